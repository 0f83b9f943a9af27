"""The plain micronavigation on simulated lines whose true track is known; the simulator shares no code with it.

Errors are those an image suffers: along the line of sight at 30 m, shift and trend of the track removed.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from motion_scenes import RX, TX, scene

from pysas.reference import bounds, displaced_phase_centres, micronavigation
from pysas.reference.reading import finer

pytestmark = pytest.mark.reference

ELEMENTS = (TX, RX)
SEABED, ADVANCE, SPACING = 8.0, 0.2, 0.025


def slant(track):
    """(ping,) m, along the line of sight at 30 m, of tracks (ping, 3) whose shift and trend are removed."""
    n = np.arange(len(track))
    flat = track - np.stack([np.polyval(np.polyfit(n, column, 1), n) for column in track.T], axis=1)
    return (np.sqrt(30.0**2 - SEABED**2) * flat[:, 1] + SEABED * flat[:, 2]) / 30.0


def errors(found, truth):
    """Root mean squares, m: slant, its increments, those of surge; and of the yaw's increments, rad."""
    left = np.column_stack([truth.shift, truth.yaw]) - found
    seen = slant(left[:, :3])
    return seen.std(), np.diff(seen).std(), np.diff(left[:, 0]).std(), np.diff(left[:, 3]).std()


@pytest.fixture(scope="module")
def short():
    """12 pings over a narrow swath, whose sway changes within the line."""
    return scene(12, swath=(20.0, 28.0), density=30.0, targets=(), correlation=1.5)


@pytest.fixture(scope="module")
def found(short):
    return displaced_phase_centres(short[1], seabed=SEABED, elements=ELEMENTS)


@pytest.fixture(scope="module")
def once(short):
    return displaced_phase_centres(short[1], seabed=SEABED, elements=ELEMENTS, iterations=1)


def test_the_track_is_found(short, found):
    _, _, truth = short
    before, after = errors(np.zeros((12, 4)), truth), errors(found, truth)
    assert before[0] > 3e-3 and before[3] > 300e-6
    assert after[0] < 0.1e-3 and after[1] < 0.1e-3
    assert after[2] < 0.5e-3 and after[3] < 250e-6


def test_the_second_pass_is_better_than_the_first(short, once, found):
    _, _, truth = short
    assert errors(found, truth)[0] < errors(once, truth)[0]


def test_started_at_the_truth_it_stays(short):
    true, _, truth = short
    found = displaced_phase_centres(true, seabed=SEABED, elements=ELEMENTS, iterations=1)
    assert slant(found[:, :3]).std() < 0.1e-3


def test_noise_at_the_true_track_is_what_the_coherence_says(short):
    """Overlapping pairs, windows of 1.25 m: what they differ from zero by, over the bound at each one's own coherence."""
    true, _, _ = short
    fine = [np.array([finer(trace) for trace in ping]) for ping in true.traces]
    reader = micronavigation._Reader(true, fine, SEABED, 1.25, 1, ELEMENTS)
    ratios = []
    for ping in range(true.n_ping - 1):
        sight = reader.sight(ping, search=False)
        overlapping = sight.pairs[:, 0] - sight.pairs[:, 1] == 8
        ratios.append(sight.slant[overlapping] / sight.sigma[overlapping])
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.2


def turned(echoes, matrix):
    """The same survey in coordinates turned by `matrix`."""
    beam = echoes.beam
    beam = dataclasses.replace(beam, boresight=beam.boresight @ matrix.T, axis=beam.axis @ matrix.T)
    return echoes.replace(tx=echoes.tx @ matrix.T, rx=echoes.rx @ matrix.T, velocity=echoes.velocity @ matrix.T, beam=beam)


def test_coordinates_do_not_matter(short, once):
    """Turned about z by 40 degrees, and with z up (turned about x by 180): displacements turn along, headings as turns do."""
    _, claim, _ = short
    c, s = np.cos(0.7), np.sin(0.7)
    for matrix, seabed, sense in (
        (np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), SEABED, 1),
        (np.diag([1.0, -1.0, -1.0]), -SEABED, -1),
    ):
        again = displaced_phase_centres(turned(claim, matrix), seabed=seabed, elements=ELEMENTS, iterations=1)
        assert np.max(np.abs(again[:, :3] @ matrix - once[:, :3])) < 1e-6
        assert np.max(np.abs(sense * again[:, 3] - once[:, 3])) < 1e-6


