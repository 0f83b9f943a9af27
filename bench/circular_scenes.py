"""What the bench of circular SAS images: the paper's pulse and point, the engines' images of it, scenes to deconvolve."""

import numpy as np
from scipy.interpolate import make_interp_spline

import pysas
from pysas import circular

C, FC, BAND, T, SIGMA, FS = 1500.0, 100e3, 20e3, 1e-3, 2e-5, 90e3
WAVE = C / FC
GAUSS = circular.PointSpread(pysas.LFM(FC, BAND, T, "gaussian", SIGMA), C)
RECT = circular.PointSpread(pysas.LFM(FC, BAND, T), C)
RADIUS, TARGET = 40 * np.sqrt(2), (20.0, 20.0)
N, STEP, PEAK = 256, WAVE / 16, 10**-1.5  # deconvolution: pixels, their spacing, noise 30 dB below the peak
AWAY = np.linspace(0, N * STEP, 24 * N)
PROFILE = make_interp_spline(AWAY, GAUSS.exact(AWAY))  # 1e-7: images of many scatterers need not integrate each pixel
SCENES = {
    "one": [(0, 0)],
    "square of a wavelength": [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)],
    "pair at 0.5": [(-0.25, 0), (0.25, 0)],
    "pair at 0.3": [(-0.15, 0), (0.15, 0)],
    "pair at 0.25": [(-0.125, 0), (0.125, 0)],
    "pair at 0.15": [(-0.075, 0), (0.075, 0)],
}


def track(pings, radius):
    angle = np.arange(pings) * 2 * np.pi / pings
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)


def echoes_of(tx, points, reach):
    """Compressed monostatic echoes of unit points, from the analytic pulse, within `reach` (m) of the first."""
    tau = 2 / C * np.linalg.norm(np.atleast_2d(points)[:, None] - tx, axis=-1)
    start = np.floor((tau[0] - 2 * reach / C) * FS) / FS
    t = start[:, None] + np.arange(int(4 * reach / C * FS) + 2) / FS
    data = sum(GAUSS.pulse.response(t - one[:, None]) * np.exp(-2j * np.pi * FC * one[:, None]) for one in tau)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=start, bandwidth=60e3)


def off_centre(a, radius, pings, half, pixels, azimuth=np.pi / 4):
    """A point at offset a: echoes, a grid about it, its axis, and the pings' weights for even views there."""
    centre = a * radius * np.array([np.cos(azimuth), np.sin(azimuth)])
    tx = track(pings, radius)
    echoes = echoes_of(tx, [[*centre, 0.0]], 1.5 * half + 6 * GAUSS.gaussian_width)
    x = np.linspace(-half, half, 2 * pixels + 1)
    weights = circular.view_weights(echoes, pysas.Grid.points([[*centre, 0.0]]))[0, :, 0]
    return echoes, pysas.Grid.plane(centre[0] + x, centre[1] + x), x, weights


def imaged(echoes, grid, weights, tol=1e-6, method="backproject"):
    return getattr(pysas, method)(echoes, grid, tol=tol, weights=weights).data / weights.sum()


def density(view, a, azimuth=np.pi / 4):
    return circular.view_density(view - azimuth, a)


def ring(image, step):
    """Amplitude of the spectrum on the ring |q| = 2/wavelength +- 0.15/wavelength, in bins of 10 degrees."""
    q = np.fft.fftshift(np.fft.fftfreq(512, step))
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image, (512, 512))))
    radius, angle = np.hypot(q, q[:, None]), np.arctan2(q[:, None], q[None, :])
    on = np.abs(radius - 2 / WAVE) < 0.15 / WAVE
    place = np.floor((angle[on] + np.pi) / (2 * np.pi) * 36).astype(int) % 36
    return np.bincount(place, spectrum[on], 36) / np.bincount(place, minlength=36)


def papers_target():
    """Complex images of the point at (20, 20) m, without weights and with, and their axis."""
    half = 6 * WAVE
    echoes, grid, x, weights = off_centre(0.5, RADIUS, 900, half, 48)
    return imaged(echoes, grid, np.ones(900)), imaged(echoes, grid, weights), x


def scene(points, noise=0.0, seed=0):
    """Image of unit scatterers at `points` (x, y) in pixels, in white noise."""
    column, row = np.arange(N), np.arange(N)[:, None]
    image = sum(PROFILE(STEP * np.hypot(column - x, row - y)) for x, y in points)
    return image + noise * np.random.default_rng(seed).standard_normal((N, N))


def draw(seed):
    return np.random.default_rng(seed).standard_normal((N, N))


def papers_square():
    """The four scatterers of Fig 8 in noise 30 dB below the peak: places, images by name."""
    truth = N / 2 + 16 * np.array(SCENES["square of a wavelength"])
    image = scene(truth, PEAK, 1)
    found = circular.fit_points(image, GAUSS, STEP, PEAK)
    return truth, {
        "image": image,
        "naive 0.1": circular.naive(image, GAUSS, STEP, 0.1),
        "Wiener": circular.wiener(image, GAUSS, STEP, PEAK),
        "one centre": circular.wave_atom_expansion(image, GAUSS, STEP, (N / 2, N / 2)),
        "fit": circular.synthesise(found, GAUSS, (N, N), STEP),
    }


def methods(image, noise):
    """Deconvolved images by name."""
    centre = (N // 2, N // 2)
    found = {"image": image}
    for threshold in (0.3, 0.1, 0.03, 0.001):
        found[f"naive, {threshold:g}"] = circular.naive(image, GAUSS, STEP, threshold)
    found["Wiener"] = circular.wiener(image, GAUSS, STEP, noise)
    for power in (1, 2):
        name = f"wave atoms about the scatterer, envelope^{power}"
        found[name] = circular.wave_atom_expansion(image, GAUSS, STEP, centre, envelope_power=power)
    return found


def diffusion(image, r):
    return circular.energy_diffusion(image, STEP, (N // 2, N // 2), r, 4 * WAVE)
