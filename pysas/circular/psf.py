"""Point spread function of circular SAS for any pulse: exact, its closed forms, and its Fourier transform.

Every function of this module is normalised to a peak of 1: the paper's I(r) is 2 pi E0 times it, its I/(2 pi) E0 times,
with E0 = B(0) = pulse.energy in s. Spatial frequencies q are in cycles/m; k = 2 pi fc/c is the one-way wavenumber. Source:
Y. Pailhas et al., JASA 141 (2017), Sections II B to III A; misprints are told where they matter.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import ive, j0

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.pulse import LFM

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_CYCLES_PER_PANEL = 1.5  # 16 Gauss-Legendre nodes integrate that many turns to 1e-15
_CHUNK = 1 << 20  # samples of the integrand held at once

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class PointSpread:
    """Point spread function of a full circle of views, of unit peak.

    Parameters
    ----------
    pulse : LFM
        Transmitted pulse; the data are compressed by its matched filter.
    c : float
        Sound speed, m/s.

    Raises
    ------
    TypeError, ValueError
        A pulse that is not an LFM, a speed that is not positive and finite.
    """

    pulse: LFM
    c: float = 1500.0

    def __post_init__(self) -> None:
        if not isinstance(self.pulse, LFM):
            raise TypeError(f"pulse={self.pulse!r}: expected a pysas.LFM")
        object.__setattr__(self, "c", _checks.number("c", self.c, positive=True))

    @property
    def wavelength(self) -> float:
        """c/fc, m."""
        return self.c / self.pulse.fc

    @property
    def shortest_wavelength(self) -> float:
        """That of the upper end of the occupied band, m: what a sampling of the PSF must resolve."""
        return self.c / (self.pulse.fc + self.pulse.occupied_bandwidth / 2)

    @property
    def k(self) -> float:
        """One-way wavenumber 2 pi fc/c, rad/m."""
        return 2 * np.pi / self.wavelength

    @property
    def ring_radius(self) -> float:
        """Radius 2 fc/c of the ring that the spectrum fills, cycles/m (the paper calls it the diameter: a misprint)."""
        return 2 / self.wavelength

    @property
    def quality(self) -> float:
        """Quality factor Q = fc/bandwidth: of the swept band or, if larger, 1/duration; Gaussian: between half powers."""
        pulse = self.pulse
        if pulse.window == "gaussian":
            return pulse.fc * np.pi * self.gaussian_width / (self.c * float(np.sqrt(np.log(2) / 2)))
        return pulse.fc / max(abs(pulse.bandwidth), 1 / pulse.duration)

    @property
    def gaussian_width(self) -> float:
        """a0 of the envelope exp(-r^2/(2 a0^2)), m (Eq 27); Gaussian windows only.

        a0^2 = c^2 sigma^2 T^2/(2 (T^2 + 4 pi^2 bandwidth^2 sigma^4)). The ring's profile has the standard deviation
        1/(2 pi a0) (printed variance 1/(pi^2 a0^2): four times too large).
        """
        if self.pulse.window != "gaussian" or self.pulse.window_parameter is None:
            raise ValueError(f"pulse: window {self.pulse.window!r}: expected 'gaussian', the only one with this closed form")
        sigma = self.pulse.window_parameter
        # divided by T: sigma and its reciprocal may both be extreme
        return self.c * sigma / float(np.sqrt(2) * np.hypot(1, 2 * np.pi * self.pulse.rate * sigma**2))

    def envelope(self, r: npt.ArrayLike) -> FloatArray:
        """Matched-filter envelope B(2r/c)/B(0) at distance `r`, m (Eqs 17, 18; other windows from a table of Eq 11)."""
        t = 2 * np.abs(_reals("r", r)) / self.c
        if self.pulse.window in ("rect", "gaussian"):
            return self.pulse.response(t)
        edges, pieces = _response(self.pulse)
        place = np.searchsorted(edges, t, side="right") - 1
        value = np.zeros(t.shape)
        for number, piece in enumerate(pieces):
            here = place == number
            value[here] = piece(t[here])
        return value

    def exact(self, r: npt.ArrayLike) -> FloatArray:
        """I(r)/I(0) by quadrature of Eq 19, relative error of the peak below 1e-12 (Tukey, Taylor: 1e-8).

        Parameters
        ----------
        r : array_like
            Distance from the point, m.

        Returns
        -------
        float64, the shape of `r`

        Raises
        ------
        ValueError, TypeError
            Non-finite or complex `r`.

        Notes
        -----
        (2/pi) integral of b(2 r cos(theta)/c) cos(2 k r cos(theta)) over a quarter turn, b = B/B(0), by composite
        Gauss-Legendre quadrature. Only angles with 2 r cos(theta)/c within the pulse count, so the cost per point grows as
        fc times min(2 r/c, pulse length).
        """
        r = np.abs(_reals("r", r))
        flat = r.ravel()
        first = np.arccos(np.minimum(1, self._reach / np.maximum(flat, self._reach)))
        cycles = 2 / self.shortest_wavelength * np.minimum(flat, self._reach)
        total = np.empty(flat.size)
        order = np.argsort(cycles)
        while order.size:
            # from the largest down: all points of a chunk take the panels of its first
            panels = 4 + int(np.ceil(cycles[order[-1]] / _CYCLES_PER_PANEL))
            chunk = order[-max(1, _CHUNK // (panels * _NODES.size)) :]
            order = order[: -chunk.size]
            total[chunk] = self._quadrature(flat[chunk], first[chunk], panels)
        return total.reshape(r.shape)

    def _quadrature(self, r: FloatArray, first: FloatArray, panels: int) -> FloatArray:
        width = (np.pi / 2 - first) / panels
        total = np.zeros(r.size)
        step = max(1, _CHUNK // (r.size * _NODES.size))
        for start in range(0, panels, step):
            panel = np.arange(start, min(start + step, panels))
            place = (panel[:, None] + (_NODES + 1) / 2).ravel()
            # x = r cos(theta) = r sin(pi/2 - theta), measured from where it vanishes
            x = r[:, None] * np.sin(width[:, None] * place)
            weights = np.tile(_WEIGHTS / 2, panel.size)
            total += (self.envelope(x) * np.cos(2 * self.k * x)) @ weights
        return np.asarray(2 / np.pi * width * total)

    @property
    def _reach(self) -> float:
        """Distance beyond which the envelope is zero, m: half the pulse's travel (a Gaussian's autocorrelation: less)."""
        if self.pulse.window == "gaussian":
            return 8.6 * self.gaussian_width
        return self.c * self.pulse.duration / 2

    def approximate(self, r: npt.ArrayLike) -> FloatArray:
        """b(2r/c) J0(2 k r) at distance `r`, m (Eq 21): within 0.4 % of the peak for the paper's pulses (Q = 5 and 7.5).

        The phase is stationary where the sonar looks along `r`, so the envelope there may stand before the integral. Warns
        where Q < 2; raises as `exact` does. O(size of r).
        """
        warn_of_low_quality(self, "Eq 21")
        r = _reals("r", r)
        return np.asarray(self.envelope(r) * j0(2 * self.k * r))

    def spectrum(self, q: npt.ArrayLike) -> FloatArray:
        """Fourier transform of the exact PSF at radial frequency `q`, cycles/m: in m^2, any pulse.

        Parameters
        ----------
        q : array_like
            Radial frequency, cycles/m; at 0 the transform is infinite (like 1/q) unless the pulse has nothing there.

        Returns
        -------
        float64, the shape of `q`

        Raises
        ------
        ValueError, TypeError
            Non-finite or complex `q`.

        Notes
        -----
        [G(q) + G(-q)]/(2 pi E0 q), G(q) = (c/2) |S(q c/2 - fc)|^2 the transform of the one-dimensional response B(2x/c)
        exp(4j pi fc x/c) and S that of the pulse: a turn of Eq 19's plane waves about the origin (not in the paper). For a
        Gaussian: a0/(sqrt(2 pi) q) exp(-2 pi^2 a0^2 (q - q0)^2) and its mirror; Eq 44 is this times sqrt(q/q0).
        """
        q = np.abs(_reals("q", q))
        total = self._line_spectrum(q) + self._line_spectrum(-q)
        with np.errstate(divide="ignore"):
            factor = np.where(q > 0, 1 / q, np.inf)
        return np.asarray(np.multiply(total, factor, out=np.zeros_like(total), where=total > 0) / (2 * np.pi))

    def _line_spectrum(self, q: FloatArray) -> FloatArray:
        """Transform of the one-dimensional response b(2x/c) exp(4j pi fc x/c), in m."""
        spectrum = self.pulse.spectrum(q * self.c / 2 - self.pulse.fc)
        return np.asarray(self.c / 2 * (spectrum.real**2 + spectrum.imag**2) / self.pulse.energy)

    def spectrum_of_approximation(self, q: npt.ArrayLike) -> FloatArray:
        """Fourier transform of `approximate`, Gaussian windows (Eq 43), in m^2; `q` in cycles/m.

        2 pi a0^2 ive(0, 4 pi k a0^2 q) exp(-2 a0^2 (pi q - k)^2): the printed I0 overflows for k a0 > 13, its scaled form
        does not.
        """
        q, a0 = np.abs(_reals("q", q)), self.gaussian_width
        return np.asarray(2 * np.pi * a0**2 * ive(0, 4 * np.pi * self.k * a0**2 * q) * self._ring(q))

    def spectrum_asymptotic(self, q: npt.ArrayLike) -> FloatArray:
        """Eq 44: a0/sqrt(2 k q) exp(-2 a0^2 (pi q - k)^2), in m^2, Gaussian windows; infinite at q = 0. Warns where Q < 2."""
        warn_of_low_quality(self, "Eq 44")
        q, a0 = np.abs(_reals("q", q)), self.gaussian_width
        with np.errstate(divide="ignore"):
            return np.asarray(a0 / np.sqrt(2 * self.k * q) * self._ring(q))

    def _ring(self, q: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-2 * self.gaussian_width**2 * (np.pi * q - self.k) ** 2))

    def image(self, x: npt.ArrayLike, y: npt.ArrayLike, views: Callable[[FloatArray], npt.ArrayLike]) -> Complex:
        """PSF of views that do not count alike: missing sectors, an element's beam pattern, a point off the centre.

        Parameters
        ----------
        x, y : array_like
            Position relative to the point, m; broadcast together.
        views : callable
            Amplitude of each view, of its angle in [-pi, pi) (an array (n,), rad, of the direction from the point to the
            sonar). For a point O' whose direction from the centre is x: `view_density` gives its unweighted sum, and an
            element of length D that looks at the centre sinc(D/wavelength a sin(angle))^2 (both ways), a its offset;
            subtract its azimuth from the angle for any other.

        Returns
        -------
        complex128, the broadcast shape
            Divided by the mean of |views|, so that a constant gives `exact`.

        Raises
        ------
        ValueError, TypeError
            Non-finite positions or amplitudes, amplitudes of another shape, or all zero.

        Notes
        -----
        Eq 19 with the amplitude under the integral, by the trapezoidal rule with n = 4096 + 8 k r angles, r the largest
        distance: exact to rounding for smooth amplitudes, to 1/n of a turn for the place of a jump. O(n) per position.
        """
        x, y = _positions(x, y)
        if not callable(views):
            raise TypeError(f"views={views!r}: expected a function of angles")
        far = float(np.max(np.hypot(x, y), initial=0.0))
        n = 4 * int(np.ceil(1024 + 2 * self.k * far))
        angle = np.asarray(-np.pi + np.arange(n) * (2 * np.pi / n), dtype=np.float64)
        amplitude = np.asarray(views(angle))
        if amplitude.shape != angle.shape or amplitude.dtype.kind not in "iufc":
            raise ValueError(f"views: expected numbers of shape {angle.shape}, found {amplitude.dtype} {amplitude.shape}")
        if not np.isfinite(amplitude).all() or not amplitude.any():
            raise ValueError("views: expected finite amplitudes, not all zero")
        amplitude = amplitude / np.mean(np.abs(amplitude))
        total = np.empty(x.size, dtype=np.complex128)
        flat_x, flat_y = x.ravel(), y.ravel()
        kept = np.flatnonzero(amplitude)
        step = max(1, _CHUNK // kept.size)
        for start in range(0, x.size, step):
            part = slice(start, start + step)
            u = flat_x[part, None] * np.cos(angle[kept]) + flat_y[part, None] * np.sin(angle[kept])
            total[part] = (self.envelope(u) * np.exp(-2j * self.k * u)) @ amplitude[kept] / n
        return total.reshape(x.shape)


def warn_of_low_quality(psf: PointSpread, formula: str) -> None:
    """Warn the caller's caller where Q < 2."""
    if psf.quality < 2:
        warnings.warn(
            f"{formula} is asymptotic in Q = fc/bandwidth; Q = {psf.quality:.2g} is below 2: use the exact form",
            UserWarning,
            stacklevel=3,
        )


