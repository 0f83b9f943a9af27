"""Small scenes the engine's tests share; echoes are random and band-limited unless said otherwise."""

import numpy as np

import pysas

C = 1500.0


def noise(pings, channels, samples, band, seed=0, dtype=np.complex128):
    """Random echoes whose spectrum fills |f| <= band/2 (in units of fs) of a record four times as long."""
    rng = np.random.default_rng(seed)
    f = np.fft.fftfreq(4 * samples)
    spectrum = rng.standard_normal((pings, channels, f.size)) + 1j * rng.standard_normal((pings, channels, f.size))
    data = np.fft.ifft(spectrum * (np.abs(f) <= band / 2))[..., :samples]
    return (data / np.sqrt(np.mean(np.abs(data) ** 2))).astype(dtype)


def survey(tx, rx, near, samples=900, fs=40e3, fc=100e3, bandwidth=30e3, seed=0, **more):
    """Random echoes over a geometry, from slant range `near` on."""
    data = noise(len(tx), rx.shape[1], samples, bandwidth / fs, seed)
    return pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=rx, c=C, t0=2 * near / C, bandwidth=bandwidth, **more)


def straight(pings=64, spacing=0.03, **more):
    """Monostatic line at height 5 m."""
    tx = pysas.tracks.straight(pings, spacing, height=5.0, start=(-pings * spacing / 2, 0.0, 0.0)).position
    return survey(tx, tx[:, None].copy(), 18.0, **more)


def moving(pings=16, channels=6, **more):
    """Six receivers on a swaying track, moving while the echo travels."""
    start = (-pings * 0.075, 0.0, 0.0)
    track = pysas.tracks.perturbed(
        pings, 0.15, height=5.0, start=start, sway=0.1, heave=0.05, yaw=0.02, correlation=2.0, seed=3
    )
    rx = pysas.tracks.array(track, channels, 0.05, offset=(0.2, 0.0, -0.1))
    return survey(track.position, rx, 18.0, velocity=track.velocity, **more)


def ring(pings=90, **more):
    """Closed circle of 20 m radius."""
    tx = pysas.tracks.circular(pings, 20.0, height=4.0).position
    return survey(tx, tx[:, None].copy(), 15.0, samples=600, **more)


def far(pings=64, **more):
    """1 km at 300 kHz."""
    tx = pysas.tracks.straight(pings, 0.1, height=50.0, start=(-3.2, 0.0, 0.0)).position
    return survey(tx, tx[:, None].copy(), 990.0, fc=300e3, **more)


def bright(pings=64):
    """A rect-spectrum point 60 dB above weak noise; image the pixels beside it."""
    echoes = straight(pings)
    t = echoes.start_time[:, None] + np.arange(echoes.n_sample) / echoes.fs
    point = np.array([0.0, 21.0, 0.0])
    tau = 2 * np.linalg.norm(point - echoes.tx, axis=1)[:, None] / C
    pulse = np.sinc(echoes.bandwidth * (t - tau)) * np.exp(-2j * np.pi * echoes.fc * tau)
    return echoes.replace(data=1e-3 * echoes.data + pulse[:, None])


PLANE = pysas.Grid.plane(np.arange(-40, 41) * 0.02, 19.0 + np.arange(60) * 0.02)
X, Y = PLANE.axes["x"], PLANE.axes["y"]
SCENES = {
    "straight": (straight, PLANE),
    "moving": (moving, PLANE),
    "circular": (ring, pysas.Grid.plane(np.arange(-30, 31) * 0.02, np.arange(-30, 31) * 0.02)),
    "surface": (moving, pysas.Grid.surface(X, Y, 0.3 * np.sin(X / 0.4) * np.cos(Y[:, None] / 0.5))),
    "far": (far, pysas.Grid.plane(np.arange(-40, 41) * 0.02, 993.0 + np.arange(60) * 0.02)),
    "beside a bright point": (bright, pysas.Grid.plane(np.arange(-40, 41) * 0.02, 21.6 + np.arange(60) * 0.02)),
    "polar": (moving, pysas.Grid.polar(19.0 + np.arange(50) * 0.02, np.pi / 2 + np.arange(-20, 21) * 0.002)),
    "record's edges": (straight, pysas.Grid.plane(X[::8], 17.0 + np.arange(90) * 0.2)),
    "full band": (lambda: straight(bandwidth=40e3 / 1.1), PLANE),
}
