"""Speed of back-projection beside its error and beside the plain Numba loop: `python -m bench.backprojection`.

Rates are terms (ping, channel, pixel) per second, preparation included, medians of interleaved runs after a warm-up;
the error is against `pysas.reference.exact` on sampled pixels of the same image, in the promise's norm. The plain loop is
timed on an eighth of the pings: its time a term does not depend on how many there are.
"""

import argparse
import json
import os
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


def methods(scene, echoes, few, grid, threads, quick, large=False):
    """Calls to time, by (name, tol); `few` is what the plain loop gets."""

    def loop():
        numba.set_num_threads(threads)
        x, y = grid.axes["x"], grid.axes["y"]
        return plain_loop(few.traces, few.tx, few.receivers, x, y, 0.0, few.fs, few.fc, few.c, few.t0)

    found = {("plain loop", None): loop}
    best = kernels()[-1] if len(kernels()) == 1 else kernels()[1]
    for name, backend, isa in kernels():
        if "complex128" in scene:
            tols = (1e-8,) if quick or name == best[0] else ()
        elif name == best[0]:
            tols = SINGLE[:2] if quick else SINGLE[:3] if large else SINGLE
        elif large:
            tols = ()
        else:
            tols = (1e-3,) if quick or not ("moving" in scene or "baseline" in name) else ()
        for tol in tols:
            found[name, tol] = lambda tol=tol, backend=backend, isa=isa: call(echoes, grid, tol, threads, backend, isa)
    return found


def run(pings, samples, pixels, threads, repeats, quick=False, large=False, scenes=SCENES):
    rows = []
    for scene, options in scenes.items():
        channels = options.get("channels", 1)
        echoes, grid = random_stripmap(pings // channels, samples, pixels, **options)
        terms = echoes.n_ping * channels * grid.size
        sampled = np.random.default_rng(0).choice(grid.size, 300, replace=False)
        exact = pysas.reference.exact(echoes, grid, sampled)
        part = echoes.n_ping // 8
        velocity = None if echoes.velocity is None else echoes.velocity[:part]
        few = echoes.replace(data=echoes.data[:part], tx=echoes.tx[:part], rx=echoes.rx[:part], velocity=velocity)
        plain = ("plain loop", None)
        errors = {}
        for count in threads:
            calls = methods(scene, echoes, few, grid, count, quick, large)
            for key, method in calls.items():  # also compiles and warms up
                image = np.asarray(method()).ravel()[sampled]
                answer = pysas.reference.exact(few, grid, sampled) if key == plain else exact
                errors[key] = pysas.metrics.relative_error(image, *answer)
            times = {key: [] for key in calls}
            for _ in range(repeats):
                for key, method in calls.items():
                    clock = time.perf_counter()
                    method()
                    spent = time.perf_counter() - clock
                    times[key].append(spent * echoes.n_ping / part if key == plain else spent)
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


def measured(quick=False):
    """All rows."""
    if quick:
        return run(96, 2048, 512, (1, 2), 3, quick=True)
    large = run(2048, 4096, 2048, (1,), 1, large=True, scenes={"monostatic": {}})
    return run(1024, 4096, 1024, (1, 2), 3) + large


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
    args = parser.parse_args()
    rows = measured(args.quick)
    print(table(rows))
    print(f"\ncall overhead of a small job (64 pings, 128²) with a plan: {1e6 * small_job():.0f} microseconds")
    if args.json:
        Path(args.json).write_text(json.dumps({"config": pysas.show_config("dict"), "rows": rows}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
