"""Bright samples that pixels do not read: what they would do to an image, measured when the data arrive, and what is done.

A plan's bounds are relative to the samples that arithmetic meets, tol to those that pixels read. The two agree where both are
alike. They do not beside a bright echo that lies just outside the grid, within the reach of an interpolation filter or of a
tree's; nor after a record's hard end that cuts something bright, whose low-passed trace rings for hundreds of samples. `fit`
compares them at some of the terms. Where they differ it takes other choices: a direct sum in place of a tree, or tables
read from whole records, low-passed by W in float64, through a filter whose error beside bright samples is that of float64.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import backprojection, bounds
from pysas._checks import ComplexArray, FloatArray
from pysas.choices import WIDE_ERROR, choose, choose_for_leaves
from pysas.engine import native, summation
from pysas.planner import SHARE_LEAVES, SHARE_ROUNDING
from pysas.plans import Choices, Plan

TERMS = 2**10, 2**14  # looked at, at least and at most; of those between, one of
ONE_OF = 2000
EXCESS = 1.25  # of tol, by which bounds may be exceeded before anything is done: what is measured is so uncertain
KEPT = ("sub-images", "relief", "view angles")  # errors of a plan that its tables have no part in
BESIDE = "bright samples beside"
TREE = 2.0  # errors of a tree beside bright nodes, in those spread evenly over its reach: 3 at most of 60 scenes
TREE_EXCESS = 1.5  # as EXCESS: what bright samples pixels do read differs more from what is measured over a tree's reach
ENDS = 3  # samples beside a record's first and last that tell how bright it is cut
TRANSFORM = 6.0  # errors of float arithmetic in transforms to and fro, rms, in roundings of the rms of what they transform


@dataclass(frozen=True)
class Terms:
    """Some of a plan's terms: flat numbers of their traces, and the samples nearest to where pixels read them."""

    trace: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Data:
    """Samples (ping, channel, sample), the traces of them that are summed, and a scale that squares do not overflow in."""

    samples: ComplexArray
    used: npt.NDArray[np.bool_]
    scale: float
    cpp: bool
    threads: int

    def mean_squares(self, trace: npt.NDArray[np.int64], place: npt.NDArray[np.int64], reach: int) -> FloatArray:
        measure = native.mean_squares if self.cpp else summation.mean_squares
        return measure(self.samples, trace, place, reach, self.scale, self.threads)


def fit(plan: Plan, samples: ComplexArray, used: npt.NDArray[np.bool_], scale: float) -> Plan:
    """The plan that images `samples` within its tol: itself where the levels are as it takes them to be, or another."""
    if not used.any():
        return plan
    terms = terms_of(plan)
    keep = used[terms.trace]
    some = Terms(terms.trace[keep], terms.place[keep])
    if not some.trace.size:
        return plan
    data = _Data(samples if samples.ndim == 3 else samples[:, None, :], used, scale, plan.backend == "cpp", plan.threads)
    weight = np.abs(plan.scene.weights[some.trace]) ** 2
    own = math.sqrt(np.mean(weight * data.mean_squares(some.trace, some.place, 1)))
    ends = _ends(plan, data, some)
    if plan.forest is not None:
        reach = _tree_reach(plan)
        beside = weight * data.mean_squares(some.trace, some.place, reach)
        excess = math.sqrt(max(float(np.mean(beside)) - own**2, 0.0))
        squares = np.zeros(some.trace.size)
        for side, distance in ((0, some.place), (1, plan.scene.n_sample - 1 - some.place)):
            # what rings has frequencies that sub-images have no nodes for; pixels nearer to an end do not go through them.
            # Ends about as bright as what pixels read are in the tree's own bounds
            brighter = np.maximum(ends[side, some.trace] - 10 * own**2, 0)
            squares += brighter * bounds.ringing(np.maximum(distance, reach), plan.scene.band) ** 2
        wrong = TREE * math.hypot(plan.choices.errors["sub-images"] * excess, math.sqrt(np.mean(squares)))
        if wrong > (TREE_EXCESS * plan.budget - plan.choices.predicted_error) * own:
            plan = _direct(plan)
    error, planned = _measured(plan, data, some, weight, ends)
    if error <= (EXCESS * plan.budget - plan.choices.predicted_error + planned) * own:
        return plan
    brighter = math.sqrt(np.max(ends)) / own if own > 0 else 1e12
    plan = _wide(plan, brighter)
    if own > 0:
        error, _ = _measured(plan, data, some, weight, ends)
        choices = plan.choices
        plan = _with(plan, dataclasses.replace(choices, errors=choices.errors | {BESIDE: error / own}))
    return plan


def notes(plan: Plan) -> list[str]:
    """What a person should know of a plan that `fit` took in place of another; warns where it does not keep its budget."""
    found = [f"summed directly: {plan.why_direct}"] if plan.forest is None and plan.why_direct else []
    if plan.choices.wide:
        found.append("whole records read in float64: samples beside those that pixels read are bright")
    errors = plan.choices.errors
    if plan.choices.predicted_error > (plan.budget + errors.get("view angles", 0.0)) * (1 + 1e-9):
        text = (
            f"tol={plan.tol:g} is not promised, error {plan.choices.predicted_error:.2g} predicted: float64 cannot tell what "
            "pixels read from the bright samples beside"
        )
        warnings.warn(text, stacklevel=5)
        found.append(text)
    return found


