"""Sathishkumar et al.'s experiment: seven targets imaged by the Fourier algorithms and by both engines, against the exact sum.

The printed parameters contradict each other; these do not: 30 kHz centre, 20 kHz down-chirp of 10 ms, sampled at 30 kHz, a
sonar of 0.22 m (sinc^2 two-way beam of the instantaneous frequency, cut at its first nulls) every 5.5 cm, reference range
100 m, 1500 m/s. Peak loss is 20 log10 of the peak over the exact sum's, times sqrt(range) for the Fourier algorithms (their
images grow as sqrt(r), the sum over pings as r), relative to omega-k with sinc interpolation at the reference range.

    python -m bench.stripmap                  tables of loss and shape: 30 m and 130 m
    python -m bench.stripmap --figure FILE    the figure
    python -m bench.stripmap --speed          all algorithms and both engines on one scene; a 2048 x 2048 omega-k;
                                              compensated tracks
"""

import argparse
import tracemalloc
from functools import partial

import numpy as np

import pysas
from bench.timing import timed

C, FC, BAND, FS, DURATION, LENGTH, R0 = 1500.0, 30e3, 20e3, 30e3, 10e-3, 0.22, 100.0
STEP, SPACING = LENGTH / 4, C / (2 * FS)
EXTENTS = {"30 m": (0, -5, 5, -10, 10, -15, 15), "130 m": (0, -20, 20, -45, 45, -65, 65)}
PULSE = pysas.LFM(FC, -BAND, DURATION)


def survey(offsets, dtype=np.complex64):
    """Raw echoes of unit targets at x = 0 and slant ranges R0 + offset."""
    targets = R0 + np.asarray(offsets, dtype=float)
    steepest = C / (FC - BAND / 2) / LENGTH  # sine of the first null at the lowest frequency
    half = int(np.ceil(1.02 * targets.max() * steepest / np.sqrt(1 - steepest**2) / STEP))
    u = STEP * np.arange(-half, half + 1)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    first = np.floor((targets.min() - 5) / SPACING)
    samples = int(np.ceil(np.hypot(targets.max(), u[-1]) / SPACING - first + DURATION * FS)) + 40
    start = first / FS
    data = np.zeros((u.size, samples), dtype=dtype)
    reach = np.arange(int(DURATION * FS) + 1)
    for target in targets:
        away = np.hypot(target, u)
        sine = u / away
        begin = np.ceil((2 * away / C - start) * FS).astype(int)
        index = begin[:, None] + reach
        t = start + index / FS - 2 * away[:, None] / C
        place = (FC + PULSE.rate * (t - DURATION / 2)) * LENGTH * sine[:, None] / C
        beam = np.where(np.abs(place) < 1, np.sinc(place), 0.0) ** 2
        echo = beam * PULSE.waveform(t) * np.exp(-4j * np.pi * FC / C * away[:, None])
        np.put_along_axis(data, index, (np.take_along_axis(data, index, 1) + echo).astype(dtype), 1)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=start, pulse=PULSE, compressed=False)


def algorithms(raw, threads=None):
    """What is compared, by name; each call gives an image."""
    common = {"reference_range": R0, "threads": threads}
    omega = partial(pysas.reference.omega_k, raw, **common)
    doppler = partial(pysas.reference.range_doppler, raw, **common)
    chirp = partial(pysas.reference.chirp_scaling, raw, **common)
    return {
        "omega-k, sinc, zp 2": omega,
        "omega-k, cubic, zp 2": partial(omega, interpolation="cubic"),
        "omega-k, linear, zp 1": partial(omega, interpolation="linear", zero_padding=1),
        "omega-k, linear, zp 2": partial(omega, interpolation="linear", zero_padding=2),
        "omega-k, linear, zp 4": partial(omega, interpolation="linear", zero_padding=4),
        "omega-k, linear, zp 8": partial(omega, interpolation="linear", zero_padding=8),
        "chirp scaling": chirp,
        "chirp scaling, second order": partial(chirp, higher_order=False),
        "range-Doppler": doppler,
        "range-Doppler, linear migration": partial(doppler, interpolation="linear"),
        "range-Doppler, second order": partial(doppler, secondary="second-order"),
        "range-Doppler, no SRC": partial(doppler, secondary="none"),
    }


