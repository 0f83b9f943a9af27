"""Weights uniform in view angle, as the engines take them: arcs of views on a lattice of places, cubics between these.

The rule is the one `pysas.circular.view_weights` states and computes pixel by pixel. Arcs are smooth from place to place
where the views keep their order around the circle; where a line through two phase centres crosses the image they jump,
and every pixel has its own. No choices: the planner says what error the lattice may have.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import Engine
from pysas.model.grid import Grid
from pysas.planning.scene import Scene

LEAST = 1024  # places a lattice may have however small the image is
PLACES = 100  # pixels a place: what a place costs is about 2/3 of theirs then, seldom needed
BYTES = 2**28  # of weights at a time
NODES = 5  # of polynomials along lines, evenly spaced
ALONG, BETWEEN = np.linspace(-1, 1, NODES), 0.8
CHECKED = 32  # pixels that the error is measured at
FEW = 4  # of these places, one in so many for that of lines: its fifth root is all that is used
# and places on each edge of the box about the image, as shares of it: a bisector's angle is a harmonic function of the
# place, and so are its differences and derivatives, which are largest on the edges
EDGES = (0.03, 0.1, 0.27, 0.5, 0.73, 0.9, 0.97)
SHORTEST, LONGEST = 16, 64  # pixels that the kernels look weights up over; of a vector, at most, the least of them
ROUNDED = 1 + 1e-9  # of lengths that are the same

Patterns = npt.NDArray[np.uint64]


@dataclass(frozen=True)
class Lattice:
    """Weights of all traces at places (x0 + i dx, y0 + j dy) about the scene's centre.

    value : (ny, nx, trace) float32; axes : (5,) x0, y0, dx, dy, m, and how long lines may be, m, for a polynomial
    through NODES places along them to hold as well; vector : m that SHORTEST pixels may span, for a quadratic; error : of a
    measured place's weights from its arcs, rms by their mean, at the worst; beyond : m around the image.
    """

    value: npt.NDArray[np.float32]
    axes: FloatArray
    vector: float
    error: float
    beyond: float

    @property
    def longest(self) -> float:
        """Of lines, m."""
        return float(self.axes[4])

    def holds(self, step: float, count: int) -> bool:
        """Whether the kernels may read weights along lines of `count` pixels `step` m apart."""
        return bool(
            step * (max(count, SHORTEST) - 1) <= ROUNDED * self.longest and step * (SHORTEST - 1) <= ROUNDED * self.vector
        )

    def of(self, order: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.float32], FloatArray]:
        """Some traces', as the C++ engine takes them."""
        return np.ascontiguousarray(self.value[..., order]), self.axes


