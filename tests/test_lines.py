"""Lines of pixels read whole from sub-images, whichever way they lie; pings weighed as they are merged."""

import answers
import numpy as np
import pytest

import pysas
from pysas.engine import cpp, native

needs_extension = pytest.mark.skipif(native.extension() is None, reason="needs the compiled extension pysas.engine._core")
pytestmark = needs_extension
FS, FC, BAND, C = 36e3, 100e3, 30e3, 1500.0
TOLS = (1e-2, 1e-3, 1e-4)


@pytest.fixture(autouse=True)
def trees_always(monkeypatch):
    """Scenes here are small: whether trees pay is another question."""
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", False)


def turned(angle, places):
    """Places or directions (..., 3) turned about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return places @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def survey(angle=0.0, side=1.0, beam=None, pings=10, channels=8, samples=1100, dtype=np.complex64):
    """Noise of the band, heard by an array that moves along x and looks along +-y, all turned by `angle`."""
    rng = np.random.default_rng(5)
    x = 0.025 * channels * (np.arange(pings) - (pings - 1) / 2)
    tx = np.stack([x, 0.03 * np.sin(2 * x), 4 + 0.02 * np.cos(3 * x)], axis=1)
    rx = tx[:, None] + 0.05 * (np.arange(channels) - (channels - 1) / 2)[:, None] * np.array([1.0, 0, 0])
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    light = None
    if beam is not None:
        look, along = turned(angle, np.array([0.0, side, 0.0])), turned(angle, np.array([1.0, 0.0, 0.0]))
        light = pysas.Beam(look, 0.1, beam, "fan", 0.6, along)
    velocity = np.tile(turned(angle, np.array([0.1 * channels, 0, 0])), (pings, 1))
    return pysas.Echoes(
        np.fft.ifft(data).astype(dtype), fs=FS, fc=FC, tx=turned(angle, tx), rx=turned(angle, rx), c=C, t0=0.026,
        bandwidth=BAND, velocity=velocity, beam=light,
    )  # fmt: skip


X, Y = np.arange(-2.0, 2.0, 0.03), np.arange(24.0, 30.0, 0.03)


def rows(x, y, angle=0.0):
    """The plane's points turned, in rows of which each lies on a line."""
    return pysas.Grid.points(turned(angle, pysas.Grid.plane(x, y).coordinates()).reshape(len(y), len(x), 3))


def wrong(image, echoes, grid):
    pixels = np.random.default_rng(0).choice(grid.size, min(grid.size, 500), replace=False)
    exact, level = answers.exact(echoes, grid, pixels)
    return np.linalg.norm(image.data.ravel()[pixels] - exact) / max(np.linalg.norm(exact), np.linalg.norm(level))


def along(plan):
    """Share of reads along lines that a plan tells of."""
    told = [line for line in str(plan).splitlines() if line.endswith("of the reads along lines")]
    return float(told[0].split(";")[1].split("%")[0]) / 100 if told else 0.0


def check(echoes, grid, least=0.3, tols=TOLS):
    shares = []
    for tol in tols:
        plan = pysas.plan(echoes, grid, tol, "ffbp", backend="cpp")
        assert wrong(plan(echoes.data), echoes, grid) <= tol
        shares.append(along(plan))
    assert max(shares) >= least
    return shares


WANTED = np.ones((Y.size, X.size), dtype=bool)
WANTED[17:150, 40:90] = False
GRIDS = {
    "columns": (0.0, 1.0, lambda: pysas.Grid.plane(X, Y)),
    "columns toward the track": (0.0, -1.0, lambda: pysas.Grid.plane(X, -Y[::-1])),
    "lines": (-np.pi / 2, 1.0, lambda: pysas.Grid.plane(Y, X)),
    "lines toward the track": (np.pi / 2, 1.0, lambda: pysas.Grid.plane(-Y[::-1], X)),
    "columns of a turned grid": (0.5, 1.0, lambda: rows(X, Y, 0.5)),
    "columns askew": (0.12, 1.0, lambda: pysas.Grid.plane(X - 2.5, Y)),
    "one line more than tiles": (0.0, 1.0, lambda: pysas.Grid.plane(X[:65], Y[:177])),
    "fine along the range": (0.0, 1.0, lambda: pysas.Grid.plane(X[::2], np.arange(25, 28, 0.007))),
    "masked": (0.0, 1.0, lambda: pysas.Grid.plane(X, Y, mask=WANTED)),
}


@pytest.mark.parametrize("beam", [None, 0.2])
@pytest.mark.parametrize("name", GRIDS)
def test_lines_lie_any_way(name, beam):
    angle, side, make = GRIDS[name]
    check(survey(angle, side, beam), make())


