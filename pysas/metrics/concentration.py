"""How concentrated an image's energy is: what autofocus lowers or raises, and what tells targets from speckle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import entr

from pysas.metrics.responses import Float, pixels
from pysas.model.image import Image


def entropy(image: Image | npt.ArrayLike) -> float:
    """-sum q ln q with q = |I|^2 / sum |I|^2, nats: the lower, the fewer pixels hold the energy.

    ln n where n pixels are alike, 0 where one has all. Developed speckle has ln n - 1 + 0.5772 (Euler's constant) whatever the
    errors of phase, so that a lower entropy there is no better focus.

    Parameters
    ----------
    image : Image or array_like
        Real or complex amplitudes, of any shape.

    Returns
    -------
    float

    Raises
    ------
    ValueError, TypeError
        No pixels, all zero, non-finite or masked ones, or no numbers.

    Notes
    -----
    O(pixels) time and memory.
    """
    return float(entr(_shares(image)).sum())


def sharpness(image: Image | npt.ArrayLike) -> float:
    """n sum |I|^4 / (sum |I|^2)^2 over n pixels: the contrast of the intensity, from 1 to n.

    1 where all pixels are alike, n where one has all the energy. Developed speckle has 2 (its intensity is exponential), within
    about sqrt(20/N) for N independent cells of resolution; far more means that few pixels stand out.

    Parameters
    ----------
    image : Image or array_like
        Real or complex amplitudes, of any shape.

    Returns
    -------
    float

    Raises
    ------
    ValueError, TypeError
        As for `entropy`.

    Notes
    -----
    O(pixels) time and memory.
    """
    share = _shares(image)
    return float(share.size * np.sum(share**2))


def _shares(image: Image | npt.ArrayLike) -> Float:
    """Of each pixel in the energy."""
    amplitude = np.abs(pixels("image", image))
    if amplitude.size == 0:
        raise ValueError(f"image: shape {amplitude.shape}: expected at least one pixel")
    if not np.isfinite(amplitude).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(amplitude))[0])
        raise ValueError(f"image: {amplitude[index]} at pixel {index}: expected finite pixels")
    largest = float(amplitude.max())
    if largest == 0:
        raise ValueError("image: all zero: expected energy to share out")
    energy = (amplitude / largest) ** 2  # the square of a small or large amplitude is no float
    return np.asarray(energy / energy.sum())
