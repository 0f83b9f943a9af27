"""Curved paths by one-way continuation: what a straight line would have recorded, for omega-k to image.

A gently curved path bounds the water on one side (K. Ito et al., Section 4). The echoes of each ping enter where the march
passes its place; a reference line behind the whole path then holds the record of a straight track.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks, _pool
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.reference.marching import Block, March, Solver, one_way_wavenumber
from pysas.reference.one_way_layout import COMPACT, PHASE, beam_angle, equation, longest_step, skirt
from pysas.reference.stripmap import TOLERANCE, Strip, frequencies, prepare


def map_to_line(
    echoes: Echoes,
    path: npt.ArrayLike | None = None,
    line: float | None = None,
    *,
    angle: int | tuple[float, float] = 45,
    half_angle: float | None = None,
    step: float | None = None,
    margin: int | None = None,
    threads: int | None = None,
) -> Echoes:
    """Echoes that a straight line would have recorded, from those of a path curved in the slant plane.

    Parameters
    ----------
    echoes : Echoes
        One channel, monostatic, evenly spaced in x at one height; raw or range-compressed.
    path : (ping, 3) array_like, optional
        Positions to go by instead of `echoes.tx`, m.
    line : float, optional
        y of the line, m; default: the point of the path nearest to the scene. No part of the path may lie beyond it.
    angle, half_angle, step, margin, threads
        As in `one_way`; half_angle is about the normal of the line.

    Returns
    -------
    Echoes
        On the line, starting earlier by the time to cross what lies between path and line; as long at the far end.

    Raises
    ------
    ValueError, TypeError
        A path that is uneven in x or leaves its plane, that runs steeper to the line than half_angle, or beyond the line (the
        ping is named); an argument outside its range.

    Notes
    -----
    A frequency's wave W (its plane wave exp(j k z) taken out) has the values s exp(-j k g) on the path z = g(x) and obeys the
    one-way equation beyond it. Columns whose ping the march has not passed keep that value, which is what bounds the others:
    right to k g (1 - cos(angle)) for the short way between neighbours. (Zero there, as a literal reading of the paper has it,
    bends the waves next to it.) O(pings steps frequencies); memory 2 to 3 times the data.
    """
    strip, depth, place = _path(echoes, path, line)
    terms, workers = equation(angle), _checks.threads(threads)
    highest = echoes.fc + min(echoes.fs, echoes.occupied_bandwidth) / 2
    half = beam_angle(echoes, strip.spacing, highest, half_angle, COMPACT)
    slope = np.abs(np.diff(depth)) / strip.spacing
    if slope.max() > np.tan(half):
        x = strip.x0 + strip.spacing * int(np.argmax(slope))
        raise ValueError(
            f"path: {np.degrees(np.arctan(slope.max())):.3g} degrees steep after the ping at x={x:.4g} m: expected at most the "
            f"half-angle, {np.degrees(half):.3g} degrees"
        )
    reach = strip.side * (place - strip.y0)
    if step is None:
        turn = -float(one_way_wavenumber(np.array(4 * np.pi * highest / echoes.speed), np.array(np.sin(half) ** 2), terms))
        step = min(longest_step(highest, echoes.speed, half, echoes.speed, reach), PHASE / turn)
    count = max(1, int(np.ceil(reach / _checks.number("step", step, positive=True) * (1 - 1e-9))))
    if margin is None:
        margin = min(len(depth), int(np.ceil(reach * np.tan(half) / strip.spacing)))
    margin = _checks.whole("margin", margin, 0)
    earlier = int(np.ceil(2 * reach / echoes.speed * echoes.fs))
    f = frequencies(echoes.n_sample + earlier + skirt(echoes), echoes.fs)
    inside = np.flatnonzero(np.abs(f) <= min(echoes.fs, echoes.occupied_bandwidth) / 2)
    spectrum = scipy.fft.fft(strip.data, f.size, axis=1, workers=workers)
    line_spectrum = np.zeros_like(spectrum)
    march = March(echoes.fc + f[inside], strip.spacing, terms, 1 / 12, workers)
    blocks = march.blocks(len(depth) + 2 * margin, spectrum.itemsize)
    passed = np.pad(np.rint(depth / max(reach, 1e-300) * count).astype(np.int64), margin, "edge")

    def task(number: int) -> None:
        part, frequency = inside[blocks[number]], march.frequency[blocks[number]]
        w = np.zeros((passed.size, part.size), dtype=spectrum.dtype)
        w[margin : passed.size - margin] = spectrum[:, part] * _turned(-2 * depth[:, None] / echoes.speed * frequency)
        _cross(w, march.factor(reach / count, echoes.speed, blocks[number]), passed, count)
        turns = 2 * reach / echoes.speed * frequency - f[part] * earlier / echoes.fs
        line_spectrum[:, part] = w[margin : passed.size - margin] * _turned(turns)

    _pool.run(task, len(blocks), workers)
    data = scipy.fft.ifft(line_spectrum, axis=1, overwrite_x=True, workers=workers)[:, : echoes.n_sample + earlier]
    tx = np.stack(
        [strip.x0 + strip.spacing * np.arange(len(depth)), np.full(len(depth), place), np.full(len(depth), strip.z0)], 1
    )
    if echoes.tx[0, 0] > echoes.tx[-1, 0]:
        data, tx = data[::-1], tx[::-1]
    data = np.ascontiguousarray(data)
    return echoes.replace(data=data, tx=tx, rx=tx, t0=strip.start - earlier / echoes.fs)


def _path(echoes: Echoes, path: npt.ArrayLike | None, line: float | None) -> tuple[Strip, FloatArray, float]:
    """The track laid straight, the depth of each ping beyond it (m, in order of growing x), and y of the line."""
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    found = echoes.tx if path is None else _checks.reals("path", path, [(echoes.n_ping, 3)], ("ping",))
    off = np.abs(found[:, 2] - found[:, 2].mean())
    limit = TOLERANCE * echoes.speed / echoes.fc
    if off.max() > limit:
        ping = int(np.argmax(off > limit))
        raise ValueError(
            f"path: ping {ping} is {off[ping]:.3g} m above or below the others: expected at most {TOLERANCE:g} wavelengths, "
            f"{limit:.3g} m (motion_compensate takes out heave)"
        )
    straight = found * [1.0, 0.0, 1.0]
    baseline = echoes.receivers - echoes.tx[:, None]
    beam = echoes.beam
    side = -1.0 if beam is not None and beam.boresight.reshape(-1, 3)[:, 1].mean() < 0 else 1.0
    ahead = side * found[:, 1]
    straight[:, 1] = side * ahead.min()
    rx = (straight[:, None] + baseline).reshape(echoes.rx.shape)
    strip = prepare(echoes.replace(tx=straight, rx=rx), None)
    depth = ahead - ahead.min()
    place = side * ahead.max() if line is None else _checks.number("line", line)
    beyond = side * place - ahead
    if beyond.min() < -1e-9:
        ping = int(np.argmin(beyond))
        raise ValueError(
            f"line={place!r}: ping {ping} at y={found[ping, 1]:g} m lies beyond it: expected y of all pings before it"
        )
    return strip, depth[::-1] if found[0, 0] > found[-1, 0] else depth, float(place)


def _turned(turns: FloatArray) -> npt.NDArray[np.complex128]:
    return np.asarray(np.exp(2j * np.pi * (turns - np.rint(turns))))


def _cross(w: Block, a: npt.NDArray[np.complex128], passed: npt.NDArray[np.int64], count: int) -> None:
    """`count` steps; a column whose ping is passed at step `passed` keeps its value until then."""
    solver, kept = Solver(w), w.copy()
    solver.prepare(a)
    for s in range(1, count + 1):
        solver.step(w)
        waiting = passed >= s
        w[waiting] = kept[waiting]
