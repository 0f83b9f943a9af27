"""Micronavigation: a track from the echoes themselves, by displaced phase centres, in a few rounds of one solution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from pysas import _checks, _pool
from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.motion import correlating
from pysas.motion.found import Motion, applied
from pysas.motion.moving import VELOCITIES, centres, times
from pysas.motion.phase_centres import MOST_BESIDE, MOST_PAIRS, Rows, Side
from pysas.motion.priors import Prior
from pysas.motion.solution import Beliefs, Equations, gauge, without_gauge
from pysas.motion.surging import mean_square_sine, surges

FIRST_REACH, REACH = 6, 3  # lags read on either side, samples: an arrival is looked for within FIRST_REACH/2, then within 1
_FINER = 8  # lags looked at per sample
_LEAST = 0.3  # coherence of a window that counts
_CUT, _PASSES = 4.0, 3  # of Cauchy's weights, standard deviations
_FLOOR = 5e-3  # rad: phases are never better known
_TRIED, _DISTINCT = 16, 1.5  # pings between all of whose channels is looked; how much stronger a missed separation must be
_BESIDE = 0.2  # steps of the phase centres by which separations that count may lie farther from 0 than the nearest
_STILL = 0.1  # of the claimed way
_WRONG, _UNLIKE = 2.0, 3.0  # standard deviations that are left of echoes (4 at most), and of a prior: neither tells the truth
_WILD = np.array([0.5, 0.5, 0.5, 0.3])  # m, rad: changes from ping to ping that no sonar makes unclaimed
_SEEN = 6.0  # standard deviations above noise's coherence at which two pings have seen the same


@dataclass(eq=False)
class _Measured:
    """What each two consecutive pings say: rows of slant displacement (pair, slot, window), and of surge (pair,)."""

    value: FloatArray
    sigma: FloatArray
    looks: FloatArray
    apart: FloatArray
    arms: FloatArray
    surge: FloatArray
    surge_sigma: FloatArray
    ahead: FloatArray
    base: FloatArray  # (pair,) slots of the nearest separation
    coherence: FloatArray
    seen: FloatArray
    slip: FloatArray


@_checks.usual_errors
def micronavigate(
    echoes: Echoes | Sequence[Echoes],
    seabed: float = 8.0,
    prior: Prior | None = None,
    windows: float = 2.5,
    lags: int = 1,
    iterations: int = 3,
    velocity: str = "follow",
    tol: float = 1e-2,
    threads: int | None = None,
    progress: Callable[[float], object] | None = None,
    elements: tuple[float, float] | None = None,
) -> Motion:
    """Find how the sonar moved from its echoes: surge, sway, heave and yaw of each ping beyond the claimed track.

    Where the arrays of consecutive pings overlap, both heard the same speckle of the seabed from the same phase centres; the
    phase between them says how much nearer the later one was.

    Parameters
    ----------
    echoes : Echoes, or a sequence of them
        Compressed, with the claimed tx, rx, velocity and beam. Several: the sides of one sonar, ping by ping.
    seabed : float
        z of the seabed's plane, m.
    prior : pysas.motion.Prior, optional
        Errors of the navigation system that the claimed track came from.
    windows : float
        Length of the windows of slant range that are correlated, m.
    lags : int
        Separations on either side of the nearest one that are correlated too, in steps of the phase centres: what surge is
        told by.
    iterations : int
        Rounds of measuring with the track found so far.
    velocity : "follow" or "keep"
        Whether the velocity came from the claimed track and so changes with it, or was measured by itself.
    tol : float
        Of the traces read, as in `backproject`.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors.
    progress : callable, optional
        Called with the fraction done now and then.
    elements : (float, float), optional
        Along-track lengths of the transmitter and of one receiver, m. Default: the beam's `length` for both.

    Returns
    -------
    pysas.motion.Motion
        Corrections to add to the claimed track; `apply` adds them. `found` is False, and all are 0, where the echoes say
        nothing: no two pings correlate.

    Raises
    ------
    ValueError, TypeError
        Raw echoes, no beam, one ping, pings that repeat samples, sides of different pings; fewer than two overlapping phase
        centres without a prior whose gyro is known, which leaves yaw unknown; an argument outside its range.

    Notes
    -----
    O(pings (channel pairs samples + windows)) time; about 0.5 GB of work in memory. A shift of the whole track and its mean
    heading cannot be found: they move the image and leave it sharp. Source: A. Bellettini, M. Pinto, Theoretical accuracy of
    synthetic aperture sonar micronavigation using a displaced phase-center antenna, IEEE J. Oceanic Eng. 27, 780 (2002).
    """
    sides = _sides(echoes)
    seabed = _checks.number("seabed", seabed)
    windows = _checks.number("windows", windows, positive=True)
    lags, iterations = _checks.whole("lags", lags, high=8), _checks.whole("iterations", iterations)
    _checks.choice("velocity", velocity, VELOCITIES)
    _checks.callback("progress", progress)
    if prior is not None and not isinstance(prior, Prior):
        raise TypeError(f"prior={prior!r}: expected a pysas.motion.Prior or None")
    prior = prior or Prior()
    pivot = np.mean([centres(one) for one in sides], axis=0)
    beliefs = Beliefs(prior, len(pivot), times(sides[0]))
    lengths = [_lengths(one, elements) for one in sides]
    claim = [Side(one, pivot, size, seabed) for one, size in zip(sides, lengths, strict=True)]
    overlap = np.max([side.overlap() for side in claim], axis=0)
    _require_overlap(overlap, prior)
    way = np.linalg.norm(np.diff(pivot, axis=0), axis=1)
    track = np.zeros((len(pivot), 4))
    missed = _missed(claim[0], windows, tol, threads)
    track[1:, :2] = -missed * np.cumsum(claim[0].ahead(0, len(way))[:, :2], axis=0)
    start, views = track, claim
    for number in range(iterations):
        if number or missed:
            now = [applied(one, pivot, track[:, :3], track[:, 3], velocity) for one in sides]
            place = pivot + track[:, :3]
            views = [Side(one, place, size, seabed) for one, size in zip(now, lengths, strict=True)]
        measured = [_measure(view, windows, number == 0, lags, tol, threads) for view in views]
        step, residual, equations, normal = _solve(measured, beliefs, track, way)
        track = track + step
        wild = bool(np.any(np.abs(np.diff(track - start, axis=0)) > _WILD))
        if wild:
            break
        if progress is not None:
            progress((number + 1) / iterations)
    return _motion(track, wild, claim, measured, overlap, residual, equations, normal, beliefs, pivot)


def _sides(echoes: Echoes | Sequence[Echoes]) -> list[Echoes]:
    sides = [echoes] if isinstance(echoes, Echoes) else list(echoes)
    if not sides:
        raise ValueError("echoes: an empty sequence: expected the Echoes of at least one side")
    for one in sides:
        if not isinstance(one, Echoes):
            raise TypeError(f"echoes: {type(one).__name__}: expected pysas.Echoes, or a sequence of them")
        if not one.compressed:
            raise ValueError("echoes: compressed=False: expected compressed echoes: pysas.compress")
        if one.beam is None:
            raise ValueError("echoes: beam=None: expected a pysas.Beam, which says where the seabed is seen, and how widely")
        if one.n_ping != sides[0].n_ping:
            raise ValueError(f"echoes: sides of {sides[0].n_ping} and {one.n_ping} pings: expected the same pings")
        if one.n_ping < 2:
            raise ValueError("echoes: one ping: expected at least two, of which a later one is compared with one before it")
        for ping in range(1, one.n_ping):
            if np.array_equal(one.traces[ping, 0], one.traces[ping - 1, 0]) and np.any(one.traces[ping, 0]):
                raise ValueError(f"echoes: ping {ping} repeats the samples of ping {ping - 1}: expected another ping's, with noise of its own")
    return sides


def _lengths(echoes: Echoes, elements: tuple[float, float] | None) -> tuple[float, float]:
    if elements is None:
        if echoes.beam is None:
            raise _checks.InternalError("beam: none")
        return echoes.beam.length, echoes.beam.length
    send, hear = _checks.reals("elements", elements, [(2,)])
    return _checks.number("elements", float(send), positive=True), _checks.number("elements", float(hear), positive=True)


def _require_overlap(overlap: FloatArray, prior: Prior) -> None:
    """Two overlapping phase centres tell yaw; without, a gyro does; and none at all is no micronavigation."""
    least, ping = (1.5, "fewer than two") if prior.gyro is None else (-0.5, "no")
    short = overlap < least
    if np.mean(short) > 0.5:
        ping_ = int(np.argmax(short))
        raise ValueError(
            f"echoes: {ping} phase centres of pings {ping_} and {ping_ + 1} overlap ({overlap[ping_]:.3g}): expected at least "
            "two, which tell yaw, or with prior=Prior(gyro=...) one: a shorter advance from ping to ping, or a longer array"
        )


def _missed(side: Side, size: float, tol: float, threads: int | None) -> float:
    """Separation, m, of the phase centres that coincide, where those are not that the claimed advance brings together: of a few
    pings, between all channels."""
    tried = np.unique(np.linspace(0, side.echoes.n_ping - 2, _TRIED).astype(int))
    numbers = np.arange(1 - side.echoes.n_channel, side.echoes.n_channel)
    strength, place, times_ = np.zeros(len(numbers)), np.zeros(len(numbers)), np.zeros(len(numbers))
    fine, filters = _lags(True, FIRST_REACH, side.echoes)
    for ping in tried:
        rows = side.measure(ping, ping + 1, size, FIRST_REACH, side.echoes.n_channel - 1, tol, threads)
        for k, number in enumerate(numbers):
            of = rows.used[0] & (rows.order == number)
            if of.any():
                strength[k] += np.max(np.mean(np.abs(rows.products[0, of] @ filters) ** 2, axis=(0, 1)))
                place[k] += np.mean(rows.separation[0, of])
                times_[k] += 1
    strength /= np.maximum(times_, 1)
    best = int(np.argmax(np.where(2 * times_ > len(tried), strength, 0)))
    near = float(np.max(strength[np.abs(numbers) <= 1]))
    if abs(numbers[best]) <= 1 or strength[best] < max(_DISTINCT * near, _LEAST**2):
        return 0.0
    return float(place[best] / times_[best])


def _lags(first: bool, reach: int, echoes: Echoes) -> tuple[FloatArray, ComplexArray]:
    """Lags that are looked at, samples, and the filters to them."""
    most = reach / 2 if first else 1.0
    fine = np.arange(-round(most * _FINER), round(most * _FINER) + 1) / _FINER
    return fine, _interpolator(fine, reach, echoes.fs / echoes.fc)


def _measure(side: Side, size: float, first: bool, lags: int, tol: float, threads: int | None) -> _Measured:
    """Rows of all pings of one side."""
    parts = []
    reach = FIRST_REACH if first else REACH
    slots = MOST_PAIRS + 2 * lags * MOST_BESIDE
    for low, high in side.batches(min(slots, (2 * lags + 1) * side.echoes.n_channel)):
        parts.append(_reduced(side, side.measure(low, high, size, reach, lags, tol, threads), reach, first))
    return _Measured(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(_Measured)))


def _reduced(side: Side, rows: Rows, reach: int, first: bool) -> _Measured:
    """Delays, their standard deviations and surge from correlations at several lags."""
    echoes, base = side.echoes, rows.order == 0
    cycle = echoes.fs / echoes.fc  # samples of the carrier's period
    fine, filters = _lags(first, reach, echoes)
    height = np.zeros((len(rows.used), fine.size))
    for slot in np.flatnonzero(base):
        height += np.sum(np.abs(rows.products[:, slot] @ filters) ** 2 * rows.count[:, slot, :, None], axis=1)
    envelope = _peak(height, fine)
    centred = rows.products[..., reach]
    # how well the envelope's peak is known, of all windows together, samples
    number = np.sum(rows.count[:, base], axis=(1, 2))
    mean = np.sum(np.abs(centred[:, base]) ** 2 * rows.count[:, base], axis=(1, 2)) / np.maximum(number, 1)
    phase_error = np.sqrt(np.clip(1 - mean, 1e-4, None) / (2 * np.maximum(number * mean, 1e-3)))
    envelope_error = phase_error * np.sqrt(12) / (2 * np.pi * echoes.occupied_bandwidth) * echoes.fs
    slip = np.abs(envelope) > np.maximum(0.6 * cycle, 4 * envelope_error)
    lag = np.where(first | slip, envelope, 0.0)
    product = np.einsum("pswm,mp->psw", rows.products, _interpolator(lag, reach, cycle))
    squared = np.minimum(np.abs(product) ** 2, 1.0)
    number = rows.count
    squared = np.where(number > 0, squared - (1 - squared) / np.maximum(number, 1), 0.0)
    wavelength = rows.speed[:, None] / echoes.fc
    delay = lag[:, None, None] / echoes.fs - np.angle(product) / (2 * np.pi * echoes.fc)
    # points beside boresight at the same range see less of a separation along it: the mean over the beam's power
    level = rows.looks[..., :2]
    short = mean_square_sine(side.elements, wavelength) / 2 / np.sum(level**2, axis=2).clip(1e-3)
    value = -rows.speed[:, None, None] / 2 * delay + short[:, None] * np.einsum("pwx,psx->psw", level, rows.apart[..., :2])
    # separations farther from 0 than the nearest are false where a bright point draws the beam's middle off boresight
    off = np.where(rows.used, np.abs(rows.separation), np.inf)
    near = off <= off.min(axis=1, keepdims=True) + _BESIDE * side.step
    good = (squared > _LEAST**2) & near[..., None]
    noise = np.sqrt(np.clip(1 - squared, 0, None) / (2 * np.maximum(number * squared, 1e-9)) + _FLOOR**2)
    sigma = np.where(good, noise * wavelength[..., None] / (4 * np.pi), 0.0)
    whole = np.sum(number, axis=2)
    strength = np.sum(squared * number, axis=2) / np.maximum(whole, 1)
    share = np.sum(np.where(base, strength, 0), axis=1) / np.maximum(np.sum(base & (whole > 0), axis=1), 1)
    tests = np.sum((number > 0) & base[:, None], axis=(1, 2))
    floor = np.sum((number > 0) / np.maximum(number, 1) * base[:, None], axis=(1, 2)) / np.maximum(tests, 1)
    seen = (share > _SEEN * floor / np.sqrt(np.maximum(tests, 1))) & (np.sum(good & base[:, None], axis=(1, 2)) >= 2)
    sigma[~seen] = 0
    surge, surge_sigma = surges(rows.separation, strength, rows.used & (whole > 0), side.elements, side.step)
    return _Measured(
        value, sigma, rows.looks, rows.apart, rows.arms, surge, np.where(seen, surge_sigma, 0.0), rows.ahead,
        np.argmax(rows.used & base, axis=1), np.sqrt(np.clip(share, 0, 1)), seen, slip & seen,
    )  # fmt: skip


def _interpolator(at: FloatArray, reach: int, cycle: float) -> ComplexArray:
    """(2 reach + 1, at) weights of lags -reach ... reach at fractional ones: a sinc under a Kaiser window, for what each lag's
    carrier, of a period of `cycle` samples, is first taken from, and then given again: between samples it aliases."""
    from_ = np.arange(-reach, reach + 1)[:, None]
    away = at[None, :] - from_
    inside = np.clip(1 - (away / (reach + 1)) ** 2, 0, None)
    return np.asarray(np.sinc(away) * np.i0(4.0 * np.sqrt(inside)) / np.i0(4.0) * np.exp(2j * np.pi * away / cycle))


def _peak(height: FloatArray, at: FloatArray) -> FloatArray:
    """Place of the largest of each row, by a parabola."""
    top = np.clip(np.argmax(height, axis=1), 1, height.shape[1] - 2)
    row = np.arange(len(height))
    left, middle, right = (height[row, top + k] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    return np.asarray(at[top] + (at[1] - at[0]) * np.clip(0.5 * (left - right) / np.where(bend < 0, bend, -np.inf), -1, 1))


def _solve(
    measured: list[_Measured], beliefs: Beliefs, track: FloatArray, way: FloatArray
) -> tuple[FloatArray, FloatArray, Equations, FloatArray]:
    """The step from a track, residuals, the equations and their pairs' normal blocks."""
    pings = len(track)
    step = np.zeros_like(track)
    for number in range(_PASSES + 1):
        normal, right, squares = np.zeros((pings - 1, 8, 8)), np.zeros((pings - 1, 8)), np.zeros((pings - 1, 2))
        found = np.concatenate([step[:-1], step[1:]], axis=1)
        for one in measured:
            cut = _CUT if number else 1e9
            _pool.call(
                correlating.gather, one.value, one.sigma, one.looks, one.apart, one.arms, found, cut, normal, right, squares
            )
            _pool.call(correlating.gather, *_surge_rows(one), found, cut, normal, right, np.zeros_like(squares))
        equations = Equations(pings)
        equations.add(normal, right)
        equations.believe(beliefs, track)
        step = equations.solve()
        beliefs.bridge(track + step, np.any([one.seen for one in measured], axis=0), way)
    echo = float(np.sqrt(squares[:, 0].sum() / max(squares[:, 1].sum(), 1)))
    return step, np.array([echo, beliefs.residual(track + step)]), equations, normal


