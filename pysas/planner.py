"""From `tol` to choices: the only module that knows how an error is bought with time.

`plan` looks at the scene, leaves out what it does not need, chooses the cheapest settings whose error bounds sum to at
most `tol` (equations: pysas/engine/preparation.py and the docstrings below) and returns a `Plan` that images any data of
the same geometry. `print(plan)` and `plan.explain()` say what was chosen and why.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, bounds, costs, engine, layouts, view_angles
from pysas._checks import ComplexArray
from pysas.costs import forest_seconds, prepare_seconds, sum_seconds, term_ns
from pysas.echoes import Echoes
from pysas.engine import MONOSTATIC, MOVING, NODES, STOP_AND_HOP, native, tree
from pysas.forest import Forest, Layout, grow, prospect
from pysas.grid import Grid
from pysas.image import Image
from pysas.plans import Choices, Plan
from pysas.scene import Scene

if TYPE_CHECKING:
    from pysas import backprojection

METHODS = ("auto", "backprojection", "ffbp")
SHARE_INTERPOLATION = 0.85
SHARE_PHASE = 0.05  # each: delay polynomial, sine and cosine
SHARE_WRAP = 0.1  # wrap-round at a record's hard end
ROWS = 32
LONGEST_BLOCK = 64
BATCH_BYTES = 24 * 2**20
LONGEST_FILTER = 400
# of tol, where sums go through a tree: for the sums of its leaves; what the rest may cost is the tree's
SHARE_LEAVES = 0.35
SHARE_ROUNDING = 0.4  # of the leaves' share, for float32 offsets in a block
SHARE_VIEWS = 0.04  # of tol, for weights uniform in view angle, where they are asked for
SHARE_RELIEF = 0.2  # of tol, for pixels read off the planes of their sub-images, where any are
FARTHEST = 1e9  # wavelengths: beyond it sub-images have more nodes than memory holds, and float64 loses 1e-5 anyway
TREE_TOL = 3e-5  # below it float32 sub-images would round too much
# width, rate and half length of the filters that a tree may use, cheapest first
TAPS = (
    (6, 1.2, 8), (6, 1.3, 8), (6, 1.4, 8), (6, 1.45, 8), (6, 1.5, 8), (8, 1.4, 10), (8, 1.45, 10), (8, 1.5, 10), (8, 1.6, 10),
    (8, 1.75, 10),
)  # fmt: skip
SPARE = 1.05  # sampling beyond the band's own limit, which a short group's band overlaps a little
FANS = ((), (2,), (4,), (4, 2), (4, 4), (4, 4, 2), (4, 4, 4), (4, 4, 4, 2), (4, 4, 4, 4))


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
        an error otherwise.

    Returns
    -------
    Plan

    Raises
    ------
    ValueError, TypeError
        Raw echoes, under-sampled data, a `tol` that cannot be met (says what can), a wrong argument.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected pysas.Grid")
    _checks.choice("method", method, METHODS)
    _checks.choice("nan", nan, ("raise", "mask"))
    name = engine.backend_name(backend)
    if not echoes.compressed:
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
    left = tol - _weigh(scene, grid, SHARE_VIEWS * tol, method != "backprojection", count)
    forest, why = None, ""
    if method != "backprojection":
        auto = method == "auto"
        forest, why = _plant(scene, grid, left, name, fallback or auto, count, auto)
    choices = _choose(scene, left, name) if forest is None else forest.choices
    if scene.lattice is not None:
        choices = dataclasses.replace(choices, errors=choices.errors | {"view angles": scene.lattice.error})
    chosen, why = ("ffbp", why) if method == "ffbp" or forest is not None else ("backprojection", "")
    return Plan(echoes, grid, tol, scene if forest is None else forest.scene, choices, count, name, nan, chosen, forest, why)


def focus(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    weights: npt.ArrayLike | str | None = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """The image of `backproject` by whichever engine has the least predicted time: `backproject` or `ffbp`.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed echoes; any track and array, moving receivers included.
    grid : Grid
    tol : float
        Relative error that is kept, whichever engine it is; as in `backproject`.
    threads, backend, weights, nan, out, progress
        As in `backproject`.

    Returns
    -------
    Image
        `image.report.method` names the engine; `plan(echoes, grid, tol).explain()` says why.

    Raises
    ------
    ValueError, TypeError
        As `backproject`.

    Notes
    -----
    O(pings channels pixels) for few pings or pixels, about O(N^2 log N) for N of each a side. `plan` for data to come.
    """
    from pysas import backprojection

    backprojection.check_out_of(out, echoes, grid)
    return plan(echoes, grid, tol, "auto", threads, backend, weights, nan)(echoes.data, out, progress)


def other_engine(plan: Plan) -> str:
    """The engine that a plan does not use: its predicted time, or why it cannot be."""
    scene = plan.scene
    left = plan.tol - (0.0 if scene.lattice is None else min(SHARE_VIEWS * plan.tol, scene.lattice.error))
    if plan.forest is not None:
        choices = _choose(scene, left, plan.backend)
        seconds = _direct_seconds(scene, choices, plan.backend)
        return f"backprojection: {seconds / plan.threads:.2g} s predicted"
    site, why = _site(scene, plan.grid, left, plan.backend, sum_seconds(scene, plan.choices, plan.backend))
    if site is not None:
        seconds = (site.seconds + prepare_seconds(scene, plan.choices)) / plan.threads + site.trees * costs.TREE_SECONDS[
            plan.backend
        ]
        why = f"{seconds:.2g} s predicted, and {costs.GROW_SECONDS[plan.backend]:g} s or more to plan"
    return f"ffbp: {why}"


def _weigh(scene: Scene, grid: Grid, error: float, tree: bool, threads: int) -> float:
    """Give a scene its weights uniform in view angle, if it asks for them; their share of tol."""
    if not scene.uniform or not scene.heard.any():
        return 0.0
    node = _node(scene) if tree else 0.0  # which also lie around the image
    stretch = (LONGEST_BLOCK - 1) * max(scene.step, node)
    scene.lattice = view_angles.lattice(scene, grid, error, LONGEST_BLOCK / 2 * node, stretch, threads)
    return min(error, float(scene.lattice.error))


def _node(scene: Scene) -> float:
    """From one node of a sub-image's ray to the next at most, m."""
    return scene.c / (4 * scene.band * scene.fs)


