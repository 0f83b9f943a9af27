"""One-way wave equation migration compared: schemes, angles and forms against the exact sum and against their formulas.

    python -m bench.one_way                  tables: damping, phase by angle, schemes, 100 kHz, parts of a track, speed
    python -m bench.one_way --figures DIR    one-way-comparison.jpg, one-way-water.jpg, one-way-scene.jpg

The scene of the tables is the experiment of a wave of c/(2 fc) = 10 cm: a point at 8 m seen by a sonar every 5 cm, sines below
0.25. The figure's scene re-stages the paper's test: 30 m x 8 m at 120 kHz with an element of 0.04 m.
"""

import argparse
import os
import warnings

import numpy as np

import pysas
from bench import one_way_figures
from bench.one_way_scenes import C, even, record, smooth
from bench.timing import timed
from pysas.reference import one_way

ANGLES = (15, 45, 65)


def modes(k, sine, depth, **options):
    """Image at `depth` of a cosine along the track that a plane wave of that sine leaves: its value over the input's.

    The record is one pulse, so narrow in band that it is a tone.
    """
    columns, fc, fs = 12, k * C / (4 * np.pi), 2000.0
    spacing = np.pi / (columns * k * sine)
    mode = np.cos(np.pi * (np.arange(columns) + 0.5) / columns)
    u = spacing * np.arange(columns)
    cosine = np.sqrt(1 - sine**2)
    centre = 2 * depth * cosine / C  # where the exact wave of this mode is in phase at t = 0
    t = centre + np.arange(-30, 31) / fs
    pulse = np.exp(-((t - centre) ** 2) / (2 * 0.003**2)) * np.exp(-2j * np.pi * fc * centre)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    echoes = pysas.Echoes(mode[:, None] * pulse, fs=fs, fc=fc, tx=tx, rx=tx, c=C, t0=t[0], bandwidth=600.0)
    grid = pysas.Grid.plane(u, [depth])
    image = one_way(echoes, grid, margin=0, half_angle=min(1.2 * np.arcsin(sine), 1.1), threads=1, **options)
    return image.data[0, 0] / mode[0]


def phases():
    """Phase error at 100 wavelengths by angle, measured on one mode, and by the formula."""
    k, depth = 838.0, 100 * 2 * np.pi / 838.0
    print("\nphase error after 100 c/(2 fc), rad: measured (formula)\n")
    degrees = (5, 10, 15, 20, 30)
    print("| angle of the equation | " + " | ".join(f"{d}°" for d in degrees) + " |\n|---" * 1 + "|---" * len(degrees) + "|")
    for angle, (alpha, beta) in zip(ANGLES, ((0.5, 0.0), (0.5, 0.25), (0.478242, 0.376370)), strict=True):
        cells = []
        for d in degrees:
            sine = np.sin(np.radians(d))
            expected = k * depth * (1 - alpha * sine**2 / (1 - beta * sine**2) - np.cos(np.radians(d)))
            found = (
                np.angle(modes(k, sine, depth, angle=angle, step=2e-4, layers=((0.0, C), (1e-3, C))) * np.exp(-1j * expected))
                + expected
            )
            cells.append(f"{found:.3g} ({expected:.3g})")
        print(f"| {angle}° | " + " | ".join(cells) + " |", flush=True)


def damping():
    """Damping of the implicit Euler scheme and of Crank-Nicolson, dB/m, measured between two depths, and by the formula."""
    k = 251.0
    print(
        "\ndamping at k = 251 rad/m, dB/m\n\n"
        "| cells per c/(2 fc) | sine | Euler | formula | Crank-Nicolson |\n|---|---|---|---|---|"
    )
    for cells in (8, 64):
        for sine in (0.1, 0.3):
            dz = 2 * np.pi / k / cells
            near, far = 40 * dz, 40 * dz + 0.5
            levels = {}
            for scheme in ("euler", "cn"):
                values = [
                    np.abs(modes(k, sine, depth, form="carrier", scheme=scheme, step=dz, angle=15, correction="none"))
                    for depth in (near, far)
                ]
                levels[scheme] = 20 * np.log10(values[0] / values[1]) / (far - near)
            a = 2 * (dz * k * sine * 12 / np.pi) ** 2 * np.sin(np.pi / 24) ** 2
            formula = 10 * np.log10(1 + a + a**2 / (4 * np.sin(k * dz / 2) ** 2)) / dz
            print(f"| {cells} | {sine} | {levels['euler']:.3f} | {formula:.3f} | {levels['cn']:.3f} |", flush=True)


def width_and_peak(data, spacing):
    row = np.unravel_index(np.argmax(np.abs(data)), data.shape)[0]
    return pysas.metrics.irw(data[row], spacing), np.abs(data).max()


def row(name, image, direct, level, spacing, seconds, rows):
    width, peak = width_and_peak(image.data[rows], spacing)
    _, ideal = width_and_peak(direct[rows], spacing)
    error = pysas.metrics.relative_error(image.data, direct, level)
    rms, _ = pysas.metrics.phase_error(image.data, direct)
    print(
        f"| {name} | {100 * width:.2f} | {20 * np.log10(peak / ideal):+.2f} | {rms:.3f} | {error:.1e} | {seconds:.2f} |",
        flush=True,
    )


HEADER = "| | width, cm | peak, dB | phase, rad rms | error | seconds |\n|---|---|---|---|---|---|"


