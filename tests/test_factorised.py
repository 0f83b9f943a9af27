"""Fast factorised back-projection keeps tol, on every track, and says what it did not factorise.

Answers are those of pysas.reference.exact on sampled pixels; echoes are random, so that every sample matters.
"""

import subprocess
import sys
import textwrap

import answers
import numpy as np
import pytest
from scenes import SCENES, bright, moving, straight, survey
from test_tolerance import engines

import pysas
from pysas.engine import tree

BACKENDS = sorted({backend for backend, _ in engines()})


@pytest.fixture(params=engines(), ids=lambda engine: engine[1] or engine[0])
def engine(request, monkeypatch):
    """A backend, its instruction set forced, that runs whatever names none."""
    backend, isa = request.param
    monkeypatch.setenv("PYSAS_BACKEND", backend)
    if isa is not None:
        monkeypatch.setenv("PYSAS_ISA", isa)
    return backend


@pytest.fixture(params=BACKENDS)
def backend(request, monkeypatch):
    """A backend that runs whatever names none."""
    monkeypatch.setenv("PYSAS_BACKEND", request.param)
    return request.param


SETS = [isa for name, isa in engines() if name == "cpp"] or ["not built"]


@pytest.fixture(params=[pytest.param(isa, marks=pytest.mark.cpp) for isa in SETS])
def compiled(request, monkeypatch):
    """C++ on an instruction set."""
    monkeypatch.setenv("PYSAS_BACKEND", "cpp")
    monkeypatch.setenv("PYSAS_ISA", request.param)


def single(echoes):
    return echoes.replace(data=echoes.data.astype(np.complex64))


def plane(pixels, lines, near, step=0.02):
    axis = np.arange(pixels) * step
    return pysas.Grid.plane(axis - axis.mean(), near + np.arange(lines) * step)


def answer(echoes, grid, weights=None, count=300):
    """Some pixels, the oracle's image there, and its level."""
    wanted = np.arange(grid.size) if grid.mask is None else np.flatnonzero(grid.mask)
    pixels = np.random.default_rng(5).choice(wanted, min(count, wanted.size), replace=False)
    return pixels, *answers.exact(echoes, grid, pixels, weights)


def error(image, echoes, grid, weights=None, count=300, right=None):
    pixels, exact, level = answer(echoes, grid, weights, count) if right is None else right
    return pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level)


def long_record(make, **more):
    """A scene whose records reach well beyond what the grids here ask for."""
    return single(make(samples=1400, **more))


def circle(pings):
    """A closed circle of 20 m radius whose records reach from 10 to 36 m."""
    tx = pysas.tracks.circular(pings, 20.0, height=4.0).position
    return single(survey(tx, tx[:, None].copy(), 10.0, samples=1400))


