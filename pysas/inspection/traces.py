"""Traces by themselves: what recorders, converters and amplifiers do to samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.inspection.finding import Finding
from pysas.inspection.levels import Levels
from pysas.inspection.sample import Sample
from pysas.model.echoes import Echoes

_OFFSET = 0.05  # share of a channel's energy in its mean
_LOUD = 10.0  # dB between channels
_STEP = 6.0  # dB from ping to ping
_TIED = 3  # samples at one largest value that may be chance
_SURE = 6.0  # standard errors
_COLUMNS = 8  # instants at which pings tie


def finite(echoes: Echoes, levels: Levels) -> Finding:
    """Not a number, infinite, or nothing at all."""
    if levels.bad is not None:
        ping, channel, sample = levels.bad
        traces = np.count_nonzero(~levels.finite)
        text = f"non-finite first at ping {ping}, channel {channel}, sample {sample}; {traces} of {levels.finite.size} traces"
        return Finding("finite samples", "FAIL", text + ": image with nan='mask', or repair the record")
    if not np.any(levels.top):
        return Finding("finite samples", "FAIL", "all samples are zero: nothing was recorded, or converted")
    return Finding("finite samples", "ok", f"{echoes.data.size} samples")


def silent(levels: Levels) -> Finding:
    """Traces without a sound: a dead channel, or pings that were not stored; or stuck at one value."""
    still = levels.finite & (levels.constant | (levels.top == 0))
    if not still.any():
        return Finding("silent traces", "ok", "none")
    ping, channel = (int(i) for i in np.argwhere(still)[0])
    words = f"{np.count_nonzero(still)} of {still.size}, first at ping {ping}, channel {channel}"
    stuck = still & (levels.top > 0)
    for name, which in (("dead", still & ~stuck), ("stuck", stuck)):
        whole = np.flatnonzero((which | ~levels.finite).all(axis=0) & which.any(axis=0))
        if whole.size:
            words += f"; {name} channels {', '.join(map(str, whole))}"
    if stuck.any():
        words += f"; {np.count_nonzero(stuck)} hold one value throughout: set them to zero or leave them out"
    return Finding("silent traces", "warn", words)


def offset(echoes: Echoes, levels: Levels) -> Finding:
    """A constant beside the echoes: a converter's zero, which after demodulation looks like a tone at fc."""
    scale = float(levels.top.max())
    power = np.sum((levels.rms / scale) ** 2, axis=0)
    mean = np.abs((levels.mean / scale).sum(axis=0))
    share = mean**2 / levels.finite.shape[0] / np.where(power > 0, power, np.inf)
    few = 10 * echoes.fs / (echoes.occupied_bandwidth * echoes.n_sample)  # a short record's mean is an echo's
    # of many pings: one echo's mean turns from ping to ping
    most = max(_OFFSET, few, 10 / echoes.n_ping)
    which = np.flatnonzero((share > most) & ~levels.constant.all(axis=0))
    if which.size:
        first = int(which[0])
        text = f"{100 * share[first]:.3g} % of the energy of channel {first} is a constant (and of {which.size - 1} others)"
        return Finding("offset", "warn", text + ": subtract each channel's mean over all pings")
    return Finding("offset", "ok", f"constants hold at most {100 * share.max():.2g} % of a channel's energy")


def clipped(echoes: Echoes, levels: Levels, sample: Sample) -> Finding:
    """A converter's limit: many samples at a trace's largest value, or many pings with one value at the same instant.

    The second shows it after a gain that varies with time. Filters (demodulation, compression) hide it.
    """
    top = float(levels.top.max())
    worst = np.unravel_index(int(np.argmax(np.where(levels.constant, 0, levels.at_top))), levels.at_top.shape)
    ping, channel = (int(i) for i in worst)
    if levels.at_top[worst] > _TIED and not levels.constant[worst]:
        trace = np.asarray(echoes.traces[worst])
        size = np.abs(np.concatenate([trace.real, trace.imag]))
        counts = np.unique(size, return_counts=True)[1]
        if counts.size > 1 and counts[-1] > _TIED + 2 * counts[-2]:
            many = np.count_nonzero((levels.at_top > _TIED) & ~levels.constant)
            text = f"{counts[-1]} samples at the largest value {levels.top[worst]:g} in ping {ping}, channel {channel}"
            return Finding("clipping", "warn", f"{text}; {many} traces: record with less gain; what is lost cannot be restored")
    instants, pings = _tied(sample)
    if instants >= _COLUMNS:
        text = f"at {instants} instants up to {pings} pings have one largest value"
        return Finding("clipping", "warn", text + ": clipped before a gain that varies with time; record with less gain")
    return Finding("clipping", "ok", f"largest value {top:g}")


