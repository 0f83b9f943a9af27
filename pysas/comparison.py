"""Methods side by side: each one's run time beside its error against `pysas.reference.exact`, as a table and a figure.

`methods` gives the calls that a data set allows, `compare` runs and judges them (or any others), `table` and `figure` show
what was found.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks, metrics, reference
from pysas._limit import TooLongError, at_most
from pysas._panels import draw, name_settings
from pysas.backprojection import backproject
from pysas.echoes import Echoes
from pysas.factorised import ffbp
from pysas.grid import Grid
from pysas.image import Image

Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.intp]
Call = Callable[[], Image]
Pair = tuple[float | None, float | None]

TOLS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
_ENGINES: dict[str, Callable[..., Image]] = {"backproject": backproject, "ffbp": ffbp}
_FITTED = ("range-Doppler", "chirp scaling")  # without the weight of the sum: a law of range and one factor are free
# many times dearer than the other, in patches that a limit cannot stop midway: tried where it takes at most _CHEAP of the limit
_DEARER = {f"fourier_image, {name}": "fourier_image, gridding" for name in ("frame", "ftcg")}
_CHEAP = 0.1
_REACH = 24  # pixels of a cut either side of the target
_SLOW = 0.25  # of the limit: what takes longer is timed once


@dataclass(frozen=True)
class Row:
    """One method in one setting.

    Attributes
    ----------
    method, setting : str
    seconds, least, most : float
        Median and extremes of the counted runs, s, of which there were `runs`.
    prepare, summed : float
        Medians of what the images' reports state, s; 0 where a method does not say.
    shape : tuple of int
        Of the image.
    terms_per_second : float
        Traces times pixels over `seconds`, also of methods that sum no terms.
    error : float
        Relative L2 error in the norm of `tol` (`metrics.relative_error`) on the sampled pixels.
    fitted : bool
        Whether the image was multiplied by sqrt(range) and one fitted complex factor first.
    loss : float or None
        By how much the target's pixel is weaker than the exact sum's, dB; None where either is 0.
    irw, pslr : (x, y), m and dB
        Response along the cuts; None where there is no main lobe or side lobe to measure.
    share : float
        Of terms that went through sub-apertures.
    memory : float or None
        Growth of the resident set, MB, where the caller measured it.
    """

    method: str
    setting: str
    seconds: float
    least: float
    most: float
    runs: int
    prepare: float
    summed: float
    shape: tuple[int, ...]
    terms_per_second: float
    error: float
    fitted: bool
    loss: float | None
    irw: Pair
    pslr: Pair
    share: float
    memory: float | None = None


@dataclass(frozen=True)
class Comparison:
    """What `compare` found.

    Attributes
    ----------
    traces, samples : int
        (ping, channel) pairs, and samples of each.
    shape : tuple of int
        Of the first method's image.
    irw, pslr : (x, y), m and dB
        Response of the exact sum on that grid.
    rows : tuple of Row
        What ran, in the order given.
    left_out, warned : dict of str to str
        Why "method, setting" is not among the rows, and what was warned of.
    """

    traces: int
    samples: int
    shape: tuple[int, ...]
    irw: Pair
    pslr: Pair
    rows: tuple[Row, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)
    warned: Mapping[str, str] = field(default_factory=dict)


def methods(
    echoes: Echoes,
    grid: Grid,
    tols: Sequence[float] = TOLS,
    *,
    raw: Echoes | None = None,
    half_angle: float | None = None,
    fewer: bool = False,
    threads: int | None = None,
) -> dict[tuple[str, str], Call]:
    """Calls by (method, setting): the engines at each of `tols`, and every reference, whether it will apply or not.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed.
    grid : Grid
        Of the engines and `fourier_image`; the other references image the track's slant plane on a grid of their own.
    tols : sequence of float
        Of the engines; may be empty.
    raw : Echoes, optional
        The same before compression, for chirp scaling.
    half_angle : float, optional
        Of `reference.one_way`, rad.
    fewer : bool
        Fewer settings of the references, and of `fourier_image` the sum alone, whose inverses take many times as long.
    threads : int, optional
        Default PYSAS_NUM_THREADS or all processors.

    Returns
    -------
    dict
        For `compare`. Nothing is computed here, and nothing checked.
    """
    found: dict[tuple[str, str], Call] = {}
    for name, engine in _ENGINES.items():
        for tol in tols:
            found[name, f"tol {tol:g}"] = partial(engine, echoes, grid, tol, threads=threads)
    settings = [("sinc", 2), ("cubic", 2), ("linear", 2), ("linear", 8)]
    for interpolation, padding in settings if fewer else [*settings, ("linear", 1), ("linear", 4)]:
        found["omega-k", f"{interpolation}, zp {padding}"] = partial(
            reference.omega_k, echoes, interpolation=interpolation, zero_padding=padding, weight="backprojection",
            threads=threads,
        )  # fmt: skip
    for interpolation in ("sinc", "linear"):
        found["range-Doppler", interpolation] = partial(
            reference.range_doppler, echoes, interpolation=interpolation, threads=threads
        )
    found["chirp scaling", "raw echoes"] = partial(_chirp_scaling, raw, threads)
    for angle in (45,) if fewer else (15, 45, 65):
        found["one-way", f"{angle} degrees"] = partial(
            reference.one_way, echoes, angle=angle, weight="backprojection", half_angle=half_angle, threads=threads
        )
    for method in ("nufft",) if fewer else ("nufft", "gridding", "frame", "ftcg"):
        for error in (1e-1,) if fewer or method != "nufft" else (1e-1, 1e-2):
            found[f"fourier_image, {method}", f"error {error:.0e}"] = partial(
                reference.fourier_image, echoes, grid, method, error=error, threads=threads
            )
    return found


def _chirp_scaling(raw: Echoes | None, threads: int | None) -> Image:
    if raw is None:
        raise ValueError("echoes: compressed: expected raw ones")
    return reference.chirp_scaling(raw, threads=threads)


def compare(
    echoes: Echoes,
    calls: Mapping[tuple[str, str], Call],
    *,
    target: npt.ArrayLike | None = None,
    half: npt.ArrayLike | None = None,
    count: int = 200,
    rounds: int = 3,
    limit: float = 60.0,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Run every call, interleaved, and judge its image against the exact sum.

    Parameters
    ----------
    echoes : Echoes
        Range-compressed and finite: what the images are made of.
    calls : mapping of (method, setting) to callable
        Each takes nothing and returns an Image on a plane or surface grid; `methods` makes some.
    target : (x, y), optional
        Where the cuts cross, m. Default: at the strongest pixel of the first image on each grid.
    half : (x, y), optional
        Half the sides of the box about `target` that random pixels come from, m; given with it. Default: the whole grid.
    count : int
        Random pixels.
    rounds : int
        Counted runs. What takes more than a quarter of `limit` has one.
    limit : float
        Longest run, s. Only the main thread can be stopped; elsewhere a run ends first and is then left out.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError, TypeError
        An argument outside its range; no call that runs (says why the first did not).

    Notes
    -----
    The first run of each call is not counted: it compiles. Each image is judged on its own grid, on pixels nearest to the same
    places: the row and the column through the target, 24 pixels either side, and random ones. Images of range-Doppler and
    chirp scaling have peaks that grow as sqrt(range), not as the sum's: they are multiplied by sqrt(range) and one fitted
    complex factor. A call that raises ValueError, ImportError or MemoryError does not apply and is left out.
    """
    reference.exact(echoes, Grid.points([[0.0, 0.0, 0.0]]), np.empty(0, dtype=np.intp))  # its checks, before the first run
    if not calls:
        raise ValueError("calls: expected at least one")
    count, rounds = _checks.whole("count", count), _checks.whole("rounds", rounds)
    limit = _checks.number("limit", limit, positive=True)
    if (target is None) != (half is None):
        raise ValueError(f"target={target!r}, half={half!r}: expected both or neither")
    box = None if target is None else (_checks.reals("target", target, [(2,)]), _checks.reals("half", half, [(2,)]))
    judge, steps = _Judge(echoes, box, count), len(calls) * (1 + rounds)
    found: dict[tuple[str, str], tuple[float, dict[str, Any]]] = {}
    left_out: dict[str, str] = {}
    warned: dict[str, str] = {}

    def tell(done: int) -> None:
        if progress is not None:
            progress(done / steps)

    late: set[tuple[str, str]] = set()
    for number, (key, call) in enumerate(calls.items()):
        if (less := (_DEARER.get(key[0], ""), key[1])) in late:
            left_out[", ".join(key)] = f"not tried: {less[0]}, many times cheaper, takes more than {_CHEAP * limit:g} s"
            continue
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                image, first = _timed(call, limit)
        except (ValueError, ImportError, MemoryError, TooLongError) as error:
            left_out[", ".join(key)] = str(error) or type(error).__name__
            if isinstance(error, TooLongError):
                late.add(key)
        else:
            if caught:
                warned[", ".join(key)] = "; ".join(dict.fromkeys(str(w.message) for w in caught))
            if first > _CHEAP * limit:
                late.add(key)
            found[key] = first, judge.judged(key[0], image)
            del image
        tell(number + 1)
    times: dict[tuple[str, str], list[tuple[float, float, float]]] = {key: [] for key in found}
    for repeat in range(rounds):
        for number, key in enumerate(calls):
            if key in found and not (times[key] and found[key][0] > _SLOW * limit):
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        image, seconds = _timed(calls[key], limit)
                except TooLongError as error:  # the first run was just below the limit
                    left_out[", ".join(key)] = str(error)
                    del found[key]
                else:
                    times[key].append((seconds, image.report.prepare_seconds, image.report.sum_seconds))
                    del image
            tell(len(calls) * (1 + repeat) + number + 1)
    if not found:
        name, reason = next(iter(left_out.items()))
        raise ValueError(f"calls: none runs; {name}: {reason}")
    traces = echoes.n_ping * echoes.n_channel
    rows = []
    for key, (_, judged) in found.items():
        total, prepare, summed = np.array(times[key]).T
        seconds = float(np.median(total))
        rows.append(
            Row(
                *key, seconds, float(total.min()), float(total.max()), len(total), float(np.median(prepare)),
                float(np.median(summed)), terms_per_second=traces * float(np.prod(judged["shape"])) / seconds, **judged,
            )
        )  # fmt: skip
    first_answer = next(iter(judge.known.values()))
    irw, pslr = first_answer.response(first_answer.exact)
    return Comparison(traces, echoes.n_sample, first_answer.grid.shape, irw, pslr, tuple(rows), left_out, warned)


