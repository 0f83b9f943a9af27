"""Echoes made fit for the Fourier algorithms (phase centres, motion compensation), what they refuse, and multi-look images."""

import numpy as np
import pytest
import stripmap_scenes as scenes

import pysas
from pysas.reference import chirp_scaling, looks, motion_compensate, omega_k, phase_centres, range_doppler

pytestmark = pytest.mark.reference

C = scenes.C
PULSE = pysas.LFM(100e3, 20e3, 2e-3, "tukey", 0.3)
WAVELENGTH = C / 100e3
POINTS = np.array([[0.0, 24.0, 0.0], [0.8, 26.0, 0.0], [-0.6, 28.5, 0.0]])


def even(pings, spacing=0.03):
    return spacing * (np.arange(pings) - (pings - 1) / 2)


def line(x, y=0.0, z=0.0):
    x = np.asarray(x, dtype=float)
    return np.stack([x, np.broadcast_to(y, x.shape), np.broadcast_to(z, x.shape)], axis=1)


def record(tx, rx=None, points=POINTS, length=0.12, **more):
    """Compressed echoes of points from 21 m on; elements of 0.12 m keep the along-track spectrum within +-105 rad/m."""
    element = pysas.simulation.Element(length)
    raw = pysas.simulate(
        points, np.ones(len(points)), PULSE, tx=tx, rx=tx if rx is None else rx, fs=40e3, duration=16e-3, t0=28e-3, threads=1,
        tx_element=element, rx_element=element, dtype=np.complex128, **more,
    )  # fmt: skip
    return pysas.compress(raw, threads=1)


def error(found, wanted):
    return pysas.metrics.relative_error(found.data, wanted.data)


# What the algorithms refuse

TRACK = line(even(40))


def changed(ping, axis, by):
    tx = TRACK.copy()
    tx[ping, axis] += by
    return tx


@pytest.mark.parametrize("make", [omega_k, range_doppler])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tx": changed(17, 0, 0.004), "rx": changed(17, 0, 0.004)}, "tx at ping 17 is 0.00[34]"),
        ({"tx": changed(3, 1, 0.002), "rx": changed(3, 1, 0.002)}, "tx at ping 3 is 0.00[12]"),
        ({"tx": changed(39, 2, -0.002), "rx": changed(39, 2, -0.002)}, "tx at ping 39 is 0.00[12]"),
        ({"rx": changed(21, 1, 0.001)}, "rx at ping 21 is 0.001 m from tx"),
        ({"velocity": np.full((40, 3), 1.0)}, "velocity: expected one stationary channel"),
        ({"t0": np.where(np.arange(40) == 8, 0.0281, 0.028)}, "t0=.* at ping 8"),
        ({"tx": 0 * TRACK, "rx": 0 * TRACK}, "does not advance along x"),
        ({"tx": TRACK[:, [1, 0, 2]], "rx": TRACK[:, [1, 0, 2]]}, "does not advance along x"),
    ],
)
def test_what_is_not_straight_and_even_is_refused_and_named(make, change, message):
    echoes = pysas.Echoes(np.ones((40, 64), complex), fs=40e3, fc=100e3, tx=TRACK, rx=TRACK, t0=0.028)
    with pytest.raises(ValueError, match=message):
        make(echoes.replace(**change), threads=1)


def test_tolerance_of_the_track_is_a_hundredth_of_a_wavelength():
    echoes = pysas.Echoes(np.ones((40, 64), complex), fs=40e3, fc=100e3, tx=TRACK, rx=TRACK, t0=0.028)
    inside, outside = (changed(20, 2, share * WAVELENGTH / 100) for share in (1.0, 1.06))
    omega_k(echoes.replace(tx=inside, rx=inside), threads=1)
    with pytest.raises(ValueError, match="ping 20"):
        omega_k(echoes.replace(tx=outside, rx=outside), threads=1)


def test_other_refusals():
    data = np.ones((40, 64), complex)
    data[11, 5] = np.nan
    echoes = pysas.Echoes(data, fs=40e3, fc=100e3, tx=TRACK, rx=TRACK, t0=0.028)
    for call in (omega_k, range_doppler, phase_centres, lambda e: motion_compensate(e, seabed=0.0)):
        with pytest.raises(ValueError, match="non-finite sample at ping 11"):
            call(echoes)
    with pytest.raises(ValueError, match="raw: 2 channels: expected one stationary channel"):
        chirp_scaling(pysas.Echoes(np.ones((40, 2, 64), complex), fs=40e3, fc=100e3, tx=TRACK, rx=np.stack([TRACK] * 2, 1)))
    with pytest.raises(ValueError, match="1 ping: expected at least two"):
        omega_k(pysas.Echoes(np.ones((1, 64), complex), fs=40e3, fc=100e3, tx=TRACK[:1], rx=TRACK[:1]))


