"""Every method on every scene, its error beside its run time: `python -m bench.report` writes docs/error-vs-time.md.

    python -m bench.report            seven scenes, eight with measured data; within 40 minutes on two cores
    python -m bench.report --quick    six of them, small, and fewer settings; in 2 minutes

What runs and how it is judged is `pysas.comparison`'s; the scenes are `bench.report_scenes`'. The last is the public Gotcha
data, where the environment variable PYSAS_DATA names the folder that holds them.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import platform
import signal
import sys
import time
from functools import partial
from pathlib import Path

import numba
import numpy as np

import pysas
from bench.backprojection import kernels
from bench.plain_loop import plain_loop
from bench.report_scenes import C, measured, scenes, tiny
from bench.report_text import document, worst
from pysas import comparison

# pixels, s and runs, by whether the run is quick
RANDOM, LIMIT, ROUNDS = {True: 200, False: 400}, {True: 3.0, False: 12.0}, {True: 2, False: 3}
ENGINES = {"backproject": pysas.backproject, "ffbp": pysas.ffbp}


def on(isa, call):
    """`call`, with PYSAS_ISA set meanwhile."""
    if isa is None:
        return call

    def run():
        before = os.environ.get("PYSAS_ISA")
        os.environ["PYSAS_ISA"] = isa
        try:
            return call()
        finally:
            if before is None:
                del os.environ["PYSAS_ISA"]
            else:
                os.environ["PYSAS_ISA"] = before

    return run


def plain(scene, threads):
    """The yardstick's image, as an `Image`."""
    echoes, grid = scene.echoes, scene.grid
    if np.ptp(echoes.start_time) > 0:
        raise ValueError("records start at different times: expected one")
    numba.set_num_threads(threads)
    axes = grid.axes["x"], grid.axes["y"]
    t0 = float(echoes.start_time[0])
    image = plain_loop(echoes.traces, echoes.tx, echoes.receivers, *axes, 0.0, echoes.fs, echoes.fc, echoes.c, t0)
    return pysas.Image(image, grid, pysas.Report("plain loop"), echoes.fc, echoes.c)


def methods(scene, threads, quick):
    """Calls by (method, setting); each gives an image."""
    echoes, grid = scene.echoes, scene.grid
    names = kernels()
    best = names[min(1, len(names) - 1)][0]
    found = {}
    for method, engine in ENGINES.items():
        for name, backend, isa in names:
            for tol in comparison.TOLS if not quick or name == best else (1e-3,):
                call = partial(engine, echoes, grid, tol, threads=threads, backend=backend)
                found[f"{method}, {name}", f"tol {tol:.0e}"] = on(isa, call)
    found |= comparison.methods(echoes, grid, (), raw=scene.raw, half_angle=scene.beam, fewer=quick, threads=threads)
    found["plain loop", "linear"] = partial(plain, scene, threads)
    return found


def memory(call):
    """Growth of the resident set in one run, MB, measured in a forked copy of this process; None where /proc cannot tell."""
    if not Path("/proc/self/clear_refs").exists():
        return None

    def resident(name):
        line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
        return int(line.split()[1]) / 1024

    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(120)  # a child that hangs ends
            Path("/proc/self/clear_refs").write_text("5")  # the high-water mark starts anew
            before = resident("VmRSS")
            call()
            os.write(write, str(resident("VmHWM") - before).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return float(text) if text else None


def measure(scene, threads, quick):
    """A scene's comparison, with the memory of what is not slow, but for quick runs."""
    limit = LIMIT[quick]
    calls = methods(scene, threads, quick)
    for (method, _), call in calls.items():
        if "numba" in method:  # the tiny scenes may not have compiled all that this one needs
            call()
    found = comparison.compare(
        scene.echoes, calls, target=scene.target, half=scene.half, count=RANDOM[quick], rounds=ROUNDS[quick], limit=limit
    )
    # libgomp, which the plain loop runs on, does not survive a fork
    rows = [
        row if quick or row.method == "plain loop" or row.seconds > limit / 4
        else dataclasses.replace(row, memory=memory(calls[row.method, row.setting]))
        for row in found.rows
    ]  # fmt: skip
    return dataclasses.replace(found, rows=tuple(rows))


def machine(threads):
    config = pysas.show_config("dict")
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return {**config, "model": model, "cores": os.cpu_count(), "threads": threads, "load": list(os.getloadavg())}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small scenes, in 2 minutes")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--docs", default="docs", metavar="FOLDER", help="where error-vs-time.md and .jpg go")
    parser.add_argument("--json", default="build/error-vs-time.json", metavar="FILE")
    args = parser.parse_args()
    clock = time.perf_counter()
    host = machine(args.threads)
    for scene in tiny(args.threads):
        for (method, _), call in methods(scene, args.threads, args.quick).items():
            if not method.endswith(("frame", "ftcg")):  # slow even here, and little of them is compiled
                with contextlib.suppress(ValueError):
                    call()
    print(f"compiled after {time.perf_counter() - clock:.0f} s", flush=True)
    found, about = {}, {}
    for name, make in scenes(args.quick).items():
        scene = make(args.threads)
        found[name], about[name] = measure(scene, args.threads, args.quick), scene.about
        print(f"{name}: {len(found[name].rows)} rows after {time.perf_counter() - clock:.0f} s", flush=True)
    if not measured():
        print("measured Gotcha: left out, PYSAS_DATA does not name its folder", flush=True)
    result = {
        "quick": args.quick, "c": C, "machine": host, "seconds": time.perf_counter() - clock,
        "scenes": {name: {"about": about[name], **dataclasses.asdict(scene)} for name, scene in found.items()},
    }  # fmt: skip
    for folder in (Path(args.docs), Path(args.json).parent):
        folder.mkdir(parents=True, exist_ok=True)
    Path(args.json).write_text(json.dumps(result, indent=1), encoding="utf-8")
    text = document(found, about, host, result["seconds"], args.quick, RANDOM[args.quick], LIMIT[args.quick], measured())
    Path(args.docs, "error-vs-time.md").write_text(text, encoding="utf-8")
    drawn = comparison.figure({f"{name}, {about[name]}": scene for name, scene in found.items()})
    drawn.savefig(Path(args.docs, "error-vs-time.jpg"), dpi=80, pil_kwargs={"quality": 60, "optimize": True})
    if worst(found) > 1:
        sys.exit(f"an engine's error is {worst(found):.2f} of the one asked for")


if __name__ == "__main__":
    main()
