"""The third container of named arrays: a Zarr v3 group in a folder, to which pings are appended and from which some are read.

Numbers and text are attributes of the group, arrays are arrays of it, in chunks of whole pings. Zarr takes a chunk that is
missing for zeros and allocates what a chunk claims to hold: here each one's file is looked at first. A chunk carries its
CRC-32C, the attributes their CRC-32 in attribute "crc32" (stores without it are read all the same).

A store grows safely: attribute "pings" tells how many pings are whole, is written after them, and Zarr gives each file its
name when it is complete. Whatever ends a writer, its store holds the pings before.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import secrets
import shutil
import stat
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks
from pysas.formats import files
from pysas.formats.fields import Array, File, allocated, blamed

SUFFIX = ".zarr"
HOLDS = {  # schemas of stores
    "echoes": "pysas-echoes-1", "images": "pysas-survey-1", "mosaics": "pysas-mosaic-1", "single images": "pysas-cf-image-1",
}  # fmt: skip
PING = "ping"
Named = Mapping[str, tuple[tuple[str, ...], Array]]  # arrays with the names of their axes

_CHUNK_BYTES = 2**21  # a chunk holds so many bytes, or one ping
_CHUNK_PINGS = 128  # and at most so many: 1200 files an array for 150,000 pings, of which one is written again a ping
_MOST_CHUNK = 2**28
_MOST_HEADER = 2**26
MOST_COUNT = 32767  # of int16
_CODECS = ["bytes", "crc32c"]
_OWN = ("pings", "complete", "crc32")


class Store(File):
    """A group opened for reading: what of it was whole at that moment.

    Attributes
    ----------
    complete : bool
        False: a writer adds pings to it, or was ended.
    counts : bool
        Samples are stored as int16.
    chunk : int
        Pings in a chunk of samples.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(os.path.realpath(folder))
        self._opened = os.stat(self._folder)
        self.fields, self.pairs, self._followed = {}, {}, {}
        self._arrays: dict[str, Any] = {}
        self._values: dict[str, Any] = {}
        self.counts, self.chunk = False, 1
        group = open_group(self._folder)
        header = dict(group.attrs)
        require_sum(header)
        for name, value in header.items():
            if name not in _OWN:
                self._values[name] = value
                self.fields[name] = _declared(value)
        pings = header.get("pings")
        if pings is not None and (type(pings) is not int or pings < 1):
            raise ValueError(f"pings: found {pings!r:.60}, expected a whole number >= 1")
        self.complete = header.get("complete", True)
        if type(self.complete) is not bool:
            raise ValueError(f"complete: found {self.complete!r:.60}, expected true or false")
        for entry in sorted(os.scandir(self._folder), key=lambda entry: entry.name):
            if not entry.name.startswith(".") and entry.is_dir():
                with blamed(entry.name):
                    self._describe(group, entry.name, pings)
        self._take_counts()

    def _describe(self, group: Any, name: str, pings: int | None) -> None:
        if name in self._values:
            raise ValueError("found as an attribute and as an array, expected one of the two")
        require_header(self._folder / name)
        array = group[name]
        if not hasattr(array, "chunks"):
            self.fields[name] = (0,), np.dtype(object)  # a group: no field of ours looks like that
            return
        shape, chunks = tuple(array.shape), tuple(array.chunks)
        codecs = [codec["name"] for codec in array.metadata.to_dict()["codecs"]]
        if codecs != _CODECS:
            raise ValueError(f"found codecs {', '.join(codecs)}, expected {', '.join(_CODECS)}")
        if array.dtype.kind not in "fciub" or chunks[:1] in ((), (0,)) or chunks[1:] != tuple(max(n, 1) for n in shape[1:]):
            raise ValueError(
                f"found {array.dtype} of shape {shape} in chunks of {chunks}, expected numbers, whole along axis 0"
            )
        if math.prod(chunks) * array.dtype.itemsize > _MOST_CHUNK:
            raise ValueError(f"found chunks of {chunks}, expected at most {_MOST_CHUNK} bytes each")
        if pings is not None and (name == "data" or (array.metadata.dimension_names or ("",))[0] == PING):
            if shape[0] < pings:
                raise ValueError(f"found {shape[0]} pings, expected {pings} or more")
            shape = pings, *shape[1:]
        self._arrays[name] = array
        self.fields[name] = shape, array.dtype

    def _take_counts(self) -> None:
        """Take int16 in and quadrature with a scale a ping as complex64."""
        shape, dtype = self.fields.get("data", ((), np.dtype(object)))
        if dtype != np.int16:
            if "data" in self._arrays:
                self.chunk = int(self._arrays["data"].chunks[0])
            return
        if self.fields.get("scale") != (shape[:1], np.dtype(np.float64)) or len(shape) < 3 or shape[-1] != 2:
            found = (
                f"found {self.fields['scale'][1]} of shape {self.fields['scale'][0]}" if "scale" in self.fields else "missing"
            )
            raise ValueError(f"scale: {found}, expected float64 a ping beside data of int16, whose last axis is I and Q")
        self.counts, self.chunk = True, int(self._arrays["data"].chunks[0])
        scale = self._read("scale", *self.fields.pop("scale"))
        with np.errstate(over="ignore", under="ignore"):
            self._scale = scale.astype(np.float32)
            good = (self._scale > 0) & np.isfinite(np.float32(MOST_COUNT) * self._scale)
        if not good.all():
            ping = int(np.argmin(good))
            raise ValueError(f"scale: {scale[ping]:g} at ping {ping}: expected numbers > 0 with samples that float32 holds")
        self.fields["data"] = shape[:-1], np.dtype(np.complex64)

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        if name in self._values:
            with blamed(name):
                return np.asarray(self._values[name], dtype=None if dtype.kind == "U" else dtype)
        return self._rows(name, 0, shape, dtype)

    def _rows(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        if name == "data" and self.counts:
            counts = self._stored(name, first, (*shape, 2), np.dtype(np.int16))
            scale = self._scale[first : first + shape[0]]
            parts = allocated(name, counts.shape, np.dtype(np.float32))
            with np.errstate(over="ignore"):  # -32768 beside the largest float32
                np.multiply(counts, scale.reshape(-1, *[1] * len(shape)), out=parts)
            return np.asarray(parts.view(np.complex64)[..., 0])
        return self._stored(name, first, shape, dtype)

    def _stored(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        try:
            return self._gathered(name, first, shape, dtype)
        finally:
            self._require_same()

    def _require_same(self) -> None:
        """What was read is not of a store that has taken this one's place since."""
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(self._folder), self._opened):
                return
        raise ValueError("found another store than was opened: it was replaced or moved")

    def _gathered(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        stored, last = self._arrays[name], first + shape[0]
        step = stored.chunks[0]
        numbers = range(first // step, -(-last // step)) if math.prod(shape) else range(0)
        for number in numbers:
            with blamed(_chunk(name, number, step)):
                self._require_chunk(stored, name, number)
        array = allocated(name, shape, dtype)
        for number in numbers:
            low, high = max(first, number * step), min(last, (number + 1) * step)
            with blamed(_chunk(name, number, step), "damaged"):
                array[low - first : high - first] = stored[low:high]
        return array

    def _require_chunk(self, stored: Any, name: str, number: int) -> None:
        key = stored.metadata.encode_chunk_key((number,) + (0,) * (len(stored.shape) - 1))
        try:
            found = os.stat(self._folder / name / key)
        except FileNotFoundError:
            raise ValueError("missing") from None
        expected = math.prod(stored.chunks) * stored.dtype.itemsize + 4
        if not stat.S_ISREG(found.st_mode) or found.st_size != expected:
            raise ValueError(f"found {found.st_size} bytes, expected {expected}")


def _chunk(name: str, number: int, step: int) -> str:
    return f"{name}, chunk {number} ({number * step} to {(number + 1) * step - 1} along axis 0)"


def _declared(value: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype of an attribute, in the words of `File.check`."""
    kinds = {str: "U", bool: "?", int: "f8", float: "f8"}
    return ((), np.dtype(kinds[type(value)])) if type(value) in kinds else ((0,), np.dtype(object))


def sum_of(header: Mapping[str, Any]) -> int:
    parts = {name: value for name, value in header.items() if name != "crc32"}
    return zlib.crc32(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode())


def require_sum(header: Mapping[str, Any], where: str = "zarr.json") -> None:
    if "crc32" in header and header["crc32"] != sum_of(header):
        raise ValueError(f"{where}: damaged: found other attributes than were written, by their CRC-32")


def open_group(folder: Path) -> Any:
    """A Zarr v3 group for reading, whose header was looked at first."""
    zarr = library()
    require_header(folder)
    with blamed("zarr.json", "no Zarr v3 group"):
        return zarr.open_group(local(folder, read_only=True), mode="r", zarr_format=3, use_consolidated=False)


def require_header(folder: Path) -> None:
    """A zarr.json of a size that can be read: a pipe would block, a device has no end."""
    try:
        found = os.stat(folder / "zarr.json")
    except FileNotFoundError:
        raise ValueError("zarr.json: missing, expected a Zarr v3 group and its arrays") from None
    if not stat.S_ISREG(found.st_mode) or found.st_size > _MOST_HEADER:
        raise ValueError(f"zarr.json: found {found.st_size} bytes, expected a file of at most {_MOST_HEADER}")


def require(path: str) -> None:
    """Raise what is not the store's fault: no zarr, no folder."""
    library()
    if not stat.S_ISDIR(os.stat(path).st_mode):
        raise ValueError(f"{path}: found a file, expected a folder that holds a Zarr v3 group")


@contextlib.contextmanager
def opened(path: str) -> Iterator[File]:
    """The store of this name; errors do not name it."""
    with contextlib.ExitStack() as stack:
        if hasattr(os, "O_DIRECTORY"):  # held: no other folder gets its number meanwhile
            stack.callback(os.close, os.open(path, os.O_RDONLY | os.O_DIRECTORY))
        yield Store(path)


# Writing


def create(folder: Path, header: Mapping[str, Any], fixed: Named, rows: Named, *, complete: bool) -> None:
    """A new group in an empty folder: attributes, arrays that stay, and the first pings of those that have a row a ping."""
    group = library().create_group(local(folder), zarr_format=3, overwrite=False)
    for name, (axes, array) in {**fixed, **rows}.items():
        row = math.prod(array.shape[1:]) * array.dtype.itemsize
        if row > _MOST_CHUNK:
            raise ValueError(f"{name}: found {row} bytes a ping, expected at most {_MOST_CHUNK}")
        many = max(1, min(_CHUNK_PINGS if name in rows else array.shape[0], _CHUNK_BYTES // row))
        chunks = many, *(max(n, 1) for n in array.shape[1:])
        made = new_array(group, name, array.dtype.newbyteorder("="), array.shape, chunks, axes)
        if array.size:
            made[...] = array
    _put(group, dict(header), next(iter(rows.values()))[1].shape[0], complete)
    require_header(folder)


def new_array(
    group: Any, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], chunks: tuple[int, ...], axes: tuple[str, ...],
    shards: tuple[int, ...] | None = None,
) -> Any:  # fmt: skip
    """An array of a group as all stores have them: chunks, or chunks within shards, with their CRC-32C and nothing else."""
    codecs = library().codecs
    return group.create_array(
        name, shape=shape, dtype=dtype, chunks=chunks, shards=shards, filters=None,
        serializer=codecs.BytesCodec(endian="little"), compressors=[codecs.Crc32cCodec()], fill_value=0, dimension_names=axes,
        chunk_key_encoding={"name": "default", "separator": "."}, config={"write_empty_chunks": True},
    )  # fmt: skip


def _put(group: Any, header: dict[str, Any], pings: int, complete: bool) -> None:
    header |= {"pings": pings, "complete": complete}
    group.update_attributes(header | {"crc32": sum_of(header)})


class Growing:
    """A group that is written to; its arrays are those it was created with."""

    def __init__(self, folder: str) -> None:
        self._group = library().open_group(local(Path(folder)), mode="r+", zarr_format=3, use_consolidated=False)
        require_sum(header := dict(self._group.attrs))
        self._header = {name: value for name, value in header.items() if name not in _OWN}
        if "pings" not in header:
            raise ValueError("pings: missing, expected a store that pysas.EchoWriter wrote")
        self.pings = int(header["pings"])
        self._arrays: dict[str, Any] = {}

    def append(self, rows: Named) -> None:
        """Pings; they count once all of them are written."""
        count = next(iter(rows.values()))[1].shape[0]
        for name, (_, array) in rows.items():
            if name not in self._arrays:
                self._arrays[name] = self._group[name].with_config({"write_empty_chunks": True})
            target = self._arrays[name]
            if target.shape[0] != self.pings + count:  # longer where a writer was ended in the midst of it
                target.resize((self.pings + count, *target.shape[1:]))
            target[self.pings :] = array
        _put(self._group, self._header, self.pings + count, complete=False)
        self.pings += count

    def finish(self) -> None:
        """Tell readers that no ping is to come."""
        _put(self._group, self._header, self.pings, complete=True)


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], *, overwrite: bool, what: str = "echoes") -> Iterator[Path]:
    """The name for a new folder, which takes the place of `path` when the block ends, and is gone when the block fails.

    A killed process leaves a `.pysas-*.part.zarr` beside the target, and the store that was there as `.old` of that name if
    killed between two renames. Only a store that can be told to be one is replaced; the new one has its permissions.
    """
    target = check_output(path, overwrite, what)
    part = target.parent / f".pysas-{os.getpid()}-{secrets.token_hex(4)}.part{SUFFIX}"
    try:
        with writing(path):
            yield part
            if target.exists():
                _exchange(part, check_output(path, overwrite, what))
            else:
                os.rename(part, target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def _exchange(part: Path, target: Path) -> None:
    part.chmod(stat.S_IMODE(target.stat().st_mode))
    old = part.with_name(f"{part.name}.old")
    os.rename(target, old)
    try:
        os.rename(part, target)
    except BaseException:
        os.rename(old, target)
        raise
    shutil.rmtree(old)


@contextlib.contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """What the file system says of a part of a store that is written, as an error that names the store."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, files.name(path)) from error


def check_output(path: str | os.PathLike[str], overwrite: bool, what: str = "echoes") -> Path:
    """Where a store of this name goes, once nothing stands there that must not be replaced: only one of the same holdings."""
    text = files.name(path)
    target = Path(os.path.realpath(text))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{text}: no such folder: {target.parent}")
    if target.exists():
        if (found := schema_of(target)) != HOLDS[what]:
            but = "" if found is None else f" but {found!r:.60}"
            raise ValueError(f"{text}: exists and is no store of {what}{but}: expected a new name")
        if not overwrite:
            raise FileExistsError(f"{text}: exists: expected a new name")
        if not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, "the store is read-only", text)
    return target


def schema_of(folder: Path) -> str | None:
    """What a store says that it holds."""
    try:
        require_header(folder)
        schema = json.loads((folder / "zarr.json").read_bytes())["attributes"]["schema"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return schema if isinstance(schema, str) else None


def local(folder: Path, *, read_only: bool = False) -> Any:
    """A folder of this machine: Zarr takes a name with "::" or "://" for a place in the network."""
    return library().storage.LocalStore(os.path.realpath(folder), read_only=read_only)


def library() -> Any:
    try:
        import zarr
        import zarr.codecs
        import zarr.storage
    except ImportError:
        raise _checks.optional("zarr", "survey") from None
    return zarr
