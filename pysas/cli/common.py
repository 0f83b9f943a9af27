"""What commands share: their form, progress, options, echoes and grids from files, and files to write."""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks, loading, plot
from pysas.formats import catalogue, depth_maps, files
from pysas.formats.containers import container
from pysas.formats.format import Look
from pysas.imaging import words
from pysas.model.echoes import Echoes
from pysas.model.gaps import shortened
from pysas.model.grid import Grid
from pysas.planning import framing
from pysas.planning.relief import laid_over

_SILENT = 30.0  # s of work without a word where there is no terminal


class Progress:
    """A bar on a terminal, a plain line a step and now and then otherwise, nothing with --json; always on standard error."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.terminal = sys.stderr is not None and sys.stderr.isatty()

    def step(self, label: str) -> Callable[[float], None] | None:
        """A callback for one step of the work."""
        if self.quiet:
            return None
        began = time.monotonic()
        told = [began]

        def left(share: float, seconds: float) -> str:
            return f", {words.spoken(seconds * (1 - share) / share)} left" if 0.02 < share < 1 and seconds > 5 else ""

        def say(share: float) -> None:
            now = time.monotonic()
            if now - told[0] > _SILENT:
                told[0] = now
                print(f"{label} {100 * share:.0f} %{left(share, now - began)}", file=sys.stderr, flush=True)

        def show(share: float) -> None:
            width = 30
            bar = "#" * int(share * width)
            seconds = time.monotonic() - began
            text = f"{label:<10} [{bar:<{width}}] {100 * share:3.0f} % {seconds:5.1f} s{left(share, seconds)}"
            print(f"\r{text:<79}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)

        if not self.terminal:
            print(f"{label} ...", file=sys.stderr, flush=True)
            return say
        return show


@dataclass(frozen=True)
class Command:
    """A command: its name, what it does in one line, the arguments it has, and what returns its exit code."""

    name: str
    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Progress], int]


def add_threads(sub: argparse.ArgumentParser) -> None:
    """--threads"""
    sub.add_argument("--threads", type=int, metavar="N", help="worker threads (default: all processors)")


def add_overwrite(sub: argparse.ArgumentParser) -> None:
    """--overwrite, of every command that writes"""
    sub.add_argument("--overwrite", action="store_true", help="replace files that are there (never what is read)")


def add_channel(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--channel", metavar="NAME", help="of a file whose channels have pings of their own")


def add_scene(sub: argparse.ArgumentParser) -> None:
    """A file of echoes and where they are imaged, for `read` and `chosen_grid`, and how."""
    sub.add_argument("raw", metavar="RAW", help="echoes, raw or compressed, in any format that is known (docs/formats.md)")
    add_channel(sub)
    sub.add_argument("--c", type=float, metavar="C", help="sound speed, m/s (default: the file's)")
    sub.add_argument("--x", type=span, metavar="MIN:MAX", help="span of x, m (default: the whole survey)")
    sub.add_argument("--y", type=span, metavar="MIN:MAX", help="span of y, m (default: the whole survey)")
    seabed = sub.add_mutually_exclusive_group()
    seabed.add_argument(
        "--z", type=float, metavar="Z", help="z of the seabed, m (default: by the file's altitude, else the sonar's own)"
    )
    seabed.add_argument("--altitude", type=float, metavar="A", help="height of the sonar over the seabed, m")
    seabed.add_argument("--depth-map", metavar="FILE", help="z of the seabed at x, y: .npz, .h5, or text of x, y, z")
    sub.add_argument(
        "--spacing", type=spacing, metavar="A [B]", help="pixel spacing along x, and along y, m (default: half the resolution)"
    )
    sub.add_argument("--side", choices=framing.SIDES, help="of the track that is imaged (default: where the beam looks)")
    sub.add_argument("--large", action="store_true", help=f"allow more than {framing.MOST:.2g} pixels")
    sub.add_argument("--grid", metavar="FILE", help="use the grid of this image file instead")
    sub.add_argument("--png", metavar="FILE", help="picture to write (needs matplotlib)")
    add_overwrite(sub)
    sub.add_argument("--nan", choices=("raise", "mask"), default="raise", help="traces with non-finite samples")
    add_threads(sub)


def span(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected MIN:MAX in metres") from None
    if not low < high:
        raise argparse.ArgumentTypeError(f"{text!r}: expected MIN below MAX")
    return low, high


def window(text: str) -> str | tuple[Any, ...]:
    """NAME or NAME:PARAMETER of a spectral window."""
    name, *parameters = text.split(":")
    try:
        return (name, *(float(value) for value in parameters)) if parameters else name
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected NAME or NAME:PARAMETER") from None


def spacing(text: str, axes: str = "along x and along y") -> tuple[float, float]:
    """One number, or two with a comma between them."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) not in (1, 2):
        raise argparse.ArgumentTypeError(f"{text!r}: expected metres, {axes}")
    return found[0], found[-1]


def read(arguments: argparse.Namespace) -> Echoes:
    """Echoes of the file that `add_scene` names, with the sound speed that it asks for."""
    echoes = loading.load_echoes(arguments.raw, channel=arguments.channel)
    return echoes if arguments.c is None else echoes.replace(c=_checks.number("--c", arguments.c, positive=True))


