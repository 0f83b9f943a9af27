"""Run, resume and verify a survey, in this process or on a Dask cluster."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pysas import __version__, _checks
from pysas._checks import FloatArray
from pysas.formats import files, stores
from pysas.formats.echo_store import open_echoes
from pysas.imaging.words import spoken
from pysas.survey.distributing import Lost, by_client
from pysas.survey.image_store import FAILED, StripHeader, StripStore, SurveyStore, create
from pysas.survey.lines import SurveyPlan
from pysas.survey.sections import Made, close_lines, image_section, made, missing, recorded
from pysas.survey.tiling import StripPlan, require_navigation

Job = tuple[int, int]  # numbers of a strip and of its section


@dataclass
class SurveyReport:
    """What a run did: `print` it.

    Attributes
    ----------
    path : str
        Of the store.
    made : list of Made
        Tiles of this run, failed ones too.
    lost : list of (strip, section, reason)
        What ended with its worker, again and again.
    before, tiles : int
        Tiles that were there already, and all.
    seconds, predicted : float
        Of this run, and what the plan said of all.
    """

    path: str
    tiles: int
    before: int
    predicted: float
    made: list[Made] = field(default_factory=list)
    lost: list[tuple[str, int, str]] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def there(self) -> int:
        """Tiles that are there now."""
        return self.before + len(self.made) - len(self.failed)

    @property
    def failed(self) -> list[Made]:
        """Tiles that could not be made."""
        return [one for one in self.made if one.state == FAILED]

    @property
    def complete(self) -> bool:
        """Whether all tiles are there."""
        return self.there == self.tiles

    def as_dict(self) -> dict[str, Any]:
        """Plain types, ready for JSON."""
        pixels, terms = sum(one.pixels for one in self.made), sum(one.terms for one in self.made)
        return {
            "store": self.path, "version": __version__, "tiles": self.tiles, "made": self.there - self.before,
            "before": self.before, "complete": self.complete, "seconds": self.seconds, "predicted_seconds": self.predicted,
            "pixels": pixels, "terms": terms, "pixels_per_second": pixels / self.seconds if self.seconds else 0.0,
            "failed": [{"strip": one.strip, "tile": one.tile, "reason": one.reason} for one in self.failed],
            "lost": [{"strip": strip, "section": section, "reason": reason} for strip, section, reason in self.lost],
        }  # fmt: skip

    def __str__(self) -> str:
        values = self.as_dict()
        rate = f", {values['pixels_per_second']:.3g} pixels/s" if values["pixels"] else ""
        there = f", {self.before} were there" if self.before else ""
        done = f"{values['made']} of {self.tiles} tiles made in {spoken(self.seconds)}{there}{rate}"
        lines = [f"{self.path}: {done if self.made or self.lost else f'nothing to do, all {self.before} tiles are there'}"]
        reasons: dict[tuple[str, str], list[int]] = {}
        for one in self.failed:
            reasons.setdefault((one.strip, one.reason), []).append(one.tile)
        lines += [f"  failed: {strip}, tiles {spans(tiles)}: {reason}" for (strip, reason), tiles in reasons.items()]
        lines += [f"  lost: {strip}, section {section}: {reason}" for strip, section, reason in self.lost]
        return "\n".join(lines)


def spans(numbers: list[int]) -> str:
    """2, 3, 4, 7 as 2-4, 7."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in found)


