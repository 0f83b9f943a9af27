"""Back-projection: the exact sum over pings and channels, kept within a stated relative error.

This module checks what comes in, carries out a plan's choices on the engine and writes the report. Choices are made in
planner.py and choices.py, arithmetic in engine/.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks, amplitudes, bounds, engine, factorised, levels, planner, plans, view_angles
from pysas._checks import ComplexArray, FloatArray
from pysas.echoes import Echoes
from pysas.engine import BLOCK, native, preparation, summation
from pysas.engine.summation import Survey, Tile, Totals
from pysas.engine.traces import MODEL, record
from pysas.grid import Grid
from pysas.image import Image, Report
from pysas.scene import Scene


def backproject(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    weights: npt.ArrayLike | str | None = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """Sum s(tau) exp(+2j pi fc tau) over pings and channels at every pixel of `grid`.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed echoes; any track and array, moving receivers included.
    grid : Grid
    tol : float
        Relative error that is kept: ||I - I_exact||_2 <= tol max(||I_exact||_2, ||R||_2) over the grid, where I_exact is
        `pysas.reference.exact` and R the incoherent level it returns. complex64: 1e-1 to 1e-5; complex128: down to
        max(1e-10, 1e-14 range/wavelength).
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS, else all processors. The image is the same for any number.
    backend : {"auto", "numba", "cpp"}
    weights : (ping,) or (ping, channel) array_like, or "uniform-angle", optional
        Real or complex factors of the terms; 0 leaves a trace out. "uniform-angle": each term weighs what
        `pysas.circular.view_weights` says, the arc of view angles that it stands for, so that the point spread function
        is the same all over the image; a small part of `tol` is theirs. Where views change their order over the image every
        pixel has its own arcs, some twenty times slower; `print(plan)` tells.
    nan : {"raise", "mask"}
        Traces that hold non-finite samples: an error, or left out of the sum.
    out : complex array of grid.shape, optional
        Filled in place and returned as the image's data; of the data's dtype, in memory of its own.
    progress : callable, optional
        Called now and then from the calling thread with the share done, 0 to 1.

    Returns
    -------
    Image
        Of the data's dtype; `image.report` says what was done.

    Raises
    ------
    ValueError
        Raw or under-sampled echoes, a `tol` that cannot be met, non-finite samples, wrong shapes, an `out` that overlaps the
        data or itself, an image beyond its dtype's range.
    TypeError
        Wrong types or dtypes; masked entries of a masked array.

    Warns
    -----
    UserWarning
        No term is summed, and why (recorded window, beam, mask, weights, non-finite samples): the image is zero. An image so
        small that its dtype does not hold it within tol.

    Notes
    -----
    O(pings channels pixels) after O(pings channels samples log samples); memory beyond input and image about 25 MB.
    """
    check_out_of(out, echoes, grid, progress)
    plan = planner.plan(echoes, grid, tol, "backprojection", threads, backend, weights, nan)
    return plan(echoes.data, out, progress)


def backproject_arrays(
    data: Any,
    pixels: Any,
    *,
    fs: float,
    fc: float,
    tx: Any,
    rx: Any,
    c: float = 1500.0,
    t0: Any = 0.0,
    velocity: Any = None,
    bandwidth: float | None = None,
    weights: npt.ArrayLike | str | None = None,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    out: ComplexArray | None = None,
) -> ComplexArray:
    """`backproject` for other people's programs: plain arrays in, the image's array out.

    Parameters
    ----------
    data : (ping, channel, sample) or (ping, sample) complex array
        Range-compressed samples, as in `Echoes`; anything with `__array_interface__`, `__dlpack__` on the CPU, or the
        buffer protocol, read where it lies.
    pixels : (..., 3) array
        Pixels, m. Where the last but one axis runs along even lines, as in a regular image, the fast path is taken.
    fs, fc, tx, rx, c, t0, velocity, bandwidth
        As in `Echoes`.
    weights, tol, threads, backend
        As in `backproject`.
    out : complex array of shape pixels.shape[:-1], optional
        Filled in place and returned.

    Returns
    -------
    complex array of shape pixels.shape[:-1]

    Raises
    ------
    ValueError, TypeError
        As `Echoes`, `Grid.points` and `backproject` do.
    """
    echoes = Echoes(data, fs=fs, fc=fc, tx=tx, rx=rx, c=c, t0=t0, velocity=velocity, bandwidth=bandwidth)
    return backproject(echoes, Grid.points(pixels), tol, threads, backend, weights, out=out).data


def check_out_of(out: ComplexArray | None, echoes: Any, grid: Any, progress: Any = None) -> None:
    """Check `out` and `progress` before any work, where what `out` must fit is what it should be."""
    _checks.callback("progress", progress)
    if isinstance(echoes, Echoes) and isinstance(grid, Grid):
        _checks.target(out, grid.shape, echoes.dtype)
        _checks.apart(out, echoes.data)


@_checks.usual_errors
def execute(plan: plans.Plan, data: npt.ArrayLike, out: ComplexArray | None, progress: Callable[[float], None] | None) -> Image:
    """Carry out `plan` on `data`; what `Plan.__call__` does."""
    scene, choices, grid, asked = plan.scene, plan.choices, plan.grid, plan
    samples = _checks.samples("data", data, (2, 3)).view()  # whose shape nobody else can set
    if samples.shape != plan.data_shape:
        raise ValueError(f"data: expected the planned shape {plan.data_shape}, found {samples.shape}")
    if samples.dtype.itemsize != plan.dtype.itemsize:
        raise TypeError(f"data: expected {plan.dtype}, found {samples.dtype}")
    _checks.callback("progress", progress)
    _checks.target(out, grid.shape, plan.dtype)
    _checks.apart(out, samples)
    notes = []

    cpp = plan.backend == "cpp"
    start = _starts(plan)
    begin, end = (np.clip(at, 0, scene.n_sample) for at in (start - choices.taps, start + choices.length + choices.taps))
    peaks = (native.peaks if cpp else summation.peaks)(samples, begin, end, plan.threads).reshape(-1)
    finite = np.isfinite(peaks)
    if not finite.all():
        bad = np.flatnonzero(~finite)
        if plan.nan == "raise":
            ping, channel = divmod(int(bad[0]), scene.channels)
            raise ValueError(f"data: non-finite sample at ping {ping}, channel {channel}: expected finite (or nan='mask')")
        notes.append(f"{len(bad)} of {scene.traces} traces left out: non-finite samples")
    used = scene.heard & finite & (scene.weights != 0)
    exponents = amplitudes.largest(scene.weights[used], peaks[used])
    scale = amplitudes.scale_of(exponents)
    order = np.flatnonzero(used)
    plan = levels.fit(plan, samples, used, scale)
    image = np.zeros(grid.shape, dtype=plan.dtype) if out is None else np.asarray(out)
    image[...] = 0
    choices = plan.choices
    if plan.why_direct:
        notes.insert(0, f"summed directly: {plan.why_direct}")
    notes += [] if plan is asked else levels.notes(plan)

    totals = Totals(0.0, 0.0, 0)
    isa = engine.isa(plan.backend)
    if order.size:
        frame, reader = plan.frame, plan.reader
        trigonometry = bounds.trigonometry(choices.trigonometry)[0]
        flat = None if plan.wide else _as_lines(image, frame.shape)
        target = np.zeros(frame.shape, dtype=np.complex128 if plan.wide else plan.dtype) if flat is None else flat
        real = np.dtype(choices.precision)
        if plan.forest is not None:
            totals = factorised.accumulate(
                plan, samples, used, lambda part: _survey(plan, part), scale, trigonometry, bounds.trigonometry(6)[0], target,
                isa, progress,
            )  # fmt: skip
        else:

            def add(frame: Frame, survey: Survey, target: ComplexArray, tick: Callable[[float], None] | None) -> Totals:
                if isinstance(reader, native.Reader):
                    return native.accumulate(
                        samples, order, survey, reader, scale, frame, trigonometry, real, choices.batch, target,
                        plan.threads, isa, tick,
                    )  # fmt: skip
                return summation.accumulate(
                    samples, order, survey, reader, scale, frame.tiles(), frame.locate, frame.straight, frame.count,
                    trigonometry, real, choices.batch, target, plan.threads, tick,
                )  # fmt: skip

            survey = _survey(plan, order)
            totals = (
                _add_each(plan, order, survey, target, add, progress) if scene.each else add(frame, survey, target, progress)
            )
        target = target.astype(plan.dtype, copy=False)
        if real == np.float32 and amplitudes.wide(exponents):
            if max(np.abs(target.real).max(), np.abs(target.imag).max()) < amplitudes.LOST:
                worst = divmod(int(order[np.argmax(exponents)]), scene.channels)
                notes.append(f"the image is lost beside ping {worst[0]}, channel {worst[1]}: leave it out by weight 0")
                warnings.warn(notes[-1], stacklevel=5)
        if small := amplitudes.restore(target, scale, order.size, plan.tol):
            notes.append(small)
            warnings.warn(small, stacklevel=5)
        if flat is None:
            image[...] = target.reshape(grid.shape)
        if grid.mask is not None:
            image[~grid.mask] = 0
    if progress is not None:
        progress(1.0)
    if totals.terms == 0:
        notes.append(scene.why_empty(finite) or scene.why_dark())
        if not plan.silent:  # or the plan has warned
            warnings.warn(notes[-1], stacklevel=5)
    everything = scene.traces * grid.size
    report = Report(
        method=plan.method, tol=plan.tol, backend=plan.backend, isa=isa, threads=plan.threads,
        prepare_seconds=totals.prepare_seconds, sum_seconds=totals.sum_seconds, terms=totals.terms,
        share_left_out=1 - totals.terms / everything,
        factorised_share=plan.forest.share if plan.forest is not None else 0.0, predicted_error=choices.predicted_error,
        choices=dict(plan.reported), notes=tuple(notes),
    )  # fmt: skip
    return Image(image, grid, report, scene.fc, scene.c)


def _partly(progress: Callable[[float], None] | None, done: float, more: float) -> Callable[[float], None] | None:
    """What tells `progress` of a part of the work, `more` of it after what is `done`."""
    return None if progress is None else lambda share: progress(done + more * share)


def _add_each(
    plan: plans.Plan,
    order: npt.NDArray[np.int64],
    survey: Survey,
    target: ComplexArray,
    add: Callable[[Frame, Survey, ComplexArray, Callable[[float], None] | None], Totals],
    progress: Callable[[float], None] | None,
) -> Totals:
    """`add` pixels with their own weights of traces `order`, so many at a time as these have room for."""
    scene, grid, real = plan.scene, plan.grid, np.dtype(plan.choices.precision)
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    at_once = min(native.SLAB, max(1, view_angles.BYTES // (real.itemsize * order.size * BLOCK)) * BLOCK)
    totals = Totals(0.0, 0.0, 0)
    for begin in range(0, wanted.size, at_once):
        pixels = wanted[begin : begin + at_once]
        frame = Frame(Grid.points(grid.coordinates(pixels)), scene, 0)
        clock = time.perf_counter()
        own = np.zeros((-(-pixels.size // frame.count) * frame.count, order.size), dtype=real)  # rows of whole blocks
        view_angles.fill(scene, frame.points(0, pixels.size), order, own, plan.threads, plan.backend)
        weighed = time.perf_counter() - clock
        part = np.zeros((1, pixels.size), dtype=target.dtype)
        some = add(frame, replace(survey, own=own), part, _partly(progress, begin / wanted.size, pixels.size / wanted.size))
        target[0, pixels] = part[0]
        prepared, summed = totals.prepare_seconds + some.prepare_seconds, totals.sum_seconds + weighed + some.sum_seconds
        totals = Totals(prepared, summed, totals.terms + some.terms)
    return totals


def _as_lines(image: ComplexArray, shape: tuple[int, int]) -> ComplexArray | None:
    """`image` as (line, pixel) without a copy, or None where its strides do not allow it."""
    if image.flags.c_contiguous:
        return image.reshape(shape)
    return image if image.shape == shape and all(step % image.itemsize == 0 for step in image.strides) else None


def _starts(plan: plans.Plan) -> npt.NDArray[np.int64]:
    """First sample that tables are made of, of every trace; it may lie before the record."""
    scene, choices = plan.scene, plan.choices
    if choices.taper or (choices.taps and (choices.wide or not choices.n_fft)):
        return np.asarray(scene.first - 1 - choices.margin)
    return np.zeros(scene.traces, dtype=np.int64)


def _survey(plan: plans.Plan, order: npt.NDArray[np.int64]) -> Survey:
    """Traces `order` as the kernels take them."""
    scene, choices = plan.scene, plan.choices
    trace = scene.trace.take(order)
    trace["kept"] = _starts(plan)[order]
    near = choices.near if choices.block else np.inf
    model = record(
        MODEL, c=scene.c, fc=scene.fc, fs=scene.fs, rate=choices.oversampling, last=scene.n_sample - 1,
        cos_beam=scene.cos_beam, near=near, run=choices.run,
    )  # fmt: skip
    lattice = None if scene.lattice is None else scene.lattice.of(order)
    return Survey(trace, scene.weights[order], scene.kind, model, lattice)


def reader_of(choices: plans.Choices, band: float) -> preparation.Interpolator | native.Reader:
    """What makes coefficients from samples, as chosen."""
    kind = np.complex64 if choices.precision == "float32" and not choices.wide else np.complex128
    if not choices.taps:
        return preparation.interpolator(
            choices.length, choices.n_fft, choices.n_fine, choices.degree, choices.taper, choices.beta, kind
        )
    error = choices.errors["interpolation"]
    if not choices.n_fft:
        return native.Reader(
            native.design(band, choices.degree, choices.phases, choices.step, error, choices.taps), choices.length
        )
    least = choices.taps if choices.wide else native.LEAST_TAPS
    filter = native.design(0.25, choices.degree, choices.phases, choices.step, error, choices.taps, least)
    window = preparation.smooth_cut(choices.length, choices.taper, choices.beta, kind)
    cut = preparation.Cut(choices.length, choices.n_fft, window)
    return native.Reader(filter, choices.length, cut, choices.wide)


class Frame:
    """The grid as (line, pixel on the line) cut into tiles; grids without straight lines are one line of all pixels.

    With `rows` these are cut by rows as well.
    """

    def __init__(self, grid: Grid, scene: Scene, block: int, rows: bool = False) -> None:
        self.grid, self.origin = grid, scene.origin
        found = scene.lines if block else None
        self.straight = found is not None
        if found is not None:
            self.first, self.step = found[0] - scene.origin, found[1]
            self.shape = (len(self.first), grid.shape[-1])
            self.count = block
        else:
            width = grid.shape[-1] if rows else grid.size
            self.shape = (grid.size // width, width)
            self.count = min(BLOCK, width)
        self.mask = None if grid.mask is None else grid.mask.reshape(self.shape)

    def points(self, begin: int, end: int) -> FloatArray:
        """Coordinates (n, 3) of pixels begin ... end - 1, counted through all lines."""
        return np.ascontiguousarray(self.grid.coordinates(np.arange(begin, end)) - self.origin)

    def some(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> FloatArray:
        """Coordinates (row, column, 3) of the pixels where rows and columns meet."""
        if self.straight:
            return np.asarray(self.first[rows, None] + columns[None, :, None] * self.step[rows, None])
        flat = (rows[:, None] * self.shape[1] + columns).ravel()
        return (self.grid.coordinates(flat) - self.origin).reshape(len(rows), len(columns), 3)

    def tiles(self) -> list[Tile]:
        """All tiles, near neighbours first."""
        height, width = self.shape
        rows, columns = (planner.ROWS, self.count) if self.straight else (1, planner.ROWS * self.count)
        return [
            Tile(top, min(top + rows, height), left, min(left + columns, width))
            for top in range(0, height, rows)
            for left in range(0, width, columns)
        ]

    def locate(self, tile: Tile) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
        """Coordinates, blocks and active rows of a tile, as `_numba.sum_tile` takes them."""
        if self.straight:
            step = self.step[tile.first : tile.last]
            blocks = np.concatenate([self.first[tile.first : tile.last] + tile.left * step, step], axis=1)
            if self.mask is None:
                return np.empty((0, 3)), blocks, np.ones(len(blocks), dtype=np.bool_)
            part = self.mask[tile.first : tile.last, tile.left : tile.right]
            return np.empty((0, 3)), blocks, np.asarray(part.any(axis=1))
        pixels = np.arange(tile.left, tile.right)
        rows = -(-pixels.size // self.count)
        padded = np.minimum(tile.left + np.arange(rows * self.count), tile.right - 1)
        coords = self.grid.coordinates(padded) - self.origin
        active: npt.NDArray[np.bool_] = np.ones(rows, dtype=np.bool_)
        if self.mask is not None:
            active = np.asarray(self.mask[0, padded].reshape(rows, self.count).any(axis=1))
        return coords, np.zeros((rows, 6)), active
