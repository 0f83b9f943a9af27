"""The engines on the scene on which other public engines were measured: `python -m bench.peers` prints a table of both.

1024 pings of 4096 samples, a crooked track, 100 kHz, 1024 x 1024 pixels of 2 cm. Medians of five interleaved runs of the whole
call after a warm-up; errors are against `pysas.reference.exact` on random pixels. The others' rows are what was measured of
them once, elsewhere: they are not run here.
"""

import time

import numpy as np

import pysas
from bench.scenes import random_stripmap

TOLS, ROUNDS, SAMPLED = (1e-2, 1e-3, 1e-4), 5, 300
DIRECT = """\
| FastSAR 0.1.8, cubic x8 | 0.39 / 0.71 | 2.5e-5 |
| FastSAR 0.1.8, linear x8 | 0.63 / 1.23 | 1.7e-3 |
| torchbp, Cartesian, linear | 0.60 / 1.03 | 7e-3 |
| PERFECT suite kernel (C, double) | 0.046 / 0.091 | 8.6e-3 |
| ISCE3 inner loop, Knab 8 | 0.016 / 0.032 | 3e-4 |
| sarsolver; grdl-sartoolbox; RITSAR | 0.015; 0.016; 0.014 (1 thread) | 4e-3; 1e-2; 5e-2 |
| plain Numba loop | 0.047 / 0.094 | 8e-3 |"""
FACTORISED = """\
| FastSAR FFBP (auto) | 0.56 / 0.32 | 1.3e-2 |
| torchbp CFBP, 2 stages | 0.76 / 0.41 | 7.1e-3 |
| torchbp FFBP, tuned | 1.7 to 3.3 / 0.9 to 1.8 | 2 to 4 % |"""


def measured(size=1024, samples=4096, rounds=ROUNDS):
    """Median seconds on one and two threads and the error of each engine and tol, and the terms of an image."""
    echoes, grid = random_stripmap(size, samples, size)
    pixels = np.random.default_rng(0).choice(grid.size, SAMPLED, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    cases = [(engine, tol, threads) for engine in (pysas.backproject, pysas.ffbp) for tol in TOLS for threads in (1, 2)]
    times, errors = {case: [] for case in cases}, {}
    for turn in range(rounds + 1):
        for engine, tol, threads in cases:
            clock = time.perf_counter()
            image = engine(echoes, grid, tol, threads=threads)
            if turn:
                times[engine, tol, threads].append(time.perf_counter() - clock)
            errors[engine, tol] = pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level)
    found = {
        (engine.__name__, tol): ([float(np.median(times[engine, tol, threads])) for threads in (1, 2)], error)
        for (engine, tol), error in errors.items()
    }
    return found, echoes.n_ping * grid.size


def text(quick=False):
    """The two tables: our rows as measured now, the others' as they were."""
    found, terms = measured(128, 1024, 1) if quick else measured()
    direct = ["| direct back-projection | 1e9 terms/s, 1 / 2 threads | error |", "|---|---|---|"]
    trees = ["| factorised | seconds, 1 / 2 threads | error |", "|---|---|---|"]
    for (name, tol), ((one, two), error) in found.items():
        rate = name == "backproject"
        values = f"{terms / one / 1e9:.2f} / {terms / two / 1e9:.2f}" if rate else f"{one:.2f} / {two:.2f}"
        (direct if rate else trees).append(f"| **pysas `{name}`, tol {tol:.0e}** | {values} | {error:.1e} |")
    return "\n".join([*direct, DIRECT, "", *trees, FACTORISED])


if __name__ == "__main__":
    print(text())
