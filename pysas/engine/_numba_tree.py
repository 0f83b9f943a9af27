"""Kernels of fast factorised back-projection in Numba: sub-images are smoothed and read. See docs/ffbp.md.

Places and phases are in float64, weights and sums in float32. Everything here trusts its arguments.
"""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

from pysas.engine._numba import _FAST, _polynomial

TAPS = 8
TURN = 2 * np.pi


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def smooth(filter, apart, begin, end, source, out):
    """Filter places [begin, end) of nodes that lie `apart` from their neighbours; what reaches beyond the nodes is left."""
    half = (filter.size - 1) * apart
    begin, end = max(begin, half), min(end, source.size - half)
    for m in range(begin, end):
        out[m] = filter[0] * source[m]
    for k in range(1, filter.size):
        f, to = filter[k], out[begin:end]
        below, above = source[begin - k * apart : end - k * apart], source[begin + k * apart : end + k * apart]
        for m in range(to.size):
            to[m] += f * (below[m] + above[m])


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _weigh(tap, x, out):
    """Weights `out` (tap, place) at places `x`, see tree.Taps."""
    for t in range(TAPS):
        to = out[t]
        for m in range(x.size):
            to[m] = tap[TAPS, t]
        for p in range(TAPS - 1, -1, -1):
            c = tap[p, t]
            for m in range(x.size):
                to[m] = to[m] * x[m] + c


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _locate(line, centre, polar, wave, ray, node, xr, xn, cycles):
    """Rays and nodes that a line of pixels is read between, where, and its carrier's turns there."""
    low, angle, beam, near, step, height = polar
    # angles are counted from that of the line's middle
    x, y = line[0] + (ray.size - 1) / 2 * line[3] - centre[0], line[1] + (ray.size - 1) / 2 * line[4] - centre[1]
    away, behind = np.sqrt(x * x + y * y), np.arctan2(y, x) - low
    ex, ey = x / away, y / away
    for m in range(ray.size):
        x, y = line[0] + m * line[3] - centre[0], line[1] + m * line[4] - centre[1]
        ground = np.sqrt(x * x + y * y)
        t = (y * ex - x * ey) / (ground + x * ex + y * ey)
        s = t * t
        # arctan of |t| < 0.26, to 6e-12: half the angle
        tail = 1.0 / 9 + s * (-1.0 / 11 + s * (1.0 / 13 - s / 15))
        bearing = behind + 2 * t * (1.0 + s * (-1.0 / 3 + s * (1.0 / 5 + s * (-1.0 / 7 + s * tail))))
        p = (bearing - TURN * np.floor(bearing / TURN) + low - angle) / beam
        q = (ground - near) / step
        turns = wave * np.sqrt(ground * ground + height * height)
        i, j = np.floor(p), np.floor(q)
        ray[m], node[m] = np.int32(i), np.int32(j)
        xr[m], xn[m] = p - i - 0.5, q - j - 0.5
        cycles[m] = turns - np.floor(turns + 0.5)


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _gather(store, row, across, m, first, total):
    """Sum of nodes from place `first` on of so many rows, `row` reals each, weighted: all rows at once, which makes vectors."""
    a0, a1, a2, a3 = across[0, m], across[1, m], across[2, m], across[3, m]
    a4, a5, a6, a7 = across[4, m], across[5, m], across[6, m], across[7, m]
    k0 = np.uintp(first)
    k1, k2, k3, k4 = k0 + np.uintp(row), k0 + np.uintp(2 * row), k0 + np.uintp(3 * row), k0 + np.uintp(4 * row)
    k5, k6, k7 = k0 + np.uintp(5 * row), k0 + np.uintp(6 * row), k0 + np.uintp(7 * row)
    for n in range(2 * TAPS):
        i = np.uintp(n)
        front = (a0 * store[k0 + i] + a1 * store[k1 + i]) + (a2 * store[k2 + i] + a3 * store[k3 + i])
        total[i] = front + ((a4 * store[k4 + i] + a5 * store[k5 + i]) + (a6 * store[k6 + i] + a7 * store[k7 + i]))


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def read(store, nodes, centre, polar, tap, wave, sines, cosines, lines, active, out):
    """Add what a sub-image's rows of `nodes` hold (real and imaginary parts in turn) at a tile's pixels lines[r, :3] + m
    lines[r, 3:] on its plane to `out` (line, pixel)."""
    rows, count = out.shape
    ray, node, cycles = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, store.dtype)
    xr, xn = np.empty(count, store.dtype), np.empty(count, store.dtype)
    across, along = np.empty((TAPS, count), store.dtype), np.empty((TAPS, count), store.dtype)
    total = np.empty(2 * TAPS, store.dtype)
    for r in range(rows):
        if not active[r]:
            continue
        _locate(lines[r], centre, polar, wave, ray, node, xr, xn, cycles)
        _weigh(tap, xr, across)
        _weigh(tap, xn, along)
        for m in range(count):
            first = (np.int64(ray[m]) - TAPS // 2 + 1) * nodes + node[m] - TAPS // 2 + 1
            _gather(store, 2 * nodes, across, m, 2 * first, total)
            re, im = total[0] * along[0, m], total[1] * along[0, m]
            for t in range(1, TAPS):
                re += total[2 * t] * along[t, m]
                im += total[2 * t + 1] * along[t, m]
            q = cycles[m] * cycles[m]
            sine, cosine = cycles[m] * _polynomial(sines, q), _polynomial(cosines, q)
            out[r, m] += complex(re * cosine - im * sine, re * sine + im * cosine)
