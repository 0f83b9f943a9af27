"""
An array that goes too fast
===========================

Phase centres should lie no farther apart than a quarter of the element's length. An array gives one every half spacing of its
receivers, and covers so much the more way in a ping; where it goes faster than its own length allows, the gaps make ghosts.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Sixteen receivers of 4 cm, phase centres every 2 cm: one ping covers 32 cm. The sonar advances by 32, 48 and 64 cm a ping.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(10), taper=0.5)
grid = pysas.Grid.plane(np.arange(-1.5, 1.5, 0.01), np.arange(19.5, 20.5, 0.01))
figure, axes = plt.subplots(3, 1, figsize=(9, 8.4), sharex=True, layout="constrained")
for ax, advance in zip(axes, (0.32, 0.48, 0.64), strict=True):
    n = round(9 / advance)
    track = pysas.tracks.straight(n, spacing=advance, start=(-advance * (n - 1) / 2, 0, 0))
    receivers = pysas.tracks.array(track, n_channel=16, spacing=0.04)
    raw = pysas.simulate(
        [[0, 20, 0]], [1.0], pulse, tx=track.position, rx=receivers, velocity=track.velocity, fs=40e3, t0=0.025, duration=0.004,
        beam=beam,
    )  # fmt: skip
    image = pysas.focus(pysas.compress(raw, window="hann"), grid, tol=1e-3)
    beside = np.abs(grid.coordinates()[:, 0]) > 0.25
    ghost = image.db().ravel()[beside].max()
    shown = ax.imshow(image.db(), extent=(-1.5, 1.5, 19.5, 20.5), origin="lower", vmin=-50, vmax=0, cmap="inferno")
    ax.set(title=f"advance of {100 * advance:.0f} cm a ping: ghosts at {ghost:.0f} dB", ylabel="y (across-track), m")
axes[-1].set_xlabel("x (along-track), m")
figure.colorbar(shown, ax=axes, label="dB relative to the peak")
plt.show()

# %%
# The checks say so before anything is imaged.

print(*(finding for finding in pysas.inspect(raw) if finding.name == "along-track sampling"), sep="\n")
