"""A track known to centimetres, an image sharp to a fraction of a wavelength: the echoes themselves say where the sonar was.

    python examples/unknown_track.py --out unknown_track.jpg

A sonar of 16 receivers goes 40 m along a rough seabed with a wreck, its shadow, and four small targets. It sways by 10 cm and
turns by 12 mrad; its inertial system claims a track that drifts by millimetres in every second. The wavelength is 15 mm.
`micronavigate` compares what neighbouring pings heard of the same seabed, `autofocus` sharpens what bright points are left to
say. The picture shows the image with the claimed track, with the one found and with the true one on one scale of dB, and below
them by how much the claim was wrong and what was found of it, with its standard deviation.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import numpy as np

import pysas
import pysas.plot

C, FC, BAND, FS = 1500.0, 100e3, 20e3, 30e3
TX, RX, RECEIVERS, OVERLAP, DEPTH = 0.10, 0.05, 16, 4, 8.0  # m: elements; receivers a ping, phase centres shared by two pings
NEAR, FAR, LENGTH = 20.0, 34.0, 40.0  # m: slant ranges recorded, length of the line
SPEED, GYRO, DEPTH_NOISE = 2e-2, 5e-5, 1e-3  # m/s, rad a ping, m: what the data sheet says of the inertial system, a sigma each
ADVANCE = (RECEIVERS - OVERLAP) * RX / 2
HALF_ANGLE = np.arcsin(C / FC / TX)  # the transmitter's first null
TARGETS = np.array([(-9.0, 21.0), (-4.0, 27.5), (6.5, 30.0), (10.5, 24.0)])  # x, y on the bed
WRECK = (1.0, 23.5, 5.0, 0.9, 0.8)  # x, y of its middle, half length, half beam, height


def bed(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Scatterers of the seabed, the wreck and the targets: places and amplitudes."""
    beside = LENGTH / 2 + FAR * np.tan(HALF_ANGLE + 0.04) + 0.5
    points, strength = pysas.simulation.seabed((-beside, beside), (17.0, 34.0), density=25.0, depth=DEPTH, seed=seed)
    x, y, half, beam, height = WRECK
    across = 1 - ((points[:, 0] - x) / half) ** 2
    behind = points[:, 1] - y  # a shadow ends where a ray over the wreck meets the bed
    dark = (across > 0) & (behind > 0) & (behind < beam + height * np.sqrt(np.clip(across, 0, 1)) * points[:, 1] / DEPTH)
    points, strength = points[~dark], strength[~dark]
    rng = np.random.default_rng(seed)
    along = rng.uniform(-1, 1, 900)
    frames = np.where(rng.random(900) < 0.5, np.round(along * 12) / 12, along)  # half of them on the hull's frames
    rail = beam * np.sqrt(1 - frames**2)
    hull = np.stack([x + half * frames, y - rail * rng.uniform(0.4, 1, 900), DEPTH - height * rng.uniform(0, 1, 900)], axis=1)
    marks = np.column_stack([TARGETS, np.full(len(TARGETS), DEPTH)])
    steel = 4 * rng.standard_normal((900, 2)).view(complex)[:, 0]
    return np.concatenate([points, hull, marks]), np.concatenate([strength, steel, np.full(len(marks), 60)])


def arms(track: pysas.tracks.Track) -> dict[str, object]:
    """Transmitter, receivers, velocity and beam of the sonar on a track."""
    zero = np.zeros(track.n_ping)
    along = np.stack([np.cos(track.yaw), np.sin(track.yaw), zero], axis=1)
    look = np.stack([-np.sin(track.yaw), np.cos(track.yaw), zero], axis=1)
    rx = pysas.tracks.array(track, RECEIVERS, RX)
    return {
        "tx": track.position,
        "rx": rx,
        "velocity": track.velocity,
        "beam": pysas.Beam(look, TX, HALF_ANGLE, taper=0.5, axis=along),
    }


