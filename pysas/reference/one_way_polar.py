"""One-way migration in polar coordinates: circular paths, looking out or in.

With p = sqrt(r) u the wave equation has k_r^2 = k^2 + (d_phi^2 + 1/4)/r^2, of which the 15-degree equation is (4/c^2) p_tt +
(2/c) p_tr - (p_phi_phi + p/4)/(2 r^2) = 0. The print of it in K. Ito et al., Section 2, is lost, and that of their cylindrical
form with it; this is derived anew and is checked against Hankel functions, which are the exact waves. The cylindrical form is
not here.
"""

from __future__ import annotations

import time

import numpy as np
import scipy.fft

from pysas import _checks, _pool
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.reference.marching import Block, March, Steps
from pysas.reference.one_way_layout import SAMPLED, beam_angle, columns_per_ping, edge_turn, equation, longest_step, skirt
from pysas.reference.stripmap import TOLERANCE, frequencies, matched_filter

WIDEST = np.radians(60)  # from the radius; no equation here is right beyond


def one_way_polar(
    echoes: Echoes,
    grid: Grid,
    *,
    angle: int | tuple[float, float] = 45,
    half_angle: float | None = None,
    step: float | None = None,
    margin: int | None = None,
    threads: int | None = None,
) -> Image:
    """Image of a circular path, outside or inside the circle, by marching the one-way equation along radii.

    Parameters
    ----------
    echoes : Echoes
        One channel, monostatic, at even angles on a circle about the grid's centre; range-compressed, or raw with their pulse.
        A full circle is closed.
    grid : Grid
        `Grid.polar` about the circle's centre whose angles are those of pings and whose radii all lie outside the circle, or
        all inside.
    angle, step, threads
        As in `one_way`.
    half_angle : float, optional
        Largest angle from the radius at the sonar that must focus, rad; as in `one_way`, for a beam that looks along radii.
    margin : int, optional
        Columns added at either end: silence, or on a full circle the other end. Default: all that half_angle can cross.

    Returns
    -------
    Image
        complex64 or complex128 as the data, on `grid`; u itself, without the weight of back-projection.

    Raises
    ------
    ValueError, TypeError
        A path that is not this circle (the ping is named); radii on both sides of it; radii so small that a wave at half_angle
        would run at more than 60 degrees from the radius there; an argument outside its range.

    Notes
    -----
    A wave that leaves the circle of radius R at an angle theta from the radius has sin(theta') = R sin(theta)/r at r. Looking
    out, the equation gets better with range; looking in it fails as r falls to R sin(theta), and nothing reaches the centre
    but what was aimed at it. Over a step from a to b the mean of 1/r^2 is 1/(a b), so that at 15 degrees only Crank-Nicolson
    errs. p/4 turns phases by (1/R - 1/r)/(8 k), here taken at fc. Cost as `one_way`.
    """
    clock = time.perf_counter()
    circle = _Circle.of(echoes, grid)
    echoes = echoes.whole()
    terms, workers = equation(angle), _checks.threads(threads)
    highest = echoes.fc + min(echoes.fs, echoes.occupied_bandwidth) / 2
    spacing = circle.radius * circle.step
    half = _half_angle(echoes, circle, spacing, highest, half_angle)
    depth = np.abs(circle.r - circle.radius)
    last = int(np.argmax(depth))
    there = np.arcsin(circle.radius * np.sin(half) / circle.r[last])
    if margin is None:
        # beyond what a ray crosses the Fresnel zone, as on a full circle the margin's end is not silent
        beyond = 2 * np.sqrt(echoes.speed / (2 * echoes.fc) * depth[last]) / spacing if circle.closed else 0.0
        margin = min(echoes.n_ping, int(np.ceil(np.abs(half - there) / circle.step + beyond)))
    margin = min(_checks.whole("margin", margin, 0), echoes.n_ping)
    if step is None:
        step = longest_step(highest, echoes.speed, max(half, there), echoes.speed, float(depth[last]))
    steps = _steps(circle, _checks.number("step", step, positive=True), echoes.speed)
    start = float(echoes.start_time[0])
    late = 2 * depth[last] / echoes.speed / np.cos(max(half, there, 0.5)) - start
    n = max(echoes.n_sample, int(np.ceil(late * echoes.fs))) + 2 * skirt(echoes)
    n += max(0, int(np.ceil((start - 2 * depth.min() / echoes.speed) * echoes.fs)))
    f = frequencies(n, echoes.fs)
    n, inside = f.size, np.abs(f) <= min(echoes.fs, echoes.occupied_bandwidth) / 2
    f = f[inside]
    matched = matched_filter(echoes, f)
    wave = scipy.fft.fft(echoes.traces[circle.order, 0], n, axis=1, workers=workers)[:, inside]
    wave *= np.exp(-2j * np.pi * f * start) * (1 if matched is None else matched) / n
    wave = np.pad(wave, ((margin, margin), (0, 0)), "wrap" if circle.closed else "constant")
    turned = edge_turn(highest, echoes.speed, max(half, there), echoes.speed) * float(depth[last])
    fine = columns_per_ping(highest * spacing / echoes.speed, half, turned)
    march = March(echoes.fc + f, spacing, terms, 1 / 12, workers, fine)
    blocks = march.blocks(len(wave), wave.itemsize)
    waves: list[Block] = [wave] * len(blocks)

    def enter(number: int) -> None:
        waves[number] = march.enter(wave[:, blocks[number]], blocks[number], echoes.speed, 0.0, False)

    _pool.run(enter, len(blocks), workers)
    out = np.zeros((circle.r.size, echoes.n_ping), dtype=wave.dtype)
    march.image(waves, blocks, steps, slice(margin, margin + echoes.n_ping), out)
    quarter = (1 / circle.radius - 1 / circle.r) * np.sign(circle.r - circle.radius) * echoes.speed / (32 * np.pi * echoes.fc)
    out *= (np.sqrt(circle.radius / circle.r) * np.exp(1j * quarter)).astype(out.dtype)[:, None]
    image = np.ascontiguousarray(out[:, circle.columns].T)
    choices = {
        "angle": angle,
        "steps": steps.length.size,
        "frequencies": f.size,
        "margin": margin,
        "half_angle": half,
        "columns_per_ping": fine,
    }
    report = Report(
        "one-way, polar", threads=workers, backend="numba", sum_seconds=time.perf_counter() - clock, choices=choices
    )  # fmt: skip
    return Image(image, grid, report, echoes.fc, echoes.speed)


