"""A plan carried out: the data are checked, its engine sums, the report is written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.imaging import words
from pysas.imaging.plans import Done, Plan
from pysas.model.gaps import windows_of
from pysas.model.image import Image, Report


@_checks.usual_errors
def execute(plan: Plan, data: npt.ArrayLike, out: ComplexArray | None, progress: Callable[[float], None] | None) -> Image:
    """Carry out `plan` on `data`; what `Plan.__call__` does."""
    samples = _samples(plan, data, out, progress)
    shortened = []
    if plan.again is not None:
        traces = samples if samples.ndim == 3 else samples[:, None, :]
        windows, count = windows_of(traces, plan.windows)
        if count:
            plan = plan.again(windows)
            shortened = [words.shortened(count, plan.scene.traces)]
    image = np.zeros(plan.grid.shape, dtype=plan.dtype) if out is None else np.asarray(out)
    done = plan.by.image(samples, image, plan.nan, progress)
    warned = list(done.warned)
    if done.totals.terms and not image.any():
        if plan.grid.mask is not None and plan.scene.dark(done.finite):
            done = dataclasses.replace(done, totals=dataclasses.replace(done.totals, terms=0))
        elif not samples.any():
            warned.append("every sample is 0: image is zero")
    if done.totals.terms == 0:
        warned.append(plan.scene.why_empty(done.finite) or plan.scene.why_dark(done.finite))
    for text in warned:
        if done.totals.terms or not plan.silent:  # or the plan has warned
            _checks.warn(text)
    return Image(image, plan.grid, _report(plan, done, shortened + done.notes + warned), plan.scene.fc, plan.scene.mean_speed)


def _samples(
    plan: Plan, data: npt.ArrayLike, out: ComplexArray | None, progress: Callable[[float], None] | None
) -> ComplexArray:
    """The data as an array, once they and where their image goes are as the plan has them."""
    samples = _checks.samples("data", data, (2, 3)).view()  # whose shape nobody else can set
    if samples.shape != plan.data_shape:
        raise ValueError(f"data: expected the planned shape {plan.data_shape}, found {samples.shape}")
    if samples.dtype.itemsize != plan.dtype.itemsize:
        raise TypeError(f"data: expected {plan.dtype}, found {samples.dtype}")
    _checks.callback("progress", progress)
    _checks.target(out, plan.grid.shape, plan.dtype)
    _checks.apart(out, samples)
    return samples


def _report(plan: Plan, done: Done, notes: list[str]) -> Report:
    totals = done.totals
    return Report(
        method=plan.method, tol=plan.tol, backend=plan.backend, isa=plan.by.isa, threads=plan.threads,
        prepare_seconds=totals.prepare_seconds, sum_seconds=totals.sum_seconds, terms=totals.terms,
        share_left_out=1 - totals.terms / (plan.scene.traces * plan.grid.size), factorised_share=done.share,
        predicted_error=done.choices.predicted_error, choices=done.choices.reported(), notes=tuple(notes),
    )  # fmt: skip
