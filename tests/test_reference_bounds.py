"""Bounds of what a track's echoes tell, against Monte Carlo and closed forms; numbers beside them were computed by hand."""

import numpy as np
import pytest

from pysas.reference import bounds

pytestmark = pytest.mark.reference

WAVE, BAND = 0.015, 20e3
ELEMENTS = (0.1, 0.05)
RNG = 1


def gaussian(rng, *shape):
    return rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2)


@pytest.mark.parametrize("gamma", [0.998, 0.9, 0.6])
def test_phase_noise_is_what_correlated_gaussian_pairs_have(gamma):
    """256 samples in a window, 10000 windows: the standard deviation itself is known to 0.7 %."""
    rng = np.random.default_rng(RNG)
    a, other = gaussian(rng, 10000, 256), gaussian(rng, 10000, 256)
    b = gamma * np.exp(0.7j) * a + np.sqrt(1 - gamma**2) * other
    found = np.angle(np.sum(b * a.conj(), axis=1)) - 0.7
    window = 256 * 1500.0 / (2 * BAND)
    bound = bounds.phase_noise(gamma, window=window, bandwidth=BAND)
    assert abs(found.mean()) < 4 * bound / 100
    assert found.std() == pytest.approx(bound, rel=0.025)
    assert found.std() > 0.975 * bound  # a bound: nothing may be below it


def test_fisher_information_by_differences():
    """trace(C^-1 dC C^-1 dC) of the covariance of one pair, by finite differences of C."""
    gamma, phi, h = 0.7, 0.3, 1e-5

    def covariance(phase):
        g = gamma * np.exp(1j * phase)
        return np.array([[1, g], [g.conjugate(), 1]])

    slope = np.linalg.solve(covariance(phi), (covariance(phi + h) - covariance(phi - h)) / (2 * h))
    window = 1500.0 / (2 * BAND)  # one sample
    found = bounds.phase_noise(gamma, window=window, bandwidth=BAND)
    assert found == pytest.approx(1 / np.sqrt(np.trace(slope @ slope).real), rel=1e-8)


def test_phase_noise_in_numbers():
    """gamma 0.6 over 2.5 m: N = 2 x 20000 x 2.5/1500 = 66.7; sqrt(0.64/(2 x 66.7 x 0.36)) = 0.1155 rad, 0.138 mm."""
    found = bounds.phase_noise(0.6, window=2.5, bandwidth=BAND)
    assert found == pytest.approx(0.11547, rel=1e-4)
    assert bounds.slant_noise(found, WAVE) == pytest.approx(1.3783e-4, rel=1e-4)


def test_slant_noise_of_a_whole_turn_is_half_a_wavelength():
    assert bounds.slant_noise(2 * np.pi, WAVE) == pytest.approx(WAVE / 2)


@pytest.mark.parametrize("pairs", [2, 3, 4, 6, 8])
def test_yaw_noise_is_that_of_a_fitted_line(pairs):
    rng = np.random.default_rng(RNG)
    places = 0.025 * np.arange(pairs)
    values = 8e-6 * rng.standard_normal((pairs, 40000))
    slopes = np.polyfit(places, values, 1)[0]
    assert slopes.std() == pytest.approx(bounds.yaw_noise(8e-6, pairs=pairs, spacing=0.025), rel=0.015)


def test_drift_is_that_of_a_heading_that_walks():
    """Sway of each ping advances by the mean heading of the two times the advance; 20000 tracks."""
    rng = np.random.default_rng(RNG)
    heading = np.cumsum(200e-6 * rng.standard_normal((20000, 40)), axis=1)
    heading = np.concatenate([np.zeros((20000, 1)), heading], axis=1)
    sway = np.cumsum(0.2 * (heading[:, 1:] + heading[:, :-1]) / 2, axis=1)
    n = np.array([5, 10, 20, 40])
    assert sway[:, n - 1].std(axis=0) == pytest.approx(bounds.drift(200e-6, advance=0.2, pings=n), rel=0.02)


def test_coherence_is_the_convolution_of_two_triangles():
    """What the transform of sinc^2 sinc^2 is; the pattern beyond the horizon has 1e-5 of its power."""
    step = 1e-4
    x = np.arange(-2000, 2001) * step
    triangles = [np.maximum(0, 1 - np.abs(x) / length) for length in ELEMENTS]
    both = np.convolve(*triangles, mode="same")
    s = np.array([0.0, 0.0125, 0.02, 0.025, 0.05, 0.06, 0.075, 0.09])
    found = bounds.coherence(s, elements=ELEMENTS, wavelength=WAVE)
    assert found == pytest.approx(np.interp(2 * s, x, both / both.max()), abs=2e-4)
    assert found[[0, 1, 3, 4]] == pytest.approx([1, 0.875, 0.600, 0.100], abs=5e-4)


def test_coherence_of_scatterers_seen_from_two_places():
    """Scatterers spread evenly in the sine of the angle, seen two-way from places s apart by both elements."""
    rng = np.random.default_rng(RNG)
    u = rng.uniform(-0.6, 0.6, (4000, 200))
    seen = gaussian(rng, 4000, 200) * np.sinc(0.1 * u / WAVE) * np.sinc(0.05 * u / WAVE)
    one = seen.sum(axis=1)
    for s in (0.0125, 0.025, 0.05):
        other = np.sum(seen * np.exp(4j * np.pi / WAVE * s * u), axis=1)
        found = np.vdot(one, other) / np.sqrt(np.vdot(one, one) * np.vdot(other, other))
        assert abs(found - bounds.coherence(s, elements=ELEMENTS, wavelength=WAVE)) < 0.03  # 2/sqrt(4000)


def test_coherence_between_an_omnidirectional_element_and_one_of_length_d():
    s = np.linspace(0, 0.06, 7)
    found = bounds.coherence(s, elements=(0.1, 0.0), wavelength=WAVE / 10)
    # of sinc(x)^2 about 1/(pi^2 x) lies beyond x = 67, the horizon
    assert found == pytest.approx(np.maximum(0, 1 - s / 0.05), abs=2e-3)


def test_peak_loss_is_that_of_pings_out_of_phase():
    rng = np.random.default_rng(RNG)
    for part, loss in ((100, 0.0686), (50, 0.2743), (32, 0.6697), (16, 2.679)):  # 4.3429 (4 pi/part)^2
        error = WAVE / part * rng.standard_normal(200000)
        peak = abs(np.mean(np.exp(4j * np.pi / WAVE * error)))
        found = bounds.peak_loss(WAVE / part, WAVE)
        assert found == pytest.approx(-20 * np.log10(peak), abs=0.02)
        assert found == pytest.approx(loss, rel=1e-3)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match=r"coherence=1\.1"):
        bounds.phase_noise(1.1, window=2.5, bandwidth=BAND)
    with pytest.raises(ValueError, match="window=0"):
        bounds.phase_noise(0.9, window=0, bandwidth=BAND)
    with pytest.raises(ValueError, match="pairs"):
        bounds.yaw_noise(1e-6, pairs=1, spacing=0.025)
    with pytest.raises(ValueError, match=r"pings=-1"):
        bounds.drift(1e-4, advance=0.2, pings=-1)
    with pytest.raises(ValueError, match="wavelength"):
        bounds.peak_loss(1e-3, 0.0)
