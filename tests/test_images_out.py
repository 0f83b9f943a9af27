"""Images for other people's programs: round trips bit for bit, places of pixels, CF's rules, and failing writes."""

from __future__ import annotations

import dataclasses
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_io import ECHOES, images, same, survey

import pysas
from pysas.cli import main
from pysas.formats import catalogue, matlab
from pysas.formats.format import COLUMNS
from pysas.model.grid import Grid
from pysas.model.image import Image, Report

pytestmark = pytest.mark.reference  # no engine takes part

rasterio = pytest.importorskip("rasterio")
xarray = pytest.importorskip("xarray")
DOC = Path(__file__).resolve().parents[1] / "docs" / "formats.md"


def picture(**changes: Any) -> Image:
    """A plane whose steps differ, along y downwards."""
    mask = np.ones((40, 70), dtype=bool)
    mask[:3, 60:] = False
    fields: dict[str, Any] = {"mask": mask} | changes
    grid = Grid.plane(12.5 + 0.05 * np.arange(70), -3 - 0.02 * np.arange(40), 20.0, **fields)
    rng = np.random.default_rng(3)
    data = (rng.standard_normal((*grid.shape, 2)).view(complex)[..., 0] * mask).astype(np.complex64)
    return Image(data, grid, Report("backprojection", 1e-3, notes=("ä",)), 1e5, 1490.5)


PLANES = {
    "straight": picture(),
    "turned": picture(origin=(431_250.25, 5_876_003.5), rotation=0.7),
    "turned back": picture(origin=(-3.0, 8.0), rotation=-2.9),
    "surface": Image(
        np.arange(12).reshape(4, 3) * (1 + 2j),
        Grid.surface([3.0, 2.0, 1.0], [0.0, 0.5, 1.0, 1.5], np.arange(12.0).reshape(4, 3)), Report("given"), 1e5, 1500.0,
    ),
}  # fmt: skip
KEPT = images() | {name: PLANES[name] for name in ("straight", "turned")}


def written(path: Path, item: Any, **options: Any) -> Path:
    catalogue.by_name(str(path), type(item)).write(str(path), item, options.get("overwrite", False))
    return path


# Round trips


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".mat"])
@pytest.mark.parametrize("case", KEPT)
def test_images_come_back_bit_for_bit(case: str, suffix: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"a{suffix}", KEPT[case])
    assert same(pysas.load(path), KEPT[case])
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("case", [case for case in ECHOES if case != "big-endian"])
def test_echoes_come_back_from_mat_bit_for_bit(case: str, tmp_path: Path) -> None:
    assert same(pysas.load(written(tmp_path / "a.mat", ECHOES[case]())), ECHOES[case]())


def test_mat_of_the_other_byte_order_and_of_one_ping(tmp_path: Path) -> None:
    """Bytes are turned to this machine's; one ping's own time and speed are numbers."""
    swapped = ECHOES["big-endian"]()
    assert same(pysas.load(written(tmp_path / "a.mat", swapped)), swapped.replace(data=swapped.data.astype(np.complex64)))
    one = survey(c=np.array([1490.0, 1491, 1492, 1493]))[:1]
    back = pysas.load_echoes(written(tmp_path / "b.mat", one))
    assert same(back.data, one.data) and same(back.rx, one.rx) and same(back.ping_time, one.ping_time)
    assert (np.ravel(back.t0), np.ravel(back.c)) == (one.t0, one.c)


