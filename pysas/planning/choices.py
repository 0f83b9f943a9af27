"""The settings of one sum: the cheapest whose error bounds add up to at most a budget, the planner's share of what is asked.

What each costs: costs.py; bounds: bounds.py, pysas/engine/preparation.py and the docstrings below.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.fft

from pysas import _checks
from pysas.engine import MONOSTATIC, MOVING, STOP_AND_HOP, Engine, native
from pysas.planning import bounds, costs
from pysas.planning.costs import term_ns
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

SHARE_INTERPOLATION = 0.85
SHARE_WIDE = 0.3  # the same of tables of whole records: all they hold may be at the band's edge, where bounds leave no margin
SHARE_PHASE = 0.05  # each: delay polynomial, sine and cosine
SHARE_WRAP = 0.1  # wrap-round at a record's hard end
# of tol, where sums go through a tree: for the sums of its leaves; what the rest may cost is the tree's
SHARE_LEAVES = 0.35
SHARE_ROUNDING = 0.4  # of the leaves' share, for float32 offsets in a block
BATCH_BYTES = 24 * 2**20
LONGEST_FILTER = 400
# of a filter at twice the sample rate: its Kaiser window's error beside what pixels read, exp(-pi sqrt(18^2 - 1))
WIDE_TAPS, WIDE_ERROR = 36, 1e-12


def choose(scene: Scene, budget: float, engine: Engine, wide: float = 0.0) -> Choices:
    """The cheapest settings whose bounds add up to at most `budget`, a relative error.

    `wide` : for data that are bright beside what pixels read, as many times as bright at their records' ends.
    """
    found = _settings(scene, budget, engine, 3 * SHARE_PHASE, None, wide)
    if found is None:  # a longer filter and a higher degree reach every budget that is let in
        raise _checks.InternalError(f"no settings within {budget:.2g}")
    return found


def choose_for_leaves(
    scene: Scene, budget: float, engine: Engine, rounding: float, rate: Fraction, wide: float = 0.0
) -> Choices | None:
    """The same with tables of `rate` intervals per sample, as C++ wants them for leaves, or None where no filter makes them
    within the budget; `rounding` : share of it for float32 offsets in a block."""
    return _settings(scene, budget, engine, rounding, rate, wide)


def _settings(
    scene: Scene, budget: float, engine: Engine, rounding: float, rate: Fraction | None, wide: float
) -> Choices | None:
    single = scene.dtype == np.complex64 or budget >= 1e-5 * (1 - 1e-9)
    precision = "float32" if single else "float64"
    polynomials = scene.lines is not None and precision in engine.polynomials
    block, near, errors = choose_delay(scene, budget, engine, precision, rounding) if polynomials else (0, 0.0, {})
    if single and not block:
        errors["rounding"] = 2.0**-22
    least = 2.0**-23 if single else 1e-14
    for terms in engine.sines[precision]:
        _, wrong = bounds.trigonometry(terms)
        if wrong <= max(SHARE_PHASE * budget, least):
            break
    errors["sine and cosine"] = wrong
    kinds = {MONOSTATIC: "monostatic", STOP_AND_HOP: "bistatic", MOVING: "moving receivers"}
    run = 0
    if single:
        run = bounds.longest_run(budget, engine.sums)
        # and as many batches, of 8 traces at least, as the image may be a sum of: see Plan.wide
        batches = min(-(-scene.traces // 8), run // 8)
        errors["running sums"] = bounds.running_error(min(run, scene.traces), engine.sums) + bounds.running_error(batches, 1)
    shared = {"precision": precision, "block": block, "near": near, "trigonometry": terms, "delay": kinds[scene.kind]}
    shared["run"] = run
    if rate is not None:
        errors["drift"] = SHARE_PHASE * budget
    if engine.filters:
        return _choose_filter(scene, budget, engine, errors, shared, rate, wide)
    return _choose_transform(scene, budget, engine, errors, shared, wide)


def _choose_filter(
    scene: Scene, budget: float, engine: Engine, errors: dict[str, float], shared: dict[str, Any], fixed: Fraction | None,
    wide: float,
) -> Choices | None:  # fmt: skip
    """Coefficients by a short filter; where pixels need samples near a record's end, of traces low-passed by W first.

    W (see pysas.reference.exact) says how a record's end is read, and its long response needs transforms: one forward, one
    back to twice the sample rate, where |f| <= 1/4 is all there is left for the filter to read. With `wide` whole records
    go through them and the filter is as long as float64 can use; its polynomials are wrong by what they themselves read.
    """
    heard = scene.heard
    away = bounds.guard(SHARE_WRAP * budget / max(wide, 1.0))
    errors = errors | {"record's ends": SHARE_WRAP * budget}
    ends = bool(wide) or _near_ends(scene, away)
    least, most = (WIDE_TAPS, WIDE_TAPS) if wide else (native.LEAST_TAPS, LONGEST_FILTER)
    n_fft = margin = taper = 0
    beta, band, double = 0.0, scene.band, 1
    length = int(np.max(scene.last[heard] - scene.first[heard], initial=0)) + 4
    if ends:
        if not wide:
            length, margin, taper, beta = _crop(scene, budget)
        n_fft = scipy.fft.next_fast_len((scene.n_sample if wide else length) + max(away, LONGEST_FILTER))
        band, double = 0.25, 2
    left = min((SHARE_WIDE if wide else SHARE_INTERPOLATION) * budget, budget - sum(errors.values()))
    best: tuple[float, native.Filter] | None = None
    rates = native.RATES if fixed is None else ((fixed.numerator, fixed.denominator * double),)
    for degree in native.sizes()[shared["precision"]]["degrees"]:
        for phases, step in rates:
            # a polynomial's own error, before any filter is made: near-minimax for this phase advance
            theta = np.pi * band * step / phases
            if theta ** (degree + 1) / (math.factorial(degree + 1) * 2**degree) > 1.5 * left:
                continue
            filter = native.design(band, degree, phases, step, left, most, least)
            if filter.error > left:
                continue
            term = term_ns(
                scene, engine.costs(), shared["precision"], shared["block"], shared["near"], degree, double * filter.rate
            )
            coefficients = (degree + 1) * length * double * filter.rate
            cost = scene.traces * (scene.pixels * term + coefficients * (costs.COEFFICIENT_NS + costs.FILTER_NS * filter.taps))
            if best is None or cost < best[0]:
                best = (cost, filter)
            break
    if best is None:
        return None
    filter = best[1]
    errors["interpolation"] = filter.error
    rate = double * filter.rate
    size = length * rate * (filter.degree + 1) * (8 if shared["precision"] == "float32" else 16)
    return Choices(
        degree=filter.degree, oversampling=rate, n_fft=n_fft, n_fine=double * n_fft, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, int(BATCH_BYTES / size) // 8 * 8), errors=errors, phases=filter.phases, step=filter.step,
        taps=filter.taps, wide=bool(wide), **shared,
    )  # fmt: skip


def _near_ends(scene: Scene, away: int) -> bool:
    """Whether pixels need samples less than `away` from a record's end: there a low-passed trace holds all |f| < 1/2."""
    first, last = scene.first[scene.heard], scene.last[scene.heard]
    return bool(first.size and (np.min(first) < away or np.max(last) > scene.n_sample - 1 - away))


