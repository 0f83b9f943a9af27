"""Results of openSTB-simulator (0.9.0): pressure in complex base-band as a Zarr group, .npz or .mat.

They hold no geometry: the simulation's configuration in TOML does, which is looked for beside a result under the result's name
(x.npz, x.toml), or is itself what is loaded, where it names the result. Its frame is kept: x, y and z downwards. Quaternions
are (w, x, y, z) and turn vectors of the vehicle's frame, x ahead, y to starboard, z down, into that frame.
"""

from __future__ import annotations

import contextlib
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files, io, matlab_variables, stores
from pysas.formats.fields import Array, File, allocated, blamed
from pysas.formats.format import Format, Item, Look
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

_ARRAYS = ("pressure", "sample_time", "ping_start_time")
_MOST_TEXT = 2**20  # bytes of a configuration
_MOST_CHUNK = 2**28
_MOST_EXPANSION = 2**17  # of zstd, whose blocks of 128 KiB may be a few bytes
_CODECS = {"zstd"}
_EVEN = 1e-6  # of a sample's interval, by which sample times may be off

Table = dict[str, Any]


def _sniff(look: Look) -> bool:
    if look.suffix == ".toml":
        return b"[controller]" in look.head or b"[trajectory]" in look.head or b"[system" in look.head
    if look.folder:
        return all((Path(look.path) / name).is_dir() for name in _ARRAYS)
    return set(_ARRAYS) <= look.entries.keys()


def _read(path: str, channel: str | None) -> Item:
    if Path(path).suffix.lower() == ".toml":
        config, result = _configuration(path), None
        with files.naming(path):
            result = str(Path(path).parent / _result(config))
        return _echoes(result, path, config)
    beside = Path(path).with_suffix(".toml")
    if not beside.is_file():
        raise FileNotFoundError(
            f"{path}: needs the simulation's configuration as {beside}, which is missing; or a header (docs/formats.md)"
        )
    return _echoes(path, str(beside), _configuration(str(beside)))


def _beside(path: str) -> list[str]:
    """The configuration of a result, or the result of a configuration."""
    with contextlib.suppress(Exception):  # reading will tell
        if Path(path).suffix.lower() == ".toml":
            return [files.name(Path(path).parent / _result(_configuration(path)))]
        return [str(Path(path).with_suffix(".toml"))]
    return []


def _configuration(path: str) -> Table:
    content = files.small(path, _MOST_TEXT, "a configuration")
    try:
        config = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: found no TOML: {error or type(error).__name__}") from None
    if "include" in config:
        raise ValueError(f"{path}: include: expected one file with the whole configuration")
    return config


def _result(config: Table) -> str:
    """The name of the file that a simulation left: of its converter, where it has one."""
    if "result_converter" in config:
        return _text(_table(config, "result_converter"), "result_converter", "filename")
    return _text(_table(config, "controller"), "controller", "result_filename")


def _echoes(path: str, beside: str, config: Table) -> Echoes:
    with _opened(path) as file, io.named(path):
        for name in _ARRAYS:
            if name not in file.fields:
                raise ValueError(f"{name}: missing, expected {', '.join(_ARRAYS)} and baseband_frequency")
        shape, dtype = file.fields["pressure"]
        t, start = (file.row(name) for name in _ARRAYS[1:])
        if dtype.kind != "c" or len(shape) != 3 or (shape[0], shape[2]) != (start.size, t.size):
            wanted = f"complex (ping={start.size}, receiver, sample={t.size})"
            raise ValueError(f"pressure: found {dtype} of shape {shape}, expected {wanted}")
        fc = float(file.row("baseband_frequency")[0])
        fs = _rate(t)
        with io.named(beside):
            fields = _geometry(config, start, shape[1])
        nothing = np.broadcast_to(np.zeros((), dtype), shape)  # all else is checked before samples are allocated
        echoes = Echoes(
            nothing, fs=fs, fc=fc, t0=float(t[0]), compressed=False, ping_time=start,
            attrs={"title": Path(path).stem, "source": "openSTB-simulator"} | _truth(config), **fields,
        )  # fmt: skip
        return echoes.replace(data=file.read("pressure"))


def _rate(t: FloatArray) -> float:
    if t.size < 2 or not np.isfinite(t).all() or not t[-1] > t[0]:
        raise ValueError("sample_time: found no rising times, expected two or more")
    rate = (t.size - 1) / (t[-1] - t[0])
    if np.max(np.abs((t - t[0]) * rate - np.arange(t.size))) > _EVEN:
        raise ValueError("sample_time: found unequal intervals, expected equal ones")
    rounded = float(np.round(rate, 6))  # times in float64 tell no more of a rate
    return rounded if abs(rounded - rate) < 1e-9 * rate else float(rate)


# What the configuration tells


