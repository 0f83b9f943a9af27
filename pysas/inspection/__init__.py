"""Consistency checks of echoes, one finding each: what `pysas check` prints and `pysas image` warns of.

Navigation and sampling speak for themselves; samples are read once for their levels, and a few pings and channels of them, at
most 2^21 samples whatever the file, are looked at closely: their spectrum, their compression by the pulse and by its
conjugate, their coherence with each other, and the strongest echoes followed from ping to ping.
"""

from __future__ import annotations

import numpy as np

from pysas import _checks
from pysas.inspection import band, followed, geometry, order, survey, traces
from pysas.inspection.finding import Finding
from pysas.inspection.levels import Levels, measured
from pysas.inspection.sample import chosen
from pysas.model.echoes import Echoes

__all__ = ["Finding", "inspect"]


@_checks.usual_errors
def inspect(echoes: Echoes) -> list[Finding]:
    """All checks, in the order a person would fix things, of what was recorded.

    Parameters
    ----------
    echoes : Echoes
        Raw or compressed.

    Returns
    -------
    list of Finding
        One a check, those that found nothing included. "FAIL": no image of these echoes can be right. "warn": an image is worse
        than it could be, or may be. What one mistake makes the others say is left out: a wrong carrier or sweep ends the list.

    Raises
    ------
    TypeError
        Not echoes.

    Notes
    -----
    One pass over the samples for levels, 30 ns each; beside it half a second to two, whatever the file. The same file is told
    the same every time. docs/check.md has what each check can see, and what the data cannot show.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    heard, alike = _recorded(echoes)
    levels = measured(heard)
    found = [traces.finite(heard, levels), traces.silent(levels)]
    found += [
        geometry.times(echoes),
        geometry.range_sampling(echoes),
        geometry.along_track(echoes),
        geometry.beam(echoes),
        geometry.track(echoes),
        geometry.receivers(echoes),
        geometry.pulse(echoes),
        survey.units(echoes),
        survey.evenness(echoes),
    ]
    if found[-3].state == "ok":
        found.append(survey.doppler(echoes))
    if levels.sounding.any():
        lost = any(f.name == "units" and f.state == "FAIL" for f in found)
        found += _heard(heard, levels, lost or not alike)
    return found


def _recorded(echoes: Echoes) -> tuple[Echoes, bool]:
    """What all pings recorded that recorded anything, a view, and whether pings can be compared by it.

    Where that is less than a quarter of a record all samples are taken, zeros where nothing was recorded. Pings of other sound
    speeds have echoes of one place at other times.
    """
    latest = float(np.max(echoes.start_time)) * echoes.fs + echoes.n_sample
    alike = float(np.ptp(echoes.speeds)) / echoes.mean_speed * latest < 0.5
    if echoes.valid is None:
        return echoes, alike
    windows = echoes.windows
    some = np.flatnonzero((windows[..., 1] >= windows[..., 0]).all(axis=1))
    if some.size:
        first, last = int(windows[some, :, 0].max()), int(windows[some, :, 1].min())
        if last + 1 - first >= max(echoes.n_sample // 4, 64):
            kept = echoes[some] if some.size < echoes.n_ping else echoes
            return kept.replace(
                data=kept.data[..., first : last + 1], t0=kept.start_time + first / echoes.fs, valid=None
            ), alike  # fmt: skip
    return echoes.whole(), False


def _heard(echoes: Echoes, levels: Levels, lost: bool) -> list[Finding]:
    """What the samples say; where positions are `lost`, or pings not alike, nothing about these."""
    sample = chosen(echoes, levels)
    found = [
        traces.clipped(echoes, levels, sample),
        traces.offset(echoes, levels),
        traces.gain(echoes, levels),
        traces.gaps(sample),
        traces.transposed(sample),
    ]
    if found[-1].state == "FAIL":
        return found
    found.append(band.carrier(sample, levels))
    if found[-1].state == "ok":
        found.append(band.declared(sample))
    if found[-1].state == "FAIL" or geometry.pulse(echoes).state == "FAIL":
        return found
    found.append(band.sweep(sample))
    if found[-1].state == "FAIL":
        return found
    coherence = order.coherences(sample)
    chance = order.background(coherence, sample)
    channels, odd = traces.channels(levels, order.within_pings(coherence, sample), chance, sample)
    found.append(channels)
    if lost:
        return found
    positions, told = followed.explained(chosen(echoes, levels, 256, 4, odd))
    found.append(positions)
    if not told:  # a few points may be alike from anywhere: followed they say more
        if odd:
            sample = chosen(echoes, levels, without=odd)
            coherence = order.coherences(sample)
        found.append(order.order(sample, coherence))
    return found
