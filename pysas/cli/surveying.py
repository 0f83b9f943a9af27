"""`pysas survey`: lines of echoes to a store of image tiles, on this machine or on a Dask cluster."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pysas import _checks
from pysas.cli.common import Command, Progress, add_overwrite, add_threads, require_places, spacing, span, window
from pysas.engine import BACKENDS
from pysas.planning.framing import SIDES
from pysas.survey import SurveyPlan, SurveyReport, follow, overview, page, plan, resume, run, verify
from pysas.survey.following import AXES
from pysas.survey.lines import SECTION, TILE
from pysas.survey.pages import SUFFIXES, is_page
from pysas.survey.running import require_place, require_same

_PATIENCE = 10.0  # s for a scheduler's answer
# options that a plan is made from, by their names in Python
_PLANNED = (
    "pixel", "swath", "side", "z", "altitude", "depth_map", "tol", "method", "backend", "nan", "window", "tile", "section",
)  # fmt: skip


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("lines", metavar="LINE", nargs="*", help="echoes of a straight line, raw or compressed (.zarr, .npz, .h5)")
    sub.add_argument("-o", "--output", metavar="STORE", help="store of images to write (.zarr)")
    sub.add_argument(
        "--pixel",
        type=functools.partial(spacing, axes="along the line and across"),
        metavar="M[,M]",
        help="pixels, along the line and across (default: 0.8 of Nyquist)",
    )
    sub.add_argument("--swath", type=span, metavar="NEAR:FAR", help="m from the track, level (default: what is recorded)")
    sub.add_argument("--side", choices=SIDES, help="default: where the beam looks")
    seabed = sub.add_mutually_exclusive_group()
    seabed.add_argument("--z", type=float, metavar="Z", help="of the seabed, m")
    seabed.add_argument("--altitude", type=float, metavar="M", help="of the sonar above the seabed, m")
    seabed.add_argument("--depth-map", metavar="MAP", help="heights of the seabed: .npz or .h5 (x, y, z), or text")
    sub.add_argument("--tol", type=float, help="relative error to keep (default: 1e-2)")
    sub.add_argument("--method", choices=("auto", "backprojection", "ffbp"))
    sub.add_argument("--backend", choices=BACKENDS)
    sub.add_argument("--nan", choices=("raise", "mask"), help="raise: tiles of pings with NaN fail; mask: without those traces")
    sub.add_argument("--window", type=window, metavar="NAME", help="spectral window of raw echoes' compression")
    sub.add_argument("--tile", type=float, metavar="M", help=f"of a tile along the line (default: {TILE:g})")
    sub.add_argument("--section", type=float, metavar="M", help=f"of what one task makes (default: {SECTION:g})")
    add_threads(sub)
    sub.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://host:8786")
    what = sub.add_mutually_exclusive_group()
    what.add_argument("--plan", action="store_true", help="list strips, predicted time and memory, and end")
    what.add_argument("--verify", action="store_true", help="compare STORE and its lines with what was written")
    what.add_argument("--follow", action="store_true", help="image one line that still grows, until its recorder ends it")
    sub.add_argument("--patience", type=float, metavar="S", help="of --follow: end after so long without a ping")
    sub.add_argument("--resume", action="store_true", help="make only what STORE lacks")
    sub.add_argument("--png", metavar="FILE", help="map of the plan to draw (needs matplotlib)")
    sub.add_argument("--report", metavar="HTML", help="page on what was made, with quick-looks; and a .json beside it")
    add_overwrite(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 where tiles fail or are damaged."""
    options = {name: value for name in _PLANNED if (value := getattr(arguments, name)) is not None}
    _require_used(arguments, options)
    _require_places(arguments)
    if arguments.plan:
        made = plan(_lines(arguments), threads=arguments.threads, **options)
        if arguments.png is not None:
            overview(made, arguments.png, overwrite=arguments.overwrite)
        print(json.dumps(_planned(made)) if arguments.json else made)
        return 0
    if arguments.output is None:
        raise ValueError("-o: missing: expected the store of images")
    if arguments.verify:
        return _verified(arguments, progress)
    with _client(arguments.scheduler) as client:
        report = _report(arguments, options, progress, client)
    if arguments.report is not None:
        page(arguments.output, report, arguments.report, overwrite=arguments.overwrite or arguments.resume)
    print(json.dumps(report.as_dict()) if arguments.json else report)
    return int(bool(report.failed or report.lost))


def _require_used(arguments: argparse.Namespace, options: dict[str, Any]) -> None:
    """Raise ValueError for what would do nothing."""
    given = {name for name in ("scheduler", "patience", "resume", "report") if getattr(arguments, name)}
    if arguments.verify:
        given |= {*options, *(name for name in ("lines", "threads", "overwrite") if getattr(arguments, name))}
    if (arguments.plan or arguments.verify) and given:
        names = ["LINE" if name == "lines" else f"--{name.replace('_', '-')}" for name in sorted(given)]
        raise ValueError(f"--{'plan' if arguments.plan else 'verify'}: {', '.join(names)}: expected none with it")
    if arguments.follow and (arguments.scheduler is not None or len(arguments.lines) != 1):
        raise ValueError("--follow: expected one LINE, and no --scheduler: tiles are made as the line grows, by this process")
    if arguments.patience is not None and not arguments.follow:
        raise ValueError("--patience: expected with --follow")


