"""What the C library is handed: directions of any length, images that overlap, numbers at the ends of their types."""

import ctypes

import numpy as np
import pytest
from scenes import PLANE, X, Y, straight
from test_c_abi import i64, image, library, pointer, pytestmark, structs  # noqa: F401

import pysas

ECHOES = straight(16)
GRID = pysas.Grid.plane(X[::3], Y[::2])


def with_beam(boresight, half_angle=0.03):
    vectors = np.ascontiguousarray(np.broadcast_to(boresight, (16, 3)), dtype=float)

    def change(survey, lines, options):
        survey.boresight, survey.beam_half_angle = vectors.ctypes.data, half_angle

    return change


@pytest.mark.parametrize("length", [1e-300, 1e-12, 0.5, 2.0, 1e10])
def test_a_boresight_of_any_length_is_a_direction(library, length):  # noqa: F811
    direction = np.array([0.02, 0.96, -0.26])
    unit = direction / np.linalg.norm(direction)
    beam = pysas.Beam(unit, 0.1, 0.03, "cone")
    pixels = np.arange(0, GRID.size, 7)
    exact, level = pysas.reference.exact(ECHOES.replace(beam=beam), GRID, pixels)
    assert 0 < np.count_nonzero(level) < level.size
    found = image(library, ECHOES, GRID, 1e-3, change=with_beam(length * unit))
    assert pysas.metrics.relative_error(found.ravel()[pixels], exact, level) <= 1e-3


@pytest.mark.parametrize(
    ("boresight", "half_angle"),
    [([0, 0, 0], 0.5), ([np.nan, 1, 0], 0.5), ([np.inf, 0, 0], 0.5), ([0, 1, 0], 0.0), ([0, 1, 0], 3.2), ([0, 1, 0], np.nan)],
)
def test_no_direction_or_no_angle_is_an_argument_error(library, boresight, half_angle):  # noqa: F811
    assert image(library, ECHOES, GRID, 1e-3, change=with_beam(boresight, half_angle)) == 1


def execute(library, data, out, stride, dtype=np.complex128):  # noqa: F811
    """The code of an image of ECHOES' geometry, from `data` into `out` at strides of elements."""
    keep = []
    grid = pysas.Grid.plane(X[:30], Y[:16])
    parts = structs(ECHOES.replace(data=ECHOES.data.astype(dtype)), grid, 1e-3, keep)
    plan = pointer()
    assert library.pysas_plan_create(*map(ctypes.byref, parts), ctypes.byref(plan)) == 0
    step = None if stride is None else ctypes.cast((i64 * 2)(*stride), pointer)
    code = library.pysas_plan_execute(plan, data, None, out, step)
    library.pysas_plan_destroy(plan)
    return code


def test_an_image_that_overlaps_is_refused_and_nothing_is_written(library):  # noqa: F811
    data = np.ascontiguousarray(ECHOES.data)
    before, at = data.copy(), data.ctypes.data
    assert execute(library, at, at, None) == 1
    assert execute(library, at, at + 16 * 500, None) == 1
    assert execute(library, at, at + 16 * (data.size - 1), None) == 1
    assert execute(library, at, at + 16 * 479, (-30, -1)) == 1
    assert np.array_equal(data, before)
    out = np.full(600, 7, complex)
    for stride in ((0, 1), (30, 0), (29, 1), (-1, 15), (1, 1)):
        assert execute(library, at, out.ctypes.data + 16 * 100, stride) == 1
    assert np.all(out == 7)
    images = [np.empty((16, 30), complex), np.empty((30, 16), complex), np.empty((16, 30), complex)]
    assert execute(library, at, images[0].ctypes.data, None) == 0
    assert execute(library, at, images[1].ctypes.data, (1, 16)) == 0
    assert execute(library, at, images[2][-1, -1:].ctypes.data, (-30, -1)) == 0
    assert np.array_equal(images[0], images[1].T) and np.array_equal(images[0], images[2][::-1, ::-1])


def scaled(library, data, weight=1.0, method=0, tol=1e-4, grid=GRID):  # noqa: F811
    weights = np.full(16, weight)

    def change(survey, lines, options):
        survey.weights, options.method = weights.ctypes.data, method

    return image(library, ECHOES.replace(data=data), grid, tol, change=change)


@pytest.mark.parametrize("method", [0, 1])
@pytest.mark.parametrize(
    ("dtype", "scale", "weight"),
    [
        (np.complex64, -100, 0), (np.complex64, 100, 0), (np.complex64, -120, 0), (np.complex128, -1000, 0),
        (np.complex128, 1000, 0), (np.complex128, -1030, 0), (np.complex128, -1000, 40), (np.complex128, 1000, -40),
    ],
)  # fmt: skip
def test_data_of_any_scale_make_the_same_image(library, dtype, scale, weight, method):  # noqa: F811
    """Samples times 2^scale, weights 2^weight."""
    grid = PLANE if method else GRID
    data = ECHOES.data.astype(dtype)
    expected = scaled(library, data, method=method, grid=grid)
    data = np.ldexp(data.view(data.real.dtype), scale).view(dtype)
    found = scaled(library, data, 2.0**weight, method, grid=grid)
    found = np.ldexp(found.view(found.real.dtype).astype(float), -scale - weight).view(complex)
    assert np.linalg.norm(found - expected) <= 1e-6 * np.linalg.norm(expected)


def test_images_beyond_their_type_are_a_code(library):  # noqa: F811
    single = ECHOES.data.astype(np.complex64)
    for data, weight in ((single, 1e14), (single, 1e-14), (ECHOES.data * 1e300, 1e14), (ECHOES.data * 1e-310, 1e-14)):
        factor = np.float32(1e30 if weight > 1 else 1e-30) if data.dtype == np.complex64 else 1.0
        assert scaled(library, data * factor, weight, tol=1e-2) == 8
    assert b"range" in library.pysas_strerror(8)


def test_traces_that_do_not_count_do_not_scale(library):  # noqa: F811
    weights, t0 = np.ones(16), ECHOES.start_time.copy()
    weights[3], t0[5] = 0, 5.0
    quiet = ECHOES.data * 1e-100
    quiet[[3, 5]] = 0
    loud = quiet.copy()
    loud[3] = loud[5] = 1e250

    def change(survey, lines, options):
        survey.weights = weights.ctypes.data

    found = [image(library, ECHOES.replace(data=data, t0=t0), GRID, 1e-4, change=change) for data in (quiet, loud)]
    assert np.any(found[0] != 0) and np.array_equal(*found)


@pytest.mark.parametrize("away", [1e12, 1e14])
def test_what_double_cannot_place_is_out_of_reach(library, away):  # noqa: F811
    grid = pysas.Grid.plane([0.0, 1.0], [20.0, away])
    assert image(library, ECHOES.replace(fc=1e-3), grid, 1e-2) == 2
