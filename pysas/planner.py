"""From `tol` to choices: the only module that knows how an error is bought with time.

`plan` looks at the scene, leaves out what it does not need, chooses the cheapest settings whose error bounds sum to at
most `tol` (equations: pysas/engine/preparation.py and the docstrings below) and returns a `Plan` that images any data of
the same geometry. `print(plan)` and `plan.explain()` say what was chosen and why.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from numpy.polynomial import Chebyshev, Polynomial

from pysas import _checks, engine
from pysas._checks import ComplexArray, FloatArray
from pysas.costs import FILTER_NS, PREPARE_NS, term_ns
from pysas.echoes import Echoes
from pysas.engine import MONOSTATIC, MOVING, NODES, STOP_AND_HOP, native, summation
from pysas.grid import Grid
from pysas.image import Image
from pysas.scene import Scene

# Tables made by `python -m bench.interpolation_table`: THETA[degree][i] for errors 10^-(1 + i/2), GUARD[i] likewise.
# fmt: off
THETA = {
    1: (
        0.6406309, 0.3570764, 0.2002508, 0.1125128, 0.0632535, 0.035567, 0.0200003, 0.0112469,
        0.0063246, 0.0035566, 0.002, 0.0011247, 0.0006325, 0.0003557, 0.0002, 0.0001125,
        6.32e-05, 3.56e-05, 2e-05, 1.12e-05, 6.3e-06, 3.6e-06, 2e-06,
    ),
    3: (
        2.2029502, 1.6130996, 1.1948211, 0.8900513, 0.6650094, 0.4976756, 0.3727813, 0.2793691,
        0.2094227, 0.1570134, 0.1177302, 0.0882796, 0.066198, 0.0496405, 0.0372247, 0.0279144,
        0.0209328, 0.0156974, 0.0117713, 0.0088273, 0.0066195, 0.0049639, 0.0037224,
    ),
    5: (
        3.948613, 3.1623589, 2.5629358, 2.0910409, 1.7129459, 1.4068107, 1.1573075, 0.9530982,
        0.7854958, 0.647684, 0.5342275, 0.4407442, 0.3636746, 0.3001126, 0.2476771, 0.2044129,
        0.1687115, 0.1392486, 0.1149327, 0.0948639, 0.0782999, 0.0646284, 0.0533442,
    ),
    7: (
        5.7628304, 4.8302489, 4.0945778, 3.4942465, 2.9947886, 2.5741886, 2.2171415, 1.9123686,
        1.651205, 1.4267877, 1.2335575, 1.0669348, 0.9230999, 0.7988365, 0.6914176, 0.5985186,
        0.5181503, 0.4486054, 0.3884151, 0.3363139, 0.2912101, 0.2521608, 0.2183514,
    ),
}
GUARD = (5, 8, 22, 27, 45, 68, 108, 159, 262, 404, 642, 1018, 1625, 2572, 4070, 6447, 10213, 16193, 25657, 40675, 64460)
# fmt: on

METHODS = ("auto", "backprojection")
SHARE_INTERPOLATION = 0.85
SHARE_PHASE = 0.05  # each: delay polynomial, sine and cosine
SHARE_WRAP = 0.1  # wrap-round at a record's hard end
ROWS = 32
BATCH_BYTES = 24 * 2**20
LONGEST_FILTER = 400


@dataclass(frozen=True)
class Choices:
    """What the planner settled on.

    precision : "float32" or "float64" of the inner loop; degree, oversampling : of the interpolation; n_fft, n_fine,
    length : transform lengths and samples kept of each trace; margin : of these, on each side of what pixels need;
    taper : samples of smooth cut (Kaiser, beta) at each end; block : pixels per delay polynomial (0: exact delay per
    pixel); near : distance (m) below which delays are exact; trigonometry : terms of the sine polynomial; batch : traces
    prepared at a time; errors : bound of each contribution; phases, step, taps : of the filter that makes the coefficients
    (C++; oversampling is phases/step of the samples, or twice that after transforms), or 0 where transforms make them.
    """

    precision: str
    degree: int
    oversampling: float
    n_fft: int
    n_fine: int
    length: int
    margin: int
    taper: int
    beta: float
    block: int
    near: float
    trigonometry: int
    batch: int
    delay: str
    errors: dict[str, float]
    phases: int = 0
    step: int = 0
    taps: int = 0

    @property
    def predicted_error(self) -> float:
        """Sum of the bounds."""
        return float(sum(self.errors.values()))


def theta_limit(degree: int, error: float) -> float:
    """Largest theta at which degree `degree` keeps `error`: THETA read log-linearly."""
    exponents = 1 + 0.5 * np.arange(len(THETA[degree]))
    return float(np.exp(np.interp(-np.log10(error), exponents, np.log(THETA[degree]))))


def interpolation_error(degree: int, theta: float) -> float:
    """Bound of the interpolation's error at phase advance `theta`: the inverse of `theta_limit`."""
    logs = np.log(THETA[degree])[::-1]
    exponents = (1 + 0.5 * np.arange(len(THETA[degree])))[::-1]
    below = np.log(max(theta, 1e-12))
    if below < logs[0]:
        return float(10.0 ** -exponents[0] * np.exp((degree + 1) * (below - logs[0])))
    return float(10.0 ** -np.interp(below, logs, exponents))


