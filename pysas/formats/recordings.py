"""What recorders leave behind: raw binary samples, which are mapped, and pulses as WAV.

Sizes are compared with the bytes that lie in a file before anything is allocated; every error names the file. `tables` reads
tables of text, `matlab` .mat files.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas.formats import files

Array = npt.NDArray[Any]


def read_samples(path: str, dtype: str, shape: Sequence[int]) -> Array:
    """Real samples of a raw binary file without a header, mapped and not read.

    Parameters
    ----------
    path : str
        A regular file that holds them all and nothing else, the last index fastest.
    dtype : str
        A sample's type in NumPy's words: "int16" (this machine's byte order), "<i2", ">i4", "float32".
    shape : of int
        Pings, channels, samples of a trace.

    Raises
    ------
    ValueError
        Another size of file than they take, no type of real numbers, a number below 1.
    OSError
        From the file system.
    """
    try:
        kind = np.dtype(dtype)
    except (TypeError, ValueError, SyntaxError):
        kind = np.dtype(object)
    if kind.kind not in "iuf" or kind.itemsize > 8:
        raise ValueError(f"{path}: dtype {dtype!r:.60}: expected a type of real numbers such as int16, <i2, >i4, float32")
    if min(shape) < 1:
        raise ValueError(f"{path}: shape {' x '.join(map(str, shape))}: expected numbers of 1 or more")
    expected = math.prod(shape) * kind.itemsize
    with files.opened(path) as file:
        found = os.fstat(file.fileno()).st_size
        if found != expected:
            text = f"{' x '.join(map(str, shape))} samples of {kind.name}"
            raise ValueError(f"{path}: {found} bytes: expected {expected}, {text}")
        return np.memmap(file, dtype=kind, mode="r", shape=tuple(shape))


def read_wav(path: str) -> tuple[Array, float]:
    """One channel of samples from a WAV file (integers of 16 to 32 bits or floats), and their rate, Hz.

    Raises ValueError for a damaged file, several channels or 8 bits, OSError from the file system.
    """
    from scipy.io import wavfile  # a tenth of a second that other commands need not wait for

    with files.opened(path) as file:
        content = file.read()
    order = {b"RIFF": "little", b"RIFX": "big"}.get(content[:4])
    declared = int.from_bytes(content[4:8], "big" if order == "big" else "little") + 8
    if order is None or declared > len(content):
        short = f"ends {declared - len(content)} bytes early" if order else "does not begin with RIFF"
        raise ValueError(f"{path}: {short}: expected a WAV file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks of text beside the samples
            rate, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:  # scipy has many ways of saying that bytes are wrong
        raise ValueError(f"{path}: expected a WAV file ({error or type(error).__name__})") from None
    if samples.ndim != 1 or samples.size == 0 or samples.dtype.kind not in "if" or samples.dtype.itemsize < 2:
        raise ValueError(f"{path}: {samples.dtype} of shape {samples.shape}: expected one channel of 16 bits or more")
    return samples, float(rate)