# Phase centres


def test_receivers_along_the_track_become_one_sonar():
    # four receivers, 0.06 m apart, and an advance of 0.12 m: phase centres every 0.03 m
    tx = line(even(50, 0.12))
    rx = tx[:, None] + np.array([[x, 0, 0] for x in (0.20, 0.26, 0.32, 0.38)])
    # omnidirectional elements: the product of two patterns seen from 0.4 m apart is another matter
    echoes = record(tx, rx, length=0.0)
    made = phase_centres(echoes, reference_range=24.0)
    assert made.n_ping == 200 and made.attrs["resampling_error"] == 0
    np.testing.assert_allclose(made.tx[:, 0], even(200) + 0.145, atol=1e-9)
    wanted = record(made.tx, length=0.0)
    uncorrected = echoes.data.reshape(wanted.data.shape)
    # the path left is at most b^2 sin^2(theta)/(4 r), and on average over angles a third of that
    assert error(made, wanted) < made.attrs["residual_phase"] < 0.02
    # b^2/(4 r) = 1.5 mm at 24 m: a tenth of a wavelength, which the correction takes away
    assert pysas.metrics.relative_error(uncorrected, wanted.data) > 0.2


def test_moving_receivers_shift_by_half_their_way():
    velocity = np.array([2.0, 0.0, 0.0])
    tx = line(even(240))
    rx = tx[:, None] + np.array([[0.1, 0, 0], [0.13, 0, 0]])
    echoes = record(tx, rx, velocity=np.broadcast_to(velocity, tx.shape))
    made = phase_centres(echoes, spacing=0.02)
    inner = slice(20, -20)
    wanted = record(made.tx)
    assert made.velocity is None and made.attrs["resampling_error"] < 2e-3
    bound = made.attrs["residual_phase"] + made.attrs["resampling_error"]
    assert pysas.metrics.relative_error(made.data[inner], wanted.data[inner]) < bound + 2e-3
    still = phase_centres(echoes.replace(velocity=None), spacing=0.02)
    # v tau/2 = 3.5 cm: more than the new spacing
    moved = record(still.tx).data[inner]
    assert pysas.metrics.relative_error(still.data[inner], moved) > 0.3


def test_uneven_pings_are_resampled():
    rng = np.random.default_rng(2)
    x = even(300, 0.02) + rng.uniform(-0.008, 0.008, 300)
    made = phase_centres(record(line(x)), along_bandwidth=220.0)
    wanted = record(made.tx)
    inner = slice(20, -20)
    assert made.attrs["residual_phase"] == 0
    assert 0 < made.attrs["resampling_error"] < 0.01
    # elements' side lobes lie beyond the band that the weights are made for: 1.5 % of the energy's root
    assert pysas.metrics.relative_error(made.data[inner], wanted.data[inner]) < 0.02
    image = omega_k(made, threads=1)
    assert pysas.metrics.peak_position(image, (0.8, 26.0), 0.2) == pytest.approx((0.8, 26.0), abs=1e-3)


def test_phase_centres_of_raw_echoes_state_what_the_pulse_costs():
    tx = line(even(40, 0.06))
    rx = tx[:, None] + np.array([[0.5, 0, 0], [0.56, 0, 0]])
    raw = pysas.simulate(POINTS[:1], [1.0], PULSE, tx=tx, rx=rx, fs=40e3, duration=12e-3, t0=28e-3, threads=1)
    made, compressed = phase_centres(raw), phase_centres(pysas.compress(raw, threads=1))
    r = sum(raw.swath) / 2
    # 2 pi fc b^2/(2 c^2 tau^2) T/2, tau = 2 r/c, for the longest baseline
    pulse = 2 * np.pi * 100e3 * 0.56**2 / (2 * 4 * r**2) * 1e-3
    r_compressed = sum(compressed.swath) / 2
    assert made.attrs["residual_phase"] - pulse == pytest.approx(
        compressed.attrs["residual_phase"] * r_compressed / r, rel=1e-6
    )
    assert error(pysas.compress(made, threads=1), compressed) < 2 * pulse + 0.02


def test_phase_centres_off_the_line_are_named():
    tx = line(even(20, 0.06))
    rx = np.repeat(tx[:, None], 2, axis=1)
    rx[7, 1, 2] += 0.001
    echoes = pysas.Echoes(np.ones((20, 2, 64), complex), fs=40e3, fc=100e3, tx=tx, rx=rx, t0=0.028)
    with pytest.raises(ValueError, match="phase centre of ping 7, channel 1 is 0.000[45]"):
        phase_centres(echoes)
    with pytest.raises(ValueError, match="expected one start time"):
        phase_centres(echoes.replace(t0=np.linspace(0.028, 0.029, 20)))
    with pytest.raises(ValueError, match="do not advance"):
        phase_centres(echoes.replace(tx=0 * tx, rx=0 * rx))
    with pytest.raises(ValueError, match="spacing=0"):
        phase_centres(echoes, spacing=0.0)


