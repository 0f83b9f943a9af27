"""Bright points: a track from the travel times of a few points' echoes, ping against ping, by one least squares of all.

Of a point n the echo of ping p comes earlier or later than the claimed track says by e_p = u_p.(e_n - delta_p) of slant range,
where delta_p is the track's error and e_n the place's. Base-band correlation of two pings' slices of range gives e_q - e_p
without a limit of half a wavelength: its envelope says which turn of phase is meant.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.contributions import contributions
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.motion import patches as _patches
from pysas.motion.moving import centres, moved, scaled
from pysas.motion.patches import Int, Patch, looks, moved_place, shifts, wave_numbers, without_gauge
from pysas.motion.results import Report

REACH = 0.35  # m of slant range to either side of a point, or eight cells where these are larger
FINER = 16  # of the correlation's envelope
ALIKE = 0.02  # nats of the cost's mean: a step that raises it by no more is gone on from, as it may lead on
STIFF = 3.0  # ties of a ping to the ping before, beside those to 0
CAUCHY = 4.0  # standard deviations
LEAST_SIGMA = 1e-6  # m
LEAST_POWER = 1e-300  # what powers are divided by, if they are 0
REWEIGHTED = 6  # times
WINDOWS = (0.0, 1.0, 2.0, 4.0, 8.0)  # pings: standard deviations of what smooths slices along pings, of which the best is kept
NARROW = 3.0  # cells: half of what a slice holds once a first solution has brought the points near their places
SAME = 8.0  # cells: points nearer to each other than this are one
COMPONENTS = ("surge", "sway", "heave", "yaw")
METRIC = "sharpness"  # by which tracks are compared: the likeliest one makes points brightest
LEAST_TIE = 1e-3  # of unknowns to 0, m per m, beside rows of weight 1; three times as much of surge and heave


@dataclass(frozen=True)
class Slices:
    """Range slices (ping, lag) of one point in the pings that see it, in base-band, and its channels at the point itself."""

    point: FloatArray
    pings: Int
    data: ComplexArray
    lags: FloatArray
    look: FloatArray
    distance: FloatArray
    channels: ComplexArray | None


@dataclass(frozen=True)
class Unknowns:
    """What is sought: of each ping its displacements along `ways` (ping, 3), and its turn where `turns` is; then of each point
    its errors along x and y. `sway` (ping, 3) is what a turn moves the array's ends along."""

    ways: list[FloatArray]
    turns: bool
    sway: FloatArray
    offsets: FloatArray  # (ping, channel) of phase centres ahead of their mean, m

    @property
    def each(self) -> int:
        return len(self.ways) + self.turns

    def of_point(self, number: int, axis: int) -> int:
        return len(self.sway) * self.each + 2 * number + axis


@dataclass(frozen=True)
class Rows:
    """Rows of one kind and point in the least squares: entries (column, value), what they are to give, their weights."""

    entries: list[tuple[Int, FloatArray]]
    wanted: FloatArray
    weight: FloatArray


def cell_of(echoes: Echoes) -> float:
    """Resolution cell of slant range, m."""
    return echoes.mean_speed / (2 * echoes.occupied_bandwidth)


def sliced(
    echoes: Echoes, patches: Sequence[Patch], channels: bool, tol: float, threads: int | None
) -> list[Slices]:  # fmt: skip
    """Slices through the brightest pixel of each patch in the pings that see it: read along each ping's line of sight, where
    travel times are exact, and the carrier taken out."""
    middle = centres(echoes)
    cell = cell_of(echoes)
    step = cell / 1.5
    half = int(np.ceil(max(REACH, 8 * cell) / step))
    lags: FloatArray = np.arange(-half, half + 1, dtype=np.float64) * step
    k = wave_numbers(echoes)
    points = np.array([patch.brightest()[0] for patch in patches])
    pings = [patch.pings for patch in patches]
    sights = [looks(middle[some], point) for point, some in zip(points, pings, strict=True)]
    every, ways = np.concatenate(pings), np.concatenate([look for look, _ in sights])
    places = np.repeat(points, [len(some) for some in pings], axis=0)
    data = _patches.read(echoes, places + lags[0] * ways, step * ways, len(lags), every, tol, threads)
    data = scaled(data * np.exp(-1j * k[every, None] * lags).astype(data.dtype))
    single: ComplexArray | None = None
    if channels:
        count = echoes.n_channel
        trace = (every[:, None] * count + np.arange(count)).reshape(-1, 1).astype(np.int64)
        rows = np.repeat(places, count, axis=0)[:, None]
        single = contributions(echoes, rows, np.concatenate([trace, trace], axis=1), tol=tol, threads=threads)
        single = scaled(single.reshape(-1, count))
    found, start = [], 0
    for point, some, (look, distance) in zip(points, pings, sights, strict=True):
        part = slice(start, start + len(some))
        start += len(some)
        found.append(Slices(point, some, data[part], lags, look, distance, None if single is None else single[part]))
    return found


