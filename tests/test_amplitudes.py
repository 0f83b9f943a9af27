"""The scale of the numbers: an image follows its data's and weights' over the whole range of their types, or says why not."""

import warnings

import numpy as np
import pytest
from scenes import PLANE, X, Y, straight

import pysas
from pysas.imaging import amplitudes

ECHOES = straight(16)
GRID = pysas.Grid.plane(X[::3], Y[::2])
BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
METHODS = ["backprojection", "ffbp"]
TINY, HUGE = 2.0**-1000, 2.0**1000


def image(data, backend, method="backprojection", tol=1e-4, weights=None, grid=GRID, **changes):
    echoes = ECHOES.replace(data=data, **changes)
    return pysas.plan(echoes, grid, tol, method, backend=backend, weights=weights)(data)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("dtype", "scale"),
    [
        *((np.complex64, s) for s in (1e-30, 2.0**-120, 1e30, 2.0**118)),
        *((np.complex128, s) for s in (1e-300, 1e-45, 2.0**-1020, 1e30, 1e300, 2.0**1010)),
    ],
)
def test_data_of_any_scale_make_the_same_image(dtype, scale, method, backend):
    grid = PLANE if method == "ffbp" else GRID
    data = ECHOES.data.astype(dtype)
    expected = image(data, backend, method, grid=grid).data.astype(complex)
    found = image(data * data.real.dtype.type(scale), backend, method, grid=grid).data.astype(complex) / scale
    assert np.linalg.norm(found - expected) <= 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("power", [-1060, -500, 500, 1010])
def test_the_oracle_follows_its_data(power):
    """Their squares, of which its level is made, are no numbers."""
    pixels = np.arange(0, GRID.size, 50)
    data = np.ldexp(ECHOES.data.view(float), power).view(complex)
    expected = pysas.reference.exact(ECHOES, GRID, pixels)
    for found, wanted in zip(pysas.reference.exact(ECHOES.replace(data=data), GRID, pixels), expected, strict=True):
        found = np.ldexp(found.view(float), -power).view(found.dtype)
        assert np.linalg.norm(found - wanted) <= 2.0 ** (-45 if power > -1000 else -8) * np.linalg.norm(wanted)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("tol", [1e-3, 1e-7])
def test_subnormal_samples_count_as_what_they_are(tol, backend):
    """Their own rounding aside: the oracle is given the same samples, scaled up exactly."""
    data = ECHOES.data * 1e-310
    exact, level = pysas.reference.exact(ECHOES.replace(data=data * 2.0**1000 * 2.0**28), GRID)
    found = image(data, backend, tol=tol).data * 2.0**1000 * 2.0**28
    assert pysas.metrics.relative_error(found, exact, level) <= tol


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("data", "weight"), [(1.0, 1e-200), (1.0, 1e200), (1e-200, 1e300), (1e300, 1e-300), (TINY, HUGE), (2.0**-1030, 1e300)]
)
def test_weights_of_any_scale_make_the_same_image(data, weight, backend):
    samples = ECHOES.data * data
    expected = image(ECHOES.data, backend).data
    found = image(samples, backend, weights=np.full(16, weight)).data
    with np.errstate(under="ignore"):
        factor = data * weight if 1e-300 < data * weight < 1e300 else weight
    assert np.linalg.norm(found / factor - expected) <= 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("span", [100, 1e120, 1e280])
def test_weights_that_undo_their_traces_levels(span, backend):
    """Each term is as before; squares of weights or samples alone may be no numbers, which is no warning."""
    factor = np.ones(16)
    factor[::3], factor[1::3] = span, 1 / span
    expected = image(ECHOES.data, backend)
    found = image(ECHOES.data / factor[:, None, None], backend, weights=factor)
    assert np.linalg.norm(found.data - expected.data) <= 1e-6 * np.linalg.norm(expected.data)
    assert not found.report.notes


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_traces_that_do_not_count_do_not_scale(dtype, method, backend):
    """One of weight 0, one heard by no pixel, one of zeros and a heavy weight, samples that no pixel asks for."""
    high = 1e30 if dtype == np.complex64 else 1e250
    data = ECHOES.data.astype(dtype) * (1e-15 if dtype == np.complex64 else 1e-100)
    weights, t0 = np.ones(16), ECHOES.start_time.copy()
    weights[3], t0[5], weights[7] = 0, 5.0, 1e60
    quiet = data.copy()
    quiet[[3, 5, 7]] = 0
    loud = quiet.copy()
    loud[3] = loud[5] = high
    grid = PLANE if method == "ffbp" else GRID
    expected = image(quiet, backend, method, weights=weights, t0=t0, grid=grid)
    found = image(loud, backend, method, weights=weights, t0=t0, grid=grid)
    assert np.any(expected.data != 0)
    assert np.array_equal(found.data, expected.data)


