"""From `tol` to choices: the only module that knows how an error is bought with time; choices.py has the settings of one sum.

`plan` looks at the scene, leaves out what it does not need, takes the engine of the least predicted time with settings whose
error bounds sum to at most `tol`, and returns a `Plan` that images any data of the same geometry. `print(plan)` and
`plan.explain()` say what was chosen and why.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.engine import Engine, engine_of, tree
from pysas.imaging.execution import execute
from pysas.imaging.plans import Plan
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.planning import bounds, costs, layouts, view_angles
from pysas.planning.choices import (
    SHARE_LEAVES,
    SHARE_PHASE,
    SHARE_ROUNDING,
    choose,
    choose_delay,
    choose_for_leaves,
    even_split,
)
from pysas.planning.costs import forest_seconds, prepare_seconds, sum_seconds
from pysas.planning.forest import Forest, Layout, make_forest, served
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices
from pysas.planning.tiles import Section, sections

METHODS = ("auto", "backprojection", "ffbp")
SHARE_VIEWS = 0.04  # of tol, for weights uniform in view angle, where they are asked for
SHARE_LIT = 0.3  # of tol, at most, for what these change where views come in and go at beams' edges
SHARE_POSITIONS = 0.03  # of tol, for polynomials of positions in merges
SHARE_ENDS = 0.2  # of tol, for what records' ends ring with beyond the band of sub-images; it adds to these as squares do
SHARE_RELIEF = 0.2  # of tol, for pixels read off the planes of their sub-images, where any are
FARTHEST = 1e9  # wavelengths: beyond it sub-images have more nodes than memory holds, and float64 loses 1e-5 anyway
TREE_TOL = 3e-5  # below it float32 sub-images would round too much
# width, rate and half length of the filters that a tree may use, cheapest first
TAPS = (
    (6, 1.2, 8), (6, 1.3, 8), (6, 1.4, 8), (6, 1.45, 8), (6, 1.5, 8), (8, 1.4, 10), (8, 1.45, 10), (8, 1.5, 10), (8, 1.6, 10),
    (8, 1.75, 10),
)  # fmt: skip
SPARE = 1.05  # sampling beyond the band's own limit, which a short group's band overlaps a little
FINEST = 8  # nodes per sample, at most
LONGER = "a tree would take longer"
FANS = ((), (2,), (4,), (4, 2), (4, 4), (4, 4, 2), (4, 4, 4), (4, 4, 4, 2), (4, 4, 4, 4))
MOST_MERGES = max(map(len, FANS))


@_checks.usual_errors
def plan(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    method: str = "auto",
    threads: int | None = None,
    backend: str = "auto",
    weights: npt.ArrayLike | str | None = None,
    nan: str = "raise",
    fallback: bool = True,
) -> Plan:
    """Choose how to image any data of this geometry on `grid` with relative error `tol`.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed; its samples are not looked at here.
    grid : Grid
    tol : float
        Relative error: ||I - I_exact|| <= tol max(||I_exact||, ||R||) over the grid, R the incoherent level. complex64:
        1e-1 to 1e-5; complex128: down to max(1e-10, 1e-14 range/wavelength).
    method : {"auto", "backprojection", "ffbp"}
        "auto" is whichever has the least predicted time for one image, the planning of a tree included.
    threads : int, optional
        Default: PYSAS_NUM_THREADS, else all processors. The image does not depend on it.
    backend : {"auto", "numba", "cpp"}
    weights : (ping,) or (ping, channel) array_like, or "uniform-angle", optional
        As in `backproject`.
    nan : {"raise", "mask"}
        Traces that hold non-finite samples: an error, or left out of the sum.
    fallback : bool
        With "ffbp" (with "auto" they are): whether terms that cannot be factorised, or not within `tol`, are summed directly;
        an error otherwise, also where samples beside those that pixels read are too bright for trees, once data arrive.

    Returns
    -------
    Plan

    Raises
    ------
    ValueError, TypeError
        Raw echoes, under-sampled data, a `tol` that cannot be met (says what can), a wrong argument.

    Warns
    -----
    UserWarning
        No term can be summed, and why (recorded window, mask, weights): images will be zero.
    """
    return _plan(echoes, grid, tol, method, threads, backend, weights, nan, fallback)


@_checks.usual_errors
def plan_ahead(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    method: str = "auto",
    threads: int | None = None,
    backend: str = "auto",
    nan: str = "raise",
) -> Plan:
    """The `plan` of echoes, raw ones too, for what they will be when compressed.

    Compression changes samples alone: not their number, rate, type or band, nor the geometry, which is all that a plan is
    made from. The plan takes compressed data.
    """
    return _plan(echoes, grid, tol, method, threads, backend, nan=nan, raw=True)


def _plan(
    echoes: Echoes,
    grid: Grid,
    tol: float,
    method: str,
    threads: int | None,
    backend: str,
    weights: npt.ArrayLike | str | None = None,
    nan: str = "raise",
    fallback: bool = True,
    raw: bool = False,
) -> Plan:
    """`raw` : whether echoes may be raw as yet."""
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected pysas.Grid")
    _checks.choice("method", method, METHODS)
    _checks.choice("nan", nan, ("raise", "mask"))
    engine = engine_of(backend)
    if not (echoes.compressed or raw):
        raise ValueError("echoes: raw (compressed=False): expected range-compressed echoes, see pysas.compress")
    if echoes.fs < 1.1 * echoes.occupied_bandwidth * (1 - 1e-9):
        raise ValueError(
            f"echoes: fs={echoes.fs:g} Hz is {echoes.fs / echoes.occupied_bandwidth:.4g} x the bandwidth "
            f"{echoes.occupied_bandwidth:g} Hz: expected at least 1.1 x"
        )
    tol = _checks.number("tol", tol, positive=True)
    scene = Scene(echoes, grid, weights)
    _reachable(tol, echoes, scene)
    count = _checks.threads(threads)
    left = tol - _weigh(scene, grid, tol, method != "backprojection", count, engine)
    choices = choose(scene, left, engine)
    forest, why, fault = None, "", ""
    if method != "backprojection":
        auto = method == "auto"
        try:
            forest, why = _trees(scene, grid, left, choices, engine, fallback or auto, count, auto)
        except _checks.InternalError as error:  # no fault of the scene: there is always the direct sum
            if not (fallback or auto):
                raise
            why = fault = f"no trees: {error}"
    choices = choices if forest is None else forest.choices
    if scene.uniform:
        choices = dataclasses.replace(choices, errors=choices.errors | {"view angles": _views_error(scene)})
    chosen, why = ("ffbp", why) if method == "ffbp" or forest is not None else ("backprojection", fault)
    return Plan(
        echoes, grid, tol, scene if forest is None else forest.scene, choices, count, engine, nan, chosen, forest, why, left,
        fallback or method != "ffbp", execute, other_engine,
    )  # fmt: skip


def other_engine(plan: Plan) -> str:
    """The engine that a plan does not use: its predicted time, or why it cannot be."""
    scene = plan.scene
    left = plan.tol - _views_error(scene)
    if plan.forest is not None:
        choices = choose(scene, left, plan.engine)
        seconds = _direct_seconds(scene, choices, plan.engine)
        return f"backprojection: {seconds / plan.threads:.2g} s predicted"
    try:
        candidate, why = _candidate(scene, plan.grid, left, plan.engine, sum_seconds(scene, plan.choices, plan.engine.costs()))
    except _checks.InternalError as error:
        candidate, why = None, f"no trees: {error}"
    if candidate is not None:
        shared = candidate.seconds + prepare_seconds(scene, plan.choices)
        seconds = shared / plan.threads + candidate.trees * costs.TREE_SECONDS
        why = f"{seconds:.2g} s predicted"
    return f"ffbp: {why}"


def _weigh(scene: Scene, grid: Grid, tol: float, tree: bool, threads: int, engine: Engine) -> float:
    """Give a scene its weights uniform in view angle, if it asks for them; what error they bring."""
    if not scene.uniform or scene.why_empty():
        return 0.0
    for node in (_node(scene), 0.0) if tree else (0.0,):  # those of sub-images also lie around the image
        stretch = (view_angles.LONGEST - 1) * max(scene.step, node)
        scene.lattice = view_angles.lattice(
            scene, grid, SHARE_VIEWS * tol, _beyond(node), stretch, threads, engine, SHARE_LIT * tol
        )
        if scene.lattice is not None:
            break
    if scene.lattice is None:
        scene.each, scene.lines = True, None
    return _views_error(scene)


def _views_error(scene: Scene) -> float:
    """What weights uniform in view angle are wrong by: a lattice's error, or the rounding of arcs."""
    if scene.lattice is not None:
        return float(scene.lattice.error)
    return 2.0**-24 if scene.each and scene.dtype == np.complex64 else 0.0


