"""Micronavigation: a track from the echoes themselves, by displaced phase centres, in a few rounds of one solution."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.motion import correlating
from pysas.motion.concluding import Solution, conclude
from pysas.motion.found import Motion
from pysas.motion.measuring import Measured, measure, seek
from pysas.motion.moving import VELOCITIES, centres, moved, times
from pysas.motion.phase_centres import Side, axes, centre_step
from pysas.motion.priors import Prior
from pysas.motion.solution import Beliefs, Equations

_CUT, _PASSES = 4.0, 3  # of Cauchy's weights, standard deviations
_ALIKE = 1e-9  # of the square of two pings' correlation, short of 1: what rounding leaves of a ping recorded again
_WILD = np.array([0.5, 0.5, 0.5, 0.3])  # m, rad: changes from ping to ping that no sonar makes unclaimed


@_checks.usual_errors
def micronavigate(
    echoes: Echoes | Sequence[Echoes],
    seabed: float = 8.0,
    prior: Prior | None = None,
    windows: float = 2.5,
    lags: int = 1,
    iterations: int = 2,
    velocity: str = "follow",
    tol: float = 2e-2,
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
        Along-track lengths of the transmitter and of one receiver, m: the two-way beam's middle lies between them as their
        squares say. Default: the beam's `length` for both, but for receivers at most their spacing.

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
    start = np.zeros((len(pivot), 4))
    sought = max((seek(side, windows, tol, threads) for side in claim), key=lambda found: found.strength)
    if prior.speed is None:
        start[1:, :2] = -sought.missed * np.cumsum(claim[0].ahead(0, len(way))[:, :2], axis=0)
        start -= start.mean(axis=0)
    track, views = start, claim
    for number in range(iterations):
        if number or start.any():
            now = [moved(one, track[:, :3], track[:, 3], velocity, pivot) for one in sides]
            place = pivot + track[:, :3]
            views = [Side(one, place, size, seabed) for one, size in zip(now, lengths, strict=True)]
        measured = [measure(view, windows, number == 0, lags, tol, threads) for view in views]
        solution = _solve(measured, beliefs, track - start, way)
        track = start + solution.track
        solution.wild = bool(np.any(np.abs(np.diff(solution.track, axis=0)) > _WILD))
        if solution.wild:
            break
        if progress is not None:
            progress((number + 1) / iterations)
    return conclude(solution, sought, track, claim, measured, overlap, pivot)


def _sides(echoes: Echoes | Sequence[Echoes]) -> list[Echoes]:
    sides = [echoes] if isinstance(echoes, Echoes) else list(echoes)
    if not sides:
        raise ValueError("echoes: an empty sequence: expected the Echoes of at least one side")
    for one in sides:
        if not isinstance(one, Echoes):
            raise TypeError(f"echoes: {type(one).__name__}: expected pysas.Echoes, or a sequence of them")
        if not one.compressed:
            raise ValueError("echoes: compressed=False: expected compressed echoes: pysas.compress")
        if one.n_ping != sides[0].n_ping:
            raise ValueError(f"echoes: sides of {sides[0].n_ping} and {one.n_ping} pings: expected the same pings")
        if one.n_ping < 2:
            raise ValueError("echoes: one ping: expected at least two, of which a later one is compared with one before it")
        _require_own_noise(one)
    return sides


def _require_own_noise(echoes: Echoes) -> None:
    """Of each ping, whose samples are numbers: one that was recorded again, be it with another gain, says that the sonar stood
    still."""
    before = power = None
    for ping, traces in enumerate(echoes.whole().traces):
        bad = ~np.isfinite(traces)
        if bad.any():
            where = f"ping {ping}, channel {int(np.argmax(bad.any(axis=1)))}"
            raise ValueError(f"echoes: non-finite sample at {where}: expected finite ones, or compress(raw, nan='mask')")
        now = traces.astype(np.complex128)
        size = np.max(np.abs(now), axis=1, keepdims=True)
        now /= np.where(size > 0, size, 1.0)
        own = np.sum(np.abs(now) ** 2, axis=1)
        if before is not None:
            alike, most = np.abs(np.sum(now * before.conj(), axis=1)) ** 2, own * power
            if np.any((alike >= (1 - _ALIKE) * most) & (most > 0)):
                raise ValueError(f"echoes: ping {ping} repeats the samples of ping {ping - 1}: expected noise of its own")
        before, power = now, own


def _lengths(echoes: Echoes, elements: tuple[float, float] | None) -> tuple[float, float]:
    if elements is None:
        _, forward = axes(echoes)  # which a beam is needed for
        length = echoes.beam.length if echoes.beam is not None else 0.0
        return length, min(length, 2 * centre_step(echoes, forward))
    send, hear = _checks.reals("elements", elements, [(2,)])
    return _checks.number("elements", float(send), positive=True), _checks.number("elements", float(hear), positive=True)


def _require_overlap(overlap: FloatArray, prior: Prior) -> None:
    """Two overlapping phase centres tell yaw; without, a gyro does; and none at all is no micronavigation."""
    least, ping = (1.5, "fewer than two") if prior.gyro is None else (-0.5, "no")
    short = overlap < least
    if np.mean(short) > 0.5:
        ping_ = int(np.argmax(short))
        raise ValueError(
            f"echoes: {ping} phase centres of pings {ping_} and {ping_ + 1} overlap ({max(overlap[ping_], 0.0):.2g}): expected "
            "at least two, which tell yaw, or with prior=Prior(gyro=...) one: a shorter advance from ping to ping, or a longer "
            "array; pysas.align_points goes by bright points alone"
        )


def _solve(measured: list[Measured], beliefs: Beliefs, track: FloatArray, way: FloatArray) -> Solution:
    """From a track, which echoes were measured by, to a better one."""
    pings = len(track)
    step = np.zeros_like(track)
    seen = np.any([one.seen for one in measured], axis=0)
    seen = np.stack([seen, seen, seen, np.any([one.seen & (one.pairs >= 2) for one in measured], axis=0)], axis=1)
    for number in range(_PASSES + 1):
        normal, right, squares = np.zeros((pings - 1, 8, 8)), np.zeros((pings - 1, 8)), np.zeros((pings - 1, 2))
        found = np.concatenate([step[:-1], step[1:]], axis=1)
        cut = _CUT if number else np.inf
        for one in measured:
            for rows, sums in ((one.rows(), squares), (one.surge_rows(), np.zeros_like(squares))):
                _pool.call(correlating.gather, *rows, found, cut, normal, right, sums)
        equations = Equations(pings)
        equations.add(normal, right)
        equations.believe(beliefs, track)
        try:
            step = equations.solve()
        except np.linalg.LinAlgError:
            raise ValueError(
                f"prior={beliefs.prior!r}: too firm or too loose beside what echoes say: expected what the navigation's data "
                "sheet says, in m, rad and s"
            ) from None
        beliefs.bridge(track + step, seen, way)
    echo = float(np.sqrt(squares[:, 0].sum() / max(squares[:, 1].sum(), 1)))
    relative = normal[:, 4:, 4:] + np.einsum("pk,kl->pkl", 1 / beliefs.step**2, np.eye(4))
    return Solution(track + step, np.array([echo, beliefs.residual(track + step)]), equations, relative)
