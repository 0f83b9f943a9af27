"""`pysas compare`: every method on echoes from a file, its time beside its error."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

from pysas import _checks, comparison, plot
from pysas.cli.common import Command, Progress, add_scene, chosen_grid, load_echoes, require_places, silenced, write_text
from pysas.imaging.planner import plan_ahead
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
    require_places([arguments.raw, arguments.grid], text=arguments.output, picture=arguments.png, overwrite=arguments.overwrite)
    limit, workers = _checks.number("limit", arguments.limit, positive=True), _checks.threads(arguments.threads)
    echoes = load_echoes(arguments.raw)
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
    calls = comparison.methods(echoes, grid, arguments.tol or comparison.TOLS, raw=raw, threads=workers)
    found = comparison.compare(echoes, calls, limit=limit, progress=progress.step("comparing"))
    text = f"{Path(arguments.raw).name}: {found.traces} traces x {found.samples} samples; {how}, {grid.shape[0]} x "
    text += f"{grid.shape[1]} pixels\n\n{comparison.table(found)}\n{_LEGEND}"
    if arguments.output is not None:
        write_text(arguments.output, text, arguments.overwrite)
    if arguments.png is not None:
        drawn = comparison.figure({Path(arguments.raw).name.encode("utf-8", "backslashreplace").decode(): found})
        plot.write(drawn, arguments.png, plot.picture_format(arguments.png), dpi=100, overwrite=arguments.overwrite)
    if arguments.json:
        names = {"raw": arguments.raw, "table": arguments.output, "png": arguments.png, "grid": how}
        print(json.dumps(names | dataclasses.asdict(found) | {"front": comparison.front(found.rows)}))
    else:
        print(text, end="")
    return 0


COMMAND = Command(
    "compare",
    "run every method on echoes from a file: its time beside its error, as a table and a figure",
    _add_arguments,
    _run,
)