def _reachable(tol: float, echoes: Echoes, scene: Scene) -> None:
    if tol > 0.1:
        raise ValueError(f"tol={tol:g}: expected at most 0.1")
    float64 = 1e-14 * scene.farthest * echoes.fc / echoes.c
    least = max(1e-5 if echoes.dtype == np.complex64 else 1e-10, float64)
    if tol < least * (1 - 1e-9):
        hint = f"; complex128 data reach {max(1e-10, float64):.3g}" if least > float64 and least == 1e-5 else ""
        raise ValueError(f"tol={tol:g}: {echoes.dtype} data over {scene.farthest:.4g} m reach {least:.3g} at best{hint}")


def _choose(
    scene: Scene, tol: float, backend: str = "numba", rounding: float = 3 * SHARE_PHASE, rate: Fraction | None = None
) -> Choices:
    """The cheapest settings whose bounds sum to at most tol; in C++ for tables of `rate`, where leaves want one."""
    single = scene.dtype == np.complex64 or tol >= 1e-5 * (1 - 1e-9)
    precision = "float32" if single else "float64"
    nodes = native.NODES[precision] if backend == "cpp" else NODES
    polynomials = scene.lines is not None and (single or backend == "cpp")
    block, near, errors = _choose_delay(scene, tol, nodes, single, backend, rounding) if polynomials else (0, 0.0, {})
    if single and not block:
        errors["rounding"] = 2.0**-22
    least = 2.0**-23 if single else 1e-14
    for terms in native.TRIGONOMETRY[precision] if backend == "cpp" else range(4, 13):
        _, wrong = bounds.trigonometry(terms)
        if wrong <= max(SHARE_PHASE * tol, least):
            break
    errors["sine and cosine"] = wrong
    kinds = {MONOSTATIC: "monostatic", STOP_AND_HOP: "bistatic", MOVING: "moving receivers"}
    shared = {"precision": precision, "block": block, "near": near, "trigonometry": terms, "delay": kinds[scene.kind]}
    if rate is not None:
        errors["drift"] = SHARE_PHASE * tol
    if backend == "numba":
        return _choose_transform(scene, tol, errors, shared)
    return _choose_filter(scene, tol, errors, shared, rate)


