"""LFM pulses against the formulas of P. Pailhas et al. (2017), SciPy's windows and independent quadrature.

Quadrature here is the trapezium rule on a dense regular grid or SciPy's adaptive `quad`; the module itself uses closed
forms and Gauss-Legendre panels.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.integrate
import scipy.signal.windows
from hypothesis import given, settings
from hypothesis import strategies as st

from pysas.model.pulse import LFM

pytestmark = pytest.mark.reference  # no engine takes part

FC, B, T = 100e3, 20e3, 1e-3
PULSES = {
    "rect": LFM(FC, B, T),
    "rect down": LFM(FC, -B, T),
    "gaussian": LFM(FC, B, T, "gaussian", 2e-5),
    "gaussian chirp": LFM(FC, -B, T, "gaussian", 3.98e-4),
    "tukey": LFM(FC, B, T, "tukey"),
    "tukey 1": LFM(FC, -B, T, "tukey", 1.0),
    "tukey 0": LFM(FC, B, T, "tukey", 0.0),
    "taylor": LFM(FC, B, T, "taylor"),
    "taylor 50": LFM(FC, -B, T, "taylor", 50.0),
}
EVERY = pytest.mark.parametrize("pulse", PULSES.values(), ids=PULSES.keys())


def quad(function: Any, start: float, stop: float) -> complex:
    """Adaptive quadrature of a complex function in pieces of a tenth of the interval."""
    edges = np.linspace(start, stop, 11)
    total = 0j
    for a, b in itertools.pairwise(edges):
        for part, unit in ((np.real, 1), (np.imag, 1j)):
            total += unit * scipy.integrate.quad(lambda t, p=part: float(p(function(t))), a, b, epsabs=1e-13)[0]
    return total


@EVERY
def test_waveform_is_equation_8(pulse: LFM) -> None:
    """A(t) exp(2j pi [f0 + K t/2] t) about the centre, demodulated: only the carrier of the demodulation is missing."""
    t = np.linspace(0.02, 0.97, 41) * T
    u = t - T / 2
    band = pulse.envelope(t) * np.exp(2j * np.pi * (FC + pulse.bandwidth / (2 * T) * u) * u)
    for fc in (FC, 97e3):
        assert np.allclose(pulse.waveform(t, fc) * np.exp(2j * np.pi * fc * u), band, atol=1e-12)
    assert np.array_equal(pulse.waveform(t), pulse.waveform(t, FC))


@EVERY
def test_envelope(pulse: LFM) -> None:
    """1 at the centre, even about it, 0 outside the support."""
    start, stop = pulse.support
    assert pulse.envelope(T / 2) == pytest.approx(1, abs=1e-15)
    u = np.linspace(0, (stop - start) / 2, 100)
    assert np.allclose(pulse.envelope(T / 2 + u), pulse.envelope(T / 2 - u), atol=1e-12)
    assert not pulse.envelope([start - 1e-9, stop + 1e-9]).any()
    assert pulse.envelope(np.zeros((2, 3, 4))).shape == (2, 3, 4)
    assert pulse.waveform(np.zeros((2, 0))).shape == (2, 0)


def test_support() -> None:
    assert PULSES["rect"].support == PULSES["tukey"].support == PULSES["taylor"].support == (0.0, T)
    start, stop = PULSES["gaussian"].support
    assert start + stop == pytest.approx(T)
    assert np.exp(-(((stop - start) / 2 / 2e-5) ** 2) / 2) < 1e-16


@pytest.mark.parametrize("n", [64, 101])
def test_tukey_is_scipys(n: int) -> None:
    """SciPy's symmetric Tukey window has its samples on both ends."""
    for alpha in (0.0, 0.1, 0.5, 1.0):
        pulse = LFM(FC, B, T, "tukey", alpha)
        expected = scipy.signal.windows.tukey(n, alpha, sym=True)
        assert np.allclose(pulse.envelope(np.linspace(0, T, n)), expected, atol=1e-12)


@pytest.mark.parametrize("n", [64, 101])
@pytest.mark.parametrize("level", [20, 35, 60])
def test_taylor_is_scipys(n: int, level: int) -> None:
    """SciPy's symmetric Taylor window has its samples in the middle of n equal cells and 1 at the centre."""
    pulse = LFM(FC, B, T, "taylor", level)
    expected = scipy.signal.windows.taylor(n, nbar=4, sll=level, norm=True, sym=True)
    assert np.allclose(pulse.envelope((np.arange(n) + 0.5) * T / n), expected, atol=1e-12)


def test_gaussian_is_equation_10() -> None:
    t = np.linspace(-T, 2 * T, 301)
    expected = np.exp(-((t - T / 2) ** 2) / (2 * 3.98e-4**2))
    assert np.allclose(PULSES["gaussian chirp"].envelope(t), expected, rtol=1e-12)


