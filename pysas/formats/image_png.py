"""Images as PNG, a grey byte of dB a pixel, beside a world file that says where the pixels lie (W3C, "PNG Specification")."""

from __future__ import annotations

import os
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.formats import files, image_maps
from pysas.formats.format import Format
from pysas.model.image import Image

_SUFFIX, _WORLD = ".png", ".pgw"


def _draw(path: str, image: Image, span: float, overwrite: bool) -> None:
    made = image_maps.of(path, image)
    coding, data = made.decibels(span)
    world = _world(path)
    files.check_outputs([("picture", path), ("its world file", world)], [], overwrite)
    a, b, c, d, e, f = made.affine
    lines = "".join(f"{number!r}\n" for number in (a, d, b, e, c, f))
    # both are complete before one of them takes its name
    with files.replacing(path, overwrite=overwrite) as picture, files.replacing(world, overwrite=overwrite) as places:
        picture.write(_png(data, made.tags | coding.tags))
        places.write(lines.encode())


def _world(path: str) -> str:
    return f"{os.path.splitext(path)[0]}{_WORLD}"


def _png(data: npt.NDArray[np.uint8], tags: dict[str, str]) -> bytes:
    """Grey of 8 bits; 0 is transparent."""
    rows, columns = data.shape
    lines = np.zeros((rows, columns + 1), dtype=np.uint8)  # each begins with its filter: none
    lines[:, 1:] = data
    parts = [
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)),
        (b"tRNS", struct.pack(">H", 0)),
        *((b"tEXt", key.encode("ascii") + b"\0" + value.encode("latin-1", "replace")) for key, value in tags.items()),
        (b"IDAT", zlib.compress(lines.data)),
        (b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(map(_chunk, parts))


def _chunk(part: tuple[bytes, bytes]) -> bytes:
    kind, content = part
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _write(path: str, image: Any, overwrite: bool) -> None:
    _draw(path, image, image_maps.SPAN, overwrite)


FORMAT = Format(
    name="png",
    title="PNG with a world file (.pgw)",
    suffixes=(_SUFFIX,),
    holds="images of planes and surfaces with even steps",
    kept=f"magnitudes as bytes of dB ({image_maps.SPAN:g} dB, or --db), places",
    lost="phase, heights of a surface, CRS",
    write=_write,
    draw=_draw,
    writes=(Image,),
)
