"""From lines to the plan of a survey: which strips, how they are cut, what they cost."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pysas import _checks
from pysas.engine import engine_of
from pysas.formats import depth_maps, files
from pysas.formats.echo_store import EchoStore, open_echoes
from pysas.imaging.planner import METHODS, plan_ahead
from pysas.imaging.words import spoken
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.planning import framing
from pysas.signal import compression
from pysas.survey.sections import QUEUE
from pysas.survey.strips import Strip
from pysas.survey.tiling import Settings, StripPlan, begun, digest_of, extended

TILE, SECTION = 20.0, 400.0  # m along the line: of a tile, and of tiles that are made together
_MOST_TILE = 2**28  # bytes of a tile's pixels
_BACK = 1.0  # m that a line may go back before it counts as turning
_TURN = np.radians(45)  # of its mean direction that a line may head
_LEGS = 64
_SONAR = ("fs", "fc", "occupied_bandwidth", "n_channel", "compressed")  # what lines of one survey share
_PROCESS = 300e6  # bytes of a process that images nothing


@dataclass(frozen=True)
class Tile:
    """A tile of a plan.

    Attributes
    ----------
    strip : str
    number : int
    grid : Grid
        Its pixels in the line's coordinates, m.
    pings : slice
        Those that light it; none where start = stop.
    seconds : float
        Predicted, by constants of the planner, on the plan's threads.
    """

    strip: str
    number: int
    grid: Grid
    pings: slice
    seconds: float


@dataclass(frozen=True, eq=False)
class SurveyPlan:
    """What a survey will do: `print` it.

    Attributes
    ----------
    strips : tuple of StripPlan
    seconds : (strip,)
        Predicted, on `threads`, reading and writing apart.
    memory : int
        Bytes that one process needs, predicted.
    threads : int
    notes : tuple of str
        What a person should know: pixels too coarse for the image.
    """

    strips: tuple[StripPlan, ...]
    seconds: tuple[float, ...]
    memory: int
    threads: int
    notes: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        """What the pixels take in a store."""
        return sum(12 * strip.tiles * strip.columns * strip.y.size for strip in self.strips)

    @property
    def tiles(self) -> list[Tile]:
        """All tiles, strip by strip."""
        found = []
        for strip, seconds in zip(self.strips, self.seconds, strict=True):
            weight = [0.0] * strip.tiles
            spans = [[0, 0] for _ in weight]
            for block in strip.blocks:
                if block.low >= block.high:
                    continue
                for tile in range(block.low // strip.columns, (block.high - 1) // strip.columns + 1):
                    begin = tile * strip.columns
                    shared = min(block.high, begin + strip.columns) - max(block.low, begin)
                    weight[tile] += shared * (block.last - block.first)
                    spans[tile] = [spans[tile][0] if spans[tile][1] else block.first, block.last]
            whole = sum(weight) or 1.0
            found += [
                Tile(strip.name, number, strip.grid(number), slice(*spans[number]), seconds * weight[number] / whole)
                for number in range(strip.tiles)
            ]
        return found

    def __str__(self) -> str:
        count = len({strip.line for strip in self.strips})
        lines = [
            f"survey of {count} line{'s' * (count > 1)}: {sum(strip.tiles for strip in self.strips)} tiles, "
            f"{sum(s.tiles * s.columns * s.y.size for s in self.strips):.3g} pixels; predicted {spoken(sum(self.seconds))} on "
            f"{self.threads} threads, {self.memory / 1e6:.0f} MB a process, a store of {self.bytes / 1e9:.2g} GB"
        ]
        for strip, seconds in zip(self.strips, self.seconds, strict=True):
            near, far = sorted((abs(float(strip.y[0]) - strip.track), abs(float(strip.y[-1]) - strip.track)))
            height = f"z = {strip.z:g} m" if strip.depth_map is None else f"z of {strip.depth_map[0]}"
            lines.append(
                f"  {strip.name}: {strip.line}, {near:.4g} to {far:.4g} m to {strip.side}, {height}: {strip.tiles} tiles of "
                f"{strip.columns} x {strip.y.size} pixels every {strip.step:g} m, {spoken(seconds)}"
            )
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])


@_checks.usual_errors
def plan(
    lines: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    pixel: float | tuple[float, float] | None = None,
    swath: tuple[float, float] | None = None,
    side: str | None = None,
    z: float | None = None,
    altitude: float | None = None,
    depth_map: str | os.PathLike[str] | None = None,
    tol: float = 1e-2,
    method: str = "auto",
    backend: str = "auto",
    nan: str = "raise",
    window: Any = None,
    tile: float = TILE,
    section: float = SECTION,
    threads: int | None = None,
) -> SurveyPlan:
    """Cut a survey into tiles, and predict what they cost, before anything runs.

    Parameters
    ----------
    lines : path or sequence of path
        Files of echoes (.zarr, .npz, .h5), raw or compressed, with beams: one straight line each, all of one sonar.
    pixel : float or (along, across), optional
        Spacing of pixels, m. Default: 0.8 of the image's Nyquist spacing.
    swath : (near, far), optional
        Distances from the mean track, seen from above, m. Default: what the records cover.
    side : {"port", "starboard", "both"}, optional
        Default: where the beam looks.
    z, altitude : float, optional
        Height of the seabed in the lines' coordinates, or how far it lies below the sonar, m: one of them or `depth_map`, or
        else as of `pysas image`.
    depth_map : path, optional
        Heights of the seabed, as `pysas image` takes them.
    tol, method, backend, nan
        As in `pysas.plan`.
    window : str or tuple, optional
        Spectral window of the compression of raw echoes, as in `pysas.compress`.
    tile, section : float
        m along the line of a tile (at least a pixel), and of tiles that are made by one task, one after another. Longer
        sections save what is prepared twice at their ends; shorter ones give more workers something to do.
    threads : int, optional
        What the prediction is for.

    Returns
    -------
    SurveyPlan

    Raises
    ------
    ValueError, TypeError
        Argument out of range; lines of different sonars or frames, without beams, closed or turning back on themselves; a
        tol that cannot be met; a depth map that does not hold all of a strip. Each names the line.
    OSError, ImportError
        From the file system; a format whose library is not installed.

    Warns
    -----
    UserWarning
        A line that is not complete; a height of the seabed that nothing tells, where it matters; pings that light tiles which
        are complete by then.

    Notes
    -----
    O(navigation): 0.1 ms a ping. No sample is read.
    """
    paths = [lines] if isinstance(lines, str | os.PathLike) else list(lines)
    if not paths:
        raise ValueError("lines: none: expected files of echoes")
    cut = Cut.of(
        pixel=pixel, swath=swath, side=side, z=z, altitude=altitude, depth_map=depth_map, tol=tol, method=method,
        backend=backend, nan=nan, window=window, tile=tile, section=section,
    )  # fmt: skip
    count = _checks.threads(threads)
    strips: list[StripPlan] = []
    notes: list[str] = []
    seconds, memory, first = [], 0.0, None
    for number, path in enumerate(paths):
        with open_echoes(path) as store:
            if first is not None:
                _require_same_sonar(first, store)
                _require_one_map(depth_map, first, store)
            first = first or store
            if paths.index(path) < number:
                _checks.warn(f"{store.path}: given twice")
            if not store.complete:
                _checks.warn(
                    f"{store.path}: not complete: its recorder adds pings, or was ended; the {store.n_ping} there count"
                )
            for strip in cut.strips(number, store.path, store.navigation):
                with files.naming(store.path):
                    whole = extended(begun(strip, store.navigation), store.navigation, complete=True)
                    whole.require_heights()
                cost = _cost(whole, store.navigation, count)
                notes += _coarse(whole, store.navigation)
                strips.append(whole)
                seconds.append(cost[0])
                memory = max(memory, cost[1])
    return SurveyPlan(tuple(strips), tuple(seconds), round(memory), count, tuple(notes))


@dataclass(frozen=True)
class Cut:
    """How every line is cut: arguments of `plan`."""

    pixel: tuple[float, float] | None
    swath: tuple[float, float] | None
    side: str | None
    z: float | None
    altitude: float | None
    depth_map: str | os.PathLike[str] | None
    tile: float
    section: float
    settings: Settings

    @classmethod
    def of(
        cls, *, pixel: float | tuple[float, float] | None = None, swath: tuple[float, float] | None = None,
        side: str | None = None, z: float | None = None, altitude: float | None = None,
        depth_map: str | os.PathLike[str] | None = None, tol: float = 1e-2, method: str = "auto", backend: str = "auto",
        nan: str = "raise", window: Any = None, tile: float = TILE, section: float = SECTION,
    ) -> Cut:  # fmt: skip
        """Once they are what `plan` takes."""
        _checks.choice("method", method, METHODS)
        _checks.choice("nan", nan, ("raise", "mask"))
        if side is not None:
            _checks.choice("side", side, framing.SIDES)
        if sum(value is not None for value in (z, altitude, depth_map)) > 1:
            raise ValueError("z, altitude, depth_map: expected one of them")
        settings = Settings(_checks.number("tol", tol, positive=True), method, backend, nan, window)
        tile, section = _checks.number("tile", tile, positive=True), _checks.number("section", section, positive=True)
        return cls(_pair(pixel), _swath(swath), side, z, altitude, depth_map, tile, section, settings)

    def strips(self, number: int, path: str, echoes: Echoes) -> list[StripPlan]:
        """Strips of a line, without blocks, by its navigation."""
        with files.naming(path):
            return self._strips(number, path, echoes)

    def _require_window(self, echoes: Echoes) -> None:
        """Raise now what compression of raw echoes would raise in every section."""
        window = self.settings.window
        if not echoes.compressed:
            compression.compress(echoes[:1], window, threads=1)  # of zeros
        elif window is not None:
            raise ValueError(f"window={window!r}: its echoes are compressed: expected raw ones")

    def _strips(self, number: int, line: str, echoes: Echoes) -> list[StripPlan]:
        if echoes.beam is None:
            raise ValueError("no beam: expected echoes with one, without it every ping lights the whole line")
        self._require_window(echoes)
        track = _straight(echoes)
        depth_map, z = None, self.z
        if self.depth_map is not None:
            path = os.path.abspath(files.name(self.depth_map))
            heights = depth_maps.load(path)
            depth_map, z = (path, digest_of(*heights)), None
            level = float(np.median(heights[2]))
        elif z is None:
            z, why = framing.assumed_height(echoes, self.altitude)
            if self.altitude is None and "altitude" not in echoes.attrs:
                _checks.warn(f"{line}: {why}; places across the track are slant ranges, and a map of them is wrong")
            level = z
        else:
            level = z = _checks.number("z", z)
        sides, recorded, spacing = framing.swath_beside(echoes, track, level, self.side)
        swath, (step, across) = self.swath or recorded, self.pixel or spacing
        if swath[0] < recorded[1] < swath[1] / 1.2:
            _checks.warn(f"{line}: swath to {swath[1]:g} m: its records reach {recorded[1]:.4g} m, pixels beyond will be empty")
        middle = round(float(np.mean(track.places[:, 1])) / across) * across
        away = framing.span(*swath, across)
        columns = min(max(round(self.tile / step), 1), _MOST_TILE // (8 * away.size))
        if columns < 1:
            raise ValueError(f"swath: {away.size} pixels across: expected fewer than {_MOST_TILE // 8}")
        many = max(round(self.section / (columns * step)), 1)
        frame = echoes.attrs.get("frame")
        found = []
        for name, sign in sides:
            y = np.sort(middle + sign * away)
            begin = StripPlan(
                f"{number:03d}-{name}", os.path.abspath(line), name, (float(track.origin[0]), float(track.origin[1])),
                track.rotation, 0.0, y, step, columns, many, middle, z, depth_map,
                dict(frame) if isinstance(frame, Mapping) else None, self.settings,
            )  # fmt: skip
            found.append(begin)
        return found


def _pair(pixel: float | tuple[float, float] | None) -> tuple[float, float] | None:
    if pixel is None:
        return None
    both = pixel if isinstance(pixel, tuple | list) else (pixel, pixel)
    if len(both) != 2:
        raise ValueError(f"pixel={pixel!r}: expected one spacing or two, along and across")
    return _checks.number("pixel", both[0], positive=True), _checks.number("pixel", both[1], positive=True)


def _swath(swath: tuple[float, float] | None) -> tuple[float, float] | None:
    if swath is None:
        return None
    if not isinstance(swath, tuple | list) or len(swath) != 2:
        raise TypeError(f"swath={swath!r}: expected two distances from the track, near and far")
    near, far = (_checks.number("swath", value, low=0.0) for value in swath)
    if not near < far:
        raise ValueError(f"swath={swath!r}: expected near < far")
    return near, far


def _straight(echoes: Echoes) -> framing.Course:
    """The track of a line, on axes along which it advances. Raises ValueError where it is none."""
    track = framing.course_of(echoes)
    if track.closed:
        raise ValueError("the track goes round what it looks at: expected a line; pysas image takes circles")
    if track.sailed < 0:
        track = replace(track, rotation=float(np.pi), places=-track.places, sailed=1.0)
    x = track.places[:, 0]
    if not np.ptp(x) > 0:
        raise ValueError("the line does not advance: expected pings at two places or more, which tell its direction")
    back = np.maximum.accumulate(x) - x
    if back.max() > _BACK:
        ping = int(np.argmax(back > _BACK))
        raise ValueError(
            f"the line turns back on itself: at ping {ping} it is {back[ping]:.3g} m behind where it was: expected lines that "
            "advance; pysas convert --pings cuts them"
        )
    advance = np.linalg.norm(np.diff(track.places, axis=0), axis=1)
    step = max(float(np.median(advance)), 1e-3) if advance.size else 1.0
    every = max(int(np.ceil(2 * _BACK / step)), len(x) // _LEGS)  # legs that sway does not turn
    steps = np.diff(track.places[::every], axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > _BACK]
    headings = np.abs(np.arctan2(steps[:, 1], steps[:, 0]))
    if headings.size and headings.max() > _TURN:
        raise ValueError(
            f"the line heads {np.degrees(headings.max()):.0f} degrees off its mean direction: expected lines that are straight "
            f"to {np.degrees(_TURN):.0f}; pysas convert --pings cuts them"
        )
    return track


def _require_one_map(depth_map: Any, first: EchoStore, other: EchoStore) -> None:
    """A depth map is in the coordinates of the lines, which have to be the same."""
    one, two = (store.navigation.attrs.get("frame") for store in (first, other))
    if depth_map is not None and one != two:
        raise ValueError(
            f"depth_map: is in the coordinates of {first.path}, and those of {other.path} are others by attrs['frame']: "
            "expected lines in one frame, or a survey for each"
        )


def _coarse(plan: StripPlan, echoes: Echoes) -> list[str]:
    """What pixels that are farther apart than the image's Nyquist spacing lose, in words."""
    c, beam = echoes.mean_speed, echoes.beam
    if beam is None:
        raise _checks.InternalError("no beam")
    sine = min(c / echoes.fc / beam.length, float(np.sin(min(beam.half_angle, np.pi / 2))))  # its first null, or its end
    finest = c / (2 * (echoes.fc + echoes.occupied_bandwidth / 2))
    needed = finest / (2 * sine), 1 / (2 * echoes.occupied_bandwidth / c + (1 - np.sqrt(1 - sine**2)) / finest)
    across = float(np.diff(plan.y).min()) if plan.y.size > 1 else 0.0
    if plan.step <= 1.5 * needed[0] and across <= 1.5 * needed[1]:
        return []
    return [
        f"{plan.name}: the image's Nyquist spacing is {needed[0]:.2g} x {needed[1]:.2g} m: of points between pixels of "
        f"{plan.step:g} x {across:g} m little may be left; a mosaic averages, and takes any coarser pixel"
    ]


