"""Fast factorised back-projection: the sum of back-projection through a tree of sub-apertures, within a stated error.

`Forest` holds, for each of the longest groups of pings, a tree of polar grids (subapertures.py), the tiles of the image read
from it and those summed directly; `accumulate` carries it out on the engine. Choices are made in planner.py. docs/ffbp.md
tells what bounds the error.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pysas import subapertures
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import MOVING, native
from pysas.engine.steps import Setting, steps
from pysas.engine.summation import Totals
from pysas.engine.tree import SubImages, Taps
from pysas.image import Image
from pysas.scene import Scene
from pysas.subapertures import BoolArray, Medium, Reads, Subtree

if TYPE_CHECKING:
    from pysas.backprojection import Frame
    from pysas.echoes import Echoes
    from pysas.grid import Grid
    from pysas.planner import Choices
    from pysas.plans import Plan

TILE_ROWS = 32
WIDE = 0.3  # a tile's radius, seen from a group, at most: rad


def ffbp(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    fallback: bool = True,
    threads: int | None = None,
    backend: str = "auto",
    weights: npt.ArrayLike | None = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """The image of `backproject`, through a tree of sub-apertures: about N^2 log N work where that takes N^3.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed echoes; any track and array, moving receivers included.
    grid : Grid
    tol : float
        Relative error that is kept, as in `backproject`.
    fallback : bool
        Whether terms that cannot be factorised, or not within `tol`, are summed directly: pixels near the track or across
        the ends of records or beams, surfaces and lists of points, tolerances below 3e-5. False: an error says
        why. `image.report.factorised_share` tells how much went through the tree.
    threads, backend, weights, nan, out, progress
        As in `backproject`.

    Returns
    -------
    Image

    Raises
    ------
    ValueError, TypeError
        As `backproject`; also where `fallback` is False and terms would have to be summed directly.

    Notes
    -----
    Memory beyond input and image: one batch of tables (about 25 MB) and of leaves, and one sub-image of each level above.
    """
    from pysas import backprojection, planner

    backprojection.check_out_of(out, echoes, grid)
    plan = planner.plan(echoes, grid, tol, "ffbp", threads, backend, weights, nan, fallback)
    return plan(echoes.data, out, progress)


@dataclass(frozen=True)
class Tree:
    """One of the longest groups: its sub-images if any tile is read from it, its traces (flat numbers), the tiles' fates."""

    order: npt.NDArray[np.int64]
    read: BoolArray
    direct: BoolArray
    subtree: Subtree | None
    extent: float


@dataclass
class Sheet:
    """Lines [begin, end) of the image, which lie on one horizontal plane, and their trees."""

    begin: int
    end: int
    width: int
    plane: float
    mask: npt.NDArray[np.bool_] | None
    active: BoolArray  # tiles with any pixel wanted
    corners: FloatArray
    trees: list[Tree] = field(default_factory=list)


@dataclass(frozen=True)
class Layout:
    """How a tree is cut: groups of at most `length` m, in parts of parts; taps; `spare` of sampling.

    `clear`: slant range (m) that nodes must have.
    """

    length: float
    fans: tuple[int, ...]
    taps: Taps
    spare: float
    clear: float


