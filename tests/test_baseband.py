"""Demodulation against sums of sinusoids, which are known at any instant, and an independent recorder's files.

A tone of frequency f and complex amplitude a, Re(a exp(2j pi f t)) on the ADC, is a exp(2j pi (f - fc) t) in base-band: t is
the time after transmission began, so that the first sample's time decides the phase. Nothing here shares code with pysas.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from scipy.interpolate import CubicSpline
from scipy.io import wavfile

import pysas
from pysas.signal import blocks
from pysas.signal.baseband import demodulate

pytestmark = pytest.mark.reference  # no engine takes part

FS, FC, BAND, T0 = 500e3, 100e3, 30e3, 0.031
N = 12_000


def tones(seed: int = 1, low: float = FC - BAND / 2, high: float = FC + BAND / 2, count: int = 60) -> tuple[Any, Any]:
    """Frequencies, those of the band's ends among them, and complex amplitudes."""
    rng = np.random.default_rng(seed)
    f = np.concatenate([[low, high], rng.uniform(low, high, count - 2)])
    return f, rng.standard_normal(count) + 1j * rng.standard_normal(count)


def analytic(f: Any, a: Any, t: Any, carrier: float = 0.0) -> Any:
    """The sum a exp(2j pi (f - carrier) t) at times `t`."""
    return np.exp(2j * np.pi * np.multiply.outer(t, f - carrier)) @ a


def inside(n: int, count: int, rate: float, *, fs: float = FS, band: float = BAND, room: float = FC) -> slice:
    """Samples that the record's ends do not reach, as documented."""
    end = 5 / (min(rate / 2.2, room) - band / 2)
    return slice(int(np.ceil(end * rate)), min(count, int(((n - 1) / fs - end) * rate)))


def error(found: Any, expected: Any, part: slice) -> float:
    return float(np.linalg.norm(found[..., part] - expected[..., part]) / np.linalg.norm(expected[..., part]))


RATES = [None, 36e3, 44.1e3, 50e3, 62.5e3, 125e3, FS, 1e6]


@pytest.mark.parametrize("rate", RATES)
def test_pass_band(rate: float | None) -> None:
    f, a = tones()
    samples = analytic(f, a, T0 + np.arange(N) / FS).real
    found, got = demodulate(samples, FS, FC, BAND, rate, T0)
    assert got == (rate or FS / 11)
    assert found.shape == (int(np.ceil(N * got / FS - 1e-9)),) and found.dtype == np.complex128
    part = inside(N, found.size, got)
    assert part.stop - part.start > found.size / 3
    assert error(found, analytic(f, a, T0 + np.arange(found.size) / got, FC), part) < 1e-7


@pytest.mark.parametrize("carrier", [0.0, 90e3, FC, 103.3e3])
@pytest.mark.parametrize("rate", [None, 36e3, 60e3])
def test_another_carrier(carrier: float, rate: float | None) -> None:
    fs = FS if carrier == 0 else 60e3
    f, a = tones()
    n = 9000 if carrier == 0 else 1500
    samples = analytic(f, a, T0 + np.arange(n) / fs, carrier)
    found, got = demodulate(samples, fs, FC, BAND, rate, T0, carrier=carrier)
    assert got >= 1.4 * BAND if rate is None else got == rate
    part = inside(n, found.size, got, fs=fs, room=fs / 2 - abs(FC - carrier))
    assert part.stop - part.start > found.size / 4
    assert error(found, analytic(f, a, T0 + np.arange(found.size) / got, FC), part) < 1e-7


@pytest.mark.parametrize("fs", [260e3, 222.2e3, 2.5e6])
def test_carriers_near_the_nyquist_rate_and_far_below(fs: float) -> None:
    """The images of a sampled signal stay out where fs/2 is near the band's upper end, 115 kHz against 111.1 and 130."""
    band = 20e3
    f, a = tones(low=FC - band / 2, high=FC + band / 2)
    n = int(12e-3 * fs)
    found, rate = demodulate(analytic(f, a, T0 + np.arange(n) / fs).real, fs, FC, band, t0=T0)
    part = inside(n, found.size, rate, fs=fs, band=band, room=min(FC, fs / 2 - FC))
    assert part.stop - part.start > 80
    assert error(found, analytic(f, a, T0 + np.arange(found.size) / rate, FC), part) < 1e-7


