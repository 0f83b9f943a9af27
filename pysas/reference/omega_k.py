"""Omega-k: the exact Fourier inversion of a straight, even track; only the Stolt interpolation approximates.

Rows of one along-track wavenumber are independent between the two transforms over pings, so they are padded, transformed,
mapped and transformed back a few at a time and in place: memory is little more than the data.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from numba import njit
from scipy.special import i0

from pysas import _checks, _pool
from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.model.image import Image, Report
from pysas.reference.stripmap import Strip, band, even_ranges, frequencies, matched_filter, prepare, reference

INTERPOLATIONS = ("linear", "cubic", "sinc")
_SINC_TAPS = 16
_TABLE = 2048  # phases of the tap table, read linearly: 3e-7 of a tap
_ROWS_BYTES = 1 << 21  # of padded rows in one task: they should stay in a core's cache

Complex = npt.NDArray[np.complex128]


def omega_k(
    echoes: Echoes,
    *,
    interpolation: str = "sinc",
    zero_padding: int = 2,
    reference_range: float | None = None,
    range_bandwidth: float | None = None,
    along_bandwidth: float | None = None,
    weight: str = "flat",
    side: str | None = None,
    threads: int | None = None,
) -> Image:
    """Image of a straight, even track by the omega-k (wavenumber, range migration) algorithm.

    Parameters
    ----------
    echoes : Echoes
        One channel, monostatic, evenly spaced along x; range-compressed, or raw with their pulse (then compressed here).
    interpolation : {"sinc", "linear", "cubic"}
        Reads the spectrum between its frequencies: 16-point sinc under a Kaiser window, linear, or cubic convolution (R. G.
        Keys 1981, a = -1/2). Linear loses about 29 rho^2 dB at rho = |r - reference_range| over the padded record's length.
    zero_padding : int
        Length of the transform over a record padded with zeros, in records, >= 1.
    reference_range : float, optional
        Slant range at which the interpolation is exact, m; default: the middle of the record.
    range_bandwidth : float, optional
        Two-sided processing bandwidth about fc, Hz, with sharp ends; default: fs.
    along_bandwidth : float, optional
        Two-sided processing bandwidth in along-track wavenumber, rad/m, about the beam's middle; default: 2 pi/spacing.
    weight : {"flat", "backprojection"}
        "flat": every (k_x, k_u) counts as it was recorded. "backprojection": as in the sum over pings, see Notes.
    side : {"+y", "-y"}, optional
        Where the sonar looks; default: where its beam does, or without one towards +y, which the report's notes then say.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.

    Returns
    -------
    Image
        complex64 or complex128 as the data, (range, ping), on the plane grid of the slant plane: x those of the pings,
        |y - y_track| slant ranges of the record every c/(2 fs) or less. Phases as in `backproject`.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; a track that is not straight, even, monostatic (the ping is named).

    Notes
    -----
    Image(k_x, k_u) = (k_x/2k) E(f, k_u) with 2k = sqrt(k_x^2 + k_u^2) (Stolt's change of variable with its Jacobian; R.
    Sathishkumar et al., Section III; D. W. Hawkins 1996). Frequencies below |k_u| c/(4 pi), where nothing propagates, are
    zero.

    The spectrum of a point has the amplitude sqrt(pi r/k) (1 - (k_u/2k)^2)^(-3/4), so with "flat" peaks grow as sqrt(r).
    Back-projection sums s(tau) exp(2j pi fc tau) over pings: for each frequency a convolution over x with exp(2j k R), whose
    Fourier transform is -2 pi r (k/k_x) H1(k_x r), H1 the Hankel function of the first kind; for k_x r >> 1 that is
    sqrt(pi r/k) (1 - (k_u/2k)^2)^(-3/4) exp(j k_x r + j pi/4), with relative error 3/(8 k_x r). "backprojection" multiplies
    by this, divided by the spacing of pings: the image then equals that of `backproject` of echoes without a beam, or whose
    beam's edge and taper lie beyond `along_bandwidth`, without a free factor.

    O(N log N) in samples; memory 1 to 3 times the data.
    """
    clock = time.perf_counter()
    _checks.choice("interpolation", interpolation, INTERPOLATIONS)
    _checks.choice("weight", weight, ("flat", "backprojection"))
    zero_padding = _checks.whole("zero_padding", zero_padding)
    workers, summed = _checks.threads(threads), weight == "backprojection"
    strip = prepare(echoes, along_bandwidth, side=side)
    stolt = _layout(strip, zero_padding, reference(echoes, reference_range), band(echoes, range_bandwidth), interpolation)
    n_sample = echoes.n_sample
    work = strip.spectrum(stolt.ranges.size, workers)
    matched = matched_filter(echoes, stolt.f)
    filters = np.ones(stolt.f.size, dtype=np.complex128) if matched is None else matched
    filters = filters * stolt.inside
    gain = stolt.gain(summed)
    rows = max(1, _ROWS_BYTES // (stolt.f.size * work.itemsize))
    prepared = time.perf_counter()

    def task(number: int) -> None:
        part = slice(number * rows, min((number + 1) * rows, len(work)))
        spectra = np.zeros((part.stop - part.start, stolt.f.size), dtype=work.dtype)
        spectra[:, :n_sample] = work[part, :n_sample]
        spectra = scipy.fft.fft(spectra, axis=1, overwrite_x=True, workers=1)
        mapped = np.empty((len(spectra), stolt.size), dtype=work.dtype)
        for row, k_u in enumerate(strip.k_u[part]):
            if strip.kept[part.start + row]:
                _pool.call(_shift, spectra[row], filters, *stolt.shift_arguments(k_u))
                _pool.call(_map, spectra[row], mapped[row], stolt.taps, summed, *stolt.map_arguments(k_u))
            else:
                mapped[row] = 0
        mapped = scipy.fft.ifft(mapped, axis=1, overwrite_x=True, workers=1)[:, : stolt.ranges.size]
        work[part, : stolt.ranges.size] = mapped * gain

    _pool.run(task, -(-len(work) // rows), workers)
    image = work[:, : stolt.ranges.size]
    image = scipy.fft.ifft(image, axis=0, overwrite_x=True, workers=workers)[: echoes.n_ping].T
    report = Report(
        "omega-k", threads=workers, backend="numba", prepare_seconds=prepared - clock,
        sum_seconds=time.perf_counter() - prepared,
        choices={"interpolation": interpolation, "zero_padding": zero_padding, "reference_range": stolt.r0, "weight": weight},
        notes=strip.notes,
    )  # fmt: skip
    return Image(np.ascontiguousarray(image), strip.grid(stolt.ranges), report, echoes.fc, echoes.speed)


@dataclass(frozen=True, eq=False)
class _Stolt:
    """Axes of the Stolt mapping: frequencies `f` of the padded record, wavenumbers first + step m, m < size, and ranges."""

    strip: Strip
    f: FloatArray
    inside: FloatArray
    first: float
    step: float
    size: int
    ranges: FloatArray
    r0: float
    taps: FloatArray

    def shift_arguments(self, k_u: float) -> tuple[float, ...]:
        """Of `_shift` for the row of one along-track wavenumber."""
        echoes = self.strip.echoes
        return k_u, self.r0, self.strip.start, echoes.fs / self.f.size, echoes.fc, echoes.speed

    def map_arguments(self, k_u: float) -> tuple[float, ...]:
        """Of `_map`."""
        echoes = self.strip.echoes
        turn = self.step * (self.ranges[0] - self.r0)
        return k_u, self.first, self.step, turn, echoes.fs / self.f.size, echoes.fc, echoes.speed

    def gain(self, summed: bool) -> ComplexArray:
        """Factor (range,) after the transform over k_x: its carrier and scale, with the sqrt(range) law where `summed`."""
        echoes, spacing = self.strip.echoes, self.ranges[1] - self.ranges[0]
        scale: npt.NDArray[Any] = echoes.speed / (2 * echoes.fs * spacing) * np.exp(1j * self.first * (self.ranges - self.r0))
        if summed:
            scale = scale * np.sqrt(np.pi * self.ranges) * np.exp(0.25j * np.pi) / self.strip.spacing
        return np.asarray(scale.astype(echoes.dtype))


def _layout(strip: Strip, zero_padding: int, r0: float, width: float, interpolation: str) -> _Stolt:
    """Choose the grids: k_x spans all that the band maps to, the range grid all that may focus outside the record."""
    echoes = strip.echoes
    f = frequencies(zero_padding * echoes.n_sample, echoes.fs)
    lowest, highest = (4 * np.pi * (echoes.fc + sign * width / 2) / echoes.speed for sign in (-1, 1))
    widest = float(np.max(np.abs(strip.k_u[strip.kept])))
    low = np.sqrt(max(lowest**2 - widest**2, 0.0))
    near, far = max(strip.swath[0], 0.0), strip.swath[1]
    if far <= 0:
        raise ValueError(f"echoes: the record ends at slant range {far:g} m: expected samples after transmission")
    spacing = min(echoes.speed / (2 * echoes.fs), 2 * np.pi / (highest - low))
    if np.floor((far - near) / spacing) < 1:
        raise ValueError(f"echoes: a record of {echoes.n_sample} samples: expected at least two ranges after transmission")
    # a point nearer than the record is focused before its start, and must not wrap round onto the far end
    ranges = even_ranges(near, far, spacing)
    margin = min(near * (1 - strip.cosine), far - near)
    size = int(scipy.fft.next_fast_len(int(np.ceil((far - near + margin) / spacing)) + 1))
    step = 2 * np.pi / (size * spacing)
    first = highest - (size - 0.5) * step
    if first < 0:
        first += step * np.ceil(-first / step)
    inside = (np.abs(f) <= width / 2).astype(np.float64)
    return _Stolt(strip, f, inside, first, step, size, ranges, r0, _taps(interpolation, zero_padding))


def _taps(interpolation: str, zero_padding: int) -> FloatArray:
    """Table (phase, tap) of the interpolator: reads between samples 0 and 1 at phase/_TABLE, tap j at sample j + 1 - taps/2."""
    t = np.linspace(0, 1, _TABLE + 1)[:, None]
    if interpolation == "linear":
        return np.concatenate([1 - t, t], axis=1)
    taps = 4 if interpolation == "cubic" else _SINC_TAPS
    u = np.abs(t - (np.arange(taps) + 1 - taps // 2))
    if interpolation == "cubic":
        return np.asarray(np.where(u <= 1, (1.5 * u - 2.5) * u**2 + 1, ((-0.5 * u + 2.5) * u - 4) * u + 2))
    # Kaiser's formula for the transition from the padded record's content to its first image
    attenuation = 2.285 * 2 * np.pi * (1 - 1 / max(zero_padding, 1.25)) * (taps - 1) + 8
    beta = 0.1102 * (attenuation - 8.7)
    inside = np.clip(1 - (u / (taps / 2)) ** 2, 0, None)
    return np.asarray(np.sinc(u) * i0(beta * np.sqrt(inside)) / i0(beta))


# Kernels: they trust their arguments.
@njit(nogil=True, cache=True)
def _shift(row, filters, k_u, r0, start, df, fc, c):  # type: ignore[no-untyped-def]
    """Filter a spectrum in FFT order in place and move its origin of time to the reference range; zero where evanescent."""
    n = row.size
    for i in range(n):
        f = (i if i < (n + 1) // 2 else i - n) * df
        k_2 = 4 * np.pi * (fc + f) / c
        square = k_2 * k_2 - k_u * k_u
        if square > 0.0 and filters[i] != 0.0:
            turns = (r0 * np.sqrt(square)) / (2 * np.pi) - f * start
            angle = 2 * np.pi * (turns - np.floor(turns + 0.5))
            row[i] *= filters[i] * complex(np.cos(angle), np.sin(angle))
        else:
            row[i] = 0.0


@njit(nogil=True, cache=True)
def _map(row, out, taps, summed, k_u, first, step, turn, df, fc, c):  # type: ignore[no-untyped-def]
    """Stolt: read the spectrum `row` at 2k = sqrt(k_x^2 + k_u^2), with the Jacobian and a phase `turn` per step of k_x."""
    n, phases, count = row.size, taps.shape[0] - 1, taps.shape[1]
    lowest = -(n // 2)
    for m in range(out.size):
        k_x = first + step * m
        k_2 = np.sqrt(k_x * k_x + k_u * k_u)
        place = (c * k_2 / (4 * np.pi) - fc) / df
        cell = int(np.floor(place))
        begin = cell + 1 - count // 2
        if cell < lowest or cell + 1 >= lowest + n or k_x <= 0.0:
            out[m] = 0.0
            continue
        fraction = (place - cell) * phases
        phase = min(int(fraction), phases - 1)
        share = fraction - phase
        real = 0.0
        imag = 0.0
        for j in range(count):
            weight = taps[phase, j] + share * (taps[phase + 1, j] - taps[phase, j])
            index = begin + j
            if index < lowest or index >= lowest + n:
                continue
            value = row[index if index >= 0 else index + n]
            real += weight * value.real
            imag += weight * value.imag
        factor = k_x / k_2
        if summed:
            factor *= np.sqrt(2 / k_2) * (k_2 / k_x) ** 1.5
        angle = turn * m
        out[m] = complex(real, imag) * (factor * complex(np.cos(angle), np.sin(angle)))
