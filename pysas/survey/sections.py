"""A section of a strip: tiles that one process makes, one after another, from a store of echoes to a store of images."""

from __future__ import annotations

import os
import threading
import warnings
import zlib
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas import __version__, _checks
from pysas.engine import engine_of
from pysas.formats.echo_store import EchoStore, open_echoes
from pysas.model.echoes import Echoes
from pysas.model.image import Report
from pysas.signal import compression
from pysas.survey.image_store import DARK, DONE, FAILED, StripStore, SurveyStore
from pysas.survey.strips import Blocks, Pending, add_block, crossed
from pysas.survey.tiling import StripPlan, require_navigation

QUEUE = 3  # tiles that are written, or wait for it
_ONE = threading.Lock()  # a process makes one section at a time, on all threads that it has


@dataclass(frozen=True)
class Made:
    """What became of a tile: what a report needs of it."""

    strip: str
    tile: int
    state: str
    reason: str = ""
    seconds: float = 0.0
    terms: int = 0
    pixels: int = 0


class Section:
    """Tiles of a section that are to be made, from blocks of pings in their order.

    Parameters
    ----------
    plan : StripPlan
    store : StripStore
    section : int
    threads : int or None
    """

    def __init__(self, plan: StripPlan, store: StripStore, section: int, threads: int | None) -> None:
        self.plan, self.store, self.threads = plan, store, threads
        self.first, self.last = plan.ends_of(section)
        self.blocks = Blocks(plan.strip(threads))
        self.pending: dict[int, Pending] = {}
        self.inputs: dict[int, list[list[int]]] = {}  # pings and their samples' CRC-32, by tiles
        self.failed: dict[int, str] = {}
        self.done: list[Made] = []
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="pysas-tiles")
        self._writing: deque[Future[None]] = deque()

    def wanted(self, number: int, tiles: Iterable[int]) -> list[int]:
        """Those of the tiles that a block lights."""
        block = self.plan.blocks[number]
        low, high = max(block.low, self.first), min(block.high, self.last)
        lit = crossed(low, high, self.plan.columns) if low < high else range(0)
        return [tile for tile in tiles if tile in lit]

    def add(self, number: int, read: Callable[[], tuple[Echoes, int]], tiles: list[int]) -> None:
        """Sum a block; what cannot be read or summed fails the tiles that it lights, among those wanted."""
        block = self.plan.blocks[number]
        low, high = max(block.low, self.first), min(block.high, self.last)
        echoes = None
        try:
            echoes, samples = read()
            engine_of(self.plan.settings.backend)  # says that Numba runs, where it does, before warnings are silent
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an image's notes have them
                image = self.blocks.image(self._ready(echoes), low, high)
        except (ValueError, TypeError, ArithmeticError, _checks.InternalError) as error:
            os.stat(self.plan.line)  # a line that is gone is no fault of its pings
            reason = _silent(echoes, block.first) if self.plan.settings.nan == "raise" and echoes is not None else ""
            for tile in tiles:
                self.failed.setdefault(tile, f"pings {block.first} to {block.last - 1}: {reason or error}")
            return
        for tile in tiles:
            if tile not in self.pending:
                self.pending[tile] = Pending(self.blocks.strip, image.data.dtype)
            self.inputs.setdefault(tile, []).append([block.first, block.last, samples])
        add_block(image, low, {tile: self.pending[tile] for tile in tiles})

    def _ready(self, echoes: Echoes) -> Echoes:
        """Compressed, on the strip's axes."""
        if not echoes.compressed:
            settings = self.plan.settings
            window = tuple(settings.window) if isinstance(settings.window, list) else settings.window
            echoes = compression.compress(echoes, window, nan=settings.nan, threads=self.threads)
        return self.plan.laid(echoes)

    def finish(self, tiles: Iterable[int]) -> None:
        """Write tiles that no block to come lights."""
        for tile in tiles:
            pending, inputs = self.pending.pop(tile, None), self.inputs.pop(tile, [])
            self.blocks.forget(tile)
            recipe = {"recipe": self.plan.recipe(tile), "version": __version__}
            if tile in self.failed:
                reason = self.failed[tile]
                self._write(self.store.put, tile, recipe | {"state": FAILED, "reason": reason})
                self.done.append(Made(self.plan.name, tile, FAILED, reason))
            elif pending is None:
                self._write(self.store.put, tile, recipe | {"state": DARK})
                self.done.append(Made(self.plan.name, tile, DARK))
            else:
                report = pending.report()
                record = recipe | {"input": inputs, "report": _lasting(report)}
                self._write(self.store.write, tile, pending.data, record)
                seconds = report.prepare_seconds + report.sum_seconds
                self.done.append(Made(self.plan.name, tile, DONE, "", seconds, report.terms, pending.data.size))

    def _write(self, what: Callable[..., None], *arguments: Any) -> None:
        """On a thread, one at a time; a few may wait for it."""
        self._wait(QUEUE - 1)
        self._writing.append(self._writer.submit(what, *arguments))

    def _wait(self, left: int = 0) -> None:
        while len(self._writing) > left:
            self._writing.popleft().result()

    def __enter__(self) -> Section:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._wait()
        finally:
            self._writer.shutdown()


