"""Independent answers that validate the engines; none of them imports an engine."""

from pysas.reference.direct import exact

__all__ = ["exact"]
