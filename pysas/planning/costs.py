"""What things cost: rough times of the engines' parts, ns on one thread, by which the planner compares its options."""

from __future__ import annotations

import math

import numpy as np

from pysas.engine import Engine
from pysas.planning.forest import Forest
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

# ns of one thread beside others: a term, each of its coefficients, a line of a block for each trace, a term with its own
# exact delay, each of its coefficients; Numba's coefficients by pairs, and for their table's size in the cache
COST_NS = {
    "avx512": (0.35, 0.06, 8.0, 2.7, 0.12),
    "avx2": (0.5, 0.085, 9.5, 3.3, 0.1),
    "baseline": (3.7, 0.4, 45.0, 18.0, 1.4),
    "numba": (2.0, 0.1, 45.0, 5.0, 0.1),
}
LANES = {"avx512": 16, "avx2": 8, "baseline": 8}  # of a vector of float32
# registers that may hold what a vector of pixels reads, with the cost of a coefficient in times that of one; the last: gathers
WINDOWS = {
    "avx512": ((1, 1.0), (2, 1.3), (4, 2.0), (math.inf, 8.0)),
    "avx2": ((1, 1.0), (2, 2.2), (math.inf, 6.5)),
    "baseline": ((math.inf, 1.0),),
}
CACHE_NS, PREPARE_NS = 0.02, 9.6  # Numba's: per over-sampling and coefficient; a coefficient of the preparation
# C++: a coefficient, what a tap of its filter adds, a point of the transforms before
COEFFICIENT_NS, FILTER_NS, TRANSFORM_NS = 1.2, 0.05, 5.5


def term_ns(
    scene: Scene, runs: str, precision: str, block: int, near: float, degree: int, oversampling: float, part: float = 1.0
) -> float:
    """Predicted cost of a term, ns, the mean of those with a block's delay polynomial and those nearer than `near`.

    `runs` : the row of the tables here; `part` : of all terms, where the farthest are not summed.
    """
    wide = 1.0 if precision == "float32" else 2.0
    term, coefficient, line, exact, gathered = COST_NS[runs]
    own = wide * (exact + gathered * (degree + 1))
    if not block:
        return own
    each = coefficient * (degree + 1)
    if runs not in LANES:  # its vectors are the compiler's
        padded = 1.0
        each += CACHE_NS * oversampling * (degree + 1)
    else:
        lanes = LANES[runs] / wide
        padded = math.ceil(block / lanes) * lanes / block
        # intervals that a vector of pixels spans, broadside to it
        span = lanes * scene.step * 2 * scene.fs / scene.c * oversampling
        before = mean = 0.0
        for registers, times in WINDOWS[runs]:
            below = 1.0 if math.isinf(registers) else scene.flatter((registers * lanes - 1) / max(span, 1e-9))
            mean += (below - before) * times
            before = below
        each *= mean
    # lines of which any pixel is that near
    share = min(1.0, scene.within(near + block * scene.step / 2) / part)
    return share * own + (1 - share) * (wide * padded * (term + each) + line / block)


def prepare_seconds(scene: Scene, choices: Choices, traces: int | None = None) -> float:
    """Predicted time of making all coefficients, of `traces` traces (default: all heard), on one thread."""
    c = choices
    if c.taps:
        made = c.length * c.oversampling * (c.degree + 1) * (COEFFICIENT_NS + FILTER_NS * c.taps)
        made += TRANSFORM_NS * (c.n_fft + c.n_fine)
    else:
        made = c.n_fine * (c.degree + 1) * PREPARE_NS
    return (int(np.count_nonzero(scene.heard)) if traces is None else traces) * made * 1e-9


def sum_seconds(scene: Scene, choices: Choices, runs: str, part: float = 1.0) -> float:
    """Predicted time of the direct sum, on one thread; of `part` of its terms, the nearest."""
    if part <= 0:
        return 0.0
    c = choices
    term = term_ns(scene, runs, c.precision, c.block, c.near, c.degree, c.oversampling, part)
    return part * scene.lit * scene.traces * scene.pixels * term * 1e-9


# a tree, ns: a term of a leaf, a node of a leaf beside its terms, a node of a parent for each child, a pixel read; the last
# two with what each tap adds
TREE_NS = {
    "avx512": (0.65, 4.0, (1.0, 0.65), (6.0, 0.7)),
    "avx2": (0.9, 4.0, (1.5, 0.6), (6.5, 0.7)),
    "baseline": (4.8, 15.0, (8.0, 1.8), (15.0, 1.7)),
    "numba": (3.2, 10.0, (3.0, 1.4), (38.0, 2.0)),
}


RELIEF = 2.0  # times as long as from their plane: pixels read off it

# s: of a tree that threads do not share, its planning included where an engine has a way of its own for that
TREE_SECONDS = 0.003


def plan_seconds(engine: Engine) -> float:
    """Of planning any trees at all, s."""
    return 0.003 if engine.subtree is not None else 0.1


def tree_ns(width: int, runs: str) -> tuple[float, float, float, float]:
    """Predicted cost of a leaf's term, of a leaf's node, of a parent's node a child, and of a pixel read, ns.

    `runs` : the row of the table.
    """
    term, node, merge, read = TREE_NS[runs]
    return term, node, merge[0] + merge[1] * width, read[0] + read[1] * width


def forest_seconds(forest: Forest, runs: str) -> float:
    """Predicted time of trees that are grown, of the direct sum of what they leave, and of preparation, on one thread."""
    work, c = forest.work(), forest.choices
    term, node, merge, read = tree_ns(forest.layout.taps.width, runs)
    read *= 1.0 if all(section.flat for section in forest.sections) else RELIEF
    trees = work.leaf_terms * term + work.leaf_nodes * node + work.merged * merge + work.read * read
    rest = sum_seconds(forest.scene, c, runs, 1 - forest.share)
    return trees * 1e-9 + rest + prepare_seconds(forest.scene, c, work.traces)
