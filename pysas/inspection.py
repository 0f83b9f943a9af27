"""Consistency checks of echoes, one finding each: what `pysas check` prints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pysas.echoes import Echoes
from pysas.pulse import LFM


@dataclass(frozen=True)
class Finding:
    """One check: its name, "ok", "warn" or "FAIL", and what was found."""

    name: str
    state: str
    text: str


def inspect(echoes: Echoes) -> list[Finding]:
    """All checks, in the order a person would fix things; O(samples)."""
    return [
        _finite(echoes),
        _clipped(echoes),
        _times(echoes),
        _range_sampling(echoes),
        _along_track(echoes),
        _smooth(echoes),
        _pulse(echoes),
    ]


def _finite(echoes: Echoes) -> Finding:
    for ping, traces in enumerate(echoes.traces):
        good = np.isfinite(traces)
        if not good.all():
            channel, sample = (int(i) for i in np.argwhere(~good)[0])
            return Finding("finite samples", "FAIL", f"non-finite first at ping {ping}, channel {channel}, sample {sample}")
    if not any(np.any(traces) for traces in echoes.traces):
        return Finding("finite samples", "FAIL", "all samples are zero")
    return Finding("finite samples", "ok", f"{echoes.data.size} samples")


def _clipped(echoes: Echoes) -> Finding:
    """A converter's limit shows as many samples at one largest value."""
    worst, where = 0, 0
    top = max(float(np.nanmax(np.abs(part))) for traces in echoes.traces for part in (traces.real, traces.imag))
    if top > 0 and np.isfinite(top):
        for ping, traces in enumerate(echoes.traces):
            count = int(np.count_nonzero(np.abs(traces.real) == top) + np.count_nonzero(np.abs(traces.imag) == top))
            if count > worst:
                worst, where = count, ping
    if worst > 3:
        return Finding("clipping", "warn", f"{worst} samples at the largest value {top:g} in ping {where}")
    return Finding("clipping", "ok", f"largest value {top:g}")


def _times(echoes: Echoes) -> Finding:
    if echoes.ping_time is None:
        return Finding("ping times", "ok", "none given")
    steps = np.diff(echoes.ping_time)
    if np.any(steps <= 0):
        return Finding("ping times", "FAIL", f"not increasing first at ping {int(np.argmax(steps <= 0)) + 1}")
    return Finding("ping times", "ok", "increasing")


def _range_sampling(echoes: Echoes) -> Finding:
    margin = echoes.fs / echoes.occupied_bandwidth
    text = f"fs is {margin:.4g} x the bandwidth"
    return Finding(
        "range sampling", "ok" if margin >= 1.1 - 1e-9 else "FAIL", text + ("" if margin >= 1.1 - 1e-9 else ", below 1.1")
    )


def _along_track(echoes: Echoes) -> Finding:
    median, largest = echoes.phase_centre_spacing()
    text = f"phase centres every {median:.4g} m, largest gap {largest:.4g} m"
    if echoes.beam is None:
        return Finding("along-track sampling", "ok", text + "; no beam given")
    length = echoes.beam.length
    if median > length / 2 * (1 + 1e-9):
        return Finding("along-track sampling", "FAIL", text + f", above D/2 = {length / 2:.4g} m")
    if largest > length / 2 * (1 + 1e-9):
        return Finding("along-track sampling", "warn", text + f": gap above D/2 = {length / 2:.4g} m")
    if largest > length / 4 * (1 + 1e-9):
        return Finding("along-track sampling", "warn", text + f", above D/4 = {length / 4:.4g} m")
    return Finding("along-track sampling", "ok", text + f", within D/4 = {length / 4:.4g} m")


def _smooth(echoes: Echoes) -> Finding:
    """Repeats and jumps: a second difference far above the track's usual one cannot be the platform's motion."""
    if echoes.n_ping < 4:
        return Finding("track", "ok", f"{echoes.n_ping} pings")
    steps = np.linalg.norm(np.diff(echoes.tx, axis=0), axis=1)
    if np.any(steps == 0):
        return Finding("track", "warn", f"the transmitter does not move first at ping {int(np.argmax(steps == 0)) + 1}")
    bends = np.linalg.norm(np.diff(echoes.tx, 2, axis=0), axis=1)
    limit = max(20 * float(np.median(bends)), 2 * float(np.median(steps)))
    if np.any(bends > limit):
        worst = int(np.argmax(bends > limit))
        return Finding(
            "track",
            "FAIL",
            f"jump near ping {worst + 1}: second difference {bends[worst]:.4g} m, usual {np.median(bends):.2g} m",
        )
    return Finding("track", "ok", f"{float(steps.sum()):.4g} m, largest step {steps.max():.4g} m")


def _pulse(echoes: Echoes) -> Finding:
    if echoes.pulse is None:
        state = "ok" if echoes.compressed else "FAIL"
        return Finding("pulse", state, "none given" + ("" if echoes.compressed else ": raw echoes cannot be compressed"))
    seconds = echoes.pulse.duration if isinstance(echoes.pulse, LFM) else (echoes.pulse.size - 1) / echoes.fs
    record = (echoes.n_sample - 1) / echoes.fs
    if seconds > record and not echoes.compressed:
        return Finding("pulse", "FAIL", f"{seconds:.4g} s, longer than the record of {record:.4g} s")
    return Finding("pulse", "ok", f"{seconds:.4g} s in a record of {record:.4g} s")
