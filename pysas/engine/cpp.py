"""The engine in C++; see interface.py."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine import native
from pysas.engine.interface import Places, Planned, Planning
from pysas.engine.traces import MODEL, Records, record

# For tests to change: whether trees must take less time than direct sums to be used, and whether they may be left for data that
# are too bright for them though direct sums must not stand in for them.
TREES_MUST_PAY, TREES_MAY_GO = True, False


class Cpp:
    """Kernels for several instruction sets, of which the best runs that the machine has."""

    name = "cpp"

    def isa(self) -> str:
        return native.isa_name()

    def arcs(
        self, trace: Records, channels: int, beam: Records, points: FloatArray, order: npt.NDArray[np.int64],
        out: npt.NDArray[Any], threads: int,
    ) -> npt.NDArray[np.uint64]:  # fmt: skip
        return np.asarray(native.core().arcs(trace, channels, beam, points, order, out, threads, None))

    def plan(
        self, scene: Any, shape: tuple[int, ...], mask: npt.NDArray[np.bool_] | None,
        points: Places, tol: float, budget: float, method: str, fallback: bool, threads: int,
    ) -> Planned:  # fmt: skip
        core = native.core()
        model = record(
            MODEL, c=scene.c, fc=scene.fc, fs=scene.fs, rate=0.0, last=scene.n_sample - 1, beam=scene.beam, near=0.0,
            run=0.0,
        )  # fmt: skip
        single = scene.dtype == np.complex64
        survey = core.Survey(scene.trace, scene.weights, model, scene.band, single, scene.channels, scene.each)
        if scene.lattice is not None:
            lattice = scene.lattice
            survey.give_lattice(lattice.value, lattice.axes, lattice.vector, lattice.beyond)
        first = step = None
        uneven = 0.0
        if scene.lines is not None:
            first, step, uneven = np.ascontiguousarray(scene.lines[0] - scene.origin), scene.lines[1], scene.lines[2]
        wanted = None if mask is None else np.ascontiguousarray(mask)
        pixels = core.Pixels(math.prod(shape[:-1]), shape[-1], scene.origin, first, step, uneven, points, wanted, scene.hears)
        seen = core.Scene(survey, pixels, scene.low, scene.high)
        leave = fallback or TREES_MAY_GO
        found: Planned = core.Plan(seen, tol, budget, method, fallback, leave, TREES_MUST_PAY, threads, self.isa())
        return found


ENGINE: Planning = Cpp()
