"""
A long track, image by image
============================

`pysas.Strip` images a track as it is recorded: pings go in as they come, and an image comes out as soon as no ping to come
lights it. Memory is that of the beam's footprint, whatever the track's length, and no seam shows between the images.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Pings of eight receivers over 24 m of bed with rows of targets, a few at a time, from a track that sways and yaws.

targets = np.array([[x, y, 0.0] for x in np.arange(1, 24, 2.0) for y in (13.0, 16.0, 19.0)])
track = pysas.tracks.perturbed(190, spacing=0.16, height=6.0, start=(-3, 0, 0), sway=0.05, yaw=5e-3, correlation=4.0, seed=6)
receivers = pysas.tracks.array(track, n_channel=8, spacing=0.04)
pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")


def pings(count=10):
    """Compressed echoes, `count` pings at a time, each with the navigation it has."""
    for first in range(0, track.n_ping, count):
        some = slice(first, first + count)
        yaw = track.yaw[some]
        look = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=1)
        raw = pysas.simulate(
            targets, np.ones(len(targets)), pulse, tx=track.position[some], rx=receivers[some], velocity=track.velocity[some],
            fs=40e3, t0=0.0165, duration=0.013, beam=pysas.Beam(look, 0.08, np.deg2rad(7), taper=0.5),
        )  # fmt: skip
        yield pysas.compress(raw, window="hann")


# %%
# Images of 4 m of track each.

strip = pysas.Strip(np.arange(12.0, 20.0, 0.02), step=0.02, length=4.0, tol=1e-2)
images = list(strip.stream(pings()))
print(f"{len(images)} images of {images[0].data.shape[1]} x {images[0].data.shape[0]} pixels")

# %%
# Side by side they are one picture; thin lines show where they meet.

figure, ax = plt.subplots(figsize=(11, 4.4), layout="constrained")
peak = max(np.abs(image.data).max() for image in images)
for image in images:
    x = image.grid.axes["x"]
    shown = ax.imshow(image.db(peak), extent=(x[0], x[-1] + 0.02, 12, 20), origin="lower", vmin=-40, vmax=0, cmap="inferno")
    ax.axvline(x[0], color="w", lw=0.4)
ax.set(xlim=(0, 24), xlabel="x (along-track), m", ylabel="y (across-track), m", title="24 m of track in images of 4 m")
figure.colorbar(shown, ax=ax, label="dB relative to the peak")
plt.show()
