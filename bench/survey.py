"""The survey that speed is for: `python -m bench.survey` prints real-time factors, rates and errors.

A vehicle 10 m above the bottom at the speed that one array's length in two pings allows, 100 kHz, 30 kHz of band, 4 pings a
second, receivers of 5 cm that move while echoes travel, sway, heave and yaw of a few cm and mrad; a fan beam of +-7.5
degrees whose outer half fades; 150 m of swath from 10 m on, flat or with 2 m of relief, pixels of 2.5 cm. Real-time factor:
seconds of survey over seconds of imaging, planning and preparation included. Error is relative to the exact sum's norm on
random pixels; echoes are noise of the band, every pixel and ping alike, so that errors cannot hide beside bright points.
The strip's images are of 10 m, from a stream of pings that begins and ends where these light the strip: what they light
beyond it is summed too, and counts as time and not as survey; of a long strip it is little. Its pings are made a few at a time
and its images are not kept, so that peak memory is that of the stream; making pings does not count as time.
"""

import argparse
import resource
import time

import numpy as np

import pysas

C, FC, BAND, FS, RATE = 1500.0, 100e3, 30e3, 36e3, 4.0
HEIGHT, NEAR, SWATH, PIXEL = 10.0, 10.0, 150.0, 0.025
ELEMENT, HALF_ANGLE = 0.05, np.deg2rad(7.5)


def track(receivers, pings, start):
    """Transmitters, receivers, their velocity, boresights and axes along the element of each ping."""
    advance = receivers * ELEMENT / 2  # phase centres half an element apart
    x = start + advance * np.arange(pings)
    place = np.stack([x, 0.05 * np.sin(2 * np.pi * x / 17), HEIGHT + 0.03 * np.sin(2 * np.pi * x / 11)], axis=1)
    yaw = 5e-3 * np.sin(2 * np.pi * x / 13)
    axis = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(pings)], axis=1)
    look = np.stack([-np.sin(yaw), np.cos(yaw), np.zeros(pings)], axis=1)
    along = ELEMENT * (np.arange(receivers) - (receivers - 1) / 2)
    velocity = np.gradient(place, 1 / RATE, axis=0) if pings > 1 else np.array([[advance * RATE, 0.0, 0.0]])
    return place, place[:, None] + along[:, None] * axis[:, None], velocity, look, axis


FAR = np.hypot(SWATH + NEAR, HEIGHT)
REACH = FAR * np.tan(HALF_ANGLE + 5e-3)  # along the track, of a ping


def pings_for(receivers, length):
    """Pings that light a strip of `length` m, and its seconds of survey."""
    advance = receivers * ELEMENT / 2
    return int(np.ceil((length + 2 * REACH) / advance)), length / (advance * RATE)


def recorded(receivers, pings, some, taper=0.5, shape="fan", seed=0, data=None):
    """Pings number `some`, a slice, of a track of so many: the same whichever are asked for, or with given samples."""
    tx, rx, velocity, look, axis = (part[some] for part in track(receivers, pings, -REACH))
    beam = pysas.Beam(look, ELEMENT, HALF_ANGLE, shape, taper, axis if shape == "fan" else None)
    samples = noise(receivers, range(pings)[some], seed) if data is None else data[: len(tx)]
    return pysas.Echoes(
        samples, fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=2 * NEAR / C, velocity=velocity, bandwidth=BAND, beam=beam
    )  # fmt: skip


def noise(receivers, numbers, seed):
    """Samples (ping, receiver, sample) of these pings."""
    samples = int(2 * (FAR / np.cos(HALF_ANGLE) - NEAR) / C * FS) + 300
    keep = (np.abs(np.fft.fftfreq(samples)) <= BAND / 2 / FS).astype(np.float32)
    data = np.empty((len(numbers), receivers, samples), dtype=np.complex64)
    for ping, number in zip(data, numbers, strict=True):
        rng = np.random.default_rng([seed, number])
        white = rng.standard_normal((receivers, 2 * samples), dtype=np.float32).view(np.complex64)
        ping[:] = np.fft.ifft(np.fft.fft(white) * keep)
    return data


def survey(receivers, length, taper=0.5, shape="fan", seed=0):
    """Echoes that a strip of `length` m needs, and its seconds of survey."""
    pings, covered = pings_for(receivers, length)
    return recorded(receivers, pings, slice(0, pings), taper, shape, seed), covered


def height_of(x, y, relief):
    """Heights of the ground (y, x) of so many m from lowest to highest."""
    waves = np.sin(2 * np.pi * x / 23)[None, :] * np.cos(2 * np.pi * y / 31)[:, None] + 0.1 * np.sin(2 * np.pi * y / 3)[:, None]
    return relief / 2.2 * waves


def ground(length, relief=0.0, start=0.0):
    """The strip's grid: a plane, or a height map."""
    x, y = start + PIXEL * np.arange(round(length / PIXEL)), np.arange(NEAR, NEAR + SWATH, PIXEL)
    return pysas.Grid.surface(x, y, height_of(x, y, relief)) if relief else pysas.Grid.plane(x, y)


def exactly(echoes, grid, pixels, found):
    """Squares of what pixels are wrong by, and of what that is relative to."""
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    return np.linalg.norm(found - exact) ** 2, max(np.linalg.norm(exact), np.linalg.norm(level)) ** 2


