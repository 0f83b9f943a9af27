"""The pulses that pings are compressed with, and the transfer functions of their filters.

A pulse is an LFM or base-band samples at the echoes' rate, measured for instance, from a time of their own on; each ping may
have its own. What two pings share is made once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.signal

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

_SIGNIFICANT = 1e-3  # of the peak: a pulse's length is the span where its samples exceed this
_WINDOW_POINTS = 8193  # linear interpolation between so many points of a window is good to 1e-7
_ON_A_SAMPLE = 1e-9  # of a sample: nearer to one than this, a replica's first sample lies on it

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Replica:
    """A pulse and the time of its first sample after transmission began, s (an LFM's leading edge: 0)."""

    pulse: Any
    t0: float
    ping: int  # the first that has it

    def sampled(self, raw: Echoes) -> tuple[Complex, int, float]:
        """Samples at rate fs, the number of the first (negative before t = 0), and by what share of a sample it is later."""
        if isinstance(self.pulse, LFM):
            start, stop = self.pulse.support
            first, last = int(np.ceil(start * raw.fs)), int(np.floor(stop * raw.fs))
            return self.pulse.waveform(np.arange(first, last + 1) / raw.fs, raw.fc), first, 0.0
        first = int(np.rint(self.t0 * raw.fs))
        late = self.t0 * raw.fs - first
        return np.asarray(self.pulse, dtype=np.complex128), first, late if abs(late) > _ON_A_SAMPLE else 0.0


def of_pings(raw: Echoes, pulse: Any, pulse_t0: npt.ArrayLike) -> tuple[list[Replica], npt.NDArray[np.intp]]:
    """The different replicas, and the number of each ping's."""
    one = pulse is None or isinstance(pulse, LFM) or getattr(pulse, "ndim", 0) == 1
    pulses = [raw.pulse if pulse is None else _pulse("pulse", pulse)] if one else _each(raw, pulse)
    if pulses[0] is None:
        raise ValueError("raw: pulse=None: expected an LFM or a sampled waveform to compress with")
    if _checks.array_like("pulse_t0", pulse_t0).ndim == 0:
        starts = np.full(1, _checks.number("pulse_t0", pulse_t0))
    else:
        starts = _checks.reals("pulse_t0", pulse_t0, [(raw.n_ping,)], ("ping",))
    record = raw.n_sample / raw.fs
    if np.any(np.abs(starts) > record):
        worst = float(starts[np.argmax(np.abs(starts))])
        raise ValueError(f"pulse_t0: {worst:g} s: expected within the length of a record, {record:g} s, of transmission")
    replicas: dict[Any, Replica] = {}
    numbers: dict[Any, int] = {}
    which = np.zeros(raw.n_ping, dtype=np.intp)
    for ping in range(raw.n_ping if max(len(pulses), starts.size) > 1 else 1):
        own, start = pulses[ping % len(pulses)], float(starts[ping % starts.size])
        if isinstance(own, LFM) and start != 0:
            raise ValueError(f"pulse_t0: {start:g} s at ping {ping}: expected 0 with an LFM, whose leading edge is at 0")
        key = (own if isinstance(own, LFM) else id(own), start)
        which[ping] = numbers.setdefault(key, len(numbers))
        replicas.setdefault(key, Replica(own, start, ping))
    return list(replicas.values()), which


def _each(raw: Echoes, pulse: Any) -> list[Any]:
    """One pulse a ping, as given."""
    if not isinstance(pulse, Sequence | np.ndarray) or isinstance(pulse, str | bytes):
        raise TypeError(f"pulse={type(pulse).__name__}: expected an LFM, its base-band samples, or one of these a ping")
    if len(pulse) != raw.n_ping:
        raise ValueError(f"pulse: expected one pulse, or one a ping, {raw.n_ping}, found {len(pulse)}")
    rows = list(pulse)
    checked = {id(own): _pulse(f"pulse[{ping}]", own) for ping, own in reversed(list(enumerate(rows)))}  # the first is named
    return [checked[id(own)] for own in rows]


def _pulse(name: str, pulse: Any) -> Any:
    if isinstance(pulse, LFM):
        return pulse
    samples = _checks.samples(name, pulse, (1,))
    if not np.all(np.isfinite(samples)):
        raise ValueError(f"{name}: expected finite samples")
    return samples


def padded_size(raw: Echoes, replica: Replica, endless: bool) -> int:
    """Samples that traces need with zeros behind them, or ValueError where the pulse does not fit the record.

    The pulse's samples lie at instants first ... first + size - 1, so a plain matched filter needs n more than those that
    reach past either end of the record. `endless` filters have no finite impulse response; padding by another n makes all lags
    from -(n - 1) to n - 1 distinct, so the circular convolution is again a linear one.
    """
    waveform, first, late = replica.sampled(raw)
    n = raw.n_sample
    significant = np.flatnonzero(np.abs(waveform) > _SIGNIFICANT * np.abs(waveform).max(initial=0.0))
    if significant.size == 0:
        raise ValueError(
            f"raw: pulse {replica.pulse!r} of ping {replica.ping}: expected at least one non-zero sample at fs {raw.fs:g} Hz"
        )
    length = int(significant[-1] - significant[0]) + 1
    if length > n:
        raise ValueError(
            f"raw: pulse of {length} samples ({length / raw.fs:g} s) of ping {replica.ping}: expected no longer than the "
            f"record of {n} samples ({n / raw.fs:g} s)"
        )
    return max(n + max(first + waveform.size, -first) + (n if endless or late else 0), waveform.size)


def transfer(raw: Echoes, replica: Replica, size: int, window: Any, inverse: float | None) -> Complex:
    """The filter's transfer function on the padded FFT grid, scaled to unit response at the peak."""
    waveform, first, late = replica.sampled(raw)
    padded = np.zeros(size, dtype=np.complex128)
    padded[: waveform.size] = waveform / np.abs(waveform).max()
    spectrum = scipy.fft.fft(np.roll(padded, first))
    frequency = scipy.fft.fftfreq(size)
    if late:
        spectrum *= np.exp(-2j * np.pi * late * frequency)
    result = np.conj(spectrum)
    power = np.abs(spectrum) ** 2
    if inverse is not None:
        result /= power + inverse * power.max()
    if window is not None:
        result *= _spectral_window(raw, replica.pulse, window, frequency * raw.fs)
    gain = float(np.mean(spectrum * result).real)
    if not np.isfinite(gain) or gain <= 0:
        raise ValueError(f"window={window!r}: leaves nothing of the pulse: expected weight in the occupied band")
    return np.asarray(result / (gain * np.abs(waveform).max()))


def _spectral_window(raw: Echoes, pulse: Any, window: str | tuple[Any, ...], frequency: FloatArray) -> FloatArray:
    expected = "expected a scipy.signal.get_window specification such as 'hann' or ('taylor', 4, 35)"
    if not isinstance(window, str | tuple):
        raise TypeError(f"window={window!r}: {expected}")
    try:
        shape = np.asarray(scipy.signal.get_window(window, _WINDOW_POINTS, fftbins=False), dtype=np.float64)
    except Exception as error:  # SciPy's own, whatever a tuple holds
        raise ValueError(f"window={window!r}: {expected} ({error})") from None
    centre, width = 0.0, raw.occupied_bandwidth
    if isinstance(pulse, LFM):
        centre, width = pulse.fc - raw.fc, pulse.occupied_bandwidth
    grid = centre + width * np.linspace(-0.5, 0.5, _WINDOW_POINTS)
    return np.interp(frequency, grid, shape, left=0.0, right=0.0)
