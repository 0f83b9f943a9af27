"""Plain arrays with a header: a small YAML or JSON file that says what arrays are and in which files beside it they lie.

The header's keys are the fields of pysas-echoes-1 (docs/conventions.md), and a few that say how `data` are stored; a value
stands in the header or names a file (`array_files`). docs/formats.md shows one of each.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from pysas.formats import array_files, files, headers, io
from pysas.formats.fields import Array, File, bytes_of
from pysas.formats.format import Format, Item, Look
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM
from pysas.model.recording import Recording

SCHEMA = "pysas-arrays-1"
UNITS = "m, s, Hz"
PHASES = ("exp(-j)", "exp(+j)")  # of an echo at travel time tau, to which 2 pi fc tau belongs
_OWN = ("header", "units", "axes", "phase")
_NEAR = 0.75  # a word less alike than this is another word, and not a slip
_KEYS = (*_OWN, *(name for name in io.ECHO_FIELDS if name != "schema"))
_AXES = ("ping", "channel", "sample", "iq")
# kinds of fields: the type that the schema has, and kinds of numbers that are taken for it
_TAKEN = {"real": ("f8", "iuf"), "truth": ("f8", "iuf"), "whole": ("i8", "iu"), "samples": ("c16", "iuf")}


class _Header(File):
    """A header's entries as named arrays, of the types that the schema has; `real` : data are real pass-band samples."""

    def __init__(self, path: str) -> None:
        entries = headers.read_header(path)
        _require_keys(path, entries)
        self._folder = Path(path).parent
        self.fields, self.pairs, self._followed = {}, {}, {}
        self._arrays: dict[str, Array] = {}
        self.samples: Array = np.empty(0)
        for name, value in entries.items():
            if name in _OWN:
                continue
            try:
                array = self._array(name, value)
                if name == "data":
                    self.samples = array = _upright(array, entries)
            except ImportError:
                raise
            except OSError as error:
                raise type(error)(f"{path}: {name}: {error}") from error
            except MemoryError as error:
                raise MemoryError(f"{path}: {name}: {error}") from error
            except (ValueError, TypeError) as error:
                raise ValueError(f"{path}: {name}: {error}") from error
            self._arrays[name] = array
        self._arrays["schema"] = np.array(io.ECHOES)
        self.real = "data" in self._arrays and self.samples.dtype.kind != "c"
        if self.real:
            self._arrays["data"] = np.broadcast_to(np.zeros((), np.complex64), self.samples.shape)
        elif entries.get("phase") == PHASES[1]:
            for name in {"data", "waveform"} & self._arrays.keys():
                self._arrays[name] = np.conj(self._arrays[name])
            self.samples = self._arrays.get("data", self.samples)
        self.fields = {name: (array.shape, array.dtype) for name, array in self._arrays.items()}

    def _array(self, name: str, value: Any) -> Array:
        kind, *shapes = io.ECHO_FIELDS[name]
        if name == "attrs":
            if not isinstance(value, dict):
                raise ValueError(f"found {value!r:.60}, expected a mapping")
            return np.array(json.dumps(io.plain(name, value)))
        if kind == "text":
            if not isinstance(value, str):
                raise ValueError(f"found {value!r:.60}, expected a string")
            return np.array(value)
        if isinstance(value, dict):
            array = array_files.read_array(self._folder, value)
            if Path(value["file"]).suffix.lower() == ".mat" and name != "data":
                array = _fewer_axes(array, {len(words.split()) for words in shapes})
        else:
            array = _inline(value)
        wanted, taken = _TAKEN.get(kind, ("", ""))
        if name == "data" or array.dtype.kind not in taken or array.dtype.str[1:] == wanted:
            return array
        return array.astype(wanted)

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        return self._arrays[name]


def _require_keys(path: str, entries: dict[str, Any]) -> None:
    if entries.get("header") != SCHEMA:
        raise ValueError(f"{path}: header: found {entries.get('header', 'none')!r:.60}, expected {SCHEMA}")
    for key in entries:
        if key not in _KEYS:
            near = difflib.get_close_matches(key.lower(), _KEYS, 1, _NEAR)
            hint = f": {near[0]} is meant?" if near else f", expected some of {', '.join(_KEYS)}"
            raise ValueError(f"{path}: {key:.60}: no key of a header{hint}")
    if entries.get("units") != UNITS:
        raise ValueError(f"{path}: units: found {entries.get('units', 'none')!r:.60}, expected {UNITS!r} and numbers in these")


def _fewer_axes(array: Array, axes: set[int]) -> Array:
    """A variable of MATLAB, where numbers and vectors have two axes, with as many as the schema has."""
    if array.ndim != 2 or 1 not in array.shape or 2 in axes:
        return array
    return array.reshape(-1) if array.size > 1 or 0 not in axes else array.reshape(())


def _inline(value: Any) -> Array:
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "biuf":
        raise ValueError(f"found {value!r:.60}, expected a number, lists of numbers of equal lengths, or a mapping with a file")
    return array


