"""What single traces contribute to rows of points: the terms of the sum before they are summed over pings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.imaging.doorways import backproject
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid


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
        Compressed.
    points : (row, n, 3)
        In m.
    traces : (row, 2) whole numbers
        First and last trace of each row, counted through all pings and channels (ping n_channel + channel): at most one ping's.
    tol : float
        As in `backproject`, of all rows together.

    Returns
    -------
    (row, n) of the echoes' dtype
        s(tau) exp(+2j pi fc tau), summed over the row's traces; zero beyond what they recorded.
    """
    out = np.zeros(points.shape[:2], dtype=echoes.dtype)
    for row, (first, last) in enumerate(traces):
        ping, channel = divmod(int(first), echoes.n_channel)
        some = echoes[ping : ping + 1]
        if echoes.data.ndim == 3:
            some = some.channels(range(channel, channel + int(last - first) + 1))
        out[row] = backproject(some, Grid.points(points[row]), tol=tol, threads=threads, backend=backend).data
    return out
