"""The Fourier algorithms: omega-k against back-projection, the others against published losses, all against extremes.

Losses and widths of the seven-target experiment were computed beforehand by an independent prototype of each algorithm; they
are stated where they are used.
"""

import re

import numpy as np
import pytest
import stripmap_scenes as scenes

import pysas
from pysas.reference import chirp_scaling, correlation, exact, omega_k, range_doppler
from pysas.reference.chirp_scaling import _scaled_rate
from pysas.reference.stripmap import prepare

C, FC, R0 = scenes.C, scenes.FC, scenes.R0
SOME = ((-1.5, 24.0), (0.3, 25.0), (1.2, 26.2))


def against_backprojection(image, echoes, rows=None, columns=None):
    """Relative L2 error of an image against back-projection on its own pixels."""
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    rows = np.ones(y.size, bool) if rows is None else rows(y)
    columns = np.ones(x.size, bool) if columns is None else columns(x)
    grid = pysas.Grid.plane(x[columns], y[rows], z=image.grid.height)
    direct = pysas.backproject(echoes, grid, tol=1e-6, threads=1).data
    return pysas.metrics.relative_error(image.data[np.ix_(rows, columns)], direct)


def even(pings, spacing=0.03):
    return spacing * (np.arange(pings) - pings // 2)


# omega-k


@pytest.fixture(scope="module")
def wide():
    """Q = 1.5, spacing D/5: the main lobe's edges are sampled without aliasing."""
    return scenes.survey((0, -10, 10), spacing=scenes.LENGTH / 5)


def illuminated(x):
    return np.abs(x) < 4.0


def about_targets(y):
    return np.min(np.abs(y[:, None] - R0 - np.array([0, -10, 10])), axis=1) < 1.5


def test_omega_k_is_back_projection(wide):
    echoes = pysas.compress(wide, threads=1)
    image = omega_k(echoes, weight="backprojection", threads=1)
    # amplitude and phase too: no factor is fitted
    assert against_backprojection(image, echoes, about_targets, illuminated) < 1e-3


def test_without_the_weight_a_tenth_remains(wide):
    echoes = pysas.compress(wide, threads=1)
    flat = omega_k(echoes, threads=1)
    rows, columns = about_targets(flat.grid.axes["y"]), illuminated(flat.grid.axes["x"])
    grid = pysas.Grid.plane(flat.grid.axes["x"][columns], flat.grid.axes["y"][rows])
    direct = pysas.backproject(echoes, grid, tol=1e-5, threads=1).data
    found = flat.data[np.ix_(rows, columns)] * np.sqrt(grid.axes["y"])[:, None]
    found *= np.vdot(found, direct) / np.vdot(found, found)
    assert 0.09 < pysas.metrics.relative_error(found, direct) < 0.11


def test_what_remains_is_the_stationary_phase():
    echoes = scenes.smooth(SOME, even(580))
    image = omega_k(echoes, weight="backprojection", threads=1)
    error = against_backprojection(image, echoes)
    # -H1(z) = sqrt(2/(pi z)) exp(j(z + pi/4)) (1 + 3j/(8 z) + ...), z = k_x r: Abramowitz and Stegun 9.2.7
    z = 4 * np.pi * FC / C * 25.0
    assert error == pytest.approx(3 / (8 * z), rel=0.1)


@pytest.mark.parametrize(
    ("options", "limit"),
    [
        ({"interpolation": "cubic", "zero_padding": 4}, 2e-4),
        pytest.param({"interpolation": "linear", "zero_padding": 16}, 4e-4, marks=pytest.mark.slow),
        ({"interpolation": "sinc", "zero_padding": 4}, 1e-4),
        ({"reference_range": 23.5}, 1e-4),
        pytest.param({"range_bandwidth": 20e3}, 1e-4, marks=pytest.mark.slow),
        ({"along_bandwidth": 170.0}, 1e-4),
    ],
)
def test_every_way_through_omega_k_agrees(options, limit):
    echoes = scenes.smooth(SOME, even(580))
    image = omega_k(echoes, weight="backprojection", threads=1, **options)
    assert against_backprojection(image, echoes) < limit


@pytest.mark.parametrize("pings", [457, 465])  # prime and odd
@pytest.mark.parametrize("samples", [353, 377])
def test_odd_lengths(pings, samples):
    echoes = scenes.smooth(((0.0, 25.0),), even(pings), samples=samples)
    assert against_backprojection(omega_k(echoes, weight="backprojection", threads=1), echoes) < 1e-4


def test_targets_at_the_ends_of_the_track():
    u = even(580)
    image = omega_k(scenes.smooth(((u[0], 25.0),), u), weight="backprojection", threads=1)
    middle = omega_k(scenes.smooth(((0.0, 25.0),), u), weight="backprojection", threads=1)

    def near(values, place, reach):
        return np.abs(values - place) < reach

    error = against_backprojection(
        image, scenes.smooth(((u[0], 25.0),), u), lambda y: near(y, 25.0, 1.0), lambda x: near(x, u[0], 1.5)
    )
    assert error < 1e-4
    # half of the beam, half of the amplitude; at the other end only what the cut aperture scatters there, nothing wrapped round
    peak = np.abs(image.data).max()
    assert peak == pytest.approx(np.abs(middle.data).max() / 2, rel=0.01)
    assert np.abs(image.data[:, image.grid.axes["x"] > 0]).max() < 0.01 * peak


def test_squint():
    look, u = np.sin(np.radians(15)), even(700)
    echoes = scenes.smooth(((5.0, 24.0), (6.5, 25.5)), u, fc=90e3, look=look, width=0.05)
    omnidirectional = echoes.replace(beam=None)
    window = (lambda y: np.abs(y - 25) < 1.5), (lambda x: np.abs(x - 5.5) < 2)
    image = omega_k(echoes, weight="backprojection", threads=1)
    assert against_backprojection(image, omnidirectional, *window) < 1e-4
    # 2 k sin(15 degrees) = 195 rad/m lies beyond pi/spacing = 105 rad/m: without the beam's axis it would be taken for an alias
    blind = omega_k(omnidirectional, weight="backprojection", threads=1)
    assert against_backprojection(blind, omnidirectional, *window) > 0.5


def test_tracks_run_either_way_and_look_to_either_side():
    points = ((-0.5, 24.0), (1.2, 26.2))
    there = omega_k(scenes.smooth(points, even(400)), threads=1)
    back = omega_k(scenes.smooth(points, even(400)[::-1]), threads=1)
    np.testing.assert_allclose(back.grid.axes["x"], there.grid.axes["x"], atol=1e-12)
    np.testing.assert_allclose(back.data, there.data, rtol=0, atol=1e-10 * np.abs(there.data).max())
    other = scenes.smooth(points, even(400), y=3.0, side=-1.0)
    image = omega_k(other, threads=1)
    np.testing.assert_allclose(image.grid.axes["y"], 3.0 - there.grid.axes["y"], atol=1e-9)
    np.testing.assert_allclose(image.data, there.data, rtol=0, atol=1e-10 * np.abs(there.data).max())
    assert pysas.metrics.peak_position(image, (1.2, 3.0 - 26.2), 0.3) == pytest.approx((1.2, 3.0 - 26.2), abs=1e-3)


@pytest.mark.parametrize("image", [omega_k, range_doppler])
def test_the_side_is_told_or_said_to_be_assumed(image):
    """Without a beam echoes of both sides are alike: what port records lies at y < 0 once that is said."""
    port = scenes.smooth(((-0.5, 24.0), (1.2, 26.2)), even(400), y=3.0, side=-1.0)
    seen, bare = image(port, threads=1), port.replace(beam=None)
    told = image(bare, side="-y", threads=1)
    assert np.array_equal(told.grid.axes["y"], seen.grid.axes["y"]) and not told.report.notes and not seen.report.notes
    assumed = image(bare, threads=1)
    assert "no side= tells" in assumed.report.notes[0] and assumed.grid.axes["y"].max() > 3.0
    assert np.array_equal(assumed.data, told.data)
    with pytest.raises(ValueError, match=r"side='port': expected .*\+y"):
        image(bare, side="port")


@pytest.mark.parametrize("weight", ["flat", "backprojection"])
def test_nothing_that_cannot_propagate_is_imaged(weight):
    # Spacing below a quarter of the least wavelength, 9.4 mm: k_u reaches 2k and beyond.
    u = even(256, 0.007)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((256, 200)) + 1j * rng.standard_normal((256, 200))
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    assert np.pi / 0.007 > 4 * np.pi * 40e3 / C

    def largest(data):
        echoes = pysas.Echoes(data, fs=20e3, fc=FC, tx=tx, rx=tx, c=C, t0=0.02, bandwidth=18e3)
        image = omega_k(echoes, weight=weight, threads=1).data
        assert np.isfinite(image).all()
        return np.abs(image).max()

    # one wave above every 2k, under a window whose main lobe ends before the propagating ones (side lobes of -150 dB)
    window = np.kaiser(256, 20)[:, None]
    evanescent = window * np.exp(1j * np.pi * np.arange(256))[:, None] * noise[0]
    assert largest(evanescent) < 1e-5 * largest(window * noise[0])
    assert largest(noise) > 0.1


def test_records_around_transmission():
    echoes = scenes.smooth(((0.0, 3.0),), even(120, 0.015), near=-1.5, samples=300)
    image = omega_k(echoes, weight="backprojection", threads=1)
    assert image.grid.axes["y"][0] == 0 and np.isfinite(image.data).all()
    # z = k_x r is 750 here: ten times the error of the stationary phase at 25 m
    assert against_backprojection(image, echoes, rows=lambda y: y > 2.5) < 1.5e-3
    with pytest.raises(ValueError, match="record ends at slant range"):
        omega_k(echoes.replace(t0=-1.0))


def test_precision_threads_and_raw_echoes():
    pulse = pysas.LFM(FC, 12e3, 4e-3, "gaussian", 2.3e-4)
    tx = np.stack([even(300), np.zeros(300), np.zeros(300)], axis=1)
    raw = pysas.simulate(
        [[0.0, 25.0, 0.0]], [1.0], pulse, tx=tx, rx=tx, fs=30e3, duration=12e-3, t0=30e-3, dtype=np.complex128, threads=1
    )
    image = omega_k(raw, threads=1)
    single = omega_k(raw.replace(data=raw.data.astype(np.complex64)), threads=1)
    assert single.data.dtype == np.complex64
    assert pysas.metrics.relative_error(single, image) < 1e-6
    for threads in (2, 3):
        np.testing.assert_array_equal(omega_k(raw, threads=threads).data, image.data)
    # the pulse's spectrum is below 1e-9 at fs/2: compressed here or before is one thing, also with a sampled waveform
    before = omega_k(pysas.compress(raw, threads=1), threads=1)
    assert pysas.metrics.relative_error(image, before) < 1e-6
    first, last = pulse.support
    assert first >= -1 / raw.fs
    sampled = pulse.waveform(np.arange(int(last * raw.fs) + 1) / raw.fs)
    assert pysas.metrics.relative_error(omega_k(raw.replace(pulse=sampled), threads=1), before) < 1e-5


# Seven targets over 30 m


@pytest.fixture(scope="module")
def thirty():
    raw = scenes.survey((0, 5, -10, 15))
    # the prototype's record was 2048 samples long, which is what linear interpolation's loss depends on
    raw = raw.replace(data=np.pad(raw.data, ((0, 0), (0, 2048 - raw.n_sample))))
    echoes = pysas.compress(raw, threads=1)
    offsets, responses = (0, 5, -10, 15), {}
    along, across = 0.055 * np.arange(-48, 49), 0.0125 * np.arange(-60, 61)
    grids = [pysas.Grid.plane(*axes) for offset in offsets for axes in ((along, [R0 + offset]), ([0.0], R0 + offset + across))]
    # all cuts at once: the oracle reads each trace once
    values, _ = exact(echoes, pysas.Grid.points(np.concatenate([grid.coordinates() for grid in grids])))
    cuts = np.split(values, np.cumsum([grid.size for grid in grids])[:-1])
    for offset, both in zip(offsets, zip(cuts[::2], cuts[1::2], strict=True), strict=True):
        widths = [pysas.metrics.irw(cut, spacing) for cut, spacing in zip(both, (0.055, 0.0125), strict=True)]
        responses[offset] = abs(both[0][48]), widths
    ideal = response(omega_k(raw, reference_range=R0, threads=1), 0)[0] / responses[0][0]
    return raw, responses, ideal


def response(image, offset):
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    columns, rows = np.abs(x) < 4.0, np.abs(y - R0 - offset) < 2.5
    grid = pysas.Grid.plane(x[columns], y[rows])
    patch = pysas.Image(image.data[np.ix_(rows, columns)], grid, image.report, image.fc, image.c)
    place = pysas.metrics.peak_position(patch, (0.0, R0 + offset), 0.2)
    cuts = [pysas.metrics.cut(patch, place, axis) for axis in ("x", "y")]
    peak = abs(cuts[0][0][np.argmin(np.abs(grid.axes["x"]))])
    return peak, [pysas.metrics.irw(values, spacing) for values, spacing in cuts], place


def losses(image, thirty, offsets):
    """Loss in dB after the sqrt(range) law, and ratios of widths along-track and in range."""
    _, exact_responses, ideal = thirty
    found = {}
    for offset in offsets:
        peak, widths, _ = response(image, offset)
        true_peak, true_widths = exact_responses[offset]
        loss = 20 * np.log10(peak / true_peak / ideal * np.sqrt((R0 + offset) / R0))
        found[offset] = loss, widths[0] / true_widths[0], widths[1] / true_widths[1]
    return found


def test_the_exact_response(thirty):
    # 0.886 c/(2B) = 3.32 cm of the flat band; 8.49 cm was the prototype's
    for _, (along, across) in thirty[1].values():
        assert along == pytest.approx(0.0849, rel=0.01) and across == pytest.approx(0.0332, rel=0.01)


LINEAR = {1: {0: 0, 5: -0.27, -10: -1.1, 15: -2.5}, 2: {0: 0, 5: -0.07, -10: -0.27, 15: -0.63}, 4: {15: -0.15}, 8: {15: -0.04}}


@pytest.mark.parametrize("padding", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow), 8])
def test_linear_stolt_interpolation_loses_as_the_square_of_the_offset(thirty, padding):
    raw = thirty[0]
    image = omega_k(raw, interpolation="linear", zero_padding=padding, reference_range=R0, threads=1)
    for offset, (loss, along, across) in losses(image, thirty, LINEAR[padding]).items():
        assert loss == pytest.approx(LINEAR[padding][offset], abs=0.1)
        # linear interpolation is a triangle in frequency: sinc^2 in range, 20 log10 sinc^2(rho) = -14.3 (1.41 rho)^2
        rho = 2 * abs(offset) * raw.fs / (C * padding * raw.n_sample)
        assert loss == pytest.approx(20 * np.log10(np.sinc(rho) ** 2), abs=0.05)
        assert along == pytest.approx(1, rel=0.03) and across == pytest.approx(1, rel=0.03)