def _choose_filter(
    scene: Scene, tol: float, errors: dict[str, float], shared: dict[str, Any], fixed: Fraction | None
) -> Choices:
    """C++: coefficients by a short filter; where pixels need samples near a record's end, of traces low-passed by W first.

    W (see pysas.reference.exact) says how a record's end is read, and its long response needs transforms: one forward, one
    back to twice the sample rate, where |f| <= 1/4 is all there is left for the filter to read.
    """
    heard = scene.heard
    away = bounds.guard(SHARE_WRAP * tol)
    errors = errors | {"record's ends": SHARE_WRAP * tol}
    ends = heard.any() and (np.min(scene.first[heard]) < away or np.max(scene.last[heard]) > scene.n_sample - 1 - away)
    n_fft = margin = taper = 0
    beta, band, double = 0.0, scene.band, 1
    if ends:
        length, margin, taper, beta = _crop(scene, tol)
        n_fft = scipy.fft.next_fast_len(length + max(away, LONGEST_FILTER))
        band, double = 0.25, 2
    else:
        length = int(np.max(scene.last[heard] - scene.first[heard], initial=0)) + 4
    left = min(SHARE_INTERPOLATION * tol, tol - sum(errors.values()))
    best: tuple[float, native.Filter] | None = None
    rates = native.RATES if fixed is None else ((fixed.numerator, fixed.denominator * double),)
    for degree in native.DEGREES[shared["precision"]]:
        for phases, step in rates:
            # a polynomial's own error, before any filter is made: near-minimax for this phase advance
            theta = np.pi * band * step / phases
            if theta ** (degree + 1) / (math.factorial(degree + 1) * 2**degree) > 1.5 * left:
                continue
            filter = native.design(band, degree, phases, step, left, LONGEST_FILTER)
            if filter.error > left:
                continue
            term = term_ns(scene, "cpp", shared["precision"], shared["block"], shared["near"], degree, double * filter.rate)
            coefficients = (degree + 1) * length * double * filter.rate
            cost = scene.traces * (scene.pixels * term + coefficients * (costs.COEFFICIENT_NS + costs.FILTER_NS * filter.taps))
            if best is None or cost < best[0]:
                best = (cost, filter)
            break
    assert best is not None  # a longer filter and a higher degree reach every tolerance that is let in
    filter = best[1]
    errors["interpolation"] = filter.error
    rate = double * filter.rate
    size = length * rate * (filter.degree + 1) * (8 if shared["precision"] == "float32" else 16)
    return Choices(
        degree=filter.degree, oversampling=rate, n_fft=n_fft, n_fine=double * n_fft, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, int(BATCH_BYTES / size) // 8 * 8), errors=errors, phases=len(filter.first), step=filter.step,
        taps=filter.taps, **shared,
    )  # fmt: skip


def _choose_transform(scene: Scene, tol: float, errors: dict[str, float], shared: dict[str, Any]) -> Choices:
    """Numba: coefficients by transforms."""
    length, margin, taper, beta = _crop(scene, tol)
    pad = bounds.guard(SHARE_WRAP * tol) if length == scene.n_sample else 0
    errors["wrap-round"] = SHARE_WRAP * tol if pad else 0.0
    n_fft = scipy.fft.next_fast_len(length + pad)
    left = min(SHARE_INTERPOLATION * tol, tol - sum(errors.values()))
    precision = shared["precision"]
    best: tuple[float, int, int] | None = None
    for degree in bounds.THETA:
        rate = max(1.0, np.pi * scene.band / bounds.theta_limit(degree, left))
        n_fine = scipy.fft.next_fast_len(int(np.ceil(n_fft * rate - 1e-9))) if rate > 1 else n_fft
        term = term_ns(scene, "numba", precision, shared["block"], shared["near"], degree, n_fine / n_fft)
        cost = scene.traces * (scene.pixels * term + costs.PREPARE_NS * (degree + 1) * n_fine)
        if best is None or cost < best[0]:
            best = (cost, degree, n_fine)
    assert best is not None
    _, degree, n_fine = best
    errors["interpolation"] = bounds.interpolation_error(degree, np.pi * scene.band * n_fft / n_fine)
    size = int(length * n_fine / n_fft) * (degree + 1) * (8 if precision == "float32" else 16)
    return Choices(
        degree=degree, oversampling=n_fine / n_fft, n_fft=n_fft, n_fine=n_fine, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, BATCH_BYTES // size // 8 * 8), errors=errors, **shared,
    )  # fmt: skip


