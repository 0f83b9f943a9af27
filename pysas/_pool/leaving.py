"""The interpreter's end: what still runs in other threads is asked to stop, and waited for, before the interpreter is gone.

A daemon thread that comes back from compiled code to an interpreter that has ended is torn down where it stands, and C++ then
ends the process by an abort.
"""

from __future__ import annotations

import atexit
import os
import time
from collections.abc import Callable
from dataclasses import dataclass

_STOP, _KEEP = 10.0, 1.0  # s at most: for threads to stop (a compiler cannot), and for those on their way back


@dataclass
class Part:
    """Code that leaves the interpreter: asked to `stop`, it has `away` threads still out, and may `keep` those out for good."""

    stop: Callable[[], None]
    away: Callable[[], int]
    keep: Callable[[], None] | None = None
    lost: int = 0  # in the parent of a fork

    def out(self) -> bool:
        return self.away() > self.lost


_parts: list[Part] = []


def join(part: Part) -> None:
    """Ask and wait for a part at the end."""
    _parts.append(part)


def _wait(seconds: float) -> None:
    end = time.monotonic() + seconds
    while any(part.out() for part in _parts) and time.monotonic() < end:
        time.sleep(0.005)


def _leave() -> None:
    for part in _parts:
        part.stop()
    try:
        _wait(_STOP)
    finally:  # Ctrl-C: at once
        for part in _parts:
            if part.keep is not None:
                part.keep()
    _wait(_KEEP)


def _forked() -> None:
    for part in _parts:
        part.lost = part.away()


atexit.register(_leave)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
