"""Results of openSTB-simulator: files of its structure with echoes by plain formulas here, read and imaged.

Positions, quaternions and travel times follow the simulator's conventions (0.9.0: system/trajectory.py, utils/quaternion.py,
travel_time/, system/signal.py), written down here a second time; pysas' simulator takes no part.
"""

from __future__ import annotations

import json
import random
import re
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import zarr
from damaged_copies import mutated
from test_io import same

import pysas
from pysas import cli

FS, FB, C = 30e3, 110e3, 1480.0
START, STOP, DURATION, ALPHA = 100e3, 120e3, 3e-3, 0.2
TX, RX = np.array([0.0, 1.2, 0.3]), np.array([[-0.05, 1.2, 0.0], [0.05, 1.2, 0.1]])
PINGS = 0.1 * np.arange(13)  # s
SAMPLES = 1200
PIXEL = 1e-2  # m

LINEAR = """[trajectory]
plugin = "linear"
start_position = [0.3, 0.1, 0.05]
end_position = [2.4, 0.4, 0.15]
speed = 1.5
"""
CIRCULAR = """[trajectory]
plugin = "circular"
centre = [1.0, -2.0, 0.5]
radius = 6.0
speed = 3.0
clockwise = {clockwise}
start_angle = 200
"""
ORIENTATION = "orientation = [0.70105738, 0.09229596, -0.09229596, 0.70105738]"
CONFIG = f"""
[controller]
plugin = "simple_points"
result_filename = "result.zarr"
points_per_chunk = 500
sample_rate = {FS}
baseband_frequency = {FB}

[system]
plugin = "generic"
[system.transmitter]
plugin = "generic"
position = {TX.tolist()}
{ORIENTATION}
[system.transmitter.beampattern]
plugin = "rectangular_beampattern"
width = 0.015
[system.signal]
plugin = "lfm_chirp"
f_start = {START}
f_stop = {STOP}
duration = {DURATION}
rms_spl = 190
window = {{plugin="tukey", alpha={ALPHA}}}
[[system.receivers]]
plugin = "generic"
position = {RX[0].tolist()}
{ORIENTATION}
[[system.receivers]]
plugin = "generic"
position = {RX[1].tolist()}
{ORIENTATION}

[environment]
plugin = "invariant"
sound_speed = {C}

"""


def config(trajectory: str, travel: str, target: np.ndarray, more: str = "") -> str:
    targets = f'[[targets]]\nplugin = "single_point"\nposition = {target.tolist()}\nreflectivity = 10\n'
    area = '[[targets]]\nplugin = "random_point_rectangle"\nseed = 1\n'
    return f'{CONFIG}{trajectory}\n[travel_time]\nplugin = "{travel}"\n{targets}{area}{more}'


Pose = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # of times (n,): position (n, 3), quaternion (n, 4)


def straight(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first, last = np.array([0.3, 0.1, 0.05]), np.array([2.4, 0.4, 0.15])
    ahead = (last - first) / np.linalg.norm(last - first)
    axis = np.cross([1.0, 0, 0], ahead)
    angle = np.arccos(ahead[0])
    turn = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis / np.linalg.norm(axis))])
    return first + 1.5 * t[:, None] * ahead, np.tile(turn, (t.size, 1))


def circle(sign: int) -> Pose:
    """Clockwise (1) from the x axis towards the y axis."""

    def pose(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = np.radians(200) + sign * 3.0 / 6.0 * t
        zero = np.zeros(t.size)
        place = np.array([1.0, -2.0, 0.5]) + 6 * np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
        half = (angle + sign * np.pi / 2) / 2
        return place, np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)

    return pose


