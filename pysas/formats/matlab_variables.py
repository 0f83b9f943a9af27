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
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.formats import files
from pysas.formats.fields import Array, File, allocated, blamed

# numbers of any shape, structures within, or None for what is neither
Structure = dict[str, "npt.NDArray[Any] | Structure | None"]

_HEADER, _VERSION = 128, 0x0100
_MATRIX, _COMPRESSED = 14, 15
_ENTRIES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_COMPLEX, _LOGICAL = 0x0800, 0x0200
_STRUCTURE, _TEXT, _OPAQUE = 2, 4, 17  # classes; the last is of MATLAB's own objects, tables and strings among them
_NUMBERS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_LETTERS = {1: "ascii", 2: "ascii", 4: "utf-16", 16: "utf-8", 17: "utf-16"}  # types of text
_MOST_EXPANSION = 1032  # deflate cannot expand by more ("Maximum Compression Factor", zlib technical details)
_MOST_ROW = 2**24  # numbers of a pulse: half a minute
_MOST_STRUCTURE = 2**30  # bytes, where they are compressed
_HEAD = 2**12  # bytes of a variable that tell its name
_LONGEST = 64  # characters of a field's name, and the zero after it
_DEEPEST = 4  # structures within structures
_SHOWN = 2**10


def read_row(path: str, name: str) -> FloatArray:
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
    with files.naming(path):
        shape, dtype = (found := _with(path, name)).fields[name]
        if dtype.kind not in "biuf" or not 0 < math.prod(shape) == max(shape) <= _MOST_ROW:
            raise ValueError(f"{name}: found {_told(shape, dtype)}: expected real numbers in one row or column")
        return found.read(name).reshape(-1).astype(np.float64)


def read_structure(path: str, name: str) -> Structure:
    """A structure of a .mat file (`save -v7` or before), alone and not in an array; texts and cells in it are passed over.

    Raises
    ------
    ValueError
        A damaged file, one of another version, no such variable, or one that is no structure; names the file.
    OSError
        From the file system.

    Notes
    -----
    O(file) time and memory; fields keep the types that they have in MATLAB, single and double among them.
    """
    with files.naming(path):
        return _with(path, name).structure(name)


def shows_structure(head: bytes, fields: set[str]) -> bool:
    """Whether the first variable of a file, of which these are the first bytes, has fields of these names."""
    packed = head[_HEADER : _HEADER + 4] in (b"\x0f\0\0\0", b"\0\0\0\x0f")
    try:
        text = zlib.decompressobj().decompress(head[_HEADER + 8 :], _SHOWN) if packed else head[_HEADER:]
    except zlib.error:
        return False
    return all(name.encode() + b"\0" in text for name in fields)


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
                word = struct.unpack(f"{self._order}I", flags[:4])[0]
                if word & 0xFF == _OPAQUE:  # which has no shape
                    title = shape
                name = bytes(title).decode("ascii")
                if not name:  # what MATLAB keeps of objects for itself
                    continue
                if name in self.fields:
                    raise ValueError(f"{name}: found twice, expected one variable of that name")
                with blamed(name):
                    self._describe(name, word, shape, kind, len(element))
                self._elements[name] = kind, element
        except (struct.error, zlib.error) as error:
            raise ValueError(f"found no variable after {', '.join(self.fields)}: {error}") from None

    def _describe(self, name: str, word: int, shape: memoryview, kind: int, length: int) -> None:
        code, two = word & 0xFF, bool(word & _COMPLEX)
        if code not in _NUMBERS and code != _TEXT:
            self.fields[name] = (0,), np.dtype(object)
            return
        lengths: tuple[int, ...] = tuple(np.frombuffer(shape, f"{self._order}i4").tolist())
        most = length * (_MOST_EXPANSION if kind == _COMPRESSED else 1)
        if len(lengths) < 2 or min(lengths) < 0 or math.prod(lengths) * (1 + two) > most:
            raise ValueError(f"found shape {lengths} in {length} bytes: expected a whole .mat file")
        self._shapes[name] = lengths
        self.fields[name] = ((), np.dtype("U")) if code == _TEXT else (lengths, _type(word))

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        """Entries lie as MATLAB's do, the first index fastest; `shape` may be another of as many."""
        if dtype.hasobject:
            raise ValueError(f"{name}: found a cell, a struct or the like, expected numbers or text")
        declared = self._shapes[name]
        with blamed(name):
            parts = list(_elements(self._content(name, 2 * _HEAD + 16 * math.prod(declared)), self._order))[3:]
            if dtype.kind == "U":
                if len(parts) != 1:
                    raise ValueError(f"found text in {len(parts)} parts: expected one")
                return np.asarray(_letters(declared, self._order, *parts[0]))
            return _array(name, parts, self._order, math.prod(declared), dtype).reshape(shape, order="F")

    def structure(self, name: str) -> Structure:
        """A structure that stands alone, with the numbers and the structures in it."""
        if self.fields[name][1].hasobject:
            with blamed(name):
                value = _value(self._content(name, _MOST_STRUCTURE), self._order, 0)
            if isinstance(value, dict):
                return value
        raise ValueError(f"{name}: found {_told(*self.fields[name])}: expected a structure")

    def _content(self, name: str, most: int) -> memoryview:
        """Flags, shape, name and what follows; of a compressed variable `most` bytes, with its checksum compared."""
        kind, element = self._elements[name]
        return _expanded(element, self._order, most) if kind == _COMPRESSED else element


