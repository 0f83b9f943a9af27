"""Weights uniform in view angle, as the engines take them: arcs of views on a lattice of places, cubics between these.

The rule is the one `pysas.circular.view_weights` states and computes pixel by pixel; here it is written for many places at
a time. No choices: the planner says what error the lattice may have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from pysas import _pool as pool
from pysas._checks import FloatArray
from pysas.grid import Grid
from pysas.scene import Scene

COINCIDENT = 1e-9  # rad: views nearer than this are one
OPENING = 4.0  # a gap this many times as wide as those beside it is none of the track's own
LEAST = 1024  # places a lattice may have however small the image is
PLACES = 100  # pixels a place: what a place costs is about 2/3 of theirs then, seldom needed
BYTES = 2**28
NODES = 5  # of polynomials along lines
CHECKED = 32  # pixels that the error is measured at
AT_ONCE = 2**18  # views of a task


@dataclass(frozen=True)
class Lattice:
    """Weights of all traces at places (x0 + i dx, y0 + j dy) about the scene's centre.

    value : (ny, nx, trace) float32; axes : (5,) x0, y0, dx, dy, m, and how long lines may be, m, for a polynomial
    through NODES places along them to hold as well; error : measured rms difference of weights from their arcs, by their
    mean; kept : whether it is what was asked.
    """

    value: npt.NDArray[np.float32]
    axes: FloatArray
    error: float
    kept: bool

    @property
    def longest(self) -> float:
        """Of lines, m."""
        return float(self.axes[4])

    def of(self, order: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.float32], FloatArray]:
        """Some traces', as the C++ engine takes them."""
        return np.ascontiguousarray(self.value[..., order]), self.axes


