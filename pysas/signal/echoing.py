"""Kernels of the simulator in Numba: the echoes of many points in one trace. They trust their arguments."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pysas.model.beam import EDGE_ANGLE
from pysas.model.pulse import WINDOWS

_RESTART = 64  # samples of the phase recurrence between exact values: its error grows as their square, to 5e-13
RECT, GAUSSIAN, TUKEY, TAYLOR = (WINDOWS.index(name) for name in ("rect", "gaussian", "tukey", "taylor"))
# columns of an element's row: boresight, along and up (3 each), length, height
_LENGTH, _HEIGHT, ELEMENT = 9, 10, 11
# of a beam's row: what of boresight lies across the axis, the axis, their normal and boresight (3 each)
_BORESIGHT, LAMP = 9, 12
DARK, ROUND, LONG = 0, 1, 2  # no beam, a cone, a fan


@njit(nogil=True, cache=True)
def _delay(x, y, z, tx, rx, v, c):  # type: ignore[no-untyped-def]
    """Travel time tau (s), range from the transmitter, and vector to the point from the receiver at reception (m)."""
    there = math.sqrt((x - tx[0]) ** 2 + (y - tx[1]) ** 2 + (z - tx[2]) ** 2)
    dx, dy, dz = x - rx[0], y - rx[1], z - rx[2]
    tau = (there + math.sqrt(dx * dx + dy * dy + dz * dz)) / c
    if v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0:
        # contracts by |v|/c < 0.1 per step: 1e-14 s, or the last bits of a long delay, within a few
        for _ in range(50):
            ex, ey, ez = dx - v[0] * tau, dy - v[1] * tau, dz - v[2] * tau
            before = tau
            tau = (there + math.sqrt(ex * ex + ey * ey + ez * ez)) / c
            if abs(tau - before) <= 1e-14 + 4e-16 * tau:
                break
        dx, dy, dz = dx - v[0] * tau, dy - v[1] * tau, dz - v[2] * tau
    return tau, there, dx, dy, dz


@njit(nogil=True, cache=True)
def delays(points, tx, rx, v, c):  # type: ignore[no-untyped-def]
    """Travel times (s) of `points` (point, 3) for one trace."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        out[i] = _delay(points[i, 0], points[i, 1], points[i, 2], tx, rx, v, c)[0]
    return out


@njit(nogil=True, cache=True)
def _turn(turns):  # type: ignore[no-untyped-def]
    """exp(2j pi turns)."""
    angle = 2 * math.pi * (turns - math.floor(turns + 0.5))
    return complex(math.cos(angle), math.sin(angle))


@njit(nogil=True, cache=True)
def _look(directive, face, dx, dy, dz, c):  # type: ignore[no-untyped-def]
    """Whether a point lies before an element's face, and the sincs' arguments per Hz."""
    if not directive:
        return True, 0.0, 0.0
    scale = math.sqrt(dx * dx + dy * dy + dz * dz) * c
    if not dx * face[0] + dy * face[1] + dz * face[2] > 0.0:
        return False, 0.0, 0.0
    along = face[_LENGTH] * (dx * face[3] + dy * face[4] + dz * face[5]) / scale
    return True, along, face[_HEIGHT] * (dx * face[6] + dy * face[7] + dz * face[8]) / scale


@njit(nogil=True, cache=True)
def _lit(beam, lamp, dx, dy, dz):  # type: ignore[no-untyped-def]
    """What a beam weighs in a direction, from its components along what `lamp` holds."""
    kind, half, taper, sine = beam
    if kind == DARK:
        return 1.0
    aside = dx * lamp[3] + dy * lamp[4] + dz * lamp[5]
    if kind == LONG and aside * aside > sine * sine * (dx * dx + dy * dy + dz * dz):
        return 0.0  # without the angle, which takes longer
    ahead = dx * lamp[0] + dy * lamp[1] + dz * lamp[2]
    across = dx * lamp[6] + dy * lamp[7] + dz * lamp[8]
    if kind == ROUND:
        alpha = math.atan2(math.hypot(aside, across), ahead)
    else:
        alpha = math.atan2(abs(aside), math.hypot(ahead, across))
        before = dx * lamp[_BORESIGHT] + dy * lamp[_BORESIGHT + 1] + dz * lamp[_BORESIGHT + 2]
        if before < -EDGE_ANGLE * math.sqrt(dx * dx + dy * dy + dz * dz):
            return 0.0
    if taper == 0.0:
        return 1.0 if alpha <= half + EDGE_ANGLE else 0.0
    ramp = 1 - (half - alpha) / (taper * half)
    return 1.0 if ramp <= 0.0 else 0.0 if ramp >= 1.0 else 0.5 + 0.5 * math.cos(math.pi * ramp)


