"""A plan: how a geometry is imaged, carried out on any data of its shape, and explained."""

from __future__ import annotations

import concurrent.futures
import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.engine import MONOSTATIC, MOVING, Engine
from pysas.engine.survey import Totals
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices


@dataclass(frozen=True)
class Done:
    """What became of some data: the choices that were carried out, which traces were finite, what a person should know, the
    parts of that to be warned of, and the share of the terms that went through trees."""

    totals: Totals
    choices: Choices
    share: float
    finite: npt.NDArray[np.bool_]
    notes: list[str]
    warned: list[str]


class EnginePlan(Protocol):
    """A plan as one engine has it.

    choices : settings; isa : what its kernels run on; share : of the terms, through trees; trees : how many of these;
    why_direct : why trees that were asked for are not used, or nothing; seconds : predicted, on one thread; memory : bytes
    allocated beyond the input.
    """

    @property
    def choices(self) -> Choices: ...

    @property
    def isa(self) -> str: ...

    @property
    def share(self) -> float: ...

    @property
    def trees(self) -> int: ...

    @property
    def why_direct(self) -> str: ...

    @property
    def seconds(self) -> float: ...

    @property
    def memory(self) -> int: ...

    def describe(self) -> str:
        """For print(plan)."""

    def other(self) -> str:
        """The method that is not used: its predicted time, or why it cannot be."""

    def follow(self, before: EnginePlan) -> None:
        """Work in the memory that a plan before, of the same engine, keeps."""

    def image(
        self, samples: ComplexArray, image: ComplexArray, nan: str, progress: Callable[[float], None] | None
    ) -> Done:  # fmt: skip
        """Image `samples` into `image`, of the grid's shape and any strides, which is overwritten."""


