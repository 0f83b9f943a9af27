"""Bright samples that pixels do not read: what they would do to an image, measured when the data arrive, and what is done.

A plan's bounds are relative to the samples that arithmetic meets, tol to those that pixels read. The two agree where both are
alike. They do not beside a bright echo that lies just outside the grid, within the reach of an interpolation filter or of a
tree's; nor after a record's hard end that cuts something bright, whose low-passed trace rings for hundreds of samples. `fit`
compares them at some of the terms, and in every trace at the ends of its record and of what its pixels read. Where they differ
it takes other choices: a direct sum in place of a tree, or tables read from whole records, low-passed by W in float64, through
a filter whose error beside bright samples is that of float64.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _pool as pool
from pysas._checks import ComplexArray, FloatArray
from pysas.engine import MONOSTATIC, Parts, preparation
from pysas.engine.survey import rows_per_task
from pysas.imaging import words
from pysas.imaging.interpreted import Interpreted, Terms
from pysas.planning import bounds
from pysas.planning.fallback import planner
from pysas.planning.raster import Raster
from pysas.planning.scene import distances
from pysas.planning.settings import Choices, reader_of

TERMS = 2**10, 2**12  # looked at, at least and at most; of those between, one of
ONE_OF = 2000
# Of what is measured beyond the plan's bounds: levels that change within a filter's reach leave more than their mean square
# says, by 2.2 beside the tail of a pulse in a band as wide as the filter allows
UNSURE = 3.0
EXCESS = 1.25  # of tol, by which what is known of whole records' tables may exceed it before a person is told
KEPT = ("sub-images", "relief", "view angles")  # errors of a plan that its tables have no part in
BESIDE = "bright samples beside"
TREE = 2.0  # errors of a tree beside bright nodes, in those spread evenly over its reach: 3 at most of 60 scenes
TREE_EXCESS = 1.5  # of tol, by which a tree's may be exceeded: so uncertain is what is measured over its reach
BRIGHTER = 10.0  # squares of what pixels read: samples elsewhere below that are like any others
BLOCK = 64  # terms by which shares of a few neighbouring traces' are told
NOTHING = 0.03  # of the error predicted: the sum of squares hardly changes
PIXELS = 8  # at which what all traces have in common is summed
ENDS = 3  # samples beside a record's first and last that tell how bright it is cut
TRANSFORM = 6.0  # errors of float arithmetic in transforms to and fro, rms, in roundings of the rms of what they transform


@dataclass(frozen=True)
class _Data:
    """Samples (ping, channel, sample), the traces of them that are summed, the first and last sample recorded of each, squares
    of weights, and the unit of samples.

    Weights are in units of the largest, a power of two, by which the samples' is divided.
    """

    samples: ComplexArray
    used: npt.NDArray[np.bool_]
    valid: npt.NDArray[np.int64]
    weight: FloatArray
    scale: float
    engine: Parts
    threads: int

    def mean_squares(self, trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64], reach: int) -> FloatArray:
        return self.engine.mean_squares(self.samples, self.valid, trace, place, reach, self.scale, self.threads)


def fit(plan: Interpreted, samples: ComplexArray, used: npt.NDArray[np.bool_], scale: float) -> Interpreted:
    """The plan that images `samples` within its tol: itself where the levels are as it takes them to be, or another.

    Itself too where no float64 holds the squares of both weights and samples.

    Raises
    ------
    ValueError
        Trees would have to be left, and the plan has no leave for that.
    """
    if not used.any():
        return plan
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _fit(plan, samples, used, scale)


def _fit(plan: Interpreted, samples: ComplexArray, used: npt.NDArray[np.bool_], scale: float) -> Interpreted:
    terms = terms_of(plan)
    keep = used[terms.trace]
    some = dataclasses.replace(terms, trace=terms.trace[keep], place=terms.place[keep], power=terms.power[keep])
    if not some.trace.size:
        return plan
    traces = samples if samples.ndim == 3 else samples[:, None, :]
    data = _Data(traces, used, plan.scene.valid, *_weighed(plan.scene.weights, used, scale), plan.engine, plan.threads)
    weight = data.weight[some.trace] * some.power
    own = math.sqrt(np.mean(weight * data.mean_squares(some.trace, some.place, 1)))
    ends = _ends(plan, data)
    if not (math.isfinite(own) and np.all(np.isfinite(ends))):
        return plan
    asked = plan
    if plan.forest is not None:
        reach = plan.forest.reach
        beside = weight * data.mean_squares(some.trace, some.place, reach)
        excess = math.sqrt(max(float(np.mean(beside)) - own**2, _outside(plan, data, reach, own)))
        squares = np.zeros(some.trace.size)
        for side, distance in enumerate(_from_ends(plan, some)):
            # what rings has frequencies that sub-images have no nodes for; pixels nearer to an end do not go through them.
            # Ends about as bright as what pixels read are in the tree's own bounds
            brighter = np.maximum(ends[side, some.trace] - BRIGHTER * own**2, 0)
            squares += brighter * bounds.ringing(np.maximum(distance, reach), plan.scene.band) ** 2
        wrong = TREE * math.hypot(plan.choices.errors["sub-images"] * excess, math.sqrt(np.mean(squares)))
        if not math.isfinite(wrong):
            return asked
        if wrong > (TREE_EXCESS * plan.budget - _predicted(plan)) * own:
            plan = _direct(plan)
    alike = functools.cache(lambda: _alike(asked, data) if np.max(ends) > BRIGHTER * own**2 else 1.0)
    error, planned = _measured(plan, data, some, own, ends, alike)
    if not math.isfinite(error):
        return asked
    if error <= (planned + (plan.budget - _predicted(plan)) / UNSURE) * own:
        return plan
    brighter = math.sqrt(np.max(ends) * alike()) / own if own > 0 else 1e12
    plan = _wide(plan, brighter)
    error, planned = _measured(plan, data, some, own, ends, alike)
    most, level = planned + EXCESS * plan.budget - _predicted(plan), own
    if error > most * own:  # what rings at the pixels is in the image as well
        level = math.sqrt(max(_low_passed(plan, data, some) - error**2, own**2))
    if error <= most * level or level == 0 or not math.isfinite(error / level):
        return plan
    return _with(plan, dataclasses.replace(plan.choices, errors=plan.choices.errors | {BESIDE: error / level}))


def _weighed(weights: ComplexArray, used: npt.NDArray[np.bool_], scale: float) -> tuple[FloatArray, float]:
    """Squares of weights in units of the largest used, a power of two, and `scale` divided by it."""
    parts = np.stack([weights.real, weights.imag])
    top = int(np.frexp(np.max(np.abs(parts[:, used])))[1])
    limits = np.finfo(np.float64)
    unit = float(np.clip(np.ldexp(scale, -top), limits.tiny, limits.max))
    return np.asarray(np.sum(np.ldexp(parts, -top) ** 2, axis=0)), unit


def _predicted(plan: Interpreted) -> float:
    """The part of the predicted error that is the budget's: weights uniform in view angle have a share of tol beside it."""
    errors = plan.choices.errors
    return plan.choices.predicted_error - errors.get("view angles", 0.0)


