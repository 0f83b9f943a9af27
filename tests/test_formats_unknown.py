"""What `pysas.load` says of a file that no format takes: what it looks like, and what to do."""

from __future__ import annotations

import gzip
import io
import pickle
import random
import re
import shutil
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import zarr

import pysas
from pysas import cli
from pysas.formats.format import Look

pytestmark = pytest.mark.reference  # no engine takes part
HEADER = r"write a header for its arrays \(docs/formats.md#plain-arrays\)"
RAW = r"write a header that says its dtype and shape \(docs/formats.md#plain-arrays\)"
SAMPLES = np.ones((4, 2, 30), np.complex64)


def wav(path: Path) -> None:
    scipy.io.wavfile.write(path, 48000, np.arange(100, dtype=np.int16))


def archive(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.txt", "text")


def tar(path: Path) -> None:
    with tarfile.open(path, "w") as file:
        file.addfile(tarfile.TarInfo("a.txt"), io.BytesIO())


def xtf(path: Path) -> None:
    """XTFFILEHEADER, whose first byte is 123, and a ping's, which begins with 0xFACE."""
    path.write_bytes(struct.pack("<BB8s", 123, 1, b"recorder").ljust(1024, b"\0") + struct.pack("<HB", 0xFACE, 0) + bytes(61))


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["echo"], file["track"], file["note"] = SAMPLES, np.zeros((4, 3)), "text"
        file.create_group("more")


def nested(path: Path) -> None:
    group = zarr.open_group(str(path), mode="w")
    group.create_array("echo", data=SAMPLES)


def segy(path: Path) -> None:
    """A textual header in EBCDIC, of which "C 1" begins (SEG-Y rev. 2, 3)."""
    path.write_bytes("C 1 CLIENT".ljust(3200).encode("cp500") + struct.pack(">12xh386x", 500))


def cut(path: Path) -> None:
    np.savez(path, echo=SAMPLES)
    path.write_bytes(path.read_bytes()[:-100])


def content(what: bytes | str) -> Callable[[Path], Any]:
    return lambda path: path.write_bytes(what.encode() if isinstance(what, str) else what)


NOISE = random.Random(1).randbytes(5000)
UNKNOWN: dict[str, tuple[str, Callable[[Path], Any], str]] = {
    "npz": (
        "a.npz", lambda p: np.savez(p, track=np.zeros((4, 3)), echo=SAMPLES),
        r"arrays of no known format: track float64 \(4, 3\), echo complex64 \(4, 2, 30\); echo may be the samples:\n  "
        + HEADER,
    ),
    "npz of many": (
        "a.npz", lambda p: np.savez(p, **{f"x{i}": np.zeros(3) for i in range(40)}), r"arrays .* and 34 more:\n  write",
    ),
    "echoes but for their schema": (
        "a.npz", lambda p: np.savez(p, data=SAMPLES, fs=1.0, fc=2.0, tx=np.zeros((4, 3)), rx=np.zeros((4, 2, 3)), c=1500.0),
        r"arrays .*; data may be the samples:\n  add schema, t0, compressed, as docs/conventions.md has them, or write",
    ),
    "npz of objects": ("a.npz", lambda p: np.savez(p, x=np.array([{}]), allow_pickle=True), "x: damaged or .*object"),
    "h5": ("a.h5", hdf5, r"arrays of .* echo complex64 \(4, 2, 30\), more \(no numbers\), .*; echo may be"),
    "mat": (
        "a.mat", lambda p: scipy.io.savemat(p, {"rd": SAMPLES, "fs": 1.0, "s": {"a": 1}}),
        r"arrays .*: rd complex64 \(4, 2, 30\), fs float64 \(1, 1\), s \(no numbers\); rd may be",
    ),
    "mat of version 4": ("a.mat", lambda p: scipy.io.savemat(p, {"rd": np.ones(3)}, format="4"), "no .mat file of .* 5 to 7"),
    "mat of version 7.3": ("a.mat", content(b"MATLAB 7.3 MAT-file".ljust(128)), "a MATLAB 7.3 file: save it with -v7"),
    "zarr": ("a.zarr", nested, "a Zarr group of echo: of no known format: copy its arrays to .npz"),
    "zarr of another name": ("line", nested, "a Zarr group of echo: of no known format"),
    "npy": ("a.npy", lambda p: np.save(p, SAMPLES), "one array of NumPy: name it in a header"),
    "h5 under another name": ("a.dat", hdf5, "HDF5 under another name: rename it to .h5, or write a header"),
    "nc": ("a.nc", hdf5, r"arrays of no known format: echo complex64[^\n]*\n  write .*: of a copy whose name ends in .h5"),
    "netCDF-3": ("a.nc", content(b"CDF\x01" + bytes(28)), "netCDF-3: convert it to netCDF-4"),
    "wav": ("a.wav", wav, f"WAV: samples without places: save them as .npy and {HEADER}"),
    "raw binary": ("a.bin", content(NOISE), f"unknown bytes: if they are raw samples, {RAW}"),
    "raw binary of zeros": ("a.dat", content(bytes(5000)), "unknown bytes"),
    "csv": ("a.csv", content("time,x,y\n1,2,3\n"), "a table of text, 'a.csv' begins 'time,x,y': pysas echoes takes navigation"),
    "a table": ("a.nav", content("time,x,y\n1,2,3\n"), "a table of text, 'a.nav' begins"),
    "text": ("a.txt", content("hello\n"), "text, 'a.txt' begins 'hello': expected samples"),
    "text cut within a letter": ("a.txt", content("x" + "ü" * 3000), "text, 'a.txt' begins 'xü"),
    "xml": ("a.xml", content("<a/>\n"), "XML, 'a.xml' begins '<a/>'"),
    "yaml": ("a.yaml", content("fs: 1\n"), "text without the key header: .*says header: pysas-arrays-1"),
    "json": ("a.json", content("{}"), "text without the key header"),
    "SEG-Y": ("a.sgy", segy, "SEG-Y: not read here: segyio reads its traces"),
    "SEG-Y in ASCII": ("a.segy", content(b"C 1 CLIENT".ljust(3600)), "SEG-Y: not read here"),
    "XTF": ("a.xtf", xtf, f"an XTF file: not read here: .*MB-System, and {RAW}"),
    "XTF of another name": ("a.dat", xtf, "an XTF file"),
    "JSF": ("a.jsf", content(struct.pack("<HBBH", 0x1601, 0xD, 0, 80) + bytes(90)), "an EdgeTech JSF record: not read"),
    "s7k": ("a.s7k", content(struct.pack("<HHI", 5, 60, 0xFFFF) + bytes(90)), "a Teledyne RESON s7k record: not read here"),
    "Kongsberg .all": ("a.all", content(struct.pack("<IBB", 100, 2, 0x49) + bytes(90)), "a Kongsberg .all record"),
    "Kongsberg .kmall": ("a.kmall", content(struct.pack("<I4s", 100, b"#IIP") + bytes(90)), "a Kongsberg .kmall record"),
    "NITF": ("a.ntf", content(b"NITF02.10" + bytes(90)), "a NITF file, but no SICD 1: a picture has no phase"),
    "CPHD of another version": ("a.cphd", content(b"CPHD/9.9\n"), "found b'CPHD/9.9': expected CPHD/1.0.1 or CPHD/1.1.0"),
    "CRSD": ("a.crsd", content(b"CRSD/1.0\n"), "CRSD signal data: not read here: sarkit"),
    "pickle": ("a.pik", content(pickle.dumps({"a": 1})), r"a Python pickle, .*save its arrays as .npz \(docs/formats.md#son"),
    "a pickle called npz": ("a.npz", content(pickle.dumps({"a": 1})), "a Python pickle"),
    "PNG": ("a.png", content(b"\x89PNG\r\n\x1a\n" + NOISE), "a PNG picture: a picture has no phase"),
    "a PNG called npz": ("a.npz", content(b"\x89PNG\r\n\x1a\n" + NOISE), "a PNG picture"),
    "JPEG": ("a.jpg", content(b"\xff\xd8\xff\xe0" + NOISE), "a JPEG picture: a picture has no phase"),
    "TIFF": ("a.tif", content(b"II*\0" + NOISE), "a TIFF picture: written here and not read"),
    "PDF": ("a.pdf", content("%PDF-1.7"), "a PDF document"),
    "gzip": ("a.npz.gz", content(gzip.compress(b"x" * 99)), "a gzip file: gunzip it first"),
    "zip": ("a.zip", archive, "a zip archive, not .npz: unpack it first"),
    "tar": ("a.tar", tar, "a tar archive: unpack it first"),
    "an npz cut short": ("a.npz", cut, "damaged, or cut short while it was copied or written"),
    "empty": ("a.npz", content(b""), "an empty file: expected samples"),
    "a folder": ("b", lambda p: (p.mkdir(), (p / "t1.h5").touch()), "a folder of 1 entries, such as t1.h5: expected a file"),
    "a program": ("a.out", content(b"\x7fELF" + NOISE), "a program: give the samples"),
}  # fmt: skip


@pytest.mark.parametrize("case", UNKNOWN)
def test_a_file_of_no_format_is_told(case: str, tmp_path: Path) -> None:
    name, make, message = UNKNOWN[case]
    make(tmp_path / name)
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path / name))}: {message}") as caught:
        pysas.load(tmp_path / name)
    said = str(caught.value).removeprefix(str(tmp_path / name))
    assert len(said.splitlines()) <= 2 and len(said) < 700


