"""Lines of a height map's pixels read whole from sub-images: each ping's array sees heights alike, and its own delays."""

import answers
import numpy as np
import pytest

import pysas
from pysas.engine import cpp, native

pytestmark = pytest.mark.skipif(native.extension() is None, reason="needs the compiled extension pysas.engine._core")
FS, FC, BAND, C = 36e3, 100e3, 30e3, 1500.0
TOLS = (1e-2, 3e-3, 1e-3)


@pytest.fixture(autouse=True)
def trees_always(monkeypatch):
    """Scenes here are small: whether trees pay is another question."""
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", False)


def turned(angle, places):
    c, s = np.cos(angle), np.sin(angle)
    return places @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def survey(
    angle=0.0, crab=0.0, offset=(0.0, 0.0, 0.0), beam=(0.2, 0.5), sway=0.05, side=1.0, pings=8, channels=24, pitch=0.0, look=0.0
):  # fmt: skip
    """Noise of the band, heard by an array whose axis is `crab` rad off the track and `pitch` up, its transmitter beside it.

    `beam` : half-angle and taper of fans that look `look` rad off the track's normal.
    """
    rng = np.random.default_rng(5)
    x = 0.025 * channels * (np.arange(pings) - (pings - 1) / 2)
    place = np.stack([x, sway * np.sin(2 * x), 6 + 0.03 * np.cos(3 * x)], axis=1)
    axis = turned(crab, np.array([np.cos(pitch), 0, np.sin(pitch)]))
    rx = place[:, None] + 0.05 * (np.arange(channels) - (channels - 1) / 2)[:, None] * axis
    samples = 1000
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    light = None
    if beam:
        way = angle + crab + look
        light = pysas.Beam(
            turned(way, np.array([0, side, 0])), 0.1, beam[0], "fan", beam[1], turned(way, np.array([1.0, 0, 0]))
        )  # fmt: skip
    velocity = np.gradient(place, 0.25, axis=0) if pings > 1 else np.array([[0.1 * channels, 0.05, 0.0]])
    return pysas.Echoes(
        np.fft.ifft(data).astype(np.complex64), fs=FS, fc=FC, tx=turned(angle, place + np.array(offset)),
        rx=turned(angle, rx), c=C, t0=0.026, bandwidth=BAND, velocity=turned(angle, velocity), beam=light,
    )  # fmt: skip


X, Y = np.arange(-2.0, 2.0, 0.03), np.arange(24.0, 32.0, 0.03)


def heights(kind, x, y):
    waves = 0.8 * np.sin(0.5 * x)[None, :] * np.cos(0.4 * y)[:, None] + 0.04 * np.sin(2.1 * y)[:, None]
    if kind == "gentle":
        waves = 0.2 * waves
    if kind == "rough":
        waves = waves + 0.02 * np.random.default_rng(3).standard_normal((len(y), len(x)))
    if kind == "steps":
        waves = waves + 0.6 * (x > 0.3) - 0.5 * (y[:, None] > 27)
    return waves


def ground(kind, angle=0.0, side=1.0, across=False):
    y = Y if side > 0 else -Y[::-1]
    z = heights(kind, X, y)
    if angle == 0 and not across:
        return pysas.Grid.surface(X, y, z)
    points = np.stack([*np.broadcast_arrays(X, y[:, None]), z], axis=-1)
    points = points.transpose(1, 0, 2) if across else points
    return pysas.Grid.points(turned(angle, points))


def wrong(image, echoes, grid):
    pixels = np.random.default_rng(0).choice(grid.size, 500, replace=False)
    exact, level = answers.exact(echoes, grid, pixels)
    return np.linalg.norm(image.data.ravel()[pixels] - exact) / max(np.linalg.norm(exact), np.linalg.norm(level))


def along(plan):
    """Share of reads along lines that a plan tells of."""
    told = [line for line in str(plan).splitlines() if line.endswith("of the reads along lines")]
    return float(told[0].split(";")[1].split("%")[0]) / 100 if told else 0.0


def check(echoes, grid, least):
    shares = []
    for tol in TOLS:
        plan = pysas.plan(echoes, grid, tol, "ffbp", backend="cpp")
        assert wrong(plan(echoes.data), echoes, grid) <= tol
        shares.append(along(plan))
    assert max(shares) >= least


@pytest.mark.parametrize("isa", native.core().levels() if native.extension() else ["not built"])
@pytest.mark.parametrize("kind", ["smooth", "rough", "steps"])
def test_heights_of_every_kind(kind, isa, monkeypatch):
    monkeypatch.setenv("PYSAS_ISA", isa)
    check(survey(), ground(kind), 0.5)


@pytest.mark.parametrize(
    ("crab", "kind", "least"), [(0.01, "gentle", 0.5), (0.01, "smooth", 0.0), (0.05, "gentle", 0.0), (0.15, "smooth", 0.0)]
)
def test_arrays_askew_of_the_lines(crab, kind, least):
    """Heights turn what such an array sees: lines are read between their lowest and their highest heights, or not."""
    check(survey(crab=crab), ground(kind), least)


