"""The sea for an example of a survey: what a synthetic aperture sonar hears on two lines over one wreck.

    python examples/survey/scene.py --out FOLDER [--length 300]

The bed lies 30 m deep in the German Bight. It is rough, in places brighter than in others, and where it is sand it has
ripples of a wavelength of 1 m and up to 6 cm from trough to crest. A wreck of 18 m lies on it, with frames, a break
amidships and a deckhouse that is its highest part, and eight small targets whose places are known.

A vehicle goes past at 8 m above the bed, first along heading 62 degrees, then back along 242 degrees on a line 40 m to
starboard, and looks to starboard each time: the lines see 24 m of ground in common, from opposite sides, and each what lies
below the other. It sways and heaves by a few centimetres and yaws by some milliradians. Its sonar works at 40 kHz with 8 kHz
of band; its transmitter's fan reaches 7.5 degrees to either side, its eight receivers are 15 cm apart. An image resolves 9 cm
along the track and 14 cm across, at ground ranges of 8 to 45 m.

Echoes fall with the cosine between a facet and the way to the sonar (Lambert's law) and not with range, for which the gain
over time has made up. So an even bed is even in an image, as the aperture grows with range, and ripples show by their slopes:
those that are bright from one line are dark from the other. Targets return alike to all sides. What stands behind the wreck,
as seen from where the sonar is, is left out: each line has shadows of its own, and sees the side of the wreck that faces it.
Noise is 20 dB below the bed.

Line by line and a few pings at a time, raw echoes are simulated from those scatterers that they can reach, compressed, and
appended to FOLDER/line1.zarr and line2.zarr, as int16. Both are in one frame: x north, y east, z down, in metres about a
latitude and longitude, which attrs["frame"] states. FOLDER/truth.json says where the targets and the wreck are in that frame,
on WGS84 and in UTM, and which of the lines see a target with their whole aperture.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import pysas

C, FC, BAND, FS, PULSE = 1500.0, 40e3, 8e3, 10e3, 1e-3
RECEIVERS, SPACING, ELEMENT, SPEED = 8, 0.15, 0.16, 2.0  # m: from receiver to receiver, transmitter; m/s
HALF_ANGLE, DEPRESSION = np.deg2rad(7.5), np.deg2rad(20.0)
ADVANCE, BLOCK = RECEIVERS * SPACING / 2, 4  # m a ping; pings simulated at a time
DEPTH, ALTITUDE, NEAR, FAR = 30.0, 8.0, 8.0, 45.0  # m; ground ranges
DENSITY, NOISE_DB, RAY = 110.0, -20.0, 40  # scatterers on 1 m2; below the bed; samples of a ray over the wreck

FRAME = pysas.navigation.Frame(lat=54.2, lon=7.9)
UTM_ZONE = 32
LINES = [pysas.navigation.Frame(np.deg2rad(heading), FRAME.lat, FRAME.lon) for heading in (62.0, 242.0)]
AREA = LINES[0]  # in whose x and y the scene is told
OFFSET = -20.0  # y of a line in its own frame

WRECK, WRECK_TURN = np.array([2.0, 1.0]), np.deg2rad(24.0)  # middle; bow from x towards y
HALF_LENGTH, HALF_BEAM, HIGHEST, FRAMES = 9.0, 2.3, 2.6, 1.2  # m; of the deckhouse; from frame to frame
TARGETS = np.array([  # share of half the line's length, and y
    (-0.80, -4.0), (-0.66, 9.5), (-0.55, 19.0), (-0.40, -7.5), (0.42, 6.0), (0.55, -18.0), (0.68, 1.5), (0.80, -9.0),
])  # fmt: skip
TARGET = 8.0  # amplitude, where the mean square of a facet that faces the sonar is 1


def sand(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How much of the bed is rippled sand, 0 to 1."""
    waves = np.sin(2 * np.pi * (x + 9 * np.sin(2 * np.pi * y / 61)) / 73 - 0.9) + 0.8 * np.sin(2 * np.pi * (y - 0.3 * x) / 52)
    return 0.5 + 0.5 * np.tanh(3 * waves)


