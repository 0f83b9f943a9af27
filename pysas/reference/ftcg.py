"""Frame-theoretic convolutional gridding: a banded matrix of quadrature weights that brings gridding near the frame.

Gridding uses Omega D with D diagonal, the frame approximation Psi^+; FTCG uses Omega C with C = 0 but for pairs of neighbouring
samples, designed once per raster (J. McKay, A. Gelb et al., arXiv:1706.08575, Eqs 13-20). A full C = (Psi Omega)^+ gives the
frame approximation itself; a diagonal one is gridding with the best weights (Eq 17).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.sparse
from numba import njit
from scipy.sparse.linalg import LinearOperator, aslinearoperator
from scipy.spatial import cKDTree

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.reference.frames import DENSE, Frame, finite_samples
from pysas.reference.gridding import Complex, Gridding, Index, Synthesis, Window

METHODS = ("lsq", "printed", "joint")
BANDS = ("nearest", "index")
_JOINT = 8000  # most entries of C designed jointly: the normal matrix then has 0.5 GB
# Designs in parts: what Psi^+ needs of a sample's surroundings. On a 30 x 30 jittered raster halos of 2 and 4 already give
# the PSNR of the whole raster's Psi^+ to 0.1 dB; more samples than modes keep the parts overdetermined.
_CELL, _MODES_HALO, _SAMPLES_HALO = 6.0, 3.0, 6.0
_RIDGE = 1e-6  # its square is the ridge's share at least: normal equations hold no condition beyond 1e8
_DEPENDENT = 1e-13  # eigenvalues of Omega^T Omega below this share of the largest count as 0: coincident columns

Row = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class FTCG:
    """A design: apply it to any number of data sets.

    Attributes
    ----------
    gridding : Gridding
        Omega (L, M).
    matrix : (M, M) sparse float64
        C; column j holds the weights by which sample j enters at its neighbours.
    method, band : str
    ill_posed : bool
        Whether the frame, or one of its parts, left coefficients undetermined.
    """

    gridding: Gridding
    matrix: scipy.sparse.csr_array[Any]
    method: str
    band: str
    ill_posed: bool

    @property
    def operator(self) -> LinearOperator:
        """Omega C: samples (M,) to coefficients (L,); also a right preconditioner of `Frame.solve`."""
        return self.gridding @ aslinearoperator(self.matrix)

    def coefficients(self, data: npt.ArrayLike) -> Complex:
        """Coefficients (L,) or (L, K) of f w from samples (M,) or (M, K). O((2 r + 1 + (2 reach)^d) M) each."""
        samples = finite_samples("data", data, self.gridding.shape[1])
        return np.asarray(self.gridding @ (self.matrix @ samples))

    def image(self, data: npt.ArrayLike, size: int | tuple[int, ...]) -> Complex:
        """f from samples (M,) at x = -1 + 2 k/size along each axis: `coefficients` and one FFT."""
        synthesis = Synthesis(self.gridding.modes, size, self.gridding.window)
        return np.asarray(synthesis @ self.coefficients(data)).reshape(synthesis.sizes)


def design(
    points: npt.ArrayLike,
    modes: int | tuple[int, ...],
    window: Window,
    r: int,
    *,
    method: str = "lsq",
    band: str = "nearest",
    weights: npt.ArrayLike | None = None,
    rcond: float | None = None,
    mu: float = 1e-4,
    parts: bool | None = None,
    threads: int | None = None,
) -> FTCG:
    """Design the banded matrix C for one raster.

    Parameters
    ----------
    points : (M,) or (M, d) float, d = 1 or 2
        lambda, Nyquist spacings.
    modes : int or tuple of int
        Largest mode n along each axis.
    window : Window
    r : int
        2 r + 1 neighbours count for each sample (all, where there are fewer), >= 0.
    method : {"lsq", "printed", "joint"}
        "lsq": each column minimises ||(Omega C - Psi^+)_j||, which for r = 0 is Eq 17. "printed": Eq 20, the band of
        (Psi Omega)^+. "joint": the C of least ||Omega C Psi - 1||_F^2 + mu tr(N)/dim ||C||_F^2, N the normal matrix.
    band : {"nearest", "index"}
        Neighbours by distance, or |j - j'| <= r as printed (they depend on how the raster is numbered).
    weights : (M,) float, optional
        Density: rows of Psi and data are multiplied by its square root. For clustered rasters.
    rcond : float, optional
        Of the frame's singular values (see `Frame`). In parts a ridge of (rcond s)^2, s a bound of the largest of them and
        rcond at least 1e-6, stands for the cut.
    mu : float
        Regularisation of "joint", >= 0.
    parts : bool, optional
        "lsq": take Psi^+ from the surroundings of each cell of samples, so that cost is O(M). Default: where Psi has more
        than 1e7 entries.
    threads : int, optional
        For parts; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.

    Returns
    -------
    FTCG

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; a design too large for its method.

    Notes
    -----
    "lsq" costs O(M L^2 + M (2 r + 1)^3), in parts O(M); "printed" O(M^3); "joint" O((M (2 r + 1))^3).
    """
    omega = Gridding(points, modes, window)
    r = _checks.whole("r", r, low=0)
    _checks.choice("method", method, METHODS)
    _checks.choice("band", band, BANDS)
    mu, workers = _checks.number("mu", mu, low=0.0), _checks.threads(threads)
    frame = Frame(points, modes, window, weights=weights, rcond=rcond)
    m, count = frame.sampling.shape
    near = _neighbours(omega.points, r, band)
    if parts is None:
        parts = m * count > DENSE
    if parts and method != "lsq":
        raise ValueError(f"method={method!r}: {m} samples x {count} modes: expected 'lsq', the only design in parts")
    if parts:
        columns, ill_posed = _in_parts(frame, omega, near, workers)
    elif method == "lsq":
        columns = _least_squares(omega.sparse.tocsc(), slice(None), frame.pseudo_inverse, near)
        ill_posed = frame.ill_posed
    elif method == "printed":
        if m * m > DENSE:
            raise ValueError(f"method='printed': {m} samples: expected at most {int(np.sqrt(DENSE))}")
        product = frame.root[:, None] * np.asarray(omega.sparse.T @ frame.sampling.dense.T).T
        # Psi Omega has rank L at most: what lies below sqrt(eps) is rounding
        inverse = np.linalg.pinv(product, rcond=max(float(np.sqrt(np.finfo(np.float64).eps)), frame.rcond)) * frame.root
        columns = [inverse[i, j] for j, i in enumerate(near)]
        ill_posed = frame.ill_posed
    else:
        columns = _joint(frame, omega, near, mu)
        ill_posed = frame.ill_posed
    lengths = [len(i) for i in near]
    entries = np.concatenate(columns), (np.concatenate(near), np.repeat(np.arange(m), lengths))
    return FTCG(omega, scipy.sparse.csr_array(entries, shape=(m, m)), method, band, ill_posed)


def _neighbours(points: FloatArray, r: int, band: str) -> list[Row]:
    """For each sample the ascending numbers of those in its band."""
    m = len(points)
    if band == "index":
        return [np.arange(max(0, j - r), min(m, j + r + 1)) for j in range(m)]
    _, near = cKDTree(points).query(points, min(2 * r + 1, m))
    near = near.reshape(m, -1)
    # among coincident samples the tree may leave out the sample itself
    near[:, -1] = np.where(np.any(near == np.arange(m)[:, None], axis=1), near[:, -1], np.arange(m))
    return list(np.sort(near, axis=1))


def _least_squares(omega: Any, rows: Index | slice, inverse: FloatArray, near: list[Row]) -> list[FloatArray]:
    """Columns of C with the bands `near`: least squares of Omega's columns against `inverse`, Psi^+ on `rows`, 0 elsewhere."""
    every, place = np.unique(np.concatenate(near), return_inverse=True)
    used = omega[:, every]
    gram, right = (used.T @ used).toarray(), used.tocsr()[rows].T @ inverse
    columns, start = [], 0
    solver, last = np.empty((0, 0)), np.empty(0, dtype=np.intp)
    for k, band in enumerate(near):
        i = place[start : start + len(band)]
        start += len(band)
        if not np.array_equal(i, last):
            solver, last = np.linalg.pinv(gram[np.ix_(i, i)], rcond=_DEPENDENT, hermitian=True), i
        columns.append(np.asarray(solver @ right[i, k]))
    return columns


