"""The range of numbers: the power of two that brings what a sum reads near 1, and the way back into the image's dtype."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.imaging import words

WIDE = 80  # bits between the traces' largest terms: float32 may lose the small ones
LOST = 2.0**-100  # of the largest term: what float32 sums of such traces cannot be trusted below


def largest(weights: ComplexArray, peaks: FloatArray) -> npt.NDArray[np.int64]:
    """Exponents e, one a trace: every |weight x sample| of it is below 2^(e + 1). Least of all integers where all are 0.

    peaks : largest real or imaginary part of the samples that are read. In exponents, as the products may be no floats.
    """
    factor = np.maximum(np.abs(weights.real), np.abs(weights.imag))
    found = np.frexp(factor)[1].astype(np.int64) + np.frexp(peaks)[1]
    found[(factor == 0) | (peaks == 0)] = np.iinfo(np.int64).min
    return found


def scale_of(exponents: npt.NDArray[np.int64]) -> float:
    """The power of two next to the largest term of all traces; 1 where there is none.

    Raises
    ------
    ValueError
        Terms that no float64 holds.
    """
    if not exponents.size or exponents.max() == np.iinfo(np.int64).min:
        return 1.0
    most = int(exponents.max())
    if most > 1024:
        raise ValueError(f"weights: times samples they reach 2^{most - 2}: expected at most 2^1024, the end of float64")
    return math.ldexp(1.0, min(max(most, -1074), 1023))


def wide(exponents: npt.NDArray[np.int64]) -> bool:
    """Whether float32 may lose the terms of some traces beside those of others."""
    found = exponents[exponents != np.iinfo(np.int64).min]
    return bool(found.size and found.max() - found.min() > WIDE)


def restore(image: ComplexArray, scale: float, traces: int, error: float) -> str:
    """Multiply sums of `traces` scaled terms by `scale`; what `image`'s dtype costs beyond a tenth of a relative `error`.

    Raises
    ------
    ValueError
        The image does not fit its dtype, which is set to 0.
    """
    kind, exponent = np.finfo(image.dtype), math.frexp(scale)[1] - 1
    # a table's readings exceed the samples by a bit or two
    if exponent + math.log2(traces) + 6 < kind.maxexp and exponent > kind.minexp + 64:
        image *= scale
        return ""
    parts = (image.real, image.imag)
    most = max(float(np.max(np.abs(part))) for part in parts)
    if most == 0:
        return ""
    if math.log2(most) + exponent >= kind.maxexp:
        image[...] = 0
        raise ValueError(f"data: the image reaches 2^{math.log2(most) + exponent:.1f}: expected less than 2^{kind.maxexp}, the "
                         f"end of {image.dtype}: smaller samples or weights")  # fmt: skip
    level = math.sqrt(sum(float(np.mean(np.square(part / most, dtype=np.float64))) for part in parts))
    for part in parts:
        np.ldexp(part, exponent, out=part)
    # rounding to multiples of the smallest number, evenly spread, of both parts
    lost = 2.0 ** min(kind.minexp - kind.nmant - exponent - math.log2(most), 1000.0) / math.sqrt(6) / max(level, 1e-300)
    if lost <= error / 10:
        return ""
    return words.too_small(image.dtype, min(lost, 1.0))
