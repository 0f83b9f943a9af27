"""pysas: an imaging engine for synthetic aperture sonar. State a relative error `tol`; the engine keeps it."""

from pysas import circular, comparison, metrics, plot, reference, tracks
from pysas.compression import compress
from pysas.echoes import Beam, Echoes
from pysas.engine import get_include, get_library, show_config
from pysas.grid import Grid
from pysas.image import Image, Report
from pysas.imaging import backproject, backproject_arrays, ffbp, focus
from pysas.io import load, save
from pysas.phase_history import from_phase_history
from pysas.planner import plan
from pysas.pulse import LFM
from pysas.simulation import simulate

__version__ = "0.1.0"

__all__ = [
    "LFM", "Beam", "Echoes", "Grid", "Image", "Report", "backproject", "backproject_arrays", "circular", "comparison",
    "compress", "ffbp", "focus", "from_phase_history", "get_include", "get_library", "load", "metrics", "plan", "plot",
    "reference", "save", "show_config", "simulate", "tracks",
]  # fmt: skip
