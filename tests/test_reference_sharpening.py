"""Cost and gradient of focus: differences of the cost, closed forms, the oracle's image, echoes that are moved in fact."""

import numpy as np
import pytest

import pysas
from pysas.reference import exact, focus_gradient
from pysas.reference.reading import delays, finer, read

pytestmark = pytest.mark.reference

C, FC, BAND, FS = 1500.0, 100e3, 20e3, 40e3


def scene(pings=8, channels=2, noise=0.0):
    """Echoes of three points from an uneven track, and the pixels about one of them."""
    rng = np.random.default_rng(3)
    tx = np.stack([0.2 * np.arange(pings), 0.01 * rng.standard_normal(pings), 0.01 * rng.standard_normal(pings)], axis=1)
    rx = tx[:, None] + np.stack([0.05 * np.arange(channels), np.zeros(channels), np.zeros(channels)], axis=1)
    points = np.array([[0.7, 19.0, 6.0], [0.9, 19.15, 6.0], [0.4, 19.6, 6.0]])
    pulse = pysas.LFM(FC, BAND, 2e-3, "tukey", 0.5)
    raw = pysas.simulate(
        points, [1.0, 0.6j, -0.4], pulse, tx=tx, rx=rx, velocity=np.tile([1.5, 0.05, 0.0], (pings, 1)), fs=FS,
        t0=2 * 18.0 / C, duration=2 * 4.0 / C + 2e-3, dtype=np.complex128,
    )  # fmt: skip
    echoes = pysas.compress(raw)
    white = rng.standard_normal((*echoes.data.shape, 2)).view(np.complex128)[..., 0]
    echoes = echoes.replace(data=echoes.data + noise * white)
    x, y = np.meshgrid(np.linspace(0.5, 1.1, 13), np.linspace(18.8, 19.3, 11))
    return echoes, np.stack([x.ravel(), y.ravel(), np.full(x.size, 6.0)], axis=1)


@pytest.mark.parametrize("metric", ["entropy", "sharpness"])
@pytest.mark.parametrize("moved", [0.0, 2e-3])
def test_gradient_is_that_of_the_cost(metric, moved):
    """Central differences over 2e-7 m: wrong by (k2 h)^2/6 = 5e-9 and by rounding of 1e-15/(k2 h)."""
    echoes, pixels = scene(pings=4, noise=0.05)
    at = moved * np.random.default_rng(0).standard_normal((4, 3))
    _, gradient = focus_gradient(echoes, pixels, metric, at)
    h, found = 2e-7, np.zeros((4, 3))
    for index in np.ndindex(4, 3):
        step = np.zeros((4, 3))
        step[index] = h
        ends = [focus_gradient(echoes, pixels, metric, at + sign * step)[0] for sign in (1, -1)]
        found[index] = (ends[0] - ends[1]) / (2 * h)
    assert np.linalg.norm(found - gradient) <= 1e-7 * np.linalg.norm(gradient)
    assert np.linalg.norm(gradient) > 1  # per m: there is something to compare


def test_cost_is_that_of_the_exact_image():
    echoes, pixels = scene(noise=0.05)
    power = np.abs(exact(echoes, pysas.Grid.points(pixels))[0]) ** 2
    q = power / power.sum()
    assert focus_gradient(echoes, pixels, "entropy")[0] == pytest.approx(-np.sum(q * np.log(q)), rel=1e-7)
    assert focus_gradient(echoes, pixels, "sharpness")[0] == pytest.approx(-np.log(np.sum(q**2)), rel=1e-7)


def test_true_track_is_a_minimum():
    """Of all displacements across the line of sight's common shift: the cost rises both ways, for every ping."""
    echoes, pixels = scene()
    for metric in ("entropy", "sharpness"):
        least, _ = focus_gradient(echoes, pixels, metric)
        for ping in range(1, echoes.n_ping - 1):
            for sign in (-1, 1):
                off = np.zeros((echoes.n_ping, 3))
                off[ping, 1] = sign * 1e-3
                assert focus_gradient(echoes, pixels, metric, off)[0] > least + 1e-4


def test_closed_forms():
    """One ping of constant samples: all of n pixels alike, ln n in both; and nothing to gain."""
    echoes, pixels = scene(pings=1, channels=1)
    flat = echoes.replace(data=np.ones(echoes.data.shape, dtype=np.complex128), t0=2 * 17.0 / C)
    for metric in ("entropy", "sharpness"):
        cost, gradient = focus_gradient(flat, pixels, metric)
        assert cost == pytest.approx(np.log(len(pixels)), abs=1e-6)
        assert np.linalg.norm(gradient) < 1e-3


def test_gradient_tells_which_way_echoes_have_to_move():
    """Echoes moved in fact, by differences over 20 um: what the gradient leaves out, the envelope's share, is small."""
    echoes, pixels = scene(pings=6)
    off = 1e-3 * np.random.default_rng(5).standard_normal(6)
    shift = np.stack([np.zeros(6), off, np.zeros(6)], axis=1)

    def moved(by):
        return echoes.replace(tx=echoes.tx + by, rx=echoes.rx + by[:, None])

    wrong = moved(shift)
    _, gradient = focus_gradient(wrong, pixels)
    found = np.zeros(6)
    for ping in range(6):
        step = np.zeros((6, 3))
        step[ping, 1] = 1e-5
        ends = [focus_gradient(moved(shift + sign * step), pixels)[0] for sign in (1, -1)]
        found[ping] = (ends[0] - ends[1]) / 2e-5
    assert np.linalg.norm(found - gradient[:, 1]) <= 0.03 * np.linalg.norm(found)


def test_delays_are_roots():
    rng = np.random.default_rng(0)
    points = rng.uniform(-40, 40, (200, 3))
    tx, rx, velocity = np.array([0.1, -0.2, 0.3]), np.array([1.0, 0.5, -0.2]), np.array([3.0, -1.0, 0.5])
    tau = delays(points, tx, rx, velocity, C)
    away = np.linalg.norm(points - tx, axis=1) + np.linalg.norm(points - rx - velocity * tau[:, None], axis=1)
    assert np.max(np.abs(C * tau - away)) < 1e-12  # m
    there = delays(tx[None] + [[0.0, 7.5, 0.0]], tx, tx, np.zeros(3), C)
    assert there == pytest.approx([0.01], rel=1e-15)


def test_reading_is_band_limited():
    """A Gaussian of 4 samples about a tenth of fs, whose spectrum ends below 1e-15 within the low-pass."""
    n = 300

    def signal(t):
        return np.exp(-((t - 150.3) ** 2) / 32 + 0.2j * np.pi * t)

    place = np.random.default_rng(0).uniform(20, 280, 1000)
    assert np.max(np.abs(read(finer(signal(np.arange(n))), place) - signal(place))) < 1e-9
    assert np.all(read(finer(np.ones(n, dtype=complex)), np.array([-200.0, 600.0])) == 0)


def test_bad_arguments_are_named():
    echoes, pixels = scene(pings=2)
    with pytest.raises(TypeError, match="echoes"):
        focus_gradient(None, pixels)
    with pytest.raises(ValueError, match="compressed"):
        focus_gradient(echoes.replace(compressed=False), pixels)
    with pytest.raises(ValueError, match="metric"):
        focus_gradient(echoes, pixels, "contrast")
    with pytest.raises(ValueError, match="displacement"):
        focus_gradient(echoes, pixels, displacement=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="pixels"):
        focus_gradient(echoes, pixels[:, :2])
    with pytest.raises(ValueError, match="pixels: the echoes are zero"):
        focus_gradient(echoes, pixels + [0, 100, 0])
