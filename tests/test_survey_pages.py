"""Overviews of plans and pages of runs: what they say, where they draw it, and that nothing of a file gets out of its cell.

A plain parser of HTML and Zarr itself, opened without pysas, are the second opinions.
"""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
import shutil
import sys
import tracemalloc
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import survey_page_scenes
import zarr
from matplotlib.image import imread

import pysas
from pysas.navigation import Frame
from pysas.survey import pictures, reducing
from pysas.survey.image_store import SurveyStore
from pysas.survey.pages import page
from pysas.survey.pictures import Chart, overview
from pysas.survey.running import SurveyReport

pytestmark = pytest.mark.cpp  # with either engine the same is tested

NAME = "<script>alert(1)<b>$x_&.zarr"  # HTML and mathematics that a picture would stumble over
FRAME = Frame(1.0, 43.5, 7.0)
FAILED, GONE, FLIPPED, CUT = range(7, 17), 5, 3, 9  # tiles, of the first strip and of the second


@dataclasses.dataclass
class Survey:
    plan: pysas.survey.SurveyPlan
    store: Path
    report: SurveyReport


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    """Two lines; pings 128 to 239 of the first are damaged, and afterwards three tiles of the second."""
    folder = tmp_path_factory.mktemp("survey")
    survey_page_scenes.line(folder / NAME, heading=0.0, origin=(0.0, 0.0), frame=FRAME)
    survey_page_scenes.line(folder / "two.zarr", heading=np.pi, origin=(60.0, 45.0), frame=FRAME, seed=1)
    plan = pysas.survey.plan([folder / NAME, folder / "two.zarr"], tile=5.0, section=20.0)
    flip(folder / NAME / "data" / "c.1.0.0.0")
    report = pysas.survey.run(plan, folder / "images.zarr")
    strip = folder / "images.zarr" / plan.strips[1].name
    (strip / "records" / str(GONE) / "zarr.json").unlink()
    flip(strip / "magnitude" / f"c.0.{FLIPPED}")
    (strip / "data" / f"c.0.{CUT}").write_bytes(b"")
    return Survey(plan, folder / "images.zarr", report)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[1000] ^= 1
    path.write_bytes(content)


