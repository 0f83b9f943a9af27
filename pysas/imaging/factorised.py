"""Fast factorised back-projection: the sum of back-projection through a tree of sub-apertures.

`accumulate` carries out on the engine what planning/fallback laid out. docs/ffbp.md tells what bounds
the error.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, InternalError
from pysas.engine.steps import Setting, Steps
from pysas.engine.survey import Survey, Totals, Trigonometry
from pysas.engine.tree import SubImages
from pysas.imaging.interpreted import Interpreted
from pysas.planning.tiles import batches, pixels_of


class _Levels:
    """Sub-images of one tree after another: of each level above the leaves there is room for one alone."""

    def __init__(self, steps: Steps) -> None:
        self.steps = steps
        self.stores: dict[int, npt.NDArray[np.float32]] = {}

    def room(self, level: int, size: int) -> npt.NDArray[np.float32]:
        """For `size` reals of sub-images of a level."""
        if level not in self.stores or self.stores[level].size < size:
            self.stores[level] = np.zeros(size, dtype=np.float32)
        return self.stores[level]

    def merge(self, levels: tuple[SubImages, ...], below: int, begin: int, end: int) -> None:
        """Complete sub-images [begin, end) of a level into their parents, and parents that this completes into theirs."""
        span, whole_from = levels[below + 1].span, begin
        while begin < end:
            parent = int(np.searchsorted(span, begin, side="right")) - 1
            stop = min(end, int(span[parent + 1]))
            children, level = levels[below].part(begin, stop), levels[below + 1].part(parent, parent + 1)
            last = stop == span[parent + 1]
            children.shape[:, 3] += levels[below].shape[begin, 3] - levels[below].shape[whole_from, 3]
            self.steps.merge(
                children, self.stores[below], level, self.room(below + 1, level.size), begin > span[parent], last,
                last and below + 2 == len(levels),
            )  # fmt: skip
            if last and below + 2 < len(levels):
                self.merge(levels, below + 1, parent, parent + 1)
            begin = stop


def accumulate(
    plan: Interpreted, samples: ComplexArray, used: npt.NDArray[np.bool_], survey_of: Callable[[Any], Survey], scale: float,
    trigonometry: Trigonometry, carrier: Trigonometry, image: ComplexArray, progress: Callable[[float], None] | None,
) -> Totals:  # fmt: skip
    """Add all traces `used` of `samples` to `image` (line, pixel), by trees and directly."""
    forest, choices = plan.forest, plan.choices
    if forest is None:
        raise InternalError("a plan without trees was to be summed through them")
    raster, scene = forest.raster, forest.scene
    traces = samples if samples.ndim == 3 else samples[:, None, :]
    trees = [(section, t) for section in forest.sections for t in section.trees]
    whole = sum(len(t.order) for _, t in trees)
    longest = max(end - begin for _, t in trees for begin, end, _, _ in batches(t, choices.batch))
    setting = Setting(forest.layout.taps, 2 * scene.fc / scene.c, trigonometry, carrier, plan.threads, plan.engine.isa())
    steps = plan.engine.steps(setting, plan.reader, longest)
    sub_images = _Levels(steps)
    prepared = summed = 0.0
    terms = done = 0
    for section, t in trees:
        own = slice(section.begin, section.end)
        part_of, lines = image[own], (raster.first[own], raster.step[own])
        direct = pixels_of(t.direct, section, raster.count) if t.direct.any() else None
        survey, kept = survey_of(t.order), used[t.order]
        if not kept.all():
            survey = replace(survey, weights=np.where(kept, survey.weights, 0))
        levels = () if t.subtree is None else t.subtree.levels
        for begin, end, leaf0, leaf1 in batches(t, choices.batch):
            clock = time.perf_counter()
            batch = survey.part(begin, end)
            steps.prepare(traces, t.order[begin:end], batch, kept[begin:end], scale)
            now = time.perf_counter()
            prepared += now - clock

            def tick(share: float, done: float = done + begin, more: int = end - begin) -> None:
                if progress is not None:
                    progress((done + share * more) / whole)

            if levels:
                level = levels[0].part(leaf0, leaf1)
                steps.leaves(batch, level, sub_images.room(0, level.size), choices.errors["drift"], len(levels) == 1, tick)
                if len(levels) > 1:
                    sub_images.merge(levels, 0, leaf0, leaf1)
            if direct is not None:
                terms += steps.direct(batch, lines, direct, raster.count, part_of, tick)
            summed += time.perf_counter() - now
        done += len(t.order)
        if levels:
            now = time.perf_counter()
            steps.read(levels[-1], sub_images.stores[len(levels) - 1], lines, section.mask, raster.count, t.read, part_of)
            terms += int(np.count_nonzero(kept)) * int(section.pixels[t.read].sum())
            summed += time.perf_counter() - now
            if progress is not None:
                progress(done / whole)
    return Totals(prepared, summed, terms)
