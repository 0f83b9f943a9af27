"""Gotcha phase history: files of its structure, what MATLAB's format can hide, and the public data where they are."""

from __future__ import annotations

import os
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from radar_mutations import mutated

import pysas
from pysas.formats.matlab_variables import read_structure

C = 299792458.0


def fields(pings: int = 12, count: int = 40, dtype: Any = np.float32, **changes: Any) -> dict[str, Any]:
    """As loadmat shows them: fp (K, pulse), columns of frequencies, rows of the rest; one point of 2 at (3, -4, 0)."""
    azimuth = np.radians(np.linspace(1.0, 2.0, pings))
    position = 7100 * np.stack([np.cos(azimuth), np.sin(azimuth), np.full(pings, 7300 / 7100)])
    position = position.astype(dtype).astype(float)
    r0 = np.linalg.norm(position, axis=0).astype(dtype).astype(float)
    freq = 9.28808e9 + 1.4715e6 * np.arange(count)
    off = np.sqrt(((np.array([3.0, -4.0, 0.0], np.longdouble)[:, None] - position) ** 2).sum(0)) - r0
    turns = 2 * freq.astype(np.longdouble)[:, None] * off / np.longdouble(C)
    found: dict[str, Any] = {
        "fp": (2 * np.exp(-2j * np.pi * (turns % 1).astype(float))).astype(np.complex64 if dtype == np.float32 else complex),
        "freq": freq[:, None].astype(dtype), "x": position[:1].astype(dtype), "y": position[1:2].astype(dtype),
        "z": position[2:].astype(dtype), "r0": r0[None].astype(dtype), "th": np.degrees(azimuth)[None].astype(dtype),
        "phi": np.full((1, pings), 45.8, dtype),
        "af": {"r_correct": np.full((1, pings), 0.25, dtype), "ph_correct": np.full((1, pings), -1.5, dtype)},
    }  # fmt: skip
    return found | changes


def saved(path: Path, values: dict[str, Any], packed: bool = False) -> Path:
    scipy.io.savemat(path, {"data": values}, do_compression=packed)
    return path


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_point_is_where_it_is(packed: bool, dtype: Any, tmp_path: Path) -> None:
    values = fields(dtype=dtype)
    echoes = pysas.load_echoes(saved(tmp_path / "a.mat", values, packed))
    expected = pysas.from_phase_history(
        values["fp"].T, values["freq"].ravel(), np.stack([values[k].ravel() for k in "xyz"], 1), values["r0"].ravel(), C
    )
    assert np.abs(echoes.data - expected.data).max() < (1e-6 if dtype == np.float32 else 1e-9)
    assert (echoes.fs, echoes.fc) == (expected.fs, expected.fc) and np.array_equal(echoes.tx, expected.tx)
    value, _ = pysas.reference.exact(echoes, pysas.Grid.points([[3.0, -4.0, 0.0]]))
    assert abs(value[0] / 12 - 2) < (4e-3 if dtype == np.float32 else 1e-4)  # float32 frequencies: up to 512 Hz off
    assert echoes.attrs["af"] == {"r_correct": [0.25] * 12, "ph_correct": [-1.5] * 12}
    half = C / 4 / 1.4715e6
    assert echoes.attrs["scene_area"]["x"] == pytest.approx([-half, half], rel=2e-5)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "real samples": ({"fp": np.ones((40, 12))}, r"data.fp: found float64 of shape \(40, 12\): expected complex"),
    "text": ({"freq": "abc"}, "data.freq: expected numbers"),
    "freq": ({"freq": np.ones((39, 1))}, r"data.freq: found shape \(39, 1\): expected 40 numbers"),
    "uneven": ({"freq": np.geomspace(9e9, 1e10, 40)[:, None]}, "freq.*equal steps"),
    "x": ({"x": np.ones((3, 4))}, r"data.x: found shape \(3, 4\): expected 12 numbers"),
    "nan": ({"z": np.full((1, 12), np.nan)}, "data.z: nan at index 0"),
    "another origin": ({"r0": np.full((1, 12), 9000.0)}, "r0: 9000 m at ping .*, .* off the distance of the origin"),
    "not finite": ({"fp": np.full((40, 12), np.inf + 0j)}, "samples: .*at ping 0"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_told(case: str, tmp_path: Path) -> None:
    changes, message = WRONG[case]
    path = saved(tmp_path / "a.mat", fields(**changes))
    with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + message):
        pysas.load(path)


def test_a_channel_is_not_asked_for(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="channel='HH': a file of format gotcha is read whole"):
        pysas.load(saved(tmp_path / "a.mat", fields()), channel="HH")


def element(kind: int, data: bytes, size: int | None = None) -> bytes:
    return struct.pack("<II", kind, len(data) if size is None else size) + data + bytes(-len(data) % 8)


def file_of(path: Path, *elements: bytes) -> Path:
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + b"".join(elements))
    return path


