"""The engine's parts: coefficients against the band-limited sum, delays in long double, backends, the worker pool."""

import threading

import numpy as np
import pytest

import pysas
from pysas import _checks, _pool
from pysas.engine import MONOSTATIC, MOVING, STOP_AND_HOP, _numba, backend_name, native, preparation, summation
from pysas.engine.traces import BEAM, BLOCK, MODEL, NO_BEAM, TILE_ROWS, TRACE, place, reals, record


@pytest.mark.parametrize(("degree", "rate", "limit"), [(1, 8, 2e-2), (3, 2, 2e-3), (5, 1, 3e-4), (7, 2, 1e-7)])
def test_coefficients_read_the_band_limited_trace(degree, rate, limit):
    """sum_k X_k W_k exp(2j pi f_k t) directly, at random instants; bound theta^(d+1)/(2^d (d+1)!) at 0.375 fs."""
    rng = np.random.default_rng(0)
    n, n_fft = 120, 400
    reader = preparation.interpolator(n, n_fft, n_fft * rate, degree, 0, 0.0, np.complex128)
    f = np.fft.fftfreq(n_fft)
    spectrum = (rng.standard_normal((3, n_fft)) + 1j * rng.standard_normal((3, n_fft))) * (np.abs(f) < 0.375)
    traces = np.fft.ifft(spectrum)[:, :n]
    out = np.empty((3, reader.intervals, degree + 1), dtype=np.complex128)
    preparation.coefficients(traces, reader, out)
    t = rng.uniform(0, n - 1, 500)
    u = t * reader.rate
    interval = np.floor(u).astype(int)
    powers = (u - interval - 0.5)[:, None] ** np.arange(degree + 1)
    read = np.sum(out[:, interval] * powers, axis=-1)
    edge = np.clip((np.abs(f) - 1 / 2.2) / (0.5 - 1 / 2.2), 0, 1)
    low_passed = np.fft.fft(traces, n_fft) * np.cos(np.pi / 2 * edge) ** 2
    exact = low_passed @ np.exp(2j * np.pi * f[:, None] * t) / n_fft
    assert np.linalg.norm(read - exact) < limit * np.linalg.norm(exact)


def test_the_taper_leaves_what_pixels_need_alone():
    reader = preparation.interpolator(300, 320, 640, 3, 60, 14.0, np.complex64)
    assert reader.window is not None and reader.window.dtype == np.float32
    assert np.all(reader.window[60:-60] == 1) and reader.window[0] < 1e-4 and np.all(np.diff(reader.window[:61]) >= 0)


@pytest.mark.parametrize("kind", [MONOSTATIC, STOP_AND_HOP, MOVING])
def test_delays_satisfy_their_equation(kind):
    """c tau = |x - tx| + |x - rx - v tau| in long double, to 1e-16 of tau."""
    rng = np.random.default_rng(1)
    g = np.zeros((), TRACE)
    g["tx"], g["rx"] = rng.uniform(-5, 5, (2, 3))
    g["c"] = 1500.0
    if kind == MONOSTATIC:
        g["rx"] = g["tx"]
    if kind == MOVING:
        g["velocity"] = rng.uniform(-20, 20, 3)
    x = rng.uniform(-50, 50, (3, 200))
    tau = np.empty(200)
    _numba._delays(kind, reals(g), x[0], x[1], x[2], 200, tau)
    wide, tau = x.T.astype(np.longdouble), tau.astype(np.longdouble)
    back = np.sqrt(np.sum((wide - g["rx"] - g["velocity"] * tau[:, None]) ** 2, axis=1))
    there = np.sqrt(np.sum((wide - g["tx"]) ** 2, axis=1))
    assert np.max(np.abs((there + back) / 1500 - tau) / tau) < 1e-15


def test_backend_choice(monkeypatch):
    monkeypatch.delenv("PYSAS_BACKEND", raising=False)
    built = native.extension() is not None
    assert backend_name() == ("cpp" if built else "numba") and backend_name("numba") == "numba"
    monkeypatch.setenv("PYSAS_BACKEND", "numba")
    assert backend_name("auto") == "numba"
    monkeypatch.setenv("PYSAS_BACKEND", "fast")
    with pytest.raises(ValueError, match="PYSAS_BACKEND='fast'"):
        backend_name()
    monkeypatch.setattr(native, "extension", lambda: None)
    with pytest.raises(ValueError, match="backend='cpp'"):
        backend_name("cpp")


