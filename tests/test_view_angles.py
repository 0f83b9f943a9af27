"""Weights uniform in view angle in the engines, against plain sums with the arcs of `circular.view_weights`, pixel by pixel."""

import functools

import numpy as np
import pytest
from test_tolerance import engine

import pysas
from pysas import circular, view_angles
from pysas.scene import Scene

UNIFORM = "uniform-angle"
__all__ = ["engine"]  # a fixture: each backend and instruction set


def survey(pings=240, turn=2 * np.pi, channels=1, beam=None, moving=False, dtype=np.complex64, seed=0):
    """Noise heard along an uneven, perhaps open, circle of 20 m about the origin: nothing is smooth from ping to ping."""
    rng = np.random.default_rng(seed)
    angle = turn * (np.arange(pings) + 0.2 * rng.standard_normal(pings)) / pings
    tx = np.stack([20 * np.cos(angle), 20 * np.sin(angle), 5 + 0.1 * rng.standard_normal(pings)], axis=1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    rx = tx[:, None] + ahead[:, None] * 0.05 * (np.arange(channels) - 0.5 * (channels - 1))[:, None]
    samples = 700
    spectrum = rng.standard_normal((pings, channels, samples)) + 1j * rng.standard_normal((pings, channels, samples))
    data = np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(samples)) < 0.5 / 1.3)).astype(dtype)
    if beam is not None:
        beam = pysas.Beam(boresight=-np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), length=0.1, half_angle=beam)
    velocity = 1.5 * ahead if moving else None
    return pysas.Echoes(
        data, fs=26e3, fc=60e3, tx=tx, rx=tx[:, None] if channels == 1 else rx, t0=2 * 7 / 1500, bandwidth=20e3, beam=beam,
        velocity=velocity,
    )  # fmt: skip


PLANE = pysas.Grid.plane(6 + 0.02 * np.arange(130), 4 + 0.02 * np.arange(70))


def exact(echoes, grid, number=14):
    """Some pixels, the oracle's sums there with each pixel's own weights, and the level errors are stated by."""
    pixels = np.sort(np.random.default_rng(1).choice(grid.size, min(number, grid.size), replace=False))
    weights = circular.view_weights(echoes, grid, pixels)
    both = [
        pysas.reference.exact(echoes, pysas.Grid.points(point[None]), weights=weight)
        for point, weight in zip(grid.coordinates(pixels), weights, strict=True)
    ]
    sums, levels = (np.concatenate(values) for values in zip(*both, strict=True))
    return pixels, sums, max(np.linalg.norm(sums), np.linalg.norm(levels))


def error(image, truth):
    pixels, sums, level = truth
    return np.linalg.norm(image.data.ravel()[pixels] - sums) / level


SURVEYS = {
    "uneven circle": {},
    "open, of three receivers": {"turn": 2.5, "channels": 3, "pings": 120},
    "moving receivers": {"channels": 2, "moving": True, "pings": 120},
    "a beam": {"beam": 0.7},
}


@pytest.fixture(scope="module", params=SURVEYS)
def case(request):
    echoes = survey(**SURVEYS[request.param])
    return echoes, exact(echoes, PLANE)


@pytest.mark.parametrize("tol", (1e-2, 1e-3, 1e-4, 1e-5))
def test_engines_keep_tol(case, tol, engine):
    echoes, truth = case
    image = pysas.backproject(echoes, PLANE, tol=tol, weights=UNIFORM, backend=engine)
    assert error(image, truth) < tol
    assert not any("view-angle" in note for note in image.report.notes)


def test_there_is_something_to_weigh(case):
    echoes, truth = case
    assert error(pysas.backproject(echoes, PLANE), truth) > 0.2


@functools.cache
def tree_case():
    """A short arc, far enough for the tree to take all terms."""
    echoes = survey(pings=200, turn=0.25)
    grid = pysas.Grid.plane(-4 + 0.02 * np.arange(130), 1 + 0.02 * np.arange(70))
    return echoes, grid, exact(echoes, grid)


def test_a_tree_weighs_as_well(engine):
    echoes, grid, truth = tree_case()
    for tol in (1e-2, 1e-3):
        image = pysas.ffbp(echoes, grid, tol=tol, fallback=False, weights=UNIFORM, backend=engine)
        assert image.report.factorised_share == 1
        assert error(image, truth) < tol


GRIDS = {
    "points": pysas.Grid.points(np.random.default_rng(2).uniform((-9, -9, -0.5), (9, 9, 0.5), (90, 3))),
    "volume": pysas.Grid.volume(6 + 0.02 * np.arange(40), 4 + 0.02 * np.arange(9), [0.0, 0.5, 1.0, 1.5]),
    "polar": pysas.Grid.polar(2 + 0.05 * np.arange(70), np.linspace(0, 6, 40)),
    "coarse": pysas.Grid.plane(0.3 * np.arange(-30, 30), 0.3 * np.arange(-30, 30)),
    "a pixel": pysas.Grid.plane([6.0], [4.0]),
}


