"""Bright points: errors of many wavelengths, clutter, arrays without attitude, and echoes that other programs simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from point_scenes import GRID, after_rigid_fit, circle, loss, peaks, radial_error, scene, side_lobes, slant_error
from recorder_scene import echoes_of

import pysas
from pysas.motion import bright_points
from pysas.motion.moving import centres, moved

# estimators, not engines: what these read is held to tolerance on every engine by test_contributions.py
pytestmark = pytest.mark.cpp

SEEDS = (1, 2, 3)
HARD = [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]


@pytest.mark.parametrize("components", [("sway",), pytest.param(("sway", "heave"), marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", HARD)
def test_sway_of_a_wavelength_and_more(seed: int, components: tuple[str, ...]) -> None:
    """20 mm rms, four half-wavelengths from peak to trough and more: 0.1 mm, 0.1 dB."""
    true, claim, points = scene(seed, 0.02)
    fixed, report = pysas.align_points(claim, GRID, components=components)
    assert loss(claim, true, points) > 5
    assert report.taken and len(report.patches) == len(points)
    assert slant_error(fixed, true) < 0.1e-3
    assert loss(fixed, true, points) < 0.1
    np.testing.assert_allclose(fixed.tx - claim.tx, report.shift, atol=1e-12)


@pytest.mark.parametrize("seed", HARD)
def test_sinusoid_of_one_wavelength(seed: int) -> None:
    """15 mm from peak to peak, 1 m long, points 24 dB above the clutter of a ping: 0.6 mm, side lobes of -18 dB and less.

    Measured: 0.03 to 0.05 mm, -21 dB, where the true track has -21.4.
    """
    true, claim, points = scene(seed, points=4, above_db=24, sine=(0.015, 1.0))
    fixed, report = pysas.align_points(claim, GRID, components=("sway",), iterations=4)
    assert slant_error(claim, true) > 4e-3 and side_lobes(claim, points).max() > -3
    assert report.taken
    assert slant_error(fixed, true) < 0.1e-3
    assert side_lobes(fixed, points).max() < -18


@pytest.mark.parametrize("seed", SEEDS)
def test_windows_keep_clutter_out(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points 24 dB above the clutter of a ping: 0.1 mm, and ten times as much without smoothing along pings."""
    true, claim, points = scene(seed, points=4, above_db=24)
    fixed, report = pysas.align_points(claim, GRID, components=("sway",), iterations=3)
    assert report.taken and slant_error(fixed, true) < 0.1e-3
    assert loss(fixed, true, points) < 0.1
    monkeypatch.setattr(bright_points, "WINDOWS", (0.0,))
    plain, _ = pysas.align_points(claim, GRID, components=("sway",), iterations=3)
    assert slant_error(plain, true) > 10 * slant_error(fixed, true)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_points_little_above_the_clutter(seed: int) -> None:
    """18 dB in a ping: 0.1 mm and 0.1 dB."""
    true, claim, points = scene(seed, points=4, above_db=18)
    fixed, report = pysas.align_points(claim, GRID, components=("sway",))
    assert report.taken and slant_error(fixed, true) < 0.1e-3
    assert loss(fixed, true, points) < 0.1


@pytest.mark.parametrize("seed", HARD)
def test_a_right_track_stays_right(seed: int) -> None:
    true, _, _ = scene(seed, points=4, above_db=24)
    fixed, _ = pysas.align_points(true, GRID, components=("sway",))
    assert slant_error(fixed, true) < 0.1e-3


def test_the_size_of_samples_does_not_matter() -> None:
    """Powers of 2 change no bit of the track."""
    _, claim, _ = scene(1, pings=96)
    expected, report = pysas.align_points(claim, GRID)
    assert report.taken
    for exponent in (-90, 100):
        data = np.asarray(claim.data) * np.float32(2.0**exponent)
        found, report = pysas.align_points(claim.replace(data=data), GRID)
        assert report.taken and np.array_equal(found.tx, expected.tx)


def test_points_may_be_given() -> None:
    true, claim, points = scene(1, 0.01)
    fixed, report = pysas.align_points(claim, GRID, points=points + 0.1, components=("sway",))
    assert report.taken and slant_error(fixed, true) < 0.1e-3
    nowhere = np.array([[0.0, 26.5, 8.0], [0.5, 31.3, 8.0]])
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(claim.data.shape) + 1j * rng.standard_normal(claim.data.shape)
    noisy = claim.replace(data=noise.astype(np.complex64))
    fixed, report = pysas.align_points(noisy, GRID, points=nowhere)
    assert fixed is noisy and not report.informative


def test_velocity_is_the_claim_s_own_or_measured() -> None:
    _, claim, _ = scene(1, 0.01, pings=96)
    n = claim.n_ping
    claim = claim.replace(velocity=np.tile([0.5, 0, 0], (n, 1)), ping_time=np.arange(n) * 0.05)
    follow, report = pysas.align_points(claim, GRID, components=("sway",))
    keep, other = pysas.align_points(claim, GRID, components=("sway",), velocity="keep")
    assert report.taken and other.taken
    np.testing.assert_allclose(follow.velocity[:, 1], np.gradient(report.shift[:, 1], 0.05), atol=1e-12)
    np.testing.assert_array_equal(keep.velocity, claim.velocity)


