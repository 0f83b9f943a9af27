"""The command line end to end: the demo, images of known targets, checks, errors and exit codes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import pysas
from pysas import cli
from pysas.cli import demo_scene
from pysas.planning.framing import default_grid


def run(*arguments, capsys):
    code = cli.main([str(a) for a in arguments])
    out = capsys.readouterr()
    return code, out.out, out.err


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small survey with one known target, raw, in a file."""
    folder = tmp_path_factory.mktemp("cli")
    track = pysas.tracks.perturbed(40, 0.05, start=(-1.0, 0.0, 0.0), height=3.0, sway=0.02, seed=2)
    pulse = pysas.LFM(100e3, 15e3, 1e-3, "tukey", 0.3)
    raw = pysas.simulate(
        [[0.2, 8.0, 0.0]], [1.0], pulse, tx=track.position, rx=pysas.tracks.array(track, 2, 0.05), fs=40e3, duration=0.014,
        velocity=track.velocity, ping_time=track.time,
        attrs={"truth_position": np.array([[0.2, 8.0, 0.0]]), "truth_amplitude": np.ones(1)},
    )  # fmt: skip
    pysas.save(folder / "raw.npz", raw)
    return folder


def test_image_finds_the_target_and_writes_all(small, capsys):
    code, out, _ = run(
        "image", small / "raw.npz", "-o", small / "image.npz", "--png", small / "image.png", "--x", "-1:1", "--y", "7:9",
        "--spacing", "0.01", "--altitude", "3", "--truth", "--json", "--tol", "1e-4", capsys=capsys,
    )  # fmt: skip
    summary = json.loads(out)
    assert code == 0 and summary["shape"] == [201, 201] and summary["report"]["tol"] == 1e-4
    (target,) = summary["targets"]
    assert target["error_mm"] < 1.0
    assert (small / "image.png").read_bytes().startswith(b"\x89PNG")
    image = pysas.load(small / "image.npz")
    again, _, _ = run(
        "image", small / "raw.npz", "-o", small / "again.npz", "--grid", small / "image.npz", "--tol", "1e-4", capsys=capsys
    )
    assert again == 0 and np.array_equal(pysas.load(small / "again.npz").data, image.data)


def test_image_text_names_the_target(small, capsys):
    code, out, err = run(
        "image", small / "raw.npz", "-o", small / "text.npz", "--spacing", "0.02", "--z", "0", "--truth", capsys=capsys
    )
    assert code == 0 and "1 in this plane" in out and "imaging" in err and "compressed on the way: matched filter" in out


def test_info_of_both_kinds(small, capsys):
    code, out, _ = run("info", small / "raw.npz", "--plan", capsys=capsys)
    assert code == 0 and "40 pings x 2 channels" in out and "interpolation" in out and "left out" in out
    assert "predicted" in out and "alternatives" in out and "ffbp" in out
    run("image", small / "raw.npz", "-o", small / "for_info.npz", "--spacing", "0.05", capsys=capsys)
    code, out, _ = run("info", small / "for_info.npz", "--json", capsys=capsys)
    assert code == 0 and json.loads(out)["kind"] == "image"


def test_check_passes_and_fails(small, capsys):
    code, out, _ = run("check", small / "raw.npz", capsys=capsys)
    assert code == 0 and "FAIL" not in out
    raw = pysas.load(small / "raw.npz")
    data = raw.data.copy()
    data[3, 1, 7] = np.nan
    time = raw.ping_time.copy()
    time[5] = time[4]
    tx = raw.tx.copy()
    tx[20] += [0.0, 4.0, 0.0]
    cases = {
        "non-finite first at ping 3, channel 1, sample 7": {"data": data},
        "not increasing first at ping 5": {"ping_time": time},
        "first at ping 20": {"tx": tx},
        "below 1.1": {"bandwidth": 39e3},
        "above D/2": {"beam": pysas.Beam([0, 1, 0], 0.01, 1.0)},
    }
    for text, change in cases.items():
        pysas.save(small / "bad.npz", raw.replace(**change))
        code, out, _ = run("check", small / "bad.npz", capsys=capsys)
        assert code == 1 and text in out
    code, out, _ = run("check", small / "bad.npz", "--json", capsys=capsys)
    assert code == 1 and json.loads(out)["ok"] is False


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["image", "missing.npz", "-o", "x.npz"], "missing.npz"),
        (["image", "{raw}", "-o", "x.npz", "--tol", "1e-9"], "tol=1e-09"),
        (["image", "{raw}", "-o", "x.npz", "--tol", "nan"], "tol=nan"),
        (["image", "{raw}", "-o", "x.npz", "--threads", "0"], "threads=0"),
        (["image", "{raw}", "-o", "x.npz", "--spacing", "-1"], "spacing=-1"),
        (["image", "{raw}", "-o", "x.txt"], "x.txt"),
        (["image", "{raw}", "-o", "x.npz", "--x", "3:1"], "MIN below MAX"),
        (["image", "{raw}", "-o", "x.npz", "--grid", "{raw}"], "expected an image"),
        (["image", "{raw}", "-o", "x.npz", "--grid", "{raw}", "--z", "1"], "--grid"),
        (["simulate", "-o", "x.npz", "--points", "{csv}"], "x,y,z,amplitude"),
        (["info", "{csv}"], "points.csv"),
        (["nonsense"], "nonsense"),
    ],
)
def test_errors_are_one_line_and_exit_2(small, tmp_path, monkeypatch, capsys, arguments, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "points.csv").write_text("1,2\n")
    values = {"raw": str(small / "raw.npz"), "csv": str(tmp_path / "points.csv")}
    before = sorted(tmp_path.iterdir())
    try:
        code = cli.main([a.format(**values) for a in arguments])
    except SystemExit as stop:  # argparse's own errors
        code = stop.code
    out = capsys.readouterr()
    assert code == 2 and out.out == ""
    lines = [line for line in out.err.splitlines() if line.startswith("pysas: error: ")]
    assert len(lines) == 1 and text in lines[0] and "Traceback" not in out.err
    assert sorted(tmp_path.iterdir()) == before  # nothing half-written


