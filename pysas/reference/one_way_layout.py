"""What the forms of one-way migration share: checks of their arguments, columns and margins, layers, and the steps in range."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import FAN
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.pulse import LFM
from pysas.reference.marching import EQUATIONS, Steps, one_way_wavenumber
from pysas.reference.stripmap import Strip, even_ranges, prepare

PHASE = 0.2  # rad, that steps in range, and differences in x, may each add up to over the march at the beam's edge
STEEPEST = 0.9  # sine beyond which steps do not follow the wave any more
SAMPLED, COMPACT, PLAIN = np.pi, 1.6, 0.8  # k_x dx that samples, and differences of fourth and second order, carry

Layers = list[tuple[float, float | FloatArray]]


def equation(angle: Any) -> tuple[float, float]:
    """alpha, beta of `angle`: 15, 45, 65, or the pair itself."""
    if isinstance(angle, int | np.integer) and int(angle) in EQUATIONS:
        return EQUATIONS[int(angle)]
    wanted = "15, 45, 65 or a pair (alpha, beta) with alpha > 0 and 0 <= beta < 1"
    if np.ndim(angle) != 1 or np.size(angle) != 2:
        raise ValueError(f"angle={angle!r}: expected {wanted}")
    alpha, beta = (float(v) for v in _checks.reals("angle", angle, [(2,)]))
    if alpha <= 0 or not 0 <= beta < 1:
        raise ValueError(f"angle={angle!r}: expected {wanted}")
    return alpha, beta


@dataclass(frozen=True, eq=False)
class Line:
    """A straight track and what is to be imaged.

    Attributes
    ----------
    strip : Strip
        The track, pings in order of growing x.
    data : (column, sample)
        Its samples that the image can need, without margins.
    grid : Grid
    rows : (n,) int
        Row of the image of each depth in `z`.
    z : (n,) float64
        Slant ranges to image, growing, m.
    columns : (m,) int
        Pings of the image's columns.
    layers : list of (top, speed)
    margin : int
        Columns of silence added at either end.
    half_angle : float
        That must focus, rad.
    highest : float
        Largest temporal frequency, Hz.
    period : int
        Samples after which a periodic record may repeat without reaching the image.
    """

    strip: Strip
    data: ComplexArray
    grid: Grid
    rows: npt.NDArray[np.int64]
    z: FloatArray
    columns: npt.NDArray[np.int64]
    layers: Layers
    margin: int
    half_angle: float
    highest: float
    period: int

    @property
    def spacing(self) -> float:
        """Of columns, m."""
        return self.strip.spacing

    @property
    def crossed(self) -> int:
        """Columns that a wave at half_angle crosses on its way to the last row."""
        return int(np.ceil(self.z[-1] * np.tan(self.half_angle) / self.spacing))

    @classmethod
    def of(
        cls, echoes: Echoes, grid: Grid | None, layers: Any, half_angle: float | None, margin: int | None, carried: float
    ) -> Line:
        """Check the arguments of a migration."""
        strip = checked(echoes)
        data = strip.data[:1] if echoes.n_ping == 1 else strip.data
        if grid is None:
            grid = _default_grid(strip, len(data))
        rows, z, columns = _pixels(strip, len(data), grid)
        media = _layers(layers, echoes)
        highest = echoes.fc + min(echoes.fs, echoes.occupied_bandwidth) / 2
        half = beam_angle(echoes, strip.spacing, highest, half_angle, carried)
        # times that rows can need: from broadside of the first to the edge of the beam, or of half a radian, of the last
        reach = np.cos(max(half, 0.5))
        needed = [travel_time(media, depth) for depth in (z[0], z[-1])]
        far = int(np.ceil((needed[1] / reach - strip.start) * echoes.fs)) + skirt(echoes)
        data = data[:, : max(far, 1)]
        before = max(0, int(np.ceil((strip.start - needed[0]) * echoes.fs)))
        period = before + max(far, data.shape[1]) + skirt(echoes)
        line = cls(strip, data, grid, rows, z, columns, media, 0, half, highest, period)
        if margin is None:
            # what leaves must not be back at the last row
            margin = 0 if len(data) == 1 else min(len(data), line.crossed // 2 + 8)
        return dataclasses.replace(line, margin=_checks.whole("margin", margin, 0))

    def split(self, domains: int, overlap: int | None) -> list[tuple[int, Line]]:
        """Sub-domains (first column, line), each with its share of the echoes (a linear partition of unity).

        Their speeds that vary along x go on into the margins.
        """
        n = len(self.data)
        if overlap is None:
            overlap = 2 * self.crossed
        overlap = _checks.whole("overlap", overlap, 0)
        if domains > n:
            raise ValueError(f"domains={domains!r}: expected at most the {n} pings")
        cuts = np.linspace(0, n, domains + 1)
        centre = np.arange(n) + 0.5
        ramp = [np.clip((centre - cut) / max(overlap, 1e-9) + 0.5, 0, 1) for cut in cuts[1:-1]]
        share = [np.ones(n), *ramp, np.zeros(n)]
        parts = []
        for i in range(domains):
            weight = share[i] - share[i + 1]
            first = max(0, int(np.floor(cuts[i] - overlap / 2))) if i else 0
            last = min(n, int(np.ceil(cuts[i + 1] + overlap / 2))) if i < domains - 1 else n
            data = self.data if domains == 1 else self.data[first:last] * weight[first:last, None].astype(self.data.real.dtype)
            layers: Layers = [
                (top, np.pad(speed[first:last], self.margin, "edge") if isinstance(speed, np.ndarray) else speed)
                for top, speed in self.layers
            ]
            parts.append((first, dataclasses.replace(self, data=data, layers=layers)))
        return parts

    def jump(self) -> float:
        """Depth down to which the water is of one speed and holds no row."""
        if np.ndim(self.layers[0][1]):
            return 0.0
        return float(min(self.z[0], self.layers[1][0] if len(self.layers) > 1 else np.inf))

    def steps(self, start: float, step: float | None, fine: int) -> Steps:
        """Steps from depth `start` to the last row, none longer than `step` (m; None: for a phase error of PHASE).

        Speeds that vary along x get `fine` values for each ping.
        """
        speeds = [c if np.ndim(c) == 0 else _between(np.asarray(c), fine) for _, c in self.layers]
        tops = [top for top, _ in self.layers]
        breaks = np.unique(np.concatenate([[start], self.z, [top for top in tops if start < top < self.z[-1]]]))
        length, time, speed, row = [], [], [], []
        where = {depth: i for i, depth in enumerate(self.z)}
        # a first row at the start is read before anything moves: after a step of no length
        pairs = [(start, start)] * (start in where) + list(zip(breaks[:-1], breaks[1:], strict=True))
        for low, high in pairs:
            c = speeds[int(np.searchsorted(tops, low, side="right")) - 1]
            limit = self.longest(c, self.z[-1] - start) if step is None else step
            n = max(1, int(np.ceil((high - low) / limit * (1 - 1e-9))))
            begin = travel_time(list(zip(tops, speeds, strict=True)), low)
            length += [float(f"{(high - low) / n:.10e}")] * n
            time += list(begin + 2 * (high - low) * np.mean(1 / np.asarray(c)) * np.arange(1, n + 1) / n)
            speed += [c] * n
            row += [-1] * (n - 1) + [where.get(high, -1)]
        return Steps(np.array(length), np.array(time), speed, np.array(row), np.ones(len(row)))

    def columns_per_ping(self, start: float) -> int:
        """Odd number for which fourth-order differences, right to (k_x dx)^4/240, err by less than PHASE at the beam's edge."""
        turned = 0.0
        for i, (top, speed) in enumerate(self.layers):
            bottom = min(self.layers[i + 1][0] if i + 1 < len(self.layers) else np.inf, self.z[-1])
            c = float(np.mean(speed))
            turned += edge_turn(self.highest, c, self.half_angle, self.strip.echoes.speed) * max(bottom - max(top, start), 0.0)
        return columns_per_ping(self.highest * self.spacing / self.strip.echoes.speed, self.half_angle, turned)

    def longest(self, speed: float | FloatArray, depth: float) -> float:
        """Step for which Crank-Nicolson's phase b^3/12, b that of a step, adds up to PHASE over `depth` at the beam's edge."""
        return longest_step(self.highest, float(np.mean(speed)), self.half_angle, self.strip.echoes.speed, depth)


