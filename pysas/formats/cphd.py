"""Compensated phase history data of radars, CPHD 1.0.1 and 1.1.0 (NGA.STND.0068): one channel as a phase history.

Transmitter at transmission and receiver when the scene reference point's echo arrives are laid on the file's own image area:
origin at its reference point, x and y along its axes, z up from both. The signal is that of the standard's model,
exp(2j pi SGN fx dTOA) with dTOA the travel time less the reference point's.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.formats import cphd_writing, files
from pysas.formats.format import Format, Look
from pysas.formats.radar_xml import SPEED, Metadata, axes, library, require_place
from pysas.model.echoes import Echoes
from pysas.model.phase_history import PhaseHistory

_START = b"CPHD/"
_HEADER = 2**16  # bytes that are looked through for the end of the header
_BLOCKS = ("XML", "PVP", "SIGNAL")
_SIGNALS: dict[str, np.dtype[Any]] = {"CI2": np.dtype("i1"), "CI4": np.dtype(">i2"), "CF8": np.dtype(">c8")}
_LATE = 1e-6  # s between an echo's arrival and what the places make it: more than any troposphere
# per-vector parameters that are used, and those without which there is none
_NEEDED = ("TxTime", "TxPos", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "FX1", "FX2", "SC0", "SCSS")


def _sniff(look: Look) -> bool:
    return look.head.startswith(_START)


def _read(path: str, channel: str | None) -> PhaseHistory:
    library("sarkit.cphd")
    with files.naming(path), files.opened(path) as file:
        blocks = _blocks(file)
        meta = Metadata(_bytes(file, *blocks["XML"]), library("sarkit.cphd").VERSION_INFO)
        chosen = _channel(meta, channel)
        vectors = _vectors(file, meta, chosen, blocks["PVP"])
        samples = _samples(file, meta, chosen, blocks["SIGNAL"])
        good = np.ones(vectors.size, bool) if "SIGNAL" not in _names(vectors) else vectors["SIGNAL"] == 1
        if not good.any():
            raise ValueError("SIGNAL: no vector holds a signal")
        if not good.all():
            _checks.warn(f"{path}: {good.size - good.sum()} of {good.size} vectors hold no signal and are left out")
            vectors, samples = vectors[good], samples[good]
        return _history(meta, chosen, vectors, samples)


def _blocks(file: IO[bytes]) -> dict[str, tuple[int, int]]:
    """Where blocks begin and how long they are, within the file."""
    head = file.read(_HEADER)
    line, _, rest = head.partition(b"\n")
    if line not in (b"CPHD/1.0.1", b"CPHD/1.1.0"):
        raise ValueError(f"found {line[:30]!r}: expected CPHD/1.0.1 or CPHD/1.1.0")
    text, terminator, _ = rest.partition(b"\f\n")
    if not terminator:
        raise ValueError(f"header: expected its end within {_HEADER} bytes")
    fields = [part.partition(b" := ") for part in text.split(b"\n") if part]
    values = {name: value for name, _, value in fields}
    if len(values) != len(fields) or not all(middle for _, middle, _ in fields):
        raise ValueError("header: expected lines of NAME := VALUE, each name once")
    size = os.fstat(file.fileno()).st_size
    found = {}
    for name in (*_BLOCKS, "SUPPORT") if b"SUPPORT_BLOCK_SIZE" in values else _BLOCKS:
        numbers = []
        for field in (f"{name}_BLOCK_BYTE_OFFSET", f"{name}_BLOCK_SIZE"):
            value = values.get(field.encode(), b"").strip()
            if not value.isdigit() or len(value) > 18:
                raise ValueError(f"header: {field}: found {value[:30]!r}: expected a whole number")
            numbers.append(int(value))
        if numbers[0] + numbers[1] > size:
            raise ValueError(f"{name} block: ends at byte {sum(numbers)} of a file of {size}: expected a whole file")
        found[name] = (numbers[0], numbers[1])
    end = max(map(sum, found.values()))
    if end != size:
        raise ValueError(f"header: blocks end at byte {end} of a file of {size}: expected a whole file and nothing after it")
    spans = sorted(found.values())
    if any(first + length > second for (first, length), (second, _) in zip(spans[:-1], spans[1:], strict=True)):
        raise ValueError("header: expected blocks that do not overlap")
    return found


def _bytes(file: IO[bytes], start: int, length: int) -> bytes:
    file.seek(start)
    content = file.read(length)
    if len(content) != length:
        raise ValueError(f"found {len(content)} of {length} bytes: expected a whole file")
    return content


def _channel(meta: Metadata, wanted: str | None) -> Any:
    """The element of Data/Channel of one channel."""
    every = {meta.get("Identifier", element): element for element in meta.all("Data/Channel")}
    if len(every) != len(meta.all("Data/Channel")):
        raise ValueError("XML: Data/Channel: expected identifiers that differ")
    names = ", ".join(repr(name) for name in every)
    if wanted is None and len(every) != 1:
        raise ValueError(f"channel: found {len(every)}, {names:.500}: expected one of them to be chosen (channel=, --channel)")
    chosen = every.get(next(iter(every)) if wanted is None else wanted)
    if chosen is None:
        raise ValueError(f"channel={wanted!r:.60}: expected one of {names:.500}")
    return chosen


def _vectors(file: IO[bytes], meta: Metadata, channel: Any, block: tuple[int, int]) -> npt.NDArray[Any]:
    """The per-vector parameters of a channel."""
    count, size = meta.whole("NumVectors", channel, 1), meta.whole("Data/NumBytesPVP", low=8)
    kinds: dict[str, tuple[np.dtype[Any], int]] = {}
    spans: list[tuple[int, int, str]] = []
    names: set[str] = set()
    for field in [child for parent in meta.all("PVP") for child in parent.iter() if meta.find("Offset", child) is not None]:
        name = meta.find("Name", field) or str(field.tag).rpartition("}")[2]
        if name in names:
            raise ValueError(f"XML: PVP/{name}: found twice, expected each once")
        names.add(name)
        kind = _kind(meta.get("Format", field))
        start = 8 * meta.whole("Offset", field)
        if kind is not None and kind.itemsize > 8 * meta.whole("Size", field):
            raise ValueError(f"XML: PVP/{name}: expected a format of its size")
        spans.append((start, start + 8 * meta.whole("Size", field), name))
        if kind is not None:
            kinds[name] = (kind, start)
    spans.sort()
    for (_, end, name), (start, _, other) in zip(spans[:-1], spans[1:], strict=True):
        if end > start:
            raise ValueError(f"XML: PVP/{other}: begins inside {name}")
    if spans[-1][1] > size:
        raise ValueError(f"XML: PVP/{spans[-1][2]}: ends at byte {spans[-1][1]} of {size}")
    for name in _NEEDED:
        shape = (3,) if name.endswith(("Pos", "Vel")) else ()
        if name not in kinds or kinds[name][0] != np.dtype((">f8", shape)):
            raise ValueError(f"XML: PVP/{name}: expected {'X=F8;Y=F8;Z=F8;' if shape else 'F8'}")
    for name, wanted in (("AmpSF", ">f8"), ("SIGNAL", ">i8")):
        if name in kinds and kinds[name][0] != np.dtype(wanted):
            raise ValueError(f"XML: PVP/{name}: expected {'F8' if wanted == '>f8' else 'I8'}")
    start = meta.whole("PVPArrayByteOffset", channel)
    _require_full(meta, block[1], "PVP", size)
    used: dict[str, tuple[np.dtype[Any], int]] = {name: kinds[name] for name in (*_NEEDED, "AmpSF", "SIGNAL") if name in kinds}
    formats, offsets = [kind for kind, _ in used.values()], [offset for _, offset in used.values()]
    layout: np.dtype[Any] = np.dtype({"names": list(used), "formats": formats, "offsets": offsets, "itemsize": size})
    vectors: npt.NDArray[Any] = np.frombuffer(_bytes(file, block[0] + start, count * size), layout)
    return vectors


def _require_full(meta: Metadata, size: int, what: str, each: int) -> None:
    """Raise where the arrays of all channels, of `each` bytes a vector or a sample, do not fill a block of `size` bytes."""
    end = 0
    for element in meta.all("Data/Channel"):
        count = meta.whole("NumVectors", element, 1) * (1 if what == "PVP" else meta.whole("NumSamples", element, 1))
        end = max(end, meta.whole(f"{what}ArrayByteOffset", element) + count * each)
    if end != size:
        raise ValueError(f"XML: Data/Channel: {what} arrays end at byte {end} of a block of {size}")


def _kind(form: str) -> np.dtype[Any] | None:
    """The type of a parameter of one number or three; None of one that is not used here."""
    one = {"F8": ">f8", "I8": ">i8", "U8": ">u8"}
    parts = [part.partition("=")[::2] for part in form.rstrip(";").split(";")]
    if len(parts) == 1 and not parts[0][1]:
        return np.dtype(one[form]) if form in one else None
    if [name for name, _ in parts] == ["X", "Y", "Z"] and {kind for _, kind in parts} == {"F8"}:
        return np.dtype((">f8", (3,)))
    return None


def _names(vectors: npt.NDArray[Any]) -> tuple[str, ...]:
    return vectors.dtype.names or ()


def _samples(file: IO[bytes], meta: Metadata, channel: Any, block: tuple[int, int]) -> npt.NDArray[Any]:
    """Samples (vector, sample), complex or (vector, sample, 2) of whole numbers, as they stand in the file."""
    if meta.find("CompressedSignalSize", channel) is not None:
        raise ValueError("XML: Data/SignalCompressionID: expected samples that are not compressed")
    form = meta.get("Data/SignalArrayFormat")
    if form not in _SIGNALS:
        raise ValueError(f"XML: Data/SignalArrayFormat: found {form!r:.30}: expected one of {', '.join(_SIGNALS)}")
    kind = _SIGNALS[form]
    rows, columns = meta.whole("NumVectors", channel, 1), meta.whole("NumSamples", channel, 2)
    start = meta.whole("SignalArrayByteOffset", channel)
    parts = 1 if kind.kind == "c" else 2
    size = rows * columns * parts * kind.itemsize
    _require_full(meta, block[1], "Signal", parts * kind.itemsize)
    samples: npt.NDArray[Any] = np.frombuffer(_bytes(file, block[0] + start, size), kind)
    return samples.reshape((rows, columns) if parts == 1 else (rows, columns, 2))


def _history(meta: Metadata, channel: Any, vectors: npt.NDArray[Any], samples: npt.NDArray[Any]) -> PhaseHistory:
    pings = vectors.size
    known = {name: _checks.reals(name, vectors[name], [(pings,), (pings, 3)], ("vector",)) for name in _NEEDED}
    origin, turn, area = _frame(meta)
    tx, arrived, point = ((known[name] - origin) @ turn.T for name in ("TxPos", "RcvPos", "SRPPos"))
    velocity = known["RcvVel"] @ turn.T
    reference = (np.linalg.norm(tx - point, axis=1) + np.linalg.norm(arrived - point, axis=1)) / SPEED
    late = np.abs(known["RcvTime"] - known["TxTime"] - reference)
    if late.max() > _LATE:
        vector = int(np.argmax(late))
        raise ValueError(f"RcvTime: {late[vector]:.4g} s from when the reference point's echo arrives, vector {vector}")
    sign = meta.get("Global/SGN")
    over = meta.get("Global/DomainType")
    if sign not in ("-1", "+1", "1") or over not in ("FX", "TOA"):
        raise ValueError(f"XML: Global: found SGN {sign!r:.10}, DomainType {over!r:.10}: expected -1 or 1, FX or TOA")
    _require_band(meta, known, samples.shape[1], over)
    scale = _checks.reals("AmpSF", vectors["AmpSF"], [(pings,)], ("vector",)) if "AmpSF" in _names(vectors) else None
    identifier = meta.get("Identifier", channel)
    attrs: dict[str, Any] = {
        "title": meta.find("CollectionID/CoreName") or "", "source": f"CPHD {meta.version}, channel {identifier}",
        "ecef": {"origin": origin.tolist(), "axes": turn.tolist()}, "scene_area": area, "cphd": meta.text,
    }  # fmt: skip
    return PhaseHistory(
        samples=_signal(samples, scale, sign != "-1"), first=known["SC0"], step=known["SCSS"], tx=tx,
        # when the reference point's echo arrives it is where the file says, in the engines' model too
        rx=arrived - velocity * reference[:, None], velocity=velocity if velocity.any() else None, reference=reference, c=SPEED,
        band=None if over == "FX" else np.stack([known["FX1"], known["FX2"]], axis=1), ping_time=known["TxTime"], attrs=attrs,
    )  # fmt: skip


def _require_band(meta: Metadata, known: Mapping[str, FloatArray], count: int, over: str) -> None:
    """Raise where the file contradicts itself about frequencies or delays."""
    low, high = known["FX1"], known["FX2"]
    if over == "FX":
        first, last = known["SC0"] - known["SCSS"], known["SC0"] + count * known["SCSS"]
        wrong, what = (low < first) | (high > last) | (high <= low), "FX1, FX2: outside the frequencies of its samples"
    else:
        wrong, what = (high <= low) | (known["SCSS"] * (high - low) > 1), "FX1, FX2: no band, or one wider than 1/SCSS"
    lowest, highest = (meta.number(f"Global/FxBand/{name}") for name in ("FxMin", "FxMax"))
    slack = 1e-6 * highest
    other = (low < lowest - slack) | (high > highest + slack)
    for bad, text in ((wrong, what), (other, "FX1, FX2: outside Global/FxBand")):
        if bad.any():
            vector = int(np.argmax(bad))
            raise ValueError(f"{text}, vector {vector}: {low[vector]:.6g} to {high[vector]:.6g} Hz")


def _signal(samples: npt.NDArray[Any], scale: FloatArray | None, conjugate: bool) -> ComplexArray:
    """Complex samples times each vector's scale, of the sign of pysas' model."""
    if samples.ndim == 3:
        made = np.empty(samples.shape[:2], np.complex64)
        made.real, made.imag = samples[..., 0], samples[..., 1]
        samples = made
    if scale is not None:
        samples = (samples * scale[:, None]).astype(np.complex64)
    return np.conj(samples) if conjugate else samples


def _frame(meta: Metadata) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Origin (3,) and axes (3, 3) of the image area in Earth-fixed coordinates, and its extent on them."""
    scene = "SceneCoordinates"
    origin = meta.vector(f"{scene}/IARP/ECF")
    geodetic = meta.vector(f"{scene}/IARP/LLH", ("Lat", "Lon", "HAE"))
    require_place(origin, geodetic, f"{scene}/IARP")
    surface = f"{scene}/ReferenceSurface"
    if meta.find(f"{surface}/Planar") is not None:
        turn = axes(meta.vector(f"{surface}/Planar/uIAX"), meta.vector(f"{surface}/Planar/uIAY"), surface)
    else:  # of constant height above the ellipsoid: the plane that touches it at the reference point
        turn = _touching(geodetic, *(meta.vector(f"{surface}/HAE/uIA{axis}LL", ("Lat", "Lon")) for axis in "XY"))
    low, high = (meta.vector(f"{scene}/ImageArea/{corner}", "XY") for corner in ("X1Y1", "X2Y2"))
    if not np.all(high > low):
        raise ValueError(f"XML: {scene}/ImageArea: found {low.tolist()} to {high.tolist()}: expected an area")
    extent = {name: [float(a), float(b)] for name, a, b in zip("xy", low, high, strict=True)}
    return origin, turn, extent | {"z": 0.0}


