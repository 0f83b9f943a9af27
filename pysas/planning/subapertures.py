"""Groups of pings and their polar grids: the geometry of fast factorised back-projection, free of choices.

A tree cuts the track into groups of at most `length` metres and each group into `fans[0]` parts, those into `fans[1]`, and so
on. Every group gets a polar grid about its centre that is as dense as its band needs and covers what its parent reads (the
longest groups: the image's tiles). See docs/ffbp.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from pysas._checks import FloatArray
from pysas.engine.traces import Records
from pysas.engine.tree import IntArray, SubImages, Taps

SLACK = 80  # columns behind a row's last node that a vector may touch
WIDEST = 0.1  # rad between rays, at most
NEAR = 1.15  # a group's centre stays this many lengths away from what is read from it
APART = 0.2  # rad between bearings at which a group's band is looked at, at most
DIRECTIONS = 8  # of half a turn, in which the outermost sensors are looked for
SPARE_ACROSS = 1.02  # of the band across rays: what is left to bearings and traces in between
# Where the frequency across rays turns, at broadside, the spectrum goes on beyond the highest of them as Airy's function
# does, in units of the cube root of half its second derivative. OVERLAP (by taps) such units are sampled as well, fewer
# where the filter with its taps is too short to see them.
OVERLAP, OVERLAP_REACH = {6: 3.0, 8: 4.3}, 1.6
BoolArray = npt.NDArray[np.bool_]
Ends = tuple[float, float]


@dataclass(frozen=True)
class Medium:
    """Sound speed (m/s), carrier and bandwidth (Hz); about what passes until an echo arrives where receivers move, s."""

    c: float
    fc: float
    bandwidth: float
    delay: float = 0.0


@dataclass(frozen=True)
class Group:
    """Traces of one group (positions in the tree's order); centre (3,) of their phase centres, extent (m) along axis (3,), and
    how far they lie off it (m)."""

    traces: IntArray
    centre: FloatArray
    extent: float
    axis: FloatArray
    off: float

    def distances(self, points: FloatArray) -> FloatArray:
        """At least, of points (n, 3) from any of the phase centres."""
        away = points - self.centre
        along = away @ self.axis
        beside = np.sqrt(np.maximum(np.sum(away**2, axis=1) - along**2, 0))
        return np.asarray(np.hypot(np.maximum(np.abs(along) - self.extent / 2, 0), np.maximum(beside - self.off, 0)))


def phase_centres(trace: Records, delay: float) -> FloatArray:
    """Middle of transmitter and receiver at reception, (trace, 3)."""
    return np.asarray((trace["tx"] + trace["rx"] + delay * trace["velocity"]) / 2)


def group(traces: IntArray, centres: FloatArray) -> tuple[Group, FloatArray]:
    """A group and its traces' places along its longest axis."""
    points = centres[traces]
    middle = points.mean(axis=0)
    axis = np.linalg.eigh(np.cov(points - middle, rowvar=False) if len(points) > 1 else np.eye(3))[1][:, -1]
    along = (points - middle) @ axis
    low, high = float(along.min()), float(along.max())
    off = float(np.linalg.norm(points - middle - np.outer(along, axis), axis=1).max())
    axis = axis if high > low else np.array([1.0, 0, 0])
    return Group(traces, middle + axis * (low + high) / 2, high - low, axis, off), along


def by_ping(centres: FloatArray, pings: IntArray) -> tuple[FloatArray, IntArray]:
    """Means of the phase centres of each ping, and which of them a trace's is; `pings` says which ping a trace is of."""
    _, place, count = np.unique(pings, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(place, axis) for axis in centres.T], axis=1) / count[:, None], place


def cut_track(centres: FloatArray, pings: IntArray, length: float) -> list[IntArray]:
    """Runs of consecutive pings of about equal path, at most `length` metres; `pings` says which ping a trace is of."""
    middle, place = by_ping(centres, pings)
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    pieces = max(1, int(np.ceil(path[-1] / length)))
    number = np.minimum((path / max(path[-1], 1e-300) * pieces).astype(np.int64), pieces - 1)[place]
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


def split(parent: Group, along: FloatArray, fan: int) -> list[IntArray]:
    """A group's traces in `fan` stretches of equal length, empty ones left out."""
    low, high = along.min(), along.max()
    number = np.minimum(((along - low) / max(high - low, 1e-300) * fan).astype(np.int64), fan - 1)
    return [parent.traces[number == i] for i in range(fan) if np.any(number == i)]


