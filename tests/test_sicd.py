"""SICD: images written are accepted by sarkit's checker and come back; what sarkit writes is read; damage is noticed."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas
from pysas import cli
from pysas.formats import catalogue, sicd
from pysas.formats.format import Look

pytest.importorskip("sarkit")

import sarkit.sicd
import sarkit.wgs84
from radar_mutations import mutated
from radar_scenes import frame
from sarkit.verification import SicdConsistency

pytestmark = pytest.mark.filterwarnings("ignore:(read|open)_text is deprecated:DeprecationWarning")  # sarkit's own


def image(rows: int = 25, columns: int = 40, **changes: Any) -> pysas.Image:
    rng = np.random.default_rng(1)
    grid = pysas.Grid.plane(
        10 + 0.1 * np.arange(columns), -3 + 0.2 * np.arange(rows), -4.0, **{"origin": (3.0, 5.0), "rotation": 0.4} | changes
    )
    data = rng.standard_normal((rows, columns, 2)).view(complex)[..., 0].astype(np.complex64)
    report = pysas.Report("backprojection", tol=1e-3, notes=("one",), choices={"degree": 3})
    return pysas.Image(data, grid, report, fc=1e5, c=1490.5)


PLACES = {
    "stand-in": None,
    "Boulder": {"origin": frame()[0].tolist(), "axes": frame()[1].tolist()},
}


def checked(path: Path) -> None:
    """Nothing that sarkit's checker calls an error or a warning, as `sicdcheck` does."""
    with path.open("rb") as file:
        checker = SicdConsistency.from_file(file)
        checker.check()
        assert checker.failures() == {} and len(checker.passes()) > 30


@pytest.mark.parametrize("place", PLACES)
def test_images_come_back_and_the_checker_accepts_them(place: str, tmp_path: Path) -> None:
    path = tmp_path / "a.nitf"
    written = image()
    sicd.write(str(path), written, ecef=PLACES[place])
    checked(path)
    found = pysas.load_image(path)
    assert found.data.dtype == np.complex64 and np.array_equal(found.data, written.data)
    assert found.report == written.report and (found.fc, found.c) == (written.fc, written.c)
    assert np.abs(found.grid.coordinates() - written.grid.coordinates()).max() < 1e-12


def test_pixels_lie_where_other_programs_look_for_them(tmp_path: Path) -> None:
    """sarkit reads the pixels and projects them to the Earth; x, y and z of the frame are the places in the image."""
    path = tmp_path / "a.nitf"
    written = image()
    origin, axes = frame()
    sicd.write(str(path), written, ecef={"origin": origin, "axes": axes})
    with path.open("rb") as file, sarkit.sicd.NitfReader(file) as reader:
        pixels, tree = reader.read_image(), reader.metadata.xmltree
    assert np.array_equal(pixels, written.data.T)
    helper = sarkit.sicd.XmlHelper(tree)
    scp, middle = (helper.load(f"{{*}}{name}") for name in ("GeoData/{*}SCP/{*}ECF", "ImageData/{*}SCPPixel"))
    row, column = (
        helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}UVectECF") * helper.load(f"{{*}}Grid/{{*}}{name}/{{*}}SS")
        for name in ("Row", "Col")
    )
    corners = [(0, 0), (0, 24), (39, 24), (39, 0)]
    places = np.array([scp + (i - middle[0]) * row + (j - middle[1]) * column for i, j in corners])
    expected = written.grid.coordinates(np.array([j * 40 + i for i, j in corners])) @ axes + origin
    assert np.abs(places - expected).max() < 1e-8
    listed = np.array([[float(v) for v in pair] for pair in helper.load("{*}GeoData/{*}ImageCorners")])
    assert np.abs(listed - sarkit.wgs84.cartesian_to_geodetic(expected)[:, :2]).max() < 1e-9