def _geometry(config: Table, start: FloatArray, receivers: int) -> dict[str, Any]:
    """Places, velocity, speed of sound and pulse, as fields of `Echoes`."""
    system = _table(config, "system")
    arms = system.get("receivers")
    if not isinstance(arms, list) or len(arms) != receivers:
        found = f"found {len(arms)}" if isinstance(arms, list) else "missing"
        raise ValueError(f"system.receivers: {found}, expected {receivers}, as the result has")
    rx_arms = np.stack([_vector(arm, f"system.receivers[{i}]", "position") for i, arm in enumerate(arms)])
    tx_arm = _vector(_table(system, "transmitter", "system."), "system.transmitter", "position")
    position, turn, velocity, rate = _along(_table(config, "trajectory"), start)
    fields: dict[str, Any] = {
        "tx": position + turn @ tx_arm,
        "rx": position[:, None] + np.einsum("pij,rj->pri", turn, rx_arms),
        "c": _number(_of_kind(config, "environment", "invariant"), "environment", "sound_speed"),
        "pulse": _pulse(_table(system, "signal", "system.")),
    }
    travel = _table(config, "travel_time").get("plugin")
    if travel == "iterative":  # receivers go on while the echo travels, and about the vehicle where that turns
        about = fields["rx"] - position[:, None]
        fields["velocity"] = velocity[:, None] + rate * np.stack([-about[..., 1], about[..., 0], 0 * about[..., 2]], axis=-1)
    elif travel != "stop_and_hop":
        raise ValueError(f"travel_time.plugin: found {travel!r:.60}, expected stop_and_hop or iterative")
    return fields


