"""What positions, sampling, beam and pulse say about themselves, without a look at the samples."""

from __future__ import annotations

import numpy as np

from pysas._checks import FloatArray
from pysas.inspection.finding import Finding
from pysas.model.beam import FAN, Beam
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

_AHEAD = 45.0  # degrees from broadside, beyond which a beam looks along the track


def times(echoes: Echoes) -> Finding:
    if echoes.ping_time is None:
        return Finding("ping times", "ok", "none given")
    steps = np.diff(echoes.ping_time)
    if np.any(steps <= 0):
        return Finding("ping times", "FAIL", f"not increasing first at ping {int(np.argmax(steps <= 0)) + 1}")
    return Finding("ping times", "ok", "increasing")


def range_sampling(echoes: Echoes) -> Finding:
    margin = echoes.fs / echoes.occupied_bandwidth
    text = f"fs is {margin:.4g} x the bandwidth"
    return Finding(
        "range sampling", "ok" if margin >= 1.1 - 1e-9 else "FAIL", text + ("" if margin >= 1.1 - 1e-9 else ", below 1.1")
    )


def along_track(echoes: Echoes) -> Finding:
    median, largest = echoes.phase_centre_spacing()
    text = f"phase centres every {median:.4g} m, largest gap {largest:.4g} m"
    if echoes.beam is None:
        return Finding("along-track sampling", "ok", text + _aliases(echoes, median))
    length = echoes.beam.length
    if median > length / 2 * (1 + 1e-9):
        return Finding("along-track sampling", "FAIL", text + f", above D/2 = {length / 2:.4g} m")
    if largest > length / 2 * (1 + 1e-9):
        return Finding("along-track sampling", "warn", text + f": gap above D/2 = {length / 2:.4g} m")
    if largest > length / 4 * (1 + 1e-9):
        return Finding("along-track sampling", "warn", text + f", above D/4 = {length / 4:.4g} m")
    return Finding("along-track sampling", "ok", text + f", within D/4 = {length / 4:.4g} m")


def _aliases(echoes: Echoes, gap: float) -> str:
    """From where on, off broadside, echoes alias that no beam keeps out: sine of a quarter of a wavelength to the gap."""
    sine = echoes.mean_speed / echoes.fc / 4 / gap if gap > 0 else 1.0
    return "; no beam given" + (
        f": what lies more than {np.degrees(np.arcsin(sine)):.3g} deg ahead or astern may alias" if sine < 1 else ""
    )


def beam(echoes: Echoes) -> Finding:
    """A beam that looks along the track, or turns within a ping by more than it is wide; where the seabed is nobody knows."""
    beam = echoes.beam
    if beam is None:
        return Finding("beam", "ok", "none given")
    text = beam.describe()
    if beam.shape == FAN:
        given = "level, across boresight" if beam.axis is None else "as given"
        text += f", axis {given}" + (f": {', '.join(f'{v:.3g}' for v in beam.axes[0])}" if len(beam.axes) == 1 else "")
    turned = _turned(beam)
    if np.any(turned > beam.half_angle):
        ping = int(np.argmax(turned > beam.half_angle))
        return Finding("beam", "warn", text + f"; turns by {np.degrees(turned[ping]):.3g} deg first before ping {ping + 1}")
    step = np.gradient(echoes.tx, axis=0) if echoes.n_ping > 1 else np.zeros((1, 3))
    length = np.linalg.norm(step, axis=1)
    if not np.any(length > 0):
        return Finding("beam", "ok", text)
    along = step / np.maximum(length, 1e-300)[:, None]
    ahead = np.abs(np.sum(along * (beam.axes if beam.shape == FAN else beam.boresights), axis=1))[length > 0]
    # of a fan's axis from the track, or of a cone's boresight from the plane across it
    angle = np.arccos(np.minimum(ahead, 1.0)) if beam.shape == FAN else np.arcsin(np.minimum(ahead, 1.0))
    off = float(np.degrees(np.median(angle)))
    if off > _AHEAD:
        return Finding("beam", "warn", text + f"; its middle lies {off:.3g} deg from broadside of the track: looks along it")
    return Finding("beam", "ok", text + f"; its middle lies {off:.2g} deg from broadside of the track")


