"""The images of a survey in a Zarr v3 group: strips of tiles, and what became of each tile.

A strip is a group with axes x and y of its own, arrays `data` (complex64) and `magnitude` (float32) of (row, column), and a
group `records` of one group a tile. A tile is `columns` columns, all rows, and one shard of each array: it is written whole, by
whoever made it, and its record last. Nothing that depends on who made it and when lies in a store, so that two runs of a plan
leave the same bytes. Chunks carry their CRC-32C, records the CRC-32 of the shards, attributes their own.
"""

from __future__ import annotations

import contextlib
import functools
import json
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

SCHEMA = stores.HOLDS["images"]
ARRAYS = {"data": np.dtype(np.complex64), "magnitude": np.dtype(np.float32)}
DONE, DARK, FAILED, DAMAGED = "done", "dark", "failed", "damaged"  # states of a tile that has a record; dark: no ping lights it

_RECORDS = "records"
_HEADERS = ("x", "y", *ARRAYS, _RECORDS)  # in a strip
_ROWS = 128, 1024  # of an inner chunk: at least and at most, of those that divide a tile's
_MOST_TILE, _MOST_TILES = 2**31, 2**24  # bytes, and of a strip
_AXIS = 4096  # columns in a chunk of x, the same whatever the length, which may grow


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
    mended : list of str
        Headers that were damaged and were written anew.
    """

    def __init__(self, folder: Path, *, mend: bool = False) -> None:
        self.name, self._folder = folder.name, folder
        self.mended: list[str] = []
        zarr = stores.library()
        with blamed(self.name):
            self.attributes = _attributes_of(folder, self.mended if mend else None)
            self._sums = dict(self.attributes.pop("headers"))
            rows = _checks.whole("rows", self.attributes.pop("rows"))
            self.columns, self.tiles = (_checks.whole(name, self.attributes[name]) for name in ("columns", "tiles"))
            if not 1 <= rows * self.columns * ARRAYS["data"].itemsize <= _MOST_TILE or not 1 <= self.tiles <= _MOST_TILES:
                found = f"found {self.tiles} tiles of {rows} x {self.columns} pixels"
                raise ValueError(f"{found}, expected 1 to {_MOST_TILES} of at most {_MOST_TILE} bytes")
            self._require_headers(rows, mend)
            self._group = zarr.open_group(stores.local(folder), mode="r+", zarr_format=3, use_consolidated=False)
            self.x, self.y = (self._axis(name) for name in "xy")
            self._arrays = {name: self._group[name] for name in ARRAYS}

    def _require_headers(self, rows: int, mend: bool) -> None:
        """Arrays say of themselves what they did; others are told of, or written anew from the strip's numbers."""
        found = _sums_of(self._folder)
        damaged = [name for name in _HEADERS if found[name] != self._sums.get(name)]
        if not damaged:
            return
        if not mend:
            raise ValueError(f"{damaged[0]}: zarr.json: missing, or not as it was written: pysas survey --resume mends it")
        memory: dict[str, Any] = {}
        _create_arrays(_in_memory(memory), rows, self.tiles, self.columns)
        for name in damaged:
            (self._folder / name).mkdir(exist_ok=True)
            with files.replacing(self._folder / name / "zarr.json") as file:
                file.write(memory[f"{name}/zarr.json"].to_bytes())
            self.mended.append(f"{name}/zarr.json")
        self._put_attributes(rows)

    def _put_attributes(self, rows: int) -> None:
        self._sums = _sums_of(self._folder)
        with files.replacing(self._folder / "zarr.json") as file:
            file.write(_zarrs_group_of({**self.attributes, "rows": rows, "headers": self._sums}))

    def _axis(self, name: str) -> FloatArray:
        with blamed(name, "damaged"):
            return np.asarray(self._group[name][...], dtype=np.float64)

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
        with files.replacing(folder / "zarr.json") as file:
            file.write(_group_of(record))

    def record(self, tile: int) -> dict[str, Any] | None:
        """A tile's record; None where it has none or one that is damaged."""
        folder = self._folder / _RECORDS / str(tile)
        try:
            stores.require_header(folder)
            content = (folder / "zarr.json").read_bytes()
            record = {name: value for name, value in json.loads(content)["attributes"].items() if name != "crc32"}
            known = record.get("state") in (DONE, DARK, FAILED, DAMAGED)
            return record if known and content == _group_of(record) else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def has_record(self, tile: int) -> bool:
        """Whether there is one, damaged or not."""
        return (self._folder / _RECORDS / str(tile) / "zarr.json").exists()

    def forget(self, tile: int) -> None:
        """Take a tile's record away: it has not been made."""
        (self._folder / _RECORDS / str(tile) / "zarr.json").unlink(missing_ok=True)

    def damage(self, tile: int, record: Mapping[str, Any]) -> str | None:
        """What is wrong with the shards of a tile that is done, by its record; reads them whole."""
        for name in ARRAYS:
            try:
                found, expected = self._sum(name, tile), record.get("shards", {}).get(name)
            except FileNotFoundError:
                return f"{name}: missing"
            if found != expected:
                return f"{name}: damaged: found bytes other than were written, by their number or CRC-32"
        return None

    def whole(self, tile: int, record: Mapping[str, Any]) -> bool:
        """Whether a tile that is done has shards of the size that they were written with, by its record."""
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
        axis, begin = self._group["x"], self.x.size
        axis.resize((x.size,))
        axis[begin:] = x[begin:]
        self.x, self.tiles = x, x.size // self.columns
        self.attributes = {**attributes, "columns": self.columns, "tiles": self.tiles}
        self._put_attributes(self.y.size)

    def parts(self) -> Iterator[Path]:
        """Files that killed processes left half-written."""
        for name in ("", "x", "y", *ARRAYS):
            for pattern in ("*.partial", ".pysas-*"):
                yield from (self._folder / name).glob(pattern)
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

    `mend` writes the headers of their arrays anew where these are damaged.
    """

    def __init__(self, path: str | os.PathLike[str], *, mend: bool = False) -> None:
        self.path, self._mend = files.name(path), mend
        stores.require(self.path)
        folder = Path(self.path)
        with self._blamed():
            self.mended: list[str] = []
            self.header = _attributes_of(folder, self.mended if mend else None)
            if (schema := self.header.get("schema")) != SCHEMA:
                raise ValueError(f"schema: found {schema!r:.60}, expected {SCHEMA!r}")
            names = self.header["strips"]
            if not isinstance(names, list) or not all(isinstance(name, str) and name.isprintable() for name in names):
                raise ValueError(f"strips: found {names!r:.60}, expected names")
            if any(Path(name).name != name or name.startswith(".") for name in names):
                raise ValueError(f"strips: found {names!r:.60}, expected names of groups of this one")
            self.names: list[str] = names

    @contextlib.contextmanager
    def _blamed(self) -> Iterator[None]:
        """Whatever is said of wrong attributes, as a ValueError that names the store."""
        try:
            yield
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{self.path}: {f'{error} missing' if isinstance(error, KeyError) else error}") from error

    @functools.cached_property
    def strips(self) -> list[StripStore]:
        """All of them."""
        return [self.strip(number) for number in range(len(self.names))]

    def strip(self, number: int) -> StripStore:
        """One of them, opened."""
        with self._blamed():
            return StripStore(Path(self.path) / self.names[number], mend=self._mend)


def create(folder: Path, header: Mapping[str, Any], strips: Sequence[StripHeader]) -> None:
    """A new store in a folder that is not there yet; tiles have no pixels and no records."""
    root = stores.library().create_group(stores.local(folder), zarr_format=3, overwrite=False)
    for strip in strips:
        rows, tiles = strip.y.size, strip.x.size // strip.columns
        group = root.create_group(strip.name)
        _create_arrays(group, rows, tiles, strip.columns)
        group["x"][...], group["y"][...] = strip.x, strip.y
        numbers = {"columns": strip.columns, "tiles": tiles, "rows": rows, "headers": _sums_of(folder / strip.name)}
        (folder / strip.name / "zarr.json").write_bytes(_zarrs_group_of({**strip.attributes, **numbers}))
    names = [strip.name for strip in strips]
    (folder / "zarr.json").write_bytes(_zarrs_group_of({**header, "schema": SCHEMA, "strips": names}))


def _attributes_of(folder: Path, mended: list[str] | None) -> dict[str, Any]:
    """Attributes of a group, as they were written; what else its header says is written anew where it is not, if `mended`."""
    stores.require_header(folder)
    group = json.loads((folder / "zarr.json").read_bytes())
    attributes = dict(group.pop("attributes", {}))
    if attributes.get("schema", SCHEMA) != SCHEMA:
        return attributes  # of another store
    if "crc32" not in attributes:
        raise ValueError("zarr.json: damaged: found attributes without their CRC-32")
    stores.require_sum(attributes)
    del attributes["crc32"]
    group.pop("consolidated_metadata", None)
    if group != {"zarr_format": 3, "node_type": "group"}:
        if mended is None:
            raise ValueError("zarr.json: damaged: pysas survey --resume mends it")
        with files.replacing(folder / "zarr.json") as file:
            file.write(_zarrs_group_of(attributes))
        mended.append("zarr.json")
    return attributes


def _create_arrays(group: Any, rows: int, tiles: int, columns: int) -> None:
    for name, size, chunk in (("x", tiles * columns, _AXIS), ("y", rows, rows)):
        stores.new_array(group, name, np.dtype(np.float64), (size,), (chunk,), (name,))
    for name, dtype in ARRAYS.items():
        shape, chunks, shards = (rows, tiles * columns), (_inner(rows), columns), (rows, columns)
        stores.new_array(group, name, dtype, shape, chunks, ("y", "x"), shards)
    group.create_group(_RECORDS)


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


def _in_memory(memory: dict[str, Any], **options: Any) -> Any:
    """A group of zarr's, whose files are the items of a dictionary."""
    zarr = stores.library()
    return zarr.create_group(zarr.storage.MemoryStore(memory), zarr_format=3, **options)


