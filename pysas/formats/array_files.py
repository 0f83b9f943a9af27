"""Arrays that a header names in files beside it: .npy, .npz, .mat, .h5, or raw binary of a stated type and shape.

Sizes are compared with the bytes that lie in a file before anything is allocated, and nothing is unpickled.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pysas.formats import files, io, matlab_variables
from pysas.formats.containers import npy_header, opened_groups
from pysas.formats.fields import Array, File, allocated, blamed, bytes_of

KEYS = ("file", "name", "dtype", "shape", "offset", "crc32")
_NAMED = (".npz", ".mat", ".h5", ".hdf5")


def read_array(folder: Path, entry: Mapping[str, Any]) -> Array:
    """The array that an entry of a header names.

    Parameters
    ----------
    folder : Path
        Of the header: relative names begin there.
    entry : mapping
        "file", and "name" in an .npz, .mat or .h5 ("group/name" in the last), or "dtype" and "shape" of raw binary, C order,
        with "offset" bytes before it (default 0) and anything after it. "crc32": of the entries' bytes in C order.

    Raises
    ------
    ValueError
        What the entry or the file lacks; names the file, where there is one.
    OSError, ImportError, MemoryError
        From the file system; .h5 without h5py; what the file holds does not fit.
    """
    unknown = sorted(map(str, entry.keys() - set(KEYS)))
    if unknown or not isinstance(entry.get("file"), str):
        found = f"found {unknown[0]!r:.60}" if unknown else "missing file"
        raise ValueError(f"{found}, expected file, and name, or dtype and shape")
    path = files.name(folder / entry["file"])
    suffix = Path(path).suffix.lower()
    raw = {key: entry[key] for key in ("dtype", "shape", "offset") if key in entry}
    if suffix in _NAMED and "name" not in entry:
        raise ValueError(f"{path}: name: missing, expected that of an array in the {suffix}")
    if ("name" in entry) != (suffix in _NAMED) or bool(raw) == (suffix in (*_NAMED, ".npy")):
        expected = "file and name" if suffix in _NAMED else "file alone" if suffix == ".npy" else "dtype and shape"
        raise ValueError(f"{path}: found {', '.join(sorted(entry))}, expected {expected} of {suffix or 'raw binary'}")
    if suffix in _NAMED:
        array = _named(path, suffix, entry["name"])
    elif suffix == ".npy":
        array = _npy(path)
    else:
        array = _raw(path, **raw)
    if "crc32" in entry and zlib.crc32(bytes_of(np.ascontiguousarray(array)).data) != entry["crc32"]:
        raise ValueError(f"{path}: damaged: found other numbers than were written, by their CRC-32")
    return array


def _named(path: str, suffix: str, name: Any) -> Array:
    if not isinstance(name, str):
        raise ValueError(f"{path}: name: found {name!r:.60}, expected a string")
    if suffix in (".h5", ".hdf5"):
        with files.opened(path) as file, io.named(path), opened_groups(file) as groups:
            place, _, name = name.strip("/").rpartition("/")
            return _of(groups.group(place, [name]), name)
    if suffix == ".mat":
        with files.opened(path), io.named(path):
            return _of(matlab_variables.Variables(path), name)
    with io.opened(path) as opened:
        return _of(opened, name)


def _of(file: File, name: str) -> Array:
    if name not in file.fields:
        raise ValueError(f"{name}: missing, expected one of {', '.join(file.fields)}"[:300])
    if file.fields[name][1].kind not in "biufc":
        raise ValueError(f"{name}: found {file.fields[name][1]}, expected numbers")
    return file.read(name)


def _npy(path: str) -> Array:
    with files.opened(path) as file, io.named(path):
        shape, fortran, dtype = npy_header(file, os.fstat(file.fileno()).st_size)
        if dtype.kind not in "biufc":
            raise ValueError(f"found {dtype}, expected numbers")
        array = allocated("array", shape, dtype, "F" if fortran else "C")
        file.readinto(bytes_of(array))  # type: ignore[attr-defined]
        return array


def _raw(path: str, dtype: Any = None, shape: Any = None, offset: Any = 0) -> Array:
    kind = np.dtype(object)
    if isinstance(dtype, str):
        with blamed(f"{path}: dtype {dtype!r:.60}", "expected one such as <i2, >f4, <c8"):
            kind = np.dtype(dtype)
    if kind.kind not in "iufc" or kind.itemsize > (16 if kind.kind == "c" else 8):
        raise ValueError(f"{path}: dtype {dtype!r:.60}: expected one such as <i2, >f4, <c8")
    if kind.itemsize > 1 and str(dtype)[:1] not in "<>":
        raise ValueError(f"{path}: dtype {dtype!r:.60}: expected its byte order too, < or > first")
    if not isinstance(shape, list) or not shape or not all(type(n) is int and n >= 1 for n in shape):
        raise ValueError(f"{path}: shape {shape!r:.60}: expected a list of numbers of 1 or more")
    if type(offset) is not int or offset < 0:
        raise ValueError(f"{path}: offset {offset!r:.60}: expected a number of bytes")
    with files.opened(path) as file, io.named(path):
        found, expected = os.fstat(file.fileno()).st_size, math.prod(shape) * kind.itemsize
        if found < offset + expected or (found != expected and not offset):
            raise ValueError(f"found {found} bytes, expected {offset + expected}: {kind} of shape {tuple(shape)}")
        array = allocated("array", tuple(shape), kind)
        file.seek(offset)
        file.readinto(bytes_of(array))  # type: ignore[attr-defined]
        return array
