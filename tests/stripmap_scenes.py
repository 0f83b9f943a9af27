"""Sathishkumar et al.'s sonar for the tests of the Fourier algorithms: raw echoes of unit targets at x = 0.

30 kHz, 20 kHz down-chirp of 10 ms, a sonar of 0.22 m whose two-way beam is sinc^2 of the instantaneous frequency, cut at its
first nulls; slant ranges 100 m + offset; 1500 m/s.
"""

import numpy as np

import pysas

C, FC, BAND, LENGTH, R0 = 1500.0, 30e3, 20e3, 0.22, 100.0


def survey(offsets, spacing=LENGTH / 4, fs=30e3, duration=10e-3, sweep=-1):
    pulse = pysas.LFM(FC, sweep * BAND, duration)
    targets = R0 + np.asarray(offsets, dtype=float)
    sine = C / (FC - BAND / 2) / LENGTH  # of the first null at the lowest frequency
    half = int(np.ceil(1.02 * targets.max() * sine / np.sqrt(1 - sine**2) / spacing))
    u = spacing * np.arange(-half, half + 1)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    cell = C / (2 * fs)
    first = np.floor((targets.min() - 5) / cell)
    samples = int(np.ceil(np.hypot(targets.max(), u[-1]) / cell - first + duration * fs)) + 40
    data = np.zeros((u.size, samples), dtype=np.complex128)
    for target in targets:
        away = np.hypot(target, u)[:, None]
        index = np.ceil((2 * away / C - first / fs) * fs).astype(int) + np.arange(int(duration * fs) + 1)
        t = (first + index) / fs - 2 * away / C
        place = (FC + pulse.rate * (t - duration / 2)) * LENGTH * u[:, None] / away / C
        beam = np.where(np.abs(place) < 1, np.sinc(place), 0.0) ** 2
        echo = beam * pulse.waveform(t) * np.exp(-4j * np.pi * FC / C * away)
        np.put_along_axis(data, index, np.take_along_axis(data, index, 1) + echo, 1)
    return pysas.Echoes(data, fs=fs, fc=FC, tx=tx, rx=tx, c=C, t0=first / fs, pulse=pulse, compressed=False)


def smooth(points, u, fc=FC, band=BAND, fs=30e3, near=21.0, samples=380, look=0.0, width=0.25, y=0.0, side=1.0):
    """Compressed echoes of a Gaussian pulse (1e-10 of its peak outside `band`) and a cos^2 beam of the sine of the angle.

    The beam reaches `width` in that sine about `look`, and is zero beyond: nothing aliases in either direction.
    """
    u = np.asarray(u, dtype=float)
    tx = np.stack([u, np.full(u.size, y), 0 * u], axis=1)
    t = 2 * near / C + np.arange(samples) / fs
    sigma = 6.8 / (np.pi * band)  # exp(-(pi f sigma)^2 2), f = band/2
    data = np.zeros((u.size, samples), dtype=np.complex128)
    for x, r in points:
        away = np.hypot(r, x - u)
        sine = (x - u) / away - look
        beam = np.where(np.abs(sine) < width, np.cos(np.pi / 2 * sine / width) ** 2, 0.0)[:, None]
        late = t - 2 * away[:, None] / C
        data += beam * np.exp(-(late**2) / (2 * sigma**2)) * np.exp(-4j * np.pi * fc / C * away[:, None])
    boresight = (look, side * np.sqrt(1 - look**2), 0.0)
    beam_field = pysas.Beam(boresight, LENGTH, np.pi / 2) if look or side < 0 else None
    return pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=tx, c=C, t0=2 * near / C, bandwidth=band, beam=beam_field)
