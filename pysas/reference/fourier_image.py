"""Images of any track from non-uniform Fourier samples, patch by patch: the frequency-domain answer where omega-k has none.

Each patch is small enough for plane waves with a common range curvature (`patches`); its samples are summed by a non-uniform
FFT, which is back-projection, or inverted by density-weighted gridding, a frame or FTCG, which estimate the reflectivity.
"""

from __future__ import annotations

import time

import numpy as np

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.reference import ftcg
from pysas.reference.frames import DENSE, Frame
from pysas.reference.gridding import Complex, Gaussian, Gridding, pipe_menon
from pysas.reference.nufft import LIBRARIES, nufft, which
from pysas.reference.patches import Patch, Survey, samples, sectors, tiles

METHODS = ("nufft", "gridding", "frame", "ftcg")
_PHASE, _SAMPLES = 0.8, 0.1  # shares of `error`: phase left by plane waves, cuts of traces, non-uniform FFT (twice the second)
_WINDOW = Gaussian(line=True)
_CELLS = 2.0  # range resolution cells in half a domain, at least: a pulse's response must fit into it
_WIDER = 1.25  # an inversion's domain over its patch: echoes from just outside are then explained, not forced inside
_ITERATIONS = 100  # of LSMR: with a damping of 1e-2 it needs fewer


def fourier_image(
    echoes: Echoes,
    grid: Grid,
    method: str = "nufft",
    *,
    error: float = 1e-2,
    tiled: bool = True,
    correct: bool = True,
    r: int = 7,
    rcond: float = 1e-2,
    library: str = "auto",
    threads: int | None = None,
) -> Image:
    """Image a plane grid through Fourier samples of patches.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed, finite, any track and array, receivers moving or not; no beam.
    grid : Grid
        A plane.
    method : {"nufft", "gridding", "frame", "ftcg"}
        "nufft": the sum over pings and frequencies, which is back-projection. The others estimate the reflectivity, scaled so
        that a point in the middle of a patch has its back-projected amplitude: "gridding" with density weights (Pipe and
        Menon), "frame" by truncated SVD or, with more than 1e7 entries, LSMR, "ftcg" with a designed band.
    error : float
        Largest error at a patch's worst point, in [1e-6, 1]: the phase (rad) that plane waves leave, rms over pings weighed by
        their energy there, and the samples' own. With "nufft" the relative error against `exact` stays below it.
    tiled : bool
        True: halve the grid into patches that keep `error`. False: one patch, or an error.
    correct : bool
        Correct range curvature, for "nufft" by sectors of the aperture.
    r : int
        Band of "ftcg": 2 r + 1 nearest samples.
    rcond : float
        Of "frame" and "ftcg": singular values below it times the largest are dropped (LSMR: damped).
    library : {"auto", "finufft", "own"}
        Of "nufft" (see `nufft`).
    threads : int, optional
        Patches at once; default PYSAS_NUM_THREADS or all processors. The image is the same for any number.

    Returns
    -------
    Image
        complex128. `report.predicted_error` is the worst patch's; `report.choices` and `notes` tell of patches, and how
        many inversions were ill-posed.

    Raises
    ------
    ValueError, TypeError
        Another kind of grid, raw echoes, a beam, a non-finite sample, an argument outside its range; with tiled=False a grid
        beyond the limit of plane waves.
    ImportError
        library="finufft" and it is not installed.

    Notes
    -----
    Without `correct` the phase left at d across the look direction from a patch's middle is k d^2/R, k = 2 pi fc/c. Corrected,
    what remains is how that differs over the aperture, and the third order. A patch costs the FFTs of its traces' cuts and
    their non-uniform FFT, whatever its size, so small patches cost more than back-projection does. Memory: the data again
    (running sums of energy) and some patches' samples.

    `exact` counts a term between a record's first and last sample and not beyond; here a trace ends smoothly. What lies within
    a patch's cut of range but outside of it is noise to an inversion.
    """
    clock = time.perf_counter()
    survey = _checked(echoes, grid)
    _checks.choice("method", method, METHODS)
    used = which(_checks.choice("library", library, LIBRARIES))
    error = _checks.number("error", error, low=1e-6, high=1.0)
    r, rcond = _checks.whole("r", r, low=0), _checks.number("rcond", rcond, low=0.0, high=1.0)
    workers = _checks.threads(threads)
    x, y, z = grid.axes["x"], grid.axes["y"], float(np.asarray(grid.height))
    middle = np.array([(x.min() + x.max()) / 2, (y.min() + y.max()) / 2, z])
    surveys = sectors(survey, middle) if correct and method == "nufft" else [survey]
    whole, parts = tiles(surveys, x, y, z, _PHASE * error, correct)
    if not tiled and len(parts) > 1:
        side = max(max(np.ptp(x[p.columns]), np.ptp(y[p.rows])) for p in parts)
        raise ValueError(
            f"grid: {np.ptp(x):g} x {np.ptp(y):g} m leaves {whole.error:.2g} rad of plane waves: expected at most "
            f"{_PHASE:g} error={error:g}, patches of about {side:.2g} m, or tiled=True"
        )
    image = np.zeros(grid.shape, dtype=np.complex128)
    ill_posed = [False] * len(parts)
    counts = [0] * len(parts)
    prepared = time.perf_counter()

    def task(number: int) -> None:
        part = parts[number]
        if method == "nufft":
            values, counts[number] = _summed(part, error, used)
        else:
            values, counts[number], ill_posed[number] = _inverted(part, method, error, r, rcond)
        image[part.rows, part.columns] = values.reshape(part.rows.stop - part.rows.start, -1)

    _pool.run(task, len(parts), workers)
    if grid.mask is not None:
        image[~grid.mask] = 0
    notes = [f"{sum(ill_posed)} of {len(parts)} inversions were ill-posed"] if any(ill_posed) else []
    ends = _ends_within(survey, x, y, z)
    if ends:
        notes.append(f"{ends} of {len(survey.number)} traces end within the grid: smoothly there, not between two pixels")
    report = Report(
        f"fourier, {method}", backend="numba", threads=workers, prepare_seconds=prepared - clock,
        sum_seconds=time.perf_counter() - prepared, predicted_error=max(p.error for p in parts) + 2 * _SAMPLES * error,
        choices={"error": error, "patches": len(parts), "sectors": len(surveys), "correct": correct, "samples": sum(counts)}
        | ({"library": used} if method == "nufft" else {}),
        notes=tuple(notes),
    )  # fmt: skip
    return Image(image, grid, report, echoes.fc, echoes.speed)


