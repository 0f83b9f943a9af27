"""Whether a store is what was written, and its lines what it was made from."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

from pysas import _checks
from pysas.formats.echo_store import open_echoes
from pysas.survey.image_store import DAMAGED, DONE, SurveyStore
from pysas.survey.running import plan_of
from pysas.survey.sections import reading
from pysas.survey.tiling import StripPlan, require_navigation


@dataclass(frozen=True)
class Damage:
    """What `verify` found: `where` is a strip and its tile, or a line and its pings."""

    where: str
    what: str


def verify(
    path: str | os.PathLike[str], *, inputs: bool = True, progress: Callable[[float], None] | None = None
) -> list[Damage]:
    """Compare every byte of a store with what was written, and the samples that it was made from with what they were.

    Tiles that are damaged are marked so, and `resume` makes them anew; headers of arrays, which follow from the plan, are
    written anew at once; damaged lines must come from a copy.

    Parameters
    ----------
    path : str or path
    inputs : bool
        Look at the lines' samples too.
    progress : callable, optional
        Is told the share that is done.

    Returns
    -------
    list of Damage
        Empty where all is well. Tiles that are not made are no damage.

    Raises
    ------
    ValueError, OSError
        No such store, or its plan (attributes of groups, axes) is damaged.

    Notes
    -----
    Reads all of it: O(bytes).
    """
    _checks.callback("progress", progress)
    store = SurveyStore(path, mend=True)
    strips = store.strips
    headers = [*store.mended, *(f"{strip.name}/{name}" for strip in strips for name in strip.mended)]
    found = [Damage(name, "missing, or not as it was written: mended") for name in headers]
    plans = [plan_of(store, strip) for strip in strips]
    whole = sum(plan.tiles + (len(plan.blocks) if inputs else 0) for plan in plans) or 1
    done = 0

    def one_more() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / whole)

    for plan, strip in zip(plans, strips, strict=True):
        samples: dict[tuple[int, int], set[int]] = {}  # CRC-32 of pings, of all tiles that are made from them
        for tile in range(plan.tiles):
            record = strip.record(tile)
            where = f"{strip.name}, tile {tile}"
            if record is None and strip.has_record(tile):
                found.append(Damage(where, "its record is damaged"))
                strip.forget(tile)
            if record is not None and record["state"] == DONE:
                for first, last, value in record.get("input", ()):
                    samples.setdefault((first, last), set()).add(value)
                if (what := strip.damage(tile, record)) is not None:
                    found.append(Damage(where, what))
                    strip.put(tile, {**record, "state": DAMAGED})
            elif record is not None and record["state"] == DAMAGED:
                found.append(Damage(where, "found damaged before"))
            one_more()
        if inputs:
            found += _inputs(plan, samples, one_more)
    return found


def _inputs(plan: StripPlan, samples: dict[tuple[int, int], set[int]], one_more: Callable[[], None]) -> list[Damage]:
    """Of a line: pings whose samples are damaged, or not those that tiles were made from."""
    found: list[Damage] = []
    try:
        with open_echoes(plan.line) as echoes:
            require_navigation(plan, echoes.navigation, plan.blocks)
            for block in plan.blocks:
                where = f"{plan.line}, pings {block.first} to {block.last - 1}"
                try:
                    _, value = reading(echoes, block.first, block.last)
                    if samples.get((block.first, block.last), set()) - {value}:
                        found.append(Damage(where, "other samples than tiles were made from"))
                except ValueError as error:
                    found.append(Damage(where, str(error)))
                one_more()
    except (ValueError, OSError) as error:
        found.append(Damage(plan.line, str(error)))
    return found
