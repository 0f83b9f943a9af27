"""The files that the pages of the documentation begin with: a line, a circle, and what a recorder leaves behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import pysas

C, FC, BAND = 1500.0, 100e3, 20e3


def line(folder: Path) -> None:
    """line.npz: 40 pings of 8 receivers with a fan, targets 17 to 21 m away on the plane z = 0."""
    track = pysas.tracks.perturbed(40, spacing=0.16, start=(-3.12, 0, 0), sway=0.02, correlation=2.0, seed=1)
    receivers = pysas.tracks.array(track, 8, 0.04)
    beam = pysas.Beam((0, 1, 0), 0.08, np.deg2rad(7), taper=0.5)
    targets = [[0, 19, 0], [1, 19, 0], [-0.7, 17.8, 0], [0.4, 20.3, 0]]
    pulse = pysas.LFM(FC, BAND, 1e-3, "tukey")
    raw = pysas.simulate(
        targets, [1, 0.7, 0.8, 0.9], pulse, tx=track.position, rx=receivers, fs=40e3, c=C, t0=0.022, duration=0.0085, beam=beam,
        velocity=track.velocity, ping_time=track.time,
    )  # fmt: skip
    pysas.save(folder / "line.npz", raw)


def circle(folder: Path) -> None:
    """circle.npz: a full circle 10 m about a scene, 5 m above it."""
    track = pysas.tracks.circular(400, 10.0, height=5.0)
    pulse = pysas.LFM(50e3, 15e3, 1e-3, "tukey", 0.3)
    raw = pysas.simulate(
        [[0, 0, 0], [0.2, 0.1, 0], [-0.3, 0.25, 0]], [1, 1, 1], pulse, tx=track.position, rx=track.position, fs=40e3,
        t0=0.0138, duration=0.0035,
    )  # fmt: skip
    pysas.save(folder / "circle.npz", raw)


def recording(folder: Path) -> None:
    """adc.bin, replica.npy, tx.npy and rx.npy: one target at (0.2, 20, 0), real samples at 500 kHz."""
    fs, t0 = 500e3, 0.024
    x = np.arange(60) * 0.05 - 1.5
    tx = np.stack([x, 0 * x, 0 * x], axis=1)
    rx = tx[:, None] + np.array([[-0.15, 0, 0], [-0.05, 0, 0], [0.05, 0, 0], [0.15, 0, 0]])
    pulse = pysas.LFM(FC, BAND, 1e-3, "tukey")
    raw = pysas.simulate([[0.2, 20, 0]], [1.0], pulse, tx=tx, rx=rx, fs=fs, c=C, t0=t0, duration=0.006)
    t = t0 + np.arange(raw.n_sample) / fs
    real = (raw.data * np.exp(2j * np.pi * FC * t)).real
    np.round(8000 * real).astype("<i2").tofile(folder / "adc.bin")
    lead = np.arange(500) / fs
    np.save(folder / "replica.npy", (pulse.waveform(lead, FC) * np.exp(2j * np.pi * FC * lead)).real)
    np.save(folder / "tx.npy", tx)
    np.save(folder / "rx.npy", rx)


def navigation(folder: Path) -> None:
    """nav.csv at 10 Hz and pings.csv: a track to the north-east at 1.5 m/s."""
    time = np.arange(0, 30, 0.1)
    frame = pysas.navigation.Frame(heading=np.deg2rad(45), lat=54.2, lon=7.9)
    lat, lon, depth = frame.to_geodetic(np.stack([1.5 * time, 0.02 * np.sin(time), 12 + 0 * time], axis=1))
    roll, pitch, heading = 0.5 * np.sin(time), 0.2 * np.cos(time), 45 + 0.3 * np.sin(time / 2)
    columns = [time, lat, lon, depth, roll, pitch, heading]
    np.savetxt(
        folder / "nav.csv", np.column_stack(columns), "%.12g", ",", header="time,lat,lon,depth,roll,pitch,heading", comments=""
    )
    np.savetxt(folder / "pings.csv", np.arange(2, 25, 0.2), "%.12g", header="time", comments="")
