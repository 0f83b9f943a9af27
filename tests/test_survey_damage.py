"""Surveys of bad pings and damaged files: tiles fail alone and with a reason, damage is named, and resume mends what it can."""

import functools
import json
import os
import shutil
import zlib

import numpy as np
import pytest
import zarr
from survey_scenes import changed, line, tree

import pysas
from pysas import cli, survey
from pysas.survey.image_store import StripHeader, SurveyStore, create

pytestmark = pytest.mark.cpp  # with either engine the same is tested

CUT = {"tile": 4.0, "section": 20.0, "pixel": (0.1, 0.1), "swath": (10.0, 30.0)}
STRIP = "000-port"


def flip(path, bit):
    """Change one bit of a file; `bit` < 1 is a share of its length."""
    content = bytearray(path.read_bytes())
    bit = int(bit * 8 * len(content)) if bit < 1 else bit
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A line, its plan, and the store that an undisturbed run leaves."""
    folder = tmp_path_factory.mktemp("scene")
    echoes = line(folder / "line.zarr", int16=True)
    plan = survey.plan(folder / "line.zarr", **CUT)
    assert survey.run(plan, folder / "out.zarr").complete
    return folder, echoes, plan, tree(folder / "out.zarr")


@pytest.fixture
def copies(scene, tmp_path, monkeypatch):
    """Copies of the line and of its store, which name each other."""
    folder, _, _, whole = scene
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(  # the plan names the line by its path, which is another for every test
        "pysas.survey.tiling.StripPlan.of", _named_anew(survey.running.StripPlan.of, str(tmp_path / "line.zarr"))
    )
    return tmp_path / "line.zarr", tmp_path / "out.zarr", whole


def _named_anew(of, path):
    return classmethod(lambda cls, attributes, y: of({**attributes, "line": path}, y))


def lit_by(plan, first, last):
    """Tiles that pings first to last - 1 or others of their blocks light."""
    strip = plan.strips[0]
    found = set()
    for block in strip.blocks:
        if block.first < last and first < block.last:
            found |= {
                tile
                for tile in range(strip.tiles)
                if block.low < (tile + 1) * strip.columns and block.high > tile * strip.columns
            }
    return found


# Bad pings


@pytest.mark.parametrize("suffix", [".npz", ".zarr"])
def test_pings_without_a_number_fail_the_tiles_that_they_light(suffix, tmp_path):
    path, store = tmp_path / f"line{suffix}", tmp_path / "out.zarr"
    line(path)
    plan = survey.plan(path, **CUT)
    survey.run(plan, tmp_path / "whole.zarr")
    shutil.rmtree(path) if suffix == ".zarr" else path.unlink()
    line(path, nan=[60, 61, 140])
    report = survey.run(plan, store)
    failed = {one.tile: one.reason for one in report.failed}
    assert failed.keys() == lit_by(plan, 60, 62) | lit_by(plan, 140, 141) and 4 <= len(failed) <= 14
    assert not report.complete and len(report.made) == report.tiles
    for tile, reason in failed.items():
        bad = "60, 61" if tile in lit_by(plan, 60, 62) else "140"
        assert reason.endswith(f"samples of ping {bad} are not finite: expected finite ones, or nan='mask'")
        assert SurveyStore(store).strips[0].record(tile)["reason"] == reason
    assert str(report).count("failed:") == len(set(failed.values())) and f"{20 - len(failed)} of 20 tiles made" in str(report)
    assert report.as_dict()["failed"] == [{"strip": STRIP, "tile": k, "reason": failed[k]} for k in sorted(failed)]
    good = tree(store)
    again = survey.resume(store)  # nothing has changed
    assert tree(store) == good and {one.tile: one.reason for one in again.failed} == failed and len(again.made) == len(failed)
    assert survey.verify(store, inputs=False) == []
    shutil.rmtree(path) if suffix == ".zarr" else path.unlink()
    line(path)
    repaired = survey.resume(store)
    assert repaired.complete and {one.tile for one in repaired.made} == failed.keys()
    assert tree(store) == tree(tmp_path / "whole.zarr")


def test_pings_without_a_number_are_left_out_when_asked(tmp_path):
    path, store = tmp_path / "line.npz", tmp_path / "out.zarr"
    echoes = line(path, pings=120, nan=[60, 61])
    plan = survey.plan(path, **CUT, nan="mask")
    report = survey.run(plan, store)
    assert report.complete and report.failed == []
    strip = SurveyStore(store).strips[0]
    notes = [" ".join(strip.record(tile)["report"]["notes"]) for tile in range(len(plan.tiles))]
    assert {tile for tile, note in enumerate(notes) if "12" in note} == lit_by(plan, 60, 62)  # 2 pings of 6 receivers
    silent = echoes.data.copy()
    silent[60:62] = 0
    for tile in sorted(lit_by(plan, 60, 62))[::2]:
        some = np.random.default_rng(tile).choice(plan.tiles[tile].grid.size, 60, replace=False)
        exact, level = pysas.reference.exact(echoes.replace(data=silent), plan.tiles[tile].grid, some)
        error = np.linalg.norm(strip.read(tile, "data").ravel()[some] - exact)
        assert error <= 1e-2 * max(np.linalg.norm(exact), np.linalg.norm(level))


# Damage of a line


@pytest.mark.parametrize("damage", ["missing", "a bit", "cut short"])
def test_damaged_chunks_of_a_line_fail_the_tiles_that_they_light(damage, scene, copies):
    _, _, plan, whole = scene
    path, store, _ = copies
    with pysas.open_echoes(path) as echoes:
        chunk = int(echoes.stored.split(", ")[1].split()[0])
    shutil.rmtree(store / STRIP / "records")
    (store / STRIP / "records").mkdir()
    (store / STRIP / "records" / "zarr.json").write_bytes(whole[f"{STRIP}/records/zarr.json"])
    bad = path / "data" / "c.1.0.0.0"
    content = bad.read_bytes()
    if damage == "missing":
        bad.unlink()
    elif damage == "a bit":
        flip(bad, 0.4)
    else:
        bad.write_bytes(content[:-5])
    report = survey.resume(store)
    lit = lit_by(plan, chunk, min(2 * chunk, 240))
    assert {one.tile for one in report.failed} == lit and 0 < len(lit) < 20
    assert all(f"data, chunk 1 ({chunk} to {2 * chunk - 1} along axis 0)" in one.reason for one in report.failed)
    found = survey.verify(store)
    assert found and all(one.where.startswith(str(path)) and "data, chunk 1" in one.what for one in found)
    bad.write_bytes(content)
    assert survey.resume(store).complete and tree(store) == whole and survey.verify(store) == []


def test_samples_other_than_tiles_were_made_from_are_named(scene, copies):
    _, echoes, _, _ = scene
    path, store, _ = copies
    shutil.rmtree(path)
    data = echoes.data.copy()
    data[100, 3, 200] *= 1.5
    with pysas.EchoWriter(path, int16=True) as writer:
        for first in range(0, 240, 48):
            writer.append(echoes.replace(data=data)[first : first + 48])
    (found,) = survey.verify(store)
    assert found.what == "other samples than tiles were made from"
    first, last = (int(word) for word in found.where.split("pings ")[1].split(" to "))
    assert first <= 100 <= last and last - first < 20


def test_tiles_made_from_two_kinds_of_samples_are_named(scene, copies):
    """Both lie in the store, and what the line holds now is right for some tiles alone."""
    _, echoes, _, _ = scene
    path, store, _ = copies
    strip = SurveyStore(store).strips[0]
    for tile in range(strip.tiles // 2, strip.tiles):
        strip.forget(tile)
    shutil.rmtree(path)
    data = echoes.data.copy()
    data[:, 3, 200] *= 1.5
    with pysas.EchoWriter(path, int16=True) as writer:
        for first in range(0, 240, 48):
            writer.append(echoes.replace(data=data)[first : first + 48])
    assert survey.resume(store).complete
    found = survey.verify(store)
    assert {one.what for one in found} == {"other samples than tiles were made from"}
    blocks = {tuple(span[:2]) for tile in range(strip.tiles // 2) for span in strip.record(tile)["input"]}
    assert len(found) == len(blocks)


def test_a_worker_that_sees_another_line_makes_no_tile(scene, copies):
    """Of the same name, as where workers do not share their disks; the client saw the right one."""
    path, store, _ = copies
    strip = SurveyStore(store).strips[0]
    for tile in range(strip.tiles):
        strip.forget(tile)
    shutil.rmtree(path)
    line(path, heading=0.31)
    with pytest.raises(ValueError, match=r"line\.zarr: navigation of pings \d+ to \d+ is not what the survey was planned from"):
        survey.sections.image_section(str(store), 0, 1, 1)
    survey.sections.close_lines()
    assert not any(strip.has_record(tile) for tile in range(strip.tiles))


# Damage of a store


def shard(store, name, tile):
    """The file of a tile's pixels."""
    return store / STRIP / name / f"c.0.{tile}"


