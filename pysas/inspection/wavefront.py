"""Where a scatterer must stand for its echoes' delays and phases: least squares on few numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

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
    ping : (ping,)
        Which they are.
    c, fc, bandwidth : float
    """

    delay: FloatArray
    phase: FloatArray
    tx: FloatArray
    rx: FloatArray
    ping: npt.NDArray[np.intp]
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
    """The best place: how the phases agree there, and by how much delays are later than its, s; the echoes that it is of."""

    coherence: float
    place: FloatArray
    late: float
    echo: Echo


def fit(echo: Echo, late: bool = False) -> Fit:
    """The place whose phases agree best among those that the delays allow.

    From twelve directions about the track; delays first (Gauss-Newton), then phases along what delays leave open. With `late`
    delays are known up to a constant.
    """
    best = Fit(0.0, np.zeros(3), 0.0, echo)
    for start in _starts(echo):
        place = _by_delay(echo, start, late)
        kept = _kept(echo, place)
        if kept is None:
            continue
        place = _by_phase(kept, _along(kept, _by_delay(kept, place, late)), late)
        agreed = kept.coherence(place)
        left = kept.delay - kept.travel(place)
        mean = float(np.median(left))
        spread = 1.5 * float(np.median(np.abs(left - mean)))
        # places far from what was heard may agree by chance
        if spread < 0.5 / echo.bandwidth and (late or abs(mean) < 1.0 / echo.bandwidth) and agreed > best.coherence:
            best = Fit(agreed, place, mean, kept)
    return best


def part(echo: Echo, rows: npt.NDArray[np.bool_] | slice) -> Echo:
    """Some of its pings."""
    names = ("delay", "phase", "tx", "rx", "ping")
    return replace(echo, **{name: getattr(echo, name)[rows] for name in names})


def _kept(echo: Echo, place: FloatArray) -> Echo | None:
    """The pings whose delays are a place's, up to a constant; None for fewer than two thirds: others' echoes come between."""
    if not np.all(np.isfinite(place)):
        return None
    left = echo.delay - echo.travel(place)
    left = np.abs(left - np.median(left)).max(axis=1)
    rows = left <= max(3 * float(np.median(left)), 0.3 / echo.bandwidth)
    if np.count_nonzero(rows) < max(8, 0.66 * rows.size):
        return None
    return part(echo, rows)


def _starts(echo: Echo) -> list[FloatArray]:
    centres = (echo.tx + echo.rx.mean(axis=1)) / 2
    middle = centres[len(centres) // 2]
    frame = np.linalg.svd(centres - centres.mean(axis=0))[2]
    along = (centres - middle) @ frame[0]
    reach = echo.c / 2 * float(echo.delay[len(centres) // 2].mean())
    near = np.abs(along) <= 0.5 * reach
    slope = np.polyfit(along[near], echo.delay.mean(axis=1)[near], 1)[0] if np.ptp(along[near]) > 0 else 0.0
    aside = float(np.clip(-echo.c / 2 * slope, -0.95, 0.95))
    turns = (np.arange(12) + 0.5) * np.pi / 6  # not in a bent track's own plane, which no step leaves
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


def _by_phase(echo: Echo, place: FloatArray, range_free: bool = False) -> FloatArray:
    """Gauss-Newton on the phases left; the mean delay holds the range, within a tenth of a cell, unless that is free."""
    held = 0.0 if range_free else 2 * np.pi * echo.bandwidth / 0.1
    rcond = 1e-6 if range_free else 1e-4

    def cost(at: FloatArray) -> float:
        late = float(np.median(echo.delay - echo.travel(at)))
        return float(np.sum(echo.left(at) ** 2)) + (held * late) ** 2

    for _ in range(_STEPS):
        slope = echo.slope(place).reshape(-1, 3)
        left = echo.left(place).ravel()
        rows = 2 * np.pi * echo.fc * (slope - slope.mean(axis=0))
        late = float(np.median(echo.delay - echo.travel(place)))
        rows = np.vstack([rows, held * slope.mean(axis=0)])
        step = np.linalg.lstsq(rows, np.r_[left.mean() - left, held * late], rcond=rcond)[0]
        if not np.all(np.isfinite(step)) or cost(place + step) >= cost(place):
            break
        place = place + step
    return place


def lateness(found: Fit) -> tuple[float, float]:
    """By how much delays are later than the curvature of the wavefront says, and the standard error of that, s.

    Infinite where phases leave the range open, as on a level circle, where another depth does as well, or fit no better for it.
    """
    echo = found.echo
    place = _by_phase(echo, found.place, range_free=True)
    slope = echo.slope(place).reshape(-1, 3)
    inner = 2 * np.pi * echo.fc * (slope - slope.mean(axis=0))
    values, axes = np.linalg.svd(inner, full_matrices=False)[1:]
    told = values > 1e-6 * values[0]
    # along each axis: how the delay changes, and how well phases tell it; each ping is one look, channels see alike, and
    # a tenth of a radian of what is left may be no noise
    gain = axes @ slope.mean(axis=0)
    noise = (float(np.std(echo.left(place))) + 0.1) * np.sqrt(echo.rx.shape[1])
    error = float(np.sqrt(np.sum((gain[told] * noise / values[told]) ** 2)))
    if np.linalg.norm(gain[~told]) > 1e-3 * np.linalg.norm(gain):
        error = np.inf
    held, free = 1 - found.coherence, 1 - echo.coherence(place)
    if held < 3e-3 or free > held / 2:
        error = np.inf
    return float(np.median(echo.delay - echo.travel(place))), error


def swapped(found: Fit) -> int | None:
    """A channel that with the next one's place explains the phases far better; None: there is none."""
    left = 1 - found.coherence
    for channel in range(found.echo.rx.shape[1] - 1):
        order = np.arange(found.echo.rx.shape[1])
        order[[channel, channel + 1]] = channel + 1, channel
        other = replace(found.echo, rx=found.echo.rx[:, order])
        if 1 - other.coherence(_by_phase(other, found.place)) < 0.2 * left - 1e-3:
            return channel
    return None