def recorded(seed: int) -> tuple[pysas.Echoes, pysas.tracks.Track, pysas.tracks.Track]:
    """What the sonar heard, with the track that it claims; the true track and the claimed one."""
    pings = round(LENGTH / ADVANCE)
    true = pysas.tracks.perturbed(
        pings, ADVANCE, start=(-LENGTH / 2, 0, 0), sway=0.10, heave=0.02, yaw=0.012, correlation=5.0, seed=seed
    )
    claim = pysas.tracks.inertial(true, speed=SPEED, bias=3e-3, gyro=GYRO, depth=DEPTH_NOISE, seed=seed)
    here = arms(true)
    element = {"boresight": here["beam"].boresight, "along": here["beam"].axis}
    with warnings.catch_warnings():  # what folds lies outside the pulse's band, where compression takes it away
        warnings.simplefilter("ignore", pysas.simulation.AliasingWarning)
        raw = pysas.simulate(
            *bed(seed),
            pysas.LFM(FC, BAND, 0.8e-3),
            fs=FS,
            c=C,
            t0=2 * NEAR / C,
            duration=2 * (FAR - NEAR) / C + 0.8e-3,
            tx_element=pysas.simulation.Element(TX, **element),
            rx_element=pysas.simulation.Element(RX, **element),
            snr_db=10.0,
            seed=seed,
            ping_time=true.time,
            **here,
        )
    return pysas.compress(raw.replace(**arms(claim)), window="boxcar", inverse=0.01), true, claim


def peaks(image: pysas.Image) -> np.ndarray:
    """Levels of the targets, dB, each the brightest pixel within half a metre."""
    x, y = np.meshgrid(image.grid.axes["x"], image.grid.axes["y"])
    near = [np.hypot(x - a, y - b) < 0.5 for a, b in TARGETS]
    return np.array([20 * np.log10(np.max(np.abs(image.data[place]))) for place in near])


def main(arguments: list[str] | None = None) -> dict[str, np.ndarray]:
    """Run the example; returns what it prints: the targets' levels below those with the true track, and slant errors, m."""
    parser = argparse.ArgumentParser(description="Find a sonar's track by its own echoes, and see what that does to the image.")
    parser.add_argument("--out", type=Path, default=Path("unknown_track.png"), help="picture to write (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of seabed, motion and noise (%(default)s)")
    options = parser.parse_args(arguments)

    echoes, true, claim = recorded(options.seed)
    print(echoes)
    prior = pysas.motion.Prior(speed=SPEED, gyro=GYRO, depth=DEPTH_NOISE)
    motion = pysas.micronavigate(echoes, seabed=DEPTH, prior=prior, elements=(TX, RX))
    found = motion.apply(echoes)
    grid = pysas.Grid.plane(np.arange(-13, 13, 0.025), np.arange(19.0, 32.0, 0.0125), z=DEPTH)
    sharp, report = pysas.autofocus(found, grid, prior=motion)
    print(f"{motion}\n{report}")

    tracks = {"claimed": echoes, "found": sharp, "true": echoes.replace(**arms(true))}
    images = {name: pysas.focus(one, grid, tol=1e-2) for name, one in tracks.items()}
    best = peaks(images["true"])
    loss = {name: peaks(image) - best for name, image in images.items()}
    wrong = {name: pysas.metrics.track_error(one, tracks["true"], 27.0, seabed=DEPTH) for name, one in tracks.items()}
    for name in tracks:
        print(f"{name:>8}: targets {np.array2string(loss[name], precision=2)} dB, slant error {1e3 * wrong[name]:.3f} mm")

    draw(options.out, images, motion, sharp, tracks["true"], echoes)
    print(f"wrote {options.out}")
    return {"loss": loss["found"], "claimed_loss": loss["claimed"], "slant": np.array([wrong["claimed"], wrong["found"]])}


def draw(
    path: Path,
    images: dict[str, pysas.Image],
    motion: pysas.motion.Motion,
    found: pysas.Echoes,
    true: pysas.Echoes,
    claim: pysas.Echoes,
) -> None:
    """Three images on one scale, and the track's error with what was found of it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 15), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    *places, below = figure.subplots(4, 1, height_ratios=[3, 3, 3, 2])
    level = float(20 * np.log10(np.percentile(np.abs(images["true"].data), 99.95)))
    for ax, (name, image) in zip(places, images.items(), strict=True):
        pysas.plot.quicklook(image, ax=ax, reference=level, dynamic_range=45, title=f"{name} track")
    x = true.tx[:, 0]

    def detrended(track: pysas.Echoes) -> np.ndarray:
        """Sway beyond the claim, mm, without the shift and turn of the whole that no image can tell."""
        sway = track.tx[:, 1] - claim.tx[:, 1]
        return 1e3 * (sway - np.polyval(np.polyfit(x, sway, 1), x))

    below.plot(x, detrended(true), "k", lw=1, label="what the claim lacks")
    below.plot(x, detrended(found), "C1", lw=1, label="found")
    sigma = 1e3 * motion.track_sigma
    below.fill_between(x, detrended(found) - sigma, detrended(found) + sigma, color="C1", alpha=0.3, lw=0, label="its sigma")
    below.set_xlabel("x, m")
    below.set_ylabel("sway, mm (wavelength: 15)")
    below.legend()
    figure.savefig(path)


if __name__ == "__main__":
    main()