# Motion compensation


@pytest.fixture(scope="module")
def perturbed():
    track = pysas.tracks.perturbed(
        300, 0.03, height=6.0, start=(-4.485, 0.0, 0.0), sway=0.05, heave=0.03, correlation=2.0, seed=4
    )
    points = np.array([[0.015, 23.5, 0.0], [0.795, 25.5, 0.0], [-0.615, 27.5, 0.0]])
    return record(track.position, points=points), points


def focused(image, points, y0, z0):
    """Largest error of the peaks' positions, m, and the peaks."""
    off, peaks = [], []
    for x, y, _ in points:
        wanted = np.array([x, y0 + np.hypot(y - y0, z0)])
        place = pysas.metrics.peak_position(image, tuple(wanted), 0.3)
        # the points lie on pings: a cut along x has its peak at a sample
        values, _ = pysas.metrics.cut(image, place, "x")
        off.append(np.abs(np.array(place) - wanted).max())
        peaks.append(np.abs(values).max())
    return max(off), np.array(peaks)


def test_a_perturbed_track_is_refused_until_it_is_compensated(perturbed):
    echoes, points = perturbed
    with pytest.raises(ValueError, match="motion_compensate"):
        omega_k(echoes, threads=1)
    made = motion_compensate(echoes, seabed=0.0)
    y0, z0 = echoes.tx[:, 1:].mean(axis=0)
    np.testing.assert_allclose(made.tx[:, 1:], np.broadcast_to([y0, z0], (300, 2)), atol=1e-12)
    assert made.attrs["displacement"] == pytest.approx(np.linalg.norm(echoes.tx[:, 1:] - [y0, z0], axis=1).max(), rel=1e-9)
    off, peaks = focused(omega_k(made, weight="backprojection", threads=1), points, y0, z0)
    assert off < 3e-3
    direct = np.abs(pysas.reference.exact(echoes, pysas.Grid.points(points))[0])
    straight = record(line(even(300), y0, z0), points=points)
    ideal = np.abs(pysas.reference.exact(straight, pysas.Grid.points(points))[0])
    unperturbed = focused(omega_k(straight, weight="backprojection", threads=1), points, y0, z0)[1]
    # Path errors of 2 |d| (1 - cos theta), |d| < 0.1 m, and 0.06 rad from broadside: 0.15 rad, whose square over two is 0.1 dB.
    # The straight track itself has 0.24 dB, of side lobes that the spacing aliases.
    assert np.all(np.abs(20 * np.log10(peaks / direct * ideal / unperturbed)) < 0.1)


def test_second_order_is_right_at_every_range_and_first_order_at_one(perturbed):
    echoes, points = perturbed
    y0, z0 = echoes.tx[:, 1:].mean(axis=0)
    straight = record(line(even(300), y0, z0), points=points)
    # near broadside: the middle pings of one point at the reference range, and at others
    r = np.hypot(points[1, 1] - y0, z0)
    first = motion_compensate(echoes, seabed=0.0, order=1, reference_range=r)
    second = motion_compensate(echoes, seabed=0.0, reference_range=r)

    def near(made, place):
        ping = int(np.argmin(np.abs(even(300) - place[0])))
        cell = int(round((2 * np.hypot(place[1] - y0, z0) / C - 28e-3) * 40e3))
        part = np.s_[ping - 5 : ping + 6, cell - 6 : cell + 7]
        return pysas.metrics.relative_error(made.data[part], straight.data[part])

    assert near(echoes, points[1]) > 0.5
    assert near(first, points[1]) < 0.03 and near(second, points[1]) < 0.03
    for place in (points[0], points[2]):
        assert near(second, place) < 0.03
        assert near(first, place) > 1.5 * near(second, place)


def test_moving_receivers_of_a_perturbed_track_end_on_the_line():
    track = pysas.tracks.perturbed(240, 0.06, height=6.0, start=(-7.2, 0.0, 0.0), sway=0.05, yaw=0.01, correlation=2.0, seed=5)
    rx = pysas.tracks.array(track, 2, 0.06, offset=(0.15, 0.0, -0.1))
    points = np.array([[0.0, 23.5, 0.0], [0.8, 26.5, 0.0]])
    echoes = record(track.position, rx, points=points, velocity=track.velocity)
    # across the track receivers move 0.04 m/s x 35 ms: several times the tolerance of phase_centres, which checks the line
    made = phase_centres(motion_compensate(echoes, seabed=0.0))
    off, _ = focused(omega_k(made, threads=1), points, *made.tx[0, 1:])
    assert off < 1e-3


