"""
A seabed with ripples, an object and its shadow
===============================================

What a side-looking sonar sees of an object is its highlight and, behind it, the shadow it casts on the seabed. Ripples are
bright where they face the sonar.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# A seabed of random scatterers, stronger where ripples face the sonar, 6 m below it. A cylinder 2 m long and 0.6 m high lies
# on the bed: points behind it are dark, points on it are bright.

height, middle, rise = 6.0, 18.0, 0.6
points, strength = pysas.simulation.seabed((-5, 5), (14, 24), density=350.0, roughness=0.01, seed=5)
ripples = 1 + 0.6 * np.sin(2 * np.pi * (points[:, 1] + 0.3 * np.sin(points[:, 0])) / 0.8)
behind = points[:, 1] - middle
shadow = (np.abs(points[:, 0]) < 1) & (behind > 0) & (behind < rise * points[:, 1] / height)
points, strength = points[~shadow], (ripples * strength)[~shadow]
rng = np.random.default_rng(5)
along, around = rng.uniform(-1, 1, 300), rng.uniform(0, np.pi / 2, 300)
hull = np.stack([along, middle - 0.3 * np.cos(around), 0.3 + 0.3 * np.sin(around)], axis=1)
points = np.concatenate([points, hull])
strength = np.concatenate([strength, 4 * rng.standard_normal(300)])

# %%
# Echoes of one transducer, at 100 kHz with 30 kHz of bandwidth.

track = pysas.tracks.straight(320, spacing=0.025, height=height, start=(-4, 0, 0))
beam = pysas.Beam((0, 1, 0), length=0.1, half_angle=np.deg2rad(6), taper=0.5)
pulse = pysas.LFM(fc=100e3, bandwidth=30e3, duration=0.4e-3, window="tukey", window_parameter=0.3)
raw = pysas.simulate(
    points,
    strength,
    pulse,
    tx=track.position,
    rx=track.position,
    fs=60e3,
    t0=0.0205,
    duration=0.0115,
    beam=beam,
    snr_db=25,
    seed=5,
)
grid = pysas.Grid.plane(np.arange(-2.5, 2.5, 0.0125), np.arange(15.5, 22.5, 0.0125))
image = pysas.focus(pysas.compress(raw, window="hann"), grid, tol=1e-2)

# %%
# The level of 0 dB is a percentile, not the peak, so that the few brightest pixels do not darken the rest.

figure, ax = plt.subplots(figsize=(7, 7), layout="constrained")
pysas.plot.quicklook(
    image, ax=ax, reference="percentile", dynamic_range=35, title="a cylinder on a rippled bed, and its shadow"
)
plt.show()
