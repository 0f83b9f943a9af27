"""Sections on the workers of a Dask cluster: a process at a time makes one, on all of its threads."""

from __future__ import annotations

import asyncio
import concurrent.futures
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pysas import __version__, _checks
from pysas.survey.sections import Made, image_section

_WAIT = 1.0  # s between looks at who is there
_NOBODY = 60.0  # s without a worker, or without the scheduler
_CANCELLED = asyncio.CancelledError, concurrent.futures.CancelledError


@dataclass(frozen=True)
class Lost:
    """A section whose worker died, again and again."""

    reason: str


def _task(path: str, number: int, section: int, threads: int | None, version: str) -> list[Made]:
    """On a worker."""
    from distributed import get_worker

    if version != __version__:
        raise ValueError(f"a worker has pysas {__version__}, the client {version}: expected one of all")
    return image_section(path, number, section, threads or get_worker().state.nthreads)


def by_client(
    client: Any, path: str, jobs: Sequence[tuple[int, int]], threads: int | None, memory: int
) -> Iterator[tuple[tuple[int, int], list[Made] | Lost]]:
    """Sections, as they are done. There are as many tasks at a time as processes; only names and numbers travel."""
    try:
        import distributed
    except ImportError:
        raise _checks.optional("distributed", "survey") from None
    if not isinstance(client, distributed.Client):
        raise TypeError(f"client={type(client).__name__}: expected a distributed.Client")
    if client.asynchronous:
        raise TypeError("client: asynchronous: expected one that waits, distributed.Client(address)")
    left = list(reversed(jobs))
    flying: dict[Any, tuple[int, int]] = {}
    workers: dict[str, Any] = {}
    asked, seen = -math.inf, time.monotonic()
    try:
        while left or flying:
            now = time.monotonic()
            if now - asked > _WAIT:  # of a thousand workers the answer is a megabyte
                workers, asked = _workers(client), now
                _require_memory(workers, memory)
            seen = now if workers else seen
            if now - seen > _NOBODY:
                raise ConnectionError(f"{_address(client)}: no worker, or no scheduler, for {_NOBODY:g} s")
            while left and len(flying) < len(workers):
                job = left.pop()
                flying[client.submit(_task, path, *job, threads, __version__, pure=False)] = job
            for future in [future for future in flying if future.done()] or _first(distributed, flying):
                yield flying.pop(future), _result(distributed, future)
    finally:
        for future in flying:
            try:
                future.cancel()
            except Exception:  # noqa: S110  the cluster is gone, which has been told
                pass


def _first(distributed: Any, flying: dict[Any, Any]) -> list[Any]:
    """Those that are done within a while."""
    if not flying:
        time.sleep(_WAIT)
        return []
    try:
        return list(distributed.wait(list(flying), timeout=_WAIT, return_when="FIRST_COMPLETED").done)
    except TimeoutError:
        return []
    except _CANCELLED:
        return [future for future in flying if future.status == "cancelled"]


def _result(distributed: Any, future: Any) -> list[Made] | Lost:
    gone = ConnectionError("the scheduler is gone, or has forgotten its tasks")
    if future.status in ("cancelled", "lost"):
        raise gone
    try:
        return list(future.result())
    except distributed.KilledWorker as error:
        return Lost(f"its worker died {error.allowed_failures + 1} times")
    except (*_CANCELLED, distributed.comm.CommClosedError):  # it died after the task, before its result was here
        raise gone from None


def _workers(client: Any) -> dict[str, Any]:
    """What the scheduler says of each process; nothing where it is not there."""
    if client.status == "closed":
        raise ConnectionError(f"{_address(client)}: the scheduler is gone")
    try:
        return dict(client.scheduler_info(n_workers=-1)["workers"])
    except (OSError, TimeoutError):
        return {}


def _address(client: Any) -> str:
    return str(getattr(client.scheduler, "address", "the scheduler"))


def _require_memory(workers: dict[str, Any], memory: int) -> None:
    for address, worker in workers.items():
        if 0 < (limit := worker["memory_limit"] or 0) < memory:
            raise ValueError(
                f"{address}: has a memory limit of {limit / 1e6:.0f} MB, a section needs {memory / 1e6:.0f} MB: expected more, "
                "or a smaller tile or swath"
            )
