"""The images of a survey in a Zarr v3 group: strips of tiles, and what became of each tile.

A strip is a group with axes x and y of its own, arrays `data` (complex64) and `magnitude` (float32) of (row, column), and a
group `records` of one group a tile. A tile is `columns` columns, all rows, and one shard of each array: it is written whole, by
whoever made it, and its record last. Nothing that depends on who made it and when lies in a store, so that two runs of a plan
leave the same bytes. Chunks carry their CRC-32C, records the CRC-32 of the shards, attributes their own.
"""

from __future__ import annotations

import functools
import json
import math
import os
import secrets
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files, stores
from pysas.formats.fields import blamed

SCHEMA = "pysas-survey-1"
ARRAYS = {"data": np.dtype(np.complex64), "magnitude": np.dtype(np.float32)}
DONE, DARK, FAILED, DAMAGED = "done", "dark", "failed", "damaged"  # states of a tile that has a record; dark: no ping lights it

_RECORDS = "records"
_ROWS = 128, 1024  # of an inner chunk: at least and at most, of those that divide a tile's
_MOST_TILE = 2**31  # bytes
_AXIS = 8192  # entries of a chunk of x, which may grow


@dataclass(frozen=True)
class StripHeader:
    """What a strip is created with: its name, its attributes, the axes of its pixels, and columns a tile."""

    name: str
    attributes: Mapping[str, Any]
    x: FloatArray
    y: FloatArray
    columns: int


