"""The back-projection sum in C++: batches of traces become tables, tables are added to all tiles. See summation.py.

A trace's table comes from a short filter; where a pixel needs samples near a record's end, of the trace low-passed by W at
twice its rate: only transforms read the end as the oracle does at every tolerance.
"""

from __future__ import annotations

import functools
import importlib
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _leaving
from pysas import _pool as pool
from pysas._checks import ComplexArray, FloatArray
from pysas.engine.preparation import Cut, low_pass, segments
from pysas.engine.survey import Raster, Survey, Totals, Trigonometry, rows_per_task

if TYPE_CHECKING:
    from pysas.engine._core import Filter as Filter

SLAB = 2**16  # pixels of a point list at a time
RATES = ((1, 1), (3, 2), (2, 1), (5, 2), (3, 1), (7, 2), (4, 1), (5, 1), (6, 1), (8, 1), (11, 1), (16, 1))


LEAST_TAPS = 8
PART = 2**22  # bytes of samples that are copied at a time where C++ cannot read them
MOST_STEP = 24  # samples that a filter may step by, see kernels.hpp


@functools.lru_cache(maxsize=64)
def simple_rate(least: float) -> Fraction:
    """The lowest rate of at least `least` intervals per sample that a filter steps through, also after doubling."""
    steps = range(1, MOST_STEP // 2 + 1)
    return min(Fraction(max(1, math.ceil(least * step * (1 - 1e-12))), step) for step in steps)


def extension() -> Any | None:
    """The compiled module, or None where it was not built."""
    try:
        return core()
    except ImportError:
        return None


def core() -> Any:
    """The compiled module, which must be there."""
    module = importlib.import_module("pysas.engine._core")
    _watch(module)
    return module


@functools.cache
def _watch(module: Any) -> None:
    _leaving.join(_leaving.Part(module.stop_others, module.away, module.keep_others))


@functools.cache
def sizes() -> dict[str, Any]:
    """What kernels are compiled for: by precision `degrees` of the interpolation, `terms` of the sine, `nodes` of the delay."""
    found: dict[str, Any] = core().sizes()
    return found


def isa_name() -> str:
    """The instruction set that will run: PYSAS_ISA, else the best of this machine.

    Raises
    ------
    ValueError
        PYSAS_ISA names none that this machine and this build have.
    """
    levels = core().levels()
    name = _checks.choice("PYSAS_ISA", os.environ.get("PYSAS_ISA", "auto"), ("auto", *levels))
    return str(levels[-1] if name == "auto" else name)


@functools.lru_cache(maxsize=256)
def design(band: float, degree: int, phases: int, step: int, error: float, most: int, least: int = LEAST_TAPS) -> Filter:
    """A filter of `least` to `most` taps that reads components |f| <= band (units of fs) with at most `error`.

    Look at its own `error`.
    """
    found: Filter = core().design(band, degree, phases, step, error, least, most)
    return found


@dataclass(frozen=True)
class Reader:
    """How traces become tables: `filter`, of samples or, where `cut` says how they are kept, of low-passed traces.

    length : samples kept; wide : low-pass whole records in float64 and keep `length` samples of that.
    """

    filter: Filter
    length: int
    cut: Cut | None = None
    wide: bool = False

    @property
    def samples(self) -> int:
        """Samples that the filter reads."""
        return self.length if self.cut is None else 2 * self.length - 1

    @property
    def rate(self) -> float:
        """Intervals per sample of the record."""
        return self.filter.rate * (2 if self.cut is not None else 1)


@functools.cache
def nodes(count: int) -> tuple[FloatArray, FloatArray]:
    """Chebyshev nodes in [-1, 1] and the matrix from values there to coefficients of powers, in the kernels' 7 x 7."""
    at = np.cos(np.pi * (2 * np.arange(count)[::-1] + 1) / (2 * count))
    at[count // 2] = 0.0
    fit = np.zeros((7, 7))
    fit[:count, :count] = np.linalg.inv(np.vander(at, increasing=True))
    return at, fit


def peaks(data: ComplexArray, begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64], threads: int) -> FloatArray:
    """Largest |real| or |imaginary| part of samples [begin, end) of each trace, (ping, channel); not finite where the trace
    is not, within or without them."""
    traces = data if data.ndim == 3 else data[:, None, :]
    if _plain(data):
        return np.asarray(core().peaks(traces, begin, end, threads, None))
    channels = traces.shape[1]
    found = np.empty(traces.shape[:2])
    for some, part in _in_parts(traces, 0, len(traces)):
        flat = slice(some.start * channels, some.stop * channels)
        found[some] = core().peaks(part, begin[flat], end[flat], threads, None)
    return found


def mean_squares(
    data: ComplexArray, trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64], reach: int, scale: float, threads: int
) -> FloatArray:
    """Mean squares of the 2 reach + 1 samples about places of (ping, channel, sample), in units of scale^2."""
    if _plain(data):
        return np.asarray(core().mean_squares(data, trace, place, reach, scale, threads, None))
    channels, found = data.shape[1], np.empty(trace.size)
    if not trace.size:
        return found
    for some, part in _in_parts(data, int(trace.min()) // channels, int(trace.max()) // channels + 1):
        own = np.flatnonzero((trace >= some.start * channels) & (trace < some.stop * channels))
        first = some.start * channels
        found[own] = core().mean_squares(part, trace[own] - first, place[own], reach, scale, threads, None)
    return found


def _plain(data: ComplexArray) -> bool:
    """Whether C++ can read the array where it lies: this machine's byte order, aligned, whole elements between samples."""
    return bool(data.dtype.isnative and data.flags.aligned and all(step % data.itemsize == 0 for step in data.strides))


def _in_parts(traces: ComplexArray, first: int, last: int) -> Iterator[tuple[slice, ComplexArray]]:
    """Working copies, that C++ can read, of some of pings [first, last) at a time."""
    kind = traces.dtype.newbyteorder("=")
    at_once = max(1, PART // max(1, traces.shape[1] * traces.shape[2] * traces.itemsize))
    for begin in range(first, last, at_once):
        some = slice(begin, min(begin + at_once, last))
        yield some, np.array(traces[some], dtype=kind, order="C")


def _native(traces: ComplexArray, order: npt.NDArray[np.int64]) -> ComplexArray:
    """A working copy of some traces that C++ can read."""
    kind = np.dtype(traces.dtype).newbyteorder("=")
    return np.array([traces[divmod(int(flat), traces.shape[1])] for flat in order], dtype=kind)[:, None, :]


def accumulate(
    data: ComplexArray,
    order: npt.NDArray[np.int64],
    survey: Survey,
    reader: Reader,
    scale: float,
    raster: Raster,
    trigonometry: Trigonometry,
    real: npt.DTypeLike,
    batch: int,
    image: ComplexArray,
    threads: int,
    isa: str,
    progress: Callable[[float], None] | None,
) -> Totals:
    """Add traces `order` of `data` to `image` (line, pixel), as summation.accumulate does."""
    engine = core()
    traces = data if data.ndim == 3 else data[:, None, :]
    kind = np.dtype(real)
    polynomials = polynomials_of(reader.filter.degree, trigonometry, sizes()[kind.name]["nodes"])
    table = empty_table(reader, min(batch, len(order)), kind)
    prepared = summed = 0.0
    terms = 0
    for begin in range(0, len(order), batch):
        part = order[begin : begin + batch]
        clock = time.perf_counter()
        rows = table[: part.size]
        some = survey.part(begin, begin + part.size)
        kept = traces_of(some)
        fill(traces, part, some.start, some.weights, scale, reader, rows, threads, isa)
        now = time.perf_counter()
        prepared += now - clock
        width = raster.shape[1]
        slabs = [(0, width)] if raster.straight else [(lo, min(lo + SLAB, width)) for lo in range(0, width, SLAB)]
        for number, (lo, hi) in enumerate(slabs):
            done, more = (begin + part.size * number / len(slabs)) / len(order), part.size / len(slabs) / len(order)
            tick = None
            if (report := progress) is not None:

                def tick(
                    share: float, report: Callable[[float], None] = report, done: float = done, more: float = more
                ) -> None:
                    report(done + more * share)

            points = None if raster.straight else raster.points(lo, hi)
            mask = None if raster.mask is None else np.ascontiguousarray(raster.mask[:, lo:hi])
            first, step = (raster.first, raster.step) if raster.straight else (None, None)
            pixels = engine.Raster(first, step, points, mask, raster.count)
            own = None if some.own is None else some.own[lo:]
            terms += engine.add(rows, polynomials, kept, pixels, own, image[:, lo:hi], threads, isa, tick)
        summed += time.perf_counter() - now
    return Totals(prepared, summed, terms)


def polynomials_of(degree: int, trigonometry: Trigonometry, count: int) -> Any:
    """As the kernels take them, with `count` nodes for delays."""
    return core().Polynomials(degree, trigonometry[0], trigonometry[1], *nodes(count))


def traces_of(survey: Survey) -> Any:
    """As the kernels take them."""
    return core().Traces(survey.trace, survey.model, survey.kind, survey.lattice)


def empty_table(reader: Reader, traces: int, real: npt.DTypeLike) -> FloatArray:
    """Room for the tables of some traces."""
    engine, kind, degree = core(), np.dtype(real), reader.filter.degree
    stride = engine.plane_stride(engine.intervals(reader.samples, reader.filter.rate), degree, kind.itemsize)
    return np.empty((traces, 2 * (degree + 1), stride), dtype=kind)


def fill(
    traces: ComplexArray,
    part: npt.NDArray[np.int64],
    start: npt.NDArray[np.int64],
    weights: ComplexArray,
    scale: float,
    reader: Reader,
    table: FloatArray,
    threads: int,
    isa: str,
) -> None:
    """Tables of traces `part` (flat numbers) of (ping, channel, sample)."""
    if reader.cut is not None:
        _low_passed(traces, part, start, weights, scale, reader, reader.cut, table, threads, isa)
        return
    source, places = (traces, part) if _plain(traces) else (_native(traces, part), np.arange(part.size))
    core().prepare(source, places, start, weights, scale, reader.filter, reader.samples, table, threads, isa, None)


def _low_passed(
    traces: ComplexArray,
    part: npt.NDArray[np.int64],
    start: npt.NDArray[np.int64],
    weights: ComplexArray,
    scale: float,
    reader: Reader,
    cut: Cut,
    table: FloatArray,
    threads: int,
    isa: str,
) -> None:
    """Tables of traces low-passed by W, at twice the sample rate, in groups of traces that stay in the cache."""
    n_fft, wide = cut.n_fft, reader.wide
    cut = Cut(traces.shape[2], n_fft, None) if wide else cut
    at_once = rows_per_task(2 * n_fft)
    kind = np.complex128 if wide or table.dtype == np.float64 else np.complex64
    pass_band: FloatArray = (2 * low_pass(scipy.fft.fftfreq(n_fft))).astype(np.float64 if kind is np.complex128 else np.float32)
    lead = reader.filter.taps  # the filter reaches before the first sample kept
    half = (n_fft + 1) // 2

    def prepare(task: int) -> None:
        rows = slice(task * at_once, (task + 1) * at_once)
        begin = np.zeros_like(start[rows]) if wide else start[rows]
        kept = segments(traces, part[rows], begin, weights[rows], scale, cut, kind)
        padded = np.zeros((len(kept), n_fft), dtype=kind)
        padded[:, lead : lead + cut.length] = kept
        spectrum = scipy.fft.fft(padded, axis=-1, workers=1, overwrite_x=True)
        spectrum *= pass_band
        fine = np.zeros((len(kept), 1, 2 * n_fft), dtype=kind)
        fine[:, 0, :half] = spectrum[:, :half]
        fine[:, 0, half - n_fft :] = spectrum[:, half:]
        fine = scipy.fft.ifft(fine, axis=-1, workers=1, overwrite_x=True)
        order = np.arange(len(kept))
        to = empty_table(reader, len(kept), np.float64) if wide and table.dtype == np.float32 else table[rows]
        start_of = 2 * (lead + start[rows] - begin)
        core().prepare(fine, order, start_of, None, 1.0, reader.filter, reader.samples, to, 1, isa, None)
        if to.dtype != table.dtype:  # rounded where it is read, not where it is bright
            stride = min(to.shape[-1], table.shape[-1])
            table[rows, :, :stride] = to[..., :stride]
            table[rows, :, stride:] = 0

    pool.run(prepare, -(-part.size // at_once), threads)
