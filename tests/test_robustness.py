"""What a host process must survive: Ctrl-C, fork, too little memory. Each in a process of its own with a time limit."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

SETUP = """
    import time, numpy as np, pysas
    tx = np.zeros((300, 3)); tx[:, 0] = np.arange(300) * 0.02
    rng = np.random.default_rng(0)
    data = rng.standard_normal((300, 1, 1500, 2)).view(complex)[..., 0].astype(np.complex64)
    echoes = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=tx[:, None], t0=0.03, bandwidth=30e3)
    small = pysas.Grid.plane(np.arange(100) * 0.02, 30 + np.arange(50) * 0.02)
    expected = pysas.backproject(echoes, small, threads=2).data
    def again():
        assert np.array_equal(pysas.backproject(echoes, small, threads=2).data, expected)
"""


def python(code):
    return [sys.executable, "-u", "-c", textwrap.dedent(SETUP) + textwrap.dedent(code)]


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("tol", [1e-3, 1e-4])
def test_ctrl_c_returns_control_within_half_a_second(threads, tol):
    code = f"""
        import signal
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
        large = pysas.Grid.plane(np.arange(6000) * 0.01, 25 + np.arange(6000) * 0.002)
        class Enough(Exception):
            pass
        def enough(share):
            if share > 0:
                raise Enough
        try:  # what is compiled for this plan is before the clock runs
            pysas.backproject(echoes, large, {tol}, threads={threads}, progress=enough)
        except Enough:
            pass
        print("ready")
        try:
            pysas.backproject(echoes, large, {tol}, threads={threads})
        except KeyboardInterrupt:
            print("stopped", flush=True)
        again()
        print("usable")
    """
    process = subprocess.Popen(python(code), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "ready\n"
        time.sleep(1.0)
        sent = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "stopped\n"
        assert time.monotonic() - sent < 0.5
        assert process.stdout.readline() == "usable\n"
        assert process.wait(60) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.skipif(os.name != "posix", reason="needs fork")
@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
def test_children_image_after_their_parent(method, tmp_path):
    script = tmp_path / "children.py"
    script.write_text(
        textwrap.dedent(SETUP)
        + textwrap.dedent(f"""
            import multiprocessing
            def child(queue):
                again()
                queue.put("ok")
            if __name__ == "__main__":
                context = multiprocessing.get_context({method!r})
                queue = context.Queue()
                process = context.Process(target=child, args=(queue,))
                process.start()
                print(queue.get(timeout=60))
                process.join(15)
                print(process.exitcode)
        """)
    )
    result = subprocess.run([sys.executable, "-W", "ignore", script], capture_output=True, text=True, timeout=150, check=False)
    assert result.stdout == "ok\n0\n", result.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs RLIMIT_AS")
def test_too_little_memory_is_a_memory_error_and_the_process_lives():
    code = """
        import resource
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + 400 * 2**20, -1))
        large = pysas.Grid.plane(np.arange(12000) * 0.002, 25 + np.arange(12000) * 0.002)
        try:
            pysas.backproject(echoes, large)
        except MemoryError:
            print("MemoryError")
        again()
        print("usable")
    """
    result = subprocess.run(python(code), capture_output=True, text=True, timeout=150, check=False)
    assert result.stdout == "MemoryError\nusable\n", result.stderr
