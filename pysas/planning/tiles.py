"""An image cut into tiles: by the plane its lines lie on, with boxes about them, and what trees make of each.

For fast factorised back-projection; see docs/ffbp.md.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine.traces import TILE_ROWS
from pysas.planning import subapertures
from pysas.planning.raster import Raster
from pysas.planning.subapertures import BoolArray, Subtree


@dataclass(frozen=True)
class Tree:
    """One of the longest groups: its sub-images if any tile is read from it, its traces (flat numbers), the tiles' fates."""

    order: npt.NDArray[np.int64]
    read: BoolArray
    direct: BoolArray
    subtree: Subtree | None
    group: subapertures.Group


@dataclass
class Section:
    """Lines [begin, end) of the image and the trees of the horizontal plane that they are read from."""

    begin: int
    end: int
    width: int
    plane: float
    mask: npt.NDArray[np.bool_] | None
    pixels: npt.NDArray[np.int64]  # wanted of each tile
    corners: FloatArray  # of boxes about the tiles (tile, 4 or 8, 3)
    trees: list[Tree] = field(default_factory=list)

    @property
    def active(self) -> BoolArray:
        """Tiles with any pixel wanted."""
        return self.pixels > 0

    @property
    def flat(self) -> bool:
        return bool(np.all(self.corners[..., 2] == self.plane))

    @functools.cached_property
    def spheres(self) -> tuple[FloatArray, FloatArray]:
        """About the tiles: middles (tile, 3) and radii (tile,)."""
        middle = self.corners.mean(axis=1)
        return middle, np.linalg.norm(self.corners - middle[:, None], axis=-1).max(axis=1)


def sections(raster: Raster) -> list[Section]:
    """The image's lines by the plane they lie on, or all of them where they lie on none."""
    height, width = raster.shape
    cuts = np.array([0, height])
    if raster.straight and not np.any(raster.step[:, 2]):
        steps = np.flatnonzero(np.diff(raster.first[:, 2])) + 1
        if len(steps) < max(1, height // TILE_ROWS):
            cuts = np.concatenate([[0], steps, [height]])
    found = []
    for begin, end in zip(cuts[:-1], cuts[1:], strict=True):
        top, left = np.arange(begin, end, TILE_ROWS), np.arange(0, width, raster.count)
        part = None if raster.mask is None else np.ascontiguousarray(raster.mask[begin:end])
        boxes = np.empty((len(top), len(left), 8, 3))
        pixels = np.empty((len(top), len(left)), dtype=np.int64)
        columns = np.minimum(raster.count, width - left)
        for i, line in enumerate(top):
            last = min(line + TILE_ROWS, end)
            boxes[i] = _boxes(raster, int(line), int(last), left)
            rows = None if part is None else part[line - begin : last - begin]
            pixels[i] = (last - line) * columns if rows is None else np.add.reduceat(rows.sum(axis=0), left)
        corners = boxes.reshape(-1, 8, 3)
        low, high = corners[..., 2].min(), corners[..., 2].max()
        if low == high:  # those above are those below
            corners = np.ascontiguousarray(corners[:, :4])
        found.append(Section(int(begin), int(end), width, float((low + high) / 2), part, pixels.ravel(), corners))
    return found


def _boxes(raster: Raster, line: int, last: int, left: npt.NDArray[np.int64]) -> FloatArray:
    """Corners (block, 8, 3), the lower four first, of upright boxes about blocks of lines [line, last) from columns `left` on.

    Whatever the order of the lines; along straight lines' mean direction, which fits lines of any.
    """
    width = raster.shape[1]
    if not raster.straight:
        turn = np.eye(2)
        points = raster.points(line * width, last * width).reshape(last - line, width, 3)
        low, high = (reach.reduceat(points, left, axis=1) for reach in (np.minimum, np.maximum))
    else:
        step = raster.step[line:last]
        ahead = step[:, :2].sum(axis=0)
        size = float(np.hypot(*ahead))
        ahead = ahead / size if size > 0 else np.array([1.0, 0.0])
        turn = np.array([ahead, [-ahead[1], ahead[0]]])
        columns = np.stack([left, np.minimum(left + raster.count, width) - 1])
        ends = raster.first[line:last, None, None] + step[:, None, None] * columns[..., None]
        ends[..., :2] = ends[..., :2] @ turn.T
        low, high = ends.min(axis=1), ends.max(axis=1)
    low, high = low.min(axis=0), high.max(axis=0)
    out = np.empty((len(left), 8, 3))
    for k in range(8):
        out[:, k] = np.where([k & 1, k & 2, k & 4], high, low)
    out[..., :2] = out[..., :2] @ turn
    return out


def pixels_of(tiles: BoolArray, section: Section, count: int) -> npt.NDArray[np.bool_]:
    """The pixels of some tiles, (line, pixel)."""
    height = section.end - section.begin
    grid = tiles.reshape(-(-height // TILE_ROWS), -1)
    full = np.repeat(np.repeat(grid, TILE_ROWS, axis=0), count, axis=1)[:height, : section.width]
    return np.ascontiguousarray(full if section.mask is None else full & section.mask)


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