def _turned(beam: Beam) -> FloatArray:
    """Angles by which a beam's middle turns from each ping to the next, rad; pi where a fan looks to the other side."""
    look = beam.boresights
    if beam.shape != FAN:
        return _between(look[:-1], look[1:])
    other = np.sum(look[:-1] * look[1:], axis=1) < 0
    turned = np.zeros(max(len(look), len(beam.axes)) - 1)
    if len(beam.axes) > 1:
        angle = _between(beam.axes[:-1], beam.axes[1:])
        turned[:] = np.minimum(angle, np.pi - angle)
    if len(look) > 1:
        turned[other] = np.pi
    return turned


def _between(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angles between vectors of length 1, rad."""
    return np.asarray(2 * np.arctan2(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1)))


def track(echoes: Echoes) -> Finding:
    """Jumps across the track, which no platform makes; repeats and gaps along it, which cost quality but not focus."""
    if echoes.n_ping < 4:
        return Finding("track", "ok", f"{echoes.n_ping} pings")
    steps = np.diff(echoes.tx, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    bends = np.diff(steps, axis=0)
    along = (steps[1:] + steps[:-1]) / np.maximum(np.linalg.norm(steps[1:] + steps[:-1], axis=1, keepdims=True), 1e-300)
    across = np.linalg.norm(bends - np.sum(bends * along, axis=1, keepdims=True) * along, axis=1)
    jump = _first_jump(across, echoes)
    if jump is not None:
        return Finding(
            "track", "FAIL", f"jump of {across[jump]:.4g} m first at ping {jump + 2}, usual {np.median(across):.2g} m"
        )
    if np.any(lengths == 0):
        return Finding("track", "warn", f"the transmitter does not move first at ping {int(np.argmax(lengths == 0)) + 1}")
    usual = float(np.median(lengths))
    if np.any(lengths > 1.5 * usual):
        gap = int(np.argmax(lengths > 1.5 * usual))
        return Finding("track", "warn", f"gap of {lengths[gap]:.4g} m first before ping {gap + 1}, usual step {usual:.4g} m")
    return Finding("track", "ok", f"{float(lengths.sum()):.4g} m, largest step {lengths.max():.4g} m")


def receivers(echoes: Echoes) -> Finding:
    """Jumps of a receiver against the transmitter: the array turns with the platform, smoothly."""
    if echoes.n_ping < 4:
        return Finding("receivers", "ok", f"{echoes.n_ping} pings")
    bends = np.linalg.norm(np.diff(echoes.receivers - echoes.tx[:, None], 2, axis=0), axis=-1)
    jump = _first_jump(bends.max(axis=1), echoes)
    if jump is not None:
        channel = int(np.argmax(bends[jump]))
        where = f"ping {jump + 2}, channel {channel}"
        return Finding("receivers", "FAIL", f"jump of {bends[jump, channel]:.4g} m against the transmitter first at {where}")
    return Finding("receivers", "ok", f"{echoes.n_channel} channels keep their places")


def _first_jump(bends: FloatArray, echoes: Echoes) -> int | None:
    """Index of the first second difference that is far above the usual one and above an eighth of a wavelength."""
    high = bends > max(10 * float(np.median(bends)), echoes.mean_speed / echoes.fc / 8)
    return int(np.argmax(high)) if high.any() else None


def pulse(echoes: Echoes) -> Finding:
    if echoes.pulse is None:
        state = "ok" if echoes.compressed else "warn"
        more = "" if echoes.compressed else ": compress(raw, pulse=...) needs it; sweep and conjugation are not looked at"
        return Finding("pulse", state, "none given" + more)
    seconds = echoes.pulse.duration if isinstance(echoes.pulse, LFM) else (echoes.pulse.size - 1) / echoes.fs
    record = (echoes.n_sample - 1) / echoes.fs
    if seconds > record and not echoes.compressed:
        return Finding("pulse", "FAIL", f"{seconds:.4g} s, longer than the record of {record:.4g} s")
    if isinstance(echoes.pulse, LFM) and not echoes.compressed:
        low, high = (echoes.pulse.fc - echoes.fc + sign * echoes.pulse.occupied_bandwidth / 2 for sign in (-1, 1))
        if max(-low, high) > echoes.fs / 2 * (1 + 1e-9):
            band = f"band {low:g} to {high:g} Hz about fc"
            return Finding("pulse", "FAIL", f"{band}, beyond what fs {echoes.fs:g} Hz holds: +-{echoes.fs / 2:g} Hz")
    return Finding("pulse", "ok", f"{seconds:.4g} s in a record of {record:.4g} s")
