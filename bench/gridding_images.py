"""fourier_image against the exact sum and both engines, for `bench.gridding`: straight, perturbed and circular tracks."""

from functools import partial

import numpy as np

import pysas
from bench.timing import timed
from pysas.reference import patches

C, FC, FS, BAND = 1500.0, 100e3, 40e3, 30e3


def record(track, centre, dtype=np.complex128, channels=1, seed=0, samples=1024):
    """Random traces in the band about the range of `centre`: the hardest case for any interpolation."""
    rng = np.random.default_rng(seed)
    pings = track.n_ping
    rx = track.position[:, None] if channels == 1 else pysas.tracks.array(track, channels, 0.04)
    spectrum = rng.standard_normal((2, pings, channels, samples))
    keep = np.abs(np.fft.fftfreq(samples)) < BAND / 2 / FS - 2 / samples
    data = np.fft.ifft((spectrum[0] + 1j * spectrum[1]) * keep) * np.hanning(samples)
    start = 2 * np.linalg.norm(track.position - centre, axis=1) / C - samples / 2 / FS
    velocity = None if channels == 1 else track.velocity
    return pysas.Echoes(
        data.astype(dtype), fs=FS, fc=FC, tx=track.position, rx=rx, c=C, t0=start, velocity=velocity, bandwidth=BAND
    )


def scenes(pings=300):
    """Echoes, middle of the image and pixel spacing, by track."""
    along = {"n_ping": pings, "spacing": 0.03, "height": 6.0, "start": (-0.015 * pings, 0.0, 0.0)}
    straight = pysas.tracks.straight(**along)
    perturbed = pysas.tracks.perturbed(**along, sway=0.2, heave=0.1, correlation=2.0, seed=4)
    circular = pysas.tracks.circular(pings, 15.0, height=6.0)
    ahead, middle = np.array([0.0, 25.0, 0.0]), np.zeros(3)
    return {
        "straight": (record(straight, ahead), ahead, 0.015),
        "perturbed, 2 moving receivers": (record(perturbed, ahead, channels=2), ahead, 0.015),
        "circular": (record(circular, middle), middle, 0.003),
    }


