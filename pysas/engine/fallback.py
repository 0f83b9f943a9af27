"""The engine in Numba, for places without a compiler and as a second opinion; see interface.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import binding

from pysas import _pool as pool
from pysas._checks import FloatArray
from pysas.engine import _numba, _numba_arcs, sub_images, summation
from pysas.engine.interface import Parts
from pysas.engine.traces import Records, reals

AT_ONCE = 2**18  # views of a task


class Fallback:
    """Kernels compiled at first use, on worker threads."""

    name = "numba"
    nodes: Mapping[str, int] = {"float32": _numba.NODES, "float64": _numba.NODES}
    sines: Mapping[str, Sequence[int]] = {"float32": range(4, 13), "float64": range(4, 13)}
    sums = 3
    slab = 0
    peaks, mean_squares = staticmethod(summation.peaks), staticmethod(summation.mean_squares)
    accumulate, read = staticmethod(summation.accumulate), staticmethod(sub_images.read)

    def isa(self) -> str:
        return str(binding.get_host_cpu_name())

    def arcs(
        self, trace: Records, channels: int, beam: Records, points: FloatArray, order: npt.NDArray[np.int64],
        out: npt.NDArray[Any], threads: int,
    ) -> npt.NDArray[np.uint64]:  # fmt: skip
        pattern = np.empty(len(points), dtype=np.uint64)
        rows = max(1, AT_ONCE // len(trace))
        geometry = reals(trace)

        def some(task: int) -> None:
            part = slice(task * rows, min((task + 1) * rows, len(points)))
            pool.call(_numba_arcs.arcs, geometry, channels, reals(beam), points[part], order, out[part], pattern[part])

        pool.run(some, -(-len(points) // rows), threads)
        return pattern


ENGINE: Parts = Fallback()
