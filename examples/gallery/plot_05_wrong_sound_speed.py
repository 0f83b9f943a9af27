"""
A wrong sound speed
===================

The sound speed turns times into ranges. Where it is wrong a target lies at another range, which an image does not show, and
its echoes are summed along the wrong curve, which it does: the target is blurred along the track.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# A straight track and one target, in water of 1500 m/s.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
track = pysas.tracks.straight(600, spacing=0.02, start=(-6, 0, 0))
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(8), taper=0.5)
raw = pysas.simulate(
    [[0, 25, 0]], [1.0], pulse, c=1500.0, tx=track.position, rx=track.position, fs=40e3, t0=0.03, duration=0.008, beam=beam
)
echoes = pysas.compress(raw, window="hann")

# %%
# It is imaged with speeds from 15 m/s too low to 30 m/s too high: that is a wrong temperature by 5 to 10 degrees.

speeds = [1485.0, 1500.0, 1515.0, 1530.0]
figure, axes = plt.subplots(1, len(speeds), figsize=(11, 4), layout="constrained")
right = np.abs(pysas.focus(echoes, pysas.Grid.points([[0, 25, 0]])).data).max()
for ax, c in zip(axes, speeds, strict=True):
    middle = 25 * c / 1500
    grid = pysas.Grid.plane(np.arange(-0.5, 0.5, 0.005), np.arange(middle - 0.5, middle + 0.5, 0.005))
    image = pysas.focus(echoes.replace(c=c), grid, tol=1e-3)
    place = pysas.metrics.peak_position(image, near=(0.0, middle), radius=0.4)
    peak = np.abs(image.data).max()
    extent = (-0.5, 0.5, middle - 0.5, middle + 0.5)
    shown = ax.imshow(image.db(right), extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.set(title=f"c {c:.0f} m/s:\n{place[1] - 25:+.2f} m, {20 * np.log10(peak / right):+.1f} dB", xlabel="x (along-track), m")
    print(f"c {c:.0f} m/s: peak {20 * np.log10(peak / right):+.1f} dB, range {place[1]:.3f} m")
axes[0].set_ylabel("y (across-track), m")
figure.colorbar(shown, ax=axes, label="dB relative to the peak at the true speed", shrink=0.7)
plt.show()

# %%
# The error of the phase at the edge of the aperture is what blurs: a sound speed wrong by a share e bends the curve of an
# echo's ranges by e twice, once in the time and once in the range, so that at a half-angle a it errs by 2 e r (1/cos a - 1),
# each way.

half_angle = np.deg2rad(6)  # where the beam's taper weighs a half
for c in speeds:
    error = 2 * 25 * (c / 1500 - 1) * (1 / np.cos(half_angle) - 1)
    print(f"c {c:.0f} m/s: {2 * error / 0.015:+.2f} wavelengths at the edge, both ways")
