"""Micronavigation beside imaging: `python -m bench.motion` prints seconds a ping of both, on the survey that speed is for.

The survey of `bench.survey` (100 kHz, 30 kHz of band, 150 m of swath, pixels of 2.5 cm, a strip from a stream of pings), with
arrays of which some phase centres coincide from ping to ping, as micronavigation needs. Coinciding ones hear the same noise of
the band, and a tenth of another; all others hear noise of their own: as coherent as a seabed that is frozen, for little time.
No array's traces are the same to the sample, so what is found there is of no interest, only how long it takes.
"""

import argparse
import statistics
import time

import numpy as np

import pysas
from bench.survey import BAND, ELEMENT, FAR, FC, FS, HALF_ANGLE, HEIGHT, NEAR, PIXEL, RATE, SWATH, C


def recorded(receivers, overlap, pings, seed=0):
    """Echoes of a straight track, which is claimed as it was."""
    advance = (receivers - overlap) * ELEMENT / 2
    x = advance * np.arange(pings)
    place = np.stack([x, np.zeros(pings), np.full(pings, HEIGHT)], axis=1)
    along = ELEMENT * (np.arange(receivers) - (receivers - 1) / 2)
    samples = int(2 * (FAR / np.cos(HALF_ANGLE) - NEAR) / C * FS) + 300
    keep = (np.abs(np.fft.fftfreq(samples)) <= BAND / 2 / FS).astype(np.float32)

    def noise(rng, rows):
        values = rng.standard_normal((rows, 2 * samples), dtype=np.float32).view(np.complex64)
        return np.fft.ifft(np.fft.fft(values) * keep).astype(np.complex64)

    data = np.empty((pings, receivers, samples), dtype=np.complex64)
    rng = np.random.default_rng(seed)
    for ping in range(pings):
        kept = data[ping - 1, receivers - overlap :].copy() if ping else noise(rng, overlap)
        data[ping, :overlap] = kept + 0.1 * noise(rng, overlap)
        data[ping, overlap:] = noise(rng, receivers - overlap)
    beam = pysas.Beam([0.0, 1.0, 0.0], ELEMENT, HALF_ANGLE, taper=0.5, axis=[1.0, 0.0, 0.0])
    return pysas.Echoes(
        data, fs=FS, fc=FC, tx=place, rx=place[:, None] + along[:, None] * [1.0, 0.0, 0.0], c=C, t0=2 * NEAR / C,
        velocity=np.gradient(place, 1 / RATE, axis=0), bandwidth=BAND, beam=beam, ping_time=np.arange(pings) / RATE,
    )  # fmt: skip


def imaged(echoes, tol, threads):
    """Seconds of a strip's images of these pings."""
    y = np.arange(NEAR, NEAR + SWATH, PIXEL)
    strip = pysas.Strip(y, PIXEL, 10.0, z=0.0, tol=tol, threads=threads)
    clock = time.perf_counter()
    for _ in strip.stream(echoes[first : first + 4] for first in range(0, echoes.n_ping, 4)):
        pass
    return time.perf_counter() - clock


def navigated(echoes, windows, threads):
    """Seconds of micronavigation."""
    clock = time.perf_counter()
    pysas.micronavigate(echoes, seabed=0.0, windows=windows, threads=threads)
    return time.perf_counter() - clock


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--receivers", type=int, nargs="+", default=[12, 32])
    parser.add_argument("--overlap", type=int, default=4, help="phase centres that coincide from ping to ping")
    parser.add_argument("--pings", type=int, default=400)
    parser.add_argument("--windows", type=int, default=100, help="of range, over the swath")
    parser.add_argument("--tol", type=float, nargs="+", default=[1e-2, 1e-3], help="of the images")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3, help="of which the medians are told, both in turn")
    args = parser.parse_args()
    head = ("receivers", "pings", "windows", "tol of images", "imaging, s a ping", "track, s a ping", "share")
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for receivers in args.receivers:
        echoes = recorded(receivers, args.overlap, args.pings)
        for tol in args.tol:
            pairs = []
            for _ in range(args.rounds):
                spent = navigated(echoes, (FAR - NEAR) / args.windows, args.threads)
                pairs.append((imaged(echoes, tol, args.threads), spent))
            images, track = (statistics.median(pair[i] for pair in pairs) / args.pings for i in (0, 1))
            share = statistics.median(b / a for a, b in pairs)
            cells = (
                receivers, args.pings, args.windows, f"{tol:g}", f"{images:.4f}", f"{track:.4f}", f"{share:.2f}",
            )  # fmt: skip
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
