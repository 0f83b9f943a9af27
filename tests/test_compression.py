"""Range compression against closed forms (P. Pailhas et al. 2017, Eqs 11-18) and its invariances.

Raw echoes are made here directly from the analytic pulse at fractional delays. Sampled correlation differs from the
analytic one by spectral aliasing only: of a Gaussian well inside fs nothing is left but the rounding of 600 turns of
carrier (1e-12); a Tukey pulse has a continuous slope, so its spectrum beyond fs/2 falls as 1/f^3 and its square, which
is what aliases, stays near 1e-5; a rect or Taylor pulse has steps and gains or loses about one sample at either end.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM
from pysas.signal import blocks
from pysas.signal.compression import compress

pytestmark = pytest.mark.reference  # no engine takes part

FS, FC, N = 40e3, 100e3, 600
TUKEY = LFM(FC, 20e3, 2e-3, "tukey", 0.5)
RECT = LFM(FC, 20e3, 2e-3)


def echoes(data: Any, pulse: Any = TUKEY, **fields: Any) -> Echoes:
    data = np.asarray(data)
    zero = np.zeros((data.shape[0], 3))
    fields = {"fs": FS, "fc": FC, "tx": zero, "rx": zero, "compressed": False, "pulse": pulse} | fields
    if data.ndim == 3:
        fields["rx"] = np.zeros((*data.shape[:2], 3))
    return Echoes(data, **fields)


def echo(pulse: LFM, delay: float, amplitude: complex = 1.0, *, fc: float = FC, t0: float = 0.0, n: int = N) -> Any:
    t = t0 + np.arange(n) / FS
    return amplitude * pulse.waveform(t - delay, fc) * np.exp(-2j * np.pi * fc * delay)


def noise(shape: tuple[int, ...], seed: int = 1, dtype: Any = np.complex64) -> Any:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)


@pytest.mark.parametrize("sweep", [1, -1])
@pytest.mark.parametrize("fc", [FC, 101e3])
@pytest.mark.parametrize(
    ("window", "parameter", "allowed"),
    [
        ("rect", None, 1.2 / (FS * 2e-3)),
        ("tukey", 0.5, 2e-5),
        ("tukey", 1.0, 5e-6),
        ("taylor", 35.0, 0.5 / (FS * 2e-3)),
        ("gaussian", 2.5e-4, 1e-12),
    ],
)
def test_closed_form(window: str, parameter: float | None, allowed: float, fc: float, sweep: int) -> None:
    pulse = LFM(FC, sweep * 20e3, 2e-3, window, parameter)
    delay, amplitude = (244 + 0.37) / FS, 1.7 - 0.4j
    found = compress(echoes([echo(pulse, delay, amplitude, fc=fc)], pulse, fc=fc)).data[0]
    u = np.arange(N) / FS - delay
    expected = amplitude * pulse.response(u) * np.exp(2j * np.pi * (pulse.fc - fc) * u - 2j * np.pi * fc * delay)
    assert np.abs(found - expected).max() <= allowed * abs(amplitude)


def test_down_sweep_peaks_where_the_up_sweep_does() -> None:
    delay = 250 / FS
    for pulse in (LFM(FC, 20e3, 2e-3), LFM(FC, -20e3, 2e-3)):
        assert np.argmax(np.abs(compress(echoes([echo(pulse, delay)], pulse)).data[0])) == 250


def test_gaussian_that_begins_before_transmission() -> None:
    """sigma = 0.4 T: support from -2.9 T; the echo's early part lies before its travel time and is not lost."""
    pulse = LFM(FC, 8e3, 1e-3, "gaussian", 4e-4)
    assert pulse.support[0] < 0
    found = compress(echoes([echo(pulse, 300 / FS)], pulse)).data[0]
    expected = pulse.response((np.arange(N) - 300) / FS) * np.exp(-2j * np.pi * FC * 300 / FS)
    assert np.abs(found - expected).max() < 1e-12


