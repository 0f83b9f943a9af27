"""CPHD as sarkit writes it: where points are imaged, what is kept, and what damaged and hostile files do."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas
from pysas import cli
from pysas.formats import catalogue
from pysas.formats.format import Look

pytest.importorskip("sarkit")

import radar_scenes
from radar_mutations import mutated
from radar_scenes import Pass, write
from sarkit.verification import CphdConsistency

pytestmark = pytest.mark.filterwarnings("ignore:(read|open)_text is deprecated:DeprecationWarning")  # sarkit's own

SCENES = {
    "FX, SGN -1": Pass(),
    "FX, SGN +1": Pass(sign=1),
    "version 1.0.1": Pass(version="1.0.1"),
    "bistatic": Pass(bistatic=True),
    "agile": Pass(hops=(0.0, 40e6, -25e6), steps=(2.5e6, 2.6e6)),
    "TOA, SGN -1": Pass(domain="TOA"),
    "TOA, SGN +1, bistatic": Pass(domain="TOA", sign=1, bistatic=True),
    "constant height": Pass(surface="HAE"),
    "scales": Pass(scale=True),
    "bytes": Pass(form="CI2"),
    "words, scales": Pass(form="CI4", scale=True),
}
UNIT = {"CF8": 1.0, "CI4": 8000.0, "CI2": 30.0}


@pytest.mark.parametrize("case", SCENES)
def test_a_point_is_imaged_where_it_is(case: str, tmp_path: Path) -> None:
    """At its place to 1e-3 of a pixel of 0.2 m and at its amplitude, with zero phase: nothing but geometry is between."""
    scene = SCENES[case]
    known = write(tmp_path / "a.cphd", scene)
    echoes = pysas.load(tmp_path / "a.cphd")
    assert isinstance(echoes, pysas.Echoes) and echoes.compressed and echoes.data.dtype.newbyteorder("=") == np.complex64
    # axes of a surface of constant height come from differences: 1e-10 rad at 10 km
    assert np.abs(echoes.tx - known["tx"]).max() < (5e-6 if scene.surface == "HAE" else 1e-8)
    assert np.abs(echoes.rx - known["rx"]).max() < (5e-6 if scene.surface == "HAE" else 1e-8)
    assert echoes.velocity is not None and np.abs(echoes.velocity - known["velocity"]).max() < 1e-6
    assert np.array_equal(echoes.ping_time, known["time"])
    point, pixel = scene.points[0], 0.2
    grid = pysas.Grid.plane(point[0] + pixel * np.arange(-12, 13), point[1] + pixel * np.arange(-12, 13), point[2])
    image = pysas.backproject(echoes, grid, tol=1e-4)
    found = pysas.metrics.peak_position(image, near=point[:2], radius=1.0)
    # rounding to whole numbers is noise: 1/4 of a unit in 1/sqrt(pings x samples)
    noise = 0.0 if scene.form == "CF8" else 0.3 / UNIT[scene.form] / np.sqrt(scene.pings * scene.count)
    assert np.abs(np.array(found[:2]) - point[:2]).max() < 1e-3 * pixel + 3 * noise
    value, _ = pysas.reference.exact(echoes, pysas.Grid.points([point]))
    expected = 2.0 * UNIT[scene.form]
    # the oracle extends traces by zeros where true ones are periodic: 1e-5
    assert abs(value[0] / scene.pings / expected - 1) < 1e-5 + 4 * noise


def test_points_of_a_scene(tmp_path: Path) -> None:
    """Off the plane too, with their phases; the matched sum written out is the expected value."""
    points, amplitudes = ((0.0, 0.0, 0.0), (8.0, 5.0, 3.0), (-7.0, 9.0, -2.0)), (1.0, 0.5j, -0.8)
    scene = Pass(points=points, amplitudes=amplitudes, bistatic=True)
    known = write(tmp_path / "a.cphd", scene)
    echoes = pysas.load_echoes(tmp_path / "a.cphd")
    where = np.array([*points, (2.0, 3.0, 0.0)])
    found, _ = pysas.reference.exact(echoes, pysas.Grid.points(where))
    tracks = known["tx"], known["rx"], known["velocity"]
    zero = radar_scenes.late(*tracks, np.zeros(3))
    for value, place in zip(found, where, strict=True):
        turns = known["fx"] * (radar_scenes.late(*tracks, place) - zero)[:, None]
        expected = np.vdot(np.exp(-2j * np.pi * (turns % 1).astype(float)), known["signal"]) / scene.count
        assert abs(value - expected) < 2e-5 * scene.pings


@pytest.mark.parametrize("case", ["FX, SGN -1", "bistatic", "TOA, SGN -1", "version 1.0.1", "constant height", "agile"])
def test_sarkit_s_checker_accepts_the_scenes(case: str, tmp_path: Path) -> None:
    write(tmp_path / "a.cphd", SCENES[case])
    assert faults_of(tmp_path / "a.cphd", "Error") == []


def test_what_is_kept(tmp_path: Path) -> None:
    known = write(tmp_path / "a.cphd", SCENES["bistatic"])
    echoes = pysas.load_echoes(tmp_path / "a.cphd")
    origin, axes = np.array(echoes.attrs["ecef"]["origin"]), np.array(echoes.attrs["ecef"]["axes"])
    assert np.abs(echoes.tx @ axes + origin - known["vectors"]["TxPos"]).max() < 1e-8
    assert echoes.attrs["scene_area"] == {"x": [-15.0, 17.0], "y": [-16.0, 18.0], "z": 0.0}
    assert "<CollectType>BISTATIC</CollectType>" in echoes.attrs["cphd"]
    assert echoes.attrs["title"] == "a pass over points" and echoes.attrs["source"] == "CPHD 1.1.0, channel HH"
    pysas.save(tmp_path / "a.npz", echoes)
    assert pysas.load_echoes(tmp_path / "a.npz").attrs == echoes.attrs


def test_the_command_line_images_the_file_s_own_area(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.cphd", SCENES["FX, SGN -1"])
    assert cli.main(["image", str(tmp_path / "a.cphd"), "-o", str(tmp_path / "i.npz"), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["grid"].startswith("the file's scene, every")
    image = pysas.load_image(tmp_path / "i.npz")
    for axis, (low, high) in zip("xy", ((-15, 17), (-16, 18)), strict=True):
        values = image.grid.axes[axis]
        assert low < values[0] and values[-1] < high and values[-1] - values[0] > high - low - 1
    assert not image.grid.turned and image.grid.height == 0
    peak = np.unravel_index(np.abs(image.data).argmax(), image.data.shape)
    assert abs(image.grid.axes["x"][peak[1]] - 6) < 0.5 and abs(image.grid.axes["y"][peak[0]] + 9) < 0.5


def test_channels_are_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.cphd"
    write(path, Pass(channels=("HH", "VH")))
    with pytest.raises(ValueError, match=re.escape(f"{path}: channel: found 2, 'HH', 'VH': expected one")):
        pysas.load(path)
    with pytest.raises(ValueError, match=re.escape(f"{path}: channel='VV': expected one of 'HH', 'VH'")):
        pysas.load(path, channel="VV")
    assert pysas.load_echoes(path, channel="VH").attrs["source"] == "CPHD 1.1.0, channel VH"
    other = str(tmp_path / "a.npz")
    for command in (["info"], ["check"], ["convert"]):
        rest = [other] if command == ["convert"] else []
        assert cli.main([*command, str(path), *rest]) == 2
        assert "expected one of them to be chosen (channel=, --channel)" in capsys.readouterr().err
        assert cli.main([*command, str(path), *rest, "--channel", "VH"]) in (0, 1)  # 1: a check that finds something
        assert "error" not in capsys.readouterr().err
    for command in (["info", other], ["check", other], ["convert", other, str(tmp_path / "b.npz")]):
        assert cli.main([*command, "--channel", "VH"]) == 2
        assert "channel='VH': a file of format pysas is read whole: expected None" in capsys.readouterr().err


def test_vectors_without_a_signal_are_left_out_and_said(tmp_path: Path) -> None:
    """Their places may be undefined."""
    known = write(tmp_path / "a.cphd", Pass(invalid=(0, 7)))
    with pytest.warns(UserWarning, match="2 of 60 vectors hold no signal and are left out"):
        echoes = pysas.load_echoes(tmp_path / "a.cphd")
    assert np.abs(echoes.tx - np.delete(known["tx"], (0, 7), axis=0)).max() < 1e-8


def test_without_sarkit_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "a.cphd", Pass())
    monkeypatch.setitem(sys.modules, "sarkit.cphd", None)
    with pytest.raises(ImportError, match=re.escape("sarkit is not installed: pip install 'pysas-sonar[radar]'")):
        pysas.load(tmp_path / "a.cphd")


# Written


@pytest.mark.parametrize("case", ["FX, SGN +1", "bistatic", "TOA, SGN -1", "constant height"])
def test_echoes_come_back_and_the_checker_accepts_them(case: str, tmp_path: Path) -> None:
    """Samples to their rounding; of complex64 after two turns of phase that is 2^-23 of the largest."""
    write(tmp_path / "a.cphd", SCENES[case])
    echoes = pysas.load_echoes(tmp_path / "a.cphd")
    assert cli.main(["convert", str(tmp_path / "a.cphd"), str(tmp_path / "b.cphd")]) == 0
    # two platforms' velocities come from places, which jitter here by more than the 1 m/s at which the checker warns
    assert faults_of(tmp_path / "b.cphd") == (["check_txrcv_posvel_residuals_1"] if SCENES[case].bistatic else [])
    same_echoes(echoes, pysas.load_echoes(tmp_path / "b.cphd"))


def faults_of(path: Path, *of: str) -> list[str]:
    """Checks of sarkit's that fail; `of` these severities, or of any."""
    with path.open("rb") as file:
        checker = CphdConsistency.from_file(file, thorough=True)
        checker.check()
        failed = checker.failures(omit_passed_sub=True)
    assert len(checker.passes()) > 50
    return [name for name, part in failed.items() if any(not of or detail["severity"] in of for detail in part["details"])]


