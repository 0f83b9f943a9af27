"""What things cost: rough times of the engines' parts, ns on one thread, by which the planner compares its options."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pysas.engine import native
from pysas.scene import Scene

if TYPE_CHECKING:
    from pysas.plans import Choices

# ns of one thread beside others: a term, each of its coefficients, a line of a block for each trace, a term with its own
# exact delay, each of its coefficients; Numba's coefficients by pairs, and for their table's size in the cache
COST_NS = {
    "avx512": (0.35, 0.06, 8.0, 2.7, 0.12),
    "avx2": (0.5, 0.085, 9.5, 4.0, 0.35),
    "baseline": (3.7, 0.4, 45.0, 18.0, 1.4),
    "numba": (2.0, 0.1, 45.0, 5.0, 0.1),
}
LANES = {"avx512": 16, "avx2": 8, "baseline": 8}  # of a vector of float32
CACHE_NS, PREPARE_NS = 0.02, 9.6  # Numba's: per over-sampling and coefficient; a coefficient of the preparation
FILTER_NS = 0.05  # a tap of a filter's coefficient


def term_ns(scene: Scene, backend: str, precision: str, block: int, near: float, degree: int, oversampling: float) -> float:
    """Predicted cost of a term, ns, the mean of those with a block's delay polynomial and those nearer than `near`."""
    wide = 1.0 if precision == "float32" else 2.0
    term, coefficient, line, exact, gathered = COST_NS[native.isa_name() if backend == "cpp" else backend]
    own = wide * (exact + gathered * (degree + 1))
    if not block:
        return own
    each = coefficient * (degree + 1)
    if backend == "numba":
        padded = 1.0
        each += CACHE_NS * oversampling * (degree + 1)
    else:
        lanes = LANES[native.isa_name()] / wide
        padded = math.ceil(block / lanes) * lanes / block
        # intervals that a vector of pixels spans: beyond one register's worth a coefficient takes more permutes
        span = lanes * scene.step * scene.slope * 2 * scene.fs / scene.c * oversampling
        registers = 1 if span < lanes - 1 else 2 if span < 2 * lanes - 1 else 5
        each *= 1 + 0.3 * (registers - 1)
    share = scene.within(near)
    return share * own + (1 - share) * (wide * padded * (term + each) + line / block)


def prepare_seconds(scene: Scene, choices: Choices) -> float:
    """Predicted time of making all coefficients, on one thread."""
    c = choices
    made = c.length * c.oversampling * (1 + FILTER_NS * c.taps) if c.taps else PREPARE_NS * c.n_fine
    return int(np.count_nonzero(scene.heard)) * made * (c.degree + 1) * 1e-9


def sum_seconds(scene: Scene, choices: Choices, backend: str) -> float:
    """Predicted time of the direct sum, on one thread."""
    c = choices
    term = term_ns(scene, backend, c.precision, c.block, c.near, c.degree, c.oversampling)
    return int(np.count_nonzero(scene.heard)) * scene.pixels * term * 1e-9


# a tree, ns: a term of a leaf, a node of a leaf beside its terms, a node of a parent for each child, a pixel read; the last
# two with what each tap adds
TREE_NS = {
    "avx512": (0.65, 4.0, (1.0, 0.65), (6.0, 0.7)),
    "avx2": (0.9, 4.0, (1.5, 0.6), (6.5, 0.7)),
    "baseline": (4.8, 15.0, (8.0, 1.8), (15.0, 1.7)),
    "numba": (3.2, 10.0, (3.0, 1.4), (38.0, 2.0)),
}


# planning a tree, s: what it costs at least, the search for a layout included; it grows far slower than the sum
GROW_SECONDS = {"cpp": 0.02, "numba": 0.05}


def tree_ns(width: int, runs: str) -> tuple[float, float, float, float]:
    """Predicted cost of a leaf's term, of a leaf's node, of a parent's node a child, and of a pixel read, ns.

    `runs` is an instruction set or "numba".
    """
    term, node, merge, read = TREE_NS[runs]
    return term, node, merge[0] + merge[1] * width, read[0] + read[1] * width
