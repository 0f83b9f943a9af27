"""Quick-look pictures: every kind of grid, the level and extent drawn, missing matplotlib, nothing half-written."""

import sys

import numpy as np
import pytest
import scipy.ndimage

import pysas

pytestmark = pytest.mark.reference  # no engine takes part

X, Y, Z = np.linspace(0, 4, 9), np.linspace(10, 12, 5), np.linspace(0, 1, 3)


def picture(grid):
    data = np.full(grid.shape, 1e-3 + 0j)
    data.flat[grid.size // 2] = 1.0
    return pysas.Image(data, grid, pysas.Report("test", tol=1e-3), 100e3, 1500.0)


@pytest.mark.parametrize(
    "grid",
    [
        pysas.Grid.plane(X, Y),
        pysas.Grid.surface(X, Y, np.zeros((5, 9))),
        pysas.Grid.polar(X + 1, Z),
        pysas.Grid.volume(X, Y, Z),
        pysas.Grid.points(np.random.default_rng(0).uniform(0, 1, (20, 3))),
        pysas.Grid.plane(np.array([0.0, 1.0, 3.0, 9.0]), Y),
        pysas.Grid.plane(X + 5e6, Y),
        pysas.Grid.plane(np.arange(4000) * 0.01, np.arange(10) * 0.01),
        pysas.Grid.plane([1.0], [2.0]),
    ],
    ids=["plane", "surface", "polar", "volume", "points", "uneven", "far", "large", "one pixel"],
)
def test_every_grid_is_drawn(grid, tmp_path):
    figure = pysas.plot.quicklook(picture(grid), tmp_path / "a.png", targets=[[1.0, 11.0]])
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert "test, tol 0.001" in figure.axes[0].get_title() and "dB" in figure.axes[1].get_ylabel()
    assert list(tmp_path.iterdir()) == [tmp_path / "a.png"]


def test_levels_and_extent():
    grid = pysas.Grid.plane(X, Y)
    data = np.full(grid.shape, 0.1 + 0j)  # 45 pixels: the 99.9th percentile lies between 0.1 and the point
    data[2, 4] = 1.0
    image = pysas.Image(data, grid, pysas.Report("test"), 100e3, 1500.0)
    drawn = pysas.plot.quicklook(image, dynamic_range=30).axes[0].images[0]
    assert np.allclose(drawn.get_array(), 20 * np.log10(np.abs(data)))
    assert drawn.get_clim() == (-30, 0) and drawn.get_extent() == [-0.25, 4.25, 9.75, 12.25]


@pytest.mark.parametrize(
    ("reference", "level", "text"),
    [
        ("peak", 20 * np.log10(4.0), "relative to the peak, 12.04 dB"),
        ("percentile", None, "relative to the 99.9th percentile"),
        (-6, -6.0, "relative to -6 dB"),
    ],
)
def test_the_level_drawn_as_0_db(reference, level, text):
    """Two pictures by one level in dB can be compared."""
    data = np.full((5, 9), 0.4 + 0j)
    data[2, 4], data[0, 0] = 4.0, 0.0
    image = pysas.Image(data, pysas.Grid.plane(X, Y), pysas.Report("test"), 100e3, 1500.0)
    figure = pysas.plot.quicklook(image, reference=reference, dynamic_range=30)
    if level is None:
        level = 20 * np.log10(np.percentile(np.abs(data[data != 0]), 99.9))
    assert np.isclose(figure.axes[0].images[0].get_array()[2, 4], 20 * np.log10(4.0) - level)
    assert text in figure.axes[1].get_ylabel()
    assert pysas.plot.quicklook(image.__class__(0 * data, image.grid, image.report, 1e5, 1500.0), reference=reference)


@pytest.mark.parametrize(("reference", "error"), [("mean", ValueError), (np.nan, ValueError), (None, TypeError)])
def test_other_references_are_refused(reference, error):
    with pytest.raises(error, match="reference="):
        pysas.plot.quicklook(picture(pysas.Grid.plane(X, Y)), reference=reference)


def test_turned_axes_are_drawn_as_such():
    grid = pysas.Grid.plane(X, Y, origin=(431200, 5533000), rotation=0.7)
    mark = grid.coordinates(np.array([22]))  # the bright pixel's
    figure = pysas.plot.quicklook(picture(grid), targets=mark)
    ax = figure.axes[0]
    assert ax.images[0].get_extent() == [-0.25, 4.25, 9.75, 12.25] and "(431200, 5533000), turned 40.1 deg" in ax.get_xlabel()
    assert np.allclose(ax.lines[0].get_xydata(), [[2, 11]], atol=1e-8)


def test_reduction_keeps_single_bright_pixels():
    grid = pysas.Grid.plane(np.arange(5000) * 0.01, np.arange(3) * 0.01)
    drawn = pysas.plot.quicklook(picture(grid)).axes[0].images[0].get_array()
    assert drawn.shape[1] <= 1600 and drawn.max() > -1e-6


@pytest.mark.parametrize("n", [1000, 1500, 3100])
def test_single_bright_pixels_reach_the_picture(n):
    """As many spots in the drawn axes as there are points, whatever the image's size."""
    grid = pysas.Grid.plane(np.arange(n) * 0.01, np.arange(n) * 0.01)
    data = np.full(grid.shape, 1e-3, dtype=np.complex64)
    places = np.linspace(0.1 * n, 0.9 * n, 9).astype(int) + np.array([0, 1, 3, 2, 5, 4, 0, 3, 1])
    data[np.ix_(places, places)] = 1
    figure = pysas.plot.quicklook(pysas.Image(data, grid, pysas.Report("test"), 100e3, 1500.0))
    figure.canvas.draw()
    box = figure.axes[0].get_window_extent()
    dots = np.asarray(figure.canvas.buffer_rgba())[::-1, :, :3].astype(int).sum(axis=-1)
    inside = dots[int(box.y0) + 5 : int(box.y1) - 5, int(box.x0) + 5 : int(box.x1) - 5]
    spots, _ = scipy.ndimage.label(inside > 300)
    assert spots.max() == 81


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(ImportError, match=r"pysas-sonar\[plot\]"):
        pysas.plot.quicklook(picture(pysas.Grid.plane(X, Y)))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    with pytest.raises(TypeError, match="image=int"):
        pysas.plot.quicklook(3, path)
    with pytest.raises(ValueError, match="dynamic_range"):
        pysas.plot.quicklook(picture(pysas.Grid.plane(X, Y)), path, dynamic_range=0)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