def same_echoes(echoes: pysas.Echoes, found: pysas.Echoes) -> None:
    assert np.abs(found.data - echoes.data).max() < 2.0**-23 * np.abs(echoes.data).max()
    assert found.data.dtype.itemsize == 8 and found.occupied_bandwidth == pytest.approx(echoes.occupied_bandwidth, rel=1e-14)
    assert (found.fs, found.fc) == (pytest.approx(echoes.fs, rel=1e-15), pytest.approx(echoes.fc, rel=1e-15))
    assert np.abs(found.tx - echoes.tx).max() < 1e-8 and np.abs(found.rx - echoes.rx).max() < 1e-8
    assert np.abs(found.start_time - echoes.start_time).max() * echoes.fs < 1e-9
    assert found.attrs["scene_area"] == echoes.attrs.get("scene_area", found.attrs["scene_area"])
    assert (found.velocity is None) == (echoes.velocity is None)
    if found.velocity is not None:
        assert np.abs(found.velocity - echoes.velocity).max() < 1e-9


def plain(**changes: Any) -> pysas.Echoes:
    """Of a scene whose place nobody knows, stop-and-hop, without times."""
    rng = np.random.default_rng(4)
    tx = np.array([5000.0, 0, 4000]) + np.arange(20)[:, None] * [0, 2.0, 0]
    data = rng.standard_normal((20, 64, 2)).view(complex)[..., 0]
    fields: dict[str, Any] = {"fs": 2e8, "fc": 1e10, "tx": tx, "rx": tx, "c": radar_scenes.C, "bandwidth": 1.5e8}
    fields["t0"] = 2 * np.linalg.norm(tx, axis=1) / radar_scenes.C - 32 / 2e8
    return pysas.Echoes(data, **(fields | changes))


