"""What calls are handed: arrays that alias, overlap, mask or change, callbacks, a caller's error settings, sums of nothing."""

import numpy as np
import pytest
from scenes import PLANE, X, Y, straight

import pysas
from pysas import _checks

ECHOES = straight(16)
BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
CALLS = {
    "backproject": pysas.backproject,
    "ffbp": pysas.ffbp,
    "focus": pysas.focus,
    "plan": lambda echoes, grid, out: pysas.plan(echoes, grid)(echoes.data, out=out),
}


def aliases():
    """Echoes, grid and an `out` that is the data, laps over them, or over itself."""
    grid = pysas.Grid.plane(X[:30] + 0.4, 17.45 + 0.01 * np.arange(16))
    part = ECHOES.data[:, :, :30].copy()
    store = np.zeros((20, 1, 30), complex)
    store[:16] = part
    near = ECHOES.replace(bandwidth=None)
    yield "the data", near.replace(data=part), grid, part[:, 0], "shares memory with data"
    yield "some of the data", near.replace(data=store[:16]), grid, store[4:, 0], "shares memory with data"
    yield "turned data", near.replace(data=part), grid, part[::-1, 0, ::-1], "shares memory with data"
    row = np.zeros(30, complex)
    same = np.lib.stride_tricks.as_strided(row, (16, 30), (0, 16))
    yield "one row", ECHOES, grid, same, "memory of its own for every entry"
    lap = np.lib.stride_tricks.as_strided(np.zeros(600, complex), (16, 30), (16 * 29, 16))
    yield "rows that lap over", ECHOES, grid, lap, "memory of its own for every entry"


ALIASES = list(aliases())


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("case", range(len(ALIASES)), ids=[case[0] for case in ALIASES])
def test_out_of_others_memory_is_refused_and_nothing_is_written(case, call):
    _, echoes, grid, out, message = ALIASES[case]
    before = echoes.data.copy()
    with pytest.raises(ValueError, match=f"^out: .*{message}"):
        CALLS[call](echoes, grid, out=out)
    assert np.array_equal(echoes.data, before)


@pytest.mark.parametrize("backend", BACKENDS)
def test_out_beside_the_data_in_one_array_is_filled(backend):
    pairs = np.zeros((16, 1, 900, 2), complex)
    pairs[..., 0] = ECHOES.data
    echoes = ECHOES.replace(data=pairs[..., 0])
    grid = pysas.Grid.plane(X[:30], Y[:16])
    out = pairs[:, 0, :30, 1]
    image = pysas.backproject(echoes, grid, backend=backend, out=out)
    assert np.shares_memory(image.data, out)
    assert np.array_equal(out, pysas.backproject(ECHOES, grid, backend=backend).data)
    assert np.array_equal(pairs[..., 0], ECHOES.data)


@pytest.mark.parametrize("out", [np.ma.zeros(PLANE.shape, complex), [[0j]], np.zeros(PLANE.shape, np.complex64)])
def test_out_of_another_kind_is_a_type_error(out):
    with pytest.raises(TypeError, match="^out: expected an array of complex128"):
        pysas.backproject(ECHOES, PLANE, out=out)


def masked(array, entry=0):
    mask = np.zeros(np.shape(array), bool)
    mask.reshape(-1)[entry] = True
    return np.ma.array(array, mask=mask)