def _surge_rows(one: _Measured) -> tuple[FloatArray, ...]:
    """Surge as rows like the others: along the forward direction, between the phase centres of the nearest pair."""
    every, base = np.arange(len(one.base)), one.base.astype(int)
    apart, arms = one.apart[every, base][:, None], one.arms[every, base][:, None]
    return one.surge[:, None, None], one.surge_sigma[:, None, None], one.ahead[:, None], apart, arms


def _motion(
    track: FloatArray, wild: bool, claim: list[Side], measured: list[_Measured], overlap: FloatArray, residual: FloatArray, equations: Equations,
    normal: FloatArray, beliefs: Beliefs, pivot: FloatArray,
) -> Motion:  # fmt: skip
    seen = np.any([one.seen for one in measured], axis=0)
    slips = np.any([one.slip for one in measured], axis=0)
    coherence = np.max([one.coherence for one in measured], axis=0)
    found, why = bool(np.mean(seen) > 0.5), ""
    way = np.linalg.norm(np.diff(pivot, axis=0), axis=1)
    still = np.linalg.norm(np.diff(pivot + track[:, :3], axis=0), axis=1) < _STILL * way
    forward = claim[0].forward
    across = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    if found and np.mean(still) > 0.5:
        found = False
        ping = int(np.argmax(still))
        why = (
            f"{np.sum(still)} of {len(still)} pairs of pings saw the same from the same place, the first of them pings {ping} and "
            f"{ping + 1}: the sonar stood still, or the same ping was recorded again, and the claimed track moves on"
        )
    elif found and (residual[0] > _WRONG or residual[1] > _UNLIKE or wild):
        found = False
        why = (
            f"echoes contradict each other by {residual[0]:.2g} and the prior by {residual[1]:.2g} standard deviations: too few "
            f"echoes of a seabed at z = {claim[0].seabed:g} m, bright points alone, or a prior that is too sure"
        )
    elif found:
        why = f"{np.sum(seen)} of {len(seen)} pairs of pings correlate"
    else:
        ping = int(np.argmin(seen))
        why = (
            f"{np.sum(~seen)} of {len(seen)} pairs of pings do not correlate, the first of them pings {ping} and {ping + 1} "
            f"(coherence {coherence[ping]:.2f}): noise, no seabed, or a claimed track whose advance is wrong"
        )
    if not found:
        track = np.zeros_like(track)
    turn = np.zeros((len(track) - 1, 4, 4))
    turn[:, 0, :2], turn[:, 1, :2], turn[:, 2, 2], turn[:, 3, 3] = forward[1:, :2], across[1:], 1, 1
    inner = normal[:, 4:, 4:] + np.einsum("pk,kl->pkl", 1 / beliefs.step**2, np.eye(4))
    variance = np.einsum("pik,pkl,pil->pi", turn, np.linalg.inv(inner), turn)
    sigma = np.sqrt(np.concatenate([variance[:1], variance]))
    looks = measured[0].looks[:, measured[0].looks.shape[1] // 2]
    looks = np.concatenate([looks, looks[-1:]])
    sure = equations.part(0, len(track)).slant_variance(looks, gauge(looks, pivot))
    slant = np.sum(looks * track[:, :3], axis=1)
    loss = _losses(claim[0], looks, pivot, slant, equations)
    surge, sway = (np.sum(track[:, :2] * d[:, :2], axis=1) for d in (forward, across))
    return Motion(
        track[:, :3], track[:, 3], surge, sway, track[:, 2], sigma, np.sqrt(np.clip(sure, 0, None)), coherence, overlap, residual,
        np.flatnonzero(slips).tolist(), np.flatnonzero(~seen).tolist(), found, why, pivot, loss,
    )  # fmt: skip


def _losses(side: Side, looks: FloatArray, pivot: FloatArray, slant: FloatArray, equations: Equations) -> FloatArray:
    """dB of an image's peaks that the claimed track and the found one cost, over one aperture: 4.34 (4 pi fc/c sigma)^2."""
    echoes, beam = side.echoes, side.echoes.beam
    if beam is None:
        raise _checks.InternalError("beam: none")
    way = float(np.median(np.linalg.norm(np.diff(pivot, axis=0), axis=1)))
    aperture = echoes.mean_speed / echoes.fc * sum(echoes.swath) / beam.length  # from null to null, at the swath's middle
    pings = min(max(int(np.ceil(aperture / max(way, 1e-9))), 3), len(slant))
    starts = np.unique(np.linspace(0, len(slant) - pings, 32).astype(int))
    before = np.mean([np.mean(without_gauge(looks[s : s + pings], pivot[s : s + pings], slant[s : s + pings]) ** 2) for s in starts])
    middle = int(starts[len(starts) // 2])
    some = slice(middle, middle + pings)
    after = np.mean(equations.part(middle, middle + pings).slant_variance(looks[some], gauge(looks[some], pivot[some])))
    turns = 4 * np.pi * echoes.fc / echoes.mean_speed
    return 4.34 * turns**2 * np.clip([before + after, after], 0, None)
