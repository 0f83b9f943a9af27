"""Image measured radar data with the sonar engine: AFRL Gotcha volumetric SAR, public release (X band, 4 degrees).

Back-projection knows only delays, so 10 km at 9.6 GHz in air is one more test of its phases: a car park 100 m wide,
with two corner reflectors. The script images the ground plane, writes a PNG and measures the -3 dB widths of isolated
points.

    python examples/gotcha.py gotcha_phase_history.npz --out gotcha.png

The file holds phase_history (pulse, frequency), freq (Hz), position (pulse, 3) and r0 (pulse,) in metres, and c (m/s).
Without an argument it is looked for in the folder named by the environment variable PYSAS_DATA.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np

import pysas
import pysas.plot

NAME = "gotcha_phase_history.npz"
CLEAR = 2.0, 6.0  # m: a point is isolated if the ring between these radii about it is ...
ISOLATION = 16.0  # ... everywhere at least so many dB weaker
FLOOR = 30.0  # dB below the brightest point


def read(path: Path, taper: str) -> tuple[pysas.Echoes, float, float]:
    """Echoes, and the theoretical -3 dB widths across and along the track on the ground, m."""
    with np.load(path) as file:
        freq, position, c = file["freq"], file["position"], float(file["c"])
        window, widening = np.ones(freq.size), 0.886
        if taper == "hann":
            window, widening = np.hanning(freq.size + 2)[1:-1], 1.44
        history = file["phase_history"] * (window / window.mean()).astype(np.float32)
        echoes = pysas.from_phase_history(history, freq, position, file["r0"], c)
    ground = float(np.hypot(position[:, 0], position[:, 1]).mean() / np.linalg.norm(position, axis=1).mean())
    turn = float(np.ptp(np.unwrap(np.arctan2(position[:, 1], position[:, 0]))))
    return echoes, widening * c / (2 * np.ptp(freq) * ground), 0.886 * c / (2 * freq.mean() * turn * ground)


def isolated_points(image: pysas.Image) -> list[tuple[float, float, float]]:
    """Bright points with nothing of note around them: x, y (m), level (dB below the brightest)."""
    level = image.db()
    x, y = np.meshgrid(image.grid.axes["x"], image.grid.axes["y"])
    left, found = level.copy(), []
    while (top := float(left.max())) > -FLOOR:
        row, column = np.unravel_index(int(np.argmax(left)), left.shape)
        distance = np.hypot(x - x[row, column], y - y[row, column])
        ring = level[(distance > CLEAR[0]) & (distance < CLEAR[1])]
        if ring.max() < top - ISOLATION:
            found.append((float(x[row, column]), float(y[row, column]), top))
        left[distance <= CLEAR[0]] = -np.inf
    return found


def main(arguments: list[str] | None = None) -> list[dict[str, Any]]:
    """Run the example; returns the measured points."""
    parser = argparse.ArgumentParser(description="Image the Gotcha phase history and measure its isolated points.")
    default = Path(os.environ["PYSAS_DATA"]) / NAME if "PYSAS_DATA" in os.environ else None
    parser.add_argument("data", nargs="?", type=Path, default=default, help=f"{NAME} (default: in $PYSAS_DATA)")
    parser.add_argument("--out", type=Path, default=Path("gotcha.png"), help="picture to write (%(default)s)")
    parser.add_argument("--size", type=float, default=100.0, help="width of the scene, m (%(default)s)")
    parser.add_argument("--pixel", type=float, default=0.2, help="pixel, m (%(default)s)")
    parser.add_argument("--tol", type=float, default=1e-3, help="relative error (%(default)s)")
    parser.add_argument("--taper", choices=("hann", "none"), default="hann", help="window over frequency (%(default)s)")
    options = parser.parse_args(arguments)
    if options.data is None:
        parser.error(f"no data: name {NAME} or set PYSAS_DATA to its folder")

    echoes, across, along = read(options.data, options.taper)
    print(echoes)
    half = round(options.size / 2 / options.pixel)
    axis = options.pixel * np.arange(-half, half + 1)
    image = pysas.backproject(echoes, pysas.Grid.plane(axis, axis), tol=options.tol)
    print(image)
    pysas.plot.quicklook(
        image, options.out, dynamic_range=50.0, title=f"Gotcha, pass 1, HH, {echoes.n_ping} pulses, tol {options.tol:g}"
    )
    print(f"wrote {options.out}")

    points = []
    print(f"isolated points, -3 dB widths (theory: {across:.3f} m in x, {along:.3f} m in y)")
    for x, y, level in isolated_points(image):
        where = pysas.metrics.peak_position(image, near=(x, y), radius=3 * options.pixel)
        width = [pysas.metrics.irw(*pysas.metrics.cut(image, where, side)) for side in ("x", "y")]
        points.append({"x": where[0], "y": where[1], "level_db": level, "width_x": width[0], "width_y": width[1]})
        print(f"  x {where[0]:8.3f} m  y {where[1]:8.3f} m  {level:6.1f} dB  {width[0]:.3f} m x {width[1]:.3f} m")
    return points


if __name__ == "__main__":
    main()
