"""Navigation of a recorder's files against the echoes in them, which were computed by another program.

In that simulation all of a pulse leaves from where the transmitter is at its leading edge: pulse_centre is 0 here. Samples are
mixed and compressed by a few lines of NumPy and SciPy; delays are written out below.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.signal

import pysas
from pysas.navigation import Geometry, Poses, euler, geometry

FS, FC, B, STEP = 500e3, 100e3, 30e3, 10
PROUD = 4  # the target that stands 0.4 m above the bed
ISOLATED = (0, 3, 4, 5)  # the other two have nearly one range


@dataclass(frozen=True)
class Recording:
    samples: np.ndarray  # (ping, channel, sample)
    replica: np.ndarray
    c: float
    delay: float
    geometry: Geometry
    targets: np.ndarray  # (target, 3) in its frame


def recording(folder: Path, nav: str) -> Recording:
    nav_table, pings = pysas.read_table(folder / nav), pysas.read_table(folder / "pings.csv")
    arms = pysas.read_table(folder / "levers.csv", text=["name"])["x", "y", "z"]
    lat, lon, depth, roll, pitch, heading = (nav_table[name] for name in ("lat", "lon", "depth", "roll", "pitch", "heading"))
    attitude = euler(roll, pitch, heading, degrees=True, source=nav)
    poses = Poses.from_geodetic(nav_table["time"], lat, lon, attitude, depth=depth, source=nav)
    survey = scipy.io.loadmat(folder / "survey.mat")
    c, delay = float(survey["c"].item()), float(survey["t_delay"].item())
    samples = np.fromfile(folder / "adc.bin", "<i2").reshape(110, 16, 2600)
    span = (delay, delay + (samples.shape[-1] - 1) / FS)
    found = geometry(poses, pings["time"], tx=arms[0], rx=arms[1:], pulse_centre=0.0, travel_time=span, source="pings.csv")
    truth = pysas.read_table(folder / "targets.csv")
    targets = found.frame.from_geodetic(truth["lat"], truth["lon"], truth["depth"])
    return Recording(samples, survey["replica"].ravel().astype(float), c, delay, found, targets)


def travel_time(made: Recording, target: np.ndarray) -> np.ndarray:
    """(ping, channel): c tau = |q - tx| + |q - rx - v tau|, by fixed points that gain a factor c/v a step."""
    out = np.linalg.norm(target - made.geometry.tx, axis=-1)[:, None]
    tau = 2 * out / made.c
    for _ in range(6):
        tau = (out + np.linalg.norm(target - made.geometry.rx - made.geometry.velocity * tau[..., None], axis=-1)) / made.c
    return np.asarray(tau)


def echoes_about(made: Recording, target: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """(ping, channel, lag): the record's matched filter at predicted travel time + lag, its turns taken back."""
    n = 4096  # more than the record and the replica, so that nothing wraps round
    f = np.fft.fftfreq(n, 1 / FS)
    band = np.flatnonzero((f > FC - 20e3) & (f < FC + 20e3))
    spectrum = np.fft.fft(made.samples, n)[..., band] * np.conj(np.fft.fft(scipy.signal.hilbert(made.replica), n)[band])
    there = np.exp(2j * np.pi * f[band] * (travel_time(made, target) - made.delay)[..., None])
    return np.asarray(spectrum * there @ np.exp(2j * np.pi * np.outer(f[band], lags)))


@pytest.fixture(scope="module")
def good(data_dir: Path) -> Recording:
    return recording(data_dir / "recorder", "nav.csv")


def test_echoes_come_when_the_geometry_says(good: Recording) -> None:
    """All 1760 traces added where each is predicted: the peak within 0.6 % of the resolution 1/B, phases alike in every trace.

    What is left, 0.07 rad or 0.08 mm of slant range, is nearly the same for all targets.
    """
    lags = np.arange(-4, 5) * 3e-6
    for i in ISOLATED:
        found = echoes_about(good, good.targets[i], lags)
        level = np.abs(found.sum(axis=(0, 1)))
        k = int(np.argmax(level))
        left, top, right = level[k - 1 : k + 2]
        off = lags[k] + 3e-6 * 0.5 * (left - right) / (left - 2 * top + right)
        assert abs(off) < 6e-3 / B
        now = found[..., lags.size // 2]
        assert np.abs(now.sum()) / np.abs(now).sum() > 0.95
        assert abs(np.angle(now.sum())) < 0.1


def test_navigation_without_its_sway_does_not_say_so(good: Recording, data_dir: Path) -> None:
    bad = recording(data_dir / "recorder", "nav_bad.csv")
    for i in ISOLATED:
        now = echoes_about(bad, bad.targets[i], np.zeros(1))
        assert np.abs(now.sum()) / np.abs(now).sum() < 0.3


def test_the_track_and_its_frame(good: Recording) -> None:
    """38 m at 1.75 m/s heading 37 degrees, 12 m deep; the bed is at 20 m, to starboard."""
    found = good.geometry
    assert np.degrees(found.frame.heading) == pytest.approx(37.0, abs=0.1)
    assert np.ptp(found.tx[:, 0]) == pytest.approx(38.1, abs=0.1) and np.abs(found.tx[:, 1]).max() < 0.5
    assert found.tx[:, 2].mean() == pytest.approx(12.1, abs=0.1)
    np.testing.assert_allclose(found.velocity[..., 0], 1.75, atol=0.01)
    assert found.receiver_error < 5e-6
    assert np.all(good.targets[:, 1] > 20)
    np.testing.assert_allclose(good.targets[:, 2], [20, 20, 20, 20, 19.6, 20], atol=1e-4)


def base_band(samples: np.ndarray, first: float) -> np.ndarray:
    t = first + np.arange(samples.shape[-1]) / FS
    taps = scipy.signal.firwin(201, 22e3, fs=FS)
    mixed = 2 * samples * np.exp(-2j * np.pi * FC * t)
    taps = taps.reshape((1,) * (samples.ndim - 1) + (-1,))
    return np.asarray(scipy.signal.fftconvolve(mixed, taps, mode="same", axes=-1)[..., ::STEP], dtype=np.complex64)


def test_targets_are_imaged_in_place(good: Recording) -> None:
    """At the bed's depth those on it within 0.2 mm; the proud one where its range is, 127 mm nearer across-track."""
    g, span = good.geometry, 0.12
    raw = pysas.Echoes(
        base_band(good.samples, good.delay), fs=FS / STEP, fc=FC, tx=g.tx, rx=g.rx, velocity=g.velocity, c=good.c,
        t0=good.delay, pulse=base_band(good.replica, 0.0), bandwidth=B, compressed=False,
    )  # fmt: skip
    echoes = pysas.compress(raw)
    step = 3e-3
    axis = np.arange(-span, span + step / 2, step)
    for i, target in enumerate(good.targets):
        expected = target - [0, 0.127, 0] if i == PROUD else target
        level = np.abs(pysas.focus(echoes, pysas.Grid.plane(expected[0] + axis, expected[1] + axis, 20.0), tol=1e-4).data)
        row, column = np.unravel_index(np.argmax(level), level.shape)

        def refined(three: np.ndarray) -> float:
            left, top, right = three
            return float(step * 0.5 * (left - right) / (left - 2 * top + right))

        x = axis[column] + refined(level[row, column - 1 : column + 2])
        y = axis[row] + refined(level[row - 1 : row + 2, column])
        assert (abs(x), abs(y)) < (2e-3, 1e-3) if i == PROUD else max(abs(x), abs(y)) < 2e-4
