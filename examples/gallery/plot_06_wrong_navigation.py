"""
Wrong navigation and what it looks like
=======================================

An image needs the track to a fiftieth of a wavelength over an aperture. Here the same echoes are imaged with navigation that
lacks sway of 0.5 to 8 mm rms, at a wavelength of 15 mm: first side lobes rise, then the target breaks into pieces.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Four targets; the true track sways, with a correlation length of 1 m.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(8), taper=0.5)
targets = np.array([[-0.6, 19.6, 0], [0.6, 19.6, 0], [-0.6, 20.4, 0], [0.6, 20.4, 0]])
grid = pysas.Grid.plane(np.arange(-1.2, 1.2, 0.01), np.arange(19.2, 20.8, 0.01))
straight = pysas.tracks.straight(500, spacing=0.02, start=(-5, 0, 0))

# %%
# Echoes are made on the track with sway and imaged as if it were straight. All pictures have one scale, the image of the true
# track's.

figure, axes = plt.subplots(2, 3, figsize=(11, 5.4), layout="constrained")
level = None
for ax, sway in zip(axes.flat, (0.0, 0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3), strict=True):
    true = pysas.tracks.perturbed(500, spacing=0.02, start=(-5, 0, 0), sway=sway, correlation=1.0, seed=3)
    raw = pysas.simulate(
        targets, np.ones(4), pulse, tx=true.position, rx=true.position, fs=40e3, t0=0.024, duration=0.006, beam=beam
    )
    echoes = pysas.compress(raw.replace(tx=straight.position, rx=straight.position), window="hann")
    image = pysas.focus(echoes, grid, tol=1e-3)
    peak = np.abs(image.data).max()
    level = level or peak
    loss = 20 * np.log10(peak / level)
    shown = ax.imshow(image.db(level), extent=(-1.2, 1.2, 19.2, 20.8), origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.set(
        title=f"unknown sway of {1e3 * sway:g} mm: {loss:+.1f} dB", xlabel="x (along-track), m", ylabel="y (across-track), m"
    )
figure.colorbar(shown, ax=axes, label="dB relative to the peak with the true track")
plt.show()