def test_commands_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "a.npz", echo=SAMPLES)
    for command in (["image"], ["convert"]):
        output = ["-o", str(tmp_path / "b.npz")] if command == ["image"] else [str(tmp_path / "b.mat.npz")]
        assert cli.main([*command, str(tmp_path / "a.npz"), *output]) != 0
        assert "echo complex64 (4, 2, 30); echo may be the samples" in capsys.readouterr().err


def test_what_the_file_system_says_comes_first(tmp_path: Path) -> None:
    for name in ("none.npz", "none.xyz", "none.zarr", "none"):
        with pytest.raises(FileNotFoundError, match=name):
            pysas.load(tmp_path / name)


def test_arrays_without_a_schema_in_real_data(data_dir: Path) -> None:
    with pytest.raises(ValueError, match="arrays of no known format: .* may be the samples"):
        pysas.load(data_dir / "gotcha_phase_history.npz")


def test_a_look_never_raises_and_no_file_is_taken_for_another(tmp_path: Path) -> None:
    """Random bytes after each known beginning, under each known name: a ValueError, or for a name of our own its reader's."""
    draw = random.Random(4)
    beginnings = [path.read_bytes()[:40] for path in sorted(_made(tmp_path / "made")) if path.is_file()]
    for number, suffix in enumerate(
        [".npz", ".h5", ".mat", ".yaml", ".json", ".toml", ".bin", ".csv", ".sgy", ".all", ""] * 20
    ):
        path = tmp_path / f"{number}{suffix}"
        path.write_bytes(draw.choice(beginnings) + draw.randbytes(draw.choice((0, 10, 5000))))
        look = Look(path)
        assert isinstance(look.entries, dict) and isinstance(look.head, bytes)
        with pytest.raises(ValueError, match=re.escape(str(path))):
            pysas.load(path)
    shutil.rmtree(tmp_path / "made")


def _made(folder: Path) -> list[Path]:
    for case, (name, make, _) in UNKNOWN.items():
        (folder / case).mkdir(parents=True)
        make(folder / case / name)
    return list(folder.glob("*/*"))
