"""The steps of fast factorised back-projection, as an engine offers them: tables, leaves, merge, read, direct sums.

See docs/ffbp.md. Tasks own what they write and every sum has one order: the image is the same for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.engine.survey import Survey, Trigonometry
from pysas.engine.tree import SubImages, Taps

BoolArray = npt.NDArray[np.bool_]
Single = npt.NDArray[np.float32]
Tick = Callable[[float], None] | None
Lines = tuple[FloatArray, FloatArray]  # first pixel and step of each


@dataclass(frozen=True)
class Setting:
    """What all steps share: taps, turns of the carrier a metre of range, sine and cosine of the sums and of the tree."""

    taps: Taps
    wave: float
    trigonometry: Trigonometry
    carrier: Trigonometry
    threads: int
    isa: str


class Steps(Protocol):
    """What trees are summed by; tables of at most as many traces at a time as it was made for."""

    def prepare(self, traces: ComplexArray, part: npt.NDArray[np.int64], survey: Survey, kept: BoolArray, scale: float) -> None:
        """Tables of traces `part`, zeros for those not `kept`."""

    def leaves(self, survey: Survey, level: SubImages, store: Single, slack: float, smooth: bool, tick: Tick) -> None:
        """Sums of the prepared traces at leaves' nodes, filtered across, and along where `smooth`.

        Phase factors may be wrong by `slack`.
        """

    def merge(
        self, children: SubImages, below: Single, parent: SubImages, store: Single, add: bool, last: bool, top: bool
    ) -> None:
        """A parent from some of its children; `last`: filtered across; `top`: filtered along."""

    def read(
        self, top: SubImages, store: Single, lines: Lines, mask: BoolArray | None, count: int, tiles: BoolArray,
        image: ComplexArray,
    ) -> None:  # fmt: skip
        """Add a sub-image at the pixels of `tiles`, of lines on its plane."""

    def direct(self, survey: Survey, lines: Lines, pixels: BoolArray, count: int, image: ComplexArray, tick: Tick) -> int:
        """Add the prepared traces at `pixels` of lines; how many terms."""
