"""Parts of echoes and images, and grids with axes of their own: against the whole, and against turned coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import PLANE, X, Y, straight

import pysas

BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]


def survey(**changes: Any) -> pysas.Echoes:
    """10 pings of 4 channels whose fields all differ from ping to ping."""
    rng = np.random.default_rng(3)
    data = rng.standard_normal((10, 4, 30)) + 1j * rng.standard_normal((10, 4, 30))
    fields: dict[str, Any] = {
        "tx": rng.standard_normal((10, 3)), "rx": rng.standard_normal((10, 4, 3)), "t0": rng.random(10),
        "velocity": rng.standard_normal((10, 4, 3)), "ping_time": np.arange(10.0), "attrs": {"title": "x"},
        "beam": pysas.Beam(rng.standard_normal((10, 3)) + [0, 5, 0], 0.1, 0.3, taper=0.5),
    }  # fmt: skip
    return pysas.Echoes(data, fs=4e4, fc=1e5, pulse=np.ones(10, complex), **(fields | changes))


@pytest.mark.parametrize("pings", [slice(2, 7), slice(None, None, -3), 4, -1, [1, 5, 5], np.arange(10) > 6])
def test_pings_take_all_that_is_theirs(pings: Any) -> None:
    echoes = survey()
    which = np.atleast_1d(np.arange(10)[pings])
    part = echoes[pings]
    assert part.n_ping == which.size and part.attrs == echoes.attrs and np.array_equal(part.pulse, echoes.pulse)
    for name in ("data", "tx", "rx", "t0", "velocity", "ping_time"):
        assert np.array_equal(getattr(part, name), getattr(echoes, name)[which])
    assert np.array_equal(part.beam.boresight, echoes.beam.boresight[which]) and part.beam.taper == 0.5
    assert np.shares_memory(part.data, echoes.data) == (not isinstance(pings, list | np.ndarray))


def test_what_is_of_all_pings_stays() -> None:
    echoes = survey(t0=0.1, velocity=None, beam=pysas.Beam([0, 1, 0], 0.1, 0.3), ping_time=None)
    part = echoes[3:5]
    assert part.t0 == 0.1 and part.velocity is None and part.beam is echoes.beam
    assert [one.n_ping for one in echoes] == [1] * 10


@pytest.mark.parametrize("which", [slice(1, 3), 2, [0, 3], np.array([True, False, False, True])])
def test_channels_take_theirs(which: Any) -> None:
    echoes = survey()
    numbers = np.atleast_1d(np.arange(4)[which])
    part = echoes.channels(which)
    for name in ("data", "rx", "velocity"):
        assert np.array_equal(getattr(part, name), getattr(echoes, name)[:, numbers])
    assert np.array_equal(part.tx, echoes.tx) and part.n_channel == numbers.size
    one = survey(velocity=np.ones((10, 3))).channels(which)
    assert one.velocity.shape == (10, 3)


def test_flat_data_have_one_channel() -> None:
    echoes = survey()
    flat = echoes.replace(data=echoes.data[:, 0], rx=echoes.rx[:, 0], velocity=None)
    assert flat.channels(0) is flat and flat[2:4].data.shape == (2, 30)
    with pytest.raises(IndexError, match="which=1"):
        flat.channels(1)


@pytest.mark.parametrize(
    ("index", "error", "text"),
    [
        (slice(5, 5), ValueError, "none of 10 is left"),
        ([], TypeError, "expected a slice"),
        (np.zeros(10, bool), ValueError, "none of 10"),
        (10, IndexError, "expected below 10"),
        ([0, -11], IndexError, "expected below 10"),
        (1.5, TypeError, "expected a slice"),
        ((1, 2, 3.0), TypeError, "expected a slice"),
        (np.ones(3, bool), TypeError, "10 booleans"),
        ("a", TypeError, "expected a slice"),
    ],
)
def test_other_indices_are_refused(index: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        survey()[index]


@pytest.mark.parametrize("backend", BACKENDS)
def test_parts_sum_to_the_whole(backend: str) -> None:
    """An image is a sum over pings and channels."""
    echoes = straight(16)
    whole = pysas.backproject(echoes, PLANE, 1e-6, backend=backend).data
    parts = [pysas.backproject(echoes[i : i + 8], PLANE, 1e-6, backend=backend).data for i in (0, 8)]
    assert np.linalg.norm(parts[0] + parts[1] - whole) < 3e-6 * np.linalg.norm(whole)


def image(grid: pysas.Grid) -> pysas.Image:
    data = np.arange(grid.size).reshape(grid.shape) * (1 + 2j)
    return pysas.Image(data, grid, pysas.Report("test"), 1e5, 1500.0)


def test_an_image_is_an_array_of_its_pixels() -> None:
    found = image(PLANE)
    assert np.asarray(found) is found.data and np.shares_memory(found[...], found.data)
    assert found[3, 4] == found.data[3, 4] and np.array_equal(np.abs(found), np.abs(found.data))
    assert np.asarray(found, np.complex64).dtype == np.complex64 and not np.shares_memory(np.array(found), found.data)
    with pytest.raises(ValueError, match="copy"):
        np.asarray(found, np.complex64, copy=False)


GRIDS = {
    "plane": (PLANE, {"x": (-0.3, 0.2), "y": (19.1, 19.5)}),
    "one axis": (PLANE, {"y": (-np.inf, np.inf)} | {"y": (19.1, 99.0)}),
    "descending": (pysas.Grid.plane(X[::-1], Y, mask=np.add.outer(Y, X) > 19.5), {"x": (-0.3, 0.2)}),
    "unsorted": (pysas.Grid.plane(np.array([0.0, 3, 5, 1, 2]), Y), {"x": (0.5, 3.5), "y": (19.1, 19.5)}),
    "surface": (pysas.Grid.surface(X, Y, np.multiply.outer(Y, X)), {"x": (-0.3, 0.2), "y": (19.1, 19.5)}),
    "turned": (pysas.Grid.surface(X, Y, np.multiply.outer(Y, X), origin=(5, 6), rotation=0.3), {"x": (-0.3, 0.2)}),
    "polar": (pysas.Grid.polar(Y, np.linspace(0, 1, 7), (1, 2, 3)), {"r": (19.1, 19.5), "angle": (0.3, 0.9)}),
    "volume": (pysas.Grid.volume(X[:5], Y[:4], [0.0, 1, 2]), {"z": (0.5, 1.5), "x": (-0.78, 0)}),
}


@pytest.mark.parametrize("kind", GRIDS)
def test_crops_keep_their_pixels_and_places(kind: str) -> None:
    grid, spans = GRIDS[kind]
    whole = image(grid)
    part = whole.crop(**spans)
    where = np.isin(whole.data.ravel(), part.data.ravel())
    assert part.grid.size == np.count_nonzero(where) < grid.size and part.report == whole.report
    assert np.array_equal(part.grid.coordinates(), grid.coordinates()[where])
    if grid.mask is not None:
        assert np.array_equal(part.grid.mask.ravel(), grid.mask.ravel()[where])
    assert np.shares_memory(part.data, whole.data) == (kind != "unsorted")
    for name, (low, high) in spans.items():
        assert part.grid.axes[name].min() >= low and part.grid.axes[name].max() <= high


@pytest.mark.parametrize(
    ("grid", "spans", "text"),
    [
        (PLANE, {"z": (0, 1)}, "z=.*expected one of the axes of a plane: x, y"),
        (PLANE, {"x": (5, 6)}, "holds no pixel: expected a span of -0.8 to 0.8"),
        (PLANE, {"x": (0.2, -0.2)}, "holds no pixel"),
        (PLANE, {"x": (0, np.nan)}, "expected finite"),
        (PLANE, {"x": (0, 1, 2)}, "expected shape"),
        (pysas.Grid.points(np.zeros((3, 3))), {"x": (0, 1)}, "axes of a points: none"),
    ],
)
def test_crops_of_nothing_are_refused(grid: pysas.Grid, spans: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        image(grid).crop(**spans)


ANGLE, SHIFT = 0.7, np.array([431234.25, 5533211.75, 0.0])
TURN = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1]])


def turned(kind: str) -> tuple[pysas.Grid, pysas.Grid]:
    """A grid, and the same turned and moved."""
    frame = {"origin": SHIFT[:2], "rotation": ANGLE}
    mask = np.add.outer(Y, X) > 19.3
    if kind == "plane":
        return pysas.Grid.plane(X, Y, 0.5, mask=mask), pysas.Grid.plane(X, Y, 0.5, mask=mask, **frame)
    height = 0.1 * np.sin(5 * Y)[:, None] * np.cos(5 * X)
    return pysas.Grid.surface(X, Y, height), pysas.Grid.surface(X, Y, height, **frame)


@pytest.mark.parametrize("kind", ["plane", "surface"])
def test_turned_axes_are_a_rotation(kind: str) -> None:
    here, there = turned(kind)
    assert np.allclose(there.coordinates(), here.coordinates() @ TURN.T + SHIFT, rtol=0, atol=2e-9)
    assert np.allclose(there.along_axes(there.coordinates()), here.coordinates()[:, :2], rtol=0, atol=2e-9)
    assert there.turned and not here.turned and "turned by 40.11 deg" in repr(there)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", [pysas.backproject, pysas.ffbp])
@pytest.mark.parametrize("kind", ["plane", "surface"])
def test_images_on_turned_axes_keep_tol(kind: str, method: Any, backend: str) -> None:
    """Of a survey that is turned with them, in coordinates of 5e6 m; and they are what the oracle says there."""
    here, there = turned(kind)
    echoes = straight(16)
    moved = echoes.replace(tx=echoes.tx @ TURN.T + SHIFT, rx=echoes.rx @ TURN.T + SHIFT)
    exact, level = pysas.reference.exact(moved, there)
    found = method(moved, there, 1e-3, backend=backend)
    wanted = np.ones(there.shape, bool) if there.mask is None else there.mask
    assert (
        pysas.metrics.relative_error(found.data[wanted], exact.reshape(there.shape)[wanted], level.reshape(there.shape)[wanted])
        < 1e-3
    )
    plain = method(echoes, here, 1e-3, backend=backend)
    assert np.linalg.norm(found.data - plain.data) < 2e-3 * np.linalg.norm(plain.data)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("kind", ["plane", "surface"])
def test_turned_axes_are_in_files(kind: str, suffix: str, tmp_path: Path) -> None:
    grid = turned(kind)[1]
    pysas.save(tmp_path / f"a{suffix}", image(grid))
    found = pysas.load_image(tmp_path / f"a{suffix}")
    assert np.array_equal(found.grid.coordinates(), grid.coordinates()) and found.grid.rotation == ANGLE
    with pytest.raises(ValueError, match="expected echoes"):
        pysas.load_echoes(tmp_path / f"a{suffix}")
    pysas.save(tmp_path / f"b{suffix}", straight(3))
    assert pysas.load_echoes(tmp_path / f"b{suffix}").n_ping == 3
    with pytest.raises(ValueError, match="expected an image"):
        pysas.load_image(tmp_path / f"b{suffix}")


def test_turned_axes_are_labelled_and_refused_where_none_are_known() -> None:
    pytest.importorskip("xarray")
    grid = turned("plane")[1]
    assert image(grid).to_xarray().attrs["rotation"] == ANGLE
    with pytest.raises(ValueError, match="turned axes"):
        pysas.reference.fourier_image(straight(16), grid)
    for wrong in ({"rotation": 7.0}, {"rotation": np.nan}, {"origin": (1, 2, 3)}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            pysas.Grid.plane(X, Y, **wrong)
