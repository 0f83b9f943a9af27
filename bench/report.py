"""Every method on every scene, its error beside its run time: `python -m bench.report` writes docs/error-vs-time.md.

    python -m bench.report            six scenes; within 40 minutes on two cores
    python -m bench.report --quick    the same scenes, small, and fewer settings; within 5 minutes

Runs are interleaved, after a first run that is not counted. Error and responses are against `pysas.reference.exact` on the
same pixels: cuts through the target and random ones among the points (`bench.report_scenes`).
"""

import argparse
import contextlib
import json
import os
import platform
import signal
import time
import warnings
from functools import partial
from pathlib import Path

import numba
import numpy as np

import pysas
from bench.backprojection import kernels
from bench.plain_loop import plain_loop
from bench.report_scenes import C, scenes, tiny
from bench.report_text import document, figure

TOLS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
ENGINES = {"backproject": pysas.backproject, "ffbp": pysas.ffbp}


class TooLong(Exception):
    """A run passed its limit."""


@contextlib.contextmanager
def at_most(seconds):
    """Raise `TooLong` from what runs longer; all methods poll for signals as they do for Ctrl-C."""

    def stop(*_):
        raise TooLong(f"stopped after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


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
    numba.set_num_threads(threads)
    axes = grid.axes["x"], grid.axes["y"]
    t0 = float(echoes.start_time[0])
    image = plain_loop(echoes.traces, echoes.tx, echoes.receivers, *axes, 0.0, echoes.fs, echoes.fc, echoes.c, t0)
    return pysas.Image(image, grid, pysas.Report("plain loop"), echoes.fc, echoes.c)


def methods(scene, threads, quick):
    """Calls by (method, setting); each gives an image."""
    echoes, grid, reference = scene.echoes, scene.grid, pysas.reference
    names = kernels()
    best = names[min(1, len(names) - 1)][0]
    found = {}
    for method, engine in ENGINES.items():
        for name, backend, isa in names:
            for tol in TOLS if not quick or name == best else (1e-3,):
                call = partial(engine, echoes, grid, tol, threads=threads, backend=backend)
                found[f"{method}, {name}", f"tol {tol:.0e}"] = on(isa, call)
    settings = [("sinc", 2), ("cubic", 2), ("linear", 2), ("linear", 8)]
    for interpolation, padding in settings if quick else [*settings, ("linear", 1), ("linear", 4)]:
        found["omega-k", f"{interpolation}, zp {padding}"] = partial(
            reference.omega_k, echoes, interpolation=interpolation, zero_padding=padding, weight="backprojection",
            threads=threads,
        )  # fmt: skip
    found["range-Doppler", "sinc"] = partial(reference.range_doppler, echoes, threads=threads)
    found["range-Doppler", "linear"] = partial(reference.range_doppler, echoes, interpolation="linear", threads=threads)
    found["chirp scaling", "raw echoes"] = partial(reference.chirp_scaling, scene.raw, threads=threads)
    for angle in (45,) if quick else (15, 45, 65):
        found["one-way", f"{angle} degrees"] = partial(
            reference.one_way, echoes, grid, angle=angle, weight="backprojection", half_angle=scene.beam, threads=threads
        )
    for error in (1e-1,) if quick else (1e-1, 1e-2):
        found["fourier_image, nufft", f"error {error:.0e}"] = partial(
            reference.fourier_image, echoes, grid, "nufft", error=error, threads=threads
        )
    found["plain loop", "linear"] = partial(plain, scene, threads)
    return found


class Answers:
    """The exact sum on the sampled pixels of each grid that turns up; methods that share a grid share its pixels."""

    def __init__(self, scene, count):
        self.scene, self.count, self.known = scene, count, {}

    def of(self, grid):
        key = tuple(np.round(axis, 9).tobytes() for axis in grid.axes.values())
        if key not in self.known:
            parts = self.scene.pixels(grid, self.count)
            pixels = np.concatenate(parts)
            self.known[key] = parts, pixels, *pysas.reference.exact(self.scene.echoes, grid, pixels)
        return self.known[key]


def shape(values, parts, grid):
    """IRW (m) and PSLR (dB) along x and y of sampled `values`; None where there is no main lobe to measure."""
    found = {"irw": [], "pslr": []}
    for begin, part, name in ((0, parts[0], "x"), (len(parts[0]), parts[1], "y")):
        axis, cut = grid.axes[name], values[begin : begin + len(part)]
        try:
            width, side = pysas.metrics.irw(cut, abs(axis[1] - axis[0])), pysas.metrics.pslr(cut)
        except ValueError:
            width = side = None
        found["irw"].append(width)
        found["pslr"].append(side)
    return found


def judged(method, image, answers):
    """Error, peak loss and response of an image against the exact sum on the same pixels."""
    parts, pixels, exact, level = answers.of(image.grid)
    values = image.data.ravel()[pixels].astype(complex)
    fitted = method in ("range-Doppler", "chirp scaling")
    if fitted:  # peaks grow as sqrt(r), those of the sum as r; the factor itself is free
        values *= np.sqrt(np.abs(image.grid.axes["y"][pixels // image.grid.shape[1]]))
        values *= np.vdot(values, exact) / np.vdot(values, values)
    peak = len(parts[0]) // 2
    return {
        "error": pysas.metrics.relative_error(values, exact, level), "fitted": fitted,
        "loss": float(20 * np.log10(np.abs(exact[peak]) / np.abs(values[peak]))), "share": image.report.factorised_share,
        "pixels": int(image.data.size), **shape(values, parts, image.grid),
    }  # fmt: skip


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


def timed(call):
    clock = time.perf_counter()
    image = call()
    return image, time.perf_counter() - clock


def measure(scene, threads, quick, rounds, limit):
    """Rows of what ran, and why the others did not."""
    answers = Answers(scene, 200 if quick else 400)
    rows, left_out, warned, calls = [], {}, {}, methods(scene, threads, quick)
    for (method, setting), call in list(calls.items()):
        if "numba" in method:  # the tiny scenes may not have compiled all that this one needs
            call()
        try:
            with at_most(limit), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                image, first = timed(call)
        except (ValueError, TooLong) as error:
            left_out[f"{method}, {setting}"] = str(error)
            del calls[method, setting]
            continue
        if caught:
            warned[f"{method}, {setting}"] = "; ".join(dict.fromkeys(str(w.message) for w in caught))
        rows.append({"method": method, "setting": setting, "first": first, **judged(method, image, answers)})
        del image
    times = [[] for _ in rows]
    for _ in range(rounds):
        for row, spent, call in zip(rows, times, calls.values(), strict=True):
            if spent and row["first"] > limit / 4:
                continue  # once is enough of what is slow
            image, seconds = timed(call)
            spent.append((seconds, image.report.prepare_seconds, image.report.sum_seconds))
            del image
    for row, spent, call in zip(rows, times, calls.values(), strict=True):
        total, prepare, summed = np.array(spent).T
        row |= {
            "seconds": float(np.median(total)), "least": float(total.min()), "most": float(total.max()), "runs": len(total),
            "prepare": float(np.median(prepare)), "sum": float(np.median(summed)),
        }  # fmt: skip
        row["terms_per_second"] = scene.traces * row["pixels"] / row["seconds"]
        # libgomp, which the plain loop runs on, does not survive a fork
        row["memory"] = None if row["method"] == "plain loop" or row["first"] > limit / 4 else memory(call)
    parts, _, exact, _ = answers.of(scene.grid)
    return {"about": scene.about, "traces": scene.traces, "samples": scene.echoes.n_sample, "grid": list(scene.grid.shape),
            "exact": shape(exact, parts, scene.grid), "rows": rows, "left_out": left_out, "warned": warned}  # fmt: skip


def machine(threads):
    config = pysas.show_config("dict")
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return {**config, "model": model, "cores": os.cpu_count(), "threads": threads, "load": list(os.getloadavg())}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small scenes, within 5 minutes")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--docs", default="docs", metavar="FOLDER", help="where error-vs-time.md and .jpg go")
    parser.add_argument("--json", default="build/error-vs-time.json", metavar="FILE")
    args = parser.parse_args()
    clock = time.perf_counter()
    host = machine(args.threads)
    for scene in tiny(args.threads):
        for call in methods(scene, args.threads, args.quick).values():
            with contextlib.suppress(ValueError):
                call()
    print(f"compiled after {time.perf_counter() - clock:.0f} s", flush=True)
    found = {}
    for name, make in scenes(args.quick).items():
        found[name] = measure(make(args.threads), args.threads, args.quick, 3, 6.0 if args.quick else 40.0)
        print(f"{name}: {len(found[name]['rows'])} rows after {time.perf_counter() - clock:.0f} s", flush=True)
    result = {"quick": args.quick, "c": C, "machine": host, "seconds": time.perf_counter() - clock, "scenes": found}
    for folder in (Path(args.docs), Path(args.json).parent):
        folder.mkdir(parents=True, exist_ok=True)
    Path(args.json).write_text(json.dumps(result, indent=1), encoding="utf-8")
    Path(args.docs, "error-vs-time.md").write_text(document(result), encoding="utf-8")
    figure(Path(args.docs, "error-vs-time.jpg"), result)


if __name__ == "__main__":
    main()