def test_what_lies_outside_is_gone() -> None:
    """Tones from rate/2.2 on, to 0 Hz and to the Nyquist rate: below 1e-7 of their amplitude."""
    t = np.arange(N) / FS
    for rate in (36e3, 50e3):
        for f in np.concatenate([np.linspace(2e3, FC - rate / 2.2, 15), np.linspace(FC + rate / 2.2, 248e3, 15)]):
            found, _ = demodulate(np.cos(2 * np.pi * f * t), FS, FC, BAND, rate)
            middle = found.size // 2
            assert np.abs(found[middle - 20 : middle + 20]).max() < 1e-7


def test_a_point_is_as_echoes_want_it() -> None:
    """p(t - tau) exp(-2j pi fc tau) of a pulse that begins at tau, Gaussian with 2e-5 of it left at 15 kHz from its centre."""
    pulse, tau = pysas.LFM(FC, 8e3, 2e-3, "gaussian", 3e-4), 0.0337123
    t = T0 + np.arange(5000) / FS
    phase = 2 * np.pi * (FC * (t - tau) + pulse.rate / 2 * (t - tau - pulse.duration / 2) ** 2)
    found, rate = demodulate(pulse.envelope(t - tau) * np.cos(phase), FS, FC, BAND, t0=T0)
    there = T0 + np.arange(found.size) / rate
    expected = pulse.waveform(there - tau) * np.exp(-2j * np.pi * FC * tau)
    assert error(found, expected, slice(None)) < 1e-6


def test_int16_to_its_rounding() -> None:
    """What comes out is wrong by what rounding put into the band: white noise of 1/12, of which BAND/FS passes."""
    f, a = tones()
    n = 40_000
    exact = 500 * analytic(f, a, T0 + np.arange(n) / FS).real
    samples = np.rint(exact).astype(np.int16)
    assert np.abs(exact).max() < 32767
    found, rate = demodulate(samples, FS, FC, BAND, 36e3, T0)
    assert found.dtype == np.complex64
    part = inside(n, found.size, rate)
    wrong = (found - 500 * analytic(f, a, T0 + np.arange(found.size) / rate, FC))[part]
    # the filter's flanks, from 15 to 16.4 kHz, let some more through; 4 is the square of the factor 2 of an analytic signal
    allowed = 4 / 12 * np.array([BAND, 2 / 2.2 * 36e3]) / FS
    assert 0.9 * allowed[0] < np.mean(np.abs(wrong) ** 2) < 1.1 * allowed[1]


