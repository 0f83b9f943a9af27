"""Surveys: tiles against the exact sum whatever the line, stores that do not depend on who made them, and what a plan refuses.

Zarr itself, opened without pysas, reads the tiles.
"""

import json
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
import zarr
from survey_scenes import TARGETS, C, changed, line, tree

import pysas
from pysas import survey
from pysas.survey.image_store import SurveyStore

CUT = {"tile": 4.0, "section": 20.0, "pixel": (0.1, 0.1), "swath": (10.0, 30.0)}
SLOPE = (0.4, -0.01, 0.02)  # heights of a plane: m, and m each m along x and y, which linear interpolation keeps


def pixels_of(store, tile, array="data"):
    """A tile as zarr reads it."""
    whole = zarr.open_group(str(store), mode="r")[tile.strip][array]
    columns = tile.grid.shape[1]
    return whole[:, tile.number * columns : (tile.number + 1) * columns]


def places_of(grid):
    """x and y of a grid's pixels (row, column, 2) in the line's coordinates."""
    x, y = np.meshgrid(grid.axes["x"], grid.axes["y"])
    cos, sin = np.cos(grid.rotation), np.sin(grid.rotation)
    return np.stack([cos * x - sin * y + grid.origin[0], sin * x + cos * y + grid.origin[1]], axis=-1)


def wrong(store, tile, echoes, tol, heights=None):
    """Error of a tile in units of tol's norm, on some of its pixels."""
    grid = tile.grid
    if heights is not None:
        x, y = grid.axes["x"], grid.axes["y"]
        grid = pysas.Grid.surface(x, y, heights(places_of(grid)), origin=grid.origin, rotation=grid.rotation)
    some = np.random.default_rng(tile.number).choice(grid.size, 80, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, some)
    found = pixels_of(store, tile)
    assert np.array_equal(pixels_of(store, tile, "magnitude"), np.abs(found))
    return np.linalg.norm(found.ravel()[some] - exact) / max(np.linalg.norm(exact), np.linalg.norm(level)) / tol


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A line, its plan, and the store that an undisturbed run leaves."""
    folder = tmp_path_factory.mktemp("scene")
    echoes = line(folder / "line.zarr")
    plan = survey.plan(folder / "line.zarr", **CUT)
    report = survey.run(plan, folder / "whole.zarr", threads=1)
    assert report.complete and report.failed == [] and len(report.made) == report.tiles == len(plan.tiles) == 20
    return folder, echoes, plan, tree(folder / "whole.zarr")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A short line in memory."""
    return line(tmp_path_factory.mktemp("short") / "short.npz", pings=100)


# Against the exact sum


LINES = {
    "askew": {}, "sailed towards -x": {"heading": np.pi}, "northwards": {"heading": np.pi / 2},
    "back": {"heading": 0.3 + np.pi}, "int16": {"int16": True}, "c of each ping": {"speeds": True}, "a gap": {"gap": 40.0},
    "far from the origin": {"origin": (4e5, 5.9e6)},
}  # fmt: skip


@pytest.mark.parametrize("case", LINES)
def test_tiles_keep_tol(case, tmp_path):
    path, store = tmp_path / "line.zarr", tmp_path / "out.zarr"
    line(path, pings=120, **LINES[case])
    echoes = pysas.load(path)
    plan = survey.plan(path, **CUT, tol=3e-3)
    report = survey.run(plan, store)
    assert report.complete and survey.verify(store) == []
    dark = {one.tile for one in report.made if one.state == "dark"}
    assert bool(dark) == (case == "a gap")
    for tile in plan.tiles[:: 4 if case == "a gap" else 3]:
        if tile.number in dark:
            assert tile.pings.start == tile.pings.stop and not np.any(pysas.reference.exact(echoes, tile.grid)[1])
            assert not np.any(pixels_of(store, tile))
        else:
            assert wrong(store, tile, echoes, 3e-3) <= 1


def test_points_are_where_they_were_put(scene):
    folder, _, plan, _ = scene
    turn = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    places = TARGETS @ turn + [1000.0, 2000.0]
    for place in places:
        near = [np.linalg.norm(places_of(tile.grid) - place, axis=-1) for tile in plan.tiles]
        number = int(np.argmin([away.min() for away in near]))
        peak = np.unravel_index(np.argmax(np.abs(pixels_of(folder / "whole.zarr", plan.tiles[number]))), near[number].shape)
        assert near[number][peak] <= 0.12  # of pixels every 0.1 m