def _beyond(node: float) -> float:
    """How far around an image its sub-images' nodes are, m."""
    return view_angles.LONGEST * node


def _node(scene: Scene) -> float:
    """From one node of a sub-image's ray to the next at most, m."""
    return scene.c / (4 * scene.band * scene.fs)


def _reachable(tol: float, echoes: Echoes, scene: Scene) -> None:
    if tol > 0.1:
        raise ValueError(f"tol={tol:g}: expected at most 0.1")
    # of the carrier's phase, or of the place in a record whose band is wider than its carrier is high
    float64 = 1e-14 * scene.farthest * max(echoes.fc, echoes.occupied_bandwidth) / echoes.c
    least = max(1e-5 if echoes.dtype == np.complex64 else 1e-10, float64)
    if not tol >= least * (1 - 1e-9):
        hint = f"; complex128 data reach {max(1e-10, float64):.3g}" if least > float64 and least == 1e-5 else ""
        raise ValueError(f"tol={tol:g}: {echoes.dtype} data over {scene.farthest:.4g} m reach {least:.3g} at best{hint}")


@dataclass(frozen=True)
class _Candidate:
    """Where trees could stand: the best layout and what sums cost with it on one thread, before any tree is made."""

    raster: Raster
    image: list[Section]
    layout: Layout
    near: float
    share: float
    relief: float
    height: float
    seconds: float
    trees: int