def lattice(
    scene: Scene, grid: Grid, error: float, beyond: float, stretch: float, threads: int, engine: Engine, most: float = 0.0
) -> Lattice | None:
    """A lattice over the image and `beyond` m around, whose weights are within `error` where that many places can be had.

    None where there is none: views change their order, their groups or their openings over the image, or arcs change
    too fast. `stretch` : m, of the lines that the kernels sum at a time. `most` : the error that may remain where beams'
    edges cross the image, and with each view that comes in the mean of the lit ones changes a little.
    """
    beyond = max(beyond, (SHORTEST - 1) * scene.step)
    low, high = scene.low[:2] - beyond, scene.high[:2] + beyond
    height = float((scene.bottom + scene.top) / 2)
    limit = int(min(max(LEAST, scene.pixels / PLACES), max(16, BYTES / (4 * scene.traces))))
    points = np.concatenate([_sample(scene, grid), _edges(low, high, height)])
    exact, patterns = arcs(scene, points, threads, engine)
    if patterns[0] == 0 or np.any(patterns != patterns[0]):
        return None
    mean = np.maximum(exact.mean(axis=1, keepdims=True), 1e-300)
    step = max(float(np.max(high - low)), 1e-3)
    least = float(np.sqrt(np.prod(np.maximum(high - low, 1e-3)) / limit))
    while True:
        # a cell more on each side: cubics go through four places
        cells = np.maximum(np.ceil((high - low) / step - 1e-9).astype(int), 1)
        spacing = np.maximum((high - low) / cells, 1e-3)
        axes = [low[k] + spacing[k] * np.arange(-1, cells[k] + 2) for k in (0, 1)]
        y, x = np.meshgrid(axes[1], axes[0], indexing="ij")
        places = np.stack([x, y, np.full_like(x, height)], axis=-1)
        value, found = arcs(scene, places.reshape(-1, 3), threads, engine)
        alike = found.reshape(x.shape) == patterns[0]
        if not alike[1:-1, 1:-1].all():
            return None
        frame = np.array([axes[0][0], axes[1][0], *spacing])
        lattice = Lattice(value.astype(np.float32).reshape(*x.shape, -1), frame, 0.0, 0.0, beyond)
        # of fourth order, where all places see the views alike
        wrong = _rms((read(lattice, points[:, :2]) - exact) / mean) if alike.all() else np.inf
        wanted = step * (min(0.7, 0.9 * (error / max(wrong, 1e-300)) ** 0.25) if wrong < np.inf else 0.5)
        if wrong <= error or step <= least or wanted < least / 4:  # met, or out of reach
            break
        step = max(least, wanted, step / 4)
    if wrong > max(error, most if scene.beamed else 0.0):
        return None
    # lines as long as the box has room for, where it has; a vector of pixels is a part of the longest
    along = np.ones(2) if scene.lines is None else scene.lines[1][len(scene.lines[1]) // 2][:2]
    along = along / np.linalg.norm(along) if along.any() else np.array([1.0, 0.0])
    room = float(np.min((high - low)[along != 0] / np.abs(along)[along != 0]))
    share = max(error, wrong)
    longest, bent = _held(scene, points[::FEW], (low, high), along, min(stretch, room), share, _quartic, threads, engine)
    vector = min(stretch * (SHORTEST - 1) / (LONGEST - 1), room)
    vector, curved = _held(scene, points[::FEW], (low, high), along, vector, share, _quadratic, threads, engine)
    return Lattice(lattice.value, np.append(lattice.axes, longest), vector, math.hypot(wrong, bent, curved), beyond)


def _held(
    scene: Scene,
    points: FloatArray,
    box: tuple[FloatArray, FloatArray],
    along: FloatArray,
    length: float,
    share: float,
    what: Callable[[FloatArray], FloatArray],
    threads: int,
    engine: Engine,
) -> tuple[float, float]:
    """How long lines through points may be, at most `length`, for `what` their arcs at NODES and a last place are wrong by
    to stay within `share` of their mean, and that error."""
    middle, size = (box[0] + box[1]) / 2, box[1] - box[0]
    while True:
        half = np.append(length / 2 * along, 0.0)
        room = np.maximum(size / 2 - np.abs(half[:2]), 0)
        centres = points.copy()
        centres[:, :2] = np.clip(points[:, :2], middle - room, middle + room)
        value = np.stack([arcs(scene, centres + x * half, threads, engine)[0] for x in (*ALONG, BETWEEN)])
        wrong = _rms(what(value) / value.mean(axis=(0, 2))[:, None])
        if wrong <= share or length < scene.step:
            return length, wrong
        # the order shows only where lines are short beside the distance of the views
        length *= min(0.9, 0.95 * (share / wrong) ** (1 / NODES))


def _quartic(value: FloatArray) -> FloatArray:
    """Of the polynomial through values at NODES, at the place between them where it is worst."""
    factor = [np.prod((BETWEEN - np.delete(ALONG, k)) / (ALONG[k] - np.delete(ALONG, k))) for k in range(NODES)]
    return np.asarray(np.tensordot(factor, value[:NODES], 1) - value[NODES])


def _quadratic(value: FloatArray) -> FloatArray:
    """Of value, slope and curve in the middle, which are all that a vector of pixels takes: rms of the rest of the quartic."""
    odd, even = (value[4] - value[0]) / 2, (value[4] + value[0]) / 2 - value[2]
    third = 4 / 3 * (odd - (value[3] - value[1]))
    fourth = 4 / 3 * (even - 4 * ((value[3] + value[1]) / 2 - value[2]))
    return np.asarray(np.sqrt(third**2 / 7 + fourth**2 / 9))


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


def arcs(scene: Scene, points: FloatArray, threads: int, engine: Engine) -> tuple[FloatArray, Patterns]:
    """Arcs of view angle (point, trace) that the traces stand for at points about the scene's centre, and the views'
    patterns there; see `Engine.arcs`."""
    out = np.empty((len(points), scene.traces))
    return out, fill(scene, points, np.arange(scene.traces), out, threads, engine)


def fill(
    scene: Scene, points: FloatArray, order: npt.NDArray[np.int64], out: npt.NDArray[Any], threads: int, engine: Engine
) -> Patterns:
    """Arcs of traces `order` in `out` (point or more, trace), of its own type, as `arcs`."""
    return engine.arcs(scene.trace, scene.channels, scene.beam, points, order, out, threads)


def _rms(values: FloatArray) -> float:
    """The largest place's."""
    return float(np.sqrt(np.max(np.mean(np.square(values), axis=1))))


def _sample(scene: Scene, grid: Grid) -> FloatArray:
    """Some of the pixels wanted, about the scene's centre."""
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    some = np.random.default_rng(0).choice(wanted, min(CHECKED, wanted.size), replace=False)
    return grid.coordinates(np.sort(some)) - scene.origin


def _edges(low: FloatArray, high: FloatArray, height: float) -> FloatArray:
    """Places on the edges of a box."""
    share = np.array(EDGES)
    x, y = low[0] + share * (high[0] - low[0]), low[1] + share * (high[1] - low[1])
    ends = [np.stack([x, np.full_like(x, end)], axis=1) for end in (low[1], high[1])]
    sides = [np.stack([np.full_like(y, end), y], axis=1) for end in (low[0], high[0])]
    places = np.concatenate(ends + sides)
    return np.concatenate([places, np.full((len(places), 1), height)], axis=1)
