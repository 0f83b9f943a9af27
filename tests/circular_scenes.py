"""Echoes of points on circular tracks, written down from the analytic pulse: no simulator, no compression."""

import numpy as np

import pysas

C, FC, FS = 1500.0, 100e3, 90e3
WAVE = C / FC
PULSE = pysas.LFM(FC, 20e3, 1e-3, "gaussian", 2e-5)


def circle(pings, radius, height=0.0, start=0.1):
    """Positions (ping, 3) evenly spaced on a circle about the origin."""
    angle = start + np.arange(pings) * 2 * np.pi / pings
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(pings, height)], axis=1)


def echoes(tx, rx, points, reach, dtype=np.complex128, pulse=PULSE):
    """Compressed echoes of unit points: samples within `reach` (m, of the first point) of its travel time."""
    rx = tx[:, None] if rx is None else rx
    points = np.atleast_2d(points)
    away = np.linalg.norm(points[:, None] - tx, axis=-1)[..., None] + np.linalg.norm(points[:, None, None] - rx, axis=-1)
    tau = away / C  # (point, ping, channel)
    start = np.floor((tau[0].min(axis=1) - 2 * reach / C) * FS) / FS
    samples = int(np.ceil((4 * reach / C + np.ptp(tau[0], axis=1).max()) * FS)) + 2
    t = start[:, None, None] + np.arange(samples) / FS
    data = sum(pulse.response(t - one[..., None]) * np.exp(-2j * np.pi * FC * one[..., None]) for one in tau)
    return pysas.Echoes(data.astype(dtype), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=start, bandwidth=60e3)


def patch(centre, half, pixels):
    """Square grid of (2 pixels + 1)^2 points about a place, of half-width `half`."""
    x = np.linspace(-half, half, 2 * pixels + 1)
    return pysas.Grid.plane(centre[0] + x, centre[1] + x), x


def circle_sum(tx, centre, x, weights, pulse=PULSE):
    """Eq 4 with the analytic pulse and exact ranges: what any sum over these pings must give, without sampled echoes."""
    total = np.zeros((x.size, x.size), dtype=complex)
    points = np.stack([*np.meshgrid(centre[0] + x, centre[1] + x), np.zeros((x.size, x.size))], axis=-1)
    for position, weight in zip(tx, weights, strict=True):
        path = np.linalg.norm(points - position, axis=-1) - np.linalg.norm(np.array([*centre, 0.0]) - position)
        total += weight * pulse.response(2 * path / C) * np.exp(4j * np.pi * FC / C * path)
    return total
