"""Weights uniform in view angle and the plain sums they serve: against the Jacobian on circles, arcs by hand elsewhere."""

import circular_scenes as scenes
import numpy as np
import pytest
from scenes import moving, survey

import pysas
from pysas import circular

PSF = circular.PointSpread(scenes.PULSE, scenes.C)


def blank(tx, rx=None, **more):
    """Echoes of nothing: geometry alone."""
    rx = tx[:, None] if rx is None else rx
    return pysas.Echoes(np.zeros((*rx.shape[:2], 8), complex), fs=90e3, fc=100e3, tx=tx, rx=rx, c=1500.0, **more)


def at(*points):
    return pysas.Grid.points(np.array(points, dtype=float))


# View angles


def test_monostatic_views_are_azimuths():
    tx = scenes.circle(50, 10.0, height=3.0)
    point = np.array([[2.0, -1.0, 0.5]])
    found = circular.view_angles(tx, tx[:, None], point)[0, :, 0]
    np.testing.assert_allclose(found, np.arctan2(tx[:, 1] + 1, tx[:, 0] - 2), atol=1e-14)


def test_bistatic_views_are_the_direction_in_which_the_range_falls():
    rng = np.random.default_rng(0)
    tx, rx, point = rng.normal(size=(6, 3)), rng.normal(size=(6, 2, 3)), rng.normal(size=(1, 3))
    found = circular.view_angles(tx, rx, point)[0]

    def range_(p):
        return np.linalg.norm(p - tx, axis=-1)[:, None] + np.linalg.norm(p - rx, axis=-1)

    step = 1e-6
    slopes = [(range_(point[0] - step * axis) - range_(point[0] + step * axis)) / (2 * step) for axis in np.eye(3)[:2]]
    np.testing.assert_allclose(found, np.arctan2(slopes[1], slopes[0]), atol=1e-8)


def test_where_there_is_no_view():
    tx = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 2]])
    rx = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 2]])[:, None]
    found = circular.view_angles(tx, rx, np.zeros((1, 3)))[0, :, 0]
    # on the point, beside it, either side of it, above it
    assert np.isnan(found).tolist() == [True, False, True, True]
    weights = circular.view_weights(blank(tx, rx), at([0, 0, 0]))
    np.testing.assert_array_equal(weights[0, :, 0], [0, 1, 0, 0])


# Arcs


def test_arcs_by_hand():
    degrees = np.radians([0.0, 90, 180, 300])
    # gaps 90, 90, 120, 60: half of both neighbours
    np.testing.assert_allclose(circular.arc_weights(degrees), np.array([75, 90, 105, 90]) / 90, rtol=1e-12)
    shuffled = [2, 0, 3, 1]
    np.testing.assert_allclose(
        circular.arc_weights(degrees[shuffled] + 4 * np.pi), np.array([105, 75, 90, 90]) / 90, rtol=1e-12
    )


def test_coincident_views_share():
    degrees = np.radians([-180.0, 0, 90, 180, 0, 270, 0])  # 180 twice, 0 three times
    found = circular.arc_weights(degrees)
    np.testing.assert_allclose(found, 7 / 4 * np.array([1 / 2, 1 / 3, 1, 1 / 2, 1 / 3, 1, 1 / 3]), rtol=1e-9)


def test_ends_of_an_open_track():
    degrees = np.radians([10.0, 11, 12, 14, 16])
    # the ends' arcs are as wide as their inner halves doubled: 1 and 2 degrees
    np.testing.assert_allclose(circular.arc_weights(degrees), np.array([1, 1, 1.5, 2, 2]) / 1.5, rtol=1e-9)


def test_missing_sectors_belong_to_nobody():
    degrees = np.delete(np.arange(0.0, 360), slice(40, 80))
    np.testing.assert_allclose(circular.arc_weights(np.radians(degrees)), 1, rtol=1e-9)
    two = np.delete(np.arange(0.0, 360), np.r_[40:80, 200:210])
    np.testing.assert_allclose(circular.arc_weights(np.radians(two)), 1, rtol=1e-9)
    # a single missed ping is bridged by its neighbours
    missed = circular.arc_weights(np.radians(np.delete(np.arange(0.0, 360), 50)))
    np.testing.assert_allclose(missed[[48, 49, 50, 51]] / missed[0], [1, 1.5, 1.5, 1], rtol=1e-9)


