"""What micronavigation does where it has nothing to go by, or no more than noise: the track stays, and why is said."""

from __future__ import annotations

import dataclasses

import motion_scenes
import numpy as np
import pytest
from recorder_scene import BED, recorded
from test_micronavigation import navigate, scene, slant, small

import pysas
from pysas.motion.priors import Prior

# estimators, not engines: see test_micronavigation.py
pytestmark = pytest.mark.cpp


def test_bright_points_do_not_stand_in_for_an_overlap():
    """Arrays that lie four steps apart where the claim, which sails half as far, lets eight phase centres overlap: what
    correlates are three targets, a little whatever the separation."""
    for seed in (1, 2, 3):
        places = ((-1.0, 22.0), (0.0, 25.0), (1.0, 28.0))
        _, claim, truth = scene(pings=12, overlap=-4, swath=(20.0, 32.0), targets=places, seed=seed)
        track = dataclasses.replace(truth.claim, position=truth.claim.position * [0.5, 1.0, 1.0])
        unchanged(motion_scenes.claimed(claim, track), "pings 0 and 1 and the following ones correlate as little")


def test_the_recorder_s_points_are_no_seabed(data_dir):
    """Six points, which a third of the pings see, and noise: nothing is found, whatever the windows, and the track stays."""
    echoes, where = recorded(data_dir / "recorder", "nav_bad.csv")
    beam = pysas.Beam(where.attitude.apply([0, 1, 0]), 0.06, 0.25, axis=where.attitude.apply([1, 0, 0]))
    echoes = echoes.replace(beam=beam)
    for size in (0.5, 1.0, 2.5):
        motion = pysas.micronavigate(echoes, BED, elements=(0.06, 0.05), windows=size)
        assert not motion.found and motion.apply(echoes) is echoes


def unchanged(echoes, why, **more):
    motion = navigate(echoes, **more)
    assert not motion.found and why in motion.why and "track unchanged" in str(motion)
    assert not motion.shift.any() and not motion.yaw.any()
    assert motion.apply(echoes) is echoes


def test_noise_is_no_track():
    _, claim, _ = small()
    rng = np.random.default_rng(0)
    noise = (rng.standard_normal(claim.data.shape) + 1j * rng.standard_normal(claim.data.shape)).astype(np.complex64)
    unchanged(claim.replace(data=noise), "19 of 19 pairs of pings do not correlate, the first of them pings 0 and 1")
    unchanged(claim.replace(data=0 * noise), "do not correlate")
    repeated = np.repeat(claim.data[:1], 20, axis=0)
    with pytest.raises(ValueError, match="ping 1 repeats the samples of ping 0"):
        navigate(claim.replace(data=repeated))
    unchanged(claim.replace(data=repeated + 1e-3 * noise), "saw the same from the same place, the first of them pings 0 and 1")


@pytest.mark.parametrize(("snr_db", "seed"), [(10.0, 2), (5.0, 3), (-3.0, 2), (-3.0, 3)])
def test_a_right_track_stays_where_noise_would_move_it(snr_db, seed):
    """What was found is noise alone, and no larger than it says."""
    true, *_ = scene(pings=40, overlap=4, swath=(20.0, 32.0), targets=(), snr_db=snr_db, seed=seed)
    unchanged(true, "dB by its own uncertainty, and is worth")


@pytest.mark.parametrize("prior", [Prior(gyro=1e-7), Prior(gyro=1e-5), Prior(gyro=1e-4), Prior(heading=1e-3)])
def test_a_prior_that_is_too_sure_is_told(prior):
    """Yaw of 12 mrad where a prior knows of none and sway is small: held to it the track would bend by millimetres."""
    _, claim, _ = scene(pings=40, swath=(20.0, 32.0), targets=(), sway=0.001, heave=0.0, yaw=0.012, surge=0.0, seed=1)
    unchanged(claim, "a prior that is too sure", prior=prior)


def test_the_size_of_samples_does_not_matter():
    """Their squares are numbers whatever they are: powers of 2 change no bit of the track."""
    _, claim, _ = small()
    data = np.asarray(claim.data)
    expected = navigate(claim)
    for exponent in (-100, 100):
        found = navigate(claim.replace(data=data * np.float32(2.0**exponent)))
        assert found.found and np.array_equal(found.shift, expected.shift) and np.array_equal(found.yaw, expected.yaw)