def test_motion_compensation_names_its_arguments(perturbed):
    echoes, _ = perturbed
    for arguments, message in (
        ({"seabed": np.nan}, "seabed=nan"),
        ({"seabed": 0.0, "order": 3}, "order=3"),
        ({"seabed": 100.0}, "line's height over the seabed"),
        ({"seabed": 0.0, "line": (0.0, 1.0, 2.0)}, "line: expected shape"),
    ):
        with pytest.raises(ValueError, match=message):
            motion_compensate(echoes, **arguments)


def test_measured_survey(data_dir):
    # six moving receivers on a track with sway, heave, yaw; the seabed at z = 8 m, targets above it displaced by flatness alone
    raw = pysas.load(data_dir / "stripmap_perturbed.npz")
    made = phase_centres(motion_compensate(pysas.compress(raw, threads=1), seabed=8.0))
    image = omega_k(made, threads=1)
    y0, z0 = made.tx[0, 1:]
    for x, y, z in ((6.5, 25.0, 8.0), (6.5, 30.0, 8.0), (6.5, 35.0, 8.0), (7.9, 32.7, 8.0)):
        wanted = (x, y0 + np.hypot(y - y0, z - z0))
        assert pysas.metrics.peak_position(image, wanted, 0.1) == pytest.approx(wanted, abs=1.5e-3)


# Looks


def speckle(seed=0):
    """A uniform field of speckle: white noise cut to 0.8 of the band each way, about a carrier."""
    rng = np.random.default_rng(seed)
    spectrum = rng.standard_normal((256, 512)) + 1j * rng.standard_normal((256, 512))
    for axis in (0, 1):
        f = np.fft.fftfreq(spectrum.shape[axis])
        spectrum *= np.expand_dims(np.abs((f - 0.3 + 0.5) % 1 - 0.5) < 0.4, 1 - axis)
    grid = pysas.Grid.plane(0.02 * np.arange(512), 30 + 0.02 * np.arange(256))
    return pysas.Image(np.fft.ifft2(spectrum), grid, pysas.Report("noise"), 100e3, C)


@pytest.mark.parametrize(("sub_apertures", "bands"), [(1, 1), (4, 1), (1, 4), (4, 2), (8, 4)])
def test_speckle_contrast_falls_as_the_root_of_looks(sub_apertures, bands):
    found = looks(speckle(), sub_apertures, bands)
    assert len(found.images) == sub_apertures * bands
    # exponential intensities: contrast 1; the mean of N independent ones: 1/sqrt(N) (J. W. Goodman 1976)
    assert found.contrast == pytest.approx(1 / np.sqrt(sub_apertures * bands), rel=0.03)


def test_looks_add_up_to_the_image_and_share_its_energy():
    image = speckle()
    found = looks(image, 4, 2)
    total = np.sum([look.data for look in found.images], axis=0)
    # each bin holds more than the thousandth of the energy that may be left out: none is
    assert pysas.metrics.relative_error(total, image) < 1e-12
    energies = [np.sum(np.abs(look.data) ** 2) for look in found.images]
    assert np.ptp(energies) < 0.05 * np.mean(energies)
    np.testing.assert_allclose(found.intensity, np.mean([np.abs(look.data) ** 2 for look in found.images], axis=0))


def test_looks_widen_a_point_by_their_number():
    # a flat band 0.8 wide: IRW 0.886/0.8 pixels, four times that for a quarter of the band
    f = np.fft.fftfreq(512)
    line_response = np.fft.fftshift(np.fft.ifft(np.abs(f) < 0.4))
    data = np.outer(np.fft.fftshift(np.fft.ifft(np.abs(np.fft.fftfreq(64)) < 0.4)), line_response)
    grid = pysas.Grid.plane(np.arange(512.0), np.arange(64.0))
    found = looks(pysas.Image(data, grid, pysas.Report("point"), 100e3, C), 4)
    for look in found.images:
        assert pysas.metrics.irw(look.data[32], 1.0) == pytest.approx(4 * 0.884 / 0.8, rel=0.02)


def test_looks_name_their_arguments():
    image = speckle()
    uneven = pysas.Grid.plane(np.cumsum(1 + np.arange(512)), np.arange(256.0))
    for call, kind, message in (
        (lambda: looks(1), TypeError, "image=int"),
        (lambda: looks(image, 0), ValueError, "sub_apertures=0"),
        (lambda: looks(image, 1, 300), ValueError, "bands=300"),
        (lambda: looks(pysas.Image(0 * image.data, image.grid, image.report, 1.0, 1.0)), ValueError, "not all zero"),
        (lambda: looks(pysas.Image(image.data, uneven, image.report, 1.0, 1.0)), ValueError, "evenly spaced axis x"),
    ):
        with pytest.raises(kind, match=message):
            call()