class StripStore:
    """One strip, opened.

    Attributes
    ----------
    name : str
    attributes : dict
    x, y : (column,), (row,)
        Axes of the pixels, m, along and across the line.
    columns, tiles : int
        Of a tile, and how many there are.
    """

    def __init__(self, folder: Path) -> None:
        self.name, self._folder = folder.name, folder
        zarr = stores.library()
        with blamed(self.name):
            stores.require_header(folder)
            self._group = zarr.open_group(stores.local(folder), mode="r+", zarr_format=3, use_consolidated=False)
            self.attributes = dict(self._group.attrs)
            stores.require_sum(self.attributes)
            del self.attributes["crc32"]
            self.columns = _checks.whole("columns", self.attributes["columns"])
            self.x, self.y = (self._axis(name) for name in "xy")
            self.tiles = self.x.size // self.columns
            self._arrays = {name: self._array(name) for name in ARRAYS}

    def _axis(self, name: str) -> FloatArray:
        stores.require_header(self._folder / name)
        array = self._group[name]
        if array.ndim != 1 or array.dtype != np.float64 or not 1 <= array.size <= 2**31:
            raise ValueError(f"{name}: found {array.dtype} of shape {array.shape}, expected float64 (n,)")
        return np.asarray(array[...], dtype=np.float64)

    def _array(self, name: str) -> Any:
        stores.require_header(self._folder / name)
        array = self._group[name]
        shape, tile = (self.y.size, self.x.size), (self.y.size, self.columns)
        found = f"{array.dtype} of shape {array.shape} in shards of {array.shards}"
        held = (
            array.ndim == 2 and array.shape[0] == shape[0] and array.shape[1] >= shape[1]
        )  # a strip that grows is longer first
        if array.dtype != ARRAYS[name] or not held or array.shards != tile or self.x.size % self.columns:
            raise ValueError(f"{name}: found {found}, expected {ARRAYS[name]} of shape {shape} in shards of {tile}, the tiles")
        if math.prod(tile) * array.dtype.itemsize > _MOST_TILE:
            raise ValueError(f"{name}: found {found}, expected shards of at most {_MOST_TILE} bytes")
        return array

    def write(self, tile: int, data: npt.NDArray[np.complex64], record: Mapping[str, Any]) -> None:
        """A tile's pixels (row, column), and then its record, which becomes that of a tile that is done."""
        pixels = np.ascontiguousarray(data, dtype=np.complex64)
        if pixels.shape != (self.y.size, self.columns):
            raise _checks.InternalError(f"tile of shape {pixels.shape}")
        arrays = {"data": pixels, "magnitude": np.abs(pixels)}
        shards = {name: _write_shard(self._shard(name, tile), array) for name, array in arrays.items()}
        self.put(tile, {**record, "state": DONE, "shards": shards})

    def put(self, tile: int, record: Mapping[str, Any]) -> None:
        """A tile's record alone."""
        folder = self._folder / _RECORDS / str(tile)
        folder.mkdir(exist_ok=True)
        attributes = {**record, "crc32": stores.sum_of(record)}
        group = {"attributes": attributes, "zarr_format": 3, "node_type": "group"}
        with files.replacing(folder / "zarr.json") as file:
            file.write(json.dumps(group, indent=1, sort_keys=True).encode())

    def record(self, tile: int) -> dict[str, Any] | None:
        """A tile's record; None where it has none or one that is damaged."""
        folder = self._folder / _RECORDS / str(tile)
        try:
            stores.require_header(folder)
            attributes = dict(json.loads((folder / "zarr.json").read_bytes())["attributes"])
            stores.require_sum(attributes)
            if attributes.pop("crc32", None) is None or attributes.get("state") not in (DONE, DARK, FAILED, DAMAGED):
                return None
            return attributes
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def has_record(self, tile: int) -> bool:
        """Whether there is one, damaged or not."""
        return (self._folder / _RECORDS / str(tile) / "zarr.json").exists()

    def forget(self, tile: int) -> None:
        """Take a tile's record away: it has not been made."""
        (self._folder / _RECORDS / str(tile) / "zarr.json").unlink(missing_ok=True)

    def damage(self, tile: int) -> str | None:
        """What is wrong with the shards of a tile that is done, by its record; reads them whole."""
        record = self.record(tile) or {}
        for name in ARRAYS:
            try:
                found, expected = self._sum(name, tile), record.get("shards", {}).get(name)
            except FileNotFoundError:
                return f"{name}: missing"
            if found != expected:
                return f"{name}: damaged: found bytes other than were written, by their number or CRC-32"
        return None

    def whole(self, tile: int) -> bool:
        """Whether a tile that is done has shards of the size that they were written with."""
        record = self.record(tile) or {}
        try:
            return all(os.stat(self._shard(name, tile)).st_size == record["shards"][name][0] for name in ARRAYS)
        except (OSError, KeyError, TypeError):
            return False

    def read(self, tile: int, name: str = "magnitude") -> npt.NDArray[Any]:
        """A tile's pixels (row, column) of `data` or `magnitude`, compared with its record.

        Raises ValueError where the tile is not done, or its shard is not what was written.
        """
        record = self.record(tile)
        if record is None or record["state"] != DONE:
            raise ValueError(f"{self.name}, tile {tile}: {'not made' if record is None else record['state']}")
        try:
            good = self._sum(name, tile) == record["shards"][name]
        except FileNotFoundError:
            good = False
        if not good:
            raise ValueError(f"{self.name}, tile {tile}: {name} is damaged or missing: pysas survey --verify names all such")
        return np.asarray(self._arrays[name][:, tile * self.columns : (tile + 1) * self.columns])

    def _shard(self, name: str, tile: int) -> Path:
        return self._folder / name / f"c.0.{tile}"

    def _sum(self, name: str, tile: int) -> list[int]:
        """Number of bytes of a shard, and their CRC-32."""
        content = self._shard(name, tile).read_bytes()
        return [len(content), zlib.crc32(content)]

    def grow(self, x: FloatArray, attributes: Mapping[str, Any]) -> None:
        """More tiles at the end, and what the strip is made from then; by no one else at the same time."""
        for name in ARRAYS:
            self._arrays[name].resize((self.y.size, x.size))
        self._group["x"].resize((x.size,))
        self._group["x"][...] = x
        self.attributes = {**attributes, "columns": self.columns}
        self._group.update_attributes({**self.attributes, "crc32": stores.sum_of(self.attributes)})
        self.x, self.tiles = x, x.size // self.columns

    def parts(self) -> Iterator[Path]:
        """Files that killed processes left half-written."""
        for name in (*ARRAYS, "x"):
            yield from (self._folder / name).glob("*.partial")
        yield from self._folder.glob("*.partial")
        yield from (self._folder / _RECORDS).glob("*/.pysas-*")


