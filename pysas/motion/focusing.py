"""Autofocus: phases of pings that make patches of a back-projected image sharp, as a smooth correction of the track.

The cost of a patch b with image I_b(x) = sum_p X_p(x) exp(-j k u_p(x).delta_p) is its entropy or its sharpness. Its derivative

    dF/d delta_p = sum_x 2 Re[-j k u_p(x) F'(x) conj(I(x)) X_p(x) exp(-j k u_p(x).delta_p)]

costs as much as the cost itself, however many unknowns delta has (J. Ash 2012, IEEE GRSL 9, 104, has the phase of one ping).
Lines of sight are linear over a patch, so that the factors are products of one along each of its axes.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.optimize
import scipy.sparse

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.motion import patches as _patches
from pysas.motion.moving import centres, moved
from pysas.motion.patches import (
    CENTRED,
    LEAST_GAIN,
    Patch,
    axes_of,
    cost_of,
    costs,
    moved_place,
    shifts,
    wave_numbers,
    without_gauge,
)
from pysas.motion.results import Report

COMPONENTS = ("surge", "sway", "heave")
ORDER = 3  # cubic
KNOTS = (8, 16, 32)
FIRST_HARMONICS = (4, 8, 16, 32)  # before the highest asked for
PASSES = 3  # over one set of knots
STEPS = 60  # of the minimiser
PRIOR = 1 / 500  # weight of the prior beside costs of order one: about one over a point's energy beside its image's noise
DAMPING = 1e-5  # of a ping's phase, rad^2, in one step, beside a patch's cost: pings that hardly see a point stay
BASIN = 0.25  # wavelengths: phases do not tell a correction beyond from another by whole turns
STILL = 1e-3  # wavelengths: a step that moves no ping farther ends a set of knots


def patch_cost(patch: Patch, delta: FloatArray, k: FloatArray, metric: str) -> tuple[float, FloatArray]:
    """Cost of a patch with its pings moved by delta (n, 3), m, and its derivative by delta; k: (n,) wave numbers."""
    kind = patch.terms.dtype
    first, second = (
        np.exp(-1j * (k * np.sum(turn * delta, axis=1))[:, None] * patch.offsets).astype(kind) for turn in patch.turns
    )
    first *= np.exp(-1j * k * np.sum(patch.look * delta, axis=1)).astype(kind)[:, None]
    terms = patch.terms * first[:, :, None]
    terms *= second[:, None, :]
    image = terms.sum(axis=0)
    value, slope = cost_of(np.abs(image).astype(np.float64) ** 2, metric)
    back = (slope * image.conj()).astype(kind)
    weights = np.stack([back, back * patch.offsets[:, None], back * patch.offsets], axis=-1).reshape(-1, 3).astype(kind)
    moments = terms.reshape(len(terms), -1) @ weights
    pull = 2 * k[:, None] * moments.imag
    gradient = pull[:, :1] * patch.look + pull[:, 1:2] * patch.turns[0] + pull[:, 2:] * patch.turns[1]
    return value, np.asarray(gradient)


class _Basis:
    """Smooth corrections of a track: coefficients to (ping, 3) shifts, several components side by side."""

    def __init__(self, functions: Any, directions: list[FloatArray]) -> None:
        self.functions = scipy.sparse.csr_array(functions)
        self.directions = directions
        self.count = self.functions.shape[1]

    def series(self, theta: FloatArray) -> FloatArray:
        """(component, ping) displacements."""
        return np.stack([self.functions @ part for part in theta.reshape(len(self.directions), self.count)])

    def shift(self, series: FloatArray) -> FloatArray:
        return shifts(series, self.directions)

    def back(self, pull: FloatArray) -> FloatArray:
        """Derivatives by coefficients, of those by (component, ping) displacements."""
        return np.concatenate([self.functions.T @ row for row in pull])


def _splines(at: FloatArray, count: int) -> Any:
    """(ping, count) clamped cubic B-splines over the numbers `at` of pings."""
    inner = np.linspace(at[0], at[-1], count - ORDER + 1)
    knots = np.concatenate([np.full(ORDER, at[0]), inner, np.full(ORDER, at[-1])])
    return scipy.interpolate.BSpline.design_matrix(at, knots, ORDER)


def _waves(angle: FloatArray, highest: int) -> FloatArray:
    """(ping, 2 (highest - 1)) harmonics 2 ... highest of the angle."""
    orders = np.arange(2, highest + 1)
    return np.concatenate([np.cos(np.outer(angle, orders)), np.sin(np.outer(angle, orders))], axis=1)


def angles(middle: FloatArray) -> FloatArray:
    """(ping,) angles of phase centres about the circle through them that fits best (least squares of x^2 + y^2), rad."""
    x, y = (middle[:, :2] - middle[:, :2].mean(axis=0)).T
    design = np.stack([x, y, np.ones(x.size)], axis=1)
    (a, b, _), *_ = np.linalg.lstsq(design, x**2 + y**2, rcond=None)
    return np.asarray(np.arctan2(y - b / 2, x - a / 2))


class _Prior:
    """1/2 sum ((second difference of a displacement)/sigma)^2, weighed PRIOR beside the costs of patches."""

    def __init__(self, sigma: FloatArray) -> None:  # (component, ping - 2)
        self.sigma = sigma

    def __call__(self, series: FloatArray) -> tuple[float, FloatArray]:
        scaled = np.diff(series, 2, axis=1) / self.sigma
        slope = scaled / self.sigma
        pull = np.zeros_like(series)
        pull[:, :-2] += slope
        pull[:, 1:-1] -= 2 * slope
        pull[:, 2:] += slope
        return PRIOR * 0.5 * float(np.sum(scaled**2)), PRIOR * pull


def _prior_of(prior: Any, echoes: Echoes, components: Sequence[str]) -> _Prior | None:
    """Of a found motion's sigmas of increments: its sway bends as its yaw errs, sigma = advance x sigma of yaw."""
    if prior is None or not getattr(prior, "found", True):
        return None
    n = echoes.n_ping - 2
    if not hasattr(prior, "sigma"):
        return _Prior(np.full((len(components), n), _checks.number("prior", prior, positive=True)))
    sigma = _checks.reals("prior.sigma", prior.sigma, [(echoes.n_ping, 4)], ("ping",))[1:]
    advance = np.linalg.norm(np.diff(centres(echoes), axis=0), axis=1)
    of = {"surge": np.sqrt(2) * sigma[:, 0], "sway": advance * sigma[:, 3], "heave": np.sqrt(2) * sigma[:, 2]}
    found = []
    for name in components:
        if not np.all(of[name] > 0):
            ping = int(np.argmin(of[name] > 0)) + 1
            raise ValueError(f"prior: sigma {of[name][ping - 1]:g} m of {name} at ping {ping}: expected numbers > 0")
        found.append(np.sqrt((of[name][1:] ** 2 + of[name][:-1] ** 2) / 2))
    return _Prior(np.array(found))