def record(store, tile):
    """The file of a tile's record."""
    return store / STRIP / "records" / str(tile) / "zarr.json"


def rewritten(path, **changes):
    """Another record, with its checksum."""
    group = json.loads(path.read_bytes())
    values = {name: value for name, value in (group["attributes"] | changes).items() if name != "crc32"}
    crc = zlib.crc32(json.dumps(values, sort_keys=True, separators=(",", ":")).encode())
    path.write_text(json.dumps(group | {"attributes": values | {"crc32": crc}}))


DAMAGES = {
    "a bit of data": (lambda store: flip(shard(store, "data", 7), 0.3), "data: damaged"),
    "the first bit": (lambda store: flip(shard(store, "data", 7), 0), "data: damaged"),
    "a bit of magnitude": (lambda store: flip(shard(store, "magnitude", 7), 0.7), "magnitude: damaged"),
    "a bit of a shard's index": (lambda store: flip(shard(store, "magnitude", 7), 1 - 1e-6), "magnitude: damaged"),
    "a bit of the record": (lambda store: flip(record(store, 7), 0.5), "its record is damaged"),
    "the record's first bit": (lambda store: flip(record(store, 7), 0), "its record is damaged"),
    "no shard": (lambda store: shard(store, "data", 7).unlink(), "data: missing"),
    "a shard cut short": (lambda store: os.truncate(shard(store, "magnitude", 7), 1000), "magnitude: damaged"),
    "an empty shard": (lambda store: os.truncate(shard(store, "data", 7), 0), "data: damaged"),
    "an empty record": (lambda store: os.truncate(record(store, 7), 0), "its record is damaged"),
    "an unknown state": (lambda store: rewritten(record(store, 7), state="half"), "its record is damaged"),
    "the shard of another tile": (lambda store: shutil.copy(shard(store, "data", 8), shard(store, "data", 7)), "data: damaged"),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGES)
