"""Fans, cones and tapers: what they weigh, what they have in common with no beam and a hard edge, and who else applies them."""

import functools

import answers
import numpy as np
import pytest
from scenes import PLANE, C, moving, ring, straight

import pysas
from pysas.reference.stripmap import beam_middle, prepare

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
RNG = np.random.default_rng(21)
YAWING = np.array([0.0, 1.0, -0.25]) + 0.04 * RNG.standard_normal((16, 3))
ASKEW = np.array([1.0, 0.3, 0.1]) + 0.04 * RNG.standard_normal((16, 3))
DOWN = [0.0, 1.0, -0.25]  # the scene lies 5 m below and 19 to 20 m away
BEAMS = {
    "fan": pysas.Beam(DOWN, 0.1, 0.05),
    "fan, narrow taper": pysas.Beam(DOWN, 0.1, 0.06, taper=0.02),
    "fan, yawing": pysas.Beam(YAWING, 0.1, 0.08, taper=0.5),
    "fan, axis askew": pysas.Beam(YAWING[0], 0.1, 0.25, axis=[1.0, 0.3, 0.1]),
    "fan, all askew": pysas.Beam(YAWING, 0.1, 0.4, taper=1.0, axis=ASKEW),
    "fan, all taper": pysas.Beam(DOWN, 0.1, np.pi / 2, taper=1.0),
    "fan, its side ends in the image": pysas.Beam([1.0, 0.0, 0.0], 0.1, np.pi / 2, axis=[0.1, 1.0, 0.2]),
    "cone": pysas.Beam(DOWN, 0.1, 0.05, "cone"),
    "cone, taper": pysas.Beam(YAWING, 0.1, 0.06, "cone", 0.6),
    "cone, beyond a right angle": pysas.Beam([0.0, 0.0, 1.0], 0.1, 2.0, "cone", 0.3),
}


def alpha(beam, echoes, points):
    """(point, ping) angles off a beam's middle from cosines, infinite on a fan's other side: as the docstring has it."""
    away = points[:, None] - echoes.tx
    away = away / np.linalg.norm(away, axis=2, keepdims=True)
    look = beam.boresight / np.linalg.norm(beam.boresight, axis=-1, keepdims=True)
    if beam.shape == "cone":
        return np.arccos(np.sum(away * look, axis=2))
    axis = np.cross(look, [0, 0, 1]) if beam.axis is None else beam.axis
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    off = np.abs(np.pi / 2 - np.arccos(np.sum(away * axis, axis=2)))
    return np.where(np.sum(away * look, axis=2) >= -1e-7, off, np.inf)  # pixels abeam of a ping are on its side


def weight(beam, angle):
    """What a term weighs at an angle off the beam's middle."""
    full = (1 - beam.taper) * beam.half_angle
    x = np.clip((angle - full) / (beam.half_angle - full), 0, 1) if beam.taper > 0 else 0.0
    return np.where(angle <= beam.half_angle, np.cos(np.pi / 2 * x) ** 2, 0.0)


def hushed(echoes):
    """Records that begin and end softly: what W leaves out of a hard end the package's plain sum does not."""
    ends = np.clip(np.minimum(np.arange(900), np.arange(900)[::-1]) / 60, 0, 1)
    return echoes.replace(data=echoes.data * np.sin(np.pi / 2 * ends) ** 2)


@pytest.fixture(params=BEAMS)
def beam(request):
    return BEAMS[request.param]


