"""A grid's pixels as lines cut into tiles, about the scene's centre: what the engines sum over."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import BLOCK
from pysas.engine.survey import Tile
from pysas.engine.traces import TILE_ROWS
from pysas.model.grid import Grid
from pysas.planning.scene import Scene


class Raster:
    """The grid as (line, pixel on the line) cut into tiles; grids without straight lines are one line of all pixels.

    With `rows` these are cut by rows as well.
    """

    def __init__(self, grid: Grid, scene: Scene, block: int, rows: bool = False) -> None:
        self.grid, self.origin = grid, scene.origin
        found = scene.lines if block else None
        self.straight = found is not None
        if found is not None:
            self.first, self.step = found[0] - scene.origin, found[1]
            self.shape = (len(self.first), grid.shape[-1])
            self.count = block
        else:
            width = grid.shape[-1] if rows else grid.size
            self.shape = (grid.size // width, width)
            self.count = min(BLOCK, width)
        self.mask = None if grid.mask is None else grid.mask.reshape(self.shape)

    def points(self, begin: int, end: int) -> FloatArray:
        """Coordinates (n, 3) of pixels begin ... end - 1, counted through all lines."""
        return np.ascontiguousarray(self.grid.coordinates(np.arange(begin, end)) - self.origin)

    def some(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> FloatArray:
        """Coordinates (row, column, 3) of the pixels where rows and columns meet."""
        if self.straight:
            return np.asarray(self.first[rows, None] + columns[None, :, None] * self.step[rows, None])
        flat = (rows[:, None] * self.shape[1] + columns).ravel()
        return (self.grid.coordinates(flat) - self.origin).reshape(len(rows), len(columns), 3)

    def tiles(self) -> list[Tile]:
        """All tiles, near neighbours first."""
        height, width = self.shape
        rows, columns = (TILE_ROWS, self.count) if self.straight else (1, TILE_ROWS * self.count)
        return [
            Tile(top, min(top + rows, height), left, min(left + columns, width))
            for top in range(0, height, rows)
            for left in range(0, width, columns)
        ]

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
