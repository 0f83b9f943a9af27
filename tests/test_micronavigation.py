"""Micronavigation against the true tracks of simulated seabeds; its parts against mathematics and plain NumPy.

Scenes are those of `motion_scenes`, sampled at 50 kHz: at 30 kHz what lies beyond the pulse's band folds into it, and lowers
the coherence of displaced pings from 0.998 to 0.99.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings

import motion_scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import pysas
from pysas.motion import correlating
from pysas.motion.moving import centres
from pysas.motion.phase_centres import Side
from pysas.motion.priors import Prior
from pysas.motion.solution import HELD, Beliefs, Equations, gauge
from pysas.motion.surging import coherence, mean_square_sine, surges

# estimators, not engines: what these read is held to tolerance on every engine by test_contributions.py
pytestmark = pytest.mark.cpp

ELEMENTS = (motion_scenes.TX, motion_scenes.RX)


def scene(**more):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion_scenes, "FS", 50e3)
        return motion_scenes.scene(**more)


@functools.cache
def small(seed=1, pings=20, overlap=4, side=1):
    """A few metres of track over a narrow swath: a second to simulate."""
    return scene(pings=pings, overlap=overlap, swath=(20.0, 32.0), targets=((-0.4, 24.0),), side=side, seed=seed)


def navigate(echoes, seabed=8.0, **more):
    return pysas.micronavigate(echoes, seabed, elements=ELEMENTS, **more)


def slant(found, true, distance=26.0):
    """RMS error in mm of slant range; a shift and a turn of the whole are gauge."""
    return 1e3 * pysas.metrics.track_error(found, true, distance)


def turned(echoes, angle, shift=(0.0, 0.0, 0.0), over=False):
    """The same survey in other coordinates: turned about z, shifted, and turned over so that z points up."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    if over:
        matrix = np.diag([1.0, -1.0, -1.0]) @ matrix

    def go(v):
        return v @ matrix.T

    beam = dataclasses.replace(echoes.beam, boresight=go(echoes.beam.boresight), axis=go(echoes.beam.axis))
    return echoes.replace(tx=go(echoes.tx) + shift, rx=go(echoes.rx) + shift, velocity=go(echoes.velocity), beam=beam)


# Parts


def test_coherence_is_the_transform_of_the_two_way_pattern():
    """The Fourier integral of [sinc(Dt v) sinc(Dr v)]^2 at twice the separation, by quadrature; and the mean square of v."""

    def power(v):
        return (np.sinc(0.10 * v) * np.sinc(0.05 * v)) ** 2

    whole = quad(power, 0, 200, limit=500)[0]
    for separation in (0.0, 0.0125, 0.025, 0.05, 0.07):
        integral = quad(lambda v, s=separation: power(v) * np.cos(4 * np.pi * s * v), 0, 200, limit=2000)[0]
        assert_allclose(coherence(np.array(separation), ELEMENTS), integral / whole, atol=2e-5)
    square = quad(lambda v: v**2 * power(v), 0, 2000, limit=5000)[0] / whole
    assert_allclose(mean_square_sine(ELEMENTS, np.array(0.015)), 0.015**2 * square, rtol=2e-3)


def test_surge_is_where_coherence_is_largest():
    """Exact coherences of known shifts, scaled by any amplitude; what lies flat, or far away, says nothing."""
    separation = np.tile([-0.025, -0.025, 0.0, 0.0, 0.025, 0.025], (4, 1))
    shift = np.array([0.0, 3e-3, -8e-3, 1e-3])
    squared = (np.array([1.0, 0.9, 0.5, 0.7])[:, None] * coherence(separation + shift[:, None], ELEMENTS)) ** 2
    used = np.ones(separation.shape, dtype=bool)
    found, sigma = surges(separation, squared, used, ELEMENTS, 0.025)
    assert_allclose(found, shift, atol=0.1e-3)
    assert np.all(sigma > 0)
    flat = surges(separation, np.ones_like(squared), used, ELEMENTS, 0.025)[1]
    assert np.all((flat == 0) | (flat > 2e-3))
    used[1, 2:] = False
    assert surges(separation, squared, used, ELEMENTS, 0.025)[1][1] == 0.0


