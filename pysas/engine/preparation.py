"""From traces to interpolation coefficients: for every interval of an over-sampled time axis, the polynomial that reads it.

On an interval of length 1/(rate fs), with position t in [-1/2, 1/2] from its middle, a component exp(2j pi f time) is
exp(j theta x), x = 2 t, theta = pi f/(rate fs) = sum_k (2 - [k = 0]) j^k J_k(theta) T_k(x) (Jacobi-Anger). Cut at degree d
this is the near-minimax polynomial of the component; its coefficients times W(f) are the transfer functions H_q, and one
inverse transform per q gives coefficient q of all intervals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from numpy.polynomial import chebyshev
from scipy.special import jv

from pysas._checks import ComplexArray, FloatArray
from pysas.engine.traces import Records


@dataclass(frozen=True)
class Cut:
    """How much of a trace is kept, and the length of its transform.

    length : samples kept of each trace; n_fft : transform length; window : (length,) smooth cut of the samples kept, or None.
    """

    length: int
    n_fft: int
    window: FloatArray | None


@dataclass(frozen=True)
class Interpolator(Cut):
    """How traces become coefficients.

    n_fine : transform length at rate fs; intervals : intervals kept; degree : of the polynomials; transfer :
    (degree + 1, n_fft) complex, H_q with the shift to the interval's middle.
    """

    n_fine: int
    intervals: int
    degree: int
    transfer: ComplexArray

    @property
    def rate(self) -> float:
        """Over-sampling: intervals per sample."""
        return self.n_fine / self.n_fft


def low_pass(f: FloatArray) -> FloatArray:
    """W at frequencies `f` in units of fs: 1 up to 1/2.2, falling as cos^2 to 0 at 1/2."""
    edge = np.clip((np.abs(f) - 1 / 2.2) / (0.5 - 1 / 2.2), 0, 1)
    return np.asarray(np.cos(np.pi / 2 * edge) ** 2)


def monomials(theta: FloatArray, degree: int) -> npt.NDArray[np.complex128]:
    """Coefficients (degree + 1, len(theta)) in powers of t, |t| <= 1/2, of the degree-d polynomial of exp(2j theta t)."""
    k = np.arange(degree + 1)
    series = (2.0 - (k == 0))[:, None] * (1j**k)[:, None] * jv(k[:, None], theta)
    to_powers = np.zeros((degree + 1, degree + 1))
    for n in k:
        row = chebyshev.cheb2poly(np.eye(degree + 1)[n])
        to_powers[: row.size, n] = row
    return np.asarray((2.0**k)[:, None] * (to_powers @ series))


def interpolator(
    length: int, n_fft: int, n_fine: int, degree: int, taper: int, beta: float, dtype: npt.DTypeLike
) -> Interpolator:
    """Transfer functions in complex `dtype`; n_fine >= n_fft. `taper` samples at each end fall as a Kaiser integral."""
    f = scipy.fft.fftfreq(n_fft)
    theta = np.pi * f * n_fft / n_fine
    transfer = monomials(theta, degree) * (low_pass(f) * np.exp(1j * theta) * (n_fine / n_fft))
    intervals = min(n_fine, int(np.ceil((length - 1) * n_fine / n_fft)) + 1)
    window = smooth_cut(length, taper, beta, dtype)
    return Interpolator(length, n_fft, window, n_fine, intervals, degree, transfer.astype(dtype))


def smooth_cut(length: int, taper: int, beta: float, dtype: npt.DTypeLike) -> FloatArray | None:
    """A window whose first and last `taper` samples rise and fall as a Kaiser window's integral; None without taper."""
    if not taper:
        return None
    rise = np.cumsum(np.kaiser(taper + 1, beta))
    window = np.ones(length)
    window[:taper] = (rise / rise[-1])[:taper]
    window[-taper:] = window[:taper][::-1]
    return np.asarray(window, dtype=np.dtype(dtype).type(0).real.dtype)


def coefficients(segments: ComplexArray, plan: Interpolator, out: npt.NDArray[Any]) -> None:
    """Fill `out` (trace, interval, degree + 1) complex from `segments` (trace, length)."""
    spectrum = scipy.fft.fft(segments, plan.n_fft, axis=-1, workers=1)
    half = (plan.n_fft + 1) // 2
    tail = plan.n_fft - half
    fine = np.zeros((segments.shape[0], plan.n_fine), dtype=plan.transfer.dtype)
    for q in range(plan.degree + 1):
        fine[:, :half] = spectrum[:, :half] * plan.transfer[q, :half]
        fine[:, half:] = 0
        if tail:
            fine[:, plan.n_fine - tail :] = spectrum[:, half:] * plan.transfer[q, half:]
        rows = scipy.fft.ifft(fine, axis=-1, workers=1)[:, : plan.intervals]
        with np.errstate(over="ignore", invalid="ignore"):  # what no pixel reads may be too bright for float32
            out[:, :, q] = rows


def segments(
    traces: ComplexArray,
    order: npt.NDArray[np.int64],
    records: Records,
    weights: ComplexArray,
    scale: float,
    plan: Cut,
    dtype: npt.DTypeLike,
) -> ComplexArray:
    """The samples kept of traces `order` (flat ping-channel numbers) of (ping, channel, sample), weighted and tapered.

    Trace i is kept from its record's first sample `kept` on, zeros outside what was recorded, divided by `scale`, a power of
    two.
    """
    channels = traces.shape[1]
    start, begin, end = (records[name].astype(np.int64) for name in ("kept", "first", "last"))
    kept: ComplexArray = np.zeros((order.size, plan.length), dtype=dtype)
    for i, flat in enumerate(order):
        trace = traces[divmod(int(flat), channels)]
        first = int(start[i])
        a, b = max(first, int(begin[i])), min(first + plan.length, int(end[i]) + 1)
        if b > a and weights[i] != 0:  # or it may hold anything
            kept[i, a - first : b - first] = _scaled(trace[a:b], complex(weights[i]), scale, kept.dtype)
    if plan.window is not None:
        kept *= plan.window
    return kept


def _scaled(samples: ComplexArray, weight: complex, scale: float, dtype: npt.DTypeLike) -> ComplexArray:
    """weight samples/scale, whose product alone need be a number of `dtype`."""
    exponent = math.frexp(scale)[1] - 1
    size = math.frexp(max(abs(weight.real), abs(weight.imag)))[1] - exponent  # of their quotient
    most = np.finfo(dtype).maxexp // 2
    factor = complex(math.ldexp(weight.real, -exponent), math.ldexp(weight.imag, -exponent)) if size < 900 else 0j
    if -most < size < most or weight == 0:
        return np.asarray(samples * np.asarray(factor, dtype)[()])
    double = np.array(samples, dtype=np.complex128)
    if -900 < size < 900:
        double *= factor
    else:
        np.ldexp(double.view(np.float64), -exponent, out=double.view(np.float64))
        double *= weight
    return double
