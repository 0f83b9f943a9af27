"""Independent answers that validate the engines; none of them imports an engine."""

from pysas.reference.chirp_scaling import chirp_scaling
from pysas.reference.correlation import correlation
from pysas.reference.direct import exact
from pysas.reference.looks import Looks, looks
from pysas.reference.motion import motion_compensate
from pysas.reference.omega_k import omega_k
from pysas.reference.one_way import one_way
from pysas.reference.one_way_curved import map_to_line
from pysas.reference.one_way_polar import one_way_polar
from pysas.reference.phase_centres import phase_centres
from pysas.reference.range_doppler import range_doppler
from pysas.reference.regularise import Enhanced, enhance, noise_level

__all__ = [
    "Enhanced", "Looks", "chirp_scaling", "correlation", "enhance", "exact", "looks", "map_to_line", "motion_compensate",
    "noise_level", "omega_k", "one_way", "one_way_polar", "phase_centres", "range_doppler",
]  # fmt: skip
