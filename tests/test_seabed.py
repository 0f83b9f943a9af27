"""Scatterers of a seabed: where they lie, how their echoes are distributed, and how alike echoes of displaced arrays are."""

from __future__ import annotations

from typing import Any

import motion_scenes
import numpy as np
import pytest
from scipy.integrate import quad

import pysas
from pysas.motion.moving import moved
from pysas.signal.simulation import seabed


def test_scatterers_lie_as_asked() -> None:
    """Even over the rectangle, Gaussian in z and in amplitude; 90,000 of them: 0.24 % of scatter in a standard deviation."""
    points, amplitudes = seabed((-20.0, 30.0), (10.0, 40.0), depth=8.0, roughness=0.2, seed=4)
    n = 60 * 50 * 30
    assert points.shape == (n, 3) and amplitudes.shape == (n,)
    assert points.dtype == np.float64 and amplitudes.dtype == np.complex128
    count, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=(10, 10), range=((-20, 30), (10, 40)))
    assert count.sum() == n
    # chi-squared of 99 degrees of freedom: 99 +- 14
    assert 50 < np.sum((count - n / 100) ** 2) / (n / 100) < 160
    assert points[:, 2].mean() == pytest.approx(8.0, abs=4 * 0.2 / np.sqrt(n))
    assert points[:, 2].std() == pytest.approx(0.2, rel=0.01)
    for part in (amplitudes.real, amplitudes.imag):
        assert part.mean() == pytest.approx(0.0, abs=4 / np.sqrt(2 * n))
        assert part.std() == pytest.approx(np.sqrt(0.5), rel=0.01)
        assert np.mean(part**4) / np.mean(part**2) ** 2 == pytest.approx(3, rel=0.05)
    assert abs(np.mean(amplitudes**2)) < 4 / np.sqrt(n)
    assert abs(np.corrcoef(points.T) - np.eye(3)).max() < 4 / np.sqrt(n)


def test_seabed_is_repeatable() -> None:
    one, again, other = (seabed((0, 5), (0, 5), seed=seed) for seed in (1, 1, 2))
    for first, second, third in zip(one, again, other, strict=True):
        np.testing.assert_array_equal(first, second)
        assert np.all(first != third)
    flat = seabed((0, 5), (0, 5), roughness=0.0, depth=-2.0, seed=1)
    np.testing.assert_array_equal(flat[0][:, 2], -2.0)
    np.testing.assert_array_equal(flat[0][:, :2], one[0][:, :2])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"x": (1.0, 1.0)}, ValueError, r"x=\(1.0, 1.0\): expected the least coordinate, then a larger one"),
        ({"y": (2.0, 1.0)}, ValueError, r"y=\(2.0, 1.0\)"),
        ({"y": (0.0, np.nan)}, ValueError, "y: nan at"),
        ({"x": 3.0}, ValueError, r"x: expected shape \(2,\)"),
        ({"x": "ab"}, TypeError, "x: expected real numbers"),
        ({"density": 0.0}, ValueError, "density=0.0"),
        ({"density": 0.01}, ValueError, r"density=0.01: 0.06 scatterers on x=\(0, 2\), y=\(0, 3\): expected 1 to 1e\+08"),
        ({"density": 1e9}, ValueError, r"density=1000000000.0: 6e\+09 scatterers"),
        ({"density": np.inf}, ValueError, "density=inf"),
        ({"roughness": -0.1}, ValueError, "roughness=-0.1"),
        ({"depth": np.nan}, ValueError, "depth=nan"),
        ({"seed": -1}, ValueError, "seed=-1"),
    ],
)
def test_rejected(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        seabed(**({"x": (0, 2), "y": (0, 3)} | changes))


def test_speckle_of_the_record_is_developed() -> None:
    """16 pings a beam's width apart, each over 10 m of range: intensity is exponential, in quadrature alike."""
    echoes, _, _ = motion_scenes.scene(
        16, 0, 1, advance=1.0, snr_db=None, targets=(), swath=(30.0, 40.0), sway=0.0, heave=0.0, yaw=0.0, surge=0.0, seed=2
    )
    samples = echoes.data[:, 0, 30:-60].astype(complex)
    samples /= np.sqrt(np.mean(np.abs(samples) ** 2, axis=0, keepdims=True).mean())
    intensity = np.abs(samples) ** 2
    independent = samples.size * motion_scenes.BAND / motion_scenes.FS
    assert pysas.metrics.sharpness(samples) == pytest.approx(2, abs=4 * np.sqrt(20 / independent))
    for level in (0.1, 0.5, 1.0, 2.0, 4.0):
        share = np.exp(-level)  # of intensities above `level` means
        assert np.mean(intensity > level) == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / independent))
    assert abs(np.mean(samples**2)) < 4 / np.sqrt(independent)


