"""Non-uniform FFT of type 3: sums of exp(j k.x) from any wavenumbers to any points, to a stated accuracy.

FINUFFT where it is installed, else two griddings and an FFT: strengths are spread to an even grid of wavenumbers, transformed
to an even grid of points and gathered at the targets, with Kaiser-Bessel kernels over grids twice over-sampled in both spaces
(J.-Y. Lee, L. Greengard 2005; A. H. Barnett, J. Magland, L. af Klinteberg 2019).
"""

from __future__ import annotations

import importlib.util

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.reference.frames import finite_samples
from pysas.reference.gridding import Complex, KaiserBessel, gather, spread, taps

LIBRARIES = ("auto", "finufft", "own")


def nufft(
    wavenumbers: npt.ArrayLike,
    strengths: npt.ArrayLike,
    targets: npt.ArrayLike,
    *,
    accuracy: float = 1e-6,
    library: str = "auto",
) -> Complex:
    """sum_j strengths_j exp(j wavenumbers_j . targets_n) for every n.

    Parameters
    ----------
    wavenumbers : (M, 2) float
        rad/m.
    strengths : (M,) real or complex
    targets : (N, 2) float
        m.
    accuracy : float
        Relative to sum |strengths|, 1e-13 to 1e-1.
    library : {"auto", "finufft", "own"}
        "auto": FINUFFT where installed (extra `nufft`), on one thread.

    Returns
    -------
    (N,) complex128

    Raises
    ------
    ValueError, TypeError
        Wrong shape, not finite, no sample or target, or an accuracy outside its range.
    ImportError
        library="finufft" and it is not installed.

    Notes
    -----
    O((M + N) log^2(1/accuracy) + P log P), P the product of the extents of wavenumbers and targets: a few times the number of
    pixels that resolve them.
    """
    k = _checks.reals("wavenumbers", wavenumbers, [("sample", 2)], ("sample",))
    x = _checks.reals("targets", targets, [("target", 2)], ("target",))
    if len(k) == 0 or len(x) == 0:
        raise ValueError(f"wavenumbers, targets: {len(k)} and {len(x)}: expected at least one of each")
    values = finite_samples("strengths", strengths, len(k))
    if values.ndim != 1:
        raise ValueError(f"strengths: expected shape ({len(k)},), found {values.shape}")
    accuracy = _checks.number("accuracy", accuracy, low=1e-13, high=0.1)
    _checks.choice("library", library, LIBRARIES)
    values = np.asarray(values, dtype=np.complex128)
    if which(library) == "finufft":
        from finufft import nufft2d3

        arguments = [np.ascontiguousarray(axis) for axis in (*k.T, *x.T)]
        return np.asarray(nufft2d3(*arguments[:2], values, *arguments[2:], isign=1, eps=accuracy, nthreads=1))
    return _two_griddings(k, values, x, accuracy)


def which(library: str) -> str:
    """The library that `library` stands for here; ImportError where it is not installed."""
    if library != "own" and importlib.util.find_spec("finufft") is None:
        if library == "finufft":
            raise _checks.optional("finufft", "nufft")
        return "own"
    return "own" if library == "own" else "finufft"


def _two_griddings(k: FloatArray, values: Complex, x: FloatArray, accuracy: float) -> Complex:
    # the error of the kernel falls as exp(-2 pi reach sqrt(1 - 1/2)): Beatty et al.; one tap for the two of them and the sum
    window = KaiserBessel(np.ceil(2 * (-np.log(accuracy) / 4.4 + 0.5)) / 2)
    k0, x0 = ((a.min(axis=0) + a.max(axis=0)) / 2 for a in (k, x))
    k_in, x_in = k - k0, x - x0
    # an extent of 0 would leave the grid without a spacing: any small one serves
    half = np.maximum(np.abs(k_in).max(axis=0), 1e-3 / np.maximum(np.abs(x_in).max(axis=0), 1e-3))
    spacing = np.pi / (2 * half)
    reach = np.abs(x_in).max(axis=0) + (window.reach + 1) * spacing
    sizes = [
        int(scipy.fft.next_fast_len(2 * int(np.ceil(2 * r / s)) + 2 * int(window.reach) + 2))
        for r, s in zip(reach, spacing, strict=True)
    ]
    period = np.array(sizes) * spacing
    # spread: bin m of an axis belongs to the wavenumber 2 pi (m - size/2)/period
    start = np.array([size // 2 for size in sizes])
    grid = np.zeros(sizes, dtype=np.complex128)
    first, weights = taps(k_in * period / (2 * np.pi) + start, window)
    centred = values * np.exp(1j * (k_in @ x0))
    for axis in range(2):
        centred = centred / window.values(k_in[:, axis] * spacing[axis] / np.pi)
    _pool.call(spread, first, weights[0], weights[1], centred, grid)
    grid = scipy.fft.fftshift(scipy.fft.ifft2(scipy.fft.ifftshift(grid), norm="forward", overwrite_x=True))
    for axis, size in enumerate(sizes):
        place = (np.arange(size) - size // 2) / (size / 2)
        inside = np.abs(place) <= 0.5 + 1e-9  # what the targets' kernels read; beyond, the window comes near 0
        factor = np.where(inside, 1 / np.where(inside, window.values(place), 1.0), 0.0)
        grid *= factor[:, None] if axis == 0 else factor
    out = np.empty(len(x), dtype=np.complex128)
    first, weights = taps(x_in / spacing + start, window)
    _pool.call(gather, first, weights[0], weights[1], grid, out)
    return np.asarray(out * np.exp(1j * (x @ k0)))
