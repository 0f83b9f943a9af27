"""One-way migration against the exact sum, its two forms against each other, and layers against delays by Snell's law.

Widths of the 10 cm experiment were computed beforehand by an independent prototype; they are stated where they are used.
"""

import numpy as np
import pytest
import stripmap_scenes as scenes
from scipy.optimize import brentq

import pysas
from pysas.reference import exact, one_way

pytestmark = pytest.mark.reference

C = 1500.0
POINTS = ((0.0, 8.0), (0.1, 9.0))


def even(pings, spacing=0.01):
    return spacing * (np.arange(pings) - pings // 2)


def against_exact(image, echoes, count=1000):
    """Relative error on random pixels."""
    pixels = np.random.default_rng(0).choice(image.grid.size, min(count, image.grid.size), replace=False)
    direct, level = exact(echoes, image.grid, pixels)
    return pysas.metrics.relative_error(image.data.ravel()[pixels], direct, level)


@pytest.fixture(scope="module")
def narrow():
    """100 kHz, cos^2 beam of sines up to 0.15, spacing 1 cm: k_x dx <= 1.4."""
    return scenes.smooth(POINTS, even(300), fc=100e3, band=15e3, fs=20e3, near=7.5, samples=60, width=0.15)


@pytest.mark.parametrize(("angle", "limit"), [(15, 0.03), (45, 0.003)])
def test_it_is_back_projection(narrow, angle, limit):
    # no factor is fitted. 15 degrees: phase k z s^4/8 = 0.5 rad at s = 0.15 and 9 m, where the beam is dark
    image = one_way(narrow, angle=angle, weight="backprojection", half_angle=0.15, threads=1)
    assert against_exact(image, narrow) < limit


def test_raw_echoes_and_the_beam_of_the_echoes():
    u = even(120)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    pulse = pysas.LFM(100e3, 12e3, 3e-3, "tukey", 0.3)
    raw = pysas.simulate([[0.0, 8.0, 0.0]], [1.0], pulse, tx=tx, rx=tx, fs=20e3, duration=6e-3, t0=10e-3, threads=1)
    grid = pysas.Grid.plane(u[40:80], 7.9 + 0.05 * np.arange(5))
    compressed = one_way(pysas.compress(raw, threads=1), grid, half_angle=0.1, threads=1)
    assert pysas.metrics.relative_error(one_way(raw, grid, half_angle=0.1, threads=1), compressed) < 0.01
    beam = pysas.Beam((0.0, 1.0, 0.0), 0.04, 0.1)
    assert one_way(raw.replace(beam=beam), grid, threads=1).report.choices["half_angle"] == 0.1
    with pytest.warns(UserWarning, match="the march carries"):
        wide = one_way(raw.replace(beam=pysas.Beam((0.0, 1.0, 0.0), 0.04, np.pi / 2)), grid, step=0.1, threads=1)
    # pi/(k dx) at the highest frequency
    k = 4 * np.pi * (100e3 + raw.occupied_bandwidth / 2) / C
    assert np.sin(wide.report.choices["half_angle"]) == pytest.approx(np.pi / (0.01 * k))


def test_a_first_row_at_the_track(narrow):
    # nothing has moved there yet: the row is the record at t = 0, silent here
    for angle, correction in ((15, "none"), (45, "both")):
        grid = pysas.Grid.plane(even(300)[140:160], [0.0, 0.05])
        image = one_way(narrow, grid, angle=angle, correction=correction, half_angle=0.08, threads=1)
        assert np.abs(image.data).max() < 1e-3


# The prototype's experiment: c/(2 fc) = 10 cm, target at 8 m, a beam cut at sines of 0.25, spacing 5 cm


@pytest.fixture(scope="module")
def low():
    u, near, fs, sigma = even(140, 0.05), 7.2, 5e3, 4.0e-4
    t = 2 * near / C + np.arange(24) / fs
    away = np.hypot(8.0, u)[:, None]
    beam = np.abs(u)[:, None] / away < 0.25
    data = beam * np.exp(-((t - 2 * away / C) ** 2) / (2 * sigma**2) - 4j * np.pi * 7500 / C * away)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    return pysas.Echoes(data, fs=fs, fc=7500.0, tx=tx, rx=tx, c=C, t0=2 * near / C, bandwidth=4e3)


LOW = pysas.Grid.plane(even(140, 0.05)[40:100], 7.75 + 0.05 * np.arange(11))


def response(image):
    """Depth of the peak, width at -3 dB in x, peak."""
    row = np.unravel_index(np.argmax(np.abs(image.data)), image.data.shape)[0]
    return image.grid.axes["y"][row], pysas.metrics.irw(image.data[row], 0.05), np.abs(image.data).max()


def test_the_width_of_each_scheme(low):
    direct = exact(low, pysas.Grid.plane(LOW.axes["x"], [8.0]))[0][0]
    ideal = pysas.metrics.irw(direct, 0.05)
    assert ideal == pytest.approx(0.176, rel=0.02)
    widths = {}
    for scheme, correction in (("euler", "none"), ("cn", "none"), ("cn", "centre"), ("cn", "compact"), ("cn", "both")):
        kwargs = {"angle": 15, "form": "carrier", "step": 0.1 / 8, "half_angle": 0.2, "threads": 1}
        depth, widths[scheme, correction], _ = response(one_way(low, LOW, scheme=scheme, correction=correction, **kwargs))
        # without corrections Crank-Nicolson's phase moves the peak
        assert depth == 8.0 or (scheme, correction) == ("cn", "none")
    # 8 cells per 10 cm: 38.4, 22.2, 18.4, 17.6, 17.2 cm
    assert widths["euler", "none"] > 1.9 * ideal and widths["cn", "none"] > 1.1 * ideal
    assert widths["cn", "both"] == pytest.approx(ideal, rel=0.1)
    assert widths["cn", "compact"] == pytest.approx(ideal, rel=0.1)
    assert response(one_way(low, LOW, half_angle=0.25, threads=1))[1] == pytest.approx(ideal, rel=0.1)


@pytest.mark.parametrize("angle", [15, 45])
def test_the_base_band_is_the_carrier_form(angle):
    echoes = scenes.smooth(((0.0, 4.0),), even(50, 0.05), fc=7500, band=4000, fs=5e3, near=3.0, samples=24, width=0.25)
    grid = pysas.Grid.plane(even(50, 0.05), 3.7 + 0.05 * np.arange(12))
    # two layers of one speed: it marches from the track, with the same differences in x
    layers = [(0.0, C), (0.01, C)]
    base = one_way(echoes, grid, angle=angle, half_angle=0.25, step=0.004, layers=layers, threads=1)
    assert base.report.choices["columns_per_ping"] == 1
    errors = []
    for step in (0.0125, 0.00625):
        found = one_way(echoes, grid, angle=angle, form="carrier", half_angle=0.25, step=step, threads=1)
        errors.append(pysas.metrics.relative_error(found.data, base.data))
    # the splitting is corrected at fc: what is left falls as dz to dz^2
    assert errors[0] < 0.01 and errors[1] < 0.45 * errors[0]


# Water of several speeds


def delay(x, depths, speeds):
    """Two-way time of the ray that crosses `depths` of layers and `x` along them: Snell's law, root-found to 1e-12 s."""
    depths, speeds = np.asarray(depths), np.asarray(speeds)
    if x == 0:
        return 2 * np.sum(depths / speeds)

    def across(p):
        return np.sum(depths * p * speeds / np.sqrt(1 - (p * speeds) ** 2)) - abs(x)

    p = brentq(across, 0, (1 - 1e-12) / speeds.max(), xtol=1e-18, rtol=1e-15)
    return 2 * np.sum(depths / (speeds * np.sqrt(1 - (p * speeds) ** 2)))


def layered(target, tops, speeds, u, half_angle, near, samples, fc=100e3, fs=20e3, band=15e3):
    """Echoes of a point under layers, cut smoothly at a half-angle at the track, and the two-way times."""

    def times(x, z):
        depths = np.diff(np.append(np.minimum(tops, z), z))
        table = np.array([delay(v, depths[depths > 0], np.asarray(speeds)[depths > 0]) for v in np.unique(np.abs(u - x))])
        return table[np.searchsorted(np.unique(np.abs(u - x)), np.abs(u - x))]

    t = 2 * near / C + np.arange(samples) / fs
    late = times(*target)
    sine = np.abs(np.gradient(late, u)) * speeds[0] / 2  # the slope of the arrival is 2 sin(angle)/c at the track
    beam = np.where(sine < np.sin(half_angle), np.cos(np.pi / 2 * sine / np.sin(half_angle)) ** 2, 0)[:, None]
    sigma = 6.8 / (np.pi * band)
    data = beam * np.exp(-((t - late[:, None]) ** 2) / (2 * sigma**2) - 2j * np.pi * fc * late[:, None])
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    echoes = pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=tx, c=C, t0=2 * near / C, bandwidth=band)

    def back_projection(x, z):
        found = np.zeros((len(z), len(x)), complex)
        for i, depth in enumerate(z):
            for j, place in enumerate(x):
                tau = times(place, depth)
                pulse = np.exp(-((tau - late) ** 2) / (2 * sigma**2)) * np.exp(2j * np.pi * fc * (tau - late))
                found[i, j] = np.sum(beam[:, 0] * pulse)
        return found

    return echoes, back_projection


