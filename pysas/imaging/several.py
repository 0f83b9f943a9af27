"""What the doorways do: an image of echoes, or the sum of the images of several Echoes on one grid.

Bands, arrays or pairs of transmitters and receivers that differ in sampling, carrier or geometry are Echoes of their own. Each
of their images is within tol of max(its norm, its R). Errors of different samples are unrelated, so that in the sum they add as
squares, as R^2 does: with R the level of all, the sum is within tol R where R decides. Where the images' own norms do, which
samples that add up in phase make, the sum's norm is at least the root of their squares' sum, and it is within tol of that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.imaging import planner, words
from pysas.model.echoes import Echoes
from pysas.model.gaps import shortened
from pysas.model.grid import Grid
from pysas.model.image import Image, Report

Progress = Callable[[float], None] | None


@dataclass(frozen=True)
class How:
    """How each image is made: arguments of `planner.plan`."""

    tol: float
    method: str
    threads: int | None
    backend: str
    nan: str
    fallback: bool = True


def image(echoes: Any, grid: Grid, how: How, weights: Any, out: ComplexArray | None, progress: Progress) -> Image:
    """The image of Echoes, or the sum of those of a list or tuple of them, with as many `weights`, or None."""
    _check_out(out, echoes, grid, progress)
    if not isinstance(echoes, list | tuple):
        return _one(echoes, grid, how, weights, out, progress)
    parts = list(echoes)
    given = _check_parts(parts, weights)
    made: list[Image] = []
    total = room = None
    for number, part in enumerate(parts):

        def tick(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(parts))

        try:
            if number == 1:
                room = np.empty(grid.shape, dtype=part.dtype)
            found = _one(part, grid, how, given[number], out if number == 0 else room, tick if progress is not None else None)
        except (ValueError, TypeError) as error:
            error.add_note(f"echoes {number} of {len(parts)}, counted from 0")
            raise
        made.append(found)
        if total is None:
            total = found.data
        else:
            total += found.data
    if total is None:
        raise _checks.InternalError("no image")
    traces = np.array([part.n_ping * part.n_channel for part in parts], dtype=np.float64)
    fc, c = (float(np.average([getattr(one, name) for one in made], weights=traces)) for name in ("fc", "c"))
    return Image(total, grid, _report([one.report for one in made], traces), fc, c)


def _one(echoes: Any, grid: Grid, how: How, weights: Any, out: ComplexArray | None, progress: Progress) -> Image:
    count = 0
    if how.nan == "mask" and isinstance(echoes, Echoes):  # plans are made from geometry alone: what was recorded is part of it
        echoes, count = shortened(echoes)
    plan = planner.plan(echoes, grid, how.tol, how.method, how.threads, how.backend, weights, how.nan, how.fallback)
    made = plan(echoes.data, out, progress)
    if not count:
        return made
    notes = (words.shortened(count, echoes.n_ping * echoes.n_channel), *made.report.notes)
    return dataclasses.replace(made, report=dataclasses.replace(made.report, notes=notes))


def _check_parts(parts: list[Any], weights: Any) -> list[Any]:
    """Weights of each of several Echoes, once these can be summed."""
    if not parts:
        raise ValueError("echoes: found none in the sequence: expected at least one pysas.Echoes")
    for number, part in enumerate(parts):
        if not isinstance(part, Echoes):
            raise TypeError(f"echoes[{number}]={type(part).__name__}: expected pysas.Echoes")
        if part.dtype != parts[0].dtype:
            raise TypeError(f"echoes[{number}]: {part.dtype} after {parts[0].dtype}: expected one dtype of all that are summed")
    if weights is None:
        return [None] * len(parts)
    if not isinstance(weights, list | tuple) or len(weights) != len(parts):
        found = f"{len(weights)}" if isinstance(weights, list | tuple) else type(weights).__name__
        raise ValueError(f"weights: found {found}: expected None, or a list of {len(parts)}, one for each Echoes")
    return list(weights)


def _report(reports: Sequence[Report], traces: Any) -> Report:
    """One report of several sums of so many traces."""
    first, terms = reports[0], sum(report.terms for report in reports)
    errors = [report.predicted_error for report in reports if report.predicted_error is not None]
    return dataclasses.replace(
        first, method=" + ".join(dict.fromkeys(report.method for report in reports)),
        prepare_seconds=sum(report.prepare_seconds for report in reports),
        sum_seconds=sum(report.sum_seconds for report in reports), terms=terms,
        share_left_out=float(np.average([report.share_left_out for report in reports], weights=traces)),
        factorised_share=sum(report.factorised_share * report.terms for report in reports) / max(terms, 1),
        predicted_error=max(errors) if errors else None,  # of squares that add up, by the R^2 of each
        choices={f"echoes {number}": dict(report.choices) for number, report in enumerate(reports)},
        notes=tuple(f"echoes {number}: {note}" for number, report in enumerate(reports) for note in report.notes),
    )  # fmt: skip


def _check_out(out: ComplexArray | None, echoes: Any, grid: Any, progress: Progress) -> None:
    """Check `out` and `progress` before any work, where what `out` must fit is what it should be."""
    _checks.callback("progress", progress)
    if not isinstance(grid, Grid):
        return
    for part in echoes if isinstance(echoes, list | tuple) else [echoes]:
        if isinstance(part, Echoes):
            _checks.target(out, grid.shape, part.dtype)
            _checks.apart(out, part.data)
