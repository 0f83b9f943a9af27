"""A track's errors from displaced phase centres, as plainly as they can be written: for lines of some tens of pings.

Phase centres of a ping that fall where others of the last one were see the same seabed: their echoes differ by how the sonar
moved and no more. Everything is read at exact delays (`reading`), and one dense least squares takes all of it. It relies on
Echoes, `reading` and `bounds`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.beam import Beam
from pysas.model.echoes import Echoes
from pysas.reference.bounds import coherence, phase_noise, slant_noise
from pysas.reference.reading import Complex, delays, finer, read

CLIP = 2.0  # of the speckle's rms, beyond which samples are cut: no bright point shall stand for its window
MEDIAN = 0.8326  # of a Rayleigh distribution of rms 1: sqrt(ln 2)
LEAST_COHERENCE = 0.3
LEAST_PHASE = 2e-3  # rad, beside the noise: lines follow the middle of the beam alone
SEARCH = 3.0  # samples of delay either way, in the first pass
FEW = 4.0  # standard deviations from which a row counts for less (Cauchy)
PASSES = 3  # of the weights
SURGE = 1e-3  # m: standard deviation of what coherence tells of the advance
WEAK = np.array([1.0, 1.0, 1.0, 0.1])  # m and rad: no displacement is larger; settles what echoes cannot tell

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Sight:
    """What two pings in turn see of each other.

    Attributes
    ----------
    pairs : (pair, 2)
        Channels of the earlier and the later ping.
    look : (pair, window, 3)
        Unit vectors to the seabed.
    turn : (pair, window)
        By how much a turn of both pings' headings, and so of the beams, alters the difference of the paths, m/rad one-way.
    slant : (pair, window)
        u.(delta of the later - delta of the earlier), m.
    sigma : (pair, window)
        Standard deviations of it, m; inf where nothing is seen.
    forward : (3,)
        Horizontal, across the line of sight.
    surge : float
        Displacement along it, m.
    """

    pairs: npt.NDArray[np.intp]
    look: FloatArray
    turn: FloatArray
    slant: FloatArray
    sigma: FloatArray
    forward: FloatArray
    surge: float


def displaced_phase_centres(
    echoes: Echoes,
    *,
    seabed: float,
    window: float = 2.5,
    lags: int = 1,
    elements: tuple[float, float] | None = None,
    iterations: int = 3,
) -> FloatArray:
    """By what a track is off, ping by ping, from echoes of overlapping phase centres.

    Parameters
    ----------
    echoes : Echoes
        Compressed, (ping, channel, sample), with `beam` (which side; a beam that turns with the ping) and, where it has
        `velocity`, with `ping_time`: a new track moves the velocity as well.
    seabed : float
        z of the flat seabed, m.
    window : float
        Slant range that one correlation sums over, m.
    lags : int
        Differences of channel numbers that are used on either side of those that overlap best, >= 1.
    elements : (float, float), optional
        Lengths of transmitter and receivers along the track, m. Default: `echoes.beam.length` for both.
    iterations : int
        Times that the track is corrected and read again.

    Returns
    -------
    (ping, 4) float64
        Truth less claim: dx, dy, dz (m) of the mean of the ping's phase centres, and the array's turn about it from +x towards
        +y (rad). A shift of all, and a rotation of all about z, remain what they are (`WEAK` keeps them near zero).

    Raises
    ------
    ValueError, TypeError
        Raw or non-finite echoes, no beam, fewer than two channels or pings, a velocity without times, two pings of which fewer
        than two pairs of phase centres overlap (both are named), an argument out of range.

    Notes
    -----
    For every pair of channels a line of points lies on the seabed along the mean boresight, at slant ranges c/(2 fs) apart,
    from where the two-way beam has its middle: transmitter and receivers weigh as the squares of their lengths, receivers
    where they receive. Both traces are read at these points' exact delays, on the carrier, A and B (B later by a common lag,
    which the envelope gives in the first pass), limited to twice the speckle's rms; C = sum B conj(A) over windows. A point's
    true two-way path is 2 u.delta shorter than the claimed, so

    u.(delta_q - delta_p) + (turn_p + turn_q)/2 (z x u).(P_q - P_p) = -(c/2) (lag - arg C/(2 pi fc)),

    with delta = d + turn z x (P - middle of the ping) and P phase centres; the second term says that lines of sight turn with
    the beams. Rows have the standard deviations of `bounds.phase_noise`. Coherences at several separations s give the surge, by
    least squares of A T(s + surge), T being `bounds.coherence`. All rows of the line are solved at once, with Cauchy's weights.

    Displaced phase centres: A. Bellettini and M. A. Pinto 2002, IEEE J. Oceanic Eng. 27, 780. O(ping^3 channel) time for the
    dense solution, which rules beyond 100 pings, and 130 bytes a sample.
    """
    elements = _checked(echoes, elements)
    seabed = _checks.number("seabed", seabed)
    window = _checks.number("window", window, positive=True)
    lags = _checks.whole("lags", lags, low=1)
    iterations = _checks.whole("iterations", iterations, low=1)
    fine = [np.array([finer(trace) for trace in ping]) for ping in echoes.whole().traces]
    total = np.zeros((echoes.n_ping, 4))
    for iteration in range(iterations):
        now = _moved(echoes, total)
        reader = _Reader(now, fine, seabed, window, lags, elements)
        total = total + _solved(now, [reader.sight(ping, search=iteration == 0) for ping in range(echoes.n_ping - 1)])
    return total


def _checked(echoes: Echoes, elements: tuple[float, float] | None) -> tuple[float, float]:
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not echoes.compressed:
        raise ValueError("echoes: compressed=False: expected range-compressed echoes (pysas.compress)")
    _looks(echoes)
    if echoes.n_ping < 2 or echoes.n_channel < 2:
        raise ValueError(f"echoes: {echoes.n_ping} pings, {echoes.n_channel} channels: expected at least two of each")
    if echoes.velocity is not None and echoes.ping_time is None:
        raise ValueError("echoes: ping_time=None beside a velocity: expected the times in which a displacement alters it")
    finite = np.isfinite(echoes.whole().traces).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(f"echoes: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
    if elements is None:
        length = 0.0 if echoes.beam is None else echoes.beam.length
        return length, length
    lengths = [_checks.number("elements", length, low=0.0) for length in elements]
    if len(lengths) != 2 or not sum(lengths) > 0:
        raise ValueError(f"elements={elements!r}: expected the lengths of transmitter and receivers, not both 0")
    return lengths[0], lengths[1]


def _looks(echoes: Echoes) -> FloatArray:
    """(ping, 3) directions in which the beam looks."""
    if echoes.beam is None:
        raise ValueError("echoes: beam=None: expected one, which tells where the sonar looks")
    return np.broadcast_to(echoes.beam.boresights, echoes.tx.shape)


def _moved(echoes: Echoes, by: FloatArray) -> Echoes:
    """Echoes of the track displaced `by` (ping, 4)."""
    middle = (echoes.tx + echoes.receivers.mean(axis=1)) / 2
    cosine, sine, zero, one = np.cos(by[:, 3]), np.sin(by[:, 3]), np.zeros(len(by)), np.ones(len(by))
    turn = np.array([[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, one]])  # (3, 3, ping)
    tx = middle + by[:, :3] + np.einsum("ijp,pj->pi", turn, echoes.tx - middle)
    arms = np.einsum("ijp,pcj->pci", turn, echoes.receivers - middle[:, None])
    velocity = echoes.receiver_velocity
    if velocity is not None and echoes.ping_time is not None:
        rate = np.gradient(by, echoes.ping_time, axis=0)
        velocity = velocity + rate[:, None, :3] + rate[:, None, 3:] * np.cross(UP, arms)
    look = np.einsum("ijp,pj->pi", turn, _looks(echoes))
    beam = Beam(look, length=1.0, half_angle=np.pi / 2)  # for its direction alone
    return echoes.replace(tx=tx, rx=(middle + by[:, :3])[:, None] + arms, velocity=velocity, beam=beam)


class _Reader:
    """Reads two pings along lines on the seabed, and compares them."""

    def __init__(
        self, echoes: Echoes, fine: list[Complex], seabed: float, window: float, lags: int, elements: tuple[float, float]
    ) -> None:
        self.echoes, self.fine, self.seabed, self.lags, self.elements = echoes, fine, seabed, lags, elements
        self.c, self.wavelength = echoes.speed, echoes.speed / echoes.fc
        velocity = echoes.receiver_velocity
        self.velocity = np.zeros(echoes.receivers.shape) if velocity is None else velocity
        self.centres = (echoes.tx[:, None] + echoes.receivers) / 2
        step = self.c / (2 * echoes.fs)
        height = float(np.max(np.abs(self.centres[..., 2] - seabed)))
        near, far = echoes.swath
        near = max(near, 1.02 * height)
        self.per_window = round(window / step)
        self.n_window = int((far - near) / step / self.per_window)
        if self.per_window < 8 or self.n_window < 1:
            raise ValueError(
                f"window={window:g} m: expected at least 8 samples ({8 * step:.3g} m) and at most the swath on the seabed, "
                f"{near:.4g} to {far:.4g} m"
            )
        self.ranges = near + step * np.arange(self.n_window * self.per_window)
        self.window = self.per_window * step
        reach = np.linspace(-sum(elements), sum(elements), 801)
        self.separations, self.expected = reach, coherence(reach, elements=elements, wavelength=self.wavelength)

    def sight(self, p: int, search: bool) -> _Sight:
        """What pings p and p + 1 see of each other; with `search`, after the envelope's common lag is found."""
        q = p + 1
        side = _looks(self.echoes)[[p, q]].sum(axis=0)
        side = side * [1, 1, 0] / np.hypot(side[0], side[1])
        forward = np.cross(side, UP)
        forward *= np.sign(forward @ (self.centres[q].mean(axis=0) - self.centres[p].mean(axis=0)))
        pairs, overlapping = self._pairs(p, forward)
        points = np.array([self._line(p, i, j, side) for i, j in pairs])
        lag = 0.0
        if search:
            few = np.flatnonzero(overlapping)
            a = np.array([self._read(p, pairs[n, 0], points[n]) for n in few])
            lag = self._lag(q, pairs[few, 1], points[few], a)
        a = self._limited(np.array([self._read(p, i, line) for (i, _), line in zip(pairs, points, strict=True)]))
        b = self._limited(np.array([self._read(q, j, line, lag) for (_, j), line in zip(pairs, points, strict=True)]))
        product = np.sum(b * a.conj(), axis=-1)
        count = 2 * self.window * self.echoes.occupied_bandwidth / self.c
        powers = np.sum(np.abs(a) ** 2, axis=-1) * np.sum(np.abs(b) ** 2, axis=-1)
        squared = np.abs(product) ** 2 / np.where(powers > 0, powers, 1)
        gamma = np.sqrt(np.clip(squared - (1 - squared) / count, 1e-6, 1))  # chance alone gives 1/count
        noise = np.hypot(
            phase_noise(gamma, window=self.window, bandwidth=self.echoes.occupied_bandwidth, c=self.c), LEAST_PHASE
        )
        sigma = np.where(gamma < LEAST_COHERENCE, np.inf, slant_noise(noise, self.wavelength))
        slant = -self.c / 2 * (lag - np.angle(product) / (2 * np.pi * self.echoes.fc))
        ends = self.centres[p, pairs[:, 0]], self.centres[q, pairs[:, 1]]
        middle = points[:, self.per_window // 2 :: self.per_window]
        look = middle - ((ends[0] + ends[1]) / 2)[:, None]
        look /= np.linalg.norm(look, axis=-1, keepdims=True)
        turn = np.sum(np.cross(UP, look) * (ends[1] - ends[0])[:, None], axis=-1)
        surge = self._surge((ends[1] - ends[0]) @ forward, gamma.mean(axis=1))
        return _Sight(pairs, look, turn, slant, sigma, forward, surge)

    def _pairs(self, p: int, forward: FloatArray) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
        """Channels (pair, 2) of pings p and p + 1, and which of them overlap best."""
        n = self.echoes.n_channel
        i, j = (index.ravel() for index in np.indices((n, n)))
        apart = (self.centres[p + 1, j] - self.centres[p, i]) @ forward
        difference = i - j
        shifts = np.arange(1 - n, n)
        best = shifts[np.argmin([abs(apart[difference == k].mean()) for k in shifts])]
        overlapping = int(np.sum(difference == best))
        gap = abs(apart[difference == best].mean())
        if overlapping < 2 or gap > (abs(apart).max() - abs(apart).min()) / (2 * n):
            raise ValueError(
                f"echoes: pings {p} and {p + 1}: {overlapping} pair{'s' * (overlapping != 1)} of phase centres overlap, "
                f"{gap:.3g} m apart: expected at least two, which tell the heading"
            )
        kept = np.flatnonzero(np.abs(difference - best) <= self.lags)
        return np.stack([i[kept], j[kept]], axis=1), difference[kept] == best

    def _line(self, p: int, i: int, j: int, side: FloatArray) -> FloatArray:
        """(n, 3) points of the seabed at `ranges` from the middle of the two-way beam, both pings' mean."""
        tx_weight, rx_weight = (length**2 / sum(e**2 for e in self.elements) for length in self.elements)
        start = np.zeros((self.ranges.size, 3))
        for ping, channel in ((p, i), (p + 1, j)):
            moved = 2 * self.ranges[:, None] / self.c * self.velocity[ping, channel]
            start += (tx_weight * self.echoes.tx[ping] + rx_weight * (self.echoes.receivers[ping, channel] + moved)) / 2
        height = start[:, 2] - self.seabed
        line = start + np.sqrt(self.ranges**2 - height**2)[:, None] * side
        line[:, 2] = self.seabed
        return line

    def _read(self, ping: int, channel: int, points: FloatArray, lag: float = 0.0) -> Complex:
        """A trace at the points' delays, later by `lag` (s), on the carrier."""
        echoes = self.echoes
        tau = lag + delays(points, echoes.tx[ping], echoes.receivers[ping, channel], self.velocity[ping, channel], self.c)
        place = (tau - echoes.start_time[ping]) * echoes.fs
        return np.asarray(read(self.fine[ping][channel], place) * np.exp(2j * np.pi * echoes.fc * tau))

    def _limited(self, lines: Complex) -> Complex:
        """(pair, window, n), no sample above CLIP times its window's speckle."""
        windows = lines.reshape(len(lines), self.n_window, self.per_window)
        size = np.abs(windows)
        limit = CLIP / MEDIAN * np.median(size, axis=-1, keepdims=True)
        return np.asarray(windows * np.minimum(1, limit / np.where(size > 0, size, 1)))

    def _lag(self, q: int, channels: npt.NDArray[np.intp], points: FloatArray, a: Complex) -> float:
        """The common delay (s) at which envelopes agree best."""
        step = 0.25 / self.echoes.fs
        tried = step * np.arange(-4 * SEARCH, 4 * SEARCH + 1)
        first = self._limited(a).conj()
        found = np.zeros(tried.size)
        for n, lag in enumerate(tried):
            b = np.array([self._read(q, j, line, lag) for j, line in zip(channels, points, strict=True)])
            found[n] = np.sum(np.abs(np.sum(self._limited(b) * first, axis=-1)) ** 2)
        top = int(np.clip(np.argmax(found), 1, tried.size - 2))
        before, at, after = found[top - 1 : top + 2]
        bend = before - 2 * at + after
        return float(tried[top] + (step / 2 * (before - after) / bend if bend < 0 else 0.0))

    def _surge(self, apart: FloatArray, gamma: FloatArray) -> float:
        """The displacement e at which A T(apart + e) fits the coherences best, A the best for each e."""

        def left(e: float) -> float:
            model = np.interp(apart + e, self.separations, self.expected)
            return float(np.sum((gamma - model * (gamma @ model) / (model @ model)) ** 2))

        reach = np.ptp(apart) / 2
        return float(minimize_scalar(left, bounds=(-reach, reach), method="bounded", options={"xatol": 1e-6}).x)


def _solved(echoes: Echoes, sights: list[_Sight]) -> FloatArray:
    """(ping, 4) displacements of least squares."""
    n_ping = echoes.n_ping
    centres = (echoes.tx[:, None] + echoes.receivers) / 2
    arms = centres - centres.mean(axis=1, keepdims=True)
    rows, values, sigmas = [], [], []
    for p, sight in enumerate(sights):
        n_window = sight.look.shape[1]
        for n, (i, j) in enumerate(sight.pairs):
            row = np.zeros((n_window, n_ping, 4))
            row[:, p, :3], row[:, p + 1, :3] = -sight.look[n], sight.look[n]
            row[:, p, 3] = -sight.look[n] @ np.cross(UP, arms[p, i]) + sight.turn[n] / 2
            row[:, p + 1, 3] = sight.look[n] @ np.cross(UP, arms[p + 1, j]) + sight.turn[n] / 2
            rows.append(row)
            values.append(sight.slant[n])
            sigmas.append(sight.sigma[n])
        surge = np.zeros((1, n_ping, 4))
        surge[0, p, :3], surge[0, p + 1, :3] = -sight.forward, sight.forward
        rows.append(surge)
        values.append(np.array([sight.surge]))
        sigmas.append(np.array([SURGE]))
    rows.append(np.eye(4 * n_ping).reshape(-1, n_ping, 4))
    values.append(np.zeros(4 * n_ping))
    sigmas.append(np.tile(WEAK, n_ping))
    sigma = np.concatenate(sigmas)
    matrix = np.concatenate(rows).reshape(sigma.size, -1) / sigma[:, None]
    wanted = np.concatenate(values) / sigma
    weight = np.ones(sigma.size)
    for _ in range(PASSES):
        found = np.linalg.lstsq(weight[:, None] * matrix, weight * wanted, rcond=None)[0]
        weight = 1 / np.sqrt(1 + ((matrix @ found - wanted) / FEW) ** 2)
    return np.asarray(found.reshape(n_ping, 4))
