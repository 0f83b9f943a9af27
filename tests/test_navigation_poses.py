"""Poses and lever arms: closed forms of straight, circular and accelerated motion, gaps, clocks, and navigation that is wrong.

`tests/test_pulse_centre.py` has the echoes of moving sonars.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pysas.navigation import Frame, Poses, euler, geometry, matrices, to_utm

pytestmark = pytest.mark.reference  # no engine takes part

START = 1.79e9  # s, UNIX
ROUNDED = 5e-7  # m: half a spacing of float64 at START, 0.12 microseconds, at some m/s
TX, RX = (0.5, 0.25, 0.1), np.array([[-0.4, 0.25, 0.15], [-0.35, 0.2, 0.15]])


def straight(n: int = 60, step: float = 0.1, speed: float = 2.0, **changes: Any) -> Poses:
    """Heading 30 degrees at constant depth and attitude."""
    time = START + step * np.arange(n)
    along = speed * step * np.arange(n)
    position = np.stack([along * np.cos(np.pi / 6), along * np.sin(np.pi / 6), np.full(n, 12.0)], axis=1)
    attitude = euler(np.full(n, 0.02), np.full(n, -0.03), np.full(n, np.pi / 6 + 0.01))
    return Poses(**{"time": time, "position": position, "attitude": attitude, **changes})


def call(poses: Poses, ping_time: Any, **changes: Any) -> Any:
    usual = {"tx": TX, "rx": RX, "pulse_centre": 1e-3, "travel_time": (0.02, 0.1)}
    return geometry(poses, ping_time, **{**usual, **changes})


def test_straight_motion() -> None:
    """Everything moves at the vehicle's speed along x; arms turned by Rz(0.01) Ry(-0.03) Rx(0.02), written out."""
    ping_time = START + np.array([1.0, 1.5, 2.25])
    found = call(straight(), ping_time)
    cr, cp, cy = np.cos([0.02, -0.03, 0.01])
    sr, sp, sy = np.sin([0.02, -0.03, 0.01])
    turn = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    along = 2.0 * (np.array([1.0, 1.5, 2.25]) + 1e-3)
    along -= along.mean()
    place = np.stack([along, 0 * along, 0 * along + 12.0], axis=1)
    np.testing.assert_allclose(found.tx, place + turn @ TX, atol=ROUNDED)
    np.testing.assert_allclose(found.rx, place[:, None] + RX @ turn.T, atol=ROUNDED)
    np.testing.assert_allclose(found.velocity, np.broadcast_to([2.0, 0, 0], (3, 2, 3)), atol=1e-5)
    np.testing.assert_allclose(found.attitude.as_matrix(), np.broadcast_to(turn, (3, 3, 3)), atol=1e-12)
    assert found.frame.heading == pytest.approx(np.pi / 6, abs=1e-6)
    assert found.receiver_error < 2 * ROUNDED
    np.testing.assert_array_equal(found.ping_time, ping_time)