def _zarrs_group_of(attributes: Mapping[str, Any]) -> bytes:
    """The zarr.json of a group, as zarr writes it."""
    memory: dict[str, Any] = {}
    _in_memory(memory, attributes=_summed(attributes))
    return bytes(memory["zarr.json"].to_bytes())


def _sums_of(folder: Path) -> dict[str, int]:
    """Checksums of the headers in a strip."""
    return {name: _sum_of(folder / name / "zarr.json") for name in _HEADERS}


def _sum_of(path: Path) -> int:
    """CRC-32 of a header; -1 where there is none."""
    try:
        stores.require_header(path.parent)
        return zlib.crc32(path.read_bytes())
    except ValueError:
        return -1


def _group_of(record: Mapping[str, Any]) -> bytes:
    """The zarr.json of a record."""
    group = {"attributes": _summed(record), "zarr_format": 3, "node_type": "group"}
    return json.dumps(group, indent=1, sort_keys=True).encode()


def _summed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes with their checksum."""
    return {**attributes, "crc32": stores.sum_of(attributes)}


def _inner(rows: int) -> int:
    """Rows of an inner chunk, which divide a tile's."""
    least, most = _ROWS
    return next((rows // many for many in range(-(-rows // most), rows // least + 1) if rows % many == 0), rows)
