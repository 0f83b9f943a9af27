"""Families of scenes that could break a bound and do not: all terms alike, all energy in one ping."""

import numpy as np
import pytest

import pysas

BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_a_point_at_a_circles_centre_keeps_tol(dtype, backend):
    """All terms alike: what rounding does to running sums does not average out."""
    pings, fs, fc = 1000, 40e3, 1e5
    angle = 2 * np.pi * np.arange(pings) / pings
    tx = 30 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    t = 0.039 + np.arange(300) / fs
    tau = 2 * np.linalg.norm([0.01, 0.003, 0] - tx, axis=1)[:, None] / 1500
    data = (np.exp(-(((t - tau) * fs / 3) ** 2)) * np.exp(-2j * np.pi * fc * tau)).astype(dtype)
    echoes = pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=tx, t0=0.039, bandwidth=24e3)
    near = (np.arange(3) - 1) * 0.0005
    grid = pysas.Grid.plane(0.01 + near, 0.003 + near)
    exact, level = pysas.reference.exact(echoes, grid)
    found = pysas.backproject(echoes, grid, 1e-5, backend=backend)
    assert pysas.metrics.relative_error(found.data, exact, level) <= 1e-5


@pytest.mark.cpp
@pytest.mark.parametrize("tol", [1e-1, 1e-3])
def test_trees_keep_tol_where_one_ping_holds_all_energy(tol):
    """Bounds of trees are means over pings and frequencies: all energy where one of them is worst, at the band's edge."""
    pings, fs, fc, bandwidth = 512, 40e3, 1e5, 24e3
    tx = np.zeros((pings, 3))
    tx[:, 0] = (np.arange(pings) - pings / 2) * 0.02
    tone = np.exp(2j * np.pi * 0.4995 * bandwidth / fs * np.arange(2000)).astype(np.complex64)
    grid = pysas.Grid.plane((np.arange(256) - 128) * 0.02, 40 + np.arange(256) * 0.02)
    silent = np.zeros((pings, 2000), np.complex64)
    echoes = pysas.Echoes(silent, fs=fs, fc=fc, tx=tx, rx=tx, t0=2 * 36 / 1500, bandwidth=bandwidth)
    trees = pysas.plan(echoes, grid, tol, "ffbp", backend="cpp", fallback=False)
    direct = pysas.plan(echoes, grid, 1e-5, "backprojection")
    shares = []
    for ping in (0, 1, 255, 511):
        data = silent.copy()
        data[ping] = tone
        image, expected = trees(data), direct(data).data  # R of one ping is |I|
        assert np.linalg.norm(image.data - expected) <= (tol + 1e-5) * np.linalg.norm(expected)
        shares.append(image.report.factorised_share)
    assert min(shares) == 1
