"""The oracle's answers, computed once for engines, instruction sets, dtypes and tolerances that image the same echoes.

`exact` is `pysas.reference.exact`, remembered by all that it is given, to the last bit.
"""

from __future__ import annotations

import hashlib
import pickle
from collections import OrderedDict

import numpy as np
import numpy.typing as npt

import pysas

KEPT = 512  # answers: more than tests of one file go to and fro between

_answers: OrderedDict[bytes, tuple[np.ndarray, np.ndarray]] = OrderedDict()


def exact(
    echoes: pysas.Echoes, grid: pysas.Grid, pixels: npt.ArrayLike | None = None, weights: npt.ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Image and level, read-only."""
    key = hashlib.blake2b(pickle.dumps((echoes, grid, pixels, weights), protocol=5)).digest()
    if key not in _answers:
        _answers[key] = pysas.reference.exact(echoes, grid, pixels, weights)
        for array in _answers[key]:
            array.flags.writeable = False
    _answers.move_to_end(key)
    if len(_answers) > KEPT:
        _answers.popitem(last=False)
    return _answers[key]
