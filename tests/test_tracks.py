"""Tracks and receiver lines: geometry by hand, statistics of the perturbed track, velocity against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pysas.tracks import Track, array, circular, inertial, perturbed, straight

pytestmark = pytest.mark.reference  # no engine takes part


def test_straight() -> None:
    track = straight(4, 0.5, height=8.0, speed=2.0, start=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(track.position, [[1, 2, 11], [1.5, 2, 11], [2, 2, 11], [2.5, 2, 11]])
    np.testing.assert_array_equal(track.velocity, [[2, 0, 0]] * 4)
    np.testing.assert_array_equal(track.yaw, [0] * 4)
    np.testing.assert_array_equal(track.time, [0, 0.25, 0.5, 0.75])
    assert all(a.dtype == np.float64 for a in (track.position, track.velocity, track.yaw, track.time))
    assert track.n_ping == 4 and repr(track) == "Track(4 pings over 1.5 m in 0.75 s)"


def test_unperturbed_is_straight() -> None:
    first, second = straight(5, 0.1, 3.0), perturbed(5, 0.1, 3.0)
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(first.velocity, second.velocity)


def test_perturbed_rms_and_correlation() -> None:
    """Over many seeds: rms as asked, autocorrelation rms^2 exp(-s^2/(2 L^2)) at s = L/2, L and 2 L."""
    correlation, spacing = 2.0, 0.5
    tracks = [
        perturbed(400, spacing, sway=0.05, heave=0.02, yaw=0.01, surge=0.004, correlation=correlation, seed=seed)
        for seed in range(200)
    ]
    for values, rms in (
        (np.array([t.position[:, 1] for t in tracks]), 0.05),
        (np.array([t.position[:, 2] for t in tracks]), 0.02),
        (np.array([t.yaw for t in tracks]), 0.01),
        (np.array([t.position[:, 0] - spacing * np.arange(400) for t in tracks]), 0.004),
    ):
        # 200 tracks of 100 correlation lengths: about 1 % of scatter
        assert np.sqrt(np.mean(values**2)) == pytest.approx(rms, rel=0.03)
        for lag in (2, 4, 8):
            expected = np.exp(-((lag * spacing) ** 2) / (2 * correlation**2))
            assert np.mean(values[:, lag:] * values[:, :-lag]) / rms**2 == pytest.approx(expected, abs=0.04)


def test_perturbed_velocity_is_the_derivative() -> None:
    track = perturbed(2001, 1e-3, speed=1.7, sway=0.1, heave=0.05, surge=0.02, correlation=0.5, seed=3)
    difference = (track.position[2:] - track.position[:-2]) / (track.time[2:] - track.time[:-2])[:, None]
    # central differences: third derivative 1.7 (kappa = 3/L)^3 amplitude h^2/6 < 1e-5
    np.testing.assert_allclose(track.velocity[1:-1], difference, atol=2e-5)
    assert np.ptp(track.velocity[:, 1]) > 0.1


def test_perturbed_is_repeatable_and_motions_independent() -> None:
    one = perturbed(50, 0.1, sway=0.1, heave=0.1, yaw=0.1, seed=5)
    again = perturbed(50, 0.1, sway=0.1, heave=0.1, yaw=0.1, seed=5)
    swaying = perturbed(50, 0.1, sway=0.2, seed=5)
    np.testing.assert_array_equal(one.position, again.position)
    np.testing.assert_allclose(swaying.position[:, 1], 2 * one.position[:, 1], rtol=1e-14)
    assert np.any(one.position != perturbed(50, 0.1, sway=0.1, heave=0.1, seed=6).position)
    assert np.abs(np.corrcoef(one.position[:, 1], one.position[:, 2])[0, 1]) < 0.999


def test_surge_and_crab_leave_the_other_motions() -> None:
    """Surge moves x alone; crab turns the platform by a constant, and neither its track nor its velocity."""
    asked: dict[str, Any] = {"sway": 0.1, "heave": 0.1, "yaw": 0.1, "seed": 5}
    one, other = perturbed(50, 0.1, **asked), perturbed(50, 0.1, surge=0.05, crab=-0.07, **asked)
    np.testing.assert_array_equal(other.position[:, 1:], one.position[:, 1:])
    assert np.std(other.position[:, 0] - one.position[:, 0]) > 0.005
    np.testing.assert_allclose(other.yaw - one.yaw, -0.07, rtol=0, atol=1e-15)
    crabbing = perturbed(50, 0.1, crab=-0.07, **asked)
    np.testing.assert_array_equal(crabbing.velocity, one.velocity)
    np.testing.assert_array_equal(crabbing.position, one.position)


TRUE = perturbed(101, 0.15, 3.0, sway=0.1, heave=0.1, yaw=0.05, seed=9)


def test_inertial_without_errors_is_the_track() -> None:
    claim = inertial(TRUE, speed=0, bias=0, gyro=0, depth=0)
    for name in ("position", "velocity", "yaw", "time"):
        np.testing.assert_array_equal(getattr(claim, name), getattr(TRUE, name))


def test_inertial_errors_have_the_deviations_asked_for() -> None:
    """Over 400 seeds: increments of position, of heading and depth white with the sigmas given; walks grow as their sums."""
    step, n = 0.1, 100  # s and increments
    claims = [inertial(TRUE, speed=5e-3, bias=0, gyro=1e-4, depth=5e-4, heading=0.02, seed=seed) for seed in range(400)]
    drift = np.array([claim.position - TRUE.position for claim in claims])
    np.testing.assert_array_equal(drift[:, 0, :2], 0)
    walk = np.array([claim.yaw - TRUE.yaw for claim in claims]) - 0.02
    np.testing.assert_allclose(walk[:, 0], 0, atol=1e-15)
    for steps, sigma in (
        (np.diff(drift[..., 0], axis=1), 5e-3 * step),
        (np.diff(drift[..., 1], axis=1), 5e-3 * step),
        (np.diff(walk, axis=1), 1e-4),
        (drift[..., 2], 5e-4),
    ):
        # 40000 draws: 0.35 % of scatter in sigma, 0.5 % in the correlation of neighbours
        assert np.sqrt(np.mean(steps**2)) == pytest.approx(sigma, rel=0.015)
        assert abs(np.mean(steps[:, 1:] * steps[:, :-1])) < 0.02 * sigma**2
    # 400 tracks: 3.5 % of scatter in what they end with
    assert np.std(drift[:, -1, 1]) == pytest.approx(5e-3 * step * np.sqrt(n), rel=0.12)
    assert np.std(walk[:, -1]) == pytest.approx(1e-4 * np.sqrt(n), rel=0.12)
    assert abs(np.mean(drift[:, -1, 0] * drift[:, -1, 1])) < 0.2 * (5e-3 * step) ** 2 * n


def test_inertial_velocity_is_what_drifts() -> None:
    """The position's increments are the claimed velocity's errors times the time; a bias is one line for the track."""
    claim = inertial(TRUE, seed=3)
    wrong = claim.velocity - TRUE.velocity
    drift = claim.position - TRUE.position
    np.testing.assert_allclose(np.diff(drift, axis=0)[:, :2], wrong[:-1, :2] * 0.1, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(wrong[:, 2], 0)
    biases = []
    for seed in range(400):
        drift = (inertial(TRUE, speed=0, bias=3e-3, seed=seed).position - TRUE.position)[:, :2]
        np.testing.assert_allclose(drift, np.outer(np.arange(101) / 100, drift[-1]), rtol=0, atol=1e-13)
        biases.append(drift[-1] / 10)
    assert np.std(biases) == pytest.approx(3e-3, rel=0.1)  # 800 draws: 2.5 %


def test_inertial_is_repeatable_and_its_errors_independent() -> None:
    one, again, other = inertial(TRUE, seed=4), inertial(TRUE, seed=4), inertial(TRUE, seed=5)
    np.testing.assert_array_equal(one.position, again.position)
    np.testing.assert_array_equal(one.yaw, again.yaw)
    assert np.all(one.position[1:] != other.position[1:])
    worse = inertial(TRUE, speed=1.0, bias=1.0, gyro=1e-5, depth=5e-4, seed=4)
    np.testing.assert_array_equal(worse.yaw, one.yaw)
    np.testing.assert_array_equal(worse.position[:, 2], one.position[:, 2])
    assert inertial(straight(1, 1.0), seed=4).n_ping == 1


@pytest.mark.parametrize("extent", [2 * np.pi, -np.pi / 2])
def test_circular(extent: float) -> None:
    n, radius, centre = 16, 20.0, np.array([3.0, -4.0, 1.0])
    track = circular(n, radius, tuple(centre), height=5.0, start_angle=0.3, extent=extent, speed=2.0)
    np.testing.assert_allclose(np.linalg.norm((track.position - centre)[:, :2], axis=1), radius, rtol=1e-14)
    np.testing.assert_array_equal(track.position[:, 2], 6.0)
    np.testing.assert_allclose(track.position[0, :2], centre[:2] + radius * np.array([np.cos(0.3), np.sin(0.3)]))
    np.testing.assert_allclose(np.sum(track.velocity * (track.position - centre), axis=1), 0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(track.velocity, axis=1), 2.0)
    step = track.position[1] - track.position[0]
    assert step @ (track.velocity[0] + track.velocity[1]) > 0  # it moves where the velocity points
    np.testing.assert_allclose(np.linalg.norm(step), 2 * radius * np.sin(abs(extent) / n / 2))  # chord
    np.testing.assert_allclose(track.time, radius * abs(extent) / n * np.arange(n) / 2.0)


def test_array_on_a_straight_track() -> None:
    rx = array(straight(2, 1.0, height=5.0), 3, 0.1, offset=(0.5, 0.2, -1.0))
    expected = [[[x + d, 0.2, 4.0] for d in (0.4, 0.5, 0.6)] for x in (0.0, 1.0)]
    np.testing.assert_allclose(rx, expected, rtol=1e-15)


def test_array_turns_with_the_platform() -> None:
    """At yaw pi/2 the along-track axis is +y and the across-track axis -x."""
    track = Track(np.zeros((1, 3)), np.zeros((1, 3)), np.array([np.pi / 2]), np.zeros(1))
    rx = array(track, 2, 2.0, offset=(10.0, 1.0, 3.0))
    np.testing.assert_allclose(rx, [[[-1, 9, 3], [-1, 11, 3]]], atol=1e-14)
    assert array(circular(7, 5.0), 4, 0.1).shape == (7, 4, 3)


@pytest.mark.parametrize(
    ("function", "arguments", "error", "message"),
    [
        (straight, {"n_ping": 0, "spacing": 1}, ValueError, "n_ping=0"),
        (straight, {"n_ping": 2.5, "spacing": 1}, TypeError, "n_ping=2.5"),
        (straight, {"n_ping": 2, "spacing": 0}, ValueError, "spacing=0"),
        (straight, {"n_ping": 2, "spacing": 1, "speed": -1}, ValueError, "speed=-1"),
        (straight, {"n_ping": 2, "spacing": 1, "height": np.nan}, ValueError, "height=nan"),
        (straight, {"n_ping": 2, "spacing": 1, "start": (0, 0)}, ValueError, r"start: expected shape \(3,\)"),
        (perturbed, {"n_ping": 2, "spacing": 1, "sway": -0.1}, ValueError, "sway=-0.1"),
        (perturbed, {"n_ping": 2, "spacing": 1, "correlation": 0}, ValueError, "correlation=0"),
        (perturbed, {"n_ping": 2, "spacing": 1, "seed": -1}, ValueError, "seed=-1"),
        (perturbed, {"n_ping": 2, "spacing": 1, "surge": -0.1}, ValueError, "surge=-0.1"),
        (perturbed, {"n_ping": 2, "spacing": 1, "crab": np.inf}, ValueError, "crab=inf"),
        (inertial, {"track": None}, TypeError, "track=NoneType"),
        (inertial, {"track": TRUE, "speed": -1}, ValueError, "speed=-1"),
        (inertial, {"track": TRUE, "bias": np.nan}, ValueError, "bias=nan"),
        (inertial, {"track": TRUE, "gyro": -1e-5}, ValueError, "gyro=-1e-05"),
        (inertial, {"track": TRUE, "depth": "1"}, TypeError, "depth='1'"),
        (inertial, {"track": TRUE, "heading": np.inf}, ValueError, "heading=inf"),
        (inertial, {"track": TRUE, "seed": 0.5}, TypeError, "seed=0.5"),
        (circular, {"n_ping": 2, "radius": 0}, ValueError, "radius=0"),
        (circular, {"n_ping": 2, "radius": 1, "extent": 0}, ValueError, "extent=0"),
        (circular, {"n_ping": 2, "radius": 1, "centre": (0, 0, np.inf)}, ValueError, "centre: inf"),
        (array, {"track": None, "n_channel": 1, "spacing": 1}, TypeError, "track=NoneType"),
        (array, {"track": straight(2, 1.0), "n_channel": 0, "spacing": 1}, ValueError, "n_channel=0"),
        (array, {"track": straight(2, 1.0), "n_channel": 1, "spacing": -1}, ValueError, "spacing=-1"),
    ],
)
def test_rejected(function: Any, arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        function(**arguments)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": np.zeros((3, 2))}, "position: expected shape"),
        ({"position": np.zeros((0, 3))}, "position: no pings"),
        ({"velocity": np.zeros((2, 3))}, r"velocity: expected shape \(3, 3\)"),
        ({"yaw": [0, np.nan, 0]}, "yaw: nan at ping 1"),
        ({"time": [0, 2, 1]}, "time: 1 s at ping 2 after 2 s"),
    ],
)
def test_track_is_validated(changes: dict[str, Any], message: str) -> None:
    fields = {"position": np.zeros((3, 3)), "velocity": np.zeros((3, 3)), "yaw": np.zeros(3), "time": np.arange(3.0)}
    with pytest.raises(ValueError, match=message):
        Track(**(fields | changes))
