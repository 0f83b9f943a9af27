"""Scenes drawn from a seed, of every kind the engines take: tracks, arrays, speeds, beams, records, data and grids.

`draw(seed)` gives a scene. Families take turns by the seed, so that any run of seeds has them all; within a family everything
is drawn. Lengths are in units of a range sample, c/(2 fs): how far apart, how fast and how finely sampled is what matters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import promise_oracle as oracle

import pysas

TRACKS = ("line", "arc", "circle", "spiral", "eight", "reversing", "still", "walk", "helix", "two lines", "jittered line")
ARRAYS = ("monostatic", "same place", "bistatic", "line", "long baseline", "fixed transmitter", "swapped", "off the middle")
GRIDS = ("plane", "polar", "surface", "volume", "points", "rotated", "cloud")
DATA = ("noise", "tones", "impulses", "point", "traces of all levels")
FAMILIES = (
    "any", "far", "late", "bright", "far", "blast", "wide views", "edges", "far", "views", "extreme", "late", "fine", "fixed",
    "far", "over-sampled", "coarse", "offset", "natural", "far",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scene:
    """What to image, how well, and where it is looked at. `lenient`: a note may say that less than tol is reached."""

    seed: int
    family: str
    words: str
    echoes: pysas.Echoes
    grid: pysas.Grid
    tol: float
    weights: Any = None
    nan: str = "raise"
    lenient: bool = False


class Draw:
    """A random generator with the few draws that scenes are made of."""

    def __init__(self, seed: int, part: str = "") -> None:
        # parts of their own, so that what is drawn there changes nothing else of a scene
        self.rng = np.random.default_rng([seed, 2024, *part.encode()])

    def one(self, choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def whole(self, low: int, high: int) -> int:
        return int(np.exp(self.rng.uniform(np.log(low), np.log(high + 1))))

    def maybe(self, chance: float) -> bool:
        return bool(self.rng.random() < chance)


def track(d: Draw, kind: str, pings: int, length: float) -> np.ndarray:
    """Positions (ping, 3) over about `length`, about the origin."""
    s = np.linspace(-0.5, 0.5, pings) if pings > 1 else np.zeros(1)
    zero, turns = np.zeros(pings), 2 * np.pi * s
    if kind == "arc":
        half = d.rng.uniform(0.2, 2.5)
        x, y, z = np.sin(s * half) / half, (1 - np.cos(s * half)) / half, zero
    elif kind == "circle":
        x, y, z = np.cos(turns) / 2, np.sin(turns) / 2, zero
    elif kind == "spiral":
        x, y, z = (0.6 + s) / 2 * np.cos(4 * turns), (0.6 + s) / 2 * np.sin(4 * turns), zero
    elif kind == "eight":
        x, y, z = np.sin(turns) / 2, np.sin(2 * turns) / 4, zero
    elif kind == "reversing":
        x, y, z = np.abs(np.linspace(-1, 1, pings)) - 0.5, 0.01 * s, zero
    elif kind == "still":
        x = y = z = zero
    elif kind == "walk":
        x, y, z = (np.cumsum(d.rng.standard_normal((pings, 3)), axis=0) / pings).T
    elif kind == "helix":
        x, y, z = np.cos(2 * turns) / 2, np.sin(2 * turns) / 2, 0.3 * s
    elif kind == "two lines":
        x, y, z = np.resize(2 * s, pings) % 1 - 0.5, np.where(s > 0, 0.4, 0.0), zero
    elif kind == "jittered line":
        x, y, z = s, d.log(1e-4, 1e-1) * d.rng.standard_normal(pings), d.log(1e-4, 1e-1) * d.rng.standard_normal(pings)
    else:
        x, y, z = s, zero, zero
    return length * np.stack([x, y, z], axis=1)


def array(d: Draw, kind: str, path: np.ndarray, channels: int, size: float, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Transmitters (ping, 3) and receivers (ping, channel, 3) of a platform on `path`; small and large baselines."""
    pings = len(path)
    tx, rx = path.copy(), np.repeat(path[:, None], channels, axis=1)
    apart = np.linspace(-0.5, 0.5, channels)[:, None] * np.array([1.0, 0.0, 0.0]) if channels > 1 else np.zeros((1, 3))
    odd = (np.arange(pings) % 2 == 1)[:, None]
    if kind == "bistatic":
        rx = rx + size * d.rng.standard_normal(3)
    elif kind == "line":
        rx = rx + size * apart + 0.1 * size * d.rng.standard_normal(3)
    elif kind == "long baseline":
        rx = rx + far * d.rng.uniform(0.1, 0.6) * np.array([*(_unit(d)[:2]), 0.0]) + size * apart
    elif kind == "fixed transmitter":
        tx = np.tile(path.mean(axis=0) + far * d.log(1e-3, 0.5) * _unit(d), (pings, 1))
    elif kind == "swapped":
        away = far * d.log(0.01, 0.5) * np.array([*(_unit(d)[:2]), 0.0])
        tx, rx = tx + np.where(odd, away, 0), rx + np.where(odd, 0, away)[:, None]
    elif kind == "off the middle":
        away = far * d.log(0.01, 0.3) * np.array([*(_unit(d)[:2]), 0.0])
        tx, rx = tx + np.where(odd, away, 0), rx - np.where(odd, away, 0)[:, None]
    return tx, rx


