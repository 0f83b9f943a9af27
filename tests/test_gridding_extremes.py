"""Gridding, frames and FTCG where they are ill-posed: nothing returns NaN, and what is undetermined is said."""

import re

import gridding_scenes as scenes
import numpy as np
import pytest

from pysas.reference import Frame, Gaussian, Gridding, KaiserBessel, Sampling, Synthesis, ftcg, pipe_menon, rasters, voronoi
from pysas.reference.rasters import asterisk, jittered, sector

pytestmark = pytest.mark.reference

WINDOW = Gaussian()
EPS = np.finfo(float).eps


def everything(points, modes, data, r=2):
    """Coefficients by every method, all finite, and the flags of those that state one."""
    found, flags = {}, {}
    for name, weights in (("voronoi", voronoi(points)), ("pipe-menon", pipe_menon(points))):
        assert np.all(weights > 0) and np.isfinite(weights).all()
        found[name] = Gridding(points, modes, WINDOW) @ (weights * data)
    frame = Frame(points, modes, WINDOW)
    for method in ("svd", "lsmr"):
        found[method] = frame.solve(data, method=method, iterations=200).coefficients
    flags["svd"] = frame.ill_posed
    options = [("lsq", "nearest", False), ("lsq", "index", False), ("lsq", "nearest", True), ("printed", "index", False)]
    for method, band, parts in [*options, ("joint", "nearest", False)]:
        made = ftcg.design(points, modes, WINDOW, r, method=method, band=band, parts=parts, threads=1)
        found[method, band, parts] = made.coefficients(data)
        flags[method, band, parts] = made.ill_posed
    for name, c in found.items():
        assert np.isfinite(c).all(), name
    low, high = frame.bounds
    assert 0 <= low <= high < np.inf and frame.condition >= 1
    return found, flags


@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-10, 1e-13, 1e-15, 0.0])
def test_condition_numbers_up_to_the_inverse_of_eps(gap):
    # as many samples as modes; two of them approach, and the condition grows as 1/gap
    points = jittered(21, 1, 0.2)[:, 0]
    points[11] = points[10] + gap
    frame = Frame(points, 10, WINDOW)
    if gap > 1e-14:
        assert 0.3 / gap < frame.condition < 100 / gap
    # rule: singular values below max(M, L) eps of the largest are dropped
    s = frame.singular_values
    assert frame.rank == np.count_nonzero(s > 21 * EPS * s[0]) == (21 if gap > 1e-14 else 20)
    c = scenes.noise(21)
    found = frame.solve(frame.sampling @ c)
    assert found.ill_posed == (frame.rank < 21) == frame.ill_posed
    assert found.residual < 1e-10 and np.linalg.norm(found.coefficients) < 1.01 * np.linalg.norm(c) + 1e-14 / max(gap, 1e-14)
    regular = Frame(points, 10, WINDOW, rcond=1e-8)
    assert regular.rank == (21 if gap > 1e-7 else 20) and regular.solve(frame.sampling @ c).residual < 1e-6


@pytest.mark.parametrize("points", [jittered(25, 1), jittered(8)], ids=["1-D", "2-D"])
def test_duplicated_samples_change_nothing(points):
    modes = 10 if points.shape[1] == 1 else 3
    twice = np.concatenate([points, points[::3]])
    data = scenes.noise(len(points))
    both = np.concatenate([data, data[::3]])
    weights = np.concatenate([np.where(np.arange(len(points)) % 3 == 0, 0.5, 1.0), np.full(len(points[::3]), 0.5)])
    alone = Frame(points, modes, WINDOW).solve(data).coefficients
    found = Frame(twice, modes, WINDOW, weights=weights).solve(both).coefficients
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-11 * np.abs(alone).max())
    gridded = Gridding(points, modes, WINDOW) @ (voronoi(points) * data)
    again = Gridding(twice, modes, WINDOW) @ (voronoi(twice) * both)
    np.testing.assert_allclose(again, gridded, rtol=0, atol=1e-6 * np.abs(data).max())
    everything(twice, modes, both)


