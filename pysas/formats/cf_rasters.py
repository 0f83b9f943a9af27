"""Rasters as NetCDF and Zarr with the names of the CF conventions, by xarray, a window at a time."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.formats import files, rasters, stores
from pysas.formats.rasters import WINDOW, Raster

_FILL = np.float32(np.nan)


class _Windows:
    """A raster in the form of an array that dask reads by chunks."""

    dtype, ndim = np.dtype(np.float32), 2

    def __init__(self, raster: Raster) -> None:
        self.shape, self._window = raster.shape, raster.window

    def __getitem__(self, where: tuple[slice, slice]) -> npt.NDArray[np.float32]:
        return self._window(where[0].start, where[1].start)


def write_netcdf(path: str | os.PathLike[str], raster: Raster, *, overwrite: bool = False) -> None:
    """Write variable `magnitude` (y, x) in float32, NaN where there is none, deflated."""
    rasters.require_libraries(path)
    chunks = tuple(min(WINDOW, size) for size in raster.shape)
    encoding = {"_FillValue": _FILL, "chunksizes": chunks, "zlib": True, "complevel": 1}
    with _one_thread():
        write_dataset(path, _dataset(raster), {"magnitude": encoding, **_plain()}, overwrite=overwrite)


def write_dataset(path: str | os.PathLike[str], dataset: Any, encoding: dict[str, Any], *, overwrite: bool = False) -> None:
    """An xarray.Dataset as NetCDF-4."""
    with rasters.replacing(path, overwrite=overwrite) as folder:
        try:
            dataset.to_netcdf(folder / "made", engine="netcdf4", format="NETCDF4", encoding=encoding)
        except _checks.InternalError:
            raise
        except RuntimeError as error:  # netCDF4's, of a full disk for one
            raise OSError(f"{files.name(path)}: could not be written: {error}") from error


def write_zarr(path: str | os.PathLike[str], raster: Raster, *, overwrite: bool = False) -> None:
    """The same in a Zarr v3 group."""
    rasters.require_libraries(path)
    require_place(path, overwrite)
    with stores.replacing(path, overwrite=overwrite, what="mosaics") as folder, _one_thread():
        encoding = {"_FillValue": _FILL, "chunks": (WINDOW, WINDOW)}
        _dataset(raster).to_zarr(
            folder, mode="w-", zarr_format=3, consolidated=False, encoding={"magnitude": encoding, **_plain()}
        )


def require_place(path: str | os.PathLike[str], overwrite: bool) -> None:
    """Raise now what writing a Zarr group of this name would: of stores, a mosaic alone is replaced."""
    stores.check_output(path, overwrite, "mosaics")


def _plain() -> dict[str, Any]:
    return {name: {"_FillValue": None} for name in "xy"}


def _one_thread() -> Any:
    import dask

    return dask.config.set(scheduler="synchronous")  # windows are made one after the other: their memory is not


def _dataset(raster: Raster) -> Any:
    import dask.array
    import xarray

    from_array: Any = dask.array.from_array  # which has no types
    values = from_array(
        _Windows(raster), chunks=(WINDOW, WINDOW), name=False, meta=np.empty((0, 0), dtype=np.float32), inline_array=True
    )
    magnitude: dict[str, Any] = {"long_name": "magnitude of the sonar image", "units": "1"}
    along = {}
    for name, axis, label in zip("xy", raster.centres(), raster.axes, strict=True):
        about = {"units": "m", "axis": name.upper(), "long_name": f"{label} of pixel centre"}
        if raster.crs is not None:
            about["standard_name"] = f"projection_{name}_coordinate"
        along[name] = (name, axis, about)
    variables: dict[str, Any] = {"magnitude": (("y", "x"), values, magnitude)}
    if raster.crs is not None:
        magnitude["grid_mapping"] = "crs"
        variables["crs"] = ((), np.int32(0), raster.crs.to_cf())
    attributes: dict[str, Any] = {"Conventions": "CF-1.10", "schema": stores.HOLDS["mosaics"], **raster.attributes}
    return xarray.Dataset(variables, coords=along, attrs=attributes)