def test_damage_of_a_tile_is_named_and_mended(case, copies):
    _, store, whole = copies
    damage, what = DAMAGES[case]
    damage(store)
    strip = SurveyStore(store).strips[0]
    with pytest.raises(ValueError, match="000-port, tile 7: "):
        strip.read(7, what.split(":")[0] if what.startswith(("data", "magnitude")) else "data")
    (found,) = survey.verify(store)
    assert found.where == "000-port, tile 7" and found.what.startswith(what)
    again = survey.verify(store)
    assert [one.where for one in again] == ([] if "record" in what else ["000-port, tile 7"])
    report = survey.resume(store)
    assert [one.tile for one in report.made] == [7] and report.before == 19 and report.complete
    assert tree(store) == whole and survey.verify(store) == []


def test_any_bit_of_a_record_counts(copies):
    _, store, whole = copies
    path = record(store, 3)
    content = path.read_bytes()
    strip = SurveyStore(store).strips[0]
    for bit in range(0, 8 * len(content), 19):
        flip(path, bit)
        assert strip.record(3) is None, bit
        path.write_bytes(content)
    assert strip.record(3)["state"] == "done"


@pytest.mark.parametrize("name", ["data", "magnitude", "x", "y", "records"])
def test_damage_of_what_arrays_say_of_themselves_is_mended(name, copies):
    _, store, whole = copies
    path = store / STRIP / name / "zarr.json"
    content = path.read_bytes()
    rng = np.random.default_rng(5)
    dot = max(content.find(b'"."'), 0)  # c/0/7 is no shard: all dark
    bits = [8 * dot + 8, *rng.choice(8 * len(content), 25, replace=False)]
    for bit in bits:
        flip(path, int(bit))
        damaged = path.read_bytes()
        with pytest.raises(ValueError, match=rf"out\.zarr: {STRIP}: {name}: zarr\.json: missing, or not as it was written"):
            SurveyStore(store).strip(0)
        (found,) = survey.verify(store, inputs=False)
        assert found.where == f"{STRIP}/{name}/zarr.json" and path.read_bytes() == content
        path.write_bytes(damaged)
        report = survey.resume(store)
        assert report.complete and report.made == [] and path.read_bytes() == content
    path.unlink()
    assert survey.resume(store).complete and tree(store) == whole


