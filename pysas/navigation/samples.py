"""Poses: where the vehicle's reference point was and how it stood, sample by sample, and between samples by splines.

Positions follow cubic splines (not-a-knot), attitudes the cubic splines of rotations of scipy's RotationSpline, both with a
continuous second derivative. A gap longer than `max_gap` ends one spline and begins another: nothing is told inside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from pysas import _checks
from pysas._checks import FloatArray
from pysas.navigation import ellipsoid
from pysas.navigation._columns import FINEST_PLACE, column, named, times
from pysas.navigation.attitudes import AXES, ENU_TO_NED
from pysas.navigation.frames import Frame
from pysas.navigation.projection import from_utm, rounded_degrees

_INTERVALS = 4  # median intervals that a gap may last unless `max_gap` says otherwise
_FASTEST = 100.0  # m/s; no sonar's vehicle is faster


@dataclass(frozen=True, eq=False, repr=False)
class Poses:
    """Samples of navigation in one local frame, of one reference point of the vehicle.

    `from_geodetic`, `from_utm` and `from_local` make them of what recorders write.

    Parameters
    ----------
    time : (n,)
        In s on any one clock, increasing; n >= 2. UNIX time in float64 is known to 0.24 microseconds.
    position : (n, 3)
        Reference point, m, in `frame`'s x, y, z (z down).
    attitude : scipy.spatial.transform.Rotation of length n
        Turns the vehicle's forward, starboard, down into `frame`'s x, y, z.
    frame : Frame
        Default: metres north, east, down.
    max_gap : float, optional
        Longest time between two samples that is interpolated over, s. Default: 4 times the median interval.
    source : str
        Name of the file it came from, for messages.

    Raises
    ------
    ValueError, TypeError
        Wrong shape or dtype, non-finite, times that repeat or run backwards, times or places rounded by their dtype,
        positions that move at more than 100 m/s; names the file and the row, counted from 0.
    """

    time: FloatArray
    position: FloatArray
    attitude: Rotation
    frame: Frame = Frame()
    max_gap: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("time", times(self._named("time"), self.time, "row"))
        n = len(self.time)
        if n < 2:
            raise ValueError(f"{self._named('time')}: {n} rows: expected at least 2")
        put("position", column(self._named("position"), self.position, [(n, 3)], finest=FINEST_PLACE))
        if not isinstance(self.attitude, Rotation):
            found = type(self.attitude).__name__
            raise TypeError(
                f"attitude={found}: expected rotations, as pysas.navigation.euler, quaternions and matrices make them"
            )
        turns = self.attitude.as_quat()
        if turns.shape != (n, 4):
            raise ValueError(f"{self._named('attitude')}: {turns.size // 4} rotations: expected one for each of {n} rows")
        put("attitude", Rotation.from_quat(turns))  # a copy: rotations can be written to
        if not isinstance(self.frame, Frame):
            raise TypeError(f"frame={type(self.frame).__name__}: expected a pysas.navigation.Frame")
        interval = np.diff(self.time)
        if self.max_gap is None:
            put("max_gap", _INTERVALS * float(np.median(interval)))
        else:
            put("max_gap", _checks.number("max_gap", self.max_gap, positive=True))
        speed = np.linalg.norm(np.diff(self.position, axis=0), axis=1) / interval
        if np.max(speed) > _FASTEST:
            row = int(np.argmax(speed))
            raise ValueError(
                f"{self._named('position')}: {speed[row]:.4g} m/s from row {row} to row {row + 1}: "
                f"expected below {_FASTEST:g} m/s"
            )

    @classmethod
    @_checks.usual_errors
    def from_geodetic(
        cls,
        time: npt.ArrayLike,
        lat: npt.ArrayLike,
        lon: npt.ArrayLike,
        attitude: Rotation,
        *,
        depth: npt.ArrayLike | None = None,
        height: npt.ArrayLike | None = None,
        max_gap: float | None = None,
        source: str = "",
    ) -> Poses:
        """Poses of latitudes and longitudes on WGS84.

        Parameters
        ----------
        time, max_gap, source
            As for `Poses`.
        lat, lon : (n,)
            Degrees, north and east; float64 (float32 resolves 0.4 m).
        attitude : scipy.spatial.transform.Rotation of length n
            Turns forward, starboard, down into true north, east, down where the vehicle is.
        depth, height : (n,)
            One of the two: m below or above the ellipsoid. Depth below the sea's surface does as well, for positions off by
            the geoid's height/6,400 km: 8 mm in a km for 50 m.

        Returns
        -------
        Poses
            In the frame of the middle sample: exact (WGS84 to Earth-centred to local), not projected.

        Raises
        ------
        ValueError, TypeError
            As `Poses`; a latitude beyond 90 or a longitude beyond 360 degrees; both or none of depth and height.
        """
        phi, lam = rounded_degrees(named(source, "lat"), lat, 90), rounded_degrees(named(source, "lon"), lon, 360)
        if phi.size == 0 or lam.size != phi.size:
            raise ValueError(
                f"{named(source, 'lon')}: {lam.size} rows beside {phi.size} of lat: expected as many, and not none"
            )
        down = _down(depth, height, phi.size, source)
        middle = phi.size // 2
        frame = Frame(lat=float(phi[middle]), lon=float(lam[middle]))
        turn, shift = frame.earth()
        position = (ellipsoid.to_earth(phi, lam, -down) - shift) @ turn
        level = Rotation.from_matrix(turn.T @ ellipsoid.north_east_down(phi, lam))
        return cls(
            times(named(source, "time"), time, "row"),
            position,
            _turned(level, attitude, phi.size, source),
            frame,
            max_gap,
            source,
        )

    @classmethod
    def from_utm(
        cls,
        time: npt.ArrayLike,
        easting: npt.ArrayLike,
        northing: npt.ArrayLike,
        zone: int,
        attitude: Rotation,
        *,
        south: bool = False,
        depth: npt.ArrayLike | None = None,
        height: npt.ArrayLike | None = None,
        max_gap: float | None = None,
        source: str = "",
    ) -> Poses:
        """Poses of UTM coordinates on WGS84.

        Parameters
        ----------
        easting, northing : (n,)
            In m, float64 (float32 resolves 0.5 m).
        zone, south
            As for `pysas.navigation.from_utm`.
        time, attitude, depth, height, max_gap, source
            As for `from_geodetic`; yaw counts from true north, not from grid north.

        Returns
        -------
        Poses
            As `from_geodetic`: neither the projection's scale (0.9996 to 1.001) nor its convergence is left in it.

        Raises
        ------
        ValueError, TypeError
            As `from_geodetic` and `pysas.navigation.from_utm`.
        """
        lat, lon = from_utm(easting, northing, zone, south=south, source=source)
        return cls.from_geodetic(time, lat, lon, attitude, depth=depth, height=height, max_gap=max_gap, source=source)

    @classmethod
    def from_local(
        cls,
        time: npt.ArrayLike,
        position: npt.ArrayLike,
        attitude: Rotation,
        *,
        axes: str = "NED",
        max_gap: float | None = None,
        source: str = "",
    ) -> Poses:
        """Poses of local metres.

        Parameters
        ----------
        position : (n, 3)
            In m: "NED": north, east, down; "ENU": east, north, up. Axes need not be the compass's: any right-handed
            x, y, z with z down, or with z up, do as well where yaw counts from their x.
        attitude : scipy.spatial.transform.Rotation of length n
            As `euler`, `quaternions` and `matrices` with the same `axes` make them.
        axes : {"NED", "ENU"}
            What the columns of `position` are.
        time, max_gap, source
            As for `Poses`.

        Returns
        -------
        Poses
            In metres north, east, down.

        Raises
        ------
        ValueError, TypeError
            As `Poses`.
        """
        places = column(named(source, "position"), position, [("n", 3)], finest=FINEST_PLACE)
        if _checks.choice("axes", axes, AXES) == "ENU":
            places = places @ ENU_TO_NED.T
        return cls(times(named(source, "time"), time, "row"), places, attitude, Frame(), max_gap, source)

    @property
    def n_sample(self) -> int:
        """Number of samples."""
        return len(self.time)

    @_checks.usual_errors
    def at(self, time: npt.ArrayLike) -> tuple[FloatArray, Rotation]:
        """Position (n, 3), m in `frame`, and attitude at times (n,), s.

        Raises
        ------
        ValueError, TypeError
            Not (n,) finite times, or one before the first sample, after the last, or in a gap; names it and the rows.

        Notes
        -----
        Error of the cubic spline between samples h apart: 5/384 h^4 max |fourth derivative| (C. A. Hall and W. W. Meyer
        1976), 0.4 mm for a heave of 1 m amplitude and 3 s period sampled at 5 Hz. O(samples + n log samples).
        """
        when = column("time", time, [("n",)])
        self.require(when, when, lambda i: f"time: {when[i]:.6f} s at index {i}")
        return self._evaluate(when)

    def require(self, start: FloatArray, stop: FloatArray, told: Callable[[int], str]) -> None:
        """Check that poses are known from each of `start` to its `stop` (n,), s; `told` names the i-th in the message."""
        runs = self._runs()
        first, last = self.time[runs[:, 0]], self.time[runs[:, 1]]
        run = np.searchsorted(first, start, side="right") - 1
        missing = np.flatnonzero((run < 0) | (stop > last[run]))
        if missing.size == 0:
            return
        i = int(missing[0])
        begin, end = (int(row) for row in runs[[0, -1], [0, 1]])
        if start[i] < self.time[begin]:
            what = f"before {self._named('time')} begins: {self.time[begin]:.6f} s at row {begin}"
            count = int(np.sum(start < self.time[begin]))
        elif stop[i] > self.time[end]:
            what = f"it ends {stop[i] - self.time[end]:.6g} s after {self._named('time')}: {self.time[end]:.6f} s at row {end}"
            count = int(np.sum(stop > self.time[end]))
        else:
            before, after = (int(row) for row in (runs[run[i], 1], runs[run[i] + 1, 0]))
            left, right = self.time[before], self.time[after]
            what = (
                f"in a gap of {self._named('time')}: {left:.6f} s at row {before} to {right:.6f} s at row {after}, "
                f"{right - left:.6g} s: expected at most max_gap = {self.max_gap:.6g} s"
            )
            count = int(np.sum((start < right) & (stop > left)))
        raise ValueError(f"{told(i)}: {what}{f'; {count} such in all' if count > 1 else ''}")

    def _runs(self) -> npt.NDArray[np.intp]:
        """First and last rows (m, 2) of what is interpolated as one; a lone sample between gaps is none."""
        cuts = np.flatnonzero(np.diff(self.time) > self._longest) + 1
        runs = np.stack([np.concatenate([[0], cuts]), np.concatenate([cuts, [self.n_sample]]) - 1], axis=1)
        runs = runs[runs[:, 1] > runs[:, 0]]
        if len(runs) == 0:
            raise ValueError(f"max_gap={self.max_gap:.6g} s: below all intervals of {self._named('time')}: expected more")
        return runs

    def _evaluate(self, time: FloatArray) -> tuple[FloatArray, Rotation]:
        position, turns = np.empty((time.size, 3)), np.empty((time.size, 4))
        runs = self._runs()
        run = np.searchsorted(self.time[runs[:, 0]], time, side="right") - 1
        for k in np.unique(run):
            first, last = runs[k]
            inside, rows = run == k, slice(first, last + 1)
            knots, when = self.time[rows] - self.time[first], time[inside] - self.time[first]
            position[inside] = CubicSpline(knots, self.position[rows])(when)
            turns[inside] = RotationSpline(knots, self.attitude[rows])(when).as_quat()
        return position, Rotation.from_quat(turns)

    @property
    def _longest(self) -> float:
        """`max_gap`, always a number."""
        if self.max_gap is None:
            raise _checks.InternalError("max_gap: not set")
        return self.max_gap

    def _named(self, name: str) -> str:
        return named(self.source, name)

    def __repr__(self) -> str:
        gaps = int(np.sum(np.diff(self.time) > self._longest))
        step = float(np.median(np.diff(self.time)))
        length = float(np.sum(np.linalg.norm(np.diff(self.position, axis=0), axis=1)))
        return "\n".join(
            [
                f"Poses: {self.n_sample} samples, {self.time[0]:.3f} to {self.time[-1]:.3f} s, median interval {step:.6g} s"
                f"{f' ({self.source})' if self.source else ''}",
                f"  frame      {self.frame}",
                f"  position   {length:.4g} m of track, z {self.position[:, 2].min():.3f} to {self.position[:, 2].max():.3f} m "
                "(down); cubic splines between samples",
                "  attitude   Rz(yaw) Ry(pitch) Rx(roll) of forward, starboard, down; splines of rotations between samples",
                f"  gaps       {gaps} longer than max_gap = {self.max_gap:.6g} s",
            ]
        )


def _down(depth: npt.ArrayLike | None, height: npt.ArrayLike | None, n: int, source: str) -> FloatArray:
    if (depth is None) == (height is None):
        raise ValueError(f"depth, height: {'none' if depth is None else 'both'} given: expected one of the two")
    if depth is not None:
        return column(named(source, "depth"), depth, [(n,)], finest=FINEST_PLACE)
    return -column(named(source, "height"), height, [(n,)], finest=FINEST_PLACE)


def _turned(level: Rotation, attitude: Rotation, n: int, source: str) -> Rotation:
    """Attitudes about each place's own north, east, down as those in the frame."""
    if not isinstance(attitude, Rotation) or attitude.as_quat().shape != (n, 4):
        return attitude  # which `Poses` refuses
    return level * attitude
