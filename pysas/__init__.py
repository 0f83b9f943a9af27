"""pysas: an imaging engine for synthetic aperture sonar. State a relative error `tol`; the engine keeps it.

Names are loaded when they are first used: a program pays for no module that it does not need.
"""

import importlib
import threading
from typing import TYPE_CHECKING

import numpy as _numpy  # noqa: F401  by one thread, before names are asked for by several

if TYPE_CHECKING:
    from pysas import circular, comparison, metrics, motion, navigation, plot, reference, survey, tracks
    from pysas.engine import get_include, get_library, show_config
    from pysas.formats.echo_store import EchoStore, open_echoes
    from pysas.formats.growing import EchoWriter
    from pysas.formats.io import save
    from pysas.formats.tables import read_table
    from pysas.imaging.doorways import backproject, backproject_arrays, ffbp, focus
    from pysas.imaging.planner import plan
    from pysas.inspection import Finding, inspect
    from pysas.loading import load, load_echoes, load_image
    from pysas.model.beam import Beam
    from pysas.model.echoes import Echoes
    from pysas.model.grid import Grid
    from pysas.model.image import Image, Report
    from pysas.model.pulse import LFM
    from pysas.motion.bright_points import align_points
    from pysas.motion.focusing import autofocus
    from pysas.motion.navigating import micronavigate
    from pysas.signal import simulation
    from pysas.signal.baseband import demodulate
    from pysas.signal.compression import compress
    from pysas.signal.phase_history import from_phase_history
    from pysas.signal.simulation import simulate
    from pysas.survey.strips import Strip

__version__ = "0.1.0"

__all__ = [
    "LFM", "Beam", "EchoStore", "EchoWriter", "Echoes", "Finding", "Grid", "Image", "Report", "Strip", "align_points",
    "autofocus", "backproject", "backproject_arrays", "circular", "comparison", "compress", "demodulate", "ffbp", "focus",
    "from_phase_history", "get_include", "get_library", "inspect", "load", "load_echoes", "load_image", "metrics",
    "micronavigate", "motion", "navigation", "open_echoes", "plan", "plot", "read_table", "reference", "save",
    "show_config", "simulate", "simulation", "survey", "tracks",
]  # fmt: skip

# where those are that are no modules
_MODULES = {
    "engine": ("get_include", "get_library", "show_config"),
    "formats.echo_store": ("EchoStore", "open_echoes"),
    "formats.growing": ("EchoWriter",),
    "formats.io": ("save",),
    "formats.tables": ("read_table",),
    "imaging.doorways": ("backproject", "backproject_arrays", "ffbp", "focus"),
    "imaging.planner": ("plan",),
    "loading": ("load", "load_echoes", "load_image"),
    "model.beam": ("Beam",),
    "model.echoes": ("Echoes",),
    "model.grid": ("Grid",),
    "model.image": ("Image", "Report"),
    "model.pulse": ("LFM",),
    "motion.bright_points": ("align_points",),
    "motion.focusing": ("autofocus",),
    "motion.navigating": ("micronavigate",),
    "signal.baseband": ("demodulate",),
    "signal.compression": ("compress",),
    "inspection": ("Finding", "inspect"),
    "signal.phase_history": ("from_phase_history",),
    "signal.simulation": ("simulate",),
    "survey.strips": ("Strip",),
}
_ROOM_OF = {"simulation": "signal.simulation"}  # of modules that stand in a room
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
_LOADING = threading.RLock()

if not TYPE_CHECKING:  # a checker shall know of no other names

    def __getattr__(name):
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        with _LOADING:
            module = importlib.import_module(f"{__name__}.{_MODULE_OF.get(name) or _ROOM_OF.get(name, name)}")
            globals()[name] = getattr(module, name) if name in _MODULE_OF else module
        return globals()[name]


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__") and name.endswith("__"))])
