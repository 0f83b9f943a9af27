"""Images as rows and columns of a map: which grids are one, where their pixels lie, and their magnitudes as bytes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.formats.rasters import Decibels, even
from pysas.model.grid import BoolArray
from pysas.model.image import Image

_KINDS = ("plane", "surface")
SPAN = 40.0  # dB of a picture where none is asked for


@dataclass(frozen=True)
class MapImage:
    """Pixels (row, column): x rises with columns and y falls with rows, along the grid's own axes.

    Attributes
    ----------
    data : complex (row, column)
        A view of the image's pixels.
    mask : bool (row, column), or None
        False: the pixel was not imaged.
    affine : (a, b, c, d, e, f)
        The centre of pixel (row, column) is (a column + b row + c, d column + e row + f), m.
    tags : dict of str to str
        What goes with it.
    """

    data: ComplexArray
    mask: BoolArray | None
    affine: tuple[float, float, float, float, float, float]
    tags: dict[str, str]

    def decibels(self, span: float) -> tuple[Decibels, npt.NDArray[np.uint8]]:
        """The pixels as bytes: 255 at the 99.9th percentile of the magnitudes that are not 0, 0 where nothing was imaged."""
        _checks.number("db", span, positive=True)
        magnitude = np.abs(self.data).astype(np.float32)
        if self.mask is not None:
            magnitude[~self.mask] = np.nan
        positive = magnitude[(magnitude > 0) & np.isfinite(magnitude)]
        coding = Decibels(float(np.percentile(positive, 99.9)) if positive.size else 1.0, float(span))
        return coding, coding.of(magnitude)


def of(path: str, image: Image) -> MapImage:
    """The image in the form of a map, or ValueError naming the file where its grid is none."""
    grid = image.grid
    if grid.kind not in _KINDS:
        raise ValueError(f"{path}: found an image of grid {grid.kind}, expected a plane or a surface; .nc takes any")
    try:
        (x, dx), (y, dy) = even("x", grid.axes["x"]), even("y", grid.axes["y"])
    except ValueError as error:
        raise ValueError(f"{path}: {error}; .nc takes any") from error
    columns, rows = grid.axes["x"].size, grid.axes["y"].size
    order: tuple[Any, Any] = (slice(None, None, -1 if dy > 0 else 1), slice(None, None, -1 if dx < 0 else 1))
    x, dx = (x, dx) if dx > 0 else (x + dx * (columns - 1), -dx)
    y, dy = (y, dy) if dy < 0 else (y + dy * (rows - 1), -dy)
    cos, sin = float(np.cos(grid.rotation)), float(np.sin(grid.rotation))
    east, north = grid.origin[0] + cos * x - sin * y, grid.origin[1] + sin * x + cos * y
    report = image.report
    tags = {"fc": repr(image.fc), "c": repr(image.c), "method": report.method, "report": json.dumps(report.as_dict())}
    if report.tol is not None:
        tags["tol"] = repr(report.tol)
    if grid.kind == "plane":
        tags["z"] = repr(float(grid.height))
    return MapImage(
        image.data[order],
        None if grid.mask is None else grid.mask[order],
        (cos * dx, -sin * dy, east, sin * dx, cos * dy, north),
        tags,
    )
