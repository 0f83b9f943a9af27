"""Files: round trips, what a broken or hostile file does, and what a failing write leaves behind."""

from __future__ import annotations

import importlib
import io as streams
import json
import os
import re
import stat
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import pysas
from pysas.formats import io
from pysas.model.echoes import Beam, Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.model.pulse import LFM

pytestmark = pytest.mark.reference  # no engine takes part

SUFFIXES = (".npz", ".h5")


def survey(flat: bool = False, dtype: str = "<c8", **changes: Any) -> Echoes:
    rng = np.random.default_rng(5)
    shape = (4, 12) if flat else (4, 2, 12)
    data = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)
    fields: dict[str, Any] = {
        "fs": 40e3, "fc": 1e5, "tx": rng.standard_normal((4, 3)), "rx": rng.standard_normal((*shape[:-1], 3)), "c": 1490.5,
        "t0": np.linspace(0.01, 0.02, 4), "velocity": rng.standard_normal((*shape[:-1], 3)), "compressed": False,
        "pulse": LFM(1e5, -3e4, 2e-3, "tukey", 0.2), "beam": Beam((0.0, 1.0, -0.3), 0.05, 0.4),
        "ping_time": np.arange(4.0), "attrs": {"title": "tøst", "list": [1, 2.5, None, True], "deep": {"a": "b"}},
    }  # fmt: skip
    return Echoes(data, **(fields | changes))


