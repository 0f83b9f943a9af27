"""
Deconvolution of a circular image
=================================

The image of a full circle is the scene convolved with a point spread function that theory knows: rings about each point. A
Wiener filter flattens the band that was heard, and noise with it; what lies outside of the band no filter brings back. Where
the scene is known to be points, `pysas.circular.fit_points` finds these.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Six points near the centre of a circle, in noise 30 dB below the strongest of them.

pulse = pysas.LFM(fc=50e3, bandwidth=15e3, duration=1e-3, window="gaussian", window_parameter=3e-5)
psf = pysas.circular.PointSpread(pulse)
step, size = 0.0025, 129
positions = np.array([[-0.07, -0.06], [0.06, -0.07], [0.0, 0.0], [0.012, 0.018], [0.07, 0.05], [-0.07, 0.07]])
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
found = pysas.circular.fit_points(image, psf, step, noise=0.03, most=8)
for place, amplitude in zip(found.position, found.amplitude, strict=True):
    x, y = 1e2 * step * (place - size // 2)
    print(f"found {amplitude:.2f} at {x:+.2f}, {y:+.2f} cm")

figure, axes = plt.subplots(1, 3, figsize=(12, 4.6), sharey=True, layout="constrained")
extent = 1e2 * np.array([axis[0], axis[-1], axis[0], axis[-1]])
for ax, (name, data) in zip(
    axes[:2], {"the image, with its rings": image, "after a Wiener filter": sharp}.items(), strict=True
):
    level = 20 * np.log10(np.abs(data) / np.abs(data).max() + 1e-9)
    shown = ax.imshow(level, extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.plot(*(1e2 * positions.T), "o", mfc="none", mec="deepskyblue", ms=12, mew=0.8)
    ax.set(title=name, xlabel="x, cm")
x, y = 1e2 * step * (found.position.T - size // 2)
drawn = axes[2].scatter(x, y, c=found.amplitude, vmin=0, vmax=1, cmap="viridis", zorder=2)
axes[2].plot(*(1e2 * positions.T), "o", mfc="none", mec="deepskyblue", ms=12, mew=0.8)
axes[2].set(title="the points that were fitted", xlabel="x, cm", aspect="equal", xlim=extent[:2], ylim=extent[2:])
figure.colorbar(drawn, ax=axes[2], label="amplitude", shrink=0.8)
axes[0].set_ylabel("y, cm")
figure.colorbar(shown, ax=axes[:2], shrink=0.8, label="dB relative to the peak; circles: true places")
plt.show()