def error_of(image, echoes, grid, count, seed=1):
    """Relative error on random pixels."""
    pixels = np.random.default_rng(seed).choice(grid.size, count, replace=False)
    wrong, whole = exactly(echoes, grid, pixels, image.data.ravel()[pixels])
    return np.sqrt(wrong / whole)


class Recorder:
    """The pings of a survey as a recorder tells them, a few at a time, and the seconds that making them takes."""

    def __init__(self, receivers, length, count=4, **beam):
        self.receivers, self.beam, self.count = receivers, beam, count
        self.pings, self.covered = pings_for(receivers, length)
        self.spent = 0.0

    def some(self, begin, end):
        return recorded(self.receivers, self.pings, slice(begin, end), **self.beam)

    def __iter__(self):
        for begin in range(0, self.pings, self.count):
            clock = time.perf_counter()
            echoes = self.some(begin, begin + self.count)
            self.spent += time.perf_counter() - clock
            yield echoes


def through_strip(recorder, length, relief, tol, threads, pixels, image_length=10.0):
    """A strip's seconds, terms, terms through trees, and error on random pixels of three of its images."""
    y, count = np.arange(NEAR, NEAR + SWATH, PIXEL), round(length / image_length)
    z = (lambda x, y: height_of(x, y, relief)) if relief else 0.0
    strip = pysas.Strip(y, PIXEL, image_length, z=z, tol=tol, threads=threads)
    looked_at, kept, terms, factorised = {0, count // 2, count - 1}, {}, 0, 0.0
    clock, looking = time.perf_counter(), 0.0
    for image in strip.stream(recorder):
        number = round(image.grid.axes["x"][0] / image_length)
        terms += image.report.terms
        factorised += image.report.terms * image.report.factorised_share
        if pixels and number in looked_at:
            begin = time.perf_counter()
            some = np.random.default_rng(number).choice(image.grid.size, pixels // len(looked_at), replace=False)
            kept[number] = some, image.data.ravel()[some]
            looking += time.perf_counter() - begin
    spent = time.perf_counter() - clock - recorder.spent - looking
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    advance = recorder.receivers * ELEMENT / 2
    wrong = whole = 0.0
    for number, (some, found) in kept.items():
        # pings that light the image: the first stands at -REACH
        first = max(int(number * image_length / advance) - 1, 0)
        echoes = recorder.some(first, int(((number + 1) * image_length + 2 * REACH) / advance) + 2)
        off, size = exactly(echoes, ground(image_length, relief, number * image_length), some, found)
        wrong, whole = wrong + off, whole + size
    return spent, terms, factorised / max(terms, 1), np.sqrt(wrong / whole) if kept else np.nan, memory


def row(receivers, length, relief, method, tol, threads, pixels, **beam):
    """Cells of one scene: prediction, time, rates and errors."""
    if method == "strip":
        recorder = Recorder(receivers, length, **beam)
        covered, predicted, took = recorder.covered, np.nan, "auto"
        spent, terms, share, error, memory = through_strip(recorder, length, relief, tol, threads, pixels)
        size = round(length / PIXEL) * round(SWATH / PIXEL)
    else:
        echoes, covered = survey(receivers, length, **beam)
        grid = ground(length, relief)
        clock = time.perf_counter()
        plan = pysas.plan(echoes, grid, tol, method, threads=threads)
        image = plan(echoes.data)
        spent = time.perf_counter() - clock
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        report, predicted, size = image.report, plan.predicted_seconds, grid.size
        took, terms, share = report.method, report.terms, report.factorised_share
        error = error_of(image, echoes, grid, pixels) if pixels else np.nan
    return [
        receivers, f"{length:g}", f"{relief:g}", method, took, f"{tol:g}", threads,
        f"{predicted:.2f}", f"{spent:.2f}", f"{covered / spent:.2f}", f"{terms / size:.0f}",
        f"{terms / spent / threads / 1e9:.2f}", f"{share:.2f}", f"{error:.1e}", f"{memory:.0f}",
    ]  # fmt: skip


HEAD = (
    "receivers", "strip, m", "relief, m", "asked", "took", "tol", "threads", "predicted, s", "imaging, s", "real-time factor",
    "terms a pixel", "1e9 terms/s a thread", "factorised", "error", "peak memory, MB",
)  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--receivers", type=int, nargs="+", default=[6, 32])
    parser.add_argument("--length", type=float, default=30.0, help="of the strip, m")
    parser.add_argument("--relief", type=float, nargs="+", default=[0.0, 2.0], help="m from lowest to highest")
    parser.add_argument("--tol", type=float, nargs="+", default=[1e-2, 1e-3])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--methods", nargs="+", default=["backprojection", "ffbp", "auto", "strip"])
    parser.add_argument("--taper", type=float, default=0.5)
    parser.add_argument("--shape", default="fan")
    parser.add_argument("--pixels", type=int, default=200, help="of the error, 0: none")
    args = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |")
    print("|---" * len(HEAD) + "|")
    for receivers in args.receivers:
        for relief in args.relief:
            for tol in args.tol:
                for method in args.methods:
                    for threads in args.threads:
                        beam = {"taper": args.taper, "shape": args.shape}
                        cells = row(receivers, args.length, relief, method, tol, threads, args.pixels, **beam)
                        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