def terms_of(plan: Plan) -> Terms:
    """Some of a plan's terms, from all traces in turn; found once."""
    if plan.terms is None:
        scene = plan.scene
        heard = np.flatnonzero(scene.heard)
        count = int(np.clip(scene.traces * scene.pixels / ONE_OF, *TERMS))
        pixels = scene.drawn
        each = max(1, min(len(pixels), -(-count // max(heard.size, 1))))
        # pixels in turn: neighbouring traces have different ones
        pick = np.random.default_rng(1).permutation(len(pixels))
        pick = pick[(np.arange(heard.size)[:, None] * each + np.arange(each)) % len(pixels)]
        index, lit = scene.read(heard, pixels, pick)
        plan.terms = Terms(np.broadcast_to(heard[:, None], lit.shape)[lit], np.rint(index[lit]).astype(np.int64))
    return plan.terms


def _ends(plan: Plan, data: _Data, some: Terms) -> FloatArray:
    """Twice the mean squares (2, trace) of samples at the first and the last end of all used traces, weighed."""
    n, number = plan.scene.n_sample, np.flatnonzero(data.used)
    weight = np.abs(plan.scene.weights[number]) ** 2
    out = np.zeros((2, data.used.size))
    for side, place in enumerate((0, n - 1)):
        found = data.mean_squares(number, np.full(number.size, place), ENDS) * 2 * (2 * ENDS + 1) / (ENDS + 1)
        out[side, number] = weight * found
    return out


def _tree_reach(plan: Plan) -> int:
    """Samples to each side of a term's that the nodes read for it hold."""
    forest = plan.forest
    if forest is None:
        return 0
    stages = len(forest.layout.fans) + 1
    return math.ceil(stages * forest.layout.taps.reach / float(forest.rate))


def _measured(plan: Plan, data: _Data, some: Terms, weight: FloatArray, ends: FloatArray) -> tuple[float, float]:
    """Error, in units of the data's scale, that a plan's tables make of the terms; and what of it is in its bounds.

    Errors of a filter are spread over its reach.
    """
    c, scene = plan.choices, plan.scene
    planned = 0.0 if c.wide else c.errors["interpolation"]  # in whole records' tables it is wrong by what is read itself
    reach = (c.taps // 2 if not c.n_fft else (c.taps + 3) // 4) + 1
    reach = reach if c.taps else 0
    beside = WIDE_ERROR if c.wide else planned
    squares = np.zeros(some.trace.size)
    if reach:
        squares += beside**2 * weight * data.mean_squares(some.trace, some.place, reach)
    if not reach:  # transforms' polynomials are wrong by what they read
        squares += planned**2 * weight * data.mean_squares(some.trace, some.place, 1)
    hidden = "wrap-round" if "wrap-round" in c.errors else "record's ends"
    start = scene.first - 1 - c.margin
    within = (start + c.taper <= 0, start + c.length - c.taper >= scene.n_sample)
    for side, distance in ((0, some.place), (1, scene.n_sample - 1 - some.place)):
        if c.n_fft:  # what is not cut away is read as it is, and comes round behind the other end
            kept = within[side][some.trace] if c.taper else True
            distance = np.where(kept, c.n_fft - distance, distance)
        squares += ends[side, some.trace] * bounds.ringing(distance, scene.band) ** 2
    if c.n_fft:
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
    return math.sqrt(np.mean(squares)), planned + c.errors.get(hidden, 0.0)


def _direct(plan: Plan) -> Plan:
    """The same without trees."""
    if "direct" not in plan.others:
        choices = _named(plan, choose(plan.scene, plan.budget, plan.backend), KEPT[-1:])
        other = _with(plan, choices)
        other.reader = backprojection.reader_of(choices, plan.scene.band)
        other.forest = None
        other.why_direct = "samples beside those that pixels read are too bright for trees"
        other.frame = backprojection.Frame(plan.grid, plan.scene, choices.block)
        plan.others["direct"] = other
    return plan.others["direct"]


def _wide(plan: Plan, ends: float) -> Plan:
    """The same with tables from whole records, whose ends are `ends` times as bright as what pixels read.

    Without trees where their rate is too low for all that whole records hold.
    """
    ends = 10.0 ** math.ceil(math.log10(min(max(ends, 1.0), 1e12)))
    choices = None
    if plan.forest is not None:
        share = SHARE_LEAVES * plan.budget
        choices = choose_for_leaves(plan.scene, share, plan.backend, SHARE_ROUNDING, plan.forest.rate, ends)
        if choices is None:
            plan = _direct(plan)
    name = f"wide {plan.forest is not None} {ends:g}"
    if name not in plan.others:
        if choices is None:
            choices = choose(plan.scene, plan.budget, plan.backend, ends)
        other = _with(plan, _named(plan, choices))
        other.reader = backprojection.reader_of(other.choices, plan.scene.band)
        plan.others[name] = other
    return plan.others[name]


def _named(plan: Plan, choices: Choices, names: tuple[str, ...] = KEPT) -> Choices:
    """Choices with the errors that they do not know of."""
    kept = {name: error for name, error in plan.choices.errors.items() if name in names}
    return dataclasses.replace(choices, errors=choices.errors | kept)


def _with(plan: Plan, choices: Choices) -> Plan:
    other = copy.copy(plan)
    other.choices, other.reported = choices, dataclasses.asdict(choices)
    return other
