"""The oracle against closed forms: known signals at known delays, the counting rule, the low-pass, translations."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from pysas.model.echoes import Beam, Echoes
from pysas.model.grid import Grid
from pysas.reference import direct, exact

pytestmark = pytest.mark.reference  # no engine takes part

FS, FC, C = 40e3, 100e3, 1500.0
EPS = float(np.finfo(np.longdouble).eps)


def pulse(t: Any, centre: Any) -> Any:
    """Gaussian of 4 samples at 0.1 fs: 6e-18 of its top at fs/2.2 in frequency, 2e-22 at 40 samples in time."""
    u = np.asarray((t - centre) * FS, dtype=np.float64)
    return np.exp(-(u**2) / 32 + 0.2j * np.pi * u)


def distance(a: npt.ArrayLike, b: npt.ArrayLike) -> Any:
    difference = np.asarray(a, dtype=np.longdouble) - np.asarray(b, dtype=np.longdouble)
    return np.sqrt(np.sum(difference**2, axis=-1))


def geometry(channels: int = 1, pings: int = 4) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    tx = np.zeros((pings, 3))
    tx[:, 0] = 0.3 * np.arange(pings)
    tx[:, 2] = 0.1
    rx = np.repeat(tx[:, None], channels, axis=1)
    if channels > 1:
        rx[..., 0] += 0.25 * np.arange(channels)
        rx[..., 1] -= 0.5
    return tx, rx


def known(channels: int = 1, n: int = 256, velocity: Any = None) -> tuple[Echoes, Any]:
    """Echoes of one pulse per trace, and its centre (ping, channel)."""
    tx, rx = geometry(channels)
    t0 = 2 * 19.0 / C
    centre = t0 + (n / 2 + 3.3 * np.arange(4 * channels).reshape(4, channels)) / np.longdouble(FS)
    data = pulse(t0 + np.arange(n) / np.longdouble(FS), centre[..., None])
    return Echoes(data, fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=t0, velocity=velocity), centre


def noise(shape: tuple[int, ...], seed: int = 0) -> npt.NDArray[np.complex128]:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))


def rotated(samples: Any, tau: Any) -> Any:
    turns = np.longdouble(FC) * tau
    return samples * np.exp(2j * np.pi * np.asarray(turns - np.rint(turns), dtype=np.float64))


@pytest.mark.parametrize("channels", [1, 3])
def test_known_signal_at_known_delays(channels: int) -> None:
    echoes, centre = known(channels)
    grid = Grid.plane(np.linspace(-0.5, 1.5, 7), np.linspace(20.8, 22.2, 11))
    points = grid.coordinates()
    terms = []
    for ping in range(4):
        for channel in range(channels):
            path = distance(points, echoes.tx[ping]) + distance(points, echoes.receivers[ping, channel])
            tau = path / C
            terms.append(rotated(pulse(tau, centre[ping, channel]), tau))
    image, level = exact(echoes, grid)
    assert image.shape == level.shape == grid.shape
    assert image.dtype == np.complex128 and level.dtype == np.float64
    np.testing.assert_allclose(image.ravel(), np.sum(terms, axis=0), rtol=0, atol=1e-13)
    np.testing.assert_allclose(level.ravel(), np.linalg.norm(terms, axis=0), rtol=0, atol=1e-13)
    assert level.max() > 0.5


def closed_form_delay(x: Any, tx: Any, rx: Any, velocity: Any, c: float) -> Any:
    """Larger root of (c^2 - v^2) tau^2 - 2 (c D - d.v) tau + D^2 - d^2 = 0, with D = |x - tx| and d = x - rx."""
    d = np.asarray(x, dtype=np.longdouble) - np.asarray(rx, dtype=np.longdouble)
    v = np.asarray(velocity, dtype=np.longdouble)
    out = distance(x, tx)
    a, b, e = np.longdouble(c) ** 2 - np.sum(v**2), c * out - np.sum(d * v, axis=-1), out**2 - np.sum(d**2, axis=-1)
    return (b + np.sqrt(b**2 - a * e)) / a


@pytest.mark.parametrize("velocity", [(2.0, 0.0, 0.0), (-3.0, 1.0, 0.5), (140.0, -30.0, 20.0)])
def test_moving_receiver_delay_is_the_root_of_its_quadratic(velocity: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-300, 300, (200, 3))
    tx, rx, v = np.array([1.0, 2.0, 3.0]), np.array([1.5, -4.0, 3.0]), np.array(velocity)
    c = np.longdouble(C)
    found = direct._delay(distance(points, tx), points.T.astype(np.longdouble), rx, v, c)
    expected = closed_form_delay(points, tx, rx, velocity, C)
    assert np.max(np.abs(found - expected) / expected) < 50 * EPS


def test_moving_receiver_at_the_pixel_and_at_the_transmitter() -> None:
    points = np.array([[0.0, 0, 0], [3.0, 0, 0], [1e-9, 0, 0]]).T.astype(np.longdouble)
    outward = np.abs(points[0])
    origin, velocity = np.zeros(3), np.array([2.0, 0, 0])
    found = direct._delay(outward, points, origin, velocity, np.longdouble(C))
    # Receding receiver on the line: c tau = D + D - v tau.
    np.testing.assert_allclose(found, 2 * outward / np.longdouble(C + 2), rtol=20 * EPS, atol=0)


def test_moving_receivers_image() -> None:
    velocity = np.full((4, 3), [1.5, -0.25, 0.5])
    echoes, centre = known(3, velocity=velocity)
    points = Grid.plane(np.linspace(-0.5, 1.5, 5), np.linspace(20.8, 22.2, 5)).coordinates()
    total = np.zeros(len(points), dtype=np.complex128)
    for ping in range(4):
        for channel in range(3):
            tau = closed_form_delay(points, echoes.tx[ping], echoes.receivers[ping, channel], velocity[ping], C)
            total += rotated(pulse(tau, centre[ping, channel]), tau)
    np.testing.assert_allclose(exact(echoes, Grid.points(points))[0], total, rtol=0, atol=1e-12)
    per_channel = echoes.replace(velocity=np.repeat(velocity[:, None], 3, axis=1))
    np.testing.assert_array_equal(exact(per_channel, Grid.points(points))[0], exact(echoes, Grid.points(points))[0])
    assert not np.allclose(exact(echoes.replace(velocity=None), Grid.points(points))[0], total, atol=1e-2)


def on_axis(ranges: npt.ArrayLike, n: int = 9) -> tuple[Echoes, Grid]:
    """c = fs = 1024, t0 = 1: a pixel at range r reads the place 2 r - 1024, without rounding."""
    data = np.zeros((1, n), dtype=np.complex64) + 1
    echoes = Echoes(data, fs=1024.0, fc=4096.0, tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), c=1024.0, t0=1.0)
    ranges = np.asarray(ranges, dtype=np.float64)
    return echoes, Grid.points(np.stack([ranges, 0 * ranges, 0 * ranges], axis=-1))


def test_terms_count_from_the_first_sample_to_the_last() -> None:
    """Up to 1e-4 samples beyond, where the trace is read at the end: places are 2 (r - 512) and 2 (r - 516) from the ends."""
    first, last = 512.0, 516.0
    ranges = [first - 6e-5, first - 4e-5, first, 514.3, last, last + 4e-5, last + 6e-5]
    echoes, grid = on_axis(ranges)
    image, level = exact(echoes, grid)
    assert list(level > 0) == [False, True, True, True, True, True, False]
    assert image[[0, 6]].tolist() == [0, 0]
    assert level[[1, 5]].tolist() == level[[2, 4]].tolist()
    beyond = image[[1, 5]] / image[[2, 4]]  # the phase is the pixel's own: fc tau with tau = 2 r / c
    np.testing.assert_allclose(beyond, np.exp(2j * np.pi * 4096 * 2 * np.array([-4e-5, 4e-5]) / 1024), rtol=0, atol=1e-9)


def test_one_sample_record() -> None:
    echoes, grid = on_axis([511.5, 512.0, 512.5], n=1)
    # The kernel of W at 0 is its integral, the two half-amplitude frequencies: 1/2.2 + 1/2.
    np.testing.assert_allclose(exact(echoes, grid)[0], [0, 1 / 2.2 + 0.5, 0], rtol=0, atol=1e-14)


def low_pass(f: Any) -> Any:
    a = np.abs(f)
    return np.where(a <= 1 / 2.2, 1, np.cos(np.pi / 2 * (a - 1 / 2.2) / (0.5 - 1 / 2.2)) ** 2) * (a < 0.5)


@pytest.mark.parametrize("n", [1, 2, 17, 64])
def test_trace_is_the_fourier_sum_over_a_long_extension(n: int) -> None:
    """sum_k X_k W_k exp(2 pi j f_k t)/m; the kernel falls as 38/t^3, so that m = 2^17 leaves less than 1e-13."""
    m = 2**17
    trace = noise((n,), n)
    place = np.append(np.random.default_rng(2).uniform(0, n - 1, 12), [0, n - 1, n // 2])
    f = np.fft.fftfreq(m)
    spectrum = np.fft.fft(trace, m) * low_pass(f)
    expected = [np.sum(spectrum * np.exp(2j * np.pi * f * t)) / m for t in place]
    found = direct._read(direct._fine_trace(trace), place.astype(np.longdouble))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-13 * np.abs(trace).max())


def test_lagrange_remainder_is_below_rounding() -> None:
    """Remainder w^N/N! prod |t - node| at mid-cell, w = pi/8, N = 20; and a tone at the band's edge, read."""
    product = math.prod((k + 0.5) ** 2 for k in range(direct.TAPS // 2))
    bound = (math.pi / direct.OVERSAMPLING) ** direct.TAPS / math.factorial(direct.TAPS) * product
    assert bound < 1.3e-15
    w = np.pi / direct.OVERSAMPLING
    tone = np.exp(1j * w * np.arange(-8, 3000))
    place = np.random.default_rng(3).uniform(8, 360, 500)
    found = direct._read(tone, place.astype(np.longdouble))
    start = direct.GUARD * direct.OVERSAMPLING - 8
    expected = np.exp(1j * w * (place * direct.OVERSAMPLING + start))
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-13)


@pytest.mark.parametrize("f", [0.0, 0.3, 1 / 2.2, 0.47, 0.49, -0.49, 0.5])
def test_tones_are_weighted_by_the_low_pass(f: float) -> None:
    n = 4096
    data = np.exp(2j * np.pi * f * np.arange(n))[None]
    echoes = Echoes(data, fs=1024.0, fc=4096.0, tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), c=1024.0)
    place = np.array([1800.25, 2048.0, 2200.5])
    grid = Grid.points(np.stack([place / 2, 0 * place, 0 * place], axis=-1))
    expected = low_pass(f) * np.exp(2j * np.pi * (f + 4.0) * place)
    np.testing.assert_allclose(exact(echoes, grid)[0], expected, rtol=0, atol=1e-6)