def test_complex128_is_rounded_and_never_overflows(tmp_path: Path) -> None:
    exact = image()
    wide = pysas.Image(exact.data.astype(complex) * (1 + 1e-12), exact.grid, exact.report, exact.fc, exact.c)
    sicd.write(str(tmp_path / "a.nitf"), wide)
    assert np.array_equal(pysas.load_image(tmp_path / "a.nitf").data, wide.data.astype(np.complex64))
    with pytest.raises(ValueError, match="pixels of more than 3.4e38"):
        sicd.write(str(tmp_path / "b.nitf"), pysas.Image(wide.data * 1e39, exact.grid, exact.report, exact.fc, exact.c))
    assert not (tmp_path / "b.nitf").exists()


BAD: dict[str, tuple[Any, str]] = {
    "polar": (pysas.Grid.polar([1.0, 2.0], [0.1, 0.2]), "found a polar of"),
    "one row": (pysas.Grid.plane([1.0, 2.0], [0.0]), r"found a plane of \(1, 2\) pixels"),
    "uneven": (pysas.Grid.plane([1.0, 2.0, 4.0], [0.0, 1.0]), "grid's x: expected ascending and evenly spaced"),
    "descending": (pysas.Grid.plane([1.0, 2.0], [1.0, 0.0]), "grid's y: expected ascending"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_written_is_told(case: str, tmp_path: Path) -> None:
    grid, message = BAD[case]
    bad = pysas.Image(np.ones(grid.shape, np.complex64), grid, pysas.Report("given"), 1e5, 1500.0)
    with pytest.raises(ValueError, match=message):
        sicd.write(str(tmp_path / "a.nitf"), bad)
    for ecef in ({}, {"origin": [0, 0, 0], "axes": np.ones((3, 3))}, {"origin": [0, 0, 0], "axes": -np.eye(3)}):
        with pytest.raises(ValueError, match="ecef"):
            sicd.write(str(tmp_path / "a.nitf"), image(), ecef=ecef)
    sicd.write(str(tmp_path / "a.nitf"), image())
    with pytest.raises(FileExistsError):
        sicd.write(str(tmp_path / "a.nitf"), image())


def test_convert_writes_and_reads_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pysas.save(tmp_path / "a.npz", image())
    assert cli.main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "a.nitf"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "sicd"
    assert cli.main(["convert", str(tmp_path / "a.nitf"), str(tmp_path / "b.npz")]) == 0
    assert np.array_equal(pysas.load_image(tmp_path / "b.npz").data, image().data)
    found = catalogue.recognised(Look(tmp_path / "a.nitf"))
    assert found is not None and found.name == "sicd"


# What sarkit writes, of any pixels


def foreign(path: Path, kind: str, table: bool = False) -> tuple[Any, Any]:
    """A SICD of random pixels by sarkit's own writer, without what only pysas knows; and its metadata."""
    sicd.write(str(path), image())
    with path.open("rb") as file, sarkit.sicd.NitfReader(file) as reader:
        meta = reader.metadata
    root = meta.xmltree.getroot()
    for element in root.findall("{*}CollectionInfo/{*}Parameter"):
        element.getparent().remove(element)
    data = root.find("{*}ImageData")
    data.find("{*}PixelType").text = kind
    data.find("{*}FirstRow").text = "5"
    data.find("{*}FullImage/{*}NumRows").text = "45"
    data.find("{*}SCPPixel/{*}Row").text = "25"
    if table:
        made = data.makeelement(data.tag.replace("ImageData", "AmpTable"), size="256")
        for index in range(256):
            entry = made.makeelement(data.tag.replace("ImageData", "Amplitude"), index=str(index))
            entry.text = repr(10.0 ** (index / 100))
            made.append(entry)
        data.insert(1, made)
    rng = np.random.default_rng(2)
    dtype = sarkit.sicd.PIXEL_TYPES[kind]["dtype"]
    pixels = np.empty((40, 25), dtype)
    if dtype.names is None:
        pixels[:] = rng.standard_normal((40, 25)) + 1j * rng.standard_normal((40, 25))
    else:
        for name in dtype.names:
            limits = np.iinfo(dtype[name])
            pixels[name] = rng.integers(limits.min, limits.max, (40, 25), endpoint=True)
    path.unlink()
    with path.open("wb") as file, sarkit.sicd.NitfWriter(file, meta) as writer:
        writer.write_image(pixels)
    return pixels, meta


@pytest.mark.parametrize(
    ("kind", "table"), [("RE32F_IM32F", False), ("RE16I_IM16I", False), ("AMP8I_PHS8I", False), ("AMP8I_PHS8I", True)]
)
def test_what_sarkit_writes_is_read(kind: str, table: bool, tmp_path: Path) -> None:
    pixels, _ = foreign(tmp_path / "a.nitf", kind, table)
    found = pysas.load_image(tmp_path / "a.nitf")
    if kind == "AMP8I_PHS8I":  # NGA.STND.0024-1: amplitude or its table, phase in 256ths of a turn
        amplitude = 10.0 ** (pixels["amp"] / 100) if table else pixels["amp"]
        expected = amplitude * np.exp(2j * np.pi * pixels["phase"] / 256)
    else:
        expected = pixels if pixels.dtype.names is None else pixels["real"] + 1j * pixels["imag"]
    assert np.abs(found.data.T - expected).max() <= 2e-7 * np.abs(expected).max()
    # about the scene's centre, which is pixel 25 - 5 of those that are there
    assert np.allclose(found.grid.axes["x"], 0.1 * (np.arange(40) - 20), atol=1e-12)
    assert np.allclose(found.grid.axes["y"], 0.2 * (np.arange(25) - 12), atol=1e-12)
    assert found.c == 299792458.0 and found.fc == pytest.approx(1e5)
    assert found.report.method == "SICD 1.4.0, OTHER, ground plane"
    assert "<PixelType>" + kind in found.report.choices["sicd"]
    pysas.save(tmp_path / "a.npz", found)
    assert pysas.load_image(tmp_path / "a.npz").report == found.report


# Damage


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.nitf"
    sicd.write(str(path), image())
    content = path.read_bytes()
    start, end = content.index(b"<SICD"), content.index(b"</SICD>") + 7
    cases = {
        "NITF: found .* bytes of": content[:-1],
        "NITF: ": content[:700],
        "XML: ": content.replace(b"<SICD ", b"<SICE ", 1),
        "XML: line": content.replace(b"<NumRows>40<", b"<NumRows>4x<"),
        "image segments are not 50 x 25": content.replace(b"<NumRows>40<", b"<NumRows>50<"),
        "damaged: expected another checksum": content.replace(b"1490.5", b"1491.5"),
        "expected the spacings of Grid": content.replace(b"<SS>0.1<", b"<SS>0.2<", 1),
    }
    for message, damaged in cases.items():
        assert damaged != content
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=re.escape(f"{path}: ") + f".*{message}"):
            pysas.load(path)
    bomb = b'<!DOCTYPE a [<!ENTITY b "x">]>' + content[start + 30 : end]
    path.write_bytes(content[:start] + bomb + content[end:])
    with pytest.raises(ValueError, match="XML: "):
        pysas.load(path)


def test_mutated_copies_are_refused_or_hold_the_same(tmp_path: Path) -> None:
    """Pixels have no checksum in a SICD: of these only a crash tells."""
    source = tmp_path / "source.nitf"
    written = image()
    sicd.write(str(source), written)
    content = source.read_bytes()
    start = content.index(written.data.T.astype(">c8").tobytes())
    words = [["RE32F_IM32F", "RE16I_IM16I"], ["SICD000", "SICE000"], ["urn:SICD:1.4.0", "urn:SICD:1.3.0"], ["GROUND", "SLANT"]]
    outcome = mutated(source, tmp_path, [[start, start + written.data.nbytes]], words)
    assert outcome["wrong"] == []
    assert outcome["refused"] >= 60
