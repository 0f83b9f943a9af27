"""The engines on the scene of the README's table of other engines: `python -m bench.peers` prints their rows.

1024 pings of 4096 samples, a crooked track, 100 kHz, 1024 x 1024 pixels of 2 cm. Medians of five interleaved runs of the whole
call after a warm-up; errors are against `pysas.reference.exact` on random pixels.
"""

import time

import numpy as np

import pysas
from bench.scenes import random_stripmap

TOLS, ROUNDS, SAMPLED = (1e-2, 1e-3, 1e-4), 5, 300


def main():
    echoes, grid = random_stripmap(1024, 4096, 1024)
    pixels = np.random.default_rng(0).choice(grid.size, SAMPLED, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    cases = [(engine, tol, threads) for engine in (pysas.backproject, pysas.ffbp) for tol in TOLS for threads in (1, 2)]
    times, errors = {case: [] for case in cases}, {}
    for turn in range(ROUNDS + 1):
        for engine, tol, threads in cases:
            clock = time.perf_counter()
            image = engine(echoes, grid, tol, threads=threads)
            if turn:
                times[engine, tol, threads].append(time.perf_counter() - clock)
            errors[engine, tol] = pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level)
    print("| engine | tol | s, 1 / 2 threads | 1e9 terms/s, 1 / 2 threads | error |\n|---|---|---|---|---|")
    for (engine, tol), error in errors.items():
        one, two = (float(np.median(times[engine, tol, threads])) for threads in (1, 2))
        rates = " / ".join(f"{echoes.n_ping * grid.size / spent / 1e9:.2f}" for spent in (one, two))
        print(f"| {engine.__name__} | {tol:.0e} | {one:.2f} / {two:.2f} | {rates} | {error:.1e} |")


if __name__ == "__main__":
    main()