def _unit(d: Draw) -> np.ndarray:
    v = d.rng.standard_normal(3)
    return v / np.linalg.norm(v)


def grid(d: Draw, kind: str, centre: np.ndarray, extent: tuple[float, float], shape: tuple[int, int], unit: float) -> Any:
    """A grid of one of the kinds about `centre`, with axes of every order."""
    rows, columns = shape
    plain = d.maybe(0.5)

    def axis(middle: float, length: float, n: int) -> np.ndarray:
        a = middle + (np.linspace(-length / 2, length / 2, n) if n > 1 else np.zeros(1))
        way = "plain" if plain else d.one(("plain", "descending", "shuffled", "duplicates", "uneven"))
        if way == "descending":
            a = a[::-1].copy()
        elif way == "shuffled":
            d.rng.shuffle(a)
        elif way == "duplicates":
            a = np.resize(np.repeat(a[: max(1, n // 2)], 2), n)
        elif way == "uneven":
            a = np.sort(middle + d.rng.uniform(-length / 2, length / 2, n))
        return a

    mask = None
    if d.maybe(0.25):
        mask = d.rng.random((rows, columns)) < d.one((0.05, 0.5, 0.95))
        if d.maybe(0.5):
            mask[: rows // 3] = False
        mask.flat[d.rng.integers(mask.size)] = True
    if kind == "plane":
        x, y = axis(centre[0], extent[0], columns), axis(centre[1], extent[1], rows)
        return pysas.Grid.plane(x, y, float(centre[2]), mask=mask)
    if kind == "surface":
        x, y = axis(centre[0], extent[0], columns), axis(centre[1], extent[1], rows)
        rough = d.one((1e-3, 0.1, 2.0)) * unit
        z = centre[2] + rough * (np.sin(np.arange(columns) / 7) + np.cos(np.arange(rows) / 5)[:, None])
        z = z + d.one((0.0, 0.1)) * rough * d.rng.standard_normal(shape)
        return pysas.Grid.surface(x, y, z, mask=mask)
    if kind == "polar":
        away = d.one((1.0, 3.0, 30.0)) * max(extent) * _unit(d)
        hub = centre - np.array([away[0], away[1], 0.0])
        r, phi = np.hypot(away[0], away[1]), np.arctan2(away[1], away[0])
        return pysas.Grid.polar(
            axis(r, min(extent[0], 1.9 * r), columns), axis(phi, min(extent[1] / r, 2 * np.pi), rows), hub, mask=mask
        )
    if kind == "volume":
        layers = d.one((1, 2, 3))
        x, y = axis(centre[0], extent[0], columns), axis(centre[1], extent[1], max(1, rows // layers))
        z = axis(centre[2], d.one((0.1, 1.0)) * min(extent), layers)
        return pysas.Grid.volume(x, y, z)
    if kind == "cloud":
        return pysas.Grid.points(centre + d.rng.uniform(-0.5, 0.5, (rows * columns, 3)) * [*extent, unit])
    flat = np.stack(np.broadcast_arrays(axis(0, extent[0], columns), axis(0, extent[1], rows)[:, None], 0.0), axis=-1)
    if kind == "rotated":
        turn = d.rng.uniform(0, 2 * np.pi)
        cos, sin = np.cos(turn), np.sin(turn)
        tilt = d.one((0.0, 0.0, 0.3))
        x, y = flat[..., 0], flat[..., 1]
        flat = np.stack([cos * x - sin * y, sin * x + cos * y, tilt * y], axis=-1)
    return pysas.Grid.points(centre + flat, mask=mask)


def noise(d: Draw, shape: tuple[int, ...], band: float) -> np.ndarray:
    """Random samples of level 1 whose spectrum fills |f| <= band/2, in units of fs, cut from longer records."""
    n = shape[-1]
    m = max(4 * n, int(np.ceil(8 / band)))
    # one frequency at least; symmetric rounding errors of a transform are the only thing beyond the band
    f = np.fft.fftfreq(m)
    inside = np.flatnonzero(np.abs(f) <= band / 2)
    spectrum = np.zeros((*shape[:-1], m), np.complex128)
    size = (*shape[:-1], inside.size)
    spectrum[..., inside] = d.rng.standard_normal(size) + 1j * d.rng.standard_normal(size)
    return np.fft.ifft(spectrum)[..., :n] * (m / np.sqrt(2 * inside.size))


def pulses(place: np.ndarray, n: int, band: float, gaussian: float = 0.0) -> np.ndarray:
    """(..., n) samples of pulses of amplitude 1 at `place`: sinc, or Gaussian down by exp(-gaussian) at the band's edge."""
    t = np.arange(n) - np.asarray(place)[..., None]
    if gaussian:
        return np.exp(-((t * np.pi * band / 2) ** 2) / gaussian)
    return np.sinc(band * t)


def samples(d: Draw, kind: str, shape: tuple[int, int, int], band: float) -> np.ndarray:
    pings, channels, n = shape
    if kind == "tones":
        f = np.where(d.rng.random((pings, channels, 1)) < 0.5, -0.5, 0.5) * band * (1 - 1e-12)
        return np.exp(2j * np.pi * (f * np.arange(n) + d.rng.random((pings, channels, 1))))
    if kind == "impulses":
        place = d.rng.uniform(-2, n + 1, (pings, channels))
        if d.maybe(0.5):
            place = np.round(place)
        return pulses(place, n, band) * np.exp(2j * np.pi * d.rng.random((pings, channels, 1)))
    data = noise(d, shape, band)
    if kind == "traces of all levels":
        data *= 10.0 ** d.rng.uniform(-6, 0, (pings, channels, 1))
    return data


def draw(seed: int) -> Scene:
    """The scene of a seed."""
    d = Draw(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    if family in ("coarse", "wide views"):
        return _plain(d, seed, family)
    # scenes that trees suit have few complications each: together they leave no tree
    far = family in ("far", "late", "over-sampled", "fixed", "natural")
    odd = 0.3 if far else 1.0
    fs = d.one((10e3, 40e3, 1e6))
    c = d.one((1500.0, 1500.0, 343.0))
    unit = c / (2 * fs)
    over = d.log(2.5, 10) if family == "over-sampled" else d.one((1.1, 1.2, 4 / 3, 2.0, d.log(1.1, 20)))
    band = 1 / over * (1 - 1e-12)  # of fs
    fc = fs / over * d.one((d.log(0.3, 1), d.log(1, 20), d.log(2, 6)))

    # geometry
    pings = d.whole(16, 250) if far else d.whole(1, 90)
    channels = d.one((1, 1, 1, 2, 4)) if pings < 100 else 1
    if family == "natural":
        pings, channels = 2048, 1
    if family == "extreme":
        pings = d.one((1, 1, 2, pings))
    kind = d.one(TRACKS) if d.maybe(odd) else d.one(("line", "jittered line", "arc"))
    reach = d.log(300, 4000) if far else d.log(20, 1500)
    if family == "over-sampled":
        reach *= over / 2
    length = reach * (d.log(3e-3, 0.5) if far else d.log(1e-2, 3.0))
    if family == "natural":
        kind, reach = d.one(("line", "jittered line", "circle", "arc")), d.log(600, 3000)
        length = reach * d.log(0.1, 1.0)
    path = track(d, kind, pings, length * unit)
    form = "fixed transmitter" if family == "fixed" else d.one(ARRAYS) if d.maybe(odd) else d.one(ARRAYS[:3])
    if family == "late" and d.maybe(0.4):
        form = d.one(("swapped", "off the middle"))
    if family == "natural":
        form = d.one(("monostatic", "bistatic"))
    tx, rx = array(d, form, path, channels, length * unit * d.one((0.02, 0.3)), reach * unit)
    squint = d.one((np.pi / 2, d.rng.uniform(0, np.pi), d.rng.uniform(0, np.pi), 0.0))
    depth = d.one((0.0, d.rng.uniform(0, 0.3), d.rng.uniform(0, 0.8)))
    centre = reach * unit * np.array([np.cos(squint), np.sin(squint), -depth]) / np.hypot(1, depth)
    if kind == "circle" and d.maybe(0.5) and not far:
        centre = 0.4 * length * unit * d.rng.random() * np.array([np.cos(squint), np.sin(squint), 0.0])
    offset = np.zeros(3)
    if family == "offset" or d.maybe(0.1):
        offset = np.array([5e6, 4e5, 0.0]) * d.one((1.0, -1.0))

    # grid
    rows, columns = d.one(((d.whole(1, 64), d.whole(1, 64)), (1, d.whole(1, 300)), (d.whole(1, 300), 1), (40, 40)))
    # from a fraction of the resolution to several times it
    fine = unit * min(1.0, over * band)
    steps = d.log(0.03, 2.0) * over * fine * np.array([1.0, d.log(0.3, 3)])
    extent = (float(min(steps[0] * columns, 200 * unit)), float(min(steps[1] * rows, 200 * unit)))
    if family == "natural":
        rows, columns, extent = 48, 48, (48 * unit, 48 * unit)
    shape = d.one(GRIDS) if d.maybe(odd) else d.one(("plane", "plane", "rotated", "polar"))
    view = grid(d, shape, centre + offset, extent, (rows, columns), unit)
    tx, rx = tx + offset, rx + offset

    velocity = None
    speed = d.one((0.0, 0.0, 1e-3, 0.01, 0.0499)) * c
    if family == "late" and d.maybe(0.3):
        speed = 0.0499 * c
    if speed and family != "natural" and d.maybe(odd):
        way = d.one(("one", "each", "odd"))
        velocity = np.tile(_unit(d), (pings, channels, 1)) if way != "each" else np.empty((pings, channels, 3))
        if way == "each":
            for index in np.ndindex(pings, channels):
                velocity[index] = _unit(d)
        if way == "odd":
            velocity[::2] = 0
        velocity = velocity * speed

    beam = None
    if d.maybe(0.5 if family == "late" else 0.2 * odd):
        look = centre + offset - tx.mean(axis=0)
        look = look if np.linalg.norm(look) > 0 else np.array([0.0, 1.0, 0.0])
        look = np.tile(look, (pings, 1)) / np.linalg.norm(look)
        look += d.one((0.0, 0.02, 0.3)) * d.rng.standard_normal((pings, 3))
        if d.maybe(0.3):
            look[::2] *= -1
        if d.maybe(0.5):
            look = look * d.log(0.1, 10)
        half = d.one((d.log(0.02, np.pi), d.log(0.2, 1.6), np.pi))
        beam = lobe(seed, look if d.maybe(0.7) else look[-1], half)

    # record: about what the pixels need, with little or much beside it, or cut
    bare = {"fs": fs, "fc": fc, "c": c, "bandwidth": band * fs}
    empty = pysas.Echoes(np.zeros((pings, channels, 1), complex), tx=tx, rx=rx, velocity=velocity, beam=beam, **bare)
    some = view.coordinates(np.unique(d.rng.integers(0, view.size, 40)))
    tau = oracle.delays(empty, some) * fs
    low, high = tau.min(axis=(0, 2)), tau.max(axis=(0, 2))
    margins = (d.rng.uniform(0, 20), d.rng.uniform(20, 120), d.rng.uniform(60, 300), d.rng.uniform(150, 300))
    before, after = d.one(margins[2:] if far else margins), d.one(margins[2:] if far else margins)
    if family == "over-sampled":
        before = d.one(margins[:2])
    span = float(high.max() - low.min())
    if d.maybe(0.15 * odd):
        before = -d.rng.uniform(0, 1) * span  # begins within the image
    start = np.full(pings, low.min() - before)
    if d.maybe(0.3 * odd):
        start = low - before  # each ping's record begins as it needs
        span = float(np.max(high - low))
    jitter = "even"
    if family == "late" or d.maybe(0.15 * odd):
        jitter = d.one(("jittered", "random", "odd late", "stepped", "odd gone"))
        each = np.arange(pings) % 2 == 1
        if jitter == "jittered":
            start = start + d.rng.uniform(0, 2, pings)
        elif jitter == "random":
            start = start + d.rng.uniform(0, 1, pings) * (before + span)
        elif jitter == "odd late":
            start = start + np.where(each, before + 0.4 * span, 0)
        elif jitter == "stepped":
            start = start + np.where(np.arange(pings) > pings // 2, before + 0.6 * span, 0)
        else:
            start = start + np.where(each, before + 3 * span + 600, 0)
    n = int(np.clip(before + span + after, 1, 800 if family != "natural" else 500))
    if family == "extreme" and d.maybe(0.4):
        n = d.one((1, 1, 2, 3))
        start = np.full(pings, np.floor(tau.min()) - d.one((0, 1)))
    if family == "blast":
        start = np.full(pings, low.min() - d.rng.uniform(30, 400))
        n = int(np.clip(low.min() - start[0] + span + d.rng.uniform(0, 200), 64, 800))

    # data
    content = d.one(DATA[:3]) if family in ("fine", "over-sampled") else d.one(DATA) if d.maybe(0.5) else "noise"
    if family == "bright":
        content = "point"
    lenient = family in ("bright", "blast") or content in ("impulses", "point", "traces of all levels")
    if content == "point":
        near = view.coordinates(np.array([int(d.rng.integers(view.size))]))[0]
        target = near + (extent[0] + d.rng.uniform(0, 20) * unit) * np.array([*_unit(d)[:2], 0.0]) * (family == "bright")
        place = oracle.delays(empty, target[None])[0]
        level = 10 ** (d.one((20, 40, 60, 80)) / 20) if family == "bright" else d.one((1e2, 1e4))
        gaussian = np.log(1e9 * level) if d.maybe(0.5) else 0.0
        echo = pulses(place * fs - start[:, None], n, band, gaussian) * np.exp(-2j * np.pi * ((fc * place) % 1))[..., None]
        data = level * echo + noise(d, (pings, channels, n), band)
    else:
        data = samples(d, content, (pings, channels, n), band)
    blast = ""
    if family == "blast":
        level = 10 ** (d.one((40, 60, 80, 100)) / 20)
        width = np.log(1e9 * level)
        data = data + level * pulses(d.one((-1.0, 0.0, -0.5, 20.0)) * over, n, band, width)
        blast = f" under a blast of {20 * np.log10(level):.0f} dB"
    double = family == "fine" or d.maybe(0.3)
    wavelengths = float(np.max(tau)) / fs * fc
    finest = max(1e-10, 2e-14 * wavelengths)
    tol = d.log(finest, 1e-4) if family == "fine" else d.log(finest, 0.1) if double and d.maybe(0.5) else d.log(1e-5, 0.1)
    if far:
        tol = d.log(3e-5, 0.1)
    if d.maybe(0.2):
        tol = d.one((1e-1, 1e-3, 1e-5)) if not far else d.one((1e-1, 1e-3))
    scale = 1.0
    if family == "extreme":
        scale = d.one((1e-30, 1e30, 1.0, 1e-38))
        if double:
            scale = d.one((scale, 1e-150, 1e150))
    data = data * scale
    dtype = np.complex128 if double else np.complex64

    weights: Any = None
    if d.maybe(0.3):
        way = d.one(("ping", "channel", "complex", "zeros"))
        weights = d.rng.uniform(0.2, 1, (pings, channels)) if way == "channel" else d.rng.standard_normal(pings)
        if way == "complex":
            weights = d.rng.standard_normal((pings, channels)) + 1j * d.rng.standard_normal((pings, channels))
        if way == "zeros":
            weights = (d.rng.random((pings, channels)) < 0.7).astype(float)
            if family == "extreme":
                data = np.where(weights[..., None] == 0, data * 1e6, data)  # what is not heard may be loud
    nan = "raise"
    if d.maybe(0.1):
        nan = "mask"
        dead = d.rng.random((pings, channels)) < 0.2
        if family != "views":
            data = np.where(dead[..., None] & (np.arange(n) == n // 2), np.nan, data)
    if family == "views":
        weights, nan, lenient = "uniform-angle", "raise", True
        tol = d.log(1e-3, 0.1)
    start_time = start / fs
    with np.errstate(over="ignore"):
        data = data.astype(dtype)
    if family == "edges":
        tx, rx, start_time, beam, view, n, data = _edges(
            d, Draw(seed, "edge").one(("fan", "cone")), unit, fs, c, pings, channels, dtype, band
        )
        velocity, weights, nan, kind, form, jitter = None, None, "raise", "edges", "monostatic", "even"
        shape, content, lenient = view.kind, "noise", False
    flat = channels == 1 and d.maybe(0.5)
    t0 = start_time if np.ptp(start_time) > 0 or d.maybe(0.3) else float(start_time[0])
    echoes = pysas.Echoes(
        data[:, 0] if flat else data, tx=tx, rx=rx[:, 0] if flat else rx, t0=t0, beam=beam,
        velocity=None if velocity is None else velocity[:, 0] if flat else velocity, **bare,
    )  # fmt: skip
    if isinstance(weights, np.ndarray) and weights.ndim == 2 and weights.shape[1] != echoes.n_channel:
        weights = weights[:, :1]
    words = (
        f"{kind}, {form}, {pings} x {channels} x {n}, {shape} {'x'.join(map(str, view.shape))}, {content}{blast}"
        f"{'' if scale == 1 else f' x {scale:g}'}, {np.dtype(dtype).name}, fs/B {over:.3g}, fc/B {fc / fs * over:.3g}, "
        f"length/range {length / reach:.2g}, range {reach:.0f} samples, speed {speed / c:.2g} c, start {jitter}, "
        f"{'no beam' if beam is None else f'{beam.shape} of {beam.half_angle:.2g} rad, taper {beam.taper:.2g}'}, weights "
        f"{'no' if weights is None else weights if isinstance(weights, str) else weights.dtype}, nan {nan}"
    )
    return Scene(seed, family, words, echoes, view, float(tol), weights, nan, lenient)


def recorded(seed: int) -> Scene:
    """The scene of a seed whose pings have sound speeds of their own, or whose traces were recorded in parts, or both."""
    scene, d = draw(seed), Draw(seed, "recorded")
    echoes, words, nan = scene.echoes, scene.words, scene.nan
    pings, channels, n = echoes.traces.shape
    spread = d.one((0.0, 1e-4, 5e-3, 3e-2))
    if spread:
        echoes = echoes.replace(c=echoes.speed * (1 + spread * d.rng.uniform(-1, 1, pings)))
        words += f", speeds within {100 * spread:g} %"
    if spread and d.maybe(0.3):
        return replace(scene, echoes=echoes, words=words)
    some = scene.grid.coordinates(np.unique(d.rng.integers(0, scene.grid.size, 40)))
    place = (oracle.delays(echoes, some) - echoes.start_time[:, None]) * echoes.fs
    low, high = place.min(axis=0), place.max(axis=0)
    kind, shape = d.one(("ragged", "across pixels", "anywhere", "one of all")), (2, pings, channels)
    if kind == "ragged":
        ends = np.stack([low - d.rng.uniform(-5, 100, low.shape), high + d.rng.uniform(-5, 100, low.shape)])
    elif kind == "across pixels":
        ends = low + (high - low) * d.rng.uniform((-0.2, 0.5), (0.5, 1.2), (*low.shape, 2)).transpose(2, 0, 1)
    else:
        ends = np.sort(d.rng.uniform(0, n, shape if kind == "anywhere" else (2, 1, 1)), axis=0)
    ends = np.sort(np.clip(np.rint(np.broadcast_to(ends, shape)), 0, n - 1).astype(int), axis=0)
    if echoes.data.ndim == 2 or d.maybe(0.3):
        ends = np.broadcast_to(ends[:, :, :1], shape)  # of pings
    first, last = ends
    inside = (np.arange(n) >= first[..., None]) & (np.arange(n) <= last[..., None])
    fill = d.one((1.0, 1e3, np.nan))
    if nan == "mask" and d.maybe(0.5):
        fill, valid = np.nan, None  # padded: the engines find out
    else:
        last = np.where(d.rng.random((pings, 1)) < 0.05, first - 1, last)  # nothing
        valid = np.stack([first, last], axis=-1)
        if echoes.data.ndim == 2 or np.all(valid == valid[:, :1]):
            valid = valid[:, 0]
    with np.errstate(over="ignore", invalid="ignore"):
        data = np.where(inside, echoes.traces, echoes.traces * echoes.dtype.type(fill)).reshape(echoes.data.shape)
    words += f", recorded {kind}, {'padded' if valid is None else f'beside samples x {fill:g}'}"
    return replace(scene, echoes=echoes.replace(data=data, valid=valid), words=words)


def lobe(seed: int, look: np.ndarray, half: float) -> pysas.Beam:
    """A fan or a cone with a hard edge, a narrow taper, a wide one or nothing but taper; axes at right angles or not."""
    d = Draw(seed, "beam")
    fan, axis = d.maybe(0.6), None
    taper = d.one((0.0, 0.0, d.log(1e-3, 0.1), 0.5, 1.0))
    if fan:
        half = min(half, np.pi / 2)
        way = d.one(("level", "level", "askew", "of the ping"))
        rows = np.atleast_2d(look)
        level = np.cross(rows, [0.0, 0.0, 1.0])
        if way != "level" or not np.all(np.linalg.norm(level, axis=1) > 1e-3 * np.linalg.norm(rows, axis=1)):
            along = rows / np.linalg.norm(rows, axis=1, keepdims=True)
            axis = np.cross(along, _unit(d)) + d.one((0.0, 0.1, 0.5)) * along + 0.05 * d.rng.standard_normal(rows.shape)
            axis = axis[0] if way == "askew" and look.ndim == 1 else axis if look.ndim == 2 else axis[0]
    return pysas.Beam(look, 1.0, half, "fan" if fan else "cone", max(taper, 1.1e-5 / half) if taper > 0 else 0.0, axis)


def _edges(
    d: Draw, shape: str, unit: float, fs: float, c: float, pings: int, channels: int, dtype: Any, band: float
) -> tuple[Any, ...]:
    """Pixels exactly on a record's first or last sample, or on a beam's edge, in numbers as a person would write them."""
    tx = np.zeros((pings, 3))
    tx[:, 0] = (np.arange(pings) - pings // 2) * 0.02
    rx = np.repeat(tx[:, None], channels, axis=1)
    n = int(d.rng.integers(60, 300))
    data = noise(d, (pings, channels, n), band).astype(dtype)
    begin = d.one((10.0, 15.0, 30.0))
    start = np.full(pings, d.one((2 * begin / c, round(2 * begin / c, 4))))
    way = d.one(("start", "end", "right angle", "diagonal", "narrow"))
    beam = None
    y = start[0] * c / 2 + np.arange(40) * d.one((unit, 0.1, 0.01))
    if way == "end":
        y = (start[0] + (n - 1) / fs) * c / 2 - np.arange(40) * d.one((unit, 0.1, 0.01))
    view = pysas.Grid.plane(np.arange(-16, 16) * d.one((0.01, 0.02)), y)
    if way == "right angle":
        beam = pysas.Beam([0.0, 1.0, 0.0], 1.0, np.pi / 2, shape)
        view = pysas.Grid.plane(begin * (1 + np.arange(30) * 1e-3), [0.0, *(np.arange(1, 6) * 0.05)])
    elif way == "diagonal":
        beam = pysas.Beam([1.0, 0.0, 0.0], 1.0, np.pi / 4, shape)
        s = begin / np.sqrt(2) + np.arange(50) * 0.01
        view = pysas.Grid.points(tx[0] + s[:, None] * np.array([1.0, 1.0, 0.0]))
    elif way == "narrow":
        half = 10.0 ** -d.rng.uniform(1, 6)
        beam = pysas.Beam([0.0, 1.0, 0.0], 1.0, half, shape)
        y = start[0] * c / 2 + 20 * unit
        view = pysas.Grid.points(tx[0] + np.array([0.0, y, 0.0]) + np.linspace(-1.5, 1.5, 61)[:, None] * [y * half, 0, 0])
    return tx, rx, start, beam, view, n, data


def _plain(d: Draw, seed: int, family: str) -> Scene:
    """A straight track beside an image, and one thing that few scenes have much of.

    "coarse": pixels of many wavelengths, so that the phase turns hundreds of times along a block of them. "wide views": an
    image as large as it is far away, over which the arcs of view that traces stand for change a lot, but keep their order.
    """
    fs, c, over = d.one((10e3, 40e3, 1e6)), 1500.0, d.one((1.2, 4 / 3, 2.0))
    unit, band, coarse = c / (2 * fs), 1 / over * (1 - 1e-12), family == "coarse"
    if coarse:
        fc = fs / over * d.log(20, 60)
        reach, pings = d.log(2000, 20_000), d.whole(1, 30)
        kind, length = d.one(("line", "arc", "jittered line")), d.log(0.02, 0.5)
        tx = track(d, kind, pings, unit * reach * length)
        rows, columns = d.one((1, 2)), d.whole(60, 300)
        extent = unit * np.array([columns * d.log(0.5, 3), rows])
        side, near, largest, weights = d.rng.uniform(-0.6, 0.6), 0.0, 1e-4, None
    else:
        fc = fs / over * d.log(1, 6)
        reach, pings = d.log(60, 200), d.whole(16, 90)
        kind, length = d.one(("line", "arc")), d.log(0.02, 2)
        tx = track(d, kind, pings, unit * reach * length)
        rows, columns = d.whole(20, 60), d.whole(20, 60)
        extent = unit * reach * d.log(0.3, 1.2) * np.array([1.0, d.log(0.5, 1.0)])
        # clear of the track, so that no line through two views crosses the image
        side, near, largest, weights = np.pi / 2, extent[1] / 2, 1e-3, "uniform-angle"
    depth = d.rng.uniform(0, 0.3)
    away = reach * unit * np.array([np.cos(side), np.sin(side), -depth]) + [0.0, near, 0.0]
    view = pysas.Grid.plane(
        away[0] + np.linspace(-0.5, 0.5, columns) * extent[0],
        away[1] + np.linspace(-0.5, 0.5, rows) * extent[1],
        float(away[2]),
    )
    empty = pysas.Echoes(np.zeros((pings, 1), complex), tx=tx, rx=tx, fs=fs, fc=fc, c=c, bandwidth=band * fs)
    tau = oracle.delays(empty, view.coordinates(np.arange(view.size))) * fs
    low = tau.min() - d.rng.uniform(40, 200)
    data = noise(d, (pings, int(np.ceil(tau.max() - low + d.rng.uniform(40, 200)))), band).astype(np.complex64)
    echoes = pysas.Echoes(data, tx=tx, rx=tx, t0=low / fs, fs=fs, fc=fc, c=c, bandwidth=band * fs)
    tol = d.log(1e-5, largest)
    words = f"{pings} x {data.shape[1]}, {view.shape}, fs/B {over:.3g}, fc/B {fc / fs * over:.3g}, range {reach:.0f} samples"
    return Scene(seed, family, words, echoes, view, tol, weights, lenient=not coarse)
