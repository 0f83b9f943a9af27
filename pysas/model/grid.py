"""Grid: the points to image - planes, polar sectors, height-mapped surfaces, volumes or any list - with an optional mask.

A grid knows its coordinates, of which it keeps its own copies, and nothing of echoes. Pixels are numbered in C order of
`shape`; the last axis is the one the engines walk along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray

BoolArray = npt.NDArray[np.bool_]
KINDS = ("plane", "polar", "surface", "volume", "points")


@dataclass(frozen=True, eq=False, repr=False)
class Grid:
    """Points to image; made by `plane`, `polar`, `surface`, `volume` or `points`.

    Attributes
    ----------
    kind : str
        Which of the five.
    shape : tuple of int
        Shape of an image on this grid.
    axes : dict of str to (n,) float64
        Coordinate vectors, m (angle: rad), in the order of the constructor's arguments; empty for points.
    mask : bool array of `shape`, or None
        False: the pixel is not computed and stays 0.
    origin : (x, y)
        Where the axes of a plane or a surface begin, m.
    rotation : float
        By how much they are turned about it, rad, from x towards y: 0 where they are those of the echoes' coordinates.
    """

    kind: str
    shape: tuple[int, ...]
    axes: Mapping[str, FloatArray]
    mask: BoolArray | None = None
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height: float | FloatArray = 0.0
    coords: FloatArray | None = None
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0

    @classmethod
    def plane(
        cls,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        z: float = 0.0,
        *,
        origin: npt.ArrayLike = (0.0, 0.0),
        rotation: float = 0.0,
        mask: npt.ArrayLike | None = None,
    ) -> Grid:
        """Horizontal plane at height `z`; shape (len(y), len(x)).

        Its axes may begin at an `origin` (x, y), m, and be turned about it by a `rotation`, rad, from x towards y, such as to
        lie along a track: pixels are origin + x (cos, sin) + y (-sin, cos).
        """
        axes = {"x": _axis("x", x), "y": _axis("y", y)}
        fields = {"height": _checks.number("z", z)} | _frame(origin, rotation)
        return cls._made("plane", axes, (axes["y"].size, axes["x"].size), mask, **fields)

    @classmethod
    def polar(
        cls,
        r: npt.ArrayLike,
        angle: npt.ArrayLike,
        centre: npt.ArrayLike = (0.0, 0.0, 0.0),
        *,
        mask: npt.ArrayLike | None = None,
    ) -> Grid:
        """Points centre + r (cos angle, sin angle, 0); shape (len(angle), len(r)); `r` in m, `angle` in rad."""
        axes = {"r": _axis("r", r), "angle": _axis("angle", angle)}
        x, y, z = _checks.reals("centre", centre, [(3,)])
        return cls._made("polar", axes, (axes["angle"].size, axes["r"].size), mask, centre=(float(x), float(y), float(z)))

    @classmethod
    def surface(
        cls,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        z: npt.ArrayLike,
        *,
        origin: npt.ArrayLike = (0.0, 0.0),
        rotation: float = 0.0,
        mask: npt.ArrayLike | None = None,
    ) -> Grid:
        """Height map `z` of shape (len(y), len(x)) over the coordinate vectors `x` and `y`, which lie as in `plane`."""
        axes = {"x": _axis("x", x), "y": _axis("y", y)}
        shape = (axes["y"].size, axes["x"].size)
        fields = {"height": _checks.reals("z", z, [shape], ("row", "column"))} | _frame(origin, rotation)
        return cls._made("surface", axes, shape, mask, **fields)

    @classmethod
    def _of_heights(cls, x: npt.ArrayLike, y: npt.ArrayLike, z: FloatArray) -> Grid:
        """A surface whose finite heights stay where they are: who changes them uses the grid no more."""
        axes = {"x": _axis("x", x), "y": _axis("y", y)}
        return cls._made("surface", axes, (axes["y"].size, axes["x"].size), None, height=z)

    @classmethod
    def volume(cls, x: npt.ArrayLike, y: npt.ArrayLike, z: npt.ArrayLike, *, mask: npt.ArrayLike | None = None) -> Grid:
        """Box of points; shape (len(z), len(y), len(x))."""
        axes = {"x": _axis("x", x), "y": _axis("y", y), "z": _axis("z", z)}
        return cls._made("volume", axes, (axes["z"].size, axes["y"].size, axes["x"].size), mask)

    @classmethod
    def points(cls, points: npt.ArrayLike, *, mask: npt.ArrayLike | None = None) -> Grid:
        """Any points (..., 3), m; shape points.shape[:-1]."""
        array = _checks.array_like("points", points)
        shape: tuple[int | str, ...] = (*array.shape[:-1], 3) if array.ndim > 1 else ("...", 3)
        coords = _checks.reals("points", points, [shape], ("point",))
        return cls._made("points", {}, coords.shape[:-1], mask, coords=coords)

    @classmethod
    def _made(cls, kind: str, axes: dict[str, FloatArray], shape: tuple[int, ...], mask: Any, **fields: Any) -> Grid:
        if 0 in shape:
            raise ValueError(f"points: expected at least one point, found shape {shape}")
        if mask is not None:
            mask = _checks.array_like("mask", mask)
            if mask.dtype != np.bool_:
                raise TypeError(f"mask: expected booleans, found dtype {mask.dtype}")
            if mask.shape != shape:
                raise ValueError(f"mask: expected the grid's shape {shape}, found {mask.shape}")
            mask = _checks.own(mask, np.bool_)
        return cls(kind, shape, axes, mask, **fields)

    @property
    def size(self) -> int:
        """Number of pixels."""
        return int(np.prod(self.shape))

    def within(self, **spans: tuple[float, float]) -> tuple[Grid, tuple[Any, ...]]:
        """The grid within spans (low, high) of its axes, ends included, by their names; and the index of its pixels in this."""
        chosen: dict[str, slice | npt.NDArray[np.intp]] = dict.fromkeys(self.axes, slice(None))
        for name, span in spans.items():
            if name not in self.axes:
                raise ValueError(
                    f"{name}={span!r}: expected one of the axes of a {self.kind}: {', '.join(self.axes) or 'none'}"
                )
            low, high = _checks.reals(name, span, [(2,)])
            number = np.flatnonzero((self.axes[name] >= low) & (self.axes[name] <= high))
            if number.size == 0:
                ends = f"{self.axes[name].min():.6g} to {self.axes[name].max():.6g}"
                raise ValueError(f"{name}={span!r}: holds no pixel: expected a span of {ends}")
            chosen[name] = slice(int(number[0]), int(number[-1]) + 1) if number[-1] - number[0] + 1 == number.size else number
        index: tuple[Any, ...] = tuple(chosen[name] for name in list(self.axes)[::-1])
        if any(isinstance(part, np.ndarray) for part in index):
            index = np.ix_(*(np.arange(n)[part] for part, n in zip(index, self.shape, strict=True)))
        axes = {name: axis[chosen[name]] for name, axis in self.axes.items()}
        height = self.height[index] if isinstance(self.height, np.ndarray) else self.height
        mask = None if self.mask is None else self.mask[index]
        return dataclasses.replace(
            self, shape=np.broadcast_to(False, self.shape)[index].shape, axes=axes, height=height, mask=mask
        ), index

    @property
    def turned(self) -> bool:
        """Whether its axes are others than those of the coordinates."""
        return self.rotation != 0 or self.origin != (0.0, 0.0)

    def along_axes(self, points: npt.ArrayLike) -> FloatArray:
        """Where points (n, 2 or 3), m, lie along the axes x and y of a plane or a surface, (n, 2); for others their x and y."""
        places = _checks.reals("points", points, [("n", 2), ("n", 3)], ("point",))[:, :2]
        if not self.turned:
            return places
        (x, y), cos, sin = (places - self.origin).T, np.cos(self.rotation), np.sin(self.rotation)
        return np.stack([cos * x + sin * y, cos * y - sin * x], axis=1)

    def coordinates(self, pixels: npt.ArrayLike | None = None) -> FloatArray:
        """Coordinates (n, 3), m, of flat pixel indices (default: all, in C order)."""
        flat = np.arange(self.size) if pixels is None else _checks.array_like("pixels", pixels)
        if flat.dtype.kind not in "iu" or flat.ndim != 1:
            raise TypeError(f"pixels: expected a 1-D array of whole numbers, found shape {flat.shape}, dtype {flat.dtype}")
        if flat.size and (int(flat.min()) < 0 or int(flat.max()) >= self.size):
            raise ValueError(f"pixels: expected 0 <= pixel < {self.size}, found {flat.min()} to {flat.max()}")
        if self.coords is not None:
            return self.coords.reshape(-1, 3)[flat]
        index = np.unravel_index(flat, self.shape)
        points = np.empty((flat.size, 3))
        if self.kind == "polar":
            angle, r = self.axes["angle"][index[0]], self.axes["r"][index[1]]
            points[:, 0] = self.centre[0] + r * np.cos(angle)
            points[:, 1] = self.centre[1] + r * np.sin(angle)
            points[:, 2] = self.centre[2]
            return points
        points[:, 0] = self.axes["x"][index[-1]]
        points[:, 1] = self.axes["y"][index[-2]]
        if self.kind == "volume":
            points[:, 2] = self.axes["z"][index[0]]
        else:
            points[:, 2] = np.asarray(self.height).reshape(-1)[flat] if np.ndim(self.height) else self.height
        if self.turned:
            cos, sin = np.cos(self.rotation), np.sin(self.rotation)
            x, y = points[:, 0].copy(), points[:, 1].copy()
            points[:, 0] = self.origin[0] + (cos * x - sin * y)
            points[:, 1] = self.origin[1] + (sin * x + cos * y)
        return points

    def __repr__(self) -> str:
        def span(name: str, values: FloatArray) -> str:
            unit = "rad" if name == "angle" else "m"
            step = f" every {(values[-1] - values[0]) / (values.size - 1):.4g} {unit}" if values.size > 1 else ""
            digits = 6 if np.max(np.abs(values)) < 1e4 else 10
            return f"  {name:<10} {values[0]:.{digits}g} to {values[-1]:.{digits}g} {unit}{step}"

        lines = [f"Grid: {self.kind}, {' x '.join(str(n) for n in self.shape)} pixels"]
        lines += [span(name, values) for name, values in self.axes.items()]
        if self.kind == "plane":
            lines.append(f"  z          {self.height:g} m")
        elif self.kind == "surface":
            lines.append(f"  z          {np.min(self.height):.4g} to {np.max(self.height):.4g} m")
        elif self.kind == "polar":
            lines.append(f"  centre     {self.centre} m")
        if self.turned:
            x, y = self.origin
            lines.append(
                f"  axes       from ({x:.10g}, {y:.10g}) m, turned by {np.degrees(self.rotation):.4g} deg from x towards y"
            )
        if self.mask is not None:
            lines.append(f"  mask       {np.count_nonzero(self.mask)} of {self.size} pixels imaged")
        return "\n".join(lines)


def _frame(origin: npt.ArrayLike, rotation: float) -> dict[str, Any]:
    x, y = _checks.reals("origin", origin, [(2,)])
    return {"origin": (float(x), float(y)), "rotation": _checks.number("rotation", rotation, low=-2 * np.pi, high=2 * np.pi)}


def _axis(name: str, values: npt.ArrayLike) -> FloatArray:
    axis = _checks.reals(name, values, [("n",)])
    if axis.size == 0:
        raise ValueError(f"{name}: expected at least one coordinate, found none")
    return axis
