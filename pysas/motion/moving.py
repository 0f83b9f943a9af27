"""Echoes of a corrected track: transmitters, receivers, velocity and beam move together."""

from __future__ import annotations

import dataclasses

import numpy as np

from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import FAN
from pysas.model.echoes import Echoes

_MODERATE = 20  # powers of 2
VELOCITIES = ("follow", "keep")


def centres(echoes: Echoes) -> FloatArray:
    """(ping, 3) means of each ping's phase centres, halfway between transmitter and receivers, at transmission, m: what a
    correction shifts, and what it turns the array about."""
    return np.asarray((echoes.tx + echoes.receivers.mean(axis=1)) / 2)


def scaled(data: ComplexArray) -> ComplexArray:
    """Times the power of 2 that brings its largest part to between 1/2 and 1, unless its squares and fourth powers are numbers
    as they are."""
    peak = max(float(max(np.max(part, initial=0.0), -np.min(part, initial=0.0))) for part in (data.real, data.imag))
    exponent = -int(np.frexp(peak)[1])
    if abs(exponent) <= _MODERATE:
        return data
    half = data.real.dtype.type(2.0) ** (exponent // 2)  # one factor may be beyond what the type holds
    return np.asarray(data * half * data.real.dtype.type(2.0) ** (exponent - exponent // 2))


def times(echoes: Echoes) -> FloatArray | None:
    """(ping,) s: when pings were sent, by `ping_time`, else by the way from ping to ping and the velocity; None where neither
    tells."""
    if echoes.ping_time is not None:
        return echoes.ping_time
    velocity = echoes.receiver_velocity
    if velocity is None or echoes.n_ping < 2:
        return None
    speed = np.linalg.norm(velocity.mean(axis=1), axis=1)
    way = np.linalg.norm(np.diff(centres(echoes), axis=0), axis=1)
    mean = (speed[1:] + speed[:-1]) / 2
    if not np.all(mean > 0):
        return None
    return np.concatenate([[0.0], np.cumsum(way / mean)])


def moved(
    echoes: Echoes, shift: FloatArray, turn: FloatArray, velocity: str = "follow", pivot: FloatArray | None = None
) -> Echoes:
    """Echoes whose pings' arrays are shifted, and turned about their phase centres' mean or another place.

    Parameters
    ----------
    echoes : Echoes
    shift : (ping, 3)
        In m.
    turn : (ping,)
        About z, from +x towards +y, rad.
    velocity : "follow" or "keep"
        Whether the velocity came from the claimed track, and so changes by what the correction does from ping to ping, or was
        measured by itself. "follow" needs to know when pings were sent; without a velocity (stop-and-hop) nothing follows.
    pivot : (ping, 3), optional
        What the arrays turn about, m: of several sides of a sonar one place. Default: `centres` of these echoes.
    """
    pivot = centres(echoes) if pivot is None else pivot
    cosine, sine = np.cos(turn), np.sin(turn)

    def turned(vectors: FloatArray) -> FloatArray:
        over = (slice(None),) + (None,) * (vectors.ndim - 2)
        x, y = vectors[..., 0], vectors[..., 1]
        c, s = cosine[over], sine[over]
        return np.stack([c * x - s * y, s * x + c * y, vectors[..., 2]], axis=-1)

    tx = pivot + shift + turned(echoes.tx - pivot)
    arms = turned(echoes.receivers - pivot[:, None])
    rx = (pivot + shift)[:, None] + arms
    speeds, when = echoes.receiver_velocity, times(echoes)
    if speeds is not None and velocity == "follow" and when is not None and echoes.n_ping > 1:
        rate = np.gradient(shift, when, axis=0)
        spin = np.gradient(turn, when)
        swing = spin[:, None, None] * np.stack([-arms[..., 1], arms[..., 0], np.zeros(arms.shape[:2])], axis=-1)
        speeds = speeds + rate[:, None] + swing
        if echoes.data.ndim == 2:
            speeds = speeds[:, 0]
    else:
        speeds = echoes.velocity
    beam = echoes.beam
    if beam is not None:
        look = turned(np.broadcast_to(beam.boresights, (echoes.n_ping, 3)))
        axis = None if beam.shape != FAN else turned(np.broadcast_to(beam.axes, (echoes.n_ping, 3)))
        beam = dataclasses.replace(beam, boresight=look, axis=axis)
    return echoes.replace(tx=tx, rx=rx.reshape(echoes.rx.shape), velocity=speeds, beam=beam)
