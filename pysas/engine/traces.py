"""What every kernel is told of a trace and of the medium, as records: the structs Trace and Model of csrc/core/kernels.hpp.

C++ takes the records themselves, and no others; Numba's kernels take their reals. Records are picked by `take` or `compress`,
which copy whole ones: an index copies field by field, five times as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray

Records = npt.NDArray[np.void]

BLOCK, TILE_ROWS = 64, 32  # pixels of a block and lines of a tile at most, see csrc/core/kernels.hpp
MONOSTATIC, STOP_AND_HOP, MOVING = 0, 1, 2  # kinds of delays
NO_BEAM, CONE, FAN = 0, 1, 2  # shapes of beams

PLACE = (np.float64, (3,))
TRACE = np.dtype(
    [
        ("tx", *PLACE),  # m, at the start of transmission
        ("rx", *PLACE),
        ("velocity", *PLACE),  # of the receiver, m/s
        ("boresight", *PLACE),  # of length 1, or zeros
        ("axis", *PLACE),  # along a fan's element, of length 1, or zeros
        ("t0", np.float64),  # time of sample 0 of the record, s
        ("c", np.float64),  # speed of sound, m/s
        ("first", np.float64),  # samples that were recorded: others count for nothing
        ("last", np.float64),
        ("kept", np.float64),  # number of the first sample kept
        ("interval", np.float64),  # for Numba's kernels alone: the trace's first interval in a table of all
    ]
)
BEAM = np.dtype(
    [
        ("shape", np.float64),
        ("half_angle", np.float64),  # the largest that counts
        ("full_angle", np.float64),  # the largest whose weight is 1: less than half_angle where the beam has a taper
    ]
)
MODEL = np.dtype(
    [
        ("c", np.float64),
        ("fc", np.float64),
        ("fs", np.float64),
        ("rate", np.float64),  # intervals per sample
        ("last", np.float64),  # last sample number that counts
        ("beam", BEAM),
        ("near", np.float64),  # distance below which every pixel's delay is exact, m
        ("run", np.float64),  # traces that a sum in float32 may have before it is added to one in float64; 0: any number
    ]
)


def record(kind: np.dtype[Any], **values: Any) -> Records:
    """One record, every field of it given by name."""
    if set(values) != set(kind.names or ()):
        raise TypeError(f"expected {kind.names}, found {tuple(values)}")
    out = np.empty((), kind)
    for name, value in values.items():
        out[name] = value
    return out


def reals(records: Records) -> FloatArray:
    """The same memory with a last axis of reals, where `place` has the fields."""
    return records.reshape(-1).view(np.float64).reshape(*records.shape, -1)


def place(kind: np.dtype[Any], name: str) -> int:
    """Number of a field's first real."""
    if kind.fields is None:
        raise TypeError(f"expected records, found {kind}")
    return kind.fields[name][1] // np.dtype(np.float64).itemsize
