"""A plan that was made here carried out: its choices are held against the data, the engine sums."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine import BLOCK
from pysas.engine.survey import Survey, Totals
from pysas.engine.traces import MODEL, record
from pysas.imaging import amplitudes, factorised, levels, words
from pysas.imaging.interpreted import Interpreted
from pysas.imaging.plans import Done, EnginePlan
from pysas.model.grid import Grid
from pysas.planning import bounds, view_angles
from pysas.planning.raster import Raster

Tick = Callable[[float], None] | None
AT_ONCE = 2**16  # pixels with weights of their own, at most


class Summing(Interpreted):
    """See plans.EnginePlan."""

    def follow(self, before: EnginePlan) -> None:
        """Nothing is kept."""

    def image(
        self, samples: ComplexArray, image: ComplexArray, nan: str, progress: Callable[[float], None] | None
    ) -> Done:  # fmt: skip
        plan: Interpreted = self
        scene, peaks = plan.scene, _peaks(plan, samples)
        finite = np.isfinite(peaks)
        notes = [] if finite.all() else [_left_out(plan, finite, nan)]
        used = scene.heard & finite & (scene.weights != 0)
        exponents = amplitudes.largest(scene.weights[used], peaks[used])
        scale = amplitudes.scale_of(exponents)
        plan = levels.fit(plan, samples, used, scale)
        if plan.why_direct:
            notes.insert(0, words.direct(plan.why_direct))
        warned: list[str] = []
        if plan is not self:
            more, warned = levels.notes(plan)
            notes += more
        image[...] = 0
        totals = Totals(0.0, 0.0, 0)
        if used.any():
            flat = None if plan.wide else _as_lines(image, plan.raster.shape)
            target = np.zeros(plan.raster.shape, dtype=np.complex128 if plan.wide else plan.dtype) if flat is None else flat
            totals = _add(plan, samples, used, scale, target, progress)
            target = target.astype(plan.dtype, copy=False)
            warned += _restored(plan, target, np.flatnonzero(used), exponents, scale)
            if flat is None:
                image[...] = target.reshape(plan.grid.shape)
            if plan.grid.mask is not None:
                image[~plan.grid.mask] = 0
        if progress is not None:
            progress(1.0)
        return Done(totals, plan.choices, plan.share, finite, notes, warned)


def _peaks(plan: Interpreted, samples: ComplexArray) -> FloatArray:
    """Of what is read of every trace; not finite where the trace is not."""
    start = _starts(plan)
    valid = plan.scene.valid
    begin, end = (np.clip(at, valid[:, 0], valid[:, 1] + 1) for at in (start, start + plan.choices.length))
    return plan.engine.peaks(samples, valid, begin, end, plan.threads).reshape(-1)


def _left_out(plan: Interpreted, finite: npt.NDArray[np.bool_], nan: str) -> str:
    """How many traces hold samples that are not finite; an error where the plan does not mask them."""
    bad = np.flatnonzero(~finite)
    if nan == "raise":
        ping, channel = divmod(int(bad[0]), plan.scene.channels)
        raise ValueError(f"data: non-finite sample at ping {ping}, channel {channel}: expected finite (or nan='mask')")
    return words.left_out(len(bad), plan.scene.traces)


def _add(
    plan: Interpreted, samples: ComplexArray, used: npt.NDArray[np.bool_], scale: float, target: ComplexArray,
    progress: Callable[[float], None] | None,
) -> Totals:  # fmt: skip
    """Add all traces `used` to `target` (line, pixel), which is left multiplied by `scale`."""
    trigonometry, kind = bounds.trigonometry(plan.choices.trigonometry)[0], np.dtype(plan.choices.precision)

    def add(order: npt.NDArray[np.int64], raster: Raster, target: ComplexArray, tick: Tick, own: Any = None) -> Totals:
        survey = replace(_survey(plan, order), own=own)
        return plan.engine.accumulate(
            samples, order, survey, plan.reader, scale, raster, trigonometry, kind, plan.choices.batch, target, plan.threads,
            tick,
        )  # fmt: skip

    order = np.flatnonzero(used)
    if plan.scene.hears is not None:
        return _add_rows(plan, plan.scene.hears, order, add, target, progress)
    if plan.forest is not None:
        return factorised.accumulate(plan, plan.forest, used, add, target, progress)
    if plan.scene.each:
        return _add_each(plan, order, add, target, progress)
    return add(order, plan.raster, target, progress)


def _restored(
    plan: Interpreted, target: ComplexArray, order: npt.NDArray[np.int64], exponents: npt.NDArray[np.int64], scale: float
) -> list[str]:
    """Give an image its scale back; what a person should know of numbers too far apart or too small."""
    said = []
    if plan.choices.precision == "float32" and amplitudes.wide(exponents):
        if max(np.abs(target.real).max(), np.abs(target.imag).max()) < amplitudes.LOST:
            said.append(words.lost_beside(int(order[np.argmax(exponents)]), plan.scene.channels))
    small = amplitudes.restore(target, scale, order.size, plan.tol)
    return said + ([small] if small else [])


def _partly(progress: Callable[[float], None] | None, done: float, more: float) -> Callable[[float], None] | None:
    """What tells `progress` of a part of the work, `more` of it after what is `done`."""
    return None if progress is None else lambda share: progress(done + more * share)


def _add_each(
    plan: Interpreted, order: npt.NDArray[np.int64], add: Callable[..., Totals], target: ComplexArray, progress: Tick
) -> Totals:
    """`add` pixels with their own weights of traces `order`, so many at a time as these have room for."""
    scene, grid, real = plan.scene, plan.grid, np.dtype(plan.choices.precision)
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    at_once = min(AT_ONCE, max(1, view_angles.BYTES // (real.itemsize * order.size * BLOCK)) * BLOCK)
    totals = Totals(0.0, 0.0, 0)
    for begin in range(0, wanted.size, at_once):
        pixels = wanted[begin : begin + at_once]
        raster = Raster(Grid.points(grid.coordinates(pixels)), scene, 0)
        clock = time.perf_counter()
        own = np.zeros((-(-pixels.size // raster.count) * raster.count, order.size), dtype=real)  # rows of whole blocks
        view_angles.fill(scene, raster.points(0, pixels.size), order, own, plan.threads, plan.engine)
        weighed = time.perf_counter() - clock
        part = np.zeros((1, pixels.size), dtype=target.dtype)
        tick = _partly(progress, begin / wanted.size, pixels.size / wanted.size)
        totals = totals.more(add(order, raster, part, tick, own)).more(Totals(0.0, weighed, 0))
        target[0, pixels] = part[0]
    return totals


def _add_rows(
    plan: Interpreted, hears: npt.NDArray[np.int64], order: npt.NDArray[np.int64], add: Callable[..., Totals],
    target: ComplexArray, progress: Tick,
) -> Totals:  # fmt: skip
    """`add` to each row of points the traces that it hears, rows of the same traces together."""
    width, totals = plan.grid.shape[-1], Totals(0.0, 0.0, 0)
    runs, which = np.unique(hears, axis=0, return_inverse=True)
    rows_of = np.split(np.argsort(which.ravel(), kind="stable"), np.cumsum(np.bincount(which.ravel()))[:-1])
    for number, ((first, last), rows) in enumerate(zip(runs, rows_of, strict=True)):
        some = order[(order >= first) & (order <= last)]
        if some.size:
            pixels = (rows[:, None] * width + np.arange(width)).ravel()
            raster = Raster(Grid.points(plan.grid.coordinates(pixels)), plan.scene, 0)
            part = np.zeros((1, pixels.size), dtype=target.dtype)
            totals = totals.more(add(some, raster, part, _partly(progress, number / len(runs), 1 / len(runs))))
            target[np.divmod(pixels, target.shape[1])] = part[0]
    return totals


def _as_lines(image: ComplexArray, shape: tuple[int, int]) -> ComplexArray | None:
    """`image` as (line, pixel) without a copy, or None where its strides do not allow it."""
    if image.flags.c_contiguous:
        return image.reshape(shape)
    return image if image.shape == shape and all(step % image.itemsize == 0 for step in image.strides) else None


def _starts(plan: Interpreted) -> npt.NDArray[np.int64]:
    """First sample that tables are made of, of every trace; it may lie before the record."""
    scene, choices = plan.scene, plan.choices
    if choices.taper:
        return np.asarray(scene.first - 1 - choices.margin)
    return np.zeros(scene.traces, dtype=np.int64)


def _survey(plan: Interpreted, order: npt.NDArray[np.int64]) -> Survey:
    """Traces `order` as the kernels take them."""
    scene, choices = plan.scene, plan.choices
    trace = scene.trace.take(order)
    trace["kept"] = _starts(plan)[order]
    near = choices.near if choices.block else np.inf
    model = record(
        MODEL, c=scene.c, fc=scene.fc, fs=scene.fs, rate=choices.oversampling, last=scene.n_sample - 1,
        beam=scene.beam, near=near, run=choices.run,
    )  # fmt: skip
    lattice = None if scene.lattice is None else scene.lattice.of(order)
    return Survey(trace, scene.weights[order], scene.kind, model, lattice)
