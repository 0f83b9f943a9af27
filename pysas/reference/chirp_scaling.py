"""Chirp scaling: a range-Doppler algorithm without interpolation, for raw echoes of a linear FM pulse.

A slight change of the chirp's rate makes all range trajectories congruent with that of the reference range, so that one phase
removes the migration of all. It relies on `stripmap` for checks and axes.
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
from pysas.model.pulse import LFM
from pysas.reference.range_doppler import migration
from pysas.reference.stripmap import Strip, band, frequencies, prepare, reference

_VANISHING = 0.8  # of c^2 S0^3 that 8 pi r K k_u^2 may reach: the rate K_s is then five times K
_HIGHER_ORDER_BAND = 1.2  # bandwidths that the higher-order phase keeps, as the chirp's spectrum has skirts


def chirp_scaling(
    raw: Echoes,
    *,
    reference_range: float | None = None,
    higher_order: bool = True,
    range_bandwidth: float | None = None,
    along_bandwidth: float | None = None,
    side: str | None = None,
    threads: int | None = None,
) -> Image:
    """Image of a straight, even track by the chirp scaling algorithm.

    Parameters
    ----------
    raw : Echoes
        Raw echoes of an LFM pulse (either sweep) demodulated at its centre, one channel, monostatic, evenly spaced along x.
    reference_range : float, optional
        Slant range at which nothing but the second-order expansion is approximate, m; default: the middle of the record.
    higher_order : bool
        Remove the phase beyond second order in frequency at the reference range first.
    range_bandwidth, along_bandwidth, side, threads
        As for `omega_k`.

    Returns
    -------
    Image
        On the plane grid of the slant plane, slant ranges every c/(2 fs), phases as in `backproject`; a point's peak grows
        as sqrt(range), as omega-k's with weight "flat". `report.choices` holds the least sample rate that the swath needs.

    Raises
    ------
    ValueError, TypeError
        As `range_doppler`; compressed echoes, another pulse; an up-chirp whose rate K_s comes near its pole within the record
        (the range is named); a sample rate below what scaling needs for the ends of the record, where they would alias.

    Notes
    -----
    R. Sathishkumar et al., Eqs 3-7, with the formulas lost in print derived anew. With K signed, r0 the reference range, S0
    and C as in `range_doppler`:

    1/K_s = 1/K - 8 pi r0 k_u^2/(c^2 S0^3)                          (Eq 3; second-order term of -r sqrt(4k^2 - k_u^2))
    0: exp(j r0 [sqrt(4k^2 - k_u^2) - S0 - (4 k0/(c S0)) w + (2 k_u^2/(c^2 S0^3)) w^2]) in (f, k_u)     (`higher_order`)
    1: exp(j pi K_s C (t - (2 r0/c)(1 + C))^2) in (t, k_u): rate K_s (1 + C), centre (2/c)(r + r0 C)
    2: exp(j w^2/(4 pi K_s (1 + C)) + j w (2 r0/c) C) in (f, k_u): compression and migration
    3: exp(j r S0 - j (4 pi/c^2) K_s C (1 + C) (r - r0)^2) in (t, k_u)

    Scaling multiplies the bandwidth by 1 + C and moves that of a point at r by 2 K_s C (1 + C)(r - r0)/c Hz:
    fs >= |K| T (1 + C) + 4 |K_s| C (1 + C) |r - r0|/c. K_s has a pole where 8 pi r K k_u^2 = c^2 S0^3, for K > 0 only.

    The amplitude is divided by sqrt(1 + C), so that every (k_x, k_u) counts as it was recorded. O(N log N) in samples; memory
    about 4 times the data.
    """
    clock = time.perf_counter()
    workers = _checks.threads(threads)
    if not isinstance(higher_order, bool | np.bool_):
        raise TypeError(f"higher_order={higher_order!r}: expected True or False")
    strip = prepare(raw, along_bandwidth, "raw", side)
    pulse = _pulse(raw)
    r0 = reference(raw, reference_range)
    width = band(raw, range_bandwidth)
    curvature = migration(strip)
    _check_rate(strip, pulse)
    rate = _scaled_rate(strip, pulse, r0)
    n = raw.n_sample
    needed = _least_fs(strip, pulse, curvature, rate, r0)
    if needed > raw.fs:
        raise ValueError(
            f"raw: fs={raw.fs:g} Hz: chirp scaling moves the ends of the record, {strip.swath[0]:.4g} and "
            f"{strip.swath[1]:.4g} m, out of the sampled band: expected at least {needed:.4g} Hz, a longer pulse, a shorter "
            f"record or a nearer reference_range"
        )
    f = frequencies(2 * n, raw.fs)
    # an echo's centre, at half the pulse's length, stands for its travel time
    t = strip.start - pulse.duration / 2 + np.arange(f.size) / raw.fs
    ranges = raw.speed / 2 * t
    seen = np.flatnonzero((ranges >= max(strip.swath[0], 0.0)) & (ranges <= strip.swath[1]))
    rows = slice(int(seen[0]), int(seen[-1]) + 1)
    work = strip.spectrum(n, workers)
    unit = np.exp(-0.25j * np.pi * np.sign(pulse.rate)) / np.sqrt(abs(pulse.rate)) / pulse.energy
    inside = np.abs(f) <= width / 2
    prepared = time.perf_counter()
    out = np.zeros((len(work), seen.size), dtype=work.dtype)

    def task(row: int) -> None:
        if not strip.kept[row]:
            return
        k_u, c1, k_s = float(strip.k_u[row]), float(curvature[row]), float(rate[row])
        s0 = np.sqrt((2 * strip.k0) ** 2 - k_u**2)
        padded = np.zeros(f.size, dtype=np.complex128)
        padded[:n] = work[row, :n]
        if higher_order:
            padded = scipy.fft.fft(padded)
            padded *= _beyond_second_order(strip, f, k_u, s0, r0) * (np.abs(f) <= _HIGHER_ORDER_BAND * abs(pulse.bandwidth) / 2)
            padded = scipy.fft.ifft(padded)
        padded *= np.exp(1j * np.pi * k_s * c1 * (t - 2 * r0 / raw.speed * (1 + c1)) ** 2)
        padded = scipy.fft.fft(padded)
        padded *= inside * np.exp(1j * np.pi * (f**2 / (k_s * (1 + c1)) + 4 * f * r0 / raw.speed * c1))
        line = scipy.fft.ifft(padded)[rows]
        x = ranges[rows]
        residual = 4 * np.pi / raw.speed**2 * k_s * c1 * (1 + c1) * (x - r0) ** 2
        out[row] = line * np.exp(1j * (x * s0 - residual)) * (unit / np.sqrt(1 + c1))

    _pool.run(task, len(work), workers)
    data = scipy.fft.ifft(out, axis=0, overwrite_x=True, workers=workers)[: raw.n_ping].T
    choices: dict[str, Any] = {"higher_order": bool(higher_order), "reference_range": r0, "least_fs": needed}
    report = Report(
        "chirp scaling", threads=workers, backend="numpy", prepare_seconds=prepared - clock, choices=choices,
        sum_seconds=time.perf_counter() - prepared, notes=strip.notes,
    )  # fmt: skip
    return Image(np.ascontiguousarray(data), strip.grid(ranges[rows]), report, raw.fc, raw.speed)


def _pulse(raw: Echoes) -> LFM:
    if raw.compressed or not isinstance(raw.pulse, LFM):
        found = "compressed=True" if raw.compressed else f"pulse={type(raw.pulse).__name__}"
        raise ValueError(f"raw: {found}: expected raw echoes of an LFM pulse, whose chirp is what is scaled")
    if abs(raw.pulse.fc - raw.fc) > 1e-9 * raw.fc:
        raise ValueError(f"raw: fc={raw.fc:g} Hz, the pulse's {raw.pulse.fc:g} Hz: expected demodulation at the pulse's centre")
    if raw.pulse.duration >= raw.n_sample / raw.fs:
        raise ValueError(
            f"raw: pulse of {raw.pulse.duration:g} s: expected shorter than the record, {raw.n_sample / raw.fs:g} s"
        )
    return raw.pulse


def _second_order(strip: Strip) -> FloatArray:
    """8 pi k_u^2/(c^2 S0^3) of each processed row, s^2/m (0 in others)."""
    k_u = np.where(strip.kept, strip.k_u, 0.0)
    s0 = np.sqrt((2 * strip.k0) ** 2 - k_u**2)
    return np.asarray(8 * np.pi * k_u**2 / (strip.echoes.speed**2 * s0**3))


def _check_rate(strip: Strip, pulse: LFM) -> None:
    """The secondary rate passes through zero at a range of its own for each k_u; the least of these must lie far beyond."""
    worst = float(np.max(_second_order(strip))) * pulse.rate
    if worst <= 0:
        return
    limit = _VANISHING / worst
    if strip.swath[1] > limit:
        raise ValueError(
            f"raw: the rate of secondary range compression passes through zero at slant range {1 / worst:.4g} m: expected an "
            f"up-chirp's record to end before {limit:.4g} m, found {strip.swath[1]:.4g} m (use a down-chirp, a longer pulse or "
            f"a smaller along_bandwidth)"
        )


def _scaled_rate(strip: Strip, pulse: LFM, r0: float) -> FloatArray:
    """K_s(k_u; r0), Hz/s."""
    return np.asarray(1 / (1 / pulse.rate - r0 * _second_order(strip)))


def _least_fs(strip: Strip, pulse: LFM, curvature: FloatArray, rate: FloatArray, r0: float) -> float:
    """Sample rate that holds the scaled spectra of points anywhere in the record, Hz."""
    near, far = strip.swath
    last = far - pulse.duration * strip.echoes.speed / 2
    offset = max(abs(near - r0), abs(last - r0))
    moved = np.abs(rate) * curvature * (1 + curvature) * 4 * offset / strip.echoes.speed
    return float(np.max(abs(pulse.bandwidth) * (1 + curvature) + moved))


def _beyond_second_order(strip: Strip, f: FloatArray, k_u: float, s0: float, r0: float) -> npt.NDArray[np.complex128]:
    """Step 0; zero where nothing propagates."""
    c = strip.echoes.speed
    k, w = strip.wavenumber(f), 2 * np.pi * f
    k_x = np.sqrt(np.clip(4 * k**2 - k_u**2, 0, None))
    phase = k_x - s0 - 4 * strip.k0 / (c * s0) * w + 2 * k_u**2 / (c**2 * s0**3) * w**2
    return np.asarray(np.where(k_x > 0, np.exp(1j * r0 * phase), 0.0))