def test_grid_outside_the_record_warns(small, capsys):
    code, _, err = run(
        "image", small / "raw.npz", "-o", small / "far.npz", "--x", "0:1", "--y", "90:91", "--spacing", "0.1", capsys=capsys
    )
    assert code == 1 and "pysas: warning: the grid lies outside the recorded window" in err
    assert not pysas.load(small / "far.npz").data.any()


def test_simulate_from_points(tmp_path, capsys):
    (tmp_path / "points.csv").write_text("0,10,0,1\n1,12,0,0.5\n")
    code, out, _ = run(
        "simulate", "-o", tmp_path / "raw.npz", "--points", tmp_path / "points.csv", "--pings", 8, "--channels", 2, "--json",
        capsys=capsys,
    )  # fmt: skip
    raw = pysas.load(tmp_path / "raw.npz")
    assert code == 0 and json.loads(out)["shape"] == list(raw.data.shape) and raw.n_ping == 8 and raw.n_channel == 2
    assert np.array_equal(raw.attrs["truth_position"], [[0, 10, 0], [1, 12, 0]])


def test_demo_in_a_process(tmp_path):
    """The whole demo as a user runs it: files, targets within 2 mm under noise, error below tol."""
    result = subprocess.run(
        [sys.executable, "-c", "import sys; from pysas.cli import main; sys.exit(main(['demo', '-o', 'results', '--json']))"],
        cwd=tmp_path, capture_output=True, text=True, timeout=240, env=os.environ | {"MPLBACKEND": "Agg"}, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    summary = json.loads(result.stdout)
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == [
        "image.npz", "image.png", "raw.npz", "report.json", "report.txt",
    ]  # fmt: skip
    assert summary["measured_error"] <= summary["tol"] == 1e-3
    assert len(summary["targets"]) >= 30 and max(t["error_mm"] for t in summary["targets"]) < 2.0


def test_demo_scene_has_its_dark_object():
    points, amplitudes, targets = demo_scene._scene(1)
    assert targets >= 30
    floor, strength = points[targets:], np.abs(amplitudes[targets:])
    inside = np.hypot(floor[:, 0] + 3.0, floor[:, 1] - 23.7) < 0.3  # the hull's middle
    assert strength[inside].max() < 0.1 * np.median(strength)


@pytest.mark.parametrize(
    ("name", "heights"), [("stripmap_perturbed", (8.0, 7.5, 7.2)), ("circular", (5.0, 4.8))], ids=["stripmap", "circular"]
)
@pytest.mark.parametrize("method", ["backprojection", "ffbp"])
def test_every_target_of_data_made_elsewhere_within_1_mm(data_dir, name, heights, method, capsys):
    """truth_position of the openSTB-simulated files; one run per depth on the default grid, cropped for speed."""
    truth = pysas.load(data_dir / f"{name}.npz").attrs["truth_position"]
    found = 0
    for z in heights:
        here = truth[np.abs(truth[:, 2] - z) < 1e-3]
        spans = [f"{v.min() - 0.3}:{v.max() + 0.3}" for v in here.T[:2]]
        code, out, _ = run(
            "image", data_dir / f"{name}.npz", "--z", z, f"--x={spans[0]}", f"--y={spans[1]}", "--truth", "--json", "--method",
            method, capsys=capsys,
        )  # fmt: skip
        targets = json.loads(out)["targets"]
        assert code == 0 and max(t["error_mm"] for t in targets) < 1.0
        found += len(targets)
    assert found == len(truth)


def test_default_grid_covers_what_the_geometry_hears(small):
    raw = pysas.load(small / "raw.npz")
    grid, how = default_grid(raw, 0.0)
    x, y = grid.axes["x"], grid.axes["y"]
    far = np.sqrt((1500 / 2 * ((raw.n_sample - 1) / raw.fs - 0.5e-3)) ** 2 - 3.0**2)
    assert "+y side" in how and x.min() < -0.9 and x.max() > 0.9 and 0.9 * far < y.max() < far
    beam = pysas.Beam([0.0, -1.0, 0.0], 0.1, 0.5)
    assert default_grid(raw.replace(beam=beam), 0.0)[0].axes["y"].max() < 0
    with pytest.raises(ValueError, match="beyond the record"):
        default_grid(raw, z=-100.0)
    ring = pysas.tracks.circular(64, 5.0)
    data = np.ones((64, 400), dtype=np.complex64)
    square, how = default_grid(pysas.Echoes(data, fs=40e3, fc=100e3, tx=ring.position, rx=ring.position, bandwidth=30e3), 0.0)
    assert "closed" in how and square.shape[0] == square.shape[1]
    # every pixel within every ping's record: farthest corner from the farthest ping
    corner = np.hypot(square.axes["x"].max(), square.axes["y"].max())
    assert 2 * (5.0 + corner) / 1500 <= 399 / 40e3


def test_raw_traces_with_nan_can_be_left_out(small, tmp_path, capsys):
    """The image is that of the same echoes with those traces silent."""
    raw = pysas.load(small / "raw.npz")
    data, silent = raw.data.copy(), raw.data.copy()
    data[7, 1, 100], silent[7, 1] = np.nan, 0
    options = ["--x", "-1:1", "--y", "7:9", "--spacing", "0.05"]
    for name, samples in (("nan", data), ("silent", silent)):
        pysas.save(tmp_path / f"{name}.npz", raw.replace(data=samples))
        code, _, err = run(
            "image", tmp_path / f"{name}.npz", "-o", tmp_path / f"{name}_image.npz", "--nan", "mask", *options, capsys=capsys
        )
        assert code == 0 and ("1 of 80 traces left out" in err) == (name == "nan")
    images = [pysas.load(tmp_path / f"{name}_image.npz").data for name in ("nan", "silent")]
    assert np.array_equal(*images)
    code, _, err = run("image", tmp_path / "nan.npz", "-o", tmp_path / "x.npz", *options, capsys=capsys)
    assert code == 2 and "ping 7, channel 1" in err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--x", "-1:1", "--y", "7:9", "--spacing", "0"], "spacing=0"),
        (["--x", "0.3:0.9", "--y", "7:9", "--spacing", "100"], "no multiple of it within 0.3 to 0.9"),
        (["--x", "0.3:0.9", "--spacing", "100"], "no multiple of it within"),
        (["-o", "nowhere/x.npz"], "no such folder"),
        (["-o", "x.mat"], "expected .npz or .h5"),
        (["--png", "nowhere/x.png"], "no such folder"),
        (["--tol", "1e-9"], "tol=1e-09"),
    ],
)
def test_what_cannot_be_done_is_said_before_the_work(small, tmp_path, monkeypatch, capsys, arguments, text):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(
        "image", small / "raw.npz", *(arguments if "-o" in arguments else ["-o", "x.npz", *arguments]), capsys=capsys
    )
    assert code == 2 and text in err and "compressing" not in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_info_of_echoes_that_cannot_be_imaged(small, tmp_path, capsys):
    raw = pysas.load(small / "raw.npz")
    for name, changes, text in (
        ("under", {"bandwidth": 39e3}, "expected at least 1.1"),
        ("far", {"attrs": {"altitude": 500.0}}, "no plan: z=-497"),
    ):
        pysas.save(tmp_path / f"{name}.npz", raw.replace(**changes))
        code, out, _ = run("info", tmp_path / f"{name}.npz", capsys=capsys)
        assert code == 0 and "40 pings x 2 channels" in out and text in out


@pytest.mark.skipif(sys.platform == "win32", reason="no such pipes there")
def test_a_reader_that_stops_reading_is_no_error(small):
    code = "import sys; from pysas.cli import main; sys.exit(main(['info', sys.argv[1], '--plan']))"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(small / "raw.npz")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    process.wait(60)
    assert "error" not in err.lower() and "Traceback" not in err
