"""A survey of a line that still grows: tiles are made as soon as no ping to come lights them."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks
from pysas.formats import files, io
from pysas.formats.echo_store import EchoStore, open_echoes
from pysas.imaging.words import spoken
from pysas.survey.image_store import SurveyStore
from pysas.survey.lines import Cut, SurveyPlan
from pysas.survey.running import SurveyReport, begin, placed, plan_of, require_place, resume
from pysas.survey.sections import Section, reading
from pysas.survey.tiling import StripPlan, begun, extended, require_navigation

AXES = 100.0  # m of track that the axes of a strip are laid along


def follow(
    line: str | os.PathLike[str], path: str | os.PathLike[str], *, poll: float = 1.0, patience: float | None = None,
    threads: int | None = None, overwrite: bool = False, again: bool = False, progress: Callable[[int], None] | None = None,
    **options: Any,
) -> SurveyReport:  # fmt: skip
    """Image a line while it is recorded, until its recorder says that it is complete.

    Axes lie along the first 100 m of the track; otherwise tiles are those of `plan` and `run` on the whole line. A store that
    was ended goes on with `again`, or with `resume` as far as the line was planned, to the same bytes.

    Parameters
    ----------
    line : path
        A store of echoes (.zarr) that a `pysas.EchoWriter` adds pings to; it need not be there yet.
    path : path
        Of the store of images.
    poll : float
        s between looks at the line.
    patience : float, optional
        s without a new ping after which this ends, with what is there; None: it waits for ever.
    threads, overwrite
        As in `run`.
    again : bool
        Go on with a store of images that is there.
    progress : callable, optional
        Is told the number of tiles that are done.
    **options
        Of `plan`: pixel, swath, side, z ... ; not with `again`.

    Returns
    -------
    SurveyReport

    Raises
    ------
    ValueError, TypeError, OSError, MemoryError
        As `plan` and `run` raise them.

    Notes
    -----
    A tile is done about a footprint's and a tile's length after the sonar has passed it. Each look at a line that has grown
    reads its navigation: 2 s of 150,000 pings of 32 receivers.
    """
    text = files.name(line)
    if not io.is_store(text):
        raise ValueError(f"{text}: expected a store of echoes (.zarr): no other grows")
    _checks.number("poll", poll, positive=True)
    _checks.callback("progress", progress)
    waiting = _Waiting(text, poll, patience)
    if again:
        if options:
            raise TypeError(f"{', '.join(options)}: expected none with again: the store has its plan")
        store = SurveyStore(path, mend=True)
        plans = [plan_of(store, strip) for strip in store.strips]
        _require_line(plans, text, store.path)
        report = resume(path, threads=threads)
    else:
        require_place(path, overwrite=overwrite)
        plans = _first(Cut.of(**options), text, waiting)
        begin(SurveyPlan(tuple(plans), (0.0,) * len(plans), 0, _checks.threads(threads)), path, overwrite=overwrite)
        report = SurveyReport(files.name(path), 0, 0, 0.0)
    with placed(report.path, f"pysas survey {text} -o {report.path} --follow --resume goes on from there"):
        return _Following(plans, SurveyStore(path), report, threads, progress).until_complete(waiting)


def _require_line(plans: list[StripPlan], line: str, path: str) -> None:
    """Raise ValueError where a store is not of this line alone."""
    others = {plan.line for plan in plans} - {os.path.abspath(line)}
    if others:
        raise ValueError(f"{path}: of {', '.join(sorted(others))}: expected that line, not {line}, alone")


class _Waiting:
    """For pings, at most so long without any."""

    def __init__(self, line: str, poll: float, patience: float | None) -> None:
        self.line, self.poll = line, poll
        self.patience = None if patience is None else _checks.number("patience", patience, positive=True)
        self.pings, self.since = 0, time.monotonic()

    def more(self, than: int) -> bool:
        """Wait for more pings or for the line's end; False: patience is over."""
        while True:
            pings, complete = self._look()
            if pings > self.pings:
                self.pings, self.since = pings, time.monotonic()
            if complete or pings > than:
                return True
            if self.patience is not None and time.monotonic() - self.since > self.patience:
                return False
            time.sleep(self.poll)

    def _look(self) -> tuple[int, bool]:
        """Pings there, and whether these are all, of the header alone. Raises OSError where a line that was there is gone."""
        if self.pings:
            os.stat(self.line)
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # not there yet; opening it tells what is wrong
            header = json.loads((Path(self.line) / "zarr.json").read_bytes())["attributes"]
            return int(header.get("pings", 1)), header.get("complete", True) is not False
        return 0, False


