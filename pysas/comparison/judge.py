"""The judge of images: the exact sum on some of their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import metrics, reference
from pysas.comparison.rows import Pair
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image

Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.intp]

_FITTED = ("range-Doppler", "chirp scaling")  # without the weight of the sum: a law of range and one factor are free
_REACH = 24  # pixels of a cut either side of the target


@dataclass(frozen=True, eq=False)
class Answer:
    """The exact sum on sampled pixels of a grid: row's cut, column's cut, random ones."""

    grid: Grid
    cuts: tuple[slice, slice]
    peak: int
    pixels: Index
    exact: Complex
    level: npt.NDArray[np.float64]

    def response(self, values: Complex) -> tuple[Pair, Pair]:
        """IRW (m) and PSLR (dB) of sampled `values`, each along x and y."""
        found = [_response(values[cut], self.grid.axes[name]) for cut, name in zip(self.cuts, ("x", "y"), strict=True)]
        return (found[0][0], found[1][0]), (found[0][1], found[1][1])


def _response(cut: Complex, axis: npt.NDArray[np.float64]) -> Pair:
    steps = np.diff(axis)
    if cut.size < 3 or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return None, None
    try:
        width, side = metrics.irw(cut, abs(float(steps[0]))), metrics.pslr(cut)
    except ValueError:  # no main lobe
        return None, None
    return width, side if np.isfinite(side) else None


class Judge:
    """Compares images with the exact sum; those that share a grid share its pixels."""

    def __init__(self, echoes: Echoes, box: tuple[Any, Any] | None, count: int) -> None:
        self.echoes, self.box, self.count = echoes, box, count
        self.known: dict[Any, Answer] = {}

    def answer(self, image: Image) -> Answer:
        grid = image.grid
        turned = np.array([*grid.origin, grid.rotation])
        key = (
            np.asarray(grid.height).tobytes(),
            turned.tobytes(),
            *(np.round(axis, 9).tobytes() for axis in grid.axes.values()),
        )
        if key not in self.known:
            x, y = grid.axes["x"], grid.axes["y"]
            if self.box is None:
                row, column = divmod(int(np.argmax(np.abs(image.data))), x.size)
                bounds = [(axis.min(), axis.max()) for axis in (x, y)]
            else:
                column, row = (int(np.argmin(np.abs(axis - at))) for axis, at in zip((x, y), self.box[0], strict=True))
                bounds = [(at - half, at + half) for at, half in zip(*self.box, strict=True)]
            rng = np.random.default_rng(0)
            places = [rng.uniform(low, high, self.count) for low, high in bounds]
            columns, rows = (np.argmin(np.abs(a[:, None] - p), axis=0) for a, p in zip((x, y), places, strict=True))
            along = np.arange(max(column - _REACH, 0), min(column + _REACH + 1, x.size))
            across = np.arange(max(row - _REACH, 0), min(row + _REACH + 1, y.size))
            pixels = np.concatenate([row * x.size + along, across * x.size + column, rows * x.size + columns])
            cuts = slice(0, along.size), slice(along.size, along.size + across.size)
            exact, level = reference.exact(self.echoes, grid, pixels)
            self.known[key] = Answer(grid, cuts, column - int(along[0]), pixels, exact, level)
        return self.known[key]

    def judged(self, method: str, image: Image) -> dict[str, Any]:
        """Fields of a `Row`."""
        answer = self.answer(image)
        values = image.data.ravel()[answer.pixels].astype(np.complex128)
        fitted = method in _FITTED
        if fitted:
            ranges = np.abs(image.grid.axes["y"][answer.pixels // image.grid.shape[1]] - self.echoes.tx[:, 1].mean())
            values *= np.sqrt(ranges)
            power = np.vdot(values, values).real
            values *= np.vdot(values, answer.exact) / power if power > 0 else 1.0
        wanted, found = np.abs(answer.exact[answer.peak]), np.abs(values[answer.peak])
        irw, pslr = answer.response(values)
        return {
            "error": metrics.relative_error(values, answer.exact, answer.level), "fitted": fitted, "irw": irw, "pslr": pslr,
            "loss": float(20 * np.log10(wanted / found)) if wanted > 0 and found > 0 else None,
            "share": image.report.factorised_share, "shape": image.grid.shape,
        }  # fmt: skip
