"""What leaving out saves: `python -m bench.ablation` prints docs/ablation.md.

Each row images one scene twice: as it is, and written so that the planner cannot see that it needs less. One thread, medians of
interleaved runs after a warm-up.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import pysas
from bench.document import machine, parser, write
from bench.scenes import random_stripmap

C, FS, BAND = 1500.0, 40e3, 30e3
STEP = C / 2 / FS  # m of range a sample
SAMPLED = 100
HEAD = """# What leaving out saves

Written by `python -m bench.ablation --write docs/ablation.md`. Each row images one scene twice: as it is, so that the planner
leaves something out, and written so that it cannot. Pairs are as it is / with nothing left out, on one thread, medians of
interleaved runs after a warm-up: seconds of the sum and of preparing the data as `image.report` has them. Saved are processor
times, median of the runs' own ratios, of an image from its plan and of the whole call with its planning: above 1 is time saved.
Difference: of the two images, all pixels; error: of each against `pysas.reference.exact` on sampled pixels; both in the norm of
`tol`. `tests/test_ablation.py` asserts for small versions that images agree and that plans say what they leave out.

"""
COLUMNS = (
    "left out", "engine", "sum, s", "prepare, s", "image saved, x", "whole saved, x", "terms left out, %", "difference",
    "error", "tol",
)  # fmt: skip
BP, BOTH, ALL = ("backprojection",), ("backprojection", "ffbp"), ("backprojection", "points", "ffbp")


@dataclass(frozen=True)
class Job:
    """What one side of a row images. `part`: what of the image is compared."""

    echoes: pysas.Echoes
    grid: pysas.Grid
    tol: float = 1e-3
    weights: object = None
    method: str | None = None
    fallback: bool = True
    part: object = ...

    def plan(self, method, backend):
        grid = self.grid
        if method == "points":
            method, grid = "backprojection", pysas.Grid.points(grid.coordinates(np.arange(grid.size)))
        method = self.method or method
        return pysas.plan(self.echoes, grid, self.tol, method, 1, backend, self.weights, fallback=self.fallback)


@dataclass(frozen=True)
class Row:
    """An omission. `make(scale)` returns the scene as it is and written otherwise; `says`: a pattern that `explain()` of the
    first plan matches and of the second does not, or None where the share of terms left out tells; `how`: one sentence."""

    name: str
    make: Callable[[int], tuple[Job, Job]]
    says: str | None
    how: str
    methods: tuple[str, ...] = BOTH


def stripmap(scale, channels=1, **options):
    """Twice as many pings as pixels a side; all pixels within every record."""
    return random_stripmap(8 * scale // channels, 1024, 4 * scale, channels=channels, **options)


def band_limited(shape, seed=1):
    """Random data in three quarters of the band, faded at both ends: to be cut and padded without leaving the band."""
    rng = np.random.default_rng(seed)
    keep = np.abs(np.fft.fftfreq(shape[-1])) <= 0.75 * BAND / 2 / FS
    return np.fft.ifft((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) * keep)


def fade(u, width=64):
    """0 for u <= 0, 1 for u >= width, in between the integral of a Kaiser window: its spectrum is 3 kHz wide."""
    ramp = np.cumsum(np.kaiser(257, 12))
    return np.interp(u, np.linspace(0, width, 257), (ramp - ramp[0]) / (ramp[-1] - ramp[0]))


def narrow(pings, samples, near, spacing=0.05, height=5.0, **options):
    """Echoes of a straight track, t0 at `near` m, of `samples` random ones that fade at both ends."""
    x = (np.arange(pings) - pings / 2) * spacing
    tx = np.stack([x, 0 * x, 0 * x + height], axis=1)
    n = np.arange(samples)
    data = band_limited((pings, samples)) * fade(n) * fade(samples - 1 - n)
    return pysas.Echoes(
        data.astype(np.complex64), fs=FS, fc=100e3, tx=tx, rx=tx, c=C, **{"t0": 2 * near / C, "bandwidth": BAND, **options}
    )


def second_root(scale):
    echoes, grid = stripmap(scale)
    return Job(echoes, grid), Job(echoes.replace(rx=echoes.rx + np.array([1e-9, 0, 0])), grid)


def motion(scale):
    echoes, grid = stripmap(scale, channels=2)
    return Job(echoes, grid), Job(echoes.replace(velocity=np.full((echoes.n_ping, 3), 1e-9)), grid)


def view_weights(scale):
    """On a circle so wide that all arcs of view are alike to 2e-4."""
    pings, pixels, radius = 8 * scale, 4 * scale, 2e4
    angle = 2 * np.pi * np.arange(pings) / pings
    tx = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    data = band_limited((pings, 1024)).astype(np.complex64)
    echoes = pysas.Echoes(
        data, fs=FS, fc=100e3, tx=tx, rx=tx, c=C, t0=2 * (radius - 512 * STEP) / C, bandwidth=BAND
    )  # fmt: skip
    axis = (np.arange(pixels) - pixels / 2) * 0.02
    grid = pysas.Grid.plane(axis, axis)
    return Job(echoes, grid), Job(echoes, grid, weights="uniform-angle")


def beam(scale):
    echoes, grid = stripmap(scale)
    return Job(echoes, grid), Job(echoes.replace(beam=pysas.Beam((0, 1, 0), 0.04, 1.6, "cone")), grid)


def out_of_beam(scale):
    """A strip of pixels across the track: what of a trace comes from out of the beam ends at one range, and is faded out."""
    echoes, half_angle, width = narrow(8 * scale, 2560, 8.0, spacing=5 / scale), 0.3, 64
    x = (np.arange(width) - width / 2) * 0.02
    grid = pysas.Grid.plane(x, np.linspace(10, 50, 16 * scale))
    edge = np.hypot(np.abs(echoes.tx[:, 0]) + abs(x[0]), 5.0) / np.sin(half_angle)
    ranges = 8.0 + STEP * np.arange(echoes.n_sample)
    echoes = echoes.replace(data=(echoes.data * fade((ranges - edge[:, None]) / STEP)).astype(np.complex64))
    return Job(echoes.replace(beam=pysas.Beam((0, 1, 0), 0.04, half_angle, "cone")), grid), Job(echoes, grid)


def out_of_window(scale):
    echoes, x = narrow(8 * scale, 512, 30.0), (np.arange(64) - 32) * 0.02
    grid = pysas.Grid.plane(x, np.linspace(22, 62, 16 * scale))
    longer = np.zeros((echoes.n_ping, 3072), np.complex64)
    longer[:, 1024:1536] = echoes.data
    return Job(echoes, grid), Job(echoes.replace(data=longer, t0=2 * (30.0 - 1024 * STEP) / C), grid)


def with_lines(grid, more):
    """The grid with more lines, masked away: (grid, what of the image is the old one)."""
    x, y = grid.axes["x"], grid.axes["y"]
    mask = np.zeros((y.size + len(more), x.size), bool)
    mask[: y.size] = True
    return pysas.Grid.plane(x, np.concatenate([y, more]), mask=mask), slice(0, y.size)


def record(scale):
    """8192 samples, 154 m."""
    echoes, x = narrow(8 * scale, 8192, 10.0, spacing=0.02), (np.arange(64) - 32) * 0.02
    grid = pysas.Grid.plane(x, 50 + 0.02 * np.arange(2 * scale))
    longer, part = with_lines(grid, [20.0, 150.0])
    return Job(echoes, grid), Job(echoes, longer, part=part)


def silent(scale):
    """The second half of the pings begins to record 60 m behind the image, which spans all that the first half recorded."""
    pings, samples = 8 * scale, 1024
    late = np.arange(pings) >= pings // 2
    echoes = narrow(pings, samples, 10.0, spacing=0.01, t0=2 * np.where(late, 90.0, 10.0) / C)
    grid = pysas.Grid.plane((np.arange(64) - 32) * 0.02, np.linspace(2.0, 40.0, 4 * scale))
    longer, part = with_lines(grid, [140.0])
    return Job(echoes, grid), Job(echoes, longer, part=part)


def mask(scale):
    echoes, grid = stripmap(scale)
    wanted = np.zeros(grid.shape, bool)
    wanted[: grid.shape[0] // 2] = True
    masked = pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=wanted)
    return Job(echoes, masked, part=wanted), Job(echoes, grid, part=wanted)


def float64(scale):
    echoes, grid = stripmap(scale, dtype=np.complex128)
    return Job(echoes, grid, 1e-5), Job(echoes, grid, 0.98e-5)


def small(scale):
    echoes, grid = random_stripmap(2 * scale, 1024, 2 * scale)
    return Job(echoes, grid, method="auto"), Job(echoes, grid, method="ffbp", fallback=False)


ROWS = (
    Row("second square root", second_root, "second square root", "Receivers are moved off the transmitter by 1e-9 m.", ALL),
    Row("moving receiver", motion, "receivers' motion", "Two receivers; their velocity is 1e-9 m/s along each axis.", ALL),
    Row(
        "weights of pixels",
        view_weights,
        "weights that differ",
        '`weights="uniform-angle"` on a circle of 20 km radius, where they are 1 to 2e-4.',
        BP,
    ),
    Row(
        "beam",
        beam,
        "beam: none",
        "A beam of 1.6 rad half-angle: it reaches every pixel, but beyond a right angle that is not looked for.",
        ALL,
    ),
    Row(
        "terms out of the beam",
        out_of_beam,
        None,
        "Without the beam; a strip across the track, so that what lies out of the beam ends at one range of each trace, "
        "and all samples before it are 0.",
        BP,
    ),
    Row(
        "terms out of the window",
        out_of_window,
        None,
        "A record that fades to 0 at both ends is continued by zeros over all ranges of the image.",
        BP,
    ),
    Row(
        "samples no pixel needs",
        record,
        r"(9\d|100) % of each record",
        "Two more lines of pixels, masked away, near both ends of a record 154 m long.",
        BP,
    ),
    Row(
        "traces no pixel hears",
        silent,
        "traces: no pixel",
        "Half of the pings record ranges beyond the image; one more line of pixels, masked away, lies there.",
        BP,
    ),
    Row("masked pixels", mask, "masked", "No mask, where the scene as it is masks half of the lines away."),
    Row(
        "float64",
        float64,
        "float64 in the inner loop",
        "`tol` 9.8e-6 instead of 1e-5 with complex128 data: the first that float64 sums. From 1e-5 on these are summed in "
        "float32 too, as complex64 data always are.",
        BP,
    ),
    Row(
        "trees for a small image",
        small,
        "Plan: backprojection",
        '`method="ffbp", fallback=False` instead of "auto"; the whole call, with its plan, is what counts.',
        ("auto",),
    ),
)


def images(jobs, method, backend, rounds):
    """Of each job: plan, image, and (round, 4) seconds of sum and preparation, processor's of the image and of the whole."""
    found = [[] for _ in jobs]
    for _ in range(rounds + 1):
        for job, runs in zip(jobs, found, strict=True):
            begin = time.process_time()
            plan = job.plan(method, backend)
            planned = time.process_time()
            image = plan(job.echoes.data)
            end = time.process_time()
            runs.append((plan, image, (image.report.sum_seconds, image.report.prepare_seconds, end - planned, end - begin)))
    return [(*runs[-1][:2], np.array([seconds for _, _, seconds in runs[1:]])) for runs in found]


