"""The correlation algorithm: raw echoes against each pixel's own replica. A slow, plain oracle beside `exact`.

Nothing is compressed or transformed: the pulse is evaluated at the recorded instants, an LFM by its formula, a measured one
as the sum of sinc functions that its samples are. It relies on Echoes, Grid and LFM alone.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.model.pulse import LFM

_CHUNK_BYTES = 1 << 24

Complex = npt.NDArray[np.complex128]


def correlation(raw: Echoes, grid: Grid, pulse: Any = None, pulse_t0: Any = 0.0) -> Image:
    """Image by correlating the raw echoes with what each pixel alone would have returned.

    Parameters
    ----------
    raw : Echoes
        Raw echoes, stop-and-hop, any track and any receivers.
    grid : Grid
        Where; masked pixels are 0.
    pulse : LFM, (sample,) complex, or a sequence of as many as there are pings, optional
        What was transmitted, if it is not `raw.pulse`; samples at rate `raw.fs`, as in `compress`.
    pulse_t0 : float or (ping,)
        Time of the first sample of measured pulses after transmission began, s.

    Returns
    -------
    Image
        complex128: sum over pings, channels and samples of s conj(waveform(t - tau)) exp(2j pi fc tau) / (fs energy), the
        peak of a point of amplitude A being A times the number of traces, as in `backproject` of compressed echoes.

    Raises
    ------
    ValueError, TypeError
        Compressed echoes, no pulse or another number of them than of pings, moving receivers, a non-finite sample (the ping
        is named).

    Notes
    -----
    R. Sathishkumar et al., Section III (C. Wu et al. 1982). The sum over samples is the matched filter's integral as far as
    the product of record and replica is sampled without aliasing: for pulses of infinite bandwidth (rect) only up to the share
    of energy outside fs. O(pixel ping channel duration fs), with measured pulses times the samples of a record.
    """
    if not isinstance(raw, Echoes):
        raise TypeError(f"raw={type(raw).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected a pysas.Grid")
    if raw.compressed:
        raise ValueError("raw: compressed=True: expected raw echoes")
    pulses, starts = _pulses(raw, pulse), np.broadcast_to(np.asarray(pulse_t0, dtype=np.float64), (raw.n_ping,))
    if any(isinstance(own, LFM) and start != 0 for own, start in zip(pulses, starts, strict=True)):
        raise ValueError("pulse_t0: an LFM begins at its own leading edge: expected 0 beside it")
    if raw.velocity is not None:
        raise ValueError("raw: receivers with a velocity: expected stop-and-hop echoes (pysas.reference.phase_centres)")
    raw, clock = raw.whole(), time.perf_counter()
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    points = grid.coordinates(wanted)
    total = np.zeros(grid.size, dtype=np.complex128)
    for ping in range(raw.n_ping):
        own = pulses[ping]
        energy = raw.fs * own.energy if isinstance(own, LFM) else float(np.sum(np.abs(own) ** 2))
        length = (own.support[1] - own.support[0]) * raw.fs if isinstance(own, LFM) else raw.n_sample * own.size
        step = max(1, int(_CHUNK_BYTES // (16 * (length + 1))))
        if not np.isfinite(raw.traces[ping]).all():
            raise ValueError(f"raw: non-finite sample at ping {ping}: expected finite samples")
        for channel in range(raw.n_channel):
            trace = raw.traces[ping, channel].astype(np.complex128)
            away = np.linalg.norm(points - raw.tx[ping], axis=1) + np.linalg.norm(points - raw.receivers[ping, channel], axis=1)
            for begin in range(0, wanted.size, step):
                tau = away[begin : begin + step] / raw.speeds[ping]
                start = float(raw.start_time[ping])
                if isinstance(own, LFM):
                    terms = _lfm(raw, own, trace, tau, start)
                else:
                    terms = _measured(trace, own, (start - tau - starts[ping]) * raw.fs)
                turns = raw.fc * tau
                total[wanted[begin : begin + step]] += terms / energy * np.exp(2j * np.pi * (turns - np.rint(turns)))
    choices: dict[str, Any] = {}
    count = wanted.size * raw.n_ping * raw.n_channel
    report = Report(
        "correlation", backend="numpy", threads=1, sum_seconds=time.perf_counter() - clock, terms=count, choices=choices
    )
    return Image(total.reshape(grid.shape), grid, report, raw.fc, raw.mean_speed)


def _pulses(raw: Echoes, pulse: Any) -> list[Any]:
    """Each ping's pulse: an LFM or complex128 samples."""
    given: Any = raw.pulse if pulse is None else pulse
    if given is None:
        raise ValueError("raw: pulse=None: expected an LFM or samples to correlate with")
    one = isinstance(given, LFM) or (not isinstance(given[0], LFM) and np.ndim(given[0]) == 0)
    pulses = [given] * raw.n_ping if one else list(given)
    if len(pulses) != raw.n_ping:
        raise ValueError(f"pulse: {len(pulses)} pulses: expected one, or one for each of {raw.n_ping} pings")
    made = [own if isinstance(own, LFM) else np.asarray(own, dtype=np.complex128) for own in pulses]
    for ping, own in enumerate(made):
        if not isinstance(own, LFM) and not (own.ndim == 1 and np.isfinite(own).all() and np.any(own)):
            raise ValueError(f"pulse: of ping {ping}: expected finite samples (sample,), not all zero")
    return made


def _lfm(raw: Echoes, pulse: LFM, trace: Complex, tau: npt.NDArray[np.float64], start: float) -> Complex:
    """Sums of a trace times the conjugate of an LFM of delays `tau`; samples outside the record count as zero."""
    first, last = pulse.support
    lags = np.arange(int(np.ceil((last - first) * raw.fs)) + 1)
    index = np.ceil((tau + first - start) * raw.fs).astype(np.intp)[:, None] + lags
    inside = (index >= 0) & (index < trace.size)
    recorded = np.where(inside, trace[np.clip(index, 0, trace.size - 1)], 0)
    replica = pulse.waveform(start + index / raw.fs - tau[:, None], raw.fc)
    return np.asarray(np.sum(recorded * replica.conj(), axis=1))


def _measured(trace: Complex, pulse: Complex, place: npt.NDArray[np.float64]) -> Complex:
    """The same for samples of a pulse: its sinc functions at sample 0 of the trace lie `place` samples after its first."""
    distance = place[:, None] + np.arange(1 - pulse.size, trace.size)
    sinc = np.lib.stride_tricks.sliding_window_view(np.sinc(distance), pulse.size, axis=1)  # (pixel, sample, of the pulse)
    replica = sinc @ pulse[::-1]
    return np.asarray(replica.conj() @ trace)
