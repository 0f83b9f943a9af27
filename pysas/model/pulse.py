"""Linear frequency-modulated pulses, their windows, spectra and matched-filter responses.

A pulse starts with its leading edge at t = 0 and has its centre at duration/2. An echo at two-way travel time tau from a
unit scatterer is recorded, demodulated at fc, as waveform(t - tau, fc) exp(-2j pi fc tau); once compressed its peak lies
at t = tau. Formulas: P. Pailhas et al. (2017), Eqs 8-18, with time measured there from the pulse's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray

WINDOWS = ("rect", "gaussian", "tukey", "taylor")
_DEFAULT_PARAMETER = {"tukey": 0.1, "taylor": 35.0}
_TAYLOR_NBAR = 4
_GAUSSIAN_REACH = 8.6  # exp(-8.6^2/2) < 1e-16
_PANEL_NODES, _PANEL_WEIGHTS = np.polynomial.legendre.leggauss(8)

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class LFM:
    """Linear frequency-modulated pulse.

    Parameters
    ----------
    fc : float
        Centre frequency, Hz.
    bandwidth : float
        Swept bandwidth, Hz; negative for a down-sweep.
    duration : float
        Length, s.
    window : {"rect", "gaussian", "tukey", "taylor"}
        Envelope. The Gaussian is not truncated to `duration` (Pailhas et al., Eq 10).
    window_parameter : float, optional
        Gaussian: sigma in s (required). Tukey: tapered share, 0 to 1 (0.1). Taylor: side-lobe level in dB below the
        peak (35; nbar is 4).

    Raises
    ------
    ValueError, TypeError
        A parameter outside its range; the message names it.
    """

    fc: float
    bandwidth: float
    duration: float
    window: str = "rect"
    window_parameter: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "fc", _checks.number("fc", self.fc, positive=True))
        object.__setattr__(self, "bandwidth", _checks.number("bandwidth", self.bandwidth))
        object.__setattr__(self, "duration", _checks.number("duration", self.duration, positive=True))
        if self.bandwidth == 0:
            raise ValueError(f"bandwidth={self.bandwidth!r}: expected a non-zero number (negative for a down-sweep)")
        if abs(self.bandwidth) >= 2 * self.fc:
            raise ValueError(f"bandwidth={self.bandwidth!r}: expected less than twice the centre frequency {self.fc:g} Hz")
        _checks.choice("window", self.window, WINDOWS)
        parameter = self.window_parameter
        if self.window == "rect":
            if parameter is not None:
                raise ValueError(f"window_parameter={parameter!r}: a rect window has none")
            return
        if parameter is None:
            parameter = _DEFAULT_PARAMETER.get(self.window)
        if self.window == "tukey":
            parameter = _checks.number("window_parameter", parameter, low=0.0, high=1.0)
        elif parameter is None:
            raise ValueError("window_parameter=None: a gaussian window needs its sigma in seconds")
        else:
            parameter = _checks.number("window_parameter", parameter, positive=True)
        object.__setattr__(self, "window_parameter", parameter)

    def __repr__(self) -> str:
        sweep = "up" if self.bandwidth > 0 else "down"
        parameter = "" if self.window_parameter is None else f" {self.window_parameter:g}"
        return (
            f"LFM({self.fc / 1e3:g} kHz, {abs(self.bandwidth) / 1e3:g} kHz {sweep}-sweep, {self.duration * 1e3:g} ms, "
            f"{self.window}{parameter})"
        )

    @property
    def rate(self) -> float:
        """Frequency rate K = bandwidth/duration, Hz/s (signed)."""
        return self.bandwidth / self.duration

    @property
    def support(self) -> tuple[float, float]:
        """Times (s) outside which the envelope is zero; for a Gaussian, below 1e-16."""
        if self.window == "gaussian":
            reach = _GAUSSIAN_REACH * self._parameter
            return self.duration / 2 - reach, self.duration / 2 + reach
        return 0.0, self.duration

    @property
    def energy(self) -> float:
        """Integral of the squared envelope, s (closed form; E = sigma sqrt(pi) for a Gaussian)."""
        if self.window == "gaussian":
            return self._parameter * float(np.sqrt(np.pi))
        if self.window == "tukey":
            return self.duration * (1 - 0.625 * self._parameter)
        if self.window == "taylor":
            scale, terms = self._taylor
            return self.duration * scale**2 * (1 + 2 * float(np.sum(terms**2)))
        return self.duration

    @property
    def occupied_bandwidth(self) -> float:
        """Two-sided bandwidth about fc, Hz: the sweep's, or where a Gaussian's spectrum has fallen to 1e-3."""
        if self.window != "gaussian":
            return abs(self.bandwidth)
        spread = (1 / self._gaussian_alpha).real
        return 2 * float(np.sqrt(np.log(1e3) / spread)) / np.pi

    @property
    def _parameter(self) -> float:
        if self.window_parameter is None:
            raise _checks.InternalError("window_parameter: not set")
        return self.window_parameter

    @property
    def _gaussian_alpha(self) -> complex:
        return 1 / (2 * self._parameter**2) - 1j * np.pi * self.rate

    @property
    def _taylor(self) -> tuple[float, FloatArray]:
        """Scale (centre = 1) and cosine coefficients of the Taylor window (T. T. Taylor 1955; Carrara et al. 1995)."""
        nbar, m = _TAYLOR_NBAR, np.arange(1, _TAYLOR_NBAR, dtype=np.float64)
        a = np.arccosh(10 ** (self._parameter / 20)) / np.pi
        s2 = nbar**2 / (a**2 + (nbar - 0.5) ** 2)
        terms = np.empty(m.size)
        for i, mi in enumerate(m):
            numerator = (-1) ** (mi + 1) * np.prod(1 - mi**2 / s2 / (a**2 + (m - 0.5) ** 2))
            terms[i] = numerator / (2 * np.prod(1 - mi**2 / m[m != mi] ** 2))
        return float(1 / (1 + 2 * terms.sum())), terms

    @_checks.usual_errors
    def envelope(self, t: npt.ArrayLike) -> FloatArray:
        """Envelope at times `t` (s) after the leading edge; 0 outside `support`, 1 at the centre."""
        u = _times("t", t) - self.duration / 2
        return np.where(np.abs(u) <= (self.support[1] - self.support[0]) / 2, self._centred(u), 0.0)

    def _centred(self, u: FloatArray) -> FloatArray:
        if self.window == "gaussian":
            return np.asarray(np.exp(-(u**2) / (2 * self._parameter**2)))
        if self.window == "tukey" and self._parameter > 0:
            edge = np.clip((2 * np.abs(u) / self.duration - 1 + self._parameter) / self._parameter, 0, 1)
            return np.asarray(0.5 + 0.5 * np.cos(np.pi * edge))
        if self.window == "taylor":
            scale, terms = self._taylor
            m = np.arange(1, terms.size + 1)
            return np.asarray(scale * (1 + 2 * np.cos(2 * np.pi * u[..., None] * m / self.duration) @ terms))
        return np.ones_like(u)

    @_checks.usual_errors
    def waveform(self, t: npt.ArrayLike, fc: float | None = None) -> Complex:
        """Complex base-band pulse at times `t`, s (Pailhas et al., Eq 8).

        Parameters
        ----------
        t : array_like
            Time after the leading edge, s.
        fc : float, optional
            Demodulation frequency, Hz; default: the pulse's own.
        """
        u = _times("t", t) - self.duration / 2
        offset = 0.0 if fc is None else self.fc - fc
        return np.asarray(self.envelope(t) * np.exp(1j * np.pi * (self.rate * u + 2 * offset) * u))

    @_checks.usual_errors
    def spectrum(self, f: npt.ArrayLike) -> Complex:
        """Fourier transform of `waveform` at base-band frequencies `f` (Hz), in s.

        Rect: Fresnel integrals; Gaussian: closed form (Eq 14); others by composite Gauss-Legendre quadrature, relative
        error below 1e-9 of the peak, O(len(f) (64 + duration |bandwidth|)).
        """
        f = _times("f", f)
        centre = np.exp(-1j * np.pi * f * self.duration)
        if self.window == "rect":
            from scipy.special import fresnel  # which echoes as such need not wait for

            rate = self.rate
            root = np.sqrt(2 * abs(rate))
            sign = np.sign(rate)

            def integral(u: FloatArray) -> Complex:
                s, c = fresnel(root * (u - f / rate))
                return np.asarray(c + 1j * sign * s)

            half = np.full_like(f, self.duration / 2)
            return np.asarray(centre * np.exp(-1j * np.pi * f**2 / rate) * (integral(half) - integral(-half)) / root)
        if self.window == "gaussian":
            alpha = self._gaussian_alpha
            return np.asarray(centre * np.sqrt(np.pi / alpha) * np.exp(-((np.pi * f) ** 2) / alpha))
        half_length = self.duration / 2
        flat = f.ravel()

        def integrand(u: FloatArray) -> Complex:
            return np.asarray(self._centred(u) * np.exp(1j * np.pi * (self.rate * u - 2 * flat[:, None]) * u))

        cycles = self.duration * (abs(self.bandwidth) + float(np.max(np.abs(flat), initial=0.0)))
        ends = np.tile([-half_length, half_length], (flat.size, 1))
        return np.asarray(centre * _integrate(integrand, self._split(ends, (0.0,)), cycles).reshape(f.shape))

    @_checks.usual_errors
    def response(self, t: npt.ArrayLike) -> FloatArray:
        """Matched-filter response about the travel time, normalised to 1 at t = 0 (real: all windows are even).

        Rect: Eq 17; Gaussian: Eq 18; others by quadrature of Eq 11, error below 1e-9.
        """
        t = _times("t", t)
        if self.window == "rect":
            overlap = np.clip(1 - np.abs(t) / self.duration, 0, None)
            return np.asarray(overlap * np.sinc(t * self.bandwidth * overlap))
        if self.window == "gaussian":
            sigma = self._parameter
            return np.asarray(np.exp(-(1 / (4 * sigma**2) + (np.pi * self.rate * sigma) ** 2) * t**2))
        flat = t.ravel()[:, None]

        def integrand(u: FloatArray) -> Complex:
            product = self._centred(u - flat / 2) * self._centred(u + flat / 2)
            return np.asarray(product * np.exp(2j * np.pi * self.rate * u * flat))

        half_length = np.clip(self.duration - np.abs(flat), 0, None) / 2
        ends = self._split(np.concatenate([-half_length, half_length], axis=1), (flat / 2, -flat / 2))
        total = _integrate(integrand, ends, self.duration * abs(self.bandwidth))
        return total.real.reshape(t.shape) / self.energy

    def _split(self, ends: FloatArray, shifts: tuple[float | FloatArray, ...]) -> FloatArray:
        """Intervals (n, edge) between `ends` (n, 2), split where a Tukey window shifted by `shifts` has its kinks."""
        if self.window != "tukey":
            return ends
        kink = (1 - self._parameter) * self.duration / 2
        kinks = [
            np.broadcast_to(np.clip(sign * kink + s, ends[:, :1], ends[:, 1:]), (len(ends), 1))
            for s in shifts
            for sign in (-1, 1)
        ]
        return np.sort(np.concatenate([ends, *kinks], axis=1), axis=1)


def _times(name: str, value: npt.ArrayLike) -> FloatArray:
    return np.asarray(_checks.array_like(name, value), dtype=np.float64)


def _integrate(integrand: Callable[[FloatArray], Complex], edges: FloatArray, cycles: float) -> Complex:
    """Integrals over [edges[i, 0], edges[i, -1]], piecewise between the edges, panels enough for `cycles` oscillations."""
    panels = 32 + int(np.ceil(cycles))
    total = np.zeros(len(edges), dtype=np.complex128)
    for low, high in zip(edges.T[:-1], edges.T[1:], strict=True):
        width = (high - low) / (2 * panels)
        for panel in range(panels):
            nodes = (low + (2 * panel + 1) * width)[:, None] + width[:, None] * _PANEL_NODES
            total += width * (integrand(nodes) @ _PANEL_WEIGHTS)
    return total
