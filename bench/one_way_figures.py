"""Figures of one-way migration: schemes side by side, layers and a curved path, and the paper's test re-staged."""

import os
import warnings

import numpy as np
from scipy.optimize import brentq

import pysas
from bench.one_way_scenes import C, even, record, smooth
from bench.timing import timed
from pysas.reference import enhance, map_to_line, omega_k, one_way

NEAR, FAR, LENGTH = 12.0, 20.0, 30.0  # of the re-staged scene, m


def figure(size):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(made)
    return made


def show(ax, data, x, y, title, span=40, peak=None):
    peak = np.abs(data).max() if peak is None else peak
    level = 20 * np.log10(np.abs(data) / peak + 1e-9)
    half = (x[1] - x[0]) / 2, (y[1] - y[0]) / 2
    extent = (x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1])
    ax.imshow(level, extent=extent, origin="lower", vmin=-span, vmax=0, cmap="inferno", aspect="auto", interpolation="nearest")
    ax.set_title(title, fontsize=8)
    ax.tick_params(labelsize=7)


def comparison(path, threads):
    """The 10 cm scene as the exact sum and each scheme show it."""
    u = even(140, 0.05)
    echoes = record(u, 0 * u, [(0.0, 8.0)], 7500.0, 4e3, 5e3, 6.5, 40, lambda sine: np.abs(sine) < 0.25)
    grid = pysas.Grid.plane(u[50:91], 7.25 + 0.05 * np.arange(31))
    warnings.filterwarnings("ignore", message=".*the march carries")
    common = {"half_angle": 0.25, "weight": "backprojection", "threads": threads}
    carrier = {"form": "carrier", "step": 0.1 / 8, "angle": 15, **common}
    shown = {
        "exact sum": pysas.reference.exact(echoes, grid)[0],
        "15°, Euler, 8 cells": one_way(echoes, grid, scheme="euler", **carrier).data,
        "15°, CN, 8 cells": one_way(echoes, grid, correction="none", **carrier).data,
        "15°, CN, corrected, 8 cells": one_way(echoes, grid, **carrier).data,
        "45°, base-band": one_way(echoes, grid, **common).data,
        "65°, base-band": one_way(echoes, grid, angle=65, **common).data,
    }
    made = figure((10, 5.6))
    upper, lower = made.subfigures(2, 1, height_ratios=(1, 1.1))
    peak = np.abs(shown["exact sum"]).max()
    for ax, (name, data) in zip(upper.subplots(1, len(shown), sharey=True), shown.items(), strict=True):
        show(ax, data, grid.axes["x"], grid.axes["y"], name, 30, peak)
        ax.set_xlabel("x, m", fontsize=7)
    left, right = lower.subplots(1, 2)
    for name, data in shown.items():
        cut = np.abs(data[np.argmax(np.abs(data).max(axis=1))]) / peak
        left.plot(grid.axes["x"], 20 * np.log10(cut + 1e-9), label=name, lw=1)
    left.set(xlabel="x, m", ylabel="dB below the exact peak", ylim=(-30, 2), title="cut along the track")
    left.legend(fontsize=7)
    degrees = np.linspace(1, 40, 200)
    sine = np.sin(np.radians(degrees))
    for angle, (alpha, beta) in {15: (0.5, 0.0), 45: (0.5, 0.25), 65: (0.478242, 0.376370)}.items():
        error = np.abs(1 - alpha * sine**2 / (1 - beta * sine**2) - np.cos(np.radians(degrees)))
        right.semilogy(degrees, 2 * np.pi * 100 * error, label=f"{angle}°", lw=1)
    right.axhline(np.pi / 4, color="k", lw=0.5, ls=":")
    right.set(xlabel="angle from broadside, degrees", ylabel="rad", ylim=(1e-5, 1e2), title="phase error after 100 c/(2 fc)")
    right.legend(fontsize=7)
    made.savefig(path, dpi=110, pil_kwargs={"quality": 85})