@pytest.mark.parametrize("name", ["zarr.json", f"{STRIP}/zarr.json", f"{STRIP}/y/c.0", f"{STRIP}/x/c.0"])
def test_damage_of_the_plan_is_named(name, copies):
    _, store, whole = copies
    flip(store / name, 0.45)
    damaged = tree(store)
    for doing in (survey.verify, survey.resume):
        with pytest.raises(ValueError, match=r"out\.zarr") as caught:
            doing(store)
        assert "\n" not in str(caught.value)
        if name != "zarr.json":
            assert STRIP in str(caught.value)
    assert tree(store) == damaged


def test_no_bit_that_flips_goes_unnoticed(copies):
    _, store, whole = copies
    rng = np.random.default_rng(3)
    names = sorted(whole)
    plan = [name for name in names if name.endswith("zarr.json") and name.count("/") < 3]
    for turn in range(40):
        name = rng.choice(plan if turn % 2 else names)
        flip(store / name, int(rng.integers(8 * len(whole[name]))))
        try:
            assert len(survey.verify(store, inputs=False)) == 1, name
            assert survey.resume(store).complete and tree(store) == whole, name
        except ValueError as error:  # the plan itself, which nothing tells again
            assert name in ("zarr.json", f"{STRIP}/zarr.json", f"{STRIP}/x/c.0", f"{STRIP}/y/c.0"), name
            assert "out.zarr" in str(error)
            (store / name).write_bytes(whole[name])


def test_another_store_is_left_as_it_is(tmp_path):
    store = tmp_path / "other.zarr"
    zarr.open_group(str(store), mode="w", zarr_format=3, attributes={"schema": "weather"})
    header = json.loads((store / "zarr.json").read_bytes()) | {"must_understand": False}
    (store / "zarr.json").write_text(json.dumps(header))
    before = tree(store)
    for doing in (survey.verify, survey.resume):
        with pytest.raises(ValueError, match=r"other\.zarr: schema: found 'weather', expected 'pysas-survey-1'"):
            doing(store)
    assert tree(store) == before


