"""
Circular SAS and its point spread function
==========================================

A sonar that circles a scene sees each point from all sides: its response is a Bessel function, a peak a fifth of a wavelength
wide among rings. The image of a point is held against the theory, which shares no code with the engine.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# 1600 pings on a circle of 10 m, and a point in its middle.

pulse = pysas.LFM(fc=50e3, bandwidth=15e3, duration=1e-3, window="tukey")
track = pysas.tracks.circular(1600, radius=10.0, height=5.0)
raw = pysas.simulate(
    [[0, 0, 0]], [1.0], pulse, tx=track.position, rx=track.position, fs=45e3, t0=0.0135, duration=0.004, dtype=np.complex128
)
step = np.arange(-0.12, 0.12, 0.001)
image = pysas.focus(pysas.compress(raw), pysas.Grid.plane(step, step), tol=1e-5)

# %%
# The theory is in the plane of the circle. Seen from 5 m above, ranges change with the cosine of the grazing angle: distances
# count 10/sqrt(125) of what they are.

theory = pysas.circular.PointSpread(pulse)
cosine = 10 / np.hypot(10, 5)
row = image.data[image.data.shape[0] // 2].real / 1600
expected = theory.exact(cosine * step)
bessel = theory.approximate(cosine * step)
print(f"largest difference from the exact point spread function: {np.abs(row - expected).max():.1e} of the peak")

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
shown = left.imshow(image.db(), extent=(-12, 12, -12, 12), origin="lower", vmin=-40, vmax=0, cmap="inferno")
left.set(title="a point seen from all sides", xlabel="x, cm", ylabel="y, cm")
figure.colorbar(shown, ax=left, label="dB relative to the peak")
right.plot(1e2 * step, row, lw=3, alpha=0.5, label="image")
right.plot(1e2 * step, expected, "k", lw=1, label="theory, any pulse")
right.plot(1e2 * step, bessel, "C1--", lw=1, label="envelope times J0(2 k r)")
right.set(title="cut through it, and what theory says", xlabel="x, cm", ylabel="relative to the peak")
right.legend()
right.grid(alpha=0.3)
plt.show()
