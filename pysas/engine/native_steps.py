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
        count = native.sizes()["float32"]["nodes"]
        self.polynomials = native.polynomials_of(self.reader.filter.degree, s.trigonometry, count)
        carrier = native.polynomials_of(self.reader.filter.degree, s.carrier, count)
        self.tree = native.core().Tree(taps.even, taps.odd, taps.tap, taps.filter, s.wave, carrier)

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
        traces, to = native.traces_of(survey), _sub_images(level, store)
        native.core().leaves(
            self.tree, self.rows, self.polynomials, traces, level.span, to, slack, smooth, s.threads, s.isa, tick
        )

    def merge(
        self, children: SubImages, below: Single, parent: SubImages, store: Single, add: bool, last: bool, top: bool
    ) -> None:
        """As Steps."""
        span = np.array([0, len(children)])
        native.core().merge(
            self.tree, span, _sub_images(children, below), _sub_images(parent, store), add, last, top, self.setting.threads,
            self.setting.isa, None,
        )  # fmt: skip

    def read(
        self, top: SubImages, store: Single, lines: Lines | None, points: FloatArray | None, stack: Stack | None,
        mask: BoolArray | None, count: int, tiles: BoolArray, image: ComplexArray,
    ) -> None:  # fmt: skip
        """As Steps."""
        first, step = (None, None) if lines is None else lines
        planes = None if stack is None else native.core().Stack(stack.axis, stack.heights, stack.number)
        raster = native.core().Raster(first, step, points, mask, count)
        native.core().read(
            self.tree, _sub_images(top, store), raster, planes, tiles.astype(np.uint8), image, self.setting.threads,
            self.setting.isa, None,
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
        raster = native.core().Raster(first, step, None if points is None else points[0], pixels, count)
        traces = native.traces_of(survey)
        return int(native.core().add(self.rows, self.polynomials, traces, raster, None, image, s.threads, s.isa, tick))


def _sub_images(level: SubImages, store: Single) -> Any:
    """As the kernels take them."""
    return native.core().SubImages(level.place, level.shape, level.range, store)
