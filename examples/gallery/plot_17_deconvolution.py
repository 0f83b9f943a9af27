"""
Deconvolution of a circular image
=================================

The image of a full circle is the scene convolved with a point spread function that theory knows: rings about each point. A Wiener
filter takes the rings away as far as noise allows, and `pysas.circular.fit_points` finds the points themselves.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Six points near the centre of a circle, in noise 20 dB below the strongest of them.

pulse = pysas.LFM(fc=50e3, bandwidth=15e3, duration=1e-3)
psf = pysas.circular.PointSpread(pulse)
step, size = 0.0025, 161
positions = np.array([[-0.08, -0.06], [0.06, -0.08], [0.0, 0.0], [0.012, 0.018], [0.09, 0.05], [-0.07, 0.08]])
amplitudes = np.array([1.0, 0.8, 1.0, 0.7, 0.5, 0.6])
axis = step * (np.arange(size) - size // 2)
spread = sum(
    a * psf.exact(np.hypot(axis[None, :] - p[0], axis[:, None] - p[1])) for a, p in zip(amplitudes, positions, strict=True)
)
rng = np.random.default_rng(9)
image = spread + 0.03 * rng.standard_normal((size, size))

# %%
# The filter, and a fit of points.

sharp = pysas.circular.wiener(image, psf, step, noise=0.03)
found = pysas.circular.fit_points(image, psf, step, noise=0.03)
print(found)

figure, axes = plt.subplots(1, 2, figsize=(11, 4.8), sharey=True, layout="constrained")
extent = 1e2 * np.array([axis[0], axis[-1], axis[0], axis[-1]])
for ax, (name, data) in zip(axes, {"the image, with its rings": image, "after a Wiener filter": sharp}.items(), strict=True):
    level = 20 * np.log10(np.abs(data) / np.abs(data).max() + 1e-9)
    shown = ax.imshow(level, extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.plot(*(1e2 * positions.T), "o", mfc="none", mec="deepskyblue", ms=12, mew=0.8)
    ax.set(title=name, xlabel="x, cm")
axes[0].set_ylabel("y, cm")
figure.colorbar(shown, ax=axes, label="dB relative to the peak; circles: true places")
plt.show()
