"""Multi-look and sub-band images: an image's spectrum cut into parts, their intensities averaged.

Each part is a sub-aperture (along-track wavenumbers are angles) or a band of frequencies; their speckle is independent, so
the incoherent mean of N parts has the speckle contrast 1/sqrt(N). It relies on Image alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.image import Image

_EDGE = 1e-3  # of the power, at either end of a spectrum, that counts as outside its band


@dataclass(frozen=True, eq=False)
class Looks:
    """Sub-images of one image.

    Attributes
    ----------
    images : tuple of Image
        One per look on the image's grid: sub-apertures (in order of along-track wavenumber) for each band, bands in order.
    intensity : float64 of the grid's shape
        Mean of |look|^2.
    contrast : float
        Speckle contrast of `intensity` over the grid: standard deviation over mean. 1 for one look of a uniform field of many
        scatterers, 1/sqrt(N) for N independent looks.
    """

    images: tuple[Image, ...]
    intensity: FloatArray
    contrast: float


def looks(image: Image, sub_apertures: int = 4, bands: int = 1) -> Looks:
    """Split an image into sub-apertures and bands and average their intensities (R. Sathishkumar et al., Section III).

    Parameters
    ----------
    image : Image
        Complex, on a plane grid, x along-track and evenly spaced, finer than its spectrum needs.
    sub_apertures, bands : int
        Parts of the along-track and of the range spectrum, >= 1, each of equal energy.

    Returns
    -------
    Looks

    Raises
    ------
    ValueError, TypeError
        Another kind of grid, a non-finite or all-zero image, fewer pixels than parts.

    Notes
    -----
    The spectrum's parts have sharp ends and do not overlap, so the sum of all looks is the image within its band, and their
    energies add up to its own. Energy in the outer thousandths of either spectrum is left out. Range and along-track resolution
    fall by about the numbers of parts. O(n log n); memory (sub_apertures bands + 3) images.
    """
    if not isinstance(image, Image):
        raise TypeError(f"image={type(image).__name__}: expected pysas.Image")
    if image.grid.kind != "plane":
        raise ValueError(f"image: expected a plane grid, found {image.grid.kind}")
    for name, axis in image.grid.axes.items():
        steps = np.diff(axis)
        if steps.size and np.ptp(steps) > 1e-6 * np.abs(steps).max():
            raise ValueError(f"image: expected an evenly spaced axis {name}")
    counts = [_checks.whole(name, value) for name, value in (("bands", bands), ("sub_apertures", sub_apertures))]
    data = np.asarray(image.data, dtype=np.complex128)
    if not np.isfinite(data).all() or not data.any():
        raise ValueError("image: expected finite pixels, not all zero")
    for axis_number, (name, count) in enumerate(zip(("bands", "sub_apertures"), counts, strict=True)):
        if count > data.shape[axis_number]:
            raise ValueError(f"{name}={count}: expected at most the {data.shape[axis_number]} pixels along that axis")
    spectrum = scipy.fft.fft2(data)
    power = np.abs(spectrum) ** 2
    parts = [_parts(power.sum(axis=1 - axis), count) for axis, count in enumerate(counts)]
    images = []
    for rows in parts[0]:
        for columns in parts[1]:
            part = np.zeros_like(spectrum)
            part[np.ix_(rows, columns)] = spectrum[np.ix_(rows, columns)]
            look = scipy.fft.ifft2(part).astype(image.data.dtype)
            images.append(Image(look, image.grid, image.report, image.fc, image.c))
    intensity = np.mean([np.abs(look.data.astype(np.complex128)) ** 2 for look in images], axis=0)
    return Looks(tuple(images), intensity, float(intensity.std() / intensity.mean()))


def _parts(power: FloatArray, count: int) -> list[npt.NDArray[Any]]:
    """Indices of the frequencies of each part, in FFT order, of equal energy."""
    n = power.size
    # the spectrum may lie across the end of the FFT's axis: begin opposite to its centre
    centre = np.angle(np.sum(power * np.exp(2j * np.pi * np.arange(n) / n))) / (2 * np.pi) * n
    order = (np.arange(n) + int(np.rint(centre)) - n // 2) % n
    total = np.cumsum(power[order]) / power.sum()
    share = np.linspace(_EDGE, 1 - _EDGE, count + 1)
    edges = np.searchsorted(total, share, side="right")
    edges[-1] = min(edges[-1] + 1, n)
    return [order[begin:end] for begin, end in zip(edges[:-1], edges[1:], strict=True)]