def _timed(call: Call, limit: float) -> tuple[Image, float]:
    clock = time.perf_counter()
    with at_most(limit):
        image = call()
    seconds = time.perf_counter() - clock
    if seconds > limit:  # what could not be stopped
        raise TooLongError(f"longer than {limit:g} s")
    if not isinstance(image, Image):
        raise TypeError(f"calls: found {type(image).__name__} returned: expected pysas.Image")
    if image.grid.kind not in ("plane", "surface"):
        raise ValueError(f"grid: expected a plane or a surface, found {image.grid.kind}")
    return image, seconds


@dataclass(frozen=True, eq=False)
class _Answer:
    """The exact sum on sampled pixels of a grid: row's cut, column's cut, random ones."""

    grid: Grid
    cuts: tuple[slice, slice]
    peak: int
    pixels: Index
    exact: Complex
    level: npt.NDArray[np.float64]

    def response(self, values: Complex) -> tuple[Pair, Pair]:
        """IRW (m) and PSLR (dB) of sampled `values`, each along x and y."""
        found = [_response(values[cut], self.grid.axes[name]) for cut, name in zip(self.cuts, ("x", "y"), strict=True)]
        return (found[0][0], found[1][0]), (found[0][1], found[1][1])


def _response(cut: Complex, axis: npt.NDArray[np.float64]) -> Pair:
    steps = np.diff(axis)
    if cut.size < 3 or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return None, None
    try:
        width, side = metrics.irw(cut, abs(float(steps[0]))), metrics.pslr(cut)
    except ValueError:  # no main lobe
        return None, None
    return width, side if np.isfinite(side) else None


