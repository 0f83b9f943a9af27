"""A strip of 60 m of sea bed with targets, imaged from a stream of pings: writes long_track.png and prints what it found.

An array of 32 receivers, 5 cm apart, sways by 5 cm and yaws by 5 mrad while it advances by 0.8 m a ping; a fan of 15 degrees
whose outer half fades. The bed is rough (random points, more of them where ripples face the sonar); nine targets stand on it.
"""

import numpy as np

import pysas

C, FC, FS, BAND, RECEIVERS = 1500.0, 100e3, 36e3, 30e3, 32
LENGTH, NEAR, FAR, HEIGHT, PIXEL, TOL = 60.0, 12.0, 42.0, 6.0, 0.025, 1e-2
HALF_ANGLE = np.deg2rad(7.5)
TARGETS = np.array([[x, y, 0.0] for x in (9.3, 29.9, 50.1) for y in (16.2, 26.7, 37.4)])


def bed(rng, count=40_000):
    """Places and amplitudes of random points on the bed, and of the targets."""
    x, y = rng.uniform(-2, LENGTH + 2, count), rng.uniform(NEAR - 1, FAR + 1, count)
    ripples = 1 + 0.7 * np.sin(2 * np.pi * (y + 1.5 * np.sin(2 * np.pi * x / 25)) / 4)
    amplitude = 0.05 * ripples * rng.standard_normal(count)
    return np.concatenate([np.stack([x, y, 0 * x], axis=1), TARGETS]), np.concatenate([amplitude, np.full(len(TARGETS), 3.0)])


def pings(rng, count=4):
    """Compressed echoes, a few pings at a time, with the navigation they have."""
    pulse = pysas.LFM(FC, BAND, 2e-3)
    points, amplitudes = bed(rng)
    reach = np.hypot(FAR, HEIGHT) * np.tan(HALF_ANGLE + 5e-3)
    track = np.arange(-reach, LENGTH + reach, RECEIVERS * 0.025)
    for begin in range(0, track.size, count):
        x = track[begin : begin + count]
        tx = np.stack([x, 0.05 * np.sin(2 * np.pi * x / 17), HEIGHT + 0.03 * np.sin(2 * np.pi * x / 11)], axis=1)
        yaw = 5e-3 * np.sin(2 * np.pi * x / 13)
        axis = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
        look = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=1)
        rx = tx[:, None] + 0.05 * (np.arange(RECEIVERS) - (RECEIVERS - 1) / 2)[:, None] * axis[:, None]
        near = np.abs(points[:, 0] - x.mean()) < reach + 3
        raw = pysas.simulate(
            points[near], amplitudes[near], pulse, tx=tx, rx=rx, fs=FS, fc=FC, c=C, t0=2 * NEAR / C - 1e-3,
            duration=2 * (np.hypot(FAR, HEIGHT) / np.cos(HALF_ANGLE) - NEAR) / C + 5e-3,
            velocity=np.tile([RECEIVERS * 0.025 * 4, 0, 0], (x.size, 1)),
            beam=pysas.Beam(look, 0.05, HALF_ANGLE, "fan", 0.5, axis),
        )  # fmt: skip
        yield pysas.compress(raw, "hann")


def main():
    import matplotlib.pyplot as plt

    strip = pysas.Strip(np.arange(NEAR, FAR, PIXEL), PIXEL, 10.0, tol=TOL)
    images = [im for im in strip.stream(pings(np.random.default_rng(1))) if 0 <= im.grid.axes["x"][0] < LENGTH]
    data = np.concatenate([im.data for im in images], axis=1)
    x, y = np.concatenate([im.grid.axes["x"] for im in images]), images[0].grid.axes["y"]
    print(f"{len(images)} images, {data.shape[1]} x {data.shape[0]} pixels, {sum(im.report.terms for im in images):.3g} terms")
    whole = pysas.Image(data, pysas.Grid.plane(x, y), images[0].report, FC, C)
    for target in TARGETS:
        found = pysas.metrics.peak_position(whole, target[:2], 0.3)
        print(f"target at {target[0]:6.3f}, {target[1]:6.3f} m: found {1e3 * np.hypot(*(found - target[:2])):.2f} mm away")
    level = 20 * np.log10(np.maximum(np.abs(data), 1e-9))
    level -= np.percentile(level, 99.5)
    plt.figure(figsize=(12, 6.4))
    plt.imshow(level, extent=(x[0], x[-1], y[0], y[-1]), origin="lower", cmap="afmhot", vmin=-40, vmax=10, aspect="equal")
    plt.colorbar(label="dB above the 99.5th percentile", shrink=0.8)
    for im in images[1:]:
        plt.axvline(im.grid.axes["x"][0], color="w", lw=0.2)
    plt.xlabel("along track, m")
    plt.ylabel("across track, m")
    plt.tight_layout()
    plt.savefig("long_track.png", dpi=150)


if __name__ == "__main__":
    main()