def delays(x, z, top, speeds):
    """Two-way time of rays through two layers by Snell's law."""
    depths = np.array([top, z - top])
    speeds = np.array(speeds)
    found = []
    for offset in np.abs(x):
        p = 0.0
        if offset > 0:
            p = brentq(
                lambda p, o=offset: np.sum(depths * p * speeds / np.sqrt(1 - (p * speeds) ** 2)) - o,
                0, (1 - 1e-12) / speeds.max(), xtol=1e-18,
            )  # fmt: skip
        found.append(2 * np.sum(depths / (speeds * np.sqrt(1 - (p * speeds) ** 2))))
    return np.array(found)


def water(path, threads):
    """A point under a layer, and points seen from a curved path."""
    u = even(300, 0.01)
    speeds, top, z = (1500.0, 1300.0), 3.0, 6.0
    tau = delays(u, z, top, speeds)
    echoes = record(u, 0 * u, [(0.0, z)], 100e3, 15e3, 20e3, 5.7, 80, smooth(0.12), late=tau - 2 * np.hypot(z, u) / C)
    made = figure((10, 5.6))
    axes = made.subplots(2, 3)
    for ax, layers, name in (
        (axes[0, 0], None, "1500 m/s everywhere"),
        (axes[0, 1], [(0.0, 1500.0), (3.0, 1300.0)], "1500 m/s, 1300 m/s below 3 m"),
    ):
        grid = pysas.Grid.plane(u[100:200], 5.8 + 0.02 * np.arange(60))
        data = one_way(echoes, grid, layers=layers, half_angle=0.12, threads=threads).data
        show(ax, data, grid.axes["x"], grid.axes["y"], name)
        ax.plot(0, z, "wo", mfc="none", ms=14, mew=0.8)
    lens = C / (1 + 0.02 * np.sin(2 * np.pi * u / 1.3))
    late = 2 * 0.05 * (1 / lens - 1 / C)
    echoes = record(u, 0 * u, [(0.0, 6.0)], 100e3, 15e3, 20e3, 5.7, 40, smooth(0.12), late=late)
    grid = pysas.Grid.plane(u[100:200], 5.8 + 0.01 * np.arange(40))
    blind = one_way(echoes, grid, half_angle=0.12, threads=threads).data
    seen = one_way(echoes, grid, half_angle=0.12, layers=[(0.0, lens), (0.05, C)], threads=threads).data
    both = np.concatenate([blind, seen])
    show(axes[0, 2], both, grid.axes["x"], 0.01 * np.arange(80), "speed varies 2 % along x: ignored (below), known")
    axes[0, 2].axhline(0.395, color="w", lw=0.6)
    u = even(500, 0.01)
    g = 0.1 * np.sin(2 * np.pi * u / 6)
    points = [(0.0, 8.0), (0.5, 9.0), (-0.6, 8.6)]
    echoes = record(u, g, points, 100e3, 15e3, 20e3, 7.2, 80, smooth(0.15))
    straight = echoes.replace(tx=echoes.tx * [1, 0, 1], rx=echoes.tx * [1, 0, 1])
    mapped = map_to_line(echoes, half_angle=0.15, threads=threads)
    images = {
        "back-projection on the curved path": pysas.backproject,
        "the path taken for a line: omega-k": straight,
        "mapped to a line: omega-k": mapped,
    }
    for ax, (name, what) in zip(axes[1], images.items(), strict=True):
        made_of = omega_k(what if isinstance(what, pysas.Echoes) else mapped, weight="backprojection", threads=threads)
        x, y = made_of.grid.axes["x"], made_of.grid.axes["y"]
        rows, columns = (y > 7.7) & (y < 9.3), np.abs(x) < 1
        data = made_of.data[np.ix_(rows, columns)]
        if not isinstance(what, pysas.Echoes):
            data = what(echoes, pysas.Grid.plane(x[columns], y[rows]), tol=1e-4, threads=threads).data
        show(ax, data, x[columns], y[rows], name)
    for ax in axes.ravel():
        ax.set_xlabel("x, m", fontsize=7)
    axes[0, 0].set_ylabel("z, m", fontsize=7)
    axes[1, 0].set_ylabel("y, m", fontsize=7)
    made.savefig(path, dpi=110, pil_kwargs={"quality": 85})