def minimised(
    kept: Sequence[Patch], basis: _Basis, k: FloatArray, metric: str, prior: _Prior | None, sofar: FloatArray
) -> tuple[FloatArray, int]:
    """(component, ping) displacements that lower the patches' costs, and how often these were looked at; `sofar` are those that
    led to the patches, which the prior speaks of as well."""
    scale = 1 / float(np.median(k))  # unknowns in rad

    def objective(theta: FloatArray) -> tuple[float, FloatArray]:
        series = basis.series(theta * scale)
        shift = basis.shift(series)
        value, pull = 0.0, np.zeros_like(shift)
        for patch in kept:
            one, slope = patch_cost(patch, shift[patch.pings], k[patch.pings], metric)
            value += one
            pull[patch.pings] += slope
        along = np.stack([np.sum(pull * way, axis=1) for way in basis.directions])
        tie = DAMPING * len(kept) / scale**2
        value, along = value + tie / 2 * float(np.sum(series**2)), along + tie * series
        if prior is not None:
            more, bend = prior(series + sofar)
            value, along = value + more, along + bend
        return value, basis.back(along) * scale

    start = np.zeros(len(basis.directions) * basis.count)
    best = scipy.optimize.minimize(objective, start, jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
    return basis.series(best.x * scale), int(best.nfev)


@_checks.usual_errors
def autofocus(
    echoes: Echoes,
    grid: Grid,
    metric: str = "entropy",
    components: Sequence[str] = ("sway",),
    knots: Sequence[int] | None = None,
    prior: Any = None,
    harmonics: int | None = None,
    velocity: str = "follow",
    tol: float = 1e-2,
    threads: int | None = None,
) -> tuple[Echoes, Report]:
    """Correct a track by what makes bright points sharpest, to a small part of the wavelength.

    Patches about the bright points of `grid`'s image keep what each ping contributes to their pixels. A smooth displacement of
    the pings is sought that lowers the patches' cost, by its derivative, through the phases alone; then the track is moved, the
    patches are read again and centred, and the next finer displacement is sought. Errors of more than about a quarter of the
    wavelength are beyond it: `align_points` finds those, with which to begin.

    Parameters
    ----------
    echoes : Echoes
        Compressed, with the claimed track; 8 pings at least; any array. Attitude is not sought.
    grid : Grid
        Where bright points are looked for, sampled as finely as an image; its heights are taken for theirs.
    metric : "entropy" or "sharpness"
        -sum q ln q with q = |I|^2/sum |I|^2, or -ln(sum |I|^4/(sum |I|^2)^2), of each patch. Sharpness for circles: points with
        the side lobes that they have there are not of the least entropy.
    components : sequence of "surge", "sway", "heave"
        Displacements sought: along the array (or the way, of one receiver), across it, along z.
    knots : sequence of int, optional
        Numbers of cubic splines over the pings that see a bright point, one set after another, 4 or more. Default: 8, 16 and 32
        as far as there are as many pings. From few to many finds smooth errors of some millimetres; an error that bends faster
        than the first splines can wants more at once.
    prior : pysas.motion.Motion or float, optional
        How much displacements may bend: the motion that `micronavigate` found and with which the echoes were corrected (one
        that was not found says nothing), or the standard deviation of their second differences from ping to ping, m (10 to
        20 um after micronavigation). Without it pings that few points see drift.
    harmonics : int, optional
        For circles: harmonics 2 up to this one of the angle about the centre in place of splines, 4, 8, 16 ... of them first.
    velocity : "follow" or "keep"
        Whether the velocity came from the claimed track and so changes with it, or was measured by itself.
    tol : float
        Of what is read, as in `backproject`.
    threads : int, optional
        As in `backproject`.

    Returns
    -------
    fixed : Echoes
        With the track found; the echoes that were given where there is nothing to go by, where a patch would become worse, all
        gain less than clutter may, or the correction is beyond a quarter of the wavelength.
    report : pysas.motion.Report
        What was found, and why it was taken or not. `print` it.

    Raises
    ------
    ValueError, TypeError
        Raw echoes, fewer than 8 pings, pings all at one place or all alike, unknown metric or components, knots or harmonics
        out of range, a prior without sigmas > 0, what `focus` raises.

    Warns
    -----
    UserWarning
        A grid that no ping sees, as `focus` does.

    Notes
    -----
    Developed speckle has one entropy whatever the errors of phase: without bright points, which exceed what speckle reaches in
    one image of a thousand, the track is left alone. No image tells mean and slope along a line, or the harmonics 0 and 1 on a
    circle; they are left out.

    O(pings points) reads of a patch of 51 x 51 pixels, three at most a set of knots, and 60 passes or so over what is kept:
    three times 21 kB of complex64 a ping and point, of 32 points at most.

    J. Ash 2012, IEEE Geosci. Remote Sens. Lett. 9, 104: sharpness of back-projected images.
    """
    began = time.perf_counter()
    names = _patches.require(echoes, grid, components, COMPONENTS, velocity, metric)
    levels = _levels(echoes, knots, harmonics)
    ways = axes_of(echoes)
    directions = [ways[name] for name in names]
    middle = centres(echoes)
    k = wave_numbers(echoes)
    bound = _prior_of(prior, echoes, names)
    wavelength = echoes.mean_speed / echoes.fc

    detection = _patches.found(echoes, grid, tol, threads)
    claimed = [patch for patch in _patches.centred(echoes, detection.centres, tol, threads) if patch is not None]
    nothing = np.zeros((len(names), echoes.n_ping))
    state = best = _State(nothing, np.zeros((len(names), 2)), echoes, claimed, list(range(len(claimed))))
    told: list[str] = []
    looked, beyond, gained = 0, False, 0.0
    seen = _patches.seen_by(claimed) if claimed else np.arange(echoes.n_ping)
    for level in levels if claimed else []:
        basis, label = _basis(level, harmonics is not None, directions, middle, seen)
        for _ in range(PASSES):
            step, count = minimised(state.patches, basis, k, metric, bound, state.series)
            looked += count
            total, removed = state.series + step, np.zeros_like(state.gauge)
            if harmonics is None:
                total, removed = without_gauge(total, directions, middle, seen)
            largest = float(np.max(np.linalg.norm(basis.shift(total - state.series), axis=1)))
            said = f"{label}: {1e3 * largest:.3g} mm at most"
            farthest = float(np.max(np.linalg.norm(basis.shift(total), axis=1)))
            if farthest > BASIN * wavelength:
                told.append(f"{said}: not tried: {1e3 * farthest:.3g} mm in all, beyond a quarter of the wavelength")
                beyond = True
                break
            expected = []
            for patch in state.patches:
                rest = basis.shift(total - state.series - step)[patch.pings]
                expected.append(moved_place(patch, _peak(patch, basis.shift(step)[patch.pings], k[patch.pings]), rest))
            track = moved(echoes, basis.shift(total), np.zeros(echoes.n_ping), velocity)
            again = _patches.centred(track, np.array(expected), tol, threads)
            kept = [number for number, patch in enumerate(again) if patch is not None]
            there = [patch for patch in again if patch is not None]
            now, then = costs(there, metric), costs([state.patches[n] for n in kept], metric)
            if not kept or not now.mean() < then.mean():
                told.append(f"{said}: not taken: {metric} does not fall")
                break
            whole: list[Patch | None] = [None] * len(claimed)
            for number in kept:
                whole[state.origin[number]] = again[number]
            verdict = _patches.judged(claimed, whole, metric)
            told.append(f"{said}: {metric} {then.mean():.4g} to {now.mean():.4g}: {verdict.why}")
            state = _State(total, state.gauge + removed, track, there, [state.origin[n] for n in kept])
            if verdict.better and verdict.gain >= gained + LEAST_GAIN:
                gained = verdict.gain
                counted = [number for number, origin in enumerate(state.origin) if origin in verdict.kept]
                patches, origins = [state.patches[n] for n in counted], [state.origin[n] for n in counted]
                best = dataclasses.replace(state, patches=patches, origin=origins)
            if largest < STILL * wavelength:
                break
    taken = best.track is not echoes
    if not claimed:
        why = _patches.emptiness(detection)
    elif taken:
        why = f"{metric} fell in all {len(best.patches)} patches"
    else:
        why = f"no correction lowers the {metric} of every patch"
        why += ", and some led beyond a quarter of the wavelength: align_points reaches farther" if beyond else ""
    shift = shifts(best.series, directions)
    before = costs([claimed[number] for number in best.origin], metric)
    report = Report(
        "autofocus", metric, bool(claimed), taken, why, np.array([before, costs(best.patches, metric)]),
        np.array([patch.centre for patch in best.patches]).reshape(-1, 3), detection.contrast, shift, np.zeros(echoes.n_ping),
        float(np.max(np.linalg.norm(shift, axis=1))), best.gauge, names, _patches.share_seen(best.patches, echoes.n_ping),
        looked, time.perf_counter() - began, tuple(told),
    )  # fmt: skip
    return best.track, report


@dataclass(frozen=True)
class _State:
    """A track that was tried: displacements, what was taken out of them, and patches, each with its number at first."""

    series: FloatArray
    gauge: FloatArray
    track: Echoes
    patches: list[Patch]
    origin: list[int]


def _peak(patch: Patch, delta: FloatArray, k: FloatArray) -> FloatArray:
    """Where a patch is to be once its pings are moved by delta: about the brightest pixel, if that is no longer near its
    centre. Pixels keep their places beside the peak as long as they may: entropies of two samplings of one peak differ."""
    first, second = (np.exp(-1j * (k * np.sum(turn * delta, axis=1))[:, None] * patch.offsets) for turn in patch.turns)
    first = first * np.exp(-1j * k * np.sum(patch.look * delta, axis=1))[:, None]
    image = np.abs(np.einsum("pxy,px,py->xy", patch.terms, first, second, optimize=True))
    at = patch.offsets[list(np.unravel_index(int(np.argmax(image)), image.shape))]
    if np.max(np.abs(at)) <= CENTRED * patch.offsets[-1]:
        return patch.centre
    return patch.centre + at @ patch.steps


def _levels(echoes: Echoes, knots: Any, harmonics: Any) -> list[int]:
    """Numbers of splines, or highest harmonics, coarse to fine."""
    if harmonics is not None:
        highest = _checks.whole("harmonics", harmonics, low=2, high=echoes.n_ping // 2)
        return [n for n in FIRST_HARMONICS if n < highest] + [highest]
    if knots is None:
        return [count for count in KNOTS if count <= echoes.n_ping]
    if isinstance(knots, str) or not isinstance(knots, Sequence) or not knots:
        raise TypeError(f"knots={knots!r}: expected a sequence of numbers of splines")
    return [_checks.whole("knots", count, low=ORDER + 1, high=echoes.n_ping) for count in knots]


def _basis(
    level: int, round_: bool, directions: list[FloatArray], middle: FloatArray, seen: _patches.Int
) -> tuple[_Basis, str]:  # fmt: skip
    """Functions of the ping, of those that are seen and the same beyond, and what they are called."""
    if round_:
        return _Basis(_waves(angles(middle), level), directions), f"harmonics 2 to {level}"
    at = _patches.held(seen, len(middle)).astype(np.float64)
    return _Basis(_splines(at, level), directions), f"{level} knots"