def test_what_echoes_do_not_know_is_filled(tmp_path: Path) -> None:
    pysas.save(tmp_path / "a.npz", plain())
    assert cli.main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "a.cphd")]) == 0
    assert faults_of(tmp_path / "a.cphd") == []
    found = pysas.load_echoes(tmp_path / "a.cphd")
    same_echoes(plain(), found)
    assert found.attrs["ecef"]["origin"] == [6378137.0, 0.0, 0.0]
    assert np.array_equal(found.ping_time, np.arange(20.0))


UNWRITTEN: dict[str, tuple[dict[str, Any], str]] = {
    "of a sonar": ({"c": 1500.0}, "found c=1500 m/s: expected that of light"),
    "raw": ({"compressed": False}, "found raw echoes of 20 pings, 1 channels"),
    "windows": ({"valid": np.tile([1, 60], (20, 1))}, "found echoes with windows"),
    "times": ({"ping_time": np.zeros(20)}, "ping_time: expected ascending times"),
    "not finite": ({"data": np.full((20, 64), np.nan + 0j)}, "data: not finite at ping 0"),
    "elsewhere": ({"t0": 1e-3}, "t0: expected records of all pings that hold the origin"),
    "wide": ({"bandwidth": 3e10}, "bandwidth=3e.10 Hz about"),
    "area": ({"attrs": {"scene_area": {"x": [0, 1], "y": [1, 0], "z": 0}}}, "scene_area.*expected ascending"),
    "no area": ({"attrs": {"scene_area": "North Sea"}}, "scene_area.*expected"),
    "place": ({"attrs": {"ecef": {"origin": [0, 0, 0]}}}, "ecef: expected"),
}