@pytest.mark.parametrize(
    "options",
    [{}, {"window": "hann"}, {"window": ("taylor", 4, 35)}, {"inverse": 1e-2}, {"window": "hamming", "inverse": 1e-3}],
)
@pytest.mark.parametrize("fc", [FC, 101e3])
def test_peak_is_the_amplitude(options: dict[str, Any], fc: float) -> None:
    delay, amplitude = 240 / FS, 0.3 + 0.8j
    for pulse in (TUKEY, RECT, LFM(FC, -15e3, 3e-3, "gaussian", 3e-4)):
        found = compress(echoes([echo(pulse, delay, amplitude, fc=fc)], pulse, fc=fc), **options).data[0]
        assert abs(found[240] * np.exp(2j * np.pi * fc * delay) - amplitude) < 1e-12
        assert np.argmax(np.abs(found)) == 240


def test_sampled_waveform_equals_its_lfm() -> None:
    raw = echo(TUKEY, 200.4 / FS)
    sampled = TUKEY.waveform(np.arange(int(2e-3 * FS) + 1) / FS)
    expected = compress(echoes([raw], TUKEY)).data
    assert np.abs(compress(echoes([raw], sampled)).data - expected).max() < 1e-14
    assert compress(echoes([raw], sampled, bandwidth=21e3), window="hann").bandwidth == 21e3


def test_matches_direct_correlation() -> None:
    """Eq 11 as a plain sum over samples, for a record full of noise: linear at both ends, no wrap-round."""
    pulse = TUKEY.waveform(np.arange(81) / FS)
    for n in (81, 97, 200):
        data = noise((1, n), dtype=np.complex128)
        full = np.concatenate([data[0], np.zeros(81)])
        expected = np.array([np.vdot(pulse, full[i : i + 81]) for i in range(n)]) / np.vdot(pulse, pulse).real
        assert np.abs(compress(echoes(data)).data[0] - expected).max() < 1e-12


def test_window_and_inverse_do_not_wrap_round() -> None:
    """An echo at one end of a record leaves the other end as it is in a record three times as long."""
    for options in ({"window": "hann"}, {"inverse": 1e-3}):
        long = compress(echoes([echo(RECT, 0.0, n=1800)], RECT), **options).data[0]
        short = compress(echoes([echo(RECT, 0.0, n=600)], RECT), **options).data[0]
        assert np.abs(short[500:] - long[500:600]).max() < 1e-4
        assert np.abs(short[500:]).max() < 0.02


def test_keeps_everything_but_the_samples() -> None:
    t0 = np.array([1e-3, 2e-3])
    data = np.stack([echo(TUKEY, 5e-3, t0=start) for start in t0]).astype(np.complex64)
    raw = echoes(data, t0=t0, c=1480.0, bandwidth=23e3, attrs={"title": "two pings"})
    done = compress(raw, window="hann")
    assert done.compressed
    assert done.data.shape == raw.data.shape
    assert done.dtype == np.complex64
    assert np.array_equal(done.t0, raw.t0)
    assert (done.fs, done.fc, done.c, done.bandwidth, done.attrs) == (FS, FC, 1480.0, 23e3, {"title": "two pings"})
    assert done.pulse is TUKEY
    peaks = t0 + np.argmax(np.abs(done.data), axis=1) / FS
    assert np.allclose(peaks, 5e-3, atol=1e-9)


SIDE_LOBES = [(None, -13.3, 0.3), ("hann", -31.5, 1.0), ("hamming", -42.7, 2.0), (("taylor", 4, 30), -30.0, 1.0)]


@pytest.mark.parametrize(("window", "level", "allowed"), SIDE_LOBES)
def test_window_sets_the_side_lobes(window: Any, level: float, allowed: float) -> None:
    """Textbook side-lobe levels (F. J. Harris 1978, Table 1); an LFM of time-bandwidth product 4000 is nearly flat."""
    fs, pulse = 160e3, LFM(FC, 20e3, 0.2)
    n = 36000
    t = np.arange(n) / fs
    raw = echoes([pulse.waveform(t - 0.01, FC)], pulse, fs=fs)
    done = np.abs(compress(raw, window=window).data[0])
    peak = int(np.argmax(done))
    assert peak == 1600
    near = done[peak : peak + 400]
    null = int(np.argmax(np.diff(near) > 0))
    assert 20 * np.log10(near[null:].max() / done[peak]) == pytest.approx(level, abs=allowed)