def _touching(geodetic: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    """Axes of the plane that touches the surface of constant height; changes of latitude and longitude, rad, a metre along."""
    wgs84 = library("sarkit.wgs84")
    steps = np.degrees(np.append(np.stack([along_x, along_y]), np.zeros((2, 1)), axis=1))
    both = (wgs84.geodetic_to_cartesian(geodetic + steps) - wgs84.geodetic_to_cartesian(geodetic - steps)) / 2
    lengths = np.linalg.norm(both, axis=1)
    if np.abs(lengths - 1).max() > 1e-2:
        raise ValueError("XML: SceneCoordinates/ReferenceSurface/HAE: expected changes of a metre")
    up = wgs84.up(geodetic)
    x = both[0] - up * (both[0] @ up)
    x /= np.linalg.norm(x)
    y = np.cross(up, x)
    if both[1] @ y < 0.99:
        raise ValueError("XML: SceneCoordinates/ReferenceSurface/HAE: expected axes at right angles, x, y and up right-handed")
    return np.stack([x, y, up])


FORMAT = Format(
    name="cphd",
    title="CPHD 1.0.1 or 1.1.0, radar phase history",
    suffixes=(".cphd",),
    holds="echoes",
    kept="one channel's samples and geometry, on the axes of its image area; the XML as text",
    lost="support arrays, vectors without a signal; of echoes written half the digits of complex128, pulse, beam, attrs",
    sniff=_sniff,
    read=_read,
    channels=True,
    write=cphd_writing.write,
    writes=(Echoes,),
    extra="radar",
)