def square(middle, spacing, pixels):
    axis = spacing * (np.arange(pixels) - pixels // 2)
    return pysas.Grid.plane(middle[0] + axis, middle[1] + axis, z=middle[2])


def patch_errors(pixels=(4, 8, 16, 32, 64, 96)):
    """Side, then predicted and measured error of one patch without and with the correction, by track and size."""
    found = {}
    for name, (echoes, middle, spacing) in scenes().items():
        rows, survey = [], patches.Survey.of(echoes)
        for count in pixels:
            grid = square(middle, spacing, count)
            exact, level = pysas.reference.exact(echoes, grid)
            row, every = [spacing * (count - 1)], slice(0, count)
            for correct in (False, True):
                surveys = patches.sectors(survey, middle) if correct else [survey]
                one = patches.patch(surveys, grid.axes["x"], grid.axes["y"], middle[2], every, every, correct)
                image = 0
                for part in one.parts:
                    k, values = patches.samples(part, one.offsets, 1e-6)
                    image = image + pysas.reference.nufft(k, values, part.targets(one.offsets), accuracy=1e-6)
                row += [one.error, pysas.metrics.relative_error(image.reshape(count, count), exact, level)]
            rows.append(row)
        found[name] = rows
    return found


def stated_errors(threads, pixels=128):
    print(f"\n{pixels} x {pixels} pixels, complex128, {threads} threads: error against the exact sum, seconds\n")
    print("| track | method | asked | predicted | measured | patches x sectors | s |\n|---|---|---|---|---|---|---|")
    for name, (echoes, middle, spacing) in scenes().items():
        grid = square(middle, spacing, pixels)
        exact, level = pysas.reference.exact(echoes, grid)

        def row(label, asked, call, *, name=name, exact=exact, level=level, repeats=3):
            image, seconds = timed(call, repeats, warm=True)
            error = pysas.metrics.relative_error(image.data, exact, level)
            choices, predicted = image.report.choices, image.report.predicted_error
            parts = f"{choices['patches']} x {choices['sectors']}" if "patches" in choices else ""
            guess = "" if predicted is None else f"{predicted:.1e}"
            print(f"| {name} | {label} | {asked:g} | {guess} | {error:.1e} | {parts} | {seconds:.3f} |", flush=True)

        for error in (3e-1, 1e-1, 1e-2, 1e-3):
            for library in ("finufft", "own"):
                call = partial(pysas.reference.fourier_image, echoes, grid, error=error, library=library, threads=threads)
                try:
                    row(f"nufft, {library}", error, call, repeats=1)
                except ImportError:
                    continue
        for engine in (pysas.backproject, pysas.ffbp):
            for tol in (1e-1, 1e-2, 1e-3):
                row(engine.__name__, tol, partial(engine, echoes, grid, tol=tol, threads=threads))


def inversions(threads):
    """Three points by every method: amplitudes over true ones, widths over the exact sum's."""
    track = pysas.tracks.perturbed(100, 0.05, 6.0, start=(-2.5, 0.0, 0.0), sway=0.1, correlation=2.0, seed=4)
    points, amplitudes = np.array([[0.0, 20.0, 0.0], [0.12, 20.06, 0.0], [-0.1, 19.9, 0.0]]), np.array([1.0, 0.7, 0.5])
    raw = pysas.simulate(
        points, amplitudes, pysas.LFM(FC, 24e3, 2e-3, "tukey", 0.3), tx=track.position, rx=track.position, fs=FS,
        duration=6e-3, t0=2 * 19.5 / C, dtype=np.complex128, threads=threads,
    )  # fmt: skip
    echoes = pysas.compress(raw, threads=threads)
    grid = pysas.Grid.plane(np.linspace(-0.25, 0.25, 51), 20 + np.linspace(-0.25, 0.25, 51))
    exact, level = pysas.reference.exact(echoes, grid)
    wanted = [abs(pysas.reference.exact(echoes, pysas.Grid.points(p[None]))[0][0]) for p in points]
    widths = [pysas.metrics.irw(cut, 0.01) for cut in (exact[25], exact[:, 25])]
    print("\nThree points (1, 0.7, 0.5), one patch of 0.5 m; peaks and IRW against the exact sum's\n")
    print("| method | peaks, dB | error of places, mm | IRW along / range | PSLR along / range, dB | from exact | s |")
    print("|---|---|---|---|---|---|---|")
    for method in ("nufft", "gridding", "ftcg", "frame"):
        call = partial(pysas.reference.fourier_image, echoes, grid, method, error=0.1, threads=threads)
        image, seconds = timed(call, warm=True)
        peaks, off = [], 0.0
        for point, peak in zip(points, wanted, strict=True):
            place = pysas.metrics.peak_position(image, point[:2], 0.04)
            values, _ = pysas.metrics.cut(image, place, "x")
            peaks.append(20 * np.log10(np.abs(values).max() / peak))
            off = max(off, 1e3 * np.hypot(*(np.array(place) - point[:2])))
        cuts = image.data[25], image.data[:, 25]
        ratio = " / ".join(f"{pysas.metrics.irw(cut, 0.01) / w:.2f}" for cut, w in zip(cuts, widths, strict=True))
        sides = " / ".join(f"{pysas.metrics.pslr(cut):.1f}" for cut in (*cuts,))
        error = pysas.metrics.relative_error(image.data, exact, level)
        levels = ", ".join(f"{p:+.2f}" for p in peaks)
        print(f"| {method} | {levels} | {off:.1f} | {ratio} | {sides} | {error:.3f} | {seconds:.2f} |", flush=True)
    sides = " / ".join(f"{pysas.metrics.pslr(cut):.1f}" for cut in (exact[25], exact[:, 25]))
    print(f"| exact | | | {100 * widths[0]:.2f} / {100 * widths[1]:.2f} cm | {sides} | | |")


def imaging(threads):
    print(
        "\nOne patch: predicted (rms phase at the worst point, rad) / measured error, without and with curvature correction\n"
    )
    for name, rows in patch_errors().items():
        print(f"\n| {name}: side, m | plane waves | corrected |\n|---|---|---|")
        for side, *errors in rows:
            pairs = [f"{a:.1e} / {b:.1e}" for a, b in zip(errors[::2], errors[1::2], strict=True)]
            print(f"| {side:.3f} | {' | '.join(pairs)} |", flush=True)
    stated_errors(threads)
    inversions(threads)
