"""Range-Doppler: range compression and range migration correction apart, with secondary range compression at one range.

It relies on `stripmap` for checks and axes. Rows of one along-track wavenumber are independent, as in omega-k; what is
approximate is that the coupling of range and along-track frequency beyond second order is removed at the reference range only.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.image import Image, Report
from pysas.reference.stripmap import Strip, band, even_ranges, frequencies, matched_filter, prepare, reference

_HALF_WIDTH = 8  # of the windowed sinc, samples: 16 points
_LINEAR_RATE = 4  # oversampling before linear interpolation: its error is then 2 % at the band's edge


def range_doppler(
    echoes: Echoes,
    *,
    secondary: str = "exact",
    interpolation: str = "sinc",
    reference_range: float | None = None,
    range_bandwidth: float | None = None,
    along_bandwidth: float | None = None,
    side: str | None = None,
    threads: int | None = None,
) -> Image:
    """Image of a straight, even track by the range-Doppler algorithm.

    Parameters
    ----------
    echoes : Echoes
        One channel, monostatic, evenly spaced along x; range-compressed, or raw with their pulse (then compressed here).
    secondary : {"exact", "second-order", "none"}
        Secondary range compression at `reference_range`: of all orders, of second order in frequency, or left out.
    interpolation : {"sinc", "linear"}
        Of range migration correction: 16-point sinc under a Lanczos window, or linear at four times the sample rate.
    reference_range, range_bandwidth, along_bandwidth, side, threads
        As for `omega_k`.

    Returns
    -------
    Image
        On the plane grid of the slant plane, slant ranges every c/(2 fs), phases as in `backproject`; a point's peak grows
        as sqrt(range), as omega-k's with weight "flat".

    Raises
    ------
    ValueError, TypeError
        As `omega_k`; moreover k_u that reach the evanescent edge 2k at fc, where migration is unbounded.

    Notes
    -----
    With k0 = 2 pi fc/c, S0 = sqrt(4 k0^2 - k_u^2) and C = 2 k0/S0 - 1 (R. Sathishkumar et al., Eqs 4-5): multiply by
    exp(j r0 [sqrt(4 k^2 - k_u^2) - S0 - (4 k0/(c S0)) w]), w = 2 pi f, or its term of second order,
    exp(-2j r0 k_u^2 w^2/(c^2 S0^3)); read each row at t = (2 r/c)(1 + C); multiply by exp(j r S0). The phase of third and
    higher order of points away from r0 stays: the band-edge error grows as |r - r0|.

    O(N log N) in samples; memory about 3 times the data.
    """
    clock = time.perf_counter()
    _checks.choice("secondary", secondary, ("exact", "second-order", "none"))
    _checks.choice("interpolation", interpolation, ("sinc", "linear"))
    workers = _checks.threads(threads)
    strip = prepare(echoes, along_bandwidth, side=side)
    r0 = reference(echoes, reference_range)
    width = band(echoes, range_bandwidth)
    curvature = migration(strip)
    n = echoes.n_sample
    # secondary compression moves echoes of other ranges by less than the record: no wrapping into it
    f = frequencies(2 * n, echoes.fs)
    matched = matched_filter(echoes, f)
    filters = np.where(np.abs(f) <= width / 2, 1.0 if matched is None else matched, 0.0)
    near, far = max(strip.swath[0], 0.0), strip.swath[1]
    ranges = even_ranges(near, far, echoes.speed / (2 * echoes.fs))
    work = strip.spectrum(ranges.size, workers)
    prepared = time.perf_counter()

    def task(row: int) -> None:
        line = work[row]
        if not strip.kept[row]:
            line[: ranges.size] = 0
            return
        k_u = float(strip.k_u[row])
        spectrum = scipy.fft.fft(line[:n].astype(np.complex128), f.size) * filters
        spectrum *= np.exp(1j * r0 * coupling(strip, f, k_u, secondary)) * propagating(strip, f, k_u)
        place = (2 * ranges / echoes.speed * (1 + curvature[row]) - strip.start) * echoes.fs
        read = _sinc if interpolation == "sinc" else _linear
        s0 = np.sqrt((2 * strip.k0) ** 2 - k_u**2)
        line[: ranges.size] = read(spectrum, place, n) * np.exp(1j * ranges * s0)

    _pool.run(task, len(work), workers)
    data = scipy.fft.ifft(work[:, : ranges.size], axis=0, overwrite_x=True, workers=workers)[: echoes.n_ping].T
    choices: dict[str, Any] = {"secondary": secondary, "interpolation": interpolation, "reference_range": r0}
    report = Report(
        "range-Doppler", threads=workers, backend="numpy", prepare_seconds=prepared - clock, choices=choices,
        sum_seconds=time.perf_counter() - prepared, notes=strip.notes,
    )  # fmt: skip
    return Image(np.ascontiguousarray(data), strip.grid(ranges), report, echoes.fc, echoes.speed)


def migration(strip: Strip) -> FloatArray:
    """Curvature factor C = 2 k0/S0 - 1 of each row (Eq 4), 0 in those that are not processed.

    Raises where a processed |k_u| reaches 2 k0.
    """
    edge = 2 * strip.k0
    widest = float(np.max(np.abs(strip.k_u[strip.kept])))
    if widest >= 0.999 * edge:
        raise ValueError(
            f"along_bandwidth: k_u reaches {widest:.4g} rad/m: expected below 0.999 of the evanescent edge "
            f"4 pi fc/c = {edge:.4g} rad/m (give a smaller along_bandwidth, or use omega_k)"
        )
    k_u = np.where(strip.kept, strip.k_u, 0.0)
    return np.asarray(edge / np.sqrt(edge**2 - k_u**2) - 1)


def propagating(strip: Strip, f: FloatArray, k_u: float) -> npt.NDArray[np.bool_]:
    """Where waves of these frequencies propagate: 2k > |k_u|."""
    return np.asarray(2 * strip.wavenumber(f) > abs(k_u))


def coupling(strip: Strip, f: FloatArray, k_u: float, secondary: str) -> FloatArray:
    """Phase per metre of reference range that secondary range compression adds; 0 where nothing propagates."""
    c = strip.echoes.speed
    k0 = strip.k0
    s0 = np.sqrt(4 * k0**2 - k_u**2)
    w = 2 * np.pi * f
    if secondary == "none":
        return np.zeros(f.size)
    if secondary == "second-order":
        return np.asarray(-2 * k_u**2 * w**2 / (c**2 * s0**3))
    k_x = np.sqrt(np.clip(4 * strip.wavenumber(f) ** 2 - k_u**2, 0, None))
    return np.asarray(np.where(k_x > 0, k_x - s0 - 4 * k0 / (c * s0) * w, 0.0))


def _sinc(spectrum: npt.NDArray[np.complex128], place: FloatArray, n: int) -> npt.NDArray[np.complex128]:
    """The row at `place` (samples): 16-point Lanczos-windowed sinc; zero outside the record's n samples."""
    trace = np.pad(scipy.fft.ifft(spectrum)[:n], _HALF_WIDTH)
    inside = (place >= 0) & (place <= n - 1)
    cell = np.floor(np.where(inside, place, 0.0)).astype(np.intp)
    share = place - cell
    # sines of the sums share - lag are made of those of share: sinc(t) sinc(t/w), sin(pi t) = (-1)^lag sin(pi share)
    slow_sine, slow_cosine = np.sin(np.pi * share / _HALF_WIDTH), np.cos(np.pi * share / _HALF_WIDTH)
    total = np.zeros(place.size, dtype=np.complex128)
    for lag in range(1 - _HALF_WIDTH, _HALF_WIDTH + 1):
        angle = np.pi * lag / _HALF_WIDTH
        window = (1 - 2 * (lag % 2)) * (slow_sine * np.cos(angle) - slow_cosine * np.sin(angle))
        total += trace[cell + lag + _HALF_WIDTH] * (window / np.where(share == lag, 1.0, share - lag) ** 2)
    total *= np.sin(np.pi * share) * _HALF_WIDTH / np.pi**2
    total = np.where(share == 0, trace[cell + _HALF_WIDTH], total)
    return np.where(inside, total, 0.0)


def _linear(spectrum: npt.NDArray[np.complex128], place: FloatArray, n: int) -> npt.NDArray[np.complex128]:
    """The row at `place` (samples): linear between samples at four times the rate; zero outside the record."""
    size = spectrum.size
    fine = np.zeros(size * _LINEAR_RATE, dtype=np.complex128)
    positive = (size + 1) // 2
    fine[:positive] = spectrum[:positive]
    fine[fine.size - (size - positive) :] = spectrum[positive:]
    trace = _LINEAR_RATE * scipy.fft.ifft(fine)[: (n - 1) * _LINEAR_RATE + 1]
    at = np.arange(trace.size) / _LINEAR_RATE
    return np.asarray(
        np.interp(place, at, trace.real, left=0, right=0) + 1j * np.interp(place, at, trace.imag, left=0, right=0)
    )
