"""How well micronavigation does on lines of metres: three seeds each, the worst counts; prints what it measures.

    pytest -m slow -n 0 -s tests/test_micronavigation_figures.py

Errors are RMS of slant range at 30 m over the whole line, a shift and a turn of the whole removed; losses those of the weakest
target's peak against the image by the true track. `docs/motion.md` has the table.
"""

from __future__ import annotations

import functools
import warnings

import motion_scenes
import numpy as np
import pytest
from test_micronavigation import navigate, scene

import pysas
from pysas.motion.priors import Prior

pytestmark = pytest.mark.slow
SEEDS = (11, 12, 13)
scenes = functools.lru_cache(maxsize=12)(lambda *items: scene(**dict(items)))


def slant(found, true, distance=30.0, seabed=8.0):
    return 1e3 * pysas.metrics.track_error(found, true, distance, seabed=seabed)


def peak(echoes, target):
    """Largest amplitude within 1 m of a target, which an unknown heading moves, on a raster of 1 mm about one of 15 mm."""
    place, reach, step = np.array(target), 1.0, 0.015
    for _ in range(2):
        around = np.arange(-reach, reach + step / 2, step)
        grid = pysas.Grid.plane(place[0] + around, place[1] + around, z=place[2])
        level = np.abs(pysas.focus(echoes, grid, tol=1e-2).data)
        row, column = np.unravel_index(np.argmax(level), level.shape)
        place, reach, step = np.array([place[0] + around[column], place[1] + around[row], place[2]]), 0.02, 0.001
    return level.max()


def loss(found, true, targets):
    return max(20 * np.log10(peak(true, target) / peak(found, target)) for target in targets)


def worst(name, rows):
    """Of several seeds; printed."""
    rows = np.array(rows)
    most = rows.max(axis=0)
    print(f"\n{name}: " + ", ".join(f"{value:.3g}" for value in most))
    return most


def test_a_line_of_64_pings():
    """K = 4, SNR 30, a straight claim, three targets: slant 0.8 mm, 0.1 mm from ping to ping, 0.3 dB; yaw as sure as said."""
    rows, ratios = [], []
    for seed in SEEDS:
        true, claim, truth = scenes(("pings", 64), ("seed", seed))
        motion = navigate(claim)
        fixed = motion.apply(claim)
        u = np.array([0.0, np.sqrt(1 - (8 / 30) ** 2), 8 / 30])
        step = np.diff((motion.shift - truth.shift) @ u)
        rows.append((slant(claim, true), slant(fixed, true), 1e3 * np.std(step), loss(fixed, true, truth.targets)))
        ratios.append(np.std(np.diff(motion.yaw - truth.yaw)) / np.median(motion.sigma[:, 3]))
        assert motion.slips == motion.unseen == [] and 0.5 < motion.residual[0] < 1.3
    _, error, step, decibels = worst("64 pings, SNR 30 dB: claimed mm, found mm, mm from ping to ping, dB", rows)
    assert error < 0.8 and step < 0.1 and decibels < 0.3
    print("yaw's noise, measured over said:", np.round(ratios, 2))
    assert 0.7 < min(ratios) and max(ratios) < 1.4


def test_a_line_with_more_sway_and_noise():
    """SNR 20, sway 50 mm: 2 mm, 1.5 dB."""
    rows = []
    for seed in SEEDS:
        true, claim, truth = scene(pings=64, snr_db=20.0, sway=0.05, seed=seed)
        fixed = navigate(claim).apply(claim)
        rows.append((slant(claim, true), slant(fixed, true), loss(fixed, true, truth.targets)))
    _, error, decibels = worst("64 pings, SNR 20 dB, sway 50 mm: claimed mm, found mm, dB", rows)
    assert error < 2.0 and decibels < 1.5


def with_an_inertial_system(overlap):
    """Of each seed 40 pings with the true track, with an inertial system's claim, what was found with its prior, the truth."""
    for seed in SEEDS:
        true, _, truth = scene(pings=40, overlap=overlap, snr_db=20.0, seed=seed)
        claim = motion_scenes.claimed(true, pysas.tracks.inertial(truth.track, seed=seed))
        yield true, claim, navigate(claim, prior=Prior(speed=6e-3, gyro=1e-5, depth=5e-4)), truth


def test_an_inertial_system_and_one_overlapping_centre():
    """K = 1, gyro 10 urad a ping, 40 pings: 0.15 mm, 0.15 dB."""
    rows = []
    for true, claim, motion, truth in with_an_inertial_system(1):
        fixed = motion.apply(claim)
        rows.append((slant(claim, true), slant(fixed, true), loss(fixed, true, truth.targets)))
        assert motion.residual[1] < 1.5
    _, error, decibels = worst("40 pings, K = 1, INS: claimed mm, found mm, dB", rows)
    assert error < 0.15 and decibels < 0.15


