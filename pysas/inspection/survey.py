"""Positions that cannot be metres, phase centres that fall in clumps, and pulses that last while the sonar moves."""

from __future__ import annotations

import numpy as np

from pysas._checks import FloatArray
from pysas.inspection.finding import Finding
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

_CROWDED = 50  # pings to a wavelength; a sonar that moves leaves a few, a survey in km or kHz hundreds
_GHOST = -33.0  # dB
_SHIFT = 0.45  # of a cell of range; exact echoes of a moving sonar lose 7 % of their peak at 0.53, a third at 1.3


def units(echoes: Echoes) -> Finding:
    """Degrees or kilometres taken for metres, and coordinates of which digits are missing."""
    wavelength = float(np.mean(echoes.c)) / echoes.fc
    flat = echoes.tx[:, :2]
    steps = np.linalg.norm(np.diff(flat, axis=0), axis=1)
    usual = float(np.median(steps)) if steps.size else 0.0
    extent = float(np.linalg.norm(np.ptp(flat, axis=0)))
    globe = bool(np.all(np.abs(flat) <= 180) and np.any(np.all(np.abs(flat) <= 90, axis=0)) and np.all(flat != 0))
    if globe and 0 < extent and usual < wavelength / 1000 and echoes.n_ping > 1:
        text = f"the track is {extent:.2g} m long at {flat[0, 0]:.4f}, {flat[0, 1]:.4f}, {usual:.2g} m a ping"
        return Finding("units", "FAIL", f"{text}: degrees of latitude and longitude taken for metres: project them first")
    if 0 < usual < wavelength / _CROWDED:
        text = f"pings are {usual:.2g} m apart, {wavelength / usual:.0f} to a wavelength of {wavelength:.2g} m"
        return Finding("units", "warn", f"{text}: kilometres taken for metres, or kHz for Hz?")
    step, coarse = _quantum(echoes.tx)
    if step > wavelength / 16:
        single = " (float32 holds no more)" if coarse else ""
        text = f"positions are multiples of {step:.3g} m{single}, a wavelength is {wavelength:.3g} m"
        return Finding("units", "FAIL", f"{text}: keep them in float64, and interpolate coarse navigation")
    return Finding("units", "ok", f"the track is {extent:.4g} m long")


def _quantum(places: FloatArray) -> tuple[float, bool]:
    """The largest step of which all of an axis are multiples, though they are not even, or 0; and whether that is float32's."""
    most, coarse = 0.0, False
    for axis in places.T:
        bends = np.abs(np.diff(axis, 2))
        if bends.size < 8 or not np.any(bends > 0):
            continue
        off = np.abs(axis - axis[0])
        single = float(np.spacing(np.float32(np.abs(axis).max())))
        for step in [single, *(m * 10.0**e for e in range(1, -5, -1) for m in (5.0, 2.0, 1.0))]:
            noise = 1e-6 * step + 4 * float(np.spacing(np.abs(axis).max()))
            if noise > step / 8:
                continue
            rest = np.abs(off - step * np.round(off / step))
            # rounding shows in uneven steps: those of an even track are even
            uneven = np.count_nonzero(bends > step / 2)
            if rest.max() <= noise and uneven > max(4, 0.05 * bends.size):
                most, coarse = max((most, coarse), (step, step == single))
                break
    return most, coarse


def evenness(echoes: Echoes) -> Finding:
    """Phase centres in clumps: ghosts along the track, where the array's pattern repeats from ping to ping."""
    if echoes.n_channel < 2 or echoes.n_ping < 8:
        return Finding("phase centres", "ok", f"{echoes.n_channel} a ping")
    centres = (echoes.tx[:, None] + echoes.receivers) / 2
    mean = centres.mean(axis=1)
    along = np.gradient(mean, axis=0)
    pace = np.linalg.norm(along, axis=1)
    good = pace > 0
    if np.count_nonzero(good) < 8:
        return Finding("phase centres", "ok", "the sonar does not move")
    unit = np.divide(along, pace[:, None], out=np.zeros_like(along), where=good[:, None])
    offset = np.median(np.einsum("pcx,px->pc", centres - mean[:, None], unit)[good], axis=0)
    advance = float(np.median(pace[good]))
    # orders that an even array of as many centres would not have
    wavelength = float(np.mean(echoes.c)) / echoes.fc
    element = 2 * advance / offset.size if echoes.beam is None else echoes.beam.length
    level, order = _ghost(offset, advance, element)
    length = float(np.ptp(offset))
    if length < 0.01 * advance:
        return Finding("phase centres", "ok", "all receivers of a ping at one place")
    if level > _GHOST:
        degrees = np.degrees(np.arcsin(min(1.0, order * wavelength / (2 * advance))))
        text = f"the array's {length:.3g} m of phase centres overlap or miss those of the next ping {advance:.3g} m on"
        text += f": ghosts of {level:.0f} dB of each point's energy {degrees:.2g} deg aside"
        return Finding("phase centres", "warn", f"{text}: weights='uniform-angle' evens them out, or weights of their gaps")
    return Finding("phase centres", "ok", f"{echoes.n_channel} a ping, evenly spread")


