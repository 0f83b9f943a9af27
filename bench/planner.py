"""Whether the planner chooses well: `python -m bench.planner` prints docs/planner.md.

On every scene and at every `tol` the two engines and `focus` image the same echoes, interleaved, in whole calls that plan,
prepare and sum; medians after a warm-up. The scenes are the report's, more that constants were fitted on, and three that
they were not.
"""

import time

import numpy as np

import pysas
from bench.document import machine, parser, write
from bench.factorised import circle, stripmap
from bench.report_scenes import SMALL, scenes
from bench.scenes import random_stripmap

TOLS = (1e-2, 1e-3, 1e-4)
THREADS, ROUNDS, PIXELS = 2, 5, 200
CALLS = {"backproject": pysas.backproject, "ffbp": pysas.ffbp, "focus": pysas.focus}
HEAD = """# What the planner chooses

Written by `python -m bench.planner --write docs/planner.md`. On each scene `backproject`, `ffbp` and `focus`, which takes
whichever the planner predicts to be the faster, image the same complex64 echoes: whole calls, planning and preparation
included, {threads} threads, medians of {rounds} interleaved runs after a warm-up. **focus / best**: its time over that of the
faster engine; 1.3 is the aim. Constants of `csrc/planning/costs.cpp` were fitted on all scenes but the last three, which took
no part in it: the worst of those fitted is **{fitted:.2f}**, of the three others **{unseen:.2f}**.

Predicted is `plan(...).predicted_seconds`, beside the preparation and sum measured: {direct} of those where `backproject` is
taken, {trees} where `ffbp` is, whose trees' planning it counts and the time measured does not. Error is of `focus` against
`pysas.reference.exact` on {pixels} random pixels, half of them chosen as often as they are bright.

"""
COLUMNS = (
    "scene", "tol", "backproject, s", "ffbp, s", "focus, s", "focus takes", "focus / best", "predicted, s", "measured, s",
    "predicted / measured", "error",
)  # fmt: skip


def height_map():
    """Pixels on a rolling sea bed: no lines of pixels, and delays of their own."""
    echoes, grid = random_stripmap(600, 2048, 400)
    x, y = grid.axes["x"], grid.axes["y"]
    return echoes, pysas.Grid.surface(x, y, 0.3 * np.sin(x[None] / 2) * np.cos(y[:, None] / 3))


FURTHER = {
    "height map": height_map,
    "stripmap of 2048 x 2048": lambda: stripmap(2048, 2048, 2048),
    "32 moving receivers": lambda: random_stripmap(48, 2048, 512, channels=32, moving=True),
    "circle of 30 m": lambda: circle(1024, 512),
    "4 moving receivers": lambda: random_stripmap(200, 2048, 400, channels=4, moving=True),
    "long stripmap, few lines": lambda: stripmap(2048, 128, 2048),
    "small image": lambda: stripmap(1024, 128, 128),
}
NEW = {  # than the constants
    "8 moving receivers, 1024 x 1024": lambda: random_stripmap(128, 2048, 1024, channels=8, moving=True),
    "short track": lambda: stripmap(256, 512, 512),
    "circle of 60 m": lambda: circle(1500, 1024, radius=60.0),
}


def places():
    """Makers of (echoes, grid) by name."""

    def made(make):
        scene = make(THREADS)
        return scene.echoes, scene.grid

    return {name: lambda make=make: made(make) for name, make in scenes(False).items() if name != SMALL} | FURTHER | NEW


def measure(echoes, grid, tol, rounds=ROUNDS, pixels=PIXELS):
    """What a line of the table says, as a dict."""
    seconds = {name: [] for name in CALLS}
    own = []
    for number in range(rounds + 1):
        for name, call in CALLS.items():
            clock = time.perf_counter()
            image = call(echoes, grid, tol, threads=THREADS)
            if number:
                seconds[name].append(time.perf_counter() - clock)
        if number:
            own.append(image.report.prepare_seconds + image.report.sum_seconds)
    # half of them as likely as they are bright: a few bright pixels may hold most of an image's energy
    power = np.abs(image.data.ravel().astype(np.complex128)) ** 2
    likely = 0.5 / grid.size + 0.5 * power / power.sum()
    some = np.random.default_rng(0).choice(grid.size, pixels, p=likely)
    exact, level = pysas.reference.exact(echoes, grid, some)
    weight = 1 / np.sqrt(likely[some])
    plan = pysas.plan(echoes, grid, tol, threads=THREADS)
    return {
        "seconds": {name: float(np.median(times)) for name, times in seconds.items()},
        "takes": "ffbp" if plan.method == "ffbp" else "backproject",
        "predicted": plan.predicted_seconds,
        "own": float(np.median(own)),
        "error": pysas.metrics.relative_error(weight * image.data.ravel()[some], weight * exact, weight * level),
    }


def ratio(found):
    """Time of `focus` over that of the faster engine."""
    seconds = found["seconds"]
    return seconds["focus"] / min(seconds["backproject"], seconds["ffbp"])


def line(name, tol, found):
    seconds = (f"{found['seconds'][call]:.3g}" for call in CALLS)
    cells = (
        name, f"{tol:.0e}", *seconds, found["takes"], f"{ratio(found):.2f}", f"{found['predicted']:.3g}",
        f"{found['own']:.3g}", f"{found['predicted'] / found['own']:.2f}", f"{found['error']:.1e}",
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main():
    args = parser(__doc__).parse_args()
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    fitted, unseen, predicted = [], [], {name: [] for name in ("backproject", "ffbp")}
    for name, make in places().items():
        echoes, grid = make()
        for tol in TOLS:
            found = measure(echoes, grid, tol)
            (unseen if name in NEW else fitted).append(ratio(found))
            predicted[found["takes"]].append(found["predicted"] / found["own"])
            lines.append(line(name, tol, found))
    direct, trees = (f"{min(of):.2f} to {max(of):.2f}" for of in predicted.values())
    head = HEAD.format(
        threads=THREADS, rounds=ROUNDS, pixels=PIXELS, fitted=max(fitted), unseen=max(unseen), direct=direct, trees=trees
    )
    write(f"{head}{chr(10).join(lines)}\n\nMachine: {machine()}.\n", args.write)


if __name__ == "__main__":
    main()
