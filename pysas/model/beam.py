"""Beam: what of a scene each ping's transmitter lights, and how much a term weighs for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray

# A term counts up to EDGE_ANGLE (rad) beyond the half-angle of a beam without taper: far more than directions in float64 are
# rounded by, so that pixels put on an edge count whatever the rounding, and far less than anything physical.
EDGE_ANGLE = 1e-7
LEAST_RAMP = 1e-5  # rad: a taper over less is an edge, of which roundings would decide
LEAST_SINE = 1e-6  # of the angle between a fan's axis and boresight
FAN, CONE = "fan", "cone"


@dataclass(frozen=True, eq=False)
class Beam:
    """Beam of the transmitter: what its terms weigh; those outside its half-angle are not part of the model.

    alpha is the angle between the direction from transmitter to pixel and, for a fan, the plane across `axis`; for a cone,
    boresight. A term weighs 1 up to (1 - taper) half_angle and cos^2(pi/2 (alpha - (1 - taper) half_angle)/(taper half_angle))
    beyond, down to 0 at half_angle. A fan holds what lies on boresight's side alone, up to 1e-7 rad beyond its end, whatever
    its depression.

    Parameters
    ----------
    boresight : (3,) or (ping, 3) array_like
        Direction the beam looks in; need not have length 1.
    length : float
        Along-track length D of the element, m; serves the along-track sampling warnings (D/4, D/2).
    half_angle : float
        Largest alpha that counts, rad: in (0, pi/2] for a fan, in (0, pi] for a cone. Without taper pixels on that edge count
        whatever their coordinates' rounding: up to 1e-7 rad beyond it.
    shape : "fan" or "cone"
        What a long element lights, narrow along track and wide in elevation, or what a round one does.
    taper : float
        Share of the half-angle over which the weight falls, 0 (a hard edge) to 1; if not 0, at least 1e-5 rad of it.
    axis : (3,) or (ping, 3) array_like, optional
        Along the element, for a fan; need not have length 1. Default: boresight x vertical, where the vertical is z.

    Raises
    ------
    ValueError, TypeError
        A shape, angle or taper out of range; a direction of no length or not finite; an axis along boresight, or none given
        where boresight is vertical; an axis given for a cone.
    """

    boresight: FloatArray
    length: float
    half_angle: float
    shape: str = FAN
    taper: float = 0.0
    axis: FloatArray | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        if self.shape not in (FAN, CONE):
            raise ValueError(f"shape={self.shape!r}: expected {FAN!r} or {CONE!r}")
        put("boresight", _direction("boresight", self.boresight))
        put("length", _checks.number("length", self.length, positive=True))
        angle = _checks.number("half_angle", self.half_angle, positive=True)
        if angle > (np.pi / 2 if self.shape == FAN else np.pi):
            limit = "pi/2] for a fan" if self.shape == FAN else "pi]"
            raise ValueError(f"half_angle={angle!r}: expected radians in (0, {limit}")
        put("half_angle", angle)
        taper = _checks.number("taper", self.taper)
        if not 0 <= taper <= 1:
            raise ValueError(f"taper={taper!r}: expected a share of the half-angle, 0 to 1")
        if 0 < taper * angle < LEAST_RAMP:
            raise ValueError(f"taper={taper!r}: {taper * angle:.3g} rad: expected 0 or at least {LEAST_RAMP:g} rad")
        put("taper", taper)
        if self.axis is not None:
            if self.shape == CONE:
                raise ValueError(f"axis={self.axis!r}: expected None for a cone")
            put("axis", _direction("axis", self.axis))
        if self.shape == FAN:
            _ = self.axes  # which checks it against boresight

    @property
    def boresights(self) -> FloatArray:
        """(1 or ping, 3) directions of length 1."""
        return _unit(np.atleast_2d(self.boresight))

    @property
    def axes(self) -> FloatArray:
        """(1 or ping, 3) directions of length 1 along a fan's element."""
        look = self.boresights
        if self.axis is None:
            axis = np.cross(look, [0.0, 0.0, 1.0])
            if not np.all(np.linalg.norm(axis, axis=1) > LEAST_SINE):
                raise ValueError(f"boresight={self.boresight!r}: vertical: expected an axis along the element beside it")
            return _unit(axis)
        axis = _unit(np.atleast_2d(self.axis))
        if len(axis) > 1 < len(look) != len(axis):
            raise ValueError(f"axis: of {len(axis)} pings: expected as many as boresight's, {len(look)}")
        if not np.all(np.linalg.norm(np.cross(look, axis), axis=1) > LEAST_SINE):
            raise ValueError(f"axis={self.axis!r}: along boresight: expected the direction of the element, across it")
        return axis

    def require_pings(self, ping: int) -> None:
        """Raise ValueError unless directions are one for all or one for each of so many pings."""
        for name, value in (("boresight", self.boresight), ("axis", self.axis)):
            if value is not None and value.shape not in ((3,), (ping, 3)):
                raise ValueError(f"beam: {name} of shape {value.shape}: expected (3,) or ({ping}, 3)")

    def describe(self) -> str:
        """In words."""
        edge = f"falling over its outer {100 * self.taper:.3g} %" if self.taper > 0 else "with a hard edge"
        return f"{self.shape}, half-angle {np.degrees(self.half_angle):.3g} deg {edge}, D {self.length:g} m"


def _direction(name: str, value: npt.ArrayLike) -> FloatArray:
    found = _checks.reals(name, value, [(3,), ("ping", 3)], ("ping",))
    length = np.hypot(np.hypot(found[..., 0], found[..., 1]), found[..., 2])
    if not np.all((length > 1e-100) & (length < 1e100)):  # whose squares are numbers
        raise ValueError(f"{name}={value!r}: expected non-zero vectors of at most 1e100")
    return found


def _unit(vectors: FloatArray) -> FloatArray:
    scaled = vectors / np.max(np.abs(vectors), axis=-1, keepdims=True)
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))
