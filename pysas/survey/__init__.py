"""Surveys: strips of images along a track, from pings as they come, and many lines at a time into a store of tiles.

Names are loaded when they are first used: who takes `pysas.Strip` pays for no store and no map.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pysas.survey.following import follow
    from pysas.survey.lines import SurveyPlan, Tile, plan
    from pysas.survey.mosaics import Mosaic, mosaic
    from pysas.survey.pages import page
    from pysas.survey.pictures import overview
    from pysas.survey.running import SurveyReport, resume, run
    from pysas.survey.sections import Made
    from pysas.survey.verifying import Damage, verify

__all__ = [
    "Damage", "Made", "Mosaic", "SurveyPlan", "SurveyReport", "Tile", "follow", "mosaic", "overview", "page", "plan", "resume",
    "run", "verify",
]  # fmt: skip

_MODULES = {
    "following": ("follow",),
    "lines": ("SurveyPlan", "Tile", "plan"),
    "mosaics": ("Mosaic", "mosaic"),
    "pages": ("page",),
    "pictures": ("overview",),
    "running": ("SurveyReport", "resume", "run"),
    "sections": ("Made",),
    "verifying": ("Damage", "verify"),
}

if not TYPE_CHECKING:  # a checker shall know of no other names

    def __getattr__(name):
        for module, names in _MODULES.items():
            if name in names:
                globals()[name] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
                return globals()[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__") and name.endswith("__"))])
