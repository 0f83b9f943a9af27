"""Deconvolution: the filters' radii against an independent prototype's, wave atoms as they are, and the fit of points.

Scene of the paper: sigma = 2e-5 s, 256 x 256 pixels of wavelength/16. Noise is 30 dB below the peak per pixel ("peak") or
below the mean power ("mean"). Radii are those of 80 and 95 % of the energy within 4 wavelengths, in wavelengths; an independent
prototype of each method computed them beforehand.
"""

import tracemalloc
import warnings

import numpy as np
import pytest
import scipy.fft
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter

import pysas
from pysas import circular

pytestmark = pytest.mark.reference

WAVE, N = 0.015, 256
STEP = WAVE / 16
PSF = circular.PointSpread(pysas.LFM(100e3, 20e3, 1e-3, "gaussian", 2e-5), 1500.0)
PEAK = 10**-1.5
CENTRE = (N // 2, N // 2)
AWAY = np.linspace(0, 13, 13 * 128 + 1) * WAVE
PROFILE = CubicSpline(AWAY, PSF.exact(AWAY))


def image(points, amplitudes, noise=0.0, seed=0, complex_=False, n=N):
    """Images of scatterers at `points` (x, y) in pixels, from the exact PSF's profile, in white noise."""
    total = np.zeros((n, n), dtype=complex if complex_ else float)
    for (x, y), amplitude in zip(points, amplitudes, strict=True):
        away = STEP * np.hypot(np.arange(n) - x, (np.arange(n) - y)[:, None])
        total += amplitude * np.where(away < AWAY[-1], PROFILE(np.minimum(away, AWAY[-1])), 0)
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((n, n))
    if complex_:
        white = (white + 1j * rng.standard_normal((n, n))) / np.sqrt(2)
    return total + noise * white


def radii(found):
    r = np.linspace(0, 4, 4001) * WAVE
    share = circular.energy_diffusion(found, STEP, CENTRE, r, 4 * WAVE)
    return [r[np.argmax(share >= part)] / WAVE for part in (0.8, 0.95)]


ONE = image([CENTRE], [1])
MEAN = np.sqrt(np.mean(ONE**2) / 1000)
NOISE = {"none": 0.0, "mean": MEAN, "peak": PEAK}


def test_the_scene_is_the_prototypes():
    assert pytest.approx(8.8e-4, abs=5e-6) == MEAN


def test_transfer_function_is_that_of_the_sampled_image():
    found = circular.transfer(PSF, (N, N), STEP)
    x = STEP * scipy.fft.fftfreq(N, 1 / N)
    away, place = np.unique(np.hypot(x, x[:, None]), return_inverse=True)
    direct = scipy.fft.fft2(PSF.exact(away)[place].reshape(N, N)).real
    assert np.abs(found - direct).max() < 3e-8 * direct.max()  # the PSF beyond the image's edge is 1e-7 of its peak
    odd = circular.transfer(PSF, (45, 60), STEP)
    q = np.hypot(scipy.fft.fftfreq(60, STEP), scipy.fft.fftfreq(45, STEP)[:, None])
    np.testing.assert_allclose(odd.ravel()[1:] * STEP**2, PSF.spectrum(q.ravel()[1:]), rtol=1e-12)


@pytest.mark.parametrize("window", ("tukey", "taylor"))
def test_transfer_function_of_windows_without_closed_form(window):
    psf = circular.PointSpread(pysas.LFM(100e3, 20e3, 0.5e-3, window), 1500.0)
    found = circular.transfer(psf, (40, 64), STEP)
    q = np.hypot(scipy.fft.fftfreq(64, STEP), scipy.fft.fftfreq(40, STEP)[:, None])[:21, 5]
    error = np.abs(found[:21, 5] * STEP**2 - psf.spectrum(q)) / psf.spectrum(psf.ring_radius)
    band = np.abs(q - psf.ring_radius) < 3 * 20e3 * 2 / 1500
    assert band.sum() > 5 and error[band].max() < 1e-6
    assert error.max() < 5e-6  # the edges of the Taylor window, 3 bandwidths away


@pytest.mark.parametrize(("window", "parameter"), [("tukey", 0.1), ("tukey", 1.0), ("taylor", 35.0)])
def test_transfer_function_of_tones(window, parameter):
    """A sweep of 1 Hz in 0.1 ms: the band is that of the duration."""
    psf = circular.PointSpread(pysas.LFM(100e3, 1.0, 1e-4, window, parameter), 1500.0)
    found = circular.transfer(psf, (32, 24), STEP) * STEP**2
    q = np.hypot(scipy.fft.fftfreq(24, STEP), scipy.fft.fftfreq(32, STEP)[:, None])
    error = np.abs(found - psf.spectrum(np.maximum(q, 1e-3)))[1:] / psf.spectrum(psf.ring_radius)
    band = np.abs(q[1:] - psf.ring_radius) < 10 * 2 / (1500 * 1e-4)
    assert band.sum() > 100 and error[band].max() < 1e-6
    assert error.max() < 2e-4  # 1/(pi f duration)^2 of what lies beyond, at most


def test_zero_frequency_is_the_mean_over_its_cell():
    wide = circular.PointSpread(pysas.LFM(100e3, 150e3, 10e-6, "gaussian", 1e-6), 1500.0)
    found = circular.transfer(wide, (128, 128), WAVE / 40)[0, 0] * (WAVE / 40) ** 2
    cell = 1 / (128 * WAVE / 40)
    q = (np.arange(400) + 0.5) / 400 * cell - cell / 2
    mean = wide.spectrum(np.hypot(q, q[:, None])).mean()
    # mean of 1/q over a disc of the cell's area, 2 sqrt(pi), for that over the square, 4 arsinh(1): 0.6 % more
    assert found == pytest.approx(mean * 2 * np.sqrt(np.pi) / (4 * np.arcsinh(1)), rel=2e-3)


@pytest.mark.parametrize(
    ("method", "noise", "expected"),
    [
        ("raw", "none", (1.301, 1.993)),
        ("raw", "peak", (1.876, 3.447)),
        (0.3, "none", (1.318, 2.041)),
        (0.3, "peak", (1.326, 2.070)),
        (0.1, "none", (1.035, 2.378)),
        (0.1, "mean", (1.035, 2.380)),
        (0.1, "peak", (1.064, 2.819)),
        (0.03, "none", (0.815, 2.078)),
        (0.03, "peak", (1.252, 3.354)),
        (0.001, "none", (0.576, 1.626)),
        (0.001, "peak", (3.505, 3.883)),
        ("wiener", "none", (0.593, 1.593)),
        ("wiener", "peak", (1.025, 1.689)),
    ],
)
def test_radii_of_the_filters(method, noise, expected):
    data = image([CENTRE], [1], NOISE[noise])
    if method == "wiener":
        found = circular.wiener(data, PSF, STEP, NOISE[noise] or MEAN, 1.0)
    else:
        found = data if method == "raw" else circular.naive(data, PSF, STEP, method)
    np.testing.assert_allclose(radii(found), expected, atol=3e-3)


def test_wiener_with_noise_below_the_mean():
    """0.616 and 1.770; noise makes the second differ by 0.02 from one draw to the next."""
    found = [radii(circular.wiener(image([CENTRE], [1], MEAN, seed), PSF, STEP, MEAN, 1.0)) for seed in range(8)]
    np.testing.assert_allclose(np.mean(found, axis=0), (0.616, 1.770), atol=0.03)


def test_wiener_is_the_best_of_the_linear_filters():
    """It puts more right than any inverse filter does, and an estimated energy serves as well as the true one."""
    points = np.random.default_rng(5).uniform(60, 196, (12, 2)).round()
    truth = np.zeros((N, N))
    truth[points[:, 1].astype(int), points[:, 0].astype(int)] = 1
    data = image(points, np.ones(12), PEAK, 6)

    def recovered(found):
        return np.sum(truth**2) - np.sum((found - truth) ** 2)

    best = recovered(circular.wiener(data, PSF, STEP, PEAK, 12.0))
    assert best > 1.05 * max(recovered(circular.naive(data, PSF, STEP, eta)) for eta in (0.03, 0.1, 0.2, 0.3, 0.5, 0.8))
    assert recovered(circular.wiener(data, PSF, STEP, PEAK)) == pytest.approx(best, rel=0.01)


@pytest.mark.parametrize("snr", (60, 40, 20, 0))
def test_wiener_from_60_to_0_db(snr):
    noise = 10 ** (-snr / 20)
    data = image([CENTRE], [1], noise, 3)
    found = circular.wiener(data, PSF, STEP, noise, 1.0)
    assert np.isfinite(found).all()
    assert np.unravel_index(np.argmax(np.abs(found)), found.shape) == CENTRE
    # never more than it puts right: white noise through the filter stays below the scatterer's own energy of 1
    assert np.sum(found**2) < 1


def test_filters_are_linear_and_keep_dtype():
    data = image([(100.3, 130.1)], [1 + 2j], 0.01, complex_=True)
    for call in (
        lambda j: circular.naive(j, PSF, STEP, 0.1),
        lambda j: circular.wiener(j, PSF, STEP, 0.01, 5.0),
    ):
        whole = call(data)
        np.testing.assert_allclose(call(data.real) + 1j * call(data.imag), whole, atol=1e-12)
        assert call(data.real).dtype == np.float64
        single = call(data.astype(np.complex64))
        assert single.dtype == np.complex64
        np.testing.assert_allclose(single, whole, atol=1e-5 * np.abs(whole).max())


def test_memory_is_a_few_images():
    data = np.ones((1024, 1024), np.complex64)
    tracemalloc.start()
    circular.wiener(data, PSF, STEP, 1.0, 1.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * data.nbytes


# Wave atoms


def test_an_atom_is_a_ridge():
    """Amplitude of its spectrum along its direction, relative to the largest; 54 % of its energy lies on the ring."""
    x = STEP * (np.arange(N) - N // 2)
    atom = circular.wave_atom(PSF, x, x[:, None], 0.0)
    assert atom[CENTRE[1], CENTRE[0]] == 1
    spectrum = np.abs(scipy.fft.fft2(atom))
    q = scipy.fft.fftfreq(N, STEP) * WAVE
    line = spectrum[0] / spectrum.max()
    order = np.argsort(q)
    found = np.interp([0, 1, 1.5, 1.8, 2.0, 2.2], q[order], line[order])
    np.testing.assert_allclose(found, (0.33, 0.39, 0.51, 0.86, 0.86, 0.10), atol=0.012)
    on_ring = np.abs(np.hypot(q, q[:, None]) - 2) < 3 * WAVE / (2 * np.pi * PSF.gaussian_width)
    assert np.sum(spectrum[on_ring] ** 2) / np.sum(spectrum**2) == pytest.approx(0.54, abs=5e-3)
    np.testing.assert_allclose(circular.wave_atom(PSF, x, x[:, None], np.pi), atom, atol=1e-12)


@pytest.mark.parametrize(("atoms", "error"), [(16, 0.14), (32, 2e-5), (64, 4e-16)])
def test_the_mean_of_the_atoms_is_the_kernel(atoms, error):
    r = np.linspace(0, 4, 401) * WAVE
    # without the envelope, which is the same for all: worst where nothing damps
    angles = np.arange(atoms) * np.pi / atoms
    worst = 0.0
    for direction in (0.0, np.pi / atoms / 2):
        x, y = r * np.cos(direction), r * np.sin(direction)
        mean = np.mean([circular.wave_atom(PSF, x, y, angle) for angle in angles], axis=0)
        worst = max(worst, np.abs((mean - circular.wave_atom_kernel(PSF, r)) / PSF.envelope(r)).max())
    assert 0.3 * error < worst < 3 * error + 1e-14 if error > 1e-10 else worst < 1e-13


@pytest.mark.parametrize(("power", "expected"), [(1, (0.590, 1.149)), (2, (0.283, 0.736))])
@pytest.mark.parametrize("noise", ("none", "peak"))
def test_expansion_about_a_scatterer_gives_the_kernel_whatever_the_noise(power, expected, noise):
    """Fig 9 states 0.25 and 0.75 wavelengths: not Eq 48 as printed, but its envelope squared (a conjecture)."""
    found = circular.wave_atom_expansion(image([CENTRE], [1], NOISE[noise]), PSF, STEP, CENTRE, envelope_power=power)
    np.testing.assert_allclose(radii(found), expected, atol=5e-3)
    x = STEP * (np.arange(N) - N // 2)
    kernel = circular.wave_atom_kernel(PSF, np.hypot(x, x[:, None]), power)
    correlation = np.sum(found * kernel) / np.sqrt(np.sum(found**2) * np.sum(kernel**2))
    assert correlation > 0.999
    np.testing.assert_allclose(radii(kernel), expected, atol=5e-3)


SQUARE = np.array(CENTRE) + 8.0 * np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])


def test_expansion_about_one_centre_misplaces_a_square():
    """Four scatterers at the corners of a wavelength's square come out at the middles of its sides."""
    found = np.abs(circular.wave_atom_expansion(image(SQUARE, np.ones(4)), PSF, STEP, CENTRE))
    sides = np.array(CENTRE) + 8 * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
    at_sides = [found[y, x] for x, y in sides]
    at_corners = [found[int(y), int(x)] for x, y in SQUARE]
    assert min(at_sides) > 3 * max(at_corners)


# Points


def distances(found, truth):
    """Of each true point to the nearest found one, in wavelengths."""
    return np.linalg.norm(found.position[:, None] - truth, axis=-1).min(axis=0) * STEP / WAVE


def test_one_scatterer():
    truth = np.array([(128.3, 127.6)])
    found = circular.fit_points(image(truth, [1], PEAK), PSF, STEP, PEAK)
    assert found.position.shape == (1, 2)
    assert distances(found, truth).max() < 1e-3
    assert found.amplitude == pytest.approx([1], abs=0.01)
    assert found.residual == pytest.approx(1, abs=0.02)


def test_one_scatterer_at_0_db():
    """Its amplitude stands 7 deviations above its error, sqrt(sum PSF^2) = sqrt(51): found, and near its place."""
    for seed in range(5):
        found = circular.fit_points(image([CENTRE], [1], 1.0, seed), PSF, STEP, 1.0)
        assert len(found.position) == 1
        assert distances(found, np.array([CENTRE])).max() < 0.1
        assert found.amplitude[0] == pytest.approx(1, abs=4 / np.sqrt(51))


@pytest.mark.parametrize(
    ("snr", "error"),
    [(60, 1e-4), pytest.param(30, 2e-3, marks=pytest.mark.slow), pytest.param(20, 6e-3, marks=pytest.mark.slow), (10, 2e-2)],
)
@pytest.mark.parametrize("complex_", (False, True), ids=("real", "complex"))
@pytest.mark.parametrize("seeds", (range(1), pytest.param(range(1, 6), marks=pytest.mark.slow)), ids=("one", "more"))
def test_the_papers_square(snr, error, complex_, seeds):
    """Errors of the prototype: 1.3e-3 wavelengths at 30 dB, 4e-3 at 20, 1.4e-2 at 10; none missed, none invented."""
    noise = 10 ** (-snr / 20)
    truth = SQUARE + 0.3
    amplitude = np.array([1, 1j, -1, 0.7 - 0.7j]) if complex_ else np.ones(4)
    for seed in seeds:
        found = circular.fit_points(image(truth, amplitude, noise, seed, complex_), PSF, STEP, noise)
        assert len(found.position) == 4
        assert distances(found, truth).max() < error
        order = np.argmin(np.linalg.norm(found.position[:, None] - truth, axis=-1), axis=0)
        np.testing.assert_allclose(found.amplitude[order], amplitude, atol=noise)


@pytest.mark.parametrize("complex_", (False, True), ids=("real", "complex"))
def test_nothing_is_found_in_noise(complex_):
    for seed in range(10):
        found = circular.fit_points(image([], [], 0.1, seed, complex_), PSF, STEP, 0.1)
        assert found.position.shape == (0, 2) and found.residual == pytest.approx(1, abs=0.05)


@pytest.mark.slow
def test_ten_scatterers():
    rng = np.random.default_rng(1)
    truth = N / 2 + rng.uniform(-48, 48, (10, 2))
    found = circular.fit_points(image(truth, rng.uniform(0.5, 1.5, 10), PEAK, 2), PSF, STEP, PEAK)
    assert len(found.position) == 10
    assert distances(found, truth).max() < 6e-3


def test_a_scene_that_is_not_of_points_comes_to_an_end():
    """Noise said to be a tenth of what it is: every wave of it looks like one more scatterer."""
    data = image([(32, 32)], [1], 0.3, n=64)
    with pytest.warns(UserWarning, match=r"stopped at 5 scatterers.*noise=0\.03"):
        found = circular.fit_points(data, PSF, STEP, 0.03, most=5)
    assert len(found.position) == 5 and found.residual > 2
    assert len(circular.fit_points(data, PSF, STEP, 0.3, most=1).position) == 1  # as many as there are: nothing to say


@pytest.mark.parametrize("separation", (0.5, 0.25, 0.15))
def test_pairs(separation):
    truth = np.array(CENTRE) + np.array([(-8 * separation, 0.2), (8 * separation, 0.2)])
    found = circular.fit_points(image(truth, [1, 1], PEAK, 2), PSF, STEP, PEAK)
    assert len(found.position) == 2
    assert distances(found, truth).max() < 5e-3


@pytest.mark.parametrize(
    ("separation", "complex_"),
    [
        (0.275, False),
        (0.35, True),
        *(
            pytest.param(separation, kind, marks=pytest.mark.slow)
            for separation in (0.3, 0.325, 0.35)
            for kind in (False, True)
        ),
    ],
)
def test_pairs_in_the_negative_lobe(separation, complex_):
    """Either lies in the first negative lobe of the other: the brightest places of the image are two where nothing is."""
    for seed, angle in enumerate((0.0, 1.3)):
        axis = 8 * separation * np.array([np.cos(angle), np.sin(angle)])
        truth = np.array(CENTRE) + 0.2 + np.array([-axis, axis])
        found = circular.fit_points(image(truth, [1, 1], PEAK, seed, complex_), PSF, STEP, PEAK)
        assert len(found.position) == 2
        assert distances(found, truth).max() < 5e-3


@pytest.mark.parametrize(("seeds", "wrong"), [((0,), 0), pytest.param(range(1, 8), 1, marks=pytest.mark.slow)])
def test_crowds(seeds, wrong):
    """Ten equal scatterers in 6 x 6 wavelengths, neighbours from 0.2 wavelengths on: of eight draws one is not unravelled."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = N / 2 + rng.uniform(-48, 48, (10, 2))
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            found = circular.fit_points(image(truth, np.ones(10), PEAK, seed), PSF, STEP, PEAK, most=11)
        if len(found.position) == 10:
            assert distances(found, truth).max() < 6e-3
        else:
            wrong -= 1
            assert found.residual > 1.04  # and it tells
    assert wrong >= 0


def test_synthesis_stands_at_the_scatterers():
    """Largest false maximum 0.36 (envelope once) and 0.32 (squared), against 0.63 in the image itself."""
    found = circular.fit_points(image(SQUARE, np.ones(4), PEAK, 1), PSF, STEP, PEAK)
    y, x = np.mgrid[:N, :N]
    near = np.min([np.hypot(x - px, y - py) for px, py in SQUARE], axis=0)
    for power, expected in ((1, 0.36), (2, 0.32)):
        made = circular.synthesise(found, PSF, (N, N), STEP, power)
        for px, py in SQUARE:
            patch = made[int(py) - 3 : int(py) + 4, int(px) - 3 : int(px) + 4]
            assert np.unravel_index(np.argmax(patch), patch.shape) == (3, 3)
        top = made == maximum_filter(made, 3)
        false = (made * (top & (near > 3))).max() / made.max()
        assert false == pytest.approx(expected, abs=0.02)


def test_a_psf_larger_than_the_image():
    """One period of a periodic scene, 1.5 wavelengths wide: the PSF wraps round it several times."""
    n = 24
    whole = image([(128, 128)], [1])
    wrapped = sum(
        whole[i : i + n, j : j + n] for i in range(128 - 12 - 4 * n, 256 - n, n) for j in range(128 - 12 - 4 * n, 256 - n, n)
    )
    found = circular.naive(wrapped, PSF, STEP, 0.01)
    assert np.unravel_index(np.argmax(found), found.shape) == (12, 12)
    assert np.isfinite(circular.wiener(wrapped, PSF, STEP, 1e-3)).all()


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: circular.naive(ONE, PSF, STEP, 0.0), ValueError, "threshold=0.0"),
        (lambda: circular.naive(ONE, PSF, STEP, 1.5), ValueError, "threshold=1.5"),
        (lambda: circular.naive(ONE[0], PSF, STEP, 0.1), ValueError, r"image: expected \(rows, columns\)"),
        (lambda: circular.naive(ONE * np.nan, PSF, STEP, 0.1), ValueError, "image: expected finite pixels"),
        (lambda: circular.naive(ONE, PSF, WAVE / 3, 0.1), ValueError, "the PSF has content beyond"),
        (lambda: circular.naive(ONE, PSF.pulse, STEP, 0.1), TypeError, "psf="),
        (lambda: circular.naive([["a"]], PSF, STEP, 0.1), TypeError, "image: expected real or complex"),
        (lambda: circular.wiener(ONE, PSF, STEP, 0.0), ValueError, "noise=0.0"),
        (lambda: circular.wiener(ONE, PSF, STEP, 10.0), ValueError, "no stronger than that: state `energy`"),
        (lambda: circular.wave_atom(PSF, 0.0, 0.0, 0.0, 3), ValueError, "envelope_power=3"),
        (lambda: circular.wave_atom_expansion(ONE, PSF, STEP, (1.0,)), ValueError, "centre: expected shape"),
        (lambda: circular.fit_points(ONE, PSF, STEP, -1.0), ValueError, "noise=-1.0"),
        (lambda: circular.synthesise(None, PSF, (4, 4), STEP), TypeError, "scatterers=None"),
        (lambda: circular.fit_points(ONE, PSF, STEP, 1.0, 0), ValueError, "most=0"),
        (lambda: circular.transfer(PSF, (0, 4), STEP), ValueError, "shape=0"),
        (lambda: circular.transfer(PSF, 4, STEP), ValueError, r"shape=4: expected \(rows, columns\)"),
        (lambda: circular.transfer(PSF, (4, 4, 4), STEP), ValueError, r"shape=\(4, 4, 4\): expected \(rows"),
        (lambda: circular.wave_atom(PSF, np.zeros(3), np.zeros(4), 0.0), ValueError, "x, y: expected shapes that broadcast"),
    ],
)
def test_what_cannot_be_is_named(call, error, text):
    with pytest.raises(error, match=text):
        call()