def test_both_sides_are_two_strips(tmp_path):
    path, store = tmp_path / "line.zarr", tmp_path / "out.zarr"
    echoes = line(path, pings=100, sides="both")
    plan = survey.plan(path, **CUT, side="both")
    assert [strip.name for strip in plan.strips] == ["000-starboard", "000-port"]
    assert survey.run(plan, store).complete
    left = np.array([-np.sin(0.3), np.cos(0.3)])  # of the heading: z points up, so port is where x turned by 90 degrees points
    for tile in plan.tiles[::3]:
        away = (places_of(tile.grid) - [1000.0, 2000.0]) @ left
        assert np.all(away > 5) if tile.strip.endswith("port") else np.all(away < -5)
        assert wrong(store, tile, echoes, 1e-2) <= 1


@pytest.mark.parametrize("window", [None, ("taylor", 4, 30)])
def test_raw_echoes_are_compressed_on_the_way(window, tmp_path):
    path, store = tmp_path / "line.zarr", tmp_path / "out.zarr"
    raw = line(path, pings=100, raw=True)
    plan = survey.plan(path, **CUT, window=window)
    assert survey.run(plan, store).complete
    for tile in plan.tiles[1::3]:
        assert wrong(store, tile, pysas.compress(raw, window), 1e-2) <= 1


def test_heights_of_a_depth_map(tmp_path):
    path, store = tmp_path / "line.zarr", tmp_path / "out.zarr"
    echoes = line(path, pings=100, origin=(0.0, 0.0))

    def heights(places):
        return SLOPE[0] + SLOPE[1] * places[..., 0] + SLOPE[2] * places[..., 1]

    x, y = np.arange(-60.0, 101.0, 20.0), np.arange(-60.0, 101.0, 20.0)
    z = heights(np.stack(np.meshgrid(x, y), axis=-1))
    np.savez(tmp_path / "map.npz", x=x, y=y, z=z)
    plan = survey.plan(path, **CUT, depth_map=tmp_path / "map.npz")
    assert survey.run(plan, store).complete
    for tile in plan.tiles[1::3]:
        assert wrong(store, tile, echoes, 1e-2, heights) <= 1
    np.savez(tmp_path / "map.npz", x=x, y=y, z=z + 1e-9)
    SurveyStore(store).strips[0].forget(2)
    with pytest.raises(ValueError, match=r"map\.npz: another depth map than the survey was planned with"):
        survey.resume(store)


def test_a_depth_map_holds_all_of_a_strip_and_need_not_hold_more(short, tmp_path):
    path = tmp_path / "line.npz"
    pysas.save(path, short)
    strip = survey.plan(path, **CUT).strips[0]
    corners = places_of(pysas.Grid.plane(strip.x[[0, -1]], strip.y[[0, -1]], origin=strip.origin, rotation=strip.rotation))
    for share, holds in ((1.02, True), (0.98, False)):
        middle = corners.mean(axis=(0, 1))
        x, y = (middle + share * (corners - middle)).reshape(4, 2).T
        np.savetxt(tmp_path / "map.txt", np.column_stack([x, y, np.zeros(4)]))  # places of its own: the strip lies askew
        if holds:
            found = survey.plan(path, **CUT, depth_map=tmp_path / "map.txt")
            assert np.array_equal(found.strips[0].x, strip.x) and survey.run(found, tmp_path / "out.zarr").complete
        else:
            with pytest.raises(ValueError, match=r"line\.npz: the depth map does not hold all of 000-port"):
                survey.plan(path, **CUT, depth_map=tmp_path / "map.txt")


