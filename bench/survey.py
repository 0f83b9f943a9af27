"""The survey that speed is for: `python -m bench.survey` prints real-time factors, rates and errors.

A vehicle 10 m above the bottom at the speed that one array's length in two pings allows, 100 kHz, 30 kHz of band, 4 pings a
second, receivers of 5 cm that move while echoes travel, sway, heave and yaw of a few cm and mrad; a fan beam of +-7.5
degrees whose outer half fades; 150 m of swath from 10 m on, flat or with 2 m of relief, pixels of 2.5 cm. Real-time factor:
seconds of survey over seconds of imaging, planning and preparation included. Error is relative to the exact sum's norm on
random pixels; echoes are noise of the band, every pixel and ping alike, so that errors cannot hide beside bright points.
The strip's images are of 10 m, from a stream of pings that begins and ends where these light the strip: what they light
beyond it is summed too, and counts as time and not as survey.
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


def survey(receivers, length, taper=0.5, shape="fan", seed=0):
    """Echoes that a strip of `length` m needs, and its seconds of survey."""
    far = np.hypot(SWATH + NEAR, HEIGHT)
    reach = far * np.tan(HALF_ANGLE + 5e-3)
    advance = receivers * ELEMENT / 2
    pings = int(np.ceil((length + 2 * reach) / advance))
    tx, rx, velocity, look, axis = track(receivers, pings, -reach)
    samples = int(2 * (far / np.cos(HALF_ANGLE) - NEAR) / C * FS) + 300
    rng = np.random.default_rng(seed)
    keep = (np.abs(np.fft.fftfreq(samples)) <= BAND / 2 / FS).astype(np.float32)
    data = np.empty((pings, receivers, samples), dtype=np.complex64)
    for ping in range(pings):
        noise = rng.standard_normal((receivers, 2 * samples), dtype=np.float32).view(np.complex64)
        data[ping] = np.fft.ifft(np.fft.fft(noise) * keep)
    beam = pysas.Beam(look, ELEMENT, HALF_ANGLE, shape, taper, axis if shape == "fan" else None)
    echoes = pysas.Echoes(
        data, fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=2 * NEAR / C, velocity=velocity, bandwidth=BAND, beam=beam
    )  # fmt: skip
    return echoes, length / (advance * RATE)


def ground(length, relief=0.0):
    """The strip's grid: a plane, or a height map of so many m from lowest to highest."""
    x, y = np.arange(0, length, PIXEL), np.arange(NEAR, NEAR + SWATH, PIXEL)
    if not relief:
        return pysas.Grid.plane(x, y)
    waves = np.sin(2 * np.pi * x / 23)[None, :] * np.cos(2 * np.pi * y / 31)[:, None] + 0.1 * np.sin(2 * np.pi * y / 3)[:, None]
    return pysas.Grid.surface(x, y, relief / 2 * waves / np.abs(waves).max())


def error_of(image, echoes, grid, count, seed=1):
    """Relative error on random pixels."""
    pixels = np.random.default_rng(seed).choice(grid.size, count, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    wrong = np.linalg.norm(image.data.ravel()[pixels] - exact)
    return wrong / max(np.linalg.norm(exact), np.linalg.norm(level))


def pings_of(echoes, count=4):
    """The echoes as a recorder tells them, a few pings at a time."""
    beam = echoes.beam
    for begin in range(0, echoes.n_ping, count):
        some = slice(begin, begin + count)
        axis = None if beam.axis is None else beam.axis[some]
        yield echoes.replace(
            data=echoes.data[some], tx=echoes.tx[some], rx=echoes.rx[some], velocity=echoes.velocity[some],
            beam=pysas.Beam(beam.boresight[some], beam.length, beam.half_angle, beam.shape, beam.taper, axis),
        )  # fmt: skip


def through_strip(echoes, grid, tol, threads, length=10.0):
    """The grid's image from a stream of pings, its terms, and the last part's report."""
    x = grid.axes["x"]
    strip = pysas.Strip(grid.axes["y"], PIXEL, length, tol=tol, threads=threads)
    data, terms = np.zeros(grid.shape, dtype=np.complex64), 0
    for image in strip.stream(pings_of(echoes)):
        first = round((image.grid.axes["x"][0] - x[0]) / PIXEL)
        low, high = max(first, 0), min(first + strip.columns, x.size)
        if low < high:
            data[:, low:high] = image.data[:, low - first : high - first]
        terms, report = terms + image.report.terms, image.report
    return pysas.Image(data, grid, report, echoes.fc, echoes.c), terms


def row(receivers, length, relief, method, tol, threads, pixels, **beam):
    """Cells of one scene: prediction, time, rates and errors."""
    echoes, covered = survey(receivers, length, **beam)
    grid = ground(length, relief)
    clock = time.perf_counter()
    if method == "strip":
        predicted = np.nan
        image, terms = through_strip(echoes, grid, tol, threads)
        report = image.report
    else:
        plan = pysas.plan(echoes, grid, tol, method, threads=threads)
        image = plan(echoes.data)
        report, predicted = image.report, plan.predicted_seconds
        terms = report.terms
    spent = time.perf_counter() - clock
    error = error_of(image, echoes, grid, pixels) if pixels else np.nan
    return [
        receivers, f"{length:g}", f"{relief:g}", method, report.method, f"{tol:g}", threads,
        f"{predicted:.2f}", f"{spent:.2f}", f"{covered / spent:.2f}", f"{terms / grid.size:.0f}",
        f"{terms / spent / threads / 1e9:.2f}", f"{report.factorised_share:.2f}", f"{error:.1e}",
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10:.0f}",
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
