"""Files: the schemas "pysas-echoes-1" and "pysas-image-1" in .npz and .h5 (h5py, extra `hdf5`), echoes in .zarr too (`survey`).

Complex fields of .h5 are compounds of "r" and "i", as h5py and HDF5.jl take for complex, netCDF-4 programs too where they are
asked to (netCDF4 and xarray with `auto_complex=True`), and MATLAB's h5read gives as a struct. Those that programs write which
have no such type may be real with a last axis of 2: real and imaginary part.

Reading trusts no size: each field's dtype and shape are taken from its header and compared with the bytes that lie in the
file, with the schema and with the other fields; then navigation and grid are read and checked, and only then samples or
pixels are allocated. This module knows no algorithm, `containers` has the bytes, `files` how a file takes its place.
"""

from __future__ import annotations

import contextlib
import json
import os
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.formats import files, stores
from pysas.formats.containers import container
from pysas.formats.fields import KINDS as DTYPES
from pysas.formats.fields import File, Streamed
from pysas.model.beam import CONE, FAN, Beam
from pysas.model.echoes import Echoes
from pysas.model.grid import KINDS, Grid
from pysas.model.image import Image, Report
from pysas.model.pulse import LFM

Array = npt.NDArray[Any]
Named = dict[str, tuple[tuple[str, ...], Array]]

ECHOES, IMAGE = stores.HOLDS["echoes"], "pysas-image-1"
_PULSE = ("pulse_kind", "pulse_fc", "pulse_bandwidth", "pulse_duration", "pulse_window")
_BEAM = ("beam_boresight", "beam_length", "beam_half_angle")  # of any beam
_MORE_BEAM = ("beam_shape", "beam_taper", "beam_axis")  # of a cone without taper where they are missing: older files' beams
_TRUTH = ("truth_position", "truth_amplitude")


def save(path: str | os.PathLike[str], what: Echoes | Image, *, overwrite: bool = True) -> None:
    """Write echoes or an image.

    Parameters
    ----------
    path : str or path
        Ends in .npz or .h5, or for echoes in .zarr: a folder. A file of that name is replaced only when the new one is
        complete; the new one has its permissions. What has the old one open or mapped, `what` itself too, goes on seeing
        the old one; whoever reads an old .zarr by pings is told that it was replaced.
    what : Echoes or Image
        `attrs` may hold what JSON can (numpy scalars and arrays become numbers and lists); "truth_position" (n, 3) and
        "truth_amplitude" (n,) among them become fields of their own and stay arrays.
    overwrite : bool
        False: a file that is there is an error.

    Raises
    ------
    ValueError, TypeError
        Another suffix or object, attrs that JSON cannot hold, or a path to something that is no regular file.
    OSError, ImportError
        From the file system, with nothing half-written left behind; a read-only file of that name, or any where `overwrite`
        is False; .h5 without h5py (extra `hdf5`), .zarr without zarr (`survey`).
    """
    if not isinstance(what, Echoes | Image):
        raise TypeError(f"what={type(what).__name__}: expected pysas.Echoes or pysas.Image")
    text = files.name(path)
    if isinstance(what, Image) or not is_store(text):
        write_file(text, fields_of(what), overwrite)
        return
    header, fixed, rows = by_ping(echo_fields(what))
    with stores.replacing(text, overwrite=overwrite) as folder:
        stores.create(folder, header, fixed, rows, complete=True)


def is_store(path: str) -> bool:
    """Whether a file of this name is a folder that holds a Zarr group."""
    return Path(path).suffix.lower() == stores.SUFFIX


def write_file(path: str, fields: Mapping[str, Array | Streamed], overwrite: bool) -> None:
    """Fields of a schema to a new .npz or .h5."""
    write = container(path)[1]
    with files.replacing(path, overwrite=overwrite) as file:
        write(file, fields)


def load(path: str | os.PathLike[str]) -> Echoes | Image:
    """Read what `save` wrote, or any file of the same schema; `loading.load` takes other formats too.

    Parameters
    ----------
    path : str or path
        Ends in .npz or .h5, a regular file or a link to one; or in .zarr, a folder. `open_echoes` reads echoes by pings.

    Returns
    -------
    Echoes or Image
        The scene's truth, where the file has it, is in `echoes.attrs` as arrays "truth_position", "truth_amplitude".
        Samples are read as they are, non-finite ones included. Fields that the schema lacks are ignored, with a warning.

    Raises
    ------
    ValueError
        A damaged file or one that breaks the schema; names file, field, found and expected. A pipe or a device.
    MemoryError
        What a whole file holds does not fit; says how much.
    OSError, ImportError
        From the file system; .h5 without h5py (extra `hdf5`), .zarr without zarr (`survey`).
    """
    text = files.name(path)
    with opened(text) as file:
        return read(text, file)


