"""Phase history to traces: a unit point's closed form, and images against the model's own sum over frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pysas.model.grid import Grid
from pysas.model.phase_history import PhaseHistory
from pysas.reference.direct import exact
from pysas.signal.phase_history import compressed, from_phase_history

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


# Pings that differ, transmitters apart from receivers


def record(first: Any, step: Any, count: int = 60, dtype: Any = np.complex128, **changes: Any) -> PhaseHistory:
    """Random samples of pings with frequencies of their own: whatever they hold, they are summed."""
    rng = np.random.default_rng(3)
    pings = len(first)
    samples = (rng.standard_normal((pings, count, 2)).view(complex)[..., 0]).astype(dtype)
    tx = rng.standard_normal((pings, 3)) + [5000.0, 0, 0]
    fields: dict[str, Any] = {
        "samples": samples, "first": np.asarray(first, float), "step": np.asarray(step, float), "tx": tx, "rx": tx + 30.0,
        "reference": 2 * np.linalg.norm(tx, axis=1) / C, "c": C,
    }  # fmt: skip
    return PhaseHistory(**fields | changes)


def transformed(echoes: Any, known: PhaseHistory, ping: int) -> Any:
    """The sum over k of samples exp(2j pi ((f - fc) (t - reference) - fc reference))/K, written out, turns in long double."""
    f = np.longdouble(known.first[ping]) + np.arange(known.samples.shape[1]) * np.longdouble(known.step[ping])
    u = (np.arange(echoes.n_sample) - echoes.n_sample // 2) / np.longdouble(echoes.fs)
    fc, reference = np.longdouble(echoes.fc), np.longdouble(known.reference[ping])
    turns = (f - fc) * u[:, None] - fc * reference
    return (known.samples[ping] * np.exp(2j * np.pi * (turns % 1).astype(float))).mean(axis=1)


PINGS = {
    "alike": ([9e9] * 4, [1.5e6] * 4),
    "first frequencies": ([9e9, 9.0123e9, 8.95e9, 9e9 + 0.125], [1.5e6] * 4),
    "steps": ([9e9] * 4, [1.5e6, 1.4e6, 1.7e6, 1.5e6 * (1 + 1e-9)]),
    "steps that rounding makes": ([9e9] * 4, [1.5e6, 1.5e6 * (1 + 1e-15), 1.5e6 * (1 - 1e-13), 1.5e6]),
    "both": ([9e9, 9.1e9, 8.9e9, 9.03e9], [1.5e6, 1.75e6, 1.3e6, 1.3e6]),
    "low": ([2e4, 2.2e4, 2.1e4, 2e4], [110.0, 100.0, 101.0, 100.0]),
}


@pytest.mark.parametrize("count", [2, 60, 61])
@pytest.mark.parametrize("case", PINGS)
def test_every_ping_is_the_sum_over_its_frequencies(case: str, count: int) -> None:
    for dtype, allowed in ((np.complex128, 1e-10), (np.complex64, 1e-6)):
        known = record(*PINGS[case], count=count, dtype=dtype)
        echoes = compressed(known)
        ends = np.stack([known.first, known.first + (count - 1) * known.step])
        assert echoes.data.dtype == dtype
        assert echoes.bandwidth == pytest.approx(2 * np.abs(ends - echoes.fc).max(), rel=1e-9)
        assert echoes.fs >= 1.25 * echoes.occupied_bandwidth
        middle = echoes.start_time + echoes.n_sample // 2 / echoes.fs
        assert np.abs(middle - known.reference).max() * echoes.fs < 1e-10
        scale = np.abs(known.samples).max()
        for ping in range(4):
            assert np.abs(echoes.data[ping] - transformed(echoes, known, ping)).max() < allowed * scale


def test_each_ping_counts_over_one_unambiguous_swath() -> None:
    """A trace repeats after 1/step: `valid` is that long to a sample, about the reference."""
    known = record(*PINGS["steps"])
    echoes = compressed(known)
    assert echoes.valid is not None
    first, last = echoes.valid.T
    assert np.abs((last - first + 1) / echoes.fs * known.step - 1).max() < 1.01 * known.step.max() / echoes.fs
    assert np.abs((first + last) / 2 - echoes.n_sample // 2).max() <= 0.5
    assert compressed(record(*PINGS["first frequencies"])).valid is None
    assert compressed(record(*PINGS["steps that rounding makes"])).valid is None


def test_one_of_equal_pings_is_the_monostatic_case() -> None:
    position, r0 = survey(6)
    for dtype, allowed in ((np.complex64, 1e-7), (np.complex128, 2e-10)):
        samples = history(frequencies(41), position, r0, [[1.0, 2.0, 0.0]], [1.0], dtype)
        same = {"tx": position, "rx": position, "reference": 2 * r0 / C, "samples": samples}
        found = compressed(record([9.3e9] * 6, [STEP] * 6, **same))
        expected = from_phase_history(samples, frequencies(41), position, r0, C)
        assert (found.fs, found.fc, found.bandwidth) == (expected.fs, expected.fc, expected.bandwidth)
        assert np.array_equal(found.start_time, expected.start_time)
        assert np.abs(found.data - expected.data).max() < allowed


def test_image_of_a_bistatic_agile_survey() -> None:
    """Transmitter and receiver on tracks of their own, pings of three bands and two steps: the points peak at their sums."""
    position, _ = survey(24)
    rx = position[::-1] + [300.0, -200.0, 50.0]
    first = 9.3e9 + 40e6 * (np.arange(24) % 3)
    step = np.where(np.arange(24) % 2, STEP, 1.2 * STEP)
    points, amplitudes = np.array([[0.0, 0.0, 0.0], [6.0, -4.0, 1.0]]), [1.0, 0.5j]

    def delay(x: Any) -> Any:
        x = np.asarray(x, np.longdouble)
        return (np.sqrt(((x - position) ** 2).sum(1)) + np.sqrt(((x - rx) ** 2).sum(1))) / np.longdouble(C)

    reference = delay([0.0, 0.0, 0.0]).astype(float)
    f = first[:, None].astype(np.longdouble) + step[:, None] * np.arange(200)

    def model(x: Any) -> Any:
        turns = f * (delay(x) - reference)[:, None]
        return np.exp(-2j * np.pi * (turns % 1).astype(float))

    samples = sum(a * model(x) for x, a in zip(points, amplitudes, strict=True))
    known = record(first, step, samples=samples, tx=position, rx=rx, reference=reference, attrs={"title": "x"})
    echoes = compressed(known)
    where = np.concatenate([points, [[1.3, 0.2, 0.1], [10.0, 10.0, 0.0]]])
    found, _ = exact(echoes, Grid.points(where))
    expected = np.array([np.vdot(model(x), samples) / 200 for x in where])
    assert np.abs(found - expected).max() < 1e-5 * 24  # ends of traces, as above
    assert echoes.attrs == {"title": "x"} and np.array_equal(echoes.rx, rx)


RECORD = record(*PINGS["steps"])
BAD_RECORDS: list[tuple[str, dict[str, Any], type[Exception], str]] = [
    ("first nan", {"first": [9e9, np.nan, 9e9, 9e9]}, ValueError, "first: nan at ping 1"),
    ("first zero", {"first": [9e9, 9e9, 0.0, 9e9]}, ValueError, "first: 0.0 at ping 2: expected Hz > 0"),
    ("step negative", {"step": [1e6, 1e6, 1e6, -1e6]}, ValueError, "step: -1000000.0 at ping 3"),
    ("step shape", {"step": 1e6}, ValueError, r"step: expected shape \(4,\)"),
    ("far apart", {"first": [9e9, 9e9, 9e10, 9e9]}, ValueError, "first, step: pings of 8.* expected traces of at most 1024"),
    ("fine step", {"step": [1e6, 1e-3, 1e6, 1e6]}, ValueError, "first, step: pings of .* steps from 0.001 Hz"),
    ("reference", {"reference": [1e-5, 1e-5, -1e-5, 1e-5]}, ValueError, "reference: -1e-05 at ping 2: expected times >= 0"),
    ("tx", {"tx": np.zeros((3, 3))}, ValueError, r"tx: expected shape \(4, 3\)"),
    ("rx nan", {"rx": _changed(RECORD.rx, (2, 1), np.nan)}, ValueError, "rx: nan at ping 2"),
    ("samples inf", {"samples": _changed(RECORD.samples, (3, 9), np.inf)}, ValueError, r"inf.* at ping 3, frequency 9"),
    ("samples real", {"samples": RECORD.samples.real}, TypeError, "samples: expected complex64"),
    ("c", {"c": -1.0}, ValueError, "c=-1.0"),
    ("velocity", {"velocity": np.full((4, 3), np.nan)}, ValueError, "velocity: nan at ping 0"),
]


@pytest.mark.parametrize(("change", "error", "text"), [b[1:] for b in BAD_RECORDS], ids=[b[0] for b in BAD_RECORDS])
def test_errors_of_records(change: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        compressed(PhaseHistory(**{**vars(RECORD), **change}))


# Samples over delay


def delays(**changes: Any) -> PhaseHistory:
    """Points' echoes over delay as a transform of flat bands leaves them, written out; two bands about other middles."""
    position, _ = survey(4)
    band = np.array([[9.3e9, 9.5e9], [9.3e9, 9.5e9], [9.35e9, 9.55e9], [9.3e9, 9.5e9]])
    reference = 2 * np.linalg.norm(position, axis=1) / C
    tau = 2 * np.sqrt(np.sum((np.array([3.0, -5.0, 0.0], np.longdouble) - position) ** 2, axis=1)) / np.longdouble(C)
    late = (tau - reference)[:, None]
    first, step = np.array([-1e-7, -1.1e-7, -9e-8, -1e-7]), np.full(4, 3.5e-9)
    q = np.sinc(((first[:, None] + step[:, None] * np.arange(60) - late) * 200e6).astype(float))
    turns = band.mean(axis=1)[:, None] * late
    fields: dict[str, Any] = {
        "samples": q * np.exp(-2j * np.pi * (turns % 1).astype(float)), "first": first, "step": step, "tx": position,
        "rx": position, "reference": reference, "c": C, "band": band,
    }  # fmt: skip
    return PhaseHistory(**fields | changes)


