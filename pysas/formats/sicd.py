"""Complex images of planes as SICD 1.4.0 (NGA.STND.0024) in NITF, and SICDs read into such images.

A SICD is made for radars that fly over the Earth. What an image of pysas does not know is filled with stand-ins, which
docs/formats.md lists, among them the place: without `ecef` the origin of the coordinates lies at latitude 0, longitude 0 on
the ellipsoid, x points east, y north and z up. Rows lie along x and columns along y, so that their normal points up.
"""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.formats import files
from pysas.formats.format import Format, Look
from pysas.formats.radar_xml import SPEED, Metadata, library, made, placed, quiet, xyz
from pysas.model.grid import Grid
from pysas.model.image import Image, Report

_OURS = "pysas-plane-1"  # the name of the parameter that keeps what only pysas knows
_CRC = f"{_OURS}-crc32"
_EVEN = 1e-6  # of a step, by which an axis may leave even spacing
_SENSOR = np.array([-1000.0, 0.0, 1000.0])  # of the stand-in track, m along rows, columns and up from the scene's centre
_ALONG = np.array([0.0, 100.0, 0.0])  # m/s
_BAND = 0.8  # of what the pixels can hold: the spacings that pysas chooses
_DURATION = 1.0  # s
_SECURITY = {"clas": "U"}


def _sniff(look: Look) -> bool:
    return look.head.startswith(b"NITF02.10") and b"SICD" in look.head


def write(path: str, image: Image, overwrite: bool = False, ecef: Mapping[str, Any] | None = None) -> None:
    """Write an image on an evenly spaced plane; complex128 pixels are rounded to complex64.

    Parameters
    ----------
    path : str
    image : Image
        On a plane of at least 2 x 2 pixels, both axes ascending and even to 1e-6 of a step.
    overwrite : bool
        Whether a file that is there may be replaced.
    ecef : mapping, optional
        Where the coordinates lie on the Earth, as `echoes.attrs["ecef"]` of a CPHD says: "origin" (3,) m and "axes" (3, 3) of
        unit vectors x, y and z in Earth-fixed coordinates. None: the stand-in of latitude 0, longitude 0.

    Raises
    ------
    ValueError
        Another grid, pixels too large for complex64, a frame that is none.
    ImportError
        `sarkit` is not installed.
    """
    sicd = library("sarkit.sicd")
    tree, pixels = _described(image, ecef)
    with quiet():
        meta = sicd.NitfMetadata(
            xmltree=tree, file_header_part={"ostaid": "pysas", "security": _SECURITY},
            im_subheader_part={"isorce": "pysas", "security": _SECURITY}, de_subheader_part={"security": _SECURITY},
        )  # fmt: skip
        with files.replacing(path, overwrite=overwrite) as file, sicd.NitfWriter(file, meta) as writer:
            writer.write_image(pixels)


