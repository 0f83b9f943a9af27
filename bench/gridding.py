"""The experiments of J. McKay, A. Gelb, V. Monga, R. G. Raj (arXiv:1706.08575) on four test functions, and images of tracks.

The paper's test function, window, sample counts and modes are not known: every row beside its numbers is our choice, Gaussian
window s = 0.7 cut at 4, n modes, PSNR = 10 log10(max |f|^2/mean |f - f_rec|^2) on a grid of 100 x 100, no noise.

    python -m bench.gridding                  PSNR by raster, convergence, windows, preconditioning, a 128 x 128 design
    python -m bench.gridding --imaging        fourier_image against the exact sum and both engines
    python -m bench.gridding --figures DIR    the figures
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import aslinearoperator

import pysas
from bench.gridding_images import imaging, patch_errors
from pysas.reference import Frame, Gaussian, Gridding, KaiserBessel, Sampling, Synthesis, ftcg, pipe_menon, rasters, voronoi

WINDOW, SIZE = Gaussian(), 100
NODES, WEIGHTS = np.polynomial.legendre.leggauss(360)  # for |lambda| up to 130


def function_a(x, y):
    return np.cos(np.pi * x) * np.sin(np.pi * y) + 0.5 * np.cos(3 * np.pi * x - 2 * np.pi * y)


def function_b(x, y):
    return np.exp(np.cos(np.pi * x) + np.sin(np.pi * y)) * (1 + 0.5 * np.cos(2 * np.pi * (x + y)))


def function_c(x, y):
    return np.exp(-((x - 0.2) ** 2 + (y + 0.1) ** 2) / 0.03) + 0.7 * np.exp(-((x + 0.3) ** 2 + (y - 0.3) ** 2) / 0.06)


def function_d(x, y):
    peak = np.exp(4 * (np.cos(np.pi * (x - 0.2)) - 1) + 4 * (np.cos(np.pi * (y + 0.1)) - 1))
    return peak + 0.5 * np.cos(4 * np.pi * x) * np.sin(3 * np.pi * y)


FUNCTIONS = {"A": function_a, "B": function_b, "C": function_c, "D": function_d}

# name: raster, modes, rcond, half-band, what the paper prints for frame and FTCG
EXPERIMENTS = {
    "jitter 30 x 30, n = 13": (rasters.jittered(30), 13, None, 7, (39.79, 25.91)),
    "jitter 15 x 15, n = 6": (rasters.jittered(15), 6, None, 7, None),
    "asterisk 15 x 15, n = 5": (rasters.asterisk(15, 15, 7.0), 5, None, 11, (40.06, 37.48)),
    "asterisk 15 x 15, n = 6": (rasters.asterisk(15, 15, 7.0), 6, 1e-3, 11, None),
    "SAS 45 deg, 15 x 15, n = 5": (rasters.sector(15, 15, np.pi / 4, 7.0, 21.0), 5, 1e-3, 7, (21.04, 23.27)),
    "SAS 60 deg, 30 x 30, n = 8": (rasters.sector(30, 30, np.pi / 3, 8.0, 26.0), 8, 1e-3, 7, None),
}


def samples(function, points):
    """fhat by Gauss-Legendre quadrature."""
    away = [np.exp(-1j * np.pi * np.outer(axis, NODES)) * WEIGHTS / 2 for axis in points.T]
    if len(away) == 1:
        return away[0] @ function(NODES)
    return np.sum((away[0] @ function(NODES[:, None], NODES[None, :])) * away[1], axis=1)


def psnr(true, found):
    return 10 * np.log10(np.max(np.abs(true)) ** 2 / np.mean(np.abs(true - found) ** 2))


def fitted(true, found):
    """Gridding's scale is not its claim: the best scalar, which is a small advantage."""
    return found * (np.vdot(found, true) / np.vdot(found, found))