def arm(pose: Pose, t: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Place of a transducer at times (n,), (n, 3): turned by quaternions."""
    centre, q = pose(t)
    w, v = q[:, :1], q[:, 1:]
    return np.asarray(centre + place + 2 * np.cross(v, w * place + np.cross(v, np.broadcast_to(place, v.shape))))


def chirp(t: np.ndarray) -> np.ndarray:
    edge = np.minimum(t, DURATION - t) / (DURATION * ALPHA / 2)
    window = np.where(edge >= 1, 1.0, 0.5 * (1 - np.cos(np.pi * np.clip(edge, 0, 1)))) * ((t >= 0) & (t <= DURATION))
    return np.asarray(window * np.exp(1j * np.pi * t * (2 * (START - FB) + (STOP - START) / DURATION * t)))


def pressure(pose: Pose, moving: bool, target: np.ndarray) -> np.ndarray:
    """Echoes of one target in base-band, (ping, receiver, sample)."""
    traces = []
    for receiver in RX:
        out = np.linalg.norm(target - arm(pose, PINGS, TX), axis=1) / C
        tau = 2 * out
        for _ in range(30):
            tau = out + np.linalg.norm(target - arm(pose, PINGS + moving * tau, receiver), axis=1) / C
        t = np.arange(SAMPLES) / FS - tau[:, None]
        traces.append(10 * chirp(t) * np.exp(-2j * np.pi * FB * tau)[:, None])
    return np.stack(traces, axis=1)


def write(path: Path, values: np.ndarray) -> Path:
    """A result in the form that the name says, as the simulator and its converters write it."""
    if path.suffix == ".zarr":
        group = zarr.create_group(store=zarr.storage.LocalStore(path))
        parts = {"pressure": values, "sample_time": np.arange(values.shape[2]) / FS, "ping_start_time": PINGS[: len(values)]}
        for name, array in parts.items():
            chunks = (1, 1, array.shape[2]) if array.ndim == 3 else array.shape
            made = group.zeros(name=name, shape=array.shape, chunks=chunks, dtype=array.dtype)
            made[:] = array
        group.attrs["baseband_frequency"], group.attrs["sample_rate"] = FB, FS
        return path
    fields = {
        "ping_start_time": PINGS[: len(values)], "sample_time": np.arange(values.shape[2]) / FS, "pressure": values,
        "pressure_dimensions": ["ping", "channel", "sample_time"], "baseband_frequency": FB,
    }  # fmt: skip
    if path.suffix == ".npz":
        np.savez(path, **fields)
    else:
        scipy.io.savemat(path, fields, appendmat=False, do_compression=True)
    return path


FAR, INSIDE = np.array([1.4, 20.0, 6.0]), np.array([0.8, -2.3, 3.0])
CASES: dict[str, tuple[str, Pose, np.ndarray]] = {
    "linear": (LINEAR, straight, FAR),
    "clockwise": (CIRCULAR.format(clockwise="true"), circle(1), INSIDE),
    "anticlockwise": (CIRCULAR.format(clockwise="false"), circle(-1), INSIDE),
}


def offset(echoes: pysas.Echoes, target: np.ndarray) -> np.ndarray:
    """Of an image's peak from the target (x, y), m."""
    side = PIXEL * np.arange(-12, 13)
    grid = pysas.Grid.plane(target[0] + side, target[1] + side, z=float(target[2]))
    level = np.log(np.abs(np.asarray(pysas.backproject(pysas.compress(echoes), grid, tol=1e-4).data)))
    row, column = np.unravel_index(int(np.argmax(level)), level.shape)

    def vertex(a: float, b: float, c: float) -> float:
        return float(0.5 * (a - c) / (a - 2 * b + c))

    x = column - 12 + vertex(*level[row, column - 1 : column + 2])
    return PIXEL * np.array([x, row - 12 + vertex(*level[row - 1 : row + 2, column])])


@pytest.mark.parametrize("travel", ["stop_and_hop", "iterative"])
@pytest.mark.parametrize("case", CASES)
def test_the_target_lies_where_it_is(case: str, travel: str, tmp_path: Path) -> None:
    trajectory, pose, target = CASES[case]
    moving = travel == "iterative"
    path = write(tmp_path / "result.npz", pressure(pose, moving, target))
    path.with_suffix(".toml").write_text(config(trajectory, travel, target))
    raw = pysas.load(path)
    assert isinstance(raw, pysas.Echoes) and (raw.velocity is not None) == moving
    np.testing.assert_allclose(raw.tx, arm(pose, PINGS, TX), atol=1e-12)
    for channel, place in enumerate(RX):
        np.testing.assert_allclose(raw.rx[:, channel], arm(pose, PINGS, place), atol=1e-12)
        if moving:
            step = (arm(pose, PINGS + 1e-6, place) - arm(pose, PINGS - 1e-6, place)) / 2e-6
            np.testing.assert_allclose(raw.velocity[:, channel], step, atol=1e-8)  # type: ignore[index]
    assert np.max(np.abs(offset(raw, target))) < 0.1 * PIXEL
    if case == "linear" and moving:  # and 20 mm aside where the motion is left out: the check can fail
        assert np.max(np.abs(offset(raw.replace(velocity=None), target))) > PIXEL


@pytest.mark.parametrize("name", ["result.zarr", "result.npz", "result.mat"])
def test_every_container(name: str, tmp_path: Path) -> None:
    values = pressure(straight, False, FAR)
    path = write(tmp_path / name, values)
    beside = path.with_suffix(".toml")
    beside.write_text(config(LINEAR, "stop_and_hop", FAR))
    raw = pysas.load(path)
    np.testing.assert_array_equal(raw.data, values)
    assert (raw.fs, raw.fc, raw.c, raw.t0, raw.compressed) == (FS, FB, C, 0.0, False)
    assert raw.pulse == pysas.LFM(110e3, 20e3, 3e-3, "tukey", 0.2)
    np.testing.assert_array_equal(raw.ping_time, PINGS)
    np.testing.assert_array_equal(raw.attrs["truth_position"], FAR[None])
    assert raw.attrs["truth_amplitude"] == [10.0]


def test_the_configuration_names_the_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = pressure(straight, False, FAR)
    write(tmp_path / "result.zarr", values)
    (tmp_path / "a.toml").write_text(config(LINEAR, "stop_and_hop", FAR))
    write(tmp_path / "other.mat", values)
    more = '[result_converter]\nplugin = "matlab"\nfilename = "other.mat"\n'
    (tmp_path / "b.toml").write_text(config(LINEAR, "stop_and_hop", FAR, more))
    for name in ("a.toml", "b.toml"):
        np.testing.assert_array_equal(pysas.load(tmp_path / name).data, values)
    (tmp_path / "result.toml").write_text(config(LINEAR, "stop_and_hop", FAR))
    for command in ("info", "check"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pings that are far apart
            cli.main([command, str(tmp_path / "result.zarr")])
        assert "13 pings" in capsys.readouterr().out or command == "check"
    spans = ["--z", "6", "--x", "1.3:1.5", "--y", "19.9:20.1", "--spacing", "0.01", "--truth"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pings that are far apart
        assert cli.main(["image", str(tmp_path / "a.toml"), *spans, "-o", str(tmp_path / "x.npz")]) == 0
    assert "target" in capsys.readouterr().out


def test_a_result_and_its_configuration_are_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By what is made of them: neither holds what the other does."""
    path = write(tmp_path / "a.npz", pressure(straight, False, FAR))
    more = '[result_converter]\nplugin = "numpy"\nfilename = "a.npz"\n'
    path.with_suffix(".toml").write_text(config(LINEAR, "stop_and_hop", FAR, more))
    before = path.read_bytes()
    assert cli.main(["convert", str(tmp_path / "a.toml"), str(path), "--overwrite"]) == 2
    assert "is read by this command" in capsys.readouterr().err and path.read_bytes() == before


@pytest.mark.parametrize("name", ["result.npz", "result.mat"])
def test_a_header_gives_the_geometry_of_any_simulation(name: str, tmp_path: Path) -> None:
    values = pressure(straight, True, FAR)
    write(tmp_path / name, values)
    (tmp_path / "result.toml").write_text(config(LINEAR, "iterative", FAR))
    whole = pysas.load(tmp_path / name)
    header = {
        "header": "pysas-arrays-1", "units": "m, s, Hz", "axes": "ping channel sample", "phase": "exp(-j)",
        "data": {"file": name, "name": "pressure"}, "fc": {"file": name, "name": "baseband_frequency"}, "fs": FS, "c": C,
        "t0": 0.0, "compressed": False, "tx": whole.tx.tolist(), "rx": whole.rx.tolist(),
        "velocity": np.asarray(whole.velocity).tolist(), "ping_time": {"file": name, "name": "ping_start_time"},
        "pulse_kind": "lfm", "pulse_fc": 110e3, "pulse_bandwidth": 20e3, "pulse_duration": DURATION, "pulse_window": "tukey",
        "pulse_window_parameter": ALPHA,
    }  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps(header))
    assert same(pysas.load(tmp_path / "a.json"), whole.replace(attrs={}))


def test_other_windows(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", pressure(straight, False, FAR)[:, :, :900])
    text = config(LINEAR, "stop_and_hop", FAR)
    window = f'window = {{plugin="tukey", alpha={ALPHA}}}\n'
    path.with_suffix(".toml").write_text(text.replace(window, ""))
    assert pysas.load(path).pulse == pysas.LFM(110e3, 20e3, 3e-3)
    path.with_suffix(".toml").write_text(text.replace(window, 'window = {plugin="hann"}\n'))
    assert pysas.load(path).pulse == pysas.LFM(110e3, 20e3, 3e-3, "tukey", 1.0)


def test_a_track_that_is_almost_along_x(tmp_path: Path) -> None:
    """Within 1e-5 of parallel, by the cosine, the simulator turns by the angle about z, whichever way it was; backwards too."""
    path = write(tmp_path / "a.npz", np.zeros((3, 2, 5), complex))
    for end, angle in (([10.0, 0.0, 0.02], np.arccos(10 / np.hypot(10, 0.02))), ([-10.0, 0.0, 0.0], np.pi)):
        text = (
            config(LINEAR, "stop_and_hop", FAR).replace("[0.3, 0.1, 0.05]", "[0, 0, 0]").replace("[2.4, 0.4, 0.15]", f"{end}")
        )
        path.with_suffix(".toml").write_text(text)
        cos, sin = np.cos(angle), np.sin(angle)
        np.testing.assert_allclose(pysas.load(path).tx[0], [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]] @ TX, atol=1e-12)


# What is missing or wrong


def swapped(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


WRONG: dict[str, tuple[Callable[[str], str], str]] = {
    "no TOML": (lambda text: text + "[", "a.toml: found no TOML"),
    "an include": (lambda text: 'include = ["b.toml"]\n' + text, "a.toml: include: expected one file"),
    "another trajectory": (swapped('"linear"', '"spline"'), "trajectory.plugin: found 'spline', expected linear or circular"),
    "no trajectory": (swapped("[trajectory]", "[track]"), "trajectory: missing, expected a table"),
    "no length": (swapped("[2.4, 0.4, 0.15]", "[0.3, 0.1, 0.05]"), "trajectory.end_position: found the start's"),
    "no radius": (
        swapped('"linear"', '"circular"\nclockwise = true\nradius = 0.0'),
        "trajectory.radius: found 0, expected > 0",
    ),
    "no speed": (swapped("speed = 1.5", ""), "trajectory.speed=None: expected a finite number"),
    "a place of two": (
        swapped("[0.3, 0.1, 0.05]", "[0.3, 0.1]"),
        r"trajectory.start_position: found \[0.3, 0.1\], expected three",
    ),
    "a receiver less": (swapped("[[system.receivers]]", "[[system.other]]"), "system.receivers: missing, expected 2"),
    "another signal": (swapped("lfm_chirp", "hfm_chirp"), "system.signal.plugin: found 'hfm_chirp', expected lfm_chirp"),
    "another window": (swapped('"tukey"', '"hamming"'), "system.signal.window.plugin: found 'hamming', expected tukey"),
    "another medium": (swapped("invariant", "layers"), "environment.plugin: found 'layers', expected invariant"),
    "other travel times": (swapped("stop_and_hop", "rays"), "travel_time.plugin: found 'rays', expected stop_and_hop or"),
    "a speed in words": (swapped(f"{C}", '"fast"'), "environment.sound_speed='fast': expected a finite number"),
    "not finite": (swapped(f"{C}", "nan"), "environment.sound_speed=nan"),
    "a sweep below zero": (swapped(f"f_stop = {STOP}", "f_stop = -1e6"), "fc=-450000.0: expected a finite number > 0"),
    "gigabytes": (lambda text: text + "\n" * 2**20, "a.toml: found more than 1048576 bytes"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_configuration_that_is_wrong(case: str, tmp_path: Path) -> None:
    change, message = WRONG[case]
    path = write(tmp_path / "a.npz", np.zeros((13, 2, 20), complex))
    path.with_suffix(".toml").write_text(change(config(LINEAR, "stop_and_hop", FAR)))
    with pytest.raises(ValueError, match=message) as caught:
        pysas.load(path)
    assert str(tmp_path / "a.") in str(caught.value) and type(caught.value) is ValueError


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pressure": np.zeros((13, 2, 20))}, "pressure: found float64 of shape .*expected complex"),
        ({"pressure": np.zeros((13, 2, 21), complex)}, r"expected complex \(ping=13, receiver, sample=20\)"),
        ({"pressure": np.zeros((13, 3, 20), complex)}, "system.receivers: found 2, expected 3"),
        ({"sample_time": np.arange(20.0) ** 2}, "sample_time: found unequal intervals"),
        ({"sample_time": np.zeros(20)}, "sample_time: found no rising times"),
        ({"ping_start_time": np.full(13, np.nan)}, "tx: nan at ping 0"),
        ({"baseband_frequency": 0.0}, r"fc=0\.0: expected a finite number > 0"),
        ({"baseband_frequency": None}, "baseband_frequency: missing, expected real numbers"),
    ],
)
def test_a_result_that_is_wrong(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", np.zeros((13, 2, 20), complex))
    with np.load(path) as file:
        fields = {name: value for name, value in (dict(file) | change).items() if value is not None}
    np.savez(path, **fields)
    path.with_suffix(".toml").write_text(config(LINEAR, "stop_and_hop", FAR))
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}: .*{message}"):
        pysas.load(path)


def test_a_result_alone_says_what_it_needs(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", np.zeros((13, 2, 20), complex))
    with pytest.raises(FileNotFoundError, match=r"a\.npz: needs the simulation's configuration as .*a\.toml"):
        pysas.load(path)
    (tmp_path / "b.toml").write_text(config(LINEAR, "stop_and_hop", FAR))
    with pytest.raises(FileNotFoundError, match=r"result\.zarr"):
        pysas.load(tmp_path / "b.toml")
    with pytest.raises(ValueError, match="channel='1': a file of format openstb is read whole"):
        pysas.load(path, channel="1")


def test_a_group_that_claims_more_than_it_has(tmp_path: Path) -> None:
    path = write(tmp_path / "a.zarr", np.zeros((13, 2, 20), complex))
    path.with_suffix(".toml").write_text(config(LINEAR, "stop_and_hop", FAR))
    for name, old, new, message in (
        (
            "sample_time",
            '"shape": [\n    20',
            f'"shape": [\n    {10**15}',
            "sample_time: found 8.* bytes declared",
        ),
        ("pressure", '"zstd"', '"blosc"', "pressure: "),
    ):
        shutil.copytree(path, tmp_path / "b.zarr")
        shutil.copy(path.with_suffix(".toml"), tmp_path / "b.toml")
        header = tmp_path / "b.zarr" / name / "zarr.json"
        text = header.read_text()
        assert old in text
        header.write_text(text.replace(old, new))
        with pytest.raises(ValueError, match=rf"b\.zarr: {message}"):
            pysas.load(tmp_path / "b.zarr")
        shutil.rmtree(tmp_path / "b.zarr")


@pytest.mark.parametrize(
    "kind", ["a.npz", "a.mat", "a.zarr/zarr.json", "a.zarr/pressure/zarr.json", "a.zarr/pressure/c/1/1/0", "a.toml"]
)
def test_damage(kind: str, tmp_path: Path) -> None:
    """200 mutated copies: an error that names a file, the same, or other numbers where no checksum can tell."""
    values = np.random.default_rng(2).standard_normal((3, 2, 20, 2)).view(complex)[..., 0]
    path = write(tmp_path / (kind.partition("/")[0] if kind != "a.toml" else "a.npz"), values)
    path.with_suffix(".toml").write_text(config(LINEAR, "iterative", FAR))
    target = tmp_path / kind
    good, expected = target.read_bytes(), pysas.load(path)
    errors, others = 0, 0
    swaps = ((b"complex128", b"float64"), (b"<c16", b"<f16"), (b"c16", b"c8"), (b"linear", b"circular"), (b"[", b"{"))
    for content in mutated(good, random.Random(5), 200, swaps):
        target.write_bytes(content)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                loaded = pysas.load(path)
        except (ValueError, OSError) as error:
            errors += 1
            assert str(tmp_path) in str(error), error
            continue
        others += not same(loaded, expected)
        assert isinstance(loaded, pysas.Echoes)
    assert errors >= 25
    if kind == "a.npz":
        assert others == 0
