"""The formats of this project, in .npz, .h5 and .zarr, as one of those that files may have."""

from __future__ import annotations

from pysas.formats import io
from pysas.formats.format import Format, Item, Look
from pysas.model.echoes import Echoes
from pysas.model.image import Image


def _sniff(look: Look) -> bool:
    return "schema" in look.entries


def is_own_store(path: str) -> bool:
    """Whether a file of this name is a Zarr group of this project's, whose pings can be read some at a time."""
    return io.is_store(path) and _sniff(Look(path))


def _read(path: str, channel: str | None) -> Item:
    return io.load(path)


def _write(path: str, item: Echoes | Image, overwrite: bool) -> None:
    io.save(path, item, overwrite=overwrite)


FORMAT = Format(
    name="pysas",
    title="pysas-echoes-1 and pysas-image-1",
    suffixes=(".npz", ".h5", ".zarr"),
    holds="echoes, images",
    kept="all",
    lost="nothing",
    sniff=_sniff,
    read=_read,
    write=_write,
    writes=(Echoes, Image),
)
