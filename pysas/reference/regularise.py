"""Enhancement of an image's magnitude by H1, total variation or BV-type regularisation.

K. Ito et al., Section 5: S minimises |S - s|^2 + beta sum phi(|grad S|^2), with a phi that smooths where the image is grey and
keeps edges and flat parts. The middle of its derivative's print is lost; what stands here is the only continuous phi' with
their three ranges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import cg

from pysas import _checks
from pysas._checks import FloatArray

KINDS = ("bv", "tv", "h1")
_SMALLEST = 1e-4  # of delta, or for TV of 1: below it phi' stays, so that flat parts keep a finite weight
_CG = 1e-5  # relative residual of the conjugate gradients, from the last iterate on


@dataclass(frozen=True, eq=False)
class Enhanced:
    """An enhanced magnitude and how it was made.

    Attributes
    ----------
    data : (row, column) float64
    beta : float
        The weight that was used.
    energy : (n + 1,) float64
        |S - s|^2 + beta sum phi(|grad S|^2), from S = s on: it never grows.
    iterations : int
    converged : bool
        The change fell below `tolerance`.
    """

    data: FloatArray
    beta: float
    energy: FloatArray
    iterations: int
    converged: bool


def phi(square: npt.ArrayLike, kind: str = "bv", delta: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """phi and its derivative at squared gradients, in units of the gradient that is an edge's.

    Parameters
    ----------
    square : array_like
        |grad S|^2/g0^2, >= 0.
    kind : {"bv", "tv", "h1"}
        "h1": phi = t^2. "tv": 2 t. "bv": 2 t - 1 + delta for t >= 1 (edges), t^2 + delta for delta <= t^2 <= 1 (grey), 2
        sqrt(delta) t below (flat). All convex, and concave in t^2, which makes the iteration decrease the energy.
    delta : float
        In (0, 1]; "bv" alone. At 1 it is "tv".

    Returns
    -------
    phi, derivative : float64 arrays
        The derivative is held below 1e-4 delta (TV: 1e-4), and phi goes on there as a parabola: Huber's function.
    """
    kind = _checks.choice("kind", kind, KINDS)
    delta = _delta(delta)
    sigma = np.asarray(square, dtype=np.float64)
    if kind == "h1":
        return sigma, np.ones_like(sigma)
    low = 1.0 if kind == "tv" else delta
    held = _SMALLEST * low
    root = np.sqrt(np.maximum(sigma, held))
    flat = np.where(sigma < held, np.sqrt(low / held) * (sigma + held), 2 * np.sqrt(low) * root)
    value = np.where(sigma < low, flat, np.where(sigma < 1, sigma + low, 2 * root - 1 + low))
    derivative = np.where(sigma < low, np.sqrt(low) / root, np.where(sigma < 1, 1.0, 1 / root))
    return np.asarray(value), np.asarray(derivative)


def enhance(
    image: npt.ArrayLike,
    beta: float | None = None,
    *,
    noise: float | None = None,
    kind: str = "bv",
    delta: float = 0.1,
    gradient: float | None = None,
    tolerance: float = 1e-4,
    iterations: int = 100,
) -> Enhanced:
    """Enhance a magnitude image; the weight is given, or follows from the noise.

    Parameters
    ----------
    image : (row, column) array_like
        Real, such as np.abs(image.data).
    beta : float, optional
        Weight of the regularisation, in units of `image`'s gradient squared, > 0. Default: by the discrepancy principle, the
        beta at which the rms of S - s is `noise`.
    noise : float, optional
        Standard deviation of the noise. Default: `noise_level(image)`. Not used where beta is given.
    kind, delta
        See `phi`.
    gradient : float, optional
        Difference between neighbours that separates grey from edge, > 0. Default: three times the noise's, 3 sqrt(2) noise.
    tolerance : float
        Stop when S changes by less than this, relative to its norm.
    iterations : int
        At most.

    Returns
    -------
    Enhanced

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; a complex or non-finite image; noise that no beta can reach.

    Notes
    -----
    Euler's equation S - beta div(phi' grad S) = s as a fixed point: phi' from the last S, then conjugate gradients (scaled by
    the diagonal) for (I + beta G^T W G) S = s, G forward differences with Neumann ends. As phi is concave in the square, each
    quadratic majorises the energy, and conjugate gradients started at the last S only decrease it. O(pixels) per product.
    """
    data = _image(image)
    kind = _checks.choice("kind", kind, KINDS)
    delta = _delta(delta)
    tolerance = _checks.number("tolerance", tolerance, positive=True)
    iterations = _checks.whole("iterations", iterations)
    sd = None if noise is None else _checks.number("noise", noise, positive=True)
    if sd is None and (beta is None or gradient is None):
        sd = noise_level(data)
        if sd == 0:
            raise ValueError("noise=None: the image's noise is estimated as 0: expected `noise`, or `beta` and `gradient`")
    scale = 3 * np.sqrt(2) * (sd or 1.0) if gradient is None else _checks.number("gradient", gradient, positive=True)
    problem = _Problem(data / scale, kind, delta, tolerance, iterations)
    if beta is None:
        if sd is None:
            raise _checks.InternalError("noise: not known")
        beta = _discrepancy(problem, sd / scale)
    found, energy, count, converged = problem.solve(_checks.number("beta", beta, positive=True))
    return Enhanced(found * scale, float(beta), energy * scale**2, count, converged)


def noise_level(image: npt.ArrayLike) -> float:
    """Standard deviation of white noise by the median of |diagonal second differences| (J. Immerkaer's mask, made robust).

    The differences d = s00 - s01 - s10 + s11 of noise have the deviation 2 sd, and their median magnitude is 0.6745 of it;
    edges along an axis and planes cancel.
    """
    data = _image(image)
    if min(data.shape) < 2:
        raise ValueError(f"image: expected at least 2 x 2 pixels, found shape {data.shape}")
    return float(np.median(np.abs(np.diff(np.diff(data, axis=0), axis=1))) / (0.6744897501960817 * 2))


class _Problem:
    """The energy of one image, in units of the gradient that is an edge's."""

    def __init__(self, data: FloatArray, kind: str, delta: float, tolerance: float, iterations: int) -> None:
        self.data, self.kind, self.delta = data.ravel(), kind, delta
        self.tolerance, self.iterations, self.shape = tolerance, iterations, data.shape
        rows, columns = (_differences(n) for n in data.shape)
        eye = [scipy.sparse.identity(n, format="csr") for n in data.shape]
        self.gradient = scipy.sparse.vstack([scipy.sparse.kron(rows, eye[1]), scipy.sparse.kron(eye[0], columns)]).tocsr()

    def terms(self, s: FloatArray) -> tuple[float, FloatArray]:
        """Sum of phi, and phi' of each pixel."""
        g = self.gradient @ s
        value, weight = phi(g[: s.size] ** 2 + g[s.size :] ** 2, self.kind, self.delta)
        return float(value.sum()), weight

    def solve(self, beta: float) -> tuple[FloatArray, FloatArray, int, bool]:
        """Minimise: the minimiser, energies, iterations, whether it converged."""
        s = self.data.copy()
        total, weight = self.terms(s)
        energy, converged, count = [beta * total], False, 0
        while count < self.iterations and not converged:
            w = scipy.sparse.diags_array(np.concatenate([weight, weight]))
            a = (scipy.sparse.identity(s.size) + beta * (self.gradient.T @ w @ self.gradient)).tocsr()
            new, _ = cg(a, self.data, x0=s, rtol=_CG, maxiter=2000, M=scipy.sparse.diags_array(1 / a.diagonal()))
            converged = bool(np.linalg.norm(new - s) <= self.tolerance * np.linalg.norm(new))
            s, count = new, count + 1
            total, weight = self.terms(s)
            energy.append(float(np.sum((s - self.data) ** 2)) + beta * total)
            converged = converged or self.kind == "h1"
        return s.reshape(self.shape), np.array(energy), count, converged


def _discrepancy(problem: _Problem, noise: float) -> float:
    """The beta at which the rms of what is taken out is `noise`; it grows with beta."""

    def excess(log_beta: float) -> float:
        found = problem.solve(float(np.exp(log_beta)))[0]
        return float(np.sqrt(np.mean((found.ravel() - problem.data) ** 2)) / noise - 1)

    most = float(np.std(problem.data))
    if noise >= most:
        raise ValueError(f"noise: {noise / most:.3g} of the image's own deviation: expected less, nothing would be left of it")
    low = -4.0
    while excess(low) > 0:
        low -= 4.0
    high = low + 1.0
    while excess(high) < 0:  # small steps: solutions for too large a beta cost the most
        low, high = high, high + 1.0
    return float(np.exp(brentq(excess, low, high, xtol=0.02)))


def _differences(n: int) -> scipy.sparse.csr_array:
    """Forward differences (n, n) with a last row of zeros."""
    ones = np.ones(n)
    ones[-1] = 0
    return (scipy.sparse.eye_array(n, k=1) - scipy.sparse.diags_array(ones)).tocsr()


def _image(image: npt.ArrayLike) -> FloatArray:
    data = _checks.reals("image", image, [("row", "column")], ("row", "column"))
    if data.size == 0:
        raise ValueError(f"image: expected at least one pixel, found shape {data.shape}")
    return data


def _delta(delta: float) -> float:
    delta = _checks.number("delta", delta, positive=True)
    if delta > 1:
        raise ValueError(f"delta={delta!r}: expected a number in (0, 1]")
    return delta