def measure(row, method, backend, scale, rounds, pixels=SAMPLED):
    """What a line of the table says, as a dict."""
    jobs = row.make(scale)
    sides = images(jobs, method, backend, rounds)
    errors, parts = [], []
    for job, (_, image, _) in zip(jobs, sides, strict=True):
        index = np.arange(job.grid.size).reshape(job.grid.shape)[job.part].ravel()
        some = np.random.default_rng(0).choice(index, min(pixels, index.size), replace=False)
        exact, level = pysas.reference.exact(job.echoes, job.grid, some)
        errors.append(float(pysas.metrics.relative_error(image.data.ravel()[some], exact, level)))
        parts.append(image.data.ravel()[index])
    level = np.full(parts[1].shape, np.sqrt(np.mean(np.square(level))))
    seconds = np.array([times for _, _, times in sides])
    reports = [image.report for _, image, _ in sides]
    return {
        "name": row.name,
        "engine": engine(method, reports, backend),
        "seconds": np.median(seconds[:, :, :2], axis=1),
        "saved": np.median(seconds[1, :, 2:] / np.maximum(seconds[0, :, 2:], 1e-9), axis=0),
        "left_out": [report.share_left_out for report in reports],
        "said": [None if row.says is None else bool(re.search(row.says, plan.explain())) for plan, _, _ in sides],
        "difference": float(pysas.metrics.relative_error(*parts, level)),
        "errors": errors,
        "tol": max(job.tol for job in jobs),
    }


