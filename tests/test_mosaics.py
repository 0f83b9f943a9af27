"""Mosaics: where targets lie, what strips that overlap become, what is written, and what is refused.

Truth for places is pyproj's own chain (topocentric, geocentric, UTM); readers are rasterio and xarray.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
import xarray

from pysas.cli import main
from pysas.formats.rasters import Decibels
from pysas.navigation import Frame, to_utm
from pysas.survey import image_store, placing
from pysas.survey.mosaics import Mosaic, mosaic

pytestmark = pytest.mark.reference  # no engine takes part

STEP = 0.1
FRAME = {"heading": 0.7, "lat": 54.3, "lon": 10.1, "origin": [20.0, -30.0, 0.0]}
Field = Callable[[Any, Any], Any]  # magnitude of x, y on a strip's axes


def header(name: str = "a", columns: int = 50, tiles: int = 4, rows: int = 160, near: float = 4.0, **changes: Any) -> Any:
    """A strip of 20 m along and 16 m across, from 4 m to starboard on."""
    attributes = {
        "line": f"{name}.zarr",
        "side": "starboard",
        "origin": [0.0, 0.0],
        "rotation": 0.0,
        "track": 0.0,
        "frame": None,
        "z": None,
    }
    step = changes.pop("step", STEP)
    y = near + step * np.arange(rows)
    if changes.get("side") == "port":
        y = -y
    return image_store.StripHeader(name, attributes | changes, step * np.arange(columns * tiles), y, columns)


def store(path: Path, *strips: tuple[Any, Field | float]) -> Path:
    """A store whose tiles are all done."""
    image_store.create(path, {}, [strip for strip, _ in strips])
    for strip, (made, field) in zip(image_store.SurveyStore(path).strips, strips, strict=True):
        values = field(made.x[None], made.y[:, None]) if callable(field) else np.full((made.y.size, made.x.size), field)
        for tile in range(strip.tiles):
            strip.write(tile, values[:, tile * made.columns : (tile + 1) * made.columns].astype(np.complex64), {})
    return path


def pixels(path: Path) -> tuple[Any, Any, Any]:
    """Magnitudes of a GeoTIFF, and x, y of its pixels' centres."""
    with rasterio.open(path) as found:
        rows, columns = np.mgrid[: found.height, : found.width] + 0.5
        x, y = found.transform.c + found.transform.a * columns, found.transform.f + found.transform.e * rows
        return found.read(1), x, y


def left(folder: Path) -> list[str]:
    return sorted(item.name for item in folder.iterdir())


# Places


def strip_of(lat: Any, lon: Any, frame: dict[str, Any], origin: Any, rotation: float, z: float) -> tuple[Any, Any]:
    """Places on a strip's axes of places on its plane, by pyproj's topocentric axes and rotations written out here."""
    local = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={frame['lon']} +lat_0={frame['lat']}"
    )
    height = np.zeros(lat.shape)
    for _ in range(6):  # until it lies z below the frame's origin
        east, north, up = local.transform(lon, lat, height)
        height -= up + frame["origin"][2] + z
    north, east = north - frame["origin"][0], east - frame["origin"][1]
    cos, sin = np.cos(frame["heading"]), np.sin(frame["heading"])
    x, y = cos * north + sin * east - origin[0], cos * east - sin * north - origin[1]
    return np.cos(rotation) * x + np.sin(rotation) * y, np.cos(rotation) * y - np.sin(rotation) * x


