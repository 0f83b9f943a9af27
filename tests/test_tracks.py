"""Tracks: even spacing, stated rms of the motions, velocity as the derivative of position, arrays that turn with yaw."""

import numpy as np
import pytest

from pysas import tracks


def test_straight_is_even_and_centred():
    track = tracks.straight(11, 0.2, height=4.0, speed=2.0)
    assert np.allclose(np.diff(track.position[:, 0]), 0.2) and np.allclose(track.position.mean(axis=0), [0, 0, 4.0])
    assert np.allclose(track.velocity, [2.0, 0, 0]) and np.allclose(np.diff(track.time), 0.1) and not track.yaw.any()


def test_perturbed_has_the_stated_motion():
    track = tracks.perturbed(20000, 0.05, sway=0.3, heave=0.1, yaw=0.02, correlation=4.0, seed=2)
    # 24 incommensurate waves over 1000 m: the rms is within a few per cent of what was asked
    assert np.std(track.position[:, 1]) == pytest.approx(0.3, rel=0.1)
    assert np.std(track.position[:, 2]) == pytest.approx(0.1, rel=0.1)
    assert np.std(track.yaw) == pytest.approx(0.02, rel=0.1)
    # central differences of a wave of length >= 4 m on 0.05 m steps: (2 pi 0.05/4)^2/6 = 1e-3
    slope = (track.position[2:] - track.position[:-2]) / (track.time[2:] - track.time[:-2])[:, None]
    assert np.abs(slope - track.velocity[1:-1]).max() < 2e-3 * np.abs(track.velocity[:, 1:]).max() + 1e-9


def test_seed_decides():
    a, b, c = (tracks.perturbed(50, 0.1, seed=s).position for s in (1, 1, 2))
    assert np.array_equal(a, b) and not np.array_equal(a, c)


def test_circle():
    track = tracks.circular(360, 10.0, centre=(1.0, 2.0, 3.0))
    away = track.position - [1.0, 2.0, 3.0]
    assert np.allclose(np.linalg.norm(away, axis=1), 10) and np.allclose(np.sum(away * track.velocity, axis=1), 0)
    gap = np.linalg.norm(track.position - np.roll(track.position, 1, axis=0), axis=1)
    assert np.allclose(gap, gap[0])  # closed: the last ping is one step before the first


def test_array_turns_with_yaw():
    track = tracks.circular(4, 10.0)  # headings +y, -x, -y, +x
    rx = tracks.array(track, 3, 0.5, offset=(0.1, 0.0, -0.2))
    heading = np.array([[0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 0, 0]], dtype=float)
    along = 0.1 + np.array([-0.5, 0.0, 0.5])
    expected = track.position[:, None] + along[:, None] * heading[:, None] + [0, 0, -0.2]
    assert np.allclose(rx, expected)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: tracks.straight(0, 0.1), ValueError, "n_ping=0"),
        (lambda: tracks.straight(2.0, 0.1), TypeError, "n_ping=2.0"),
        (lambda: tracks.straight(3, -0.1), ValueError, "spacing=-0.1"),
        (lambda: tracks.perturbed(3, 0.1, sway=-1), ValueError, "sway=-1"),
        (lambda: tracks.perturbed(3, 0.1, correlation=0), ValueError, "correlation=0"),
        (lambda: tracks.circular(3, 0), ValueError, "radius=0"),
        (lambda: tracks.circular(3, 1, centre=(0, 0)), ValueError, "centre"),
        (lambda: tracks.array("t", 3, 0.1), TypeError, "track='t'"),
        (lambda: tracks.array(tracks.straight(2, 0.1), 0, 0.1), ValueError, "n_channel=0"),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()