@pytest.mark.parametrize(
    ("tops", "speeds", "depth", "half_angle"),
    [
        ((0.0, 1.2), (1500.0, 1300.0), 2.5, 0.15),
        ((0.0, 1.0, 1.6), (1500.0, 1560.0, 1480.0), 2.5, 0.15),
        ((0.0, 1.2), (1500.0, 150.0), 1.5, 0.15),  # 10 : 1 down: rays straighten
        ((0.0, 1.2), (1500.0, 15000.0), 3.2, 0.03),  # 1 : 10: 17 degrees from 1.7
    ],
)
def test_layers_against_delays_by_snells_law(tops, speeds, depth, half_angle):
    u = even(120)
    first = delay(0.0, np.diff(np.append(tops, depth)), speeds) * C / 2
    echoes, back_projection = layered((0.0, depth), tops, speeds, u, half_angle, first - 0.5, 50)
    cell = 0.02 * speeds[-1] / C
    z = depth + cell * np.arange(-4, 5)
    grid = pysas.Grid.plane(u[44:77:4], z)
    layers = list(zip(tops, speeds, strict=True))
    image = one_way(echoes, grid, layers=layers, half_angle=half_angle, threads=1)
    direct = back_projection(grid.axes["x"], z)
    # the sum over pings grows with the root of sum(depth speed) over layers, by its stationary phase; one factor is fitted
    tips = np.array([[max(v - top, 0.0) for top in (*tops, np.inf)] for v in z])
    data = image.data * np.sqrt(-np.diff(tips, axis=1) @ speeds)[:, None]
    factor = np.vdot(data, direct) / np.vdot(data, data)
    assert pysas.metrics.relative_error(factor * data, direct) < 0.015
    row, column = np.unravel_index(np.argmax(np.abs(data)), data.shape)
    assert (row, column) == (4, 4)
    # with one speed it is elsewhere
    wrong = one_way(echoes, pysas.Grid.plane(u[60:61], first - 0.2 + 0.02 * np.arange(21)), half_angle=half_angle, threads=1)
    assert abs(wrong.grid.axes["y"][np.argmax(np.abs(wrong.data))] - first) < 0.03 and abs(first - depth) > 0.005


