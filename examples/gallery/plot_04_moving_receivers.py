"""
Moving receivers against stop-and-hop
=====================================

While an echo travels the sonar moves on. At 2.5 m/s and 40 m of range that is 13 cm, nine wavelengths at 100 kHz. Taken to
stand still until the echo is there (stop-and-hop), an array puts targets beside their places, and farther off the longer the
way is.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Eight receivers behind a transmitter, at 2.5 m/s: the simulation solves the exact delay of receivers that move.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
track = pysas.tracks.straight(60, spacing=0.2, speed=2.5, start=(-6, 0, 0))
receivers = pysas.tracks.array(track, n_channel=8, spacing=0.05)
beam = pysas.Beam((0, 1, 0), length=0.1, half_angle=np.deg2rad(7), taper=0.5)
targets = np.array([[0.0, 12.0, 0.0], [0.0, 24.0, 0.0], [0.0, 36.0, 0.0]])
raw = pysas.simulate(
    targets,
    np.ones(3),
    pulse,
    tx=track.position,
    rx=receivers,
    velocity=track.velocity,
    fs=40e3,
    t0=0.015,
    duration=0.036,
    beam=beam,
)
moving = pysas.compress(raw, window="hann")

# %%
# The same echoes, once with the receivers' velocity and once without it.

stopped = moving.replace(velocity=None)
figure, axes = plt.subplots(2, 3, figsize=(11, 5.2), layout="constrained")
for row, (name, echoes) in enumerate({"moving receivers": moving, "stop-and-hop": stopped}.items()):
    for ax, (x, y, _) in zip(axes[row], targets, strict=True):
        grid = pysas.Grid.plane(np.arange(x - 0.3, x + 0.3, 0.005), np.arange(y - 0.2, y + 0.2, 0.005))
        image = pysas.focus(echoes, grid, tol=1e-3)
        place = pysas.metrics.peak_position(image, near=(x, y), radius=0.25)
        extent = (x - 0.3, x + 0.3, y - 0.2, y + 0.2)
        shown = ax.imshow(image.db(), extent=extent, origin="lower", vmin=-40, vmax=0, cmap="inferno")
        ax.plot(x, y, "o", mfc="none", mec="deepskyblue", ms=14)
        ax.set(title=f"{name}: {1e3 * (place[0] - x):+.0f} mm", xlabel="x (along-track), m", ylabel="y (across-track), m")
        print(f"{name:17} {y:4.0f} m: {1e3 * (place[0] - x):+7.1f} mm along, {1e3 * (place[1] - y):+6.1f} mm across the track")
figure.colorbar(shown, ax=axes, label="dB relative to the peak; circles: true places")
plt.show()
