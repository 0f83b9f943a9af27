"""What the bench of one-way migration images: compressed echoes of points seen from a line or a path."""

import numpy as np

import pysas

C = 1500.0


def even(pings, spacing):
    return spacing * (np.arange(pings) - pings // 2)


def record(u, g, points, fc, band, fs, near, samples, beam, amplitudes=None, late=None, dtype=np.complex128):
    """Compressed echoes at (u, g) of a Gaussian pulse; `beam` of the sine about broadside, `late` s of each ping, two ways."""
    t = 2 * near / C + np.arange(samples) / fs
    sigma = 6.8 / (np.pi * band)
    reach = int(np.ceil(5 * sigma * fs))
    data = np.zeros((u.size, samples), dtype=np.complex128)
    for amplitude, (x, z) in zip(np.ones(len(points)) if amplitudes is None else amplitudes, points, strict=True):
        away = np.hypot(z - g, x - u)
        shade = amplitude * beam((x - u) / away)
        pings = np.flatnonzero(shade)
        tau = 2 * away[pings] / C + (0 if late is None else late[pings])
        index = np.rint((tau - t[0]) * fs).astype(int)[:, None] + np.arange(-reach, reach + 1)
        inside = (index >= 0) & (index < samples)
        echo = np.exp(-((t[0] + index / fs - tau[:, None]) ** 2) / (2 * sigma**2))
        echo = echo * (shade[pings] * np.exp(-2j * np.pi * fc * tau))[:, None]
        rows = np.broadcast_to(pings[:, None], index.shape)
        data[rows[inside], index[inside]] += echo[inside]
    tx = np.stack([u, g, 0 * u], axis=1)
    return pysas.Echoes(data.astype(dtype), fs=fs, fc=fc, tx=tx, rx=tx, c=C, t0=t[0], bandwidth=band)


def smooth(width):
    return lambda sine: np.where(np.abs(sine) < width, np.cos(np.pi / 2 * sine / width) ** 2, 0.0)