def test_speed_that_varies_along_the_track():
    # a lens in the first 5 cm: rays cross it where they start, so that it delays each ping on its own
    u = even(300)
    lens = C / (1 + 0.02 * np.sin(2 * np.pi * u / 1.3))
    late = 2 * 0.05 * (1 / lens - 1 / C)
    straight = scenes.smooth(((0.0, 8.0),), u, fc=100e3, band=15e3, fs=20e3, near=7.5, samples=40, width=0.15)
    t = 2 * 7.5 / C + np.arange(40) / 20e3
    away = np.hypot(8.0, u)[:, None]
    sigma, sine = 6.8 / (np.pi * 15e3), np.abs(u)[:, None] / away
    beam = np.where(sine < 0.15, np.cos(np.pi / 2 * sine / 0.15) ** 2, 0)
    tau = 2 * away / C + late[:, None]
    echoes = straight.replace(data=beam * np.exp(-((t - tau) ** 2) / (2 * sigma**2) - 2j * np.pi * 100e3 * tau))
    grid = pysas.Grid.plane(u[120:180], 7.85 + 0.0125 * np.arange(24))
    ideal = one_way(straight, grid, half_angle=0.15, threads=1)
    blind = one_way(echoes, grid, half_angle=0.15, threads=1)
    seen = one_way(echoes, grid, half_angle=0.15, layers=[(0.0, lens), (0.05, C)], threads=1)
    # a ray at 0.15 moves 7.5 mm along the lens: 2 pi fc 2 x 0.05/C x 0.02 x (2 pi/1.3) x 3.75 mm = 0.015 rad
    assert pysas.metrics.relative_error(seen.data, ideal.data) < 0.015
    assert pysas.metrics.relative_error(blind.data, ideal.data) > 0.3
    back = echoes.replace(data=echoes.data[::-1], tx=echoes.tx[::-1], rx=echoes.rx[::-1])
    again = one_way(back, grid, half_angle=0.15, layers=[(0.0, lens[::-1]), (0.05, C)], threads=1)
    np.testing.assert_allclose(again.data, seen.data, rtol=0, atol=1e-9 * np.abs(seen.data).max())


