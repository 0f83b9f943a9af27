"""`pysas navigate` and `pysas image --motion`: a file whose track is a straight claim, and what becomes of it."""

import json

import numpy as np
import pytest
from motion_scenes import arms, scene

import pysas
from pysas.cli.program import main
from pysas.motion.improving import improved

# estimators, not engines: what these read is held to tolerance on every engine by test_contributions.py
pytestmark = pytest.mark.cpp

SPANS = ["--x", "-2:2", "--y", "21:30", "--z", "8", "--spacing", "0.04", "0.02"]


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A short line with its claim, raw as it would be kept, and the echoes with the true track."""
    echoes, claim, truth = scene(pings=24, swath=(20.0, 32.0), density=30.0, targets=((-0.5, 22.0), (0.4, 26.0)), seed=3)
    folder = tmp_path_factory.mktemp("navigate")
    pysas.save(folder / "line.npz", claim)
    return folder, echoes, claim, truth


def test_navigate_writes_the_track_that_it_finds(line, tmp_path, capsys):
    folder, echoes, claim, _ = line
    fixed, png = tmp_path / "fixed.npz", tmp_path / "track.png"
    command = ["navigate", str(folder / "line.npz"), "-o", str(fixed), "--motion", "micronavigation", *SPANS]
    assert main([*command, "--png", str(png), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["fixed"] == str(fixed) and told["changed"] and told["micronavigation"]["found"] and png.stat().st_size > 10_000
    found = pysas.load_echoes(fixed)
    assert np.array_equal(found.data, claim.data) and "micronavigation" in found.attrs["motion"]
    before, after = (pysas.metrics.track_error(one, echoes, 26.0, seabed=8.0) for one in (claim, found))
    assert after < 0.5e-3 < 2e-3 < before
    assert main(command) == 2  # the file is there
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0
    out = capsys.readouterr().out
    assert "found: 23 of 23 pairs of pings correlate" in out and "not seen" in out and "pysas image fixed.npz --z 8" in out


def test_image_finds_the_track_on_the_way(line, tmp_path, capsys):
    folder, echoes, _, _ = line
    out = tmp_path / "image.npz"
    command = ["image", str(folder / "line.npz"), "-o", str(out), *SPANS]
    levels = {}
    for motion in ("none", "auto"):
        assert main([*command, "--motion", motion, "--overwrite"]) == 0
        image = pysas.load_image(out)
        levels[motion] = 20 * np.log10(np.max(np.abs(image.data)))
        said = capsys.readouterr().out
        assert ("Motion: 24 pings, found" in said) == (motion == "auto")
    best = 20 * np.log10(np.max(np.abs(pysas.focus(echoes, image.grid, 1e-3).data)))
    assert levels["auto"] > best - 1 and levels["none"] < best - 2


def test_any_grid_tells_the_height(line):
    """A grid of points, a volume or a polar one has its height in its coordinates."""
    _, _, claim, _ = line
    x, y = np.arange(-1.0, 1.0, 0.5), np.arange(22.0, 24.0, 0.5)
    plane = pysas.Grid.plane(x, y, 8.0)
    expected = improved(claim, plane, "micronavigation").motion
    polar = pysas.Grid.polar(y, [1.5, 1.6], (0.0, 0.0, 8.0))
    for grid in (pysas.Grid.points(plane.coordinates()), pysas.Grid.volume(x, y, [8.0]), polar):
        assert np.array_equal(improved(claim, grid, "micronavigation").motion.shift, expected.shift)


def test_noise_leaves_the_track_alone(line, tmp_path, capsys):
    """Exit code 1, nothing written, and why."""
    _, _, claim, _ = line
    rng = np.random.default_rng(0)
    data = rng.standard_normal((*claim.data.shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    pysas.save(tmp_path / "noise.npz", claim.replace(data=data))
    fixed = tmp_path / "fixed.npz"
    assert main(["navigate", str(tmp_path / "noise.npz"), "-o", str(fixed), *SPANS]) == 1
    out = capsys.readouterr().out
    assert not fixed.exists() and "not written" in out and "nothing found, track unchanged" in out


def test_what_cannot_be_navigated_is_told(line, tmp_path, capsys):
    _, _, claim, _ = line
    pysas.save(tmp_path / "bare.npz", claim.replace(beam=None))
    command = ["navigate", str(tmp_path / "bare.npz"), "-o", str(tmp_path / "fixed.npz"), "--motion", "micronavigation", *SPANS]
    assert main(command) == 2
    assert "beam=None: expected a pysas.Beam" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["image", str(tmp_path / "bare.npz"), "--motion", "by hand"])
    assert "invalid choice: 'by hand'" in capsys.readouterr().err


def test_raw_echoes_stay_raw(tmp_path, capsys):
    """What is written is what was read, samples and pulse, with another track."""
    _, claim, _ = scene(pings=8, swath=(20.0, 26.0), density=30.0, targets=(), seed=4)
    pulse = pysas.LFM(100e3, 20e3, 0.2e-3)
    noise = np.random.default_rng(1).standard_normal((*claim.data.shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    raw = claim.replace(data=claim.data + 0.01 * noise, pulse=pulse, compressed=False, bandwidth=None)
    track = pysas.tracks.straight(8, 0.2, start=(-0.7, 0, 0))
    raw = raw.replace(**arms(track, raw.n_channel))
    pysas.save(tmp_path / "raw.npz", raw)
    code = main(
        ["navigate", str(tmp_path / "raw.npz"), "-o", str(tmp_path / "fixed.npz"), "--motion", "micronavigation", *SPANS]
    )
    capsys.readouterr()
    assert code == 0
    fixed = pysas.load_echoes(tmp_path / "fixed.npz")
    assert not fixed.compressed and np.array_equal(fixed.data, raw.data) and not np.array_equal(fixed.tx, raw.tx)
