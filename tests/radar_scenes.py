"""A radar's pass over points near Boulder as CPHD, written by sarkit: geometry, signal and XML from the standard alone.

Nothing of pysas is used here. Delays are the closed-form root of the moving receiver's quadratic, in Earth-fixed coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import sarkit.cphd
import sarkit.wgs84
from lxml import etree

C = 299792458.0
SITE = np.array([40.0, -105.25, 1650.0])  # latitude and longitude, degrees, height above the ellipsoid, m
NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/{}"
FIELDS = (
    ("TxTime", 1), ("TxPos", 3), ("TxVel", 3), ("RcvTime", 1), ("RcvPos", 3), ("RcvVel", 3), ("SRPPos", 3), ("aFDOP", 1),
    ("aFRR1", 1), ("aFRR2", 1), ("FX1", 1), ("FX2", 1), ("TOA1", 1), ("TOA2", 1), ("TDTropoSRP", 1), ("SC0", 1), ("SCSS", 1),
)  # fmt: skip


def frame(azimuth: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Origin and axes x, y, up of the image area in Earth-fixed coordinates; x towards `azimuth`, degrees from north."""
    north, east, up = (getattr(sarkit.wgs84, name)(SITE) for name in ("north", "east", "up"))
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    x = cos * north + sin * east
    return sarkit.wgs84.geodetic_to_cartesian(SITE), np.stack([x, np.cross(up, x), up])


@dataclass(frozen=True, kw_only=True)
class Pass:
    """What is written; places are on the axes of `frame`, m."""

    points: tuple[tuple[float, float, float], ...] = ((6.0, -9.0, 0.0),)
    amplitudes: tuple[complex, ...] = (2.0,)
    sign: int = -1
    domain: str = "FX"
    form: str = "CF8"
    version: str = "1.1.0"
    surface: str = "Planar"
    bistatic: bool = False
    hops: tuple[float, ...] = (0.0,)  # of the first frequency, Hz, ping after ping
    steps: tuple[float, ...] = (2.5e6,)
    scale: bool = False  # with AmpSF
    invalid: tuple[int, ...] = ()  # vectors without a signal; None of them: no SIGNAL
    channels: tuple[str, ...] = ("HH",)
    pings: int = 60
    count: int = 100
    change: Any = None  # of the XML's text
    made: dict[str, Any] = field(default_factory=dict)


def late(tx: Any, rx: Any, velocity: Any, place: Any) -> Any:
    """Travel time (ping,) by way of a place to receivers that are at `rx` at transmission and move: c t = |a| + |b + v t|."""
    tx, rx, velocity, place = (np.asarray(value, np.longdouble) for value in (tx, rx, velocity, place))
    out = np.sqrt(((tx - place) ** 2).sum(-1))
    back = rx - place
    a = C**2 - (velocity**2).sum(-1)
    b = C * out + (back * velocity).sum(-1)
    c = out**2 - (back**2).sum(-1)
    return (b + np.sqrt(b**2 - a * c)) / a