class _Circle:
    """A circular path and the radii to image: `order` sorts pings by growing angle, `columns` are the grid's angles in it."""

    def __init__(self, echoes: Echoes, grid: Grid) -> None:
        away = echoes.tx - np.array(grid.centre)
        limit = TOLERANCE * echoes.speed / echoes.fc
        self.radius = float(np.hypot(away[:, 0], away[:, 1]).mean())
        turn = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
        self.step = float(np.abs(turn[-1] - turn[0]) / (len(turn) - 1))
        even = turn[0] + np.sign(turn[-1] - turn[0]) * self.step * np.arange(len(turn))
        even = even + np.mean(turn - even)
        ideal = np.stack([self.radius * np.cos(even), self.radius * np.sin(even), np.zeros(len(even))], axis=1)
        for name, off in (("tx", away - ideal), ("rx", echoes.receivers[:, 0] - echoes.tx)):
            far = np.linalg.norm(off, axis=1)
            if far.max() > limit:
                ping = int(np.argmax(far > limit))
                raise ValueError(
                    f"echoes: {name} at ping {ping} is {far[ping]:.3g} m from a monostatic circle about the grid's centre at "
                    f"even angles: expected at most {TOLERANCE:g} wavelengths, {limit:.3g} m"
                )
        self.order = np.argsort(even)
        self.closed = bool(np.isclose(self.step * len(even), 2 * np.pi, rtol=1e-6))
        place = (grid.axes["angle"] - even.min()) / self.step
        place = place - np.floor((place + 0.5) * self.step / (2 * np.pi)) * (2 * np.pi / self.step)
        self.columns = np.rint(place).astype(np.int64)
        off = np.abs(place - self.columns)
        if off.max() > 1e-3 or self.columns.max() >= len(even):
            column = int(np.argmax((off > 1e-3) | (self.columns >= len(even))))
            raise ValueError(f"grid: angle={grid.axes['angle'][column]:g} rad at column {column}: expected the angle of a ping")
        self.r = grid.axes["r"]

    @classmethod
    def of(cls, echoes: Echoes, grid: Grid) -> _Circle:
        """Check the arguments of a migration."""
        if not isinstance(echoes, Echoes):
            raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
        if not isinstance(grid, Grid) or grid.kind != "polar":
            raise TypeError(f"grid={grid!r}: expected a pysas.Grid.polar")
        if echoes.n_channel != 1 or echoes.velocity is not None or echoes.n_ping < 2:
            raise ValueError(
                f"echoes: {echoes.n_ping} pings x {echoes.n_channel} channels: expected several of one, stationary"
            )
        if np.ptp(echoes.start_time) * echoes.fc > TOLERANCE:
            raise ValueError("echoes: t0 differs between pings: expected one start time")
        finite = np.isfinite(echoes.whole().traces).all(axis=(1, 2))
        if not finite.all():
            raise ValueError(f"echoes: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
        circle = cls(echoes, grid)
        out = np.sign(circle.r - circle.radius)
        if circle.r.min() <= 0 or np.any(out != out[0]):
            raise ValueError(f"grid: r from {circle.r.min():g} to {circle.r.max():g} m: expected all on one side of the circle")
        return circle


def _half_angle(echoes: Echoes, circle: _Circle, spacing: float, highest: float, half_angle: float | None) -> float:
    if half_angle is None and echoes.beam is not None:
        half_angle = min(echoes.beam.half_angle, 1.1)
    half = beam_angle(echoes.replace(beam=None), spacing, highest, half_angle, SAMPLED)
    sine = circle.radius * np.sin(half) / circle.r.min()
    if sine > np.sin(WIDEST):
        raise ValueError(
            f"grid: at r={circle.r.min():g} m the half-angle of {np.degrees(half):.3g} degrees becomes more than 60 degrees "
            f"from the radius: expected r >= {circle.radius * np.sin(half) / np.sin(WIDEST):.4g} m"
        )
    return half


def _steps(circle: _Circle, step: float, c: float) -> Steps:
    """Steps from the circle to every radius in turn."""
    depth = np.abs(circle.r - circle.radius)
    order, out = np.argsort(depth), np.sign(circle.r[0] - circle.radius)
    length, time_, row, spread = [], [], [], []
    low = 0.0
    for i in order:
        high = float(depth[i])
        n = max(1, int(np.ceil((high - low) / step * (1 - 1e-9))))
        length += [(high - low) / n] * n
        place = low + (high - low) * np.arange(n + 1) / n
        time_ += list(2 / c * place[1:])
        row += [-1] * (n - 1) + [int(i)]
        # one factor for some steps, while r changes by less than a hundredth: the mean of 1/r^2 over them
        several = max(1, int(0.01 * circle.r.min() / ((high - low) / n))) if n > 1 else 1
        ends = np.minimum(np.arange(n) // several * several + several, n)
        r_before, r_after = (circle.radius + out * place[e] for e in (np.arange(n) // several * several, ends))
        spread += list(circle.radius**2 / (r_before * r_after))
        low = high
    return Steps(np.array(length), np.array(time_), [c] * len(length), np.array(row), np.array(spread))
