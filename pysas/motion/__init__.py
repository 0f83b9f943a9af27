"""Where the sonar was, from its own echoes: the track to a fraction of a wavelength, as images need it."""

from pysas.motion.found import Motion
from pysas.motion.priors import Prior
from pysas.motion.results import Report

__all__ = ["Motion", "Prior", "Report"]
