"""Strong echoes followed from ping to ping: whether any place explains their phases, and which mistake would.

What no echo shows (speckle without anything that stands out) is said to be unknown, not right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pysas._checks import FloatArray
from pysas.inspection.finding import Finding
from pysas.inspection.sample import Complex, Index, Sample
from pysas.inspection.wavefront import Echo, fit, lateness, part, swapped

_ECHOES = 5
_LEAST = 20  # pings
_FAINT = 0.1  # of the loudest: its side lobes
_BESIDE = 12  # cells about an echo that are not looked at again
_PROMINENT = 5.0  # times the median beside it
_RIGHT, _WRONG = 0.85, 0.75  # coherences; by chance 20 pings reach about 0.55
_JUMP = 0.5  # cells of range between steps of two pings that follow each other
_ROUGH = 0.9  # rad, of second differences
_SURE = 6.0  # standard errors


def followed(sample: Sample) -> list[Echo]:
    """Up to five echoes that stand out over twenty pings or more, loudest first; O(pings samples)."""
    middle = sample.traces.shape[1] // 2
    size = np.abs(sample.compressed[:, middle]).astype(np.float64)
    cell = max(1, round(sample.echoes.fs / sample.echoes.occupied_bandwidth))
    step = np.linalg.norm(np.diff(sample.tx, axis=0), axis=1)
    c = float(np.mean(sample.echoes.c))
    starts = sample.echoes.start_time[sample.pings] * sample.echoes.fs
    # samples by which an echo may move from one ping to the next
    reach = np.ceil(np.minimum(2 * step / c * sample.echoes.fs, 4 * cell)).astype(int) + 1
    found: list[Echo] = []
    left = size.copy()
    for _ in range(3 * _ECHOES):
        if len(found) == _ECHOES:
            break
        ping, at = (int(i) for i in np.unravel_index(int(np.argmax(left)), left.shape))
        if left[ping, at] <= _FAINT * size.max():
            break
        track = {ping: at}
        for way in (1, -1):
            here, drift, now = at, 0.0, ping
            while 0 <= now + way < len(size):
                shift = starts[now] - starts[now + way]
                guess = here + drift + shift
                span = int(reach[min(now, now + way)]) + 1
                low, high = max(0, round(guess) - span), min(size.shape[1], round(guess) + span + 1)
                if high <= low:
                    break
                there = low + int(np.argmax(size[now + way, low:high]))
                if not _stands_out(size[now + way], there, cell):
                    break
                drift = 0.7 * drift + 0.3 * (there - here - shift)
                here, now = there, now + way
                track[now] = here
        for p, n in track.items():
            left[p, max(0, n - _BESIDE * cell) : n + _BESIDE * cell + 1] = 0
        rows = np.array(sorted(p for p, n in track.items() if _alone(size[p], n, cell)), dtype=np.intp)
        if rows.size >= _LEAST:
            echo = _smooth(_read(sample, rows, np.array([track[p] for p in rows])))
            if len(echo.delay) >= _LEAST:
                found.append(echo)
    return found


def _stands_out(trace: FloatArray, at: int, cell: int) -> bool:
    beside = trace[max(0, at - 40 * cell) : at + 40 * cell + 1]
    return bool(trace[at] > _PROMINENT * np.median(beside) and trace[at] > 0)


def _alone(trace: FloatArray, at: int, cell: int) -> bool:
    """No other echo of a third of its size within eight cells."""
    low = max(0, at - 8 * cell)
    beside = trace[low : at + 8 * cell + 1].copy()
    beside[max(0, at - low - 2 * cell) : at - low + 2 * cell + 1] = 0
    return bool(beside.max(initial=0.0) < 0.33 * trace[at])


def _smooth(echo: Echo) -> Echo:
    """The longest part in which delays do not jump, as they do where one echo is left for another."""
    delay = echo.delay[:, echo.delay.shape[1] // 2] * echo.bandwidth
    rate = np.diff(delay) / np.diff(echo.ping)
    jumps = (np.abs(np.diff(rate, prepend=rate[:1])) > _JUMP) | (np.diff(echo.ping) > 4)
    ends = np.r_[0, np.flatnonzero(jumps) + 1, len(delay)]
    longest = int(np.argmax(np.diff(ends)))
    return part(echo, slice(int(ends[longest]), int(ends[longest + 1])))


def _read(sample: Sample, rows: Index, at: Index) -> Echo:
    """Delay and phase of an echo in all channels, about where the middle one has it."""
    echoes, compressed = sample.echoes, sample.compressed
    c, n = float(np.mean(echoes.c)), compressed.shape[-1]
    rx = sample.rx[rows]
    places = np.linalg.norm(rx - rx[:, rx.shape[1] // 2][:, None], axis=-1)
    delay, phase = np.zeros(places.shape), np.zeros(places.shape)
    middle = sample.band[0]
    for row, (ping, sample_at) in enumerate(zip(rows, at, strict=True)):
        for channel in range(places.shape[1]):
            span = int(np.ceil(places[row, channel] / c * echoes.fs))
            low, high = max(0, int(sample_at) - span), min(n, int(sample_at) + span + 1)
            trace: Complex = compressed[ping, channel].astype(np.complex128)
            size = np.abs(trace)
            peak = low + int(np.argmax(size[low:high]))
            part = 0.0
            if 0 < peak < n - 1:
                a, b, d = size[peak - 1 : peak + 2]
                part = float(np.clip(0.5 * (a - d) / (a - 2 * b + d), -0.5, 0.5)) if a - 2 * b + d < 0 else 0.0
            delay[row, channel] = echoes.start_time[sample.pings[ping]] + (sample.first + peak + part) / echoes.fs
            # about another middle of the band phases turn within the peak
            phase[row, channel] = np.angle(trace[peak]) + 2 * np.pi * middle * part / echoes.fs
    pings = sample.pings[rows]
    return Echo(delay, phase, sample.tx[rows], _heard_at(sample, pings, delay), pings, c, echoes.fc, echoes.occupied_bandwidth)


def explained(sample: Sample) -> tuple[Finding, bool]:
    """Whether a place explains the echoes with the positions given; and whether that tells of their order."""
    echoes = [echo for echo in followed(sample) if not _rough(echo)]
    fits = [fit(echo) for echo in echoes]
    if not fits:
        text = "no echo stands out over 20 pings: nothing says whether positions fit the phases"
        return Finding("positions", "ok", text), False
    agreed = [found.coherence for found in fits]
    right, wrong = sum(v >= _RIGHT for v in agreed), sum(v < _WRONG for v in agreed)
    if wrong > 2 * right:
        return _guilty(sample, echoes, float(np.median(agreed))), True
    times = sorted((len(f.echo.delay), *lateness(f)) for f in fits if f.coherence >= _RIGHT)
    least = 2 / sample.echoes.occupied_bandwidth
    told = [(pings, late) for pings, late, error in times if abs(late) > max(_SURE * error, least)]
    text = f"{right} of {len(fits)} echoes followed fit a place (coherence {max(agreed):.2f})"
    pairs = [swapped(found) for found in fits]
    if pairs[0] is not None and pairs.count(pairs[0]) > len(pairs) / 2:
        one, other = sample.channels[pairs[0]], sample.channels[pairs[0] + 1]
        words = f"{text}, and far better with the places of channels {one} and {other} changed"
        return Finding("positions", "FAIL", f"{words}: receivers are shuffled: reorder channels or rx"), True
    if told:
        sure = [late for _, late in told]
        late = float(np.median(sure))
        able = sum(_SURE * error < abs(late) for _, _, error in times)
        # what is seen from most places knows best
        if len(sure) >= 0.6 * able and told[-1][0] > 0.8 * times[-1][0] and np.ptp(sure) < 0.5 * abs(late):
            return Finding("positions", "warn", f"{text}, but {_delayed(late, fits[0].echo.c)}"), True
    return Finding("positions", "ok", text), right > 0


def _delayed(seconds: float, c: float) -> str:
    side = "late" if seconds > 0 else "early"
    text = f"come {abs(seconds):.3g} s ({abs(seconds) * c / 2:.3g} m) {side} for the curvature of their wavefronts"
    return f"{text}: a group delay is missing in t0, or c is wrong"


def _guilty(sample: Sample, echoes: list[Echo], agreed: float) -> Finding:
    """The mistake without which the echoes would fit."""
    longest = max(len(e.delay) for e in echoes)
    text = f"{len(echoes)} echoes followed over up to {longest} pings fit no place (coherence {agreed:.2f}"
    cases = [("data are conjugate", "I and Q are swapped: conjugate the data", [replace(e, phase=-e.phase) for e in echoes])]
    if echoes[0].rx.shape[1] > 1:
        turned = [replace(e, rx=e.rx[:, ::-1]) for e in echoes]
        cases.append(("receivers or pings are in reverse order", "reorder channels or rx, or the pings", turned))
    turned = [_other_way(sample, e) for e in echoes]
    cases.append(("pings or receivers are in reverse order", "reorder the samples or the positions", turned))
    best, words = _RIGHT, ""
    for name, remedy, changed in cases:
        value = float(np.median([fit(e).coherence for e in changed]))
        if value > best:
            best, words = value, f"{text}; {value:.2f} if {name}): {remedy}"
    if words:
        return Finding("positions", "FAIL", words)
    if _alone_right(echoes):
        words = "though each channel's do: receivers are shuffled or inverted, or their places, lever arms or attitude wrong"
        return Finding("positions", "FAIL", f"{text}) {words}")
    delayed = [fit(e, late=True) for e in echoes]
    near = all(abs(found.late) < 0.1 * float(found.echo.delay.mean()) for found in delayed)
    if near and float(np.median([found.coherence for found in delayed])) > _RIGHT:
        words = _delayed(float(np.median([found.late for found in delayed])), echoes[0].c)
        return Finding("positions", "warn", f"{text}) unless they {words}")
    words = "positions do not follow the motion: lever arm or attitude forgotten, clock offset, navigation drift, or c"
    return Finding("positions", "warn", f"{text}): {words}")


def _heard_at(sample: Sample, pings: Index, delay: FloatArray) -> FloatArray:
    """Receivers when echoes arrive."""
    which = np.ix_(pings, sample.channels)
    rx, moving = sample.echoes.receivers[which], sample.echoes.receiver_velocity
    return rx if moving is None else rx + moving[which] * delay[..., None]


def _other_way(sample: Sample, echo: Echo) -> Echo:
    """With the positions of the pings in reverse order."""
    pings = sample.echoes.n_ping - 1 - echo.ping
    return replace(echo, tx=sample.echoes.tx[pings], rx=_heard_at(sample, pings, echo.delay))


def _alone_right(echoes: list[Echo]) -> bool:
    """Whether the echoes of single channels fit."""
    if echoes[0].rx.shape[1] < 2:
        return False
    found = []
    for echo in echoes:
        for channel in range(echo.rx.shape[1]):
            one = slice(channel, channel + 1)
            single = replace(echo, delay=echo.delay[:, one], phase=echo.phase[:, one], rx=echo.rx[:, one])
            found.append(fit(single).coherence)
    return float(np.median(found)) >= _RIGHT


def _rough(echo: Echo) -> bool:
    """Phases of one receiver that turn unlike from ping to ping: several scatterers, noise, or shuffled pings (see `order`)."""
    if echo.rx.shape[1] > 1:
        return False  # from one ping to the next an array goes far
    bends = np.diff(echo.phase[:, echo.phase.shape[1] // 2], 2)
    return float(np.sqrt(np.mean(np.angle(np.exp(1j * bends)) ** 2))) > _ROUGH
