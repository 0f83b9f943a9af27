"""One-way migration against the exact sum, its two forms against each other, and both against the formulas of their steps.

Figures of the 10 cm experiment (peaks, widths) and of dispersion were computed beforehand by an independent prototype; they
are stated where they are used.
"""

import numpy as np
import pytest
import stripmap_scenes as scenes

import pysas
from pysas.reference import exact, one_way

POINTS = ((0.0, 8.0), (0.5, 9.0), (-0.7, 10.0))


def even(pings, spacing=0.01):
    return spacing * (np.arange(pings) - pings // 2)


@pytest.fixture(scope="module")
def narrow():
    """100 kHz, cos^2 beam of sines up to 0.15, spacing 1 cm: k_x dx <= 1.4."""
    return scenes.smooth(POINTS, even(400), fc=100e3, band=15e3, fs=20e3, near=7.5, samples=100, width=0.15)


@pytest.fixture(scope="module")
def low():
    """7.5 kHz, c/(2 fc) = 10 cm, sines up to 0.25, spacing 5 cm; a carrier's grid is affordable."""
    return scenes.smooth(((0.0, 8.0),), even(120, 0.05), fc=7500, band=4000, fs=5e3, near=6.5, samples=30, width=0.25)


LOW_GRID = pysas.Grid.plane(even(120, 0.05)[30:90], 7.4 + 0.05 * np.arange(24))


def against_exact(image, echoes, count=2000):
    """Relative error on random pixels."""
    pixels = np.random.default_rng(0).choice(image.grid.size, min(count, image.grid.size), replace=False)
    direct, level = exact(echoes, image.grid, pixels)
    return pysas.metrics.relative_error(image.data.ravel()[pixels], direct, level)


@pytest.mark.parametrize(("angle", "limit"), [(15, 0.03), (45, 0.006)])
def test_it_is_back_projection(narrow, angle, limit):
    # no factor is fitted. 15 degrees: phase k z s^4/8 = 0.5 rad at s = 0.15 and 9 m, where the beam is dark
    image = one_way(narrow, angle=angle, weight="backprojection", half_angle=0.15, threads=1)
    assert against_exact(image, narrow) < limit


@pytest.mark.parametrize("angle", [15, 45])
def test_the_base_band_is_the_carrier_form(low, angle):
    # two layers of one speed: it marches from the track, with the same differences in x
    layers = [(0.0, 1500.0), (0.01, 1500.0)]
    base = one_way(low, LOW_GRID, angle=angle, half_angle=0.25, step=0.004, layers=layers, threads=1)
    errors = [
        pysas.metrics.relative_error(
            one_way(low, LOW_GRID, angle=angle, form="carrier", half_angle=0.25, step=step, threads=1), base
        )
        for step in (0.0125, 0.00625)
    ]
    # the splitting is right to dz^2 at fc already: what is left falls as dz^2
    assert errors[0] < 0.01 and errors[1] < 0.3 * errors[0]
