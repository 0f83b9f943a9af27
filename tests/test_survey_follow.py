"""Lines that grow while they are imaged: the same tiles whenever one looks, and whatever ends the follower."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from survey_scenes import line, tree

import pysas
from pysas import cli, survey
from pysas.survey import image_store
from pysas.survey.image_store import SurveyStore
from pysas.survey.tiling import StripPlan

pytestmark = pytest.mark.cpp  # with either engine the same is tested

CUT = {"tile": 5.0, "section": 20.0, "pixel": 0.1, "swath": (10.0, 30.0), "z": 0.0}
PINGS = 500  # 150 m: axes are laid along the first 100
PATIENCE = 60.0  # s


@pytest.fixture(scope="module")
def echoes(tmp_path_factory):
    return line(tmp_path_factory.mktemp("line") / "line.zarr", pings=PINGS)


def record(echoes, path, step, delay=0.0):
    """Write a line as a recorder does, so many pings at a time."""
    with pysas.EchoWriter(path) as writer:
        for first in range(0, echoes.n_ping, step):
            writer.append(echoes[first : first + step])
            time.sleep(delay)


@pytest.fixture(scope="module")
def followed(echoes, tmp_path_factory):
    """The store of a follower that came when all pings were there."""
    folder = tmp_path_factory.mktemp("followed")
    record(echoes, folder / "line.zarr", 100)
    report = survey.follow(folder / "line.zarr", folder / "images.zarr", **CUT)
    assert report.complete and not report.failed and report.tiles == len(report.made)
    return folder


@pytest.mark.parametrize(("step", "delay"), [(7, 0.01), (90, 0.1)])
def test_tiles_are_the_same_however_the_line_grew(echoes, followed, tmp_path, monkeypatch, step, delay):
    monkeypatch.chdir(tmp_path)
    recorder = threading.Thread(target=record, args=(echoes, "line.zarr", step, delay))
    told = []
    recorder.start()  # a line that is not there yet is waited for
    report = survey.follow("line.zarr", "images.zarr", poll=0.02, patience=PATIENCE, progress=told.append, **CUT)
    recorder.join()
    assert report.complete and told == sorted(set(told)) and told[-1] == report.tiles
    mine, other = tree("images.zarr"), tree(followed / "images.zarr")
    assert mine.keys() == other.keys()
    apart = {name for name in mine if mine[name] != other[name]}
    assert apart == {"000-port/zarr.json"}  # which names the line
    stored, expected = (SurveyStore(folder / "images.zarr").strips[0].attributes for folder in (tmp_path, followed))
    assert stored | {"line": ""} == expected | {"line": ""}
    assert survey.verify("images.zarr") == [] and survey.resume("images.zarr").made == []


def test_tiles_are_made_before_the_line_ends(echoes, tmp_path):
    with pysas.EchoWriter(tmp_path / "line.zarr") as writer:
        writer.append(echoes[:400])
        report = survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", poll=0.02, patience=0.1, **CUT)
        first = len(report.made)
        # 120 m, of which a footprint of 2 x 30 m tan(6 degrees), a metre and the tile that these cross are not final
        assert 120 / 5 - 4 <= first <= 120 / 5 and report.complete
        assert len(survey.resume(tmp_path / "images.zarr").made) == 0  # what a ping to come may light is not made
        writer.append(echoes[400:])
    report = survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", again=True)
    assert report.before == first and report.complete and report.tiles == first + len(report.made)


def test_tiles_keep_tol_and_are_those_of_a_survey(echoes, followed):
    """Axes differ by what the first 100 m of sway turn them; the tiles' pixels are compared with the exact sum."""
    store = SurveyStore(followed / "images.zarr")
    plan = survey.plan(followed / "line.zarr", **CUT)
    (strip,) = store.strips
    assert strip.tiles == plan.strips[0].tiles
    assert abs(strip.attributes["rotation"] - plan.strips[0].rotation) < 2e-3
    grid = StripPlan.of(strip.attributes, strip.y).grid(12)
    some = np.random.default_rng(0).choice(grid.size, 100, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, some)
    found = strip.read(12, "data").ravel()[some]
    assert np.linalg.norm(found - exact) <= 1e-2 * max(np.linalg.norm(exact), np.linalg.norm(level))


