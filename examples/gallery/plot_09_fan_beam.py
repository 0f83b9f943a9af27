"""
A fan beam and its taper
========================

`pysas.Beam` says which pixels a ping lights, and how much a term weighs there. What lies outside of it costs no time and adds
no noise; how the weight falls at its edges decides the side lobes along the track.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Three fans of 16 degrees: with hard edges, and with a weight that falls over the outer half or over all of it.

half_angle = np.deg2rad(8)
fans = {taper: pysas.Beam((0, 1, 0), length=0.08, half_angle=half_angle, taper=taper) for taper in (0.0, 0.5, 1.0)}
track = pysas.tracks.straight(500, spacing=0.02, start=(-5, 0, 0))
pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey")
raw = pysas.simulate(
    [[0, 20, 0], [0.25, 20, 0]], [1.0, 0.03], pulse, tx=track.position, rx=track.position, fs=40e3, t0=0.024, duration=0.006
)
echoes = pysas.compress(raw, window="hann")

# %%
# What one ping lights: the image of a single ping whose trace is 1 everywhere is the beam's weight on the ground.

ground = pysas.Grid.plane(np.arange(-6, 6, 0.05), np.arange(0.5, 30, 0.05))
flat = pysas.Echoes(
    np.ones((1, 4000), np.complex64), fs=60e3, fc=1.0, tx=[[0, 0, 0]], rx=[[0, 0, 0]], bandwidth=30e3, beam=fans[0.5]
)  # fmt: skip
lit = np.abs(pysas.backproject(flat, ground, tol=1e-3).data)

# %%
# A target with one 30 dB weaker at 25 cm beside it: the side lobes of hard edges hide it, those of the taper do not.

figure, axes = plt.subplots(1, 4, figsize=(12, 4), layout="constrained", width_ratios=[1, 1, 1, 1])
drawn = axes[0].imshow(lit, extent=(-6, 6, 0.5, 30), origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=1)
axes[0].set(title="weight of one ping, taper 0.5", xlabel="x (along-track), m", ylabel="y (across-track), m")
figure.colorbar(drawn, ax=axes[0])
grid = pysas.Grid.plane(np.arange(-0.4, 0.6, 0.005), np.arange(19.8, 20.2, 0.005))
for ax, (taper, fan) in zip(axes[1:], fans.items(), strict=True):
    image = pysas.focus(echoes.replace(beam=fan), grid, tol=1e-4)
    shown = ax.imshow(
        image.db(), extent=(-0.4, 0.6, 19.8, 20.2), origin="lower", vmin=-50, vmax=0, cmap="inferno", aspect="auto"
    )
    ax.set(title=f"taper {taper}: two targets", xlabel="x (along-track), m")
    share = image.report.share_left_out
    print(f"taper {taper}: {image.report.terms:.3g} terms, {100 * share:.0f} % left out for the beam")
figure.colorbar(shown, ax=axes[3], label="dB relative to the peak")
plt.show()