def test_memory_of_a_depth_map_is_predicted(short, tmp_path):
    """Heights in float64: of the largest block's image, and of all tiles that it crosses."""
    x = np.linspace(900.0, 1100.0, 5)
    np.savez(tmp_path / "map.npz", x=x, y=x + 1000, z=np.zeros((5, 5)))
    pysas.save(tmp_path / "one.npz", short)
    flat, mapped = (survey.plan(tmp_path / "one.npz", **CUT, **of) for of in ({"z": 0.0}, {"depth_map": tmp_path / "map.npz"}))
    strip = mapped.strips[0]
    heights = max(
        block.high - block.low + strip.columns * ((block.high - 1) // strip.columns + 1 - block.low // strip.columns)
        for block in strip.blocks
    )
    assert mapped.memory - flat.memory >= 8 * strip.y.size * heights


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_other_containers_give_the_same_tiles(suffix, scene, tmp_path):
    _, echoes, _, whole = scene
    path, store = tmp_path / f"line{suffix}", tmp_path / "out.zarr"
    pysas.save(path, echoes)
    assert survey.run(survey.plan(path, **CUT), store).complete
    found = tree(store)
    assert found.keys() == whole.keys()
    assert {name for name in found if found[name] != whole[name]} == {"000-port/zarr.json"}  # where the line's name stands


# What a tile depends on


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_change_no_byte(threads, scene, tmp_path):
    _, _, plan, whole = scene
    survey.run(plan, tmp_path / "out.zarr", threads=threads)
    assert tree(tmp_path / "out.zarr") == whole


@pytest.mark.parametrize("seed", range(6))
def test_any_tiles_that_are_missing_are_made_as_they_were(seed, scene, tmp_path):
    folder, _, _, whole = scene
    store = tmp_path / "out.zarr"
    shutil.copytree(folder / "whole.zarr", store)
    rng = np.random.default_rng(seed)
    lost = np.flatnonzero(rng.random(20) < rng.random())
    for tile in lost:
        SurveyStore(store).strips[0].forget(tile)
        for name in ("data", "magnitude"):
            if rng.random() < 0.5:  # what a death left: its shards, or not
                (store / "000-port" / name / f"c.0.{tile}").unlink()
    (store / "000-port" / "data" / "c.0.1f2e3d.partial").write_bytes(b"half")
    report = survey.resume(store)
    assert sorted(one.tile for one in report.made) == list(lost) and report.complete and report.before == 20 - len(lost)
    assert tree(store) == whole


@pytest.mark.cpp
def test_tiles_of_trees_depend_on_neither_threads_nor_what_is_missing(tmp_path):
    path, store = tmp_path / "line.zarr", tmp_path / "out.zarr"
    line(path, pings=40, receivers=32, far=80.0)
    plan = survey.plan(path, tile=10.0, section=50.0, pixel=(0.02, 0.02), swath=(20.0, 75.0), backend="cpp")
    survey.run(plan, store, threads=1)
    strip, whole = SurveyStore(store).strips[0], tree(store)
    assert sum(strip.record(tile)["report"]["factorised_share"] > 0.2 for tile in range(strip.tiles)) >= 3
    for missing, threads in ((range(strip.tiles), 3), ((1, 2, 6), 2), ((4,), 1)):
        for tile in missing:
            strip.forget(tile)
        survey.resume(store, threads=threads)
        assert tree(store) == whole


def test_a_store_keeps_its_plan(scene):
    folder, _, plan, _ = scene
    store = SurveyStore(folder / "whole.zarr")
    kept = survey.running.plans_of(store)
    assert [strip.attributes() for strip in kept] == [strip.attributes() for strip in plan.strips]
    assert np.array_equal(kept[0].x, store.strips[0].x)
    records = [store.strips[0].record(tile) for tile in range(20)]
    assert [record["recipe"] for record in records] == [plan.strips[0].recipe(tile) for tile in range(20)]


def test_only_the_predicted_pings_light_a_tile(scene):
    folder, echoes, plan, _ = scene
    strip = SurveyStore(folder / "whole.zarr").strips[0]
    assert sum(tile.seconds for tile in plan.tiles) == pytest.approx(sum(plan.seconds))
    for tile in plan.tiles[::6]:
        begin, end = tile.pings.start, tile.pings.stop
        read = strip.record(tile.number)["input"]
        assert (read[0][0], read[-1][1]) == (begin, end)
        assert all(earlier[1] == later[0] for earlier, later in zip(read, read[1:], strict=False))
        assert [one[2] for one in read] == [zlib.crc32(echoes.data[first:last].tobytes()) for first, last, _ in read]
        for others in (echoes[:begin] if begin else None, echoes[end:] if end < echoes.n_ping else None):
            assert others is None or not np.any(pysas.reference.exact(others, tile.grid)[1])
        assert np.any(pysas.reference.exact(echoes[begin:end], tile.grid)[1])


def test_the_order_of_lines_is_that_of_strips(tmp_path):
    for name in ("b", "a"):
        line(tmp_path / f"{name}.zarr", pings=60, seed=ord(name))
    plan = survey.plan([tmp_path / "b.zarr", tmp_path / "a.zarr"], **CUT)
    assert [(strip.name, Path(strip.line).name) for strip in plan.strips] == [("000-port", "b.zarr"), ("001-port", "a.zarr")]
    report = survey.run(plan, tmp_path / "out.zarr")
    assert report.complete and {one.strip for one in report.made} == {"000-port", "001-port"}
    values = report.as_dict()
    assert json.loads(json.dumps(values)) == values and values["made"] == len(plan.tiles) and values["failed"] == []
    assert values["pixels"] == sum(tile.grid.size for tile in plan.tiles) and values["terms"] > 0


def test_progress_never_goes_back(scene, tmp_path):
    told = []
    survey.run(scene[2], tmp_path / "out.zarr", progress=told.append)
    assert told == sorted(told) and told[-1] == 1 and len(told) > 10
    told.clear()
    survey.verify(tmp_path / "out.zarr", progress=told.append)
    assert told == sorted(told) and told[-1] == 1


# What a plan refuses


def turned_back(echoes):
    """A line that is sailed to and fro."""
    along = echoes.tx[:, :2] @ [np.cos(0.3), np.sin(0.3)]
    back = np.maximum(along - along[80], 0)[:, None] * np.array([np.cos(0.3), np.sin(0.3), 0])
    return echoes.replace(tx=echoes.tx - 2 * back, rx=echoes.rx - 2 * back[:, None])


def circular(echoes):
    """A circle of 20 m that looks at its middle."""
    angle = 2 * np.pi * np.arange(echoes.n_ping) / echoes.n_ping
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    arms = 0.1 * (np.arange(6) - 2.5)[:, None]
    place = 20 * out + [0, 0, 10]
    beam = pysas.Beam(-out, 0.1, np.radians(6), "fan", 0.5, ahead)
    return echoes.replace(tx=place, rx=place[:, None] + arms * ahead[:, None], velocity=ahead, beam=beam)


def bent(echoes):
    """A line that turns by 100 degrees."""
    turned = np.radians(100) * np.clip((np.arange(echoes.n_ping) - 30) / 40, 0, 1)
    ahead = np.stack([np.cos(turned), np.sin(turned), 0 * turned], axis=1)
    place = np.cumsum(0.3 * ahead, axis=0) + [0, 0, 10]
    arms = 0.1 * (np.arange(6) - 2.5)[:, None]
    beam = pysas.Beam(ahead @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), 0.1, np.radians(6), "fan", 0.5, ahead)
    return echoes.replace(tx=place, rx=place[:, None] + arms * ahead[:, None], velocity=ahead, beam=beam)


