"""Speed of back-projection beside its error and beside the plain Numba loop: `python -m bench.backprojection`.

Rates are terms (ping, channel, pixel) per second, preparation included, medians of interleaved runs after a warm-up;
the error is against `pysas.reference.exact` on sampled pixels of the same image, in the promise's norm.
"""

import argparse
import json
import time

import numba
import numpy as np

import pysas
from bench.plain_loop import plain_loop
from bench.scenes import random_stripmap


def run(pings, samples, pixels, tols, threads, repeats):
    rows = []
    for name, options in (("monostatic", {}), ("6 receivers, moving", {"channels": 6, "moving": True})):
        channels = options.get("channels", 1)
        echoes, grid = random_stripmap(pings // channels, samples, pixels, **options)
        terms = echoes.n_ping * channels * grid.size
        sampled = np.random.default_rng(0).choice(grid.size, 300, replace=False)
        exact, level = pysas.reference.exact(echoes, grid, sampled)

        def loop(echoes=echoes, grid=grid):
            x, y = grid.axes["x"], grid.axes["y"]
            return plain_loop(echoes.traces, echoes.tx, echoes.receivers, x, y, 0.0, echoes.fs, echoes.fc, echoes.c, echoes.t0)

        for count in threads:
            numba.set_num_threads(count)
            methods = {("plain loop", None): loop}
            for tol in tols:
                methods["pysas numba", tol] = lambda tol=tol, echoes=echoes, grid=grid, count=count: (
                    pysas.backproject(echoes, grid, tol, threads=count).data
                )
            errors = {
                key: pysas.metrics.relative_error(np.asarray(method()).ravel()[sampled], exact, level)
                for key, method in methods.items()
            }
            times = {key: [] for key in methods}
            for _ in range(repeats):
                for key, method in methods.items():
                    clock = time.perf_counter()
                    method()
                    times[key].append(time.perf_counter() - clock)
            plain = np.array(times["plain loop", None])
            for key in methods:
                rows.append(
                    {
                        "scene": name,
                        "threads": count,
                        "method": key[0],
                        "tol": key[1],
                        "error": errors[key],
                        "terms_per_second": terms / float(np.median(times[key])),
                        "ratio_to_plain": float(np.median(plain / np.array(times[key]))),
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


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small scene, under a minute")
    parser.add_argument("--json", metavar="FILE", help="also write the rows there")
    args = parser.parse_args()
    if args.quick:
        rows = run(96, 2048, 512, (1e-2, 1e-3), (1, 2), 3)
    else:
        rows = run(1024, 4096, 1024, (1e-2, 1e-3, 1e-4, 1e-5), (1, 2), 3)
    print(table(rows))
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump({"config": pysas.show_config("dict"), "rows": rows}, file, indent=1)


if __name__ == "__main__":
    main()
