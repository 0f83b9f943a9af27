"""Height maps summed along lines: delays and weights are polynomials along a line and in the height off it."""

from concurrent.futures import ThreadPoolExecutor

import answers
import numpy as np
import pytest

import pysas
from pysas.engine import cpp, native

pytestmark = pytest.mark.skipif(native.extension() is None, reason="needs the compiled extension pysas.engine._core")
FS, FC, BAND, C = 36e3, 100e3, 30e3, 1500.0
X, Y = np.arange(-2.0, 2.0, 0.025), np.arange(12.0, 15.0, 0.03)
SETS = native.core().levels() if native.extension() else ["not built"]


@pytest.fixture(params=SETS)
def isa(request, monkeypatch):
    monkeypatch.setenv("PYSAS_BACKEND", "cpp")
    monkeypatch.setenv("PYSAS_ISA", request.param)


def heights(kind, x, y):
    """Of a slope with waves, of the same with ripples of the pixels' size, or of steps."""
    waves = 0.3 * np.sin(0.9 * x)[None, :] * np.cos(0.7 * y)[:, None] + 0.05 * x - 0.1 * (y[:, None] - 13)
    if kind == "rough":
        return waves + 0.02 * np.random.default_rng(3).standard_normal((len(y), len(x)))
    if kind == "steps":
        return waves + 0.8 * (x > 0.3) - 0.5 * (y[:, None] > 13.5)
    return waves


def survey(beam=None, velocity=True, pings=12, channels=6, samples=700, dtype=np.complex64, yaw=0.02):
    """Noise of the band, heard by a swaying array that yaws."""
    rng = np.random.default_rng(5)
    x = 0.15 * (np.arange(pings) - (pings - 1) / 2)
    turn = yaw * np.sin(3 * x)
    axis = np.stack([np.cos(turn), np.sin(turn), np.zeros(pings)], axis=1)
    tx = np.stack([x, 0.03 * np.sin(2 * x), 4 + 0.02 * np.cos(3 * x)], axis=1)
    rx = tx[:, None] + 0.05 * (np.arange(channels) - (channels - 1) / 2)[:, None] * axis[:, None]
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    light = None
    if beam is not None:
        shape, taper, half = beam
        look = np.stack([-np.sin(turn), np.cos(turn), np.full(pings, -0.2)], axis=1)
        light = pysas.Beam(look, 0.05, half, shape, taper, axis if shape == "fan" else None)
    return pysas.Echoes(
        np.fft.ifft(data).astype(dtype), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=0.0145, bandwidth=BAND, beam=light,
        velocity=np.tile([0.6, 0.02, 0.0], (pings, 1)) if velocity else None,
    )  # fmt: skip


def wrong(image, echoes, grid):
    """Relative error by the oracle, which takes each pixel's own delay in float64."""
    pixels = np.random.default_rng(0).choice(grid.size, 600, replace=False)
    exact, level = answers.exact(echoes, grid, pixels)
    return np.linalg.norm(image.data.ravel()[pixels] - exact) / max(np.linalg.norm(exact), np.linalg.norm(level))


BEAMS = {
    "none": None,
    "fan": ("fan", 0.5, 0.12),
    "fan, hard edge": ("fan", 0.0, 0.08),
    "fan, all taper": ("fan", 1.0, 0.1),
    "cone": ("cone", 0.5, 0.3),
}


@pytest.mark.parametrize("beam", BEAMS)
@pytest.mark.parametrize("kind", ["smooth", "rough", "steps"])
@pytest.mark.parametrize("tol", [1e-2, 1e-3, 1e-4, 1e-5])
def test_every_tol_is_kept(tol, kind, beam, isa):
    echoes, grid = survey(BEAMS[beam]), pysas.Grid.surface(X, Y, heights(kind, X, Y))
    plan = pysas.plan(echoes, grid, tol, "backprojection")
    assert plan.choices.block > 8 and "heights" in plan.choices.errors
    assert wrong(plan(echoes.data), echoes, grid) <= tol


