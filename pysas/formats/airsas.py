"""AirSAS: in-air data of a sonar on a linear track, in HDF5 as published, or of a turntable as arrays out of a pickle.

The published layout (T. E. Blanford et al., "An in-air synthetic aperture sonar dataset of target scattering in environments
of varying complexity", with its MATLAB scripts): scenes/NAME.h5 and, beside the folder "scenes", the folder "characterization
data". MATLAB's axes are the file's in reverse: its [sample, ping] are (ping, sample) here.

The other is that of A. W. Reed et al. (2023), "Neural volumetric reconstruction for coherent synthetic aperture sonar", whose
system_data.pik holds Python objects: nothing reads it here, but the arrays in it by their names, in .npz or .h5.
"""

from __future__ import annotations

import csv
import io as streams
import re
from pathlib import Path
from typing import Any

import numpy as np

from pysas._checks import FloatArray
from pysas.formats import files, io
from pysas.formats.containers import Groups, opened_groups
from pysas.formats.fields import Array, File, allocated
from pysas.formats.format import Format, Item, Look
from pysas.model.pulse import LFM
from pysas.model.recording import Recording

BESIDE = "characterization data"
PARAMETERS, SENSORS = "acquistionParams.csv", "sensorCoordinates.csv"  # spelt so
# rows of the former, counted from 1 below its header, as the scripts count them; values stand in column 2
_FS, _DELAY, _START, _STOP, _DURATION, _TAPER = 1, 2, 8, 9, 10, 13
_MOST_TABLE = 2**20  # bytes

PICKLED = ("wfm_data", "tx_coords", "rx_coords", "sampling_frequency", "f_start", "f_stop", "t_dur", "win_ratio")


def _sniff(look: Look) -> bool:
    names = look.entries.keys()
    return {"na", "ch1"} <= names or set(PICKLED[:3]) <= names


def _read(path: str, channel: str | None) -> Item:
    with io.opened(path) as file:
        if "wfm_data" in file.fields:
            return _read_arrays(path, file)
    parameters, sensors = (_table(path, name) for name in (PARAMETERS, SENSORS))
    numbers = {row: _parameter(parameters, row) for row in (_FS, _DELAY, _START, _STOP, _DURATION, _TAPER)}
    fs, delay = numbers[_FS], numbers[_DELAY] / numbers[_FS]
    with files.opened(path) as stream, io.named(path), opened_groups(stream) as groups:
        track = groups.group("na", ["position", "temperature"])
        position = track.row("position")
        temperature = track.reals("temperature")
        if temperature.shape[-1:] != position.shape:
            found = f"found shape {temperature.shape}, expected (sensor, ping={position.size})"
            raise ValueError(f"na/temperature: {found}, MATLAB's [ping, sensor]")
        channels = sorted(int(name[2:]) for name in groups.names() if re.fullmatch(r"ch[1-9][0-9]?", name))
        samples = _samples(groups, channels, position.size)
        attrs = {"title": Path(path).stem, "source": "AirSAS (T. E. Blanford et al.)"}
        if (date := groups.text("collection_date")) is not None:
            attrs["collection_date"] = date[:100]
    places = _places(sensors, max(channels))
    track_at = np.zeros((position.size, 3))
    track_at[:, 0] = position  # the array moves along x, and stands while it listens
    with io.named(parameters[0]):
        return _recording(
            samples, fs, numbers[_START], numbers[_STOP], numbers[_DURATION], numbers[_TAPER], t0=-delay, attrs=attrs,
            tx=track_at + places[0], rx=track_at[:, None] + places[channels],
            air_temperature=temperature.reshape(-1, position.size).mean(axis=0),
        )  # fmt: skip


def _recording(samples: Array, fs: float, start: float, stop: float, duration: float, taper: float, **rest: Any) -> Recording:
    pulse = LFM((start + stop) / 2, stop - start, duration, "tukey", taper)
    return Recording(samples=samples, fs=fs, fc=pulse.fc, bandwidth=pulse.occupied_bandwidth, pulse=pulse, **rest)


def _samples(groups: Groups, channels: list[int], pings: int) -> Array:
    """(ping, channel, sample) as the file's groups have them."""
    samples: Array = np.empty(0)
    for number, channel in enumerate(channels):
        name, group = f"ch{channel}/ts", groups.group(f"ch{channel}", ["ts"])
        shape, dtype = group.fields.get("ts", ((), np.dtype(object)))
        if dtype.kind not in "iuf" or len(shape) != 2 or shape[0] != pings:
            raise ValueError(
                f"{name}: found {dtype} of shape {shape}, expected real numbers (ping={pings}, sample), MATLAB's [sample, ping]"
            )
        if number == 0:
            samples = allocated("ts", (pings, len(channels), shape[1]), dtype)
        if (shape[1], dtype) != (samples.shape[2], samples.dtype):
            raise ValueError(f"{name}: found {dtype} of shape {shape}, expected those of ch{channels[0]}")
        samples[:, number] = group.read("ts")
    if samples.size == 0:
        raise ValueError("ch1/ts: found no samples, expected some")
    return samples