def delays(first: ComplexArray, second: ComplexArray, step: float, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much farther (m) a point is in each row of `second` than in that of `first`, and the rows' coherence.

    The correlation is interpolated in base-band, where its envelope has no carrier that could alias; the envelope's peak is
    right to a fraction of FINER steps, and the carrier's phase there says the rest.
    """
    n = first.shape[1]
    size = 2 * n
    spectrum = np.fft.fft(second, size) * np.fft.fft(first, size).conj()
    padded = np.zeros((len(first), size * FINER), dtype=spectrum.dtype)
    padded[:, :n], padded[:, -n:] = spectrum[:, :n], spectrum[:, n:]
    correlation = np.fft.ifft(padded) * FINER
    best = np.argmax(np.abs(correlation), axis=1)
    at = correlation[np.arange(len(first)), best]
    metres = step / FINER * np.where(best >= n * FINER, best - size * FINER, best)
    one, other = (np.sum(np.abs(row).astype(np.float64) ** 2, axis=1) for row in (first, second))
    return metres - np.angle(at * np.exp(1j * k * metres)) / k, np.abs(at) / np.maximum(np.sqrt(one * other), LEAST_POWER)


def pair_rows(one: Slices, number: int, k: FloatArray, unknowns: Unknowns, width: float, reach: float) -> Rows:
    """Rows of a point's consecutive pings: e_q - e_p, with slices smoothed along pings (what turns from ping to ping goes, as
    clutter beside the point does) and cut to `reach`."""
    data = one.data * (np.abs(one.lags) <= reach)
    if width > 0:
        data = scipy.ndimage.gaussian_filter1d(data, width, axis=0, mode="nearest")
    early = np.flatnonzero(np.diff(one.pings) == 1)
    p = one.pings[early]
    farther, coherence = delays(data[early], data[early + 1], one.lags[1] - one.lags[0], k[p])
    peak = np.max(np.abs(data), axis=1).astype(np.float64)
    before, after = one.look[early], one.look[early + 1]
    entries = []
    for c, way in enumerate(unknowns.ways):
        entries.append(((p + 1) * unknowns.each + c, -np.sum(after * way[p + 1], axis=1)))
        entries.append((p * unknowns.each + c, np.sum(before * way[p], axis=1)))
    for axis in range(2):
        entries.append((np.full(len(p), unknowns.of_point(number, axis)), (after - before)[:, axis]))
    return Rows(entries, farther, coherence**2 * _relative(peak[early] * peak[early + 1]))


def slope_rows(one: Slices, number: int, k: FloatArray, unknowns: Unknowns) -> Rows:
    """Rows of the slope of a point's phase along the array: a turn of the array, or a place off along the track."""
    if one.channels is None:
        raise _checks.InternalError("channels: not read")
    p = one.pings
    offsets = unknowns.offsets[p]
    order = np.argsort(offsets.mean(axis=0))
    channels, offsets = one.channels[:, order], offsets[:, order]
    product = np.sum(channels[:, 1:] * channels[:, :-1].conj(), axis=1)
    spacing = (offsets[:, -1] - offsets[:, 0]) / (offsets.shape[1] - 1)
    arm = np.sqrt(np.mean(offsets**2, axis=1))
    slope = -np.angle(product) / (k[p] * spacing)
    sway = unknowns.sway[p]
    forward = np.stack([sway[:, 1], -sway[:, 0], sway[:, 2]], axis=1)
    turned = -(forward - one.look * np.sum(one.look * forward, axis=1)[:, None]) / one.distance[:, None]
    entries = [(p * unknowns.each + len(unknowns.ways), -arm * np.sum(one.look * sway, axis=1))]
    for axis in range(2):
        entries.append((np.full(len(p), unknowns.of_point(number, axis)), arm * turned[:, axis]))
    return Rows(entries, arm * slope, _relative(np.abs(product)))


