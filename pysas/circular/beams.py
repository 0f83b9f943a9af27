"""What beams leave of terms, for the sums and weights of this package; shares nothing with an engine's or the oracle's rule."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.model.beam import EDGE_ANGLE, Beam


def off_middle(beam: Beam, direction: FloatArray, ping: int | None = None) -> FloatArray:
    """Angle off a beam's middle.

    Parameters
    ----------
    beam : Beam
    direction : (n, 3)
        From transmitters to places, m.
    ping : int, optional
        The ping that all directions belong to. Default: one each, in turn.

    Returns
    -------
    float64 (n,)
        rad, of a cone's boresight or the plane across a fan's axis; infinite where a fan's other side lies. 0 on a transmitter.
    """

    def of(vectors: FloatArray) -> FloatArray:
        return vectors if ping is None or len(vectors) == 1 else vectors[ping : ping + 1]

    boresight = of(beam.boresights)
    distance = np.linalg.norm(direction, axis=-1, keepdims=True)
    unit = np.divide(direction, distance, out=np.broadcast_to(boresight, direction.shape).copy(), where=distance > 0)
    if beam.shape == "cone":
        # W. Kahan: exact to rounding at any angle
        return np.asarray(2 * np.arctan2(np.linalg.norm(unit - boresight, axis=-1), np.linalg.norm(unit + boresight, axis=-1)))
    aside = np.abs(np.sum(unit * of(beam.axes), axis=-1)) * (distance[..., 0] > 0)
    angle = np.arcsin(np.minimum(aside, 1.0))  # wrong by at most 2e-8 rad, near pi/2
    return np.where(np.sum(unit * boresight, axis=-1) >= -EDGE_ANGLE, angle, np.inf)


def lit(beam: Beam, angle: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether places at an angle off a beam's middle count: without taper up to 1e-7 rad beyond the half-angle."""
    return np.asarray(angle <= beam.half_angle + (0.0 if beam.taper > 0 else EDGE_ANGLE))


def weight(beam: Beam, angle: FloatArray) -> FloatArray:
    """What terms weigh at an angle off a beam's middle: a raised cosine over the taper, 0 where they do not count."""
    found = lit(beam, angle).astype(np.float64)
    if beam.taper > 0:
        ramp = (beam.half_angle - np.minimum(angle, beam.half_angle)) / (beam.taper * beam.half_angle)
        found *= (1 - np.cos(np.pi * np.minimum(ramp, 1.0))) / 2
    return found
