"""How well a track can be found from its own echoes, and what an image loses by the rest: formulas with their derivations.

Speckle is circular Gaussian: many scatterers in a resolution cell. Slant displacements are one-way, in m: what a phase centre
moves by along the line of sight turns the phase of its echoes by 4 pi/wavelength. It relies on nothing of pysas but checks.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray

_STEPS = 1 << 14  # of the quadrature over the half space: the pattern of 100 wavelengths has 80 of them a lobe


def phase_noise(coherence: npt.ArrayLike, *, window: float, bandwidth: float, c: float = 1500.0) -> FloatArray:
    """Least standard deviation of the phase between two echoes of the same seabed.

    Parameters
    ----------
    coherence : array_like
        gamma = |E[b conj(a)]|/sqrt(E|a|^2 E|b|^2), in (0, 1].
    window : float
        Slant range that the correlation sums over, m.
    bandwidth : float
        Of the echoes, Hz, flat.
    c : float
        Sound speed, m/s.

    Returns
    -------
    (...) float64
        rad.

    Raises
    ------
    ValueError, TypeError
        A coherence outside (0, 1], another argument that is not a number > 0.

    Notes
    -----
    A window holds N = bandwidth 2 window/c independent samples. Each pair (a, b) is circular Gaussian with the covariance
    [[1, g], [conj(g), 1]], g = gamma exp(j phi); the Fisher information on phi is trace(C^-1 dC C^-1 dC) =
    2 gamma^2/(1 - gamma^2) a pair, and none of it is shared with gamma or the powers. So the variance is at least
    (1 - gamma^2)/(2 N gamma^2) (E. Rodriguez and J. Martin 1992, IEE Proc. F 139, 147). The phase of sum b conj(a) is the
    likeliest and reaches it where N gamma^2 is large.
    """
    gamma = np.asarray(coherence, dtype=np.float64)
    if not np.all((gamma > 0) & (gamma <= 1)):
        raise ValueError(f"coherence={coherence!r}: expected numbers in (0, 1]")
    samples = 2 * _checks.number("window", window, positive=True) * _checks.number("bandwidth", bandwidth, positive=True)
    samples /= _checks.number("c", c, positive=True)
    return np.asarray(np.sqrt((1 - gamma**2) / (2 * samples * gamma**2)))


def slant_noise(phase: npt.ArrayLike, wavelength: float) -> FloatArray:
    """Slant displacement (m) that turns an echo by `phase` (rad): wavelength phase/(4 pi)."""
    return np.asarray(_checks.number("wavelength", wavelength, positive=True) * np.asarray(phase) / (4 * np.pi))


def yaw_noise(slant: float, *, pairs: int, spacing: float) -> float:
    """Standard deviation of the change of heading between two pings.

    Parameters
    ----------
    slant : float
        Standard deviation of the slant displacement that one pair of overlapping phase centres gives, m.
    pairs : int
        Overlapping pairs K >= 2.
    spacing : float
        Of phase centres along the array (half the receivers'), m.

    Returns
    -------
    float
        rad, where the line of sight is level; r/g times as much at ground range g of slant range r.

    Notes
    -----
    The slope of a straight line through K values of equal noise at equal steps: slant/(spacing sqrt(K (K^2 - 1)/12)). One
    pair tells none.
    """
    count = _checks.whole("pairs", pairs, low=2)
    arm = _checks.number("spacing", spacing, positive=True) * np.sqrt(count * (count**2 - 1) / 12)
    return float(_checks.number("slant", slant, low=0.0) / arm)


def drift(yaw: float, *, advance: float, pings: npt.ArrayLike) -> FloatArray:
    """Standard deviation of the sway that noise of the yaw leaves after so many pings.

    Parameters
    ----------
    yaw : float
        Standard deviation of the change of heading between two pings, rad (`yaw_noise`).
    advance : float
        From ping to ping, m.
    pings : array_like
        n, from the ping whose place and heading are known.

    Returns
    -------
    (...) float64
        m: yaw advance n^1.5/sqrt(3).

    Notes
    -----
    Displaced phase centres tell sway relative to the heading, and only changes of heading. Errors e_1 ... e_n of those add up
    to an error of the heading, and this, times the advance, to one of sway: advance sum_l (n - l + 1/2) e_l. Its variance is
    advance^2 yaw^2 (n^3/3 - n/12). With headings from elsewhere sway alone walks, by sqrt(n) times a pair's noise.
    """
    n = np.asarray(pings, dtype=np.float64)
    if not np.all(n >= 0):
        raise ValueError(f"pings={pings!r}: expected numbers >= 0")
    step = _checks.number("yaw", yaw, low=0.0) * _checks.number("advance", advance, positive=True)
    return np.asarray(step * n**1.5 / np.sqrt(3))


def coherence(separation: npt.ArrayLike, *, elements: tuple[float, float], wavelength: float) -> FloatArray:
    """Coherence of speckle seen from two phase centres apart along the track.

    Parameters
    ----------
    separation : array_like
        s, m.
    elements : (float, float)
        Lengths of transmitter and receivers along the track, m; 0: omnidirectional.
    wavelength : float
        m.

    Returns
    -------
    (...) float64
        T(s), 1 at s = 0.

    Notes
    -----
    A scatterer at the sine u off broadside returns the power [sinc(Dt u/wavelength) sinc(Dr u/wavelength)]^2 to either, and its
    two-way paths differ by 2 s u. Scatterers being independent, T(s) is the transform of that power at 2 s/wavelength (van
    Cittert and Zernike), by the midpoint rule over |u| < 1. Where all of the pattern lies within, that is the convolution of
    triangles of half-widths Dt and Dr at 2 s: zero beyond (Dt + Dr)/2, whatever the wavelength.
    """
    wave = _checks.number("wavelength", wavelength, positive=True)
    s = np.asarray(separation, dtype=np.float64)
    u = (np.arange(_STEPS) + 0.5) / _STEPS  # the other half is the same
    power = np.ones(_STEPS)
    for length in elements:
        power *= np.sinc(_checks.number("elements", length, low=0.0) * u / wave) ** 2
    turned = np.cos(4 * np.pi / wave * s[..., None] * u)
    return np.asarray(turned @ power / power.sum())


def peak_loss(slant: npt.ArrayLike, wavelength: float) -> FloatArray:
    """Loss of a point's peak (dB, >= 0) by slant errors of so much rms (m), Gaussian and independent from ping to ping.

    Pings add with phases of variance v = (4 pi slant/wavelength)^2; the amplitude's mean is exp(-v/2), so the peak loses
    10 log10(e) v = 4.34 v (J. Ruze 1966). A smooth error costs less: what it has of a shift and a trend only moves the point.
    """
    variance = np.square(4 * np.pi / _checks.number("wavelength", wavelength, positive=True) * np.asarray(slant))
    return np.asarray(10 / np.log(10) * variance)
