"""Surge from coherence: how it falls with the separation of two phase centres says where it is largest."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray

_WIDEST, _GRID = 1.5, 121  # of shifts that are tried, in steps of the phase centres; their number
LEAST_SIGMA = 0.1e-3  # m: surge is never better known


@lru_cache(maxsize=8)
def _pattern(elements: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Lags, and the convolution of both elements' triangles at them, 1 at 0."""
    fine = np.arange(4097) * (sum(elements) / 2048) - sum(elements)
    send, hear = (np.clip(1 - np.abs(fine) / size, 0, None) for size in elements)
    both = np.convolve(send, hear, "same")
    return np.asarray(fine, dtype=np.float64), np.asarray(both / both.max())


def coherence(separation: FloatArray, elements: tuple[float, float]) -> FloatArray:
    """Coherence of the seabed's echoes at two phase centres so far apart along the track, m: the Fourier transform of the
    two-way power pattern [sinc(Dt v) sinc(Dr v)]^2 at twice the separation, hence both elements' triangles convolved."""
    return np.asarray(np.interp(2 * np.abs(separation), *_pattern(elements), right=0.0))


def mean_square_sine(elements: tuple[float, float], wavelength: FloatArray) -> FloatArray:
    """Of the angle off boresight, over the same pattern: wavelength^2/(4 pi^2) times the bend of `coherence` at 0."""
    short, long = sorted(elements)
    return np.asarray((wavelength / (2 * np.pi)) ** 2 * 2 / long / (short - short**2 / (3 * long)))


def peak(height: FloatArray, at: FloatArray) -> FloatArray:
    """Place of the largest of each row, by a parabola."""
    top = np.clip(np.argmax(height, axis=1), 1, height.shape[1] - 2)
    row = np.arange(len(height))
    left, middle, right = (height[row, top + k] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    return np.asarray(at[top] + (at[1] - at[0]) * np.clip(0.5 * (left - right) / np.where(bend < 0, bend, -np.inf), -1, 1))


def surges(
    separation: FloatArray,
    squared: FloatArray,
    used: npt.NDArray[np.bool_],
    elements: tuple[float, float],
    step: float,
) -> tuple[FloatArray, FloatArray]:
    """How much farther apart phase centres were than claimed (pair,), and its standard deviation, 0 where nothing tells.

    separation, squared, used : (pair, slot): claimed separations, m, squares of coherences, and which count: least squares of
    A^2 T^2(separation + shift) over both.
    """
    shift = np.linspace(-_WIDEST, _WIDEST, _GRID) * step
    weight = used.astype(float)
    cost = np.empty((len(squared), _GRID))
    for k, move in enumerate(shift):
        model = coherence(separation + move, elements) ** 2
        size = np.sum(weight * model**2, axis=1)
        fit = np.clip(np.sum(weight * model * squared, axis=1), 0, None) ** 2
        cost[:, k] = np.sum(weight * squared**2, axis=1) - fit / np.maximum(size, 1e-9)
    best = np.argmin(cost, axis=1)
    top, row = np.clip(best, 1, _GRID - 2), np.arange(len(squared))
    left, middle, right = (cost[row, top + k] for k in (-1, 0, 1))
    bend = np.maximum(left - 2 * middle + right, 1e-30)
    spacing = shift[1] - shift[0]
    found = peak(-cost, shift)
    free = np.maximum(weight.sum(axis=1) - 2, 1)
    sigma = np.sqrt(2 * np.clip(cost.min(axis=1), 0, None) / free / (bend / spacing**2) + LEAST_SIGMA**2)
    known = (best == top) & (weight.sum(axis=1) >= 3) & (sigma < step / 2)
    return np.where(known, found, 0.0), np.where(known, sigma, 0.0)
