"""Autofocus: the cost's derivative, tracks found to a small part of the wavelength, and where it must leave a track alone."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from motion_scenes import scene as array_scene
from point_scenes import GRID, circle, loss, radial_error, scene, slant_error, speckle

import pysas
from pysas.motion import focusing, patches
from pysas.motion.moving import moved

# estimators, not engines: what these read is held to tolerance on every engine by test_contributions.py
pytestmark = pytest.mark.cpp

SEEDS = (1, 2, 3)
HARD = [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("metric", ["entropy", "sharpness"])
def test_the_gradient_is_that_of_differences(seed: int, metric: str) -> None:
    """Central differences of the cost by one ping's displacement: 1e-7 of the largest, where rounding allows no more."""
    _, claim, points = scene(seed, pings=48, points=2, dtype=np.complex128)
    (patch,) = patches.made(claim, points[:1], 1e-6, None)
    rng = np.random.default_rng(seed)
    delta = 2e-3 * rng.standard_normal((len(patch.pings), 3))
    k = patches.wave_numbers(claim)[patch.pings]
    _, gradient = focusing.patch_cost(patch, delta, k, metric)
    step = 1e-6
    for ping, axis in rng.integers((0, 0), (len(delta), 3), (12, 2)):
        ends = []
        for sign in (-2, -1, 1, 2):
            near = delta.copy()
            near[ping, axis] += sign * step
            ends.append(focusing.patch_cost(patch, near, k, metric)[0])
        difference = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        assert difference == pytest.approx(gradient[ping, axis], abs=1e-7 * np.abs(gradient).max())


def test_a_patch_moves_as_its_echoes_do() -> None:
    """Phases alone say what reading the echoes of a moved track says: 0.1 % where the shift is 1 mm, a 37th of a cell."""
    _, claim, points = scene(1, pings=64, points=2)
    shift = np.zeros((64, 3))
    shift[:, 1] = 1e-3 * np.sin(np.arange(64) / 9.0)
    (before,), (after,) = (
        patches.made(echoes, points[:1], 1e-4, None) for echoes in (claim, moved(claim, shift, np.zeros(64)))
    )
    assert before is not None and after is not None
    k = patches.wave_numbers(claim)[before.pings]
    for metric in ("entropy", "sharpness"):
        there = float(patches.costs([after], metric)[0])
        assert focusing.patch_cost(before, shift[before.pings], k, metric)[0] == pytest.approx(there, rel=2e-3)


def test_the_prior_knows_its_derivative() -> None:
    rng = np.random.default_rng(0)
    prior = focusing._Prior(1e-5 * (1 + rng.uniform(size=(2, 18))))
    series = 1e-4 * rng.standard_normal((2, 20))
    _, pull = prior(series)
    for c, p in ((0, 0), (0, 7), (1, 18), (1, 19)):
        near = [series.copy() for _ in range(2)]
        near[0][c, p] -= 1e-7
        near[1][c, p] += 1e-7
        assert (prior(near[1])[0] - prior(near[0])[0]) / 2e-7 == pytest.approx(pull[c, p], rel=1e-6)


