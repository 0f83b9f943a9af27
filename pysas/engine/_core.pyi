"""What the C++ extension exports; a test compares this with the extension itself."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.engine.traces import Records

def compiler() -> str:
    """Name and version of the compiler that built this extension."""

def levels() -> list[str]:
    """Instruction sets this build has and this machine runs, worst first."""

def sizes() -> dict[str, Any]:
    """What kernels are compiled for, by precision: `degrees` of the interpolation, `terms` of the sine, `nodes` of the
    delay; and what all share: pixels of a `block`, `rows` of a tile, `step` of a filter at most."""

def isa(name: str) -> str:
    """The instruction set that `name` stands for; "auto" is the best. ValueError for one that is not in `levels`."""

def stop_others() -> None:
    """The interpreter ends in this thread: sums in others are to stop."""

def keep_others() -> None:
    """From now on the other threads do not come back to it."""

def away() -> int:
    """Threads outside the interpreter that may still come back."""

def plane_stride(intervals: int, degree: int, real: int) -> int:
    """Reals of `real` bytes from one plane of a table to the next."""

def intervals(length: int, rate: float) -> int:
    """Intervals of a table over `length` samples."""

class Filter:
    """Weights (phase, tap, power) and first taps (phase,) of a filter, its steps, and its measured `error`.

    `rate` : over-sampling, intervals per sample.
    """

    @property
    def weight(self) -> npt.NDArray[np.float64]: ...
    @property
    def first(self) -> npt.NDArray[np.int64]: ...
    @property
    def step(self) -> int: ...
    @property
    def error(self) -> float: ...
    @property
    def degree(self) -> int: ...
    @property
    def taps(self) -> int: ...
    @property
    def phases(self) -> int: ...
    @property
    def rate(self) -> float: ...
    def __init__(self, weight: npt.NDArray[np.float64], first: npt.NDArray[np.int64], step: int, error: float) -> None: ...

class Polynomials:
    """How tables are read and delays formed: degree of the interpolation, sine and cosine in turns^2, nodes of delays and the
    matrix from values there to coefficients, 7 x 7."""

    def __init__(
        self,
        degree: int,
        sine: Sequence[float],
        cosine: Sequence[float],
        nodes: npt.NDArray[np.float64],
        fit: npt.NDArray[np.float64],
    ) -> None: ...

class Traces:
    """Traces, what they have in common, and their weights at places (y, x, trace) with view_angles.Lattice.axes."""

    def __init__(
        self,
        trace: Records,
        model: Records,
        kind: int,
        weights: tuple[npt.NDArray[np.float32], npt.NDArray[np.float64]] | None,
    ) -> None: ...

class Raster:
    """Lines by first pixels and steps, or points; which of them are wanted; `count` pixels make a block."""

    def __init__(
        self,
        first: npt.NDArray[np.float64] | None,
        step: npt.NDArray[np.float64] | None,
        points: npt.NDArray[np.float64] | None,
        mask: npt.NDArray[np.bool_] | None,
        count: int,
    ) -> None: ...

class SubImages:
    """See pysas.engine.tree.SubImages; `store` has their rows."""

    def __init__(
        self,
        place: npt.NDArray[np.float64],
        shape: npt.NDArray[np.int64],
        range: npt.NDArray[np.int32],
        store: npt.NDArray[np.float32],
    ) -> None: ...

class Stack:
    """See pysas.engine.steps.Stack."""

    def __init__(self, axis: npt.NDArray[np.float64], heights: npt.NDArray[np.float64], number: int) -> None: ...

def design(band: float, degree: int, phases: int, step: int, error: float, least: int, most: int) -> Filter:
    """A filter, with its measured error; see csrc/core/filters.hpp."""

def peaks(
    data: npt.NDArray[Any],
    begin: npt.NDArray[np.int64],
    end: npt.NDArray[np.int64],
    threads: int,
    tick: Callable[[float], object] | None,
) -> npt.NDArray[np.float64]:
    """Largest real or imaginary part of samples [begin, end) of every trace of (ping, channel, sample); not finite where the
    trace is not."""

def mean_squares(
    data: npt.NDArray[Any],
    trace: npt.NDArray[np.int64],
    place: npt.NDArray[np.int64],
    reach: int,
    scale: float,
    threads: int,
    tick: Callable[[float], object] | None,
) -> npt.NDArray[np.float64]:
    """Mean square of the 2 reach + 1 samples about each place (flat trace, sample), in units of scale^2; 0 off the record."""

def prepare(
    data: npt.NDArray[Any],
    order: npt.NDArray[np.int64],
    start: npt.NDArray[np.int64],
    weights: npt.NDArray[np.complex128] | None,
    scale: float,
    filter: Filter,
    length: int,
    table: npt.NDArray[Any],
    threads: int,
    isa: str,
    tick: Callable[[float], object] | None,
) -> None:
    """Fill `table` (trace, plane, plane_stride) from the samples of traces `order`."""

def add(
    table: npt.NDArray[Any],
    polynomials: Polynomials,
    traces: Traces,
    raster: Raster,
    own: npt.NDArray[Any] | None,
    image: npt.NDArray[Any],
    threads: int,
    isa: str,
    tick: Callable[[float], object] | None,
) -> int:
    """Add a batch's terms to `image` (line, pixel); returns how many.

    `own` : weights of a list of points, (point, trace) of the table's reals, with rows for whole blocks of points.
    """

def arcs(
    trace: Records,
    channels: int,
    cos_beam: float,
    points: npt.NDArray[np.float64],
    order: npt.NDArray[np.int64],
    out: npt.NDArray[Any],
    threads: int,
    tick: Callable[[float], object] | None,
) -> npt.NDArray[np.uint64]:
    """Arcs of view angle that traces `order` stand for at points, in `out` (point or more, trace); the views' patterns.

    See csrc/core/arcs.hpp.
    """

class Tree:
    """Taps (see pysas.engine.tree.Taps) and carrier, turns a metre of range, that all steps of a tree share."""

    def __init__(
        self,
        even: npt.NDArray[np.float32],
        odd: npt.NDArray[np.float32],
        tap: npt.NDArray[np.float32],
        filter: npt.NDArray[np.float32],
        wave: float,
        carrier: Polynomials,
    ) -> None: ...

def leaves(
    tree: Tree,
    table: npt.NDArray[np.float32],
    polynomials: Polynomials,
    traces: Traces,
    span: npt.NDArray[np.int64],
    to: SubImages,
    slack: float,
    smooth: bool,
    threads: int,
    isa: str,
    tick: Callable[[float], object] | None,
) -> None:
    """Fill the sub-images of groups of traces; with `smooth` for pixels to read, else for merging."""

def merge(
    tree: Tree,
    span: npt.NDArray[np.int64],
    children: SubImages,
    to: SubImages,
    add: bool,
    last: bool,
    smooth: bool,
    threads: int,
    isa: str,
    tick: Callable[[float], object] | None,
) -> None:
    """Sub-images from their children's, added to what they hold with `add`; filtered with `last`, for pixels with `smooth`."""

