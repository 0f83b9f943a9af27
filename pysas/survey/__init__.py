"""Surveys: strips of images along a track, from pings as they come, and many lines at a time into a store of tiles."""

from pysas.survey.following import follow
from pysas.survey.lines import SurveyPlan, Tile, plan
from pysas.survey.mosaics import Mosaic, mosaic
from pysas.survey.pages import page
from pysas.survey.pictures import overview
from pysas.survey.running import Damage, SurveyReport, resume, run, verify
from pysas.survey.sections import Made

__all__ = [
    "Damage", "Made", "Mosaic", "SurveyPlan", "SurveyReport", "Tile", "follow", "mosaic", "overview", "page", "plan", "resume",
    "run", "verify",
]  # fmt: skip
