"""Phase history: what each ping heard at equally spaced frequencies, as radars and stepped-frequency sonars record it.

Or at equally spaced delays, where a radar has transformed it already.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pysas._checks import ComplexArray, FloatArray

# Largest deviation of a frequency from the even grid, in steps. A deviation of d steps turns the phase by pi d at the
# ends of the unambiguous swath, |R - r0| = c/(4 df), and by less inside: here at most 1.6e-3 rad, -56 dB. Frequencies
# near 10 GHz stored as float32 are off by up to 512 Hz, 3.5e-4 steps in the public Gotcha data (1.47 MHz steps).
_UNEVEN = 5e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseHistory:
    """The model is samples[p, k] = sum over scatterers of a exp(-2j pi f[p, k] (tau[p] - reference[p])).

    tau is the two-way travel time by way of a scatterer and f[p, k] = first[p] + k step[p]. With a `band` samples lie over
    delay instead, about its middle b[p]: samples[p, k] = sum of a q(first[p] + k step[p] - (tau[p] - reference[p]))
    exp(-2j pi b[p] (tau[p] - reference[p])) with q real and 1 at 0.

    Parameters
    ----------
    samples : (ping, K) complex64 or complex128
        Responses.
    first, step : (ping,)
        Frequency of sample 0 and the steps to the others, Hz; with a `band` the delay after `reference`, s.
    tx, rx : (ping, 3)
        Transmitter at transmission; receiver at transmission, m.
    reference : (ping,)
        Two-way travel time to which each ping's phase is referred, s.
    c : float
        Propagation speed, m/s.
    band : (ping, 2), optional
        Lowest and highest frequency of samples over delay, Hz. None: samples lie over frequency.
    velocity : (ping, 3), optional
        Of the receivers until the echo arrives, m/s. None: they stand.
    ping_time : (ping,), optional
        Time of each transmission, s.
    attrs : mapping
        Anything else.
    """

    samples: ComplexArray
    first: FloatArray
    step: FloatArray
    tx: FloatArray
    rx: FloatArray
    reference: FloatArray
    c: float
    band: FloatArray | None = None
    velocity: FloatArray | None = None
    ping_time: FloatArray | None = None
    attrs: Mapping[str, Any] = field(default_factory=dict)


def even_grid(freq: FloatArray) -> tuple[float, float]:
    """Step and middle frequency (index K//2) of the least-squares even grid through `freq` (K,), Hz.

    ValueError where they are not positive, increasing and equally spaced to 5e-4 of a step; names the first that is not.
    """
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