MISTAKES = {
    "no beam": (lambda e: e.replace(beam=None), {}, r"one\.npz: no beam: expected echoes with one"),
    "circle": (circular, {}, r"one\.npz: the track goes round what it looks at: expected a line"),
    "turns back": (turned_back, {}, r"one\.npz: the line turns back on itself: at ping 8\d it is 1\.\d+ m behind"),
    "bent": (bent, {}, r"one\.npz: the line heads \d\d degrees off its mean direction"),
    "beyond the record": (None, {"swath": (60.0, 70.0)}, r"one\.npz: no ping lights 000-port, from y = "),
    "tol": (None, {"tol": 1e-9}, r"one\.npz: tol=1e-09"),
    "tol below 0": (None, {"tol": -1.0}, r"tol=-1\.0"),
    "swath": (None, {"swath": (30.0, 10.0)}, r"swath=\(30\.0, 10\.0\): expected near < far"),
    "pixel": (None, {"pixel": (0.1, 0.1, 0.1)}, r"pixel=\(0\.1, 0\.1, 0\.1\): expected one spacing or two"),
    "z and altitude": (None, {"z": 0.0, "altitude": 3.0}, r"z, altitude, depth_map: expected one of them"),
    "below the record": (None, {"altitude": 60.0}, r"one\.npz: z=-49\.993: 60 m from the track, beyond the record"),
    "tile": (None, {"tile": 0.0}, r"tile=0\.0"),
    "method": (None, {"method": "chirp scaling"}, r"method='chirp scaling'"),
    "nan": (None, {"nan": "zero"}, r"nan='zero'"),
    "side": (None, {"side": "left"}, r"side='left'"),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_what_cannot_be_planned_is_named(case, short, tmp_path):
    change, options, message = MISTAKES[case]
    pysas.save(tmp_path / "one.npz", change(short) if change else short)
    with pytest.raises(ValueError, match=message) as caught:
        survey.plan(tmp_path / "one.npz", **CUT | options)
    assert "\n" not in str(caught.value) and caught.value.args[0].count("one.npz") <= 1


def test_a_window_is_looked_at_before_anything_runs(short, tmp_path):
    pysas.save(tmp_path / "one.npz", short)
    with pytest.raises(ValueError, match=r"one\.npz: window='hann': its echoes are compressed: expected raw ones"):
        survey.plan(tmp_path / "one.npz", **CUT, window="hann")
    line(tmp_path / "raw.npz", pings=80, raw=True)
    with pytest.raises(ValueError, match=r"raw\.npz: window='no such'"):
        survey.plan(tmp_path / "raw.npz", **CUT, window="no such")


def test_a_line_of_one_place_has_no_direction(short, tmp_path):
    pysas.save(tmp_path / "one.npz", short[:1])
    with pytest.raises(ValueError, match=r"one\.npz: the line does not advance: expected pings at two places or more"):
        survey.plan(tmp_path / "one.npz", **CUT)


def test_pings_that_light_what_is_done_are_told(short, tmp_path):
    """A ping that yaws by 15 degrees lights, 30 m away, 8 m behind those before it; tiles there are complete by then."""
    beam = short.beam
    turn = np.radians(np.where(np.arange(short.n_ping) == 45, 15.0, 0.0))
    cos, sin, zero = np.cos(turn), np.sin(turn), 0 * turn
    turned = np.moveaxis(np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, zero + 1]]), 2, 0)
    look, ahead = (np.einsum("pij,pj->pi", turned, np.broadcast_to(v, (short.n_ping, 3))) for v in (beam.boresights, beam.axes))
    yawed = pysas.Beam(look, beam.length, beam.half_angle, "fan", beam.taper, ahead)
    pysas.save(tmp_path / "one.npz", short.replace(beam=yawed))
    with pytest.warns(UserWarning, match=r"one\.npz: pings \d+ to \d+ light \d\.?\d* m of 000-port that are complete by then"):
        survey.plan(tmp_path / "one.npz", **CUT)


