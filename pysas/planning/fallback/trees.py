"""The Numba engine's trees of sub-apertures, of one level: short groups, whose sub-images are read at the pixels.

For horizontal planes whose pixels lie on even lines; what tiles near a group or across a record's end need is summed directly.
Bounds are those of docs/ffbp.md.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np

from pysas._checks import FloatArray
from pysas.engine import MOVING, Parts, tree
from pysas.engine.traces import TILE_ROWS
from pysas.model.echoes import EDGE
from pysas.model.grid import Grid
from pysas.planning import bounds, subapertures, view_angles
from pysas.planning.fallback import settings
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices
from pysas.planning.subapertures import BoolArray, IntArray

# shares of tol: nodes; what records' ends ring with, which adds to reads as squares do, and these have the rest
LEAVES, ENDS = 0.35, 0.2
TOL, FARTHEST = 3e-5, 1e9  # float32 sub-images round too much below; wavelengths beyond which there are too many nodes
RATES = (1.31, 1.43, 1.6, 1.7)  # nodes by what the band needs
GROUP, LEAST = 64, 32  # traces of a group: its nodes cost about as much as its reads; as many terms as a read costs
FEW_NODES = 4  # of a sub-image: smaller images are summed directly
NEAR = 1.15  # a group's centre stays this many lengths away from what is read from it
WIDE = 0.25  # a tile's radius, seen from a group, at most: rad
LINE = 192  # pixels of lines that blocks of any length divide
LEAST_NODES, PAIRS = 1 << 22, 1 << 18  # that sub-images of any image may have; traces and tiles at a time
NEAR_TRACK, LONGER = "pixels too near the track, or across the ends of records", "a tree would take longer"


@dataclass(frozen=True)
class SubImage:
    """A group's polar grid on a plane, its tiles that are summed, and the image's tiles that are read from it."""

    grid: tree.PolarGrid
    nodes: BoolArray
    tiles: BoolArray


@dataclass(frozen=True)
class Group:
    """Traces (flat numbers), their extent (m), a sub-image for each plane, and the image's tiles that are summed directly."""

    order: IntArray
    extent: float
    sub_images: list[SubImage]
    direct: BoolArray


class Tiles:
    """An image's: spheres about them, pixels wanted of each, and the planes that they lie on whole."""

    def __init__(self, raster: Raster) -> None:
        self.raster, self.wanted = raster, raster.wanted()
        self.middle, self.radius, self.level = raster.spheres()
        self.planes = np.unique(self.middle[self.level & (self.wanted > 0), 2]).tolist()


@dataclass
class Forest:
    """All sub-images of an image, whose tiles have rows of `block` nodes, and the settings of the sums at nodes and beside
    them; `scene` : with the samples that nodes ask for."""

    scene: Scene
    tiles: Tiles
    block: int
    taps: tree.Taps
    groups: list[Group]
    choices: Choices

    @property
    def sub_images(self) -> list[SubImage]:
        return [sub for group in self.groups for sub in group.sub_images]

    @property
    def nodes(self) -> int:
        return sum(math.prod(sub.grid.shape) for sub in self.sub_images)

    def pixels(self, chosen: BoolArray) -> int:
        """Of some tiles, those wanted."""
        return int(self.tiles.wanted[chosen].sum())

    @property
    def terms(self) -> int:
        """That are read from sub-images."""
        return sum(len(group.order) * self.pixels(sub.tiles) for group in self.groups for sub in group.sub_images)

    @property
    def share(self) -> float:
        """The same of all terms."""
        return self.terms / max(self.terms + sum(len(group.order) * self.pixels(group.direct) for group in self.groups), 1)

    @property
    def summed(self) -> int:
        """Terms of the nodes."""
        tiles = sum(len(group.order) * int(sub.nodes.sum()) for group in self.groups for sub in group.sub_images)
        return TILE_ROWS * self.block * tiles

    @property
    def reads(self) -> int:
        """Of pixels from sub-images."""
        return sum(self.pixels(sub.tiles) for sub in self.sub_images)

    @property
    def reach(self) -> int:
        """Samples to each side of a term's that the nodes read for it hold."""
        return math.ceil(self.taps.reach / (2 * self.scene.band * self.taps.rate))

    @property
    def store_bytes(self) -> int:
        """Of the sub-image alive at a time, and of what smooths it."""
        return 16 * max(math.prod(sub.grid.shape) for sub in self.sub_images)

    def describe(self) -> list[str]:
        """The trees, for print(plan)."""
        found, traces = self.sub_images, sum(len(group.order) for group in self.groups)
        longest = max(group.extent for group in self.groups)
        return [
            f"  trees          {len(found)}, over groups of at most {longest:.3g} m, {self.taps.width} taps at "
            f"{self.taps.rate:.3g} x the band",
            f"  factorised     {100 * self.share:.1f} % of the terms, the rest summed directly",
            f"    level 0      {len(found)} sub-images of {traces / len(self.groups):.3g} traces each, "
            f"{self.nodes / len(found):.3g} nodes",
        ]