def test_a_motion_is_applied_once():
    _, claim, _ = small()
    motion = navigate(claim)
    with pytest.raises(ValueError, match="corrected already"):
        motion.apply(motion.apply(claim))


def test_a_ping_recorded_again_is_named():
    """Whole, with another gain, or but for a channel."""
    _, claim, _ = small()
    for gain_, first in ((1.0, 0), (1.001, 0), (1.0, 1)):
        data = np.array(claim.data)
        data[7, first:] = np.float32(gain_) * data[6, first:]
        with pytest.raises(ValueError, match="ping 7 repeats the samples of ping 6"):
            navigate(claim.replace(data=data))


def test_bright_points_alone_do():
    """Nothing but noise and four points: surge is unknown, and said to be; the rest is found in the windows that hold one."""
    places = ((-2.0, 22.0), (0.0, 24.0), (1.0, 26.0), (2.0, 30.0))
    true, claim, _ = scene(pings=24, density=0.0, targets=places, swath=(20.0, 32.0), snr_db=30.0, seed=1)
    motion = navigate(claim)
    assert slant(motion.apply(claim), true) < min(0.5, 0.1 * slant(claim, true))
    assert slant(motion.apply(claim), true) < 3 * 1e3 * np.sqrt(np.mean(motion.track_sigma**2))


def test_what_cannot_be_is_named():
    _, claim, truth = small()
    with pytest.raises(ValueError, match="beam=None: expected a pysas.Beam"):
        navigate(claim.replace(beam=None))
    with pytest.raises(ValueError, match="one ping: expected at least two"):
        navigate(claim[:1])
    with pytest.raises(ValueError, match="compressed=False"):
        navigate(claim.replace(compressed=False))
    data = np.array(claim.data)
    data[7, 2, 5] = np.nan
    with pytest.raises(ValueError, match="non-finite sample at ping 7, channel 2"):
        navigate(claim.replace(data=data))
    assert navigate(claim.replace(data=data, valid=np.tile([6, claim.n_sample - 1], (20, 1)))).found
    with pytest.raises(ValueError, match="fewer than two phase centres of pings 0 and 1 overlap"):
        navigate(claim.channels(slice(0, 5)))
    with pytest.raises(ValueError, match="no phase centres of pings 0 and 1 overlap"):
        navigate(claim.channels(0), prior=Prior(gyro=1e-5))
    far = dataclasses.replace(truth.claim, position=truth.claim.position * [3.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="of pings 0 and 1 overlap"):
        navigate(motion_scenes.claimed(claim, far))
    with pytest.raises(ValueError, match="windows=100: expected at least 8 samples .* and at most the 1.* m of slant range"):
        navigate(claim, windows=100.0)
    with pytest.raises(ValueError, match="windows=0.01: expected at least 8 samples"):
        navigate(claim, windows=0.01)
    with pytest.raises(ValueError, match="0 m of slant range that the record has of a seabed at z = 100 m"):
        navigate(claim, 100.0)
    with pytest.raises(ValueError, match="speed=0.001: expected echoes whose pings have times"):
        navigate(claim.replace(velocity=None, ping_time=None), prior=Prior(speed=1e-3))
    for bad in (Prior(depth=1e6), Prior(speed=1e-12)):
        with pytest.raises(ValueError, match="prior=Prior.*too firm or too loose"):
            navigate(claim, prior=bad)
    with pytest.raises(ValueError, match="velocity='stay'"):
        navigate(claim, velocity="stay")
    with pytest.raises(TypeError, match="prior=3: expected a pysas.motion.Prior"):
        navigate(claim, prior=3)
    with pytest.raises(TypeError, match="list: expected pysas.Echoes"):
        navigate([[claim]])
    with pytest.raises(ValueError, match="elements: expected shape"):
        pysas.micronavigate(claim, elements=(0.1,))
    with pytest.raises(ValueError, match="19 pings: expected 20"):
        navigate(claim).apply(claim[:19])


def test_noise_at_the_limit_of_coherence_bends_no_track():
    """3 dB more noise than echo: what would be found is less sure than the wavelength, and 40 % worse than the claim."""
    _, claim, _ = scene(pings=40, swath=(20.0, 32.0), targets=(), snr_db=-3.0, seed=3)
    unchanged(claim, "by its own uncertainty")
