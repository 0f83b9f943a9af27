"""The steps of fast factorised back-projection on either engine: tables, leaves, merge, read, direct sums. See docs/ffbp.md.

`Compiled` hands them to C++, `Interpreted` to Numba's kernels on worker threads. Tasks own what they write and every sum has
one order, so that the image is the same for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _pool as pool
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import _numba, _numba_tree, native, summation
from pysas.engine.preparation import Interpolator
from pysas.engine.summation import Survey
from pysas.engine.traces import reals
from pysas.engine.tree import SubImages, Taps

BoolArray = npt.NDArray[np.bool_]
Single = npt.NDArray[np.float32]
Tick = Callable[[float], None] | None
Terms = tuple[tuple[float, ...], tuple[float, ...]]
COLUMNS = 256  # of a sub-image smoothed across its rays at a time
RAYS = 8  # of a parent at a time


@dataclass(frozen=True)
class Setting:
    """What all steps share: taps, turns of the carrier a metre of range, sine and cosine of the sums and of the tree."""

    taps: Taps
    wave: float
    trigonometry: Terms
    carrier: Terms
    threads: int
    isa: str


@dataclass(frozen=True)
class Stack:
    """How pixels off a sub-image's plane are read from it: at their range and place along its group's axis (3,).

    They weigh what the polynomial through values on all `heights` (m), of which this plane's is `number`, has of it.
    """

    axis: FloatArray
    heights: FloatArray
    number: int


Lines = tuple[FloatArray, FloatArray]  # first pixel and step of each


@dataclass
class Compiled:
    """The steps in C++; `room` traces at most have tables at a time."""

    setting: Setting
    reader: native.Reader
    room: int
    table: FloatArray = field(init=False)
    rows: FloatArray = field(init=False)
    tree: Any = field(init=False)

    def __post_init__(self) -> None:
        s, taps = self.setting, self.setting.taps
        self.table = native.empty_table(self.reader, self.room, np.float32)
        self.nodes, self.fit = native.nodes(5)
        self.tree = native.core().Tree(
            taps.even, taps.odd, taps.tap, taps.filter, s.wave, s.carrier[0], s.carrier[1], self.nodes, self.fit
        )

    def prepare(
        self, traces: ComplexArray, part: npt.NDArray[np.int64], survey: Survey, kept: BoolArray, scale: float
    ) -> None:  # fmt: skip
        """Tables of traces `part`, zeros for those not `kept`."""
        self.rows = self.table[: part.size]
        native.fill(
            traces, part, survey.start, survey.weights, scale, self.reader, self.rows, self.setting.threads, self.setting.isa
        )
        self.rows[~kept] = 0

    def leaves(self, survey: Survey, level: SubImages, store: Single, slack: float, smooth: bool, tick: Tick) -> None:
        """Sums of the prepared traces at leaves' nodes, filtered across, and along where `smooth`.

        Phase factors may be wrong by `slack`.
        """
        s = self.setting
        native.core().leaves(
            self.tree, self.rows, self.reader.filter.degree, s.trigonometry[0], s.trigonometry[1], survey.trace,
            survey.model, survey.kind, level.span, level.place, level.shape, level.range, survey.lattice, store, slack, smooth,
            s.threads, s.isa, tick,
        )  # fmt: skip

    def merge(
        self, children: SubImages, below: Single, parent: SubImages, store: Single, add: bool, last: bool, top: bool
    ) -> None:
        """A parent from some of its children; `last`: filtered across; `top`: filtered along."""
        native.core().merge(
            self.tree, np.array([0, len(children)]), children.place, children.shape, children.range, below, parent.place,
            parent.shape, parent.range, store, add, last, top, self.setting.threads, self.setting.isa, None,
        )  # fmt: skip

    def read(
        self, top: SubImages, store: Single, lines: Lines | None, points: FloatArray | None, stack: Stack | None,
        mask: BoolArray | None, count: int, tiles: BoolArray, image: ComplexArray,
    ) -> None:  # fmt: skip
        """Add a sub-image at the pixels of `tiles`: of lines on its plane, or of points (line, pixel, 3) near it."""
        first, step = (None, None) if lines is None else lines
        axis, heights, number = (None, None, 0) if stack is None else (stack.axis, stack.heights, stack.number)
        native.core().read(
            self.tree, top.place, top.shape, top.range, store, first, step, points, axis, heights, number, mask, count,
            tiles.astype(np.uint8), image, self.setting.threads, self.setting.isa, None,
        )  # fmt: skip

    def direct(
        self,
        survey: Survey,
        lines: Lines | None,
        points: FloatArray | None,
        pixels: BoolArray,
        count: int,
        image: ComplexArray,
        tick: Tick,
    ) -> int:
        """Add the prepared traces at `pixels` of lines, or of points (1, pixel, 3); how many terms."""
        s = self.setting
        first, step = (None, None) if lines is None else lines
        flat = None if points is None else points[0]
        return int(
            native.core().add(
                self.rows, self.reader.filter.degree, s.trigonometry[0], s.trigonometry[1], survey.trace, survey.model,
                survey.kind, self.nodes, self.fit, first, step, flat, pixels, count, survey.lattice, None, image, s.threads,
                s.isa, tick,
            )
        )  # fmt: skip


@dataclass
class Interpreted:
    """The steps in Numba; `room` traces at most have tables at a time."""

    setting: Setting
    reader: Interpolator
    room: int
    table: npt.NDArray[np.complex64] = field(init=False)
    rows: npt.NDArray[np.complex64] = field(init=False)

    def __post_init__(self) -> None:
        s = self.setting
        self.table = np.empty((self.room, self.reader.intervals, self.reader.degree + 1), dtype=np.complex64)
        self.nodes, self.fit = summation.chebyshev()
        self.half = np.float32(0.5)
        self.sums = tuple(tuple(np.float32(v) for v in terms) for terms in s.trigonometry)
        self.turns = tuple(tuple(np.float32(v) for v in terms) for terms in s.carrier)
        self.pairs = (0,) * ((self.reader.degree + 1) // 2)

    def prepare(
        self, traces: ComplexArray, part: npt.NDArray[np.int64], survey: Survey, kept: BoolArray, scale: float
    ) -> None:  # fmt: skip
        """As Compiled.prepare."""
        self.rows = self.table[: part.size]
        summation.prepare(
            traces, part, survey.start, survey.weights, scale, self.reader, self.rows, self.setting.threads, kept
        )  # fmt: skip

    def leaves(self, survey: Survey, level: SubImages, store: Single, slack: float, smooth: bool, tick: Tick) -> None:
        """As Compiled.leaves."""
        pieces = []
        for i in range(len(level)):
            rays = _ranges(level, i)
            rays = rays[rays[:, 0] < rays[:, 1]]
            if rays.size:
                end = int(rays[:, 1].max())
                pieces += [(i, m, min(m + _numba.BLOCK, end)) for m in range(int(rays[:, 0].min()), end, _numba.BLOCK)]
        geometry, flat = self._numbered(survey)
        model = survey.model.copy()
        model["near"] = 0.0  # leaves have polynomials at any distance that the planner lets them have
        sound = reals(model)
        lattice, axes = survey.weighing()

        def add(task: int) -> None:
            i, begin, end = pieces[task]
            part = slice(level.span[i], level.span[i + 1])
            pool.call(
                _numba_tree.leaf,
                level.place[i], level.shape[i], level.range, begin, end, geometry[part], sound, survey.kind,
                flat, self.nodes, self.fit, self.half, self.sums[0], self.sums[1], self.pairs, self.setting.wave,
                self.turns[0], self.turns[1], lattice[..., part], axes, store,
            )  # fmt: skip

        self._run(add, len(pieces), tick)
        if smooth:
            self._smooth_along(level, store)
        self._smooth_across(level, store)

    def merge(
        self, children: SubImages, below: Single, parent: SubImages, store: Single, add: bool, last: bool, top: bool
    ) -> None:
        """As Compiled.merge."""
        taps = self.setting.taps
        rays = int(parent.shape[0, 1])

        def merge_rays(task: int) -> None:
            pool.call(
                _numba_tree.merge,
                parent.place[0], parent.shape[0], parent.range, store, task * RAYS, min((task + 1) * RAYS, rays),
                children.place, children.shape, below, taps.even, taps.odd, taps.filter, self.setting.wave, self.turns[0],
                self.turns[1], add, top,
            )  # fmt: skip

        self._run(merge_rays, -(-rays // RAYS), None)
        if last:
            self._smooth_across(parent, store)

    def read(
        self, top: SubImages, store: Single, lines: Lines | None, points: FloatArray | None, stack: Stack | None,
        mask: BoolArray | None, count: int, tiles: BoolArray, image: ComplexArray,
    ) -> None:  # fmt: skip
        """As Compiled.read."""
        taps, wanted = self.setting.taps, np.flatnonzero(tiles)
        place, shape = top.place[0], top.shape[0]

        def look(task: int) -> None:
            rows, columns = _tile(int(wanted[task]), image.shape, count)
            active = np.ones(rows.stop - rows.start, np.bool_) if mask is None else mask[rows, columns].any(axis=1)
            if not active.any():
                return
            out = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.complex64)
            pixels, axis, heights, number = np.empty((0, 0, 3)), np.zeros(3), np.empty(0), 0
            blocks = np.zeros((len(out), 6))
            if lines is not None:
                blocks = np.concatenate([lines[0][rows] + columns.start * lines[1][rows], lines[1][rows]], axis=1)
            if points is not None and stack is not None:
                pixels, axis, heights, number = points[rows, columns], stack.axis, stack.heights, stack.number
            pool.call(
                _numba_tree.read,
                place, shape, store, taps.even, taps.odd, self.setting.wave, self.turns[0], self.turns[1], blocks, pixels, axis,
                heights, number, active, out,
            )  # fmt: skip
            image[rows, columns] += out

        self._run(look, len(wanted), None)

    def direct(
        self,
        survey: Survey,
        lines: Lines | None,
        points: FloatArray | None,
        pixels: BoolArray,
        count: int,
        image: ComplexArray,
        tick: Tick,
    ) -> int:
        """As Compiled.direct."""
        geometry, flat = self._numbered(survey)
        model = reals(survey.model)
        tiles = -(-image.shape[0] // _numba_tree.ROWS) * -(-image.shape[1] // count)
        counted = np.zeros(tiles, dtype=np.int64)

        def add(task: int) -> None:
            rows, columns = _tile(task, image.shape, count)
            active = pixels[rows, columns].any(axis=1)
            if not active.any():
                return
            width = columns.stop - columns.start
            blocks, coords = np.zeros((rows.stop - rows.start, 6)), np.empty((0, 3))
            if lines is not None:
                blocks = np.concatenate([lines[0][rows] + columns.start * lines[1][rows], lines[1][rows]], axis=1)
            if points is not None:
                coords = points[rows, columns].reshape(-1, 3)
            out = np.zeros((len(blocks), width), dtype=np.complex64)
            counted[task] = pool.call(
                _numba.sum_tile,
                coords, blocks, lines is not None, active, geometry, model, survey.kind, flat,
                summation.places(out.shape[1], np.float32), self.nodes, self.fit, self.half, self.sums[0], self.sums[1],
                self.pairs, *survey.weighing(), out,
            )  # fmt: skip
            image[rows, columns] += out

        self._run(add, tiles, tick)
        return int(counted.sum())

    def _numbered(self, survey: Survey) -> tuple[FloatArray, Single]:
        """Traces numbered by their first interval, and the table that this counts in."""
        return summation.numbered(survey.trace, self.reader.intervals), self.rows.reshape(-1).view(np.float32)

    def _run(self, task: Callable[[int], None], count: int, tick: Tick) -> None:
        pool.run(task, count, self.setting.threads, None if tick is None else lambda done: tick(done / max(count, 1)))

    def _smooth_along(self, level: SubImages, store: Single) -> None:
        rays = [(i, ray) for i in range(len(level)) for ray in range(int(level.shape[i, 1]))]

        def smooth(task: int) -> None:
            i, ray = rays[task]
            pool.call(_numba_tree.smooth_along, level.shape[i], level.range, self.setting.taps.filter, ray, store)

        self._run(smooth, len(rays), None)

    def _smooth_across(self, level: SubImages, store: Single) -> None:
        pieces = [
            (i, m, min(m + COLUMNS, int(level.shape[i, 2])))
            for i in range(len(level))
            for m in range(0, int(level.shape[i, 2]), COLUMNS)
        ]

        def smooth(task: int) -> None:
            i, begin, end = pieces[task]
            pool.call(_numba_tree.smooth_across, level.shape[i], level.range, self.setting.taps.filter, begin, end, store)

        self._run(smooth, len(pieces), None)


def _ranges(level: SubImages, i: int) -> npt.NDArray[np.int32]:
    first = int(level.shape[i, 4])
    return level.range[first : first + int(level.shape[i, 1])]


def _tile(number: int, shape: tuple[int, ...], count: int) -> tuple[slice, slice]:
    """Lines and pixels of a tile."""
    down, across = divmod(number, -(-shape[1] // count))
    top, left = down * _numba_tree.ROWS, across * count
    return slice(top, min(top + _numba_tree.ROWS, shape[0])), slice(left, min(left + count, shape[1]))


def steps(setting: Setting, reader: native.Reader | Interpolator, room: int) -> Compiled | Interpreted:
    """The steps on the engine that a reader belongs to."""
    return Compiled(setting, reader, room) if isinstance(reader, native.Reader) else Interpreted(setting, reader, room)