class Reader(HTMLParser):
    """Tags with their attributes, rows of cells, pictures, and all text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self._cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append([])
        self._cell = tag in ("td", "th")
        if self._cell:
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._cell = self._cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._cell:
            self.rows[-1][-1] += data

    @property
    def pictures(self) -> Iterator[np.ndarray[Any, Any]]:
        for tag, attributes in self.tags:
            if tag == "img":
                kind, content = (attributes["src"] or "").split(",")
                assert kind == "data:image/png;base64"
                yield imread(io.BytesIO(base64.b64decode(content, validate=True)), format="png")


@pytest.fixture(scope="module")
def written(survey: Survey, tmp_path_factory: pytest.TempPathFactory) -> tuple[Reader, dict[str, Any]]:
    path = tmp_path_factory.mktemp("page") / "page.html"
    values = page(survey.store, survey.report, path)
    assert sorted(item.name for item in path.parent.iterdir()) == ["page.html", "page.json"]
    assert json.loads(path.with_suffix(".json").read_bytes()) == values
    return Reader(path.read_text("utf-8")), values


# The page


def test_totals_speed_and_settings_stand_in_the_page(written: tuple[Reader, dict[str, Any]], survey: Survey) -> None:
    reader, values = written
    said = {row[0]: row[1] for row in reader.rows if len(row) == 2}
    assert values | survey.report.as_dict() == values
    assert values["tiles"] == 34 and values["made"] == 24 and not values["complete"]
    assert said["tiles"] == "34: 24 made by this run, 0 there before"
    assert "Incomplete: 10 failed, 2 damaged, 1 missing, of 34 tiles." in reader.text
    rows, columns = survey.plan.strips[0].y.size, survey.plan.strips[0].columns
    assert said["pixels of this run"] == f"{24 * rows * columns:.4g}"
    seconds = survey.report.seconds
    assert f"{24 * rows * columns / seconds:.3g} pixels/s, {values['terms'] / seconds:.3g} terms/s" in said["speed"]
    predicted = sum(survey.plan.seconds) * 24 / 34
    assert said["measured / predicted"].startswith(f"{seconds / predicted:.2f}, for the 70.6 %")
    names, settings = reader.rows[-2:]
    found = dict(zip(names, settings, strict=True))
    assert found["strips"] == "000-port, 001-port" and found["tol"] == "0.01" and found["method"] == "auto (backprojection)"
    assert all(0 < strip["predicted_error"] <= 0.01 for strip in values["strips"])
    near, far = map(float, found["swath, m"].split(" to "))
    assert 5 < near < 10 and 45 < far < 52  # records of 12 to 52 m, 10 m above the seabed


def test_every_tile_is_counted_and_every_failure_named(written: tuple[Reader, dict[str, Any]], survey: Survey) -> None:
    reader, values = written
    first, second = values["strips"]
    counts = [[strip[state] for state in ("done", "dark", "failed", "damaged", "missing")] for strip in (first, second)]
    assert counts == [[7, 0, 10, 0, 0], [14, 0, 0, 2, 1]]
    assert [row[4:9] for row in reader.rows if row[1:2] in ([NAME], ["two.zarr"])] == [list(map(str, row)) for row in counts]
    shown = {(row[0], row[1], row[2], row[3]) for row in reader.rows if len(row) == 4}
    assert [one.tile for one in survey.report.failed] == list(FAILED)
    for one in survey.report.failed:
        spans = [re.fullmatch(r"(\d+)(?:-(\d+))?", row[2]) for row in shown if row[3] == one.reason and row[1] == "failed"]
        assert any(span and int(span[1]) <= one.tile <= int(span[2] or span[1]) for span in spans)
    assert ("001-port", "damaged", str(CUT), "pixels are missing or cut short") in shown
    assert any(row[:3] == ("001-port", "damaged", str(FLIPPED)) and "magnitude is damaged" in row[3] for row in shown)


def test_what_stands_in_files_is_text_and_the_page_fetches_nothing(written: tuple[Reader, dict[str, Any]]) -> None:
    reader, _ = written
    assert any(NAME in row[3] for row in reader.rows if len(row) == 4)  # reasons name the line: they are told as they are
    assert {tag for tag, _ in reader.tags} <= set("html head meta title style body h1 h2 h3 p table tr th td img code".split())
    for _, attributes in reader.tags:
        assert not [name for name in attributes if name.startswith("on") or name in ("href", "srcset")]
        assert (attributes.get("src") or "data:").startswith("data:")
    policy = next(a["content"] for _, a in reader.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def test_pictures_are_a_map_and_one_a_strip(written: tuple[Reader, dict[str, Any]]) -> None:
    shapes = [picture.shape for picture in written[0].pictures]
    assert len(shapes) == 3 and all(300 < high < 1500 and 900 < wide < 1600 for high, wide, _ in shapes)
    for state in ("failed", "damaged", "missing"):  # in the map, flat as they are
        colour = np.array([int(pictures.COLOURS[state][k : k + 2], 16) for k in (1, 3, 5)]) / 255
        assert np.sum(np.all(np.abs(next(written[0].pictures)[..., :3] - colour) < 0.01, axis=-1)) > 500


def test_what_a_run_lost_is_named(survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "drawable", lambda: False)
    report = dataclasses.replace(survey.report, lost=[("000-port", 2, "its worker died <4> times")])
    page(survey.store, report, tmp_path / "a.html")
    rows = Reader((tmp_path / "a.html").read_text("utf-8")).rows
    assert ["000-port", "lost", "section 2", "its worker died <4> times"] in rows


def test_notes_of_tiles_are_told(survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "drawable", lambda: False)
    shutil.copytree(survey.store, tmp_path / "b.zarr")
    strip = SurveyStore(tmp_path / "b.zarr").strips[0]
    for tile in (1, 2, 4):
        record = strip.record(tile)
        assert record is not None
        strip.put(tile, record | {"report": record["report"] | {"notes": ["<i>terms</i> left out"], "predicted_error": "?"}})
    values = page(tmp_path / "b.zarr", survey.report, tmp_path / "b.html")
    assert values["strips"][0]["notes"] == [{"note": "<i>terms</i> left out", "tiles": [1, 2, 4]}]
    assert ["000-port", "<i>terms</i> left out", "1-2, 4"] in Reader((tmp_path / "b.html").read_text("utf-8")).rows


def test_without_matplotlib_the_page_says_what_to_install(
    survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    values = page(survey.store, survey.report, tmp_path / "a.html")
    reader = Reader((tmp_path / "a.html").read_text("utf-8"))
    assert list(reader.pictures) == [] and "pip install 'pysas-sonar[plot]'" in reader.text
    assert values["strips"][0]["failed"] == 10
    with pytest.raises(ImportError, match=r"pysas-sonar\[plot\]"):
        overview(survey.plan, tmp_path / "a.png")


@pytest.mark.parametrize("there", ["a.html", "a.json"])
def test_nothing_is_replaced_unasked(survey: Survey, there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "drawable", lambda: False)
    (tmp_path / there).write_text("mine")
    with pytest.raises(FileExistsError, match=there):
        page(survey.store, survey.report, tmp_path / "a.html")
    assert [item.read_text() for item in tmp_path.iterdir()] == ["mine"]
    page(survey.store, survey.report, tmp_path / "a.html", overwrite=True)
    assert (tmp_path / there).read_text("utf-8") != "mine"


def test_other_arguments_are_refused(survey: Survey, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a\.pdf: expected a name that ends in \.html"):
        page(survey.store, survey.report, tmp_path / "a.pdf")
    with pytest.raises(TypeError, match=r"report=dict: expected what pysas\.survey\.run returns"):
        page(survey.store, {}, tmp_path / "a.html")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"plan=str: expected what pysas\.survey\.plan returns"):
        overview("a", tmp_path / "a.png")  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError):
        page(tmp_path / "none.zarr", survey.report, tmp_path / "a.html")
    assert list(tmp_path.iterdir()) == []


# Quick-looks


def rows_of(survey: Survey, number: int, share: float = 1.0) -> tuple[list[pictures.Panel], str, dict[int, str]]:
    strip = SurveyStore(survey.store).strips[number]
    records = [strip.record(tile) for tile in range(strip.tiles)]
    states = ["missing" if record is None else str(record["state"]) for record in records]
    told: dict[int, str] = {}

    def damaged(tile: int, reason: str) -> None:
        states[tile], told[tile] = "damaged", reason

    panels, said = reducing.rows_of(survey.plan.strips[number], strip, states, damaged, share)
    return panels, said, told


@pytest.mark.parametrize("high", [400, 90])
def test_boxes_hold_the_mean_power_of_their_pixels(survey: Survey, high: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By Zarr and a loop over boxes, whose edges are not those of tiles."""
    monkeypatch.setattr(reducing, "_HIGH", high)
    monkeypatch.setattr(reducing, "_WIDE", 150)
    (panel,), said, _ = rows_of(survey, 0)
    plan = survey.plan.strips[0]
    data = zarr.open_group(str(survey.store), mode="r")[plan.name]["data"][...]
    down, along = -(-plan.y.size // high), -(-plan.tiles * plan.columns // 150)
    assert said.startswith(f"boxes of {along * plan.step:.3g} m along") and plan.columns % along
    done = FAILED[0] * plan.columns
    for (row, column), found in np.ndenumerate(panel.power):
        pixels = data[row * down : (row + 1) * down, column * along : min((column + 1) * along, done)]
        assert np.isnan(found) if pixels.size == 0 else found == pytest.approx(np.mean(np.abs(pixels) ** 2), rel=1e-5)
    assert set(panel.states) == set(FAILED)


def test_a_target_lies_where_it_was_put(survey: Survey) -> None:
    (panel,), _, _ = rows_of(survey, 0)
    plan = survey.plan.strips[0]
    row, column = np.unravel_index(np.nanargmax(panel.power), panel.power.shape)
    size = np.array([plan.tiles * plan.columns * plan.step, plan.y[-1] - plan.y[0]]) / panel.power.shape[::-1]
    found = np.array([plan.start, plan.y[0]]) + size * (np.array([column, row]) + 0.5)
    assert np.all(np.abs(found - [20.0, -25.0]) < 2 * size)  # port, z down


def test_tiles_that_cannot_be_read_are_told_of(survey: Survey) -> None:
    (panel,), _, told = rows_of(survey, 1)
    assert panel.states == {FLIPPED: "damaged", GONE: "missing"}
    assert set(told) == {FLIPPED} and "magnitude is damaged" in told[FLIPPED]


def test_long_strips_are_wrapped_and_longer_ones_shown_in_stretches(survey: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reducing, "_WIDE", 60)
    panels, said, _ = rows_of(survey, 0)
    assert [(panel.first, panel.last) for panel in panels] == [(0, 6), (6, 12), (12, 17)] and "stretches" not in said
    pixels = survey.plan.strips[0].y.size * survey.plan.strips[0].columns
    monkeypatch.setattr(reducing, "_MOST_READ", 7 * pixels)
    panels, said, _ = rows_of(survey, 0)
    assert [(panel.first, panel.last) for panel in panels] == [(0, 2), (7, 9), (15, 17)]
    assert said.endswith("3 stretches of 9.994 m, evenly spaced, 35 % of the strip")


def test_memory_is_that_of_a_tile(survey: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reducing, "_HIGH", 20)
    monkeypatch.setattr(reducing, "_WIDE", 60)
    strip, plan = SurveyStore(survey.store).strips[0], survey.plan.strips[0]
    peaks = []
    for many in (1, 1, FAILED[0]):  # the first time libraries load
        tracemalloc.start()
        reducing.rows_of(dataclasses.replace(plan, tiles=many), strip, ["done"] * many, lambda *_: None, 1.0)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    tile = 4 * plan.y.size * plan.columns
    assert tile < peaks[1] and peaks[2] < min(5 * tile, peaks[1] + 0.5 * tile)


# Where things are drawn


def test_strips_lie_north_and_east_as_their_frames_say(survey: Survey) -> None:
    """Of a frame at rest on a heading: x along it, y to starboard. A second one lies 0.01 degrees further north."""
    strips = survey.plan.strips
    chart = Chart(strips)
    sin, cos = np.sin(FRAME.heading), np.cos(FRAME.heading)
    begin = chart.track(0)[0]
    start = strips[0].start
    assert np.allclose(begin, [start * sin, start * cos], atol=0.1)
    y = -0.5 * (abs(strips[0].y[0]) + abs(strips[0].y[-1]))  # port, with z down
    x = start + strips[0].step * (strips[0].columns - 1) / 2
    assert np.allclose(chart.tiles(0)[0].mean(axis=0), [x * sin + y * cos, x * cos - y * sin], atol=0.1)
    moved = dataclasses.replace(strips[0], frame=dataclasses.asdict(dataclasses.replace(FRAME, lat=43.51)))
    both = Chart([strips[0], moved])
    # meridian radius of WGS84: a (1 - e^2) / (1 - e^2 sin^2 lat)^(3/2)
    radius = 6378137.0 * (1 - 0.00669438) / (1 - 0.00669438 * np.sin(np.radians(43.505)) ** 2) ** 1.5
    assert np.allclose(both.track(1) - both.track(0), [0.0, radius * np.radians(0.01)], atol=0.05)


def test_frames_that_cannot_be_are_named(survey: Survey) -> None:
    with pytest.raises(ValueError, match=r"attrs\['frame'\]: lat=100"):
        Chart([dataclasses.replace(survey.plan.strips[0], frame={"lat": 100.0, "lon": 0.0})])
    with pytest.raises(ValueError, match=r"attrs\['frame'\].*color"):
        Chart([dataclasses.replace(survey.plan.strips[0], frame={"color": 1})])


def figure_of(plan: pysas.survey.SurveyPlan, path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    drawn = []
    write = pysas.plot.write
    with monkeypatch.context() as patch:
        patch.setattr("pysas.plot.write", lambda figure, *rest, **more: (drawn.append(figure), write(figure, *rest, **more)))
        overview(plan, path)
    return drawn[0]


@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_an_overview_is_drawn(suffix: str, survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"a{suffix}"
    figure = figure_of(survey.plan, path, monkeypatch)
    assert path.read_bytes().startswith({".png": b"\x89PNG", ".pdf": b"%PDF"}[suffix])
    ax = figure.axes[0]
    assert ax.get_title() == str(survey.plan).splitlines()[0] and "34 tiles" in ax.get_title()
    assert ax.get_ylabel() == "north, m" and ax.get_xlabel() == "east, m (0, 0: 43.500000, 7.000000 deg, WGS84)"
    assert {text.get_text() for text in ax.texts} == {NAME.removesuffix(".zarr"), "two"}
    tiles = next(artist for artist in ax.collections if artist.get_array() is not None)
    assert np.allclose(tiles.get_array(), [tile.seconds for tile in survey.plan.tiles])
    assert np.allclose(tiles.get_paths()[20].vertices[:4], Chart(survey.plan.strips).tiles(1)[3])
    with pytest.raises(FileExistsError, match=path.name):
        overview(survey.plan, path)


def test_a_large_survey_is_few_artists(survey: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    strips = tuple(
        dataclasses.replace(
            survey.plan.strips[0], name=f"{k:03d}-port", line=f"line{k}", tiles=100, origin=(0.0, 60.0 * k), frame=None
        )
        for k in range(100)
    )
    plan = dataclasses.replace(survey.plan, strips=strips, seconds=(60.0,) * len(strips))
    ax = figure_of(plan, tmp_path / "a.png", monkeypatch).axes[0]
    assert len(ax.collections) <= 4 and len(ax.texts) == 0 and ax.get_xlabel() == "x, m"
    assert sum(len(artist.get_paths()) for artist in ax.collections) >= 10_000
