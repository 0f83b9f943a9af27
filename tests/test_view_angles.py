"""Weights uniform in view angle in the engines, against plain sums with the arcs of `circular.view_weights`, pixel by pixel."""

import functools

import answers
import numpy as np
import pytest
from test_tolerance import engine

import pysas
from pysas import circular
from pysas.engine import engine_of, native
from pysas.engine.traces import BEAM, CONE, FAN, TRACE, record
from pysas.planning import view_angles
from pysas.planning.scene import Scene

UNIFORM = "uniform-angle"
__all__ = ["engine"]  # a fixture: each backend and instruction set


def survey(pings=240, turn=2 * np.pi, channels=1, beam=None, moving=False, dtype=np.complex64, seed=0):
    """Noise heard along an uneven, perhaps open, circle of 20 m about the origin: nothing is smooth from ping to ping."""
    rng = np.random.default_rng(seed)
    angle = turn * (np.arange(pings) + 0.2 * rng.standard_normal(pings)) / pings
    tx = np.stack([20 * np.cos(angle), 20 * np.sin(angle), 5 + 0.1 * rng.standard_normal(pings)], axis=1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    rx = tx[:, None] + ahead[:, None] * 0.05 * (np.arange(channels) - 0.5 * (channels - 1))[:, None]
    samples = 700
    spectrum = rng.standard_normal((pings, channels, samples)) + 1j * rng.standard_normal((pings, channels, samples))
    data = np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(samples)) < 0.5 / 1.3)).astype(dtype)
    if beam is not None:
        beam = pysas.Beam(boresight=-np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), length=0.1, half_angle=beam)
    velocity = 1.5 * ahead if moving else None
    return pysas.Echoes(
        data, fs=26e3, fc=60e3, tx=tx, rx=tx[:, None] if channels == 1 else rx, t0=2 * 7 / 1500, bandwidth=20e3, beam=beam,
        velocity=velocity,
    )  # fmt: skip


PLANE = pysas.Grid.plane(6 + 0.02 * np.arange(130), 4 + 0.02 * np.arange(70))


@answers.remembered
def exact(echoes, grid, number=14):
    """Some pixels, the oracle's sums there with each pixel's own weights, and the level errors are stated by.

    The oracle gives each trace's term at all of the pixels; a sum is linear in its weights.
    """
    pixels = np.sort(np.random.default_rng(1).choice(grid.size, min(number, grid.size), replace=False))
    weights = circular.view_weights(echoes, grid, pixels).reshape(len(pixels), echoes.n_ping, echoes.n_channel)
    points, channels = pysas.Grid.points(grid.coordinates(pixels)), np.eye(echoes.n_channel)
    term = np.array(
        [
            [pysas.reference.exact(echoes[ping : ping + 1], points, weights=one[None])[0] for one in channels]
            for ping in range(echoes.n_ping)
        ]
    )
    weighed = weights * term.transpose(2, 0, 1)
    sums = weighed.sum(axis=(1, 2))
    return pixels, sums, max(np.linalg.norm(sums), np.linalg.norm(weighed))


def error(image, truth):
    pixels, sums, level = truth
    return np.linalg.norm(image.data.ravel()[pixels] - sums) / level


SURVEYS = {
    "uneven circle": {},
    "open, of three receivers": {"turn": 2.5, "channels": 3, "pings": 120},
    "moving receivers": {"channels": 2, "moving": True, "pings": 120},
    "a beam": {"beam": 0.7},
}


@pytest.fixture(scope="module", params=SURVEYS)
def case(request):
    echoes = survey(**SURVEYS[request.param])
    return echoes, exact(echoes, PLANE)


@pytest.mark.parametrize("tol", (1e-2, 1e-3, 1e-4, 1e-5))
def test_engines_keep_tol(case, tol, engine):
    echoes, truth = case
    image = pysas.backproject(echoes, PLANE, tol=tol, weights=UNIFORM, backend=engine)
    assert error(image, truth) < tol
    assert not any("view-angle" in note for note in image.report.notes)


def test_there_is_something_to_weigh(case):
    echoes, truth = case
    assert error(pysas.backproject(echoes, PLANE), truth) > 0.2


@functools.cache
def tree_case():
    """A short arc, far enough for the tree to take all terms."""
    echoes = survey(pings=200, turn=0.25)
    grid = pysas.Grid.plane(-4 + 0.02 * np.arange(130), 1 + 0.02 * np.arange(70))
    return echoes, grid, exact(echoes, grid)


