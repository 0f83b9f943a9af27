"""Pictures of images. matplotlib is imported here and only when a picture is drawn; no global state (no pyplot)."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files
from pysas.model.grid import Grid
from pysas.model.image import Image
from pysas.motion.found import Motion
from pysas.motion.results import Report

Shade = Callable[[npt.NDArray[Any]], FloatArray]

_DPI = 150
_FAR = 1e4  # coordinates beyond this are drawn about a round origin named on the axis


def quicklook(
    image: Image,
    path: str | os.PathLike[str] | None = None,
    *,
    dynamic_range: float = 40.0,
    reference: str | float = "peak",
    targets: npt.ArrayLike | None = None,
    title: str | None = None,
    ax: Any = None,
    overwrite: bool = True,
) -> Any:
    """Draw the magnitude in dB, axes in metres, equal aspect, colour bar.

    Parameters
    ----------
    image : Image
        A volume is drawn as its maximum over z, points as a scatter plot.
    path : path, optional
        Written as PNG (or what the suffix says), complete or not at all.
    dynamic_range : float
        dB shown, below the reference.
    reference : "peak", "percentile" or float
        What is drawn as 0 dB: the largest magnitude, its 99.9th percentile (of the pixels that are not 0), or a level in dB,
        20 log10 of a magnitude, by which pictures of several images can be compared. The colour bar names it in dB.
    targets : (n, 2 or 3) array_like, optional
        Positions marked with small circles.
    title : str, optional
        Default: method and tol.
    ax : matplotlib Axes, optional
        Drawn into; default: a new figure.
    overwrite : bool
        False: a file that is there is an error.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        Without matplotlib; names the extra.
    ValueError, TypeError
        An argument outside its range, or a suffix that this matplotlib cannot write.
    OSError
        From the file system.
    """
    if not isinstance(image, Image):
        raise TypeError(f"image={type(image).__name__}: expected pysas.Image")
    dynamic_range = _checks.number("dynamic_range", dynamic_range, positive=True)
    marks = None if targets is None else _checks.reals("targets", targets, [(2,), (3,), ("n", 2), ("n", 3)], ("target",))
    if isinstance(reference, str):
        _checks.choice("reference", reference, ("peak", "percentile"))
    else:
        reference = _checks.number("reference", reference, low=-600, high=600)
    kind = "" if path is None else picture_format(path)
    figure: Any
    if ax is None:
        figure = _figure(figsize=_size(image), dpi=_DPI, layout="constrained")
        ax = figure.add_subplot()
    else:
        figure = ax.figure
    grid = image.grid
    magnitude = np.abs(image.data)
    note = ""
    if grid.kind == "volume":
        magnitude, note = magnitude.max(axis=0), ", maximum over z"
    level, said = _reference(magnitude, reference)

    def db(found: npt.NDArray[Any]) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.maximum(20 * np.log10(found.astype(np.float64)) - level, -2 * dynamic_range)

    style: dict[str, Any] = {"vmin": -dynamic_range, "vmax": 0.0, "cmap": "inferno"}
    origin = np.zeros(2)
    if grid.kind in ("plane", "surface", "volume"):
        x, y = grid.axes["x"], grid.axes["y"]
        origin = _origin(x, y)
        drawn = _draw_rectangles(ax, x - origin[0], y - origin[1], magnitude, db, style)
    elif grid.kind == "polar":
        x, y, _ = grid.coordinates().T
        origin = _origin(x, y)
        drawn = _draw_sector(ax, grid, origin, magnitude, db, style)
    else:
        x, y, _ = grid.coordinates().T
        origin = _origin(x, y)
        drawn = ax.scatter(x - origin[0], y - origin[1], c=db(magnitude.ravel()), s=4, **style)
    if marks is not None:
        marks = grid.along_axes(np.atleast_2d(marks))
        ax.plot(marks[:, 0] - origin[0], marks[:, 1] - origin[1], "o", mfc="none", mec="deepskyblue", ms=9, mew=0.8)
    ax.set_aspect("equal")
    for axis, name, start in ((ax.xaxis, "x (along-track)", origin[0]), (ax.yaxis, "y (across-track)", origin[1])):
        axis.set_label_text(f"{name}, m" + (f" from {start:.0f}" if start else ""))
    if grid.turned:
        where = f"from ({grid.origin[0]:.10g}, {grid.origin[1]:.10g}), turned {np.degrees(grid.rotation):.1f} deg"
        ax.xaxis.set_label_text(f"{ax.xaxis.get_label_text()}\n{where}")
    figure.colorbar(drawn, ax=ax, label=said, shrink=0.85, extend="neither" if db(magnitude.max()) <= 1e-6 else "max")
    tol = "" if image.report.tol is None else f", tol {image.report.tol:g}"
    ax.set_title((f"{image.report.method}{tol}" if title is None else title) + note)
    if path is not None:
        write(figure, path, kind, dpi=_DPI, overwrite=overwrite)
    return figure


def track(
    found: Motion | Report,
    path: str | os.PathLike[str] | None = None,
    *,
    before: Image | None = None,
    after: Image | None = None,
    dynamic_range: float = 40.0,
    title: str | None = None,
    overwrite: bool = True,
) -> Any:
    """Draw what was found of a track: corrections with what they are sure to, coherence, the image before and after.

    Parameters
    ----------
    found : pysas.motion.Motion or pysas.motion.Report
        Of `micronavigate`; or of `align_points` or `autofocus`, which know shifts alone.
    path : path, optional
        As in `quicklook`.
    before, after : Image, optional
        With the claimed track and with the corrected one, drawn on one scale of dB relative to the peak of `after`: both, or
        neither.
    dynamic_range : float
        dB shown of the images.
    title : str, optional
    overwrite : bool
        False: a file that is there is an error.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        Without matplotlib; names the extra.
    ValueError, TypeError
        Anything else to draw; one image without the other; a suffix that this matplotlib cannot write.
    OSError
        From the file system.
    """
    if not isinstance(found, Motion | Report):
        raise TypeError(f"found={type(found).__name__}: expected pysas.motion.Motion or pysas.motion.Report")
    if (before is None) != (after is None):
        raise ValueError("before, after: one image alone: expected both or neither")
    kind = "" if path is None else picture_format(path)
    rows = 3 if isinstance(found, Motion) else 1
    figure = _figure(figsize=(7 if before is None else 14, max(2.4 * rows, 4.8)), dpi=_DPI, layout="constrained")
    tracks, pictures = (figure, None) if before is None else figure.subfigures(1, 2)
    axes = tracks.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    ping = np.arange(len(found.shift))
    if isinstance(found, Motion):
        _draw_motion(axes, ping, found)
    else:
        for values, name in zip(found.shift.T, "xyz", strict=True):
            axes[0].plot(ping, 1e3 * values, lw=1, label=f"along {name}")
        axes[0].set_ylabel("shift, mm")
        axes[0].legend(fontsize="small")
    axes[-1].set_xlabel("ping")
    tracks.suptitle(str(found).splitlines()[0] if title is None else title, fontsize="medium", wrap=True)
    if before is not None and after is not None and pictures is not None:
        peak = float(np.max(np.abs(after.data)))
        level = 20 * np.log10(peak) if peak > 0 else 0.0
        for ax, image, name in zip(pictures.subplots(2, 1), (before, after), ("claimed track", "corrected track"), strict=True):
            quicklook(image, ax=ax, dynamic_range=dynamic_range, reference=level, title=name)
    if path is not None:
        write(figure, path, kind, dpi=_DPI, overwrite=overwrite)
    return figure


def _draw_motion(axes: Any, ping: npt.NDArray[np.int64], found: Motion) -> None:
    """Shifts and turns, each with the band of its standard deviation, and coherence with what was not seen."""
    shift, turn, seen = axes
    for values, name, colour in ((found.surge, "surge", "C2"), (found.sway, "sway", "C0"), (found.heave, "heave", "C1")):
        shift.plot(ping, 1e3 * values, lw=1, color=colour, label=name)
    low, high = 1e3 * (found.sway - found.track_sigma), 1e3 * (found.sway + found.track_sigma)
    shift.fill_between(ping, low, high, color="C0", alpha=0.3, lw=0, label="standard deviation, slant")
    shift.set_ylabel("shift, mm")
    shift.legend(fontsize="small", ncols=2)
    turn.plot(ping, 1e3 * found.yaw, lw=1, color="C3")
    turn.set_ylabel("yaw, mrad")
    twin = turn.twinx()
    twin.plot(ping, 1e6 * found.sigma[:, 3], lw=0.8, color="0.5")
    twin.set_ylim(bottom=0)
    twin.set_ylabel("sigma a ping, urad", color="0.5")
    seen.plot(ping[:-1] + 0.5, found.coherence, lw=1, color="C4")
    for pings, colour, name in ((found.unseen, "C3", "not seen"), (found.slips, "C1", "slip")):
        if pings:
            seen.plot(np.array(pings) + 0.5, np.zeros(len(pings)), "|", color=colour, ms=10, label=name)
    if found.unseen or found.slips:
        seen.legend(fontsize="small")
    seen.set_ylim(-0.05, 1.05)
    seen.set_ylabel("coherence")


def _reference(magnitude: npt.NDArray[Any], reference: str | float) -> tuple[float, str]:
    """What is drawn as 0 dB, in dB, and how the colour bar says it."""
    if not isinstance(reference, str):
        return reference, f"dB relative to {reference:.4g} dB"
    positive = magnitude[magnitude > 0]
    if positive.size == 0:
        return 0.0, "dB (the image is zero)"
    found = float(positive.max() if reference == "peak" else np.percentile(positive, 99.9))
    level = 20 * float(np.log10(found))
    return level, f"dB relative to {'the peak' if reference == 'peak' else 'the 99.9th percentile'}, {level:.4g} dB"


def write(figure: Any, path: str | os.PathLike[str], kind: str, *, dpi: float, overwrite: bool) -> None:
    """Write a figure in a format, complete or not at all.

    It is drawn in memory first: some of matplotlib's formats stumble over a full disk.
    """
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=dpi, format=kind)
    with files.replacing(path, overwrite=overwrite) as file:
        file.write(drawn.getbuffer())


def picture_format(path: str | os.PathLike[str]) -> str:
    """Format of a picture by its suffix, PNG without one; an error where it cannot be written here."""
    text, figure = files.name(path), _figure(figsize=(0.1, 0.1))
    figure.text(0, 0, "0")
    found = Path(text).suffix.lstrip(".").lower() or "png"
    known = figure.canvas.get_supported_filetypes()
    if found not in known:
        raise ValueError(f"{text}: found suffix {Path(text).suffix!r}, expected one of {', '.join(sorted(known))}")
    try:  # a format may need programs or libraries beside matplotlib
        figure.savefig(io.BytesIO(), format=found)
    except (RuntimeError, ValueError, OSError, ImportError) as error:
        raise ValueError(f"{text}: matplotlib cannot write {found} here: {error}") from error
    return found


def _figure(**choices: Any) -> Any:
    """A figure of no window."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise _checks.optional("matplotlib", "plot") from None
    figure = Figure(**choices)
    FigureCanvasAgg(figure)
    return figure


