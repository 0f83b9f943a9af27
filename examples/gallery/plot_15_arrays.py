"""
Arrays in, arrays out, and xarray
=================================

Samples of your own are any complex array that NumPy can show, an image is one too. With ``xarray`` installed an image becomes
a labelled array, whose axes are in metres.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Base-band samples of your own: a point at travel time tau contributes p(t - tau) exp(-2j pi fc tau), here with a sinc for p.

fs, fc, c = 50e3, 75e3, 1480.0
x = np.arange(-3, 3, 0.02)
tx = np.stack([x, 0 * x, 0 * x], axis=1)
time = 0.018 + np.arange(400) / fs
data = np.zeros((len(x), 400), np.complex64)
for point, amplitude in (([0.4, 16.0, 0.0], 1.0), ([-0.6, 17.2, 0.0], 0.5j)):
    tau = 2 * np.linalg.norm(tx - point, axis=1)[:, None] / c
    data += amplitude * np.sinc(30e3 * (time - tau)) * np.exp(-2j * np.pi * fc * tau)

# %%
# Plain arrays in and a plain array out: pixels are an array of places, of any shape.

px, py = np.meshgrid(np.arange(-1.5, 1.5, 0.01), np.arange(15, 18, 0.01))
pixels = np.stack([px, py, 0 * px], axis=-1)
plain = pysas.backproject_arrays(data, pixels, fs=fs, fc=fc, c=c, tx=tx, rx=tx, t0=0.018, bandwidth=30e3)
print(type(plain), plain.dtype, plain.shape)

# %%
# The same with `pysas.Echoes` and `pysas.Grid`, which keep what belongs to the samples; `np.asarray` and indexing give
# pixels.

echoes = pysas.Echoes(data, fs=fs, fc=fc, c=c, tx=tx, rx=tx, t0=0.018, bandwidth=30e3)
image = pysas.backproject(echoes, pysas.Grid.plane(np.arange(-1.5, 1.5, 0.01), np.arange(15, 18, 0.01)))
print("largest difference of the two:", np.abs(np.asarray(image) - plain).max())

# %%
# A labelled array selects, averages and draws by metres.

labelled = image.to_xarray()
print(labelled.sel(x=0.4, y=16.0, method="nearest").item())
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
(20 * np.log10(np.abs(labelled) / np.abs(labelled).max())).plot(
    ax=left, vmin=-40, vmax=0, cmap="inferno", cbar_kwargs={"label": "dB relative to the peak"}
)
left.set(title="an image as an xarray.DataArray", aspect="equal")
for y in (16.0, 17.2):
    np.abs(labelled).sel(y=y, method="nearest").plot(ax=right, label=f"y = {y} m")
right.set(title="lines of it, by their place in metres", ylabel="magnitude")
right.legend()
plt.show()
