"""Convolutional gridding: windows, quadrature weights and the operators between non-uniform samples, modes and images.

An unknown f lives on [-1, 1]^d, d = 1 or 2; its samples are fhat(lambda) = 2^-d integral f(x) exp(-j pi lambda.x) dx at real
lambda, unit spacing being Nyquist's. With a window w > 0 whose transform is small beyond `reach`, the modes of f w are

    (f w)^(l) = integral fhat(lambda) what(l - lambda) dlambda  ~  sum_j alpha_j fhat_j what(l - lambda_j),

a sparse sum, and an FFT and a division by w give f (J. McKay, A. Gelb et al., arXiv:1706.08575, Eqs 1-3; the FTCG band is in
`ftcg`, the frame in `frames`). Windows are even, so what(l - lambda) is real.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.sparse
from numba import njit
from scipy.sparse.linalg import LinearOperator
from scipy.spatial import QhullError, Voronoi
from scipy.special import i0e, wofz

from pysas import _checks, _pool
from pysas._checks import FloatArray

Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.intp]

_SAME = 1e-9  # samples nearer than this, in Nyquist spacings, count as one place
_PIPE_WIDTH = 0.5  # standard deviation of the density kernel, Nyquist spacings: within 1.5 % of flat on an even raster


class Window(Protocol):
    """What gridding needs of a window: its reach in the spectrum, its values in space and its kernel in the spectrum."""

    @property
    def reach(self) -> float:
        """Largest |kappa| at which `kernel` is used, Nyquist spacings."""

    def values(self, x: npt.ArrayLike) -> FloatArray:
        """w(x) > 0 on [-1, 1]."""

    def kernel(self, kappa: npt.ArrayLike) -> FloatArray:
        """Transform of w at |kappa| <= reach; 0 beyond."""


@dataclass(frozen=True)
class Gaussian:
    """w(x) = exp(-x^2/(2 s^2)) (Greengard and Lee 2004).

    Parameters
    ----------
    s : float
        Width, > 0. Wide windows are better conditioned: w(1) = 0.36 at s = 0.7.
    reach : float
        Where the kernel is cut, > 0.
    line : bool
        Transform w over the whole line, which leaves nothing beyond `reach`; else over [-1, 1], whose ends leave tails
        w(1) sin(pi kappa)/(pi kappa). Where f = 0 outside [-1, 1] either is a kernel of f w.

    Raises
    ------
    ValueError, TypeError
        Not finite numbers > 0.
    """

    s: float = 0.7
    reach: float = 4.0
    line: bool = False

    def __post_init__(self) -> None:
        _checks.number("s", self.s, positive=True)
        _checks.number("reach", self.reach, positive=True)

    def values(self, x: npt.ArrayLike) -> FloatArray:
        """w(x)."""
        return np.asarray(np.exp(-(np.asarray(x, dtype=np.float64) ** 2) / (2 * self.s**2)))

    def kernel(self, kappa: npt.ArrayLike) -> FloatArray:
        """(1/2) integral w exp(-j pi kappa x) dx; Faddeeva's w(z) keeps the error function from overflowing."""
        kappa = np.asarray(kappa, dtype=np.float64)
        a = 1 / (self.s * np.sqrt(2))
        b = np.pi * np.abs(kappa) / (2 * a)
        tail = 0.0 if self.line else np.exp(-(a**2)) * np.real(np.exp(-2j * a * b) * wofz(1j * a - b))
        value = np.sqrt(np.pi) / (2 * a) * (np.exp(-(b**2)) - tail)
        return np.where(np.abs(kappa) <= self.reach, value, 0.0)


