"""What a file format is to the house: how it is recognised, read and written, and what is kept of what it holds."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pysas.formats import files, io, matlab_variables
from pysas.formats.containers import opened_netcdf
from pysas.model.echoes import Echoes
from pysas.model.image import Image
from pysas.model.phase_history import PhaseHistory
from pysas.model.recording import Recording

Item = Echoes | Image | PhaseHistory | Recording
_HEAD = 4096  # bytes of a file that are looked at


class Look:
    """A first look at a file: its name, its first bytes and, where it is a container of named arrays, their names.

    Nothing that is wrong with a file is an error here: `read` will tell.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = files.name(path)
        self.suffix = Path(self.path).suffix.lower()

    @cached_property
    def folder(self) -> bool:
        """Whether it is a folder."""
        return os.path.isdir(self.path)

    @cached_property
    def head(self) -> bytes:
        """The first bytes of a regular file."""
        with contextlib.suppress(OSError, ValueError), files.opened(self.path) as file:
            return file.read(_HEAD)
        return b""

    @cached_property
    def entries(self) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Shape and type of the arrays of an .npz, .h5, .nc, .mat or .zarr by their names; none where they cannot be told."""
        with contextlib.suppress(Exception):
            if matlab_variables.is_mat(self.head):
                return matlab_variables.Variables(self.path).fields
            if self.suffix == ".nc":
                with files.opened(self.path) as netcdf, opened_netcdf(netcdf) as variables:
                    return dict(variables.fields)
            with io.opened(self.path) as file:
                return dict(file.fields)
        return {}


def _none(look: Look) -> bool:
    return False


def _alone(path: str) -> list[str]:
    return []


def _unread(path: str, channel: str | None) -> Item:
    raise ValueError(f"{path}: found a format that is written and not read")


def _unwritten(path: str, item: Any, overwrite: bool) -> None:
    raise ValueError(f"{path}: found a format that is read and not written")


@dataclass(frozen=True)
class Format:
    """One format of files.

    Attributes
    ----------
    name : str
        One word, by which commands name it.
    title : str
        What it is, in a line.
    suffixes : of str
        Names of files that hold it end so, with the dot, in lower case.
    holds : str
        "echoes" (compressed from a phase history by `pysas.load`, where it is one), "images" or both.
    kept, lost : str
        What of a file's content is taken over, and what is not, for the table of docs/formats.md.
    sniff : callable
        Whether a file, by its `Look`, is of this format. It never raises, and is quick. Default: no file is.
    read : callable
        `read(path, channel)`: what the file holds; errors name the file. `channel`: one that the file names, or None.
    channels : bool
        Whether a file may have channels of which one is read. Other formats' are asked for none (`require_channel`).
    beside : callable
        Files that reading a file reads too, so far as it tells; it never raises. Default: none.
    write : callable
        `write(path, item, overwrite)`: a new file, which takes its name when complete.
    draw : callable, optional
        `draw(path, image, span, overwrite)`: the same of an image as bytes over so many dB.
    writes : of type
        What `write` takes.
    extra : str, optional
        pysas-sonar[extra] installs what the format needs.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    holds: str
    kept: str
    lost: str
    sniff: Callable[[Look], bool] = _none
    read: Callable[[str, str | None], Item] = _unread
    channels: bool = False
    beside: Callable[[str], list[str]] = _alone
    write: Callable[[str, Any, bool], None] = _unwritten
    draw: Callable[[str, Any, float, bool], None] | None = None
    writes: tuple[type, ...] = ()
    extra: str | None = None

    def require_channel(self, path: str, channel: str | None) -> None:
        """ValueError where one is asked for of a format that has none to choose from."""
        if channel is not None and not self.channels:
            raise ValueError(f"{path}: channel={channel!r:.60}: a file of format {self.name} is read whole: expected None")

    @property
    def row(self) -> tuple[str, ...]:
        """What `COLUMNS` say of it."""
        taken = ", ".join({"Echoes": "echoes", "Image": "images"}.get(kind.__name__, kind.__name__) for kind in self.writes)
        read = "no" if self.read is _unread else "yes"
        return (
            self.name,
            self.title,
            " ".join(self.suffixes),
            self.holds,
            read,
            taken or "no",
            self.kept,
            self.lost,
            self.extra or "-",
        )


COLUMNS = ("name", "format", "files", "holds", "read", "written", "kept", "lost", "extra")
