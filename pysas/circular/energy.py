"""Energy of the circular-SAS point spread function: how it diffuses with radius, and the resolution that follows.

Energies are those of the PSF of unit peak, in m^2; the paper's E (of I/(2 pi)) is pulse.energy^2 times as large. Source: Y.
Pailhas et al., JASA 141 (2017), Eqs 22-38.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.special import erf, ive

from pysas import _checks
from pysas._checks import FloatArray
from pysas.circular.psf import PointSpread, warn_of_low_quality

FORMS = ("exact", "approximate", "asymptotic")
_PER_WAVELENGTH = 64  # samples to the shortest of the band: J0(2 k r)^2 has a period of a quarter of one


def energy_within(psf: PointSpread, r: npt.ArrayLike, form: str = "exact") -> FloatArray:
    """Energy within the distance `r` of the point, m^2.

    Parameters
    ----------
    psf : PointSpread
    r : array_like
        Distances, m, >= 0.
    form : {"exact", "approximate", "asymptotic"}
        "exact": of Eq 19. "approximate": of Eq 21, 2 pi integral of [b(2r/c) J0(2 k r)]^2 r dr (Eq 33). "asymptotic": (1/k)
        integral of b^2 dr (Eq 37), for a Gaussian sqrt(pi) a0/(2 k) erf(r/a0) (Eq 38); warns where Q < 2.

    Returns
    -------
    float64, the shape of `r`

    Raises
    ------
    ValueError, TypeError
        Negative or non-finite distances, an unknown form.

    Notes
    -----
    Misprints: B(r) in Eqs 33-37 stands for B(2r/c), and Eq 38 has erf(a0 r), which is not even a number. The exact PSF of a
    pulse with any content at zero frequency falls as 1/r in the end, so that its energy has no limit; for windows in use
    that lies below 1e-12. By a cubic spline through 64 samples to the shortest
    wavelength of the band, to 1e-6; O(max(r)/wavelength) samples.
    """
    _psf(psf)
    _checks.choice("form", form, FORMS)
    array = _checks.array_like("r", r)
    r = _checks.reals("r", array, [array.shape])
    if r.size and r.min() < 0:
        raise ValueError(f"r: {r.min():g}: expected distances >= 0")
    if form == "asymptotic" and psf.pulse.window == "gaussian":
        return np.asarray(asymptotic_energy(psf) * erf(r / psf.gaussian_width))
    if form == "asymptotic":
        warn_of_low_quality(psf, "Eq 37")
    far = float(np.max(r, initial=0.0)) or psf.wavelength
    s = np.linspace(0, far, 16 + int(np.ceil(_PER_WAVELENGTH * far / psf.shortest_wavelength)))
    if form == "asymptotic":
        density = psf.envelope(s) ** 2 / psf.k
    else:
        density = 2 * np.pi * s * (psf.exact(s) if form == "exact" else psf.approximate(s)) ** 2
    return np.asarray(CubicSpline(s, density).antiderivative()(r))


def energy(psf: PointSpread) -> float:
    """Energy of `PointSpread.approximate` for a Gaussian: pi a0^2 ive(0, 2 k^2 a0^2), m^2 (Eq 25; I0 itself overflows)."""
    a0 = _psf(psf).gaussian_width
    return float(np.pi * a0**2 * ive(0, 2 * (psf.k * a0) ** 2))


def asymptotic_energy(psf: PointSpread) -> float:
    """sqrt(pi) a0/(2 k), m^2: Eq 32 for a Gaussian. Warns where Q < 2."""
    a0 = _psf(psf).gaussian_width
    warn_of_low_quality(psf, "Eq 32")
    return float(np.sqrt(np.pi) * a0 / (2 * psf.k))


def resolution(psf: PointSpread, share: float, within: float, form: str = "exact") -> float:
    """Radius that holds `share` of the energy within the distance `within`, m.

    Parameters
    ----------
    psf : PointSpread
    share : float
        In (0, 1).
    within : float
        Distance out to which all of the energy is counted, m.
    form : {"exact", "approximate", "asymptotic"}
        As for `energy_within`; the asymptotic radius of a Gaussian is a0 erfinv(share).

    Returns
    -------
    float

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """
    _psf(psf)
    share = _checks.number("share", share, positive=True)
    if share >= 1:
        raise ValueError(f"share={share!r}: expected a number in (0, 1)")
    within = _checks.number("within", within, positive=True)
    r = np.linspace(0, within, 16 + int(np.ceil(4 * _PER_WAVELENGTH * within / psf.shortest_wavelength)))
    found = energy_within(psf, r, form)
    # energy never falls; equal neighbours (beyond the pulse) would not be increasing
    return float(np.interp(share * found[-1], found, r))


def energy_diffusion(
    image: npt.ArrayLike, spacing: float, centre: tuple[float, float], r: npt.ArrayLike, within: float
) -> FloatArray:
    """Share of an image's energy within each distance `r` of a place, of that within `within`.

    Parameters
    ----------
    image : (rows, columns) real or complex
    spacing : float
        Between pixels, m.
    centre : (x, y)
        Place, in pixels (column, row).
    r : (n,) array_like
        Distances, m.
    within : float
        Distance out to which energy counts, m; the disc must lie within the image.

    Returns
    -------
    float64 (n,)
        Sums over whole pixels: the distance is uncertain by about half a pixel.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, pixels that are not finite, a disc beyond the image, or no energy in it.
    """
    data = _checks.array_like("image", image)
    if data.ndim != 2 or data.dtype.kind not in "iufc":
        raise ValueError(f"image: expected numbers (rows, columns), found {data.dtype} {data.shape}")
    if not np.isfinite(data).all():
        raise ValueError("image: expected finite pixels")
    spacing = _checks.number("spacing", spacing, positive=True)
    within = _checks.number("within", within, positive=True)
    place = _checks.reals("centre", centre, [(2,)])
    r = _checks.reals("r", r, [("n",)])
    reach = within / spacing
    last = np.array(data.shape[::-1]) - 1
    if np.any(place - reach < -0.5) or np.any(place + reach > last + 0.5):
        raise ValueError(f"within={within!r}: expected a disc about centre={centre!r} that lies within the image")
    away = np.hypot(np.arange(data.shape[1]) - place[0], (np.arange(data.shape[0]) - place[1])[:, None])
    inside = away <= reach
    order = np.argsort(away[inside], kind="stable")
    total = np.cumsum(np.abs(data[inside][order]).astype(np.float64) ** 2)
    if not total[-1] > 0:
        raise ValueError("image: expected energy within the disc")
    count = np.searchsorted(away[inside][order] * spacing, r, side="right")
    return np.asarray(np.concatenate([[0.0], total])[count] / total[-1])


def _psf(psf: Any) -> PointSpread:
    if not isinstance(psf, PointSpread):
        raise TypeError(f"psf={psf!r}: expected a pysas.circular.PointSpread")
    return psf