def _tied(sample: Sample) -> tuple[int, int]:
    """At how many instants pings of a channel tie at the largest value, and how many of them at most."""
    found = (0, 0)
    for channel in range(sample.traces.shape[1]):
        traces = sample.traces[:, channel]
        if len(traces) < 2 * _TIED:
            return found
        for part in (traces.real, traces.imag):
            size = np.sort(np.abs(part), axis=0)[::-1]
            count = np.sum(size == size[:1], axis=0)
            # integers tie at any value: as often at the next one
            after = np.take_along_axis(size, np.minimum(count, len(size) - 1)[None], axis=0)
            second = np.sum(size == after, axis=0)
            # a smooth peak without noise is flat to rounding: the next value lies just below; so does all that is rounding
            high = (
                (count >= _TIED) & (count > 2 * second) & (size[0] - after[0] > 1e-5 * size[0]) & (after[0] > 1e-4 * size.max())
            )
            if np.count_nonzero(high) > found[0]:
                found = int(np.count_nonzero(high)), int(count[high].max())
    return found


def gain(echoes: Echoes, levels: Levels) -> Finding:
    """Steps of gain: every sample of a ping is larger than before by one factor, noise and echoes alike."""
    decibels = 20 * np.log10(np.where(levels.sounding, levels.rms, np.nan))
    change = np.diff(decibels, axis=0)
    step = np.abs(change)
    # a level that goes on changing is an echo's in a beam; gains stay, or come back
    around = np.pad(change, ((1, 1), (0, 0)))
    stays = np.ones(change.shape, dtype=bool)
    for other in (around[:-2], around[2:]):
        stays &= (np.abs(other) < step / 4) | ((other * change < 0) & (np.abs(other) > step / 2))
    steps = np.argwhere((np.nan_to_num(step) > _STEP) & stays)
    if steps.size == 0:
        return Finding("gain", "ok", f"largest step {np.nanmax(step, initial=0):.2g} dB from ping to ping")
    at = steps[np.unique(np.linspace(0, len(steps) - 1, min(len(steps), 32)).astype(int))]
    seen = [(ping, channel, _ratio(echoes, ping, channel)) for ping, channel in at]
    real = [(int(ping) + 1, int(channel), ratio) for ping, channel, ratio in seen if abs(ratio) > _STEP]
    if not real:
        return Finding("gain", "ok", "levels change with the echoes, not with the gain")
    ping, channel, ratio = real[0]
    about = round(len(steps) * len(real) / len(at))
    text = f"step of {ratio:+.3g} dB first at ping {ping}, channel {channel}, about {about} in all, of all samples alike"
    return Finding("gain", "warn", text + ": divide pings by their gain, or give weights=1/gain")


