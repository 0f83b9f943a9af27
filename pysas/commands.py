"""What the commands of the command line do; each takes the parsed arguments and returns an exit code."""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks, _files, comparison, compression, framing, io, metrics, plot, reference, tracks
from pysas import demo as demonstration
from pysas._checks import FloatArray
from pysas._containers import container
from pysas.cli import Progress
from pysas.echoes import Echoes
from pysas.grid import Grid
from pysas.image import Image
from pysas.inspection import inspect
from pysas.planner import plan
from pysas.pulse import LFM
from pysas.simulation import simulate as simulate_points


def demo(arguments: argparse.Namespace, progress: Progress) -> int:
    """Simulate, save, image through the same path as `image`, and report the error."""
    folder = Path(arguments.output)
    folder.mkdir(parents=True, exist_ok=True)
    with_picture = _matplotlib()
    written = ["raw.npz", "image.npz", "report.json", "report.txt"] + ["image.png"] * with_picture
    _files.check_outputs([("-o", str(folder / name)) for name in written], [], arguments.overwrite)
    clock = time.perf_counter()
    raw = demonstration.echoes(threads=arguments.threads, progress=progress.step("simulating"))
    io.save(folder / "raw.npz", raw, overwrite=arguments.overwrite)
    simulated = time.perf_counter() - clock
    choices = argparse.Namespace(
        raw=str(folder / "raw.npz"), output=str(folder / "image.npz"), tol=1e-3, grid=None, method="auto", backend="auto",
        nan="raise", threads=arguments.threads, png=str(folder / "image.png") if with_picture else None,
        overwrite=arguments.overwrite,
    )  # fmt: skip
    picture, summary, echoes = _image(choices, progress, demonstration.grid())
    progress.step("checking")
    pixels = np.random.default_rng(0).choice(picture.grid.size, 200, replace=False)
    exact, level = reference.exact(echoes, picture.grid, pixels)
    summary["measured_error"] = metrics.relative_error(picture.data.ravel()[pixels], exact, level)
    summary["seconds"]["simulate"] = simulated
    summary["seconds"]["all"] = time.perf_counter() - clock
    _write_text(folder / "report.json", json.dumps(summary, indent=1) + "\n", arguments.overwrite)
    text = "\n".join(
        [
            _describe(picture, summary),
            f"measured error {summary['measured_error']:.2g} of the {summary['tol']:g} asked, on {pixels.size} pixels "
            "against the float64 sum",
            f"everything took {summary['seconds']['all']:.1f} s",
        ]
    )
    _write_text(folder / "report.txt", text + "\n", arguments.overwrite)
    if arguments.json:
        print(json.dumps(summary))
    else:
        print(f"{text}\nwritten to {folder}: {', '.join(written)}")
        if not with_picture:
            print("no picture: pip install 'pysas-sonar[plot]'")
    return 0


def image(arguments: argparse.Namespace, progress: Progress) -> int:
    """Image a file of echoes; 1 where not one term was summed."""
    if arguments.output is None and arguments.png is None and not arguments.json:
        raise ValueError("nothing to write: expected -o IMAGE, --png FILE or --json")
    picture, summary, _ = _image(arguments, progress, None)
    print(json.dumps(summary) if arguments.json else _describe(picture, summary))
    return int(picture.report.terms == 0)


def _image(arguments: argparse.Namespace, progress: Progress, grid: Grid | None) -> tuple[Image, dict[str, Any], Echoes]:
    """Load, compress if raw, image, save, draw; the one path of `demo` and `image`."""
    _require_places(arguments, [arguments.raw, arguments.grid], data=arguments.output, picture=arguments.png)
    echoes = _echoes(arguments.raw)
    how = "given grid"
    if grid is None:
        grid, how = _grid(arguments, echoes)
    seconds = {}
    # a plan of the compressed echoes: what cannot be met is said before anything is compressed
    chosen = plan(
        echoes.replace(compressed=True), grid, arguments.tol, arguments.method, arguments.threads, arguments.backend,
        nan=arguments.nan,
    )  # fmt: skip
    if not echoes.compressed:
        clock = time.perf_counter()
        if arguments.nan == "mask":
            echoes = _silenced(echoes)
        echoes = compression.compress(echoes, threads=arguments.threads, progress=progress.step("compressing"))
        seconds["compress"] = time.perf_counter() - clock
    picture = chosen(echoes.data, progress=progress.step("imaging"))
    seconds |= {"prepare": picture.report.prepare_seconds, "sum": picture.report.sum_seconds}
    targets = _targets(picture, echoes)
    if arguments.output is not None:
        io.save(arguments.output, picture, overwrite=arguments.overwrite)
    if arguments.png is not None:
        marks = [target["true"] for target in targets]
        plot.quicklook(picture, arguments.png, targets=marks or None, overwrite=arguments.overwrite)
    summary = {
        "raw": str(arguments.raw), "image": arguments.output, "png": arguments.png, "grid": how,
        "shape": list(grid.shape), "tol": arguments.tol, "report": picture.report.as_dict(), "seconds": seconds,
        "targets": targets,
    }  # fmt: skip
    return picture, summary, echoes