@njit(nogil=True, cache=True)
def _window(window, terms, u, duration):  # type: ignore[no-untyped-def]
    """Envelope at time `u` from the pulse's centre, inside its support."""
    if window == GAUSSIAN:
        return math.exp(-u * u * terms[0])
    if window == TUKEY:
        edge = (2 * abs(u) / duration - 1 + terms[0]) / terms[0]
        return 1.0 if edge <= 0.0 else 0.5 + 0.5 * math.cos(math.pi * min(edge, 1.0))
    if window == TAYLOR:
        x = math.cos(2 * math.pi * u / duration)
        return terms[0] + x * (terms[1] + x * (terms[2] + x * terms[3]))
    return 1.0


@njit(nogil=True, cache=True)
def add_echoes(  # type: ignore[no-untyped-def]
    sums, points, amplitudes, first, last, geometry, model, window, terms, spreading, faces, directive, lamp, beam
):
    """Add the echoes of points first ... last - 1 to one trace. Returns -1, or a point without distance for `spreading`.

    The phase pi (rate u + 2 offset) u of the chirp is quadratic in the sample number, so exp(j phase) follows from two
    complex products per sample: value *= advance; advance *= bend. Every _RESTART samples all are set anew.
    """
    tx, rx, v, start, c = geometry
    carrier, rate, duration, half, fc, fs = model
    offset, bend = carrier - fc, _turn(rate / fs / fs)
    n_sample = sums.size
    across, sines, turns = np.zeros(4), np.zeros(4, dtype=np.complex128), np.zeros(4, dtype=np.complex128)
    for i in range(first, last):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        weight = _lit(beam, lamp, x - tx[0], y - tx[1], z - tx[2])
        if weight == 0.0 and not spreading:
            continue
        tau, there, dx, dy, dz = _delay(x, y, z, tx, rx, v, c)
        amplitude = amplitudes[i]
        if spreading:
            loss = there * math.sqrt(dx * dx + dy * dy + dz * dz)
            if loss == 0.0:
                return i
            amplitude /= loss
        # the envelope's own test decides at the edges: begin a sample early, end a sample late
        middle = (tau - start + duration / 2) * fs
        if not (middle - half * fs < n_sample and middle + half * fs > -1.0):
            continue
        low = int(max(math.floor(middle - half * fs), 0.0))
        high = int(min(math.ceil(middle + half * fs), n_sample - 1.0))
        while low <= high and abs(start + low / fs - tau - duration / 2) > half:
            low += 1
        while low <= high and abs(start + high / fs - tau - duration / 2) > half:
            high -= 1
        if low > high:
            continue
        before_tx, along_tx, up_tx = _look(directive[0], faces[0], x - tx[0], y - tx[1], z - tx[2], c)
        before_rx, along_rx, up_rx = _look(directive[1], faces[1], dx, dy, dz, c)
        if not (before_tx and before_rx):
            continue
        if weight == 0.0:
            continue
        amplitude *= weight
        count = 0
        for argument in (along_tx, up_tx, along_rx, up_rx):
            if argument != 0.0:  # else the sinc is 1
                across[count] = argument
                count += 1
        amplitude *= _turn(-fc * tau)
        for restart in range(low, high + 1, _RESTART):
            u = start + restart / fs - tau - duration / 2
            value = amplitude * _turn((0.5 * rate * u + offset) * u)
            advance = _turn((rate * (u + 0.5 / fs) + offset) / fs)
            for k in range(count):
                sines[k] = _turn(0.5 * (carrier + rate * u) * across[k])
                turns[k] = _turn(0.5 * rate / fs * across[k])
            for n in range(restart, min(restart + _RESTART, high + 1)):
                if window == RECT and count == 0:
                    sums[n] += value
                else:
                    u = start + n / fs - tau - duration / 2
                    gain = _window(window, terms, u, duration)
                    below = 1.0
                    for k in range(count):
                        x = math.pi * (carrier + rate * u) * across[k]
                        if abs(x) > 1e-3:
                            gain *= sines[k].imag
                            below *= x
                        else:
                            gain *= 1 - x * x / 6
                        sines[k] *= turns[k]
                    sums[n] += value * (gain / below)
                value *= advance
                advance *= bend
    return -1


@njit(nogil=True, cache=True)
def energy(trace):  # type: ignore[no-untyped-def]
    """Sum of |trace|^2 in one fixed order, wherever the array lies in memory."""
    total = 0.0
    for value in trace:
        total += value.real * value.real + value.imag * value.imag
    return total
