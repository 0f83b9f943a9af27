"""Frequency-domain phase history (stepped-frequency or de-chirped spotlight data) turned into compressed echoes.

Each ping holds the scene's response at K equally spaced frequencies, its phase referred to a delay. One zero-padded inverse
FFT per ping gives the base-band trace about that delay; the phase of the carrier there, reduced in long double, makes it an
ordinary trace that every engine understands. Pings whose frequencies begin elsewhere are turned by the difference; pings of
other steps are summed at the common rate by the chirp z-transform (L. Bluestein, IEEE Trans. Audio 18, 1970), as exactly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.model.phase_history import PhaseHistory, even_grid

_MARGIN = 1.25  # fs over the occupied bandwidth, at least
_BATCH_BYTES = 32 * 2**20
_MOST = 16  # samples of a trace a frequency, or of 64 frequencies: pings whose bands lie further apart have no common base-band
_ALIKE = 1e-11  # of a step, by which the last of K frequencies may be off one step of all pings: pi/2 of it in rad


@_checks.usual_errors
def from_phase_history(
    samples: npt.ArrayLike, freq: npt.ArrayLike, position: npt.ArrayLike, r0: npt.ArrayLike, c: float
) -> Echoes:
    """Compressed echoes of a monostatic phase history.

    The model is samples[p, k] = sum over scatterers of a exp(-4j pi freq[k]/c (|x - position[p]| - r0[p])); a unit
    scatterer peaks at 1. Fitted evenly spaced frequencies stand in for `freq`; `fc` is the fitted one of index K//2.

    Parameters
    ----------
    samples : (ping, K) complex64 or complex128
        Phase history; the dtype is kept.
    freq : (K,)
        Frequencies, Hz, increasing in equal steps.
    position : (ping, 3)
        Antenna (transmitter and receiver), m.
    r0 : (ping,)
        Range to which each ping's phase is referred, m.
    c : float
        Propagation speed, m/s.

    Returns
    -------
    Echoes
        (ping, sample) traces of one unambiguous swath c/(2 df) about r0, fs at least 1.25 times the bandwidth.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or dtype, non-finite values, or frequencies not positive, increasing and equally spaced (to 5e-4 of
        a step, 1.6e-3 rad at the ends of the swath); names the first offending index.

    Notes
    -----
    O(ping K log K) time; the result and about 32 MB of work in memory.
    """
    spectrum = _spectrum(samples)
    pings, count = spectrum.shape
    frequencies = _checks.reals("freq", freq, [(count,)])
    antenna = _checks.reals("position", position, [(pings, 3)], ("ping",))
    reference = _not_negative("r0", r0, pings, "ranges")
    c = _checks.number("c", c, positive=True)
    step, fc = even_grid(frequencies)
    turns = 2 * np.longdouble(fc) * reference.astype(np.longdouble) / np.longdouble(c)
    steps = np.full(pings, step)
    data, fs, valid, bandwidth = _traces(spectrum, np.zeros(pings), steps, turns)
    t0 = 2 * reference / c - (data.shape[1] // 2) / fs
    return Echoes(data, fs=fs, fc=fc, tx=antenna, rx=antenna, c=c, t0=t0, bandwidth=bandwidth, valid=valid)


@_checks.usual_errors
def compressed(history: PhaseHistory) -> Echoes:
    """Compressed echoes of any phase history; a unit scatterer peaks at 1, as with `from_phase_history`.

    Pings may differ in their first frequency and in their step. `fc` is the frequency of index K//2 where that is the same
    in all pings, and else the middle of the band that they occupy together; nothing is interpolated.

    Parameters
    ----------
    history : PhaseHistory

    Returns
    -------
    Echoes
        (ping, sample) traces about each ping's reference, fs at least 1.25 times the bandwidth of all pings together; each
        holds its ping's unambiguous swath of delays, 1/step, where steps differ by `valid`.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or dtype, non-finite values, frequencies or steps that are not > 0, references < 0, delays whose steps
        differ from ping to ping or are longer than 1/bandwidth, bands of pings so far apart that traces would have more than
        16 max(K, 64) samples; names the first offending ping.

    Notes
    -----
    O(ping N log N) time for traces of N samples; the result and about 32 MB of work in memory.
    """
    spectrum = _spectrum(history.samples)
    pings, count = spectrum.shape
    if history.band is not None:
        return _of_delays(history, spectrum)
    first = _positive("first", history.first, pings)
    step = _positive("step", history.step, pings)
    reference = _not_negative("reference", history.reference, pings, "times")
    middle = first + (count // 2) * step
    fc = float(middle[0])
    if np.any(middle != fc):
        fc = float((first.min() + (first + (count - 1) * step).max()) / 2)
    offset = (first - fc) + (count // 2) * step
    turns = np.longdouble(fc) * reference.astype(np.longdouble)
    data, fs, valid, bandwidth = _traces(spectrum, offset, step, turns)
    t0 = reference - (data.shape[1] // 2) / fs
    return _echoes(history, data, fs=fs, fc=fc, t0=t0, bandwidth=bandwidth, valid=valid)


def _of_delays(history: PhaseHistory, samples: ComplexArray) -> Echoes:
    """Traces that lie over delay already, with the carrier's phase at their reference and about one frequency."""
    pings, count = samples.shape
    first = _checks.reals("first", history.first, [(pings,)], ("ping",))
    step = _positive("step", history.step, pings, "s")
    reference = _not_negative("reference", history.reference, pings, "times")
    band = _checks.reals("band", history.band, [(pings, 2)], ("ping",))
    wrong = (band[:, 0] <= 0) | (band[:, 1] <= band[:, 0])
    if wrong.any():
        ping = int(np.argmax(wrong))
        raise ValueError(f"band: {band[ping, 0]:g} to {band[ping, 1]:g} Hz at ping {ping}: expected 0 < lowest < highest")
    # last samples lie within a millionth of a sample of where their own steps put them
    other = np.abs(step - step[0]) * count > 1e-6 * step[0]
    if other.any():
        ping = int(np.argmax(other))
        raise ValueError(f"step: {step[ping]:.12g} s at ping {ping}, {step[0]:.12g} s at ping 0: expected one step of delays")
    middle = band.mean(axis=1)
    fc = float(middle[0]) if np.all(middle == middle[0]) else float((band[:, 0].min() + band[:, 1].max()) / 2)
    fs, bandwidth = 1 / float(step[0]), 2 * float(np.abs(band - fc).max())
    if fs < bandwidth:
        raise ValueError(f"step: {step[0]:g} s for {bandwidth:g} Hz of all pings together: expected at most 1/bandwidth")
    dtype = np.complex64 if samples.dtype.itemsize == 8 else np.complex128
    data = np.empty((pings, count), dtype=dtype)
    for ping in range(pings):
        if not np.isfinite(samples[ping]).all():
            k = int(np.argmin(np.isfinite(samples[ping])))
            raise ValueError(f"samples: {samples[ping, k]} at ping {ping}, delay {k}: expected finite values")
        after = first[ping] + np.longdouble(step[0]) * np.arange(count)
        turns = np.longdouble(middle[ping] - fc) * after - np.longdouble(fc) * np.longdouble(reference[ping])
        data[ping] = samples[ping] * np.exp(2j * np.pi * np.asarray(turns % 1, dtype=np.float64))
    return _echoes(history, data, fs=fs, fc=fc, t0=reference + first, bandwidth=bandwidth)


