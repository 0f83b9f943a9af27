"""Bright points: a track from the travel times of a few points' echoes, ping against ping, by one least squares of all.

Of a point n the echo of ping p comes earlier or later than the claimed track says by e_p = u_p.(e_n - delta_p) of slant range,
where delta_p is the track's error and e_n the place's. Base-band correlation of two pings' slices of range gives e_q - e_p
without a limit of half a wavelength: its envelope says which turn of phase is meant.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.motion import patches as _patches
from pysas.motion.moving import centres
from pysas.motion.patches import Int, looks, wave_numbers

REACH = 0.35  # m of slant range to either side of a point, or eight cells where these are larger
FINER = 16  # of the correlation's envelope
CAUCHY = 4.0  # standard deviations
REWEIGHTED = 5  # times
TIKHONOV = {"surge": 3e-3, "sway": 1e-3, "heave": 3e-3, "yaw": 1e-3}  # beside rows of weight 1, per m (yaw: per m at the array's ends)


class Slices:
    """Range slices of one point in the pings that see it, in base-band: (ping, lag)."""

    def __init__(self, point: FloatArray, pings: Int, data: ComplexArray, lags: FloatArray, look: FloatArray) -> None:
        self.point, self.pings, self.data, self.lags, self.look = point, pings, data, lags, look


def sliced(echoes: Echoes, points: FloatArray, tol: float, threads: int | None) -> list[Slices]:
    """Slices of all points: read at points along each ping's line of sight, where travel times are exact, carrier taken out."""
    middle = centres(echoes)
    cell = echoes.mean_speed / (2 * echoes.occupied_bandwidth)
    step = cell / 1.5
    half = int(np.ceil(max(REACH, 8 * cell) / step))
    lags = np.arange(-half, half + 1) * step
    k = wave_numbers(echoes)
    rows, places = [], []
    for point in points:
        pings = _patches.within_records(echoes, point)
        look, _ = looks(middle[pings], point)
        rows.append((point, pings, look))
        places.append(point + lags[:, None] * look[:, None, :])
    data = _patches.read(echoes, np.concatenate(places), np.concatenate([pings for _, pings, _ in rows]), tol, threads)
    found, start = [], 0
    for point, pings, look in rows:
        some = data[start : start + len(pings)] * np.exp(-1j * k[pings, None] * lags)
        start += len(pings)
        found.append(Slices(point, pings, some, lags, look))
    return found


def windowed(data: ComplexArray, width: float) -> ComplexArray:
    """Slices smoothed along pings by a Gaussian of so many pings' standard deviation: what turns from ping to ping goes."""
    import scipy.ndimage

    return scipy.ndimage.gaussian_filter1d(data, width, axis=0, mode="nearest")


def delays(first: ComplexArray, second: ComplexArray, step: float, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much farther a point is in each row of `second`, m, and the coherence of the two rows."""
    n = first.shape[1]
    size = 2 * n
    spectrum = np.fft.fft(second, size) * np.fft.fft(first, size).conj()
    padded = np.zeros((len(first), size * FINER), dtype=complex)
    padded[:, : size // 2], padded[:, -(size // 2) :] = spectrum[:, : size // 2], spectrum[:, size // 2 :]
    correlation = np.fft.ifft(padded) * FINER
    best = np.argmax(np.abs(correlation), axis=1)
    row = np.arange(len(first))
    size *= FINER
    left, top, right = (np.abs(correlation[row, (best + shift) % size]) for shift in (-1, 0, 1))
    bend = 2 * top - left - right
    fraction = np.where(bend > 0, (right - left) / 2 / np.where(bend > 0, bend, 1), 0)
    lag = np.where(best >= size // 2, best - size, best)
    at = correlation[row, best]
    energy = np.sqrt(np.sum(np.abs(first) ** 2, axis=1) * np.sum(np.abs(second) ** 2, axis=1))
    metres = step / FINER * lag
    del fraction
    return metres - np.angle(at * np.exp(1j * k * metres)) / k, np.abs(at) / np.maximum(energy, 1e-300)


def solved(
    rows: list[tuple[Int, FloatArray, FloatArray, FloatArray, FloatArray]],
    directions: list[FloatArray],
    ties: list[float],
    n_ping: int,
) -> tuple[FloatArray, FloatArray, float]:
    """(component, ping) displacements, (point, 2) errors of places and the rows' standard deviation, m.

    rows: of each point its pings q (the earlier of each pair is q - 1), what is farther, weights, looks of q and of q - 1.
    """
    count = len(directions)
    entries: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    wanted, weights, start = [], [], 0
    for number, (late, farther, weight, look, before) in enumerate(rows):
        at = start + np.arange(len(late))
        for c, way in enumerate(directions):
            entries.append((at, late * count + c, -np.sum(look * way[late], axis=1)))
            entries.append((at, (late - 1) * count + c, np.sum(before * way[late - 1], axis=1)))
        for c in range(2):
            entries.append((at, np.full(len(at), n_ping * count + 2 * number + c), (look - before)[:, c]))
        wanted.append(farther)
        weights.append(weight)
        start += len(late)
    unknowns = n_ping * count + 2 * len(rows)
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    design = scipy.sparse.csr_array((value, (row, column)), shape=(start, unknowns))
    target, weight = np.concatenate(wanted), np.concatenate(weights)
    tie = np.concatenate([np.tile(ties, n_ping), np.full(2 * len(rows), min(ties))])
    robust = np.ones_like(weight)
    for _ in range(REWEIGHTED):
        scale = scipy.sparse.diags_array(weight * robust)
        normal = (design.T @ (scale @ design) + scipy.sparse.diags_array(tie**2)).tocsc()
        solution = scipy.sparse.linalg.spsolve(normal, design.T @ (weight * robust * target))
        rest = (design @ solution - target) * np.sqrt(weight)
        sigma = max(1.4826 * float(np.median(np.abs(rest))), 1e-9)
        robust = 1 / (1 + (rest / (CAUCHY * sigma)) ** 2)
    series = solution[: n_ping * count].reshape(n_ping, count).T
    return np.asarray(series), np.asarray(solution[n_ping * count :].reshape(-1, 2)), sigma