def test_window_is_spread_over_the_occupied_band() -> None:
    """Compressed spectrum = plain spectrum x cos^2 window about the pulse's centre frequency, 0 outside its band."""
    fc, n = 102e3, 1500
    raw = echoes([echo(RECT, 500 / FS, fc=fc, n=n)], RECT, fc=fc)
    f = np.fft.fftfreq(n, 1 / FS)
    plain, windowed = (np.fft.fft(compress(raw, window=w).data[0]) for w in (None, "hann"))
    u = (f + 2e3) / 20e3
    inside = np.abs(u) < 0.45
    ratio = np.abs(windowed[inside] / plain[inside])
    assert np.allclose(ratio / ratio.max(), np.cos(np.pi * u[inside]) ** 2, atol=0.01)
    assert np.abs(windowed[np.abs(u) > 0.55]).max() < 1e-3 * np.abs(windowed).max()


def test_inverse_flattens_the_spectrum() -> None:
    """Wiener: an isolated echo's spectrum becomes g |P|^2/(|P|^2 + inverse max|P|^2), g making its mean 1 / n."""
    pulse, n, inverse = LFM(FC, 12e3, 2e-3, "gaussian", 3e-4), 2400, 1e-3
    raw = echoes([echo(pulse, 1200 / FS, n=n)], pulse)
    f = np.fft.fftfreq(n, 1 / FS)
    power = np.abs(pulse.spectrum(f)) ** 2
    expected = power / (power + inverse * power.max())
    expected *= n / expected.sum()
    found = np.abs(np.fft.fft(compress(raw, inverse=inverse).data[0]))
    assert np.abs(found - expected).max() < 1e-3 * expected.max()
    band = power > 0.1 * power.max()
    plain = np.abs(np.fft.fft(compress(raw).data[0]))
    assert np.ptp(found[band]) / found[band].mean() < 0.02
    assert np.ptp(plain[band]) / plain[band].mean() > 1


@settings(max_examples=20, deadline=None)
@given(a=st.complex_numbers(max_magnitude=10), b=st.complex_numbers(max_magnitude=10), seed=st.integers(0, 99))
def test_linearity(a: complex, b: complex, seed: int) -> None:
    x, y = noise((2, 1, 200), seed, np.complex128)
    parts = a * compress(echoes(x)).data + b * compress(echoes(y)).data
    scale = (abs(a) + abs(b)) * 10 + 1
    assert np.abs(compress(echoes(a * x + b * y)).data - parts).max() < 100 * np.finfo(float).eps * scale


@settings(max_examples=20, deadline=None)
@given(shift=st.integers(1, 100), seed=st.integers(0, 99), window=st.sampled_from([None, "hann"]))
def test_shift(shift: int, seed: int, window: str | None) -> None:
    """Delaying the record by whole samples delays the result."""
    data = np.zeros((2, 400), dtype=np.complex128)
    data[0, 100:200] = noise((100,), seed, np.complex128)
    data[1] = np.roll(data[0], shift)
    first, second = compress(echoes(data), window=window).data
    assert np.abs(first[: 400 - shift] - second[shift:]).max() < 1e-12


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_same_bits_for_any_threads_and_batches(dtype: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = echoes(noise((7, 3, 150), dtype=dtype))
    expected = compress(raw, window="hann", threads=1).data
    for threads in (2, 3, 7):
        assert np.array_equal(compress(raw, window="hann", threads=threads).data, expected)
    for size in (1, 40_000, 90_000):
        monkeypatch.setattr(blocks, "BYTES", size)
        assert np.array_equal(compress(raw, window="hann", threads=2).data, expected)


def test_progress_ends_at_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 1)
    seen: list[float] = []
    compress(echoes(noise((3, 2, 100))), progress=seen.append)
    assert len(seen) == 6
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_interrupt_between_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 1)

    def stop(_: float) -> None:
        raise KeyboardInterrupt

    raw = echoes(noise((3, 2, 100)))
    with pytest.raises(KeyboardInterrupt):
        compress(raw, progress=stop)
    assert compress(raw).compressed