def guard(error: float) -> int:
    """Zeros that keep wrap-round below `error` (at most 1e-11)."""
    index = int(np.ceil(2 * (-np.log10(error) - 1) - 1e-9))
    return GUARD[min(max(index, 0), len(GUARD) - 1)]


@functools.cache
def trigonometry(terms: int) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], float]:
    """Polynomials in turns^2 of sin(2 pi t)/t (`terms`) and cos(2 pi t) (`terms` + 1) on |t| <= 1/2, and their error."""

    def sine(q: FloatArray) -> FloatArray:
        t = np.sqrt(q)
        return np.asarray(2 * np.pi * np.sinc(2 * t))

    def cosine(q: FloatArray) -> FloatArray:
        return np.asarray(np.cos(2 * np.pi * np.sqrt(q)))

    fits = []
    worst = 0.0
    q = np.linspace(0, 0.25, 401)
    for function, count, weight in ((sine, terms, np.sqrt(q)), (cosine, terms + 1, np.ones_like(q))):
        series = Chebyshev.interpolate(function, count - 1, domain=[0, 0.25])
        worst = max(worst, float(np.max(np.abs(weight * (series(q) - function(q))))))
        fits.append(tuple(float(v) for v in series.convert(kind=Polynomial).coef))
    return (fits[0], fits[1]), worst


