"""What single traces contribute to rows of points: the terms of the sum before they are summed over pings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.planner import plan_rows
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.planning.rows import Lines


def contributions(
    echoes: Echoes,
    points: FloatArray,
    traces: npt.NDArray[np.int64],
    *,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
) -> ComplexArray:
    """Sums, at rows of points, of the traces that belong to each row.

    Parameters
    ----------
    echoes : Echoes
        Compressed. Of traces that no row names nothing is read; their samples are finite all the same.
    points : (row, n, 3)
        In m.
    traces : (row, 2) whole numbers
        First and last trace of each row, counted through all pings and channels: ping n_channel + channel.
    tol : float
        As in `backproject`, of all rows together: ||out - exact|| <= tol ||terms||.

    Returns
    -------
    (row, n) of the echoes' dtype
        w s(tau) exp(+2j pi fc tau), w the beam's weight, summed over the row's traces; zero beyond what they recorded.

    Raises
    ------
    ValueError, TypeError
        As of `backproject`; rows and traces that do not go together.

    Notes
    -----
    O(row n traces of a row), with exact delays; each trace is prepared once, whatever the number of rows that ask for it.
    `along_lines` is three times as fast. Memory beyond input and output: a batch of coefficients, about 25 MB, and the points
    once more.
    """
    rows = Grid.points(points)
    if len(rows.shape) != 2:
        raise ValueError(f"points: expected shape (row, n, 3), found {(*rows.shape, 3)}")
    return _summed(echoes, rows, traces, tol, threads, backend)


def along_lines(
    echoes: Echoes,
    first: FloatArray,
    step: FloatArray,
    count: int,
    traces: npt.NDArray[np.int64],
    *,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
) -> ComplexArray:
    """The same at rows of points that lie evenly on lines: as `contributions`, but for

    Parameters
    ----------
    first, step : (row, 3)
        Point m of a row lies at first + m step, m. Rows of up to 64 points, those of the same traces next to each other, are
        fastest: a longer line is several of them.
    count : int
        Points of each row.

    Returns
    -------
    (row, count)
    """
    first, step = (_checks.reals(name, value, [("row", 3)]) for name, value in (("first", first), ("step", step)))
    if first.shape != step.shape or not len(first):
        raise ValueError(f"first, step: {first.shape} and {step.shape}: expected as many of each, one at least")
    return _summed(echoes, Lines.of(first, step, _checks.whole("count", count)), traces, tol, threads, backend)


@_checks.usual_errors
def _summed(
    echoes: Echoes, rows: Grid, traces: npt.NDArray[np.int64], tol: float, threads: int | None, backend: str
) -> ComplexArray:  # fmt: skip
    hears = _checks.array_like("traces", traces)
    number, most = rows.shape[0], echoes.n_ping * echoes.n_channel
    if hears.dtype.kind not in "iu" or hears.shape != (number, 2):
        raise ValueError(f"traces: expected whole numbers ({number}, 2), found {hears.dtype} {hears.shape}")
    bad = (hears[:, 0] < 0) | (hears[:, 0] > hears[:, 1]) | (hears[:, 1] >= most)
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(f"traces: {hears[row].tolist()} of row {row}: expected first <= last of {most} traces")
    by = plan_rows(echoes, rows, np.array(hears, dtype=np.int64, order="C"), tol, threads, backend)
    out = np.zeros(rows.shape, dtype=echoes.dtype)
    by.image(echoes.data, out, "raise", None)
    return out
