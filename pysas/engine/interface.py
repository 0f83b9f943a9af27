"""What an engine offers: all that planning and imaging know of one. Nothing outside this folder asks for its name to decide."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine.steps import Setting, Steps
from pysas.engine.survey import Raster, Survey, Totals, Trigonometry
from pysas.engine.traces import Records
from pysas.engine.tree import IntArray, SubImages

Subtrees = Callable[..., tuple[IntArray, tuple[SubImages, ...], float] | None]


class Engine(Protocol):
    """Sums of back-projection and steps of trees, and what they are made for.

    name : as `backend` has it; nodes : of delay polynomials, by precision; sines : numbers of terms of sine and cosine to
    choose from, by precision; polynomials : precisions in which delays may be polynomials; sums : float sums that a term goes
    through; filters : whether tables are made by short filters, or else by transforms; slab : points whose delays are exact
    that are looked at at a time, or 0; subtree : makes the tree below a group as `subtrees.make` does, or None.
    """

    name: str
    polynomials: Collection[str]
    sums: int
    filters: bool
    slab: int
    subtree: Subtrees | None

    @property
    def nodes(self) -> Mapping[str, int]: ...

    @property
    def sines(self) -> Mapping[str, Sequence[int]]: ...

    def isa(self) -> str:
        """What kernels run on: an instruction set, or a processor's name."""

    def costs(self) -> str:
        """Which row of a table of costs is this engine's."""

    def peaks(self, data: ComplexArray, begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64], threads: int) -> FloatArray:
        """Largest |real| or |imaginary| part of samples [begin, end) of each trace, (ping, channel); not finite where the
        trace is not, within or without them."""

    def mean_squares(
        self, data: ComplexArray, trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64], reach: int, scale: float,
        threads: int,
    ) -> FloatArray:  # fmt: skip
        """Mean squares of the 2 reach + 1 samples about places of (ping, channel, sample), in units of scale^2; 0 off
        records."""

    def arcs(
        self, trace: Records, channels: int, cos_beam: float, points: FloatArray, order: npt.NDArray[np.int64],
        out: npt.NDArray[Any], threads: int,
    ) -> npt.NDArray[np.uint64]:  # fmt: skip
        """Fill `out` (point, kept) with the arcs of traces `order` among all at points about the scene's centre.

        Their mean over the traces within whose beam a point lies is 1; the others' arcs are what they would be there. Rows
        of `out` beyond the points stay. Returns a number for each point that is the same where views have one order around
        the circle, one grouping and one set of openings, so that arcs are smooth from place to place; 0 where a view has no
        angle or a gap is about as wide as makes an opening. O(point trace log trace).
        """

    def accumulate(
        self, data: ComplexArray, order: npt.NDArray[np.int64], survey: Survey, reader: Any, scale: float, raster: Raster,
        trigonometry: Trigonometry, real: npt.DTypeLike, batch: int, image: ComplexArray, threads: int,
        progress: Callable[[float], None] | None,
    ) -> Totals:  # fmt: skip
        """Add traces `order` (flat ping-channel numbers; record i of survey.trace is order[i]) of `data` to `image` (line,
        pixel), which is left multiplied by `scale`."""

    def steps(self, setting: Setting, reader: Any, room: int) -> Steps:
        """The steps of trees, with tables of at most `room` traces at a time."""
