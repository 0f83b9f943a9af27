"""The correlation algorithm: raw echoes against each pixel's own replica. A slow, plain oracle beside `exact`.

Nothing is compressed, transformed or interpolated: the pulse is evaluated analytically at the recorded instants. It relies on
Echoes, Grid and LFM alone.
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


def correlation(raw: Echoes, grid: Grid) -> Image:
    """Image by correlating the raw echoes with what each pixel alone would have returned.

    Parameters
    ----------
    raw : Echoes
        Raw echoes of an LFM pulse, stop-and-hop, any track and any receivers.
    grid : Grid
        Where; masked pixels are 0.

    Returns
    -------
    Image
        complex128: sum over pings, channels and samples of s conj(waveform(t - tau)) exp(2j pi fc tau) / (fs energy), the
        peak of a point of amplitude A being A times the number of traces, as in `backproject` of compressed echoes.

    Raises
    ------
    ValueError, TypeError
        Compressed echoes, another pulse, moving receivers, a non-finite sample (the ping is named).

    Notes
    -----
    R. Sathishkumar et al., Section III (C. Wu et al. 1982). The sum over samples is the matched filter's integral as far as
    the product of record and replica is sampled without aliasing: for pulses of infinite bandwidth (rect) only up to the share
    of energy outside fs. O(pixel ping channel duration fs).
    """
    if not isinstance(raw, Echoes):
        raise TypeError(f"raw={type(raw).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected a pysas.Grid")
    if raw.compressed or not isinstance(raw.pulse, LFM):
        found = "compressed=True" if raw.compressed else f"pulse={type(raw.pulse).__name__}"
        raise ValueError(f"raw: {found}: expected raw echoes of an LFM pulse")
    if raw.velocity is not None:
        raise ValueError("raw: receivers with a velocity: expected stop-and-hop echoes (pysas.reference.phase_centres)")
    clock = time.perf_counter()
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    points = grid.coordinates(wanted)
    total = np.zeros(grid.size, dtype=np.complex128)
    first, last = raw.pulse.support
    lags = np.arange(int(np.ceil((last - first) * raw.fs)) + 1)
    step = max(1, _CHUNK_BYTES // (16 * lags.size))
    for ping in range(raw.n_ping):
        if not np.isfinite(raw.traces[ping]).all():
            raise ValueError(f"raw: non-finite sample at ping {ping}: expected finite samples")
        for channel in range(raw.n_channel):
            trace = raw.traces[ping, channel].astype(np.complex128)
            away = np.linalg.norm(points - raw.tx[ping], axis=1) + np.linalg.norm(points - raw.receivers[ping, channel], axis=1)
            for begin in range(0, wanted.size, step):
                tau = away[begin : begin + step] / raw.c
                total[wanted[begin : begin + step]] += _replicas(raw, raw.pulse, trace, tau, raw.start_time[ping], first, lags)
    scale = raw.fs * raw.pulse.energy
    choices: dict[str, Any] = {}
    terms = wanted.size * raw.n_ping * raw.n_channel
    report = Report(
        "correlation", backend="numpy", threads=1, sum_seconds=time.perf_counter() - clock, terms=terms, choices=choices
    )
    return Image((total / scale).reshape(grid.shape), grid, report, raw.fc, raw.c)


def _replicas(
    raw: Echoes,
    pulse: LFM,
    trace: npt.NDArray[np.complex128],
    tau: npt.NDArray[np.float64],
    start: float,
    first: float,
    lags: npt.NDArray[np.int_],
) -> npt.NDArray[np.complex128]:
    """One trace against the replicas of delays `tau`; samples outside the record count as zero."""
    index = np.ceil((tau + first - start) * raw.fs).astype(np.intp)[:, None] + lags
    inside = (index >= 0) & (index < trace.size)
    recorded = np.where(inside, trace[np.clip(index, 0, trace.size - 1)], 0)
    replica = pulse.waveform(start + index / raw.fs - tau[:, None], raw.fc)
    turns = raw.fc * tau
    return np.asarray(np.sum(recorded * replica.conj(), axis=1) * np.exp(2j * np.pi * (turns - np.rint(turns))))