@pytest.mark.parametrize("side", ["port", "starboard"])
@pytest.mark.parametrize(("rotation", "origin"), [(0.0, (0.0, 0.0)), (2.1, (3000.0, -4000.0)), (-0.6, (-900.0, 1500.0))])
def test_targets_lie_where_they_are(side: str, rotation: float, origin: tuple[float, float], tmp_path: Path) -> None:
    frame, z = FRAME | {"heading": 0.7 + rotation / 2}, 25.0
    made = header(side=side, frame=frame, origin=list(origin), rotation=rotation, z=z, near=6.0)
    sign = -1 if side == "port" else 1
    about = np.array([[3.03, 8.21], [11.57, 14.96], [17.22, 19.4]]) * [1, sign]
    # latitudes and longitudes about those places, to 1e-7 degrees: their own places come from them alone
    cos, sin = np.cos(rotation), np.sin(rotation)
    line = np.stack([origin[0] + about @ [cos, -sin], origin[1] + about @ [sin, cos], np.full(3, z)], axis=-1)
    lat, lon, _ = (np.round(value, 7) for value in Frame(**frame).to_geodetic(line))
    x, y = strip_of(lat, lon, frame, origin, rotation, z)
    assert np.abs(np.stack([x, y], -1) - about).max() < 0.02

    def blobs(at_x: Any, at_y: Any) -> Any:
        return 0.01 + sum(np.exp(-((at_x - u) ** 2 + (at_y - v) ** 2) / (2 * 0.15**2)) for u, v in zip(x, y, strict=True))

    found = mosaic(store(tmp_path / "s.zarr", (made, blobs)), tmp_path / "m.tif")
    assert found.crs == "EPSG:32632" and found.pixel == pytest.approx(STEP)
    east, north = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True).transform(lon, lat)
    values, at_east, at_north = pixels(tmp_path / "m.tif")
    for e, n in zip(east, north, strict=True):
        near = np.hypot(at_east - e, at_north - n) < 0.6
        weight = np.where(near, values - 0.01, 0).astype(float) ** 2
        found_at = [(weight * axis).sum() / weight.sum() for axis in (at_east, at_north)]  # the middle of its power
        assert np.abs(np.array(found_at) - [e, n]).max() < 0.05 * STEP


def test_the_chain_is_that_of_the_projection_without_pyproj(tmp_path: Path) -> None:
    made = header(frame=FRAME, origin=[1000.0, 2000.0], rotation=0.3, z=5.0)
    chart = placing.chart(image_store.SurveyStore(store(tmp_path / "s.zarr", (made, 1.0))).strips, None)
    (place,) = chart.places
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-2000, 2000, (2, 200))
    line = np.stack([1000 + np.cos(0.3) * x - np.sin(0.3) * y, 2000 + np.sin(0.3) * x + np.cos(0.3) * y, np.full(200, 5.0)], -1)
    lat, lon, _ = Frame(**FRAME).to_geodetic(line)
    east, north = to_utm(lat, lon, 32)
    found = place.to_map(x, y)
    assert np.abs(found[0] - east).max() < 1e-6 and np.abs(found[1] - north).max() < 1e-6
    back = place.from_map(*found)
    assert np.abs(back[0] - x).max() < 1e-6 and np.abs(back[1] - y).max() < 1e-6


@pytest.mark.filterwarnings("ignore:crs='EPSG.3413'")  # meant for latitudes beyond 60 degrees
@pytest.mark.parametrize("pixel", [0.025, 1.0, 4.0])
@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:3857", "EPSG:3413"])
def test_places_between_those_of_the_lattice_are_right_to_a_millimetre(pixel: float, crs: str, tmp_path: Path) -> None:
    made = header(frame=FRAME, z=5.0)
    chart = placing.chart(image_store.SurveyStore(store(tmp_path / "s.zarr", (made, 1.0))).strips, crs)
    (place,) = chart.places
    asked = []

    def inverse(east: Any, north: Any) -> Any:
        asked.append(east.size)
        return place.from_map(east, north)

    east, north = chart.bounds[0][0] + pixel * np.arange(512), chart.bounds[0][2] - pixel * np.arange(512)
    x, y = placing.over(inverse, east, north)
    exact = place.from_map(*(part.ravel() for part in np.meshgrid(east, north)))
    assert max(np.abs(x.ravel() - exact[0]).max(), np.abs(y.ravel() - exact[1]).max()) < placing.MAP_ERROR < 1e-3
    assert sum(asked) < 50_000  # of 262,144 pixels


def test_lines_in_local_metres(tmp_path: Path) -> None:
    """Without a frame x is to the right and y up; with one that has a heading, east and north."""
    spot = lambda x, y: 0.1 + np.exp(-((x - 12.3) ** 2 + (y - 9.1) ** 2) / 0.05)  # noqa: E731
    for number, (frame, place) in enumerate(
        [(None, (112.3, 59.1)), ({"heading": np.pi / 2, "lat": None, "lon": None, "origin": [7.0, 3.0, 0.0]}, (115.3, -52.1))]
    ):
        path = store(tmp_path / f"{number}.zarr", (header(origin=[100.0, 50.0], frame=frame), spot))
        found = mosaic(path, tmp_path / f"{number}.tif")
        values, x, y = pixels(tmp_path / f"{number}.tif")
        with rasterio.open(tmp_path / f"{number}.tif") as tif:
            assert tif.crs is None and found.crs is None
        peak = np.nanargmax(values)
        assert abs(x.flat[peak] - place[0]) <= 0.51 * STEP and abs(y.flat[peak] - place[1]) <= 0.51 * STEP
        with pytest.raises(ValueError, match="local metres"):
            mosaic(path, tmp_path / "x.tif", crs="EPSG:32632")
    with pytest.raises(ValueError, match=r"a is tied to the Earth, b in local metres without a frame: expected"):
        mosaic(store(tmp_path / "m.zarr", (header("a", frame=FRAME), 1.0), (header("b"), 1.0)), tmp_path / "x.tif")


