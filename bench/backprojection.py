"""Speed of back-projection beside its error and beside the plain Numba loop: `python -m bench.backprojection`.

Rates are terms (ping, channel, pixel) per second, preparation included, medians of interleaved runs after a warm-up;
the error is against `pysas.reference.exact` on sampled pixels of the same image, in the promise's norm. The plain loop is
timed on an eighth of the pings: its time a term does not depend on how many there are.
"""

import argparse
import json
import os
import re
import time
from pathlib import Path

import numba
import numpy as np

import pysas
from bench.plain_loop import plain_loop
from bench.scenes import random_stripmap

SINGLE = (1e-2, 1e-3, 1e-4, 1e-5)
SCENES = {
    "monostatic": {},
    "6 receivers, moving": {"channels": 6, "moving": True},
    "monostatic, complex128": {"dtype": np.complex128},
}


def kernels():
    """(name, backend, instruction set) of everything this machine runs."""
    extension = pysas.show_config("dict")["extension"]
    sets = [] if extension == "not built" else extension.split(", ")[1:]
    return [("numba", "numba", None)] + [(f"C++ {name}", "cpp", name) for name in reversed(sets)]


def call(echoes, grid, tol, threads, backend, isa):
    """One image, on an instruction set."""
    before = os.environ.pop("PYSAS_ISA", None)
    try:
        if isa is not None:
            os.environ["PYSAS_ISA"] = isa
        return pysas.backproject(echoes, grid, tol, threads=threads, backend=backend).data
    finally:
        os.environ.pop("PYSAS_ISA", None)
        if before is not None:
            os.environ["PYSAS_ISA"] = before


def methods(scene, echoes, grid, threads, quick):
    """Calls to time, by (name, tol)."""

    def loop(pings=echoes.n_ping):
        numba.set_num_threads(threads)
        x, y = grid.axes["x"], grid.axes["y"]
        tx, rx, data = echoes.tx[:pings], echoes.receivers[:pings], echoes.traces[:pings]
        return plain_loop(data, tx, rx, x, y, 0.0, echoes.fs, echoes.fc, echoes.c, echoes.t0)

    found = {("plain loop", None): loop}
    best = kernels()[-1] if len(kernels()) == 1 else kernels()[1]
    for name, backend, isa in kernels():
        if "complex128" in scene:
            tols = (1e-8,) if name != "C++ baseline" else ()
        elif name == best[0]:
            tols = SINGLE[:2] if quick else SINGLE
        else:
            tols = (1e-3,)
        for tol in tols:
            found[name, tol] = lambda tol=tol, backend=backend, isa=isa: call(echoes, grid, tol, threads, backend, isa)
    return found


def run(pings, samples, pixels, threads, repeats, quick=False, scenes=SCENES):
    rows = []
    for scene, options in scenes.items():
        channels = options.get("channels", 1)
        echoes, grid = random_stripmap(pings // channels, samples, pixels, **options)
        terms = echoes.n_ping * channels * grid.size
        sampled = np.random.default_rng(0).choice(grid.size, 300, replace=False)
        exact, level = pysas.reference.exact(echoes, grid, sampled)
        for count in threads:
            calls = methods(scene, echoes, grid, count, quick)
            plain = ("plain loop", None)
            if count == threads[0]:
                errors = {}
            for key, method in calls.items():  # also compiles and warms up
                if key not in errors:
                    errors[key] = pysas.metrics.relative_error(np.asarray(method()).ravel()[sampled], exact, level)
            times = {key: [] for key in calls}
            for _ in range(repeats):
                for key, method in calls.items():
                    clock = time.perf_counter()
                    if key == plain:
                        method(echoes.n_ping // 8)
                        times[key].append((time.perf_counter() - clock) * echoes.n_ping / (echoes.n_ping // 8))
                    else:
                        method()
                        times[key].append(time.perf_counter() - clock)
            plain_times = np.array(times[plain])
            for key in calls:
                rows.append(
                    {
                        "scene": f"{scene}, {pings} x {samples}, {pixels}²",
                        "threads": count,
                        "method": key[0],
                        "tol": key[1],
                        "error": errors[key],
                        "terms_per_second": terms / float(np.median(times[key])),
                        "ratio_to_plain": float(np.median(plain_times / np.array(times[key]))),
                    }
                )
    return rows


def table(rows):
    lines = ["| scene | threads | method | tol | error | 1e9 terms/s | x plain loop |", "|---|---|---|---|---|---|---|"]
    for r in rows:
        tol = "" if r["tol"] is None else f"{r['tol']:.0e}"
        lines.append(
            f"| {r['scene']} | {r['threads']} | {r['method']} | {tol} | {r['error']:.1e} | "
            f"{r['terms_per_second'] / 1e9:.3f} | {r['ratio_to_plain']:.1f} |"
        )
    return "\n".join(lines)


def small_job():
    """Seconds of a small job with a plan, beyond the time of its own sums: median of 50."""
    echoes, grid = random_stripmap(64, 1024, 128)
    plan = pysas.plan(echoes, grid, 1e-3, threads=1)
    times = []
    for _ in range(50):
        clock = time.perf_counter()
        report = plan(echoes.data).report
        times.append(time.perf_counter() - clock - report.prepare_seconds - report.sum_seconds)
    return float(np.median(times))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small scenes, under a minute")
    parser.add_argument("--json", metavar="FILE", help="also write the rows there")
    parser.add_argument("--readme", metavar="FILE", help="replace the table between its bench comments")
    args = parser.parse_args()
    if args.quick:
        rows = run(96, 2048, 512, (1, 2), 3, quick=True)
    else:
        rows = run(1024, 4096, 1024, (1, 2), 3)
        rows += run(2048, 4096, 2048, (1,), 1, scenes={"monostatic": {}})
    text = table(rows)
    print(text)
    print(f"\ncall overhead of a small job (64 pings, 128²) with a plan: {1e6 * small_job():.0f} microseconds")
    if args.json:
        Path(args.json).write_text(json.dumps({"config": pysas.show_config("dict"), "rows": rows}, indent=1), encoding="utf-8")
    if args.readme:
        path = Path(args.readme)
        old = path.read_text(encoding="utf-8")
        new = re.sub(r"(<!-- bench -->\n).*?(\n<!-- /bench -->)", lambda m: m[1] + text + m[2], old, flags=re.S)
        path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