FIGURES = {
    "cubic": (
        lambda raw: omega_k(raw, interpolation="cubic", reference_range=R0, threads=1),
        {0: (0, 1, 1), 15: (-0.01, 1, 1)},
    ),
    "sinc": (lambda raw: omega_k(raw, reference_range=R0, threads=1), {0: (0, 1, 1), 15: (0, 1, 1)}),
    "chirp scaling": (
        lambda raw: chirp_scaling(raw, reference_range=R0, threads=1),
        {0: (0, 0.99, 1.0), 5: (-0.38, 1.04, 1.02), -10: (-1.04, 1.13, 1.06), 15: (-1.62, 1.20, 1.10)},
    ),
    "chirp scaling, second order": (
        lambda raw: chirp_scaling(raw, reference_range=R0, higher_order=False, threads=1),
        {0: (-2.1, 1.18, 1.16), 15: (-1.9, None, None)},
    ),
    "range-Doppler": (
        lambda raw: range_doppler(raw, reference_range=R0, threads=1),
        {0: (0, None, None), 5: (-0.36, None, None), -10: (-0.97, None, None), 15: (-1.54, None, None)},
    ),
    "range-Doppler, linear": (
        lambda raw: range_doppler(raw, interpolation="linear", reference_range=R0, threads=1),
        {0: (0, None, None), 15: (-1.54, None, None)},
    ),
    "range-Doppler, second order": (
        lambda raw: range_doppler(raw, secondary="second-order", reference_range=R0, threads=1),
        {0: (-2.0, None, None), 15: (-1.8, None, None)},
    ),
    "range-Doppler, none": (
        lambda raw: range_doppler(raw, secondary="none", reference_range=R0, threads=1),
        {0: (-5.6, 1.60, 1.33), -10: (-5.3, None, None), 15: (-5.9, None, None)},
    ),
}


