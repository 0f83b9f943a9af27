"""How large samples are, of whole traces and about places of them, in Numba. Everything here trusts its arguments."""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def peaks(traces, valid, begin, end, out):
    """Largest real or imaginary part of samples begin to end of each trace (ping, channel), or inf where any that was recorded,
    valid (ping, channel, 2), is not finite.
    """
    pings, channels, _ = traces.shape
    for ping in range(pings):
        for channel in range(channels):
            finite, most = True, 0.0
            for n in range(valid[ping, channel, 0], valid[ping, channel, 1] + 1):
                s = traces[ping, channel, n]
                finite &= np.isfinite(s.real) and np.isfinite(s.imag)
            for n in range(begin[ping, channel], end[ping, channel]):
                s = traces[ping, channel, n]
                most = max(most, abs(s.real), abs(s.imag))
            out[ping, channel] = most if finite else np.inf


@njit(nogil=True, cache=True)
def mean_squares(data, valid, trace, place, reach, inverse, out):
    """See summation.mean_squares."""
    channels = data.shape[1]
    for i in range(trace.size):
        ping, channel = divmod(trace[i], channels)
        total = 0.0
        for n in range(max(place[i] - reach, valid[trace[i], 0]), min(place[i] + reach, valid[trace[i], 1]) + 1):
            s = data[ping, channel, n]
            total += (np.float64(s.real) * inverse) ** 2 + (np.float64(s.imag) * inverse) ** 2
        out[i] = total / (2 * reach + 1)