@dataclass(frozen=True)
class Bands:
    """Highest frequencies of a group's sub-image: rad a radian across its rays, and how fast that changes (second derivative),
    cycles a metre of slant range along them."""

    across: float
    bend: float
    along: float


def _slopes(g: Records, members: Group, medium: Medium, plane: float, angle: FloatArray, ground: FloatArray) -> FloatArray:
    """Of traces' two-way times (2, trace, ground, angle): across, along a ground distance's arc, and along slant range."""
    ground = ground[:, None]
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    side = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    place = np.array([members.centre[0], members.centre[1], plane]) + ground[..., None] * out  # (ground, angle, 3)
    g = g[:, None, None]
    there, back = place - g["tx"], place - g["rx"]
    way, speed = np.linalg.norm(there, axis=-1, keepdims=True), np.linalg.norm(g["velocity"], axis=-1)
    back = back - (way + np.linalg.norm(back, axis=-1, keepdims=True)) / medium.c * g["velocity"]
    slope = there / np.maximum(way, 1e-9) + back / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-9)
    slope /= (medium.c - speed)[..., None]
    lateral = np.sum(slope * side, axis=-1) * ground
    radial = np.sum(slope * out, axis=-1) * slant(ground, members.centre[2] - plane) / np.maximum(ground, 1e-9)
    return np.stack([lateral, radial])


def _outermost(members: Group, trace: Records, medium: Medium, plane: float, angles: Ends, grounds: Ends) -> Records:
    """Traces of which one has a phase as steep as any: those at a group's ends in all directions, and, where transmitter and
    receiver are apart, those whose phases are the steepest at places of the sub-image.

    All traces are looked at: one that differs from its neighbours may be the outermost.
    """
    g = trace.take(members.traces)
    if len(g) <= 4:
        return g
    angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    axes = np.concatenate([np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [[0.0, 0.0, 1.0]]])
    tx, rx = g["tx"] - members.centre, g["rx"] + medium.delay * g["velocity"] - members.centre
    places = [(tx + rx) @ axes.T]
    if np.any(tx != rx):
        wide = int(np.clip(math.ceil((angles[1] - angles[0]) / (np.pi / DIRECTIONS)) + 1, 3, 2 * DIRECTIONS + 1))
        slopes = _slopes(g, members, medium, plane, np.linspace(*angles, wide), np.array(grounds))
        places += [slope.reshape(len(g), -1) for slope in slopes]
    return g.take(np.unique(np.concatenate([end(at, axis=0) for at in places for end in (np.argmin, np.argmax)])))


def bands(members: Group, trace: Records, medium: Medium, plane: float, angles: Ends, grounds: Ends) -> Bands:
    """Of a group over bearings and ground distances, all its traces looked at.

    A trace's echo of base-band frequency f at two-way time tau varies as exp(2j pi ((fc + f) tau - fc tau_0)), tau_0 that of
    the centre: its phase's gradient, with f = +-B/2. Between the bearings looked at it exceeds what is found there by at most
    an eighth of its second derivative times their distance squared.
    """
    count = max(5, math.ceil(min((angles[1] - angles[0]) / APART, 64.0)) + 1)
    g = _outermost(members, trace, medium, plane, angles, grounds)
    lateral, radial = _slopes(g, members, medium, plane, np.linspace(*angles, count), np.linspace(*grounds, 3))
    bend = float(np.max(np.abs(np.diff(lateral, 2, axis=-1))))
    half = medium.bandwidth / 2
    turns = 2 * np.pi * (medium.fc + half)
    along = float(np.max(half * np.abs(radial) + medium.fc * np.abs(radial - 2 / medium.c)))
    step = (angles[1] - angles[0]) / (count - 1)
    return Bands(turns * (float(np.max(np.abs(lateral))) + bend / 8), turns * bend / step**2, along)


