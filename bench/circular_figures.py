"""Figs 2 to 9 of Pailhas et al. (2017); see `bench.circular`."""

import numpy as np

from bench.circular_scenes import (
    GAUSS,
    PEAK,
    RADIUS,
    RECT,
    STEP,
    TARGET,
    WAVE,
    N,
    density,
    diffusion,
    methods,
    papers_square,
    papers_target,
    ring,
    scene,
)
from pysas import circular


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
    drawing(axes[2, 0])
    for ax, (title, image) in zip(
        axes[2, 1:],
        {
            "Fig 5a: spectrum, centred": GAUSS.exact(np.hypot(fine, fine[:, None])),
            "Fig 7c: (20, 20) m, plain": plain,
            "Fig 7d: (20, 20) m, even views": even,
        }.items(),
        strict=True,
    ):
        values, limits = spectrum_of(image, step)
        picture(ax, values, title, limits, "cycles per wavelength")
    plot.savefig(path, dpi=80)


def drawing(ax):
    """Fig 7a: the circle of the track, and the virtual one about the target, every thousandth view on each."""
    view = circular.virtual_angles(RADIUS, WAVE, 0.5)[::1000]
    theta = circular.track_angle(view, 0.5) + np.pi / 4
    virtual = np.array(TARGET)[:, None] + RADIUS / 2 * np.array([np.cos(view + np.pi / 4), np.sin(view + np.pi / 4)])
    real = RADIUS * np.array([np.cos(theta), np.sin(theta)])
    ax.plot([real[0], [TARGET[0]] * view.size], [real[1], [TARGET[1]] * view.size], "0.8", lw=0.5)
    ax.plot(*real, "o", ms=3, label="track, 40 sqrt(2) m")
    ax.plot(*virtual, "o", ms=3, label="virtual, 20 sqrt(2) m")
    ax.plot(*TARGET, "k+")
    ax.set_title("Fig 7a: even views of (20, 20) m", fontsize=9)
    ax.set_xlabel("m", fontsize=8)
    ax.set_aspect("equal")
    ax.set_ylim(-95, 65)
    ax.legend(fontsize=7, loc="lower left")


def figure_deconvolution(path):
    """Figs 6, 8 and 9."""
    plot, axes = canvas(2, 4, (15, 7.4))
    x = STEP * (np.arange(N) - N // 2)
    atom = circular.wave_atom(GAUSS, x, x[:, None], np.pi / 4)
    extent = [(-N / 2 - 0.5) / 16, (N / 2 - 0.5) / 16] * 2
    picture(axes[0, 0], atom, "Fig 6a: wave atom, 45 degrees", extent, cmap="RdBu_r", vmin=-0.5, vmax=0.5)
    axes[0, 0].set(xlim=(-3, 3), ylim=(-3, 3))
    values, limits = spectrum_of(atom, STEP)
    picture(axes[0, 1], values, "its spectrum: a ridge; circles: 64 atoms as in Fig 6b", limits, "cycles per wavelength")
    turn = np.arange(128) * np.pi / 64
    axes[0, 1].plot(2 * np.cos(turn), 2 * np.sin(turn), "o", mfc="none", mec="c", ms=3, mew=0.5)
    truth, images = papers_square()
    titles = ("8a: image, 30 dB", "8b: naive, 0.1", "8c: Wiener", "8d as printed: one centre", "8d by a fit of points")
    shown = {f"Fig {title}": values for title, values in zip(titles, images.values(), strict=True)}
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