def _ghost(offset: FloatArray, advance: float, element: float) -> tuple[float, int]:
    """Energy (dB of a point's) and order of the strongest line among those that as many even phase centres would cancel.

    A line of order m images a point m wavelength/(2 advance) aside in the sine, where an element lights it by sinc^2 both ways;
    its length is twice the spacing of even phase centres unless a beam is given.
    """
    orders = np.arange(1, offset.size)
    lines = np.abs(np.mean(np.exp(2j * np.pi * orders[:, None] * offset / advance), axis=1))
    lines *= np.sinc(orders * element / (2 * advance)) ** 2
    best = int(np.argmax(lines))
    return float(20 * np.log10(max(lines[best], 1e-15))), int(orders[best])


def doppler(echoes: Echoes) -> Finding:
    """How far an echo's frequency shifts over a pulse that lasts while the sonar moves, against the cells of range it moves by.

    The chirp reads a shift f_D as a delay of f_D/K, that is f_D T in cells of range; f_D = 2 v sin(angle)/wavelength.
    """
    pulse = echoes.pulse
    if pulse is None or echoes.n_ping < 2:
        return Finding("Doppler", "ok", "no pulse given" if pulse is None else "one ping")
    speed = _speed(echoes)
    if speed is None:
        return Finding("Doppler", "ok", "no velocity and no ping times: speed unknown")
    seconds = pulse.duration if isinstance(pulse, LFM) else pulse.size / echoes.fs
    c = float(np.mean(echoes.c))
    aside = _aside(echoes)
    cells = 2 * speed * seconds * np.sin(aside) * echoes.fc / c
    text = f"{speed:.3g} m/s for a pulse of {seconds:.3g} s is {1e3 * speed * seconds:.2g} mm"
    text += f": echoes {np.degrees(aside):.2g} deg off broadside shift by {cells:.2g} cells of range"
    if cells > _SHIFT:
        return Finding("Doppler", "warn", f"{text}: shorten the pulse, or compress with replicas shifted as each angle is")
    return Finding("Doppler", "ok", text)


def _speed(echoes: Echoes) -> float | None:
    if echoes.velocity is not None:
        return float(np.median(np.linalg.norm(echoes.velocity, axis=-1)))
    if echoes.ping_time is None:
        return None
    seconds = np.diff(echoes.ping_time)
    good = seconds > 0
    if not good.any():
        return None
    return float(np.median(np.linalg.norm(np.diff(echoes.tx, axis=0), axis=1)[good] / seconds[good]))


def _aside(echoes: Echoes) -> float:
    """Angle off broadside within which echoes come, either side of their middle: the beam's, or those of one place; rad.

    The place is the middle of the swath, broadside of the middle ping, on the side of a bent track which sees it straighter.
    """
    middle = echoes.n_ping // 2
    along = np.gradient(echoes.tx, axis=0)[:, :2]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    aside = np.array([-along[middle, 1], along[middle, 0]])
    angles = []
    for side in (-1, 1):
        look = echoes.tx[middle, :2] + side * np.mean(echoes.swath) * aside - echoes.tx[:, :2]
        away = np.sum(look * along, axis=1) / np.maximum(np.linalg.norm(look, axis=1), 1e-300)
        angles.append(float(np.arcsin(min(np.ptp(away) / 2, 1.0))))
    return min(angles) if echoes.beam is None else min(*angles, echoes.beam.half_angle)