CASES = {
    "straight": (lambda: long_record(straight, pings=256), plane(192, 160, 24.0)),
    "prime number of pings": (lambda: long_record(straight, pings=251), plane(150, 130, 24.0)),
    "moving, 6 receivers": (lambda: long_record(moving, pings=48), plane(192, 160, 24.0)),
    "circular": (lambda: circle(400), plane(150, 150, -1.5)),
    "polar grid": (
        lambda: long_record(moving, pings=48),
        pysas.Grid.polar(24.0 + np.arange(180) * 0.02, np.pi / 2 + np.arange(-90, 91) * 0.001),
    ),
    "volume": (
        lambda: long_record(straight, pings=128),
        pysas.Grid.volume(np.arange(-64, 65) * 0.02, 26 + np.arange(96) * 0.02, np.array([-0.5, 0.0, 0.7])),
    ),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    make, grid = CASES[request.param]
    echoes = make()
    return echoes, grid, answer(echoes, grid)


@pytest.mark.parametrize("tol", [1e-1, 1e-3, 3e-5])
def test_keeps_tol_through_the_tree_alone(case, tol, engine):
    echoes, grid, right = case
    image = pysas.ffbp(echoes, grid, tol, fallback=False)
    assert image.report.factorised_share == 1 and image.report.method == "ffbp" and image.report.backend == engine
    assert image.report.predicted_error <= tol
    assert error(image, echoes, grid, right=right) <= tol


@pytest.mark.slow
@pytest.mark.parametrize("tol", [10 ** -(1 + i / 8) for i in range(28)] + [3e-5])
def test_keeps_every_tol_through_the_tree_alone(case, tol, engine):
    """Eight tolerances a decade."""
    echoes, grid, right = case
    image = pysas.ffbp(echoes, grid, tol, fallback=False)
    assert image.report.factorised_share == 1
    assert error(image, echoes, grid, right=right) <= tol


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tol", [1e-1, 1e-3, 1e-5])
def test_keeps_tol_on_the_scenes_of_the_sweep(name, tol, backend):
    make, grid = SCENES[name]
    echoes = single(make())
    image = pysas.ffbp(echoes, grid, tol)
    assert error(image, echoes, grid, count=150) <= tol


def test_beside_a_bright_point(backend):
    """Sidelobes of a point 60 dB above all else live at the edge of the band, where interpolation is worst."""
    echoes = single(bright(256))
    grid = plane(160, 100, 22.0)
    for tol in (1e-2, 1e-3, 1e-4):
        image = pysas.ffbp(echoes, grid, tol, fallback=False)
        assert error(image, echoes, grid) <= tol


def tracked(position, near=18.0, **more):
    return single(survey(position, position[:, None].copy(), near, samples=1600, **more))


def line(x, y=0.0, z=5.0):
    return np.stack([x, np.full(x.size, y), np.full(x.size, z)], axis=1)


TRACKS = {
    "gap": line(np.concatenate([np.arange(100) * 0.03, 5 + np.arange(90) * 0.03]) - 3.5),
    "reversing": line(np.concatenate([np.arange(100) * 0.03, 3 - np.arange(100) * 0.031]) - 1.5),
    "repeated pings": line(np.repeat(np.arange(60) * 0.04, 3) - 1.2),
    "one place": line(np.zeros(40)),
    "one ping": line(np.zeros(1)),
    "uneven": line(np.sort(np.random.default_rng(3).uniform(-3, 3, 180))),
    "swaying by a metre": line(np.arange(200) * 0.03 - 3) + np.sin(np.arange(200) / 15)[:, None] * [0, 0.5, 0.3],
}


@pytest.mark.parametrize("name", TRACKS)
def test_tracks_that_break_the_toy(name, backend):
    echoes, grid = tracked(TRACKS[name]), plane(130, 100, 26.0)
    right = answer(echoes, grid)
    for tol in (1e-2, 1e-4):
        image = pysas.ffbp(echoes, grid, tol, fallback=False)
        assert image.report.factorised_share == 1
        assert error(image, echoes, grid, right=right) <= tol


PLACES = {
    "under the track": (line(np.arange(160) * 0.03 - 2.4), plane(140, 200, -2.0), 1.0),
    "pixels on the track": (line(np.arange(160) * 0.03 - 2.4, z=0.0), plane(140, 120, -1.2), 0.0),
    "behind the track": (line(np.arange(160) * 0.03), plane(160, 120, 20.0, 0.03), 10.0),
    "range shorter than the aperture": (line(np.arange(256) * 0.04 - 5), plane(150, 130, 4.0), 2.0),
    "both sides": (line(np.arange(160) * 0.03 - 2.4), plane(70, 700, -28.0, 0.08), 1.0),
    "300:1 swath": (line(np.arange(128) * 0.03 - 1.9, z=2.0), plane(40, 1500, 0.1, 0.02), 0.1),
}


@pytest.mark.parametrize("name", PLACES)
def test_any_place_of_the_image(name, backend, monkeypatch):
    """Through trees as far as any place allows, whether they pay or not."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    position, grid, near = PLACES[name]
    echoes = tracked(position, near)
    right = answer(echoes, grid, count=500)
    for tol in (1e-2, 1e-4):
        assert error(pysas.ffbp(echoes, grid, tol), echoes, grid, right=right) <= tol


def rows(shift_x, shift_y):
    """Lines of 130 pixels in any order or along any curve."""
    x, y = (np.arange(130) - 65) * 0.02 + shift_x[:, None], (26.0 + shift_y)[:, None]
    return pysas.Grid.points(np.stack(np.broadcast_arrays(x, y, 0.0), axis=-1))


N = np.arange(100)
SHUFFLED = np.random.default_rng(0).permutation(N) * 0.02
ORDERS = {
    "lines in any order": pysas.Grid.plane((np.arange(130) - 65) * 0.02, 26.0 + SHUFFLED),
    "rows in any order": rows(np.zeros(100), SHUFFLED),
    "rows that sway": rows(0.5 * np.sin(N / 5), N * 0.02),
    "rows there and back": rows(np.zeros(100), 0.5 * np.sin(N / 5)),
    "rays far apart": pysas.Grid.polar(24.0 + np.arange(130) * 0.02, np.pi / 2 + np.arange(-30, 30) * 0.005),
}


@pytest.mark.parametrize("name", ORDERS)
def test_lines_may_lie_in_any_order(name, backend, monkeypatch):
    """Tiles hold all of their lines, not what lies between the first and the last."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    echoes, grid = tracked(line(np.arange(160) * 0.03 - 2.4), near=20.0), ORDERS[name]
    image = pysas.ffbp(echoes, grid, 1e-3)
    assert image.report.factorised_share > 0.6
    assert error(image, echoes, grid, count=500) <= 1e-3
    assert error(pysas.backproject(echoes, grid, 1e-3), echoes, grid, count=500) <= 1e-3


def test_stiff_ratios(backend):
    """Range over wavelength of 1e6, and a band wider than half the carrier (Q below 2)."""
    far = line(np.arange(128) * 0.3 - 19, z=50.0)
    echoes = single(survey(far, far[:, None].copy(), 1495.0, fc=1e6, samples=900))
    grid = plane(96, 96, 1500.0, 0.02)
    assert error(pysas.ffbp(echoes, grid, 1e-3), echoes, grid) <= 1e-3
    echoes = tracked(line(np.arange(200) * 0.03 - 3), fc=18e3, bandwidth=30e3)
    grid = plane(130, 100, 26.0)
    for tol in (1e-2, 1e-4):
        assert error(pysas.ffbp(echoes, grid, tol, fallback=False), echoes, grid) <= tol


def test_options_weights_mask_beam_and_missing_traces(backend):
    echoes, grid = CASES["moving, 6 receivers"][0](), CASES["moving, 6 receivers"][1]
    rng = np.random.default_rng(4)
    weights = rng.standard_normal((48, 6)) + 1j * rng.standard_normal((48, 6))
    weights[3] = 0
    mask = np.zeros(grid.shape, bool)
    mask[20:90, 30:170] = rng.random((70, 140)) < 0.5
    masked = pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask)
    image = pysas.ffbp(echoes, masked, 1e-3, weights=weights, fallback=False)
    assert error(image, echoes, masked, weights) <= 1e-3 and not image.data[~mask].any()
    beam = echoes.replace(beam=pysas.Beam([0.0, 1.0, -0.25], 0.05, np.radians(9.0)))
    assert error(pysas.ffbp(beam, grid, 1e-3), beam, grid) <= 1e-3
    data = echoes.data.copy()
    data[5, 2, 100] = np.nan
    image = pysas.plan(echoes, grid, 1e-3, "ffbp", nan="mask", fallback=False)(data)
    data[5, 2] = 0
    assert error(image, echoes.replace(data=data), grid) <= 1e-3


