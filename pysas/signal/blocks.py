"""Traces a block at a time: which, at what scale, and what becomes of a mapped file's pages afterwards.

A block is as many whole pings as the stated memory holds, or part of one ping's channels. What a block gives depends on its own
traces alone, so that results are the same for blocks of any size.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

BYTES = 32 * 2**20  # of work
_SHARED = ("r", "r+", "w+")  # modes of np.memmap whose pages are the file's own, not copies


def batches(pings: int, channels: int, rows: int) -> Iterator[tuple[slice, slice]]:
    """Blocks of whole pings, or parts of one ping where its channels alone exceed `rows`."""
    step_ping, step_channel = max(1, rows // channels), min(rows, channels)
    for ping in range(0, pings, step_ping):
        for channel in range(0, channels, step_channel):
            yield slice(ping, min(ping + step_ping, pings)), slice(channel, min(channel + step_channel, channels))


def exponents(peaks: npt.NDArray[Any], kind: np.dtype[Any]) -> npt.NDArray[np.intc]:
    """Powers of two that bring traces of these peaks near 1: amplitudes near the ends of `kind` neither overflow nor sink."""
    limit = np.finfo(kind).maxexp - 2  # 2^limit and 2^-limit are both normal numbers
    return np.asarray(np.clip(np.frexp(peaks)[1], -limit, limit), dtype=np.intc)


def powers(kind: np.dtype[Any], exponent: npt.NDArray[np.intc]) -> npt.NDArray[Any]:
    """2^exponent in `kind`."""
    return np.asarray(np.ldexp(kind.type(1), exponent))


def let_go(*arrays: npt.NDArray[Any]) -> None:
    """Take a mapped file's pages off this process's account.

    They stay in the system's cache, written ones too, but would count as memory in use until the system is short of it: a
    recording larger than memory looks then as if it were held whole. Maps whose changes are private copies stay as they are.
    """
    if not hasattr(mmap, "MADV_DONTNEED"):
        return
    for array in arrays:
        owner: Any = array
        while isinstance(owner, np.ndarray) and not isinstance(owner, np.memmap):
            owner = owner.base
        pages = getattr(owner, "_mmap", None)
        if isinstance(pages, mmap.mmap) and owner.mode in _SHARED:
            pages.madvise(mmap.MADV_DONTNEED)
