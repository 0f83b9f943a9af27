"""`pysas info`: what a file holds, and the plan for its default grid."""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from pysas.cli.common import Command, Progress
from pysas.formats import io
from pysas.imaging.planner import plan_ahead
from pysas.model.image import Image
from pysas.planning import framing


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="FILE")
    sub.add_argument("--tol", type=float, default=1e-3)
    sub.add_argument("--plan", action="store_true", help="also what the plan leaves out, its errors, and alternatives")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    item = io.load(arguments.file)
    if isinstance(item, Image):
        values: dict[str, Any] = {"kind": "image", "shape": list(item.data.shape), "report": item.report.as_dict()}
        text = repr(item)
    else:
        near, far = item.swath
        values = {
            "kind": "echoes", "shape": list(item.data.shape), "dtype": str(item.dtype), "compressed": item.compressed,
            "fs": item.fs, "fc": item.fc, "c": np.asarray(item.c).tolist(), "bandwidth": item.occupied_bandwidth,
            "swath": [near, far],
            "range_resolution": item.range_resolution, "phase_centre_spacing": list(item.phase_centre_spacing()),
            "warnings": item.warnings(),
        }  # fmt: skip
        try:
            grid, how = framing.default_grid(item)
            chosen = plan_ahead(item, grid, arguments.tol)
            summary = chosen.explain() if arguments.plan else str(chosen)
        except ValueError as error:  # what the file holds is worth seeing where it cannot be imaged so
            how, summary = "none", f"no plan: {error}"
        values |= {"grid": how, "plan": summary}
        title = item.attrs.get("title")
        text = "\n".join([repr(item)] + ([f"  title      {title}"] if title else []) + [f"default grid: {how}", summary])
    print(json.dumps(values) if arguments.json else text)
    return 0


COMMAND = Command("info", "what a file holds and what the planner would do", _add_arguments, _run)
