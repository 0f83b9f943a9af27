"""`pysas image`: image echoes from a file, and find the targets that the file knows of."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks, metrics, plot
from pysas.cli import tracking
from pysas.cli.common import Command, Progress, add_scene, chosen_grid, has_matplotlib, read, require_places, silenced, window
from pysas.cli.tracking import add_motion, corrected
from pysas.engine import BACKENDS
from pysas.formats import io
from pysas.imaging.planner import plan_ahead
from pysas.inspection import inspect
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image
from pysas.model.pulse import LFM
from pysas.motion.improving import Improved
from pysas.planning.scene import UNIFORM
from pysas.signal import compression


@dataclass(frozen=True)
class Choices:
    """How echoes are compressed, imaged and drawn. `truth` : whether targets that the file knows of are looked for; `track` :
    what finds a better one in compressed echoes."""

    tol: float = 1e-3
    method: str = "auto"
    backend: str = "auto"
    nan: str = "raise"
    threads: int | None = None
    window: str | tuple[Any, ...] | None = None
    weights: str | None = None
    dynamic_range: float = 40.0
    reference: str | float = "peak"
    truth: bool = False
    track: Callable[[Echoes, Grid, Progress], Improved] | None = None


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    add_scene(sub)
    sub.add_argument(
        "-o", "--output", metavar="IMAGE", help="image file to write (.npz, .h5); with it and without --png no picture"
    )
    sub.add_argument("--tol", type=float, default=Choices.tol, help="relative error to keep (default: 1e-3)")
    sub.add_argument(
        "--method", choices=("auto", "backprojection", "ffbp"), default="auto", help="auto: the faster, by prediction"
    )
    sub.add_argument("--backend", choices=BACKENDS, default="auto")
    sub.add_argument(
        "--window",
        type=window,
        metavar="NAME",
        help="spectral window against side lobes in range: hann, taylor, kaiser:8.6 ...",
    )
    sub.add_argument("--weights", choices=(UNIFORM,), help="weigh pings by the view angles they stand for")
    sub.add_argument(
        "--dynamic-range", type=float, default=Choices.dynamic_range, metavar="DB", help="of the picture (default: 40)"
    )
    sub.add_argument(
        "--reference",
        type=_reference,
        default="peak",
        metavar="WHAT",
        help="0 dB of the picture: peak, percentile, or a level in dB",
    )
    add_motion(sub, "none")
    sub.add_argument("--truth", action="store_true", help="find and mark the targets that the file knows of")


def _reference(text: str) -> str | float:
    if text in ("peak", "percentile"):
        return text
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected peak, percentile or a number of dB") from None


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 where the image is empty."""
    output, png = arguments.output, arguments.png
    if output is None and png is None and not arguments.json:
        name = f"{Path(arguments.raw).stem}_image"
        output, png = f"{name}.npz", f"{name}.png" if has_matplotlib() else None
    inputs = [arguments.raw, arguments.grid, arguments.depth_map]
    require_places(inputs, data=output, picture=png, overwrite=arguments.overwrite)
    echoes = read(arguments)
    grid, how = chosen_grid(arguments, echoes)
    names = [field.name for field in dataclasses.fields(Choices) if field.name != "track"]
    track = None if arguments.motion == "none" else functools.partial(corrected, arguments)
    choices = Choices(**{name: getattr(arguments, name) for name in names}, track=track)
    for finding in inspect(echoes):
        if finding.state != "ok" and finding.name != "finite samples":  # which --nan decides about
            what = "FAIL, no image of these echoes can be right: " if finding.state == "FAIL" else ""
            warnings.warn(f"{what}{finding.name}: {finding.text}", stacklevel=1)
    picture, _, summary = imaged(
        arguments.raw, echoes, grid, how, progress, choices, output=output, png=png, overwrite=arguments.overwrite
    )
    print(json.dumps(summary) if arguments.json else described(picture, summary))
    if arguments.output is None and output is not None and png is None:
        print("no picture: pip install 'pysas-sonar[plot]'")
    return int(not picture.data.any())


COMMAND = Command("image", "image echoes from a file, raw or compressed; write an image and a picture", _add_arguments, _run)