def _silent(echoes: Echoes, first: int) -> str:
    """Which pings have samples that are no numbers, by their numbers in the line; nothing where none has."""
    bad = first + np.flatnonzero(~np.isfinite(echoes.data.reshape(echoes.n_ping, -1)).all(axis=1))
    if not bad.size:
        return ""
    which = ", ".join(map(str, bad)) if bad.size < 5 else f"{bad[0]} and {bad.size - 1} more"
    return f"samples of ping {which} are not finite: expected finite ones, or nan='mask'"


def _lasting(report: Report) -> dict[str, Any]:
    """What a report says that does not differ from run to run."""
    values = report.as_dict()
    for name in ("threads", "prepare_seconds", "sum_seconds", "choices"):
        del values[name]
    return values


def reading(store: EchoStore, first: int, last: int) -> tuple[Echoes, int]:
    """Some pings, and the CRC-32 of their samples."""
    echoes = store.echoes(slice(first, last))
    return echoes, zlib.crc32(np.ascontiguousarray(echoes.data).data.cast("B"))


def missing(plan: StripPlan, store: StripStore, section: int) -> list[int]:
    """Tiles of a section that are not as the plan has them."""
    return [tile for tile in plan.tiles_of(section) if not made(plan, store, tile)]


def made(plan: StripPlan, store: StripStore, tile: int) -> bool:
    """Whether a tile is done, or dark, by its record; its pixels are not looked at."""
    record = store.record(tile)
    if record is None or record.get("recipe") != plan.recipe(tile):
        return False
    return record["state"] == DARK or (record["state"] == DONE and store.whole(tile, record))


def recorded(store: StripStore, tile: int) -> Made:
    """What became of a tile that is made, by its record."""
    record = store.record(tile) or {}
    terms = record.get("report", {}).get("terms", 0)
    return Made(store.name, tile, record["state"], "", 0.0, terms, store.y.size * store.columns if terms else 0)


def image_section(
    path: str, number: int, section: int, threads: int | None, progress: Callable[[float], None] | None = None
) -> list[Made]:
    """Make the tiles of a section that are missing.

    Parameters
    ----------
    path : str
        Of the store of images; its plan names the store of echoes.
    number, section : int
        Of the strip and of its section.
    threads : int or None
    progress : callable, optional
        Is told the share that is done.

    Returns
    -------
    list of Made
        Tiles that were missing, one each.

    Raises
    ------
    OSError, MemoryError, ValueError
        What ends a run: the file system, memory, or a store that is not the plan's. What is wrong with some pings is a tile's
        failure.
    """
    with _ONE:
        store = SurveyStore(path).strip(number)
        plan = StripPlan.of(store.attributes, store.y)
        wanted = missing(plan, store, section)
        if not wanted:
            return []
        with Section(plan, store, section, threads) as work:
            _make(work, _opened(plan.line), wanted, progress)
        return work.done


_kept: dict[tuple[str, int, int], EchoStore] = {}  # the line that was opened last, by its name, folder and time of change


def _opened(line: str) -> EchoStore:
    """A line's navigation is read once for all of its sections that follow each other in a process."""
    found = os.stat(os.path.join(line, "zarr.json") if os.path.isdir(line) else line)
    key = line, found.st_ino, found.st_mtime_ns
    if key not in _kept:
        close_lines()
        _kept[key] = open_echoes(line)
    return _kept[key]


def close_lines() -> None:
    """Let go of what is kept open."""
    while _kept:
        _kept.popitem()[1].close()


def _make(work: Section, echoes: EchoStore, wanted: list[int], progress: Callable[[float], None] | None) -> None:
    plan = work.plan
    lit = {k: tiles for k in plan.blocks_of(range(wanted[0], wanted[-1] + 1)) if (tiles := work.wanted(k, wanted))}
    blocks = {k: plan.blocks[k] for k in lit}
    require_navigation(plan, echoes.navigation, list(blocks.values()))  # of a worker's own disk it may be another
    left = list(wanted)
    with ThreadPoolExecutor(1, thread_name_prefix="pysas-pings") as reader:

        def ask(numbers: list[int]) -> list[Future[tuple[Echoes, int]]]:
            return [reader.submit(reading, echoes, blocks[k].first, blocks[k].last) for k in numbers]

        numbers = list(blocks)
        coming = ask(numbers[:1])
        for place, number in enumerate(numbers):
            now = coming.pop()
            coming = ask(numbers[place + 1 : place + 2])  # while this one is summed
            work.add(number, now.result, lit[number])
            ready = [tile for tile in left if tile < blocks[number].final]
            left = left[len(ready) :]
            work.finish(ready)
            if progress is not None:
                progress((place + 1) / len(numbers))
    work.finish(left)
