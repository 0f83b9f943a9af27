"""Pictures of a survey: where its tiles lie, what became of each, and its strips, reduced.

matplotlib is imported by `pysas.plot`, when a picture is drawn. Tiles are collections, one a kind, not an artist each.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas import plot
from pysas._checks import FloatArray
from pysas.navigation import Frame
from pysas.survey.image_store import DAMAGED, DARK, DONE, FAILED
from pysas.survey.lines import SurveyPlan
from pysas.survey.tiling import StripPlan

MISSING = "missing"  # of a tile without a record
COLOURS = {DONE: "#8fbc8f", DARK: "#9a9a9a", FAILED: "#d62728", DAMAGED: "#ff8c00", MISSING: "#7ec8e3"}
_SIDES = {"port": "#c0392b", "starboard": "#1e8449"}  # as its lights are
_DPI = 130
_SLIMMEST = 1 / 8  # of a map, height by width or the other way, at one scale
_NAMED = 80  # lines: more names cover each other
_WIDE_EDGE = 4.0  # points that a tile is across for its outline to be drawn
_RANGE = 40.0  # dB of a quick-look
_ROW = 10.5, 0.85  # inches of a quick-look's row: wide, and beside its picture high


def overview(plan: SurveyPlan, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Draw a plan before anything runs: mean tracks with their direction, tiles by what they cost, sides of the sonar.

    Parameters
    ----------
    plan : SurveyPlan
    path : path
        Of the picture: PNG, or what its suffix says.
    overwrite : bool
        Replace a file that is there; False: it is an error.

    Raises
    ------
    ValueError, TypeError
        Another plan, a suffix that this matplotlib cannot write, frames of which some are tied to the Earth and some are not.
    ImportError
        Without matplotlib; names the extra.
    OSError
        From the file system.

    Notes
    -----
    Lines whose `attrs["frame"]` says where they lie are drawn in metres east and north, others in their own x and y. O(tiles).
    """
    if not isinstance(plan, SurveyPlan):
        raise TypeError(f"plan={type(plan).__name__}: expected what pysas.survey.plan returns")
    kind = plot.picture_format(path)
    if not overwrite and os.path.lexists(path):
        raise FileExistsError(f"{os.fspath(path)!s}: exists: expected a new name, or overwrite=True")
    chart = Chart(plan.strips)
    figure, ax = chart.figure(str(plan).splitlines()[0], 11.0)
    polygons = np.concatenate([chart.tiles(number) for number in range(len(plan.strips))])
    seconds = np.array([tile.seconds for tile in plan.tiles])
    tiles = chart.add(ax, polygons, array=seconds, cmap="viridis")
    tiles.set_clim(0.0, max(float(seconds.max()), 1e-9))
    figure.colorbar(tiles, ax=ax, label="predicted, s a tile", shrink=0.8)
    for side, colour in _SIDES.items():
        some = [chart.outline(number) for number, strip in enumerate(plan.strips) if strip.side == side]
        if some:
            chart.add(
                ax,
                np.array(some),
                facecolors="none",
                edgecolors=colour,
                linewidths=1.2 if len(plan.strips) < 20 else 0.6,
                label=side,
            )
    chart.tracks(ax)
    figure.legend(loc="outside lower center", fontsize="small", ncols=6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # letters of a file's name that the font does not have
        plot.write(figure, path, kind, dpi=_DPI, overwrite=overwrite)


def coverage(strips: Sequence[StripPlan], states: Sequence[Sequence[str]]) -> bytes:
    """PNG of what became of each tile, by strips."""
    chart = Chart(strips)
    figure, ax = chart.figure("tiles by what became of them", 8.0)
    for state, colour in COLOURS.items():
        some = [
            chart.tiles(number)[[k for k, found in enumerate(of_strip) if found == state]]
            for number, of_strip in enumerate(states)
            if state in of_strip
        ]
        if not some:
            continue
        polygons = np.concatenate(some)
        chart.add(ax, polygons, facecolors=colour, edgecolors="white", label=f"{state}: {len(polygons)}")
        if state not in (DONE, DARK):  # one tile of thousands must be seen
            ax.plot(*polygons.mean(axis=1).T, "s", ms=2, color=colour, zorder=3)
    chart.tracks(ax)
    figure.legend(loc="outside lower center", fontsize="small", ncols=6)
    return png(figure)


class Chart:
    """Strips of a survey on one map.

    Their coordinates are metres north and east of the first line's latitude and longitude, or of the local metres of its
    frame, where lines have frames; else the lines' own x and y.
    """

    def __init__(self, strips: Sequence[StripPlan]) -> None:
        self.strips = strips
        frames = [_frame(strip) for strip in strips]
        given = [frame for frame in frames if frame is not None]
        self.framed, self.mixed = bool(given), 0 < len(given) < len(frames)
        base = Frame(0.0, given[0].lat, given[0].lon) if given else Frame()
        self.base = base
        self._into = [(frame or base).into(base) for frame in frames]
        every = np.concatenate([part(number) for number in range(len(strips)) for part in (self.outline, self.track)])
        self.low, self.high = every.min(axis=0), every.max(axis=0)
        self.origin = np.where(np.abs(every).max(axis=0) < 1e5, 0.0, np.floor(self.low / 100) * 100)

    def place(self, number: int, x: FloatArray, y: FloatArray) -> FloatArray:
        """Where points on a strip's axes lie on the map: (..., right and up), m."""
        strip = self.strips[number]
        cos, sin = np.cos(strip.rotation), np.sin(strip.rotation)
        line = [strip.origin[0] + cos * x - sin * y, strip.origin[1] + sin * x + cos * y, np.full(np.shape(x), strip.z or 0.0)]
        turn, shift = self._into[number]
        found = np.stack(line, axis=-1) @ turn.T + shift
        return np.asarray(found[..., [1, 0]] if self.framed else found[..., :2])

    def tiles(self, number: int) -> FloatArray:
        """(tile, corner, 2)"""
        strip = self.strips[number]
        edges = strip.start + strip.step * (strip.columns * np.arange(strip.tiles + 1) - 0.5)
        low, high = strip.y[0], strip.y[-1]
        x = np.stack([edges[:-1], edges[1:], edges[1:], edges[:-1]], axis=1)
        return self.place(number, x, np.broadcast_to([low, low, high, high], x.shape))

    def outline(self, number: int) -> FloatArray:
        """(corner, 2)"""
        tiles = self.tiles(number)
        return np.stack([tiles[0, 0], tiles[-1, 1], tiles[-1, 2], tiles[0, 3]])

    def track(self, number: int) -> FloatArray:
        """(begin and end, 2) of the mean track beside a strip."""
        strip = self.strips[number]
        x = strip.start + strip.step * strip.columns * strip.tiles * np.array([0.0, 1.0])
        return self.place(number, x, np.full(2, strip.track))

    def figure(self, title: str, width: float) -> tuple[Any, Any]:
        """A figure, inches wide, with axes in metres."""
        wide, high = np.maximum(self.high - self.low, 1e-3)
        shape = float(np.clip(high / wide, 0.3, 1.2))
        figure = plot._figure(figsize=(width, 0.75 * width * shape + 1.6), dpi=_DPI, layout="constrained")
        ax = figure.add_subplot()
        equal = _SLIMMEST < high / wide < 1 / _SLIMMEST
        margin = 0.03 * (np.full(2, max(wide, high)) if equal else np.array([wide, high]))
        low, top = self.low - margin - self.origin, self.high + margin - self.origin
        ax.set_xlim(low[0], top[0])
        ax.set_ylim(low[1], top[1])
        notes = []
        if equal:
            ax.set_aspect("equal")
        else:
            notes.append("axes are of different scales")
        if self.mixed:
            notes.append("lines without a frame are drawn as if their x were north")
        names = ("east", "north") if self.framed else ("x", "y")
        for axis, name, start in zip((ax.xaxis, ax.yaxis), names, self.origin, strict=True):
            axis.set_label_text(f"{name}, m" + (f" from {start:.0f}" if start else ""))
        if self.base.lat is not None and self.base.lon is not None:
            ax.xaxis.set_label_text(f"{ax.xaxis.get_label_text()} (0, 0: {self.base.lat:.6f}, {self.base.lon:.6f} deg, WGS84)")
        ax.set_title("\n".join([title, *notes]), fontsize="medium", parse_math=False)
        return figure, ax

    def add(self, ax: Any, polygons: FloatArray, **style: Any) -> Any:
        """Polygons as one artist; edges of the small ones are left out: they would cover them."""
        from matplotlib.collections import PolyCollection

        if "linewidths" not in style:
            sides = np.linalg.norm(np.diff(polygons[:, :3], axis=1), axis=2)
            points = 72 * ax.figure.get_figwidth() * np.median(sides.min(axis=1)) / max(float(self.high[0] - self.low[0]), 1e-3)
            style |= (
                {"edgecolors": "white", "linewidths": 0.5} if points > _WIDE_EDGE else {"edgecolors": "face", "linewidths": 0.2}
            )
        shown: Any = polygons - self.origin
        return ax.add_collection(PolyCollection(shown, **style))

    def tracks(self, ax: Any) -> None:
        """Mean tracks of lines from their beginning to their end, an arrow in the middle, names at the beginning."""
        lines: dict[str, int] = {}
        for number, strip in enumerate(self.strips):
            lines.setdefault(strip.line, number)
        ends = []
        for line, number in lines.items():
            both = self.track(number) - self.origin
            ends.append(both)
            if len(lines) <= _NAMED:
                name = os.path.splitext(os.path.basename(line))[0]
                ax.text(
                    *both[0], printable(name), fontsize="x-small", parse_math=False, clip_on=True, ha="center", va="bottom",
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 0.5}, zorder=5,
                )  # fmt: skip
        from matplotlib.collections import LineCollection

        ax.add_collection(LineCollection(ends, colors="black", linewidths=0.8, label="mean track"))
        begin, way = np.array(ends)[:, 0], np.diff(np.array(ends), axis=1)[:, 0]
        ax.quiver(
            *(begin + 0.45 * way).T, *(0.1 * way).T, angles="xy", scale_units="xy", scale=1.0, width=0.0015, headwidth=8,
            headlength=10, headaxislength=9, zorder=4,
        )  # fmt: skip


