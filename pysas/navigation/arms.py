"""Lever arms: poses at the pings' times -> where transmitter and receivers are, and how receivers move until echoes come.

The pulse's centre is what places are told for: it leaves while the vehicle moves, and each part of it has its phase from where
the transmitter is then. To first order in the motion these balance about one instant, `pulse_centre`, so that targets are found
where they would be had all of the pulse left from there. `compress` puts an echo's peak at its travel time for t counted from
the leading edge: places at leading edge + pulse_centre belong to `t0` counted from the leading edge, with nothing to correct.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import hilbert
from scipy.spatial.transform import Rotation

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.pulse import LFM
from pysas.navigation._columns import column, named, times
from pysas.navigation.frames import Frame, along_track
from pysas.navigation.samples import Poses

_LONGEST_ARM = 100.0  # m; longer ones are millimetres
_NEAR_SHARE = float(np.sqrt(2) - 1)  # of the last travel time: before it receivers have hardly moved
_MIDPOINTS = 8192  # of a pulse: its centre to 1e-7 of its length
_LOOKS = 5  # instants of the record at which receivers are compared with their straight paths


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """What `pysas.Echoes` wants of navigation, ping by ping, in one frame; `geometry` makes it.

    Parameters
    ----------
    frame : Frame
        x, y, z (down) of all that follows.
    ping_time : (ping,)
        Leading edge of each pulse on the navigation's clock, s.
    pulse_centre : float
        From there to the instant that places are told for, s.
    tx : (ping, 3)
        Transmitter when the pulse's centre leaves, m.
    rx : (ping, channel, 3), or (ping, 3) for one receiver given as (3,)
        Receivers at that instant, m.
    velocity : as `rx`
        Mean velocity of each receiver until it hears what is far away, m/s.
    attitude : scipy.spatial.transform.Rotation of length ping
        Turns forward, starboard, down into the frame at that instant: attitude.apply([0, 1, 0]) is a starboard sonar's level
        boresight, (ping, 3), attitude.apply([1, 0, 0]) a fan's axis.
    receiver_error : float
        How far a receiver is at most from rx + velocity t while the record lasts, m.
    """

    frame: Frame
    ping_time: FloatArray
    pulse_centre: float
    tx: FloatArray
    rx: FloatArray
    velocity: FloatArray
    attitude: Rotation
    receiver_error: float

    def __repr__(self) -> str:
        pings, channels = len(self.tx), self.rx.shape[1] if self.rx.ndim == 3 else 1
        length = float(np.linalg.norm(self.tx[-1] - self.tx[0]))
        speed = np.linalg.norm(self.velocity, axis=-1)
        return "\n".join(
            [
                f"Geometry: {pings} pings x {channels} channels over {length:.4g} m",
                f"  frame      {self.frame}",
                f"  instant    the pulse's centre, {self.pulse_centre:.6g} s after ping_time, its leading edge; "
                "t0 of Echoes counts from the leading edge",
                f"  velocity   of receivers from there until they hear: {speed.min():.4g} to {speed.max():.4g} m/s, "
                f"straight to within {self.receiver_error:.2g} m",
            ]
        )


@_checks.usual_errors
def pulse_centre(pulse: LFM | npt.ArrayLike, fs: float | None = None, fc: float = 0.0) -> float:
    """The instant of a pulse, s after its leading edge, that places are told for: sum t |f p|^2 / sum |f p|^2.

    Each frequency f of a sweep leaves at its own time and shows a target moved along the track by the vehicle's way until then;
    in an image these balance with weights of energy times f^2, as phases turn with f. For a flat LFM with b = bandwidth/fc it
    is duration/2 (1 + b/(3 + b^2/4)).

    Parameters
    ----------
    pulse : LFM or (sample,)
        A measured waveform begins at the leading edge, as `Echoes.pulse` does: complex base-band about `fc`, or real pass-band.
    fs : float
        Sample rate of a waveform, Hz.
    fc : float
        Demodulation frequency of a complex waveform, Hz.

    Returns
    -------
    float

    Raises
    ------
    ValueError, TypeError
        A waveform that is not one row of finite samples of which two neighbours are not zero, or without fs.
    """
    if isinstance(pulse, LFM):
        start, stop = pulse.support
        t = start + (np.arange(_MIDPOINTS) + 0.5) * ((stop - start) / _MIDPOINTS)
        weight = (pulse.envelope(t) * (pulse.fc + pulse.rate * (t - pulse.duration / 2))) ** 2
        return float(t @ weight / weight.sum())
    samples = _checks.array_like("pulse", pulse)
    if samples.ndim != 1 or samples.dtype.kind not in "iufc":
        raise ValueError(f"pulse: shape {samples.shape} of {samples.dtype}: expected one row of samples")
    rate, carrier = _checks.number("fs", fs, positive=True), _checks.number("fc", fc, low=0.0)
    if samples.dtype.kind != "c" and carrier != 0:
        raise ValueError(f"fc={fc!r}: real samples: expected pass-band ones, which have none, or complex ones about fc")
    peak = float(np.max(np.abs(samples.astype(np.complex128)), initial=0.0))
    if not np.isfinite(peak) or peak == 0:
        raise ValueError(f"pulse: {samples.size} samples, peak {peak:g}: expected finite samples of which some are not zero")
    waveform = samples / peak if samples.dtype.kind == "c" else hilbert(samples / peak)
    step = waveform[1:] * np.conj(waveform[:-1])  # from sample to sample: energy, and the turn that is the frequency
    weight = np.abs(step) * (carrier + np.angle(step) * rate / (2 * np.pi)) ** 2
    if not weight.sum() > 0:
        raise ValueError(f"pulse: {samples.size} samples: expected neighbours that are not zero, and a frequency")
    return float((np.arange(weight.size) + 0.5) @ weight / weight.sum() / rate)


@_checks.usual_errors
def geometry(
    poses: Poses,
    ping_time: npt.ArrayLike,
    *,
    tx: npt.ArrayLike,
    rx: npt.ArrayLike,
    pulse_centre: float,
    travel_time: Sequence[float],
    clock_offset: float = 0.0,
    frame: Frame | None = None,
    source: str = "",
) -> Geometry:
    """Places of transmitter and receivers for each ping, and the receivers' velocity until echoes come.

    Parameters
    ----------
    poses : Poses
    ping_time : (ping,)
        Leading edge of each pulse, s, increasing.
    tx : (3,)
        Transmitter from the poses' reference point: forward, starboard, down, m.
    rx : (channel, 3) or (3,)
        Receivers likewise.
    pulse_centre : float
        From the leading edge to the pulse's centre, s: what the function of that name tells. 0 where `ping_time` is the pulse's
        centre; then `t0` of Echoes is from the pulse's leading edge all the same.
    travel_time : (first, last)
        Two-way travel times that the record covers, s, 0 <= first < last: t0 and t0 + (n - 1)/fs.
    clock_offset : float
        Added to `ping_time` it gives the navigation's clock, s.
    frame : Frame, optional
        That of the result. Default: x along the mean track of these pings, `along_track`.
    source : str
        Name of the pings' file, for messages.

    Returns
    -------
    Geometry

    Raises
    ------
    ValueError, TypeError
        An argument of the wrong shape, dtype or size; times that repeat or run backwards; a ping that navigation does not
        cover until its record ends, or in a gap longer than `poses.max_gap`. Names file, ping and row.

    Notes
    -----
    A receiver's path is taken for straight between transmission and the instant t* when it hears what is far away:
    velocity = (its place at t* - its place at 0)/t*, so that its acceleration a leaves an error of a t (t - t*)/2 at travel
    time t. With n = max(first, 0.414 last), t* = (last^2 + n^2)/(last + n) makes the largest such error of the record as
    small as it can be, a last n (last - n)/(2 (last + n)) <= 0.086 a last^2: 0.2 mm for 0.1 m/s^2 and 0.15 s.
    `receiver_error` tells what the poses themselves say.

    O(samples + ping channel) time and memory.
    """
    if not isinstance(poses, Poses):
        raise TypeError(f"poses={type(poses).__name__}: expected pysas.navigation.Poses")
    name = named(source, "ping_time")
    when = times(name, ping_time, "ping")
    if when.size == 0:
        raise ValueError(f"{name}: no pings: expected at least one")
    arm_out, arm_in = _arms("tx", tx, [(3,)]), _arms("rx", rx, [(3,), ("channel", 3)])
    centre = _checks.number("pulse_centre", pulse_centre, low=0.0, high=10.0)
    first, last = (float(t) for t in _checks.reals("travel_time", travel_time, [(2,)]))
    if not 0 <= first < last:
        raise ValueError(f"travel_time=({first:g}, {last:g}): expected 0 <= first < last, s")
    when = when + _checks.number("clock_offset", clock_offset)
    start = when + centre

    def told(ping: int) -> str:
        return f"{name}: ping {ping} at {when[ping]:.6f} s on navigation's clock with {centre + last:.4g} s of pulse and echoes"

    poses.require(start, start + last, told)
    near = max(first, _NEAR_SHARE * last)
    met = (last**2 + near**2) / (last + near)
    ages = np.concatenate([[0.0, met], np.linspace(first, last, _LOOKS)])
    position, attitude = poses._evaluate((start + ages[:, None]).ravel())
    if frame is None:
        frame = along_track(position[: when.size], poses.frame)
    elif not isinstance(frame, Frame):
        raise TypeError(f"frame={type(frame).__name__}: expected a pysas.navigation.Frame or None")
    turn, shift = poses.frame.into(frame)
    position = position @ turn.T + shift
    attitude = Rotation.from_matrix(turn) * attitude

    def placed(age: int, arms: FloatArray) -> FloatArray:
        """Places of (..., 3) arms at one age of the pings."""
        rows = slice(age * when.size, (age + 1) * when.size)
        moved = np.einsum("pij,...j->p...i", attitude[rows].as_matrix(), arms)
        return np.asarray(moved + position[rows].reshape(-1, *(1,) * (arms.ndim - 1), 3))

    begun = placed(0, arm_in)
    velocity = (placed(1, arm_in) - begun) / met
    off = max(float(np.abs(placed(i, arm_in) - begun - velocity * ages[i]).max()) for i in range(2, ages.size))
    return Geometry(frame, when, centre, placed(0, arm_out), begun, velocity, attitude[: when.size], off)


def _arms(name: str, value: npt.ArrayLike, shapes: list[tuple[int | str, ...]]) -> FloatArray:
    arms = column(name, value, shapes, "channel")
    if arms.size == 0:
        raise ValueError(f"{name}: no channels: expected at least one")
    longest = float(np.abs(arms).max())
    if longest > _LONGEST_ARM:
        raise ValueError(f"{name}: {longest:g} m: expected a lever arm below {_LONGEST_ARM:g} m (forward, starboard, down)")
    return arms
