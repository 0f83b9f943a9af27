"""Simulated raw echoes against the closed-form moving-receiver delay, the analytic pulse and the definition of noise."""

import warnings

import numpy as np
import pytest

from pysas import tracks
from pysas.pulse import LFM
from pysas.simulation import Element, _delay, aliased_share, simulate

C = 1500.0


def quadratic_delay(x, tx, rx, v, c=C):
    """Positive root of (c^2 - v^2) tau^2 - 2 (c D - d.v) tau + D^2 - d^2 = 0, d = x - rx, D = |x - tx|, in long double."""
    x, tx, rx, v = (np.asarray(a, dtype=np.longdouble) for a in (x, tx, rx, v))
    d, there = x - rx, np.sqrt(np.sum((x - tx) ** 2))
    a, b = c * c - v @ v, c * there - d @ v
    return float((b + np.sqrt(b * b - a * (there**2 - d @ d))) / a)


def one_ping(pulse, points, amplitudes, **options):
    fields = {"tx": [[0.0, 0.0, 0.0]], "rx": [[[0.3, 0.0, 0.0]]], "fs": 40e3, "duration": 0.04, "dtype": np.complex128}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return simulate(points, amplitudes, pulse, **(fields | options))


def test_moving_receiver_delay_is_the_root_of_its_quadratic():
    draw = np.random.default_rng(3)
    for _ in range(300):
        x, tx, rx = draw.uniform(-60, 60, (3, 3))
        v = draw.uniform(-40, 40, 3)
        assert _delay(x, tx, rx, v, C) == pytest.approx(quadratic_delay(x, tx, rx, v), abs=1e-12)


@pytest.mark.parametrize(("window", "parameter"), [("rect", None), ("tukey", 0.3), ("taylor", 30.0), ("gaussian", 1e-4)])
@pytest.mark.parametrize("bandwidth", [20e3, -20e3])
@pytest.mark.parametrize("fc", [100e3, 98.5e3])
def test_samples_are_the_analytic_pulse_at_the_exact_delay(window, parameter, bandwidth, fc):
    pulse = LFM(100e3, bandwidth, 4e-3, window, parameter)
    v, rx = np.array([2.0, -1.0, 0.5]), np.array([0.3, 0.0, 0.0])
    points, amplitudes = np.array([[1.0, 20.0, 3.0], [-2.0, 22.0, 4.0]]), np.array([1.0, 0.5 - 2j])
    raw = one_ping(pulse, points, amplitudes, velocity=[v], fc=fc, t0=0.01)
    t = 0.01 + np.arange(raw.n_sample) / raw.fs
    expected = np.zeros(t.size, dtype=np.complex128)
    for x, a in zip(points, amplitudes, strict=True):
        tau = quadratic_delay(x, np.zeros(3), rx, v)
        expected += a * pulse.waveform(t - tau, fc) * np.exp(-2j * np.pi * fc * tau)
    assert np.abs(raw.data[0, 0] - expected).max() < 1e-10 * np.abs(amplitudes).sum()


def test_spreading_divides_by_both_ranges():
    pulse = LFM(100e3, 20e3, 1e-3)
    plain, spread = (one_ping(pulse, [[0.0, 20.0, 0.0]], [1.0], spreading=on) for on in (False, True))
    there, back = 20.0, np.hypot(0.3, 20.0)
    assert np.abs(spread.data * there * back - plain.data).max() < 1e-12


def test_element_pattern_has_its_null_and_hears_nothing_behind():
    # narrow band: sinc(f L sin(angle)/c) is zero at sin(angle) = c/(f L)
    pulse = LFM(100e3, 1.0, 1e-3)
    length = 0.05
    sine = C / (100e3 * length)
    face = Element(length)
    peak = np.abs(one_ping(pulse, [[0.0, 20.0, 0.0]], [1.0], tx_element=face).data).max()
    at_null = [[20.0 * sine, 20.0 * np.sqrt(1 - sine**2), 0.0]]
    assert peak == pytest.approx(1.0, abs=1e-12)
    assert np.abs(one_ping(pulse, at_null, [1.0], tx_element=face).data).max() < 1e-5
    assert not one_ping(pulse, [[0.0, -20.0, 0.0]], [1.0], tx_element=face).data.any()
    # half way to the null in sine: sinc(1/2) = 2/pi, on receive as well (receiver at the transmitter)
    half = [[20.0 * sine / 2, 20.0 * np.sqrt(1 - (sine / 2) ** 2), 0.0]]
    both = one_ping(pulse, half, [1.0], tx_element=face, rx_element=face, rx=[[[0.0, 0.0, 0.0]]])
    assert np.abs(both.data).max() == pytest.approx((2 / np.pi) ** 2, rel=1e-4)


def test_element_pattern_follows_the_instantaneous_frequency():
    pulse = LFM(100e3, 40e3, 2e-3)
    point, length = np.array([2.0, 20.0, 0.0]), 0.1
    raw = one_ping(pulse, [point], [1.0], tx_element=Element(length), fs=100e3, rx=[[[0.0, 0.0, 0.0]]])
    bare = one_ping(pulse, [point], [1.0], fs=100e3, rx=[[[0.0, 0.0, 0.0]]])
    t = np.arange(raw.n_sample) / raw.fs - 2 * np.linalg.norm(point) / C - 1e-3
    f = 100e3 + pulse.rate * t
    inside = np.abs(bare.data[0, 0]) > 0
    expected = np.sinc(f * length * point[0] / np.linalg.norm(point) / C)[inside]
    assert np.abs((raw.data[0, 0] / np.where(inside, bare.data[0, 0], 1))[inside] - expected).max() < 1e-9


