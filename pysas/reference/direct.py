"""The float64 oracle: the sum over pings and channels that "exact" means everywhere in pysas.

It relies on Echoes and Grid for the data and on nothing else of pysas: delays, interpolation and the counting rule
are its own, so that engine, simulator and oracle share no error. Ranges, delays and turns of phase are np.longdouble
(64-bit mantissa on x86; where long double is float64 the phase keeps about 1e-16 range/wavelength). Slow, plain, never
optimised.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len

from pysas.model.echoes import Echoes
from pysas.model.grid import Grid

OVERSAMPLING = 8
TAPS = 20
GUARD = 2  # samples read beyond each end of the record: TAPS/2 fine samples, rounded up
PASS_EDGE, STOP_EDGE = 1 / 2.2, 0.5  # of W, in cycles per sample
CHUNK = 8192  # pixels read at once
# How far beyond a record's end (samples) and a beam's edge (rad) a term still counts: see `exact`.
EDGE, EDGE_ANGLE = 1e-4, 1e-7

Complex = npt.NDArray[np.complex128]
Float = npt.NDArray[np.float64]
Long = npt.NDArray[np.longdouble]


def exact(
    echoes: Echoes, grid: Grid, pixels: npt.ArrayLike | None = None, weights: npt.ArrayLike | None = None
) -> tuple[Complex, Float]:
    """Sum weight s(tau) exp(+2j pi fc tau) over pings and channels, and its incoherent level R.

    A (pixel, ping, channel) term counts if and only if u = (tau - t0) fs lies from 0 to n - 1 for n samples (of `valid` =
    (a, b), from a to b: such a trace is the one cropped to samples a to b, begun at t0 + a/fs, whatever the others hold) and,
    with a beam, if the pixel's angle alpha off its middle is at most the half-angle: the angle between the vector from the
    transmitter to the pixel and boresight (cone), or the plane across the fan's axis, of which only boresight's side counts
    (receivers are not tested; a pixel on the transmitter counts). It then weighs 1 up to (1 - taper) half_angle and
    cos^2(pi/2 (alpha - (1 - taper) half_angle)/(taper half_angle)) beyond, beside `weights`. Pixels are often put exactly on
    an edge, where the rounding of their coordinates would decide; so that it does not, edges lie outside of where they are
    put by EDGE = 1e-4 samples (-1e-4 <= u <= n - 1 + 1e-4) and, where there is no taper and at the end of a fan's side,
    EDGE_ANGLE = 1e-7 rad: coordinates of 5e6 m rounded to float64 are wrong by 1e-6 samples at 1 MHz and by 1e-9 rad at 1 m,
    and no sonar is known to 2 um or 1e-7 rad. Beyond its end a trace is read at the end. The delay obeys
    c tau = |x - tx| + |x - rx - velocity tau| with the ping's own c.

    Each trace is read as a band-limited signal: extended with zeros, low-passed by W(f) = 1 for |f| <= fs/2.2 falling
    as cos^2 to exactly 0 at fs/2, and sampled at 8 fs. Here the zeros have no end: the trace is convolved with W's
    kernel, known in closed form, over every lag it has. An extension to a finite length makes the kernel periodic; it
    differs, in L2 for white samples, by 2e-7 (1024 samples, 1024 zeros) or 4e-9 (4096 samples, 4096 zeros), all of it
    near the ends. Between the fine samples the signal is read by 20-point Lagrange interpolation. In the central cell
    that is wrong for exp(j w k), |w| <= pi/8 per fine sample, by no more than w^20/20! (19!!/2^10)^2 <= 1.3e-15 (the
    remainder), plus rounding: together below 1e-13 of the largest sample.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed data, finite where they were recorded.
    grid : Grid
        Where. Pixels whose mask is False are 0.
    pixels : (n,) integers, optional
        Flat indices (C order) of the pixels wanted; default: all.
    weights : (ping,) or (ping, channel) real or complex, optional
        Factor of each trace; default 1.

    Returns
    -------
    exact : complex128, grid.shape or (n,)
    level : float64, the same shape
        R = sqrt(sum |weight x sample|^2).

    Raises
    ------
    ValueError
        Raw (uncompressed) echoes; a non-finite sample (ping and channel named); weights of wrong shape or not finite.
    TypeError
        Arguments of the wrong type.

    Notes
    -----
    O(ping channel (pixel + n log n)) time, about 1 us per term; memory 100 B per pixel and 1 kB per sample of a trace.
    Remainder of Lagrange interpolation: P. J. Davis, Interpolation and Approximation (1963), Eq 3.1.1.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={echoes!r}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={grid!r}: expected a pysas.Grid")
    if not echoes.compressed:
        raise ValueError("echoes: compressed=False: expected range-compressed echoes (pysas.compress)")
    _require_finite(echoes)
    peak = _peak(echoes)
    if peak > 0 and not 1e-100 < peak < 1e100:  # their squares are no numbers, those of others of the same shape are
        shift = int(np.frexp(peak)[1])
        data = np.empty(echoes.data.shape, dtype=np.complex128)
        with np.errstate(invalid="ignore", over="ignore"):  # of what was not recorded
            for part, source in ((data.real, echoes.data.real), (data.imag, echoes.data.imag)):
                np.ldexp(np.asarray(source, dtype=np.float64), -shift, out=part)
        found = exact(echoes.replace(data=data), grid, pixels, weights)
        return np.ldexp(found[0].view(np.float64), shift).view(np.complex128), np.ldexp(found[1], shift)
    factors = _factors(weights, echoes)
    points = grid.coordinates(pixels)
    shape = grid.shape if pixels is None else (len(points),)
    wanted = np.ones(len(points), dtype=np.bool_)
    if grid.mask is not None:
        mask = grid.mask.ravel()
        wanted = mask if pixels is None else mask[np.asarray(pixels)]
    kept = np.flatnonzero(wanted)
    total, power = _sum(echoes, np.ascontiguousarray(points[kept].T, dtype=np.longdouble), factors)
    image = np.zeros(len(points), dtype=np.complex128)
    level = np.zeros(len(points))
    image[kept] = total
    level[kept] = np.sqrt(power)
    return image.reshape(shape), level.reshape(shape)


