"""Metrics against closed forms: sinc and Gaussian responses under phase ramps, a point seen by a squinted aperture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from pysas import metrics
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.reference import exact

pytestmark = pytest.mark.reference  # no engine takes part


def sinc_width(level: float) -> float:
    return 2 * float(brentq(lambda x: np.sinc(x) - level, 0.1, 0.9))


def sinc_cut(n: int = 201, sampling: float = 1.25, shift: float = 0.3, ramp: float = 0.0) -> Any:
    """sinc of unit bandwidth sampled `sampling` times per unit, its peak `shift` samples past the middle."""
    k = np.arange(n)
    return np.sinc((k - n // 2 - shift) / sampling) * np.exp(1j * ramp * k)


@pytest.mark.parametrize("ramp", [0.0, 0.7, -2.5, 3.1])
@pytest.mark.parametrize("shift", [0.0, 0.3, -0.5])
def test_sinc_width(ramp: float, shift: float) -> None:
    cut = sinc_cut(shift=shift, ramp=ramp)
    assert metrics.irw(cut, 0.8) == pytest.approx(sinc_width(10 ** (-3 / 20)), rel=2e-5)
    # Half power: 0.885893 (root of sinc^2 = 1/2).
    assert metrics.irw(cut, 0.8, level_db=10 * np.log10(0.5)) == pytest.approx(0.885893, rel=2e-5)


def test_sinc_side_lobes() -> None:
    first = minimize_scalar(np.sinc, bounds=(1.2, 1.7), method="bounded").fun
    expected = 20 * np.log10(-first)
    assert expected == pytest.approx(-13.2615, abs=1e-3)
    for ramp in (0.0, 2.9):
        assert metrics.pslr(sinc_cut(ramp=ramp)) == pytest.approx(expected, abs=2e-3)


def test_sinc_integrated_side_lobes() -> None:
    n, sampling = 401, 1.25
    reach = n // 2 / sampling
    main = 2 * quad(lambda x: np.sinc(x) ** 2, 0, 1)[0]
    whole = 2 * quad(lambda x: np.sinc(x) ** 2, 0, reach, limit=1000)[0]
    expected = 10 * np.log10((whole - main) / main)
    assert 10 * np.log10((1 - main) / main) == pytest.approx(-9.68, abs=5e-3)  # the endless sinc: its energy is 1
    assert metrics.islr(sinc_cut(n, sampling, shift=0.0, ramp=1.0)) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("kind", ["complex", "magnitude", "integer"])
def test_gaussian_width(kind: str) -> None:
    k = np.arange(80)
    sigma = 3.0
    cut: Any = np.exp(-((k - 37.4) ** 2) / (2 * sigma**2))
    if kind == "complex":
        cut = cut * np.exp(2.2j * k)
    tolerance = 1e-5
    if kind == "integer":
        cut, tolerance = np.rint(cut * 1e6).astype(int), 1e-4
    # Amplitude 10^(-3/20) at x = sigma sqrt(2 ln 10^(3/20)) = sigma sqrt(0.3 ln 10).
    assert metrics.irw(cut, 0.02) == pytest.approx(0.04 * sigma * np.sqrt(0.3 * np.log(10)), rel=tolerance)
    assert metrics.pslr(cut) < -60
    assert metrics.islr(cut) < -60


def test_magnitude_of_a_sinc() -> None:
    """A magnitude has cusps; its square is band-limited, at twice the bandwidth."""
    cut = np.abs(sinc_cut(n=301, sampling=2.5))
    assert metrics.irw(cut, 0.4) == pytest.approx(sinc_width(10 ** (-3 / 20)), rel=1e-4)
    assert metrics.pslr(cut) == pytest.approx(-13.2615, abs=0.01)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_cut_metrics_ignore_scale(scale: float) -> None:
    cut = sinc_cut(ramp=1.0)
    assert metrics.irw(cut * scale, 0.8) == pytest.approx(metrics.irw(cut, 0.8), rel=1e-12)
    assert metrics.pslr(cut * scale) == pytest.approx(metrics.pslr(cut), abs=1e-9)


@pytest.mark.parametrize(
    "cut", [np.ones((3, 3)), np.ones(2), np.zeros(9), np.array([0, 1, np.nan]), np.array([0, np.inf, 0, 0])]
)
def test_bad_cuts(cut: Any) -> None:
    for measure in (lambda c: metrics.irw(c, 1.0), metrics.pslr, metrics.islr):
        with pytest.raises(ValueError, match="cut"):
            measure(cut)


def test_bad_arguments_of_irw() -> None:
    with pytest.raises(ValueError, match="spacing"):
        metrics.irw(sinc_cut(), 0.0)
    with pytest.raises(ValueError, match="level_db"):
        metrics.irw(sinc_cut(), 1.0, level_db=3.0)
    with pytest.raises(ValueError, match="main lobe"):
        metrics.irw(np.exp(-((np.arange(9) - 4) ** 2) / 1e3), 1.0)
    with pytest.raises(TypeError, match="cut"):
        metrics.irw(["a", "b", "c"], 1.0)


def peak(shape: tuple[int, int], row: float, column: float, ramps: tuple[float, float], sampling: float = 1.3) -> Any:
    r, c = np.arange(shape[0])[:, None], np.arange(shape[1])
    body = np.sinc((r - row) / sampling) * np.sinc((c - column) / (2 * sampling))
    return body * np.exp(1j * (ramps[0] * r + ramps[1] * c))


@pytest.mark.parametrize("ramps", [(0.0, 0.0), (1.3, -2.9), (3.1, 3.14)])
@pytest.mark.parametrize("shape", [(120, 90), (50, 40), (7, 9)])
def test_peak_between_pixels(shape: tuple[int, int], ramps: tuple[float, float]) -> None:
    row, column = shape[0] / 2 + 0.37, shape[1] / 2 - 0.48
    x, y = metrics.peak_position(peak(shape, row, column, ramps))
    # A 7 x 9 patch cuts the side lobes off.
    tolerance = 0.05 if shape[0] < 10 else 1e-3
    assert (x, y) == pytest.approx((column, row), abs=tolerance)


def test_peak_of_a_finely_sampled_response() -> None:
    r, c = np.arange(300)[:, None], np.arange(400)
    body = np.exp(-((r - 141.23) ** 2 + (c - 222.77) ** 2 + 0.8 * (r - 141.23) * (c - 222.77)) / 800)
    assert metrics.peak_position((body * np.exp(0.3j * r)).astype(np.complex64)) == pytest.approx((222.77, 141.23), abs=1e-3)


def image(data: Any, x: Any, y: Any) -> Image:
    return Image(np.asarray(data, dtype=np.complex128), Grid.plane(x, y), Report("test"), 100e3, 1500.0)


def test_peak_in_grid_coordinates_near_a_place() -> None:
    x, y = 5e6 + 0.25 * np.arange(90), 40 - 0.5 * np.arange(120)  # UTM; y downwards
    data = peak((120, 90), 30.2, 20.6, (0.4, 1.0)) + 0.5 * peak((120, 90), 85.7, 61.1, (0.4, 1.0))
    strong, weak = (5e6 + 0.25 * 20.6, 40 - 0.5 * 30.2), (5e6 + 0.25 * 61.1, 40 - 0.5 * 85.7)
    picture = image(data, x, y)
    assert metrics.peak_position(picture) == pytest.approx(strong, rel=0, abs=3e-3)
    assert metrics.peak_position(picture, near=(weak[0] + 0.3, weak[1]), radius=1.0) == pytest.approx(weak, rel=0, abs=3e-3)
    with pytest.raises(ValueError, match="radius"):
        metrics.peak_position(picture, near=(0.0, 0.0), radius=1.0)
    with pytest.raises(ValueError, match="both or neither"):
        metrics.peak_position(picture, near=weak)


def test_peak_rejects_other_grids_and_data() -> None:
    data = peak((20, 20), 9.3, 9.3, (0, 0))
    with pytest.raises(ValueError, match="evenly spaced axis x"):
        metrics.peak_position(image(data, np.arange(20.0) ** 2, np.arange(20.0)))
    polar = Image(data, Grid.polar(np.arange(1.0, 21), np.arange(20) / 20), Report("test"), 1e5, 1500.0)
    with pytest.raises(ValueError, match="polar"):
        metrics.peak_position(polar)
    for bad in (np.zeros((5, 5)), np.full((5, 5), np.nan), np.ones(5), np.ones((2, 5))):
        with pytest.raises(ValueError, match="image"):
            metrics.peak_position(bad)


@pytest.mark.parametrize("ramps", [(0.0, 0.0), (2.0, -3.0)])
def test_cuts_pass_through_the_peak(ramps: tuple[float, float]) -> None:
    x, y = 0.25 * np.arange(160), 0.5 * np.arange(150)
    picture = image(peak((150, 160), 74.37, 79.52, ramps), x, y)
    where = metrics.peak_position(picture)
    along, spacing = metrics.cut(picture, where, "x")
    assert along.shape == (160,) and spacing == 0.25
    # The row between two rows: the closed form, with the ramp's phase there.
    expected = np.sinc((np.arange(160) - 79.52) / 2.6) * np.exp(1j * (ramps[0] * 74.37 + ramps[1] * np.arange(160)))
    np.testing.assert_allclose(along, expected, atol=2e-3)
    width = sinc_width(10 ** (-3 / 20))
    assert metrics.irw(along, spacing) == pytest.approx(2.6 * 0.25 * width, rel=1e-4)
    down, spacing = metrics.cut(picture, where, "y")
    assert down.shape == (150,) and spacing == 0.5
    assert metrics.irw(down, spacing) == pytest.approx(1.3 * 0.5 * width, rel=1e-4)
    assert metrics.pslr(down) == pytest.approx(-13.26, abs=0.01)
    np.testing.assert_allclose(metrics.cut(picture, (x[3], y[7]), "x")[0], picture.data[7], atol=1e-12)


def test_cut_rejects_a_place_outside() -> None:
    picture = image(peak((20, 20), 9.3, 9.3, (0, 0)), np.arange(20.0), np.arange(20.0))
    with pytest.raises(ValueError, match="position"):
        metrics.cut(picture, (3.0, 25.0), "x")
    with pytest.raises(ValueError, match="axis"):
        metrics.cut(picture, (3.0, 3.0), "z")


def test_peak_of_a_point_seen_by_a_squinted_aperture() -> None:
    """Every term is largest, and in phase, at the point: so is the image. The squint puts a steep ramp on it."""
    fs, fc, c, ping = 40e3, 100e3, 1500.0, 64
    target = np.array([8.013, 19.9871, 0.0])
    tx = np.zeros((ping, 3))
    tx[:, 0] = np.linspace(-1, 1, ping)
    tau = 2 * np.linalg.norm(target - tx, axis=1) / c
    t0 = float(tau.min()) - 64 / fs
    u = (t0 + np.arange(200) / fs)[None] - tau[:, None]
    data = np.exp(-((u * fs) ** 2) / 8) * np.exp(-2j * np.pi * fc * tau)[:, None]
    x, y = target[0] + 0.01 * (np.arange(81) - 40.3), target[1] + 0.01 * (np.arange(91) - 44.6)
    grid = Grid.plane(x, y)
    picture = Image(exact(Echoes(data, fs=fs, fc=fc, tx=tx, rx=tx, c=c, t0=t0), grid)[0], grid, Report("exact"), fc, c)
    found = metrics.peak_position(picture)
    np.testing.assert_allclose(found, target[:2], atol=1e-5)
    values, _ = metrics.cut(picture, found, "y")
    assert np.abs(values).max() == pytest.approx(ping, rel=0.05)


def test_relative_error() -> None:
    wanted = np.array([3.0, 4.0j])
    off = np.array([3.0, 4.0j + 0.5])
    assert metrics.relative_error(wanted, wanted) == 0
    assert metrics.relative_error(off, wanted) == pytest.approx(0.1)
    assert metrics.relative_error(off, wanted, level=np.array([6.0, 8.0])) == pytest.approx(0.05)
    assert metrics.relative_error(off, wanted, level=np.array([0.1, 0.1])) == pytest.approx(0.1)
    assert metrics.relative_error(np.zeros(2), np.zeros(2)) == 0
    assert metrics.relative_error(np.ones(2), np.zeros(2)) == np.inf
    assert np.isnan(metrics.relative_error(np.full(2, np.nan), np.zeros(2)))
    picture = image(np.full((3, 3), 2.0), np.arange(3.0), np.arange(3.0))
    assert metrics.relative_error(picture, np.ones((3, 3))) == pytest.approx(1.0)
    for arguments in ((wanted, wanted[:1]), (wanted, wanted, wanted[:1])):
        with pytest.raises(ValueError, match="expected the shape"):
            metrics.relative_error(*arguments)
    with pytest.raises(TypeError, match="data"):
        metrics.relative_error(["a"], ["b"])


def test_phase_error() -> None:
    rng = np.random.default_rng(0)
    wanted = rng.standard_normal(2000) + 1j * rng.standard_normal(2000)
    rms, offset = metrics.phase_error(2 * wanted * np.exp(2.5j), wanted)
    assert rms == pytest.approx(0, abs=1e-12)
    assert offset == pytest.approx(2.5)
    # Two equal values at +a and -a about the constant; a dark pixel has no weight.
    rms, offset = metrics.phase_error([np.exp(0.3j), np.exp(0.1j), 0.0], [1, 1, 5.0])
    assert (rms, offset) == pytest.approx((0.1, 0.2))
    with pytest.raises(ValueError, match="non-zero"):
        metrics.phase_error(np.zeros(3), np.ones(3))
    with pytest.raises(ValueError, match="finite"):
        metrics.phase_error(np.full(3, np.inf), np.ones(3))


def test_entropy_and_sharpness_in_closed_form() -> None:
    """k equal pixels of n: ln k and n/k; a geometric series of intensities r^i: by its sums."""
    rng = np.random.default_rng(2)
    for k, n in ((1, 1), (1, 50), (7, 50), (50, 50)):
        image = np.zeros(n, dtype=complex)
        image[:k] = 3e-7 * np.exp(2j * np.pi * rng.uniform(size=k))
        assert metrics.entropy(image.reshape(-1, 1)) == pytest.approx(np.log(k), abs=1e-14)
        assert metrics.sharpness(image) == pytest.approx(n / k, rel=1e-14)
    r, n = 0.7, 400
    image = r ** (np.arange(n) / 2)
    # q = (1 - r) r^i: -ln(1 - r) - r ln r/(1 - r); sum q^2 = (1 - r)/(1 + r)
    assert metrics.entropy(image) == pytest.approx(-np.log(1 - r) - r * np.log(r) / (1 - r), rel=1e-13)
    assert metrics.sharpness(image) == pytest.approx(n * (1 - r) / (1 + r), rel=1e-13)


def test_entropy_and_sharpness_of_developed_speckle() -> None:
    """Independent circular Gaussian pixels: intensity exponential, E e ln e = 1 - Euler's constant, E e^2 = 2."""
    rng = np.random.default_rng(3)
    n = 200_000
    image = rng.standard_normal((n, 2)) @ [1, 1j]
    # the scatter: sqrt(20/n) of sharpness, about 1/sqrt(n) of entropy
    assert metrics.sharpness(image) == pytest.approx(2, abs=4 * np.sqrt(20 / n))
    assert metrics.entropy(image) == pytest.approx(np.log(n) - 1 + np.euler_gamma, abs=4 / np.sqrt(n))


def test_entropy_and_sharpness_know_no_scale() -> None:
    """Levels whose squares are no floats, and pixels in an Image, count the same."""
    rng = np.random.default_rng(4)
    data = rng.standard_normal((20, 30)) + 1j * rng.standard_normal((20, 30))
    image = Image(data, Grid.plane(np.arange(30.0), np.arange(20.0)), Report("test"), 100e3, 1500.0)
    for measure in (metrics.entropy, metrics.sharpness):
        value = measure(data)
        assert measure(image) == value
        for scale in (1e-200, 1e200):
            assert measure(scale * data) == pytest.approx(value, rel=1e-13)


@pytest.mark.parametrize("measure", [metrics.entropy, metrics.sharpness])
def test_entropy_and_sharpness_refuse_what_has_no_energy(measure: Any) -> None:
    with pytest.raises(ValueError, match="image: all zero"):
        measure(np.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"image: nan at pixel \(1, 2\)"):
        measure(np.where(np.arange(12).reshape(3, 4) == 6, np.nan, 1.0))
    with pytest.raises(ValueError, match=r"image: shape \(0, 4\)"):
        measure(np.zeros((0, 4)))
    with pytest.raises(TypeError, match="image: expected real or complex numbers"):
        measure(np.array(["a"]))