def _size(image: Image) -> tuple[float, float]:
    """Figure size, inches, that the image's shape fills beside its colour bar."""
    x, y = np.ptp(image.grid.along_axes(image.grid.coordinates(_corners(image))), axis=0)
    aspect = float(np.clip(x / max(y, 1e-300), 0.25, 4.0))
    height = 7.0 if aspect < 1 else max(7.0 / aspect, 2.5)
    return height * aspect + 2.2, height + 1.0


def _corners(image: Image) -> npt.NDArray[np.int64]:
    """Flat numbers of pixels that span the grid (all of an irregular one)."""
    shape = image.grid.shape
    if image.grid.kind in ("plane", "surface", "volume"):
        return np.array([0, int(np.prod(shape[-2:])) - 1])
    return np.arange(image.grid.size)


def _origin(x: FloatArray, y: FloatArray) -> FloatArray:
    """A round origin for coordinates too large to read on an axis, else 0."""
    return np.array([0.0 if np.max(np.abs(v)) < _FAR else np.floor(np.min(v) / 100) * 100 for v in (x, y)])


def _room(ax: Any, x: FloatArray, y: FloatArray) -> float:
    """Dots per metre that axes over these coordinates have at least: drawing more pixels would skip some."""
    box = ax.get_window_extent()
    return 0.85 * float(min(box.width / max(np.ptp(x), 1e-9), box.height / max(np.ptp(y), 1e-9)))