@functools.cache
def of_pings(engine):
    """(ping, pixel) images of single pings without a beam."""
    echoes, ping = moving(), np.eye(16)
    return [pysas.backproject(echoes, PLANE, 1e-7, weights=only, backend=engine).data.ravel() for only in ping]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sum_has_each_pings_image_by_its_weight(engine, beam):
    """An image is linear: each ping's own, times what its beam weighs at every pixel. Terms are those within the half-angle."""
    echoes = moving().replace(beam=beam)
    angle = alpha(beam, echoes, PLANE.coordinates())
    weights = weight(beam, angle)
    expected = np.sum(weights.T * of_pings(engine), axis=0)
    # samples have a mean square of 1
    level = np.sqrt(np.sum(weights**2) * echoes.n_channel)
    for tol in (1e-4, 1e-7):  # with polynomials of delays and, on Numba, without
        image = pysas.backproject(echoes, PLANE, tol, backend=engine)
        assert np.linalg.norm(image.data.ravel() - expected) < (1.1 * tol + 2e-7) * level
        # of a tile's last blocks pixels may count in part
        assert image.report.terms == pytest.approx(np.count_nonzero(angle <= beam.half_angle) * echoes.n_channel, rel=1e-3)
        assert image.report.terms > 0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_beams_image_keeps_tol(engine, beam):
    echoes = moving().replace(beam=beam)
    pixels = np.arange(0, PLANE.size, 31)
    exact, level = answers.exact(echoes, PLANE, pixels)
    for tol in (1e-2, 1e-4, 1e-8):
        image = pysas.backproject(echoes, PLANE, tol, backend=engine)
        assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= tol


def test_circular_sums_weigh_alike(beam):
    """The package's plain sum has its own delays, interpolation and angles."""
    echoes = hushed(moving()).replace(beam=beam)
    pixels = np.arange(0, PLANE.size, 31)
    exact, level = answers.exact(echoes, PLANE, pixels)
    found = pysas.circular.weighted_sum(echoes, PLANE, pixels=pixels)
    assert pysas.metrics.relative_error(found, exact, level) < 1e-5  # a little of soft ends lies where W falls


@pytest.mark.parametrize("engine", ENGINES)
def test_weights_uniform_in_view_angle_go_by_the_half_angle(engine, beam):
    """Arcs of lit views have mean 1, whatever a taper leaves of them; the taper weighs terms beside them."""
    echoes, few = hushed(moving()).replace(beam=beam), pysas.Grid.plane(PLANE.axes["x"][::5], PLANE.axes["y"][::6])
    weights = pysas.circular.view_weights(echoes, few)
    lit = alpha(beam, echoes, few.coordinates()) <= beam.half_angle
    np.testing.assert_array_equal(weights.any(axis=2), lit)
    np.testing.assert_allclose(weights.sum(axis=(1, 2)), lit.sum(axis=1) * echoes.n_channel, rtol=1e-12)
    expected = pysas.circular.weighted_sum(echoes, few, weights).ravel()
    _, level = answers.exact(echoes, few)
    image = pysas.backproject(echoes, few, 1e-3, weights="uniform-angle", backend=engine)
    assert np.linalg.norm(image.data.ravel() - expected) < 1e-3 * max(np.linalg.norm(level), np.linalg.norm(expected))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("axis", [None, [1.0, 0.4, 0.2]])
