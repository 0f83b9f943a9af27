"""Numbers from MATLAB's files of versions 5 to 7 (MathWorks, "MAT-File Format", level 5).

`scipy.io.loadmat` reads them too, but ends the process by a segmentation fault where a damaged file names a type of data that
does not exist (SciPy 1.17). Here nothing is expanded beyond what a variable may hold, and every error names the file.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from pysas._checks import FloatArray
from pysas.formats import files

_HEADER, _VERSION = 128, 0x0100
_MATRIX, _COMPRESSED = 14, 15
_ENTRIES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_CLASSES = range(6, 16)  # double, single, integers of 8 to 64 bits
_COMPLEX = 0x0800
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
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER])
    if order is None or struct.unpack(f"{order}H", content[124:126])[0] != _VERSION:
        raise ValueError(f"{path}: expected a .mat file of MATLAB's versions 5 to 7 (save -v7)")
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
    (_, flags), (_, shape), _, (kind, data) = parts
    word = struct.unpack(f"{order}I", flags[:4])[0]
    lengths = np.frombuffer(shape, f"{order}i4").tolist()
    count = math.prod(lengths)
    if word & 0xFF not in _CLASSES or word & _COMPLEX or not 0 < count == max(lengths, default=0) <= _MOST:
        text = f"found class {word & 0xFF}{', complex' if word & _COMPLEX else ''} of shape {tuple(lengths)}"
        raise ValueError(f"{text}: expected real numbers (6 to 15) in one row or column")
    entry = np.dtype(f"{order}{_ENTRIES.get(kind, 'V1')}")
    if entry.kind == "V" or len(data) != count * entry.itemsize:
        raise ValueError(f"found {len(data)} bytes of type {kind} for {count} numbers: expected a whole .mat file")
    return np.frombuffer(data, entry).astype(np.float64)