def imaged(
    raw: str,
    echoes: Echoes,
    grid: Grid,
    how: str,
    progress: Progress,
    choices: Choices,
    *,
    output: str | None = None,
    png: str | None = None,
    overwrite: bool = False,
) -> tuple[Image, Echoes, dict[str, Any]]:
    """The image of the echoes of a file `raw`, their compressed form, and a summary; saved and drawn where asked.

    `how` : the grid came about.
    """
    tol, threads = choices.tol, choices.threads
    _checks.number("--dynamic-range", choices.dynamic_range, positive=True)
    if echoes.compressed and choices.window is not None:
        raise ValueError(f"--window {choices.window}: {raw} is range-compressed already: expected raw echoes")
    seconds, compressed = {}, None
    if choices.nan == "mask" and not echoes.compressed:
        echoes = silenced(echoes)
    # planned first: what cannot be met is said before anything is compressed
    chosen = plan_ahead(echoes, grid, tol, choices.method, threads, choices.backend, choices.nan, choices.weights)
    if not echoes.compressed:
        clock = time.perf_counter()
        compressed = f"matched filter of {_pulse(echoes)}, window {choices.window or 'none'}"
        echoes = compression.compress(echoes, choices.window, threads=threads, progress=progress.step("compressing"))
        seconds["compress"] = time.perf_counter() - clock
    better = None if choices.track is None else choices.track(echoes, grid, progress)
    if better is not None and better.changed:
        echoes = better.echoes
        chosen = plan_ahead(echoes, grid, tol, choices.method, threads, choices.backend, choices.nan, choices.weights)
    picture = chosen(echoes.data, progress=progress.step("imaging"))
    seconds |= {"prepare": picture.report.prepare_seconds, "sum": picture.report.sum_seconds}
    targets = _targets(picture, echoes) if choices.truth else []
    if choices.truth and not targets:
        known = len(np.asarray(echoes.attrs.get("truth_position", ())))
        where = (
            f"none of the file's {known} within 1 mm of the plane that is imaged, and inside it"
            if known
            else "the file knows none"
        )
        warnings.warn(f"--truth: no target: {where}", stacklevel=1)
    if output is not None:
        io.save(output, picture, overwrite=overwrite)
    if png is not None:
        marks = [target["true"] for target in targets]
        plot.quicklook(
            picture, png, dynamic_range=choices.dynamic_range, reference=choices.reference, targets=marks or None,
            overwrite=overwrite,
        )  # fmt: skip
    summary = {
        "raw": raw, "compressed": compressed, "image": output, "png": png, "grid": how, "shape": list(grid.shape), "tol": tol,
        "c": np.asarray(echoes.c).tolist(), "report": picture.report.as_dict(), "seconds": seconds, "targets": targets,
    }  # fmt: skip
    if better is not None:
        summary["motion"] = tracking.summary(better)
        summary["motion"]["text"] = str(better)
    return picture, echoes, summary


def _pulse(echoes: Echoes) -> str:
    return str(echoes.pulse) if isinstance(echoes.pulse, LFM) else "the sampled pulse"


def _targets(picture: Image, echoes: Echoes) -> list[dict[str, Any]]:
    """Known targets in the imaged plane: where they are and where the image has its peak."""
    grid = picture.grid
    truth = echoes.attrs.get("truth_position")
    if truth is None or grid.kind != "plane":
        return []
    positions = np.asarray(truth, dtype=np.float64)
    places = grid.along_axes(positions)
    x, y = grid.axes["x"], grid.axes["y"]
    margin = echoes.range_resolution
    found = []
    for position, place in zip(positions, places, strict=True):
        if abs(position[2] - float(np.asarray(grid.height))) > 1e-3:
            continue
        if not (x.min() + margin < place[0] < x.max() - margin and y.min() + margin < place[1] < y.max() - margin):
            continue
        others = np.linalg.norm(positions - position, axis=1)
        apart = others[others > 0]
        radius = min(1.5 * margin, 0.5 * float(apart.min())) if apart.size else 1.5 * margin
        try:
            peak = metrics.peak_position(picture, near=(float(place[0]), float(place[1])), radius=radius)
        except ValueError:
            continue  # no pixel within the radius: the grid is too coarse to say
        at = Grid.plane([peak[0]], [peak[1]], origin=grid.origin, rotation=grid.rotation).coordinates()[0, :2]
        error = float(np.linalg.norm(at - position[:2]))
        found.append({"true": position.tolist(), "found": at.tolist(), "error_mm": 1e3 * error})
    return found


def described(picture: Image, summary: dict[str, Any]) -> str:
    """The image, its files and how its targets were met, for the reader."""
    lines = [repr(picture), f"  chosen     {summary['grid']}"]
    if summary["compressed"]:
        lines.append(f"  compressed on the way: {summary['compressed']}")
    lines += summary.get("motion", {}).get("text", "").splitlines()
    lines += [f"  {name + ' written':<10} {summary[name]}" for name in ("image", "png") if summary[name]]
    targets = summary["targets"]
    if targets:
        worst = max(targets, key=lambda target: float(target["error_mm"]))
        middle = float(np.median([target["error_mm"] for target in targets]))
        x, y, z = worst["true"]
        lines.append(
            f"  targets    {len(targets)} in this plane, found within {worst['error_mm']:.3f} mm (at x {x:.3f}, y {y:.3f}, "
            f"z {z:.3f}), the middle one within {middle:.3f} mm"
        )
    return "\n".join(lines)