def test_one_two_and_lone_views():
    np.testing.assert_array_equal(circular.arc_weights([1.0]), [1])
    np.testing.assert_array_equal(circular.arc_weights([1.0, 1.0]), [1, 1])
    np.testing.assert_allclose(circular.arc_weights([1.0, 1.1]), [1, 1])
    np.testing.assert_allclose(circular.arc_weights(np.full(5, 2.0)), 1)
    lone = circular.arc_weights(np.radians([*np.arange(10.0), 90, *np.arange(180.0, 190)]))
    np.testing.assert_allclose(lone, 1, rtol=1e-9)


def test_nearly_coincident_views_are_no_opening():
    degrees = np.arange(0.0, 360)
    degrees[100:103] = 100, 100.001, 100.002
    found = circular.arc_weights(np.radians(degrees))
    assert found[[100, 101, 102]].sum() / found[0] == pytest.approx(2, abs=1e-2)
    assert found[103] / found[0] == pytest.approx(2, abs=1e-2)  # 101 and 102 degrees are missing


def test_an_array_with_gaps_between_pings_is_no_open_track():
    degrees = (np.arange(0, 360, 10.0)[:, None] + np.array([0.0, 1, 2])).ravel()
    found = circular.arc_weights(np.radians(degrees), channels=3).reshape(-1, 3)
    np.testing.assert_allclose(found, np.tile([4.5, 1, 4.5], (36, 1)) * 3 / 10, rtol=1e-9)


# On tracks


@pytest.mark.parametrize("a", (0.0, 0.2, 0.5, 0.9))
def test_on_a_circle_they_are_the_jacobian(a):
    tx = scenes.circle(2000, 10.0, height=2.0)
    weights = circular.view_weights(blank(tx), at([0, 10 * a, 0]))[0, :, 0]
    exact = circular.view_rate(np.arctan2(tx[:, 1], tx[:, 0]) - np.pi / 2, a)
    # half the difference of the neighbours' angles: second order in the spacing
    np.testing.assert_allclose(weights, exact, rtol=1e-5 / (1 - a) ** 2)
    assert weights.mean() == pytest.approx(1, rel=1e-14)


@pytest.mark.parametrize("a", (0.99, 1 - 1e-6, 1 - 1e-12))
def test_a_point_all_but_on_the_track(a):
    """The half turn that it makes between the two pings beside it is neither's; the others keep the Jacobian's proportions."""
    tx = scenes.circle(1000, 10.0, start=np.pi / 1000)
    weights = circular.view_weights(blank(tx), at([10 * a, 0, 0]))[0, :, 0]
    assert np.isfinite(weights).all() and (weights > 0).all()
    assert weights.mean() == pytest.approx(1, rel=1e-12)
    far = np.abs(np.arctan2(tx[:, 1], tx[:, 0])) > 1
    exact = circular.view_rate(np.arctan2(tx[:, 1], tx[:, 0]), a)[far]
    np.testing.assert_allclose(weights[far] / exact, np.mean(weights[far] / exact), rtol=1e-3)


@pytest.mark.parametrize("shape", ["fan", "cone"])
def test_beam(shape):
    """In the plane of the circle both are alike."""
    tx = scenes.circle(360, 10.0)
    echoes = blank(tx, beam=pysas.Beam(-tx, 0.1, 0.3, shape, 0.0 if shape == "fan" else 0.5))
    point = np.array([0, 8.0, 0])
    weights = circular.view_weights(echoes, at(point))[0, :, 0]
    to = point - tx
    inside = np.sum(to * -tx, axis=1) >= np.cos(0.3) * np.linalg.norm(to, axis=1) * 10
    assert 50 < inside.sum() < 300
    np.testing.assert_array_equal(weights > 0, inside)
    assert weights[inside].mean() == pytest.approx(1, rel=1e-14)
    # a near and a far arc: within each the Jacobian, at their ends too
    exact = circular.view_rate(np.arctan2(tx[:, 1], tx[:, 0]) - np.pi / 2, 0.8)[inside]
    np.testing.assert_allclose(weights[inside] / exact, np.mean(weights[inside] / exact), rtol=0.03)


