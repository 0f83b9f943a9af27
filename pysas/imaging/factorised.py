"""Fast factorised back-projection: the sum of back-projection through sub-images of groups of traces.

`accumulate` carries out on the engine what planning/fallback laid out. docs/ffbp.md tells what bounds the error.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray
from pysas.engine.survey import Totals
from pysas.imaging.interpreted import Interpreted
from pysas.planning import bounds
from pysas.planning.fallback.trees import Forest
from pysas.planning.raster import Raster

Tick = Callable[[float], None] | None
Add = Callable[[npt.NDArray[np.int64], Raster, ComplexArray, Tick], Totals]


def accumulate(
    plan: Interpreted, forest: Forest, used: npt.NDArray[np.bool_], add: Add, image: ComplexArray, progress: Tick
) -> Totals:
    """Add all traces `used` to `image` (line, pixel): group by group to a polar grid for each plane, which is then read, and
    directly to the tiles that are not. `add` sums some traces on a raster."""
    wave, carrier, raster = 2 * plan.scene.fc / plan.scene.c, bounds.trigonometry(6)[0], forest.tiles.raster
    totals, step = Totals(0.0, 0.0, 0), 1 / len(forest.groups)
    for number, group in enumerate(forest.groups):
        order = group.order[used[group.order]]
        if not order.size:
            continue

        def tick(share: float, begin: float = number * step) -> None:
            if progress is not None:
                progress(begin + share * step)

        for sub in group.sub_images:
            held = np.zeros(sub.grid.shape, dtype=np.complex64)
            nodes = raster.along(sub.grid.lines(), sub.grid.shape[1], forest.block).of(sub.nodes)
            totals = totals.more(add(order, nodes, held, tick), order.size * forest.pixels(sub.tiles))
            clock = time.perf_counter()
            plan.engine.read(held, sub.grid, forest.taps, wave, carrier, raster.of(sub.tiles), image, plan.threads)
            totals = totals.more(Totals(0.0, time.perf_counter() - clock, 0))
        if group.direct.any():
            totals = totals.more(add(order, raster.of(group.direct), image, tick))
    return totals