def _require_places(arguments: argparse.Namespace) -> None:
    """Raise now what writing the pictures and the page would raise after the work."""
    if arguments.png is not None and not arguments.plan:
        raise ValueError("--png: expected with --plan: it is a map of the plan")
    if arguments.report is not None and Path(arguments.report).suffix.lower() not in SUFFIXES:
        raise ValueError(f"--report {arguments.report}: expected a name that ends in .html")
    beside = None if arguments.report is None else str(Path(arguments.report).with_suffix(".json"))
    inputs = [*arguments.lines, arguments.depth_map]
    again = arguments.overwrite or (arguments.resume and is_page(arguments.report))
    for text in (arguments.report, beside):
        require_places(inputs, text=text, overwrite=again)
    require_places(inputs, picture=arguments.png, overwrite=arguments.overwrite)


def _lines(arguments: argparse.Namespace) -> list[str]:
    if not arguments.lines:
        raise ValueError("LINE: none: expected files of echoes")
    return list(arguments.lines)


def _report(arguments: argparse.Namespace, options: dict[str, Any], progress: Progress, client: Any) -> SurveyReport:
    output, threads = arguments.output, arguments.threads
    if arguments.resume and arguments.overwrite:
        raise ValueError("--resume, --overwrite: expected one of both")
    there = arguments.resume and os.path.exists(output)
    if arguments.follow:
        return _followed(arguments, options, there)
    if arguments.resume and not arguments.lines:
        if not there:
            raise ValueError(f"-o {output}: no such store: expected one to go on with, or LINEs to begin it with")
        if options:
            raise ValueError(f"--resume: {', '.join(options)}: expected with LINEs, or none: the store has its plan")
        return resume(output, client=client, threads=threads, progress=progress.step("imaging"))
    if not there:  # before the time that a plan takes
        require_place(output, overwrite=arguments.overwrite)
    made = plan(_lines(arguments), threads=threads, **options)
    if there:
        require_same(made, output)
    elif not arguments.json:
        print(made, flush=True)
    step = progress.step("imaging")
    if there:
        return resume(output, client=client, threads=threads, progress=step)
    return run(made, output, client=client, threads=threads, overwrite=arguments.overwrite, progress=step)


def _followed(arguments: argparse.Namespace, options: dict[str, Any], there: bool) -> SurveyReport:
    if there and options:
        raise ValueError(f"--follow --resume: {', '.join(options)}: expected none: the store has its plan")

    line, terminal = arguments.lines[0], sys.stderr.isatty()

    def told(tiles: int) -> None:
        if not arguments.json:
            text = f"{tiles} tile{'s' * (tiles > 1)}"
            print(f"\r{text}" if terminal else text, end="" if terminal else "\n", file=sys.stderr, flush=True)

    if not arguments.json:
        yet = "" if os.path.exists(line) else ", which is not there yet"
        print(f"following {line}{yet}: tiles come once {AXES:g} m of track are there", file=sys.stderr, flush=True)

    return follow(
        line, arguments.output, patience=arguments.patience, threads=arguments.threads,
        overwrite=arguments.overwrite, again=there, progress=told, **options,
    )  # fmt: skip


def _verified(arguments: argparse.Namespace, progress: Progress) -> int:
    found = verify(arguments.output, progress=progress.step("verifying"))
    if arguments.json:
        print(json.dumps({"store": arguments.output, "damage": [{"where": one.where, "what": one.what} for one in found]}))
    else:
        print("\n".join(f"{one.where}: {one.what}" for one in found) or f"{arguments.output}: as it was written")
    return int(bool(found))


def _planned(made: SurveyPlan) -> dict[str, Any]:
    tiles = [
        {"strip": tile.strip, "tile": tile.number, "pings": [tile.pings.start, tile.pings.stop], "seconds": tile.seconds}
        for tile in made.tiles
    ]
    return {"seconds": sum(made.seconds), "memory": made.memory, "threads": made.threads, "tiles": tiles}


@contextlib.contextmanager
def _client(address: str | None) -> Iterator[Any]:
    """A cluster's, or None for this process."""
    if address is None:
        yield None
        return
    try:
        import distributed
    except ImportError:
        raise _checks.optional("distributed", "survey") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it has to say is told in one line
    try:
        client: Any = distributed.Client(address, timeout=_PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConnectionError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from None
    with client:
        yield client


COMMAND = Command("survey", "image lines of any length, tile by tile, into a store (.zarr)", _add_arguments, _run)