# Strips that overlap: two lines that look at each other from 40 m apart, each at ground ranges of 3.98 to 29.98 m


def facing(path: Path, first: Field | float = 2.0, second: Field | float = 6.0) -> Path:
    one = header("one", rows=260, near=4.03, origin=[0.013, 0.0])
    other = header("other", rows=260, near=4.03, origin=[19.913, 40.0], rotation=np.pi)  # the same x, turned round
    return store(path, (one, first), (other, second))


def profile(path: Path, output: Path, **options: Any) -> tuple[Any, Any]:
    """Magnitudes across the lines in the middle of them, and y."""
    mosaic(path, output, **options)
    values, x, y = pixels(output)
    column = int(np.abs(x[0] - 10).argmin())
    return values[:, column], y[:, column]


def test_where_lines_overlap_one_is_taken_or_their_mean(tmp_path: Path) -> None:
    path = facing(tmp_path / "s.zarr")
    for combine, low, high in (("nearest", 2, 6), ("strongest", 6, 6), ("mean", 4, 4)):
        found, y = profile(path, tmp_path / "m.tif", combine=combine, overwrite=True)
        expected = np.select(
            [(y > 3.98) & (y < 10.02), (y > 10.02) & (y < 20), (y > 20) & (y < 29.98), (y > 29.98) & (y < 36.02)],
            [2.0, low, high, 6.0],
            np.nan,
        )
        assert np.allclose(found, expected, rtol=1e-6, equal_nan=True), combine


def test_a_feather_is_what_its_formulas_say(tmp_path: Path) -> None:
    path, feather = facing(tmp_path / "s.zarr"), 3.0
    nearest, y = profile(path, tmp_path / "n.tif", feather=feather)
    mean, _ = profile(path, tmp_path / "m.tif", feather=feather, combine="mean")
    strongest, _ = profile(path, tmp_path / "x.tif", feather=feather, combine="strongest")
    covered = ~np.isnan(nearest)
    # distances from where data end: the samples that would follow
    f = [np.clip(np.minimum(at - 3.93, 30.03 - at) / feather, 0, 1) for at in (y, 40 - y)]
    over = np.clip((1 + (y - (40 - y)) / feather) / 2, 0, 1)  # how far the other line lies over the first
    w = f[0] * (1 - f[1] * over), f[1] * (1 - f[0] * (1 - over))
    for found, expected in (
        (nearest, (2 * w[0] + 6 * w[1]) / (w[0] + w[1] + 1e-30)),
        (mean, (2 * f[0] + 6 * f[1]) / (f[0] + f[1] + 1e-30)),
        (strongest, np.maximum(2 * f[0], 6 * f[1]) / (np.maximum(f[0], f[1]) + 1e-30)),
    ):
        inner = covered & (np.maximum(f[0], f[1]) > 0.05)
        assert np.abs(found - expected)[inner].max() < 0.02
        # nothing jumps: from 2 to 6 over the feather, for "strongest" in one part of it
        assert np.abs(np.diff(found[covered])).max() < 4 * 4 * STEP / feather
    assert (
        nearest[np.abs(y - 20).argmin()] == pytest.approx(4, abs=0.15)
        and np.abs(np.diff(nearest[(y > 15) & (y < 25)])).max() < 0.2
    )
    sharp, _ = profile(path, tmp_path / "s.tif")
    assert np.nanmax(np.abs(np.diff(sharp))) == pytest.approx(4)


