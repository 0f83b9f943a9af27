"""Plain arrays with a header: the documented example, exact round trips, every container, and what a wrong header says."""

from __future__ import annotations

import json
import random
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from damaged_copies import mutated
from test_io import ECHOES, same, survey

import pysas
from pysas import cli
from pysas.formats import arrays, headers

pytestmark = pytest.mark.reference  # no engine takes part
DOCS = Path(__file__).parents[1] / "docs" / "formats.md"
TARGET = np.array([0.2, 8.0, 0.0])
PULSE = pysas.LFM(100e3, 15e3, 1e-3, "tukey", 0.1)


def simulated() -> pysas.Echoes:
    track = pysas.tracks.straight(40, 0.05, start=(-1.0, 0.0, 0.0), height=3.0)
    rx = pysas.tracks.array(track, 2, 0.05)
    raw = pysas.simulate([TARGET], [1.0], PULSE, tx=track.position, rx=rx, fs=40e3, t0=4e-3, duration=0.014)
    velocity = np.tile([1.5, 0.0, 0.0], (40, 1))
    return raw.replace(
        data=raw.data[..., :560], velocity=velocity,
        attrs={"title": "one target", "truth_position": TARGET[None], "truth_amplitude": np.ones(1)},
    )  # fmt: skip


def example() -> str:
    (found,) = re.findall(r"```yaml\n(header: .*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    return str(found)


@pytest.fixture
def documented(tmp_path: Path) -> tuple[Path, pysas.Echoes]:
    """The files of the documented header, made without pysas' writers, and what they hold."""
    raw = simulated()
    step = np.abs(raw.data).max() / 30000
    counts = np.stack([raw.data.real, raw.data.imag], axis=-1) / step
    np.rint(counts).astype("<i2").tofile(tmp_path / "samples.bin")
    np.savez(tmp_path / "track.npz", transmitter=raw.tx)
    scipy.io.savemat(tmp_path / "track.mat", {"receivers": raw.rx})
    np.save(tmp_path / "velocity.npy", np.asarray(raw.velocity).astype(np.float32))
    (tmp_path / "survey.yaml").write_text(example())
    return tmp_path / "survey.yaml", raw


def test_the_documented_header(documented: tuple[Path, pysas.Echoes]) -> None:
    path, raw = documented
    loaded = pysas.load(path)
    assert isinstance(loaded, pysas.Echoes) and loaded.data.shape == (40, 2, 560) and loaded.data.dtype == np.complex64
    counts = np.fromfile(path.with_name("samples.bin"), "<i2").reshape(40, 2, 560, 2).astype(np.float32)
    np.testing.assert_array_equal(loaded.data, counts[..., 0] + 1j * counts[..., 1])
    assert same(dict(vars(loaded.replace(data=raw.data))), dict(vars(raw)))


def test_the_documented_header_is_converted_and_named_keys_are_all_told(documented: tuple[Path, pysas.Echoes]) -> None:
    path, _ = documented
    assert cli.main(["convert", str(path), str(path.with_suffix(".npz"))]) == 0
    assert same(pysas.load(path.with_suffix(".npz")), pysas.load(path))


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("case", ECHOES)
def test_echoes_come_back_bit_for_bit(case: str, suffix: str, tmp_path: Path) -> None:
    echoes = ECHOES[case]()
    path = tmp_path / f"survey{suffix}"
    arrays.FORMAT.write(str(path), echoes, False)
    assert same(pysas.load(path), echoes)
    assert all(name.name.startswith("survey.") for name in tmp_path.iterdir())


def test_text_that_looks_like_something_else_stays_text(tmp_path: Path) -> None:
    attrs = {"a": "1e5", "b": "12", "c": "yes", "d": "2020-01-01", "e": "null", "f": ".5", "g": [1e-7, 1e16, 3, "~"], "h": "+1"}
    for suffix in (".yaml", ".json"):
        arrays.FORMAT.write(str(tmp_path / f"a{suffix}"), survey(attrs=attrs), True)
        assert pysas.load(tmp_path / f"a{suffix}").attrs == attrs


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_numbers_that_are_not_finite_are_no_part_of_a_header(suffix: str, tmp_path: Path) -> None:
    """JSON has none, and readers of headers take none."""
    for value in (np.nan, -np.inf):
        with pytest.raises(ValueError, match=f"a{suffix}: found a number that is not finite"):
            arrays.FORMAT.write(str(tmp_path / f"a{suffix}"), survey(attrs={"depth": [1.0, value]}), False)
    assert not list(tmp_path.iterdir())


def test_files_that_are_there_are_kept(tmp_path: Path) -> None:
    """All take their names together: another survey's arrays are not half replaced."""
    path = tmp_path / "a.yaml"
    arrays.FORMAT.write(str(path), survey(), False)
    before = {item.name: item.read_bytes() for item in tmp_path.iterdir()}
    with pytest.raises(FileExistsError):
        arrays.FORMAT.write(str(path), survey(), False)
    path.unlink()
    with pytest.raises(FileExistsError, match=r"a\.\w+\.npy"):
        arrays.FORMAT.write(str(path), survey(c=1400.0), False)
    with pytest.raises(ValueError, match="attrs: found .* bytes of text, expected at most 262144"):
        arrays.FORMAT.write(str(path), survey(attrs={"x": "y" * 2**20}), True)
    del before["a.yaml"]
    assert {item.name: item.read_bytes() for item in tmp_path.iterdir()} == before


@pytest.mark.parametrize("names", [("a.yaml", "a.json"), ("a.yaml", "tx.npz"), ("link.yaml", "a.json")])
def test_what_a_header_names_is_not_replaced_by_what_is_made_of_it(
    names: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor its arrays by those of another header, some of whose pings are asked for."""
    arrays.FORMAT.write(str(tmp_path / "a.yaml"), survey(), False)
    np.savez(tmp_path / "tx.npz", tx=survey().tx)
    text = (tmp_path / "a.yaml").read_text()
    begin, end = text.index("tx:"), text.index("\nrx:")
    (tmp_path / "a.yaml").write_text(text[:begin] + "tx: {file: tx.npz, name: tx}" + text[end:])
    (tmp_path / "link.yaml").symlink_to(tmp_path / "a.yaml")
    before = {item.name: item.read_bytes() for item in tmp_path.iterdir()}
    source, target = (str(tmp_path / name) for name in names)
    assert cli.main(["convert", source, target, "--pings", "0:2", "--overwrite"]) == 2
    said = capsys.readouterr().err
    assert f"B {target}" in said and "is read by this command" in said
    assert {item.name: item.read_bytes() for item in tmp_path.iterdir()} == before
    if target.endswith(".npz"):
        assert cli.main(["image", source, "--z", "0", "-o", target, "--overwrite"]) == 2
        assert "is read by this command" in capsys.readouterr().err
        assert {item.name: item.read_bytes() for item in tmp_path.iterdir()} == before


# Arrays of every container and order


RAW = np.random.default_rng(3).standard_normal((4, 2, 12, 2)).view(np.complex128)[..., 0]
LEAST: dict[str, Any] = {
    "header": "pysas-arrays-1", "units": "m, s, Hz", "axes": "ping channel sample", "phase": "exp(-j)", "fs": 40000,
    "fc": 1e5, "compressed": True, "tx": np.arange(12.0).reshape(4, 3).tolist(), "c": 1500, "t0": 0.01,
    "rx": np.arange(24.0).reshape(4, 2, 3).tolist(), "data": {"file": "data.npy"},
}  # fmt: skip


def header(tmp_path: Path, changes: dict[str, Any], suffix: str = ".json") -> Path:
    """The least header with changes; None takes a key away. Its data lie beside it, made by NumPy."""
    if not (tmp_path / "data.npy").exists():
        np.save(tmp_path / "data.npy", RAW)
    entries = {key: value for key, value in (LEAST | changes).items() if value is not None}
    path = tmp_path / f"header{suffix}"
    path.write_text(json.dumps(entries))
    return path


def test_the_least_header(tmp_path: Path) -> None:
    for suffix in (".json", ".yaml", ".yml"):  # JSON is YAML 1.2
        loaded = pysas.load(header(tmp_path, {}, suffix))
        np.testing.assert_array_equal(loaded.data, RAW)
        assert (loaded.fs, loaded.c, loaded.t0, loaded.compressed) == (40e3, 1500.0, 0.01, True)
        np.testing.assert_array_equal(loaded.rx.ravel(), np.arange(24.0))


def saved(tmp_path: Path, name: str, array: np.ndarray) -> dict[str, Any]:
    """An array in a file of the container that the name says, without pysas, and the header's entry for it."""
    path, suffix = tmp_path / name, Path(name).suffix
    if suffix == ".npy":
        np.save(path, array)
        return {"file": name}
    if suffix == ".npz":
        np.savez_compressed(path, x=array)
        return {"file": name, "name": "x"}
    if suffix == ".mat":
        scipy.io.savemat(path, {"x": array, "text": "y"}, do_compression=True)
        return {"file": name, "name": "x"}
    if suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["deep/er/x"] = array
        return {"file": name, "name": "deep/er/x"}
    path.write_bytes(b"head" + array.tobytes() + b"tail")
    return {"file": name, "dtype": array.dtype.str, "shape": list(array.shape), "offset": 4}


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mat", ".h5", ".raw"])
@pytest.mark.parametrize("axes", ["ping channel sample", "sample channel ping", "channel, sample, ping"])
def test_any_container_and_order_of_axes(axes: str, suffix: str, tmp_path: Path) -> None:
    words = axes.replace(",", "").split()
    turned = RAW.transpose([("ping", "channel", "sample").index(word) for word in words])
    array = np.asfortranarray(turned) if suffix == ".npy" else np.ascontiguousarray(turned)
    loaded = pysas.load(header(tmp_path, {"axes": axes, "data": saved(tmp_path, f"x{suffix}", array)}))
    np.testing.assert_array_equal(loaded.data, RAW)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mat", ".h5", ".raw"])
def test_in_phase_and_quadrature_in_any_place(suffix: str, tmp_path: Path) -> None:
    counts = np.random.default_rng(4).integers(-9999, 9999, (2, 4, 2, 12)).astype("<i2")
    entry = saved(tmp_path, f"x{suffix}", counts)
    loaded = pysas.load(header(tmp_path, {"axes": ["iq", "ping", "channel", "sample"], "data": entry}))
    np.testing.assert_array_equal(loaded.data, counts[0] + 1j * counts[1])
    loaded = pysas.load(header(tmp_path, {"axes": "iq ping channel sample", "data": entry}))
    np.testing.assert_array_equal(loaded.data, counts[0] + 1j * counts[1])
    assert loaded.data.dtype == np.complex64


def test_vectors_of_matlab_and_single_precision(tmp_path: Path) -> None:
    c, t0 = np.linspace(1490, 1500, 4).astype(np.float32), np.arange(4, dtype=np.int16)
    entries = {
        "c": saved(tmp_path, "c.mat", c),
        "t0": saved(tmp_path, "t0.mat", t0),
        "fs": saved(tmp_path, "fs.mat", np.array(4e4)),
    }
    loaded = pysas.load(header(tmp_path, entries))
    np.testing.assert_array_equal(loaded.c, c.astype(float))
    np.testing.assert_array_equal(loaded.t0, t0.astype(float))
    assert loaded.fs == 4e4
    wave = np.array([[1.0, 2.0, 3.0]]) * 1j
    entries = {
        "waveform": saved(tmp_path, "w.mat", wave),
        "compressed": False,
        "truth_position": [[1, 2, 3]],
        "truth_amplitude": [1],
    }
    loaded = pysas.load(header(tmp_path, entries))
    np.testing.assert_array_equal(loaded.pulse, wave[0])
    np.testing.assert_array_equal(loaded.attrs["truth_position"], [[1.0, 2.0, 3.0]])


def test_data_of_the_other_sign_are_conjugates(tmp_path: Path) -> None:
    wave = np.exp(1j * np.arange(5.0))
    changes = {"phase": "exp(+j)", "compressed": False, "waveform": saved(tmp_path, "w.npy", wave)}
    loaded = pysas.load(header(tmp_path, changes))
    np.testing.assert_array_equal(loaded.data, RAW.conj())
    np.testing.assert_array_equal(loaded.pulse, wave.conj())


def test_real_samples_are_demodulated(tmp_path: Path) -> None:
    """A real echo A cos(2 pi f t + phi) at f = fc is A exp(j phi) (docs/conventions.md), in the middle of its record."""
    fs, fc, t0, phi = 400e3, 100e3, 3e-3, np.array([0.1, 1.0, -2.0, 3.0])
    t = t0 + np.arange(4000) / fs
    real = 2.5 * np.cos(2 * np.pi * fc * t + phi[:, None, None]) * np.ones((1, 2, 1))
    changes = {
        "phase": None, "fs": fs, "t0": t0, "bandwidth": 15e3, "compressed": False, "data": saved(tmp_path, "real.npy", real),
        "pulse_kind": "lfm", "pulse_fc": 1e5, "pulse_bandwidth": 15e3, "pulse_duration": 1e-3, "pulse_window": "rect",
    }  # fmt: skip
    loaded = pysas.load(header(tmp_path, changes))
    n = loaded.n_sample
    assert loaded.t0 == t0 and loaded.pulse == pysas.LFM(1e5, 15e3, 1e-3) and 1.1 * 15e3 < loaded.fs < 40e3
    middle = loaded.data[..., n // 3 : -n // 3]
    np.testing.assert_allclose(middle, 2.5 * np.exp(1j * phi[:, None, None]) * np.ones_like(middle), atol=1e-5)
    assert cli.main(["convert", str(tmp_path / "header.json"), str(tmp_path / "out.npz")]) == 0
    assert same(pysas.load(tmp_path / "out.npz").data, loaded.data)


# What is wrong


def raw(dtype: str, *shape: int, **more: Any) -> dict[str, Any]:
    """The entry of 768 bytes in raw binary."""
    return {"data": {"file": "raw.bin", "dtype": dtype, "shape": list(shape), **more}}


REAL: dict[str, Any] = {"phase": None, "data": {"file": "real.npy"}}
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "a key misspelt": ({"bandwith": 1.0}, "bandwith: no key of a header: bandwidth is meant"),
    "a key in capitals": ({"FC": 1.0}, "FC: no key of a header: fc is meant"),
    "a key unlike all": ({"sampling_rate": 1.0}, "sampling_rate: no key of a header, expected some of header, units"),
    "a key of nothing": ({"colour": 1.0}, "colour: no key of a header, expected some of header, units"),
    "the schema's own": ({"schema": "pysas-echoes-1"}, "schema: no key of a header"),
    "another header": ({"header": "pysas-arrays-1.5"}, "header: found 'pysas-arrays-1.5', expected pysas-arrays-1"),
    "units of others": ({"units": "mm, ms, kHz"}, "units: found 'mm, ms, kHz', expected 'm, s, Hz'"),
    "no units": ({"units": None}, "units: found 'none'"),
    "no axes": ({"axes": None}, "data: axes: found None, expected those of data"),
    "axes without pings": ({"axes": "channel sample"}, "data: axes: found 'channel sample'"),
    "an axis twice": ({"axes": "ping ping sample"}, "data: axes: found 'ping ping sample'"),
    "other axes": ({"axes": "ping sample beam"}, "data: axes: found 'ping sample beam'"),
    "too few axes": ({"axes": "ping sample"}, r"data: found shape \(4, 2, 12\), expected 2 axes: ping, sample"),
    "no pair": ({"axes": "ping iq sample"}, "data: found complex128 of shape .* expected real numbers, 2 along axis iq"),
    "no phase": ({"phase": None}, r"data: phase: found 'none', expected exp\(-j\) or exp\(\+j\)"),
    "another phase": ({"phase": "-"}, "data: phase: found '-'"),
    "no data": ({"data": None}, "data: missing, expected complex64 or complex128"),
    "no tx": ({"tx": None}, "tx: missing, expected float64"),
    "no compressed": ({"compressed": None}, "compressed: missing, expected bool"),
    "compressed in words": ({"compressed": "yes"}, "compressed: found 'yes'"),
    "fs in words": ({"fs": "40 kHz"}, "fs: found '40 kHz', expected a number"),
    "fs below zero": ({"fs": -1.0}, r"fs=-1\.0: expected a finite number > 0"),
    "true for a number": ({"fs": True}, "fs: found bool .*expected float64"),
    "rx of other pings": ({"rx": [[[0, 0, 0]] * 2] * 3}, r"rx: found shape \(3, 2, 3\), expected \(ping=4, channel=2, 3\)"),
    "unequal lengths": ({"tx": [[0, 0, 0], [0, 0]]}, "tx: found .* expected a number, lists of numbers of equal lengths"),
    "half a pulse": ({"pulse_kind": "lfm"}, "pulse_fc: missing, expected beside pulse_kind"),
    "attrs in words": ({"attrs": "x"}, "attrs: found 'x', expected a mapping"),
    "no such file": ({"data": {"file": "none.npy"}}, "data: .*none.npy"),
    "a folder": ({"data": {"file": "."}}, "data: .*"),
    "an entry without a file": ({"data": {"dtype": "<i2"}}, "data: missing file, expected file, and name"),
    "an entry's other key": ({"data": {"file": "data.npy", "axis": 0}}, "data: found 'axis', expected file, and name"),
    "a name that .npy has not": ({"data": {"file": "data.npy", "name": "x"}}, ".*found file, name, expected file alone"),
    "no name": ({"data": {"file": "x.npz"}}, r"data: .*x.npz: name: missing, expected that of an array in the \.npz"),
    "no shape": ({"data": {"file": "raw.bin"}}, r"data: .*raw.bin: found file, expected dtype and shape of \.bin"),
    "no order of bytes": (raw("i2", 4, 2, 12), "data: .*dtype 'i2': expected its byte order too"),
    "no numbers": (raw("O", 4), "data: .*dtype 'O': expected one such as <i2"),
    "no type": (raw("<i2)(", 4), r"data: .*dtype '<i2\)\('"),
    "a type of several": (raw("(9,)<f8", 4), "data: .*expected one such as <i2"),
    "another size": (
        raw("<c8", 4, 2, 13), r"data: .*raw.bin: found 768 bytes, expected 832: complex64 of shape",
    ),
    "terabytes": (raw("<c8", 2**40, 2, 13), "data: .*raw.bin: found 768 bytes, expected"),
    "a shape below one": (raw("<c8", -4, -2), r"data: .*shape \[-4, -2\]: expected a list"),
    "an offset below zero": (raw("<c8", 4, offset=-8), "data: .*offset -8: expected"),
    "no such array": ({"data": {"file": "x.npz", "name": "y"}}, "data: .*x.npz: y: missing, expected one of x"),
    "no such group": ({"data": {"file": "x.h5", "name": "a/b/y"}}, "data: .*x.h5: a/b: missing, expected a group"),
    "objects": ({"data": {"file": "objects.npy"}}, "data: .*objects.npy: found object of shape"),
    "another crc32": ({"data": {"file": "data.npy", "crc32": 1}}, "data: .*data.npy: damaged: found other numbers"),
    "real without a band": (REAL, "bandwidth: missing, expected the band about fc"),
    "real with a phase": ({"data": {"file": "real.npy"}}, "data: phase: found beside real data"),
    "real with windows": (
        REAL | {"bandwidth": 1e4, "valid": [[0, 11]] * 4}, "valid: found beside real data",
    ),
    "real with a waveform": (
        REAL | {"bandwidth": 1e4, "waveform": [1, 2]}, "waveform: found beside real data",
    ),
    "real and under-sampled": (REAL | {"bandwidth": 1e4}, "fc=100000 Hz: expected a frequency in"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_header_is_one_error_that_names_it(case: str, tmp_path: Path) -> None:
    RAW.astype("<c8").tofile(tmp_path / "raw.bin")
    np.savez(tmp_path / "x.npz", x=RAW)
    np.save(tmp_path / "real.npy", RAW.real)
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["a/x"] = RAW
    changes, message = WRONG[case]
    path = header(tmp_path, changes)
    with pytest.raises((ValueError, OSError), match=f"{re.escape(str(path))}: {message}") as caught:
        pysas.load(path)
    assert len(str(caught.value)) < 600


TEXTS: dict[str, tuple[str, str]] = {
    "aliases": ("header: pysas-arrays-1\na: &a [1]\nb: *a\n", "found an alias"),
    "a bomb of aliases": ("header: pysas-arrays-1\na: &a [x,x]\nb: &b [*a,*a]\nc: &c [*b,*b]\n", "found an alias"),
    "objects": (
        "header: pysas-arrays-1\nfs: !!python/object/apply:os.system [ls]\n",
        "no YAML: .* constructor",
    ),
    "a key twice": ("header: pysas-arrays-1\nfs: 1\nfs: 2\n", "found a key twice"),
    "not finite": ("header: pysas-arrays-1\nfs: 1e999\n", "found 1e999, expected finite numbers"),
    "a key of numbers": ("header: pysas-arrays-1\n1: 2\n", "found a key that is no text"),
    "a list": ("- header: pysas-arrays-1\n", "found list, expected a mapping"),
    "deep": ("header: pysas-arrays-1\nattrs: " + "[" * 5000, ""),
    "no YAML": ("header: pysas-arrays-1\nx: [1\n", "no YAML: "),
}


@pytest.mark.parametrize("case", TEXTS)
def test_what_yaml_can_hide_is_refused(case: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(TEXTS[case][0])
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}: {TEXTS[case][1]}"):
        pysas.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"header": "pysas-arrays-1", "fs": 1, "fs": 2}', "fs: found twice"),
        ('{"header": "pysas-arrays-1", "fs": NaN}', "found NaN, expected finite numbers"),
        ('{"header": "pysas-arrays-1", "fs": 1e999}', "found 1e999, expected finite numbers"),
        ('{"header": "pysas-arrays-1", "attrs": ' + "[" * 5000, ""),
        ('["pysas-arrays-1"]', "found list, expected a mapping"),
    ],
)
def test_what_json_can_hide_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ValueError, match=f"a.json: {message}"):
        pysas.load(tmp_path / "a.json")