@functools.cache
def grid_case(name):
    echoes = survey(channels=2, pings=80)
    return echoes, exact(echoes, GRIDS[name])


@pytest.mark.parametrize("name", GRIDS)
def test_any_grid(name, engine):
    echoes, truth = grid_case(name)
    image = pysas.backproject(echoes, GRIDS[name], tol=1e-3, weights=UNIFORM, backend=engine)
    assert error(image, truth) < 1e-3


@functools.cache
def double_case():
    echoes = survey(pings=80, dtype=np.complex128)
    return echoes, exact(echoes, PLANE)


def test_float64(engine):
    echoes, truth = double_case()
    image = pysas.backproject(echoes, PLANE, tol=1e-6, weights=UNIFORM, backend=engine)
    assert error(image, truth) < 1e-6


def test_threads_do_not_matter(engine):
    echoes = survey(pings=80)
    images = [pysas.backproject(echoes, PLANE, weights=UNIFORM, backend=engine, threads=n).data for n in (1, 3)]
    np.testing.assert_array_equal(*images)


def positions(angles, radius=10.0):
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.ones_like(angles)], axis=1)


TRACKS = {
    "even": positions(2 * np.pi * np.arange(60) / 60),
    "pinged twice where it closes": positions(np.linspace(0, 2 * np.pi, 61)),
    "every place twice": positions(np.repeat(2 * np.pi * np.arange(30) / 30, 2)),
    "a missing sector": positions(np.delete(2 * np.pi * np.arange(60) / 60, slice(20, 31))),
    "a lone view": positions(np.concatenate([np.linspace(0, 1, 30), [3.0]])),
    "clusters": positions(np.sort(np.random.default_rng(3).uniform(0, 2, 50) ** 2)),
    "a straight line": np.stack([np.linspace(-20, 20, 81), np.full(81, -12.0), np.zeros(81)], axis=1),
    "two": positions(np.array([0.0, 1.0])),
    "one": positions(np.array([0.5])),
}


@pytest.mark.parametrize("channels", (1, 3))
@pytest.mark.parametrize("name", TRACKS)
def test_arcs_are_those_of_the_rule(name, channels):
    """Two programs of one rule: vectors over many places here, place by place in `circular`."""
    tx = TRACKS[name]
    rx = tx[:, None] + 0.3 * np.arange(channels)[:, None] * [1.0, 0.5, 0.2]
    echoes = pysas.Echoes(np.zeros((len(tx), channels, 16), np.complex64), fs=1e4, fc=1e5, tx=tx, rx=rx, bandwidth=8e3)
    points = np.random.default_rng(4).uniform((-6, -6, -1), (6, 6, 1), (40, 3))
    grid = pysas.Grid.points(points)
    scene = Scene(echoes, grid, UNIFORM)
    found = view_angles.arcs(scene, points - scene.origin)
    np.testing.assert_allclose(found, circular.view_weights(echoes, grid).reshape(40, -1), rtol=1e-7, atol=1e-9)


def test_where_arcs_change_too_fast_a_note_says_so():
    """An image across the track: no lattice follows weights whose nearest view turns by pi in a pixel."""
    tx = positions(2 * np.pi * np.arange(200) / 200, 2.0)
    echoes = pysas.Echoes(np.ones((200, 400), np.complex64), fs=26e3, fc=60e3, tx=tx, rx=tx, bandwidth=20e3)
    image = pysas.backproject(
        echoes, pysas.Grid.plane(0.05 * np.arange(-60, 61), 0.05 * np.arange(-60, 61)), 1e-4, weights=UNIFORM
    )
    assert np.isfinite(image.data).all()
    assert any("view-angle weights are within" in note for note in image.report.notes)
    assert image.report.predicted_error > 1e-4


def test_a_wrong_name_is_told():
    echoes = survey(pings=20)
    for call in (pysas.backproject, pysas.ffbp, pysas.plan):
        with pytest.raises(ValueError, match="weights='even': expected an array or 'uniform-angle'"):
            call(echoes, PLANE, weights="even")


def test_a_plan_tells_of_them():
    echoes = survey(pings=40)
    plain, even = pysas.plan(echoes, PLANE), pysas.plan(echoes, PLANE, weights=UNIFORM)
    assert "weights that differ" in plain.explain() and "weights that differ" not in even.explain()
    assert "view angles" in even.explain()
    assert even.predicted_memory - plain.predicted_memory >= even.scene.lattice.value.nbytes
    outside = pysas.Grid.plane([900.0, 901.0], [0.0])
    with pytest.warns(UserWarning, match="outside the recorded window"):
        assert not pysas.backproject(echoes, outside, weights=UNIFORM).data.any()