def ripples(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Their height, m: crests 25 degrees off the lines, which wander."""
    across = 0.42 * x + 0.91 * y + 0.35 * np.sin(2 * np.pi * x / 13) + 0.25 * np.sin(2 * np.pi * (x + y) / 7.3)
    return (0.004 + 0.026 * sand(x, y)) * np.cos(2 * np.pi * across)


def aboard(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along the wreck and across it, m, from its middle."""
    cos, sin = np.cos(WRECK_TURN), np.sin(WRECK_TURN)
    return cos * (x - WRECK[0]) + sin * (y - WRECK[1]), cos * (y - WRECK[1]) - sin * (x - WRECK[0])


def hull(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Height of the wreck above the bed, m; 0 beside it. Its rails meet at bow and stern."""
    share = np.abs(along) / HALF_LENGTH
    inside = 1 - share * share * share
    side = np.square(across / HALF_BEAM) / np.maximum(inside, 1e-9)
    top = 1.3 + 0.8 * share * share - 0.7 * (np.abs(along - 1.9) < 0.8)
    house = (np.abs(along + 3.8) < 1.2) & (np.abs(across) < 1.2)
    return np.where((inside > 0) & (side < 1), np.where(house, HIGHEST, top * (1 - side * side * side)), 0.0)


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of wreck and bed, m."""
    steel = hull(*aboard(x, y))
    return np.where(steel > 0, steel, ripples(x, y))


@dataclasses.dataclass
class Scene:
    """Scatterers in the order of x, in AREA's axes: places, amplitudes, slopes of what they lie on, and which are targets."""

    places: np.ndarray
    strength: np.ndarray
    slopes: np.ndarray
    target: np.ndarray


def scene(length: float, targets: np.ndarray) -> Scene:
    """Bed, wreck and targets."""
    beyond = np.hypot(FAR, ALTITUDE) * np.tan(HALF_ANGLE + 0.02)
    places, strength = pysas.simulation.seabed(
        (-length / 2 - beyond, length / 2 + beyond), (-27.0, 27.0), DENSITY, DEPTH, roughness=0.01, seed=1
    )  # fmt: skip
    x, y = places[:, 0], places[:, 1]
    places[:, 2] -= height(x, y)
    step = 0.03
    slopes = [height(x + step, y) - height(x - step, y), height(x, y + step) - height(x, y - step)]
    along, across = aboard(x, y)
    frames = np.abs(along / FRAMES % 1 - 0.5) < 0.1
    strength *= np.where(hull(along, across) > 0, np.where(frames, 9.0, 2.0), 10 ** ((6 * sand(x, y) - 3) / 20))
    places, strength = np.concatenate([places, targets]), np.concatenate([strength, np.full(len(targets), TARGET)])
    order = np.argsort(places[:, 0])
    flat = np.concatenate([np.stack(slopes, axis=1) / (2 * step), np.zeros((len(targets), 2))])
    return Scene(places[order], strength[order], flat[order], order >= len(flat) - len(targets))


def shadowed(places: np.ndarray, sonar: np.ndarray) -> np.ndarray:
    """Whether the wreck stands between places and the sonar: rays are followed through the box that holds it."""
    start = np.stack(aboard(*places[:, :2].T))
    step = np.array(aboard(*sonar[:2]))[:, None] - start  # all the way to the sonar
    box = np.array([[HALF_LENGTH], [HALF_BEAM]])
    ends = np.sort([(-box - start) / step, (box - start) / step], axis=0)
    above = DEPTH - places[:, 2]
    rise = places[:, 2] - sonar[2]
    first = np.maximum(ends[0].max(axis=0), 0.0)
    last = np.minimum(ends[1].min(axis=0), (HIGHEST - above) / rise)
    near = np.flatnonzero(first < last)
    dark = np.zeros(len(places), dtype=bool)
    for share in (np.arange(RAY) + 0.5) / RAY:
        t = first[near] + share * (last - first)[near]
        hit = hull(*(start[:, near] + t * step[:, near])) > above[near] + t * rise[near] + 0.02  # m: not the facet itself
        dark[near[hit]] = True
        near = near[~hit]
    return dark


def heard(bed: Scene, line: int, length: float) -> Iterator[pysas.Echoes]:
    """Compressed echoes of a line, some pings at a time."""
    own = LINES[line]
    track = pysas.tracks.perturbed(
        round(length / ADVANCE), ADVANCE, DEPTH - ALTITUDE, SPEED, (-length / 2, OFFSET, 0.0),
        sway=0.03, heave=0.02, yaw=4e-3, correlation=8.0, seed=line,
    )  # fmt: skip
    zero, level, down = np.zeros(track.n_ping), np.cos(DEPRESSION), np.full(track.n_ping, np.sin(DEPRESSION))
    ahead, look = own.to_ned(np.stack([  # of a frame without an origin: it turns directions as well as places
        np.stack([np.cos(track.yaw), np.sin(track.yaw), zero], axis=1),
        np.stack([-level * np.sin(track.yaw), level * np.cos(track.yaw), down], axis=1),
    ]))  # fmt: skip
    tx, velocity = own.to_ned(track.position), own.to_ned(track.velocity)
    rx = own.to_ned(pysas.tracks.array(track, RECEIVERS, SPACING))
    nearest, farthest = np.hypot(NEAR, ALTITUDE), np.hypot(FAR, ALTITUDE) / np.cos(HALF_ANGLE)
    pulse = pysas.LFM(FC, BAND, PULSE)
    # what a ping hears of the bed at once, in the middle of the swath: half a pulse long, as wide as the beam
    middle = (NEAR + FAR) / 2
    lit = middle * 2 * 0.7 * HALF_ANGLE * C * PULSE / 2
    noise = 10 ** (NOISE_DB / 20) * ALTITUDE / middle * np.sqrt(DENSITY * lit / 2)  # in each of I and Q
    rng = np.random.default_rng(100 + line)
    for begin in range(0, track.n_ping, BLOCK):
        some = slice(begin, begin + BLOCK)
        sonar = AREA.from_ned(tx[some].mean(axis=0))
        low, high = np.searchsorted(bed.places[:, 0], sonar[0] + np.array([-1, 1]) * (farthest * np.tan(HALF_ANGLE) + 2))
        places, slopes = bed.places[low:high], bed.slopes[low:high]
        away = sonar - places
        slant = np.linalg.norm(away, axis=1)
        aside = np.abs(away[:, 0]) < slant * np.sin(HALF_ANGLE + 0.02) + ADVANCE * BLOCK / 2 + SPACING
        near = np.flatnonzero(aside & (slant > nearest - C * PULSE / 2 - 0.2) & (slant < farthest + 0.2))
        near = near[(AREA.to_ned(away[near]) @ look[some].mean(axis=0)) < 0]
        near = near[~shadowed(places[near], sonar)]
        up = -away[near, 2] - np.sum(slopes[near] * away[near, :2], axis=1)
        facing = up / (slant[near] * np.sqrt(1 + np.sum(slopes[near] ** 2, axis=1)))
        facing = np.where(bed.target[low:high][near], 1.0, np.maximum(facing, 0.0))
        raw = pysas.simulate(
            AREA.to_ned(places[near]), bed.strength[low:high][near] * facing, pulse,
            tx=tx[some], rx=rx[some], velocity=velocity[some], fs=FS, c=C, t0=2 * nearest / C,
            duration=2 * (farthest - nearest) / C + PULSE, ping_time=track.time[some] + 900.0 * line,
            beam=pysas.Beam(look[some], ELEMENT, HALF_ANGLE, taper=0.5, axis=ahead[some]),
            attrs={"title": f"line {line + 1} of a survey", "frame": dataclasses.asdict(FRAME), "altitude": ALTITUDE},
        )  # fmt: skip
        raw.data.view(np.float32)[...] += noise * rng.standard_normal((*raw.data.shape[:-1], 2 * raw.n_sample))
        yield pysas.compress(raw, "hann", inverse=0.02)


def told(places: np.ndarray) -> dict[str, list[float]]:
    """Places of FRAME, there, on WGS84 and in UTM."""
    lat, lon, depth = FRAME.to_geodetic(places)
    easting, northing = pysas.navigation.to_utm(lat, lon, UTM_ZONE)
    x, y, z = np.moveaxis(places, -1, 0)
    columns = {"x": x, "y": y, "z": z, "lat": lat, "lon": lon, "depth": depth, "easting": easting, "northing": northing}
    return {name: np.asarray(column).tolist() for name, column in columns.items()}


def truth(targets: np.ndarray, length: float) -> dict[str, object]:
    """What the scene holds, for truth.json: arrays have an entry a target."""
    places = AREA.to_ned(targets)
    seen = []
    for own in LINES:
        along, across, _ = own.from_ned(places).T
        whole = np.abs(along) < length / 2 - np.hypot(across - OFFSET, ALTITUDE) * np.tan(HALF_ANGLE)
        seen.append((whole & (across - OFFSET > NEAR) & (across - OFFSET < FAR)).tolist())
    wreck = told(AREA.to_ned(np.array([*WRECK, DEPTH])))
    bow = float(np.degrees(AREA.heading + WRECK_TURN))
    return {
        "frame": dataclasses.asdict(FRAME), "seabed_z": DEPTH, "utm_zone": UTM_ZONE, "headings_deg": [62.0, 242.0],
        "targets": told(places) | {"seen_by_line1": seen[0], "seen_by_line2": seen[1]},
        "wreck": wreck | {"length": 2 * HALF_LENGTH, "beam": 2 * HALF_BEAM, "height": HIGHEST, "heading_deg": bow},
    }  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Write both lines and what is true of them."""
    parser = argparse.ArgumentParser(description="Simulate the echoes of two lines of a survey over a wreck.")
    parser.add_argument("--out", type=Path, required=True, help="folder for line1.zarr, line2.zarr and truth.json")
    parser.add_argument("--length", type=float, default=300.0, help="of a line, m (%(default)g)")
    options = parser.parse_args(arguments)
    if not 50 <= options.length <= 1000:
        parser.error(f"--length {options.length:g}: expected 50 to 1000 m")
    options.out.mkdir(parents=True, exist_ok=True)
    targets = np.column_stack([TARGETS * [options.length / 2, 1], np.full(len(TARGETS), DEPTH)])
    (options.out / "truth.json").write_text(json.dumps(truth(targets, options.length), indent=1) + "\n")
    bed = scene(options.length, targets)
    # what folds lies outside the pulse's band, where compression takes it away
    warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
    for line in range(len(LINES)):
        clock, path = time.perf_counter(), options.out / f"line{line + 1}.zarr"
        with pysas.EchoWriter(path, int16=True, overwrite=True) as writer:
            for echoes in heard(bed, line, options.length):
                writer.append(echoes)
        print(f"{path}: {writer.n_ping} pings of {RECEIVERS} receivers in {time.perf_counter() - clock:.1f} s")


if __name__ == "__main__":
    main()