def test_thread_setting(monkeypatch):

    monkeypatch.setenv("PYSAS_NUM_THREADS", "3")
    assert _checks.threads(None) == 3 and _checks.threads(2) == 2
    for text in ("0", "many", "-1"):
        monkeypatch.setenv("PYSAS_NUM_THREADS", text)
        with pytest.raises(ValueError, match="PYSAS_NUM_THREADS"):
            _checks.threads(None)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_the_pool_does_every_task_once(threads):
    done, ticks, lock = [], [], threading.Lock()

    def task(i):
        with lock:
            done.append(i)

    _pool.run(task, 57, threads, ticks.append)
    assert sorted(done) == list(range(57)) and ticks[-1] == 57


@pytest.mark.parametrize("threads", [1, 3])
def test_the_pool_raises_one_exception_and_stops(threads):
    done = []

    def task(i):
        if i == 5:
            raise RuntimeError("task 5")
        done.append(i)

    with pytest.raises(RuntimeError, match="task 5"):
        _pool.run(task, 10_000, threads)
    assert len(done) < 5_000


def test_an_exception_in_a_worker_is_one_python_exception(monkeypatch):
    from scenes import PLANE, straight

    def broken(*_):
        raise ArithmeticError("injected")

    monkeypatch.setattr("pysas.engine.summation.coefficients", broken)
    with pytest.raises(ArithmeticError, match="injected"):
        pysas.backproject(straight(), PLANE, threads=2, backend="numba")


@pytest.mark.cpp
@pytest.mark.parametrize("threads", [1, 3])
def test_an_exception_in_the_callback_ends_the_sum(threads):
    """Raised in the calling thread between tiles, carried through the C++ scheduler, other threads joined."""
    from scenes import straight

    def stop(share):
        raise ArithmeticError(f"at {share:.2f}")

    axis = np.arange(1500) * 0.01
    with pytest.raises(ArithmeticError, match="at 0"):
        pysas.backproject(straight(), pysas.Grid.plane(axis, 19 + axis / 10), threads=threads, backend="cpp", progress=stop)


@pytest.mark.cpp
def test_isa_is_forced_and_unknown_ones_are_named(monkeypatch):
    from scenes import PLANE, straight

    for name in native.core().levels():
        monkeypatch.setenv("PYSAS_ISA", name)
        assert pysas.backproject(straight(8), PLANE, backend="cpp").report.isa == name
    monkeypatch.setenv("PYSAS_ISA", "mmx")
    with pytest.raises(ValueError, match="PYSAS_ISA='mmx'"):
        pysas.backproject(straight(8), PLANE, backend="cpp")
    with pytest.raises(ValueError, match="isa='mmx'"):
        native.core().isa("mmx")


@pytest.mark.cpp
@pytest.mark.parametrize(("band", "degree", "phases", "step"), [(0.375, 3, 2, 1), (0.2, 2, 3, 2), (0.4545, 5, 2, 1)])
def test_a_filter_s_error_is_what_it_does_to_components(band, degree, phases, step):
    """Each in-band component, read by hand with the weights, is wrong by at most the stated error, and nearly that much."""
    error = 1e-4 if degree > 3 else 1e-2
    filter = native.core().design(band, degree, phases, step, error, 8, 400)
    n = np.arange(-400, 800)
    worst = 0.0
    for f in np.linspace(-band, band, 41):
        x = np.exp(2j * np.pi * f * n)
        for k in range(20):
            m, phase = divmod(k, phases)
            begin = 400 + step * m + filter.first[phase]
            q = filter.weight[phase].T @ x[begin : begin + filter.taps]
            t = np.linspace(-0.5, 0.5, 23)
            exact = np.exp(2j * np.pi * f * (k + 0.5 + t) * step / phases)
            worst = max(worst, float(np.max(np.abs(np.polynomial.polynomial.polyval(t, q) - exact))))
    assert filter.error <= error
    assert 0.8 * filter.error < worst < 1.02 * filter.error


