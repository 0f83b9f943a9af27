"""One pass over all samples: what each trace holds, for the checks that need no more than that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.model.echoes import Echoes

_SAMPLES = 1 << 20  # of a block of pings

Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Levels:
    """Of every trace, (ping, channel).

    Attributes
    ----------
    bad : tuple of int, optional
        Ping, channel and sample of the first value that is not finite.
    finite : bool
        All its samples are.
    rms : float64
        Root of the mean of |sample|^2.
    mean : complex128
        Mean of the samples.
    top : float64
        Largest real or imaginary part.
    at_top : int64
        Real and imaginary parts that have just this size.
    constant : bool
        All samples have one value.
    real : bool
        No sample has an imaginary part.
    """

    bad: tuple[int, int, int] | None
    finite: Bool
    rms: FloatArray
    mean: npt.NDArray[np.complex128]
    top: FloatArray
    at_top: npt.NDArray[np.int64]
    constant: Bool
    real: Bool

    @property
    def sounding(self) -> Bool:
        """Finite traces with anything in them."""
        return np.asarray(self.finite & (self.top > 0))


def measured(echoes: Echoes) -> Levels:
    """The levels of all traces; O(samples), in blocks of 2^20 of them. Those that are not finite have no level: 0."""
    shape = echoes.traces.shape[:2]
    columns: dict[str, npt.NDArray[Any]] = {
        "finite": np.zeros(shape, dtype=bool), "rms": np.zeros(shape), "mean": np.zeros(shape, dtype=complex),
        "top": np.zeros(shape), "at_top": np.zeros(shape, dtype=np.int64), "constant": np.zeros(shape, dtype=bool),
        "real": np.zeros(shape, dtype=bool),
    }  # fmt: skip
    bad = None
    step = max(1, _SAMPLES // (shape[1] * echoes.n_sample))
    for ping in range(0, shape[0], step):
        rows = slice(ping, ping + step)
        traces = np.ascontiguousarray(echoes.traces[rows], dtype=echoes.dtype)
        # real and imaginary parts in turn
        parts = traces.view(traces.real.dtype)
        size = np.abs(parts)
        top = size.max(axis=-1).astype(np.float64)
        finite = np.isfinite(top)
        if bad is None and not finite.all():
            first = np.argwhere(~np.isfinite(traces))[0]
            bad = (int(first[0]) + ping, int(first[1]), int(first[2]))
        with np.errstate(invalid="ignore", over="ignore"):
            scale = np.where(finite & (top > 0), top, 1.0)
            mean = np.mean(np.square(parts / scale[..., None]), axis=-1)
            columns["rms"][rows] = np.where(finite, scale * np.sqrt(2 * mean), 0)
            columns["mean"][rows] = np.where(finite, traces.mean(axis=-1, dtype=complex), 0)
            columns["constant"][rows] = finite & np.all(traces == traces[..., :1], axis=-1)
        columns["finite"][rows] = finite
        columns["top"][rows] = np.where(finite, top, 0)
        columns["at_top"][rows] = np.count_nonzero(size == top[..., None].astype(size.dtype), axis=-1)
        columns["real"][rows] = finite & ~traces.imag.any(axis=-1)
    return Levels(bad, **columns)
