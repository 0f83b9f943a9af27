"""Depth maps: heights of the seabed over even places from .npz or .h5 (fields x, y, z), or of any places as lines of text."""

from __future__ import annotations

import os
from pathlib import Path

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
    with files.opened(text) as stream:
        if Path(text).suffix.lower() in (".npz", ".h5"):
            with container(text)[0](stream) as file:
                try:
                    file.check(_FIELDS, _FIELDS)
                    found = [file.read(name) for name in "xyz"]
                    shapes: list[tuple[int | str, ...]] = [("x",), ("y",), ("y", "x")]
                    x, y, z = (_checks.reals(n, v, [s], ("row",)) for n, v, s in zip("xyz", found, shapes, strict=True))
                except ValueError as error:
                    raise ValueError(f"{text}: {error}") from None
            return x, y, z
        try:
            lines = (line.decode("utf-8").replace(",", " ") for line in stream)
            points = np.loadtxt(lines, ndmin=2)
        except ValueError as error:
            raise ValueError(f"{text}: {error}: expected lines of x, y, z") from None
    if points.shape[1] != 3 or points.shape[0] < 3:
        raise ValueError(f"{text}: found {points.shape[0]} lines of {points.shape[1]} numbers, expected lines of x, y, z")
    x, y, z = _checks.reals(text, points, [("n", 3)], ("line",)).T
    return x, y, z
