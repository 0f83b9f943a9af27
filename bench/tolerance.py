"""Asked and measured relative error of back-projection: `python -m bench.tolerance` prints a table per dtype.

Scenes hold random band-limited echoes, the hardest case; the error is against `pysas.reference.exact` on sampled pixels,
in the promise's norm, so that 1e-3 asked means at most 1e-3 measured.
"""

import numpy as np

import pysas
from bench.scenes import random_stripmap


def scenes(dtype):
    yield "straight, monostatic", *random_stripmap(192, 2048, 256, dtype=dtype)
    yield "6 receivers, moving", *random_stripmap(32, 2048, 256, channels=6, moving=True, dtype=dtype)
    echoes, plane = random_stripmap(192, 2048, 192, dtype=dtype)
    x, y = plane.axes["x"], plane.axes["y"]
    height = 0.3 * np.sin(x / 0.7) * np.cos(y[:, None] / 0.9)
    yield "height map", echoes, pysas.Grid.surface(x, y, height)
    angle = 2 * np.pi * np.arange(192) / 192
    ring = np.stack([30 * np.cos(angle), 30 * np.sin(angle), np.full(192, 8.0)], axis=1)
    yield "circular", echoes.replace(tx=ring, rx=ring[:, None], t0=2 * 24 / 1500.0), pysas.Grid.plane(x, x)


def table(dtype, exponents, count=400):
    """The errors of all scenes as a table; exact values at so many pixels."""
    lines = ["| scene | " + " | ".join(f"1e-{e}" for e in exponents) + " |", "|---" * (len(exponents) + 1) + "|"]
    for name, echoes, grid in scenes(dtype):
        pixels = np.random.default_rng(0).choice(grid.size, count, replace=False)
        exact, level = pysas.reference.exact(echoes, grid, pixels)
        row = []
        for e in exponents:
            image = pysas.backproject(echoes, grid, 10.0**-e)
            row.append(pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level))
        lines.append(f"| {name} | " + " | ".join(f"{value:.1e}" for value in row) + " |")
    return "\n".join(lines)


def text(quick=False):
    """Both tables."""
    last = {np.complex64: 3 if quick else 5, np.complex128: 3 if quick else 10}
    parts = [f"{np.dtype(dtype)}\n\n{table(dtype, range(1, n + 1), 40 if quick else 400)}" for dtype, n in last.items()]
    return "\n\n".join(parts)


if __name__ == "__main__":
    print(text())