def _relative(strength: FloatArray) -> FloatArray:
    return np.asarray(strength.astype(np.float64) / max(float(np.max(strength, initial=0.0)), LEAST_POWER))


def solved(rows: Sequence[Rows], ties: Any) -> tuple[FloatArray, float]:
    """Least squares of rows with Cauchy's weights, each kind's residuals having a standard deviation of their own, and of
    `ties`, sparse rows that are to give 0; returns the solution and the median of the standard deviations, m."""
    row, column, value, group = [], [], [], []
    start = 0
    for number, one in enumerate(rows):
        for index, part in one.entries:
            row.append(start + np.arange(len(index)))
            column.append(index)
            value.append(part)
        group.append(np.full(len(one.wanted), number))
        start += len(one.wanted)
    where = (np.concatenate(row), np.concatenate(column))
    design = scipy.sparse.csr_array((np.concatenate(value), where), shape=(start, ties.shape[1]))
    wanted, weight, kind = (np.concatenate(part) for part in ([r.wanted for r in rows], [r.weight for r in rows], group))
    robust, sigma = np.ones_like(weight), np.ones(len(rows))
    for _ in range(REWEIGHTED):
        relative = (np.median(sigma) / sigma[kind]) ** 2
        total = weight * robust * relative
        normal = design.T @ scipy.sparse.diags_array(total) @ design + ties.T @ ties
        solution = np.asarray(scipy.sparse.linalg.spsolve(normal.tocsc(), design.T @ (total * wanted)))
        rest = (design @ solution - wanted) * np.sqrt(weight)
        sigma = np.array([1.4826 * np.median(np.abs(rest[kind == n])) if np.any(kind == n) else 1.0 for n in range(len(rows))])
        sigma = np.maximum(sigma, LEAST_SIGMA)
        robust = 1 / (1 + (rest / (CAUCHY * sigma[kind])) ** 2)
    return solution, float(np.median(sigma))


@dataclass(frozen=True)
class _State:
    """A track that was tried: displacements along the ways and turns, what was taken out of them, and the points' patches;
    `origin` says which of the first points each goes back to, `cost` what all that were tried cost."""

    series: FloatArray
    turn: FloatArray
    gauge: FloatArray
    track: Echoes
    patches: list[Patch]
    origin: list[int]
    cost: FloatArray