def test_a_header_of_more_than_256_kib_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("header: pysas-arrays-1\n" + "#" * 2**18)
    with pytest.raises(ValueError, match="a.yaml: found more than 262144 bytes"):
        pysas.load(tmp_path / "a.yaml")


def test_yaml_without_its_library_names_the_extra_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yaml", None)
    path = header(tmp_path, {}, ".yaml")
    with pytest.raises(ImportError, match=r"pysas-sonar\[yaml\]'; a header in JSON needs nothing"):
        pysas.load(path)
    with pytest.raises(ImportError, match="JSON"):
        headers.written_header("a.yaml", {})
    np.testing.assert_array_equal(pysas.load(header(tmp_path, {})).data, RAW)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mat", ".h5", ".raw", ".json", ".yaml"])
def test_damage(suffix: str, tmp_path: Path) -> None:
    """200 mutated copies: an error that names a file, the same, or other numbers where no checksum can tell."""
    checked, text = suffix == ".npz", suffix in (".json", ".yaml")
    array = RAW.astype("<c8")
    entry = saved(tmp_path, "x.npy" if text else f"x{suffix}", array)
    path = header(tmp_path, {"data": entry}, suffix if text else ".json")
    target = path if text else tmp_path / f"x{suffix}"
    good, expected = target.read_bytes(), pysas.load(path)
    outcomes = {"error": 0, "same": 0, "other": 0}
    swaps: tuple[tuple[bytes, bytes], ...] = ((b"<c8", b"<c4"), (b"<c8", b">c8"), (b"(4, 2", b"(8, 1"), (b"\x06", b"\x07"))
    for content in mutated(good, random.Random(7), 200, swaps):
        target.unlink()  # h5py keeps what it read of a file that has the same number
        target.write_bytes(content)
        try:
            with warnings.catch_warnings(record=True):
                loaded = pysas.load(path)
        except (ValueError, OSError) as error:
            outcomes["error"] += 1
            assert str(path) in str(error) or str(target) in str(error), error
            continue
        outcomes["same" if same(loaded, expected) else "other"] += 1
        assert isinstance(loaded, pysas.Echoes)
    assert outcomes["error"] >= 25, outcomes
    if checked:
        assert outcomes["other"] == 0, outcomes
    if suffix != ".json" and not text:  # and with the sum that pysas' own writer gives no other numbers come through
        arrays.FORMAT.write(str(tmp_path / "own.json"), expected, True)
        own = tmp_path / "own.data.npy"
        whole = own.read_bytes()
        for content in mutated(whole, random.Random(8), 50):
            own.write_bytes(content)
            try:
                assert same(pysas.load(tmp_path / "own.json").data, expected.data)
            except (ValueError, OSError) as error:
                assert "own." in str(error)
