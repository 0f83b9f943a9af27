"""Frequency-domain phase history (stepped-frequency or de-chirped spotlight data) turned into compressed echoes.

Each ping holds the scene's response at K equally spaced frequencies, its phase referred to the range r0 of a scene
centre. One zero-padded inverse FFT per ping gives the base-band trace about the delay 2 r0/c; the phase of the carrier
at that delay, reduced in long double, makes it an ordinary trace that every engine understands.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes

_MARGIN = 1.25  # fs over the occupied bandwidth, at least
# Largest deviation of a frequency from the even grid, in steps. A deviation of d steps turns the phase by pi d at the
# ends of the unambiguous swath, |R - r0| = c/(4 df), and by less inside: here at most 1.6e-3 rad, -56 dB. Frequencies
# near 10 GHz stored as float32 are off by up to 512 Hz, 3.5e-4 steps in the public Gotcha data (1.47 MHz steps).
_UNEVEN = 5e-4
_BATCH_BYTES = 32 * 2**20


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
    spectrum = _checks.samples("samples", samples, (2,))
    pings, count = spectrum.shape
    if count < 2:
        raise ValueError(f"samples: expected at least 2 frequencies, found shape {spectrum.shape}")
    frequencies = _checks.reals("freq", freq, [(count,)])
    antenna = _checks.reals("position", position, [(pings, 3)], ("ping",))
    reference = _checks.reals("r0", r0, [(pings,)], ("ping",))
    if np.any(reference < 0):
        ping = int(np.argmax(reference < 0))
        raise ValueError(f"r0: {reference[ping]} at ping {ping}: expected ranges >= 0")
    c = _checks.number("c", c, positive=True)
    step, fc = _even_grid(frequencies)
    middle = count // 2
    bandwidth = 2 * middle * step
    n = scipy.fft.next_fast_len(int(np.ceil(_MARGIN * 2 * middle)) + 1)
    fs = n * step
    dtype = np.complex64 if spectrum.dtype.itemsize == 8 else np.complex128
    turns = np.asarray(2 * np.longdouble(fc) * reference.astype(np.longdouble) / np.longdouble(c) % 1, dtype=np.float64)
    carrier = np.exp(-2j * np.pi * turns)
    bins = (np.arange(count) - middle) % n
    data = np.empty((pings, n), dtype=dtype)
    rows = max(1, _BATCH_BYTES // (3 * 16 * n))
    for start in range(0, pings, rows):
        part = spectrum[start : start + rows]
        if not np.isfinite(part).all():
            ping, k = (int(i) for i in np.argwhere(~np.isfinite(part))[0])
            raise ValueError(f"samples: {part[ping, k]} at ping {ping + start}, frequency {k}: expected finite values")
        work = np.zeros((part.shape[0], n), dtype=np.complex128)
        work[:, bins] = part * (carrier[start : start + rows, None] * (n / count))
        data[start : start + rows] = scipy.fft.fftshift(scipy.fft.ifft(work, axis=-1), axes=-1)
    t0 = 2 * reference / c - (n // 2) / fs
    return Echoes(data, fs=fs, fc=fc, tx=antenna, rx=antenna, c=c, t0=t0, bandwidth=bandwidth)


def _even_grid(freq: FloatArray) -> tuple[float, float]:
    """Step and middle frequency (index K//2) of the least-squares even grid through `freq`, Hz, or ValueError."""
    steps = np.diff(freq)
    if freq[0] <= 0:
        raise ValueError(f"freq[0]={freq[0]:g} Hz: expected frequencies > 0")
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0)) + 1
        raise ValueError(f"freq[{k}]={freq[k]:.12g} Hz: expected more than freq[{k - 1}]={freq[k - 1]:.12g} Hz")
    usual = float(np.median(steps))
    uneven = np.abs(steps - usual) > 2 * _UNEVEN * usual
    centred = np.arange(freq.size) - (freq.size - 1) / 2
    middle = float(freq[freq.size // 2])
    offset = freq - middle
    step = float(centred @ offset / (centred @ centred))
    fitted = offset.mean() + step * centred
    off = np.abs(offset - fitted) > _UNEVEN * step
    if uneven.any() or off.any():
        first = int(np.argmax(uneven)) + 1 if uneven.any() else int(np.argmax(off))
        raise ValueError(
            f"freq[{first}]={freq[first]:.12g} Hz: expected equal steps of {usual:.9g} Hz, to {_UNEVEN:g} of a step"
        )
    return step, middle + float(fitted[freq.size // 2])