def patch(density: float, targets: Any = (), seed: int = 0) -> pysas.Image:
    """Two by one metre, 30 m away, from 3.2 m of track."""
    grid = pysas.Grid.plane(np.arange(-40, 40) * 0.025, 28.8 + np.arange(60) * 0.02, z=8.0)
    asked: dict[str, Any] = {"snr_db": None, "swath": (29.0, 32.0), "targets": targets, "density": density, "seed": seed}
    echoes, _, _ = motion_scenes.scene(16, 0, 8, **asked)
    return pysas.backproject(echoes, grid, 1e-3)


def test_speckle_of_the_image_is_as_developed_as_scatterers_are_dense() -> None:
    """Contrast is 2 + 2 F/density, F the integral of |h|^4 over the square of that of |h|^2 for a point's response h.

    That is Campbell's theorem for a Poisson process with Gaussian amplitudes (E |a|^4 = 2). With F = 4/9 per cell (two
    sincs), n scatterers a cell: 2 + 0.89/n.
    """
    point = np.abs(patch(0.0, ((0.0, 29.4),)).data) ** 2
    factor = float(np.sum(point**2) / np.sum(point) ** 2 / (0.025 * 0.02))
    assert factor * 0.075 * 0.0375 == pytest.approx(4 / 9, rel=0.2)
    # their scatter: 500 scatterers a patch, then 300 cells
    for density, seeds, tolerance in ((200.0, 3, 0.2), (1000.0, 2, 0.15)):
        found = [pysas.metrics.sharpness(patch(density, seed=seed)) for seed in range(seeds)]
        assert np.mean(found) == pytest.approx(2 + 2 * factor / density, rel=tolerance)
    assert pysas.metrics.sharpness(patch(200.0, ((0.0, 29.4),))) > 30


@pytest.mark.parametrize(("overlap", "separation"), [(4, 0.0), (4.5, 0.0125), (5, 0.025), (6, 0.05)])
def test_echoes_of_displaced_phase_centres_are_as_alike_as_theory_says(overlap: float, separation: float) -> None:
    """Coherence at separation s is the Fourier transform of the two-way power pattern at 2 s/wavelength (van Cittert-Zernike).

    The pattern is [sinc(Dt u/wavelength) sinc(Dr u/wavelength)]^2 up to the transmitter's null; 1, 0.875, 0.60, 0.10.
    """
    advance = (12 - overlap) * motion_scenes.D / 2
    echoes, _, _ = motion_scenes.scene(
        16, advance=advance, snr_db=None, targets=(), sway=0.0, heave=0.0, yaw=0.0, surge=0.0, swath=(25.0, 40.0), seed=6
    )
    shift = 8  # of channels from ping to ping: phase centres 4 d apart in an advance of 4 d, and `separation` off otherwise
    one, other = echoes.data[:-1, shift:, 40:-60].astype(complex), echoes.data[1:, :-shift, 40:-60].astype(complex)
    # windows of 1 m: paths of unlike baselines differ by b^2/(4 r), slowly along range
    size = 40
    count = one.shape[-1] // size
    one, other = (a[..., : size * count].reshape(*a.shape[:2], count, size) for a in (one, other))
    cross = np.abs(np.sum(one * other.conj(), axis=-1))
    power = np.sqrt(np.sum(np.abs(one) ** 2, axis=-1) * np.sum(np.abs(other) ** 2, axis=-1))
    independent = size * motion_scenes.BAND / motion_scenes.FS
    squared = np.mean((cross / power) ** 2)
    found = np.sqrt(max((squared - 1 / independent) / (1 - 1 / independent), 0.0))
    wavelength = motion_scenes.C / motion_scenes.FC

    def pattern(u: float) -> float:
        return float((np.sinc(motion_scenes.TX * u / wavelength) * np.sinc(motion_scenes.RX * u / wavelength)) ** 2)

    edge = wavelength / motion_scenes.TX
    whole = quad(pattern, 0, edge)[0]
    expected = quad(lambda u: pattern(u) * np.cos(4 * np.pi * separation * u / wavelength), 0, edge)[0] / whole
    assert found == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("snr_db", [20.0, 0.0])