def exact_response(echoes, offset):
    """Peak, widths (m) and side-lobe ratios (dB), along-track and range, of the exact sum at a target."""
    along = pysas.Grid.plane(STEP * np.arange(-72, 73), [R0 + offset])
    across = pysas.Grid.plane([0.0], R0 + offset + SPACING / 2 * np.arange(-120, 121))
    cuts = [(pysas.reference.exact(echoes, grid)[0].ravel(), d) for grid, d in ((along, STEP), (across, SPACING / 2))]
    return describe(cuts, float(np.abs(cuts[0][0][72])))


def describe(cuts, peak, place=(0.0, 0.0)):
    widths = [pysas.metrics.irw(values, spacing) for values, spacing in cuts]
    return {"peak": peak, "irw": widths, "pslr": [pysas.metrics.pslr(values) for values, _ in cuts], "place": place}


def response(image, offset):
    """The same of an image, at its own peak near the target, and where that lies from the target (m)."""
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    columns, rows = np.abs(x) < 4.0, np.abs(y - R0 - offset) < 3.0
    grid = pysas.Grid.plane(x[columns], y[rows])
    patch = pysas.Image(image.data[np.ix_(rows, columns)], grid, image.report, image.fc, image.c)
    place = pysas.metrics.peak_position(patch, (0.0, R0 + offset), 0.2)
    cuts = [pysas.metrics.cut(patch, place, axis) for axis in ("x", "y")]
    peak = float(np.abs(cuts[0][0][np.argmin(np.abs(grid.axes["x"]))]))
    return describe(cuts, peak, (place[0], place[1] - R0 - offset))


def table(raw, offsets, threads):
    """The exact sum's responses by offset, and for each algorithm its own with loss (dB) and ratios of widths, or a refusal."""
    echoes = pysas.compress(raw, threads=threads)
    exact = {offset: exact_response(echoes, offset) for offset in offsets}
    found, unit = {}, None
    for name, call in algorithms(raw, threads).items():
        try:
            image = call()
        except ValueError as error:
            found[name] = str(error)
            continue
        found[name] = {offset: response(image, offset) for offset in offsets}
        for offset, r in found[name].items():
            level = r["peak"] / exact[offset]["peak"] * np.sqrt((R0 + offset) / R0)
            unit = level if unit is None else unit
            r["loss"] = 20 * np.log10(level / unit)
            r["ratio"] = [a / b for a, b in zip(r["irw"], exact[offset]["irw"], strict=True)]
    return exact, found


def pair(values, form):
    return " / ".join(format(value, form) for value in values)


def show(extent, threads):
    """Print one line for each algorithm: the worse of the two signs of an offset; shapes at the largest offset."""
    offsets = EXTENTS[extent]
    exact, found = table(survey(offsets), offsets, threads)
    sizes = sorted({abs(offset) for offset in offsets})
    far = sizes[-1]
    print(f"\n{extent}. Exact sum: IRW, cm, and PSLR, dB, along-track / range\n")
    print("| offset, m | IRW | PSLR |\n|---|---|---|")
    for offset, r in exact.items():
        print(f"| {offset:+d} | {pair([100 * w for w in r['irw']], '.2f')} | {pair(r['pslr'], '.1f')} |")
    print(f"\nLoss, dB, by offset; at {far} m: ratio of IRW, PSLR, dB, along-track / range, and error of the peak in range\n")
    print(f"| algorithm | {' | '.join(f'±{s} m' if s else '0' for s in sizes)} | IRW | PSLR | range, mm |")
    print("|---" * (len(sizes) + 4) + "|")
    for name, responses in found.items():
        if isinstance(responses, str):
            print(f"| {name} | refused: {responses} |")
            continue
        worst = [min(r["loss"] for offset, r in responses.items() if abs(offset) == size) + 0.0 for size in sizes]
        end = responses[far]
        shape = f"{pair(end['ratio'], '.2f')} | {pair(end['pslr'], '.1f')} | {1e3 * end['place'][1]:+.1f}"
        print(f"| {name} | {' | '.join(f'{loss:.2f}' for loss in worst)} | {shape} |", flush=True)
    return found