def masked_arguments():
    t, p = ECHOES.tx, ECHOES.n_ping
    for name, value in {
        "data": ECHOES.data,
        "tx": t,
        "rx": ECHOES.rx,
        "velocity": np.zeros((p, 3)),
        "t0": ECHOES.start_time,
        "ping_time": np.arange(p),
    }.items():
        yield name, lambda name=name, value=value: ECHOES.replace(**{name: masked(value)})
    yield "pulse", lambda: ECHOES.replace(pulse=masked(np.ones(5, complex)))
    yield "boresight", lambda: pysas.Beam(masked([0.0, 1, 0]), 0.1, 0.5)
    yield "x", lambda: pysas.Grid.plane(masked(X), Y)
    yield "angle", lambda: pysas.Grid.polar(Y, masked(X))
    yield "centre", lambda: pysas.Grid.polar(Y, X, masked(np.zeros(3)))
    yield "z", lambda: pysas.Grid.surface(X, Y, masked(np.zeros(PLANE.shape)))
    yield "z", lambda: pysas.Grid.plane(X, Y, np.ma.masked)
    yield "points", lambda: pysas.Grid.points(masked(np.zeros((5, 3))))
    yield "points", lambda: pysas.Grid.points([masked(np.zeros(3)), np.zeros(3)])
    yield "mask", lambda: pysas.Grid.plane(X, Y, mask=masked(np.ones(PLANE.shape, bool)))
    yield "weights", lambda: pysas.backproject(ECHOES, PLANE, weights=masked(np.ones(p)))
    yield "data", lambda: pysas.plan(ECHOES, PLANE)(masked(ECHOES.data))
    yield "data", lambda: next(pysas.plan(ECHOES, PLANE).stream([masked(ECHOES.data)]))
    yield "data", lambda: pysas.backproject_arrays(masked(ECHOES.data), np.zeros((1, 3)), fs=1, fc=1, tx=t, rx=ECHOES.rx)
    yield "data", lambda: pysas.Image(masked(np.ones(PLANE.shape, complex)), PLANE, pysas.Report("x"), 1e5, 1500.0)
    points = np.array([[0.0, 20, 0]])
    pulse = pysas.LFM(1e5, 2e4, 1e-3)
    yield "points", lambda: pysas.simulate(masked(points), [1], pulse, tx=t, rx=ECHOES.rx, fs=4e4, duration=0.05)
    yield "amplitudes", lambda: pysas.simulate(points, masked([1.0]), pulse, tx=t, rx=ECHOES.rx, fs=4e4, duration=0.05)
    yield "samples", lambda: pysas.from_phase_history(masked(np.ones((2, 4), complex)), np.arange(1, 5), t[:2], [1, 1], 1.0)


MASKED = list(masked_arguments())


@pytest.mark.parametrize("case", range(len(MASKED)), ids=[f"{i}-{case[0]}" for i, case in enumerate(MASKED)])
def test_masked_entries_are_refused(case):
    name, call = MASKED[case]
    with pytest.raises(TypeError, match=f"^{name}: masked"):
        call()


def test_a_masked_array_without_masked_entries_is_an_array():
    echoes = ECHOES.replace(data=np.ma.array(ECHOES.data), tx=np.ma.array(ECHOES.tx, mask=False))
    assert type(echoes.data) is np.ndarray and type(echoes.tx) is np.ndarray


