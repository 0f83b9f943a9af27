"""Stiff and extreme cases that no other test asserts; `docs/stability.md` names the test of each row."""

import re
from pathlib import Path

import numpy as np
import pytest
from scenes import survey

import pysas

C, FC = 1500.0, 1e6
TRACK = pysas.tracks.straight(64, 0.03, height=5.0, start=(-1.0, 0.0, 0.0)).position
PLANE = pysas.Grid.plane(np.arange(64) * 0.02, 20 + np.arange(48) * 0.02)


def error(echoes, grid, tol, method="backprojection"):
    pixels = np.random.default_rng(1).choice(grid.size, 150, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    image = pysas.plan(echoes, grid, tol, method)(echoes.data)
    return pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level)


def far(ratio, dtype):
    """A track and an image so many wavelengths of 1.5 mm apart."""
    distance = ratio * C / FC
    tx = np.stack([(np.arange(64) - 32) * 0.3, np.zeros(64), np.full(64, 50.0)], axis=1)
    echoes = survey(tx, tx[:, None].copy(), distance - 5, fc=FC)
    grid = pysas.Grid.plane((np.arange(96) - 48) * 0.02, distance + np.arange(64) * 0.02)
    return echoes.replace(data=echoes.data.astype(dtype)), grid


@pytest.mark.parametrize("ratio", [7e6, 9e8])
def test_range_over_wavelength(ratio):
    echoes, grid = far(ratio, np.complex64)
    for tol in (1e-3, 1e-5):
        assert error(echoes, grid, tol) <= tol
    assert error(echoes, grid, 1e-3, "ffbp") <= 1e-3
    least = 1.001e-14 * ratio
    assert error(*far(ratio, complex), least) <= least


@pytest.mark.parametrize("dtype", [np.complex64, complex])
def test_beyond_1e9_wavelengths_tol_is_refused_and_trees_are_not_grown(dtype):
    """float64 ranges lose 1e-14 range/wavelength of phase, whatever the samples are."""
    echoes, grid = far(1e10, dtype)
    with pytest.raises(ValueError, match=r"tol=1e-05: complex\d+ data over 1.5e\+07 m reach 0.0001 at best$"):
        pysas.backproject(echoes, grid, 1e-5)
    assert error(echoes, grid, 1.01e-4) <= 1.01e-4
    with pytest.raises(ValueError, match=r"range beyond 1e\+09 wavelengths"):
        pysas.ffbp(echoes, grid, 1e-3, fallback=False)


@pytest.mark.parametrize("step", [1e-9, 1e-6, 10.0])
def test_pixels_far_finer_and_far_coarser_than_the_resolution(step):
    echoes = survey(TRACK, TRACK[:, None].copy(), 18.0)
    grid = pysas.Grid.plane(np.arange(-20, 21) * step, 20 + np.arange(20) * min(step, 0.5))
    for method in ("backprojection", "ffbp"):
        for tol in (1e-3, 1e-5, 1e-9):
            assert error(echoes, grid, tol, method) <= tol


@pytest.mark.parametrize("baseline", [40.0, 4e4])
def test_baselines_longer_than_the_range(baseline):
    rx = TRACK[:, None] + np.array([baseline, 3.0, 1.0])
    near = (15 + np.hypot(baseline, 20) - 3) / 2
    echoes = survey(TRACK, rx, near)
    tol = max(1e-9, 1.1e-14 * baseline * 1e5 / C)
    for one in (1e-3, tol):
        assert error(echoes, PLANE, one) <= one


@pytest.mark.parametrize("fc", [18e3, 600.0])
def test_quality_below_2(fc):
    """Q 0.6 and 0.02: a band of 30 kHz about a carrier below it."""
    echoes = survey(TRACK, TRACK[:, None].copy(), 18.0, fc=fc)
    for tol in (1e-3, 1e-9):
        assert error(echoes, PLANE, tol) <= tol
    with pytest.raises(ValueError, match="no frequency below zero"):
        pysas.reference.omega_k(echoes, threads=1)


def test_the_table_names_tests_that_exist():
    """Every row has its tests."""
    root = Path(__file__).resolve().parents[1]
    rows = (root / "docs" / "stability.md").read_text(encoding="utf-8").splitlines()[7:]
    tests = "".join(path.read_text(encoding="utf-8") for path in (root / "tests").glob("test_*.py"))
    assert len(rows) == 12
    for row in rows:
        named = re.findall(r"\btest_\w+", row)
        assert named and all(f"def {name}(" in tests for name in named)
