"""The steps of fast factorised back-projection by Numba's kernels on worker threads, see steps.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pysas import _pool as pool
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import _numba, _numba_tree, summation
from pysas.engine.preparation import Interpolator
from pysas.engine.steps import BoolArray, Lines, Setting, Single, Tick
from pysas.engine.survey import Survey
from pysas.engine.traces import BLOCK, TILE_ROWS, reals
from pysas.engine.tree import SubImages

COLUMNS = 256  # of a sub-image smoothed across its rays at a time
RAYS = 8  # of a parent at a time


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
        """As Steps."""
        self.rows = self.table[: part.size]
        summation.prepare(
            traces, part, survey.start, survey.weights, scale, self.reader, self.rows, self.setting.threads, kept
        )  # fmt: skip

    def leaves(self, survey: Survey, level: SubImages, store: Single, slack: float, smooth: bool, tick: Tick) -> None:
        """As Steps."""
        pieces = []
        for i in range(len(level)):
            rays = _ranges(level, i)
            rays = rays[rays[:, 0] < rays[:, 1]]
            if rays.size:
                end = int(rays[:, 1].max())
                pieces += [(i, m, min(m + BLOCK, end)) for m in range(int(rays[:, 0].min()), end, BLOCK)]
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
        """As Steps."""
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
        self, top: SubImages, store: Single, lines: Lines, mask: BoolArray | None, count: int, tiles: BoolArray,
        image: ComplexArray,
    ) -> None:  # fmt: skip
        """As Steps."""
        first, step = lines
        taps, wanted = self.setting.taps, np.flatnonzero(tiles)

        def look(task: int) -> None:
            rows, columns = _tile(int(wanted[task]), image.shape, count)
            active = np.ones(rows.stop - rows.start, np.bool_) if mask is None else mask[rows, columns].any(axis=1)
            if not active.any():
                return
            out = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.complex64)
            blocks = np.concatenate([first[rows] + columns.start * step[rows], step[rows]], axis=1)
            pool.call(
                _numba_tree.read,
                top.place[0], top.shape[0], store, taps.even, taps.odd, self.setting.wave, self.turns[0], self.turns[1],
                blocks, active, out,
            )  # fmt: skip
            image[rows, columns] += out

        self._run(look, len(wanted), None)

    def direct(self, survey: Survey, lines: Lines, pixels: BoolArray, count: int, image: ComplexArray, tick: Tick) -> int:
        """As Steps."""
        first, step = lines
        geometry, flat = self._numbered(survey)
        model = reals(survey.model)
        tiles = -(-image.shape[0] // TILE_ROWS) * -(-image.shape[1] // count)
        counted = np.zeros(tiles, dtype=np.int64)

        def add(task: int) -> None:
            rows, columns = _tile(task, image.shape, count)
            active = pixels[rows, columns].any(axis=1)
            if not active.any():
                return
            blocks = np.concatenate([first[rows] + columns.start * step[rows], step[rows]], axis=1)
            out = np.zeros((len(blocks), columns.stop - columns.start), dtype=np.complex64)
            counted[task] = pool.call(
                _numba.sum_tile,
                np.empty((0, 3)), blocks, True, active, geometry, model, survey.kind, flat,
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
    top, left = down * TILE_ROWS, across * count
    return slice(top, min(top + TILE_ROWS, shape[0])), slice(left, min(left + count, shape[1]))
