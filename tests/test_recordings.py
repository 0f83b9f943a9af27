"""`pysas echoes`: a recording made here from formulas becomes an image with its target in place; what is wrong with files.

A vehicle sails north from the equator at 1 m/s, 5 m deep; one point echoes a sweep, pass-band, by A s(t - tau). One degree of
latitude there is pi/180 a (1 - e^2), of longitude pi/180 a (WGS84: a = 6378137 m, e^2 = 0.00669437999014).
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile

import pysas
from pysas import cli
from pysas.formats import recordings
from pysas.navigation import Frame

FS, FC, B, DURATION, C, T0, SPEED = 100e3, 20e3, 6e3, 4e-3, 1480.0, 12.013e-3, 1.0
PINGS, SAMPLES = 60, 1400
NORTH, EAST = np.pi / 180 * 6378137.0 * (1 - 0.00669437999014), np.pi / 180 * 6378137.0  # m a degree, at the equator
TARGET = np.array([1.9, 12.3, 9.0])  # north, east, down, m
TX, RX = np.array([0.1, 0.2, 0.3]), np.array([[-0.2, 0.2, 0.3], [0.05, 0.25, 0.35]])


def envelope(t: np.ndarray) -> np.ndarray:
    """Edges of a tenth of the pulse's length."""
    return np.asarray(np.sin(np.pi / 2 * np.clip(np.minimum(t, DURATION - t) / (0.1 * DURATION), 0, 1)) ** 2)


def sweep(t: np.ndarray) -> np.ndarray:
    """Real pass-band."""
    return np.asarray(envelope(t) * np.cos(2 * np.pi * ((FC - B / 2) * t + B / (2 * DURATION) * t**2)))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    ping = 100.0 + 0.1 * np.arange(PINGS)
    place = np.stack([SPEED * (ping - 103.0), np.zeros(PINGS), np.full(PINGS, 5.0)], axis=-1)
    out = np.linalg.norm(TARGET - place - TX, axis=-1)[:, None]
    tau = 2 * out / C
    for _ in range(8):  # receivers move on until they hear; each step gains a factor C/SPEED
        back = TARGET - place[:, None] - RX - SPEED * tau[..., None] * [1.0, 0.0, 0.0]
        tau = (out + np.linalg.norm(back, axis=-1)) / C
    t = T0 + np.arange(SAMPLES) / FS
    np.round(12_000 * sweep(t - tau[..., None])).astype("<i2").tofile(folder / "adc.bin")
    replica = np.round(20_000 * sweep(np.arange(round(DURATION * FS) + 1) / FS)).astype(np.int16)
    scipy.io.wavfile.write(folder / "replica.wav", int(FS), replica)
    scipy.io.savemat(
        folder / "survey.mat", {"fs": FS, "c": C, "t0": T0, "replica": replica, "two": np.ones((2, 2)), "word": "x"}
    )
    when = np.arange(99.5, 107.0, 0.1)
    rows = [f"{t:.3f},{SPEED * (t - 103.0) / NORTH:.13f},0,5,0,0,0" for t in when]
    (folder / "nav.csv").write_text("time,lat,lon,depth,roll,pitch,heading\n" + "\n".join(rows) + "\n")
    (folder / "pings.csv").write_text("time\n" + "".join(f"{t:.3f}\n" for t in ping))
    arms = [("rx0", RX[0]), ("tx", TX), ("rx1", RX[1])]
    (folder / "levers.csv").write_text("name,x,y,z\n" + "".join(f"{name},{a[0]},{a[1]},{a[2]}\n" for name, a in arms))
    return folder


OPTIONS: dict[str, Any] = {
    "samples": "adc.bin", "dtype": "<i2", "shape": f"{PINGS} 2 {SAMPLES}", "pulse": "replica.wav", "nav": "nav.csv",
    "pings": "pings.csv", "levers": "levers.csv", "fs": FS, "fc": FC, "bandwidth": 8e3, "t0": T0, "c": C, "pulse-centre": 0,
}  # fmt: skip


