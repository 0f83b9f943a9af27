"""The promise of tol: ||I - I_exact|| <= tol max(||I_exact||, ||R||) on sampled pixels, over scenes, dtypes and tolerances."""

import numpy as np
import pytest
from scenes import SCENES

import pysas

SINGLE = 10.0 ** -np.arange(1, 5.01, 1 / 3)
DOUBLE = 10.0 ** -np.arange(1, 10.01, 1 / 3)


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    """A scene with the oracle's answer on 250 pixels."""
    make, grid = SCENES[request.param]
    echoes = make()
    pixels = np.random.default_rng(1).choice(grid.size, 250, replace=False)
    return request.param, echoes, grid, pixels, pysas.reference.exact(echoes, grid, pixels)


def errors(scene, dtype, tolerances):
    _, echoes, grid, pixels, (exact, level) = scene
    # the oracle saw complex128; rounding the samples to complex64 moves it by 3e-8
    echoes = echoes.replace(data=echoes.data.astype(dtype))
    found = []
    for tol in tolerances:
        image = pysas.backproject(echoes, grid, float(tol))
        assert image.data.dtype == dtype and image.report.predicted_error <= tol
        found.append(pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level))
    return np.array(found)


def test_complex64_keeps_tol(scene):
    found = errors(scene, np.complex64, SINGLE)
    assert np.all(found <= SINGLE), dict(zip(SINGLE, found, strict=True))
    assert np.median(found / SINGLE) > 0.02  # and no more is bought than was asked


def test_complex128_keeps_tol(scene):
    reachable = DOUBLE[DOUBLE >= (1e-14 * 1000 * 300e3 / 1500 if scene[0] == "far" else 1e-10) * (1 - 1e-9)]
    found = errors(scene, np.complex128, reachable)
    assert np.all(found <= reachable), dict(zip(reachable, found, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize("name", SCENES)
def test_eight_tolerances_per_decade(name, dtype):
    make, grid = SCENES[name]
    echoes = make(pings=1024) if name != "full band" else make()
    pixels = np.random.default_rng(2).choice(grid.size, 250, replace=False)
    exact = pysas.reference.exact(echoes, grid, pixels)
    low = 5 if dtype == np.complex64 else 8 if name == "far" else 10
    tolerances = 10.0 ** -np.arange(1, low + 0.01, 1 / 8)
    assert np.all(errors((name, echoes, grid, pixels, exact), dtype, tolerances) <= tolerances)


def test_options_keep_tol():
    """Weights, beam and mask together, against the oracle that has its own."""
    make, grid = SCENES["moving"]
    beam = pysas.Beam([0.0, 1.0, -0.25], 0.05, np.radians(14.0))
    echoes = make().replace(beam=beam)
    rng = np.random.default_rng(4)
    weights = rng.standard_normal((16, 6)) + 1j * rng.standard_normal((16, 6))
    weights[3] = 0
    mask = rng.random(grid.shape) < 0.3
    grid = pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask)
    pixels = np.arange(0, grid.size, 7)
    exact, level = pysas.reference.exact(echoes, grid, pixels, weights)
    assert 0.05 < np.count_nonzero(level) / pixels.size < 0.5
    for tol in (1e-2, 1e-4, 1e-8):
        image = pysas.backproject(echoes, grid, tol, weights=weights)
        assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= tol
        assert not image.data[~mask].any()
