"""Sub-images and their interpolation, as the kernels of fast factorised back-projection take them. See docs/ffbp.md.

A sub-image is what a group of traces makes of a horizontal plane, on a polar grid about the foot of the group's centre. Its
carrier about the centre taken away, nodes are filtered along both axes so that few taps read between them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray

WIDTHS = (8,)  # taps the kernels are made for


@dataclass(frozen=True)
class Taps:
    """Interpolation between nodes `rate` times as dense as the band needs.

    tap : (width + 1, width) float32, powers by taps, of places x in [-1/2, 1/2] from an interval's middle; filter : (half + 1,)
    float32, the symmetric filter that undoes the taps' smoothing; worst, rms : error of a component over band and places.
    """

    width: int
    rate: float
    tap: npt.NDArray[np.float32]
    filter: npt.NDArray[np.float32]
    worst: float
    rms: float

    @property
    def reach(self) -> int:
        """Nodes beside a place that it depends on."""
        return len(self.filter) - 1 + self.width // 2


@functools.lru_cache(maxsize=64)
def taps(width: int, rate: float, half: int) -> Taps:
    """The best Kaiser-Bessel taps of a width, and the filter that makes them interpolate |f| <= 1/(2 rate) per node.

    With A the filter's response and S(f, x) the taps' sum at place x, A S = 1 is solved by least squares over band and
    places, the band's edge weighing most (near-minimax). As in non-uniform FFTs (Fessler & Sutton, 2003) such taps need far
    fewer than an interpolator of plain samples.
    """
    found = [_design(width, rate, half, beta) for beta in np.arange(1.7 * width, 2.3 * width, 0.04 * width)]
    return min(found, key=lambda t: t.worst)


def _design(width: int, rate: float, half: int, beta: float) -> Taps:
    degree = width
    # densest at the band's edge: the error's last extremum lies within 2 % of it
    x, f = np.linspace(-0.5, 0.5, 17), 0.5 / rate * np.sin(np.linspace(0, np.pi / 2, 33))
    offset = np.arange(width) - (width - 1) / 2
    nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)) / 2
    z = 2 * (offset[:, None] - nodes) / width
    values = np.i0(beta * np.sqrt(np.maximum(1 - z * z, 0))) / np.i0(beta)
    power = np.linalg.solve(np.vander(nodes, increasing=True), values.T)  # (degree + 1, width)
    weight = np.vander(x, degree + 1, increasing=True) @ power
    total = np.einsum("xt,xtf->fx", weight, np.exp(2j * np.pi * (offset[:, None] - x[:, None, None]) * f))
    k = np.arange(half + 1)
    cosines = np.where(k == 0, 1, 2) * np.cos(2 * np.pi * f[:, None] * k)
    system = (cosines[:, None] * total[..., None]).reshape(-1, half + 1)
    edge = np.repeat((1.02 - (f / f[-1]) ** 2) ** -0.25, x.size)
    rows = np.concatenate([system.real, system.imag]) * np.tile(edge, 2)[:, None]
    filter = np.linalg.lstsq(rows, np.concatenate([edge, 0 * edge]))[0]
    error = np.abs(system @ filter - 1)
    worst, rms = float(error.max()), float(np.sqrt(np.mean(error**2)))
    return Taps(width, rate, power.astype(np.float32), filter.astype(np.float32), worst, rms)


@dataclass(frozen=True)
class PolarGrid:
    """Nodes of a sub-image: rays from bearing `angle`, `beam` rad apart, nodes from ground distance `near`, `step` m apart.

    What is read lies at bearings from `low` on, less than a turn behind it.
    """

    centre: FloatArray  # of the group's phase centres
    plane: float  # its height
    low: float
    angle: float
    beam: float
    near: float
    step: float
    shape: tuple[int, int]  # rays, nodes

    @property
    def height(self) -> float:
        """Of the centre above the plane."""
        return float(self.centre[2]) - self.plane

    @property
    def slant(self) -> FloatArray:
        """Ranges of a ray's nodes from the centre."""
        return np.asarray(np.hypot(self.near + np.arange(self.shape[1]) * self.step, self.height))

    def lines(self) -> tuple[FloatArray, FloatArray]:
        """First node and step (ray, 3) of the rays, which are even lines."""
        bearing = self.angle + np.arange(self.shape[0]) * self.beam
        away = np.stack([np.cos(bearing), np.sin(bearing), 0 * bearing], axis=1)
        return np.append(self.centre[:2], self.plane) + self.near * away, self.step * away
