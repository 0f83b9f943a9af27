"""Strips' tiles sampled where a mosaic's pixels are: power over a pixel's box, ground range, distance from where data end."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from pysas import _checks
from pysas._checks import FloatArray
from pysas.survey import image_store
from pysas.survey.image_store import StripStore
from pysas.survey.placing import Place, over

Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

_CACHE = 96 * 2**20  # bytes of tiles that are kept
_MOST_BLOCK = 2 * 2**20  # samples of a strip that are looked at at a time
_FEATHER_CELLS = 100  # a feather's distances are told to a hundredth of it, or to a sample
_SAME = 1.01  # samples that a pixel may span and still be taken for one: maps stretch by a thousandth or so
_LEAST = 1e-6  # weight of a pixel that has data


@dataclass(frozen=True)
class Sampled:
    """A strip at a window's pixels (row, column): `magnitude`, NaN where it has no data, `range` (m) and `weight`, 0 to 1."""

    magnitude: Floats
    range: Floats
    weight: Floats


class Tiles:
    """Magnitudes of a store's tiles, those used last kept.

    Attributes
    ----------
    done : list of (tile,) bool
        By strip.
    missing : int
        Tiles that were not made, or failed.
    """

    def __init__(self, path: str, strips: Sequence[StripStore]) -> None:
        self._path, self._strips = path, strips
        self._kept: OrderedDict[tuple[int, int], Floats] = OrderedDict()
        self._bytes = 0
        self.done: list[Bools] = []
        self.missing = 0
        for strip in strips:
            done = np.zeros(strip.tiles, dtype=np.bool_)
            for tile in range(strip.tiles):
                record = strip.record(tile) or {}
                state = record.get("state")
                done[tile] = state == image_store.DONE
                self.missing += state in (None, image_store.FAILED)
                if state == image_store.DAMAGED or (done[tile] and not strip.whole(tile, record)):
                    raise ValueError(f"{path}: {strip.name}, tile {tile}: damaged: expected it made again, by --resume")
            self.done.append(done)

    @property
    def total(self) -> int:
        return sum(strip.tiles for strip in self._strips)

    def magnitude(self, strip: int, tile: int) -> Floats:
        """Of (row, column), of a tile that is done; 0 where no ping lights it."""
        key = strip, tile
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        try:
            found = self._strips[strip].read(tile)
        except ValueError as error:
            raise ValueError(f"{self._path}: {error}") from error
        if not np.isfinite(found).all():
            raise ValueError(f"{self._path}: {self._strips[strip].name}, tile {tile}: magnitudes that are not finite")
        self._kept[key] = found
        self._bytes += found.nbytes
        while self._bytes > _CACHE and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1].nbytes
        return found


