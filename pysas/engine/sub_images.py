"""Sub-images of fast factorised back-projection, smoothed and read by Numba's kernels on worker threads. See docs/ffbp.md.

Tasks own what they write and every sum has one order: the image is the same for any number of threads.
"""

from __future__ import annotations

import numpy as np

from pysas import _pool as pool
from pysas._checks import ComplexArray
from pysas.engine import _numba_tree
from pysas.engine.survey import Raster, Trigonometry
from pysas.engine.tree import PolarGrid, Taps

AT_ONCE = 2**14  # reals that a task smooths


def read(
    held: ComplexArray, grid: PolarGrid, taps: Taps, wave: float, carrier: Trigonometry, raster: Raster, image: ComplexArray,
    threads: int,
) -> None:  # fmt: skip
    """See Parts.read."""
    held *= np.exp(-2j * np.pi * (wave * grid.slant % 1)).astype(np.complex64)
    store, other = held.reshape(-1).view(np.float32), np.zeros(2 * held.size, dtype=np.float32)
    nodes, tiles = held.shape[1], raster.tiles()
    for apart in (2, 2 * nodes):  # along rays, then across them

        def smooth(task: int, apart: int = apart, source: object = store, out: object = other) -> None:
            pool.call(_numba_tree.smooth, taps.filter, apart, task * AT_ONCE, (task + 1) * AT_ONCE, source, out)

        pool.run(smooth, -(-store.size // AT_ONCE), threads)
        store, other = other, store
    polar = (grid.low, grid.angle, grid.beam, grid.near, grid.step, grid.height)
    sines, cosines = (tuple(np.float32(v) for v in terms) for terms in carrier)

    def look(task: int) -> None:
        tile = tiles[task]
        _, lines, active = raster.locate(tile)
        out = np.zeros((tile.last - tile.first, tile.right - tile.left), dtype=np.complex64)
        pool.call(_numba_tree.read, store, nodes, grid.centre, polar, taps.tap, wave, sines, cosines, lines, active, out)
        image[tile.first : tile.last, tile.left : tile.right] += out

    pool.run(look, len(tiles), threads)
