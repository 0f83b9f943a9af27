"""Whether traces that see alike stand side by side: pings and receivers in another order than their positions.

Echoes of places near each other are coherent (D. A. Cook and D. C. Brown, IEEE JOE 34 (2009): by the overlap of phase centres),
so each trace has its best partner among those whose phase centres lie nearest, whatever the scene.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.inspection.finding import Finding
from pysas.inspection.sample import Sample

_NEAREST = (2, 4)  # receivers, and pings, about each among which its partner must be
_STANDS_OUT = 3.8  # robust standard deviations; the best of a hundred by chance: 2.8, of a fifth of them more than this
_SURE = 5.0  # standard errors
_MISPLACED = 0.1  # share of pings with a partner elsewhere
_PAIRS = 12

Bool = npt.NDArray[np.bool_]


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


def background(coherence: FloatArray, sample: Sample) -> tuple[float, float]:
    """What traces of far pings have in common by chance: median and robust standard deviation."""
    count = sample.traces.shape[1]
    ping = np.arange(len(coherence)) // count
    heard = coherence.diagonal() > 0
    far = (np.abs(ping[:, None] - ping) > max(2, ping[-1] // 8)) & heard[:, None] & heard
    values = coherence[far] if far.any() else coherence[heard][:, heard]
    if values.size == 0:
        return 0.0, 1.0
    middle = float(np.median(values))
    return middle, 1.48 * float(np.median(np.abs(values - middle))) + 1e-6


def order(sample: Sample, coherence: FloatArray) -> Finding:
    """Partners elsewhere than the positions say; or a reversed order of pings or receivers that fits better."""
    if len(sample.pings) < 8:
        return Finding("order", "ok", "too few pings to tell")
    usual, spread = background(coherence, sample)
    for test in (_receivers, _transposed, _reversed, _pings):
        found = test(sample, coherence, usual, spread)
        if found is not None:
            return found
    return Finding("order", "ok", f"no traces more alike than neighbours (coherence by chance {usual:.2g})")


def _receivers(sample: Sample, coherence: FloatArray, usual: float, spread: float) -> Finding | None:
    """Channels whose best partner within pings is not beside them."""
    pings, count = sample.traces.shape[:2]
    if count < 4:
        return None
    inside = np.where(np.eye(count, dtype=bool), 0, within_pings(coherence, sample))
    distance = np.linalg.norm(sample.rx.mean(axis=0)[:, None] - sample.rx.mean(axis=0), axis=-1)
    best, beside = inside.max(axis=1), np.where(_near(distance, _NEAREST[0]), inside, 0).max(axis=1)
    partner = best - usual > _SURE * spread / np.sqrt(pings / 2)
    apart = partner & (beside - usual < 0.6 * (best - usual))
    if np.count_nonzero(apart) < max(3, 0.5 * count):
        return None
    # in another order they are a chain, and not in this one: what a few points have in common is neither
    given, chained = (_links(inside - usual, by) for by in (np.argsort(_along(sample)), _chain(inside - usual)))
    if given > 0.5 * chained or chained < 0.8 * float(np.mean(best - usual)):
        return None
    first = int(np.argmax(apart))
    text = f"{np.count_nonzero(apart)} of {count} receivers are most like others than those beside them"
    text += f", first channel {sample.channels[first]} like channel {sample.channels[int(np.argmax(inside[first]))]}"
    return Finding("order", "FAIL", f"{text}: receivers are shuffled against rx: reorder channels or rx")


def _along(sample: Sample) -> FloatArray:
    """Where receivers stand along their array, m."""
    places = sample.rx.mean(axis=0) - sample.rx.mean(axis=(0, 1))
    return np.asarray(places @ np.linalg.svd(places, full_matrices=False)[2][0])


def _chain(alike: FloatArray) -> npt.NDArray[np.intp]:
    """The order in which the most alike stand side by side: the Fiedler vector's."""
    weight = np.where(np.eye(len(alike), dtype=bool), 0, np.maximum(alike, 0)) ** 2
    return np.argsort(np.linalg.eigh(np.diag(weight.sum(axis=1)) - weight)[1][:, 1])


def _links(alike: FloatArray, by: npt.NDArray[np.intp]) -> float:
    """Mean of what those side by side in an order have in common."""
    return float(np.mean(alike[by[:-1], by[1:]]))


def _transposed(sample: Sample, coherence: FloatArray, usual: float, spread: float) -> Finding | None:
    """As many channels as pings, and each is the other."""
    pings, count = sample.traces.shape[:2]
    if pings != count or sample.echoes.n_ping != sample.echoes.n_channel:
        return None
    other = coherence.reshape(pings, count, pings, count).transpose(1, 0, 3, 2).reshape(coherence.shape)
    given = _score(sample, coherence, sample.tx, sample.rx, within=True)
    turned = _score(sample, other, sample.tx, sample.rx, within=True)
    if given is None or turned is None or not _clearly(given, turned, usual, spread):
        return None
    text = (
        f"coherence of echoes whose phase centres are near is {given[0]:.2g} as given, {turned[0]:.2g} with pings for channels"
    )
    return Finding("order", "FAIL", f"{text}: the first two axes are transposed: swap them")