MINOR = ("range-Doppler, linear", "range-Doppler, second order", "range-Doppler, none")


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) if name in MINOR else name for name in FIGURES])
def test_published_figures(thirty, name):
    make, expected = FIGURES[name]
    found = losses(make(thirty[0]), thirty, expected)
    for offset, (loss, along, across) in expected.items():
        assert found[offset][0] == pytest.approx(loss, abs=0.3)
        if along is not None:
            assert found[offset][1] == pytest.approx(along, rel=0.03)
            assert found[offset][2] == pytest.approx(across, rel=0.03)


@pytest.mark.slow
def test_published_figures_over_130_m():
    raw = scenes.survey((0, -65, 65))
    echoes = pysas.compress(raw, threads=1)
    image = omega_k(raw, interpolation="linear", zero_padding=8, reference_range=R0, threads=1)
    scaled = chirp_scaling(raw, reference_range=R0, threads=1)
    doppler = range_doppler(raw, reference_range=R0, threads=1)
    for offset in (-65, 65):
        true = abs(exact(echoes, pysas.Grid.plane([0.0], [R0 + offset]))[0].item())
        base = abs(exact(echoes, pysas.Grid.plane([0.0], [R0]))[0].item())
        law = base / true * np.sqrt((R0 + offset) / R0)
        for made, loss in ((image, -0.05), (scaled, -4.65), (doppler, -4.5)):
            found = 20 * np.log10(response(made, offset)[0] / response(made, 0)[0] * law)
            assert found == pytest.approx(loss, abs=0.3)


