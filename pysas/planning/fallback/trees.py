"""The Numba engine's trees of sub-apertures: one fixed layout, over horizontal planes whose pixels lie on even lines.

Groups are as long as the nearest pixel allows, cut in four again and again, so that leaves have some dozens of traces; what
tiles near a group, across a beam's edge or a record's end need is summed directly. Bounds are those of docs/ffbp.md.
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.optimize

from pysas._checks import FloatArray
from pysas.engine import MOVING, Parts, tree
from pysas.model.echoes import EDGE
from pysas.model.grid import Grid
from pysas.planning import bounds, subapertures, view_angles
from pysas.planning.fallback import settings
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices
from pysas.planning.subapertures import BoolArray, Medium, Subtree
from pysas.planning.tiles import Section, Tree, batches, sections

# shares of tol: leaves; positions in merges, each of MERGES at most; what records' ends ring with, which adds to merges and
# reads as squares do, and these have the rest
LEAVES, POSITIONS, ENDS = 0.35, 0.03, 0.2
TOL, FARTHEST = 3e-5, 1e9  # float32 sub-images round too much below; wavelengths beyond which there are too many nodes
FAN, MERGES = 4, 4
LEAF, SHORTEST = 64, 16.0  # traces that a leaf has at most, if it is longer than so many wavelengths
LENGTHS = (1.0, 0.5, 0.25, 0.12)  # of the longest that a group may have
LEAST = 32  # traces of a group, on average: reading a pixel takes as long as some twenty terms
TAPS = ((6, 1.2, 8), (6, 1.3, 8), (6, 1.5, 8), (8, 1.5, 10), (8, 1.75, 10))  # width, rate, half a filter; cheapest first
SPARE = 1.05  # sampling beyond the band's own limit along rays
HELD = 0.45  # cycles a sample: nodes for as much hold all that W passes
WIDE = 0.3  # a tile's radius, seen from a group, at most: rad
LEAST_NODES, PAIRS = 1 << 22, 1 << 18  # nodes that trees of any image may have; traces and tiles at a time
NEAR_TRACK, LONGER = "pixels too near the track, or across the ends of records", "a tree would take longer"


@dataclass(frozen=True)
class Layout:
    """Groups of at most `length` m, in parts of parts; taps; slant ranges (m) that nodes must have from the centre of the
    longest group, `clear`, and of its parts, `apart`; samples that a place must lie inside of records, `ends`."""

    length: float
    fans: tuple[int, ...]
    taps: tree.Taps
    clear: float
    apart: float
    ends: float

    def step(self, scene: Scene) -> float:
        """Between nodes, m, before the sub-images' own bands are known."""
        return scene.c / (4 * scene.band * scene.fs * self.taps.rate)


