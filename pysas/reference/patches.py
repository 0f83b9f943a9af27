"""Patches: a small part of a plane image as Fourier samples, and how small it must be.

About a patch's centre x0 the travel time of trace t is tau_t(x0) + g_t.d + q_t(d), g_t its gradient in the plane and q_t its
second-order part, range curvature. Without q, sample (t, f) is one of the image's spectrum at the wavenumber k = 2 pi (fc + f)
g_t. Curvature that is one displacement for all traces, q_t(d) = g_t.b(d), moves the image without blurring it: b is fitted by
least squares over the traces and undone by reading the spectrum's image at d + b(d). What remains blurs, and bounds the patch.
Delays are written anew here; no engine is imported.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy.fft

from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.reference.gridding import Complex, Index

_SECTOR = np.pi / 4  # of directions that share a bend: half of it would leave a quarter, for twice the transforms
_PROBES = 5  # points along each axis at which a patch's error is looked at, its corners among them


@dataclass(frozen=True, eq=False)
class Survey:
    """Geometry by trace (ping-major), and the rms frequency of the band.

    Attributes
    ----------
    number : (trace,)
        Of each trace among the record's, ping-major.
    tx, rx, velocity : (trace, 3)
        m, m/s.
    start : (trace,)
        Time of sample 0, s.
    energy : (trace, sample + 1)
        Running sum of |sample|^2.
    frequency : float
        sqrt(fc^2 + bandwidth^2/12), Hz.
    """

    echoes: Echoes
    number: Index
    tx: FloatArray
    rx: FloatArray
    velocity: FloatArray
    start: FloatArray
    energy: FloatArray
    frequency: float

    @classmethod
    def of(cls, echoes: Echoes) -> Survey:
        """All traces of a record."""
        channels = echoes.n_channel
        rx = echoes.receivers.reshape(-1, 3)
        velocity = np.zeros_like(rx) if echoes.receiver_velocity is None else echoes.receiver_velocity.reshape(-1, 3)
        frequency = float(np.sqrt(echoes.fc**2 + echoes.occupied_bandwidth**2 / 12))
        tx, start = np.repeat(echoes.tx, channels, axis=0), np.repeat(echoes.start_time, channels)
        traces = echoes.traces.reshape(len(rx), -1)
        energy = np.zeros((len(rx), echoes.n_sample + 1))
        np.cumsum(traces.real.astype(np.float64) ** 2 + traces.imag.astype(np.float64) ** 2, axis=1, out=energy[:, 1:])
        return cls(echoes, np.arange(len(rx)), tx, rx, velocity, start, energy, frequency)

    def of_traces(self, chosen: Index) -> Survey:
        """Some of the traces."""
        return dataclasses.replace(
            self, number=self.number[chosen], tx=self.tx[chosen], rx=self.rx[chosen], velocity=self.velocity[chosen],
            start=self.start[chosen], energy=self.energy[chosen],
        )  # fmt: skip

    def delays(self, points: FloatArray) -> FloatArray:
        """Travel times (trace, point), s: c tau = |x - tx| + |x - rx - velocity tau|, its quadratic's root.

        With P = |x - tx| and D = x - rx, (c tau - P)^2 = |D - v tau|^2; of the quadratic (c^2 - v^2) tau^2 - 2 (c P - D.v) tau
        + P^2 - D^2 = 0 the larger root is at least P/c.
        """
        c = self.echoes.speed
        out = np.linalg.norm(points - self.tx[:, None], axis=-1)
        path = points - self.rx[:, None]
        a = c**2 - np.sum(self.velocity**2, axis=-1)[:, None]
        b = c * out - np.einsum("tpi,ti->tp", path, self.velocity)
        back = np.sum(path**2, axis=-1)
        # b^2 - a (P^2 - D^2) without cancellation for v = 0: there it is (c |D|)^2
        v_2 = np.sum(self.velocity**2, axis=-1)[:, None]
        dv = c * out - b
        root = np.sqrt(np.maximum(c**2 * back + dv**2 - 2 * c * out * dv + v_2 * (out**2 - back), 0.0))
        return np.asarray((b + root) / a)


@dataclass(frozen=True, eq=False)
class Expansion:
    """Delays of a survey's traces about a patch's centre.

    Attributes
    ----------
    delay : (trace,)
        tau(x0), s.
    gradient : (trace, 2)
        g, s/m, along x and y.
    bend : (2, 2, 2)
        b(d)_i = d . bend_i d, m; 0 where curvature is not corrected.
    """

    survey: Survey
    delay: FloatArray
    gradient: FloatArray
    bend: FloatArray

    def targets(self, offsets: FloatArray) -> FloatArray:
        """d + b(d) (pixel, 2), m."""
        return np.asarray(offsets + np.einsum("pj,ijk,pk->pi", offsets, self.bend, offsets))


@dataclass(frozen=True, eq=False)
class Patch:
    """Rows and columns of a plane grid with the expansions about their middle.

    Attributes
    ----------
    rows, columns : slice
        Of the grid.
    centre : (3,)
        m.
    offsets : (pixel, 2)
        d = pixel - centre, m, C order of the rows and columns.
    parts : tuple of Expansion
        One for each sector of the aperture.
    error : float
        Phase left at the patch's worst point, rad: rms over traces, each weighed by its energy in the patch's delays, which is
        what a relative error against the incoherent level is. Alike where no trace has any.
    """

    rows: slice
    columns: slice
    centre: FloatArray
    offsets: FloatArray
    parts: tuple[Expansion, ...]
    error: float


def sectors(survey: Survey, centre: FloatArray) -> list[Survey]:
    """The traces in groups that see `centre` from within 45 degrees: a wide aperture bends in no common way."""
    delay = survey.delays(centre[None])[:, 0]
    gradient, _ = _derivatives(survey, centre, delay)
    azimuth = np.arctan2(gradient[:, 1], gradient[:, 0])
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    start = ordered[(np.argmax(gaps) + 1) % gaps.size]
    turned = (azimuth - start) % (2 * np.pi)
    count = max(1, int(np.ceil(turned.max() / _SECTOR)))
    group = np.minimum((turned / max(turned.max(), 1e-300) * count).astype(int), count - 1)
    return [survey.of_traces(np.flatnonzero(group == number)) for number in range(count) if np.any(group == number)]


def patch(surveys: list[Survey], x: FloatArray, y: FloatArray, z: float, rows: slice, columns: slice, correct: bool) -> Patch:
    """Expand the delays about the middle of the rows and columns."""
    xs, ys = x[columns], y[rows]
    centre = np.array([(xs.min() + xs.max()) / 2, (ys.min() + ys.max()) / 2, z])
    mesh = np.stack(np.meshgrid(xs - centre[0], ys - centre[1]), axis=-1).reshape(-1, 2)
    probes = np.linspace(-0.5, 0.5, _PROBES)
    at = np.stack(np.meshgrid(probes * np.ptp(xs), probes * np.ptp(ys)), axis=-1).reshape(-1, 2)
    around = centre + np.concatenate([at, np.zeros((len(at), 1))], axis=1)
    parts, squares, weights = [], [], []
    for survey in surveys:
        delay = survey.delays(centre[None])[:, 0]
        gradient, hessian = _derivatives(survey, centre, delay)
        bend = np.zeros((2, 2, 2))
        if correct:
            # minimises sum_t (g_t.b(d) - q_t(d))^2 for every d at once; one direction of looking leaves the other free: least b
            bend = np.einsum("it,tjk->ijk", np.linalg.pinv(gradient, rcond=1e-6), hessian) / 2
        parts.append(Expansion(survey, delay, gradient, bend))
        rest = survey.delays(around) - delay[:, None] - gradient @ parts[-1].targets(at).T
        squares.append((2 * np.pi * survey.frequency * rest) ** 2)
        weights.append(_energy(survey, delay, gradient @ at.T))
    weight = np.concatenate(weights)
    weight = weight if weight.any() else np.ones(weight.size)
    error = np.sqrt(np.max(weight @ np.concatenate(squares)) / weight.sum())
    return Patch(rows, columns, centre, mesh, tuple(parts), float(error))


def _energy(survey: Survey, delay: FloatArray, offsets: FloatArray) -> FloatArray:
    """Energy (trace,) of the samples within the delays delay + offsets (trace, point)."""
    n = survey.echoes.n_sample
    place = (delay - survey.start) * survey.echoes.fs
    first = np.clip(np.floor(place + offsets.min(axis=1) * survey.echoes.fs), 0, n).astype(np.intp)
    last = np.clip(np.ceil(place + offsets.max(axis=1) * survey.echoes.fs) + 1, 0, n).astype(np.intp)
    index = np.arange(len(delay))
    return np.asarray(survey.energy[index, np.maximum(last, first)] - survey.energy[index, first])


def _derivatives(survey: Survey, centre: FloatArray, delay: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradient (trace, 2) and second derivatives (trace, 2, 2) of the delay in the plane; the latter for still receivers."""
    c = survey.echoes.speed
    gradient, hessian = np.zeros((len(delay), 3)), np.zeros((len(delay), 2, 2))
    for origin in (survey.tx, survey.rx + survey.velocity * delay[:, None]):
        away = centre - origin
        distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-9)
        unit = away / distance[:, None]
        gradient += unit
        hessian += (np.eye(2) - unit[:, :2, None] * unit[:, None, :2]) / (c * distance)[:, None, None]
    receding = np.sum(unit * survey.velocity, axis=-1)
    return gradient[:, :2] / (c + receding)[:, None], hessian


