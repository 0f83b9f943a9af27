"""Image: complex pixels on a grid with the report of how they were made."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.grid import Grid


@dataclass(frozen=True)
class Report:
    """How an image was made.

    Attributes
    ----------
    method : str
        Algorithm, such as "backprojection".
    tol, predicted_error : float or None
        Relative error asked for, and the planner's bound for its choices.
    backend, isa : str
        Engine ("numba", "cpp") and instruction set.
    threads, terms : int
        Worker threads; (ping, channel, pixel) terms summed.
    prepare_seconds, sum_seconds : float
        Wall time of the data's transforms and of the sum.
    share_left_out, factorised_share : float
        Share of all terms that was not needed; share summed through sub-apertures.
    choices : dict
        The planner's settings.
    notes : tuple of str
        What a person should know, such as an image wholly outside the recorded window.
    """

    method: str
    tol: float | None = None
    backend: str = ""
    isa: str = ""
    threads: int = 0
    prepare_seconds: float = 0.0
    sum_seconds: float = 0.0
    terms: int = 0
    share_left_out: float = 0.0
    factorised_share: float = 0.0
    predicted_error: float | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain types, ready for JSON."""
        return dataclasses.asdict(self) | {"notes": list(self.notes)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Report:
        """The inverse of `as_dict`; unknown names are an error."""
        names = {f.name for f in dataclasses.fields(cls)}
        unknown = set(values) - names
        if unknown or "method" not in values:
            raise ValueError(f"report: found {sorted(values)}, expected 'method' and some of {sorted(names - {'method'})}")
        return cls(**{**values, "notes": tuple(values.get("notes", ()))})


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """Complex image.

    Attributes
    ----------
    data : complex array of grid.shape
        Sum of s(tau) exp(+2j pi fc tau) over pings and channels.
    grid : Grid
    report : Report
    fc, c : float
        Demodulation frequency, Hz, and sound speed, m/s, of the echoes.
    """

    data: ComplexArray
    grid: Grid
    report: Report
    fc: float
    c: float

    def __post_init__(self) -> None:
        if not isinstance(self.grid, Grid):
            raise TypeError(f"grid={self.grid!r}: expected a pysas.Grid")
        if not isinstance(self.report, Report):
            raise TypeError(f"report={self.report!r}: expected a Report")
        data = _checks.array_like("data", self.data)
        if data.dtype.kind != "c":
            raise TypeError(f"data: expected complex pixels, found dtype {data.dtype}")
        if data.shape != self.grid.shape:
            raise ValueError(f"data: expected the grid's shape {self.grid.shape}, found {data.shape}")
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "fc", _checks.number("fc", self.fc, positive=True))
        object.__setattr__(self, "c", _checks.number("c", self.c, positive=True))

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """The pixels: np.asarray(image) is `data`, and NumPy's functions take images."""
        return np.array(self.data, dtype=dtype, copy=copy)

    def __getitem__(self, index: Any) -> Any:
        """Pixels, as of `data`: image[...] is all of them; `crop` keeps their grid."""
        return self.data[index]

    def crop(self, **spans: tuple[float, float]) -> Image:
        """The image within spans of its axes, ends included; pixels are shared, not copied, where axes ascend or descend.

        Parameters
        ----------
        **spans : (low, high)
            By the name of an axis of its grid, m (angle: rad): image.crop(x=(0, 5), y=(20, 30)).

        Raises
        ------
        ValueError, TypeError
            No such axis, a span that is none or holds no pixel.
        """
        grid, where = self.grid.within(**spans)
        return dataclasses.replace(self, data=self.data[where], grid=grid)

    def db(self, reference: float | None = None) -> FloatArray:
        """Magnitude in dB below `reference` (amplitude; default: the largest). Zero pixels are -inf; all zero: all -inf."""
        magnitude = np.abs(self.data).astype(np.float64)
        level = float(magnitude.max()) if reference is None else _checks.number("reference", reference, positive=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(20 * np.log10(magnitude / (level or 1.0)))

    def to_xarray(self) -> Any:
        """The image as an `xarray.DataArray` with axes in metres (needs the extra `xarray`).

        `to_netcdf` writes complex pixels with engine="h5netcdf", or engine="netcdf4" and auto_complex=True.
        """
        try:
            import xarray
        except ImportError:
            raise _checks.optional("xarray", "xarray") from None
        grid = self.grid
        dims = {"plane": ("y", "x"), "surface": ("y", "x"), "polar": ("angle", "r"), "volume": ("z", "y", "x")}.get(
            grid.kind, tuple(f"point_{i}" for i in range(len(grid.shape)))
        )
        coords: dict[str, Any] = {
            name: (name, axis, {"units": "rad" if name == "angle" else "m"}) for name, axis in grid.axes.items()
        }
        if grid.kind == "surface":
            coords["height"] = (dims, np.asarray(grid.height), {"units": "m"})
        if grid.coords is not None:
            coords |= {name: (dims, grid.coords[..., i], {"units": "m"}) for i, name in enumerate("xyz")}
        attrs: dict[str, Any] = {"fc": self.fc, "c": self.c, "method": self.report.method}
        if grid.turned:
            attrs |= {"origin": grid.origin, "rotation": grid.rotation}
        return xarray.DataArray(self.data, dims=dims, coords=coords, name="image", attrs=attrs)

    def __repr__(self) -> str:
        report = self.report
        peak = float(np.max(np.abs(self.data)))
        where: npt.NDArray[Any] = self.grid.coordinates(np.array([int(np.argmax(np.abs(self.data)))]))[0]
        tol = "" if report.tol is None else f", tol {report.tol:g}"
        lines = [
            f"Image: {self.data.dtype}, {report.method}{tol}, {report.backend} {report.threads} threads",
            f"  peak       {peak:.4g} at x {where[0]:.4f}, y {where[1]:.4f}, z {where[2]:.4f} m",
            f"  time       {report.prepare_seconds:.3f} s preparation, {report.sum_seconds:.3f} s sum, "
            f"{report.terms:.4g} terms",
        ]
        lines += [f"  note       {note}" for note in report.notes]
        return "\n".join(lines + ["  " + line for line in repr(self.grid).splitlines()])
