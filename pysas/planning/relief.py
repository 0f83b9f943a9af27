"""A plane laid over a depth map."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from pysas._checks import FloatArray
from pysas.model.grid import Grid

_BLOCK = 2**20  # pixels whose heights are looked up at once


def laid_over(grid: Grid, x: FloatArray, y: FloatArray, z: FloatArray) -> Grid:
    """The surface of a plane's pixels at the heights of a depth map, linear between its places.

    Parameters
    ----------
    grid : Grid
        A plane.
    x, y, z : (column,), (row,), (row, column), or (point,) each
        Heights over even or scattered places, m, in the coordinates of the echoes.

    Returns
    -------
    Grid
        A surface with the plane's axes; pixels beyond the map are masked.

    Raises
    ------
    ValueError
        The map holds none of the pixels.

    Warns
    -----
    UserWarning
        It does not hold all of them; says how many.

    Notes
    -----
    O(pixels) over even places; scattered ones are joined by Delaunay triangles, O(points log points) more.
    """
    from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator

    middle = np.array([y.mean(), x.mean()])  # large coordinates lose what triangles are judged by
    read: Any
    if z.ndim == 2:
        rows, columns = np.argsort(y), np.argsort(x)
        axes = y[rows] - middle[0], x[columns] - middle[1]
        if not all(np.all(np.diff(axis) > 0) for axis in axes):
            raise ValueError("the depth map has a row or a column twice: expected different x and y")
        read = RegularGridInterpolator(axes, z[np.ix_(rows, columns)], bounds_error=False)
    else:
        read = LinearNDInterpolator(np.column_stack([y, x]) - middle, z)
    height = np.empty(grid.size)
    for begin in range(0, grid.size, _BLOCK):
        pixels = np.arange(begin, min(begin + _BLOCK, grid.size))
        height[pixels] = read(grid.coordinates(pixels)[:, 1::-1] - middle)
    beyond = np.isnan(height)
    if beyond.all():
        low, high = (f"({f(x):.6g}, {f(y):.6g})" for f in (np.min, np.max))
        raise ValueError(f"the depth map, from {low} to {high} m, holds no pixel of the grid")
    mask = None
    if beyond.any():
        warnings.warn(
            f"{np.count_nonzero(beyond)} of {beyond.size} pixels lie beyond the depth map: they are masked", stacklevel=2
        )
        mask = ~beyond.reshape(grid.shape)
        height[beyond] = np.mean(height[~beyond])
    return Grid.surface(
        grid.axes["x"], grid.axes["y"], height.reshape(grid.shape), origin=grid.origin, rotation=grid.rotation, mask=mask
    )