@pytest.mark.parametrize("rms", [pytest.param(1e-3, marks=pytest.mark.slow), 3e-3, pytest.param(6e-3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", HARD)
def test_a_circle(data_dir: Path, seed: int, rms: float) -> None:
    """Radial errors of 1, 3 and 6 mm, harmonics 2 to 9: 0.05 mm, 0.05 dB."""
    true, claim, points, grid = circle(data_dir, seed, rms)
    fixed, report = pysas.align_points(claim, grid, components=("sway",))
    fixed, _ = pysas.autofocus(fixed, grid, metric="sharpness", harmonics=16)
    assert report.taken
    assert radial_error(fixed, true) < 0.05e-3
    assert loss(fixed, true, points, half=0.03, step=0.001) < 0.05


STRIP = pysas.Grid.plane(np.arange(4, 9, 0.015), np.arange(23.5, 36.5, 0.015), 8.0)


def strip(folder: Path) -> tuple[pysas.Echoes, pysas.Echoes, np.ndarray]:
    """True attitude and x, sway and heave replaced by their means; six targets, as the seventh lies beside one of them."""
    true = pysas.compress(pysas.load(folder / "stripmap_perturbed.npz"))
    shift = true.tx.mean(axis=0) - true.tx
    shift[:, 0] = 0
    return true, moved(true, shift, np.zeros(true.n_ping)), np.load(folder / "stripmap_perturbed.npz")["truth_position"][:6]


@pytest.mark.parametrize("given", [False, True])
def test_an_array_with_sway_and_heave_unknown(data_dir: Path, given: bool) -> None:
    """Of 36 mm rms: targets lose 0.5 dB at most and lie within 5 mm; 0.1 dB where their heights are known."""
    true, claim, targets = strip(data_dir)
    fixed, report = pysas.align_points(claim, STRIP, points=targets if given else None)
    assert loss(claim, true, targets, half=0.12, step=0.006) > 10
    assert report.taken
    before, after = (peaks(echoes, targets, half=0.12, step=0.006) for echoes in (true, fixed))
    assert np.max(before[:, 0] - after[:, 0]) < (0.1 if given else 0.5)
    assert after_rigid_fit(after[:, 1:], targets[:, :2]).max() < (1e-3 if given else 5e-3)


@pytest.mark.slow
def test_an_array_without_attitude(data_dir: Path) -> None:
    """A straight level line in place of all motion: slopes along the array find its yaw of 19 mrad to 2, and save 1.5 dB."""
    true, _, targets = strip(data_dir)
    n = true.n_ping
    middle, x = true.tx.mean(axis=0), np.linspace(true.tx[0, 0], true.tx[-1, 0], n)
    tx = np.stack([x, np.full(n, middle[1]), np.full(n, middle[2])], axis=1)
    arm = (true.rx - true.tx[:, None]).mean(axis=0)
    speed = np.broadcast_to([np.mean(np.gradient(x, true.ping_time)), 0.0, 0.0], true.rx.shape)
    claim = true.replace(tx=tx, rx=tx[:, None] + arm, velocity=speed)
    plain, _ = pysas.align_points(claim, STRIP)
    turned, report = pysas.align_points(claim, STRIP, components=("sway", "heave", "yaw"))
    array = true.rx[:, -1] - true.rx[:, 0]
    yaw = np.arctan2(array[:, 1], array[:, 0])
    assert np.std(yaw) > 15e-3 and np.std(yaw - report.yaw) < 2e-3
    losses = [loss(echoes, true, targets, half=0.12, step=0.006) for echoes in (plain, turned)]
    assert losses[1] < 1.0 < losses[0] - 0.5


def test_a_recording_whose_navigation_lacks_its_sway(data_dir: Path) -> None:
    """Sixteen receivers and 8.6 mm of sway: from -9 dB and less to within 1 dB of the image with the right navigation."""
    true, targets = echoes_of(data_dir / "recorder", "nav.csv")
    claim, _ = echoes_of(data_dir / "recorder", "nav_bad.csv")
    grid = pysas.Grid.plane(np.arange(-3, 3, 0.02), np.arange(22.3, 25.6, 0.015), 20.0)
    before = peaks(true, targets, half=0.1, step=0.01)[:, 0]
    assert np.min(before - peaks(claim, targets, half=0.25, step=0.01)[:, 0]) > 8.5
    fixed, report = pysas.align_points(claim, grid)
    assert report.taken
    assert np.max(before - peaks(fixed, targets, half=0.25, step=0.01)[:, 0]) < 0.5
    middle = centres(fixed) - centres(true)
    assert report.seen < 0.5  # pings that no target is seen by go with their neighbours
    assert np.abs(report.shift[:, 1]).max() < 0.03 and np.isfinite(middle).all()


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"components": ("roll",)}, ValueError, "components"),
        ({"components": ("yaw",)}, ValueError, "alone"),
        ({"components": ("sway", "yaw")}, ValueError, "one receiver"),
        ({"iterations": 0}, ValueError, "iterations"),
        ({"points": np.zeros((2, 2))}, ValueError, "points"),
        ({"points": np.full((2, 3), np.nan)}, ValueError, "points"),
    ],
)
def test_wrong_arguments(changes: dict, error: type[Exception], words: str) -> None:
    _, claim, _ = scene(1, pings=32, points=2)
    with pytest.raises(error, match=words):
        pysas.align_points(claim, GRID, **changes)
