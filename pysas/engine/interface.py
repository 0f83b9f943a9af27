"""What an engine offers: all that planning and imaging know of one. Nothing outside this folder asks for its name to decide."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine.survey import Raster, Survey, Totals, Trigonometry
from pysas.engine.traces import Records
from pysas.engine.tree import PolarGrid, Taps

Tick = Callable[[float], None] | None
Places = FloatArray | tuple[FloatArray, FloatArray, FloatArray] | Callable[[npt.NDArray[np.int64]], FloatArray]


class Chosen(Protocol):
    """What a plan chose: `choices`, as planning.settings.Choices has them, with errors by name; `share` of the terms that go
    through `trees`, and `why_direct` where these were asked for in vain."""

    choices: dict[str, Any]
    share: float
    trees: int
    why_direct: str


class Done(Chosen, Protocol):
    """What became of some data, and the plan that was carried out.

    left_out : traces with samples that are not finite; used : number of traces summed; beside : error that bright samples
    make beyond the plan's bounds; lost : share of the image that its type does not hold; loudest : trace beside which others
    are lost in float32, or -1.
    """

    prepare_seconds: float
    sum_seconds: float
    terms: int
    left_out: Sequence[int]
    used: int
    beside: float
    lost: float
    loudest: int


class Planned(Chosen, Protocol):
    """A plan of an engine that plans by itself; seconds : predicted, on one thread; memory : bytes beyond the input."""

    isa: str
    seconds: float
    memory: int

    def describe(self, shape: str, more: int) -> str:
        """In words, of an image of a shape, with `more` bytes that a caller allocates."""

    def other(self) -> str:
        """The method that is not used: its predicted time, or why it cannot be."""

    def follow(self, before: Any) -> None:
        """Work in the memory that a plan before keeps, instead of memory of its own."""

    def __call__(self, data: ComplexArray, image: ComplexArray, whole: bool, tick: Tick) -> Done:
        """Image (ping, channel, sample) into (row, column); an error where a trace is not finite, with `whole`."""


class Engine(Protocol):
    """Something that sums. name : as `backend` has it."""

    name: str

    def isa(self) -> str:
        """What kernels run on: an instruction set, or a processor's name."""

    def arcs(
        self, trace: Records, channels: int, beam: Records, points: FloatArray, order: npt.NDArray[np.int64],
        out: npt.NDArray[Any], threads: int,
    ) -> npt.NDArray[np.uint64]:  # fmt: skip
        """Fill `out` (point, kept) with the arcs of traces `order` among all at points about the scene's centre.

        Their mean over the traces within whose beam a point lies is 1; the others' arcs are what they would be there. Rows
        of `out` beyond the points stay. Returns a number for each point that is the same where views have one order around
        the circle, one grouping and one set of openings, so that arcs are smooth from place to place; 0 where a view has no
        angle or a gap is about as wide as makes an opening. O(point trace log trace).
        """


@runtime_checkable
class Planning(Engine, Protocol):
    """An engine that plans by itself."""

    def plan(
        self, scene: Any, shape: tuple[int, ...], mask: npt.NDArray[np.bool_] | None,
        points: Places, tol: float, budget: float, method: str, fallback: bool, threads: int,
    ) -> Planned:  # fmt: skip
        """How to image a planning.scene.Scene on a grid of a shape and mask, whose pixels lie at `points`: a list (n, 3), x,
        y and heights (y, x) of a map, or what tells coordinates about the scene's centre by pixels' numbers.

        `budget` : of tol, what sums may be wrong by; `fallback` : whether direct sums may stand in for trees.
        """


class Parts(Engine, Protocol):
    """An engine whose sums are put together by its callers.

    nodes : of delay polynomials, by precision; sines : numbers of terms of sine and cosine to choose from, by precision; sums :
    float sums that a term goes through; slab : points whose delays are exact that are looked at at a time, or 0.
    """

    nodes: Mapping[str, int]
    sines: Mapping[str, Sequence[int]]
    sums: int
    slab: int

    def peaks(
        self, data: ComplexArray, valid: npt.NDArray[np.int64], begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64],
        threads: int,
    ) -> FloatArray:  # fmt: skip
        """Largest |real| or |imaginary| part of samples [begin, end) of each trace, (ping, channel); not finite where any
        sample is not that was recorded, `valid` (trace, 2): the first and the last."""

    def mean_squares(
        self, data: ComplexArray, valid: npt.NDArray[np.int64], trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64],
        reach: int, scale: float, threads: int,
    ) -> FloatArray:  # fmt: skip
        """Mean squares of the 2 reach + 1 samples about places of (ping, channel, sample), in units of scale^2; those not
        recorded (`valid`, as above) count as 0."""

    def accumulate(
        self, data: ComplexArray, order: npt.NDArray[np.int64], survey: Survey, reader: Any, scale: float, raster: Raster,
        trigonometry: Trigonometry, real: npt.DTypeLike, batch: int, image: ComplexArray, threads: int,
        progress: Callable[[float], None] | None,
    ) -> Totals:  # fmt: skip
        """Add traces `order` (flat ping-channel numbers; record i of survey.trace is order[i]) of `data` to `image` (line,
        pixel), which is left multiplied by `scale`."""

    def read(
        self, held: ComplexArray, grid: PolarGrid, taps: Taps, wave: float, carrier: Trigonometry, raster: Raster,
        image: ComplexArray, threads: int,
    ) -> None:  # fmt: skip
        """Add a sub-image, `held` (ray, node) as it was summed, at the pixels of raster.tiles() to `image` (line, pixel).

        `held` is overwritten; `wave` : turns of the carrier a metre of range; `carrier` : sine and cosine for them.
        """


AnyEngine = Planning | Parts