@_checks.usual_errors
def align_points(
    echoes: Echoes,
    grid: Grid,
    points: npt.ArrayLike | None = None,
    components: Sequence[str] = ("sway", "heave"),
    iterations: int = 6,
    velocity: str = "follow",
    tol: float = 1e-2,
    threads: int | None = None,
) -> tuple[Echoes, Report]:
    """Correct a track by the travel times of a few bright points, whatever the size of its error.

    The image of `grid` with the claimed track shows where bright points are, smeared as they may be. Around each a slice of
    range is read in every ping that sees it; base-band correlation of consecutive pings says by how much the point came nearer
    or went farther than claimed, by its envelope and its phase together, and one least squares of all points and pings gives
    the pings' displacements and the points' true places. Slices are smoothed along pings by several windows, against the
    clutter beside a point, and the window is kept whose image is sharpest; then all of it again with the track found.

    Parameters
    ----------
    echoes : Echoes
        Compressed, with the claimed track; 8 pings at least. All channels of a ping are summed at the points, so their
        attitude matters: see `components`.
    grid : Grid
        Where bright points are looked for, sampled as finely as an image; its heights are taken for theirs.
    points : (point, 3), optional
        Places near bright points with their own heights, m, within a patch's half of where the claimed track shows them, in
        place of those that are found in the image.
    components : sequence of "surge", "sway", "heave", "yaw"
        What is sought of each ping: displacements along the array (or the way, of one receiver), across it, along z, and turns
        about the vertical, which the phase along the array says where attitude is unknown. Sway and heave separate by points
        at different ranges: of points at one range ask for one.
    iterations : int
        At most; it ends where the image becomes no sharper.
    velocity : "follow" or "keep"
        Whether the velocity came from the claimed track and so changes with it, or was measured by itself.
    tol : float
        Of what is read, as in `backproject`.
    threads : int, optional
        As in `backproject`.

    Returns
    -------
    fixed : Echoes
        With the track found; the echoes that were given where there is nothing to go by or no patch may be told to be better.
    report : pysas.motion.Report
        What was found, and why it was taken or not. `print` it.

    Raises
    ------
    ValueError, TypeError
        Raw echoes, fewer than 8 pings, pings all at one place or all alike, unknown components, "yaw" alone or of one receiver,
        points that are not (point, 3), what `focus` raises.

    Warns
    -----
    UserWarning
        A grid that no ping sees, as `focus` does.

    Notes
    -----
    A shift of track and scene together and a turn of both about the vertical leave echoes as they are: mean and slope along a
    line are taken out of what was found, on a circle a shift. A point's height that is not the grid's turns part of the track's
    heave into sway: 0.5 to 0.8 m of it cost up to 0.5 dB where sway and heave were 36 mm. Errors from ping to ping of more than
    8 range cells are not found.

    O(pings points) reads, of a slice each, and as many patches of 51 x 51 pixels, five times an iteration; a sparse least
    squares that grows with pings. Memory: 21 kB of complex64 a ping, of one point at a time.

    P. Eichel, D. Ghiglia, C. Jakowatz 1989, Opt. Lett. 14, 1, have the window along the aperture against clutter.
    """
    began = time.perf_counter()
    names = _patches.require(echoes, grid, components, COMPONENTS, velocity)
    iterations = _checks.whole("iterations", iterations)
    given = None if points is None else _checks.reals("points", points, [("point", 3)], ("point",))
    if names == ("yaw",):
        raise ValueError("components: 'yaw' alone: expected displacements beside it")
    if "yaw" in names and echoes.n_channel < 2:
        raise ValueError("components: 'yaw' of one receiver: expected an array of several")
    axes = _patches.axes_of(echoes)
    spread = (echoes.receivers - echoes.receivers.mean(axis=1, keepdims=True)) / 2
    offsets = np.einsum("pcx,px->pc", spread, axes["surge"])
    unknowns = Unknowns([axes[name] for name in names if name != "yaw"], "yaw" in names, axes["sway"], offsets)
    detection = _patches.found(echoes, grid, tol, threads)
    start = _patches.centred(echoes, detection.centres if given is None else given, tol, threads, summed=True)
    kept = [patch for patch in start if patch is not None and (given is None or _patches.stands_out(patch))]
    before = _patches.costs(kept, METRIC)
    nothing = np.zeros((len(unknowns.ways), echoes.n_ping))
    still = np.zeros(echoes.n_ping)
    claimed = _State(nothing, still, np.zeros((len(nothing), 2)), echoes, kept, list(range(len(kept))), before)
    state, best, merged = claimed, claimed, set[int]()
    told: list[str] = []
    solutions = 0
    for iteration in range(iterations if kept else 0):
        slices = sliced(state.track, state.patches, unknowns.turns, tol, threads)
        reach = NARROW * cell_of(echoes) if iteration else np.inf
        tried = [_step(echoes, state, slices, unknowns, velocity, w, reach, tol, threads) for w in WINDOWS]
        solutions += len(tried)
        chosen = min(range(len(tried)), key=lambda n: float(tried[n][1].cost.mean()))
        width, (sigma, following) = WINDOWS[chosen], tried[chosen]
        largest = 1e3 * float(np.max(np.linalg.norm(shifts(following.series - state.series, unknowns.ways), axis=1)))
        said = f"{len(slices)} points, window of {width:g} pings: {largest:.3g} mm at most, sigma {1e3 * sigma:.2g} mm"
        told.append(f"{said}: {METRIC} {state.cost.mean():.4g} to {following.cost.mean():.4g}")
        if not following.cost.mean() < state.cost.mean() + ALIKE:
            break
        state, gone = _distinct(echoes, following)
        merged |= gone
        if gone or best is claimed or state.cost.mean() < best.cost.mean():
            best = state
    state = best
    # those that came to lie where a brighter one is were it all the time
    apart = [number for number in range(len(kept)) if number not in merged]
    now = dict(zip(state.origin, state.patches, strict=True))
    verdict = _patches.judged([kept[n] for n in apart], [now.get(n) for n in apart], METRIC)
    taken = bool(kept) and state.track is not echoes and verdict.better
    why = verdict.why if kept else _patches.emptiness(detection)
    if taken:
        counted = {apart[n] for n in verdict.kept}
        state = _some(state, [n for n, origin in enumerate(state.origin) if origin in counted])
    else:
        state = claimed
    shift = shifts(state.series, unknowns.ways)
    report = Report(
        "align_points", METRIC, bool(kept), taken, why, np.array([before[state.origin], state.cost]),
        np.array([patch.centre for patch in state.patches]).reshape(-1, 3), detection.contrast, shift, state.turn,
        float(np.max(np.linalg.norm(shift, axis=1))), state.gauge, tuple(name for name in names if name != "yaw"),
        _patches.share_seen(state.patches, echoes.n_ping), solutions, time.perf_counter() - began, tuple(told),
    )  # fmt: skip
    return state.track, report