def _described(image: Image, ecef: Mapping[str, Any] | None) -> tuple[Any, ComplexArray]:
    """The metadata of an image and its pixels, rows along x."""
    grid = image.grid
    if grid.kind != "plane" or min(grid.shape) < 2:
        raise ValueError(f"image: found a {grid.kind} of {grid.shape} pixels: expected a plane of at least 2 x 2")
    steps = []
    for name in "xy":
        axis = grid.axes[name]
        step = (axis[-1] - axis[0]) / (axis.size - 1)
        if step <= 0 or np.abs(axis - axis[0] - step * np.arange(axis.size)).max() > _EVEN * step:
            raise ValueError(f"image: grid's {name}: expected ascending and evenly spaced coordinates")
        steps.append(float(step))
    with np.errstate(over="ignore"):
        pixels = np.ascontiguousarray(image.data.T, dtype=np.complex64)
    if np.isinf(pixels).any() and not np.isinf(image.data).any():
        raise ValueError("image: pixels of more than 3.4e38: expected such as complex64 holds")
    origin, turn = placed(ecef)
    cos, sin = np.cos(grid.rotation), np.sin(grid.rotation)
    rows, columns = np.array([cos, sin, 0.0]) @ turn, np.array([-sin, cos, 0.0]) @ turn
    middle = (pixels.shape[0] // 2, pixels.shape[1] // 2)
    known: dict[str, Any] = {
        "x": grid.axes["x"][[0, -1]].tolist(), "y": grid.axes["y"][[0, -1]].tolist(), "z": float(np.max(grid.height)),
        "grid_origin": list(grid.origin), "rotation": grid.rotation, "fc": image.fc, "c": image.c,
        "report": image.report.as_dict(),
    }  # fmt: skip

    def ecef_of(row: float, column: float) -> FloatArray:
        x, y = grid.axes["x"][0] + row * steps[0], grid.axes["y"][0] + column * steps[1]
        local = [grid.origin[0] + cos * x - sin * y, grid.origin[1] + sin * x + cos * y, known["z"]]
        return np.asarray(origin + np.array(local) @ turn)

    text = json.dumps(known, sort_keys=True)
    return _tree(pixels.shape, middle, ecef_of, rows, columns, steps, image.fc, text), pixels


def _tree(
    shape: tuple[int, int],
    middle: tuple[int, int],
    ecef_of: Any,
    rows: FloatArray,
    columns: FloatArray,
    steps: list[float],
    fc: float,
    known: str,
) -> Any:
    """The XML: what the image tells, and the stand-ins."""
    sicd, wgs84 = library("sarkit.sicd"), library("sarkit.wgs84")

    def poly(values: list[float]) -> dict[str, Any]:
        return {"@order1": len(values) - 1, "Coef": [{"@exponent1": i, "": value} for i, value in enumerate(values)]}

    def direction(unit: FloatArray, step: float) -> dict[str, Any]:
        band = _BAND / step
        return {
            "UVectECF": xyz(unit), "SS": step, "ImpRespWid": 0.8859 / band, "Sgn": -1, "ImpRespBW": band, "KCtr": 0.0,
            "DeltaK1": -band / 2, "DeltaK2": band / 2, "WgtType": {"WindowName": "UNIFORM"},
        }  # fmt: skip

    scene = ecef_of(*middle)
    llh = wgs84.cartesian_to_geodetic(scene)
    own = np.stack([rows, columns, np.cross(rows, columns)])
    velocity = _ALONG @ own
    start = scene + _SENSOR @ own - velocity * _DURATION / 2
    last = (shape[0] - 1, shape[1] - 1)
    corners = [wgs84.cartesian_to_geodetic(ecef_of(*at)) for at in ((0, 0), (0, last[1]), last, (last[0], 0))]
    point = {"ECF": xyz(scene), "LLH": dict(zip(("Lat", "Lon", "HAE"), llh.tolist(), strict=True))}
    band = {"Min": fc * (1 - 1e-3), "Max": fc * (1 + 1e-3)}
    content: dict[str, Any] = {
        "CollectionInfo": {
            "CollectorName": "UNKNOWN", "CoreName": "UNKNOWN", "CollectType": "MONOSTATIC",
            "RadarMode": {"ModeType": "SPOTLIGHT"}, "Classification": "UNCLASSIFIED",
            "Parameter": [{"@name": _OURS, "": known}, {"@name": _CRC, "": zlib.crc32(known.encode())}],
        },
        "ImageCreation": {"Application": "pysas"},
        "ImageData": {
            "PixelType": "RE32F_IM32F", "NumRows": shape[0], "NumCols": shape[1], "FirstRow": 0, "FirstCol": 0,
            "FullImage": {"NumRows": shape[0], "NumCols": shape[1]}, "SCPPixel": {"Row": middle[0], "Col": middle[1]},
        },
        "GeoData": {
            "EarthModel": "WGS_84", "SCP": point,
            "ImageCorners": {"ICP": [
                {"@index": index, "Lat": float(at[0]), "Lon": float(at[1])}
                for index, at in zip(("1:FRFC", "2:FRLC", "3:LRLC", "4:LRFC"), corners, strict=True)
            ]},
        },
        "Grid": {
            "ImagePlane": "GROUND", "Type": "PLANE",
            "TimeCOAPoly": {"@order1": 0, "@order2": 0, "Coef": {"@exponent1": 0, "@exponent2": 0, "": _DURATION / 2}},
            "Row": direction(rows, steps[0]), "Col": direction(columns, steps[1]),
        },
        "Timeline": {"CollectStart": "1970-01-01T00:00:00Z", "CollectDuration": _DURATION},
        "Position": {"ARPPoly": {name: poly([float(a), float(b)]) for name, a, b in zip("XYZ", start, velocity, strict=True)}},
        "RadarCollection": {
            "TxFrequency": band, "TxPolarization": "UNKNOWN",
            "RcvChannels": {"@size": 1, "ChanParameters": {"@index": 1, "TxRcvPolarization": "UNKNOWN"}},
        },
        "ImageFormation": {
            "RcvChanProc": {"NumChanProc": 1, "ChanIndex": 1}, "TxRcvPolarizationProc": "UNKNOWN", "TStartProc": 0.0,
            "TEndProc": _DURATION, "TxFrequencyProc": {"MinProc": band["Min"], "MaxProc": band["Max"]},
            "ImageFormAlgo": "OTHER", "STBeamComp": "NO", "ImageBeamComp": "NO", "AzAutofocus": "NO", "RgAutofocus": "NO",
        },
    }  # fmt: skip
    tree = made("urn:SICD:1.4.0", "SICD", content)
    root = tree.getroot()
    with quiet():
        root.append(sicd.compute_scp_coa(tree))
    return tree


def _read(path: str, channel: str | None) -> Image:
    sicd = library("sarkit.sicd")
    with files.naming(path), files.opened(path) as file:
        xml, segments = _nitf(file)
        meta = Metadata(xml, sicd.VERSION_INFO)
        pixels = _pixels(file, meta, segments)
        return _image(meta, pixels)


def _nitf(file: IO[bytes]) -> tuple[bytes, list[tuple[str, int, int, int, int]]]:
    """The XML, and of each segment of the image its name, rows, columns and where its pixels begin; all within the file."""
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    try:  # what is wrong with a header, jbpy tells by any exception
        parsed = library("jbpy").Jbp().load(file)
        declared = int(parsed["FileHeader"]["FL"].value)
        text = parsed["DataExtensionSegments"][0]
        if not str(text["subheader"]["DESSHTN"].value).startswith("urn:SICD"):
            raise ValueError("found no SICD in its first data extension")
        place, length = int(text["DESDATA"].get_offset()), int(text["DESDATA"].size)
        segments = []
        for segment in parsed["ImageSegments"]:
            header = segment["subheader"]
            name = str(header["IID1"].value)
            if name.startswith("SICD"):
                found = {key: header[key].value for key in ("IC", "IMODE", "NBPR", "NBPC", "NBANDS", "NBPP")}
                if (found["IC"], found["IMODE"], found["NBPR"], found["NBPC"], found["NBANDS"]) != ("NC", "P", 1, 1, 2):
                    raise ValueError(f"found an image segment of {found}: expected two bands in one block")
                rows, columns = int(header["NROWS"].value), int(header["NCOLS"].value)
                data = segment["Data"]
                if int(data.size) != rows * columns * 2 * int(found["NBPP"]) // 8:
                    raise ValueError(f"found {data.size} bytes of {rows} x {columns} pixels")
                segments.append((name, rows, columns, int(data.get_offset()), int(data.size)))
    except (OSError, ImportError, MemoryError):
        raise
    except Exception as error:
        raise ValueError(f"NITF: {type(error).__name__}: {error!s:.200}") from None
    if declared != size:
        raise ValueError(f"NITF: found {size} bytes of {declared}: expected a whole file")
    for start, count in [(place, length), *((segment[3], segment[4]) for segment in segments)]:
        if start < 0 or count < 0 or start + count > size:
            raise ValueError(f"NITF: a segment ends at byte {start + count} of {size}")
    file.seek(place)
    return file.read(length), sorted(segments)


def _pixels(file: IO[bytes], meta: Metadata, segments: list[Any]) -> ComplexArray:
    """Pixels (row, column), complex64."""
    shape = meta.whole("ImageData/NumRows", low=1), meta.whole("ImageData/NumCols", low=1)
    kind = {"RE32F_IM32F": ">f4", "RE16I_IM16I": ">i2", "AMP8I_PHS8I": "u1"}[meta.get("ImageData/PixelType")]
    each = 2 * np.dtype(kind).itemsize
    if sum(rows for _, rows, *_ in segments) != shape[0] or any(
        columns != shape[1] or size != rows * columns * each for _, rows, columns, _, size in segments
    ):
        raise ValueError(f"NITF: image segments are not {shape[0]} x {shape[1]} pixels of {each} bytes")
    raw = np.empty((*shape, 2), np.dtype(kind))
    first = 0
    for _, rows, _, start, size in segments:
        file.seek(start)
        raw[first : first + rows] = np.frombuffer(file.read(size), kind).reshape(rows, shape[1], 2)
        first += rows
    pixels = np.empty(shape, np.complex64)
    if kind == "u1":
        phase = np.exp(2j * np.pi * np.arange(256) / 256).astype(np.complex64)
        pixels[:] = _amplitudes(meta)[raw[..., 0]] * phase[raw[..., 1]]
    else:
        pixels.real, pixels.imag = raw[..., 0], raw[..., 1]
    return pixels


def _amplitudes(meta: Metadata) -> npt.NDArray[np.float32]:
    """Of the 256 values of a byte."""
    table = {element.get("index"): element.text for element in meta.all("ImageData/AmpTable/Amplitude")}
    if table and set(table) != {str(index) for index in range(256)}:
        raise ValueError("XML: ImageData/AmpTable: expected one amplitude of each index from 0 to 255")
    return np.array([table.get(str(index), index) for index in range(256)], dtype=np.float32)


def _image(meta: Metadata, pixels: ComplexArray) -> Image:
    steps = [meta.number(f"Grid/{name}/SS") for name in ("Row", "Col")]
    data = np.ascontiguousarray(pixels.T)
    known = {str(element.get("name")): str(element.text or "") for element in meta.all("CollectionInfo/Parameter")}
    if {_OURS, _CRC} & set(known):
        return _ours(known.get(_OURS, ""), known.get(_CRC), steps, data)
    middle = [meta.whole(f"ImageData/SCPPixel/{name}") for name in ("Row", "Col")]
    first = [meta.whole(f"ImageData/First{name}") for name in ("Row", "Col")]
    x, y = (step * (np.arange(n) + low - at) for step, n, low, at in zip(steps, pixels.shape, first, middle, strict=True))
    band = [meta.number(f"ImageFormation/TxFrequencyProc/{name}Proc") for name in ("Min", "Max")]
    if min(steps) <= 0 or band[0] <= 0:
        raise ValueError(f"XML: found spacings {steps} m, frequencies {band} Hz: expected such > 0")
    algorithm, plane = meta.get("ImageFormation/ImageFormAlgo"), meta.get("Grid/ImagePlane")
    report = Report(f"SICD {meta.version}, {algorithm}, {plane.lower()} plane", choices={"sicd": meta.text})
    return Image(data, Grid.plane(x, y), report, fc=sum(band) / 2, c=SPEED)


def _ours(text: str, crc: str | None, steps: list[float], data: ComplexArray) -> Image:
    """An image that pysas wrote."""
    if crc != str(zlib.crc32(text.encode())):
        raise ValueError(f"XML: CollectionInfo/Parameter {_OURS}: damaged: expected another checksum")
    try:
        known = json.loads(text)
        ends = [known[name] for name in "xy"]
        x, y = (np.linspace(low, high, n) for (low, high), n in zip(ends, data.shape[::-1], strict=True))
        if abs((x[1] - x[0]) / steps[0] - 1) > _EVEN or abs((y[1] - y[0]) / steps[1] - 1) > _EVEN:
            raise ValueError("expected the spacings of Grid")
        grid = Grid.plane(x, y, known["z"], origin=known["grid_origin"], rotation=known["rotation"])
        return Image(data, grid, Report.from_dict(known["report"]), fc=known["fc"], c=known["c"])
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise ValueError(f"XML: CollectionInfo/Parameter {_OURS}: {error}") from None


def _written(path: str, item: Any, overwrite: bool) -> None:
    with files.naming(path):
        write(path, item, overwrite)


FORMAT = Format(
    name="sicd",
    title="SICD, complex images of radars in NITF",
    suffixes=(".nitf", ".ntf", ".sicd"),
    holds="images",
    kept="pixels in complex64, plane, report; of others' files pixels, spacings and the XML as text",
    lost="masks; half the digits of complex128; of others' files where on the Earth the plane lies, but for the XML",
    sniff=_sniff,
    read=_read,
    write=_written,
    writes=(Image,),
    extra="radar",
)