def same(a: Any, b: Any) -> bool:
    """Equal in type, dtype and every bit."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, Echoes | Image | Grid | Beam):
        return type(a) is type(b) and same(dict(vars(a)), dict(vars(b)))
    return bool(type(a) is type(b) and a == b)


ECHOES: dict[str, Callable[[], Echoes]] = {
    "everything": survey,
    "two dimensions": lambda: survey(flat=True),
    "complex128": lambda: survey(dtype="<c16"),
    "big-endian": lambda: survey(dtype=">c8"),
    "velocity of the ping, beam of the ping": lambda: survey(
        velocity=np.ones((4, 3)), beam=Beam(np.tile([0.0, 2.0, 0.1], (4, 1)), 0.1, 1.0)
    ),
    "speeds and windows of pings": lambda: survey(
        c=np.linspace(1490, 1500, 4), valid=np.array([[0, 11], [3, 9], [5, 4], [0, -1]])
    ),
    "windows of traces": lambda: survey(valid=np.tile([[0, 7], [2, 11]], (4, 1, 1))),
    "two dimensions, windows": lambda: survey(flat=True, c=np.full(4, 1500.0), valid=np.tile([1, 7], (4, 1))),
    "cone, taper": lambda: survey(beam=Beam((0.0, 1.0, -0.3), 0.05, 2.4, "cone", 0.3)),
    "axis of the array": lambda: survey(beam=Beam(np.tile([0.0, 2.0, 0.1], (4, 1)), 0.1, 1.0, taper=1.0, axis=(1.0, 0.2, 0.0))),
    "axis of the ping": lambda: survey(beam=Beam((0.0, 0.0, -1.0), 0.1, 1.0, axis=np.tile([1.0, 0.1, 0.0], (4, 1)))),
    "least": lambda: survey(
        velocity=None, compressed=True, pulse=None, beam=None, ping_time=None, attrs=None, t0=0.5, bandwidth=None
    ),
    "sampled pulse": lambda: survey(pulse=np.exp(1j * np.arange(5.0)).astype(np.complex64)),
    "rect": lambda: survey(pulse=LFM(9e4, 2e4, 1e-3)),
    "gaussian": lambda: survey(pulse=LFM(9e4, 2e4, 1e-3, "gaussian", 2e-4)),
    "own bandwidth": lambda: survey(bandwidth=12345.0),
    "truth": lambda: survey(
        attrs={"title": "x", "truth_position": np.arange(6.0).reshape(2, 3), "truth_amplitude": np.array([1.0, 0.5])}
    ),
    "complex truth": lambda: survey(attrs={"truth_position": np.zeros((1, 3)), "truth_amplitude": np.array([1j])}),
    "no targets": lambda: survey(attrs={"truth_position": np.zeros((0, 3)), "truth_amplitude": np.zeros(0)}),
    "long attrs": lambda: survey(attrs={"text": "ü" * 70_000}),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("case", ECHOES)
def test_echoes_come_back_bit_for_bit(case: str, suffix: str, tmp_path: Path) -> None:
    echoes = ECHOES[case]()
    path = tmp_path / f"survey{suffix}"
    io.save(path, echoes)
    assert same(io.load(str(path)), echoes)
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


def test_strided_and_read_only_samples_are_written(tmp_path: Path) -> None:
    wide = np.asfortranarray(survey(dtype="<c16").data)[:, ::-1, ::2]
    wide.flags.writeable = False
    for suffix in SUFFIXES:
        io.save(tmp_path / f"a{suffix}", survey().replace(data=wide))
        loaded = io.load(tmp_path / f"a{suffix}")
        assert np.array_equal(loaded.data, wide)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_non_finite_samples_are_kept(suffix: str, tmp_path: Path) -> None:
    data = survey().data.copy()
    data[1, 0, 3], data[2, 1, 0] = np.nan, np.inf
    io.save(tmp_path / f"a{suffix}", survey().replace(data=data))
    assert same(io.load(tmp_path / f"a{suffix}").data, data)


def images() -> dict[str, Image]:
    mask = np.arange(12).reshape(3, 4) % 2 == 0
    x, y = np.array([0.0, 1.0, 3.0, 4.0]), np.array([5.0, 4.0, 3.0])
    grids = {
        "plane": Grid.plane(x, y, z=-2.5),
        "masked plane": Grid.plane(x, y, mask=mask),
        "polar": Grid.polar(x, y, centre=(5e6, 1.0, -2.0), mask=mask),
        "surface": Grid.surface(x, y, np.arange(12.0).reshape(3, 4)),
        "volume": Grid.volume(x, y, np.array([1.0, 2.0]), mask=np.ones((2, 3, 4), dtype=bool)),
        "points": Grid.points(np.arange(18.0).reshape(2, 3, 3)),
        "masked points": Grid.points(np.arange(6.0).reshape(2, 3), mask=np.array([True, False])),
    }
    report = Report(
        "backprojection", tol=1e-3, backend="numba", isa="avx2", threads=2, prepare_seconds=0.1, sum_seconds=0.2, terms=7,
        share_left_out=0.25, predicted_error=9e-4, choices={"degree": 3, "errors": {"rounding": 1e-7}}, notes=("one", "two"),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    return {
        name: Image(rng.integers(-99, 99, grid.shape) * (1 - 2j), grid, report, fc=1e5, c=1500.0)
        for name, grid in grids.items()
    }


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("case", images())
def test_images_come_back_bit_for_bit(case: str, suffix: str, tmp_path: Path) -> None:
    image = images()[case]
    io.save(tmp_path / f"image{suffix}", image)
    loaded = io.load(tmp_path / f"image{suffix}")
    assert isinstance(loaded, Image) and loaded.report == image.report
    assert same(loaded, image)


def test_numpy_entries_of_attrs_become_plain(tmp_path: Path) -> None:
    io.save(tmp_path / "a.npz", survey(attrs={"n": np.int64(3), "v": np.arange(3), "t": (1, 2)}))
    assert io.load(tmp_path / "a.npz").attrs == {"n": 3, "v": [0, 1, 2], "t": [1, 2]}


@pytest.mark.parametrize(
    ("attrs", "message"),
    [
        ({"deep": {"x": [object()]}}, r"attrs\['deep'\]\['x'\]\[0\]: found object"),
        ({"z": 1j}, r"attrs\['z'\]: found complex"),
        ({"deep": {1: 2}}, r"attrs\['deep'\]: found key 1, expected strings"),
        (
            {"truth_position": np.zeros((2, 3)), "truth_amplitude": np.zeros(3)},
            r"truth_amplitude.*found float64 of shape \(3,\)",
        ),
        ({"truth_position": np.zeros((2, 2)), "truth_amplitude": np.zeros(2)}, r"truth_position.*expected shape \(n, 3\)"),
    ],
)
def test_attrs_that_a_file_cannot_hold(attrs: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        io.save(tmp_path / "a.npz", survey(attrs=attrs))
    assert not list(tmp_path.iterdir())


def test_wrong_arguments(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"ndarray: expected pysas\.Echoes or pysas\.Image"):
        io.save(tmp_path / "a.npz", np.zeros(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"a\.mat: found suffix '\.mat', expected \.npz or \.h5"):
        io.save(tmp_path / "a.mat", survey())
    with pytest.raises(ValueError, match=r"a: found suffix ''"):
        io.load(tmp_path / "a")
    for suffix in SUFFIXES:
        with pytest.raises(FileNotFoundError, match="none"):
            io.load(tmp_path / f"none{suffix}")


def test_hdf5_without_h5py_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "a.h5").write_bytes(b"")
    with pytest.raises(ImportError, match=r"pysas-sonar\[hdf5\]"):
        io.save(tmp_path / "b.h5", survey())
    with pytest.raises(ImportError, match=r"pysas-sonar\[hdf5\]"):
        io.load(tmp_path / "a.h5")
    assert [item.name for item in tmp_path.iterdir()] == ["a.h5"]


@pytest.mark.parametrize(("name", "shape"), [("stripmap_perturbed", (87, 6, 2120)), ("circular", (420, 4, 700))])
def test_files_of_others(name: str, shape: tuple[int, ...], data_dir: Path) -> None:
    echoes = io.load(data_dir / f"{name}.npz")
    assert isinstance(echoes, Echoes) and echoes.data.shape == shape  # sizes: README of the data
    assert echoes.pulse == LFM(1e5, 3e4, 2e-3, "tukey", 0.1)
    assert echoes.attrs["truth_position"].shape == (echoes.attrs["targets"], 3)


def test_a_file_of_another_kind_is_named(data_dir: Path) -> None:
    with pytest.raises(ValueError, match=r"gotcha_phase_history\.npz: schema: missing"):
        io.load(data_dir / "gotcha_phase_history.npz")


# Files that break the schema


def contents(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return dict(file)


def written(suffix: str, tmp_path: Path, fields: dict[str, Any]) -> Path:
    """A file with the given fields, made without pysas."""
    path = tmp_path / f"broken{suffix}"
    if suffix == ".npz":
        np.savez(path, **fields)
    else:
        with h5py.File(path, "w") as file:
            for name, value in fields.items():
                file[name] = str(value) if np.asarray(value).dtype.kind == "U" else value
    return path


BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "no schema": ({"schema": None}, "schema: missing"),
    "another schema": ({"schema": "pysas-echoes-9"}, "schema: found 'pysas-echoes-9', expected 'pysas-echoes-1' or"),
    "no data": ({"data": None}, "data: missing, expected complex64 or complex128"),
    "no tx": ({"tx": None}, "tx: missing, expected float64"),
    "real data": ({"data": np.zeros((4, 2, 12))}, "data: found float64 .*expected complex64 or complex128"),
    "whole fs": ({"fs": np.int64(40000)}, r"fs: found int64 of shape \(\), expected float64"),
    "single rx": ({"rx": np.zeros((4, 2, 3), dtype=np.float32)}, "rx: found float32 .*expected float64"),
    "one ping less": ({"tx": np.zeros((3, 3))}, r"tx: found shape \(3, 3\), expected \(ping=4, 3\)"),
    "one channel more": ({"rx": np.zeros((4, 3, 3))}, r"rx: found shape \(4, 3, 3\), expected \(ping=4, channel=2, 3\)"),
    "rx without channels": ({"rx": np.zeros((4, 3))}, r"rx: found shape \(4, 3\), expected \(ping=4, channel=2, 3\)"),
    "no pings": ({"data": np.zeros((0, 2, 12), dtype=np.complex64)}, r"t0: found shape \(4,\), expected \(\) or \(ping=0,\)"),
    "many dimensions": ({"data": np.zeros((4, 2, 3, 4), dtype=np.complex64)}, r"data: found shape \(4, 2, 3, 4\)"),
    "t0 of the wrong length": ({"t0": np.zeros(5)}, r"t0: found shape \(5,\), expected \(\) or \(ping=4,\)"),
    "c of the wrong length": ({"c": np.zeros(5)}, r"c: found shape \(5,\), expected \(\) or \(ping=4,\)"),
    "a speed below zero": ({"c": np.array([1500.0, 1500.0, -1.0, 1500.0])}, "c: -1 at ping 2: expected numbers > 0"),
    "real windows": ({"valid": np.zeros((4, 2))}, r"valid: found float64 of shape \(4, 2\), expected int64 or int32"),
    "windows of other pings": ({"valid": np.zeros((3, 2), int)}, r"valid: found shape \(3, 2\), expected \(ping=4, 2\) or"),
    "windows of other channels": ({"valid": np.zeros((4, 3, 2), int)}, r"valid: found shape \(4, 3, 2\), .*channel=2, 2\)"),
    "windows beyond": ({"valid": np.tile([0, 12], (4, 1))}, "valid: samples 0 to 12 at ping 0: expected .* <= last <= 11"),
    "text for fs": ({"fs": "fast"}, "fs: found .*expected float64"),
    "number for attrs": ({"attrs": np.float64(1)}, "attrs: found float64 .*expected a string"),
    "attrs no JSON": ({"attrs": "{"}, "attrs: found no JSON"),
    "attrs a list": ({"attrs": "[1]"}, "attrs: found JSON list, expected an object"),
    "attrs deep": ({"attrs": "[" * 100_000}, "attrs: found no JSON"),
    "compressed a number": ({"compressed": np.float64(0)}, "compressed: found float64 .*expected bool"),
    "another pulse": ({"pulse_kind": "cw"}, "pulse_kind: found 'cw', expected 'lfm'"),
    "half a pulse": ({"pulse_duration": None}, "pulse_duration: missing, expected beside pulse_kind"),
    "two pulses": ({"waveform": np.ones(3, dtype=np.complex64)}, "waveform: found beside pulse_kind"),
    "pulse window": ({"pulse_window": "boxcar"}, "pulse: window='boxcar'"),
    "half a beam": ({"beam_length": None}, "beam_length: missing, expected beside beam_boresight"),
    "half a truth": ({"truth_position": np.zeros((1, 3))}, "truth_amplitude: missing, expected beside truth_position"),
    "truth unequal": (
        {"truth_position": np.zeros((2, 3)), "truth_amplitude": np.zeros(3)}, r"truth_amplitude: found shape \(3,\).*target=2",
    ),
    "navigation not finite": ({"tx": np.full((4, 3), np.nan)}, "tx: nan at ping 0"),
    "negative rate": ({"fs": np.float64(-1.0)}, r"fs=-1\.0: expected a finite number > 0"),
    "infinite t0": ({"t0": np.float64(np.inf)}, "t0=inf"),
    "wide angle": ({"beam_half_angle": np.float64(4.0)}, "beam: half_angle=4.0: expected radians"),
    "a cone's angle for a fan": ({"beam_half_angle": np.float64(2.0)}, r"beam: half_angle=2.0: expected .* for a fan"),
    "another shape": ({"beam_shape": "square" * 99}, "beam_shape: found 'squaresquare.*, expected 'fan' or 'cone'"),
    "shape a number": ({"beam_shape": np.float64(2)}, "beam_shape: found float64 .*expected a string"),
    "taper above 1": ({"beam_taper": np.float64(1.5)}, "beam: taper=1.5: expected a share"),
    "taper not a number": ({"beam_taper": np.float64(np.nan)}, "beam: taper=nan"),
    "tapers": ({"beam_taper": np.zeros(4)}, r"beam_taper: found shape \(4,\), expected \(\)"),
    "axis along boresight": ({"beam_axis": np.array([0.0, 2.0, -0.6])}, "beam: axis=.*along boresight"),
    "axis of no length": ({"beam_axis": np.zeros(3)}, "beam: axis=.*expected non-zero vectors"),
    "axis not finite": ({"beam_axis": np.array([1.0, np.inf, 0.0])}, "beam: axis: inf"),
    "axes of other pings": ({"beam_axis": np.ones((3, 3))}, r"beam_axis: found shape \(3, 3\), .*ping=4"),
    "axis of a cone": ({"beam_axis": np.array([1.0, 0, 0]), "beam_shape": "cone"}, "beam: axis=.*expected None for a cone"),
    "a shape alone": (
        {"beam_boresight": None, "beam_length": None, "beam_half_angle": None, "beam_taper": None},
        "beam_boresight: missing, expected beside beam_shape",
    ),
}  # fmt: skip


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_schema_is_one_error_that_names_the_file(case: str, suffix: str, tmp_path: Path) -> None:
    change, message = BROKEN[case]
    io.save(tmp_path / "good.npz", survey())
    fields = {name: value for name, value in (contents(tmp_path / "good.npz") | change).items() if value is not None}
    path = written(suffix, tmp_path, fields)
    with pytest.raises(ValueError, match=rf"{re.escape(str(path))}: {message}") as caught:
        io.load(path)
    assert type(caught.value) is ValueError and len(str(caught.value)) < 400


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_older_files_beam_is_a_cone_with_a_hard_edge(suffix: str, tmp_path: Path) -> None:
    """Before beams had a shape and a taper there was no other."""
    io.save(tmp_path / "good.npz", survey(beam=Beam((0.0, 1.0, -0.3), 0.05, 2.5, "cone")))
    fields = contents(tmp_path / "good.npz")
    assert fields["beam_shape"] == "cone" and fields["beam_taper"] == 0 and "beam_axis" not in fields
    older = {name: value for name, value in fields.items() if name not in ("beam_shape", "beam_taper")}
    loaded = io.load(written(suffix, tmp_path, older))
    assert same(loaded, survey(beam=Beam((0.0, 1.0, -0.3), 0.05, 2.5, "cone", 0.0)))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid_kind": "cube"}, "grid_kind: found 'cube', expected one of plane"),
        ({"grid_x": None}, "grid_x: missing"),
        ({"grid_height": None}, "grid_height: missing"),
        ({"grid_x": np.zeros(5)}, r"grid_x: found shape \(5,\), expected \(x=4,\)"),
        ({"grid_mask": np.zeros((2, 4), dtype=bool)}, r"grid_mask: found shape \(2, 4\), expected \(y=3, x=4\)"),
        ({"grid_mask": np.zeros((3, 4))}, "grid_mask: found float64"),
        ({"grid_y": np.array([0.0, np.inf, 1.0])}, "y: inf"),
        ({"report": '{"tol": 1}'}, "report: found"),
        ({"report": None}, "report: missing"),
        ({"data": np.zeros((4, 3), dtype=np.complex64)}, r"grid_x: found shape \(4,\), expected \(x=3,\)"),
    ],
)
def test_a_broken_image(change: dict[str, Any], message: str, suffix: str, tmp_path: Path) -> None:
    io.save(tmp_path / "good.npz", images()["plane"])
    fields = {name: value for name, value in (contents(tmp_path / "good.npz") | change).items() if value is not None}
    path = written(suffix, tmp_path, fields)
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}: {message}"):
        io.load(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_fields_that_the_schema_does_not_know_are_reported(suffix: str, tmp_path: Path) -> None:
    io.save(tmp_path / "good.npz", survey())
    path = written(suffix, tmp_path, contents(tmp_path / "good.npz") | {"velocitys": np.ones((4, 3))})
    with pytest.warns(UserWarning, match="ignored, not in pysas-echoes-1: velocitys"):
        loaded = io.load(path)
    assert same(loaded, survey())


def test_python_objects_are_refused(tmp_path: Path) -> None:
    io.save(tmp_path / "good.npz", survey())
    for name in ("data", "attrs", "extra"):
        path = written(".npz", tmp_path, contents(tmp_path / "good.npz") | {name: np.array([{"a": 1}], dtype=object)})
        with pytest.raises(ValueError, match=f"{name}: damaged or not .npy .*found object"):
            io.load(path)


# Sizes that are not true


def member(shape: tuple[int, ...], dtype: str, body: bytes) -> bytes:
    stream = streams.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue() + body


def npz_with(tmp_path: Path, content: bytes, method: int = zipfile.ZIP_STORED) -> Path:
    """A good file whose data are replaced by `content`."""
    io.save(tmp_path / "good.npz", survey())
    path = tmp_path / "sizes.npz"
    with zipfile.ZipFile(tmp_path / "good.npz") as good, zipfile.ZipFile(path, "w") as archive:
        for info in good.infolist():
            if info.filename != "data.npy":
                archive.writestr(info.filename, good.read(info))
        archive.writestr("data.npy", content, method)
    return path


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (member((4, 2, 10**12), "<c8", b"x" * 64), r"data: .*in 64 bytes, expected 64000000000000 bytes"),
        (member((4, 2, 12), "<c8", b"x" * 767), "in 767 bytes, expected 768 bytes"),
        (member((4, 2, 12), "<c8", b"x" * 769), "in 769 bytes, expected 768 bytes"),
        (member((2**62, 2**62, 2**62), "<c8", b"x"), "expected"),
        (member((-4, -2, 12), "<c8", b"x" * 768), "data: damaged"),
        (b"\x93NUMPY\x01\x00\xff\xff{", "data: damaged"),
        (b"\x93NUMPY\x01\x00\x0a\x00" + b"(" * 10, "data: damaged"),
        (b"no array at all", "data: damaged"),
        (b"", "data: damaged"),
    ],
)
def test_declared_sizes_are_compared_before_anything_is_allocated(content: bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        io.load(npz_with(tmp_path, content))


def test_a_deflated_file_is_read(tmp_path: Path) -> None:
    io.save(tmp_path / "good.npz", survey())
    np.savez_compressed(tmp_path / "small.npz", **contents(tmp_path / "good.npz"))
    assert same(io.load(tmp_path / "small.npz"), survey())


def test_unusual_compression_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="data: damaged .*expected a stored or deflated one"):
        io.load(npz_with(tmp_path, member((4, 2, 12), "<c8", bytes(768)), zipfile.ZIP_LZMA))


def test_a_size_that_deflate_cannot_reach_is_refused(tmp_path: Path) -> None:
    """The central directory claims a terabyte of zeros in a few bytes."""
    path = npz_with(tmp_path, member((4, 2, 12), "<c8", bytes(768)), zipfile.ZIP_DEFLATED)
    raw = bytearray(path.read_bytes())
    entry = raw.rindex(b"data.npy") - 46
    raw[entry + 24 : entry + 28] = (2**31).to_bytes(4, "little")  # uncompressed size: APPNOTE.TXT 4.3.12
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=f"data: damaged .*found {2**31} bytes declared"):
        io.load(path)


def test_a_member_twice_is_refused(tmp_path: Path) -> None:
    path = npz_with(tmp_path, member((4, 2, 12), "<c8", bytes(768)))
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("tx.npy", member((4, 3), "<f8", bytes(96)))
    with pytest.raises(ValueError, match="tx: found twice"):
        io.load(path)


def h5_with(tmp_path: Path, replace: Callable[[h5py.File], None], field: str = "data") -> Path:
    """A good file whose `field` is made by `replace`."""
    io.save(tmp_path / "good.npz", survey())
    path = written(".h5", tmp_path, contents(tmp_path / "good.npz"))
    with h5py.File(path, "a") as file:
        del file[field]
        replace(file)
    return path


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(4, 2, 12), dtype="<c8")
    layout[...] = h5py.VirtualSource("other.h5", "data", shape=(4, 2, 12))
    file.create_virtual_dataset("data", layout)


HOSTILE: dict[str, tuple[Callable[[h5py.File], Any], str]] = {
    "external link": (lambda f: f.__setitem__("data", h5py.ExternalLink("other.h5", "/x")), "data: found a link"),
    "soft link": (lambda f: f.__setitem__("data", h5py.SoftLink("/tx")), "data: found a link"),
    "virtual": (virtual, "data: found samples kept in other files"),
    "external storage": (
        lambda f: f.create_dataset("data", (4, 2, 12), "<c8", external=[("other.bin", 0, 768)]),
        "data: found samples kept in other files",
    ),
    "nothing stored": (
        lambda f: f.create_dataset("data", (4, 2, 10**13), "<c8", chunks=(4, 2, 100)),
        "data: found 640000000000000 bytes declared",
    ),
    "chunks missing": (
        lambda f: f.create_dataset("data", (4, 2, 1200), "<c8", chunks=(4, 2, 12), compression="gzip").__setitem__(
            (slice(0, 1), slice(0, 1), slice(0, 12)), 1
        ),
        "data: found ",
    ),
    "a group": (lambda f: f.create_group("data"), r"data: found shape \(0,\)|data: found object"),
    "no value": (lambda f: f.create_dataset("data", data=h5py.Empty("f8")), "data: found object"),
    "ragged": (lambda f: f.create_dataset("data", (4,), h5py.vlen_dtype(np.float64)), "data: found"),
    "references": (lambda f: f.create_dataset("data", (4,), h5py.ref_dtype), "data: found"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_what_hdf5_can_hide_is_refused(case: str, tmp_path: Path) -> None:
    make, message = HOSTILE[case]
    path = h5_with(tmp_path, make)
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}: ({message})"):
        io.load(path)


# Damage


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_parts_that_became_zero_or_changed_places_are_noticed(suffix: str, tmp_path: Path) -> None:
    """As where a disk loses what it was given, or a copy is left sparse: whole blocks of zeros satisfy Fletcher-32."""
    rng = np.random.default_rng(11)
    data = (rng.standard_normal((4, 2, 2500, 2)).view(complex)[..., 0]).astype(np.complex64)
    image = images()["masked plane"]
    for number, item in enumerate((survey().replace(data=data), image)):
        source, path = tmp_path / f"source{suffix}", tmp_path / f"damaged{suffix}"
        io.save(source, item)
        original = source.read_bytes()
        size = 4096 if number == 0 else 256
        starts = [*range(0, len(original), size), *rng.integers(0, len(original), 20).tolist()]
        samples = item.data.tobytes()
        spans = [(start, start + size) for start in starts]
        spans.append((original.index(samples), original.index(samples) + len(samples)))
        changed = 0
        for first, last in spans:
            raw = bytearray(original)
            raw[first:last] = bytes(len(raw[first:last]))
            other = bytearray(original)
            second = int(rng.integers(0, len(original) - size))
            if abs(second - first) >= size and first + size <= len(original):
                other[first : first + size], other[second : second + size] = (
                    original[second : second + size], original[first : first + size],
                )  # fmt: skip
            for damaged in (raw, other):
                path.unlink(missing_ok=True)
                path.write_bytes(damaged)
                try:
                    assert same(io.load(path), item)
                except ValueError as error:
                    changed += 1
                    assert str(path) in str(error)
        assert changed >= len(spans)


def test_hdf5_files_without_checksums_of_arrays_are_read(tmp_path: Path) -> None:
    """As other programs write them, in chunks with Fletcher-32 or without."""
    io.save(tmp_path / "good.npz", survey())
    fields = contents(tmp_path / "good.npz")
    for options in ({}, {"chunks": True, "fletcher32": True}, {"compression": "gzip", "shuffle": True}):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            for name, value in fields.items():
                array = value if value.dtype.kind != "U" else str(value)
                file.create_dataset(name, data=array, **(options if value.ndim else {}))
        assert same(io.load(tmp_path / "a.h5"), survey())


def test_a_checksum_of_another_kind_is_refused(tmp_path: Path) -> None:
    for value in (np.float64(1), np.arange(3), "x", np.int64(5)):
        io.save(tmp_path / "a.h5", survey())
        with h5py.File(tmp_path / "a.h5", "a") as file:
            del file["data"].attrs["crc32"]
            file["data"].attrs["crc32"] = value
        with pytest.raises(ValueError, match="data: damaged .*for crc32"):
            io.load(tmp_path / "a.h5")


MUTATE = """
import json, os, sys, warnings
from pathlib import Path
import numpy as np
from pysas.formats import io

