"""What a plan of the Numba engine asks: settings, trees or why there are none, rough times. See imaging/plans.py."""

from __future__ import annotations

import numpy as np

from pysas._checks import InternalError
from pysas.engine import Parts
from pysas.model.grid import Grid
from pysas.planning.fallback import settings, trees
from pysas.planning.fallback.trees import Forest
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

TERMS = 2**26  # of an image, from which "auto" takes trees
RULE = f"trees from {TERMS:.2g} terms on, if they serve half of them, by half as many sums at their nodes"
# rough times, ns: a term and a coefficient of the direct sum, a pixel read, a pixel's own view-angle weight
TERM_NS, COEFFICIENT_NS, READ_NS, ARC_NS = 3.5, 9.6, 70.0, 60.0

choose, for_leaves = settings.choose, trees.choose


def rule(auto: bool) -> str:
    """What decides between the engines."""
    return RULE if auto else ""


def make_trees(
    scene: Scene, grid: Grid, tol: float, engine: Parts, fallback: bool, auto: bool
) -> tuple[Forest | None, str]:  # fmt: skip
    """Trees, or None and why all is summed directly; an error where that is forbidden, of any terms.

    `auto` : where `RULE` has them.
    """
    if auto and scene.traces * scene.pixels < TERMS:
        return None, trees.LONGER
    forest, why = trees.lay_out(scene, grid, tol, engine, not fallback)
    if forest is not None and auto and (forest.share < 0.5 or forest.summed > forest.terms / 2):
        return None, trees.LONGER
    if forest is None and not fallback:
        raise ValueError(f"fallback=False, tol={tol:g}: expected all terms to go through the tree, found: {why}")
    return forest, why


def other(scene: Scene, grid: Grid, tol: float, forest: Forest | None, engine: Parts, threads: int) -> str:
    """The engine that a plan does not use: its rough time, or why it cannot be."""
    if forest is not None:
        return f"backprojection: {seconds(scene, choose(scene, tol, engine), None) / threads:.2g} s predicted"
    try:
        forest, why = trees.lay_out(scene, grid, tol, engine, False)
    except InternalError as error:
        why = f"no trees: {error}"
    if forest is not None:
        why = f"trees over {len(forest.groups)} groups of pings would serve {100 * forest.share:.3g} % of the terms"
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
        total += TERM_NS * forest.summed + READ_NS * forest.reads
    return 1e-9 * total