@pytest.mark.parametrize(("dtype", "power"), [(np.complex64, 125), (np.complex64, -120), (np.complex128, 1000)])
def test_scale_invariant(dtype: Any, power: int) -> None:
    data = noise((2, 300), dtype=dtype)
    expected = compress(echoes(data)).data
    scale = np.ldexp(data.real.dtype.type(1), power)
    found = compress(echoes(data * scale)).data
    assert np.abs(found / scale - expected).max() < 1e-6 * np.abs(expected).max()


def test_zeros_stay_zero() -> None:
    assert not compress(echoes(np.zeros((2, 200), np.complex64))).data.any()


@pytest.mark.parametrize("order", [">c8", ">c16"])
def test_any_layout(order: str) -> None:
    plain = noise((4, 3, 160), dtype=np.dtype(order).newbyteorder("="))
    expected = compress(echoes(plain)).data
    swapped = plain.astype(order)
    strided = np.zeros((8, 3, 320), plain.dtype)[::2, :, ::-2]
    strided[:] = plain
    frozen = plain.copy()
    frozen.flags.writeable = False
    for data in (swapped, strided, frozen, np.asfortranarray(plain)):
        done = compress(echoes(data))
        assert np.array_equal(done.data, expected)
        assert done.data.dtype.isnative


def test_input_is_not_changed() -> None:
    data = noise((2, 200))
    copy = data.copy()
    compress(echoes(data), window="hann")
    assert np.array_equal(data, copy)


# Pulses as they were measured, and one a ping

GAUSSIAN = LFM(FC, 12e3, 2e-3, "gaussian", 1.4e-4)  # exp(-7.1^2/2), 8e-12 of it, is left at its ends, where samples may end
DOWN = LFM(FC, -12e3, 2e-3, "gaussian", 1.4e-4)


def measured(pulse: LFM, start: float, count: int = 110) -> Any:
    """Samples of a pulse at rate FS from time `start` on."""
    return pulse.waveform(start + np.arange(count) / FS)


def closed_form(pulse: LFM, delay: float, n: int = N) -> Any:
    u = np.arange(n) / FS - delay
    return pulse.response(u) * np.exp(-2j * np.pi * FC * delay)


@pytest.mark.parametrize(("lead", "allowed"), [(0.0, 1e-10), (-7.0, 1e-10), (-7.31, 1e-10), (4.5, 1e-8), (12.0, 1e-5)])
def test_a_measured_pulse_begins_when_it_does(lead: float, allowed: float) -> None:
    """Pailhas et al., Eq 18, to what is cut off: exp(-6.3^2/2) at 4.5 samples after the leading edge, exp(-5^2/2) at 12."""
    delay = (244 + 0.37) / FS
    raw = echoes([echo(GAUSSIAN, delay)], None)
    found = compress(raw, pulse=measured(GAUSSIAN, lead / FS), pulse_t0=lead / FS).data[0]
    assert np.abs(found - closed_form(GAUSSIAN, delay)).max() < allowed
    assert compress(raw, pulse=measured(GAUSSIAN, lead / FS), pulse_t0=lead / FS, window="hann").compressed


