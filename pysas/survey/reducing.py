"""Strips reduced to quick-looks: mean power in boxes of pixels, a tile in memory at a time.

A strip is wrapped into rows at about one scale along and across, at most eight; a longer one is compressed along the track.
Where reading all of it would take longer than a page is worth, the rows are stretches of it, evenly spaced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pysas._checks import FloatArray
from pysas.survey.image_store import DONE, StripStore
from pysas.survey.pictures import Panel
from pysas.survey.tiling import StripPlan

_WIDE, _HIGH = 1200, 400  # boxes of a row, at most
_LOW = 100  # boxes across for which a strip is wrapped
_ROWS = 8
_MOST_BOXES = 8_000_000  # of all rows of a page, which become its bytes
_MOST_READ, _MOST_TILES = 4_000_000_000, 20_000  # pixels and tiles of a page: a minute or two


def rows_of(
    plan: StripPlan, strip: StripStore, states: Sequence[str], damaged: Callable[[int, str], None], share: float
) -> tuple[list[Panel], str]:
    """Rows of a strip's quick-look, and what they are in words.

    Parameters
    ----------
    plan, strip
    states : sequence of str
        A tile each; may change while tiles are read.
    damaged : callable
        Is told of a tile, and why, whose pixels are not what was written.
    share : float
        Of what a page may read and hold.
    """
    pixels = plan.columns * plan.y.size
    across = float(plan.y[-1] - plan.y[0]) + plan.step
    wide = int(np.clip(share * _MOST_BOXES / (_ROWS * 1.5 * _LOW), _WIDE / 4, _WIDE))
    length = plan.tiles * plan.columns * plan.step
    many = int(np.clip(round(length * _LOW / (across * wide)), 1, min(_ROWS, plan.tiles)))
    most = max(int(share * min(_MOST_READ / pixels, _MOST_TILES)), many)
    each = min(-(-plan.tiles // many), max(most // many, 1))
    if each * many >= plan.tiles:
        firsts = list(range(0, plan.tiles, each))
    else:
        firsts = np.linspace(0, plan.tiles - each, many).astype(int).tolist()
    boxes = max(-(-plan.y.size // _HIGH), 1), max(-(-each * plan.columns // wide), 1)
    panels = [_panel(plan, strip, states, damaged, (first, min(first + each, plan.tiles)), boxes) for first in firsts]
    size = boxes[1] * plan.step, boxes[0] * across / plan.y.size
    said = f"boxes of {size[0]:.3g} m along x {size[1]:.3g} m across"
    if each * many < plan.tiles:
        part = 100 * each * many / plan.tiles
        said += f"; {many} stretches of {each * plan.columns * plan.step:.4g} m, evenly spaced, {part:.2g} % of the strip"
    return panels, said


def _panel(
    plan: StripPlan, strip: StripStore, states: Sequence[str], damaged: Callable[[int, str], None], tiles: tuple[int, int],
    boxes: tuple[int, int],
) -> Panel:  # fmt: skip
    first, last = tiles
    shape = -(-plan.y.size // boxes[0]), -(-(last - first) * plan.columns // boxes[1])
    power, count = np.zeros(shape), np.zeros(shape)
    without = {}
    for tile in range(first, last):
        if states[tile] == DONE:
            try:
                _add(power, count, strip.read(tile), (tile - first) * plan.columns, boxes)
            except (ValueError, OSError) as error:
                damaged(tile, str(error))
        if states[tile] != DONE:
            without[tile] = states[tile]
    with np.errstate(invalid="ignore", divide="ignore"):
        return Panel(first, last, power / count, without)


def _add(power: FloatArray, count: FloatArray, magnitude: FloatArray, begin: int, boxes: tuple[int, int]) -> None:
    """Sums of squares and numbers of pixels, by boxes; `begin`: the row's column that the tile's first one is."""
    columns = (begin + np.arange(magnitude.shape[1])) // boxes[1]
    edges = np.flatnonzero(np.diff(columns, prepend=-1))
    many = np.diff(edges, append=columns.size)
    for row in range(power.shape[0]):
        some = magnitude[row * boxes[0] : (row + 1) * boxes[0]]
        sums = np.einsum("ij,ij->j", some, some, dtype=np.float64)
        power[row, columns[edges]] += np.add.reduceat(sums, edges)
        count[row, columns[edges]] += many * len(some)
