"""One scene through every engine, method and instruction set, judged by two oracles.

An image is kept (within tol), refused by a ValueError that says a stated reason, or broken; nothing else is allowed.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import c_library
import numpy as np
import promise_oracle as oracle
from promise_scenes import Scene

import pysas
from pysas.engine import native
from pysas.planning.fallback import trees

EVALUATIONS = 4e6  # of W's kernel for a scene's pixels, unless their least number asks for more
PIXELS = (24, 60)
CONFIRMED = 1e9  # evaluations spent on all pixels of a grid before it is said to be broken
LEAST_TREE = 3e-5  # tolerance of a tree
# what a ValueError may say
REASONS = ("at best", "expected all terms to go through the tree", "too bright for trees")
TOLERANCE = 2  # the C library's code for a tolerance that it cannot keep


@dataclass(frozen=True)
class Way:
    """How an image is made. engine: "numba", "cpp" or "c"; method: "mixed" is trees beside direct sums, whatever they cost."""

    engine: str
    method: str
    isa: str = ""

    def __str__(self) -> str:
        return " ".join(part for part in (self.engine, self.isa, self.method) if part)


@dataclass(frozen=True)
class Outcome:
    """verdict: "kept", "told" (missed, by no more than the report says), "refused", "none" (no such tree) or "broken"."""

    seed: int
    way: str
    verdict: str
    ratio: float = 0.0
    words: str = ""
    share: float = 0.0
    seconds: float = 0.0


def ways(scene: Scene, everything: bool) -> list[Way]:
    """All ways, or a share of them that the seed draws."""
    levels = tuple(native.core().levels()) if native.extension() else ()
    methods = ("backproject", "focus", "ffbp", "mixed")
    found = [Way("cpp", method, isa) for isa in levels for method in methods]
    found += [Way("numba", method) for method in methods]
    if levels and _expressible(scene):
        found += [Way("c", method, isa) for isa in levels for method in ("backproject", "ffbp")]
    if scene.tol < LEAST_TREE:
        found = [way for way in found if way.method not in ("ffbp", "mixed")]
    if everything:
        return found
    rng = np.random.default_rng([scene.seed, 7])
    isa = levels[int(rng.integers(len(levels)))] if levels else ""
    numba, c = not levels or rng.random() < 0.25, rng.random() < 0.5
    taken = {"cpp": True, "numba": numba, "c": c}
    chosen = [way for way in found if taken[way.engine] and way.isa in ("", isa)]
    return [way for way in chosen if way.method not in ("focus", "mixed") or rng.random() < 0.4]


def _expressible(scene: Scene) -> bool:
    """Whether `c_library` can say it: no complex or pixels' own weights, no traces to leave out."""
    real = scene.weights is None or (isinstance(scene.weights, np.ndarray) and scene.weights.dtype.kind == "f")
    return real and scene.nan == "raise"


@dataclass
class Truth:
    """What the oracles say at some pixels of a scene, and what is known of the whole."""

    scene: Scene
    pixels: np.ndarray
    image: np.ndarray
    level: np.ndarray
    apart: float  # of the two oracles, by the scene's norm; 0 where they were not compared
    silent: bool  # no term counts at any pixel

    def error(self, found: np.ndarray) -> float:
        return _error(found.reshape(-1)[self.pixels], self.image, self.level)


def _error(found: np.ndarray, image: np.ndarray, level: np.ndarray) -> float:
    """Relative error of the promise; formed of values scaled to 1, whose squares neither overflow nor vanish."""
    top = max(float(np.max(np.abs(image), initial=0)), float(np.max(level, initial=0)))
    found = found.astype(np.complex128)
    if top == 0:
        return 0.0 if not found.any() else math.inf
    if not np.isfinite(found).all():
        return math.inf
    norm = max(np.linalg.norm(image / top), np.linalg.norm(level / top))
    return float(np.linalg.norm(found / top - image / top) / norm)


