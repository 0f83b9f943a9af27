"""Plain sums over pings and channels with a weight for every pixel, and the resampled sum of the circular-SAS paper.

They show what uniform view angles do to an image, and are what an engine's own weighting is compared with; float64, a pass
over the pixels for every trace, no approximation but the interpolation between samples. Nothing of an engine or of the oracle
is used.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import FloatArray
from pysas.circular import beams
from pysas.circular.geometry import track_angle, virtual_angles
from pysas.model.echoes import EDGE, Echoes
from pysas.model.grid import Grid

OVERSAMPLING = 16
TAPS = 8
_EVEN = 1.5  # largest step of a closed circle relative to the mean

Complex = npt.NDArray[np.complex128]


def weighted_sum(
    echoes: Echoes, grid: Grid, weights: npt.ArrayLike | None = None, pixels: npt.ArrayLike | None = None
) -> Complex:
    """Sum over pings and channels of weight s(tau) exp(2j pi fc tau), a weight for each pixel.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed, finite; terms outside the beam or the record do not count, those on its taper count by that.
    grid : Grid
        Its mask is not looked at.
    weights : (pixel, ping, channel), optional
        Real or complex; default 1. `view_weights` gives those that are uniform in view angle.
    pixels : (n,) integers, optional
        Flat indices (C order) of the pixels wanted; default: all.

    Returns
    -------
    complex128, grid.shape or (n,)

    Raises
    ------
    ValueError, TypeError
        Raw echoes, samples or weights that are not finite, weights of another shape.

    Notes
    -----
    The delay obeys c tau = |x - tx| + |x - rx - velocity tau|, the root of a quadratic. Traces are sampled 16 times finer by
    a transform of twice their length and read by 8-point Lagrange interpolation: 1e-9 of a sample's size within 0.9 of the
    band, away from the record's ends. O(pixel ping channel).
    """
    _compressed(echoes)
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={grid!r}: expected a pysas.Grid")
    points = grid.coordinates(pixels)
    shape = (len(points), echoes.n_ping, echoes.n_channel)
    factors = None if weights is None else _weights(weights, shape)
    total = np.zeros(len(points), dtype=np.complex128)
    for ping in range(echoes.n_ping):
        left = _beam(echoes, points, ping)
        for channel in range(echoes.n_channel):
            used = left > 0 if factors is None else (left > 0) & (factors[:, ping, channel] != 0)
            term = left[used] * _terms(echoes, points[used], ping, channel)
            total[used] += term if factors is None else factors[used, ping, channel] * term
    return total.reshape(grid.shape) if pixels is None else total


def resampled_sum(echoes: Echoes, grid: Grid, *, normalised: bool = True) -> Complex:
    """Image of a circular track as the sum over a virtual circle about each pixel (Pailhas et al., Eq 7).

    Parameters
    ----------
    echoes : Echoes
        Range-compressed, one channel at the transmitter, on a closed circle at one height (to a quarter wavelength).
    grid : Grid
        Pixels within the circle.
    normalised : bool
        True: (2 pi/N') times the sum. False: 2 pi times it, as printed.

    Returns
    -------
    complex128, grid.shape

    Raises
    ------
    ValueError, TypeError
        Raw echoes, another track, a pixel on or beyond the circle.

    Notes
    -----
    I(O') = (2 pi/N') sum over n of s at h^-1(theta'_n), read at t = 2 |S O'|/c, from the ping nearest to h^-1(theta'_n) with
    that ping's own position. Misprints: the paper omits 1/N', so that the gain changes with N' from pixel to pixel, and
    has t = |S O'|/c. `weighted_sum` with `view_weights` gives the same image (times N/(2 pi)) from all pings.
    O(N') per pixel; a count for each (pixel, ping) is held.
    """
    _compressed(echoes)
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={grid!r}: expected a pysas.Grid")
    wavelength = echoes.speed / echoes.fc
    centre, radius, azimuth = _circle(echoes, wavelength)
    order = np.argsort(azimuth)
    steps = np.diff(azimuth[order], append=azimuth[order[0]] + 2 * np.pi)
    if steps.max() > _EVEN * 2 * np.pi / echoes.n_ping:
        raise ValueError(f"tx: a gap of {np.degrees(steps.max()):.3g} degrees: expected a closed, evenly sampled circle")
    middles = azimuth[order] + steps / 2
    points = grid.coordinates()
    offset = np.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1]) / radius
    if offset.max() >= 1:
        raise ValueError(f"grid: a pixel {offset.max():.4g} radii from the centre: expected all within the circle")
    direction = np.arctan2(points[:, 1] - centre[1], points[:, 0] - centre[0])
    # how often each pixel takes each ping
    times = np.zeros((len(points), echoes.n_ping, 1))
    for number, (a, psi) in enumerate(zip(offset, direction, strict=True)):
        theta = track_angle(virtual_angles(radius, wavelength, a), a) + psi
        place = np.searchsorted(middles, middles[-1] - 2 * np.pi + np.mod(theta - middles[-1], 2 * np.pi))
        count = np.bincount(order[place % order.size], minlength=echoes.n_ping)
        times[number, :, 0] = count / (theta.size if normalised else 1)
    return 2 * np.pi * weighted_sum(echoes, grid, times)


def _compressed(echoes: Echoes) -> None:
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={echoes!r}: expected pysas.Echoes")
    if not echoes.compressed:
        raise ValueError("echoes: compressed=False: expected range-compressed echoes (pysas.compress)")
    finite = np.isfinite(echoes.whole().traces)
    if not finite.all():
        ping, channel, sample = (int(i) for i in np.argwhere(~finite)[0])
        raise ValueError(f"data: not finite at ping {ping}, channel {channel}, sample {sample}: expected finite samples")


def _weights(weights: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    array = _checks.array_like("weights", weights)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"weights: expected real or complex numbers, found dtype {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"weights: expected shape (pixel, ping, channel) = {shape}, found {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"weights: {array[~np.isfinite(array)][0]}: expected finite values")
    return array


def _beam(echoes: Echoes, points: FloatArray, ping: int) -> FloatArray:
    """What the transmitter's beam leaves of each point's terms."""
    if echoes.beam is None:
        return np.ones(len(points))
    return beams.weight(echoes.beam, beams.off_middle(echoes.beam, points - echoes.tx[ping], ping))


def _terms(echoes: Echoes, points: FloatArray, ping: int, channel: int) -> Complex:
    """s(tau) exp(2j pi fc tau) at `points`, 0 outside the record."""
    c, (first, last) = float(echoes.speeds[ping]), echoes.windows[ping, channel]
    outward = np.linalg.norm(points - echoes.tx[ping], axis=-1)
    path = points - echoes.receivers[ping, channel]
    squared = np.sum(path**2, axis=-1)
    if echoes.receiver_velocity is None:
        tau = (outward + np.sqrt(squared)) / c
    else:
        velocity = echoes.receiver_velocity[ping, channel]
        # (c^2 - v^2) tau^2 - 2 (c outward - path.v) tau + outward^2 - |path|^2 = 0
        lead = c**2 - float(velocity @ velocity)
        half = c * outward - path @ velocity
        tau = (half + np.sqrt(half**2 + lead * (squared - outward**2))) / lead
    position = (tau - echoes.start_time[ping]) * echoes.fs
    inside = (position >= first - EDGE) & (position <= last + EDGE)
    values = np.zeros(len(points), dtype=np.complex128)
    if inside.any():
        recorded = echoes.traces[ping, channel, first : last + 1]
        read = _read(recorded, np.clip(position[inside], first, last) - first)
        values[inside] = read * np.exp(2j * np.pi * np.mod(echoes.fc * tau[inside], 1.0))
    return values


def _read(trace: npt.NDArray[Any], position: FloatArray) -> Complex:
    """Band-limited trace at `position`, in samples."""
    n = scipy.fft.next_fast_len(2 * trace.size)
    spectrum = scipy.fft.fft(trace.astype(np.complex128), n)
    padded = np.zeros(n * OVERSAMPLING, dtype=np.complex128)
    half = n // 2
    padded[:half], padded[half - n :] = spectrum[:half], spectrum[half:]
    fine = scipy.fft.ifft(padded) * OVERSAMPLING
    place = position * OVERSAMPLING
    cell = np.floor(place)
    t = place - cell + (TAPS // 2 - 1)
    first = cell.astype(np.intp) - (TAPS // 2 - 1)
    value = np.zeros(position.size, dtype=np.complex128)
    for k in range(TAPS):
        others = [j for j in range(TAPS) if j != k]
        factor = np.prod([(t - j) / (k - j) for j in others], axis=0)
        value += factor * fine[(first + k) % fine.size]
    return value


def _circle(echoes: Echoes, wavelength: float) -> tuple[FloatArray, float, FloatArray]:
    """Centre (x, y), radius and azimuths of a monostatic circular track."""
    if echoes.n_channel != 1 or np.max(np.linalg.norm(echoes.receivers[:, 0] - echoes.tx, axis=-1)) > wavelength / 4:
        raise ValueError("rx: expected one channel at the transmitter")
    if echoes.n_ping < 3:
        raise ValueError(f"tx: {echoes.n_ping} pings: expected a closed, evenly sampled circle")
    x, y, z = (echoes.tx - echoes.tx.mean(axis=0)).T
    # |p|^2 = 2 p.centre + constant: linear in the centre
    solution = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1), x**2 + y**2, rcond=None)[0]
    away = np.hypot(x - solution[0], y - solution[1])
    radius = float(away.mean())
    off = max(float(np.abs(away - radius).max()), float(np.abs(z).max()))
    if off > wavelength / 4:
        raise ValueError(f"tx: {off:.3g} m from a level circle: expected at most a quarter wavelength, {wavelength / 4:.3g} m")
    centre = echoes.tx.mean(axis=0)[:2] + solution[:2]
    return centre, radius, np.arctan2(y - solution[1], x - solution[0])
