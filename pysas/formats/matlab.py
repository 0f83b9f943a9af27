"""Echoes and images as variables of a .mat file (MATLAB's versions 5 to 7), by the names of our own schemas.

MATLAB gives everything two axes or more and drops those of length 1 behind them: here fields get the shapes of the schema
back. Of a single ping, what may be a number or one a ping is a number.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pysas.formats import files, io, matlab_variables
from pysas.formats.fields import Array
from pysas.formats.format import Format, Item, Look
from pysas.model.echoes import Echoes
from pysas.model.grid import KINDS
from pysas.model.image import Image

_MOST = 2**31 - 2**16  # bytes of a variable: offsets are of 32 bits, and MATLAB takes no more


class _Variables(matlab_variables.Variables):
    """Variables as fields of a schema."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        sizes: dict[str, int] = {}
        for name, (_, *shapes) in self._table().items():
            if name in self.fields and self.fields[name][1].kind not in "UO":
                shape, dtype = self.fields[name]
                self.fields[name] = _fitting(shape, shapes, sizes), dtype

    def _table(self) -> dict[str, tuple[str, ...]]:
        """Shapes of fields, those first that tell the sizes of others."""
        kind = self.text("grid_kind") if "grid_kind" in self.fields else ""
        if kind in KINDS:
            shape = self.fields["grid_coords"][0][:-1] if "grid_coords" in self.fields else ()
            table = io.image_table(kind, shape)
            return dict(sorted(table.items(), key=lambda item: not item[0].startswith("grid_")))
        if "rx" not in self.fields:
            return {}
        table = io.echo_table(len(self.fields["rx"][0]) == 2)
        return {name: table[name] for name in ("rx", "data")} | table

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        return np.asarray(super()._read(name, shape, dtype), order="C")


def _fitting(found: tuple[int, ...], shapes: list[str], sizes: dict[str, int]) -> tuple[int, ...]:
    """The first of the shapes, in words, that MATLAB shows as `found`; `found` where none is. Its words' sizes are noted."""
    for words in map(str.split, shapes):
        if len(words) < 2:
            fits = found == (1, 1) if not words else found == (0, 0) or (len(found) == 2 and 1 in found)
            shape = (int(np.prod(found)),) * len(words)
        else:
            fits, shape = len(found) <= len(words), found + (1,) * (len(words) - len(found))
        named = {word: n for word, n in zip(words, shape, strict=False) if fits}
        if fits and all((int(word) if word.isdigit() else sizes.get(word, n)) == n for word, n in named.items()):
            sizes |= named
            return shape
    return found


def _sniff(look: Look) -> bool:
    return matlab_variables.is_mat(look.head) and (
        "schema" in look.entries or not look.entries
    )  # none: reading tells what is wrong


def _read(path: str, channel: str | None) -> Item:
    files.opened(path).close()  # what is not the file's fault
    with io.named(path):
        return io.read(path, _Variables(path))


def _write(path: str, item: Echoes | Image, overwrite: bool) -> None:
    import scipy.io  # half a second that other commands do not need

    fields = io.fields_of(item)
    for name, array in fields.items():
        if array.dtype.kind != "U" and array.nbytes > _MOST:
            raise ValueError(f"{path}: {name}: found {array.nbytes} bytes, expected at most {_MOST} in a .mat: .h5 takes more")
    content = {name: str(array) if array.dtype.kind == "U" else array for name, array in fields.items()}
    with files.replacing(path, overwrite=overwrite) as file:
        stream: Any = file  # which SciPy takes, and its types do not say
        scipy.io.savemat(stream, content, do_compression=True, oned_as="row")


FORMAT = Format(
    name="matlab",
    title="MATLAB .mat, versions 5 to 7",
    suffixes=(".mat",),
    holds="echoes, images",
    kept="all, by the names of docs/conventions.md",
    lost="nothing; less than 2 GiB a variable",
    sniff=_sniff,
    read=_read,
    write=_write,
    writes=(Echoes, Image),
)
