"""Point scenes to raw echoes: every sample from the analytic pulse at the exact delay, nothing interpolated.

A trace is the sum of amplitude waveform(t - tau, fc) exp(-2j pi fc tau) over the points, in complex128 and in the order of
the points, so the echoes are bit-identical for any number of threads. The delays here are this module's own: the oracle
and the engine have theirs, so that none can hide another's mistake. Tasks are short, for Ctrl-C.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _pool
from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import FAN, Beam
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM, WINDOWS
from pysas.signal.echoing import DARK, ELEMENT, GAUSSIAN, LAMP, LONG, RECT, ROUND, TAYLOR, TUKEY, add_echoes, energy

_TASK_SAMPLES = 1 << 21  # echo samples of one task: some tens of milliseconds
_BLOCK_BYTES = 32 * 2**20  # of traces being summed in complex128
_MOST_SCATTERERS = 1e8
_ALIASED = 1e-3  # share of the pulse's energy outside the sampled band that calls for a warning

Complex = npt.NDArray[np.complex128]


class AliasingWarning(UserWarning):
    """The pulse has energy outside the band that the sample rate can hold."""


@dataclass(frozen=True, eq=False)
class Element:
    """A flat rectangular transmitter or receiver with an evenly driven face.

    Its pattern at frequency f towards a unit vector u is sinc(f length u.along / c) sinc(f height u.up / c), with
    sinc(x) = sin(pi x)/(pi x) and up = along x boresight; zero behind the face (u.boresight <= 0).

    Parameters
    ----------
    length, height : float
        Along `along` and across it, m, >= 0; 0: no directivity in that plane.
    boresight, along : (3,) or (ping, 3)
        Directions of the face's normal and of its length, at right angles; normalised here.

    Raises
    ------
    ValueError, TypeError
        A negative size, a zero vector, or vectors not at right angles (cosine above 1e-6).
    """

    length: float
    height: float = 0.0
    boresight: npt.ArrayLike = (0.0, 1.0, 0.0)
    along: npt.ArrayLike = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("length", "height"):
            object.__setattr__(self, name, _checks.number(name, getattr(self, name), low=0.0))
        for name in ("boresight", "along"):
            vector = _checks.reals(name, getattr(self, name), [(3,), ("ping", 3)], ("ping",))
            norm = np.linalg.norm(vector, axis=-1, keepdims=True)
            if not np.all(norm > 0):
                raise ValueError(f"{name}={getattr(self, name)!r}: expected non-zero vectors")
            object.__setattr__(self, name, vector / norm)
        boresight, along = np.asarray(self.boresight), np.asarray(self.along)
        if boresight.ndim == along.ndim == 2 and len(boresight) != len(along):
            raise ValueError(f"along: {len(along)} vectors: expected one, or one per boresight ({len(boresight)})")
        cosine = float(np.max(np.abs(np.sum(boresight * along, axis=-1)), initial=0.0))
        if cosine > 1e-6:
            raise ValueError(f"along={self.along!r}: cosine {cosine:.3g} with boresight: expected right angles")

    def _rows(self, name: str, n_ping: int) -> FloatArray:
        """(ping, ELEMENT) rows for the kernel."""
        vectors = []
        for field in ("boresight", "along"):
            vector = np.asarray(getattr(self, field), dtype=np.float64)
            if vector.ndim == 2 and len(vector) != n_ping:
                raise ValueError(f"{name}: {field} of shape {vector.shape}: expected (3,) or ({n_ping}, 3)")
            vectors.append(np.broadcast_to(vector, (n_ping, 3)))
        sizes = np.broadcast_to([self.length, self.height], (n_ping, 2))
        return np.concatenate([*vectors, np.cross(vectors[1], vectors[0]), sizes], axis=1)


@_checks.usual_errors
def seabed(
    x: Sequence[float], y: Sequence[float], density: float = 60.0, depth: float = 0.0, roughness: float = 0.05, seed: int = 0
) -> tuple[FloatArray, Complex]:
    """Scatterers of a rough seabed, whose echoes are speckle, repeatable by `seed`.

    As many as `density` and the area say (rounded) lie independently and evenly over a rectangle, at Gaussian, independent
    heights about a plane, with circular complex Gaussian amplitudes of mean square 1.

    Parameters
    ----------
    x, y : (2,)
        Least and largest coordinates of the rectangle, m. Along the track it should reach beyond both ends by the farthest
        range times the tangent of the beam's half-angle and of what the heading turns; across it, from the nearest to the
        farthest ground range of the record and by half a pulse beyond. What no ping lights costs time alone.
    density : float
        Number of scatterers on 1 m2, > 0. An image's contrast (`metrics.sharpness`) is about 2 + 0.9/n for n scatterers in a
        cell of range and along-track resolution: developed speckle (2, exponential intensity) takes several. A record needs
        fewer: its cells are as wide as the beam.
    depth : float
        z of the plane, m: positive below the sonar where z points down. For a slope add it to the points' z.
    roughness : float
        Standard deviation of z, m, >= 0.
    seed : int
        Of places and amplitudes.

    Returns
    -------
    points : (point, 3) float64
        In m: `simulate`'s `points`.
    amplitudes : (point,) complex128
        Its `amplitudes`.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, of the wrong shape or type; a rectangle without a scatterer, or with 1e8 or more.

    Notes
    -----
    O(points) time and memory. Add targets by joining theirs to both arrays: a scatterer's mean square is 1.
    """
    sides = []
    for name, value in (("x", x), ("y", y)):
        low, high = (float(end) for end in _checks.reals(name, value, [(2,)]))
        if not low < high:
            raise ValueError(f"{name}={value!r}: expected the least coordinate, then a larger one")
        sides.append((low, high))
    density = _checks.number("density", density, positive=True)
    depth, roughness = _checks.number("depth", depth), _checks.number("roughness", roughness, low=0.0)
    rng = np.random.default_rng(_checks.whole("seed", seed, low=0))
    expected = density * math.prod(high - low for low, high in sides)
    if not 0.5 <= expected < _MOST_SCATTERERS:
        where = f"{expected:.3g} scatterers on x={x!r}, y={y!r}"
        raise ValueError(f"density={density!r}: {where}: expected 1 to {_MOST_SCATTERERS:.0e}")
    n = round(expected)
    points = np.stack([*(rng.uniform(low, high, n) for low, high in sides), depth + roughness * rng.standard_normal(n)], axis=1)
    return points, math.sqrt(0.5) * rng.standard_normal((n, 2)).view(np.complex128)[:, 0]


@_checks.usual_errors
def simulate(
    points: npt.ArrayLike,
    amplitudes: npt.ArrayLike,
    pulse: LFM,
    *,
    tx: npt.ArrayLike,
    rx: npt.ArrayLike,
    fs: float,
    duration: float,
    c: float | npt.ArrayLike = 1500.0,
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
    progress: Callable[[float], object] | None = None,
    ping_time: npt.ArrayLike | None = None,
    attrs: Mapping[str, Any] | None = None,
    beam: Beam | None = None,
) -> Echoes:
    """Raw echoes of point targets.

    A point of amplitude A adds A waveform(t - tau, fc) exp(-2j pi fc tau), with the two-way travel time tau the root of
    c tau = |x - tx| + |x - rx - velocity tau|, to every trace; what falls outside the record is cut (Sathishkumar et al.,
    Eqs 1-2, without stop-and-hop). No Doppler scale of the pulse, no absorption, no multiple scattering.

    Parameters
    ----------
    points : (point, 3)
        Positions, m.
    amplitudes : (point,)
        Real or complex.
    pulse : LFM
        Its leading edge leaves the transmitter at t = 0.
    tx : (ping, 3)
        Transmitter at the instant of transmission, m.
    rx : (ping, channel, 3) or (ping, 3)
        Receivers at the instant of transmission, m; the data are (ping, channel, sample) or (ping, sample) accordingly.
    fs : float
        Sample rate, Hz.
    c : float or (ping,)
        Sound speed, m/s: one, or each ping's own.
    duration : float
        Length of the record, s, at least the pulse's; sample n = 0 ... ceil(duration fs) - 1 is at t0 + n/fs.
    t0 : float or (ping,)
        Time of sample 0 after the start of transmission, s.
    velocity : (ping, 3) or (ping, channel, 3), optional
        Receivers' velocity until the echo arrives, m/s. None: stop-and-hop.
    fc : float, optional
        Demodulation frequency, Hz; default: the pulse's.
    spreading : bool
        Divide by |x - tx| |x - rx(tau)| in m^2 (1/r each way).
    tx_element, rx_element : Element, optional
        Directivity, at the pulse's instantaneous frequency at each sample and, for receivers, from where they are at
        reception. None: omnidirectional.
    snr_db : float, optional
        Adds complex white Gaussian noise: 10 log10 of the mean |signal|^2 over all samples of all traces (those without
        an echo too) to the variance of the noise. None: no noise. Compression then raises the ratio of a point's peak by the
        pulse's number of samples (duration fs), of speckle by about fs over the bandwidth alone.
    seed : int, optional
        Of the noise; each (ping, channel) has its own stream of it. None: different every time.
    dtype : complex64 or complex128
        Of the data; sums are complex128.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.
    progress : callable, optional
        Called with the fraction done now and then.
    ping_time, attrs
        As in `Echoes`.
    beam : Beam, optional
        Multiplies the echoes of a point by what the beam weighs in its direction from the transmitter, two-way and the same at
        all frequencies; those outside it are left out. Stands beside the elements' patterns, which follow frequency: with
        `tx_element` give it where the echoes shall be cut as the sonar's processing cuts them, else in place of elements.

    Returns
    -------
    Echoes
        With compressed=False, `pulse` and `beam`.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range, of the wrong shape or type; with `spreading`, a point on a transmitter or receiver.

    Warns
    -----
    AliasingWarning
        More than 1e-3 of the pulse's energy (3 % of its norm) lies outside fs/2 either side of fc.

    Notes
    -----
    O(points pings channels (1 + pulse duration fs)) time; the data and about 32 MB of work in memory.
    """
    if not isinstance(pulse, LFM):
        raise TypeError(f"pulse={type(pulse).__name__}: expected a pysas.LFM")
    fs = _checks.number("fs", fs, positive=True)
    fc = pulse.fc if fc is None else _checks.number("fc", fc, positive=True)
    place = np.ascontiguousarray(_checks.reals("points", points, [("point", 3)], ("point",)))
    strength = _amplitudes(amplitudes, len(place))
    transmitters = _checks.reals("tx", tx, [("ping", 3)], ("ping",))
    n_ping = len(transmitters)
    receivers = _checks.reals("rx", rx, [(n_ping, "channel", 3), (n_ping, 3)], ("ping", "channel"))
    if receivers.size == 0:
        raise ValueError(f"rx: shape {receivers.shape}: expected at least one ping and one channel")
    if not isinstance(spreading, bool | np.bool_):
        raise TypeError(f"spreading={spreading!r}: expected True or False")
    snr_db = None if snr_db is None else _checks.number("snr_db", snr_db)
    seed = None if seed is None else _checks.whole("seed", seed, low=0)
    _checks.callback("progress", progress)
    workers = _checks.threads(threads)
    elements = []
    for name, element in (("tx_element", tx_element), ("rx_element", rx_element)):
        if element is not None and not isinstance(element, Element):
            raise TypeError(f"{name}={element!r}: expected a pysas.simulation.Element or None")
        elements.append(np.zeros((n_ping, ELEMENT)) if element is None else element._rows(name, n_ping))
    if beam is not None and not isinstance(beam, Beam):
        raise TypeError(f"beam={beam!r}: expected a pysas.Beam or None")
    shape = (*receivers.shape[:-1], _n_sample(duration, fs, pulse))
    geometry: dict[str, Any] = {"tx": transmitters, "rx": receivers, "t0": t0, "velocity": velocity, "ping_time": ping_time}
    data = np.zeros(shape, dtype=_complex_type(dtype))
    # validates what is left before the work starts; the samples are filled in below
    speed: Any = c
    extra = {} if attrs is None else attrs
    echoes = Echoes(data, fs=fs, fc=fc, c=speed, pulse=pulse, compressed=False, attrs=extra, beam=beam, **geometry)
    share = _aliased(pulse, fc, fs)
    if share > _ALIASED:
        warnings.warn(
            f"fs={fs:g} Hz: {math.sqrt(share):.2g} of the pulse's norm ({share:.2g} of its energy) lies outside "
            f"{fc:g} +- {fs / 2:g} Hz and aliases",
            AliasingWarning,
            stacklevel=2,
        )
    directive = (tx_element is not None, rx_element is not None)
    power = _fill(echoes, place, strength, bool(spreading), elements, directive, workers, progress)
    if snr_db is not None:
        if not power > 0:
            where = "the record" if beam is None else "the record and the beam"
            raise ValueError(f"snr_db={snr_db!r}: no echo lies in {where}: expected a signal to measure noise against")
        _add_noise(echoes.traces, power * 10 ** (-snr_db / 10), seed, workers)
    return echoes


def _lamp(beam: Beam | None, n_ping: int) -> tuple[FloatArray, tuple[int, float, float, float]]:
    """(ping, LAMP) rows for the kernel, and a beam's kind, half-angle, taper and a sine beyond which a fan surely ends."""
    if beam is None:
        return np.zeros((n_ping, LAMP)), (DARK, 0.0, 0.0, 0.0)
    look = np.broadcast_to(beam.boresights, (n_ping, 3))
    if beam.shape == FAN:
        kind, axis = LONG, np.broadcast_to(beam.axes, (n_ping, 3))
        middle = np.cross(axis, np.cross(look, axis))
    else:  # any axis across boresight
        kind, axis = ROUND, np.cross(look, np.eye(3)[np.argmin(np.abs(look), axis=1)])
        axis, middle = axis / np.linalg.norm(axis, axis=1, keepdims=True), look
    middle = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    rows = np.concatenate([middle, axis, np.cross(middle, axis), look], axis=1)
    return rows, (kind, beam.half_angle, beam.taper, math.sin(min(beam.half_angle + 1e-6, math.pi / 2)) + 1e-9)


