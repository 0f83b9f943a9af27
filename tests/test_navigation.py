"""Attitudes, the ellipsoid, UTM and local frames: matrices by hand, PROJ's numbers, closed forms, round trips."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pysas import navigation
from pysas.navigation import Frame, along_track, euler, from_utm, matrices, quaternions, to_utm

pytestmark = pytest.mark.reference  # no engine takes part

FORWARD, STARBOARD, DOWN = np.eye(3)
ANGLE = st.floats(-np.pi, np.pi)
PITCH = st.floats(-np.pi / 2, np.pi / 2)
# WGS84 (NIMA TR8350.2): semi-axes; the quarter of a meridian, which is a Legendre integral of the second kind
A, B, QUARTER = 6378137.0, 6356752.3142, 10001965.7293
# latitude, longitude, height, Earth-centred x, y, z: PROJ 9.5.1, EPSG:4979 to EPSG:4978
PLACES = [
    (50.73, -1.41, -20.0, (4044091.116331192, -99541.7096678892, 4914571.728586119)),
    (-33.86, 151.25, 8.5, (-4648346.815160666, 2550170.3895533793, -3533566.6144870413)),
    (90.0, 0.0, 0.0, (0.0, 0.0, 6356752.314245179)),
    (71.25, -179.5, -4000.0, (-2055002.0963595333, -17933.73160466185, 6013517.869090448)),
]
# latitude, longitude, zone, south, easting, northing: PROJ 9.5.1, EPSG:4326 to EPSG:326zz or 327zz
UTM = [
    (50.73, -1.41, 30, False, 612213.0917805973, 5621006.090141049),
    (50.73, -0.5, 31, False, 253014.22909156416, 5625644.012138104),
    (72.5, 5.9, 31, False, 597299.7209477114, 8047053.75689772),
    (0.001, 3.0, 31, False, 500000.0, 110.5300461113784),
    (-33.86, 151.25, 56, True, 338117.03107399447, 6251989.076704213),
]


def by_hand(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), written out."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


@given(roll=ANGLE, pitch=PITCH, yaw=ANGLE)
def test_euler_angles_turn_about_x_then_y_then_z(roll: float, pitch: float, yaw: float) -> None:
    expected = by_hand(roll, pitch, yaw)
    np.testing.assert_allclose(euler([roll], [pitch], [yaw]).as_matrix()[0], expected, atol=1e-14)
    degrees = np.degrees([[roll], [pitch], [yaw]])
    np.testing.assert_allclose(euler(*degrees, degrees=True).as_matrix()[0], expected, atol=1e-14)
    np.testing.assert_allclose(matrices(expected[None]).as_matrix()[0], expected, atol=1e-14)


def test_signs_of_angles_as_a_navigator_has_them() -> None:
    """North, east, down: heading clockwise from north, bow up, starboard down are positive."""
    heading = euler([0], [0], [np.radians(30)])
    np.testing.assert_allclose(heading.apply(FORWARD), [[np.sqrt(3) / 2, 1 / 2, 0]], atol=1e-15)
    np.testing.assert_allclose(heading.apply(STARBOARD), [[-1 / 2, np.sqrt(3) / 2, 0]], atol=1e-15)
    assert euler([0], [0.1], [0]).apply(FORWARD)[0, 2] == pytest.approx(-np.sin(0.1))
    assert euler([0.1], [0], [0]).apply(STARBOARD)[0, 2] == pytest.approx(np.sin(0.1))


@given(roll=ANGLE, pitch=PITCH, yaw=ANGLE)
def test_the_same_attitude_in_east_north_up(roll: float, pitch: float, yaw: float) -> None:
    """ROS REP 103: forward, port, up into east, north, up; yaw from east counter-clockwise, pitch bow down, roll the same."""
    ned = by_hand(roll, pitch, yaw)
    other = euler([roll], [-pitch], [(np.pi / 2 - yaw + np.pi) % (2 * np.pi) - np.pi], axes="ENU")
    np.testing.assert_allclose(other.as_matrix()[0], ned, atol=1e-14)
    north, east, down = ned  # rows; columns forward, starboard, down
    enu = np.stack([east, north, -down]) * [1, -1, -1]
    np.testing.assert_allclose(matrices(enu[None], axes="ENU").as_matrix()[0], ned, atol=1e-14)


@given(axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.01), angle=ANGLE)
def test_quaternions_turn_as_rodrigues_says(axis: tuple[float, float, float], angle: float) -> None:
    """q = (cos(a/2), sin(a/2) u) turns by a about u: R v = v cos a + (u x v) sin a + u (u.v)(1 - cos a)."""
    u = np.array(axis) / np.linalg.norm(axis)
    v = np.array([0.3, -1.2, 0.7])
    expected = v * np.cos(angle) + np.cross(u, v) * np.sin(angle) + u * (u @ v) * (1 - np.cos(angle))
    w, (x, y, z) = np.cos(angle / 2), np.sin(angle / 2) * u
    for q, order in (([[w, x, y, z]], "wxyz"), ([[x, y, z, w]], "xyzw"), ([[-w, -x, -y, -z]], "wxyz")):
        np.testing.assert_allclose(quaternions(q, order=order).apply(v)[0], expected, atol=1e-14)


def test_rounded_quaternions_and_matrices_are_taken() -> None:
    turn = by_hand(0.1, -0.2, 2.0)
    np.testing.assert_allclose(matrices(np.round(turn, 4)[None]).as_matrix()[0], turn, atol=2e-4)
    q = np.round(Rotation.from_matrix(turn).as_quat(), 4)
    np.testing.assert_allclose(quaternions(q[None], order="xyzw").as_matrix()[0], turn, atol=2e-4)


@pytest.mark.parametrize(("lat", "lon", "height", "expected"), PLACES)
def test_places_on_the_earth(lat: float, lon: float, height: float, expected: tuple[float, float, float]) -> None:
    origin = Frame(lat=lat, lon=lon, origin=(0.0, 0.0, -height))
    turn, shift = origin.earth()
    np.testing.assert_allclose(shift, expected, atol=2e-9)  # a spacing of float64 there is 1e-9
    # columns north, east, down: down is against the ellipsoid's normal, east level and along the circle of latitude
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-15)
    phi, lam = np.radians([lat, lon])
    np.testing.assert_allclose(turn[:, 2], -np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)]))
    np.testing.assert_allclose(turn[:, 1], [-np.sin(lam), np.cos(lam), 0])
    assert np.linalg.det(turn) == pytest.approx(1)


@given(
    lat=st.floats(-90, 90), lon=st.floats(-179, 179), heading=st.floats(-6, 6), x=st.floats(-1e4, 1e4), y=st.floats(-1e4, 1e4)
)
def test_local_to_geodetic_and_back(lat: float, lon: float, heading: float, x: float, y: float) -> None:
    frame = Frame(heading, lat, lon)
    place = np.array([[x, y, 4000.0], [y, x, -3.0]])
    np.testing.assert_allclose(frame.from_geodetic(*frame.to_geodetic(place)), place, atol=1e-8)


def test_a_degree_is_as_long_as_the_ellipsoid_says() -> None:
    """Near a point: north M dlat, east N cos(lat) dlon, with the radii of curvature of meridian and prime vertical."""
    lat, step = 50.0, 1e-5
    e2 = 1 - (B / A) ** 2
    w = 1 - e2 * np.sin(np.radians(lat)) ** 2
    meridian, normal = A * (1 - e2) / w**1.5, A / np.sqrt(w)
    north, east, down = Frame(lat=lat, lon=7.0).from_geodetic(lat + step, 7.0 + step, 5.0)
    assert north == pytest.approx((meridian - 5) * np.radians(step), rel=1e-6)
    assert east == pytest.approx((normal - 5) * np.radians(step) * np.cos(np.radians(lat)), rel=1e-6)
    assert down == pytest.approx(5.0, abs=1e-6)


def test_what_lies_far_away_stands_lower() -> None:
    """d^2/(2 R) below its depth: the frame is flat, the sea is not."""
    place = Frame(lat=0.0, lon=0.0).from_geodetic(0.0, np.degrees(1000 / A), 20.0)
    assert place[2] - 20 == pytest.approx(1000**2 / (2 * A), rel=1e-4)


@pytest.mark.parametrize(("lat", "lon", "zone", "south", "easting", "northing"), UTM)
def test_utm(lat: float, lon: float, zone: int, south: bool, easting: float, northing: float) -> None:
    found = to_utm(lat, lon, zone, south=south)
    np.testing.assert_allclose(found, (easting, northing), rtol=0, atol=2e-7)
    np.testing.assert_allclose(from_utm(*found, zone, south=south), (lat, lon), rtol=0, atol=1e-12)


def test_the_meridian_s_quarter() -> None:
    easting, northing = to_utm(90.0, 3.0, 31)
    assert easting == pytest.approx(500e3, abs=1e-6) and northing == pytest.approx(0.9996 * QUARTER, abs=1e-3)


def test_frames_turn_and_shift() -> None:
    """Heading east: x is east, y to starboard is south, z down."""
    frame = Frame(np.pi / 2, origin=(10.0, 20.0, 1.0))
    np.testing.assert_allclose(frame.from_ned([10.0, 25.0, 3.0]), [5, 0, 2], atol=1e-14)
    np.testing.assert_allclose(frame.from_ned([7.0, 20.0, 1.0]), [0, 3, 0], atol=1e-14)
    np.testing.assert_allclose(frame.to_ned([5.0, 3.0, 2.0]), [7, 25, 3], atol=1e-14)
    turn, shift = frame.into(Frame())
    np.testing.assert_allclose(turn @ [5, 3, 2] + shift, [7, 25, 3], atol=1e-14)


def test_frames_of_two_lines_agree_on_a_target() -> None:
    one, other = Frame(0.3, 50.73, -1.41), Frame(2.9, 50.74, -1.39)
    turn, shift = one.into(other)
    place = np.array([[12.0, 34.0, 20.0]])
    np.testing.assert_allclose(place @ turn.T + shift, other.from_geodetic(*one.to_geodetic(place)), atol=1e-8)


@given(heading=st.floats(0, 6.28), offset=st.floats(-1e6, 1e6))
def test_the_mean_track_lies_along_x(heading: float, offset: float) -> None:
    rng = np.random.default_rng(3)
    s = np.linspace(0, 40, 81)
    sway = 0.1 * np.sin(s) + 0.01 * rng.normal(size=s.size)
    track = np.stack([s * np.cos(heading) - sway * np.sin(heading) + offset, s * np.sin(heading) + sway * np.cos(heading)], 1)
    frame = along_track(np.column_stack([track, np.full(s.size, 12.0)]))
    turned = frame.from_ned(np.column_stack([track, np.full(s.size, 12.0)]))
    assert np.angle(np.exp(1j * (frame.heading - heading))) == pytest.approx(0, abs=2e-3)
    np.testing.assert_allclose(turned.mean(axis=0), [0, 0, 12], atol=1e-6)
    assert turned[-1, 0] - turned[0, 0] == pytest.approx(40, abs=1e-2)
    line = np.polynomial.polynomial.polyfit(turned[:, 0], turned[:, 1], 1)
    assert line[1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("s", [[0, 10, 20, 40], [30, 0, 10, 20, 40], [40, 0, 39]])
def test_the_mean_track_points_from_its_first_place_to_its_last(s: list[float]) -> None:
    """Not as most of its way goes: samples may begin before a turn."""
    frame = along_track(np.multiply.outer(np.array(s, float), [np.cos(2.0), np.sin(2.0), 0.0]))
    assert frame.heading == pytest.approx(2.0 if s[-1] > s[0] else 2.0 + np.pi)


def test_a_track_that_does_not_move_heads_north() -> None:
    assert along_track(np.ones((4, 3))).heading == 0.0
    frame = along_track(np.zeros((1, 3)), Frame(1.0, 50.0, 3.0))
    assert (frame.heading, frame.lat, frame.lon) == (0.0, pytest.approx(50.0), pytest.approx(3.0))


def test_what_frames_say() -> None:
    text = repr(Frame(np.radians(37), 50.73, -1.41))
    assert all(word in text for word in ("heading 37.000 deg", "starboard", "z down", "50.73", "WGS84"))
    assert "local metres" in repr(Frame(origin=(1.0, 2.0, 3.0)))


TURN = np.eye(3)[None]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: euler([0, 0], [0, 0], [0, 37.0]), ValueError, r"^yaw: 37 at row 1: .* rad; is it in degrees\?"),
        (lambda: euler([0, 4.0], [0, 0], [0, 0]), ValueError, "^roll: 4 at row 1"),
        (lambda: euler([0], [2.0], [0]), ValueError, "^pitch: 2 at row 0"),
        (lambda: euler([0], [0], [400.0], degrees=True), ValueError, "^yaw: 400 at row 0: expected -360 to 360 degrees"),
        (lambda: euler([0, 0], [0, np.nan], [0, 0], source="a.csv"), ValueError, "^a.csv: pitch: nan at row 1"),
        (lambda: euler([0, 0], [0], [0, 0]), ValueError, r"^pitch: expected shape \(2,\)"),
        (lambda: euler([0], [0], [0], axes="NWU"), ValueError, "axes='NWU': expected one of NED, ENU"),
        (lambda: euler([0], [0], [0], source=3), TypeError, "source=3"),  # type: ignore[arg-type]
        (lambda: quaternions([[1, 0, 0, 0], [1, 1, 0, 0]], order="wxyz"), ValueError, r"^quaternion: length 1.41421 at row 1"),
        (
            lambda: quaternions([[0, 0, 0, 0]], order="wxyz", source="q.csv"),
            ValueError,
            "^q.csv: quaternion: length 0 at row 0",
        ),
        (lambda: quaternions([[1, 0, 0, 0]], order="abcd"), ValueError, "order='abcd'"),
        (lambda: matrices(1.01 * TURN), ValueError, r"^matrix: transpose\(R\) R differs from 1 by 0.0201 at row 0"),
        (lambda: matrices(np.diag([1, 1, -1])[None]), ValueError, "determinant -1 at row 0"),
        (lambda: Frame(37.0), ValueError, r"heading=37.0: .*degrees\?"),
        (lambda: Frame(lat=91.0, lon=0.0), ValueError, "lat=91.0"),
        (lambda: Frame(lat=50.0), ValueError, "lon=None: expected both or none"),
        (lambda: Frame().to_geodetic([0.0, 0, 0]), ValueError, "frame: it has no lat, lon"),
        (lambda: Frame().into(Frame(lat=1.0, lon=1.0)), ValueError, "expected one tied to local metres"),
        (lambda: Frame(lat=1.0, lon=1.0).from_geodetic(91.0, 0.0), ValueError, "lat=91.0"),
        (lambda: along_track(np.zeros((0, 3))), ValueError, "position: no rows"),
        (lambda: along_track(np.zeros((3, 3)), "north"), TypeError, "frame=str"),  # type: ignore[arg-type]
        (lambda: to_utm([50.0, 95.0], [1.0, 1.0], 31), ValueError, "lat: 95 at row 1"),
        (lambda: to_utm(50.0, 80.0, 31), ValueError, "lon: 77 at row 0: expected -60 to 60 degrees from the middle of zone 31"),
        (
            lambda: to_utm([0.0, 0.0], [3.0, 8.0], 31),
            ValueError,
            "easting: 1057.* at row 1: expected 100000 to 900000 m in zone 31",
        ),
        (lambda: to_utm(50.0, 3.0, 61), ValueError, "zone=61"),
        (lambda: from_utm(50.73, -1.41, 30), ValueError, "easting: 50.73 at row 0"),
        (lambda: from_utm([5e5], [5e7], 30, source="u.csv"), ValueError, "^u.csv: northing: 50000000 at row 0"),
        (lambda: from_utm(np.float32([5e5]), np.float32([5e6]), 30), ValueError, "easting: float32 resolves 500000 to 0.031"),
    ],
)
def test_rejected(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()


def test_public_names() -> None:
    assert [name for name in navigation.__all__ if not getattr(navigation, name).__doc__] == []