def test_windows_correlate_as_numpy_does():
    """Amplitudes are clipped at 2 rms as the median says (of an even number, the larger one in the middle; found to 1 in 4096);
    a window of which less than half was recorded is left out."""
    rng = np.random.default_rng(0)
    a, b = (rng.standard_normal((2, 3, 200)) + 1j * rng.standard_normal((2, 3, 200))).astype(np.complex64)
    a[0, 30] = 100.0
    a[2, :60] = 0
    products, powers, counts = np.empty((3, 2, 5), dtype=complex), np.empty((3, 2)), np.empty((3, 2))
    squares = np.empty(100, dtype=np.float32)
    correlating.windows(a, b, 100, squares, squares.view(np.int32), 30, products, powers, counts)

    def clipped(trace, window):
        power = np.sort(np.abs(trace[window][trace[window] != 0]) ** 2)
        most = 2 * np.sqrt(power[power.size // 2] / np.log(2))
        return trace * np.minimum(1, most / np.maximum(np.abs(trace), 1e-30))

    for row in range(3):
        for window in range(2):
            part = slice(100 * window, 100 * window + 100)
            if row == 2 and window == 0:
                assert powers[row, window] == counts[row, window] == 0 and not products[row, window].any()
                continue
            one, two = clipped(a[row], part)[part], clipped(b[row], part)
            assert_allclose(powers[row, window], np.linalg.norm(one) * np.linalg.norm(two[part]), rtol=2e-4)
            padded = np.pad(two, 2)
            for lag in range(-2, 3):
                expected = np.vdot(one, padded[part.start + 2 + lag : part.stop + 2 + lag])
                assert_allclose(products[row, window, lag + 2], expected, atol=0.02)
            assert counts[row, window] == 100


def dense(equations):
    n = len(equations.diagonal)
    matrix = np.zeros((4 * n, 4 * n))
    for p in range(n):
        matrix[4 * p : 4 * p + 4, 4 * p : 4 * p + 4] = equations.diagonal[p]
        if p:
            matrix[4 * p : 4 * p + 4, 4 * p - 4 : 4 * p] = equations.beside[p - 1]
            matrix[4 * p - 4 : 4 * p, 4 * p : 4 * p + 4] = equations.beside[p - 1].T
    return matrix


def random_equations(n=9):
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((n - 1, 20, 8))
    equations = Equations(n)
    equations.add(np.einsum("prk,prl->pkl", rows, rows), rng.standard_normal((n - 1, 8)))
    equations.believe(Beliefs(Prior(), n, None), rng.standard_normal((n, 4)))
    return equations


def test_the_banded_solution_is_the_dense_one():
    equations = random_equations()
    assert_allclose(equations.solve().ravel(), np.linalg.solve(dense(equations), equations.right.ravel()), rtol=1e-9)


def test_variances_are_those_of_the_dense_inverse():
    """Of a part of the track whose middle ping is held, with a shift and a trend projected out of both sides: pings beyond it
    are as unknown as its own."""
    equations, rng = random_equations(), np.random.default_rng(2)
    looks = rng.standard_normal((6, 3))
    basis = np.linalg.qr(rng.standard_normal((6, 2)))[0]
    part = equations.part(2, 8)
    matrix = dense(equations)
    matrix[20:24, 20:24] += np.diag(1 / HELD**2)
    along = np.zeros((6, 24))
    for p in range(6):
        along[p, 4 * p : 4 * p + 3] = looks[p]
    covariance = along @ np.linalg.inv(matrix)[8:32, 8:32] @ along.T
    project = np.eye(6) - basis @ basis.T
    assert_allclose(part.slant_variance(looks, basis), np.diag(project @ covariance @ project), rtol=1e-7)


def test_gauge_is_a_shift_and_a_turn_of_the_whole():
    x = np.linspace(-5, 5, 30)
    places = np.stack([x, 0 * x, 0 * x], axis=1)
    looks = np.tile([0.0, 0.96, 0.28], (30, 1))
    basis = gauge(looks, places)
    assert basis.shape == (30, 2)
    line = 0.3 + 0.02 * x
    assert_allclose(basis @ (basis.T @ line), line, atol=1e-12)
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    assert gauge(-circle, 20 * circle).shape == (30, 2)  # shifts of the centre; a turn changes no distance to it


def test_a_prior_is_finite_and_positive():
    with pytest.raises(ValueError, match="gyro=0: expected a finite number > 0"):
        Prior(gyro=0)
    with pytest.raises(TypeError, match="depth='deep'"):
        Prior(depth="deep")


# The whole


def test_phase_noise_reaches_the_bound():
    """At the true track, windows of 1.25 m: sqrt((1 - g^2)/(2 N g^2)), N = 2 B L/c; at most 1.2 times that (1.00 to 1.08)."""
    number = 2 * 20e3 * 1.25 / 1500
    for seed in (1, 2, 3):
        echoes, _, _ = scene(pings=8, targets=(), swath=(20.0, 32.0), seed=seed)
        rows = Side(echoes, centres(echoes), ELEMENTS, 8.0).measure(0, 7, 1.25, 3, 1, 1e-3, 1)
        nearest = rows.products[:, rows.order == 0][rows.used[:, rows.order == 0]][..., 3]
        square = np.mean(np.abs(nearest) ** 2)
        assert np.all(np.abs(rows.count[rows.count > 0] - number) < 1)
        bound = np.sqrt((1 - square) / (2 * number * square))
        assert square > 0.98
        ratio = np.sqrt(np.mean(np.angle(nearest) ** 2)) / bound
        assert 0.8 < ratio < 1.2


def test_a_track_is_found():
    true, claim, truth = small()
    motion = navigate(claim)
    fixed = motion.apply(claim)
    assert motion.found and motion.slips == [] and motion.unseen == []
    assert slant(claim, true) > 1.0
    assert slant(fixed, true) < 0.15
    assert 1e3 * np.std(np.diff(motion.heave - truth.shift[:, 2])) < 0.1
    assert np.std(np.diff(motion.yaw - truth.yaw)) < 2 * np.median(motion.sigma[:, 3]) < 400e-6
    assert 0.95 < motion.coherence.min() and motion.overlap == pytest.approx(4 * np.ones(19))
    assert fixed.attrs["motion"].startswith("micronavigation: shifts of up to")
    assert_allclose(motion.shift[:, :2], np.stack([motion.surge, motion.sway], axis=1), atol=1e-12)  # of a claim along x
    text = str(motion)
    for word in ("found", "heading", "pitch", "sure to", "phase centres overlap", "peaks may lose"):
        assert word in text


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_true_track_stays(seed):
    true, _, _ = small(seed)
    assert slant(navigate(true).apply(true), true) < 0.1


def test_coordinates_do_not_matter():
    """Turned, far away, z up; a cone; speeds and starts a ping; one thread or two, to the last bit."""
    _, claim, _ = small()
    plain = navigate(claim)
    for angle, shift in ((2.0, (5e5, 4e6, 0.0)), (-np.pi / 2, (0.0, 0.0, 0.0))):
        other = navigate(turned(claim, angle, shift))
        for name in ("surge", "sway", "heave", "yaw"):
            assert_allclose(getattr(other, name), getattr(plain, name), atol=1e-6)
    other = navigate(turned(claim, 0.3, over=True), -8.0)
    assert_allclose(other.surge, plain.surge, atol=1e-6)
    for name in ("sway", "heave", "yaw"):
        assert_allclose(getattr(other, name), -getattr(plain, name), atol=1e-6)
    cone = claim.replace(beam=pysas.Beam(claim.beam.boresight, 0.1, 0.15, shape="cone"))
    assert_allclose(navigate(cone).shift, plain.shift, atol=1e-9)
    assert np.array_equal(navigate(claim, threads=1).shift, navigate(claim, threads=2).shift)
    each = claim.replace(c=np.full(20, 1500.0), t0=np.full(20, float(claim.t0)))
    assert_allclose(navigate(each).shift, plain.shift, atol=1e-9)


def test_starts_and_windows_a_ping():
    """Records that start when they like, and samples that were not recorded, whatever they hold."""
    true, claim, _ = small()
    rng = np.random.default_rng(0)
    late, n = rng.integers(0, 30, 20), claim.n_sample - 30
    data = np.stack([claim.data[p, :, k : k + n] for p, k in enumerate(late)])
    assert slant(navigate(claim.replace(data=data, t0=claim.t0 + late / claim.fs)).apply(claim), true) < 0.2
    data = np.array(claim.data)
    for p, k in enumerate(late):
        data[p, :, :k], data[p, :, n + k :] = 1e6, -1e6
    valid = np.stack([late, late + n - 1], axis=1)
    assert slant(navigate(claim.replace(data=data, valid=valid)).apply(claim), true) < 0.2


def test_receivers_are_as_long_as_they_are_apart():
    """Unless told otherwise, and no longer than the beam's element."""
    _, claim, _ = small()
    assert_allclose(pysas.micronavigate(claim).shift, navigate(claim).shift, atol=1e-7)


def test_receivers_said_to_stand_still():
    """A claim without a velocity: the drift while an echo travels is nearly the same from ping to ping."""
    true, claim, _ = small()
    still = claim.replace(velocity=None)
    motion = navigate(still)
    assert motion.apply(still).velocity is None
    assert slant(motion.apply(still), true) < 0.2


def test_a_curved_track():
    """An arc of 40 m radius about the seabed: the claim is the arc itself, without sway, heave and yaw."""
    radius, advance, pings = 40.0, 0.2, 20
    true, claim = (
        pysas.tracks.perturbed(pings, advance, start=(-1.9, 0.0, 0.0), sway=s, heave=s / 2, yaw=s / 3, correlation=3.0, seed=4)
        for s in (0.04, 0.0)
    )

    def bent(track):
        x, y, z = track.position.T
        angle = x / radius
        c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(pings), np.ones(pings)
        position = np.stack([(radius - y) * s, radius - (radius - y) * c, z], axis=1)
        turn = np.stack([np.stack([c, -s, zero], 1), np.stack([s, c, zero], 1), np.stack([zero, zero, one], 1)], axis=1)
        velocity = np.einsum("pij,pj->pi", turn, track.velocity * np.stack([1 - y / radius, one, one], axis=1))
        return pysas.tracks.Track(position, velocity, track.yaw + angle, track.time)

    true, claim = bent(true), bent(claim)
    points, amplitudes = pysas.simulation.seabed((-10.0, 10.0), (16.0, 33.0), 40.0, 8.0, seed=4)
    geometry = motion_scenes.arms(true, 12)
    face = {"boresight": geometry["beam"].boresight, "along": geometry["beam"].axis}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
        raw = pysas.simulate(
            points, amplitudes, pysas.LFM(100e3, 20e3, 0.8e-3), fs=50e3, t0=40 / 1500, duration=20 / 1500 + 0.8e-3,
            tx_element=pysas.simulation.Element(0.10, **face), rx_element=pysas.simulation.Element(0.05, **face),
            ping_time=true.time, **geometry,
        )  # fmt: skip
    echoes = pysas.compress(raw, window="boxcar", inverse=0.01)
    claimed = motion_scenes.claimed(echoes, claim)
    motion = navigate(claimed)
    assert slant(claimed, echoes) > 1.0
    assert slant(motion.apply(claimed), echoes) < 0.15
    # the shift is told along the claimed track's own directions
    forward = np.stack([np.cos(claim.yaw), np.sin(claim.yaw)], axis=1)
    assert_allclose(motion.surge, np.sum(motion.shift[:, :2] * forward, axis=1), atol=1e-9)


def test_the_second_opinion_agrees():
    """`reference.displaced_phase_centres`, with delays, readings and dense least squares of its own: both differ by less than
    either errs; but for a shift and a turn of the whole, and for surge, which each weighs in its own way."""
    _, claim, truth = small(pings=12)
    one = navigate(claim)
    other = pysas.reference.displaced_phase_centres(claim, seabed=8.0, window=2.5, lags=1, elements=ELEMENTS)
    place = np.arange(12.0)
    for name, column, most in (("sway", 1, 15e-6), ("heave", 2, 30e-6), ("yaw", 3, 40e-6)):
        difference = getattr(one, name) - other[:, column]
        assert np.std(difference - np.polyval(np.polyfit(place, difference, 1), place)) < most
    difference = np.diff(one.surge - other[:, 0])
    assert np.std(difference) < np.median(one.sigma[:, 0])


def test_two_sides_are_one_solution():
    (right, one, _), (left, other, _) = small(3), small(3, side=-1)
    motion = navigate([one, other])
    assert slant(motion.apply(one), right) < 0.15 and slant(motion.apply(other), left) < 0.15
    assert np.all(motion.sigma[:, 3] < navigate(one).sigma[:, 3])
    with pytest.raises(ValueError, match="sides of 20 and 19 pings"):
        navigate([one, other[:19]])


def test_one_overlapping_centre_and_a_gyro():
    true, _, truth = small(2, overlap=1, pings=16)
    claim = motion_scenes.claimed(true, pysas.tracks.inertial(truth.track, seed=2))
    with pytest.raises(ValueError, match="pings 0 and 1 overlap .*prior=Prior"):
        navigate(claim)
    motion = navigate(claim, prior=Prior(speed=6e-3, gyro=1e-5, depth=5e-4))
    assert motion.found
    assert slant(motion.apply(claim), true) < min(0.15, slant(claim, true))


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.1, 1.25])
def test_a_wrong_advance_is_found(factor):
    true, claim, truth = small()
    track = dataclasses.replace(truth.claim, position=truth.claim.position * [factor, 1.0, 1.0])
    wrong = motion_scenes.claimed(claim, track)
    fixed = navigate(wrong).apply(wrong)
    assert slant(fixed, true) < 0.2
    assert abs(np.ptp(fixed.tx[:, 0]) - np.ptp(true.tx[:, 0])) < 5e-3


