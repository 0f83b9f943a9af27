"""Rounding that adds up: sums of very many terms, and coordinates of large maps."""

import numpy as np
import pytest
from scenes import C, noise
from test_edges import ENGINES, MAP, error

import pysas
from pysas.planning import bounds


def platform(pings, seed, tol, backend, kind=np.complex64, grid=None, method="backprojection"):
    """Error and prediction of a platform that stands still and hears the same of every ping: equal terms."""
    rng = np.random.default_rng(seed)
    n = np.arange(64)
    trace = (np.exp(-(((n - 31.3) / 4) ** 2)) * np.exp(2j * np.pi * rng.random())).astype(kind)
    more = {"fs": 40e3, "fc": 1e5, "c": C, "t0": 0.04, "bandwidth": 20e3}
    one = pysas.Echoes(trace[None], tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), **more)
    grid = pysas.Grid.points([[0, 30 + (29 + k + rng.random()) * C / 40e3 / 2, 0] for k in range(5)]) if grid is None else grid
    exact, level = pysas.reference.exact(one, grid)
    tx = np.zeros((pings, 3))
    echoes = pysas.Echoes(np.repeat(trace[None], pings, axis=0), tx=tx, rx=tx, **more)
    plan = pysas.plan(echoes, grid, tol, method=method, backend=backend)
    image = plan(echoes.data)
    return np.linalg.norm(image.data - pings * exact) / (pings * np.linalg.norm(exact)), plan


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("kind", [np.complex64, np.complex128])
@pytest.mark.parametrize("pings", [3000, 12000])
def test_sums_of_equal_terms_keep_tol(backend, kind, pings):
    for seed in range(2):
        found, plan = platform(pings, seed, 1e-5, backend, kind)
        assert found <= plan.choices.predicted_error <= 1e-5
        assert "running sums" in plan.choices.errors


@pytest.mark.parametrize("backend", ENGINES)
def test_sums_along_lines_keep_tol(backend):
    """Lines take delay polynomials, points do not."""
    grid = pysas.Grid.plane(np.arange(-8, 8) * 0.001, 30 + (31 + np.arange(3)) * C / 40e3 / 2)
    found, plan = platform(6000, 0, 1e-5, backend, grid=grid)
    assert plan.choices.block > 0
    assert found <= 1e-5


def test_sums_of_many_batches_keep_tol(monkeypatch):
    """Of C++: tests/test_c_abi.py, with 60,000 pings."""
    monkeypatch.setattr("pysas.planning.fallback.settings.BATCH_BYTES", 1)  # 8 traces
    found, plan = platform(6000, 1, 1e-5, "numba")
    assert plan.choices.batch == 8
    assert plan.by.wide
    assert found <= 1e-5


@pytest.mark.cpp
def test_leaves_of_very_many_traces_keep_tol():
    """48 places, 400 pings at each: a tree's leaves are sums of thousands."""
    samples, fs, fc, times = 700, 40e3, 1e5, 400
    tx = np.stack([np.arange(48) * 0.02, np.zeros(48), np.zeros(48)], axis=1)
    target = np.array([0.3, 63.0, 0.0])
    tau = 2 * np.linalg.norm(target - tx, axis=1)[:, None] / C
    t = 0.076 + np.arange(samples) / fs
    data = (np.exp(-(((t - tau) * fs / 3) ** 2)) * np.exp(-2j * np.pi * fc * tau + 1j)).astype(np.complex64)

    def echoes(repeats):
        place = np.repeat(tx, repeats, axis=0)
        return pysas.Echoes(np.repeat(data, repeats, axis=0), fs=fs, fc=fc, tx=place, rx=place, c=C, t0=0.076, bandwidth=24e3)

    grid = pysas.Grid.plane(np.arange(64) * 0.01, 62.5 + np.arange(64) * 0.01)
    exact, _ = pysas.reference.exact(echoes(1), grid)
    image = pysas.ffbp(echoes(times), grid, 3e-5, backend="cpp")
    assert image.report.factorised_share > 0.5
    assert np.linalg.norm(image.data - times * exact) <= 3e-5 * times * np.linalg.norm(exact)


@pytest.mark.cpp
def test_double_precision_has_no_runs():
    found, plan = platform(300, 0, 1e-9, "cpp", np.complex128)
    assert plan.choices.run == 0
    assert found <= 1e-9


@pytest.mark.parametrize("sums", [1, 3])
def test_running_sums_round_no_more_than_charged(sums):
    """C++: one sum a part, real parts' products and imaginary parts' added in turn, with one rounding each (multiply-add)."""
    rng = np.random.default_rng(3)
    for count in (32, 256):
        sample, factor = (np.exp(2j * np.pi * rng.random(500)).astype(np.complex64).astype(complex) for _ in range(2))
        re, im = np.zeros(500, np.float32), np.zeros(500, np.float32)
        for _ in range(count):
            re = (re + sample.real * factor.real).astype(np.float32)
            re = (re - sample.imag * factor.imag).astype(np.float32)
            im = (im + sample.real * factor.imag).astype(np.float32)
            im = (im + sample.imag * factor.real).astype(np.float32)
        wrong = np.abs(re + 1j * im - count * sample * factor) / count
        assert wrong.max() <= bounds.running_error(count, sums)
        assert np.sqrt(np.mean(wrong**2)) >= 0.25 * bounds.running_error(count, 1)  # it does round


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("kind", ["polar", "plane", "turned"])
@pytest.mark.parametrize(
    "fc, tol, corner",
    [(1e5, 1e-8, MAP), (5e5, 1e-6, MAP), (1e5, 1e-5, [0, 1e9, 0]), (1e5, 1e-3, [0, 1e11, 0])],
)
def test_large_coordinates(backend, kind, fc, tol, corner):
    """Pixels lie where `Grid.coordinates` says, each rounded by itself: no even lines where that matters to `tol`."""
    corner = np.asarray(corner, dtype=float)
    dtype = np.complex64 if tol >= 1e-5 else np.complex128
    tx = np.stack([(np.arange(8) - 4) * 0.02, np.zeros(8), np.zeros(8)], axis=1) + corner
    data = noise(8, 1, 300, 0.6).astype(dtype)
    echoes = pysas.Echoes(data, fs=40e3, fc=fc, tx=tx, rx=tx[:, None], c=C, t0=2 * 28 / C, bandwidth=24e3)
    along, down = np.arange(64) * 0.01, np.arange(4) * 0.01
    if kind == "polar":
        grid = pysas.Grid.polar(29 + along, np.pi / 2 + down, corner)
    elif kind == "plane":
        grid = pysas.Grid.plane(corner[0] + along, corner[1] + 29 + down, corner[2])
    else:
        x, y = np.meshgrid(along, down)
        grid = pysas.Grid.points(np.stack([0.8 * x - 0.6 * y, 29 + 0.6 * x + 0.8 * y, 0 * x], axis=-1) + corner)
    assert error(pysas.backproject(echoes, grid, tol, backend=backend).data, echoes, grid) < tol
