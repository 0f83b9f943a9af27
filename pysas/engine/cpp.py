"""The engine in C++; see interface.py."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine import native, subtrees
from pysas.engine.interface import Engine, Subtrees
from pysas.engine.native_steps import Compiled
from pysas.engine.steps import Setting, Steps
from pysas.engine.survey import Raster, Survey, Totals, Trigonometry
from pysas.engine.traces import Records


class Cpp:
    """Kernels for several instruction sets, of which the best runs that the machine has."""

    name = "cpp"
    polynomials: Collection[str] = ("float32", "float64")
    sums = 1
    filters = True
    slab = native.SLAB
    subtree: Subtrees | None = staticmethod(subtrees.make)
    peaks, mean_squares = staticmethod(native.peaks), staticmethod(native.mean_squares)

    @property
    def nodes(self) -> Mapping[str, int]:
        return {name: native.sizes()[name]["nodes"] for name in self.polynomials}

    @property
    def sines(self) -> Mapping[str, Sequence[int]]:
        return {name: native.sizes()[name]["terms"] for name in self.polynomials}

    def isa(self) -> str:
        return native.isa_name()

    def costs(self) -> str:
        return native.isa_name()

    def arcs(
        self, trace: Records, channels: int, cos_beam: float, points: FloatArray, order: npt.NDArray[np.int64],
        out: npt.NDArray[Any], threads: int,
    ) -> npt.NDArray[np.uint64]:  # fmt: skip
        return np.asarray(native.core().arcs(trace, channels, cos_beam, points, order, out, threads, None))

    def accumulate(
        self, data: ComplexArray, order: npt.NDArray[np.int64], survey: Survey, reader: native.Reader, scale: float,
        raster: Raster, trigonometry: Trigonometry, real: npt.DTypeLike, batch: int, image: ComplexArray, threads: int,
        progress: Callable[[float], None] | None,
    ) -> Totals:  # fmt: skip
        return native.accumulate(
            data, order, survey, reader, scale, raster, trigonometry, real, batch, image, threads, self.isa(), progress
        )

    def steps(self, setting: Setting, reader: native.Reader, room: int) -> Steps:
        return Compiled(setting, reader, room)


ENGINE: Engine = Cpp()