def methods(points, n, window=WINDOW, rcond=None, r=7):
    """Functions from data to an image, by name."""
    frame = Frame(points, n, window, rcond=rcond)
    phi = Synthesis(frame.sampling.modes, SIZE, window)
    shape = phi.sizes

    def gridded(weights):
        omega = Gridding(points, n, window)
        return lambda data, true: fitted(true, (phi @ (omega @ (weights * data))).reshape(shape))

    def designed(half, **options):
        try:
            made = ftcg.design(points, n, window, half, rcond=rcond, **options)
        except ValueError:
            return None
        return lambda data, true: made.image(data, SIZE)

    density = pipe_menon(points)
    clustered = {"weights": density, "rcond": 1e-2}
    of_clustered = Frame(points, n, window, **clustered)

    def weighted(half):
        made = ftcg.design(points, n, window, half, **clustered)
        return lambda data, true: made.image(data, SIZE)

    return frame, {
        "frame": lambda data, true: (phi @ frame.solve(data).coefficients).reshape(shape),
        "frame, density, rcond 1e-2": lambda data, true: (phi @ of_clustered.solve(data).coefficients).reshape(shape),
        "gridding, Voronoi": gridded(voronoi(points)),
        "gridding, Pipe-Menon": gridded(density),
        "FTCG r = 0 (Eq 17)": designed(0),
        "FTCG Eq 20": designed(r, method="printed", band="index"),
        "FTCG lsq, index": designed(r, band="index"),
        "FTCG lsq, nearest": designed(r),
        "FTCG lsq, nearest, in parts": designed(r, parts=True),
        "FTCG lsq, nearest, density, rcond 1e-2": weighted(r),
        "FTCG joint, index, mu 1e-4": designed(r, method="joint", band="index"),
    }


def experiments():
    axis = -1 + 2 * np.arange(SIZE) / SIZE
    mesh = np.meshgrid(axis, axis, indexing="ij")
    print("\nPSNR, dB, for A / B / C / D\n")
    for name, (points, n, rcond, r, paper) in EXPERIMENTS.items():
        frame, made = methods(points, n, rcond=rcond, r=r)
        low, high = frame.bounds
        printed = "none printed" if paper is None else f"paper: frame {paper[0]}, FTCG {paper[1]}"
        print(f"\n**{name}**, M = {len(points)}, L = {frame.sampling.shape[1]}, band {2 * r + 1}; {printed}.")
        print(f"cond Psi {frame.condition:.3g}, rank {frame.rank}, frame bounds {low:.2g}, {high:.3g}\n")
        print("| method | A | B | C | D |\n|---|---|---|---|---|")
        for label, call in made.items():
            if call is None:
                print(f"| {label} | too large |")
                continue
            levels = [psnr(f(*mesh), call(samples(f, points), f(*mesh))) for f in FUNCTIONS.values()]
            print(f"| {label} | {' | '.join(f'{level:.1f}' for level in levels)} |", flush=True)


def one_dimensional(x):
    return np.exp(np.cos(np.pi * x))


CONVERGENCE = (8, 16, 32, 64, 128)


def convergence(count=8):
    """PSNR (m, method), means over `count` rasters."""
    x = -1 + 2 * np.arange(512) / 512
    true, table = one_dimensional(x), []
    for m in CONVERGENCE:
        rows = []
        for seed in range(count):
            points = rasters.jittered(2 * m + 1, 1, seed=seed)
            data, n = samples(one_dimensional, points), m - 2
            phi = Synthesis((n,), 512, WINDOW)
            row = [psnr(true, fitted(true, phi @ (Gridding(points, n, WINDOW) @ (voronoi(points) * data))))]
            row += [psnr(true, ftcg.design(points, n, WINDOW, r).image(data, 512)) for r in (0, 1, 3, 7, 15)]
            rows.append([*row, psnr(true, phi @ Frame(points, n, WINDOW).solve(data).coefficients)])
        table.append(np.mean(rows, axis=0))
    return np.array(table)


LABELS = ("gridding, Voronoi", "FTCG r = 0", "r = 1", "r = 3", "r = 7", "r = 15", "frame")