class Plan:
    """How to image a geometry: call it with data shaped like the echoes' it was made from.

    Attributes
    ----------
    choices : Choices
    tol : float
    """

    def __init__(
        self, echoes: Echoes, grid: Grid, tol: float, scene: Scene, engine: Engine, threads: int, nan: str, method: str,
        by: EnginePlan, execute: Callable[[Plan, npt.ArrayLike, ComplexArray | None, Callable[[float], None] | None], Image],
        again: Callable[[npt.NDArray[np.int64]], Plan] | None = None,
    ) -> None:  # fmt: skip
        self.by, self.execute, self.again = by, execute, again
        self.windows = echoes.windows
        self.tol, self.threads, self.engine = tol, threads, engine
        self.grid, self.scene, self.nan = grid, scene, nan
        self.method = "ffbp" if by.trees else method
        self.data_shape, self.dtype = echoes.data.shape, echoes.dtype
        self.silent = scene.why_empty()
        if self.silent:
            _checks.warn(self.silent)

    @property
    def choices(self) -> Choices:
        """Settings, and the bound of each contribution to the error."""
        return self.by.choices

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return self.engine.name

    def __call__(
        self, data: npt.ArrayLike, out: ComplexArray | None = None, progress: Callable[[float], None] | None = None
    ) -> Image:
        """Image `data`.

        Parameters
        ----------
        data : array of the echoes' shape and dtype
        out : complex array of grid.shape, optional
            Written in place and returned as the image's data.
        progress : callable, optional
            Called from this thread with the share done, 0 to 1.

        Returns
        -------
        Image

        Raises
        ------
        ValueError, TypeError
            Wrong shape or dtype; non-finite samples (first ping and channel named) with nan="raise"; an `out` that overlaps the
            data or itself; an image beyond its dtype's range.

        Warns
        -----
        UserWarning
            No term is summed, and why; an image so small that its dtype does not hold it within tol.

        Notes
        -----
        With nan="mask" data whose traces end earlier than planned, in non-finite samples, are planned anew.
        O(traces (pixels + n_fft log n_fft)); memory beyond input and output: one batch of coefficients, about 25 MB.
        """
        return self.execute(self, data, out, progress)

    def stream(self, batches: Iterable[npt.ArrayLike]) -> Iterator[Image]:
        """Images of many data sets, in their order: the next is read on a thread while one is summed.

        Parameters
        ----------
        batches : iterable of arrays of the echoes' shape and dtype
            Such as a generator that reads files: it runs on a thread of its own, one batch ahead. Each batch is an array of its
            own: one that is refilled for the next would be summed while it changes.

        Returns
        -------
        iterator of Image
            Nothing is read before the first is asked for. Closed early (`close`, or dropped), it waits for the batch being
            read, which is lost, and leaves no thread.

        Raises
        ------
        TypeError
            At once, where `batches` is not iterable.
        ValueError, TypeError, or what the iterable raises
            Instead of the image of the batch that is wrong or could not be read, after all before it; a note of the exception
            counts the batch, from 0. The stream ends there.

        Notes
        -----
        Time of an image: the longer of reading and imaging, where reading leaves the interpreter free. Memory: two batches
        and an image.
        """
        try:
            source = iter(batches)
        except TypeError:
            raise TypeError(f"batches={type(batches).__name__}: expected an iterable of arrays") from None
        return self._stream(source)

    def _stream(self, source: Iterator[npt.ArrayLike]) -> Iterator[Image]:
        def read() -> list[npt.ArrayLike]:
            return list(itertools.islice(source, 1))

        with concurrent.futures.ThreadPoolExecutor(1, thread_name_prefix="pysas-stream") as reader:
            coming = reader.submit(read)
            for number in itertools.count():
                try:
                    batch = coming.result()
                    if not batch:
                        return
                    coming = reader.submit(read)
                    image = self(batch[0])
                except Exception as error:
                    error.add_note(f"batch {number} of the stream")
                    raise
                batch.clear()  # not kept while the image is in use
                yield image

    def __str__(self) -> str:
        return self.by.describe()

    @property
    def predicted_seconds(self) -> float:
        """Rough time of an image on this many threads, s, the planning of trees included.

        By constants of the planner, not measured on this machine.
        """
        return self.by.seconds / self.threads

    @property
    def predicted_memory(self) -> int:
        """Bytes allocated beyond the input: image, one batch of coefficients, workers' tiles."""
        return self.by.memory

    @_checks.usual_errors
    def explain(self) -> str:
        """What the scene has, what was left out and the share of work saved, where the error goes, and the alternatives.

        The other method comes with its predicted time, or why it is not taken; the Fourier algorithms of
        `pysas.reference` are named where the track is straight and even.
        """
        c, scene = self.choices, self.scene
        lines = [str(self), "  left out"]
        silent = scene.traces - int(np.count_nonzero(scene.heard))
        saved = 1 - c.length / scene.n_sample
        recorded = float(np.mean(scene.valid[:, 1] - scene.valid[:, 0] + 1)) / scene.n_sample
        masked = 1 - scene.pixels / self.grid.size
        rows = [
            (scene.kind == MONOSTATIC, "second square root: transmitter and receiver at one place"),
            (scene.kind != MOVING, "receivers' motion within the ping: no velocity"),
            (not scene.uniform, "weights that differ from pixel to pixel: not asked for"),
            (not scene.beamed, f"beam: {'it reaches every pixel from every ping' if scene.all_lit else 'none given'}"),
            (c.precision == "float32", "float64 in the inner loop: tol does not need it"),
            (recorded < 1, f"{100 * (1 - recorded):.3g} % of the samples: not recorded"),
            (saved > 0, f"{100 * saved:.0f} % of each record: no pixel needs it"),
            (silent > 0, f"{silent} of {scene.traces} traces: no pixel within their window"),
            (masked > 0, f"{100 * masked:.0f} % of the pixels: masked"),
        ]
        lines += [f"    - {text}" for used, text in rows if used]
        lines += ["  error bounds"] + [f"    - {name}: {value:.2g}" for name, value in c.errors.items()]
        lines += ["  alternatives", f"    - {self.by.other()}"]
        if scene.even_line():
            first = "" if scene.kind == MONOSTATIC and scene.channels == 1 else ", of reference.phase_centres"
            lines += [
                f"    - omega-k, range-Doppler, chirp scaling (pysas.reference{first}): the track is straight and even;",
                "      never chosen: they image the slant plane and keep no tol",
            ]
        return "\n".join(lines)
