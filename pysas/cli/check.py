"""`pysas check`: whether echoes from a file are sound."""

from __future__ import annotations

import argparse
import json

from pysas import loading
from pysas.cli.common import Command, Progress, add_channel
from pysas.formats import own
from pysas.formats.echo_store import open_echoes
from pysas.inspection import Finding, geometry, inspect, survey

_MOST_BYTES, _MOST_PINGS = 2**28, 512  # of samples of a store that are looked at
_WHOLE = (geometry.times, geometry.along_track, geometry.track, survey.units, survey.evenness)  # by navigation alone


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="FILE")
    add_channel(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 if anything fails."""
    path = arguments.file
    if own.is_own_store(path):
        own.FORMAT.require_channel(path, arguments.channel)
        findings = _of_store(path)
    else:
        findings = inspect(loading.load_echoes(path, channel=arguments.channel))
    failed = any(finding.state == "FAIL" for finding in findings)
    if arguments.json:
        rows = [{"check": f.name, "state": f.state, "text": f.text} for f in findings]
        print(json.dumps({"file": arguments.file, "ok": not failed, "checks": rows}))
    else:
        print("\n".join(map(str, findings)))
    return int(failed)


def _of_store(path: str) -> list[Finding]:
    """Findings about the samples of pings in the middle, and about all navigation, which is read anyway."""
    with open_echoes(path) as store:
        navigation, n = store.navigation, store.n_ping
        ping = navigation.n_channel * navigation.n_sample * navigation.dtype.itemsize
        count = max(min(n, _MOST_PINGS, _MOST_BYTES // ping), 1)
        first = (n - count) // 2
        found = inspect(store.echoes(slice(first, first + count)))
    whole = {finding.name: finding for finding in (judge(navigation) for judge in _WHOLE)}
    text = f"samples of pings {first} to {first + count - 1} of {n}, navigation of all"
    if not store.complete:
        text += "; pings are still added, or their recorder was ended"
    return [Finding("looked at", "ok", text), *(whole.get(finding.name, finding) for finding in found)]


COMMAND = Command("check", "check a file of echoes; exit code 1 if something is wrong", _add_arguments, _run)