def _prepared(scene: Scene) -> tuple[pysas.Echoes, np.ndarray]:
    """Echoes whose traces left out are zeros, and the (ping, channel) weights of the others."""
    echoes = scene.echoes
    traces = echoes.traces
    at, valid = np.arange(echoes.n_sample), _recorded(scene)
    inside = (at >= valid[..., :1]) & (at <= valid[..., 1:])
    finite = (np.isfinite(traces) | ~inside).all(axis=2)
    weights = np.ones(finite.shape, complex)
    if isinstance(scene.weights, np.ndarray):
        weights = weights * (scene.weights if scene.weights.ndim == 2 else scene.weights[:, None])
    weights[~finite] = 0
    data = np.where(finite[..., None] & inside, traces, 0).astype(np.complex128).reshape(echoes.data.shape)
    return echoes.replace(data=data, valid=valid if echoes.data.ndim == 3 else valid[:, 0]), weights


def _recorded(scene: Scene) -> np.ndarray:
    """(ping, channel, 2) first and last sample that count, without NaN at the ends where these are masked."""
    valid = np.zeros((*scene.echoes.traces.shape[:2], 2), dtype=int) + np.array([0, scene.echoes.n_sample - 1])
    if scene.echoes.valid is not None:
        valid[...] = scene.echoes.valid if scene.echoes.valid.ndim == 3 else scene.echoes.valid[:, None]
    if scene.nan == "mask":
        for ping, channel in np.ndindex(valid.shape[:2]):
            first, last = valid[ping, channel]
            good = np.isfinite(scene.echoes.traces[ping, channel])
            while first < last and not good[first]:
                first += 1
            while first < last and not good[last]:
                last -= 1
            if good[first : last + 1].all():
                valid[ping, channel] = first, last
    return valid