def _in_parts(frame: Frame, omega: Gridding, near: list[Row], threads: int) -> tuple[list[FloatArray], bool]:
    """`_least_squares` cell by cell, with the inverse of the modes and samples around each.

    There (Psi^T Psi + ridge)^-1 Psi^T stands for Psi^+: a small matrix for each of many threads, which BLAS would give threads
    of its own and slow down tenfold.
    """
    points, modes = omega.points, omega.modes
    _, cell = np.unique(np.floor(points / _CELL), axis=0, return_inverse=True)
    order = np.argsort(cell.ravel(), kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(cell.ravel()[order])) + 1)
    columns: list[FloatArray] = [np.empty(0)] * len(points)
    ill_posed = [False] * len(groups)
    sparse, tree = omega.sparse.tocsc(), cKDTree(points)
    first, second = frame.sampling.factors
    last = (*modes, 0)[1]

    def task(number: int) -> None:
        mine = groups[number]
        low, high = points[mine].min(axis=0), points[mine].max(axis=0)
        middle, reach = (low + high) / 2, float(np.max(high - low)) / 2 + _SAMPLES_HALO
        around = np.array(sorted(tree.query_ball_point(middle, reach, p=np.inf)))
        rows = [
            np.arange(max(-n, int(np.ceil(a - _MODES_HALO))), min(n, int(np.floor(b + _MODES_HALO))) + 1) + n
            for n, a, b in zip(modes, low, high, strict=True)
        ] + [np.zeros(1, dtype=int)]
        flat = (rows[0][:, None] * (2 * last + 1) + rows[1]).ravel()
        if flat.size == 0:  # samples beyond the modes' spectrum: nothing of them is wanted
            for j in mine:
                columns[j] = np.zeros(len(near[j]))
            return
        psi = (first[around][:, rows[0], None] * second[around][:, None, rows[1]]).reshape(around.size, flat.size)
        psi *= frame.root[around, None]
        inverse = psi[np.searchsorted(around, mine)].T.copy()
        ill_posed[number] = _pool.call(_ridge_solve, psi, inverse, max(frame.rcond, _RIDGE) ** 2)
        inverse *= frame.root[mine]
        for j, column in zip(mine, _least_squares(sparse, flat, inverse, [near[j] for j in mine]), strict=True):
            columns[j] = column

    _pool.run(task, len(groups), threads)
    return columns, any(ill_posed)


