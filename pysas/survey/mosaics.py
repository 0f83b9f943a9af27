"""Mosaics: the strips of a survey's store on one map, whose windows are made one at a time."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas import __version__, _checks
from pysas._checks import FloatArray
from pysas.formats import cf_rasters, files, geotiff, rasters
from pysas.formats.rasters import WINDOW, Decibels, Raster
from pysas.survey import placing, sampling
from pysas.survey.image_store import SurveyStore

COMBINE = ("nearest", "strongest", "mean")
PERCENTILE = 99.9

_PART = 512  # pixels along a side of what is made at a time, less where a pixel spans many samples
_MOST = 2**31 - 1  # pixels along a side, which is as many as GeoTIFF takes
_BIN = 0.01  # dB of a histogram's bins
_BINS = 180_000  # from -900 dB on: all float32
_SNAP = 1e-6  # pixels by which an edge is taken to lie on a line of the map


@dataclass(frozen=True)
class Mosaic:
    """What was written.

    Attributes
    ----------
    output : str
    shape : (rows, columns)
    pixel : float
        A pixel's side, m.
    crs : str, or None in local metres
        Its name, "EPSG:32632" where it has one there.
    bounds : (left, bottom, right, top)
        Edges, m.
    coverage : float
        Share of the pixels that have data.
    tiles, missing : int
        Tiles of the store; those of them that were not made, or failed.
    reference : float or None
        Magnitude that byte 255 stands for; None where there are no bytes.
    """

    output: str
    shape: tuple[int, int]
    pixel: float
    crs: str | None
    bounds: tuple[float, float, float, float]
    coverage: float
    tiles: int
    missing: int
    reference: float | None


@_checks.usual_errors
def mosaic(
    store: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    pixel: float | None = None,
    crs: Any = None,
    combine: str = "nearest",
    feather: float = 0.0,
    db: float | None = None,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Mosaic:
    """Write the strips of a survey's store as one map, north up: GeoTIFF, NetCDF or Zarr.

    Magnitudes are combined, never samples: lines are not coherent with each other.

    Parameters
    ----------
    store : path
        Of the survey's images.
    output : path
        With suffix .tif (cloud-optimised GeoTIFF), .nc or .zarr (by the CF conventions).
    pixel : float, optional
        A pixel's side, in m of the map; default: the largest step of the store's pixels.
    crs : str or anything that pyproj.CRS takes, optional
        A projected CRS in metres. Default: UTM (WGS84) in the zone of the survey's middle; where lines are not tied to the
        Earth, their local metres, without a CRS.
    combine : "nearest", "strongest" or "mean"
        Where strips overlap: the one of the least ground range, the largest magnitude, or the mean of their magnitudes.
    feather : float
        m over which a strip's weight rises from where it has no data, and, for "nearest", over which strips blend where their
        ranges are equal. 0: no blending.
    db : float, optional
        Of a GeoTIFF: bytes 1 to 255 over so many dB below the 99.9th percentile of the magnitudes, 0 where there are no data.
        Default: magnitudes in float32, NaN where there are no data.
    overwrite : bool
        Whether a file, or a mosaic in .zarr, that is there may be replaced.
    progress : callable, optional
        Called with the share that is done.

    Returns
    -------
    Mosaic

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; a CRS that does not exist; strips that are tied to different things; a store without a
        tile that is done; a tile that is damaged, which is named.
    FileExistsError
        The output exists, and `overwrite` is not given.
    ImportError
        A library of the extra `survey` is not installed.

    Warns
    -----
    UserWarning
        Tiles of the store are missing or failed.

    Notes
    -----
    A pixel's magnitude in a strip is the root of the mean power over the pixel's box, bilinear between the means about the
    strip's samples. Power has no phase to get wrong, is never negative, and its mean is kept whatever the size of pixels; an
    average of magnitudes would darken speckle where it interpolates and nowhere else.

    Time: that of the pixels times the strips that cover them. Memory: windows, 96 MiB of tiles and one tile more, whatever
    the sizes of survey and map.
    """
    path, kind = files.name(output), rasters.format_of(output)
    _checks.choice("combine", combine, COMBINE)
    feather = _checks.number("feather", feather, low=0.0)
    pixel = None if pixel is None else _checks.number("pixel", pixel, positive=True)
    if db is not None:
        db = _checks.number("db", db, positive=True)
        if kind != rasters.GEOTIFF:
            raise ValueError(f"db={db!r}: expected None for {path}: bytes are for .tif")
    _checks.callback("progress", progress)
    opened = SurveyStore(store)
    _require_place(path, kind, opened.path, overwrite)
    rasters.require_libraries(path)
    made = _Map(opened, pixel, crs, combine, feather, progress)
    if kind == rasters.GEOTIFF:
        coding = None if db is None else lambda: Decibels(made.level(), db)
        geotiff.write(path, made.raster, coding, overwrite=overwrite)
    elif kind == rasters.NETCDF:
        cf_rasters.write_netcdf(path, made.raster, overwrite=overwrite)
    else:
        cf_rasters.write_zarr(path, made.raster, overwrite=overwrite)
    (rows, columns), raster = made.raster.shape, made.raster
    bounds = raster.left, raster.top - rows * raster.pixel, raster.left + columns * raster.pixel, raster.top
    return Mosaic(
        path, raster.shape, raster.pixel, _name(raster.crs), bounds, made.covered / (rows * columns), made.tiles.total,
        made.tiles.missing, None if db is None else made.level(),
    )  # fmt: skip


def _require_place(path: str, kind: str, store: str, overwrite: bool) -> None:
    """Raise now what writing would raise after the work, and where it would change the store."""
    source, target = os.path.realpath(store), os.path.realpath(path)
    if target == source or target.startswith(source + os.sep):
        raise ValueError(f"output={path!r}: lies in the store that is read: expected another place")
    if kind == rasters.ZARR:
        cf_rasters.require_place(path, overwrite)
    else:
        files.check_outputs([("output", path)], [], overwrite)


def _name(crs: Any) -> str | None:
    if crs is None:
        return None
    authority = crs.to_authority()
    return str(crs.name if authority is None else ":".join(authority))


class _Map:
    """The map of a survey, and what is learnt of it while it is made.

    Attributes
    ----------
    raster : Raster
    tiles : Tiles
    covered : int
        Pixels with data, of the windows made so far.
    """

    def __init__(
        self, store: SurveyStore, pixel: float | None, crs: Any, combine: str, feather: float,
        progress: Callable[[float], None] | None,
    ) -> None:  # fmt: skip
        strips = store.strips
        self.tiles = sampling.Tiles(store.path, strips)
        if not any(done.any() for done in self.tiles.done):
            raise ValueError(f"{store.path}: no tile of {self.tiles.total} is done: expected some, by pysas survey --resume")
        try:
            chart = placing.chart(strips, crs)
        except ValueError as error:
            raise error if str(error).startswith("crs=") else ValueError(f"{store.path}: {error}") from error
        if self.tiles.missing:
            missing = f"{self.tiles.missing} of {self.tiles.total} tiles"
            _checks.warn(f"{store.path}: {missing} are missing or failed: no data there")
        steps = [abs(axis.step) for place in chart.places for axis in (place.x, place.y)]
        self._pixel = max(steps) if pixel is None else pixel
        self._combine, self._feather, self._progress = combine, feather, progress
        self._bounds = chart.bounds
        self._samplers = [
            sampling.Sampler(number, strip, place, self.tiles, sampling.ground(place, box, self._pixel), feather)
            for number, (strip, place, box) in enumerate(zip(strips, chart.places, chart.bounds, strict=True))
        ]
        self.covered, self._made = 0, 0
        self._histogram = np.zeros(_BINS, dtype=np.int64)
        left, top, shape = self._extent()
        attributes: dict[str, str | float | int] = {
            "title": "mosaic of a sonar survey", "source": f"pysas {__version__}", "combine": combine, "feather_m": feather,
            "tiles": self.tiles.total, "tiles_missing": self.tiles.missing,
        }  # fmt: skip
        self.raster = Raster(shape, left, top, self._pixel, chart.crs, chart.axes, attributes, self._window)
        self._windows = math.prod(-(-size // WINDOW) for size in shape)

    def _extent(self) -> tuple[float, float, tuple[int, int]]:
        """Left and upper edge on multiples of a pixel, and (rows, columns), of a map that holds all strips."""
        low, high = self._bounds.min(axis=0) / self._pixel, self._bounds.max(axis=0) / self._pixel
        first = np.floor(low[[0, 2]] + _SNAP)
        columns, rows = (int(size) for size in np.ceil(high[[1, 3]] - _SNAP) - first)
        if max(rows, columns) > _MOST:
            raise ValueError(f"pixel={self._pixel!r}: {rows} x {columns} pixels: expected at most {_MOST} along a side")
        return float(first[0] * self._pixel), float((first[1] + rows) * self._pixel), (rows, columns)

    def level(self) -> float:
        """The 99.9th percentile of the magnitudes, to a hundredth of a dB."""
        counts = np.cumsum(self._histogram)
        if not counts[-1]:
            return 1.0
        number = int(np.searchsorted(counts, PERCENTILE / 100 * counts[-1]))
        return float(10 ** (((number + 1) * _BIN - 900) / 20))

    def _window(self, row: int, column: int) -> sampling.Floats:
        """Pixels of a window, made part by part."""
        rows, columns = (min(WINDOW, size - first) for size, first in zip(self.raster.shape, (row, column), strict=True))
        found = np.full((rows, columns), np.nan, dtype=np.float32)
        x = np.asarray(self.raster.left + self._pixel * (column + np.arange(columns) + 0.5), dtype=np.float64)
        y = np.asarray(self.raster.top - self._pixel * (row + np.arange(rows) + 0.5), dtype=np.float64)
        side = _PART
        near = self._near(x, y)
        while side > 1 and not all(self._samplers[k].fits(side * self._pixel, side * self._pixel) for k in near):
            side //= 2
        for first in range(0, rows if near else 0, side):
            for begin in range(0, columns, side):
                where = slice(first, first + side), slice(begin, begin + side)
                found[where] = self._part(x[where[1]], y[where[0]], found[where])
        self._count(found[~np.isnan(found)])
        self._made += 1
        if self._progress is not None:
            self._progress(self._made / self._windows)
        return found

    def _count(self, data: sampling.Floats) -> None:
        self.covered += data.size
        with np.errstate(divide="ignore"):
            level = (20 * np.log10(data.astype(np.float64)) + 900) / _BIN
        self._histogram += np.bincount(np.clip(level, 0, _BINS - 1).astype(np.intp), minlength=_BINS)

    def _part(self, x: FloatArray, y: FloatArray, empty: sampling.Floats) -> sampling.Floats:
        parts = [part for k in self._near(x, y) if (part := self._samplers[k].sample(x, y)) is not None]
        return sampling.combined(parts, self._combine, self._feather) if parts else empty

    def _near(self, x: FloatArray, y: FloatArray) -> list[int]:
        """Strips that may have data among pixels."""
        low_x, high_x, low_y, high_y = self._bounds.T
        return [int(k) for k in np.flatnonzero((low_x <= x[-1]) & (high_x >= x[0]) & (low_y <= y[0]) & (high_y >= y[-1]))]