# Chirp scaling


def test_the_rate_is_the_second_order_term():
    # 1/K_s = 1/K - (1/(2 pi)) d^2/dw^2 [r sqrt(4 k^2 - k_u^2)] * ... : differences in long double of the phase itself
    raw = scenes.survey((0,), spacing=0.055)
    strip = prepare(raw, None)
    rates = _scaled_rate(strip, raw.pulse, R0)
    c, step = np.longdouble(C), np.longdouble(2 * np.pi * 20.0)
    for row in (0, 7, strip.k_u.size // 3, strip.k_u.size // 2):
        k_u = np.longdouble(strip.k_u[row])

        def phase(w, k_u=k_u):
            return -np.longdouble(R0) * np.sqrt(4 * ((2 * np.pi * np.longdouble(FC) + w) / c) ** 2 - k_u**2)

        second = (phase(step) - 2 * phase(0) + phase(-step)) / step**2
        # a chirp of rate K has the spectral phase -w^2/(4 pi K)
        expected = 1 / (1 / np.longdouble(raw.pulse.rate) - 2 * np.pi * second)
        assert float(rates[row]) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.parametrize("sweep", [-1, 1])
def test_both_sweeps_focus_at_the_target(sweep):
    raw = scenes.survey((0,), duration=20e-3, sweep=sweep)
    _, _, place = response(chirp_scaling(raw, reference_range=R0, threads=1), 0)
    assert place == pytest.approx((0.0, R0), abs=1e-3)


def test_a_vanishing_secondary_rate_names_its_range():
    raw = scenes.survey((0,), duration=4e-3, sweep=1)
    # 8 pi r K k_u^2 = c^2 S0^3 at k_u = pi/spacing, K = 5e6: r = 80.9 m
    k_u = np.pi / 0.055
    s0 = np.sqrt((4 * np.pi * FC / C) ** 2 - k_u**2)
    at = C**2 * s0**3 / (8 * np.pi * 5e6 * k_u**2)
    with pytest.raises(ValueError, match=r"passes through zero at slant range [\d.]+ m") as error:
        chirp_scaling(raw, threads=1)
    # the largest k_u of the transform is within one bin of pi/spacing
    assert float(re.search(r"slant range ([\d.]+) m", str(error.value))[1]) == pytest.approx(at, rel=0.01)
    assert np.isfinite(chirp_scaling(raw.replace(pulse=pysas.LFM(FC, -20e3, 4e-3)), threads=1).data).all()
    assert np.isfinite(chirp_scaling(raw, along_bandwidth=60.0, threads=1).data).all()


def test_a_sample_rate_below_the_scaling_condition_is_refused():
    raw = scenes.survey((0, -15, 15), fs=21e3)
    with pytest.raises(ValueError, match="chirp scaling moves the ends of the record"):
        chirp_scaling(raw, threads=1)
    image = chirp_scaling(scenes.survey((0, -15, 15), fs=24e3), reference_range=R0, threads=1)
    assert 20.5e3 < image.report.choices["least_fs"] < 24e3


@pytest.mark.parametrize("make", [range_doppler, chirp_scaling])
def test_the_evanescent_edge_is_refused_where_migration_is_unbounded(make):
    raw = scenes.survey((0,), spacing=0.055)
    dense = raw.replace(tx=raw.tx / 6, rx=raw.rx / 6)
    with pytest.raises(ValueError, match="evanescent edge"):
        make(dense, threads=1)
    assert np.isfinite(make(dense, along_bandwidth=120.0, threads=1).data).all()


def test_range_doppler_and_chirp_scaling_of_odd_lengths():
    raw = scenes.survey((0,))
    odd = raw.replace(data=raw.data[:-1, :-2], tx=raw.tx[:-1], rx=raw.rx[:-1])
    for made in (range_doppler(odd, reference_range=R0, threads=1), chirp_scaling(odd, reference_range=R0, threads=1)):
        peak, _, place = response(made, 0)
        assert place == pytest.approx((0.0, R0), abs=1e-3) and peak > 1


def test_squinted_range_doppler_and_chirp_scaling():
    # 15 degrees, Q = 4.5: expanded about the beam's axis no longer, still focused at the reference range
    look = np.radians(15)
    boresight = (np.sin(look), np.cos(look), 0.0)
    element = pysas.simulation.Element(0.1, boresight=boresight, along=(np.cos(look), -np.sin(look), 0.0))
    tx = np.stack([even(800), np.zeros(800), np.zeros(800)], axis=1)
    raw = pysas.simulate(
        [[5.01, 25.0, 0.0]], [1.0], pysas.LFM(90e3, -20e3, 4e-3, "tukey", 0.2), tx=tx, rx=tx, fs=40e3, duration=16e-3, t0=28e-3,
        tx_element=element, rx_element=element, threads=1, dtype=np.complex128,
    )  # fmt: skip
    raw = raw.replace(beam=pysas.Beam(boresight, 0.1, np.pi / 2))
    ideal = np.abs(omega_k(raw, reference_range=25.0, threads=1).data).max()
    for image in (range_doppler(raw, reference_range=25.0, threads=1), chirp_scaling(raw, reference_range=25.0, threads=1)):
        assert pysas.metrics.peak_position(image) == pytest.approx((5.01, 25.0), abs=1e-3)
        assert 20 * np.log10(np.abs(image.data).max() / ideal) == pytest.approx(0, abs=0.3)
    # what second order alone leaves moves the peak by millimetres
    second = chirp_scaling(raw, reference_range=25.0, higher_order=False, threads=1)
    assert 3e-3 < pysas.metrics.peak_position(second)[1] - 25.0 < 1e-2


def test_range_doppler_of_a_record_around_transmission():
    echoes = scenes.smooth(((0.0, 3.0),), even(120, 0.015), near=-1.5, samples=300)
    image = range_doppler(echoes, along_bandwidth=200.0, reference_range=3.0, threads=1)
    assert np.isfinite(image.data).all()
    assert pysas.metrics.peak_position(image) == pytest.approx((0.0, 3.0), abs=2e-3)


# Correlation


@pytest.mark.parametrize("channels", [1, 3])
def test_correlation_is_matched_filter_and_sum(channels):
    pulse = pysas.LFM(100e3, 15e3, 2e-3, "gaussian", 2.5e-4)
    track = pysas.tracks.perturbed(12, 0.1, sway=0.05, seed=1)
    rx = track.position if channels == 1 else pysas.tracks.array(track, channels, 0.1)
    raw = pysas.simulate(
        [[0.5, 20.0, 0.0], [0.7, 20.4, 0.0]], [1.0, 0.5j], pulse, tx=track.position, rx=rx, fs=40e3, duration=9e-3, t0=22e-3,
        dtype=np.complex128, threads=1,
    )  # fmt: skip
    grid = pysas.Grid.plane(np.linspace(0.3, 0.9, 7), np.linspace(19.8, 20.6, 9))
    image = correlation(raw, grid)
    # the pulse's spectrum, and so its product with the replica, is below 1e-9 outside fs/2.2
    assert pysas.metrics.relative_error(image, exact(pysas.compress(raw, threads=1), grid)[0]) < 1e-8
    mask = np.zeros(grid.shape, bool)
    mask[4, 3] = True
    masked = correlation(raw, pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask))
    np.testing.assert_array_equal(masked.data != 0, mask)
    assert masked.data[4, 3] == pytest.approx(image.data[4, 3], rel=1e-12)


