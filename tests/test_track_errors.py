"""Errors of tracks against closed forms: what is gauge, what the grazing angle does, circles, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import pysas
from pysas.metrics import track_error
from pysas.tracks import Track, array, circular, perturbed, straight

pytestmark = pytest.mark.reference  # no engine takes part

FloatArray = npt.NDArray[np.float64]

N = 200
LINE = straight(N, 0.1, start=(-4.0, 2.0, 1.0))
WAVE = np.sin(2 * np.pi * 5 * (np.arange(N) + 0.5) / N)  # 5 periods: a mean of 0, rms sqrt(1/2)
# what is left when a linear trend is taken out of them: 1 - r^2 with r the correlation of WAVE and the ping's number
LEFT = np.sqrt(1 - np.corrcoef(WAVE, np.arange(N))[0, 1] ** 2)


def moved(track: Track, shift: FloatArray) -> Track:
    return Track(track.position + shift, track.velocity, track.yaw, track.time)


def along(component: int, values: FloatArray) -> FloatArray:
    shift = np.zeros((N, 3))
    shift[:, component] = values
    return shift


def echoes(track: Track, beam: pysas.Beam | None = None) -> pysas.Echoes:
    rx = array(track, 4, 0.05, offset=(0.1, 0.0, 0.0))
    data = np.zeros((*rx.shape[:2], 8), dtype=np.complex64)
    return pysas.Echoes(data, fs=20e3, fc=100e3, tx=track.position, rx=rx, c=1500.0, bandwidth=15e3, beam=beam)


@pytest.mark.parametrize("seabed", [9.0, -7.0, 1.0])
def test_sway_and_heave_by_grazing_angle(seabed: float) -> None:
    """2 mm of sway counts as sqrt(1 - (h/r)^2), of heave as h/r with h from the track's own height of 1 m, surge not at all."""
    sine = (seabed - 1) / 20
    for component, share in ((0, 0.0), (1, np.sqrt(1 - sine**2)), (2, abs(sine))):
        found = moved(LINE, along(component, 2e-3 * WAVE))
        expected = 2e-3 * np.sqrt(0.5) * LEFT * share
        assert track_error(found, LINE, 20.0, seabed=seabed) == pytest.approx(expected, abs=1e-15)
        assert track_error(found.position, LINE.position, 20.0, seabed=seabed) == pytest.approx(expected, abs=1e-15)


def test_sway_and_heave_add_with_their_signs() -> None:
    """They cancel where the way to one side's seabed stays as long; to the other side they add."""
    sine = 8 / 25
    shift = along(1, sine * WAVE) - along(2, np.sqrt(1 - sine**2) * WAVE)
    assert track_error(LINE.position + shift, LINE.position, 25.0, seabed=9.0) == pytest.approx(0, abs=1e-15)
    other = track_error(LINE.position + shift, LINE.position, 25.0, seabed=9.0, boresight=(0, -1, 0))
    assert other == pytest.approx(2 * sine * np.sqrt(1 - sine**2) * np.sqrt(0.5) * LEFT, rel=1e-12)


def test_shift_and_heading_are_gauge() -> None:
    """Any shift of a line, and any slope of its sway and heave; on a line of any heading."""
    n = np.arange(N)
    for angle in (0.0, 0.7, -2.0):
        cosine, sine = np.cos(angle), np.sin(angle)
        rotation = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
        truth = LINE.position @ rotation
        found = (LINE.position + [3.0, -2.0, 0.4] + along(1, 0.02 * n) + along(2, 0.001 * n)) @ rotation
        assert track_error(found, truth, 30.0) < 1e-14
        found = found + (along(1, 1e-3 * WAVE) @ rotation)
        assert track_error(found, truth, 30.0) == pytest.approx(
            1e-3 * np.sqrt(0.5) * LEFT * np.sqrt(1 - (7 / 30) ** 2), rel=1e-9
        )


def test_random_error_of_a_perturbed_track() -> None:
    """White sway of 1 mm: shift and trend take 2 of N degrees of freedom, whatever the true motion."""
    rng = np.random.default_rng(5)
    squares = []
    for seed in range(50):
        track = perturbed(N, 0.1, sway=0.04, heave=0.02, yaw=0.012, correlation=3.0, seed=seed)
        found = moved(track, along(1, 1e-3 * rng.standard_normal(N)))
        squares.append(track_error(found, track, 30.0, seabed=0.0) ** 2)
    # chi-squared of 50 (N - 2) degrees of freedom scatters by 1.4 %; yaw of 12 mrad makes 1e-4 of it
    assert np.mean(squares) == pytest.approx(1e-6 * (1 - 2 / N), rel=0.05)


