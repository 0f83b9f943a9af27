"""Worker threads: tasks by number, in order of a shared counter, that stop within one task on an error or Ctrl-C.

Threads live for one call, so a fork between calls inherits none; results never depend on how many there are, because
every task owns its output.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

_POLL = 0.1


def run(task: Callable[[int], None], count: int, threads: int, tick: Callable[[int], None] | None = None) -> None:
    """Call task(0) ... task(count - 1) on `threads` threads; `tick(done)` is called now and then from this thread.

    The first exception of a task, or KeyboardInterrupt here, ends the others after their current task and is raised.
    """
    if threads == 1 and tick is None and threading.current_thread() is threading.main_thread():
        for number in range(count):
            task(number)
        return
    lock, stop = threading.Lock(), threading.Event()
    state = {"next": 0, "done": 0}

    def work() -> None:
        while not stop.is_set():
            with lock:
                number = state["next"]
                state["next"] += 1
            if number >= count:
                return
            try:
                task(number)
            except BaseException:
                stop.set()
                raise
            with lock:
                state["done"] += 1

    with ThreadPoolExecutor(min(threads, max(count, 1)), thread_name_prefix="pysas") as pool:
        futures = [pool.submit(work) for _ in range(min(threads, count))]
        try:
            pending = set(futures)
            while pending:
                finished, pending = wait(pending, timeout=_POLL, return_when=FIRST_EXCEPTION)
                for future in finished:
                    future.result()
                if tick is not None:
                    tick(state["done"])
        except BaseException:
            stop.set()
            raise