def _trees(
    scene: Scene, grid: Grid, tol: float, choices: Choices, engine: Engine, fallback: bool, threads: int, auto: bool
) -> tuple[Forest | None, str]:
    """A tree for each of the longest groups, or None and why all is summed directly, as `choices` say; an error where that is
    forbidden.

    `auto` : planning the trees counts beside their sums.
    """
    direct = sum_seconds(scene, choices, engine.costs())
    most = _direct_seconds(scene, choices, engine) if fallback else math.inf
    forest = None
    planning = threads * costs.plan_seconds(engine) if auto else 0.0
    if most <= 3 * planning:  # looking for a layout alone takes about as long
        return None, LONGER
    candidate, why = _candidate(scene, grid, tol, engine, direct, most - planning)
    alone = threads * costs.TREE_SECONDS
    if candidate is not None and candidate.seconds + alone * candidate.trees > most - planning:
        return None, LONGER
    if candidate is not None:
        forest, why = _make_forest(scene, candidate, tol, engine, not fallback, (most - planning) / max(alone, 1e-9))
    if forest is not None:
        forest.seconds += alone * len(forest.trees)
        if forest.seconds > most:
            return None, LONGER
    if not fallback and (forest is None or forest.share < 1):
        if forest is not None:
            near = "pixels near the track or across the ends of records or beams"
            why = f"{100 * (1 - forest.share):.3g} % of the terms, {near}"
        raise ValueError(f"fallback=False, tol={tol:g}: expected all terms to go through the tree, found: {why}")
    return forest, why


def _direct_seconds(scene: Scene, choices: Choices, engine: Engine) -> float:
    return sum_seconds(scene, choices, engine.costs()) + prepare_seconds(scene, choices)