def edge_turn(highest: float, speed: float, half_angle: float, outside: float) -> float:
    """|k_z - k| at the beam's edge, rad/m; `half_angle` holds in water of the speed `outside`, and Snell's law elsewhere."""
    sine = min(np.sin(half_angle) * speed / outside, STEEPEST)
    return -float(one_way_wavenumber(np.array(4 * np.pi * highest / speed), np.array(sine**2), EQUATIONS[45]))


def longest_step(highest: float, speed: float, half_angle: float, outside: float, depth: float) -> float:
    """See `Line.longest`."""
    turn = edge_turn(highest, speed, half_angle, outside)
    return float(np.sqrt(12 * PHASE / (turn**3 * max(depth, 1e-12))))


def columns_per_ping(waves: float, half_angle: float, turned: float) -> int:
    """See `Line.columns_per_ping`; `waves`: wavelengths per spacing, `turned`: edge_turn times depth, rad."""
    phase = 4 * np.pi * waves * np.sin(half_angle)
    return int(np.ceil((turned * phase**4 / 240 / PHASE) ** 0.25)) // 2 * 2 + 1


def checked(echoes: Echoes) -> Strip:
    """`prepare`, for one ping too: it is one column with Neumann ends, the same as two equal ones."""
    if isinstance(echoes, Echoes) and echoes.n_ping == 1 and echoes.n_channel == 1:
        echoes = echoes.whole()
        apart = np.array([[0.0, 0, 0], [1.0, 0, 0]])
        twice = np.concatenate([echoes.traces[:, 0]] * 2)
        echoes = Echoes(
            twice, fs=echoes.fs, fc=echoes.fc, tx=echoes.tx + apart, rx=echoes.receivers[:, 0] + apart, c=echoes.speed,
            t0=float(echoes.start_time[0]), bandwidth=echoes.bandwidth, pulse=echoes.pulse, compressed=echoes.compressed,
        )  # fmt: skip
    return prepare(echoes, None)


