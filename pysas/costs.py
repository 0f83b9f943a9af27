"""What things cost: rough times of the engines' parts, ns on one thread, by which the planner compares its options."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pysas.engine import native
from pysas.scene import Scene

if TYPE_CHECKING:
    from pysas.plans import Choices

# Numba's cost model, ns: a term, its coefficient pairs, its table's size in the cache (per over-sampling and coefficient), one
# coefficient of the preparation; a term with its own exact delay
TERM_NS, PAIR_NS, CACHE_NS, PREPARE_NS, EXACT_NS = 2.6, 0.2, 0.02, 9.6, 8.0
# that of C++: lanes, then ns of a term, of one of its coefficients, of a term with its own exact delay, by instruction set
NATIVE_NS = {
    "avx512": (16, 0.35, 0.06, 2.5),
    "avx2": (8, 0.6, 0.085, 4.0),
    "baseline": (8, 2.6, 0.3, 8.0),
}
FILTER_NS = 0.05  # a tap of a filter's coefficient


def term_ns(block: int, degree: int, oversampling: float, backend: str, scene: Scene, precision: str) -> float:
    """Predicted cost of a term, ns."""
    if backend == "numba":
        base = TERM_NS if block else EXACT_NS
        return (base + PAIR_NS * (degree + 1) / 2 + CACHE_NS * oversampling * (degree + 1)) * (
            1 if precision == "float32" else 2
        )
    lanes, term, coefficient, exact = NATIVE_NS[native.isa_name()]
    wide = 1.0 if precision == "float32" else 2.0
    if not block:
        return wide * exact
    # intervals that a vector of pixels spans: beyond one register's worth a coefficient takes more permutes
    span = lanes / wide * scene.step * scene.slope * 2 * scene.fs / scene.c * oversampling
    registers = 1 if span < lanes / wide - 1 else 2 if span < 2 * lanes / wide - 1 else 5
    return wide * (term + coefficient * (degree + 1) * (1 + 0.3 * (registers - 1)))


def prepare_seconds(scene: Scene, choices: Choices) -> float:
    """Predicted time of making all coefficients, on one thread."""
    c = choices
    made = c.length * c.oversampling * (1 + FILTER_NS * c.taps) if c.taps else PREPARE_NS * c.n_fine
    return int(np.count_nonzero(scene.heard)) * made * (c.degree + 1) * 1e-9


def sum_seconds(scene: Scene, choices: Choices, backend: str) -> float:
    """Predicted time of the direct sum, on one thread."""
    c = choices
    term = term_ns(c.block, c.degree, c.oversampling, backend, scene, c.precision)
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
