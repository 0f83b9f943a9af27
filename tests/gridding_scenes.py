"""Functions on [-1, 1]^d with their samples by quadrature, for the gridding tests."""

import numpy as np


def _cosine(x, y):
    return np.cos(np.pi * x) * np.sin(np.pi * y) + 0.5 * np.cos(3 * np.pi * x - 2 * np.pi * y)


def _exponential(x, y):
    return np.exp(np.cos(np.pi * x) + np.sin(np.pi * y)) * (1 + 0.5 * np.cos(2 * np.pi * (x + y)))


def _bump(x, y):
    peak = np.exp(4 * (np.cos(np.pi * (x - 0.2)) - 1) + 4 * (np.cos(np.pi * (y + 0.1)) - 1))
    return peak + 0.5 * np.cos(4 * np.pi * x) * np.sin(3 * np.pi * y)


FUNCTIONS = {"A": _cosine, "B": _exponential, "D": _bump}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)


def samples(function, points):
    """fhat at `points` (M, d) by Gauss-Legendre quadrature."""
    away = [np.exp(-1j * np.pi * np.outer(axis, NODES)) * WEIGHTS / 2 for axis in points.T]
    if len(away) == 1:
        return away[0] @ function(NODES)
    return np.sum((away[0] @ function(NODES[:, None], NODES[None, :])) * away[1], axis=1)


def grid(size):
    """Points x = -1 + 2 k/size, and their mesh."""
    x = -1 + 2 * np.arange(size) / size
    return x, np.meshgrid(x, x, indexing="ij")


def psnr(true, found):
    return 10 * np.log10(np.max(np.abs(true)) ** 2 / np.mean(np.abs(true - found) ** 2))


def fitted(true, found):
    """`found` times the best scalar."""
    return found * (np.vdot(found, true) / np.vdot(found, found))


def noise(shape, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
