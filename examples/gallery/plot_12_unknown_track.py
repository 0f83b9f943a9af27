"""
A track found from the echoes
=============================

Navigation knows a track to centimetres, an image needs it to fractions of a millimetre. Where the arrays of neighbouring
pings overlap, both heard the same seabed from the same place: `pysas.micronavigate` goes from there to the track, and
`pysas.autofocus` sharpens what bright points are left to say.
"""

import matplotlib.pyplot as plt
import numpy as np

import pysas

# %%
# Twelve receivers, of whose phase centres four overlap from ping to ping, 8 m above a rough seabed with five targets. The
# sonar sways by 5 cm; its inertial system is wrong by 2 cm/s.

fc, band, length, spacing, depth, n = 100e3, 20e3, 0.10, 0.05, 8.0, 44
half_angle = np.arcsin(1500 / fc / length)  # the transmitter's first null
advance = (12 - 4) * spacing / 2
true = pysas.tracks.perturbed(
    n, advance, start=(-advance * n / 2, 0, 0), sway=0.05, heave=0.01, yaw=0.005, correlation=3.0, seed=1
)
claim = pysas.tracks.inertial(true, speed=2e-2, gyro=2e-5, seed=3)
targets = np.array([[-1.5, 21.5], [1.0, 21.0], [0.0, 23.0], [-1.2, 25.0], [1.4, 25.5]])


def arms(track):
    """Transmitter, receivers, their velocity and the beam of the sonar on a track."""
    along = np.stack([np.cos(track.yaw), np.sin(track.yaw), 0 * track.yaw], axis=1)
    look = np.stack([-np.sin(track.yaw), np.cos(track.yaw), 0 * track.yaw], axis=1)
    beam = pysas.Beam(look, length, half_angle, taper=0.5, axis=along)
    receivers = pysas.tracks.array(track, n_channel=12, spacing=spacing)
    return {"tx": track.position, "rx": receivers, "velocity": track.velocity, "beam": beam}


points, strength = pysas.simulation.seabed((-9, 9), (17.5, 27.5), density=25.0, depth=depth, roughness=0.03, seed=1)
points = np.concatenate([points, np.column_stack([targets, np.full(5, depth)])])
strength = np.concatenate([strength, np.full(5, 40.0)])
pulse = pysas.LFM(fc, band, 0.4e-3, window="tukey", window_parameter=0.5)
raw = pysas.simulate(points, strength, pulse, fs=45e3, t0=2 * 20 / 1500, duration=0.0117, snr_db=10, seed=1, **arms(true))
echoes = pysas.compress(raw.replace(**arms(claim)), window="boxcar", inverse=0.01)

# %%
# The track is found from the claimed one.

prior = pysas.motion.Prior(speed=2e-2, gyro=2e-5)
motion = pysas.micronavigate(echoes, seabed=depth, prior=prior, elements=(length, spacing))
print(motion)
grid = pysas.Grid.plane(np.arange(-2.2, 2.2, 0.02), np.arange(20.2, 26.4, 0.0125), z=depth)
fixed, report = pysas.autofocus(motion.apply(echoes), grid, prior=motion)

# %%
# The image with the claimed track, with the one found and with the true one, on one scale. What lies faintly beside each
# target are ambiguities: receivers of 5 cm sample a transmitter of 10 cm that sparsely.

tracks = {"claimed": echoes, "found": fixed, "true": echoes.replace(**arms(true))}
images = {name: pysas.focus(one, grid, tol=1e-2) for name, one in tracks.items()}
peak = np.abs(images["true"].data).max()
figure, axes = plt.subplots(1, 3, figsize=(11, 5.4), sharey=True, layout="constrained")
for ax, (name, image) in zip(axes, images.items(), strict=True):
    shown = ax.imshow(image.db(peak), extent=(-2.2, 2.2, 20.2, 26.4), origin="lower", vmin=-40, vmax=0, cmap="inferno")
    error = pysas.metrics.track_error(tracks[name], tracks["true"], 24.0, seabed=depth)
    level = 20 * np.log10(np.abs(image.data).max() / peak)
    ax.set(title=f"{name} track: {1e3 * error:.2f} mm off, {level:+.1f} dB", xlabel="x (along-track), m")
axes[0].set_ylabel("y (across-track), m")
figure.colorbar(shown, ax=axes, label="dB relative to the peak with the true track")
plt.show()
