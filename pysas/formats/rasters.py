"""Maps of pixels that leave the house: what they are, and which format a name asks for.

A raster is never in memory as a whole: writers ask for its windows, each once, in the order that suits them.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files

WINDOW = 1024  # pixels along a side of a window that writers ask for, where the raster does not end before
GEOTIFF, NETCDF, ZARR = "geotiff", "netcdf", "zarr"
_FORMATS = {".tif": GEOTIFF, ".tiff": GEOTIFF, ".nc": NETCDF, ".zarr": ZARR}


def even(name: str, values: FloatArray) -> tuple[float, float]:
    """The first of two or more places along an axis and their step, which is not 0.

    Raises ValueError where steps differ, by more than a thousandth.
    """
    if values.size < 2 or not np.isfinite(values).all():
        raise ValueError(f"{name}: found {values.size} entries, expected two or more, all finite")
    step = float(values[-1] - values[0]) / (values.size - 1)
    off = np.abs(values[0] + step * np.arange(values.size) - values)
    if step == 0 or off.max() > 1e-3 * abs(step):
        raise ValueError(f"{name}: unequal steps at entry {int(off.argmax())}: expected equal ones, not 0")
    return float(values[0]), step


@dataclass(frozen=True)
class Raster:
    """Magnitudes (row, column) of square pixels, rows from north to south, NaN where there are none.

    Attributes
    ----------
    shape : (rows, columns)
    left, top : float
        Edges of the first pixel, m.
    pixel : float
        A side, m.
    crs : pyproj.CRS or None
        None: local metres.
    axes : (str, str)
        What x and y are.
    attributes : dict
        Texts and numbers that go with it.
    window : callable
        `window(row, column)` are the pixels of the window that begins there, a multiple of WINDOW: float32 (row, column).
    """

    shape: tuple[int, int]
    left: float
    top: float
    pixel: float
    crs: Any
    axes: tuple[str, str]
    attributes: Mapping[str, str | float | int]
    window: Callable[[int, int], npt.NDArray[np.float32]]

    def centres(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """x (column,) and y (row,), which falls, of the pixels' centres."""
        rows, columns = self.shape
        x, y = self.left + self.pixel * (np.arange(columns) + 0.5), self.top - self.pixel * (np.arange(rows) + 0.5)
        return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


@dataclass(frozen=True)
class Decibels:
    """Magnitudes as bytes: 255 at `reference` and above, 1 at `span` dB below it and less, 0 where there is none."""

    reference: float
    span: float

    def of(self, magnitude: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
        found = np.zeros(magnitude.shape, dtype=np.uint8)
        some = ~np.isnan(magnitude)
        with np.errstate(divide="ignore"):
            level = 20 * np.log10(magnitude[some] / np.float32(self.reference))
        found[some] = 1 + np.rint(254 * np.clip(1 + level / np.float32(self.span), 0, 1))
        return found

    @property
    def scale(self) -> float:
        """dB a step."""
        return self.span / 254

    @property
    def tags(self) -> dict[str, str]:
        """What a file of such bytes says of them."""
        return {"reference": repr(self.reference), "db": repr(self.span)}

    @property
    def offset(self) -> float:
        """dB relative to the reference that 0 would stand for."""
        return -self.span - self.scale


def format_of(path: str | os.PathLike[str]) -> str:
    """The format that a name's suffix asks for."""
    suffix = os.path.splitext(files.name(path))[1].lower()
    if suffix not in _FORMATS:
        raise ValueError(f"{files.name(path)}: found suffix {suffix!r}, expected .tif, .nc or .zarr")
    return _FORMATS[suffix]


def require_libraries(path: str | os.PathLike[str]) -> None:
    """Raise now what writing would for want of a library."""
    try:
        if format_of(path) == GEOTIFF:
            import rasterio  # noqa: F401
        else:
            import dask.array  # noqa: F401
            import xarray  # noqa: F401

            if format_of(path) == NETCDF:
                import netCDF4  # noqa: F401
            else:
                import zarr  # noqa: F401
    except ImportError as error:
        raise _checks.optional(error.name or str(error), "survey") from None


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[Path]:
    """A folder in which a library makes the file "made" by its name: it takes the place of `path` when the block ends.

    The folder is gone after that, whatever happens; a killed process leaves a `.pysas-*.part` beside the target.
    """
    with files.replacing(path, overwrite=overwrite) as file:
        parent = Path(os.path.realpath(files.name(path))).parent
        folder = parent / f".pysas-{os.getpid()}-{secrets.token_hex(4)}.part"
        folder.mkdir()
        try:
            yield folder
            with open(folder / "made", "rb") as made:
                shutil.copyfileobj(made, file, 2**22)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
