"""Scenes of `bench.report`: a unit target among weaker points, under a smooth beam, on several tracks.

Straight tracks lie in the plane of the image, as the Fourier algorithms have it, so that all methods form the same pixels:
those that `range_doppler` returns. The beam falls as cos^2 to nothing where the pings stop sampling it.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pysas

GOTCHA = "gotcha_phase_history.npz"
SMALL = "small circle"
C, FC, SWEEP = 1500.0, 100e3, 20e3
PULSE = pysas.LFM(FC, SWEEP, 2e-3, "tukey", 0.6)
BAND = 26e3  # holds all but 6e-6 of the compressed pulse
LEVEL, MARGIN = 0.3, 0.4  # amplitude of the weaker points; record beyond the points, m


@dataclass(frozen=True)
class Scene:
    """What is imaged, and where errors are taken: along cuts through the target and on random pixels within `half` of it.

    Measured echoes have neither target nor raw echoes.
    """

    about: str
    raw: pysas.Echoes | None
    echoes: pysas.Echoes
    grid: pysas.Grid
    target: tuple[float, float] | None
    half: tuple[float, float] | None
    beam: float | None

    @property
    def traces(self):
        return self.echoes.n_ping * self.echoes.n_channel


def field(target, half, clear, count=24, seed=2):
    """Points and amplitudes: the target, and others in the box about it, none within `clear` of it."""
    rng = np.random.default_rng(seed)
    points, amplitudes = [(*target, 0.0)], [1.0 + 0j]
    while len(points) <= count:
        away = rng.uniform(-1, 1, 2) * half
        if np.any(np.abs(away) > clear):
            points.append((target[0] + away[0], target[1] + away[1], 0.0))
            amplitudes.append(LEVEL * np.exp(2j * np.pi * rng.uniform()))
    return np.array(points), np.array(amplitudes)


def record(track, points, amplitudes, fs, span, beam=None, rx=None, velocity=None, threads=2):
    """Raw echoes from slant ranges `span`, m; `beam`: sine from broadside where the two-way pattern ends."""
    first = np.floor((span[0] - MARGIN) * 2 / C * fs)
    common = {
        "tx": track.position, "rx": track.position if rx is None else rx, "velocity": velocity, "fs": fs, "t0": first / fs,
        "duration": (span[1] + MARGIN) * 2 / C - first / fs + PULSE.duration, "c": C, "threads": threads,
    }  # fmt: skip
    if beam is None:
        return pysas.simulate(points, amplitudes, PULSE, **common)
    data = 0
    for point, amplitude in zip(points, amplitudes, strict=True):
        raw = pysas.simulate(point[None], [amplitude], PULSE, **common)
        away = point - track.position
        sine = away[:, 0] / np.linalg.norm(away, axis=1)
        shade = np.where(np.abs(sine) < beam, np.cos(np.pi / 2 * sine / beam) ** 2, 0.0).astype(np.float32)
        data = data + raw.data * shade.reshape(-1, *[1] * (raw.data.ndim - 1))
    return raw.replace(data=data)


def compressed(raw, threads):
    return pysas.compress(raw, threads=threads).replace(bandwidth=BAND)


def weighted(raw):
    """Raw echoes under the pulse's own spectrum: chirp scaling compresses phases alone, a matched filter amplitudes too."""
    t = np.arange(int(PULSE.duration * raw.fs) + 1) / raw.fs
    n = raw.n_sample + 2 * t.size
    window = np.abs(np.fft.fft(PULSE.waveform(t), n))
    data = np.fft.ifft(np.fft.fft(raw.data, n) * window / window.max())[..., : raw.n_sample]
    return raw.replace(data=data.astype(raw.dtype))


def straight(about, near, far, step, beam, across, fs=40e3, threads=2):
    """A straight even track whose pings see every point, `across` m either side of the middle, through the whole beam."""
    reach = int(np.ceil((far * beam / np.sqrt(1 - beam**2) + across) / step))
    track = pysas.tracks.straight(2 * reach + 1, step, start=(-reach * step, 0.0, 0.0))
    row = round((near + far) * fs / C)  # of the record, so that the target lies on a pixel
    target, half = (0.0, row * C / (2 * fs)), (across, 0.95 * (far - near) / 2)
    clear = min(0.6 * across, 30 * step), min(0.6 * half[1], 0.7)
    points, amplitudes = field(target, half, clear)
    raw = record(track, points, amplitudes, fs, (near, far / np.sqrt(1 - beam**2)), beam, threads=threads)
    echoes = compressed(raw, threads)
    grid = pysas.reference.range_doppler(echoes, threads=threads).grid
    return Scene(about, weighted(raw), echoes, grid, target, half, float(np.arcsin(beam)))


