"""Pictures of images. matplotlib is imported here and only when a picture is drawn; no global state (no pyplot)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.image import Image
from pysas.io import replacing

_MOST = 1600  # pixels drawn per axis; more are reduced by block maxima, so that points do not vanish
_FAR = 1e4  # coordinates beyond this are drawn about a round origin named on the axis


def quicklook(
    image: Image,
    path: str | os.PathLike[str] | None = None,
    *,
    dynamic_range: float = 40.0,
    targets: npt.ArrayLike | None = None,
    title: str | None = None,
    ax: Any = None,
) -> Any:
    """Draw the magnitude in dB below the 99.9th-percentile peak, axes in metres, equal aspect, colour bar.

    Parameters
    ----------
    image : Image
        A volume is drawn as its maximum over z, points as a scatter plot.
    path : path, optional
        Written as PNG (or what the suffix says), complete or not at all.
    dynamic_range : float
        dB shown.
    targets : (n, 2 or 3) array_like, optional
        Positions marked with small circles.
    title : str, optional
        Default: method and tol.
    ax : matplotlib Axes, optional
        Drawn into; default: a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        Without matplotlib; names the extra.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise _checks.optional("matplotlib", "plot") from None
    if not isinstance(image, Image):
        raise TypeError(f"image={type(image).__name__}: expected pysas.Image")
    dynamic_range = _checks.number("dynamic_range", dynamic_range, positive=True)
    figure: Any
    if ax is None:
        figure = Figure(figsize=_size(image), layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
    else:
        figure = ax.figure
    grid = image.grid
    magnitude = np.abs(image.data).astype(np.float64)
    note = ""
    if grid.kind == "volume":
        magnitude, note = magnitude.max(axis=0), ", maximum over z"
    positive = magnitude[magnitude > 0]
    peak = float(np.percentile(positive, 99.9)) if positive.size else 1.0
    with np.errstate(divide="ignore"):
        db = np.maximum(20 * np.log10(magnitude / peak), -2 * dynamic_range)
    style: dict[str, Any] = {"vmin": -dynamic_range, "vmax": 0.0, "cmap": "inferno"}
    origin = np.zeros(2)
    if grid.kind in ("plane", "surface", "volume"):
        x, y = grid.axes["x"], grid.axes["y"]
        origin = _origin(x, y)
        drawn = _draw_rectangles(ax, x - origin[0], y - origin[1], db, style)
    elif grid.kind == "polar":
        x, y, _ = grid.coordinates().T
        origin = _origin(x, y)
        drawn = ax.pcolormesh(
            (x - origin[0]).reshape(grid.shape),
            (y - origin[1]).reshape(grid.shape),
            db,
            shading="nearest",
            rasterized=True,
            **style,
        )
    else:
        x, y, _ = grid.coordinates().T
        origin = _origin(x, y)
        drawn = ax.scatter(x - origin[0], y - origin[1], c=db.ravel(), s=4, **style)
    if targets is not None:
        marks = np.atleast_2d(np.asarray(targets, dtype=np.float64))
        ax.plot(marks[:, 0] - origin[0], marks[:, 1] - origin[1], "o", mfc="none", mec="deepskyblue", ms=9, mew=0.8)
    ax.set_aspect("equal")
    for axis, name, start in ((ax.xaxis, "x (along-track)", origin[0]), (ax.yaxis, "y (across-track)", origin[1])):
        axis.set_label_text(f"{name}, m" + (f" from {start:.0f}" if start else ""))
    figure.colorbar(drawn, ax=ax, label="dB below the 99.9th percentile", shrink=0.85)
    tol = "" if image.report.tol is None else f", tol {image.report.tol:g}"
    ax.set_title((f"{image.report.method}{tol}" if title is None else title) + note)
    if path is not None:
        with replacing(Path(path)) as temporary:
            figure.savefig(temporary, dpi=150, format=Path(path).suffix.lstrip(".").lower() or "png")
    return figure


def _size(image: Image) -> tuple[float, float]:
    """Figure size, inches, that the image's shape fills beside its colour bar."""
    x, y, _ = np.ptp(image.grid.coordinates(_corners(image)), axis=0)
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


def _draw_rectangles(ax: Any, x: FloatArray, y: FloatArray, db: FloatArray, style: dict[str, Any]) -> Any:
    rows, columns = (max(1, -(-n // _MOST)) for n in db.shape)
    if rows > 1 or columns > 1:
        db = np.maximum.reduceat(db, np.arange(0, db.shape[0], rows), axis=0)
        db = np.maximum.reduceat(db, np.arange(0, db.shape[1], columns), axis=1)
    even = all(v.size < 3 or np.ptp(np.diff(v)) < 1e-3 * abs(np.diff(v)).max() for v in (x, y))
    if even:
        dx, dy = ((v[-1] - v[0]) / max(v.size - 1, 1) / 2 or 0.5 for v in (x, y))
        extent = (x[0] - dx, x[-1] + dx, y[0] - dy, y[-1] + dy)
        return ax.imshow(db, origin="lower", extent=extent, interpolation="nearest", **style)
    middle_x = np.array([part.mean() for part in np.split(x, range(columns, x.size, columns))])
    middle_y = np.array([part.mean() for part in np.split(y, range(rows, y.size, rows))])
    return ax.pcolormesh(middle_x, middle_y, db, shading="nearest", rasterized=True, **style)
