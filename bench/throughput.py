"""Sustained imaging of a survey: `python -m bench.throughput` prints images a second and the real-time factor.

A vehicle at the speed that one array's length in two pings allows, 100 kHz, 4 pings a second, 150 m of swath, pixels of
2.5 cm: each image is a stretch of the swath with all pings whose beam (15 degrees) lights it. Real-time factor: seconds of
survey that one second of imaging covers. A plan is made once and its stream fed from memory; echoes are random.
"""

import argparse
import time

import numpy as np

import pysas

C, FC, BAND, FS, RATE, SWATH, PIXEL, NEAR = 1500.0, 100e3, 30e3, 36e3, 4.0, 150.0, 0.025, 10.0
ELEMENT, BEAM = 0.05, np.deg2rad(7.5)
LENGTH = 3.2  # m of track in an image


def survey(receivers):
    """Echoes that one image needs, its grid, and its seconds of survey."""
    advance = receivers * ELEMENT / 2  # a ping: phase centres half an element apart
    far = np.hypot(SWATH + NEAR, 10.0)
    reach = far * np.tan(BEAM)
    pings = int(np.ceil((LENGTH + 2 * reach) / advance))
    x = -reach + advance * np.arange(pings)
    tx = np.stack([x, 0.05 * np.sin(x), np.full(pings, 10.0)], axis=1)
    rx = np.repeat(tx[:, None], receivers, axis=1)
    rx[..., 0] += ELEMENT * np.arange(receivers)
    samples = int(2 * (far / np.cos(BEAM) - NEAR) / C * FS) + 300
    rng = np.random.default_rng(0)
    keep = (np.abs(np.fft.fftfreq(samples)) <= BAND / 2 / FS).astype(np.float32)
    data = np.empty((pings, receivers, samples), dtype=np.complex64)
    for ping in range(pings):
        noise = rng.standard_normal((receivers, 2 * samples), dtype=np.float32).view(np.complex64)
        data[ping] = np.fft.ifft(np.fft.fft(noise) * keep)
    velocity = np.tile([advance * RATE, 0.0, 0.0], (pings, 1))
    beam = pysas.Beam(boresight=(0.0, 1.0, 0.0), length=ELEMENT, half_angle=BEAM)
    echoes = pysas.Echoes(
        data, fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=2 * NEAR / C, velocity=velocity, bandwidth=BAND, beam=beam
    )  # fmt: skip
    grid = pysas.Grid.plane(np.arange(0, LENGTH, PIXEL), np.arange(NEAR, NEAR + SWATH, PIXEL))
    return echoes, grid, LENGTH / (advance * RATE)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--receivers", type=int, nargs="+", default=[6, 32])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--images", type=int, default=2)
    args = parser.parse_args()
    print("| receivers | engine | tol | pings an image | image, s | survey, s | real-time factor | factorised |")
    print("|---|---|---|---|---|---|---|---|")
    for receivers in args.receivers:
        echoes, grid, covered = survey(receivers)
        for method in ("backprojection", "ffbp"):
            for tol in (1e-2, 1e-3):
                plan = pysas.plan(echoes, grid, tol, method, threads=args.threads)
                clock = time.perf_counter()
                for image in plan.stream(echoes.data for _ in range(args.images)):
                    report = image.report
                spent = (time.perf_counter() - clock) / args.images
                cells = (
                    receivers,
                    method,
                    f"{tol:g}",
                    echoes.n_ping,
                    f"{spent:.2f}",
                    f"{covered:.2f}",
                    f"{covered / spent:.2f}",
                )
                print("|", " | ".join(map(str, cells)), f"| {report.factorised_share:.2f} |", flush=True)


if __name__ == "__main__":
    main()
