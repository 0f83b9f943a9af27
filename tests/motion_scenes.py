"""Scenes in which a track is to be found: a rough seabed and targets, seen by an array on a track that nobody knows.

Unless said otherwise: 100 kHz, 20 kHz, 1500 m/s; a transmitter of 0.10 m amid 12 receivers of 0.05 m every 0.05 m, of whose
phase centres 4 coincide from ping to ping; slant ranges 20 to 45 m; z down, the seabed 8 m below with 5 cm rms roughness, 60
scatterers a m2, three targets; sway 40 mm, heave 20 mm, yaw 12 mrad, surge 3 mm rms of 3 m correlation; noise 30 dB below the
compressed record. The claimed track is straight, with heading 0; what an inertial system says is
`claimed(echoes, pysas.tracks.inertial(truth.track))`. Records are developed speckle; images at 60 scatterers a m2 are not: 0.1
a cell and a contrast of 10, where 1000 to 5000 a m2 make one near 2.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

import pysas

C, FC, BAND, FS, PULSE = 1500.0, 100e3, 20e3, 30e3, 0.8e-3
INVERSE = 0.01  # of the filter that compresses: echoes are flat in the band
TX, RX, D, HEIGHT = 0.10, 0.05, 0.05, 8.0
HALF_ANGLE = np.arcsin(C / FC / TX)  # the transmitter's first null
TARGETS = ((-2.0, 24.0), (0.4, 30.0), (2.2, 36.0))  # x and ground range, m


@dataclass(frozen=True)
class Truth:
    """What an estimate is compared with."""

    track: pysas.tracks.Track
    claim: pysas.tracks.Track
    shift: np.ndarray  # (ping, 3), m: what `moved` has to shift the claimed echoes by, and to turn them
    yaw: np.ndarray  # (ping,), rad
    targets: np.ndarray  # (target, 3), m
    side: int


def arms(track, receivers, side=1):
    """Transmitters, receivers, their velocities and the beam of an array on `track`."""
    rx = pysas.tracks.array(track, receivers, D)
    arm = rx - track.position[:, None]
    spin = np.gradient(track.yaw, track.time) if track.n_ping > 1 else np.zeros(1)
    swing = spin[:, None, None] * np.stack([-arm[..., 1], arm[..., 0], np.zeros(arm.shape[:2])], axis=-1)
    cosine, sine, zero = np.cos(track.yaw), np.sin(track.yaw), np.zeros(track.n_ping)
    look, along = side * np.stack([-sine, cosine, zero], axis=1), np.stack([cosine, sine, zero], axis=1)
    beam = pysas.Beam(look, TX, HALF_ANGLE, axis=along)
    return {"tx": track.position, "rx": rx, "velocity": track.velocity[:, None] + swing, "beam": beam}


def claimed(echoes, track, side=1):
    """The same echoes with the geometry that `track` claims."""
    return echoes.replace(**arms(track, echoes.n_channel, side))


def correction(true, claim):
    """Shift (ping, 3) and yaw (ping,) from the claimed echoes and track to the true ones, as `pysas.motion.moving.moved` takes
    them: about the mean of each ping's phase centres."""
    (one, track), (other, straight) = true, claim
    middle = [(e.tx + e.receivers.mean(axis=1)) / 2 for e in (one, other)]
    return middle[0] - middle[1], track.yaw - straight.yaw


def gain(pulse):
    """What compression multiplies signal to noise by: the noise outside the band goes."""
    size = 4096
    spectrum = np.fft.fft(pulse.waveform(np.arange(size) / FS, FC))
    power = np.abs(spectrum) ** 2
    inside = np.abs(np.fft.fftfreq(size, 1 / FS)) <= BAND / 2
    filtered = inside * power / (power + INVERSE * power.max()) ** 2
    return np.sum(filtered * power) / power.sum() / filtered.mean()


def scene(
    pings: int = 64,
    overlap: int = 4,
    receivers: int = 12,
    *,
    snr_db: float | None = 30.0,
    sway: float = 0.04,
    heave: float = 0.02,
    yaw: float = 0.012,
    surge: float = 0.003,
    crab: float = 0.0,
    correlation: float = 3.0,
    targets: Any = TARGETS,
    strength: float = 60.0,
    swath: tuple[float, float] = (20.0, 45.0),
    height: float = HEIGHT,
    density: float = 60.0,
    roughness: float = 0.05,
    slope: float = 0.0,
    advance: float | None = None,
    side: int = 1,
    seed: int = 0,
    claim: pysas.tracks.Track | None = None,
    threads: int | None = None,
):
    """Compressed echoes with the true track, the same with a straight claim, and the truth.

    `targets` are (x, ground range), each of `strength` times a scatterer's amplitude, on the seabed's plane; density 0: no
    speckle. `advance` (m a ping) goes before `overlap`; `slope` tilts the seabed across the track about 30 m. `snr_db` compares
    mean powers over the compressed record, targets included.
    """
    advance = (receivers - overlap) * D / 2 if advance is None else advance
    start = (-advance * (pings - 1) / 2, 0.0, 0.0)
    motion = {"sway": sway, "heave": heave, "yaw": yaw, "surge": surge, "crab": crab, "correlation": correlation}
    track = pysas.tracks.perturbed(pings, advance, start=start, seed=seed, **motion)
    if claim is None:
        claim = pysas.tracks.straight(pings, advance, start=start)
    draw = seed if side > 0 else seed + 1000  # of seabed and noise: each side has its own
    points, amplitudes = np.zeros((0, 3)), np.zeros(0, dtype=complex)
    spare = C * PULSE / 2
    if density > 0:
        near, far = (np.sqrt(max(r**2 - height**2, 1.0)) for r in (swath[0] - spare, swath[1] + spare))
        left, right = (far * np.tan(HALF_ANGLE + 3 * yaw + sign * side * crab) for sign in (1, -1))
        end = advance * (pings - 1) / 2 + receivers * D
        y = (near, far) if side > 0 else (-far, -near)
        points, amplitudes = pysas.simulation.seabed((-end - left, end + right), y, density, height, roughness, draw)
        points[:, 2] += slope * (np.abs(points[:, 1]) - 30.0)
    place = np.array([(x, side * y, height + slope * (y - 30.0)) for x, y in targets]).reshape(-1, 3)
    points = np.concatenate([points, place])
    amplitudes = np.concatenate([amplitudes, np.full(len(place), strength, dtype=complex)])
    geometry = arms(track, receivers, side)
    element = {"boresight": geometry["beam"].boresight, "along": geometry["beam"].axis}
    pulse = pysas.LFM(FC, BAND, PULSE)
    if snr_db is not None:
        snr_db -= 10 * np.log10(gain(pulse))
    with warnings.catch_warnings():
        # what lies beyond the pulse's band folds to outside the band again, and compression takes it away
        warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
        raw = pysas.simulate(
            points,
            amplitudes,
            pulse,
            fs=FS,
            t0=2 * swath[0] / C,
            duration=2 * (swath[1] - swath[0]) / C + PULSE,
            tx_element=pysas.simulation.Element(TX, **element),
            rx_element=pysas.simulation.Element(RX, **element),
            snr_db=snr_db,
            seed=draw,
            ping_time=track.time,
            threads=threads,
            **geometry,
        )
    echoes = pysas.compress(raw, window="boxcar", inverse=INVERSE)
    straight = claimed(echoes, claim, side)
    shift, turn = correction((echoes, track), (straight, claim))
    return echoes, straight, Truth(track, claim, shift, turn, place, side)