def run(
    plan: SurveyPlan, path: str | os.PathLike[str], *, client: Any = None, threads: int | None = None, overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> SurveyReport:  # fmt: skip
    """Image a survey into a store.

    Parameters
    ----------
    plan : SurveyPlan
    path : str or path
        Of the store to write, ends in .zarr.
    client : distributed.Client, optional
        Whose workers make the tiles, one section a process at a time; they must see the same files under the same names. None:
        this process does.
    threads : int, optional
        Of a process; default: all processors, or those of a worker.
    overwrite : bool
        Replace a store that is there; False: it is an error.
    progress : callable, optional
        Is told the share that is done.

    Returns
    -------
    SurveyReport
        Of tiles whose pings cannot be imaged too: they fail, with a reason, and the others go on.

    Raises
    ------
    ValueError, TypeError
        Another suffix or client, something else of that name (echoes too, which nothing would bring back), a line that is read.
    OSError, MemoryError, ConnectionError
        From the file system (a full disk), and where the cluster is gone. `resume` goes on from there.

    Notes
    -----
    Memory: `plan.memory`, whatever the length of the lines. The store is the same, byte by byte, whoever made it and however
    often it was ended and resumed.
    """
    text = begin(plan, path, overwrite=overwrite)
    return resume(text, client=client, threads=threads, progress=progress)


def begin(plan: SurveyPlan, path: str | os.PathLike[str], *, overwrite: bool) -> str:
    """A new store of a plan, without any tile; returns its name."""
    if not isinstance(plan, SurveyPlan):
        raise TypeError(f"plan={type(plan).__name__}: expected what pysas.survey.plan returns")
    text, target = files.name(path), require_place(path, overwrite=overwrite)
    for line in {Path(os.path.realpath(strip.line)) for strip in plan.strips}:
        if target == line or target in line.parents or line in target.parents:
            raise ValueError(f"{text}: is, holds or lies in {line}, which is read by this survey: expected another name")
    header = {
        "version": __version__, "predicted": {"seconds": sum(plan.seconds), "memory": plan.memory, "threads": plan.threads},
    }  # fmt: skip
    with placed(text), stores.replacing(text, overwrite=overwrite, what="images") as folder:
        create(folder, header, [StripHeader(s.name, s.attributes(), s.x, s.y, s.columns) for s in plan.strips])
    return text


def require_place(path: str | os.PathLike[str], *, overwrite: bool) -> Path:
    """Where a store of images of this name goes; raises ValueError or OSError where it cannot."""
    text = files.name(path)
    if Path(text).suffix.lower() != stores.SUFFIX:
        raise ValueError(f"{text}: expected a name that ends in {stores.SUFFIX}")
    try:
        target = stores.check_output(text, overwrite, "images")
    except FileExistsError:
        raise FileExistsError(f"{text}: exists: expected a new name, or --resume or --overwrite") from None
    return target


def resume(
    path: str | os.PathLike[str], *, client: Any = None, threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SurveyReport:  # fmt: skip
    """Make the tiles that a store's plan has and the store has not: those not begun, failed, or found damaged by `verify`.

    Parameters
    ----------
    path : str or path
        Of the store.
    client, threads, progress
        As in `run`.

    Returns
    -------
    SurveyReport

    Raises
    ------
    ValueError
        No such store, one of another version, or lines whose navigation is not what it was planned from.
    TypeError, OSError, MemoryError, ConnectionError
        As `run` raises them.
    """
    _checks.callback("progress", progress)
    if threads is not None:
        threads = _checks.threads(threads)
    store = SurveyStore(path, mend=True)
    plans = plans_of(store)
    for part in [part for strip in store.strips for part in strip.parts()]:
        part.unlink(missing_ok=True)
    jobs: dict[Job, list[int]] = {}  # and the tiles that they lack
    before = 0
    for number, (plan, strip) in enumerate(zip(plans, store.strips, strict=True)):
        for section in range(plan.sections):
            lacking = missing(plan, strip, section)
            before += len(plan.tiles_of(section)) - len(lacking)
            if lacking:
                jobs[number, section] = lacking
    weights = {job: len(lacking) * plans[job[0]].y.size * plans[job[0]].columns for job, lacking in jobs.items()}
    tiles = sum(plan.ready for plan in plans)
    report = SurveyReport(store.path, tiles, before, float(store.header["predicted"]["seconds"]))
    began, whole, done = time.perf_counter(), sum(weights.values()) or 1, 0

    def told(share: float, weight: int) -> None:
        if progress is not None:
            progress((done + share * weight) / whole)

    try:
        with placed(store.path, f"pysas survey --resume -o {store.path} goes on from there"):
            results = (
                _here(store.path, weights, threads, told)
                if client is None
                else by_client(client, store.path, list(jobs), threads, store.header["predicted"]["memory"])
            )
            for job, found in results:
                done += weights[job]
                told(0.0, 0)
                plan, strip = plans[job[0]], store.strips[job[0]]
                if isinstance(found, Lost):
                    report.lost.append((plan.name, job[1], found.reason))
                    found = []
                named = {one.tile for one in found}  # a worker that died told of none of those that it made
                report.made += found + [
                    recorded(strip, tile) for tile in jobs[job] if tile not in named and made(plan, strip, tile)
                ]
    finally:
        close_lines()
    report.seconds = time.perf_counter() - began
    return report


@contextlib.contextmanager
def placed(path: str, note: str = "") -> Iterator[None]:
    """Errors of the file system name the store where they name nothing, as those of writing do; `note` tells how to go on."""
    try:
        yield
    except (OSError, MemoryError, KeyboardInterrupt) as error:
        if isinstance(error, OSError) and error.errno and error.filename is None and not isinstance(error, ConnectionError):
            error.filename = path
        if note:
            error.add_note(note)
        raise


def _here(
    path: str, weights: dict[Job, int], threads: int | None, told: Callable[[float, int], None]
) -> Iterator[tuple[Job, list[Made] | Lost]]:
    for job, weight in weights.items():
        yield job, image_section(path, *job, threads, lambda share, weight=weight: told(share, weight))  # type: ignore[misc]


def plans_of(store: SurveyStore) -> list[StripPlan]:
    """The plans of a store's strips, once lines and version are what they were planned with."""
    if (found := store.header.get("version")) != __version__:
        raise ValueError(f"{store.path}: planned by pysas {found}, this is {__version__}: expected a new survey, --overwrite")
    plans = [plan_of(store, strip) for strip in store.strips]
    for line in dict.fromkeys(plan.line for plan in plans):
        with open_echoes(line) as echoes:
            mine = [plan for plan in plans if plan.line == line]
            for plan in mine:
                require_navigation(plan, echoes.navigation, plan.blocks)
            more = echoes.n_ping - max(plan.blocks[-1].last for plan in mine)
            if more and mine[0].complete:
                _checks.warn(f"{line}: has {more} pings more than were planned: a new survey has them")
    return plans


def plan_of(store: SurveyStore, strip: StripStore) -> StripPlan:
    """The plan of a stored strip, whose numbers are those of its arrays."""
    try:
        plan = StripPlan.of(strip.attributes, strip.y)
        for name in ("rotation", "start", "step", "track"):
            _checks.number(name, getattr(plan, name), positive=name == "step")
        _checks.reals("origin", plan.origin, [(2,)])
        _checks.whole("section", plan.section)
        if plan.z is not None:
            _checks.number("z", plan.z)
        elif plan.depth_map is None:
            raise ValueError("neither z nor depth_map")
        if (plan.tiles, plan.columns, plan.name) != (strip.tiles, strip.columns, strip.name):
            raise ValueError(f"found {plan.tiles} tiles of {plan.columns} columns, its arrays have {strip.tiles}")
        if not all(isinstance(value, str) for value in (plan.line, plan.side)) or type(plan.complete) is not bool:
            raise ValueError("line, side, complete: expected names, and true or false")
        _require_blocks(plan)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{store.path}: {strip.name}: no plan of a strip ({error})") from error
    return plan


def _require_blocks(plan: StripPlan) -> None:
    """Raise ValueError for blocks that do not follow each other, or lie beyond the strip."""
    before = 0
    for number, block in enumerate(plan.blocks):
        numbers = block.first, block.last, block.low, block.high, block.final
        good = all(type(value) is int for value in numbers) and before == block.first < block.last
        if not (good and 0 <= block.low <= block.high and 0 <= block.final <= plan.tiles):
            raise ValueError(f"blocks: number {number}: found {numbers}, expected pings that follow those before, and columns")
        before = block.last
    if not before:
        raise ValueError("blocks: none")


def require_same(plan: SurveyPlan, path: str | os.PathLike[str]) -> None:
    """Raise ValueError where a store was planned otherwise; names the first thing that differs."""
    store = SurveyStore(path)
    expected = "expected what the store was planned with, or --overwrite"
    if len(store.strips) != len(plan.strips):
        raise ValueError(f"{store.path}: has {len(store.strips)} strips, these lines {len(plan.strips)}: {expected}")
    for stored, strip in zip(store.strips, plan.strips, strict=True):
        was, now = _flat(stored.attributes, stored.y), _flat(strip.attributes(), strip.y)
        for name in now:
            if was.get(name) != now[name]:
                found = "other pings" if name == "blocks" else f"{now[name]!r:.60} after {was.get(name)!r:.60}"
                raise ValueError(f"{store.path}: {stored.name}: {name}: {found}: {expected}")


def _flat(attributes: dict[str, Any], y: FloatArray) -> dict[str, Any]:
    """A strip's plan without names within names, what follows from others last."""
    given = {**attributes, **attributes["settings"], "y": [float(y[0]), float(y[-1]), y.size]}
    last = ("start", "tiles", "blocks")
    order = [name for name in given if name not in ("settings", *last)]
    return {name: given[name] for name in (*order, *last)}