def _direct(scene: Scene, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    echoes, weights = _prepared(scene)
    points = scene.grid.coordinates(pixels)
    if isinstance(scene.weights, str):
        weights = weights[None] * pysas.circular.view_weights(echoes, scene.grid, pixels)
    peak = float(np.max(np.abs(echoes.data)))  # whose square may be no number
    shift = int(np.frexp(peak)[1]) if not 1e-100 < peak < 1e100 else 0
    parts = [np.ldexp(part, -shift) for part in (echoes.data.real, echoes.data.imag)]
    image, level, sure = oracle.direct_sum(echoes.replace(data=parts[0] + 1j * parts[1]), points, weights)
    return np.ldexp(image.real, shift) + 1j * np.ldexp(image.imag, shift), np.ldexp(level, shift), sure


def truth(scene: Scene, both: bool = True) -> Truth:
    """Of the second oracle; `both` : compared with the reference, which costs more."""
    echoes, weights = _prepared(scene)
    grid = scene.grid
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    number = int(np.clip(EVALUATIONS / echoes.data.size, *PIXELS))
    rng = np.random.default_rng([scene.seed, 11])
    pixels = np.sort(rng.choice(wanted, min(number, wanted.size), replace=False))
    image, level, sure = _direct(scene, pixels)
    pixels, image, level = pixels[sure], image[sure], level[sure]
    apart = 0.0
    if both and not isinstance(scene.weights, str):
        apart = _error(pysas.reference.exact(echoes, grid, pixels, weights)[0], image, level)
    silent = not level.any() and not oracle.any_term(echoes, grid.coordinates(wanted), weights != 0)
    return Truth(scene, pixels, image, level, apart, silent)


def confirmed(scene: Scene, found: np.ndarray) -> float:
    """The error over the whole grid, or as many of its pixels as can be afforded: what the promise speaks of."""
    wanted = np.arange(scene.grid.size) if scene.grid.mask is None else np.flatnonzero(scene.grid.mask)
    number = int(max(100, CONFIRMED / scene.echoes.data.size))
    if number < wanted.size:
        wanted = np.sort(np.random.default_rng(scene.seed).choice(wanted, number, replace=False))
    image, level, sure = _direct(scene, wanted)
    return _error(found.reshape(-1)[wanted][sure], image[sure], level[sure])


@contextmanager
def _forced(way: Way) -> Iterator[None]:
    """An instruction set by the environment; trees at any cost for "mixed"."""
    with mock.patch.dict(os.environ, {"PYSAS_ISA": way.isa} if way.isa else {}):
        if way.method != "mixed":
            yield
            return
        with mock.patch("pysas.engine.cpp.TREES_MUST_PAY", False), mock.patch.object(trees, "LEAST", 1):
            yield


def image(scene: Scene, way: Way) -> tuple[np.ndarray, Any]:
    """The image and its report, or None for C's."""
    with _forced(way):
        if way.engine == "c":
            return _by_c(scene, way)
        call: Callable[..., Any] = {"backproject": pysas.backproject, "focus": pysas.focus}.get(way.method, pysas.ffbp)
        more = {} if way.method in ("backproject", "focus") else {"fallback": way.method == "mixed"}
        made = call(
            scene.echoes, scene.grid, scene.tol, threads=1 + scene.seed % 2, backend=way.engine, weights=scene.weights,
            nan=scene.nan, **more,
        )  # fmt: skip
        return made.data, made.report


class Refused(ValueError):
    """The C library's code for a tolerance that cannot be kept."""


def _by_c(scene: Scene, way: Way) -> tuple[np.ndarray, Any]:
    echoes, grid = scene.echoes, scene.grid
    weights = None
    if scene.weights is not None:
        full = scene.weights if scene.weights.ndim == 2 else scene.weights[:, None]
        weights = np.ascontiguousarray(np.broadcast_to(full, (echoes.n_ping, echoes.n_channel)))
    found = c_library.call(
        echoes, grid, scene.tol, method=int(way.method == "ffbp"), isa=way.isa, threads=1 + scene.seed % 2, weights=weights
    )
    if found.code == TOLERANCE:
        raise Refused("at best: code 2 of the C library")
    if found.code:
        raise RuntimeError(f"code {found.code} of the C library")
    return found.image, found


def judge(scene: Scene, known: Truth, way: Way) -> Outcome:
    """What became of a scene by one way."""
    begun = time.perf_counter()

    def outcome(verdict: str, ratio: float = 0.0, words: str = "", share: float = 0.0) -> Outcome:
        return Outcome(scene.seed, str(way), verdict, ratio, words, share, time.perf_counter() - begun)

    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            found, report = image(scene, way)
        except ValueError as error:
            if not any(reason in str(error) for reason in REASONS):
                return outcome("broken", math.inf, f"ValueError: {error}")
            return outcome("none" if way.method == "ffbp" and "tree" in str(error) else "refused", 0.0, str(error))
        except Exception as error:
            return outcome("broken", math.inf, f"{type(error).__name__}: {error}")
    share = float(getattr(report, "factorised_share", 0.0))
    if way.engine == "c" and way.method == "ffbp" and share == 0:
        return outcome("none")  # the same sum as by "backproject"
    notes = [str(w.message) for w in heard] + list(getattr(report, "notes", ()))
    if scene.grid.mask is not None and found[~scene.grid.mask].any():
        return outcome("broken", math.inf, "pixels that are masked are not zero", share)
    if known.silent and not notes and way.engine != "c":
        return outcome("broken", math.inf, "no term was left, and nobody said so", share)
    if not np.isfinite(found).all():
        return outcome("broken", math.inf, "the image is not finite", share)
    ratio = known.error(found) / scene.tol
    if ratio > 1:
        ratio = confirmed(scene, found) / scene.tol
    if ratio <= 1:
        return outcome("kept", ratio, "", share)
    said = getattr(report, "predicted_error", None) or 0.0
    if scene.lenient and notes and ratio * scene.tol <= said:
        return outcome("told", ratio, notes[-1], share)
    return outcome("broken", ratio, f"predicted {said / scene.tol:.2g}; notes {notes}" if report is not None else "", share)


def steps(scene: Scene, everything: bool = False) -> Iterator[str | Outcome]:
    """All outcomes of a scene, each after the name of the way that is begun."""
    yield "oracles"
    known = truth(scene, everything or scene.seed % 3 == 0)
    # float64 turns of phase: 1e-16 of the path in wavelengths, a few times
    if known.apart > max(0.1 * scene.tol, 1e-11):
        words = f"the oracles differ by {known.apart:.2g}"
        yield Outcome(scene.seed, "oracles", "broken", known.apart / scene.tol, words)
    for way in ways(scene, everything):
        yield str(way)
        yield judge(scene, known, way)


def trial(scene: Scene, everything: bool = False) -> list[Outcome]:
    """All outcomes of a scene."""
    return [step for step in steps(scene, everything) if isinstance(step, Outcome)]
