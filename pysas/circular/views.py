"""Weights that make a sum over pings and channels uniform in view angle, for any track and any array.

Each (pixel, ping, channel) term counts by the arc of view angles it stands for, so that the point spread function is the
same all over the image: for an off-centre pixel of a circle, a circle that is not closed, an uneven track. On a circle the
weights tend to the Jacobian d theta'/d theta of Y. Pailhas et al., JASA 141 (2017), Eq 2, and the weighted sum to their
resampled one (Eq 7), with no ping interpolated or dropped.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.circular import beams
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid

COINCIDENT = 1e-9  # rad: views nearer than this are one
OPENING = 4.0  # a gap more than this many times as wide as those beside it is none of the track's own
TIE = 1e-6  # by this part more at least: rounding must not decide about gaps that are whole multiples of others

Bool = npt.NDArray[np.bool_]


def view_angles(tx: npt.ArrayLike, rx: npt.ArrayLike, points: npt.ArrayLike) -> FloatArray:
    """Angle from which each transmitter and receiver together see each point.

    Parameters
    ----------
    tx : (ping, 3)
        Transmitters, m.
    rx : (ping, channel, 3)
        Receivers, m.
    points : (point, 3)
        In m.

    Returns
    -------
    float64 (point, ping, channel)
        Azimuth, rad in [-pi, pi], of the bisector of the unit vectors from the point to transmitter and receiver, projected
        on the horizontal plane: the direction along which the echo's phase changes fastest there. NaN where there is none: a
        point on a transducer, or right between transmitter and receiver or below their middle.

    Raises
    ------
    ValueError, TypeError
        Arrays of wrong shape or not finite.
    """
    tx = _checks.reals("tx", tx, [("ping", 3)], ("ping",))
    rx = _checks.reals("rx", rx, [(len(tx), "channel", 3)], ("ping", "channel"))
    points = _checks.reals("points", points, [("point", 3)], ("point",))
    angles = np.empty((len(points), *rx.shape[:2]))
    for number, point in enumerate(points):
        outward, back = tx[:, None] - point, rx - point
        away, returned = np.linalg.norm(outward, axis=-1), np.linalg.norm(back, axis=-1)
        bisector = outward[..., :2] * returned[..., None] + back[..., :2] * away[..., None]
        angles[number] = np.arctan2(bisector[..., 1], bisector[..., 0])
        size = np.linalg.norm(bisector, axis=-1)
        angles[number][size <= 1e-12 * away * returned] = np.nan
    return angles


def view_weights(echoes: Echoes, grid: Grid, pixels: npt.ArrayLike | None = None) -> FloatArray:
    """Weight of each (pixel, ping, channel) that makes the sum uniform in view angle.

    Parameters
    ----------
    echoes : Echoes
        Its geometry; samples are not looked at. Terms outside its beam weigh 0; a taper changes nothing within, for a sum
        weighs its terms by that as well.
    grid : Grid
    pixels : (n,) integers, optional
        Flat indices (C order) of the pixels wanted; default: all.

    Returns
    -------
    float64 (pixel, ping, channel)
        >= 0; mean 1 over the terms that count.

    Raises
    ------
    TypeError
        Arguments of the wrong type.

    Notes
    -----
    The views of a pixel are sorted by angle, and each has the arc from half-way to its neighbour on one side to half-way on
    the other (a Voronoi cell of the circle), whether or not a beam lights the pixel from there. Views within 1e-9 rad of
    each other share one arc equally. A gap more than 4.000004 times as wide as any of the 2 channel + 2 gaps before it, or
    any of those after it, is an opening - the end of a track, a missing sector - and belongs to nobody: the views at its
    ends have arcs twice their inner half; 4 times is none, so that rounding does not decide where three pings of an even
    circle are missing. A lone view between two openings has the median arc. Receivers are taken where they are at
    transmission. O(view log view) per pixel.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={echoes!r}: expected pysas.Echoes")
    if not isinstance(grid, Grid):
        raise TypeError(f"grid={grid!r}: expected a pysas.Grid")
    points = grid.coordinates(pixels)
    angles = view_angles(echoes.tx, echoes.receivers, points)
    weights = np.zeros(angles.shape)
    for angle, lit, weight in zip(angles, _in_beam(echoes, points)[..., None], weights, strict=True):
        found = np.isfinite(angle)
        if np.any(found & lit):
            weight[found] = arc_weights(angle[found], echoes.n_channel)
            weight *= lit / np.mean(weight[found & lit])
    return weights


def arc_weights(angles: npt.ArrayLike, channels: int = 1) -> FloatArray:
    """Arcs of the circle that views at `angles` stand for, of mean 1; the rule is that of `view_weights`.

    Parameters
    ----------
    angles : (view,)
        In rad, any order.
    channels : int
        Views of each ping: a gap is compared with the 2 channels + 2 on either side.

    Returns
    -------
    float64 (view,)

    Raises
    ------
    ValueError, TypeError
        No angle, or angles that are not finite.
    """
    angles = _checks.reals("angles", angles, [("view",)], ("view",))
    channels = _checks.whole("channels", channels)
    if angles.size == 0:
        raise ValueError("angles: expected at least one view")
    turn = np.mod(angles, 2 * np.pi)
    order = np.argsort(turn, kind="stable")
    gaps = np.diff(turn[order], append=turn[order[0]] + 2 * np.pi)
    # begin after the widest gap, so that coincident views stand together
    widest = int(np.argmax(gaps))
    order, gaps = np.roll(order, -widest - 1), np.roll(gaps, -widest - 1)
    first = np.concatenate([[True], gaps[:-1] > COINCIDENT])
    group = np.cumsum(first) - 1
    gaps = gaps[np.concatenate([first[1:], [True]])]
    arcs = _arcs(gaps, channels)[group] / np.bincount(group)[group]
    weights = np.empty(angles.size)
    weights[order] = arcs / np.mean(arcs)
    return weights


def _arcs(gaps: FloatArray, channels: int) -> FloatArray:
    """Arc of each view from the gaps that follow them around the circle."""
    n = gaps.size
    if n < 3:
        return np.ones(n)
    # so many that overlapping pings of an array, or a few nearly coincident ones, do not make their neighbours look wide
    steps = range(1, 1 + min(2 * channels + 2, (n - 1) // 2))
    before, after = (np.max([np.roll(gaps, side * step) for step in steps], axis=0) for side in (1, -1))
    opening = gaps > OPENING * (1 + TIE) * np.minimum(before, after)
    after = np.where(opening, 0.0, gaps / 2)
    before = np.roll(after, 1)
    ends = opening | np.roll(opening, 1)
    arcs = np.where(ends, 2, 1) * (before + after)
    alone = arcs == 0
    if alone.any():
        arcs[alone] = np.median(arcs[~alone]) if not alone.all() else 1.0
    return np.asarray(arcs)


def _in_beam(echoes: Echoes, points: FloatArray) -> Bool:
    """(point, ping): whether a point lies within the transmitter's beam."""
    seen = np.ones((len(points), echoes.n_ping), dtype=np.bool_)
    if echoes.beam is None:
        return seen
    for number, point in enumerate(points):
        seen[number] = beams.lit(echoes.beam, beams.off_middle(echoes.beam, point - echoes.tx))
    return seen
