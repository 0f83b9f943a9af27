"""A line of a survey: noise of the band and point targets, on any heading, written as a file of echoes."""

import json
import zlib
from pathlib import Path

import numpy as np

import pysas

C, FC, BAND, FS, ALTITUDE, FIRST, LAST = 1500.0, 100e3, 8e3, 12e3, 10.0, 12.0, 40.0  # m/s, Hz, Hz, Hz, m, and slant ranges in m
TARGETS = np.array([[15.0, 18.0], [31.3, 25.2], [52.0, 21.1]])  # m along the line from its first ping, and to port of it


def tree(folder):
    """Every file of a store, by its name in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(Path(folder).rglob("*")) if path.is_file()}


def line(
    path, heading=0.3, pings=240, origin=(1000.0, 2000.0), seed=0, receivers=6, sides="port", int16=False, raw=False,
    speeds=False, gap=0.0, nan=(), far=LAST,
):  # fmt: skip
    """Write echoes of a line that sways, heaves and yaws, and return them.

    `speeds`: a sound speed for each ping; `gap`: m without pings in the middle of the line; `nan`: pings without numbers;
    `far`: slant range that is recorded, m.
    """
    rng = np.random.default_rng(seed)
    x = 0.05 * receivers * np.arange(pings)
    x[pings // 2 :] += gap
    place = np.stack([x, 0.05 * np.sin(x / 3), ALTITUDE + 0.03 * np.sin(x / 2)], axis=1)
    yaw = 5e-3 * np.sin(x / 2.5)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    look = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=1) if sides == "port" else np.array([0.0, 0.0, -1.0])
    arms = 0.1 * (np.arange(receivers) - (receivers - 1) / 2)
    turn = np.array([[np.cos(heading), np.sin(heading), 0], [-np.sin(heading), np.cos(heading), 0], [0, 0, 1]])  # of rows
    at = np.array([*origin, 0.0])
    pulse = pysas.LFM(FC, BAND, 3e-3, "taylor")
    echoes = pysas.simulate(
        np.column_stack([TARGETS, np.zeros(len(TARGETS))]) @ turn + at, np.full(len(TARGETS), 3.0), pulse, tx=place @ turn + at,
        rx=(place[:, None] + arms[:, None] * ahead[:, None]) @ turn + at, velocity=np.gradient(place, 0.25, axis=0) @ turn,
        fs=FS, t0=2 * FIRST / C, duration=2 * (far - FIRST) / C, c=C + 5 * np.sin(x / 9) if speeds else C, threads=1,
        beam=pysas.Beam(look @ turn, 0.1, np.radians(6), "fan", 0.5, ahead @ turn), attrs={"altitude": ALTITUDE},
    )  # fmt: skip
    if not raw:
        echoes = pysas.compress(echoes, threads=1)
    noise = np.fft.fft(rng.standard_normal((*echoes.data.shape, 2)).view(complex)[..., 0])
    noise *= np.abs(np.fft.fftfreq(echoes.n_sample)) <= BAND / 2 / FS
    data = np.asarray(echoes.data + np.fft.ifft(noise), dtype=np.complex64)
    data[list(nan)] = np.nan
    echoes = echoes.replace(data=data)
    if Path(path).suffix != ".zarr":
        pysas.save(path, echoes)
        return echoes
    with pysas.EchoWriter(path, int16=int16) as writer:
        for first in range(0, pings, 48):
            writer.append(echoes[first : first + 48])
    return echoes


def changed(store, **changes):
    """Attributes of a store other than they were, with their checksum."""
    path = store / "zarr.json"
    group = json.loads(path.read_bytes())
    attributes = {name: value for name, value in (group["attributes"] | changes).items() if name != "crc32"}
    text = json.dumps(attributes, sort_keys=True, separators=(",", ":"))
    path.write_text(json.dumps(group | {"attributes": attributes | {"crc32": zlib.crc32(text.encode())}}))