def test_what_scipy_and_xarray_see(tmp_path: Path) -> None:
    import scipy.io

    image = PLANES["turned"]
    found = scipy.io.loadmat(written(tmp_path / "a.mat", image), squeeze_me=True)
    assert np.array_equal(found["data"], image.data) and found["data"].dtype == np.complex64
    assert np.array_equal(found["grid_x"], image.grid.axes["x"]) and found["grid_rotation"] == image.grid.rotation
    assert (found["fc"], found["c"], found["grid_kind"]) == (image.fc, image.c, "plane")
    for path in (written(tmp_path / "a.nc", image), written(tmp_path / "a.zarr", image)):
        more = {"engine": "zarr", "consolidated": False} if path.suffix == ".zarr" else {}
        with xarray.open_dataset(path, **more) as data:
            assert np.array_equal(data["real"] + 1j * data["imag"], image.data)
            assert np.array_equal(data["x"], image.grid.axes["x"]) and data["real"].dims == ("y", "x")
            assert data.attrs["rotation"] == image.grid.rotation and data.attrs["fc"] == image.fc
            assert json.loads(data.attrs["report"]) == image.report.as_dict() | {"choices": {}}


def test_netcdf4_finds_other_bytes_by_itself(tmp_path: Path) -> None:
    """Chunks carry Fletcher-32 for programs that know nothing of ours: deflated numbers of a bit changed within."""
    import h5py
    import netCDF4

    path = written(tmp_path / "a.nc", PLANES["straight"])
    raw = bytearray(path.read_bytes())
    packed = zlib.compress(b"")[:1]  # each deflated chunk begins so
    with netCDF4.Dataset(path) as file:
        assert file["real"].filters()["fletcher32"] and file["imag"].filters()["fletcher32"]
    with h5py.File(path) as file:
        chunk = file["real"].id.get_chunk_info(0)
    assert raw[chunk.byte_offset : chunk.byte_offset + 1] == packed
    raw[chunk.byte_offset + chunk.size // 2] ^= 8
    path.write_bytes(raw)
    with netCDF4.Dataset(path) as file, pytest.raises(RuntimeError):
        file["real"][:]
    with pytest.raises(ValueError, match=r"a\.nc: real: damaged"):
        pysas.load(path)


@pytest.mark.parametrize("case", KEPT)
def test_the_rules_of_cf_that_matter(case: str, tmp_path: Path) -> None:
    """CF 1.10: 2.3 names, 2.6.1 Conventions, 3.1 units in UDUNITS' words, 3.5 flags, 4 axes, 5.1 coordinates of a dimension."""
    with xarray.open_dataset(written(tmp_path / "a.nc", KEPT[case]), decode_coords=False) as data:
        assert data.attrs["Conventions"] == "CF-1.10" and data.attrs["title"] and data.attrs["history"]
        for name, variable in data.variables.items():
            assert name.isidentifier() and variable.attrs["long_name"] and "standard_name" not in variable.attrs
            if name == "mask":
                flags = variable.attrs["flag_values"]
                assert len(flags) == len(variable.attrs["flag_meanings"].split()) and flags.dtype == variable.dtype
            else:
                wanted = {"real": "1", "imag": "1", "angle": "radian"}.get(name, "1" if name.startswith("point") else "m")
                assert variable.attrs["units"] == wanted
            assert variable.dtype.kind in "fi" and "_FillValue" not in variable.encoding
            assert variable.attrs.get("axis") == (
                name.upper() if name in ("x", "y") and variable.ndim == 1 and "x" in data.dims else None
            )
            if variable.ndim == 1 and variable.dims == (name,):
                steps = np.diff(variable.values)
                assert (steps > 0).all() or (steps < 0).all()
            for named in variable.encoding.get("coordinates", variable.attrs.get("coordinates", "")).split():
                assert set(data[named].dims) <= set(variable.dims)


# Places


def places(image: Image, affine: Any) -> float:
    """The largest distance between pixels' centres by an affine map of (column, row) and the grid's own, m.

    Files begin in the corner where the grid's own x is least and y is most.
    """
    rows, columns = image.grid.shape
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    wanted = image.grid.coordinates().reshape(rows, columns, 3)[np.argsort(-y)][:, np.argsort(x)]
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    a, b, c, d, e, f = affine
    return float(
        max(np.abs(a * column + b * row + c - wanted[..., 0]).max(), np.abs(d * column + e * row + f - wanted[..., 1]).max())
    )


def centred(transform: Any) -> tuple[float, ...]:
    """The affine map of pixels' centres: GDAL counts from their corners."""
    a, b, c, d, e, f = transform[:6]
    return a, b, c + (a + b) / 2, d, e, f + (d + e) / 2


@pytest.mark.parametrize("case", PLANES)
def test_geotiff(case: str, tmp_path: Path) -> None:
    image = PLANES[case]
    turned = image.data[np.argsort(-image.grid.axes["y"])][:, np.argsort(image.grid.axes["x"])]
    with rasterio.open(written(tmp_path / "a.tif", image)) as file:
        assert places(image, centred(file.transform)) < 1e-9
        assert np.array_equal(file.read(1), turned) and file.dtypes[0] == image.data.dtype.name and file.crs is None
        tags = file.tags()
        assert (float(tags["fc"]), float(tags["c"]), tags["method"]) == (image.fc, image.c, image.report.method)
        assert Report.from_dict(json.loads(tags["report"])) == image.report
        if image.grid.mask is not None:
            mask = image.grid.mask[np.argsort(-image.grid.axes["y"])][:, np.argsort(image.grid.axes["x"])]
            assert np.array_equal(file.read_masks(1) > 0, mask)


def decibels(image: Image, span: float) -> np.ndarray:
    """Bytes as docs/formats.md says."""
    magnitude = np.abs(image.data.astype(complex))
    level = 20 * np.log10(
        magnitude / np.percentile(magnitude[magnitude > 0], 99.9), where=magnitude > 0, out=np.full(magnitude.shape, -np.inf)
    )
    found = 1 + np.rint(254 * np.clip(1 + level / span, 0, 1))
    if image.grid.mask is not None:
        found[~image.grid.mask] = 0
    return found[np.argsort(-image.grid.axes["y"])][:, np.argsort(image.grid.axes["x"])]


@pytest.mark.parametrize("case", PLANES)
def test_png_and_geotiff_in_decibels(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from matplotlib.image import imread

    image = PLANES[case]
    pysas.save(tmp_path / "a.npz", image)
    for name in ("a.png", "a.tif"):
        assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / name), "--db", "30"]) == 0
    assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.png")]) == 0
    lines = (tmp_path / "a.pgw").read_text().splitlines()
    a, d, b, e, c, f = map(float, lines)
    assert places(image, (a, b, c, d, e, f)) < 1e-9 and lines == (tmp_path / "b.pgw").read_text().splitlines()
    with rasterio.open(tmp_path / "a.tif") as file:
        assert places(image, centred(file.transform)) < 1e-9
        in_tif = file.read(1)
        assert file.nodata == 0 and file.dtypes == ("uint8",) and float(file.tags()["db"]) == 30
    for name, span in (("a.png", 30.0), ("b.png", 40.0)):
        grey = np.rint(255 * imread(tmp_path / name)).astype(int)
        shown = grey[..., 0] * (grey[..., -1] > 0) if grey.ndim == 3 else grey  # 0 is transparent
        assert np.abs(shown - decibels(image, span)).max() <= 1  # float32 where a step ends
        assert (shown == decibels(image, span)).mean() > 0.99
        if span == 30:
            assert np.array_equal(shown, in_tif)
    assert capsys.readouterr().out.splitlines()[0].endswith(f"a.png: png, {image.grid.shape[0]} x {image.grid.shape[1]}")


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_grids_that_are_no_map_are_told(suffix: str, tmp_path: Path) -> None:
    for case in ("polar", "volume", "points"):
        with pytest.raises(
            ValueError, match=rf"a{suffix}: found an image of grid {case}, expected a plane or a surface; .nc takes any"
        ):
            written(tmp_path / f"a{suffix}", images()[case])
    with pytest.raises(ValueError, match=rf"a{suffix}: x: unequal steps at entry 2: expected equal ones, not 0; .nc takes any"):
        written(tmp_path / f"a{suffix}", images()["plane"])
    assert list(tmp_path.iterdir()) == []


