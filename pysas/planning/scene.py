"""What the planner sees of a scene: geometry about its centre, each trace's window, the shape of the work. No choices."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import MONOSTATIC, MOVING, STOP_AND_HOP
from pysas.engine.traces import BEAM, CONE, FAN, NO_BEAM, TRACE, Records, record
from pysas.model import beam as beams
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.planning.rows import Lines

UNIFORM = "uniform-angle"
SAMPLED, TRACES = 400, 32  # pixels and traces by whose pairs shares of the terms are guessed
DRAWN = 4096  # pixels whose terms are looked at when data arrive
PAIRS = 2**21  # of pixels and traces looked at where no term was found


class Scene:
    """What the planner sees: geometry about the scene's centre, the window of every trace, the shape of the work."""

    @np.errstate(over="ignore", invalid="ignore")  # coordinates too large for their squares: tol refuses them
    def __init__(
        self, echoes: Echoes, grid: Grid, weights: npt.ArrayLike | str | None, hears: npt.NDArray[np.int64] | None = None
    ) -> None:
        """`hears` : (row, 2) first and last trace, by flat number, that a row of a grid of points hears; None: all."""
        self.fs, self.fc = echoes.fs, echoes.fc
        # the least: wave numbers by it are the largest of any trace
        self.c, self.mean_speed = float(np.min(echoes.speeds)), echoes.mean_speed
        self.one_speed = bool(np.all(echoes.speeds == self.c))
        self.n_sample, self.dtype = echoes.n_sample, echoes.dtype
        self.band = echoes.occupied_bandwidth / 2 / echoes.fs
        pings, channels = echoes.n_ping, echoes.n_channel
        self.traces, self.channels = pings * channels, channels
        self.hears = hears
        self.lines = found = lines(grid) if hears is None or isinstance(grid, Lines) else None
        low, high = _box(grid)
        self.origin = (low + high) / 2
        low, high = low - self.origin, high - self.origin
        tx = np.repeat(echoes.tx - self.origin, channels, axis=0)
        rx = (echoes.receivers - self.origin).reshape(-1, 3)
        velocity = echoes.receiver_velocity
        moving = velocity is not None and bool(np.any(velocity))
        self.kind = MOVING if moving else MONOSTATIC if np.array_equal(tx, rx) else STOP_AND_HOP
        self.trace = trace = np.zeros(self.traces, TRACE)
        trace["tx"], trace["rx"] = tx, rx
        if velocity is not None:
            trace["velocity"] = velocity.reshape(-1, 3)
        self.beam, self.all_lit = record(BEAM, shape=NO_BEAM, half_angle=np.pi, full_angle=np.pi), False
        if echoes.beam is not None:
            fan = echoes.beam.shape == beams.FAN
            edge = 0.0 if echoes.beam.taper > 0 else beams.EDGE_ANGLE
            half = echoes.beam.half_angle
            full = (1 - echoes.beam.taper) * half + edge
            trace["boresight"] = np.repeat(np.broadcast_to(echoes.beam.boresights, (pings, 3)), channels, axis=0)
            if fan:
                trace["axis"] = np.repeat(np.broadcast_to(echoes.beam.axes, (pings, 3)), channels, axis=0)
            self.all_lit = _lights(trace, fan, full, low, high)
            if not self.all_lit:
                self.beam = record(BEAM, shape=FAN if fan else CONE, half_angle=half + edge, full_angle=full)
        trace["t0"] = np.repeat(echoes.start_time, channels)
        trace["c"] = np.repeat(echoes.speeds, channels)
        self.valid = echoes.windows.reshape(-1, 2).astype(np.int64)  # first and last sample recorded of each trace
        trace["first"], trace["last"] = self.valid.T
        self.uniform = isinstance(weights, str)
        self.weights = _weights(weights, pings, channels)
        self.lattice: Any = None  # weights that change from pixel to pixel, see view_angles.py
        self.each = False  # these are computed pixel by pixel
        self.low, self.high = low, high
        self.bottom, self.top = float(low[2]), float(high[2])
        near_tx, far_tx = distances(tx, low, high)
        near_rx, far_rx = distances(rx, low, high)
        speed = np.linalg.norm(trace["velocity"], axis=1)
        self.nearest = float(min(near_tx.min(), near_rx.min()))
        self.farthest = float(max(far_tx.max(), far_rx.max()))
        # indices that any pixel can ask for, within the record
        self.first = self._index(np.floor(((near_tx + near_rx) / (trace["c"] + speed) - trace["t0"]) * self.fs))
        self.last = self._index(np.ceil(((far_tx + far_rx) / (trace["c"] - speed) - trace["t0"]) * self.fs))
        begin, end = self.valid.T
        self.heard = (self.last >= begin) & (self.first <= end) & (begin <= end)
        if hears is not None:
            steps = np.zeros(self.traces + 1, dtype=np.int64)
            np.add.at(steps, hears[:, 0], 1)
            np.add.at(steps, hears[:, 1] + 1, -1)
            self.heard &= np.cumsum(steps[:-1]) > 0
        self.first, self.last = np.maximum(self.first, begin), np.minimum(self.last, end)
        self.pixels = grid.size if grid.mask is None else int(np.count_nonzero(grid.mask))
        self._grid = grid
        self.step = self.uneven = 0.0
        if found is not None:
            self.step = float(np.max(np.linalg.norm(found[1], axis=1)))
            self.line_length, self.uneven = grid.shape[-1], found[2]

    @functools.cached_property
    def slope(self) -> float:
        """Largest share of a step along a line that changes the one-way range, or so; see _slope."""
        if self.lines is None:
            return 0.0
        names = ("tx",) if self.kind == MONOSTATIC else ("tx", "rx")
        return _slope(self.lines, self.origin, tuple(self.trace[name] for name in names), self.line_length)

    @functools.cached_property
    def _pixels(self) -> FloatArray:
        return self._draw(SAMPLED, 0)

    @functools.cached_property
    def drawn(self) -> FloatArray:
        """Some of the pixels wanted, about the scene's centre."""
        return self._draw(DRAWN, 1)

    def _draw(self, number: int, seed: int) -> FloatArray:
        some, mask = _spread(number, self.pixels, seed), self._grid.mask
        return self._grid.coordinates(some if mask is None else np.flatnonzero(mask)[some]) - self.origin

    def _index(self, place: FloatArray) -> npt.NDArray[np.int64]:
        """Places as whole numbers, all beyond the record's ends alike: they may be larger than any int64."""
        return np.clip(place, -1, self.n_sample).astype(np.int64)

    @functools.cached_property
    def lit(self) -> float:
        """About the share of (trace, pixel) pairs within record and beam: the terms."""
        # a stride might meet one channel alone
        some = np.linspace(0, self.traces - 1, min(self.traces, TRACES)).astype(np.int64)
        _, share = self.read(some, self._pixels, np.tile(np.arange(len(self._pixels)), (some.size, 1)))
        return float(np.mean(share > 0)) if share.size else 0.0

    def read(
        self, traces: npt.NDArray[np.int64], pixels: FloatArray, pick: npt.NDArray[np.int64]
    ) -> tuple[FloatArray, FloatArray]:
        """Where pixels `pick` (trace, some) read traces, samples, to within a sample; and what of each term is left.

        By its beam, 0 to 1; 0 beyond what was recorded.
        """
        index, share = self._look(traces, pixels, pick)
        return index, np.where(self._within(traces, index), share, 0.0)

    def _within(self, traces: npt.NDArray[np.int64], index: FloatArray) -> npt.NDArray[np.bool_]:
        first, last = self.valid[traces].T[..., None]
        return np.asarray((index >= first) & (index <= last))

    def _look(
        self, traces: npt.NDArray[np.int64], pixels: FloatArray, pick: npt.NDArray[np.int64]
    ) -> tuple[FloatArray, FloatArray]:
        """The same whatever the records' ends."""
        some = self.trace.take(traces)
        speed = some["c"][:, None]
        tx, rx, velocity, boresight, axis = (some[name].T[..., None] for name in ("tx", "rx", "velocity", "boresight", "axis"))
        pixel = [pixels[:, k][pick] for k in range(3)]
        away = [pixel[k] - tx[k] for k in range(3)]
        out = np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
        back = out
        if self.kind != MONOSTATIC:
            for _ in range(3 if self.kind == MOVING else 1):
                late = (out + back) / speed  # of receivers that have moved: twice again is enough
                home = [pixel[k] - rx[k] - (velocity[k] * late if self.kind == MOVING else 0.0) for k in range(3)]
                back = np.sqrt(home[0] ** 2 + home[1] ** 2 + home[2] ** 2)
        index = ((out + back) / speed - some["t0"][:, None]) * self.fs
        if not self.beamed:
            return index, np.ones(index.shape)
        before = away[0] * boresight[0] + away[1] * boresight[1] + away[2] * boresight[2]
        if self.beam["shape"] == CONE:
            angle = np.arctan2(np.sqrt(np.maximum(out**2 - before**2, 0)), before)
        else:
            aside = np.abs(away[0] * axis[0] + away[1] * axis[1] + away[2] * axis[2])
            angle = np.arctan2(aside, np.sqrt(np.maximum(out**2 - aside**2, 0)))
            angle[before < -beams.EDGE_ANGLE * out] = np.inf
        half, full = float(self.beam["half_angle"]), float(self.beam["full_angle"])
        share: FloatArray = np.where(angle <= half, 1.0, 0.0)
        if full < half:
            share *= np.cos(np.pi / 2 * np.clip((angle - full) / (half - full), 0, 1)) ** 2
        return index, share

    @property
    def beamed(self) -> bool:
        """Whether beams leave out or weaken any term."""
        return bool(self.beam["shape"] != NO_BEAM)

    def even_line(self) -> bool:
        """Whether transmitters stand on an even line along x, to a hundredth of a wavelength: what Fourier algorithms take."""
        tx: FloatArray = self.trace["tx"][:: self.channels]
        n = np.arange(len(tx)) - (len(tx) - 1) / 2
        step = float(n @ tx[:, 0]) / max(float(n @ n), 1.0)
        off = np.linalg.norm(tx - tx.mean(axis=0) - n[:, None] * [step, 0.0, 0.0], axis=1)
        late = float(np.ptp(self.trace["t0"])) * self.fc
        straight = step != 0 and off.max() <= 0.01 * self.c / self.fc
        return bool(straight and self.one_speed and late <= 0.01 and self.fs < 2 * self.fc)

    def why_silent(self) -> str:
        """Why no pixel hears any ping."""
        some = self.valid[:, 0] <= self.valid[:, 1]
        if not some.any():
            return "nothing was recorded: valid holds no sample of any trace: image is zero"
        begin, end = self.valid[some].T
        low = float(np.min(self.trace["c"][some] / 2 * (self.trace["t0"][some] + begin / self.fs)))
        high = float(np.max(self.trace["c"][some] / 2 * (self.trace["t0"][some] + end / self.fs)))
        return (
            f"the grid lies outside the recorded window: image is zero; grid at slant ranges {self.nearest:.4g} to "
            f"{self.farthest:.4g} m, record {low:.4g} to {high:.4g} m"
        )

    def why_empty(self, finite: npt.NDArray[np.bool_] | None = None) -> str:
        """Why no term can be summed, of any pixel, or of traces that are `finite`; nothing where some can."""
        zero = self.weights == 0
        if self.pixels == 0:
            return "the mask leaves out every pixel: image is zero"
        if not self.heard.any():
            return self.why_silent()
        if zero.all():
            return "the weights are all 0: image is zero"
        bad = np.zeros_like(zero) if finite is None else ~finite
        if bad.all():
            return "every trace holds non-finite samples: image is zero"
        if np.any(self.heard & ~zero & ~bad):
            return ""
        counts = [(~self.heard, "outside the recorded window"), (zero, "of weight 0"), (bad, "with non-finite samples")]
        found = ", ".join(f"{np.count_nonzero(c)} {text}" for c, text in counts if c.any())
        return f"no trace is left of {self.traces}: {found}: image is zero"

    def why_dark(self, finite: npt.NDArray[np.bool_] | None = None) -> str:
        """Why no pixel has a term although traces are left, of all or of those that are `finite`.

        Looked at in all pairs of them, or in PAIRS of pixels and traces all over where there are more.
        """
        left, pixels = self._pairs(finite)
        heard = lit = False
        for trace in left[:, None]:
            index, share = self._look(trace, pixels, np.arange(len(pixels))[None])
            heard, lit = heard or bool(np.any(self._within(trace, index))), lit or bool(np.any(share > 0))
        within = "the recorded window"
        if heard and lit:
            within = "the beam and at once within the recorded window"
        elif not lit:
            within = "the beam" if heard else "the beam or the recorded window"
        return f"no pixel lies within {within} of any trace left: image is zero"

    def dark(self, finite: npt.NDArray[np.bool_]) -> bool:
        """Whether no pixel that is wanted has a term, of traces that are `finite`, looked at as `why_dark` does.

        For images that are zero although terms were counted: kernels count whole lines, masked pixels among them.
        """
        left, pixels = self._pairs(finite)
        for trace in left[:, None]:
            index, share = self._look(trace, pixels, np.arange(len(pixels))[None])
            if np.any(self._within(trace, index) & (share > 0)):
                return False
        return True

    def _pairs(self, finite: npt.NDArray[np.bool_] | None) -> tuple[npt.NDArray[np.int64], FloatArray]:
        """Traces that are left, of all or of those that are `finite`, and pixels: all of them, or PAIRS of them all over."""
        left = np.flatnonzero(self.heard & (self.weights != 0) & (True if finite is None else finite))
        pixels = self.drawn
        if self.pixels * left.size <= PAIRS:
            pixels = self._draw(self.pixels, 1)
        return left[_spread(min(left.size, max(1, PAIRS // len(pixels))), left.size, 1)], pixels


def _lights(trace: Records, fan: bool, angle: float, low: FloatArray, high: FloatArray) -> bool:
    """Whether a box lies within `angle` in every beam: its corners do.

    Cones up to a right angle are convex. So is what a fan holds on one side: across its axis a place is at least as far away
    as along one direction, here the box's centre's, and |aside| <= tan(angle) of that is a wedge.
    """
    boresight, axis = trace["boresight"], trace["axis"]
    if not fan and angle >= np.pi:
        return True
    sine, cosine = np.sin(angle) * (1 - 1e-9), np.cos(angle) + 1e-9
    middle = (low + high) / 2 - trace["tx"]
    out = middle - np.sum(middle * axis, axis=1, keepdims=True) * axis
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
    for corner in np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T:
        away = corner - trace["tx"]
        before = np.sum(away * boresight, axis=1)
        if fan:
            aside = np.abs(np.sum(away * axis, axis=1))
            held = (before > 0) & (aside * max(cosine, 0.0) <= np.sum(away * out, axis=1) * sine)
        else:
            held = before >= max(cosine, 1e-9) * np.linalg.norm(away, axis=1)
        if not held.all():
            return False
    return True


def _weights(weights: npt.ArrayLike | str | None, pings: int, channels: int) -> ComplexArray:
    if isinstance(weights, str) and weights != UNIFORM:
        raise ValueError(f"weights={weights!r}: expected an array or {UNIFORM!r}")
    given = None if isinstance(weights, str) else weights
    array = np.ones(pings) if given is None else _checks.array_like("weights", given)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"weights: expected numbers, found dtype {array.dtype}")
    if array.shape not in ((pings,), (pings, channels)):
        raise ValueError(f"weights: expected shape ({pings},) or ({pings}, {channels}), found {array.shape}")
    full = np.array(array, dtype=np.complex128).reshape(pings, -1)
    if not np.all(np.isfinite(full)):
        ping, channel = np.argwhere(~np.isfinite(full))[0]
        raise ValueError(f"weights: non-finite at ping {ping}{f', channel {channel}' if array.ndim > 1 else ''}")
    return np.broadcast_to(full, (pings, channels)).reshape(-1)


def _spread(number: int, count: int, seed: int) -> npt.NDArray[np.int64]:
    """At most `number` of `count` things, one somewhere in each of equal parts, ascending."""
    places = (np.arange(number) + np.random.default_rng(seed).random(number)) * (count / number)
    whole = places.astype(np.int64)
    return whole[np.diff(whole, prepend=-1) > 0][:count]


def lines(grid: Grid) -> tuple[FloatArray, FloatArray, float] | None:
    """First pixel and step (line, 3) of the grid's last axis, if that is evenly spaced lines, and how far (m) off; else None.

    Even means to 1e-9 of the line's length plus the rounding of large coordinates; the deviation adds to the phase error.
    Deviations are those of the float64 coordinates that the grid returns, each rounded by itself.
    """
    if isinstance(grid, Lines):
        return grid.first, grid.step, 0.0
    if grid.kind == "points":
        return _lines_of(grid.coords) if grid.coords is not None and grid.coords.ndim > 2 else None
    name = {"plane": "x", "volume": "x", "polar": "r"}.get(grid.kind)
    if name is None:
        return None
    axis = grid.axes[name]
    span = axis[-1] - axis[0]
    # from the first place on: places of large coordinates would round once more
    wrong = float(np.max(np.abs(axis - axis[0] - span * np.linspace(0, 1, axis.size))))
    if wrong > 1e-9 * abs(span) + 4e-16 * np.max(np.abs(axis)):
        return None
    number = int(np.prod(grid.shape[:-1]))
    first = grid.coordinates(np.arange(number) * axis.size)
    last = grid.coordinates(np.arange(number) * axis.size + axis.size - 1)
    if (grid.kind == "polar" or grid.turned) and axis.size > 2:
        # r cos(angle) and its sum with the centre round for every pixel; so do the ends that its line goes by, and turned axes
        largest = np.max(np.abs(np.concatenate([first[:, :2], last[:, :2]])), axis=0)
        wrong += float(np.linalg.norm(np.spacing(largest))) + 4 * float(np.spacing(np.max(np.abs(axis))))
    return first, (last - first) / max(axis.size - 1, 1), wrong


def _lines_of(points: FloatArray) -> tuple[FloatArray, FloatArray, float] | None:
    """The same of points (..., pixel, 3) that happen to lie on such lines, row by row: no copy of the grid."""
    rows = points.reshape(-1, points.shape[-2], 3)
    number = rows.shape[1]
    share = np.linspace(0, 1, number)[:, None] if number > 1 else np.zeros((1, 1))
    first, along = rows[:, 0], rows[:, -1] - rows[:, 0]
    large = 1e-15 * float(np.max(np.abs(points)))
    worst = 0.0
    for row, begin, span in zip(rows, first, along, strict=True):
        wrong = float(np.max(np.linalg.norm(row - begin - share * span, axis=1)))
        if wrong > 1e-9 * float(np.linalg.norm(span)) + large:
            return None
        worst = max(worst, wrong)
    return first.copy(), along / max(number - 1, 1), worst


def _box(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Corners of a box that holds the grid."""
    if grid.turned:
        x, y = ([np.min(grid.axes[name]), np.max(grid.axes[name])] for name in "xy")
        corners = Grid.plane(x, y, origin=grid.origin, rotation=grid.rotation).coordinates()
        corners[:, 2] = [np.min(grid.height), np.max(grid.height)] * 2
        wide = 4 * np.spacing(np.abs(corners).max())  # pixels are rounded each by itself
        return corners.min(axis=0) - wide, corners.max(axis=0) + wide
    if grid.kind in ("plane", "volume", "surface"):
        spans = [(np.min(a), np.max(a)) for a in grid.axes.values()]
        if grid.kind != "volume":
            spans.append((np.min(grid.height), np.max(grid.height)))
        corners = np.array(spans, dtype=np.float64).T
        return corners[0], corners[1]
    if isinstance(grid, Lines):
        points = grid.ends
    else:
        points = grid.coords.reshape(-1, 3) if grid.coords is not None else grid.coordinates()
    # column by column: NumPy takes twenty times as long for all three at a time
    columns = [points[:, k] for k in range(3)]
    return np.array([np.min(x) for x in columns]), np.array([np.max(x) for x in columns])


def distances(points: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest distance of each point from a box."""
    least = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    far = np.where(np.abs(points - low) > np.abs(points - high), low, high)
    return least, np.linalg.norm(points - far, axis=1)


def _slope(
    found: tuple[FloatArray, FloatArray, float], origin: FloatArray, sensors: tuple[FloatArray, ...], count: int
) -> float:
    """Largest share of a step along a line that changes the one-way range, over traces and the lines' ends (plus 10 %)."""
    if count == 1:
        return 0.0
    first, step, _ = found
    places = np.array([0, (count - 1) / 2, count - 1])[:, None]
    worst = 0.0
    for i in np.unique(np.linspace(0, len(first) - 1, min(len(first), 9)).astype(int)):
        along = step[i] / max(float(np.linalg.norm(step[i])), 1e-300)
        pixel = first[i] + places * step[i] - origin
        for sensor in sensors:
            away = [pixel[:, k, None] - sensor[:, k] for k in range(3)]  # (place, trace)
            distance = np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
            ahead = away[0] * along[0] + away[1] * along[1] + away[2] * along[2]
            worst = max(worst, float(np.max(np.abs(ahead) / np.maximum(distance, 1e-9))))
    return min(1.0, 1.1 * worst)
