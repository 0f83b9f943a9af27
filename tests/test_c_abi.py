"""The C library: through ctypes against the oracle and the Python engine, and the C example, built with plain cc."""

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

import c_library
import numpy as np
import promise_scenes
import pytest
import test_c_python
from c_library import PROGRESS, Options, Survey, i64, pointer, structs
from scenes import PLANE, SCENES, C, far, moving, noise, straight
from test_factorised import CASES, answer, plane
from test_levels import scene as beside

import pysas

pytestmark = [pytest.mark.cpp, pytest.mark.skipif(sys.platform == "win32", reason="POSIX names and flags")]
EXAMPLE = Path(__file__).parent.parent / "examples" / "c" / "image.c"


@pytest.fixture(scope="module")
def library():
    return c_library.library()


def image(library, echoes, grid, tol, points=False, change=lambda survey, lines, options: None, shares=None):
    """The image, or the code of an error; the factorised share is appended to `shares`."""
    keep = []
    parts = structs(echoes, grid, tol, keep, points)
    change(*parts)
    plan = pointer()
    code = library.pysas_plan_create(*map(ctypes.byref, parts), ctypes.byref(plan))
    if code:
        return code
    if shares is not None:
        shares.append(library.pysas_plan_factorised_share(plan))
    out = np.full(grid.shape, np.nan, dtype=echoes.dtype)
    data = echoes.data
    step = (i64 * 3)(*(s // data.itemsize for s in data.strides))
    code = library.pysas_plan_execute(plan, data.ctypes.data, ctypes.cast(step, pointer), out.ctypes.data, None)
    library.pysas_plan_destroy(plan)
    return code or out


@pytest.mark.parametrize("name", [name for name in SCENES if name not in ("polar", "surface")])
def test_tol_is_kept(library, name):
    make, grid = SCENES[name]
    echoes = make()
    pixels = np.random.default_rng(5).choice(grid.size, 250, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    for data, tols in ((single, (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)), (echoes, (1e-4, 1e-6, 1e-8))):
        for tol in tols:
            found = image(library, data, grid, tol)
            assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= tol


def test_pixels_on_a_records_ends_count(library):
    """A grid whose first row lies on the first sample of pings abeam, whose last on the last."""
    samples, fs = 400, 40e3
    tx = np.stack([(np.arange(24) - 12) * 0.02, np.zeros(24), np.zeros(24)], axis=1)
    data = noise(24, 1, samples, 0.75).astype(np.complex64)
    for start, row in ((0.04, 30.0), (0.02, 15.0), (2 * 30 / C, 30.0)):
        echoes = pysas.Echoes(data, fs=fs, fc=1e5, tx=tx, rx=tx[:, None], c=C, t0=start, bandwidth=30e3)
        grid = pysas.Grid.plane(np.arange(-24, 24) * 0.01, np.linspace(row, row + C * (samples - 1) / fs / 2, 12))
        exact, level = pysas.reference.exact(echoes, grid)
        for points in (False, True):
            found = image(library, echoes, grid, 1e-3, points)
            assert pysas.metrics.relative_error(found, exact, level) <= 1e-3


@pytest.mark.parametrize("half", [np.pi / 2, np.pi / 4, 1e-7])
def test_pixels_on_a_beams_edge_count(library, half):
    """In a row that begins on the track, on a diagonal, and across a beam narrower than its slack."""
    echoes = straight(8, spacing=0.05).replace(t0=0.0)
    tx = echoes.tx
    bore = np.array([0, 1.0, 0]) if half > 1 or half < 1e-3 else np.array([1.0, 0, 0])
    across = np.arange(1, 6, 0.25)
    edge = tx[0] + across[:, None] * {np.pi / 2: [1.0, 0, 0], np.pi / 4: [1.0, 1, 0], 1e-7: [1e-7, 1, 0]}[half]
    grid = pysas.Grid.points(np.stack([edge, edge + 0.3 * bore, edge - 0.3 * bore]))
    keep = np.tile(bore, (len(tx), 1))

    def lit(survey, lines, options):
        survey.boresight, survey.beam_half_angle = keep.ctypes.data, half

    exact, level = pysas.reference.exact(echoes.replace(beam=pysas.Beam(bore, 0.1, half, "cone")), grid)
    assert np.all(level[0] > 0)
    found = image(library, echoes, grid, 1e-3, True, lit)
    assert pysas.metrics.relative_error(found, exact, level) <= 1e-3


@pytest.mark.parametrize("pings", [6000, 60000])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_sums_of_equal_terms_keep_tol(library, pings, dtype):
    """A platform that stands still; of so many pings that batches add up too."""
    n = np.arange(2000)
    trace = (np.exp(-(((n - 1000.3) / 4) ** 2)) * np.exp(0.3j)).astype(dtype)
    survey = {"fs": 40e3, "fc": 1e5, "c": C, "t0": 0.04, "bandwidth": 20e3}
    one = pysas.Echoes(trace[None], tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), **survey)
    ranges = 30 + (999.2 + 0.7 * np.arange(4)) * C / 40e3 / 2
    grid = pysas.Grid.points(np.stack([0 * ranges, ranges, 0 * ranges], axis=1).reshape(2, 2, 3))
    exact, _ = pysas.reference.exact(one, grid)
    tx = np.zeros((pings, 3))
    echoes = pysas.Echoes(np.broadcast_to(trace, (pings, 1, n.size)), tx=tx, rx=tx[:, None], **survey)
    found = image(library, echoes, grid, 1e-5, True)
    assert np.linalg.norm(found - pings * exact) <= 1e-5 * pings * np.linalg.norm(exact)


@pytest.mark.parametrize(("seed", "tol"), [(1025, 1e-3), (1006, 1e-3), (1007, 1e-2)])
def test_tol_is_kept_beside_bright_samples(library, seed, tol):
    """An echo just outside the grid, a transmit pulse that the record's start cuts; the Python engines keep tol there."""
    _, echoes, grid = beside(seed)
    echoes = echoes.replace(data=echoes.data.astype(np.complex64)[:, None].copy(), rx=echoes.tx[:, None].copy())
    exact, level = pysas.reference.exact(echoes, grid)
    assert pysas.metrics.relative_error(image(library, echoes, grid, tol), exact, level) <= tol


@pytest.mark.parametrize("seed", [752, 1358])
def test_tol_is_kept_beside_records_ends(seed):
    """Tones at the band's edge, pixels on a record's first samples; the Python engines keep tol there."""
    scene = promise_scenes.draw(seed)
    found = c_library.call(scene.echoes, scene.grid, scene.tol)
    pixels = np.arange(0, scene.grid.size, max(1, scene.grid.size // 100))
    exact, level = pysas.reference.exact(scene.echoes, scene.grid, pixels)
    assert pysas.metrics.relative_error(found.image.ravel()[pixels], exact, level) <= scene.tol


@pytest.mark.parametrize("name", ["surface", "polar", "moving"])
def test_lists_of_points(library, name):
    make, grid = SCENES[name]
    echoes = make()
    found = image(library, echoes, grid, 1e-3, points=True)
    pixels = np.arange(0, grid.size, 11)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3


def test_mask_progress_and_cancelling(library):
    echoes = moving()
    mask = np.zeros(PLANE.shape, bool)
    mask[10:30, 5:50] = True
    grid = pysas.Grid.plane(PLANE.axes["x"], PLANE.axes["y"], mask=mask)
    found = image(library, echoes, grid, 1e-3)
    assert np.array_equal(found != 0, mask)
    shares = []

    @PROGRESS
    def note(share, user):
        shares.append(share)
        return 0

    @PROGRESS
    def stop(share, user):
        return 1

    def with_progress(callback):
        def change(survey, lines, options):
            options.progress = callback

        return change

    again = image(library, echoes, grid, 1e-3, change=with_progress(note))
    assert np.array_equal(found, again) and shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)
    assert image(library, echoes, grid, 1e-3, change=with_progress(stop)) == 4


def test_every_isa_and_thread_count(library):
    echoes = moving()
    expected = image(library, echoes, PLANE, 1e-4)
    for threads in (1, 3, 7):
        found = image(library, echoes, PLANE, 1e-4, change=lambda s, g, o, n=threads: setattr(o, "threads", n))
        assert np.array_equal(found, expected)
    for isa in (b"baseline", b"avx2", b"avx512", b"neon"):
        found = image(library, echoes, PLANE, 1e-4, change=lambda s, g, o, name=isa: setattr(o, "isa", name))
        assert isinstance(found, int) and found == 1 or np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("part", "field", "value", "code"),
    [
        (0, "struct_size", 8, 6), (0, "n_ping", 0, 1), (0, "n_sample", 2**62, 1), (0, "fs", float("nan"), 1), (0, "fc", -1, 1),
        (0, "c", 0, 1), (0, "bandwidth", 39e3, 1), (0, "tx", None, 1), (0, "t0", float("inf"), 1), (1, "struct_size", 0, 6),
        (1, "width", -3, 1), (1, "height", 2**60, 1), (2, "tol", 0.5, 2), (2, "tol", 1e-12, 2), (2, "tol", float("nan"), 2),
        (2, "dtype", 7, 1), (2, "method", 3, 1), (2, "method", -1, 1), (2, "threads", -1, 1), (2, "isa", b"mmx", 1),
    ],
)  # fmt: skip
def test_bad_arguments_are_codes(library, part, field, value, code):
    def change(*parts):
        setattr(parts[part], field, value)
        if field == "t0":
            parts[0].ping_t0 = None

    found = image(library, straight(8), PLANE, 1e-3, change=change)
    assert found == code


def test_null_pointers_and_codes_have_words(library):
    assert library.pysas_plan_create(None, None, None, None) == 1
    assert library.pysas_plan_execute(None, None, None, None, None) == 1
    words = [library.pysas_strerror(code) for code in range(10)]
    assert len(set(words)) == 10 and words[9] == b"unknown error code"


def test_traces_of_weight_zero_may_be_anywhere(library):
    """With a beam that looks nowhere; the others make the image that they make alone."""
    echoes, wild = straight(16), straight(16)
    axis = np.arange(32) / 64
    grid = pysas.Grid.plane(axis, axis + 20)
    weights, boresight = np.ones(16), np.tile([0.0, 1.0, 0.0], (16, 1))
    weights[[0, 7]] = 0
    position = wild.tx.copy()
    position[7] = 1e14, 0, 0
    wild = wild.replace(tx=position, rx=position[:, None])

    def lit(survey, lines, options):
        survey.weights, survey.boresight, survey.beam_half_angle = weights.ctypes.data, boresight.ctypes.data, 0.2

    expected = image(library, echoes, grid, 1e-3, change=lit)
    boresight[7] = 0
    assert np.array_equal(image(library, wild, grid, 1e-3, change=lit), expected)


def test_far_away_coordinates_lose_nothing(library):
    """Northings of 4,194,304 m, which float64 adds without rounding; steps that it does not hold."""
    echoes, shift = straight(16), np.array([0.0, 2.0**22, 0.0])
    near = pysas.Grid.plane(np.arange(40) * 0.013, 20 + np.arange(30) * 0.011)
    moved = echoes.replace(tx=echoes.tx + shift, rx=echoes.receivers + shift)

    def north(survey, lines, options):
        lines.first[1] += shift[1]

    assert np.array_equal(moved.tx - shift, echoes.tx)
    found = [image(library, one, near, 1e-8, change=change) for one, change in ((echoes, lambda *_: None), (moved, north))]
    assert pysas.metrics.relative_error(found[1], found[0], 0 * abs(found[0])) <= 1e-9


def test_samples_that_are_not_finite(library):
    data = straight(8).data.copy()
    data[3, 0, 5] = np.nan
    assert isinstance(image(library, straight(8), PLANE, 1e-3), np.ndarray)
    keep = []
    parts = structs(straight(8), PLANE, 1e-3, keep)
    plan = pointer()
    assert library.pysas_plan_create(*map(ctypes.byref, parts), ctypes.byref(plan)) == 0
    out = np.zeros(PLANE.shape, complex)
    assert library.pysas_plan_execute(plan, data.ctypes.data, None, out.ctypes.data, None) == 7
    library.pysas_plan_destroy(plan)


FFBP = 1


def factorised(library, echoes, grid, tol, points=False, **options):
    """Image and share of fast factorised back-projection, with some fields of the options set."""

    def change(survey, lines, struct):
        struct.method = FFBP
        for name, value in options.items():
            setattr(struct, name, value)

    shares = []
    return image(library, echoes, grid, tol, points, change, shares), shares[0]


@pytest.mark.parametrize("name", ["straight", "prime number of pings", "moving, 6 receivers", "circular"])
def test_ffbp_keeps_tol(library, name):
    make, grid = CASES[name]
    echoes = make()
    pixels, exact, level = answer(echoes, grid)
    for tol in (1e-1, 1e-2, 1e-3, 1e-4):
        found, _ = factorised(library, echoes, grid, tol)
        assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= tol


def test_ffbp_down_to_its_least_tolerance(library):
    """Between records' ends that are far enough off; double samples go through float trees too."""
    echoes, grid = straight(pings=256, samples=3500).replace(t0=2 * 4.0 / 1500), plane(192, 160, 26.0)
    pixels, exact, level = answer(echoes, grid)
    for data in (echoes, echoes.replace(data=echoes.data.astype(np.complex64))):
        found, _ = factorised(library, data, grid, 3e-5)
        assert found.dtype == data.dtype
        assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 3e-5


def test_ffbp_with_weights_mask_and_beam(library):
    make, grid = CASES["moving, 6 receivers"]
    echoes = make()
    rng = np.random.default_rng(4)
    weights = rng.standard_normal((48, 6))
    weights[3] = 0
    mask = np.zeros(grid.shape, bool)
    mask[20:90, 30:170] = rng.random((70, 140)) < 0.5
    masked = pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask)
    found, _ = factorised(library, echoes, masked, 1e-3)
    pixels, exact, level = answer(echoes, masked)
    assert not found[~mask].any()
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3

    def more(survey, lines, options):
        survey.weights = weights.ctypes.data
        options.method = FFBP

    found = image(library, echoes, masked, 1e-3, change=more)
    exact, level = pysas.reference.exact(echoes, masked, pixels, weights)
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3
    boresight = np.tile(np.array([0.0, 1.0, -0.25]) / np.hypot(1, 0.25), (48, 1))
    beam = echoes.replace(beam=pysas.Beam(boresight[0], 0.05, np.radians(9.0), "cone"))
    shares = []

    def narrow(survey, lines, options):
        survey.boresight = boresight.ctypes.data
        survey.beam_half_angle = np.radians(9.0)
        options.method = FFBP

    found = image(library, echoes, grid, 1e-3, change=narrow, shares=shares)
    pixels, exact, level = answer(beam, grid)
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3


@pytest.mark.parametrize("points", [False, True])
def test_images_of_floats_are_rounded_once(library, points):
    """Of many trees, or batches: as the image of the same samples in double."""
    echoes, grid = straight(pings=512, samples=3500).replace(t0=2 * 4.0 / 1500), plane(96, 80, 26.0)
    data = echoes.data.astype(np.complex64)
    found, _ = factorised(library, echoes.replace(data=data), grid, 3e-5, points)
    double, _ = factorised(library, echoes.replace(data=data.astype(np.complex128)), grid, 3e-5, points)
    assert np.array_equal(found, double.astype(np.complex64))


def test_a_beam_that_reaches_every_pixel_is_none(library):
    """From every ping, within a right angle of boresight: trees, and the same image."""
    echoes, grid = test_c_python.SCENES["one receiver"][0](), test_c_python.SCENES["one receiver"][1]
    boresight = np.tile([0.0, 1.0, 0.0], (len(echoes.tx), 1))
    plain, share = factorised(library, echoes, grid, 1e-3, threads=1)
    assert share > 0.99
    for half, trees in ((1.5, True), (np.pi / 2, True), (2.5, True), (0.1, False)):
        shares = []

        def lit(survey, lines, options, half=half):
            survey.boresight, survey.beam_half_angle = boresight.ctypes.data, half
            options.method, options.threads = FFBP, 1

        found = image(library, echoes, grid, 1e-3, change=lit, shares=shares)
        assert shares == [share if trees else 0] and np.array_equal(found, plain) == trees
    boresight[5] *= -1  # behind one ping, whose beam reaches round it

    def behind(survey, lines, options):
        survey.boresight, survey.beam_half_angle = boresight.ctypes.data, 2.0
        options.method, options.threads = FFBP, 1

    shares = []
    found = image(library, echoes, grid, 1e-3, change=behind, shares=shares)
    assert not np.array_equal(found, plain) and 0 < shares[0] < share  # groups without that ping have trees


def test_ffbp_on_every_isa_and_thread_count(library):
    echoes, grid = test_c_python.SCENES["one receiver"][0](), test_c_python.SCENES["one receiver"][1]
    pixels, exact, level = answer(echoes, grid)
    for isa in (None, b"baseline", b"avx2", b"avx512", b"neon"):
        one = image(library, echoes, grid, 1e-3, change=lambda s, g, o, name=isa: setattr(o, "isa", name))
        if isinstance(one, int):
            assert one == 1  # not on this machine
            continue
        one, share = factorised(library, echoes, grid, 1e-3, isa=isa, threads=1)
        assert share > 0.99
        assert pysas.metrics.relative_error(one.ravel()[pixels], exact, level) <= 1e-3
    one = factorised(library, echoes, grid, 1e-3, threads=1)
    for threads in (2, 3, 7):
        assert np.array_equal(factorised(library, echoes, grid, 1e-3, threads=threads)[0], one[0])


def test_ffbp_reports_progress_and_stops(library):
    echoes, grid = test_c_python.SCENES["one receiver"][0](), test_c_python.SCENES["one receiver"][1]
    shares = []

    @PROGRESS
    def note(share, user):
        shares.append(share)
        return int(share > 0.3)

    @PROGRESS
    def listen(share, user):
        shares.append(share)
        return 0

    found, _ = factorised(library, echoes, grid, 1e-3, progress=listen, threads=1)
    assert isinstance(found, np.ndarray)
    assert shares[0] == 0 and shares[-1] == 1 and len(shares) > 2 and shares == sorted(shares)
    shares.clear()
    assert factorised(library, echoes, grid, 1e-3, progress=note, threads=1)[0] == 4
    assert shares == sorted(shares) and 0.3 < shares[-1] < 1


@pytest.mark.parametrize("method", [0, 1, 2])
def test_plans_tell_what_python_s_do(library, method):
    """In words, whole or cut to the room there is, and in numbers."""
    echoes = SCENES["moving"][0]()
    echoes = echoes.replace(data=echoes.data.astype(np.complex64))
    axis = np.arange(64) / 64
    grid, keep, plan = pysas.Grid.plane(axis, axis + 20), [], pointer()
    parts = structs(echoes, grid, 1e-3, keep)
    parts[2].method = method
    assert library.pysas_plan_create(*map(ctypes.byref, parts), ctypes.byref(plan)) == 0
    same = pysas.plan(echoes, grid, 1e-3, ("backprojection", "ffbp", "auto")[method], parts[2].threads, "cpp")
    size = library.pysas_plan_describe(plan, None, 0)
    text = ctypes.create_string_buffer(size + 1)
    assert library.pysas_plan_describe(plan, text, size + 1) == size and text.value.decode() == str(same)
    few = ctypes.create_string_buffer(b"x" * 20)
    assert library.pysas_plan_describe(plan, few, 10) == size and few.raw[:12] == text.raw[:9] + b"\0xx"
    assert library.pysas_plan_seconds(plan) == same.predicted_seconds
    assert library.pysas_plan_error(plan) == pytest.approx(same.choices.predicted_error, rel=1e-12)
    library.pysas_plan_destroy(plan)
    assert library.pysas_plan_describe(None, None, 0) == library.pysas_plan_seconds(None) == library.pysas_plan_error(None) == 0


def test_surveys_of_older_callers_have_cones_with_hard_edges(library):
    echoes, grid = moving(16), PLANE
    boresight = np.tile([0.0, 1.0, -0.2], (echoes.n_ping, 1))

    def lit(survey, lines, options):
        survey.boresight, survey.beam_half_angle = boresight.ctypes.data, 0.3

    def older(survey, lines, options):
        lit(survey, lines, options)
        survey.beam_shape, survey.beam_taper = 1, 0.5  # beyond its end: not read
        survey.struct_size = Survey.beam_shape.offset

    assert np.array_equal(image(library, echoes, grid, 1e-3, change=older), image(library, echoes, grid, 1e-3, change=lit))
    for size in (0, Survey.beam_shape.offset + 4, ctypes.sizeof(Survey) + 8):
        assert image(library, echoes, grid, 1e-3, change=lambda s, g, o, n=size: setattr(s, "struct_size", n)) == 6


@pytest.mark.parametrize(
    "beam",
    [
        {"beam_shape": 2}, {"beam_shape": -1}, {"beam_half_angle": 1.6, "beam_shape": 1}, {"beam_taper": -0.1},
        {"beam_taper": 1.1}, {"beam_taper": float("nan")}, {"beam_taper": 1e-6},
        {"beam_shape": 1, "beam_axis": [0.0, 2.0, 0.0]}, {"beam_shape": 1, "beam_axis": [0.0, 0.0, 0.0]},
        {"beam_shape": 1, "boresight": [0.0, 0.0, -1.0]},
    ],
)  # fmt: skip
def test_beams_that_are_none(library, beam):
    echoes, grid = moving(16), PLANE
    arrays = {name: np.tile(beam.get(name, [0.0, 1.0, 0.0]), (echoes.n_ping, 1)) for name in ("boresight", "beam_axis")}

    def change(survey, lines, options):
        survey.boresight, survey.beam_half_angle = arrays["boresight"].ctypes.data, 0.3
        for name, value in beam.items():
            setattr(survey, name, arrays[name].ctypes.data if name in arrays else value)

    assert image(library, echoes, grid, 1e-3, change=change) == 1


def test_speeds_and_windows(library):
    """As Echoes have them; of callers whose struct ends before them all pings have c, and all was recorded."""
    echoes = straight(12)
    windows = np.tile([40, echoes.n_sample - 200], (12, 1))
    windows[5] = 300, 299
    own = echoes.replace(c=1500.0 + 8 * np.sin(np.arange(12.0)), valid=windows)
    assert np.array_equal(image(library, own, PLANE, 1e-3), pysas.backproject(own, PLANE, 1e-3, backend="cpp").data)

    def older(survey, lines, options):
        survey.struct_size = Survey.ping_c.offset

    assert np.array_equal(image(library, own.replace(c=1500.0), PLANE, 1e-3, change=older), image(library, echoes, PLANE, 1e-3))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ping_c", [0.0]),
        ("ping_c", [np.nan]),
        ("valid", [-1, 5]),
        ("valid", [7, 5]),
        ("valid", [0, 10**6]),
        ("valid", [10**6, 10**6]),
    ],
)
def test_speeds_and_windows_that_are_none(library, name, values):
    echoes = straight(4)
    given = {"ping_c": np.full(4, 1500.0), "valid": np.tile(np.array([0, echoes.n_sample - 1]), (4, 1))}[name]
    given[2] = values if name == "valid" else values[0]
    assert image(library, echoes, PLANE, 1e-3, change=lambda s, g, o: setattr(s, name, given.ctypes.data)) == 1


