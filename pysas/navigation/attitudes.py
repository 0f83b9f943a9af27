"""Attitudes as Euler angles, quaternions or matrices -> rotations of the vehicle's axes into north, east, down.

Whatever comes in, what goes out is a `scipy.spatial.transform.Rotation` that turns forward, starboard, down into north, east,
down. With axes="ENU" the input turns forward, port, up into east, north, up instead (ROS REP 103).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pysas import _checks
from pysas._checks import FloatArray
from pysas.navigation._columns import column, named, within

AXES = ("NED", "ENU")
ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_PORT_UP = np.diag([1.0, -1.0, -1.0])  # forward, starboard, down -> forward, port, up
_ROUNDED = 1e-3  # what three decimals in a file do to a length of 1


@_checks.usual_errors
def euler(
    roll: npt.ArrayLike,
    pitch: npt.ArrayLike,
    yaw: npt.ArrayLike,
    *,
    axes: str = "NED",
    degrees: bool = False,
    source: str = "",
) -> Rotation:
    """Attitudes of Euler angles: R = Rz(yaw) Ry(pitch) Rx(roll), applied to a vector of the vehicle from right to left.

    Parameters
    ----------
    roll, pitch, yaw : (n,)
        Rad. "NED": roll starboard down, pitch bow up, yaw (heading) from true north clockwise. "ENU": roll starboard down,
        pitch bow down, yaw from east counter-clockwise.
    axes : {"NED", "ENU"}
        What the angles turn: forward, starboard, down into north, east, down; or forward, port, up into east, north, up.
    degrees : bool
        The angles are in degrees.
    source : str
        Name of the file they came from, for messages.

    Returns
    -------
    scipy.spatial.transform.Rotation
        n rotations of forward, starboard, down into north, east, down.

    Raises
    ------
    ValueError, TypeError
        Unequal lengths, non-finite, or beyond a half turn of roll, a quarter of pitch, a whole one of yaw: degrees where
        radians are meant. Names the angle and the row.
    """
    turn = 360.0 if degrees else 2 * np.pi
    unit = "degrees" if degrees else "rad"
    angles: list[FloatArray] = []
    for name, value, limit in (("roll", roll, turn / 2), ("pitch", pitch, turn / 4), ("yaw", yaw, turn)):
        name = named(source, name)
        angle = column(name, value, [(len(angles[0]),) if angles else ("n",)])
        within(name, angle, -limit * (1 + 1e-6), limit * (1 + 1e-6), unit, "" if degrees else "; is it in degrees?")
        angles.append(angle)
    given = Rotation.from_euler("ZYX", np.stack(angles[::-1], axis=1), degrees=degrees)
    return _into_ned(given, axes)


@_checks.usual_errors
def quaternions(quaternion: npt.ArrayLike, *, order: str, axes: str = "NED", source: str = "") -> Rotation:
    """Attitudes of unit quaternions.

    Parameters
    ----------
    quaternion : (n, 4)
        Of length 1 to within 1e-3 (what rounding in files leaves); its sign is free. v' = q v q* turns the vehicle's axes into
        those of the Earth.
    order : {"wxyz", "xyzw"}
        Whether the real part stands first or last.
    axes, source
        As for `euler`.

    Returns
    -------
    scipy.spatial.transform.Rotation
        n rotations of forward, starboard, down into north, east, down.

    Raises
    ------
    ValueError, TypeError
        Wrong shape, non-finite, or a length other than 1; names the row.
    """
    _checks.choice("order", order, ("wxyz", "xyzw"))
    name = named(source, "quaternion")
    q = column(name, quaternion, [("n", 4)])
    length = np.linalg.norm(q, axis=1)
    wrong = np.abs(length - 1) > _ROUNDED
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise ValueError(f"{name}: length {length[row]:.6g} at row {row}: expected 1 (to within {_ROUNDED:g})")
    return _into_ned(Rotation.from_quat(np.roll(q, -1, axis=1) if order == "wxyz" else q), axes)


@_checks.usual_errors
def matrices(matrix: npt.ArrayLike, *, axes: str = "NED", source: str = "") -> Rotation:
    """Attitudes of rotation matrices.

    Parameters
    ----------
    matrix : (n, 3, 3)
        Each times a column vector in the vehicle's axes is that vector in the Earth's. Orthogonal to within 1e-3; the nearest
        rotation is taken.
    axes, source
        As for `euler`.

    Returns
    -------
    scipy.spatial.transform.Rotation
        n rotations of forward, starboard, down into north, east, down.

    Raises
    ------
    ValueError, TypeError
        Wrong shape, non-finite, not orthogonal, or a reflection (determinant -1: left-handed axes); names the row.
    """
    name = named(source, "matrix")
    m = column(name, matrix, [("n", 3, 3)])
    excess = np.max(np.abs(np.swapaxes(m, 1, 2) @ m - np.eye(3)), axis=(1, 2), initial=0.0)
    wrong = excess > _ROUNDED
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise ValueError(f"{name}: transpose(R) R differs from 1 by {excess[row]:.3g} at row {row}: expected a rotation")
    mirrored = np.linalg.det(m) < 0
    if np.any(mirrored):
        row = int(np.argmax(mirrored))
        raise ValueError(f"{name}: determinant -1 at row {row}: expected a rotation between right-handed axes")
    return _into_ned(Rotation.from_matrix(m), axes)


def _into_ned(given: Rotation, axes: str) -> Rotation:
    if _checks.choice("axes", axes, AXES) == "NED":
        return given
    return Rotation.from_matrix(ENU_TO_NED @ given.as_matrix() @ _PORT_UP)
