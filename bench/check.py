"""Ratios of speeds that must not fall: `python -m bench.check` measures them and compares them with bench/ratios.json.

Two calls that share a machine slow down together, so that their ratio holds where seconds do not: medians of interleaved
runs, one thread. A ratio below 0.6 of the one stored for the same instruction set fails: what is stored was measured on one
machine, and others differ in caches and vector units by that much. One that falls is measured again, up to twice, and its
best counts: what another program on the machine takes away comes and goes, what the code takes stays. `--write` stores what
is measured.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numba
import numpy as np

import pysas
from bench.factorised import stripmap
from bench.plain_loop import plain_loop
from bench.scenes import random_stripmap
from bench.survey import NEAR, PIXEL, SWATH, recorded

STORED = Path(__file__).with_name("ratios.json")
LEAST = 0.6
ROUNDS = 5
TRIES = 3


def seconds(calls):
    """Median seconds of each call, interleaved, after a warm-up."""
    for call in calls:
        call()
    found = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, times in zip(calls, found, strict=True):
            clock = time.perf_counter()
            call()
            times.append(time.perf_counter() - clock)
    return [float(np.median(times)) for times in found]


def against_plain(backend):
    """How many times faster than the loop a user would write first; the loop gets an eighth of the pings."""
    echoes, grid = random_stripmap(256, 2048, 256)
    few, _ = random_stripmap(32, 2048, 256)
    numba.set_num_threads(1)
    x, y = grid.axes["x"], grid.axes["y"]
    loop, engine = seconds(
        [
            lambda: plain_loop(few.traces, few.tx, few.receivers, x, y, 0.0, few.fs, few.fc, few.c, few.t0),
            lambda: pysas.backproject(echoes, grid, 1e-3, threads=1, backend=backend),
        ]
    )
    return 8 * loop / engine


def tree():
    """Trees over direct sums at 1e-3, plans apart."""
    echoes, grid = stripmap(1024, 512, 1024)
    plans = [pysas.plan(echoes, grid, 1e-3, method, threads=1) for method in ("backprojection", "ffbp")]
    direct, factorised = seconds([lambda plan=plan: plan(echoes.data) for plan in plans])
    return direct / factorised


def survey():
    """Trees over direct sums at 1e-2 on some pings of the survey, plans apart."""
    echoes = recorded(32, 100, slice(40, 52))
    x = echoes.tx[:, 0].mean() + PIXEL * np.arange(-160, 160)
    grid = pysas.Grid.plane(x, np.arange(NEAR, NEAR + SWATH, PIXEL))
    plans = [pysas.plan(echoes, grid, 1e-2, method, threads=1) for method in ("backprojection", "ffbp")]
    direct, factorised = seconds([lambda plan=plan: plan(echoes.data) for plan in plans])
    return direct / factorised


def weights():
    """Unweighted over uniform-angle sums, plans apart."""
    echoes, grid = random_stripmap(256, 2048, 512)
    plans = [pysas.plan(echoes, grid, 1e-3, "backprojection", threads=1, weights=w) for w in (None, "uniform-angle")]
    plain, even = seconds([lambda plan=plan: plan(echoes.data) for plan in plans])
    return plain / even


def measured():
    ratios = {"numba to plain loop": against_plain("numba")}
    if pysas.show_config("dict")["extension"] != "not built":
        ratios |= {
            "C++ to plain loop": against_plain("cpp"),
            "ffbp to backproject": tree(),
            "survey: the same": survey(),
            "plain to uniform-angle": weights(),
        }
        ratios["C++ to numba"] = ratios["C++ to plain loop"] / ratios["numba to plain loop"]
    return ratios


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="store what is measured instead of comparing")
    args = parser.parse_args()
    config = pysas.show_config("dict")
    isa = "numba" if config["extension"] == "not built" else config["isa"]
    found, every = measured(), json.loads(STORED.read_text())
    if args.write:
        every[isa] = {name: round(value, 2) for name, value in found.items()}
        STORED.write_text(json.dumps(every, indent=2) + "\n")
    if isa not in every:
        sys.exit(f"no ratios are stored for {isa}: --write stores {found}")
    stored = every[isa]
    for _ in range(TRIES - 1):
        if all(value >= LEAST * stored[name] for name, value in found.items()):
            break
        found = {name: max(value, found[name]) for name, value in measured().items()}
    bad = [name for name, value in found.items() if value < LEAST * stored[name]]
    for name, value in found.items():
        print(f"{isa} {name:24s} {value:6.2f}  stored {stored[name]:6.2f}  {'FELL' if name in bad else 'ok'}")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