def test_a_tree_weighs_as_well(engine):
    echoes, grid, truth = tree_case()
    for tol in (1e-2, 1e-3):
        image = pysas.ffbp(echoes, grid, tol=tol, fallback=False, weights=UNIFORM, backend=engine)
        assert image.report.factorised_share == 1
        assert error(image, truth) < tol


def test_a_tree_and_direct_sums_weigh_alike(engine, monkeypatch):
    """Some pixels through the tree, those across the record's ends directly, whichever would be faster."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    echoes = survey(pings=200, turn=0.25)
    grid = pysas.Grid.plane(8 + 0.03 * np.arange(160), -1 + 0.05 * np.arange(40))
    image = pysas.ffbp(echoes, grid, tol=1e-2, weights=UNIFORM, backend=engine)
    assert 0.2 < image.report.factorised_share < 0.95
    assert error(image, exact(echoes, grid)) < 1e-2


GRIDS = {
    "points": pysas.Grid.points(np.random.default_rng(2).uniform((-9, -9, -0.5), (9, 9, 0.5), (90, 3))),
    "volume": pysas.Grid.volume(6 + 0.02 * np.arange(40), 4 + 0.02 * np.arange(9), [0.0, 0.5, 1.0, 1.5]),
    "polar": pysas.Grid.polar(2 + 0.05 * np.arange(70), np.linspace(0, 6, 40)),
    "coarse": pysas.Grid.plane(0.3 * np.arange(-30, 30), 0.3 * np.arange(-30, 30)),
    "a pixel": pysas.Grid.plane([6.0], [4.0]),
}


@functools.cache
def grid_case(name):
    echoes = survey(channels=2, pings=80)
    return echoes, exact(echoes, GRIDS[name])


@pytest.mark.parametrize("name", GRIDS)
def test_any_grid(name, engine):
    echoes, truth = grid_case(name)
    image = pysas.backproject(echoes, GRIDS[name], tol=1e-3, weights=UNIFORM, backend=engine)
    assert error(image, truth) < 1e-3


@functools.cache
def double_case():
    echoes = survey(pings=80, dtype=np.complex128)
    return echoes, exact(echoes, PLANE)


def test_float64(engine):
    echoes, truth = double_case()
    image = pysas.backproject(echoes, PLANE, tol=1e-6, weights=UNIFORM, backend=engine)
    assert error(image, truth) < 1e-6


def test_threads_do_not_matter(engine):
    echoes = survey(pings=80)
    images = [pysas.backproject(echoes, PLANE, weights=UNIFORM, backend=engine, threads=n).data for n in (1, 3)]
    np.testing.assert_array_equal(*images)


def positions(angles, radius=10.0):
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.ones_like(angles)], axis=1)


TRACKS = {
    "even": positions(2 * np.pi * np.arange(60) / 60),
    "pinged twice where it closes": positions(np.linspace(0, 2 * np.pi, 61)),
    "every place twice": positions(np.repeat(2 * np.pi * np.arange(30) / 30, 2)),
    "a missing sector": positions(np.delete(2 * np.pi * np.arange(60) / 60, slice(20, 31))),
    "a lone view": positions(np.concatenate([np.linspace(0, 1, 30), [3.0]])),
    "clusters": positions(np.sort(np.random.default_rng(3).uniform(0, 2, 50) ** 2)),
    "a straight line": np.stack([np.linspace(-20, 20, 81), np.full(81, -12.0), np.zeros(81)], axis=1),
    "two": positions(np.array([0.0, 1.0])),
    "one": positions(np.array([0.5])),
}


BACKENDS = ["numba"] + ["cpp"] * (native.extension() is not None)


def arcs_of(tx, rx, points, backend):
    """Arcs by a backend, and by the rule."""
    echoes = pysas.Echoes(
        np.zeros((len(tx), rx.shape[1], 16), np.complex64), fs=1e4, fc=1e5, tx=tx, rx=rx, bandwidth=8e3
    )  # fmt: skip
    grid = pysas.Grid.points(points)
    scene = Scene(echoes, grid, UNIFORM)
    found, patterns = view_angles.arcs(scene, points - scene.origin, 1, engine_of(backend))
    return found, circular.view_weights(echoes, grid).reshape(len(points), -1), patterns


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("channels", (1, 3))
@pytest.mark.parametrize("name", TRACKS)
def test_arcs_are_those_of_the_rule(name, channels, backend):
    """Three programs of one rule: place by place in `circular`, and each engine's."""
    tx = TRACKS[name]
    rx = tx[:, None] + 0.3 * np.arange(channels)[:, None] * [1.0, 0.5, 0.2]
    points = np.random.default_rng(4).uniform((-6, -6, -1), (6, 6, 1), (40, 3))
    found, expected, _ = arcs_of(tx, rx, points, backend)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_point_on_a_transducer_is_not_seen_from_there(backend):
    """No direction, no weight, on the phase centre and straight below it; the others share the circle."""
    tx = TRACKS["even"]
    points = np.concatenate([tx[7:9], tx[7:9] - [0, 0, 2.0]])
    found, expected, patterns = arcs_of(tx, tx[:, None], points, backend)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(found[[0, 1, 2, 3], [7, 8, 7, 8]], 0)
    assert not patterns.any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_rounding_does_not_decide_about_a_gap_of_four(backend):
    """Three pings missing of an even circle, seen from its centre: the gap is four times its neighbours, however it is turned.

    It is no opening: the views at its ends have (4 + 1)/2 spacings, the others 1, and the mean over 57 views is 1.
    """
    turned = np.random.default_rng(5).uniform(0, 2 * np.pi, 40)
    expected = np.full(57, 57 / 60)
    expected[[0, -1]] *= 2.5
    for turn in turned:
        tx = positions(turn + 2 * np.pi * np.arange(57) / 60)
        found, ruled, _ = arcs_of(tx, tx[:, None], np.zeros((1, 3)), backend)
        np.testing.assert_allclose(ruled[0], expected, rtol=1e-9)
        np.testing.assert_allclose(found[0], expected, rtol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_coincident_views_share_an_arc_equally(backend):
    """Pings repeated, exactly or but for rounding, in any order: together they weigh what one of them would."""
    rng = np.random.default_rng(6)
    once = positions(np.sort(rng.uniform(0, 2, 40)))
    times = rng.integers(1, 4, 40)
    order = rng.permutation(np.repeat(np.arange(40), times))
    points = rng.uniform((-3, -3, 0), (3, 3, 0), (10, 3))
    one = arcs_of(once, once[:, None], points, backend)[0]
    shared = (one / times)[:, order]
    for noise in (0.0, 1e-13):
        tx = once[order] + noise * rng.standard_normal((order.size, 3))
        found, expected, _ = arcs_of(tx, tx[:, None], points, backend)
        np.testing.assert_allclose(found, expected, rtol=1e-7)
        np.testing.assert_allclose(found, shared / shared.mean(axis=1, keepdims=True), rtol=1e-7)


def noise_from(tx, grid, channels=1, beam=None, seed=0, dtype=np.complex64):
    """Noise heard by a sonar at `tx` during all travel times to the grid."""
    rng = np.random.default_rng(seed)
    rx = tx[:, None] + [0.04, 0.01, 0.0] * np.arange(channels)[:, None]
    distance = np.linalg.norm(grid.coordinates()[:, None] - tx, axis=-1)
    first, last = 2 * (max(distance.min() - 1, 0)) / 1500, 2 * (distance.max() + 1) / 1500
    samples = int((last - first) * 26e3)
    spectrum = rng.standard_normal((len(tx), channels, samples)) + 1j * rng.standard_normal((len(tx), channels, samples))
    data = np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(samples)) < 0.5 / 1.3)).astype(dtype)
    return pysas.Echoes(data, fs=26e3, fc=60e3, tx=tx, rx=rx, t0=first, bandwidth=20e3, beam=beam)


