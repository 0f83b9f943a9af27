"""
A first image
=============

Nine targets on the seabed, seen by one transducer on a straight track: echoes are simulated, compressed and imaged, in five
calls. Each target becomes a point a few centimetres wide, whatever its range.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# The sonar is at 100 kHz with 20 kHz of bandwidth. It advances by 2.5 cm a ping, 8 m above the bed, at z = 0, and looks to
# positive y through a beam of 16 degrees.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
track = pysas.tracks.straight(480, spacing=0.025, height=8.0, start=(-6, 0, 0))
beam = pysas.Beam((0, 1, 0), length=0.1, half_angle=np.deg2rad(8), taper=0.5)
x, y = np.meshgrid([-2.0, 0.0, 2.0], [16.0, 19.0, 22.0])
targets = np.stack([x.ravel(), y.ravel(), np.zeros(9)], axis=1)

raw = pysas.simulate(
    targets,
    np.ones(9),
    pulse,
    tx=track.position,
    rx=track.position,
    fs=40e3,
    t0=0.02,
    duration=0.014,
    beam=beam,
    snr_db=0,
    seed=1,
)
print(raw)

# %%
# `pysas.compress` makes a sharp echo of each pulse, and `pysas.focus` sums the echoes of all pings at each pixel of a grid,
# to a relative error of `tol`.

echoes = pysas.compress(raw, window="hann")
grid = pysas.Grid.plane(np.arange(-3, 3, 0.0125), np.arange(15, 23, 0.0125), z=0.0)
image = pysas.focus(echoes, grid, tol=1e-3)
print(image)

# %%
# On the left what was recorded, in which a target is a curve as long as the beam is wide; on the right the image, with
# circles about the true places.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5.2), layout="constrained")
magnitude = np.abs(echoes.data).T
slant = echoes.c / 2 * (echoes.t0 + np.arange(echoes.n_sample) / echoes.fs)
shown = left.imshow(
    20 * np.log10(magnitude / magnitude.max() + 1e-9),
    extent=(track.position[0, 0], track.position[-1, 0], slant[0], slant[-1]),
    origin="lower", aspect="auto", vmin=-40, vmax=0, cmap="inferno",
)  # fmt: skip
left.set(xlabel="place of the sonar along the track, m", ylabel="slant range, m", title="compressed echoes")
figure.colorbar(shown, ax=left, label="dB relative to the peak")
pysas.plot.quicklook(image, ax=right, targets=targets, title="image: each target is a point")
plt.show()
