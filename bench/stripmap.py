"""Sathishkumar et al.'s experiment: seven targets imaged by the Fourier algorithms and by both engines, against the exact sum.

The printed parameters contradict each other; these do not: 30 kHz centre, 20 kHz down-chirp of 10 ms, sampled at 30 kHz, a
sonar of 0.22 m (sinc^2 two-way beam of the instantaneous frequency, cut at its first nulls) every 5.5 cm, reference range
100 m, 1500 m/s. Peak loss is 20 log10 of the peak over the exact sum's, times sqrt(range) for the Fourier algorithms (their
images grow as sqrt(r), the sum over pings as r), relative to omega-k with sinc interpolation at the reference range.

    python -m bench.stripmap                  tables of loss and shape: 30 m and 130 m
    python -m bench.stripmap --figure FILE    the figure
    python -m bench.stripmap --speed          all algorithms and both engines on one scene; a 2048 x 2048 omega-k
"""

import argparse
import time
import tracemalloc
from functools import partial

import numpy as np

import pysas

C, FC, BAND, FS, DURATION, LENGTH, R0 = 1500.0, 30e3, 20e3, 30e3, 10e-3, 0.22, 100.0
STEP, SPACING = LENGTH / 4, C / (2 * FS)
EXTENTS = {"30 m": (0, -5, 5, -10, 10, -15, 15), "130 m": (0, -20, 20, -45, 45, -65, 65)}
PULSE = pysas.LFM(FC, -BAND, DURATION)


def survey(offsets, dtype=np.complex64):
    """Raw echoes of unit targets at x = 0 and slant ranges R0 + offset."""
    targets = R0 + np.asarray(offsets, dtype=float)
    steepest = C / (FC - BAND / 2) / LENGTH  # sine of the first null at the lowest frequency
    half = int(np.ceil(1.02 * targets.max() * steepest / np.sqrt(1 - steepest**2) / STEP))
    u = STEP * np.arange(-half, half + 1)
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    first = np.floor((targets.min() - 5) / SPACING)
    samples = int(np.ceil(np.hypot(targets.max(), u[-1]) / SPACING - first + DURATION * FS)) + 40
    start = first / FS
    data = np.zeros((u.size, samples), dtype=dtype)
    reach = np.arange(int(DURATION * FS) + 1)
    for target in targets:
        away = np.hypot(target, u)
        sine = u / away
        begin = np.ceil((2 * away / C - start) * FS).astype(int)
        index = begin[:, None] + reach
        t = start + index / FS - 2 * away[:, None] / C
        place = (FC + PULSE.rate * (t - DURATION / 2)) * LENGTH * sine[:, None] / C
        beam = np.where(np.abs(place) < 1, np.sinc(place), 0.0) ** 2
        echo = beam * PULSE.waveform(t) * np.exp(-4j * np.pi * FC / C * away[:, None])
        np.put_along_axis(data, index, (np.take_along_axis(data, index, 1) + echo).astype(dtype), 1)
    return pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=start, pulse=PULSE, compressed=False)


def algorithms(raw, threads=None):
    """What is compared, by name; each call gives an image."""
    common = {"reference_range": R0, "threads": threads}
    omega = partial(pysas.reference.omega_k, raw, **common)
    doppler = partial(pysas.reference.range_doppler, raw, **common)
    chirp = partial(pysas.reference.chirp_scaling, raw, **common)
    return {
        "omega-k, sinc, zp 2": omega,
        "omega-k, cubic, zp 2": partial(omega, interpolation="cubic"),
        "omega-k, linear, zp 1": partial(omega, interpolation="linear", zero_padding=1),
        "omega-k, linear, zp 2": partial(omega, interpolation="linear", zero_padding=2),
        "omega-k, linear, zp 4": partial(omega, interpolation="linear", zero_padding=4),
        "omega-k, linear, zp 8": partial(omega, interpolation="linear", zero_padding=8),
        "chirp scaling": chirp,
        "chirp scaling, second order": partial(chirp, higher_order=False),
        "range-Doppler": doppler,
        "range-Doppler, linear migration": partial(doppler, interpolation="linear"),
        "range-Doppler, second order": partial(doppler, secondary="second-order"),
        "range-Doppler, no SRC": partial(doppler, secondary="none"),
    }