@EVERY
def test_energy(pulse: LFM) -> None:
    expected = quad(lambda t: pulse.envelope(t) ** 2, *pulse.support).real
    assert pulse.energy == pytest.approx(expected, rel=1e-9)


@EVERY
def test_parseval(pulse: LFM) -> None:
    """Energy in the spectrum; the spectrum of a pulse with steps falls as 1/f, leaving 1e-3 of it beyond +-200 kHz.

    Spectra are sampled closer than 1/(2 support): the sum over f is then the integral itself.
    """
    f = np.arange(-200e3, 200e3 + 1, 400.0 if pulse.window != "gaussian" else 125.0)
    found = np.sum(np.abs(pulse.spectrum(f)) ** 2) * (f[1] - f[0])
    smooth = pulse.window in ("gaussian",) or pulse.window_parameter == 1.0
    assert found == pytest.approx(pulse.energy, rel=1e-6 if smooth else 2e-3)


@EVERY
def test_spectrum(pulse: LFM) -> None:
    """Fourier transform of `waveform`, its phase referred to the leading edge."""
    f = np.array([-31e3, -9.7e3, 0.0, 123.4, 10e3, 25e3])
    expected = [quad(lambda t, v=v: pulse.waveform(t) * np.exp(-2j * np.pi * v * t), *pulse.support) for v in f]
    assert np.abs(pulse.spectrum(f) - expected).max() < 1e-6 * np.abs(expected).max()
    assert pulse.spectrum(f.reshape(2, 3)).shape == (2, 3)
    assert complex(pulse.spectrum(0.0)) == pytest.approx(expected[2], abs=1e-6 * np.abs(expected).max())


@EVERY
def test_response(pulse: LFM) -> None:
    """Eq 11: integral of conj(s(t')) s(t' + t) over t', over the energy."""
    start, stop = pulse.support
    times = np.array([0.0, 3.1e-6, -2.2e-5, 7e-5, 2.7e-4, -0.8e-3])
    for t in times:
        overlap = start + max(0.0, -t), stop - max(0.0, t)
        expected = quad(lambda u, t=t: np.conj(pulse.waveform(u)) * pulse.waveform(u + t), *overlap)
        assert abs(expected.imag) < 1e-9 * pulse.energy
        assert pulse.response(t) == pytest.approx(expected.real / pulse.energy, abs=1e-6)
    assert pulse.response(0.0) == pytest.approx(1, abs=1e-6)
    assert pulse.response(times.reshape(3, 2)).shape == (3, 2)


def test_rect_response_is_equation_17() -> None:
    """B(t) = T sin[pi t B (1 - |t|/T)]/(pi t B), B(0) = T, 0 beyond +-T."""
    t = np.array([-1.2e-3, -9e-4, -1.3e-5, 2e-6, 5e-5, 1e-3, 2e-3])
    inside = np.abs(t) < T
    expected = np.where(inside, T * np.sin(np.pi * t * B * (1 - np.abs(t) / T)) / (np.pi * t * B), 0)
    for pulse in (PULSES["rect"], PULSES["rect down"]):
        assert np.allclose(pulse.energy * pulse.response(t), expected, atol=1e-15)
        assert pulse.energy * pulse.response(0.0) == T


def test_gaussian_response_is_equation_18() -> None:
    """B(t) = sigma sqrt(pi) exp{-[1/(4 sigma^2) + pi^2 (B/T)^2 sigma^2] t^2}."""
    t = np.linspace(-1e-4, 1e-4, 21)
    for name, sigma in (("gaussian", 2e-5), ("gaussian chirp", 3.98e-4)):
        width = 1 / (4 * sigma**2) + np.pi**2 * (B / T) ** 2 * sigma**2
        expected = sigma * np.sqrt(np.pi) * np.exp(-width * t**2)
        assert np.allclose(PULSES[name].energy * PULSES[name].response(t), expected, rtol=1e-12)


def test_partner_sigma_has_the_same_response() -> None:
    """sigma and T/(2 pi B sigma) give the same |B(t)| shape."""
    t = np.linspace(-1e-4, 1e-4, 21)
    partner = LFM(FC, B, T, "gaussian", T / (2 * np.pi * B * 2e-5))
    assert np.allclose(partner.response(t), PULSES["gaussian"].response(t), rtol=1e-10)


@EVERY
def test_response_is_the_transform_of_the_power_spectrum(pulse: LFM) -> None:
    f = np.arange(-200e3, 200e3 + 1, 400.0 if pulse.window != "gaussian" else 125.0)
    power = np.abs(pulse.spectrum(f)) ** 2 * (f[1] - f[0])
    t = np.array([0.0, 1e-5, 6e-5])
    found = np.array([np.sum(power * np.exp(2j * np.pi * f * v)) for v in t]) / pulse.energy
    assert np.abs(found - pulse.response(t)).max() < 2e-3


