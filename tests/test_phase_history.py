"""Phase history to traces: a unit point's closed form, and images against the model's own sum over frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pysas.model.grid import Grid
from pysas.reference.direct import exact
from pysas.signal.phase_history import from_phase_history

pytestmark = pytest.mark.reference  # no engine takes part

C = 299792458.0
STEP = 1.5e6


def survey(pings: int = 24) -> tuple[Any, Any]:
    """Antenna on an arc 10 km from the scene's centre, and the ranges to that centre."""
    azimuth = np.radians(np.linspace(1.0, 3.0, pings))
    position = 7100 * np.stack([np.cos(azimuth), np.sin(azimuth), np.full(pings, 7300 / 7100)], axis=1)
    return position, np.linalg.norm(position, axis=1)


def frequencies(count: int) -> Any:
    return 9.3e9 + STEP * np.arange(count)


def history(freq: Any, position: Any, r0: Any, points: Any, amplitudes: Any, dtype: Any = np.complex128) -> Any:
    """The model as written: sum of a exp(-4j pi freq/c (|x - position| - r0)), phases in long double turns."""
    total = np.zeros((len(position), len(freq)), dtype=np.complex128)
    f = np.asarray(freq, dtype=np.longdouble)
    for x, a in zip(points, amplitudes, strict=True):
        off = np.sqrt(np.sum((np.asarray(x, np.longdouble) - position) ** 2, axis=1)) - r0
        turns = 2 * f * off[:, None] / np.longdouble(C)
        total += a * np.exp(-2j * np.pi * np.asarray(turns % 1, dtype=np.float64))
    return total.astype(dtype)


def matched_sum(samples: Any, freq: Any, position: Any, r0: Any, x: Any) -> complex:
    """Sum over pings and frequencies of samples conj(model of a unit point at x), over the number of frequencies."""
    return complex(np.vdot(history(freq, position, r0, [x], [1.0]), samples)) / len(freq)


