"""UTM on WGS84: the transverse Mercator projection by Krueger's series in the third flattening.

C. F. F. Karney, Transverse Mercator with an accuracy of a few nanometers, J. Geodesy 85 (2011), Eqs 7-12 and 35, here to the
fourth order: 0.2 micrometres within a zone. The way back solves the same series, so the two are each other's inverse.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.navigation._columns import FINEST_PLACE, METRES_A_DEGREE, column, named, within
from pysas.navigation.ellipsoid import ECCENTRICITY2, FLATTENING, SEMI_MAJOR

_SCALE, _FALSE_EASTING, _FALSE_NORTHING = 0.9996, 500e3, 10000e3
_N = FLATTENING / (2 - FLATTENING)
_RADIUS = SEMI_MAJOR / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_ALPHA = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16 + 41 * _N**4 / 180,
    13 * _N**2 / 48 - 3 * _N**3 / 5 + 557 * _N**4 / 1440,
    61 * _N**3 / 240 - 103 * _N**4 / 140,
    49561 * _N**4 / 161280,
)
_ECCENTRICITY = float(np.sqrt(ECCENTRICITY2))
_STEPS = 12  # of fixed points that gain a factor 1/e^2 = 150 a step
_EASTINGS = (100e3, 900e3)  # m
_WIDEST = 60.0  # deg from the zone's middle; near poles eastings allow that many


@_checks.usual_errors
def to_utm(lat: npt.ArrayLike, lon: npt.ArrayLike, zone: int, *, south: bool = False) -> tuple[FloatArray, FloatArray]:
    """Easting and northing of places on WGS84.

    Parameters
    ----------
    lat, lon : float or (n,)
        Degrees, north and east.
    zone : int
        1 to 60; its middle lies at 6 zone - 183 degrees east. Places of a neighbouring zone do, to eastings of 100 and 900 km.
    south : bool
        Whether northings count from 10,000 km, as in zones of the southern hemisphere.

    Returns
    -------
    easting, northing : float64
        In m, shaped as `lat`.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; names the row.
    """
    lat, lon = column("lat", lat, [(), ("n",)]), column("lon", lon, [(), ("n",)])
    within("lat", np.atleast_1d(lat), -90, 90, "degrees")
    offset = (lon - _middle(zone) + 180) % 360 - 180
    within("lon", np.atleast_1d(offset), -_WIDEST, _WIDEST, f"degrees from the middle of zone {zone}")
    phi, lam = np.radians(lat), np.radians(offset)
    conformal = np.sinh(np.arcsinh(np.tan(phi)) - _ECCENTRICITY * np.arctanh(_ECCENTRICITY * np.sin(phi)))
    sphere = np.arctan2(conformal, np.cos(lam)) + 1j * np.arcsinh(np.sin(lam) / np.hypot(conformal, np.cos(lam)))
    plane = _SCALE * _RADIUS * (sphere + _series(sphere))
    easting, northing = plane.imag + _FALSE_EASTING, plane.real + (_FALSE_NORTHING if south else 0.0)
    within("easting", np.atleast_1d(easting), *_EASTINGS, f"m in zone {zone}")
    return easting, northing


@_checks.usual_errors
def from_utm(
    easting: npt.ArrayLike, northing: npt.ArrayLike, zone: int, *, south: bool = False, source: str = ""
) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude (degrees, WGS84) of UTM coordinates.

    Parameters
    ----------
    easting, northing : float or (n,)
        In m, of a dtype that resolves them to 0.1 mm: float32 does not.
    zone, south
        As for `to_utm`.
    source : str
        Name of the file they came from, for messages.

    Returns
    -------
    lat, lon : float64
        Degrees, shaped as `easting`.

    Raises
    ------
    ValueError, TypeError
        Easting outside 100 to 900 km or northing outside 0 to 10,000 km, both of one length, or rounded; names the row.
    """
    shapes: list[tuple[int | str, ...]] = [(), ("n",)]
    east = column(named(source, "easting"), easting, shapes, finest=FINEST_PLACE)
    north = column(named(source, "northing"), northing, [east.shape], finest=FINEST_PLACE)
    within(named(source, "easting"), np.atleast_1d(east), *_EASTINGS, "m", " (UTM)")
    within(named(source, "northing"), np.atleast_1d(north), 0.0, 10000e3, "m", " (UTM)")
    from_equator, from_middle = north - (_FALSE_NORTHING if south else 0.0), east - _FALSE_EASTING
    plane: npt.NDArray[np.complex128] = np.asarray((from_equator + 1j * from_middle) / (_SCALE * _RADIUS))
    sphere = plane
    for _ in range(_STEPS):
        sphere = plane - _series(sphere)
    conformal = np.arcsinh(np.sin(sphere.real) / np.hypot(np.sinh(sphere.imag), np.cos(sphere.real)))
    lam = np.arctan2(np.sinh(sphere.imag), np.cos(sphere.real))
    phi = np.arctan(np.sinh(conformal))
    for _ in range(_STEPS):
        phi = np.arctan(np.sinh(conformal + _ECCENTRICITY * np.arctanh(_ECCENTRICITY * np.sin(phi))))
    return np.degrees(phi), (np.degrees(lam) + _middle(zone) + 180) % 360 - 180


def rounded_degrees(name: str, value: npt.ArrayLike, limit: float) -> FloatArray:
    """Latitudes or longitudes in degrees within `limit`, not rounded to more than 0.1 mm by their dtype."""
    degrees = column(name, value, [("n",)], finest=FINEST_PLACE / METRES_A_DEGREE)
    within(name, degrees, -limit, limit, "degrees")
    return degrees


def _middle(zone: int) -> float:
    return 6.0 * _checks.whole("zone", zone, 1, 60) - 183.0


def _series(sphere: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    return np.asarray(sum(alpha * np.sin(2 * (j + 1) * sphere) for j, alpha in enumerate(_ALPHA)))
