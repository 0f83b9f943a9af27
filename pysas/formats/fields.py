"""Named arrays of an open file, whatever container they lie in: what is declared, and whether it is what a schema wants."""

from __future__ import annotations

import contextlib
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray

Array = npt.NDArray[Any]

KINDS = {  # what an error says, and dtypes without byte order
    "samples": ("complex64 or complex128", ("c8", "c16")), "real": ("float64", ("f8",)), "bool": ("bool", ("b1",)),
    "whole": ("int64 or int32", ("i8", "i4")),
    "truth": ("float64 or complex128", ("f8", "c16")), "text": ("a string", ()), "flag": ("bool or uint8", ("b1", "u1")),
}  # fmt: skip


@contextlib.contextmanager
def blamed(name: str, what: str = "") -> Iterator[None]:
    """Whatever zipfile, zlib, numpy and h5py say of wrong bytes, as a ValueError that names the field."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        said = str(error) or type(error).__name__
        raise ValueError(f"{name}: {what} ({said})" if what else f"{name}: {said}") from error


def allocated(name: str, shape: tuple[int, ...], dtype: np.dtype[Any], order: Any = "C") -> Array:
    try:
        return np.empty(shape, dtype=dtype, order=order)
    except MemoryError:
        size = math.prod(shape) * dtype.itemsize
        raise MemoryError(f"{name}: no memory for {size / 2**20:.0f} MiB, {dtype} of shape {shape}") from None


def bytes_of(array: Array) -> Array:
    """The bytes of a contiguous array, not copied."""
    return array.reshape(-1, order="A").view(np.uint8) if array.nbytes else np.empty(0, dtype=np.uint8)


@dataclass(frozen=True)
class Streamed:
    """An array that is given block by block along its first axis, in C order, as often as it is asked for."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    blocks: Callable[[], Iterable[Array]]

    ndim = property(lambda self: len(self.shape))
    size = property(lambda self: math.prod(self.shape))
    nbytes = property(lambda self: self.size * self.dtype.itemsize)


class File:
    """An open file: `fields` gives the shape and dtype that each field declares, found to agree with its bytes."""

    fields: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]
    pairs: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]  # what fields declare that are taken as complex
    _followed: dict[str, tuple[int, int]]  # fields that are read in order: how far, and the CRC-32 until there

    def read(self, name: str) -> Array:
        """The field's entries."""
        if name not in self.pairs:
            return self._read(name, *self.fields[name])
        parts = np.ascontiguousarray(self._read(name, *self.pairs[name]))
        return np.asarray(parts.view(self.fields[name][1])[..., 0])

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        raise NotImplementedError

    def rows(self, name: str, first: int, last: int) -> Array:
        """The field's entries first to last - 1 along its first axis; nothing else of it is read.

        A checksum of the whole field is compared once it has been read from its first entry to its last, in order.
        """
        shape, dtype = self.pairs.get(name, self.fields[name])
        array = self._rows(name, first, (last - first, *shape[1:]), dtype)
        follows, begun = self._followed.get(name, (0, 0))
        if first in (0, follows) and (known := self._checksums(name)) is not None:
            found = zlib.crc32(bytes_of(array).data, begun if first else known[0])
            if last == shape[0] and found != known[1]:
                raise ValueError(f"{name}: damaged: found other bytes than were written, by their CRC-32")
            self._followed[name] = last, found
        return np.asarray(array.view(self.fields[name][1])[..., 0]) if name in self.pairs else array

    def _rows(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        raise NotImplementedError

    def _checksums(self, name: str) -> tuple[int, int] | None:
        """CRC-32 of what comes before the field's first entry, and after its last."""
        return None

    def reads_rows(self, name: str) -> bool:
        """Whether `rows` can read the field without what lies before."""
        return True

    def take_pairs(self, names: Iterable[str]) -> None:
        """Take real fields of these names as complex whose last axis is real and imaginary part, as some programs write."""
        for name in names:
            shape, dtype = self.fields.get(name, ((), np.dtype(object)))
            if dtype.kind == "f" and len(shape) > 1 and shape[-1] == 2:
                self.pairs[name] = shape, dtype
                self.fields[name] = shape[:-1], np.dtype(f"{dtype.str[0]}c{2 * dtype.itemsize}")

    def text(self, name: str) -> str:
        """A string field."""
        self.check({name: ("text", "")}, [name])
        value = self.read(name).reshape(-1)[0]
        try:
            return value.decode("utf-8") if isinstance(value, bytes) else str(value)
        except UnicodeDecodeError:
            raise ValueError(f"{name}: found {value!r:.60}, expected UTF-8 text") from None

    def reals(self, name: str) -> FloatArray:
        """Real numbers of any type, as float64."""
        if name not in self.fields or self.fields[name][1].kind not in "iuf":
            raise ValueError(f"{name}: missing, expected real numbers")
        return self.read(name).astype(np.float64)

    def row(self, name: str) -> FloatArray:
        """The same (n,), of one axis that is longer than 1 at most: files of MATLAB have no axis alone."""
        array = self.reals(name)
        if array.size == 0 or array.size != max(array.shape, default=1):
            raise ValueError(f"{name}: found shape {array.shape}, expected one row")
        return array.reshape(-1)

    def together(self, names: tuple[str, ...]) -> bool:
        """Whether a group of fields is there; part of one is an error."""
        missing = [name for name in names if name not in self.fields]
        if 0 < len(missing) < len(names):
            there = next(name for name in names if name in self.fields)
            raise ValueError(f"{missing[0]}: missing, expected beside {there}")
        return not missing

    def check(self, table: Mapping[str, tuple[str, ...]], needed: Iterable[str]) -> None:
        """Presence, dtypes and shapes, against the schema and each other; nothing is read."""
        for name in needed:
            if name not in self.fields:
                raise ValueError(f"{name}: missing, expected {KINDS[table[name][0]][0]}")
        sizes: dict[str, int] = {}
        for name, (kind, *shapes) in sorted(table.items(), key=lambda item: item[0] != "data"):
            if name not in self.fields:
                continue
            shape, dtype = self.fields[name]
            if not (dtype.kind in "US" and math.prod(shape) == 1 if kind == "text" else dtype.str[1:] in KINDS[kind][1]):
                raise ValueError(f"{name}: found {dtype} of shape {shape}, expected {KINDS[kind][0]}")
            if kind == "text":
                continue
            for words in map(str.split, shapes):
                wanted = [int(word) if word.isdigit() else sizes.get(word, n) for word, n in zip(words, shape, strict=False)]
                if len(words) == len(shape) and tuple(wanted) == shape:
                    sizes |= {word: n for word, n in zip(words, shape, strict=True) if not word.isdigit()}
                    break
            else:
                known = [" ".join(f"{w}={sizes[w]}" if w in sizes else w for w in words.split()) for words in shapes]
                text = " or ".join(f"({one.replace(' ', ', ')}{',' * (one != '' and ' ' not in one)})" for one in known)
                raise ValueError(f"{name}: found shape {shape}, expected {text}")
