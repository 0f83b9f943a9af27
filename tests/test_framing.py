"""The default grid against the geometry it is meant for: delays here are computed pixel by pixel, ping by ping."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import pysas
from pysas.planning import framing
from pysas.planning.framing import assumed_height, span

pytestmark = pytest.mark.reference  # no engine takes part

C, FS, FC, BAND = 1500.0, 40e3, 100e3, 20e3


def survey(track: np.ndarray, n_sample: int = 1200, t0: float = 0.02, beam: pysas.Beam | None = None) -> pysas.Echoes:
    rx = track[:, None] + np.array([[0.1, 0, 0], [0.2, 0, 0]])
    data = np.zeros((len(track), 2, n_sample), dtype=np.complex64)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=track, rx=rx, c=C, t0=t0, bandwidth=BAND, beam=beam)


def line(length: float, pings: int = 41, height: float = 5.0) -> np.ndarray:
    return np.stack([np.linspace(0, length, pings), np.zeros(pings), np.full(pings, height)], axis=1)


def default_grid(echoes: pysas.Echoes, z: float = 0.0, **options: Any) -> tuple[pysas.Grid, str]:
    return framing.default_grid(echoes, z, **options)


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
    assert abs(x.size - y.size) <= 1 and np.allclose([x.mean(), y.mean()], [7, -3], atol=0.15)
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


def test_a_grid_of_the_whole_survey_is_refused_before_it_is_cropped() -> None:
    """400 m of track and a swath of 90 m at 2 mm are 9e9 pixels."""
    echoes = survey(line(400.0), n_sample=4000)
    with pytest.raises(ValueError, match=r"has \d+ x \d+ = \d\.\d+e\+09 pixels.*--large"):
        default_grid(echoes, spacing=(0.002, 0.002))
    grid, _ = default_grid(echoes, spacing=(0.5, 0.25))
    x, y = grid.axes["x"], grid.axes["y"]
    assert x[0] == 0.5 and x[-1] == 400 and y[-1] > 80  # phase centres begin at 0.075 m
    many = default_grid(survey(line(400.0)), spacing=(0.01, 0.01), large=True)[0]
    assert many.size > framing.MOST


@pytest.mark.parametrize("angle", [30.0, 90.0, 217.0, -45.0])
def test_a_track_in_any_direction_has_axes_along_it(angle: float) -> None:
    """The same survey turned: the same rectangle, on its own axes; every pixel as far from the track as it was."""
    a = np.radians(angle)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    echoes = survey(line(10.0))
    shift = np.array([431234.0, 5533210.0, 0.0])
    turned = echoes.replace(tx=echoes.tx @ turn.T + shift, rx=echoes.rx @ turn.T + shift)
    (here, _), (there, how) = default_grid(echoes, spacing=(0.5, 0.5)), default_grid(turned, spacing=(0.5, 0.5))
    assert np.allclose(np.degrees(there.rotation), (angle + 180) % 360 - 180) and "from x towards y" in how
    near = []
    for grid, survey_ in ((here, echoes), (there, turned)):
        away = np.linalg.norm(grid.coordinates()[:, None] - survey_.tx[::10], axis=-1)
        near.append((away.min(), away.max()))
    assert 15 < near[0][0] < 16 and np.allclose(near[1], near[0], atol=0.5)  # the record begins at 15 m
    assert abs(here.size - there.size) < 0.1 * here.size


def test_lines_sailed_to_and_fro_are_one_survey_on_both_sides() -> None:
    """Two parallel lines 30 m apart, with beams to port of each: outward, and inward."""
    out, back = line(40.0), line(40.0)[::-1] + [0, 30, 0]
    look = np.repeat([[0.0, 1, -0.2], [0, -1, -0.2]], 41, axis=0)
    grid, how = default_grid(survey(np.concatenate([out, back]), beam=pysas.Beam(look, 0.1, 0.3)), spacing=(0.5, 0.5))
    y = grid.axes["y"]
    assert "both sides" in how and y[0] < -30 and y[-1] > 60


def test_a_side_that_is_asked_for() -> None:
    """Port lies left of the way sailed, seen from above: z up, or down as in NED."""
    for down, height in ((-1, 0.0), (1, 12.0)):
        echoes = survey(line(10.0))
        for side in ("port", "starboard"):
            y = default_grid(echoes, height, side=side)[0].axes["y"]
            assert np.all(y * down * (1 if side == "starboard" else -1) > 0)
        y = default_grid(echoes, height, side="both")[0].axes["y"]
        assert abs(y[0] + y[-1]) < 1
    with pytest.raises(ValueError, match="side='left'"):
        default_grid(survey(line(10.0)), side="left")


def test_a_loop_that_looks_outwards_is_no_circle() -> None:
    angle = np.linspace(0, 2 * np.pi, 90)
    track = np.stack([12 * np.cos(angle), 12 * np.sin(angle), np.full(90, 4.0)], axis=1)
    look = np.stack([np.cos(angle), np.sin(angle), np.full(90, -0.2)], axis=1)
    axis = np.stack([-np.sin(angle), np.cos(angle), np.zeros(90)], axis=1)
    outward, inward = (pysas.Beam(sign * look, 0.1, 0.3, axis=axis) for sign in (1, -1))
    assert "closed" in default_grid(survey(track, t0=0.005, beam=inward))[1]
    grid, how = default_grid(survey(track, t0=0.005, beam=outward), spacing=(0.1, 0.1))
    assert "both sides" in how and 23.5 < np.ptp(grid.axes["x"]) < 24


def test_the_seabed_is_where_the_altitude_says_or_at_the_sonar() -> None:
    echoes = survey(line(10.0))
    z, why = assumed_height(echoes)
    assert z == 5 and "assumed" in why and "--altitude" in why
    z, why = assumed_height(echoes, 3.0)
    assert z == 2 and "taken to point up" in why
    z, why = assumed_height(echoes.replace(attrs={"altitude": 4.0}))
    assert z == 1 and "attrs" in why
    for down in (1, -1):  # beams tell which way is down
        z, why = assumed_height(echoes.replace(beam=pysas.Beam([0, 1, 0.2 * down], 0.1, 0.3)), 3.0)
        assert z == 5 + 3 * down and "taken" not in why
    with pytest.raises(ValueError, match="altitude=-1"):
        assumed_height(echoes, -1.0)


def test_a_track_that_sways_needs_the_height() -> None:
    """An eighth of a wavelength of 15 mm is 1.9 mm; a sine has an rms of its amplitude by sqrt(2)."""
    for sway, matters in ((0.0, False), (2e-3, False), (3e-3, True), (0.05, True)):
        track = line(10.0) + np.cos(np.linspace(0, 4 * np.pi, 41))[:, None] * [0, sway, 0]
        echoes = survey(track)
        assert framing.course_of(echoes).bent == pytest.approx(sway / np.sqrt(2), rel=0.03, abs=1e-9)
        assert framing.height_matters(echoes) == matters
        assert ("not sharp" in assumed_height(echoes)[1]) == matters
    assert re.search(r"by 3\.[56] cm rms, 2\.4 wavelengths", assumed_height(echoes)[1])


def test_echoes_laid_along_x_are_the_same_survey() -> None:
    a = np.radians(70.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    beam = pysas.Beam([0.1, 1, -0.3], 0.1, 0.3, axis=[1, 0, 0])
    echoes = survey(line(10.0), beam=beam).replace(velocity=np.full((41, 3), [1.0, 0.2, 0]))
    shift = np.array([50.0, -20.0, 0.0])
    turned = echoes.replace(
        tx=echoes.tx @ turn.T + shift, rx=echoes.rx @ turn.T + shift, velocity=echoes.velocity @ turn.T,
        beam=pysas.Beam(turn @ beam.boresight, 0.1, 0.3, axis=turn @ [1, 0, 0]),
    )  # fmt: skip
    back, track = framing.laid_along_x(turned)
    assert np.degrees(track.rotation) == pytest.approx(70)
    for name in ("tx", "rx"):  # about the first place, to whole metres
        assert np.allclose(getattr(back, name) - back.tx[0], getattr(echoes, name) - echoes.tx[0], atol=1e-12)
    assert np.allclose(back.velocity, echoes.velocity) and np.allclose(back.beam.boresight, beam.boresight)
    assert np.allclose(back.beam.axis, [1, 0, 0], atol=1e-15)
    assert framing.laid_along_x(echoes)[0] is echoes


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
        ({"z": -500.0}, "z=-500"), ({"z": np.nan}, "z=nan"), ({"spacing": (0.0, 1.0)}, "spacing=0"),
        ({"spacing": (1.0, -1.0)}, "spacing=-1"), ({"spacing": (np.inf, 1.0)}, "spacing=inf"),
    ],
)  # fmt: skip
def test_wrong_arguments(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        default_grid(survey(line(10.0)), **options)


def test_a_given_spacing_is_kept() -> None:
    grid, _ = default_grid(survey(line(10.0)), spacing=(0.25, 0.25))
    assert all(np.allclose(np.diff(axis), 0.25) for axis in grid.axes.values())


def test_a_span_holds_multiples_within_its_limits() -> None:
    assert np.allclose(span(-0.1, 0.31, 0.1), [-0.1, 0.0, 0.1, 0.2, 0.3])
    assert span(0.0, 1.0, 0.1).size == 11  # ends are within, whatever their rounding
    with pytest.raises(ValueError, match="no multiple of it within 5 to 8"):
        span(5.0, 8.0, 100.0)
    for step in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="spacing="):
            span(0.0, 1.0, step)


@pytest.mark.parametrize("heading", [0.0, 0.5, 90.0, 179.5, 180.0, -175.0])
def test_sides_follow_the_way_that_was_sailed(heading: float) -> None:
    """Port is left of the way sailed where the sonar is above the seabed and z points up, whatever the axes."""
    angle = np.radians(heading)
    ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
    echoes = survey(line(15.0)[:, :1] * ahead + [0, 0, 5.0])
    for side, sign in (("port", 1.0), ("starboard", -1.0)):
        grid, _ = default_grid(echoes, 0.0, side=side)
        middle = grid.coordinates().mean(axis=0) - echoes.tx.mean(axis=0)
        assert sign * (ahead[0] * middle[1] - ahead[1] * middle[0]) > 0


def test_frames_of_navigation_have_z_down() -> None:
    """Their z is depth and y starboard (docs/navigation.md), which no beam needs to tell."""
    echoes = survey(line(15.0) * [1, 1, 0] + [0, 0, 12.0]).replace(attrs={"frame": {"latitude": 59.0}})
    z, _ = assumed_height(echoes, 8.0)
    assert z == pytest.approx(20.0)
    for height in (assumed_height(echoes)[0], z):
        assert default_grid(echoes, height, side="starboard")[0].axes["y"].min() > 0
    level = pysas.Beam([0.0, 1.0, 0.0], 0.1, 0.1, "fan")  # a beam that looks neither up nor down tells no more than none
    assert assumed_height(echoes.replace(beam=level), 8.0)[0] == pytest.approx(20.0)


def test_speeds_of_pings_are_taken_by_their_mean() -> None:
    sway = line(15.0) + np.stack([np.zeros(41), 0.1 * np.sin(np.arange(41.0)), np.zeros(41)], axis=1)
    echoes = survey(sway)
    assert assumed_height(echoes.replace(c=np.full(41, echoes.c)))[1] == assumed_height(echoes)[1]


def test_the_scene_that_a_file_was_recorded_for() -> None:
    """On the coordinates' own axes, whichever way the track lies, at its height; as far as it says and no further."""
    turned = line(10.0)[:, [1, 0, 2]]
    scene = {"x": [20.0, 24.0], "y": [-3.0, 5.0], "z": 1.5}
    echoes = survey(turned).replace(attrs={"scene_area": scene, "altitude": 7.0})
    assert assumed_height(echoes)[0] == 1.5 and assumed_height(echoes, 2.0)[0] == 3.0
    grid, how = default_grid(echoes, 1.5)
    assert not grid.turned and how.startswith("the file's scene")
    for name in "xy":
        axis = grid.axes[name]
        step = axis[1] - axis[0]
        assert scene[name][0] <= axis[0] < scene[name][0] + step and scene[name][1] - step < axis[-1] <= scene[name][1] + step
    assert np.ptp(np.diff(grid.axes["x"])) < 1e-9 and grid.axes["x"][1] - grid.axes["x"][0] <= C / 2 / BAND


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("North Sea", "scene_area.*expected"),
        ({"x": [0, 1], "y": [0, 1]}, "scene_area.*expected"),
        ({"x": [0, 1], "y": [1, 1], "z": 0}, "scene_area.*found"),
        ({"x": [0, np.nan], "y": [0, 1], "z": 0}, "scene_area.*nan"),
        ({"x": [0, 1], "y": [0, 1], "z": None}, "scene_area.*z"),
    ],
)
def test_a_scene_that_is_none(scene: Any, message: str) -> None:
    echoes = survey(line(10.0)).replace(attrs={"scene_area": scene})
    with pytest.raises((ValueError, TypeError), match=message):
        default_grid(echoes)


def test_a_scene_has_no_side() -> None:
    echoes = survey(line(10.0)).replace(attrs={"scene_area": {"x": [0, 1], "y": [20, 21], "z": 0.0}})
    with pytest.raises(ValueError, match="side='port': the file says which scene"):
        default_grid(echoes, side="port")