def _choose_delay(
    scene: Scene, tol: float, nodes: int, single: bool, backend: str, share: float = 3 * SHARE_PHASE, whole: bool = False
) -> tuple[int, float, dict[str, float]]:
    """Length of a block and the distance from which its delay polynomial holds; 0 where only exact delays keep tol.

    The cheapest; with `whole` the longest that holds for all pixels, spheres about tiles reaching nearer than those.

    sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so the
    polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each way. The
    offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the block, which may
    take `share` of tol.
    """
    wave = scene.fc / scene.c
    uneven = 4 * np.pi * wave * scene.uneven  # a pixel off its line is off by as much on both ways
    eps = 2.0**-24 if single else 2.0**-53
    best: tuple[int, float, dict[str, float]] = (0, 0.0, {})
    cheapest = math.inf
    for block in (64, 48, 32, 16, 8):
        count = _even_split(scene.line_length, block)
        half = scene.step * (count - 1) / 2
        turns = 2 * half * scene.slope * wave
        rounding = np.pi * turns * eps + 4 * eps + uneven
        bent = scene.lattice is not None and 2 * half > scene.lattice.longest
        if rounding > share * tol or bent:
            continue
        near = 2 * half
        if half > 0:
            scaled = 2 * np.pi * wave * 2 * 1.3 * (2 / (2 * nodes - 1)) * half**nodes / 2 ** (nodes - 1)
            near = max(near, (scaled / (SHARE_PHASE * tol)) ** (1 / (nodes - 1)))
        cost = near if whole else term_ns(scene, backend, "float32" if single else "float64", count, near, 3, 2.0)
        if cost < cheapest:
            cheapest = cost
            best = (count, near, {"rounding": rounding, "delay polynomial": SHARE_PHASE * tol})
        if whole and near <= 0.9 * scene.nearest:
            break
    return best


