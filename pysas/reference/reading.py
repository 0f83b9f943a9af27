"""Samples at exact delays, for the second opinions on a track: one trace at a time, plain and slow.

Delay and interpolation are this module's own: the delay is the root of a quadratic equation, the trace is made finer by a
Fourier transform and read by polynomials. It relies on nothing of pysas; what it reads is the band-limited signal that
`reference.exact` defines.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas._checks import FloatArray

FINER = 8
NODES = range(-5, 7)  # fine samples about the cell that is read
GUARD = 16  # samples kept on either side of the record
PASS, STOP = 1 / 2.2, 0.5  # cycles per sample between which the low-pass falls

Complex = npt.NDArray[np.complex128]


def delays(points: FloatArray, tx: FloatArray, rx: FloatArray, velocity: FloatArray, c: float) -> FloatArray:
    """Travel times (...) from `tx` by `points` (..., 3) to a receiver that starts at `rx` and moves on, s.

    c tau = a + |w - v tau| with a = |x - tx| and w = x - rx is, squared,
    (c^2 - v^2) tau^2 - 2 (c a - w.v) tau + a^2 - w^2 = 0, of which the larger root is the echo.
    """
    away, back = points - tx, points - rx
    a = np.sqrt(np.sum(away**2, axis=-1))
    half = c * a - np.sum(back * velocity, axis=-1)
    square = c**2 - np.sum(np.square(velocity), axis=-1)
    rest = a**2 - np.sum(back**2, axis=-1)
    return np.asarray((half + np.sqrt(half**2 - square * rest)) / square)


def finer(trace: npt.NDArray[np.complexfloating]) -> Complex:
    """The trace at `FINER` times its rate, from `GUARD` samples before its first on; extended with zeros as long as itself,
    low-passed by 1 up to fs/2.2, falling as a squared cosine to 0 at fs/2."""
    n = trace.size
    size = int(scipy.fft.next_fast_len(n + max(n, 1024)))
    frequency = np.abs(scipy.fft.fftfreq(size))
    ramp = np.clip((frequency - PASS) / (STOP - PASS), 0, 1)
    spectrum = scipy.fft.fft(trace.astype(np.complex128), size) * np.cos(np.pi / 2 * ramp) ** 2
    wide = np.zeros(FINER * size, dtype=np.complex128)
    positive = (size + 1) // 2
    wide[:positive], wide[positive - size :] = spectrum[:positive], spectrum[positive:]
    fine = FINER * scipy.fft.ifft(wide)
    return np.concatenate([fine[-FINER * GUARD :], fine[: FINER * (n + GUARD)]])


def read(fine: Complex, position: FloatArray) -> Complex:
    """What `finer` made of a trace, at `position` (samples from its first): Lagrange's polynomials through 12 nodes, wrong by
    at most 1e-9 of the strongest frequency (P. J. Davis 1963, Eq 3.1.1); zero farther off the record than `GUARD` allows."""
    place = (position + GUARD) * FINER
    inside = (place >= -NODES[0]) & (place < fine.size - NODES[-1] - 1)
    place = np.where(inside, place, -NODES[0])
    cell = np.floor(place).astype(np.intp)
    t = place - cell
    value = np.zeros(t.shape, dtype=np.complex128)
    for node in NODES:
        weight = np.ones(t.shape)
        for other in NODES:
            if other != node:
                weight *= (t - other) / (node - other)
        value += weight * fine[cell + node]
    return np.where(inside, value, 0)