def lattice(scene: Scene, grid: Grid, error: float, beyond: float, stretch: float, threads: int) -> Lattice:
    """A lattice over the image and `beyond` m around, whose weights are within `error` where that many places can be had.

    `stretch` : m, of the lines that the kernels sum at a time.
    """
    low, high = scene.low[:2] - beyond, scene.high[:2] + beyond
    height = float((scene.bottom + scene.top) / 2)
    most = int(min(max(LEAST, scene.pixels / PLACES), max(16, BYTES / (4 * scene.traces))))
    points = _sample(scene, grid)
    exact = arcs(scene, points, threads)
    mean = np.maximum(exact.mean(axis=1, keepdims=True), 1e-300)
    step = max(float(np.max(high - low)), 1e-3)
    least = float(np.sqrt(np.prod(np.maximum(high - low, 1e-3)) / most))
    while True:
        # a cell more on each side: cubics go through four places
        cells = np.maximum(np.ceil((high - low) / step - 1e-9).astype(int), 1)
        spacing = np.maximum((high - low) / cells, 1e-3)
        axes = [low[k] + spacing[k] * np.arange(-1, cells[k] + 2) for k in (0, 1)]
        y, x = np.meshgrid(axes[1], axes[0], indexing="ij")
        places = np.stack([x, y, np.full_like(x, height)], axis=-1)
        value = arcs(scene, places.reshape(-1, 3), threads).astype(np.float32).reshape(*x.shape, -1)
        found = Lattice(value, np.array([axes[0][0], axes[1][0], *spacing]), 0.0, True)
        wrong = _rms((read(found, points[:, :2]) - exact) / mean)
        wanted = step * min(0.7, 0.9 * (error / max(wrong, 1e-300)) ** 0.25)  # it is of fourth order
        if wrong <= error or step <= least or wanted < least / 4:  # met, or out of reach
            break
        step = max(least, wanted, step / 4)
    along = np.zeros(3)
    along[:2] = 1 if scene.lines is None else scene.lines[1][len(scene.lines[1]) // 2][:2]
    along *= stretch / max(float(np.linalg.norm(along)), 1e-300)
    nodes = np.linspace(-1, 1, NODES)
    at, fifth = 0.8, [np.prod((0.8 - np.delete(nodes, k)) / (nodes[k] - np.delete(nodes, k))) for k in range(NODES)]
    through = sum(f * arcs(scene, points + x / 2 * along, threads) for f, x in zip(fifth, nodes, strict=True))
    bent = _rms((through - arcs(scene, points + at / 2 * along, threads)) / mean)
    longest = stretch * (error / max(bent, 1e-300)) ** (1 / NODES)
    return Lattice(value, np.append(found.axes, longest), wrong, wrong <= error)


def read(lattice: Lattice, places: FloatArray) -> npt.NDArray[np.float32]:
    """Weights (place, trace) at places (place, 2); beyond the lattice those of its edge."""
    value = lattice.value
    first, factors = [], []
    for k, n in ((0, value.shape[1]), (1, value.shape[0])):
        u = np.clip((places[:, k] - lattice.axes[k]) / lattice.axes[2 + k], 0, n - 1)
        begin = np.clip(u.astype(int) - 1, 0, n - 4)
        a, b, c, d = (u - begin - i for i in range(4))
        first.append(begin)
        factors.append(np.stack([-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6]).astype(np.float32))
    out = np.zeros((len(places), value.shape[2]), dtype=np.float32)
    for j in range(4):
        for i in range(4):
            out += (factors[1][j] * factors[0][i])[:, None] * value[first[1] + j, first[0] + i]
    return out


def arcs(scene: Scene, points: FloatArray, threads: int = 1) -> FloatArray:
    """Arcs of view angle (point, trace) that the traces stand for at points about the scene's centre.

    Their mean over the traces within whose beam a point lies is 1; the others' arcs are what they would be there. O(point
    trace log trace).
    """
    out = np.empty((len(points), scene.traces))
    rows = max(1, AT_ONCE // scene.traces)

    def some(task: int) -> None:
        part = slice(task * rows, (task + 1) * rows)
        out[part] = _arcs_at(scene, points[part])

    pool.run(some, -(-len(points) // rows), threads)
    return out


def _arcs_at(scene: Scene, points: FloatArray) -> FloatArray:
    g = scene.geometry
    there = [g[:, k] - points[:, k, None] for k in range(3)]
    back = [g[:, 3 + k] - points[:, k, None] for k in range(3)]
    away, returned = (np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2) for d in (there, back))
    turn = np.arctan2(there[1] * returned + back[1] * away, there[0] * returned + back[0] * away)
    turn[turn < 0] += 2 * np.pi
    order = np.argsort(turn, axis=1, kind="stable")
    sorted_turn = np.take_along_axis(turn, order, axis=1)
    gaps = np.diff(sorted_turn, append=sorted_turn[:, :1] + 2 * np.pi, axis=1)
    distinct = gaps > COINCIDENT
    found = np.empty_like(gaps)
    plain = distinct.all(axis=1)
    found[plain] = _shares(gaps[plain], scene.channels)
    for row in np.flatnonzero(~plain):
        # a group of coincident views ends where the next gap is; those behind the last gap belong to the first group
        ends = np.flatnonzero(distinct[row])
        if not ends.size:
            found[row] = 1.0
            continue
        group = np.searchsorted(ends, np.arange(gaps.shape[1])) % ends.size
        found[row] = (_shares(gaps[row, ends][None], scene.channels)[0] / np.bincount(group))[group]
    out = np.empty_like(found)
    np.put_along_axis(out, order, found, axis=1)
    counted = np.ones(out.shape, dtype=np.bool_)
    if scene.cos_beam > -1:
        counted = -(there[0] * g[:, 9] + there[1] * g[:, 10] + there[2] * g[:, 11]) >= scene.cos_beam * away
        counted |= ~counted.any(axis=1, keepdims=True)
    mean = np.sum(out, axis=1, where=counted) / counted.sum(axis=1)
    return np.asarray(out / np.maximum(mean, 1e-300)[:, None])


def _shares(gaps: FloatArray, channels: int) -> FloatArray:
    """Arc of each view (row, view) from the gaps that follow the views around the circle."""
    n = gaps.shape[1]
    if n < 3:
        return np.ones_like(gaps)
    steps = min(2 * channels + 2, (n - 1) // 2)
    widest = scipy.ndimage.maximum_filter1d(gaps, steps, axis=1, mode="wrap")  # of the gaps from i - steps // 2 on
    before, behind = np.roll(widest, steps - steps // 2, axis=1), np.roll(widest, -1 - steps // 2, axis=1)
    opening = gaps > OPENING * np.minimum(before, behind)
    after = np.where(opening, 0.0, gaps / 2)
    arc = after + np.roll(after, 1, axis=1)
    arc[opening | np.roll(opening, 1, axis=1)] *= 2
    lone = arc == 0
    for row in np.flatnonzero(lone.any(axis=1)):
        arc[row, lone[row]] = np.median(arc[row, ~lone[row]]) if not lone[row].all() else 1.0
    return np.asarray(arc)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _sample(scene: Scene, grid: Grid) -> FloatArray:
    """Some of the pixels wanted, about the scene's centre."""
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    some = np.random.default_rng(0).choice(wanted, min(CHECKED, wanted.size), replace=False)
    return grid.coordinates(np.sort(some)) - scene.origin