class _Judge:
    """Compares images with the exact sum; those that share a grid share its pixels."""

    def __init__(self, echoes: Echoes, box: tuple[Any, Any] | None, count: int) -> None:
        self.echoes, self.box, self.count = echoes, box, count
        self.known: dict[Any, _Answer] = {}

    def answer(self, image: Image) -> _Answer:
        grid = image.grid
        key = (np.asarray(grid.height).tobytes(), *(np.round(axis, 9).tobytes() for axis in grid.axes.values()))
        if key not in self.known:
            x, y = grid.axes["x"], grid.axes["y"]
            if self.box is None:
                row, column = divmod(int(np.argmax(np.abs(image.data))), x.size)
                bounds = [(axis.min(), axis.max()) for axis in (x, y)]
            else:
                column, row = (int(np.argmin(np.abs(axis - at))) for axis, at in zip((x, y), self.box[0], strict=True))
                bounds = [(at - half, at + half) for at, half in zip(*self.box, strict=True)]
            rng = np.random.default_rng(0)
            places = [rng.uniform(low, high, self.count) for low, high in bounds]
            columns, rows = (np.argmin(np.abs(a[:, None] - p), axis=0) for a, p in zip((x, y), places, strict=True))
            along = np.arange(max(column - _REACH, 0), min(column + _REACH + 1, x.size))
            across = np.arange(max(row - _REACH, 0), min(row + _REACH + 1, y.size))
            pixels = np.concatenate([row * x.size + along, across * x.size + column, rows * x.size + columns])
            cuts = slice(0, along.size), slice(along.size, along.size + across.size)
            exact, level = reference.exact(self.echoes, grid, pixels)
            self.known[key] = _Answer(grid, cuts, column - int(along[0]), pixels, exact, level)
        return self.known[key]

    def judged(self, method: str, image: Image) -> dict[str, Any]:
        """Fields of a `Row`."""
        answer = self.answer(image)
        values = image.data.ravel()[answer.pixels].astype(np.complex128)
        fitted = method in _FITTED
        if fitted:
            ranges = np.abs(image.grid.axes["y"][answer.pixels // image.grid.shape[1]] - self.echoes.tx[:, 1].mean())
            values *= np.sqrt(ranges)
            power = np.vdot(values, values).real
            values *= np.vdot(values, answer.exact) / power if power > 0 else 1.0
        wanted, found = np.abs(answer.exact[answer.peak]), np.abs(values[answer.peak])
        irw, pslr = answer.response(values)
        return {
            "error": metrics.relative_error(values, answer.exact, answer.level), "fitted": fitted, "irw": irw, "pslr": pslr,
            "loss": float(20 * np.log10(wanted / found)) if wanted > 0 and found > 0 else None,
            "share": image.report.factorised_share, "shape": image.grid.shape,
        }  # fmt: skip


def front(rows: Sequence[Row]) -> list[int]:
    """Indices of the Pareto front: the rows that no other beats in both time and error, the fastest first."""
    found, least = [], np.inf
    for index in sorted(range(len(rows)), key=lambda i: (rows[i].seconds, rows[i].error)):
        if rows[index].error < least:
            least = rows[index].error
            found.append(index)
    return found


def table(comparison: Comparison) -> str:
    """Markdown: the exact sum's response, a line a row, the front marked, and what was left out or warned of, with reasons.

    A column that no row fills is left out; "pixels" is filled where an image has another shape than the first.
    """
    best = set(front(comparison.rows))
    lines = [_cells(row, number in best, comparison.shape) for number, row in enumerate(comparison.rows)]
    kept = [name for name in lines[0] if any(cells[name] for cells in lines)]
    text = [f"Exact sum: IRW {_pair(comparison.irw, '.2f', 100)} cm, PSLR {_pair(comparison.pslr, '.1f')} dB.\n"]
    text += [f"| {' | '.join(kept)} |\n|{'---|' * len(kept)}"]
    text += [f"| {' | '.join(cells[name] for name in kept)} |" for cells in lines]
    for title, found in (("Left out", comparison.left_out), ("Warned of", comparison.warned)):
        if found:
            text += [f"\n{title}:\n", _reasons(found)]
    return "\n".join(text) + "\n"


def _cells(row: Row, best: bool, shape: tuple[int, ...]) -> dict[str, str]:
    share = f", {100 * row.share:.0f} % factorised" if row.method.startswith("ffbp") else ""
    return {
        "method": row.method, "setting": row.setting + share,
        "s": f"{row.seconds:.3g} " + (f"({row.least:.3g} to {row.most:.3g})" if row.runs > 1 else "(once)"),
        "preparation": f"{row.prepare:.3g}" if row.prepare else "", "sum": f"{row.summed:.3g}" if row.summed else "",
        "pixels": "" if row.shape == shape else " x ".join(map(str, row.shape)),
        "1e9 terms/s": f"{row.terms_per_second / 1e9:.3g}", "error": f"{row.error:.1e}" + ("*" if row.fitted else ""),
        "loss, dB": "" if row.loss is None else f"{round(row.loss, 2) + 0.0:.2f}",
        "IRW, cm": _pair(row.irw, ".2f", 100), "PSLR, dB": _pair(row.pslr, ".1f"),
        "MB": "" if row.memory is None else f"{row.memory:.0f}", "front": "front" if best else "",
    }  # fmt: skip


def _pair(values: Pair, form: str, scale: float = 1.0) -> str:
    """Two numbers as text, "-" for one that is not known."""
    return " / ".join("-" if value is None else format(scale * value, form) for value in values)


def _reasons(found: Mapping[str, str]) -> str:
    """What was said of methods, those of one reason together."""
    grouped: dict[str, list[str]] = {}
    for name, reason in found.items():
        grouped.setdefault(re.sub(r"\s+", " ", reason), []).append(name)
    return "\n".join(f"- {'; '.join(names)}: {reason}" for reason, names in grouped.items())


def figure(comparisons: Mapping[str, Comparison]) -> Any:
    """Error against run time, log-log: a panel a comparison, by title, the front in grey behind it.

    Parameters
    ----------
    comparisons : mapping of str to Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Of no window: `savefig` writes it.

    Raises
    ------
    ImportError
        Without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise _checks.optional("matplotlib", "plot") from None
    columns = min(len(comparisons), 3)
    rows = -(-len(comparisons) // columns)
    size = (8.5, 7.5) if columns == 1 else (5.2 * columns, 4.6 * rows + 1.2)
    plot = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(plot)
    axes = plot.subplots(rows, columns, squeeze=False).ravel()
    handles: dict[str, Any] = {}
    for ax, (title, comparison) in zip(axes, comparisons.items(), strict=False):
        draw(ax, comparison.rows, front(comparison.rows))
        ax.set_title(title, fontsize=10, parse_math=False)  # may be the name of a file
        handles |= {text: handle for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)}
    for ax in axes[len(comparisons) :]:
        ax.remove()
    if len(axes) == len(comparisons):
        plot.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3 if columns == 1 else 5)
    else:  # where panels are missing
        plot.legend(list(handles.values()), list(handles), loc="lower right", ncols=2)
    plot.draw_without_rendering()  # places, and so which labels would meet, are known from here
    for ax, comparison in zip(axes, comparisons.values(), strict=False):
        name_settings(ax, comparison.rows)
    return plot
