"""Trees below groups of traces, made in C++: what subapertures.make_subtree does in Python."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pysas._checks import FloatArray
from pysas.engine import native
from pysas.engine.traces import Records
from pysas.engine.tree import PLACE, SHAPE, IntArray, SubImages, Taps


def make(
    trace: Records, centres: FloatArray, order: IntArray, medium: FloatArray, fans: Sequence[int], taps: Taps,
    plane: float, direction: float, readings: FloatArray, step: float, left: int,
) -> tuple[IntArray, tuple[SubImages, ...], float] | None:  # fmt: skip
    """Traces in the leaves' order, levels, leaves first, and the highest frequency along their rays, for `readings` (n, 4):
    bearings from `direction` and grounds; None where these would take more than the floats `left`.

    `order` : the group's traces; `medium` : sound speed, carrier, bandwidth and about what passes until an echo arrives where
    receivers move.
    """
    ordered, counts, place, shape, ranges, span, along = native.core().subtree(
        trace, centres, order, medium, fans, taps.width, taps.half, taps.rate, plane, direction, readings, step, left
    )
    if not len(counts):
        return None
    places, shapes, ranges = place.reshape(-1, PLACE), shape.reshape(-1, SHAPE), ranges.reshape(-1, 2)
    levels = []
    image = rays = ends = 0
    for count in counts:
        own = shapes[image : image + count]
        more, size = int(own[:, 1].sum()), int(own[-1, 3] + 2 * own[-1, 1] * own[-1, 2])
        levels.append(
            SubImages(places[image : image + count], own, ranges[rays : rays + more], span[ends : ends + count + 1], size)
        )
        image, rays, ends = image + count, rays + more, ends + count + 1
    return np.asarray(ordered), tuple(levels), float(along)
