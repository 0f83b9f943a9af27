"""Where strips lie on a map: from their axes through the line's coordinates and its frame to a CRS, and back.

A map is a projected CRS, where frames are tied to the Earth; else local metres: east and north where frames have a heading,
the lines' own x and y where they have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import rasters
from pysas.navigation import Frame, ellipsoid
from pysas.survey.image_store import StripStore

Pair = tuple[FloatArray, FloatArray]

MAP_ERROR = 1e-4  # m, of places interpolated between those of a lattice
_ROUND_TRIP = 1e-3  # m, to a map and back: beyond, the CRS does not hold where the survey is
_DEPTHS = 3  # steps towards the depth of a strip's plane, each of which gains a factor 2 (R/d)^2 at d from a frame's origin
_EDGE = 33  # places along an edge that tell how far a strip reaches
_MOST_CELLS = 64  # of a lattice along an axis
_UTM_LATITUDES = (-80.0, 84.0)
_EARTH, _NORTH_EAST, _PLAIN = "tied to the Earth", "in local metres north and east", "in local metres without a frame"


@dataclass(frozen=True)
class Axis:
    """Pixels' places along an axis of a strip, with equal steps, which may be negative."""

    first: float
    step: float
    size: int

    @classmethod
    def of(cls, name: str, values: FloatArray) -> Axis:
        """Raises ValueError where steps differ, by more than a thousandth."""
        return cls(*rasters.even(name, values), values.size)

    def edges(self) -> FloatArray:
        """Places along the whole of it, from edge to edge."""
        return self.first + self.step * np.linspace(-0.5, self.size - 0.5, _EDGE)


