"""Files: the schemas "pysas-echoes-1" and "pysas-image-1" in two containers, .npz and .h5 (h5py, extra `hdf5`).

Reading never unpickles and trusts no size: each field's dtype and shape are taken from its header and compared with the
schema, with the other fields and with the bytes that lie in the file; then navigation and grid are read and checked,
and only then samples or pixels are allocated. Both containers carry checksums (CRC-32 of each .npz member; in .h5 those
of the format's metadata and Fletcher-32 of the arrays), so that damage is noticed. Writing goes to a temporary name in
the same folder, which takes the file's place when complete. This module knows no algorithm.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import secrets
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.echoes import Beam, Echoes
from pysas.grid import KINDS, Grid
from pysas.image import Image, Report
from pysas.pulse import LFM

Array = npt.NDArray[Any]

ECHOES, IMAGE = "pysas-echoes-1", "pysas-image-1"
_MOST_EXPANSION = 1032  # deflate cannot expand by more ("Maximum Compression Factor", zlib technical details)
_CHUNK_BYTES = 2**20
_COMPACT_BYTES = 60_000  # HDF5 keeps data of less than 64 KiB in the (checksummed) object header where asked
_SAFE_FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, Fletcher-32, LZF: built in, and none expands by more than deflate
_PULSE = ("pulse_kind", "pulse_fc", "pulse_bandwidth", "pulse_duration", "pulse_window")
_BEAM = ("beam_boresight", "beam_length", "beam_half_angle")
_TRUTH = ("truth_position", "truth_amplitude")
_KINDS = {  # what an error says, and dtypes without byte order
    "samples": ("complex64 or complex128", ("c8", "c16")), "real": ("float64", ("f8",)), "bool": ("bool", ("b1",)),
    "truth": ("float64 or complex128", ("f8", "c16")), "text": ("a string", ()),
}  # fmt: skip


def save(path: str | os.PathLike[str], what: Echoes | Image) -> None:
    """Write echoes or an image.

    Parameters
    ----------
    path : str or path
        Ends in .npz or .h5. An existing file is replaced only when the new one is complete.
    what : Echoes or Image
        `attrs` may hold what JSON can (numpy scalars and arrays become numbers and lists); "truth_position" (n, 3) and
        "truth_amplitude" (n,) among them become fields of their own and stay arrays.

    Raises
    ------
    ValueError, TypeError
        Another suffix or object, or attrs that JSON cannot hold.
    OSError, ImportError
        From the file system, with nothing half-written left behind; .h5 without h5py (extra `hdf5`).
    """
    if not isinstance(what, Echoes | Image):
        raise TypeError(f"what={type(what).__name__}: expected pysas.Echoes or pysas.Image")
    write = _container(path)[1]
    fields = _echo_fields(what) if isinstance(what, Echoes) else _image_fields(what)
    with replacing(path) as part:
        write(part, fields)


def load(path: str | os.PathLike[str]) -> Echoes | Image:
    """Read what `save` wrote, or any file of the same schema.

    Parameters
    ----------
    path : str or path
        Ends in .npz or .h5.

    Returns
    -------
    Echoes or Image
        The scene's truth, where the file has it, is in `echoes.attrs` as arrays "truth_position", "truth_amplitude".
        Samples are read as they are, non-finite ones included. Fields that the schema lacks are ignored, with a warning.

    Raises
    ------
    ValueError
        A damaged file or one that breaks the schema; names file, field, found and expected.
    OSError, ImportError
        From the file system; .h5 without h5py (extra `hdf5`).
    """
    opened = _container(path)[0]
    with open(path, "rb"):
        pass  # the file system's own errors, before a library turns them into its own
    try:
        with opened(Path(path)) as file:
            schema = file.text("schema")
            if schema not in (ECHOES, IMAGE):
                raise ValueError(f"schema: found {schema!r:.60}, expected {ECHOES!r} or {IMAGE!r}")
            result, known = _read_echoes(file) if schema == ECHOES else _read_image(file)
            unknown = sorted(file.fields.keys() - known)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # zipfile, zlib, h5py and json have many ways of saying that bytes are wrong
        raise ValueError(f"{os.fspath(path)}: {error or type(error).__name__}") from error
    if unknown:
        warnings.warn(f"{os.fspath(path)}: ignored, not in {schema}: {', '.join(unknown)}", stacklevel=2)
    return result


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary name beside `path` that takes its place when the block ends and vanishes when the block fails."""
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise ValueError(f"{os.fspath(path)}: expected a regular file or a new name")
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(target.parent))
    part = target.with_name(f".pysas-{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink()
        raise


def _container(path: str | os.PathLike[str]) -> tuple[Callable[..., Any], Callable[[Path, dict[str, Array]], None]]:
    containers = {".npz": (_open_npz, _write_npz), ".h5": (_open_h5, _write_h5)}
    if (suffix := Path(path).suffix.lower()) not in containers:
        raise ValueError(f"{os.fspath(path)}: found suffix {suffix!r}, expected .npz or .h5")
    return containers[suffix]


# From objects to fields and back. Tables: kind of a field's entries, then the shapes it may have; a word in a shape is the
# same number wherever it stands, T is "ping channel", or "ping" where the data are (ping, sample)

_ECHO_FIELDS: dict[str, tuple[str, ...]] = {
    "schema": ("text", ""), "data": ("samples", "T sample"), "fs": ("real", ""), "fc": ("real", ""), "c": ("real", ""),
    "t0": ("real", "", "ping"), "tx": ("real", "ping 3"), "rx": ("real", "T 3"), "compressed": ("bool", ""),
    "velocity": ("real", "ping 3", "T 3"), "bandwidth": ("real", ""), "ping_time": ("real", "ping"),
    "pulse_kind": ("text", ""), "pulse_fc": ("real", ""), "pulse_bandwidth": ("real", ""), "pulse_duration": ("real", ""),
    "pulse_window": ("text", ""), "pulse_window_parameter": ("real", ""), "waveform": ("samples", "length"),
    "truth_position": ("real", "target 3"), "truth_amplitude": ("truth", "target"),
    "beam_boresight": ("real", "3", "ping 3"), "beam_length": ("real", ""), "beam_half_angle": ("real", ""),
    "attrs": ("text", ""),
}  # fmt: skip
_ECHO_NEEDS = ("schema", "data", "fs", "fc", "c", "t0", "tx", "rx", "compressed")
_AXES = {"plane": ("x", "y"), "surface": ("x", "y"), "polar": ("r", "angle"), "volume": ("x", "y", "z"), "points": ()}
_MORE_GRID = {"plane": ("height", ""), "surface": ("height", "y x"), "polar": ("centre", "3")}


def _echo_fields(echoes: Echoes) -> dict[str, Array]:
    attrs = dict(echoes.attrs)
    fields: dict[str, Any] = {"schema": ECHOES}
    fields |= {name: getattr(echoes, name) for name in ("fs", "fc", "c", "t0", "tx", "rx", "compressed")}
    fields |= {name: value for name in ("velocity", "ping_time") if (value := getattr(echoes, name)) is not None}
    if echoes.bandwidth != echoes.replace(bandwidth=None).bandwidth:
        fields["bandwidth"] = echoes.bandwidth
    pulse = echoes.pulse
    if isinstance(pulse, LFM):
        fields |= {"pulse_kind": "lfm"} | {f"pulse_{key}": value for key, value in vars(pulse).items() if value is not None}
    elif pulse is not None:
        fields["waveform"] = pulse
    if echoes.beam is not None:
        fields |= {f"beam_{key}": value for key, value in vars(echoes.beam).items()}
    if any(name in attrs for name in _TRUTH):
        fields |= dict(zip(_TRUTH, _truth(*(attrs.pop(name, None) for name in _TRUTH)), strict=True))
    if attrs:
        fields["attrs"] = json.dumps(_plain("attrs", attrs))
    fields["data"] = echoes.data
    return {name: np.asarray(value) for name, value in fields.items()}


def _truth(position: Any, amplitude: Any) -> tuple[Array, Array]:
    position = _checks.reals("attrs['truth_position']", position, [("n", 3)], ("target",))
    amplitude = _checks.array_like("attrs['truth_amplitude']", amplitude)
    if amplitude.dtype.kind not in "iufc" or amplitude.shape != position.shape[:1]:
        found = f"{amplitude.dtype} of shape {amplitude.shape}"
        raise ValueError(f"attrs['truth_amplitude']: found {found}, expected numbers of shape {position.shape[:1]}")
    return position, amplitude.astype(np.complex128 if amplitude.dtype.kind == "c" else np.float64)


def _read_echoes(file: _File) -> tuple[Echoes, set[str]]:
    two = "data" in file.fields and len(file.fields["data"][0]) == 2
    trace = "ping" if two else "ping channel"
    table = {name: tuple(part.replace("T", trace) for part in field) for name, field in _ECHO_FIELDS.items()}
    file.check(table, _ECHO_NEEDS)
    got = file.together(_PULSE), file.together(_BEAM), file.together(_TRUTH)
    if got[0] and "waveform" in file.fields:
        raise ValueError("waveform: found beside pulse_kind, expected one of the two")
    names = [name for name, field in table.items() if name in file.fields and name != "data" and field[0] != "text"]
    values: dict[str, Any] = {name: file.read(name) for name in names}
    values |= {name: value.item() for name, value in values.items() if value.ndim == 0}
    attrs = _object("attrs", file.text("attrs")) if "attrs" in file.fields else {}
    attrs |= {name: values.pop(name) for name in _TRUTH if got[2]}
    pulse = values.pop("waveform", None)
    if got[0]:
        pulse = _read_pulse(file, values)
    beam = Beam(*(values.pop(name) for name in _BEAM)) if got[1] else None
    shape, dtype = file.fields["data"]
    stand_in = np.broadcast_to(np.zeros((), dtype), shape)  # navigation is checked before samples are allocated
    echoes = Echoes(stand_in, pulse=pulse, beam=beam, attrs=attrs, **values)
    return echoes.replace(data=file.read("data")), set(table)


def _read_pulse(file: _File, values: dict[str, Any]) -> LFM:
    if (kind := file.text("pulse_kind")) != "lfm":
        raise ValueError(f"pulse_kind: found {kind!r:.60}, expected 'lfm'")
    parts = {name: values.pop(f"pulse_{name}", None) for name in ("fc", "bandwidth", "duration", "window_parameter")}
    try:
        return LFM(window=file.text("pulse_window"), **parts)
    except ValueError as error:
        raise ValueError(f"pulse: {error}") from None


def _image_table(kind: str, shape: tuple[int, ...]) -> dict[str, tuple[str, ...]]:
    pixels = " ".join(reversed(_AXES[kind])) or " ".join(map(str, shape))
    table: dict[str, tuple[str, ...]] = dict.fromkeys(("schema", "report", "grid_kind"), ("text", ""))
    table |= {"data": ("samples", pixels), "fc": ("real", ""), "c": ("real", ""), "grid_mask": ("bool", pixels)}
    table |= {f"grid_{name}": ("real", name) for name in _AXES[kind]}
    name, wanted = _MORE_GRID.get(kind, ("coords", f"{pixels} 3"))
    return table if kind == "volume" else table | {f"grid_{name}": ("real", wanted)}


def _image_fields(image: Image) -> dict[str, Array]:
    grid = image.grid
    if image.data.dtype.str[1:] not in _KINDS["samples"][1]:
        raise TypeError(f"data: found {image.data.dtype}, expected complex64 or complex128 pixels")
    fields: dict[str, Any] = {"schema": IMAGE, "fc": image.fc, "c": image.c, "grid_kind": grid.kind}
    fields |= {f"grid_{name}": axis for name, axis in grid.axes.items()}
    if grid.kind != "volume":
        name = _MORE_GRID.get(grid.kind, ("coords", ""))[0]
        fields[f"grid_{name}"] = getattr(grid, name)
    if grid.mask is not None:
        fields["grid_mask"] = grid.mask
    fields["report"] = json.dumps(_plain("report", image.report.as_dict()))
    fields["data"] = image.data
    return {name: np.asarray(value) for name, value in fields.items()}


def _read_image(file: _File) -> tuple[Image, set[str]]:
    kind = file.text("grid_kind")
    if kind not in KINDS:
        raise ValueError(f"grid_kind: found {kind!r:.60}, expected one of {', '.join(KINDS)}")
    table = _image_table(kind, file.fields["data"][0] if "data" in file.fields else ())
    file.check(table, [name for name in table if name != "grid_mask"])
    names = [name for name in table if name.startswith("grid_") and name in file.fields and name != "grid_kind"]
    argument = {"height": "z", "coords": "points"}
    parts = {argument.get(key := name.removeprefix("grid_"), key): file.read(name) for name in names}
    if kind == "plane":
        parts["z"] = parts["z"].item()
    grid: Grid = getattr(Grid, kind)(**parts)
    report = Report.from_dict(_object("report", file.text("report")))
    return Image(file.read("data"), grid, report, file.read("fc").item(), file.read("c").item()), set(table)


def _plain(name: str, value: Any) -> Any:
    """`value` in JSON's own types, or TypeError naming the entry."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return [_plain(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{name}: found key {key!r}, expected strings")
        return {key: _plain(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    raise TypeError(f"{name}: found {type(value).__name__}, expected what JSON can hold")


def _object(name: str, text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: found no JSON ({error}), expected a JSON object") from None
    if not isinstance(value, dict):
        raise ValueError(f"{name}: found JSON {type(value).__name__}, expected an object")
    return value


# Containers


class _File:
    """An open file: `fields` gives the shape and dtype that each field declares, found to agree with its bytes."""

    fields: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]

    def read(self, name: str) -> Array:
        """The field's entries."""
        raise NotImplementedError

    def text(self, name: str) -> str:
        """A string field."""
        self.check({name: ("text", "")}, [name])
        value = self.read(name).reshape(-1)[0]
        try:
            return value.decode("utf-8") if isinstance(value, bytes) else str(value)
        except UnicodeDecodeError:
            raise ValueError(f"{name}: found {value!r:.60}, expected UTF-8 text") from None

    def together(self, names: tuple[str, ...]) -> bool:
        """Whether a group of fields is there; part of one is an error."""
        missing = [name for name in names if name not in self.fields]
        if 0 < len(missing) < len(names):
            there = next(name for name in names if name in self.fields)
            raise ValueError(f"{missing[0]}: missing, expected beside {there}")
        return not missing

    def check(self, table: Mapping[str, tuple[str, ...]], needed: Iterable[str]) -> None:
        """Presence, dtypes and shapes, against the schema and each other; nothing is read."""
        for name in needed:
            if name not in self.fields:
                raise ValueError(f"{name}: missing, expected {_KINDS[table[name][0]][0]}")
        sizes: dict[str, int] = {}
        for name, (kind, *shapes) in sorted(table.items(), key=lambda item: item[0] != "data"):
            if name not in self.fields:
                continue
            shape, dtype = self.fields[name]
            if not (dtype.kind in "US" and math.prod(shape) == 1 if kind == "text" else dtype.str[1:] in _KINDS[kind][1]):
                raise ValueError(f"{name}: found {dtype} of shape {shape}, expected {_KINDS[kind][0]}")
            if kind == "text":
                continue
            for words in map(str.split, shapes):
                wanted = [int(word) if word.isdigit() else sizes.get(word, n) for word, n in zip(words, shape, strict=False)]
                if len(words) == len(shape) and tuple(wanted) == shape:
                    sizes |= {word: n for word, n in zip(words, shape, strict=True) if not word.isdigit()}
                    break
            else:
                known = [" ".join(f"{w}={sizes[w]}" if w in sizes else w for w in words.split()) for words in shapes]
                text = " or ".join(f"({one.replace(' ', ', ')}{',' * (one != '' and ' ' not in one)})" for one in known)
                raise ValueError(f"{name}: found shape {shape}, expected {text}")


class _Npz(_File):
    def __init__(self, archive: zipfile.ZipFile, size: int) -> None:
        self._archive, self._size = archive, size
        self._members: dict[str, zipfile.ZipInfo] = {}
        self._start: dict[str, tuple[int, bool]] = {}
        self.fields = {}
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if name in self._members:
                raise ValueError(f"{name}: found twice, expected one member of that name")
            self._members[name] = info
            try:
                self._describe(name, info)
            except Exception as error:
                raise ValueError(f"{name}: damaged or not .npy ({error or type(error).__name__})") from error

    def _describe(self, name: str, info: zipfile.ZipInfo) -> None:
        stored = info.compress_type == zipfile.ZIP_STORED
        if info.flag_bits & 1 or not (stored or info.compress_type == zipfile.ZIP_DEFLATED):
            raise ValueError("found an encrypted or unusual member, expected a stored or deflated one")
        most = info.compress_size * (1 if stored else _MOST_EXPANSION)
        if info.file_size > most or info.header_offset + info.compress_size > self._size:
            raise ValueError(f"found {info.file_size} bytes declared, expected at most {min(most, self._size * 1032)}")
        with self._archive.open(info) as stream:  # also compares the two names that a zip file holds
            if not info.filename.endswith(".npy"):
                return
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, fortran, dtype = read(stream)
            start = stream.tell()
        declared = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or start + declared != info.file_size:
            raise ValueError(f"found {dtype} of shape {shape} in {info.file_size - start} bytes, expected {declared} bytes")
        self.fields[name] = shape, dtype
        self._start[name] = start, fortran

    def read(self, name: str) -> Array:
        shape, dtype = self.fields[name]
        if dtype.hasobject:
            raise ValueError(f"{name}: found {dtype}, expected no Python objects")
        start, fortran = self._start[name]
        array = np.empty(shape, dtype=dtype, order="F" if fortran else "C")
        target = array.reshape(-1, order="A").view(np.uint8) if array.nbytes else np.empty(0, dtype=np.uint8)
        try:
            with self._archive.open(self._members[name]) as stream:
                stream.read(start)
                done = 0
                while done < target.size:
                    part = stream.read(min(_CHUNK_BYTES, target.size - done))
                    if not part:
                        raise ValueError(f"ends {target.size - done} bytes early")
                    target[done : done + len(part)] = np.frombuffer(part, dtype=np.uint8)
                    done += len(part)
                stream.read(1)  # the end: here zipfile compares the checksum
        except Exception as error:
            raise ValueError(f"{name}: damaged ({error or type(error).__name__})") from error
        return array


@contextlib.contextmanager
def _open_npz(path: Path) -> Iterator[_File]:
    with zipfile.ZipFile(path) as archive:
        yield _Npz(archive, path.stat().st_size)


def _write_npz(path: Path, fields: dict[str, Array]) -> None:
    with zipfile.ZipFile(path, "x") as archive:
        for name, array in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)


