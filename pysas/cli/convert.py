"""`pysas convert`: echoes and images from one format to another; between this project's own a block of pings at a time."""

from __future__ import annotations

import argparse
import json

from pysas import loading
from pysas.cli.common import Command, Progress, add_overwrite
from pysas.formats import catalogue, files, io, own, stores
from pysas.formats.containers import container
from pysas.formats.echo_store import open_echoes
from pysas.formats.format import Look
from pysas.model.echoes import Echoes


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="A", help="echoes or an image, in any format that is known (docs/formats.md)")
    sub.add_argument("output", metavar="B", help="file to write: its name's end says in which format")
    sub.add_argument("--channel", metavar="NAME", help="of a file whose channels have pings of their own")
    sub.add_argument("--int16", action="store_true", help="samples in int16 with a scale a ping, in a .zarr")
    sub.add_argument("--pings", type=_span, default=slice(None), metavar="A:B", help="pings A to B - 1, counted from 0")
    add_overwrite(sub)


def _span(text: str) -> slice:
    first, colon, last = text.partition(":")
    if not colon or not all(end == "" or (end.isascii() and end.isdigit()) for end in (first, last)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B, numbers of pings, or one of them")
    return slice(int(first) if first else None, int(last) if last else None)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    source, output = arguments.file, arguments.output
    look = Look(source)
    if catalogue.recognised(look) in (None, own.FORMAT) and look.suffix in own.FORMAT.suffixes and _holds_echoes(source):
        if Look(output).suffix in own.FORMAT.suffixes:
            return _streamed(arguments, progress)
    if arguments.int16:
        raise ValueError("--int16: expected echoes of .npz, .h5 or .zarr, and a .zarr to write")
    _require_place(source, output, arguments.overwrite)
    item = loading.load(source, channel=arguments.channel)
    if arguments.pings != slice(None):
        if not isinstance(item, Echoes):
            raise ValueError(f"--pings: {source} holds an image: expected echoes")
        item = item[arguments.pings]
    target = catalogue.by_name(output, type(item))
    target.write(output, item, arguments.overwrite)
    shape = list(item.data.shape)
    text = f"{output}: {target.title}, {item.data.dtype} of shape {' x '.join(map(str, shape))}"
    values = {"output": output, "format": target.name, "shape": shape, "stored": str(item.data.dtype)}
    print(json.dumps(values) if arguments.json else text)
    return 0


def _holds_echoes(path: str) -> bool:
    """False of an image of this project; what is wrong with a file is told when it is read."""
    try:
        with io.opened(path) as file:
            return file.text("schema") != io.IMAGE
    except (ValueError, OSError, ImportError):
        return True


def _require_place(source: str, output: str, overwrite: bool) -> None:
    """Raise now what writing would."""
    if io.is_store(output):
        target = stores.check_output(output, overwrite)
        if target.exists() and target.samefile(source):
            raise ValueError(f"B {output}: is read by this command: expected another name")
    else:
        files.check_outputs([("B", output)], [source], overwrite)


def _streamed(arguments: argparse.Namespace, progress: Progress) -> int:
    """From one of this project's containers to another, a block of pings at a time."""
    output = arguments.output
    _require_place(arguments.file, output, arguments.overwrite)
    if not io.is_store(output):
        container(output)
    with open_echoes(arguments.file) as store:
        step = progress.step("converting")
        store.save(output, arguments.pings, int16=arguments.int16, overwrite=arguments.overwrite, progress=step)
    with open_echoes(output) as written:
        shape = list(written.navigation.data.shape)
        text = f"{output}: {shape[0]} pings, stored as {written.stored}"
    print(json.dumps({"output": output, "shape": shape, "stored": written.stored}) if arguments.json else text)
    return 0


COMMAND = Command("convert", "write echoes or an image in another format", _add_arguments, _run)