def read(path: str, file: File) -> Echoes | Image:
    """What an open file holds, whose fields have the schemas' names; errors do not name it."""
    schema = file.text("schema")
    if schema not in (ECHOES, IMAGE):
        raise ValueError(f"schema: found {schema!r:.60}, expected {ECHOES!r} or {IMAGE!r}")
    if schema == ECHOES:
        echoes, known = read_navigation(file)
        result: Echoes | Image = echoes.replace(data=file.read("data"))
    else:
        result, known = _read_image(file)
    unknown = sorted(file.fields.keys() - known)
    if unknown:
        message = f"{path}: ignored, not in {schema}: {', '.join(unknown)}"
        warnings.warn(message, stacklevel=5)
    return result


def fields_of(what: Echoes | Image) -> dict[str, Array]:
    """The schema's fields."""
    return echo_fields(what) if isinstance(what, Echoes) else _image_fields(what)


@contextlib.contextmanager
def opened(path: str) -> Iterator[File]:
    """The named arrays of a file; what is wrong with it is a ValueError that names it, while it is open."""
    with contextlib.ExitStack() as stack:
        if is_store(path):
            stores.require(path)
            opening: contextlib.AbstractContextManager[File] = stores.opened(path)
        else:
            of_stream = container(path)[0]
            opening = of_stream(stack.enter_context(files.opened(path)))
        with named(path):
            file = stack.enter_context(opening)
            file.take_pairs(("data", "waveform"))
            yield file


@contextlib.contextmanager
def named(path: str) -> Iterator[None]:
    """Whatever zipfile, zlib, h5py, zarr and json say of wrong bytes, as a ValueError that names the file, once."""
    try:
        yield
    except MemoryError as error:
        raise MemoryError(f"{path}: {error}") from error
    except Exception as error:
        said = str(error) or type(error).__name__
        raise ValueError(said if said.startswith(f"{path}: ") else f"{path}: {said}") from error


# From objects to fields and back. Tables: kind of a field's entries, then the shapes it may have; a word in a shape is the
# same number wherever it stands, T is "ping channel", or "ping" where the data are (ping, sample)

ECHO_FIELDS: dict[str, tuple[str, ...]] = {
    "schema": ("text", ""), "data": ("samples", "T sample"), "fs": ("real", ""), "fc": ("real", ""),
    "c": ("real", "", "ping"), "t0": ("real", "", "ping"), "tx": ("real", "ping 3"), "rx": ("real", "T 3"),
    "compressed": ("flag", ""),
    "velocity": ("real", "ping 3", "T 3"), "bandwidth": ("real", ""), "ping_time": ("real", "ping"),
    "valid": ("whole", "ping 2", "T 2"),
    "pulse_kind": ("text", ""), "pulse_fc": ("real", ""), "pulse_bandwidth": ("real", ""), "pulse_duration": ("real", ""),
    "pulse_window": ("text", ""), "pulse_window_parameter": ("real", ""), "waveform": ("samples", "length"),
    "truth_position": ("real", "target 3"), "truth_amplitude": ("truth", "target"),
    "beam_boresight": ("real", "3", "ping 3"), "beam_length": ("real", ""), "beam_half_angle": ("real", ""),
    "beam_shape": ("text", ""), "beam_taper": ("real", ""), "beam_axis": ("real", "3", "ping 3"),
    "attrs": ("text", ""),
}  # fmt: skip
_ECHO_NEEDS = ("schema", "data", "fs", "fc", "c", "t0", "tx", "rx", "compressed")
_AXES = {"plane": ("x", "y"), "surface": ("x", "y"), "polar": ("r", "angle"), "volume": ("x", "y", "z"), "points": ()}
_TURNED = ("plane", "surface")  # may have axes of their own: grid_origin and grid_rotation, where these are not 0
_MORE_GRID = {"plane": ("height", ""), "surface": ("height", "y x"), "polar": ("centre", "3")}


