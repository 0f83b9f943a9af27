"""Fast factorised back-projection: the sum of back-projection through a tree of sub-apertures.

`accumulate` carries out on the engine what forest.py laid out. Choices are made in planner.py. docs/ffbp.md tells what bounds
the error.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray, InternalError
from pysas.engine.steps import Setting, Stack
from pysas.engine.survey import Totals
from pysas.engine.traces import TILE_ROWS
from pysas.engine.tree import SubImages
from pysas.imaging.plans import Plan
from pysas.planning.forest import batches
from pysas.planning.raster import Raster
from pysas.planning.tiles import Section, pixels_of


def accumulate(
    plan: Plan, samples: ComplexArray, used: npt.NDArray[np.bool_], survey_of: Callable[[Any], Any], scale: float,
    trigonometry: tuple[tuple[float, ...], tuple[float, ...]], carrier: tuple[tuple[float, ...], tuple[float, ...]],
    image: ComplexArray, isa: str, progress: Callable[[float], None] | None,
) -> Totals:  # fmt: skip
    """Add all traces `used` of `samples` to `image` (line, pixel), by trees and directly."""
    forest, choices, threads = plan.forest, plan.choices, plan.threads
    if forest is None:
        raise InternalError("a plan without trees was to be summed through them")
    raster, scene = forest.raster, forest.scene
    traces = samples if samples.ndim == 3 else samples[:, None, :]
    stores: dict[int, Any] = {}
    prepared = summed = 0.0
    terms = 0
    trees = [(section, t) for section in forest.sections for t in section.trees]
    whole = sum(len(t.order) for _, t in trees)
    longest = max(end - begin for _, t in trees for begin, end, _, _ in batches(t, choices.batch))
    setting = Setting(forest.layout.taps, 2 * scene.fc / scene.c, trigonometry, carrier, threads, isa)
    engine = plan.engine.steps(setting, plan.reader, longest)
    done = 0

    def store(level: int, size: int) -> Any:
        if level not in stores or stores[level].size < size:
            stores[level] = np.zeros(size, dtype=np.float32)
        return stores[level]

    def rise(levels: tuple[SubImages, ...], below: int, begin: int, end: int) -> None:
        """Merge complete sub-images [begin, end) of a level into their parents, and parents that this completes into theirs.

        So each level above the leaves needs room for one sub-image alone.
        """
        span, whole_from = levels[below + 1].span, begin
        while begin < end:
            parent = int(np.searchsorted(span, begin, side="right")) - 1
            stop = min(end, int(span[parent + 1]))
            children, level = levels[below].part(begin, stop), levels[below + 1].part(parent, parent + 1)
            last = stop == span[parent + 1]
            children.shape[:, 3] += levels[below].shape[begin, 3] - levels[below].shape[whole_from, 3]
            engine.merge(
                children, stores[below], level, store(below + 1, level.size), begin > span[parent], last,
                last and below + 2 == len(levels),
            )  # fmt: skip
            if last and below + 2 < len(levels):
                rise(levels, below + 1, parent, parent + 1)
            begin = stop

    for section, t in trees:
        own = slice(section.begin, section.end)
        part_of = image[own]
        lines = (raster.first[own], raster.step[own]) if raster.straight else None
        direct = pixels_of(t.direct, section, raster.count) if t.direct.any() else None
        survey = survey_of(t.order)
        kept = used[t.order]
        if not kept.all():
            survey = replace(survey, weights=np.where(kept, survey.weights, 0))
        for begin, end, leaf0, leaf1 in batches(t, choices.batch):
            clock = time.perf_counter()
            batch = survey.part(begin, end)
            engine.prepare(traces, t.order[begin:end], batch, kept[begin:end], scale)
            now = time.perf_counter()
            prepared += now - clock

            def tick(share: float, done: float = done + begin, more: int = end - begin) -> None:
                if progress is not None:
                    progress((done + share * more) / whole)

            if t.subtree is not None:
                levels = t.subtree.levels
                level = levels[0].part(leaf0, leaf1)
                engine.leaves(batch, level, store(0, level.size), choices.errors["drift"], len(levels) == 1, tick)
                if len(levels) > 1:
                    rise(levels, 0, leaf0, leaf1)
            if direct is not None:
                if lines is not None:
                    terms += engine.direct(batch, lines, None, direct, raster.count, part_of, tick)
                for row, last in () if lines is not None else _bands(section, direct):
                    points = _points(raster, section, row, last).reshape(1, -1, 3)
                    some = np.zeros((1, points.shape[1]), dtype=part_of.dtype)
                    terms += engine.direct(batch, None, points, direct[row:last].reshape(1, -1), raster.count, some, tick)
                    part_of[row:last] += some.reshape(last - row, -1)
            summed += time.perf_counter() - now
        done += len(t.order)
        if t.subtree is None:
            continue
        now = time.perf_counter()
        levels = t.subtree.levels
        top = levels[-1]
        if section.flat and lines is not None:
            engine.read(top, stores[len(levels) - 1], lines, None, None, section.mask, raster.count, t.read, part_of)
        else:
            stack = Stack(t.group.axis, section.planes, section.number)
            tiles = t.read.reshape(-1, -(-section.width // raster.count))
            for row, last in _bands(section, pixels_of(t.read, section, raster.count)):
                part = None if section.mask is None else section.mask[row:last]
                points, here = _points(raster, section, row, last), tiles[row // TILE_ROWS]
                engine.read(top, stores[len(levels) - 1], None, points, stack, part, raster.count, here, part_of[row:last])
        terms += 0 if section.number else int(np.count_nonzero(kept)) * int(section.pixels[t.read].sum())
        summed += time.perf_counter() - now
        if progress is not None:
            progress(done / whole)
    return Totals(prepared, summed, terms)


def _bands(section: Section, pixels: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Rows of tiles, as lines [begin, end), that have any of the pixels."""
    height = section.end - section.begin
    rows = [(top, min(top + TILE_ROWS, height)) for top in range(0, height, TILE_ROWS)]
    return [(top, bottom) for top, bottom in rows if pixels[top:bottom].any()]


def _points(raster: Raster, section: Section, top: int, bottom: int) -> FloatArray:
    """Pixels (line, pixel, 3) of some of a section's lines."""
    first, last = section.begin + top, section.begin + bottom
    if raster.straight:
        along = np.arange(section.width)[None, :, None] * raster.step[first:last, None]
        return np.ascontiguousarray(raster.first[first:last, None] + along)
    return raster.points(first * section.width, last * section.width).reshape(bottom - top, section.width, 3)
