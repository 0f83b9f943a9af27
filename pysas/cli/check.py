"""`pysas check`: whether echoes from a file are sound."""

from __future__ import annotations

import argparse
import json

from pysas.cli.common import Command, Progress
from pysas.formats import io
from pysas.inspection import inspect


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="FILE")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 if anything fails."""
    findings = inspect(io.load_echoes(arguments.file))
    failed = any(finding.state == "FAIL" for finding in findings)
    if arguments.json:
        rows = [{"check": f.name, "state": f.state, "text": f.text} for f in findings]
        print(json.dumps({"file": arguments.file, "ok": not failed, "checks": rows}))
    else:
        print("\n".join(map(str, findings)))
    return int(failed)


COMMAND = Command("check", "check a file of echoes; exit code 1 if something is wrong", _add_arguments, _run)
