"""`pysas survey`: what it prints, what it returns, and what it refuses before it begins."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from survey_scenes import line

import pysas
from pysas import cli
from pysas.cli import common, surveying

pytestmark = pytest.mark.cpp  # with either engine the same is tested

CUT = ["--tile", "5", "--section", "20", "--pixel", "0.1", "--swath", "10:30", "--z", "0"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lines")
    line(folder / "one.zarr")
    line(folder / "two.zarr", heading=0.3 + np.pi, origin=(1060.0, 2045.0), seed=1)
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """The working folder, with two lines."""
    for name in ("one.zarr", "two.zarr"):
        os.symlink(made / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pysas_survey(capsys, *arguments, expect=0):
    code = cli.main(["survey", *arguments])
    out = capsys.readouterr()
    assert code == expect, out.err
    return out


def test_a_plan_is_listed_and_nothing_is_made(folder, capsys):
    before = set(Path.cwd().iterdir())
    text = pysas_survey(capsys, "one.zarr", "two.zarr", "--plan", *CUT).out
    assert text.startswith("survey of 2 lines: ") and "000-port" in text and "10 to 30 m to port" in text
    values = json.loads(pysas_survey(capsys, "one.zarr", "two.zarr", "--plan", "--json", *CUT).out)
    assert len(values["tiles"]) > 20 and values["seconds"] == pytest.approx(sum(tile["seconds"] for tile in values["tiles"]))
    assert set(Path.cwd().iterdir()) == before
    pysas_survey(capsys, "one.zarr", "--plan", "--png", "plan.png", *CUT)
    assert Path("plan.png").read_bytes().startswith(b"\x89PNG")


def test_a_survey_from_plan_to_page(folder, capsys):
    out = pysas_survey(capsys, "one.zarr", "two.zarr", "-o", "all.zarr", "--report", "all.html", *CUT)
    assert "imaging ..." in out.err and "tiles made in" in out.out
    values = json.loads(Path("all.json").read_text())
    assert values["complete"] and values["made"] == values["tiles"] and not values["failed"]
    assert "<html" in Path("all.html").read_text()
    assert "as it was written" in pysas_survey(capsys, "-o", "all.zarr", "--verify").out
    again = json.loads(pysas_survey(capsys, "one.zarr", "two.zarr", "-o", "all.zarr", "--resume", "--json", *CUT).out)
    assert again["made"] == 0 and again["before"] == again["tiles"]

    shard = Path("all.zarr/000-port/magnitude/c.0.3")
    content = bytearray(shard.read_bytes())
    content[100] ^= 4
    shard.write_bytes(content)
    found = json.loads(pysas_survey(capsys, "-o", "all.zarr", "--verify", "--json", expect=1).out)
    assert [one["where"] for one in found["damage"]] == ["000-port, tile 3"]
    assert json.loads(pysas_survey(capsys, "-o", "all.zarr", "--resume", "--json").out)["made"] == 1


def test_failed_tiles_are_told_and_make_the_exit_code(folder, capsys):
    echoes = pysas.load("one.zarr")
    data = echoes.data.copy()
    data[100, 2, 7] = np.nan
    pysas.save("bad.npz", echoes.replace(data=data))
    out = pysas_survey(capsys, "bad.npz", "-o", "bad.zarr", *CUT, expect=1)
    assert "failed: 000-port, tiles" in out.out and "ping 100" in out.out and "nan='mask'" in out.out
    pysas_survey(capsys, "bad.npz", "-o", "bad.zarr", "--overwrite", "--nan", "mask", *CUT)


def test_a_store_tells_its_state(folder, capsys):
    pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", *CUT)
    Path("one_images.zarr/000-port/records/3/zarr.json").unlink()
    assert cli.main(["info", "one_images.zarr", "--json"]) == 0
    (strip,) = json.loads(capsys.readouterr().out)["strips"]
    assert strip["missing"] == 1 and strip["done"] == strip["tiles"] - 1 and strip["complete"]
    assert cli.main(["info", "one_images.zarr"]) == 0
    text = capsys.readouterr().out
    assert "000-port" in text and "1 missing" in text and "one.zarr" in text


def test_only_a_page_of_its_own_is_replaced_when_resumed(folder, capsys):
    pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", "--report", "page.html", *CUT)
    out = pysas_survey(capsys, "-o", "one_images.zarr", "--resume", "--report", "page.html").out
    assert "nothing to do, all" in out
    Path("notes.html").write_text("mine")
    pysas_survey(capsys, "-o", "one_images.zarr", "--resume", "--report", "notes.html", expect=2)
    Path("page.json").write_text('{"mine": 1}')
    pysas_survey(capsys, "-o", "one_images.zarr", "--resume", "--report", "page.html", expect=2)
    assert Path("notes.html").read_text() == "mine" and Path("page.json").read_text() == '{"mine": 1}'


def test_stores_of_one_kind_never_replace_those_of_another(folder, capsys):
    pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", *CUT)
    echoes = pysas.load("two.zarr")
    pysas.save("copy.zarr", echoes[:10])
    pysas_survey(capsys, "one.zarr", "-o", "copy.zarr", "--overwrite", *CUT, expect=2)
    assert cli.main(["convert", "copy.zarr", "one_images.zarr", "--overwrite"]) == 2
    assert "is no store of echoes but 'pysas-survey-1'" in capsys.readouterr().err
    with pytest.raises(ValueError, match="is no store of echoes but 'pysas-survey-1'"):
        pysas.EchoWriter("one_images.zarr", overwrite=True)
    assert pysas.load("copy.zarr").n_ping == 10
    pysas_survey(capsys, "-o", "one_images.zarr", "--verify")


def test_what_makes_a_wrong_map_is_said(folder, capsys):
    echoes = pysas.load("one.zarr")
    pysas.save("low.npz", echoes.replace(attrs={}))
    cut = [*CUT[:-2], "--plan"]
    assert "places across the track are slant ranges" in pysas_survey(capsys, "low.npz", *cut).err
    assert "slant ranges" not in pysas_survey(capsys, "one.zarr", *cut).err  # whose attrs tell the altitude
    out = pysas_survey(capsys, "one.zarr", "--plan", "--z", "0", "--pixel", "0.5")
    assert "note: 000-port: the image's Nyquist spacing is 0.034 x " in out.out and "a mosaic averages" in out.out
    assert "note" not in pysas_survey(capsys, "one.zarr", "--plan", "--z", "0").out
    far = pysas_survey(capsys, "one.zarr", "--plan", "--z", "0", "--swath", "10:90")
    assert "swath to 90 m: its records reach" in far.err
    pysas.save("other.npz", echoes.replace(attrs={"frame": {"heading": 1.0, "lat": None, "lon": None, "origin": [0, 0, 0]}}))
    pysas.save("same.npz", echoes.replace(attrs={"frame": {"heading": 0.0, "lat": None, "lon": None, "origin": [0, 0, 0]}}))
    x = np.array([900.0, 1200.0])
    np.savez("map.npz", x=x, y=x + 1000, z=np.zeros((2, 2)))
    out = pysas_survey(capsys, "same.npz", "other.npz", "--plan", "--depth-map", "map.npz", "--swath", "10:30", expect=2)
    assert "depth_map: is in the coordinates of" in out.err
    assert "one.zarr: given twice" in pysas_survey(capsys, "one.zarr", "one.zarr", "--plan", *CUT).err


MISTAKES = {
    "no line": (["-o", "a.zarr"], "LINE: none"),
    "no output": (["one.zarr"], "-o: missing"),
    "no such line": (["three.zarr", "-o", "a.zarr"], "three.zarr"),
    "suffix": (["one.zarr", "-o", "a.npz", *CUT], r"a.npz: expected a name that ends in .zarr"),
    "input": (["one.zarr", "-o", "one.zarr", "--overwrite", *CUT], "is no store of images"),
    "something else": (["one.zarr", "-o", "folder.zarr", "--overwrite", *CUT], "folder.zarr: exists and is no store"),
    "both": (["one.zarr", "-o", "a.zarr", "--resume", "--overwrite", *CUT], "--resume, --overwrite"),
    "picture": (["one.zarr", "-o", "a.zarr", "--png", "a.png", *CUT], "--png: expected with --plan"),
    "page": (["one.zarr", "-o", "a.zarr", "--report", "a.txt", *CUT], "a.txt: expected a name that ends in .html"),
    "page is there": (["one.zarr", "-o", "a.zarr", "--report", "there.html", *CUT], "there.html: exists"),
    "nobody": (["one.zarr", "-o", "a.zarr", "--scheduler", "tcp://127.0.0.1:1", *CUT], "no Dask scheduler answers"),
    "verify": (["-o", "one.zarr", "--verify"], "schema: found 'pysas-echoes-1'"),
    "nothing to resume": (["-o", "none.zarr", "--resume"], "-o none.zarr: no such store"),
    "resume": (["-o", "one.zarr", "--resume"], "schema: found 'pysas-echoes-1'"),
    "swath": (["one.zarr", "--plan", "--swath", "200:300"], "one.zarr"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_one_line_and_cost_nothing(case, folder, capsys, monkeypatch):
    arguments, message = MISTAKES[case]
    monkeypatch.setattr(surveying, "_PATIENCE", 0.5)
    Path("folder.zarr").mkdir()
    Path("there.html").write_text("mine")
    before = {path: path.stat().st_mtime_ns for path in Path.cwd().iterdir()}
    out = pysas_survey(capsys, *arguments, expect=2)
    errors = [text for text in out.err.splitlines() if text.startswith("pysas: error:")]
    assert len(errors) == 1 and message in errors[0], out.err
    assert {path: path.stat().st_mtime_ns for path in Path.cwd().iterdir()} == before


def test_other_options_than_the_stores_are_named(folder, capsys):
    pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", *CUT)
    other = [*CUT[:-1], "0.5"]
    assert "z: 0.5 after 0.0" in pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", "--resume", *other, expect=2).err
    out = pysas_survey(capsys, "one.zarr", "two.zarr", "-o", "one_images.zarr", "--resume", *CUT, expect=2)
    assert "has 1 strips, these lines 2" in out.err
    out = pysas_survey(capsys, "one.zarr", "-o", "one_images.zarr", *CUT, expect=2)
    assert "exists: expected a new name, or --resume or --overwrite" in out.err
    assert "expected with LINEs" in pysas_survey(capsys, "-o", "one_images.zarr", "--resume", *CUT, expect=2).err


def test_without_the_extra_the_command_says_what_to_install(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    monkeypatch.setitem(sys.modules, "distributed", None)
    for arguments in (["one.zarr", "-o", "a.zarr"], ["one.npz", "-o", "a.zarr", "--scheduler", "tcp://127.0.0.1:1"]):
        assert "pysas-sonar[survey]" in pysas_survey(capsys, *arguments, expect=2).err


def test_progress_tells_the_time_left(capsys, monkeypatch):
    """Of work at an even pace: half of it in 40 s leaves 40 s; where no terminal is a line at most every half minute."""
    clock = iter([0.0, 10.0, 40.0, 60.0])
    monkeypatch.setattr(common.time, "monotonic", lambda: next(clock))
    told = common.Progress(quiet=False).step("imaging")
    for share in (0.125, 0.5, 0.75):
        told(share)
    assert capsys.readouterr().err.splitlines() == ["imaging ...", "imaging 50 %, 40 s left"]
    assert common.Progress(quiet=True).step("imaging") is None