def _first(cut: Cut, line: str, waiting: _Waiting) -> list[StripPlan]:
    """Strips of a line of which enough is there to lay axes along it."""
    while True:
        if not waiting.more(waiting.pings):
            found = f"{waiting.pings} pings, and no more for {spoken(waiting.patience or 0.0)}"
            raise ValueError(f"{line}: {found}: expected {AXES:g} m of track and a tile, to lay axes along")
        with open_echoes(line) as store:
            navigation = store.navigation
            away = np.linalg.norm(navigation.tx[:, :2] - navigation.tx[0, :2], axis=1)
            enough = np.flatnonzero(away >= max(AXES, cut.tile))
            if not store.complete and not enough.size:
                continue
            first = navigation[: int(enough[0]) + 1] if enough.size else navigation
            with files.naming(line):
                strips = [begun(strip, first) for strip in cut.strips(0, line, first)]
            strips = [extended(strip, navigation, store.complete) for strip in strips]
            if all(strip.tiles for strip in strips):
                return strips


class _Following:
    """Strips of one line, as they grow."""

    def __init__(
        self, plans: list[StripPlan], store: SurveyStore, report: SurveyReport, threads: int | None,
        progress: Callable[[int], None] | None,
    ) -> None:  # fmt: skip
        self.plans, self.store, self.threads, self.progress = plans, store, threads, progress
        self.report = report  # of tiles that are done
        self.open: list[dict[int, Section]] = [{} for _ in plans]
        self.final = [plan.ready if report.tiles else 0 for plan in plans]  # tiles before these are
        self.next = [_lighting(plan, tile) for plan, tile in zip(plans, self.final, strict=True)]  # blocks to be summed

    def until_complete(self, waiting: _Waiting) -> SurveyReport:
        began = time.perf_counter()
        try:
            while True:
                with open_echoes(waiting.line) as echoes:
                    for number in range(len(self.plans)):
                        self._go_on(number, echoes)
                    if echoes.complete:
                        break
                    pings = echoes.n_ping
                if not waiting.more(pings):
                    break
        finally:
            for sections in self.open:
                for section in sections.values():
                    section.__exit__()
        self.report.tiles = sum(plan.ready for plan in self.plans)
        self.report.seconds += time.perf_counter() - began
        return self.report

    def _go_on(self, number: int, echoes: EchoStore) -> None:
        """Extend a strip by what has come, and make what is complete."""
        strip, before = self.store.strips[number], self.plans[number]
        require_navigation(before, echoes.navigation, before.blocks[-1:])
        if before.complete and echoes.n_ping > before.blocks[-1].last:
            planned = f"the survey was planned when it was complete with {before.blocks[-1].last}"
            raise ValueError(f"{before.line}: has {echoes.n_ping} pings, {planned}: expected a new survey, --overwrite")
        plan = extended(before, echoes.navigation, echoes.complete)
        if plan.attributes() != strip.attributes:
            strip.grow(plan.x, plan.attributes())
        self.plans[number] = plan
        for section in self.open[number].values():
            section.plan = plan
        while self.next[number] < len(plan.blocks):
            self._add(number, self.next[number], echoes)
            self.next[number] += 1
        if echoes.complete:
            self._finish(number, plan.tiles)

    def _add(self, number: int, block: int, echoes: EchoStore) -> None:
        plan, sections = self.plans[number], self.open[number]
        one = plan.blocks[block]
        if one.high > one.low:
            many = plan.section * plan.columns
            for section in range(one.low // many, (one.high - 1) // many + 1):
                if section not in sections:
                    sections[section] = Section(plan, self.store.strips[number], section, self.threads)
                tiles = range(max(self.final[number], section * plan.section), (section + 1) * plan.section)
                wanted = sections[section].wanted(block, tiles)
                if wanted:
                    sections[section].add(block, lambda: reading(echoes, one.first, one.last), wanted)
        self._finish(number, one.final)

    def _finish(self, number: int, final: int) -> None:
        """Write tiles before `final`."""
        plan, sections = self.plans[number], self.open[number]
        while self.final[number] < final:
            section = self.final[number] // plan.section
            end = min((section + 1) * plan.section, final)
            if section not in sections:
                sections[section] = Section(plan, self.store.strips[number], section, self.threads)
            work = sections[section]
            work.finish(range(self.final[number], end))
            self.final[number] = end
            self.report.made += work.done
            work.done = []
            if end == (section + 1) * plan.section:
                sections.pop(section).__exit__()
            if self.progress is not None:
                self.progress(sum(self.final))


def _lighting(plan: StripPlan, tile: int) -> int:
    """The first block that lights a tile or one after it."""
    return next(
        (k for k, block in enumerate(plan.blocks) if block.high > max(block.low, tile * plan.columns)), len(plan.blocks)
    )