def test_scene_has_the_noise_asked_for(snr_db: float) -> None:
    """In the compressed record, within what cut pulses at the swath's ends make of it; none outside the band."""
    asked: dict[str, Any] = {"swath": (25.0, 35.0), "seed": 1}
    clean, noisy = (motion_scenes.scene(8, snr_db=level, **asked)[0].data for level in (None, snr_db))
    noise = noisy - clean
    assert 10 * np.log10(np.mean(np.abs(clean) ** 2) / np.mean(np.abs(noise) ** 2)) == pytest.approx(snr_db, abs=0.4)


@pytest.mark.parametrize("side", [1, -1])
def test_scene_s_correction_moves_the_claim_to_the_truth(side: int) -> None:
    """Positions and beams to rounding; velocities as far as differences of positions tell."""
    echoes, claimed, truth = motion_scenes.scene(40, crab=0.05, side=side, density=0.0, seed=2)
    found = moved(claimed, truth.shift, truth.yaw)
    np.testing.assert_allclose(found.tx, echoes.tx, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.receivers, echoes.receivers, rtol=0, atol=1e-13)
    assert found.beam is not None and echoes.beam is not None
    np.testing.assert_allclose(found.beam.boresights, echoes.beam.boresights, rtol=0, atol=1e-13)
    assert np.sign(echoes.beam.boresights[0, 1]) == side and np.sign(truth.targets[0, 1]) == side
    np.testing.assert_array_equal(claimed.data, echoes.data)
    assert pysas.metrics.track_error(found, echoes, 30.0) < 1e-13 < 2e-3 < pysas.metrics.track_error(claimed, echoes, 30.0)
    # third derivatives of 40 mm over 3 m at 1.5 m/s: 2e-5 m/s; at the ends one-sided differences, second ones, 1e-3
    np.testing.assert_allclose(found.receiver_velocity[1:-1], echoes.receiver_velocity[1:-1], rtol=0, atol=2e-4)


@pytest.mark.parametrize(("side", "crab"), [(1, 0.15), (1, -0.15), (-1, 0.15), (-1, -0.15)])
def test_scene_s_seabed_fills_the_beam_of_every_ping(side: int, crab: float) -> None:
    """The ends of a short line hear as much as its middle, crabbing by a half-angle."""
    echoes, _, _ = motion_scenes.scene(9, 4, 6, side=side, crab=crab, snr_db=None, targets=(), density=20.0, seed=7)
    power = np.mean(np.abs(echoes.data[..., 50:-80]) ** 2, axis=(1, 2))
    # some 600 independent samples a ping: 4 % of scatter; a bare half of the beam would show as 50 %
    np.testing.assert_allclose(power / power.mean(), 1, atol=0.2)
