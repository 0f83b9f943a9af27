"""Circular SAS: the figures and numbers of Pailhas et al. (2017), and the engines against the analytic point spread function.

The paper's pulse: 100 kHz, 20 kHz in 1 ms, Gaussian with sigma = 2e-5 s (printed: 2e-2, a share of the pulse); 1500 m/s, which
it does not state. Fig 1 is a drawing of the geometry.

    python -m bench.circular                  tables: the paper's numbers, the engines, deconvolution
    python -m bench.circular --figures DIR    Figs 2 to 9 as circular-psf.jpg and circular-deconvolution.jpg in DIR
    python -m bench.circular --data FILE      a survey on a circle with `truth_position` in its attrs
    python -m bench.circular --speed          the costly calls
"""

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

import pysas
from pysas import circular

C, FC, BAND, T, SIGMA, FS = 1500.0, 100e3, 20e3, 1e-3, 2e-5, 90e3
WAVE = C / FC
GAUSS = circular.PointSpread(pysas.LFM(FC, BAND, T, "gaussian", SIGMA), C)
RECT = circular.PointSpread(pysas.LFM(FC, BAND, T), C)
RADIUS, TARGET = 40 * np.sqrt(2), (20.0, 20.0)
N, STEP, PEAK = 256, WAVE / 16, 10**-1.5  # deconvolution: pixels, their spacing, noise 30 dB below the peak
AWAY = np.linspace(0, N * STEP, 24 * N)
PROFILE = make_interp_spline(AWAY, GAUSS.exact(AWAY))  # 1e-7: images of many scatterers need not integrate each pixel
SHARES = (0.5, 0.8, 0.9, 0.95)


def track(pings, radius):
    angle = np.arange(pings) * 2 * np.pi / pings
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)


def echoes_of(tx, points, reach):
    """Compressed monostatic echoes of unit points, from the analytic pulse, within `reach` (m) of the first."""
    tau = 2 / C * np.linalg.norm(np.atleast_2d(points)[:, None] - tx, axis=-1)
    start = np.floor((tau[0] - 2 * reach / C) * FS) / FS
    t = start[:, None] + np.arange(int(4 * reach / C * FS) + 2) / FS
    data = sum(GAUSS.pulse.response(t - one[:, None]) * np.exp(-2j * np.pi * FC * one[:, None]) for one in tau)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=start, bandwidth=60e3)


def off_centre(a, radius, pings, half, pixels, azimuth=np.pi / 4):
    """A point at offset a: echoes, a grid about it, its axis, and the pings' weights for even views there."""
    centre = a * radius * np.array([np.cos(azimuth), np.sin(azimuth)])
    tx = track(pings, radius)
    echoes = echoes_of(tx, [[*centre, 0.0]], 1.5 * half + 6 * GAUSS.gaussian_width)
    x = np.linspace(-half, half, 2 * pixels + 1)
    weights = circular.view_weights(echoes, pysas.Grid.points([[*centre, 0.0]]))[0, :, 0]
    return echoes, pysas.Grid.plane(centre[0] + x, centre[1] + x), x, weights


def imaged(echoes, grid, weights, tol=1e-6, method="backproject"):
    return getattr(pysas, method)(echoes, grid, tol=tol, weights=weights).data / weights.sum()


def ring(image, step):
    """Amplitude of the spectrum on the ring |q| = 2/wavelength +- 0.15/wavelength, in bins of 10 degrees."""
    q = np.fft.fftshift(np.fft.fftfreq(512, step))
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image, (512, 512))))
    radius, angle = np.hypot(q, q[:, None]), np.arctan2(q[:, None], q[None, :])
    on = np.abs(radius - 2 / WAVE) < 0.15 / WAVE
    place = np.floor((angle[on] + np.pi) / (2 * np.pi) * 36).astype(int) % 36
    return np.bincount(place, spectrum[on], 36) / np.bincount(place, minlength=36)


def papers_target():
    """Complex images of the point at (20, 20) m, without weights and with, and their axis."""
    half = 6 * WAVE
    echoes, grid, x, weights = off_centre(0.5, RADIUS, 900, half, 48)
    return imaged(echoes, grid, np.ones(900)), imaged(echoes, grid, weights), x