source, count, folder = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
original, good = source.read_bytes(), io.load(source)
rng = np.random.default_rng(7)

def values(item):
    found = {}
    for name, value in vars(item).items():
        if name in ("pulse", "report"):
            found[name] = np.frombuffer(repr(value).encode(), np.uint8)
        elif hasattr(value, "__dataclass_fields__"):
            found |= {f"{name}.{key}": part for key, part in values(value).items()}
        elif isinstance(value, dict):
            found |= {f"{name}.{key}": np.asarray(part) for key, part in value.items()}
        elif value is not None:
            found[name] = np.asarray(value)
    return found

def swapped(path):
    names = {}
    if source.suffix == ".npz":
        with np.load(source) as file:
            names = dict(file)
    else:
        import h5py
        with h5py.File(source) as file:
            names = {name: item[()] for name, item in file.items()}
        names = {name: value.decode() if isinstance(value, bytes) else value for name, value in names.items()}
    name = str(rng.choice(sorted(names)))
    array = np.asarray(names[name])
    other = np.dtype(str(rng.choice(["<f4", "<f8", ">f8", "<i8", "<u8", "<c8", "<c16", "|b1", "<i2", "<f2"])))
    if array.dtype.kind == "U":
        names[name] = np.zeros((), other)
    elif array.dtype.itemsize == other.itemsize and rng.random() < 0.5:
        names[name] = array.view(other.newbyteorder("=")) if array.dtype.byteorder != "|" else array
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            names[name] = array.astype(other)
    if source.suffix == ".npz":
        np.savez(path, **names)
    else:
        with h5py.File(path, "w") as file:
            for key, value in names.items():
                file[key] = str(value) if np.asarray(value).dtype.kind in "UO" else value

