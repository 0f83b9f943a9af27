"""Trees of sub-apertures over an image: which tiles are read from which, and which are summed directly. No choices.

`Forest` holds, for each of the longest groups of pings, a tree of polar grids (subapertures.py), the tiles of the image read
from it and those summed directly. See docs/ffbp.md.
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import MOVING, Engine, native
from pysas.engine.tree import Taps
from pysas.model.echoes import EDGE
from pysas.planning import subapertures
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices
from pysas.planning.subapertures import BoolArray, Medium, Readings, Subtree
from pysas.planning.tiles import Section, Tree

MOST_PLANES = 6
WIDE = 0.3  # a tile's radius, seen from a group, at most: rad
LEAST_NODES = 1 << 22  # that trees of any image may have
PAIRS = 1 << 18  # of traces and tiles at a time


@dataclass(frozen=True)
class Layout:
    """How a tree is cut: groups of at most `length` m, in parts of parts; taps; `spare` of sampling.

    `clear`: slant range (m) that nodes must have from the centre of the longest group, `apart` from those of its parts; `ends`:
    samples that a place must lie inside of records.
    """

    length: float
    fans: tuple[int, ...]
    taps: Taps
    spare: float
    clear: float
    apart: float
    ends: float


@dataclass(frozen=True)
class Work:
    """What trees do, each as often as a plane asks: terms and nodes of leaves, (node, child) pairs merged, pixels read, traces
    prepared."""

    leaf_terms: float
    leaf_nodes: float
    merged: float
    read: float
    traces: int


@dataclass
class Forest:
    """All trees of an image."""

    scene: Scene
    raster: Raster
    layout: Layout
    rate: Fraction  # nodes per sample
    step: float
    sections: list[Section]
    choices: Choices
    share: float
    seconds: float = 0.0

    @property
    def trees(self) -> list[Tree]:
        return [t for section in self.sections for t in section.trees]

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

    def work(self) -> Work:
        """Counted, but that leaves of a tree are taken to have as many traces each."""
        terms = nodes = merged = read = traces = 0.0
        for section in self.sections:
            for t in section.trees:
                traces += len(t.order)
                if t.subtree is None:
                    continue
                levels = t.subtree.levels
                nodes += levels[0].nodes
                terms += levels[0].nodes * len(t.order) / len(levels[0])
                merged += sum(above.nodes * len(below) / len(above) for below, above in itertools.pairwise(levels))
                read += int(section.pixels[t.read].sum())
        return Work(terms, nodes, merged, read, int(traces))

    def describe(self) -> list[str]:
        """The tree, for print(plan)."""
        taps, trees = self.layout.taps, [t for t in self.trees if t.subtree is not None]
        lines = [
            f"  trees          {len(self.trees)}, over groups of at most {max(t.group.extent for t in self.trees):.3g} m, "
            f"{taps.width} taps at {taps.rate:.3g} x the band, nodes every {self.step:.3g} m",
            f"  factorised     {100 * self.share:.1f} % of the terms, the rest summed directly",
        ]
        stack = max(section.planes.size for section in self.sections)
        if stack > 1:
            lines.append(f"  relief         pixels read from {stack} planes each, trees for all of them")
        if trees:
            levels = trees[len(trees) // 2].subtree.levels  # type: ignore[union-attr]
            for i, level in enumerate(levels):
                made = f"{level.span[-1] / len(level):.3g} {'traces' if i == 0 else 'sub-images'} each"
                lines.append(
                    f"    level {i}      {len(level)} sub-images of {made}, {level.nodes / len(level):.3g} nodes, "
                    f"a ray every {np.mean(level.place[:, 5]):.2g} rad"
                )
        return lines


def _stack(section: Section, groups: list[subapertures.Group], scene: Scene, error: float) -> FloatArray | None:
    """Heights of the planes that a section's pixels are read from by polynomials of height, or None where too many were needed.

    At one range and one place along its axis a group's phases turn with the angle about that axis by what its transmitters and
    receivers together lie beside it: exp(j a s), |s| <= 1, of which the polynomial through n Chebyshev nodes lacks
    a^n/(n! 2^(n-1)). Where they lie on opposite sides their paths differ in second order still: by q^2 cos^2/(2 r) for each
    sensor q beside the axis, and as q/r of a transmitter and a receiver that are not equally far.
    """
    low, high = section.corners[section.active][..., 2].min(), section.corners[section.active][..., 2].max()
    most = 0.0
    for members in groups:
        tx, rx = (scene.trace[name][members.traces] - members.centre for name in ("tx", "rx"))
        across = [v - np.outer(v @ members.axis, members.axis) for v in (tx, rx)]
        size = np.linalg.norm(across, axis=-1)
        second = np.sum(size**2, axis=0) + size.min(axis=0) * np.linalg.norm(tx - rx, axis=1)
        _, beside = subapertures.onto(section.corners, members, section.plane)
        clear = _beside(section.corners, beside, members)
        if clear.any():
            closest = float(beside[clear].min())
            off = float(np.max(np.linalg.norm(across[0] + across[1], axis=1) + second / closest))
            highest = 2 * np.pi * (scene.fc + scene.band * scene.fs) / scene.c
            most = max(most, highest * off * (high - low) / 2 / closest)
    for count in range(1, MOST_PLANES + 1):
        if most**count / math.factorial(count) / 2 ** (count - 1) <= error:
            nodes = np.cos(np.pi * (2 * np.arange(count)[::-1] + 1) / (2 * count))
            return np.asarray((low + high) / 2 + (high - low) / 2 * nodes)
    return None


def _beside(corners: FloatArray, beside: FloatArray, members: subapertures.Group) -> BoolArray:
    """Tiles that lie beside a group and not ahead, so that planes have all their ranges."""
    ground = np.linalg.norm(corners[..., :2] - members.centre[:2], axis=-1)
    return np.asarray(np.all(np.nan_to_num(beside) > 0.25 * ground, axis=1), dtype=np.bool_)


def _fates(
    scene: Scene, order: npt.NDArray[np.int64], members: subapertures.Group, section: Section, layout: Layout, step: float,
    near: float,
) -> tuple[BoolArray, BoolArray]:  # fmt: skip
    """Which tiles are read from a group's sub-image, and which are summed directly; the rest is silent or not wanted.

    None is read across a beam's edge, where the sum has a step.
    """
    corners, active = section.corners, section.active
    middle, radius = section.spheres
    ground = np.linalg.norm(middle[:, :2] - members.centre[:2], axis=1)
    nearest = ground - radius
    # nodes that a read depends on lie this much further out or in, and to the sides
    reach = (len(layout.fans) + 1) * (layout.taps.reach + 4) * step
    heights = np.abs(members.centre[2] - corners[active][..., 2])
    least = max(float(np.hypot(subapertures.NEAR * members.extent, heights.max())), layout.clear)
    away = subapertures.slant(np.maximum(nearest, 0), float(heights.min()))
    read = active & (away >= near) & (away - reach >= least) & (radius <= WIDE * ground) & (scene.cos_beam <= -1)
    for plane in () if section.flat else section.planes:
        seen, beside = subapertures.onto(corners, members, plane)
        closest = np.linalg.norm(np.nan_to_num(seen[..., :2] - members.centre[:2]), axis=-1).min(axis=1)
        read &= _beside(corners, beside, members) & (closest >= subapertures.NEAR * members.extent)
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
    `ends` m of path inside; and which inside any.

    Those that are sure to, by boxes about all sensors; of the others some traces tell most, and all traces the rest.
    """
    g, last = scene.trace.take(order), scene.n_sample - 1
    more = np.maximum(2 * reach, ends)
    boxes = [(g[name].min(axis=0), g[name].max(axis=0)) for name in ("tx", "rx")]
    path = sum(np.linalg.norm(middle - (low + high) / 2, axis=1) for low, high in boxes)
    spread = 2 * radius + more + sum(float(np.linalg.norm(high - low)) for low, high in boxes) / 2
    speed = float(np.sqrt(np.max(np.sum(g["velocity"] ** 2, axis=1))))
    earliest = ((path - spread) / (scene.c + speed) - g["t0"].max()) * scene.fs
    latest = ((path + spread) / (scene.c - speed) - g["t0"].min()) * scene.fs
    inside = (earliest >= 0) & (latest <= last)
    heard = inside.copy()
    unsure = np.flatnonzero(~inside & (latest >= -EDGE) & (earliest <= last + EDGE))
    inside[unsure] = True
    at_once = max(1, PAIRS // max(1, unsure.size))
    some = np.unique(np.linspace(0, len(g) - 1, min(at_once, 32)).astype(np.int64))
    for number in range(-1, -(-len(g) // at_once)):
        left = unsure[inside[unsure] | ~heard[unsure]]
        if not left.size:
            break
        t = (g.take(some) if number < 0 else g[number * at_once : (number + 1) * at_once])[:, None]
        # (trace, tile), coordinate by coordinate: sums over a last axis of three are slow
        there, back = (np.sqrt(sum((middle[left, k] - t[name][..., k]) ** 2 for k in range(3))) for name in ("tx", "rx"))
        speeds, widths = np.sqrt(np.sum(t["velocity"] ** 2, axis=-1)), 2 * radius[left] + more
        low = ((there + back - widths) / (scene.c + speeds) - t["t0"]) * scene.fs
        high = ((there + back + widths) / (scene.c - speeds) - t["t0"]) * scene.fs
        inside[left] &= np.all((low >= 0) & (high <= last), axis=0)
        heard[left] |= np.any((high >= -EDGE) & (low <= last + EDGE), axis=0)
    return inside & heard, heard


def _cut(scene: Scene, length: float) -> tuple[list[npt.NDArray[np.int64]], FloatArray]:
    """Traces of each of the longest groups, and all phase centres."""
    order = np.flatnonzero(scene.heard & (scene.weights != 0))
    centres = subapertures.phase_centres(scene.trace, reception(scene))
    if not order.size:
        return [], centres
    return [order[part] for part in subapertures.cut_track(centres[order], order // scene.channels, length)], centres


def reception(scene: Scene) -> float:
    """About what passes until an echo arrives, s, where receivers move."""
    return (scene.nearest + scene.farthest) / scene.c if scene.kind == MOVING else 0.0


def _step(scene: Scene, layout: Layout) -> float:
    """Between nodes, m, before the sub-images' own bands are known."""
    return scene.c / (4 * scene.band * scene.fs * layout.taps.rate)


def served(
    scene: Scene, image: list[Section], layout: Layout, near: float, relief: float, most: int = 5, tiles: int = 500
) -> tuple[float, int, int]:  # fmt: skip
    """Share of the terms that trees of a layout would serve, planes that pixels would be read from, and number of groups.

    The first two judged by about `most` of the groups and `tiles` of the tiles of each section of the `image`.
    """
    whole, centres = _cut(scene, layout.length)
    pieces = whole[len(whole) // most // 2 :: max(1, len(whole) // most)]
    groups = [subapertures.group(piece, centres)[0] for piece in pieces]
    through = everything = 0
    deepest = 1
    for section in image:
        if not section.active.any():
            continue
        planes = section.planes if section.flat else _stack(section, groups, scene, relief)
        if planes is None:
            return 0.0, 1, len(whole)
        deepest = max(deepest, planes.size)
        some = np.flatnonzero(section.active)
        some = some[:: max(1, some.size // tiles)]
        fewer = replace(section, planes=planes, pixels=section.pixels[some], corners=section.corners[some])
        for piece, members in zip(pieces, groups, strict=True):
            read, direct = _fates(scene, piece, members, fewer, layout, _step(scene, layout), near)
            through += len(piece) * int(fewer.pixels[read].sum())
            everything += len(piece) * int(fewer.pixels[read | direct].sum())
    return through / max(everything, 1), deepest, len(whole)


def make_forest(
    scene: Scene, raster: Raster, image: list[Section], layout: Layout, near: float, relief: float, least: Fraction,
    whole: bool, engine: Engine,
) -> Forest | None:  # fmt: skip
    """All trees of an image, without choices for the direct sums; None where no pixel can be read from one (`whole`: not all),
    or where trees have more nodes than the sum has terms.

    `image` : its sections, which stay as they are; `relief` : relative error that reading pixels off their planes may cost;
    `least` : nodes per sample at least.
    """
    pieces, centres = _cut(scene, layout.length)
    if not pieces:
        return None
    groups = [subapertures.group(part, centres) for part in pieces]
    step = _step(scene, layout)
    found: list[tuple[Section, list[tuple[BoolArray, BoolArray, Readings | None]]]] = []
    for base in image:
        if not base.active.any():
            continue
        planes = base.planes if base.flat else _stack(base, [members for members, _ in groups], scene, relief)
        if planes is None:
            return None
        base = replace(base, planes=planes)
        fates = []
        for piece, (members, _) in zip(pieces, groups, strict=True):
            fates.append(_fates(scene, piece, members, base, layout, step, near))
            if whole and fates[-1][1].any():
                return None
        for k, plane in enumerate(planes):
            section, seen = replace(base, plane=float(plane), number=k, trees=[]), []
            for (members, _), (read, direct) in zip(groups, fates, strict=True):
                reads = None
                if read.any():
                    corners = base.corners[read]
                    corners = corners if base.flat else subapertures.onto(corners, members, section.plane)[0]
                    reads = subapertures.seen_from(corners, members.centre)
                seen.append((read, direct if k == 0 else np.zeros_like(direct), reads))  # once is enough
            found.append((section, seen))
    if not any(reads is not None for _, seen in found for _, _, reads in seen):
        return None
    rate = max(least, _nodes_per_sample(scene, layout, 2 / scene.c * scene.band * scene.fs))
    while True:
        forest, highest = _with_rate(scene, raster, layout, pieces, groups, centres, found, rate, engine)
        if forest is None or highest <= rate:
            return forest
        rate = highest


def _nodes_per_sample(scene: Scene, layout: Layout, along: float) -> Fraction:
    """For the highest frequency along rays, cycles a metre: a simple number, as tables have as many intervals to a sample."""
    return native.simple_rate(scene.c * layout.taps.rate * layout.spare * along / scene.fs)


def _with_rate(
    scene: Scene, raster: Raster, layout: Layout, pieces: list[npt.NDArray[np.int64]],
    groups: list[tuple[subapertures.Group, FloatArray]], centres: FloatArray,
    found: list[tuple[Section, list[tuple[BoolArray, BoolArray, Readings | None]]]], rate: Fraction, engine: Engine,
) -> tuple[Forest | None, Fraction]:  # fmt: skip
    """Trees with `rate` nodes per sample, and how many their bands ask for.

    One spacing for all grids: neighbours along a parent's ray are neighbours on a child's, and intervals of the tables.
    """
    step = scene.c * rate.denominator / (2 * scene.fs * rate.numerator)
    delay = reception(scene)
    medium = Medium(scene.c, scene.fc, 2 * scene.band * scene.fs, delay)
    wider = copy.copy(scene)
    wider.first, wider.last = scene.first.copy(), scene.last.copy()
    through = everything = 0
    along = 0.0
    left = max(LEAST_NODES, sum(len(piece) for piece in pieces) * scene.pixels)
    made = []
    for base, seen in found:
        section = replace(base, trees=[])
        for piece, (members, places), (read, direct, reads) in zip(pieces, groups, seen, strict=True):
            if not (read.any() or direct.any()):
                continue
            subtree = None
            if reads is not None:
                subtree = subapertures.make_subtree(
                    members, places, layout.fans, scene.trace, centres, medium, section.plane, reads, step, layout.taps, left,
                    engine.subtree,
                )  # fmt: skip
                if subtree is None:
                    return None, rate
                left -= sum(level.nodes for level in subtree.levels)
                along = max(along, subtree.along)
                _widen(wider, subtree, step)
            traces = piece if subtree is None else subtree.traces
            section.trees.append(Tree(traces, read, direct, subtree, members))
            if section.number == 0:
                through += len(traces) * int(section.pixels[read].sum())
                everything += len(traces) * int(section.pixels[read | direct].sum())
        if section.trees:
            made.append(section)
    share = through / max(everything, 1)
    forest = Forest(wider, raster, layout, rate, step, made, None, share)  # type: ignore[arg-type]
    return forest, _nodes_per_sample(scene, layout, along)


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
        g = scene.trace.take(traces)
        apart = np.linalg.norm(g["tx"] - centre, axis=1) + np.linalg.norm(g["rx"] - centre, axis=1)
        speed = np.linalg.norm(g["velocity"], axis=1)
        begin = np.floor(((np.maximum(2 * low - apart, 0)) / (scene.c + speed) - g["t0"]) * scene.fs).astype(np.int64)
        end = np.ceil(((2 * high + apart) / (scene.c - speed) - g["t0"]) * scene.fs).astype(np.int64)
        scene.first[traces] = np.maximum(np.minimum(scene.first[traces], begin), 0)
        scene.last[traces] = np.minimum(np.maximum(scene.last[traces], end), scene.n_sample - 1)


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
