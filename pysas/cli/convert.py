"""`pysas convert`: echoes from one container to another, a block of pings at a time."""

from __future__ import annotations

import argparse
import json

from pysas.cli.common import Command, Progress, add_overwrite
from pysas.formats import files, io, stores
from pysas.formats.containers import container
from pysas.formats.echo_store import open_echoes


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="A", help="echoes (.npz, .h5, .zarr)")
    sub.add_argument("output", metavar="B", help="file to write (.npz, .h5, .zarr)")
    sub.add_argument("--int16", action="store_true", help="samples in int16 with a scale a ping, in a .zarr")
    sub.add_argument("--pings", type=_span, default=slice(None), metavar="A:B", help="pings A to B - 1, counted from 0")
    add_overwrite(sub)


def _span(text: str) -> slice:
    first, colon, last = text.partition(":")
    if not colon or not all(end == "" or (end.isascii() and end.isdigit()) for end in (first, last)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B, numbers of pings, or one of them")
    return slice(int(first) if first else None, int(last) if last else None)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    output = arguments.output
    if io.is_store(output):
        target = stores.check_output(output, arguments.overwrite)
        if target.exists() and target.samefile(arguments.file):
            raise ValueError(f"B {output}: is read by this command: expected another name")
    else:
        container(output)
        files.check_outputs([("B", output)], [arguments.file], arguments.overwrite)
    with open_echoes(arguments.file) as store:
        step = progress.step("converting")
        store.save(output, arguments.pings, int16=arguments.int16, overwrite=arguments.overwrite, progress=step)
    with open_echoes(output) as written:
        shape = list(written.navigation.data.shape)
        text = f"{output}: {shape[0]} pings, stored as {written.stored}"
    print(json.dumps({"output": output, "shape": shape, "stored": written.stored}) if arguments.json else text)
    return 0


COMMAND = Command("convert", "write echoes to another container: .npz, .h5 or .zarr", _add_arguments, _run)