def test_a_fan_of_a_right_angle_is_half_of_no_beam(engine, axis):
    """Of pixels on both sides of a track; those before boresight as without a beam, the others dark."""
    echoes = straight().replace(t0=0.0)
    grid = pysas.Grid.plane(np.arange(-40, 41) * 0.05, np.arange(-60, 60) * 0.1 + 0.033)
    plain = pysas.backproject(echoes, grid, 1e-7, backend=engine).data
    image = pysas.backproject(echoes.replace(beam=pysas.Beam([0, 1, 0], 0.1, np.pi / 2, axis=axis)), grid, 1e-7, backend=engine)
    ahead = grid.axes["y"] > 0
    assert not image.data[~ahead].any()
    assert np.linalg.norm((image.data - plain)[ahead]) < 1e-6 * np.linalg.norm(plain[ahead])
    assert image.report.terms == pytest.approx(image.data.size / 2 * 64, rel=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("shape", ["fan", "cone"])
@pytest.mark.parametrize("half", [0.3, 1.2])
def test_the_narrowest_taper_is_a_hard_edge_but_near_it(engine, shape, half):
    echoes = moving(16, 2).replace(t0=0.0)
    rng = np.random.default_rng(3)
    points = echoes.tx.mean(axis=0) + rng.standard_normal((150, 3)) * [5, 5, 2]
    hard, soft = (pysas.Beam(YAWING, 0.1, half, shape, taper) for taper in (0.0, 1.01e-5 / half))
    points = points[np.all(np.abs(alpha(hard, echoes, points) - half) > 2e-5, axis=1)]
    grid = pysas.Grid.points(points)
    images = [pysas.backproject(echoes.replace(beam=beam), grid, 1e-8, backend=engine) for beam in (hard, soft)]
    assert images[0].report.terms == images[1].report.terms > 0
    np.testing.assert_allclose(images[0].data, images[1].data, rtol=0, atol=1e-7 * np.abs(images[0].data).max())


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("shape", ["fan", "cone"])
def test_a_beam_that_weighs_all_by_1_costs_nothing(engine, shape):
    """What lies within the flat part of every ping's beam is imaged as without one, bit for bit; what is on a taper not."""
    echoes = straight(16)
    plain = pysas.backproject(echoes, PLANE, backend=engine)
    for taper, all_lit in ((0.0, True), (0.5, True), (0.95, False)):
        lit = echoes.replace(beam=pysas.Beam(DOWN, 0.1, 0.3, shape, taper))
        plan = pysas.plan(lit, PLANE, method="backprojection", backend=engine)
        assert ("it reaches every pixel from every ping" in plan.explain()) == all_lit
        assert np.array_equal(plan(lit.data).data, plain.data) == all_lit


@pytest.mark.parametrize("engine", ENGINES)
def test_bright_samples_that_a_taper_all_but_hides(engine):
    """60 dB above what other pixels read, 30 samples beside it, and read at a weight of 1e-3: the level R is that of both."""
    echoes = straight(32)
    middle, rng = echoes.tx.mean(axis=0), np.random.default_rng(0)
    points = []
    for slant, angle, count in ((20.0, 0.0, 150), (20.6, 0.294, 50)):
        r = slant + 0.05 * rng.random(count)
        points.append(middle + np.stack([r * np.sin(angle), np.sqrt((r * np.cos(angle)) ** 2 - 25), 0 * r - 5], axis=1))
    grid = pysas.Grid.points(np.concatenate(points))
    ranges = (echoes.start_time[:, None] + np.arange(echoes.n_sample) / echoes.fs) * C / 2
    data = echoes.data * (1 + 1e3 * np.exp(-(((ranges - 20.62) / 0.1) ** 2) / 2))[:, None]
    echoes = echoes.replace(data=data, beam=pysas.Beam([0, 1, 0], 0.06, 0.3, taper=0.5), bandwidth=36e3)
    exact, level = answers.exact(echoes, grid)
    for tol in (1e-3, 1e-5, 1e-7):
        image = pysas.backproject(echoes, grid, tol, backend=engine)
        assert pysas.metrics.relative_error(image.data, exact, level) <= tol


def test_weights_on_a_ring_of_fans():
    """A closed circle whose fans look inwards: axes are tangents, so that sin alpha is a pixel's offset by its distance."""
    echoes = ring()
    look = -echoes.tx * [1.0, 1.0, 0.0]
    beam = pysas.Beam(look, 0.1, 0.02, taper=0.5)
    point = np.array([[0.25, 0.1, 0.0]])
    tangent = np.cross(look / np.linalg.norm(look, axis=1, keepdims=True), [0, 0, 1])
    expected = weight(beam, np.arcsin(np.abs(tangent @ point[0]) / np.linalg.norm(point - echoes.tx, axis=1)))
    assert expected.min() < 0.9 and expected.max() == 1
    # samples of 1 where the point is heard, which W leaves as they are but for 1e-4 of a record's ends, far away
    lit = echoes.replace(data=np.ones_like(echoes.data), beam=beam)
    _, level = answers.exact(lit, pysas.Grid.points(point))
    assert level[0] == pytest.approx(np.sqrt(np.sum(expected**2)), rel=1e-3)


def test_the_middle_of_a_beam():
    """A fan's is the plane across its axis, so that boresight's part along the element says nothing."""
    np.testing.assert_allclose(beam_middle(pysas.Beam([0.3, 1, 0], 0.1, 0.1, "cone")), np.array([0.3, 1, 0]) / np.hypot(0.3, 1))
    np.testing.assert_allclose(beam_middle(pysas.Beam([0.3, 1, 0], 0.1, 0.1)), np.array([0.3, 1, 0]) / np.hypot(0.3, 1))
    np.testing.assert_allclose(beam_middle(pysas.Beam([0.3, 1, 0], 0.1, 0.1, axis=[2, 0, 0])), [0, 1, 0], atol=1e-15)
    each = pysas.Beam([[0.3, 2, 0], [-0.15, 1, 0]], 0.1, 0.1)
    np.testing.assert_allclose(beam_middle(each), [0, 1, 0], atol=1e-15)
    echoes = straight(8)
    for axis, centre in ((None, 4 * np.pi * echoes.fc / C * 0.3 / np.hypot(0.3, 1)), ([1, 0, 0], 0.0)):
        strip = prepare(echoes.replace(beam=pysas.Beam([0.3, 1, 0], 0.1, 0.1, axis=axis)), None)
        assert np.abs(strip.k_u - centre).max() <= np.pi / 0.03 * (1 + 1e-9)


def test_phase_centres_keep_a_beams_shape():
    track = pysas.tracks.straight(12, 0.3, height=5.0)
    rx = pysas.tracks.array(track, 2, 0.15)
    data = np.ones((12, 2, 100), np.complex64)
    common = {"fs": 40e3, "fc": 100e3, "c": C, "t0": 0.02, "bandwidth": 3e4}
    look, axis = np.tile([0.0, 1.0, -0.1], (12, 1)), np.tile([1.0, 0.1, 0.0], (12, 1))
    for beam in (pysas.Beam(look, 0.1, 0.3, taper=0.4, axis=axis), pysas.Beam(look, 0.1, 2.0, "cone", 0.2)):
        found = pysas.reference.phase_centres(pysas.Echoes(data, tx=track.position, rx=rx, beam=beam, **common)).beam
        assert (found.shape, found.half_angle, found.taper, found.length) == (beam.shape, beam.half_angle, beam.taper, 0.1)
        np.testing.assert_allclose(found.boresights, beam.boresights[:1], atol=1e-15)
        if beam.axis is not None:
            np.testing.assert_allclose(found.axes, beam.axes[:1], atol=1e-15)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("taper", [0.0, 0.5, 1.0])
def test_side_lobes_along_the_track_are_those_of_the_taper(engine, taper):
    """Of a track of even steps that sees a point from all of a beam: the transform of its weights over the angle.

    With u = R tan(a) the sum over the track of w(a) exp(2j k (r(u - x) - r(u))) is the integral of
    w(a) exp(2j k x sin(a)) da / cos(a)^2.
    """
    half, slant, band = np.deg2rad(7.5), 30.0, 6e3
    u = np.arange(-5, 5.0001, 0.01)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    start = 2 * slant / 1500 - 100 / 36e3
    delay = 2 * np.hypot(u, slant)[:, None] / 1500
    data = np.sinc(band * (start + np.arange(400) / 36e3 - delay)) * np.exp(-2j * np.pi * 100e3 * delay)
    beam = pysas.Beam([0, 1, 0], 0.1, half, "fan", taper, [1, 0, 0])
    echoes = pysas.Echoes(
        data.astype(np.complex64), fs=36e3, fc=100e3, tx=tx, rx=tx, c=1500, t0=start, bandwidth=band, beam=beam
    )  # fmt: skip
    x = 0.004 * np.arange(-60, 61)
    found = pysas.backproject(echoes, pysas.Grid.plane(x, [slant]), 1e-4, backend=engine).data[0]
    angle = np.linspace(-half, half, 20001)
    beyond = np.clip(np.abs(angle) - (1 - taper) * half, 0, None)
    weight = np.cos(np.pi / 2 * beyond / (taper * half or 1)) ** 2 / np.cos(angle) ** 2
    turns = 4 * np.pi * 100e3 / 1500 * x[:, None] * np.sin(angle)
    theory = np.mean(weight * np.exp(1j * turns), axis=1)
    assert pysas.metrics.pslr(found) == pytest.approx(pysas.metrics.pslr(theory), abs=0.15)
    assert pysas.metrics.irw(found, 0.004) == pytest.approx(pysas.metrics.irw(theory, 0.004), rel=5e-3)