def test_a_killed_follower_goes_on_to_the_same_bytes(echoes, followed, tmp_path):
    command = [
        sys.executable, "-m", "pysas", "survey", "line.zarr", "-o", "images.zarr", "--tile", "5", "--section", "20", "--pixel",
        "0.1", "--swath", "10:30", "--z", "0", "--follow",
    ]  # fmt: skip
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True)
    try:
        with pysas.EchoWriter(tmp_path / "line.zarr") as writer:
            writer.append(echoes[:420])
            end = time.monotonic() + PATIENCE
            while len(list(tmp_path.glob("images.zarr/*/records/*/zarr.json"))) < 6:
                assert time.monotonic() < end and process.poll() is None
                time.sleep(0.005)
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            writer.append(echoes[420:])
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    done = subprocess.run(
        [*command[:7], "--follow", "--resume", "--json"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    report = json.loads(done.stdout)
    assert report["complete"] and report["before"] >= 6
    mine, other = tree(tmp_path / "images.zarr"), tree(followed / "images.zarr")
    assert {name for name in mine.keys() | other.keys() if mine.get(name) != other.get(name)} == {"000-port/zarr.json"}


def test_what_cannot_be_followed_is_named(echoes, tmp_path, capsys):
    with pytest.raises(ValueError, match=r"line\.npz: expected a store"):
        survey.follow(tmp_path / "line.npz", tmp_path / "images.zarr", **CUT)
    with pytest.raises(ValueError, match=r"none\.zarr: 0 pings, and no more for 0\.05 s: expected 100 m of track"):
        survey.follow(tmp_path / "none.zarr", tmp_path / "images.zarr", poll=0.01, patience=0.05, **CUT)
    with pytest.raises(TypeError, match="tile: expected none with again"):
        survey.follow(tmp_path / "none.zarr", tmp_path / "images.zarr", again=True, tile=1.0)
    with pytest.raises(TypeError, match="wrong"):
        survey.follow(tmp_path / "none.zarr", tmp_path / "images.zarr", wrong=1.0)
    with pytest.raises(ValueError, match="poll=0"):
        survey.follow(tmp_path / "none.zarr", tmp_path / "images.zarr", poll=0.0)
    assert not (tmp_path / "images.zarr").exists()
    assert cli.main(["survey", "a.zarr", "b.zarr", "-o", str(tmp_path / "images.zarr"), "--follow"]) == 2
    assert "one LINE" in capsys.readouterr().err


def test_growth_rewrites_no_axis_that_is_there(tmp_path):
    """Of a line of 120 km the axis has 40 MB."""
    store = tmp_path / "grown.zarr"
    image_store.create(store, {}, [image_store.StripHeader("000-port", {}, np.arange(9000.0), np.arange(4.0), 50)])
    first = store / "000-port" / "x" / "c.0"
    before = first.stat().st_mtime_ns, first.stat().st_ino
    strip = SurveyStore(store).strips[0]
    strip.grow(np.arange(13000.0), {})
    assert before == (first.stat().st_mtime_ns, first.stat().st_ino)
    again = SurveyStore(store).strips[0]
    assert np.array_equal(again.x, np.arange(13000.0)) and again.tiles == 260


# What is not the line that was planned


def ended(echoes, folder, **options):
    """A follower whose patience is over, of a line that still grows."""
    with pysas.EchoWriter(folder / "line.zarr") as writer:
        writer.append(echoes)
        return survey.follow(folder / "line.zarr", folder / "images.zarr", poll=0.02, patience=0.05, **CUT | options)


def test_a_store_goes_on_with_its_own_line_alone(echoes, tmp_path):
    ended(echoes[:420], tmp_path)
    before = tree(tmp_path / "images.zarr")
    record(echoes, tmp_path / "other.zarr", 100)
    with pytest.raises(ValueError, match=r"images\.zarr: of .*line\.zarr: expected that line, not .*other\.zarr"):
        survey.follow(tmp_path / "other.zarr", tmp_path / "images.zarr", again=True, patience=1.0)
    assert tree(tmp_path / "images.zarr") == before


def test_a_line_that_is_replaced_while_it_is_followed_ends_it(echoes, tmp_path):
    line_, store = tmp_path / "line.zarr", tmp_path / "images.zarr"
    (tmp_path / "other").mkdir()
    other = line(tmp_path / "other" / "line.zarr", pings=PINGS, heading=0.31)
    replaced = []

    def replace(_):
        if not replaced:
            replaced.append(True)
            line_.rename(tmp_path / "gone.zarr")
            record(other, line_, 500)

    with pysas.EchoWriter(line_) as writer:
        writer.append(echoes[:420])
        with pytest.raises(ValueError, match=r"line\.zarr: navigation of pings .* is not what the survey was planned from"):
            survey.follow(line_, store, poll=0.02, patience=5.0, progress=replace, **CUT)


def test_a_line_that_is_gone_ends_it(echoes, tmp_path):
    """As where a mount is lost; it would wait for ever."""
    lost = []

    def lose(_):
        if not lost:
            lost.append(True)
            threading.Timer(0.5, (tmp_path / "line.zarr").rename, [tmp_path / "gone.zarr"]).start()

    with pysas.EchoWriter(tmp_path / "line.zarr") as writer:
        writer.append(echoes[:420])
        with pytest.raises(FileNotFoundError, match=r"line\.zarr") as caught:
            survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", poll=0.02, patience=PATIENCE, progress=lose, **CUT)
    assert "--follow --resume goes on from there" in caught.value.__notes__[0]


def test_a_line_that_was_complete_and_grows_again_is_named(echoes, tmp_path):
    """Tiles at its end were made without the pings that came after."""
    record(echoes[:420], tmp_path / "line.zarr", 100)
    survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", **CUT)
    before = tree(tmp_path / "images.zarr")
    with pysas.EchoWriter(tmp_path / "line.zarr", resume=True) as writer:
        writer.append(echoes[420:])
    with (
        pytest.raises(ValueError, match=r"line\.zarr: has 500 pings, the survey was planned when it was complete with 420"),
        pytest.warns(UserWarning, match=r"line\.zarr: has 80 pings more than were planned: a new survey has them"),
    ):
        survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", again=True)
    assert tree(tmp_path / "images.zarr") == before


def test_tiles_that_fail_again_are_told_by_a_follower_that_goes_on(echoes, tmp_path, capsys):
    data = echoes.data.copy()
    data[200] = np.nan
    assert ended(echoes.replace(data=data)[:420], tmp_path).failed
    with pysas.EchoWriter(tmp_path / "line.zarr", resume=True) as writer:
        writer.append(echoes[420:])
    command = ["survey", str(tmp_path / "line.zarr"), "-o", str(tmp_path / "images.zarr"), "--follow", "--resume", "--json"]
    assert cli.main(command) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["failed"] and not report["complete"] and "ping 200" in report["failed"][0]["reason"]


def test_a_store_that_no_recorder_wrote_is_complete(echoes, tmp_path):
    """Without attributes "pings" and "complete" all pings are there."""
    record(echoes, tmp_path / "line.zarr", 500)
    path = tmp_path / "line.zarr" / "zarr.json"
    group = json.loads(path.read_bytes())
    for name in ("pings", "complete", "crc32"):
        del group["attributes"][name]
    path.write_text(json.dumps(group))
    assert survey.follow(tmp_path / "line.zarr", tmp_path / "images.zarr", patience=1.0, **CUT).complete


def test_a_tile_that_is_longer_than_the_track_for_axes(echoes, tmp_path):
    """Rounded to pixels it is longer than what was waited for."""
    cut = CUT | {"tile": 149.6, "pixel": 0.7}
    with pytest.raises(ValueError, match=r"line\.zarr: 500 pings, and no more for 0\.05 s: expected 100 m of track and a tile"):
        ended(echoes, tmp_path, **cut)
    assert not (tmp_path / "images.zarr").exists()
    record(echoes, tmp_path / "whole.zarr", 500)
    assert survey.follow(tmp_path / "whole.zarr", tmp_path / "images.zarr", patience=5.0, **cut).complete