def test_occupied_bandwidth() -> None:
    assert PULSES["rect down"].occupied_bandwidth == B
    assert PULSES["tukey"].occupied_bandwidth == B
    for name in ("gaussian", "gaussian chirp"):
        pulse = PULSES[name]
        edge = np.abs(pulse.spectrum(pulse.occupied_bandwidth / 2) / pulse.spectrum(0.0))
        assert edge == pytest.approx(1e-3, rel=1e-9)


def test_rate_and_sweep() -> None:
    """The instantaneous frequency runs from -B/2 to B/2, or the other way for a down-sweep."""
    t = np.array([0.1, 0.5, 0.9]) * T
    for name, sign in (("rect", 1), ("rect down", -1)):
        pulse = PULSES[name]
        assert pulse.rate == sign * B / T
        step = 1e-9
        turn = np.angle(pulse.waveform(t + step) * np.conj(pulse.waveform(t - step))) / (4 * np.pi * step)
        assert np.allclose(turn, sign * B * np.array([-0.4, 0, 0.4]), atol=1)


@settings(max_examples=12, deadline=None)
@given(
    sweep=st.floats(1e3, 5e4),
    duration=st.floats(1e-4, 3e-3),
    sign=st.sampled_from([1, -1]),
    window=st.sampled_from([("rect", None), ("gaussian", 1e-4), ("tukey", 0.3), ("taylor", 40.0)]),
)
def test_response_bounds(sweep: float, duration: float, sign: int, window: tuple[str, float | None]) -> None:
    """|response| <= 1 = response(0) (Cauchy-Schwarz), even, and blind to the sweep's direction."""
    pulse = LFM(FC, sign * sweep, duration, *window)
    mirrored = LFM(FC, -sign * sweep, duration, *window)
    t = np.linspace(-1.1, 1.1, 45) * duration
    found = pulse.response(t)
    assert np.all(np.abs(found) <= 1 + 1e-6)
    assert np.allclose(found, pulse.response(-t), atol=1e-6)
    assert np.allclose(found, mirrored.response(t), atol=1e-6)


def test_defaults_and_repr() -> None:
    assert LFM(FC, B, T, "tukey").window_parameter == 0.1
    assert LFM(FC, B, T, "taylor").window_parameter == 35.0
    assert LFM(FC, B, T).window_parameter is None
    assert repr(LFM(FC, -B, T, "tukey")) == "LFM(100 kHz, 20 kHz down-sweep, 1 ms, tukey 0.1)"
    assert LFM(FC, B, T) == LFM(FC, B, T)
    assert LFM(np.float32(FC), int(B), np.array(T)) == LFM(FC, B, T)  # type: ignore[arg-type]


BAD: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"fc": 0.0}, ValueError, "fc=0.0: expected a finite number > 0"),
    ({"fc": -1e5}, ValueError, "fc=-100000.0"),
    ({"fc": np.nan}, ValueError, "fc=nan"),
    ({"fc": True}, TypeError, "fc=True"),
    ({"fc": np.True_}, TypeError, "fc=np.True_"),
    ({"fc": "1e5"}, TypeError, "fc='1e5'"),
    ({"fc": 1e5 + 0j}, TypeError, r"fc=\(100000\+0j\)"),
    ({"fc": np.complex64(1e5 + 3j)}, TypeError, "fc=np.complex64"),
    ({"fc": np.array("1e5")}, TypeError, "fc=array"),
    ({"fc": np.array([1e5])}, TypeError, "fc=array"),
    ({"fc": None}, TypeError, "fc=None"),
    ({"fc": 10**400}, ValueError, "expected a finite number > 0"),
    ({"bandwidth": 0.0}, ValueError, "bandwidth=0.0: expected a non-zero"),
    ({"bandwidth": np.inf}, ValueError, "bandwidth=inf"),
    ({"bandwidth": 2e5}, ValueError, "bandwidth=200000.0: expected less than twice"),
    ({"duration": 0.0}, ValueError, "duration=0.0"),
    ({"duration": -1e-3}, ValueError, "duration=-0.001"),
    ({"window": "hann"}, ValueError, "window='hann': expected one of rect, gaussian, tukey, taylor"),
    ({"window": None}, ValueError, "window=None"),
    ({"window_parameter": 0.5}, ValueError, "window_parameter=0.5: a rect window has none"),
    ({"window": "gaussian"}, ValueError, "sigma"),
    ({"window": "gaussian", "window_parameter": 0.0}, ValueError, "window_parameter=0.0"),
    ({"window": "tukey", "window_parameter": 1.5}, ValueError, r"=1.5: expected a finite number in \[0.0, 1.0\]"),
    ({"window": "tukey", "window_parameter": np.nan}, ValueError, "window_parameter=nan"),
    ({"window": "taylor", "window_parameter": -35}, ValueError, "window_parameter=-35"),
]


@pytest.mark.parametrize(("change", "error", "text"), BAD)
def test_errors(change: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        LFM(**{"fc": FC, "bandwidth": B, "duration": T, **change})