def _amplitudes(value: npt.ArrayLike, n_point: int) -> Complex:
    array = _checks.array_like("amplitudes", value)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"amplitudes: expected real or complex numbers, found dtype {array.dtype}")
    if array.shape != (n_point,):
        raise ValueError(f"amplitudes: expected shape ({n_point},), one per point, found {array.shape}")
    if not np.isfinite(array).all():
        index = int(np.argmax(~np.isfinite(array)))
        raise ValueError(f"amplitudes: {array[index]} at point {index}: expected finite values")
    return np.ascontiguousarray(array, dtype=np.complex128)


def _complex_type(value: npt.DTypeLike) -> np.dtype[Any]:
    try:
        dtype = np.dtype(value)
    except TypeError:
        raise TypeError(f"dtype={value!r}: expected complex64 or complex128") from None
    if dtype not in (np.dtype(np.complex64), np.dtype(np.complex128)):
        raise TypeError(f"dtype={dtype}: expected complex64 or complex128")
    return dtype


def _n_sample(duration: float, fs: float, pulse: LFM) -> int:
    duration = _checks.number("duration", duration, positive=True)
    if duration < pulse.duration:
        raise ValueError(f"duration={duration!r}: expected at least the pulse's {pulse.duration:g} s")
    if duration * fs >= 2**31:
        raise ValueError(f"duration={duration!r}: {duration * fs:.3g} samples: expected fewer than 2^31")
    return math.ceil(duration * fs * (1 - 1e-12))  # 0.07 s at 100 kHz is 7000 samples, not 7001