def echo_fields(echoes: Echoes) -> dict[str, Array]:
    attrs = dict(echoes.attrs)
    fields: dict[str, Any] = {"schema": ECHOES}
    fields |= {name: getattr(echoes, name) for name in ("fs", "fc", "c", "t0", "tx", "rx", "compressed")}
    fields |= {name: value for name in ("velocity", "valid", "ping_time") if (value := getattr(echoes, name)) is not None}
    if echoes.bandwidth != echoes.replace(bandwidth=None).bandwidth:
        fields["bandwidth"] = echoes.bandwidth
    pulse = echoes.pulse
    if isinstance(pulse, LFM):
        fields |= {"pulse_kind": "lfm"} | {f"pulse_{key}": value for key, value in vars(pulse).items() if value is not None}
    elif pulse is not None:
        fields["waveform"] = pulse
    if echoes.beam is not None:
        fields |= {f"beam_{key}": value for key, value in vars(echoes.beam).items() if value is not None}
    if any(name in attrs for name in _TRUTH):
        fields |= dict(zip(_TRUTH, _truth(*(attrs.pop(name, None) for name in _TRUTH)), strict=True))
    if attrs:
        fields["attrs"] = json.dumps(plain("attrs", attrs))
    fields["data"] = echoes.data
    return {name: np.asarray(value) for name, value in fields.items()}


_AXES_OF = {"3": "xyz", "2": "ends"}  # names of axes whose length is their own


def by_ping(fields: Mapping[str, Array]) -> tuple[dict[str, Any], Named, Named]:
    """Fields of echoes as a store has them: attributes, arrays, and arrays of a row a ping, with the names of axes."""
    header: dict[str, Any] = {}
    fixed: Named = {}
    rows: Named = {}
    trace = stores.PING if fields["data"].ndim == 2 else f"{stores.PING} channel"
    for name, array in fields.items():
        if array.ndim == 0:
            header[name] = array.item()
            continue
        shapes = (shape.replace("T", trace).split() for shape in ECHO_FIELDS[name][1:])
        axes = next(tuple(_AXES_OF.get(word, word) for word in words) for words in shapes if len(words) == array.ndim)
        (rows if axes[0] == stores.PING else fixed)[name] = axes, array
    return header, fixed, rows


def _truth(position: Any, amplitude: Any) -> tuple[Array, Array]:
    position = _checks.reals("attrs['truth_position']", position, [("n", 3)], ("target",))
    amplitude = _checks.array_like("attrs['truth_amplitude']", amplitude)
    if amplitude.dtype.kind not in "iufc" or amplitude.shape != position.shape[:1]:
        found = f"{amplitude.dtype} of shape {amplitude.shape}"
        raise ValueError(f"attrs['truth_amplitude']: found {found}, expected numbers of shape {position.shape[:1]}")
    return position, amplitude.astype(np.complex128 if amplitude.dtype.kind == "c" else np.float64)


def echo_table(one_receiver: bool) -> dict[str, tuple[str, ...]]:
    """Kind and shapes of the fields of echoes, whose data are (ping, sample) or (ping, channel, sample)."""
    trace = "ping" if one_receiver else "ping channel"
    return {name: tuple(part.replace("T", trace) for part in field) for name, field in ECHO_FIELDS.items()}


def read_navigation(file: File) -> tuple[Echoes, set[str]]:
    """All of echoes but their samples, for which zeros stand that take no memory, and the names of the schema's fields."""
    table = echo_table("data" in file.fields and len(file.fields["data"][0]) == 2)
    file.check(table, _ECHO_NEEDS)
    got = file.together(_PULSE), file.together(_BEAM), file.together(_TRUTH)
    for name in _MORE_BEAM:
        if name in file.fields and not got[1]:
            raise ValueError(f"{_BEAM[0]}: missing, expected beside {name}")
    if got[0] and "waveform" in file.fields:
        raise ValueError("waveform: found beside pulse_kind, expected one of the two")
    names = [name for name, field in table.items() if name in file.fields and name != "data" and field[0] != "text"]
    values: dict[str, Any] = {name: file.read(name) for name in names}
    values |= {name: value.item() for name, value in values.items() if value.ndim == 0}
    if values["compressed"] not in (0, 1):
        raise ValueError(f"compressed: found {values['compressed']}, expected 0 or 1")
    values["compressed"] = bool(values["compressed"])
    attrs = _object("attrs", file.text("attrs")) if "attrs" in file.fields else {}
    attrs |= {name: values.pop(name) for name in _TRUTH if got[2]}
    pulse = values.pop("waveform", None)
    if got[0]:
        pulse = _read_pulse(file, values)
    beam = _read_beam(file, values) if got[1] else None
    shape, dtype = file.fields["data"]
    stand_in = np.broadcast_to(np.zeros((), dtype), shape)  # navigation is checked before samples are allocated
    return Echoes(stand_in, pulse=pulse, beam=beam, attrs=attrs, **values), set(table)


