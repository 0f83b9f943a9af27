"""Layouts that a tree of sub-apertures may have on a scene, and about what they cost. No choices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.optimize

from pysas import subapertures
from pysas._checks import FloatArray
from pysas.costs import tree_ns
from pysas.forest import Layout
from pysas.scene import Scene

if TYPE_CHECKING:
    from pysas.backprojection import Frame


def grounds(scene: Scene, frame: Frame) -> FloatArray:
    """Ground distances between some of the track and some of the image, sorted, m."""
    places = scene.geometry[scene.heard, :2]
    some = places[:: max(1, len(places) // 64)]
    pixels = _sample(frame, 24).reshape(-1, 3)[:, :2]
    return np.sort(np.linalg.norm(some[:, None] - pixels, axis=-1).ravel())


def _sample(frame: Frame, most: int) -> FloatArray:
    """Some pixels (row, column, 3), the image's edges among them."""
    rows, columns = (np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64)) for n in frame.shape)
    return frame.some(rows, columns)


def lengths(scene: Scene, away: FloatArray) -> list[float]:
    """Candidates for the longest groups: fractions of the ground distances `away` of the image, at most the track."""
    places = scene.geometry[scene.heard, :2]
    track = float(np.linalg.norm(np.ptp(places, axis=0)))
    limits = [float(np.quantile(away, q)) / subapertures.NEAR for q in (0.0, 0.1)]
    found = {min(limit * part, track + 1e-3) for limit in limits for part in (0.95, 0.5, 0.25, 0.12)}
    return sorted(v for v in found if v > 0)


def seconds(scene: Scene, frame: Frame, layout: Layout, runs: str) -> float:
    """Predicted seconds of all groups on one thread of `runs`, from a group in the middle of the track."""
    traces = np.flatnonzero(scene.heard)
    places = scene.geometry[traces, :2]
    path = float(np.sum(np.linalg.norm(np.diff(places[:: max(1, len(places) // 256)], axis=0), axis=1)))
    groups = max(1, math.ceil(path / layout.length))
    centre = places[len(places) // 2]
    height, width = frame.shape
    pixel = _sample(frame, 24)
    points = pixel[..., :2] - centre
    ground = np.hypot(points[..., 0], points[..., 1])
    served = ground >= subapertures.NEAR * min(layout.length, path)
    pixels = scene.pixels
    if not served.any():
        return math.inf
    # the image's area by its corners' spans; a single line is as wide as it is dense
    down = float(np.mean(np.linalg.norm(pixel[-1] - pixel[0], axis=-1))) or 0.01
    across = float(np.mean(np.linalg.norm(pixel[:, -1] - pixel[:, 0], axis=-1))) or 0.01
    area = down * across * float(np.mean(np.where(served, 1 / np.maximum(ground, 1e-9), 0)))
    bearing = np.arctan2(points[..., 1], points[..., 0])[served]
    turn = np.angle(np.mean(np.exp(1j * bearing)))
    spread = float(np.ptp(np.angle(np.exp(1j * (bearing - turn)))))
    depth = float(np.ptp(ground[served]))
    taps, reach = layout.taps, 2 * layout.taps.reach
    step = scene.c / (4 * scene.band * scene.fs * taps.rate * layout.spare)
    shortest = scene.c / (scene.fc + scene.band * scene.fs)
    length = min(layout.length, path) + 1e-6
    nodes = []
    for fan in (*layout.fans, 0):
        beam = min(subapertures.WIDEST, shortest / (2 * taps.rate * layout.spare * length))
        rays = spread / beam
        mean = area / max(spread, 1e-9)
        nodes.append((rays + reach) * (min(mean + reach * beam * mean, depth + mean) / step + reach))
        length /= max(fan, 1)
    leaf_term, leaf, merge, read = tree_ns(taps.width, runs)
    per_leaf = len(traces) / groups / math.prod(layout.fans)
    work = nodes[-1] * math.prod(layout.fans) * (per_leaf * leaf_term + leaf)
    parts = 1
    for level, fan in enumerate(layout.fans):
        work += parts * nodes[level] * fan * merge
        parts *= fan
    part = float(np.mean(served))
    return float(1e-9 * (groups * (work + pixels * part * read) + len(traces) * pixels * (1 - part) * leaf_term))


def clear(scene: Scene, height: float, extent: float, rate: float, error: float) -> float:
    """Slant range from which the delay polynomials of a leaf's rays hold to within `error`, for leaves of `extent` m at most
    `height` up.

    Along a ray of constant bearing a sensor at p from the centre is r - p.x/r + (p^2 - (p.x/r)^2)/2r + ... away, where x/r has
    the components sqrt(1 - (height/r)^2) = 1 - sum a_k (height/r)^2k along the ground, a_k > 0, and height/r. Polynomials
    through 5 Chebyshev nodes of |s| <= h are wrong by at most h^5/(5! 2^4) of the fifth derivative, on both ways.
    """
    heard = scene.geometry[scene.heard]
    reach = extent / 2 + float(np.max(np.linalg.norm(heard[:, 0:3] - heard[:, 3:6], axis=1))) / 2
    half = 31.5 * scene.c / (4 * scene.band * scene.fs * rate)
    k = np.arange(1, 400)
    powers = np.cumprod(np.concatenate([[0.5], (k[:-1] - 0.5) / (k[:-1] + 1)])) * np.prod(2 * k[:, None] + np.arange(5), axis=1)

    def wrong(slant: float) -> float:
        lateral = float(powers @ np.exp(2 * k * np.log(max(height, 1e-9) / slant))) / slant**5
        fifth = reach * lateral + 120 * reach * (height + 2 * reach) / slant**6
        return 2 * 2 * np.pi * scene.fc / scene.c * fifth * half**5 / 1920 - error

    low, high = max(height, 1e-3) * (1 + 1e-6), 1e3 * (height + reach + half)
    if wrong(high) >= 0:
        return math.inf
    return low if wrong(low) <= 0 else float(scipy.optimize.brentq(wrong, low, high, rtol=1e-3))