def compare(arguments: argparse.Namespace, progress: Progress) -> int:
    """Every method on a file of echoes, its time beside its error."""
    _require_places(arguments, [arguments.raw, arguments.grid], text=arguments.output, picture=arguments.png)
    limit, workers = _checks.number("limit", arguments.limit, positive=True), _checks.threads(arguments.threads)
    echoes = _echoes(arguments.raw)
    grid, how = _grid(arguments, echoes)
    if grid.kind not in ("plane", "surface"):
        raise ValueError(f"--grid {arguments.grid}: found {grid.kind}, expected a plane or a surface")
    for tol in arguments.tol or ():
        plan(echoes.replace(compressed=True), grid, tol, "backprojection", workers)
    if arguments.nan == "mask":
        echoes = _silenced(echoes)
    raw = None if echoes.compressed else echoes
    if raw is not None:
        echoes = compression.compress(raw, threads=workers, progress=progress.step("compressing"))
    calls = comparison.methods(echoes, grid, arguments.tol or comparison.TOLS, raw=raw, threads=workers)
    found = comparison.compare(echoes, calls, limit=limit, progress=progress.step("comparing"))
    text = f"{Path(arguments.raw).name}: {found.traces} traces x {found.samples} samples; {how}, {grid.shape[0]} x "
    text += f"{grid.shape[1]} pixels\n\n{comparison.table(found)}\n{_COMPARED}"
    if arguments.output is not None:
        _write_text(arguments.output, text, arguments.overwrite)
    if arguments.png is not None:
        drawn = comparison.figure({Path(arguments.raw).name.encode("utf-8", "backslashreplace").decode(): found})
        plot.write(drawn, arguments.png, plot.picture_format(arguments.png), dpi=100, overwrite=arguments.overwrite)
    if arguments.json:
        names = {"raw": arguments.raw, "table": arguments.output, "png": arguments.png, "grid": how}
        print(json.dumps(names | dataclasses.asdict(found) | {"front": comparison.front(found.rows)}))
    else:
        print(text, end="")
    return 0


_COMPARED = """\
s: median of the whole call (least to most). error: relative L2 against the float64 sum, in the norm of tol, on the cuts through
the strongest pixel and random pixels of each method's own grid; loss: of that pixel; IRW, PSLR: along x / y. *: after
sqrt(range) and one fitted factor. pixels: where other than above. front: none here is both faster and closer. An engine above
its tol: the data have energy outside their bandwidth or beyond fs/2.2, where nothing is promised.
"""


def _require_places(
    arguments: argparse.Namespace,
    inputs: Iterable[str | None],
    *,
    data: str | None = None,
    text: str | None = None,
    picture: str | None = None,
) -> None:
    """Raise now what writing would raise after the work, and where it would cost a file."""
    if picture is not None and not _matplotlib():
        raise ImportError("--png: matplotlib is not installed: pip install 'pysas-sonar[plot]'")
    if picture is not None:
        plot.picture_format(picture)
    if data is not None:
        container(data)
    outputs = [("-o", data), ("-o", text), ("--png", picture)]
    _files.check_outputs(
        [(option, path) for option, path in outputs if path is not None],
        [path for path in inputs if path is not None],
        arguments.overwrite,
    )


