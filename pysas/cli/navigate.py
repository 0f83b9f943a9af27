"""`pysas navigate`: find the track that the echoes themselves tell, and write them with it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pysas import plot
from pysas.cli.common import Command, Progress, add_scene, chosen_grid, read, require_places, silenced
from pysas.cli.tracking import add_motion, corrected, moved_to, summary
from pysas.formats import io
from pysas.imaging.doorways import focus
from pysas.motion.found import Motion
from pysas.motion.improving import Improved
from pysas.motion.results import Report
from pysas.signal import compression


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.epilog = (
        "RAW is written as it was, raw or compressed, with the track that was found: pysas image FIXED makes the picture. "
        "Where nothing is found the exit code is 1 and nothing is written."
    )
    add_scene(sub)
    sub.add_argument("-o", "--output", required=True, metavar="FIXED", help="echoes to write (.npz, .h5)")
    add_motion(sub, "auto")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 where the track stays as it was."""
    output, png = arguments.output, arguments.png
    require_places(
        [arguments.raw, arguments.grid, arguments.depth_map], data=output, picture=png, overwrite=arguments.overwrite
    )
    raw = read(arguments)
    grid, how = chosen_grid(arguments, raw)
    whole = silenced(raw) if arguments.nan == "mask" else raw
    echoes = whole
    if not echoes.compressed:
        echoes = compression.compress(echoes, threads=arguments.threads, progress=progress.step("compressing"))
    found = corrected(arguments, echoes, grid, progress)
    if found.changed:
        io.save(output, moved_to(whole, found.echoes), overwrite=arguments.overwrite)
    if png is not None:
        before, after = (focus(one, grid, 1e-2, threads=arguments.threads) for one in (echoes, found.echoes))
        plot.track(_drawn(found), png, before=before, after=after, overwrite=arguments.overwrite)
    if arguments.json:
        moved = float(np.max(np.linalg.norm(found.echoes.tx - echoes.tx, axis=1)))
        print(
            json.dumps({"fixed": output if found.changed else None, "grid": how, "png": png, "moved": moved} | summary(found))
        )
    else:
        print(f"{found}\n  grid       {how}")
        again = f"pysas image {Path(output).name}{_seabed(arguments)}"
        print(f"  written    {output}: {again}" if found.changed else f"  not written: {output}")
    return int(not found.changed)


def _drawn(found: Improved) -> Motion | Report:
    """Micronavigation where it found something, else the last report that was taken: what the corrected image shows."""
    motion, reports = found.motion, found.reports
    if motion is not None and (motion.found or not reports):
        return motion
    return next((one for one in reversed(reports) if one.taken), reports[-1])


def _seabed(arguments: argparse.Namespace) -> str:
    """The option that an image needs too: a track's heave was found for this seabed, and is wrong for another."""
    for name in ("z", "altitude", "depth_map", "grid"):
        value = getattr(arguments, name)
        if value is not None:
            return f" --{name.replace('_', '-')} {value}"
    return ""


COMMAND = Command("navigate", "correct the track by the echoes themselves; write the echoes with it", _add_arguments, _run)
