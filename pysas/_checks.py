"""Checks at the public border: each raises one error that names the argument, its value and what is expected.

Everything behind these functions trusts its input. Navigation is converted to float64; data are never copied.
"""

from __future__ import annotations

import numbers
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complexfloating[Any, Any]]

_MOST_THREADS = 2**31 - 1  # what an int of C holds


def number(name: str, value: Any, *, positive: bool = False, low: float | None = None, high: float | None = None) -> float:
    """Return `value` as a finite float, within (0, inf) or [low, high] where asked."""
    expected = "a finite number"
    if positive:
        expected = "a finite number > 0"
    elif low is not None or high is not None:
        expected = f"a finite number in [{low if low is not None else '-inf'}, {high if high is not None else 'inf'}]"
    real = isinstance(value, numbers.Real) and not isinstance(value, bool | np.timedelta64)
    if not real and not (isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"):
        raise TypeError(f"{name}={value!r}: expected {expected}")
    try:
        result = float(value)
    except OverflowError:
        result = np.inf
    bad = not np.isfinite(result) or (positive and result <= 0)
    bad = bad or (low is not None and result < low) or (high is not None and result > high)
    if bad:
        raise ValueError(f"{name}={value!r}: expected {expected}")
    return result


def whole(name: str, value: Any, low: int = 1) -> int:
    """Return `value` as an int >= low."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name}={value!r}: expected a whole number >= {low}")
    if value < low:
        raise ValueError(f"{name}={value!r}: expected a whole number >= {low}")
    return int(value)


def reals(name: str, value: Any, shapes: Sequence[tuple[int | str, ...]], labels: Sequence[str] = ()) -> FloatArray:
    """Return `value` as a finite float64 array whose shape is one of `shapes` (a str entry matches any length).

    `labels` names the leading axes (such as "ping", "channel") in the message about the first non-finite entry.
    """
    array = array_like(name, value)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name}: expected real numbers, found dtype {array.dtype}")
    if not any(_fits(array.shape, shape) for shape in shapes):
        wanted = " or ".join(f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in shapes)
        raise ValueError(f"{name}: expected shape {wanted}, found {array.shape}")
    array = np.asarray(array, dtype=np.float64)
    finite = np.isfinite(array)
    if not finite.all():
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        where = ", ".join(f"{label} {i}" for label, i in zip(labels, index, strict=False)) or f"index {index}"
        raise ValueError(f"{name}: {array[index]} at {where}: expected finite values")
    return array


def array_like(name: str, value: Any) -> npt.NDArray[Any]:
    """Return `value` as an array of any dtype, not copied where it is one, or shows one (DLPack on the CPU included)."""
    try:
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array_interface__"):
            value = np.from_dlpack(value)
        return np.asarray(value)
    except (BufferError, RuntimeError) as error:
        raise TypeError(f"{name}: expected an array in this machine's memory: {error}") from None
    except ValueError:
        raise ValueError(f"{name}: expected an array, found sequences of unequal lengths") from None


def _fits(found: tuple[int, ...], wanted: tuple[int | str, ...]) -> bool:
    return len(found) == len(wanted) and all(isinstance(w, str) or f == w for f, w in zip(found, wanted, strict=True))


def samples(name: str, value: Any, ndims: Sequence[int]) -> ComplexArray:
    """Return `value` as a complex64 or complex128 array (any byte order or stride), not copied."""
    array = array_like(name, value)
    if array.dtype.kind != "c" or array.dtype.itemsize not in (8, 16):
        raise TypeError(f"{name}: expected complex64 or complex128 samples, found dtype {array.dtype}")
    if array.ndim not in ndims:
        wanted = " or ".join(str(n) for n in ndims)
        raise ValueError(f"{name}: expected {wanted} dimensions, found shape {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name}: expected at least one sample, found shape {array.shape}")
    return array


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Return `value` if it is one of `allowed`."""
    if value not in allowed:
        raise ValueError(f"{name}={value!r}: expected one of {', '.join(allowed)}")
    return str(value)


def threads(value: Any) -> int:
    """Number of worker threads: `value`, else PYSAS_NUM_THREADS, else the processors this process may use."""
    if value is not None:
        if (count := whole("threads", value)) > _MOST_THREADS:
            raise ValueError(f"threads={value!r:.60}: expected at most {_MOST_THREADS}")
        return count
    text = os.environ.get("PYSAS_NUM_THREADS")
    if text is not None:
        # of ASCII digits: int() and isdigit() disagree on others, and int() takes "1_0"
        if not re.fullmatch(r"\s*0*[1-9][0-9]{0,9}\s*", text, re.ASCII) or int(text) > _MOST_THREADS:
            raise ValueError(f"PYSAS_NUM_THREADS={text!r:.60}: expected a whole number, 1 to {_MOST_THREADS}")
        return int(text)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def optional(module: str, extra: str) -> ImportError:
    """The error for a missing optional dependency."""
    return ImportError(f"{module} is not installed: pip install 'pysas-sonar[{extra}]'")
