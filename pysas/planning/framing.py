"""A sensible grid from the geometry alone, for users who have not chosen one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.pulse import LFM

MOST = 50_000_000  # pixels, unless more are allowed: 0.4 GB in complex64
SIDES = ("port", "starboard", "both")
_LEGS = 64  # of a track, about, whose directions are averaged: places from ping to ping may jitter
_ALONG = np.radians(1.0)  # tracks within this of the x axis keep the coordinates' axes


@dataclass(frozen=True)
class Course:
    """Where a survey was sailed, seen from above.

    Attributes
    ----------
    origin, rotation : (2,) m, and rad
        Axes along it, as a `Grid` has them; 0 for a track within a degree of the x axis.
    places : (ping, 2)
        Mean phase centre of each ping on these axes, m.
    height : float
        Median z of the phase centres, m.
    closed : bool
        Whether it goes round what it looks at.
    bent : float
        How far it leaves a straight line, rms, m.
    sailed : float
        1, or -1 for a track near the x axis that was sailed towards -x.
    """

    origin: FloatArray
    rotation: float
    places: FloatArray
    height: float
    closed: bool
    bent: float
    sailed: float = 1.0

    @property
    def extents(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest place, m."""
        return self.places.min(axis=0), self.places.max(axis=0)


def course_of(echoes: Echoes) -> Course:
    """The track of echoes, on the axes of its lines: their mean direction, whichever way each was sailed."""
    centres = (echoes.tx + echoes.receivers.mean(axis=1)) / 2
    flat, height = centres[:, :2], float(np.round(np.median(centres[:, 2]), 3))
    inward = flat.mean(axis=0) - flat
    bent = float(np.linalg.norm(np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1:])) / len(centres) ** 0.5
    closed = _encloses(flat, flat.mean(axis=0))
    if closed and echoes.beam is not None:  # a loop that looks outwards is a line
        closed = float(np.mean(np.sum(echoes.beam.boresights[:, :2] * inward, axis=1))) > 0
    steps = np.diff(flat[:: max(1, len(flat) // _LEGS)], axis=0) @ [1, 1j]
    twice = np.sum(np.divide(steps**2, np.abs(steps), out=np.zeros_like(steps), where=steps != 0))  # to and fro count alike
    angle = 0.0 if closed or abs(twice) == 0 else float(np.angle(twice)) / 2
    if np.sum(steps * np.exp(-1j * angle)).real < 0 or angle == -np.pi / 2:
        angle += np.pi
    if abs(np.sin(angle)) < np.sin(_ALONG):
        return Course(np.zeros(2), 0.0, flat, height, closed, bent, float(np.sign(np.cos(angle))))
    angle = float(np.angle(np.exp(1j * angle)))
    origin = np.round(flat[0])
    axes = Grid.plane([0.0], [0.0], origin=origin, rotation=angle)
    return Course(origin, angle, axes.along_axes(flat), height, closed, bent)


def laid_along_x(echoes: Echoes) -> tuple[Echoes, Course]:
    """Echoes with all places and directions on the axes of their track, and where these were."""
    track = course_of(echoes)
    return laid_on(echoes, track.origin, track.rotation), track


def laid_on(echoes: Echoes, origin: FloatArray, rotation: float) -> Echoes:
    """Echoes with places and directions on axes at `origin`, turned by `rotation` from x towards y, as a `Grid` has them."""
    if not rotation and not np.any(origin):
        return echoes
    cos, sin = np.cos(rotation), np.sin(rotation)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])  # of rows, from the coordinates' axes
    zero = np.append(origin, 0)
    changes: dict[str, Any] = {name: (getattr(echoes, name) - zero) @ turn for name in ("tx", "rx")}
    if echoes.velocity is not None:
        changes["velocity"] = echoes.velocity @ turn
    if echoes.beam is not None:
        axis = None if echoes.beam.axis is None else echoes.beam.axis @ turn
        changes["beam"] = replace(echoes.beam, boresight=echoes.beam.boresight @ turn, axis=axis)
    return echoes.replace(**changes)


def assumed_height(echoes: Echoes, altitude: float | None = None) -> tuple[float, str]:
    """z of the seabed, m, `altitude` below the sonar, or else what is assumed of it; and why, in words.

    Without an `altitude`, here or among the attrs of the echoes, it is the sonar's own height: there is no telling where the
    seabed is, and a straight track focuses all of it there, at its slant ranges (see `height_matters`). Down is where beams
    look; without beams, or where they look neither up nor down, z is taken to point up.
    """
    given, area = "given", scene_area(echoes)
    if altitude is None and area is not None:
        return area[2], f"z = {area[2]:.10g} m, of the file's scene"
    if altitude is None and "altitude" in echoes.attrs:
        altitude, given = echoes.attrs["altitude"], "of the file's attrs"
    track = course_of(echoes)
    sonar = track.height
    if altitude is None:
        sharp = "across-track places are slant ranges there, and all is sharp as the track is straight"
        if track.closed:
            sharp = "round a closed track what lies elsewhere is not sharp"
        elif height_matters(echoes):
            off = f"{100 * track.bent:.2g} cm rms, {track.bent * echoes.fc / echoes.mean_speed:.2g} wavelengths"
            sharp = f"the track leaves a straight line by {off}, so that what lies elsewhere is not sharp"
        why = f"z = {sonar:.10g} m assumed, the sonar's own: nothing says where the seabed is (--z, --altitude, --depth-map)"
        return sonar, f"{why}; {sharp}"
    altitude = _checks.number("altitude", altitude, positive=True)
    down = _down(echoes)
    z = sonar + (down or -1.0) * altitude
    why = f"z = {z:.10g} m: altitude {altitude:g} m, {given}, from the sonar's z = {sonar:.10g} m"
    return z, why if down else why + ", z taken to point up (--z where it does not)"


def scene_area(echoes: Echoes) -> tuple[FloatArray, FloatArray, float] | None:
    """Corners (2,) and height, m, of the scene that a file was recorded for, by its attrs["scene_area"], or None.

    ValueError where that is no {"x": [low, high], "y": [low, high], "z": height}.
    """
    area = echoes.attrs.get("scene_area")
    if area is None:
        return None
    expected = 'attrs["scene_area"]: expected {"x": [low, high], "y": [low, high], "z": height}'
    if not isinstance(area, Mapping) or not {"x", "y", "z"} <= set(area):
        raise ValueError(expected)
    spans = np.stack([_checks.reals(f'attrs["scene_area"][{name!r}]', area[name], [(2,)]) for name in "xy"])
    if not np.all(spans[:, 1] > spans[:, 0]):
        raise ValueError(f"{expected}, found {spans.tolist()}")
    return spans[:, 0], spans[:, 1], _checks.number('attrs["scene_area"]["z"]', area["z"])


def height_matters(echoes: Echoes) -> bool:
    """Whether an image at the wrong height is not sharp: the track is closed, or leaves a line by an eighth of a wavelength."""
    track = course_of(echoes)
    return track.closed or track.bent > echoes.mean_speed / echoes.fc / 8


def _down(echoes: Echoes) -> float:
    """Sign of z downwards, by where beams look, or of a frame of `pysas.navigation`, where z is depth; 0: nothing tells."""
    look = 0.0 if echoes.beam is None else float(np.mean(echoes.beam.boresights[:, 2]))
    if abs(look) > 0.01:
        return float(np.sign(look))
    return 1.0 if isinstance(echoes.attrs.get("frame"), Mapping) else 0.0


def along_track_resolution(echoes: Echoes) -> float:
    """-3 dB width along the track, m, at the middle of the record: 0.886 c/(4 f sin theta), with theta as in `default_grid`."""
    return 0.886 * echoes.mean_speed / (4 * echoes.fc * max(_sine(echoes, course_of(echoes)), 1e-6))


def _sine(echoes: Echoes, track: Course) -> float:
    """Of the half-angle that the track subtends at mid range, or of the beam's first null."""
    low, high = track.extents
    if track.closed:
        return 1.0
    sine = float(np.sin(np.arctan2((high[0] - low[0]) / 2, sum(echoes.swath) / 2)))
    return sine if echoes.beam is None else min(sine, echoes.mean_speed / echoes.fc / echoes.beam.length)


def default_grid(
    echoes: Echoes,
    z: float,
    spacing: tuple[float, float] | None = None,
    side: str | None = None,
    large: bool = False,
) -> tuple[Grid, str]:
    """A plane at height `z` over the whole survey, and one line that says how it was chosen.

    A track that closes round what it looks at gets a square about its middle that every ping's record covers. Any other gets
    the rectangle beside it, along the mean direction of its lines: x over all of the track (with a quarter of its length to
    spare at each end when the track is short against the range), y over the ranges recorded on the `side` asked for, or where
    the beam's boresight looks, or else towards +y. Raw records lose half the pulse's length at the far end. Echoes of a file
    that says for which scene they were recorded (`scene_area`) get that.

    `spacing` (m, along and across) defaults, along each axis, to 0.8 of the image's Nyquist spacing: with the highest
    frequency f and theta the half-angle the track subtends at mid range (at most the beam's first null), the image's
    bandwidth is 4 f sin(theta)/c along-track and 2 B/c + 2 f (1 - cos(theta))/c across; a closed track has 4 f/c in both.

    Raises
    ------
    ValueError
        More than 50 million pixels, unless `large`; says how many. A plane beyond the record.
    """
    z = _checks.number("z", z)
    track = course_of(echoes)
    c = echoes.mean_speed
    finest = c / (2 * (echoes.fc + echoes.occupied_bandwidth / 2))
    area = scene_area(echoes)
    if area is not None:
        if side is not None:
            raise ValueError(f"side={side!r}: the file says which scene it was recorded for: expected None")
        low, high = area[:2]
        steps = (min(_spacing(echoes, track)),) * 2
        track = replace(track, origin=np.zeros(2), rotation=0.0)  # the area lies on the coordinates' axes
        how = "the file's scene"
    elif track.closed:
        ground = _recorded(echoes, track, z)
        middle = track.places.mean(axis=0)
        radius = float(np.median(np.linalg.norm(track.places - middle, axis=1)))
        half = max(min(ground[1] - radius, radius - ground[0], radius) / np.sqrt(2), finest)
        low, high = middle - half, middle + half
        steps = (_round(0.4 * finest),) * 2
        how = "square inside a closed track"
    else:
        low, high, how = _beside(echoes, track, _recorded(echoes, track, z), z, side)
        steps = _spacing(echoes, track)
    if spacing is not None:
        steps = (_checks.number("spacing", spacing[0], positive=True), _checks.number("spacing", spacing[1], positive=True))
    counts = [max(int(np.ceil((b - a) / step)), 1) for a, b, step in zip(low, high, steps, strict=True)]
    how += f", every {steps[0]:g} m along x and {steps[1]:g} m along y"
    pixels = counts[0] * counts[1]
    if pixels > MOST and not large:
        raise ValueError(
            f"the whole survey, {how}, has {counts[0]} x {counts[1]} = {pixels:.3g} pixels, "
            f"{pixels * echoes.dtype.itemsize / 1e9:.3g} GB: expected at most {MOST:.2g}: a larger --spacing, --x and --y, or "
            "--large to allow it"
        )
    x, y = (span(float(a), float(b), step) for a, b, step in zip(low, high, steps, strict=True))
    return Grid.plane(x, y, z, origin=track.origin, rotation=track.rotation), how


def _spacing(echoes: Echoes, track: Course) -> tuple[float, float]:
    """0.8 of the image's Nyquist spacing beside a track that is not closed, m along it and across."""
    c = echoes.mean_speed
    finest = c / (2 * (echoes.fc + echoes.occupied_bandwidth / 2))
    sine = _sine(echoes, track)
    across = 2 * echoes.occupied_bandwidth / c + (1 - np.sqrt(max(1 - sine**2, 0.0))) / finest
    return _round(0.8 * min(finest / (2 * max(sine, 1e-6)), 1 / across)), _round(0.8 / across)


def _recorded(echoes: Echoes, track: Course, z: float) -> tuple[float, float]:
    """Least and largest distance from the track at height `z` that records cover, m; raw ones but for half a pulse."""
    drop = abs(track.height - z)
    record = (echoes.n_sample - 1) / echoes.fs
    if not echoes.compressed and echoes.pulse is not None:
        pulse = echoes.pulse
        record -= (pulse.duration if isinstance(pulse, LFM) else (pulse.size - 1) / echoes.fs) / 2
    c = echoes.mean_speed
    near = max(c / 2 * float(echoes.start_time.max()), 0.0)
    far = c / 2 * (float(echoes.start_time.min()) + record)
    if far <= drop:
        raise ValueError(f"z={z:g}: {drop:.4g} m from the track, beyond the record's {far:.4g} m: choose another --z or a grid")
    return float(np.sqrt(max(near**2 - drop**2, 0.0))), float(np.sqrt(far**2 - drop**2))


def _beside(
    echoes: Echoes, track: Course, ground: tuple[float, float], z: float, side: str | None
) -> tuple[FloatArray, FloatArray, str]:
    """Corners of the rectangle beside a track, on its axes, and how it was chosen."""
    (left, bottom), (right, top) = track.extents
    near, far = _inside(ground)
    length = right - left
    spare = max(0.25 * length, 1.0) if length < 0.5 * near else 0.0
    sign, why = _side(echoes, track, z, side)
    low = bottom + near if sign > 0 else bottom - far
    high = top - near if sign < 0 else top + far
    where = f"the {'+' if sign > 0 else '-'}y side" if sign else "both sides"
    how = f"rectangle on {where} of the track ({why})"
    if track.rotation:
        x, y = track.origin
        how += f", axes from ({x:.10g}, {y:.10g}) m along it, {np.degrees(track.rotation):.3f} deg from x towards y"
    return np.array([left - spare, low]), np.array([right + spare, high]), how


def _inside(ground: tuple[float, float]) -> tuple[float, float]:
    """Distances from the track that are safe within those that records cover."""
    near, far = ground
    spare = 0.02 * (far - near)
    return near + spare if near else 0.1 * far, far - spare


def swath_beside(
    echoes: Echoes, track: Course, z: float, side: str | None = None
) -> tuple[list[tuple[str, int]], tuple[float, float], tuple[float, float]]:
    """Where `default_grid` looks beside a track: sides by name and sign of y, distances from the track, pixels' spacing, m."""
    sign, _ = _side(echoes, track, z, side)
    port = _port(echoes, track, z)
    sides = [("port" if one == port else "starboard", one) for one in ([sign] if sign else [-1, 1])]
    return sides, _inside(_recorded(echoes, track, z)), _spacing(echoes, track)


def _port(echoes: Echoes, track: Course, z: float) -> int:
    """Sign of y on the port side: the sonar is above the seabed."""
    return int((np.sign(track.height - z) or -_down(echoes) or 1.0) * track.sailed)


def _side(echoes: Echoes, track: Course, z: float, side: str | None) -> tuple[int, str]:
    """+1 or -1 for one side of a track's axes, 0 for both, and what decided."""
    if side is not None:
        _checks.choice("side", side, SIDES)
        port = _port(echoes, track, z)
        return {"port": port, "starboard": -port, "both": 0}[side], f"--side {side}"
    if echoes.beam is None:
        return 1, "no beam or --side tells which"
    across = echoes.beam.boresights[:, :2] @ [-np.sin(track.rotation), np.cos(track.rotation)]
    share = float(np.mean(across > 0))
    return (1 if share > 0.9 else -1 if share < 0.1 else 0), "where the beam looks"


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
    """Whether a track turns at least three quarters of something like a circle about `middle`."""
    if len(track) < 8:
        return False
    away = track - middle
    angle, radius = np.unwrap(np.arctan2(away[:, 1], away[:, 0])), np.linalg.norm(away, axis=1)
    return bool(abs(angle[-1] - angle[0]) > 1.5 * np.pi and radius.min() > 0.75 * radius.max())