def test_mean_is_one_on_any_array():
    echoes = moving()
    grid = pysas.Grid.plane(np.linspace(-1, 1, 5), np.linspace(19, 21, 4))
    weights = circular.view_weights(echoes, grid)
    assert weights.shape == (20, echoes.n_ping, echoes.n_channel)
    np.testing.assert_allclose(weights.mean(axis=(1, 2)), 1, rtol=1e-13)
    assert (weights > 0).all()
    np.testing.assert_array_equal(circular.view_weights(echoes, grid, [7, 3]), weights[[7, 3]])


# Sums


def faded(echoes):
    """With a record that rises from zero and falls to it, so that cutting it short leaves nothing beyond the band."""
    return echoes.replace(data=echoes.data * np.hanning(echoes.n_sample))


def test_plain_sum_is_the_oracles():
    """Moving receivers included; away from the record's ends the sums differ by the interpolation alone."""
    echoes = faded(moving(bandwidth=24e3))
    grid = pysas.Grid.plane(np.linspace(-1, 1, 5), np.linspace(22, 24, 4))
    exact, level = pysas.reference.exact(echoes, grid)
    assert pysas.metrics.relative_error(circular.weighted_sum(echoes, grid), exact, level) < 1e-6
    one = circular.weighted_sum(echoes, grid, np.full((20, echoes.n_ping, echoes.n_channel), 2j))
    np.testing.assert_allclose(one, 2j * circular.weighted_sum(echoes, grid), rtol=1e-12)
    some = circular.weighted_sum(echoes, grid, pixels=[4, 19])
    np.testing.assert_allclose(some, circular.weighted_sum(echoes, grid).ravel()[[4, 19]], rtol=1e-12)


def test_plain_sum_counts_what_the_oracle_counts():
    """A beam, and pixels that some pings' records do not reach."""
    tx = np.stack([np.linspace(-3, 3, 40), np.zeros(40), np.zeros(40)], axis=1)
    beam = pysas.Beam(boresight=(0.0, 1.0, 0.0), length=0.1, half_angle=0.1)
    echoes = faded(survey(tx, tx[:, None], 18.0, samples=300, bandwidth=24e3, beam=beam))
    grid = pysas.Grid.plane(np.linspace(-4, 4, 9), [10.0, 17.9, 18.5, 21.0, 23.3, 30.0])
    exact, level = pysas.reference.exact(echoes, grid)
    found = circular.weighted_sum(echoes, grid)
    np.testing.assert_array_equal(found == 0, exact == 0)
    np.testing.assert_array_equal(found[[0, -1]], 0)
    assert pysas.metrics.relative_error(found[2:4], exact[2:4], level[2:4]) < 1e-6


@pytest.fixture(scope="module")
def off_centre():
    """A point at a = 0.5 of a circle of 1.5 m, as many pings as half a wavelength asks for, and +-2 wavelengths about it."""
    radius, centre = 1.5, (0.0, 0.75)
    tx = scenes.circle(int(4 * np.pi * radius / scenes.WAVE), radius)
    echoes = scenes.echoes(tx, None, [*centre, 0.0], 0.15)
    grid, x = scenes.patch(centre, 2 * scenes.WAVE, 3)
    return echoes, grid, x


