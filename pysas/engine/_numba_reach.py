"""Whether pixels lie outside, inside or across a trace's window and beam, in Numba. Everything here trusts its arguments."""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

from pysas.engine.traces import BEAM, CONE, MODEL, NO_BEAM, TRACE, place
from pysas.model.beam import EDGE_ANGLE
from pysas.model.echoes import EDGE

# where the reals of a trace and of the model are, see traces.py
TX, RX, VELOCITY, BORESIGHT, AXIS = (place(TRACE, name) for name in ("tx", "rx", "velocity", "boresight", "axis"))
T0, C, FIRST, LAST, KEPT, INTERVAL = (place(TRACE, name) for name in ("t0", "c", "first", "last", "kept", "interval"))
FC, FS, RATE, NEAR, RUN = (place(MODEL, name) for name in ("fc", "fs", "rate", "near", "run"))
SHAPE, HALF_ANGLE, FULL_ANGLE = (place(MODEL, "beam") + place(BEAM, name) for name in ("shape", "half_angle", "full_angle"))
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
    low = (least / (g[C] + speed) * (1 - 1e-9) - g[T0]) * model[FS]
    high = (most / (g[C] - speed) * (1 + 1e-9) - g[T0]) * model[FS]
    if high < g[FIRST] - EDGE or low > g[LAST] + EDGE:
        return OUTSIDE
    return INSIDE if low >= g[FIRST] + EDGE_MARGIN and high <= g[LAST] - EDGE_MARGIN else ACROSS


@njit(nogil=True, cache=True)
def off_middle(shape, g, x, y, z):
    """|d| sin(alpha) and |d| cos(alpha) of a place d = (x, y, z) from its transmitter, and whether it lies on its beam's side.

    alpha: the angle off a cone's boresight or the plane across a fan's axis.
    """
    along = x * g[BORESIGHT] + y * g[BORESIGHT + 1] + z * g[BORESIGHT + 2]
    first = BORESIGHT if shape == CONE else AXIS
    a, b, c = g[first], g[first + 1], g[first + 2]
    across = np.sqrt((y * c - z * b) ** 2 + (z * a - x * c) ** 2 + (x * b - y * a) ** 2)
    if shape == CONE:
        return across, along, True
    return abs(x * a + y * b + z * c), across, along >= -EDGE_ANGLE * np.sqrt(x * x + y * y + z * z)


@njit(nogil=True, cache=True)
def beam_weight(sine, cosine, full, half):
    """What a term weighs for its beam, where alpha is at most `half`, and its sine and cosine by any one length."""
    # of the difference, which keeps the digits that angles near each other would lose
    beyond = np.arctan2(sine * np.cos(full) - cosine * np.sin(full), cosine * np.cos(full) + sine * np.sin(full))
    return np.cos(np.pi / 2 * min(1.0, max(0.0, beyond / (half - full)))) ** 2


@njit(nogil=True, cache=True)
def _beam(g, model, centre, radius, there):
    """The same of a sphere and the beam, inside where its weight is 1 everywhere; `there`: its centre's distance."""
    shape, half, full = model[SHAPE], model[HALF_ANGLE], model[FULL_ANGLE]
    if shape == NO_BEAM:
        return INSIDE
    if there <= radius * (1 + 1e-9):
        return ACROSS
    x, y, z = centre[0] - g[TX], centre[1] - g[TX + 1], centre[2] - g[TX + 2]
    sine, cosine, _ = off_middle(shape, g, x, y, z)
    if shape == CONE:
        angle, spread = np.arctan2(sine, cosine), np.arcsin(radius / there) + 1e-9
        if angle - spread > half:
            return OUTSIDE
        return ACROSS if angle + spread > full else INSIDE
    reach = radius + 1e-9 * there
    before = x * g[BORESIGHT] + y * g[BORESIGHT + 1] + z * g[BORESIGHT + 2]
    # distances to the double cone about the axis, and to the plane that its side ends with
    if sine * np.cos(half) - cosine * np.sin(half) > reach or before < -reach - EDGE_ANGLE * (there + radius):
        return OUTSIDE
    return INSIDE if cosine * np.sin(full) - sine * np.cos(full) > reach and before > reach else ACROSS


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
    if where == OUTSIDE or model[SHAPE] == NO_BEAM:
        return where
    centre = ((x[0] + x[last]) / 2, (y[0] + y[last]) / 2, (z[0] + z[last]) / 2)
    return _both(where, _beam(g, model, centre, np.sqrt(length2) / 2, _distance(g, TX, centre[0], centre[1], centre[2])))
