"""Measures: of an image's error, of a point's response, of how concentrated an image is, and of a track's error."""

from pysas.metrics.concentration import entropy, sharpness
from pysas.metrics.responses import cut, irw, islr, peak_position, phase_error, pslr, relative_error
from pysas.metrics.slant_errors import track_error

__all__ = [
    "cut", "entropy", "irw", "islr", "peak_position", "phase_error", "pslr", "relative_error", "sharpness", "track_error",
]  # fmt: skip
