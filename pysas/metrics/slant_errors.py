"""Error of a track as an image sees it: along the line of sight, less what no image can tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes

# A line of sight that turns by less than about this (rad) from end to end tells nothing about shifts along the track.
_TURNED = 0.05


@_checks.usual_errors
def track_error(found: Any, true: Any, range: float, *, seabed: float = 8.0, boresight: npt.ArrayLike | None = None) -> float:
    """RMS error of a track along the line of sight, m, after what no image can tell has been taken out.

    The error of a ping is u . (found - true) with u the unit vector from the true track to the seabed at slant range `range` in
    the direction of look: with h the plane's z less the track's mean, sqrt(1 - (h/range)^2) times what lies across the
    track plus h/range times the heave. Echoes' two-way path is wrong by twice that.

    Track and scene may move together, and turn together about z, and no echo changes. So the least-squares fit of a shift and
    of a turn is taken out: on a straight track a constant and a linear trend along it (heading), on a circle a shift of the
    centre and a constant. Shifts along the track are fitted only where the line of sight turns by more than about 0.05 rad.

    Parameters
    ----------
    found, true : Echoes, Track or (ping, 3) array_like
        Two of one kind, of the same pings. Of Echoes the means of each ping's phase centres at transmission are compared, of
        tracks the positions.
    range : float
        Slant range, m, > 0.
    seabed : float
        z of the seabed's plane, m. Its distance from the track's mean z is at most `range`.
    boresight : (3,) or (ping, 3) array_like, optional
        Direction of look, of which the horizontal part counts. Default: that of the true echoes' beam; else 90 degrees from the
        true track's yaw, or from the way from ping to ping where there is none, from +x towards +y.

    Returns
    -------
    float

    Raises
    ------
    ValueError, TypeError
        Values out of range, not finite, of different kinds or numbers of pings; fewer than 3 pings, of which nothing
        would be left; a seabed farther than `range`; a vertical boresight, or none where the pings do not move.

    Notes
    -----
    O(pings). For the loss that an image suffers take the pings of one aperture: white errors of rms s cost 4.34 (4 pi s /
    wavelength)^2 dB of a peak, smooth ones over a longer track less.
    """
    (position, _), (base, heading) = _positions("found", found), _positions("true", true)
    if isinstance(found, Echoes) != isinstance(true, Echoes):
        raise TypeError(f"found={type(found).__name__}, true={type(true).__name__}: expected two of one kind")
    n = len(base)
    if len(position) != n:
        raise ValueError(f"found: {len(position)} pings: expected {n}, as many as true")
    if n < 3:
        raise ValueError(f"true: {n} pings: expected at least 3: shift and trend leave nothing of fewer")
    range = _checks.number("range", range, positive=True)
    down = _checks.number("seabed", seabed) - float(base[:, 2].mean())
    if abs(down) > range:
        raise ValueError(f"range={range:g}: the seabed at z={seabed:g} m is {abs(down):g} m off: expected at least that")
    if boresight is None and isinstance(true, Echoes) and true.beam is not None:
        look = np.broadcast_to(true.beam.boresights, (n, 3))
    elif boresight is not None:
        look = np.broadcast_to(_checks.reals("boresight", boresight, [(3,), (n, 3)], ("ping",)), (n, 3))
    else:
        way = np.gradient(base, axis=0) if heading is None else np.stack([np.cos(heading), np.sin(heading)], axis=1)
        look = np.stack([-way[:, 1], way[:, 0]], axis=1)
    level = np.hypot(look[:, 0], look[:, 1])
    if not np.all(level > 0):
        raise ValueError(f"boresight: no horizontal direction at ping {int(np.argmin(level))}: expected one (or `boresight`)")
    sine = down / range
    sight = np.concatenate([np.sqrt(1 - sine**2) * look[:, :2] / level[:, None], np.full((n, 1), sine)], axis=1)
    error = np.sum(sight * (position - base), axis=1)
    away = base - base.mean(axis=0)
    turn = sight[:, 1] * away[:, 0] - sight[:, 0] * away[:, 1]
    extent = float(np.sqrt(np.mean(away[:, :2] ** 2)))
    free = np.column_stack([sight, turn / extent]) if extent > 0 else sight
    fit = np.linalg.lstsq(free, error, rcond=_TURNED)[0]
    return float(np.sqrt(np.mean((error - free @ fit) ** 2)))


def _positions(name: str, value: Any) -> tuple[FloatArray, FloatArray | None]:
    """(ping, 3) m, and the heading where there is one."""
    if isinstance(value, Echoes):
        return np.asarray((value.tx + value.receivers.mean(axis=1)) / 2), None
    heading = getattr(value, "yaw", None)
    place = getattr(value, "position", value)  # a Track, whose module stands above this one
    return _checks.reals(name, place, [("ping", 3)], ("ping",)), heading