def beam_angle(echoes: Echoes, spacing: float, highest: float, half_angle: float | None, carried: float) -> float:
    """Half-angle about broadside that must focus, rad; warns where `spacing` is more than `carried`/k_x."""
    k = 4 * np.pi * highest / echoes.speed
    limit = float(np.arcsin(min(carried / (k * spacing), 1.0)))
    if half_angle is not None:
        half = _checks.number("half_angle", half_angle, positive=True)
        if half >= np.pi / 2:
            raise ValueError(f"half_angle={half_angle!r}: expected radians in (0, pi/2)")
    elif echoes.beam is not None:
        # a cone's middle is a direction, a fan's a plane: from broadside no farther than its axis from the track
        if echoes.beam.shape == FAN:
            squint = np.arctan2(np.linalg.norm(echoes.beam.axes[:, 1:], axis=1), np.abs(echoes.beam.axes[:, 0])).max()
        else:
            squint = np.arcsin(np.minimum(np.abs(echoes.beam.boresights[:, 0]), 1.0)).max()
        half = float(min(echoes.beam.half_angle + squint, 1.1))
    else:
        return float(min(np.arcsin(min(min(carried, COMPACT) / (k * spacing), 1.0)), np.radians(15)))
    if half > limit * (1 + 1e-9) and echoes.n_ping > 1:
        warnings.warn(
            f"spacing of pings {spacing:.4g} m: the march carries {carried:.3g}/k_x, at most "
            f"{carried / (k * np.sin(half)):.4g} m for a half-angle of {np.degrees(half):.3g} degrees",
            stacklevel=4,
        )
        # nothing steeper comes through; a beam so wide sets no angle
        return half if half_angle is not None else limit
    return half


def travel_time(layers: Layers, depth: float) -> float:
    """Two-way time straight down to `depth`, s (with the mean of 1/c over the columns)."""
    total = 0.0
    for i, (top, speed) in enumerate(layers):
        bottom = layers[i + 1][0] if i + 1 < len(layers) else np.inf
        total += 2 * max(min(depth, bottom) - top, 0.0) * float(np.mean(1 / np.asarray(speed)))
    return total


