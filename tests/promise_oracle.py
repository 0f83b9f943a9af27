"""A second oracle for the promise of `tol`, which shares nothing with `pysas.reference.exact` but the definition.

Each term is a direct sum over all samples of its trace with the closed-form kernel of the low-pass W (a raised cosine between
fs/2.2 and fs/2; Proakis, Digital Communications, Eq 9.2-27), in float64: no transform, no interpolation. The delay of a moving
receiver is the closed-form root of its quadratic.
"""

from __future__ import annotations

import numba
import numpy as np

# A term counts up to so many samples beyond a record's ends, where it is read at the end, and rad beyond a beam's edge: places
# that lie exactly there in decimal numbers do so to rounding only. The same as pysas.reference.exact's rule, written again.
RECORD_SLACK = 1e-4
BEAM_SLACK = 1e-7
UNSURE = 0.01  # of these: rounding decides what lies nearer to where counting stops

PASS, STOP = 1 / 2.2, 0.5
H, X = (PASS + STOP) / 2, 2 * (STOP - PASS)  # half-amplitude frequency, cycles per sample; x = X |t|


@numba.njit(cache=True)
def delay(outward, e, v, c):
    """Root tau of c tau = D + |e - v tau|, D outward, e from receiver to pixel.

    Squared: (c^2 - v^2) tau^2 - 2 (c D - e.v) tau + D^2 - e^2 = 0; the larger root.
    """
    ee, ev, vv = 0.0, 0.0, 0.0
    for k in range(3):
        ee += e[k] * e[k]
        ev += e[k] * v[k]
        vv += v[k] * v[k]
    if vv == 0:
        return (outward + np.sqrt(ee)) / c
    root = c * c * ee - 2 * c * outward * ev + ev * ev + vv * (outward * outward - ee)
    return (c * outward - ev + np.sqrt(max(root, 0.0))) / (c * c - vv)


@numba.njit(cache=True)
def _sinc(x):
    return 1.0 if abs(x) < 1e-12 else np.sin(np.pi * x) / (np.pi * x)


@numba.njit(cache=True)
def kernel(t):
    """Impulse response of W at `t` samples: cos(pi x / 2) / (1 - x^2) as a sinc, which is smooth at x = 1."""
    x = X * abs(t)
    return 2 * H * _sinc(2 * H * t) * np.pi / 2 * _sinc((1 - x) / 2) / (1 + x)


@numba.njit(cache=True)
def _read(trace, u, turn, half):
    """Low-passed `trace` at place `u`; `turn`, `half`: exp(2 pi i H m), exp(pi i X m / 2) of its samples m."""
    at, bell = np.exp(2j * np.pi * H * u), np.exp(0.5j * np.pi * X * u)
    total = 0j
    for m in range(trace.size):
        t = u - m
        x = X * t
        if abs(t) < 0.5 or abs(abs(x) - 1) < 0.02:
            total += trace[m] * kernel(t)
        else:
            sine = at.imag * turn[m].real - at.real * turn[m].imag
            cosine = bell.real * half[m].real + bell.imag * half[m].imag
            total += trace[m] * (sine / (np.pi * t) * cosine / (1 - x * x))
    return total


@numba.njit(cache=True)
def _cross(a, b):
    return np.sqrt((a[1] * b[2] - a[2] * b[1]) ** 2 + (a[2] * b[0] - a[0] * b[2]) ** 2 + (a[0] * b[1] - a[1] * b[0]) ** 2)


