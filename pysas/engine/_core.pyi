"""What the C++ extension exports; a test compares this with the extension itself."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.engine.traces import Records

def compiler() -> str:
    """Name and version of the compiler that built this extension."""

def levels() -> list[str]:
    """Instruction sets this build has and this machine runs, worst first."""

def sizes() -> dict[str, int]:
    """Pixels of a `block` and `rows` of a tile, at most."""

def isa(name: str) -> str:
    """The instruction set that `name` stands for; "auto" is the best. ValueError for one that is not in `levels`."""

def stop_others() -> None:
    """The interpreter ends in this thread: sums in others are to stop."""

def keep_others() -> None:
    """From now on the other threads do not come back to it."""

def away() -> int:
    """Threads outside the interpreter that may still come back."""

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

def design(band: float, degree: int, phases: int, step: int, error: float, least: int, most: int) -> Filter:
    """A filter, with its measured error; see csrc/core/filters.hpp."""

def arcs(
    trace: Records,
    channels: int,
    beam: Records,
    points: npt.NDArray[np.float64],
    order: npt.NDArray[np.int64],
    out: npt.NDArray[Any],
    threads: int,
    tick: Callable[[float], object] | None,
) -> npt.NDArray[np.uint64]:
    """Arcs of view angle that traces `order` stand for at points, in `out` (point or more, trace); the views' patterns.

    See csrc/core/arcs.hpp.
    """

class Survey:
    """Traces about an image's centre, what they weigh, and what they have in common: `model`, half the bandwidth in cycles per
    sample, whether samples are complex64, traces of a ping, whether every pixel has its own weights uniform in view angle."""

    def __init__(
        self,
        trace: Records,
        weights: npt.NDArray[np.complex128],
        model: Records,
        band: float,
        single: bool,
        channels: int,
        each: bool,
    ) -> None: ...
    def give_lattice(self, value: npt.NDArray[np.float32], axes: npt.NDArray[np.float64], vector: float, beyond: float) -> None:
        """Weights that change from pixel to pixel: see planning.view_angles.Lattice. `value` is read where it lies."""

class Pixels:
    """Lines about the image's centre `origin`, how far off them pixels lie at most, m; coordinates of all pixels, as a list
    (n, 3), as x, y and heights (y, x) of a map, or told by their numbers about the origin; the mask of those wanted; first and
    last trace (row, 2) that rows of points hear, if not all."""

    def __init__(
        self,
        height: int,
        width: int,
        origin: npt.NDArray[np.float64],
        first: npt.NDArray[np.float64] | None,
        step: npt.NDArray[np.float64] | None,
        uneven: float,
        points: npt.NDArray[np.float64]
        | tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]
        | Callable[[npt.NDArray[np.int64]], npt.NDArray[np.float64]],
        mask: npt.NDArray[np.bool_] | None,
        hears: npt.NDArray[np.int64] | None = None,
    ) -> None: ...

class Scene:
    """What a planner sees of a survey and pixels in a box."""

    def __init__(self, survey: Survey, pixels: Pixels, low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]) -> None: ...

class Done:
    """What became of some data, and the plan that was carried out; see interface.Done."""

    @property
    def choices(self) -> dict[str, Any]: ...
    @property
    def share(self) -> float: ...
    @property
    def trees(self) -> int: ...
    @property
    def why_direct(self) -> str: ...
    @property
    def prepare_seconds(self) -> float: ...
    @property
    def sum_seconds(self) -> float: ...
    @property
    def terms(self) -> int: ...
    @property
    def left_out(self) -> list[int]: ...
    @property
    def used(self) -> int: ...
    @property
    def beside(self) -> float: ...
    @property
    def lost(self) -> float: ...
    @property
    def loudest(self) -> int: ...

class Plan:
    """How to image data of a scene; see interface.Planned.

    `leave` : whether trees may be left for data that are too bright for them; `pay` : whether they must take less time than
    direct sums to be used. ValueError where `tol` cannot be kept, or where without `fallback` not all terms go through trees.
    """

    def __init__(
        self,
        scene: Scene,
        tol: float,
        budget: float,
        method: str,
        fallback: bool,
        leave: bool,
        pay: bool,
        threads: int,
        isa: str,
    ) -> None: ...
    @property
    def choices(self) -> dict[str, Any]: ...
    @property
    def share(self) -> float: ...
    @property
    def trees(self) -> int: ...
    @property
    def why_direct(self) -> str: ...
    @property
    def isa(self) -> str: ...
    @property
    def seconds(self) -> float: ...
    @property
    def memory(self) -> int: ...
    def describe(self, shape: str, more: int) -> str: ...
    def other(self) -> str: ...
    def follow(self, before: Plan) -> None: ...
    def __call__(
        self,
        data: npt.NDArray[Any],
        image: npt.NDArray[Any],
        whole: bool,
        tick: Callable[[float], object] | None,
    ) -> Done: ...