@dataclass(frozen=True)
class KaiserBessel:
    """The kernel I0(beta sqrt(1 - (kappa/reach)^2))/I0(beta), of compact support, with its exact inverse transform as w.

    Parameters
    ----------
    reach : float
        Half of its support, Nyquist spacings, > 0.
    beta : float, optional
        Default: for images in |x| <= 1/2, twice over-sampled modes (P. J. Beatty, D. G. Nishimura, J. M. Pauly 2005, Eq 5).

    Raises
    ------
    ValueError, TypeError
        Not finite numbers > 0, or beta <= pi sqrt(reach^2 - 1), where w is not positive on [-1, 1].
    """

    reach: float = 4.0
    beta: float | None = None

    def __post_init__(self) -> None:
        reach = _checks.number("reach", self.reach, positive=True)
        least = np.pi * np.sqrt(max(reach**2 - 1, 0.0))
        usual = np.pi * np.sqrt(max(2.25 * reach**2 - 0.8, 0.25))
        beta = _checks.number("beta", usual if self.beta is None else self.beta, positive=True)
        if beta <= least:
            raise ValueError(f"beta={beta!r}: expected more than pi sqrt(reach^2 - 1) = {least:.4g}, or w vanishes in [-1, 1]")
        object.__setattr__(self, "beta", beta)

    @property
    def _beta(self) -> float:
        if self.beta is None:
            raise _checks.InternalError("beta: not set")
        return self.beta

    def values(self, x: npt.ArrayLike) -> FloatArray:
        """integral kernel exp(j pi kappa x) dkappa."""
        square = self._beta**2 - (np.pi * self.reach * np.asarray(x, dtype=np.float64)) ** 2
        root = np.sqrt(np.abs(square))
        with np.errstate(over="ignore", invalid="ignore"):
            growing = np.exp(root - self._beta) * -np.expm1(-2 * root) / (2 * np.where(root > 0, root, 1))
        value = np.where(square > 0, growing, np.exp(-self._beta) * np.sinc(root / np.pi))
        return np.asarray(2 * self.reach * value / i0e(self._beta))

    def kernel(self, kappa: npt.ArrayLike) -> FloatArray:
        """I0(beta sqrt(1 - (kappa/reach)^2))/I0(beta)."""
        inside = 1 - (np.asarray(kappa, dtype=np.float64) / self.reach) ** 2
        argument = self._beta * np.sqrt(np.clip(inside, 0, None))
        return np.where(inside >= 0, i0e(argument) * np.exp(argument - self._beta) / i0e(self._beta), 0.0)


def points_and_modes(points: Any, modes: Any) -> tuple[FloatArray, tuple[int, ...]]:
    """Check samples (M,), (M, 1) or (M, 2) and the largest mode n, one or one per dimension."""
    array = _checks.array_like("points", points)
    array = array[:, None] if array.ndim == 1 else array
    array = _checks.reals("points", array, [("sample", 1), ("sample", 2)], ("sample",))
    if len(array) == 0:
        raise ValueError("points: no samples: expected at least one")
    each = modes if isinstance(modes, tuple) else (modes,) * array.shape[1]
    if len(each) != array.shape[1]:
        raise ValueError(f"modes={modes!r}: expected one number, or {array.shape[1]}")
    return array, tuple(_checks.whole("modes", n, low=0) for n in each)


def taps(places: FloatArray, window: Window) -> tuple[Index, list[FloatArray]]:
    """First grid points (M, 2) within reach of `places` (M, d) and the kernel there, (M, taps) for each of two axes."""
    count = int(np.floor(2 * window.reach)) + 1
    first = np.zeros((len(places), 2), dtype=np.intp)
    weights = []
    for axis, place in enumerate(places.T):
        lowest = np.ceil(place - window.reach)
        weights.append(window.kernel(lowest[:, None] + np.arange(count) - place[:, None]))
        first[:, axis] = np.clip(lowest, -(2.0**40), 2.0**40)  # far beyond any grid: no tap of it lands
    if len(weights) == 1:
        weights.append(np.ones((len(places), 1)))
    return first, weights


