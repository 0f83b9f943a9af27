"""The analytic point spread function: against direct sums and numeric transforms, and against the paper's own figures.

Figures said to be the paper's are printed in Y. Pailhas et al., JASA 141 (2017); its sigma = 2e-2 is a share of the pulse.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, jn_zeros

import pysas
from pysas import circular

pytestmark = pytest.mark.reference

C, FC, BAND, T = 1500.0, 100e3, 20e3, 1e-3
WAVE = C / FC
GAUSS = circular.PointSpread(pysas.LFM(FC, BAND, T, "gaussian", 2e-5), C)
RECT = circular.PointSpread(pysas.LFM(FC, BAND, T), C)
OTHERS = [circular.PointSpread(pysas.LFM(FC, BAND, T, window), C) for window in ("tukey", "taylor")]
NARROW = circular.PointSpread(pysas.LFM(FC, 100e3, 10e-6, "gaussian", 2e-6), C)  # Q = 0.9


def turned(psf, r, n=4096):
    """Eq 19 as printed: the mean over n angles of the demodulated response."""
    x = r[:, None] * np.cos(np.arange(n) * 2 * np.pi / n)
    return np.mean(psf.pulse.response(2 * x / psf.c) * np.exp(4j * np.pi * psf.pulse.fc * x / psf.c), axis=1)


def test_envelopes_are_those_printed():
    t = np.linspace(-0.9, 0.9, 91) * T
    r = C * t / 2
    rect = np.sinc(t * BAND * (1 - np.abs(t) / T)) * (1 - np.abs(t) / T)  # Eq 17 over T
    np.testing.assert_allclose(RECT.envelope(r), rect, atol=1e-15)
    sigma = 2e-5
    np.testing.assert_allclose(
        GAUSS.envelope(r / 20), np.exp(-(1 / (4 * sigma**2) + (np.pi * BAND / T * sigma) ** 2) * (t / 20) ** 2), atol=1e-14
    )  # Eq 18 over sigma sqrt(pi)
    # Eq 27: a0 = 21.19 mm = 1.412 wavelengths
    assert GAUSS.gaussian_width / WAVE == pytest.approx(1.4124, abs=5e-5)
    np.testing.assert_allclose(GAUSS.envelope(r), np.exp(-(r**2) / (2 * GAUSS.gaussian_width**2)), rtol=1e-12)


@pytest.mark.parametrize("psf", [GAUSS, RECT, *OTHERS, NARROW], ids=lambda psf: repr(psf.pulse))
def test_envelope_is_the_autocorrelation(psf):
    """Eq 11 by a plain sum over the pulse."""
    low, high = psf.pulse.support
    t = np.linspace(low, high, 100_001)
    for lag in np.array([0.0, 0.013, 0.11, 0.4]) * (high - low):
        carrier = np.exp(-2j * np.pi * psf.pulse.rate * (t - (low + high) / 2) * lag)
        product = psf.pulse.envelope(t) * psf.pulse.envelope(t - lag) * carrier
        total = np.trapezoid(product, t) * np.exp(1j * np.pi * psf.pulse.rate * lag**2)
        assert abs(total / psf.pulse.energy - psf.envelope(lag * C / 2)) < 2e-5


@pytest.mark.parametrize("psf", OTHERS, ids=lambda psf: psf.pulse.window)
def test_tabulated_envelopes(psf):
    t = np.concatenate([[0.0, T, -T, 1.2 * T, 1e-9 * T], np.random.default_rng(0).uniform(-T, T, 300)])
    np.testing.assert_allclose(psf.envelope(t * C / 2), psf.pulse.response(t), atol=1e-8)


@pytest.mark.parametrize(("bandwidth", "taper"), [(1.0, 0.1), (1.0, 1.0), (BAND, 0.003), (-50.0, 0.3)])
def test_tabulated_envelopes_follow_the_edges(bandwidth, taper):
    """A tone's response has no period of its bandwidth to go by; a sharp taper turns within its own length."""
    psf = circular.PointSpread(pysas.LFM(FC, bandwidth, T, "tukey", taper), C)
    t = T * np.concatenate([np.linspace(0, 1, 60), taper * np.linspace(0, 1, 20), 1 - taper * np.linspace(0, 1, 20)])
    np.testing.assert_allclose(psf.envelope(t * C / 2), psf.pulse.response(t), atol=1e-8)