def test_a_sonar_that_looks_to_the_other_side():
    _, claim, truth = scene(8, swath=(20.0, 28.0), density=30.0, targets=(), correlation=1.5, side=-1)
    found = displaced_phase_centres(claim, seabed=SEABED, elements=ELEMENTS)
    left = truth.shift - found[:, :3]
    assert slant(truth.shift * [1, -1, 1]).std() > 0.6e-3
    assert slant(left * [1, -1, 1]).std() < 0.1e-3


def test_what_cannot_be_seen_does_not_come_back(short, once):
    """A claim shifted and turned about z as a whole gives the same echoes at the seabed's places, shifted and turned."""
    _, claim, _ = short
    angle = 5e-3
    matrix = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    away = turned(claim, matrix)
    away = away.replace(tx=away.tx + [3.0, -2.0, 0], rx=away.rx + [3.0, -2.0, 0])
    again = displaced_phase_centres(away, seabed=SEABED, elements=ELEMENTS, iterations=1)
    assert np.max(np.abs(again[:, :3] @ matrix - once[:, :3])) < 1e-6


def test_bad_input_is_named(short):
    _, claim, _ = short
    with pytest.raises(TypeError, match="echoes"):
        displaced_phase_centres(None, seabed=SEABED)
    with pytest.raises(ValueError, match="beam=None"):
        displaced_phase_centres(claim.replace(beam=None), seabed=SEABED)
    with pytest.raises(ValueError, match="compressed=False"):
        displaced_phase_centres(claim.replace(compressed=False), seabed=SEABED)
    data = claim.data.copy()
    data[3, 2, 100] = np.nan
    with pytest.raises(ValueError, match="non-finite sample at ping 3"):
        displaced_phase_centres(claim.replace(data=data), seabed=SEABED)
    with pytest.raises(ValueError, match="ping_time=None"):
        displaced_phase_centres(claim.replace(ping_time=None), seabed=SEABED)
    with pytest.raises(ValueError, match="1 pings"):
        displaced_phase_centres(claim[0], seabed=SEABED)
    with pytest.raises(ValueError, match="window=100"):
        displaced_phase_centres(claim, seabed=SEABED, window=100.0)
    with pytest.raises(ValueError, match="elements"):
        displaced_phase_centres(claim, seabed=SEABED, elements=(0.0, 0.0))
    with pytest.raises(ValueError, match="lags"):
        displaced_phase_centres(claim, seabed=SEABED, lags=0)
    apart = claim.replace(**{name: getattr(claim, name) * [2, 1, 1] for name in ("tx", "velocity")})
    rx = claim.rx + (apart.tx - claim.tx)[:, None]
    with pytest.raises(ValueError, match="pings 0 and 1"):
        displaced_phase_centres(apart.replace(rx=rx), seabed=SEABED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_forty_pings_with_targets(seed):
    """Four overlapping centres, noise 30 dB below, three strong targets, which change little of the surge."""
    _, claim, truth = scene(40, seed=seed)
    found = displaced_phase_centres(claim, seabed=SEABED, elements=ELEMENTS)
    before, after = errors(np.zeros((40, 4)), truth), errors(found, truth)
    assert before[0] > 5e-3
    assert after[0] < 0.8e-3 and after[1] < 0.1e-3
    _, claim, truth = scene(40, seed=seed, targets=())
    speckle = errors(displaced_phase_centres(claim, seabed=SEABED, elements=ELEMENTS), truth)
    assert after[2] < 0.3e-3 and after[2] < 1.5 * speckle[2]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_of_the_heading_is_what_the_bound_says(seed):
    """Noise 15 dB below: coherence 1/(1 + 10^-1.5), 10 windows of 2.5 m, 4 pairs. The sway drifts by it."""
    _, claim, truth = scene(40, seed=seed, snr_db=15.0, targets=())
    found = displaced_phase_centres(claim, seabed=SEABED, elements=ELEMENTS)
    phase = bounds.phase_noise(1 / (1 + 10**-1.5), window=2.5, bandwidth=20e3) / np.sqrt(10)
    yaw = bounds.yaw_noise(float(bounds.slant_noise(phase, 0.015)), pairs=4, spacing=SPACING)
    left = np.column_stack([truth.shift, truth.yaw]) - found
    assert 0.7 < np.diff(left[:, 3]).std() / yaw < 1.4
    n = 10
    sway = left[n:, 1] - left[:-n, 1] - n * ADVANCE * left[:-n, 3]
    assert 0.6 < np.sqrt(np.mean(sway**2)) / bounds.drift(yaw, advance=ADVANCE, pings=n) < 1.6
