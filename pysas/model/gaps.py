"""Samples that are not finite where a recorder padded or blanked its traces: what `nan="mask"` makes of them.

At a trace's ends they shorten what counts as recorded, `Echoes.valid`. Between samples that are finite they are no gap that a
band-limited trace could be read across: such a trace is left out by whoever sums it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray
from pysas.model.echoes import Echoes

Windows = npt.NDArray[np.int64]


def windows_of(traces: ComplexArray, windows: Windows) -> tuple[Windows, int]:
    """First and last samples (ping, channel, 2) of `traces` (ping, channel, sample) without non-finite ones at either end, and
    how many traces this shortens.

    Traces that hold other non-finite samples, or no finite one, keep theirs: they have to be left out. O(samples).
    """
    found, count = windows, 0
    for ping, channels in enumerate(traces):
        finite = np.isfinite(channels)
        for channel in np.flatnonzero(~finite.all(axis=-1)):
            first, last = (int(end) for end in windows[ping, channel])
            place = np.flatnonzero(finite[channel, first : last + 1])
            if not place.size or place.size == last + 1 - first or place[-1] - place[0] + 1 != place.size:
                continue
            if not count:
                found = np.array(windows)
            found[ping, channel] = first + place[0], first + place[-1]
            count += 1
    return found, count


def shortened(echoes: Echoes) -> tuple[Echoes, int]:
    """Echoes whose `valid` leaves out the non-finite samples at their traces' ends, and how many traces this shortens."""
    windows, count = windows_of(echoes.traces, echoes.windows)
    return (with_windows(echoes, windows), count) if count else (echoes, 0)


def with_windows(echoes: Echoes, windows: Windows) -> Echoes:
    """Echoes of which samples within `windows` (ping, channel, 2) were recorded."""
    return echoes.replace(valid=windows if echoes.data.ndim == 3 else windows[:, 0])
