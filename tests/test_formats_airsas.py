"""AirSAS: files of the published structure, made of real echoes by plain formulas here, read and imaged.

The MATLAB scripts that the data are published with (genLfm.m, packToStruct.m, reconstructImage.m) are followed step by step
for the answer; pysas' simulator takes no part.
"""

from __future__ import annotations

import pickle
import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.signal
from damaged_copies import mutated
from test_io import same

import pysas
from pysas import cli

FS, DELAY, START, STOP, DURATION, TAPER = 100e3, 62.3, 30e3, 10e3, 1e-3, 0.1  # s, Hz, samples
SPEAKER = np.array([0.02, 0.01, 0.95])
MICROPHONES = SPEAKER + np.array([[-0.06, 0, 0.06], [-0.02, 0, 0.06], [0.02, 0, 0.06], [0.06, 0, 0.06]])
POSITION = 1.6 + 0.006 * np.arange(130)  # m along the track
TEMPERATURE = np.stack([18.2 + 0.005 * np.arange(130), 19.0 + 0.005 * np.arange(130)])  # deg C, two sensors: 343 m/s
TARGET, PLANE = np.array([2.0123, 0.9047, 0.6032]), 0.6032
PIXEL = 3e-3  # m, of makeSasImage.m
PARAMETERS = [
    ("Sample rate", FS), ("Group delay", DELAY), ("Number of samples", 1000), ("Bits", 16), ("Averages", 1), ("Range", 10),
    ("Coupling", "AC"), ("Start frequency", START), ("Stop frequency", STOP), ("Pulse length", DURATION), ("Amplitude", 1),
    ("Window", "tukey"), ("Window parameter", TAPER),
]  # fmt: skip


def pulse(t: np.ndarray) -> np.ndarray:
    """genLfm.m times tukeywin, as functions of time."""
    edge = np.minimum(t, DURATION - t) / (TAPER * DURATION / 2)
    window = np.where(edge >= 1, 1.0, 0.5 * (1 - np.cos(np.pi * np.clip(edge, 0, 1))))
    return window * np.sin(2 * np.pi * (START + 0.5 * (STOP - START) / DURATION * t) * t) * ((t >= 0) & (t <= DURATION))


def speeds() -> np.ndarray:
    """getAirSpeed.m, model 0."""
    return 331.6 + 0.61 * TEMPERATURE.mean(axis=0)


def series(channel: int, samples: int = 1000) -> np.ndarray:
    """Echoes of one target and the sound that goes from speaker to microphone, (ping, sample), later by the group delay."""
    track = np.zeros((POSITION.size, 3))
    track[:, 0] = POSITION
    out, back = (np.linalg.norm(TARGET - track - place, axis=1) for place in (SPEAKER, MICROPHONES[channel - 1]))
    direct = np.linalg.norm(SPEAKER - MICROPHONES[channel - 1]) / speeds()
    t = (np.arange(samples) - DELAY) / FS
    return 0.5 + pulse(t - ((out + back) / speeds())[:, None]) + 3 * pulse(t - direct[:, None])


@pytest.fixture(scope="module")
def recorded() -> dict[int, np.ndarray]:
    return {channel: series(channel) for channel in (1, 2, 3, 4)}


def published(folder: Path, recorded: dict[int, np.ndarray], **parts: Any) -> Path:
    """The published folders with one scene: MATLAB's [sample, ping] is (ping, sample) of HDF5."""
    (folder / "scenes").mkdir(parents=True)
    (folder / "characterization data").mkdir()
    lines = [f"{name},{value},unit" for name, value in PARAMETERS]
    (folder / "characterization data" / "acquistionParams.csv").write_text("\n".join(["Parameter,Value,Units", *lines]))
    places = zip(["speaker", "mic 1", "mic 2", "mic 3", "mic 4"], [SPEAKER, *MICROPHONES], strict=True)
    lines = [",".join([name, *(f"{x:.6f}" for x in place)]) for name, place in places]
    (folder / "characterization data" / "sensorCoordinates.csv").write_text("\n".join(["Sensor,x,y,z", *lines]))
    path = folder / "scenes" / "t1e1_01.h5"
    with h5py.File(path, "w") as file:
        file.attrs["collection_date"] = "01-Jun-2020 17:18:14"
        for channel, ts in recorded.items():
            file[f"ch{channel}/ts"] = ts
            file[f"ch{channel}/img_re"] = np.zeros((3, 4))
        file["na/position"] = POSITION[None]
        file["na/temperature"] = TEMPERATURE
        file["na/humidity"] = np.full((1, POSITION.size), 40.0)
        file["na/xVec"], file["na/yVec"] = np.arange(4.0), np.arange(3.0)
        for name, value in parts.items():
            del file[name]
            if value is not None:
                file[name] = value
    return path