def _write_text(path: str | Path, text: str, overwrite: bool) -> None:
    """UTF-8; what a file's name holds beside text, escaped."""
    with _files.replacing(path, overwrite=overwrite) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


def _silenced(echoes: Echoes) -> Echoes:
    """Traces that hold a non-finite sample set to zero: compression would spread it, and zeros add nothing to an image."""
    bad = np.array([~np.isfinite(traces).all(axis=-1) for traces in echoes.traces])
    if not bad.any():
        return echoes
    warnings.warn(f"{np.count_nonzero(bad)} of {bad.size} traces left out: non-finite samples", stacklevel=2)
    data = echoes.data.copy()
    data[bad if data.ndim == 3 else bad[:, 0]] = 0
    return echoes.replace(data=data)


def _matplotlib() -> bool:
    import importlib.util

    return importlib.util.find_spec("matplotlib") is not None


def _echoes(path: str) -> Echoes:
    item = io.load(path)
    if not isinstance(item, Echoes):
        raise ValueError(f"{path}: found an image, expected echoes")
    return item


def _grid(arguments: argparse.Namespace, echoes: Echoes) -> tuple[Grid, str]:
    if arguments.grid is not None:
        if any(value is not None for value in (arguments.x, arguments.y, arguments.z, arguments.spacing)):
            raise ValueError("--grid: expected without --x, --y, --z and --spacing")
        item = io.load(arguments.grid)
        if not isinstance(item, Image):
            raise ValueError(f"--grid {arguments.grid}: found echoes, expected an image")
        return item.grid, f"grid of {arguments.grid}"
    z = 0.0 if arguments.z is None else arguments.z
    if arguments.x is not None and arguments.y is not None and arguments.spacing is not None:
        axes = [framing.span(limits[0], limits[1], arguments.spacing) for limits in (arguments.x, arguments.y)]
        return Grid.plane(axes[0], axes[1], z), "given spans"
    grid, how = framing.default_grid(echoes, z, arguments.spacing)
    if arguments.x is None and arguments.y is None:
        return grid, how
    axes = []
    for name, limits in (("x", arguments.x), ("y", arguments.y)):
        axis = grid.axes[name]
        step = arguments.spacing
        if step is None:  # an axis of one pixel has no step: the other's will do
            step = float(np.diff(axis if axis.size > 1 else grid.axes["y" if name == "x" else "x"])[0])
        axes.append(axis if limits is None else framing.span(limits[0], limits[1], step))
    return Grid.plane(axes[0], axes[1], z), f"given spans, else {how}"


def _targets(picture: Image, echoes: Echoes) -> list[dict[str, Any]]:
    """Known targets in the imaged plane: where they are and where the image has its peak."""
    grid = picture.grid
    truth = echoes.attrs.get("truth_position")
    if truth is None or grid.kind != "plane":
        return []
    positions = np.asarray(truth, dtype=np.float64)
    x, y = grid.axes["x"], grid.axes["y"]
    margin = echoes.range_resolution
    found = []
    for position in positions:
        if abs(position[2] - float(np.asarray(grid.height))) > 1e-3:
            continue
        if not (x.min() + margin < position[0] < x.max() - margin and y.min() + margin < position[1] < y.max() - margin):
            continue
        others = np.linalg.norm(positions - position, axis=1)
        apart = others[others > 0]
        radius = min(1.5 * margin, 0.5 * float(apart.min())) if apart.size else 1.5 * margin
        try:
            peak = metrics.peak_position(picture, near=(float(position[0]), float(position[1])), radius=radius)
        except ValueError:
            continue  # no pixel within the radius: the grid is too coarse to say
        error = float(np.hypot(peak[0] - position[0], peak[1] - position[1]))
        found.append({"true": position.tolist(), "found": [float(v) for v in peak], "error_mm": 1e3 * error})
    return found


def _describe(picture: Image, summary: dict[str, Any]) -> str:
    lines = [repr(picture), f"  grid       {summary['grid']}"]
    lines += [f"  {name + ' written':<10} {summary[name]}" for name in ("image", "png") if summary[name]]
    targets = summary["targets"]
    if targets:
        lines.append(f"  targets    {len(targets)} in this plane; true x, y, z; found x, y; error")
        for target in targets:
            (x, y, z), (u, v) = target["true"], target["found"]
            lines.append(f"    {x:9.4f} {y:9.4f} {z:8.3f}  {u:10.5f} {v:10.5f}  {target['error_mm']:7.3f} mm")
        lines.append(f"    largest error {max(target['error_mm'] for target in targets):.3f} mm")
    return "\n".join(lines)


