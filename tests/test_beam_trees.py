"""Trees of the C++ engine in beams: tapers through the leaves, hard edges beside them, arrays, yaw, relief."""

import answers
import numpy as np
import pytest

import pysas
from pysas.engine import cpp, native

needs_extension = pytest.mark.skipif(native.extension() is None, reason="needs the compiled extension pysas.engine._core")
pytestmark = needs_extension
FS, FC, BAND, C = 36e3, 100e3, 30e3, 1500.0
TOLS = (1e-1, 1e-2, 1e-3, 1e-4)


@pytest.fixture(autouse=True)
def trees_always(monkeypatch):
    """Scenes here are small: whether trees pay is another question."""
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", False)


def array(rng, pings, channels, half_angle, taper, shape="fan", height=3.0, yaw=0.0, moving=False, samples=1000):
    """Noise of the band, heard by an array of receivers 5 cm apart that advances by half its length a ping."""
    x = 0.025 * channels * np.arange(pings)
    tx = np.stack([x, 0.03 * np.sin(x), height + 0.02 * np.cos(3 * x)], axis=1)
    along = 0.05 * (np.arange(channels) - (channels - 1) / 2)
    angle = yaw * rng.standard_normal(pings)
    axis = np.stack([np.cos(angle), np.sin(angle), np.zeros(pings)], axis=1)
    look = np.stack([-np.sin(angle), np.cos(angle), np.zeros(pings)], axis=1)
    rx = tx[:, None] + along[:, None] * axis[:, None]
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    beam = pysas.Beam(look, 0.1, half_angle, shape, taper, axis if shape == "fan" else None)
    velocity = np.tile([0.1 * channels, 0.05, 0.0], (pings, 1)) if moving else None
    return pysas.Echoes(
        np.fft.ifft(data).astype(np.complex64), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=0.02, bandwidth=BAND, beam=beam,
        velocity=velocity,
    )  # fmt: skip


def wrong(image, echoes, grid):
    """Error in units of tol's norm."""
    pixels = np.random.default_rng(0).choice(grid.size, min(grid.size, 400), replace=False)
    exact, level = answers.exact(echoes, grid, pixels)
    return np.linalg.norm(image.data.ravel()[pixels] - exact) / max(np.linalg.norm(exact), np.linalg.norm(level))


@pytest.mark.parametrize("taper", [0.1, 0.5, 1.0])
@pytest.mark.parametrize(("pings", "channels", "moving"), [(24, 6, True), (6, 24, False), (1, 64, True), (40, 1, False)])
def test_tapers_go_through_trees(pings, channels, moving, taper):
    rng = np.random.default_rng(pings)
    echoes = array(rng, pings, channels, 0.25, taper, yaw=0.02, moving=moving)
    middle = echoes.tx[:, 0].mean()
    grid = pysas.Grid.plane(middle + np.arange(-3, 3, 0.06), np.arange(22, 30, 0.06))
    shares = []
    for tol in TOLS:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol
        shares.append(image.report.factorised_share)
    assert shares[1] > 0.5 or channels * pings < 50


@pytest.mark.parametrize("seed", range(6))
def test_images_at_the_kinks_of_a_taper(seed):
    """All terms of a small image lie where the weight's second derivative jumps: bounds are means over bearings."""
    rng = np.random.default_rng(seed)
    half_angle, taper = rng.uniform(0.07, 0.4), rng.choice([0.2, 0.5, 1.0])
    echoes = array(rng, int(rng.integers(1, 4)), int(rng.integers(24, 80)), half_angle, taper)
    angle = half_angle * (1 - taper if seed % 2 else rng.uniform(0.6, 0.95))
    reach = rng.uniform(22, 32)
    x, y = echoes.tx[:, 0].mean() + reach * np.sin(angle), reach * np.cos(angle)
    grid = pysas.Grid.plane(x + np.arange(-0.4, 0.4, 0.02), y + np.arange(-1, 1, 0.02))
    shares = []
    for tol in TOLS:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol
        shares.append(image.report.factorised_share)
    assert max(shares) == 1


@pytest.mark.parametrize("shape", ["fan", "cone"])
def test_what_hard_edges_do_not_cross_goes_through_trees(shape):
    echoes = array(np.random.default_rng(3), 6, 24, 0.25, 0.0, shape, yaw=0.01)
    middle = echoes.tx[:, 0].mean()
    grid = pysas.Grid.plane(middle + np.arange(-9, 9, 0.06), np.arange(22, 30, 0.06))
    for tol in TOLS[:3]:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol
        assert 0.1 < image.report.factorised_share < 0.95


def test_cones_that_fade_go_through_trees():
    echoes = array(np.random.default_rng(4), 6, 24, 0.4, 0.5, "cone")
    grid = pysas.Grid.plane(echoes.tx[:, 0].mean() + np.arange(-5, 5, 0.06), np.arange(22, 30, 0.06))
    for tol in TOLS[:3]:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol and image.report.factorised_share > 0


@pytest.mark.parametrize(("shape", "yaw"), [("fan", 0.0), ("fan", 0.03), ("cone", 0.0)])
def test_relief_in_beams_that_fade(shape, yaw):
    """At one range and place along a group a fan across it weighs alike, a yawing one nearly so, a cone does not."""
    echoes = array(np.random.default_rng(5), 6, 24, 0.3, 0.5, shape, height=8.0, yaw=yaw)
    x, y = echoes.tx[:, 0].mean() + np.arange(-4, 4, 0.08), np.arange(22, 30, 0.08)
    grid = pysas.Grid.surface(x, y, 0.3 * np.sin(x)[None, :] * np.cos(y)[:, None])
    for tol in TOLS[:3]:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol
        if yaw == 0 and tol == 1e-2:
            assert (image.report.factorised_share > 0.5) == (shape == "fan")


