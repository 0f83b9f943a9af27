"""What `pysas navigate` and `pysas image --motion` share: options of what is known of a track, and the better track by them."""

from __future__ import annotations

import argparse
from typing import Any

from pysas.cli.common import Progress
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.motion.improving import WAYS, Improved, improved
from pysas.motion.priors import Prior

_SIGMAS = (
    ("speed", "M/S", "of the claimed track's speed"),
    ("heading", "RAD", "of the claimed heading"),
    ("gyro", "RAD", "of the change of heading from ping to ping"),
    ("depth", "M", "of the claimed z of each ping"),
)


def add_motion(sub: argparse.ArgumentParser, default: str) -> None:
    """--motion, and what an inertial system is sure of."""
    group = sub.add_argument_group("track", "correct the track by the echoes themselves, see docs/motion.md")
    group.add_argument(
        "--motion",
        choices=WAYS if default == "none" else WAYS[:-1],
        default=default,
        help="micronavigation: by overlapping arrays; autofocus: by bright points and sharpness; auto: what the data allow, "
        f"one after the other (default: {default})",
    )
    for name, unit, text in _SIGMAS:
        group.add_argument(f"--sigma-{name}", type=float, metavar=unit, help=f"standard deviation {text}")
    group.add_argument(
        "--keep-velocity", action="store_true", help="the velocity was measured by itself, and does not follow the track"
    )


def corrected(arguments: argparse.Namespace, echoes: Echoes, grid: Grid, progress: Progress) -> Improved:
    """Compressed echoes with the track that `add_motion` asks for."""
    sigmas = {name: getattr(arguments, f"sigma_{name}") for name, *_ in _SIGMAS}
    prior = Prior(**sigmas) if any(value is not None for value in sigmas.values()) else None
    return improved(
        echoes, grid, arguments.motion, prior=prior, velocity="keep" if arguments.keep_velocity else "follow",
        threads=arguments.threads, progress=progress.step("track"),
    )  # fmt: skip


def summary(found: Improved) -> dict[str, Any]:
    """For --json."""
    out: dict[str, Any] = {"changed": found.changed, "untried": list(found.untried), "steps": []}
    if found.motion is not None:
        motion = found.motion
        out["micronavigation"] = {
            "found": motion.found, "why": motion.why, "slips": motion.slips, "unseen": motion.unseen,
            "residual": list(map(float, motion.residual)), "largest_shift": float(abs(motion.shift).max()),
        }  # fmt: skip
    for report in found.reports:
        told = {name: getattr(report, name) for name in ("method", "taken", "informative", "why", "largest", "seconds")}
        out["steps"].append(told)
    return out


def moved_to(raw: Echoes, found: Echoes) -> Echoes:
    """Echoes as recorded, raw or not, with another's track."""
    return raw.replace(tx=found.tx, rx=found.rx, velocity=found.velocity, beam=found.beam, attrs=found.attrs)