def _frame(strip: StripPlan) -> Frame | None:
    if strip.frame is None:
        return None
    try:
        return Frame(**strip.frame)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{strip.line}: attrs['frame']: {error}") from error


@dataclass(frozen=True)
class Panel:
    """A row of a quick-look: tiles `first` to `last` - 1 as mean power in boxes.

    Attributes
    ----------
    power : (row, column)
        Across and along the line; NaN where no tile is.
    states : mapping of int to str
        Of its tiles that have no pixels.
    """

    first: int
    last: int
    power: FloatArray
    states: Mapping[int, str]


def quicklook(strip: StripPlan, panels: Sequence[Panel]) -> bytes:
    """PNG of a strip's rows, one scale of dB for all."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    positive = np.concatenate([panel.power[panel.power > 0] for panel in panels])
    level = 10 * float(np.log10(np.percentile(positive, 99.9))) if positive.size else 0.0
    length = (panels[0].last - panels[0].first) * strip.columns * strip.step
    across = float(strip.y[-1] - strip.y[0]) + strip.step
    high = float(np.clip(_ROW[0] * 0.85 * across / length, 1.0, 5.0))
    figure = plot._figure(figsize=(_ROW[0], len(panels) * (high + _ROW[1]) + 0.3), dpi=_DPI, layout="constrained")
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    port_up = (strip.side == "port") == (float(strip.y.mean()) > strip.track)  # as seen from above, whether z is up or down
    drawn, found = None, set()
    for ax, panel in zip(axes, panels, strict=True):
        with np.errstate(divide="ignore"):
            db = np.maximum(10 * np.log10(panel.power) - level, -2 * _RANGE)
        x = strip.start + strip.step * (strip.columns * np.array([panel.first, panel.last]) - 0.5)
        away = np.array([strip.y[0], strip.y[-1]]) - strip.track
        drawn = ax.imshow(
            np.ma.masked_invalid(db), origin="lower", extent=(*x, *away), interpolation="nearest", cmap="inferno",
            vmin=-_RANGE, vmax=0.0, aspect="auto",
        )  # fmt: skip
        for state in COLOURS:
            tiles = [tile for tile, of_tile in panel.states.items() if of_tile == state]
            if tiles:
                found.add(state)
                edges = strip.start + strip.step * (strip.columns * np.array([[tile, tile + 1] for tile in tiles]) - 0.5)
                polygons = [[(a, away[0]), (b, away[0]), (b, away[1]), (a, away[1])] for a, b in edges]
                ax.add_collection(PolyCollection(polygons, facecolors=COLOURS[state], edgecolors="0.2", lw=0, hatch="////"))
        ax.set_xlim(x[0], x[0] + length)
        ax.set_ylim(*(away if port_up else away[::-1]))
        ax.set_ylabel("across, m", fontsize="small")
    axes[-1].set_xlabel("along the track, m")
    said = f"dB re {level:.1f} dB,\nthe 99.9th percentile"
    figure.colorbar(drawn, ax=list(axes), label=said, extend="max", aspect=12 * len(panels))
    if found:
        patches = [Patch(facecolor=COLOURS[state], hatch="////", label=state) for state in COLOURS if state in found]
        axes[0].legend(handles=patches, loc="upper right", fontsize="small", ncols=len(patches))
    return png(figure)


def printable(text: str) -> str:
    """Text of a file that a picture or a page can hold: half a surrogate pair as an escape."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def png(figure: Any) -> bytes:
    """A figure as PNG."""
    content = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # letters of a file's name that the font does not have
        figure.savefig(content, format="png", dpi=_DPI)
    return content.getvalue()


def drawable() -> bool:
    """Whether matplotlib is there."""
    try:
        plot._figure()
    except ImportError:
        return False
    return True
