"""`pysas info`: what a file holds, where it was sailed, and what imaging it would give and cost."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from pysas import loading
from pysas._checks import FloatArray
from pysas.cli.common import Command, Progress, add_channel
from pysas.formats import io, own
from pysas.formats.echo_store import open_echoes
from pysas.formats.stores import HOLDS, schema_of
from pysas.imaging.planner import plan_ahead
from pysas.model.echoes import Echoes
from pysas.model.image import Image
from pysas.planning import framing
from pysas.survey.image_store import SurveyStore
from pysas.survey.running import plan_of


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("file", metavar="FILE")
    add_channel(sub)
    sub.add_argument("--tol", type=float, default=1e-3)
    sub.add_argument("--plan", action="store_true", help="also how the engine would go about it, its errors, and alternatives")


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    if io.is_store(arguments.file) and schema_of(Path(arguments.file)) == HOLDS["images"]:
        values, text = _of_images(arguments.file)
        print(json.dumps(values) if arguments.json else text)
        return 0
    if own.is_own_store(arguments.file):
        own.FORMAT.require_channel(arguments.file, arguments.channel)
        values, text = _of_store(arguments.file, arguments.tol, arguments.plan)
        print(json.dumps(values) if arguments.json else text)
        return 0
    item = loading.load(arguments.file, channel=arguments.channel)
    if isinstance(item, Image):
        values = {"kind": "image", "shape": list(item.data.shape), "report": item.report.as_dict()}
        text = repr(item)
    else:
        values, text = _of_echoes(item, arguments.tol, arguments.plan)
    print(json.dumps(values) if arguments.json else text)
    return 0


def _of_images(path: str) -> tuple[dict[str, Any], str]:
    """What a survey's store has of its plan."""
    store = SurveyStore(path)
    strips, lines = [], [f"images of a survey, planned by pysas {store.header.get('version')}"]
    for strip in store.strips:
        plan = plan_of(store, strip)
        states = Counter((strip.record(tile) or {"state": "missing"})["state"] for tile in range(plan.ready))
        strips.append({"strip": plan.name, "line": plan.line, "tiles": plan.ready, "complete": plan.complete, **states})
        there = ", ".join(f"{count} {state}" for state, count in sorted(states.items())) or "none"
        lines.append(
            f"  {plan.name}: {plan.line}{'' if plan.complete else ', which grows'}: {plan.ready} tiles of {plan.columns} x "
            f"{plan.y.size} pixels every {plan.step:g} m, tol {plan.settings.tol:g}: {there}"
        )
    return {"kind": "survey", "version": store.header.get("version"), "strips": strips}, "\n".join(lines)


def _of_store(path: str, tol: float, explained: bool) -> tuple[dict[str, Any], str]:
    """By navigation, and three pings of which samples are read."""
    with open_echoes(path) as store:
        values, text = _of_echoes(store.navigation, tol, explained)
        n = store.n_ping
        pings = sorted({0, n // 2, n - 1})
        peaks = [float(np.abs(store.echoes(slice(ping, ping + 1)).whole().data).max()) for ping in pings]
    values |= {
        "stored": store.stored,
        "complete": store.complete,
        "peaks": {str(k): v for k, v in zip(pings, peaks, strict=True)},
    }
    heard = ", ".join(f"{peak:.3g} in ping {ping}" for ping, peak in zip(pings, peaks, strict=True))
    lines = [f"  stored     {store.stored}{'' if store.complete else '; not complete: pings are added, or were'}"]
    return values, "\n".join([text, *lines, f"  samples    largest magnitude {heard}"])


def _of_echoes(echoes: Echoes, tol: float, explained: bool) -> tuple[dict[str, Any], str]:
    near, far = echoes.swath
    track = framing.course_of(echoes)
    tx, rx = (_extents(places) for places in (echoes.tx, echoes.receivers))
    along = framing.along_track_resolution(echoes)
    values = {
        "kind": "echoes", "shape": list(echoes.data.shape), "dtype": str(echoes.dtype), "compressed": echoes.compressed,
        "fs": echoes.fs, "fc": echoes.fc, "c": np.asarray(echoes.c).tolist(),
        "bandwidth": echoes.occupied_bandwidth, "swath": [near, far],
        "range_resolution": echoes.range_resolution, "along_track_resolution": along,
        "phase_centre_spacing": list(echoes.phase_centre_spacing()), "track": {"tx": tx, "rx": rx, "closed": track.closed,
        "direction": float(np.degrees(track.rotation))}, "warnings": echoes.warnings(),
    }  # fmt: skip
    title = echoes.attrs.get("title")
    lines = [repr(echoes)] + ([f"  title      {title}"] if title else [])
    lines += [f"  {name:<10} {_spans(extents)}" for name, extents in (("tx", tx), ("rx", rx))]
    lines.append(
        f"  direction  {'closed' if track.closed else f'{np.degrees(track.rotation):.3f} deg from x towards y'}, "
        f"sonar at z = {track.height:.10g} m"
    )
    lines.append(f"  resolution {100 * echoes.range_resolution:.3g} cm in slant range, {100 * along:.3g} cm along the track")
    try:
        z, why = framing.assumed_height(echoes)
        grid, how = framing.default_grid(echoes, z)
        chosen = plan_ahead(echoes, grid, tol)
    except (ValueError, TypeError) as error:  # what the file holds is worth seeing where it cannot be imaged so
        return values | {"grid": "none", "plan": f"no plan: {error}"}, "\n".join([*lines, f"no plan: {error}"])
    low, high = np.array([[axis.min(), axis.max()] for axis in grid.axes.values()]).T
    seconds = chosen.predicted_seconds
    lines += [
        f"default image, {grid.shape[1]} x {grid.shape[0]} pixels",
        f"  chosen     {how}",
        f"  extents    {_spans([low.tolist(), high.tolist()])}",
        f"  height     {why}",
        f"  time       about {seconds:.2g} s by {chosen.method} on {chosen.threads} threads, at tol {tol:g}",
    ]
    summary = chosen.explain() if explained else ""
    values |= {"grid": f"{how}; {why}", "grid_shape": list(grid.shape), "grid_extents": [low.tolist(), high.tolist()],
               "seconds": seconds, "method": chosen.method, "plan": summary}  # fmt: skip
    return values, "\n".join([*lines, summary] if explained else lines)


def _extents(places: FloatArray) -> list[list[float]]:
    flat = places.reshape(-1, 3)
    return [flat.min(axis=0).tolist(), flat.max(axis=0).tolist()]


def _spans(extents: list[list[float]]) -> str:
    return (
        ", ".join(
            f"{name} {round(low, 3):.10g} to {round(high, 3):.10g}" for name, low, high in zip("xyz", *extents, strict=False)
        )
        + " m"
    )


COMMAND = Command("info", "what a file holds: track, ranges, resolution, and the image it would give", _add_arguments, _run)
