"""Variables of MATLAB's files of versions 5 to 7 (MathWorks, "MAT-File Format", level 5).

`scipy.io.loadmat` reads them too, but ends the process by a segmentation fault where a damaged file names a type of data that
does not exist (SciPy 1.17). Here nothing is expanded beyond what a variable may hold, and every error names the file.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from pysas._checks import FloatArray
from pysas.formats import files
from pysas.formats.fields import Array, File, allocated, blamed

_HEADER, _VERSION = 128, 0x0100
_MATRIX, _COMPRESSED = 14, 15
_ENTRIES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_CLASSES = range(6, 16)  # double, single, integers of 8 to 64 bits
_COMPLEX, _LOGICAL = 0x0800, 0x0200
_TEXT = 4
_NUMBERS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_LETTERS = {1: "ascii", 2: "ascii", 4: "utf-16", 16: "utf-8", 17: "utf-16"}  # types of text
_MOST_EXPANSION = 1032  # deflate cannot expand by more ("Maximum Compression Factor", zlib technical details)
_MOST = 2**24  # numbers of a variable: a pulse of half a minute
_HEAD = 2**12  # bytes of a variable that tell its name


def read_mat(path: str, name: str) -> FloatArray:
    """A real variable of a .mat file (`save -v7` or before), as one row of numbers.

    Raises
    ------
    ValueError
        A damaged file, one of another version, a variable that is not there, is no real number or has two long axes.
    OSError
        From the file system.

    Notes
    -----
    O(file) time and memory.
    """
    with files.opened(path) as file:
        content = file.read()
    with files.naming(path):
        order = _order(content[:_HEADER])
    found: list[str] = []
    try:
        for kind, element in _elements(memoryview(content)[_HEADER:], order):
            if kind not in (_MATRIX, _COMPRESSED):
                continue
            _, _, (_, title) = _parts(kind, element, order, 3, _HEAD)
            found.append(bytes(title).decode("ascii", "replace"))
            if found[-1] == name:
                return _numbers(_parts(kind, element, order, 4, _HEAD + 8 * _MOST), order)
    except (ValueError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}{f', {found[-1]:.60}' if found else ''}: {error}") from None
    raise ValueError(f"{path}: no variable {name!r:.60}: expected one of {', '.join(found)}")


def is_mat(head: bytes) -> bool:
    """Whether a file that begins so is one of versions 5 to 7."""
    try:
        _order(head[:_HEADER])
    except ValueError:
        return False
    return True


class Variables(File):
    """The variables of a .mat file as named arrays: numbers of any shape, text, and what is neither as fields of objects.

    Shapes are MATLAB's, of two axes or more, those of text (). Errors are ValueErrors without the file's name. Takes the memory
    of the file; a compressed variable is expanded when it is read, and its Adler-32 compared.
    """

    def __init__(self, path: str) -> None:
        with files.opened(path) as file:
            content = file.read()
        self.fields, self.pairs, self._followed = {}, {}, {}
        self._order = _order(content[:_HEADER])
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._elements: dict[str, tuple[int, memoryview]] = {}
        try:
            for kind, element in _elements(memoryview(content)[_HEADER:], self._order):
                if kind not in (_MATRIX, _COMPRESSED):
                    raise ValueError(f"found an element of type {kind}: expected a variable")
                (_, flags), (_, shape), (_, title) = _parts(kind, element, self._order, 3, _HEAD)
                name = bytes(title).decode("ascii")
                if name in self.fields:
                    raise ValueError(f"{name}: found twice, expected one variable of that name")
                with blamed(name):
                    self._describe(name, flags, shape, kind, len(element))
                self._elements[name] = kind, element
        except (struct.error, zlib.error) as error:
            raise ValueError(f"found no variable after {', '.join(self.fields)}: {error}") from None

    def _describe(self, name: str, flags: memoryview, shape: memoryview, kind: int, length: int) -> None:
        word = struct.unpack(f"{self._order}I", flags[:4])[0]
        code, two = word & 0xFF, bool(word & _COMPLEX)
        if code not in _NUMBERS and code != _TEXT:
            self.fields[name] = (0,), np.dtype(object)
            return
        lengths: tuple[int, ...] = tuple(np.frombuffer(shape, f"{self._order}i4").tolist())
        most = length * (_MOST_EXPANSION if kind == _COMPRESSED else 1)
        if len(lengths) < 2 or min(lengths) < 0 or math.prod(lengths) * (1 + two) > most:
            raise ValueError(f"found shape {lengths} in {length} bytes: expected a whole .mat file")
        self._shapes[name] = lengths
        if code == _TEXT:
            self.fields[name] = (), np.dtype("U")
            return
        dtype = np.dtype("?") if word & _LOGICAL else np.dtype(_NUMBERS[code])
        self.fields[name] = lengths, np.result_type(dtype, np.complex64) if two else dtype

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        """Entries lie as MATLAB's do, the first index fastest; `shape` may be another of as many."""
        if dtype.hasobject:
            raise ValueError(f"{name}: found a cell, a struct or the like, expected numbers or text")
        kind, element = self._elements[name]
        declared, two = self._shapes[name], dtype.kind == "c"
        count = math.prod(declared)
        with blamed(name):
            if kind == _COMPRESSED:
                element = _expanded(element, self._order, 2 * _HEAD + 8 * count * (1 + two))
            parts = list(_elements(element, self._order))
            if len(parts) != 4 + two:
                raise ValueError(f"found {len(parts)} parts of a variable: expected {4 + two}")
            if dtype.kind == "U":
                return np.asarray(_letters(declared, self._order, *parts[3]))
            array = allocated(name, (count,), dtype)
            for part, target in zip(parts[3:], (array.real, array.imag) if two else (array,), strict=True):
                target[...] = _entries(part, self._order, count)
        return array.reshape(shape, order="F")


