"""Tracks of a platform and arrays of receivers on it: what simulations and examples start from.

x is along-track, y across-track; z is whatever the caller says (up or down).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray


@dataclass(frozen=True, eq=False)
class Track:
    """Where a platform is at every ping.

    Attributes
    ----------
    position, velocity : (ping, 3) float64
        m and m/s.
    yaw : (ping,) float64
        Heading of the platform's axis about z, rad, 0 along +x.
    time : (ping,) float64
        s.
    """

    position: FloatArray
    velocity: FloatArray
    yaw: FloatArray
    time: FloatArray


def straight(n_ping: int, spacing: float, *, height: float = 0.0, speed: float = 1.5) -> Track:
    """Straight line along x, centred on x = 0, y = 0, at z = `height`: `spacing` m between pings, `speed` m/s."""
    return perturbed(n_ping, spacing, height=height, speed=speed, sway=0.0, heave=0.0, yaw=0.0)


def perturbed(
    n_ping: int,
    spacing: float,
    *,
    height: float = 0.0,
    speed: float = 1.5,
    sway: float = 0.1,
    heave: float = 0.05,
    yaw: float = 0.01,
    correlation: float = 5.0,
    seed: int = 0,
) -> Track:
    """Straight line with smooth random sway (y), heave (z) and yaw of the given rms (m, m, rad).

    Each motion is a sum of 24 sinusoids along the track with wavelengths from `correlation` up to 8 times that (m), equal
    amplitudes and random phases; `velocity` is its exact derivative at `speed` m/s along x.
    """
    _checks.whole("n_ping", n_ping)
    spacing = _checks.number("spacing", spacing, positive=True)
    speed = _checks.number("speed", speed, positive=True)
    correlation = _checks.number("correlation", correlation, positive=True)
    height = _checks.number("height", height)
    x = (np.arange(n_ping) - (n_ping - 1) / 2) * spacing
    draw = np.random.default_rng(seed)
    waves = 2 * np.pi / (correlation * np.linspace(1, 8, 24))
    motions = []
    for name, rms in (("sway", sway), ("heave", heave), ("yaw", yaw)):
        rms = _checks.number(name, rms, low=0.0)
        phase = waves * x[:, None] + draw.uniform(0, 2 * np.pi, waves.size)
        scale = rms * np.sqrt(2 / waves.size)
        motions.append((scale * np.sin(phase).sum(axis=1), scale * speed * (waves * np.cos(phase)).sum(axis=1)))
    position = np.stack([x, motions[0][0], height + motions[1][0]], axis=1)
    velocity = np.stack([np.full(n_ping, speed), motions[0][1], motions[1][1]], axis=1)
    return Track(position, velocity, motions[2][0], np.arange(n_ping) * spacing / speed)


def circular(
    n_ping: int, radius: float, *, centre: npt.ArrayLike = (0.0, 0.0, 0.0), start: float = 0.0, extent: float = 2 * np.pi,
    speed: float = 1.5,
) -> Track:  # fmt: skip
    """Circle of `radius` m about `centre` (its z is the track's), `extent` rad from `start`, evenly spaced, end left out."""
    _checks.whole("n_ping", n_ping)
    radius = _checks.number("radius", radius, positive=True)
    speed = _checks.number("speed", speed, positive=True)
    middle = _checks.reals("centre", centre, [(3,)])
    extent = _checks.number("extent", extent, positive=True)
    angle = _checks.number("start", start) + extent * np.arange(n_ping) / n_ping
    zero = np.zeros(n_ping)
    position = middle + radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
    velocity = speed * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1)
    time = np.asarray(radius * (angle - angle[0]) / speed, dtype=np.float64)
    return Track(position, velocity, np.asarray(angle + np.pi / 2, dtype=np.float64), time)


def array(track: Track, n_channel: int, spacing: float, *, offset: npt.ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Receivers (ping, channel, 3), m: a uniform line along the platform's axis, centred `offset` from the track.

    `offset` (along, across, z) and the line turn with the platform's yaw.
    """
    if not isinstance(track, Track):
        raise TypeError(f"track={track!r}: expected a pysas.tracks.Track")
    _checks.whole("n_channel", n_channel)
    spacing = _checks.number("spacing", spacing, positive=True)
    along, across, up = _checks.reals("offset", offset, [(3,)])
    place = along + (np.arange(n_channel) - (n_channel - 1) / 2) * spacing
    cos, sin = np.cos(track.yaw)[:, None], np.sin(track.yaw)[:, None]
    z = np.full((track.yaw.size, n_channel), up)
    line = np.stack([place * cos - across * sin, place * sin + across * cos, z], axis=-1)
    return np.asarray(track.position[:, None, :] + line)
