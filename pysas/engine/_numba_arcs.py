"""Arcs of view angle in Numba: the rule of `pysas.circular.view_weights`. Everything here trusts its arguments."""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

from pysas.engine._numba_reach import RX, TX, off_middle
from pysas.engine.traces import BEAM, NO_BEAM, place

SHAPE, HALF_ANGLE = place(BEAM, "shape"), place(BEAM, "half_angle")
TURN = 2 * np.pi
COINCIDENT = 1e-9  # rad: views nearer than this are one
OPENING = 4.0 * (1 + 1e-6)  # a gap this many times as wide as those beside it is none of the track's own
DOUBT = 1.1  # a gap this near to that may open from one place to the next
NOWHERE = 1e-12  # of a bisector: no direction
MOVES = 16  # a view on average, beyond which views are sorted anew


@njit(nogil=True, cache=True)
def _mixed(x):
    """SplitMix64's, of an unsigned number."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(nogil=True, cache=True)
def _look(geometry, beam, point, angle, seen, lit):
    """Angle of every view, whether it has one, and whether its beam holds the point; how many have."""
    count = 0
    beam_cosine, beam_sine = np.cos(beam[HALF_ANGLE]), np.sin(beam[HALF_ANGLE])
    for i in range(geometry.shape[0]):
        g = geometry[i]
        tx, ty, tz = g[TX] - point[0], g[TX + 1] - point[1], g[TX + 2] - point[2]
        rx, ry, rz = g[RX] - point[0], g[RX + 1] - point[1], g[RX + 2] - point[2]
        away, returned = np.sqrt(tx * tx + ty * ty + tz * tz), np.sqrt(rx * rx + ry * ry + rz * rz)
        x, y = tx * returned + rx * away, ty * returned + ry * away
        seen[i] = x * x + y * y > (NOWHERE * away * returned) ** 2
        count += seen[i]
        a = np.arctan2(y, x)
        angle[i] = a + TURN if a < 0 else a
        lit[i] = True
        if beam[SHAPE] != NO_BEAM:
            sine, cosine, side = off_middle(beam[SHAPE], g, -tx, -ty, -tz)
            lit[i] = side and sine * beam_cosine <= cosine * beam_sine  # cosines lose the smallest
    return count


@njit(nogil=True, cache=True)
def _sort(order, angle):
    """Sort views by angle where they nearly are; whether they are now: given up after MOVES of each."""
    left = MOVES * order.size
    for k in range(1, order.size):
        number = order[k]
        to = k
        while to > 0 and angle[order[to - 1]] > angle[number]:
            order[to] = order[to - 1]
            to -= 1
        order[to] = number
        left -= k - to
        if left < 0:
            return False
    return True


@njit(nogil=True, cache=True)
def _shares(gaps, channels):
    """Arc of each group of views, whether the gap behind it is an opening, and whether any of that is in doubt."""
    n = gaps.size
    arcs, openings = np.ones(n), np.zeros(n, dtype=np.bool_)
    if n < 3:
        return arcs, openings, False
    steps = min(2 * channels + 2, (n - 1) // 2)
    # the widest of `steps` gaps from each on, by windows of twice the length again and again
    widest = np.empty(n + steps)
    widest[:n] = gaps
    widest[n:] = gaps[:steps]
    length = 1
    while length < steps:
        more = min(length, steps - length)
        for i in range(n + steps - more):
            widest[i] = max(widest[i], widest[i + more])
        length += more
    doubtful = False
    half = np.empty(n)
    for i in range(n):
        limit = OPENING * min(widest[(i - steps) % n], widest[(i + 1) % n])
        openings[i] = gaps[i] > limit
        doubtful = doubtful or (limit / DOUBT < gaps[i] < limit * DOUBT)
        half[i] = 0.0 if openings[i] else gaps[i] / 2
    alone = False
    for i in range(n):
        arcs[i] = (half[i] + half[i - 1]) * (2 if openings[i] or openings[i - 1] else 1)
        alone = alone or arcs[i] == 0
    if alone:
        others = arcs[arcs > 0]
        arcs[arcs == 0] = np.median(others) if others.size else 1.0
    return arcs, openings, doubtful


@njit(nogil=True, cache=True)
def arcs(geometry, channels, beam, points, order, out, pattern):
    """Fill `out` (point, kept) with arcs of traces `order` and `pattern` (point,) with what arcs.hpp says of it."""
    n = geometry.shape[0]
    angle, value = np.empty(n), np.empty(n)
    seen, lit = np.zeros(n, dtype=np.bool_), np.empty(n, dtype=np.bool_)
    turned = np.empty(0, dtype=np.int64)
    group = np.empty(n, dtype=np.int64)
    gaps = np.empty(n)
    for p in range(points.shape[0]):
        count = _look(geometry, beam, points[p], angle, seen, lit)
        if count == 0:
            out[p] = 0
            pattern[p] = 0
            continue
        if count == n == turned.size:  # a neighbour's order, but for where it begins
            turned = np.roll(turned, -np.argmin(angle[turned]))
        if count < n or turned.size < n or not _sort(turned, angle):
            some = np.flatnonzero(seen)
            turned = some[np.argsort(angle[some])]
        found = 0
        for k in range(count):
            after = angle[turned[k + 1]] if k + 1 < count else angle[turned[0]] + TURN
            group[k] = found
            gap = after - angle[turned[k]]
            if gap > COINCIDENT:
                gaps[found] = gap
                found += 1
        size = np.zeros(found)
        for k in range(count):
            group[k] %= found  # those behind the last gap are one with the first
            size[group[k]] += 1
        arc, openings, doubtful = _shares(gaps[:found], channels)
        value[:] = 0
        for k in range(count):
            value[turned[k]] = arc[group[k]] / size[group[k]]
        total, number = 0.0, 0
        for i in range(n):
            if seen[i] and lit[i]:
                total += value[i]
                number += 1
        if number == 0:
            total, number = value.sum(), count
        mean = max(total / number, 1e-300)
        for k in range(order.size):
            out[p, k] = value[order[k]] / mean
        pattern[p] = 0
        if count == n and not doubtful:
            # around the circle from the first trace's group on; within a group traces have no order
            parts = np.zeros(found, dtype=np.uint64)
            first = 0
            for k in range(n):
                parts[group[k]] += _mixed(np.uint64(turned[k]))
                if turned[k] == 0:
                    first = group[k]
            mixed = np.uint64(found)
            for i in range(found):
                g = (first + i) % found
                mixed = _mixed(mixed ^ (parts[g] + np.uint64(1 if openings[g] else 0)))
            pattern[p] = mixed | np.uint64(1)