def _aliased(pulse: LFM, fc: float, fs: float) -> float:
    """Share of the pulse's energy outside fs/2 either side of fc: Parseval, on a fine midpoint grid of the waveform."""
    start, stop = pulse.support
    reach = abs(pulse.fc - fc) + pulse.occupied_bandwidth / 2
    samples = (stop - start) * max(fs, 2 * reach)
    finer = min(max(2**18 / samples, 4.0), 32.0)
    n = math.ceil(finer * samples)
    step = (stop - start) / n
    waveform = pulse.waveform(start + (np.arange(n) + 0.5) * step, fc)
    size = scipy.fft.next_fast_len(4 * n)
    power = np.abs(scipy.fft.fft(waveform, size)) ** 2
    # the band's edges lie between two bins: integrate the power linearly up to them
    frequency, power = np.fft.fftshift(np.fft.fftfreq(size, step)), np.fft.fftshift(power)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]))])
    inside = float(np.diff(np.interp([-fs / 2, fs / 2], frequency, total))[0])
    return max(1 - inside / float(power.sum()), 0.0)


def _fill(
    echoes: Echoes,
    points: FloatArray,
    amplitudes: Complex,
    spreading: bool,
    elements: list[FloatArray],
    directive: tuple[bool, bool],
    workers: int,
    progress: Callable[[float], object] | None,
) -> float:
    """Sum the echoes, by blocks of traces (memory) and chunks of points (time), into the data; returns mean |signal|^2."""
    traces, pulse = echoes.traces, cast(LFM, echoes.pulse)
    n_ping, n_channel, n_sample = traces.shape
    tx, rx, start = np.array(echoes.tx, order="C"), np.array(echoes.receivers, order="C"), np.array(echoes.start_time)
    moving = echoes.receiver_velocity
    velocity = np.zeros(rx.shape) if moving is None else np.array(moving, order="C")
    lamps, beam = _lamp(echoes.beam, n_ping)
    model, window, terms = _model(pulse, echoes.fc, echoes.fs)
    speeds = np.array(echoes.speeds)
    cost = (16 + 2 * model[3] * echoes.fs) * (1 + 4 * sum(directive))  # of an echo, in samples without a pattern
    step = max(1, int(_TASK_SAMPLES / cost))
    n_trace, chunks = n_ping * n_channel, range(0, max(len(points), 1), step)
    rows = min(max(workers, _BLOCK_BYTES // (16 * n_sample)), n_trace)
    sums = np.empty((rows, n_sample), dtype=np.complex128)
    power = np.zeros(n_trace)
    total, finished, clashes = n_trace * len(chunks), 0, list[tuple[int, int, int]]()

    def add(block: int, first: int, task: int) -> None:
        trace, row = block + task, sums[task]
        ping, channel = divmod(trace, n_channel)
        geometry = (tx[ping], rx[ping, channel], velocity[ping, channel], start[ping], speeds[ping])
        faces = (elements[0][ping], elements[1][ping])
        last = min(first + step, len(points))
        what = (geometry, model, window, terms, spreading, faces, directive, lamps[ping], beam)
        bad = _pool.call(add_echoes, row, points, amplitudes, first, last, *what)
        if bad >= 0:
            clashes.append((ping, channel, bad))  # the first is told, whichever thread was faster
        if last == len(points):
            power[trace] = _pool.call(energy, row)
            traces[ping, channel] = row

    def tick(done: int) -> None:
        progress((finished + done) / total)  # type: ignore[misc]

    for block in range(0, n_trace, rows):
        count = min(rows, n_trace - block)
        sums[:count] = 0
        for first in chunks:
            task = partial(add, block, first)
            _pool.run(task, count, workers, tick if progress is not None else None)
            finished += count
            for ping, channel, bad in sorted(clashes):
                where = f"point {bad} at {points[bad]} lies on the transmitter or receiver of ping {ping}, channel {channel}"
                raise ValueError(f"points: {where}: expected distances > 0 with spreading=True")
    return float(power.mean() / n_sample)


def _model(pulse: LFM, fc: float, fs: float) -> tuple[tuple[float, ...], int, tuple[float, ...]]:
    """What the kernel needs of pulse and sampling, the window's number, and the window's terms."""
    half = (pulse.support[1] - pulse.support[0]) / 2
    model = (pulse.fc, pulse.rate, pulse.duration, half, fc, fs)
    parameter = pulse.window_parameter or 0.0
    window = WINDOWS.index(pulse.window)
    terms = (parameter, 0.0, 0.0, 0.0)
    if window == TUKEY and parameter == 0:
        window = RECT
    if window == GAUSSIAN:
        terms = (1 / (2 * parameter**2), 0.0, 0.0, 0.0)
    if window == TAYLOR:
        # cos(2x) and cos(3x) as polynomials of cos(x)
        scale, (a, b, d) = pulse._taylor
        terms = (scale * (1 - 2 * b), scale * (2 * a - 6 * d), scale * 4 * b, scale * 8 * d)
    return model, window, terms


def _add_noise(traces: ComplexArray, variance: float, seed: int | None, workers: int) -> None:
    """Add complex white Gaussian noise: a stream per ping, of which each channel has its own."""
    n_ping, n_channel, n_sample = traces.shape
    entropy = np.random.SeedSequence(seed).entropy

    def task(trace: int) -> None:
        ping, channel = divmod(trace, n_channel)
        rng = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(ping, channel)))
        noise = math.sqrt(variance / 2) * rng.standard_normal((n_sample, 2)).view(np.complex128)[:, 0]
        traces[ping, channel] = traces[ping, channel] + noise

    _pool.run(task, n_ping * n_channel, workers)