def around(spacing: float, half: int) -> pysas.Grid:
    offset = spacing * np.arange(-half, half + 1)
    return pysas.Grid.plane(TARGET[0] + offset, TARGET[1] + offset, z=PLANE)


def peak(image: np.ndarray, spacing: float) -> np.ndarray:
    """Place of the peak relative to the middle (x, y), m, by parabolas through logarithms."""
    level = np.log(np.abs(image))
    row, column = np.unravel_index(int(np.argmax(level)), level.shape)

    def vertex(a: float, b: float, c: float) -> float:
        return float(0.5 * (a - c) / (a - 2 * b + c))

    x = column - level.shape[1] // 2 + vertex(*level[row, column - 1 : column + 2])
    y = row - level.shape[0] // 2 + vertex(*level[row - 1 : row + 2, column])
    return spacing * np.array([x, y])


def script(ts: np.ndarray, microphone: np.ndarray, grid: pysas.Grid) -> np.ndarray:
    """packToStruct.m and reconstructImage.m on one channel, but for their high-pass filter, which passes the whole band."""
    data = ts.T - ts.T.mean(axis=0)
    count = data.shape[0]
    ramp = np.exp(2j * np.pi * np.fft.fftfreq(count, 1 / FS) * DELAY / FS)
    ramp[count // 2] = ramp[count // 2].real
    data = np.fft.ifft(np.fft.fft(data, axis=0) * ramp[:, None], axis=0).real
    length = round(DURATION * FS)
    blank = np.ones(count)
    blank[:length], blank[length : 2 * length] = 0, (np.sin(np.linspace(-np.pi / 2, np.pi / 2, length)) + 1) / 2
    data = scipy.signal.hilbert(data * blank[:, None], axis=0)
    data[:length] = 0
    size = count + length - 1
    replica = scipy.signal.hilbert(pulse(np.arange(length) / FS))
    spectrum = np.fft.fft(data, size, axis=0) * np.fft.fft(replica, size).conj()[:, None]
    data = scipy.signal.resample_poly(np.fft.ifft(spectrum, axis=0)[:count], 10, 1, axis=0)
    x, y = np.meshgrid(grid.axes["x"], grid.axes["y"])
    image = np.zeros(x.shape, complex)
    for ping, place in enumerate(POSITION):
        path = np.zeros(x.shape)
        for sensor in (SPEAKER, microphone):
            path += np.sqrt((x - sensor[0] - place) ** 2 + (y - sensor[1]) ** 2 + (PLANE - sensor[2]) ** 2)
        image += data[np.rint(path / speeds()[ping] * FS * 10).astype(int) - 1, ping]  # MATLAB counts from 1
    return image


def test_a_file_of_the_published_structure(tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    raw = pysas.load(published(tmp_path / "a", recorded))
    assert isinstance(raw, pysas.Echoes) and raw.data.shape[:2] == (130, 4) and not raw.compressed
    assert raw.pulse == pysas.LFM(20e3, -20e3, 1e-3, "tukey", 0.1) and raw.fc == 20e3
    assert raw.t0 == pytest.approx(-DELAY / FS, abs=1e-15) and raw.velocity is None
    np.testing.assert_allclose(raw.c, speeds(), rtol=1e-15)
    np.testing.assert_allclose(raw.tx[7], SPEAKER + [POSITION[7], 0, 0], atol=1e-6)
    np.testing.assert_allclose(raw.rx[7], MICROPHONES + [POSITION[7], 0, 0], atol=1e-6)
    assert raw.attrs["title"] == "t1e1_01" and raw.attrs["collection_date"] == "01-Jun-2020 17:18:14"


def test_the_target_lies_where_it_is(tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    echoes = pysas.compress(pysas.load(published(tmp_path / "a", recorded)))
    for chosen in (echoes, echoes.channels(0), echoes.channels(3)):
        image = pysas.backproject(chosen, around(1e-3, 15), tol=1e-4)
        assert np.max(np.abs(peak(np.asarray(image.data), 1e-3))) < 0.1 * PIXEL


def test_an_image_is_that_of_the_published_scripts(tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    """They read the nearest of 1 us: phases are off by 2 pi 20 kHz x 0.29 us rms and, counting from 1, by 1 us for all."""
    echoes = pysas.compress(pysas.load(published(tmp_path / "a", recorded)))
    grid = around(PIXEL, 12)
    for channel in (1, 4):
        expected = script(recorded[channel], MICROPHONES[channel - 1], grid)
        found = np.asarray(pysas.backproject(echoes.channels(channel - 1), grid, tol=1e-4).data)
        alike = np.abs(np.vdot(expected, found)) / (np.linalg.norm(expected) * np.linalg.norm(found))
        assert alike > 0.99
        np.testing.assert_allclose(peak(expected, PIXEL), peak(found, PIXEL), atol=0.1 * PIXEL)


def test_the_command_images_it(tmp_path: Path, recorded: dict[int, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    path = published(tmp_path / "a", recorded)
    monkeypatch.chdir(tmp_path)
    spans = ["--z", "0.6032", "--x", "1.95:2.07", "--y", "0.85:0.95", "--spacing", "0.003"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a straight line of pings, and of echoes that begin before t = 0
        assert cli.main(["image", str(path), *spans, "-o", "x.npz"]) == 0
    image = pysas.load("x.npz")
    row, column = np.unravel_index(int(np.argmax(np.abs(image.data))), image.data.shape)
    found = image.grid.axes["x"][column], image.grid.axes["y"][row]
    assert np.max(np.abs(np.array(found) - TARGET[:2])) <= PIXEL


def test_the_speed_of_sound_is_near_cramer_s_equation() -> None:
    """O. Cramer, JASA 93 (1993), equations 15 and A1 to A3, Table III: within 0.1 % at 50 % humidity, 0.2 % in dry air."""
    from pysas.signal.recorded import speed_in_air

    t = np.linspace(10, 25, 16)
    kelvin, p, xc = t + 273.15, 101325.0, 4e-4
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    saturation = np.exp(1.2811805e-5 * kelvin**2 - 1.9509874e-2 * kelvin + 34.04926034 - 6.3536311e3 / kelvin)
    for humidity, most in ((0.5, 1e-3), (0.0, 2e-3)):
        xw = humidity * enhancement * saturation / p
        c = (
            331.5024 + 0.603055 * t - 0.000528 * t**2 + (51.471935 + 0.1495874 * t - 0.000782 * t**2) * xw
            + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p + (-85.20931 - 0.228525 * t + 5.91e-5 * t**2) * xc
            - 2.835149 * xw**2 - 2.15e-13 * p**2 + 29.179762 * xc**2 + 0.000486 * xw * p * xc
        )  # fmt: skip
        assert np.max(np.abs(speed_in_air(t) / c - 1)) < most
    with pytest.raises(ValueError, match="air_temperature: 295 at ping 1: expected -100 to 100 Celsius"):
        speed_in_air([20.0, 295.0])


# What is missing or wrong


def edited(name: str, change: Callable[[str], str | None]) -> Callable[[Path], None]:
    """A change of a table beside the scenes; None takes it away."""

    def act(path: Path) -> None:
        table = path.parents[1] / "characterization data" / name
        text = change(table.read_text())
        table.unlink()
        if text is not None:
            table.write_text(text)

    return act


def kept(path: Path) -> None:
    """No change."""


def put(name: str, old: object, new: str) -> Callable[[Path], None]:
    return edited(name, lambda text: text.replace(str(old), new))


P, S = "acquistionParams.csv", "sensorCoordinates.csv"
WRONG: dict[str, tuple[dict[str, Any], Callable[[Path], None], str]] = {
    "no parameters": ({}, edited(P, lambda text: None), 'h5: needs .*acquistionParams.csv, which is missing: .*"scenes"'),
    "no sensors": ({}, edited(S, lambda text: None), "t1e1_01.h5: needs .*sensorCoordinates.csv, which is missing"),
    "too few rows": ({}, edited(P, lambda text: text[:200]), "Params.csv: row .* below the header, column 2: missing"),
    "a rate in words": ({}, put(P, FS, "fast"), "row 1 below the header, column 2: found 'fast'"),
    "a rate below zero": ({}, put(P, FS, "-1"), "fs=-1.0: expected a finite number > 0"),
    "frequencies beyond": ({}, put(P, START, "90000"), "fc=50000 Hz: expected a frequency in"),
    "too few sensors": ({}, edited(S, lambda text: text[: text.index("mic 4")]), "Coordinates.csv: found 4 rows"),
    "a place in words": ({}, put(S, "0.950000", "up"), "row 1 below the header: found 'speaker,"),
    "a table of gigabytes": ({}, edited(S, lambda text: text + "\n" * 2**20), "Coordinates.csv: found more than 1048576"),
    "no places": ({"na/position": None}, kept, "position: missing, expected real numbers"),
    "places in rows": ({"na/position": np.zeros((2, 65))}, kept, r"position: found shape \(2, 65\), expected one row"),
    "temperatures of others": ({"na/temperature": np.zeros((2, 9))}, kept, r"na/temperature: found shape \(2, 9\), expected"),
    "Kelvin": ({"na/temperature": np.full((2, 130), 291.0)}, kept, "air_temperature: 291 at ping 0: expected -100 to 100"),
    "turned samples": ({"ch2/ts": np.zeros((1000, 130))}, kept, r"ch2/ts: found float64 of shape .*, expected .*ping=130"),
    "complex samples": ({"ch2/ts": np.zeros((130, 1000), complex)}, kept, "ch2/ts: found complex128 .* expected real numbers"),
    "other samples": ({"ch2/ts": np.zeros((130, 999))}, kept, r"ch2/ts: found .*\(130, 999\), expected those of ch1"),
    "no samples": ({"ch1/ts": None}, kept, "ch1/ts: found object of shape"),
    "not finite": ({"ch3/ts": np.full((130, 1000), np.nan)}, kept, "samples: nan at ping 0, channel 2, sample 0"),
    "a link": ({"ch1/ts": h5py.SoftLink("/ch2/ts")}, kept, "found a link, expected a dataset"),
    "a linked group": ({"na": h5py.ExternalLink("other.h5", "/na")}, kept, "na: found a link"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_error_that_names_the_file(case: str, tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    parts, change, message = WRONG[case]
    path = published(tmp_path / "a", recorded, **parts)
    change(path)
    with pytest.raises((ValueError, OSError), match=message) as caught:
        pysas.load(path)
    assert str(tmp_path / "a") in str(caught.value) and len(str(caught.value)) < 600


def test_a_file_in_the_root_of_a_file_system_is_no_other_error(
    tmp_path: Path, recorded: dict[int, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose folder has none above it."""
    path = published(tmp_path / "a", recorded)
    monkeypatch.setattr(Path, "resolve", lambda self: Path("/") / self.name)
    with pytest.raises(FileNotFoundError, match="t1e1_01.h5: needs /characterization data/acquistionParams.csv"):
        pysas.load(path)


def test_a_channel_is_not_chosen(tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="channel='1': a file of format airsas is read whole"):
        pysas.load(published(tmp_path / "a", recorded), channel="1")


# Arrays out of a pickle


def arrays(recorded: dict[int, np.ndarray]) -> dict[str, Any]:
    """As A. W. Reed et al. keep them: traces of one microphone, their group delay removed."""
    track = np.zeros((POSITION.size, 3))
    track[:, 0] = POSITION
    spectrum = np.fft.rfft(recorded[1]) * np.exp(2j * np.pi * np.fft.rfftfreq(1000, 1 / FS) * DELAY / FS)
    return {
        "wfm_data": np.fft.irfft(spectrum), "tx_coords": track + SPEAKER, "rx_coords": track + MICROPHONES[0],
        "temps": TEMPERATURE.mean(axis=0)[:, None], "sampling_frequency": FS, "f_start": START, "f_stop": STOP,
        "t_dur": DURATION, "win_ratio": TAPER,
    }  # fmt: skip


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_arrays_out_of_a_pickle(suffix: str, tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    fields, path = arrays(recorded), tmp_path / f"system_data{suffix}"
    if suffix == ".npz":
        np.savez(path, **fields)
    else:
        with h5py.File(path, "w") as file:
            for name, value in fields.items():
                file[name] = value
    raw = pysas.load(path)
    assert raw.data.ndim == 2 and raw.t0 == 0.0
    np.testing.assert_allclose(raw.c, speeds())
    image = pysas.backproject(pysas.compress(raw), around(1e-3, 15), tol=1e-4)
    assert np.max(np.abs(peak(np.asarray(image.data), 1e-3))) < 0.1 * PIXEL


def test_the_documented_conversion_of_a_pickle(
    tmp_path: Path, recorded: dict[int, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = arrays(recorded)
    data = {name: fields[name] for name in ("wfm_data", "tx_coords", "rx_coords", "temps")}
    data |= {"speed_of_sound": 343.1, "sys_params": {"sampling_frequency": FS}}
    data["wfm_params"] = {name: fields[name] for name in ("f_start", "f_stop", "t_dur", "win_ratio")}
    (tmp_path / "system_data.pik").write_bytes(pickle.dumps(data))
    docs = (Path(__file__).parents[1] / "docs" / "formats.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```python\n(import pickle.*?)```", docs, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(snippet, {})
    raw = pysas.load("system_data.npz")
    assert raw.c == 343.1 and raw.n_ping == POSITION.size and raw.pulse == pysas.LFM(20e3, -20e3, 1e-3, "tukey", 0.1)
    with pytest.raises(ValueError, match="system_data.pik: a Python pickle"):
        pysas.load("system_data.pik")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"f_stop": None}, "f_stop: missing, expected wfm_data, tx_coords"),
        ({"temps": None}, r"speed_of_sound: missing, expected it \(m/s, one number\) or temps"),
        ({"speed_of_sound": np.array([343.0, 344.0])}, r"speed_of_sound: found shape \(2,\), expected one number"),
        ({"wfm_data": np.zeros((130, 1000), complex)}, "wfm_data: found complex128 of shape .* expected real numbers"),
        ({"rx_coords": np.zeros((129, 3))}, r"rx: expected shape \(130, 3\), found \(129, 3\)"),
        ({"tx_coords": np.array([{}])}, "tx_coords: damaged or not .npy"),
    ],
)
def test_arrays_that_are_wrong(change: dict[str, Any], message: str, tmp_path: Path, recorded: dict[int, np.ndarray]) -> None:
    fields = {name: value for name, value in (arrays(recorded) | change).items() if value is not None}
    np.savez(tmp_path / "a.npz", allow_pickle=True, **fields)
    with pytest.raises(ValueError, match=rf"^[^:]*a\.npz: {message}"):
        pysas.load(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", ["scene", P, S, "arrays"])
def test_damage(kind: str, tmp_path: Path) -> None:
    """200 mutated copies: an error that names a file, the same, or other numbers where no checksum can tell."""
    few = {channel: series(channel, 300)[:5].astype(np.float32) for channel in (1, 2)}
    scene = {"na/position": POSITION[None, :5], "na/temperature": TEMPERATURE[:, :5]}
    path = published(tmp_path / "a", few, **scene)
    target = path if kind == "scene" else path.parents[1] / "characterization data" / kind
    if kind == "arrays":
        path = target = tmp_path / "system_data.npz"
        fields = arrays({1: np.pad(few[1], ((0, 0), (0, 700)))})
        np.savez(path, **{name: value[:5] if np.ndim(value) else value for name, value in fields.items()})
    good, expected = target.read_bytes(), pysas.load(path)
    errors, others = 0, 0
    for content in mutated(good, random.Random(9), 200, ((b"ts", b"tx"), (b"na", b"ma"), (b"<f8", b"<i8"), (b",", b";"))):
        target.unlink()  # h5py keeps what it read of a file that has the same number
        target.write_bytes(content)
        try:
            loaded = pysas.load(path)
        except (ValueError, OSError) as error:
            errors += 1
            assert re.search(re.escape(str(tmp_path)), str(error)), error
            continue
        others += not same(loaded, expected)
        assert isinstance(loaded, pysas.Echoes)
    assert errors >= 25
    if kind == "arrays":
        assert others == 0