def moving(about, pings, pixels, threads=2):
    """Six receivers that move while the echo travels, on a swaying track."""
    channels, step = 6, 0.18
    track = pysas.tracks.perturbed(
        pings, step, 6.0, start=(-pings * step / 2, 0.0, 0.0), sway=0.1, heave=0.05, yaw=0.01, correlation=2.0, seed=4
    )
    rx = pysas.tracks.array(track, channels, 0.06, offset=(0.2, 0.0, -0.1))
    axis = 0.02 * (np.arange(pixels) - pixels // 2)
    target, half = (0.0, 25.0), (0.9 * axis[-1], 0.9 * axis[-1])
    points, amplitudes = field(target, half, (0.5 * half[0], 0.5 * half[1]))
    span = 24.5 - half[1], 27.5 + half[1]
    raw = record(track, points, amplitudes, 40e3, span, 0.1, rx, track.velocity, threads)
    return Scene(about, raw, compressed(raw, threads), pysas.Grid.plane(axis, 25.0 + axis), target, half, None)


def circular(about, pings, pixels, threads=2):
    """A closed circle of 15 m about the image, 6 m above it."""
    track = pysas.tracks.circular(pings, 15.0, height=6.0)
    axis = 0.003 * (np.arange(pixels) - pixels // 2)
    half = (0.6 * axis[-1], 0.6 * axis[-1])
    points, amplitudes = field((0.0, 0.0), half, (0.4 * half[0], 0.4 * half[1]))
    raw = record(track, points, amplitudes, 40e3, (15.5 - axis[-1], 16.8 + axis[-1]), threads=threads)
    return Scene(about, raw, compressed(raw, threads), pysas.Grid.plane(axis, axis), (0.0, 0.0), half, None)


def gotcha(size, pixel):
    """AFRL's Gotcha, a measured car park, under a Hann window over frequency (`examples/gotcha.py`)."""
    with np.load(Path(os.environ["PYSAS_DATA"]) / GOTCHA) as file:
        window = np.hanning(file["freq"].size + 2)[1:-1]
        history = file["phase_history"] * (window / window.mean()).astype(np.float32)
        echoes = pysas.from_phase_history(history, file["freq"], file["position"], file["r0"], float(file["c"]))
    half = round(size / 2 / pixel)
    axis = pixel * np.arange(-half, half + 1)
    return Scene("10 km, X band, 4 degrees", None, echoes, pysas.Grid.plane(axis, axis), None, None, None)


def tiny(threads):
    """What every kernel is compiled on."""
    return [
        straight("", 10.0, 11.0, 0.03, 0.05, 0.3, threads=threads),
        moving("", 12, 64, threads),
        circular("", 64, 64, threads),
    ]


def scenes(quick):
    """Makers of the scenes by name; each takes the number of threads."""
    if quick:
        lines = {
            "straight stripmap": ("25 m", 23.0, 27.0, 0.03, 0.1, 1.2),
            "wide swath of 130 m": ("35 to 165 m", 35.0, 165.0, 0.1, 0.03, 0.6, 30e3),
            "near range": ("1 to 3 m", 1.0, 3.0, 0.01, 0.3, 0.5),
            "range of 1 km": ("997 to 1003 m", 997.0, 1003.0, 0.15, 0.02, 1.5),
        }
        others = (60, 200), (600, 160)
    else:
        lines = {
            "straight stripmap": ("20 to 34 m", 20.0, 34.0, 0.03, 0.1, 8.0),
            "wide swath of 130 m": ("35 to 165 m", 35.0, 165.0, 0.06, 0.055, 1.0, 30e3),
            "near range": ("0.6 to 6 m", 0.6, 6.0, 0.01, 0.3, 1.5),
            "range of 1 km": ("990 to 1010 m", 990.0, 1010.0, 0.1, 0.03, 2.0),
        }
        others = (160, 600), (1500, 384)
    made = {name: lambda threads, a=a: straight(*a, threads=threads) for name, a in lines.items()}
    made["perturbed track, 6 moving receivers"] = lambda threads: moving("25 m, 6 m above", *others[0], threads)
    made["circular"] = lambda threads: circular("radius 15 m, 6 m above", *others[1], threads)
    found = {name: made[name] for name in ORDER}
    if not quick:  # small enough for frames
        found[SMALL] = lambda threads: circular("radius 15 m, 6 m above", 120, 40, threads)
    if measured():
        found["measured Gotcha"] = lambda threads: gotcha(*((30.0, 0.2) if quick else (100.0, 0.2)))
    return found


def measured():
    """Whether the measured data are there."""
    return "PYSAS_DATA" in os.environ and Path(os.environ["PYSAS_DATA"], GOTCHA).is_file()


ORDER = (
    "straight stripmap", "perturbed track, 6 moving receivers", "circular", "wide swath of 130 m", "near range",
    "range of 1 km",
)  # fmt: skip
