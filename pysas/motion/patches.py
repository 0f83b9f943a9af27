"""Small patches about bright points: where an image has some, and what each ping contributes to their pixels.

A patch is a square of PIXELS x PIXELS points in the horizontal plane through its centre, one axis along the mean horizontal
line of sight, spaced so that its image is sampled above the Nyquist rate of what the centre's pings show of it. It keeps the
terms of the sum of each ping that sees it, so that phases of pings can be tried without reading an echo again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.contributions import along_lines
from pysas.imaging.doorways import focus
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.motion.moving import VELOCITIES, centres

PIXELS = 51  # of a patch along each axis: some 12 resolution cells to either side
MARGIN = 2.0  # spacing of pixels below that of Nyquist: sums of |I|^4 depend on where pixels lie beside a peak if it is less
MOST = 32  # patches
FALSE_ALARM = 1e-3  # chance that an image of developed speckle has any bright point
DEEPEST = 10 ** (-18 / 20)  # a bright point's amplitude beside the brightest one's: what lies below is taken for its side lobes
MEDIANS = 1.25  # allows for what medians over a tile err by
TILE = 32  # pixels along each axis over which the clutter's level is taken
FAINT = 1e-3  # energy of a ping beside the strongest one's below which it does not see a point
CENTRINGS = 3  # of a patch
CENTRED = 0.25  # of a patch's half: how far from its centre its brightest pixel may be

EMPTIED = 0.5  # of a patch's energy: one that keeps less may have held another point's side lobes
LEAST_GAIN = 0.01  # nats, about 0.05 dB of a peak
COVERED = 0.9  # of the pings of such a patch are seen by those that count
METRICS = ("entropy", "sharpness")
LEAST_PINGS = 8

Int = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Detection:
    """What an image says of bright points.

    Attributes
    ----------
    centres : (point, 3)
        Of bright isolated maxima, brightest first, m.
    contrast : float
        n sum |I|^4 / (sum |I|^2)^2 over its n pixels that are not 0: 2 in developed speckle.
    highest, threshold : float
        The largest power of a pixel over the mean power of the clutter about it, and what a bright point needs, dB.
    """

    centres: FloatArray
    contrast: float
    highest: float
    threshold: float


@dataclass(frozen=True)
class Patch:
    """One patch and what pings contribute to it.

    Attributes
    ----------
    centre : (3,)
        m.
    steps : (2, 3)
        From pixel to pixel along its axes, m.
    offsets : (PIXELS,)
        Of pixels from the centre along either axis, in steps.
    pings : (n,) whole numbers
        Those that see it.
    terms : (n, PIXELS, PIXELS)
        What each contributes, all its channels together; or (1, PIXELS, PIXELS), their sum.
    look : (n, 3)
        Unit vectors from the pings' phase centres to the centre.
    turns : (2, n, 3)
        By how much they differ one step further along each axis.
    """

    centre: FloatArray
    steps: FloatArray
    offsets: FloatArray
    pings: Int
    terms: ComplexArray
    look: FloatArray
    turns: FloatArray

    def image(self) -> ComplexArray:
        """(PIXELS, PIXELS) sum over pings."""
        return np.asarray(self.terms.sum(axis=0))

    def brightest(self) -> tuple[FloatArray, float]:
        """Where its image has its largest magnitude, m, and how far that is from the centre, 1 at the patch's edge."""
        image = self.image()
        first, second = np.unravel_index(int(np.argmax(np.abs(image))), image.shape)
        at = np.array([self.offsets[first], self.offsets[second]])
        return self.centre + at @ self.steps, float(np.max(np.abs(at)) / self.offsets[-1])