def why_not(scene: Scene, tol: float) -> str:
    """Why no tree is for a scene, whatever its layout; nothing where one may be."""
    node, lattice = scene.c / (4 * scene.band * scene.fs), scene.lattice
    rows = [
        (tol < TOL * (1 - 1e-9), f"tol below {TOL:g}"),
        (not scene.one_speed, "pings of different sound speeds"),
        (scene.farthest > FARTHEST * scene.c / scene.fc, f"range beyond {FARTHEST:g} wavelengths"),
        (not scene.heard.any(), "the grid lies outside the recorded window"),
        # reads at unrelated places between nodes are what bounds of sub-images' errors rest on
        (
            bool(np.linalg.norm(scene.high - scene.low) < FEW_NODES * node),
            "the image is no larger than a few nodes of a sub-image",
        ),
        (scene.each, "view-angle weights are every pixel's own: views change their order over the image"),
        (
            lattice is not None and lattice.beyond < view_angles.LONGEST * node,
            "views change their order around the image",
        ),
        (scene.beamed, "beams have edges in the image"),
        (
            scene.lines is None or bool(np.any(scene.lines[1][:, 2])),
            "relief or points: pixels on no even lines of level planes",
        ),
    ]
    return next((why for found, why in rows if found), "")


def taps_for(tol: float) -> tree.Taps:
    """The fewest nodes whose interpolation leaves room for nodes' own errors and what rings of records' ends."""
    found = (tree.taps(8, rate, 8) for rate in RATES)
    return next(taps for taps in found if math.hypot(bounds.tree_error(taps, 1), ENDS * tol) <= (1 - LEAVES) * tol)


def choose(scene: Scene, tol: float, engine: Parts, wide: float = 0.0) -> Choices:
    """Settings of the sums at nodes, and at pixels beside them: of lines whose steps are the longer of both and may lie along
    the line of sight."""
    taps, lines = taps_for(tol), copy.copy(scene)
    lines.step, lines.slope, lines.line_length = max(scene.step, subapertures.node(scene, taps)), 1.0, LINE
    choices = settings.choose(lines, LEAVES * tol, engine, wide, leaves=True)
    choices.errors["sub-images"] = math.hypot(bounds.tree_error(taps, 1), ENDS * tol)
    return choices


