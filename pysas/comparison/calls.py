"""The methods there are, in their settings, as calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from pysas import reference
from pysas.imaging.doorways import backproject, ffbp
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image

Call = Callable[[], Image]

TOLS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
_ENGINES: dict[str, Callable[..., Image]] = {"backproject": backproject, "ffbp": ffbp}


def methods(
    echoes: Echoes,
    grid: Grid,
    tols: Sequence[float] = TOLS,
    *,
    raw: Echoes | None = None,
    line: Echoes | None = None,
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
    line : Echoes, optional
        What omega-k, range-Doppler and one-way migration image, such as `reference.phase_centres(echoes)`, range-compressed.
        Default: `echoes`.
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
    line = echoes if line is None else line
    for name, engine in _ENGINES.items():
        for tol in tols:
            found[name, f"tol {tol:g}"] = partial(engine, echoes, grid, tol, threads=threads)
    settings = [("sinc", 2), ("cubic", 2), ("linear", 2), ("linear", 8)]
    for interpolation, padding in settings if fewer else [*settings, ("linear", 1), ("linear", 4)]:
        found["omega-k", f"{interpolation}, zp {padding}"] = partial(
            reference.omega_k, line, interpolation=interpolation, zero_padding=padding, weight="backprojection",
            threads=threads,
        )  # fmt: skip
    for interpolation in ("sinc", "linear"):
        found["range-Doppler", interpolation] = partial(
            reference.range_doppler, line, interpolation=interpolation, threads=threads
        )
    found["chirp scaling", "raw echoes"] = partial(_chirp_scaling, raw, threads)
    for angle in (45,) if fewer else (15, 45, 65):
        found["one-way", f"{angle} degrees"] = partial(
            reference.one_way, line, angle=angle, weight="backprojection", half_angle=half_angle, threads=threads
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
