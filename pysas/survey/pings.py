"""Pings of echoes joined."""

from __future__ import annotations

from typing import Any

import numpy as np

from pysas.model.beam import FAN, Beam
from pysas.model.echoes import Echoes

SAME = ("fs", "fc", "bandwidth", "compressed")


def joined(parts: list[Echoes]) -> Echoes:
    """One after the other.

    Raises
    ------
    ValueError
        Different sampling, arrays, or beams but for where they look.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    for other in parts[1:]:
        for name in SAME:
            if getattr(other, name) != getattr(first, name):
                raise ValueError(f"pings: {name}={getattr(other, name)!r} after {getattr(first, name)!r}: expected one of all")
        if other.data.shape[1:] != first.data.shape[1:] or other.dtype != first.dtype:
            found, expected = (f"{e.dtype} of shape (ping, {', '.join(map(str, e.data.shape[1:]))})" for e in (other, first))
            raise ValueError(f"pings: data {found} after {expected}: expected one of all")
        if (other.velocity is None) != (first.velocity is None) or (other.beam is None) != (first.beam is None):
            raise ValueError("pings: velocity or beam given for some of them: expected all or none")
    changes: dict[str, Any] = {name: np.concatenate([getattr(e, name) for e in parts]) for name in ("data", "tx", "rx")}
    changes["t0"] = np.concatenate([e.start_time for e in parts])
    if any(np.ndim(e.c) or e.c != first.c for e in parts):
        changes["c"] = np.concatenate([e.speeds for e in parts])
    if any(e.valid is not None for e in parts):
        changes["valid"] = np.concatenate([e.windows if e.data.ndim == 3 else e.windows[:, 0] for e in parts])
    if first.velocity is not None:
        changes["velocity"] = np.concatenate([_moving(e) for e in parts])
    changes["ping_time"] = None
    if all(e.ping_time is not None for e in parts):
        changes["ping_time"] = np.concatenate([e.ping_time for e in parts if e.ping_time is not None])
    if first.beam is not None:
        changes["beam"] = _joined_beams([(e.beam, e.n_ping) for e in parts if e.beam is not None])
    return first.replace(**changes)


def _moving(echoes: Echoes) -> Any:
    velocity = echoes.receiver_velocity
    return velocity if echoes.data.ndim == 3 or velocity is None else velocity[:, 0]


def _joined_beams(beams: list[tuple[Beam, int]]) -> Beam:
    first = beams[0][0]
    for beam, _ in beams:
        for name in ("shape", "half_angle", "taper", "length"):
            if getattr(beam, name) != getattr(first, name):
                raise ValueError(
                    f"pings: beam {name}={getattr(beam, name)!r} after {getattr(first, name)!r}: expected one of all"
                )
    look = np.concatenate([np.broadcast_to(beam.boresight, (count, 3)) for beam, count in beams])
    axis = None
    if first.shape == FAN:
        axis = np.concatenate([np.broadcast_to(beam.axes, (count, 3)) for beam, count in beams])
    return Beam(look, first.length, first.half_angle, first.shape, first.taper, axis)