def scene(points, noise=0.0, seed=0):
    """Image of unit scatterers at `points` (x, y) in pixels, in white noise."""
    column, row = np.arange(N), np.arange(N)[:, None]
    image = sum(PROFILE(STEP * np.hypot(column - x, row - y)) for x, y in points)
    return image + noise * np.random.default_rng(seed).standard_normal((N, N))


def diffusion(image, r):
    return circular.energy_diffusion(image, STEP, (N // 2, N // 2), r, 4 * WAVE)


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
    table(
        ("figure", "quantity", "paper", "here"),
        [
            ("7a", "radius of the virtual circle of (20, 20) m; views", "20 m", f"{RADIUS / 2:.2f} m = 20 sqrt(2) m; {views}"),
            ("2", "largest difference of Eqs 19 and 21, rect / Gaussian", "great matching", pair(worst, ".4f")),
            ("2", "central peak against the matched filter's", "around 50 % wider", f"{2 * 2.404826 / np.pi - 1:.0%} wider"),
            ("4", "radii of 50/80/90/95 % of the energy, wavelengths", "~0.75 / 1.3 / ~1.75 / 2.0", pair(exact)),
            ("4", "the same, Eq 38", "", pair(formula)),
            ("4", "the same, rect window", "", pair(rect)),
            ("5", "mean radius of the ring, 2 fc/c", "1, as its diameter", f"{mean / GAUSS.ring_radius:.4f}, its radius"),
            ("5", "variance of the ring, 1/(pi^2 a0^2)", "1", f"{spread:.4f}"),
            ("7c, d", "max/min of the ring over angle, plain / even views", "not stated", pair(levels, ".2f")),
            ("9", "80/95 % radii of Eqs 48-49 as printed, wavelengths", "0.25 / 0.75", pair(kernels[0])),
            ("9", "the same, envelope squared (a conjecture)", "0.25 / 0.75", pair(kernels[1])),
        ],
    )


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
    print(
        "density (plain) or without (even views); left: the wavefront's curvature, as 1/R, and the arcs of few views; ring max/min"
    )
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
    for a in (0.0, 0.5):
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
            share = images[0].report.factorised_share
            errors = [pysas.metrics.relative_error(image.data[np.ix_(inner, inner)], direct) for image in images]
            rows.append((method, a, f"{share:.2f}", *(f"{error:.1e}" for error in errors)))
    print(
        "\n5000 pings at 10 m, 0.9 m imaged, even views: error within 2 wavelengths against the analytic pulse at exact ranges"
    )
    table(("method", "a", "factorised", "tol 1e-2", "1e-3", "1e-4"), rows)


def density(view, a, azimuth=np.pi / 4):
    return circular.view_density(view - azimuth, a)


def methods(image, noise):
    """Deconvolved images by name."""
    centre = (N // 2, N // 2)
    found = {"image": image}
    for threshold in (0.3, 0.1, 0.03, 0.001):
        found[f"naive, {threshold:g}"] = circular.naive(image, GAUSS, STEP, threshold)
    found["Wiener"] = circular.wiener(image, GAUSS, STEP, noise)
    for power in (1, 2):
        name = f"wave atoms about the scatterer, envelope^{power}"
        found[name] = circular.wave_atom_expansion(image, GAUSS, STEP, centre, envelope_power=power)
    return found


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
        for level in (60, 30, 20, 10):
            noise = 10 ** (-level / 20)
            runs = [circular.fit_points(image + noise * draw(seed), GAUSS, STEP, noise) for seed in range(3)]
            counts = "/".join(str(len(run.position)) for run in runs)
            away = [np.linalg.norm(run.position[:, None] - truth, axis=-1).min(axis=0).max() / 16 for run in runs]
            residual = max(run.residual for run in runs)
            rows.append((name, f"{level} dB", f"{counts} of {len(truth)}", f"{max(away):.1e}", f"{residual:.3f}"))
    print(
        "\nFit of points, three draws of noise below the peak of one: scatterers found, worst error of a place in wavelengths"
    )
    table(("scene", "SNR", "found", "error", "residual / noise"), rows)


SCENES = {
    "one": [(0, 0)],
    "square of a wavelength": [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)],
    "pair at 0.5": [(-0.25, 0), (0.25, 0)],
    "pair at 0.25": [(-0.125, 0), (0.125, 0)],
    "pair at 0.15": [(-0.075, 0), (0.075, 0)],
}


def draw(seed):
    return np.random.default_rng(seed).standard_normal((N, N))


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


def canvas(rows, columns, size):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    plot = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(plot)
    return plot, plot.subplots(rows, columns)


def picture(ax, image, title, extent, unit="wavelengths", **more):
    ax.imshow(image, extent=extent, origin="lower", interpolation="nearest", **{"cmap": "inferno"} | more)
    ax.set_title(title, fontsize=9)
    ax.set_xlabel(unit, fontsize=8)


def spectrum_of(image, step, n=1024):
    """Magnitude of the centred spectrum within 3/wavelength, relative to its largest, and its extent in 1/wavelength."""
    q = np.fft.fftshift(np.fft.fftfreq(n, step)) * WAVE
    shown = np.abs(q) <= 3
    values = np.abs(np.fft.fftshift(np.fft.fft2(image, (n, n))))[np.ix_(shown, shown)]
    return values / values.max(), [q[shown][0], q[shown][-1]] * 2


def figure_psf(path):
    """Figs 2 to 5 and 7."""
    plot, axes = canvas(3, 4, (15, 10.5))
    r = np.linspace(-4, 4, 1601) * WAVE
    x = np.linspace(-4, 4, 161) * WAVE
    extent = [-4, 4, -4, 4]
    for row, psf in enumerate((RECT, GAUSS)):
        name = psf.pulse.window
        exact, formula = psf.exact(r), psf.approximate(r)
        axes[row, 0].plot(r / WAVE, exact, lw=1.5, label="Eq 19")
        axes[row, 0].plot(r / WAVE, formula, "--", lw=1, label="Eq 21")
        axes[row, 0].plot(r / WAVE, 100 * (exact - formula), lw=0.7, label="difference x 100")
        axes[row, 0].set_title(f"Fig 2: {name}, difference at most {np.abs(exact - formula).max():.4f}", fontsize=9)
        away, place = np.unique(np.hypot(x, x[:, None]), return_inverse=True)
        image = psf.exact(away)[place].reshape(x.size, x.size)
        picture(axes[row, 1], image, f"Fig 3: {name}", extent, cmap="RdBu_r", vmin=-0.4, vmax=0.4)
    out = np.linspace(0, 5, 501) * WAVE
    total = circular.energy(GAUSS)
    axes[0, 2].plot(out / WAVE, circular.energy_within(GAUSS, out) / total, label="Eq 19")
    axes[0, 2].plot(out / WAVE, circular.energy_within(GAUSS, out, "asymptotic") / total, "--", label="Eq 38, erf(r/a0)")
    axes[0, 2].set_title("Fig 4: share of the energy, gaussian", fontsize=9)
    axes[0, 2].set_xlabel("wavelengths", fontsize=8)
    q = np.linspace(60, 210, 601)
    top = GAUSS.spectrum(GAUSS.ring_radius)
    axes[1, 2].plot(q * WAVE, GAUSS.spectrum(q) / top, label="exact transform of Eq 19")
    axes[1, 2].plot(q * WAVE, GAUSS.spectrum_of_approximation(q) / top, label="Eq 43")
    axes[1, 2].plot(q * WAVE, GAUSS.spectrum_asymptotic(q) / top, "--", label="Eq 44")
    axes[1, 2].set_title("Fig 5b: radial spectrum", fontsize=9)
    axes[1, 2].set_xlabel("cycles per wavelength", fontsize=8)
    axes[0, 3].plot(np.degrees(view := np.linspace(-np.pi, np.pi, 721)), density(view, 0.5), label="(20, 20) m")
    axes[0, 3].plot([-180, 180], [1, 1], "--", label="centre")
    axes[0, 3].set_title("Fig 7b: number of views per angle", fontsize=9)
    axes[0, 3].set_xlabel("view angle, degrees", fontsize=8)
    plain, even, fine = papers_target()
    step = fine[1] - fine[0]
    lines = [(ring(image, step), name) for image, name in ((plain, "plain"), (even, "even views"))]
    for values, name in lines:
        axes[1, 3].plot(np.arange(-175, 180, 10), values / values.mean(), label=f"{name}: {values.max() / values.min():.2f}")
    axes[1, 3].set_title("ring of the spectrum, max/min", fontsize=9)
    axes[1, 3].set_xlabel("spectral angle, degrees", fontsize=8)
    for ax in axes[:2].flat:
        if ax.lines:
            ax.legend(fontsize=7)
            ax.grid(alpha=0.3)
    for ax, (title, image) in zip(
        axes[2],
        {
            "Fig 5a: spectrum, centred": GAUSS.exact(np.hypot(fine, fine[:, None])),
            "Fig 7c: (20, 20) m, plain": plain,
            "Fig 7d: (20, 20) m, even views": even,
            "real part of 7c": plain.real,
        }.items(),
        strict=True,
    ):
        values, limits = spectrum_of(image, step)
        picture(ax, values, title, limits, "cycles per wavelength")
    plot.savefig(path, dpi=80)


def figure_deconvolution(path):
    """Figs 6, 8 and 9."""
    plot, axes = canvas(2, 4, (15, 7.4))
    x = STEP * (np.arange(N) - N // 2)
    atom = circular.wave_atom(GAUSS, x, x[:, None], np.pi / 4)
    extent = [(-N / 2 - 0.5) / 16, (N / 2 - 0.5) / 16] * 2
    picture(axes[0, 0], atom, "Fig 6a: wave atom, 45 degrees", extent, cmap="RdBu_r", vmin=-0.5, vmax=0.5)
    axes[0, 0].set(xlim=(-3, 3), ylim=(-3, 3))
    values, limits = spectrum_of(atom, STEP)
    picture(axes[0, 1], values, "its spectrum: a ridge, not the two spots of Fig 6b", limits, "cycles per wavelength")
    truth = N / 2 + 16 * np.array(SCENES["square of a wavelength"])
    image = scene(truth, PEAK, 1)
    found = circular.fit_points(image, GAUSS, STEP, PEAK)
    shown = {
        "Fig 8a: image, 30 dB": image,
        "Fig 8b: naive, 0.1": circular.naive(image, GAUSS, STEP, 0.1),
        "Fig 8c: Wiener": circular.wiener(image, GAUSS, STEP, PEAK),
        "Fig 8d as printed: one centre": circular.wave_atom_expansion(image, GAUSS, STEP, (N / 2, N / 2)),
        f"fit of points: {len(found.position)} found": circular.synthesise(found, GAUSS, (N, N), STEP),
    }
    for ax, (title, values) in zip((axes[0, 2], axes[0, 3], *axes[1, :3]), shown.items(), strict=True):
        picture(ax, np.abs(values) / np.abs(values).max(), title, extent)
        ax.plot(*((truth.T - N / 2) / 16), "c+", ms=7, mew=0.7)
        ax.set(xlim=(-2.5, 2.5), ylim=(-2.5, 2.5))
    r = np.linspace(0, 4, 801) * WAVE
    one = scene([(N // 2, N // 2)])
    axes[1, 3].plot(r / WAVE, diffusion(one, r), lw=1, label="image, noise-free")
    for name, values in methods(scene([(N // 2, N // 2)], PEAK), PEAK).items():
        if name in ("image", "Wiener") or name.startswith("wave"):
            label = f"{name.replace(' about the scatterer', '')}, 30 dB"
            axes[1, 3].plot(r / WAVE, diffusion(values, r), lw=1, label=label)
    axes[1, 3].plot([0.25, 0.75], [0.8, 0.95], "k^", ms=5, label="paper, wave atoms")
    axes[1, 3].plot([1.3, 2.0], [0.8, 0.95], "ko", ms=5, label="paper, image")
    axes[1, 3].set_title("Fig 9: share of the energy, one scatterer", fontsize=9)
    axes[1, 3].set_xlabel("wavelengths", fontsize=8)
    axes[1, 3].legend(fontsize=7)
    axes[1, 3].grid(alpha=0.3)
    plot.savefig(path, dpi=80)


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
            rows.append((name, f"{n} x {n}, {kind.__name__}", f"{timed(call):.2f}"))
    echoes, _, _, _ = off_centre(0.5, 10.0, 2000, WAVE, 2)
    grid = pysas.Grid.plane(np.linspace(3, 4, 32), np.linspace(3, 4, 32))
    rows.append(("view weights", "1024 pixels, 2000 pings", f"{timed(lambda: circular.view_weights(echoes, grid)):.2f}"))
    table(("call", "size", "seconds"), rows)


def timed(call):
    seconds = []
    for _ in range(3):
        clock = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - clock)
    return sorted(seconds)[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", metavar="DIR", type=Path)
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
