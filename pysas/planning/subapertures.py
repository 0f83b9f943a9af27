"""Groups of pings and their polar grids: the geometry of fast factorised back-projection, free of choices.

Every group gets a polar grid about its centre that is as dense as the band of its sub-image needs, and covers the tiles of the
image that are read from it. See docs/ffbp.md.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.engine.traces import TILE_ROWS, Records
from pysas.engine.tree import PolarGrid, Taps

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Ends = tuple[float, float]

WIDEST = 0.1  # rad between rays, at most
APART = 0.2  # rad between bearings at which a group's band is looked at, at most
AT_ONCE = 256  # traces whose bands are looked at at a time
SPARE, SPARE_ACROSS = 1.05, 1.02  # of the band along and across rays: what is left to bearings, ranges and traces in between
# Where the frequency across rays turns, at broadside, the spectrum goes on beyond the highest of them as Airy's function
# does, in units of the cube root of half its second derivative: so many such units are sampled as well.
OVERLAP = 4.3


class Medium(Protocol):
    """Sound speed (m/s), carrier and sample rate (Hz), half the bandwidth by sample rate: a Scene is one."""

    c: float
    fc: float
    fs: float
    band: float


def node(medium: Medium, taps: Taps) -> float:
    """From one node of a ray to the next, m, at most: what the echoes' bandwidth asks for."""
    return medium.c / (4 * medium.band * medium.fs * taps.rate)


def cut_track(centres: FloatArray, pings: IntArray, length: float, least: int, most: int) -> list[IntArray]:
    """Runs of consecutive pings of about equal path: of at most `length` metres, but from `least` to `most` of them; `pings`
    says which ping a trace is of."""
    _, place, count = np.unique(pings, return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(place, axis) for axis in centres.T], axis=1) / count[:, None]
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    pieces = min(max(math.ceil(min(path[-1] / max(length, 1e-9), 1e9)), least), most)
    number = np.minimum((path / max(path[-1], 1e-300) * pieces).astype(np.int64), pieces - 1)[place]
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


def _slopes(
    g: Records, centre: FloatArray, medium: Medium, plane: float, angle: FloatArray, ground: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of traces' two-way times (trace, ground, angle): by bearing, and by ground distance."""
    ground = ground[:, None]
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    side = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    place = np.append(centre[:2], plane) + ground[..., None] * out  # (ground, angle, 3)
    g = g[:, None, None]
    there, back = place - g["tx"], place - g["rx"]
    way, speed = np.linalg.norm(there, axis=-1, keepdims=True), np.linalg.norm(g["velocity"], axis=-1)
    back = back - (way + np.linalg.norm(back, axis=-1, keepdims=True)) / medium.c * g["velocity"]
    slope = there / np.maximum(way, 1e-9) + back / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-9)
    slope /= (medium.c - speed)[..., None]
    return np.sum(slope * side, axis=-1) * ground, np.sum(slope * out, axis=-1)


def bands(
    trace: Records, centre: FloatArray, medium: Medium, plane: float, angles: Ends, grounds: Ends
) -> tuple[float, float, float]:
    """Highest frequencies of a group's sub-image over bearings and ground distances, all its traces looked at: rad a radian
    across rays, how fast that changes (second derivative), and cycles a metre of ground along them.

    A trace's echo of base-band frequency f at two-way time tau varies as exp(2j pi ((fc + f) tau - fc tau_0)), tau_0 that of
    the centre: its phase's gradient, with f = +-B/2. Between the bearings looked at it exceeds what is found there by at most
    an eighth of its second derivative times their distance squared.
    """
    angle = np.linspace(*angles, max(5, math.ceil(min((angles[1] - angles[0]) / APART, 64.0)) + 1))
    ground = np.linspace(*grounds, 3)
    own = 2 / medium.c * ground / np.maximum(np.hypot(ground, centre[2] - plane), 1e-9)
    half = medium.band * medium.fs
    across = bend = along = 0.0
    for begin in range(0, len(trace), AT_ONCE):
        lateral, radial = _slopes(trace[begin : begin + AT_ONCE], centre, medium, plane, angle, ground)
        across = max(across, float(np.max(np.abs(lateral))))
        bend = max(bend, float(np.max(np.abs(np.diff(lateral, 2, axis=-1)))))
        along = max(along, float(np.max(half * np.abs(radial) + medium.fc * np.abs(radial - own[:, None]))))
    turns = 2 * np.pi * (medium.fc + half)
    return turns * (across + bend / 8), turns * bend / (angle[1] - angle[0]) ** 2, along


