"""
Error against ``tol``
=====================

You state a relative error and the engine keeps it. Here noise, the hardest data, is imaged at every ``tol`` from 0.1 to
1e-10, and each image is held against the exact sum, `pysas.reference.exact`, at some of its pixels.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Band-limited noise of 600 pings, on a track that sways.

track = pysas.tracks.perturbed(600, spacing=0.02, start=(-6, 0, 0), sway=0.1, correlation=3.0, seed=2)
rng = np.random.default_rng(0)
spectrum = rng.standard_normal((2, 600, 1200)) * (np.abs(np.fft.fftfreq(1200)) < 0.4)
data = np.fft.ifft(spectrum[0] + 1j * spectrum[1])
echoes = pysas.Echoes(data, fs=50e3, fc=100e3, bandwidth=40e3, tx=track.position, rx=track.position, t0=0.016)
grid = pysas.Grid.plane(np.arange(-4, 4, 0.02), np.arange(14, 22, 0.02))

# %%
# The error is that of the norm: of the difference over that of the image, or over that of what was summed where it is larger.
# complex64 data go down to a ``tol`` of 1e-5, complex128 to 1e-10.

pixels = rng.choice(grid.size, 150, replace=False)
exact, level = pysas.reference.exact(echoes, grid, pixels)
found = {}
for dtype, least in ((np.complex64, 5), (np.complex128, 10)):
    typed = echoes.replace(data=data.astype(dtype))
    for tol in 10.0 ** -np.arange(1, least + 1):
        image = pysas.backproject(typed, grid, tol=tol)
        found[dtype.__name__, tol] = pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level)

# %%
# All points lie below the line: what is asked is kept, with some room.

figure, ax = plt.subplots(figsize=(7, 4.6), layout="constrained")
for name, marker in (("complex128", "s-"), ("complex64", "o-")):
    asked = [tol for dtype, tol in found if dtype == name]
    ax.loglog(asked, [found[name, tol] for tol in asked], marker, label=f"measured, {name} data")
ax.loglog([1e-10, 0.1], [1e-10, 0.1], "k--", lw=1, label="what was asked")
ax.set(xlabel="tol asked for", ylabel="relative error measured", title="the error of an image stays below tol")
ax.grid(alpha=0.3)
ax.legend()
plt.show()
