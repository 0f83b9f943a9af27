"""The paper's marching in time, Algorithms I and II, carrier kept: every cell of range takes one step of diffraction per shift.

Time runs backwards and in metres, tau = (c/2)(T - t), so that waves move one cell of range per step. A step has the parts of
K. Ito et al., Eqs 9 and 12: F moves one cell, with the data's difference entering at the track; u_tau = F, F_tau = alpha u_xx;
u_tau = q, q_tau = beta u_xx (Algorithm I: beta = 0, without the third part and without q). Kept are u, dz F and dz q.

Cells take from the cell before them alone, so that a tile, some cells over some steps, needs the tile before it in range and
that before it in time: tiles on a diagonal are independent, and the cells that no data have reached are never visited.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from pysas import _pool
from pysas._checks import FloatArray

_TILE = 64  # cells and steps
SCHEMES = ("cn", "euler")

Samples = npt.NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, eq=False)
class Scheme:
    """Coefficients of one implicit part: (I + e H) d = w - H (f u + gamma w), then u += d, w <- s d - (s - 1) w.

    H is the second difference with Neumann ends. With theta^2 = coefficient (dz/dx)^2 and b = theta^2/4: implicit Euler has
    e = f = theta^2, gamma = 0, s = 1; Crank-Nicolson e = b - gamma, f = 2 b, s = 2, with gamma = 1/12 for fourth order in x.
    `inverse` (column,) are the pivots' reciprocals.
    """

    e: float
    f: float
    gamma: float
    s: float
    inverse: FloatArray

    @classmethod
    def of(cls, coefficient: float, ratio: float, columns: int, scheme: str, gamma: float) -> Scheme:
        """For alpha or beta, dz/dx, and gamma = 1/12 or 0 (Euler: 0)."""
        theta2 = coefficient * ratio**2
        e, f, s = (theta2, theta2, 1.0) if scheme == "euler" else (theta2 / 4 - gamma, theta2 / 2, 2.0)
        # pivots p = e + r without the cancellation of 1 + 2 e - e^2/p, which loses the 1 where dz/dx is large
        inverse, r = np.empty(columns), 1.0
        for i in range(columns):
            inverse[i] = 1 / (r if i == columns - 1 else e + r)
            r = 1 + e * r / (e + r)
        return cls(e, f, gamma, s, inverse)

    @property
    def numbers(self) -> FloatArray:
        """What the kernel takes."""
        return np.array([self.e, self.f, self.gamma, self.s])


def march(
    signal: Callable[[int, int], Samples], count: int, cells: int, columns: int, parts: list[Scheme], threads: int
) -> Samples:
    """u (column, cell) after `count` steps.

    Parameters
    ----------
    signal : callable
        signal(first, last): data (last - first, column) at the track at steps first to last - 1, latest echo first.
    count, cells, columns : int
    parts : list of Scheme
        One (Algorithm I) or two (Algorithm II).
    threads : int
        Tiles are independent of it.

    Notes
    -----
    O(columns min(n, cells)) for step n, O(columns cells) memory.
    """
    dtype = signal(0, 0).dtype
    width, edges = min(_TILE, cells), -(-cells // _TILE)
    states = [_State(columns, width, dtype, len(parts)) for _ in range(edges)]
    chunks = -(-count // _TILE)
    flows: dict[int, Samples] = {}
    last = np.zeros((1, columns), dtype=dtype)

    # chunk t enters tile b at diagonal t + b; cells of tile b are silent before chunk b
    for diagonal in range(chunks + edges - 1):
        tiles = [b for b in range(edges) if b <= diagonal - b < chunks]
        if diagonal < chunks:
            first = diagonal * _TILE
            data = signal(first, min(first + _TILE, count))
            flows[-1] = np.diff(data, axis=0, prepend=last)
            last = data[-1:]
        before = dict(flows)

        def task(i: int, tiles: list[int] = tiles, before: dict[int, Samples] = before) -> None:
            flows[tiles[i]] = states[tiles[i]].advance(before[tiles[i] - 1], parts, tiles[i] == 0)

        _pool.run(task, len(tiles), threads)
    return np.concatenate([state.u for state in states], axis=1)[:, :cells]


class _State:
    """u, dz F and dz q of one tile's cells. F lies one place to the right, its first place is what enters."""

    def __init__(self, columns: int, width: int, dtype: np.dtype[Any], parts: int) -> None:
        self.u = np.zeros((columns, width), dtype=dtype)
        self.w = np.zeros((2, columns, width + 1), dtype=dtype)
        self.q = np.zeros((columns, width if parts == 2 else 0), dtype=dtype)
        self.y = np.empty_like(self.u)
        self.done = 0

    def advance(self, inflow: Samples, parts: list[Scheme], first: bool) -> Samples:
        """Take `inflow` (step, column), return what leaves the last cell."""
        real = self.u.real.dtype
        outflow = np.empty_like(inflow)
        a, b = parts[0], parts[-1]
        _pool.call(
            _tile,
            self.u.view(real), self.w.view(real), self.q.view(real), self.y.view(real), inflow.view(real),
            outflow.view(real), a.numbers.astype(real), a.inverse.astype(real), b.numbers.astype(real),
            b.inverse.astype(real), self.done % 2, first,
        )  # fmt: skip
        self.done += len(inflow)
        return outflow


# Kernels: they trust their arguments. Complex numbers are pairs of reals, as all coefficients are real.
@njit(nogil=True, cache=True)
def _solve(u, w, y, numbers, inverse):  # type: ignore[no-untyped-def]
    """y <- the solution d of (I + e H) d = w - H (f u + gamma w)."""
    e, f, gamma = numbers[0], numbers[1], numbers[2]
    n, m = y.shape
    for i in range(n):
        low, high = max(i - 1, 0), min(i + 1, n - 1)
        p = inverse[i]
        for j in range(m):
            of_u = (u[i, j] - u[low, j]) + (u[i, j] - u[high, j])
            of_w = (w[i, j] - w[low, j]) + (w[i, j] - w[high, j])
            y[i, j] = (w[i, j] - (f * of_u + gamma * of_w)) * p
        if i > 0:
            p *= e
            for j in range(m):
                y[i, j] += p * y[i - 1, j]
    for i in range(n - 2, -1, -1):
        p = e * inverse[i]
        for j in range(m):
            y[i, j] += p * y[i + 1, j]


@njit(nogil=True, cache=True)
def _tile(u, w, q, y, inflow, outflow, a, a_inverse, b, b_inverse, parity, first):  # type: ignore[no-untyped-def]
    """March one tile: u (column, 2 cell), w (2, column, 2 cell + 2), flows (step, 2 column)."""
    n, m = u.shape
    wide = q.shape[1] > 0
    for t in range(inflow.shape[0]):
        now, then = w[(parity + t) % 2], w[(parity + t + 1) % 2]
        for i in range(n):
            for j in range(2):
                now[i, j] = inflow[t, 2 * i + j]
                outflow[t, 2 * i + j] = now[i, m + j]  # from the last cell, one step ago
                if first and wide:
                    now[i, j] -= q[i, j]
        _solve(u, now, y, a, a_inverse)
        s, keep = a[3], a[3] - 1
        for i in range(n):
            for j in range(m):
                u[i, j] += y[i, j]
                then[i, j + 2] = s * y[i, j] - keep * now[i, j]
        if wide:
            _solve(u, q, y, b, b_inverse)
            s, keep = b[3], b[3] - 1
            for i in range(n):
                for j in range(m):
                    u[i, j] += y[i, j]
                    q[i, j] = s * y[i, j] - keep * q[i, j]