def test_phase_at_seven_million_wavelengths() -> None:
    """10 km at 1 MHz; the turns fc 2 r/c from rational arithmetic."""
    fc, r, n = 1e6, 10e3 + 1.1, 128
    t0 = 2 * 10e3 / C
    after = 60.25 / FS
    data = pulse(np.arange(n) / np.longdouble(FS), after)[None]
    echoes = Echoes(data, fs=FS, fc=fc, tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), c=C, t0=t0)
    tau = 2 * Fraction(r) / Fraction(C)
    turns = float(Fraction(fc) * tau % 1)
    expected = pulse(float(tau - Fraction(t0)), after) * np.exp(2j * np.pi * turns)
    found = exact(echoes, Grid.points([[r, 0.0, 0.0]]))[0][0]
    assert abs(expected) > 0.5
    assert abs(found - expected) < 1e-13 + 2 * np.pi * 1.4e7 * 4 * EPS


def test_translation_to_utm_changes_nothing() -> None:
    echoes = Echoes(noise((5, 2, 128)), fs=FS, fc=FC, tx=np.zeros((5, 3)), rx=np.zeros((5, 2, 3)), t0=2 * 19.5 / C)
    rng = np.random.default_rng(4)
    tx, rx = (np.rint(rng.uniform(-1, 1, s) * 1024) / 1024 for s in ((5, 3), (5, 2, 3)))
    points = np.rint((rng.uniform(-1, 1, (50, 3)) + np.array([0, 21, 0])) * 1024) / 1024
    offset = np.array([5e6, -5e6 + 1 / 1024, 40.0])
    here = exact(echoes.replace(tx=tx, rx=rx), Grid.points(points))
    there = exact(echoes.replace(tx=tx + offset, rx=rx + offset), Grid.points(points + offset))
    np.testing.assert_array_equal(here[0], there[0])
    np.testing.assert_array_equal(here[1], there[1])
    assert np.all(here[1] > 0)


