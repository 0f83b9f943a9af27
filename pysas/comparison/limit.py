"""A limit to how long a call may run, in the main thread of any platform."""

from __future__ import annotations

import _thread
import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


class TooLongError(BaseException):
    """A run passed its limit; no Exception, so that nothing on its way takes it for an error of its own."""


@contextlib.contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Stop what runs longer, in the main thread, as Ctrl-C would: every loop that Ctrl-C can stop polls for signals.

    A timer's thread trips SIGINT for the main thread, which works on every platform; while it is armed, a handler tells its
    interrupt from the user's.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:  # None: not Python's, cannot be put back
        yield
        return
    lock, late, over = threading.Lock(), False, False

    def stop() -> None:
        nonlocal late
        with lock:
            if not over:
                late = True
                _thread.interrupt_main()

    def interrupted(number: int, frame: Any) -> None:
        nonlocal late
        if late:
            late = False
            if not over:
                raise TooLongError(f"longer than {seconds:g} s")
        elif callable(before):
            before(number, frame)
        elif before == signal.SIG_DFL:
            raise KeyboardInterrupt

    timer = threading.Timer(seconds, stop)
    timer.daemon = True
    signal.signal(signal.SIGINT, interrupted)
    try:
        timer.start()
        try:
            yield
        finally:
            over = True
    finally:
        with lock:
            over = True
        timer.cancel()
        # an interrupt that came too late is dealt with by `interrupted`: signal.signal looks for tripped signals first
        signal.signal(signal.SIGINT, before)