@lru_cache(maxsize=8)
def _response(pulse: LFM) -> tuple[FloatArray, tuple[BSpline, ...]]:
    """The matched-filter response from lag 0 to the duration: edges between smooth pieces, and a quintic spline of each.

    To 1e-8, 16 samples to the period of the bandwidth and 64 more, for windows whose response costs a quadrature for every
    lag. It is smooth but where two of a Tukey window's four kinks meet. Costs
    (bandwidth duration)^2 once per pulse: 8 s at a product of 600.
    """
    edges = np.array([0.0, 1.0])
    if pulse.window == "tukey" and pulse.window_parameter:
        taper = pulse.window_parameter
        edges = np.unique(np.clip([0, taper / 2, 1 - taper, 1 - taper / 2, 1], 0, 1))
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])] * pulse.duration
    edges[-1] = pulse.duration
    pieces = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        t = np.linspace(low, high, 64 + 16 * int(np.ceil(abs(pulse.bandwidth) * (high - low))))
        pieces.append(make_interp_spline(t, pulse.response(t), k=5))
    return edges, tuple(pieces)


def sigmas_of_width(width: float, bandwidth: float, duration: float, c: float = 1500.0) -> tuple[float, float]:
    """Both Gaussian sigmas (s) that give the envelope the width a0: a short tone and a chirp with one PSF.

    Parameters
    ----------
    width : float
        a0, m, at most c sqrt(T/(8 pi |bandwidth|)).
    bandwidth, duration : float
        Of the sweep, Hz and s; T = duration.
    c : float
        Sound speed, m/s.

    Returns
    -------
    short, long : float
        short x long = T/(2 pi |bandwidth|); they meet at the largest width.

    Raises
    ------
    ValueError, TypeError
        A width beyond the largest, or an argument outside its range.

    Notes
    -----
    Eq 27 is a quadratic in sigma^2. The paper's sigma = 2e-2 is a share of the pulse: 2e-5 s; its chirp of the same PSF
    has sigma = 0.398 T.
    """
    width = _checks.number("width", width, positive=True)
    duration = _checks.number("duration", duration, positive=True)
    bandwidth = abs(_checks.number("bandwidth", bandwidth))
    c = _checks.number("c", c, positive=True)
    if bandwidth == 0:
        raise ValueError(f"bandwidth={bandwidth!r}: expected a non-zero number")
    largest = c * float(np.sqrt(duration / (8 * np.pi * bandwidth)))
    ratio = width / largest
    if ratio > 1:
        raise ValueError(f"width={width!r}: expected at most c sqrt(T/(8 pi bandwidth)) = {largest!r} m")
    meeting = float(np.sqrt(duration / (2 * np.pi * bandwidth)))
    # with v = (sigma/meeting)^2: ratio^2 = 2 v/(1 + v^2), the sine of an angle of which v is the tangent of half
    sine = ratio**2
    v = sine / (1 + float(np.sqrt((1 - sine) * (1 + sine))))
    return meeting * float(np.sqrt(v)), meeting / float(np.sqrt(v))


def _reals(name: str, value: npt.ArrayLike) -> FloatArray:
    array = _checks.array_like(name, value)
    return _checks.reals(name, array, [array.shape])


def _positions(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    x, y = _reals("x", x), _reals("y", y)
    try:
        x, y = np.broadcast_arrays(x, y)
    except ValueError:
        raise ValueError(f"x, y: expected shapes that broadcast together, found {x.shape} and {y.shape}") from None
    return x, y
