"""Structures of numbers from MATLAB's files of versions 5 to 7 (MathWorks, "MAT-File Format", level 5).

What `matlab` reads of a variable of numbers, for one of named fields; texts, cells and arrays of structures are passed over.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.formats import files, matlab

# numbers of any shape in float32 or float64, structures within, or None for what is neither
Structure = dict[str, "npt.NDArray[Any] | Structure | None"]
_STRUCTURE, _SINGLE = 2, 7
_LONGEST = 64  # characters of a field's name, and the zero after it
_DEEPEST = 4  # structures within structures
_MOST = 2**30  # bytes of a compressed variable
_SHOWN = 2**10


def shows(head: bytes, fields: set[str]) -> bool:
    """Whether the first variable of a file, of which these are the first bytes, is a structure of these fields."""
    packed = head[128:132] in (b"\x0f\0\0\0", b"\0\0\0\x0f")
    try:
        text = zlib.decompressobj().decompress(head[136:], _SHOWN) if packed else head[128:]
    except zlib.error:
        return False
    return all(name.encode() + b"\0" in text for name in fields)


def read_structure(path: str, name: str) -> Structure:
    """A structure of a .mat file (`save -v7` or before), alone and not in an array.

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
    with files.opened(path) as file:
        content = file.read()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or struct.unpack(f"{order}H", content[124:126])[0] != 0x0100:
        raise ValueError(f"{path}: expected a .mat file of MATLAB's versions 5 to 7 (save -v7)")
    found: list[str] = []
    try:
        for kind, element in matlab._elements(memoryview(content)[128:], order):
            if kind == matlab._COMPRESSED:
                element = memoryview(_expanded(element, order))
            elif kind != matlab._MATRIX:
                continue
            parts = list(itertools.islice(matlab._elements(element, order), 3))
            found.append(bytes(parts[2][1]).decode("ascii", "replace") if len(parts) == 3 else "")
            if found[-1] == name:
                value = _value(element, order, 0)
                if not isinstance(value, dict):
                    raise ValueError("expected a structure")
                return value
    except (ValueError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}{f', {found[-1]:.60}' if found else ''}: {error}") from None
    raise ValueError(f"{path}: no variable {name!r:.60}: expected one of {', '.join(found)}")


def _expanded(element: memoryview, order: str) -> bytes:
    """What a compressed variable holds, behind its own type and size; zlib's checksum is that of the file."""
    unpacking = zlib.decompressobj()
    kind, size = struct.unpack(f"{order}II", unpacking.decompress(element, 8))
    if kind != matlab._MATRIX or size > _MOST:
        raise ValueError(f"found type {kind} of {size} bytes: expected a variable of at most {_MOST}")
    content = unpacking.decompress(unpacking.unconsumed_tail, size + 1)
    if len(content) != size or not unpacking.eof:
        raise ValueError(f"found {len(content)} bytes of a variable, or more: expected {size}")
    return content


def _value(element: memoryview, order: str, depth: int) -> npt.NDArray[Any] | Structure | None:
    """A variable: flags, shape, name, and then its numbers or fields."""
    parts = matlab._elements(element, order)
    head = list(itertools.islice(parts, 3))
    if len(head) < 3 or len(head[0][1]) < 8:
        raise ValueError("found a variable without flags, shape and name")
    (_, flags), (_, shape), _ = head
    word = struct.unpack(f"{order}I", flags[:4])[0]
    lengths = np.frombuffer(shape, f"{order}i4").tolist()
    if len(lengths) < 2 or min(lengths) < 0:
        raise ValueError(f"found a variable of shape {tuple(lengths)}")
    if word & 0xFF in matlab._CLASSES:
        single = word & 0xFF == _SINGLE
        if word & 0xFF > _SINGLE:
            return None  # integers are no part of what is read here
        real = _entries(parts, order, math.prod(lengths), single)
        if word & matlab._COMPLEX:
            values = np.empty(real.size, np.complex64 if single else np.complex128)
            values.real, values.imag = real, _entries(parts, order, real.size, single)
            real = values
        return real.reshape(lengths, order="F")
    if word & 0xFF != _STRUCTURE or math.prod(lengths) != 1 or depth == _DEEPEST:
        return None
    sizes, names = (bytes(part) for _, part in itertools.islice(parts, 2))
    size = struct.unpack(f"{order}I", sizes[:4])[0]
    if not 1 < size <= _LONGEST or len(names) % size:
        raise ValueError(f"found names of {size} characters in {len(names)}")
    titles = [names[at : at + size].split(b"\0")[0].decode("ascii", "replace") for at in range(0, len(names), size)]
    fields = [part for kind, part in parts if kind == matlab._MATRIX]
    if len(fields) != len(titles) or len(set(titles)) != len(titles):
        raise ValueError(f"found {len(fields)} values of fields {', '.join(titles):.200}")
    return {title: _value(field, order, depth + 1) if len(field) else None for title, field in zip(titles, fields, strict=True)}


def _entries(parts: Any, order: str, count: int, single: bool) -> npt.NDArray[Any]:
    """`count` numbers, the next part of a variable, in float32 or float64; MATLAB keeps whole ones in integers."""
    kind, data = next(parts, (0, memoryview(b"")))
    entry = np.dtype(f"{order}{matlab._ENTRIES.get(kind, 'V1')}")
    if entry.kind == "V" or len(data) != count * entry.itemsize:
        raise ValueError(f"found {len(data)} bytes of type {kind} for {count} numbers: expected a whole .mat file")
    kept = np.frombuffer(data, entry)
    values = kept.astype(np.float32 if single else np.float64)
    if entry.kind == "f" and values.dtype.itemsize != entry.itemsize:
        raise ValueError(f"found numbers of {entry.itemsize} bytes in a variable of {values.dtype}")
    if entry.kind in "iu" and not np.array_equal(values.astype(np.float64), kept.astype(np.float64)):
        raise ValueError(f"found integers of {entry.itemsize} bytes that are no numbers of the variable's type")
    return values
