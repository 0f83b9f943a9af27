"""Good surveys for `bench.mistakes`: points, speckle, both and rippled sand, of 1, 6 and 16 receivers, on lines and circles."""

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pysas

C, FC, FS = 1500.0, 100e3, 40e3
ELEMENT = 0.05  # m, of transmitter and receivers
PITCH = {1: 0.0, 6: 0.05, 16: 0.04}  # of receivers, m
FILES = ("stripmap_perturbed.npz", "circular.npz", "gotcha_phase_history.npz")


@dataclass(frozen=True)
class Scene:
    """What a survey is of.

    Attributes
    ----------
    path : "line", "sway" or "circle"
    receivers : int
    bed : "points", "speckle", "both" or "sand"
    snr : float
        dB of raw samples; compression gains 13 to 18.
    compressed : bool
        Which of the two forms is checked.
    near : float
        First slant range, m; the sonar is as low as a third of it.
    """

    path: str
    receivers: int
    bed: str
    snr: float
    compressed: bool
    near: float = 15.0

    @property
    def name(self):
        form = "compressed" if self.compressed else "raw"
        return f"{self.path}, {self.receivers} rx, {self.bed}, {self.snr:g} dB, {form}"


SCENES = (
    Scene("line", 1, "points", 20, False),
    Scene("line", 1, "speckle", 20, False),
    Scene("line", 1, "both", 10, True),
    Scene("line", 1, "sand", 15, False, 6.0),
    Scene("sway", 1, "points", 0, True),
    Scene("sway", 1, "both", 5, False),
    Scene("sway", 1, "sand", 10, True),
    Scene("circle", 1, "points", 10, False),
    Scene("circle", 1, "both", 20, True),
    Scene("line", 6, "points", 10, True),
    Scene("line", 6, "speckle", 20, False),
    Scene("sway", 6, "both", 5, False),
    Scene("sway", 6, "sand", 10, True, 6.0),
    Scene("circle", 6, "speckle", 20, False),
    Scene("circle", 6, "points", 0, True),
    Scene("line", 16, "points", -5, False),
    Scene("line", 16, "speckle", 10, True),
    Scene("sway", 16, "both", 10, False),
    Scene("line", 16, "sand", 0, True, 6.0),
    Scene("circle", 16, "both", 10, False),
)


def survey(scene, seed=0, *, advance=1.0, duration=None, speed=1.5):
    """Raw echoes; `advance` scales how far the sonar goes from ping to ping, m/s `speed` times and moves its receivers."""
    rng = np.random.default_rng([seed, SCENES.index(scene)])
    channels = scene.receivers
    band = float(rng.choice([20e3, 30e3]))
    duration = float(rng.choice([1e-3, 2e-3])) if duration is None else duration
    pulse = pysas.LFM(FC, band * rng.choice([-1, 1]), duration, str(rng.choice(["rect", "tukey"])))
    pings = {1: 96, 6: 64, 16: 48}[channels]
    step = advance * (0.025 if channels == 1 else channels * PITCH[channels] / 2)
    height = scene.near / 3
    more = {}
    if scene.path == "circle":
        pings *= 2
        track = pysas.tracks.circular(pings, 14.0, height=height, extent=pings * step / 14.0, speed=speed)
    elif scene.path == "sway":
        track = pysas.tracks.perturbed(
            pings, step, height=height, sway=0.1, heave=0.03, yaw=0.01, correlation=1.0, seed=seed, speed=speed
        )
        more = {"velocity": track.velocity}
    else:
        track = pysas.tracks.straight(pings, step, height=height, speed=speed)
    rx = pysas.tracks.array(track, channels, PITCH[channels]) if channels > 1 else track.position
    middle = track.position.mean(axis=0)
    points, amplitudes = bed(scene, rng, middle, float(np.ptp(track.position[:, 0])))
    more |= {"ping_time": np.arange(pings) * step / speed}
    if scene.path != "circle":
        element = pysas.simulation.Element(ELEMENT)
        more |= {"tx_element": element, "rx_element": element}
    near = 7.0 if scene.path == "circle" else scene.near
    with warnings.catch_warnings():
        # 30 kHz of 1 ms at 40 kHz: 1 % of the energy, as recorders have it
        warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
        return pysas.simulate(
            points, amplitudes, pulse, tx=track.position, rx=rx, fs=FS, c=C, t0=2 * near / C, duration=2 * 12 / C + duration,
            snr_db=scene.snr, seed=seed, **more,
        )  # fmt: skip


def bed(scene, rng, middle, length):
    """Scatterers of a scene and their amplitudes."""
    if scene.path == "circle":
        low, high = np.array([-2.0, -2.0]), np.array([2.0, 2.0])  # what pings 25 mm apart sample
    else:
        low = np.array([middle[0] - length / 2 - 4, scene.near - 1])
        high = np.array([middle[0] + length / 2 + 4, scene.near + 11])
    parts = []
    if scene.bed in ("points", "both"):
        edge = 0.2 * (high - low)
        places = rng.uniform(low + edge, high - edge, (6, 2))
        parts.append((places, rng.uniform(0.7, 1.3, 6) * (30 if scene.bed == "both" else 1)))
    if scene.bed != "points":
        places = rng.uniform(low, high, (2500, 2))
        amplitudes = rng.standard_normal(2500) + 1j * rng.standard_normal(2500)
        if scene.bed == "sand":
            ripples = 1 + np.cos(2 * np.pi * (places[:, 1] + 0.3 * np.sin(places[:, 0])) / 0.7)
            patches = np.exp(1.5 * np.sin(places[:, 0] / 1.1) * np.sin(places[:, 1] / 0.9 + 1))
            amplitudes *= ripples * patches
        parts.append((places, amplitudes))
    flat = np.concatenate([p for p, _ in parts])
    return np.c_[flat, np.zeros(len(flat))], np.concatenate([a for _, a in parts]).astype(complex)


def measured():
    """Echoes that this project did not make, by name, where PYSAS_DATA names their folder: (raw or compressed, as stored)."""
    folder = os.environ.get("PYSAS_DATA")
    if not folder:
        return {}
    found = {name.split(".")[0]: pysas.load(Path(folder) / name) for name in FILES[:2]}
    with np.load(Path(folder) / FILES[2]) as file:
        history = (file[name] for name in ("phase_history", "freq", "position", "r0"))
        found["gotcha"] = pysas.from_phase_history(*history, float(file["c"]))
    return found
