"""`pysas image`: image echoes from a file, and find the targets that the file knows of."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from typing import Any

import numpy as np

from pysas import metrics, plot
from pysas.cli.common import Command, Progress, add_scene, chosen_grid, load_echoes, require_places, silenced
from pysas.engine import BACKENDS
from pysas.formats import io
from pysas.imaging.planner import plan_ahead
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image
from pysas.signal import compression
from pysas.signal.inspection import inspect


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    add_scene(sub)
    sub.add_argument("-o", "--output", metavar="IMAGE", help="image file to write (.npz, .h5)")
    sub.add_argument("--tol", type=float, default=1e-3, help="relative error to keep (default: 1e-3)")
    sub.add_argument(
        "--method", choices=("auto", "backprojection", "ffbp"), default="auto", help="auto: the faster, by prediction"
    )
    sub.add_argument("--backend", choices=BACKENDS, default="auto")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 where not one term was summed."""
    if arguments.output is None and arguments.png is None and not arguments.json:
        raise ValueError("nothing to write: expected -o IMAGE, --png FILE or --json")
    require_places([arguments.raw, arguments.grid], data=arguments.output, picture=arguments.png, overwrite=arguments.overwrite)
    echoes = load_echoes(arguments.raw)
    grid, how = chosen_grid(arguments, echoes)
    for finding in inspect(echoes):
        if finding.state != "ok" and finding.name != "finite samples":  # which --nan decides about
            warnings.warn(f"{finding.name}: {finding.text}", stacklevel=1)
    picture, _, summary = imaged(
        arguments.raw, echoes, grid, how, progress, tol=arguments.tol, method=arguments.method, backend=arguments.backend,
        nan=arguments.nan, threads=arguments.threads, output=arguments.output, png=arguments.png,
        overwrite=arguments.overwrite,
    )  # fmt: skip
    print(json.dumps(summary) if arguments.json else described(picture, summary))
    return int(picture.report.terms == 0)


COMMAND = Command("image", "image echoes from a file", _add_arguments, _run)


def imaged(
    raw: str,
    echoes: Echoes,
    grid: Grid,
    how: str,
    progress: Progress,
    *,
    tol: float = 1e-3,
    method: str = "auto",
    backend: str = "auto",
    nan: str = "raise",
    threads: int | None = None,
    output: str | None = None,
    png: str | None = None,
    overwrite: bool = False,
) -> tuple[Image, Echoes, dict[str, Any]]:
    """The image of the echoes of a file `raw`, their compressed form, and a summary; saved and drawn where asked.

    `how` : the grid came about.
    """
    seconds = {}
    # planned first: what cannot be met is said before anything is compressed
    chosen = plan_ahead(echoes, grid, tol, method, threads, backend, nan)
    if not echoes.compressed:
        clock = time.perf_counter()
        if nan == "mask":
            echoes = silenced(echoes)
        echoes = compression.compress(echoes, threads=threads, progress=progress.step("compressing"))
        seconds["compress"] = time.perf_counter() - clock
    picture = chosen(echoes.data, progress=progress.step("imaging"))
    seconds |= {"prepare": picture.report.prepare_seconds, "sum": picture.report.sum_seconds}
    targets = _targets(picture, echoes)
    if output is not None:
        io.save(output, picture, overwrite=overwrite)
    if png is not None:
        marks = [target["true"] for target in targets]
        plot.quicklook(picture, png, targets=marks or None, overwrite=overwrite)
    summary = {
        "raw": raw, "image": output, "png": png, "grid": how, "shape": list(grid.shape), "tol": tol,
        "report": picture.report.as_dict(), "seconds": seconds, "targets": targets,
    }  # fmt: skip
    return picture, echoes, summary


def _targets(picture: Image, echoes: Echoes) -> list[dict[str, Any]]:
    """Known targets in the imaged plane: where they are and where the image has its peak."""
    grid = picture.grid
    truth = echoes.attrs.get("truth_position")
    if truth is None or grid.kind != "plane":
        return []
    positions = np.asarray(truth, dtype=np.float64)
    x, y = grid.axes["x"], grid.axes["y"]
    margin = echoes.range_resolution
    found = []
    for position in positions:
        if abs(position[2] - float(np.asarray(grid.height))) > 1e-3:
            continue
        if not (x.min() + margin < position[0] < x.max() - margin and y.min() + margin < position[1] < y.max() - margin):
            continue
        others = np.linalg.norm(positions - position, axis=1)
        apart = others[others > 0]
        radius = min(1.5 * margin, 0.5 * float(apart.min())) if apart.size else 1.5 * margin
        try:
            peak = metrics.peak_position(picture, near=(float(position[0]), float(position[1])), radius=radius)
        except ValueError:
            continue  # no pixel within the radius: the grid is too coarse to say
        error = float(np.hypot(peak[0] - position[0], peak[1] - position[1]))
        found.append({"true": position.tolist(), "found": [float(v) for v in peak], "error_mm": 1e3 * error})
    return found


def described(picture: Image, summary: dict[str, Any]) -> str:
    """The image, its files and its targets, for the reader."""
    lines = [repr(picture), f"  grid       {summary['grid']}"]
    lines += [f"  {name + ' written':<10} {summary[name]}" for name in ("image", "png") if summary[name]]
    targets = summary["targets"]
    if targets:
        lines.append(f"  targets    {len(targets)} in this plane; true x, y, z; found x, y; error")
        for target in targets:
            (x, y, z), (u, v) = target["true"], target["found"]
            lines.append(f"    {x:9.4f} {y:9.4f} {z:8.3f}  {u:10.5f} {v:10.5f}  {target['error_mm']:7.3f} mm")
        lines.append(f"    largest error {max(target['error_mm'] for target in targets):.3f} mm")
    return "\n".join(lines)