def _even_split(length: int, block: int) -> int:
    """Pixels per block, at most `block`: blocks of equal size, a multiple of 8 where the line is long."""
    blocks = -(-length // block)
    count = -(-length // blocks)
    return min(block, -(-count // 8) * 8) if length > 8 else length


def _crop(scene: Scene, tol: float) -> tuple[int, int, int, float]:
    """Samples kept of every trace, those kept beside what pixels need, the taper at each cut end and its beta.

    A smooth cut (the integral of a Kaiser window) of g samples leaves a band-limited trace band-limited to within
    beta = pi sqrt((g delta)^2 - 1), delta the free band up to 1/2.2: exp(-beta) is held to a thousandth of tol, so that
    a point 60 dB above the scene just outside the cut does no harm. It begins GUARD samples away: a record's own end that is
    nearer stays in, with what the low-pass W makes of it.
    """
    heard = scene.heard
    if not heard.any():
        return scene.n_sample, 0, 0, 0.0
    free = 1 / 2.2 - scene.band
    margin = bounds.guard(tol)
    if free < 0.01:
        return scene.n_sample, 0, 0, 0.0
    beta = np.log(1e3 / tol)
    taper = int(np.ceil(np.sqrt(1 + (beta / np.pi) ** 2) / free)) + 1
    needed = int(np.max(scene.last[heard] - scene.first[heard])) + 2 + 2 * (taper + margin)
    return (needed, margin + taper, taper, float(beta)) if needed < 0.9 * scene.n_sample else (scene.n_sample, 0, 0, 0.0)


@dataclass(frozen=True)
class _Site:
    """Where trees could stand: the best layout and what sums cost with it on one thread, before any tree is grown."""

    frame: backprojection.Frame
    layout: Layout
    near: float
    share: float
    relief: float
    height: float
    seconds: float
    trees: int


def _plant(
    scene: Scene, grid: Grid, tol: float, backend: str, fallback: bool, threads: int, auto: bool
) -> tuple[Forest | None, str]:
    """A tree for each of the longest groups, or None and why all is summed directly; an error where that is forbidden.

    `auto` : planning the trees counts beside their sums.
    """
    choices = _choose(scene, tol, backend)
    direct = sum_seconds(scene, choices, backend)
    most = _direct_seconds(scene, choices, backend) if fallback else math.inf
    forest, longer = None, "a tree would take longer"
    growing = threads * costs.GROW_SECONDS[backend] if auto else 0.0
    if most <= growing:
        return None, longer
    site, why = _site(scene, grid, tol, backend, direct)
    alone = threads * costs.TREE_SECONDS[backend]
    if site is not None and site.seconds + alone * site.trees > most - growing:
        return None, longer
    if site is not None:
        forest, why = _grow(scene, site, tol, backend, not fallback)
    if forest is not None:
        forest.seconds += alone * len(forest.trees)
        if forest.seconds > most:
            return None, longer
    if not fallback and (forest is None or forest.share < 1):
        if forest is not None:
            near = "pixels near the track or across the ends of records or beams"
            why = f"{100 * (1 - forest.share):.3g} % of the terms, {near}"
        raise ValueError(f"fallback=False, tol={tol:g}: expected all terms to go through the tree, found: {why}")
    return forest, why


def _direct_seconds(scene: Scene, choices: Choices, backend: str) -> float:
    return sum_seconds(scene, choices, backend) + prepare_seconds(scene, choices)


def _site(scene: Scene, grid: Grid, tol: float, backend: str, direct: float) -> tuple[_Site | None, str]:
    """The cheapest layout that keeps tol, or why there is none; `direct`: seconds of a sum of all terms without trees."""
    from pysas import backprojection

    if tol < TREE_TOL * (1 - 1e-9):
        return None, f"tol below {TREE_TOL:g}"
    if scene.farthest > FARTHEST * scene.c / scene.fc:
        return None, f"range beyond {FARTHEST:g} wavelengths"
    if not scene.heard.any():
        return None, "the grid lies outside the recorded window"
    if scene.lattice is not None and (LONGEST_BLOCK - 1) * _node(scene) > scene.lattice.longest:
        return None, "view-angle weights change fast along the rays of sub-images"
    share = SHARE_LEAVES * tol
    flat = scene.lines is not None and not np.any(scene.lines[1][:, 2])
    relief = 0.05 * tol if flat else SHARE_RELIEF * tol
    block, near = 0, 0.0
    if scene.lines is not None:
        nodes = native.NODES["float32"] if backend == "cpp" else NODES
        block, near, _ = _choose_delay(scene, share, nodes, True, backend, SHARE_ROUNDING, whole=True)
        if not block:
            return None, "pixels too coarse for float32 blocks"
        block = _even_split(scene.line_length, block)
    sensors = scene.geometry[scene.heard][:, [2, 5]]
    height = float(max(sensors.max() - scene.bottom, scene.top - sensors.min()))
    frame = backprojection.Frame(grid, scene, block, rows=True)
    kinds: list[tuple[tuple[int, ...], tree.Taps]] = []
    for fans in FANS:
        for width, rate, half in TAPS:
            taps = tree.taps(width, rate, half)
            if bounds.tree_error(taps, len(fans) + 1) <= tol - share - relief:
                kinds.append((fans, taps))
                break
    if not kinds:
        return None, "no interpolation keeps tol"
    runs = native.isa_name() if backend == "cpp" else backend
    found = layouts.cheapest(scene, frame, kinds, runs, SPARE, direct)
    if found is None:
        return None, "pixels too near the track"
    layout = layouts.cleared(scene, found[0], height, SHARE_PHASE * share)
    part, planes, groups = prospect(scene, frame, layout, near, relief)
    seconds = found[1] * part * planes + direct * (1 - part)
    return _Site(frame, layout, near, share, relief, height, seconds, planes * groups), ""


def _grow(scene: Scene, site: _Site, tol: float, backend: str, whole: bool) -> tuple[Forest | None, str]:
    """The trees of a site, in shorter groups where its own reach too few pixels (`whole`: not all)."""

    def grown(layout: Layout) -> Forest | None:
        layout = layouts.cleared(scene, layout, site.height, SHARE_PHASE * site.share)
        return grow(scene, site.frame, site.frame.mask, layout, site.near, site.relief, backend == "cpp")

    layout = site.layout
    forest = grown(layout)
    # shorter groups see more as from a line, and nearer pixels from afar
    while (forest is None or (whole and forest.share < 1)) and layout.length > site.layout.length / 8:
        layout = dataclasses.replace(layout, length=layout.length * 0.7)
        forest = grown(layout)
    if forest is None or not any(t.read.any() for t in forest.trees):
        return None, "no pixel far enough from all groups of pings, or too steep a relief"
    choices = _choose(forest.scene, site.share, backend, SHARE_ROUNDING, forest.rate)
    errors = choices.errors | {"sub-images": bounds.tree_error(layout.taps, len(layout.fans) + 1)}
    if not all(sheet.flat for sheet in forest.sheets):
        errors["relief"] = site.relief
    forest.choices = dataclasses.replace(choices, errors=errors)
    forest.seconds = forest_seconds(forest, backend)
    return forest, ""