@pytest.mark.parametrize("psf", [GAUSS, NARROW], ids=("Q = 7.5", "Q = 0.9"))
def test_exact_is_the_mean_over_the_circle(psf):
    r = np.linspace(0, 8, 201) * WAVE
    np.testing.assert_allclose(psf.exact(r), turned(psf, r), atol=1e-13)
    assert psf.exact(0.0) == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("psf", [RECT, *OTHERS], ids=lambda psf: psf.pulse.window)
def test_exact_of_pulses_that_end(psf):
    r = np.array([0.0, 0.2, 1.1, 3.0]) * WAVE
    # their responses have a kink at 0: the trapezoidal rule is right to 1/n^2 only
    np.testing.assert_allclose(psf.exact(r), turned(psf, r, 1024), atol=1e-6)


@pytest.mark.parametrize("waves", (0.3, 2.0, 9.0, 80.0))
def test_exact_of_a_rectangular_window_to_rounding(waves):
    """Adaptive quadrature of Eq 19 over a quarter turn, or over the pulse where it ends sooner."""
    r = waves * WAVE
    first = np.arccos(min(1.0, C * T / 2 / r))

    def integrand(theta):
        x = r * np.cos(theta)
        return float(RECT.pulse.response(2 * x / C) * np.cos(2 * RECT.k * x))

    value, _ = quad(integrand, first, np.pi / 2, limit=2000, epsabs=1e-13, epsrel=0)
    assert RECT.exact(r) == pytest.approx(2 / np.pi * value, abs=1e-12)


def test_exact_beyond_the_pulse():
    reach = C * T / 2
    far = reach * np.array([0.99, 1.5])
    np.testing.assert_allclose(RECT.exact(far), turned(RECT, far, 2**15), atol=1e-6)
    # (2/pi) integral of the response over sqrt(r^2 - x^2), where the root is nearly r
    value, _ = quad(lambda x: float(RECT.envelope(x) * np.cos(2 * RECT.k * x)), 0, reach, limit=2000, epsabs=1e-13)
    assert RECT.exact(20 * reach) == pytest.approx(2 / np.pi * value / (20 * reach), abs=1e-9)


@pytest.mark.parametrize(("psf", "error"), [(GAUSS, 0.0035), (RECT, 0.0039)], ids=("gaussian", "rect"))
def test_approximation(psf, error):
    """Eq 21: 0.35 % of the peak (Gaussian), 0.39 % (rect); Fig 2 shows no difference."""
    r = np.linspace(0, 8, 1601) * WAVE
    assert np.abs(psf.approximate(r) - psf.exact(r)).max() == pytest.approx(error, rel=0.02)


def test_central_peak():
    """Zero to zero 0.3827 wavelengths, 53 % wider than the matched filter's c/(4 fc) (paper: around 50 %)."""
    zero = jn_zeros(0, 1)[0] / (2 * GAUSS.k)
    assert GAUSS.approximate(zero) == pytest.approx(0, abs=1e-15)
    assert 2 * zero / WAVE == pytest.approx(0.3827, abs=1e-4)
    assert 2 * zero / (C / (4 * FC)) == pytest.approx(1.53, abs=2e-3)


@pytest.mark.parametrize(
    ("form", "radii"),
    [("exact", (0.632, 1.296, 1.607, 1.992)), ("asymptotic", (0.674, 1.280, 1.643, 1.957))],
)
def test_resolution(form, radii):
    """Radii of 50, 80, 90, 95 % of the energy; the paper reads 0.75, 1.3, 1.75, 2.0 off its Fig 4."""
    found = [circular.resolution(GAUSS, share, 12 * WAVE, form) / WAVE for share in (0.5, 0.8, 0.9, 0.95)]
    np.testing.assert_allclose(found, radii, atol=2e-3)


def test_resolution_of_a_rectangular_window():
    found = [circular.resolution(RECT, share, 60 * WAVE, "approximate") / WAVE for share in (0.5, 0.8, 0.9, 0.95)]
    np.testing.assert_allclose(found, (0.636, 1.328, 1.995, 4.336), rtol=0.012)


