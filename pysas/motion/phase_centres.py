"""Displaced phase centres: where the arrays of two consecutive pings overlap, both heard the seabed from the same places.

Pairs of channels, one of each ping, whose phase centres lie nearest or a step or two apart; a line of points on the seabed for
each pair, along the beam, from the two-way beam's centroid; both traces read at the exact delays of those points, and
correlated window by window. The phase says how much nearer the later one was, the coherence how far apart both were.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks, _pool
from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.contributions import along_lines
from pysas.model.beam import FAN
from pysas.model.echoes import Echoes
from pysas.motion import correlating
from pysas.motion.moving import centres, scaled

MOST_PAIRS, MOST_BESIDE = 12, 4  # of channels at the nearest separation, and at each of those a step or more away
_BATCH_BYTES = 100e6  # of the samples of both traces of each pair
_PIECE = 64  # samples of a line on the seabed that lie evenly
_TASK_ROWS = 64
# samples left out at both ends of long records, whose ends would have to be read by transforms of them all: a third of the time
_BESIDE_ENDS = 256
_GRAZING = 0.98  # largest sine of the depression angle at which a range says where on the seabed it is

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rows:
    """Of pairs of pings, slots of channel pairs and windows: products (lag last, normalised to coherence) and what they need.

    used : (pair, slot); order : (slot,) separations' number, 0 the nearest.
    separation : (pair, slot) along the claimed forward direction, m; apart (pair, slot, 3); arms (pair, slot, 2, 2).
    products : (pair, slot, window, lag); count (pair, slot, window) independent samples; looks (pair, window, 3); ahead
        (pair, 3).
    """

    used: npt.NDArray[np.bool_]
    order: IntArray
    separation: FloatArray
    apart: FloatArray
    arms: FloatArray
    products: ComplexArray
    count: FloatArray
    looks: FloatArray
    ahead: FloatArray
    speed: FloatArray


class Side:
    """Echoes of one side of a sonar, and its pairs of channels and lines on the seabed by the claimed track."""

    def __init__(self, echoes: Echoes, pivot: FloatArray, elements: tuple[float, float], seabed: float) -> None:
        self.echoes, self.elements, self.seabed = echoes, elements, seabed
        self.centres = (echoes.tx[:, None] + echoes.receivers) / 2
        self.arms = (self.centres - pivot[:, None])[..., :2]
        axis, self.forward = axes(echoes)
        self.across, self.up = _plane(axis, echoes)
        self.step = centre_step(echoes, self.forward)

    def ahead(self, low: int, high: int) -> FloatArray:
        """Mean forward directions of pings low ... high - 1 and their next."""
        ahead = self.forward[low:high] + self.forward[low + 1 : high + 1]
        return np.asarray(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))

    def overlap(self) -> FloatArray:
        """(ping - 1,) phase centres of a ping that lie beside one of the next, by the claimed track."""
        ahead = self.ahead(0, self.echoes.n_ping - 1)
        before = np.einsum("pcx,px->pc", self.centres[:-1], ahead)
        after = np.einsum("pcx,px->pc", self.centres[1:], ahead)
        shared = np.minimum(before.max(axis=1), after.max(axis=1)) - np.maximum(before.min(axis=1), after.min(axis=1))
        return np.asarray(shared / self.step + 1)

    def pairs(self, low: int, high: int, lags: int) -> tuple[IntArray, IntArray, npt.NDArray[np.bool_], IntArray, FloatArray]:
        """Of pings low ... high - 1 and their next: channels, which of the slots are used, their separations' numbers (-lags
        ... lags), and the separations."""
        ahead = self.ahead(low, high)
        before = np.einsum("pcx,px->pc", self.centres[low:high], ahead)
        after = np.einsum("pcx,px->pc", self.centres[low + 1 : high + 1], ahead)
        gaps = after[:, None, :] - before[:, :, None]
        nearest = np.take_along_axis(gaps.reshape(len(gaps), -1), np.abs(gaps).reshape(len(gaps), -1).argmin(1)[:, None], 1)
        every = np.arange(high - low)[:, None]
        firsts, seconds, uses, orders = [], [], [], []
        for number in range(-lags, lags + 1):
            aim = nearest + number * self.step
            other = np.abs(gaps - aim[:, :, None]).argmin(axis=2)
            miss = np.abs(np.take_along_axis(gaps, other[:, :, None], 2)[:, :, 0] - aim)
            good = miss <= 0.499 * self.step
            most = min(self.echoes.n_channel, MOST_BESIDE if number else MOST_PAIRS)
            total = good.sum(axis=1)[:, None]
            slot = np.arange(most)
            rank = np.where(total > most, np.round(slot * (total - 1) / max(most - 1, 1)).astype(int), slot)
            first = np.take_along_axis(np.argsort(~good, axis=1, kind="stable"), rank, 1)
            firsts.append(first)
            seconds.append(np.take_along_axis(other, first, 1))
            uses.append(slot < total)
            orders += [number] * most
        first, second, used = (np.concatenate(parts, axis=1) for parts in (firsts, seconds, uses))
        return first, second, used, np.array(orders), gaps[every, first, second]

    def windows(self, size: float) -> tuple[int, int, int]:
        """First sample, length and number of windows of `size` m of slant range.

        Raises
        ------
        ValueError
            None within the record; fewer than 8 samples.
        """
        step = float(np.mean(self.echoes.speeds)) / (2 * self.echoes.fs)
        length = int(round(size / step))
        begin, end = self._within
        count = (end - begin) // max(length, 1)
        if length < 8 or count < 1:
            seen = max(end - begin, 0) * step
            raise ValueError(
                f"windows={size:g}: expected at least 8 samples ({8 * step:.3g} m), and at most the {seen:.3g} m of slant "
                f"range that the record has of a seabed at z = {self.seabed:g} m"
            )
        return begin, length, count

    @functools.cached_property
    def _within(self) -> tuple[int, int]:
        """First sample at which every ping sees the seabed, and the end of those that are read."""
        echoes = self.echoes
        reached = np.abs(self.seabed - self.centres[..., 2].mean(axis=1)) / (np.abs(self.up[:, 2]) * _GRAZING)
        beside = _BESIDE_ENDS if echoes.n_sample >= 30 * _BESIDE_ENDS else 0
        begin = max(int(np.ceil(np.max((2 * reached / echoes.speeds - echoes.start_time) * echoes.fs))), beside)
        return begin, echoes.n_sample - beside

    def batches(self, slots: int) -> Iterator[tuple[int, int]]:
        """Pings low ... high - 1 whose lines fit into memory."""
        each = max(int(_BATCH_BYTES / (16 * self.echoes.n_sample * slots)), 1)
        for low in range(0, self.echoes.n_ping - 1, each):
            yield low, min(low + each, self.echoes.n_ping - 1)

    def measure(self, low: int, high: int, size: float, reach: int, lags: int, tol: float, threads: int | None) -> Rows:
        """Correlations of pings low ... high - 1 with their next, at lags of -reach ... reach samples."""
        echoes = self.echoes
        first, second, used, order, separation = self.pairs(low, high, lags)
        begin, length, count = self.windows(size)
        pair, slot = np.nonzero(used)
        which = np.stack([low + pair, low + pair + 1])
        channel = np.stack([first[pair, slot], second[pair, slot]])
        heads, looks = self._lines(which, channel, begin, length, count)
        ways = np.diff(heads, axis=1) / _PIECE
        some = echoes[low : high + 1].replace(beam=None)
        trace = np.repeat((which - low) * echoes.n_channel + channel, ways.shape[1])
        first_points, steps = (np.tile(part.reshape(-1, 3), (2, 1)) for part in (heads[:, :-1], ways))
        data = along_lines(
            some, first_points, steps, _PIECE, np.stack([trace, trace], axis=1), tol=tol, threads=threads
        ).reshape(2, len(pair), -1)  # fmt: skip
        data = scaled(data)
        products = np.empty((len(pair), count, 2 * reach + 1), dtype=np.complex128)
        powers, counts = np.empty((len(pair), count)), np.empty((len(pair), count))
        real = data[0].real.dtype
        whole, top = (np.int32, 30) if real == np.float32 else (np.int64, 62)

        def task(number: int) -> None:
            rows = slice(number * _TASK_ROWS, (number + 1) * _TASK_ROWS)
            into = (products[rows], powers[rows], counts[rows])
            squares = np.empty(length, dtype=real)
            room = (squares, squares.view(whole), top)
            _pool.call(correlating.windows, data[0][rows], data[1][rows], length, *room, *into)

        _pool.run(task, -(-len(pair) // _TASK_ROWS), _checks.threads(threads))
        products /= np.where(powers > 0, powers, 1.0)[:, :, None]
        independent = counts / echoes.fs * echoes.occupied_bandwidth
        full = np.zeros((*used.shape, count, 2 * reach + 1), dtype=np.complex128)
        full[pair, slot] = products
        number = np.zeros((*used.shape, count))
        number[pair, slot] = independent
        sight = np.zeros((high - low, count, 3))
        sight[pair[::-1]] = looks[::-1]  # of a ping's first slot
        every = np.arange(low, high)[:, None]
        apart = self.centres[every + 1, second] - self.centres[every, first]
        arms = np.stack([self.arms[every, first], self.arms[every + 1, second]], axis=2)
        speed = (echoes.speeds[low:high] + echoes.speeds[low + 1 : high + 1]) / 2
        return Rows(used, order, separation, apart, arms, full, number, sight, self.ahead(low, high), speed)

    def _lines(self, which: IntArray, channel: IntArray, begin: int, length: int, count: int) -> tuple[FloatArray, FloatArray]:
        """Of pairs of traces ends (row, end, 3) of straight pieces of lines on the seabed, each of _PIECE samples of slant
        range to within its curvature, and lines of sight (row, window, 3) to windows' middles."""
        echoes = self.echoes
        send, hear = (size**2 / (self.elements[0] ** 2 + self.elements[1] ** 2) for size in self.elements)
        start = (send * echoes.tx[which] + hear * echoes.receivers[which, channel]).mean(axis=0)
        speed, near = echoes.speeds[which].mean(axis=0), echoes.start_time[which].mean(axis=0)
        rate = np.zeros_like(start)
        if echoes.receiver_velocity is not None:
            rate = hear * echoes.receiver_velocity[which, channel].mean(axis=0) * (2 / speed)[:, None]
        across, up = (direction[which].mean(axis=0) for direction in (self.across, self.up))
        across, up = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (across, up))

        def sight(sample: npt.NDArray[Any]) -> tuple[FloatArray, FloatArray]:
            r = np.maximum(near[:, None] + sample / echoes.fs, 1 / echoes.fs) * speed[:, None] / 2
            sine = np.clip((self.seabed - start[:, 2:] - rate[:, 2:] * r) / (r * up[:, 2:]), -1, 1)
            return r[..., None], np.sqrt(1 - sine**2)[..., None] * across[:, None] + sine[..., None] * up[:, None]

        r, looks = sight(np.asarray(begin + _PIECE * np.arange(-(-count * length // _PIECE) + 1.0)))
        middles = begin + (np.arange(count) + 0.5) * length
        return start[:, None] + r * (rate[:, None] + looks), sight(middles)[1]


def axes(echoes: Echoes) -> tuple[FloatArray, FloatArray]:
    """(ping, 3) directions of the element that lights the seabed, and their horizontal parts of length 1: forward.

    Raises
    ------
    ValueError
        No beam, or one that looks along the vertical.
    """
    beam = echoes.beam
    if beam is None:
        raise ValueError("echoes: beam=None: expected a pysas.Beam, which says where the seabed is seen, and how widely")
    if beam.shape == FAN:
        axis = np.broadcast_to(beam.axes, (echoes.n_ping, 3))
    else:
        axis = np.broadcast_to(np.cross(beam.boresights, [0.0, 0.0, 1.0]), (echoes.n_ping, 3))
    level = axis * [1.0, 1.0, 0.0]
    size = np.linalg.norm(level, axis=1, keepdims=True)
    if not np.all(size > 1e-3):
        ping = int(np.argmin(size))
        look = beam.boresights[ping % len(beam.boresights)]
        raise ValueError(f"echoes: beam: boresight {look} at ping {ping}: expected one off the vertical")
    way = np.gradient(centres(echoes), axis=0)
    sign = -1.0 if np.sum(level * way) < 0 else 1.0
    return np.asarray(sign * axis / np.linalg.norm(axis, axis=1, keepdims=True)), np.asarray(sign * level / size)


def _plane(axis: FloatArray, echoes: Echoes) -> tuple[FloatArray, FloatArray]:
    """Two directions (ping, 3) that span the plane across the element: the level one to the beam's side, and towards +z."""
    if echoes.beam is None:
        raise _checks.InternalError("beam: none")
    across = np.cross([0.0, 0.0, 1.0], axis)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    across *= np.where(np.sum(across * echoes.beam.boresights, axis=1, keepdims=True) < 0, -1.0, 1.0)
    up = np.cross(axis, across)
    return across, up * np.where(up[:, 2:] < 0, -1.0, 1.0)


def centre_step(echoes: Echoes, forward: FloatArray) -> float:
    """Typical distance of a ping's neighbouring phase centres along the forward direction, m; half the element's length where
    there is one channel."""
    along = np.sort(np.einsum("pcx,px->pc", echoes.receivers / 2, forward), axis=1)
    gaps = np.diff(along, axis=1)
    gaps = gaps[gaps > 1e-6]
    if gaps.size:
        return float(np.median(gaps))
    if echoes.beam is None:
        raise _checks.InternalError("beam: none")
    return echoes.beam.length / 2