def test_any_number_of_threads_gives_the_same_bits(backend):
    echoes, grid = CASES["moving, 6 receivers"][0](), CASES["moving, 6 receivers"][1]
    one = pysas.ffbp(echoes, grid, 1e-3, fallback=False, threads=1).data
    for threads in (2, 3, 7):
        assert np.array_equal(pysas.ffbp(echoes, grid, 1e-3, fallback=False, threads=threads).data, one)


def test_a_plan_shows_its_tree_and_images_other_data(backend):
    echoes, grid = CASES["straight"][0](), CASES["straight"][1]
    plan = pysas.plan(echoes, grid, 1e-3, "ffbp", fallback=False)
    text = str(plan)
    for word in ("ffbp of", "groups of at most", "level 0", "traces each", "taps", "factorised     100.0 %", "predicted"):
        assert word in text
    other = single(straight(pings=256, samples=1400, seed=8))
    assert error(plan(other.data), other, grid) <= 1e-3


X, Y = (np.arange(120) - 60) * 0.02, 24 + np.arange(96) * 0.02
HILLS = np.sin(X / 0.4) * np.cos(Y[:, None] / 0.5)
RELIEFS = {
    "rough": pysas.Grid.surface(X, Y, 0.3 * HILLS),
    "high": pysas.Grid.surface(X, Y, 2.0 * np.sin(X / 5) * np.cos(Y[:, None] / 4)),
    "tilted lines": pysas.Grid.points(np.stack(np.broadcast_arrays(X, Y[:, None], 0.2 * X + 0.1 * Y[:, None] - 3), axis=-1)),
    "masked": pysas.Grid.surface(X, Y, 0.3 * HILLS, mask=HILLS > 0.2),
    "list of points": pysas.Grid.points(
        np.array([0, 24, 0]) + np.random.default_rng(1).uniform([-1, 0, -0.3], [1, 2, 0.3], (3000, 3))
    ),
}


