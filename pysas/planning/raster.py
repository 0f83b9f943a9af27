"""A grid's pixels as lines cut into tiles, about the scene's centre: what the engines sum over."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import BLOCK
from pysas.engine.survey import Tile
from pysas.engine.traces import TILE_ROWS
from pysas.model.grid import Grid
from pysas.planning.scene import Scene


class Raster:
    """The grid as (line, pixel on the line) cut into tiles; grids without straight lines are one line of all pixels."""

    def __init__(self, grid: Grid, scene: Scene, block: int) -> None:
        self.grid, self.origin = grid, scene.origin
        found = scene.lines if block else None
        self.straight = found is not None
        if found is not None:
            self.first, self.step = found[0] - scene.origin, found[1]
            self.shape = (len(self.first), grid.shape[-1])
            self.count = block
        else:
            self.shape = (1, grid.size)
            self.count = min(BLOCK, grid.size)
        self.mask = None if grid.mask is None else grid.mask.reshape(self.shape)
        self._chosen: npt.NDArray[np.bool_] | None = None

    def of(self, chosen: npt.NDArray[np.bool_]) -> Raster:
        """The same of some of its tiles alone."""
        other = copy.copy(self)
        other._chosen = chosen
        return other

    def along(self, lines: tuple[FloatArray, FloatArray], width: int, count: int) -> Raster:
        """Other lines, by first pixel and step, of `width` pixels, `count` in a tile."""
        other = copy.copy(self)
        (other.first, other.step), other.shape, other.count = lines, (len(lines[0]), width), count
        other.mask = other._chosen = None
        return other

    def points(self, begin: int, end: int) -> FloatArray:
        """Coordinates (n, 3) of pixels begin ... end - 1, counted through all lines."""
        return np.ascontiguousarray(self.grid.coordinates(np.arange(begin, end)) - self.origin)

    def tiles(self) -> list[Tile]:
        """All tiles, or those chosen, near neighbours first; where lines lie on few level planes, each tile on one."""
        height, width = self.shape
        rows, columns = (TILE_ROWS, self.count) if self.straight else (1, TILE_ROWS * self.count)
        cuts = np.flatnonzero(np.diff(self.first[:, 2])) + 1 if self.straight else np.empty(0, dtype=np.int64)
        if len(cuts) * TILE_ROWS > height:
            cuts = cuts[:0]
        found = [
            Tile(top, min(top + rows, end), left, min(left + columns, width))
            for begin, end in itertools.pairwise([0, *cuts.tolist(), height])
            for top in range(begin, end, rows)
            for left in range(0, width, columns)
        ]
        return found if self._chosen is None else list(itertools.compress(found, self._chosen))

    def spheres(self) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
        """About the tiles of straight lines: middles (tile, 3), radii, and whether a tile lies on a level plane."""
        found = []
        for tile in self.tiles():
            columns = np.array([[tile.left], [tile.right - 1]])
            ends = self.first[tile.first : tile.last, None] + self.step[tile.first : tile.last, None] * columns
            low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
            middle = low + (high - low) / 2
            found.append((middle, np.linalg.norm(ends - middle, axis=-1).max(), low[2] == high[2]))
        middles, radii, level = zip(*found, strict=True)
        return np.array(middles), np.array(radii), np.array(level)

    def wanted(self) -> npt.NDArray[np.int64]:
        """Pixels of each tile that are not masked."""
        full = np.ones(self.shape, dtype=np.bool_) if self.mask is None else self.mask
        return np.array([np.count_nonzero(full[t.first : t.last, t.left : t.right]) for t in self.tiles()])

    def locate(self, tile: Tile) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
        """Coordinates, blocks and active rows of a tile, as `_numba.sum_tile` takes them."""
        if self.straight:
            step = self.step[tile.first : tile.last]
            blocks = np.concatenate([self.first[tile.first : tile.last] + tile.left * step, step], axis=1)
            if self.mask is None:
                return np.empty((0, 3)), blocks, np.ones(len(blocks), dtype=np.bool_)
            part = self.mask[tile.first : tile.last, tile.left : tile.right]
            return np.empty((0, 3)), blocks, np.asarray(part.any(axis=1))
        pixels = np.arange(tile.left, tile.right)
        rows = -(-pixels.size // self.count)
        padded = np.minimum(tile.left + np.arange(rows * self.count), tile.right - 1)
        coords = self.grid.coordinates(padded) - self.origin
        active: npt.NDArray[np.bool_] = np.ones(rows, dtype=np.bool_)
        if self.mask is not None:
            active = np.asarray(self.mask[0, padded].reshape(rows, self.count).any(axis=1))
        return coords, np.zeros((rows, 6)), active
