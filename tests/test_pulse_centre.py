"""Pulses that leave and come back while the sonar moves: where places must be told for, so that targets are found in place.

Records are exact for every sample: what is heard at t left at the instant te of |q - x0 - v te| + |q - rx(t)| = c (t - te),
whose root is closed. That Doppler scale, coupling and all are in them; nothing of pysas is but the pulse's formula.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import pysas
from pysas.navigation import Frame, Geometry, Poses, euler, geometry, pulse_centre

C, FC, B, FS = 1500.0, 100e3, 20e3, 40e3
TARGET, ARM = np.array([0.0, 30.0, 20.0]), np.array([-0.4, 0.0, 0.1])
PINGS, SPACING, DEPTH = 48, 0.05, 12.0
NEAR, FAR = 0.040, 0.046  # the record without the pulse's length, s
Pulse = Callable[[np.ndarray], np.ndarray]


def record(place: np.ndarray, speed: float, pulse: Pulse, t: np.ndarray) -> np.ndarray:
    """(ping, sample) base-band echoes; `place` (ping, 3) is the transmitter's when the leading edge leaves."""
    v = np.array([speed, 0, 0])
    heard = C * t - np.linalg.norm(TARGET - place[:, None] - v * t[:, None] - ARM, axis=-1)  # = c te + the way out
    away = TARGET - place
    half = C * heard - (away @ v)[:, None]
    square = C**2 - v @ v
    te = (half - np.sqrt(half**2 - square * (heard**2 - np.sum(away**2, axis=-1)[:, None]))) / square
    return np.asarray(pulse(te) * np.exp(2j * np.pi * FC * (te - t)))


def survey(speed: float, centre: float, t: np.ndarray) -> tuple[np.ndarray, Geometry]:
    """Leading edges' places, and navigation's answer for `centre`, where the target is abeam of the middle of the track."""
    middle = -(ARM[0] + speed * (NEAR + FAR) / 2) / 2
    time = (middle + (np.arange(PINGS) - (PINGS - 1) / 2) * SPACING) / speed
    clock = np.arange(time[0] - 1, time[-1] + 1, 0.1)
    zero = 0 * clock
    poses = Poses(clock, np.stack([speed * clock, zero, zero + DEPTH], axis=1), euler(zero, zero, zero))
    place = np.stack([speed * time, 0 * time, 0 * time + DEPTH], axis=1)
    span = (float(t[0]), float(t[-1]))
    return place, geometry(poses, time, tx=(0, 0, 0), rx=ARM, pulse_centre=centre, travel_time=span, frame=Frame())


def along_track_error(speed: float, duration: float, pulse: Pulse, waveform: object, centre: float) -> float:
    """How far the image's peak lies from the target along the track, m."""
    t = NEAR + np.arange(int((FAR - NEAR + duration) * FS)) / FS
    place, found = survey(speed, centre, t)
    raw = pysas.Echoes(
        record(place, speed, pulse, t), fs=FS, fc=FC, tx=found.tx, rx=found.rx, velocity=found.velocity, c=C, t0=NEAR,
        pulse=waveform, bandwidth=B, compressed=False,
    )  # fmt: skip
    step = 2e-3
    grid = pysas.Grid.plane(step * np.arange(-20, 21), TARGET[1] + step * np.arange(-4, 5), TARGET[2])
    level = np.abs(pysas.backproject(pysas.compress(raw), grid, tol=1e-6).data)
    row, column = np.unravel_index(np.argmax(level), level.shape)
    left, top, right = level[row, column - 1 : column + 2]
    return float(grid.axes["x"][column] + step * 0.5 * (left - right) / (left - 2 * top + right))


