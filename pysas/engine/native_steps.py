"""The steps of fast factorised back-projection in C++, see steps.py."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine import native
from pysas.engine.steps import BoolArray, Lines, Setting, Single, Stack, Tick
from pysas.engine.survey import Survey
from pysas.engine.tree import SubImages


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
        self.nodes, self.fit = native.nodes(native.sizes()["float32"]["nodes"])
        self.tree = native.core().Tree(
            taps.even, taps.odd, taps.tap, taps.filter, s.wave, s.carrier[0], s.carrier[1], self.nodes, self.fit
        )

    def prepare(
        self, traces: ComplexArray, part: npt.NDArray[np.int64], survey: Survey, kept: BoolArray, scale: float
    ) -> None:  # fmt: skip
        """As Steps."""
        self.rows = self.table[: part.size]
        native.fill(
            traces, part, survey.start, survey.weights, scale, self.reader, self.rows, self.setting.threads, self.setting.isa
        )
        self.rows[~kept] = 0

    def leaves(self, survey: Survey, level: SubImages, store: Single, slack: float, smooth: bool, tick: Tick) -> None:
        """As Steps."""
        s = self.setting
        native.core().leaves(
            self.tree, self.rows, self.reader.filter.degree, s.trigonometry[0], s.trigonometry[1], survey.trace,
            survey.model, survey.kind, level.span, level.place, level.shape, level.range, survey.lattice, store, slack, smooth,
            s.threads, s.isa, tick,
        )  # fmt: skip

    def merge(
        self, children: SubImages, below: Single, parent: SubImages, store: Single, add: bool, last: bool, top: bool
    ) -> None:
        """As Steps."""
        native.core().merge(
            self.tree, np.array([0, len(children)]), children.place, children.shape, children.range, below, parent.place,
            parent.shape, parent.range, store, add, last, top, self.setting.threads, self.setting.isa, None,
        )  # fmt: skip

    def read(
        self, top: SubImages, store: Single, lines: Lines | None, points: FloatArray | None, stack: Stack | None,
        mask: BoolArray | None, count: int, tiles: BoolArray, image: ComplexArray,
    ) -> None:  # fmt: skip
        """As Steps."""
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
        """As Steps."""
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