# The command


def test_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    image, echoes = PLANES["straight"], survey()
    pysas.save("i.npz", image)
    pysas.save("e.npz", echoes)
    for start, item, chain in (
        ("i.npz", image, ("i.nc", "i.zarr", "i.mat", "i.h5")),
        ("e.npz", echoes, ("e.mat", "e.zarr", "e.h5")),
    ):
        for target in chain:
            assert main(["convert", start, target]) == 0
            assert same(pysas.load(target), item)
            start = target
    capsys.readouterr()
    for arguments, said in (
        (["i.npz", "i.nc"], "i.nc: exists: expected a new name"),
        (["i.npz", "i.zarr"], "i.zarr: exists: expected a new name"),
        (["i.npz", "e.zarr", "--overwrite"], "e.zarr: exists and is no store of single images"),
        (["e.npz", "i.zarr", "--overwrite"], "i.zarr: exists and is no store of echoes"),
        (["i.mat", "i.mat", "--overwrite"], "B i.mat: is read by this command"),
        (["e.npz", "e.nc"], "e.nc: found suffix '.nc', expected one of .mat, .npz, .h5, .zarr"),
        (["i.npz", "x.nc", "--db", "30"], "--db 30: expected an image, and a .tif or .png to write"),
        (["e.npz", "x.h5", "--db", "30"], "--db 30: expected an image, and a .tif or .png to write"),
        (["i.npz", "x.tif", "--db", "0"], "db=0.0: expected a finite number > 0"),
    ):
        assert main(["convert", *arguments]) == 2
        assert said in capsys.readouterr().err
    for target in ("i.nc", "i.zarr", "i.mat"):
        assert main(["convert", "i.npz", target, "--overwrite"]) == 0
    Path("p.pgw").write_text("mine")
    assert main(["convert", "i.npz", "p.png"]) == 2
    assert "p.pgw: exists" in capsys.readouterr().err and not Path("p.png").exists() and Path("p.pgw").read_text() == "mine"
    assert main(["convert", "i.npz", "p.png", "--overwrite"]) == 0 and len(Path("p.pgw").read_text().splitlines()) == 6
    assert not [item.name for item in tmp_path.iterdir() if item.name.startswith(".")]