@pytest.mark.parametrize("name", RELIEFS)
@pytest.mark.parametrize("tol", [1e-3])
def test_relief_is_read_from_a_stack_of_planes(name, tol, compiled):
    """Pixels on no plane, over a swaying array: each at its own height."""
    echoes, grid = CASES["moving, 6 receivers"][0](), RELIEFS[name]
    image = pysas.ffbp(echoes, grid, tol, fallback=False)
    assert image.report.factorised_share == 1 and image.report.predicted_error <= tol
    assert error(image, echoes, grid) <= tol


def test_a_straight_track_needs_one_plane_for_any_relief(compiled):
    """From a line, all that has one range and one place along it looks alike: mathematics, not interpolation."""
    echoes, grid = CASES["straight"][0](), RELIEFS["high"]
    plan = pysas.plan(echoes, grid, 1e-4, "ffbp", fallback=False)
    assert "planes" not in str(plan)
    assert error(plan(echoes.data), echoes, grid) <= 1e-4


@pytest.mark.parametrize("column", [True, False])
def test_relief_beside_a_transmitter_and_a_receiver_on_opposite_sides(column, compiled):
    """Their phase centres lie on a line, but what they lie off it counts in second order; columns have no step."""
    track = line(np.arange(23) * 0.08 - 0.9)
    echoes = single(survey(track, (track + [0.05, 0.54, 0.78])[:, None], 22.0, samples=1600))
    y = 24 + np.linspace(-1.9, 1.9, 177)
    grid = pysas.Grid.surface((np.arange(40) - 20) * 0.02, y[::4], np.tile(0.3 * (y[::4, None] - 24) - 10.5, 40))
    if column:
        grid = pysas.Grid.points(np.stack([9 + 0 * y, y, 0.3 * (y - 24) - 10.5], axis=-1)[:, None])
    image = pysas.ffbp(echoes, grid, 1e-3, fallback=False)
    assert error(image, echoes, grid) <= 1e-3


@pytest.mark.parametrize("name", RELIEFS)
def test_relief_is_summed_directly_where_an_engine_has_no_trees_for_it(name, monkeypatch):
    monkeypatch.setenv("PYSAS_BACKEND", "numba")
    echoes, grid = CASES["moving, 6 receivers"][0](), RELIEFS[name]
    image = pysas.ffbp(echoes, grid, 1e-3)
    assert image.report.notes == ("summed directly: relief or points: pixels on no even lines of level planes",)
    assert image.report.factorised_share == 0 and error(image, echoes, grid) <= 1e-3
    with pytest.raises(ValueError, match="expected all terms to go through the tree, found: relief or points"):
        pysas.ffbp(echoes, grid, 1e-3, fallback=False)


@pytest.mark.cpp
def test_relief_of_which_some_lies_under_the_track_is_summed_directly(monkeypatch):
    """By one instruction set, as these trees take seconds to plan: tiles of both kinds are summed by each of them below."""
    monkeypatch.setenv("PYSAS_BACKEND", "cpp")
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    echoes = tracked(line(np.arange(256) * 0.03 - 3.8), 4.0)
    y = np.arange(-20, 350) * 0.05
    grid = pysas.Grid.surface((np.arange(64) - 32) * 0.02, y, 0.1 * np.sin(y[:, None] / 0.3) * np.ones(64))
    image = pysas.ffbp(echoes, grid, 1e-3)
    assert 0.2 < image.report.factorised_share < 1
    assert error(image, echoes, grid, count=600) <= 1e-3


