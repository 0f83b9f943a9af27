"""`pysas demo`: simulate a survey, save and image it, and report the error."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from pysas import loading, metrics, reference
from pysas.cli import demo_scene
from pysas.cli.common import (
    Command,
    Progress,
    add_overwrite,
    add_threads,
    has_matplotlib,
    require_places,
    write_text,
)
from pysas.cli.image import Choices, described, imaged
from pysas.formats import files, io


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("-o", "--output", default="demo", metavar="DIR", help="folder for the results (default: demo)")
    add_overwrite(sub)
    add_threads(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """Image through the same path as `image`, from the file that was written."""
    folder = Path(arguments.output)
    folder.mkdir(parents=True, exist_ok=True)
    with_picture = has_matplotlib()
    written = ["raw.npz", "image.npz", "report.json", "report.txt"] + ["image.png"] * with_picture
    files.check_outputs([("-o", str(folder / name)) for name in written], [], arguments.overwrite)
    clock = time.perf_counter()
    raw = demo_scene.echoes(threads=arguments.threads, progress=progress.step("simulating"))
    io.save(folder / "raw.npz", raw, overwrite=arguments.overwrite)
    simulated = time.perf_counter() - clock
    read, output = str(folder / "raw.npz"), str(folder / "image.npz")
    png = str(folder / "image.png") if with_picture else None
    require_places([read], data=output, picture=png, overwrite=arguments.overwrite)
    picture, echoes, summary = imaged(
        read, loading.load_echoes(read), demo_scene.grid(), "given grid", progress,
        Choices(threads=arguments.threads, truth=True),
        output=output, png=png, overwrite=arguments.overwrite,
    )  # fmt: skip
    progress.step("checking")
    pixels = np.random.default_rng(0).choice(picture.grid.size, 200, replace=False)
    exact, level = reference.exact(echoes, picture.grid, pixels)
    summary["measured_error"] = metrics.relative_error(picture.data.ravel()[pixels], exact, level)
    summary["seconds"]["simulate"] = simulated
    summary["seconds"]["all"] = time.perf_counter() - clock
    write_text(folder / "report.json", json.dumps(summary, indent=1) + "\n", arguments.overwrite)
    text = "\n".join(
        [
            described(picture, summary),
            f"measured error {summary['measured_error']:.2g} of the {summary['tol']:g} asked, on {pixels.size} pixels "
            "against the float64 sum",
            f"everything took {summary['seconds']['all']:.1f} s",
        ]
    )
    write_text(folder / "report.txt", text + "\n", arguments.overwrite)
    if arguments.json:
        print(json.dumps(summary))
    else:
        print(f"{text}\nwritten to {folder}: {', '.join(written)}")
        if not with_picture:
            print("no picture: pip install 'pysas-sonar[plot]'")
    return 0


COMMAND = Command("demo", "simulate a survey, image it and report the error", _add_arguments, _run)
