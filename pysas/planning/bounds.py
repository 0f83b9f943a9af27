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

# Made by `python -m bench.interpolation_table`: GUARD[i] for errors 10^-(1 + i/2).
# fmt: off
GUARD = (5, 8, 22, 27, 45, 68, 108, 159, 262, 404, 642, 1018, 1625, 2572, 4070, 6447, 10213, 16193, 25657, 40675, 64460)
# fmt: on


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
