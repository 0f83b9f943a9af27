"""Runs of methods, interleaved, each timed, judged, and stopped where it takes too long."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks, reference
from pysas.comparison.calls import Call
from pysas.comparison.judge import Judge
from pysas.comparison.limit import TooLongError, at_most
from pysas.comparison.rows import Comparison, Row
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image

# many times dearer than the other, in patches that a limit cannot stop midway: tried where it takes at most _CHEAP of the limit
_DEARER = {f"fourier_image, {name}": "fourier_image, gridding" for name in ("frame", "ftcg")}
_CHEAP = 0.1
_SLOW = 0.25  # of the limit: what takes longer is timed once


def compare(
    echoes: Echoes,
    calls: Mapping[tuple[str, str], Call],
    *,
    target: npt.ArrayLike | None = None,
    half: npt.ArrayLike | None = None,
    count: int = 200,
    rounds: int = 3,
    limit: float = 60.0,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Run every call, interleaved, and judge its image against the exact sum.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed and finite: what the images are made of.
    calls : mapping of (method, setting) to callable
        Each takes nothing and returns an Image on a plane or surface grid; `methods` makes some.
    target : (x, y), optional
        Where the cuts cross, m. Default: at the strongest pixel of the first image on each grid.
    half : (x, y), optional
        Half the sides of the box about `target` that random pixels come from, m; given with it. Default: the whole grid.
    count : int
        Random pixels.
    rounds : int
        Counted runs. What takes more than a quarter of `limit` has one.
    limit : float
        Longest run, s. Only the main thread can be stopped; elsewhere a run ends first and is then left out.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; no call that runs (says why the first did not).

    Notes
    -----
    The first run of each call is not counted: it compiles. Each image is judged on its own grid, on pixels nearest to the same
    places: the row and the column through the target, 24 pixels either side, and random ones. Images of range-Doppler and
    chirp scaling have peaks that grow as sqrt(range), not as the sum's: they are multiplied by sqrt(range) and one fitted
    complex factor. A call that raises ValueError, ImportError or MemoryError does not apply and is left out.
    """
    reference.exact(echoes, Grid.points([[0.0, 0.0, 0.0]]), np.empty(0, dtype=np.intp))  # its checks, before the first run
    if not calls:
        raise ValueError("calls: expected at least one")
    count, rounds = _checks.whole("count", count), _checks.whole("rounds", rounds)
    limit = _checks.number("limit", limit, positive=True)
    if (target is None) != (half is None):
        raise ValueError(f"target={target!r}, half={half!r}: expected both or neither")
    box = None if target is None else (_checks.reals("target", target, [(2,)]), _checks.reals("half", half, [(2,)]))
    judge, steps = Judge(echoes, box, count), len(calls) * (1 + rounds)
    found: dict[tuple[str, str], tuple[float, dict[str, Any]]] = {}
    left_out: dict[str, str] = {}
    warned: dict[str, str] = {}

    def tell(done: int) -> None:
        if progress is not None:
            progress(done / steps)

    late: set[tuple[str, str]] = set()
    for number, (key, call) in enumerate(calls.items()):
        if (less := (_DEARER.get(key[0], ""), key[1])) in late:
            left_out[", ".join(key)] = f"not tried: {less[0]}, many times cheaper, takes more than {_CHEAP * limit:g} s"
            continue
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                image, first = _timed(call, limit)
        except (ValueError, ImportError, MemoryError, TooLongError) as error:
            left_out[", ".join(key)] = str(error) or type(error).__name__
            if isinstance(error, TooLongError):
                late.add(key)
        else:
            if caught:
                warned[", ".join(key)] = "; ".join(dict.fromkeys(str(w.message) for w in caught))
            if first > _CHEAP * limit:
                late.add(key)
            found[key] = first, judge.judged(key[0], image)
            del image
        tell(number + 1)
    times: dict[tuple[str, str], list[tuple[float, float, float]]] = {key: [] for key in found}
    for repeat in range(rounds):
        for number, key in enumerate(calls):
            if key in found and not (times[key] and found[key][0] > _SLOW * limit):
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        image, seconds = _timed(calls[key], limit)
                except TooLongError as error:  # the first run was just below the limit
                    left_out[", ".join(key)] = str(error)
                    del found[key]
                else:
                    times[key].append((seconds, image.report.prepare_seconds, image.report.sum_seconds))
                    del image
            tell(len(calls) * (1 + repeat) + number + 1)
    if not found:
        name, reason = next(iter(left_out.items()))
        raise ValueError(f"calls: none runs; {name}: {reason}")
    traces = echoes.n_ping * echoes.n_channel
    rows = []
    for key, (_, judged) in found.items():
        total, prepare, summed = np.array(times[key]).T
        seconds = float(np.median(total))
        rows.append(
            Row(
                *key, seconds, float(total.min()), float(total.max()), len(total), float(np.median(prepare)),
                float(np.median(summed)), terms_per_second=traces * float(np.prod(judged["shape"])) / seconds, **judged,
            )
        )  # fmt: skip
    first_answer = next(iter(judge.known.values()))
    irw, pslr = first_answer.response(first_answer.exact)
    return Comparison(traces, echoes.n_sample, first_answer.grid.shape, irw, pslr, tuple(rows), left_out, warned)


def _timed(call: Call, limit: float) -> tuple[Image, float]:
    clock = time.perf_counter()
    with at_most(limit):
        image = call()
    seconds = time.perf_counter() - clock
    if seconds > limit:  # what could not be stopped
        raise TooLongError(f"longer than {limit:g} s")
    if not isinstance(image, Image):
        raise TypeError(f"calls: found {type(image).__name__} returned: expected pysas.Image")
    if image.grid.kind not in ("plane", "surface"):
        raise ValueError(f"grid: expected a plane or a surface, found {image.grid.kind}")
    return image, seconds
