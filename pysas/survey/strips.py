"""Strip: images of a long track one after another, from pings as they come.

Pings are taken in blocks. A block's image covers what its beams light, and is added to the images that it crosses; an image is
given away once no ping to come lights it. So each ping's sub-images are made once, and what is kept is as long as the beam's
footprint, not as the track.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.planner import plan
from pysas.imaging.plans import EnginePlan
from pysas.model.beam import FAN
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.survey.pings import joined

ROWS = 64  # of the grid, at which reaches along the track are looked at


class Strip:
    """Images of `length` m along x, side by side, of a track along x.

    Parameters
    ----------
    y : (row,) array_like
        Across-track coordinates of the pixels, m.
    step, length : float
        Of pixels and of images along x, m; `length` a multiple of `step`.
    origin : float
        x of a first column of images: they begin at origin + number length.
    z : float or callable
        Height of the ground, m, or a function of the vectors x and y that returns heights (row, column); it is asked once
        for each image.
    tol, method, threads, backend, nan
        As in `pysas.plan`. Errors of blocks add as squares, as R^2 of an image does, so that each image keeps `tol`.
    block : float, optional
        m of track whose pings are summed at a time; default `length`.
    slack : float
        m along x by which a ping to come may light what none before it of the newest block would: yaw, surge.

    Raises
    ------
    ValueError, TypeError
        Arguments of the wrong type, shape or range.

    Notes
    -----
    Memory: images as long as a footprint and an image, with their heights, a block's image of a footprint and a block, the
    block's pings.
    """

    @_checks.usual_errors
    def __init__(
        self, y: npt.ArrayLike, step: float, length: float, *, origin: float = 0.0,
        z: float | Callable[[FloatArray, FloatArray], npt.ArrayLike] = 0.0, tol: float = 1e-3, method: str = "auto",
        threads: int | None = None, backend: str = "auto", nan: str = "raise", block: float | None = None, slack: float = 1.0,
    ) -> None:  # fmt: skip
        self.y = _checks.reals("y", y, [("row",)], ("row",))
        self.step = _checks.number("step", step, positive=True)
        self.length = _checks.number("length", length, positive=True)
        self.columns = round(self.length / self.step)
        if not self.columns or abs(self.columns * self.step - self.length) > 1e-6 * self.length:
            raise ValueError(f"length={length!r}: expected a multiple of step={step!r}")
        self.origin = _checks.number("origin", origin)
        self.z = z if callable(z) else _checks.number("z", z)
        self.block = self.length if block is None else _checks.number("block", block, positive=True)
        self.slack = _checks.number("slack", slack)
        if self.slack < 0:
            raise ValueError(f"slack={slack!r}: expected at least 0 m")
        self.options: dict[str, Any] = {"tol": tol, "method": method, "threads": threads, "backend": backend, "nan": nan}

    def grid(self, first: int, count: int) -> Grid:
        """Pixels of `count` columns from number `first` on."""
        x = self._x(first, count)
        return Grid.surface(x, self.y, self.z(x, self.y)) if callable(self.z) else Grid.plane(x, self.y, self.z)

    def _x(self, first: int, count: int) -> FloatArray:
        return np.asarray(self.origin + self.step * np.arange(first, first + count), dtype=np.float64)

    def stream(self, pings: Iterable[Echoes]) -> Iterator[Image]:
        """Images, in the order of the track, as soon as no ping to come lights them.

        Parameters
        ----------
        pings : iterable of Echoes
            In the order of the track, one or many pings each, all with beams, of one array and sampling. Their navigation is
            what plans are made from: gaps, changing speed, sway and yaw are the normal case.

        Yields
        ------
        Image
            What no ping lights is not given; a note of the next image tells of such a gap.

        Raises
        ------
        ValueError, TypeError
            Echoes without a beam or of different sampling, and what `pysas.plan` raises.

        Warns
        -----
        UserWarning
            A ping lights an image that was given away already: its part there is left out. A larger `slack` waits longer.

        Notes
        -----
        A block's time is that of `pysas.focus` on what it lights, planning included.
        """
        state = _Stream(self)
        for block in _blocks(pings, self.block):
            state.add(block)
            yield from state.complete()
        yield from state.rest()


class Blocks:
    """Images of a strip's blocks of pings, one after another in the same memory."""

    def __init__(self, strip: Strip) -> None:
        self.strip = strip
        self.ground: dict[int, FloatArray] = {}  # heights, by numbers of images
        self.heights: FloatArray = np.empty(0)  # of a block
        self.before: EnginePlan | None = None
        self.room: ComplexArray = np.empty(0, dtype=np.complex64)

    def image(self, echoes: Echoes, low: int, high: int) -> Image:
        """Columns low to high - 1 of what these pings tell; its data last until the next."""
        grid = self._grid(low, high)
        made = plan(echoes, grid, **self.strip.options)
        if self.before is not None:
            made.by.follow(self.before)
        self.before = made.by
        return made(echoes.data, self._room(grid, echoes))

    def grid(self, number: int) -> Grid:
        """Pixels of an image of the strip."""
        strip = self.strip
        if callable(strip.z):
            return Grid._of_heights(strip._x(number * strip.columns, strip.columns), strip.y, self._ground(number))
        return strip.grid(number * strip.columns, strip.columns)

    def forget(self, number: int) -> None:
        """Heights of an image that no block to come crosses."""
        self.ground.pop(number, None)

    def _grid(self, low: int, high: int) -> Grid:
        """Pixels of columns low to high - 1; heights are asked for once for each image that these cross."""
        strip = self.strip
        if not callable(strip.z):
            return strip.grid(low, high - low)
        columns, size = strip.columns, strip.y.size * (high - low)
        if self.heights.size < size:
            self.heights = np.empty(size + size // 8)
        heights = self.heights[:size].reshape(strip.y.size, high - low)
        for number in crossed(low, high, columns):
            begin = number * columns
            first, last = max(low, begin), min(high, begin + columns)
            heights[:, first - low : last - low] = self._ground(number)[:, first - begin : last - begin]
        return Grid._of_heights(strip._x(low, high - low), strip.y, heights)

    def _ground(self, number: int) -> FloatArray:
        """Heights of an image to come."""
        if number not in self.ground:
            strip = self.strip
            found = cast("Callable[..., npt.ArrayLike]", strip.z)(strip._x(number * strip.columns, strip.columns), strip.y)
            self.ground[number] = _checks.reals("z", found, [(strip.y.size, strip.columns)], ("row", "column"))
        return self.ground[number]

    def _room(self, grid: Grid, echoes: Echoes) -> ComplexArray:
        """Where a block's image goes: the first touch of memory takes as long as some sums."""
        if self.room.size < grid.size or self.room.dtype != echoes.dtype:
            self.room = np.empty(grid.size + grid.size // 8, dtype=echoes.dtype)
        return self.room[: grid.size].reshape(grid.shape)


class Pending:
    """An image to come, and what was done for it."""

    def __init__(self, strip: Strip, dtype: np.dtype[Any]) -> None:
        self.strip = strip
        self.data: ComplexArray = np.zeros((strip.y.size, strip.columns), dtype=dtype)
        self.reports: list[Report] = []

    def add(self, number: int, image: Image, low: int) -> None:
        """What a block's image, whose first column is `low`, has of image `number`."""
        begin, high = number * self.strip.columns, low + image.data.shape[1]
        first, last = max(low, begin), min(high, begin + self.strip.columns)
        self.data[:, first - begin : last - begin] += image.data[:, first - low : last - low]
        self.reports.append(_share(image.report, (last - first) / (high - low)))

    def report(self) -> Report:
        """Of all blocks together."""
        last = self.reports[-1]
        terms = sum(report.terms for report in self.reports)
        notes = dict.fromkeys(note for report in self.reports for note in report.notes)
        return Report(
            last.method, last.tol, last.backend, last.isa, last.threads,
            sum(report.prepare_seconds for report in self.reports), sum(report.sum_seconds for report in self.reports), terms,
            min(report.share_left_out for report in self.reports),
            sum(report.factorised_share * report.terms for report in self.reports) / max(terms, 1),
            max((report.predicted_error or 0.0) for report in self.reports), {}, tuple(notes),
        )  # fmt: skip


def add_block(image: Image, low: int, images: Mapping[int, Pending]) -> None:
    """Add a block's image, whose first column is `low`, to images that it crosses, by their numbers."""
    with ThreadPoolExecutor(image.report.threads, thread_name_prefix="pysas-strip") as pool:  # as long as some sums on one
        list(pool.map(lambda number: images[number].add(number, image, low), images))


def crossed(low: int, high: int, columns: int) -> range:
    """Numbers of the images that columns low to high - 1 lie in."""
    return range(low // columns, (high - 1) // columns + 1)


def columns_of(reaches: Iterable[tuple[float, float] | None], strip: Strip) -> tuple[int, int]:
    """First column that pings light, by their reaches, and the one after the last; the same one twice where they light none."""
    lit = [end for end in reaches if end is not None]
    if not lit:
        return 0, 0
    low = int(np.ceil((min(end[0] for end in lit) - strip.origin) / strip.step - 1e-9))
    high = int(np.floor((max(end[1] for end in lit) - strip.origin) / strip.step + 1e-9)) + 1
    return low, max(low, high)


class _Stream:
    """One run along a strip."""

    def __init__(self, strip: Strip) -> None:
        self.strip = strip
        self.blocks = Blocks(strip)
        self.pending: dict[int, Pending] = {}
        self.forward = 0  # 1 or -1 along x, once it is known
        self.given: int | None = None  # the image given away last
        self.reach = (-np.inf, np.inf)  # of the newest ping
        self.units = 0.0, 0.0  # fc and c of the images

    def add(self, echoes: Echoes) -> None:
        """Image what a block lights."""
        strip = self.strip
        reaches = [end for end in reaches_along(echoes, strip) if end is not None]
        moved = float(echoes.tx[-1, 0] - echoes.tx[0, 0])
        self.forward = self.forward or int(np.sign(moved))
        if not reaches:
            return
        self.reach = reaches[-1]
        low, high = self._left(*columns_of(reaches, strip))
        if low >= high:
            return
        image = self.blocks.image(echoes, low, high)
        self.units = image.fc, image.c
        numbers = crossed(low, high, strip.columns)
        for number in numbers:
            if number not in self.pending:
                self.pending[number] = Pending(strip, image.data.dtype)
        add_block(image, low, {number: self.pending[number] for number in numbers})

    def _left(self, low: int, high: int) -> tuple[int, int]:
        """Of columns low to high - 1 those of images that were not given away."""
        if self.given is None:
            return low, high
        edge = (self.given + (self.forward > 0)) * self.strip.columns
        late = edge - low if self.forward > 0 else high - edge
        if late > 0:
            where = self.strip.origin + edge * self.strip.step
            warnings.warn(
                f"pings light {late * self.strip.step:.3g} m before x = {where:.6g} m, where images were given away: left out "
                f"there; expected slack={self.strip.slack + late * self.strip.step:.3g} or more",
                stacklevel=4,
            )
        return (max(low, edge), high) if self.forward > 0 else (low, min(high, edge))

    def complete(self) -> Iterator[Image]:
        """Images that lie behind what the newest ping lights."""
        if not self.forward:
            return
        strip = self.strip
        for number in sorted(self.pending, key=lambda k: k * self.forward):
            begin = strip.origin + number * strip.length
            behind = (
                begin + strip.length < self.reach[0] - strip.slack if self.forward > 0 else begin > self.reach[1] + strip.slack
            )
            if not behind:
                return
            yield self._give(number)

    def rest(self) -> Iterator[Image]:
        for number in sorted(self.pending, key=lambda k: k * (self.forward or 1)):
            yield self._give(number)

    def _give(self, number: int) -> Image:
        strip, one = self.strip, self.pending.pop(number)
        report = one.report()
        if self.given is not None and abs(number - self.given) > 1:
            ends = sorted((self.given + (self.forward > 0), number + (self.forward < 0)))
            low, high = (strip.origin + end * strip.length for end in ends)
            report = dataclasses.replace(report, notes=(*report.notes, f"nothing lights x from {low:.6g} to {high:.6g} m"))
        self.given = number
        grid = self.blocks.grid(number)
        self.blocks.forget(number)
        return Image(one.data, grid, report, *self.units)


def _share(report: Report, share: float) -> Report:
    """What of a block's work is an image's, by their columns."""
    return dataclasses.replace(
        report, terms=round(report.terms * share), prepare_seconds=report.prepare_seconds * share,
        sum_seconds=report.sum_seconds * share,
    )  # fmt: skip


def _blocks(pings: Iterable[Echoes], length: float) -> Iterator[Echoes]:
    """Blocks of pings that advance by at most `length` m along x, or are one ping."""
    kept: list[Echoes] = []
    start = 0.0
    for echoes in pings:
        if not isinstance(echoes, Echoes):
            raise TypeError(f"pings: {type(echoes).__name__}: expected pysas.Echoes")
        if echoes.beam is None:
            raise ValueError("pings: no beam: expected echoes with one, without it every ping lights the whole strip")
        begin = 0
        for ping in range(echoes.n_ping):
            x = float(echoes.tx[ping, 0])
            if not kept and ping == begin:
                start = x
            elif abs(x - start) >= length:
                if ping > begin:
                    kept.append(echoes[begin:ping])
                yield joined(kept)
                kept, begin, start = [], ping, x
        kept.append(echoes[begin : echoes.n_ping])
    if kept:
        yield joined(kept)


def reaches_along(echoes: Echoes, strip: Strip) -> list[tuple[float, float] | None]:
    """Least and largest x that each ping lights within its record, at any row of a strip; None where it lights nothing.

    With X = x - tx the condition |X u + e| <= s sqrt(X^2 + h^2) of a fan (u, e: of its axis along x and of the rest; s: the
    sine of its half-angle), or its opposite for a cone, is quadratic in X; so is the record's end.
    """
    beam = echoes.beam
    if beam is None:
        raise _checks.InternalError("no beam")
    fan = beam.shape == FAN
    toward = np.broadcast_to(beam.axes if fan else beam.boresights, (echoes.n_ping, 3))
    limit = np.sin(beam.half_angle) if fan else np.cos(beam.half_angle)
    rows = strip.y[np.unique(np.linspace(0, strip.y.size - 1, min(ROWS, strip.y.size)).astype(int))]
    heights = _heights(strip, echoes, rows)
    ground = np.stack([np.repeat(rows, heights.shape[1]), heights.ravel()], axis=1)  # y and z
    # the farthest sample: half the way and what receivers are off
    last = echoes.speeds * (echoes.start_time + (echoes.n_sample - 1) / echoes.fs)
    longest = last / 2 + np.max(np.linalg.norm(echoes.receivers - echoes.tx[:, None], axis=-1), axis=1)
    margin = float(np.max(np.abs(np.diff(strip.y, prepend=strip.y[0])))) + strip.step  # rows between those looked at
    found: list[tuple[float, float] | None] = []
    looks = np.broadcast_to(beam.boresights, (echoes.n_ping, 3))
    for tx, to, look, reach in zip(echoes.tx, toward, looks, longest, strict=True):
        away = ground - tx[1:]
        square = np.sum(away**2, axis=1)
        farthest = np.sqrt(np.maximum(reach**2 - square, 0.0)) * (reach**2 > square)
        rest = away @ to[1:]
        a, b, c = to[0] ** 2 - limit**2, to[0] * rest, rest**2 - limit**2 * square
        low, high = -farthest, farthest.copy()
        if (fan and a > 0) or (not fan and limit > 0 and a < 0):  # else only the record ends it
            root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
            real = b**2 - a * c >= 0
            ends = np.sort(np.stack([(-b - root) / a, (-b + root) / a]), axis=0)
            low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
            low[~real], high[~real] = 1.0, -1.0
        lit = (low <= high) & (farthest > 0)
        if fan:  # which holds boresight's side alone
            lit &= np.maximum(look[0] * low, look[0] * high) + away @ look[1:] >= 0
        ends_lit = (float(tx[0] + low[lit].min() - margin), float(tx[0] + high[lit].max() + margin)) if lit.any() else None
        found.append(ends_lit)
    return found


def _heights(strip: Strip, echoes: Echoes, rows: FloatArray) -> FloatArray:
    """Heights (row, some) that the ground has at rows near a block."""
    if not callable(strip.z):
        return np.full((rows.size, 1), float(strip.z))
    middle = float(np.mean(echoes.tx[:, 0]))
    reach = echoes.swath[1] + float(np.ptp(echoes.tx[:, 0]))
    found = _checks.reals("z", strip.z(np.linspace(middle - reach, middle + reach, ROWS), rows), [(rows.size, ROWS)])
    return np.stack([found.min(axis=1), found.max(axis=1)], axis=1)
