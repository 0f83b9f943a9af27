"""Multi-receiver echoes as those of one sonar that sends and receives at evenly spaced phase centres.

A transmitter and a receiver b apart see almost what one sonar at their midpoint would, b^2/(4 r) farther off; a receiver that
moves on until the echo arrives only moves the midpoint. So each trace is shifted in time, and the traces are interpolated along
the track onto even positions. It relies on Echoes and on the checks of `stripmap`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import i0

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import Beam
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM
from pysas.reference.stripmap import TOLERANCE, beam_middle, one_start

_HALF_WIDTH = 16  # of the interpolator in time, samples
_NEIGHBOURS = 16  # traces that one interpolated trace is made of
_NOISE = 1e-6  # power relative to the signal's that interpolation allows for: bounds its weights where pings coincide
_MOVE = 1 / 64  # of the spacing that receivers may move before weights are computed anew
_BAND = 0.85  # of what the spacing samples, where no beam tells

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Centres:
    """Midpoints of transmitter and receiver, trace by trace, as linear functions of the travel time.

    Attributes
    ----------
    middle, drift : (trace, 3)
        Position for an echo of no travel time, m, and its velocity, m/s.
    baseline, opening : (trace, 3)
        From transmitter to receiver, m, and how fast it grows, m/s.
    """

    middle: FloatArray
    drift: FloatArray
    baseline: FloatArray
    opening: FloatArray

    @classmethod
    def of(cls, echoes: Echoes) -> Centres:
        baseline = (echoes.receivers - echoes.tx[:, None]).reshape(-1, 3)
        velocity = echoes.receiver_velocity
        opening = np.zeros(baseline.shape) if velocity is None else velocity.reshape(-1, 3)
        middle = np.repeat(echoes.tx, echoes.n_channel, axis=0) + baseline / 2
        return cls(middle, opening / 2, baseline, opening)

    def at(self, tau: float) -> FloatArray:
        """Midpoints (trace, 3) for echoes of travel time `tau`, m."""
        return self.middle + self.drift * tau


def phase_centres(
    echoes: Echoes, *, spacing: float | None = None, along_bandwidth: float | None = None, reference_range: float | None = None
) -> Echoes:
    """Equivalent monostatic, evenly spaced echoes.

    Parameters
    ----------
    echoes : Echoes
        Raw or range-compressed, of any number of channels, on a straight track along x (`motion_compensate` makes one); pings
        may be uneven.
    spacing : float, optional
        Of the new pings, m; default: the mean spacing of all phase centres.
    along_bandwidth : float, optional
        Two-sided, rad/m: what the interpolation along the track is made for. Default: the main lobe's 8 pi/D for a beam of
        length D, at most 0.85 of 2 pi/spacing; without a beam that.
    reference_range : float, optional
        For which the residual phase is stated, m; default: the middle of the record.

    Returns
    -------
    Echoes
        (ping, sample), tx = rx on even positions, no velocity, no ping_time. `attrs` gains "residual_phase" (rad, the largest
        left at `reference_range`; it falls as 1/range) and "resampling_error" (root mean square of the interpolation along
        the track relative to the signal, for a flat spectrum within along_bandwidth; 0 where phase centres were even).

    Raises
    ------
    ValueError, TypeError
        A phase centre farther than 0.01 wavelengths from one line along x (ping and channel are named), a start time that
        differs between pings, a non-finite sample, an argument outside its range.

    Notes
    -----
    At broadside the two-way path is sqrt(4 r^2 + b^2), so a monostatic echo of travel time tau is recorded at
    sqrt(tau^2 + b^2/c^2) = tau + b^2/(2 c^2 tau) + ..., with b the baseline when the echo arrives (A. Bellettini and M. A.
    Pinto 2002, displaced phase centres). At an angle theta from broadside along the baseline the path exceeds 2r by only
    b^2 cos^2(theta)/(4 r): the phase left is (2 pi f/c) b^2 sin^2(theta)/(4 r), and in raw echoes, whose samples belong to
    more than one range, 2 pi fc b^2/(2 c^2 tau^2) T/2 for a pulse of length T.

    The midpoint of a receiver with velocity v lies v tau/2 ahead. Each even position is made of the 16 nearest traces with
    the weights of least mean square error for a signal with a flat spectrum of width `along_bandwidth` (best linear
    unbiased interpolation; J. Capon 1969).

    O(trace sample) time with a constant of about 100; memory about 4 times the data.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if spacing is not None:
        spacing = _checks.number("spacing", spacing, positive=True)
    if along_bandwidth is not None:
        along_bandwidth = _checks.number("along_bandwidth", along_bandwidth, positive=True)
    start = one_start(echoes)
    r = sum(echoes.swath) / 2 if reference_range is None else _checks.number("reference_range", reference_range, positive=True)
    if r <= 0:
        raise ValueError(f"echoes: the record is centred on slant range {r:g} m: expected samples after transmission")
    echoes = echoes.whole()
    finite = np.isfinite(echoes.traces).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(f"echoes: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
    centres = Centres.of(echoes)
    place = _on_line(echoes, centres, 2 * r / echoes.speed)
    delay = echoes.pulse.duration / 2 if isinstance(echoes.pulse, LFM) and not echoes.compressed else 0.0
    tau = start - delay + np.arange(echoes.n_sample) / echoes.fs
    traces = echoes.traces.reshape(-1, echoes.n_sample)
    moved = np.empty(traces.shape, dtype=echoes.dtype)
    for i, trace in enumerate(traces):
        gap = np.linalg.norm(centres.baseline[i] + centres.opening[i] * tau[:, None], axis=1) / echoes.speed
        # nearer than the baseline is long there is no equivalent sonar; the shift is held
        late = np.maximum(tau, gap)
        moved[i] = delayed(echoes, trace, np.sqrt(late**2 + gap**2) - late)
    positions = np.sort(place[:, 0])
    span = float(positions[-1] - positions[0])
    if span == 0 or len(positions) < 2:
        raise ValueError("echoes: the phase centres do not advance along x: expected a track")
    step = span / (len(positions) - 1) if spacing is None else spacing
    x = positions[0] + step * np.arange(int(np.floor(span / step * (1 + 1e-12))) + 1)
    width, carrier = _band(echoes, along_bandwidth, step)
    data, error = _resample(echoes, moved, centres, tau, x, width, carrier)
    tx = np.stack([x, np.full(x.size, place[:, 1].mean()), np.full(x.size, place[:, 2].mean())], axis=1)
    residual = _residual(echoes, centres, r, delay, width, carrier)
    attrs = {**echoes.attrs, "residual_phase": residual, "resampling_error": error}
    beam = None if echoes.beam is None else _for_all(echoes.beam)
    return echoes.replace(data=data, tx=tx, rx=tx, velocity=None, ping_time=None, t0=start, attrs=attrs, beam=beam)


def _for_all(beam: Beam) -> Beam:
    """A beam with the mean directions of all pings, itself where it has no others."""
    if beam.boresight.ndim == 1 and (beam.axis is None or beam.axis.ndim == 1):
        return beam
    axis = None if beam.axis is None else beam.axes.mean(axis=0)
    return replace(beam, boresight=beam.boresights.mean(axis=0), axis=axis)


def delayed(echoes: Echoes, trace: ComplexArray, delay: FloatArray) -> Complex:
    """The trace read `delay` (sample,) seconds later and turned by the carrier: what came tau + delay comes at tau.

    Sinc under a Kaiser window, made for the margin between the occupied band and fs; zero outside the record.
    """
    n = trace.size
    margin = max(1 - echoes.occupied_bandwidth / echoes.fs, 0.05)
    beta = 0.1102 * max(2.285 * 2 * np.pi * margin * (2 * _HALF_WIDTH - 1) + 8 - 8.7, 0)
    place = np.arange(n) + delay * echoes.fs
    cell = np.floor(place).astype(np.intp)
    lags = np.arange(1 - _HALF_WIDTH, _HALF_WIDTH + 1)
    t = (place - cell)[:, None] - lags
    kernel = np.sinc(t) * i0(beta * np.sqrt(np.clip(1 - (t / _HALF_WIDTH) ** 2, 0, None))) / i0(beta)
    index = cell[:, None] + lags
    values = np.where((index >= 0) & (index < n), trace[np.clip(index, 0, n - 1)], 0)
    turns = echoes.fc * delay
    return np.asarray(np.einsum("ij,ij->i", kernel, values) * np.exp(2j * np.pi * (turns - np.rint(turns))))


def _on_line(echoes: Echoes, centres: Centres, tau: float) -> FloatArray:
    """Phase centres for echoes of `tau`; raises where one is off their common line along x."""
    place = centres.at(tau)
    off = np.linalg.norm(place[:, 1:] - place[:, 1:].mean(axis=0), axis=1)
    limit = TOLERANCE * echoes.speed / echoes.fc
    if off.max() > limit:
        ping, channel = divmod(int(np.argmax(off > limit)), echoes.n_channel)
        raise ValueError(
            f"echoes: the phase centre of ping {ping}, channel {channel} is {off[off > limit][0]:.3g} m from "
            f"a line along x: expected at most {TOLERANCE:g} wavelengths, {limit:.3g} m (motion_compensate)"
        )
    return place


def _band(echoes: Echoes, along_bandwidth: float | None, step: float) -> tuple[float, float]:
    """Width and centre of the along-track band, rad/m."""
    carrier = 0.0
    if echoes.beam is not None:
        carrier = 4 * np.pi * echoes.fc / echoes.speed * float(beam_middle(echoes.beam)[0])
    if along_bandwidth is not None:
        return along_bandwidth, carrier
    sampled = _BAND * 2 * np.pi / step
    return (sampled if echoes.beam is None else min(8 * np.pi / echoes.beam.length, sampled)), carrier


def _resample(
    echoes: Echoes,
    traces: ComplexArray,
    centres: Centres,
    tau: FloatArray,
    x: FloatArray,
    width: float,
    carrier: float,
) -> tuple[ComplexArray, float]:
    """Traces at even positions `x` and the rms error of the interpolation relative to the signal."""
    fastest = float(np.max(np.abs(centres.drift[:, 0])))
    step = float(x[1] - x[0]) if x.size > 1 else 1.0
    limit = TOLERANCE * echoes.speed / echoes.fc
    blocks = int(np.ceil(max(fastest * float(tau[-1] - tau[0]) / (_MOVE * step), 1)))
    edges = np.unique(np.linspace(0, tau.size, min(blocks, tau.size) + 1).astype(int))
    data = np.zeros((x.size, tau.size), dtype=traces.dtype)
    errors = []
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        u = centres.middle[:, 0] + centres.drift[:, 0] * max(float(tau[begin:end].mean()), 0.0)
        order = np.argsort(u, kind="stable")
        if len(u) == x.size and np.max(np.abs(u[order] - x)) <= limit:
            data[:, begin:end] = traces[order, begin:end]
            errors.append(0.0)
            continue
        near = _nearest(u[order], x)
        sample = u[order][near]
        weights, error = _weights(sample, x, width, carrier)
        errors.append(error)
        for j in range(near.shape[1]):
            data[:, begin:end] += (weights[:, j, None] * traces[order[near[:, j]], begin:end]).astype(traces.dtype)
    return data, float(np.sqrt(np.mean(np.square(errors))))


def _nearest(u: FloatArray, x: FloatArray) -> npt.NDArray[np.intp]:
    """Indices (position, neighbour) of the sorted samples `u` about each `x`."""
    count = min(_NEIGHBOURS, u.size)
    first = np.clip(np.searchsorted(u, x) - count // 2, 0, u.size - count)
    return np.asarray(first[:, None] + np.arange(count))


def _weights(u: FloatArray, x: FloatArray, width: float, carrier: float) -> tuple[Complex, float]:
    """Weights (position, neighbour) of least mean square error, and that error's root over all positions."""

    def correlated(d: FloatArray) -> Complex:
        return np.asarray(np.sinc(width * d / (2 * np.pi)) * np.exp(1j * carrier * d))

    among = correlated(u[:, :, None] - u[:, None, :]) + _NOISE * np.eye(u.shape[1])
    towards = correlated(x[:, None] - u)
    # signal at x = sum_j w_j signal at u_j with w = towards among^-1 (both Hermitian in their arguments)
    weights = np.linalg.solve(np.swapaxes(among, 1, 2), towards[:, :, None])[:, :, 0]
    error = 1 - np.real(np.sum(weights * towards.conj(), axis=1))
    return np.asarray(weights), float(np.sqrt(np.clip(error, 0, None).mean()))


def _residual(echoes: Echoes, centres: Centres, r: float, delay: float, width: float, carrier: float) -> float:
    tau = 2 * r / echoes.speed
    longest = float(np.max(np.linalg.norm(centres.baseline + centres.opening * tau, axis=1)))
    low, high = (echoes.fc + sign * echoes.occupied_bandwidth / 2 for sign in (-1, 1))
    if echoes.beam is not None:
        sine = min(
            1.0, float(np.sin(min(echoes.beam.half_angle, np.pi / 2))) + abs(carrier) * echoes.speed / (4 * np.pi * echoes.fc)
        )
    else:
        sine = min(1.0, (width / 2 + abs(carrier)) * echoes.speed / (4 * np.pi * low)) if low > 0 else 1.0
    angle = 2 * np.pi * high / echoes.speed * longest**2 * sine**2 / (4 * r)
    return float(angle + 2 * np.pi * echoes.fc * longest**2 / (2 * echoes.speed**2 * tau**2) * delay)