def test_sub_domains_add_up(narrow):
    grid = pysas.Grid.plane(even(300)[50:250], 7.6 + 0.0375 * np.arange(12))
    whole = one_way(narrow, grid, half_angle=0.15, threads=1)
    peak = np.abs(whole.data).max()
    errors = {}
    for overlap in (None, 24, 0):
        found = one_way(narrow, grid, half_angle=0.15, domains=3, overlap=overlap, threads=2)
        errors[overlap] = np.abs(found.data - whole.data).max() / peak
        assert found.report.choices["domains"] == 3
    # silence beside each part lets waves leave: what differs is what crosses the ends of its margins
    assert errors[None] < 1e-4 and errors[24] < 0.5
    assert errors[24] > errors[None]


# Extremes


def test_one_trace_is_its_own_image(narrow):
    one = narrow.replace(data=narrow.data[150:151], tx=narrow.tx[150:151], rx=narrow.rx[150:151])
    image = one_way(one, weight="flat", threads=1)
    assert image.data.shape == (60, 1)
    # the record cuts the first point's pulse at 2e-5 of its peak
    assert against_exact(image, one) < 2e-5
    carrier = one_way(one, form="carrier", threads=1)
    assert against_exact(carrier, one) < 2e-5


def test_records_shorter_than_the_image(narrow):
    grid = pysas.Grid.plane(even(300)[100:200], np.concatenate([5.0 + 0.5 * np.arange(5), 7.6 + 0.05 * np.arange(60)]))
    short = narrow.replace(data=narrow.data[:, :25])
    silent = narrow.replace(data=np.pad(short.data, ((0, 0), (0, 60))))
    found, wanted = (one_way(e, grid, half_angle=0.15, threads=1) for e in (short, silent))
    assert pysas.metrics.relative_error(found.data, wanted.data) < 0.01
    peak = np.abs(found.data).max()
    assert np.abs(found.data[grid.axes["y"] > 9.0]).max() < 0.02 * peak
    assert np.abs(found.data[grid.axes["y"] < 6.6]).max() < 0.02 * peak


@pytest.mark.parametrize("form", ["base-band", "carrier"])
def test_evanescent_energy_is_not_imaged(form):
    # pings every c/(8 fc): k_x dx reaches pi where 2k dx is pi/2
    u, rng = even(64, 0.025), np.random.default_rng(0)
    noise = rng.standard_normal(40) + 1j * rng.standard_normal(40)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    window = np.kaiser(64, 20)[:, None]

    def largest(along):
        data = window * along[:, None] * noise
        echoes = pysas.Echoes(data, fs=5e3, fc=7500.0, tx=tx, rx=tx, c=C, t0=2e-3, bandwidth=4e3)
        grid = pysas.Grid.plane(u, 2 + 0.1 * np.arange(20))
        return np.abs(one_way(echoes, grid, form=form, margin=0, half_angle=0.3, threads=1).data).max()

    assert largest(np.exp(1j * np.pi * np.arange(64))) < 1e-5 * largest(np.ones(64))


