"""All commands: their arguments, how they are run, and what becomes of warnings and errors."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

from pysas import __version__, _checks
from pysas.cli.common import Command, Progress

_ERROR, _INTERRUPTED = 2, 130
# and their modules
_COMMANDS = {
    "demo": "demo", "echoes": "echoes", "navigate": "navigate", "image": "image", "compare": "compare",
    "survey": "surveying", "mosaic": "mosaicking", "simulate": "simulation", "convert": "convert", "info": "info",
    "check": "check",
}  # fmt: skip


def _command(name: str) -> Command:
    """A command by its name; its module is loaded when it is asked for."""
    command = importlib.import_module(f"pysas.cli.{_COMMANDS[name]}").COMMAND
    if not isinstance(command, Command):
        raise _checks.InternalError(f"{name}: no command")
    return command


def _joined(argv: Sequence[str]) -> list[str]:
    """`--x -1:1` as `--x=-1:1`, as argparse takes a value that begins with a minus for an option; `--spacing A B` as A,B."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] in ("--x", "--y", "--z", "--reference") and argument.startswith("-"):
            joined[-1] += f"={argument}"
        elif joined[-2:-1] == ["--spacing"] and _is_number(joined[-1]) and _is_number(argument):
            joined[-1] += f",{argument}"
        else:
            joined.append(argument)
    return joined


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        self.exit(_ERROR, f"pysas: error: {message}\n")


def parser(names: Iterable[str] = _COMMANDS) -> argparse.ArgumentParser:
    """Commands, all of them by default, and their options."""
    top = _Parser(prog="pysas", description="Images synthetic aperture sonar data and keeps the error you ask for.")
    top.add_argument("--version", action="version", version=f"pysas {__version__}")
    subparsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    for command in map(_command, names):
        sub = subparsers.add_parser(command.name, help=command.text, description=command.text)
        sub.add_argument("--json", action="store_true", help="one JSON object on standard output")
        command.add_arguments(sub)
    return top


def _notes(error: BaseException) -> str:
    """What was added to an exception on its way."""
    return "".join(f"; {note}" for note in getattr(error, "__notes__", ()))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code (0 well, 1 a failed check or an empty image, 2 an error, 130 Ctrl-C)."""
    given = _joined(sys.argv[1:] if argv is None else argv)
    arguments = parser([name for name in given[:1] if name in _COMMANDS] or _COMMANDS).parse_args(given)

    def warn(message: Any, *_: Any, **__: Any) -> None:
        print(f"pysas: warning: {message}", file=sys.stderr)

    if isinstance(sys.stdout, io.TextIOWrapper):  # the work is not lost where a name cannot be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = warn
        try:
            code = _command(arguments.command).run(arguments, Progress(arguments.json))
            if sys.stdout is not None:  # closed by the caller
                sys.stdout.flush()
            return code
        except KeyboardInterrupt as error:
            print(f"pysas: interrupted{_notes(error)}", file=sys.stderr)
            return _INTERRUPTED
        except BrokenPipeError:  # the reader, such as `head`, has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return _ERROR
        except (ValueError, TypeError, OSError, ImportError, MemoryError) as error:
            if os.environ.get("PYSAS_DEBUG"):
                raise
            text = " ".join(str(error).split()) or type(error).__name__
            print(f"pysas: error: {text}{_notes(error)}", file=sys.stderr)
            return _ERROR