def test_a_pulse_a_ping() -> None:
    """Up- and down-sweeps in turn, as formulas or as measured, each with its own start."""
    delays = (200 + np.array([0.0, 10.3, 20.6, 30.9, 41.2])) / FS
    sweeps = [GAUSSIAN, DOWN, GAUSSIAN, DOWN, DOWN]
    raw = echoes([echo(pulse, delay) for pulse, delay in zip(sweeps, delays, strict=True)], None)
    expected = np.array([closed_form(pulse, delay) for pulse, delay in zip(sweeps, delays, strict=True)])
    starts = np.array([0.0, -3.0, -2.5, -1.0, -0.25]) / FS
    samples = [measured(pulse, start) for pulse, start in zip(sweeps, starts, strict=True)]
    up, down = measured(GAUSSIAN, 0.0), measured(DOWN, 0.0, 100)
    for pulse, start in ((sweeps, 0.0), (samples, starts), (np.array(samples), starts), ([up, down, up, down, down], 0.0)):
        found = compress(raw, pulse=pulse, pulse_t0=start)
        assert np.abs(found.data - expected).max() < 1e-10
        assert found.pulse is None
    mixed = [GAUSSIAN, samples[1], samples[2], DOWN, down]
    assert np.abs(compress(raw, pulse=mixed, pulse_t0=starts * [0, 1, 1, 0, 0]).data - expected).max() < 1e-10
    assert np.abs(compress(raw, pulse=GAUSSIAN).data[1] - expected[1]).max() > 0.3  # the other sweep shows


def test_pulses_given_come_before_the_echoes_own() -> None:
    raw = echoes([echo(GAUSSIAN, 0.005)], TUKEY)
    assert np.abs(compress(raw, pulse=GAUSSIAN).data[0] - closed_form(GAUSSIAN, 0.005)).max() < 1e-10


def test_same_bits_for_any_blocks_of_many_pulses(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = echoes(noise((150, 2, 130)), None)
    pulses = list(noise((75, 40), 3)) * 2
    expected = compress(raw, pulse=pulses, threads=1).data
    for ping in (0, 74, 75, 149):
        alone = echoes(raw.data[ping : ping + 1], None)
        assert np.abs(compress(alone, pulse=pulses[ping]).data - expected[ping]).max() < 1e-6
    for size in (1, 40_000):
        monkeypatch.setattr(blocks, "BYTES", size)
        assert np.array_equal(compress(raw, pulse=pulses, threads=2).data, expected)


# Samples that are none, and results in memory of the caller's


@pytest.mark.parametrize("value", [np.nan, np.inf, complex(1, -np.inf)])
def test_masked_samples_count_as_zero_and_stay(value: complex, monkeypatch: pytest.MonkeyPatch) -> None:
    data = noise((4, 3, 200))
    bad = np.zeros(data.shape, bool)
    bad[1, 0, :30] = bad[1, 2, 150:] = bad[2, 1, 99] = bad[3] = True
    zeros = np.where(bad, 0, data)
    expected = compress(echoes(zeros)).data
    for size in (blocks.BYTES, 1):
        monkeypatch.setattr(blocks, "BYTES", size)
        found = compress(echoes(np.where(bad, value, data)), nan="mask").data
        assert np.array_equal(np.isfinite(found), ~bad)
        assert np.array_equal(found[~bad], expected[~bad])


def test_result_in_memory_of_the_caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 40_000)
    data = noise((20, 2, 200))
    expected = compress(echoes(data)).data
    data.tofile(tmp_path / "raw")
    raw = echoes(np.memmap(tmp_path / "raw", np.complex64, "r", shape=data.shape))
    out = np.memmap(tmp_path / "out", np.complex64, "w+", shape=data.shape)
    found = compress(raw, out=out)
    assert np.shares_memory(found.data, out) and np.array_equal(out, expected)
    out.flush()
    assert np.array_equal(np.fromfile(tmp_path / "out", np.complex64).reshape(data.shape), expected)
    flat = np.empty((20, 200), np.complex64)
    assert np.array_equal(compress(echoes(data[:, 0]), out=flat).data, expected[:, 0]) and np.array_equal(flat, expected[:, 0])


def _with_bad(shape: tuple[int, ...], where: tuple[int, ...], value: complex) -> Any:
    data = noise(shape)
    data[where] = value
    return data


