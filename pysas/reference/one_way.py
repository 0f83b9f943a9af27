"""Migration by one-way wave equations: what omega-k cannot image, sound speed that changes with depth or along the track.

The track is z = 0 and z the slant range; a scatterer is a source that fires at t = 0 into water where waves run at c/2 (K.
Ito et al., Section 2). The echoes are continued into the water by an equation for waves of one direction, right up to an angle
from broadside, and the image is what is left of them at t = 0.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.reference import one_way_carrier as carrier
from pysas.reference.marching import Block, March
from pysas.reference.one_way_layout import COMPACT, PLAIN, SAMPLED, Line, equation
from pysas.reference.stripmap import frequencies, matched_filter


def one_way(
    echoes: Echoes,
    grid: Grid | None = None,
    *,
    angle: int | tuple[float, float] = 45,
    scheme: str = "cn",
    correction: str | None = None,
    form: str = "base-band",
    layers: Sequence[tuple[float, npt.ArrayLike]] | None = None,
    weight: str = "flat",
    half_angle: float | None = None,
    step: float | None = None,
    margin: int | None = None,
    domains: int = 1,
    overlap: int | None = None,
    threads: int | None = None,
) -> Image:
    """Image of a straight, even track by marching a one-way wave equation into the water.

    Parameters
    ----------
    echoes : Echoes
        One channel, monostatic, evenly spaced along x; range-compressed, or raw with their pulse (then compressed here).
        One ping is its own image.
    grid : Grid, optional
        Plane of slant ranges |y - y_track| at the track's height whose x are those of pings; default: all pings, and the
        record's ranges every c/(2 fs).
    angle : {45, 15, 65} or (alpha, beta)
        k_z = k [1 - alpha s^2/(1 - beta s^2)], s = k_x/k: 1/2, 0; 1/2, 1/4; 0.478242, 0.376370. 15 is Algorithm I, the others
        are Algorithm II. As alpha is not 1/2, 65 is worse than 15 below 20 degrees.
    scheme : {"cn", "euler"}
        Crank-Nicolson, or the paper's implicit Euler (form="carrier" alone), which damps by exp(-k_x^2 dz z/4).
    correction : {"both", "centre", "compact", "none"}, optional
        "compact": fourth-order differences in x, in base-band with columns between pings where their phase at half_angle would
        add up to more than 0.2 rad. "centre": alpha and beta times tan(phi/2)/(phi/2), phi = k dz at fc, which
        undoes the splitting's error there; form="base-band" has none. Default: both, of "euler" none.
    form : {"base-band", "carrier"}
        "base-band": each frequency of the occupied band on its own, carrier removed: steps follow the beam. "carrier": the
        paper's march in time, carrier kept: steps follow the wavelength.
    layers : sequence of (top, speed), optional
        Sound speed, m/s, from depth `top`, m, down; the first top is 0. A speed may be (ping,): the part that varies along x is
        split off (Strang), refraction by it is right to the order of dz. Default: echoes.c everywhere.
    weight : {"flat", "backprojection"}
        As in `omega_k`: "backprojection" gives the image that `backproject` sums without a beam, in water of one speed.
    half_angle : float, optional
        Largest angle from broadside that must focus, rad: margins and steps follow it. Default: that of the beam, its taper
        included (at most what the pings sample), else 15 degrees, or what fourth-order differences at this spacing carry if
        that is less.
    step : float, optional
        Longest step in range, m. Default: "base-band": the phase of Crank-Nicolson at half_angle adds up to 0.2 rad;
        "carrier": c/(2 fc)/16.
    margin : int, optional
        Columns of silence at either end, without which waves that leave come back. Default: half of what half_angle can cross.
    domains : int
        Parts of the track, each migrated on its own and in parallel, that overlap and add up.
    overlap : int, optional
        Columns that neighbouring parts share, in which the echoes go over linearly from one to the other. Default: twice what
        half_angle can cross, to which the sum is as good as the whole.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.

    Returns
    -------
    Image
        complex64 or complex128 as the data. Phases as in `backproject`.

    Warns
    -----
    UserWarning
        Pings farther apart than the march can carry at half_angle: pi/k_x; with form="carrier" 1.6/k_x; without compact
        differences 0.8/k_x. States the limit.

    Raises
    ------
    ValueError, TypeError
        An argument outside its range or against another; a track that is not straight, even, monostatic (the ping is named).

    Notes
    -----
    K. Ito et al., Eqs 4-12. With tau = (c/2)(T - t), (d_tau^2 - beta d_x^2)(u_tau + u_z) = alpha d_x^2 u_tau: in time,
    Algorithms I and II (the print of II has alpha and beta exchanged, which destroys the image).

    Base-band: u = U exp(-j k0 (tau - z)) leaves (d_tau - j k0)(U_tau + U_z) = U_xx/2 (15 degrees). The fast operator cannot be
    stepped on a grid of the bandwidth (its trapezoidal rule errs by kappa (kappa dz)^2/12 at k = k0 + kappa, of k), but over
    tau it is a product: U_z = j kappa U + (j/2k) U_xx. So the record is transformed once and each frequency marches over z
    alone, with steps that only have to follow k_z - k: right for every frequency of the band, in any layers, and the image
    is the sum over frequencies at t = 0. Water of one speed above the first row is crossed at once, by cosines in x.

    Evanescent waves (|k_x| >= k) are taken out. Crank-Nicolson keeps the energy of each frequency to rounding.

    O(columns depths frequencies) base-band, O(columns cells steps) in time; memory: the records that the image can need,
    their margins, and the image, however long the record.
    """
    clock = time.perf_counter()
    _checks.choice("scheme", scheme, carrier.SCHEMES)
    _checks.choice("form", form, ("base-band", "carrier"))
    _checks.choice("weight", weight, ("flat", "backprojection"))
    if scheme == "euler" and form != "carrier":
        raise ValueError(f'scheme={scheme!r}: expected "cn" with form={form!r}')
    if correction is None:
        correction = "both" if scheme == "cn" else "none"
    _checks.choice("correction", correction, ("both", "centre", "compact", "none") if scheme == "cn" else ("none",))
    terms, workers, domains = equation(angle), _checks.threads(threads), _checks.whole("domains", domains)
    if step is not None:
        step = _checks.number("step", step, positive=True)
    summed = weight == "backprojection"
    carried = PLAIN if correction not in ("both", "compact") else COMPACT if form == "carrier" else SAMPLED
    line = Line.of(echoes, grid, layers, half_angle, margin, carried)
    if summed and (len(line.layers) > 1 or np.ndim(line.layers[0][1])):
        raise ValueError(f'weight={weight!r}: expected "flat" with layers')

    def migrate(part: Line, threads: int) -> tuple[Block, dict[str, Any]]:
        if form == "carrier":
            return _carrier(part, terms, scheme, correction, step, summed, threads)
        return _base_band(part, terms, 1 / 12 if correction in ("both", "compact") else 0.0, step, summed, threads)

    parts = line.split(domains, overlap)
    found: list[tuple[Block, dict[str, Any]] | None] = [None] * len(parts)

    def task(number: int) -> None:
        found[number] = migrate(parts[number][1], 1 if len(parts) > 1 else workers)

    _pool.run(task, len(parts), min(workers, len(parts)))
    image = np.zeros((line.z.size, len(line.data)), dtype=echoes.dtype)
    choices: dict[str, Any] = {"angle": angle, "form": form, "scheme": scheme, "correction": correction}
    for (first, part), made in zip(parts, found, strict=True):
        if made is None:
            raise _checks.InternalError("a part of the track was not migrated")
        image[:, first : first + len(part.data)] += made[0]
        choices |= made[1]
    if summed:
        image *= np.sqrt(line.z)[:, None].astype(image.real.dtype)
    out = np.empty(line.grid.shape, dtype=echoes.dtype)
    out[line.rows] = image[:, line.columns]
    choices |= {"half_angle": line.half_angle, "margin": line.margin, "domains": domains}
    seconds = time.perf_counter() - clock
    report = Report("one-way", threads=workers, backend="numba", sum_seconds=seconds, choices=choices)
    return Image(out, line.grid, report, echoes.fc, echoes.speed)


def spectrum(line: Line) -> tuple[Block, FloatArray]:
    """Base-band spectrum (column, frequency) of the traces, time from transmission, and its frequencies: the occupied band."""
    echoes = line.strip.echoes
    f = frequencies(line.period, echoes.fs)
    n, inside = f.size, np.abs(f) <= min(echoes.fs, echoes.occupied_bandwidth) / 2
    f = f[inside]
    matched = matched_filter(echoes, f)
    turns = f * line.strip.start
    filters = np.exp(-2j * np.pi * (turns - np.rint(turns))) * (1 if matched is None else matched) / n
    found = scipy.fft.fft(line.data, n, axis=1, workers=1)[:, inside]
    found *= filters
    return found, f


def _base_band(
    line: Line, terms: tuple[float, float], gamma: float, step: float | None, summed: bool, threads: int
) -> tuple[Block, dict[str, Any]]:
    """Image (depth, column) by frequencies."""
    echoes = line.strip.echoes
    wave, f = spectrum(line)
    n, start = len(wave), line.jump()
    fine = line.columns_per_ping(start) if gamma and n > 1 else 1
    march = March(echoes.fc + f, line.spacing, terms, gamma, threads, fine)
    columns = n + 2 * line.margin
    inside = slice(line.margin, line.margin + n)
    blocks = march.blocks(columns, wave.itemsize)
    waves: list[Block] = [wave] * len(blocks)

    def enter(number: int) -> None:
        padded = np.zeros((columns, blocks[number].stop - blocks[number].start), dtype=wave.dtype)
        padded[inside] = wave[:, blocks[number]]
        waves[number] = march.enter(padded, blocks[number], line.layers[0][1], start, summed)

    _pool.run(enter, len(blocks), threads)
    steps = line.steps(start, step, fine)
    out = np.zeros((line.z.size, n), dtype=wave.dtype)
    march.image(waves, blocks, steps, inside, out)
    return out, {"steps": steps.length.size, "frequencies": f.size, "columns_per_ping": fine}


def _carrier(
    line: Line, terms: tuple[float, float], scheme: str, correction: str, step: float | None, summed: bool, threads: int
) -> tuple[Block, dict[str, Any]]:
    """Image (depth, column) by marching in time."""
    echoes, z = line.strip.echoes, line.z
    if len(line.layers) > 1 or np.ndim(line.layers[0][1]):
        raise ValueError('layers: expected None with form="carrier": its cells are those of one sound speed')
    apart = np.diff(z) if z.size > 1 else np.ones(1)
    if np.ptp(apart) > 1e-6 * apart[0]:
        raise ValueError('grid: expected evenly spaced y with form="carrier"')
    wavelength = echoes.speed / (2 * echoes.fc)
    divided = int(np.ceil(apart[0] / (wavelength / 16 if step is None else step) * (1 - 1e-9)))
    dz = float(apart[0] / divided)
    # a cell j of Crank-Nicolson has taken j + 1 steps of diffraction; Euler's is where the paper puts it, at j dz
    ahead = int(scheme == "cn")
    before = max(int(z[0] / dz) - ahead, 0)
    offset = z[0] - (before + ahead) * dz
    cells = before + (z.size - 1) * divided + 1
    wave, f = spectrum(line)
    columns = len(wave) + 2 * line.margin
    padded = np.zeros((columns, f.size), dtype=wave.dtype)
    inside = slice(line.margin, line.margin + len(wave))
    padded[inside] = wave
    march = March(echoes.fc + f, line.spacing, terms, 0.0, threads)
    padded = march.enter(padded, slice(0, f.size), echoes.speed, 0.0, summed)
    latest = line.strip.start + (line.period - 1) / echoes.fs
    count = max(int(np.ceil((latest * echoes.speed / 2 - offset) / dz)), cells)

    def signal(first: int, last: int) -> Block:
        n = np.arange(first, last)
        t = 2 / echoes.speed * ((count - 1 - n + ahead) * dz + offset)
        cycles = (echoes.fc + f)[:, None] * t
        data = padded @ np.exp(2j * np.pi * (cycles - np.rint(cycles))).astype(padded.dtype)
        data[:, t > latest] = 0
        return np.ascontiguousarray(data.T)

    phase = 2 * np.pi / wavelength * dz
    if correction in ("both", "centre"):
        if phase >= np.pi:
            raise ValueError(f"step={dz:g} m: expected less than half of c/(2 fc), {wavelength / 2:g} m, to be corrected")
        terms = (terms[0] * np.tan(phase / 2) / (phase / 2), terms[1] * np.tan(phase / 2) / (phase / 2))
    gamma = 1 / 12 if correction in ("both", "compact") else 0.0
    ratio = dz / line.spacing
    parts = [carrier.Scheme.of(v, ratio, columns, scheme, gamma) for v in terms if v > 0]
    u = carrier.march(signal, count, cells, columns, parts, threads)
    return u[inside, before::divided].T, {"cells": cells, "steps": count, "dz": dz}