def scene() -> tuple[Echoes, Grid]:
    tx, rx = geometry(2)
    echoes = Echoes(noise((4, 2, 200)), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=2 * 19.0 / C)
    return echoes, Grid.plane(np.linspace(-2, 3, 6), np.linspace(18.5, 22.5, 9))


def test_weights_scale_each_trace() -> None:
    echoes, grid = scene()
    weights = noise((4, 2), 5)
    image, level = exact(echoes, grid, weights=weights)
    scaled = exact(echoes.replace(data=echoes.data * weights[..., None]), grid)
    np.testing.assert_allclose(image, scaled[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(level, scaled[1], rtol=0, atol=1e-12)
    per_ping = np.array([1, 0, 2, 0.5])
    found, wanted = exact(echoes, grid, weights=per_ping), exact(echoes, grid, weights=np.stack([per_ping] * 2, axis=1))
    np.testing.assert_array_equal(found[0], wanted[0])


def test_level_is_the_incoherent_sum() -> None:
    echoes, grid = scene()
    single = np.zeros(grid.shape)
    for ping in range(4):
        for channel in range(2):
            weights = np.zeros((4, 2))
            weights[ping, channel] = 1
            single += np.abs(exact(echoes, grid, weights=weights)[0]) ** 2
    np.testing.assert_allclose(exact(echoes, grid)[1], np.sqrt(single), rtol=1e-13)


def test_mask_and_pixels_select() -> None:
    echoes, grid = scene()
    image, level = exact(echoes, grid)
    mask = np.random.default_rng(6).random(grid.shape) < 0.5
    masked = Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask)
    found = exact(echoes, masked)
    np.testing.assert_array_equal(found[0], np.where(mask, image, 0))
    np.testing.assert_array_equal(found[1], np.where(mask, level, 0))
    pixels = np.array([5, 3, 50, 3])
    np.testing.assert_array_equal(exact(echoes, grid, pixels)[0], image.ravel()[pixels])
    np.testing.assert_array_equal(exact(echoes, masked, pixels)[1], np.where(mask, level, 0).ravel()[pixels])
    assert exact(echoes, grid, np.array([], dtype=int))[0].shape == (0,)
    nothing = Grid.plane(grid.axes["x"], grid.axes["y"], mask=np.zeros(grid.shape, dtype=bool))
    assert not exact(echoes, nothing)[1].any()


def test_more_pixels_than_a_chunk() -> None:
    echoes, _ = scene()
    grid = Grid.plane(np.linspace(-2, 3, 100), np.linspace(18.5, 22.5, direct.CHUNK // 100 + 20))
    echoes = echoes.replace(data=echoes.data[:1, 0], tx=echoes.tx[:1], rx=echoes.receivers[:1, 0])
    pixels = np.array([0, direct.CHUNK - 1, direct.CHUNK, grid.size - 1])
    np.testing.assert_array_equal(exact(echoes, grid)[0].ravel()[pixels], exact(echoes, grid, pixels)[0])


def test_beam_limits_the_transmitter_only() -> None:
    """Boresight +y per ping, half-angle 45 degrees: the diagonal pixel counts; the receivers are elsewhere."""
    data = np.ones((2, 1, 64), dtype=np.complex64)
    rx = np.array([[[50.0, 0, 0]], [[50.0, 0, 0]]])
    boresight = np.array([[0.0, 2, 0], [0.0, -1, 0]])
    echoes = Echoes(data, fs=64.0, fc=64.0, tx=np.zeros((2, 3)), rx=rx, c=200.0, beam=Beam(boresight, 0.1, np.pi / 4, "cone"))
    points = np.array(
        [[3.0, 3, 0], [3.0, 3 - 1.2e-6, 0], [3.0, 3 - 3e-7, 0], [0, 3, 0], [0, -3, 0], [3, -3, 0], [3, 0, 0], [0, 0, 0]]
    )
    terms = np.rint((exact(echoes, Grid.points(points))[1] / exact(echoes.replace(beam=None), Grid.points(points))[1]) ** 2 * 2)
    # delta m lower are delta / 6 rad more off the first boresight: 2e-7, and 5e-8, less than what still counts
    assert terms.tolist() == [1, 0, 1, 1, 1, 1, 0, 2]
    everywhere = echoes.replace(beam=Beam(np.array([0.0, 1, 0]), 0.1, np.pi, "cone"))
    np.testing.assert_array_equal(
        exact(everywhere, Grid.points(points))[0], exact(echoes.replace(beam=None), Grid.points(points))[0]
    )


def test_start_time_per_ping() -> None:
    echoes, grid = scene()
    start = float(echoes.start_time[0]) + np.arange(4) * 2.0**-14
    total = np.zeros(grid.shape, dtype=np.complex128)
    for ping in range(4):
        part = slice(ping, ping + 1)
        one = echoes.replace(data=echoes.data[part], tx=echoes.tx[part], rx=echoes.rx[part], t0=float(start[ping]))
        total += exact(one, grid)[0]
    np.testing.assert_allclose(exact(echoes.replace(t0=start), grid)[0], total, rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", ["<c8", ">c8", ">c16"])
def test_strides_and_byte_order_do_not_matter(dtype: str) -> None:
    echoes, grid = scene()
    plain = echoes.data.astype(np.dtype(dtype).newbyteorder("="))
    wide = np.zeros((2, 200, 4, 3), dtype=dtype)
    wide[..., 1] = plain.transpose(1, 2, 0)
    strided = wide[..., 1].transpose(2, 0, 1)
    strided.flags.writeable = False
    found, wanted = exact(echoes.replace(data=strided), grid), exact(echoes.replace(data=plain), grid)
    np.testing.assert_array_equal(found[0], wanted[0])


def test_two_dimensional_data_are_one_channel() -> None:
    echoes, grid = scene()
    flat = echoes.replace(data=echoes.data[:, 0], rx=echoes.rx[:, 0])
    first = echoes.replace(data=echoes.data[:, :1], rx=echoes.rx[:, :1])
    np.testing.assert_array_equal(exact(flat, grid)[0], exact(first, grid)[0])


@pytest.mark.parametrize("scale", [2.0**-120, 2.0**120])
def test_amplitude_only_scales(scale: float) -> None:
    echoes, grid = scene()
    image, level = exact(echoes, grid)
    scaled = exact(echoes.replace(data=echoes.data * scale), grid)
    np.testing.assert_allclose(scaled[0], image * scale, rtol=1e-12)
    np.testing.assert_allclose(scaled[1], level * scale, rtol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1j * np.nan])
def test_non_finite_sample_is_named(value: complex) -> None:
    echoes, grid = scene()
    data = echoes.data.copy()
    data[2, 1, 7] = value
    with pytest.raises(ValueError, match=r"data: .* at ping 2, channel 1, sample 7"):
        exact(echoes.replace(data=data), grid)


def test_raw_echoes_are_rejected() -> None:
    echoes, grid = scene()
    with pytest.raises(ValueError, match="compressed=False"):
        exact(echoes.replace(compressed=False), grid)


@pytest.mark.parametrize(
    ("weights", "error"), [(np.ones(3), ValueError), (np.full((4, 2), np.nan), ValueError), (["a"] * 4, TypeError)]
)
def test_bad_weights(weights: Any, error: type[Exception]) -> None:
    echoes, grid = scene()
    with pytest.raises(error, match="weights"):
        exact(echoes, grid, weights=weights)


def test_wrong_types() -> None:
    echoes, grid = scene()
    with pytest.raises(TypeError, match="echoes="):
        exact(echoes.data, grid)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="grid="):
        exact(echoes, echoes.data)  # type: ignore[arg-type]
