"""The demonstration's scene: a six-receiver strip on a swaying track over targets and a textured seabed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pysas import tracks
from pysas._checks import FloatArray
from pysas.model.beam import Beam
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.pulse import LFM
from pysas.signal.simulation import Element, simulate

CHANNELS = 6
_DEPTH = 6.0
_NEAR, _FAR = 19.0, 36.0
_PATCH = (-4.6, 22.4, 3.2, 2.6)  # left, bottom, width, height of the textured patch, m


def grid() -> Grid:
    """The plane z = 0, 12 m by 12 m, every 2 cm."""
    return Grid.plane(np.arange(-300, 301) * 0.02, np.arange(1000, 1601) * 0.02, 0.0)


def echoes(
    pings: int = 150,
    channels: int = CHANNELS,
    seed: int = 1,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Echoes:
    """Raw echoes of the scene with 30 dB signal-to-noise ratio; its targets are in attrs["truth_position"]."""
    pulse = LFM(100e3, 30e3, 2e-3, "tukey", 0.1)
    c, fs, spacing, size = 1500.0, 40e3, 0.025, 0.05
    # receivers twice as far apart as their phase centres; consecutive pings continue the line of phase centres
    advance = channels * spacing / 2
    start = (-advance * (pings - 1) / 2, 0.0, 0.0)
    track = tracks.perturbed(
        pings, advance, height=_DEPTH, start=start, sway=0.06, heave=0.03, yaw=0.004, correlation=3.0, seed=seed
    )
    rx = tracks.array(track, channels, spacing, offset=(0.3, 0.0, -0.05))
    points, amplitudes, targets = _scene(seed)
    middle = (_NEAR + _FAR) / 2
    boresight = (0.0, np.sqrt(1 - (_DEPTH / middle) ** 2), -_DEPTH / middle)
    face = Element(size, boresight=boresight)
    raw = simulate(
        points,
        amplitudes,
        pulse,
        tx=track.position,
        rx=rx,
        fs=fs,
        duration=2 * (_FAR - _NEAR) / c + pulse.duration,
        c=c,
        t0=2 * _NEAR / c,
        velocity=track.velocity,
        tx_element=face,
        rx_element=face,
        snr_db=10.0,
        seed=seed,
        threads=threads,
        progress=progress,
        ping_time=track.time,
        attrs={
            "title": "pysas demo: six receivers, swaying track, targets and a textured seabed",
            "axes": "x along-track, y across-track, z up; seabed z = 0",
            "altitude": _DEPTH,
            "truth_position": points[:targets],
            "truth_amplitude": amplitudes[:targets].real,
        },
    )
    # of a face without height, which lights all depressions: first nulls lie at 17 degrees, first side lobes' peaks at 25
    return raw.replace(beam=Beam(np.array(boresight), size, float(np.radians(25.0))))


def _scene(seed: int) -> tuple[FloatArray, FloatArray, int]:
    """Points, amplitudes, and how many of the first points are targets."""
    draw = np.random.default_rng(seed)
    left, bottom, width, height = _PATCH
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-5.2, 5.2, 7), np.linspace(21.0, 31.2, 6)))
    x, y = x + draw.uniform(-0.3, 0.3, x.size), y + draw.uniform(-0.3, 0.3, y.size)
    clear = (x < left - 0.3) | (x > left + width + 0.3) | (y < bottom - 0.3) | (y > bottom + height + 0.3)
    targets = np.stack([x, y, np.zeros_like(x)], axis=1)[clear]
    strong = draw.choice([1.0, 0.7, 0.5], len(targets))
    count = 9000
    u, v = draw.uniform(0, width, count), draw.uniform(0, height, count)
    # a hull with a cross-beam: weak scatterers inside, no shadow
    along, across = u - width / 2, v - height / 2
    turned, aside = along * 0.9 + across * 0.43, across * 0.9 - along * 0.43
    hull = (turned / 1.15) ** 2 + (aside / 0.36) ** 2 < 1
    mast = (np.abs(turned - 0.15) < 0.16) & (np.abs(aside) < 0.75)
    weak = np.where(hull | mast, 0.02, 1.0)
    texture = 0.05 * weak * (draw.standard_normal(count) + 1j * draw.standard_normal(count))
    floor = np.stack([left + u, bottom + v, np.zeros(count)], axis=1)
    return np.concatenate([targets, floor]), np.concatenate([strong.astype(np.complex128), texture]), len(targets)