@pytest.mark.parametrize("lead", [0.0, -6.0, -6.4])
def test_correlation_with_measured_pulses(lead):
    """Up- and down-sweeps in turn, known by their samples alone: the matched filters' image, and that of the formulas."""
    fs = 40e3
    sweeps = [pysas.LFM(100e3, sign * 12e3, 2e-3, "gaussian", 2e-4) for sign in (1, -1)] * 4
    tx = np.zeros((8, 3))
    tx[:, 0] = 0.1 * np.arange(8)
    # one echo a ping, written down by hand
    tau = 2 * np.linalg.norm([0.4, 20.0, 0.0] - tx, axis=1) / 1500
    t = 25e-3 + np.arange(240) / fs
    data = np.array([p.waveform(t - d) * np.exp(-2j * np.pi * 100e3 * d) for p, d in zip(sweeps, tau, strict=True)])
    raw = pysas.Echoes(data, fs=fs, fc=100e3, tx=tx, rx=tx, t0=25e-3, compressed=False)
    grid = pysas.Grid.plane(np.linspace(0.3, 0.5, 5), np.linspace(19.9, 20.1, 5))
    samples = [p.waveform(lead / fs + np.arange(100) / fs) for p in sweeps]
    image = correlation(raw, grid, samples, lead / fs)
    assert abs(image.data[2, 2] - 8) < 1e-9
    assert pysas.metrics.relative_error(image, correlation(raw, grid, sweeps)) < 1e-9
    compressed = pysas.compress(raw, pulse=samples, pulse_t0=lead / fs, threads=1)
    assert pysas.metrics.relative_error(image, exact(compressed, grid)[0]) < 1e-9
    single = raw.replace(data=data[::2], tx=tx[::2], rx=tx[::2], pulse=samples[0])
    if lead == 0:
        assert pysas.metrics.relative_error(correlation(single, grid), correlation(single, grid, sweeps[0])) < 1e-9