def tiles(
    surveys: list[Survey], x: FloatArray, y: FloatArray, z: float, error: float, correct: bool
) -> tuple[Patch, list[Patch]]:
    """The whole grid as one patch, and patches that cover it with at most `error` each, halved until they are small enough."""
    first = patch(surveys, x, y, z, slice(0, y.size), slice(0, x.size), correct)
    left, done = [first], []
    while left:
        part = left.pop()
        if part.error <= error or len(part.offsets) == 1:
            done.append(part)
            continue
        wide = np.ptp(x[part.columns]) >= np.ptp(y[part.rows])
        across = part.columns if wide else part.rows
        half = (across.start + across.stop) // 2
        for piece in (slice(across.start, half), slice(half, across.stop)):
            rows, columns = (part.rows, piece) if wide else (piece, part.columns)
            left.append(patch(surveys, x, y, z, rows, columns, correct))
    return first, done


def samples(part: Expansion, offsets: FloatArray, accuracy: float, in_band: bool = False) -> tuple[FloatArray, Complex]:
    """Fourier samples for the pixels at `offsets`: wavenumbers (n, 2), rad/m, and values (n,); image sum value exp(j k.d).

    Each trace is cut out about the patch's delays under a taper whose spectrum fits between the band and fs/2; `in_band` keeps
    no frequency beyond the band itself.
    """
    survey, echoes = part.survey, part.survey.echoes
    fs, fc, n = echoes.fs, echoes.fc, echoes.n_sample
    reach = int(np.ceil(np.max(np.abs(part.gradient @ part.targets(offsets).T)) * fs)) + 2
    margin = max((fs - echoes.occupied_bandwidth) / (2 * fs), 0.02)  # cycles per sample
    beta = 1.5 - np.log(accuracy)
    guard = int(np.ceil(np.hypot(1, beta / np.pi) / margin))
    size = int(scipy.fft.next_fast_len(2 * (reach + guard) + 1))
    place = np.arange(size) - size // 2
    # rises as the integral of a Kaiser window: 0 beyond `guard`, 1 within `reach`
    rise = np.concatenate([[0.0], np.cumsum(np.kaiser(guard, beta))])
    taper = np.interp(reach + guard - np.abs(place), np.arange(guard + 1), rise / rise[-1])
    middle = np.rint((part.delay - survey.start) * fs).astype(np.intp)
    seen = np.flatnonzero((middle + size // 2 >= 0) & (middle - size // 2 < n))
    if seen.size == 0:
        return np.zeros((0, 2)), np.zeros(0, dtype=np.complex128)
    index = middle[seen, None] + place
    inside = (index >= 0) & (index < n)
    traces = echoes.traces.reshape(-1, n)
    cut = np.where(inside, traces[survey.number[seen, None], np.clip(index, 0, n - 1)], 0) * taper
    spectrum = scipy.fft.fft(scipy.fft.ifftshift(cut, axes=1), axis=1, norm="forward")
    f = scipy.fft.fftfreq(size, 1 / fs)
    kept = np.abs(f) <= min(echoes.occupied_bandwidth / 2 + (0.0 if in_band else margin * fs), fs / 2)
    f = f[kept]
    # from the cut's middle sample to the delay, at most half a sample
    away = part.delay[seen] - survey.start[seen] - middle[seen] / fs
    turns = fc * part.delay[seen]
    turns = (turns - np.rint(turns))[:, None] + away[:, None] * f
    values = spectrum[:, kept] * np.exp(2j * np.pi * turns)
    k = 2 * np.pi * (fc + f)[None, :, None] * part.gradient[seen, None, :]
    return k.reshape(-1, 2), values.ravel()
