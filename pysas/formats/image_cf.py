"""Images as NetCDF-4 and Zarr with the names of the CF conventions, through xarray; read back by the containers' own readers.

CF has no complex numbers: pixels are two real variables. NetCDF-4 checks chunks by Fletcher-32 and nothing of where they lie;
so variables carry the CRC-32 of their entries, and the attributes theirs, as in the other containers.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pysas import __version__
from pysas.formats import cf_rasters, files, io, rasters, stores
from pysas.formats.containers import opened_netcdf
from pysas.formats.fields import Array, File, bytes_of
from pysas.formats.format import Format, Item, Look
from pysas.model.image import Image

_NETCDF, _ZARR = ".nc", stores.SUFFIX
_SCHEMA = stores.HOLDS["single images"]
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SIDE, _CHUNK_BYTES = 1024, 2**21  # of a chunk along the last two axes; of one in Zarr
_ABOUT = "real + 1j imag = sum of s(tau) exp(+2j pi fc tau) over pings and channels; fc in Hz, c in m s-1, places in m"
_LONG = {
    "x": "x of pixel", "y": "y of pixel", "z": "z of pixel", "height": "z of pixel", "r": "range of pixel from the centre",
    "angle": "angle of pixel from x towards y", "real": "real part of the sonar image",
    "imag": "imaginary part of the sonar image",
}  # fmt: skip


# Writing


def _write(path: str, image: Image, overwrite: bool) -> None:
    rasters.require_libraries(path)
    dataset = _dataset(image)
    if Path(path).suffix.lower() == _ZARR:
        _write_zarr(path, dataset, overwrite)
        return
    encoding = {}
    for name, variable in dataset.variables.items():
        sides = (1,) * max(0, variable.ndim - 2) + (_SIDE if variable.ndim > 1 else _SIDE**2,) * min(2, variable.ndim)
        chunks = tuple(map(min, sides, variable.shape))
        variable.attrs["crc32"] = np.uint32(zlib.crc32(bytes_of(np.ascontiguousarray(variable.values)).data))
        encoding[name] = {"_FillValue": None, "chunksizes": chunks, "zlib": True, "complevel": 1, "fletcher32": True}
    cf_rasters.write_dataset(path, dataset, encoding, overwrite=overwrite)


def _write_zarr(path: str, dataset: Any, overwrite: bool) -> None:
    codecs = stores.library().codecs
    encoding = {}
    for name, variable in dataset.variables.items():
        row = math.prod(variable.shape[1:]) * variable.dtype.itemsize
        chunks = max(1, min(variable.shape[0], _CHUNK_BYTES // row)), *variable.shape[1:]
        encoding[name] = {
            "_FillValue": None, "chunks": chunks, "filters": (), "compressors": (codecs.Crc32cCodec(),),
            "serializer": codecs.BytesCodec(endian="little"),
        }  # fmt: skip
    with stores.replacing(path, overwrite=overwrite, what="single images") as folder:
        dataset.to_zarr(folder, mode="w-", zarr_format=3, consolidated=False, encoding=encoding, write_empty_chunks=True)


def _dataset(image: Image) -> Any:
    import xarray

    grid, pixels = image.grid, image.to_xarray()
    kind = np.dtype(f"f{image.data.dtype.itemsize // 2}")
    parts = {
        name: pixels.copy(data=np.asarray(part, kind, order="C"))
        for name, part in (("real", image.data.real), ("imag", image.data.imag))
    }
    if grid.mask is not None:
        parts["mask"] = pixels.copy(data=grid.mask.astype(np.int8))
    points = {name: np.arange(size) for name, size in pixels.sizes.items() if name not in pixels.coords}
    dataset = xarray.Dataset(parts, attrs=_header(image)).assign_coords(points)
    for name, variable in dataset.variables.items():
        variable.attrs = {"units": "1"}
        if name in _LONG:
            variable.attrs = {"units": "radian" if name == "angle" else "1" if name in parts else "m", "long_name": _LONG[name]}
        if name == "mask":
            flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "not_imaged imaged"}
            variable.attrs = {"long_name": "whether a pixel was imaged", **flags}
        elif name in points:
            variable.attrs["long_name"] = "number of the point"
        elif name in ("x", "y") and name in grid.axes:
            along = f"{name} of pixel along the grid's own axis, turned and shifted by the attributes rotation and origin"
            variable.attrs |= {"axis": name.upper()} | ({"long_name": along} if grid.turned else {})
    return dataset


def _header(image: Image) -> dict[str, Any]:
    grid, report = image.grid, image.report
    fields = io.fields_of(image)
    header: dict[str, Any] = {"Conventions": "CF-1.10", "title": "sonar image", "schema": _SCHEMA, "comment": _ABOUT}
    header |= {
        "history": f"written by pysas {__version__}",
        "grid_kind": grid.kind,
        "fc": image.fc,
        "c": image.c,
        "report": str(fields["report"]),
    }
    header["method"] = report.method.encode("ascii", "backslashreplace").decode()  # in the report as it is
    if report.tol is not None:
        header["tol"] = float(report.tol)
    if grid.kind == "plane":
        header["height"] = float(grid.height)
    if grid.kind == "polar":
        header |= {f"centre_{name}": value for name, value in zip("xyz", grid.centre, strict=True)}
    if grid.turned:
        header |= {"origin_x": grid.origin[0], "origin_y": grid.origin[1], "rotation": grid.rotation}
    return header | {"crc32": stores.sum_of(header)}


# Reading


class _Image(File):
    """Variables and attributes as fields of "pysas-image-1"."""

    def __init__(self, base: File) -> None:
        self._base = base
        self.fields, self.pairs, self._followed = {}, {}, {}
        self._made: dict[str, Callable[[], Array]] = {}
        if (schema := base.text("schema")) != _SCHEMA:
            raise ValueError(f"schema: found {schema!r:.60}, expected {_SCHEMA!r}")
        self._put("schema", (), np.dtype("U"), lambda: np.asarray(io.IMAGE))
        for name in ("fc", "c", "report", "grid_kind"):
            self._same(name, name)
        kind = base.text("grid_kind")
        if kind == "points":
            self._joined("grid_coords", "xyz", lambda parts: np.stack(parts, axis=-1))
        else:
            for name in ("x", "y", "z", "r", "angle", "height", "rotation"):
                self._same(f"grid_{name}", name)
            for name, parts in (("centre", "xyz"), ("origin", "xy")):
                if f"{name}_x" in base.fields:
                    self._joined(f"grid_{name}", [f"{name}_{part}" for part in parts], np.array)
        if "mask" in base.fields:
            self._put("grid_mask", base.fields["mask"][0], np.dtype(bool), self._mask)
        shape, dtype = self._alike(["real", "imag"])
        self._put("data", shape, np.dtype(f"c{2 * dtype.itemsize}"), self._pixels)

    def _put(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], read: Callable[[], Array]) -> None:
        self.fields[name], self._made[name] = (shape, dtype), read

    def _same(self, name: str, source: str) -> None:
        if source in self._base.fields:
            self._put(name, *self._base.fields[source], lambda: self._base.read(source))

    def _joined(self, name: str, sources: Any, join: Callable[[list[Array]], Array]) -> None:
        shape, dtype = self._alike(list(sources))
        joined = (*shape, len(sources)) if shape else (len(sources),)
        self._put(name, joined, dtype, lambda: join([self._base.read(source) for source in sources]))

    def _alike(self, names: list[str]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """The shape and the dtype of fields that have the same."""
        for name in names:
            found = self._base.fields.get(name)
            if found is None or found != self._base.fields[names[0]] or found[1].str[1:] not in ("f4", "f8"):
                said = "missing" if found is None else f"found {found[1]} of shape {found[0]}"
                raise ValueError(f"{name}: {said}, expected {', '.join(names)} alike, of float32 or float64")
        return self._base.fields[names[0]]

    def _mask(self) -> Array:
        values = self._base.read("mask")
        if values.dtype != np.int8 or not np.isin(values, (0, 1)).all():
            raise ValueError(f"mask: found {values.dtype}, expected int8, 0 or 1")
        return values.astype(bool)

    def _pixels(self) -> Array:
        data = np.empty(*self.fields["data"])
        data.real, data.imag = self._base.read("real"), self._base.read("imag")
        return data

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        return self._made[name]()


def _sniff(look: Look) -> bool:
    if look.folder:
        return {"schema", "grid_kind", "real", "imag"} <= look.entries.keys()
    written = "schema" in look.entries or not look.entries  # none: reading tells what is wrong
    return look.suffix == _NETCDF and look.head.startswith(_HDF5) and written


def _read(path: str, channel: str | None) -> Item:
    if Path(path).is_dir():
        with io.opened(path) as store:
            return io.read(path, _Image(store))
    with files.opened(path) as file, io.named(path), opened_netcdf(file) as variables:
        stores.require_sum(variables.header, "attributes")
        return io.read(path, _Image(variables))


FORMAT = Format(
    name="cf",
    title="NetCDF-4 and Zarr by the CF conventions",
    suffixes=(_NETCDF, _ZARR),
    holds="images",
    kept="all; pixels as real and imag",
    lost="nothing",
    sniff=_sniff,
    read=_read,
    write=_write,
    writes=(Image,),
    extra="survey,hdf5",
)