def lay_out(scene: Scene, grid: Grid, tol: float, engine: Parts, whole: bool) -> tuple[Forest | None, str]:
    """Trees that serve most terms (`whole`: all of them), or why there are none."""
    why = why_not(scene, tol)
    if why:
        return None, why
    taps, choices = taps_for(tol), choose(scene, tol, engine)
    block = choices.block
    if not block:
        return None, "pixels or nodes too coarse for float32 blocks"
    tiles = Tiles(Raster(grid, scene, settings.even_split(scene.line_length, block)))
    order = np.flatnonzero(scene.heard & (scene.weights != 0))
    if not (tiles.wanted.any() and order.size):
        return None, "there is nothing to sum"
    if not tiles.planes:
        return None, "lines of pixels on too many planes"
    wider = copy.copy(scene)
    wider.first, wider.last = scene.first.copy(), scene.last.copy()
    delay = (scene.nearest + scene.farthest) / scene.c if scene.kind == MOVING else 0.0  # about what an echo takes
    ends = np.stack([scene.trace["tx"], scene.trace["rx"] + delay * scene.trace["velocity"]])
    pieces = subapertures.cut_track(
        ends.mean(axis=0)[order], order // scene.channels, scene.nearest / 2, -(-len(order) // GROUP),
        max(1, len(order) // LEAST),
    )  # fmt: skip
    if len(pieces) * LEAST > len(order) and not whole:
        return None, LONGER
    forest = Forest(wider, tiles, block, taps, [], choices)
    for piece in pieces:
        group = _group(forest, order[piece], ends[:, order[piece]], tol)
        if group is None:
            return None, LONGER
        forest.groups.append(group)
        if forest.nodes > max(LEAST_NODES, scene.traces * scene.pixels):
            return None, LONGER
    share = forest.share
    if share == 0:
        return None, NEAR_TRACK
    if whole and share < 1:
        return None, f"{100 * (1 - share):.3g} % of the terms, {NEAR_TRACK}"
    forest.choices = choose(wider, tol, engine)
    return forest, ""


def _group(forest: Forest, order: IntArray, ends: FloatArray, tol: float) -> Group | None:
    """Traces with transmitters and receivers at `ends` (2, trace, 3), where they are; None where nodes were too many."""
    centres, tiles, found = ends.mean(axis=0), forest.tiles, []
    centre = (centres.min(axis=0) + centres.max(axis=0)) / 2
    extent = 2 * float(np.linalg.norm(ends - centre, axis=-1).max())
    read, direct = _fates(forest.scene, order, centre, extent, tiles, forest.taps, tol)
    for plane in tiles.planes:
        chosen = read & (tiles.middle[:, 2] == plane)
        if chosen.any():
            sub = _sub_image(forest, order, centre, plane, chosen)
            if sub is None:
                return None
            found.append(sub)
    return Group(order, extent, found, direct)


def _fates(
    scene: Scene, order: IntArray, centre: FloatArray, extent: float, tiles: Tiles, taps: tree.Taps, tol: float
) -> tuple[BoolArray, BoolArray]:
    """Which tiles are read from a group's sub-images, and which are summed directly; the rest is silent or not wanted."""
    step = subapertures.node(scene, taps)
    # nodes that a read depends on lie so much further out or in; those to the sides as much farther from a trace at most as its
    # phase turns there, which is sampled `rate` times as densely as it asks for
    reach = (taps.reach + 1) * step + taps.reach * scene.c / (scene.fc + scene.band * scene.fs) / (4 * taps.rate)
    ends = bounds.hushed(ENDS * tol, scene.band) * scene.c / scene.fs + 2 * taps.reach * step
    ground = np.linalg.norm(tiles.middle[:, :2] - centre[:2], axis=1)
    read = tiles.level & (tiles.wanted > 0) & (tiles.radius <= WIDE * ground)
    read &= ground - tiles.radius - reach >= NEAR * extent
    direct, some = np.zeros_like(read), np.flatnonzero(tiles.wanted)
    inside, heard = _within(scene, order, tiles.middle[some], 2 * tiles.radius[some] + max(2 * reach, ends))
    read[some] &= inside
    direct[some] = heard & ~read[some]
    return read, direct


def _within(scene: Scene, order: IntArray, middle: FloatArray, width: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Which places lie, with `width` m of path around them, inside the records of all traces `order`; and inside any."""
    inside, heard = np.ones(len(middle), dtype=np.bool_), np.zeros(len(middle), dtype=np.bool_)
    at_once = max(1, PAIRS // len(middle))
    for begin in range(0, len(order), at_once):
        t = scene.trace.take(order[begin : begin + at_once])[:, None]
        # (trace, tile), coordinate by coordinate: sums over a last axis of three are slow
        path = sum(np.sqrt(sum((middle[:, k] - t[name][..., k]) ** 2 for k in range(3))) for name in ("tx", "rx"))
        speed = np.sqrt(np.sum(t["velocity"] ** 2, axis=-1))
        low = ((path - width) / (t["c"] + speed) - t["t0"]) * scene.fs
        high = ((path + width) / (t["c"] - speed) - t["t0"]) * scene.fs
        inside &= np.all((low >= t["first"]) & (high <= t["last"]), axis=0)
        heard |= np.any((high >= t["first"] - EDGE) & (low <= t["last"] + EDGE), axis=0)
    return inside & heard, heard


def _sub_image(forest: Forest, order: IntArray, centre: FloatArray, plane: float, chosen: BoolArray) -> SubImage | None:
    """What a plane's chosen tiles are read from, its traces' windows widened to hold it; None of too many nodes."""
    scene, taps, tiles = forest.scene, forest.taps, forest.tiles
    trace, middle, radius = scene.trace.take(order), tiles.middle[chosen], tiles.radius[chosen]
    grid = subapertures.polar(trace, centre, scene, plane, middle, radius, taps)
    if math.prod(grid.shape) > max(LEAST_NODES, scene.pixels):
        return None
    apart = sum(np.linalg.norm(trace[name] - centre, axis=1) for name in ("tx", "rx"))
    speed, slant = np.linalg.norm(trace["velocity"], axis=1), grid.slant
    first = np.floor((np.maximum(2 * slant[0] - apart, 0) / (scene.c + speed) - trace["t0"]) * scene.fs).astype(np.int64)
    last = np.ceil(((2 * slant[-1] + apart) / (scene.c - speed) - trace["t0"]) * scene.fs).astype(np.int64)
    begin, end = scene.valid[order].T
    scene.first[order] = np.maximum(np.minimum(scene.first[order], first), begin)
    scene.last[order] = np.minimum(np.maximum(scene.last[order], last), end)
    return SubImage(grid, subapertures.needed(grid, middle, radius, taps, forest.block), chosen)
