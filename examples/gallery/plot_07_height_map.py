"""
Relief: a height map against a flat bed
=======================================

A straight track images points at any height sharply. One that sways does not: the sway changes the range by another amount
where a point stands higher. A depth map given as the grid's heights makes the image sharp, and puts its pixels where they
belong.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# A mound of 2 m on a flat bed, with points on it, seen by a sonar 10 m above the bed that sways by 10 cm.

x, y = np.arange(-2.4, 2.4, 0.01), np.arange(13.0, 19.0, 0.01)


def height(x, y):
    """The bed, z in m above the plane."""
    return 2.0 * np.exp(-((x**2 + (y - 16) ** 2) / 1.5**2))


px, py = (a.ravel() for a in np.meshgrid(np.arange(-2, 2.1, 0.8), np.arange(13.5, 18.6, 0.8)))
points = np.stack([px, py, height(px, py)], axis=1)
track = pysas.tracks.perturbed(500, spacing=0.02, height=10.0, start=(-5, 0, 0), sway=0.10, correlation=2.0, seed=4)
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(7), taper=0.5)
pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
raw = pysas.simulate(
    points, np.ones(len(points)), pulse, tx=track.position, rx=track.position, fs=40e3, t0=0.018, duration=0.014, beam=beam
)
echoes = pysas.compress(raw, window="hann")

# %%
# One grid is the plane z = 0, the other the surface of the map.

grids = {"flat": pysas.Grid.plane(x, y, z=0.0), "height map": pysas.Grid.surface(x, y, height(x, y[:, None]))}
images = {name: pysas.focus(echoes, grid, tol=1e-3) for name, grid in grids.items()}
peak = max(np.abs(image.data).max() for image in images.values())

figure, axes = plt.subplots(1, 3, figsize=(11, 6), sharey=True, layout="constrained")
extent = (x[0], x[-1], y[0], y[-1])
relief = axes[0].imshow(height(x, y[:, None]), extent=extent, origin="lower", cmap="viridis")
axes[0].set(title="the bed", ylabel="y (across-track), m")
figure.colorbar(relief, ax=axes[0], label="height, m", location="bottom")
for ax, (name, image) in zip(axes[1:], images.items(), strict=True):
    shown = ax.imshow(image.db(peak), extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.plot(px, py, "o", mfc="none", mec="deepskyblue", ms=10, mew=0.6)
    ax.set_title({"flat": "imaged as if it were flat", "height map": "imaged on its height map"}[name])
for ax in axes:
    ax.set_xlabel("x (along-track), m")
figure.colorbar(shown, ax=axes[1:], label="dB relative to the peak; circles: true places", location="bottom")
plt.show()
