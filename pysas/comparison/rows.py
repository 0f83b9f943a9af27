"""What is found of each method, and which are the best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

Pair = tuple[float | None, float | None]


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


def front(rows: Sequence[Row]) -> list[int]:
    """Indices of the Pareto front: the rows that no other beats in both time and error, the fastest first."""
    found, least = [], np.inf
    for index in sorted(range(len(rows)), key=lambda i: (rows[i].seconds, rows[i].error)):
        if rows[index].error < least:
            least = rows[index].error
            found.append(index)
    return found