class Gridding(LinearOperator):
    """Omega of Eq 3: M samples to the (2 n + 1)^d modes of f w, entries what(l - lambda_j) for |l - lambda_j| <= reach.

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
    Modes are numbered in C order, axis 0 belonging to points[:, 0]. Entries are kept as one factor per axis, so memory is
    O(M reach d), and a product O(M (2 reach)^d).
    """

    def __init__(self, points: npt.ArrayLike, modes: int | tuple[int, ...], window: Window) -> None:
        self.points, self.modes = points_and_modes(points, modes)
        self.window = window
        sizes = [2 * n + 1 for n in self.modes]
        super().__init__(np.dtype(np.float64), (int(np.prod(sizes)), len(self.points)))  # type: ignore[call-arg]  # the stubs know __new__ alone
        self._first, self._weights = taps(self.points + np.array(self.modes), window)
        self._sizes = (sizes[0], sizes[1] if len(sizes) == 2 else 1)

    def _matvec(self, x: npt.NDArray[Any]) -> Complex:
        out = np.zeros(self._sizes, dtype=np.complex128)
        _pool.call(spread, self._first, self._weights[0], self._weights[1], np.asarray(x, dtype=np.complex128).ravel(), out)
        return out.ravel()

    def _rmatvec(self, x: npt.NDArray[Any]) -> Complex:
        out = np.empty(len(self.points), dtype=np.complex128)
        _pool.call(
            gather,
            self._first,
            self._weights[0],
            self._weights[1],
            np.asarray(x, dtype=np.complex128).reshape(self._sizes),
            out,
        )
        return out

    @cached_property
    def sparse(self) -> scipy.sparse.csr_array[Any]:
        """The same as a sparse matrix (L, M) float64."""
        counts = [w.shape[1] for w in self._weights]
        row, column = (self._first[:, axis, None] + np.arange(counts[axis]) for axis in range(2))
        inside = ((row >= 0) & (row < self._sizes[0]))[:, :, None] & ((column >= 0) & (column < self._sizes[1]))[:, None, :]
        value = self._weights[0][:, :, None] * self._weights[1][:, None, :]
        flat = row[:, :, None] * self._sizes[1] + column[:, None, :]
        sample = np.broadcast_to(np.arange(len(self.points))[:, None, None], flat.shape)
        keep = inside & (value != 0)
        return scipy.sparse.csr_array((value[keep], (flat[keep], sample[keep])), shape=self.shape)


class Synthesis(LinearOperator):
    """Phi: modes to the image sum_l c_l exp(j pi l.x)/w(x) at x = -1 + 2 k/size, k = 0 ... size - 1 along each axis.

    Parameters
    ----------
    modes : tuple of int
        Largest mode along each axis.
    size : int or tuple of int
        Points along each axis, each at least 2 n + 1.
    window : Window

    Raises
    ------
    ValueError, TypeError
        Too few points (modes would alias), or not whole numbers.

    Notes
    -----
    One FFT: O(size^d log size).
    """

    def __init__(self, modes: tuple[int, ...], size: int | tuple[int, ...], window: Window) -> None:
        sizes = size if isinstance(size, tuple) else (size,) * len(modes)
        if len(sizes) != len(modes):
            raise ValueError(f"size={size!r}: expected one number, or {len(modes)}")
        for n, points in zip(modes, sizes, strict=True):
            if _checks.whole("size", points) < 2 * n + 1:
                raise ValueError(f"size={points}: expected at least {2 * n + 1} points for modes up to {n}")
        self.modes, self.sizes = modes, sizes
        count = int(np.prod([2 * n + 1 for n in modes]))
        super().__init__(np.dtype(np.complex128), (int(np.prod(sizes)), count))  # type: ignore[call-arg]  # the stubs know __new__ alone
        self._factor = np.ones(sizes)
        self._bins = np.ix_(*(np.arange(-n, n + 1) % points for n, points in zip(modes, sizes, strict=True)))
        self._sign = np.ones([2 * n + 1 for n in modes])
        for axis, (n, points) in enumerate(zip(modes, sizes, strict=True)):
            along = [-1 if i == axis else 1 for i in range(len(modes))]
            self._factor = self._factor / window.values(-1 + 2 * np.arange(points) / points).reshape(along)
            self._sign = self._sign * ((-1.0) ** np.arange(-n, n + 1)).reshape(along)

    def _matvec(self, x: npt.NDArray[Any]) -> Complex:
        spectrum = np.zeros(self.sizes, dtype=np.complex128)
        spectrum[self._bins] = x.reshape(self._sign.shape) * self._sign
        return np.asarray(scipy.fft.ifftn(spectrum, norm="forward") * self._factor).ravel()

    def _rmatvec(self, x: npt.NDArray[Any]) -> Complex:
        spectrum = scipy.fft.fftn(x.reshape(self.sizes) * self._factor)
        return np.asarray(spectrum[self._bins] * self._sign).ravel()