@pytest.mark.parametrize("rough", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("tol", [1e-2, 1e-3])
def test_windows_of_coefficients_reach_as_far_as_heights_do(tol, rough, isa):
    """Neighbours that differ by many intervals of a table, whose delays turn along the line and with height."""
    x, y = np.arange(-8.0, 8.0, 0.05), np.arange(24.0, 32.0, 0.25)
    echoes = survey(("fan", 0.5, 0.4), samples=1100).replace(t0=0.03)
    grid = pysas.Grid.surface(x, y, -2 + rough * np.random.default_rng(4).uniform(-1, 1, (len(y), len(x))))
    assert wrong(pysas.backproject(echoes, grid, tol), echoes, grid) <= tol


@pytest.mark.parametrize("beam", ["none", "fan", "cone"])
@pytest.mark.parametrize("tol", [1e-4, 1e-8])
def test_every_tol_is_kept_in_complex128(tol, beam, isa):
    echoes, grid = survey(BEAMS[beam], dtype=np.complex128), pysas.Grid.surface(X, Y, heights("rough", X, Y))
    assert wrong(pysas.backproject(echoes, grid, tol), echoes, grid) <= tol


@pytest.mark.parametrize("kind", ["smooth", "rough"])
@pytest.mark.parametrize("height", [0.4, 3.0])
def test_pixels_close_below_the_track(kind, height, isa):
    """Down to 0.4 m, where no polynomial holds, over records that end among the pixels."""
    y = np.arange(-0.5, 2.0, 0.03)
    echoes = survey().replace(t0=0.0)
    grid = pysas.Grid.surface(X, y, 4 - height - 0.3 + heights(kind, X, y))
    for tol in (1e-2, 1e-4):
        assert wrong(pysas.backproject(echoes, grid, tol), echoes, grid) <= tol


@pytest.mark.parametrize("slope", [1.5, 3.0, 5.0, 10.0])
@pytest.mark.parametrize("tol", [1e-2, 1e-3])
def test_slopes_make_lines_longer(tol, slope, isa):
    """The delay's polynomial holds for a line's own length, not for what that is from above."""
    y = np.arange(7.0, 9.0, 0.05)
    z = slope * X + 0.002 * np.sin(9 * X)[None, :] * np.cos(7 * y)[:, None]
    echoes, grid = survey(samples=1500).replace(t0=0.0), pysas.Grid.surface(X, y, z)
    assert wrong(pysas.backproject(echoes, grid, tol), echoes, grid) <= tol
    hills = pysas.Grid.surface(X, y, slope / 4 * np.sin(4 * X)[None, :] + 0 * y[:, None])
    assert wrong(pysas.backproject(echoes, hills, tol), echoes, hills) <= tol


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
def test_a_curtain_has_no_lines(tol, isa):
    """Rows that stand upright, unevenly."""
    n, y = 128, np.linspace(2, 5, 40)
    z = -8 + 8 * np.linspace(0, 1, n) ** 1.05
    places = np.stack([np.zeros((40, n)), np.repeat(y[:, None], n, 1), np.repeat(z[None], 40, 0)], axis=-1)
    echoes, grid = survey(samples=1500).replace(t0=0.0), pysas.Grid.points(places)
    assert wrong(pysas.backproject(echoes, grid, tol), echoes, grid) <= tol


@pytest.mark.parametrize(("tilt", "half"), [(1.0, 0.001), (0.6, 0.002), (0.6, 0.02)])
def test_fans_askew_of_the_ground(tilt, half, monkeypatch, isa):
    """Weights that turn with height; a term counts where it does in the oracle, whatever vectors are."""
    z = 4 + 0.04 * np.random.default_rng(4).uniform(-1, 1, (len(Y), len(X)))  # as high as the track: the fan lights some
    axis = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    echoes = survey().replace(beam=pysas.Beam([0.0, 1.0, 0.0], 0.05, half, "fan", 0.5, axis))
    grid = pysas.Grid.surface(X, Y, z)
    image = pysas.backproject(echoes, grid, 1e-2)
    assert wrong(image, echoes, grid) <= 1e-2
    monkeypatch.setenv("PYSAS_ISA", "baseline")
    assert image.report.terms == pysas.backproject(echoes, grid, 1e-2).report.terms


def test_points_in_rows_are_a_map(isa):
    """The same pixels, the same bits, as a map or as points; rows that run backwards too."""
    echoes, z = survey(BEAMS["fan"]), heights("rough", X, Y)
    grid = pysas.Grid.surface(X, Y, z)
    image = pysas.backproject(echoes, grid, 1e-3).data
    rows = grid.coordinates().reshape(*grid.shape, 3)
    assert np.array_equal(pysas.backproject(echoes, pysas.Grid.points(rows), 1e-3).data, image)
    back = pysas.Grid.points(np.ascontiguousarray(rows[:, ::-1]))
    assert "polynomials" in str(pysas.plan(echoes, back, 1e-3, "backprojection"))
    assert np.linalg.norm(pysas.backproject(echoes, back, 1e-3).data[:, ::-1] - image) <= 2e-3 * np.linalg.norm(image)


def test_a_level_map_is_a_plane(isa):
    echoes, plane = survey(BEAMS["fan"]), pysas.Grid.plane(X, Y, 0.25)
    image = pysas.backproject(echoes, pysas.Grid.surface(X, Y, np.full((len(Y), len(X)), 0.25)), 1e-3).data
    assert np.linalg.norm(image - pysas.backproject(echoes, plane, 1e-3).data) <= 1e-5 * np.linalg.norm(image)


def test_uneven_places_have_their_own_delays(isa):
    x = X + 0.004 * np.sin(40 * X)
    echoes, grid = survey(BEAMS["fan"]), pysas.Grid.surface(x, Y, heights("smooth", x, Y))
    assert "exact per pixel" in str(pysas.plan(echoes, grid, 1e-3, "backprojection"))
    assert wrong(pysas.backproject(echoes, grid, 1e-3), echoes, grid) <= 1e-3


def test_masks_strides_and_threads(isa):
    """A part of the pixels, an image whose rows do not follow each other, any number of threads."""
    echoes, z = survey(BEAMS["fan"]), heights("rough", X, Y)
    mask = np.random.default_rng(2).random(z.shape) < 0.3
    mask[:40] = False
    whole, grid = pysas.Grid.surface(X, Y, z), pysas.Grid.surface(X, Y, z, mask=mask)
    image = pysas.backproject(echoes, whole, 1e-3, threads=1).data
    room = np.full((len(Y), 2 * len(X)), 7, dtype=np.complex64)
    plan = pysas.plan(echoes, grid, 1e-3, "backprojection", threads=3)
    found = plan(echoes.data, room[:, ::2]).data
    assert not found[~mask].any() and np.all(room[:, 1::2] == 7)
    assert np.linalg.norm((found - image)[mask]) <= 2e-3 * np.linalg.norm(image[mask])
    assert np.array_equal(pysas.backproject(echoes, whole, 1e-3, threads=3).data, image)


@pytest.mark.parametrize("tol", [1e-2, 1e-3])
def test_trees_leave_lines_to_direct_sums(tol, isa, monkeypatch):
    """What trees do not read of a relief is summed along lines, in tiles of both kinds."""
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", False)
    y = np.arange(5.0, 16.0, 0.06)
    echoes = survey(("fan", 0.6, 0.2), samples=1300).replace(t0=0.004)
    grid = pysas.Grid.surface(X, y, heights("smooth", X, y))
    image = pysas.ffbp(echoes, grid, tol)
    assert 0.1 < image.report.factorised_share < 1
    assert wrong(image, echoes, grid) <= tol


def test_a_plan_images_again_in_the_same_memory(isa):
    """What a sum leaves behind is no part of the next one, nor of another plan's that follows it."""
    echoes, grid = survey(BEAMS["fan"]), pysas.Grid.surface(X, Y, heights("rough", X, Y))
    plan = pysas.plan(echoes, grid, 1e-3)
    first = plan(echoes.data).data.copy()
    plan((1e3 * echoes.data).astype(np.complex64))
    assert np.array_equal(plan(echoes.data).data, first)
    after = pysas.plan(echoes, grid, 1e-3)
    after.by.follow(plan.by)
    assert np.array_equal(after(echoes.data).data, first)


def test_plans_may_be_followed_while_they_work(isa):
    """Memory goes with the last sum that has it."""
    echoes, grid = survey(BEAMS["fan"]), pysas.Grid.surface(X, Y, heights("rough", X, Y))
    plan = pysas.plan(echoes, grid, 1e-3, threads=1)
    first = plan(echoes.data).data.copy()
    with ThreadPoolExecutor(2) as pool:
        images = [pool.submit(lambda: plan(echoes.data).data) for _ in range(40)]
        while not all(image.done() for image in images):
            plan.by.follow(pysas.plan(echoes, grid, 1e-2, threads=1).by)
    assert all(np.array_equal(image.result(), first) for image in images)
