"""Layouts that a tree of sub-apertures may have on a scene, and about what they cost."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from pysas._checks import FloatArray
from pysas.engine.tree import Taps
from pysas.planning import bounds, subapertures
from pysas.planning.costs import tree_ns
from pysas.planning.forest import Layout, reception
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene

HELD = 0.45  # cycles a sample: nodes for as much hold all that W passes, as taps fail slowly beyond their band


def _track(scene: Scene) -> FloatArray:
    """Mean phase centres of the traces heard of each ping, seen from above."""
    centres = subapertures.phase_centres(scene.trace.compress(scene.heard), reception(scene))
    return subapertures.by_ping(centres, np.flatnonzero(scene.heard) // scene.channels)[0][:, :2]


def grounds(scene: Scene, raster: Raster) -> FloatArray:
    """Ground distances between some of the track and some of the image, m."""
    places = _track(scene)
    some = places[:: max(1, len(places) // 64)]
    pixels = _sample(raster, 24).reshape(-1, 3)
    return np.sqrt((some[:, :1] - pixels[:, 0]) ** 2 + (some[:, 1:] - pixels[:, 1]) ** 2).ravel()


def _sample(raster: Raster, most: int) -> FloatArray:
    """Some pixels (row, column, 3), the image's edges among them."""
    rows, columns = (np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64)) for n in raster.shape)
    return raster.some(rows, columns)


def lengths(scene: Scene, away: FloatArray) -> list[float]:
    """Candidates for the longest groups: fractions of the ground distances `away` of the image, at most the track."""
    places = _track(scene)
    track = float(np.linalg.norm(np.ptp(places, axis=0)))
    limits = [float(np.quantile(away, q)) / subapertures.NEAR for q in (0.0, 0.1)]
    found = {min(limit * part, track + 1e-3) for limit in limits for part in (0.95, 0.5, 0.25, 0.12)}
    return sorted(v for v in found if v > 0)


@dataclass(frozen=True)
class _View:
    """The image from the middle one of groups of at most `length` m."""

    length: float
    groups: int
    served: float  # share of the pixels that are far enough away along the ground
    area: float  # of these, over their ground distances, m
    spread: float  # of their bearings, rad
    depth: float  # of their ground distances, m


def _views(scene: Scene, raster: Raster) -> list[_View]:
    """By candidate length, those that serve any pixel."""
    places = _track(scene)
    path = float(np.sum(np.linalg.norm(np.diff(places[:: max(1, len(places) // 256)], axis=0), axis=1)))
    centre = places[len(places) // 2]
    pixel = _sample(raster, 24)
    points = pixel[..., :2] - centre
    ground = np.hypot(points[..., 0], points[..., 1])
    bearings = np.arctan2(points[..., 1], points[..., 0])
    # the image's area by its corners' spans; a single line is as wide as it is dense
    down = float(np.mean(np.linalg.norm(pixel[-1] - pixel[0], axis=-1))) or 0.01
    across = float(np.mean(np.linalg.norm(pixel[:, -1] - pixel[:, 0], axis=-1))) or 0.01
    found = []
    for length in lengths(scene, grounds(scene, raster)):
        served = ground >= subapertures.NEAR * min(length, path)
        if served.any():
            area = down * across * float(np.mean(np.where(served, 1 / np.maximum(ground, 1e-9), 0)))
            bearing = bearings[served]
            turn = np.angle(np.mean(np.exp(1j * bearing)))
            spread = float(np.ptp(np.angle(np.exp(1j * (bearing - turn)))))
            groups, depth = max(1, math.ceil(path / length)), float(np.ptp(ground[served]))
            found.append(_View(min(length, path) + 1e-6, groups, float(np.mean(served)), area, spread, depth))
    return found


def cheapest(
    scene: Scene, raster: Raster, kinds: list[tuple[tuple[int, ...], Taps]], runs: str, spare: float, direct: float
) -> tuple[Layout, float] | None:
    """Of layouts of the `kinds` (fans, taps), that of the least predicted time, and its seconds on one thread if it served all
    pixels; None where none serves any.

    What is not served costs its share of `direct`, s; served are, to begin with, pixels far enough along the ground.
    """
    best: tuple[float, Layout, float] | None = None
    for view in _views(scene, raster):
        for fans, taps in kinds:
            layout = Layout(view.length, fans, taps, spare, 0.0, 0.0, 0.0)
            trees = _seconds(scene, view, layout, runs)
            cost = trees + (1 - view.served) * direct
            if best is None or cost < best[0]:
                best = cost, layout, trees / view.served
    return None if best is None else best[1:]


def _seconds(scene: Scene, view: _View, layout: Layout, runs: str) -> float:
    """Predicted time of all groups on one thread of `runs`."""
    taps, reach = layout.taps, 2 * layout.taps.reach
    step = scene.c / (4 * scene.band * scene.fs * taps.rate * layout.spare)
    shortest = scene.c / (scene.fc + scene.band * scene.fs)
    length = layout.length
    nodes = []
    for fan in (*layout.fans, 0):
        beam = min(subapertures.WIDEST, shortest / (2 * taps.rate * layout.spare * length))
        rays = view.spread / beam
        mean = view.area / max(view.spread, 1e-9)
        nodes.append((rays + reach) * (min(mean + reach * beam * mean, view.depth + mean) / step + reach))
        length /= max(fan, 1)
    leaf_term, leaf, merge, read = tree_ns(taps.width, runs)
    per_leaf = int(np.count_nonzero(scene.heard)) / view.groups / math.prod(layout.fans)
    work = nodes[-1] * math.prod(layout.fans) * (per_leaf * leaf_term + leaf)
    parts = 1
    for level, fan in enumerate(layout.fans):
        work += parts * nodes[level] * fan * merge
        parts *= fan
    return float(1e-9 * view.groups * (work + scene.pixels * view.served * read))


def cleared(scene: Scene, layout: Layout, height: float, error: float, merge: float, ends: float) -> Layout:
    """A layout with the slant ranges that its nodes must have, whose sensors stand at most `height` up, and its distance from
    records' ends.

    `error` : for the delays along leaves' rays; `merge` : for each merge, whose children lie off their parent's centre;
    `ends` : for what a record's end rings with beyond the band that nodes hold.
    """
    heard = scene.trace.compress(scene.heard)
    baseline = float(np.max(np.linalg.norm(heard["tx"] - heard["rx"], axis=1)))
    extents = layout.length / np.cumprod([1, *layout.fans])
    away = [_clear(scene, height, (extent - part) / 2, layout.taps.rate, merge) for extent, part in itertools.pairwise(extents)]
    away.append(_clear(scene, height, (extents[-1] + baseline) / 2, layout.taps.rate, error))
    held = layout.spare * scene.band >= HELD
    return replace(
        layout, clear=away[0], apart=max(away[1:], default=0.0), ends=0.0 if held else bounds.hushed(ends, scene.band)
    )


def _clear(scene: Scene, height: float, reach: float, rate: float, error: float) -> float:
    """Slant range from which polynomials of degree 4 along 64 nodes of a ray hold to within `error` rad for the two-way delay
    of what lies `reach` m off the centre, the centre's own taken away, at most `height` up.

    Along a ray of constant bearing a sensor at p from the centre is r - p.x/r + (p^2 - (p.x/r)^2)/2r + ... away, where x/r has
    the components sqrt(1 - (height/r)^2) = 1 - sum a_k (height/r)^2k along the ground, a_k > 0, and height/r. Polynomials
    through 5 Chebyshev nodes of |s| <= h are wrong by at most h^5/(5! 2^4) of the fifth derivative, on both ways.
    """
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