def test_empty_regions_of_the_spectrum():
    points = jittered(31, 1)
    points = points[np.abs(points[:, 0]) > 5]
    data = scenes.noise(len(points))
    _, flags = everything(points, 12, data)
    assert flags["svd"] and flags["lsq", "nearest", False] and Frame(points, 12, WINDOW).condition > 1e6
    two = sector(9, 7, np.pi / 6, 8.0, 16.0)
    _, flags = everything(two, 5, scenes.noise(len(two)))
    assert all(flags.values())
    # modes where nothing was sampled stay 0: least norm
    away = jittered(11, 1) + 40
    np.testing.assert_allclose(Gridding(away, 5, WINDOW) @ scenes.noise(11), 0)
    everything(away, 5, scenes.noise(11))


def test_one_sample():
    for points in ([[0.3]], [[0.3, -0.2]]):
        found, flags = everything(np.array(points), 1, np.array([2.0 + 1j]))
        assert all(flags.values())
        frame = Frame(points, 1, WINDOW)
        np.testing.assert_allclose(frame.sampling @ found["svd"], [2.0 + 1j], rtol=1e-12)
        everything(np.array(points), 0, np.array([1.0]))


def test_a_band_wider_than_the_data_is_full():
    points, data = jittered(7), scenes.noise(49)
    full = Frame(points, 2, WINDOW).solve(data).coefficients
    for band in ftcg.BANDS:
        made = ftcg.design(points, 2, WINDOW, 1000, band=band)
        assert made.matrix.nnz == 49 * 49
        np.testing.assert_allclose(made.coefficients(data), full, rtol=0, atol=1e-9 * np.abs(full).max())


@pytest.mark.parametrize("jitter", [0.25, 0.5, 1.0, 3.0])
def test_jitter_beyond_a_quarter(jitter):
    points = jittered(25, 1, jitter, seed=2)
    data = scenes.samples(lambda x: np.exp(np.cos(np.pi * x)), points)
    everything(points, 9, data)
    frame = Frame(points, 9, WINDOW)
    found = frame.solve(data)
    if jitter <= 0.25:
        assert frame.condition < 20 and not found.ill_posed
    else:
        assert frame.condition > Frame(jittered(25, 1, 0.25, seed=2), 9, WINDOW).condition
    # what is determined is fitted whatever the raster
    assert found.residual < 0.02


@pytest.mark.parametrize("snr", [60, 40, 20, 0])
def test_noise_is_amplified_by_no_more_than_the_frame_bound(snr):
    points = jittered(12, seed=3)
    frame, made = Frame(points, 5, WINDOW), ftcg.design(points, 5, WINDOW, 7)
    clean = frame.sampling @ scenes.noise(121, 1)
    noise = scenes.noise(144, 2)
    noise *= np.linalg.norm(clean) / np.linalg.norm(noise) * 10 ** (-snr / 20)
    moved = frame.solve(clean + noise).coefficients - frame.solve(clean).coefficients
    assert np.linalg.norm(moved) <= np.linalg.norm(noise) / frame.singular_values[-1] * (1 + 1e-9)
    # white noise excites all singular values alike: rms over them is what it is worth on average
    expected = np.linalg.norm(noise) / np.sqrt(144) * np.linalg.norm(1 / frame.singular_values)
    assert np.linalg.norm(moved) == pytest.approx(expected, rel=0.25)
    banded = made.coefficients(clean + noise) - made.coefficients(clean)
    assert np.linalg.norm(banded) <= np.linalg.norm(noise) * np.linalg.norm(made.gridding.sparse @ made.matrix.toarray(), 2)


def test_zero_data_and_weights():
    points = jittered(6)
    frame = Frame(points, 2, WINDOW, weights=np.zeros(36))
    assert frame.rank == 0 and frame.ill_posed and frame.condition == np.inf
    assert not frame.solve(np.ones(36)).coefficients.any()
    for method in ("svd", "lsmr"):
        found = Frame(points, 2, WINDOW).solve(np.zeros(36), method=method)
        assert not found.coefficients.any() and found.residual == 0