def test_relief_of_any_width_is_summed_once(compiled, monkeypatch):
    """Tiles read from trees beside tiles summed directly, in blocks of points that run on from line to line."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    make, grid = SCENES["surface"]
    echoes = single(make())
    image = pysas.ffbp(echoes, grid, 1e-3)
    assert grid.shape[1] % 64 and 0.2 < image.report.factorised_share < 0.9
    assert image.report.terms == echoes.n_ping * echoes.n_channel * grid.size
    assert error(image, echoes, grid) <= 1e-3


def test_says_why_it_sums_directly(backend):
    with pytest.raises(ValueError, match="tol below 3e-05"):
        pysas.ffbp(long_record(straight), plane(64, 64, 24.0), 1e-5, fallback=False)
    with pytest.raises(ValueError, match="near the track|far enough from all groups"):
        pysas.ffbp(tracked(PLACES["under the track"][0], 1.0), PLACES["under the track"][1], 1e-3, fallback=False)
    assert "a tree would take longer" in pysas.ffbp(single(straight(8)), plane(32, 32, 24.0), 1e-3).report.notes[-1]


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_linear_and_blind_to_scale(dtype, backend):
    echoes, grid = CASES["straight"][0](), CASES["straight"][1]
    echoes = echoes.replace(data=echoes.data.astype(dtype))
    plan = pysas.plan(echoes, grid, 1e-3, "ffbp", fallback=False)
    a = plan(echoes.data).data
    assert a.dtype == dtype
    b = plan(echoes.data * dtype(2.0**-90)).data
    assert np.array_equal(b * dtype(2.0**90), a)


@pytest.mark.parametrize("width", tree.WIDTHS)
def test_taps_are_as_good_as_they_say(width):
    """A component's samples, filtered, then read between nodes, in float64: another way than the design's least squares."""
    rng = np.random.default_rng(width)
    taps = tree.taps(width, 1.5, 8)
    n = np.arange(200)
    worst = 0.0
    for f in np.linspace(0, 0.5 / 1.5, 30):
        samples = np.exp(2j * np.pi * f * n)
        filter = np.concatenate([taps.filter[:0:-1], taps.filter]).astype(float)
        even = np.convolve(samples, filter, mode="same")
        for place in 100 + rng.random(20):
            k = int(place)
            x = place - k - 0.5
            weight = np.array([np.polynomial.polynomial.polyval(x, taps.tap[:, t].astype(float)) for t in range(width)])
            value = weight @ even[k - width // 2 + 1 : k + width // 2 + 1]
            worst = max(worst, abs(value - np.exp(2j * np.pi * f * place)))
    assert 0.5 * taps.worst <= worst <= 1.1 * taps.worst + 2e-6


def test_memory_stays_within_the_promise_and_the_estimate(backend):
    """Peak resident memory: less than three times input and output together, and what the plan predicts."""
    code = """
        import resource, numpy as np, pysas
        rng = np.random.default_rng(0)
        n = 1536
        tx = np.zeros((n, 3)); tx[:, 0] = (np.arange(n) - n / 2) * 0.02
        data = rng.standard_normal((n, 3000, 2), dtype=np.float32).view(np.complex64)[..., 0]
        echoes = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=tx, t0=0.026, bandwidth=30e3)
        small = pysas.Grid.plane(np.arange(70) * 0.02, 30 + np.arange(40) * 0.02)
        pysas.ffbp(echoes, small, 1e-3, fallback=False, threads=2)
        grid = pysas.Grid.plane((np.arange(1536) - 768) * 0.02, 30 + np.arange(1536) * 0.02)
        plan = pysas.plan(echoes, grid, 1e-3, "ffbp", threads=2)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        image = plan(data)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
        print(grown, plan.predicted_memory, data.nbytes, image.data.nbytes, image.report.factorised_share)
    """
    run = [sys.executable, "-c", textwrap.dedent(code)]
    result = subprocess.run(run, capture_output=True, text=True, timeout=100, check=True)
    *numbers, share = result.stdout.split()
    grown, predicted, data, image = (int(v) for v in numbers)
    assert float(share) > 0.9
    assert data + grown <= 3 * (data + image)
    assert grown <= 1.3 * predicted + 16 * 2**20