def test_energies():
    """Eq 32: 5.6328e-14, against 5.6373e-14 of Eq 23 and 0.16 % more of Eq 19 (units of the paper)."""
    scale = GAUSS.pulse.energy**2
    assert circular.asymptotic_energy(GAUSS) * scale == pytest.approx(5.6328e-14, rel=1e-5)
    assert circular.energy(GAUSS) * scale == pytest.approx(5.6373e-14, rel=1e-5)
    numeric = 2 * np.pi * quad(lambda r: float(GAUSS.approximate(r) ** 2 * r), 0, 0.2, limit=500, epsabs=0, epsrel=1e-10)[0]
    assert circular.energy(GAUSS) == pytest.approx(numeric, rel=1e-9)
    assert circular.energy_within(GAUSS, 0.2, "approximate") == pytest.approx(numeric, rel=1e-6)
    exact = 2 * np.pi * quad(lambda r: float(GAUSS.exact(r) ** 2 * r), 0, 0.2, limit=500, epsabs=0, epsrel=1e-9)[0]
    assert circular.energy_within(GAUSS, 0.2) == pytest.approx(exact, rel=1e-6)
    assert circular.energy_within(GAUSS, 0.2) / circular.asymptotic_energy(GAUSS) == pytest.approx(1.0016, abs=1e-4)
    # Parseval: the same from the spectrum
    power = quad(lambda q: float(GAUSS.spectrum(q) ** 2 * 2 * np.pi * q), 60, 210, epsabs=0, epsrel=1e-10)[0]
    assert circular.energy_within(GAUSS, 0.2) == pytest.approx(power, rel=1e-6)


def test_diffusion_is_the_error_function_of_the_ratio():
    """Eq 38 with r/a0 for the printed a0 r: at most 0.034 from Eq 33, the oscillations it smooths; as printed 0.999."""
    r = np.linspace(0, 6, 1201) * WAVE
    numeric = circular.energy_within(GAUSS, r, "approximate") / circular.energy(GAUSS)
    formula = circular.energy_within(GAUSS, r, "asymptotic") / circular.asymptotic_energy(GAUSS)
    assert np.abs(numeric - formula).max() == pytest.approx(0.034, abs=1e-3)


def test_energy_of_pulses_shorter_than_a_period():
    """Q = 0.04: the envelope is a hundredth of a wavelength wide, and that is what the samples must follow."""
    short = circular.PointSpread(pysas.LFM(FC, 1e3, 10e-6, "gaussian", 1e-7), C)
    r = np.linspace(0, 0.6 * WAVE, 20_001)
    dense = 2 * np.pi * np.trapezoid(r * short.exact(r) ** 2, r)
    assert circular.energy_within(short, r[-1]) == pytest.approx(dense, rel=1e-5)
    with pytest.warns(UserWarning, match="Eq 21"):
        assert circular.energy_within(short, r[-1], "approximate") == pytest.approx(circular.energy(short), rel=1e-6)
    half = circular.resolution(short, 0.5, r[-1])
    assert circular.energy_within(short, half) == pytest.approx(dense / 2, rel=1e-3)


def test_energy_diffusion_of_an_image():
    step = WAVE / 16
    x = step * np.arange(-64, 65)
    image = GAUSS.exact(np.hypot(x, x[:, None]))
    r = np.linspace(0, 4, 4001) * WAVE
    share = circular.energy_diffusion(image, step, (64, 64), r, 4 * WAVE)
    assert r[np.argmax(share >= 0.8)] / WAVE == pytest.approx(1.301, abs=0.002)
    assert r[np.argmax(share >= 0.95)] / WAVE == pytest.approx(1.993, abs=0.002)


# Spectra


def hankel(function, q, far, n=200_001):
    """Eq 40 by the trapezoidal rule, whose error is at the end r = 0 alone: h^2/12 d/dr (f J0 r) = h^2 f(0)/12."""
    r = np.linspace(0, far, n)
    f = function(r)
    total = np.array([2 * np.pi * np.trapezoid(f * j0(2 * np.pi * r * one) * r, r) for one in q])
    return total + 2 * np.pi * (r[1] ** 2) * f[0] / 12


