"""Numbers from MATLAB's files: what SciPy writes, the other byte order by hand, and files that are damaged."""

from __future__ import annotations

import random
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from pysas.formats.matlab_variables import Variables, read_row
from pysas.formats.recordings import read_wav

pytestmark = pytest.mark.reference  # no engine takes part

KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?")


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("orientation", ["row", "column"])
def test_what_scipy_writes(tmp_path: Path, packed: bool, orientation: Any) -> None:
    values = {f"x{i}": np.arange(100).astype(kind) for i, kind in enumerate(KINDS)} | {
        "one": 1487.3,
        "four": np.arange(4, dtype="i1"),
    }
    more = {"text": "abc", "cell": np.array([1, "a"], object), "record": {"a": 1.0}, "large": np.ones((300, 400))}
    scipy.io.savemat(tmp_path / "a.mat", more | values, do_compression=packed, oned_as=orientation)
    for name, value in values.items():
        found = read_row(str(tmp_path / "a.mat"), name)
        assert found.dtype == np.float64
        np.testing.assert_array_equal(found, np.atleast_1d(value))


def big_endian(name: bytes, values: np.ndarray) -> bytes:
    """MATLAB's level 5 as written on a machine of the other byte order: a double array whose numbers are kept as int16."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    flags, shape = struct.pack(">II", 6, 0), struct.pack(">ii", 1, values.size)
    parts = element(6, flags) + element(5, shape) + element(1, name) + element(3, values.astype(">i2").tobytes())
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(">H", 0x0100) + b"MI" + element(14, parts)


def test_the_other_byte_order(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(big_endian(b"pulse", np.arange(-3, 4)))
    np.testing.assert_array_equal(read_row(str(tmp_path / "a.mat"), "pulse"), np.arange(-3, 4))


@pytest.mark.parametrize("packed", [False, True])
def test_variables_of_any_shape(tmp_path: Path, packed: bool) -> None:
    rng = np.random.default_rng(1)
    values = {kind: (100 * rng.random((3, 4, 5))).astype(kind) for kind in KINDS[:-1]}
    values |= {kind: (rng.random((2, 7)) - 1j * rng.random((2, 7))).astype(kind) for kind in ("c8", "c16")}
    values |= {"one": np.array([[3.5]]), "none": np.zeros((0, 3)), "row": np.arange(4.0)[None]}
    scipy.io.savemat(tmp_path / "a.mat", values | {"text": "abc", "record": {"a": 1.0}}, do_compression=packed)
    found = Variables(str(tmp_path / "a.mat"))
    for name, value in values.items():
        assert found.fields[name] == (value.shape, value.dtype)
        np.testing.assert_array_equal(found.read(name), value)
    assert found.fields["text"] == ((), np.dtype("U")) and found.read("text") == "abc"
    assert found.fields["record"] == ((0,), np.dtype(object))
    with pytest.raises(ValueError, match="record: found a cell, a struct or the like, expected numbers or text"):
        found.read("record")


def test_variables_of_the_other_byte_order(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(big_endian(b"pulse", np.arange(-3, 4)))
    found = Variables(str(tmp_path / "a.mat"))
    assert found.fields["pulse"] == ((1, 7), np.dtype("f8"))
    np.testing.assert_array_equal(found.read("pulse"), np.arange(-3.0, 4.0)[None])


@pytest.mark.parametrize("packed", [False, True])
def test_a_variable_of_more_numbers_than_bytes_is_not_described(tmp_path: Path, packed: bool) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.zeros(8)})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    content[164:168] = struct.pack("<i", 2**30)  # behind the file's header, the variable's tag, flags and its shape's tag
    if packed:
        inner = zlib.compress(bytes(content[128:]))
        content = content[:128] + struct.pack("<II", 15, len(inner)) + inner
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(ValueError, match=r"x: found shape \(1, 1073741824\) in \d+ bytes: expected a whole .mat file"):
        Variables(str(tmp_path / "a.mat"))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.ones((2, 3)), "float64 of shape (2, 3)"),
        (np.ones(3) + 1j, "complex128 of shape (1, 3)"),
        (np.zeros((0, 0)), "float64 of shape (0, 0)"),
        ("text", "text"),
        ({"a": 1.0}, "no numbers"),
    ],
)
def test_what_is_no_row_of_numbers(tmp_path: Path, value: Any, said: str) -> None:
    path = str(tmp_path / "a.mat")
    scipy.io.savemat(path, {"x": value})
    with pytest.raises(ValueError) as error:
        read_row(path, "x")
    assert f"{path}: x: found {said}: expected real numbers" in str(error.value)
    with pytest.raises(ValueError, match="no variable 'y': expected one of x"):
        read_row(path, "y")


def test_other_versions_are_told(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "4.mat", {"x": 1.0}, format="4")
    (tmp_path / "73.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM" + bytes(512))
    (tmp_path / "none.mat").write_bytes(b"")
    for name in ("4.mat", "73.mat", "none.mat"):
        with pytest.raises(ValueError, match=rf"{name}: expected a .mat file of MATLAB's versions 5 to 7"):
            read_row(str(tmp_path / name), "x")


def test_nothing_is_expanded_beyond_a_variable_s_most(tmp_path: Path) -> None:
    """400 MiB of zeros in two of them, with a shape to it: 2^24 numbers, 128 MiB, are the most."""
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.zeros(8)})
    inner = bytearray((tmp_path / "a.mat").read_bytes())
    head, matrix = inner[:128], inner[128:]
    matrix[36:40] = struct.pack("<i", 2**27)  # after the tag, flags and the shape's own tag: its second length
    packer = zlib.compressobj(1)
    packed = packer.compress(bytes(matrix)) + b"".join(packer.compress(bytes(2**20)) for _ in range(400)) + packer.flush()
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"a.mat: x: found"):
        read_row(str(tmp_path / "a.mat"), "x")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 300e6


@pytest.mark.parametrize("suffix", ["mat", "wav"])
def test_damage_is_an_error_or_other_numbers(tmp_path: Path, suffix: str) -> None:
    """Bytes changed at random: nothing but a ValueError that names the file, or as many numbers as were there."""
    path, draw = tmp_path / f"a.{suffix}", random.Random(3)
    samples = (1000 * np.sin(np.arange(60))).astype(np.int16)
    if suffix == "mat":
        scipy.io.savemat(path, {"fs": 1.0, "x": samples}, do_compression=False)
    else:
        scipy.io.wavfile.write(path, 48000, samples)
    good, failed = path.read_bytes(), 0
    for _ in range(400):
        bad = bytearray(good)
        for _ in range(draw.choice((1, 2, 4))):
            bad[draw.randrange(len(bad))] = draw.randrange(256)
        path.write_bytes(bad[: draw.choice((len(bad), draw.randrange(len(bad))))])
        try:
            if suffix == "mat":
                read_row(str(path), "x")
            else:
                read_wav(str(path))
        except ValueError as error:
            failed += 1
            assert str(path) in str(error)
    assert failed > 100


def test_objects_of_matlab_are_passed_over(tmp_path: Path) -> None:
    """Strings, tables and the like (class 17): flags, name, "MCOS", class, contents, without a shape; all that they hold
    lies in a variable without a name at the end."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)

    def flags(code: int) -> bytes:
        return element(6, struct.pack("<II", code, 0))

    numbers = element(5, struct.pack("<ii", 1, 1)) + element(1, b"") + element(9, struct.pack("<d", 1.0))
    contents = element(14, flags(6) + numbers)
    objects = [
        element(14, flags(17) + element(1, name) + element(1, b"MCOS") + element(1, kind) + contents)
        for name, kind in ((b"site", b"string"), (b"log", b"table"))
    ]
    unnamed = element(14, flags(6) + numbers)
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.arange(4.0)})
    content = (tmp_path / "a.mat").read_bytes()
    packed = [struct.pack("<II", 15, len(inner := zlib.compress(objects[0]))) + inner]
    for two in (objects, packed + objects[1:]):
        (tmp_path / "a.mat").write_bytes(content + b"".join(two) + unnamed)
        found = Variables(str(tmp_path / "a.mat"))
        assert {name: dtype.kind for name, (_, dtype) in found.fields.items()} == {"x": "f", "site": "O", "log": "O"}
        np.testing.assert_array_equal(found.read("x"), np.arange(4.0)[None])
        with pytest.raises(ValueError, match="log: found a cell, a struct or the like"):
            found.read("log")


def test_numbers_that_a_variable_s_type_does_not_hold(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.array([1.5, 2.0, np.nan])})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    for code, said in ((6, None), (7, None), (12, "x: found numbers of float64 that are none of a variable of int32")):
        content[144] = code  # the class among the flags
        (tmp_path / "a.mat").write_bytes(content)
        if said is None:
            np.testing.assert_array_equal(Variables(str(tmp_path / "a.mat")).read("x"), [[1.5, 2.0, np.nan]])
        else:
            with pytest.raises(ValueError, match=said):
                Variables(str(tmp_path / "a.mat")).read("x")
