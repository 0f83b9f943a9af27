"""Raw echoes of point scatterers, evaluated from the analytic pulse at exact delays; nothing is interpolated.

The quadratic phase of a pulse is advanced from sample to sample by a complex recurrence restarted every 128 samples, which
keeps it within 1e-13 of direct evaluation. Pings are independent tasks on worker threads; memory is one trace buffer per
thread. Shares no delay code with the engine or the oracle.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.echoes import Echoes
from pysas.pulse import LFM, WINDOWS

_CHUNK = 4096
_RESTART = 128
_ALIAS_WARNING = 0.01


@dataclass(frozen=True, eq=False)
class Element:
    """Rectangular transducer face with the two-way-independent pattern sinc(f L u_along/c) sinc(f H u_up/c).

    Parameters
    ----------
    length, height : float
        Along-track and vertical size, m; height 0: no vertical pattern.
    boresight, along : (3,) or (ping, 3) array_like
        Normal of the face and its along-track axis; made unit length, `along` made perpendicular to `boresight`. Nothing
        is heard behind the face.
    """

    length: float
    height: float = 0.0
    boresight: npt.ArrayLike = (0.0, 1.0, 0.0)
    along: npt.ArrayLike = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "length", _checks.number("length", self.length, positive=True))
        object.__setattr__(self, "height", _checks.number("height", self.height, low=0.0))
        boresight = _checks.reals("boresight", self.boresight, [(3,), ("ping", 3)], ("ping",))
        along = _checks.reals("along", self.along, [(3,), ("ping", 3)], ("ping",))
        norm = np.linalg.norm(boresight, axis=-1, keepdims=True)
        if not np.all(norm > 0):
            raise ValueError(f"boresight={self.boresight!r}: expected non-zero vectors")
        boresight = boresight / norm
        across = along - np.sum(along * boresight, axis=-1, keepdims=True) * boresight
        norm = np.linalg.norm(across, axis=-1, keepdims=True)
        if not np.all(norm > 1e-9):
            raise ValueError(f"along={self.along!r}: expected vectors not parallel to boresight")
        object.__setattr__(self, "boresight", boresight)
        object.__setattr__(self, "along", across / norm)

    def axes(self, pings: int, name: str) -> FloatArray:
        """(ping, 11): length, height, then boresight, along and up unit vectors."""
        boresight, along = np.asarray(self.boresight), np.asarray(self.along)
        for vectors in (boresight, along):
            if vectors.shape not in ((3,), (pings, 3)):
                raise ValueError(f"{name}: vectors of shape {vectors.shape}: expected (3,) or ({pings}, 3)")
        boresight, along = np.broadcast_to(boresight, (pings, 3)), np.broadcast_to(along, (pings, 3))
        sizes = np.tile([self.length, self.height], (pings, 1))
        return np.concatenate([sizes, boresight, along, np.cross(along, boresight)], axis=1)


@njit(nogil=True, cache=True)
def _delay(x, tx, rx, velocity, c):  # type: ignore[no-untyped-def]
    """Two-way travel time, s: c tau = |x - tx| + |x - rx - v tau|, iterated until it moves less than 1e-15 s."""
    there = np.sqrt((x[0] - tx[0]) ** 2 + (x[1] - tx[1]) ** 2 + (x[2] - tx[2]) ** 2)
    tau = 0.0
    for _ in range(60):
        dx, dy, dz = x[0] - rx[0] - velocity[0] * tau, x[1] - rx[1] - velocity[1] * tau, x[2] - rx[2] - velocity[2] * tau
        new = (there + np.sqrt(dx * dx + dy * dy + dz * dz)) / c
        moved = abs(new - tau)
        tau = new
        if moved < 1e-15:
            break
    return tau


@njit(nogil=True, cache=True)
def _face(x, at, axes):  # type: ignore[no-untyped-def]
    """Delays across the face, L u_along and H u_up (m), of the direction from `at` to `x`; NaN behind the face."""
    dx, dy, dz = x[0] - at[0], x[1] - at[1], x[2] - at[2]
    r = np.sqrt(dx * dx + dy * dy + dz * dz)
    if r == 0.0 or dx * axes[2] + dy * axes[3] + dz * axes[4] <= 0.0:
        return np.nan, np.nan
    along = (dx * axes[5] + dy * axes[6] + dz * axes[7]) / r
    up = (dx * axes[8] + dy * axes[9] + dz * axes[10]) / r
    return axes[0] * along, axes[1] * up


@njit(nogil=True, cache=True)
def _sinc(x):  # type: ignore[no-untyped-def]
    return 1.0 if x == 0.0 else np.sin(np.pi * x) / (np.pi * x)


@njit(nogil=True, cache=True)
def _envelope(window, u, duration, parameter, taylor):  # type: ignore[no-untyped-def]
    if window == 1:
        return np.exp(-u * u / (2 * parameter * parameter))
    if window == 2:
        edge = 2 * abs(u) / duration - 1 + parameter
        return 1.0 if edge <= 0 else 0.5 + 0.5 * np.cos(np.pi * edge / parameter)
    if window == 3:
        total = 1.0
        for m in range(1, taylor.size):
            total += 2 * taylor[m] * np.cos(2 * np.pi * m * u / duration)
        return total * taylor[0]
    return 1.0


@njit(nogil=True, cache=True)
def _add_echoes(points, amplitudes, tx, rx, velocity, tx_axes, rx_axes, scales, window, taylor, spreading, trace):  # type: ignore[no-untyped-def]
    """Add all points' echoes of one ping to `trace` (channel, sample).

    scales: c, fs, t0, demodulation fc, pulse fc, rate, duration, window parameter, half the support.
    """
    c, fs, t0, fc, pulse_fc = scales[0], scales[1], scales[2], scales[3], scales[4]
    rate, duration, parameter, reach = scales[5], scales[6], scales[7], scales[8]
    dt = 1 / fs
    offset = pulse_fc - fc
    turn = np.exp(2j * np.pi * rate * dt * dt)
    patterned = tx_axes.size > 0 or rx_axes.size > 0
    for channel in range(rx.shape[0]):
        for point in range(points.shape[0]):
            x = points[point]
            tau = _delay(x, tx, rx[channel], velocity[channel], c)
            centre = tau + duration / 2 - t0
            first = max(int(np.ceil((centre - reach) * fs)), 0)
            last = min(int(np.floor((centre + reach) * fs)), trace.shape[1] - 1)
            if last < first:
                continue
            amplitude = amplitudes[point]
            there = np.sqrt((x[0] - tx[0]) ** 2 + (x[1] - tx[1]) ** 2 + (x[2] - tx[2]) ** 2)
            if spreading:
                amplitude = amplitude / (there * (c * tau - there))
            a1, a2, b1, b2 = 0.0, 0.0, 0.0, 0.0
            if tx_axes.size > 0:
                a1, a2 = _face(x, tx, tx_axes)
            if rx_axes.size > 0:
                at = rx[channel] + velocity[channel] * tau
                b1, b2 = _face(x, at, rx_axes)
            if np.isnan(a1) or np.isnan(b1):
                continue
            carrier = fc * tau
            carrier = amplitude * np.exp(-2j * np.pi * (carrier - np.floor(carrier)))
            value, step = 0j, 0j
            for n in range(first, last + 1):
                u = n * dt - centre
                if (n - first) % _RESTART == 0:
                    value = carrier * np.exp(1j * np.pi * (rate * u + 2 * offset) * u)
                    step = np.exp(1j * np.pi * (rate * (2 * u + dt) + 2 * offset) * dt)
                gain = _envelope(window, u, duration, parameter, taylor) if window else 1.0
                if patterned:
                    f = (pulse_fc + rate * u) / c
                    gain *= _sinc(f * a1) * _sinc(f * a2) * _sinc(f * b1) * _sinc(f * b2)
                trace[channel, n] += gain * value
                value *= step
                step *= turn


def aliased_share(pulse: LFM, fs: float, fc: float | None = None) -> float:
    """Share of the pulse's energy outside |f - fc| <= fs/2, by quadrature of its spectrum.

    The band's energy is integrated on a grid finer than 1/(8 duration); the total is the pulse's closed form (Parseval).
    """
    centre = (pulse.fc if fc is None else fc) - pulse.fc
    span = pulse.support[1] - pulse.support[0]
    count = int(np.ceil(fs * span * 8)) | 1
    f = np.linspace(centre - fs / 2, centre + fs / 2, max(count, 2001))
    inside = float(np.trapezoid(np.abs(pulse.spectrum(f)) ** 2, f))
    return max(0.0, 1 - inside / pulse.energy)


def simulate(
    points: npt.ArrayLike,
    amplitudes: npt.ArrayLike,
    pulse: LFM,
    *,
    tx: npt.ArrayLike,
    rx: npt.ArrayLike,
    fs: float,
    duration: float,
    c: float = 1500.0,
    t0: float | npt.ArrayLike = 0.0,
    velocity: npt.ArrayLike | None = None,
    fc: float | None = None,
    spreading: bool = False,
    tx_element: Element | None = None,
    rx_element: Element | None = None,
    snr_db: float | None = None,
    seed: int | None = None,
    dtype: npt.DTypeLike = np.complex64,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    ping_time: npt.ArrayLike | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> Echoes:
    """Raw echoes of point scatterers.

    Parameters
    ----------
    points : (point, 3) array_like
        Positions, m.
    amplitudes : (point,) array_like
        Real or complex.
    pulse : LFM
    tx : (ping, 3) array_like
        Transmitter at transmission, m.
    rx : (ping, channel, 3) or (ping, 3) array_like
        Receivers at transmission, m; decides the shape of the data.
    fs : float
        Sample rate, Hz.
    duration : float
        Length of the record, s: ceil(duration fs) samples from t0.
    c : float
        Sound speed, m/s.
    t0 : float or (ping,)
        Time of sample 0 after the start of transmission, s.
    velocity : (ping, 3) or (ping, channel, 3), optional
        Receivers' velocity until the echo arrives, m/s; the delay is solved to 1e-15 s.
    fc : float, optional
        Demodulation frequency, Hz; default: the pulse's.
    spreading : bool
        Divide by both ranges (spherical spreading, m).
    tx_element, rx_element : Element, optional
        Frequency-dependent patterns at the pulse's instantaneous frequency.
    snr_db : float, optional
        Adds complex white Gaussian noise this far below the mean power of all samples of the record.
    seed : int, optional
        Of the noise; None draws a fresh one.
    dtype : complex64 or complex128
    threads : int, optional
        The result does not depend on it.
    progress : callable, optional
        Called with the share done, 0 to 1.
    ping_time, attrs : optional
        Handed to the Echoes.

    Returns
    -------
    Echoes
        compressed=False.

    Raises
    ------
    ValueError, TypeError
        A wrong argument; names it.

    Warns
    -----
    UserWarning
        More than 1 % of the pulse's energy lies outside fs and aliases.

    Notes
    -----
    O(pings channels points pulse samples). The sum over points of a trace is in complex128 and in order of the points.
    """
    if not isinstance(pulse, LFM):
        raise TypeError(f"pulse={pulse!r}: expected a pysas.LFM")
    where = _checks.reals("points", points, [("point", 3)], ("point",))
    if where.shape[0] == 0:
        raise ValueError("points: expected at least one point, found none")
    strength = np.asarray(amplitudes)
    if strength.dtype.kind not in "iufc":
        raise TypeError(f"amplitudes: expected numbers, found dtype {strength.dtype}")
    if strength.shape != where.shape[:1]:
        raise ValueError(f"amplitudes: expected shape {where.shape[:1]}, found {strength.shape}")
    if not np.all(np.isfinite(strength)):
        raise ValueError(f"amplitudes: non-finite at point {int(np.argmax(~np.isfinite(strength)))}: expected finite values")
    strength = strength.astype(np.complex128)
    kind = np.dtype(dtype)
    if kind not in (np.dtype(np.complex64), np.dtype(np.complex128)):
        raise TypeError(f"dtype={dtype!r}: expected complex64 or complex128")
    fs = _checks.number("fs", fs, positive=True)
    samples = int(np.ceil(_checks.number("duration", duration, positive=True) * fs - 1e-9))
    fc = pulse.fc if fc is None else _checks.number("fc", fc, positive=True)
    receivers = _checks.reals("rx", rx, [("ping", "channel", 3), ("ping", 3)], ("ping", "channel"))
    shape = (*receivers.shape[:-1], samples)
    if 0 in shape:
        raise ValueError(f"rx: expected at least one ping and channel, found shape {receivers.shape}")
    data = np.zeros(shape, dtype=kind)
    geometry: dict[str, Any] = {"tx": tx, "t0": t0, "velocity": velocity, "ping_time": ping_time}
    echoes = Echoes(data, fs=fs, fc=fc, rx=receivers, c=c, pulse=pulse, compressed=False, attrs=attrs or {}, **geometry)
    if snr_db is not None:
        snr_db = _checks.number("snr_db", snr_db)
    workers = _checks.threads(threads)
    share = aliased_share(pulse, fs, fc)
    if share > _ALIAS_WARNING:
        warnings.warn(f"{100 * share:.2g} % of the pulse's energy lies outside fs={fs:g} Hz and aliases", stacklevel=2)

    moving = echoes.receiver_velocity
    rest = np.zeros((echoes.n_channel, 3))
    none = np.zeros(0)
    faces = [
        None if element is None else element.axes(echoes.n_ping, name)
        for name, element in (("tx_element", tx_element), ("rx_element", rx_element))
    ]
    scale, terms = pulse._taylor if pulse.window == "taylor" else (0.0, none)
    taylor = np.concatenate([[scale], terms])
    half = (pulse.support[1] - pulse.support[0]) / 2
    window = WINDOWS.index(pulse.window)
    traces = echoes.traces

    def ping_task(ping: int) -> None:
        buffer = np.zeros((echoes.n_channel, samples), dtype=np.complex128)
        start, parameter = echoes.start_time[ping], pulse.window_parameter or 0.0
        scales = np.array([echoes.c, fs, start, fc, pulse.fc, pulse.rate, pulse.duration, parameter, half])
        axes = [none if face is None else face[ping] for face in faces]
        for begin in range(0, where.shape[0], _CHUNK):
            _add_echoes(
                where[begin : begin + _CHUNK], strength[begin : begin + _CHUNK], echoes.tx[ping], echoes.receivers[ping],
                rest if moving is None else np.ascontiguousarray(moving[ping]), axes[0], axes[1], scales, window, taylor,
                spreading, buffer,
            )  # fmt: skip
        traces[ping] = buffer

    def tick(done: int) -> None:
        assert progress is not None
        progress(done / echoes.n_ping)

    _pool.run(ping_task, echoes.n_ping, workers, None if progress is None else tick)
    if snr_db is not None:
        _add_noise(traces, snr_db, seed)
    return echoes


def _add_noise(traces: npt.NDArray[np.complexfloating[Any, Any]], snr_db: float, seed: int | None) -> None:
    """White complex noise of variance mean |sample|^2 / 10^(snr/10), one generator per ping."""
    power = float(np.mean([np.mean(np.abs(trace).astype(np.float64) ** 2) for trace in traces]))
    spread = np.sqrt(power / 10 ** (snr_db / 10) / 2)
    for trace, stream in zip(traces, np.random.SeedSequence(seed).spawn(len(traces)), strict=True):
        draw = np.random.default_rng(stream)
        trace += (spread * (draw.standard_normal(trace.shape) + 1j * draw.standard_normal(trace.shape))).astype(trace.dtype)
