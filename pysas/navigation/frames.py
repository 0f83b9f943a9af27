"""Local frames: x along a heading, y to its starboard, z down, in metres; tied to the Earth or to local metres.

A frame tied to a latitude and longitude is the plane that touches WGS84 there, at height 0: distances in it are true ones, and
what lies d away stands d^2/(2 R) lower in z than its depth says (0.8 mm at 100 m, 8 cm at 1 km).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.navigation import ellipsoid

_PLACES: list[tuple[int | str, ...]] = [(3,), ("n", 3), ("n", "m", 3)]


@dataclass(frozen=True, repr=False)
class Frame:
    """A right-handed local frame: x along `heading`, y to its starboard, z down.

    Parameters
    ----------
    heading : float
        Of x, rad, from north clockwise (towards east). Within a turn.
    lat, lon : float, optional
        Degrees on WGS84: where north = east = down = 0 is, on the ellipsoid. None: north, east, down are the local metres
        that navigation came in, wherever they count from.
    origin : (3,)
        Where x = y = z = 0 is, in metres north, east, down.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, or only one of lat and lon; names it.
    """

    heading: float = 0.0
    lat: float | None = None
    lon: float | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        turn = 2 * np.pi
        if abs(_checks.number("heading", self.heading)) > turn:
            raise ValueError(f"heading={self.heading!r}: expected within {turn:.4g} rad; is it in degrees?")
        object.__setattr__(self, "heading", float(self.heading))
        if (self.lat is None) != (self.lon is None):
            raise ValueError(f"lat={self.lat!r}, lon={self.lon!r}: expected both or none")
        if self.lat is not None:
            object.__setattr__(self, "lat", _checks.number("lat", self.lat, low=-90.0, high=90.0))
            object.__setattr__(self, "lon", _checks.number("lon", self.lon, low=-360.0, high=360.0))
        north, east, down = (float(v) for v in _checks.reals("origin", self.origin, [(3,)]))
        object.__setattr__(self, "origin", (north, east, down))

    @_checks.usual_errors
    def to_ned(self, position: npt.ArrayLike) -> FloatArray:
        """Metres north, east, down (of lat, lon, or of the local metres that navigation came in) of (..., 3) in this frame."""
        return np.asarray(_places("position", position) @ self._axes.T + np.array(self.origin))

    @_checks.usual_errors
    def from_ned(self, position: npt.ArrayLike) -> FloatArray:
        """Positions (..., 3) in this frame of metres north, east, down."""
        return np.asarray((_places("position", position) - np.array(self.origin)) @ self._axes)

    @_checks.usual_errors
    def to_geodetic(self, position: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Latitude, longitude (degrees, WGS84) and depth (m below the ellipsoid) of (..., 3) in this frame.

        Raises ValueError where the frame has no lat, lon.
        """
        turn, shift = self.earth()
        lat, lon, height = ellipsoid.from_earth(_places("position", position) @ turn.T + shift)
        return lat, lon, -height

    @_checks.usual_errors
    def from_geodetic(self, lat: npt.ArrayLike, lon: npt.ArrayLike, depth: npt.ArrayLike = 0.0) -> FloatArray:
        """Positions (..., 3) in this frame of places on WGS84: degrees, and m below the ellipsoid.

        Raises ValueError where the frame has no lat, lon, or for a latitude beyond 90 degrees.
        """
        shapes: list[tuple[int | str, ...]] = [(), ("n",)]
        phi, lam, down = (
            _checks.reals(name, value, shapes, ("row",)) for name, value in (("lat", lat), ("lon", lon), ("depth", depth))
        )
        if np.any(np.abs(phi) > 90):
            raise ValueError(f"lat={float(phi.flat[np.argmax(np.abs(phi) > 90)])!r}: expected -90 to 90 degrees")
        turn, shift = self.earth()
        return (ellipsoid.to_earth(phi, lam, -down) - shift) @ turn

    def earth(self) -> tuple[FloatArray, FloatArray]:
        """Matrix (3, 3) and shift (3,), m, that bring this frame into Earth-centred axes.

        Raises ValueError where the frame has no lat, lon.
        """
        if self.lat is None or self.lon is None:
            raise ValueError("frame: it has no lat, lon: expected one that is tied to the Earth")
        lat, lon = np.float64(self.lat), np.float64(self.lon)
        ned = ellipsoid.north_east_down(np.asarray(lat), np.asarray(lon))
        shift = ellipsoid.to_earth(np.asarray(lat), np.asarray(lon), np.zeros(()))
        return ned @ self._axes, shift + ned @ np.array(self.origin)

    def into(self, other: Frame) -> tuple[FloatArray, FloatArray]:
        """Matrix (3, 3) and shift (3,), m, that bring positions of this frame into another one.

        Raises ValueError where one of them is tied to the Earth and the other is not.
        """
        if (self.lat is None) != (other.lat is None):
            raise ValueError(f"frame: {other}: expected one tied to {'local metres' if self.lat is None else 'the Earth'}")
        if (self.lat, self.lon) == (other.lat, other.lon):
            turn, shift = self._axes, np.array(self.origin)
            to, base = other._axes, np.array(other.origin)
        else:
            (turn, shift), (to, base) = self.earth(), other.earth()
        return to.T @ turn, to.T @ (shift - base)

    @property
    def _axes(self) -> FloatArray:
        """Columns: x, y, z in north, east, down."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def __repr__(self) -> str:
        at = "local metres" if self.lat is None else f"latitude {self.lat:.8f}, longitude {self.lon:.8f} deg (WGS84)"
        off = "" if self.origin == (0.0, 0.0, 0.0) else " + ({:.3f}, {:.3f}, {:.3f}) m north, east, down".format(*self.origin)
        heading = round(np.degrees(self.heading), 3) % 360
        return f"Frame(x along heading {heading:.3f} deg, y to starboard of it, z down; origin: {at}{off})"


@_checks.usual_errors
def along_track(position: npt.ArrayLike, frame: Frame | None = None) -> Frame:
    """A frame whose x points along the mean track and whose origin lies in its middle, at depth 0.

    The mean track is the line of least squared distances to the positions, seen from above; it points from the first position
    to the last.

    Parameters
    ----------
    position : (n, 3)
        In m, in `frame`.
    frame : Frame, optional
        That of `position`; default: metres north, east, down.

    Returns
    -------
    Frame
        Tied to the latitude and longitude of the track's middle where `frame` is tied to the Earth, else to its local metres.
        `heading` is that of the mean track; of a track that does not move, north.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or non-finite.
    """
    frame = Frame() if frame is None else frame
    if not isinstance(frame, Frame):
        raise TypeError(f"frame={type(frame).__name__}: expected a pysas.navigation.Frame")
    places = _checks.reals("position", position, [("n", 3)], ("row",))
    if len(places) == 0:
        raise ValueError("position: no rows: expected at least one")
    middle = places.mean(axis=0)
    if frame.lat is None:
        north, east, _ = frame.to_ned(middle)
        tied = Frame(origin=(north, east, 0.0))
    else:
        lat, lon, _ = frame.to_geodetic(middle)
        tied = Frame(lat=float(lat), lon=float(lon))
    turn, shift = frame.into(tied)
    level = (places @ turn.T + shift)[:, :2]
    direction = np.linalg.svd(level - level.mean(axis=0), full_matrices=False)[2][0]
    along = (level[-1] - level[0]) @ direction
    if np.ptp(level @ direction) == 0:
        return tied
    north, east = direction if along >= 0 else -direction
    return Frame(float(np.arctan2(east, north)) % (2 * np.pi), tied.lat, tied.lon, tied.origin)


def _places(name: str, value: npt.ArrayLike) -> FloatArray:
    return _checks.reals(name, value, _PLACES)
