"""A plan of an engine that plans and sums by itself, as its compiled code has it."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from pysas._checks import ComplexArray, FloatArray
from pysas.engine import Planning, interface
from pysas.engine.survey import Totals, readable
from pysas.imaging import words
from pysas.imaging.plans import Done, EnginePlan
from pysas.model.grid import Grid
from pysas.planning import view_angles
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

BESIDE = "bright samples beside"


class Compiled:
    """See plans.EnginePlan."""

    def __init__(
        self, scene: Scene, grid: Grid, tol: float, budget: float, views: float, method: str, fallback: bool, threads: int,
        engine: Planning,
    ) -> None:  # fmt: skip
        """`views` : what weights uniform in view angle are wrong by, beside the `budget` of sums."""
        self.scene, self.shape, self.tol, self.views = scene, grid.shape, tol, views
        self.plan = engine.plan(
            scene, grid.shape, grid.mask, _places(grid, scene.origin), tol, budget, method, fallback, threads
        )

    def _choices(self, plan: interface.Chosen, more: float = 0.0) -> Choices:
        errors = dict(plan.choices["errors"])
        if self.scene.uniform:
            errors["view angles"] = self.views
        if more:
            errors[BESIDE] = more
        return Choices(**plan.choices | {"errors": errors})

    @functools.cached_property
    def choices(self) -> Choices:
        """Settings of data that are no brighter beside what pixels read."""
        return self._choices(self.plan)

    @property
    def isa(self) -> str:
        return str(self.plan.isa)

    @property
    def share(self) -> float:
        return float(self.plan.share)

    @property
    def trees(self) -> int:
        return int(self.plan.trees)

    @property
    def why_direct(self) -> str:
        return str(self.plan.why_direct)

    @property
    def seconds(self) -> float:
        return float(self.plan.seconds)

    @property
    def weights_bytes(self) -> int:
        """Of weights uniform in view angle."""
        scene = self.scene
        if scene.lattice is not None:
            return int(scene.lattice.value.nbytes)
        item = 4 if self.choices.precision == "float32" else 8
        return min(view_angles.BYTES, scene.pixels * scene.traces * item) if scene.each else 0

    @property
    def memory(self) -> int:
        return int(self.plan.memory) + self.weights_bytes

    def describe(self) -> str:
        return str(self.plan.describe(" x ".join(map(str, self.shape)), self.weights_bytes))

    def other(self) -> str:
        return str(self.plan.other())

    def follow(self, before: EnginePlan) -> None:
        if isinstance(before, Compiled):
            self.plan.follow(before.plan)

    def image(
        self, samples: ComplexArray, image: ComplexArray, nan: str, progress: Callable[[float], None] | None
    ) -> Done:  # fmt: skip
        scene, width = self.scene, self.shape[-1]
        traces = readable(samples if samples.ndim == 3 else samples[:, None, :])
        rows = _rows(image, width)
        lines = np.empty((image.size // width, width), dtype=image.dtype) if rows is None else rows
        done = self.plan(traces, lines, nan == "raise", progress)
        if rows is None:
            image[...] = lines.reshape(image.shape)
        finite = np.ones(scene.traces, dtype=np.bool_)
        finite[list(done.left_out)] = False
        choices = self._choices(done, done.beside) if done.used else self.choices
        notes = [words.direct(done.why_direct)] * bool(done.why_direct)
        notes += [words.left_out(len(done.left_out), scene.traces)] * bool(done.left_out)
        notes += [words.WIDE] * choices.wide
        warned = []
        if done.beside:
            warned.append(words.not_promised(self.tol, choices.predicted_error))
        if done.loudest >= 0:
            warned.append(words.lost_beside(done.loudest, scene.channels))
        if done.lost:
            warned.append(words.too_small(image.dtype, done.lost))
        totals = Totals(done.prepare_seconds, done.sum_seconds, done.terms)
        return Done(totals, choices, float(done.share), finite, notes, warned)


def _places(grid: Grid, origin: FloatArray) -> interface.Places:
    """Where a grid's pixels lie."""
    if grid.coords is not None:
        return grid.coords.reshape(-1, 3)
    if grid.turned and grid.kind == "surface":
        return grid.coordinates()
    if grid.kind == "surface":
        return grid.axes["x"], grid.axes["y"], np.asarray(grid.height)
    return lambda numbers: np.ascontiguousarray(grid.coordinates(numbers) - origin)


def _rows(image: ComplexArray, width: int) -> ComplexArray | None:
    """`image` as (row, column) without a copy, or None where its strides do not allow it."""
    if image.ndim == 2:
        rows = image
    elif image.flags.c_contiguous or image.ndim == 1:
        rows = image.reshape(-1, width)
    else:
        return None
    return rows if rows.dtype.isnative and all(step % image.itemsize == 0 for step in rows.strides) else None
