"""Compressed echoes of a radar as CPHD 1.1.0: one channel over delay, about the origin of the coordinates.

The standard reckons with the speed of light, so that a sonar's echoes are none. What echoes do not know is filled with
stand-ins, which docs/formats.md lists.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.formats import files
from pysas.formats.radar_xml import SPEED, library, made, placed, quiet, xyz
from pysas.model.echoes import Echoes

_NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
_CHANNEL = "1"
# parameters of vectors, in the order of the standard
_FIELDS = (
    "TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "aFDOP", "aFRR1", "aFRR2", "FX1", "FX2", "TOA1",
    "TOA2", "TDTropoSRP", "SC0", "SCSS",
)  # fmt: skip
_INSIDE = 1e-6  # of a swath or a time, by which what is stated lies inside what there is


def write(path: str, echoes: Any, overwrite: bool) -> None:
    """Write echoes; ValueError names what is wrong with them."""
    cphd = library("sarkit.cphd")
    with files.naming(path):
        data = _required(echoes)
        origin, turn = placed(echoes.attrs.get("ecef"))
        signal, values = _vectors(echoes, data, origin, turn)
        tree = _tree(echoes, values, data.shape, origin, turn)
        with quiet():
            vectors = np.zeros(len(data), cphd.get_pvp_dtype(tree))
            for name in _FIELDS:
                vectors[name] = values[name]
            geometry = tree.getroot().find("{*}ReferenceGeometry")
            tree.getroot().replace(geometry, cphd.compute_reference_geometry(tree, vectors))
            with files.replacing(path, overwrite=overwrite) as file, cphd.Writer(file, cphd.Metadata(xmltree=tree)) as writer:
                writer.write_signal(_CHANNEL, signal)
                writer.write_pvp(_CHANNEL, vectors)


def _required(echoes: Echoes) -> ComplexArray:
    """The samples (ping, sample) of echoes that a CPHD can hold."""
    if not echoes.compressed or echoes.n_channel != 1 or echoes.n_ping < 2:
        kind = "compressed" if echoes.compressed else "raw"
        raise ValueError(f"found {kind} echoes of {echoes.n_ping} pings, {echoes.n_channel} channels: expected compressed, one")
    if np.abs(echoes.speeds / SPEED - 1).max() > 1e-9:
        raise ValueError(f"found c={echoes.mean_speed:g} m/s: expected that of light, with which a CPHD reckons, {SPEED:g}")
    if echoes.valid is not None:
        raise ValueError("found echoes with windows (valid): expected whole records: echoes.whole()")
    if echoes.ping_time is not None and np.any(np.diff(echoes.ping_time) <= 0):
        raise ValueError("ping_time: expected ascending times")
    data = echoes.traces[:, 0]
    if not np.isfinite(data).all():
        raise ValueError(f"data: not finite at ping {int(np.argwhere(~np.isfinite(data))[0, 0])}")
    return data


def _vectors(echoes: Echoes, data: ComplexArray, origin: FloatArray, turn: FloatArray) -> tuple[ComplexArray, dict[str, Any]]:
    """Samples with their carrier's phase about the origin of the coordinates, and each ping's parameters."""
    time = np.arange(echoes.n_ping) * 1.0 if echoes.ping_time is None else echoes.ping_time - echoes.ping_time[0]
    tx, rx = echoes.tx, echoes.receivers[:, 0]
    moving = echoes.receiver_velocity
    velocity = np.zeros_like(tx) if moving is None else moving[:, 0]
    # a transmitter that stands where the receiver does moves as it does
    along = velocity if moving is not None and np.allclose(tx, rx, rtol=0, atol=1e-6) else np.gradient(tx, time, axis=0)
    late = _arrival(tx, rx, velocity)
    turns = np.longdouble(echoes.fc) * late.astype(np.longdouble) % 1
    signal = (data * np.exp(2j * np.pi * turns.astype(np.float64))[:, None]).astype(np.complex64)
    half = echoes.occupied_bandwidth / 2
    if half >= echoes.fc:
        raise ValueError(f"bandwidth={2 * half:g} Hz about {echoes.fc:g} Hz: expected frequencies > 0")
    first, span = echoes.start_time - late, (echoes.n_sample - 1) / echoes.fs
    # one swath that all records hold, a little inside
    low, high = float(first.max()) + _INSIDE * span, float(first.min()) + (1 - _INSIDE) * span
    if not low < 0 < high:
        raise ValueError("t0: expected records of all pings that hold the origin of the coordinates")
    values = {
        "TxTime": time, "TxPos": tx @ turn + origin, "TxVel": along @ turn, "RcvTime": time + late,
        "RcvPos": (rx + velocity * late[:, None]) @ turn + origin, "RcvVel": velocity @ turn, "SRPPos": origin, "aFDOP": 0.0,
        "aFRR1": 0.0, "aFRR2": 0.0, "FX1": echoes.fc - half, "FX2": echoes.fc + half, "TOA1": low, "TOA2": high,
        "TDTropoSRP": 0.0, "SC0": first, "SCSS": 1 / echoes.fs,
    }  # fmt: skip
    return signal, values


def _arrival(tx: FloatArray, rx: FloatArray, velocity: FloatArray) -> FloatArray:
    """When the echo of the origin meets the receiver, s: the root of c t = |tx| + |rx + v t|."""
    out = np.linalg.norm(tx, axis=1)
    square = SPEED**2 - np.sum(velocity**2, axis=1)
    half = SPEED * out + np.sum(rx * velocity, axis=1)
    rest = out**2 - np.sum(rx**2, axis=1)
    return np.asarray((half + np.sqrt(half**2 - square * rest)) / square)


def _tree(echoes: Echoes, values: dict[str, Any], shape: tuple[int, ...], origin: FloatArray, turn: FloatArray) -> Any:
    """The XML: what the echoes tell, and the stand-ins."""
    wgs84 = library("sarkit.wgs84")
    (left, right), (bottom, top) = _area(echoes.attrs.get("scene_area"), values)
    around = ((left, bottom), (left, top), (right, top), (right, bottom))
    corners = [wgs84.cartesian_to_geodetic(np.array([*place, 0.0]) @ turn + origin) for place in around]
    lines, samples = (_spaced(*ends, 0.8 * SPEED / 2 / echoes.occupied_bandwidth) for ends in ((left, right), (bottom, top)))
    fields: dict[str, Any] = {}
    word = 0
    for name in _FIELDS:
        size = 3 if name.endswith(("Pos", "Vel")) else 1
        fields[name] = {"Offset": word, "Size": size, "Format": "X=F8;Y=F8;Z=F8;" if size == 3 else "F8"}
        word += size
    first, last = float(values["FX1"]), float(values["FX2"])
    toa = {"TOAMin": values["TOA1"], "TOAMax": values["TOA2"]}
    reference = library("sarkit.cphd").compute_t_ref(
        *(values[name] for name in ("TxPos", "RcvPos", "SRPPos", "TxTime", "RcvTime"))
    )
    middle, dwell = float(reference[0] + reference[-1]) / 2, float(reference[-1] - reference[0]) * (1 - _INSIDE)
    together = np.allclose(echoes.tx, echoes.receivers[:, 0], rtol=0, atol=1e-3)
    point = {
        "ECF": xyz(origin),
        "LLH": dict(zip(("Lat", "Lon", "HAE"), wgs84.cartesian_to_geodetic(origin).tolist(), strict=True)),
    }
    return made(
        _NAMESPACE,
        "CPHD",
        {
            "CollectionID": {
                "CollectorName": "UNKNOWN", "CoreName": str(echoes.attrs.get("title") or "UNKNOWN"),
                "CollectType": "MONOSTATIC" if together else "BISTATIC", "RadarMode": {"ModeType": "SPOTLIGHT"},
                "Classification": "UNCLASSIFIED", "ReleaseInfo": "UNKNOWN",
            },
            "Global": {
                "DomainType": "TOA", "SGN": -1,
                "Timeline": {
                    "CollectionStart": "1970-01-01T00:00:00Z", "TxTime1": float(values["TxTime"][0]),
                    "TxTime2": float(values["TxTime"][-1]),
                },
                "FxBand": {"FxMin": first, "FxMax": last}, "TOASwath": toa,
            },
            "SceneCoordinates": {
                "EarthModel": "WGS_84", "IARP": point,
                "ReferenceSurface": {"Planar": {"uIAX": xyz(turn[0]), "uIAY": xyz(turn[1])}},
                "ImageArea": {"X1Y1": {"X": left, "Y": bottom}, "X2Y2": {"X": right, "Y": top}},
                "ImageAreaCornerPoints": {
                    "IACP": [{"@index": i + 1, "Lat": float(at[0]), "Lon": float(at[1])} for i, at in enumerate(corners)]
                },
                "ImageGrid": {
                    "IARPLocation": {"Line": lines[2], "Sample": samples[2]},
                    "IAXExtent": {"LineSpacing": lines[0], "FirstLine": 0, "NumLines": lines[1]},
                    "IAYExtent": {"SampleSpacing": samples[0], "FirstSample": 0, "NumSamples": samples[1]},
                },
            },
            "Data": {
                "SignalArrayFormat": "CF8", "NumBytesPVP": 8 * word, "NumCPHDChannels": 1,
                "Channel": {
                    "Identifier": _CHANNEL, "NumVectors": shape[0], "NumSamples": shape[1], "SignalArrayByteOffset": 0,
                    "PVPArrayByteOffset": 0,
                },
                "NumSupportArrays": 0,
            },
            "Channel": {
                "RefChId": _CHANNEL, "FXFixedCPHD": "true", "TOAFixedCPHD": "true", "SRPFixedCPHD": "true",
                "Parameters": {
                    "Identifier": _CHANNEL, "RefVectorIndex": shape[0] // 2, "FXFixed": "true", "TOAFixed": "true",
                    "SRPFixed": "true", "Polarization": {"TxPol": "UNSPECIFIED", "RcvPol": "UNSPECIFIED"},
                    "FxC": (first + last) / 2, "FxBW": last - first, "TOASaved": toa["TOAMax"] - toa["TOAMin"],
                    "DwellTimes": {"CODId": "1", "DwellId": "1"},
                },
            },
            "PVP": fields,
            "Dwell": {
                "NumCODTimes": 1, "CODTime": {"Identifier": "1", "CODTimePoly": _constant(middle)}, "NumDwellTimes": 1,
                "DwellTime": {"Identifier": "1", "DwellTimePoly": _constant(dwell)},
            },
            # the rest of it is reckoned from the vectors
            "ReferenceGeometry": {"SRP": {"ECF": xyz(origin), "IAC": xyz(np.zeros(3))}},
        },
    )  # fmt: skip


def _spaced(low: float, high: float, wanted: float) -> tuple[float, int, float]:
    """Spacing of pixels that fill a span, how many they are, and which of them, in parts, lies at 0."""
    count = max(1, round((high - low) / wanted))
    spacing = (high - low) / count
    return spacing, count, -low / spacing - 0.5


def _constant(value: float) -> dict[str, Any]:
    return {"@order1": 0, "@order2": 0, "Coef": {"@exponent1": 0, "@exponent2": 0, "": value}}


def _area(area: Any, values: dict[str, npt.NDArray[Any]]) -> list[list[float]]:
    """Spans along x and y that the echoes' attrs name, or else a square as large as the swath of ranges."""
    if area is None:
        half = SPEED / 4 * float(values["TOA2"] - values["TOA1"])
        return [[-half, half], [-half, half]]
    if not isinstance(area, Mapping) or not {"x", "y", "z"} <= set(area) or area["z"] != 0:
        raise ValueError(
            'attrs["scene_area"]: expected {"x": [low, high], "y": [low, high], "z": 0}, of a plane with the origin'
        )
    spans = [_checks.reals(f'attrs["scene_area"][{name!r}]', area[name], [(2,)]).tolist() for name in "xy"]
    if any(high <= low for low, high in spans):
        raise ValueError(f'attrs["scene_area"]: found {spans}: expected ascending spans')
    return spans