def test_the_centre_of_an_lfm() -> None:
    """Flat: the mean of t (fc + K u)^2 over u = t - T/2, T/2 + fc B T/6/(fc^2 + B^2/12)."""
    for bandwidth in (20e3, -20e3):
        expected = 0.005 + FC * bandwidth * 0.01 / 6 / (FC**2 + bandwidth**2 / 12)
        assert pulse_centre(pysas.LFM(FC, bandwidth, 0.01)) == pytest.approx(expected, rel=1e-7)
    assert 0.005 + FC * B * 0.01 / 6 / (FC**2 + B**2 / 12) == pytest.approx(0.005 * (1 + 0.2 / (3 + 0.01)), rel=1e-12)


@pytest.mark.parametrize("window", ["rect", "tukey", "taylor"])
def test_the_centre_of_a_waveform_is_that_of_its_pulse(window: str) -> None:
    lfm = pysas.LFM(FC, B, 5e-3, window)
    expected = pulse_centre(lfm)
    t = np.arange(201) / FS
    assert pulse_centre(lfm.waveform(t), FS, FC) == pytest.approx(expected, abs=2e-7)  # 1 micrometre at 5 m/s
    assert pulse_centre(lfm.waveform(t, 95e3), FS, 95e3) == pytest.approx(expected, abs=2e-7)  # 1 micrometre at 5 m/s
    t = np.arange(2501) / 500e3
    real = np.real(lfm.waveform(t) * np.exp(2j * np.pi * FC * t))
    assert pulse_centre(np.round(30000 * real).astype(np.int16), 500e3) == pytest.approx(expected, abs=2e-7)


@pytest.mark.parametrize(("duration", "speed", "limit"), [(2e-3, 2.0, 2e-5), (10e-3, 2.0, 2e-5), (10e-3, 5.0, 3e-5)])
def test_targets_are_found_in_place(duration: float, speed: float, limit: float) -> None:
    """Told for another instant of the pulse, they are off by what the vehicle moves between: v T/2 for the leading edge."""
    lfm = pysas.LFM(FC, B, duration)
    centre = pulse_centre(lfm)
    assert abs(along_track_error(speed, duration, lfm.waveform, lfm, centre)) < limit
    for wrong in (0.0, duration / 2, duration):
        off = along_track_error(speed, duration, lfm.waveform, lfm, wrong)
        assert off == pytest.approx(speed * (wrong - centre), abs=2 * limit)
    assert speed * centre > 100 * limit


def test_down_sweeps_and_fading_pulses_too() -> None:
    duration, speed = 10e-3, 2.0
    down = pysas.LFM(FC, -B, duration, "tukey", 0.2)
    assert abs(along_track_error(speed, duration, down.waveform, down, pulse_centre(down))) < 2e-5
    up = pysas.LFM(FC, B, duration, "tukey", 0.2)

    def fading(t: np.ndarray) -> np.ndarray:
        return np.asarray(up.waveform(t) * np.exp(-3 * t / duration))

    waveform = fading(np.arange(int(duration * FS) + 1) / FS)
    centre = pulse_centre(waveform, FS, FC)
    assert centre < 0.4 * duration
    assert abs(along_track_error(speed, duration, fading, waveform, centre)) < 2e-5


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((np.zeros((2, 3)), 1e5), ValueError, r"pulse: shape \(2, 3\)"),
        ((np.ones(8), None), TypeError, "fs=None"),
        ((np.zeros(8), 1e5), ValueError, "pulse: 8 samples, peak 0"),
        (([1.0, np.nan], 1e5), ValueError, "peak nan"),
        (([1.0 + 0j], 1e5, 1e5), ValueError, "pulse: 1 samples: expected neighbours"),
        ((np.ones(8), 1e5, 1e5), ValueError, "fc=100000.0: real samples"),
        ((np.ones(8, complex), 1e5, -1.0), ValueError, "fc=-1.0"),
        ((np.array(["a"]), 1e5), ValueError, "expected one row of samples"),
    ],
)
def test_rejected(arguments: tuple[object, ...], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        pulse_centre(*arguments)  # type: ignore[arg-type]
