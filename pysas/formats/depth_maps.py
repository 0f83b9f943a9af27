"""Depth maps: heights of the seabed over even places from .npz or .h5 (fields x, y, z), or of any places as lines of text."""

from __future__ import annotations

import os
from pathlib import Path
from typing import IO

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files
from pysas.formats.containers import container

_FIELDS = {"x": ("real", "x"), "y": ("real", "y"), "z": ("real", "y x")}


def load(path: str | os.PathLike[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Read a depth map, in the coordinates of the echoes, m.

    Parameters
    ----------
    path : str or path
        .npz or .h5 with float64 x (column,), y (row,) and z (row, column); anything else is text, lines of x, y and z with
        commas or blanks between them.

    Returns
    -------
    x, y, z
        Of a container as they are, of text (point,) each.

    Raises
    ------
    ValueError
        No such content, or values that are not finite; names file and field.
    """
    text = files.name(path)
    contained = Path(text).suffix.lower() in (".npz", ".h5")
    with files.opened(text) as stream:
        try:
            x, y, z = _contained(text, stream) if contained else _lines(stream)
        except MemoryError:
            raise
        except Exception as error:  # zipfile, zlib, h5py and loadtxt have many ways of saying that bytes are wrong
            raise ValueError(f"{text}: {error or type(error).__name__}") from error
    return x, y, z


def _contained(path: str, stream: IO[bytes]) -> list[FloatArray]:
    with container(path)[0](stream) as file:
        file.check(_FIELDS, _FIELDS)
        return [_checks.reals(name, file.read(name), [tuple(_FIELDS[name][1].split())], ("row", "column")) for name in _FIELDS]


def _lines(stream: IO[bytes]) -> list[FloatArray]:
    points = np.loadtxt((line.decode("utf-8").replace(",", " ") for line in stream), ndmin=2)
    if points.shape[1] != 3 or points.shape[0] < 3:
        raise ValueError(f"found {points.shape[0]} lines of {points.shape[1]} numbers, expected lines of x, y, z")
    return list(_checks.reals("x, y, z", points, [("n", 3)], ("point",)).T)