outcome = {"refused": 0, "same": 0, "wrong": []}
wanted = values(good)
for number in range(count):
    path = folder / f"mutated{source.suffix}"
    kind = ("flip", "flip", "burst", "cut", "swap", "zeros", "ones", "out", "in", "copy")[number % 10]
    raw = bytearray(original)
    if kind == "flip":
        raw[rng.integers(len(raw))] ^= 1 << rng.integers(8)
    elif kind == "burst":
        start = rng.integers(len(raw))
        for place in range(start, min(start + 1 + rng.integers(16), len(raw))):
            raw[place] = rng.integers(256)
    elif kind == "cut":
        del raw[rng.integers(len(raw)):]
    elif kind in ("zeros", "ones"):
        start, length = rng.integers(len(raw)), rng.integers(1, 64)
        raw[start:start + length] = bytes([0 if kind == "zeros" else 255]) * len(raw[start:start + length])
    elif kind == "out":
        start, end = sorted(rng.integers(0, len(raw), 2))
        del raw[start:end]
    elif kind == "in":
        start = rng.integers(len(raw))
        raw[start:start] = rng.bytes(rng.integers(1, 100))
    elif kind == "copy":
        start, source_start, length = *rng.integers(0, len(raw), 2), rng.integers(1, 200)
        raw[start:start + length] = raw[source_start:source_start + length]
    path.unlink(missing_ok=True)
    swapped(path) if kind == "swap" else path.write_bytes(raw)
    try:
        found = values(io.load(path))
    except (ValueError, OSError) as error:
        outcome["refused"] += 1
        assert type(error) is ValueError and str(path) in str(error), repr(error)
        continue
    if found.keys() == wanted.keys() and all(np.array_equal(found[key], wanted[key]) for key in wanted):
        outcome["same"] += 1
    else:
        outcome["wrong"].append([number, kind])