@dataclass
class Forest:
    """All trees of an image, and the settings of the sums at their leaves and beside them."""

    scene: Scene
    raster: Raster
    layout: Layout
    rate: float  # nodes per sample
    step: float
    sections: list[Section]
    choices: Choices
    share: float  # of the terms that go through trees

    @property
    def trees(self) -> list[Tree]:
        return [t for section in self.sections for t in section.trees]

    @property
    def store_bytes(self) -> int:
        """Of the sub-images alive at a time: a batch of leaves, and one sub-image of each level above them."""
        most: dict[int, int] = {}
        for t in self.trees:
            for i, level in enumerate(t.subtree.levels if t.subtree is not None else ()):
                leaves = [(first, last) for _, _, first, last in batches(t, self.choices.batch)]
                parts = leaves if i == 0 else [(k, k + 1) for k in range(len(level))]
                most[i] = max(most.get(i, 0), *(4 * level.part(first, last).size for first, last in parts))
        return sum(most.values())

    def describe(self) -> list[str]:
        """The trees, for print(plan)."""
        taps, longest = self.layout.taps, max(t.group.extent for t in self.trees)
        lines = [
            f"  trees          {len(self.trees)}, over groups of at most {longest:.3g} m, "
            f"{taps.width} taps at {taps.rate:.3g} x the band, nodes every {self.step:.3g} m",
            f"  factorised     {100 * self.share:.1f} % of the terms, the rest summed directly",
        ]
        subtrees = [t.subtree for t in self.trees if t.subtree is not None]
        for i, level in enumerate(subtrees[len(subtrees) // 2].levels):
            made = f"{level.span[-1] / len(level):.3g} {'traces' if i == 0 else 'sub-images'} each"
            lines.append(f"    level {i}      {len(level)} sub-images of {made}, {level.nodes / len(level):.3g} nodes")
        return lines


@dataclass
class Placement:
    """A layout on a scene: traces of its groups, groups with their traces' places along them, phase centres of all traces; of
    each section and group the tiles read from trees, and those summed directly; what share of the terms is read."""

    layout: Layout
    raster: Raster
    pieces: list[npt.NDArray[np.int64]]
    groups: list[tuple[subapertures.Group, FloatArray]]
    centres: FloatArray
    fates: list[tuple[Section, list[tuple[BoolArray, BoolArray]]]]
    share: float


def why_not(scene: Scene, tol: float) -> str:
    """Why no tree is for a scene, whatever its layout; nothing where one may be."""
    node, lattice = scene.c / (4 * scene.band * scene.fs), scene.lattice
    rows = [
        (tol < TOL * (1 - 1e-9), f"tol below {TOL:g}"),
        (scene.farthest > FARTHEST * scene.c / scene.fc, f"range beyond {FARTHEST:g} wavelengths"),
        (not scene.heard.any(), "the grid lies outside the recorded window"),
        (scene.each, "view-angle weights are every pixel's own: views change their order over the image"),
        (
            lattice is not None and lattice.beyond < view_angles.LONGEST * node,
            "views change their order around the image",
        ),
        (
            lattice is not None and not lattice.holds(node, view_angles.LONGEST),
            "view-angle weights change fast along the rays of sub-images",
        ),
        (scene.beamed, "beams have edges in the image"),
        (
            scene.lines is None or bool(np.any(scene.lines[1][:, 2])),
            "relief or points: pixels on no even lines of level planes",
        ),
    ]
    return next((why for found, why in rows if found), "")


def lay_out(scene: Scene, grid: Grid, tol: float, engine: Parts, whole: bool) -> tuple[Placement | None, str]:
    """The longest groups that serve all tiles, or those that serve most (`whole`: none), or why there are none."""
    why = why_not(scene, tol)
    if why:
        return None, why
    block, near, _ = settings.delays(scene, LEAVES * tol, engine, settings.LEAF_ROUNDING)
    if not block:
        return None, "pixels too coarse for float32 blocks"
    raster = Raster(grid, scene, block, rows=True)
    image = [section for section in sections(raster) if section.active.any()]
    if not all(section.flat for section in image):
        return None, "lines of pixels on too many planes"
    order = np.flatnonzero(scene.heard & (scene.weights != 0))
    if not (image and order.size):
        return None, "there is nothing to sum"
    delay = reception(scene)
    centres = subapertures.phase_centres(scene.trace, delay)
    best: Placement | None = None
    for length in _lengths(centres[order], image):
        pieces = [order[part] for part in subapertures.cut_track(centres[order], order // scene.channels, length)]
        if len(pieces) * LEAST > len(order) and not whole:
            continue
        groups = [subapertures.group(piece, centres) for piece in pieces]
        layout = _layout(scene, max(members.extent for members, _ in groups), len(order) / len(pieces), tol)
        if layout is None:
            return None, "no interpolation keeps tol"
        placed = Placement(layout, raster, pieces, groups, centres, [], 0.0)
        through = everything = 0
        for section in image:
            fates = [_fates(scene, piece, g[0], section, layout, near) for piece, g in zip(pieces, groups, strict=True)]
            placed.fates.append((section, fates))
            for piece, (read, direct) in zip(pieces, fates, strict=True):
                through += len(piece) * int(section.pixels[read].sum())
                everything += len(piece) * int(section.pixels[read | direct].sum())
        placed.share = through / max(everything, 1)
        if placed.share == 1:
            return placed, ""
        if best is None or placed.share > best.share:
            best = placed
    if best is None:
        return None, LONGER
    if best.share == 0:
        return None, NEAR_TRACK
    return (None, f"{100 * (1 - best.share):.3g} % of the terms, {NEAR_TRACK}") if whole else (best, "")


def reception(scene: Scene) -> float:
    """About what passes until an echo arrives, s, where receivers move."""
    return (scene.nearest + scene.farthest) / scene.c if scene.kind == MOVING else 0.0


def _lengths(centres: FloatArray, image: list[Section]) -> list[float]:
    """Lengths of groups to try, in turn: fractions of what the nearest pixel allows, then of what all but a tenth do."""
    track = centres[:: max(1, len(centres) // 256), :2]
    tiles = np.concatenate([section.corners[section.active].reshape(-1, 3) for section in image])[:, :2]
    tiles = tiles[:: max(1, len(tiles) // 1024)]
    away = np.linalg.norm(track[:, None] - tiles, axis=-1)
    limits = [0.95 * float(np.quantile(away, q)) / subapertures.NEAR for q in (0.0, 0.1)]
    extent = float(np.linalg.norm(np.ptp(centres, axis=0))) + 1e-3
    found = [min(limit, extent) * part for limit in limits for part in LENGTHS]
    return list(dict.fromkeys(length for length in found if length > 0))


def _layout(scene: Scene, length: float, traces: float, tol: float) -> Layout | None:
    """Parts, taps and the ranges they need, for groups of `length` m with so many traces; None where no taps keep tol."""
    merges = 0
    while merges < MERGES and traces > LEAF * FAN**merges and length > SHORTEST * scene.c / scene.fc * FAN**merges:
        merges += 1
    left = tol * (1 - POSITIONS - LEAVES)
    for count in range(merges, -1, -1):
        for kind in TAPS:
            taps = tree.taps(*kind)
            if math.hypot(bounds.tree_error(taps, count + 1), ENDS * tol) <= left:
                return _cleared(scene, length, (FAN,) * count, taps, tol)
    return None


def _cleared(scene: Scene, length: float, fans: tuple[int, ...], taps: tree.Taps, tol: float) -> Layout:
    """A layout with the slant ranges that its nodes must have, and its distance from records' ends."""
    heard = scene.trace.compress(scene.heard)
    heights = np.concatenate([heard[name][:, 2] for name in ("tx", "rx")])
    height = float(max(heights.max() - scene.bottom, scene.top - heights.min()))
    baseline = float(np.max(np.linalg.norm(heard["tx"] - heard["rx"], axis=1)))
    extents = length / np.cumprod([1, *fans])
    merge, leaf = POSITIONS * tol / MERGES, settings.PHASE * LEAVES * tol
    away = [_clear(scene, height, (whole - part) / 2, taps.rate, merge) for whole, part in itertools.pairwise(extents)]
    away.append(_clear(scene, height, (extents[-1] + baseline) / 2, taps.rate, leaf))
    ends = 0.0 if SPARE * scene.band >= HELD else bounds.hushed(ENDS * tol, scene.band)
    return Layout(length, fans, taps, away[0], max(away[1:], default=0.0), ends)


def _clear(scene: Scene, height: float, reach: float, rate: float, error: float) -> float:
    """Slant range from which polynomials of degree 4 along 64 nodes of a ray hold to within `error` rad for the two-way delay
    of what lies `reach` m off the centre, the centre's own taken away, at most `height` up.

    Along a ray of constant bearing a sensor at p from the centre is r - p.x/r + (p^2 - (p.x/r)^2)/2r + ... away, where x/r has
    the components sqrt(1 - (height/r)^2) = 1 - sum a_k (height/r)^2k along the ground, a_k > 0, and height/r. Polynomials
    through 5 Chebyshev nodes of |s| <= h are wrong by at most h^5/(5! 2^4) of the fifth derivative, on both ways.
    """
    half = 31.5 * scene.c / (4 * scene.band * scene.fs * rate)
    k = np.arange(1, 400)
    powers = np.cumprod(np.concatenate([[0.5], (k[:-1] - 0.5) / (k[:-1] + 1)])) * np.prod(2 * k[:, None] + np.arange(5), axis=1)

    def wrong(slant: float) -> float:
        lateral = float(powers @ np.exp(2 * k * np.log(max(height, 1e-9) / slant))) / slant**5
        fifth = reach * lateral + 120 * reach * (height + 2 * reach) / slant**6
        return 2 * 2 * np.pi * scene.fc / scene.c * fifth * half**5 / 1920 - error

    low, high = max(height, 1e-3) * (1 + 1e-6), 1e3 * (height + reach + half)
    if wrong(high) >= 0:
        return math.inf
    return low if wrong(low) <= 0 else float(scipy.optimize.brentq(wrong, low, high, rtol=1e-3))


def _fates(
    scene: Scene, order: npt.NDArray[np.int64], members: subapertures.Group, section: Section, layout: Layout, near: float
) -> tuple[BoolArray, BoolArray]:
    """Which tiles are read from a group's sub-image, and which are summed directly; the rest is silent or not wanted."""
    active, (middle, radius) = section.active, section.spheres
    ground = np.linalg.norm(middle[:, :2] - members.centre[:2], axis=1)
    # nodes that a read depends on lie this much further out or in, and to the sides
    step = layout.step(scene)
    reach = (len(layout.fans) + 1) * (layout.taps.reach + 4) * step
    height = abs(float(members.centre[2]) - section.plane)
    least = max(float(np.hypot(subapertures.NEAR * members.extent, height)), layout.clear)
    away = subapertures.slant(np.maximum(ground - radius, 0), height)
    read = active & (away >= near) & (away - reach >= least) & (radius <= WIDE * ground)
    read &= members.distances(middle) - radius - reach >= layout.apart
    some = np.flatnonzero(active)
    ends = layout.ends * scene.c / scene.fs + 2 * layout.taps.reach * step
    inside, heard = _within(scene, order, middle[some], radius[some], reach, ends)
    read[some] &= inside
    direct = np.zeros_like(active)
    direct[some] = heard & ~read[some]
    return read, direct


def _within(
    scene: Scene, order: npt.NDArray[np.int64], middle: FloatArray, radius: FloatArray, reach: float, ends: float
) -> tuple[BoolArray, BoolArray]:
    """Which balls about pixels lie, with `reach` m around them, inside the records of all traces `order`, and themselves
    `ends` m of path inside; and which inside any."""
    inside, heard = np.ones(len(middle), dtype=np.bool_), np.zeros(len(middle), dtype=np.bool_)
    width, last = 2 * radius + max(2 * reach, ends), scene.n_sample - 1
    at_once = max(1, PAIRS // max(1, len(middle)))
    for begin in range(0, len(order), at_once):
        t = scene.trace.take(order[begin : begin + at_once])[:, None]
        # (trace, tile), coordinate by coordinate: sums over a last axis of three are slow
        path = sum(np.sqrt(sum((middle[:, k] - t[name][..., k]) ** 2 for k in range(3))) for name in ("tx", "rx"))
        speed = np.sqrt(np.sum(t["velocity"] ** 2, axis=-1))
        low = ((path - width) / (scene.c + speed) - t["t0"]) * scene.fs
        high = ((path + width) / (scene.c - speed) - t["t0"]) * scene.fs
        inside &= np.all((low >= 0) & (high <= last), axis=0)
        heard |= np.any((high >= -EDGE) & (low <= last + EDGE), axis=0)
    return inside & heard, heard


def make_forest(scene: Scene, placed: Placement, tol: float, engine: Parts) -> Forest | None:
    """Trees of a layout; None where they have more nodes than the sum has terms."""
    rate = _rate(scene, placed.layout, 2 / scene.c * scene.band * scene.fs)
    while True:
        found = _with_rate(scene, placed, rate)
        if found is None:
            return None
        made, wider, along = found
        asked = _rate(scene, placed.layout, along)
        if asked <= rate * (1 + 1e-9):
            break
        rate = asked
    choices = settings.choose(wider, LEAVES * tol, engine, leaves=True)
    merges = len(placed.layout.fans)
    ends = ENDS * tol if placed.layout.ends else 0.0
    errors = choices.errors | {"sub-images": math.hypot(bounds.tree_error(placed.layout.taps, merges + 1), ends)}
    if merges:
        errors["positions"] = POSITIONS * tol * merges / MERGES
    step = scene.c / (2 * scene.fs * rate)
    return Forest(wider, placed.raster, placed.layout, rate, step, made, replace(choices, errors=errors), placed.share)


def _rate(scene: Scene, layout: Layout, along: float) -> float:
    """Nodes per sample for the highest frequency along rays, cycles a metre."""
    return scene.c * layout.taps.rate * SPARE * along / scene.fs


def _with_rate(scene: Scene, placed: Placement, rate: float) -> tuple[list[Section], Scene, float] | None:
    """Sections with trees of `rate` nodes per sample, the scene with the samples that their leaves ask for, and the highest
    frequency along their rays. One spacing for all grids: neighbours along a parent's ray are neighbours on a child's."""
    step, layout = scene.c / (2 * scene.fs * rate), placed.layout
    medium = Medium(scene.c, scene.fc, 2 * scene.band * scene.fs, reception(scene))
    wider = copy.copy(scene)
    wider.first, wider.last = scene.first.copy(), scene.last.copy()
    left, along, made = max(LEAST_NODES, scene.traces * scene.pixels), 0.0, []
    for base, fates in placed.fates:
        section = replace(base, trees=[])
        for piece, (members, places), (read, direct) in zip(placed.pieces, placed.groups, fates, strict=True):
            subtree: Subtree | None = None
            if read.any():
                reads = subapertures.seen_from(base.corners[read], members.centre)
                subtree = subapertures.make_subtree(
                    members, places, layout.fans, scene.trace, placed.centres, medium, section.plane, reads, step, layout.taps,
                    left,
                )  # fmt: skip
                if subtree is None:
                    return None
                left -= sum(level.nodes for level in subtree.levels)
                along = max(along, subtree.along)
                _widen(wider, subtree, step)
            if read.any() or direct.any():
                order = piece if subtree is None else subtree.traces
                section.trees.append(Tree(order, read, direct, subtree, members))
        if section.trees:
            made.append(section)
    return made, wider, along


def _widen(scene: Scene, subtree: Subtree, step: float) -> None:
    """Samples that a tree's leaves ask of their traces, whatever the image asks."""
    leaves = subtree.levels[0]
    for place, (i0, rays, _, _, first), span in zip(leaves.place, leaves.shape, itertools.pairwise(leaves.span), strict=True):
        traces = subtree.traces[slice(*span)]
        ends = leaves.range[first : first + rays]
        ends = ends[ends[:, 0] < ends[:, 1]] + i0
        low, high = (ends[:, 0].min() - 1) * step, (ends[:, 1].max() + 1) * step
        g = scene.trace.take(traces)
        apart = sum(np.linalg.norm(g[name] - place[:3], axis=1) for name in ("tx", "rx"))
        speed = np.linalg.norm(g["velocity"], axis=1)
        begin = np.floor((np.maximum(2 * low - apart, 0) / (scene.c + speed) - g["t0"]) * scene.fs).astype(np.int64)
        end = np.ceil(((2 * high + apart) / (scene.c - speed) - g["t0"]) * scene.fs).astype(np.int64)
        scene.first[traces] = np.maximum(np.minimum(scene.first[traces], begin), 0)
        scene.last[traces] = np.minimum(np.maximum(scene.last[traces], end), scene.n_sample - 1)