def _candidate(
    scene: Scene, grid: Grid, tol: float, engine: Engine, direct: float, most: float = math.inf
) -> tuple[_Candidate | None, str]:  # fmt: skip
    """The cheapest layout that keeps tol, or why there is none within `most` s.

    `direct` : of a sum of all terms without trees, s.
    """
    if tol < TREE_TOL * (1 - 1e-9):
        return None, f"tol below {TREE_TOL:g}"
    if scene.farthest > FARTHEST * scene.c / scene.fc:
        return None, f"range beyond {FARTHEST:g} wavelengths"
    if not scene.heard.any():
        return None, "the grid lies outside the recorded window"
    if scene.each:
        return None, "view-angle weights are every pixel's own: views change their order over the image"
    if scene.lattice is not None and scene.lattice.beyond < _beyond(_node(scene)):
        return None, "views change their order around the image"
    if scene.lattice is not None and not scene.lattice.holds(_node(scene), view_angles.LONGEST):
        return None, "view-angle weights change fast along the rays of sub-images"
    share = SHARE_LEAVES * tol
    block, near = 0, 0.0
    if scene.lines is not None:
        block, near, _ = choose_delay(scene, share, engine, "float32", SHARE_ROUNDING, whole=True)
        if not block:
            return None, "pixels too coarse for float32 blocks"
        block = even_split(scene.line_length, block)
    heights = np.concatenate([scene.trace[name][scene.heard, 2] for name in ("tx", "rx")])
    height = float(max(heights.max() - scene.bottom, scene.top - heights.min()))
    raster = Raster(grid, scene, block, rows=True)
    image = sections(raster)
    relief = 0.0 if all(section.flat for section in image) else SHARE_RELIEF * tol
    kinds: list[tuple[tuple[int, ...], tree.Taps]] = []
    for fans in FANS:
        for width, rate, half in TAPS:
            taps = tree.taps(width, rate, half)
            if (
                math.hypot(bounds.tree_error(taps, len(fans) + 1), SHARE_ENDS * tol)
                <= tol * (1 - SHARE_POSITIONS) - share - relief
            ):
                kinds.append((fans, taps))
                break
    if not kinds:
        return None, "no interpolation keeps tol"
    found = layouts.cheapest(scene, raster, kinds, engine.costs(), SPARE, direct)
    if found is None:
        return None, "pixels too near the track"
    if found[1] > most:
        return None, LONGER
    layout = layouts.cleared(
        scene, found[0], height, SHARE_PHASE * share, SHARE_POSITIONS * tol / MOST_MERGES, SHARE_ENDS * tol
    )
    part, planes, groups = served(scene, image, layout, near, relief)
    seconds = found[1] * part * planes + direct * (1 - part)
    return _Candidate(raster, image, layout, near, share, relief, height, seconds, planes * groups), ""


def _make_forest(
    scene: Scene, best: _Candidate, tol: float, engine: Engine, whole: bool, most: float
) -> tuple[Forest | None, str]:  # fmt: skip
    """About `most` trees of the best candidate, in shorter groups where its own reach too few pixels (`whole`: not all)."""
    error = SHARE_PHASE * best.share

    def made(layout: Layout, least: Fraction) -> Forest | None:
        layout = layouts.cleared(scene, layout, best.height, error, SHARE_POSITIONS * tol / MOST_MERGES, SHARE_ENDS * tol)
        return make_forest(scene, best.raster, best.image, layout, best.near, best.relief, least, whole, engine)

    layout = best.layout
    forest = made(layout, Fraction(0))
    # shorter groups see more as from a line, and nearer pixels from afar
    shortest = best.layout.length * max(1 / 8, best.trees / max(most, 1e-9))
    while forest is None and layout.length > shortest:
        layout = dataclasses.replace(layout, length=layout.length * 0.7)
        forest = made(layout, Fraction(0))
    choices = None
    while forest is not None:
        choices = choose_for_leaves(forest.scene, best.share, engine, SHARE_ROUNDING, forest.rate)
        if choices is not None:
            break
        # near a record's end tables hold all frequencies that samples can: their intervals must be shorter for that
        forest = made(layout, 2 * forest.rate) if forest.rate < FINEST else None
    if forest is None or choices is None:
        return None, "no pixel far enough from all groups of pings, or too steep a relief"
    merges = len(layout.fans)
    ends = SHARE_ENDS * tol if forest.layout.ends else 0.0
    errors = choices.errors | {"sub-images": math.hypot(bounds.tree_error(layout.taps, merges + 1), ends)}
    if merges:
        errors["positions"] = SHARE_POSITIONS * tol * merges / MOST_MERGES
    if not all(section.flat for section in forest.sections):
        errors["relief"] = best.relief
    forest.choices = dataclasses.replace(choices, errors=errors)
    forest.seconds = forest_seconds(forest, engine.costs())
    return forest, ""