def test_lines_of_different_sonars_are_named(short, tmp_path):
    pysas.save(tmp_path / "one.npz", short)
    others = {
        "fc": short.replace(fc=short.fc + 10), "n_channel": short.replace(data=short.data[:, 1:], rx=short.rx[:, 1:]),
        "fs": short.replace(fs=short.fs + 1), "frame": short.replace(attrs={"frame": {"lat": 1.0}}),
    }  # fmt: skip
    for name, other in others.items():
        pysas.save(tmp_path / f"{name}.npz", other)
        with pytest.raises(ValueError, match=rf"{name}.*one") as caught:
            survey.plan([tmp_path / "one.npz", tmp_path / f"{name}.npz"], **CUT)
        assert "one.npz" in str(caught.value) and f"{name}.npz" in str(caught.value)
    with pytest.raises(ValueError, match="lines: none"):
        survey.plan([])
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz"):
        survey.plan([tmp_path / "one.npz", tmp_path / "nothing.npz"])


# What must not be overwritten


def test_nothing_that_stands_there_is_overwritten(scene, tmp_path):
    folder, _, plan, whole = scene
    source, store = folder / "line.zarr", tmp_path / "out.zarr"
    before = tree(source)
    shutil.copytree(folder / "whole.zarr", store)
    with pytest.raises(FileExistsError, match=r"out\.zarr: exists"):
        survey.run(plan, store)
    assert tree(store) == whole
    for overwrite in (False, True):
        with pytest.raises((ValueError, FileExistsError), match=r"line\.zarr: (exists|is, holds or lies in .*line\.zarr)"):
            survey.run(plan, source, overwrite=overwrite)
    (tmp_path / "letters.zarr").mkdir()
    (tmp_path / "letters.zarr" / "zarr.json").write_text("{}")
    with pytest.raises(ValueError, match=r"letters\.zarr: exists and is no store"):
        survey.run(plan, tmp_path / "letters.zarr", overwrite=True)
    with pytest.raises(ValueError, match=r"out\.tif: expected a name that ends in \.zarr"):
        survey.run(plan, tmp_path / "out.tif")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        survey.run(plan, tmp_path / "nowhere" / "out.zarr")
    with pytest.raises(TypeError, match="plan=str"):
        survey.run("line.zarr", tmp_path / "new.zarr")
    with pytest.raises(TypeError, match=r"client=str: expected a distributed\.Client"):
        survey.run(plan, tmp_path / "new.zarr", client="tcp://127.0.0.1:8786")
    shutil.copytree(source, tmp_path / "other.zarr")  # a line that this survey does not read
    with pytest.raises(
        ValueError, match=r"other\.zarr: exists and is no store of images but 'pysas-echoes-1': expected a new name"
    ):
        survey.run(plan, tmp_path / "other.zarr", overwrite=True)
    assert tree(source) == tree(tmp_path / "other.zarr") == before
    assert tree(tmp_path / "letters.zarr") == {"zarr.json": b"{}"}
    other = survey.plan(source, **CUT | {"tile": 8.0})
    assert survey.run(other, store, overwrite=True).complete and tree(store) != whole


