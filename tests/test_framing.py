"""The default grid against the geometry it is meant for: delays here are computed pixel by pixel, ping by ping."""

from __future__ import annotations

import numpy as np
import pytest

import pysas
from pysas.planning.framing import default_grid, span

C, FS, FC, BAND = 1500.0, 40e3, 100e3, 20e3


def survey(track: np.ndarray, n_sample: int = 1200, t0: float = 0.02, beam: pysas.Beam | None = None) -> pysas.Echoes:
    rx = track[:, None] + np.array([[0.1, 0, 0], [0.2, 0, 0]])
    data = np.zeros((len(track), 2, n_sample), dtype=np.complex64)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=track, rx=rx, c=C, t0=t0, bandwidth=BAND, beam=beam)


def line(length: float, pings: int = 41, height: float = 5.0) -> np.ndarray:
    return np.stack([np.linspace(0, length, pings), np.zeros(pings), np.full(pings, height)], axis=1)


def heard(echoes: pysas.Echoes, grid: pysas.Grid) -> np.ndarray:
    """Share of the pings whose record holds each corner and edge middle of the grid, on every channel."""
    x, y = (grid.axes[name][[0, grid.axes[name].size // 2, -1]] for name in "xy")
    points = np.array([[a, b, grid.height] for a in x for b in y])
    out = np.linalg.norm(points[:, None] - echoes.tx, axis=-1)
    back = np.linalg.norm(points[:, None, None] - echoes.receivers, axis=-1)
    sample = ((out[..., None] + back) / C - echoes.start_time[:, None]) * FS
    return np.mean(np.all((sample >= 0) & (sample <= echoes.n_sample - 1), axis=-1), axis=1)


def test_a_strip_is_framed_beside_its_track() -> None:
    echoes = survey(line(10.0))
    grid, how = default_grid(echoes)
    x, y = grid.axes["x"], grid.axes["y"]
    near, far = C * 0.02 / 2, C / 2 * (0.02 + 1199 / FS)  # slant ranges of the record
    assert x[0] <= 0.2 and x[-1] >= 9.9
    assert np.sqrt(near**2 - 25) < y[0] < np.sqrt(near**2 - 25) + 1.0
    assert np.sqrt(far**2 - 25) - 1.0 < y[-1] < np.sqrt(far**2 - 25)
    assert "+y" in how and heard(echoes, grid).min() > 0.2


def test_the_side_is_the_beam_s() -> None:
    for side in (1, -1):
        grid, how = default_grid(survey(line(10.0), beam=pysas.Beam([0.1, side, -0.2], 0.1, 0.3)))
        assert np.all(side * grid.axes["y"] > 0) and ("+y" if side > 0 else "-y") in how


def test_raw_records_end_before_the_pulse_does() -> None:
    echoes = survey(line(10.0))
    pulse = pysas.LFM(FC, BAND, 4e-3)
    raw = echoes.replace(pulse=pulse, compressed=False)
    shorter = echoes_far(echoes) - echoes_far(raw)
    assert C / 2 * pulse.duration * 0.45 < shorter < C / 2 * pulse.duration * 1.1


def echoes_far(echoes: pysas.Echoes) -> float:
    return float(default_grid(echoes)[0].axes["y"][-1])


def test_a_circle_is_framed_inside_and_heard_by_all() -> None:
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    track = np.stack([7 + 12 * np.cos(angle), -3 + 12 * np.sin(angle), np.full(90, 4.0)], axis=1)
    echoes = survey(track, t0=0.005)
    grid, _ = default_grid(echoes)
    x, y = grid.axes["x"], grid.axes["y"]
    assert x.size == y.size and np.allclose([x.mean(), y.mean()], [7, -3], atol=0.15)
    assert np.ptp(x) > 1 and heard(echoes, grid).min() == 1


def test_pixels_are_fine_enough_for_the_image_s_own_bandwidth() -> None:
    """Wavenumbers of the image: 2 f/c times the direction to the track, over the band and the track's angle."""
    echoes = survey(line(10.0))
    grid, _ = default_grid(echoes)
    middle = np.array([5.0, grid.axes["y"].mean(), 0.0])
    away = echoes.tx - middle
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    waves = 2 / C * np.multiply.outer([FC - BAND / 2, FC + BAND / 2], away[:, :2]).reshape(-1, 2)
    for name, width in zip("xy", np.ptp(waves, axis=0), strict=True):
        step = grid.axes[name][1] - grid.axes[name][0]
        assert 0.2 / width < step < 1 / width


def test_the_default_grid_is_bounded_and_says_so() -> None:
    grid, how = default_grid(survey(line(400.0), n_sample=4000))
    assert grid.size <= 4.01e6 and "shrunk" in how
    x = grid.axes["x"]
    assert abs((x[0] + x[-1]) / 2 - 200) < 1


def test_far_coordinates_keep_the_frame() -> None:
    shift = np.array([4.5e6, 5.2e6, 0.0])
    here, there = default_grid(survey(line(10.0)))[0], default_grid(survey(line(10.0) + shift))[0]
    assert abs(here.size - there.size) < 0.01 * here.size
    assert abs(there.axes["y"][0] - shift[1] - here.axes["y"][0]) < 0.1


def test_one_ping_still_has_a_frame() -> None:
    grid, _ = default_grid(survey(line(10.0)[:1]))
    assert np.ptp(grid.axes["x"]) > 0.5 and grid.size > 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"z": -500.0}, "z=-500"), ({"z": np.nan}, "z=nan"), ({"spacing": 0.0}, "spacing=0"),
        ({"spacing": -1.0}, "spacing=-1"), ({"spacing": np.inf}, "spacing=inf"),
    ],
)  # fmt: skip
def test_wrong_arguments(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        default_grid(survey(line(10.0)), **options)


def test_a_given_spacing_is_kept() -> None:
    grid, _ = default_grid(survey(line(10.0)), spacing=0.25)
    assert all(np.allclose(np.diff(axis), 0.25) for axis in grid.axes.values())


def test_a_span_holds_multiples_within_its_limits() -> None:
    assert np.allclose(span(-0.1, 0.31, 0.1), [-0.1, 0.0, 0.1, 0.2, 0.3])
    assert span(0.0, 1.0, 0.1).size == 11  # ends are within, whatever their rounding
    with pytest.raises(ValueError, match="no multiple of it within 5 to 8"):
        span(5.0, 8.0, 100.0)
    for step in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="spacing="):
            span(0.0, 1.0, step)
