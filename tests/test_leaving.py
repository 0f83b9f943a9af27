"""Ctrl-C while kernels compile, and the interpreter's end while daemon threads image. Each in a process of its own."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from numba import njit

from pysas import _pool
from pysas._pool import leaving

SETUP = """
    import sys, threading, time, numpy as np, pysas, pysas._pool.leaving
    tx = np.zeros((300, 3)); tx[:, 0] = np.arange(300) * 0.02
    data = np.ones((300, 1, 1500), np.complex64)
    echoes = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=tx[:, None], t0=0.03, bandwidth=30e3)
    grid = pysas.Grid.plane(np.arange(1000) * 0.02, 30 + np.arange(600) * 0.01)
    tiny = pysas.Grid.plane(np.arange(10) * 0.02, 30 + np.arange(5) * 0.02)
"""
BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]


def python(code):
    return [sys.executable, "-u", "-c", textwrap.dedent(SETUP) + textwrap.dedent(code)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_leaving_while_daemon_threads_image_is_quiet(backend):
    """Several at a time, and again as soon as one ends, whatever it ends by."""
    code = f"""
        calls = [
            lambda: pysas.backproject(echoes, grid, backend={backend!r}, threads=2),
            lambda: pysas.backproject(echoes, grid, backend={backend!r}, threads=1),
            lambda: pysas.backproject(echoes, grid, backend={backend!r}, progress=lambda share: None),
            lambda: pysas.ffbp(echoes, grid, backend={backend!r}),
            lambda: pysas.plan(echoes, grid, method="ffbp", backend={backend!r}),
        ]
        pysas.backproject(echoes, tiny, backend={backend!r})
        def work(call):
            while True:
                try:
                    call()
                except Exception:
                    print("failed")
        for call in calls:
            threading.Thread(target=work, args=(call,), daemon=True).start()
        time.sleep(0.5)
        print("leaving")
    """
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "leaving\n", "")


@pytest.mark.cpp
def test_leaving_while_daemon_threads_compute_arcs_is_quiet():
    """Every pixel's own, of an image in line with the track: nearly all of the time is theirs."""
    code = """
        ahead = pysas.Grid.plane(37 + np.arange(300) * 0.02, np.arange(-150, 150) * 0.02)
        views = pysas.plan(echoes, ahead, method="backprojection", backend="cpp", weights="uniform-angle", threads=1)
        assert views.scene.each
        def work():
            while True:
                views(data)
        threading.Thread(target=work, daemon=True).start()
        time.sleep(0.5)
        print("leaving")
    """
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "leaving\n", "")


def test_what_is_called_at_exit_may_still_image():
    code = """
        import atexit
        atexit.register(lambda: print(pysas.backproject(echoes, tiny, threads=2).report.terms > 0))
        pysas._pool.leaving.atexit.unregister(pysas._pool.leaving._leave)
        atexit.register(pysas._pool.leaving._leave)  # last registered, first called
    """
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "True\n", "")


