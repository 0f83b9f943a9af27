"""
What a plan leaves out
======================

Before anything is summed the planner looks at the scene: which terms can be left out, which engine is faster, what ``tol``
allows. A plan says all of this in words, and images many data sets of one geometry.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Two scenes of the same size: one that needs all there is, and one with a beam, a mask and a record longer than the image
# needs.

track = pysas.tracks.perturbed(800, spacing=0.025, start=(-10, 0, 0), sway=0.05, correlation=4.0, seed=8)
rng = np.random.default_rng(8)
data = rng.standard_normal((800, 1600, 2)).astype(np.float32).view(np.complex64)[..., 0]
common = {"fs": 40e3, "fc": 100e3, "bandwidth": 20e3, "tx": track.position, "rx": track.position, "t0": 0.01}
x, y = np.arange(-8, 8, 0.05), np.arange(10, 30, 0.05)
every = pysas.plan(pysas.Echoes(data, **common), pysas.Grid.plane(x, y), tol=1e-3)

beam = pysas.Beam((0, 1, 0), length=0.1, half_angle=np.deg2rad(8), taper=0.5)
middle = np.hypot(x / 8, (y[:, None] - 20) / 10) < 1
fewer = pysas.plan(pysas.Echoes(data, beam=beam, **common), pysas.Grid.plane(x, y, mask=middle), tol=1e-3)
fewer.explain()

# %%
# How much of all terms (ping, channel and pixel) each sums.

images = {"no beam, all pixels": every(data), "a beam and a mask": fewer(data)}
shares = {name: 1 - image.report.share_left_out for name, image in images.items()}
figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), layout="constrained")
for ax, (name, image) in zip(axes[:2], images.items(), strict=True):
    shown = ax.imshow(image.db(), extent=(-8, 8, 10, 30), origin="lower", vmin=-40, vmax=0, cmap="inferno", aspect="auto")
    ax.set(title=f"noise: {name}", xlabel="x (along-track), m", ylabel="y (across-track), m")
figure.colorbar(shown, ax=axes[1], label="dB relative to the peak")
axes[2].bar(list(shares), [100 * share for share in shares.values()])
axes[2].set(title="terms that are summed", ylabel="% of all", ylim=(0, 105))
plt.show()
