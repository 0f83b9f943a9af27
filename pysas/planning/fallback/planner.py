"""What a plan of the Numba engine asks: settings, trees or why there are none, rough times. See imaging/plans.py."""

from __future__ import annotations

import itertools

import numpy as np

from pysas._checks import InternalError
from pysas.engine import Parts
from pysas.model.grid import Grid
from pysas.planning.fallback import settings, trees
from pysas.planning.fallback.trees import LONGER, Forest
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

TERMS, TRACES = 2**26, 128  # of an image, and of each of its trees, from which "auto" takes trees
RULE = f"trees from {TERMS:.2g} terms on, if they serve half of them and each has {TRACES} traces or more"
# rough times, ns: a term and a coefficient of the direct sum; a leaf's term, a node of a parent for each child, a pixel read
TERM_NS, COEFFICIENT_NS, LEAF_NS, MERGE_NS, READ_NS, ARC_NS = 2.8, 9.6, 3.2, 12.0, 50.0, 60.0

choose = settings.choose


def rule(auto: bool) -> str:
    """What decides between the engines."""
    return RULE if auto else ""


def for_leaves(scene: Scene, tol: float, engine: Parts, wide: float) -> Choices | None:
    """Settings of the leaves of trees within `tol`, and of what is summed directly beside them."""
    return settings.choose(scene, trees.LEAVES * tol, engine, wide, leaves=True)


def make_trees(
    scene: Scene, grid: Grid, tol: float, engine: Parts, fallback: bool, auto: bool
) -> tuple[Forest | None, str]:  # fmt: skip
    """Trees, or None and why all is summed directly; an error where that is forbidden, of any terms.

    `auto` : where `RULE` has them.
    """
    if auto and scene.traces * scene.pixels < TERMS:
        return None, LONGER
    placed, why = trees.lay_out(scene, grid, tol, engine, not fallback)
    if placed is not None and auto and (placed.share < 0.5 or scene.traces < TRACES * len(placed.pieces)):
        return None, LONGER
    forest = None
    if placed is not None:
        forest = trees.make_forest(scene, placed, tol, engine)
        why = "" if forest is not None else LONGER
    if forest is None and not fallback:
        raise ValueError(f"fallback=False, tol={tol:g}: expected all terms to go through the tree, found: {why}")
    return forest, why


def other(scene: Scene, grid: Grid, tol: float, forest: Forest | None, engine: Parts, threads: int) -> str:
    """The engine that a plan does not use: its rough time, or why it cannot be."""
    if forest is not None:
        return f"backprojection: {seconds(scene, choose(scene, tol, engine), None) / threads:.2g} s predicted"
    try:
        placed, why = trees.lay_out(scene, grid, tol, engine, False)
    except InternalError as error:
        placed, why = None, f"no trees: {error}"
    if placed is not None:
        why = f"trees over {len(placed.pieces)} groups of pings would serve {100 * placed.share:.3g} % of the terms"
    return f"ffbp: {why}"


def seconds(scene: Scene, choices: Choices, forest: Forest | None) -> float:
    """Rough time of an image on one thread, s."""
    heard = int(np.count_nonzero(scene.heard))
    total = COEFFICIENT_NS * heard * choices.n_fine * (choices.degree + 1)
    share = 0.0 if forest is None else forest.share
    total += TERM_NS * (1 - share) * scene.lit * scene.traces * scene.pixels
    if scene.each:
        total += ARC_NS * scene.traces * scene.pixels
    if forest is not None:
        total += READ_NS * sum(int(section.pixels[t.read].sum()) for section in forest.sections for t in section.trees)
        for t in forest.trees:
            levels = t.subtree.levels if t.subtree is not None else ()
            total += sum(LEAF_NS * leaves.nodes * len(t.order) / len(leaves) for leaves in levels[:1])
            total += sum(MERGE_NS * above.nodes * len(below) / len(above) for below, above in itertools.pairwise(levels))
    return 1e-9 * total
