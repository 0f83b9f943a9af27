"""March of the one-way wave equations from the track into the water, one temporal frequency at a time.

With k = 4 pi (fc + f)/c (two-way), u = U exp(-2j pi (fc + f) t) and the plane wave exp(j k z) taken out of U, the equation of
a frequency reads (1 - beta s^2) W_z = -j k alpha s^2 W, s^2 = -d^2/dx^2/k^2. Crank-Nicolson over dz with -d^2/dx^2 =
(I - gamma H)^-1 H/dx^2 (H the second difference with Neumann ends; gamma = 0, or 1/12: fourth order) is

    (I - a H) W+ = (I - conj(a) H) W,    a = gamma + (beta - j alpha k dz/2)/(k dx)^2,

so that W+ = (conj(a)/a) W + (1 - conj(a)/a) (I - a H)^-1 W: one tridiagonal solve and no product; |W| is kept exactly, whatever
dz/dx. Frequencies are the fast axis of every array, so that one loop solves for many of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from numba import njit

from pysas import _pool
from pysas._checks import FloatArray

# alpha and beta of k_z/k = 1 - alpha s^2/(1 - beta s^2): K. Ito et al., Eqs 4 and 6 (65 degrees with all printed digits)
EQUATIONS = {15: (0.5, 0.0), 45: (0.5, 0.25), 65: (0.478242, 0.376370)}

_BLOCK_BYTES = 1 << 18  # of one task's wave: it, the factors and the solution stay in a core's cache
_PART_BYTES = 1 << 25  # of all tasks' parts of the image between two sums

Complex = npt.NDArray[np.complex128]
Block = npt.NDArray[np.complexfloating[Any, Any]]  # (column, frequency)


@dataclass(frozen=True, eq=False)
class Steps:
    """Where the march goes.

    Attributes
    ----------
    length : (n,) float64
        Steps, m; equal ones are equal to the last bit, so that their factors are made once.
    time : (n,) float64
        Two-way travel time from z = 0 to the end of each step, s.
    speed : list of n float or (column,) float64
        Sound speed in each, m/s.
    row : (n,) int
        Row of the image at the end of each step, or -1.
    spread : (n,) float64
        Mean of (spacing of columns at the track)^2/(spacing there)^2 over each step: not 1 where columns are rays.
    """

    length: FloatArray
    time: FloatArray
    speed: Sequence[float | FloatArray]
    row: npt.NDArray[np.int64]
    spread: FloatArray


def one_way_wavenumber(k: FloatArray, sine2: FloatArray, equation: tuple[float, float]) -> FloatArray:
    """k_z - k of the one-way equation, rad/m, at squared sines `sine2`."""
    alpha, beta = equation
    return np.asarray(-k * alpha * sine2 / (1 - beta * sine2))


@dataclass(frozen=True, eq=False)
class March:
    """The march of all frequencies: numbers that no step changes.

    Attributes
    ----------
    frequency : (n,) float64
        fc + f, Hz.
    spacing : float
        Of pings, m.
    equation : (alpha, beta)
    gamma : float
        0, or 1/12 for differences of fourth order.
    threads : int
    fine : int
        Odd: columns of the march for each ping, the middle one at its place.
    """

    frequency: FloatArray
    spacing: float
    equation: tuple[float, float]
    gamma: float
    threads: int
    fine: int = 1

    def factor(self, length: float, speed: float | FloatArray, part: slice, spread: float = 1.0) -> Complex:
        """a (frequency,) of one step."""
        alpha, beta = self.equation
        k = 4 * np.pi * self.frequency[part] * np.mean(1 / np.asarray(speed))
        return np.asarray(self.gamma + (beta - 0.5j * alpha * k * length) * spread / (k * self.spacing / self.fine) ** 2)

    def blocks(self, columns: int, itemsize: int) -> list[slice]:
        """Frequencies of each task: their number depends on nothing but the problem, so that sums do not either."""
        size = max(8, min(64, _BLOCK_BYTES // (columns * self.fine * itemsize) // 8 * 8))
        return [slice(i, min(i + size, self.frequency.size)) for i in range(0, self.frequency.size, size)]

    def enter(self, w: Block, part: slice, speed: float | FloatArray, depth: float, summed: bool) -> Block:
        """Take out of `w` what does not propagate and carry the rest to `depth` at once, through water of one speed.

        Cosines of a DCT-II are the modes that Neumann ends leave; each obeys the one-way equation by a factor. The result has
        `fine` columns for each of `w`. `summed`: with the weight of back-projection but for sqrt(z), see `one_way`.
        """
        k = 4 * np.pi * self.frequency[part] * np.mean(1 / np.asarray(speed))
        k_x = np.pi * np.arange(w.shape[0]) / (w.shape[0] * self.spacing)
        sine2 = (k_x[:, None] / k) ** 2
        wide = sine2 >= 1
        sine2[wide] = 0
        factor = np.exp(1j * depth * one_way_wavenumber(k, sine2, self.equation))
        if summed:
            factor *= np.sqrt(2 * np.pi / k) * np.exp(0.25j * np.pi) / self.spacing * (1 - sine2) ** -0.75
        factor[wide] = 0
        modes = scipy.fft.dct(w, axis=0, workers=1) * (self.fine * factor).astype(w.dtype)
        return np.ascontiguousarray(scipy.fft.idct(modes, n=len(w) * self.fine, axis=0, overwrite_x=True, workers=1))

    def image(self, waves: list[Block], blocks: list[slice], steps: Steps, inside: slice, out: Block) -> None:
        """March the waves of all blocks of frequencies, in place, and add them up at each row of `out` (row, ping inside)."""
        inside = slice(inside.start * self.fine + self.fine // 2, inside.stop * self.fine, self.fine)
        rows = max(1, _PART_BYTES // (len(blocks) * out.shape[1] * 16))
        ends = np.flatnonzero(steps.row >= 0)
        first = 0
        for group in (ends[i : i + rows] for i in range(0, ends.size, rows)):
            chunk = range(first, int(group[-1]) + 1)
            parts = np.zeros((len(blocks), group.size, out.shape[1]), dtype=np.complex128)

            def task(number: int, chunk: range = chunk, parts: Complex = parts) -> None:
                self._march(waves[number], blocks[number], steps, chunk, inside, parts[number])

            _pool.run(task, len(blocks), self.threads)
            out[steps.row[group]] += parts.sum(axis=0)
            first = chunk.stop

    def _march(
        self, w: Block, part: slice, steps: Steps, chunk: range, inside: slice, out: Complex
    ) -> None:  # fmt: skip
        """Some steps of one block of frequencies; `out` (row, column) gets the rows that they end at."""
        solver = Solver(w)
        screen: Block | None = None
        row = 0
        for s in chunk:
            length, speed = float(steps.length[s]), steps.speed[s]
            if length == 0:  # a row where the march begins
                self._row(w, part, steps, s, inside, out[row])
                row += 1
                continue
            same = s > chunk.start and length == steps.length[s - 1] and steps.spread[s] == steps.spread[s - 1]
            if not same or speed is not steps.speed[s - 1]:
                solver.prepare(self.factor(length, speed, part, steps.spread[s]))
                screen = None if np.ndim(speed) == 0 else self._screen(length, np.asarray(speed), part, w.dtype)
            if screen is not None:
                w *= screen
            solver.step(w)
            if screen is not None:
                w *= screen
            if steps.row[s] >= 0:
                self._row(w, part, steps, s, inside, out[row])
                row += 1

    def _row(self, w: Block, part: slice, steps: Steps, s: int, inside: slice, out: Complex) -> None:
        """Sum over frequencies at t = 0, with the plane wave put back."""
        cycles = self.frequency[part] * steps.time[s]
        _pool.call(gather, w[inside], np.exp(2j * np.pi * (cycles - np.rint(cycles))), out)

    def _screen(self, length: float, speed: FloatArray, part: slice, dtype: np.dtype[Any]) -> Block:
        """Half a step's turn by what 1/c differs from its mean over the columns (Strang splitting)."""
        late = length * (1 / speed - np.mean(1 / speed))
        return np.asarray(np.exp(2j * np.pi * late[:, None] * self.frequency[part]), dtype=dtype)


