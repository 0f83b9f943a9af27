"""The drop-in call on plain arrays: whatever shows an array is read, `out` is filled in place, regular pixels are fast."""

import numpy as np
import pytest
from scenes import PLANE, SCENES, moving, straight

import pysas
from pysas.planning.scene import lines


class Interface:
    """No array, but it shows one."""

    def __init__(self, array):
        self.__array_interface__ = array.__array_interface__
        self.keep = array


class Packed:
    """The same by DLPack."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def arguments(echoes):
    rates = {name: getattr(echoes, name) for name in ("fs", "fc", "c", "bandwidth", "tx", "rx", "velocity")}
    return rates | {"t0": echoes.start_time}


PIXELS = PLANE.coordinates().reshape(*PLANE.shape, 3)


@pytest.mark.parametrize("show", [np.asarray, Interface, Packed, memoryview])
def test_anything_that_shows_an_array_is_read(show):
    echoes = moving()
    expected = pysas.backproject_arrays(echoes.data, PIXELS, **arguments(echoes))
    found = pysas.backproject_arrays(show(echoes.data), PIXELS, **arguments(echoes))
    assert np.array_equal(found, expected)
    exact, level = pysas.reference.exact(echoes, PLANE, np.arange(0, PLANE.size, 9))
    assert pysas.metrics.relative_error(found.ravel()[::9], exact, level) <= 1e-3


def test_memory_elsewhere_is_a_type_error():
    class Elsewhere:
        def __dlpack__(self, **_):
            raise BufferError("on a device")

        def __dlpack_device__(self):
            return (2, 0)

    with pytest.raises(TypeError, match="data: expected an array in this machine's memory"):
        pysas.backproject_arrays(Elsewhere(), PIXELS, **arguments(straight(2)))


@pytest.mark.parametrize("layout", ["C", "F", "strided"])
def test_out_is_filled_in_place(layout):
    echoes = straight(16)
    store = np.full((2 * PLANE.shape[0], PLANE.shape[1]), 7, complex)
    out = {"C": store[: PLANE.shape[0]], "F": np.asfortranarray(store[: PLANE.shape[0]]), "strided": store[::2]}[layout]
    found = pysas.backproject_arrays(echoes.data, PIXELS, **arguments(echoes), out=out)
    assert found is out or np.shares_memory(found, out)
    assert np.array_equal(out, pysas.backproject(echoes, PLANE).data)
    if layout == "strided":
        assert np.all(store[1::2] == 7)


def test_regular_pixels_are_lines_and_others_are_not():
    found = lines(pysas.Grid.points(PIXELS))
    expected = lines(PLANE)
    assert found is not None and expected is not None
    assert np.allclose(found[0], expected[0], atol=1e-12) and np.allclose(found[1], expected[1], atol=1e-12)
    bent = PIXELS.copy()
    bent[3, 7, 2] += 1e-6
    assert lines(pysas.Grid.points(bent)) is None
    assert lines(pysas.Grid.points(PIXELS.reshape(-1, 3))) is None


@pytest.mark.parametrize("name", ["surface", "polar"])
def test_pixels_of_any_shape(name):
    make, grid = SCENES[name]
    echoes = make()
    found = pysas.backproject_arrays(echoes.data, grid.coordinates().reshape(*grid.shape, 3), **arguments(echoes), tol=1e-4)
    exact, level = pysas.reference.exact(echoes, grid, np.arange(0, grid.size, 9))
    assert pysas.metrics.relative_error(found.ravel()[::9], exact, level) <= 1e-4
