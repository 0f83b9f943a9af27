"""Several ways to a better track, one after the other: each begins with what the one before found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pysas import _checks
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.motion.bright_points import align_points
from pysas.motion.focusing import autofocus
from pysas.motion.found import Motion
from pysas.motion.navigating import micronavigate
from pysas.motion.priors import Prior
from pysas.motion.results import Report

WAYS = ("auto", "micronavigation", "autofocus", "none")


@dataclass(frozen=True)
class Improved:
    """Echoes of the better track, or those given; what was found on the way; what could not be tried, and why."""

    echoes: Echoes
    motion: Motion | None
    reports: tuple[Report, ...]
    untried: tuple[str, ...]

    @property
    def changed(self) -> bool:
        """Whether the track is another."""
        return (self.motion is not None and self.motion.found) or any(report.taken for report in self.reports)

    def __str__(self) -> str:
        parts = [] if self.motion is None else [self.motion]
        return "\n".join([*map(str, [*parts, *self.reports]), *self.untried])


def improved(
    echoes: Echoes,
    grid: Grid,
    way: str = "auto",
    *,
    prior: Prior | None = None,
    velocity: str = "follow",
    tol: float = 1e-2,
    threads: int | None = None,
    progress: Callable[[float], object] | None = None,
) -> Improved:
    """The track that echoes and their image tell.

    Parameters
    ----------
    echoes : Echoes
        Compressed.
    grid : Grid
        Where the image is to be sharp; its height is the seabed's.
    way : {"auto", "micronavigation", "autofocus", "none"}
        "autofocus": bright points are aligned, then their image is sharpened. "auto": micronavigation where pings overlap and
        a beam is known, then autofocus with what that is sure of; without it, autofocus alone. A step that finds nothing
        leaves the track to the next as it is.
    prior, velocity, tol, threads
        As in `micronavigate`.
    progress : callable, optional
        Called with the share done of all that may be tried.

    Raises
    ------
    ValueError, TypeError
        As of the steps; with "auto" what forbids micronavigation alone is told in `untried`.
    """
    _checks.choice("way", way, WAYS)
    motion, untried, seen = None, [], echoes
    navigating = way in ("auto", "micronavigation")
    if navigating:
        share = 1.0 if way == "micronavigation" else 0.5
        told = None if progress is None else lambda done: progress(share * done)
        try:
            motion = micronavigate(
                echoes,
                float(np.median(grid.coordinates()[:, 2])),
                prior,
                velocity=velocity,
                tol=tol,
                threads=threads,
                progress=told,
            )
            seen = motion.apply(echoes, velocity)
        except ValueError as error:
            if way != "auto":
                raise
            untried.append(f"no micronavigation: {error}")
    reports: list[Report] = []
    if way in ("auto", "autofocus"):
        known = motion if motion is not None and motion.found else None
        if known is None:
            seen, report = align_points(seen, grid, velocity=velocity, tol=tol, threads=threads)
            reports.append(report)
        seen, report = autofocus(seen, grid, prior=known, velocity=velocity, tol=tol, threads=threads)
        reports.append(report)
    if progress is not None:
        progress(1.0)
    return Improved(seen, motion, tuple(reports), tuple(untried))
