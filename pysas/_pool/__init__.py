"""Worker threads: tasks by number, in order of a shared counter, that stop within one task on an error or Ctrl-C.

Threads live for one call, so a fork between calls inherits none; results never depend on how many there are, because
every task owns its output. `call` compiles a kernel where Ctrl-C need not wait for it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

from pysas._pool import leaving

_POLL = 0.1
_local = threading.local()  # run: the Run that this thread works for


class _Stopped(BaseException):
    """A worker whose run was given up while it compiled."""


class _Run:
    """What the threads of one call share."""

    def __init__(self, task: Callable[[int], None], count: int) -> None:
        self.task, self.count = task, count
        self.lock, self.stop, self.idle = threading.Lock(), threading.Event(), threading.Event()
        self.next = self.done = self.compiling = 0
        self.busy = 1  # threads at work, and the one that starts them
        self.failure: BaseException | None = None
        self.seen: set[Any] = set()  # kernels called, hence compiled
        self.main = threading.current_thread() is threading.main_thread()

    def start(self, threads: int) -> None:
        """Start workers, or as many as there are threads to be had; this thread works where there are none."""
        for started in range(threads):
            with self.lock:
                self.busy += 1
            try:
                threading.Thread(target=self.work, name="pysas", daemon=True).start()
            except RuntimeError:
                if started:
                    self.leave()
                else:
                    self.work()
                return

    def leave(self) -> None:
        with self.lock:
            self.busy -= 1
            if self.busy == 0:
                self.idle.set()

    def over(self) -> bool:
        return self.stop.is_set() or (_out.stopping and not self.main)

    def working(self) -> bool:
        """Whether tasks go on; those that a compiler holds up do not, once they are told to stop."""
        with self.lock:
            return self.busy > self.compiling

    def work(self) -> None:
        _local.run = self
        with _out:
            try:
                while not self.over():
                    with self.lock:
                        number = self.next
                        self.next += 1
                    if number >= self.count:
                        break
                    self.task(number)
                    with self.lock:
                        self.done += 1
            except _Stopped:
                pass
            except BaseException as error:
                with self.lock:
                    self.failure = self.failure or error
                self.stop.set()
            finally:
                _local.run = None
                self.leave()

    def drive(self, threads: int, tick: Callable[[int], None] | None) -> None:
        """From this thread: start the others, wait for them, stop them."""
        try:
            try:
                self.start(threads)
            finally:
                self.leave()
            while not self.idle.wait(_POLL) and (self.working() or not self.stop.is_set()):
                if _out.stopping and not self.main:
                    raise SystemExit
                if tick is not None:
                    tick(self.done)
        except BaseException:
            self.stop.set()
            while self.working():  # tasks write to what the caller is given back
                try:
                    self.idle.wait(0.01)
                except KeyboardInterrupt:
                    continue
            raise
        if self.failure is not None:
            raise self.failure
        if _out.stopping and not self.main:
            raise SystemExit
        if tick is not None:
            tick(self.done)


class _Out:
    """Threads that run or compile kernels."""

    def __init__(self) -> None:
        self.lock, self.number, self.stopping = threading.Lock(), 0, False
        self.compiling: set[threading.Event] = set()  # each set when it has ended

    def __enter__(self) -> None:
        with self.lock:
            self.number += 1

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.number -= 1

    def ask(self) -> None:
        self.stopping = True

    def settle(self) -> None:
        """Before a fork: a compiler's lock would stay locked in the child."""
        for done in list(self.compiling):
            done.wait()

    def forked(self) -> None:
        """In a fork's child: threads that held the lock or compiled are the parent's; `leaving` counts them as lost."""
        self.lock = threading.Lock()
        self.compiling.clear()


_out = _Out()
leaving.join(leaving.Part(_out.ask, lambda: _out.number))
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_out.settle, after_in_child=_out.forked)


def run(task: Callable[[int], None], count: int, threads: int, tick: Callable[[int], None] | None = None) -> None:
    """Call task(0) ... task(count - 1) on `threads` threads; `tick(done)` is called now and then from this thread.

    The first exception of a task, or KeyboardInterrupt here, ends the others after their current task and is raised.
    """
    this = _Run(task, count)
    if threads == 1 and tick is None and this.main:
        outer, _local.run = getattr(_local, "run", None), this
        try:
            for number in range(count):
                task(number)
        finally:
            _local.run = outer
        return
    if count:
        this.drive(min(threads, count), tick)


def call(kernel: Any, *args: Any) -> Any:
    """kernel(*args), where a kernel is a Numba function: compiled first, where it has to be, by a thread that Ctrl-C leaves
    behind."""
    this: _Run | None = getattr(_local, "run", None)
    if this is None or kernel not in this.seen:
        types = tuple(kernel.typeof_pyval(a) for a in args)
        if types not in kernel.overloads:
            if threading.current_thread() is threading.main_thread():
                _compile_aside(kernel, types)
            elif this is None:
                kernel.compile(types)
            else:
                _compile_in(this, kernel, types)
        if this is not None:
            this.seen.add(kernel)
    return kernel(*args)


def _compile_in(this: _Run, kernel: Any, types: tuple[Any, ...]) -> None:
    """Compile in a worker: a run that is given up meanwhile does not wait for it, and none of its tasks goes on."""
    with this.lock:
        this.compiling += 1
    try:
        _compile(kernel, types, threading.Event())
    finally:
        with this.lock:  # whoever gives up sets `stop` and then looks who works
            this.compiling -= 1
            given_up = this.stop.is_set()
    if given_up:
        raise _Stopped


def _compile(kernel: Any, types: tuple[Any, ...], done: threading.Event) -> None:
    """Compile where a fork waits for it."""
    _out.compiling.add(done)
    try:
        kernel.compile(types)
    finally:
        _out.compiling.discard(done)
        done.set()


def _compile_aside(kernel: Any, types: tuple[Any, ...]) -> None:
    failure: list[BaseException] = []
    done = threading.Event()

    def work() -> None:
        with _out:
            try:
                _compile(kernel, types, threading.Event())
            except BaseException as error:
                failure.append(error)
            finally:
                done.set()

    try:
        threading.Thread(target=work, name="pysas-compile", daemon=True).start()
    except RuntimeError:  # no threads to be had
        kernel.compile(types)
        return
    while not done.wait(_POLL):
        pass
    if failure:
        raise failure[0]