def test_what_objects_are_made_of_is_copied_and_cannot_be_changed():
    mutable = {"tx": ECHOES.tx, "rx": ECHOES.rx, "velocity": np.zeros((16, 3)), "t0": ECHOES.start_time, "ping_time": X[:16]}
    mutable = {name: np.array(value) for name, value in mutable.items()}
    boresight, pulse = np.array([0.0, 1, 0]), np.ones(4, complex)
    echoes = pysas.Echoes(ECHOES.data, fs=4e4, fc=1e5, beam=pysas.Beam(boresight, 0.1, 1.0), pulse=pulse, **mutable)
    x, y, points, mask = X.copy(), Y.copy(), PLANE.coordinates(), np.ones(PLANE.shape, bool)
    plane, any_, height = pysas.Grid.plane(x, y, mask=mask), pysas.Grid.points(points), np.zeros(PLANE.shape)
    surface = pysas.Grid.surface(x, y, height)
    kept = [getattr(echoes, name) for name in mutable] + [echoes.beam.boresight, echoes.pulse, *plane.axes.values()]
    kept += [any_.coords, plane.mask, surface.height]
    given = [*mutable.values(), boresight, pulse, x, y, points, mask, height]
    for array, original in zip(kept, given, strict=True):
        assert not np.shares_memory(array, original) and np.array_equal(array, original)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert echoes.data is ECHOES.data


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", ["points", "surface", "plane"])
def test_a_plan_images_what_was_planned_whatever_becomes_of_the_arrays(kind, backend):
    arrays = {"tx": np.array(ECHOES.tx), "rx": np.array(ECHOES.rx), "t0": np.array(ECHOES.start_time), "weights": np.ones(16)}
    x, y, z = X.copy(), Y.copy(), np.zeros(PLANE.shape)
    points = np.random.default_rng(0).uniform(0, 1, (300, 3)) + [0, 19, 0]
    grid = {"points": lambda: pysas.Grid.points(points), "surface": lambda: pysas.Grid.surface(x, y, z)}.get(
        kind, lambda: pysas.Grid.plane(x, y)
    )()
    weights = arrays.pop("weights")
    echoes = ECHOES.replace(**arrays)
    plan = pysas.plan(echoes, grid, method="backprojection", backend=backend, weights=weights)
    expected = plan(ECHOES.data).data
    for array in (*arrays.values(), weights, x, y, z, points):
        array[...] = np.nan
    assert np.array_equal(plan(ECHOES.data).data, expected)
    assert np.array_equal(pysas.backproject(echoes, grid, backend=backend).data, expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_samples_are_read_when_a_call_starts(backend):
    data = ECHOES.data.copy()
    echoes = ECHOES.replace(data=data)
    plan = pysas.plan(echoes, PLANE, backend=backend)
    first = plan(data).data
    data *= 2
    assert np.allclose(plan(data).data, 2 * first, rtol=1e-6)
    data[3, 0, 7] = np.inf
    with pytest.raises(ValueError, match="non-finite sample at ping 3, channel 0"):
        plan(data)


def everything():
    raw = pysas.simulate(
        [[0, 20, 0]], [1], pysas.LFM(1e5, 1e4, 1e-3, "gaussian", 1e-4), tx=ECHOES.tx, rx=ECHOES.rx, fs=4e4, duration=0.04
    )
    echoes = pysas.compress(raw, window="hann")
    repr(echoes)
    for backend in pysas.engine.BACKENDS[1:]:
        if backend == "cpp" and pysas.engine.native.extension() is None:
            continue
        for method in ("backprojection", "ffbp"):
            plan = pysas.plan(echoes, PLANE, 1e-3, method, backend=backend)
            plan.explain()
            image = plan(echoes.data)
        pysas.backproject(ECHOES, PLANE, weights="uniform-angle", backend=backend)
        pysas.backproject(ECHOES.replace(beam=pysas.Beam([0, 1, 0], 0.05, 0.5)), PLANE, 1e-6, backend=backend)
    image.db()
    repr(image)


@pytest.mark.filterwarnings("ignore:.*far below a pixel")
def test_a_callers_error_settings_are_its_own():
    with np.errstate(all="raise"):
        everything()
        assert np.geterr() == dict.fromkeys(np.geterr(), "raise")


@pytest.mark.parametrize("call", CALLS)
def test_progress_must_be_callable(call):
    with pytest.raises(TypeError, match=r"^progress=3: expected a callable or None"):
        if call == "plan":
            pysas.plan(ECHOES, PLANE)(ECHOES.data, progress=3)
        else:
            CALLS[call](ECHOES, PLANE, progress=3)


def test_ragged_and_odd_arguments_are_named():
    with pytest.raises(ValueError, match="^weights: expected an array, found sequences of unequal lengths"):
        pysas.backproject(ECHOES, PLANE, weights=[[1, 2], [3]])
    raw = ECHOES.replace(compressed=False, pulse=np.ones(3, complex))
    for window in ((), ("hann", "x"), ("kaiser",), (np.ones(3),)):
        with pytest.raises(ValueError, match="^window="):
            pysas.compress(raw, window=window)
    with pytest.raises(ValueError, match=r"^backend=\['cpp'\]: expected one of"):
        pysas.backproject(ECHOES, PLANE, backend=["cpp"])
    for threads in (0, 4097, 10**30):
        with pytest.raises(ValueError, match=rf"^threads={threads}: expected a whole number in \[1, 4096\]"):
            pysas.backproject(ECHOES, PLANE, threads=threads)


@pytest.mark.parametrize("text", ["", "two", "-1", "0", "\u00b2", "1e3", "99999999999999999999", "5000"])
def test_an_odd_number_of_threads_in_the_environment_is_named(text, monkeypatch):
    monkeypatch.setenv("PYSAS_NUM_THREADS", text)
    with pytest.raises(ValueError, match="^PYSAS_NUM_THREADS=.*: expected a whole number"):
        pysas.backproject(ECHOES, PLANE)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("away", [1e12, 1e15, 1e20, 1e100, 1e200])
def test_what_float64_cannot_place_is_refused(away, backend):
    """Delays over 1e15 m have no sample to themselves, whatever the carrier."""
    echoes = ECHOES.replace(fc=1e-3, bandwidth=2e4)
    grid = pysas.Grid.points([[0, 20, 0], [0, away, 0]])
    with pytest.raises(ValueError, match="tol=0.01: .* reach .* at best"):
        pysas.backproject(echoes, grid, 1e-2, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("t0", [-1e12, 1e12, 1e300])
def test_a_record_ages_away_hears_nothing(t0, backend):
    with pytest.warns(UserWarning, match="outside the recorded window"):
        assert not pysas.backproject(ECHOES.replace(t0=t0), PLANE, backend=backend).data.any()


def empty():
    blind = pysas.Beam([0, -1, 0], 0.1, 0.5)
    nan = np.full_like(ECHOES.data, np.nan)
    yield "window", {}, {"t0": 5.0}, {}, "outside the recorded window"
    # the box of two pixels reaches across the record, its pixels do not
    yield "pixels", {"points": [[0, 2, 0], [0, 100, 0]]}, {}, {}, "no pixel lies within the recorded window of any trace left"
    yield "beam", {}, {"beam": blind}, {}, "no pixel lies within the beam of any trace left"
    near, far, behind = [0, 2, 0], [0, 100, 0], [0, -20, 0]  # 2 m are before the record begins, 100 m after it ends
    recorded = "no pixel lies within the recorded window of any trace left"
    either = "no pixel lies within the beam or the recorded window of any trace left"
    at_once = "no pixel lies within the beam and at once within the recorded window of any trace left"
    for shape in ("fan", "cone"):
        ahead, back = (pysas.Beam([0, side, 0], 0.1, 1.5, shape, 0.5) for side in (1, -1))
        yield f"window, {shape}", {"points": [near, far]}, {"beam": ahead}, {}, recorded
        yield f"either, {shape}", {"points": [near, far]}, {"beam": back}, {}, either
        yield f"both, {shape}", {"points": [near, behind]}, {"beam": ahead}, {}, at_once
    yield "mask", {"mask": np.zeros(PLANE.shape, bool)}, {}, {}, "the mask leaves out every pixel"
    yield "NaN", {}, {"data": nan}, {"nan": "mask"}, "every trace holds non-finite samples"
    yield "weights", {}, {}, {"weights": np.zeros(16)}, "the weights are all 0"
    odd, late = np.arange(16) % 2, np.where(np.arange(16) % 2, 5.0, ECHOES.start_time)
    mixed = "no trace is left of 16: 8 outside the recorded window, 8 of weight 0"
    yield "window and weights", {}, {"t0": late}, {"weights": odd}, mixed


EMPTY = list(empty())


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("case", EMPTY, ids=[case[0] for case in EMPTY])
def test_a_sum_of_nothing_warns_once_and_says_why(case, call, backend):
    _, pixels, changes, options, message = case
    grid = pysas.Grid.points(pixels["points"]) if "points" in pixels else pysas.Grid.plane(X, Y, **pixels)
    echoes = ECHOES.replace(**changes)
    with pytest.warns(UserWarning, match=f"{message}.*: image is zero") as caught:
        if call == "plan":
            image = pysas.plan(echoes, grid, backend=backend, **options)(echoes.data)
        else:
            image = CALLS[call](echoes, grid, backend=backend, **options)
    assert len(caught) == 1
    assert not image.data.any() and image.report.terms == 0
    assert sum("image is zero" in note for note in image.report.notes) == 1


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("call", ["backproject", "ffbp", "focus"])
def test_terms_of_masked_pixels_alone_are_none(call, backend):
    """Pixels 100 m away lie beyond the record; the one within it is masked, on the same line."""
    points = np.zeros((1, 30, 3))
    points[..., 1] = np.linspace(20, 100, 30)
    mask = points[..., 1] > 40
    echoes = ECHOES.replace(data=ECHOES.data[..., :300])
    with pytest.warns(UserWarning, match="no pixel lies within the recorded window of any trace left: image is zero") as caught:
        image = CALLS[call](echoes, pysas.Grid.points(points, mask=mask), backend=backend)
    assert len(caught) == 1 and image.report.terms == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_samples_of_nothing_are_said_to_be(backend):
    with pytest.warns(UserWarning, match="every sample is 0: image is zero"):
        image = pysas.backproject(ECHOES.replace(data=np.zeros_like(ECHOES.data)), PLANE, backend=backend)
    assert image.report.terms > 0 and not image.data.any()


def test_a_fault_in_planning_trees_leaves_the_direct_sum(monkeypatch):
    """Of Numba's planner; that of C++ has no door for faults."""

    def fail(*_, **__):
        raise _checks.InternalError("no such tree")

    monkeypatch.setattr("pysas.planning.fallback.planner.TERMS", 0)
    monkeypatch.setattr("pysas.planning.fallback.trees.lay_out", fail)
    expected = pysas.backproject(ECHOES, PLANE, backend="numba")
    for image in (pysas.focus(ECHOES, PLANE, backend="numba"), pysas.ffbp(ECHOES, PLANE, backend="numba")):
        assert np.array_equal(image.data, expected.data)
        assert any("no such tree" in note for note in image.report.notes)
    assert "no such tree" in pysas.plan(ECHOES, PLANE, method="backprojection", backend="numba").explain()
    with pytest.raises(_checks.InternalError, match="no such tree"):
        pysas.ffbp(ECHOES, PLANE, fallback=False, backend="numba")


def test_an_internal_error_asks_for_a_report():
    error = _checks.InternalError("nothing found")
    assert isinstance(error, RuntimeError)
    assert str(error).startswith("nothing found: a fault of pysas, not of its input: please report it")
