"""Circular SAS: the figures and numbers of Pailhas et al. (2017), and the engines against the analytic point spread function.

The paper's pulse: 100 kHz, 20 kHz in 1 ms, Gaussian with sigma = 2e-5 s (printed: 2e-2, a share of the pulse); 1500 m/s, which
it does not state. Fig 1 is a drawing of the geometry.

    python -m bench.circular                  tables: the paper's numbers, the engines, deconvolution
    python -m bench.circular --figures [DIR]  Figs 2 to 9 as circular-psf.jpg and circular-deconvolution.jpg in DIR (docs)
    python -m bench.circular --data FILE      a survey on a circle with `truth_position` in its attrs
    python -m bench.circular --speed          the costly calls
"""

import argparse
import time
import tracemalloc
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter

import pysas
from bench.circular_figures import figure_deconvolution, figure_psf
from bench.circular_scenes import (
    GAUSS,
    PEAK,
    RADIUS,
    RECT,
    SCENES,
    STEP,
    WAVE,
    C,
    N,
    density,
    diffusion,
    draw,
    echoes_of,
    imaged,
    methods,
    off_centre,
    papers_square,
    papers_target,
    ring,
    scene,
    track,
)
from bench.timing import timed
from pysas import circular

SHARES = (0.5, 0.8, 0.9, 0.95)


def radii(image):
    r = np.linspace(0, 4, 4001) * WAVE
    share = diffusion(image, r)
    return [float(r[np.argmax(share >= part)] / WAVE) for part in (0.8, 0.95)]


def pair(values, form=".3f"):
    return " / ".join(format(value, form) for value in values)


def table(head, rows):
    print(f"\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(map(str, row))} |", flush=True)


def numbers():
    """The paper's numbers beside ours."""
    r = np.linspace(0, 8, 1601) * WAVE
    worst = [np.abs(psf.approximate(r) - psf.exact(r)).max() for psf in (RECT, GAUSS)]
    exact = [circular.resolution(GAUSS, share, 12 * WAVE) / WAVE for share in SHARES]
    formula = [circular.resolution(GAUSS, share, 12 * WAVE, "asymptotic") / WAVE for share in SHARES]
    rect = [circular.resolution(RECT, share, 50 * WAVE) / WAVE for share in SHARES]
    q = np.linspace(60, 210, 30_001)
    profile = GAUSS.spectrum_asymptotic(q)
    mean = np.sum(profile * q) / profile.sum()
    spread = np.sum(profile * (q - mean) ** 2) / profile.sum() * (np.pi * GAUSS.gaussian_width) ** 2
    plain, even, x = papers_target()
    levels = [values.max() / values.min() for values in (ring(plain, x[1] - x[0]), ring(even, x[1] - x[0]))]
    kernels = [[kernel_radius(power, share) for share in (0.8, 0.95)] for power in (1, 2)]
    views = circular.virtual_angles(RADIUS, WAVE, 0.5).size
    away = np.linspace(3, 6, 3001) * WAVE
    square = papers_square()[1]
    tails = [np.abs(psf.exact(away)).max() for psf in (RECT, GAUSS)]
    real = np.abs(plain.real - even.real).max()
    angles = np.radians([0, 180])
    table(
        ("figure", "quantity", "paper", "here"),
        [
            ("2", "largest difference of Eqs 19 and 21, rect / Gaussian", "great matching", pair(worst, ".4f")),
            ("2", "central peak against the matched filter's", "around 50 % wider", f"{2 * 2.404826 / np.pi - 1:.0%} wider"),
            ("3", "largest magnitude from 3 to 6 wavelengths, rect / Gaussian", "heavier tail of rect", pair(tails, ".4f")),
            ("4", "radii of 50/80/90/95 % of the energy, wavelengths", "~0.75 / 1.3 / ~1.75 / 2.0", pair(exact)),
            ("4", "the same, Eq 38", "", pair(formula)),
            ("4", "the same, rect window", "", pair(rect)),
            ("5", "mean radius of the ring, 2 fc/c", "1, as its diameter", f"{mean / GAUSS.ring_radius:.4f}, its radius"),
            ("5", "variance of the ring, 1/(pi^2 a0^2)", "1", f"{spread:.4f}"),
            ("6", "share of an atom's energy on the ring, +- 3 deviations", "all: spots on the ring", f"{on_the_ring():.2f}"),
            ("7a", "radius of the virtual circle of (20, 20) m; views", "20 m", f"{RADIUS / 2:.2f} m = 20 sqrt(2) m; {views}"),
            (
                "7b",
                "views from the nearest / farthest ping",
                "lowest where nearest",
                pair(circular.view_density(angles, 0.5), ".2f"),
            ),
            ("7", "largest change of the real / imaginary part", "order of 1 %", pair((real, np.abs(plain.imag).max()), ".1e")),
            ("7c, d", "max/min of the ring over angle, plain / even views", "not stated", pair(levels, ".2f")),
            (
                "8",
                f"largest false maximum: {', '.join(square)}",
                "not stated",
                pair(map(false_maximum, square.values()), ".2f"),
            ),
            ("9", "80/95 % radii of Eqs 48-49 as printed, wavelengths", "0.25 / 0.75", pair(kernels[0])),
            ("9", "the same, envelope squared (a conjecture)", "0.25 / 0.75", pair(kernels[1])),
        ],
    )


