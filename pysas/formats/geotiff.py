"""Rasters, and arrays that are in memory, as cloud-optimised GeoTIFF, by rasterio: tiles of 512, deflated, with overviews."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.formats import rasters
from pysas.formats.rasters import WINDOW, Decibels, Raster

_TILE = 512
_CACHE = 64  # MB of GDAL's, which takes a twentieth of the machine's memory otherwise
_DRAFT = {
    "driver": "GTiff", "count": 1, "tiled": True, "blockxsize": _TILE, "blockysize": _TILE, "compress": "deflate", "zlevel": 1,
    "bigtiff": "if_safer", "sparse_ok": True,
}  # fmt: skip
_BYTES = {"nodata": 0, "predictor": 2}


def write(
    path: str | os.PathLike[str], raster: Raster, coding: Callable[[], Decibels] | None = None, *, overwrite: bool = False
) -> None:
    """Write magnitudes in float32, NaN where there are none, or in the bytes of `coding`, which is asked once all are known.

    Beside the target there is room needed for twice the file and, for bytes, the magnitudes in float32, deflated.
    """
    with _replacing(path, overwrite) as folder:
        made = _draft(folder / "magnitude.tif", raster)
        if coding is not None:
            made = _coded(folder / "bytes.tif", made, coding())
        resampling = "average" if coding else "rms"
        _optimise(made, folder, predictor="yes", overview_resampling=resampling, overview_compress="deflate")


def write_whole(
    path: str | os.PathLike[str],
    data: npt.NDArray[Any],
    affine: tuple[float, float, float, float, float, float],
    tags: Mapping[str, str],
    *,
    coding: Decibels | None = None,
    mask: npt.NDArray[np.bool_] | None = None,
    overwrite: bool = False,
) -> None:
    """Write an array (row, column), without a CRS.

    Parameters
    ----------
    data : complex, or uint8 of `coding`
    affine : (a, b, c, d, e, f)
        The centre of pixel (row, column) is (a column + b row + c, d column + e row + f).
    tags : of str
        What goes with it, beside what `coding` says.
    coding : Decibels, optional
        What bytes are.
    mask : bool (row, column), optional
        False: no data there.
    """
    with _replacing(path, overwrite) as folder:
        import rasterio

        a, b, c, d, e, f = affine
        transform = rasterio.Affine(a, b, c - (a + b) / 2, d, e, f - (d + e) / 2)  # of the first pixel's corner
        rows, columns = data.shape
        form = _DRAFT | {"width": columns, "height": rows, "dtype": data.dtype.name, "transform": transform}
        form |= {} if coding is None else _BYTES
        with rasterio.open(folder / "draft.tif", "w", **form) as draft:
            draft.write(data, 1)
            if mask is not None:
                draft.write_mask(mask)
            draft.update_tags(**tags, AREA_OR_POINT="Area")
            if coding is None:
                draft.set_band_description(1, "complex image")
            else:
                _describe(draft, coding)
        how = {"predictor": "yes", "overview_resampling": "average", "overview_compress": "deflate"}
        # means of phases that turn within a pixel are nothing, and neither is a predictor of such numbers
        _optimise(folder / "draft.tif", folder, **({"overviews": "none"} if coding is None else how))


def _describe(target: Any, coding: Decibels) -> None:
    """Say of an open file of bytes what they are."""
    target.update_tags(**coding.tags)
    target.set_band_description(1, "dB relative to the reference")
    target.units, target.scales, target.offsets = ("dB",), (coding.scale,), (coding.offset,)


@contextlib.contextmanager
def _replacing(path: str | os.PathLike[str], overwrite: bool) -> Iterator[Path]:
    """A folder in which "made" is made, with GDAL's errors as those of a file."""
    try:
        import rasterio
        import rasterio.errors
        import rasterio.shutil
    except ImportError:
        raise _checks.optional("rasterio", "survey") from None
    with (
        rasters.replacing(path, overwrite=overwrite) as folder,
        rasterio.Env(GDAL_CACHEMAX=_CACHE, GDAL_TIFF_INTERNAL_MASK=True),
    ):
        try:
            yield folder
        except rasterio.errors.RasterioError as error:
            raise OSError(f"{os.fspath(path)}: could not be written: {error}") from error


def _optimise(source: Path, folder: Path, **options: str) -> None:
    import rasterio.shutil

    rasterio.shutil.copy(
        str(source), str(folder / "made"), driver="COG", blocksize=_TILE, compress="deflate", bigtiff="if_safer",
        num_threads="1", **options,
    )  # fmt: skip


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
        profile = source.profile | _DRAFT | {"dtype": "uint8"} | _BYTES
        with rasterio.open(path, "w", **profile) as target:
            for row in range(0, source.height, WINDOW):
                for column in range(0, source.width, WINDOW):
                    sizes = min(WINDOW, source.height - row), min(WINDOW, source.width - column)
                    window = _window(row, column, *sizes)
                    values = coding.of(source.read(1, window=window))
                    if values.any():
                        target.write(values, 1, window=window)
            target.update_tags(**source.tags())
            _describe(target, coding)
    return path


def _window(row: int, column: int, rows: int, columns: int) -> Any:
    from rasterio.windows import Window

    return Window(column, row, columns, rows)
