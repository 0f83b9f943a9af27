"""Scenes the benchmarks share: random band-limited echoes, the hardest case for any interpolation."""

import numpy as np

import pysas


def random_stripmap(pings, samples, pixels, *, channels=1, moving=False, dtype=np.complex64, seed=1):
    """A swaying straight track at 100 kHz, 30 kHz band, fs 40 kHz; `pixels` squared of 2 cm from 30 m slant range."""
    rng = np.random.default_rng(seed)
    fs, fc, c, band = 40e3, 100e3, 1500.0, 30e3
    keep = np.abs(np.fft.fftfreq(samples)) <= band / 2 / fs
    spectrum = rng.standard_normal((pings, channels, samples)) + 1j * rng.standard_normal((pings, channels, samples))
    data = np.fft.ifft(spectrum * keep).astype(dtype)
    tx = np.zeros((pings, 3))
    tx[:, 0] = (np.arange(pings) - pings / 2) * 0.02 * channels
    tx[:, 1] = 0.1 * np.sin(np.arange(pings) / 40)
    tx[:, 2] = 8 + 0.05 * np.sin(np.arange(pings) / 57)
    rx = np.repeat(tx[:, None], channels, axis=1)
    rx[:, :, 0] += 0.04 * np.arange(channels) if channels > 1 else 0
    velocity = np.tile([1.5, 0.1, 0.05], (pings, 1)) if moving else None
    echoes = pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=rx, c=c, t0=2 * 24 / c, velocity=velocity, bandwidth=band)
    axis = 0.02 * np.arange(pixels)
    return echoes, pysas.Grid.plane(axis - axis.mean(), 30 + axis)