def line(pings, length, y=0.0):
    return np.stack([np.linspace(-length / 2, length / 2, pings), np.full(pings, y), np.zeros(pings)], axis=1)


def turns(pings, times=1):
    return 2 * np.pi * times * np.arange(pings) / pings


def walk(rng, pings):
    return np.concatenate(
        [np.cumsum(rng.standard_normal((pings, 2)), axis=0) * 0.7, 0.02 * rng.standard_normal((pings, 1))], axis=1
    )


def back(rng, pings):
    return line(pings, 10)[::-1] + rng.normal(0, 0.01, (pings, 3))


CROSSING = {
    "figure eight": lambda rng, n: 8 * np.stack([np.sin(turns(n)), np.sin(2 * turns(n)) / 2, 0 * turns(n)], axis=1),
    "spiral": lambda rng, n: np.linspace(2, 8, n)[:, None] * positions(turns(n, 3), 1.0) - [0, 0, 1],
    "two lines": lambda rng, n: np.concatenate([line(n // 2, 10), line(n // 2, 10, 0.5) + [0.03, 0, 0]]),
    "there and back": lambda rng, n: np.concatenate(
        [line(n // 2, 10), line(n // 2, 10)[::-1] + rng.normal(0, 0.01, (n // 2, 3))]
    ),
    "the same way back": lambda rng, n: np.concatenate([line(n // 2, 10), line(n // 2, 10)[::-1]]),
    "random walk": walk,
    "standing still": lambda rng, n: np.zeros((n, 3)) + rng.choice([0.0, 1e-13, 1e-3]) * rng.standard_normal((n, 3)),
    "pings repeated": lambda rng, n: np.repeat(walk(rng, n // 3), 3, axis=0),
}


@functools.cache
def crossing_case(name, seed):
    """A track of a kind, an image beside it, over it or in line with it, and what it should hold."""
    rng = np.random.default_rng([seed, list(CROSSING).index(name)])
    tx = CROSSING[name](rng, int(rng.integers(20, 50)) * 2)
    channels = int(rng.choice([1, 1, 2]))
    beam = None
    if rng.random() < 0.3:
        half = rng.uniform(0.4, 1.5)
        beam = pysas.Beam([0.0, 1.0, 0.0], 0.1, half, "fan" if half < 1 else "cone", 0.5 if half % 0.2 < 0.1 else 0.0)
    x, y = np.round(rng.uniform((-6, 2), (6, 14)), 1)  # round: pixels lie on tracks and in line with them
    step, width = rng.choice([0.02, 0.05, 0.25]), int(rng.choice([1, 9, 33, 70]))
    grid = pysas.Grid.plane(x + step * np.arange(width), y + step * np.arange(int(rng.choice([1, 12]))))
    if name in ("random walk", "standing still") and rng.random() < 0.5:
        grid = pysas.Grid.points(rng.uniform((-8, -8, -0.5), (8, 8, 0.5), (60, 3)))
    echoes = noise_from(tx, grid, channels, beam, seed)
    return echoes, grid, exact(echoes, grid)


@pytest.mark.filterwarnings("ignore:.*:UserWarning")  # a beam may light nothing
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
@pytest.mark.parametrize("name", CROSSING)
def test_tracks_that_cross_themselves_keep_tol(name, seed, engine):
    echoes, grid, truth = crossing_case(name, seed)
    for tol in (1e-1, 1e-3):
        image = pysas.focus(echoes, grid, tol=tol, weights=UNIFORM, backend=engine, threads=1)
        assert image.report.predicted_error <= tol
        assert truth[2] == 0 or error(image, truth) < tol


@pytest.mark.parametrize(("shape", "taper"), [("fan", 0.0), ("fan", 0.6), ("cone", 0.0), ("cone", 0.6)])
def test_beams_edges_across_the_image(engine, shape, taper):
    """Each view that comes in or goes changes the mean of those that light a pixel."""
    tx = line(120, 30)
    beam = pysas.Beam([0.0, 1.0, 0.0], 0.1, 0.3, shape, taper)
    grid = pysas.Grid.plane(0.05 * np.arange(64), 20 + 0.05 * np.arange(20))
    echoes = noise_from(tx, grid, beam=beam)
    truth = exact(echoes, grid, 40)
    for tol in (1e-1, 1e-2, 1e-3, 1e-4):
        image = pysas.backproject(echoes, grid, tol=tol, weights=UNIFORM, backend=engine)
        assert error(image, truth) < tol and image.report.predicted_error <= tol


@functools.cache
def far_below_case():
    tx = CROSSING["figure eight"](None, 40)
    grid = pysas.Grid.plane(0.05 * np.arange(12), 12 + 0.05 * np.arange(6))
    echoes = noise_from(tx, grid, dtype=np.complex128)
    return echoes, grid, exact(echoes, grid)


def test_float64_keeps_what_no_float32_lattice_could(engine):
    for echoes, grid, truth in ((*double_case()[:1], PLANE, double_case()[1]), far_below_case()):
        image = pysas.backproject(echoes, grid, tol=1e-9, weights=UNIFORM, backend=engine)
        assert error(image, truth) < 1e-9 and image.report.predicted_error <= 1e-9


def test_an_image_across_the_track(engine):
    """No lattice follows weights whose nearest view turns by pi in a pixel."""
    tx = positions(turns(80), 2.0)
    grid = pysas.Grid.plane(0.1 * np.arange(-30, 31), 0.1 * np.arange(-30, 31), mask=np.indices((61, 61)).sum(axis=0) % 3 == 0)
    echoes = noise_from(tx, grid)
    wanted = np.flatnonzero(grid.mask)
    some, *rest = exact(echoes, pysas.Grid.points(grid.coordinates(wanted)), 30)
    truth = wanted[some], *rest
    for method in ("backprojection", "ffbp"):
        plan = pysas.plan(echoes, grid, 1e-4, method, backend=engine, weights=UNIFORM)
        assert "every pixel's own" in str(plan)
        shares = []
        image = plan(echoes.data, progress=shares.append)
        assert not image.data[~grid.mask].any() and shares[-1] == 1 and shares == sorted(shares)
        assert error(image, truth) < 1e-4
        assert image.report.predicted_error <= 1e-4
    with pytest.raises(ValueError, match="views change their order"):
        pysas.ffbp(echoes, grid, fallback=False, weights=UNIFORM, backend=engine)
    images = [pysas.backproject(echoes, grid, weights=UNIFORM, backend=engine, threads=n).data for n in (1, 3)]
    np.testing.assert_array_equal(*images)


def test_pixels_weighed_in_parts(engine, monkeypatch):
    """Weights of all pixels at once may be more than memory should hold."""
    tx = CROSSING["figure eight"](None, 40)
    grid = pysas.Grid.plane(0.05 * np.arange(40), 12 + 0.05 * np.arange(10))
    echoes = noise_from(tx, grid)
    whole = pysas.backproject(echoes, grid, weights=UNIFORM, backend=engine)
    monkeypatch.setattr(view_angles, "BYTES", 1)
    parts = pysas.backproject(echoes, grid, weights=UNIFORM, backend=engine)
    np.testing.assert_allclose(parts.data, whole.data, rtol=1e-6, atol=1e-6 * np.abs(whole.data).max())
    assert parts.report.terms == whole.report.terms


def test_a_wrong_name_is_told():
    echoes = survey(pings=20)
    for call in (pysas.backproject, pysas.ffbp, pysas.plan):
        with pytest.raises(ValueError, match="weights='even': expected an array or 'uniform-angle'"):
            call(echoes, PLANE, weights="even")


def test_a_plan_tells_of_them():
    echoes = survey(pings=40)
    plain, even = pysas.plan(echoes, PLANE), pysas.plan(echoes, PLANE, weights=UNIFORM)
    assert "weights that differ" in plain.explain() and "weights that differ" not in even.explain()
    assert "view angles" in even.explain()
    assert even.predicted_memory - plain.predicted_memory >= even.scene.lattice.value.nbytes
    outside = pysas.Grid.plane([900.0, 901.0], [0.0])
    with pytest.warns(UserWarning, match="outside the recorded window"):
        assert not pysas.backproject(echoes, outside, weights=UNIFORM).data.any()


@pytest.mark.parametrize("shape", [CONE, FAN])
def test_the_narrowest_beams_hold_what_kernels_take(engine, shape):
    """Edges a part in 10^4 from a point, which cosines of 2e-7 rad do not tell apart: of the views lit the mean is 1."""
    rng = np.random.default_rng(3)
    limit = 2e-7
    trace = np.zeros(400, TRACE)
    turn = np.sort(rng.uniform(0, 6, 400))
    towards = -np.stack([np.cos(turn), np.sin(turn), 0.3 + 0 * turn], axis=1) / np.hypot(1, 0.3)
    aside = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    lit = rng.random(400) < 0.5
    angle = limit * np.where(lit, 1 - 1e-4, 1 + 1e-4)
    point = np.array([[1.25, -0.5, 0.75]])
    trace["tx"] = trace["rx"] = point - 8 * towards
    trace["boresight"] = np.cos(angle)[:, None] * towards + np.sin(angle)[:, None] * aside
    trace["axis"] = np.cos(angle)[:, None] * aside - np.sin(angle)[:, None] * towards
    found = np.empty((1, 400))
    beam = record(BEAM, shape=shape, half_angle=limit, full_angle=limit)
    engine_of(engine).arcs(trace, 1, beam, point, np.arange(400), found, 1)
    np.testing.assert_allclose(np.mean(found[0, lit]), 1, rtol=1e-12)
