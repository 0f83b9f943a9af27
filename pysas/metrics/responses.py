"""Measures of an image against another and of point responses: relative error, width, side lobes, peak position, phase.

Between pixels an image is read as a band-limited signal. Focused images carry a phase ramp (up to 2 k sin(angle)
rad/m), which may put their spectrum anywhere, even across the Nyquist frequency; so the mean ramp is taken out first
(lag-one correlation), and the rest is interpolated by a sinc under a Kaiser window: right to 1e-6 where the spectrum
then fits within 0.9 of the sampling rate, and local, so that neighbours and borders beyond 48 samples do not matter.
No engine is imported here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import i0

from pysas import _checks
from pysas.model.image import Image

HALF_WIDTH = 48  # of the interpolator, samples
KAISER = 14.0  # transition band 0.905 to 1.095 of the Nyquist frequency
UPSAMPLING = 16

Complex = npt.NDArray[np.complex128]
Float = npt.NDArray[np.float64]


def relative_error(data: Image | npt.ArrayLike, exact: Image | npt.ArrayLike, level: npt.ArrayLike | None = None) -> float:
    """||data - exact||_2 / max(||exact||_2, ||level||_2): the error that `tol` bounds.

    Parameters
    ----------
    data, exact : Image or array_like
        Of one shape.
    level : array_like of that shape, optional
        Incoherent level R of each pixel, as `reference.exact` returns it.

    Returns
    -------
    float
        0 where both are zero, inf where only `exact` (and `level`) is; NaN pixels give nan.

    Raises
    ------
    ValueError
        Shapes that differ.
    """
    found, wanted = pixels("data", data), pixels("exact", exact)
    _same_shape("exact", wanted, found)
    scale = float(np.linalg.norm(wanted))
    if level is not None:
        incoherent = pixels("level", level)
        _same_shape("level", incoherent, found)
        scale = max(scale, float(np.linalg.norm(incoherent)))
    error = float(np.linalg.norm(found - wanted))
    if scale == 0:
        return 0.0 if error == 0 else np.inf if error > 0 else np.nan
    return error / scale


def phase_error(data: Image | npt.ArrayLike, exact: Image | npt.ArrayLike) -> tuple[float, float]:
    """Phase of `data` against `exact`, rad: its rms weighted by |data exact|, and its constant part.

    Parameters
    ----------
    data, exact : Image or array_like
        Of one shape.

    Returns
    -------
    rms : float
        Root of the weighted mean square of the phase difference left after the constant is removed.
    offset : float
        The constant: the phase of sum(data conj(exact)), in (-pi, pi].

    Raises
    ------
    ValueError
        Shapes that differ, non-finite pixels, or no pixel where both are non-zero.
    """
    found, wanted = pixels("data", data), pixels("exact", exact)
    _same_shape("exact", wanted, found)
    if not (np.isfinite(found).all() and np.isfinite(wanted).all()):
        raise ValueError("data, exact: expected finite pixels")
    product = found * wanted.conj()
    weight = np.abs(product)
    if not weight.any():
        raise ValueError("data, exact: expected a pixel where both are non-zero")
    offset = float(np.angle(product.sum()))
    phase = np.angle(product * np.exp(-1j * offset))
    return float(np.sqrt(np.sum(weight * phase**2) / np.sum(weight))), offset


def irw(cut: npt.ArrayLike, spacing: float, level_db: float = -3.0) -> float:
    """Impulse response width: the main lobe's full width where its amplitude is 10^(level_db/20) of the peak.

    At the default -3 dB (amplitude 0.7079) the width of sinc(x) is 0.8844; at half power (-3.0103 dB) it is 0.8859.

    Parameters
    ----------
    cut : (n,) array_like
        Samples through the peak, n >= 3. Complex or signed: band-limited below 0.9/spacing. Real and non-negative
        (a magnitude): its square is what must be band-limited, so that it needs twice as many samples.
    spacing : float
        Sample spacing, m (or any unit: the result has it too).
    level_db : float
        Level of the width relative to the peak, dB, < 0.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        A cut that is not 1-D, not finite or all zero, or whose main lobe stays above the level up to an end.
    """
    spacing = _checks.number("spacing", spacing, positive=True)
    if _checks.number("level_db", level_db) >= 0:
        raise ValueError(f"level_db={level_db!r}: expected a number < 0")
    response = _Cut(cut)
    threshold = 10 ** (level_db / 20) * response.peak
    below = response.fine < threshold
    left = response.top - int(np.argmax(below[: response.top + 1][::-1]))
    right = response.top + int(np.argmax(below[response.top :]))
    if not (below[left] and below[right]):
        raise ValueError(f"cut: the main lobe does not fall to {level_db:g} dB within its {response.samples.size} samples")

    def above(t: float) -> float:
        return float(response.magnitude(np.array([t]))[0]) - threshold

    step = 1 / UPSAMPLING
    end, start = brentq(above, (right - 1) * step, right * step), brentq(above, left * step, (left + 1) * step)
    return spacing * float(end - start)


def pslr(cut: npt.ArrayLike) -> float:
    """Peak side-lobe ratio, dB: the largest magnitude outside the main lobe, relative to the peak.

    The main lobe ends at the first minimum of the magnitude on either side of the peak (a null, if the response has
    one). -inf where the cut holds no side lobe. The sinc has -13.26 dB. Arguments and errors: see `irw`.
    """
    response = _Cut(cut)
    left, right = response.nulls()
    outside = response.fine.copy()
    outside[left : right + 1] = 0
    highest = int(np.argmax(outside))
    if outside[highest] == 0:
        return -np.inf
    return float(20 * np.log10(response.summit(highest) / response.peak))


def islr(cut: npt.ArrayLike) -> float:
    """Integrated side-lobe ratio, dB: energy of the cut outside the main lobe relative to the energy within it.

    The main lobe is that of `pslr`. The endless sinc has -9.68 dB; a cut that ends sooner has less. -inf where the cut
    holds no side lobe. Arguments and errors: see `irw`.
    """
    response = _Cut(cut)
    left, right = response.nulls()
    energy = response.fine**2
    main = float(np.trapezoid(energy[left : right + 1]))
    side = float(np.trapezoid(energy[: left + 1]) + np.trapezoid(energy[right:]))
    with np.errstate(divide="ignore"):
        return float(10 * np.log10(side / main))


def peak_position(
    image: Image | npt.ArrayLike, near: tuple[float, float] | None = None, radius: float | None = None
) -> tuple[float, float]:
    """Position (x, y) of the largest magnitude between the pixels, to 1e-3 pixel for well-sampled peaks.

    Parameters
    ----------
    image : Image on an evenly sampled plane or surface grid, or (rows, columns) array_like
        An array has x = column and y = row.
    near : (x, y), optional
        Where to look; default: everywhere.
    radius : float, optional
        Distance from `near` within which the largest pixel is sought, m (array: pixels). Needs `near`, and `near` it.

    Returns
    -------
    x, y : float
        In grid coordinates, m (array: pixels).

    Raises
    ------
    ValueError
        Another kind of grid, uneven or fewer than 3 x 3 pixels, a non-finite or all-zero image, or no pixel within
        `radius`.
    """
    data, x, y = _plane(image)
    if (near is None) != (radius is None):
        raise ValueError(f"near={near!r}, radius={radius!r}: expected both or neither")
    magnitude = np.abs(data)
    if near is not None:
        where = _checks.reals("near", near, [(2,)])
        reach = _checks.number("radius", radius, positive=True)
        within = np.hypot(x.at(np.arange(x.size)) - where[0], (y.at(np.arange(y.size)) - where[1])[:, None]) <= reach
        if not within.any():
            raise ValueError(f"radius={radius!r}: no pixel within it of near={near!r}")
        magnitude = np.where(within, magnitude, -1.0)
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(magnitude)), magnitude.shape))
    if magnitude[row, column] <= 0:
        raise ValueError("image: expected a non-zero pixel to look for a peak")
    rows, columns = _around(row, y.size), _around(column, x.size)
    patch = _without_ramp(_without_ramp(data[rows, columns], 0)[0], 1)[0]
    found = _climb(patch, np.array([row - rows.start, column - columns.start], dtype=np.float64))
    return float(x.at(found[1] + columns.start)), float(y.at(found[0] + rows.start))


def cut(image: Image | npt.ArrayLike, position: tuple[float, float], axis: str) -> tuple[Complex, float]:
    """Samples of an image along the line through `position` parallel to `axis`.

    Parameters
    ----------
    image : Image on an evenly sampled plane or surface grid, or (rows, columns) array_like
        An array has x = column and y = row.
    position : (x, y)
        In grid coordinates, as `peak_position` returns it. Between two rows or columns the image is interpolated.
    axis : "x" or "y"
        Direction of the line.

    Returns
    -------
    values : complex128 (len(x),) or (len(y),)
        At the grid's own coordinates along `axis`.
    spacing : float
        Their distance, m (array: 1).

    Raises
    ------
    ValueError
        A position outside the image; otherwise as `peak_position`.
    """
    data, x, y = _plane(image)
    _checks.choice("axis", axis, ("x", "y"))
    where = _checks.reals("position", position, [(2,)])
    across, value = (y, where[1]) if axis == "x" else (x, where[0])
    place = (value - across.first) / across.step
    if not -0.5 <= place <= across.size - 0.5:
        raise ValueError(f"position={position!r}: expected a place within the image")
    lines = data if axis == "x" else data.T
    part = _around(int(np.rint(np.clip(place, 0, across.size - 1))), across.size)
    flat, ramp = _without_ramp(lines[part], 0)
    offset = place - part.start
    values = _sinc_kernel(offset - np.arange(flat.shape[0])) @ flat * np.exp(1j * ramp * offset)
    return np.asarray(values), abs((x if axis == "x" else y).step)


def pixels(name: str, value: Image | npt.ArrayLike) -> Complex:
    """Pixels of an image or array, complex128."""
    array = np.asarray(value.data if isinstance(value, Image) else value)
    if array.dtype.kind not in "iufc":
        raise TypeError(f"{name}: expected real or complex numbers, found dtype {array.dtype}")
    return array.astype(np.complex128)


def _same_shape(name: str, found: npt.NDArray[Any], data: npt.NDArray[Any]) -> None:
    if found.shape != data.shape:
        raise ValueError(f"{name}: expected the shape of data {data.shape}, found {found.shape}")


def _sinc_kernel(t: npt.NDArray[np.floating[Any]]) -> Float:
    """Interpolating kernel at distances `t` in samples."""
    inside = np.clip(1 - (t / HALF_WIDTH) ** 2, 0, None)
    return np.asarray(np.where(inside > 0, np.sinc(t) * i0(KAISER * np.sqrt(inside)) / i0(KAISER), 0.0))


def _without_ramp(data: Complex, axis: int) -> tuple[Complex, float]:
    """`data` times exp(-j ramp index) along `axis`, and the ramp (rad per sample) that centres its spectrum on zero."""
    lines = np.moveaxis(data, axis, 0)
    ramp = float(np.angle(np.vdot(lines[:-1], lines[1:])))
    flat = np.exp(-1j * ramp * np.arange(lines.shape[0])).reshape((-1,) + (1,) * (lines.ndim - 1)) * lines
    return np.moveaxis(flat, 0, axis), ramp


def _maximum(function: Callable[[Float], float], start: Float, step: float = 0.25) -> Float:
    """Place of the maximum near `start`: the top of the parabola through 3^dims points, ever finer."""
    centre, one = start, np.eye(start.size)
    for _ in range(3):
        for _ in range(4):

            def value(*moves: Float, origin: Float = centre, step: float = step) -> float:
                return function(origin + step * np.sum(moves, axis=0))

            ahead, behind = np.array([value(e) for e in one]), np.array([value(-e) for e in one])
            gradient = (ahead - behind) / 2
            hessian = np.diag(ahead + behind - 2 * function(centre))
            for i, j in np.ndindex(hessian.shape):
                if i != j:
                    e, f = one[i], one[j]
                    hessian[i, j] = (value(e, f) + value(-e, -f) - value(e, -f) - value(-e, f)) / 4
            if np.linalg.eigvalsh(hessian).max() < 0:
                move = np.clip(-np.linalg.solve(hessian, gradient), -2, 2)
            else:  # no top nearby: walk uphill
                move = np.sign(gradient)
            centre = np.clip(centre + step * move, start - 1, start + 1)
        step /= 5
    return centre


def _climb(patch: Complex, start: Float) -> Float:
    rows, columns = np.arange(patch.shape[0]), np.arange(patch.shape[1])

    def power(place: Float) -> float:
        return float(np.abs(_sinc_kernel(place[0] - rows) @ patch @ _sinc_kernel(place[1] - columns)) ** 2)

    return _maximum(power, start)


def _around(index: int, size: int) -> slice:
    """The samples that an interpolation near `index` needs."""
    return slice(max(0, index - HALF_WIDTH - 2), min(size, index + HALF_WIDTH + 3))


class _Axis:
    """Evenly spaced coordinates."""

    def __init__(self, name: str, values: Float) -> None:
        if values.size < 3:
            raise ValueError(f"image: expected at least 3 pixels along {name}, found {values.size}")
        self.first = float(values[0])
        self.step = float(values[-1] - values[0]) / (values.size - 1)
        self.size = values.size
        if self.step == 0 or np.max(np.abs(values - self.at(np.arange(values.size)))) > 1e-6 * abs(self.step):
            raise ValueError(f"image: expected an evenly spaced axis {name}")

    def at(self, place: Any) -> Any:
        return self.first + self.step * place


def _plane(image: Image | npt.ArrayLike) -> tuple[Complex, _Axis, _Axis]:
    data = pixels("image", image)
    if isinstance(image, Image):
        if image.grid.kind not in ("plane", "surface"):
            raise ValueError(f"image: expected a plane or surface grid, found {image.grid.kind} (or pass image.data)")
        x, y = image.grid.axes["x"], image.grid.axes["y"]
    else:
        if data.ndim != 2:
            raise ValueError(f"image: expected (rows, columns), found shape {data.shape}")
        y, x = (np.arange(size, dtype=np.float64) for size in data.shape)
    if not np.isfinite(data).all():
        raise ValueError("image: expected finite pixels")
    return data, _Axis("x", x), _Axis("y", y)


class _Cut:
    """A cut as a continuous magnitude: sampled UPSAMPLING times finer, and at any place (in samples)."""

    def __init__(self, values: npt.ArrayLike) -> None:
        found = np.asarray(values)
        samples = pixels("cut", found)
        if samples.ndim != 1 or samples.size < 3:
            raise ValueError(f"cut: expected a vector of at least 3 samples, found shape {samples.shape}")
        if not np.isfinite(samples).all() or not samples.any():
            raise ValueError("cut: expected finite samples, not all zero")
        self.scale = float(np.max(np.abs(samples)))
        samples = samples / self.scale
        # A magnitude has cusps at its nulls; its square is smooth there.
        self.squared = found.dtype.kind != "c" and bool(np.all(samples.real >= 0))
        self.samples = _without_ramp(samples**2 if self.squared else samples, 0)[0]
        self.fine = self._upsample()
        self.top = int(np.argmax(self.fine))
        self.peak = self.summit(self.top)

    def summit(self, index: int) -> float:
        """Magnitude at the top of the parabola through the fine sample `index` and its neighbours."""
        if index in (0, self.fine.size - 1):
            return float(self.fine[index])
        before, here, after = (float(value) for value in self.fine[index - 1 : index + 2])
        bend = 2 * here - before - after
        return here + (after - before) ** 2 / (8 * bend) if bend > 0 and here >= max(before, after) else here

    def magnitude(self, place: Float) -> Float:
        values = _sinc_kernel(place[:, None] - np.arange(self.samples.size)) @ self.samples
        return self._finish(values)

    def _finish(self, values: Complex) -> Float:
        return self.scale * (np.sqrt(np.clip(values.real, 0, None)) if self.squared else np.abs(values))

    def _upsample(self) -> Float:
        phases = np.empty((self.samples.size, UPSAMPLING), dtype=np.complex128)
        lags = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
        for phase in range(UPSAMPLING):
            kernel = _sinc_kernel(lags + phase / UPSAMPLING)
            phases[:, phase] = np.convolve(self.samples, kernel)[HALF_WIDTH : HALF_WIDTH + self.samples.size]
        return self._finish(phases.ravel()[: (self.samples.size - 1) * UPSAMPLING + 1])

    def nulls(self) -> tuple[int, int]:
        """Fine indices of the first minimum on either side of the peak (the ends, where there is none)."""
        rising = np.diff(self.fine) > 0
        after, before = np.flatnonzero(rising[self.top :]), np.flatnonzero(~rising[: self.top])
        left = int(before[-1]) + 1 if before.size else 0
        right = self.top + int(after[0]) if after.size else self.fine.size - 1
        return left, right
