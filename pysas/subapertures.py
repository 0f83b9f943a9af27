"""Groups of pings and their polar grids: the geometry of fast factorised back-projection, free of choices.

A tree cuts the track into groups of at most `length` metres and each group into `fans[0]` parts, those into `fans[1]`, and so
on. Every group gets a polar grid about its centre that is as dense as its band needs and covers what its parent reads (the
longest groups: the image's tiles). See docs/ffbp.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from pysas._checks import FloatArray
from pysas.engine import growth
from pysas.engine.tree import IntArray, SubImages, Taps

SLACK = 80  # columns behind a row's last node that a vector may touch
WIDEST = 0.1  # rad between rays, at most
NEAR = 1.15  # a group's centre stays this many lengths away from what is read from it
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Medium:
    """Sound speed (m/s), carrier and bandwidth (Hz)."""

    c: float
    fc: float
    bandwidth: float


@dataclass(frozen=True)
class Group:
    """Traces of one group (positions in the tree's order), centre (3,) of their phase centres, extent (m) along axis (3,)."""

    traces: IntArray
    centre: FloatArray
    extent: float
    axis: FloatArray


def phase_centres(geometry: FloatArray, delay: float) -> FloatArray:
    """Middle of transmitter and receiver at reception, (trace, 3)."""
    return np.asarray((geometry[:, 0:3] + geometry[:, 3:6] + delay * geometry[:, 6:9]) / 2)


def group(traces: IntArray, centres: FloatArray) -> tuple[Group, FloatArray]:
    """A group and its traces' places along its longest axis."""
    points = centres[traces]
    middle = points.mean(axis=0)
    axis = np.linalg.eigh(np.cov(points - middle, rowvar=False) if len(points) > 1 else np.eye(3))[1][:, -1]
    along = (points - middle) @ axis
    low, high = float(along.min()), float(along.max())
    return Group(traces, middle + axis * (low + high) / 2, high - low, axis if high > low else np.array([1.0, 0, 0])), along


def onto(points: FloatArray, members: Group, plane: float) -> tuple[FloatArray, FloatArray]:
    """Where the plane has the points' (..., 3) slant range and place along a group's axis, and how far beside that axis (...).

    A group on a line sees the two alike. NaN where the plane has no such place.
    """
    across = float(np.linalg.norm(members.axis[:2]))
    if across < 0.7:
        return np.full(points.shape, np.nan), np.full(points.shape[:-1], np.nan)
    ahead = members.axis[:2] / across
    beside = np.array([-ahead[1], ahead[0]])
    away = points - members.centre
    height = members.centre[2] - plane
    along = (away @ members.axis + height * members.axis[2]) / across
    square = np.sum(away**2, axis=-1) - height**2 - along**2
    side = away[..., :2] @ beside
    off = np.copysign(np.sqrt(np.where(square > 0, square, np.nan)), side)
    place = members.centre[:2] + along[..., None] * ahead + off[..., None] * beside
    return np.concatenate([place, np.full((*off.shape, 1), plane)], axis=-1), np.minimum(np.abs(off), np.abs(side))


def cut_track(centres: FloatArray, pings: IntArray, length: float) -> list[IntArray]:
    """Runs of consecutive pings of about equal path, at most `length` metres; `pings` says which ping a trace is of."""
    _, place, count = np.unique(pings, return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(place, axis) for axis in centres.T], axis=1) / count[:, None]
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    pieces = max(1, int(np.ceil(path[-1] / length)))
    number = np.minimum((path / max(path[-1], 1e-300) * pieces).astype(np.int64), pieces - 1)[place]
    return [np.flatnonzero(number == i) for i in range(pieces) if np.any(number == i)]


def split(parent: Group, along: FloatArray, fan: int) -> list[IntArray]:
    """A group's traces in `fan` stretches of equal length, empty ones left out."""
    low, high = along.min(), along.max()
    number = np.minimum(((along - low) / max(high - low, 1e-300) * fan).astype(np.int64), fan - 1)
    return [parent.traces[number == i] for i in range(fan) if np.any(number == i)]


