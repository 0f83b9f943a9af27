"""
Omega-k and back-projection side by side
========================================

On a straight, evenly sampled track the omega-k algorithm images by Fourier transforms. It shares no code with the engine and
makes the same image; on a track that sways by 2 mm it no longer applies, where back-projection takes the track as it is.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Seven targets, a monostatic sonar, a straight track in the plane of the targets. The beam shapes the echoes; for the images
# it is left out, as omega-k knows none and takes echoes as they were recorded.

pulse = pysas.LFM(fc=60e3, bandwidth=20e3, duration=1e-3, window="tukey")
track = pysas.tracks.straight(512, spacing=0.02, start=(-5.11, 0, 0))
rng = np.random.default_rng(7)
targets = np.column_stack([rng.uniform(-1.5, 1.5, 7), rng.uniform(15, 18, 7), np.zeros(7)])
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(10), taper=1.0)
raw = pysas.simulate(
    targets, np.ones(7), pulse, tx=track.position, rx=track.position, fs=40e3, t0=0.018, duration=0.009, beam=beam
)
echoes = pysas.compress(raw, window="hann").replace(beam=None)

# %%
# Omega-k chooses its own pixels; back-projection is asked for the same ones. The two weigh the ends of the aperture
# differently unless omega-k is told to weigh as a sum over pings does.

omega = pysas.reference.omega_k(echoes, weight="backprojection").crop(x=(-2, 2), y=(14.5, 18.5))
sums = pysas.focus(echoes, omega.grid, tol=1e-4)
factor = np.vdot(omega.data, sums.data) / np.vdot(omega.data, omega.data)
difference = np.linalg.norm(sums.data - factor * omega.data) / np.linalg.norm(sums.data)
print(f"difference of the images: {difference:.1e} of their norm")

figure, axes = plt.subplots(1, 3, figsize=(12, 4.6), sharey=True, layout="constrained")
peak = np.abs(sums.data).max()
apart = sums.data - factor * omega.data
shown_data = {"omega-k": factor * omega.data, "back-projection": sums.data, "difference": apart}
for ax, (name, data) in zip(axes, shown_data.items(), strict=True):
    level = 20 * np.log10(np.abs(data) / peak + 1e-9)
    shown = ax.imshow(level, extent=(-2, 2, 14.5, 18.5), origin="lower", vmin=-60, vmax=0, cmap="inferno")
    ax.set(title=name + (f": {difference:.0e} of the norm" if data is apart else ""), xlabel="x (along-track), m")
axes[0].set_ylabel("y (slant range), m")
figure.colorbar(shown, ax=axes, label="dB relative to the peak")
plt.show()

# %%
# What it cannot take it refuses.

swaying = pysas.tracks.perturbed(512, spacing=0.02, start=(-5.11, 0, 0), sway=2e-3, seed=1)
try:
    pysas.reference.omega_k(echoes.replace(tx=swaying.position, rx=swaying.position))
except ValueError as error:
    print(error)
