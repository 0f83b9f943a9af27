"""`pysas image`, `info` and `compare` as they are used daily: what is written, assumed, chosen and said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas
from pysas import cli, comparison
from pysas.planning import framing

TARGET = np.array([0.2, 8.0, 0.0])
HEIGHT = 3.0
SPANS = ["--x", "-0.4:0.8", "--y", "7.5:8.5", "--spacing", "0.01"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Raw echoes of one target from a straight track 3 m above it; the same with a beam, turned, and of a circle."""
    folder = tmp_path_factory.mktemp("daily")
    track = pysas.tracks.straight(40, 0.05, start=(-1.0, 0.0, 0.0), height=HEIGHT)
    pulse = pysas.LFM(100e3, 15e3, 1e-3, "tukey", 0.1)
    fixed: dict[str, Any] = {"fs": 40e3, "duration": 0.014}
    raw = pysas.simulate([TARGET], [1.0], pulse, tx=track.position, rx=pysas.tracks.array(track, 2, 0.05), **fixed)
    raw = raw.replace(attrs={"truth_position": TARGET[None], "truth_amplitude": np.ones(1)})
    pysas.save(folder / "raw.npz", raw)
    pysas.save(folder / "compressed.npz", pysas.compress(raw))
    a = np.radians(130.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    shift = np.array([431234.0, 5533211.0, -40.0])
    attrs = raw.attrs | {"truth_position": TARGET[None] @ turn.T + shift}
    beam = pysas.Beam(turn @ [0, 1, -0.4], 0.1, 0.5)
    pysas.save(folder / "utm.npz", raw.replace(tx=raw.tx @ turn.T + shift, rx=raw.rx @ turn.T + shift, beam=beam, attrs=attrs))
    ring = pysas.tracks.circular(100, 5.0, height=2.0)
    round_ = pysas.simulate([[0.1, 0.2, 0]], [1.0], pulse, tx=ring.position, rx=ring.position, **fixed)
    pysas.save(folder / "ring.npz", round_)
    return folder


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    try:
        code = cli.main([str(a) for a in arguments])
    except SystemExit as stop:  # argparse's own errors
        code = int(str(stop.code))
    out = capsys.readouterr()
    return code, out.out, out.err


def imaged(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[pysas.Image, str, str]:
    code, out, err = run(capsys, "image", *arguments, "-o", "x.npz", "--overwrite")
    assert code == 0, err
    return pysas.load_image("x.npz"), out, err


def peak(image: pysas.Image) -> np.ndarray:
    return image.grid.coordinates(np.array([int(np.argmax(np.abs(image.data)))]))[0]


def test_a_plain_command_writes_an_image_and_a_picture(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "image", store / "raw.npz", "--spacing", "0.1")
    assert code == 0 and sorted(p.name for p in Path().iterdir()) == ["raw_image.npz", "raw_image.png"]
    assert "compressed on the way: matched filter of LFM(100 kHz" in out and "image written raw_image.npz" in out
    assert "targets" not in out and len(out.splitlines()) < 15
    before = Path("raw_image.npz").stat()
    code, out, err = run(capsys, "image", store / "raw.npz", "--spacing", "0.1")
    assert code == 2 and "raw_image.npz: exists" in err and "compressing" not in err
    assert Path("raw_image.npz").stat().st_mtime_ns == before.st_mtime_ns
    assert run(capsys, "image", store / "raw.npz", "--spacing", "0.1", "--overwrite")[0] == 0


def test_without_matplotlib_there_is_the_image(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pysas.cli.image.has_matplotlib", lambda: False)
    code, out, _ = run(capsys, "image", store / "raw.npz", "--spacing", "0.1")
    assert code == 0 and [p.name for p in Path().iterdir()] == ["raw_image.npz"] and "pip install 'pysas-sonar[plot]'" in out


def test_the_height_is_given_or_said_to_be_assumed(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The target is 8.544 m away from the track: across-track where the sonar's own plane is imaged, 8 m on its own."""
    image, out, _ = imaged(capsys, store / "raw.npz", "--spacing", "0.02")
    assert "z = 3 m assumed, the sonar's own" in out and "--altitude" in out and image.grid.height == HEIGHT
    assert np.allclose(peak(image), [0.2, np.hypot(8, 3), 3], atol=0.03)
    for options in (["--z", "0"], ["--altitude", "3"]):
        image, out, _ = imaged(capsys, store / "raw.npz", "--spacing", "0.02", *options)
        assert "assumed" not in out and np.allclose(peak(image), TARGET, atol=0.02)
    for options in (["--z", "0", "--altitude", "3"], ["--altitude", "0"], ["--altitude", "nan"], ["--altitude", "500"]):
        code, _, err = run(capsys, "image", store / "raw.npz", "-o", "y.npz", *options)
        assert code == 2 and ("not allowed with" in err or "altitude" in err or "--z" in err) and not Path("y.npz").exists()


def test_a_closed_track_is_warned_of_its_height(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--x", "-0.5:0.5", "--y", "-0.5:0.5", "--spacing", "0.01"]
    _, _, err = imaged(capsys, store / "ring.npz", *options)
    assert "warning: z = 2 m assumed" in err and "round a closed track" in err
    image, _, err = imaged(capsys, store / "ring.npz", *options, "--altitude", "2")
    assert "warning" not in err and np.allclose(peak(image), [0.1, 0.2, 0], atol=0.011)


def maps() -> dict[str, np.ndarray]:
    x, y = np.linspace(-2, 2, 5), np.linspace(12, 4, 9)
    return {"x": x, "y": y, "z": np.add.outer(0.25 * (y - 8), 0 * x)}


@pytest.mark.parametrize("kind", ["map.npz", "map.h5", "map.csv", "map.xyz"])
def test_a_depth_map_is_laid_under_the_image(kind: str, store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A seabed that rises away from the track passes through the target, which is found where it is."""
    found = maps()
    if kind == "map.npz":
        np.savez(kind, **found)
    elif kind == "map.h5":
        import h5py

        with h5py.File(kind, "w") as file:
            for name, values in found.items():
                file[name] = values
    else:
        x, y = np.meshgrid(found["x"], found["y"])
        points = np.column_stack([x.ravel(), y.ravel(), found["z"].ravel()])
        np.savetxt(kind, points, delimiter="," if kind == "map.csv" else " ")
    image, out, err = imaged(capsys, store / "raw.npz", "--depth-map", kind, *SPANS)
    assert image.grid.kind == "surface" and f"z of {kind}" in out and "warning" not in err
    assert np.allclose(image.grid.height, 0.25 * (image.grid.axes["y"] - 8)[:, None], atol=1e-9)
    assert np.allclose(peak(image), TARGET, atol=0.011)
    image, _, err = imaged(capsys, store / "raw.npz", "--depth-map", kind, "--x", "-0.5:3", "--y", "7:9", "--spacing", "0.1")
    assert "warning: 210 of 756 pixels lie beyond the depth map" in err  # 10 of 36 columns beyond x = 2
    assert image.grid.mask is not None and np.array_equal(image.grid.mask.sum(axis=0), 21 * (image.grid.axes["x"] < 2.001))
    code, _, err = run(capsys, "image", store / "raw.npz", "-o", "y.npz", "--depth-map", kind, "--x", "5:6", "--y", "7:9")
    assert code == 2 and "holds no pixel" in err


@pytest.mark.parametrize(
    ("name", "write", "text"),
    [
        ("a.csv", lambda p: p.write_text("x,y,z\n1,2,3\n"), "a.csv: could not convert string 'x'"),
        ("a.csv", lambda p: p.write_text("1,2\n3,4\n5,6\n"), "found 3 lines of 2 numbers"),
        ("a.csv", lambda p: p.write_text("1,2,nan\n3,4,5\n5,6,7\n"), "a.csv: x, y, z: nan at point 0"),
        ("a.csv", lambda p: p.write_bytes(bytes(range(256))), "a.csv"),
        ("a.npz", lambda p: np.savez(p, x=np.arange(3.0), y=np.arange(2.0)), "z: missing"),
        ("a.npz", lambda p: np.savez(p, x=np.arange(3.0), y=np.arange(2.0), z=np.zeros((3, 2))), "z: found shape"),
        ("a.npz", lambda p: np.savez(p, x=np.zeros(3), y=np.arange(2.0), z=np.zeros((2, 3))), "twice"),
        ("a.npz", lambda p: np.savez(p, x=np.array([None]), y=np.arange(2.0), z=np.zeros((2, 1))), "a.npz: x:"),
    ],
)
def test_other_depth_maps_are_named(name: str, write: Any, text: str, store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path(name))
    code, _, err = run(capsys, "image", store / "raw.npz", "-o", "y.npz", "--depth-map", name, *SPANS)
    assert code == 2 and text in err and "Traceback" not in err


def test_a_survey_in_utm_is_imaged_along_its_track(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out, _ = imaged(capsys, store / "utm.npz", "--altitude", "3", "--spacing", "0.02", "--truth", "--png", "a.png")
    assert np.degrees(image.grid.rotation) == pytest.approx(130) and image.grid.height == pytest.approx(-40)
    assert "+y side of the track (where the beam looks)" in out and "1 in this plane, found within" in out
    truth = pysas.load_echoes(store / "utm.npz").attrs["truth_position"]
    assert np.allclose(peak(image), truth, atol=0.02) and Path("a.png").exists()
    code, _, err = run(capsys, "image", store / "utm.npz", "-o", "y.npz", "--x", "431230:431231")
    assert code == 2 and "expected both, on the axes of the data" in err
    found, _, _ = imaged(
        capsys, store / "utm.npz", "--z", "-40", "--spacing", "0.02", f"--x={truth[0, 0] - 1}:{truth[0, 0] + 1}",
        f"--y={truth[0, 1] - 1}:{truth[0, 1] + 1}",
    )  # fmt: skip
    assert not found.grid.turned and np.allclose(peak(found), truth, atol=0.02)


@pytest.mark.parametrize(("side", "sign"), [("port", 1), ("starboard", -1)])
def test_either_side_is_imaged(side: str, sign: int, store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Echoes without a beam come from either side alike."""
    image, _, _ = imaged(capsys, store / "raw.npz", "--z", "0", "--side", side, "--spacing", "0.02")
    assert np.allclose(peak(image), TARGET * [1, sign, 1], atol=0.02)


def test_too_large_a_grid_is_refused_with_its_size(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for spans in ([], ["--x", "-4:4"]):
        code, _, err = run(capsys, "image", store / "raw.npz", "--z", "0", "--spacing", "0.0001", *spans)
        assert code == 2 and "pixels" in err and "--large" in err and not list(Path().iterdir())


def test_spacings_along_and_across(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "image", "--spacing", "0.1", "0.05", store / "raw.npz", *SPANS[:4], "--json")
    assert code == 0 and json.loads(out)["shape"] == [21, 13]
    code, out, _ = run(capsys, "image", "--spacing", "0.1", store / "raw.npz", *SPANS[:4], "--json")
    assert code == 0 and json.loads(out)["shape"] == [11, 13]
    for wrong in (["0.1,0.1,0.1"], ["a"], ["0.1", "-1"]):
        assert run(capsys, "image", "--spacing", *wrong, store / "raw.npz", "--json")[0] == 2


def test_the_sound_speed_moves_the_target(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Slant ranges grow with it: 8.544 m at 1500 m/s."""
    image, _, _ = imaged(capsys, store / "raw.npz", "--c", "1470", "--spacing", "0.01")
    assert image.c == 1470 and peak(image)[1] == pytest.approx(np.hypot(8, 3) * 1470 / 1500, abs=0.02)
    for wrong in ("0", "nan"):
        code, _, err = run(capsys, "image", store / "raw.npz", "-o", "y.npz", "--c", wrong)
        assert code == 2 and "--c=" in err


def test_a_window_lowers_side_lobes(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lobes = {}
    for window in ("none", "hann", "kaiser:8.6"):
        options = [] if window == "none" else ["--window", window]
        image, out, _ = imaged(capsys, store / "raw.npz", "--z", "0", *SPANS, *options)
        given = {"none": None, "kaiser:8.6": ("kaiser", 8.6)}.get(window, window)
        expected = pysas.focus(pysas.compress(pysas.load_echoes(store / "raw.npz"), given), image.grid)
        assert np.array_equal(image.data, expected.data)
        lobes[window] = pysas.metrics.pslr(image.data[:, int(np.argmax(np.abs(image.data).max(axis=0)))])
        assert f"window {'none' if not options else window.split(':')[0]}" in out.replace("('", "").replace("'", "")
    assert lobes["hann"] < lobes["none"] - 5 and lobes["kaiser:8.6"] < lobes["none"] - 5
    wrongs = [
        ("raw", "hanning9", "window"),
        ("raw", "kaiser:x", "NAME:PARAMETER"),
        ("compressed", "hann", "compressed already"),
    ]
    for name, wrong, text in wrongs:
        code, _, err = run(capsys, "image", store / f"{name}.npz", "-o", "y.npz", *SPANS, "--window", wrong)
        assert code == 2 and text in err and not Path("y.npz").exists()


def test_weights_are_those_of_the_library(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out, _ = imaged(capsys, store / "compressed.npz", "--z", "0", *SPANS, "--weights", "uniform-angle", "--tol", "1e-4")
    echoes = pysas.load_echoes(store / "compressed.npz")
    expected = pysas.focus(echoes, image.grid, 1e-4, weights="uniform-angle")
    assert np.array_equal(image.data, expected.data) and "compressed on the way" not in out
    assert run(capsys, "image", store / "raw.npz", "--weights", "hann", "--json")[0] == 2


def test_the_picture_s_levels_are_chosen(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[dict[str, Any]] = []
    monkeypatch.setattr("pysas.plot.quicklook", lambda image, path, **options: drawn.append(options))
    for options in ([], ["--reference", "percentile", "--dynamic-range", "55"], ["--reference", "-3.5", "--truth"]):
        code = run(capsys, "image", store / "raw.npz", "--png", "a.png", "--z", "0", *SPANS, *options)[0]
        assert code == 0
    assert [d["reference"] for d in drawn] == ["peak", "percentile", -3.5]
    assert [d["dynamic_range"] for d in drawn] == [40.0, 55.0, 40.0]
    assert [d["targets"] is not None for d in drawn] == [False, False, True]
    for wrong in (["--reference", "mean"], ["--dynamic-range", "-5"]):
        code, _, err = run(capsys, "image", store / "raw.npz", "--png", "a.png", *SPANS, *wrong)
        assert code == 2 and "compressing" not in err


def test_targets_are_summed_up(capsys: pytest.CaptureFixture[str], store: Path) -> None:
    """Many of them take one line."""
    raw = pysas.load_echoes(store / "raw.npz")
    many = np.column_stack([np.linspace(-0.3, 0.7, 40), np.full(40, 8.0), np.zeros(40)])
    pysas.save("many.npz", raw.replace(attrs={"truth_position": many, "truth_amplitude": np.ones(40)}))
    _, out, _ = imaged(capsys, "many.npz", "--z", "0", *SPANS, "--truth")
    (line,) = (line for line in out.splitlines() if "targets" in line)
    assert "in this plane, found within" in line and len(out.splitlines()) < 15


def test_an_empty_image_ends_with_1(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = pysas.load_echoes(store / "raw.npz")
    silent = raw.replace(data=np.zeros_like(raw.data))
    blind = raw.replace(beam=pysas.Beam([0, -1, 0], 0.1, 0.5))
    bad = raw.replace(data=np.full_like(raw.data, np.nan))
    for echoes, options, text in ((silent, [], "every sample is 0"), (blind, [], "beam"), (bad, ["--nan", "mask"], "left out")):
        pysas.save("empty.npz", echoes)
        code, _, err = run(capsys, "image", "empty.npz", "-o", "y.npz", "--overwrite", *SPANS, *options)
        assert code == 1 and f"{text}" in err and "warning" in err


def test_info_speaks_of_extents_ranges_resolution_and_time(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "info", store / "utm.npz")
    raw = pysas.load_echoes(store / "utm.npz")
    assert code == 0 and f"tx         x {raw.tx[:, 0].min():.10g}"[:20] in out
    assert "direction  130.000 deg from x towards y, sonar at z = -37 m" in out and "default image," in out
    assert "in slant range" in out and "time       about" in out and "assumed" in out
    assert not any(word in out for word in ("interpolation", "rays", "transforms", "left out"))
    assert "interpolation" in run(capsys, "info", store / "utm.npz", "--plan")[1]
    values = json.loads(run(capsys, "info", store / "utm.npz", "--json")[1])
    assert values["track"]["tx"] == [raw.tx.min(axis=0).tolist(), raw.tx.max(axis=0).tolist()]
    assert (
        values["seconds"] > 0
        and len(values["grid_extents"][0]) == 2
        and "closed, sonar" in run(capsys, "info", store / "ring.npz")[1]
    )


@pytest.mark.parametrize(("name", "turned"), [("raw.npz", False), ("utm.npz", True)])
def test_compare_makes_a_line_of_an_array(
    name: str, turned: bool, store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Omega-k then finds the target, in the slant plane, at 0.2 m along the track's first metre."""
    images = []

    def one(echoes: pysas.Echoes, calls: Any, **_: Any) -> comparison.Comparison:
        images.append(calls["omega-k", "linear, zp 2"]())
        return comparison.Comparison(80, 560, (3, 3), (0.1, 0.1), (-13.0, -13.0), ())

    monkeypatch.setattr(comparison, "compare", one)
    monkeypatch.setattr(comparison, "table", lambda _: "")
    code, out, _ = run(capsys, "compare", store / name, "--altitude", "3", "--spacing", "0.05")
    assert code == 0 and "phase centres, made even (2 channels)" in out and ("turned by -130.000 deg" in out) == turned
    track = framing.course_of(pysas.load_echoes(store / name))
    x, y, _ = peak(images[0]) - [0, track.places[0, 1], 0]
    assert x - images[0].grid.axes["x"][0] == pytest.approx(1.2, abs=0.1) and y == pytest.approx(np.hypot(8, 3), abs=0.1)


def test_compare_says_why_there_is_no_line(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        comparison, "compare", lambda *_, **__: comparison.Comparison(80, 560, (3, 3), (0.1, 0.1), (-13.0, -13.0), ())
    )
    monkeypatch.setattr(comparison, "table", lambda _: "")
    code, out, _ = run(capsys, "compare", store / "ring.npz", "--altitude", "2", "--spacing", "0.05")
    assert code == 0 and "have no line to image, reference.phase_centres:" in out