def test_reals_of_records_lie_where_their_fields_do():
    """Numba's kernels read fields by their places among the reals, C++ by those of its structs of 21 and 10 doubles."""
    assert TRACE.itemsize == 21 * 8 and MODEL.itemsize == 10 * 8
    for kind in (TRACE, MODEL):
        some = np.zeros(3, kind)
        for number, name in enumerate(kind.names):
            some[name][1] = number + 1  # all reals of a record within
            row, count = reals(some)[1, place(kind, name) :], kind[name].itemsize // 8
            assert np.all(row[:count] == number + 1) and not np.any(row[count:])
        assert np.shares_memory(reals(some), some) and reals(some[0:1].reshape(())).shape == (kind.itemsize // 8,)
    with pytest.raises(TypeError, match="expected"):
        record(MODEL, c=1500.0)


@pytest.mark.cpp
def test_the_extension_takes_its_own_records_alone():
    """numpy calls a dtype the same only where names, types and places of the fields are."""
    points, order, out = np.zeros((1, 3)), np.arange(2), np.empty((1, 2))

    beam = record(BEAM, shape=NO_BEAM, half_angle=np.pi, full_angle=np.pi)

    def arcs(trace):
        native.core().arcs(trace, 1, beam, points, order, out, 1, None)

    own = np.zeros(2, TRACE)
    own["tx"] = own["rx"] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    arcs(own)
    np.testing.assert_allclose(out, 1.0)
    fields = [(name, TRACE[name]) for name in TRACE.names]
    renamed = [("receiver" if name == "rx" else name, kind) for name, kind in fields]
    single = [(name, np.dtype((np.float32, kind.shape))) for name, kind in fields]
    for other in (renamed, fields[::-1], single, [*fields, ("more", np.float64)]):
        with pytest.raises(TypeError, match="trace: expected contiguous records of .*velocity.*, found .*velocity"):
            arcs(np.zeros(2, np.dtype(other)))
    with pytest.raises(TypeError, match="trace: expected contiguous records of .*, found float64"):
        arcs(reals(own))
    with pytest.raises(TypeError, match="trace: expected contiguous records"):
        arcs(np.zeros(4, TRACE)[::2])


@pytest.mark.cpp
def test_what_kernels_share_is_what_python_takes():
    assert native.core().sizes() == {"block": BLOCK, "rows": TILE_ROWS}


def test_numba_reads_only_its_own_traces(monkeypatch):
    """A line's last block ends where the line does: coarse pixels beyond it would need samples that were not prepared."""
    axis = np.arange(65) * 0.3  # one pixel more than a block
    tx = np.zeros((4, 3)) + [0.0, -30.0, 5.0]
    echoes = pysas.Echoes(
        np.ones((4, 4000), np.complex64), fs=40e3, fc=1e5, tx=tx, rx=tx, c=1500.0, t0=2 * 20 / 1500, bandwidth=30e3
    )  # fmt: skip
    seen = []
    kernel = summation._numba.sum_tile

    def watched(coords, blocks, straight, active, geometry, model, kind, table, x, *rest):
        *_, pairs, _, _, out = rest
        assert out.shape[1] == x.size
        pixels = blocks[:, None, :3] + np.arange(x.size)[:, None] * blocks[:, None, 3:]
        first, shared = geometry[0].view(TRACE)[0], model.view(MODEL)[0]
        delay = 2 / 1500 * np.linalg.norm(pixels - first["tx"], axis=-1)
        interval = ((delay - first["t0"]) * shared["fs"] - first["kept"]) * shared["rate"]
        seen.append((interval.max(), table.size / len(geometry) / (4 * len(pairs))))
        return kernel(coords, blocks, straight, active, geometry, model, kind, table, x, *rest)

    for name in ("overloads", "compile", "typeof_pyval"):
        setattr(watched, name, getattr(kernel, name))
    monkeypatch.setattr(summation._numba, "sum_tile", watched)
    pysas.backproject(echoes, pysas.Grid.plane(axis, axis[:40]), 1e-2, backend="numba")
    assert len(seen) > 2 and all(last <= room for last, room in seen)