class Solver:
    """Steps of one block: the factors of I - a H and room for a solution."""

    def __init__(self, w: Block) -> None:
        self.g, self.y = np.empty_like(w), np.empty_like(w)
        self.r, self.s = (np.empty(w.shape[1], dtype=w.dtype) for _ in range(2))

    def prepare(self, a: Complex) -> None:
        """Factorise for a (frequency,)."""
        _pool.call(factorise, a, self.g)
        self.r[:] = a.conj() / a
        self.s[:] = (1 - a.conj() / a) / a

    def step(self, w: Block) -> None:
        """One Crank-Nicolson step in place."""
        _pool.call(step, w, self.y, self.g, self.r, self.s)


# Kernels: they trust their arguments.
@njit(nogil=True, cache=True)
def factorise(a, g):  # type: ignore[no-untyped-def]
    """g_i = a/(d_i - a g_(i-1)), d the diagonal of I - a H: Thomas' elimination with the upper diagonal a divided out."""
    n, m = g.shape
    for f in range(m):
        before = 0j
        for i in range(n):
            ends = (1 if i == 0 else 0) + (1 if i == n - 1 else 0)
            before = a[f] / (1 - (2 - ends) * a[f] - a[f] * before)
            g[i, f] = before


@njit(nogil=True, cache=True)
def step(w, y, g, r, s):  # type: ignore[no-untyped-def]
    """w <- r w + s x, where x solves (I - a H) x = a w."""
    n, m = w.shape
    for f in range(m):
        y[0, f] = g[0, f] * w[0, f]
    for i in range(1, n):
        for f in range(m):
            y[i, f] = g[i, f] * (w[i, f] - y[i - 1, f])
    for i in range(n - 1, -1, -1):
        if i < n - 1:
            for f in range(m):
                y[i, f] -= g[i, f] * y[i + 1, f]
        for f in range(m):
            w[i, f] = r[f] * w[i, f] + s[f] * y[i, f]


@njit(nogil=True, cache=True)
def gather(w, phase, out):  # type: ignore[no-untyped-def]
    """out[column] = sum over frequencies of w phase, in float64."""
    for i in range(w.shape[0]):
        total = 0j
        for f in range(w.shape[1]):
            total += w[i, f] * phase[f]
        out[i] = total