def axes_of(echoes: Echoes) -> dict[str, FloatArray]:
    """(ping, 3) horizontal directions along ("surge") and across ("sway", 90 degrees on from +x towards +y) each ping's array,
    of one receiver along the way; and the vertical ("heave")."""
    middle = centres(echoes)
    index = np.arange(echoes.n_ping)
    reach = min(4, max(1, (echoes.n_ping - 1) // 2))
    way = middle[np.minimum(index + reach, index[-1])] - middle[np.maximum(index - reach, 0)]
    forward = way[:, :2]
    if echoes.n_channel > 1:
        receivers = echoes.receivers[..., :2]
        apart = np.linalg.norm(receivers - receivers[:, :1], axis=2)
        far = int(np.argmax(apart.mean(axis=0)))
        array = receivers[:, far] - receivers[:, 0]
        if np.all(np.linalg.norm(array, axis=1) > 1e-3):
            same = np.sum(array * forward, axis=1)
            forward = array * np.where(np.median(np.sign(same)) < 0, -1.0, 1.0)
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = np.divide(forward, length, out=np.tile([1.0, 0.0], (len(forward), 1)), where=length > 0)
    zero = np.zeros(len(forward))
    return {
        "surge": np.stack([forward[:, 0], forward[:, 1], zero], axis=1),
        "sway": np.stack([-forward[:, 1], forward[:, 0], zero], axis=1),
        "heave": np.stack([zero, zero, zero + 1], axis=1),
    }


def wave_numbers(echoes: Echoes) -> FloatArray:
    """(ping,) phase of an echo per metre of slant range, 4 pi fc/c, rad/m."""
    return 4 * np.pi * echoes.fc / echoes.speeds


def looks(middle: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(ping, 3) unit vectors from phase centres to a point, and (ping,) their distances, m."""
    way = point - middle
    distance = np.linalg.norm(way, axis=1)
    return way / distance[:, None], distance


def read(
    echoes: Echoes, first: FloatArray, step: FloatArray, count: int, pings: Int, tol: float, threads: int | None
) -> ComplexArray:
    """(row, count) contributions of one ping a row, all its channels together, at points from `first` (row, 3) on, a `step`
    (row, 3) apart."""
    channels = echoes.n_channel
    traces = np.stack([pings * channels, pings * channels + channels - 1], axis=1).astype(np.int64)
    return along_lines(echoes, first, step, count, traces, tol=tol, threads=threads)


def within_records(echoes: Echoes, point: FloatArray) -> Int:
    """Pings whose records hold a point's travel time."""
    _, distance = looks(centres(echoes), point)
    windows = echoes.windows
    first, last = windows[..., 0].min(axis=1), windows[..., 1].max(axis=1)
    place = (2 * distance / echoes.speeds - echoes.start_time) * echoes.fs
    return np.flatnonzero((place >= first) & (place <= last))


@np.errstate(under="ignore")
def detect(image: ComplexArray, grid: Grid, apart: float, most: int = MOST) -> Detection:
    """Bright isolated maxima of an image.

    Clutter is taken for developed speckle, whose power is exponential about a mean that medians over tiles of TILE x TILE
    pixels tell. The largest of n independent pixels exceeds mean (ln n + ln 1/p) with a chance p: FALSE_ALARM. Bright points
    exceed that by MEDIANS, are the largest within `apart` of them, and lie at most 18 dB below the brightest. Where there are
    more than `most`, those that are farther apart are taken first.
    """
    magnitude = np.abs(image).astype(np.float64)
    power = magnitude**2
    lit = power > 0
    count = int(np.count_nonzero(lit))
    threshold = MEDIANS * (np.log(max(count, 1)) + np.log(1 / FALSE_ALARM))
    if count == 0:
        return Detection(np.zeros((0, 3)), 0.0, -np.inf, 10 * np.log10(threshold))
    total = float(power.sum())
    contrast = float(count * np.sum((power / total) ** 2))
    ratio = power / _clutter(power, lit)
    highest = float(10 * np.log10(np.max(np.where(lit, ratio, 0.0), initial=1e-300)))
    bright = np.flatnonzero(((ratio > threshold) & (magnitude >= DEEPEST * magnitude.max())).ravel())
    if bright.size == 0:
        return Detection(np.zeros((0, 3)), contrast, highest, 10 * float(np.log10(threshold)))
    bright = bright[np.argsort(-power.ravel()[bright], kind="stable")]
    bright = bright[:1] if most == 1 else bright
    places = grid.coordinates(bright)
    chosen = spread(places, apart, most)
    return Detection(places[chosen], contrast, highest, 10 * float(np.log10(threshold)))


def spread(places: FloatArray, apart: float, most: int = MOST) -> list[int]:
    """Which of (n, 3) places in order of their worth are kept, `apart` from each other; first those that are farther apart."""
    chosen: list[int] = []
    peaks: list[int] = []
    left = np.ones(len(places), dtype=bool)
    while left.any():  # of each neighbourhood the brightest
        one = int(np.argmax(left))
        peaks.append(one)
        left &= np.linalg.norm(places - places[one], axis=1) > apart
    for distance in (4 * apart, 2 * apart, apart):
        for one in peaks:
            if len(chosen) == most:
                return sorted(chosen)
            near = np.linalg.norm(places[chosen] - places[one], axis=1) if chosen else np.array([np.inf])
            if one not in chosen and near.min() > distance * (1 - 1e-12):
                chosen.append(one)
    return sorted(chosen)


def _clutter(power: FloatArray, lit: npt.NDArray[np.bool_]) -> FloatArray:
    """Mean power of the clutter about each pixel, from medians over tiles (ln 2 of an exponential's mean), between whose
    middles, and beyond, decibels go in straight lines."""
    overall = float(np.median(power[lit]))
    if power.ndim != 2 or min(power.shape) < 2 * TILE:
        return np.full(power.shape, overall / np.log(2))
    counts = [n // TILE for n in power.shape]
    edges = [np.linspace(0, n, k + 1).astype(int) for n, k in zip(power.shape, counts, strict=True)]
    level = np.full(counts, overall)
    for i, j in np.ndindex(*counts):
        tile = (slice(edges[0][i], edges[0][i + 1]), slice(edges[1][j], edges[1][j + 1]))
        inside = power[tile][lit[tile]]
        if inside.size > TILE:
            level[i, j] = np.median(inside)
    rows, columns = (_between(n, k) for n, k in zip(power.shape, counts, strict=True))
    return np.asarray(np.exp(rows @ np.log(level) @ columns.T) / np.log(2))


def _between(size: int, count: int) -> FloatArray:
    """(size, count) weights of straight lines through the middles of `count` tiles."""
    at = (np.arange(size) + 0.5) * count / size - 0.5
    first = np.clip(np.floor(at).astype(int), 0, count - 2)
    weights = np.zeros((size, count))
    weights[np.arange(size), first] = 1 - (at - first)
    weights[np.arange(size), first + 1] = at - first
    return weights


def steps_of(echoes: Echoes, point: FloatArray, pings: Int, energy: FloatArray) -> FloatArray:
    """(2, 3) steps between a patch's pixels: across and along the mean horizontal line of sight."""
    look, _ = looks(centres(echoes)[pings], point)
    mean = (energy[:, None] * look).sum(axis=0)[:2]
    if np.linalg.norm(mean) < 0.1 * energy.sum():  # seen from all round
        mean = look[0, :2]
    along = np.array([*(mean / max(np.linalg.norm(mean), 1e-300)), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    k = wave_numbers(echoes)[pings]
    edges = 1 + np.array([-0.5, 0.5]) * echoes.occupied_bandwidth / echoes.fc
    steps = []
    for axis in (across, along):
        numbers = (k * (look @ axis))[:, None] * edges
        extent = max(float(np.ptp(numbers)), 1e-9)
        steps.append(axis * 2 * np.pi / extent / MARGIN)
    return np.array(steps)


def made(
    echoes: Echoes, points: FloatArray, tol: float, threads: int | None, summed: bool = False
) -> list[Patch | None]:  # fmt: skip
    """A patch about each of (n, 3) points, its terms read, or their sum alone in place of them (1, PIXELS, PIXELS); None for
    points that fewer than two pings see."""
    middle = centres(echoes)
    rows = [within_records(echoes, point) for point in points]
    if not any(len(row) for row in rows):
        return [None] * len(points)
    every = np.repeat(points, [len(row) for row in rows], axis=0)
    first = read(echoes, every, np.zeros_like(every), 1, np.concatenate(rows), tol, threads)[:, 0]
    offsets: FloatArray = np.arange(PIXELS, dtype=np.float64) - PIXELS // 2
    patches: list[Patch | None] = []
    ends = np.cumsum([len(row) for row in rows])
    for point, row, end in zip(points, rows, ends, strict=True):
        energy = np.abs(first[end - len(row) : end]).astype(np.float64) ** 2
        energy = scipy.ndimage.uniform_filter1d(energy, max(min(5, energy.size), 1), mode="nearest")
        seen = (energy > FAINT * np.max(energy, initial=0.0)) & (energy > 0)
        if np.count_nonzero(seen) < 2:
            patches.append(None)
            continue
        pings = row[seen]
        steps = steps_of(echoes, point, pings, energy[seen])
        lines = np.tile(point + offsets[0] * steps[1] + offsets[:, None] * steps[0], (pings.size, 1))
        way = np.broadcast_to(steps[1], lines.shape)
        terms = read(echoes, lines, way, PIXELS, np.repeat(pings, PIXELS), tol, threads)
        terms = terms.reshape(-1, PIXELS, PIXELS)
        terms = terms.sum(axis=0, keepdims=True) if summed else terms
        look, distance = looks(middle[pings], point)
        turns = np.stack([(step - look * (look @ step)[:, None]) / distance[:, None] for step in steps])
        patches.append(Patch(point, steps, offsets, pings, terms, look, np.asarray(turns, dtype=np.float64)))
    return patches


def centred(
    echoes: Echoes, points: FloatArray, tol: float, threads: int | None, summed: bool = False
) -> list[Patch | None]:  # fmt: skip
    """A patch for each point whose brightest pixel is near its centre; None where the peak drifts on after CENTRINGS."""
    places = np.array(points)
    kept: list[Patch | None] = [None] * len(places)
    left = list(range(len(places)))
    for _ in range(CENTRINGS):
        if not left:
            break
        again = []
        for number, patch in zip(left, made(echoes, places[left], tol, threads, summed), strict=True):
            if patch is None:
                continue
            place, far = patch.brightest()
            if far <= CENTRED:
                kept[number] = patch
            else:
                places[number] = place
                again.append(number)
        left = again
    return kept


def cost_of(power: FloatArray, metric: str) -> tuple[float, FloatArray]:
    """Cost of an image of this |I|^2, and its derivative by |I|^2."""
    total = float(power.sum())
    if metric == "entropy":
        share = power / total
        logarithm = np.log(np.where(share > 0, share, 1.0))
        entropy = -float(np.sum(share * logarithm))
        return entropy, -(logarithm + entropy) / total
    fourth = float(np.sum(power**2))
    return -float(np.log(fourth / total**2)), -(2 * power / fourth - 2 / total)


def costs(patches: Sequence[Patch], metric: str) -> FloatArray:
    """(patch,) costs of patches as they are."""
    return np.array([cost_of(np.abs(patch.image()).astype(np.float64) ** 2, metric)[0] for patch in patches])


@dataclass(frozen=True)
class Verdict:
    """Whether a track is better by its patches: `kept` are the numbers of those that hold a point, none of which may have
    become worse, and `gain` is by how much their costs' mean fell."""

    better: bool
    kept: list[int]
    why: str
    gain: float = 0.0


def judged(before: Sequence[Patch], after: Sequence[Patch | None], metric: str) -> Verdict:
    """Compare patches with one track and with another.

    The cost of every patch has to fall, and their mean by LEAST_GAIN, as clutter alone lets it fall a little with any track
    that is fitted to it. Only a patch that held side lobes of a smeared point elsewhere does not count (`_emptied`), if those
    that count are at least half of all, and are seen by the pings that it was seen by.
    """
    if not before:
        return Verdict(False, [], "no bright points")
    old = costs(before, metric)
    empty = _emptied(before, after)
    counted = [number for number in range(len(before)) if number not in empty]
    now = costs([patch for number, patch in enumerate(after) if patch is not None and number in counted], metric)
    rising = int(np.count_nonzero(~(now < old[counted])))
    if rising:
        return Verdict(False, counted, f"{metric} rises in {rising} of {len(before)} patches")
    if 2 * len(counted) < len(before):
        return Verdict(False, counted, f"{len(empty)} of {len(before)} bright points left their patches")
    seen = seen_by([before[number] for number in counted])
    if any(np.mean(np.isin(before[number].pings, seen)) < COVERED for number in empty):
        return Verdict(False, counted, "a bright point left its patch, and no other sees its pings")
    gain = float(np.mean(old[counted] - now))
    if gain < LEAST_GAIN:
        return Verdict(False, counted, f"{metric} falls by {gain:.2g} alone, which clutter may do")
    without = f", {len(empty)} others were side lobes" if empty else ""
    return Verdict(True, counted, f"{metric} falls in all {len(counted)} patches{without}", gain)


def _emptied(before: Sequence[Patch], after: Sequence[Patch | None]) -> set[int]:
    """Patches that held no point, but side lobes or a point far off the height: their peak drifted off, they have lost half
    their energy, or their peak has fallen to where it would not be taken for a point."""
    gone = {number for number, patch in enumerate(after) if patch is None}
    there = [(number, patch) for number, patch in enumerate(after) if patch is not None]
    if not there:
        return gone
    kept = np.array([_energy(patch) / _energy(before[number]) for number, patch in there])
    peak = np.array([np.max(np.abs(patch.image())) for _, patch in there])
    was = np.array([np.max(np.abs(before[number].image())) for number, _ in there])
    faint = (peak < was) & (peak < DEEPEST * peak.max())
    return gone | {number for (number, _), one in zip(there, (kept < EMPTIED) | faint, strict=True) if one}


def stands_out(patch: Patch) -> bool:
    """Whether its brightest pixel is a bright point beside the rest of the patch, as in `detect`."""
    power = np.abs(patch.image()).astype(np.float64) ** 2
    return bool(power.max() * np.log(2) > np.median(power) * (np.log(power.size) + np.log(1 / FALSE_ALARM)))


def _energy(patch: Patch) -> float:
    return float(np.sum(np.abs(patch.image()).astype(np.float64) ** 2))


def without_gauge(
    series: FloatArray, directions: Sequence[FloatArray], middle: FloatArray, seen: Int
) -> tuple[FloatArray, FloatArray]:
    """(component, ping) displacements without what no image tells, and that, (component, 2): of a line each one's mean, m, and
    slope, m/m; of a track that turns by more than a radian what of each a shift of everything along x and y does, m.

    Pings before the first and after the last that are seen keep these two's displacements.
    """
    way = np.diff(middle, axis=0)
    turned = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    found, kept = [], []
    for row, direction in zip(series, directions, strict=True):
        if np.ptp(turned) > 1:
            design = direction[:, :2]
        else:
            arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(way, axis=1))])
            design = np.stack([np.ones(arc.size), arc - arc[seen].mean()], axis=1)
        part, *_ = np.linalg.lstsq(design[seen], row[seen], rcond=1e-9)
        kept.append((row - design @ part)[held(seen, len(row))])
        found.append(part)
    return np.array(kept), np.array(found)


def held(seen: Int, n_ping: int) -> Int:
    """(ping,) each ping, or the first or last that is seen where that lies between."""
    return np.clip(np.arange(n_ping), seen[0], seen[-1])


def seen_by(patches: Sequence[Patch]) -> Int:
    """Pings that see at least one of the patches."""
    return np.unique(np.concatenate([patch.pings for patch in patches]))


def shifts(series: FloatArray, directions: Sequence[FloatArray]) -> FloatArray:
    """(ping, 3) of (component, ping) displacements along (ping, 3) directions each."""
    return np.asarray(np.einsum("cp,cpx->px", series, np.asarray(directions)))


def moved_place(patch: Patch, place: FloatArray, shift: FloatArray) -> FloatArray:
    """Where a point at `place` appears once its pings are shifted by (n, 3), m, on top: horizontally, by least squares of slant
    ranges."""
    wanted = np.sum(patch.look * shift, axis=1)
    design = np.column_stack([patch.look[:, :2], np.ones(len(wanted))])
    found, *_ = np.linalg.lstsq(design, wanted, rcond=1e-9)
    return np.asarray(place + np.array([found[0], found[1], 0.0]))


def require(
    echoes: Any, grid: Any, components: Any, known: Sequence[str], velocity: Any, metric: Any = "entropy"
) -> tuple[str, ...]:
    """Check what both methods are given; returns the components."""
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not echoes.compressed:
        raise ValueError("echoes: raw: expected range-compressed echoes: pysas.compress(echoes)")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected a pysas.Grid")
    if isinstance(components, str) or not isinstance(components, Sequence) or not components:
        raise TypeError(f"components={components!r}: expected a sequence of some of {', '.join(known)}")
    names = tuple(_checks.choice("components", name, known) for name in components)
    if len(set(names)) < len(names):
        raise ValueError(f"components={components!r}: expected each of them once")
    _checks.choice("velocity", velocity, VELOCITIES)
    _checks.choice("metric", metric, METRICS)
    if echoes.n_ping < LEAST_PINGS:
        raise ValueError(f"echoes: {echoes.n_ping} pings: expected at least {LEAST_PINGS} to find a track by")
    way = np.linalg.norm(np.diff(centres(echoes), axis=0), axis=1)
    if not way.any():
        raise ValueError("echoes: all pings are at one place: expected a track that moves")
    if all(np.array_equal(ping, echoes.data[0]) for ping in echoes.data[1:]):
        raise ValueError("echoes: all pings hold the same samples: expected those of a track that moves")
    return names


def emptiness(detection: Detection) -> str:
    """Why there is nothing to go by."""
    if not np.isfinite(detection.highest):
        return "nothing found: the image of the grid is empty"
    return (
        f"not informative: the brightest pixel is {detection.highest:.3g} dB above the clutter about it, a bright point "
        f"{detection.threshold:.3g} dB"
    )


def share_seen(patches: Sequence[Patch], n_ping: int) -> float:
    """Of the pings, that see at least one patch."""
    return len(seen_by(patches)) / n_ping if patches else 0.0


def found(echoes: Echoes, grid: Grid, tol: float, threads: int | None) -> Detection:
    """Bright points of the grid's image with the track as it is, so far apart that the brightest one's patch would hold no
    other."""
    image = np.asarray(focus(echoes, grid, tol=tol, threads=threads).data)
    first = detect(image, grid, 0.0, most=1)
    if not len(first.centres):
        return first
    (patch,) = made(echoes, first.centres, tol, threads, summed=True)
    if patch is None:
        return dataclasses.replace(first, centres=first.centres[:0])
    return detect(image, grid, apart=2 * float(patch.offsets[-1] * np.linalg.norm(patch.steps, axis=1).max()))
