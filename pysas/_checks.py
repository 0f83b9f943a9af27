"""Checks at the public border: each raises one error that names the argument, its value and what is expected.

Everything behind these functions trusts its input, so what indices and geometry come from is copied here before it is looked
at: nobody can change it afterwards. Samples are never copied: no index depends on them.
"""

from __future__ import annotations

import numbers
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complexfloating[Any, Any]]
# NumPy's own settings, whatever the caller's are: an exponential that underflows inside is no error of theirs
usual_errors = np.errstate(divide="warn", over="warn", under="ignore", invalid="warn")
MOST_THREADS = 4096  # as in pysas.h


class InternalError(RuntimeError):
    """Something inside pysas that cannot be, whatever the input."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}: a fault of pysas, not of its input: please report it with the call that raised it")


def number(name: str, value: Any, *, positive: bool = False, low: float | None = None, high: float | None = None) -> float:
    """Return `value` as a finite float, within (0, inf) or [low, high] where asked."""
    if value is np.ma.masked:
        raise TypeError(f"{name}: masked: expected a number")
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


def whole(name: str, value: Any, low: int = 1, high: int | None = None) -> int:
    """Return `value` as an int in [low, high]."""
    expected = f"a whole number >= {low}" if high is None else f"a whole number in [{low}, {high}]"
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name}={value!r}: expected {expected}")
    if value < low or (high is not None and value > high):
        raise ValueError(f"{name}={value!r}: expected {expected}")
    return int(value)


def reals(name: str, value: Any, shapes: Sequence[tuple[int | str, ...]], labels: Sequence[str] = ()) -> FloatArray:
    """A read-only float64 copy of `value`, which is finite and of one of `shapes` (a str entry matches any length).

    `labels` names the leading axes (such as "ping", "channel") in the message about the first non-finite entry.
    """
    array = array_like(name, value)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name}: expected real numbers, found dtype {array.dtype}")
    if not any(_fits(array.shape, shape) for shape in shapes):
        wanted = " or ".join(f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in shapes)
        raise ValueError(f"{name}: expected shape {wanted}, found {array.shape}")
    array = own(array, np.float64)  # first: another thread may write to what was given
    finite = np.isfinite(array)
    if not finite.all():
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        where = ", ".join(f"{label} {i}" for label, i in zip(labels, index, strict=False)) or f"index {index}"
        raise ValueError(f"{name}: {array[index]} at {where}: expected finite values")
    return array


def own(array: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """A C-contiguous copy that cannot be written to."""
    copy = np.array(array, dtype=dtype, order="C")
    copy.setflags(write=False)
    return copy


def array_like(name: str, value: Any) -> npt.NDArray[Any]:
    """Return `value` as an array of any dtype, not copied where it is one, or shows one (DLPack on the CPU included).

    Masked entries are an error: NumPy would take what lies under the mask.
    """
    if _masked(value):
        raise TypeError(
            f"{name}: masked entries: expected plain values: fill them, or give NaN samples and nan='mask', or weights 0"
        )
    try:
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array_interface__"):
            value = np.from_dlpack(value)
        return np.asarray(value)
    except (BufferError, RuntimeError) as error:
        raise TypeError(f"{name}: expected an array in this machine's memory: {error}") from None
    except ValueError:
        raise ValueError(f"{name}: expected an array, found sequences of unequal lengths") from None


def _masked(value: Any) -> bool:
    """Whether entries of an array, or of arrays in sequences, are masked."""
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    return isinstance(value, list | tuple) and any(_masked(v) for v in value if not isinstance(v, numbers.Number))


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


def target(out: Any, shape: tuple[int, ...], *dtypes: npt.DTypeLike, whose: str = "the grid's") -> None:
    """Check `out`, into which an array of this shape and one of these dtypes is to be written."""
    if out is None:
        return
    plain = isinstance(out, np.ndarray) and not isinstance(out, np.ma.MaskedArray)
    if not plain or out.dtype not in [np.dtype(dtype) for dtype in dtypes]:
        wanted = " or ".join(str(np.dtype(dtype)) for dtype in dtypes)
        raise TypeError(f"out: expected an array of {wanted}, found {out.dtype if plain else type(out).__name__}")
    if out.shape != shape:
        raise ValueError(f"out: expected {whose} shape {shape}, found {out.shape}")
    if not out.flags.writeable:
        raise ValueError("out: expected a writeable array, found a read-only one")
    needed = out.itemsize
    for step, count in sorted((abs(step), count) for step, count in zip(out.strides, out.shape, strict=True) if count > 1):
        if step < needed:
            raise ValueError(f"out: strides {out.strides}: expected memory of its own for every entry")
        needed += step * (count - 1)


def apart(out: npt.NDArray[Any] | None, data: npt.NDArray[Any], name: str = "data") -> None:
    """Check that writing to `out` leaves `data`, the argument `name`, as they are."""
    if out is None or not np.may_share_memory(out, data):
        return
    try:
        shared = np.shares_memory(out, data, max_work=10**6)  # type: ignore[arg-type]
    except np.exceptions.TooHardError:
        shared = True
    if shared:
        raise ValueError(f"out: shares memory with {name}: expected memory of its own")


def callback(name: str, value: Any) -> None:
    """Check a function that is called now and then, or None."""
    if value is not None and not callable(value):
        raise TypeError(f"{name}={value!r}: expected a callable or None")


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Return `value` if it is one of `allowed`."""
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name}={value!r}: expected one of {', '.join(allowed)}")
    return str(value)


def threads(value: Any) -> int:
    """Number of worker threads: `value`, else PYSAS_NUM_THREADS, else the processors this process may use."""
    if value is not None:
        return whole("threads", value, high=MOST_THREADS)
    text = os.environ.get("PYSAS_NUM_THREADS")
    if text is not None:
        # of ASCII digits: int() and isdigit() disagree on others, and int() takes "1_0"
        if not re.fullmatch(r"\s*0*[1-9][0-9]{0,9}\s*", text, re.ASCII) or int(text) > MOST_THREADS:
            raise ValueError(f"PYSAS_NUM_THREADS={text!r:.60}: expected a whole number, 1 to {MOST_THREADS}")
        return int(text)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn whoever called pysas, however many of its own functions lie between."""
    frame, level = sys._getframe(1), 3
    inside = ("pysas", "numpy", "contextlib")  # `usual_errors` among them
    while frame.f_back is not None and frame.f_back.f_globals.get("__name__", "").partition(".")[0] in inside:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


def optional(module: str, extra: str) -> ImportError:
    """The error for a missing optional dependency."""
    return ImportError(f"{module} is not installed: pip install 'pysas-sonar[{extra}]'")
