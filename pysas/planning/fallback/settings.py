"""The Numba engine's settings of one sum: few and fixed, chosen by their error bounds alone, which add up to a budget at most.

What is fixed: degrees of polynomials by budget, the lengths that blocks may have, shares of the budget. What follows from the
bounds: how densely transforms must sample, how far delay polynomials reach, how many samples are kept and how they are cut.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
import scipy.optimize
from scipy.special import jv

from pysas.engine import MONOSTATIC, MOVING, STOP_AND_HOP, Parts
from pysas.planning import bounds
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices

# shares of the budget: interpolation of samples, and of whole records, which may hold all at the band's edge; delay
# polynomials, and sine and cosine; wrap-round at a record's hard end; float32 offsets in a block, of leaves' budget as well
INTERPOLATION, WIDE, PHASE, WRAP, ROUNDING, LEAF_ROUNDING = 0.85, 0.3, 0.05, 0.1, 0.15, 0.4
BLOCKS = (64, 48, 32, 16, 8)  # pixels that may share a delay polynomial
BATCH_BYTES = 24 * 2**20
KINDS = {MONOSTATIC: "monostatic", STOP_AND_HOP: "bistatic", MOVING: "moving receivers"}


def choose(scene: Scene, budget: float, engine: Parts, wide: float = 0.0, leaves: bool = False) -> Choices:
    """Settings whose bounds add up to at most `budget`, a relative error.

    `wide` : for data that are bright beside what pixels read, as many times as bright at their records' ends: whole records
    are transformed in float64; `leaves` : for nodes of trees, whose steps are long.
    """
    single = scene.dtype == np.complex64 or budget >= 1e-5 * (1 - 1e-9)
    errors: dict[str, float] = {}
    block, near = 0, 0.0
    if single:
        block, near, errors["rounding"] = delays(scene, budget, engine, LEAF_ROUNDING if leaves else ROUNDING)
    if block:
        errors["delay polynomial"] = PHASE * budget
    for terms in engine.sines["float32"]:
        errors["sine and cosine"] = bounds.trigonometry(terms)[1]
        if errors["sine and cosine"] <= max(PHASE * budget, 2.0**-23 if single else 1e-14):
            break
    run = bounds.longest_run(budget, engine.sums) if single else 0
    if single:  # and as many batches, of 8 traces at least, as the image may be a sum of: see Interpreted.wide
        batches = min(-(-scene.traces // 8), run // 8)
        errors["running sums"] = bounds.running_error(min(run, scene.traces), engine.sums) + bounds.running_error(batches, 1)
    # transforms, whose zeros keep a record's ends from coming round; near these a low-passed trace holds all |f| < 1/2
    errors["wrap-round"] = WRAP * budget
    away = bounds.guard(WRAP * budget / max(wide, 1.0))
    length, margin, taper, beta = (scene.n_sample, 0, 0, 0.0) if wide else crop(scene, budget)
    begin, end = scene.valid[scene.heard].T
    ends = bool(np.any(scene.first[scene.heard] - begin < away) or np.any(end - scene.last[scene.heard] < away))
    band = 0.5 if wide or ends else scene.band
    n_fft = scipy.fft.next_fast_len(length + (away if length == scene.n_sample else 0))
    degree = 7 if not single else 5 if budget < 3e-3 else 3
    left = min((WIDE if wide else INTERPOLATION) * budget, budget - sum(errors.values()))
    rate = max(1.0, np.pi * band / theta_limit(degree, left))
    n_fine = scipy.fft.next_fast_len(math.ceil(n_fft * rate - 1e-9)) if rate > 1 else n_fft
    errors["interpolation"] = interpolation_error(degree, np.pi * band * n_fft / n_fine)
    size = int(length * n_fine / n_fft) * (degree + 1) * (8 if single else 16)
    return Choices(
        precision="float32" if single else "float64", degree=degree, oversampling=n_fine / n_fft, n_fft=n_fft, n_fine=n_fine,
        length=length, margin=margin, taper=taper, beta=beta, block=block, near=near, trigonometry=terms,
        batch=max(8, BATCH_BYTES // size // 8 * 8), delay=KINDS[scene.kind], errors=errors, run=run, wide=bool(wide),
    )  # fmt: skip


def delays(scene: Scene, budget: float, engine: Parts, share: float) -> tuple[int, float, float]:
    """Pixels that share a delay polynomial, the distance from which it holds, and the error of float32 offsets in a block; no
    pixels where delays must be exact.

    The longest block that holds at 0.9 of the nearest range, or else one of 16 pixels, of 8 where 16 round too much.

    sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so the
    polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each way. The
    offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the block, which may
    take `share` of the budget.
    """
    found = 0, 0.0, 2.0**-22
    if scene.lines is None:
        return found
    nodes, wave, eps = engine.nodes["float32"], scene.fc / scene.c, 2.0**-24
    for block in BLOCKS:
        count = even_split(scene.line_length, block)
        half = scene.step * (count - 1) / 2
        turns = 2 * half * scene.slope * wave
        rounding = np.pi * turns * eps + 4 * eps + 4 * np.pi * wave * scene.uneven  # off the line, on both ways
        if rounding > share * budget or (scene.lattice is not None and not scene.lattice.holds(scene.step, count)):
            continue
        scaled = 2 * np.pi * wave * 2 * 1.3 * (2 / (2 * nodes - 1)) * half**nodes / 2 ** (nodes - 1)
        near = max(2 * half, (scaled / (PHASE * budget)) ** (1 / (nodes - 1)))
        found = count, near, rounding
        if near <= 0.9 * scene.nearest or block <= 16:
            break
    return found


def even_split(length: int, block: int) -> int:
    """Pixels per block, at most `block`: blocks of equal size, a multiple of 8 where the line is long."""
    count = -(-length // -(-length // block))
    return min(block, -(-count // 8) * 8) if length > 8 else length


def crop(scene: Scene, budget: float) -> tuple[int, int, int, float]:
    """Samples kept of every trace, those kept beside what pixels need, the taper at each cut end and its beta.

    A smooth cut (the integral of a Kaiser window) of g samples leaves a band-limited trace band-limited to within
    beta = pi sqrt((g delta)^2 - 1), delta the free band up to 1/2.2: exp(-beta) is held to a thousandth of the budget, so that
    a point 60 dB above the scene just outside the cut does no harm. It begins GUARD samples away: a record's own end that is
    nearer stays in, with what the low-pass W makes of it.
    """
    free = 1 / 2.2 - scene.band
    if free < 0.01 or not scene.heard.any():
        return scene.n_sample, 0, 0, 0.0
    beta = math.log(1e3 / budget)
    taper = math.ceil(math.hypot(1, beta / math.pi) / free) + 1
    margin = bounds.guard(budget) + taper
    needed = int(np.max(scene.last[scene.heard] - scene.first[scene.heard])) + 2 + 2 * margin
    return (needed, margin, taper, beta) if needed < 0.9 * scene.n_sample else (scene.n_sample, 0, 0, 0.0)


def interpolation_error(degree: int, theta: float) -> float:
    """Bound of what exp(j theta x), |x| <= 1, lacks of its series 2 j^k J_k(theta) T_k(x) (Jacobi-Anger) beyond `degree`."""
    return float(2 * np.sum(np.abs(jv(degree + np.arange(1, 40), theta))))


def theta_limit(degree: int, error: float) -> float:
    """Largest phase advance over half an interval at which polynomials of `degree` keep `error`: the inverse."""

    def excess(theta: float) -> float:
        return math.log(interpolation_error(degree, theta) / error)

    return float(scipy.optimize.brentq(excess, 1e-2, 9.0, xtol=1e-9))
