"""A sensible grid from the geometry alone, for users who have not chosen one."""

from __future__ import annotations

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.pulse import LFM

_MOST = 4_000_000  # pixels


def default_grid(echoes: Echoes, z: float = 0.0, spacing: float | None = None) -> tuple[Grid, str]:
    """A plane at height `z` that the survey images well, and one line that says how it was chosen.

    A track that closes round its middle gets a square about it that every ping's record covers. Any other gets the
    rectangle beside it: x over the track (with a quarter of its length to spare at each end when the track is short
    against the range), y on the side of the beam's boresight (else +y) over the ranges recorded. Raw records lose half
    the pulse's length at the far end.

    `spacing` (m) defaults, along each axis, to 0.8 of the image's Nyquist spacing: with the highest frequency f and theta
    the half-angle the track subtends at mid range (at most the beam's first null), the image's bandwidth is 4 f
    sin(theta)/c along-track and 2 B/c + 2 f (1 - cos(theta))/c across; a closed track has 4 f/c in both. At most four
    million pixels: the rectangle shrinks about its middle.
    """
    z = _checks.number("z", z)
    if spacing is not None:
        spacing = _checks.number("spacing", spacing, positive=True)
    centres = (echoes.tx + echoes.receivers.mean(axis=1)) / 2
    middle = centres.mean(axis=0)
    drop = abs(float(np.median(centres[:, 2])) - z)
    record = (echoes.n_sample - 1) / echoes.fs
    if not echoes.compressed and echoes.pulse is not None:
        pulse = echoes.pulse
        record -= (pulse.duration if isinstance(pulse, LFM) else (pulse.size - 1) / echoes.fs) / 2
    c = echoes.mean_speed
    near = c / 2 * float(echoes.start_time.max())
    far = c / 2 * (float(echoes.start_time.min()) + record)
    if far <= drop:
        raise ValueError(f"z={z:g}: {drop:.4g} m from the track, beyond the record's {far:.4g} m: choose another --z or a grid")
    ground_near, ground_far = (float(np.sqrt(max(r**2 - drop**2, 0.0))) for r in (near, far))
    finest = c / (2 * (echoes.fc + echoes.occupied_bandwidth / 2))
    if _encloses(centres[:, :2], middle[:2]):
        radius = float(np.median(np.linalg.norm(centres[:, :2] - middle[:2], axis=1)))
        half = max(min(ground_far - radius, radius - ground_near, radius) / np.sqrt(2), finest)
        box = np.array([middle[0] - half, middle[0] + half, middle[1] - half, middle[1] + half])
        steps = np.full(2, _round(0.4 * finest))
        how = "square inside a closed track"
    else:
        low, high = float(centres[:, 0].min()), float(centres[:, 0].max())
        length = float(np.linalg.norm(centres.max(axis=0) - centres.min(axis=0)))
        near_edge = ground_near + 0.02 * (ground_far - ground_near) if ground_near else 0.1 * ground_far
        far_edge = ground_far - 0.02 * (ground_far - ground_near)
        spare = max(0.25 * length, 1.0) if length < 0.5 * near_edge else 0.0
        side, sine = 1.0, np.sin(np.arctan2(length / 2, (near + far) / 2))
        if echoes.beam is not None:
            side = float(np.sign(np.mean(np.atleast_2d(echoes.beam.boresight)[:, 1]))) or 1.0
            sine = min(sine, c / echoes.fc / echoes.beam.length)
        across = 2 * echoes.occupied_bandwidth / c + (1 - np.sqrt(1 - sine**2)) / finest
        steps = np.array([_round(0.8 * min(finest / (2 * max(sine, 1e-6)), 1 / across)), _round(0.8 / across)])
        y = middle[1] + side * np.array([near_edge, far_edge])
        box = np.array([low - spare, high + spare, y.min(), y.max()])
        how = f"rectangle on the {'+' if side > 0 else '-'}y side of the track"
    if spacing is not None:
        steps[:] = spacing
    pixels = (box[1] - box[0]) * (box[3] - box[2]) / (steps[0] * steps[1])
    if pixels > _MOST:
        share = np.sqrt(_MOST / pixels)
        for i in (0, 2):
            centre, half = (box[i] + box[i + 1]) / 2, (box[i + 1] - box[i]) / 2 * share
            box[i : i + 2] = centre - half, centre + half
        how += f", shrunk about its middle to {_MOST:.2g} pixels"
    grid = Grid.plane(span(box[0], box[1], float(steps[0])), span(box[2], box[3], float(steps[1])), z)
    return grid, f"{how}, z = {z:g} m, every {steps[0]:g} m along x and {steps[1]:g} m along y"


def span(low: float, high: float, step: float) -> FloatArray:
    """Multiples of `step` from `low` to `high`, at least one."""
    step = _checks.number("spacing", step, positive=True)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    if last < first:
        raise ValueError(f"spacing={step:g}: no multiple of it within {low:g} to {high:g} m: expected a smaller one")
    axis: FloatArray = np.asarray(np.arange(first, last + 1) * step, dtype=np.float64)
    return axis


def _round(value: float) -> float:
    """`value` rounded down to two significant digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(np.floor(value / unit + 1e-9) * unit)


def _encloses(track: FloatArray, middle: FloatArray) -> bool:
    """Whether a track turns at least three quarters of a circle about `middle`."""
    if len(track) < 8:
        return False
    angle = np.unwrap(np.arctan2(track[:, 1] - middle[1], track[:, 0] - middle[0]))
    return bool(abs(angle[-1] - angle[0]) > 1.5 * np.pi)