def _order(head: bytes) -> str:
    order = {b"IM": "<", b"MI": ">"}.get(head[126:_HEADER])
    if order is None or struct.unpack(f"{order}H", head[124:126])[0] != _VERSION:
        raise ValueError("expected a .mat file of MATLAB's versions 5 to 7 (save -v7)")
    return order


def _expanded(element: memoryview, order: str, most: int) -> memoryview:
    """What a compressed variable holds, all of it, with its checksum compared."""
    stream = zlib.decompressobj()
    try:
        data = memoryview(stream.decompress(element, most))
    except zlib.error as error:
        raise ValueError(f"damaged ({error})") from None
    if not stream.eof or stream.unused_data:
        raise ValueError("found another number of bytes than its shape says: expected a whole .mat file")
    if len(data) < 8 or struct.unpack(f"{order}II", data[:8]) != (_MATRIX, len(data) - 8):
        raise ValueError("found no variable in a compressed element: expected a whole .mat file")
    return data[8:]


def _entries(part: tuple[int, memoryview], order: str, count: int) -> Array:
    kind, data = part
    entry = np.dtype(f"{order}{_ENTRIES.get(kind, 'V1')}")
    if entry.kind == "V" or len(data) != count * entry.itemsize:
        raise ValueError(f"found {len(data)} bytes of type {kind} for {count} numbers: expected a whole .mat file")
    return np.frombuffer(data, entry)


def _letters(shape: tuple[int, ...], order: str, kind: int, data: memoryview) -> str:
    coding, count = _LETTERS.get(kind), math.prod(shape)
    if coding is None or shape[1:] != (count,):
        raise ValueError(f"found text of type {kind} and shape {shape}: expected one line of it")
    if coding == "utf-16":
        coding += "-le" if order == "<" else "-be"
    text = bytes(data).decode(coding)
    if len(text) != count:
        raise ValueError(f"found {len(text)} letters for {count}: expected a whole .mat file")
    return text


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Types and data of elements, one after another."""
    while data:
        kind, size = struct.unpack(f"{order}II", data[:8])
        start, end = 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
        if kind >> 16:  # a small one: its size beside its type, its data in place of the size
            kind, size, start, end = kind & 0xFFFF, kind >> 16, 4, 8
        if start + size > min(len(data), end):
            raise ValueError(f"found {len(data) - start} of {size} bytes: expected a whole .mat file")
        yield kind, data[start : start + size]
        data = data[end:]


def _parts(kind: int, element: memoryview, order: str, count: int, most: int) -> list[tuple[int, memoryview]]:
    """The first elements of a variable: flags, shape, name, numbers. Of a compressed one `most` bytes are looked at."""
    if kind == _COMPRESSED:
        element = memoryview(zlib.decompressobj().decompress(element, most))[8:]
    found = list(itertools.islice(_elements(element, order), count))
    if len(found) < count:
        raise ValueError(f"found {len(found)} parts of a variable: expected {count}")
    return found


def _numbers(parts: list[tuple[int, memoryview]], order: str) -> FloatArray:
    (_, flags), (_, shape), _, data = parts
    word = struct.unpack(f"{order}I", flags[:4])[0]
    lengths = np.frombuffer(shape, f"{order}i4").tolist()
    count = math.prod(lengths)
    if word & 0xFF not in _CLASSES or word & _COMPLEX or not 0 < count == max(lengths, default=0) <= _MOST:
        text = f"found class {word & 0xFF}{', complex' if word & _COMPLEX else ''} of shape {tuple(lengths)}"
        raise ValueError(f"{text}: expected real numbers (6 to 15) in one row or column")
    return _entries(data, order, count).astype(np.float64)