def _checked(echoes: Echoes, grid: Grid) -> Survey:
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected a pysas.Grid")
    if grid.kind != "plane":
        raise ValueError(f"grid: expected a plane, found {grid.kind}")
    if grid.turned:
        raise ValueError("grid: turned axes: expected those of the echoes' coordinates")
    if not echoes.compressed:
        raise ValueError("echoes: compressed=False: expected range-compressed echoes (pysas.compress)")
    if echoes.beam is not None:
        raise ValueError("echoes: a beam ends within patches: expected beam=None (echoes.replace(beam=None))")
    echoes = echoes.whole()
    finite = np.isfinite(echoes.traces)
    if not finite.all():
        ping, channel, sample = (int(i) for i in np.argwhere(~finite)[0])
        where = f"ping {ping}, channel {channel}, sample {sample}"
        raise ValueError(f"data: {echoes.traces[ping, channel, sample]} at {where}: expected finite samples")
    return Survey.of(echoes)


def _ends_within(survey: Survey, x: FloatArray, y: FloatArray, z: float) -> int:
    """Traces with delays inside and outside of their record over the grid."""
    mesh = np.meshgrid(np.linspace(x.min(), x.max(), 5), np.linspace(y.min(), y.max(), 5))
    tau = survey.delays(np.stack([*mesh, np.full_like(mesh[0], z)], axis=-1).reshape(-1, 3))
    place = (tau - survey.start[:, None]) * survey.echoes.fs
    inside = (place >= 0) & (place <= survey.echoes.n_sample - 1)
    return int(np.count_nonzero(inside.any(axis=1) & ~inside.all(axis=1)))


def _summed(part: Patch, error: float, library: str) -> tuple[Complex, int]:
    """The patch by type-3 sums, one for each sector."""
    total = np.zeros(len(part.offsets), dtype=np.complex128)
    count = 0
    for expansion in part.parts:
        k, values = samples(expansion, part.offsets, _SAMPLES * error)
        if len(k):
            total += nufft(k, values, expansion.targets(part.offsets), accuracy=_SAMPLES * error, library=library)
        count += len(k)
    return total, count


def _inverted(part: Patch, method: str, error: float, r: int, rcond: float) -> tuple[Complex, int, bool]:
    """The patch's reflectivity, and whether its inversion was ill-posed."""
    (expansion,) = part.parts
    k, values = samples(expansion, part.offsets, _SAMPLES * error, in_band=True)
    if not len(k):
        return np.zeros(len(part.offsets), dtype=np.complex128), 0, False
    targets = expansion.targets(part.offsets)
    k0 = (k.min(axis=0) + k.max(axis=0)) / 2
    echoes = expansion.survey.echoes
    cell = echoes.speed / (2 * echoes.occupied_bandwidth)
    half = np.maximum(_WIDER * np.abs(targets).max(axis=0), _CELLS * cell)
    points = (k - k0) * half / np.pi
    modes = tuple(int(n) for n in np.ceil(np.abs(points).max(axis=0)))
    # with the echoes of a unit point in the middle: what its reflectivity is worth in a sum over pings
    both = np.stack([values, np.ones(len(k))], axis=1)
    density, ill_posed = pipe_menon(points), False
    if method == "gridding":
        found = Gridding(points, modes, _WINDOW) @ (density[:, None] * both)
    elif method == "ftcg":
        made = ftcg.design(points, modes, _WINDOW, r, weights=density, rcond=rcond, threads=1)
        found, ill_posed = made.coefficients(both), made.ill_posed
    else:
        frame = Frame(points, modes, _WINDOW, weights=density, rcond=rcond)
        large = frame.sampling.shape[0] * frame.sampling.shape[1] > DENSE
        solution = frame.solve(both, method="lsmr", accuracy=1e-4, iterations=_ITERATIONS) if large else frame.solve(both)
        found, ill_posed = solution.coefficients, solution.ill_posed
    image = _at(targets / half, found[:, 0], modes)
    unit = _at(np.zeros((1, 2)), found[:, 1], modes)[0]
    scale = len(k) / unit if unit != 0 else 0.0
    return image * np.exp(1j * (targets @ k0)) * scale, len(k), ill_posed


def _at(places: FloatArray, coefficients: Complex, modes: tuple[int, ...]) -> Complex:
    """sum_l c_l exp(j pi l.x)/w(x) at any places (n, 2)."""
    first, second = (np.exp(1j * np.pi * np.outer(x, np.arange(-n, n + 1))) for x, n in zip(places.T, modes, strict=True))
    total = np.sum((first @ coefficients.reshape(first.shape[1], -1)) * second, axis=1)
    return np.asarray(total / np.prod(_WINDOW.values(places), axis=1))