def test_a_ping_lost_and_a_gap_are_bridged():
    """Nothing joins what lies before and after but smooth motion; said, and far better than the claim all the same."""
    true, claim, _ = small(pings=40)
    data = np.array(claim.data)
    data[20] = 0
    motion = navigate(claim.replace(data=data))
    assert motion.unseen == [19, 20] and "pings 19, 20: nothing correlates" in str(motion)
    assert slant(motion.apply(claim), true) < 0.25 * slant(claim, true)
    kept = np.r_[0:18, 22:40]
    motion = navigate(claim[kept])
    assert motion.unseen == [17]
    assert slant(motion.apply(claim[kept]), true[kept]) < 0.5 * slant(claim[kept], true[kept])


def test_long_lines_join():
    """Of 800 pings in one solution the first 100 move from ping to ping as they do alone."""
    _, claim, _ = small()
    track = pysas.tracks.straight(800, 0.2)
    long = pysas.Echoes(
        np.tile(np.asarray(claim.data), (40, 1, 1)), fs=claim.fs, fc=claim.fc, t0=claim.t0, bandwidth=claim.bandwidth,
        ping_time=track.time, **motion_scenes.arms(track, 12),
    )  # fmt: skip
    whole, part = navigate(long, iterations=1), navigate(long[:100], iterations=1)
    joints = np.arange(19, 799, 20)
    assert whole.unseen == joints.tolist()
    seen = np.setdiff1d(np.arange(99), joints)
    for name, column in (("heave", 2), ("yaw", 3)):  # weakly held to the claim, whose mean over either differs
        change = np.diff(getattr(whole, name)[:100]) - np.diff(getattr(part, name))
        assert np.all(np.abs(change[seen]) < 0.5 * np.median(part.sigma[:, column]))
    assert np.all(np.isfinite(whole.track_sigma)) and whole.track_sigma.max() < 0.1
