"""Lines for the tests of surveys: a small sonar over noise with point targets, in a store of echoes.

100 kHz, 10 kHz of band, elements of 0.1 m, 10 m above the seabed; slant ranges 12 to 52 m, 1500 m/s. It sways, heaves and yaws.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import pysas
from pysas.navigation import Frame

C, FC, BAND, FS = 1500.0, 100e3, 10e3, 12e3
SPACING, PERIOD, ALTITUDE, DEPTH = 0.1, 0.25, 10.0, 20.0  # m of receivers, s of pings, m, m of the seabed in a frame
HALF_ANGLE = np.deg2rad(6)  # of the beam
FIRST, SAMPLES = 2 * 12 / C, int(2 * 40 / C * FS)


def line(
    path: str | Path,
    *,
    heading: float = 0.3,
    pings: int = 240,
    origin: tuple[float, float] = (1000.0, 2000.0),
    seed: int = 0,
    receivers: int = 6,
    targets: npt.ArrayLike = ((20.0, 25.0), (40.0, 30.0)),
    amplitude: float = 30.0,
    frame: Frame | None = None,
    int16: bool = True,
    **fields: Any,
) -> pysas.Echoes:
    """Write a line's echoes, which have advanced by half the array a ping, and give them back.

    Parameters
    ----------
    path : path
        Ends in .zarr; replaced.
    heading, origin
        Direction of the track, rad from x towards y, and where it begins, m. The sonar looks to port.
    targets : (n, 2)
        Along the track and away from it, m, on the seabed.
    amplitude : float
        Of targets; noise has unit power a sample before its band is cut.
    frame : Frame, optional
        Of the coordinates, which have z down then, the seabed at 20 m; else z is up and the seabed at 0.
    fields
        Of `pysas.Echoes`, such as attrs, instead of the line's own.
    """
    rng = np.random.default_rng(seed)
    along = receivers * SPACING / 2 * np.arange(pings)
    place = np.stack([along, 0.05 * np.sin(along / 3), ALTITUDE + 0.03 * np.sin(along / 2)], axis=1)
    yaw = 5e-3 * np.sin(along / 2.5)
    axis = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    look = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw - 0.3], axis=1)
    rx = place[:, None] + SPACING * (np.arange(receivers) - (receivers - 1) / 2)[:, None] * axis[:, None]
    velocity = np.gradient(place, PERIOD, axis=0)
    frequency = np.fft.fftfreq(SAMPLES, 1 / FS)
    noise = rng.standard_normal((pings, receivers, SAMPLES, 2)).view(complex)[..., 0] / np.sqrt(2)
    spectrum = np.fft.fft(noise)
    for x, y in np.reshape(targets, (-1, 2)):
        to = np.array([x, y, 0.0])
        out = np.linalg.norm(place - to, axis=1)[:, None]
        delay = 2 * out / C
        for _ in range(3):  # receivers move until the echo is there
            there = rx + velocity[:, None] * delay[..., None]
            delay = (out + np.linalg.norm(there - to, axis=-1)) / C
        sine = np.abs(np.sum((to - place) * axis, axis=1))[:, None] / out
        lit = amplitude * (sine <= np.sin(HALF_ANGLE))[..., None]
        spectrum += lit * np.exp(-2j * np.pi * (FC * delay[..., None] + frequency * (delay[..., None] - FIRST)))
    data = np.fft.ifft(spectrum * (np.abs(frequency) <= BAND / 2)).astype(np.complex64)
    cos, sin = np.cos(heading), np.sin(heading)
    turn, start = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.array([*origin, 0.0])
    attrs: dict[str, Any] = {"altitude": ALTITUDE}
    if frame is not None:
        turn, start = np.diag([1.0, -1.0, -1.0]) @ turn, start + [0.0, 0.0, DEPTH]
        attrs["frame"] = dataclasses.asdict(frame)
    own: dict[str, Any] = {
        "fs": FS, "fc": FC, "tx": place @ turn + start, "rx": rx @ turn + start, "velocity": velocity @ turn, "c": C,
        "t0": FIRST, "bandwidth": BAND, "attrs": attrs,
        "beam": pysas.Beam(look @ turn, 0.1, HALF_ANGLE, "fan", 0.5, axis @ turn),
    }  # fmt: skip
    echoes = pysas.Echoes(data, **(own | fields))
    shutil.rmtree(path, ignore_errors=True)
    with pysas.EchoWriter(path, int16=int16) as writer:
        for first in range(0, pings, 16):
            writer.append(echoes[first : first + 16])
    return echoes
