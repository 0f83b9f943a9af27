"""Whether traces that see alike stand side by side: pings and receivers in another order than their positions.

Echoes of places near each other are coherent (D. A. Cook and D. C. Brown, IEEE JOE 34 (2009): by the overlap of phase centres),
so each trace has its best partner among those whose phase centres lie nearest, whatever the scene.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.signal.inspection.finding import Finding
from pysas.signal.inspection.sample import Sample

_NEAREST = 6  # phase centres about each that its partner may be
_MIXED = 0.2  # share of traces with a partner elsewhere
_BETTER = 1.25  # times the coherence that the order given has
_PAIRS = 12


def coherences(sample: Sample) -> FloatArray:
    """Magnitudes of the coherence of all traces with each other, (ping x channel, ping x channel); O(traces^2 samples).

    Loud samples are held down to thrice the median, so that one echo does not speak for all of the scene.
    """
    start = sample.echoes.start_time[sample.pings]
    shift = np.round((start - start[0]) * sample.echoes.fs).astype(int)
    moved = [np.roll(traces, by, axis=-1) if by else traces for traces, by in zip(sample.compressed, shift, strict=True)]
    flat = np.stack(moved).reshape(-1, sample.traces.shape[-1])
    size = np.abs(flat)
    usual = 3 * np.median(size, axis=-1, keepdims=True)
    level = np.where(usual > 0, usual, 1e-3 * size.max(axis=-1, keepdims=True))
    limited: ComplexArray = np.divide(flat, size + level, out=np.zeros_like(flat), where=level > 0)
    norm = np.sqrt(np.sum(np.abs(limited) ** 2, axis=-1, keepdims=True))
    limited = np.divide(limited, norm, out=np.zeros_like(flat), where=norm > 0)
    return np.asarray(np.abs(limited @ limited.conj().T), dtype=np.float64)


def within_pings(coherence: FloatArray, sample: Sample) -> FloatArray:
    """(channel, channel) mean over the pings."""
    ping, channel = sample.traces.shape[:2]
    own = coherence.reshape(ping, channel, ping, channel)
    return np.asarray(own[np.arange(ping), :, np.arange(ping)].mean(axis=0))


def chance(sample: Sample) -> float:
    """What the coherence of two unlike traces hardly exceeds, from how many samples of theirs are independent."""
    power = np.mean(np.abs(sample.compressed) ** 2, axis=(0, 1))
    many = float(power.sum() ** 2 / np.sum(power**2)) if power.any() else 1.0
    many *= min(1.0, sample.echoes.occupied_bandwidth / sample.echoes.fs)
    return float(min(1.0, 3.5 / np.sqrt(max(many, 1.0))))


def order(sample: Sample, coherence: FloatArray) -> Finding:
    """Partners elsewhere than the positions say; or a reversed order of pings or receivers that fits better."""
    pings, count = sample.traces.shape[:2]
    least = chance(sample)
    best = np.where(np.eye(len(coherence), dtype=bool), 0, coherence).max(axis=1)
    heard = best > 1.5 * least
    if pings < 4 or np.count_nonzero(heard) < max(_PAIRS, 0.3 * heard.size):
        return Finding("order", "ok", "echoes of neighbours are too unlike to tell")
    given = _score(sample, coherence, sample.tx, sample.rx)
    others = {
        "receivers are in reverse order": (sample.tx, sample.rx[:, ::-1]),
        "pings are in reverse order": (sample.tx[::-1], sample.rx[::-1]),
    }
    if count == sample.echoes.n_ping:
        others["pings and channels are transposed"] = (sample.tx, sample.rx)
    if count > 1 and given is not None:
        for words, (tx, rx) in others.items():
            matrix = coherence
            if "transposed" in words:
                matrix = coherence.reshape(pings, count, pings, count).transpose(1, 0, 3, 2).reshape(coherence.shape)
            score = _score(sample, matrix, tx, rx)
            if score is not None and score > _BETTER * given + least / 2:
                text = f"coherence of echoes whose phase centres meet is {given:.2g} as given, {score:.2g} where {words}"
                return Finding("order", "FAIL", f"{text}: reorder the samples or the positions")
    centres = _centres(sample.tx, sample.rx)
    near = _near(centres)
    by_place = np.where(near, coherence, 0).max(axis=1)
    elsewhere = heard & (best > 1.3 * by_place + least)
    share = np.count_nonzero(elsewhere) / np.count_nonzero(heard)
    if share > _MIXED:
        what = _which(sample, coherence, near, elsewhere)
        first = int(np.argmax(elsewhere))
        text = f"{100 * share:.2g} % of the traces are most like others than their neighbours, first ping "
        text += f"{sample.pings[first // count]}, channel {sample.channels[first % count]}"
        return Finding("order", "FAIL", f"{text}: {what} are shuffled against their positions: sort both alike")
    return Finding("order", "ok", f"neighbours are the most alike ({np.median(by_place[heard]):.2g})")


def _centres(tx: FloatArray, rx: FloatArray) -> FloatArray:
    return np.asarray(((tx[:, None] + rx) / 2).reshape(-1, 3))


def _distances(centres: FloatArray) -> FloatArray:
    inner = centres - centres.mean(axis=0)
    square = np.sum(inner**2, axis=1)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square - 2 * inner @ inner.T, 0)))


def _near(centres: FloatArray) -> npt.NDArray[np.bool_]:
    """Pairs of which one is among the nearest of the other, or as near as those."""
    distance = _distances(centres)
    np.fill_diagonal(distance, np.inf)
    reach = np.sort(distance, axis=1)[:, min(_NEAREST, len(distance) - 1) - 1]
    return np.asarray(distance <= np.maximum(reach[:, None], reach) * (1 + 1e-9))


def _score(sample: Sample, coherence: FloatArray, tx: FloatArray, rx: FloatArray) -> float | None:
    """Mean coherence of traces of different pings whose phase centres meet, or nearly; None for fewer than twelve."""
    channel = rx.shape[1]
    distance = _distances(_centres(tx, rx))
    ping = np.arange(len(distance)) // channel
    distance[ping[:, None] == ping] = np.inf
    nearest = distance.min(axis=1)
    reach = 1.2 * float(np.quantile(nearest, 0.1)) + float(np.mean(sample.echoes.c)) / sample.echoes.fc / 16
    pairs = distance <= reach
    return float(coherence[pairs].mean()) if np.count_nonzero(pairs) >= _PAIRS else None


def _which(sample: Sample, coherence: FloatArray, near: npt.NDArray[np.bool_], elsewhere: npt.NDArray[np.bool_]) -> str:
    """Pings, or receivers: whose partners are of the same ping."""
    pings, count = sample.traces.shape[:2]
    if count < 3:
        return "pings"
    same = np.arange(pings * count) // count
    inside = np.where((same[:, None] == same) & ~np.eye(same.size, dtype=bool), coherence, 0)
    moved = inside.max(axis=1) > 1.3 * np.where(near, inside, 0).max(axis=1) + 0.05
    return "receivers" if np.count_nonzero(moved & elsewhere) > 0.5 * np.count_nonzero(elsewhere) else "pings"