def plan(
    echoes: Echoes,
    grid: Grid,
    tol: float = 1e-3,
    method: str = "auto",
    threads: int | None = None,
    backend: str = "auto",
    weights: npt.ArrayLike | None = None,
    nan: str = "raise",
) -> Plan:
    """Choose how to image any data of this geometry on `grid` with relative error `tol`.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed; its samples are not looked at here.
    grid : Grid
    tol : float
        Relative error: ||I - I_exact|| <= tol max(||I_exact||, ||R||) over the grid, R the incoherent level. complex64:
        1e-1 to 1e-5; complex128: down to max(1e-10, 1e-14 range/wavelength).
    method : {"auto", "backprojection"}
    threads : int, optional
        Default: PYSAS_NUM_THREADS, else all processors. The image does not depend on it.
    backend : {"auto", "numba", "cpp"}
    weights : (ping,) or (ping, channel) array_like, optional
        Real or complex factors of the terms; 0 leaves a trace out.
    nan : {"raise", "mask"}
        Traces that hold non-finite samples: an error, or left out of the sum.

    Returns
    -------
    Plan

    Raises
    ------
    ValueError, TypeError
        Raw echoes, under-sampled data, a `tol` that cannot be met (says what can), a wrong argument.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={type(grid).__name__}: expected pysas.Grid")
    _checks.choice("method", method, METHODS)
    _checks.choice("nan", nan, ("raise", "mask"))
    name = engine.backend_name(backend)
    if not echoes.compressed:
        raise ValueError("echoes: raw (compressed=False): expected range-compressed echoes, see pysas.compress")
    if echoes.fs < 1.1 * echoes.occupied_bandwidth * (1 - 1e-9):
        raise ValueError(
            f"echoes: fs={echoes.fs:g} Hz is {echoes.fs / echoes.occupied_bandwidth:.4g} x the bandwidth "
            f"{echoes.occupied_bandwidth:g} Hz: expected at least 1.1 x"
        )
    tol = _checks.number("tol", tol, positive=True)
    scene = Scene(echoes, grid, weights)
    _reachable(tol, echoes, scene)
    return Plan(echoes, grid, tol, scene, _choose(scene, tol, name), _checks.threads(threads), name, nan)


def _reachable(tol: float, echoes: Echoes, scene: Scene) -> None:
    if tol > 0.1:
        raise ValueError(f"tol={tol:g}: expected at most 0.1")
    least = 1e-5 if echoes.dtype == np.complex64 else max(1e-10, 1e-14 * scene.farthest * echoes.fc / echoes.c)
    if tol < least * (1 - 1e-9):
        hint = "; complex128 data reach 1e-10" if echoes.dtype == np.complex64 else ""
        raise ValueError(f"tol={tol:g}: {echoes.dtype} data over {scene.farthest:.4g} m reach {least:.3g} at best{hint}")


def _choose(scene: Scene, tol: float, backend: str = "numba") -> Choices:
    """The cheapest settings whose bounds sum to at most tol."""
    single = scene.dtype == np.complex64 or tol >= 1e-5 * (1 - 1e-9)
    precision = "float32" if single else "float64"
    nodes = native.NODES[precision] if backend == "cpp" else NODES
    polynomials = scene.lines is not None and (single or backend == "cpp")
    block, near, errors = _choose_delay(scene, tol, nodes, single) if polynomials else (0, 0.0, {})
    if single and not block:
        errors["rounding"] = 2.0**-22
    least = 2.0**-23 if single else 1e-14
    for terms in native.TRIGONOMETRY[precision] if backend == "cpp" else range(4, 13):
        _, wrong = trigonometry(terms)
        if wrong <= max(SHARE_PHASE * tol, least):
            break
    errors["sine and cosine"] = wrong
    kinds = {MONOSTATIC: "monostatic", STOP_AND_HOP: "bistatic", MOVING: "moving receivers"}
    shared = {"precision": precision, "block": block, "near": near, "trigonometry": terms, "delay": kinds[scene.kind]}
    return (_choose_filter if backend == "cpp" else _choose_transform)(scene, tol, errors, shared)


def _choose_filter(scene: Scene, tol: float, errors: dict[str, float], shared: dict[str, Any]) -> Choices:
    """C++: coefficients by a short filter; where pixels need samples near a record's end, of traces low-passed by W first.

    W (see pysas.reference.exact) says how a record's end is read, and its long response needs transforms: one forward, one
    back to twice the sample rate, where |f| <= 1/4 is all there is left for the filter to read.
    """
    heard = scene.heard
    away = guard(SHARE_WRAP * tol)
    errors = errors | {"record's ends": SHARE_WRAP * tol}
    ends = heard.any() and (np.min(scene.first[heard]) < away or np.max(scene.last[heard]) > scene.n_sample - 1 - away)
    n_fft = margin = taper = 0
    beta, band, double = 0.0, scene.band, 1
    if ends:
        length, margin, taper, beta = _crop(scene, tol)
        n_fft = scipy.fft.next_fast_len(length + max(away, LONGEST_FILTER))
        band, double = 0.25, 2
    else:
        length = int(np.max(scene.last[heard] - scene.first[heard], initial=0)) + 4
    left = min(SHARE_INTERPOLATION * tol, tol - sum(errors.values()))
    best: tuple[float, native.Filter] | None = None
    for degree in native.DEGREES[shared["precision"]]:
        for phases, step in native.RATES:
            # a polynomial's own error, before any filter is made: near-minimax for this phase advance
            theta = np.pi * band * step / phases
            if theta ** (degree + 1) / (math.factorial(degree + 1) * 2**degree) > 1.5 * left:
                continue
            filter = native.design(band, degree, phases, step, left, LONGEST_FILTER)
            if filter.error > left:
                continue
            term = term_ns(shared["block"], degree, double * filter.rate, "cpp", scene, shared["precision"])
            coefficients = (degree + 1) * length * double * filter.rate
            cost = scene.traces * (scene.pixels * term + coefficients * (1 + FILTER_NS * filter.taps))
            if best is None or cost < best[0]:
                best = (cost, filter)
            break
    assert best is not None  # a longer filter and a higher degree reach every tolerance that is let in
    filter = best[1]
    errors["interpolation"] = filter.error
    rate = double * filter.rate
    size = length * rate * (filter.degree + 1) * (8 if shared["precision"] == "float32" else 16)
    return Choices(
        degree=filter.degree, oversampling=rate, n_fft=n_fft, n_fine=double * n_fft, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, int(BATCH_BYTES / size) // 8 * 8), errors=errors, phases=len(filter.first), step=filter.step,
        taps=filter.taps, **shared,
    )  # fmt: skip


def _choose_transform(scene: Scene, tol: float, errors: dict[str, float], shared: dict[str, Any]) -> Choices:
    """Numba: coefficients by transforms."""
    length, margin, taper, beta = _crop(scene, tol)
    pad = guard(SHARE_WRAP * tol) if length == scene.n_sample else 0
    errors["wrap-round"] = SHARE_WRAP * tol if pad else 0.0
    n_fft = scipy.fft.next_fast_len(length + pad)
    left = min(SHARE_INTERPOLATION * tol, tol - sum(errors.values()))
    precision = shared["precision"]
    best: tuple[float, int, int] | None = None
    for degree in THETA:
        rate = max(1.0, np.pi * scene.band / theta_limit(degree, left))
        n_fine = scipy.fft.next_fast_len(int(np.ceil(n_fft * rate - 1e-9))) if rate > 1 else n_fft
        term = term_ns(shared["block"], degree, n_fine / n_fft, "numba", scene, precision)
        cost = scene.traces * (scene.pixels * term + PREPARE_NS * (degree + 1) * n_fine)
        if best is None or cost < best[0]:
            best = (cost, degree, n_fine)
    assert best is not None
    _, degree, n_fine = best
    errors["interpolation"] = interpolation_error(degree, np.pi * scene.band * n_fft / n_fine)
    size = int(length * n_fine / n_fft) * (degree + 1) * (8 if precision == "float32" else 16)
    return Choices(
        degree=degree, oversampling=n_fine / n_fft, n_fft=n_fft, n_fine=n_fine, length=length, margin=margin, taper=taper,
        beta=beta, batch=max(8, BATCH_BYTES // size // 8 * 8), errors=errors, **shared,
    )  # fmt: skip


def _choose_delay(scene: Scene, tol: float, nodes: int, single: bool) -> tuple[int, float, dict[str, float]]:
    """Block length and the distance from which its delay polynomial holds; 0 where only exact delays keep tol.

    sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so the
    polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each way. The
    offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the block.
    """
    wave = scene.fc / scene.c
    uneven = 4 * np.pi * wave * scene.uneven  # a pixel off its line is off by as much on both ways
    eps = 2.0**-24 if single else 2.0**-53
    best: tuple[int, float, dict[str, float]] = (0, 0.0, {})
    for block in (64, 48, 32, 16):
        count = _even_split(scene.line_length, block)
        half = scene.step * (count - 1) / 2
        turns = 2 * half * scene.slope * wave
        rounding = np.pi * turns * eps + 4 * eps + uneven
        if rounding > 3 * SHARE_PHASE * tol:
            continue
        near = 2 * half
        if half > 0:
            scaled = 2 * np.pi * wave * 2 * 1.3 * (2 / (2 * nodes - 1)) * half**nodes / 2 ** (nodes - 1)
            near = max(near, (scaled / (SHARE_PHASE * tol)) ** (1 / (nodes - 1)))
        best = (count, near, {"rounding": rounding, "delay polynomial": SHARE_PHASE * tol})
        if near <= scene.nearest:
            break
    return best


def _even_split(length: int, block: int) -> int:
    """Pixels per block, at most `block`: blocks of equal size, a multiple of 8 where the line is long."""
    blocks = -(-length // block)
    count = -(-length // blocks)
    return min(block, -(-count // 8) * 8) if length > 8 else length


def _crop(scene: Scene, tol: float) -> tuple[int, int, int, float]:
    """Samples kept of every trace, those kept beside what pixels need, the taper at each cut end and its beta.

    A smooth cut (the integral of a Kaiser window) of g samples leaves a band-limited trace band-limited to within
    beta = pi sqrt((g delta)^2 - 1), delta the free band up to 1/2.2: exp(-beta) is held to a thousandth of tol, so that
    a point 60 dB above the scene just outside the cut does no harm. It begins GUARD samples away: a record's own end that is
    nearer stays in, with what the low-pass W makes of it.
    """
    heard = scene.heard
    if not heard.any():
        return scene.n_sample, 0, 0, 0.0
    free = 1 / 2.2 - scene.band
    margin = guard(tol)
    if free < 0.01:
        return scene.n_sample, 0, 0, 0.0
    beta = np.log(1e3 / tol)
    taper = int(np.ceil(np.sqrt(1 + (beta / np.pi) ** 2) / free)) + 1
    needed = int(np.max(scene.last[heard] - scene.first[heard])) + 2 + 2 * (taper + margin)
    return (needed, margin + taper, taper, float(beta)) if needed < 0.9 * scene.n_sample else (scene.n_sample, 0, 0, 0.0)


class Plan:
    """How to image a geometry: call it with data shaped like the echoes' it was made from.

    Attributes
    ----------
    choices : Choices
    tol : float
    """

    def __init__(
        self, echoes: Echoes, grid: Grid, tol: float, scene: Scene, choices: Choices, threads: int, backend: str, nan: str
    ) -> None:
        from pysas import backprojection

        self.tol, self.choices, self.threads, self.backend = tol, choices, threads, backend
        self.grid, self.scene, self.nan = grid, scene, nan
        self.data_shape, self.dtype = echoes.data.shape, echoes.dtype
        self.frame = backprojection.Frame(grid, scene, choices.block)
        self.reported = dataclasses.asdict(choices)
        self.reader = backprojection.reader_of(choices, scene.band)
        if not scene.heard.any():
            warnings.warn(scene.why_silent(), stacklevel=4)

    def __call__(
        self, data: npt.ArrayLike, out: ComplexArray | None = None, progress: Callable[[float], None] | None = None
    ) -> Image:
        """Image `data`.

        Parameters
        ----------
        data : array of the echoes' shape and dtype
        out : complex array of grid.shape, optional
            Written in place and returned as the image's data.
        progress : callable, optional
            Called from this thread with the share done, 0 to 1.

        Returns
        -------
        Image

        Raises
        ------
        ValueError, TypeError
            Wrong shape or dtype; non-finite samples (first ping and channel named) with nan="raise".

        Notes
        -----
        O(traces (pixels + n_fft log n_fft)); memory beyond input and output: one batch of coefficients, about 25 MB.
        """
        from pysas import backprojection

        return backprojection.execute(self, data, out, progress)

    def __str__(self) -> str:
        c, scene = self.choices, self.scene
        shape = " x ".join(map(str, self.grid.shape))
        delay = f"polynomials over {c.block} pixels, exact below {c.near:.3g} m" if c.block else "exact per pixel"
        kept = f"{c.length} of {scene.n_sample} samples" + (f", tapered over {c.taper}" if c.taper else "")
        made = [f"transforms of {c.n_fft} and {c.n_fine}"] * bool(c.n_fft) + [f"a filter of {c.taps} taps"] * bool(c.taps)
        return "\n".join(
            [
                f"Plan: backprojection of {scene.traces} traces on {shape} pixels, tol {self.tol:g}",
                f"  backend        {self.backend}, {c.precision}, {self.threads} threads, batches of {c.batch} traces",
                f"  traces         {kept}, {', '.join(made)}",
                f"  interpolation  degree {c.degree} at {c.oversampling:.3g} x the sample rate",
                f"  delay          {c.delay}, {delay}",
                f"  terms          {scene.traces * scene.pixels:.4g} at most",
                f"  predicted      error {c.predicted_error:.2g}, time {self.predicted_seconds:.2g} s, "
                f"memory {self.predicted_memory / 2**20:.0f} MB beyond the input",
            ]
        )

    @property
    def predicted_seconds(self) -> float:
        """Rough time on this many threads, s (constants of the planner, not measured on this machine)."""
        c, scene = self.choices, self.scene
        term = term_ns(c.block, c.degree, c.oversampling, self.backend, scene, c.precision)
        traces = int(np.count_nonzero(scene.heard))
        made = c.length * c.oversampling * (1 + FILTER_NS * c.taps) if c.taps else PREPARE_NS * c.n_fine
        return traces * (scene.pixels * term + made * (c.degree + 1)) * 1e-9 / self.threads

    @property
    def predicted_memory(self) -> int:
        """Bytes allocated beyond the input: image, one batch of coefficients, workers' tiles."""
        c = self.choices
        item = 8 if c.precision == "float32" else 16
        work = c.batch * c.length * c.oversampling * (c.degree + 1) * item
        if c.n_fft:
            work += self.threads * summation.rows_per_task(c.n_fine) * (c.length + 2 * c.n_fft + 3 * c.n_fine) * item
        if self.backend == "cpp" and not c.block:
            work += 24 * min(native.SLAB, self.grid.size)
        return int(self.grid.size * self.dtype.itemsize + work)

    def explain(self) -> str:
        """What the scene has, what was left out and the share of work saved, and where the error goes."""
        c, scene = self.choices, self.scene
        lines = [str(self), "  left out"]
        silent = scene.traces - int(np.count_nonzero(scene.heard))
        saved = 1 - c.length / scene.n_sample
        masked = 1 - scene.pixels / self.grid.size
        rows = [
            (scene.kind == MONOSTATIC, "second square root: transmitter and receiver at one place"),
            (scene.kind != MOVING, "receivers' motion within the ping: no velocity"),
            (scene.weights is None, "weights: none given"),
            (scene.cos_beam <= -1, "beam: none given"),
            (c.precision == "float32", "float64 in the inner loop: tol does not need it"),
            (saved > 0, f"{100 * saved:.0f} % of each record: no pixel needs it"),
            (silent > 0, f"{silent} of {scene.traces} traces: no pixel within their window"),
            (masked > 0, f"{100 * masked:.0f} % of the pixels: masked"),
        ]
        lines += [f"    - {text}" for used, text in rows if used]
        lines += ["  error bounds"] + [f"    - {name}: {value:.2g}" for name, value in c.errors.items()]
        return "\n".join(lines)