def test_crab_and_large_steps():
    """4 degrees of crab that nobody knows, steps of 13 mm and more: 0.5 mm, no slips."""
    rows = []
    for seed in SEEDS:
        true, claim, truth = scene(pings=20, snr_db=20.0, crab=np.radians(4), sway=0.12, correlation=1.5, seed=seed)
        motion = navigate(claim)
        rows.append((slant(claim, true), slant(motion.apply(claim), true)))
        assert motion.slips == []
        print(f"largest step {1e3 * np.max(np.abs(np.diff(truth.shift[:, 1]))):.3g} mm")
    assert worst("20 pings, crab 4 degrees: claimed mm, found mm", rows)[1] < 0.5


def test_strong_targets_change_little():
    """Errors of surge from ping to ping with three targets over those without: 1.5; and started at the truth: 0.1 mm."""
    rows = []
    for seed in SEEDS:
        errors = []
        for targets in ((), motion_scenes.TARGETS):
            true, claim, truth = scene(pings=20, targets=targets, seed=seed)
            errors.append(1e3 * np.std(np.diff(navigate(claim).surge - truth.shift[:, 0])))
        rows.append((*errors, errors[1] / errors[0], slant(navigate(true).apply(true), true)))
    _, _, ratio, stays = worst("20 pings: surge mm without and with targets, ratio; started at the truth mm", rows)
    assert ratio < 1.5 and stays < 0.1


@pytest.mark.parametrize(
    ("overlap", "most"), [(2, 0.6), (3, 0.35), (6, 0.1), (8, 0.05)], ids=lambda value: f"{value}"
)  # fmt: skip
def test_overlap_rules(overlap, most):
    rows = []
    for seed in SEEDS:
        true, claim, _ = scene(pings=20, overlap=overlap, seed=seed)
        rows.append((slant(claim, true), slant(navigate(claim).apply(claim), true)))
    assert worst(f"20 pings, K = {overlap}: claimed mm, found mm", rows)[1] < most


@pytest.mark.parametrize(
    ("name", "most", "more"),
    [
        ("advance half a step off", 0.25, {"advance": 8.5 * 0.025}),
        ("seabed slopes by 10 %", 0.3, {"slope": 0.1}),
        ("40 to 90 m", 0.15, {"swath": (40.0, 90.0)}),
    ],
)
def test_other_lines(name, most, more):
    rows = []
    for seed in SEEDS:
        true, claim, _ = scene(pings=20, seed=seed, **more)
        rows.append((slant(claim, true, 45.0), slant(navigate(claim).apply(claim), true, 45.0)))
    assert worst(f"20 pings, {name}: claimed mm, found mm", rows)[1] < most


def test_no_overlapping_centre_and_an_inertial_system():
    """K = 0: the nearest phase centres lie 25 mm apart, with a coherence of 0.6."""
    rows = []
    for true, claim, motion, _ in with_an_inertial_system(0):
        rows.append((slant(claim, true), slant(motion.apply(claim), true)))
    assert worst("40 pings, K = 0, INS: claimed mm, found mm", rows)[1] < 0.6


@pytest.mark.parametrize(("snr_db", "most"), [(10.0, 0.5), (5.0, 0.8), (0.0, 1.5), (-3.0, 2.4), (-5.0, 2.4), (-10.0, 2.4)])
def test_noise(snr_db, most):
    """Down to a coherence of 0.3, at -3 dB; beyond nothing is found, or was no better than what was claimed."""
    rows = []
    for seed in SEEDS:
        true, claim, _ = scene(pings=20, targets=(), snr_db=snr_db, seed=seed)
        rows.append((slant(claim, true), slant(navigate(claim).apply(claim), true)))
        assert rows[-1][1] <= rows[-1][0]
    assert worst(f"20 pings, SNR {snr_db:g} dB: claimed mm, found mm", rows)[1] < most


# What real seas do


def each_ping(echoes, scatterers):
    """Compressed echoes of what differs from ping to ping: scatterers(ping) gives points and amplitudes."""
    out = np.zeros(echoes.traces.shape, dtype=np.complex64)
    pulse = pysas.LFM(motion_scenes.FC, motion_scenes.BAND, motion_scenes.PULSE)
    element = pysas.simulation.Element
    for ping in range(echoes.n_ping):
        one = echoes[ping]
        face = {"boresight": one.beam.boresight, "along": one.beam.axis}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
            raw = pysas.simulate(
                *scatterers(ping), pulse, tx=one.tx, rx=one.rx, velocity=one.velocity, fs=echoes.fs, t0=echoes.t0,
                duration=echoes.n_sample / echoes.fs, tx_element=element(motion_scenes.TX, **face),
                rx_element=element(motion_scenes.RX, **face),
            )  # fmt: skip
        out[ping] = pysas.compress(raw, window="boxcar", inverse=motion_scenes.INVERSE).traces[0]
    return out