def simulate(arguments: argparse.Namespace, progress: Progress) -> int:
    """Write simulated raw echoes."""
    _require_places(arguments, [arguments.points], data=arguments.output)
    step = progress.step("simulating")
    if arguments.points is None:
        raw = demonstration.echoes(arguments.pings, arguments.channels, arguments.seed, arguments.threads, step)
    else:
        points = _points(arguments.points)
        far = float(np.linalg.norm(points[:, :3], axis=1).max())
        pulse = LFM(100e3, 30e3, 2e-3, "tukey", 0.1)
        advance = arguments.channels * 0.0125
        start = (-advance * (arguments.pings - 1) / 2, 0.0, 0.0)
        track = tracks.perturbed(arguments.pings, advance, start=start, sway=0.05, heave=0.03, yaw=0.004, seed=arguments.seed)
        reach = far + float(np.abs(track.position).max()) + 1.0
        raw = simulate_points(
            points[:, :3], points[:, 3], pulse, tx=track.position, rx=tracks.array(track, arguments.channels, 0.025), fs=40e3,
            duration=2 * reach / 1500.0 + pulse.duration, velocity=track.velocity, threads=arguments.threads, progress=step,
            ping_time=track.time, attrs={"truth_position": points[:, :3], "truth_amplitude": points[:, 3]},
        )  # fmt: skip
    io.save(arguments.output, raw, overwrite=arguments.overwrite)
    print(json.dumps({"raw": arguments.output, "shape": list(raw.data.shape)}) if arguments.json else repr(raw))
    return 0


def _points(path: str) -> FloatArray:
    with _files.opened(path) as file:
        try:
            points = np.loadtxt(file, delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{path}: {error}: expected lines of x,y,z,amplitude") from None
    if points.shape[0] == 0 or points.shape[1] != 4:
        raise ValueError(f"{path}: found {points.shape[1]} columns, expected x,y,z,amplitude")
    return np.asarray(points, dtype=np.float64)


def info(arguments: argparse.Namespace, progress: Progress) -> int:
    """What a file holds, and the plan for its default grid."""
    item = io.load(arguments.file)
    if isinstance(item, Image):
        values: dict[str, Any] = {"kind": "image", "shape": list(item.data.shape), "report": item.report.as_dict()}
        text = repr(item)
    else:
        near, far = item.swath
        values = {
            "kind": "echoes", "shape": list(item.data.shape), "dtype": str(item.dtype), "compressed": item.compressed,
            "fs": item.fs, "fc": item.fc, "c": item.c, "bandwidth": item.occupied_bandwidth, "swath": [near, far],
            "range_resolution": item.range_resolution, "phase_centre_spacing": list(item.phase_centre_spacing()),
            "warnings": item.warnings(),
        }  # fmt: skip
        try:
            grid, how = framing.default_grid(item)
            chosen = plan(item.replace(compressed=True), grid, arguments.tol)
            summary = chosen.explain() if arguments.plan else str(chosen)
        except ValueError as error:  # what the file holds is worth seeing where it cannot be imaged so
            how, summary = "none", f"no plan: {error}"
        values |= {"grid": how, "plan": summary}
        title = item.attrs.get("title")
        text = "\n".join([repr(item)] + ([f"  title      {title}"] if title else []) + [f"default grid: {how}", summary])
    print(json.dumps(values) if arguments.json else text)
    return 0


def check(arguments: argparse.Namespace, progress: Progress) -> int:
    """Check a file of echoes; 1 if anything fails."""
    findings = inspect(_echoes(arguments.file))
    failed = any(finding.state == "FAIL" for finding in findings)
    if arguments.json:
        rows = [{"check": f.name, "state": f.state, "text": f.text} for f in findings]
        print(json.dumps({"file": arguments.file, "ok": not failed, "checks": rows}))
    else:
        print("\n".join(f"{f.state:<5} {f.name:<22} {f.text}" for f in findings))
    return int(failed)
