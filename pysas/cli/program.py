"""All commands: their arguments, how they are run, and what becomes of warnings and errors."""

from __future__ import annotations

import argparse
import io
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from pysas import __version__
from pysas.cli import check, compare, demo, echoes, image, info, simulation
from pysas.cli.common import Progress

_ERROR, _INTERRUPTED = 2, 130
_COMMANDS = {
    command.name: command
    for command in (
        demo.COMMAND,
        echoes.COMMAND,
        image.COMMAND,
        compare.COMMAND,
        simulation.COMMAND,
        info.COMMAND,
        check.COMMAND,
    )  # fmt: skip
}


def _joined(argv: Sequence[str]) -> list[str]:
    """`--x -1:1` as `--x=-1:1`: argparse takes a value that begins with a minus for an option."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] in ("--x", "--y", "--z") and argument.startswith("-"):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        self.exit(_ERROR, f"pysas: error: {message}\n")


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = _Parser(prog="pysas", description="Images synthetic aperture sonar data and keeps the error you ask for.")
    top.add_argument("--version", action="version", version=f"pysas {__version__}")
    subparsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    for command in _COMMANDS.values():
        sub = subparsers.add_parser(command.name, help=command.text, description=command.text)
        sub.add_argument("--json", action="store_true", help="one JSON object on standard output")
        command.add_arguments(sub)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code (0 well, 1 a failed check or an image of nothing, 2 an error, 130 Ctrl-C)."""
    arguments = parser().parse_args(_joined(sys.argv[1:] if argv is None else argv))

    def warn(message: Any, *_: Any, **__: Any) -> None:
        print(f"pysas: warning: {message}", file=sys.stderr)

    if isinstance(sys.stdout, io.TextIOWrapper):  # the work is not lost where a name cannot be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = warn
        try:
            code = _COMMANDS[arguments.command].run(arguments, Progress(arguments.json))
            if sys.stdout is not None:  # closed by the caller
                sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            print("pysas: interrupted", file=sys.stderr)
            return _INTERRUPTED
        except BrokenPipeError:  # the reader, such as `head`, has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return _ERROR
        except (ValueError, TypeError, OSError, ImportError, MemoryError) as error:
            if os.environ.get("PYSAS_DEBUG"):
                raise
            text = " ".join(str(error).split()) or type(error).__name__
            print(f"pysas: error: {text}", file=sys.stderr)
            return _ERROR