def on_the_ring():
    """Share of a wave atom's energy within three deviations of the ring."""
    x, q = STEP * (np.arange(N) - N // 2), np.fft.fftfreq(N, STEP)
    power = np.abs(np.fft.fft2(circular.wave_atom(GAUSS, x, x[:, None], 0.0))) ** 2
    near = np.abs(np.hypot(q, q[:, None]) - GAUSS.ring_radius) < 3 / (2 * np.pi * GAUSS.gaussian_width)
    return power[near].sum() / power.sum()


def false_maximum(image):
    """Largest local maximum of the magnitude more than 3 pixels from a corner of the square, relative to the largest at one."""
    size = np.abs(image)
    corners = N // 2 + 8 * np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])
    row, column = np.mgrid[:N, :N]
    near = np.min([np.hypot(column - x, row - y) for x, y in corners], axis=0) <= 3
    return np.max(size * (size == maximum_filter(size, 3)) * ~near) / size[near].max()


def kernel_radius(power, share):
    r = np.linspace(0, 4, 8001) * WAVE
    energy = np.cumsum(circular.wave_atom_kernel(GAUSS, r, power) ** 2 * r)
    return float(np.interp(share * energy[-1], energy, r) / WAVE)


def validation():
    """Both engines against the point spread function: by offset and radius, by tol, by number of pings."""
    half, rows = 2 * WAVE, []
    error = pysas.metrics.relative_error
    for a in (0.0, 0.2, 0.5, 0.8):
        pings = int(circular.angles_for_patch(half, 0.8 * WAVE) / (1 - a))
        cells = []
        for radius in (10.0, RADIUS):
            echoes, grid, x, weights = off_centre(a, radius, pings, half, 16)
            exact = GAUSS.exact(np.hypot(x, x[:, None]))
            dense = GAUSS.image(x, x[:, None], partial(density, a=a))
            cells += [error(imaged(echoes, grid, np.ones(pings)), dense), error(imaged(echoes, grid, weights), exact)]
        wide = off_centre(a, RADIUS, 3 * pings, 3 * half, 48)
        for weights in (np.ones(3 * pings), wide[3]):
            values = ring(imaged(wide[0], wide[1], weights), wide[2][1] - wide[2][0])
            cells.append(values.max() / values.min())
        rows.append((a, pings, *(f"{cell:.1e}" for cell in cells[:4]), *(f"{cell:.2f}" for cell in cells[4:])))
    print("\nFull circle, +-2 wavelengths about a point: relative L2 error of the complex image against Eq 19 with the views'")
    print("density (plain) or without (even views); left: the wavefront's curvature, as 1/R, and the arcs of few views;")
    print("ring: max/min of its amplitude over angle")
    head = ("a", "pings", "10 m, plain", "10 m, even", "56.6 m, plain", "56.6 m, even", "ring, plain", "ring, even")
    table(head, rows)
    by_tol()
    corner = 2 * GAUSS.k * np.sqrt(2) * half
    rows = []
    for share in (0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4):
        pings = int(share * corner)
        echoes, grid, x, weights = off_centre(0.0, 1000.0, pings, half, 16)
        found = imaged(echoes, grid, weights)
        rows.append((pings, f"{share:.1f}", f"{error(found, GAUSS.exact(np.hypot(x, x[:, None]))):.1e}"))
    print(
        "\nFull circle, a = 0, R = 1 km, +-2 wavelengths against Eq 19 by number of pings; 2 k r is that of the patch's corner"
    )
    table(("pings", "pings/(2 k r)", "error"), rows)


def by_tol():
    """Both engines against the analytic pulse summed over the same pings at exact ranges; pings dense enough for the tree."""
    rows, half, radius, pings = [], 0.45, 10.0, 5000
    for a in (0.0, 0.2, 0.5, 0.8):
        tx = track(pings, radius)
        centre = a * radius * np.sqrt(0.5) * np.ones(2)
        echoes = echoes_of(tx, [[*centre, 0.0]], 1.4)
        x = np.linspace(-half, half, 121)
        grid = pysas.Grid.plane(centre[0] + x, centre[1] + x)
        weights = circular.view_rate(np.arctan2(tx[:, 1], tx[:, 0]) - np.pi / 4, a)
        inner = np.abs(x) < 2 * WAVE
        points = np.stack([*np.meshgrid(centre[0] + x[inner], centre[1] + x[inner])], axis=-1)
        direct = np.zeros(points.shape[:2], dtype=complex)
        for position, weight in zip(tx[:, :2], weights, strict=True):
            path = np.linalg.norm(points - position, axis=-1) - np.linalg.norm(centre - position)
            direct += weight * GAUSS.pulse.response(2 * path / C) * np.exp(2j * GAUSS.k * path)
        for method in ("backproject", "ffbp"):
            images = [getattr(pysas, method)(echoes, grid, tol=tol, weights=weights) for tol in (1e-2, 1e-3, 1e-4)]
            share = min(image.report.factorised_share for image in images)
            errors = [pysas.metrics.relative_error(image.data[np.ix_(inner, inner)], direct) for image in images]
            rows.append((method, a, f"{share:.2f}", *(f"{error:.1e}" for error in errors)))
    print(
        "\n5000 pings at 10 m, 0.9 m imaged, even views: error within 2 wavelengths against the analytic pulse at exact ranges"
    )
    table(("method", "a", "factorised", "tol 1e-2", "1e-3", "1e-4"), rows)


def deconvolution():
    """Radii of every method, and what the fit of points finds."""
    clean = scene([(N // 2, N // 2)])
    mean = np.sqrt(np.mean(clean**2) / 1000)
    white = np.random.default_rng(0).standard_normal((N, N))
    columns = [methods(clean + noise * white, noise or mean) for noise in (0.0, mean, PEAK)]
    print(
        "\nOne scatterer: 80/95 % radii of the energy within 4 wavelengths, in wavelengths; noise 30 dB below the mean power or"
    )
    print(
        "the peak. Paper (Fig 9): 1.3 / 2.0 for the image, 0.25 / 0.75 for wave atoms. Radii of wave atoms are their kernel's."
    )
    rows = [(name, *(pair(radii(column[name])) for column in columns)) for name in columns[0]]
    table(("method", "noise-free", "30 dB, mean", "30 dB, peak"), rows)
    rows = []
    for name, offsets in SCENES.items():
        truth = N / 2 + 0.3 + 16 * np.array(offsets)
        image = scene(truth)
        for level in (60, 30, 10, 0):
            noise = 10 ** (-level / 20)
            with warnings.catch_warnings(action="ignore"):  # where it stops is told by the number found
                runs = [
                    circular.fit_points(image + noise * draw(seed), GAUSS, STEP, noise, len(truth) + 2) for seed in range(3)
                ]
            counts = "/".join(str(len(run.position)) for run in runs)
            away = [np.linalg.norm(run.position[:, None] - truth, axis=-1).min(axis=0).max() / 16 for run in runs]
            residual = max(run.residual for run in runs)
            rows.append((name, f"{level} dB", f"{counts} of {len(truth)}", f"{max(away):.1e}", f"{residual:.3f}"))
    print(
        "\nFit of points, three draws of noise below the peak of one: scatterers found (stopped at 2 too many), worst error\n"
        "of a true place, in wavelengths"
    )
    table(("scene", "SNR", "found", "error", "residual / noise"), rows)


def survey(name):
    """Targets of a recorded circle: place of the peak; its shape against Eq 19 and against the targets' analytic echoes."""
    echoes = pysas.compress(pysas.load(name))
    truth, strength = np.asarray(echoes.attrs["truth_position"]), np.asarray(echoes.attrs["truth_amplitude"])
    rows, x = [], np.linspace(-2 * WAVE, 2 * WAVE, 33)
    middle = np.abs(x) < 0.75 * WAVE
    pulse = circular.PointSpread(echoes.pulse, echoes.c)

    def ranges(point):
        outward, back = point[..., None, None, :] - echoes.tx[:, None], point[..., None, None, :] - echoes.receivers
        return np.linalg.norm(outward, axis=-1), np.linalg.norm(back, axis=-1)

    def error(found, wanted):
        return np.linalg.norm((found / found[16] - wanted / wanted[16])[middle]) / np.linalg.norm((wanted / wanted[16])[middle])

    for number, point in enumerate(truth):
        grid = pysas.Grid.plane(point[0] + x, point[1] + x, z=point[2])
        weights = circular.view_weights(echoes, pysas.Grid.points(point[None]))[0]
        image = pysas.backproject(echoes, grid, tol=1e-5, weights=weights)
        place = np.array(pysas.metrics.peak_position(image, (point[0], point[1]), 0.01)) - point[:2]
        cut, step = image.data[16].astype(complex), x[1] - x[0]
        # the wavenumber along the seabed is k times the cosine of the depression
        steep = np.linalg.norm(echoes.tx[:, :2] - point[:2], axis=1) / np.linalg.norm(echoes.tx - point, axis=1)
        exact = circular.PointSpread(echoes.pulse, echoes.c / steep.mean()).exact(x)
        paths = sum(ranges(np.stack([point[0] + x, 0 * x + point[1], 0 * x + point[2]], axis=1)))
        echo = np.zeros(x.size, dtype=complex)
        for other, amplitude in zip(truth, strength, strict=True):
            outward, back = ranges(other)
            longer = paths - outward - back
            wave = pulse.envelope(longer / 2) * np.exp(2j * np.pi * echoes.fc / echoes.c * longer)
            echo += amplitude * np.sum(weights / (outward * back) * wave, axis=(1, 2))
        width = [1e3 * pysas.metrics.irw(values, step) for values in (cut, exact.astype(complex))]
        shape = f"{error(cut, exact):.3f} | {error(cut, echo):.1e}"
        rows.append((number, f"{1e3 * np.hypot(*place):.4f}", pair(width, ".2f"), shape))
    print(f"\n{name}: place of the peak; -3 dB width and the complex cut along x within 0.75 wavelengths against Eq 19")
    print("for the mean depression; that cut against the analytic echoes of all targets, spread as 1/(range range)")
    table(("target", "place, mm", "width / Eq 19's, mm", "cut, Eq 19", "cut, all echoes"), rows)


def speed():
    """Seconds of the calls that grow with the image."""
    rng = np.random.default_rng(0)
    rows = []
    for n, kind in ((1024, np.complex64), (2048, np.complex64), (2048, np.complex128)):
        image = (rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))).astype(kind)
        for name, call in (
            ("Wiener", lambda image=image: circular.wiener(image, GAUSS, STEP, 1.0, 10.0)),
            ("naive", lambda image=image: circular.naive(image, GAUSS, STEP, 0.1)),
        ):
            _, seconds = timed(call, 3, np.median)
            rows.append((name, f"{n} x {n}, {kind.__name__}", f"{seconds:.2f}", f"{memory(call) / image.nbytes:.1f}"))
    echoes, _, _, _ = off_centre(0.5, 10.0, 2000, WAVE, 2)
    grid = pysas.Grid.plane(np.linspace(3, 4, 32), np.linspace(3, 4, 32))
    _, seconds = timed(lambda: circular.view_weights(echoes, grid), 3, np.median)
    rows.append(("view weights", "1024 pixels, 2000 pings", f"{seconds:.2f}", ""))
    table(("call", "size", "seconds", "memory, images"), rows)
    weights_cost()


def weights_cost():
    """What weights uniform in view angle cost the engines: medians of interleaved calls, planning included."""
    tx = track(2048, 20.0)
    data = np.random.default_rng(0).standard_normal((2048, 2 * 1200)).astype(np.float32).view(np.complex64)
    echoes = pysas.Echoes(data, fs=26e3, fc=60e3, tx=tx, rx=tx, c=C, t0=2 * 6 / C, bandwidth=20e3)
    x = 0.02 * (np.arange(512) - 256)
    grid, rows = pysas.Grid.plane(x, x), []
    for method in ("backproject", "ffbp"):
        for tol in (1e-2, 1e-3, 1e-4):
            seconds = {None: [], "uniform-angle": []}
            for _ in range(5):
                for weights, found in seconds.items():
                    clock = time.perf_counter()
                    image = getattr(pysas, method)(echoes, grid, tol=tol, weights=weights, threads=1)
                    found.append((time.perf_counter() - clock, image.report.sum_seconds))
            plain, even = (np.median(found, axis=0) for found in seconds.values())
            error = image.report.choices["errors"]["view angles"]
            rows.append((method, tol, *(f"{v:.2f}" for v in (*plain, *even, *even / plain)), f"{error:.1e}"))
    head = ("method", "tol", "plain, s", "its sum", "even, s", "its sum", "ratio", "of sums", "error of weights")
    print("\nuniform-angle: 2048 pings at 20 m, 512 x 512 pixels of 2 cm, one thread")
    table(head, rows)


def memory(call):
    """Most bytes allocated at once."""
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", metavar="DIR", type=Path, nargs="?", const=Path("docs"))
    parser.add_argument("--data", metavar="FILE")
    parser.add_argument("--speed", action="store_true")
    args = parser.parse_args()
    if args.figures:
        numbers()
        figure_psf(args.figures / "circular-psf.jpg")
        figure_deconvolution(args.figures / "circular-deconvolution.jpg")
    elif args.data:
        survey(args.data)
    elif args.speed:
        speed()
    else:
        numbers()
        validation()
        deconvolution()


if __name__ == "__main__":
    main()