@numba.njit(cache=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def lobe(away, boresight, axis, beam):
    """Whether a term counts in `away` from its transmitter, what it then weighs, and how near that is to counting otherwise.

    beam : its shape (0 none, 1 cone, 2 fan), half-angle and taper, over which the weight is (1 + cos(pi x))/2, x from 0 to 1.
    """
    shape, half, taper = beam
    if shape == 0:
        return True, 1.0, np.inf
    nearest = np.inf
    if shape == 1:
        alpha = np.arctan2(_cross(away, boresight), _dot(away, boresight))
    else:
        alpha = np.arctan2(abs(_dot(away, axis)), _cross(away, axis))
        length = np.sqrt(_dot(away, away))
        before = _dot(away, boresight) / length if length > 0 else 0.0
        nearest = abs(before + BEAM_SLACK) / BEAM_SLACK
        if before < -BEAM_SLACK:
            return False, 0.0, nearest
    if taper == 0:
        beyond = alpha - half - BEAM_SLACK
        return beyond <= 0, 1.0, min(nearest, abs(beyond) / BEAM_SLACK)
    x = min(1.0, max(0.0, 1 - (half - alpha) / (taper * half)))
    return alpha <= half, (1 + np.cos(np.pi * x)) / 2, nearest


@numba.njit(cache=True)
def _sum(data, fs, fc, start, tx, rx, velocity, c, ends, points, boresight, axis, beam, weights):
    """Image, squared level, and how near (in slacks) any term comes to where it would be counted otherwise."""
    pings, channels, samples = data.shape
    image, power = np.zeros(len(points), np.complex128), np.zeros(len(points))
    nearest = np.full(len(points), np.inf)
    places = np.arange(samples)
    turn, half = np.exp(2j * np.pi * H * places), np.exp(0.5j * np.pi * X * places)
    away = np.zeros(3)
    for i in range(len(points)):
        for p in range(pings):
            squared = 0.0
            for k in range(3):
                away[k] = points[i, k] - tx[p, k]
                squared += away[k] * away[k]
            lit, light, edge = lobe(away, boresight[p], axis[p], beam)
            nearest[i] = min(nearest[i], edge)
            if not lit:
                continue
            for k in range(channels):
                tau = delay(np.sqrt(squared), points[i] - rx[p, k], velocity[p, k], c[p])
                u = (tau - start[p]) * fs
                first, last = ends[p, k]
                if last < first:
                    continue
                away_from = min(abs(u - first + RECORD_SLACK), abs(u - last - RECORD_SLACK))
                nearest[i] = min(nearest[i], away_from / RECORD_SLACK)
                weight = weights[min(i, len(weights) - 1), p, k]
                if u < first - RECORD_SLACK or u > last + RECORD_SLACK or weight == 0:
                    continue
                value = weight * light * _read(data[p, k, first : last + 1], min(max(u, first), last) - first, turn, half)
                turns = fc * tau
                turns -= np.rint(turns)
                image[i] += value * np.exp(2j * np.pi * turns)
                power[i] += value.real**2 + value.imag**2
    return image, power, nearest


@numba.njit(cache=True)
def _any(fs, start, ends, tx, rx, velocity, c, points, boresight, axis, beam, used):
    """Whether any term of `used` traces counts at any of the points."""
    away = np.zeros(3)
    for i in range(len(points)):
        for p in range(len(tx)):
            for k in range(3):
                away[k] = points[i, k] - tx[p, k]
            outward = np.sqrt((away**2).sum())
            if not lobe(away, boresight[p], axis[p], beam)[0]:
                continue
            for k in range(rx.shape[1]):
                u = (delay(outward, points[i] - rx[p, k], velocity[p, k], c[p]) - start[p]) * fs
                first, last = ends[p, k]
                if used[p, k] and first <= last and first - RECORD_SLACK <= u <= last + RECORD_SLACK:
                    return True
    return False


def _geometry(echoes):
    """Arrays of a survey as the loops take them: start, tx, rx, velocity, boresights and axes of length 1, and the beam."""
    pings, channels = echoes.n_ping, echoes.n_channel
    velocity = np.zeros((pings, channels, 3)) if echoes.velocity is None else echoes.receiver_velocity
    boresight, axis, beam = np.zeros((pings, 3)), np.zeros((pings, 3)), (0.0, np.pi, 0.0)
    if (given := echoes.beam) is not None:
        beam = ({"cone": 1.0, "fan": 2.0}[given.shape], given.half_angle, given.taper)
        boresight = np.broadcast_to(given.boresight, (pings, 3))
        boresight = boresight / np.linalg.norm(boresight, axis=1, keepdims=True)
        if given.shape == "fan":
            axis = np.cross(boresight, [0.0, 0.0, 1.0]) if given.axis is None else np.broadcast_to(given.axis, (pings, 3))
            axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    arrays = (echoes.start_time, echoes.tx, echoes.receivers, velocity, boresight, axis)
    # copies, as read-only arrays would be a type of their own to Numba: each loop is compiled once
    return (*(np.array(a, dtype=np.float64, order="C") for a in arrays), beam)


def _speeds(echoes):
    """(ping,) sound speeds."""
    return np.full(echoes.n_ping, echoes.c) if isinstance(echoes.c, float) else np.array(echoes.c)


def _ends(echoes):
    """(ping, channel, 2) first and last sample recorded."""
    valid = np.tile([0, echoes.n_sample - 1], (echoes.n_ping, 1)) if echoes.valid is None else echoes.valid
    valid = valid if valid.ndim == 3 else np.tile(valid[:, None], (1, echoes.n_channel, 1))
    return np.array(valid, dtype=np.int64, order="C")


def delays(echoes, points):
    """(point, ping, channel) travel times, s."""
    _, tx, rx, velocity, *_ = _geometry(echoes)
    out, c = np.empty((len(points), *rx.shape[:2])), _speeds(echoes)[:, None]
    for i, point in enumerate(points):
        outward, e = np.linalg.norm(point - tx, axis=1)[:, None], point - rx
        ee, ev, vv = (np.sum(a * b, axis=-1) for a, b in ((e, e), (e, velocity), (velocity, velocity)))
        root = c**2 * ee - 2 * c * outward * ev + ev**2 + vv * (outward**2 - ee)
        out[i] = (c * outward - ev + np.sqrt(np.maximum(root, 0))) / (c**2 - vv)
    return out


def direct_sum(echoes, points, weights=None):
    """Image and level at `points`, and which of these have no term too near to an end for rounding to decide.

    weights : (ping, channel), or (point, ping, channel), of which traces of weight 0 may hold anything.
    """
    w = np.ones((echoes.n_ping, echoes.n_channel)) if weights is None else np.asarray(weights)
    w = np.ascontiguousarray(w if w.ndim == 3 else w[None], np.complex128)
    start, tx, rx, velocity, boresight, axis, beam = _geometry(echoes)
    data = np.ascontiguousarray(echoes.traces, np.complex128)
    image, power, nearest = _sum(
        data,
        echoes.fs,
        echoes.fc,
        start,
        tx,
        rx,
        velocity,
        _speeds(echoes),
        _ends(echoes),
        np.ascontiguousarray(points),
        boresight,
        axis,
        beam,
        w,
    )
    return image, np.sqrt(power), nearest > UNSURE


def any_term(echoes, points, used):
    """Whether any term counts at any of the points, of the traces `used` (ping, channel)."""
    start, tx, rx, velocity, boresight, axis, beam = _geometry(echoes)
    return bool(
        _any(
            echoes.fs, start, _ends(echoes), tx, rx, velocity, _speeds(echoes), np.ascontiguousarray(points), boresight, axis,
            beam, np.ascontiguousarray(used),
        )
    )  # fmt: skip