def _one(file: File, name: str) -> float:
    array = file.reals(name)
    if array.size != 1:
        raise ValueError(f"{name}: found shape {array.shape}, expected one number")
    return float(array.reshape(-1)[0])


# Tables beside the scenes


def _table(path: str, name: str) -> tuple[str, list[list[str]]]:
    """A table's own path and its rows below the names of columns, which are told by a column 2 that is no number."""
    target = _place(path, name)
    if not target.is_file():
        where = f'expected it in the folder "{BESIDE}" beside the folder "scenes" of the file, as published'
        raise FileNotFoundError(f"{path}: needs {target}, which is missing: {where}")
    content = files.small(target, _MOST_TABLE, "a small table")
    try:
        rows = list(csv.reader(streams.StringIO(content.decode("utf-8-sig"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{target}: expected a table of text: {error}") from None
    rows = [row for row in rows if any(map(str.strip, row))]
    return str(target), rows[1:] if rows and not _is_number(rows[0][1:2]) else rows


def _place(path: str, name: str) -> Path:
    return Path(path).resolve().parent.parent / BESIDE / name


def _beside(path: str) -> list[str]:
    return [str(_place(path, name)) for name in (PARAMETERS, SENSORS)]


def _is_number(cells: list[str]) -> bool:
    try:
        return bool(cells) and np.isfinite(float(cells[0]))
    except ValueError:
        return False


def _parameter(table: tuple[str, list[list[str]]], row: int) -> float:
    path, rows = table
    cells = rows[row - 1][1:2] if row <= len(rows) else []
    if not _is_number(cells):
        found = f"found {cells[0]!r:.60}" if cells else "missing"
        raise ValueError(f"{path}: row {row} below the header, column 2: {found}, expected a number")
    return float(cells[0])


def _places(table: tuple[str, list[list[str]]], last: int) -> FloatArray:
    """Speaker, then microphones 1 to `last`, (1 + last, 3) m."""
    path, rows = table
    if len(rows) <= last:
        raise ValueError(f"{path}: found {len(rows)} rows, expected the speaker's and those of {last} microphones")
    for number, row in enumerate(rows[: last + 1]):
        if len(row) < 4 or not all(_is_number([cell]) for cell in row[1:4]):
            raise ValueError(
                f"{path}: row {number + 1} below the header: found {','.join(row)!r:.60}, expected a name, x, y, z"
            )
    return np.array([[float(cell) for cell in row[1:4]] for row in rows[: last + 1]])


# Arrays out of a pickle


def _read_arrays(path: str, file: File) -> Recording:
    """A trace of each place of the turntable, from which the recorder's delay was taken when they were pickled."""
    with io.named(path):
        for name in PICKLED:
            if name not in file.fields:
                raise ValueError(f"{name}: missing, expected {', '.join(PICKLED)} and speed_of_sound or temps")
        shape, dtype = file.fields["wfm_data"]
        if dtype.kind not in "iuf" or len(shape) != 2:
            raise ValueError(f"wfm_data: found {dtype} of shape {shape}, expected real numbers (ping, sample)")
        medium: dict[str, Any] = {}
        if "speed_of_sound" in file.fields:
            medium["c"] = _one(file, "speed_of_sound")
        elif "temps" in file.fields:
            medium["air_temperature"] = file.row("temps")
        else:
            raise ValueError("speed_of_sound: missing, expected it (m/s, one number) or temps (degrees Celsius, one a ping)")
        fs, *sweep = (_one(file, name) for name in PICKLED[3:])
        return _recording(
            file.read("wfm_data"), fs, *sweep, tx=file.reals("tx_coords"), rx=file.reals("rx_coords"), **medium,
            attrs={"title": Path(path).stem, "source": "AirSAS (A. W. Reed et al.)"},
        )  # fmt: skip


FORMAT = Format(
    name="airsas",
    title="AirSAS in-air data: scenes/*.h5 as published, or the arrays of system_data.pik in .npz or .h5",
    suffixes=(".h5", ".npz"),
    holds="echoes",
    kept="samples of all channels, places, speed of sound a ping, pulse, group delay (as t0), date",
    lost="images, humidity, calibration",
    sniff=_sniff,
    read=_read,
    beside=_beside,
    extra="hdf5",
)