BAD = {
    "points: no samples": lambda: voronoi(np.zeros((0, 2))),
    "points: expected shape": lambda: voronoi(np.zeros((3, 3))),
    "points: nan at sample 1": lambda: Frame([0.0, np.nan], 1, WINDOW),
    "modes=(1, 2): expected one number": lambda: Gridding([0.0], (1, 2), WINDOW),
    "modes=-1: expected": lambda: Gridding([0.0], -1, WINDOW),
    "s=0: expected": lambda: Gaussian(0),
    "reach=-1.0: expected": lambda: KaiserBessel(-1.0),
    "beta=3.0: expected more than": lambda: KaiserBessel(4.0, 3.0),
    "size=4: expected at least 5": lambda: Synthesis((2,), 4, WINDOW),
    "size=(5, 5): expected one": lambda: Synthesis((2,), (5, 5), WINDOW),
    "weights: -1 at sample 1": lambda: Frame([0.0, 1.0], 1, WINDOW, weights=[1.0, -1.0]),
    "rcond=2": lambda: Frame([0.0], 1, WINDOW, rcond=2),
    "data: expected shape (2,)": lambda: Frame([0.0, 1.0], 1, WINDOW).solve([1.0]),
    "data: nan at sample 1": lambda: Frame([0.0, 1.0], 1, WINDOW).solve([1.0, np.nan]),
    "method='qr'": lambda: Frame([0.0], 1, WINDOW).solve([1.0], method="qr"),
    "r=-1": lambda: ftcg.design([0.0], 1, WINDOW, -1),
    "band='near'": lambda: ftcg.design([0.0], 1, WINDOW, 1, band="near"),
    "method='joint': 1000 samples": lambda: ftcg.design(jittered(1000, 1), 9, WINDOW, 1, method="joint", parts=True),
    "method='joint': 8980 entries": lambda: ftcg.design(jittered(1000, 1), 1, WINDOW, 4, method="joint", band="index"),
    "use method='lsmr'": lambda: Frame(jittered(60), 28, WINDOW).solve(np.zeros(3600)),
    "jitter=-1": lambda: jittered(3, jitter=-1),
    "dimensions=3": lambda: jittered(3, 3),
    "extent=0": lambda: asterisk(3, 3, 0),
    "inner=3: expected less": lambda: sector(3, 3, 1.0, 3.0, 2.0),
    "iterations=0": lambda: pipe_menon([0.0], 0),
}


@pytest.mark.parametrize("message", BAD)
def test_one_clear_error(message):
    with pytest.raises(ValueError, match=re.escape(message)):
        BAD[message]()


def test_wrong_types():
    for call in (
        lambda: Sampling(["a"], 1, WINDOW),
        lambda: Frame([0.0], 1.5, WINDOW),
        lambda: Frame([0.0], 1, WINDOW).solve(["x"]),
    ):
        with pytest.raises(TypeError):
            call()


def test_rasters():
    assert np.abs(jittered(9, 1, 0.0)[:, 0] - np.arange(-4, 5)).max() == 0
    assert jittered(4, seed=1).tolist() == jittered(4, seed=1).tolist() != jittered(4, seed=2).tolist()
    spokes = asterisk(3, 5, 2.0)
    np.testing.assert_allclose(np.linalg.norm(spokes, axis=1), np.tile([2, 1, 0, 1, 2], 3), atol=1e-12)
    part = sector(5, 4, 0.5, 3.0, 6.0)
    np.testing.assert_allclose(part.min(axis=0), -part.max(axis=0), atol=1e-12)
    # its width is 2 outer sin(half_angle), its height outer - inner cos(half_angle)
    np.testing.assert_allclose(np.ptp(part, axis=0), [12 * np.sin(0.5), 6 - 3 * np.cos(0.5)], atol=1e-12)
    for raster in (rasters.asterisk(1, 1, 1.0), rasters.sector(1, 1, 0.5, 1.0, 2.0)):
        np.testing.assert_allclose(raster, [[0.0, 0.0]])
