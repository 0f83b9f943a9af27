"""Points seen by one transducer on a swaying track that nobody knows, and what became of their images.

100 kHz, 20 kHz; one element of 0.10 m sends and hears every 25 mm; z down, points on a plane 8 m below. The claimed track is
straight.
"""

from __future__ import annotations

import warnings

import numpy as np

import pysas
from pysas.motion.moving import moved

C, FC, BAND, FS = 1500.0, 100e3, 20e3, 30e3
HEIGHT, STEP, ELEMENT = 8.0, 0.025, 0.10
CLUTTER = 60.0  # scatterers a m2
# of one ping, a cell of range across the two-way beam: 37.5 mm by 2.7 m or so at 27 m, with six scatterers
CELL = 6.0
GRID = pysas.Grid.plane(np.arange(-2.2, 2.2, 0.03), np.arange(20.0, 34.5, 0.03), HEIGHT)


def scene(seed, sway=0.003, *, pings=240, points=5, above_db=None, correlation=1.0, sine=None, dtype=np.complex64, snr_db=30.0):
    """Echoes with the true track, the same with the claimed one, and the points; clutter `above_db` below a point in a ping's
    range cell, and a `sine` of this many metres from peak to peak and this period in place of random sway."""
    rng = np.random.default_rng(seed)
    x = (np.arange(pings) - pings / 2) * STEP
    claim = np.stack([x, 0 * x, 0 * x], axis=1)
    true = claim.copy()
    if sine is None:
        true[:, 1] = pysas.tracks.perturbed(pings, STEP, sway=sway, correlation=correlation, seed=seed).position[:, 1]
    else:
        true[:, 1] = sine[0] / 2 * np.sin(2 * np.pi * x / sine[1] + rng.uniform(0, 2 * np.pi))
    across = np.linspace(21, 33, points) + rng.uniform(-0.5, 0.5, points)
    place = np.stack([rng.uniform(-1.5, 1.5, points), across, np.full(points, HEIGHT)], axis=1)
    all_points, strength = place, np.exp(2j * np.pi * rng.uniform(size=points))
    if above_db is not None:
        more, amplitude = pysas.simulation.seabed((-7.0, 7.0), (18.0, 36.0), CLUTTER, HEIGHT, 0.05, seed)
        all_points = np.concatenate([place, more])
        strength = np.concatenate([10 ** (above_db / 20) * np.sqrt(CELL) * strength, amplitude])
    return (*seen(all_points, strength, true, claim, 17.0, 38.0, snr_db, seed, dtype), place)


def speckle(seed, sway=0.003, pings=96):
    """Developed speckle alone: 7 scatterers in a cell of the image; claimed echoes and a grid within what they show."""
    x = (np.arange(pings) - pings / 2) * STEP
    claim = np.stack([x, 0 * x, 0 * x], axis=1)
    true = claim.copy()
    true[:, 1] = pysas.tracks.perturbed(pings, STEP, sway=sway, correlation=1.0, seed=seed).position[:, 1]
    points, amplitudes = pysas.simulation.seabed((-5.5, 5.5), (22.5, 25.5), 4000.0, HEIGHT, 0.02, seed)
    _, claimed = seen(points, amplitudes, true, claim, 23.5, 27.5, 30.0, seed, np.complex64)
    return claimed, pysas.Grid.plane(np.arange(-1, 1, 0.02), np.arange(22.9, 25.1, 0.015), HEIGHT)


def seen(points, amplitudes, true, claim, near, far, snr_db, seed, dtype):
    pulse = pysas.LFM(FC, BAND, 0.3e-3)
    element = pysas.simulation.Element(ELEMENT)
    with warnings.catch_warnings():
        # what lies beyond the pulse's band is little, and the same in all echoes
        warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
        raw = pysas.simulate(
            points, amplitudes, pulse, tx=true, rx=true, fs=FS, t0=2 * near / C, duration=2 * (far - near) / C + pulse.duration,
            tx_element=element, rx_element=element, snr_db=snr_db, seed=seed, dtype=dtype,
        )  # fmt: skip
    echoes = pysas.compress(raw)
    return echoes, echoes.replace(tx=claim, rx=claim)


def slant_error(found, true):
    """rms of the middle half's sway error, mean and slope taken out, m."""
    middle = slice(found.n_ping // 4, 3 * found.n_ping // 4)
    error, x = (found.tx - true.tx)[middle, 1], true.tx[middle, 0]
    return float(np.std(error - np.polyval(np.polyfit(x, error, 1), x)))


def peaks(echoes, points, half=0.4, step=0.015):
    """(point, 3): level, dB, and where x and y each point's peak is within a square about it."""
    found = []
    side = np.arange(-half, half + step / 2, step)
    for point in points:
        image = pysas.focus(echoes, pysas.Grid.plane(point[0] + side, point[1] + side, point[2]), tol=1e-3)
        x, y = pysas.metrics.peak_position(image)
        top = pysas.focus(echoes, pysas.Grid.points([[x, y, point[2]]]), tol=1e-3)
        found.append((20 * np.log10(abs(top.data[0])), x, y))
    return np.array(found)


def loss(found, true, points, **how):
    """Largest loss of a point's peak beside the true track's image, dB."""
    return float(np.max(peaks(true, points, **how)[:, 0] - peaks(found, points, **how)[:, 0]))


def side_lobes(echoes, points, reach=0.8):
    """Highest side lobe along the track of each point, dB."""
    found = []
    side = np.arange(-reach, reach, 0.01)
    for point in points:
        grid = pysas.Grid.plane(point[0] + side, point[1] + np.arange(-0.1, 0.1, 0.01), point[2])
        image = pysas.focus(echoes, grid, tol=1e-3)
        cut, _ = pysas.metrics.cut(image, pysas.metrics.peak_position(image), "x")
        top = int(np.argmax(np.abs(cut)))
        found.append(pysas.metrics.pslr(cut[max(0, top - 60) : top + 61]))
    return np.array(found)


def after_rigid_fit(found, true):
    """(point,) distances of places (point, 2) from the true ones after the shift and turn that fit best, m (Kabsch)."""
    one, other = found - found.mean(axis=0), true - true.mean(axis=0)
    u, _, v = np.linalg.svd(one.T @ other)
    if np.linalg.det(u @ v) < 0:
        u[:, -1] *= -1
    return np.linalg.norm(one @ (u @ v) - other, axis=1)


def circle(folder, seed, rms):
    """Echoes of a circular track, the same with a radial error of this rms, the points on the plane, and a grid."""
    true = pysas.compress(pysas.load(folder / "circular.npz"))
    points = np.load(folder / "circular.npz")["truth_position"]
    points = points[points[:, 2] == 5.0]  # one stands higher than the plane
    rng = np.random.default_rng(seed)
    angle = np.arctan2(true.tx[:, 1], true.tx[:, 0])
    error = sum(rng.standard_normal() * np.cos(n * angle + rng.uniform(0, 2 * np.pi)) for n in range(2, 10))
    shift = (error * rms / np.std(error))[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    axis = np.arange(-0.7, 0.7, 0.0025)
    return true, moved(true, shift, np.zeros(len(shift))), points, pysas.Grid.plane(axis, axis, 5.0)


def radial_error(found, true):
    """rms less mean and a shift of the centre, m."""
    angle = np.arctan2(true.tx[:, 1], true.tx[:, 0])
    error = np.sum((found.tx - true.tx)[:, :2] * np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=1)
    design = np.stack([np.ones(angle.size), np.cos(angle), np.sin(angle)], axis=1)
    return float(np.std(error - design @ np.linalg.lstsq(design, error, rcond=None)[0]))