def _reversed(sample: Sample, coherence: FloatArray, usual: float, spread: float) -> Finding | None:
    """Phase centres of pings meet at other receivers. Reversed pings and reversed receivers are each other's mirror."""
    if sample.traces.shape[1] < 2:
        return None
    given = _score(sample, coherence, sample.tx, sample.rx)
    turned = _score(sample, coherence, sample.tx, sample.rx[:, ::-1])
    if turned is None or given is None or not _clearly(given, turned, usual, spread):
        return None
    text = f"coherence of pings where their phase centres meet is {given[0]:.2g} as given, {turned[0]:.2g} the other way round"
    return Finding("order", "FAIL", f"{text}: receivers or pings are in reverse order: reorder channels or rx, or the pings")


def _clearly(given: tuple[float, int], turned: tuple[float, int], usual: float, spread: float) -> bool:
    error = spread / np.sqrt(min(given[1], turned[1]) / 2)  # each pair counts twice
    return bool(turned[0] - usual > 2 * max(given[0] - usual, 0.0) + _SURE * error)


def _pings(sample: Sample, coherence: FloatArray, usual: float, spread: float) -> Finding | None:
    """Pings whose best partner is not beside them."""
    alike = _affinity(sample, coherence, usual, spread)
    np.fill_diagonal(alike, np.nan)
    row = np.nanmedian(alike, axis=1)
    scatter = 1.48 * np.nanmedian(np.abs(alike - row[:, None]), axis=1) + 1e-6
    distance = np.linalg.norm(sample.tx[:, None] - sample.tx, axis=-1)
    best = np.nanmax(alike, axis=1)
    beside = np.nanmax(np.where(_near(distance, _NEAREST[1]), alike, -1), axis=1)
    partner = best - row > _STANDS_OUT * scatter
    apart = partner & (beside - row < 0.4 * (best - row))
    clear, elsewhere = float(partner.mean()), float(apart.mean())
    if not (elsewhere > 0.6 * clear > 0.2 or (clear > 0.4 and elsewhere > _MISPLACED)) or np.count_nonzero(apart) < 4:
        return None
    first = int(np.argmax(apart))
    there = int(np.nanargmax(alike[first]))
    text = f"{np.count_nonzero(apart)} of {len(apart)} pings are most like others than their neighbours, first ping "
    text += f"{sample.pings[first]} like ping {sample.pings[there]}"
    return Finding("order", "FAIL", f"{text}: pings are shuffled against their positions: sort both alike")


def _affinity(sample: Sample, coherence: FloatArray, usual: float, spread: float) -> FloatArray:
    """(ping, ping) how alike pings are at that offset of their channels which is best, in standard deviations of chance."""
    pings, count = sample.traces.shape[:2]
    by = coherence.reshape(pings, count, pings, count)
    best = np.full((pings, pings), -np.inf)
    for offset in range(1 - count, count):
        pairs = count - abs(offset)
        mean = np.trace(by, offset, axis1=1, axis2=3) / pairs
        best = np.maximum(best, (mean - usual) * np.sqrt(pairs) / spread)
    return best


def _centres(tx: FloatArray, rx: FloatArray) -> FloatArray:
    return np.asarray(((tx[:, None] + rx) / 2).reshape(-1, 3))


def _distances(centres: FloatArray) -> FloatArray:
    inner = centres - centres.mean(axis=0)
    square = np.sum(inner**2, axis=1)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square - 2 * inner @ inner.T, 0)))


def _near(distance: FloatArray, count: int) -> Bool:
    """Pairs of which one is among so many nearest of the other, or as near as those."""
    apart = np.where(np.eye(len(distance), dtype=bool), np.inf, distance)
    reach = np.sort(apart, axis=1)[:, min(count, len(apart) - 1) - 1]
    return np.asarray(apart <= np.maximum(reach[:, None], reach) * (1 + 1e-9))


def _score(
    sample: Sample, coherence: FloatArray, tx: FloatArray, rx: FloatArray, within: bool = False
) -> tuple[float, int] | None:
    """Mean coherence of traces whose phase centres meet, or nearly, and of how many pairs; None for fewer than twelve.

    Of different pings, unless `within` counts those of one too.
    """
    channel = rx.shape[1]
    distance = _distances(_centres(tx, rx))
    ping = np.arange(len(distance)) // channel
    distance[np.eye(len(distance), dtype=bool) if within else ping[:, None] == ping] = np.inf
    reach = 1.2 * float(np.quantile(distance.min(axis=1), 0.1)) + float(np.mean(sample.echoes.c)) / sample.echoes.fc / 16
    pairs = distance <= reach
    return (float(coherence[pairs].mean()), int(np.count_nonzero(pairs))) if np.count_nonzero(pairs) >= _PAIRS else None
