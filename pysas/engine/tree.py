"""Sub-images and their interpolation, as the kernels of fast factorised back-projection take them. See docs/ffbp.md.

A sub-image is what a group of traces makes of a horizontal plane, its carrier about the group's centre taken away, sampled
at (g, angle) about the centre's foot. Nodes are filtered along both axes so that few taps read between them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray

IntArray = npt.NDArray[np.int64]
WIDTHS = (6, 8)  # taps the kernels are compiled for
PLACE, SHAPE = 7, 5  # columns: centre (3), plane, first angle, angle step, node step; i0, rays, stride, offset, first range


@dataclass(frozen=True)
class Taps:
    """Interpolation between nodes `rate` times as dense as the band needs.

    even, odd : (pairs, powers) float32, polynomials of tap p at x in [-1/2, 1/2] from an interval's middle, in x^2 (odd: times
    x); tap : (width + 1, 8) float32, the same as powers by taps; filter : (half + 1,) float32, the symmetric filter that
    undoes the taps' smoothing; worst, rms : error of a component over band and places.
    """

    width: int
    rate: float
    even: npt.NDArray[np.float32]
    odd: npt.NDArray[np.float32]
    tap: npt.NDArray[np.float32]
    filter: npt.NDArray[np.float32]
    worst: float
    rms: float

    @property
    def half(self) -> int:
        return len(self.filter) - 1

    @property
    def reach(self) -> int:
        """Nodes beside a place that it depends on."""
        return self.half + self.width // 2


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
    half_power = power[:, : width // 2].T  # taps p and width - 1 - p mirror each other
    mirror = power[:, ::-1][:, : width // 2].T
    tap = np.zeros((degree + 1, 8))
    tap[:, :width] = power
    even, odd = ((half_power + mirror) / 2)[:, 0::2], ((half_power - mirror) / 2)[:, 1::2]
    single = [np.ascontiguousarray(a, np.float32) for a in (even, odd, tap, filter)]
    worst, rms = float(error.max()), float(np.sqrt(np.mean(error**2)))
    return Taps(width, rate, single[0], single[1], single[2], single[3], worst, rms)


@dataclass(frozen=True)
class SubImages:
    """The sub-images of a level's groups.

    place : (n, PLACE) float64; shape : (n, SHAPE) int64; range : (rays of all, 2) int32, nodes summed on each ray; span :
    (n + 1,) int64, of the level below (or traces) what image i is made of; size : floats of the store that holds their rows.
    """

    place: FloatArray
    shape: IntArray
    range: npt.NDArray[np.int32]
    span: IntArray
    size: int

    def __len__(self) -> int:
        return len(self.place)

    @property
    def nodes(self) -> int:
        """Nodes summed."""
        return int(np.sum(np.maximum(self.range[:, 1] - self.range[:, 0], 0), dtype=np.int64))

    def part(self, begin: int, end: int) -> SubImages:
        """Some of them, in a store of their own."""
        shape = self.shape[begin:end].copy()
        shape[:, 3] -= shape[0, 3]
        size = int(shape[-1, 3] + 2 * shape[-1, 1] * shape[-1, 2])
        return SubImages(self.place[begin:end], shape, self.range, self.span[begin : end + 1] - self.span[begin], size)