def test_spectra():
    q = np.linspace(80, 190, 12)
    exact = GAUSS.spectrum(q)
    top = GAUSS.spectrum(GAUSS.ring_radius)
    assert np.abs(hankel(GAUSS.exact, q, 12 * WAVE, 20_001) - exact).max() < 1e-7 * top
    second = GAUSS.spectrum_of_approximation(q)
    assert np.abs(hankel(GAUSS.approximate, q, 12 * WAVE) - second).max() < 1e-9 * top
    asymptotic = GAUSS.spectrum_asymptotic(q)
    assert np.abs(asymptotic / second - 1).max() < 7e-4  # Eq 44 against Eq 43
    a0 = GAUSS.gaussian_width
    closed = a0 / (np.sqrt(2 * np.pi) * q) * np.exp(-2 * (np.pi * a0 * (q - 2 * FC / C)) ** 2)
    np.testing.assert_allclose(exact, closed, rtol=1e-11)
    np.testing.assert_allclose(exact, asymptotic * np.sqrt(GAUSS.ring_radius / q), rtol=1e-12)
    ring = np.linspace(60, 210, 3001)
    difference = np.abs(GAUSS.spectrum_asymptotic(ring) - GAUSS.spectrum(ring)).max() / GAUSS.spectrum(ring).max()
    assert difference == pytest.approx(0.018, abs=1e-3)


def test_ring():
    """Mean radius 2 fc/c and variance 1/(4 pi^2 a0^2); printed: diameter, and four times the variance."""
    q = np.linspace(60, 210, 30_001)
    profile = GAUSS.spectrum_asymptotic(q)
    mean = np.sum(profile * q) / profile.sum()
    variance = np.sum(profile * (q - mean) ** 2) / profile.sum()
    assert mean / GAUSS.ring_radius == pytest.approx(0.9984, abs=1e-4)
    assert variance * (2 * np.pi * GAUSS.gaussian_width) ** 2 == pytest.approx(1.0016, abs=1e-4)


def inverse(psf, q, r):
    """2 pi integral of the spectrum times J0(2 pi q r) q dq, by the trapezoidal rule."""
    spectrum = psf.spectrum(q)
    return [2 * np.pi * np.trapezoid(spectrum * j0(2 * np.pi * q * one) * q, q) for one in r]


SOME = np.array([0.0, 0.1, 0.33, 1.0, 2.0, 3.7]) * WAVE


def test_spectrum_at_low_quality():
    back = inverse(NARROW, np.linspace(0, 5 * NARROW.ring_radius, 20_001)[1:], SOME)
    np.testing.assert_allclose(back, NARROW.exact(SOME), atol=1e-3)


@pytest.mark.parametrize("psf", OTHERS, ids=lambda psf: psf.pulse.window)
def test_spectrum_of_other_windows(psf):
    np.testing.assert_allclose(inverse(psf, np.linspace(103, 163, 601), SOME), psf.exact(SOME), atol=1e-3)


def test_spectrum_of_a_rectangular_window():
    half = 32e3
    q = 2 * (FC + np.linspace(-half, half, 8001)) / C
    back = inverse(RECT, q, SOME)
    # the ends of a chirp of band +-b leave |S|^2 = (1/(f - b)^2 + 1/(f + b)^2)/(4 pi^2) beyond it, on average
    lost = (1 / (half - BAND / 2) + 1 / (half + BAND / 2)) / (2 * np.pi**2 * T)
    assert 1 - back[0] == pytest.approx(lost, rel=0.05)
    np.testing.assert_allclose(back, RECT.exact(SOME), atol=lost)


# Extremes


def test_huge_arguments():
    """k r to 1e6 and b^2 a0^2 to 1e8: I0(5e7) has overflowed long before."""
    sharp = circular.PointSpread(pysas.LFM(1e6, 1e3, 50e-3, "gaussian", 1.9e-3))
    z = (2 * sharp.k * sharp.gaussian_width) ** 2
    assert 1e7 < z < 1e9
    assert circular.energy(sharp) == pytest.approx(circular.asymptotic_energy(sharp), rel=1e-8)
    q = sharp.ring_radius + np.linspace(-2, 2, 9) / (2 * np.pi * sharp.gaussian_width)
    np.testing.assert_allclose(sharp.spectrum_of_approximation(q), sharp.spectrum_asymptotic(q), rtol=1e-7)
    r = np.array([0.0, 1e-6, 1e-3, 1.0, 250.0])
    assert 2 * sharp.k * r[-1] > 1e6
    np.testing.assert_allclose(sharp.exact(r[:4]), sharp.approximate(r[:4]), atol=2e-4)
    assert np.isfinite(sharp.exact(r)).all() and abs(sharp.exact(r)[-1]) < 1e-12