def silenced(echoes: Echoes) -> Echoes:
    """Traces that hold a non-finite sample set to zero: compression would spread it, and zeros add nothing to an image.

    Where all such samples lie at its ends they shorten the trace's `valid` instead.
    """
    echoes, count = shortened(echoes)
    if count:
        warnings.warn(words.shortened(count, echoes.n_ping * echoes.n_channel), stacklevel=2)
    bad = np.zeros(echoes.traces.shape[:2], dtype=np.bool_)
    for ping, channel in np.ndindex(bad.shape):
        first, last = echoes.windows[ping, channel]
        bad[ping, channel] = not np.isfinite(echoes.traces[ping, channel, first : last + 1]).all()
    if not bad.any():
        return echoes
    warnings.warn(words.left_out(int(np.count_nonzero(bad)), bad.size), stacklevel=2)
    data = echoes.data.copy()
    data[bad if data.ndim == 3 else bad[:, 0]] = 0
    return echoes.replace(data=data)


def chosen_grid(arguments: argparse.Namespace, echoes: Echoes) -> tuple[Grid, str]:
    """The grid that the options of `add_scene` ask for, and how it came about."""
    if arguments.grid is not None:
        names = ("x", "y", "z", "altitude", "depth_map", "spacing", "side")
        given = [f"--{name.replace('_', '-')}" for name in names if getattr(arguments, name) is not None]
        if given:
            raise ValueError(f"--grid {arguments.grid}: expected without {', '.join(given)}")
        return loading.load_image(arguments.grid).grid, f"grid of {arguments.grid}"
    relief = None if arguments.depth_map is None else depth_maps.load(arguments.depth_map)
    if relief is not None:
        z, why = float(np.median(relief[2])), f"z of {arguments.depth_map}"
    elif arguments.z is not None:
        z, why = arguments.z, f"z = {arguments.z:g} m"
    else:
        z, why = framing.assumed_height(echoes, arguments.altitude)
        if arguments.altitude is None and not {"altitude", "scene_area"} & set(echoes.attrs) and framing.height_matters(echoes):
            warnings.warn(why, stacklevel=2)
    grid, how = _spanned(arguments, echoes, z)
    if relief is not None:
        grid = laid_over(grid, *relief)
    return grid, f"{how}; {why}"


def _spanned(arguments: argparse.Namespace, echoes: Echoes, z: float) -> tuple[Grid, str]:
    """A plane over the spans asked for, or the survey."""
    spacing = arguments.spacing
    if arguments.x is not None and arguments.y is not None and spacing is not None:
        axes = [framing.span(low, high, step) for (low, high), step in zip((arguments.x, arguments.y), spacing, strict=True)]
        return Grid.plane(axes[0], axes[1], z), "given spans"
    if arguments.x is None and arguments.y is None:
        return framing.default_grid(echoes, z, spacing, arguments.side, arguments.large)
    grid, how = framing.default_grid(echoes, z, spacing, arguments.side, large=True)
    if grid.turned and (arguments.x is None or arguments.y is None):
        raise ValueError(f"--x, --y: the survey's own axes are turned, {how}: expected both, on the axes of the data")
    if arguments.side is not None and arguments.x is not None and arguments.y is not None:
        raise ValueError(f"--side {arguments.side}: --x and --y say where: expected one of both")
    if grid.turned and spacing is None:  # steps along the track and across it, whichever way the data's axes lie
        spacing = (min(float(np.diff(grid.axes[name])[0]) for name in "xy" if grid.axes[name].size > 1),) * 2
    axes = []
    for number, (name, limits) in enumerate((("x", arguments.x), ("y", arguments.y))):
        axis = grid.axes[name]
        step = None if spacing is None else spacing[number]
        if step is None:  # an axis of one pixel has no step: the other's will do
            step = float(np.diff(axis if axis.size > 1 else grid.axes["y" if name == "x" else "x"])[0])
        axes.append(axis if limits is None else framing.span(limits[0], limits[1], step))
    pixels = axes[0].size * axes[1].size
    if pixels > framing.MOST and not arguments.large:
        found = f"{axes[0].size} x {axes[1].size} = {pixels:.3g} pixels"
        raise ValueError(
            f"the spans have {found}: expected at most {framing.MOST:.2g}: a larger --spacing, or --large to allow it"
        )
    return Grid.plane(axes[0], axes[1], z), f"given spans, else {how}"


def has_matplotlib() -> bool:
    """Whether pictures can be drawn."""
    return importlib.util.find_spec("matplotlib") is not None


def require_places(
    inputs: Iterable[str | None],
    *,
    data: str | None = None,
    text: str | None = None,
    picture: str | None = None,
    overwrite: bool,
) -> None:
    """Raise now what writing would raise after the work, and where it would cost a file."""
    if picture is not None and not has_matplotlib():
        raise ImportError("--png: matplotlib is not installed: pip install 'pysas-sonar[plot]'")
    if picture is not None:
        plot.picture_format(picture)
    if data is not None:
        container(data)
    outputs = [("-o", data), ("-o", text), ("--png", picture)]
    given = [path for path in inputs if path is not None]
    if overwrite:  # without it nothing is replaced
        given = [path for source in given for path in catalogue.inputs_of(Look(source))]
    files.check_outputs([(option, path) for option, path in outputs if path is not None], given, overwrite)


def write_text(path: str | Path, text: str, overwrite: bool) -> None:
    """UTF-8; what a file's name holds beside text, escaped."""
    with files.replacing(path, overwrite=overwrite) as file:
        file.write(text.encode("utf-8", "backslashreplace"))