def _ratio(echoes: Echoes, ping: int, channel: int) -> float:
    """Median over the samples of the ratio of a ping to the one before, dB; 0 where samples do not agree on it."""
    pair = np.abs(np.asarray(echoes.traces[ping : ping + 2, channel]).astype(np.complex128))
    pair /= pair.max()
    both = (pair > 0).all(axis=0)
    if np.count_nonzero(both) < 32 or np.count_nonzero(both) < 0.5 * np.count_nonzero(pair.any(axis=0)):
        return 0.0
    ratio = 20 * np.log10(pair[1, both] / pair[0, both])
    # quiet and loud samples, near and far ones alike: an echo that comes into the beam leaves the rest as it was
    loud = pair[:, both].prod(axis=0)
    place = np.arange(ratio.size)
    parts = (loud <= np.median(loud), loud > np.median(loud), *(place * 4 // ratio.size == quarter for quarter in range(4)))
    medians = [float(np.median(ratio[part])) for part in parts]
    return float(np.median(ratio)) if np.ptp(medians) < max(1.0, 60 / np.sqrt(ratio.size)) else 0.0


def channels(levels: Levels, coherence: FloatArray, chance: tuple[float, float], sample: Sample) -> tuple[Finding, list[int]]:
    """Channels unlike the others: of another level, or with echoes that no other has; and which.

    coherence : (channel, channel)
        Mean over the pings of |sum x y*| / sqrt(sum |x|^2 sum |y|^2), of the sample's channels.
    chance : (float, float)
        What unlike traces have of it, and its standard deviation.
    """
    sounding = levels.sounding & ~levels.constant
    if sounding.shape[1] < 3 or not sounding.any():
        return Finding("channels", "ok", f"{sounding.shape[1]}"), []
    rms = np.where(sounding, levels.rms, np.nan)
    alive = np.flatnonzero(sounding.any(axis=0))
    level = 20 * np.log10(np.nanmedian(rms[:, alive], axis=0))
    off = level - np.median(level)
    which = [int(alive[i]) for i in np.flatnonzero(np.abs(off) > _LOUD)]
    said = [f"channel {alive[i]} is {off[i]:+.3g} dB from the others" for i in np.flatnonzero(np.abs(off) > _LOUD)]
    best = np.where(np.eye(len(coherence), dtype=bool), 0, coherence).max(axis=1) - chance[0]
    usual = float(np.median(best))
    if usual > _SURE * chance[1] / np.sqrt(len(sample.pings) / 2):
        alone = (best < 0.3 * usual) & (coherence.diagonal() > 0)
        said += [
            f"channel {sample.channels[i]} has echoes of its own (coherence {best[i]:.2g} above chance, usual {usual:.2g})"
            for i in np.flatnonzero(alone)
        ]
        which += [int(sample.channels[i]) for i in np.flatnonzero(alone)]
    if said:
        more = f"; and {len(said) - 3} more" if len(said) > 3 else ""
        text = "; ".join(said[:3]) + more + ": noise, or a gain of its own: weigh it by 1/gain or leave it out (weights 0)"
        return Finding("channels", "warn", text), which
    return Finding("channels", "ok", f"{sounding.shape[1]} alike within {np.abs(off).max():.2g} dB"), []


def gaps(sample: Sample) -> Finding:
    """Samples that are zero where the same range of the ping before or after is not."""
    echoes, traces = sample.echoes, sample.traces
    step = np.linalg.norm(np.diff(sample.tx, axis=0), axis=1)
    # echoes shift by so many samples from ping to ping at most, and a record's start may
    starts = float(np.abs(np.diff(echoes.start_time[sample.pings])).max(initial=0.0))
    shift = int((2 * float(step.max(initial=0.0)) / float(np.mean(echoes.c)) + starts) * echoes.fs) + 1
    least = 8 + 2 * shift
    if len(traces) < 3 or traces.shape[-1] < 2 * least:
        return Finding("gaps", "ok", "too few samples to tell")
    zero = traces == 0
    heard = ~zero
    found = []
    for ping, channel in np.argwhere(zero.any(axis=-1) & heard.any(axis=-1)):
        edges = np.flatnonzero(np.diff(np.r_[0, zero[ping, channel].astype(np.int8), 0]))
        near = [p for p in (ping - 1, ping + 1) if 0 <= p < len(traces)]
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            inside = start > 0 and stop < traces.shape[-1]
            if inside and stop - start >= least and any(_filled(heard[p, channel, start:stop]) for p in near):
                found.append((int(sample.pings[ping]), int(sample.channels[channel]), int(start), int(stop)))
    if not found:
        return Finding("gaps", "ok", "none")
    ping, channel, start, stop = found[0]
    text = f"{len(found)} gaps of zeros in {sample.traces.shape[0] * sample.traces.shape[1]} traces, first at ping {ping}, "
    text += f"channel {channel}, samples {start + sample.first} to {stop + sample.first - 1}, where its neighbours have echoes"
    return Finding("gaps", "warn", text + ": pings blanked there add nothing: what is dark in the image may be a gap")


def _filled(heard: npt.NDArray[Any]) -> bool:
    return bool(np.mean(heard) > 0.9)


def transposed(sample: Sample) -> Finding:
    """As many samples as pings, each the other: levels that change from ping to ping and not with range, band across pings."""
    echoes = sample.echoes
    name = "axes"
    if echoes.n_ping != echoes.n_sample or echoes.n_ping < 16:
        return Finding(name, "ok", "pings and samples differ in number" if echoes.n_ping != echoes.n_sample else "few pings")
    data = np.asarray(echoes.traces[:, sample.channels[len(sample.channels) // 2]]).astype(np.complex128)
    if not np.isfinite(data).all() or not data.any():
        return Finding(name, "ok", "no finite samples")
    power = np.abs(data) ** 2
    level = np.log(power + 1e-3 * power.mean())
    ranges, pings = float(np.var(level.mean(axis=0))), float(np.var(level.mean(axis=1)))
    middle, band = sample.band
    inside = []
    for axis in (1, 0):
        spectra = np.abs(np.fft.fft(data, axis=axis)) ** 2
        frequency = np.fft.fftfreq(len(data), 1 / echoes.fs)
        off = np.abs((frequency - middle + echoes.fs / 2) % echoes.fs - echoes.fs / 2) <= 0.55 * band
        inside.append(float(spectra.sum(axis=1 - axis)[off].sum() / spectra.sum()))
    text = f"levels vary {np.sqrt(ranges):.2g} with range and {np.sqrt(pings):.2g} from ping to ping"
    text += f", {100 * inside[0]:.3g} % of the energy is in the band along samples, {100 * inside[1]:.3g} % along pings"
    more = inside[1] - inside[0]
    if more > 0.05 or (more > 0.02 and ranges < 1.2 * pings) or (more > -0.05 and ranges < 0.3 * pings):
        return Finding(name, "FAIL", f"{text}: pings and samples are transposed: swap the axes")
    return Finding(name, "ok", text)