def test_sizes_are_not_believed(tmp_path: Path) -> None:
    """Numbers that a shape claims, an element beyond the file, names of other lengths, a kilobyte that becomes a gigabyte."""
    flags, shape, name = element(6, struct.pack("<II", 2, 0)), element(5, struct.pack("<ii", 1, 1)), element(1, b"data")
    large = element(
        14,
        element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", 30000, 30000)) + element(1, b"") + element(9, b""),
    )
    head = flags + shape + name
    size, names = struct.pack("<HHI", 5, 4, 3), element(1, b"fp\0")

    def packed(size: int) -> bytes:
        inner = zlib.compress(struct.pack("<II", 14, size) + head + bytes(10**6))
        return struct.pack("<II", 15, len(inner)) + inner

    cases = {
        "found 0 bytes of type 9 for 900000000": element(14, head + size + names + large),
        "found 0 of 4294967288 bytes": element(14, b"", 4294967288),
        "found names of 3 characters in 4": element(14, head + size + element(1, b"fp\0x") + large),
        "found 1 values of fields fp, x": element(14, head + size + element(1, b"fp\0x\0\0") + large),
        "data: found type 14 of 2000000000 bytes": packed(2000000000),
        "data: found 100001 bytes of a variable, or more": packed(100000),
        "no variable 'data'": b"",
    }
    for message, content in cases.items():
        path = file_of(tmp_path / "a.mat", content)
        with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + re.escape(message)):
            read_structure(str(path), "data")


def test_structures_within_structures_end(tmp_path: Path) -> None:
    """A thousand of them are not followed."""
    inner = element(9, b"")
    size, names = struct.pack("<HHI", 5, 4, 3), element(1, b"fp\0")
    for _ in range(1000):
        head = element(6, struct.pack("<II", 2, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"data")
        inner = element(14, head + size + names + inner)
    found: Any = read_structure(str(file_of(tmp_path / "a.mat", inner)), "data")
    for _ in range(3):
        found = found["fp"]
    assert found == {"fp": None}


def test_mutated_copies_are_refused_or_hold_the_same(tmp_path: Path) -> None:
    """What holds values has no checksum where it is not compressed: of these only a crash tells."""
    for packed in (False, True):
        source = saved(tmp_path / "source.mat", fields(), packed)
        content = source.read_bytes()
        known = fields()
        spans = [[0, 124]]
        for values in [] if packed else [*known.pop("af").values(), *known.values()]:
            parts = (values.real, values.imag) if values.dtype.kind == "c" else (values,)
            for part in parts:
                text = part.T.astype("<f4").tobytes()
                start = content.index(text)
                spans.append([start, start + len(text)])
        words = [["fp", "fq"], ["r0", "r1"], ["\x07\x00\x00\x00", "\x09\x00\x00\x00"], ["\x05\x00\x00\x00", "\x01\x00\x00\x00"]]
        outcome = mutated(source, tmp_path, spans, words)
        assert outcome["wrong"] == []
        assert outcome["refused"] >= 60


def test_measured_data_come_back(tmp_path: Path) -> None:
    """The public data, cut into files of their own structure: images of the parts add up to that of all. A bright point is as
    wide as the formulas say: 0.886 c/(2 B cos(grazing)) in range, 1.44/0.886 of it under a Hann window over frequency, and
    0.886 c/(4 f sin(half the angle) cos(grazing)) along the track."""
    folder = os.environ.get("PYSAS_DATA")
    if not folder:
        pytest.skip("PYSAS_DATA is not set")
    with np.load(Path(folder) / "gotcha_phase_history.npz") as file:
        known = dict(file)
    whole = pysas.from_phase_history(known["phase_history"], known["freq"], known["position"], known["r0"], float(known["c"]))
    grid = pysas.Grid.plane(np.arange(-17.6, -13.4, 0.1), np.arange(19.6, 23.6, 0.1))
    image = pysas.backproject(whole, grid, tol=1e-4)
    total, under_hann = np.zeros((2, *grid.shape), complex)
    for part in np.array_split(np.arange(469), 4):
        samples = known["phase_history"][part]
        values = {"fp": samples.T, "freq": known["freq"][:, None].astype("f4"), "r0": known["r0"][None, part]}
        values |= {name: known["position"][None, part, i] for i, name in enumerate("xyz")}
        echoes = pysas.load_echoes(saved(tmp_path / "a.mat", values))
        assert np.abs(echoes.data - whole.data[part]).max() < 1e-6 * np.abs(whole.data).max()
        total += pysas.backproject(echoes, grid, tol=1e-4).data
        values["fp"] = (samples * np.hanning(424)).T.astype(np.complex64)
        echoes = pysas.load_echoes(saved(tmp_path / "a.mat", values))
        under_hann += pysas.backproject(echoes, grid, tol=1e-4).data
    assert np.abs(total - image.data).max() < 5e-4 * np.abs(image.data).max()
    grazing = np.arctan2(known["position"][:, 2].mean(), np.linalg.norm(known["position"][:, :2], axis=1).mean())
    azimuth = np.ptp(np.arctan2(known["position"][:, 1], known["position"][:, 0]))
    across = 0.886 * C / (2 * np.ptp(known["freq"]) * np.cos(grazing))
    along = 0.886 * C / (4 * known["freq"].mean() * np.sin(azimuth / 2) * np.cos(grazing))
    assert (1.44 / 0.886 * across, along) == pytest.approx((0.50, 0.28), abs=0.01)  # of the data's description
    for data, expected in ((total, (across, along)), (under_hann, (1.44 / 0.886 * across, along))):
        picture = pysas.Image(data, grid, image.report, image.fc, image.c)
        peak = pysas.metrics.peak_position(picture, near=(-15.5, 21.6), radius=1.0)
        widths = [pysas.metrics.irw(*pysas.metrics.cut(picture, (peak[0], peak[1]), axis)) for axis in "xy"]
        assert widths == pytest.approx(expected, rel=0.04)