OUT = noise((2, 200))
BAD: list[tuple[str, Any, dict[str, Any], type[Exception], str]] = [
    ("array", noise((2, 200)), {}, TypeError, "raw=ndarray: expected pysas.Echoes"),
    ("compressed", echoes(noise((2, 200)), compressed=True), {}, ValueError, "range-compressed already"),
    ("no pulse", echoes(noise((2, 200)), pulse=None), {}, ValueError, "pulse=None"),
    ("long pulse", echoes(noise((2, 60))), {}, ValueError, r"pulse of 79 samples .* record of 60 samples"),
    ("silent", echoes(noise((2, 60)), np.zeros(5, complex)), {}, ValueError, "at least one non-zero sample"),
    ("nan", echoes(_with_bad((3, 2, 200), (2, 1, 7), np.nan)), {}, ValueError, "ping 2, channel 1, sample 7"),
    ("inf", echoes(_with_bad((3, 200), (1, 9), 1j * np.inf)), {}, ValueError, "ping 1, channel 0, sample 9"),
    ("window name", echoes(noise((2, 200))), {"window": "square"}, ValueError, "window='square'"),
    ("window type", echoes(noise((2, 200))), {"window": 3.0}, TypeError, "window=3.0"),
    ("window nan", echoes(noise((2, 200))), {"window": ("kaiser", np.nan)}, ValueError, "window="),
    ("inverse 0", echoes(noise((2, 200))), {"inverse": 0.0}, ValueError, "inverse=0.0"),
    ("inverse nan", echoes(noise((2, 200))), {"inverse": np.nan}, ValueError, "inverse=nan"),
    ("inverse bool", echoes(noise((2, 200))), {"inverse": True}, TypeError, "inverse=True"),
    ("threads 0", echoes(noise((2, 200))), {"threads": 0}, ValueError, "threads=0"),
    ("threads float", echoes(noise((2, 200))), {"threads": 1.5}, TypeError, "threads=1.5"),
    ("progress", echoes(noise((2, 200))), {"progress": 1}, TypeError, "progress=1"),
    ("nan word", echoes(noise((2, 200))), {"nan": "zero"}, ValueError, "nan='zero'"),
    ("out shape", echoes(OUT), {"out": np.empty((2, 199), "c8")}, ValueError, r"out: expected the data's shape \(2, 200\)"),
    ("out dtype", echoes(OUT), {"out": np.empty((2, 200), "c16")}, TypeError, "out: expected an array of complex64"),
    ("out overlaps", echoes(OUT), {"out": OUT}, ValueError, "out: shares memory with raw"),
    ("pulse type", echoes(noise((2, 200))), {"pulse": 3.0}, TypeError, "pulse=float"),
    ("pulse real", echoes(noise((2, 200))), {"pulse": np.ones(9)}, TypeError, "pulse: expected complex64 or complex128"),
    ("pulse nan", echoes(noise((2, 200))), {"pulse": np.full(9, np.nan + 0j)}, ValueError, "pulse: expected finite samples"),
    ("pulse count", echoes(noise((2, 200))), {"pulse": [TUKEY] * 3}, ValueError, "one a ping, 2, found 3"),
    ("pulse of one", echoes(noise((2, 200))), {"pulse": [TUKEY, 1]}, TypeError, r"pulse\[1\]: expected complex64"),
    ("pulse long", echoes(noise((2, 200))), {"pulse": [TUKEY, noise((201,))]}, ValueError, "of ping 1: expected no longer"),
    ("start of LFM", echoes(noise((2, 200))), {"pulse_t0": 1e-3}, ValueError, "pulse_t0: 0.001 s at ping 0: expected 0 with"),
    ("start count", echoes(noise((2, 200))), {"pulse_t0": [0.0]}, ValueError, r"pulse_t0: expected shape \(2,\)"),
    ("start far", echoes(noise((2, 200))), {"pulse": noise((9,)), "pulse_t0": 1.7e9}, ValueError, "pulse_t0: 1.7e"),
    ("start nan", echoes(noise((2, 200))), {"pulse": noise((9,)), "pulse_t0": np.nan}, ValueError, "pulse_t0=nan"),
]


@pytest.mark.parametrize(("raw", "options", "error", "text"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_errors(raw: Any, options: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        compress(raw, **options)


def test_non_finite_sample_in_a_later_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 1)
    with pytest.raises(ValueError, match="ping 2, channel 1, sample 7"):
        compress(echoes(_with_bad((3, 2, 200), (2, 1, 7), np.nan)))
