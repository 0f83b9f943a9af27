"""What a file looks like that no format takes, and what can be done with it, in a line or two.

First bytes are those of public specifications: SEG-Y (SEG, rev. 2), XTF (Triton, rev. 42), JSF (EdgeTech 0023492), s7k
(Teledyne RESON), .all and .kmall (Kongsberg), NITF (MIL-STD-2500C), CPHD (NGA.STND.0068) and CRSD, and the usual ones.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pysas.formats import headers, stores
from pysas.formats.arrays import SCHEMA
from pysas.formats.format import Look

_HEADER = "write a header for its arrays (docs/formats.md#plain-arrays)"
_RAW = "write a header that says its dtype and shape (docs/formats.md#plain-arrays)"
_SONAR = "not read here: export its samples and navigation to arrays with its maker's software or MB-System, and {header}"
_MOST_NAMED = 6
_ECHOES = ("schema", "data", "fs", "fc", "c", "t0", "tx", "rx", "compressed")  # what echoes must have
_OWN = (".npz", ".h5", ".zarr")  # names of this project's own files, whose readers tell what is wrong with one

# first bytes, where they stand, what the file looks like, what to do
_BYTES: tuple[tuple[int, bytes, str, str], ...] = (
    (0, b"\x1f\x8b", "a gzip file", "gunzip it first"),
    (0, b"BZh", "a bzip2 file", "bunzip2 it first"),
    (0, b"\xfd7zXZ\0", "an xz file", "unxz it first"),
    (0, b"\x28\xb5\x2f\xfd", "a zstd file", "unzstd it first"),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it first"),
    (257, b"ustar", "a tar archive", "unpack it first"),
    (0, b"\x89PNG\r\n\x1a\n", "a PNG picture", "a picture has no phase: give the samples it was made from"),
    (0, b"\xff\xd8\xff", "a JPEG picture", "a picture has no phase: give the samples it was made from"),
    (0, b"GIF8", "a GIF picture", "a picture has no phase: give the samples it was made from"),
    (0, b"II*\0", "a TIFF picture", "written here and not read: give the samples it was made from"),
    (0, b"MM\0*", "a TIFF picture", "written here and not read: give the samples it was made from"),
    (0, b"II+\0", "a BigTIFF picture", "written here and not read: give the samples it was made from"),
    (0, b"%PDF", "a PDF document", "give the samples"),
    (0, b"CRSD/", "CRSD signal data", "not read here: sarkit reads it, " + _HEADER.replace("write", "then write")),
    (0, b"NITF", "a NITF file, but no SICD 1", "a picture has no phase: give the samples it was made from"),
    (0, b"NSIF", "a NSIF file (SICD?)", "not read here: sarkit reads SICD, " + _HEADER.replace("write", "then write")),
    (0, b"\x93NUMPY", "one array of NumPy", "name it in a header (docs/formats.md#plain-arrays)"),
    (0, b"CDF\x01", "netCDF-3", f"convert it to netCDF-4 (nccopy -k 4) and {_HEADER}"),
    (0, b"CDF\x02", "netCDF-3", f"convert it to netCDF-4 (nccopy -k 4) and {_HEADER}"),
    (
        0,
        b"MATLAB 7.3",
        "a MATLAB 7.3 file",
        "save it with -v7; what is too large for that, write as .h5 (docs/conventions.md#writers)",
    ),
    (4, b"\xff\xff\0\0", "a Teledyne RESON s7k record", _SONAR.format(header=_RAW)),
    (4, b"#IIP", "a Kongsberg .kmall record", _SONAR.format(header=_RAW)),
    (0, b"\x01\x16", "an EdgeTech JSF record", _SONAR.format(header=_RAW)),
    (0, b"\x7fELF", "a program", "give the samples"),
)
_TEXT_SUFFIXES = {".csv": "a table of text", ".txt": "text", ".tsv": "a table of text", ".xml": "XML"}


def explained(look: Look) -> str | None:
    """What is said of a file that no format takes; None where a reader of this project's own files says it better.

    Never raises.
    """
    if look.folder:
        return _of_folder(look)
    if not look.head:
        return _of_nothing(look)
    if look.entries:
        return _of_arrays(look.entries) + (": of a copy whose name ends in .h5" if look.suffix == ".nc" else "")
    for offset, magic, what, advice in _BYTES:
        if look.head[offset : offset + len(magic)] == magic:
            return f"{what}: {advice}"
    own = look.suffix in _OWN
    if own and (look.suffix == ".zarr" or look.head[:2] == b"PK" or look.head[:4] == b"\x89HDF"):
        return None
    found = _of_bytes(look) or _of_text(look)
    return found if found is not None or own else f"unknown bytes: if they are raw samples, {_RAW}"


def _of_nothing(look: Look) -> str | None:
    try:
        return "an empty file: expected samples" if os.path.getsize(look.path) == 0 else None
    except OSError:
        return None


def _of_folder(look: Look) -> str | None:
    try:
        names = sorted(os.listdir(look.path))
    except OSError:
        return None
    if look.entries:
        return _of_arrays(look.entries)
    if ".zgroup" in names or ("zarr.json" in names and _is_foreign(Path(look.path))):
        arrays = [name for name in names if not name.startswith(".") and name != "zarr.json"]
        shown = ", ".join(arrays[:_MOST_NAMED])
        return f"a Zarr group of {shown}: of no known format: copy its arrays to .npz and {_HEADER}"
    if look.suffix in _OWN:
        return None
    scenes = [name for name in names if name == "scenes" or name.endswith((".h5", ".npz"))]
    hint = f", such as {scenes[0]}" if scenes else ""
    return f"a folder of {len(names)} entries{hint}: expected a file, or a folder that holds a Zarr group"


def _is_foreign(folder: Path) -> bool:
    """Whether a Zarr group of version 3 claims no schema of this project."""
    try:
        stores.require_header(folder)
        header = json.loads((folder / "zarr.json").read_bytes())
        return bool(header["node_type"] == "group" and "schema" not in header.get("attributes", {}))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _of_arrays(entries: Mapping[str, tuple[tuple[int, ...], np.dtype[Any]]]) -> str:
    """Names, shapes and types, and which may be the samples: the largest of at least two axes, complex before real."""
    shown = [f"{name:.40} {_kind(shape, dtype)}" for name, (shape, dtype) in list(entries.items())[:_MOST_NAMED]]
    more = f" and {len(entries) - _MOST_NAMED} more" if len(entries) > _MOST_NAMED else ""
    likely = [
        (dtype.kind == "c", math.prod(shape), name)
        for name, (shape, dtype) in entries.items()
        if 2 <= len(shape) <= 4 and dtype.kind in "iufc" and min(shape) > 0
    ]
    guess = f"; {max(likely)[2]:.40} may be the samples" if likely else ""
    lacking = [name for name in _ECHOES if name not in entries]
    advice = f"{_HEADER}, or name its fields as docs/conventions.md does"
    if len(lacking) <= len(_ECHOES) // 2:
        advice = f"add {', '.join(lacking)}, as docs/conventions.md has them, or {_HEADER}"
    return f"arrays of no known format: {', '.join(shown)}{more}{guess}:\n  {advice}"


def _kind(shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    return "text" if dtype.kind in "US" else "(no numbers)" if dtype.hasobject else f"{dtype.name} {shape}"


def _of_bytes(look: Look) -> str | None:
    """What first bytes alone do not tell."""
    head = look.head
    if head[:4] in (b"RIFF", b"RIFX", b"RF64") and head[8:12] == b"WAVE":
        return f"WAV: samples without places: save them as .npy and {_HEADER}; pysas echoes takes one as --pulse"
    if head[:2] == b"PK":
        return "a zip archive, not .npz: unpack it first"
    if head[:1] == b"\x80" and head[1:2] in b"\x02\x03\x04\x05":
        return (
            "a Python pickle, which runs code when it is read: not read here: save its arrays as .npz (docs/formats.md#sonar)"
        )
    if head[:1] == b"\x7b" and (head[1024:1026] == b"\xce\xfa" or look.suffix == ".xtf"):
        return f"an XTF file: {_SONAR.format(header=_RAW)}"
    if head[4:5] == b"\x02" and look.suffix in (".all", ".wcd"):
        return f"a Kongsberg .all record: {_SONAR.format(header=_RAW)}"
    if head[:2] in (b"\xc3\x40", b"C ", b"C0") and (look.suffix in (".sgy", ".segy") or head[:3] in (b"\xc3\x40\xf1", b"C 1")):
        return f"SEG-Y: not read here: segyio reads its traces: save them as .npy and {_HEADER}"
    if head[:8] == b"\x89HDF\r\n\x1a\n":
        return f"HDF5 under another name: rename it to .h5, or {_HEADER}"
    if look.suffix == ".mat":
        return f"no .mat file of MATLAB's versions 5 to 7, or a damaged one: save it with -v7 and {_HEADER}"
    return None


def _of_text(look: Look) -> str | None:
    head = look.head
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # a letter that the look has cut is none
            return None
        text = head[: error.start].decode("utf-8-sig")
    if any(ord(letter) < 32 and letter not in "\t\n\r\f" for letter in text):
        return None
    if look.suffix in headers.SUFFIXES:
        return f"text without the key header: a header of arrays says header: {SCHEMA} (docs/formats.md#plain-arrays)"
    first = text.splitlines()[0] if text.strip() else ""
    table = look.suffix in (".csv", ".tsv") or (first.count(",") >= 2 and "\n" in text)
    what = "a table of text" if table else _TEXT_SUFFIXES.get(look.suffix, "text")
    use = "pysas echoes takes navigation and lever arms so" if table else "expected samples"
    return f"{what}, {Path(look.path).name!r:.40} begins {first!r:.40}: {use}; samples in text: save them as .npy and {_HEADER}"