def test_a_store_that_grew_is_the_one_that_was_created_so(scene, tmp_path, monkeypatch):
    strip = scene[2].strips[0]
    for name, tiles in (("grown", 7), ("killed", 7), ("whole", 20)):
        short = StripHeader(STRIP, {"tiles": tiles, "more": tiles}, strip.x[: tiles * 40], strip.y, 40)
        create(tmp_path / f"{name}.zarr", {"version": "1"}, [short])
    before = tree(tmp_path / "killed.zarr")
    SurveyStore(tmp_path / "grown.zarr").strips[0].grow(strip.x, {"tiles": 20, "more": 20})
    assert tree(tmp_path / "grown.zarr") == tree(tmp_path / "whole.zarr")
    killed = SurveyStore(tmp_path / "killed.zarr").strips[0]
    monkeypatch.setattr(killed, "_put_attributes", lambda rows: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        killed.grow(strip.x, {"tiles": 20, "more": 20})
    assert SurveyStore(tmp_path / "killed.zarr", mend=True).strips[0].tiles == 7
    found = tree(tmp_path / "killed.zarr")
    assert {name for name in found if found[name] != before.get(name)} <= {f"{STRIP}/x/c.0"}  # places of columns to come
    assert np.array_equal(SurveyStore(tmp_path / "killed.zarr").strips[0].x, strip.x[:280])


@pytest.mark.parametrize(
    "change",
    [
        {"section": 0}, {"section": "a"}, {"step": 0}, {"z": "a"}, {"z": None}, {"line": 3}, {"origin": [1]},
        {"rotation": None}, {"track": None}, {"complete": "a"}, {"blocks": []}, {"settings": {"unknown": 1}},
        {"blocks": [{"first": 0, "last": 10, "low": 0, "high": -1, "final": 3, "navigation": ""}]},
        {"blocks": [{"first": 5, "last": 10, "low": 0, "high": 40, "final": 0, "navigation": ""}]},
    ],
    ids=str,
)  # fmt: skip
def test_a_plan_that_cannot_be_is_named(change, scene, tmp_path):
    """Its checksum is right: someone wrote it so."""
    shutil.copytree(scene[0] / "out.zarr", tmp_path / "out.zarr")
    changed(tmp_path / "out.zarr" / STRIP, **change)
    report = survey.SurveyReport("out.zarr", 1, 0, 0.0)
    page = functools.partial(survey.page, report=report, path=tmp_path / "page.html")
    for what in (survey.resume, survey.verify, page):
        with pytest.raises(ValueError, match=r"out\.zarr: 000-port: "):
            what(tmp_path / "out.zarr")


# The command line


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["line.zarr", "--verify"], "--verify: LINE: expected none"),
        (["--verify", "--tol", "1e-3"], "--verify: --tol: expected none"),
        (["--verify", "--depth-map", "map.npz"], "--verify: --depth-map: expected none"),
        (["--verify", "--resume"], "--verify: --resume: expected none"),
        (["--verify", "--report", "page.html"], "--verify: --report: expected none"),
        (["--verify", "--scheduler", "tcp://127.0.0.1:1"], "--verify: --scheduler: expected none"),
        (["--verify", "--threads", "1"], "--verify: --threads: expected none"),
        (["line.zarr", "--plan", "--resume"], "--plan: --resume: expected none"),
        (["line.zarr", "--plan", "--scheduler", "tcp://127.0.0.1:1"], "--plan: --scheduler: expected none"),
        (["line.zarr", "--patience", "3"], "--patience: expected with --follow"),
    ],
)
def test_options_that_would_do_nothing_are_refused(options, message, copies, capsys):
    _, store, _ = copies
    before = tree(store)
    assert cli.main(["survey", *options, "-o", str(store)]) == 2
    assert message in capsys.readouterr().err and tree(store) == before


def test_an_output_that_cannot_be_is_told_before_lines_are_planned(copies, tmp_path, capsys):
    """Planning takes 13 s of a long line, and a follower waits for 100 m of track."""
    path, store, _ = copies
    for place, message in ((store, "out.zarr: exists"), (path, "line.zarr: exists"), (tmp_path / "a.tif", "ends in .zarr")):
        assert cli.main(["survey", "not there.npz", "-o", str(place)]) == 2
        assert message in capsys.readouterr().err
        assert cli.main(["survey", "not there.zarr", "-o", str(place), "--follow", "--patience", "0.01"]) == 2
        assert message in capsys.readouterr().err
    assert cli.main(["survey", "-o", str(tmp_path / "none.zarr"), "--resume"]) == 2
    assert "none.zarr" in capsys.readouterr().err