def run(output: Path | str, *more: str, **changes: Any) -> int:
    options = {name: value for name, value in (OPTIONS | changes).items() if value is not None}
    words = [word for name, value in options.items() for word in (f"--{name}", *shlex.split(str(value)))]
    return cli.main(["echoes", *words, "-o", str(output), *more])


def loaded(path: Path) -> pysas.Echoes:
    echoes = pysas.load(path)
    assert isinstance(echoes, pysas.Echoes)
    return echoes


def test_a_target_is_imaged_in_place(made: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """Within 0.03 mm of 74 mm of wavelength: samples in int16, places and delays by the formulas above."""
    monkeypatch.chdir(made)
    assert run(tmp_path / "line.h5") == 0
    assert "--z DEPTH" in capsys.readouterr().out
    echoes = loaded(tmp_path / "line.h5")
    assert echoes.compressed and echoes.data.shape[:2] == (PINGS, 2) and echoes.t0 == T0 and echoes.c == C
    lat, lon = TARGET[0] / NORTH, TARGET[1] / EAST
    target = Frame(**echoes.attrs["frame"]).from_geodetic(lat, lon, TARGET[2])
    x, y = (target[i] + np.arange(-0.2, 0.2, 0.005) for i in (0, 1))
    image = pysas.focus(echoes, pysas.Grid.plane(x, y, target[2]), tol=1e-4)
    found = pysas.metrics.peak_position(image, near=(target[0], target[1]), radius=0.1)
    np.testing.assert_allclose(found, target[:2], rtol=0, atol=3e-5)
    there = pysas.focus(echoes, pysas.Grid.points([target]), tol=1e-4).data[0]
    assert abs(np.angle(there)) < 0.01  # fc t0 is no whole number of turns
    assert np.abs(image.data).max() / (2 * PINGS) == pytest.approx(
        12_000 / 20_000, rel=1e-4
    )  # of the pulse as it is in its file


def test_numbers_and_the_pulse_come_from_a_matlab_file(made: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(made)
    assert run(tmp_path / "plain.npz") == 0
    names = {"fs": "survey.mat:fs", "c": "survey.mat:c", "t0": "survey.mat:t0", "pulse": "survey.mat:replica"}
    assert run(tmp_path / "mat.npz", "--json", **names) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    plain, mat = loaded(tmp_path / "plain.npz"), loaded(tmp_path / "mat.npz")
    assert summary["shape"] == list(plain.data.shape) and summary["fs"] == plain.fs
    assert (mat.fs, mat.c, mat.t0) == (plain.fs, plain.c, plain.t0)
    np.testing.assert_allclose(mat.data, plain.data, rtol=0, atol=1e-6 * np.abs(plain.data).max())


def test_a_pulse_s_centre_is_its_own_unless_said(made: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """sum t |f p|^2 / sum |f p|^2 by the sweep's own formula; the vehicle's way until then is between the places of both."""
    monkeypatch.chdir(made)
    assert run(tmp_path / "own.npz", **{"pulse-centre": None}) == 0 and run(tmp_path / "edge.npz") == 0
    own, edge = loaded(tmp_path / "own.npz"), loaded(tmp_path / "edge.npz")
    t = np.linspace(0, DURATION, 10_001)
    weight = (envelope(t) * (FC - B / 2 + B / DURATION * t)) ** 2
    centre = float(t @ weight / weight.sum())
    assert own.attrs["pulse_centre"] == pytest.approx(centre, abs=1e-6) and edge.attrs["pulse_centre"] == 0
    frames = [Frame(**echoes.attrs["frame"]) for echoes in (own, edge)]
    north = [frame.to_geodetic(echoes.tx)[0] * NORTH for frame, echoes in zip(frames, (own, edge), strict=True)]
    np.testing.assert_allclose(north[0] - north[1], SPEED * centre, atol=5e-6)


def changed(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / name).write_bytes(change((folder / name).read_bytes()))

    return apply


def replaced(name: str, old: bytes, new: bytes) -> Callable[[Path], None]:
    return changed(name, lambda text: text.replace(old, new))


def written(name: str, samples: np.ndarray, rate: int = int(FS)) -> Callable[[Path], None]:
    return lambda folder: scipy.io.wavfile.write(folder / name, rate, samples)


def nothing(folder: Path) -> None:
    pass


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (changed("adc.bin", lambda b: b[:-2]), {}, "adc.bin: 335998 bytes: expected 336000, 60 x 2 x 1400 samples of int16"),
        (nothing, {"dtype": "<i4"}, "adc.bin: 336000 bytes: expected 672000, 60 x 2 x 1400 samples of int32"),
        (nothing, {"dtype": "complex64"}, "adc.bin: dtype 'complex64': expected a type of real numbers"),
        (nothing, {"dtype": "nonsense"}, "adc.bin: dtype 'nonsense': expected a type of real numbers"),
        (nothing, {"shape": "0 2 1400"}, "adc.bin: shape 0 x 2 x 1400: expected numbers of 1 or more"),
        (nothing, {"shape": f"30 4 {SAMPLES}"}, "pings.csv: 60 pings: expected 30, as --shape says of adc.bin"),
        (nothing, {"shape": f"60 1 {2 * SAMPLES}"}, "levers.csv: 2 receivers: expected 1, as --shape says of adc.bin"),
        (nothing, {"samples": "missing.bin"}, "missing.bin"),
        (nothing, {"samples": "."}, "Is a directory"),
        (nothing, {"fs": "half"}, "--fs 'half': expected a number, or FILE.mat:NAME"),
        (nothing, {"fs": "nan"}, "--fs 'nan': expected a number"),
        (nothing, {"fs": 0}, "--fs=0.0: expected"),
        (nothing, {"c": "survey.mat:speed"}, "survey.mat: no variable 'speed': expected one of fs, c, t0, replica, two, word"),
        (nothing, {"c": "survey.mat:two"}, "survey.mat: two: found float64 of shape (2, 2): expected real numbers"),
        (nothing, {"c": "survey.mat:word"}, "survey.mat: word: found text: expected real numbers"),
        (nothing, {"c": "survey.mat:replica"}, "--c: survey.mat, replica: 401 numbers: expected one"),
        (changed("survey.mat", lambda b: b[:500]), {"c": "survey.mat:replica"}, "survey.mat: found 172 of 864 bytes"),
        (changed("survey.mat", lambda b: b"text"), {"c": "survey.mat:c"}, "survey.mat: expected a .mat file"),
        (nothing, {"t0": -0.001}, "--t0=-0.001: expected"),
        (nothing, {"fc": 70e3}, "replica.wav: fc=70000 Hz: expected a frequency in 0 to 50000 Hz"),
        (nothing, {"bandwidth": 45e3}, "replica.wav: bandwidth=45000 Hz"),
        (nothing, {"bandwidth": 1e-6}, "--bandwidth 1e-06 Hz: expected more than a record resolves, 71.4286 Hz"),
        (nothing, {"pulse": "nav.csv"}, "nav.csv: does not begin with RIFF: expected a WAV file"),
        (changed("replica.wav", lambda b: b[:-100]), {}, "replica.wav: ends 100 bytes early: expected a WAV file"),
        (replaced("replica.wav", b"fmt ", b"fnt "), {}, "replica.wav: expected a WAV file (No fmt chunk before data)"),
        (written("replica.wav", np.ones((99, 2), np.int16)), {}, "replica.wav: int16 of shape (99, 2): expected one channel"),
        (written("replica.wav", np.ones(99, np.uint8)), {}, "replica.wav: uint8 of shape (99,): expected one channel"),
        (written("replica.wav", np.ones(99, np.int16), 48000), {}, "replica.wav: 48000 Hz: expected the samples' rate"),
        (written("replica.wav", np.zeros(99, np.int16)), {}, "replica.wav: pulse: 99 samples, peak 0"),
        (written("replica.wav", np.ones(3000, np.int16)), {}, "replica.wav: raw: pulse of 413 samples (0.03304 s)"),
        (written("replica.wav", np.full(99, np.nan, np.float32)), {}, "replica.wav: not finite first at sample 0"),
        (replaced("nav.csv", b"heading", b"yaw"), {}, "nav.csv: no column 'heading': expected time, lat"),
        (replaced("nav.csv", b"103.000,", b"102.000,"), {}, "nav.csv: time: 102.000000 s at row 35 is before 102.900000 s"),
        (changed("nav.csv", lambda b: b[: b.index(b"104.000")]), {}, "ping 39 at 103.900000 s on navigation's clock with"),
        (replaced("nav.csv", b",5,0,0,0", b",5,0,0,north"), {}, "nav.csv, line 2, heading: 'north': expected a number"),
        (replaced("pings.csv", b"103.000", b"103.200"), {}, "pings.csv: ping_time: 103.100000 s at ping 31 is before"),
        (replaced("pings.csv", b"time", b"when"), {}, "pings.csv: no column 'time': expected time, found when"),
        (replaced("levers.csv", b"rx0", b"hydrophone"), {}, "levers.csv: name 'hydrophone': expected tx or rx..."),
        (replaced("levers.csv", b"rx0", b"tx0"), {}, "levers.csv: 2 rows named tx: expected one transmitter"),
        (replaced("levers.csv", b"name", b"label"), {}, "levers.csv: text: no column 'name'"),
        (replaced("levers.csv", b"tx,0.1", b"tx,100.1"), {}, "levers.csv: tx: 100.1 m: expected a lever arm below 100 m"),
        (replaced("levers.csv", b"tx,0.1", b"tx,"), {}, "levers.csv: tx: nan"),
        (nothing, {"pulse-centre": -1}, "--pulse-centre=-1.0: expected"),
    ],
)  # fmt: skip
def test_bad_input_is_one_error(
    made: Path, tmp_path: Path, monkeypatch: Any, capsys: Any, change: Callable[[Path], None], options: Any, said: str
) -> None:
    for file in made.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    change(tmp_path)
    assert run("line.npz", **options) == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("pysas: error: ")]
    assert len(lines) == 1 and said in lines[0] and "Traceback" not in error
    assert not (tmp_path / "line.npz").exists()