def test_options_of_older_callers(library):
    """The first options ended before the method: what lies behind them in memory is not looked at."""
    make, grid = CASES["straight"]
    echoes = make()
    direct = image(library, echoes, grid, 1e-3)

    def older(survey, lines, options):
        options.struct_size = Options.method.offset
        options.method = 12345

    shares = []
    assert np.array_equal(image(library, echoes, grid, 1e-3, change=older, shares=shares), direct) and shares == [0]
    for size in (0, Options.method.offset - 8, Options.method.offset + 4, ctypes.sizeof(Options) + 8):
        assert image(library, echoes, grid, 1e-3, change=lambda s, g, o, n=size: setattr(o, "struct_size", n)) == 6


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("make", [straight, far])
def test_the_example(tmp_path, make):
    echoes = make()
    grid = SCENES["far"][1] if make is far else PLANE
    program = tmp_path / "image"
    library = pysas.get_library()
    command = [
        "cc",
        str(EXAMPLE),
        f"-I{pysas.get_include()}",
        library,
        f"-Wl,-rpath,{Path(library).parent}",
        "-o",
        str(program),
    ]
    subprocess.run([*command, "-Wall", "-Wextra", "-Werror", "-Wno-missing-field-initializers"], check=True)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    raw, out = tmp_path / "raw", tmp_path / "out"
    raw.write_bytes(single.data.tobytes() + echoes.tx.tobytes() + echoes.receivers.tobytes())
    x, y = grid.axes["x"], grid.axes["y"]
    numbers = [
        *echoes.data.shape,
        echoes.fs,
        echoes.fc,
        echoes.c,
        echoes.start_time[0],
        x.size,
        y.size,
        x[0],
        y[0],
        x[1] - x[0],
    ]
    subprocess.run(
        [str(program), str(raw), str(out), *(repr(float(v)) if v != int(v) else str(int(v)) for v in numbers)], check=True
    )
    found = np.frombuffer(out.read_bytes(), np.complex64).reshape(grid.shape)
    pixels = np.arange(0, grid.size, 13)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3
    assert subprocess.run([str(program)], capture_output=True).returncode == 2
