"""Bounds of the errors that the engines' arithmetic makes, by what makes them: tables and polynomials. No choices."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt
import scipy.optimize
from numpy.polynomial import Chebyshev, Polynomial

from pysas._checks import FloatArray
from pysas.engine import tree

# Tables made by `python -m bench.interpolation_table`: THETA[degree][i] for errors 10^-(1 + i/2), GUARD[i] likewise.
# fmt: off
THETA = {
    1: (
        0.6406309, 0.3570764, 0.2002508, 0.1125128, 0.0632535, 0.035567, 0.0200003, 0.0112469,
        0.0063246, 0.0035566, 0.002, 0.0011247, 0.0006325, 0.0003557, 0.0002, 0.0001125,
        6.32e-05, 3.56e-05, 2e-05, 1.12e-05, 6.3e-06, 3.6e-06, 2e-06,
    ),
    3: (
        2.2029502, 1.6130996, 1.1948211, 0.8900513, 0.6650094, 0.4976756, 0.3727813, 0.2793691,
        0.2094227, 0.1570134, 0.1177302, 0.0882796, 0.066198, 0.0496405, 0.0372247, 0.0279144,
        0.0209328, 0.0156974, 0.0117713, 0.0088273, 0.0066195, 0.0049639, 0.0037224,
    ),
    5: (
        3.948613, 3.1623589, 2.5629358, 2.0910409, 1.7129459, 1.4068107, 1.1573075, 0.9530982,
        0.7854958, 0.647684, 0.5342275, 0.4407442, 0.3636746, 0.3001126, 0.2476771, 0.2044129,
        0.1687115, 0.1392486, 0.1149327, 0.0948639, 0.0782999, 0.0646284, 0.0533442,
    ),
    7: (
        5.7628304, 4.8302489, 4.0945778, 3.4942465, 2.9947886, 2.5741886, 2.2171415, 1.9123686,
        1.651205, 1.4267877, 1.2335575, 1.0669348, 0.9230999, 0.7988365, 0.6914176, 0.5985186,
        0.5181503, 0.4486054, 0.3884151, 0.3363139, 0.2912101, 0.2521608, 0.2183514,
    ),
}
GUARD = (5, 8, 22, 27, 45, 68, 108, 159, 262, 404, 642, 1018, 1625, 2572, 4070, 6447, 10213, 16193, 25657, 40675, 64460)
# fmt: on


def theta_limit(degree: int, error: float) -> float:
    """Largest theta at which degree `degree` keeps `error`: THETA read log-linearly."""
    exponents = 1 + 0.5 * np.arange(len(THETA[degree]))
    return float(np.exp(np.interp(-np.log10(error), exponents, np.log(THETA[degree]))))


def interpolation_error(degree: int, theta: float) -> float:
    """Bound of the interpolation's error at phase advance `theta`: the inverse of `theta_limit`."""
    logs = np.log(THETA[degree])[::-1]
    exponents = (1 + 0.5 * np.arange(len(THETA[degree])))[::-1]
    below = np.log(max(theta, 1e-12))
    if below < logs[0]:
        return float(10.0 ** -exponents[0] * np.exp((degree + 1) * (below - logs[0])))
    return float(10.0 ** -np.interp(below, logs, exponents))


def guard(error: float) -> int:
    """Zeros that keep wrap-round below `error`, 1e-12 at least; below the table's 1e-11 they grow as they do in it."""
    if error < 1e-11:
        return math.ceil(GUARD[-1] * math.pow(1e-11 / max(error, 1e-12), 0.4))
    index = int(np.ceil(2 * (-np.log10(error) - 1) - 1e-9))
    return GUARD[min(max(index, 0), len(GUARD) - 1)]


@functools.cache
def trigonometry(terms: int) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], float]:
    """Polynomials in turns^2 of sin(2 pi t)/t (`terms`) and cos(2 pi t) (`terms` + 1) on |t| <= 1/2, and their error."""

    def sine(q: FloatArray) -> FloatArray:
        t = np.sqrt(q)
        return np.asarray(2 * np.pi * np.sinc(2 * t))

    def cosine(q: FloatArray) -> FloatArray:
        return np.asarray(np.cos(2 * np.pi * np.sqrt(q)))

    fits = []
    worst = 0.0
    q = np.linspace(0, 0.25, 401)
    for function, count, weight in ((sine, terms, np.sqrt(q)), (cosine, terms + 1, np.ones_like(q))):
        series = Chebyshev.interpolate(function, count - 1, domain=[0, 0.25])
        worst = max(worst, float(np.max(np.abs(weight * (series(q) - function(q))))))
        fits.append(tuple(float(v) for v in series.convert(kind=Polynomial).coef))
    return (fits[0], fits[1]), worst


def tree_error(taps: tree.Taps, stages: int) -> float:
    """Bound of a tree's interpolation: along rays the band's worst frequency, across them the mean over a group's pings.

    A stage's error of a component depends on where between nodes it is read, and stages read at unrelated places: they add
    as squares. 1.2 is the margin of the tolerance sweep.
    """
    return 1.2 * math.sqrt(stages) * math.hypot(taps.worst, taps.rms)


def longest_run(budget: float, sums: int) -> int:
    """Traces that `sums` running sums in float32 a pixel may have before they are added to sums in float64.

    They take a twentieth of `budget` where 32 are few enough: shorter ones cost more time than they give.
    """
    run = 256
    while run > 32 and running_error(run, sums) > 0.05 * budget * (1 + 1e-9):
        run //= 2
    return run


def running_error(terms: int, sums: int) -> float:
    """Error of running sums in float32 relative to their end.

    Each addition rounds by at most 2^-24 of what there is by then: of equal terms half of the end on average. They are worst:
    then roundings have one sign for as long as the exponent stays. C++ has one sum a part, which rounds twice a term; in
    simulations of equal random terms it was wrong by 0.17 (rms) to 0.48 terms 2^-24. Numba has four sums a part.
    """
    return terms * sums * 2.0**-25


def ringing(distance: npt.ArrayLike, band: float) -> FloatArray:
    """Bound of what W makes of a record's end `distance` samples away, relative to the samples there.

    W's impulse response falls as 11^2/(pi d^3) = 39/d^3. Of |f| <= band it leaves the more the farther band is from 1/2.2:
    about 1/(1/2.2 - band) samples beside the end add up, without relation rms sqrt(1 + d/5) for d of them.
    """
    d = np.maximum(distance, 1.0)
    layer = 1 / np.maximum(1 / 2.2 - band, 1 / d)
    return np.asarray(np.minimum(0.5, 39 / d**3 * np.sqrt(1 + layer / 5)))


def hushed(error: float, band: float) -> float:
    """Samples from a record's end at which what rings of samples there is at most `error` of them."""
    return float(scipy.optimize.brentq(lambda d: float(ringing(d, band)) - error, 1.0, 1e7, rtol=1e-3))