def _step(
    echoes: Echoes, state: _State, slices: Sequence[Slices], unknowns: Unknowns, velocity: str, width: float, reach: float,
    tol: float, threads: int | None,
) -> tuple[float, _State]:  # fmt: skip
    """Standard deviation of the rows, m, and the track that one solution leads to; a point that is lost costs what it did."""
    k, n = wave_numbers(echoes), echoes.n_ping
    rows = [pair_rows(one, number, k, unknowns, width, reach) for number, one in enumerate(slices)]
    if unknowns.turns:
        rows += [slope_rows(one, number, k, unknowns) for number, one in enumerate(slices)]
    ties = [LEAST_TIE if way is unknowns.sway else 3 * LEAST_TIE for way in unknowns.ways] + [LEAST_TIE] * unknowns.turns
    solution, sigma = solved(rows, _ties(ties, n, 2 * len(slices)))
    mine = solution[: n * unknowns.each].reshape(n, unknowns.each).T
    errors = solution[n * unknowns.each :].reshape(-1, 2)
    step, turn = mine[: len(unknowns.ways)], state.turn + (mine[-1] if unknowns.turns else 0.0)
    seen = _patches.seen_by(state.patches)
    total, removed = without_gauge(state.series + step, unknowns.ways, centres(echoes), seen)
    rest = shifts(total - state.series - step, unknowns.ways)
    expected = []
    for one, error in zip(slices, errors, strict=True):
        virtual = Patch(one.point, np.zeros((2, 3)), np.zeros(1), one.pings, one.data, one.look, np.zeros((2, 1, 3)))
        expected.append(moved_place(virtual, one.point + np.array([*error, 0.0]), rest[one.pings]))
    track = moved(echoes, shifts(total, unknowns.ways), turn, velocity)
    again = _patches.centred(track, np.array(expected), tol, threads, summed=True)
    cost, patches, origin = state.cost.copy(), [], []
    for number, patch in enumerate(again):
        if patch is not None:
            cost[number] = _patches.costs([patch], METRIC)[0]
            patches.append(patch)
            origin.append(state.origin[number])
    return sigma, _State(total, turn, state.gauge + removed, track, patches, origin, cost)


def _ties(ties: Sequence[float], n_ping: int, others: int) -> Any:
    """Each ping's unknowns to 0, as no row tells a shift of everything, and ten times as firmly to those of the ping before, so
    that pings that see no point go with their neighbours; the points' errors to 0."""
    each = scipy.sparse.diags_array(np.asarray(ties))
    change = scipy.sparse.eye_array(n_ping - 1, n_ping, k=1) - scipy.sparse.eye_array(n_ping - 1, n_ping)
    pings = scipy.sparse.kron(scipy.sparse.vstack([STIFF * change, scipy.sparse.eye_array(n_ping)]), each)
    return scipy.sparse.block_diag([pings, scipy.sparse.diags_array(np.full(others, LEAST_TIE))]).tocsr()


def _some(state: _State, numbers: Sequence[int]) -> _State:
    """With some of its points."""
    patches = [state.patches[n] for n in numbers]
    origin = [state.origin[n] for n in numbers]
    return dataclasses.replace(state, patches=patches, origin=origin, cost=_patches.costs(patches, METRIC))


def _distinct(echoes: Echoes, state: _State) -> tuple[_State, set[int]]:
    """Without points that came to lie where a brighter one is, and which these were at first."""
    level = np.array([np.max(np.abs(patch.image())) for patch in state.patches])
    order = np.argsort(-level, kind="stable")
    places = np.array([state.patches[i].brightest()[0] for i in order]).reshape(-1, 3)
    kept = sorted(int(order[i]) for i in _patches.spread(places, SAME * cell_of(echoes)))
    return _some(state, kept), set(state.origin) - {state.origin[n] for n in kept}