def test_an_output_that_holds_a_line_or_lies_in_one_is_refused(scene, tmp_path):
    folder, echoes, _, _ = scene
    store = tmp_path / "out.zarr"
    shutil.copytree(folder / "whole.zarr", store)
    with pysas.EchoWriter(store / "line.zarr") as writer:
        writer.append(echoes)
    inside = tree(store)
    plan = survey.plan(store / "line.zarr", **CUT)
    for path in (store, store / "line.zarr" / "images.zarr"):
        with pytest.raises(ValueError, match=r"which is read by this survey: expected another name"):
            survey.run(plan, path, overwrite=True)
    assert tree(store) == inside


def test_a_store_of_another_schema_or_version_is_not_gone_on_with(scene, tmp_path):
    folder, _, _, _ = scene
    store = tmp_path / "out.zarr"
    shutil.copytree(folder / "whole.zarr", store)
    SurveyStore(store).strips[0].forget(3)
    for doing in (survey.resume, survey.verify):
        with pytest.raises(ValueError, match=r"line\.zarr: schema: found 'pysas-echoes-1', expected 'pysas-survey-1'"):
            doing(folder / "line.zarr")
        with pytest.raises(FileNotFoundError):
            doing(tmp_path / "nothing.zarr")
    changed(store, version="0.0.1")
    before = tree(store)
    with pytest.raises(ValueError, match=r"out\.zarr: planned by pysas 0\.0\.1, this is "):
        survey.resume(store)
    changed(store, schema="pysas-survey-2")
    with pytest.raises(ValueError, match=r"out\.zarr: schema: found 'pysas-survey-2'"):
        survey.resume(store)
    changed(store, schema="pysas-survey-1", strips=["../000-port"])
    with pytest.raises(ValueError, match=r"out\.zarr: strips: found .*names of groups of this one"):
        survey.resume(store)
    changed(store, strips=["000-port"])
    assert tree(store) == before


@pytest.mark.parametrize("change", ["a place", "a speed", "a beam", "fewer pings"])
def test_another_navigation_than_planned_is_named(change, scene, tmp_path):
    _, echoes, _, _ = scene
    path, store = tmp_path / "line.npz", tmp_path / "out.zarr"
    pysas.save(path, echoes)
    plan = survey.plan(path, **CUT)
    moved = echoes.tx.copy()
    moved[100, 2] += 1e-6
    others = {
        "a place": echoes.replace(tx=moved), "a speed": echoes.replace(c=C + 1e-3), "fewer pings": echoes[:200],
        "a beam": echoes.replace(beam=pysas.Beam(echoes.beam.boresight, 0.1, 0.1, "fan", 0.5, echoes.beam.axis)),
    }  # fmt: skip
    pysas.save(path, others[change], overwrite=True)
    with pytest.raises(ValueError, match=r"line\.npz: navigation of pings \d+ to \d+ is not what the survey was planned from"):
        survey.run(plan, store)
    assert SurveyStore(store).strips[0].record(0) is None
    pysas.save(path, echoes, overwrite=True)
    assert survey.resume(store).complete
