"""The back-projection sum over batches of traces: prepare a batch, then add it to every tile, both on worker threads.

Batches and tiles are fixed by the plan, not by the number of threads, so that the image is bit-identical for any. Samples
are scaled by one power of two before they meet float32, so that no amplitude over- or underflows on the way.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _pool as pool
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import _numba, _numba_samples
from pysas.engine.preparation import Interpolator, coefficients, segments
from pysas.engine.survey import Raster, Survey, Totals, Trigonometry, readable, rows_per_task
from pysas.engine.traces import Records, reals


def peaks(
    data: ComplexArray, valid: npt.NDArray[np.int64], begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64], threads: int
) -> FloatArray:
    """See Parts.peaks."""
    traces = data if data.ndim == 3 else data[:, None, :]
    found = np.zeros(traces.shape[:2])
    begin, end = (np.asarray(at).reshape(found.shape) for at in (begin, end))
    valid = np.ascontiguousarray(valid).reshape(*found.shape, 2)
    size = max(1, 2**16 // (traces.shape[1] * traces.shape[2]))

    def measure(task: int) -> None:
        some = slice(task * size, (task + 1) * size)
        pool.call(_numba_samples.peaks, readable(traces[some]), valid[some], begin[some], end[some], found[some])

    pool.run(measure, -(-traces.shape[0] // size), threads)
    return found


def mean_squares(
    data: ComplexArray, valid: npt.NDArray[np.int64], trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64], reach: int,
    scale: float, threads: int,
) -> FloatArray:  # fmt: skip
    """See Parts.mean_squares."""
    out, channels = np.zeros(trace.size), data.shape[1]
    size = max(1, 2**16 // min(2 * reach + 1, data.shape[2]))
    inverse = min(1 / scale, np.finfo(np.float64).max)  # one over a subnormal is infinite

    def measure(task: int) -> None:
        some = slice(task * size, (task + 1) * size)
        first, last = np.min(trace[some]) // channels, np.max(trace[some]) // channels
        near, number = readable(data[first : last + 1]), trace[some] - first * channels
        windows = np.ascontiguousarray(valid[first * channels : (last + 1) * channels])
        pool.call(_numba_samples.mean_squares, near, windows, number, place[some], reach, inverse, out[some])

    pool.run(measure, -(-trace.size // size), threads)
    return out


def chebyshev() -> tuple[FloatArray, FloatArray]:
    """Nodes of the delay polynomials in [-1, 1], and the matrix from values there to coefficients of powers."""
    nodes = np.cos(np.pi * (2 * np.arange(_numba.NODES)[::-1] + 1) / (2 * _numba.NODES))
    nodes[_numba.NODES // 2] = 0.0
    return nodes, np.linalg.inv(np.vander(nodes, increasing=True))


def places(count: int, real: npt.DTypeLike) -> npt.NDArray[Any]:
    """Places of a block's pixels in [-1, 1]."""
    return np.linspace(-1, 1, count).astype(real) if count > 1 else np.zeros(1, real)


def numbered(trace: Records, intervals: int) -> FloatArray:
    """Traces as Numba's kernels take them, numbered by the first of their `intervals` in a batch's table."""
    own = trace.copy()
    own["interval"] = np.arange(len(own)) * intervals
    return reals(own)


