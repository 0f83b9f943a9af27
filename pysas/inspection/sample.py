"""The few pings and channels that are looked at closely, filtered to the band that the echoes declare.

Which they are depends on the counts alone, so a file is always told the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas._checks import ComplexArray, FloatArray
from pysas.inspection.levels import Levels
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

MOST_PINGS = 128
MOST_CHANNELS = 16
MOST_SAMPLES = 4096  # of a trace
MOST_TRACES = 512

Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Sample:
    """Pings that follow each other, and some of their channels.

    Attributes
    ----------
    echoes : Echoes
    pings, channels : (ping,), (channel,) int
        Which they are.
    first : int
        Sample of the record that theirs begin with.
    traces : (ping, channel, sample) complex
        As recorded; those that are not finite are 0.
    """

    echoes: Echoes
    pings: Index
    channels: Index
    first: int
    traces: ComplexArray

    @property
    def band(self) -> tuple[float, float]:
        """Middle and width of the declared band, Hz about fc."""
        echoes = self.echoes
        if isinstance(echoes.pulse, LFM):
            return echoes.pulse.fc - echoes.fc, echoes.pulse.occupied_bandwidth
        return 0.0, echoes.occupied_bandwidth

    @property
    def tx(self) -> FloatArray:
        """(ping, 3), m."""
        return self.echoes.tx[self.pings]

    @property
    def rx(self) -> FloatArray:
        """(ping, channel, 3), m."""
        return self.echoes.receivers[np.ix_(self.pings, self.channels)]

    @cached_property
    def size(self) -> int:
        """Of transforms: the samples and as long a pulse."""
        n = self.traces.shape[-1]
        longest = n if self.pulse is None else self.pulse.size
        return int(scipy.fft.next_fast_len(n + min(n, longest)))

    @cached_property
    def pulse(self) -> Complex | None:
        """The pulse's samples from its leading edge on; None where nobody knows it."""
        pulse, fs = self.echoes.pulse, self.echoes.fs
        if pulse is None:
            return None
        if not isinstance(pulse, LFM):
            return np.asarray(pulse, dtype=np.complex128)
        start, stop = pulse.support
        return pulse.waveform(np.arange(np.ceil(start * fs), np.floor(stop * fs) + 1) / fs, self.echoes.fc)

    @cached_property
    def transfer(self) -> Complex | None:
        """The pulse's spectrum of largest value 1, its leading edge at t = 0. None: unknown, or too long for these samples."""
        if self.pulse is None or self.pulse.size > self.traces.shape[-1]:
            return None
        first = 0
        if isinstance(self.echoes.pulse, LFM):
            first = int(np.ceil(self.echoes.pulse.support[0] * self.echoes.fs))
        padded = np.zeros(self.size, dtype=complex)
        padded[: self.pulse.size] = self.pulse
        spectrum = scipy.fft.fft(np.roll(padded, first))
        largest = np.abs(spectrum).max()
        return np.asarray(spectrum / largest) if largest > 0 else None

    @cached_property
    def spectra(self) -> ComplexArray:
        """Of the traces, zero-padded; (ping, channel, frequency)."""
        return np.asarray(scipy.fft.fft(self.traces, self.size, axis=-1))

    def back(self, spectra: ComplexArray) -> ComplexArray:
        """The samples of spectra."""
        return np.asarray(scipy.fft.ifft(spectra, axis=-1)[..., : self.traces.shape[-1]])

    @cached_property
    def compressed(self) -> ComplexArray:
        """The traces after the matched filter, or as they are where they have been through it or it is not known."""
        if self.echoes.compressed or self.transfer is None:
            return self.traces
        return self.back(self.spectra * np.conj(self.transfer).astype(self.traces.dtype))


def chosen(
    echoes: Echoes,
    levels: Levels,
    pings: int = MOST_PINGS,
    channels: int = MOST_CHANNELS,
    without: Sequence[int] = (),
) -> Sample:
    """At most so many pings about the middle of the survey and channels evenly among all, the loudest samples of long records.

    At most 512 traces of 4096 samples: 2^21, whatever the file. Channels that are dead, stuck or in `without` are left out.
    """
    n_ping, n_channel, n = echoes.traces.shape
    alive = np.asarray((levels.sounding & ~levels.constant).any(axis=0))
    alive[list(without)] = False
    those = np.flatnonzero(alive) if alive.any() else np.arange(n_channel)
    channel = those[np.unique(np.linspace(0, those.size - 1, min(those.size, channels)).round().astype(np.intp))]
    count = max(1, min(n_ping, pings, MOST_TRACES // channel.size))
    ping = np.arange((n_ping - count) // 2, (n_ping - count) // 2 + count)
    traces = echoes.traces[ping[0] : ping[-1] + 1][:, channel]
    good = levels.finite[np.ix_(ping, channel)]
    first = 0
    if n > MOST_SAMPLES:
        few = np.square(np.abs(traces[:: max(1, count // 8)]))
        loud = np.cumsum(np.mean(few, axis=(0, 1), where=good[:: max(1, count // 8), :, None]))
        first = int(np.argmax(loud[MOST_SAMPLES:] - loud[:-MOST_SAMPLES]))
        traces = traces[..., first : first + MOST_SAMPLES]
    found = np.array(np.where(good[..., None], traces, 0), dtype=echoes.dtype)
    top = float(max(np.abs(found.real).max(), np.abs(found.imag).max()))
    if top > 0:  # squares of what float32 holds it may not hold
        kind = found.real.dtype
        limit = np.finfo(kind).maxexp - 2
        found *= np.ldexp(kind.type(1), -int(np.clip(np.frexp(top)[1], -limit, limit)))
    return Sample(echoes, ping, channel, first, found)