@pytest.mark.parametrize("extent", [2 * np.pi, -2 * np.pi])
def test_circle(extent: float) -> None:
    """A shift of the centre and a constant radial error are gauge; cos(m angle) of m >= 2 is not."""
    ring = circular(N, 20.0, (1.0, 2.0, 0.0), extent=extent)
    radial = (ring.position - [1.0, 2.0, 0.0]) / 20
    angle = np.arctan2(radial[:, 1], radial[:, 0])
    gauge = [0.3, -0.2, 0.1] + 0.01 * radial
    look = -radial  # inwards, where the track's left hand points on a circle from +x to +y
    for m in (2, 7):
        found = ring.position + gauge + 1e-3 * np.cos(m * angle)[:, None] * radial
        expected = 1e-3 * np.sqrt(0.5) * np.sqrt(1 - (5 / 20) ** 2)
        assert track_error(found, ring.position, 20.0, seabed=5.0, boresight=look) == pytest.approx(expected, rel=1e-12)
        if extent > 0:
            assert track_error(moved(ring, found - ring.position), ring, 20.0, seabed=5.0) == pytest.approx(expected, rel=1e-12)


def test_echoes_are_compared_at_their_phase_centres() -> None:
    """An array that a wrong yaw turns about a transmitter behind it moves its phase centres by yaw times their distance."""
    turned = Track(LINE.position, LINE.velocity, 0.01 * WAVE, LINE.time)
    expected = 0.05 * 0.01 * np.sqrt(0.5) * LEFT * np.sqrt(1 - (7 / 30) ** 2)  # receivers 0.1 m ahead, phase centres half
    # sin(yaw) for yaw: 2e-5 of it
    assert track_error(echoes(turned), echoes(LINE), 30.0) == pytest.approx(expected, rel=1e-4)
    # the side is that of the true echoes' beam: seen from there sway and heave cancel
    sine = 7 / 30
    shift = along(1, sine * WAVE) + along(2, np.sqrt(1 - sine**2) * WAVE)
    port = echoes(LINE, pysas.Beam((0.3, -1.0, 0.2), 0.1, 0.2))
    straight_abeam = np.array([0.3, -1.0]) / np.hypot(0.3, 1.0)
    left = track_error(echoes(moved(LINE, shift)), port, 30.0)
    amplitude = np.sqrt(1 - sine**2) * sine * (straight_abeam[1] + 1)
    assert left == pytest.approx(amplitude * np.sqrt(0.5) * LEFT, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"found": np.zeros((N - 1, 3))}, ValueError, "found: 199 pings: expected 200"),
        ({"found": np.full((N, 3), np.nan)}, ValueError, "found: nan at ping 0"),
        ({"found": np.zeros((N, 2))}, ValueError, "found: expected shape"),
        ({"found": "track"}, TypeError, "found: expected real numbers"),
        ({"found": echoes(LINE)}, TypeError, "found=Echoes, true=Track: expected two of one kind"),
        ({"true": np.zeros((2, 3)), "found": np.zeros((2, 3))}, ValueError, "true: 2 pings: expected at least 3"),
        ({"range": 0.0}, ValueError, "range=0.0"),
        ({"range": np.nan}, ValueError, "range=nan"),
        ({"range": 5.0}, ValueError, "range=5: the seabed at z=8 m is 7 m off"),
        ({"seabed": np.inf}, ValueError, "seabed=inf"),
        ({"boresight": (0, 0, 1)}, ValueError, "boresight: no horizontal direction at ping 0"),
        ({"boresight": (0, 1)}, ValueError, "boresight: expected shape"),
        ({"true": np.ones((N, 3))}, ValueError, "boresight: no horizontal direction at ping 0"),
    ],
)
def test_rejected(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        track_error(**({"found": LINE, "true": LINE, "range": 30.0} | changes))


def test_a_track_is_no_error_of_itself() -> None:
    assert track_error(LINE, LINE, 30.0) == 0.0
