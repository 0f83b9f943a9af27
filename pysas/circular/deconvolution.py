"""Deconvolution of circular-SAS images by filters and by wave atoms.

An image J of scatterers of amplitude A at points is J = sum A I(x - point) + noise, with I the point spread function of unit
peak; the PSF is the same everywhere only if the views are even (`view_weights`). Filters work on the image as one period of a
periodic scene: a scatterer nearer to an edge than the PSF reaches shows on the other side. Source: Y. Pailhas et al., JASA
141 (2017), Section III B.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.interpolate import make_interp_spline
from scipy.special import j0

from pysas import _checks
from pysas._checks import FloatArray
from pysas.circular.psf import PointSpread, _positions, _reals

ATOMS = 64
# Bandwidths from fc within which windows without closed form count; power beyond, relative to the largest: 4e-6 for the
# Taylor window, less for Tukey's 0.1, 2e-4 for a Tukey window that is all but rectangular.
_BANDS = 3
_TONE = 12  # and so many of 1/duration, which a pulse has without any sweep: what a Tukey window of 0.1 has beyond is 1e-4
_EDGE = 1e-3  # of the largest value: what the transfer function may still have beyond the sampled band

Pixels = npt.NDArray[Any]


def transfer(psf: PointSpread, shape: tuple[int, int], spacing: float) -> FloatArray:
    """Transfer function: FFT of the PSF on a grid of `spacing`, from its exact transform.

    Parameters
    ----------
    psf : PointSpread
    shape : (rows, columns)
    spacing : float
        Between pixels, m.

    Returns
    -------
    float64 (rows, columns)
        In the order of `scipy.fft.fftfreq`: I_hat(q)/spacing^2. The value at q = 0, where the exact one is infinite for a
        pulse with content at zero frequency, is its mean over one cell.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; a spacing too coarse for the ring 2/wavelength of the spectrum.

    Notes
    -----
    A PSF larger than the image comes out wrapped, as the FFT of a periodic scene has it. One quadrant is evaluated; O(pixels).
    """
    if not isinstance(psf, PointSpread):
        raise TypeError(f"psf={psf!r}: expected a pysas.circular.PointSpread")
    spacing = _checks.number("spacing", spacing, positive=True)
    rows, columns = _rows_and_columns(shape)
    nyquist = 1 / (2 * spacing)
    if nyquist < psf.ring_radius or psf.spectrum(nyquist) > _EDGE * psf.spectrum(psf.ring_radius):
        raise ValueError(
            f"spacing={spacing!r}: the PSF has content beyond 1/(2 spacing) = {nyquist:.4g} cycles/m; its ring is at "
            f"{psf.ring_radius:.4g} cycles/m"
        )
    # a quadrant: rows 0 ... rows/2, and fftfreq's magnitudes tell which of them each row is
    qy, qx = np.arange(rows // 2 + 1) / (rows * spacing), np.arange(columns // 2 + 1) / (columns * spacing)
    q = np.hypot(qx, qy[:, None])
    # mean of I_hat, which goes as 1/q, over a disc as large as a cell: twice its value at the rim
    q[0, 0] = 1 / np.sqrt(np.pi * rows * columns) / spacing
    quadrant = _radial(psf, q)
    quadrant[0, 0] *= 2
    row, column = (np.minimum(np.arange(n), n - np.arange(n)) for n in (rows, columns))
    return np.asarray(quadrant[row[:, None], column] / spacing**2)


def naive(image: npt.ArrayLike, psf: PointSpread, spacing: float, threshold: float) -> Pixels:
    """Inverse filter 1/I_hat where |I_hat| >= threshold max|I_hat|, else 0.

    Parameters
    ----------
    image : (rows, columns) real or complex
    psf : PointSpread
    spacing : float
        Between pixels, m.
    threshold : float
        In (0, 1].

    Returns
    -------
    Scatterers' amplitude per pixel, (rows, columns), real for a real image.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, pixels that are not finite, too coarse a spacing.

    Notes
    -----
    Noise is amplified by up to 1/threshold. Valid for any scene; sharpens little: what lies off the ring stays lost.
    O(N log N).
    """
    data = _image(image)
    threshold = _checks.number("threshold", threshold, positive=True)
    if threshold > 1:
        raise ValueError(f"threshold={threshold!r}: expected a number in (0, 1]")
    response = transfer(psf, _shape(data), spacing)
    keep = response >= threshold * response.max()
    return _filtered(data, np.divide(1, response, out=np.zeros_like(response), where=keep))


def wiener(image: npt.ArrayLike, psf: PointSpread, spacing: float, noise: float, energy: float | None = None) -> Pixels:
    """Wiener filter I_hat s/(I_hat^2 s + n) for points in white noise (Eq 47).

    Parameters
    ----------
    image : (rows, columns) real or complex
    psf : PointSpread
    spacing : float
        Between pixels, m.
    noise : float
        Root mean square of the noise of a pixel, > 0, in the image's unit.
    energy : float, optional
        Sum of |A|^2 over the scatterers. Default: what the image's own energy gives, less the noise's.

    Returns
    -------
    Scatterers' amplitude per pixel, (rows, columns), real for a real image.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, pixels that are not finite, too coarse a spacing, or (without `energy`) an image no
        stronger than its noise.

    Notes
    -----
    Densities per frequency of the FFT: s = sum |A|^2 is flat for points, n = pixels noise^2; both times spacing^4 in the
    paper's units. The best linear filter for such scenes, and the one for a continuous seabed. O(N log N), a few images of
    memory.
    """
    data = _image(image)
    noise = _checks.number("noise", noise, positive=True)
    response = transfer(psf, _shape(data), spacing)
    if energy is None:
        excess = float(np.sum(np.abs(data) ** 2, dtype=np.float64)) - data.size * noise**2
        if not excess > 0:
            raise ValueError(f"noise={noise!r}: the image is no stronger than that: state `energy`")
        energy = excess * data.size / float(np.sum(response**2))  # Parseval: energy of a unit scatterer's image
    energy = _checks.number("energy", energy, positive=True)
    return _filtered(data, response / (response**2 + data.size * noise**2 / energy))


def wave_atom(psf: PointSpread, x: npt.ArrayLike, y: npt.ArrayLike, angle: float, envelope_power: int = 1) -> FloatArray:
    """Wave atom b(2r/c)^p J0(2k (x cos(angle) - y sin(angle))) of unit peak, about its centre (Eq 48).

    Parameters
    ----------
    psf : PointSpread
    x, y : array_like
        Position relative to the centre, m; broadcast together.
    angle : float
        theta_n, rad.
    envelope_power : {1, 2}
        p; 1 as printed.

    Returns
    -------
    float64, the broadcast shape

    Raises
    ------
    ValueError, TypeError
        Positions or an angle that are not finite, another power.

    Notes
    -----
    The spectrum of J0 fills the whole of -2k..2k: an atom is a ridge through the origin with maxima on the ring, 54 % of its
    energy there (sigma = 2e-5 s), not the two spots that Fig 6(b) draws.
    """
    x, y = _positions(x, y)
    angle = _checks.number("angle", angle)
    return np.asarray(_envelope(psf, np.hypot(x, y), envelope_power) * j0(2 * psf.k * (x * np.cos(angle) - y * np.sin(angle))))


def wave_atom_kernel(psf: PointSpread, r: npt.ArrayLike, envelope_power: int = 1) -> FloatArray:
    """Mean of the wave atoms of all angles about one centre, b(2r/c)^p J0(k r)^2, at distance `r`, m.

    What Eqs 48 and 49 make of a scatterer at their common centre, whatever the data: every coefficient is then the same. N
    atoms at angles n pi/N give it to 4e-16 within 4 wavelengths for N = 64, to 2e-5 for N = 32, to 0.14 for N = 16. With p =
    1, as printed, 80 and 95 % of its energy lie within 0.590 and 1.149 wavelengths (sigma = 2e-5 s), with p = 2 within 0.283
    and 0.736; Fig 9 states 0.25 and 0.75. That p = 2 matches was found afterwards, among some 20 candidates: it is a
    conjecture about the paper.

    Parameters
    ----------
    psf : PointSpread
    r : array_like
        Distance from the centre, m.
    envelope_power : {1, 2}
        p; 1 as printed.

    Returns
    -------
    float64, the shape of `r`

    Raises
    ------
    ValueError, TypeError
        Distances that are not finite reals, another power.
    """
    r = np.abs(_reals("r", r))
    return np.asarray(_envelope(psf, r, envelope_power) * j0(psf.k * r) ** 2)


def wave_atom_expansion(
    image: npt.ArrayLike,
    psf: PointSpread,
    spacing: float,
    centre: tuple[float, float],
    threshold: float = 0.1,
    envelope_power: int = 1,
    atoms: int = ATOMS,
) -> Pixels:
    """Expansion of the naive inverse in wave atoms about ONE centre (Eqs 48, 49), as printed.

    Valid only for a scatterer at `centre`: it then returns `wave_atom_kernel`, whose sharpness comes from the atoms and not
    from the data. Several scatterers come out at wrong places (those of a square at the middles of its sides); use
    `fit_points` and `synthesise`.

    Parameters
    ----------
    image : (rows, columns) real or complex
    psf : PointSpread
    spacing : float
        Between pixels, m.
    centre : (x, y)
        In pixels (column, row).
    threshold : float
        Of the naive inverse, in (0, 1].
    envelope_power : {1, 2}
        See `wave_atom_kernel`.
    atoms : int
        N, at angles n pi/N (an atom is the same at angle + pi).

    Returns
    -------
    (rows, columns), real for a real image

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, pixels that are not finite, too coarse a spacing.

    Notes
    -----
    The atoms overlap and are not orthogonal (condition number 2e6 for 64), so that sum <g, psi_n> psi_n is no projection.
    Misprint: Eq 49 lacks the normalisation; here c_n = <g, psi_n>/sum psi_n^2, and the sum is divided by sum_m <psi_m,
    psi_n>/sum psi_n^2. O(atoms pixels).
    """
    data = _image(image)
    place = _checks.reals("centre", centre, [(2,)])
    atoms = _checks.whole("atoms", atoms)
    inverse = naive(data, psf, spacing, threshold)
    x = spacing * (np.arange(data.shape[1]) - place[0])
    y = spacing * (np.arange(data.shape[0]) - place[1])[:, None]
    total: Pixels = np.zeros(data.shape, dtype=inverse.dtype)
    norms, everything = np.empty(atoms), np.zeros(data.shape)
    for number in range(atoms):
        atom = wave_atom(psf, x, y, number * np.pi / atoms, envelope_power)
        norms[number] = np.sum(atom**2)
        everything += atom
        total += np.vdot(atom, inverse) / norms[number] * atom
    # sum_m <psi_m, psi_n>, the same for all n but for the corners of the grid: its mean
    gain = float(np.sum(everything**2)) / atoms / float(np.mean(norms))
    return np.asarray(total / gain)


def _envelope(psf: PointSpread, r: FloatArray, power: int) -> FloatArray:
    if not isinstance(psf, PointSpread):
        raise TypeError(f"psf={psf!r}: expected a pysas.circular.PointSpread")
    if power not in (1, 2):
        raise ValueError(f"envelope_power={power!r}: expected 1 or 2")
    return psf.envelope(r) ** power


def _radial(psf: PointSpread, q: FloatArray) -> FloatArray:
    """The spectrum at many frequencies: closed forms directly, windows that need quadrature from a table."""
    if psf.pulse.window in ("rect", "gaussian"):
        return psf.spectrum(q)
    # |S|^2 of a pulse of length T is band-limited in q, to c T/2: four samples for each that it needs, by a quintic spline
    half = (_BANDS * abs(psf.pulse.bandwidth) + _TONE / psf.pulse.duration) * 2 / psf.c
    low, high = max(float(q.min()), psf.ring_radius - half), min(float(q.max()), psf.ring_radius + half)
    table = np.linspace(low, high, 16 + int(4 * psf.c * psf.pulse.duration * (high - low)))
    spline = make_interp_spline(table, table * psf.spectrum(table), k=5)
    return np.asarray(np.where((q >= low) & (q <= high), spline(np.clip(q, low, high)), 0) / q)


def _filtered(data: Pixels, gain: FloatArray) -> Pixels:
    spectrum = scipy.fft.fft2(data)
    spectrum *= gain.astype(spectrum.real.dtype, copy=False)
    result = scipy.fft.ifft2(spectrum, overwrite_x=True)
    return np.asarray(result if data.dtype.kind == "c" else result.real)


def _image(image: npt.ArrayLike) -> Pixels:
    data = _checks.array_like("image", image)
    if data.dtype.kind not in "iufc":
        raise TypeError(f"image: expected real or complex numbers, found dtype {data.dtype}")
    if data.ndim != 2 or data.size == 0:
        raise ValueError(f"image: expected (rows, columns), found shape {data.shape}")
    if not np.isfinite(data).all():
        raise ValueError("image: expected finite pixels")
    if data.dtype.kind in "iu":
        data = data.astype(np.float64)
    return data


def _shape(data: Pixels) -> tuple[int, int]:
    return int(data.shape[0]), int(data.shape[1])


def _rows_and_columns(shape: Any) -> tuple[int, int]:
    if not isinstance(shape, tuple | list) or len(shape) != 2:
        raise ValueError(f"shape={shape!r}: expected (rows, columns)")
    rows, columns = (_checks.whole("shape", n) for n in shape)
    return rows, columns