def test_resampled_sum_and_weighted_sum_agree(off_centre):
    """Eq 7 with 1/N' against all pings with their arcs, up to the places of the nearest pings."""
    echoes, grid, x = off_centre
    resampled = circular.resampled_sum(echoes, grid) / (2 * np.pi)
    weighted = circular.weighted_sum(echoes, grid, circular.view_weights(echoes, grid)) / echoes.n_ping
    plain = circular.weighted_sum(echoes, grid) / echoes.n_ping
    # views off by up to half a step, evenly: so much phase at the patch's corner, and N' of them average; 3 deviations
    phase = 2 * PSF.k * np.hypot(x[0], x[0]) * (np.pi / echoes.n_ping) / (1 - 0.5)
    assert np.abs(resampled - weighted).max() < 3 * phase / np.sqrt(3) / np.sqrt(echoes.n_ping / 2)
    # the point spread but for the curvature of the wavefront, k r^2/R of phase: 0.5 in the corners, where the image is dim
    exact = PSF.exact(np.hypot(x, x[:, None]))
    assert np.abs(weighted - exact).max() < 1e-2
    # without weights that of its density of views, which is 0.1 away on these pixels
    dense = PSF.image(x, x[:, None], lambda view: circular.view_density(view - np.pi / 2, 0.5))
    assert np.abs(plain - dense).max() < 1e-2
    assert np.abs(plain - weighted).max() == pytest.approx(np.abs(dense.imag).max(), rel=0.05)


def weighted(echoes, grid):
    return circular.weighted_sum(echoes, grid, circular.view_weights(echoes, grid)) / (echoes.n_ping * echoes.n_channel)


RADIUS = 200.0  # k r^2/R of phase at the corners of +-1.5 wavelengths, r = 32 mm: 2e-3


def test_open_circle_off_the_centre():
    """230 degrees seen from a = 0.4: the point spread of the views it has, each as often as the next."""
    tx = scenes.circle(600, RADIUS)[:383]
    centre = (0.0, 0.4 * RADIUS)
    echoes = scenes.echoes(tx, None, [*centre, 0.0], 0.15)
    grid, x = scenes.patch(centre, 1.5 * scenes.WAVE, 6)
    seen = np.unwrap(np.arctan2(tx[:, 1] - centre[1], tx[:, 0]))
    low, high = seen[0] - (seen[1] - seen[0]) / 2, seen[-1] + (seen[-1] - seen[-2]) / 2
    exact = PSF.image(x, x[:, None], lambda view: (np.mod(view - low, 2 * np.pi) < high - low).astype(float))
    found, plain = weighted(echoes, grid), circular.weighted_sum(echoes, grid) / 383
    assert pysas.metrics.relative_error(found, exact) < 1e-3
    assert pysas.metrics.relative_error(plain, exact) > 0.2


def test_uneven_array_on_an_ellipse():
    """Speed and distance vary along the track, three receivers trail unevenly: with the weights it is the full circle's PSF."""
    t = np.arange(260) * 2 * np.pi / 260
    t = t + 0.3 * np.sin(t) + 0.1 * np.cos(3 * t)
    centre = (0.1 * RADIUS, -0.3 * RADIUS)
    tx = np.stack([RADIUS * np.cos(t), 0.8 * RADIUS * np.sin(t), 0 * t], axis=1)
    along = np.stack([-np.sin(t), 0.8 * np.cos(t), 0 * t], axis=1)
    rx = tx[:, None] + along[:, None] * np.array([0.0, 1.5, 4.0])[:, None]
    echoes = scenes.echoes(tx, rx, [*centre, 0.0], 0.15)
    grid, x = scenes.patch(centre, 1.5 * scenes.WAVE, 6)
    exact = PSF.exact(np.hypot(x, x[:, None]))
    assert pysas.metrics.relative_error(weighted(echoes, grid), exact) < 6e-4
    assert pysas.metrics.relative_error(circular.weighted_sum(echoes, grid) / 780, exact) > 0.4


def test_gain_of_the_printed_sum_changes_with_the_pixel():
    tx = scenes.circle(200, 0.5)
    echoes = scenes.echoes(tx, None, [0.1, 0.2, 0.0], 0.1)
    grid, _ = scenes.patch((0.1, 0.2), scenes.WAVE, 1)
    printed = circular.resampled_sum(echoes, grid, normalised=False)
    ratio = printed / circular.resampled_sum(echoes, grid)
    radius = np.hypot(grid.axes["x"], grid.axes["y"][:, None])
    np.testing.assert_allclose(ratio, np.ceil(4 * np.pi * (0.5 - radius) / scenes.WAVE), rtol=1e-12)


