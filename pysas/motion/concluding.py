"""From a solution to what is told of it: whether a track was found, how sure, and what an image gains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.motion.found import Motion
from pysas.motion.measuring import LEAST, Measured, Sought
from pysas.motion.phase_centres import Side
from pysas.motion.solution import Equations, gauge, without_gauge

_DOUBT = 1.0  # dB
# how many times its own uncertainty a track has to mend: the square of the one bend that noise is mostly made of reaches so
# many times its mean in one track of twelve (chi squared of one degree of freedom)
_SURE = 3.0
# dB of its own uncertainty, a phase of 4.8 rad over an aperture, beyond which a track is noise however much it seems to mend
_LOST = 100.0
_STILL = 0.1  # of the claimed way
# standard deviations that are left of echoes (4 at most), and of the worst part of a prior: neither tells the truth. Right
# priors left 1.8 and 3.3 at most where phase centres lie apart, those that bent a track 2.1 or 4.0 and more
_WRONG, _UNLIKE = 2.0, 3.6


@dataclass(eq=False)
class Solution:
    """A track (ping, 4), what it leaves of echoes and prior in standard deviations (2,), its equations, what is known of each
    ping in the frame of the one before, (ping - 1, 4, 4), and whether it is beyond belief."""

    track: FloatArray
    residual: FloatArray
    equations: Equations
    relative: FloatArray
    wild: bool = False


def conclude(
    solution: Solution, sought: Sought, track: FloatArray, claim: list[Side], measured: list[Measured], overlap: FloatArray,
    pivot: FloatArray,
) -> Motion:  # fmt: skip
    """What is told of a track (ping, 4) beyond the claimed one, 0 where nothing was found."""
    seen = np.any([one.seen for one in measured], axis=0)
    slips = np.any([one.slip for one in measured], axis=0)
    coherence = np.max([one.coherence for one in measured], axis=0)
    forward = claim[0].forward
    across = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    turn = np.zeros((len(track) - 1, 4, 4))
    turn[:, 0, :2], turn[:, 1, :2], turn[:, 2, 2], turn[:, 3, 3] = forward[1:, :2], across[1:], 1, 1
    variance = np.einsum("pik,pkl,pil->pi", turn, np.linalg.inv(solution.relative), turn)
    scale = max(1.0, float(solution.residual[0]))  # echoes that leave more over than they should are less sure than they say
    sigma = scale * np.sqrt(np.concatenate([variance[:1], variance]))
    looks = measured[0].looks[:, measured[0].looks.shape[1] // 2]
    looks = np.concatenate([looks, looks[-1:]])
    sure = solution.equations.part(0, len(track)).slant_variance(looks, gauge(looks, pivot))
    slant = np.sum(looks * track[:, :3], axis=1)
    change, doubt, whole = _losses(claim[0], looks, pivot, slant, solution.equations, seen)
    doubt *= scale**2
    why = _wanting(solution, sought, claim[0], pivot, seen, coherence, track)
    if why is None and whole and doubt > min(max(_DOUBT, change / _SURE), _LOST):
        why = (
            f"what was found would cost an image {doubt:.2g} dB by its own uncertainty, and is worth {change:.2g} dB: not "
            f"{_SURE:g} times as much, or more than {_LOST:g} dB unsure"
        )
    found = why is None
    loss = np.array([change + doubt, doubt])
    if not found:
        track, loss = np.zeros_like(track), np.full(2, np.nan)
    surge, sway = (np.sum(track[:, :2] * d[:, :2], axis=1) for d in (forward, across))
    return Motion(
        track[:, :3], track[:, 3], surge, sway, track[:, 2], sigma, scale * np.sqrt(np.clip(sure, 0, None)), coherence, overlap,
        solution.residual, np.flatnonzero(slips).tolist(), np.flatnonzero(~seen).tolist(), found,
        why or f"{np.sum(seen)} of {len(seen)} pairs of pings correlate", pivot, loss,
    )  # fmt: skip


def _wanting(
    solution: Solution, sought: Sought, side: Side, pivot: FloatArray, seen: npt.NDArray[np.bool_], coherence: FloatArray,
    track: FloatArray,
) -> str | None:  # fmt: skip
    """Why a solution is no track, or None."""
    if np.mean(seen) <= 0.5:
        ping = int(np.argmin(seen))
        return (
            f"{np.sum(~seen)} of {len(seen)} pairs of pings do not correlate, the first of them pings {ping} and {ping + 1} "
            f"(coherence {coherence[ping]:.2f}): noise, no seabed, or a claimed track whose advance is wrong"
        )
    if not sought.distinct:
        return (
            f"pings 0 and 1 and the following ones correlate as little (coherence {np.sqrt(sought.strength):.2f} at most) at "
            f"one separation of phase centres as at others ({np.sqrt(sought.typical):.2f}): bright points or noise, no "
            "overlap"
        )
    if np.median(coherence) < LEAST:
        return f"pings correlate too little: coherence {np.median(coherence):.2f}, expected {LEAST:g} and more: noise"
    way, claimed = (np.linalg.norm(np.diff(place, axis=0), axis=1) for place in (pivot + track[:, :3], pivot))
    still = way < _STILL * claimed
    if np.mean(still) > 0.5:
        ping = int(np.argmax(still))
        return (
            f"{np.sum(still)} of {len(still)} pairs of pings saw the same from the same place, the first of them pings {ping} "
            f"and {ping + 1}: the sonar stood still, or the same ping was recorded again, and the claimed track moves on"
        )
    echo, prior = solution.residual
    if echo > _WRONG or prior > _UNLIKE or solution.wild:
        return (
            f"echoes contradict each other by {echo:.2g} and the prior by {prior:.2g} standard deviations: too few echoes of a "
            f"seabed at z = {side.seabed:g} m (the sonar is at {np.mean(pivot[:, 2]):.3g} m), or a prior that is too sure"
        )
    return None


def _losses(
    side: Side, looks: FloatArray, pivot: FloatArray, slant: FloatArray, equations: Equations, seen: npt.NDArray[np.bool_]
) -> tuple[float, float, bool]:
    """dB of an image's peaks that a correction and its uncertainty are worth over one aperture, 4.34 (4 pi fc/c sigma)^2, and
    whether any aperture is without pings that nothing correlates."""
    echoes, beam = side.echoes, side.echoes.beam
    if beam is None:
        raise _checks.InternalError("beam: none")
    way = float(np.median(np.linalg.norm(np.diff(pivot, axis=0), axis=1)))
    aperture = echoes.mean_speed / echoes.fc * sum(echoes.swath) / beam.length  # from null to null, at the swath's middle
    pings = min(max(int(np.ceil(aperture / max(way, 1e-9))), 3), len(slant))
    starts = np.unique(np.linspace(0, len(slant) - pings, 32).astype(int))
    parts = [slice(int(s), int(s) + pings) for s in starts]
    before = np.mean([np.mean(without_gauge(looks[p], pivot[p], slant[p]) ** 2) for p in parts])
    whole = [p for p in parts if seen[p.start : p.stop - 1].all()]
    some = (whole or parts)[len(whole or parts) // 2]
    after = float(np.mean(equations.part(some.start, some.stop).slant_variance(looks[some], gauge(looks[some], pivot[some]))))
    size = 4.34 * (4 * np.pi * echoes.fc / echoes.mean_speed) ** 2
    return float(size * before), float(size * max(after, 0.0)), bool(whole)