@pytest.mark.parametrize("name", ["a.nc", "a.mat", "a.tif", "a.png"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / name, PLANES["straight"])
    before = {item.name: item.read_bytes() for item in tmp_path.iterdir()}

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    for called in ("pysas.formats.files.os.fsync", "pysas.formats.files.os.replace"):
        with monkeypatch.context() as patch:
            patch.setattr(called, full)
            with pytest.raises(OSError, match="No space"):
                written(path, PLANES["turned"], overwrite=True)
        assert {item.name: item.read_bytes() for item in tmp_path.iterdir()} == before


def test_a_mat_says_what_takes_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matlab, "_MOST", 22_399)
    with pytest.raises(
        ValueError, match=r"a\.mat: data: found 22400 bytes, expected at most 22399 in a \.mat: \.h5 takes more"
    ):
        written(tmp_path / "a.mat", PLANES["straight"])
    assert list(tmp_path.iterdir()) == []


def test_the_page_and_the_command_list_the_formats(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [COLUMNS, ["---"] * len(COLUMNS), *(known.row for known in catalogue.FORMATS)]
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    assert table in DOC.read_text(encoding="utf-8"), f"docs/formats.md: expected this table:\n{table}"
    with pytest.raises(SystemExit) as end:
        main(["convert", "--formats"])
    said = capsys.readouterr().out
    assert end.value.code == 0 and all(text in said for known in catalogue.FORMATS for text in known.row)


def test_the_page_s_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    image = dataclasses.replace(PLANES["straight"], data=PLANES["straight"].data + 9)  # whose level is a number everywhere
    written(Path("line.nc"), image)
    section = DOC.read_text(encoding="utf-8").split("### xarray")[1].split("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)
    names["data"].close()
    assert np.array_equal(names["image"], image.data) and float(names["level"].max()) == 0
    assert capsys.readouterr().out == "100000.0 m\n"