@pytest.mark.parametrize("backend", BACKENDS)
def test_samples_that_no_pixel_asks_for_do_not_scale(backend):
    """The record's ends ring through W at the pixels, 1e36 times as bright as what is there: the exact image is that."""
    record = 5000
    data = np.zeros((16, 1, record), np.complex64)
    data[:, :, 2000:2900] = 1e-15 * ECHOES.data
    t0 = float(ECHOES.start_time[0]) - 2000 / ECHOES.fs
    quiet = image(data, backend, tol=1e-3, t0=t0)
    exact, level = pysas.reference.exact(ECHOES.replace(data=data, t0=t0), GRID)
    assert np.any(quiet.data != 0) and pysas.metrics.relative_error(quiet.data, exact, level) <= 1e-3
    data[:, :, :20] = data[:, :, -20:] = 1e30
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "tol=0.001 is not promised")
        found = image(data, backend, tol=1e-3, t0=t0)
    exact, level = pysas.reference.exact(ECHOES.replace(data=data, t0=t0), GRID)
    assert pysas.metrics.relative_error(found.data, exact, level) <= 1e-3
    assert found.report.predicted_error < 2e-3  # a bound of what comes round of ends that partly cancel
    assert np.linalg.norm(exact) > 1e30 * np.linalg.norm(quiet.data)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("data", "weight"), [(1e300, 1e10), (1e200, 1e200), (1e308, 1.0)])
def test_an_image_beyond_its_type_is_refused(data, weight, backend):
    samples = np.full(ECHOES.data.shape, data, complex)
    with pytest.raises(ValueError, match=r"(reach|reaches) 2\^"):
        image(samples, backend, weights=np.full(16, weight))


@pytest.mark.parametrize("backend", BACKENDS)
def test_complex64_ends_before_its_weights_do(backend):
    out = np.ones(GRID.shape, np.complex64)
    plan = pysas.plan(ECHOES.replace(data=ECHOES.data.astype(np.complex64)), GRID, weights=np.full(16, 1e200), backend=backend)
    with pytest.raises(
        ValueError, match=r"data: the image reaches 2\^6\d\d\.\d: expected less than 2\^128, the end of complex64"
    ):
        plan(ECHOES.data.astype(np.complex64), out)
    assert not out.any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("scale", "tol"), [(1e-44, 1e-2), (1e-41, 1e-4), (1e-200, 1e-1)])
def test_an_image_too_small_for_its_type_is_told(scale, tol, backend):
    data = ECHOES.data.astype(np.complex64)
    with pytest.warns(UserWarning, match="so small that complex64 holds it within .* of itself only: scale the data") as caught:
        found = image(data, backend, tol=tol, weights=np.full(16, scale))
    assert len(caught) == 1 and str(caught[0].message) in found.report.notes
    expected = image(data, backend, tol=tol).data
    # nothing but the rounding to multiples of 2^-149, of both parts
    off = found.data.astype(complex) - scale * expected.astype(complex)
    assert max(np.abs(off.real).max(), np.abs(off.imag).max()) <= 2.0**-149 * 0.55


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_image_lost_beside_a_trace_that_lights_no_pixel_is_told(backend):
    """Its window reaches the pixels, its beam does not: float32 scales by it all the same."""
    boresight = np.tile([0.0, 1, 0], (16, 1))
    boresight[2] = [0, -1, 0]
    data = ECHOES.data.copy()
    data[2] = 1e60
    with pytest.warns(UserWarning, match="lost beside ping 2, channel 0: leave it out by weight 0"):
        image(data, backend, tol=1e-3, beam=pysas.Beam(boresight, 0.1, 0.5))
    weights = np.ones(16)
    weights[2] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert image(data, backend, tol=1e-3, weights=weights).data.any()


def test_exponents_bound_the_terms():
    rng = np.random.default_rng(0)
    peaks = np.ldexp(rng.random(400), rng.integers(-1074, 1024, 400))
    weights = np.ldexp(rng.random(400), rng.integers(-1074, 1024, 400)) * np.exp(2j * rng.random(400))
    peaks[::7] = 0
    found = amplitudes.largest(weights, peaks)
    for exponent, weight, peak in zip(found, weights, peaks, strict=True):
        if peak == 0 or weight == 0:
            assert exponent == np.iinfo(np.int64).min
            continue
        size = np.log2(peak) + np.log2(max(abs(weight.real), abs(weight.imag)))
        assert exponent - 2 <= size + 1e-6 and size <= exponent + 1e-6
    assert amplitudes.scale_of(np.array([], dtype=int)) == 1.0
    assert amplitudes.scale_of(np.array([-2000])) == 2.0**-1074 and amplitudes.scale_of(np.array([1024])) == 2.0**1023
