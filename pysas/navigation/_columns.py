"""Columns of navigation, checked: every error names the file where it is known, the argument, its value and the row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray

FINEST_TIME = 1e-6  # s: at some m/s a few micrometres
FINEST_PLACE = 1e-4  # m: a phase of 0.05 rad at 100 kHz
METRES_A_DEGREE = 111e3  # of latitude, for what a rounded degree is worth


def named(source: Any, name: str) -> str:
    """The argument's name after that of the file it came from."""
    if not isinstance(source, str):
        raise TypeError(f"source={source!r:.60}: expected the name of a file, or ''")
    return f"{source}: {name}" if source else name


def column(
    name: str, value: Any, shapes: Sequence[tuple[int | str, ...]], label: str = "row", finest: float = 0.0
) -> FloatArray:
    """`value` in float64, finite, and not rounded to more than `finest` by the dtype it comes in."""
    array = _checks.array_like(name, value)
    if array.dtype.kind in "iuf" and array.size and finest > 0:
        held = np.dtype(np.float64) if array.dtype.kind in "iu" or array.dtype.itemsize > 8 else array.dtype
        largest = np.max(np.abs(array[np.isfinite(array)]), initial=0)
        step = float(np.spacing(largest.astype(held)))
        if step > finest:
            by = f"{array.dtype}{'' if array.dtype == held else f' in {held}'}"
            raise ValueError(f"{name}: {by} resolves {largest:.10g} to {step:.2g}: expected {finest:.2g} or finer, in SI units")
    return _checks.reals(name, array, shapes, (label,))


def times(name: str, value: Any, label: str) -> FloatArray:
    """Times (s) that increase."""
    time = column(name, value, [("n",)], label, FINEST_TIME)
    backwards = np.diff(time) <= 0
    if np.any(backwards):
        i = int(np.argmax(backwards)) + 1
        word = "the same as" if time[i] == time[i - 1] else "before"
        raise ValueError(
            f"{name}: {time[i]:.6f} s at {label} {i} is {word} {time[i - 1]:.6f} s at {label} {i - 1}: "
            "expected increasing times"
        )
    return time


def within(name: str, value: FloatArray, low: float, high: float, unit: str, hint: str = "") -> None:
    """Check that all entries lie in [low, high]."""
    outside = (value < low) | (value > high)
    if np.any(outside):
        row = int(np.argmax(outside))
        raise ValueError(f"{name}: {value[row]:.10g} at row {row}: expected {low:g} to {high:g} {unit}{hint}")