def _with(path: str, name: str) -> Variables:
    """The variables of a file that has this one."""
    found = Variables(path)
    if name not in found.fields:
        raise ValueError(f"no variable {name!r:.60}: expected one of {', '.join(found.fields):.300}")
    return found


def _told(shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    return "text" if dtype.kind == "U" else "no numbers" if dtype.hasobject else f"{dtype} of shape {shape}"


def _order(head: bytes) -> str:
    order = {b"IM": "<", b"MI": ">"}.get(head[126:_HEADER])
    if order is None or struct.unpack(f"{order}H", head[124:126])[0] != _VERSION:
        raise ValueError("expected a .mat file of MATLAB's versions 5 to 7 (save -v7)")
    return order


def _expanded(element: memoryview, order: str, most: int) -> memoryview:
    """What a compressed variable holds behind its own type and size, all of it, with its checksum compared."""
    stream = zlib.decompressobj()
    try:
        kind, size = struct.unpack(f"{order}II", stream.decompress(element, 8))
        if kind != _MATRIX or size > most:
            raise ValueError(f"found type {kind} of {size} bytes: expected a variable of at most {most}")
        data = stream.decompress(stream.unconsumed_tail, size + 1)
    except (struct.error, zlib.error) as error:
        raise ValueError(f"damaged ({error})") from None
    if len(data) != size or not stream.eof or stream.unused_data:
        raise ValueError(f"found {len(data)} bytes of a variable, or more: expected {size}")
    return memoryview(data)


def _type(word: int) -> np.dtype[Any]:
    """The type of numbers, by the flags of their variable."""
    dtype = np.dtype("?") if word & _LOGICAL else np.dtype(_NUMBERS[word & 0xFF])
    return np.result_type(dtype, np.complex64) if word & _COMPLEX else dtype


def _array(name: str, parts: list[tuple[int, memoryview]], order: str, count: int, dtype: np.dtype[Any]) -> Array:
    """`count` numbers, from the parts of a variable that hold the real ones and, of complex ones, the imaginary ones.

    MATLAB keeps them in any type that holds their values, whole ones in integers.
    """
    two = dtype.kind == "c"
    if len(parts) != 1 + two:
        raise ValueError(f"found {len(parts)} parts of {dtype} numbers: expected {1 + two}")
    kept = [_entries(part, order, count) for part in parts]
    array = allocated(name, (count,), dtype)
    for target, entries in zip((array.real, array.imag) if two else (array,), kept, strict=True):
        with np.errstate(invalid="ignore", over="ignore"):
            target[...] = entries
        if not np.array_equal(target, entries, equal_nan=entries.dtype.kind == target.dtype.kind == "f"):
            raise ValueError(f"found numbers of {entries.dtype} that are none of a variable of {dtype}")
    return array


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


def _value(element: memoryview, order: str, depth: int) -> npt.NDArray[Any] | Structure | None:
    """What a field or a variable holds: numbers, or the fields of a structure."""
    parts = _elements(element, order)
    head = list(itertools.islice(parts, 3))
    if len(head) < 3 or len(head[0][1]) < 8:
        raise ValueError("found a variable without flags, shape and name")
    word = struct.unpack(f"{order}I", head[0][1][:4])[0]
    code = word & 0xFF
    if code not in _NUMBERS and (code != _STRUCTURE or depth == _DEEPEST):
        return None
    lengths = np.frombuffer(head[1][1], f"{order}i4").tolist()
    if len(lengths) < 2 or min(lengths) < 0:
        raise ValueError(f"found a variable of shape {tuple(lengths)}")
    if code in _NUMBERS:
        return _array("numbers", list(parts), order, math.prod(lengths), _type(word)).reshape(lengths, order="F")
    if math.prod(lengths) != 1:
        return None
    sizes, names = (bytes(part) for _, part in itertools.islice(parts, 2))
    size = struct.unpack(f"{order}I", sizes[:4])[0]
    if not 1 < size <= _LONGEST or len(names) % size:
        raise ValueError(f"found names of {size} characters in {len(names)}")
    titles = [names[at : at + size].split(b"\0")[0].decode("ascii", "replace") for at in range(0, len(names), size)]
    fields = [part for kind, part in parts if kind == _MATRIX]
    if len(fields) != len(titles) or len(set(titles)) != len(titles):
        raise ValueError(f"found {len(fields)} values of fields {', '.join(titles):.200}")
    return {title: _value(field, order, depth + 1) if len(field) else None for title, field in zip(titles, fields, strict=True)}
