"""Layouts that a tree of sub-apertures may have on a scene, and about what they cost. No choices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pysas import subapertures
from pysas._checks import FloatArray
from pysas.costs import tree_ns
from pysas.factorised import Layout
from pysas.scene import Scene

if TYPE_CHECKING:
    from pysas.backprojection import Frame


def grounds(scene: Scene, frame: Frame) -> FloatArray:
    """Ground distances between some of the track and some of the image, sorted, m."""
    places = scene.geometry[scene.heard, :2]
    some = places[:: max(1, len(places) // 64)]
    ends = np.concatenate([frame.first, frame.first + frame.step * (frame.shape[1] - 1)])[:, :2]
    middle = (ends[: len(frame.first)] + ends[len(frame.first) :]) / 2
    pixels = np.concatenate([ends, middle])[:: max(1, len(ends) // 200)]
    return np.sort(np.linalg.norm(some[:, None] - pixels, axis=-1).ravel())


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
    rows, columns = np.linspace(0, height - 1, 24).astype(int), np.linspace(0, width - 1, 24)
    points = frame.first[rows][:, None, :2] + columns[None, :, None] * frame.step[rows][:, None, :2] - centre
    ground = np.hypot(points[..., 0], points[..., 1])
    served = ground >= subapertures.NEAR * min(layout.length, path)
    pixels = scene.pixels
    if not served.any():
        return math.inf
    row = float(np.mean(np.linalg.norm(np.diff(frame.first[:, :2], axis=0), axis=1))) if height > 1 else 0.01
    area = row * height * scene.step * width * float(np.mean(np.where(served, 1 / np.maximum(ground, 1e-9), 0)))
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