def voronoi(points: npt.ArrayLike) -> FloatArray:
    """Quadrature weights from the samples' Voronoi cells: lengths (d = 1) or areas (d = 2), Nyquist cells.

    Parameters
    ----------
    points : (M,) or (M, d) float

    Returns
    -------
    (M,) float64, > 0
        Cells end at the raster's bounding box widened by half a Nyquist spacing, so one sample has weight 1. Samples within
        1e-9 of each other share their cell.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or not finite.

    Notes
    -----
    The box cuts cells exactly: the raster is mirrored in its sides. O(M log M).
    """
    array, modes = points_and_modes(points, 0)
    places, inverse, count = np.unique(np.round(array / _SAME), axis=0, return_inverse=True, return_counts=True)
    inverse, places = inverse.ravel(), places * _SAME
    low, high = places.min(axis=0) - 0.5, places.max(axis=0) + 0.5
    if len(modes) == 1:
        x = places[:, 0]
        edges = np.concatenate([low, (x[1:] + x[:-1]) / 2, high])
        cell = np.diff(edges)
    else:
        mirrored = [places]
        for axis in range(2):
            for side in (low, high):
                other = places.copy()
                other[:, axis] = 2 * side[axis] - other[:, axis]
                mirrored.append(other)
        try:
            diagram = Voronoi(np.concatenate(mirrored))
        except QhullError as error:  # pragma: no cover - five reflections of a finite raster are in general position
            raise ValueError(f"points: no Voronoi diagram: {error}") from None
        cell = np.empty(len(places))
        for i in range(len(places)):
            corners = diagram.vertices[diagram.regions[diagram.point_region[i]]] - places[i]
            corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]
            x, y = corners.T
            cell[i] = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
    return np.asarray((cell / count)[inverse])


def pipe_menon(points: npt.ArrayLike, iterations: int = 30) -> FloatArray:
    """Quadrature weights by the iteration alpha <- alpha/(K alpha), K a Gaussian of unit integral (Pipe and Menon 1999).

    Parameters
    ----------
    points : (M,) or (M, d) float
    iterations : int
        >= 1.

    Returns
    -------
    (M,) float64, > 0
        Weights whose sum under the kernel, of standard deviation 1/2, is near 1 at every sample. Where the raster is sparser
        they level off at (2 pi 0.5^2)^(d/2), 1.25 or 1.57 Nyquist cells; Voronoi cells grow without bound.

    Raises
    ------
    ValueError, TypeError
        Wrong shape, not finite, or iterations < 1.

    Notes
    -----
    K is Omega^T Omega of a narrower Gaussian on a grid of a third of Nyquist's spacing (its Gaussian shape is right to 1e-3):
    O(iterations M), and memory for that grid over the raster's extent.
    """
    array, modes = points_and_modes(points, 0)
    _checks.whole("iterations", iterations)
    finer = 3
    window = Gaussian(np.sqrt(2) / (np.pi * finer * _PIPE_WIDTH), 4 * finer * _PIPE_WIDTH / np.sqrt(2), line=True)
    places = finer * (array - (array.min(axis=0) + array.max(axis=0)) / 2)
    sizes = tuple(int(n) for n in np.ceil(np.abs(places).max(axis=0) + window.reach))
    omega = Gridding(places, sizes, window)
    weight = np.ones(len(array))
    for _ in range(iterations):
        weight = weight / (np.real(omega.H @ (omega @ weight)) * finer ** len(modes))
    return np.asarray(weight)


# Kernels: they trust their arguments.
@njit(nogil=True, cache=True)
def spread(first, weights0, weights1, values, out):  # type: ignore[no-untyped-def]
    """out[first_j + (a, b)] += weights0[j, a] weights1[j, b] values[j], entries beyond `out` left out."""
    for j in range(values.size):
        row, column = first[j, 0], first[j, 1]
        begin, end = max(0, -column), min(weights1.shape[1], out.shape[1] - column)
        for a in range(max(0, -row), min(weights0.shape[1], out.shape[0] - row)):
            value = weights0[j, a] * values[j]
            for b in range(begin, end):
                out[row + a, column + b] += weights1[j, b] * value


@njit(nogil=True, cache=True)
def gather(first, weights0, weights1, grid, out):  # type: ignore[no-untyped-def]
    """The adjoint of `spread`."""
    for j in range(out.size):
        row, column = first[j, 0], first[j, 1]
        begin, end = max(0, -column), min(weights1.shape[1], grid.shape[1] - column)
        total = 0j
        for a in range(max(0, -row), min(weights0.shape[1], grid.shape[0] - row)):
            partial = 0j
            for b in range(begin, end):
                partial += weights1[j, b] * grid[row + a, column + b]
            total += weights0[j, a] * partial
        out[j] = total
