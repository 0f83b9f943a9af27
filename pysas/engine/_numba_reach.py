"""Whether pixels lie outside, inside or across a trace's window and beam, in Numba. Everything here trusts its arguments."""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

from pysas.engine.traces import MODEL, TRACE, place
from pysas.model.echoes import EDGE

# where the reals of a trace and of the model are, see traces.py
TX, RX, VELOCITY, BORESIGHT, T0, KEPT, INTERVAL = (
    place(TRACE, name) for name in ("tx", "rx", "velocity", "boresight", "t0", "kept", "interval")
)
C, FC, FS, RATE, LAST, COS_BEAM, NEAR, RUN = (
    place(MODEL, name) for name in ("c", "fc", "fs", "rate", "last", "cos_beam", "near", "run")
)
OUTSIDE, INSIDE, ACROSS = 0, 1, 2
EDGE_MARGIN = 0.01  # samples: nearer to a record's ends every pixel's own delay decides


@njit(nogil=True, cache=True)
def _distance(g, sensor, x, y, z):
    return np.sqrt((x - g[sensor]) ** 2 + (y - g[sensor + 1]) ** 2 + (z - g[sensor + 2]) ** 2)


@njit(nogil=True, cache=True)
def _window(g, model, least, most):
    """Whether distances out and home that sum to `least` to `most` lie outside, inside or across the record's window."""
    speed = np.sqrt(g[VELOCITY] ** 2 + g[VELOCITY + 1] ** 2 + g[VELOCITY + 2] ** 2)
    # one part in 1e9 of slack: rounding must never decide what the exact block should
    low = (least / (model[C] + speed) * (1 - 1e-9) - g[T0]) * model[FS]
    high = (most / (model[C] - speed) * (1 + 1e-9) - g[T0]) * model[FS]
    if high < -EDGE or low > model[LAST] + EDGE:
        return OUTSIDE
    return INSIDE if low >= EDGE_MARGIN and high <= model[LAST] - EDGE_MARGIN else ACROSS


@njit(nogil=True, cache=True)
def _beam(g, model, centre, radius, there):
    """The same of a sphere and the beam; `there`: its centre's distance."""
    if model[COS_BEAM] <= -1.0:
        return INSIDE
    if there <= radius * (1 + 1e-9):
        return ACROSS
    along = 0.0
    for axis in range(3):
        along += (centre[axis] - g[TX + axis]) * g[BORESIGHT + axis]
    angle = np.arccos(min(1.0, max(-1.0, along / there)))
    spread = np.arcsin(radius / there) + 1e-7  # an arc cosine loses half of its digits
    limit = np.arccos(model[COS_BEAM])
    if angle - spread > limit:
        return OUTSIDE
    return ACROSS if angle + spread > limit else INSIDE


@njit(nogil=True, cache=True)
def _both(one, other):
    return OUTSIDE if one == OUTSIDE or other == OUTSIDE else max(one, other)


@njit(nogil=True, cache=True)
def reach(g, model, centre, radius):
    """Whether a sphere lies outside, inside or across the record's window and the beam, and its least distance."""
    there = _distance(g, TX, centre[0], centre[1], centre[2])
    back = _distance(g, RX, centre[0], centre[1], centre[2])
    least = max(there - radius, 0.0) + max(back - radius, 0.0)
    where = _both(_window(g, model, least, there + back + 2 * radius), _beam(g, model, centre, radius, there))
    return where, max(min(there, back) - radius, 0.0)


@njit(nogil=True, cache=True)
def line_reach(g, model, x, y, z):
    """The same of a straight line of pixels, whose ranges differ far less than those of a sphere about it, where it runs
    along the track.
    """
    last = x.size - 1
    ax, ay, az = x[last] - x[0], y[last] - y[0], z[last] - z[0]
    length2 = ax * ax + ay * ay + az * az
    least = most = 0.0
    for sensor in (TX, RX):
        dx, dy, dz = x[0] - g[sensor], y[0] - g[sensor + 1], z[0] - g[sensor + 2]
        t = min(1.0, max(0.0, -(dx * ax + dy * ay + dz * az) / length2)) if length2 > 0 else 0.0
        least += np.sqrt((dx + t * ax) ** 2 + (dy + t * ay) ** 2 + (dz + t * az) ** 2)
        most += max(_distance(g, sensor, x[0], y[0], z[0]), _distance(g, sensor, x[last], y[last], z[last]))
    where = _window(g, model, least, most)
    if where == OUTSIDE or model[COS_BEAM] <= -1.0:
        return where
    centre = ((x[0] + x[last]) / 2, (y[0] + y[last]) / 2, (z[0] + z[last]) / 2)
    return _both(where, _beam(g, model, centre, np.sqrt(length2) / 2, _distance(g, TX, centre[0], centre[1], centre[2])))
