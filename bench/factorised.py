"""Fast factorised against direct back-projection at the same tolerance: `python -m bench.factorised` prints the tables.

Echoes are random and band-limited, the hardest case. Both engines run on the same threads in one process, interleaved;
errors are against `pysas.reference.exact` on random pixels. Where an image is too large for a direct sum in reasonable time
its time is that of a strip of its lines, scaled.

    python -m bench.factorised            the cases of the table in docs/ffbp.md
    python -m bench.factorised --growth   time against size, 1024 to 4096 (8192 with --large)
    python -m bench.factorised --sweep    scene x tol: error, time, ratio
    python -m bench.factorised --figures FOLDER   growth.png, difference.png
"""

import argparse
from pathlib import Path

import numpy as np

import pysas
from bench.timing import timed

FS, FC, C, BAND = 40e3, 100e3, 1500.0, 30e3
TOLS = (1e-2, 1e-3, 1e-4)


def random_echoes(tx, farthest, near=24.0, seed=1, sway=True):
    """Random echoes of the band from slant range `near` to beyond `farthest`."""
    samples = int(np.ceil(2 * (farthest - near) / C * FS)) + 400
    rng = np.random.default_rng(seed)
    keep = (np.abs(np.fft.fftfreq(samples)) <= BAND / 2 / FS).astype(np.float32)
    data = np.empty((len(tx), samples), dtype=np.complex64)
    for begin in range(0, len(tx), 256):
        shape = (min(256, len(tx) - begin), samples)
        spectrum = rng.standard_normal(shape, dtype=np.float32) + 1j * rng.standard_normal(shape, dtype=np.float32)
        data[begin : begin + 256] = np.fft.ifft(spectrum * keep)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=2 * near / C, bandwidth=BAND)


def stripmap(pings, height, width, spacing=0.02, pixel=0.02):
    """A swaying straight track at 8 m height; pixels from 40 m across track on."""
    n = np.arange(pings)
    tx = np.stack([(n - pings / 2) * spacing, 0.1 * np.sin(n / 40), 8 + 0.05 * np.sin(n / 57)], axis=1)
    x, y = (np.arange(width) - width / 2) * pixel, 40 + np.arange(height) * pixel
    farthest = float(np.hypot(y[-1], x[-1] - tx[0, 0])) + 4
    return random_echoes(tx, farthest), pysas.Grid.plane(x, y)


def circle(pings, pixels, radius=30.0, pixel=0.02):
    """A closed circle at 8 m height about the image."""
    angle = 2 * np.pi * np.arange(pings) / pings
    tx = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(pings, 8.0)], axis=1)
    x = (np.arange(pixels) - pixels / 2) * pixel
    return random_echoes(tx, radius + 1.5 * x[-1] + 8, near=5.0), pysas.Grid.plane(x, x)


CASES = {
    "stripmap, 2048 pings, 2048 x 2048": (lambda: stripmap(2048, 2048, 2048), 1),
    "circular, 4096 pings, 1024 x 1024": (lambda: circle(4096, 1024), 1),
    "stripmap, 8192 pings, 4096 x 8192": (lambda: stripmap(8192, 4096, 8192), 32),
}


def strip_of(grid, share):
    """Every so many tiles' lines of a plane grid: one part in `share` of it."""
    y = grid.axes["y"]
    tiles = [y[begin : begin + 32] for begin in range(0, y.size, 32 * share)]
    return pysas.Grid.plane(grid.axes["x"], np.concatenate(tiles))


def through(echoes, grid, tol):
    """The image through trees alone, or where that cannot be through as many as the planner will."""
    try:
        return pysas.ffbp(echoes, grid, tol, fallback=False, threads=2)
    except ValueError:
        return pysas.ffbp(echoes, grid, tol, threads=2)