def test_holes_are_feathered_too_and_lend_nothing(tmp_path: Path) -> None:
    """What no ping lights is 0 in a tile: no data, as a tile is that is not there."""
    path = facing(tmp_path / "s.zarr", lambda x, y: np.where((x > 6) & (x < 12) & (y < 24), 0.0, 2.0))
    mosaic(path, tmp_path / "m.tif", feather=2.0)
    values, x, y = pixels(tmp_path / "m.tif")
    row = int(np.abs(y[:, 0] - 15).argmin())
    found, at = values[row], x[row]
    assert np.allclose(found[(at > 6.1) & (at < 11.9)], 6) and np.isclose(found[np.abs(at - 3).argmin()], 2)
    assert np.abs(np.diff(found[(at > 2.1) & (at < 17)])).max() < 4 * 1.5 * STEP / 2
    alone = (y > 4.1) & (y < 9.9) & (x > 6.1) & (x < 11.9)
    assert np.isnan(values[alone]).all()


def test_three_lines_at_random_against_the_formula_pixel_by_pixel(tmp_path: Path) -> None:
    """No feather: nearest by ground range from each track, on axes turned by any angle; port and starboard."""
    strips, angles = [], (0.3, 2.5, -1.1)
    for k, angle in enumerate(angles):
        side = "port" if k == 1 else "starboard"
        strips.append((header(f"s{k}", side=side, origin=[3.0 * k, 2.0 * k], rotation=angle, track=0.5 * k), float(k + 1)))
    path = store(tmp_path / "s.zarr", *strips)
    found = {}
    for combine in ("nearest", "strongest", "mean"):
        mosaic(path, tmp_path / f"{combine}.tif", combine=combine)
        found[combine], x, y = pixels(tmp_path / f"{combine}.tif")
    inside, ranges = [], []
    clear = np.ones(x.shape, dtype=bool)  # of edges
    for k, angle in enumerate(angles):
        u, v = x - 3 * k, y - 2 * k
        u, v = np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
        v = -v if k == 1 else v
        away = np.minimum.reduce([u + STEP / 2, 19.95 - u, v - 3.95, 19.95 - v])
        clear &= np.abs(away) > 1e-3
        inside.append(away > 0)
        ranges.append(np.where(away > 0, np.abs((-v if k == 1 else v) - 0.5 * k), np.inf))
    shape = (3, 1, 1)
    value, inside_all = np.arange(1.0, 4).reshape(shape), np.array(inside)
    some = inside_all.any(axis=0)
    assert np.array_equal(~np.isnan(found["nearest"])[clear], some[clear]) and (inside_all.sum(axis=0) > 1).sum() > 500
    at = clear & some
    expected = {
        "nearest": 1.0 + np.argmin(ranges, axis=0),
        "strongest": np.where(inside_all, value, 0).max(axis=0),
        "mean": np.where(inside_all, value, 0).sum(axis=0) / np.maximum(inside_all.sum(axis=0), 1),
    }
    for combine, truth in expected.items():
        assert np.allclose(found[combine][at], truth[at], rtol=1e-5), combine


# Sizes of pixels