def test_delays_become_echoes_of_the_model() -> None:
    """p(t - tau) exp(-2j pi fc tau) with p(u) = sinc(B u) exp(2j pi (middle - fc) u), whatever the reference was."""
    known = delays()
    echoes = compressed(known)
    assert echoes.fs == pytest.approx(1 / 3.5e-9) and echoes.fc == 9.425e9 and echoes.bandwidth == pytest.approx(250e6)
    tau = 2 * np.sqrt(np.sum((np.array([3.0, -5.0, 0.0], np.longdouble) - known.tx) ** 2, axis=1)) / np.longdouble(C)
    assert known.band is not None
    for ping in range(4):
        t = known.reference[ping] + np.longdouble(known.first[ping]) + np.arange(60) * np.longdouble(known.step[ping])
        u = t - tau[ping]
        turns = (known.band[ping].mean() - echoes.fc) * u - echoes.fc * tau[ping]
        expected = np.sinc((u * 200e6).astype(float)) * np.exp(2j * np.pi * (turns % 1).astype(float))
        assert np.abs(echoes.data[ping] - expected).max() < 1e-8  # 9.4 GHz at 68 us, of which float64 tells 1e-20 s
        assert abs(float(t[0]) - echoes.start_time[ping]) < 1e-19


BAD_DELAYS: list[tuple[str, dict[str, Any], str]] = [
    ("band", {"band": _changed(delays().band, (1, 1), 9.2e9)}, "band: 9.3e.09 to 9.2e.09 Hz at ping 1"),
    ("bands apart", {"band": _changed(delays().band, 2, [8e9, 8.1e9])}, "step: 3.5e-09 s for 1.5e.09 Hz of all pings"),
    ("step", {"step": _changed(delays().step, 3, 4.1e-9)}, "step: 4.1e-09 s at ping 3, 3.5e-09 s at ping 0: expected one step"),
    ("step zero", {"step": np.zeros(4)}, "step: 0.0 at ping 0: expected s > 0"),
    ("samples", {"samples": _changed(delays().samples, (2, 7), np.nan)}, "at ping 2, delay 7: expected finite"),
]


@pytest.mark.parametrize(("change", "text"), [b[1:] for b in BAD_DELAYS], ids=[b[0] for b in BAD_DELAYS])
def test_errors_of_delays(change: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        compressed(delays(**change))
