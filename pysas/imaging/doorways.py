"""The doorways: echoes and a grid in, an image out, within a stated relative error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy.typing as npt

from pysas._checks import ComplexArray
from pysas.imaging import several
from pysas.imaging.several import How
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image

Weights = npt.ArrayLike | str | None


def backproject(
    echoes: Echoes | Sequence[Echoes],
    grid: Grid,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    weights: Weights | Sequence[Weights] = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """Sum s(tau) exp(+2j pi fc tau) over pings and channels at every pixel of `grid`.

    Parameters
    ----------
    echoes : Echoes, or a list or tuple of them
        Range-compressed echoes; any track and array, moving receivers included. Of several (bands, arrays, pairs of
        transmitters and receivers, each with its own sampling, carrier and geometry, of one dtype) the images are summed.
    grid : Grid
    tol : float
        Relative error that is kept: ||I - I_exact||_2 <= tol max(||I_exact||_2, ||R||_2) over the grid, where I_exact is
        `pysas.reference.exact` and R the incoherent level it returns. complex64: 1e-1 to 1e-5; complex128: down to
        max(1e-10, 1e-14 range/wavelength). Of several Echoes each image keeps it; errors of different samples are unrelated and
        add as squares, as R^2 does, and so the sum keeps it too.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS, else all processors. The image is the same for any number.
    backend : {"auto", "numba", "cpp"}
    weights : (ping,) or (ping, channel) array_like, or "uniform-angle", optional
        Real or complex factors of the terms; 0 leaves a trace out. "uniform-angle": each term weighs what
        `pysas.circular.view_weights` says, the arc of view angles that it stands for, so that the point spread function
        is the same all over the image; a small part of `tol` is theirs. Where views change their order over the image every
        pixel has its own arcs, some twenty times slower; `print(plan)` tells. Of several Echoes a list, an entry each, or None.
    nan : {"raise", "mask"}
        Non-finite samples where `echoes.valid` says that something was recorded: an error; or those at a trace's ends shorten
        its `valid`, and a trace with others, or with no finite one, is left out of the sum. The report's notes count both.
    out : complex array of grid.shape, optional
        Filled in place and returned as the image's data; of the data's dtype, in memory of its own.
    progress : callable, optional
        Called now and then from the calling thread with the share done, 0 to 1.

    Returns
    -------
    Image
        Of the data's dtype; `image.report` says what was done. Of several Echoes: one report of all, with the settings of each
        under "echoes 0", "echoes 1" ... in its choices; the image's fc and c are means over all traces.

    Raises
    ------
    ValueError
        Raw or under-sampled echoes, a `tol` that cannot be met, non-finite samples, wrong shapes, an `out` that overlaps the
        data or itself, an image beyond its dtype's range.
    TypeError
        Wrong types or dtypes; masked entries of a masked array.

    Warns
    -----
    UserWarning
        No term is summed, and why (recorded window, beam, mask, weights, non-finite samples): the image is zero. An image so
        small that its dtype does not hold it within tol.

    Notes
    -----
    O(pings channels pixels) after O(pings channels samples log samples); memory beyond input and image about 25 MB.
    """
    return several.image(echoes, grid, How(tol, "backprojection", threads, backend, nan), weights, out, progress)


def ffbp(
    echoes: Echoes | Sequence[Echoes],
    grid: Grid,
    tol: float = 1e-3,
    fallback: bool = True,
    threads: int | None = None,
    backend: str = "auto",
    weights: Weights | Sequence[Weights] = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """The image of `backproject`, through a tree of sub-apertures: about N^2 log N work where that takes N^3.

    Parameters
    ----------
    echoes : Echoes, or a list or tuple of them
        Range-compressed echoes; any track and array, moving receivers included; as in `backproject`.
    grid : Grid
    tol : float
        Relative error that is kept, as in `backproject`.
    fallback : bool
        Whether terms that cannot be factorised, or not within `tol`, are summed directly: pixels near the track or across
        the ends of records or beams, relief too high for its track, tolerances below 3e-5. False: an error says why.
        `image.report.factorised_share` tells how much went through the tree.
    threads, backend, weights, nan, out, progress
        As in `backproject`.

    Returns
    -------
    Image

    Raises
    ------
    ValueError, TypeError
        As `backproject`; also where `fallback` is False and terms would have to be summed directly: by their geometry, or
        as samples beside those that pixels read are too bright for trees.

    Notes
    -----
    Memory beyond input and image: one batch of tables (about 25 MB) and of leaves, and one sub-image of each level above.
    """
    return several.image(echoes, grid, How(tol, "ffbp", threads, backend, nan, fallback), weights, out, progress)


def focus(
    echoes: Echoes | Sequence[Echoes],
    grid: Grid,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    weights: Weights | Sequence[Weights] = None,
    nan: str = "raise",
    out: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """The image of `backproject` by whichever engine has the least predicted time: `backproject` or `ffbp`.

    Parameters
    ----------
    echoes : Echoes, or a list or tuple of them
        Range-compressed echoes; any track and array, moving receivers included; as in `backproject`.
    grid : Grid
    tol : float
        Relative error that is kept, whichever engine it is; as in `backproject`.
    threads, backend, weights, nan, out, progress
        As in `backproject`.

    Returns
    -------
    Image
        `image.report.method` names the engine; `plan(echoes, grid, tol).explain()` says why.

    Raises
    ------
    ValueError, TypeError
        As `backproject`.

    Notes
    -----
    O(pings channels pixels) for few pings or pixels, about O(N^2 log N) for N of each a side. `plan` for data to come.
    """
    return several.image(echoes, grid, How(tol, "auto", threads, backend, nan), weights, out, progress)


def backproject_arrays(
    data: Any,
    pixels: Any,
    *,
    fs: float,
    fc: float,
    tx: Any,
    rx: Any,
    c: Any = 1500.0,
    t0: Any = 0.0,
    velocity: Any = None,
    bandwidth: float | None = None,
    weights: npt.ArrayLike | str | None = None,
    tol: float = 1e-3,
    threads: int | None = None,
    backend: str = "auto",
    out: ComplexArray | None = None,
) -> ComplexArray:
    """`backproject` for other people's programs: plain arrays in, the image's array out.

    Parameters
    ----------
    data : (ping, channel, sample) or (ping, sample) complex array
        Range-compressed samples, as in `Echoes`; anything with `__array_interface__`, `__dlpack__` on the CPU, or the
        buffer protocol, read where it lies.
    pixels : (..., 3) array
        Pixels, m. Where the last but one axis runs along even lines, as in a regular image, the fast path is taken.
    fs, fc, tx, rx, c, t0, velocity, bandwidth
        As in `Echoes`.
    weights, tol, threads, backend
        As in `backproject`.
    out : complex array of shape pixels.shape[:-1], optional
        Filled in place and returned.

    Returns
    -------
    complex array of shape pixels.shape[:-1]

    Raises
    ------
    ValueError, TypeError
        As `Echoes`, `Grid.points` and `backproject` do.
    """
    echoes = Echoes(data, fs=fs, fc=fc, tx=tx, rx=rx, c=c, t0=t0, velocity=velocity, bandwidth=bandwidth)
    return backproject(echoes, Grid.points(pixels), tol, threads, backend, weights, out=out).data