@pytest.mark.parametrize("case", UNWRITTEN)
def test_what_a_cphd_cannot_hold_is_told(case: str, tmp_path: Path) -> None:
    changes, message = UNWRITTEN[case]
    echoes = plain().replace(**changes)
    path = str(tmp_path / "a.cphd")
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + ".*" + message):
        catalogue.by_name(path, pysas.Echoes).write(path, echoes, False)
    assert list(tmp_path.iterdir()) == []


# Damage


def change(old: str, new: str) -> Any:
    def changed(text: str) -> str:
        assert text.count(old) >= 1, old
        return text.replace(old, new, 1)

    return changed


WRONG: dict[str, tuple[str, str, str]] = {
    "schema": ("<SGN>-1</SGN>", "<SGN>-2</SGN>", "XML: line"),
    "more vectors": ("<NumVectors>60<", "<NumVectors>61<", "XML: Data/Channel: PVP arrays end at"),
    "more than there can be": ("<NumVectors>60<", "<NumVectors>600000000<", "XML: Data/Channel: PVP arrays end at"),
    "more samples": ("<NumSamples>100<", "<NumSamples>101<", "XML: Data/Channel: Signal arrays end at"),
    "other samples": ("<SignalArrayFormat>CF8<", "<SignalArrayFormat>CI4<", "XML: Data/Channel: Signal arrays end at"),
    "overlap": ("<Offset>4</Offset>", "<Offset>3</Offset>", "XML: PVP/TxVel: begins inside TxPos"),
    "beyond a vector": ("<Offset>26</Offset>", "<Offset>99</Offset>", "XML: PVP/SCSS: ends at byte 800 of"),
    "a parameter twice": (
        "</PVP>",
        "<AddedPVP><Name>TxPos</Name><Offset>26</Offset><Size>3</Size><Format>X=F8;Y=F8;Z=F8;</Format></AddedPVP></PVP>",
        "XML: PVP/TxPos: found twice",
    ),
    "places apart": ("<HAE>1650.0<", "<HAE>1750.0<", "its Earth-fixed and geodetic coordinates are 100 m apart"),
    "area": ("<X>-15.0<", "<X>25.0<", "ImageArea"),
}


@pytest.mark.parametrize("case", WRONG)
def test_metadata_that_lie_are_refused(case: str, tmp_path: Path) -> None:
    old, new, message = WRONG[case]
    path = tmp_path / "a.cphd"
    write(path, Pass())
    content = path.read_bytes()
    assert content.count(old.encode()) >= 1
    # of the same length: a header that agrees
    start = content.index(b"<CPHD")
    end = content.index(b"</CPHD>") + 7
    body = content[start:end].replace(old.encode(), new.encode(), 1)
    head = re.sub(rb"XML_BLOCK_SIZE := \d+", b"XML_BLOCK_SIZE := %d" % len(body), content[:start])
    grown = len(body) - (end - start)
    room = 64 if grown < 16 else 256  # blocks after the XML are moved by it
    moved = re.sub(
        rb"(PVP|SIGNAL)_BLOCK_BYTE_OFFSET := (\d+)", lambda m: b"%s_BLOCK_BYTE_OFFSET := %d" % (m[1], int(m[2]) + room), head
    )
    path.write_bytes(moved + body + bytes(room - grown) + content[end:])
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + ".*" + message):
        pysas.load(path)