def test_pings_too_far_apart_are_said(narrow, low):
    grid = pysas.Grid.plane([0.0], [7.8, 7.9])
    # pi, 1.6 and 0.8 over k sin(half-angle) with k = 4 pi 107.5 kHz/1500
    for half_angle, arguments, message in (
        (0.5, {}, r"0\.01 m: the march carries 3\.14/k_x, at most 0\.007276 m for a half-angle of 28\.6 degrees"),
        (0.1, {"correction": "none"}, r"the march carries 0\.8/k_x, at most 0\.008898 m"),
    ):
        with pytest.warns(UserWarning, match=message):
            one_way(narrow, grid, half_angle=half_angle, step=0.1, margin=0, threads=1, **arguments)
    with pytest.warns(UserWarning, match=r"the march carries 1\.6/k_x, at most 0\.04193 m for a half-angle of 28\.6 degrees"):
        one_way(low, grid, form="carrier", half_angle=0.5, step=0.0125, margin=0, threads=1)


@pytest.mark.parametrize("form", ["base-band", "carrier"])
def test_single_precision_does_not_drift(form):
    points = ((0.0, 4.0),)
    echoes = scenes.smooth(points, even(40, 0.05), fc=7500, band=4000, fs=5e3, near=3.0, samples=24, width=0.25)
    grid = pysas.Grid.plane(even(40, 0.05), 3.7 + 0.05 * np.arange(12))
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    layers = [(0.0, C), (0.01, C)] if form == "base-band" else None
    step = 0.004 if form == "base-band" else 0.0125
    found = [one_way(e, grid, form=form, half_angle=0.25, step=step, layers=layers, threads=1) for e in (single, echoes)]
    assert found[0].data.dtype == np.complex64
    # a thousand steps of rounding 6e-8
    assert pysas.metrics.relative_error(found[0].data, found[1].data) < 3e-5
    many = one_way(single, grid, form=form, half_angle=0.25, step=step, layers=layers, threads=3)
    np.testing.assert_array_equal(many.data, found[0].data)


def test_what_it_refuses(narrow):
    grid = pysas.Grid.plane([0.0], [7.6, 7.7])
    for arguments, message in (
        ({"angle": 30}, "angle=30: expected 15, 45, 65 or a pair"),
        ({"angle": (0.5, 1.0)}, "angle="),
        ({"scheme": "euler"}, "scheme='euler'"),
        ({"scheme": "rk4"}, "scheme='rk4'"),
        ({"form": "carrier", "scheme": "euler", "correction": "both"}, "correction='both'"),
        ({"form": "carrier", "layers": [(0.0, C), (1.0, C)]}, "layers: expected None"),
        ({"form": "carrier", "step": 0.004}, "step=0.004 m: expected less than half"),
        ({"layers": [(1.0, C)]}, r"layers\[0\]: top 1 m"),
        ({"layers": [(0.0, C), (0.0, C)]}, r"layers\[1\]"),
        ({"layers": [(0.0, -C)]}, r"layers\[0\]=-1500"),
        ({"layers": [(0.0, np.full(4, C))]}, r"layers\[0\]: expected shape \(300,\)"),
        ({"layers": [(0.0, C), (1.0, C)], "weight": "backprojection"}, "weight='backprojection'"),
        ({"half_angle": 2.0}, "half_angle=2.0"),
        ({"step": 0.0}, "step=0.0"),
        ({"margin": -1}, "margin=-1"),
        ({"domains": 301}, "domains=301"),
    ):
        with pytest.raises(ValueError, match=message):
            one_way(narrow, grid, threads=1, **arguments)
    with pytest.raises(TypeError, match="layers=3"):
        one_way(narrow, grid, layers=3)
    with pytest.raises(ValueError, match=r"grid: x=0.004 m at column 0: expected the x of a ping"):
        one_way(narrow, pysas.Grid.plane([0.004], [7.6]))
    with pytest.raises(ValueError, match="on the sonar's side"):
        one_way(narrow, pysas.Grid.plane([0.0], [-7.6]))
    with pytest.raises(ValueError, match="height 1 m"):
        one_way(narrow, pysas.Grid.plane([0.0], [7.6], z=1.0))
    with pytest.raises(TypeError, match="grid="):
        one_way(narrow, pysas.Grid.points([[0.0, 7.6, 0.0]]))
    with pytest.raises(TypeError, match="echoes=int"):
        one_way(3)
