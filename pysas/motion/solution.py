"""One least-squares solution of a whole track: block-tridiagonal normal equations, their solution and variances, O(pings)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

from pysas._checks import FloatArray
from pysas.motion.priors import BRIDGE_STEP, BRIDGE_TURN, HEADING, POSITION, STEP, TURN, Prior

LEVEL = 0.05  # rad: lines of sight that turn by less see no shift along the track
HELD = np.array([1e-4, 1e-4, 1e-4, 1e-5])  # m, rad: how firmly a ping is held where variances of the others are asked for


class Equations:
    """Normal equations of x, y, z and turn of each ping: blocks on the diagonal, and of a ping (row) and the one before it."""

    def __init__(self, pings: int) -> None:
        self.diagonal = np.zeros((pings, 4, 4))
        self.beside = np.zeros((pings - 1, 4, 4))
        self.right = np.zeros((pings, 4))

    def add(self, normal: FloatArray, right: FloatArray) -> None:
        """Those of each two consecutive pings, (ping - 1, 8, 8) and (ping - 1, 8)."""
        self.diagonal[:-1] += normal[:, :4, :4]
        self.diagonal[1:] += normal[:, 4:, 4:]
        self.beside += normal[:, 4:, :4]
        self.right[:-1] += right[:, :4]
        self.right[1:] += right[:, 4:]

    def believe(self, beliefs: Beliefs, track: FloatArray) -> None:
        """That a track (ping, 4) and what is sought beyond it are as small as is believed."""
        each, step = 1 / beliefs.each**2, 1 / beliefs.step**2
        k = np.arange(4)
        self.diagonal[:, k, k] += each
        self.diagonal[1:, k, k] += step
        self.diagonal[:-1, k, k] += step
        self.beside[:, k, k] -= step
        self.right -= each * track
        pull = step * (np.diff(track, axis=0) - beliefs.expected)
        self.right[1:] -= pull
        self.right[:-1] += pull

    def part(self, first: int, last: int) -> Equations:
        """What all say of pings first ... last - 1 alone, the middle one of which is held: what else lies there is gauge."""
        some = Equations(last - first)
        some.diagonal[:], some.beside[:] = self.diagonal[first:last], self.beside[first : last - 1]
        # pings beyond, which nobody knows either, are eliminated from both ends on
        if first > 0:
            before = self.diagonal[0]
            for p in range(first):
                before = self.diagonal[p + 1] - self.beside[p] @ np.linalg.solve(before, self.beside[p].T)
            some.diagonal[0] += before - self.diagonal[first]
        if last < len(self.diagonal):
            after = self.diagonal[-1]
            for p in range(len(self.diagonal) - 2, last - 2, -1):
                after = self.diagonal[p] - self.beside[p].T @ np.linalg.solve(after, self.beside[p])
            some.diagonal[-1] += after - self.diagonal[last - 1]
        k = np.arange(4)
        some.diagonal[(last - first) // 2, k, k] += 1 / HELD**2
        return some

    def banded(self) -> FloatArray:
        """(8, 4 ping) lower bands, as scipy.linalg.solveh_banded has them."""
        bands = np.zeros((8, 4 * len(self.diagonal)))
        for a in range(4):
            for b in range(4):
                if a >= b:
                    bands[a - b, b::4] += self.diagonal[:, a, b]
                bands[4 + a - b, b:-4:4] += self.beside[:, a, b]
        return bands

    def solve(self) -> FloatArray:
        """(ping, 4)."""
        return np.asarray(scipy.linalg.solveh_banded(self.banded(), self.right.ravel(), lower=True)).reshape(-1, 4)

    def slant_variance(self, looks: FloatArray, basis: FloatArray) -> FloatArray:
        """(ping,) variances of the track along `looks` (ping, 3) without what lies in the orthonormal `basis` (ping, n)."""
        pings = len(self.diagonal)
        ahead, gains = [self.diagonal[0]], []
        for p in range(pings - 1):
            gains.append(np.linalg.solve(ahead[-1], self.beside[p].T).T)
            ahead.append(self.diagonal[p + 1] - gains[-1] @ self.beside[p].T)
        covariance = np.linalg.inv(ahead[-1])
        own = np.empty(pings)
        for p in range(pings - 1, -1, -1):
            if p < pings - 1:
                covariance = np.linalg.inv(ahead[p]) + gains[p].T @ covariance @ gains[p]
            own[p] = looks[p] @ covariance[:3, :3] @ looks[p]
        along = np.zeros((pings, 4, basis.shape[1]))
        along[:, :3] = looks[:, :, None] * basis[:, None, :]
        flat = along.reshape(4 * pings, -1)
        answer = np.asarray(scipy.linalg.solveh_banded(self.banded(), flat, lower=True))
        cross = np.einsum("px,pxn->pn", looks, answer.reshape(pings, 4, -1)[:, :3])
        return np.asarray(own - 2 * np.sum(basis * cross, axis=1) + np.einsum("pn,nm,pm->p", basis, flat.T @ answer, basis))


class Beliefs:
    """Standard deviations of x, y, z and turn of each ping (4,), and of their changes from ping to ping (ping - 1, 4)."""

    def __init__(self, prior: Prior, pings: int, times: FloatArray | None) -> None:
        self.prior = prior
        self.each = np.array([POSITION, POSITION, prior.depth or POSITION, prior.heading or HEADING])
        self.expected = np.zeros((pings - 1, 4))
        self.step = np.tile([STEP, STEP, np.sqrt(2) * prior.depth if prior.depth else STEP, prior.gyro or TURN], (pings - 1, 1))
        self.guessed = np.array([prior.speed is None, prior.speed is None, prior.depth is None, prior.gyro is None])
        if prior.speed is not None:
            if times is None:
                raise ValueError(
                    f"prior: speed={prior.speed!r}: expected echoes whose pings have times: ping_time, or a velocity that tells"
                )
            self.step[:, :2] = (prior.speed * np.abs(np.diff(times)))[:, None]

    def bridge(self, track: FloatArray, seen: npt.NDArray[np.bool_], way: FloatArray) -> None:
        """Expect that what no echo tells, and no prior, of a track's changes (ping - 1, 4) is as before and after, per m of the
        claimed way from ping to ping (ping - 1,): smooth motion is the better guess."""
        place = np.cumsum(way) - way / 2
        rate = np.diff(track, axis=0) / np.maximum(way, 1e-9)[:, None]
        for k in np.flatnonzero(self.guessed):
            told, rest = seen[:, k], ~seen[:, k]
            if told.any():
                self.expected[rest, k] = np.interp(place[rest], place[told], rate[told, k]) * way[rest]
                sure = BRIDGE_TURN if k == 3 else BRIDGE_STEP
                self.step[rest, k] = sure * way[rest] / max(float(np.median(way[told])), 1e-9)

    def residual(self, track: FloatArray) -> float:
        """Root mean square of a track (ping, 4), or of its changes, over what is believed of them: the largest of its parts, as
        what is believed of one too firmly does not become right by what is believed of the others."""
        parts = (track / self.each, (np.diff(track, axis=0) - self.expected) / self.step)
        return float(np.sqrt(max(np.max(np.mean(part**2, axis=0)) for part in parts)))


def without_gauge(looks: FloatArray, places: FloatArray, slant: FloatArray) -> FloatArray:
    """What is left of displacements along the lines of sight (ping,)."""
    basis = gauge(looks, places)
    return np.asarray(slant - basis @ (basis.T @ slant))


def gauge(looks: FloatArray, places: FloatArray) -> FloatArray:
    """Orthonormal (ping, n): what a shift, and a turn about z, of the whole track change along lines of sight (ping, 3)."""
    places = places - places.mean(axis=0)
    turn = looks[:, 1] * places[:, 0] - looks[:, 0] * places[:, 1]
    columns = np.column_stack([looks, turn / max(float(np.abs(places).max()), 1e-9)])
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, sizes > LEVEL * sizes[0]])