@pytest.mark.parametrize("name", ["columns", "lines toward the track"])
def test_masks_and_doubles(name):
    angle, side, make = GRIDS[name]
    echoes, grid = survey(angle, side, 0.2), make()
    image = pysas.ffbp(echoes, grid, 1e-3, backend="cpp").data
    double = pysas.ffbp(survey(angle, side, 0.2, dtype=np.complex128), grid, 1e-3, backend="cpp").data
    assert np.linalg.norm(double - image) < 1e-5 * np.linalg.norm(image)
    wanted = np.random.default_rng(1).random(grid.shape) < 0.5
    x, y = grid.axes["x"], grid.axes["y"]
    masked = pysas.ffbp(echoes, pysas.Grid.plane(x, y, mask=wanted), 1e-3, backend="cpp").data
    assert np.all(masked[~wanted] == 0)
    assert np.linalg.norm((masked - image)[wanted]) < 2e-3 * np.linalg.norm(image[wanted])


def test_pixels_far_apart_along_the_range_are_read_one_by_one():
    """Nodes between them would be read for nothing."""
    echoes, grid = survey(), pysas.Grid.plane(X, np.arange(24, 34, 0.12))
    plan = pysas.plan(echoes, grid, 1e-2, "ffbp", backend="cpp")
    assert plan(echoes.data).report.factorised_share > 0.5
    assert along(plan) == 0
    assert wrong(plan(echoes.data), echoes, grid) <= 1e-2


def test_a_turned_grid_has_no_lines_that_lead_away():
    echoes = survey(samples=1300)
    grid = rows(X, Y - 27, np.pi / 4)
    grid = pysas.Grid.points(grid.coordinates().reshape(Y.size, X.size, 3) + [0, 28.0, 0])
    plan = pysas.plan(echoes, grid, 1e-2, "ffbp", backend="cpp")
    assert along(plan) == 0
    assert wrong(plan(echoes.data), echoes, grid) <= 1e-2


@pytest.mark.parametrize(("pings", "channels"), [(8, 32), (24, 12), (60, 4), (3, 70), (1, 90)])
@pytest.mark.parametrize("half_angle", [0.08, 0.3])
def test_pings_are_weighed_as_they_are_merged(pings, channels, half_angle):
    echoes = survey(0.0, 1.0, half_angle, pings, channels)
    check(echoes, pysas.Grid.plane(X, Y), least=0.0)


@pytest.mark.parametrize("beam", [None, 0.3])
@pytest.mark.parametrize("turn", [0.0, np.pi / 2, 0.3])
def test_images_on_both_sides_and_all_round(beam, turn):
    """The widest gap between bearings may lie about a line's direction, where no ray is."""
    echoes = survey(turn, 1.0, beam, pings=3, samples=2000).replace(t0=0.008)
    echoes = echoes.replace(tx=echoes.tx + [0, 0, 10.0], rx=echoes.rx + [0, 0, 10.0])
    axis = np.arange(-30.0, 30.0, 0.04)
    wanted = np.abs(np.stack(np.meshgrid(axis, axis))).max(axis=0) >= 9  # not what is near the track
    for mask in (wanted, wanted & (np.abs(axis) >= 4)[:, None], wanted & (np.abs(axis) >= 4)):
        grid = pysas.Grid.plane(axis, axis, mask=mask)
        plan = pysas.plan(echoes, grid, 1e-2, "ffbp", backend="cpp")
        image = plan(echoes.data)
        assert along(plan) > 0.1 or beam is not None
        pixels = np.random.default_rng(0).choice(np.flatnonzero(mask), 400, replace=False)
        exact, level = answers.exact(echoes, grid, pixels)
        off = np.linalg.norm(image.data.ravel()[pixels] - exact)
        assert off <= 1e-2 * max(np.linalg.norm(exact), np.linalg.norm(level))


@pytest.mark.parametrize("tol", [1e-3, 1e-4])
def test_lines_near_a_group_high_above(tol):
    """There bearings turn too fast along a line for polynomials: what they miss is in the budget."""
    echoes = survey(pings=4, channels=4, samples=500).replace(t0=0.02)
    echoes = echoes.replace(tx=echoes.tx + [0, 0, 14.0], rx=echoes.rx + [0, 0, 14.0])
    grid = pysas.Grid.plane(np.arange(-1.5, 1.5, 0.02), np.arange(5.0, 9.0, 0.02))
    assert wrong(pysas.ffbp(echoes, grid, tol, backend="cpp"), echoes, grid) <= tol


def test_threads_agree():
    echoes, grid = survey(0.0, 1.0, 0.2), pysas.Grid.plane(X, Y)
    assert along(pysas.plan(echoes, grid, 1e-3, "ffbp", backend="cpp")) > 0.3
    one = pysas.ffbp(echoes, grid, 1e-3, backend="cpp", threads=1).data
    assert np.array_equal(one, pysas.ffbp(echoes, grid, 1e-3, backend="cpp", threads=3).data)
