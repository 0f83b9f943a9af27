"""Geometry of a circular track: view angles of a point off the centre, their density, and how many views are needed.

A sonar on a circle of radius R about O images O' at a distance a R from O, 0 <= a < 1. Angles are measured from the
direction O -> O': the track angle theta of the sonar about O, the view angle theta' of the sonar about O'. Source: Y.
Pailhas et al., JASA 141 (2017), Eqs 1-5. The forms used here are those of the printed arc cosines, written so that they
keep their digits at 0, at pi and as a -> 1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray


def full_view_radius(radius: float, beamwidth: float) -> float:
    """Radius R sin(beamwidth/2) of the area that a sonar looking at the centre sees from its whole circle (Eq 1).

    Parameters
    ----------
    radius : float
        Of the track, m.
    beamwidth : float
        Full beam width, rad, in (0, pi]: a wider beam sees the whole disc.

    Returns
    -------
    float
        In m.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """
    radius = _checks.number("radius", radius, positive=True)
    beamwidth = _checks.number("beamwidth", beamwidth, positive=True)
    if beamwidth > np.pi:
        raise ValueError(f"beamwidth={beamwidth!r}: expected radians in (0, pi]")
    return radius * float(np.sin(beamwidth / 2))


def view_angle(track_angle: npt.ArrayLike, offset: float) -> FloatArray:
    """View angle theta' = h(theta) of a point off the centre (Eq 2).

    Parameters
    ----------
    track_angle : array_like
        theta, rad.
    offset : float
        a = |OO'|/R, in [0, 1).

    Returns
    -------
    float64, the shape of `track_angle`
        In [-pi, pi].

    Raises
    ------
    ValueError, TypeError
        A non-finite angle or an offset outside [0, 1).

    Notes
    -----
    theta' = atan2(sin theta, cos theta - a): the printed sgn(theta) arccos(...) loses half of the digits at 0 and pi.
    """
    theta, a = _angle("track_angle", track_angle), _offset(offset)
    # cos theta - a with both of its small parts kept where a -> 1 and theta -> 0
    return np.asarray(np.arctan2(np.sin(theta), (1 - a) - 2 * np.sin(theta / 2) ** 2))


def track_angle(view_angle: npt.ArrayLike, offset: float) -> FloatArray:
    """Track angle theta = h^-1(theta') from which the sonar sees a point off the centre (Eq 3).

    Parameters
    ----------
    view_angle : array_like
        theta', rad.
    offset : float
        a = |OO'|/R, in [0, 1).

    Returns
    -------
    float64, the shape of `view_angle`
        In [-pi, pi].

    Raises
    ------
    ValueError, TypeError
        A non-finite angle or an offset outside [0, 1).

    Notes
    -----
    theta = theta' - arcsin(a sin theta') (law of sines), from its sine and cosine: sin theta = sin theta' (s - a cos
    theta'), cos theta = s cos theta' + a sin^2 theta', s = sqrt(1 - a^2 sin^2 theta'); the cosine is the printed Eq 3.
    """
    view, a = _angle("view_angle", view_angle), _offset(offset)
    root, gap = _root_and_gap(view, a)
    return np.asarray(np.arctan2(np.sin(view) * gap, np.cos(view) * root + a * np.sin(view) ** 2))


def view_rate(track_angle: npt.ArrayLike, offset: float) -> FloatArray:
    """Jacobian d theta'/d theta = (1 - a cos theta)/(1 + a^2 - 2 a cos theta): how fast the view turns along the track.

    Its mean over the circle is 1; it lies between 1/(1 + a) and 1/(1 - a). Weighting each ping by it makes a sum over
    pings uniform in view angle (not printed in the paper: the derivative of its Eq 2).

    Parameters
    ----------
    track_angle : array_like
        theta, rad.
    offset : float
        a = |OO'|/R, in [0, 1).

    Returns
    -------
    float64, the shape of `track_angle`

    Raises
    ------
    ValueError, TypeError
        A non-finite angle or an offset outside [0, 1).
    """
    theta, a = _angle("track_angle", track_angle), _offset(offset)
    versine = 2 * np.sin(theta / 2) ** 2
    return np.asarray(((1 - a) + a * versine) / ((1 - a) ** 2 + 2 * a * versine))


def view_density(view_angle: npt.ArrayLike, offset: float) -> FloatArray:
    """Number of views per unit of view angle, relative to a centred point (Fig 7b): d theta/d theta' at theta'.

    1 - a cos theta'/sqrt(1 - a^2 sin^2 theta'): 1 - a where the sonar is nearest, 1 + a where it is farthest. Opposite
    views add to exactly 2, so the real part of the image is the same with and without resampling.

    Parameters
    ----------
    view_angle : array_like
        theta', rad.
    offset : float
        a = |OO'|/R, in [0, 1).

    Returns
    -------
    float64, the shape of `view_angle`

    Raises
    ------
    ValueError, TypeError
        A non-finite angle or an offset outside [0, 1).
    """
    view, a = _angle("view_angle", view_angle), _offset(offset)
    root, gap = _root_and_gap(view, a)
    return np.asarray(gap / root)


def virtual_angles(radius: float, wavelength: float, offset: float) -> FloatArray:
    """View angles that sample the circle of radius (1 - a) R about O' every half wavelength (Eq 5).

    Parameters
    ----------
    radius : float
        R of the track, m.
    wavelength : float
        At the centre frequency, m.
    offset : float
        a = |OO'|/R, in [0, 1).

    Returns
    -------
    float64 (n,)
        n = ceil(4 pi (1 - a) R/wavelength) angles theta'_i = -pi + (i + 1/2) 2 pi/n, rad.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.

    Notes
    -----
    Misprint: the printed step (wavelength/2)/((1 - a) R) does not divide 2 pi, so that the last arc would be counted
    short; here the step is the largest that does and is no longer. O(n).
    """
    radius = _checks.number("radius", radius, positive=True)
    wavelength = _checks.number("wavelength", wavelength, positive=True)
    n = int(np.ceil(4 * np.pi * (1 - _offset(offset)) * radius / wavelength))
    return np.asarray(-np.pi + (np.arange(n) + 0.5) * (2 * np.pi / n), dtype=np.float64)


def angles_for_patch(patch_radius: float, wavelength: float) -> int:
    """Least number of evenly spread views that image a patch without aliasing in angle.

    Parameters
    ----------
    patch_radius : float
        Radius rho of the patch about its centre, m.
    wavelength : float
        The shortest of the band, m.

    Returns
    -------
    int
        n = ceil(z + 6 z^(1/3) + 10) with z = 4 k rho, k = 2 pi/wavelength.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.

    Notes
    -----
    n views turn J0(2 k r) into J0(2 k r) + 2 j^n J_n(2 k r) cos(n phi) + ... (Jacobi-Anger), and two points of the patch lie
    up to r = 2 rho apart. J_n(z) dies off over n - z of some z^(1/3): at this n it is below 1e-7.
    """
    patch_radius = _checks.number("patch_radius", patch_radius, positive=True)
    wavelength = _checks.number("wavelength", wavelength, positive=True)
    z = 8 * np.pi * patch_radius / wavelength
    return int(np.ceil(z + 6 * np.cbrt(z) + 10))


def _angle(name: str, value: npt.ArrayLike) -> FloatArray:
    array = _checks.array_like(name, value)
    return _checks.reals(name, array, [array.shape])


def _offset(value: float) -> float:
    offset = _checks.number("offset", value, low=0.0)
    if offset >= 1:
        raise ValueError(f"offset={value!r}: expected a number in [0, 1): the point lies within the circle")
    return offset


def _root_and_gap(view: FloatArray, a: float) -> tuple[FloatArray, FloatArray]:
    """s = sqrt(1 - a^2 sin^2 theta') and s - a cos theta', the latter by (s^2 - a^2 cos^2)/(s + a cos) where it cancels."""
    short, along = (1 - a) * (1 + a), a * np.cos(view)
    root = np.sqrt(short + along**2)
    return root, np.where(along > 0, short / (root + np.abs(along)), root - along)
