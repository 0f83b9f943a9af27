"""Recordings larger than memory: `python -m bench.recording` demodulates and compresses one, and prints the peak memory.

1e5 pings of 16 channels, 512 samples each of int16 at 500 kHz, of which 30 kHz about 100 kHz are kept at 50 kHz: 1.6 GB read
from a mapped file, and twice 0.67 GB written to such. The recording is noise, which costs what echoes do. Peak memory is the
process's largest resident set, mapped pages included; `--pings` for fewer.
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pysas

FS, FC, BAND, RATE, T0 = 500e3, 100e3, 30e3, 50e3, 0.02
CHANNELS, SAMPLES, PULSE = 16, 512, 2e-4
KEPT = -(-SAMPLES * int(RATE) // int(FS))


def record(path, pings, block=500):
    """A file of noise as an ADC would leave it."""
    rng = np.random.default_rng(1)
    with open(path, "wb") as file:
        for start in range(0, pings, block):
            count = min(block, pings - start)
            rng.integers(-8192, 8192, (count, CHANNELS, SAMPLES), dtype=np.int16).tofile(file)


def peak():
    """Largest resident set so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def replica():
    """A pulse as it is measured: an up-sweep over the band, int16 at the ADC's rate."""
    t = np.arange(int(PULSE * FS) + 1) / FS
    phase = 2 * np.pi * (FC * t + BAND / PULSE * (t - PULSE / 2) ** 2 / 2)
    return np.rint(16000 * np.cos(phase)).astype(np.int16)


def process(folder, pings):
    """Seconds to demodulate and to compress."""
    shape = (pings, CHANNELS, KEPT)
    samples = np.memmap(folder / "adc.bin", np.int16, "r", shape=(pings, CHANNELS, SAMPLES))
    clock = time.perf_counter()
    base = np.memmap(folder / "base.bin", np.complex64, "w+", shape=shape)
    pysas.demodulate(samples, FS, FC, BAND, RATE, T0, out=base)
    demodulated = time.perf_counter() - clock
    pulse, _ = pysas.demodulate(replica(), FS, FC, BAND, RATE)
    place = np.zeros((pings, 3))
    raw = pysas.Echoes(
        base, fs=RATE, fc=FC, t0=T0, tx=place, rx=np.zeros((pings, CHANNELS, 3)), bandwidth=BAND, pulse=pulse, compressed=False
    )
    clock = time.perf_counter()
    out = np.memmap(folder / "compressed.bin", np.complex64, "w+", shape=shape)
    pysas.compress(raw, out=out)
    return demodulated, time.perf_counter() - clock


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=100_000)
    parser.add_argument("--folder", help="where the files go, some 3 GB; default: a temporary one")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        record(Path(folder) / "adc.bin", arguments.pings)
        before = peak()
        demodulated, compressed = process(Path(folder), arguments.pings)
    size = arguments.pings * CHANNELS * SAMPLES
    print(f"{arguments.pings} pings x {CHANNELS} channels x {SAMPLES} int16 samples, {2 * size / 1e9:.2f} GB; {KEPT} come out")
    print(f"demodulate {demodulated:.1f} s, {size / demodulated / 1e6:.0f} Msamples/s; compress {compressed:.1f} s")
    print(f"peak memory {peak() / 1e6:.0f} MB, {before / 1e6:.0f} MB before")


if __name__ == "__main__":
    main()
