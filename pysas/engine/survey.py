"""What engines are handed: traces with what each weighs, an image's pixels; and what they tell of their sums."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine.traces import Records

Trigonometry = tuple[tuple[float, ...], tuple[float, ...]]  # of polynomials for sine and cosine


def rows_per_task(n_fine: int) -> int:
    """Traces a worker transforms at a time: several, unless their transforms outgrow the cache; more where they are short, as
    what is around the transforms is Python's, one thread at a time."""
    return max(1, min(8, 2**19 // n_fine), min(16, 2**16 // n_fine))


@dataclass(frozen=True)
class Survey:
    """Traces as the kernels want them, coordinates about the scene's centre.

    trace : (trace,) TRACE, whose first sample kept may lie before the record; weights : (trace,); kind : MONOSTATIC,
    STOP_AND_HOP or MOVING; model : () MODEL; lattice : weights that change from pixel to pixel, at places (y, x, trace),
    float32, and view_angles.Lattice.axes, or None; own : those of a list of points, (point, trace) of the arithmetic's type,
    with rows for whole blocks, or None.
    """

    trace: Records
    weights: ComplexArray
    kind: int
    model: Records
    lattice: tuple[npt.NDArray[np.float32], FloatArray] | None = None
    own: npt.NDArray[Any] | None = None

    @property
    def start(self) -> npt.NDArray[np.int64]:
        """Number of the first sample kept of each trace."""
        return np.asarray(self.trace["kept"], dtype=np.int64)

    def part(self, begin: int, end: int) -> Survey:
        """Traces [begin, end)."""
        lattice = self.lattice
        if lattice is not None:
            lattice = (np.ascontiguousarray(lattice[0][..., begin:end]), lattice[1])
        own = None if self.own is None else np.ascontiguousarray(self.own[:, begin:end])
        some = slice(begin, end)
        return Survey(self.trace[some], self.weights[some], self.kind, self.model, lattice, own)

    def weighing(self) -> tuple[npt.NDArray[np.float32], FloatArray]:
        """The lattice as Numba's kernels take it: without traces where there is none."""
        return (np.empty((4, 4, 0), dtype=np.float32), np.ones(5)) if self.lattice is None else self.lattice


@dataclass(frozen=True)
class Tile:
    """Rows [first, last) and columns [left, right) of the image seen as (line, pixel on the line)."""

    first: int
    last: int
    left: int
    right: int


@dataclass(frozen=True)
class Totals:
    """What a sum did."""

    prepare_seconds: float
    sum_seconds: float
    terms: int

    def more(self, other: Totals, terms: int | None = None) -> Totals:
        """With another sum's, of `terms` if it says so."""
        terms = other.terms if terms is None else terms
        return Totals(self.prepare_seconds + other.prepare_seconds, self.sum_seconds + other.sum_seconds, self.terms + terms)


class Raster(Protocol):
    """The image as lines of pixels, or one line of points; see planning/raster.py."""

    straight: bool
    first: FloatArray
    step: FloatArray
    shape: tuple[int, int]
    count: int
    mask: npt.NDArray[np.bool_] | None

    def points(self, begin: int, end: int) -> FloatArray: ...

    def tiles(self) -> list[Tile]: ...

    def locate(self, tile: Tile) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]: ...


def readable(samples: ComplexArray) -> ComplexArray:
    """`samples` as kernels read them: this machine's byte order, aligned, whole elements apart; themselves where they are."""
    plain = samples.flags.aligned and all(step % samples.itemsize == 0 for step in samples.strides)
    return samples if samples.dtype.isnative and plain else np.array(samples, dtype=samples.dtype.newbyteorder("="), order="C")