def _choose_transform(
    scene: Scene, budget: float, engine: Engine, errors: dict[str, float], shared: dict[str, Any], wide: float
) -> Choices | None:
    """Coefficients by transforms, with `wide` of whole records in float64."""
    length, margin, taper, beta = (scene.n_sample, 0, 0, 0.0) if wide else _crop(scene, budget)
    away = bounds.guard(SHARE_WRAP * budget / max(wide, 1.0))
    band = 0.5 if wide or _near_ends(scene, away) else scene.band
    pad = away if length == scene.n_sample else 0
    errors["wrap-round"] = SHARE_WRAP * budget
    n_fft = scipy.fft.next_fast_len(length + pad)
    left = min((SHARE_WIDE if wide else SHARE_INTERPOLATION) * budget, budget - sum(errors.values()))
    precision = shared["precision"]
    best: tuple[float, int, int] | None = None
    for degree in bounds.THETA:
        rate = max(1.0, np.pi * band / bounds.theta_limit(degree, left))
        n_fine = scipy.fft.next_fast_len(int(np.ceil(n_fft * rate - 1e-9))) if rate > 1 else n_fft
        term = term_ns(scene, engine.costs(), precision, shared["block"], shared["near"], degree, n_fine / n_fft)
        cost = scene.traces * (scene.pixels * term + costs.PREPARE_NS * (degree + 1) * n_fine)
        if best is None or cost < best[0]:
            best = (cost, degree, n_fine)
    if best is None:
        return None
    _, degree, n_fine = best
    errors["interpolation"] = bounds.interpolation_error(degree, np.pi * band * n_fft / n_fine)
    size = int(length * n_fine / n_fft) * (degree + 1) * (8 if precision == "float32" else 16)
    return Choices(
        degree=degree, oversampling=n_fine / n_fft, n_fft=n_fft, n_fine=n_fine, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, BATCH_BYTES // size // 8 * 8), errors=errors, wide=bool(wide), **shared,
    )  # fmt: skip


