"""Arcs of view angle that traces stand for at points, by either backend: weights that make a sum uniform in view angle."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _pool as pool
from pysas._checks import FloatArray
from pysas.engine import _numba_arcs, native
from pysas.engine.traces import Records, reals

AT_ONCE = 2**18  # views of a task


def arcs(
    backend: str,
    trace: Records,
    channels: int,
    cos_beam: float,
    points: FloatArray,
    order: npt.NDArray[np.int64],
    out: npt.NDArray[Any],
    threads: int,
) -> npt.NDArray[np.uint64]:
    """Fill `out` (point, kept) with the arcs of traces `order` among all at points about the scene's centre.

    Their mean over the traces within whose beam a point lies is 1; the others' arcs are what they would be there. Rows of
    `out` beyond the points stay. Returns a number for each point that is the same where views have one order around the
    circle, one grouping and one set of openings, so that arcs are smooth from place to place; 0 where a view has no angle
    or a gap is about as wide as makes an opening. O(point trace log trace).
    """
    if backend == "cpp":
        return np.asarray(native.core().arcs(trace, channels, cos_beam, points, order, out, threads, None))
    pattern = np.empty(len(points), dtype=np.uint64)
    rows = max(1, AT_ONCE // len(trace))
    geometry = reals(trace)

    def some(task: int) -> None:
        part = slice(task * rows, min((task + 1) * rows, len(points)))
        pool.call(_numba_arcs.arcs, geometry, channels, cos_beam, points[part], order, out[part], pattern[part])

    pool.run(some, -(-len(points) // rows), threads)
    return pattern