def test_every_isa_and_number_of_threads(monkeypatch):
    echoes = array(np.random.default_rng(6), 6, 24, 0.25, 0.5, yaw=0.02, moving=True)
    grid = pysas.Grid.plane(echoes.tx[:, 0].mean() + np.arange(-3, 3, 0.08), np.arange(22, 30, 0.08))
    for isa in native.core().levels():
        monkeypatch.setenv("PYSAS_ISA", isa)
        for method in (pysas.ffbp, pysas.backproject):
            one, two = (method(echoes, grid, 1e-3, threads=threads, backend="cpp") for threads in (1, 2))
            assert np.array_equal(one.data, two.data) and one.report.isa == isa
            assert wrong(one, echoes, grid) <= 1e-3


@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize("look", [(0.0, 1.0, 0.0), (0.0, 1.0, -1.0)])
def test_fans_light_one_side_of_the_track_alone(look, along):
    """Lines on both sides of the ground below the track, along it and across it: weights know of no side."""
    echoes = array(np.random.default_rng(7), 8, 1, 0.6, 0.5, samples=700)
    echoes = echoes.replace(t0=0.003, beam=pysas.Beam(look, 0.1, 0.6, "fan", 0.5, (1.0, 0.0, 0.0)))
    far, near = np.arange(-6, 6, 0.05) + 0.011, np.arange(-4.3, 3, 0.4)
    if along == "x":
        grid = pysas.Grid.plane(far, near)
    else:
        grid = pysas.Grid.points(np.stack(np.broadcast_arrays(near[:6, None], far[None], 0.0), -1))
    for backend in ("cpp", "numba"):
        for tol in TOLS[1:]:
            assert wrong(pysas.backproject(echoes, grid, tol, backend=backend), echoes, grid) <= tol


@pytest.mark.parametrize("off", [0.02, 0.2])
def test_trees_beside_the_end_of_a_fans_side(off):
    """Nodes beyond it are read too: weights go on smoothly there."""
    echoes = array(np.random.default_rng(8), 1, 64, 1.5, 0.5)
    look = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    echoes = echoes.replace(beam=pysas.Beam(look, 0.1, 1.5, "fan", 0.5, (1.0, 0.0, 0.0)))
    half = 0.02 * 23 / 2
    middle = np.array([-22.0, 22.0]) + echoes.tx[0, :2] + look[:2] * (half * np.sqrt(2) + off)
    offsets = np.linspace(-half, half, 24)
    grid = pysas.Grid.plane(middle[0] + offsets, middle[1] + offsets)
    for tol in TOLS:
        image = pysas.ffbp(echoes, grid, tol, backend="cpp")
        assert wrong(image, echoes, grid) <= tol and image.report.factorised_share == (tol > 2e-4)


@pytest.mark.parametrize(
    ("shape", "height", "taper"), [("cone", 5.6, 0.1), ("fan", 4.5, 0.04), ("fan", 3.0, 0.3), ("cone", 12.0, 0.5)]
)
def test_tapers_that_rays_cross(shape, height, taper):
    """Cones and upright axes tell elevations apart: along a ray their weights change with range."""
    rng = np.random.default_rng(9)
    channels, reach = 64, 50.0
    tx = np.array([[0.0, 0.0, height]])
    rx = tx[:, None] + 1e-3 * (np.arange(channels) - channels / 2)[:, None] * np.array([1.0, 0.0, 0.0])
    data = np.fft.fft(rng.standard_normal((1, channels, 2 * 2000)).view(complex))
    data[..., np.abs(np.fft.fftfreq(2000)) > BAND / 2 / FS] = 0
    elevation = np.arctan2(height, reach)
    half = elevation / (1 - taper)  # the image lies where the taper begins
    axis = (0.0, 0.0, 1.0) if shape == "fan" else None
    beam = pysas.Beam((0.0, 1.0, 0.0), 0.1, half, shape, taper, axis)
    echoes = pysas.Echoes(
        np.fft.ifft(data).astype(np.complex64), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=0.04, bandwidth=BAND, beam=beam
    )
    grid = pysas.Grid.plane(np.arange(-1, 1, 0.1), reach + np.arange(-2, 2, 0.02))
    for tol in TOLS:
        assert wrong(pysas.ffbp(echoes, grid, tol, backend="cpp"), echoes, grid) <= tol


@pytest.mark.parametrize("share", [1e-2, 3e-5, 1e-5])
def test_images_at_a_tapers_outer_edge(share):
    """What weights are wrong by is relative to what pixels have of them."""
    echoes = array(np.random.default_rng(10), 1, 8, 0.2, 0.5)
    angle = 0.2 * (1 - 0.5 * share)
    slant = np.arange(23.0, 29.0, 0.02)
    place = np.sqrt(slant**2 - 9.0)  # at height 3: sines off the plane across x are those of x over slant range
    x = slant * np.sin(angle)
    grid = pysas.Grid.points(np.stack([x + echoes.tx[0, 0], np.sqrt(place**2 - x**2), np.zeros(x.size)], axis=-1)[None])
    for tol in TOLS[:3]:
        assert wrong(pysas.backproject(echoes, grid, tol, backend="cpp"), echoes, grid) <= tol