def spacing(
    trace: Records, centre: FloatArray, medium: Medium, plane: float, angles: Ends, grounds: Ends, taps: Taps
) -> tuple[float, float]:
    """Between rays that serve reads at bearings and ground distances, rad, and between nodes of a ray, m.

    Nodes beside the reads count too, as far as taps and filter reach, so that the spacing depends on itself: what is found for
    the reads alone bounds how far that is.
    """
    more = taps.reach * node(medium, taps)
    grounds = max(grounds[0] - more, 1e-9), grounds[1] + more
    beam = along = outer = 0.0
    for _ in range(2):
        across, bend, along = bands(trace, centre, medium, plane, (angles[0] - outer, angles[1] + outer + 1e-3), grounds)
        beam = min(WIDEST, np.pi / (taps.rate * (SPARE_ACROSS * max(across, 1e-9) + OVERLAP * float(np.cbrt(bend / 2)))))
        outer = taps.reach * beam
    return beam, min(node(medium, taps), 1 / (2 * taps.rate * SPARE * along))


def polar(
    trace: Records, centre: FloatArray, medium: Medium, plane: float, middle: FloatArray, radius: FloatArray, taps: Taps
) -> PolarGrid:
    """The grid that a group's sub-image is read from at tiles within circles (middle, radius)."""
    bearing, half, ground = _seen(centre, 0.0, middle, radius)
    ordered = np.sort(bearing)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    start = float(ordered[(np.argmax(gaps) + 1) % len(ordered)])  # behind the widest gap between the tiles
    bearing, half, ground = _seen(centre, start, middle, radius)
    low, high = start + float(np.min(bearing - half)), start + float(np.max(bearing + half))
    near, far = float(np.min(ground - radius)), float(np.max(ground + radius))
    beam, step = spacing(trace, centre, medium, plane, (low, high), (near, far), taps)
    rays, nodes = (math.floor(a) + 2 * taps.reach + 2 for a in (min(high - low, 2 * np.pi) / beam, (far - near) / step))
    return PolarGrid(
        centre, plane, low - 1e-3 * beam, low - taps.reach * beam, beam, near - taps.reach * step, step, (rays, nodes)
    )


def needed(grid: PolarGrid, middle: FloatArray, radius: FloatArray, taps: Taps, count: int) -> BoolArray:
    """Which of a polar grid's own tiles, of `count` nodes of TILE_ROWS rays, hold nodes that tiles within circles ask for."""
    bearing, half, ground = _seen(grid.centre, grid.angle, middle, radius)

    def cut(low: FloatArray, high: FloatArray, size: int) -> list[list[int]]:
        ends = [(low - taps.reach) // size, (high + taps.reach + 1) // size + 1]
        found: list[list[int]] = np.stack(ends, axis=1).astype(np.int64).clip(0).tolist()
        return found

    out = np.zeros((-(-grid.shape[0] // TILE_ROWS), -(-grid.shape[1] // count)), dtype=np.bool_)
    columns = cut((ground - radius - grid.near) / grid.step, (ground + radius - grid.near) / grid.step, count)
    for turn in (-2 * np.pi, 0.0, 2 * np.pi):  # the last tiles may reach beyond the first
        rows = cut((bearing - half + turn) / grid.beam, (bearing + half + turn) / grid.beam, TILE_ROWS)
        for (top, bottom), (left, right) in zip(rows, columns, strict=True):
            if bottom:
                out[top:bottom, left:right] = True
    return out.ravel()


def _seen(
    centre: FloatArray, start: float, middle: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bearings of circles from `start` on, half the angles that they fill, and ground distances."""
    x, y = (middle[:, :2] - centre[:2]).T
    ground = np.hypot(x, y)
    return (np.arctan2(y, x) - start) % (2 * np.pi), np.arcsin(np.minimum(radius / ground, 1)), ground