def test_one_receiver_and_a_given_frame() -> None:
    frame = Frame(0.0, origin=(1.0, 2.0, 3.0))
    found = call(straight(), START + np.array([1.0, 2.0]), rx=RX[0], frame=frame)
    assert found.rx.shape == found.velocity.shape == (2, 3)
    many = call(straight(), START + np.array([1.0, 2.0]), frame=Frame())
    np.testing.assert_allclose(found.rx, many.rx[:, 0] - [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(found.velocity, many.velocity[:, 0], atol=1e-9)


def test_clocks_and_the_pulse_s_centre_shift_alike() -> None:
    poses, ping_time = straight(), START + np.array([1.0, 2.0])
    ahead = call(poses, ping_time - 18.0, clock_offset=18.25, pulse_centre=0.0, frame=Frame())
    np.testing.assert_allclose(ahead.ping_time, ping_time + 0.25, atol=3e-7)
    centred = call(poses, ping_time, pulse_centre=0.25, frame=Frame())
    np.testing.assert_allclose(ahead.tx, centred.tx, atol=2 * ROUNDED)


def circle(speed: float, radius: float, step: float, n: int) -> Poses:
    """Clockwise seen from above (heading grows), about (0, 0), bow along the tangent; times near 0."""
    time = step * np.arange(n)
    angle = speed * time / radius
    position = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return Poses(time, position, euler(0 * angle, 0 * angle, np.angle(np.exp(1j * (angle + np.pi / 2)))))


def on_circle(angle: np.ndarray, radius: float, arm: np.ndarray) -> np.ndarray:
    """An arm (forward, starboard, down): the tangent is forward, the centre to starboard."""
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=-1)
    return np.asarray((radius - arm[1]) * out + arm[0] * ahead + arm[2] * np.array([0, 0, 1.0]))


def test_circular_motion_between_samples() -> None:
    """Cubic splines: 5/384 h^4 max |x''''| = 5/384 h^4 r w^4 = 8e-7 m at h = 0.2 s, w = 0.2 rad/s, r = 25 m."""
    speed, radius, step = 5.0, 25.0, 0.2
    poses, w = circle(speed, radius, step, 300), speed / radius
    time = np.linspace(10.0, 40.0, 77)
    found = call(poses, time, frame=Frame(), travel_time=(0.05, 0.2))
    bound = 5 / 384 * step**4 * radius * w**4
    assert bound == pytest.approx(8.3e-7, rel=0.01)
    np.testing.assert_allclose(found.tx, on_circle(w * (time + 1e-3), radius, np.array(TX)), atol=1.1 * bound)
    for channel, arm in enumerate(RX):
        np.testing.assert_allclose(found.rx[:, channel], on_circle(w * (time + 1e-3), radius, arm), atol=1.1 * bound)
    # straight paths: a last n (last - n)/(2 (last + n)) with a = w^2 |arm's radius|, n = 0.414 last
    acceleration = w**2 * np.max(np.hypot(radius - RX[:, 1], RX[:, 0]))
    expected = acceleration * 0.2**2 * 0.0858
    assert expected == pytest.approx(3.4e-3, rel=0.01)
    worst = 0.0
    for age in np.linspace(0.05, 0.2, 151):
        true = np.stack([on_circle(w * (time + 1e-3 + age), radius, arm) for arm in RX], axis=1)
        worst = max(worst, float(np.linalg.norm(found.rx + found.velocity * age - true, axis=-1).max()))
    assert worst == pytest.approx(expected, rel=0.01)
    assert found.receiver_error == pytest.approx(expected, rel=0.01)


@given(first=st.floats(0, 0.19), amount=st.floats(0.01, 1.0))
def test_receivers_that_accelerate(first: float, amount: float) -> None:
    """x = a t^2/2, which cubics follow exactly: the largest error of the record is as small as a straight path leaves it."""
    last = 0.2
    time = 0.1 * np.arange(40)
    position = np.stack([amount * time**2 / 2, 0 * time, 0 * time], axis=1)
    poses = Poses(time, position, euler(0 * time, 0 * time, 0 * time))
    found = call(poses, [1.0], frame=Frame(), rx=[[0, 0, 0]], travel_time=(first, last), pulse_centre=0.0)
    ages = np.linspace(first, last, 2001)
    drift = amount * (1.0 * ages + ages**2 / 2)  # from x(1)
    worst = float(np.max(np.abs(found.velocity[0, 0, 0] * ages - drift)))
    # the best velocity there is, by search
    tried = amount * (1.0 + np.linspace(0, 0.1, 4001))
    best = float(np.min(np.max(np.abs(np.multiply.outer(tried, ages) - drift), axis=1)))
    assert worst <= best + amount * 1e-5
    assert worst <= 0.0859 * amount * last**2
    assert found.receiver_error == pytest.approx(worst, rel=0.2)


def test_the_same_navigation_in_all_coordinates() -> None:
    """Latitude and longitude, UTM (scale and convergence taken out), metres east, north, up: one geometry."""
    n = 80
    time = START + 0.1 * np.arange(n)
    frame = Frame(lat=50.73, lon=-0.5)  # convergence of zone 31 here: -2.7 degrees
    s = 0.2 * np.arange(n)
    local = np.stack([s, 0.3 * s + 0.2 * np.sin(s), 12 + 0.1 * np.cos(s)], axis=1)
    lat, lon, depth = frame.to_geodetic(local)
    attitude = euler(0.05 * np.sin(s), 0.03 * np.cos(s), 0.3 + 0.1 * np.sin(s / 2))
    ping_time = START + np.arange(1.0, 6.0, 0.21)
    one = call(Poses.from_geodetic(time, lat, lon, attitude, depth=depth), ping_time, frame=frame)
    above = call(Poses.from_geodetic(time, lat, lon, attitude, height=-depth), ping_time, frame=frame)
    easting, northing = to_utm(lat, lon, 31)
    utm = call(Poses.from_utm(time, easting, northing, 31, attitude, depth=depth), ping_time, frame=frame)
    plane = Poses.from_local(time, local, attitude)
    metres = call(plane, ping_time, frame=Frame())
    port_up = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ attitude.as_matrix() @ np.diag([1.0, -1, -1])
    enu_poses = Poses.from_local(time, local[:, [1, 0, 2]] * [1, 1, -1], matrices(port_up, axes="ENU"), axes="ENU")
    enu = call(enu_poses, ping_time, frame=Frame())
    for other, limit in ((above, 1e-8), (utm, 1e-6), (metres, 5e-6), (enu, 5e-6)):
        # metres: attitudes about north at each place, which over 15 m turns by 3e-6 rad from that of the frame
        np.testing.assert_allclose(other.tx, one.tx, atol=limit)
        np.testing.assert_allclose(other.rx, one.rx, atol=limit)
        np.testing.assert_allclose(other.velocity, one.velocity, atol=10 * limit)
    np.testing.assert_allclose(metres.tx, enu.tx, atol=1e-9)
    auto = call(Poses.from_geodetic(time, lat, lon, attitude, depth=depth), ping_time)
    turn, shift = auto.frame.into(frame)
    np.testing.assert_allclose(auto.rx @ turn.T + shift, one.rx, atol=1e-7)
    assert auto.frame.heading == pytest.approx(np.arctan(0.3), abs=0.03) and auto.frame.lat is not None


def test_true_north_turns_with_the_meridians() -> None:
    """10 km west of the frame's origin at latitude 60 true north lies east of its north by 10 km/N tan(lat) = 0.155 degrees."""
    lat, east = 60.0, 10e3
    a, b = 6378137.0, 6356752.3142
    normal = a / np.sqrt(1 - (1 - (b / a) ** 2) * np.sin(np.radians(lat)) ** 2)
    lon = np.degrees(east / (normal * np.cos(np.radians(lat))))
    level = euler(np.zeros(3), np.zeros(3), np.zeros(3))
    time = np.array([0.0, 200.0, 400.0])
    poses = Poses.from_geodetic(time, np.full(3, lat), lon * np.arange(3), level, depth=np.zeros(3))
    bow = poses.at(time)[1].apply([1, 0, 0])
    expected = east / normal * np.tan(np.radians(lat)) * np.array([1, 0, -1])
    np.testing.assert_allclose(np.arctan2(bow[:, 1], bow[:, 0]), expected, rtol=1e-3, atol=1e-12)


def test_attitudes_go_the_short_way_between_samples() -> None:
    """359 to 1 degrees passes north, and q and -q are one attitude."""
    yaw = np.radians([357, 359, 1, 3])
    poses = Poses(np.arange(4.0), np.zeros((4, 3)), euler(0 * yaw, 0 * yaw, yaw))
    flipped = poses.attitude.as_quat() * np.array([[1], [-1], [1], [-1]])
    for attitude in (poses.attitude, Rotation.from_quat(flipped)):
        _, found = Poses(np.arange(4.0), np.zeros((4, 3)), attitude).at([1.5, 2.25])
        np.testing.assert_allclose(found.as_rotvec(degrees=True), [[0, 0, 0], [0, 0, 1.5]], atol=1e-10)


def test_gaps_end_splines() -> None:
    """Beside a gap positions come of the samples on their own side: 0 before it, a line after it."""
    time = np.concatenate([np.arange(10.0), [25.0], np.arange(40.0, 50.0)])
    x = np.where(time > 30, time - 40, 0.0)
    poses = Poses(time, np.stack([x, 0 * x, 0 * x], 1), euler(0 * x, 0 * x, 0 * x), source="nav.csv")
    assert poses.max_gap == 4.0
    found, _ = poses.at([8.9, 40.5, 49.0])
    np.testing.assert_allclose(found[:, 0], [0, 0.5, 9], atol=1e-12)
    with pytest.raises(
        ValueError, match=r"^time: 20\.0+ s at index 1: in a gap of nav\.csv: time: 9\.0.* row 9 to 40\.0.* row 11"
    ):
        poses.at([8.0, 20.0, 25.0])
    allowed = Poses(time, poses.position, poses.attitude, max_gap=20.0)
    assert allowed.at([20.0])[0].shape == (1, 3)
    assert "2 longer than max_gap = 4 s" in repr(poses) and "nav.csv" in repr(poses)


def test_a_gap_names_pings_and_rows() -> None:
    full = straight()
    keep = np.r_[0:20, 31:60]
    poses = Poses(full.time[keep], full.position[keep], full.attitude[keep], source="nav.csv")
    pings = START + np.arange(0.5, 5.0, 0.25)
    # row 19 is at 1.9 s, row 20 at 3.1 s: pings 6 (2.0 s) to 10 (3.0 s) lie between, ping 5 at 1.75 s ends at 1.851 s
    message = (
        r"^pings\.csv: ping_time: ping 6 at 1790000002\.0.*: in a gap of nav\.csv: time: 1790000001\.9\d* s at row 19 to "
        r"1790000003\.1\d* s at row 20, 1\.2 s: expected at most max_gap = 0\.4.* s; 5 such in all$"
    )
    with pytest.raises(ValueError, match=message):
        call(poses, pings, source="pings.csv")
    with pytest.raises(ValueError, match="ping 5 at .* in a gap"):
        call(poses, pings, travel_time=(0.02, 0.2))  # its echoes last into the gap
    assert call(poses, pings[:6]).tx.shape == (6, 3)


def test_what_is_assumed_is_said() -> None:
    poses = straight(source="nav.csv")
    text = repr(poses)
    for word in ("Rz(yaw) Ry(pitch) Rx(roll)", "forward, starboard, down", "z 12.000 to 12.000 m (down)", "max_gap = 0.4"):
        assert word in text
    text = repr(call(poses, START + np.array([1.0, 2.0])))
    for word in (
        "2 pings x 2 channels",
        "pulse's centre, 0.001 s",
        "t0 of Echoes counts from the leading edge",
        "heading 30.000",
    ):
        assert word in text


def test_poses_are_kept_as_they_were() -> None:
    position, attitude = np.zeros((3, 3)), euler(np.zeros(3), np.zeros(3), np.zeros(3))
    poses = Poses(np.arange(3.0), position, attitude)
    position += 7
    attitude[0] = Rotation.from_rotvec([0, 0, 1])
    assert np.all(poses.position == 0) and np.all(poses.attitude.as_quat()[0] == [0, 0, 0, 1])


LEVEL = euler(np.zeros(4), np.zeros(4), np.zeros(4))
TIME = np.arange(4.0)
LAT = np.full(4, 50.73)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"time": [0, 1, 1, 2]}, ValueError, r"^n\.csv: time: 1\.0* s at row 2 is the same as 1\.0* s at row 1: expected incr"),
        ({"time": [0, 2, 1, 3]}, ValueError, r"^n\.csv: time: 1\.0* s at row 2 is before 2\.0* s at row 1"),
        ({"time": [0, np.nan, 1, 3]}, ValueError, r"^n\.csv: time: nan at row 1"),
        (
            {"time": 1.79e12 + TIME},
            ValueError,
            r"^n\.csv: time: float64 resolves 1.79e\+12 to 0.00024: expected 1e-06 or finer, in SI",
        ),
        ({"time": 1790000000 * 10**9 + np.arange(4) * 10**9}, ValueError, r"^n\.csv: time: int64 in float64 resolves 1.79"),
        ({"time": np.float32(1.79e9 + 100 * TIME)}, ValueError, r"^n\.csv: time: float32 resolves"),
        ({"time": [0.0], "position": np.zeros((1, 3))}, ValueError, "time: 1 rows: expected at least 2"),
        ({"position": [[0, 0, 0], [1, 0, 0], [2, np.inf, 0], [3, 0, 0]]}, ValueError, "position: inf at row 2"),
        ({"position": np.zeros((3, 3))}, ValueError, r"position: expected shape \(4, 3\)"),
        (
            {"position": np.zeros((4, 3), "f4") + np.float32(5e6)},
            ValueError,
            "position: float32 resolves 5000000 to 0.5: expected 0",
        ),
        ({"position": [[0, 0, 0], [1, 0, 0], [2000, 0, 0], [3, 0, 0]]}, ValueError, "position: 1999 m/s from row 1 to row 2"),
        ({"attitude": LEVEL[:3]}, ValueError, "attitude: 3 rotations: expected one for each of 4 rows"),
        ({"attitude": np.zeros((4, 3))}, TypeError, "attitude=ndarray: expected rotations"),
        ({"frame": "NED"}, TypeError, "frame=str"),
        ({"max_gap": 0.0}, ValueError, "max_gap=0.0"),
        ({"source": None}, TypeError, "source=None"),
    ],
)
def test_wrong_poses(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    fields: dict[str, Any] = {"time": TIME, "position": np.zeros((4, 3)), "attitude": LEVEL, "source": "n.csv"}
    with pytest.raises(error, match=message):
        Poses(**(fields | changes))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: Poses.from_geodetic(TIME, LAT + 50, LAT, LEVEL, depth=TIME),
            "^lat: 100.73 at row 0: expected -90 to 90 degrees",
        ),
        (lambda: Poses.from_geodetic(TIME, LAT, LAT, LEVEL), "depth, height: none given"),
        (lambda: Poses.from_geodetic(TIME, LAT, LAT, LEVEL, depth=TIME, height=TIME), "depth, height: both given"),
        (
            lambda: Poses.from_geodetic(TIME, LAT, LAT, LEVEL, depth=[1, 2, np.nan, 3], source="n.csv"),
            "^n.csv: depth: nan at row 2",
        ),
        (lambda: Poses.from_geodetic(TIME, LAT, LAT[:3], LEVEL, depth=TIME), "lon: 3 rows beside 4 of lat"),
        (lambda: Poses.from_geodetic(TIME, np.float32(LAT), LAT, LEVEL, depth=TIME), "lat: float32 resolves 50.7"),
        (lambda: Poses.from_geodetic(TIME, LAT, LAT, LEVEL[:2], depth=TIME), "attitude: 2 rotations"),
        (lambda: Poses.from_utm(TIME, LAT, LAT, 30, LEVEL, depth=TIME, source="n.csv"), "^n.csv: easting: 50.73 at row 0"),
        (lambda: Poses.from_local(TIME, np.zeros((4, 3)), LEVEL, axes="XYZ"), "axes='XYZ'"),
        (
            lambda: straight().at([START - 1.0]),
            r"^time: 1789999999.0* s at index 0: before time begins: 1790000000.0* s at row 0",
        ),
        (lambda: Poses(TIME, np.zeros((4, 3)), LEVEL, max_gap=0.5).at([1.0]), "max_gap=0.5 s: below all intervals of time"),
    ],
)
def test_wrong_navigation(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


PINGS = START + np.array([1.0, 1.5, 2.0])


@pytest.mark.parametrize(
    ("ping_time", "changes", "error", "message"),
    [
        (PINGS[[0, 2, 1]], {}, ValueError, r"^p\.csv: ping_time: .*001\.50* s at ping 2 is before .*002\.0* s at ping 1"),
        (PINGS[[0, 0, 1]], {}, ValueError, r"^p\.csv: ping_time: .* at ping 1 is the same as .* at ping 0"),
        ([START, np.nan], {}, ValueError, r"^p\.csv: ping_time: nan at ping 1"),
        ([], {}, ValueError, "ping_time: no pings"),
        (PINGS - 1.5, {}, ValueError, r"ping 0 at 1789999999.5.*before n\.csv: time begins: .* at row 0; 1 such|at row 0$"),
        (PINGS + 4.2, {}, ValueError, r"ping 2 at 1790000006\.2.*: it ends 0\.40?\d* s after n\.csv: time: .* at row 59$"),
        (
            PINGS,
            {"clock_offset": 18.0},
            ValueError,
            r"ping 0 at 1790000019\.0.*on navigation's clock.* at row 59; 3 such in all",
        ),
        (PINGS, {"tx": (500.0, 250.0, 100.0)}, ValueError, "tx: 500 m: expected a lever arm below 100 m"),
        (PINGS, {"tx": np.zeros((3, 3))}, ValueError, r"tx: expected shape \(3,\)"),
        (PINGS, {"rx": np.zeros((0, 3))}, ValueError, "rx: no channels"),
        (PINGS, {"rx": [[0, 0, 0], [0, np.nan, 0]]}, ValueError, "rx: nan at channel 1"),
        (PINGS, {"pulse_centre": -1e-3}, ValueError, "pulse_centre=-0.001"),
        (PINGS, {"travel_time": (0.1, 0.1)}, ValueError, r"travel_time=\(0.1, 0.1\): expected 0 <= first < last"),
        (PINGS, {"frame": Frame(lat=50.0, lon=0.0)}, ValueError, "expected one tied to local metres"),
        (PINGS, {"frame": 0.0}, TypeError, "frame=float"),
    ],
)
def test_wrong_pings(ping_time: Any, changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(straight(source="n.csv"), ping_time, source="p.csv", **changes)


def test_poses_are_wanted() -> None:
    with pytest.raises(TypeError, match="poses=NoneType"):
        call(None, PINGS)  # type: ignore[arg-type]