@pytest.mark.parametrize("pixel", [0.1, 0.2, 0.25, 0.73])
def test_mean_power_is_kept_whatever_the_size_of_pixels(pixel: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    speckle = lambda x, y: np.sqrt(rng.exponential(size=(y.size, x.size)))  # noqa: E731
    path = store(tmp_path / "s.zarr", (header(rows=400, tiles=10, rotation=0.4), speckle))
    power = np.mean([image_store.SurveyStore(path).strips[0].read(tile).astype(float) ** 2 for tile in range(10)])
    mosaic(path, tmp_path / "m.tif", pixel=pixel)
    values, *_ = pixels(tmp_path / "m.tif")
    assert np.nanmean(values.astype(float) ** 2) == pytest.approx(power, rel=0.01)


def test_nothing_aliases_into_coarse_pixels(tmp_path: Path) -> None:
    """Rows of 1 and 3 in turn: power 5 whatever the pixel's place; every fourth sample alone would be 1 or 3."""
    bars = lambda x, y: 1.0 + 2 * (np.rint((y - 4) / STEP).astype(int) % 2) + 0 * x  # noqa: E731
    path = store(tmp_path / "s.zarr", (header(rotation=0.2), bars))
    mosaic(path, tmp_path / "m.tif", pixel=4 * STEP)
    values, *_ = pixels(tmp_path / "m.tif")
    inner = values[~np.isnan(values)]
    assert np.abs(np.median(inner) - np.sqrt(5)) < 1e-5 and np.mean(np.abs(inner - np.sqrt(5)) < 0.01) > 0.85


def test_a_map_does_not_depend_on_how_it_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    path = facing(tmp_path / "s.zarr", lambda x, y: rng.random((y.size, x.size)), 3.0)
    mosaic(path, tmp_path / "a.tif", feather=2.0)
    monkeypatch.setattr("pysas.survey.mosaics._PART", 37)
    monkeypatch.setattr("pysas.survey.sampling._CACHE", 1)
    for module in ("mosaics", "geotiff"):
        monkeypatch.setattr(f"pysas.{'survey' if module == 'mosaics' else 'formats'}.{module}.WINDOW", 64)
    mosaic(path, tmp_path / "b.tif", feather=2.0)
    one, other = pixels(tmp_path / "a.tif")[0], pixels(tmp_path / "b.tif")[0]
    assert np.allclose(one, other, rtol=1e-5, equal_nan=True)


MEMORY = """
    import re, sys
    import rasterio, pyproj, zarr, scipy.ndimage, pysas.survey.mosaics as m
    most = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) * 1024
    before = most()
    found = m.mosaic(sys.argv[1], sys.argv[2], pixel=0.0034, feather=1.0, db=40)
    print(found.shape[0] * found.shape[1] * 4, before, most())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.slow
def test_memory_does_not_grow_with_the_map(tmp_path: Path) -> None:
    path = store(
        tmp_path / "s.zarr", (header(rotation=0.7, near=10.0, rows=25), 1.0), (header("b", origin=[0.0, 40.0], rows=25), 2.0)
    )
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(MEMORY), str(path), str(tmp_path / "m.tif")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    size, before, peak = (int(word) for word in run.stdout.split())
    assert size > 350e6 and 10e6 < peak - before < 250e6 and peak < 500e6  # bytes; the first: were the map in memory as float32


# What is written


def test_a_geotiff_is_cloud_optimised_and_says_what_it_holds(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    made = header(frame=FRAME, rows=1100, columns=300)
    path = store(tmp_path / "s.zarr", (made, lambda x, y: np.exp(2 * rng.standard_normal((y.size, x.size)))))
    floats, coded = mosaic(path, tmp_path / "f.tif"), mosaic(path, tmp_path / "b.tiff", db=50)
    assert left(tmp_path) == ["b.tiff", "f.tif", "s.zarr"]
    with rasterio.open(tmp_path / "f.tif") as tif:
        magnitude = tif.read(1)
        assert tif.dtypes == ("float32",) and np.isnan(tif.nodata)
    share = np.mean(~np.isnan(magnitude))
    assert floats.coverage == share == coded.coverage and floats.reference is None
    for name, found in (("f.tif", floats), ("b.tiff", coded)):
        with rasterio.open(tmp_path / name) as tif:
            assert tif.crs == rasterio.crs.CRS.from_epsg(32632) and tif.crs.to_epsg() == 32632
            assert (
                tif.shape == found.shape
                and tuple(tif.bounds) == pytest.approx(found.bounds)
                and tif.res == pytest.approx((STEP, STEP))
            )
            assert np.allclose(np.array(tif.bounds) / STEP, np.rint(np.array(tif.bounds) / STEP), atol=1e-4)
            assert tif.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and tif.compression.name == "deflate"
            assert tif.block_shapes == [(512, 512)] and tif.overviews(1)[:2] == [2, 4] and tif.tags()["combine"] == "nearest"
    with rasterio.open(tmp_path / "b.tiff") as tif:
        values = tif.read(1)
        reference = float(tif.tags()["reference"])
        assert tif.dtypes == ("uint8",) and tif.nodata == 0 and float(tif.tags()["db"]) == 50 and tif.units == ("dB",)
        scale, offset = tif.scales[0], tif.offsets[0]
    assert np.array_equal(values == 0, np.isnan(magnitude)) and reference == coded.reference
    assert 20 * np.log10(reference / np.nanpercentile(magnitude, 99.9)) == pytest.approx(0, abs=0.02)
    level = 20 * np.log10(magnitude[values > 0] / reference)
    assert np.abs(np.clip(level, -50, 0) - (values[values > 0] * scale + offset)).max() <= 0.5 * 50 / 254 + 1e-3
    assert np.all(values[values > 0][level >= 0] == 255) and np.all(values[values > 0][level <= -50] == 1)


def test_bytes_are_decibels() -> None:
    of = Decibels(reference=10.0, span=40.0).of
    at = np.array([np.nan, 0.0, 0.01, 0.1, 1.0, 10.0, 1e9], dtype=np.float32)
    assert of(at).tolist() == [0, 1, 1, 1, 128, 255, 255]


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.parametrize("frame", [FRAME, None], ids=["utm", "local"])
def test_netcdf_and_zarr_keep_the_conventions(suffix: str, frame: Any, tmp_path: Path) -> None:
    path = store(tmp_path / "s.zarr", (header(frame=frame, columns=300, rotation=0.2), lambda x, y: 1 + x + y))
    mosaic(path, tmp_path / "m.tif")
    found = mosaic(path, tmp_path / f"m{suffix}")
    values, x, y = pixels(tmp_path / "m.tif")
    assert left(tmp_path) == sorted(["m.tif", f"m{suffix}", "s.zarr"])
    opened = xarray.open_dataset(
        tmp_path / f"m{suffix}", **({} if suffix == ".nc" else {"engine": "zarr", "consolidated": False})
    )
    with opened as data:
        assert data.attrs["Conventions"] == "CF-1.10" and data.attrs["combine"] == "nearest"
        magnitude = data["magnitude"]
        assert (
            magnitude.dims == ("y", "x") and magnitude.dtype == np.float32 and np.array_equal(magnitude, values, equal_nan=True)
        )
        assert np.isnan(magnitude.encoding["_FillValue"]) and magnitude.attrs["units"] == "1" and magnitude.attrs["long_name"]
        assert np.allclose(data["x"], x[0], atol=1e-6) and np.allclose(data["y"], y[:, 0], atol=1e-6)
        for name in "xy":
            attributes = data[name].attrs
            assert attributes["units"] == "m" and attributes["axis"] == name.upper() and "_FillValue" not in data[name].encoding
            assert attributes.get("standard_name") == (f"projection_{name}_coordinate" if frame else None)
        if frame:
            name = magnitude.attrs.get("grid_mapping") or magnitude.encoding["grid_mapping"]
            assert (
                pyproj.CRS.from_cf(data[name].attrs) == pyproj.CRS.from_epsg(32632) == pyproj.CRS(data[name].attrs["crs_wkt"])
            )
        else:
            assert "grid_mapping" not in {**magnitude.attrs, **magnitude.encoding} and found.crs is None


def test_zones_of_utm_and_other_maps(tmp_path: Path) -> None:
    for lat, lon, zone in ((54.0, 179.9, 60), (-33.0, 151.0, 56), (10.0, -179.9, 1), (0.5, 0.1, 31)):
        path = store(tmp_path / f"{zone}.zarr", (header(frame=FRAME | {"lat": lat, "lon": lon}), 1.0))
        assert mosaic(path, tmp_path / f"{zone}.tif").crs == f"EPSG:{(32600 if lat > 0 else 32700) + zone}"
    path = store(tmp_path / "s.zarr", (header(frame=FRAME), 1.0))
    area = {}
    for crs in ("EPSG:25832", "EPSG:3857", pyproj.CRS("EPSG:3034")):
        found = mosaic(path, tmp_path / "m.tif", crs=crs, overwrite=True)
        area[found.crs] = found.coverage * found.shape[0] * found.shape[1] * found.pixel**2
    with pytest.warns(UserWarning, match="EPSG:32701.*is meant for .*latitude 54"):
        mosaic(path, tmp_path / "south.tif", crs="EPSG:32701")
    stretch = 1 / np.cos(np.radians(54.3)) ** 2  # of Mercator's areas, of a sphere
    assert area["EPSG:25832"] == pytest.approx(320, rel=0.01) and area["EPSG:3857"] == pytest.approx(320 * stretch, rel=0.02)


# What is missing, damaged or refused


def test_tiles_that_are_missing_are_counted(tmp_path: Path) -> None:
    path = store(tmp_path / "s.zarr", (header(), 1.0))
    (strip,) = image_store.SurveyStore(path).strips
    strip.put(0, {"state": "failed", "reason": "NaN"})
    strip.put(1, {"state": "dark"})
    (path / "a" / "records" / "3" / "zarr.json").unlink()
    with pytest.warns(UserWarning, match=r"s\.zarr: 2 of 4 tiles are missing or failed"):
        found = mosaic(path, tmp_path / "m.tif")
    assert (found.missing, found.tiles) == (2, 4)
    values, x, _ = pixels(tmp_path / "m.tif")
    assert (
        found.coverage == pytest.approx(0.25, abs=0.01)
        and np.nanmin(x[~np.isnan(values)]) > 9.9
        and np.nanmax(x[~np.isnan(values)]) < 15
    )
    strip.put(2, {"state": "failed"})
    with pytest.raises(ValueError, match="no tile of 4 is done"):
        mosaic(path, tmp_path / "n.tif")


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("suffix", [".tif", ".nc", ".zarr"])
def test_a_tile_that_is_damaged_is_named_and_nothing_is_left(suffix: str, tmp_path: Path) -> None:
    path = store(tmp_path / "s.zarr", (header(), 1.0))
    output = tmp_path / f"m{suffix}"
    mosaic(path, output)
    before = left(tmp_path), output.read_bytes() if output.is_file() else left(output / "magnitude")
    flip(path / "a" / "magnitude" / "c.0.2")
    with pytest.raises(ValueError, match=r"s\.zarr: a, tile 2: .*damaged"):
        mosaic(path, output, overwrite=True)
    with pytest.raises(ValueError, match="a, tile 2"):
        mosaic(path, tmp_path / f"new{suffix}")
    assert (left(tmp_path), output.read_bytes() if output.is_file() else left(output / "magnitude")) == before


def test_damage_that_shows_at_once(tmp_path: Path) -> None:
    path = store(tmp_path / "s.zarr", (header(), 1.0))
    (strip,) = image_store.SurveyStore(path).strips
    record = strip.record(1)
    strip.put(1, {"state": "damaged"})
    with pytest.raises(ValueError, match="a, tile 1: damaged"):
        mosaic(path, tmp_path / "m.tif")
    strip.put(1, record)
    strip.write(2, np.full((160, 50), np.nan, np.complex64), {})
    with pytest.raises(ValueError, match="a, tile 2: magnitudes that are not finite"):
        mosaic(path, tmp_path / "m.tif")
    shard = path / "a" / "magnitude" / "c.0.3"
    shard.write_bytes(shard.read_bytes()[:-9])
    with pytest.raises(ValueError, match="a, tile 3: damaged"):
        mosaic(path, tmp_path / "m.tif")


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no such CRS": ({"crs": "EPSG:99999"}, "crs='EPSG:99999': no such CRS"),
    "no CRS at all": ({"crs": "somewhere"}, "crs='somewhere': no such CRS"),
    "degrees": ({"crs": "EPSG:4326"}, "expected a projected CRS in metres"),
    "feet": ({"crs": "EPSG:2225"}, "expected a projected CRS in metres"),
    "westwards": ({"crs": "EPSG:2048"}, "counts westwards"),
    "the other side of the Earth": (
        {"crs": "+proj=ortho +lat_0=-54 +lon_0=-170 +type=crs"},
        "does not hold where the survey is",
    ),
    "pixel": ({"pixel": 0.0}, "pixel=0.0: expected a finite number > 0"),
    "tiny pixel": ({"pixel": 1e-9}, "pixel=1e-09: .* expected at most"),
    "combine": ({"combine": "sum"}, "combine='sum': expected one of nearest, strongest, mean"),
    "feather": ({"feather": -1.0}, "feather=-1.0: expected"),
    "db": ({"db": 0}, "db=0: expected"),
    "db of floats": ({"db": 50, "output": "m.nc"}, "db=50.0: expected None"),
    "suffix": ({"output": "m.png"}, "found suffix '.png', expected .tif, .nc or .zarr"),
    "inside": ({"output": "s.zarr/m.tif"}, "lies in the store"),
    "the store": ({"output": "s.zarr", "overwrite": True}, "lies in the store"),
    "another store": ({"output": "other.zarr", "overwrite": True}, "is no store of mosaics but 'pysas-survey-1'"),
    "no folder": ({"output": "nowhere/m.tif"}, "no such folder"),
    "no mosaic": ({"output": "full.zarr", "overwrite": True}, "exists and is no store"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_one_message(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("s.zarr", "other.zarr"):
        store(Path(name), (header(frame=FRAME, tiles=1), 1.0))
    Path("full.zarr").mkdir()
    before = left(tmp_path), left(tmp_path / "s.zarr")
    options, text = BAD[case]
    with pytest.raises((ValueError, FileNotFoundError), match=text):
        mosaic("s.zarr", **({"output": "m.tif"} | options))
    assert (left(tmp_path), left(tmp_path / "s.zarr")) == before


def test_a_place_where_the_projection_ends(tmp_path: Path) -> None:
    path = store(tmp_path / "s.zarr", (header(frame=FRAME | {"lat": 86.0}), 1.0))
    with pytest.raises(ValueError, match=r"crs=None: the survey lies at latitude 86\.0.., beyond UTM"):
        mosaic(path, tmp_path / "m.tif")
    assert mosaic(path, tmp_path / "m.tif", crs="EPSG:32661").coverage > 0.3


def test_attributes_of_strips_are_checked(tmp_path: Path) -> None:
    for number, (changes, text) in enumerate(
        [({"track": "0"}, "a: track="), ({"origin": [1.0]}, "a: origin: expected"), ({"rotation": None}, "a: rotation=None"),
         ({"frame": {"latitude": 3}}, "a: frame: found"), ({"frame": FRAME | {"lat": 99}}, "a: lat=99")]
    ):  # fmt: skip
        path = store(tmp_path / f"{number}.zarr", (header(**changes), 1.0))
        with pytest.raises(ValueError, match=rf"{number}\.zarr: {text}"):
            mosaic(path, tmp_path / "m.tif")
    made = header()
    made.y[3] += 0.05
    with pytest.raises(ValueError, match="a: y: unequal steps at entry 3"):
        mosaic(store(tmp_path / "y.zarr", (made, 1.0)), tmp_path / "m.tif")


@pytest.mark.parametrize("suffix", [".tif", ".nc", ".zarr"])
def test_nothing_is_overwritten_unasked(suffix: str, tmp_path: Path) -> None:
    path, output = store(tmp_path / "s.zarr", (header(), 1.0)), tmp_path / f"m{suffix}"
    first = mosaic(path, output)
    with pytest.raises(FileExistsError, match=f"m{suffix}: exists"):
        mosaic(path, output)
    assert mosaic(path, output, overwrite=True) == first and left(tmp_path) == sorted([f"m{suffix}", "s.zarr"])


@pytest.mark.parametrize(
    ("library", "suffix"),
    [
        ("rasterio", ".tif"),
        ("pyproj", ".tif"),
        ("xarray", ".nc"),
        ("dask.array", ".nc"),
        ("netCDF4", ".nc"),
        ("xarray", ".zarr"),
    ],
)
def test_a_library_that_is_missing_is_named(library: str, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = store(tmp_path / "s.zarr", (header(frame=FRAME), 1.0))
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        ImportError, match=rf"{library.partition('.')[0]}.* is not installed: pip install 'pysas-sonar\[survey\]'"
    ):
        mosaic(path, tmp_path / f"m{suffix}")


FULL = """
    import resource, signal, sys
    from pysas.survey.mosaics import mosaic
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    try: mosaic(*sys.argv[1:])
    except OSError as error: print("OSError", error)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of POSIX")
@pytest.mark.parametrize("suffix", [".tif", ".nc", ".zarr"])
def test_a_disk_that_is_full_is_an_error_and_leaves_nothing(suffix: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    path = store(tmp_path / "s.zarr", (header(), lambda x, y: rng.random((y.size, x.size))))
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(FULL), str(path), str(tmp_path / f"m{suffix}")],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert run.stdout.startswith("OSError") and left(tmp_path) == ["s.zarr"], run.stdout + run.stderr


# The command


def test_the_command_writes_a_map_and_tells_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, output = store(tmp_path / "s.zarr", (header(frame=FRAME), 1.0)), tmp_path / "m.tif"
    image_store.SurveyStore(path).strips[0].put(3, {"state": "failed"})
    assert main(["mosaic", str(path), "-o", str(output), "--pixel", "0.2", "--db", "40", "--feather", "1"]) == 0
    out, err = capsys.readouterr()
    assert re.search(
        r"m\.tif: \d+ x \d+ pixels of 0\.2 m, EPSG:32632\n  coverage   \d+\.\d % of the pixels; 1 of 4 tiles missing", out
    )
    assert "255        magnitude 1.0" in out and "warning" in err and "1 of 4 tiles" in err and "mosaic ..." in err
    assert main(["mosaic", str(path), "-o", str(output)]) == 2 and "exists" in capsys.readouterr().err
    assert (
        main(["mosaic", str(path), "-o", str(output), "--overwrite", "--json", "--combine", "mean", "--crs", "EPSG:25832"]) == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert set(found) == set(Mosaic.__dataclass_fields__) and found["crs"] == "EPSG:25832" and found["missing"] == 1
    assert main(["mosaic", str(path), "-o", str(tmp_path / "x.tif"), "--crs", "EPSG:99999"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1 and "EPSG:99999" in lines[0] and os.listdir(tmp_path).count("x.tif") == 0
