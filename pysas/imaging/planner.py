"""From `tol` to a plan: who plans it, and what weights uniform in view angle may cost of it.

An engine that plans by itself (C++) takes what is left of `tol`; for another few fixed settings are chosen here. `plan` returns
a `Plan` that images any data of the same geometry. `print(plan)` and `plan.explain()` say what was chosen and why.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.engine import Engine, Parts, Planning, engine_of
from pysas.imaging.compiled import Compiled
from pysas.imaging.execution import execute
from pysas.imaging.plans import EnginePlan, Plan
from pysas.imaging.summing import Summing
from pysas.model.echoes import Echoes
from pysas.model.gaps import with_windows
from pysas.model.grid import Grid
from pysas.planning import view_angles
from pysas.planning.fallback import planner as fixed
from pysas.planning.scene import UNIFORM, Scene

METHODS = ("auto", "backprojection", "ffbp")
SHARE_VIEWS = 0.04  # of tol, for weights uniform in view angle, where they are asked for
SHARE_LIT = 0.3  # of tol, at most, for what these change where views come in and go at beams' edges


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
        "auto" is whichever has the least predicted time for one image, the planning of a tree included; the Numba engine
        has a plain rule instead, which `print(plan)` tells.
    threads : int, optional
        Default: PYSAS_NUM_THREADS, else all processors. The image does not depend on it.
    backend : {"auto", "numba", "cpp"}
    weights : (ping,) or (ping, channel) array_like, or "uniform-angle", optional
        As in `backproject`.
    nan : {"raise", "mask"}
        Non-finite samples that were recorded: an error; or, as in `backproject`, those at a trace's ends shorten its `valid`,
        for which such data are planned anew, and traces with others are left out of the sum.
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


def plan_rows(
    echoes: Echoes, rows: Grid, hears: npt.NDArray[np.int64], tol: float, threads: int | None, backend: str
) -> EnginePlan:
    """Direct sums at rows of points, each of the traces that it alone hears: hears (row, 2), the first and the last, counted
    through all pings and channels. Rows that lie where nothing was recorded are zero without a word."""
    return _engine_plan(echoes, rows, tol, "backprojection", threads, backend, hears=hears)[0]


@_checks.usual_errors
def plan_ahead(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    method: str = "auto",
    threads: int | None = None,
    backend: str = "auto",
    nan: str = "raise",
    weights: str | None = None,
) -> Plan:
    """The `plan` of echoes, raw ones too, for what they will be when compressed.

    Compression changes samples alone: not their number, rate, type or band, nor the geometry, which is all that a plan is
    made from. The plan takes compressed data.
    """
    return _plan(echoes, grid, tol, method, threads, backend, weights, nan, raw=True)


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
    _checks.choice("nan", nan, ("raise", "mask"))
    by, scene, engine = _engine_plan(echoes, grid, tol, method, threads, backend, weights, fallback, raw)
    name = "ffbp" if method == "ffbp" else "backprojection"
    again = None
    if nan == "mask":
        given = UNIFORM if scene.uniform else scene.weights.reshape(echoes.n_ping, -1)
        again = _anew(echoes, grid, tol, method, threads, backend, given, fallback, raw)
    return Plan(echoes, grid, tol, scene, engine, _checks.threads(threads), nan, name, by, execute, again)


def _engine_plan(
    echoes: Echoes, grid: Grid, tol: float, method: str, threads: int | None, backend: str,
    weights: npt.ArrayLike | str | None = None, fallback: bool = True, raw: bool = False,
    hears: npt.NDArray[np.int64] | None = None,
) -> tuple[EnginePlan, Scene, Engine]:  # fmt: skip
    """`raw` : whether echoes may be raw as yet; `hears` : see Scene."""
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes (several: backproject, ffbp, focus)")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected pysas.Grid")
    _checks.choice("method", method, METHODS)
    engine = engine_of(backend)
    if not (echoes.compressed or raw):
        raise ValueError("echoes: raw (compressed=False): expected range-compressed echoes, see pysas.compress")
    if echoes.fs < 1.1 * echoes.occupied_bandwidth * (1 - 1e-9):
        raise ValueError(
            f"echoes: fs={echoes.fs:g} Hz is {echoes.fs / echoes.occupied_bandwidth:.4g} x the bandwidth "
            f"{echoes.occupied_bandwidth:g} Hz: expected at least 1.1 x"
        )
    tol = _checks.number("tol", tol, positive=True)
    scene = Scene(echoes, grid, weights, hears)
    _reachable(tol, echoes, scene)
    count = _checks.threads(threads)
    views = _weigh(scene, grid, tol, method != "backprojection", count, engine)
    budget, stands_in = tol - views, fallback or method == "auto"
    if isinstance(engine, Planning):
        return Compiled(scene, grid, tol, budget, views, method, stands_in, count, engine), scene, engine
    return _interpreted(scene, grid, tol, budget, method, stands_in, count, engine), scene, engine


def _anew(
    echoes: Echoes, grid: Grid, tol: float, method: str, threads: int | None, backend: str, weights: npt.ArrayLike | str,
    fallback: bool, raw: bool,
) -> Callable[[npt.NDArray[np.int64]], Plan]:  # fmt: skip
    """What plans for windows of what was recorded that are not the echoes'."""
    bare = echoes.replace(data=np.broadcast_to(np.zeros((), echoes.dtype), echoes.data.shape))  # a plan holds no data

    def again(windows: npt.NDArray[np.int64]) -> Plan:
        return _plan(with_windows(bare, windows), grid, tol, method, threads, backend, weights, "mask", fallback, raw)

    return again


def _interpreted(
    scene: Scene, grid: Grid, tol: float, budget: float, method: str, fallback: bool, threads: int, engine: Parts
) -> Summing:  # fmt: skip
    """The plan of an engine that has none of its own."""
    choices = fixed.choose(scene, budget, engine)
    forest, why = None, ""
    if method != "backprojection":
        try:
            forest, why = fixed.make_trees(scene, grid, budget, engine, fallback, method == "auto")
            why = why if method == "ffbp" else ""
        except _checks.InternalError as error:  # no fault of the scene: there is always the direct sum
            if not fallback:
                raise
            why = f"no trees: {error}"
    if forest is not None:
        scene, choices = forest.scene, forest.choices
    if scene.uniform:
        choices = dataclasses.replace(choices, errors=choices.errors | {"view angles": _views_error(scene)})
    return Summing(scene, grid, tol, budget, method, fallback, threads, engine, choices, forest, why)


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
    float64 = 1e-14 * scene.farthest * max(echoes.fc, echoes.occupied_bandwidth) / scene.c
    least = max(1e-5 if echoes.dtype == np.complex64 else 1e-10, float64)
    if not tol >= least * (1 - 1e-9):
        hint = f"; complex128 data reach {max(1e-10, float64):.3g}" if least > float64 and least == 1e-5 else ""
        raise ValueError(f"tol={tol:g}: {echoes.dtype} data over {scene.farthest:.4g} m reach {least:.3g} at best{hint}")