def _between(values: FloatArray, fine: int) -> FloatArray:
    """Linear between pings, `fine` values for each."""
    places = (np.arange(values.size * fine) + 0.5) / fine - 0.5
    return np.interp(places, np.arange(values.size), values)


def skirt(echoes: Echoes) -> int:
    """Samples that an echo reaches beyond its travel time: of a compressed pulse its side lobes, of a raw one all of it."""
    length = 0.0
    if not echoes.compressed and echoes.pulse is not None:
        length = echoes.pulse.duration * echoes.fs if isinstance(echoes.pulse, LFM) else float(echoes.pulse.size)
    return 16 + int(np.ceil(4 * echoes.fs / echoes.occupied_bandwidth + length))


def _default_grid(strip: Strip, columns: int) -> Grid:
    near, far = max(strip.swath[0], 0.0), strip.swath[1]
    if far <= 0:
        raise ValueError(f"echoes: the record ends at slant range {far:g} m: expected samples after transmission")
    ranges = even_ranges(near, far, strip.echoes.speed / (2 * strip.echoes.fs))
    return Grid.plane(strip.x0 + strip.spacing * np.arange(columns), strip.y0 + strip.side * ranges, z=strip.z0)


def _pixels(
    strip: Strip, columns: int, grid: Grid
) -> tuple[npt.NDArray[np.int64], FloatArray, npt.NDArray[np.int64]]:  # fmt: skip
    """Rows in order of depth, their depths, and the pings of the columns."""
    if not isinstance(grid, Grid) or grid.kind != "plane":
        raise TypeError(f"grid={grid!r}: expected a pysas.Grid.plane")
    if grid.turned:
        raise ValueError("grid: turned axes: expected those of the echoes' coordinates")
    if abs(float(np.mean(grid.height)) - strip.z0) > 1e-6:
        raise ValueError(f"grid: height {grid.height:g} m: expected that of the track, {strip.z0:g} m (the slant plane)")
    place = (grid.axes["x"] - strip.x0) / strip.spacing
    off = np.abs(place - np.rint(place))
    if off.max() > 1e-3 or place.min() < -0.5 or place.max() > columns - 0.5:
        column = int(np.argmax((off > 1e-3) | (place < -0.5) | (place > columns - 0.5)))
        raise ValueError(f"grid: x={grid.axes['x'][column]:g} m at column {column}: expected the x of a ping")
    depth = strip.side * (grid.axes["y"] - strip.y0)
    rows = np.argsort(depth)
    if depth[rows[0]] < 0 or np.any(np.diff(depth[rows]) <= 0):
        raise ValueError(f"grid: y from {grid.axes['y'][0]:g} m: expected different slant ranges on the sonar's side")
    return rows.astype(np.int64), depth[rows], np.rint(place).astype(np.int64)


def _layers(layers: Any, echoes: Echoes) -> Layers:
    """Layers as (top, speed), the first at the track."""
    if layers is None:
        return [(0.0, echoes.speed)]
    if not isinstance(layers, Sequence) or not layers or any(not isinstance(v, Sequence) or len(v) != 2 for v in layers):
        raise TypeError(f"layers={layers!r}: expected a sequence of pairs (top in m, speed in m/s)")
    found: Layers = []
    for i, (top, speed) in enumerate(layers):
        name = f"layers[{i}]"
        top = _checks.number(name, top, low=0.0)
        if (i == 0) != (top == 0) or (found and top <= found[-1][0]):
            raise ValueError(f"{name}: top {top:g} m: expected tops that grow from 0 at the track")
        if np.ndim(speed):
            values = _checks.reals(name, speed, [(echoes.n_ping,)], ("ping",))
            values = values[::-1] if echoes.tx[0, 0] > echoes.tx[-1, 0] else values
            if values.min() <= 0:
                raise ValueError(f"{name}: speed {values.min():g} m/s: expected speeds > 0")
            found.append((top, values))
        else:
            found.append((top, _checks.number(name, speed, positive=True)))
    return found