def _echoes(history: PhaseHistory, data: ComplexArray, **sampling: Any) -> Echoes:
    c = _checks.number("c", history.c, positive=True)
    return Echoes(
        data, c=c, tx=history.tx, rx=history.rx, velocity=history.velocity, ping_time=history.ping_time, attrs=history.attrs,
        **sampling,
    )  # fmt: skip


def _traces(
    spectrum: ComplexArray, offset: FloatArray, step: FloatArray, turns: npt.NDArray[np.longdouble]
) -> tuple[ComplexArray, float, npt.NDArray[np.int64] | None, float]:
    """Traces, their rate, which samples of them count, and the bandwidth.

    `offset` (ping,): frequencies of index K//2 above fc, Hz; `turns`: of the carrier to each ping's reference.
    """
    pings, count = spectrum.shape
    middle = count // 2
    bandwidth = 2 * float(np.max(np.maximum(np.abs(offset - middle * step), np.abs(offset + (count - 1 - middle) * step))))
    finest = float(step.min())
    length = np.ceil(max(_MARGIN * bandwidth / finest, _MARGIN * 2 * middle)) + 1
    if length > _MOST * max(count, 64):
        raise ValueError(
            f"first, step: pings of {bandwidth:.4g} Hz together at steps from {finest:.4g} Hz, {count} frequencies each: "
            f"expected traces of at most {_MOST * max(count, 64)} samples"
        )
    n = scipy.fft.next_fast_len(int(length))
    fs = n * finest
    dtype = np.complex64 if spectrum.dtype.itemsize == 8 else np.complex128
    carrier = np.exp(-2j * np.pi * np.asarray(turns % 1, dtype=np.float64))
    bins = (np.arange(count) - middle) % n
    away = np.arange(n) - n // 2  # samples from the reference
    even = (step - finest) * count <= _ALIKE * finest
    data = np.empty((pings, n), dtype=dtype)
    rows = max(1, _BATCH_BYTES // (3 * 16 * n))
    for start in range(0, pings, rows):
        chosen = slice(start, start + rows)
        part = spectrum[chosen]
        if not np.isfinite(part).all():
            ping, k = (int(i) for i in np.argwhere(~np.isfinite(part))[0])
            raise ValueError(f"samples: {part[ping, k]} at ping {ping + start}, frequency {k}: expected finite values")
        work = np.zeros((part.shape[0], n), dtype=np.complex128)
        work[:, bins] = part * (carrier[chosen, None] * (n / count))
        work = scipy.fft.fftshift(scipy.fft.ifft(work, axis=-1), axes=-1)
        for row in np.flatnonzero(~even[chosen]):
            ping = start + int(row)
            work[row] = _summed(part[row] * (carrier[ping] / count), np.longdouble(step[ping]) / np.longdouble(fs), n)
        turned = np.flatnonzero(offset[chosen])
        if turned.size:
            ramp = (offset[chosen][turned].astype(np.longdouble) / np.longdouble(fs))[:, None] * away % 1
            work[turned] *= np.exp(2j * np.pi * ramp.astype(np.float64))
        data[chosen] = work
    return data, fs, None if even.all() else _swaths(finest / step, n), bandwidth


def _summed(spectrum: ComplexArray, rate: np.longdouble, n: int) -> ComplexArray:
    """The sum over k of spectrum[k] exp(2j pi rate (k - K//2) (m - n//2)) for m = 0 ... n - 1, in O(n log n).

    By k m = (k^2 + m^2 - (m - k)^2)/2 it is a convolution.
    """
    count = spectrum.size
    k = np.arange(count) - count // 2
    m = np.arange(n) - n // 2

    def chirp(j: npt.NDArray[np.int64]) -> ComplexArray:
        return np.asarray(np.exp(2j * np.pi * (rate / 2 * j**2 % 1).astype(np.float64)))

    size = scipy.fft.next_fast_len(n + count - 1)
    kernel = scipy.fft.fft(chirp(np.arange(n + count - 1) + m[0] - k[-1]).conj(), size)
    found = scipy.fft.ifft(scipy.fft.fft(spectrum * chirp(k), size) * kernel)[count - 1 : count - 1 + n]
    return np.asarray(found * chirp(m))


def _swaths(share: FloatArray, n: int) -> npt.NDArray[np.int64]:
    """First and last sample of the unambiguous swaths, `share` of n samples about the reference."""
    half = share * n / 2
    first = np.maximum(np.ceil(n // 2 - half), 0)
    last = np.minimum(np.ceil(n // 2 + half) - 1, n - 1)
    return np.stack([first, last], axis=1).astype(np.int64)


def _spectrum(samples: npt.ArrayLike) -> ComplexArray:
    spectrum = _checks.samples("samples", samples, (2,))
    if spectrum.shape[1] < 2:
        raise ValueError(f"samples: expected at least 2 frequencies, found shape {spectrum.shape}")
    return spectrum


def _not_negative(name: str, value: npt.ArrayLike, pings: int, what: str) -> FloatArray:
    array = _checks.reals(name, value, [(pings,)], ("ping",))
    if np.any(array < 0):
        ping = int(np.argmax(array < 0))
        raise ValueError(f"{name}: {array[ping]} at ping {ping}: expected {what} >= 0")
    return array


def _positive(name: str, value: npt.ArrayLike, pings: int, unit: str = "Hz") -> FloatArray:
    array = _checks.reals(name, value, [(pings,)], ("ping",))
    if np.any(array <= 0):
        ping = int(np.argmax(array <= 0))
        raise ValueError(f"{name}: {array[ping]} at ping {ping}: expected {unit} > 0")
    return array