def choose_delay(
    scene: Scene, budget: float, engine: Engine, precision: str, share: float = 3 * SHARE_PHASE, whole: bool = False
) -> tuple[int, float, dict[str, float]]:
    """Length of a block and the distance from which its delay polynomial holds; 0 where only exact delays keep to the budget.

    The cheapest; with `whole` the longest that holds for all pixels, spheres about tiles reaching nearer than those.

    sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so the
    polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each way. The
    offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the block, which may
    take `share` of the budget.
    """
    nodes, single = engine.nodes[precision], precision == "float32"
    wave = scene.fc / scene.c
    uneven = 4 * np.pi * wave * scene.uneven  # a pixel off its line is off by as much on both ways
    eps = 2.0**-24 if single else 2.0**-53
    best: tuple[int, float, dict[str, float]] = (0, 0.0, {})
    cheapest = math.inf
    for block in (64, 48, 32, 16, 8):
        count = even_split(scene.line_length, block)
        half = scene.step * (count - 1) / 2
        turns = 2 * half * scene.slope * wave
        rounding = np.pi * turns * eps + 4 * eps + uneven
        bent = scene.lattice is not None and not scene.lattice.holds(scene.step, count)
        if rounding > share * budget or bent:
            continue
        near = 2 * half
        if half > 0:
            scaled = 2 * np.pi * wave * 2 * 1.3 * (2 / (2 * nodes - 1)) * half**nodes / 2 ** (nodes - 1)
            near = max(near, (scaled / (SHARE_PHASE * budget)) ** (1 / (nodes - 1)))
        cost = near if whole else term_ns(scene, engine.costs(), precision, count, near, 3, 2.0)
        if cost < cheapest:
            cheapest = cost
            best = (count, near, {"rounding": rounding, "delay polynomial": SHARE_PHASE * budget})
        if whole and near <= 0.9 * scene.nearest:
            break
    return best


def even_split(length: int, block: int) -> int:
    """Pixels per block, at most `block`: blocks of equal size, a multiple of 8 where the line is long."""
    blocks = -(-length // block)
    count = -(-length // blocks)
    return min(block, -(-count // 8) * 8) if length > 8 else length


def _crop(scene: Scene, budget: float) -> tuple[int, int, int, float]:
    """Samples kept of every trace, those kept beside what pixels need, the taper at each cut end and its beta.

    A smooth cut (the integral of a Kaiser window) of g samples leaves a band-limited trace band-limited to within
    beta = pi sqrt((g delta)^2 - 1), delta the free band up to 1/2.2: exp(-beta) is held to a thousandth of the budget, so that
    a point 60 dB above the scene just outside the cut does no harm. It begins GUARD samples away: a record's own end that is
    nearer stays in, with what the low-pass W makes of it.
    """
    heard = scene.heard
    if not heard.any():
        return scene.n_sample, 0, 0, 0.0
    free = 1 / 2.2 - scene.band
    margin = bounds.guard(budget)
    if free < 0.01:
        return scene.n_sample, 0, 0, 0.0
    beta = np.log(1e3 / budget)
    taper = int(np.ceil(np.sqrt(1 + (beta / np.pi) ** 2) / free)) + 1
    needed = int(np.max(scene.last[heard] - scene.first[heard])) + 2 + 2 * (taper + margin)
    return (needed, margin + taper, taper, float(beta)) if needed < 0.9 * scene.n_sample else (scene.n_sample, 0, 0, 0.0)
