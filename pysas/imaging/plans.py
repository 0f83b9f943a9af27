"""A plan: how a geometry is imaged, carried out on any data of its shape, and explained."""

from __future__ import annotations

import concurrent.futures
import itertools
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.engine import MONOSTATIC, MOVING, Engine
from pysas.engine.survey import rows_per_task
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image
from pysas.planning import view_angles
from pysas.planning.costs import prepare_seconds, sum_seconds
from pysas.planning.forest import Forest
from pysas.planning.raster import Raster
from pysas.planning.scene import Scene
from pysas.planning.settings import Choices, reader_of


@dataclass(frozen=True)
class Terms:
    """Some of a plan's terms: flat numbers of their traces, and the samples nearest to where pixels read them.

    heard, edges : all traces that pixels hear, and the least and the largest place (2, trace) that any pixel can read there.
    """

    trace: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]
    heard: npt.NDArray[np.int64]
    edges: npt.NDArray[np.int64]


class Plan:
    """How to image a geometry: call it with data shaped like the echoes' it was made from.

    Attributes
    ----------
    choices : Choices
    tol : float
    """

    def __init__(
        self,
        echoes: Echoes,
        grid: Grid,
        tol: float,
        scene: Scene,
        choices: Choices,
        threads: int,
        engine: Engine,
        nan: str,
        method: str,
        forest: Forest | None,
        why_direct: str,
        budget: float,
        fallback: bool,
        execute: Callable[[Plan, npt.ArrayLike, ComplexArray | None, Callable[[float], None] | None], Image],
        alternative: Callable[[Plan], str],
    ) -> None:
        self.budget = budget  # of tol: what choices were made for
        self.execute, self.alternative = execute, alternative
        self.fallback = fallback  # whether trees may be left for data that are too bright for them
        self.terms: Terms | None = None  # looked at when data arrive, see levels.py
        self.others: dict[str, Plan] = {}  # that take this one's place for some data
        self.tol, self.choices, self.threads, self.engine = tol, choices, threads, engine
        self.grid, self.scene, self.nan = grid, scene, nan
        self.method, self.forest, self.why_direct = method, forest, why_direct
        self.data_shape, self.dtype = echoes.data.shape, echoes.dtype
        self.raster = Raster(grid, scene, choices.block) if forest is None else forest.raster
        self.reported = choices.reported()
        self.reader = reader_of(choices, scene.band)
        self.silent = scene.why_empty()
        if self.silent:
            warnings.warn(self.silent, stacklevel=5)

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
        c, scene = self.choices, self.scene
        shape = " x ".join(map(str, self.grid.shape))
        delay = f"polynomials over {c.block} pixels, exact below {c.near:.3g} m" if c.block else "exact per pixel"
        kept = f"{c.length} of {scene.n_sample} samples" + (f", tapered over {c.taper}" if c.taper else "")
        made = [f"transforms of {c.n_fft} and {c.n_fine}"] * bool(c.n_fft) + [f"a filter of {c.taps} taps"] * bool(c.taps)
        return "\n".join(
            [
                f"Plan: {self.method} of {scene.traces} traces on {shape} pixels, tol {self.tol:g}",
                f"  backend        {self.backend}, {c.precision}, {self.threads} threads, batches of {c.batch} traces",
                f"  traces         {kept}, {', '.join(made)}",
                f"  interpolation  degree {c.degree} at {c.oversampling:.3g} x the sample rate",
                f"  delay          {c.delay}, {delay}",
                f"  terms          {scene.traces * scene.pixels:.4g} at most",
                *(self.forest.describe() if self.forest is not None else []),
                *([f"  direct sum     {self.why_direct}"] if self.why_direct else []),
                *(["  view angles    every pixel's own: views change their order over the image"] if scene.each else []),
                f"  predicted      error {c.predicted_error:.2g}, time {self.predicted_seconds:.2g} s, "
                f"memory {self.predicted_memory / 2**20:.0f} MB beyond the input",
            ]
        )

    @property
    def predicted_seconds(self) -> float:
        """Rough time of an image on this many threads, s, the planning of trees that C++ grows included.

        By constants of the planner, not measured on this machine.
        """
        if self.forest is not None:
            return self.forest.seconds / self.threads
        direct = sum_seconds(self.scene, self.choices, self.engine.costs()) + prepare_seconds(self.scene, self.choices)
        if self.scene.each:
            direct += 1e-9 * view_angles.ARC_NS.get(self.engine.costs(), 40.0) * self.scene.pixels * self.scene.traces
        return direct / self.threads

    @property
    def wide(self) -> bool:
        """Whether the image is a sum of so many batches, or trees, that complex64 would round it too often."""
        c = self.choices
        rounds = -(-self.scene.traces // c.batch)
        if self.forest is not None:
            rounds += max(len(section.trees) for section in self.forest.sections)
        return bool(self.dtype == np.complex64 and rounds > c.run // 8)

    @property
    def predicted_memory(self) -> int:
        """Bytes allocated beyond the input: image, one batch of coefficients, workers' tiles."""
        c, scene = self.choices, self.scene
        item = 8 if c.precision == "float32" else 16
        work = (16 * self.grid.size if self.wide else 0) + c.batch * c.length * c.oversampling * (c.degree + 1) * item
        if c.n_fft:
            work += self.threads * rows_per_task(c.n_fine) * (c.length + 2 * c.n_fft + 3 * c.n_fine) * item
        if not c.block:
            work += 24 * min(self.engine.slab, self.grid.size)
        if self.forest is not None:
            work += self.forest.store_bytes
        if scene.lattice is not None:
            work += scene.lattice.value.nbytes
        if scene.each:
            work += min(view_angles.BYTES, self.scene.pixels * self.scene.traces * item // 2)
        return int(self.grid.size * self.dtype.itemsize + work)

    @_checks.usual_errors
    def explain(self) -> str:
        """What the scene has, what was left out and the share of work saved, where the error goes, and the alternatives.

        The other engine comes with its predicted time, or why it cannot keep `tol`; the Fourier algorithms of
        `pysas.reference` are named where the track is straight and even.
        """
        c, scene = self.choices, self.scene
        lines = [str(self), "  left out"]
        silent = scene.traces - int(np.count_nonzero(scene.heard))
        saved = 1 - c.length / scene.n_sample
        masked = 1 - scene.pixels / self.grid.size
        rows = [
            (scene.kind == MONOSTATIC, "second square root: transmitter and receiver at one place"),
            (scene.kind != MOVING, "receivers' motion within the ping: no velocity"),
            (not scene.uniform, "weights that differ from pixel to pixel: not asked for"),
            (scene.cos_beam <= -1, f"beam: {'it reaches every pixel from every ping' if scene.all_lit else 'none given'}"),
            (c.precision == "float32", "float64 in the inner loop: tol does not need it"),
            (saved > 0, f"{100 * saved:.0f} % of each record: no pixel needs it"),
            (silent > 0, f"{silent} of {scene.traces} traces: no pixel within their window"),
            (masked > 0, f"{100 * masked:.0f} % of the pixels: masked"),
        ]
        lines += [f"    - {text}" for used, text in rows if used]
        lines += ["  error bounds"] + [f"    - {name}: {value:.2g}" for name, value in c.errors.items()]
        lines += ["  alternatives", f"    - {self.alternative(self)}"]
        if scene.even_line():
            first = "" if scene.kind == MONOSTATIC and scene.channels == 1 else ", of reference.phase_centres"
            lines += [
                f"    - omega-k, range-Doppler, chirp scaling (pysas.reference{first}): the track is straight and even;",
                "      never chosen: they image the slant plane and keep no tol",
            ]
        return "\n".join(lines)
