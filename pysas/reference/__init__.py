"""Independent answers that validate the engines; none of them imports an engine."""

from pysas.reference.direct import exact
from pysas.reference.omega_k import omega_k

__all__ = ["exact", "omega_k"]
