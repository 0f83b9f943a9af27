"""Lines of a height map's pixels read whole from sub-images: each ping's array sees heights alike, and its own delays."""

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


def survey(angle=0.0, crab=0.0, offset=(0.0, 0.0, 0.0), beam=True, sway=0.05, side=1.0, pings=8, channels=24):
    """Noise of the band, heard by an array whose axis is `crab` rad off the track and whose transmitter lies beside it."""
    rng = np.random.default_rng(5)
    x = 0.025 * channels * (np.arange(pings) - (pings - 1) / 2)
    place = np.stack([x, sway * np.sin(2 * x), 6 + 0.03 * np.cos(3 * x)], axis=1)
    axis = turned(crab, np.array([1.0, 0, 0]))
    rx = place[:, None] + 0.05 * (np.arange(channels) - (channels - 1) / 2)[:, None] * axis
    samples = 1000
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    light = None
    if beam:
        light = pysas.Beam(turned(angle, turned(crab, np.array([0, side, 0]))), 0.1, 0.2, "fan", 0.5, turned(angle, axis))
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
    exact, level = pysas.reference.exact(echoes, grid, pixels)
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
    check(survey(beam=False, pings=pings), ground("smooth"), 0.0)


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


def test_steep_ground_is_not_read_along_lines():
    """Where ranges do not grow along a line it has no bearing to follow."""
    z = 0.8 * (Y - 28)[:, None] + 3.0 * np.sin(2.0 * Y)[:, None] + 0 * X
    check(survey(), pysas.Grid.surface(X, Y, z), 0.0)