def _along(trajectory: Table, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Position (ping, 3), attitude (ping, 3, 3), velocity (ping, 3) of the vehicle, and its rate of turn about z, rad/s."""
    name, speed = "trajectory", _number(trajectory, "trajectory", "speed")
    if trajectory.get("plugin") == "linear":
        first, last = (_vector(trajectory, name, f"{end}_position") for end in ("start", "end"))
        length = float(np.linalg.norm(last - first))
        if not length > 0:
            raise ValueError("trajectory.end_position: found the start's, expected another")
        ahead = (last - first) / length
        turn = np.broadcast_to(_turned_to(ahead), (t.size, 3, 3))
        return first + t[:, None] * (speed * ahead), turn, np.broadcast_to(speed * ahead, (t.size, 3)), 0.0
    if trajectory.get("plugin") != "circular":
        raise ValueError(f"trajectory.plugin: found {trajectory.get('plugin')!r:.60}, expected linear or circular")
    if type(clockwise := trajectory.get("clockwise")) is not bool:
        raise ValueError(f"trajectory.clockwise: found {clockwise!r:.60}, expected true or false")
    if not (radius := _number(trajectory, name, "radius")) > 0:
        raise ValueError(f"trajectory.radius: found {radius:g}, expected > 0")
    begin = math.radians(_number(trajectory, name, "start_angle", 0.0))
    rate = (1 if clockwise else -1) * speed / radius  # clockwise as seen from above: z is down
    angle = begin + rate * t
    heading = angle + math.copysign(math.pi / 2, rate)
    cos, sin, zero = np.cos(heading), np.sin(heading), np.zeros(t.size)
    turn = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], axis=-1).reshape(-1, 3, 3)
    place = _vector(trajectory, name, "centre") + radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
    return place, turn, speed * turn[..., 0], rate


def _turned_to(ahead: FloatArray) -> FloatArray:
    """The least rotation (3, 3) that turns x into the unit vector `ahead` (O. Rodrigues 1840)."""
    cross = np.array([0.0, -ahead[2], ahead[1]])  # x times ahead
    sine = float(np.linalg.norm(cross))
    if 1 - abs(ahead[0]) <= 1e-8 + 1e-5:  # where the simulator turns about z (numpy.isclose)
        cross, sine = np.array([0.0, 0.0, 1.0]), 1.0
    k = cross / sine
    matrix = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    angle = math.acos(max(-1.0, min(1.0, float(ahead[0]))))
    return np.asarray(np.eye(3) + math.sin(angle) * matrix + (1 - math.cos(angle)) * (matrix @ matrix))


def _pulse(signal: Table) -> LFM:
    name = "system.signal"
    if signal.get("plugin") != "lfm_chirp":
        raise ValueError(f"{name}.plugin: found {signal.get('plugin')!r:.60}, expected lfm_chirp (others: by a header)")
    first, last, duration = (_number(signal, name, key) for key in ("f_start", "f_stop", "duration"))
    shape: tuple[Any, ...] = ("rect",)
    if "window" in signal:
        window = _table(signal, "window", "system.signal.")
        if window.get("plugin") not in ("tukey", "hann"):
            found = f"found {window.get('plugin')!r:.60}"
            raise ValueError(f"{name}.window.plugin: {found}, expected tukey, hann or none (others: by a header)")
        shape = "tukey", _number(window, f"{name}.window", "alpha") if window["plugin"] == "tukey" else 1.0
    return LFM((first + last) / 2, last - first, duration, *shape)


def _truth(config: Table) -> Table:
    """Single targets, which `pysas image --truth` finds; areas of many are not listed."""
    targets = config.get("targets")
    single = (
        [t for t in targets if isinstance(t, dict) and t.get("plugin") == "single_point"] if isinstance(targets, list) else []
    )
    if not single:
        return {}
    places = np.stack([_vector(target, "targets", "position") for target in single])
    return {"truth_position": places, "truth_amplitude": np.array([_number(t, "targets", "reflectivity") for t in single])}


def _table(config: Table, name: str, within: str = "") -> Table:
    if not isinstance(found := config.get(name), dict):
        raise ValueError(f"{within}{name}: missing, expected a table")
    return found


def _of_kind(config: Table, name: str, plugin: str) -> Table:
    table = _table(config, name)
    if table.get("plugin") != plugin:
        raise ValueError(f"{name}.plugin: found {table.get('plugin')!r:.60}, expected {plugin}")
    return table


def _text(table: Table, name: str, key: str) -> str:
    if not isinstance(value := table.get(key), str):
        raise ValueError(f"{name}.{key}: found {value!r:.60}, expected a name")
    return value


def _number(table: Table, name: str, key: str, default: float | None = None) -> float:
    return _checks.number(f"{name}.{key}", table.get(key, default))


def _vector(table: Any, name: str, key: str) -> FloatArray:
    value = table.get(key) if isinstance(table, dict) else None
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{name}.{key}: found {value!r:.60}, expected three numbers")
    return np.array([_checks.number(f"{name}.{key}", entry) for entry in value])


# Files of results


@contextlib.contextmanager
def _opened(path: str) -> Iterator[File]:
    suffix = Path(path).suffix.lower()
    if suffix == ".mat":
        with files.opened(path), io.named(path):
            file: File = matlab_variables.Variables(path)
        yield file
    elif suffix == ".npz":
        with io.opened(path) as file:
            yield file
    else:
        stores.require(path)
        with io.named(path):
            file = _Group(path)
        yield file


class _Group(File):
    """The simulator's own Zarr v3 group; its chunks have no checksums."""

    def __init__(self, path: str) -> None:
        self._folder = Path(path).resolve()
        group = stores.open_group(self._folder)
        self.fields, self.pairs, self._followed = {}, {}, {}
        self._arrays: dict[str, Any] = {}
        self._header = dict(group.attrs)
        for name in _ARRAYS:
            if (self._folder / name).is_dir():
                with blamed(name):
                    self._describe(group, name)
        frequency = self._header.get("baseband_frequency")
        if isinstance(frequency, int | float):
            self._frequency = np.array(float(frequency))
            self.fields["baseband_frequency"] = (), np.dtype(np.float64)

    def _describe(self, group: Any, name: str) -> None:
        stores.require_header(self._folder / name)
        array = group[name]
        if not hasattr(array, "chunks"):
            raise ValueError("found a group, expected an array")
        codecs = {type(codec).__name__.removesuffix("Codec").lower() for codec in (*array.filters, *array.compressors)}
        if not codecs <= _CODECS:
            raise ValueError(f"found codecs {', '.join(sorted(codecs))}, expected some of {', '.join(sorted(_CODECS))}")
        if math.prod(array.chunks) * array.dtype.itemsize > _MOST_CHUNK or array.dtype.kind not in "iufc":
            raise ValueError(f"found {array.dtype} in chunks of {array.chunks}, expected numbers, {_MOST_CHUNK} bytes at most")
        self._arrays[name] = array
        self.fields[name] = tuple(array.shape), array.dtype

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        if name not in self._arrays:
            return self._frequency
        declared = math.prod(shape) * dtype.itemsize
        stored = sum(entry.stat().st_size for entry in (self._folder / name).rglob("*") if entry.is_file())
        if declared > stored * _MOST_EXPANSION:
            raise ValueError(f"{name}: found {declared} bytes declared and {stored} stored, expected all of them stored")
        array = allocated(name, shape, dtype)
        with blamed(name, "damaged"):
            array[...] = self._arrays[name][...]
        return array


FORMAT = Format(
    name="openstb",
    title="results of openSTB-simulator in .zarr, .npz or .mat with its configuration in .toml",
    suffixes=(".toml", ".zarr", ".npz", ".mat"),
    holds="echoes",
    kept="samples, linear or circular trajectory, places and motion of transducers, LFM pulse, single targets",
    lost="beam patterns, distortions, areas of targets",
    sniff=_sniff,
    read=_read,
    beside=_beside,
    extra="survey",
)
