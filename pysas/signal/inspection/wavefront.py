"""Where a scatterer must stand for its echoes' delays and phases: least squares on few numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pysas._checks import FloatArray

_STEPS = 12


@dataclass(frozen=True)
class Echo:
    """One scatterer's echoes, as they were read.

    Attributes
    ----------
    delay : (ping, channel)
        Two-way travel times, s.
    phase : (ping, channel)
        rad, of A exp(-2j pi fc delay) up to one constant.
    tx, rx : (ping, 3), (ping, channel, 3)
        Where the positions given have transmitter and receivers, m; receivers when the echo arrives.
    c, fc, bandwidth : float
    """

    delay: FloatArray
    phase: FloatArray
    tx: FloatArray
    rx: FloatArray
    c: float
    fc: float
    bandwidth: float

    def travel(self, place: FloatArray) -> FloatArray:
        """Two-way travel times to a place (3,), s."""
        out = np.linalg.norm(place - self.tx, axis=-1)[:, None]
        return np.asarray((out + np.linalg.norm(place - self.rx, axis=-1)) / self.c)

    def slope(self, place: FloatArray) -> FloatArray:
        """(ping, channel, 3) derivative of `travel`."""
        out = (place - self.tx)[:, None]
        back = place - self.rx
        unit = out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-12)
        return np.asarray((unit + back / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-12)) / self.c)

    def left(self, place: FloatArray) -> FloatArray:
        """Phases that the place leaves, rad about their mean."""
        turned = np.exp(1j * (self.phase + 2 * np.pi * self.fc * self.travel(place)))
        return np.asarray(np.angle(turned * np.conj(turned.mean())))

    def coherence(self, place: FloatArray) -> float:
        """|mean exp(j phase left)|: 1 where all agree."""
        return float(abs(np.mean(np.exp(1j * (self.phase + 2 * np.pi * self.fc * self.travel(place))))))


@dataclass(frozen=True)
class Fit:
    """The best place: how the phases agree there, and by how much delays are later than its, s."""

    coherence: float
    place: FloatArray
    late: float


def fit(echo: Echo, late: bool = False) -> Fit:
    """The place whose phases agree best among those that the delays allow.

    From twelve directions about the track; delays first (Gauss-Newton), then phases along what delays leave open. With `late`
    delays are known up to a constant.
    """
    best = Fit(0.0, np.zeros(3), 0.0)
    for start in _starts(echo):
        place = _by_delay(echo, start, late)
        kept = _kept(echo, place)
        if kept is None:
            continue
        place = _by_phase(kept, _along(kept, _by_delay(kept, place, late)))
        agreed = kept.coherence(place)
        left = kept.delay - kept.travel(place)
        mean = float(np.median(left))
        spread = 1.5 * float(np.median(np.abs(left - mean)))
        # places far from what was heard may agree by chance
        if spread < 0.5 / echo.bandwidth and (late or abs(mean) < 1.0 / echo.bandwidth) and agreed > best.coherence:
            best = Fit(agreed, place, mean)
    return best


def _kept(echo: Echo, place: FloatArray) -> Echo | None:
    """The pings whose delays are a place's, up to a constant; None for fewer than two thirds: others' echoes come between."""
    if not np.all(np.isfinite(place)):
        return None
    left = echo.delay - echo.travel(place)
    left = np.abs(left - np.median(left)).max(axis=1)
    rows = left <= max(3 * float(np.median(left)), 0.3 / echo.bandwidth)
    if np.count_nonzero(rows) < max(8, 0.66 * rows.size):
        return None
    return replace(echo, delay=echo.delay[rows], phase=echo.phase[rows], tx=echo.tx[rows], rx=echo.rx[rows])


def _starts(echo: Echo) -> list[FloatArray]:
    centres = (echo.tx + echo.rx.mean(axis=1)) / 2
    middle = centres[len(centres) // 2]
    frame = np.linalg.svd(centres - centres.mean(axis=0))[2]
    along = (centres - middle) @ frame[0]
    reach = echo.c / 2 * float(echo.delay[len(centres) // 2].mean())
    near = np.abs(along) <= 0.5 * reach
    slope = np.polyfit(along[near], echo.delay.mean(axis=1)[near], 1)[0] if np.ptp(along[near]) > 0 else 0.0
    aside = float(np.clip(-echo.c / 2 * slope, -0.95, 0.95))
    turns = np.arange(12) * np.pi / 6
    around = np.cos(turns)[:, None] * frame[1] + np.sin(turns)[:, None] * frame[2]
    return list(middle + reach * (aside * frame[0] + np.sqrt(1 - aside**2) * around))


def _by_delay(echo: Echo, place: FloatArray, late: bool) -> FloatArray:
    """Least squares of the delays, with an unknown constant where `late`; steps held within a tenth of the range."""
    for _ in range(_STEPS):
        slope = echo.slope(place).reshape(-1, 3)
        left = (echo.delay - echo.travel(place)).ravel()
        if late:
            slope = slope - slope.mean(axis=0)
            left = left - np.median(left)
        # another echo in some pings or channels must not bend the rest
        held = 2 * float(np.median(np.abs(left))) + 0.05 / echo.bandwidth
        step = np.linalg.lstsq(slope, np.clip(left, -held, held), rcond=2e-4)[0]
        reach = float(np.linalg.norm(place - echo.tx[len(echo.tx) // 2]))
        length = float(np.linalg.norm(step))
        place = place + step * min(1.0, 0.1 * reach / max(length, 1e-12))
    return place


def _along(echo: Echo, place: FloatArray) -> FloatArray:
    """The best of places along the direction that delays tell least of and phases most: within some ten cells."""
    slope = echo.slope(place).reshape(-1, 3)
    _, values, axes = np.linalg.svd(slope - slope.mean(axis=0), full_matrices=False)
    rms = values * 2 * np.pi * echo.fc / np.sqrt(len(slope))  # rad a metre
    found = place
    for axis, size in zip(axes, rms, strict=True):
        if size * echo.c / echo.bandwidth < 0.3:
            continue  # within what delays tell, phases do not change
        steps = np.arange(-16, 17) * 0.5 / size
        places = [found + step * axis for step in steps]
        found = places[int(np.argmax([echo.coherence(p) for p in places]))]
    return found


def _by_phase(echo: Echo, place: FloatArray) -> FloatArray:
    """Gauss-Newton on the phases left."""
    for _ in range(_STEPS):
        slope = echo.slope(place).reshape(-1, 3)
        slope = 2 * np.pi * echo.fc * (slope - slope.mean(axis=0))
        left = echo.left(place).ravel()
        step = np.linalg.lstsq(slope, -(left - left.mean()), rcond=1e-2)[0]
        moved = place + step
        if not np.all(np.isfinite(moved)) or echo.coherence(moved) < echo.coherence(place):
            break
        place = moved
    return place