def _upright(array: Array, entries: dict[str, Any]) -> Array:
    """Samples (ping, channel, sample) or (ping, sample), I and Q as complex, whatever their axes were."""
    words = entries.get("axes")
    words = " ".join(map(str, words)) if isinstance(words, list) else words
    axes = words.replace(",", " ").split() if isinstance(words, str) else []
    if not {"ping", "sample"} <= set(axes) <= set(_AXES) or len(set(axes)) < len(axes):
        raise ValueError(f"axes: found {words!r:.60}, expected those of data in their order, of {', '.join(_AXES)}")
    if array.ndim != len(axes):
        raise ValueError(f"found shape {array.shape}, expected {len(axes)} axes: {', '.join(axes)}")
    if array.dtype.kind not in "iufc":
        raise ValueError(f"found {array.dtype}, expected numbers")
    if "iq" in axes:
        pair = np.moveaxis(array, axes.index("iq"), -1)
        if pair.shape[-1] != 2 or pair.dtype.kind == "c":
            raise ValueError(f"found {array.dtype} of shape {array.shape}, expected real numbers, 2 along axis iq: I and Q")
        axes.remove("iq")
        array = np.empty(pair.shape[:-1], np.result_type(pair.dtype, np.complex64))
        array.real, array.imag = pair[..., 0], pair[..., 1]
    if array.dtype.kind == "c" and entries.get("phase") not in PHASES:
        found = entries.get("phase", "none")
        raise ValueError(f"phase: found {found!r:.60}, expected {' or '.join(PHASES)}: the turn of an echo by 2 pi fc tau")
    if array.dtype.kind != "c" and "phase" in entries:
        raise ValueError("phase: found beside real data, expected it beside complex data alone")
    return array.transpose([axes.index(word) for word in _AXES if word in axes])


def _sniff(look: Look) -> bool:
    return look.suffix in headers.SUFFIXES and SCHEMA.encode() in look.head


def _read(path: str, channel: str | None) -> Item:
    header = _Header(path)
    with io.named(path):
        found, _ = io.read_navigation(header)
        return _recorded(found, header) if header.real else found.replace(data=header.samples)


def _beside(path: str) -> list[str]:
    """The files that a header names."""
    with contextlib.suppress(Exception):  # reading will tell
        named = [value["file"] for value in headers.read_header(path).values() if isinstance(value, dict) and "file" in value]
        return [files.name(Path(path).parent / name) for name in named]
    return []


def _recorded(found: Echoes, header: _Header) -> Recording:
    """Real samples beside what was found of everything else."""
    if "bandwidth" not in header.fields:
        raise ValueError("bandwidth: missing, expected the band about fc that real data are demodulated to, Hz")
    if found.valid is not None:
        raise ValueError("valid: found beside real data, expected it beside complex data alone")
    if found.pulse is not None and not isinstance(found.pulse, LFM):
        raise ValueError("waveform: found beside real data, expected pulse_kind: lfm (pysas echoes takes a measured pulse)")
    return Recording(
        samples=header.samples, fs=found.fs, fc=found.fc, bandwidth=found.occupied_bandwidth, tx=found.tx, rx=found.rx,
        c=found.c, t0=found.t0, velocity=found.velocity, pulse=found.pulse, compressed=found.compressed, beam=found.beam,
        ping_time=found.ping_time, attrs=found.attrs,
    )  # fmt: skip


def is_beside(header: str, path: str) -> bool:
    """Whether a file has a name that arrays beside a header get."""
    target, found = Path(header).resolve(), Path(path).resolve()
    return found.parent == target.parent and found.name in {f"{target.stem}.{name}.npy" for name in io.ECHO_FIELDS}


def _write(path: str, item: Echoes, overwrite: bool) -> None:
    """A header, and beside it an .npy of each array: survey.yaml, survey.data.npy, survey.tx.npy ..."""
    entries: dict[str, Any] = {"header": SCHEMA, "units": UNITS}
    entries["axes"] = "ping channel sample" if item.data.ndim == 3 else "ping sample"
    entries["phase"] = PHASES[0]
    target = Path(files.name(path))
    arrays = {}
    for name, array in io.echo_fields(item).items():
        if name == "attrs":
            entries[name] = json.loads(array.item())
        elif array.ndim == 0 and name != "schema":
            entries[name] = array.item()
        elif array.ndim:
            arrays[name] = array
            beside, check = f"{target.stem}.{name}.npy", zlib.crc32(bytes_of(np.ascontiguousarray(array)).data)
            entries[name] = {"file": beside, "crc32": check}
    text = headers.written_header(str(target), entries)
    if len(text) > headers.MOST:
        raise ValueError(f"{path}: attrs: found {len(text)} bytes of text, expected at most {headers.MOST}")
    with contextlib.ExitStack() as stack:  # all take their names once all are written, the header last
        stack.enter_context(files.replacing(target, overwrite=overwrite)).write(text)
        for name, array in arrays.items():
            file = stack.enter_context(files.replacing(target.with_name(entries[name]["file"]), overwrite=overwrite))
            np.lib.format.write_array(file, array, allow_pickle=False)


FORMAT = Format(
    name="arrays",
    title="plain arrays with a header in YAML or JSON",
    suffixes=headers.SUFFIXES,
    holds="echoes",
    kept="all",
    lost="nothing",
    sniff=_sniff,
    read=_read,
    beside=_beside,
    write=_write,
    writes=(Echoes,),
    extra="yaml",
)
