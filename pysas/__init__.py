"""pysas: an imaging engine for synthetic aperture sonar. State a relative error `tol`; the engine keeps it."""

from pysas import circular, comparison, metrics, plot, reference, tracks
from pysas.engine import get_include, get_library, show_config
from pysas.formats.io import load, save
from pysas.imaging.doorways import backproject, backproject_arrays, ffbp, focus
from pysas.imaging.planner import plan
from pysas.model.echoes import Beam, Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.model.pulse import LFM
from pysas.signal import simulation
from pysas.signal.compression import compress
from pysas.signal.phase_history import from_phase_history
from pysas.signal.simulation import simulate

__version__ = "0.1.0"

__all__ = [
    "LFM", "Beam", "Echoes", "Grid", "Image", "Report", "backproject", "backproject_arrays", "circular", "comparison",
    "compress", "ffbp", "focus", "from_phase_history", "get_include", "get_library", "load", "metrics", "plan", "plot",
    "reference", "save", "show_config", "simulate", "simulation", "tracks",
]  # fmt: skip
