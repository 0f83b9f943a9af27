"""`pysas simulate`: write simulated raw echoes, of the demonstration's scene or of points from a file."""

from __future__ import annotations

import argparse
import json

import numpy as np

from pysas import tracks
from pysas._checks import FloatArray
from pysas.cli import demo_scene
from pysas.cli.common import Command, Progress, add_overwrite, add_threads, require_places
from pysas.formats import files, io
from pysas.model.pulse import LFM
from pysas.signal.simulation import simulate


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("-o", "--output", required=True, metavar="RAW", help="file to write (.npz, .h5)")
    add_overwrite(sub)
    sub.add_argument("--points", metavar="FILE", help="scatterers, x,y,z,amplitude a line (default: the demo's)")
    sub.add_argument("--pings", type=int, default=150)
    sub.add_argument("--channels", type=int, default=6)
    sub.add_argument("--seed", type=int, default=1)
    add_threads(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    require_places([arguments.points], data=arguments.output, overwrite=arguments.overwrite)
    step = progress.step("simulating")
    if arguments.points is None:
        raw = demo_scene.echoes(arguments.pings, arguments.channels, arguments.seed, arguments.threads, step)
    else:
        points = _points(arguments.points)
        far = float(np.linalg.norm(points[:, :3], axis=1).max())
        pulse = LFM(100e3, 30e3, 2e-3, "tukey", 0.1)
        advance = arguments.channels * 0.0125
        start = (-advance * (arguments.pings - 1) / 2, 0.0, 0.0)
        track = tracks.perturbed(arguments.pings, advance, start=start, sway=0.05, heave=0.03, yaw=0.004, seed=arguments.seed)
        reach = far + float(np.abs(track.position).max()) + 1.0
        raw = simulate(
            points[:, :3], points[:, 3], pulse, tx=track.position, rx=tracks.array(track, arguments.channels, 0.025), fs=40e3,
            duration=2 * reach / 1500.0 + pulse.duration, velocity=track.velocity, threads=arguments.threads, progress=step,
            ping_time=track.time, attrs={"truth_position": points[:, :3], "truth_amplitude": points[:, 3]},
        )  # fmt: skip
    io.save(arguments.output, raw, overwrite=arguments.overwrite)
    print(json.dumps({"raw": arguments.output, "shape": list(raw.data.shape)}) if arguments.json else repr(raw))
    return 0


COMMAND = Command("simulate", "write simulated raw echoes", _add_arguments, _run)


def _points(path: str) -> FloatArray:
    with files.opened(path) as file:
        try:
            points = np.loadtxt(file, delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{path}: {error}: expected lines of x,y,z,amplitude") from None
    if points.shape[0] == 0 or points.shape[1] != 4:
        raise ValueError(f"{path}: found {points.shape[1]} columns, expected x,y,z,amplitude")
    return np.asarray(points, dtype=np.float64)
