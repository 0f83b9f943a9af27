"""`pysas convert`: echoes and images from one format to another; between this project's own a block of pings at a time."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from pysas import loading
from pysas.cli.common import Command, Progress, add_channel, add_overwrite
from pysas.formats import arrays, catalogue, files, io, own, stores
from pysas.formats.containers import container
from pysas.formats.echo_store import open_echoes
from pysas.formats.format import COLUMNS, Look
from pysas.model.echoes import Echoes
from pysas.model.image import Image


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="A", help="echoes or an image, in any format that is known (docs/formats.md)")
    sub.add_argument("output", metavar="B", help="file to write: its name's end says in which format")
    add_channel(sub)
    sub.add_argument("--int16", action="store_true", help="samples in int16 with a scale a ping, in a .zarr")
    sub.add_argument("--pings", type=_span, default=slice(None), metavar="A:B", help="pings A to B - 1, counted from 0")
    sub.add_argument("--db", type=float, metavar="DB", help="an image in a .tif or .png: bytes over DB dB (.png: 40)")
    sub.add_argument("--formats", action=_Formats, nargs=0, help="print the formats that are known, and end")
    add_overwrite(sub)


class _Formats(argparse.Action):
    """Prints the formats, as --version does its number: A and B are not asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        for known in catalogue.FORMATS:
            said = dict(zip(COLUMNS, known.row, strict=True))
            print(f"{said.pop('name'):8} {said.pop('format')}")
            for column, text in said.items():
                print(f"{'':8}   {column:8} {text}")
        parser.exit()


def _span(text: str) -> slice:
    first, colon, last = text.partition(":")
    if not colon or not all(end == "" or (end.isascii() and end.isdigit()) for end in (first, last)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B, numbers of pings, or one of them")
    return slice(int(first) if first else None, int(last) if last else None)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    source, output = arguments.file, arguments.output
    look = Look(source)
    if catalogue.recognised(look) is own.FORMAT and look.suffix in own.FORMAT.suffixes and _holds_echoes(source):
        if Look(output).suffix in own.FORMAT.suffixes and arguments.db is None:
            own.FORMAT.require_channel(source, arguments.channel)
            return _streamed(look, arguments, progress)
    if arguments.int16:
        raise ValueError("--int16: expected echoes of .npz, .h5 or .zarr, and a .zarr to write")
    _require_place(look, output, arguments.overwrite)
    item = loading.read(look, arguments.channel)
    if arguments.pings != slice(None):
        if not isinstance(item, Echoes):
            raise ValueError(f"--pings: {source} holds an image: expected echoes")
        item = item[arguments.pings]
    target = catalogue.by_name(output, type(item))
    if arguments.db is None:
        target.write(output, item, arguments.overwrite)
    elif target.draw is None or not isinstance(item, Image):
        raise ValueError(f"--db {arguments.db:g}: expected an image, and a .tif or .png to write")
    else:
        target.draw(output, item, arguments.db, arguments.overwrite)
    shape = list(item.data.shape)
    text = f"{output}: {target.name}, {' x '.join(map(str, shape))}"
    values = {"output": output, "format": target.name, "shape": shape}
    print(json.dumps(values) if arguments.json else text)
    return 0


def _holds_echoes(path: str) -> bool:
    """False of an image of this project; what is wrong with a file is told when it is read."""
    try:
        with io.opened(path) as file:
            return file.text("schema") != io.IMAGE
    except (ValueError, OSError, ImportError):
        return True


def _require_place(look: Look, output: str, overwrite: bool) -> None:
    """Raise now what writing would."""
    if io.is_store(output):
        # either is replaced by its like alone: which this is to be, writing knows
        single = stores.schema_of(Path(output)) == stores.HOLDS["single images"]
        target = stores.check_output(output, overwrite, "single images" if single else "echoes")
        if target.exists() and target.samefile(look.path):
            raise ValueError(f"B {output}: is read by this command: expected another name")
        return
    inputs = catalogue.inputs_of(look) if overwrite else [look.path]
    files.check_outputs([("B", output)], inputs, overwrite)
    if Look(output).suffix in arrays.FORMAT.suffixes:
        replaced = next((path for path in inputs if arrays.is_beside(output, path)), None)
        if replaced is not None:
            raise ValueError(f"B {output}: would replace {replaced}, which is read by this command: expected another name")


def _streamed(look: Look, arguments: argparse.Namespace, progress: Progress) -> int:
    """From one of this project's containers to another, a block of pings at a time."""
    output = arguments.output
    _require_place(look, output, arguments.overwrite)
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
