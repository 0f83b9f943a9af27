"""`pysas compare`: every method on echoes from a file, its time beside its error."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from pysas import _checks, comparison, plot, reference
from pysas.cli.common import Command, Progress, add_scene, chosen_grid, read, require_places, silenced, write_text
from pysas.imaging.planner import plan_ahead
from pysas.model.echoes import Echoes
from pysas.planning import framing
from pysas.reference.stripmap import prepare
from pysas.signal import compression

_LEGEND = """\
s: median of the whole call (least to most). error: relative L2 against the float64 sum, in the norm of tol, on the cuts through
the strongest pixel and random pixels of each method's own grid; loss: of that pixel; IRW, PSLR: along x / y. *: after
sqrt(range) and one fitted factor. pixels: where other than above. front: none here is both faster and closer. An engine above
its tol: the data have energy outside their bandwidth or beyond fs/2.2, where nothing is promised.
"""


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    add_scene(sub)
    sub.add_argument("-o", "--output", metavar="TABLE", help="file to write the table to (Markdown)")
    sub.add_argument("--tol", type=float, nargs="+", metavar="TOL", help="of the engines (default: 1e-1 to 1e-5)")
    sub.add_argument("--limit", type=float, default=60.0, metavar="SECONDS", help="longest run (default: 60)")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    inputs = [arguments.raw, arguments.grid, arguments.depth_map]
    require_places(inputs, text=arguments.output, picture=arguments.png, overwrite=arguments.overwrite)
    limit, workers = _checks.number("limit", arguments.limit, positive=True), _checks.threads(arguments.threads)
    echoes = read(arguments)
    notes: list[str] = []
    if all(value is None for value in (arguments.grid, arguments.x, arguments.y, arguments.depth_map)):
        echoes, track = framing.laid_along_x(echoes)  # where Fourier methods take them
        if track.rotation:
            notes.append(
                f"The survey was turned by {-np.degrees(track.rotation):.3f} deg about ({track.origin[0]:.10g}, "
                f"{track.origin[1]:.10g}) m, so that its track lies along x."
            )
    grid, how = chosen_grid(arguments, echoes)
    if grid.kind not in ("plane", "surface"):
        raise ValueError(f"--grid {arguments.grid}: found {grid.kind}, expected a plane or a surface")
    for tol in arguments.tol or ():  # one that cannot be met is said before anything is compressed
        plan_ahead(echoes, grid, tol, "backprojection", workers)
    if arguments.nan == "mask":
        echoes = silenced(echoes)
    raw = None if echoes.compressed else echoes
    if raw is not None:
        echoes = compression.compress(raw, threads=workers, progress=progress.step("compressing"))
    line, raw, note = _on_a_line(echoes, raw, progress)
    notes += [note] * bool(note)
    calls = comparison.methods(echoes, grid, arguments.tol or comparison.TOLS, raw=raw, line=line, threads=workers)
    found = comparison.compare(echoes, calls, limit=limit, progress=progress.step("comparing"))
    text = f"{Path(arguments.raw).name}: {found.traces} traces x {found.samples} samples; {how}, {grid.shape[0]} x "
    text += f"{grid.shape[1]} pixels\n\n{''.join(f'{note}{chr(10) * 2}' for note in notes)}{comparison.table(found)}\n{_LEGEND}"
    if arguments.output is not None:
        write_text(arguments.output, text, arguments.overwrite)
    if arguments.png is not None:
        drawn = comparison.figure({Path(arguments.raw).name.encode("utf-8", "backslashreplace").decode(): found})
        plot.write(drawn, arguments.png, plot.picture_format(arguments.png), dpi=100, overwrite=arguments.overwrite)
    if arguments.json:
        names = {"raw": arguments.raw, "table": arguments.output, "png": arguments.png, "grid": how, "notes": notes}
        print(json.dumps(names | dataclasses.asdict(found) | {"front": comparison.front(found.rows)}))
    else:
        print(text, end="")
    return 0


def _on_a_line(echoes: Echoes, raw: Echoes | None, progress: Progress) -> tuple[Echoes, Echoes | None, str]:
    """What Fourier and one-way methods take: echoes, compressed and raw, as they are or of their phase centres; and a note."""
    try:
        prepare(echoes, None)
    except ValueError as error:
        why = str(error).removeprefix("echoes: ").split(":")[0]
    else:
        return echoes, raw, ""
    progress.step("phase centres")
    try:
        line = reference.phase_centres(echoes)
        raw_line = None if raw is None else reference.phase_centres(raw)
    except ValueError as error:
        return echoes, raw, f"Fourier and one-way methods have no line to image, reference.phase_centres: {error}."
    return (
        line,
        raw_line,
        f"Fourier and one-way methods image the echoes' {line.n_ping} phase centres, made even ({why}): at most "
        f"{line.attrs['residual_phase']:.2g} rad of phase are neglected by that, and {line.attrs['resampling_error']:.1e} of "
        "the signal is the resampling's error. They are judged as all methods are, against the sum over the echoes themselves.",
    )


COMMAND = Command(
    "compare",
    "run every method on echoes from a file: its time beside its error, as a table and a figure",
    _add_arguments,
    _run,
)