def _joint(frame: Frame, omega: Gridding, near: list[Row], mu: float) -> list[FloatArray]:
    """All entries at once: minimise ||Omega C Psi - 1||_F^2 + mu tr(N)/dim ||C||_F^2."""
    row = np.concatenate(near)
    column = np.repeat(np.arange(len(near)), [len(i) for i in near])
    if row.size > _JOINT:
        raise ValueError(f"method='joint': {row.size} entries of C: expected at most {_JOINT}")
    psi = frame.root[:, None] * frame.sampling.dense
    gram, data = (omega.sparse.T @ omega.sparse).toarray(), psi @ psi.T
    normal = gram[np.ix_(row, row)] * data[np.ix_(column, column)]
    right = np.asarray(omega.sparse.T @ psi.T)[row, column]
    ridge = mu * np.trace(normal) / row.size
    if ridge > 0:
        normal[np.diag_indices_from(normal)] += ridge
        value = scipy.linalg.solve(normal, right, assume_a="pos")
    else:  # mu = 0, or no sample reaches a mode
        value = scipy.linalg.lstsq(normal, right)[0]
    value = np.asarray(value) * frame.root[column]
    return np.split(value, np.cumsum([len(i) for i in near])[:-1])


# Kernel: it trusts its arguments.
@njit(nogil=True, cache=True)
def _ridge_solve(psi, right, share):  # type: ignore[no-untyped-def]
    """right <- (psi^T psi + ridge)^-1 right in place by Cholesky, ridge = share times the norm's bound; whether it mattered."""
    m, n = psi.shape
    gram = np.zeros((n, n))
    for k in range(m):
        for i in range(n):
            value = psi[k, i]
            for j in range(i + 1):
                gram[i, j] += value * psi[k, j]
    largest = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += abs(gram[max(i, j), min(i, j)])
        largest = max(largest, total)
    ridge = share * largest if largest > 0.0 else 1.0
    least = np.inf
    for i in range(n):
        for j in range(i + 1):
            total = gram[i, j] + (ridge if i == j else 0.0)
            for k in range(j):
                total -= gram[i, k] * gram[j, k]
            if i == j:
                least = min(least, total)
                gram[i, i] = np.sqrt(max(total, ridge))
            else:
                gram[i, j] = total / gram[j, j]
    for column in range(right.shape[1]):
        for i in range(n):
            total = right[i, column]
            for k in range(i):
                total -= gram[i, k] * right[k, column]
            right[i, column] = total / gram[i, i]
        for i in range(n - 1, -1, -1):
            total = right[i, column]
            for k in range(i + 1, n):
                total -= gram[k, i] * right[k, column]
            right[i, column] = total / gram[i, i]
    return bool(m < n or least < 4 * ridge)
