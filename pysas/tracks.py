"""Tracks of the sonar and lines of receivers: geometry to simulate with, and to state what a survey looked like.

Axes: x along-track, y across-track; yaw turns the platform about z, from +x towards +y, so its along-track axis is
(cos yaw, sin yaw, 0). A track holds one position per ping, at the instant of transmission, with the velocity that belongs
to it: `simulate(..., tx=track.position, rx=array(track, ...), velocity=track.velocity)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from pysas import _checks
from pysas._checks import FloatArray

__all__ = ["Track", "array", "circular", "inertial", "perturbed", "straight"]

_HARMONICS = 64


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """Where the platform is at each transmission.

    Parameters
    ----------
    position, velocity : (ping, 3)
        In m and m/s.
    yaw : (ping,)
        Heading of the along-track axis, rad, from +x towards +y.
    time : (ping,)
        Time of each transmission, s, not decreasing.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or dtype, or non-finite; the message names the field and the ping.
    """

    position: FloatArray
    velocity: FloatArray
    yaw: FloatArray
    time: FloatArray

    def __post_init__(self) -> None:
        position = _checks.reals("position", self.position, [("ping", 3)], ("ping",))
        n = position.shape[0]
        if n == 0:
            raise ValueError("position: no pings: expected at least one")
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "velocity", _checks.reals("velocity", self.velocity, [(n, 3)], ("ping",)))
        object.__setattr__(self, "yaw", _checks.reals("yaw", self.yaw, [(n,)], ("ping",)))
        time = _checks.reals("time", self.time, [(n,)], ("ping",))
        if np.any(np.diff(time) < 0):
            ping = int(np.argmax(np.diff(time) < 0)) + 1
            raise ValueError(f"time: {time[ping]:g} s at ping {ping} after {time[ping - 1]:g} s: expected not decreasing")
        object.__setattr__(self, "time", time)

    @property
    def n_ping(self) -> int:
        """Number of pings."""
        return int(self.position.shape[0])

    def __repr__(self) -> str:
        length = float(np.sum(np.linalg.norm(np.diff(self.position, axis=0), axis=1)))
        return f"Track({self.n_ping} pings over {length:.4g} m in {self.time[-1] - self.time[0]:.4g} s)"


def straight(
    n_ping: int, spacing: float, height: float = 0.0, speed: float = 1.5, start: Sequence[float] = (0.0, 0.0, 0.0)
) -> Track:
    """A straight track along +x at constant speed.

    Parameters
    ----------
    n_ping : int
        Number of pings.
    spacing : float
        Advance per ping, m, > 0.
    height : float
        Added to the z of `start`, m.
    speed : float
        In m/s, > 0; sets `time` and `velocity`.
    start : (3,)
        Position of the first ping (before `height`), m.

    Returns
    -------
    Track

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; the message names it.
    """
    return perturbed(n_ping, spacing, height, speed, start)


def perturbed(
    n_ping: int,
    spacing: float,
    height: float = 0.0,
    speed: float = 1.5,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    sway: float = 0.0,
    heave: float = 0.0,
    yaw: float = 0.0,
    surge: float = 0.0,
    crab: float = 0.0,
    correlation: float = 10.0,
    seed: int = 0,
) -> Track:
    """A straight track with smooth random sway, heave, yaw and surge, repeatable by `seed`.

    Each is rms sqrt(2/M) sum_m cos(kappa_m s + phi_m) over M = 64 harmonics in the along-track distance s, with random
    phases phi_m and one wavenumber kappa_m drawn in each of M equally likely slices of a Gaussian of standard deviation
    1/correlation. The spectrum is that Gaussian; the autocorrelation is rms^2 exp(-s^2 / (2 correlation^2)). The velocity
    is the exact derivative of the position.

    Parameters
    ----------
    n_ping, spacing, height, speed, start
        As for `straight`; `speed` is that along x.
    sway, heave : float
        Displacement in y and in z, rms over many tracks, m. On a track much longer than `correlation` its own rms.
    yaw : float
        Heading, rms, rad. It turns the platform, not the track.
    surge : float
        Displacement in x from even spacing, rms, m.
    crab : float
        Constant heading, rad, to which `yaw` adds: the platform does not point where it goes.
    correlation : float
        Correlation length, m, > 0.
    seed : int
        Sway, heave, yaw and surge draw independently: changing one leaves the others.

    Returns
    -------
    Track

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; the message names it.

    Notes
    -----
    O(64 n_ping) time and memory.
    """
    n = _checks.whole("n_ping", n_ping)
    spacing = _checks.number("spacing", spacing, positive=True)
    speed = _checks.number("speed", speed, positive=True)
    correlation = _checks.number("correlation", correlation, positive=True)
    crab = _checks.number("crab", crab)
    asked = (("sway", sway), ("heave", heave), ("yaw", yaw), ("surge", surge))
    motion = {name: _checks.number(name, value, low=0.0) for name, value in asked}
    streams = np.random.SeedSequence(_checks.whole("seed", seed, low=0)).spawn(len(motion))
    s = spacing * np.arange(n, dtype=np.float64)
    (y, vy), (z, vz), (heading, _), (x, vx) = (
        _harmonics(s, rms, correlation, stream) for rms, stream in zip(motion.values(), streams, strict=True)
    )
    position = _place("start", start, height) + np.stack([s + x, y, z], axis=1)
    velocity = speed * np.stack([1 + vx, vy, vz], axis=1)
    return Track(position, velocity, crab + heading, s / speed)


def circular(
    n_ping: int,
    radius: float,
    centre: Sequence[float] = (0.0, 0.0, 0.0),
    height: float = 0.0,
    start_angle: float = 0.0,
    extent: float = 2 * np.pi,
    speed: float = 1.5,
) -> Track:
    """A circular track, heading along its tangent.

    Parameters
    ----------
    n_ping : int
        Number of pings, at angles start_angle + extent ping/n_ping: a full circle has no ping twice.
    radius : float
        In m, > 0.
    centre : (3,)
        In m.
    height : float
        Added to the z of `centre`, m.
    start_angle, extent : float
        From +x towards +y, rad; a negative `extent` goes round the other way.
    speed : float
        In m/s, > 0.

    Returns
    -------
    Track

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; the message names it.
    """
    n = _checks.whole("n_ping", n_ping)
    radius = _checks.number("radius", radius, positive=True)
    speed = _checks.number("speed", speed, positive=True)
    start_angle = _checks.number("start_angle", start_angle)
    extent = _checks.number("extent", extent)
    if extent == 0:
        raise ValueError(f"extent={extent!r}: expected a non-zero angle in rad")
    turned = extent * np.arange(n, dtype=np.float64) / n
    angle = start_angle + turned
    yaw = angle + (np.pi / 2 if extent > 0 else -np.pi / 2)
    zero = np.zeros(n)
    position = _place("centre", centre, height) + radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
    velocity = speed * np.stack([np.cos(yaw), np.sin(yaw), zero], axis=1)
    return Track(position, velocity, yaw, radius * np.abs(turned) / speed)


def inertial(
    track: Track,
    speed: float = 5e-3,
    bias: float = 3e-3,
    gyro: float = 1e-5,
    depth: float = 5e-4,
    heading: float = 0.0,
    seed: int = 0,
) -> Track:
    """What an inertial navigation system aided by speed and depth claims that `track` was, repeatable by `seed`.

    From the first ping's true place on, horizontal positions drift by the integral of the speed's error, which is white from
    ping to ping and constant over the time between them; the claimed velocity has the same error. The heading walks away from
    a constant offset; it errs by itself, and does not turn the positions.

    Parameters
    ----------
    track : Track
        The true one.
    speed : float
        Standard deviation of the speed's white error in x and in y, m/s, >= 0.
    bias : float
        That of its constant error in x and in y, m/s, >= 0: one draw for the track.
    gyro : float
        That of a ping's step of the heading's random walk, rad, >= 0; the first ping has none.
    depth : float
        That of the white error of z, m, >= 0; the vertical speed has none.
    heading : float
        Constant error of the heading, claimed less true, rad.
    seed : int
        The four errors draw independently: changing one leaves the others.

    Returns
    -------
    Track

    Raises
    ------
    ValueError, TypeError
        An argument outside its range or of the wrong type; the message names it.

    Notes
    -----
    O(pings) time and memory.
    """
    _track(track)
    asked = (("speed", speed), ("bias", bias), ("gyro", gyro), ("depth", depth))
    sigma = {name: _checks.number(name, value, low=0.0) for name, value in asked}
    heading = _checks.number("heading", heading)
    streams = np.random.SeedSequence(_checks.whole("seed", seed, low=0)).spawn(len(sigma))
    rngs = dict(zip(sigma, map(np.random.default_rng, streams), strict=True))
    n = track.n_ping
    wrong = np.zeros((n, 3))
    wrong[:, :2] = sigma["bias"] * rngs["bias"].standard_normal(2) + sigma["speed"] * rngs["speed"].standard_normal((n, 2))
    drift = np.zeros((n, 3))
    drift[1:] = np.cumsum(wrong[:-1] * np.diff(track.time)[:, None], axis=0)
    drift[:, 2] = sigma["depth"] * rngs["depth"].standard_normal(n)
    walk = np.concatenate([[0.0], np.cumsum(sigma["gyro"] * rngs["gyro"].standard_normal(n - 1))])
    return Track(track.position + drift, track.velocity + wrong, track.yaw + heading + walk, track.time)


def array(track: Track, n_channel: int, spacing: float, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """Receivers in a uniform line along the platform's along-track axis.

    Parameters
    ----------
    track : Track
    n_channel : int
        Number of receivers.
    spacing : float
        Between receivers, m, > 0. Channel 0 is the last in the direction of travel.
    offset : (3,)
        From the track's position to the middle of the line in the platform's axes (along-track, across-track, z), m;
        it turns with the platform.

    Returns
    -------
    (ping, channel, 3) float64
        Positions at the instant of transmission, m.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; the message names it.
    """
    _track(track)
    n = _checks.whole("n_channel", n_channel)
    spacing = _checks.number("spacing", spacing, positive=True)
    along, across, up = _checks.reals("offset", offset, [(3,)])
    forward = along + spacing * (np.arange(n) - (n - 1) / 2)
    cos, sin = np.cos(track.yaw)[:, None], np.sin(track.yaw)[:, None]
    turned = np.stack([cos * forward - sin * across, sin * forward + cos * across, np.full((track.n_ping, n), up)], axis=-1)
    return np.asarray(track.position[:, None, :] + turned)


def _track(value: object) -> None:
    if not isinstance(value, Track):
        raise TypeError(f"track={type(value).__name__}: expected a pysas.tracks.Track")


def _place(name: str, value: npt.ArrayLike, height: float) -> FloatArray:
    place = _checks.reals(name, value, [(3,)])
    return np.asarray(place + np.array([0.0, 0.0, _checks.number("height", height)]))


def _harmonics(s: FloatArray, rms: float, correlation: float, stream: np.random.SeedSequence) -> tuple[FloatArray, FloatArray]:
    """The random displacement at distances `s` and its derivative with respect to s."""
    if rms == 0:
        return np.zeros(s.size), np.zeros(s.size)
    rng = np.random.default_rng(stream)
    kappa = ndtri((np.arange(_HARMONICS) + rng.uniform(0.0, 1.0, _HARMONICS)) / _HARMONICS) / correlation
    phase = rng.uniform(0.0, 2 * np.pi, _HARMONICS)
    angle = np.multiply.outer(s, kappa) + phase
    amplitude = rms * np.sqrt(2 / _HARMONICS)
    return amplitude * np.cos(angle).sum(axis=1), -amplitude * (np.sin(angle) @ kappa)