def show_convergence(table):
    print("\nConvergence, jitter 1/4 in one dimension, exp(cos pi x), n = m - 2, means of 8 rasters, PSNR in dB\n")
    print(f"| m | {' | '.join(LABELS)} |\n{'|---' * (len(LABELS) + 1)}|")
    for m, row in zip(CONVERGENCE, table, strict=True):
        print(f"| {m} | {' | '.join(f'{value:.1f}' for value in row)} |")


def windows():
    axis = -1 + 2 * np.arange(SIZE) / SIZE
    mesh = np.meshgrid(axis, axis, indexing="ij")
    points = rasters.jittered(30)
    print("\nWindows, jitter 30 x 30, n = 13, PSNR, dB, for A / B / C / D\n")
    print("| window | cond Psi | frame | gridding, Voronoi | FTCG lsq, nearest, r = 7 |\n|---|---|---|---|---|")
    chosen = {
        "Gaussian 0.7 of [-1, 1]": Gaussian(), "Gaussian 0.7 of the line": Gaussian(line=True),
        "Gaussian 0.5 of the line": Gaussian(0.5, line=True), "Kaiser-Bessel, reach 1.2, beta 3": KaiserBessel(1.2, 3.0),
    }  # fmt: skip
    for name, window in chosen.items():
        frame, phi = Frame(points, 13, window), Synthesis((13, 13), SIZE, window)
        omega, made, cells = Gridding(points, 13, window), ftcg.design(points, 13, window, 7), voronoi(points)
        rows = []
        for f in FUNCTIONS.values():
            true, data = f(*mesh), samples(f, points)
            found = (phi @ frame.solve(data).coefficients, phi @ (omega @ (cells * data)), phi @ made.coefficients(data))
            scale = [lambda t, g: g, fitted, lambda t, g: g]
            rows.append([psnr(true, s(true, g.reshape(SIZE, SIZE))) for s, g in zip(scale, found, strict=True)])
        cells_of = [" / ".join(f"{row[i]:.1f}" for row in rows) for i in range(3)]
        print(f"| {name} | {frame.condition:.3g} | {' | '.join(cells_of)} |", flush=True)


def noise():
    """PSNR of D from noisy samples; what a frame amplifies, its singular values bound."""
    axis = -1 + 2 * np.arange(SIZE) / SIZE
    true, rng = function_d(*np.meshgrid(axis, axis, indexing="ij")), np.random.default_rng(0)
    print("\nD from samples with white noise (energy of the samples over that of the noise), PSNR, dB\n")
    print("| raster | method | no noise | 60 dB | 40 dB | 20 dB | 0 dB |\n|---|---|---|---|---|---|---|")
    for name in ("jitter 30 x 30, n = 13", "asterisk 15 x 15, n = 6"):
        points, n, _, r, _ = EXPERIMENTS[name]
        data, phi = samples(function_d, points), Synthesis((n, n), SIZE, WINDOW)
        white = rng.standard_normal((2, len(points)))
        white = (white[0] + 1j * white[1]) * np.linalg.norm(data) / np.linalg.norm(white)
        density, omega = pipe_menon(points), Gridding(points, n, WINDOW)
        made = ftcg.design(points, n, WINDOW, r, weights=density, rcond=1e-2)
        operators = {
            f"frame, rcond {rcond:.0e}": phi @ aslinearoperator(Frame(points, n, WINDOW, rcond=rcond).pseudo_inverse)
            for rcond in (1e-13, 1e-3, 1e-1)
        }
        operators["FTCG lsq, nearest, density"] = phi @ made.operator
        operators["gridding, Pipe-Menon, fitted"] = phi @ omega @ aslinearoperator(np.diag(density))
        for label, operator in operators.items():
            levels = []
            for scale in (0, *(10 ** (-snr / 20) for snr in (60, 40, 20, 0))):
                found = (operator @ (data + white * scale)).reshape(SIZE, SIZE)
                levels.append(psnr(true, fitted(true, found) if "fitted" in label else found))
            print(f"| {name} | {label} | {' | '.join(f'{level:.1f}' for level in levels)} |", flush=True)