@pytest.mark.parametrize(
    ("offset", "least"), [((0.3, 0.4, 0.2), 0.5), ((0.0, 0.0, 1.0), 0.0), ((-2.0, 0.1, 0.0), 0.5), ((0.1, 1.5, 3.0), 0.0)]
)
def test_transmitters_beside_the_array(offset, least):
    """What it is off by changes with height alone as its own delay does, whatever the way."""
    check(survey(offset=offset), ground("smooth"), least)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rows_of_points_any_way(angle, across, side):
    check(survey(angle, side=side), ground("smooth", angle, side, across), 0.5)


@pytest.mark.parametrize("pings", [1, 8])
def test_without_a_beam(pings):
    check(survey(beam=None, pings=pings), ground("smooth"), 0.0)


def test_sway_and_heave_of_receivers_that_move():
    """Receivers that move across the axis while echoes travel are where their own delay says."""
    check(survey(sway=0.3), ground("smooth"), 0.5)


def test_masks_and_threads():
    echoes = survey()
    mask = np.ones((Y.size, X.size), dtype=bool)
    mask[17:150, 40:90] = False
    grid = pysas.Grid.surface(X, Y, heights("rough", X, Y), mask=mask)
    one, two = (pysas.ffbp(echoes, grid, 1e-2, threads=threads, backend="cpp") for threads in (1, 2))
    assert np.array_equal(one.data, two.data) and not one.data[~mask].any() and one.report.factorised_share > 0.5


@pytest.mark.parametrize("tilt", [(0.002, 0.0), (0.02, -0.03)])
@pytest.mark.parametrize("points", [False, True])
def test_tilted_planes(tilt, points, monkeypatch):
    """Rows of a tilted plane are straight and have no heights of their own: lines of its pixels are not a plane's."""
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", True)
    z = tilt[0] * (Y - 28)[:, None] + tilt[1] * X
    grid = pysas.Grid.surface(X, Y, z)
    if points:
        grid = pysas.Grid.points(np.stack([*np.broadcast_arrays(X, Y[:, None]), z], axis=-1))
    echoes = survey(channels=64, pings=12)
    for tol in TOLS:
        for fits in (pysas.focus, pysas.ffbp):
            assert wrong(fits(echoes, grid, tol, backend="cpp"), echoes, grid) <= tol


@pytest.mark.parametrize("pitch", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("rough", [0.01, 0.05])
def test_pitched_arrays_over_rough_ground(pitch, rough):
    """An axis that rises turns with heights themselves."""
    z = rough * np.sign(np.random.default_rng(2).standard_normal((Y.size, X.size)))
    grid = pysas.Grid.surface(X, Y, z)
    for channels in (24, 48):
        check(survey(pitch=pitch, channels=channels, pings=2), grid, 0.0)


@pytest.mark.parametrize("crab", [0.1, 0.2, 0.27])
@pytest.mark.parametrize("slope", [-0.5, 0.5, 0.8, 0.95])
def test_slopes_that_face_an_array_askew(crab, slope):
    """A line up such a slope is seen shorter along the ray and not beside it, so that it crosses more rays."""
    y, x = np.arange(60.0, 63.0, 0.01), np.arange(-0.3, 0.3, 0.01)
    z = slope * (y - 61.5)[:, None] + 0.003 * np.random.default_rng(1).standard_normal((y.size, x.size)) - 24
    across = 60 * np.tan(crab)
    echoes = survey(crab=crab, channels=3, pings=1, beam=None).replace(t0=2 * 62.0 / C)
    grid = pysas.Grid.surface(x - across, y, z)
    for tol in (0.1, 0.03, 1e-2):
        assert wrong(pysas.ffbp(echoes, grid, tol, backend="cpp"), echoes, grid) <= tol


@pytest.mark.parametrize("look", [-0.7, 0.0, 0.5])
@pytest.mark.parametrize("taper", [0.0, 0.1])
def test_fans_that_look_ahead(look, taper):
    """Where a fan looks ahead its channels differ by more: what one plane serves is less."""
    middle = -28 * np.tan(look)
    z = heights("smooth", X, Y)
    grid = pysas.Grid.surface(X + middle, Y, z)
    echoes = survey(offset=(0.0, 0.0, -4.0), beam=(0.1, taper), look=look, channels=64, pings=2)
    check(echoes.replace(t0=2 * 26 / np.cos(look) / C), grid, 0.0)


@pytest.mark.parametrize("offset", [(0.0, 16.0, 0.0), (0.0, 18.0, -3.0), (0.0, -8.0, 4.0), (6.0, 0.5, 0.0)])
def test_transmitters_far_from_the_array(offset):
    check(survey(offset=offset, beam=None, pings=2, channels=6), ground("gentle"), 0.0)


def test_steep_ground():
    """Where ranges do not grow along a line it has no bearing to follow, and none is read."""
    z = 0.8 * (Y - 28)[:, None] + 3.0 * np.sin(2.0 * Y)[:, None] + 0 * X
    grid = pysas.Grid.surface(X, Y, z)
    check(survey(), grid, 0.0)
    assert along(pysas.plan(survey(), grid, 1e-2, "ffbp", backend="cpp")) == 0
