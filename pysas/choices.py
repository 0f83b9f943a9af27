"""The settings of one sum: the cheapest whose error bounds add up to at most a budget, the planner's share of what is asked.

What each costs: pysas/costs.py; bounds: pysas/bounds.py, pysas/engine/preparation.py and the docstrings below.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.fft

from pysas import _checks, bounds, costs
from pysas.costs import term_ns
from pysas.engine import MONOSTATIC, MOVING, NODES, STOP_AND_HOP, native
from pysas.plans import Choices
from pysas.scene import Scene

SHARE_INTERPOLATION = 0.85
SHARE_PHASE = 0.05  # each: delay polynomial, sine and cosine
SHARE_WRAP = 0.1  # wrap-round at a record's hard end
LONGEST_BLOCK = 64
BATCH_BYTES = 24 * 2**20
LONGEST_FILTER = 400


def choose(
    scene: Scene, budget: float, backend: str = "numba", rounding: float = 3 * SHARE_PHASE, rate: Fraction | None = None
) -> Choices:
    """The cheapest settings whose bounds add up to at most `budget`, a relative error.

    `rate` : of the tables in C++, where leaves want one.
    """
    single = scene.dtype == np.complex64 or budget >= 1e-5 * (1 - 1e-9)
    precision = "float32" if single else "float64"
    nodes = native.NODES[precision] if backend == "cpp" else NODES
    polynomials = scene.lines is not None and (single or backend == "cpp")
    block, near, errors = choose_delay(scene, budget, nodes, single, backend, rounding) if polynomials else (0, 0.0, {})
    if single and not block:
        errors["rounding"] = 2.0**-22
    least = 2.0**-23 if single else 1e-14
    for terms in native.TRIGONOMETRY[precision] if backend == "cpp" else range(4, 13):
        _, wrong = bounds.trigonometry(terms)
        if wrong <= max(SHARE_PHASE * budget, least):
            break
    errors["sine and cosine"] = wrong
    kinds = {MONOSTATIC: "monostatic", STOP_AND_HOP: "bistatic", MOVING: "moving receivers"}
    shared = {"precision": precision, "block": block, "near": near, "trigonometry": terms, "delay": kinds[scene.kind]}
    if rate is not None:
        errors["drift"] = SHARE_PHASE * budget
    if backend == "numba":
        return _choose_transform(scene, budget, errors, shared)
    return _choose_filter(scene, budget, errors, shared, rate)


def _choose_filter(
    scene: Scene, budget: float, errors: dict[str, float], shared: dict[str, Any], fixed: Fraction | None
) -> Choices:
    """C++: coefficients by a short filter; where pixels need samples near a record's end, of traces low-passed by W first.

    W (see pysas.reference.exact) says how a record's end is read, and its long response needs transforms: one forward, one
    back to twice the sample rate, where |f| <= 1/4 is all there is left for the filter to read.
    """
    heard = scene.heard
    away = bounds.guard(SHARE_WRAP * budget)
    errors = errors | {"record's ends": SHARE_WRAP * budget}
    ends = heard.any() and (np.min(scene.first[heard]) < away or np.max(scene.last[heard]) > scene.n_sample - 1 - away)
    n_fft = margin = taper = 0
    beta, band, double = 0.0, scene.band, 1
    if ends:
        length, margin, taper, beta = _crop(scene, budget)
        n_fft = scipy.fft.next_fast_len(length + max(away, LONGEST_FILTER))
        band, double = 0.25, 2
    else:
        length = int(np.max(scene.last[heard] - scene.first[heard], initial=0)) + 4
    left = min(SHARE_INTERPOLATION * budget, budget - sum(errors.values()))
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
    if best is None:  # a longer filter and a higher degree reach every budget that is let in
        raise _checks.InternalError(f"no filter within {left:.2g}")
    filter = best[1]
    errors["interpolation"] = filter.error
    rate = double * filter.rate
    size = length * rate * (filter.degree + 1) * (8 if shared["precision"] == "float32" else 16)
    return Choices(
        degree=filter.degree, oversampling=rate, n_fft=n_fft, n_fine=double * n_fft, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, int(BATCH_BYTES / size) // 8 * 8), errors=errors, phases=len(filter.first), step=filter.step,
        taps=filter.taps, **shared,
    )  # fmt: skip


def _choose_transform(scene: Scene, budget: float, errors: dict[str, float], shared: dict[str, Any]) -> Choices:
    """Numba: coefficients by transforms."""
    length, margin, taper, beta = _crop(scene, budget)
    pad = bounds.guard(SHARE_WRAP * budget) if length == scene.n_sample else 0
    errors["wrap-round"] = SHARE_WRAP * budget if pad else 0.0
    n_fft = scipy.fft.next_fast_len(length + pad)
    left = min(SHARE_INTERPOLATION * budget, budget - sum(errors.values()))
    precision = shared["precision"]
    best: tuple[float, int, int] | None = None
    for degree in bounds.THETA:
        rate = max(1.0, np.pi * scene.band / bounds.theta_limit(degree, left))
        n_fine = scipy.fft.next_fast_len(int(np.ceil(n_fft * rate - 1e-9))) if rate > 1 else n_fft
        term = term_ns(scene, "numba", precision, shared["block"], shared["near"], degree, n_fine / n_fft)
        cost = scene.traces * (scene.pixels * term + costs.PREPARE_NS * (degree + 1) * n_fine)
        if best is None or cost < best[0]:
            best = (cost, degree, n_fine)
    if best is None:
        raise _checks.InternalError(f"no interpolation within {left:.2g}")
    _, degree, n_fine = best
    errors["interpolation"] = bounds.interpolation_error(degree, np.pi * scene.band * n_fft / n_fine)
    size = int(length * n_fine / n_fft) * (degree + 1) * (8 if precision == "float32" else 16)
    return Choices(
        degree=degree, oversampling=n_fine / n_fft, n_fft=n_fft, n_fine=n_fine, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, BATCH_BYTES // size // 8 * 8), errors=errors, **shared,
    )  # fmt: skip


def choose_delay(
    scene: Scene, budget: float, nodes: int, single: bool, backend: str, share: float = 3 * SHARE_PHASE, whole: bool = False
) -> tuple[int, float, dict[str, float]]:
    """Length of a block and the distance from which its delay polynomial holds; 0 where only exact delays keep to the budget.

    The cheapest; with `whole` the longest that holds for all pixels, spheres about tiles reaching nearer than those.

    sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so the
    polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each way. The
    offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the block, which may
    take `share` of the budget.
    """
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
        bent = scene.lattice is not None and 2 * half > scene.lattice.longest
        if rounding > share * budget or bent:
            continue
        near = 2 * half
        if half > 0:
            scaled = 2 * np.pi * wave * 2 * 1.3 * (2 / (2 * nodes - 1)) * half**nodes / 2 ** (nodes - 1)
            near = max(near, (scaled / (SHARE_PHASE * budget)) ** (1 / (nodes - 1)))
        cost = near if whole else term_ns(scene, backend, "float32" if single else "float64", count, near, 3, 2.0)
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