def preconditioning():
    """LSMR on the frame to 1e-8, without and with FTCG as a right preconditioner."""
    chosen = {
        "jitter 30 x 30, n = 13": (rasters.jittered(30), 13),
        "jitter 64 x 64, n = 29": (rasters.jittered(64), 29),
        "jitter 1/2, 30 x 30, n = 12": (rasters.jittered(30, jitter=0.5), 12),
        "asterisk 15 x 15, n = 5": (rasters.asterisk(15, 15, 7.0), 5),
        "asterisk 45 x 45, n = 14": (rasters.asterisk(45, 45, 22.0), 14),
        "SAS 45 deg, 15 x 15, n = 4": (rasters.sector(15, 15, np.pi / 4, 7.0, 21.0), 4),
        "SAS 60 deg, 30 x 30, n = 6": (rasters.sector(30, 30, np.pi / 3, 8.0, 26.0), 6),
    }
    print("\nLSMR on Psi c = fhat of random c, to 1e-8: condition of the system, iterations, seconds, error of c\n")
    print("| raster | plain | density weights | FTCG r = 0 | r = 7 | r = 15 | design r = 15, s |")
    print("|---|---|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    for name, (points, n) in chosen.items():
        frame, weighted = Frame(points, n, WINDOW), Frame(points, n, WINDOW, weights=pipe_menon(points))
        count = frame.sampling.shape[1]
        c = rng.standard_normal(count) + 1j * rng.standard_normal(count)
        data, cells = frame.sampling @ c, []
        for r in (None, "density", 0, 7, 15):
            clock = time.perf_counter()
            one = ftcg.design(points, n, WINDOW, r, threads=1) if isinstance(r, int) else None
            spent = time.perf_counter() - clock
            solver = weighted if r == "density" else frame
            system = solver.root[:, None] * solver.sampling.dense
            if one is not None:
                system = system @ (one.gridding.sparse @ one.matrix).toarray()
            s = np.linalg.svd(system, compute_uv=False)[:count]
            clock = time.perf_counter()
            operator = None if one is None else one.operator
            found = solver.solve(data, method="lsmr", accuracy=1e-8, preconditioner=operator, iterations=2000)
            seconds = time.perf_counter() - clock
            error = np.linalg.norm(found.coefficients - c) / np.linalg.norm(c)
            mark = "" if not found.ill_posed else "+"
            cells.append(f"{s[0] / s[-1]:.2g}, {found.iterations}{mark}, {seconds:.2f} s, {error:.0e}")
        print(f"| {name} | {' | '.join(cells)} | {spent:.2f} |", flush=True)


def large(threads):
    """The design and use of 128 x 128 samples."""
    points, n = rasters.jittered(128), 60
    ftcg.design(points[:64], 2, WINDOW, 2, parts=True, threads=1)  # compiles
    clock = time.perf_counter()
    made = ftcg.design(points, n, WINDOW, 7, threads=threads)
    designed = time.perf_counter() - clock
    data, axis = samples(function_a, points), -1 + 2 * np.arange(128) / 128
    made.image(data, 128)
    seconds = []
    for _ in range(5):
        clock = time.perf_counter()
        image = made.image(data, 128)
        seconds.append(time.perf_counter() - clock)
    level = psnr(function_a(*np.meshgrid(axis, axis, indexing="ij")), image)
    print(f"\n128 x 128 samples, n = {n}, band 15, {threads} threads: designed in {designed:.1f} s, applied in "
          f"{1e3 * min(seconds):.1f} to {1e3 * max(seconds):.1f} ms ({level:.1f} dB for A)")  # fmt: skip
    frame = Frame(points, n, WINDOW)
    rng = np.random.default_rng(0)
    c = rng.standard_normal(frame.sampling.shape[1]) * (1 + 0j)
    for label, operator in {"plain": None, "with FTCG r = 7": made.operator}.items():
        clock = time.perf_counter()
        found = frame.solve(frame.sampling @ c, method="lsmr", accuracy=1e-8, preconditioner=operator)
        seconds = time.perf_counter() - clock
        error = np.linalg.norm(found.coefficients - c) / np.linalg.norm(c)
        print(f"LSMR to 1e-8, {label}: {found.iterations} iterations, {seconds:.1f} s, error of c {error:.0e}", flush=True)


def canvas(size, rows, columns, **options):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    plot = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(plot)
    return plot, plot.subplots(rows, columns, **options)


def figures(folder):
    folder.mkdir(parents=True, exist_ok=True)
    plot, ax = canvas((6.4, 4.2), 1, 1)
    styles = ("k--", ":", ".-", "s-", "D-", "v-", "o-")
    for label, style, values in zip(LABELS, styles, convergence().T, strict=True):
        ax.plot(CONVERGENCE, values, style, label=label, ms=4)
    ax.set(xlabel="m (2 m + 1 samples, jitter 1/4)", ylabel="PSNR, dB", xscale="log", title="exp(cos πx), means of 8 rasters")
    ax.set_xticks(CONVERGENCE, [str(m) for m in CONVERGENCE])
    ax.minorticks_off()
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8, loc="center right", bbox_to_anchor=(1, 0.52))
    plot.savefig(folder / "gridding-convergence.jpg", dpi=100)

    shown = ["jitter 15 x 15, n = 6", "asterisk 15 x 15, n = 5", "SAS 45 deg, 15 x 15, n = 5"]
    plot, axes = canvas((10.5, 6.8), 2, 3)
    for (above, below), name in zip(axes.T, shown, strict=True):
        points, n, _, _, _ = EXPERIMENTS[name]
        above.plot(*points.T, ".", ms=3)
        above.add_patch(_square(n))
        above.set(title=name, aspect="equal", xlabel="λ₁", ylabel="λ₂")
        product = Sampling(points, n, WINDOW).dense @ Gridding(points, n, WINDOW).sparse.toarray()
        inverse = np.abs(np.linalg.pinv(product, rcond=1e-4))
        drawn = below.imshow(20 * np.log10(inverse / inverse.max() + 1e-6), vmin=-60, vmax=0, cmap="inferno")
        below.set(title="|(ΨΩ)†|", xlabel="sample", ylabel="sample")
    plot.colorbar(drawn, ax=axes[1], label="dB below the largest")
    plot.savefig(folder / "gridding-rasters.jpg", dpi=90)

    plot, axes = canvas((10.5, 3.8), 1, 3, sharey=True)
    for ax, (name, rows) in zip(axes, patch_errors().items(), strict=True):
        sides, *series = np.array(rows, dtype=float).T
        labels = ("plane waves: predicted", "measured", "curvature corrected: predicted", "measured")
        for label, style, values in zip(labels, ("C0--", "C0o", "C1--", "C1o"), series, strict=True):
            ax.loglog(sides, values, style, label=label, ms=4)
        ax.set(title=name, xlabel="side of the patch, m", ylim=(1e-5, 3))
        ax.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("relative error, phase in rad")
    axes[0].legend(fontsize=7)
    plot.savefig(folder / "gridding-patches.jpg", dpi=100)


def _square(n):
    from matplotlib.patches import Rectangle

    return Rectangle((-n, -n), 2 * n, 2 * n, fill=False, color="C1")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", metavar="DIR", type=Path)
    parser.add_argument("--imaging", action="store_true")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    print(f"pysas {pysas.__version__}, {args.threads} threads")
    if args.figures:
        figures(args.figures)
    elif args.imaging:
        imaging(args.threads)
    else:
        experiments()
        show_convergence(convergence())
        windows()
        noise()
        preconditioning()
        large(args.threads)


if __name__ == "__main__":
    main()