def _read_pulse(file: File, values: dict[str, Any]) -> LFM:
    if (kind := file.text("pulse_kind")) != "lfm":
        raise ValueError(f"pulse_kind: found {kind!r:.60}, expected 'lfm'")
    parts = {name: values.pop(f"pulse_{name}", None) for name in ("fc", "bandwidth", "duration", "window_parameter")}
    try:
        return LFM(window=file.text("pulse_window"), **parts)
    except ValueError as error:
        raise ValueError(f"pulse: {error}") from None


def _read_beam(file: File, values: dict[str, Any]) -> Beam:
    shape = file.text("beam_shape") if "beam_shape" in file.fields else CONE
    if shape not in (FAN, CONE):
        raise ValueError(f"beam_shape: found {shape!r:.60}, expected {FAN!r} or {CONE!r}")
    boresight, length, half_angle = (values.pop(name) for name in _BEAM)
    taper, axis = values.pop("beam_taper", 0.0), values.pop("beam_axis", None)
    try:
        return Beam(boresight, length, half_angle, shape, taper, axis)
    except ValueError as error:
        raise ValueError(f"beam: {error}") from None


def image_table(kind: str, shape: tuple[int, ...]) -> dict[str, tuple[str, ...]]:
    """Kind and shapes of the fields of an image on a grid of this kind; `shape` of its data counts for points."""
    pixels = " ".join(reversed(_AXES[kind])) or " ".join(map(str, shape))
    table: dict[str, tuple[str, ...]] = dict.fromkeys(("schema", "report", "grid_kind"), ("text", ""))
    table |= {"data": ("samples", pixels), "fc": ("real", ""), "c": ("real", ""), "grid_mask": ("bool", pixels)}
    table |= {f"grid_{name}": ("real", name) for name in _AXES[kind]}
    name, wanted = _MORE_GRID.get(kind, ("coords", f"{pixels} 3"))
    if kind in _TURNED:
        table |= {"grid_origin": ("real", "2"), "grid_rotation": ("real", "")}
    return table if kind == "volume" else table | {f"grid_{name}": ("real", wanted)}


def _image_fields(image: Image) -> dict[str, Array]:
    grid = image.grid
    if image.data.dtype.str[1:] not in DTYPES["samples"][1]:
        raise TypeError(f"data: found {image.data.dtype}, expected complex64 or complex128 pixels")
    fields: dict[str, Any] = {"schema": IMAGE, "fc": image.fc, "c": image.c, "grid_kind": grid.kind}
    fields |= {f"grid_{name}": axis for name, axis in grid.axes.items()}
    if grid.kind != "volume":
        name = _MORE_GRID.get(grid.kind, ("coords", ""))[0]
        fields[f"grid_{name}"] = getattr(grid, name)
    if grid.turned:
        fields |= {"grid_origin": grid.origin, "grid_rotation": grid.rotation}
    if grid.mask is not None:
        fields["grid_mask"] = grid.mask
    fields["report"] = json.dumps(plain("report", image.report.as_dict()))
    fields["data"] = image.data
    return {name: np.asarray(value) for name, value in fields.items()}


def _read_image(file: File) -> tuple[Image, set[str]]:
    kind = file.text("grid_kind")
    if kind not in KINDS:
        raise ValueError(f"grid_kind: found {kind!r:.60}, expected one of {', '.join(KINDS)}")
    table = image_table(kind, file.fields["data"][0] if "data" in file.fields else ())
    file.check(table, [name for name in table if name not in ("grid_mask", "grid_origin", "grid_rotation")])
    file.together(("grid_origin", "grid_rotation"))
    names = [name for name in table if name.startswith("grid_") and name in file.fields and name != "grid_kind"]
    argument = {"height": "z", "coords": "points"}
    parts = {argument.get(key := name.removeprefix("grid_"), key): file.read(name) for name in names}
    parts |= {name: parts[name].item() for name in ("z", "rotation") if name in parts and parts[name].ndim == 0}
    grid: Grid = getattr(Grid, kind)(**parts)
    report = Report.from_dict(_object("report", file.text("report")))
    return Image(file.read("data"), grid, report, file.read("fc").item(), file.read("c").item()), set(table)


def plain(name: str, value: Any) -> Any:
    """`value` in JSON's own types, or TypeError naming the entry."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return [plain(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{name}: found key {key!r}, expected strings")
        return {key: plain(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    raise TypeError(f"{name}: found {type(value).__name__}, expected what JSON can hold")


def _object(name: str, text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: found no JSON ({error}), expected a JSON object") from None
    if not isinstance(value, dict):
        raise ValueError(f"{name}: found JSON {type(value).__name__}, expected an object")
    return value
