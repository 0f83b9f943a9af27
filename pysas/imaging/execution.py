"""A plan carried out: the data are checked, its choices are held against them, the engine sums, the report is written.

Choices are made in planner.py and choices.py, arithmetic in engine/.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.engine import BLOCK
from pysas.engine.survey import Survey, Totals
from pysas.engine.traces import MODEL, record
from pysas.imaging import amplitudes, factorised, levels
from pysas.imaging.plans import Plan
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.planning import bounds, view_angles
from pysas.planning.raster import Raster

AT_ONCE = 2**16  # pixels with weights of their own, at most


@_checks.usual_errors
def execute(plan: Plan, data: npt.ArrayLike, out: ComplexArray | None, progress: Callable[[float], None] | None) -> Image:
    """Carry out `plan` on `data`; what `Plan.__call__` does."""
    scene, choices, grid, asked = plan.scene, plan.choices, plan.grid, plan
    samples = _checks.samples("data", data, (2, 3)).view()  # whose shape nobody else can set
    if samples.shape != plan.data_shape:
        raise ValueError(f"data: expected the planned shape {plan.data_shape}, found {samples.shape}")
    if samples.dtype.itemsize != plan.dtype.itemsize:
        raise TypeError(f"data: expected {plan.dtype}, found {samples.dtype}")
    _checks.callback("progress", progress)
    _checks.target(out, grid.shape, plan.dtype)
    _checks.apart(out, samples)
    notes = []

    start = _starts(plan)
    begin, end = (np.clip(at, 0, scene.n_sample) for at in (start - choices.taps, start + choices.length + choices.taps))
    peaks = plan.engine.peaks(samples, begin, end, plan.threads).reshape(-1)
    finite = np.isfinite(peaks)
    if not finite.all():
        bad = np.flatnonzero(~finite)
        if plan.nan == "raise":
            ping, channel = divmod(int(bad[0]), scene.channels)
            raise ValueError(f"data: non-finite sample at ping {ping}, channel {channel}: expected finite (or nan='mask')")
        notes.append(f"{len(bad)} of {scene.traces} traces left out: non-finite samples")
    used = scene.heard & finite & (scene.weights != 0)
    exponents = amplitudes.largest(scene.weights[used], peaks[used])
    scale = amplitudes.scale_of(exponents)
    order = np.flatnonzero(used)
    plan = levels.fit(plan, samples, used, scale)
    image = np.zeros(grid.shape, dtype=plan.dtype) if out is None else np.asarray(out)
    image[...] = 0
    choices = plan.choices
    if plan.why_direct:
        notes.insert(0, f"summed directly: {plan.why_direct}")
    notes += [] if plan is asked else levels.notes(plan)

    totals = Totals(0.0, 0.0, 0)
    isa = plan.engine.isa()
    if order.size:
        raster, reader = plan.raster, plan.reader
        trigonometry = bounds.trigonometry(choices.trigonometry)[0]
        flat = None if plan.wide else _as_lines(image, raster.shape)
        target = np.zeros(raster.shape, dtype=np.complex128 if plan.wide else plan.dtype) if flat is None else flat
        real = np.dtype(choices.precision)
        if plan.forest is not None:
            totals = factorised.accumulate(
                plan, samples, used, lambda part: _survey(plan, part), scale, trigonometry, bounds.trigonometry(6)[0], target,
                isa, progress,
            )  # fmt: skip
        else:

            def add(raster: Raster, survey: Survey, target: ComplexArray, tick: Callable[[float], None] | None) -> Totals:
                return plan.engine.accumulate(
                    samples, order, survey, reader, scale, raster, trigonometry, real, choices.batch, target, plan.threads, tick
                )

            survey = _survey(plan, order)
            totals = (
                _add_each(plan, order, survey, target, add, progress) if scene.each else add(raster, survey, target, progress)
            )
        target = target.astype(plan.dtype, copy=False)
        if real == np.float32 and amplitudes.wide(exponents):
            if max(np.abs(target.real).max(), np.abs(target.imag).max()) < amplitudes.LOST:
                worst = divmod(int(order[np.argmax(exponents)]), scene.channels)
                notes.append(f"the image is lost beside ping {worst[0]}, channel {worst[1]}: leave it out by weight 0")
                warnings.warn(notes[-1], stacklevel=5)
        if small := amplitudes.restore(target, scale, order.size, plan.tol):
            notes.append(small)
            warnings.warn(small, stacklevel=5)
        if flat is None:
            image[...] = target.reshape(grid.shape)
        if grid.mask is not None:
            image[~grid.mask] = 0
    if progress is not None:
        progress(1.0)
    if totals.terms == 0:
        notes.append(scene.why_empty(finite) or scene.why_dark())
        if not plan.silent:  # or the plan has warned
            warnings.warn(notes[-1], stacklevel=5)
    everything = scene.traces * grid.size
    report = Report(
        method=plan.method, tol=plan.tol, backend=plan.backend, isa=isa, threads=plan.threads,
        prepare_seconds=totals.prepare_seconds, sum_seconds=totals.sum_seconds, terms=totals.terms,
        share_left_out=1 - totals.terms / everything,
        factorised_share=plan.forest.share if plan.forest is not None else 0.0, predicted_error=choices.predicted_error,
        choices=dict(plan.reported), notes=tuple(notes),
    )  # fmt: skip
    return Image(image, grid, report, scene.fc, scene.c)


def _partly(progress: Callable[[float], None] | None, done: float, more: float) -> Callable[[float], None] | None:
    """What tells `progress` of a part of the work, `more` of it after what is `done`."""
    return None if progress is None else lambda share: progress(done + more * share)


def _add_each(
    plan: Plan,
    order: npt.NDArray[np.int64],
    survey: Survey,
    target: ComplexArray,
    add: Callable[[Raster, Survey, ComplexArray, Callable[[float], None] | None], Totals],
    progress: Callable[[float], None] | None,
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
        some = add(raster, replace(survey, own=own), part, _partly(progress, begin / wanted.size, pixels.size / wanted.size))
        target[0, pixels] = part[0]
        prepared, summed = totals.prepare_seconds + some.prepare_seconds, totals.sum_seconds + weighed + some.sum_seconds
        totals = Totals(prepared, summed, totals.terms + some.terms)
    return totals


def _as_lines(image: ComplexArray, shape: tuple[int, int]) -> ComplexArray | None:
    """`image` as (line, pixel) without a copy, or None where its strides do not allow it."""
    if image.flags.c_contiguous:
        return image.reshape(shape)
    return image if image.shape == shape and all(step % image.itemsize == 0 for step in image.strides) else None


def _starts(plan: Plan) -> npt.NDArray[np.int64]:
    """First sample that tables are made of, of every trace; it may lie before the record."""
    scene, choices = plan.scene, plan.choices
    if choices.taper or (choices.taps and (choices.wide or not choices.n_fft)):
        return np.asarray(scene.first - 1 - choices.margin)
    return np.zeros(scene.traces, dtype=np.int64)


def _survey(plan: Plan, order: npt.NDArray[np.int64]) -> Survey:
    """Traces `order` as the kernels take them."""
    scene, choices = plan.scene, plan.choices
    trace = scene.trace.take(order)
    trace["kept"] = _starts(plan)[order]
    near = choices.near if choices.block else np.inf
    model = record(
        MODEL, c=scene.c, fc=scene.fc, fs=scene.fs, rate=choices.oversampling, last=scene.n_sample - 1,
        cos_beam=scene.cos_beam, near=near, run=choices.run,
    )  # fmt: skip
    lattice = None if scene.lattice is None else scene.lattice.of(order)
    return Survey(trace, scene.weights[order], scene.kind, model, lattice)
