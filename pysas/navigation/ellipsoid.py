"""The WGS84 ellipsoid: latitude, longitude and height to Earth-centred metres and back, and local axes.

Formulas: B. Hofmann-Wellenhof et al., GNSS (2008), section 8.2; constants: NIMA TR8350.2. Angles in degrees, heights
above the ellipsoid in m. Plain arrays in and out, checked by the callers.
"""

from __future__ import annotations

import numpy as np

from pysas._checks import FloatArray

SEMI_MAJOR = 6378137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
_BOWRING_STEPS = 3  # one is good to 1e-11 rad near the surface, three to rounding from 10 km below it to space


def to_earth(lat: FloatArray, lon: FloatArray, height: FloatArray) -> FloatArray:
    """(..., 3) Earth-centred, Earth-fixed x, y, z."""
    phi, lam = np.radians(lat), np.radians(lon)
    normal = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * np.sin(phi) ** 2)
    level = (normal + height) * np.cos(phi)
    return np.stack(
        [level * np.cos(lam), level * np.sin(lam), ((1 - ECCENTRICITY2) * normal + height) * np.sin(phi) + 0 * lam], axis=-1
    )


def from_earth(place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude, longitude and height of (..., 3), by Bowring's iteration on the parametric latitude."""
    x, y, z = np.moveaxis(place, -1, 0)
    level = np.hypot(x, y)
    b = SEMI_MAJOR * (1 - FLATTENING)
    second = ECCENTRICITY2 / (1 - ECCENTRICITY2)
    beta = np.arctan2(z, (1 - FLATTENING) * level)
    for _ in range(_BOWRING_STEPS):
        phi = np.arctan2(z + second * b * np.sin(beta) ** 3, level - ECCENTRICITY2 * SEMI_MAJOR * np.cos(beta) ** 3)
        beta = np.arctan2((1 - FLATTENING) * np.sin(phi), np.cos(phi))
    # of the two quotients for the height the one that holds at the poles too
    height = level * np.cos(phi) + z * np.sin(phi) - SEMI_MAJOR * np.sqrt(1 - ECCENTRICITY2 * np.sin(phi) ** 2)
    return np.degrees(phi), np.degrees(np.arctan2(y, x)), height


def north_east_down(lat: FloatArray, lon: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices that turn north, east, down into Earth-centred axes."""
    phi, lam = np.broadcast_arrays(np.radians(lat), np.radians(lon))
    sin, cos = np.sin(phi), np.cos(phi)
    north = np.stack([-sin * np.cos(lam), -sin * np.sin(lam), cos], axis=-1)
    east = np.stack([-np.sin(lam), np.cos(lam), np.zeros_like(lam)], axis=-1)
    down = np.stack([-cos * np.cos(lam), -cos * np.sin(lam), -sin], axis=-1)
    return np.stack([north, east, down], axis=-1)