def compare(echoes, grid, tol, share=1, repeats=3, pixels=2000):
    """Medians of sums' and total seconds of both engines, ratios, the factorised image's error and share."""
    chosen = np.random.default_rng(0).choice(grid.size, pixels, replace=False)
    exact = pysas.reference.exact(echoes, grid, chosen)
    part = grid if share == 1 else strip_of(grid, share)
    rows = []
    for _ in range(repeats):
        direct, direct_total = timed(lambda: pysas.backproject(echoes, part, tol, threads=2))
        tree, tree_total = timed(lambda: through(echoes, grid, tol))
        scale = grid.size / part.size
        rows.append([direct.report.sum_seconds * scale, direct_total * scale, tree.report.sum_seconds, tree_total])
    direct_sum, direct_total, tree_sum, tree_total = np.median(rows, axis=0)
    return {
        "direct_sum": direct_sum, "tree_sum": tree_sum, "direct_total": direct_total, "tree_total": tree_total,
        "error": pysas.metrics.relative_error(tree.data.ravel()[chosen], *exact), "share": tree.report.factorised_share,
    }  # fmt: skip


HEADER = (
    "| case | tol | error | direct sum, s | ffbp sum, s | ratio | direct total, s | ffbp total, s | ratio | factorised |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def line(name, tol, r):
    return (
        f"| {name} | {tol:.0e} | {r['error']:.1e} | {r['direct_sum']:.2f} | {r['tree_sum']:.2f} | "
        f"{r['direct_sum'] / r['tree_sum']:.1f} | {r['direct_total']:.2f} | {r['tree_total']:.2f} | "
        f"{r['direct_total'] / r['tree_total']:.1f} | {100 * r['share']:.0f} % |"
    )


def cases(large):
    print(HEADER)
    for name, (make, share) in CASES.items():
        if share > 1 and not large:
            continue
        echoes, grid = make()
        for tol in TOLS:
            print(line(name, tol, compare(echoes, grid, tol, share, repeats=3 if share == 1 else 1)), flush=True)


def growth(sizes, tol=1e-3):
    print("| pings = pixels a side | direct sum, s | ffbp sum, s | ratio |\n|---|---|---|---|")
    found = []
    for n in sizes:
        echoes, grid = stripmap(n, n, n)
        r = compare(echoes, grid, tol, max(1, n // 1024), 1, 200)
        found.append((n, r["direct_sum"], r["tree_sum"]))
        print(f"| {n} | {r['direct_sum']:.2f} | {r['tree_sum']:.2f} | {r['direct_sum'] / r['tree_sum']:.1f} |", flush=True)
    n, direct, tree = np.array(found).T
    exponents = [np.polyfit(np.log(n), np.log(seconds), 1)[0] for seconds in (direct, tree)]
    print(f"exponent of time against size: direct {exponents[0]:.2f}, ffbp {exponents[1]:.2f}")
    return n, direct, tree


def moving(pings=1024, channels=6):
    """Six receivers that move while the echo travels, on a swaying track."""
    start = (-pings * 0.02, 0.0, 0.0)
    track = pysas.tracks.perturbed(
        pings, 0.04, height=8.0, start=start, sway=0.1, heave=0.05, yaw=0.01, correlation=3.0, seed=3
    )  # fmt: skip
    rx = pysas.tracks.array(track, channels, 0.05, offset=(0.2, 0.0, -0.1))
    echoes = random_echoes(np.repeat(track.position, channels, axis=0), 62.0)
    data = echoes.data.reshape(pings, channels, -1)
    return pysas.Echoes(
        data, fs=FS, fc=FC, tx=track.position, rx=rx, velocity=track.velocity, c=C, t0=echoes.t0, bandwidth=BAND
    )  # fmt: skip


def sweep_scenes():
    """Scenes of the tolerance tests, at 1024 pings and 512 x 512 pixels or more."""
    echoes, plane = stripmap(1024, 512, 512)
    x, y = plane.axes["x"], plane.axes["y"]
    hills = pysas.Grid.surface(x, y, 0.3 * np.sin(x / 0.8) * np.cos(y[:, None] / 0.7))
    fan = pysas.Grid.polar(41 + np.arange(512) * 0.02, np.pi / 2 + (np.arange(512) - 256) * 4e-4)
    six = moving()
    n = np.arange(1024)
    far = np.stack([(n - 512) * 0.1, 0.02 * np.sin(n / 40), np.full(1024, 50.0)], axis=1)
    return {
        "stripmap, 1024 pings, 1024²": stripmap(1024, 1024, 1024),
        "stripmap, 1024 pings, 512²": (echoes, plane),
        "6 moving receivers, 1024 pings, 512²": (six, plane),
        "6 moving receivers, height map, 512²": (six, hills),
        "height map, 1024 pings, 512²": (echoes, hills),
        "polar grid, 1024 pings, 512²": (echoes, fan),
        "1 km, 1024 pings, 512²": (random_echoes(far, 1012.0, near=985.0), pysas.Grid.plane(x, 993 + y - y[0])),
        "records' ends, 1024 pings, 512²": (random_echoes(echoes.tx, 45.0, near=41.0), plane),
        "circular, 2048 pings, 512²": circle(2048, 512),
        "wide swath, 1024 pings, 2048 x 256": stripmap(1024, 2048, 256, pixel=0.04),
    }


def sweep(tols):
    print(HEADER)
    for name, (echoes, grid) in sweep_scenes().items():
        for tol in tols:
            print(line(name, tol, compare(echoes, grid, tol, repeats=1, pixels=300)), flush=True)


def figures(folder, sizes):
    from matplotlib import pyplot

    n, direct, tree = growth(sizes)
    figure, axes = pyplot.subplots(figsize=(5, 4), layout="constrained")
    axes.loglog(n, direct, "o-", label="direct, strips scaled")
    axes.loglog(n, tree, "s-", label="ffbp")
    axes.loglog(n, tree[0] * (n / n[0]) ** 2, ":", label="N²")
    axes.set(xlabel="pings = pixels a side", ylabel="seconds of the sum, tol 1e-3, 2 threads")
    axes.legend()
    figure.savefig(Path(folder) / "growth.png", dpi=110)
    pings = 768
    track = pysas.tracks.perturbed(
        pings, 0.02, height=8.0, start=(-7.7, 0.0, 0.0), sway=0.2, heave=0.1, correlation=3.0, seed=2
    )
    rng = np.random.default_rng(3)
    points = np.stack([rng.uniform(-4, 4, 60), rng.uniform(31, 37, 60), np.zeros(60)], axis=1)
    t = 2 * 26 / C + np.arange(1400) / FS
    data = np.zeros((pings, t.size), dtype=np.complex64)
    for point in points:
        tau = 2 * np.linalg.norm(point - track.position, axis=1)[:, None] / C
        data += np.sinc(BAND * (t - tau)) * np.exp(-2j * np.pi * FC * tau)
    echoes = pysas.Echoes(data, fs=FS, fc=FC, tx=track.position, rx=track.position, c=C, t0=t[0], bandwidth=BAND)
    grid = pysas.Grid.plane(np.linspace(-5, 5, 1000), np.linspace(30, 38, 640))
    exact = pysas.backproject(echoes, grid, 1e-3).data
    image = pysas.ffbp(echoes, grid, 1e-3, fallback=False).data
    figure, axes = pyplot.subplots(1, 3, figsize=(13, 4), layout="constrained", sharey=True)
    peak = np.abs(exact).max()
    for ax, part, title in zip(axes, (exact, image, image - exact), ("direct", "ffbp", "difference"), strict=True):
        shown = ax.imshow(
            20 * np.log10(np.abs(part) / peak + 1e-9), extent=(-5, 5, 30, 38), origin="lower", vmin=-100, vmax=0, cmap="magma"
        )
        ax.set(title=title, xlabel="along-track, m")
    axes[0].set_ylabel("across-track, m")
    figure.colorbar(shown, ax=axes, label="dB below the peak")
    figure.savefig(Path(folder) / "difference.png", dpi=90)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--sweep", action="store_true")
    parser.add_argument("--large", action="store_true", help="also 8192 pings")
    parser.add_argument("--figures", metavar="FOLDER")
    args = parser.parse_args()
    sizes = (1024, 2048, 4096, 8192) if args.large else (1024, 2048, 4096)
    if args.figures:
        figures(args.figures, sizes)
    elif args.growth:
        growth(sizes)
    elif args.sweep:
        sweep((1e-1, *TOLS, 3e-5))
    else:
        cases(args.large)


if __name__ == "__main__":
    main()