def engine(method, reports, backend):
    """Its name, with the shares that went through trees."""
    names = {"points": "backprojection, points", "auto": "focus"}
    shares = [f"{100 * report.factorised_share:.0f}" for report in reports]
    trees = f" ({' / '.join(shares)} % in trees)" if method in ("ffbp", "auto") else ""
    return f"{names.get(method, method)}{trees}, {'C++' if backend == 'cpp' else 'Numba'}"


def line(found):
    sum_, prepare = (f"{a:.3f} / {b:.3f}" for a, b in found["seconds"].T)
    cells = (
        found["name"], found["engine"], sum_, prepare, *(f"{saved:.2f}" for saved in found["saved"]),
        " / ".join(f"{100 * share:.0f}" for share in found["left_out"]), f"{found['difference']:.1e}",
        " / ".join(f"{error:.1e}" for error in found["errors"]), f"{found['tol']:.0e}",
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main():
    args = parser(__doc__).parse_args()
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    built = pysas.show_config("dict")["extension"] != "not built"
    for row in ROWS:
        for method in row.methods:
            few = method == "points"  # a term there takes several times as long
            if built:
                lines.append(line(measure(row, method, "cpp", 32 if few else 64, 11)))
            lines.append(line(measure(row, method, "numba", 32, 5)))
    how = "\n".join(f"- {row.name}: {row.how}" for row in ROWS)
    text = HEAD + "\n".join(lines) + f"\n\nMachine: {machine()}.\n\nHow each is switched off:\n\n{how}\n"
    write(text, args.write)


if __name__ == "__main__":
    main()
