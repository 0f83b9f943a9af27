"""A strip of a line: its axes, the blocks of pings that are summed at a time, and the tiles that these light.

Everything that a tile's pixels depend on stands in its strip: which pings a block has and which columns it covers. So a tile
comes out the same, bit by bit, whoever makes it and whatever was made before.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import __version__, _checks
from pysas._checks import FloatArray
from pysas.formats import depth_maps, io
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.planning.framing import laid_on
from pysas.planning.relief import laid_over
from pysas.survey.strips import Strip, columns_of, reaches_along

SLACK = 1.0  # m along the track by which a ping to come may light what the newest does not: yaw, surge


@dataclass(frozen=True)
class Settings:
    """How all strips of a survey are imaged: `pysas.survey.plan` says what each is."""

    tol: float = 1e-2
    method: str = "auto"
    backend: str = "auto"
    nan: str = "raise"
    window: Any = None


@dataclass(frozen=True)
class Block:
    """Pings `first` to `last` - 1, which are summed together on columns `low` to `high` - 1.

    final : tiles before this number are complete with it; navigation : SHA-256 of these pings' navigation.
    """

    first: int
    last: int
    low: int
    high: int
    final: int
    navigation: str


@dataclass(frozen=True)
class StripPlan:
    """One side of a line.

    Attributes
    ----------
    name, line, side : str
        Its own, the file of echoes, and "port" or "starboard".
    origin, rotation
        Of its axes in the line's coordinates, as a `Grid` has them; the sonar advances along x.
    start : float
        x of the first pixel, m.
    y : (row,)
        Across the line, m.
    step : float
        Between pixels along x, m.
    columns, section : int
        Of a tile, and tiles that are made together at most: a block's image ends at a section's.
    track : float
        y of the mean track.
    z : float or None
        Height of the seabed, m, in the line's coordinates; None: `depth_map` has it.
    depth_map : (path, SHA-256) or None
    frame : dict or None
        Of the line's coordinates, of `pysas.navigation.Frame`.
    settings : Settings
    blocks : tuple of Block
    tiles : int
    complete : bool
        False: the line grows.
    """

    name: str
    line: str
    side: str
    origin: tuple[float, float]
    rotation: float
    start: float
    y: FloatArray
    step: float
    columns: int
    section: int
    track: float
    z: float | None
    depth_map: tuple[str, str] | None
    frame: Mapping[str, Any] | None
    settings: Settings
    blocks: tuple[Block, ...] = ()
    tiles: int = 0
    complete: bool = False

    @property
    def x(self) -> FloatArray:
        """Of all pixels, m."""
        return np.asarray(self.start + self.step * np.arange(self.tiles * self.columns), dtype=np.float64)

    @property
    def ready(self) -> int:
        """How many tiles no ping to come lights."""
        return self.tiles if self.complete or not self.blocks else self.blocks[-1].final

    @property
    def sections(self) -> int:
        """How many there are."""
        return -(-self.ready // self.section)

    def tiles_of(self, section: int) -> range:
        """Tiles of a section that are ready."""
        return range(section * self.section, min((section + 1) * self.section, self.ready))

    def ends_of(self, section: int) -> tuple[int, int]:
        """First column of a section and the one after its last; they do not depend on how long the line becomes."""
        return section * self.section * self.columns, (section + 1) * self.section * self.columns

    def strip(self, threads: int | None, *, reaching: bool = False) -> Strip:
        """What sums its blocks, or tells what they reach, for which it may ask for heights beyond those of the depth map.

        Raises ValueError for a depth map other than the one it was planned with.
        """
        s = self.settings
        z = self.z if self.z is not None else self._heights(reaching)
        return Strip(
            self.y, self.step, self.columns * self.step, origin=self.start, z=z, tol=s.tol, method=s.method, threads=threads,
            backend=s.backend, nan=s.nan, slack=SLACK,
        )  # fmt: skip

    def require_heights(self) -> None:
        """Raise ValueError where its depth map does not hold all pixels: what it holds is convex, so that corners tell."""
        if self.depth_map is not None:
            self._heights(False)(*(axis[[0, axis.size // 2, -1]] for axis in (self.x, self.y)))

    def _heights(self, reaching: bool) -> Any:
        if self.depth_map is None:
            raise _checks.InternalError("neither z nor depth map")
        path, digest = self.depth_map
        x, y, z = depth_maps.load(path)
        if digest_of(x, y, z) != digest:
            raise ValueError(f"{path}: another depth map than the survey was planned with")
        return lambda along, across: self._over(along, across, (x, y, z), reaching)

    def _over(
        self, along: FloatArray, across: FloatArray, heights: tuple[FloatArray, FloatArray, FloatArray], reaching: bool
    ) -> FloatArray:
        """Heights (row, column) of a depth map at places on the strip's axes, all of which it holds."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pixels beyond it, which are an error here
            found = laid_over(Grid.plane(along, across, 0.0, origin=self.origin, rotation=self.rotation), *heights)
        height = np.array(found.height, dtype=np.float64)
        if found.mask is not None:
            if not reaching:
                raise ValueError(f"the depth map does not hold all of {self.name}: expected one that does")
            height[~found.mask] = np.mean(height[found.mask])  # only the least and the largest matter
        return height

    def laid(self, echoes: Echoes) -> Echoes:
        """Echoes of the line on the strip's axes."""
        return laid_on(echoes, np.array(self.origin), self.rotation)

    def grid(self, tile: int) -> Grid:
        """Pixels of a tile, in the line's coordinates; those of a depth map at height 0."""
        x = self.start + self.step * np.arange(tile * self.columns, (tile + 1) * self.columns)
        return Grid.plane(x, self.y, self.z or 0.0, origin=self.origin, rotation=self.rotation)

    def blocks_of(self, tiles: range) -> list[int]:
        """Numbers of the blocks that light some of these tiles."""
        low, high = tiles.start * self.columns, tiles.stop * self.columns
        lows, highs = self._ends
        return [int(k) for k in np.flatnonzero((lows < high) & (highs > low) & (lows < highs))]

    @functools.cached_property
    def _ends(self) -> npt.NDArray[np.int64]:
        """First columns of the blocks, and those after their last."""
        return np.array([(block.low, block.high) for block in self.blocks], dtype=np.int64).reshape(-1, 2).T

    def recipe(self, tile: int) -> str:
        """SHA-256 of all that a tile is made from but its samples."""
        blocks = [
            [one.first, one.last, one.low, one.high, one.navigation]
            for one in (self.blocks[k] for k in self.blocks_of(range(tile, tile + 1)))
        ]
        given = [__version__, self._common, self.ends_of(tile // self.section), tile, blocks]
        return hashlib.sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()

    @functools.cached_property
    def _common(self) -> dict[str, Any]:
        """What all tiles are made from."""
        given = dataclasses.replace(self, blocks=()).attributes() | {"y": digest_of(self.y)}
        for name in ("name", "line", "frame", "track", "complete", "tiles", "blocks"):
            del given[name]
        return given

    def attributes(self) -> dict[str, Any]:
        """What a store keeps of it beside its axes."""
        values = dataclasses.asdict(self)
        del values["y"]
        return json.loads(json.dumps(values))  # type: ignore[no-any-return]

    @classmethod
    def of(cls, attributes: Mapping[str, Any], y: FloatArray) -> StripPlan:
        """The inverse of `attributes`."""
        values = dict(attributes)
        values["settings"] = Settings(**values["settings"])
        values["blocks"] = tuple(Block(**block) for block in values["blocks"])
        values["origin"] = tuple(values["origin"])
        if values["depth_map"] is not None:
            values["depth_map"] = tuple(values["depth_map"])
        return cls(y=y, **values)


def begun(plan: StripPlan, navigation: Echoes) -> StripPlan:
    """A strip that starts where the first pings that light it do, in a line of which these are known."""
    strip = plan.strip(1, reaching=True)
    for first, last in _spans(plan, navigation, 0, complete=True):
        low, high = columns_of(reaches_along(plan.laid(navigation[first:last]), strip), strip)
        if high > low:
            return dataclasses.replace(plan, start=float(strip.origin + low * plan.step))
    raise ValueError(f"no ping lights {plan.name}, from y = {plan.y[0]:g} to {plan.y[-1]:g} m: another swath, side or seabed")


def extended(plan: StripPlan, navigation: Echoes, complete: bool) -> StripPlan:
    """A strip with the blocks and tiles of pings that follow those that it has.

    Blocks advance by a tile's length. While more pings are to come the last pings make none, and no tile is counted that only
    they could complete.

    Parameters
    ----------
    plan : StripPlan
    navigation : Echoes
        Of the whole line, in its own coordinates; samples are not looked at.
    complete : bool
        No ping is to come.

    Warns
    -----
    UserWarning
        A block begins no earlier than the tiles that blocks before have completed: what it lights there is left out.

    Notes
    -----
    O(pings).
    """
    strip = plan.strip(1, reaching=True)
    blocks = list(plan.blocks)
    begin = blocks[-1].last if blocks else 0
    final = blocks[-1].final if blocks else 0
    late, where = 0, (0, 0)  # columns that are left out, at most, and by which pings
    for first, last in _spans(plan, navigation, begin, complete):
        some = navigation[first:last]
        reaches = reaches_along(plan.laid(some), strip)
        low, high = columns_of(reaches, strip)
        lit = [end for end in reaches if end is not None]
        if lit and (without := min(high, final * plan.columns) - low) > late:
            late, where = without, (first, last)
        low = max(low, final * plan.columns)
        if lit:
            behind = (lit[-1][0] - SLACK - plan.start) / (plan.step * plan.columns)
            final = max(final, int(np.floor(behind - 1e-9)))
        blocks.append(Block(first, last, low, max(low, high), final, navigation_digest(some)))
    if late > 0:
        left = f"light {late * plan.step:.3g} m of {plan.name} that are complete by then, others less: left out there"
        _checks.warn(f"{plan.line}: pings {where[0]} to {where[1] - 1} {left}, by yaw or as their footprint grows")
    tiles = max((-(-block.high // plan.columns) for block in blocks if block.high > block.low), default=0)
    if complete and blocks:
        blocks[-1] = dataclasses.replace(blocks[-1], final=tiles)
    return dataclasses.replace(plan, blocks=tuple(blocks), tiles=tiles, complete=complete)


def _spans(plan: StripPlan, navigation: Echoes, first: int, complete: bool) -> Iterator[tuple[int, int]]:
    """Pings of the blocks to come: each advances by a tile's length at most, or is one ping."""
    forward = np.array([np.cos(plan.rotation), np.sin(plan.rotation)])
    along = navigation.tx[:, :2] @ forward
    length = plan.columns * plan.step
    while first < along.size:
        beyond = np.flatnonzero(np.abs(along[first:] - along[first]) >= length)
        if not beyond.size and not complete:
            return
        last = first + int(beyond[0]) if beyond.size else int(along.size)
        yield first, last
        first = last


def require_navigation(plan: StripPlan, navigation: Echoes, blocks: Iterable[Block]) -> None:
    """Raise ValueError where a line's navigation is not that of these blocks of its plan."""
    for block in blocks:
        if block.last > navigation.n_ping or navigation_digest(navigation[block.first : block.last]) != block.navigation:
            raise ValueError(
                f"{plan.line}: navigation of pings {block.first} to {block.last - 1} is not what the survey was planned from: "
                "expected the same file, or a new survey, --overwrite"
            )


def navigation_digest(echoes: Echoes) -> str:
    """SHA-256 of everything of echoes that an image depends on but samples."""
    fields = io.echo_fields(echoes)
    names = sorted(fields.keys() - {"data", "attrs", "truth_position", "truth_amplitude", "ping_time"})
    return digest_of(*(part for name in names for part in (np.frombuffer(name.encode(), np.uint8), fields[name])))


def digest_of(*arrays: Any) -> str:
    """SHA-256 of arrays, their shapes and dtypes."""
    found = hashlib.sha256()
    for array in map(np.asarray, arrays):
        found.update(f"{array.dtype.str} {array.shape}".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()
