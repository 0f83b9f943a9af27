"""Rasters as cloud-optimised GeoTIFF, by rasterio: tiles of 512, deflated, with overviews."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks
from pysas.formats import rasters
from pysas.formats.rasters import WINDOW, Decibels, Raster

_TILE = 512
_CACHE = 64  # MB of GDAL's, which takes a twentieth of the machine's memory otherwise
_DRAFT = {
    "driver": "GTiff", "count": 1, "tiled": True, "blockxsize": _TILE, "blockysize": _TILE, "compress": "deflate", "zlevel": 1,
    "bigtiff": "if_safer", "sparse_ok": True,
}  # fmt: skip


def write(
    path: str | os.PathLike[str], raster: Raster, coding: Callable[[], Decibels] | None = None, *, overwrite: bool = False
) -> None:
    """Write magnitudes in float32, NaN where there are none, or in the bytes of `coding`, which is asked once all are known.

    Beside the target there is room needed for twice the file and, for bytes, the magnitudes in float32, deflated.
    """
    try:
        import rasterio
        import rasterio.errors
        import rasterio.shutil
    except ImportError:
        raise _checks.optional("rasterio", "survey") from None
    with rasters.replacing(path, overwrite=overwrite) as folder, rasterio.Env(GDAL_CACHEMAX=_CACHE):
        try:
            made = _draft(folder / "magnitude.tif", raster)
            if coding is not None:
                made = _coded(folder / "bytes.tif", made, coding())
            rasterio.shutil.copy(
                str(made), str(folder / "made"), driver="COG", blocksize=_TILE, compress="deflate", bigtiff="if_safer",
                predictor="yes", overview_resampling="average" if coding else "rms", overview_compress="deflate",
                num_threads="1",
            )  # fmt: skip
        except rasterio.errors.RasterioError as error:
            raise OSError(f"{os.fspath(path)}: could not be written: {error}") from error


def _draft(path: Path, raster: Raster) -> Path:
    """The magnitudes, window by window."""
    import rasterio

    rows, columns = raster.shape
    crs = None if raster.crs is None else rasterio.crs.CRS.from_wkt(raster.crs.to_wkt())
    transform = rasterio.Affine(raster.pixel, 0, raster.left, 0, -raster.pixel, raster.top)
    with rasterio.open(
        path,
        "w",
        width=columns,
        height=rows,
        dtype="float32",
        nodata=np.nan,
        crs=crs,
        transform=transform,
        predictor=3,
        **_DRAFT,
    ) as draft:
        for row in range(0, rows, WINDOW):
            for column in range(0, columns, WINDOW):
                values = raster.window(row, column)
                if not np.isnan(values).all():  # what is not written is read as no data
                    draft.write(values, 1, window=_window(row, column, *values.shape))
        draft.update_tags(**{name: str(value) for name, value in raster.attributes.items()}, AREA_OR_POINT="Area")
        draft.set_band_description(1, "magnitude")
    return path


def _coded(path: Path, draft: Path, coding: Decibels) -> Path:
    import rasterio

    with rasterio.open(draft) as source:
        profile = source.profile | _DRAFT | {"dtype": "uint8", "nodata": 0, "predictor": 2}
        with rasterio.open(path, "w", **profile) as target:
            for row in range(0, source.height, WINDOW):
                for column in range(0, source.width, WINDOW):
                    sizes = min(WINDOW, source.height - row), min(WINDOW, source.width - column)
                    window = _window(row, column, *sizes)
                    values = coding.of(source.read(1, window=window))
                    if values.any():
                        target.write(values, 1, window=window)
            target.update_tags(**source.tags(), reference=repr(coding.reference), db=repr(coding.span))
            target.set_band_description(1, "dB relative to the reference")
            target.units, target.scales, target.offsets = ("dB",), (coding.scale,), (coding.offset,)
    return path


def _window(row: int, column: int, rows: int, columns: int) -> Any:
    from rasterio.windows import Window

    return Window(column, row, columns, rows)