@pytest.mark.parametrize(
    ("kind", "result"),
    [("i1", "c8"), ("<i2", "c8"), (">i2", "c8"), ("u2", "c8"), ("<i4", "c16"), (">i4", "c16"), ("i8", "c16"), ("f2", "c8"),
     (">f4", "c8"), ("f8", "c16"), (">f8", "c16")],
)  # fmt: skip
def test_kinds_and_layouts(kind: str, result: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    plain = rng.integers(0, 100, (3, 2, 1000)).astype(kind)
    expected, rate = demodulate(plain.astype(np.float64), FS, FC, BAND, t0=T0)
    strided = np.zeros((6, 2, 2000), kind)[::2, :, ::-2]
    strided[:] = plain
    plain.tofile(tmp_path / "adc")
    mapped = np.memmap(tmp_path / "adc", kind, "r", shape=plain.shape)
    copy = plain.copy()
    for samples in (plain, strided, np.asfortranarray(plain), mapped):
        found, got = demodulate(samples, FS, FC, BAND, t0=T0)
        assert got == rate and found.dtype == np.dtype(result) and found.shape == expected.shape
        assert error(found, expected, slice(None)) < (1e-6 if result == "c8" else 1e-14)
    assert np.array_equal(plain, copy)
    assert np.array_equal(demodulate(plain[1, 1], FS, FC, BAND, t0=T0)[0], demodulate(plain, FS, FC, BAND, t0=T0)[0][1, 1])
    assert np.array_equal(demodulate(plain[:, 1], FS, FC, BAND, t0=T0)[0], demodulate(plain, FS, FC, BAND, t0=T0)[0][:, 1])


def test_pairs_of_i_and_q() -> None:
    rng = np.random.default_rng(3)
    pairs = rng.integers(-30000, 30000, (4, 3, 900, 2)).astype(np.int16)
    samples = pairs[..., 0] + 1j * pairs[..., 1].astype(np.float64)
    found, rate = demodulate(pairs, 60e3, FC, BAND, t0=T0, carrier=95e3, iq=True)
    expected, same = demodulate(samples, 60e3, FC, BAND, t0=T0, carrier=95e3)
    assert rate == same and found.dtype == np.complex64
    assert error(found, expected, slice(None)) < 1e-6
    for kind in ("<f4", ">f8"):
        assert (
            error(demodulate(pairs.astype(kind), 60e3, FC, BAND, t0=T0, carrier=95e3, iq=True)[0], expected, slice(None)) < 1e-6
        )
    single, _ = demodulate(samples.astype(">c8"), 60e3, FC, BAND, t0=T0, carrier=95e3)
    assert single.dtype == np.complex64 and error(single, expected, slice(None)) < 1e-6


def test_start_a_ping() -> None:
    rng = np.random.default_rng(4)
    samples, starts = rng.standard_normal((3, 2, 1000)), np.array([0.01, 0.0213, 3.7])
    found, _ = demodulate(samples, FS, FC, BAND, t0=starts)
    for ping, start in enumerate(starts):
        expected, _ = demodulate(samples[ping], FS, FC, BAND, t0=start)
        assert np.array_equal(found[ping], expected)
        plain, _ = demodulate(samples[ping], FS, FC, BAND)
        assert np.abs(expected - plain * np.exp(-2j * np.pi * FC * start)).max() < 1e-9


def test_same_bits_for_any_threads_and_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = np.random.default_rng(5).integers(-999, 999, (7, 3, 800)).astype(np.int16)
    expected, _ = demodulate(samples, FS, FC, BAND, threads=1)
    for size in (1, 50_000, 120_000):
        monkeypatch.setattr(blocks, "BYTES", size)
        assert np.array_equal(demodulate(samples, FS, FC, BAND, threads=2)[0], expected)


@pytest.mark.parametrize(("kind", "power"), [("f4", 120), ("f4", -140), ("f8", 1000), ("f8", -1060)])
def test_any_scale(kind: str, power: int) -> None:
    samples = np.round(np.random.default_rng(6).uniform(-64, 64, (2, 900))).astype(kind)
    expected, _ = demodulate(samples, FS, FC, BAND)
    found, _ = demodulate(np.ldexp(samples, power), FS, FC, BAND)
    back = np.ldexp(found.real, -power) + 1j * np.ldexp(found.imag, -power)
    # near the smallest numbers a result is rounded to them
    assert np.abs(back - expected).max() < max(1e-6, 2.0 * 2.0 ** (-149 - power if kind == "f4" else -1074 - power))


@pytest.mark.parametrize("mode", ["w+", "r+"])
def test_mapped_files_in_and_out(mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 60_000)
    samples = np.random.default_rng(7).integers(-999, 999, (20, 2, 800)).astype(np.int16)
    samples.tofile(tmp_path / "adc")
    np.zeros((20, 2, 80), np.complex64).tofile(tmp_path / "base")
    mapped = np.memmap(tmp_path / "adc", np.int16, "r", shape=samples.shape)
    out = np.memmap(tmp_path / "base", np.complex64, mode, shape=(20, 2, 80))
    found, rate = demodulate(mapped, FS, FC, BAND, 50e3, out=out)
    expected, _ = demodulate(samples, FS, FC, BAND, 50e3)
    assert found is out and rate == 50e3
    assert np.array_equal(out, expected)
    out.flush()
    assert np.array_equal(np.fromfile(tmp_path / "base", np.complex64).reshape(out.shape), expected)


def test_private_copies_of_mapped_files_stay(tmp_path: Path) -> None:
    """A copy-on-write map has no file that its changes could be read from again."""
    np.zeros((4, 1000), np.int16).tofile(tmp_path / "adc")
    mapped = np.memmap(tmp_path / "adc", np.int16, "c", shape=(4, 1000))
    mapped[:] = np.random.default_rng(8).integers(-999, 999, mapped.shape)
    copy = np.array(mapped)
    found, _ = demodulate(mapped, FS, FC, BAND)
    assert np.array_equal(mapped, copy) and np.abs(found).max() > 0


def test_out_decides_the_precision() -> None:
    samples = np.random.default_rng(9).integers(-(2**23), 2**23, 1000).astype(np.int32)
    expected, _ = demodulate(samples, FS, FC, BAND, 50e3)
    single = np.empty(100, np.complex64)
    demodulate(samples, FS, FC, BAND, 50e3, out=single)
    assert np.array_equal(single, expected.astype(np.complex64))


WAVE = np.cos(np.arange(1000.0))
BAD: list[tuple[dict[str, Any], type[Exception], str]] = [
    (
        {"fc": 260e3},
        ValueError,
        r"fc=260000 Hz: expected a frequency in 0 to 250000 Hz, what real samples at fs 500000 Hz hold",
    ),
    ({"fc": 240e3}, ValueError, r"bandwidth=30000 Hz: 225000 to 255000 Hz are kept.* expected them in 0 to 250000 Hz"),
    ({"fc": 14e3}, ValueError, r"-1000 to 29000 Hz are kept"),
    ({"fc": 15.5e3}, ValueError, r"flanks reach 16363.6 Hz from fc"),
    ({"fc": -1.0}, ValueError, "fc=-1.0"),
    ({"rate": 35e3}, ValueError, r"rate=35000 Hz: expected at least 1.2 x the band of 30000 Hz, 36000 Hz"),
    ({"rate": 50e3 * np.pi}, ValueError, r"rate=157079.63.* Hz: expected a ratio of whole numbers to fs 500000 Hz, such as"),
    ({"rate": 1e12}, ValueError, "expected a ratio of whole numbers"),
    ({"rate": np.nan}, ValueError, "rate=nan"),
    ({"bandwidth": None}, TypeError, "bandwidth=None, rate=None"),
    ({"bandwidth": 400.0}, ValueError, r"bandwidth=400 Hz: expected more than a record of 1000 samples resolves, 500 Hz"),
    ({"bandwidth": 5e-324}, ValueError, "expected more than a record of 1000 samples resolves"),
    ({"bandwidth": None, "rate": 3e5}, ValueError, "bandwidth=214286 Hz: -7142.86 to 207143 Hz are kept"),
    ({"bandwidth": 0.0}, ValueError, "bandwidth=0.0"),
    ({"fs": 0.0}, ValueError, "fs=0.0"),
    ({"samples": WAVE + 0j}, TypeError, "carrier=None: expected that of the complex samples"),
    ({"carrier": 90e3}, TypeError, r"carrier=90000.0: expected None for real samples"),
    ({"samples": WAVE + 0j, "carrier": 400e3}, ValueError, r"fc=100000 Hz: expected a frequency in 150000 to 650000 Hz"),
    ({"samples": WAVE + 0j, "carrier": 90e3, "fs": 40e3}, ValueError, r"expected them in 70000 to 110000 Hz, what complex"),
    ({"samples": WAVE[:, None], "iq": True, "carrier": 0.0}, ValueError, r"a last axis of 2, I and Q, found shape \(1000, 1\)"),
    ({"samples": WAVE.reshape(-1, 2) + 0j, "iq": True, "carrier": 0.0}, TypeError, "expected real samples"),
    ({"iq": 1}, TypeError, "iq=1"),
    ({"samples": WAVE > 0}, TypeError, "found dtype bool"),
    ({"samples": WAVE.astype(np.longdouble)}, TypeError, "up to 64 bits"),
    ({"samples": np.float64(1.0)}, ValueError, r"found shape \(\)"),
    ({"samples": np.empty((0, 10))}, ValueError, r"found shape \(0, 10\)"),
    ({"samples": np.ones((2, 2, 2, 100))}, ValueError, r"found shape \(2, 2, 2, 100\)"),
    ({"samples": np.ma.masked_array(WAVE, WAVE > 0.9)}, TypeError, "samples: masked entries"),
    ({"t0": [0.1]}, ValueError, "t0: expected one number"),
    ({"samples": WAVE.reshape(2, 500), "t0": [0.1] * 3}, ValueError, r"t0: expected shape \(2,\)"),
    ({"samples": WAVE.reshape(2, 500), "t0": [0.1, np.nan]}, ValueError, "t0: nan at ping 1"),
    ({"t0": np.inf}, ValueError, "t0=inf"),
    ({"out": np.empty(91, np.complex64)}, ValueError, r"out: expected the result's shape \(100,\), found \(91,\)"),
    ({"out": np.empty(100)}, TypeError, "out: expected an array of complex64 or complex128, found float64"),
    ({"out": WAVE[:200].view(np.complex128)}, ValueError, "out: shares memory with samples"),
    ({"threads": 0}, ValueError, "threads=0"),
]


@pytest.mark.parametrize(("options", "kind", "text"), BAD)
def test_errors(options: dict[str, Any], kind: type[Exception], text: str) -> None:
    usual = {"samples": WAVE, "fs": FS, "fc": FC, "bandwidth": BAND}
    if "out" in options:
        usual["rate"] = 50e3
    with pytest.raises(kind, match=text):
        demodulate(**(usual | options))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_samples_are_named(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BYTES", 1)
    samples = np.ones((3, 2, 900), np.float32)
    samples[2, 1, 7] = value
    with pytest.raises(ValueError, match=f"samples: {value} at ping 2, channel 1, sample 7: expected finite"):
        demodulate(samples, FS, FC, BAND)
    pairs = np.ones((3, 2, 900, 2), np.float32)
    pairs[1, 0, 9, 1] = value
    with pytest.raises(ValueError, match=f"samples: {value} at ping 1, channel 0, sample 9: expected finite"):
        demodulate(pairs, FS, FC, BAND, carrier=FC, iq=True)


# An independent recorder's files (see the data's own README): int16 pass-band, measured pulse, navigation, lever arms, targets


class Recorder:
    """Travel times from the files: WGS84 to a local north-east-down frame, poses by cubic splines, the receiver where it is
    when the echo arrives."""

    def __init__(self, folder: Path) -> None:
        nav = np.loadtxt(folder / "nav.csv", delimiter=",", skiprows=1)
        self.origin, self.epoch = nav[0, 1:3], nav[0, 0]
        self.position = CubicSpline(nav[:, 0] - self.epoch, self.local(nav[:, 1:4]))
        self.attitude = CubicSpline(nav[:, 0] - self.epoch, np.radians(nav[:, 4:7]))
        self.pings = np.loadtxt(folder / "pings.csv", skiprows=1) - self.epoch
        self.levers = np.loadtxt(folder / "levers.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3))
        self.targets = self.local(np.loadtxt(folder / "targets.csv", delimiter=",", skiprows=1))
        settings = scipy.io.loadmat(folder / "survey.mat")
        self.c, self.t0 = float(settings["c"].item()), float(settings["t_delay"].item())
        self.samples = np.memmap(folder / "adc.bin", "<i2", "r").reshape(110, 16, 2600)
        self.fs, self.replica = wavfile.read(folder / "replica.wav")

    def local(self, place: Any) -> Any:
        """(latitude, longitude in deg, depth) to north, east, down in m about the first one of the track."""
        a, flattening = 6378137.0, 1 / 298.257223563
        square = flattening * (2 - flattening)

        def geocentric(lat: Any, lon: Any, height: Any) -> Any:
            across = a / np.sqrt(1 - square * np.sin(lat) ** 2)
            return np.stack(
                [(across + height) * np.cos(lat) * np.cos(lon), (across + height) * np.cos(lat) * np.sin(lon),
                 (across * (1 - square) + height) * np.sin(lat)], axis=-1,
            )  # fmt: skip

        lat, lon = np.radians(self.origin)
        s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
        axes = np.array([[-s * cl, -s * sl, c], [-sl, cl, 0], [-c * cl, -c * sl, -s]])
        offset = geocentric(*np.radians(place[:, :2]).T, -place[:, 2]) - geocentric(lat, lon, 0.0)
        return offset @ axes.T

    def element(self, t: float, lever: Any) -> Any:
        (cr, cp, ch), (sr, sp, sh) = np.cos(self.attitude(t)), np.sin(self.attitude(t))
        roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        heading = np.array([[ch, -sh, 0], [sh, ch, 0], [0, 0, 1]])
        return self.position(t) + heading @ pitch @ roll @ lever

    def travel_time(self, target: Any, ping: int, channel: int) -> float:
        t = self.pings[ping]
        away = float(np.linalg.norm(target - self.element(t, self.levers[0])))
        tau = 2 * away / self.c
        for _ in range(8):  # contracts by v/c, 1e-3
            tau = (away + float(np.linalg.norm(target - self.element(t + tau, self.levers[1 + channel])))) / self.c
        return tau


def test_recorder(data_dir: Path) -> None:
    """The strongest echoes of the nearest target lie where navigation puts them: to 0.02 samples, 0.3 mm of range, and 0.1 rad,
    which is 0.1 mm."""
    recorder = Recorder(data_dir / "recorder")
    fc, band, rate, lead = 100e3, 36e3, 50e3, 100
    data, _ = demodulate(recorder.samples, recorder.fs, fc, band, rate, recorder.t0)
    # zeros before the leading edge, so that what the filter puts there is kept
    pulse, _ = demodulate(np.pad(recorder.replica, lead), recorder.fs, fc, band, rate, -lead / recorder.fs)
    raw = pysas.Echoes(
        data, fs=rate, fc=fc, t0=recorder.t0, c=recorder.c, tx=np.zeros((110, 3)), rx=np.zeros((110, 16, 3)), compressed=False
    )
    echoes = pysas.compress(raw, pulse=pulse, pulse_t0=-lead / recorder.fs)
    target = min(recorder.targets, key=lambda place: min(recorder.travel_time(place, ping, 0) for ping in range(0, 110, 10)))
    found = []
    for ping in range(0, 110, 5):
        for channel in (0, 7, 15):
            tau = recorder.travel_time(target, ping, channel)
            place, trace = (tau - recorder.t0) * rate, echoes.data[ping, channel]
            near = place + np.arange(-3, 3, 0.005)
            level = np.abs(np.sinc(np.subtract.outer(near, np.arange(trace.size))) @ trace)
            at = np.sinc(place - np.arange(trace.size)) @ trace * np.exp(2j * np.pi * fc * tau)
            found.append((level.max(), near[level.argmax()] - place, np.angle(at)))
    amplitude, offset, phase = np.array(found).T
    strong = amplitude > 0.5 * amplitude.max()
    assert np.count_nonzero(strong) >= 6
    assert np.abs(offset[strong]).max() < 0.02
    assert np.abs(phase[strong]).max() < 0.1


@pytest.mark.slow
def test_a_recording_larger_than_memory_goes_through_below_1_gb(tmp_path: Path) -> None:
    """1e5 pings of 16 channels, 1.6 GB of int16 samples: the largest resident set, mapped pages included."""
    root = Path(__file__).parents[1]
    run = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.append({str(root)!r}); import bench.recording as r; r.main()",
         "--folder", str(tmp_path)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    (line,) = (line for line in run.stdout.splitlines() if line.startswith("peak memory"))
    assert float(line.split()[2]) < 1000
