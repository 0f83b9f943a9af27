"""
A point's response under windows
================================

What a point target looks like in detail: the width of its main lobe and the level of its side lobes, in range by the window
of the compression, along the track by the taper of the beam. A window buys low side lobes with width.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# One point 20 m away in the middle of a straight track.

pulse = pysas.LFM(fc=100e3, bandwidth=20e3, duration=1e-3, window="tukey", window_parameter=0.05)
track = pysas.tracks.straight(400, spacing=0.02, start=(-3.99, 0, 0))
beam = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(7.5))
raw = pysas.simulate(
    [[0, 20, 0]], [1.0], pulse, tx=track.position, rx=track.position, fs=80e3, t0=0.024, duration=0.006, beam=beam
)
grid = pysas.Grid.plane(np.arange(-0.4, 0.4, 0.0025), np.arange(19.6, 20.4, 0.0025))

# %%
# The filter is the pulse's inverse within its band (``inverse``), so that the window alone shapes the spectrum: a matched
# filter leaves the ripple of a short sweep's spectrum in it. `pysas.metrics` finds the peak between pixels, takes cuts
# through it and measures them: the resolution (IRW, the width at -3 dB), the peak side lobe (PSLR) and all side lobes
# together (ISLR).

figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
print(f"{'':24}{'IRW, mm':>10}{'PSLR, dB':>10}{'ISLR, dB':>10}")


def measure(ax, image, name, axis):
    """Draw a cut in dB and print what is measured of it."""
    place = pysas.metrics.peak_position(image, near=(0.0, 20.0), radius=0.1)
    values, step = pysas.metrics.cut(image, place, axis)
    width, peak, total = pysas.metrics.irw(values, step), pysas.metrics.pslr(values), pysas.metrics.islr(values)
    print(f"{name:24}{1e3 * width:10.1f}{peak:10.1f}{total:10.1f}")
    magnitude = np.abs(values)
    offset = 1e2 * step * (np.arange(magnitude.size) - np.argmax(magnitude))
    ax.plot(offset, 20 * np.log10(magnitude / magnitude.max() + 1e-9), label=f"{name}: {1e3 * width:.0f} mm, {peak:.0f} dB")


for window in ("boxcar", "hamming", ("taylor", 4, 35), "hann"):
    image = pysas.focus(pysas.compress(raw, window=window, inverse=1e-3), grid, tol=1e-4)
    measure(axes[0], image, str(window), "y")

for taper in (0.0, 0.5, 1.0):
    narrow = pysas.Beam((0, 1, 0), length=0.08, half_angle=np.deg2rad(7.5), taper=taper)
    image = pysas.focus(pysas.compress(raw.replace(beam=narrow)), grid, tol=1e-4)
    measure(axes[1], image, f"taper {taper}", "x")

for ax, name, way in zip(axes, ("windows of the compression", "tapers of the beam"), ("y", "x"), strict=True):
    ax.set(xlabel=f"offset in {way}, cm", title=f"a point's response in {way}: {name}", ylim=(-70, 2), xlim=(-25, 25))
    ax.grid(alpha=0.3)
    ax.legend(fontsize="small", loc="lower center")
axes[0].set_ylabel("dB relative to the peak")
plt.show()
