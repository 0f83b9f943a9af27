"""How the benchmarks write their documents."""

import argparse
import platform
from pathlib import Path

import pysas


def parser(doc):
    """An argument parser with `--write`."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--write", metavar="FILE", help="write the document there instead of printing it")
    return made


def write(text, file):
    """Write a document to `file`, or print it where that is None."""
    if file:
        Path(file).write_text(text, encoding="utf-8")
    else:
        print(text, end="")


def machine():
    """A line about what was measured on."""
    config = pysas.show_config("dict")
    return f"{config['processor']} ({platform.machine()}), {config['isa']}, pysas {config['pysas']}, Python {config['python']}"
