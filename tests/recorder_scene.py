"""Compressed echoes of a recorder's files with one or the other navigation, and where targets are imaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.io
import scipy.io.wavfile

import pysas
from pysas.navigation import Geometry, Poses, euler, geometry

FC, BAND, BED, LEAD = 100e3, 36e3, 20.0, 200
PROUD, LAYOVER = 4, -0.127  # m: what the recording's own description says of the fifth target


def recorded(folder: Path, navigation: str) -> tuple[pysas.Echoes, Geometry]:
    """Compressed echoes, and where the sonar was, as its navigation says."""
    survey = scipy.io.loadmat(folder / "survey.mat")
    fs, c, t0 = (survey[name].item() for name in ("fs", "c", "t_delay"))
    nav, pings = pysas.read_table(folder / navigation), pysas.read_table(folder / "pings.csv")
    arms = pysas.read_table(folder / "levers.csv", text=["name"])["x", "y", "z"]
    adc = np.memmap(folder / "adc.bin", "<i2", "r").reshape(len(pings), len(arms) - 1, -1)
    data, rate = pysas.demodulate(adc, fs, FC, bandwidth=BAND, t0=t0)
    replica = np.pad(scipy.io.wavfile.read(folder / "replica.wav")[1], LEAD)
    pulse, _ = pysas.demodulate(replica, fs, FC, bandwidth=BAND, t0=-LEAD / fs)
    attitude = euler(nav["roll"], nav["pitch"], nav["heading"], degrees=True, source=nav.path)
    poses = Poses.from_geodetic(nav["time"], nav["lat"], nav["lon"], attitude, depth=nav["depth"], source=nav.path)
    span = (t0, t0 + (adc.shape[-1] - 1) / fs)
    where = geometry(poses, pings["time"], tx=arms[0], rx=arms[1:], pulse_centre=0.0, travel_time=span)
    raw = pysas.Echoes(
        data, fs=rate, fc=FC, t0=t0, c=c, tx=where.tx, rx=where.rx, velocity=where.velocity, ping_time=where.ping_time,
        bandwidth=30e3, compressed=False,
    )  # fmt: skip
    return pysas.compress(raw, pulse=pulse, pulse_t0=-LEAD / fs), where


def echoes_of(folder: Path, navigation: str) -> tuple[pysas.Echoes, np.ndarray]:
    """The same, and where targets are imaged."""
    echoes, where = recorded(folder, navigation)
    truth = pysas.read_table(folder / "targets.csv")
    targets = where.frame.from_geodetic(truth["lat"], truth["lon"], truth["depth"])
    targets[PROUD] = [targets[PROUD, 0], targets[PROUD, 1] + LAYOVER, BED]
    return echoes, targets
