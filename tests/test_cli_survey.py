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
