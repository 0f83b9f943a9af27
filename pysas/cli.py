"""The command line: arguments, progress, errors. What the commands do is in commands.py."""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from pysas import __version__

_ERROR, _INTERRUPTED = 2, 130


def _span(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected MIN:MAX in metres") from None
    if not low < high:
        raise argparse.ArgumentTypeError(f"{text!r}: expected MIN below MAX")
    return low, high


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
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", help="one JSON object on standard output")
        return sub

    def workers(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--threads", type=int, metavar="N", help="worker threads (default: all processors)")

    def writes(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--overwrite", action="store_true", help="replace files that are there (never what is read)")

    demo = command("demo", "simulate a survey, image it and report the error")
    demo.add_argument("-o", "--output", default="demo", metavar="DIR", help="folder for the results (default: demo)")
    writes(demo)
    workers(demo)

    def scene(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("raw", metavar="RAW", help="echoes, raw or compressed (.npz, .h5)")
        sub.add_argument("--x", type=_span, metavar="MIN:MAX", help="along-track span, m")
        sub.add_argument("--y", type=_span, metavar="MIN:MAX", help="across-track span, m")
        sub.add_argument("--z", type=float, metavar="Z", help="height of the imaged plane, m (default: 0)")
        sub.add_argument("--spacing", type=float, metavar="S", help="pixel spacing, m (default: half the resolution)")
        sub.add_argument("--grid", metavar="FILE", help="use the grid of this image file instead")
        sub.add_argument("--png", metavar="FILE", help="picture to write (needs matplotlib)")
        writes(sub)
        sub.add_argument("--nan", choices=("raise", "mask"), default="raise", help="traces with non-finite samples")
        workers(sub)

    image = command("image", "image echoes from a file")
    scene(image)
    image.add_argument("-o", "--output", metavar="IMAGE", help="image file to write (.npz, .h5)")
    image.add_argument("--tol", type=float, default=1e-3, help="relative error to keep (default: 1e-3)")
    image.add_argument(
        "--method", choices=("auto", "backprojection", "ffbp"), default="auto", help="auto: the faster, by prediction"
    )
    image.add_argument("--backend", choices=("auto", "numba", "cpp"), default="auto")

    compare = command("compare", "run every method on echoes from a file: its time beside its error, as a table and a figure")
    scene(compare)
    compare.add_argument("-o", "--output", metavar="TABLE", help="file to write the table to (Markdown)")
    compare.add_argument("--tol", type=float, nargs="+", metavar="TOL", help="of the engines (default: 1e-1 to 1e-5)")
    compare.add_argument("--limit", type=float, default=60.0, metavar="SECONDS", help="longest run (default: 60)")

    simulate = command("simulate", "write simulated raw echoes")
    simulate.add_argument("-o", "--output", required=True, metavar="RAW", help="file to write (.npz, .h5)")
    writes(simulate)
    simulate.add_argument("--points", metavar="FILE", help="scatterers, x,y,z,amplitude a line (default: the demo's)")
    simulate.add_argument("--pings", type=int, default=150)
    simulate.add_argument("--channels", type=int, default=6)
    simulate.add_argument("--seed", type=int, default=1)
    workers(simulate)

    info = command("info", "what a file holds and what the planner would do")
    info.add_argument("file", metavar="FILE")
    info.add_argument("--tol", type=float, default=1e-3)
    info.add_argument("--plan", action="store_true", help="also what the plan leaves out, its errors, and alternatives")

    check = command("check", "check a file of echoes; exit code 1 if something is wrong")
    check.add_argument("file", metavar="FILE")
    return top


class Progress:
    """A bar on a terminal, a plain line a step otherwise, nothing with --json; always on standard error."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.terminal = sys.stderr is not None and sys.stderr.isatty()

    def step(self, label: str) -> Callable[[float], None] | None:
        """A callback for one step of the work."""
        if self.quiet:
            return None
        if not self.terminal:
            print(f"{label} ...", file=sys.stderr, flush=True)
            return None
        began = time.monotonic()

        def show(share: float) -> None:
            width = 30
            bar = "#" * int(share * width)
            seconds = time.monotonic() - began
            end = "\n" if share >= 1 else ""
            print(f"\r{label:<10} [{bar:<{width}}] {100 * share:3.0f} % {seconds:5.1f} s", end=end, file=sys.stderr, flush=True)

        return show


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code (0 well, 1 a failed check or an image of nothing, 2 an error, 130 Ctrl-C)."""
    arguments = parser().parse_args(_joined(sys.argv[1:] if argv is None else argv))

    def warn(message: Any, *_: Any, **__: Any) -> None:
        print(f"pysas: warning: {message}", file=sys.stderr)

    from pysas import commands

    if isinstance(sys.stdout, io.TextIOWrapper):  # the work is not lost where a name cannot be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = warn
        try:
            code = int(getattr(commands, arguments.command)(arguments, Progress(arguments.json)))
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


if __name__ == "__main__":
    sys.exit(main())