def test_exact_where_k_r_is_a_million():
    """Within the envelope: Eq 19 by the trapezoidal rule in extended precision, at k r = 5e5; Eq 21 beside it."""
    tone = circular.PointSpread(pysas.LFM(1e6, 1.0, 1.0, "gaussian", 0.2))
    r, a0 = 119.0, tone.gaussian_width
    turn = 2 * np.arctan2(np.longdouble(0), np.longdouble(-1))
    n = int(2.5 * tone.k * r) // 4 * 4
    x = r * np.cos((np.arange(n // 4) + np.longdouble(0.5)) * (turn / n))
    mean = np.mean(np.exp(-((x / a0) ** 2) / 2) * np.cos(turn * (2 * tone.pulse.fc / tone.c * x)))
    assert tone.exact(r) == pytest.approx(float(mean), abs=1e-12)
    assert tone.approximate(r) == pytest.approx(tone.exact(r), rel=1e-5)
    assert tone.exact(250.0) == pytest.approx(tone.approximate(250.0), rel=1e-5)  # k r = 1.05e6


def test_sigma_and_its_partner():
    """The paper's tone of 20 us and a chirp of 0.398 T have one PSF; the largest width belongs to sqrt(T/(2 pi band))."""
    short, long = circular.sigmas_of_width(GAUSS.gaussian_width, BAND, T, C)
    assert short == pytest.approx(2e-5, rel=1e-12) and long == pytest.approx(0.3979e-3, rel=1e-4)
    chirp = circular.PointSpread(pysas.LFM(FC, BAND, T, "gaussian", long), C)
    r = np.linspace(0, 5, 51) * WAVE
    np.testing.assert_allclose(chirp.exact(r), GAUSS.exact(r), atol=1e-12)
    np.testing.assert_allclose(chirp.spectrum(q := np.linspace(80, 190, 50)), GAUSS.spectrum(q), rtol=1e-10)
    widest = C * np.sqrt(T / (8 * np.pi * BAND))
    assert widest / WAVE == pytest.approx(4.46, abs=5e-3)
    assert circular.sigmas_of_width(widest, BAND, T, C) == pytest.approx([8.92e-5] * 2, rel=1e-3)
    for width in (1e-9, 1e-4, 0.9 * widest):
        for sigma in circular.sigmas_of_width(width, -BAND, T, C):
            psf = circular.PointSpread(pysas.LFM(FC, BAND, T, "gaussian", sigma), C)
            assert psf.gaussian_width == pytest.approx(width, rel=1e-12)
    with pytest.raises(ValueError, match=r"width=1.0: expected at most c sqrt"):
        circular.sigmas_of_width(1.0, BAND, T, C)


def test_low_quality_warns_and_the_exact_form_does_not():
    r = np.linspace(0, 2, 21) * WAVE
    for call in (
        lambda: NARROW.approximate(r),
        lambda: NARROW.spectrum_asymptotic(100.0),
        lambda: circular.asymptotic_energy(NARROW),
    ):
        with pytest.warns(UserWarning, match=r"Q = 0\.\d+ is below 2: use the exact form"):
            call()
    NARROW.exact(r)
    NARROW.spectrum(100.0)
    circular.energy_within(NARROW, r)


# Views that do not count alike


def test_image_of_even_views_is_the_point_spread():
    x = np.linspace(-2, 2, 9) * WAVE
    image = GAUSS.image(x, x[:, None], np.ones_like)
    np.testing.assert_allclose(image, GAUSS.exact(np.hypot(x, x[:, None])), atol=1e-13)


def test_density_of_views_leaves_the_real_part():
    """Opposite views add to 2, so an off-centre point's unweighted image differs in its imaginary part alone: 0.29."""
    x, y = np.linspace(-3, 3, 49) * WAVE, np.array([[0.0], [-0.4], [1.7]]) * WAVE
    image = GAUSS.image(x, y, lambda view: circular.view_density(view, 0.5))
    np.testing.assert_allclose(image.real, GAUSS.exact(np.hypot(x, y)), atol=1e-13)
    assert np.abs(image.imag).max() == pytest.approx(0.29, abs=0.01)


def test_one_view_and_half_a_circle():
    x = np.linspace(-2, 2, 9) * WAVE
    ray = GAUSS.image(x, x[:, None], lambda view: (np.arange(view.size) == view.size // 2).astype(float))
    # view 0 looks along x: nothing changes across it
    np.testing.assert_allclose(ray, np.tile(GAUSS.envelope(x) * np.exp(-2j * GAUSS.k * x), (9, 1)), atol=1e-13)
    half = GAUSS.image(x, x[:, None], lambda view: (np.abs(view) < np.pi / 2).astype(float))
    np.testing.assert_allclose(half.real, GAUSS.exact(np.hypot(x, x[:, None])), atol=1e-3)


def test_element_pattern_narrows_the_views_of_an_off_centre_point():
    a, length = 0.3, 0.1

    def pattern(view):
        return np.sinc(length / WAVE * a * np.sin(view)) ** 2

    x = np.linspace(0, 2, 41) * WAVE
    # seen from ahead and behind only: sharp along x, wider across
    along, across = GAUSS.image(x, 0.0, pattern), GAUSS.image(0.0, x, pattern)
    n = 20_000
    view = (np.arange(n) + 0.5) * 2 * np.pi / n
    u = x[:, None] * np.cos(view)
    direct = (GAUSS.envelope(u) * np.exp(-2j * GAUSS.k * u)) @ pattern(view) / pattern(view).sum()
    np.testing.assert_allclose(along, direct, atol=1e-12)
    assert np.argmax(np.abs(across) < 0.5) > 2 * np.argmax(np.abs(along) < 0.5)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: circular.PointSpread("chirp"), TypeError, "pulse='chirp': expected a pysas.LFM"),
        (lambda: circular.PointSpread(GAUSS.pulse, 0.0), ValueError, "c=0.0"),
        (lambda: RECT.gaussian_width, ValueError, "window 'rect': expected 'gaussian'"),
        (lambda: RECT.spectrum_of_approximation(1.0), ValueError, "window 'rect'"),
        (lambda: GAUSS.exact([0.0, np.nan]), ValueError, "r: nan at index"),
        (lambda: GAUSS.spectrum("q"), TypeError, "q: expected real numbers"),
        (lambda: GAUSS.image(0.0, 0.0, lambda view: 1.0), ValueError, "views: expected numbers of shape"),
        (lambda: GAUSS.image(0.0, 0.0, np.zeros_like), ValueError, "not all zero"),
        (lambda: circular.energy_within(GAUSS, -1.0), ValueError, "r: -1: expected distances >= 0"),
        (lambda: circular.energy_within(GAUSS, 1.0, "best"), ValueError, "form='best'"),
        (lambda: circular.energy_within(GAUSS.pulse, 1.0), TypeError, "psf="),
        (lambda: GAUSS.image(np.zeros(3), np.zeros(4), np.ones_like), ValueError, r"x, y: expected shapes that broadcast"),
        (lambda: GAUSS.image(0.0, 0.0, None), TypeError, "views=None: expected a function of angles"),
        (lambda: circular.resolution(GAUSS.pulse, 0.5, 0.1), TypeError, "psf="),
        (lambda: circular.energy_diffusion([[1, np.inf], [1, 1]], 1.0, (0, 0), [1.0], 0.5), ValueError, "finite pixels"),
        (lambda: circular.resolution(GAUSS, 1.0, 0.1), ValueError, r"share=1.0: expected a number in \(0, 1\)"),
        (lambda: circular.energy_diffusion(np.ones((9, 9)), 1.0, (4, 4), [1.0], 9.0), ValueError, "within=9.0"),
        (lambda: circular.energy_diffusion(np.zeros((9, 9)), 1.0, (4, 4), [1.0], 4.0), ValueError, "expected energy"),
    ],
)
def test_what_cannot_be_is_named(call, error, text):
    with pytest.raises(error, match=text):
        call()
