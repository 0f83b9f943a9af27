"""Rasters of non-uniform Fourier samples for the gridding experiments: jittered grid, asterisk, sector of a polar annulus."""

from __future__ import annotations

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray


def jittered(count: int, dimensions: int = 2, jitter: float = 0.25, seed: int = 0) -> FloatArray:
    """The even grid of unit spacing about 0, each sample displaced uniformly by at most `jitter` along each axis.

    Parameters
    ----------
    count : int
        Samples along each axis.
    dimensions : int
        1 or 2.
    jitter : float
        Nyquist spacings, >= 0. Up to 1/4 the modes are an admissible frame (Gelb and Song 2014).
    seed : int

    Returns
    -------
    (count^d, d) float64
        In order of rows.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """
    count = _checks.whole("count", count)
    if dimensions not in (1, 2):
        raise ValueError(f"dimensions={dimensions!r}: expected 1 or 2")
    jitter = _checks.number("jitter", jitter, low=0.0)
    axis = np.arange(count) - count // 2
    grid = np.stack(np.meshgrid(*[axis] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    moves = np.random.default_rng(_checks.whole("seed", seed, low=0)).uniform(-1, 1, grid.shape)
    return np.asarray(grid + jitter * moves)


def asterisk(spokes: int, count: int, extent: float) -> FloatArray:
    """Lines through the origin at even angles, `count` even samples each from -extent to extent.

    Parameters
    ----------
    spokes, count : int
    extent : float
        Nyquist spacings, > 0.

    Returns
    -------
    (spokes count, 2) float64
        In order of spokes.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """
    spokes, count = _checks.whole("spokes", spokes), _checks.whole("count", count)
    extent = _checks.number("extent", extent, positive=True)
    angle = np.pi * np.arange(spokes) / spokes
    radius = np.linspace(-extent, extent, count) if count > 1 else np.zeros(1)
    return np.stack([np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)], axis=-1).reshape(-1, 2)


def sector(angles: int, radii: int, half_angle: float, inner: float, outer: float) -> FloatArray:
    """What a side-scan SAS samples: a sector of a polar annulus about the second axis, even in angle and in radius.

    Parameters
    ----------
    angles, radii : int
    half_angle : float
        rad, in (0, pi].
    inner, outer : float
        Radii, Nyquist spacings, 0 <= inner < outer. The middle of the sector's bounding box becomes 0, as by demodulation.

    Returns
    -------
    (angles radii, 2) float64
        In order of angle.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range.
    """
    angles, radii = _checks.whole("angles", angles), _checks.whole("radii", radii)
    half_angle = _checks.number("half_angle", half_angle, low=0.0, high=np.pi)
    inner, outer = _checks.number("inner", inner, low=0.0), _checks.number("outer", outer, positive=True)
    if inner >= outer:
        raise ValueError(f"inner={inner:g}: expected less than outer={outer:g}")
    angle = np.linspace(-half_angle, half_angle, angles) if angles > 1 else np.zeros(1)
    radius = np.linspace(inner, outer, radii) if radii > 1 else np.full(1, outer)
    points = np.stack([np.outer(np.sin(angle), radius), np.outer(np.cos(angle), radius)], axis=-1).reshape(-1, 2)
    return np.asarray(points - (points.min(axis=0) + points.max(axis=0)) / 2)