@pytest.mark.parametrize("metric", ["entropy", pytest.param("sharpness", marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", HARD)
def test_points_seen_by_one_element(seed: int, metric: str) -> None:
    """Sway of 3 mm rms: 0.1 mm and 0.1 dB."""
    true, claim, points = scene(seed)
    fixed, report = pysas.autofocus(claim, GRID, metric=metric)
    assert loss(claim, true, points) > 1
    assert report.informative and report.taken and len(report.patches) == len(points)
    assert slant_error(fixed, true) < 0.1e-3
    assert loss(fixed, true, points) < 0.1
    assert np.all(report.cost[1] < report.cost[0])
    np.testing.assert_allclose(fixed.tx - claim.tx, report.shift, atol=1e-12)
    assert report.largest == pytest.approx(np.linalg.norm(report.shift, axis=1).max())
    for word in ("track moved", "bright points", metric, "not seen"):
        assert word in str(report)


@pytest.mark.parametrize("seed", HARD)
def test_a_right_track_stays_right(seed: int) -> None:
    true, _, _ = scene(seed, points=4, above_db=24)
    fixed, _ = pysas.autofocus(true, GRID)
    assert slant_error(fixed, true) < 0.1e-3


@pytest.mark.parametrize("seed", HARD)
def test_developed_speckle_says_nothing(seed: int) -> None:
    claim, grid = speckle(seed)
    for fixed, report in (pysas.autofocus(claim, grid), pysas.align_points(claim, grid)):
        assert fixed is claim
        assert not report.informative and not report.taken
        assert "not informative" in report.why and "track unchanged" in str(report)
        assert report.contrast == pytest.approx(2, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", HARD)
def test_an_error_beyond_the_basin_is_left_alone(seed: int) -> None:
    """20 mm rms of sway: phases alone would lead astray; align_points finds it."""
    _, claim, _ = scene(seed, 0.02)
    fixed, report = pysas.autofocus(claim, GRID)
    assert fixed is claim and not report.taken
    assert "align_points" in report.why


@pytest.mark.slow
@pytest.mark.parametrize("seed", HARD)
def test_after_micronavigation(seed: int) -> None:
    """An array's track whose heading wanders by 125 urad a ping, as micronavigation leaves it: 0.5 mm, 0.25 dB."""
    true, _, truth = array_scene(density=10.0, snr_db=20.0, seed=seed)
    rng = np.random.default_rng(seed)
    wander = np.cumsum(np.cumsum(25e-6 * rng.standard_normal(64)))
    shift = np.zeros((64, 3))
    shift[:, 1] = wander - np.polyval(np.polyfit(np.arange(64.0), wander, 1), np.arange(64.0))
    claim = moved(true, shift, np.zeros(64))
    grid = pysas.Grid.plane(np.arange(-4, 4.5, 0.025), np.arange(22, 38, 0.02), 8.0)
    sigma = np.tile([1e-3, 20e-6, 60e-6, 125e-6], (64, 1))
    fixed, report = pysas.autofocus(claim, grid, metric="sharpness", prior=SimpleNamespace(sigma=sigma))
    assert report.taken
    assert pysas.metrics.track_error(fixed, true, 30.0) < 0.5e-3
    assert pysas.metrics.track_error(fixed, true, 30.0) < pysas.metrics.track_error(claim, true, 30.0) / 2
    assert loss(fixed, true, truth.targets) < 0.25


@pytest.mark.parametrize("seed", HARD)
def test_a_circle(data_dir: Path, seed: int) -> None:
    """1 mm rms of radial error, harmonics 2 to 9: 0.05 mm, 0.05 dB, the targets in place."""
    true, claim, points, grid = circle(data_dir, seed, 1e-3)
    fixed, report = pysas.autofocus(claim, grid, metric="sharpness", harmonics=16)
    assert report.taken
    assert radial_error(fixed, true) < 0.05e-3
    assert loss(fixed, true, points, half=0.03, step=0.001) < 0.05


# What is a bright point


def texture(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Developed speckle, two pixels a cell of resolution."""
    spectrum = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    rows, columns = (np.abs(np.fft.fftfreq(n)) < 0.25 for n in shape)
    return np.fft.ifft2(spectrum * rows[:, None] * columns)


def test_speckle_raises_no_alarm() -> None:
    """The threshold is for one false alarm in a thousand images: at most 2 in 400, of which levels fall by 20 dB."""
    rng = np.random.default_rng(0)
    grid = pysas.Grid.plane(np.arange(96) * 0.02, np.arange(128) * 0.02)
    fall = 10 ** (-np.linspace(0, 20, 128) / 20)[:, None]
    alarms = sum(len(patches.detect(fall * texture(rng, grid.shape), grid, 0.5).centres) > 0 for _ in range(400))
    assert alarms <= 2


def test_targets_are_not_missed() -> None:
    """Four of a power of 18 dB above the clutter in each of 50 images, 1 m and more apart, in the order of their brightness."""
    rng = np.random.default_rng(1)
    grid = pysas.Grid.plane(np.arange(160) * 0.02, np.arange(128) * 0.02)
    places = [(20, 30), (100, 40), (30, 120), (90, 130)]
    for _ in range(50):
        image = texture(rng, grid.shape)
        image /= np.sqrt(np.mean(np.abs(image) ** 2))
        for number, place in enumerate(places):
            image[place] = 10 ** ((18 + number) / 20)
        found = patches.detect(image, grid, 0.6)
        wanted = [grid.coordinates(np.array([np.ravel_multi_index(place, grid.shape)]))[0] for place in places[::-1]]
        np.testing.assert_allclose(found.centres, wanted)
        assert found.highest > found.threshold


def test_those_that_lie_apart_come_first() -> None:
    places = np.array([[0, 0, 0], [1.1, 0, 0], [0.5, 0, 0], [9, 0, 0], [4.5, 0, 0]], dtype=float)
    assert patches.spread(places, 1.0) == [0, 1, 3, 4]
    assert patches.spread(places, 1.0, most=3) == [0, 3, 4]


# Bad input


@pytest.fixture(scope="module")
def claim() -> pysas.Echoes:
    return scene(1, pings=48, points=3)[1]


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"metric": "contrast"}, ValueError, "metric"),
        ({"components": ("yaw",)}, ValueError, "components"),
        ({"components": ()}, TypeError, "components"),
        ({"components": ("sway", "sway")}, ValueError, "once"),
        ({"components": "sway"}, TypeError, "components"),
        ({"knots": (3,)}, ValueError, "knots"),
        ({"knots": (49,)}, ValueError, "knots"),
        ({"knots": ()}, TypeError, "knots"),
        ({"harmonics": 1}, ValueError, "harmonics"),
        ({"velocity": "free"}, ValueError, "velocity"),
        ({"prior": -1.0}, ValueError, "prior"),
        ({"prior": SimpleNamespace(sigma=np.zeros((48, 4)))}, ValueError, "sway at ping 1"),
        ({"prior": SimpleNamespace(sigma=np.ones((47, 4)))}, ValueError, "prior.sigma"),
    ],
)
def test_wrong_arguments(claim: pysas.Echoes, changes: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        pysas.autofocus(claim, GRID, **({"knots": (8,)} | changes))


@pytest.mark.parametrize("method", [pysas.autofocus, pysas.align_points])
def test_wrong_echoes(claim: pysas.Echoes, method) -> None:
    with pytest.raises(ValueError, match="1 pings: expected at least 8"):
        method(claim[0], GRID)
    with pytest.raises(ValueError, match="raw"):
        method(claim.replace(compressed=False), GRID)
    with pytest.raises(ValueError, match="one place"):
        still = np.tile(claim.tx[:1], (claim.n_ping, 1))
        method(claim.replace(tx=still, rx=still), GRID)
    with pytest.raises(ValueError, match="same samples"):
        method(claim.replace(data=np.repeat(claim.data[:1], claim.n_ping, axis=0)), GRID)
    with pytest.raises(TypeError, match="echoes"):
        method(claim.data, GRID)
    with pytest.raises(TypeError, match="grid"):
        method(claim, claim)
    bad = claim.data.copy()
    bad[5, 100] = np.nan
    with pytest.raises(ValueError, match="ping 5"):
        method(claim.replace(data=bad), GRID)


@pytest.mark.parametrize("method", [pysas.autofocus, pysas.align_points])
def test_nothing_to_go_by(claim: pysas.Echoes, method) -> None:
    how = {"knots": (8,)} if method is pysas.autofocus else {}
    rng = np.random.default_rng(0)
    noise = claim.replace(
        data=(rng.standard_normal(claim.data.shape) + 1j * rng.standard_normal(claim.data.shape)).astype("c8")
    )
    fixed, report = method(noise, GRID, **how)
    assert fixed is noise and not report.informative
    outside = pysas.Grid.plane(np.arange(-1, 1, 0.05), np.arange(80, 82, 0.05), 8.0)
    with pytest.warns(UserWarning, match="outside|no term|record"):
        fixed, report = method(claim, outside, **how)
    assert fixed is claim and "empty" in report.why