def exact_response(echoes, offset):
    """Peak, widths (m) and side-lobe ratios (dB), along-track and range, of the exact sum at a target."""
    along = pysas.Grid.plane(STEP * np.arange(-72, 73), [R0 + offset])
    across = pysas.Grid.plane([0.0], R0 + offset + SPACING / 2 * np.arange(-120, 121))
    cuts = [(pysas.reference.exact(echoes, grid)[0].ravel(), d) for grid, d in ((along, STEP), (across, SPACING / 2))]
    return describe(cuts, float(np.abs(cuts[0][0][72])))


def describe(cuts, peak, place=(0.0, 0.0)):
    widths = [pysas.metrics.irw(values, spacing) for values, spacing in cuts]
    return {"peak": peak, "irw": widths, "pslr": [pysas.metrics.pslr(values) for values, _ in cuts], "place": place}


def response(image, offset):
    """The same of an image, at its own peak near the target, and where that lies from the target (m)."""
    x, y = image.grid.axes["x"], image.grid.axes["y"]
    columns, rows = np.abs(x) < 4.0, np.abs(y - R0 - offset) < 3.0
    grid = pysas.Grid.plane(x[columns], y[rows])
    patch = pysas.Image(image.data[np.ix_(rows, columns)], grid, image.report, image.fc, image.c)
    place = pysas.metrics.peak_position(patch, (0.0, R0 + offset), 0.2)
    cuts = [pysas.metrics.cut(patch, place, axis) for axis in ("x", "y")]
    peak = float(np.abs(cuts[0][0][np.argmin(np.abs(grid.axes["x"]))]))
    return describe(cuts, peak, (place[0], place[1] - R0 - offset))


def table(extent, threads):
    """Rows (name, offset, loss, ratio of widths, PSLR, error in position) for one extent."""
    offsets = EXTENTS[extent]
    raw = survey(offsets)
    echoes = pysas.compress(raw, threads=threads)
    exact = {offset: exact_response(echoes, offset) for offset in offsets}
    rows, unit = [], None
    for name, call in algorithms(raw, threads).items():
        try:
            image = call()
        except ValueError as error:
            rows.append((name, str(error)))
            continue
        for offset in offsets:
            found, true = response(image, offset), exact[offset]
            level = found["peak"] / true["peak"] * np.sqrt((R0 + offset) / R0)
            unit = level if unit is None else unit
            widths = [a / b for a, b in zip(found["irw"], true["irw"], strict=True)]
            rows.append((name, offset, 20 * np.log10(level / unit), widths, found["pslr"], found["place"]))
    return exact, rows


def show(extent, threads):
    exact, rows = table(extent, threads)
    print(f"\n{extent}: IRW as a ratio to the exact sum's, along-track / range\n")
    print("| algorithm | offset, m | loss, dB | IRW | PSLR, dB | position, mm |\n|---|---|---|---|---|---|")
    for offset, r in exact.items():
        print(
            f"| exact sum | {offset:+d} | | {100 * r['irw'][0]:.2f} cm / {100 * r['irw'][1]:.2f} cm "
            f"| {r['pslr'][0]:.1f} / {r['pslr'][1]:.1f} | |"
        )
    for name, *row in rows:
        if len(row) == 1:
            print(f"| {name} | refused: {row[0]} | | | | |")
            continue
        offset, loss, widths, pslr, place = row
        print(
            f"| {name} | {offset:+d} | {loss:.2f} | {widths[0]:.2f} / {widths[1]:.2f} | {pslr[0]:.1f} / {pslr[1]:.1f} "
            f"| {1e3 * place[0]:.1f} / {1e3 * place[1]:.1f} |",
            flush=True,
        )
    return rows