class _H5(_File):
    def __init__(self, file: Any, size: int) -> None:
        self._file, self._size = file, size
        self.fields = {}
        for name in file:
            try:
                self._describe(name)
            except Exception as error:
                raise ValueError(f"{name}: {error or type(error).__name__}") from error

    def _describe(self, name: str) -> None:
        h5py = _h5py()
        if not isinstance(self._file.get(name, getlink=True), h5py.HardLink):
            raise ValueError("found a link, expected a dataset within the file")
        item = self._file[name]
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            self.fields[name] = (0,), np.dtype(object)  # a group or an empty dataset: no field of ours looks like that
            return
        if item.is_virtual or item.external:
            raise ValueError("found samples kept in other files, expected them within this one")
        properties = item.id.get_create_plist()
        filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
        if not filters <= _SAFE_FILTERS:
            raise ValueError(f"found HDF5 filters {sorted(filters)}, expected some of {sorted(_SAFE_FILTERS)}")
        text = h5py.check_string_dtype(item.dtype)
        if text is not None and text.length is None:
            self.fields[name] = item.shape, np.dtype("U")
            return
        stored, declared = item.id.get_storage_size(), math.prod(item.shape) * item.dtype.itemsize
        most = stored * (_MOST_EXPANSION if filters & {1, 32000} else 1)
        if declared > most or stored > self._size:
            raise ValueError(f"found {declared} bytes declared and {stored} stored, expected all of them stored")
        if item.chunks is not None and declared:
            count = math.prod(-(-n // k) for n, k in zip(item.shape, item.chunks, strict=True))
            large = math.prod(item.chunks) * item.dtype.itemsize > max(declared, _CHUNK_BYTES)
            if large or item.id.get_num_chunks() != count:
                raise ValueError(f"found {item.id.get_num_chunks()} chunks of {item.chunks}, expected {count} that fit")
        self.fields[name] = item.shape, item.dtype

    def read(self, name: str) -> Array:
        try:
            return np.asarray(self._file[name][()])
        except Exception as error:
            raise ValueError(f"{name}: damaged ({error})") from error


@contextlib.contextmanager
def _open_h5(path: Path) -> Iterator[_File]:
    with _h5py().File(path, "r") as file:
        yield _H5(file, path.stat().st_size)


def _write_h5(path: Path, fields: dict[str, Array]) -> None:
    h5py = _h5py()
    try:
        # from version 1.8 of the format on, all metadata carry checksums; the bounds keep the file readable from 1.10 on
        with h5py.File(path, "x", libver=("v110", "v110")) as file:
            for name, array in fields.items():
                if array.dtype.kind == "U":
                    encoded = str(array[()]).encode()
                    kind = h5py.string_dtype("utf-8", max(1, len(encoded)))
                    array = np.array(encoded if len(encoded) <= _COMPACT_BYTES else [encoded], dtype=kind)
                if array.ndim and array.size:
                    file.create_dataset(name, data=array, chunks=True, fletcher32=True).flush()
                    continue
                layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                layout.set_layout(h5py.h5d.COMPACT)
                kind, space = h5py.h5t.py_create(array.dtype, logical=True), h5py.h5s.create_simple(array.shape)
                h5py.h5d.create(file.id, name.encode(), kind, space, layout).write(h5py.h5s.ALL, h5py.h5s.ALL, array)
            file.flush()  # closing would not tell of a full disk
    except RuntimeError as error:
        raise OSError(f"{path}: {error}") from error


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise _checks.optional("h5py", "hdf5") from None
    return h5py