def schemes(threads):
    """Every angle, scheme, correction and form on the 10 cm scene, against the exact sum."""
    spacing = 0.05
    u = even(140, spacing)
    echoes = record(u, 0 * u, [(0.0, 8.0)], 7500.0, 4e3, 5e3, 6.5, 40, lambda sine: np.abs(sine) < 0.25)
    grid = pysas.Grid.plane(u[40:100], 7.0 + 0.05 * np.arange(41))
    direct, level = pysas.reference.exact(echoes, grid)
    width, _ = width_and_peak(direct, spacing)
    rows = slice(10, 31)
    print(f"\n10 cm scene, exact sum {100 * width:.2f} cm; weight of back-projection, no factor fitted\n\n{HEADER}")
    # plain differences do not carry this angle at 5 cm: that is what is compared
    warnings.filterwarnings("ignore", message=".*the march carries")
    common = {"weight": "backprojection", "half_angle": 0.25, "threads": threads}
    for cells in (8, 16):
        for angle in ANGLES:
            for scheme, corrections in (("euler", ("none",)), ("cn", ("none", "centre", "compact", "both"))):
                for correction in corrections:
                    if angle == 65 and correction in ("centre", "compact"):
                        continue
                    options = {"form": "carrier", "step": 0.1 / cells, "correction": correction, **common}
                    image, seconds = timed(lambda a=angle, s=scheme, o=options: one_way(echoes, grid, angle=a, scheme=s, **o))
                    name = f"{angle}°, {scheme}, {correction}, {cells} cells"
                    row(name, image, direct, level, spacing, seconds, rows)
    for angle in ANGLES:
        image, seconds = timed(lambda a=angle: one_way(echoes, grid, angle=a, **common))
        row(f"{angle}°, base-band", image, direct, level, spacing, seconds, rows)


def sonar(threads):
    """100 kHz, base-band form, beside omega-k; and parts of the track with overlaps."""
    spacing = 0.01
    u = even(400, spacing)
    points = [(0.0, 8.0), (0.3, 9.0), (-0.4, 10.0)]
    echoes = record(u, 0 * u, points, 100e3, 15e3, 20e3, 7.5, 100, smooth(0.15))
    omega, seconds = timed(lambda: pysas.reference.omega_k(echoes, weight="backprojection", threads=threads))
    columns = np.abs(omega.grid.axes["x"]) < 1
    rows = (omega.grid.axes["y"] > 7.6) & (omega.grid.axes["y"] < 10.4)
    grid = pysas.Grid.plane(omega.grid.axes["x"][columns], omega.grid.axes["y"][rows])
    direct, level = pysas.reference.exact(echoes, grid)
    first = np.abs(grid.axes["y"] - 8) < 0.3
    width, _ = width_and_peak(direct[first], spacing)
    print(f"\n100 kHz, 1 cm spacing, 8 to 10 m, exact sum {100 * width:.2f} cm\n\n{HEADER}")
    cut = pysas.Image(omega.data[np.ix_(rows, columns)], grid, omega.report, omega.fc, omega.c)
    row("omega-k", cut, direct, level, spacing, seconds, first)
    common = {"weight": "backprojection", "half_angle": 0.15, "threads": threads}
    for angle in ANGLES:
        image, seconds = timed(lambda a=angle: one_way(echoes, grid, angle=a, **common))
        row(f"{angle}°", image, direct, level, spacing, seconds, first)
    whole = one_way(echoes, grid, **common)
    print("\nthree parts of the track against the whole, largest difference over the peak\n")
    print("| columns shared | difference | seconds |\n|---|---|---|")
    for overlap in (None, 96, 48, 24, 0):
        found, seconds = timed(lambda o=overlap: one_way(echoes, grid, domains=3, overlap=o, **common))
        name = "twice what 0.15 rad crosses" if overlap is None else overlap
        print(
            f"| {name} | {np.abs(found.data - whole.data).max() / np.abs(whole.data).max():.1e} | {seconds:.2f} |", flush=True
        )


def speed(threads):
    """512 x 512 pixels from records of 1024 samples."""
    rng = np.random.default_rng(0)
    data = rng.standard_normal((512, 2048), dtype=np.float32).view(np.complex64)
    u = even(512, 0.01)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    echoes = pysas.Echoes(data, fs=25e3, fc=100e3, tx=tx, rx=tx, c=C, t0=2 * 5 / C, bandwidth=20e3)
    grid = pysas.Grid.plane(u, 5 + 0.03 * np.arange(512))
    one_way(echoes, pysas.Grid.plane(u, [5.0]), half_angle=0.15, threads=threads)
    image, seconds = timed(lambda: one_way(echoes, grid, half_angle=0.15, threads=threads))
    chosen = image.report.choices
    print(
        f"\n512 x 512 from 512 x 1024 samples at 100 kHz, complex64, {threads} threads: {seconds:.1f} s "
        f"({chosen['steps']} steps, {chosen['frequencies']} frequencies, {chosen['columns_per_ping']} columns per ping)"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", metavar="DIR")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    if args.figures:
        os.makedirs(args.figures, exist_ok=True)
        one_way_figures.draw(args.figures, args.threads)
        return
    damping()
    phases()
    schemes(args.threads)
    sonar(args.threads)
    speed(args.threads)


if __name__ == "__main__":
    main()