def plain(true, claim, seed):
    return true, claim, {}


def lost(true, claim, seed):
    data = np.array(true.data)
    data[[10, 25, 33]] = 0
    return true.replace(data=data), claim.replace(data=data), {}


def gap(true, claim, seed):
    kept = np.r_[0:18, 24:40]
    return true[kept], claim[kept], {}


def added(true, claim, more):
    data = np.asarray(true.data) + more
    return true.replace(data=data), claim.replace(data=data), {}


def fish(true, claim, seed):
    """Twenty, each as strong as a target, that wander about by decimetres a ping, 3 m above the seabed."""
    rng = np.random.default_rng(seed)
    place = rng.normal(0, 0.5, (20, 3)) + [0.0, 28.0, 5.0]
    way = np.cumsum(rng.normal(0, 0.05, (40, 20, 3)), axis=0)
    return added(true, claim, each_ping(true, lambda ping: (place + way[ping], np.full(20, 60.0))))


def ghost(true, claim, seed):
    more = np.zeros_like(true.data)
    more[..., 80:] = -0.1 * true.data[..., :-80]
    return added(true, claim, more)


def decorrelated(true, claim, seed):
    """A fifth of the power comes from scatterers that are new in each ping."""

    def new(ping):
        x = true.tx[ping, 0]
        points, amplitudes = pysas.simulation.seabed((x - 8, x + 8), (18.0, 46.0), 30.0, 8.0, seed=1000 * seed + ping)
        return points, np.sqrt(2) * amplitudes

    data = np.sqrt(0.8) * np.asarray(true.data) + np.sqrt(0.2) * each_ping(true, new)
    return true.replace(data=data), claim.replace(data=data), {}


def deeper(true, claim, seed):
    return true, claim, {"seabed": 10.0}


def shallower(true, claim, seed):
    return true, claim, {"seabed": 6.0}


def faster(true, claim, seed):
    return true, claim.replace(c=1515.0), {}


@pytest.mark.parametrize(
    ("trouble", "most", "decibels"),
    [
        (plain, 0.5, 0.4), (lost, 0.5, 0.4), (gap, 1.5, 2.0), (fish, 0.8, 0.8), (ghost, 0.5, 0.4), (decorrelated, 2.2, 6.0),
        (deeper, 1.0, 1.2), (shallower, 1.2, 1.5), (faster, 2.2, None),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)  # fmt: skip
def test_trouble(trouble, most, decibels):
    """Of 40 pings, K = 4, SNR 30: what remains, which is never more than was claimed."""
    rows = []
    for seed in SEEDS:
        true, claim, truth = scenes(("pings", 40), ("seed", seed))
        true, claim, more = trouble(true, claim, seed)
        fixed = navigate(claim, **more).apply(claim)
        lost_ = [loss(e, true, truth.targets) if decibels else np.nan for e in (claim, fixed)]
        rows.append((slant(claim, true), slant(fixed, true), *lost_))
        assert rows[-1][1] < rows[-1][0]
    found = worst(f"40 pings, {trouble.__name__}: claimed mm, found mm; dB", rows)
    assert found[1] < most and (decibels is None or found[3] < decibels)


def test_near_range():
    """6 to 16 m, 4 m above the seabed."""
    rows = []
    for seed in SEEDS:
        true, claim, truth = scene(pings=40, swath=(6.0, 16.0), height=4.0, targets=((-1.0, 9.0), (0.4, 12.0)), seed=seed)
        fixed = navigate(claim, 4.0).apply(claim)
        rows.append((slant(claim, true, 12.0, 4.0), slant(fixed, true, 12.0, 4.0), loss(fixed, true, truth.targets)))
    _, error, decibels = worst("40 pings, 6 to 16 m: claimed mm, found mm, dB", rows)
    assert error < 1.2 and decibels < 0.3


def test_the_loss_that_is_told_is_what_images_lose():
    """Lines longer than an aperture: over its 40 pings the slant error is what `loss` says, on average over three of them."""
    told, measured = [], []
    for seed in (1, 2, 3):
        true, claim, _ = motion_scenes.scene(
            pings=100, swath=(20.0, 34.0), density=30.0, targets=(), seed=seed, snr_db=15.0
        )  # fmt: skip
        motion = pysas.micronavigate(claim, seabed=8.0, elements=(0.10, 0.05))
        fixed = motion.apply(claim)
        parts = [slice(start, start + 40) for start in range(0, 61, 3)]
        wrong = [pysas.metrics.track_error(fixed[part], true[part], 27.0, seabed=8.0) for part in parts]
        told.append(motion.loss[1])
        measured.append(4.34 * (4 * np.pi / 0.015) ** 2 * np.mean(np.square(wrong)))
    print(f"\n100 pings: dB told, measured: {np.mean(told):.3g}, {np.mean(measured):.3g}")
    assert 0.5 < np.mean(measured) / np.mean(told) < 2
