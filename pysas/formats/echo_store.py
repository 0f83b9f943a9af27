"""Echoes that stay in their file: navigation is read when it is opened, samples when pings are asked for."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from collections.abc import Iterator
from types import TracebackType
from typing import Any

from pysas import _checks
from pysas.formats import files, io
from pysas.formats.fields import Array, Streamed
from pysas.formats.growing import EchoWriter
from pysas.formats.stores import Store, replacing
from pysas.model.echoes import Echoes

_BLOCK_BYTES = 2**24  # of samples that are read at once


class EchoStore:
    """Echoes of a file, read by pings: `open_echoes` opens one.

    A store that still grows is seen as it was when opened.

    Attributes
    ----------
    path : str
        The file's name.
    navigation : Echoes
        All of the echoes but their samples, for which zeros stand that take no memory: what plans are made from.
    complete : bool
        False: a recorder adds pings, or was ended before it was done.
    stored : str
        How samples lie there.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = files.name(path)
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(io.opened(self.path))
            with io.named(self.path):
                if (schema := file.text("schema")) != io.ECHOES:
                    raise ValueError(f"schema: found {schema!r:.60}, expected {io.ECHOES!r}")
                self.navigation, known = io.read_navigation(file)
            self._file = file
            self._files = stack.pop_all()
        self._whole: Array | None = None
        if unknown := sorted(file.fields.keys() - known):
            warnings.warn(f"{self.path}: ignored, not in {io.ECHOES}: {', '.join(unknown)}", stacklevel=3)
        if not file.reads_rows("data"):
            warnings.warn(f"{self.path}: data are deflated or in Fortran order, and read whole", stacklevel=3)
            with io.named(self.path):
                self._whole = file.read("data")
        self.complete = file.complete if isinstance(file, Store) else True
        self.stored = str(self.navigation.dtype)
        self._step = 1
        if isinstance(file, Store):
            self._step = file.chunk
            self.stored = f"{'int16 I and Q' if file.counts else self.stored}, {file.chunk} pings a chunk"

    @property
    def n_ping(self) -> int:
        """Number of pings."""
        return self.navigation.n_ping

    @property
    def swath(self) -> tuple[float, float]:
        """Slant ranges that the records cover, m."""
        return self.navigation.swath

    def echoes(self, pings: slice = slice(None)) -> Echoes:
        """Some of the pings, and no other's samples read.

        Parameters
        ----------
        pings : slice
            Pings that follow each other: slice(100, 200).

        Raises
        ------
        ValueError
            No ping is left, a step, or damage of the file that these pings show.
        TypeError
            No slice.

        Notes
        -----
        Samples of a store are complex64 or as stored; a store reads whole chunks of pings, each compared with its checksum. Of
        .npz and .h5 that of the whole file is compared where all pings are read in order.
        """
        first, last = self._span(pings)
        some = self.navigation[first:last]
        with io.named(self.path):
            data = self._file.rows("data", first, last) if self._whole is None else self._whole[first:last]
        return some.replace(data=data)

    def blocks(self, pings: slice = slice(None)) -> Iterator[Echoes]:
        """The same pings, a few at a time, as `Strip.stream` takes them: 16 MiB of samples, or one chunk of the store."""
        first, last = self._span(pings)
        ping = math.prod(self.navigation.data.shape[1:]) * self.navigation.dtype.itemsize
        step = max(_BLOCK_BYTES // ping // self._step, 1) * self._step
        while first < last:
            end = min((first // step + 1) * step, last)
            yield self.echoes(slice(first, end))
            first = end

    def save(
        self, path: str | os.PathLike[str], pings: slice = slice(None), *, int16: bool = False, overwrite: bool = False,
        progress: Any = None,
    ) -> None:  # fmt: skip
        """Write some of the pings to another file, a block at a time.

        Parameters
        ----------
        path : str or path
            Ends in .npz, .h5 or .zarr. It takes its place when complete.
        pings : slice
            As in `echoes`.
        int16 : bool
            As in `EchoWriter`, of a .zarr.
        overwrite : bool
            False: a file that is there is an error.
        progress : callable, optional
            Is told the share that is done.

        Raises
        ------
        ValueError, TypeError, OSError, ImportError
            As `save` and `EchoWriter` raise them.
        """
        text = files.name(path)
        _checks.callback("progress", progress)
        first, last = self._span(pings)
        done, passes = [0], 2 if text.lower().endswith(".h5") else 1  # whose checksums come before the samples

        def told() -> Iterator[Echoes]:
            for block in self.blocks(pings):
                yield block
                done[0] += block.n_ping
                if progress is not None:
                    progress(min(done[0] / (passes * (last - first)), 1.0))

        if io.is_store(text):
            with replacing(text, overwrite=overwrite) as folder, EchoWriter(folder, int16=int16) as writer:
                for block in told():
                    writer.append(block)
            return
        if int16:
            raise ValueError(f"{text}: int16: expected a .zarr")
        some = self.navigation[first:last]
        data = Streamed(some.data.shape, some.dtype, lambda: (block.data for block in told()))
        io.write_file(text, io.echo_fields(some) | {"data": data}, overwrite)

    def _span(self, pings: slice) -> tuple[int, int]:
        if not isinstance(pings, slice):
            raise TypeError(f"pings={pings!r:.60}: expected a slice, such as slice(100, 200)")
        first, last, step = pings.indices(self.n_ping)
        if step != 1 or first >= last:
            raise ValueError(f"pings {pings.start}:{pings.stop}: expected some of {self.n_ping} that follow each other")
        return first, last

    def close(self) -> None:
        """Close the file; samples are not to be read any more."""
        self._files.close()

    def __enter__(self) -> EchoStore:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"EchoStore {self.path}, stored as {self.stored}{'' if self.complete else ', not complete'}\n{self.navigation!r}"


def open_echoes(path: str | os.PathLike[str]) -> EchoStore:
    """Open echoes of a file, whose samples stay there until pings are asked for.

    Parameters
    ----------
    path : str or path
        Ends in .zarr, .npz or .h5.

    Returns
    -------
    EchoStore
        With the file held open: `close` it, or use it in a `with` statement.

    Raises
    ------
    ValueError
        As `load` raises it; damage of samples, a missing chunk of them, is told when they are read.
    OSError, ImportError
        From the file system; .h5 without h5py (extra `hdf5`), .zarr without zarr (`survey`).

    Warns
    -----
    UserWarning
        Deflated .npz files, and those in Fortran order, cannot be read by pings and are read whole.

    Notes
    -----
    O(navigation) time and memory.

    Examples
    --------
    >>> with pysas.open_echoes("line.zarr") as store:  # doctest: +SKIP
    ...     for image in strip.stream(store.blocks()):
    ...         ...
    """
    return EchoStore(path)