def test_noise_has_the_stated_power_and_repeats_with_its_seed():
    pulse = LFM(100e3, 20e3, 2e-3, "tukey")
    track = tracks.straight(40, 0.1)
    fields = {"tx": track.position, "rx": track.position, "fs": 40e3, "duration": 0.05}
    clean = simulate([[0.0, 20.0, 0.0]], [1.0], pulse, **fields)
    a, b = (simulate([[0.0, 20.0, 0.0]], [1.0], pulse, snr_db=3.0, seed=5, **fields) for _ in range(2))
    noise = a.data - clean.data
    ratio = np.mean(np.abs(clean.data) ** 2) / np.mean(np.abs(noise) ** 2)
    assert 10 * np.log10(ratio) == pytest.approx(3.0, abs=0.1)  # 80 000 samples: standard error 0.015 dB
    assert np.array_equal(a.data, b.data)
    assert not np.array_equal(a.data, simulate([[0.0, 20.0, 0.0]], [1.0], pulse, snr_db=3.0, seed=6, **fields).data)


def test_threads_do_not_change_a_bit():
    track = tracks.perturbed(7, 0.1, seed=1)
    draw = np.random.default_rng(0)
    points = np.stack([draw.uniform(-5, 5, 200), draw.uniform(15, 25, 200), np.zeros(200)], axis=1)
    fields = {"tx": track.position, "rx": tracks.array(track, 3, 0.1), "velocity": track.velocity, "fs": 40e3, "duration": 0.04}
    images = [
        simulate(points, np.ones(200), LFM(100e3, 20e3, 1e-3, "tukey"), threads=n, snr_db=20, seed=1, **fields).data
        for n in (1, 2, 3)
    ]
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])


def test_aliased_share_agrees_with_a_transform_and_warns():
    pulse = LFM(100e3, 20e3, 1e-3)
    # independent: FFT of the pulse sampled 64 times faster than its band, zero-padded
    fast = 64 * 20e3
    t = (np.arange(int(1e-3 * fast)) + 0.5) / fast
    energy = np.abs(np.fft.fft(pulse.waveform(t), 1 << 17)) ** 2
    f = np.fft.fftfreq(1 << 17, 1 / fast)
    expected = energy[np.abs(f) > 10e3].sum() / energy.sum()
    assert aliased_share(pulse, 20e3) == pytest.approx(expected, abs=2e-4)
    with pytest.warns(UserWarning, match="energy lies outside"):
        simulate([[0.0, 20.0, 0.0]], [1.0], pulse, tx=[[0, 0, 0]], rx=[[0, 0, 0]], fs=20e3, duration=0.04)


GOOD = {"tx": [[0.0, 0, 0]], "rx": [[0.0, 0, 0]], "fs": 60e3, "duration": 0.03}


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"points": [[0.0, np.nan, 0.0]]}, ValueError, "points.*point 0"),
        ({"points": [[0.0, 1.0]]}, ValueError, "points: expected shape"),
        ({"points": np.zeros((0, 3))}, ValueError, "points: expected at least one"),
        ({"amplitudes": [1.0, 2.0]}, ValueError, "amplitudes: expected shape"),
        ({"amplitudes": [np.inf]}, ValueError, "amplitudes: non-finite at point 0"),
        ({"amplitudes": ["a"]}, TypeError, "amplitudes"),
        ({"pulse": "chirp"}, TypeError, "pulse='chirp'"),
        ({"fs": 0.0}, ValueError, "fs=0.0"),
        ({"duration": -1.0}, ValueError, "duration=-1.0"),
        ({"fc": np.nan}, ValueError, "fc=nan"),
        ({"dtype": np.float32}, TypeError, "dtype"),
        ({"rx": [[0.0, 0, 0], [1.0, 0, 0]]}, ValueError, "tx: expected shape"),
        ({"tx": [[0.0, np.inf, 0]]}, ValueError, "tx: inf at ping 0"),
        ({"velocity": [[0.0, 400.0, 0]]}, ValueError, "velocity"),
        ({"snr_db": np.nan}, ValueError, "snr_db=nan"),
        ({"threads": 0}, ValueError, "threads=0"),
        ({"tx_element": Element(0.1, boresight=np.ones((3, 3)), along=[1.0, 0, 0])}, ValueError, "tx_element"),
    ],
)
def test_errors_name_the_argument(change, error, text):
    arguments = {"points": [[0.0, 20.0, 0.0]], "amplitudes": [1.0], "pulse": LFM(100e3, 20e3, 2e-3, "tukey")} | GOOD | change
    with pytest.raises(error, match=text):
        simulate(arguments.pop("points"), arguments.pop("amplitudes"), arguments.pop("pulse"), **arguments)


@pytest.mark.parametrize(
    ("arguments", "text"), [({"length": 0}, "length=0"), ({"length": 1, "boresight": (0, 0, 0)}, "boresight"),
                            ({"length": 1, "along": (0, 1, 0)}, "along")]
)  # fmt: skip
def test_element_errors(arguments, text):
    with pytest.raises(ValueError, match=text):
        Element(**arguments)