def _require_same_sonar(first: EchoStore, other: EchoStore) -> None:
    for name in _SONAR:
        was, now = (getattr(store.navigation, name) for store in (first, other))
        if was != now:
            raise ValueError(
                f"{other.path}: {name}={now!r}, {first.path} has {was!r}: expected lines of one sonar; survey others apart"
            )
    was, now = (_frame(store) for store in (first, other))
    if was != now:
        raise ValueError(
            f"{other.path}: its coordinates are {now}, those of {first.path} {was}: expected attrs['frame'] of one kind, as "
            "pysas echoes writes it"
        )


def _frame(store: EchoStore) -> str:
    """What ties a line's coordinates to those of others."""
    frame = store.navigation.attrs.get("frame")
    if not isinstance(frame, Mapping):
        return "local metres"
    return "tied to no latitude and longitude" if frame.get("lat") is None else "tied to a latitude and longitude"


def _cost(plan: StripPlan, navigation: Echoes, threads: int) -> tuple[float, float]:
    """Predicted seconds of a strip and bytes of a process, from its dearest block."""
    weights = [(block.last - block.first) * (block.high - block.low) for block in plan.blocks]
    if not any(weights):
        raise ValueError(f"{plan.line}: no ping lights the strip from {plan.y[0]:g} to {plan.y[-1]:g} m: another swath or side")
    dear = plan.blocks[int(np.argmax(weights))]
    some = navigation[dear.first : dear.last]
    strip: Strip = plan.strip(threads)
    grid = strip.grid(dear.low, dear.high - dear.low)
    s = plan.settings
    engine_of(s.backend)  # says that Numba runs, where it does, before warnings are silent
    with files.naming(plan.line), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is silent is an error here
        made = plan_ahead(plan.laid(some), grid, s.tol, s.method, threads, s.backend, s.nan)
    if made.silent:
        raise ValueError(f"{plan.line}: nothing to {plan.side}: {made.silent}")
    tile = plan.y.size * plan.columns * navigation.dtype.itemsize
    pending = ((dear.high - dear.low) // plan.columns + 3 + QUEUE) * tile  # those to come, and those to be written
    if plan.depth_map is not None:  # heights in float64: of a block, of tiles that it crosses, of one while it is read off
        columns = (dear.high - dear.low) * 9 // 8 + plan.columns * ((dear.high - dear.low) // plan.columns + 2 + 4)
        pending += 8 * plan.y.size * columns
    pings = some.data.size * some.dtype.itemsize * (2 if some.compressed else 4)  # the next block is read meanwhile
    return made.predicted_seconds * sum(weights) / max(weights), made.predicted_memory + pending + pings + _PROCESS
