"""A plan of an engine that is planned here, in Python: its settings, trees and words. Carried out in summing.py."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import Parts
from pysas.engine.survey import rows_per_task
from pysas.model.grid import Grid
from pysas.planning import view_angles
from pysas.planning.fallback import planner
from pysas.planning.fallback.trees import Forest
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices, reader_of


@dataclass(frozen=True)
class Terms:
    """Some of a plan's terms: flat numbers of their traces, and the samples nearest to where pixels read them.

    power : what their beams leave of each, squared; heard, edges : all traces that pixels hear, and the least and the largest
    place (2, trace) that any pixel can read there.
    """

    trace: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]
    power: FloatArray
    heard: npt.NDArray[np.int64]
    edges: npt.NDArray[np.int64]


@dataclass
class Interpreted:
    """See plans.EnginePlan. `budget` : of tol, what choices were made for; `fallback` : whether trees may be left for data that
    are too bright for them."""

    scene: Scene
    grid: Grid
    tol: float
    budget: float
    method: str
    fallback: bool
    threads: int
    engine: Parts
    choices: Choices
    forest: Forest | None
    why_direct: str
    terms: Terms | None = None  # looked at when data arrive, see levels.py
    others: dict[str, Interpreted] = field(default_factory=dict)  # that take this one's place for some data

    def __post_init__(self) -> None:
        self.dtype = self.scene.dtype
        self.raster = Raster(self.grid, self.scene, self.choices.block) if self.forest is None else self.forest.tiles.raster
        self.reader = reader_of(self.choices)
        self.rule = planner.rule(self.method == "auto")

    @property
    def isa(self) -> str:
        return self.engine.isa()

    @property
    def share(self) -> float:
        return self.forest.share if self.forest is not None else 0.0

    @property
    def trees(self) -> int:
        return len(self.forest.sub_images) if self.forest is not None else 0

    @property
    def seconds(self) -> float:
        return planner.seconds(self.scene, self.choices, self.forest)

    def other(self) -> str:
        args = (self.scene, self.grid, self.budget, self.forest, self.engine, self.threads)
        return planner.other(*args)

    def describe(self) -> str:
        c, scene = self.choices, self.scene
        method = "ffbp" if self.forest is not None or self.method == "ffbp" else "backprojection"
        shape = " x ".join(map(str, self.grid.shape))
        delay = f"polynomials over {c.block} pixels, exact below {c.near:.3g} m" if c.block else "exact per pixel"
        kept = f"{c.length} of {scene.n_sample} samples" + (f", tapered over {c.taper}" if c.taper else "")
        return "\n".join(
            [
                f"Plan: {method} of {scene.traces} traces on {shape} pixels, tol {self.tol:g}",
                f"  backend        {self.engine.name}, {c.precision}, {self.threads} threads, batches of {c.batch} traces",
                f"  traces         {kept}, transforms of {c.n_fft} and {c.n_fine}",
                f"  interpolation  degree {c.degree} at {c.oversampling:.3g} x the sample rate",
                f"  delay          {c.delay}, {delay}",
                f"  terms          {scene.traces * scene.pixels:.4g} at most",
                *(self.forest.describe() if self.forest is not None else []),
                *([f"  rule           {self.rule}"] if self.rule else []),
                *([f"  direct sum     {self.why_direct}"] if self.why_direct else []),
                *(["  view angles    every pixel's own: views change their order over the image"] if scene.each else []),
                f"  predicted      error {c.predicted_error:.2g}, time {self.seconds / self.threads:.2g} s, "
                f"memory {self.memory / 2**20:.0f} MB beyond the input",
            ]
        )

    @property
    def wide(self) -> bool:
        """Whether the image is a sum of so many batches, or trees, that complex64 would round it too often."""
        c = self.choices
        rounds = -(-self.scene.traces // c.batch)
        if self.forest is not None:
            rounds += len(self.forest.groups)
        return bool(self.dtype == np.complex64 and rounds > c.run // 8)

    @property
    def memory(self) -> int:
        c, scene = self.choices, self.scene
        item = 8 if c.precision == "float32" else 16
        work = (16 * self.grid.size if self.wide else 0) + c.batch * c.length * c.oversampling * (c.degree + 1) * item
        if c.n_fft:
            work += self.threads * rows_per_task(c.n_fine) * (c.length + 2 * c.n_fft + 3 * c.n_fine) * item
        if not c.block:
            work += 24 * min(self.engine.slab, self.grid.size)
        if self.forest is not None:
            work += self.forest.store_bytes
        if scene.lattice is not None:
            work += scene.lattice.value.nbytes
        if scene.each:
            work += min(view_angles.BYTES, self.scene.pixels * self.scene.traces * item // 2)
        return int(self.grid.size * self.dtype.itemsize + work)