def test_what_is_read_is_not_replaced(made: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(made)
    (made / "there.npz").write_bytes(b"")
    assert run("there.npz") == 2 and "there.npz: exists" in capsys.readouterr().err
    (made / "survey.npz").symlink_to("survey.mat")
    assert run("survey.npz", "--overwrite", c="survey.mat:c") == 2
    assert "is read by this command" in capsys.readouterr().err


def test_samples_of_every_real_type_are_mapped(tmp_path: Path) -> None:
    values = np.arange(24).reshape(2, 3, 4)
    for kind in ("<i2", ">i2", "<i4", "uint8", ">f4", "float64"):
        values.astype(kind).tofile(tmp_path / "raw")
        found = recordings.read_samples(str(tmp_path / "raw"), kind, (2, 3, 4))
        assert isinstance(found, np.memmap) and found.dtype == kind
        np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("kind", ["int32", "float32", "int16"])
def test_wav_of_every_width(tmp_path: Path, kind: str) -> None:
    values = (1000 * np.sin(np.arange(50))).astype(kind)
    scipy.io.wavfile.write(tmp_path / "a.wav", 96000, values)
    samples, rate = recordings.read_wav(str(tmp_path / "a.wav"))
    assert rate == 96000 and samples.dtype == kind
    np.testing.assert_array_equal(samples, values)
