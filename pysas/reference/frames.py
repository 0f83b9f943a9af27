"""Frame approximation from non-uniform Fourier samples: the pseudo-inverse of the samples of an admissible frame.

Modes phi_l = exp(j pi l.x)/w(x), |l| <= n, have the samples Psi_jl = <phi_l, psi_j> = (1/w)^(lambda_j - l), real because w is
even; coefficients Psi^+ fhat reproduce any f in their span exactly (G. Song, A. Gelb 2013; arXiv:1706.08575, Eqs 8-12). In two
dimensions every row of Psi is a product of rows of two small matrices, which is all that is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import scipy.linalg
from scipy.sparse.linalg import LinearOperator, lsmr
from scipy.special import roots_legendre

from pysas import _checks
from pysas._checks import FloatArray
from pysas.reference.gridding import Complex, Window, points_and_modes

DENSE = 1e7  # most entries of a matrix that is decomposed: 80 MB, some ten seconds


class Sampling(LinearOperator):
    """Psi of Eq 9: coefficients of the modes phi_l to samples fhat(lambda_j), (M, L).

    Parameters
    ----------
    points : (M,) or (M, d) float, d = 1 or 2
        lambda, Nyquist spacings.
    modes : int or tuple of int
        Largest mode n along each axis, >= 0.
    window : Window

    Raises
    ------
    ValueError, TypeError
        Wrong shape, not finite, or no samples.

    Notes
    -----
    The transform of 1/w is a Gauss-Legendre sum with enough nodes for its fastest oscillation: right to 1e-14. A product costs
    O(M L), as d small matrix products.
    """

    def __init__(self, points: npt.ArrayLike, modes: int | tuple[int, ...], window: Window) -> None:
        self.points, self.modes = points_and_modes(points, modes)
        self.window = window
        self.factors = [_transform(self.points[:, axis], n, window) for axis, n in enumerate(self.modes)]
        if len(self.factors) == 1:
            self.factors.append(np.ones((len(self.points), 1)))
        count = int(np.prod([2 * n + 1 for n in self.modes]))
        super().__init__(np.dtype(np.float64), (len(self.points), count))  # type: ignore[call-arg]  # the stubs know __new__ alone

    def _matvec(self, x: npt.NDArray[Any]) -> Complex:
        first, second = self.factors
        grid = np.ascontiguousarray(x, dtype=np.complex128).reshape(first.shape[1], second.shape[1])
        # real matrices against complex vectors: as twice as many real columns
        partial = (first @ grid.view(np.float64)).view(np.complex128)
        return np.asarray(np.einsum("jl,jl->j", partial, second))

    def _rmatvec(self, x: npt.NDArray[Any]) -> Complex:
        first, second = self.factors
        spread = np.ascontiguousarray(x, dtype=np.complex128).reshape(-1, 1) * second
        return (first.T @ spread.view(np.float64)).view(np.complex128).ravel()

    @cached_property
    def dense(self) -> FloatArray:
        """The matrix (M, L) float64."""
        first, second = self.factors
        return (first[:, :, None] * second[:, None, :]).reshape(self.shape)


def _transform(points: FloatArray, n: int, window: Window) -> FloatArray:
    """(1/2) integral_-1^1 exp(-j pi (lambda - l) x)/w(x) dx for |l| <= n."""
    fastest = float(np.max(np.abs(points), initial=0.0)) + n
    nodes, weights = roots_legendre(48 + int(np.ceil(2 * fastest)))
    modes = np.arange(-n, n + 1)
    # the integrand is even in x: cos(pi (lambda - l) x), split into products of cosines and of sines
    away, along = np.pi * np.outer(points, nodes), np.pi * np.outer(nodes, modes)
    weights = weights / (2 * window.values(nodes))
    return np.asarray((np.cos(away) * weights) @ np.cos(along) + (np.sin(away) * weights) @ np.sin(along))


@dataclass(frozen=True, eq=False)
class FrameSolution:
    """Coefficients of the modes and what is known of their quality.

    Attributes
    ----------
    coefficients : (L,) or (L, K) complex128
        Of phi_l; of least norm where the samples leave some undetermined.
    residual : float
        ||Psi c - fhat||/||fhat|| (weighted as the solution is); 0 for zero data.
    iterations : int
        Of LSMR, the most of any column; 0 for the SVD.
    ill_posed : bool
        SVD: singular values were dropped, or there are fewer samples than modes. LSMR: it did not reach its tolerance.
    """

    coefficients: Complex
    residual: float
    iterations: int
    ill_posed: bool


class Frame:
    """The frame approximation of one raster, for any number of data sets.

    Parameters
    ----------
    points : (M,) or (M, d) float, d = 1 or 2
        lambda, Nyquist spacings.
    modes : int or tuple of int
        Largest mode n along each axis.
    window : Window
    weights : (M,) float, optional
        Density of quadrature: rows and data are multiplied by its square root. Default 1.
    rcond : float, optional
        Singular values below rcond times the largest are dropped; default max(M, L) eps, as for a matrix rank.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """

    def __init__(
        self,
        points: npt.ArrayLike,
        modes: int | tuple[int, ...],
        window: Window,
        *,
        weights: npt.ArrayLike | None = None,
        rcond: float | None = None,
    ) -> None:
        self.sampling = Sampling(points, modes, window)
        m, count = self.sampling.shape
        if weights is None:
            self.root = np.ones(m)
        else:
            given = _checks.reals("weights", weights, [(m,)], ("sample",))
            if np.any(given < 0):
                raise ValueError(f"weights: {given.min():g} at sample {int(given.argmin())}: expected weights >= 0")
            self.root = np.sqrt(given)
        self._least = max(m, count) * np.finfo(np.float64).eps
        self.rcond = self._least if rcond is None else _checks.number("rcond", rcond, low=0.0, high=1.0)

    @cached_property
    def _svd(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        m, count = self.sampling.shape
        if m * count > DENSE:
            raise ValueError(f"{m} samples x {count} modes: expected at most {DENSE:g} entries to decompose; use method='lsmr'")
        u, s, v = scipy.linalg.svd(self.root[:, None] * self.sampling.dense, full_matrices=False)
        return np.asarray(u), np.asarray(s), np.asarray(v)

    @property
    def singular_values(self) -> FloatArray:
        """Of the weighted Psi, descending, min(M, L) of them."""
        return self._svd[1]

    @property
    def rank(self) -> int:
        """Singular values kept."""
        s = self.singular_values
        return int(np.count_nonzero(s > self.rcond * s[0])) if s[0] > 0 else 0

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the weighted Psi; inf where M < L or the smallest is 0."""
        s = self.singular_values
        return float(s[0] / s[-1]) if s.size == self.sampling.shape[1] and s[-1] > 0 else float("inf")

    @property
    def ill_posed(self) -> bool:
        """Whether some coefficients are undetermined: rank below L."""
        return self.rank < self.sampling.shape[1]

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Frame bounds A, B: A ||f||^2 <= sum_j weight_j |<f, psi_j>|^2 <= B ||f||^2 for f in the span of the modes (Eq 4)."""
        first, second = (
            factor @ np.linalg.inv(_root_of_gram(n, self.sampling.window)).T if n is not None else factor
            for factor, n in zip(self.sampling.factors, (*self.sampling.modes, None)[:2], strict=True)
        )
        m, count = self.sampling.shape
        if m * count > DENSE:
            raise ValueError(f"{m} samples x {count} modes: expected at most {DENSE:g} entries to decompose")
        scaled = self.root[:, None] * (first[:, :, None] * second[:, None, :]).reshape(m, count)
        s = scipy.linalg.svdvals(scaled)
        return (float(s[-1] ** 2) if m >= count else 0.0), float(s[0] ** 2)

    @cached_property
    def pseudo_inverse(self) -> FloatArray:
        """Psi^+ (L, M) of the kept singular values, weights included."""
        u, s, v = self._svd
        kept = slice(0, self.rank)
        return np.asarray((v[kept].T / s[kept]) @ u[:, kept].T * self.root)

    def solve(
        self,
        data: npt.ArrayLike,
        *,
        method: str = "svd",
        preconditioner: LinearOperator | None = None,
        accuracy: float = 1e-10,
        iterations: int | None = None,
    ) -> FrameSolution:
        """Coefficients of the modes from samples.

        Parameters
        ----------
        data : (M,) or (M, K) real or complex
            Samples fhat(lambda_j) of one or K data sets.
        method : {"svd", "lsmr"}
            Truncated SVD, or LSMR (Fong and Saunders 2011) with the operator alone. An `rcond` above the default then damps
            instead, by rcond times the largest singular value (of a power iteration).
        preconditioner : LinearOperator (L, M), optional
            For LSMR: c = P y is sought (`ftcg.FTCG.operator` is one), without damping.
        accuracy : float
            LSMR stops at this relative size of the residual of the normal equations (its atol and btol).
        iterations : int, optional
            Most iterations of LSMR; default 10 max(M, L).

        Returns
        -------
        FrameSolution

        Raises
        ------
        ValueError, TypeError
            Data of the wrong shape or not finite; a matrix too large for the SVD.
        """
        m, count = self.sampling.shape
        _checks.choice("method", method, ("svd", "lsmr"))
        samples = finite_samples("data", data, m)
        columns = self.root[:, None] * np.asarray(samples, dtype=np.complex128).reshape(m, -1)
        if method == "svd":
            u, s, v = self._svd
            kept = slice(0, self.rank)
            found = v[kept].T @ ((u[:, kept].T @ columns) / s[kept, None])
            used, failed = 0, self.ill_posed
        else:
            accuracy = _checks.number("accuracy", accuracy, low=0.0, high=1.0)
            limit = 10 * max(m, count) if iterations is None else _checks.whole("iterations", iterations)
            system = _Weighted(self.sampling, self.root)
            inner = system if preconditioner is None else system @ preconditioner
            damp = self.rcond * _norm(system) if preconditioner is None and self.rcond > self._least else 0.0
            found, used, failed = np.zeros((count, columns.shape[1]), dtype=np.complex128), 0, False
            for k in range(columns.shape[1]):
                result = lsmr(inner, cast(Any, columns[:, k]), damp, atol=accuracy, btol=accuracy, conlim=0, maxiter=limit)
                found[:, k] = result[0] if preconditioner is None else preconditioner @ result[0]
                used, failed = max(used, int(result[2])), failed or result[1] not in (0, 1, 2, 4, 5)
        missed = self.root[:, None] * (self.sampling @ found) - columns
        size = float(np.linalg.norm(columns))
        shape = (count, *samples.shape[1:])
        return FrameSolution(
            np.asarray(found).reshape(shape), float(np.linalg.norm(missed)) / size if size > 0 else 0.0, used, failed
        )


class _Weighted(LinearOperator):
    """Rows of an operator times `root`."""

    def __init__(self, sampling: Sampling, root: FloatArray) -> None:
        super().__init__(sampling.dtype, sampling.shape)  # type: ignore[call-arg]  # the stubs know __new__ alone
        self._sampling, self._root = sampling, root

    def _matvec(self, x: npt.NDArray[Any]) -> Complex:
        return np.asarray(self._root * (self._sampling @ x.ravel()))

    def _rmatvec(self, x: npt.NDArray[Any]) -> Complex:
        return np.asarray(self._sampling.H @ (self._root * x.ravel()))


def _norm(system: _Weighted) -> float:
    """Largest singular value, from below, within some per cent."""
    vector = np.ones(system.shape[1], dtype=np.complex128)
    size = 0.0
    for _ in range(10):
        vector = np.asarray(system.H @ (system @ vector))
        size = float(np.linalg.norm(vector))
        if size == 0:
            break
        vector /= size
    return float(np.sqrt(size))


def finite_samples(name: str, data: npt.ArrayLike, m: int) -> npt.NDArray[Any]:
    """Return `data` as a finite (m,) or (m, K) real or complex array."""
    array = _checks.array_like(name, data)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"{name}: expected real or complex numbers, found dtype {array.dtype}")
    if array.ndim not in (1, 2) or array.shape[0] != m or array.size == 0:
        raise ValueError(f"{name}: expected shape ({m},) or ({m}, K), found {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name}: {array[where]} at sample {where[0]}: expected finite values")
    return array


def _root_of_gram(n: int, window: Window) -> FloatArray:
    """Cholesky factor R, R R^T = <phi_l, phi_l'> of one axis."""
    nodes, weights = roots_legendre(64 + 4 * n)
    values = np.cos(np.pi * np.outer(np.arange(2 * n + 1), nodes)) @ (weights / (2 * window.values(nodes) ** 2))
    return np.asarray(np.linalg.cholesky(scipy.linalg.toeplitz(values)))