COMPILED = {
    "backproject": "pysas.backproject(echoes, tiny, 1e-3, backend='numba', threads=2)",
    "one thread": "pysas.backproject(echoes, tiny, 1e-3, backend='numba', threads=1)",
    "simulate": "pysas.simulate([[0, 30, 0]], [1], pysas.LFM(1e5, 3e4, 1e-3), tx=tx, rx=tx, fs=40e3, duration=0.06)",
}


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
@pytest.mark.parametrize("call", COMPILED)
def test_ctrl_c_does_not_wait_for_a_compiler(call, tmp_path):
    code = f"""
        import os, signal
        from numba.core import event
        signal.signal(signal.SIGINT, signal.default_int_handler)
        class Begun(event.Listener):
            def on_start(self, _):
                os.write(1, b"compiling\\n")  # whole: the signal may fall between a text and its end of line
            def on_end(self, _):
                pass
        event.register("numba:compile", Begun())
        try:
            {COMPILED[call]}
        except KeyboardInterrupt:
            print("stopped", flush=True)
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    process = subprocess.Popen(python(code), stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout.readline() == "compiling\n"
        time.sleep(0.3)
        sent = time.monotonic()
        process.send_signal(signal.SIGINT)
        while (line := process.stdout.readline()) == "compiling\n":
            pass
        assert line == "stopped\n"
        assert time.monotonic() - sent < 0.5
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_run_that_is_given_up_while_it_compiles_writes_nothing_more(monkeypatch):
    """Of two tasks, one compiles when the other fails: the run ends at once, the compiler later, and its task never."""

    @njit(nogil=True)
    def kernel(x):
        x[0] = 1

    began, go, done = threading.Event(), threading.Event(), threading.Event()
    compile_ = kernel.compile

    def slowly(types):
        began.set()
        go.wait(30)
        compile_(types)
        done.set()

    monkeypatch.setattr(kernel, "compile", slowly)
    out = np.zeros(1)

    def task(number):
        if number == 0:
            _pool.call(kernel, out)
        began.wait(30)
        raise ValueError("the other task")

    with pytest.raises(ValueError, match="the other task"):
        _pool.run(task, 2, 2)
    assert not done.is_set() and _pool._out.compiling
    go.set()
    assert done.wait(30)
    _pool._out.settle()
    assert out[0] == 0 and not _pool._out.compiling
    _pool.run(lambda _: _pool.call(kernel, out), 1, 2)
    assert out[0] == 1


def test_a_kernel_that_does_not_compile_raises_what_the_compiler_says():
    @njit
    def kernel(x):
        return x.nothing

    for run in (lambda: _pool.call(kernel, 1.0), lambda: _pool.run(lambda _: _pool.call(kernel, 1.0), 3, 2)):
        with pytest.raises(Exception, match="nothing"):
            run()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_fork_waits_for_what_compiles(tmp_path):
    code = """
        from numba import njit
        from numba.core.compiler_lock import global_compiler_lock
        class Slow:
            done = False
            def compile(self, types):
                with global_compiler_lock:  # as any kernel's does
                    time.sleep(0.5)
                self.done = True
        slow = Slow()
        @njit
        def quick(x):
            return x + 1
        threading.Thread(target=lambda: pysas._pool._compile_aside(slow, ())).start()
        while not pysas._pool._out.compiling:
            time.sleep(0.001)
        import os
        child = os.fork()
        if child == 0:
            print("child", pysas._pool.call(quick, 1), flush=True)
            sys.exit(0)
        print("parent", os.waitpid(child, 0)[1], slow.done)
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=100, env=environment, check=False)
    assert (result.returncode, result.stdout) == (0, "child 2\nparent 0 True\n"), result.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forks_child_has_a_lock_of_its_own():
    """Whoever held the parent's is not there; threads that were out are still counted, as lost."""
    code = """
        import os
        out = pysas._pool._out
        done = threading.Event()
        done.set()
        with out.lock:
            out.number, out.compiling = 3, {done}
            child = os.fork()
            if child == 0:
                print(out.lock.acquire(timeout=1), out.number, len(out.compiling), flush=True)
                os._exit(0)
            out.number, out.compiling = 0, set()
        sys.exit(os.waitpid(child, 0)[1])
    """
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout) == (0, "True 3 0\n"), result.stderr


def test_threads_that_are_away_are_waited_for(monkeypatch):
    calls = []
    part = leaving.Part(lambda: calls.append("stop"), lambda: calls.count("away") < 3 and not calls.append("away"))
    part.keep = lambda: calls.append("keep")
    monkeypatch.setattr(leaving, "_parts", [part])
    leaving._leave()
    assert calls[0] == "stop" and calls[-1] == "keep" and calls.count("away") == 3
    part.away = lambda: 1
    leaving._forked()  # the parent's threads are not the child's
    assert not part.out()