class Sampler:
    """One strip, sampled at pixels of a given size (m on the seabed) with weights that rise over `feather` m."""

    def __init__(self, number: int, strip: StripStore, place: Place, tiles: Tiles, pixel: float, feather: float) -> None:
        self._number, self._columns, self._place, self._tiles, self._feather = number, strip.columns, place, tiles, feather
        self._axes = place.y, place.x  # of rows and columns
        self._kernels = [_box(pixel / abs(axis.step)) for axis in self._axes]
        self._cell = [max(1, int(feather / (_FEATHER_CELLS * abs(axis.step)))) for axis in self._axes]

    def fits(self, height: float, width: float) -> bool:
        """Whether a window of so many metres is small enough to be sampled at once."""
        reach = float(np.hypot(height, width))
        sizes = [reach / abs(axis.step) + kernel.size + 4 for axis, kernel in zip(self._axes, self._kernels, strict=True)]
        return sizes[0] * sizes[1] <= _MOST_BLOCK

    def sample(self, east: FloatArray, north: FloatArray) -> Sampled | None:
        """The strip at pixels whose centres are `north` (row,), `east` (column,); None where it has no data there."""
        x, y = over(self._place.from_map, east, north)
        at = [(place - axis.first) / axis.step for place, axis in zip((y, x), self._axes, strict=True)]
        spans = []
        for index, axis, kernel in zip(at, self._axes, self._kernels, strict=True):
            reach = kernel.size // 2 + 1
            low = max(int(np.floor(max(index.min(), -1.0))) - reach, -1)
            high = min(int(np.ceil(min(index.max(), axis.size))) + reach + 1, axis.size + 1)
            if low >= high:
                return None
            spans.append((low, high))
        block = self._block(*spans)
        lit = block > 0
        # the sample that a pixel's centre lies in
        near = [np.rint(index).clip(low, high - 1).astype(np.intp) - low for index, (low, high) in zip(at, spans, strict=True)]
        inside = np.logical_and.reduce(
            [(index >= low - 0.5) & (index <= high - 0.5) for index, (low, high) in zip(at, spans, strict=True)]
        )
        inside &= lit[near[0], near[1]]
        if not inside.any():
            return None
        # by a power of two, which changes no digit: squares of any float32 can be had
        scale = -int(np.frexp(block.max())[1])
        np.ldexp(block, scale, out=block)
        np.square(block, out=block)
        places = np.stack([index - low for index, (low, _) in zip(at, spans, strict=True)])
        power = self._mean(block, places)
        if not lit.all():
            power /= np.maximum(self._mean(lit.astype(np.float32), places), np.finfo(np.float32).tiny)
        magnitude = np.ldexp(np.sqrt(power), -scale)
        magnitude[~inside] = np.nan
        weight = np.where(inside, self._weight(at) if self._feather else np.float32(1), np.float32(0)).astype(np.float32)
        return Sampled(magnitude, np.abs(y - self._place.track).astype(np.float32), weight)

    def _mean(self, block: Floats, places: FloatArray) -> Floats:
        """Means over a pixel's box about each sample, and bilinear between samples."""
        for axis, kernel in enumerate(self._kernels):
            if kernel.size > 1:
                block = ndimage.correlate1d(block, kernel, axis=axis, mode="constant")
        found: Floats = ndimage.map_coordinates(block, places, order=1, mode="constant", prefilter=False)
        return found

    def _block(self, rows: tuple[int, int], columns: tuple[int, int]) -> Floats:
        """Magnitudes of rows and columns from the first to before the last; 0 where there are none, beyond the strip too."""
        block = np.zeros((rows[1] - rows[0], columns[1] - columns[0]), dtype=np.float32)
        for tile, (low, high), (first, last) in self._within(rows, columns):
            found = self._tiles.magnitude(self._number, tile)
            begin = tile * self._columns
            block[low - rows[0] : high - rows[0], first - columns[0] : last - columns[0]] = found[
                low:high, first - begin : last - begin
            ]
        return block

    def _within(self, rows: tuple[int, int], columns: tuple[int, int]) -> list[Any]:
        """Tiles that are done, with the rows and columns of them that lie within a span."""
        done, many = self._tiles.done[self._number], self._columns
        low, high = max(rows[0], 0), min(rows[1], self._axes[0].size)
        first, last = max(columns[0], 0), min(columns[1], self._axes[1].size)
        if low >= high or first >= last:
            return []
        return [
            (tile, (low, high), (max(first, tile * many), min(last, (tile + 1) * many)))
            for tile in range(first // many, (last - 1) // many + 1)
            if done[tile]
        ]

    def _weight(self, at: Sequence[FloatArray]) -> Floats:
        """Distance from the nearest place without data / feather, at most 1.

        Distances are those between cells of some samples, which have data where all their samples do.
        """
        spans = []
        for index, axis, cell in zip(at, self._axes, self._cell, strict=True):
            margin = int(np.ceil(self._feather / (abs(axis.step) * cell))) + 2
            low = max(int(np.floor(max(index.min(), 0.0) / cell)) - margin, -1)
            high = min(int(np.ceil(min(index.max(), axis.size) / cell)) + margin, -(-axis.size // cell)) + 1
            spans.append((low, high))
        cells = np.zeros([high - low for low, high in spans], dtype=np.bool_)
        counted = np.zeros(cells.shape, dtype=np.int32)
        rows, columns = ((low * cell, high * cell) for (low, high), cell in zip(spans, self._cell, strict=True))
        for tile, (low, high), (first, last) in self._within(rows, columns):
            lit = self._tiles.magnitude(self._number, tile)[
                low:high, first - tile * self._columns : last - tile * self._columns
            ]
            counts: npt.NDArray[Any] = lit > 0
            where = []
            for number, (begin, end) in enumerate(((low, high), (first, last))):
                starts, numbers = _cells(begin, end, self._cell[number])
                counts = np.add.reduceat(counts, starts, axis=number, dtype=np.int32)
                where.append(slice(numbers[0] - spans[number][0], numbers[-1] + 1 - spans[number][0]))
            counted[where[0], where[1]] += counts
        full = [
            np.minimum((np.arange(low, high) + 1) * cell, axis.size) - np.maximum(np.arange(low, high) * cell, 0)
            for (low, high), cell, axis in zip(spans, self._cell, self._axes, strict=True)
        ]
        np.equal(counted, np.outer(*(np.maximum(sizes, 1) for sizes in full)), out=cells)
        if cells.all():
            return np.ones(at[0].shape, dtype=np.float32)
        sampling = [abs(axis.step) * cell for axis, cell in zip(self._axes, self._cell, strict=True)]
        away = ndimage.distance_transform_edt(cells, sampling=sampling).astype(np.float32)
        places = np.stack(
            [(index + 0.5) / cell - 0.5 - low for index, cell, (low, _) in zip(at, self._cell, spans, strict=True)]
        )
        found: Floats = ndimage.map_coordinates(away, places, order=1, mode="nearest", prefilter=False)
        return np.asarray(np.clip(found / np.float32(self._feather), np.float32(_LEAST), np.float32(1)))


def _cells(begin: int, end: int, cell: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Of samples begin to end - 1: where each cell's begin among them, and the cells' numbers."""
    numbers = np.arange(begin // cell, (end - 1) // cell + 1)
    return np.maximum(numbers * cell, begin) - begin, numbers


def _box(width: float) -> Floats:
    """Weights of samples about one whose mean is that over a box of `width` samples, at least one."""
    half = (width if width > _SAME else 1.0) / 2
    offsets = np.arange(-int(np.ceil(half - 0.5 - 1e-9)), int(np.ceil(half - 0.5 - 1e-9)) + 1)
    weights = np.minimum(offsets + 0.5, half) - np.maximum(offsets - 0.5, -half)
    if weights.min() < 0:
        raise _checks.InternalError(f"box of {width}")
    return np.asarray(weights / weights.sum(), dtype=np.float32)


def combined(parts: Sequence[Sampled], combine: str, feather: float) -> Floats:
    """One magnitude from strips' at the same pixels, NaN where none has data.

    With magnitudes m, weights f and ranges r of strips i, j: `mean` is sum f m / sum f; `strongest` max(f m) / max f; `nearest`
    sum w m / sum w with w_i = f_i prod_j (1 - f_j s((r_i - r_j) / feather)), s(t) = (1 + t) / 2 between 0 and 1: the nearer
    strip lies over the farther one, as opaque as its f, and both are half seen where their ranges are equal. Without a feather
    that is the strip of least range.
    """
    covered = np.logical_or.reduce([part.weight > 0 for part in parts])
    values = [np.where(part.weight > 0, part.magnitude, np.float32(0)) for part in parts]
    if combine == "strongest":
        top = np.maximum.reduce([part.weight * value for part, value in zip(parts, values, strict=True)])
        bottom = np.maximum.reduce([part.weight for part in parts])
    elif combine == "nearest" and not feather:
        ranges = np.stack([np.where(part.weight > 0, part.range, np.float32(np.inf)) for part in parts])
        top = np.take_along_axis(np.stack(values), ranges.argmin(axis=0)[None], axis=0)[0]
        bottom = np.ones_like(top)
    else:
        top, bottom = np.zeros_like(values[0]), np.zeros_like(values[0])
        for part, value in zip(parts, values, strict=True):
            weight = part.weight.copy()
            for other in parts if combine == "nearest" else ():
                if other is not part:
                    over_it = np.clip((1 + (part.range - other.range) / np.float32(feather)) / 2, 0, 1)
                    weight *= 1 - other.weight * over_it
            top += weight * value
            bottom += weight
    found = np.full(top.shape, np.nan, dtype=np.float32)
    np.divide(top, bottom, out=found, where=covered)
    return found


def ground(place: Place, bounds: FloatArray, pixel: float) -> float:
    """m on the strip's axes of a pixel's side in the middle of a strip: maps have scales other than 1."""
    east, north = float(bounds[:2].mean()), float(bounds[2:].mean())
    x, y = place.from_map(np.array([east, east + pixel, east]), np.array([north, north, north + pixel]))
    return float(np.sqrt(abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))))