@pytest.mark.parametrize("count", [40, 41, 2, 3, 424])
@pytest.mark.parametrize(("dtype", "allowed"), [(np.complex64, 1e-6), (np.complex128, 1e-9)])
def test_trace_of_a_unit_point(count: int, dtype: Any, allowed: float) -> None:
    """p(t - tau) exp(-2j pi fc tau), p(u) = mean of exp(2j pi (freq - fc) u): a Dirichlet kernel, 1 at u = 0."""
    position, r0 = survey(5)
    freq = frequencies(count)
    point = np.array([3.2, -7.1, 0.4])
    echoes = from_phase_history(history(freq, position, r0, [point], [1.0], dtype), freq, position, r0, C)
    tau = 2 * np.sqrt(np.sum((point.astype(np.longdouble) - position) ** 2, axis=1)) / np.longdouble(C)
    turns = np.asarray(np.longdouble(echoes.fc) * tau % 1, dtype=np.float64)
    for p in range(5):
        u = echoes.start_time[p] - np.float64(tau[p]) + np.arange(echoes.n_sample) / echoes.fs
        pulse = np.exp(2j * np.pi * (freq - freq[count // 2]) * u[:, None]).mean(axis=1)
        assert np.abs(echoes.data[p] - pulse * np.exp(-2j * np.pi * turns[p])).max() < allowed
    assert echoes.data.dtype == dtype


def test_sampling() -> None:
    position, r0 = survey(3)
    for count in (2, 3, 40, 41, 424):
        freq = frequencies(count)
        echoes = from_phase_history(np.ones((3, count), np.complex64), freq, position, r0, C)
        assert echoes.compressed
        assert echoes.fc == pytest.approx(freq[count // 2], rel=1e-14)
        assert echoes.bandwidth == pytest.approx(2 * np.abs(freq - echoes.fc).max(), rel=1e-7)
        assert echoes.fs >= 1.25 * echoes.occupied_bandwidth
        assert echoes.fs / echoes.n_sample == pytest.approx(STEP, rel=1e-9)
        middle = echoes.start_time + (echoes.n_sample // 2) / echoes.fs
        assert np.allclose(middle, 2 * r0 / C, rtol=1e-14, atol=0)
        assert np.array_equal(echoes.tx, position)
        assert np.array_equal(echoes.rx, position)
        assert np.abs(echoes.data).argmax(axis=1).tolist() == [echoes.n_sample // 2] * 3


@pytest.mark.parametrize("count", [200, 201])
def test_image_equals_the_sum_over_frequencies(count: int) -> None:
    """The oracle extends traces by zeros where true ones are periodic: 1e-5 of the peak 100 samples from the ends."""
    position, r0 = survey()
    freq = frequencies(count)
    points = np.array([[0.0, 0.0, 0.0], [6.0, -4.0, 1.0], [-9.0, 3.0, 0.0]])
    samples = history(freq, position, r0, points, [1.0, 0.5j, -0.8])
    echoes = from_phase_history(samples, freq, position, r0, C)
    where = np.concatenate([points, [[1.3, 0.2, 0.1], [5.8, -4.0, 1.0], [10.0, 10.0, 0.0]]])
    found, _ = exact(echoes, Grid.points(where))
    expected = np.array([matched_sum(samples, freq, position, r0, x) for x in where])
    assert np.abs(found - expected).max() < 1e-5 * len(position)
    assert abs(expected[0]) > 0.9 * len(position)


def test_rounded_frequencies() -> None:
    """Frequencies stored as float32 (512 Hz off, 3.4e-4 of a step) cost no more than pi 3.4e-4 rad of phase."""
    position, r0 = survey()
    true = frequencies(424) + 123.456
    rounded = true.astype(np.float32)
    assert np.abs(rounded - true).max() > 400
    point = [8.0, -6.0, 0.0]
    samples = history(true, position, r0, [point], [1.0])
    found, _ = exact(from_phase_history(samples, rounded, position, r0, C), Grid.points(np.array([point])))
    assert abs(found[0] / len(position) - 1) < 1.1e-3


def test_any_layout() -> None:
    position, r0 = survey(6)
    freq = frequencies(30)
    plain = history(freq, position, r0, [[1.0, 2.0, 0.0]], [1.0], np.complex64)
    expected = from_phase_history(plain, freq, position, r0, C).data
    wide = np.zeros((12, 60), np.complex64)
    wide[::2, ::-2] = plain
    frozen = plain.copy()
    frozen.flags.writeable = False
    for samples in (plain.astype(">c8"), wide[::2, ::-2], frozen, np.asfortranarray(plain)):
        found = from_phase_history(samples, freq.astype(">f8"), np.asfortranarray(position), r0[::-1][::-1], C)
        assert np.array_equal(found.data, expected)
        assert found.data.dtype.isnative


def _changed(values: Any, index: Any, value: Any) -> Any:
    values = np.array(values)
    values[index] = value
    return values


_POSITION, _R0 = survey(4)
GOOD: dict[str, Any] = {
    "samples": np.ones((4, 20), np.complex64),
    "freq": frequencies(20),
    "position": _POSITION,
    "r0": _R0,
    "c": C,
}
BAD: list[tuple[str, dict[str, Any], type[Exception], str]] = [
    ("real samples", {"samples": np.ones((4, 20))}, TypeError, "samples: expected complex64 or complex128"),
    ("3-D samples", {"samples": np.ones((4, 1, 20), complex)}, ValueError, r"samples: expected 2 dim"),
    ("no samples", {"samples": np.ones((0, 20), complex)}, ValueError, r"samples: expected at least one"),
    ("one frequency", {"samples": np.ones((4, 1), complex)}, ValueError, r"samples: expected at least 2 freq"),
    ("nan", {"samples": _changed(GOOD["samples"], (2, 5), np.nan)}, ValueError, "ping 2, frequency 5"),
    ("freq length", {"freq": frequencies(19)}, ValueError, r"freq: expected shape \(20,\), found \(19,\)"),
    ("freq nan", {"freq": _changed(frequencies(20), 3, np.nan)}, ValueError, "freq: nan at index"),
    ("freq complex", {"freq": frequencies(20) + 0j}, TypeError, "freq: expected real"),
    ("freq negative", {"freq": -frequencies(20)[::-1]}, ValueError, r"freq\[0\]=-9.3285e\+09 Hz"),
    ("freq falling", {"freq": frequencies(20)[::-1]}, ValueError, r"freq\[1\]=.* more than freq\[0\]"),
    ("freq repeated", {"freq": _changed(frequencies(20), 7, frequencies(20)[6])}, ValueError, r"freq\[7\]="),
    (
        "freq outlier",
        {"freq": _changed(frequencies(20), 12, 9.3e9 + 12.002 * STEP)},
        ValueError,
        r"freq\[12\]=.*0.0005",
    ),
    ("freq bent", {"freq": frequencies(20) + 15 * np.arange(20) ** 2}, ValueError, r"freq\[0\]=.* equal steps"),
    ("freq gap", {"freq": np.delete(frequencies(21), 9)}, ValueError, r"freq\[9\]=.* equal steps of 1500000 Hz"),
    ("position shape", {"position": _POSITION[:, :2]}, ValueError, r"position: expected shape \(4, 3\), found"),
    ("position nan", {"position": _changed(_POSITION, (3, 1), np.nan)}, ValueError, "position: nan at ping 3"),
    ("r0 scalar", {"r0": 1e4}, ValueError, r"r0: expected shape \(4,\), found \(\)"),
    ("r0 inf", {"r0": _changed(_R0, 2, np.inf)}, ValueError, "r0: inf at ping 2"),
    ("r0 negative", {"r0": _changed(_R0, 1, -1.0)}, ValueError, "r0: -1.0 at ping 1"),
    ("c zero", {"c": 0.0}, ValueError, "c=0.0"),
    ("c string", {"c": "3e8"}, TypeError, "c='3e8'"),
]


@pytest.mark.parametrize(("change", "error", "text"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_errors(change: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        from_phase_history(**{**GOOD, **change})
