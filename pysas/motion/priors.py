"""What else is known of a track's errors: standard deviations of an inertial navigation system, and what stands in for none."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from pysas import _checks


@dataclass(frozen=True)
class Prior:
    """Errors of the navigation that the claimed track came from, one standard deviation each; None: not known.

    Parameters
    ----------
    speed : float, optional
        Of the velocity along x and y, independent from ping to ping, m/s: steps of position are believed to speed times the
        time between pings.
    heading : float, optional
        Of each ping's heading, rad.
    gyro : float, optional
        Of the change of heading from one ping to the next, rad: what the heading is worth where fewer than two phase centres
        overlap.
    depth : float, optional
        Of each ping's z, independent from ping to ping, m.

    Raises
    ------
    ValueError, TypeError
        What is not a finite number > 0.
    """

    speed: float | None = None
    heading: float | None = None
    gyro: float | None = None
    depth: float | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                object.__setattr__(self, field.name, _checks.number(field.name, value, positive=True))


# What is believed where nobody says better: enough to fix what echoes cannot see, a shift and a turn of the whole, and to join
# pings that no echo joins by the claimed track; a thousandth of what echoes know of a ping.
POSITION, HEADING = 1.0, 0.1  # m, rad: of each ping
STEP, TURN = 0.05, 0.1  # m, rad: of the change from one ping to the next
BRIDGE_STEP, BRIDGE_TURN = 2e-3, 1e-3  # m, rad: the same, from what it is before and after, where a ping saw nothing