print(json.dumps(outcome))
"""


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("what", ["echoes", "image"])
def test_mutated_copies_are_refused_or_hold_the_same(what: str, suffix: str, tmp_path: Path) -> None:
    """In a subprocess: a crash is a failure here too."""
    truth = {"truth_position": np.zeros((2, 3)), "truth_amplitude": np.ones(2)}
    source = tmp_path / f"source{suffix}"
    io.save(source, survey(attrs={"title": "x"} | truth) if what == "echoes" else images()["masked plane"])
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(MUTATE), str(source), "200", str(tmp_path)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    outcome = json.loads(run.stdout)
    assert outcome["wrong"] == []
    assert outcome["refused"] >= 100  # the rest hit slack such as dates, or are the same values in another dtype


# Writing


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    failure: BaseException, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"survey{suffix}"
    io.save(path, survey())
    before = path.read_bytes()

    def fail(*_: Any) -> None:
        raise failure

    monkeypatch.setattr(os, "fsync", fail)
    for target in (path, tmp_path / f"new{suffix}"):
        with pytest.raises(type(failure)):
            io.save(target, survey().replace(c=1400.0))
    assert path.read_bytes() == before
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failure_in_the_middle_of_a_write(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"survey{suffix}"
    io.save(path, survey())
    before = path.read_bytes()
    fields: Callable[[Echoes], dict[str, np.ndarray]] = io.echo_fields
    bad = np.array([object()])
    monkeypatch.setattr(io, "echo_fields", lambda echoes: fields(echoes) | {"zz": bad})
    with pytest.raises((ValueError, TypeError)):
        io.save(path, survey())
    assert path.read_bytes() == before
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


FILL = """
import resource, sys
from pathlib import Path
import numpy as np
from pysas.formats import io
from pysas.model.echoes import Echoes
path = Path(sys.argv[1])
echoes = Echoes(np.ones((8, 100_000), np.complex64), fs=1.0, fc=1.0, tx=np.zeros((8, 3)), rx=np.zeros((8, 3)))
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    io.save(path, echoes)
except OSError:
    print(sorted(item.name for item in path.parent.iterdir()))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files there")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_that_cannot_grow(suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"old{suffix}").write_bytes(b"old")
    command = [sys.executable, "-c", FILL, str(tmp_path / f"old{suffix}")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert run.stdout.strip() == f"['old{suffix}']", run.stderr
    assert (tmp_path / f"old{suffix}").read_bytes() == b"old"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_folders_that_take_no_file(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such folder"):
        io.save(tmp_path / "none" / f"a{suffix}", survey())
    assert not list(tmp_path.iterdir())
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(ValueError, match="expected a regular file or a new name"):
        io.save(tmp_path / f"folder{suffix}", survey())
    with pytest.raises(OSError):
        io.load(tmp_path / f"folder{suffix}")
    if sys.platform != "win32" and os.geteuid() != 0:  # root may write anywhere
        locked = tmp_path / "locked"
        locked.mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
        with pytest.raises(OSError):
            io.save(locked / f"a{suffix}", survey())
        assert not list(locked.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    io.save(tmp_path / "a.npz", survey())
    (tmp_path / "link.npz").symlink_to("a.npz")
    io.save(tmp_path / "link.npz", survey(c=1400.0))
    assert (tmp_path / "link.npz").is_symlink()
    assert io.load(tmp_path / "a.npz").c == 1400.0


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f4", ">f8"])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_real_and_imaginary_parts_along_a_last_axis_are_samples(suffix: str, kind: str, order: Any, tmp_path: Path) -> None:
    """As MATLAB and netCDF write what they have no complex type for."""
    echoes = survey(pulse=np.ones(5, np.complex64), dtype=kind.replace("f4", "c8").replace("f8", "c16"))
    io.save(tmp_path / f"whole{suffix}", echoes)
    fields: dict[str, Any] = {}
    if suffix == ".npz":
        with np.load(tmp_path / "whole.npz") as whole:
            fields = dict(whole)
    else:
        with h5py.File(tmp_path / "whole.h5") as whole:
            fields = {name: item[()] for name, item in whole.items()}
    parts = np.stack([echoes.data.real, echoes.data.imag], axis=-1)
    fields |= {"data": np.asarray(parts, dtype=kind, order=order), "waveform": np.tile([1.0, 0.0], (5, 1))}
    path = tmp_path / f"parts{suffix}"
    if suffix == ".npz":
        np.savez(path, **fields)
    else:
        with h5py.File(path, "w") as made:
            for name, value in fields.items():
                made[name] = value
    found = pysas.load_echoes(path)
    assert np.array_equal(found.data, echoes.data) and found.data.dtype == np.dtype(
        kind.replace("f4", "c8").replace("f8", "c16")
    )
    assert np.array_equal(found.pulse, np.ones(5))
    fields["data"] = parts[..., :1]
    if suffix == ".npz":
        np.savez(path, **fields)
        with pytest.raises(ValueError, match="data: found float"):
            io.load(path)


def test_complex_samples_are_the_compound_that_others_take_for_complex(tmp_path: Path) -> None:
    """h5py's documentation: "complex numbers are represented as compound types with fields r and i"."""
    io.save(tmp_path / "a.h5", survey())
    with h5py.File(tmp_path / "a.h5") as file:
        kind = file["data"].id.get_type()
        assert [kind.get_member_name(i) for i in range(kind.get_nmembers())] == [b"r", b"i"]
        assert kind.get_member_type(0).get_size() == 4 and kind.get_size() == 8


def test_files_open_as_netcdf(tmp_path: Path) -> None:
    netcdf = importlib.import_module("netCDF4")
    echoes = survey()
    io.save(tmp_path / "a.h5", echoes)
    with netcdf.Dataset(tmp_path / "a.h5", auto_complex=True) as file:
        assert np.array_equal(file["data"][...], echoes.data) and np.array_equal(file["tx"][...], echoes.tx)