def read(
    tree: Tree,
    sub_image: SubImages,
    raster: Raster,
    stack: Stack | None,
    wanted: npt.NDArray[np.uint8],
    image: npt.NDArray[Any],
    threads: int,
    isa: str,
    tick: Callable[[float], object] | None,
) -> None:
    """Add a sub-image to the `wanted` tiles of `image` (line, pixel): lines on its plane, or points near it."""

def subtree(
    trace: Records,
    centres: npt.NDArray[np.float64],
    order: npt.NDArray[np.int64],
    medium: npt.NDArray[np.float64],
    fans: Sequence[int],
    taps: int,
    half: int,
    rate: float,
    plane: float,
    direction: float,
    readings: npt.NDArray[np.float64],
    step: float,
    left: int,
) -> tuple[
    npt.NDArray[np.int64],
    npt.NDArray[np.int64],
    npt.NDArray[np.float64],
    npt.NDArray[np.int64],
    npt.NDArray[np.int32],
    npt.NDArray[np.int64],
    float,
]:
    """The tree below a group, traces `order`, for `readings` (n, 4): bearings from `direction` and ground distances, lowest and
    highest. Returns traces in the leaves' order, sub-images of each level, leaves first, and all levels' places, shapes,
    ranges and spans, and the highest frequency along their rays; no levels where these would take more than the floats
    `left`.

    `medium` : sound speed, carrier, bandwidth and about what passes until an echo arrives where receivers move.
    """