@dataclass
class Forest:
    """All trees of an image."""

    scene: Scene
    frame: Frame
    layout: Layout
    rate: Fraction  # nodes per sample
    step: float
    sheets: list[Sheet]
    choices: Choices
    share: float
    seconds: float = 0.0

    @property
    def trees(self) -> list[Tree]:
        return [t for sheet in self.sheets for t in sheet.trees]

    @property
    def store_bytes(self) -> int:
        """Of the sub-images alive at a time: a batch of leaves, and one sub-image of each level above them."""
        most: dict[int, int] = {}
        for t in self.trees:
            levels = t.subtree.levels if t.subtree is not None else ()
            for i, level in enumerate(levels):
                leaves = [(first, last) for _, _, first, last in batches(t, self.choices.batch)]
                parts = leaves if i == 0 else [(k, k + 1) for k in range(len(level))]
                most[i] = max(most.get(i, 0), *(4 * level.part(first, last).size for first, last in parts))
        return sum(most.values())

    def describe(self) -> list[str]:
        """The tree, for print(plan)."""
        taps, trees = self.layout.taps, [t for t in self.trees if t.subtree is not None]
        lines = [
            f"  tree           {len(self.trees)} groups of at most {max(t.extent for t in self.trees):.3g} m, "
            f"{taps.width} taps at {taps.rate:.3g} x the band, nodes every {self.step:.3g} m",
            f"  factorised     {100 * self.share:.1f} % of the terms, the rest summed directly",
        ]
        if trees:
            levels = trees[len(trees) // 2].subtree.levels  # type: ignore[union-attr]
            for i, level in enumerate(levels):
                made = f"{level.span[-1] / len(level):.3g} {'traces' if i == 0 else 'sub-images'} each"
                lines.append(
                    f"    level {i}      {len(level)} sub-images of {made}, {level.nodes / len(level):.3g} nodes, "
                    f"a ray every {np.mean(level.place[:, 5]):.2g} rad"
                )
        return lines


def sheets(frame: Frame, mask: npt.NDArray[np.bool_] | None) -> list[Sheet] | None:
    """The image's lines by the plane they lie on; None where they lie on none."""
    if not frame.straight or np.any(frame.step[:, 2]):
        return None
    planes = frame.first[:, 2]
    cuts = np.concatenate([[0], np.flatnonzero(np.diff(planes)) + 1, [len(planes)]])
    if len(cuts) - 1 > max(1, len(planes) // TILE_ROWS):
        return None
    found = []
    for begin, end in zip(cuts[:-1], cuts[1:], strict=True):
        first, step = frame.first[begin:end], frame.step[begin:end]
        width, count = frame.shape[1], frame.count
        top = np.arange(0, end - begin, TILE_ROWS)
        left = np.arange(0, width, count)
        rows = np.stack([top, np.minimum(top + TILE_ROWS, end - begin) - 1], axis=1)
        columns = np.stack([left, np.minimum(left + count, width) - 1], axis=1)
        corners = first[rows][:, None, :, None] + columns[None, :, None, :, None] * step[rows][:, None, :, None]
        corners = corners.reshape(-1, 4, 3)
        part = None if mask is None else np.ascontiguousarray(mask[begin:end])
        active = np.ones(len(corners), dtype=np.bool_)
        if part is not None:
            padded = np.zeros((len(top) * TILE_ROWS, len(left) * count), dtype=np.bool_)
            padded[: part.shape[0], :width] = part
            active = padded.reshape(len(top), TILE_ROWS, len(left), count).any(axis=(1, 3)).ravel()
        found.append(Sheet(int(begin), int(end), width, float(planes[begin]), part, active, corners))
    return found


def _fates(
    scene: Scene, order: npt.NDArray[np.int64], members: subapertures.Group, corners: FloatArray, active: BoolArray,
    layout: Layout, step: float, plane: float, near: float,
) -> tuple[BoolArray, BoolArray]:  # fmt: skip
    """Which tiles are read from a group's sub-image, and which are summed directly; the rest is silent or not wanted."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    ground = np.linalg.norm(middle[:, :2] - members.centre[:2], axis=1)
    nearest = ground - radius
    # nodes that a read depends on lie this much further out or in, and to the sides
    reach = (len(layout.fans) + 1) * (layout.taps.reach + 4) * step
    height = float(members.centre[2]) - plane
    least = max(float(np.hypot(subapertures.NEAR * members.extent, height)), layout.clear)
    away = subapertures.slant(np.maximum(nearest, 0), height)
    read = active & (away >= near) & (away - reach >= least) & (radius <= WIDE * ground)
    some = order[:: max(1, len(order) // 32)]
    geometry = scene.geometry[some]
    places = subapertures.phase_centres(scene.geometry[order], 0.0)
    slack = float(np.max(np.linalg.norm(np.diff(places, axis=0), axis=1), initial=0.0)) * max(1, len(order) // 32)
    heard = np.zeros_like(active)
    inside = np.ones_like(active)
    for row in geometry:
        there = np.linalg.norm(middle - row[0:3], axis=1)
        back = np.linalg.norm(middle - row[3:6], axis=1)
        speed = float(np.linalg.norm(row[6:9]))
        spread = 2 * (radius + slack)
        low = ((there + back - spread - 2 * reach) / (scene.c + speed) - row[12]) * scene.fs
        high = ((there + back + spread + 2 * reach) / (scene.c - speed) - row[12]) * scene.fs
        heard |= (high >= 0) & (low <= scene.n_sample - 1)
        inside &= (low >= 0) & (high <= scene.n_sample - 1)
        if scene.cos_beam > -1:
            lateral = radius + slack + 6 * layout.taps.reach * subapertures.WIDEST * ground
            cosine = np.sum((middle - row[0:3]) * row[9:12], axis=1) / np.maximum(there, 1e-9)
            angle = np.arccos(np.clip(cosine, -1, 1)) + np.arcsin(np.minimum(1, lateral / np.maximum(there, 1e-9)))
            inside &= (angle <= np.arccos(scene.cos_beam)) & (lateral < there)
    read &= inside
    return read, active & heard & ~read


def grow(scene: Scene, frame: Frame, mask: npt.NDArray[np.bool_] | None, layout: Layout, near: float) -> Forest | None:
    """All trees of an image, without choices for the direct sums; None where the image's lines lie on no planes."""
    found = sheets(frame, mask)
    order = np.flatnonzero(scene.heard if scene.weights is None else scene.heard & (scene.weights != 0))
    if found is None or not order.size:
        return None
    medium = Medium(scene.c, scene.fc, 2 * scene.band * scene.fs)
    delay = (scene.nearest + scene.farthest) / scene.c if scene.kind == MOVING else 0.0
    centres = subapertures.phase_centres(scene.geometry, delay)
    pieces = [order[part] for part in subapertures.cut_track(centres[order], order // scene.channels, layout.length)]
    groups = [subapertures.group(part, centres) for part in pieces]
    # one node spacing for all grids: neighbours along a parent's ray are neighbours on a child's
    highest = 1e-9
    fates = {}
    step = scene.c / (2 * medium.bandwidth * layout.taps.rate)
    for sheet in found:
        for i, (members, _) in enumerate(groups):
            read, direct = _fates(scene, pieces[i], members, sheet.corners, sheet.active, layout, step, sheet.plane, near)
            fates[id(sheet), i] = read, direct
            if read.any():
                angle, bearings, grounds = Reads(sheet.corners).seen_from(members.centre, np.flatnonzero(read))
                angles = angle + np.linspace(bearings.min(), bearings.max(), 9)
                highest = max(
                    highest,
                    subapertures.bands(
                        members, scene.geometry, medium, sheet.plane, angles, np.linspace(grounds.min(), grounds.max(), 4)
                    )[1],
                )
    # and as long as a table's intervals, of which there are a simple number to a sample
    rate = native.simple_rate(scene.c * layout.taps.rate * layout.spare * highest / scene.fs)
    step = scene.c * rate.denominator / (2 * scene.fs * rate.numerator)
    wider = copy.copy(scene)
    wider.first, wider.last = scene.first.copy(), scene.last.copy()
    through = everything = 0
    for sheet in found:
        pixels = _sizes(sheet, frame.count)
        for i, (members, along) in enumerate(groups):
            read, direct = fates[id(sheet), i]
            if not (read.any() or direct.any()):
                continue
            subtree = None
            if read.any():
                subtree = subapertures.plant(
                    members, along, layout.fans, scene.geometry, centres, medium, sheet.plane, Reads(sheet.corners), read,
                    step, layout.taps, layout.spare,
                )  # fmt: skip
                _widen(wider, subtree, step)
            traces = pieces[i] if subtree is None else subtree.traces
            sheet.trees.append(Tree(traces, read, direct, subtree, members.extent))
            through += len(traces) * int(pixels[read].sum())
            everything += len(traces) * int(pixels[read | direct].sum())
    if not any(sheet.trees for sheet in found):
        return None
    return Forest(wider, frame, layout, rate, step, found, None, through / max(everything, 1))  # type: ignore[arg-type]


def _widen(scene: Scene, subtree: Subtree, step: float) -> None:
    """Samples that a tree's leaves ask of their traces, whatever the image asks."""
    leaves = subtree.levels[0]
    for i in range(len(leaves)):
        traces = subtree.traces[leaves.span[i] : leaves.span[i + 1]]
        i0, rays, _, _, first = leaves.shape[i]
        ends = leaves.range[first : first + rays]
        ends = ends[ends[:, 0] < ends[:, 1]] + i0
        centre = leaves.place[i, :3]
        low, high = (ends[:, 0].min() - 1) * step, (ends[:, 1].max() + 1) * step
        g = scene.geometry[traces]
        apart = np.linalg.norm(g[:, 0:3] - centre, axis=1) + np.linalg.norm(g[:, 3:6] - centre, axis=1)
        speed = np.linalg.norm(g[:, 6:9], axis=1)
        begin = np.floor(((np.maximum(2 * low - apart, 0)) / (scene.c + speed) - g[:, 12]) * scene.fs).astype(np.int64)
        end = np.ceil(((2 * high + apart) / (scene.c - speed) - g[:, 12]) * scene.fs).astype(np.int64)
        scene.first[traces] = np.maximum(np.minimum(scene.first[traces], begin), 0)
        scene.last[traces] = np.minimum(np.maximum(scene.last[traces], end), scene.n_sample - 1)


def accumulate(
    plan: Plan, samples: ComplexArray, used: npt.NDArray[np.bool_], survey_of: Callable[[Any], Any], scale: float,
    trigonometry: tuple[tuple[float, ...], tuple[float, ...]], carrier: tuple[tuple[float, ...], tuple[float, ...]],
    image: ComplexArray, isa: str, progress: Callable[[float], None] | None,
) -> Totals:  # fmt: skip
    """Add all traces `used` of `samples` to `image` (line, pixel), by trees and directly."""
    forest, choices, threads = plan.forest, plan.choices, plan.threads
    assert forest is not None
    frame, scene = forest.frame, forest.scene
    traces = samples if samples.ndim == 3 else samples[:, None, :]
    stores: dict[int, Any] = {}
    prepared = summed = 0.0
    terms = 0
    trees = [(sheet, t) for sheet in forest.sheets for t in sheet.trees]
    whole = sum(len(t.order) for _, t in trees)
    longest = max(end - begin for _, t in trees for begin, end, _, _ in batches(t, choices.batch))
    setting = Setting(forest.layout.taps, 2 * scene.fc / scene.c, trigonometry, carrier, threads, isa)
    engine = steps(setting, plan.reader, longest)
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

    for sheet, t in trees:
        first, step = frame.first[sheet.begin : sheet.end], frame.step[sheet.begin : sheet.end]
        part_of = image[sheet.begin : sheet.end]
        direct = _pixels(t.direct, sheet, frame.count) if t.direct.any() else None
        survey = survey_of(t.order)
        kept = used[t.order]
        if not kept.all():
            survey = replace(survey, weights=np.where(kept, 1.0 + 0j if survey.weights is None else survey.weights, 0))
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
                terms += engine.direct(batch, first, step, direct, frame.count, part_of, tick)
            summed += time.perf_counter() - now
        done += len(t.order)
        if t.subtree is None:
            continue
        now = time.perf_counter()
        levels = t.subtree.levels
        top = levels[-1]
        engine.read(top, stores[len(levels) - 1], first, step, sheet.mask, frame.count, t.read, part_of)
        terms += int(np.count_nonzero(kept)) * _wanted(t.read, sheet, frame.count)
        summed += time.perf_counter() - now
        if progress is not None:
            progress(done / whole)
    return Totals(prepared, summed, terms)


def batches(t: Tree, batch: int) -> list[tuple[int, int, int, int]]:
    """Traces [begin, end) at a time, of leaves [first, last)."""
    if t.subtree is None:
        return [(b, min(b + batch, len(t.order)), 0, 0) for b in range(0, len(t.order), batch)]
    levels = t.subtree.levels
    span = levels[0].span
    found, leaf = [], 0
    while leaf < len(span) - 1:
        last = max(leaf + 1, int(np.searchsorted(span, span[leaf] + batch, side="right")) - 1)
        if len(levels) > 1:  # whole parents, if one fits: what is merged in parts is read and written again
            whole = int(levels[1].span[np.searchsorted(levels[1].span, last, side="right") - 1])
            last = whole if whole > leaf else last
        found.append((int(span[leaf]), int(span[last]), leaf, last))
        leaf = last
    return found


def _sizes(sheet: Sheet, count: int) -> npt.NDArray[np.int64]:
    """Pixels of each tile."""
    height, width = sheet.end - sheet.begin, sheet.width
    down, across = -(-height // TILE_ROWS), -(-width // count)
    rows = np.minimum(TILE_ROWS, height - TILE_ROWS * np.arange(down))
    columns = np.minimum(count, width - count * np.arange(across))
    return np.asarray((rows[:, None] * columns).ravel())


def _pixels(tiles: BoolArray, sheet: Sheet, count: int) -> npt.NDArray[np.bool_]:
    """The pixels of some tiles, (line, pixel)."""
    height = sheet.end - sheet.begin
    grid = tiles.reshape(-(-height // TILE_ROWS), -1)
    full = np.repeat(np.repeat(grid, TILE_ROWS, axis=0), count, axis=1)[:height, : sheet.width]
    return np.ascontiguousarray(full if sheet.mask is None else full & sheet.mask)


def _wanted(tiles: BoolArray, sheet: Sheet, count: int) -> int:
    """How many pixels some tiles have."""
    return int(np.count_nonzero(_pixels(tiles, sheet, count)))


__all__ = ["Forest", "Layout", "accumulate", "ffbp", "grow"]