def write(path: Path, scene: Pass) -> dict[str, Any]:
    """A file by sarkit's writer; returns tx, rx (at transmission), velocity on the axes of `frame`, and the vectors."""
    origin, axes = frame()
    p = np.arange(scene.pings)
    time = 0.02 * p
    velocity = np.array([150.0, 120.0, 1.0]) @ axes
    tx = (np.array([-6000.0, 5000.0, 7000.0]) + [0.3, -0.2, 0.1] * np.sin(0.2 * p)[:, None]) @ axes + origin
    tx = tx + velocity * time[:, None]
    own = np.array([10.0, -90.0, 3.0]) @ axes if scene.bistatic else velocity
    rx = (np.array([3000.0, 4000.0, 6000.0]) @ axes + origin) + own * time[:, None] if scene.bistatic else tx
    to_point = late(tx, rx, own, origin)
    first, step = 9.3e9 + np.resize(scene.hops, scene.pings), np.resize(scene.steps, scene.pings)
    fx = first[:, None].astype(np.longdouble) + step[:, None] * np.arange(scene.count)
    band = np.stack([first, first + (scene.count - 1) * step], axis=1)
    toa = float(1 / (1.25 * step.max()))
    total = 0
    spacing = 1 / (1.3 * np.ptp(band, axis=1).max())
    start = -spacing * (scene.count // 2)
    for point, amplitude in zip(scene.points, scene.amplitudes, strict=True):
        delay = (late(tx, rx, own, np.asarray(point) @ axes + origin) - to_point)[:, None]
        if scene.domain == "FX":
            total = total + amplitude * np.exp(2j * np.pi * scene.sign * (fx * delay % 1).astype(float))
        else:
            turns = scene.sign * band.mean(axis=1)[:, None] * delay
            at = start + spacing * np.arange(scene.count) - delay
            shape = np.sinc((at * np.ptp(band, axis=1)[:, None]).astype(float))
            total = total + amplitude * shape * np.exp(2j * np.pi * (turns % 1).astype(float))
    scales = np.linspace(0.5, 2.0, scene.pings) if scene.scale else np.ones(scene.pings)
    signal = stored(total / scales[:, None], scene.form)
    names = list(FIELDS) + ([("AmpSF", 1)] if scene.scale else []) + ([("SIGNAL", 1)] if scene.invalid else [])
    tree = etree.ElementTree(etree.fromstring(xml(scene, names, band, toa, time, (start, spacing))))
    vectors = np.zeros(scene.pings, sarkit.cphd.get_pvp_dtype(tree))
    arrived = rx + own * np.asarray(to_point, float)[:, None]
    low = start if scene.domain == "TOA" else first
    values = {
        "TxTime": time, "TxPos": tx, "TxVel": velocity, "RcvTime": time + np.asarray(to_point, float), "RcvPos": arrived,
        "RcvVel": own, "SRPPos": origin, "FX1": band[:, 0], "FX2": band[:, 1], "TOA1": -toa / 2, "TOA2": toa / 2, "SC0": low,
        "SCSS": spacing if scene.domain == "TOA" else step, "AmpSF": scales, "SIGNAL": ~np.isin(p, scene.invalid),
        "aFRR1": 1e-9, "aFRR2": 2e-9 / band.sum(axis=1),
    }  # fmt: skip
    for name, _ in names:
        vectors[name] = values.get(name, 0.0)
    if scene.invalid:
        signal[list(scene.invalid)] = 0
        vectors["TxPos"][list(scene.invalid)] = np.nan
    old = tree.getroot().find("{*}ReferenceGeometry")
    if old is not None and not scene.invalid:
        made = sarkit.cphd.compute_reference_geometry(tree, vectors)
        tree.getroot().replace(old, made)
    with path.open("wb") as file, sarkit.cphd.Writer(file, sarkit.cphd.Metadata(xmltree=tree)) as writer:
        for name in scene.channels:
            writer.write_signal(name, signal)
            writer.write_pvp(name, vectors)
    turned = {"tx": (tx - origin) @ axes.T, "rx": (rx - origin) @ axes.T, "velocity": np.tile(own @ axes.T, (scene.pings, 1))}
    return turned | {"vectors": vectors, "signal": signal, "time": time, "fx": fx}


def stored(samples: Any, form: str) -> Any:
    """Samples in a format of the standard; whole numbers after a scale of 30 or 8000 a unit."""
    if form == "CF8":
        return samples.astype(np.complex64)
    unit, kind = {"CI2": (30, np.int8), "CI4": (8000, np.int16)}[form]
    whole = np.empty(samples.shape, [("real", kind), ("imag", kind)])
    whole["real"], whole["imag"] = np.round(unit * samples.real), np.round(unit * samples.imag)
    return whole


def xyz(values: Any) -> str:
    return "".join(f"<{name}>{float(value)!r}</{name}>" for name, value in zip("XYZ", values, strict=False))


def xml(scene: Pass, names: list[tuple[str, int]], band: Any, toa: float, time: Any, delays: tuple[float, float]) -> bytes:
    """The metadata that the standard asks for."""
    origin, axes = frame()
    words = np.cumsum([0] + [size for _, size in names])
    vectors = "".join(
        f"<{name}><Offset>{words[i]}</Offset><Size>{size}</Size><Format>"
        f"{'X=F8;Y=F8;Z=F8;' if size == 3 else 'I8' if name == 'SIGNAL' else 'F8'}</Format></{name}>"
        for i, (name, size) in enumerate(names)
    )  # in the order in which the standard lists them
    order = ("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "AmpSF", "aFDOP", "aFRR1", "aFRR2", "FX1",
             "FX2", "TOA1", "TOA2", "TDTropoSRP", "SC0", "SCSS", "SIGNAL")  # fmt: skip
    parts = {name: vectors[vectors.index(f"<{name}>") : vectors.index(f"</{name}>") + len(name) + 3] for name, _ in names}
    vectors = "".join(parts[name] for name in order if name in parts)
    area = "<X1Y1><X>-15.0</X><Y>-16.0</Y></X1Y1><X2Y2><X>17.0</X><Y>18.0</Y></X2Y2>"
    if scene.surface == "Planar":
        surface = f"<Planar><uIAX>{xyz(axes[0])}</uIAX><uIAY>{xyz(axes[1])}</uIAY></Planar>"
    else:  # changes of latitude and longitude, rad, a metre along: from the radii of curvature of WGS 84
        sine = np.sin(np.radians(SITE[0]))
        e2 = 0.00669437999014
        across = 6378137.0 / np.sqrt(1 - e2 * sine**2)
        along = across * (1 - e2) / (1 - e2 * sine**2)
        north, east = (getattr(sarkit.wgs84, name)(SITE) for name in ("north", "east"))
        ends = [
            (axis @ north / (along + SITE[2]), axis @ east / (across + SITE[2]) / np.cos(np.radians(SITE[0]))) for axis in axes
        ]
        surface = "<HAE>" + "".join(
            f"<uIA{name}LL><Lat>{float(lat)!r}</Lat><Lon>{float(lon)!r}</Lon></uIA{name}LL>"
            for name, (lat, lon) in zip("XY", ends[:2], strict=True)
        ) + "</HAE>"  # fmt: skip
    corners = [
        sarkit.wgs84.cartesian_to_geodetic(np.array(c) @ axes[:2] + origin)
        for c in ((-15, -16), (-15, 18), (17, 18), (17, -16))
    ]
    corner_points = "".join(
        f'<IACP index="{i + 1}"><Lat>{float(c[0])!r}</Lat><Lon>{float(c[1])!r}</Lon></IACP>' for i, c in enumerate(corners)
    )
    size = 8 * words[-1]
    each = scene.pings * scene.count * {"CF8": 8, "CI4": 4, "CI2": 2}[scene.form]
    data = "".join(
        f"<Channel><Identifier>{name}</Identifier><NumVectors>{scene.pings}</NumVectors><NumSamples>{scene.count}</NumSamples>"
        f"<SignalArrayByteOffset>{i * each}</SignalArrayByteOffset><PVPArrayByteOffset>{i * scene.pings * size}"
        "</PVPArrayByteOffset></Channel>" for i, name in enumerate(scene.channels)
    )  # fmt: skip
    fixed = "true" if np.ptp(band, axis=0).max() == 0 else "false"
    low, high = float(band.min()), float(band.max())
    parameters = "".join(
        f"<Parameters><Identifier>{name}</Identifier><RefVectorIndex>{scene.pings // 2}</RefVectorIndex><FXFixed>{fixed}"
        "</FXFixed><TOAFixed>true</TOAFixed><SRPFixed>true</SRPFixed><Polarization><TxPol>H</TxPol><RcvPol>H</RcvPol>"
        f"</Polarization><FxC>{(low + high) / 2!r}</FxC><FxBW>{high - low!r}</FxBW><TOASaved>{toa!r}</TOASaved><DwellTimes>"
        "<CODId>1</CODId><DwellId>1</DwellId></DwellTimes></Parameters>" for name in scene.channels
    )  # fmt: skip
    middle = float(time[scene.pings // 2])
    poly = '<{0}Poly order1="0" order2="0"><Coef exponent1="0" exponent2="0">{1!r}</Coef></{0}Poly></{0}>'
    poly = "<{0}><Identifier>1</Identifier>" + poly
    kind = "BISTATIC" if scene.bistatic else "MONOSTATIC"
    text = f"""<CPHD xmlns="{NAMESPACE.format(scene.version)}"><CollectionID><CollectorName>made</CollectorName>
<CoreName>a pass over points</CoreName><CollectType>{kind}</CollectType><RadarMode><ModeType>SPOTLIGHT</ModeType></RadarMode>
<Classification>UNCLASSIFIED</Classification><ReleaseInfo>UNRESTRICTED</ReleaseInfo></CollectionID>
<Global><DomainType>{scene.domain}</DomainType><SGN>{scene.sign:+d}</SGN><Timeline><CollectionStart>2026-01-01T00:00:00Z</CollectionStart>
<TxTime1>{float(time[0])!r}</TxTime1><TxTime2>{float(time[-1])!r}</TxTime2></Timeline><FxBand><FxMin>{low!r}</FxMin>
<FxMax>{high!r}</FxMax></FxBand><TOASwath><TOAMin>{-toa / 2!r}</TOAMin><TOAMax>{toa / 2!r}</TOAMax></TOASwath></Global>
<SceneCoordinates><EarthModel>WGS_84</EarthModel><IARP><ECF>{xyz(origin)}</ECF><LLH><Lat>{SITE[0]}</Lat><Lon>{SITE[1]}</Lon>
<HAE>{SITE[2]}</HAE></LLH></IARP><ReferenceSurface>{surface}</ReferenceSurface><ImageArea>{area}</ImageArea>
<ImageAreaCornerPoints>{corner_points}</ImageAreaCornerPoints></SceneCoordinates>
<Data><SignalArrayFormat>{scene.form}</SignalArrayFormat><NumBytesPVP>{size}</NumBytesPVP>
<NumCPHDChannels>{len(scene.channels)}</NumCPHDChannels>{data}<NumSupportArrays>0</NumSupportArrays></Data>
<Channel><RefChId>{scene.channels[0]}</RefChId><FXFixedCPHD>{fixed}</FXFixedCPHD><TOAFixedCPHD>true</TOAFixedCPHD>
<SRPFixedCPHD>true</SRPFixedCPHD>{parameters}</Channel><PVP>{vectors}</PVP>
<Dwell><NumCODTimes>1</NumCODTimes>{poly.format("CODTime", middle)}<NumDwellTimes>1</NumDwellTimes>
{poly.format("DwellTime", 0.9 * float(time[-1]))}</Dwell>
<ReferenceGeometry><SRP><ECF>{xyz(origin)}</ECF><IAC>{xyz(np.zeros(3))}</IAC></SRP><ReferenceTime>{middle}</ReferenceTime>
<SRPCODTime>{middle}</SRPCODTime><SRPDwellTime>{0.9 * float(time[-1])}</SRPDwellTime>REFERENCE</ReferenceGeometry></CPHD>"""
    monostatic = "".join(
        f"<{name}>{value}</{name}>" for name, value in (
            ("ARPPos", xyz(origin)), ("ARPVel", xyz(axes[0])), ("SideOfTrack", "L"), ("SlantRange", 1.0), ("GroundRange", 1.0),
            ("DopplerConeAngle", 90.0), ("GrazeAngle", 30.0), ("IncidenceAngle", 60.0), ("AzimuthAngle", 0.0),
            ("TwistAngle", 0.0),
            ("SlopeAngle", 0.0), ("LayoverAngle", 0.0))
    )  # fmt: skip
    text = text.replace("REFERENCE", f"<Monostatic>{monostatic}</Monostatic>")  # put right when the vectors are known
    return (text if scene.change is None else scene.change(text)).encode()