def bands(
    members: Group, geometry: FloatArray, medium: Medium, plane: float, angles: FloatArray, grounds: FloatArray
) -> tuple[float, float]:
    """Highest frequencies of a group's sub-image: cycles a radian and cycles a metre of slant range.

    A trace's echo of base-band frequency f at two-way time tau varies as exp(2j pi ((fc + f) tau - fc tau_0)), tau_0 that of
    the centre: its phase's gradient, with f = +-B/2, at the places given.
    """
    geometry = geometry[members.traces]
    if len(geometry) > 16:  # extremes along and across
        offset = phase_centres(geometry, 0.0) - members.centre
        axes = np.linalg.eigh(np.cov(offset, rowvar=False))[1]
        along = offset @ axes
        even = np.arange(0, len(along), max(1, len(along) // 6))
        picked = np.unique(np.concatenate([along.argmin(axis=0), along.argmax(axis=0), even]))
        geometry = geometry[picked]
    angle, ground = (a.ravel() for a in np.meshgrid(angles, grounds, indexing="ij"))
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    side = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    place = np.array([members.centre[0], members.centre[1], plane]) + ground[:, None] * out
    slope = np.zeros((len(geometry), len(place), 3))
    for sensor in (geometry[:, 0:3], geometry[:, 3:6]):
        away = place - sensor[:, None]
        slope += away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    speed = np.linalg.norm(geometry[:, 6:9], axis=1)[:, None]
    slope /= (medium.c - speed)[..., None]
    height = members.centre[2] - plane
    radial, lateral = np.sum(slope * out, axis=-1), np.sum(slope * side, axis=-1) * ground
    radial *= np.sqrt(ground**2 + height**2) / np.maximum(ground, 1e-9)  # along slant range
    half = medium.bandwidth / 2
    return (
        float(np.max(np.abs(lateral))) * (medium.fc + half),
        float(np.max(half * np.abs(radial) + medium.fc * np.abs(radial - 2 / medium.c))),
    )


def slant(ground: FloatArray, height: float) -> FloatArray:
    """Slant range of the ground at a horizontal distance from a place at `height`."""
    return np.asarray(np.hypot(ground, height))


def ground(slant: FloatArray, height: float) -> FloatArray:
    """The inverse; 0 where the ground is farther."""
    return np.asarray(np.sqrt(np.maximum(slant**2 - height**2, 0)))


def _cover(beams: FloatArray, nodes: FloatArray, taps: Taps) -> tuple[int, IntArray, IntArray]:
    """First ray, and raw node ranges of all rays, that serve reads at `beams` (n, 2) x `nodes` (n, 2), lowest and highest."""
    before = taps.width // 2
    low = np.floor(beams[:, 0]).astype(np.int64) - before
    high = np.floor(beams[:, 1]).astype(np.int64) + before + 1
    first = int(low.min()) - taps.half
    rays = int(high.max()) + taps.half + 1 - first
    count = high - low + 1
    at = np.repeat(low - first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(count.sum())
    begin, end = np.full(rays, 2**30, dtype=np.int64), np.full(rays, -(2**30), dtype=np.int64)
    np.minimum.at(begin, at, np.repeat(np.floor(nodes[:, 0]).astype(np.int64) - before - 1, count))
    np.maximum.at(end, at, np.repeat(np.floor(nodes[:, 1]).astype(np.int64) + before + 3, count))
    size = 2 * taps.half + 1
    begin = minimum_filter1d(begin, size, mode="nearest") - taps.half
    end = maximum_filter1d(end, size, mode="nearest") + taps.half
    empty = begin >= end
    begin[empty] = end[empty] = 0
    return first, begin, end


@dataclass
class _Node:
    members: Group
    along: FloatArray
    angle: float  # the direction that its rays are numbered from
    beam: float  # rad between rays
    first: int  # number of its first ray
    begin: npt.NDArray[np.int64]
    end: npt.NDArray[np.int64]
    children: list[_Node]

    def outline(self, step: float) -> tuple[FloatArray, FloatArray]:
        """Angles (ray,) and slant ranges (ray, 2) of the raw nodes' ends."""
        used = np.flatnonzero(self.begin < self.end)
        ends = np.stack([self.begin[used], self.end[used] - 1], axis=1) * step
        return np.asarray(self.angle + (self.first + used) * self.beam), ends


@dataclass(frozen=True)
class Readings:
    """What one of the longest groups is read at: bearings (n, 2) from a middle direction and ground distances (n, 2) of tiles,
    lowest and highest."""

    direction: float
    bearings: FloatArray
    grounds: FloatArray


def seen_from(corners: FloatArray, centre: FloatArray) -> Readings:
    """Of tiles by their corners (tile, corner, 3), seen from `centre`."""
    x, y = corners[..., 0] - centre[0], corners[..., 1] - centre[1]
    angle = np.arctan2(y.sum(axis=1), x.sum(axis=1))
    # the direction opposite the widest gap between the tiles
    ordered = np.sort(angle)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    direction = float(ordered[widest] + gaps[widest] / 2 + np.pi)
    bearing = (angle - direction + np.pi) % (2 * np.pi) - np.pi
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    depth, side = x * cosine + y * sine, y * cosine - x * sine
    own, away = np.arctan2(side, depth), np.hypot(x, y)
    nearest = np.minimum(away.min(axis=1), depth.min(axis=1))  # an edge may pass nearer than its ends
    return Readings(
        direction,
        bearing[:, None] + np.stack([own.min(axis=1), own.max(axis=1)], axis=1),
        np.stack([nearest, away.max(axis=1)], axis=1),
    )


def _tree(
    members: Group, along: FloatArray, fans: tuple[int, ...], geometry: FloatArray, centres: FloatArray, medium: Medium,
    plane: float, angle: float, bearings: FloatArray, slants: FloatArray, step: float, taps: Taps, spare: float,
) -> _Node:  # fmt: skip
    """A node whose reads lie at bearings (n, 2) from `angle` and slant ranges (n, 2), and all below it."""
    height = members.centre[2] - plane
    low, high = float(bearings.min()), float(bearings.max())
    near, far = ground(np.array([slants.min(), slants.max()]), height)
    lateral, _ = bands(
        members, geometry, medium, plane, angle + np.linspace(low, high, 9), np.linspace(near, far, 3)
    )  # fmt: skip
    beam = min(WIDEST, 1 / (2 * taps.rate * spare * max(lateral, 1e-9)))
    first, begin, end = _cover(bearings / beam, slants / step, taps)
    node = _Node(members, along, angle, beam, first, begin, end, [])
    if fans:
        rays, ends = node.outline(step)
        away = ground(ends, height)
        for traces in split(members, along, fans[0]):
            child, place = group(traces, centres)
            offset = members.centre[:2] - child.centre[:2]
            ahead = offset[0] * np.cos(rays) + offset[1] * np.sin(rays)
            aside = offset[1] * np.cos(rays) - offset[0] * np.sin(rays)
            theirs = np.hypot(away + ahead[:, None], aside[:, None])
            bearing = (rays - angle)[:, None] + np.arcsin(aside[:, None] / theirs)
            node.children.append(
                _tree(
                    child, place, fans[1:], geometry, centres, medium, plane, angle, np.sort(bearing, axis=1),
                    np.sort(slant(theirs, child.centre[2] - plane), axis=1), step, taps, spare,
                )
            )  # fmt: skip
    return node


def _level(nodes: list[_Node], spans: list[int], plane: float, step: float) -> SubImages:
    place = np.empty((len(nodes), 7))
    shape = np.empty((len(nodes), 5), dtype=np.int64)
    ranges, offset, rays = [], 0, 0
    for i, node in enumerate(nodes):
        used = node.begin < node.end
        i0 = int(node.begin[used].min())
        width = int(node.end[used].max()) - i0
        stride = -(-(width + SLACK) // 16) * 16
        stride += 16 * (stride % 512 == 0)  # rows must not share cache sets
        place[i] = *node.members.centre, plane, node.angle + node.first * node.beam, node.beam, step
        shape[i] = i0, len(node.begin), stride, offset, rays
        ranges.append(np.where(used[:, None], np.stack([node.begin, node.end], axis=1) - i0, 0))
        offset += 2 * len(node.begin) * stride
        rays += len(node.begin)
    span = np.concatenate([[0], np.cumsum(spans)]).astype(np.int64)
    return SubImages(place, shape, np.concatenate(ranges).astype(np.int32), span, offset)


@dataclass(frozen=True)
class Subtree:
    """One of the longest groups: its traces in the leaves' order, and levels, leaves first."""

    traces: IntArray
    levels: tuple[SubImages, ...]


def plant(
    members: Group, along: FloatArray, fans: tuple[int, ...], geometry: FloatArray, centres: FloatArray, medium: Medium,
    plane: float, reads: Readings, step: float, taps: Taps, spare: float, compiled: bool = False,
) -> Subtree:  # fmt: skip
    """The tree below one of the longest groups, for what is read from it; `compiled` by C++, an order of magnitude faster."""
    angle, bearings, grounds = reads.direction, reads.bearings, reads.grounds
    if compiled:
        sound = np.array([medium.c, medium.fc, medium.bandwidth])
        ends = np.concatenate([bearings, grounds], axis=1)
        return Subtree(*growth.plant(geometry, centres, members.traces, sound, fans, taps, spare, plane, angle, ends, step))
    slants = slant(grounds, members.centre[2] - plane)
    root = _tree(members, along, fans, geometry, centres, medium, plane, angle, bearings, slants, step, taps, spare)
    levels = [[root]]
    while levels[-1][0].children:
        levels.append([child for node in levels[-1] for child in node.children])
    built = []
    for depth, nodes in enumerate(levels):
        below = [len(node.children) if depth + 1 < len(levels) else len(node.members.traces) for node in nodes]
        built.append(_level(nodes, below, plane, step))
    traces = np.concatenate([node.members.traces for node in levels[-1]])
    return Subtree(traces, tuple(built[::-1]))