def spacing(
    members: Group, trace: Records, medium: Medium, plane: float, angles: Ends, slants: Ends, step: float, taps: Taps
) -> tuple[float, float]:
    """Between rays that serve reads at bearings and slant ranges, rad, and the highest frequency along them, cycles a metre.

    Nodes beside the reads count too, as far as taps and filter reach, so that the spacing depends on itself: each second try
    is safe.
    """
    height = members.centre[2] - plane
    near, inner = (float(ground(np.array(slants[0] - more), height)) for more in (0, taps.reach * step))
    grounds = max(inner, near / 2), float(ground(np.array(slants[1] + taps.reach * step), height))
    beam, outer, along = 0.0, 1e-3, 0.0
    for attempt in range(4):
        found = bands(members, trace, medium, plane, (angles[0] - outer, angles[1] + outer), grounds)
        sway, across = float(np.cbrt(found.bend / 2)), max(found.across, 1e-9)
        seen = OVERLAP_REACH * taps.reach * sway * min(WIDEST, np.pi / (taps.rate * across))
        more = OVERLAP[taps.width] * min(1.0, seen) * sway
        before, beam = beam, min(WIDEST, np.pi / (taps.rate * (SPARE_ACROSS * across + more)))
        if attempt % 2:
            along = max(along, found.along)
        if attempt == 1 and beam >= 0.97 * before:
            break
        outer = taps.reach * beam
    return float(beam), along


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
    highest: float  # frequency along any ray, its children's too

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
    members: Group, along: FloatArray, fans: tuple[int, ...], trace: Records, centres: FloatArray, medium: Medium,
    plane: float, angle: float, bearings: FloatArray, slants: FloatArray, step: float, taps: Taps, left: int,
) -> _Node | None:  # fmt: skip
    """A node whose reads lie at bearings (n, 2) from `angle` and slant ranges (n, 2), and all below it; None where these have
    more than `left` nodes."""
    low, high = float(bearings.min()), float(bearings.max())
    beam, highest = spacing(
        members, trace, medium, plane, (angle + low, angle + high), (float(slants.min()), float(slants.max())), step, taps
    )
    if (high - low) / beam * (slants.max() - slants.min()) / step > left:
        return None
    first, begin, end = _cover(bearings / beam, slants / step, taps)
    node = _Node(members, along, angle, beam, first, begin, end, [], highest)
    left -= int(np.sum(end - begin))
    if left < 0:
        return None
    if fans:
        rays, ends = node.outline(step)
        away = ground(ends, members.centre[2] - plane)
        for traces in split(members, along, fans[0]):
            part, place = group(traces, centres)
            offset = members.centre[:2] - part.centre[:2]
            ahead = offset[0] * np.cos(rays) + offset[1] * np.sin(rays)
            aside = offset[1] * np.cos(rays) - offset[0] * np.sin(rays)
            theirs = np.maximum(np.hypot(away + ahead[:, None], aside[:, None]), 1e-9)
            bearing = (rays - angle)[:, None] + np.arcsin(np.clip(aside[:, None] / theirs, -1, 1))
            child = _tree(
                part, place, fans[1:], trace, centres, medium, plane, angle, np.sort(bearing, axis=1),
                np.sort(slant(theirs, part.centre[2] - plane), axis=1), step, taps, left,
            )  # fmt: skip
            if child is None:
                return None
            node.children.append(child)
            node.highest = max(node.highest, child.highest)
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
    """One of the longest groups: its traces in the leaves' order, levels, leaves first, and the highest frequency along any of
    their rays (cycles a metre)."""

    traces: IntArray
    levels: tuple[SubImages, ...]
    along: float


def make_subtree(
    members: Group, along: FloatArray, fans: tuple[int, ...], trace: Records, centres: FloatArray, medium: Medium,
    plane: float, reads: Readings, step: float, taps: Taps, left: int,
) -> Subtree | None:  # fmt: skip
    """The tree below one of the longest groups, for what is read from it.

    None where it would have more than about `left` nodes.
    """
    angle, bearings, grounds = reads.direction, reads.bearings, reads.grounds
    slants = slant(grounds, members.centre[2] - plane)
    root = _tree(members, along, fans, trace, centres, medium, plane, angle, bearings, slants, step, taps, left)
    if root is None:
        return None
    levels = [[root]]
    while levels[-1][0].children:
        levels.append([child for node in levels[-1] for child in node.children])
    built = []
    for depth, nodes in enumerate(levels):
        below = [len(node.children) if depth + 1 < len(levels) else len(node.members.traces) for node in nodes]
        built.append(_level(nodes, below, plane, step))
    traces = np.concatenate([node.members.traces for node in levels[-1]])
    return Subtree(traces, tuple(built[::-1]), root.highest)
