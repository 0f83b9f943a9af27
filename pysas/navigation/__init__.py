"""Navigation: clocks, positions, attitudes and lever arms -> the `tx`, `rx` and `velocity` that `pysas.Echoes` wants.

Local axes are x, y, z with z down: north, east, down where a frame's heading is 0, else x along the heading and y to its
starboard. The vehicle's axes are forward, starboard, down. `docs/navigation.md` has all conventions.
"""

from pysas.navigation.arms import Geometry, geometry, pulse_centre
from pysas.navigation.attitudes import euler, matrices, quaternions
from pysas.navigation.frames import Frame, along_track
from pysas.navigation.projection import from_utm, to_utm
from pysas.navigation.samples import Poses

__all__ = [
    "Frame", "Geometry", "Poses", "along_track", "euler", "from_utm", "geometry", "matrices", "pulse_centre", "quaternions",
    "to_utm",
]  # fmt: skip