# Arguments


def test_arguments_are_named():
    echoes = scenes.smooth(((0.0, 25.0),), even(32))
    raw = scenes.survey((0,))
    cases = [
        (lambda: omega_k(1), TypeError, "echoes=int: expected pysas.Echoes"),
        (lambda: omega_k(echoes, interpolation="spline"), ValueError, "interpolation='spline'"),
        (lambda: omega_k(echoes, weight="none"), ValueError, "weight='none'"),
        (lambda: omega_k(echoes, zero_padding=0), ValueError, "zero_padding=0"),
        (lambda: omega_k(echoes, reference_range=-1.0), ValueError, "reference_range=-1.0"),
        (lambda: omega_k(echoes, range_bandwidth=1e6), ValueError, "range_bandwidth=1000000.0"),
        (lambda: omega_k(echoes, along_bandwidth=1e6), ValueError, "along_bandwidth=1000000.0"),
        (lambda: omega_k(raw.replace(pulse=None)), ValueError, "pulse=None"),
        (lambda: omega_k(echoes.replace(fs=70e3)), ValueError, "fs=70000 Hz: expected less than twice fc"),
        (lambda: range_doppler(echoes, secondary="third"), ValueError, "secondary='third'"),
        (lambda: range_doppler(echoes, interpolation="cubic"), ValueError, "interpolation='cubic'"),
        (lambda: chirp_scaling(echoes), ValueError, "compressed=True"),
        (lambda: chirp_scaling(raw, higher_order=1), TypeError, "higher_order=1"),
        (lambda: chirp_scaling(raw.replace(pulse=np.ones(9, complex))), ValueError, "pulse=ndarray"),
        (lambda: chirp_scaling(raw.replace(fc=31e3)), ValueError, "demodulation at the pulse's centre"),
        (lambda: correlation(echoes, pysas.Grid.plane([0.0], [25.0])), ValueError, "compressed=True"),
        (lambda: correlation(raw, None), TypeError, "grid=NoneType"),
        (lambda: correlation(raw.replace(pulse=None), pysas.Grid.plane([0.0], [25.0])), ValueError, "pulse=None"),
        (lambda: correlation(raw, pysas.Grid.plane([0.0], [25.0]), [raw.pulse] * 2), ValueError, "2 pulses: expected one, or"),
        (
            lambda: correlation(raw, pysas.Grid.plane([0.0], [25.0]), np.full(3, np.nan)),
            ValueError,
            "of ping 0: expected finite",
        ),
    ]
    for call, kind, text in cases:
        with pytest.raises(kind, match=text.replace("(", r"\(")):
            call()


def test_correlation_takes_a_start_of_measured_pulses_alone():
    raw = scenes.survey((0,), spacing=0.5)
    grid = pysas.Grid.plane([0.0], [R0])
    with pytest.raises(ValueError, match="pulse_t0: an LFM begins"):
        correlation(raw, grid, pulse_t0=5e-4)