def _reduced(
    magnitude: npt.NDArray[Any], first: FloatArray, second: FloatArray, room: tuple[float, float]
) -> tuple[npt.NDArray[Any], FloatArray, FloatArray, tuple[int, int]]:
    """Maxima of blocks, about `room` of them along each axis, the axes of their middles, and the blocks' size."""
    size = tuple(max(1, int(np.ceil(n / max(most, 16.0)))) for n, most in zip(magnitude.shape, room, strict=True))
    for axis, block in enumerate(size):
        magnitude = np.maximum.reduceat(magnitude, np.arange(0, magnitude.shape[axis], block), axis=axis)
    axes = [
        np.array([part.mean() for part in np.split(v, range(block, v.size, block))])
        for v, block in zip((first, second), size, strict=True)
    ]
    return magnitude, axes[0], axes[1], (size[0], size[1])


def _draw_rectangles(
    ax: Any, x: FloatArray, y: FloatArray, magnitude: npt.NDArray[Any], db: Shade, style: dict[str, Any]
) -> Any:
    dots = _room(ax, x, y)
    even = all(v.size < 3 or np.ptp(np.diff(v)) < 1e-3 * abs(np.diff(v)).max() for v in (x, y))
    magnitude, middle_y, middle_x, (rows, columns) = _reduced(magnitude, y, x, (np.ptp(y) * dots, np.ptp(x) * dots))
    if not even:
        return ax.pcolormesh(middle_x, middle_y, db(magnitude), shading="nearest", rasterized=True, **style)
    dx, dy = ((v[-1] - v[0]) / max(v.size - 1, 1) or 1.0 for v in (x, y))
    left, bottom = x[0] - dx / 2, y[0] - dy / 2
    # the last block may reach beyond the image, whose own limits stay
    extent = (left, left + magnitude.shape[1] * columns * dx, bottom, bottom + magnitude.shape[0] * rows * dy)
    drawn = ax.imshow(db(magnitude), origin="lower", extent=extent, interpolation="nearest", **style)
    ax.set_xlim(left, left + x.size * dx)
    ax.set_ylim(bottom, bottom + y.size * dy)
    return drawn


def _draw_sector(ax: Any, grid: Grid, origin: FloatArray, magnitude: npt.NDArray[Any], db: Shade, style: dict[str, Any]) -> Any:
    x, y, _ = grid.coordinates().T
    r, angle = grid.axes["r"], grid.axes["angle"]
    dots = _room(ax, x, y)
    room = (np.ptp(angle) * np.abs(r).max() * dots, np.ptp(r) * dots)
    magnitude, angle, r, _ = _reduced(magnitude, angle, r, room)
    east, north = (grid.centre[i] - origin[i] + np.outer(f(angle), r) for i, f in enumerate((np.cos, np.sin)))
    return ax.pcolormesh(east, north, db(magnitude), shading="nearest", rasterized=True, **style)