class Place:
    """Where a strip lies.

    Attributes
    ----------
    x, y : Axis
    track : float
        y of the mean track, m.
    """

    def __init__(self, strip: StripStore) -> None:
        attributes = strip.attributes
        try:
            self.x, self.y = Axis.of("x", strip.x), Axis.of("y", strip.y)
            east, north = _checks.reals("origin", attributes["origin"], [(2,)])
            self._origin = float(east), float(north)
            turn = _checks.number("rotation", attributes["rotation"])
            self._cos, self._sin = math.cos(turn), math.sin(turn)
            self.track = _checks.number("track", attributes["track"])
            z = attributes.get("z")
            self._z = 0.0 if z is None else _checks.number("z", z)
            given = attributes.get("frame")
            self._frame = None if given is None else _frame(given)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{strip.name}: {error}") from error
        except KeyError as error:
            raise ValueError(f"{strip.name}: {error}: missing, expected an attribute of the strip") from error
        self.kind = _PLAIN if self._frame is None else _NORTH_EAST if self._frame.lat is None else _EARTH
        self._transformer: Any = None

    def put_on(self, transformer: Any) -> None:
        """Choose the map: what brings longitude and latitude to it (pyproj)."""
        self._transformer = transformer

    def corners(self) -> FloatArray:
        """Earth-centred places (4, 3), m, of the corners of a strip that is tied to the Earth."""
        x, y = (np.array([axis.edges()[0], axis.edges()[-1]]) for axis in (self.x, self.y))
        lat, lon, depth = self._tied().to_geodetic(self._line(np.repeat(x, 2), np.tile(y, 2)))
        return ellipsoid.to_earth(lat, lon, -depth)

    def bounds(self) -> tuple[float, float, float, float]:
        """Least and largest x, least and largest y, on the map, of the strip's pixels and their halves beyond them.

        Raises ValueError where the map does not hold there.
        """
        x, y = self.x.edges(), self.y.edges()
        ring_x = np.concatenate([x, x, np.full(_EDGE, x[0]), np.full(_EDGE, x[-1])])
        ring_y = np.concatenate([np.full(_EDGE, y[0]), np.full(_EDGE, y[-1]), y, y])
        east, north = self.to_map(ring_x, ring_y)
        if np.isfinite(east).all() and np.isfinite(north).all():
            back = self.from_map(east, north)
            if max(np.abs(back[0] - ring_x).max(), np.abs(back[1] - ring_y).max()) <= _ROUND_TRIP:
                return float(east.min()), float(east.max()), float(north.min()), float(north.max())
        raise ValueError("does not hold where the survey is: expected one that does")

    def to_map(self, x: FloatArray, y: FloatArray) -> Pair:
        """Places (n,) on the map of places on the strip's axes."""
        line = self._line(x, y)
        if self._frame is None:
            return line[:, 0], line[:, 1]
        if self._frame.lat is None:
            ned = self._frame.to_ned(line)
            return ned[:, 1], ned[:, 0]
        lat, lon, _ = self._frame.to_geodetic(line)
        east, north = self._transformer.transform(lon, lat)
        return np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)

    def from_map(self, east: FloatArray, north: FloatArray) -> Pair:
        """Places (n,) on the strip's axes, exactly: of those on the strip's plane at `z` that have these coordinates."""
        if self._frame is None:
            x, y = east, north
        elif self._frame.lat is None:
            found = self._frame.from_ned(np.stack([north, east, np.full(east.shape, self._z)], axis=-1))
            x, y = found[:, 0], found[:, 1]
        else:
            lon, lat = self._transformer.transform(east, north, direction="INVERSE")
            if not (np.isfinite(lon).all() and np.isfinite(lat).all()):  # beyond the map's end: no place of the strip
                ok = np.isfinite(lon) & np.isfinite(lat)
                x, y = np.full(east.shape, np.inf), np.full(east.shape, np.inf)
                if ok.any():
                    x[ok], y[ok] = self.from_map(east[ok], north[ok])
                return x, y
            depth = np.full(east.shape, self._z)
            for _ in range(_DEPTHS):
                found = self._frame.from_geodetic(lat, lon, depth)
                depth = depth + self._z - found[:, 2]
            x, y = found[:, 0], found[:, 1]
        x, y = x - self._origin[0], y - self._origin[1]
        return self._cos * x + self._sin * y, self._cos * y - self._sin * x

    def _line(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The line's own coordinates (n, 3)."""
        east, north = self._origin
        return np.stack(
            [east + self._cos * x - self._sin * y, north + self._sin * x + self._cos * y, np.full(x.shape, self._z)], axis=-1
        )

    def _tied(self) -> Frame:
        if self._frame is None:
            raise _checks.InternalError("a strip without a frame")
        return self._frame


def _frame(given: Any) -> Frame:
    if not isinstance(given, Mapping) or not set(given) <= {"heading", "lat", "lon", "origin"}:
        raise ValueError(f"frame: found {given!r:.80}, expected heading, lat, lon and origin")
    return Frame(**given)


@dataclass(frozen=True)
class Chart:
    """The map that strips are put on.

    `crs` is a pyproj.CRS, or None for local metres; `axes` says what x and y of the map are.
    """

    crs: Any
    axes: tuple[str, str]
    places: list[Place]
    bounds: FloatArray  # (strip, 4): least and largest x, least and largest y


def chart(strips: Sequence[StripStore], crs: Any) -> Chart:
    """Put strips on a map: the CRS given, that of UTM's zone about their middle, or their local metres.

    Raises
    ------
    ValueError
        Strips of different kinds; a CRS that does not exist, has not metres to the east and north, or does not hold there.
    ImportError
        Strips are tied to the Earth, or a CRS is given, and pyproj is not installed.
    """
    places = [Place(strip) for strip in strips]
    for strip, place in zip(strips, places, strict=True):
        if place.kind != places[0].kind:
            raise ValueError(
                f"{strips[0].name} is {places[0].kind}, {strip.name} {place.kind}: expected strips that are tied to one thing"
            )
    kind = places[0].kind
    if kind != _EARTH:
        if crs is not None:
            raise ValueError(f"crs={crs!r:.60}: the survey is {kind}: expected None, or lines tied to the Earth")
        axes = ("east", "north") if kind == _NORTH_EAST else ("x", "y")
        return Chart(None, axes, places, np.array([place.bounds() for place in places]))
    pyproj = library()
    name = _utm(places) if crs is None else crs
    found = projected(name)
    transformer = pyproj.Transformer.from_crs("EPSG:4326", found, always_xy=True)
    bounds = []
    _warn_of_area(found, name, places)
    for place in places:
        place.put_on(transformer)
        try:
            bounds.append(place.bounds())
        except ValueError as error:
            raise ValueError(f"crs={name!r:.60}: {error}") from None
    return Chart(found, ("easting", "northing"), places, np.array(bounds))


def _warn_of_area(crs: Any, name: Any, places: Sequence[Place]) -> None:
    area = crs.area_of_use
    lat, lon = _middle(places)
    if area is not None and not (area.south <= lat <= area.north and _within(lon, area.west, area.east)):
        where = f"latitude {lat:.3f}, longitude {lon:.3f}"
        _checks.warn(f"crs={name!r:.60}: {crs.name} is meant for {area.name:.120}, the survey lies at {where}")


def _within(lon: float, west: float, east: float) -> bool:
    """Whether a meridian lies between two, eastwards from the first."""
    return (lon - west) % 360 <= (east - west) % 360 or (east - west) % 360 == 0


def projected(crs: Any) -> Any:
    """A pyproj.CRS of eastings and northings in metres.

    Raises ValueError for one that does not exist or is not of that kind.
    """
    pyproj = library()
    try:
        found = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError:
        raise ValueError(f"crs={crs!r:.60}: no such CRS: expected one that pyproj knows, such as 'EPSG:32632'") from None
    axes = found.axis_info[:2]
    if not found.is_projected or any(axis.unit_conversion_factor != 1 for axis in axes):
        raise ValueError(f"crs={crs!r:.60}: {found.name}: expected a projected CRS in metres, such as one of UTM")
    if any(axis.direction == "west" for axis in axes):
        raise ValueError(f"crs={crs!r:.60}: {found.name} counts westwards: expected eastings and northings")
    return found


def _utm(places: Sequence[Place]) -> str:
    """The zone of UTM about the middle of all corners."""
    lat, lon = _middle(places)
    low, high = _UTM_LATITUDES
    if not low <= lat <= high:
        raise ValueError(f"crs=None: the survey lies at latitude {lat:.3f}, beyond UTM: expected a CRS for there")
    zone = int((lon + 180) // 6) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"


def _middle(places: Sequence[Place]) -> tuple[float, float]:
    """Latitude and longitude of the middle of all corners."""
    lat, lon, _ = ellipsoid.from_earth(np.concatenate([place.corners() for place in places]).mean(axis=0))
    return float(lat), float(lon)


def library() -> Any:
    try:
        import pyproj
        import pyproj.exceptions
    except ImportError:
        raise _checks.optional("pyproj", "survey") from None
    return pyproj


def over(inverse: Callable[[FloatArray, FloatArray], Pair], east: FloatArray, north: FloatArray) -> Pair:
    """Places (row, column) on a strip's axes of a window's pixels, whose centres are `east` (column,) and `north` (row,).

    Exact on a lattice and bilinear in between. A lattice is halved until the middles of its cells' sides, where interpolation
    is off the most, are right to `MAP_ERROR`: the middles of the cells would not do, as second derivatives along the two axes
    cancel there where a map is conformal.
    """
    cells = 1
    while cells <= min(_MOST_CELLS, max(east.size, north.size)):
        at_east, at_north = (np.linspace(axis[0], axis[-1], 2 * cells + 1) for axis in (east, north))
        mesh = [part.ravel() for part in np.meshgrid(at_east, at_north)]
        exact = [part.reshape(at_north.size, at_east.size) for part in inverse(mesh[0], mesh[1])]
        off = max(float(np.max(np.abs(part[::2, :-2:2] + part[::2, 2::2] - 2 * part[::2, 1::2]))) for part in exact)
        off = max(off, *(float(np.max(np.abs(part[:-2:2, ::2] + part[2::2, ::2] - 2 * part[1::2, ::2]))) for part in exact))
        if off / 2 <= MAP_ERROR:
            rows, columns = _weights(north, 2 * cells), _weights(east, 2 * cells)
            return rows @ exact[0] @ columns.T, rows @ exact[1] @ columns.T
        cells *= 2
    mesh = [part.ravel() for part in np.meshgrid(east, north)]
    x, y = inverse(mesh[0], mesh[1])
    return x.reshape(north.size, east.size), y.reshape(north.size, east.size)


def _weights(axis: FloatArray, cells: int) -> FloatArray:
    """Weights (entry, cells + 1) of linear interpolation from equally many places between an axis's ends."""
    span = axis[-1] - axis[0]
    at = (axis - axis[0]) * (cells / span if span else 0.0)
    low = np.minimum(at.astype(np.intp), cells - 1)
    weights = np.zeros((axis.size, cells + 1))
    weights[np.arange(axis.size), low] = 1 - (at - low)
    weights[np.arange(axis.size), low + 1] += at - low
    return weights