def test_entities_and_document_types_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.cphd"
    write(path, Pass())
    content = path.read_bytes()
    levels = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
    for kind in (f'<!DOCTYPE CPHD [<!ENTITY a0 "x">{levels}]>', '<!DOCTYPE CPHD SYSTEM "file:///etc/passwd">'):
        body = (kind + content[content.index(b"<CPHD") : content.index(b"</CPHD>") + 7].decode()).replace("a pass", "&a11;")
        head = f"CPHD/1.1.0\nXML_BLOCK_SIZE := {len(body)}\nXML_BLOCK_BYTE_OFFSET := 512\nPVP_BLOCK_SIZE := 0\n"
        head += "PVP_BLOCK_BYTE_OFFSET := 0\nSIGNAL_BLOCK_SIZE := 0\nSIGNAL_BLOCK_BYTE_OFFSET := 0\n\f\n"
        path.write_bytes(head.encode().ljust(512) + body.encode())
        with pytest.raises(ValueError, match=re.escape(f"{path}: XML: ")):
            pysas.load(path)


HEADERS = {
    "another version": (rb"CPHD/1\.1\.0", b"CPHD/0.3.0", "found b'CPHD/0.3.0': expected CPHD/1.0.1 or CPHD/1.1.0"),
    "no end": (rb"\f", b" ", "header: expected "),
    "no number": (rb"XML_BLOCK_SIZE := \d+", b"XML_BLOCK_SIZE := -1", "header: XML_BLOCK_SIZE: found b'-1'"),
    "beyond the file": (
        rb"SIGNAL_BLOCK_SIZE := \d+",
        b"SIGNAL_BLOCK_SIZE := 999999999999999",
        "SIGNAL block: ends at byte 10000",
    ),
    "missing": (rb"PVP_BLOCK_SIZE", b"PVQ_BLOCK_SIZE", "header: PVP_BLOCK_SIZE: found b''"),
}


@pytest.mark.parametrize("case", HEADERS)
def test_headers_that_lie_are_refused(case: str, tmp_path: Path) -> None:
    pattern, new, message = HEADERS[case]
    path = tmp_path / "a.cphd"
    write(path, Pass())
    path.write_bytes(re.sub(pattern, new, path.read_bytes(), count=1))
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + message):
        pysas.load(path)


def test_the_format_is_known_by_its_content(tmp_path: Path) -> None:
    write(tmp_path / "a.npz", Pass())
    found = catalogue.recognised(Look(tmp_path / "a.npz"))
    assert found is not None and found.name == "cphd"


def test_mutated_copies_are_refused_or_hold_the_same(tmp_path: Path) -> None:
    """In a subprocess: a crash is a failure here too. Samples and vectors have no checksum: of these only a crash tells."""
    source = tmp_path / "source.cphd"
    write(source, Pass(pings=20, count=32))
    content = source.read_bytes()
    number = {key: int(value) for key, value in re.findall(rb"(\w+) := (\d+)", content[:600])}
    spans = [[number[b"%s_BLOCK_BYTE_OFFSET" % name], number[b"%s_BLOCK_SIZE" % name]] for name in (b"PVP", b"SIGNAL")]
    spans = [[start, start + size] for start, size in spans]
    words = [["CF8", "CI4"], ["CF8", "CI2"], ["<Format>F8<", "<Format>I8<"], ["<Format>F8<", "<Format>F4<"], ["X=F8", "X=I8"]]
    outcome = mutated(source, tmp_path, spans, words)
    assert outcome["wrong"] == []
    assert outcome["refused"] >= 80