def _require_finite(echoes: Echoes) -> None:
    for ping in range(echoes.n_ping):
        for channel in range(echoes.n_channel):
            trace, first = _cropped(echoes, ping, channel)
            finite = np.isfinite(trace)
            if not finite.all():
                sample = int(np.argmin(finite))
                where = f"ping {ping}, channel {channel}, sample {first + sample}"
                raise ValueError(f"data: {trace[sample]} at {where}: expected finite samples")


def _cropped(echoes: Echoes, ping: int, channel: int) -> tuple[npt.NDArray[Any], int]:
    """What was recorded of a trace, and the number of its first sample."""
    trace, valid = echoes.traces[ping, channel], echoes.valid
    if valid is None:
        return trace, 0
    first, last = (int(end) for end in (valid[ping] if valid.ndim == 2 else valid[ping, channel]))
    return trace[first : last + 1], first


def _peak(echoes: Echoes) -> float:
    """Largest real or imaginary part recorded."""
    traces = (_cropped(echoes, ping, channel)[0] for ping in range(echoes.n_ping) for channel in range(echoes.n_channel))
    return max(float(np.max(np.abs(part), initial=0.0)) for trace in traces for part in (trace.real, trace.imag))


def _factors(weights: npt.ArrayLike | None, echoes: Echoes) -> npt.NDArray[Any]:
    """Weights as (ping, channel)."""
    shape = (echoes.n_ping, echoes.n_channel)
    if weights is None:
        return np.ones(shape)
    array = np.asarray(weights)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"weights: expected real or complex numbers, found dtype {array.dtype}")
    if array.shape not in (shape[:1], shape):
        raise ValueError(f"weights: expected shape {shape[:1]} or {shape}, found {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"weights: {array[~np.isfinite(array)][0]}: expected finite values")
    return np.broadcast_to(array if array.ndim == 2 else array[:, None], shape)


def _sum(echoes: Echoes, points: Long, factors: npt.NDArray[Any]) -> tuple[Complex, Float]:
    """Image and squared level at `points` (3, n)."""
    total = np.zeros(points.shape[1], dtype=np.complex128)
    power = np.zeros(points.shape[1])
    fs, fc = np.longdouble(echoes.fs), np.longdouble(echoes.fc)
    for ping in range(echoes.n_ping):
        seen, lit = _seen(echoes, points, ping)
        c = np.longdouble(echoes.c if isinstance(echoes.c, float) else echoes.c[ping])
        outward = _distance(points[:, seen], echoes.tx[ping])
        for channel in range(echoes.n_channel):
            receiver = echoes.receivers[ping, channel]
            velocity = None if echoes.receiver_velocity is None else echoes.receiver_velocity[ping, channel]
            trace, first = _cropped(echoes, ping, channel)
            start_time, last = np.longdouble(echoes.start_time[ping]) + first / fs, trace.size - 1
            fine: Complex | None = None  # made only where a pixel needs it
            for start in range(0, seen.size, CHUNK):
                chunk = seen[start : start + CHUNK]
                tau = _delay(outward[start : start + CHUNK], points[:, chunk], receiver, velocity, c)
                position = (tau - start_time) * fs
                counts = (position >= -EDGE) & (position <= last + EDGE)
                if not counts.any():
                    continue
                if fine is None:
                    fine = _fine_trace(trace)
                pixel = chunk[counts]
                sample = factors[ping, channel] * _read(fine, np.clip(position[counts], 0, last))
                sample *= lit[start : start + CHUNK][counts]
                turns = fc * tau[counts]
                turns -= np.rint(turns)
                total[pixel] += sample * np.exp(2j * np.pi * turns.astype(np.float64))
                power[pixel] += sample.real**2 + sample.imag**2
    return total, power


def _seen(echoes: Echoes, points: Long, ping: int) -> tuple[npt.NDArray[np.intp], Float]:
    """Indices of the points within the transmitter's beam, and what their terms weigh for it."""
    beam = echoes.beam
    if beam is None:
        return np.arange(points.shape[1]), np.ones(points.shape[1])
    direction = (points - echoes.tx[ping].astype(np.longdouble)[:, None]).astype(np.float64).T
    boresight = np.broadcast_to(beam.boresight, echoes.tx.shape)[ping]
    # arctangents keep small angles, which arc cosines would round away
    if beam.shape == "cone":
        angle = np.arctan2(np.linalg.norm(np.cross(direction, boresight), axis=-1), direction @ boresight)
        seen = np.ones(angle.size, dtype=np.bool_)
    else:
        axis = np.cross(boresight, [0, 0, 1]) if beam.axis is None else np.broadcast_to(beam.axis, echoes.tx.shape)[ping]
        angle = np.arctan2(np.abs(direction @ axis), np.linalg.norm(np.cross(direction, axis), axis=-1))
        distance = np.linalg.norm(direction, axis=-1) * np.linalg.norm(boresight)
        seen = direction @ boresight >= -EDGE_ANGLE * distance
    edge = beam.half_angle + (EDGE_ANGLE if beam.taper == 0 else 0.0)
    lit = np.flatnonzero(seen & (angle <= edge))
    weight = np.ones(lit.size)
    if beam.taper > 0:
        ramp = (angle[lit] - (1 - beam.taper) * beam.half_angle) / (beam.taper * beam.half_angle)
        weight = np.cos(np.pi / 2 * np.clip(ramp, 0, 1)) ** 2
    return lit, weight


def _distance(points: Long, origin: Float) -> Long:
    squared = np.zeros(points.shape[1], dtype=np.longdouble)
    for axis in range(3):
        squared += (points[axis] - np.longdouble(origin[axis])) ** 2
    return np.sqrt(squared)


def _delay(outward: Long, points: Long, receiver: Float, velocity: Float | None, c: np.longdouble) -> Long:
    """Travel time tau of c tau = outward + |x - rx - velocity tau|.

    Newton's method: g(tau) = c tau - outward - |x - rx - velocity tau| is concave and rises at least as c - |velocity|,
    so after one step the iterates grow monotonically to the root, from any start, and quadratically.
    """
    tau = (outward + _distance(points, receiver)) / c
    if velocity is None or not velocity.any():
        return tau
    offset = points - receiver.astype(np.longdouble)[:, None]
    speed = velocity.astype(np.longdouble)[:, None]
    enough = 4 * np.finfo(np.longdouble).eps
    for _ in range(50):
        path = offset - speed * tau
        back = np.sqrt(np.sum(path**2, axis=0))
        slope = c + np.sum(speed * path, axis=0) / np.where(back > 0, back, 1)
        step = (c * tau - outward - back) / slope
        tau -= step
        if np.all(np.abs(step) <= enough * tau):
            break
    return tau


def _low_pass_kernel(t: Float) -> Float:
    """Inverse Fourier transform of W at `t` samples: a raised cosine's, 2 h sinc(2 h t) cos(pi x / 2)/(1 - x^2).

    h is the half-amplitude frequency and x = 2 (STOP_EDGE - PASS_EDGE) t; Proakis, Digital Communications, Eq 9.2-27.
    Written with cos(pi x / 2) = sin(pi (1 - x)/2), which is smooth at x = 1.
    """
    h = (PASS_EDGE + STOP_EDGE) / 2
    x = 2 * (STOP_EDGE - PASS_EDGE) * np.abs(t)
    return np.asarray(2 * h * np.sinc(2 * h * t) * np.pi / 2 * np.sinc((1 - x) / 2) / (1 + x))


@lru_cache(maxsize=4)
def _filters(n: int) -> Complex:
    """Transforms of W's kernel at the OVERSAMPLING phases of a fine sample, over all lags of a trace of `n` samples."""
    m = int(next_fast_len(2 * (n + GUARD)))
    lag = np.arange(m)
    lag[lag > m // 2] -= m
    phase = np.arange(OVERSAMPLING)[:, None] / OVERSAMPLING
    return np.asarray(np.fft.fft(_low_pass_kernel(lag + phase), axis=1))


def _fine_trace(trace: npt.NDArray[Any]) -> Complex:
    """The low-passed trace at OVERSAMPLING fs, from GUARD samples before the first to GUARD after the last."""
    n = trace.size
    filters = _filters(n)
    phases = np.fft.ifft(np.fft.fft(trace.astype(np.complex128), filters.shape[1]) * filters, axis=1)
    return np.concatenate([phases[:, -GUARD:], phases[:, : n + GUARD]], axis=1).T.ravel()


def _read(fine: Complex, position: Long) -> Complex:
    """Trace at `position` (samples, 0 to n - 1): Lagrange interpolation in the central cell, second barycentric form.

    Berrut and Trefethen, SIAM Review 46 (2004), Eq 4.2; equally spaced nodes: weights (-1)^k binomial(TAPS - 1, k).
    """
    place = position * OVERSAMPLING
    cell = np.floor(place)
    first = cell.astype(np.intp) + GUARD * OVERSAMPLING - (TAPS // 2 - 1)
    t = (place - cell).astype(np.float64)
    numerator = np.zeros(t.size, dtype=np.complex128)
    denominator = np.zeros(t.size)
    for k in range(TAPS):
        distance = t - (k - (TAPS // 2 - 1))
        distance[distance == 0] = 1e-30  # on a node: its term then outweighs all others by 1e30
        weight = (-1) ** k * comb(TAPS - 1, k) / distance
        numerator += weight * fine[first + k]
        denominator += weight
    return np.asarray(numerator / denominator)