def staged():
    """Echoes of 30 m x 8 m at 120 kHz, element 0.04 m, every D/4: texture, a dark object with a bright edge, targets."""
    rng = np.random.default_rng(7)
    count = 20000
    x, z = rng.uniform(-LENGTH / 2, LENGTH / 2, count), rng.uniform(NEAR, FAR, count)
    amplitude = 0.05 * rng.standard_normal(count) * (1 + 0.6 * np.sin(2 * np.pi * (x + 0.5 * z) / 1.5))
    hull = (np.abs(x - 6) < 2.5) & (np.abs(z - 16.5 - 0.2 * (x - 6)) < 0.8)
    amplitude[hull] = 0
    edge = np.linspace(3.5, 8.5, 160)
    targets = [(-11.0, 14.0), (-8.0, 18.0), (-5.0, 13.5), (-2.0, 16.0), (0.5, 18.5), (11.0, 13.5), (12.5, 18.0)]
    points = np.concatenate([np.stack([x, z], 1), np.stack([edge, 15.7 + 0.2 * (edge - 6)], 1), targets])
    strengths = np.concatenate([amplitude, 0.2 * rng.standard_normal(160), np.ones(len(targets))])
    u = even(3000, 0.01)

    def beam(sine):
        place = 0.04 * 120e3 / C * sine
        return np.where(np.abs(place) < 1, np.sinc(place) ** 2, 0.0)

    echoes = record(
        u, 0 * u, points, 120e3, 20e3, 25e3, NEAR - 0.3, 290, beam, strengths, dtype=np.complex64
    )  # fmt: skip
    noise = rng.standard_normal((*echoes.data.shape, 2)) @ [1, 1j]
    return echoes.replace(data=(echoes.data + 0.02 * noise).astype(np.complex64))


def blocks(data, rows=2, columns=8):
    """Rms magnitude over blocks of pixels."""
    power = np.abs(data[: data.shape[0] // rows * rows, : data.shape[1] // columns * columns]) ** 2
    return np.sqrt(power.reshape(power.shape[0] // rows, rows, -1, columns).mean(axis=(1, 3)))


def scene(path, threads):
    """Raw data, one-way image, enhanced image, omega-k."""
    echoes = staged()
    grid = pysas.Grid.plane(echoes.tx[:, 0], NEAR + 0.03 * np.arange(267))
    image, one_seconds = timed(lambda: one_way(echoes, grid, half_angle=0.145, threads=threads))
    omega, omega_seconds = timed(lambda: omega_k(echoes, threads=threads))
    magnitude = blocks(image.data)
    better, better_seconds = timed(lambda: enhance(magnitude))
    omega_rows = float(omega.grid.axes["y"][0]), float(np.diff(omega.grid.axes["y"])[0])
    shown = {
        "range-compressed data, 3000 pings at 120 kHz": (blocks(echoes.data.T), NEAR - 0.3, 0.03),
        f"one-way, 45°, base-band: {one_seconds:.1f} s for 267 x 3000 pixels": (magnitude, NEAR, 0.03),
        f"enhanced, BV-type, beta by the discrepancy principle: {better_seconds:.1f} s for 133 x 375": (
            better.data,
            NEAR,
            0.03,
        ),
        f"omega-k: {omega_seconds:.1f} s": (blocks(omega.data), *omega_rows),
    }
    made = figure((10, 9.5))
    axes = made.subplots(4, 1, sharex=True, sharey=True)
    x = np.mean(grid.axes["x"].reshape(-1, 8), axis=1)
    for ax, (name, (data, first, apart)) in zip(axes, shown.items(), strict=True):
        show(ax, data, x, first + apart / 2 + 2 * apart * np.arange(len(data)), name, 36, 1.2 * np.quantile(data, 0.999))
        ax.set_ylabel("slant range, m", fontsize=7)
    axes[3].set(xlabel="x, m", ylim=(NEAR, FAR))
    made.savefig(path, dpi=85, pil_kwargs={"quality": 50})
    print(f"one-way {one_seconds:.1f} s, enhancement {better_seconds:.1f} s, omega-k {omega_seconds:.1f} s")
    print(image.report.choices, f"beta {better.beta:.3g}, {better.iterations} iterations, converged {better.converged}")


def draw(folder, threads):
    for name, make in (("comparison", comparison), ("water", water), ("scene", scene)):
        path = os.path.join(folder, f"one-way-{name}.jpg")
        make(path, threads)
        print(path, os.path.getsize(path) // 1000, "kB", flush=True)
