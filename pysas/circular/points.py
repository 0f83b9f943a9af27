"""Point scatterers of a circular-SAS image by detection and joint refinement, and the image they make with a chosen kernel.

What remains valid of wave-atom deconvolution for several scatterers. The sharpness of the synthesised image is that of its
kernel, chosen beforehand, and no evidence of resolution; what counts is the error of the positions, what is missed and what is
invented.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.optimize import least_squares
from scipy.special import jnp_zeros

from pysas import _checks
from pysas._checks import FloatArray
from pysas.circular.deconvolution import _image, _rows_and_columns, _shape, transfer, wave_atom_kernel
from pysas.circular.psf import PointSpread

# Fall of chi-squared that a scatterer must bring: 5.5 deviations of a real amplitude, and as rare in the two components of a
# complex one: exp(-gain/2) against 0.146 times that. Noise alone reaches it in 0.5 % of images 16 wavelengths
# square (4 of 772).
GAIN = {"real": 5.5**2, "complex": 5.5**2 + 4}
_STEPS = 100  # a fit of points that are there takes some 10, one that wanders between wrong places thousands
_DIRECTIONS = 16  # of guesses at neighbours
_BAND = 1e-3  # of the largest value of the transfer function: what lies below tells nothing


@dataclass(frozen=True, eq=False)
class Scatterers:
    """Point scatterers found in an image.

    Attributes
    ----------
    position : (n, 2) float64
        Place (x, y) in pixels (column, row), in the order of detection.
    amplitude : (n,) float64 or complex128
    residual : float
        Root mean square of what they leave of the image within the PSF's band, relative to the noise stated: about 1 where the
        model holds.
    """

    position: FloatArray
    amplitude: npt.NDArray[Any]
    residual: float


def fit_points(image: npt.ArrayLike, psf: PointSpread, spacing: float, noise: float, most: int = 64) -> Scatterers:
    """Point scatterers whose images add up to `image`, as many as the noise lets one tell.

    Parameters
    ----------
    image : (rows, columns) real or complex
        Even views (`view_weights`), PSF of unit peak per unit amplitude; one period of a periodic scene, so let it reach
        beyond its scatterers as far as the PSF does. Real images have real amplitudes.
    psf : PointSpread
    spacing : float
        Between pixels, m.
    noise : float
        Root mean square of the noise of a pixel, > 0; white.
    most : int
        Number of scatterers to stop at, with a warning if one more would still bring enough: a scene that is not made of
        points, or whose noise is stated too low, has no last one.

    Returns
    -------
    Scatterers

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, pixels that are not finite, too coarse a spacing.

    Notes
    -----
    Greedy: the residual is correlated with the PSF, its largest magnitude becomes a scatterer, or the scatterer near it gets a
    neighbour in its first negative lobe, or gives way to two there, if that leaves less; all positions are refined
    together by non-linear least squares on the image's spectrum (amplitudes follow linearly: variable projection, G. H. Golub
    and V. Pereyra 1973, with L. Kaufman's Jacobian), and the scatterer stays if chi-squared fell by more than 30 (complex
    images: 34), which noise alone brings about in 0.5 % of images 16 wavelengths square.

    The negative lobes matter: two points 0.27 to 0.36 wavelengths apart, each in the lobe of the other, show brightest where
    nothing is; without those guesses they are missed. Crowds of such neighbours still go wrong now and then: of eight draws of
    ten points in 6 x 6 wavelengths one, with more found than there are and `residual` above 1.04. A continuous seabed is not
    made of points: use `wiener`.
    O(n^3 band) for n scatterers and `band` frequencies on the ring, of which some n arrays are held.
    """
    data = _image(image)
    noise = _checks.number("noise", noise, positive=True)
    most = _checks.whole("most", most)
    model = _Model(data, psf, spacing)
    # a complex pixel's noise has two components of half the power each
    scale = (1 if model.real else 2) / noise**2
    gain = GAIN["real" if model.real else "complex"]
    position = np.empty((0, 2))
    amplitude, rest = model.solve(position)
    chi2 = scale * float(np.vdot(rest, rest).real)
    while True:
        trials = [model.refine(start) for start in model.starts(position, rest)]
        solved = [(place, *model.solve(place)) for place in trials]
        tried, tried_amplitude, tried_rest = min(solved, key=lambda one: float(np.vdot(one[2], one[2]).real))
        tried_chi2 = scale * float(np.vdot(tried_rest, tried_rest).real)
        if not chi2 - tried_chi2 > gain:
            break
        if len(position) == most:
            warnings.warn(
                f"stopped at {most} scatterers though one more lowers chi-squared: a scene that is not of points, or more "
                f"noise than noise={noise:g}",
                UserWarning,
                stacklevel=2,
            )
            break
        position, amplitude, rest, chi2 = tried, tried_amplitude, tried_rest, tried_chi2
    residual = float(np.sqrt(np.mean(np.abs(rest) ** 2))) / noise
    return Scatterers(position, amplitude, residual)


def synthesise(
    scatterers: Scatterers, psf: PointSpread, shape: tuple[int, int], spacing: float, envelope_power: int = 1
) -> Any:
    """Image of scatterers with the wave atoms' kernel b(2r/c)^p J0(k r)^2 in place of the PSF.

    Parameters
    ----------
    scatterers : Scatterers
    psf : PointSpread
    shape : (rows, columns)
    spacing : float
        Between pixels, m.
    envelope_power : {1, 2}
        p; see `wave_atom_kernel`.

    Returns
    -------
    float64 or complex128 (rows, columns)

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.

    Notes
    -----
    Eqs 48 and 49 with the atoms about each scatterer instead of one common centre. O(n pixels).
    """
    if not isinstance(scatterers, Scatterers):
        raise TypeError(f"scatterers={scatterers!r}: expected pysas.circular.Scatterers")
    spacing = _checks.number("spacing", spacing, positive=True)
    rows, columns = _rows_and_columns(shape)
    image = np.zeros((rows, columns), dtype=scatterers.amplitude.dtype)
    for (x, y), amplitude in zip(scatterers.position, scatterers.amplitude, strict=True):
        away = spacing * np.hypot(np.arange(columns) - x, (np.arange(rows) - y)[:, None])
        image += amplitude * wave_atom_kernel(psf, away, envelope_power)
    return image


class _Model:
    """The image's spectrum on the ring as a sum of shifted transfer functions; positions in pixels."""

    def __init__(self, data: Any, psf: PointSpread, spacing: float) -> None:
        response = transfer(psf, _shape(data), spacing)
        self.kept = response >= _BAND * response.max()
        self.shape, self.real = data.shape, data.dtype.kind != "c"
        root = np.sqrt(data.size)
        self.response = response[self.kept] / root
        self.data = scipy.fft.fft2(data.astype(np.complex128))[self.kept] / root
        turns = [2 * np.pi * scipy.fft.fftfreq(n) for n in data.shape]
        grids = np.broadcast_arrays(turns[1], turns[0][:, None])
        self.turns = np.stack([grid[self.kept] for grid in grids])
        # in pixels: what a step of the search is measured in, and the distance of the PSF's first negative lobe
        self.wavelength = psf.wavelength / spacing
        self.lobe = float(jnp_zeros(0, 1)[0]) / (2 * psf.k) / spacing

    def shifted(self, position: FloatArray) -> Any:
        """(frequency, scatterer): spectra of unit scatterers."""
        return self.response[:, None] * np.exp(-1j * self.turns.T @ position.T)

    def columns(self, spectra: Any) -> FloatArray:
        """Spectra as real equations: (2 frequency, amplitude), twice as many amplitudes where they are complex."""
        real = np.concatenate([spectra.real, spectra.imag])
        if self.real:
            return np.asarray(real)
        return np.concatenate([real, np.concatenate([-spectra.imag, spectra.real])], axis=1)

    def solve(self, position: FloatArray) -> tuple[Any, Any]:
        """Amplitudes by least squares, and the spectrum of what they leave."""
        if len(position) == 0:
            return np.zeros(0, dtype=np.float64 if self.real else np.complex128), self.data
        spectra = self.shifted(position)
        wanted = np.concatenate([self.data.real, self.data.imag])
        solution = np.linalg.lstsq(self.columns(spectra), wanted, rcond=1e-10)[0]
        amplitude = solution if self.real else solution[: len(position)] + 1j * solution[len(position) :]
        return amplitude, self.data - spectra @ amplitude

    def starts(self, position: FloatArray, rest: Any) -> list[FloatArray]:
        """Positions with one more scatterer, to refine: the strongest residual's, and the best two guesses at neighbours."""
        peak = self.strongest(rest)
        starts = [np.vstack([position, peak])]
        away = np.linalg.norm(position - peak, axis=1)
        if not np.any(away < self.wavelength):
            return starts
        near = int(np.argmin(away))
        one, others = position[near], np.delete(position, near, axis=0)
        turn = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
        # two that cross their lobes in a place where nothing is make an equilateral triangle with it
        first, middle, second = (
            one + self.lobe * np.stack([np.cos(turn + side), np.sin(turn + side)], axis=1)
            for side in (-np.pi / 6, 0, np.pi / 6)
        )
        guesses = [np.vstack([position, place]) for place in middle]
        guesses += [np.vstack([others, *pair]) for pair in zip(first, second, strict=True)]
        guesses.sort(key=lambda guess: float(np.linalg.norm(self.solve(guess)[1])))
        return starts + guesses[:2]

    def strongest(self, rest: Any) -> FloatArray:
        """Pixel (x, y) at which one more scatterer would take most of the residual."""
        spectrum = np.zeros(self.shape, dtype=np.complex128)
        spectrum[self.kept] = self.response * rest
        match = scipy.fft.ifft2(spectrum)
        row, column = np.unravel_index(int(np.argmax(np.abs(match.real if self.real else match))), self.shape)
        return np.array([[column, row]], dtype=np.float64)

    def refine(self, position: FloatArray) -> FloatArray:
        """All positions together, by least squares of what the best amplitudes leave."""

        def residual(flat: FloatArray) -> FloatArray:
            rest = self.solve(flat.reshape(-1, 2) * self.wavelength)[1]
            return np.concatenate([rest.real, rest.imag])

        def jacobian(flat: FloatArray) -> FloatArray:
            place = flat.reshape(-1, 2) * self.wavelength
            amplitude, spectra = self.solve(place)[0], self.shifted(place)
            # d residual = -(part outside of the span of the spectra) of d spectra x amplitude
            slopes = 1j * self.turns.T[:, None, :] * (spectra * amplitude)[:, :, None] * self.wavelength
            flat_slopes = slopes.reshape(len(spectra), -1)
            stacked = np.concatenate([flat_slopes.real, flat_slopes.imag])
            basis, sizes, _ = np.linalg.svd(self.columns(spectra), full_matrices=False)
            basis = basis[:, sizes > 1e-10 * sizes[0]]
            return np.asarray(stacked - basis @ (basis.T @ stacked))

        start = position.ravel() / self.wavelength
        found = least_squares(residual, start, jac=jacobian, method="lm", xtol=1e-10, ftol=1e-10, gtol=1e-10, max_nfev=_STEPS)
        return np.asarray(found.x.reshape(-1, 2) * self.wavelength)