def prepare(
    traces: ComplexArray,
    part: npt.NDArray[np.int64],
    trace: Records,
    weights: ComplexArray,
    scale: float,
    reader: Interpolator,
    table: npt.NDArray[Any],
    threads: int,
    kept: npt.NDArray[np.bool_] | None = None,
) -> None:
    """Tables of traces `part` (flat numbers, records `trace`) of (ping, channel, sample); zeros for those not `kept`."""
    at_once = rows_per_task(reader.n_fine)

    def transform(task: int) -> None:
        rows = np.arange(task * at_once, min((task + 1) * at_once, part.size))
        if kept is not None:
            table[rows[~kept[rows]]] = 0
            rows = rows[kept[rows]]  # the others may hold anything
        if rows.size:
            cut = segments(traces, part[rows], trace.take(rows), weights[rows], scale, reader, reader.transfer.dtype)
            whole = rows.size == rows[-1] + 1 - rows[0]
            out = table[rows[0] : rows[-1] + 1] if whole else np.empty((rows.size, *table.shape[1:]), table.dtype)
            coefficients(cut, reader, out)
            if not whole:
                table[rows] = out

    pool.run(transform, -(-part.size // at_once), threads)


def accumulate(
    data: ComplexArray,
    order: npt.NDArray[np.int64],
    survey: Survey,
    reader: Interpolator,
    scale: float,
    raster: Raster,
    trigonometry: Trigonometry,
    real: npt.DTypeLike,
    batch: int,
    image: ComplexArray,
    threads: int,
    progress: Callable[[float], None] | None,
) -> Totals:
    """Add traces `order` (flat ping-channel numbers; record i of survey.trace is order[i]) of `data` to `image` (line, pixel).

    The image is left multiplied by `scale`.
    """
    traces = data if data.ndim == 3 else data[:, None, :]
    tiles, straight, count = raster.tiles(), raster.straight, raster.count
    kind = np.dtype(real)
    complex_kind = np.dtype(np.complex64 if kind == np.float32 else np.complex128)
    nodes, fit = chebyshev()
    scalar: Any = kind.type
    sines, cosines = (tuple(scalar(v) for v in terms) for terms in trigonometry)
    pairs = (0,) * ((reader.degree + 1) // 2)
    half = scalar(0.5)
    model = reals(survey.model)
    counted = np.zeros(len(tiles), dtype=np.int64)
    prepared = summed = 0.0
    batches = range(0, len(order), batch)
    for number, begin in enumerate(batches):
        part = order[begin : begin + batch]
        clock = time.perf_counter()
        table = np.empty((part.size, reader.intervals, reader.degree + 1), dtype=complex_kind)
        some = survey.part(begin, begin + part.size)
        prepare(traces, part, some.trace, some.weights, scale, reader, table, threads)
        geometry = numbered(some.trace, reader.intervals)
        flat_table = table.reshape(-1).view(kind)
        now = time.perf_counter()
        prepared += now - clock

        lattice, axes = some.weighing()

        def add(
            task: int, geometry: FloatArray = geometry, flat_table: Any = flat_table, lattice: Any = lattice, axes: Any = axes,
            own: Any = some.own,
        ) -> None:  # fmt: skip
            tile = tiles[task]
            coords, blocks, active = raster.locate(tile)
            if not active.any():
                return
            # a line's last block ends with it: no samples were prepared for pixels beyond
            width = min(count, tile.right - tile.left) if straight else count
            out = np.zeros((blocks.shape[0], width), dtype=complex_kind)
            if own is not None:
                lattice, axes = own[tile.left : tile.left + out.size].reshape(*out.shape, -1), np.empty(0)
            terms = pool.call(
                _numba.sum_tile,
                coords, blocks, straight, active, geometry, model, survey.kind, flat_table, places(width, kind), nodes,
                fit, half, sines, cosines, pairs, lattice, axes, out,
            )  # fmt: skip
            pixels = (tile.last - tile.first) * (tile.right - tile.left)
            counted[task] += terms * pixels // out.size
            if straight:
                image[tile.first : tile.last, tile.left : tile.right] += out
            else:
                image[tile.first : tile.last, tile.left : tile.right] += out.reshape(-1)[:pixels]

        tick = None
        if (report := progress) is not None:

            def tick(done: int, number: int = number, report: Callable[[float], None] = report) -> None:
                report((number + done / len(tiles)) / len(batches))

        pool.run(add, len(tiles), threads, tick)
        summed += time.perf_counter() - now
    return Totals(prepared, summed, int(counted.sum()))