@pytest.mark.parametrize("a", (0.2, 0.5, 0.8))
def test_jacobian_and_resampling_are_one_sum(a):
    """Pings at h^-1 of even views, or even pings weighted by d theta'/d theta: the same integral, to rounding."""
    x = np.array([-1.3, -0.2, 0.0, 0.9]) * scenes.WAVE
    even = -np.pi + np.arange(3000) * 2 * np.pi / 3000
    sums = []
    for theta, weights in ((circular.track_angle(even, a), np.ones(3000)), (even, circular.view_rate(even, a))):
        tx = 5 * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
        sums.append(scenes.circle_sum(tx, (5 * a, 0.0), x, weights) / 3000)
    np.testing.assert_allclose(sums[0], sums[1], rtol=0, atol=1e-12)


def test_uneven_views_with_the_engines_weights_as_the_plain_sum():
    """A constant weight per ping: the engine, the oracle and the plain sum are one."""
    tx = scenes.circle(300, 10.0)[:200]
    echoes = scenes.echoes(tx, None, [0.0, 4.0, 0.0], 0.15)
    grid, _ = scenes.patch((0.0, 4.0), scenes.WAVE, 3)
    weights = circular.view_weights(echoes, at([0, 4, 0]))[0, :, 0]
    found = circular.weighted_sum(echoes, grid, np.tile(weights[:, None], (49, 1, 1)))
    engine = pysas.backproject(echoes, grid, tol=1e-8, weights=weights, threads=1).data
    exact, _ = pysas.reference.exact(echoes, grid, weights=weights)
    assert pysas.metrics.relative_error(found, exact) < 1e-6
    assert pysas.metrics.relative_error(engine, exact) < 1e-8


RING = scenes.circle(100, 10.0)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: circular.view_angles(RING, RING, RING), ValueError, r"rx: expected shape \(100, channel, 3\)"),
        (lambda: circular.view_weights(None, at([0, 0, 0])), TypeError, "echoes=None"),
        (lambda: circular.view_weights(blank(RING), None), TypeError, "grid=None"),
        (lambda: circular.arc_weights([]), ValueError, "angles: expected at least one view"),
        (lambda: circular.arc_weights([0.0, np.nan]), ValueError, "angles: nan at view 1"),
        (lambda: circular.arc_weights([0.0], 0), ValueError, "channels=0"),
        (lambda: circular.weighted_sum(blank(RING, compressed=False), at([0, 0, 0])), ValueError, "compressed=False"),
        (lambda: circular.weighted_sum(blank(RING), at([0, 0, 0]), np.ones(3)), ValueError, r"weights: expected shape \(pixel"),
        (lambda: circular.weighted_sum(blank(RING), at([0, 0, 0]), np.full((1, 100, 1), np.inf)), ValueError, "weights: inf"),
        (lambda: circular.weighted_sum(blank(RING), at([0, 0, 0]), "x"), TypeError, "weights: expected real or complex"),
        (lambda: circular.resampled_sum(blank(RING[:70]), at([0, 0, 0])), ValueError, "tx: a gap of 112 degrees"),
        (lambda: circular.resampled_sum(blank(RING * [1, 1.1, 1]), at([0, 0, 0])), ValueError, "from a level circle"),
        (lambda: circular.resampled_sum(blank(RING), at([0, 10.5, 0])), ValueError, "a pixel 1.05 radii from the centre"),
        (lambda: circular.resampled_sum(blank(RING, RING[:, None] + 1), at([0, 0, 0])), ValueError, "rx: expected one channel"),
        (lambda: circular.resampled_sum(blank(RING[:2]), at([0, 0, 0])), ValueError, "tx: 2 pings"),
    ],
)
def test_what_cannot_be_is_named(call, error, text):
    with pytest.raises(error, match=text):
        call()
