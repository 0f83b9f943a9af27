"""Writing a store of echoes ping by ping, while the sonar runs."""

from __future__ import annotations

import os
from types import TracebackType
from typing import Any

import numpy as np

from pysas._checks import FloatArray
from pysas.formats import files, io, stores
from pysas.formats.fields import Array
from pysas.model.echoes import Echoes


class EchoWriter:
    """Pings to a store, a Zarr v3 group of schema "pysas-echoes-1" (extra `survey`), one or many at a time.

    Readers see the pings of the calls of `append` that are done, whole, and so they do after any end of this process; it takes
    the machine's own end to lose more, as nothing waits for the disk. The store comes into being with its first pings. There
    must be one writer at a time.

    Parameters
    ----------
    path : str or path
        Ends in .zarr.
    int16 : bool
        Store samples as I and Q in int16 with a scale a ping, its largest part / 32767: half the size of complex64, each part
        to half a step. What `valid` leaves out becomes 0. False: as they are.
    overwrite : bool
        Replace a store that is there; False: it is an error.
    resume : bool
        Go on after the last whole ping of a store that is there, in its own kind of samples.

    Attributes
    ----------
    path : str
    n_ping : int
        Pings written, those before `resume` among them.

    Raises
    ------
    ValueError
        Another suffix, something else of that name, `resume` together with `overwrite` or with a store that is damaged or has
        arrays of a row a ping that the schema lacks.
    OSError, ImportError
        From the file system, of a store that is there where neither `overwrite` nor `resume` is given or is not there with
        `resume`; no zarr.

    Examples
    --------
    >>> with pysas.EchoWriter("line.zarr", int16=True) as writer:  # doctest: +SKIP
    ...     for echoes in sonar:
    ...         writer.append(echoes)
    """

    def __init__(
        self, path: str | os.PathLike[str], *, int16: bool = False, overwrite: bool = False, resume: bool = False
    ) -> None:
        self.path = files.name(path)
        if not io.is_store(self.path):
            raise ValueError(f"{self.path}: expected a name that ends in {stores.SUFFIX}")
        if resume and overwrite:
            raise ValueError("resume=True, overwrite=True: expected one of both")
        self.n_ping = 0
        self._folder = os.path.realpath(self.path)  # wherever the process goes
        self._int16, self._overwrite = int16, overwrite
        self._store: stores.Growing | None = None
        self._same: dict[str, Any] = {}  # what all pings have in common, and what each has of its own
        if not resume:
            stores.check_output(self.path, overwrite)
            return
        with io.opened(self.path) as file:
            navigation, known = io.read_navigation(file)
            self.n_ping = navigation.n_ping
            for name in file.fields.keys() - known:
                if file.fields[name][0][:1] == (self.n_ping,):
                    raise ValueError(f"{name}: found a row a ping, expected only fields of {io.ECHOES}, which grow")
            if "data" in file.pairs:
                raise ValueError("data: found real and imaginary part along an axis, expected complex samples or int16")
            file.rows("data", self.n_ping - 1, self.n_ping)  # the chunk that the next pings are put into
            self._int16 = isinstance(file, stores.Store) and file.counts
            self._store = stores.Growing(self._folder)
        self._same = self._common(*io.by_ping(io.echo_fields(navigation[:1])))

    def append(self, echoes: Echoes) -> None:
        """Pings that follow those before.

        Parameters
        ----------
        echoes : Echoes
            One or many pings. What the first have a ping (t0, c, boresight), and what not at all (velocity), holds for all.

        Raises
        ------
        ValueError
            Other sampling, arrays, pulses, beams or attrs than before; samples that int16 cannot hold. Nothing is written.
        OSError
            From the file system: a full disk. These pings do not count, and may be appended again.

        Notes
        -----
        O(samples), and the chunks that hold the last pings are written again: up to 128 pings of navigation, or 2 MiB of
        samples.
        """
        if not isinstance(echoes, Echoes):
            raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
        header, fixed, rows = io.by_ping(io.echo_fields(echoes))
        common = self._common(header, fixed, rows)
        self._require_same(common)
        if self._int16:
            axes = rows["data"][0]
            counts, scale = _counts(echoes, self.n_ping)
            rows |= {"scale": (axes[:1], scale), "data": ((*axes, "iq"), counts)}
        if self._store is None:
            with stores.replacing(self._folder, overwrite=self._overwrite) as folder:
                stores.create(folder, header, fixed, rows, complete=False)
            self._store, self._same = stores.Growing(self._folder), common
        else:
            with stores.writing(self.path):
                self._store.append(rows)
        self.n_ping += echoes.n_ping

    def _require_same(self, common: dict[str, Any]) -> None:
        for name in sorted(common.keys() | self._same.keys() if self._same else ()):
            now, before = (one.get(name, "none") for one in (common, self._same))
            if not np.array_equal(now, before):
                text = " ".join(f"{before!s:.60}".split())
                raise ValueError(
                    f"{name}: found {now!s:.60} after {text}: expected the same of all pings, or one a ping from the first"
                )

    def _common(self, header: dict[str, Any], fixed: io.Named, rows: io.Named) -> dict[str, Any]:
        own = {}
        for name, (_, array) in rows.items():
            dtype = "samples" if name == "data" and self._int16 else array.dtype.newbyteorder("=")
            own[name] = f"{dtype} (ping, {', '.join(map(str, array.shape[1:]))})"
        return header | {name: array for name, (_, array) in fixed.items()} | own

    def close(self) -> None:
        """Tell readers that the line is complete."""
        if self._store is not None:
            with stores.writing(self.path):
                self._store.finish()

    def __enter__(self) -> EchoWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()


def _counts(echoes: Echoes, before: int) -> tuple[Array, FloatArray]:
    """I and Q in steps of a scale a ping, which float32 holds: (ping, ..., sample, 2) int16 and (ping,)."""
    data = np.ascontiguousarray(echoes.whole().data, dtype=echoes.dtype)
    parts = data.view(data.real.dtype).reshape(*data.shape, 2)
    flat = parts.reshape(parts.shape[0], -1)
    top = np.maximum(flat.max(axis=1), -flat.min(axis=1)).astype(np.float64)
    with np.errstate(over="ignore"):
        near = (top / stores.MOST_COUNT).astype(np.float32)
        near = np.where(near.astype(np.float64) * stores.MOST_COUNT < top, np.nextafter(near, np.float32(np.inf)), near)
        good = np.isfinite(np.float32(stores.MOST_COUNT) * near)
    if not good.all():
        ping = int(np.argmin(good))
        raise ValueError(f"data: {top[ping]:g} in ping {before + ping}: expected finite samples that float32 holds, for int16")
    scale = np.where(top > 0, near, 1).astype(np.float64)
    counts = np.empty(parts.shape, dtype=np.int16)
    for ping, step in enumerate(scale):
        counts[ping] = np.rint(parts[ping] / step)  # in float64
    return counts, scale
