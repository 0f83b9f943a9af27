"""Independent answers that validate the engines; none of them imports an engine."""

from pysas.reference.chirp_scaling import chirp_scaling
from pysas.reference.correlation import correlation
from pysas.reference.direct import exact
from pysas.reference.omega_k import omega_k
from pysas.reference.range_doppler import range_doppler

__all__ = ["chirp_scaling", "correlation", "exact", "omega_k", "range_doppler"]
