"""A survey's machinery beside the engine alone: `python -m bench.scale` prints times, ratios and peak memory.

The reference survey of `bench.survey` (32 receivers, 150 m of swath, pixels of 2.5 cm) as a store of echoes on disk. Three ways
through the same strip take turns: `pysas.Strip` from pings in memory, whose images are dropped (the engine alone);
`pysas.survey.run` from the store into a store, in this process; and the same by two worker processes of one thread each. The
line is imaged twice in a run, as two strips, so that both workers have something to do. Ratios are of medians of times: the
pings are the same, while tiles and images, all of 20 m, begin at other places. With --long M a line of so many metres, whose
noise repeats itself, is written and imaged by a process of its own in pixels of 5 cm, and the peak of its memory is told.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pysas
from bench.survey import NEAR, PIXEL, SWATH, pings_for, recorded

TILE = 20.0
OPTIONS = {"swath": (NEAR, NEAR + SWATH - PIXEL), "z": 0.0, "side": "port", "tile": TILE}


def write_line(path, receivers, length, repeating=False):
    """A line of echoes of so many metres; returns its bytes."""
    pings, noise = pings_for(receivers, length)[0], None
    with pysas.EchoWriter(path, int16=True) as writer:
        for first in range(0, pings, 16):
            some = slice(first, min(first + 16, pings))
            echoes = recorded(receivers, pings, some) if noise is None else recorded(receivers, pings, some, data=noise)
            noise = echoes.data if repeating else None
            writer.append(echoes)
    return sum(file.stat().st_size for file in Path(path).rglob("*") if file.is_file())


def engine_alone(path, tol, threads):
    """Seconds of a strip whose pings are in memory."""
    with pysas.open_echoes(path) as store:
        pings = list(store.blocks())
    y = NEAR + PIXEL * np.arange(round(SWATH / PIXEL))
    strip = pysas.Strip(y, PIXEL, TILE, tol=tol, threads=threads)
    clock = time.perf_counter()
    pixels = sum(image.data.size for _ in range(2) for image in strip.stream(pings))
    return time.perf_counter() - clock, pixels


def through_stores(path, folder, tol, threads, client=None, times=2, pixel=PIXEL):
    """Seconds of `pysas.survey.run`, its plan included."""
    clock = time.perf_counter()
    plan = pysas.survey.plan([path] * times, tol=tol, threads=threads, pixel=pixel, **OPTIONS)
    report = pysas.survey.run(plan, f"{folder}/images.zarr", client=client, threads=threads, overwrite=True)
    seconds = time.perf_counter() - clock
    assert report.complete
    return seconds, sum(one.pixels for one in report.made), plan.memory


def cluster(count):
    import distributed

    return distributed.LocalCluster(
        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1", memory_limit=0
    )


def compare(folder, receivers, length, tol, rounds):
    """Rates of the three ways, in pixels a second."""
    import distributed

    path = f"{folder}/line.zarr"
    size = write_line(path, receivers, length)
    covered = pings_for(receivers, length)[1]
    print(
        f"{receivers} receivers, {length:g} m, {size / 1e9:.2f} GB of echoes in int16, tol {tol:g}; {os.cpu_count()} processors"
    )
    found = {"engine alone": [], "survey, this process": [], "survey, two workers": []}
    with cluster(2) as here, distributed.Client(here) as client:
        for _ in range(rounds):
            found["engine alone"].append(engine_alone(path, tol, 2))
            found["survey, this process"].append(through_stores(path, folder, tol, 2))
            found["survey, two workers"].append(through_stores(path, folder, tol, 1, client))
    print("| way | s, median | pixels/s | real-time factor | speed over the engine's | over this process's |")
    print("|---" * 6 + "|")
    times = {}
    for way, runs in found.items():
        times[way] = seconds = float(np.median([run[0] for run in runs]))
        ratios = [f"{times[other] / seconds:.2f}" for other in list(found)[:2] if other in times]
        print(f"| {way} | {seconds:.2f} | {runs[0][1] / seconds:.3g} | {2 * covered / seconds:.1f} | {' | '.join(ratios)} |")


def long_line(folder, receivers, length, tol):
    """Peak memory of a process that images a long line."""
    path = f"{folder}/long.zarr"
    size = write_line(path, receivers, length, repeating=True)
    code = (
        "import bench.scale, resource; "
        f"s, n, m = bench.scale.through_stores({path!r}, {folder!r}, {tol!r}, 2, times=1, pixel=0.05); "
        "print(s, n, m, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    seconds, pixels, predicted, peak = map(float, answer.split())
    print(
        f"{length:g} m, {size / 1e9:.1f} GB of echoes: {seconds:.0f} s, {pixels:.3g} pixels, {pixels / seconds:.3g} pixels/s, "
        f"peak memory {peak / 1e6:.0f} MB, predicted {predicted / 1e6:.0f} MB"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--receivers", type=int, default=32)
    parser.add_argument("--length", type=float, default=400.0, help="of the line, m")
    parser.add_argument("--tol", type=float, default=1e-2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--long", type=float, default=0.0, help="of a line for the peak memory, m")
    parser.add_argument("--folder", help="for stores, which are removed (default: a temporary one)")
    args = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="pysas-", dir=args.folder)
    try:
        if args.length:
            compare(folder, args.receivers, args.length, args.tol, args.rounds)
        if args.long:
            long_line(folder, args.receivers, args.long, args.tol)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