def figure(path, found, threads):
    """Loss against offset, and the target 15 m from the reference range as each algorithm shows it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    offsets = EXTENTS["30 m"]
    raw = survey(offsets)
    plot = Figure(figsize=(11, 6.4), layout="constrained")
    FigureCanvasAgg(plot)
    upper, lower = plot.subfigures(2, 1)
    shown = {
        "omega-k, sinc, zp 2": "o-", "omega-k, linear, zp 1": "v-", "omega-k, linear, zp 2": "s-",
        "omega-k, linear, zp 8": ".-", "chirp scaling": "D-", "chirp scaling, second order": "x:",
        "range-Doppler, no SRC": "+:",
    }  # fmt: skip
    for ax, extent in zip(upper.subplots(1, 2), EXTENTS, strict=True):
        for name, style in shown.items():
            points = sorted((offset, r["loss"]) for offset, r in found[extent][name].items())
            ax.plot(*zip(*points, strict=True), style, label=name, ms=4, lw=1)
        ax.set(xlabel="range from the reference range (100 m), m", ylabel="peak loss, dB", title=f"targets over {extent}")
        ax.set_ylim(-7.5, 0.5)
        ax.grid(alpha=0.3)
    upper.legend(*ax.get_legend_handles_labels(), fontsize=8, loc="outside right upper")
    made = algorithms(raw, threads)
    names = ("omega-k, linear, zp 2", "chirp scaling", "chirp scaling, second order", "range-Doppler, no SRC")
    x = STEP * np.arange(-16, 17)
    exact, _ = pysas.reference.exact(
        pysas.compress(raw, threads=threads), pysas.Grid.plane(x, R0 + 15 + SPACING * np.arange(-20, 21))
    )
    patches = {"exact sum": exact / np.abs(exact).max()}
    for name in names:
        image = made[name]()
        px, y = image.grid.axes["x"], image.grid.axes["y"]
        rows, columns = np.abs(y - R0 - 15) < 20.5 * SPACING, np.abs(px) < 16.5 * STEP
        patches[name] = image.data[np.ix_(rows, columns)] / found["30 m"][name][0]["peak"]
    for ax, (name, patch) in zip(lower.subplots(1, len(patches), sharey=True), patches.items(), strict=True):
        level = 20 * np.log10(np.abs(patch) + 1e-9)
        extent = (x[0], x[-1], 15 - 20 * SPACING, 15 + 20 * SPACING)
        drawn = ax.imshow(level, extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno", interpolation="nearest")
        ax.set_title(name.replace(", second", ",\nsecond").replace(", no", ",\nno").replace(", zp", ",\nzp"), fontsize=9)
        ax.set_aspect("auto")
        ax.set_xlabel("along-track, m")
    lower.axes[0].set_ylabel("range from 100 m, m")
    lower.colorbar(drawn, ax=lower.axes, label="dB")
    plot.savefig(path, dpi=90)


def error_on_targets(image, echoes, fitted):
    """Relative L2 error on random pixels about the targets; `fitted`: after the sqrt(range) law and one factor."""
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    rows = np.flatnonzero(np.min(np.abs(y[:, None] - R0 - np.array(EXTENTS["30 m"])), axis=1) < 0.15)
    columns = np.flatnonzero(np.abs(x) < 0.4)
    chosen = (rows[:, None] * x.size + columns).ravel()
    chosen = np.random.default_rng(0).choice(chosen, min(700, chosen.size), replace=False)
    exact, level = pysas.reference.exact(echoes, image.grid, chosen)
    data = image.data.ravel()[chosen].astype(complex)
    if not fitted:
        return pysas.metrics.relative_error(data, exact, level)
    data *= np.sqrt(y[chosen // x.size])
    return pysas.metrics.relative_error(data * (np.vdot(data, exact) / np.vdot(data, data)), exact)


def speed(threads):
    """Every algorithm and both engines on the scene of 30 m: seconds, and error about the targets."""
    raw = survey(EXTENTS["30 m"])
    echoes = pysas.compress(raw, threads=threads)
    calls = algorithms(raw, threads)
    weighted = partial(pysas.reference.omega_k, echoes, reference_range=R0, weight="backprojection", threads=threads)
    grid = calls["range-Doppler"]().grid
    chosen = {
        "omega-k, sinc, zp 2, weight of back-projection": (weighted, False),
        **{name: (call, True) for name, call in calls.items()},
        "backproject, tol 1e-3": (partial(pysas.backproject, echoes, grid, tol=1e-3, threads=threads), False),
        "ffbp, tol 1e-3": (partial(pysas.ffbp, echoes, grid, tol=1e-3, threads=threads), False),
    }
    print(f"\n{raw.n_ping} pings x {raw.n_sample} samples, complex64, {threads} threads")
    print("\n| algorithm | pixels | seconds | error | factor fitted |\n|---|---|---|---|---|")
    for name, (call, fitted) in chosen.items():
        image, seconds = timed(call, 3, np.median, warm=True)
        error = error_on_targets(image, echoes, fitted)
        shape = " x ".join(map(str, image.data.shape))
        print(f"| {name} | {shape} | {seconds:.2f} | {error:.1e} | {'yes' if fitted else 'no'} |", flush=True)
    points = pysas.Grid.plane(STEP * np.arange(-5, 6), R0 + SPACING * np.arange(-5, 6))
    image, seconds = timed(lambda: pysas.reference.correlation(raw, points), warm=True)
    exact, level = pysas.reference.exact(echoes, points)
    error = pysas.metrics.relative_error(image.data, exact, level)
    print(f"| correlation (slow oracle) | 11 x 11 | {seconds:.2f} | {error:.1e} | no |")
    square(threads)
    motion(threads)


def motion(threads):
    """Compensated tracks through omega-k against back-projection of the track as it was: peaks and image."""
    points = np.array([[0.015, 23.5, 0.0], [0.795, 25.5, 0.0], [-0.615, 27.5, 0.0]])
    print("\n100 kHz, seabed 6 m below; loss of the worst of three peaks, dB, and error of its place, mm\n")
    print("| sway / heave, cm rms | order 1 | order 2 |\n|---|---|---|")
    for sway, heave in ((0, 0), (1, 1), (5, 3), (10, 6), (20, 12)):
        track = pysas.tracks.perturbed(
            300, 0.03, 6.0, start=(-4.485, 0.0, 0.0), sway=sway / 100, heave=heave / 100, correlation=2.0, seed=4
        )
        data = 0
        for point in points:
            raw = pysas.simulate(
                point[None], [1.0], pysas.LFM(100e3, 20e3, 2e-3, "tukey", 0.3), tx=track.position, rx=track.position, fs=40e3,
                duration=16e-3, t0=28e-3, threads=threads,
            )  # fmt: skip
            away = point - track.position
            place = 0.12 * 100e3 / C * away[:, 0] / np.linalg.norm(away, axis=1)
            data = data + raw.data * np.where(np.abs(place) < 1, np.sinc(place) ** 2, 0)[:, None].astype(np.float32)
        raw = raw.replace(data=data)
        echoes = pysas.compress(raw, threads=threads)
        direct = np.abs(pysas.reference.exact(echoes, pysas.Grid.points(points))[0])
        cells = []
        for order in (1, 2):
            made = pysas.reference.motion_compensate(echoes, seabed=0.0, order=order)
            image = pysas.reference.omega_k(made, weight="backprojection", threads=threads)
            loss, off = [], []
            for point, peak in zip(points, direct, strict=True):
                wanted = point[0], made.tx[0, 1] + np.hypot(point[1] - made.tx[0, 1], made.tx[0, 2])
                place = pysas.metrics.peak_position(image, wanted, 0.3)
                values, _ = pysas.metrics.cut(image, place, "x")
                loss.append(20 * np.log10(np.abs(values).max() / peak))
                off.append(1e3 * np.hypot(place[0] - wanted[0], place[1] - wanted[1]))
            cells.append(f"{min(loss):.2f} dB, {max(off):.1f} mm")
        print(f"| {sway} / {heave} | {' | '.join(cells)} |", flush=True)


def square(threads, n=2048):
    """An n x n omega-k: seconds and peak memory."""
    rng = np.random.default_rng(0)
    data = rng.standard_normal((n, 2 * n), dtype=np.float32).view(np.complex64)
    u = STEP * np.arange(n)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    echoes = pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=0.1, bandwidth=BAND)
    print(f"\nomega-k of {n} pings x {n} samples, complex64, zero padding 2, {threads} threads")
    print("\n| interpolation | seconds | peak memory / data |\n|---|---|---|")
    for interpolation in ("sinc", "linear"):
        call = partial(pysas.reference.omega_k, echoes, interpolation=interpolation, threads=threads)
        _, seconds = timed(call, 3, np.median, warm=True)
        tracemalloc.start()
        call()
        peak = tracemalloc.get_traced_memory()[1] / data.nbytes
        tracemalloc.stop()
        print(f"| {interpolation} | {seconds:.2f} | {peak:.1f} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", metavar="FILE")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--threads", type=int)
    args = parser.parse_args()
    if args.speed:
        speed(args.threads or 2)
        return
    found = {extent: show(extent, args.threads) for extent in EXTENTS}
    if args.figure:
        figure(args.figure, found, args.threads)


if __name__ == "__main__":
    main()