class SurveyStore:
    """The store of a survey, opened.

    Attributes
    ----------
    path : str
    header : dict
        Its attributes.
    names : list of str
        Of the strips.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = files.name(path)
        stores.require(self.path)
        folder = Path(self.path)
        try:
            stores.require_header(folder)
            header = json.loads((folder / "zarr.json").read_bytes()).get("attributes", {})
            if (schema := header.get("schema")) != SCHEMA:
                raise ValueError(f"schema: found {schema!r:.60}, expected {SCHEMA!r}")
            stores.require_sum(header)
            self.header = {name: value for name, value in header.items() if name != "crc32"}
            names = self.header["strips"]
            if not isinstance(names, list) or not all(isinstance(name, str) and name.isprintable() for name in names):
                raise ValueError(f"strips: found {names!r:.60}, expected names")
            if any(Path(name).name != name or name.startswith(".") for name in names):
                raise ValueError(f"strips: found {names!r:.60}, expected names of groups of this one")
            self.names: list[str] = names
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{self.path}: {f'{error} missing' if isinstance(error, KeyError) else error}") from error

    @functools.cached_property
    def strips(self) -> list[StripStore]:
        """All of them."""
        return [self.strip(number) for number in range(len(self.names))]

    def strip(self, number: int) -> StripStore:
        """One of them, opened."""
        try:
            return StripStore(Path(self.path) / self.names[number])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{self.path}: {f'{error} missing' if isinstance(error, KeyError) else error}") from error


def create(folder: Path, header: Mapping[str, Any], strips: Sequence[StripHeader]) -> None:
    """A new store in a folder that is not there yet; tiles have no pixels and no records."""
    zarr = stores.library()
    root = zarr.create_group(stores.local(folder), zarr_format=3, overwrite=False)
    for strip in strips:
        attributes = {**strip.attributes, "columns": strip.columns}
        group = root.create_group(strip.name, attributes={**attributes, "crc32": stores.sum_of(attributes)})
        for name, axis, many in (("x", strip.x, _AXIS), ("y", strip.y, strip.y.size)):
            stores.create_array(group, name, (name,), axis, many)
        for name, dtype in ARRAYS.items():
            group.create_array(
                name, shape=(strip.y.size, strip.x.size), dtype=dtype, chunks=(_inner(strip.y.size), strip.columns),
                shards=(strip.y.size, strip.columns), filters=None, serializer=zarr.codecs.BytesCodec(endian="little"),
                compressors=[zarr.codecs.Crc32cCodec()], fill_value=0, dimension_names=("y", "x"),
                chunk_key_encoding={"name": "default", "separator": "."},
            )  # fmt: skip
        group.create_group(_RECORDS)
    attributes = {**header, "schema": SCHEMA, "strips": [strip.name for strip in strips]}
    root.update_attributes({**attributes, "crc32": stores.sum_of(attributes)})


def _write_shard(path: Path, pixels: npt.NDArray[Any]) -> list[int]:
    """A tile as Zarr's sharding codec has it: inner chunks, each with its CRC-32C, and the index of their places; returns the
    number of bytes and their CRC-32. Zarr's own writing costs a tenth of imaging the tile, this a third of that."""
    from google_crc32c import value as crc32c  # Zarr's own

    rows, pixels = _inner(pixels.shape[0]), pixels.view()
    pixels.setflags(write=False)
    parts: list[Any] = []
    index, place = [], 0
    for first in range(0, pixels.shape[0], rows):
        chunk = pixels[first : first + rows].reshape(-1).view(np.uint8)
        parts += [chunk, crc32c(chunk).to_bytes(4, "little")]
        index += [place, chunk.size + 4]
        place += chunk.size + 4
    end = np.array(index, dtype="<u8").tobytes()
    parts += [end, crc32c(end).to_bytes(4, "little")]
    part = path.with_name(f"{path.name}.{secrets.token_hex(8)}.partial")
    try:
        with open(part, "xb", buffering=0) as file:
            for one in parts:
                _write_all(file, one)
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    total = 0
    for one in parts:
        total = zlib.crc32(one, total)
    return [place + len(end) + 4, total]


def _write_all(file: Any, content: Any) -> None:
    """However little the file takes at a time."""
    left = memoryview(content)
    while left.nbytes:
        left = left[file.write(left) :]


def _inner(rows: int) -> int:
    """Rows of an inner chunk, which divide a tile's."""
    least, most = _ROWS
    return next((rows // many for many in range(-(-rows // most), rows // least + 1) if rows % many == 0), rows)