def notes(plan: Interpreted) -> tuple[list[str], list[str]]:
    """What a person should know of a plan that `fit` took in place of another; and be warned of, where it does not keep its
    budget."""
    found, warned = [], []
    if plan.choices.wide:
        found.append(words.WIDE)
    if _predicted(plan) > plan.budget * (1 + 1e-9):
        warned.append(words.not_promised(plan.tol, plan.choices.predicted_error))
    return found, warned


def terms_of(plan: Interpreted) -> Terms:
    """Some of a plan's terms, from all traces in turn; found once."""
    if plan.terms is None:
        scene = plan.scene
        heard = np.flatnonzero(scene.heard if scene.pixels else np.zeros_like(scene.heard))
        count = int(np.clip(scene.traces * scene.pixels / ONE_OF, *TERMS))
        pixels = scene.drawn
        each = max(1, min(len(pixels), -(-count // max(heard.size, 1))))
        # pixels in turn: neighbouring traces have different ones
        pick = np.random.default_rng(1).permutation(len(pixels))
        pick = pick[(np.arange(heard.size)[:, None] * each + np.arange(each)) % max(len(pixels), 1)]
        index, share = scene.read(heard, pixels, pick)
        lit = share > 0
        trace, place = np.broadcast_to(heard[:, None], lit.shape)[lit], np.rint(index[lit]).astype(np.int64)
        plan.terms = Terms(trace, place, share[lit] ** 2, heard, _edges(plan, heard))
    return plan.terms


def _edges(plan: Interpreted, heard: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Least and largest place (2, trace) that a pixel in the grid's box reads: at its nearest point, and in a corner."""
    scene = plan.scene
    at = scene.trace.take(heard)
    if scene.kind == MONOSTATIC:
        low, high = ((2 * away / at["c"] - at["t0"]) * scene.fs for away in distances(at["tx"], scene.low, scene.high))
        return np.asarray(np.clip(np.stack([np.floor(low), np.ceil(high)]), -1, scene.n_sample), dtype=np.int64)
    corners = np.array(sorted(set(itertools.product(*zip(scene.low, scene.high, strict=True)))))
    pixels = np.concatenate([corners, np.clip((at["tx"] + at["rx"]) / 2, scene.low, scene.high)])
    pick = np.tile(np.arange(len(corners) + 1), (heard.size, 1))
    pick[:, -1] += np.arange(heard.size)
    index, _ = scene.read(heard, pixels, pick)
    edges = np.stack([np.floor(index.min(axis=1)), np.ceil(index.max(axis=1))])
    return np.asarray(np.clip(edges, -1, scene.n_sample), dtype=np.int64)


def _ends(plan: Interpreted, data: _Data) -> FloatArray:
    """Twice the mean squares (2, trace) of samples at the first and the last end of all used traces, weighed."""
    number = np.flatnonzero(data.used)
    out = np.zeros((2, data.used.size))
    for side, place in enumerate(plan.scene.valid.T):
        found = data.mean_squares(number, place[number], ENDS) * 2 * (2 * ENDS + 1) / (ENDS + 1)
        out[side, number] = data.weight[number] * found
    return out


def _from_ends(plan: Interpreted, some: Terms) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Samples that terms lie from the first and from the last one recorded."""
    first, last = plan.scene.valid[some.trace].T
    return some.place - first, last - some.place


def _outside(plan: Interpreted, data: _Data, reach: int, own: float) -> float:
    """Mean square, over the terms, of bright samples within `reach` of them just outside what pixels read, in all traces.

    A term near an edge reaches up to `reach` samples beyond, one in 2 `reach` + 1 each; how many terms are so near is told by
    some of the terms, of blocks of neighbouring traces.
    """
    terms, half = terms_of(plan), reach // 2
    kept = data.used[terms.heard]
    number, bright = terms.heard[kept], []
    for edge, out in zip(terms.edges, (-1, 1), strict=True):
        found = data.mean_squares(number, edge[kept] + out * (half + 1), half) * ((2 * half + 1) / (2 * reach + 1))
        bright.append(np.maximum(data.weight[number] * found - BRIGHTER * own**2, 0))
    if not any(np.any(found) for found in bright):
        return 0.0
    blocks = max(1, min(terms.trace.size // BLOCK, terms.heard.size))
    block = np.arange(terms.heard.size) * blocks // terms.heard.size
    rank = np.searchsorted(terms.heard, terms.trace)
    traces, count = np.bincount(block, minlength=blocks), np.bincount(block[rank], minlength=blocks)
    total = 0.0
    for edge, out, found in zip(terms.edges, (-1, 1), bright, strict=True):
        near = np.bincount(block[rank], (edge[rank] - terms.place) * out <= reach, minlength=blocks)
        each = ((near + 1) * count / (count + 2) / traces)[block[kept]]  # the likely number of terms so near
        total += float(np.sum(each * found))
    return total / terms.trace.size


def _low_passed(plan: Interpreted, data: _Data, some: Terms) -> float:
    """Mean square of what pixels read of whole records low-passed by W: what rings of bright samples elsewhere included."""
    number, n_sample = np.unique(some.trace), plan.scene.n_sample
    n_fft = scipy.fft.next_fast_len(2 * n_sample)
    transfer = preparation.low_pass(scipy.fft.fftfreq(n_fft))
    at_once = rows_per_task(n_fft)
    squares = np.zeros(some.trace.size)

    def measure(task: int) -> None:
        part = number[task * at_once : (task + 1) * at_once]
        begin, end = np.searchsorted(some.trace, [part[0], part[-1] + 1])
        with np.errstate(over="ignore", invalid="ignore"):
            whole = data.samples[np.divmod(part, data.samples.shape[1])].astype(np.complex128) / data.scale
            at, (first, last) = np.arange(n_sample), data.valid[part].T[..., None]
            whole[(at < first) | (at > last)] = 0
            spectrum = scipy.fft.fft(whole, n_fft, axis=-1, workers=1) * transfer
            smooth = scipy.fft.ifft(spectrum, axis=-1, workers=1)
            squares[begin:end] = np.abs(smooth[np.searchsorted(part, some.trace[begin:end]), some.place[begin:end]]) ** 2

    pool.run(measure, -(-number.size // at_once), data.threads)
    return float(np.mean(data.weight[some.trace] * some.power * squares))


def _measured(
    plan: Interpreted, data: _Data, some: Terms, own: float, ends: FloatArray, alike: Callable[[], float]
) -> tuple[float, float]:
    """Error, in units of the data's scale, that a plan's tables make of the terms; and what of it is in its bounds.

    `alike` : times the power that bright ends have in an image.
    """
    c, scene, weight = plan.choices, plan.scene, data.weight[some.trace] * some.power
    planned = 0.0 if c.wide else c.errors["interpolation"]  # in whole records' tables it is wrong by what is read itself
    # transforms' polynomials are wrong by what they read
    squares = planned**2 * weight * data.mean_squares(some.trace, some.place, 1)
    start = scene.first - 1 - c.margin
    within = (start + c.taper <= scene.valid[:, 0], start + c.length - c.taper > scene.valid[:, 1])
    for side, distance in enumerate(_from_ends(plan, some)):
        # what is not cut away is read as it is, and comes round behind the other end
        kept = within[side][some.trace] if c.taper else True
        distance = np.where(kept, c.n_fft - distance, distance)
        cut = ends[side, some.trace] * some.power
        loudest = float(bounds.ringing(np.min(distance), scene.band)) ** 2 * float(np.max(cut))
        least = (NOTHING * c.predicted_error * own) ** 2
        if loudest * scene.traces <= least:
            continue
        rings = bounds.ringing(distance, scene.band) ** 2
        bright = np.maximum(cut - BRIGHTER * own**2, 0) * rings
        squares += cut * rings
        if float(np.mean(bright)) * scene.traces > least:
            squares += (alike() - 1) * bright
    number = np.flatnonzero(data.used)
    middle = np.full(number.size, scene.n_sample // 2)
    power = np.zeros(data.used.size)
    power[number] = data.mean_squares(number, middle, scene.n_sample) * (2 * scene.n_sample + 1) / scene.n_sample
    single = c.precision == "float32" and not c.wide
    squares += (TRANSFORM * 2.0 ** (-24 if single else -53)) ** 2 * weight * power[some.trace]
    if c.taper:
        for place in (start, start + c.length - c.taper):
            middle = place[some.trace] + c.taper // 2
            cut = data.mean_squares(some.trace, middle, c.taper // 2 + 1)
            squares += math.exp(-2 * c.beta) * weight * cut
    return math.sqrt(np.mean(squares)), planned + c.errors["wrap-round"]


def _alike(plan: Interpreted, data: _Data) -> float:
    """How much more power than of unrelated samples a pixel has of what rings at one sample of all traces, at some pixels.

    A transmit pulse that a record's start cuts is the same in all of them; W rings at about 0.47 of the sample rate.
    """
    scene, pixels = plan.scene, plan.scene.drawn[:PIXELS]
    heard = np.flatnonzero(scene.heard & data.used)
    index, share = scene.read(heard, pixels, np.tile(np.arange(len(pixels)), (heard.size, 1)))
    weight = data.weight[heard, None] * share**2
    place = scene.trace["t0"][heard, None] * scene.fs + index
    most = 1.0
    for frequency in (scene.fc / scene.fs + shift for shift in (-0.47, 0.0, 0.47)):
        total = np.sum(np.sqrt(weight) * np.exp(2j * np.pi * (frequency * place % 1)), axis=0)
        most = max(most, float(np.mean(np.abs(total) ** 2) / np.mean(np.sum(weight, axis=0))))
    return most


def _direct(plan: Interpreted) -> Interpreted:
    """The same without trees."""
    if not plan.fallback:
        raise ValueError(f"fallback=False, tol={plan.tol:g}: samples beside those that pixels read are too bright for trees")
    found = plan.others.get("direct")
    if found is None:
        choices = _named(plan, planner.choose(plan.scene, plan.budget, plan.engine), KEPT[-1:])
        found = _with(plan, choices)
        found.reader = reader_of(choices)
        found.forest = None
        found.why_direct = "samples beside those that pixels read are too bright for trees"
        found.raster = Raster(plan.grid, plan.scene, choices.block)
        plan.others["direct"] = found
    return found


def _wide(plan: Interpreted, ends: float) -> Interpreted:
    """The same with tables from whole records, whose ends are `ends` times as bright as what pixels read."""
    ends = 10.0 ** math.ceil(math.log10(min(max(ends, 1.0), 1e12)))
    name = f"wide {plan.forest is not None} {ends:g}"
    found = plan.others.get(name)
    if found is None:
        settings = planner.choose if plan.forest is None else planner.for_leaves
        found = _with(plan, _named(plan, settings(plan.scene, plan.budget, plan.engine, ends)))
        found.reader = reader_of(found.choices)
        plan.others[name] = found
    return found


def _named(plan: Interpreted, choices: Choices, names: tuple[str, ...] = KEPT) -> Choices:
    """Choices with the errors that they do not know of."""
    kept = {name: error for name, error in plan.choices.errors.items() if name in names}
    return dataclasses.replace(choices, errors=choices.errors | kept)


def _with(plan: Interpreted, choices: Choices) -> Interpreted:
    other = copy.copy(plan)
    other.choices = choices
    return other
