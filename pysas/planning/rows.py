"""Lines anywhere, a few pixels each, as a grid: what contributions of single traces are summed at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.model.grid import Grid


def _none() -> FloatArray:
    return np.empty((0, 3))


@dataclass(frozen=True, eq=False, repr=False)
class Lines(Grid):
    """Pixel m of line r at first[r] + m step[r]; first, step : (line, 3), m."""

    first: FloatArray = field(default_factory=_none)
    step: FloatArray = field(default_factory=_none)

    @classmethod
    def of(cls, first: FloatArray, step: FloatArray, count: int) -> Lines:
        """Lines of `count` pixels."""
        return cls("lines", (len(first), count), {}, first=first, step=step)

    @property
    def ends(self) -> FloatArray:
        """(2 line, 3) first and last pixels."""
        return np.concatenate([self.first, self.first + (self.shape[1] - 1) * self.step])

    def coordinates(self, pixels: npt.ArrayLike | None = None) -> FloatArray:
        """As of any grid."""
        line, number = np.divmod(np.arange(self.size) if pixels is None else np.asarray(pixels), self.shape[1])
        return np.asarray(self.first[line] + number[:, None] * self.step[line])
