"""Back-projection: invariances, geometry at its limits, inputs of every layout, and one clear error for each bad one."""

import sys
import threading
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import PLANE, C, moving, noise, straight

import pysas

SMALL = pysas.Grid.plane(np.arange(-20, 21) * 0.02, 19.0 + np.arange(20) * 0.02)


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.complex_numbers(max_magnitude=10, min_magnitude=0.1), st.integers(0, 5))
def test_linear(factor, seed):
    a, b = straight(16), straight(16, seed=seed + 1)
    both = pysas.backproject(a.replace(data=a.data + factor * b.data), SMALL, 1e-8).data
    parts = pysas.backproject(a, SMALL, 1e-8).data + factor * pysas.backproject(b, SMALL, 1e-8).data
    assert relative(both, parts) < 1e-12


@settings(max_examples=8, deadline=None, derandomize=True)
@given(*(st.integers(-(2**22), 2**22) for _ in range(3)))
def test_shift_of_everything_changes_nothing(i, j, k):
    # multiples of 1/4 m up to 1e6 m are exact in float64 beside coordinates that are multiples of 2^-20 m
    offset = np.array([i, j, k]) / 4
    echoes = moving(6)
    tx, rx = np.round(echoes.tx * 2**20) / 2**20, np.round(echoes.rx * 2**20) / 2**20
    points = np.round(SMALL.coordinates()[::9] * 2**20) / 2**20
    images = [
        pysas.backproject(echoes.replace(tx=tx + o, rx=rx + o), pysas.Grid.points(points + o), 1e-3).data for o in (0, offset)
    ]
    assert np.array_equal(images[0], images[1])


def test_utm_offset_of_5e6_m_loses_nothing():
    echoes, offset = moving(), np.array([5e5, 5e6, 0.0])
    grid = pysas.Grid.plane(SMALL.axes["x"] + 5e5, SMALL.axes["y"] + 5e6)
    near = pysas.backproject(echoes, SMALL, 1e-5).data
    far = pysas.backproject(echoes.replace(tx=echoes.tx + offset, rx=echoes.rx + offset), grid, 1e-5).data
    # coordinates of 5e6 m round to 9e-10 m: 4e-7 rad at 100 kHz on each way
    assert relative(far, near) < 1e-5


def test_tiles_are_the_image():
    echoes = moving()
    whole = pysas.backproject(echoes, PLANE, 1e-4).data
    x, y = PLANE.axes["x"], PLANE.axes["y"]
    parts = np.block([[pysas.backproject(echoes, pysas.Grid.plane(x[a], y[b]), 1e-4).data for a in (slice(33), slice(33, None))]
                      for b in (slice(7), slice(7, None))])  # fmt: skip
    assert relative(parts, whole) < 1e-4


@pytest.mark.parametrize("tol", [1e-3, 1e-5, 1e-8])
def test_any_number_of_threads_gives_the_same_bits(tol):
    echoes = moving()
    images = [pysas.backproject(echoes, PLANE, tol, threads=n).data for n in (1, 2, 3, 7)]
    assert all(np.array_equal(images[0], image) for image in images[1:])


def test_every_grid_kind_agrees_with_the_plane():
    echoes = moving()
    plane = pysas.backproject(echoes, SMALL, 1e-8).data
    x, y = SMALL.axes["x"], SMALL.axes["y"]
    others = [
        pysas.Grid.surface(x, y, np.zeros(SMALL.shape)),
        pysas.Grid.volume(x, y, [0.0]),
        pysas.Grid.points(SMALL.coordinates().reshape(*SMALL.shape, 3)),
    ]
    for grid in others:
        assert relative(pysas.backproject(echoes, grid, 1e-8).data.reshape(plane.shape), plane) < 1e-11
        assert relative(pysas.backproject(echoes, grid, 1e-3).data.reshape(plane.shape), plane) < 1e-3


@pytest.mark.parametrize("pings", [1, 2, 13, 67])
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (70, 1), (3, 65)])
def test_odd_sizes(pings, shape):
    echoes = straight(pings)
    grid = pysas.Grid.plane(np.arange(shape[1]) * 0.01, 20 + np.arange(shape[0]) * 0.01)
    exact, level = pysas.reference.exact(echoes, grid)
    image = pysas.backproject(echoes, grid, 1e-4)
    assert pysas.metrics.relative_error(image.data, exact, level) <= 1e-4
    assert image.report.terms == pings * grid.size and image.report.share_left_out == 0


def test_pixels_on_the_track_on_the_transducer_and_behind():
    tx = pysas.tracks.straight(64, 0.05).position
    rx = tx[:, None].copy()
    echoes = pysas.Echoes(noise(64, 1, 400, 0.75), fs=40e3, fc=100e3, tx=tx, rx=rx, c=C, bandwidth=30e3)
    for grid in (
        pysas.Grid.plane(np.arange(64) * 0.05, [-0.5, 0.0, 0.5]),  # pixels on every transducer
        pysas.Grid.plane(np.arange(200) * 0.01, -4.0 + np.arange(3) * 0.01),
        pysas.Grid.plane(np.arange(100) * 0.05, [1e-3, 0.1]),
    ):
        exact, level = pysas.reference.exact(echoes, grid)
        for tol in (1e-3, 1e-5, 1e-9):
            assert pysas.metrics.relative_error(pysas.backproject(echoes, grid, tol).data, exact, level) <= tol


def test_gaps_repeats_reversals_and_wide_baselines():
    rng = np.random.default_rng(0)
    tx = np.concatenate([straight(20).tx, straight(20).tx[::-1], straight(20).tx + [7.0, 0.0, 0.0]])
    rx = tx[:, None] + np.array([[[0.0, 0.0, 0.0], [40.0, 3.0, 1.0]]]) + rng.uniform(-0.1, 0.1, (60, 2, 3))
    echoes = pysas.Echoes(noise(60, 2, 2500, 0.75), fs=40e3, fc=100e3, tx=tx, rx=rx, c=C, t0=0.01, bandwidth=30e3)
    exact, level = pysas.reference.exact(echoes, SMALL)
    for tol in (1e-3, 1e-5, 1e-9):
        assert pysas.metrics.relative_error(pysas.backproject(echoes, SMALL, tol).data, exact, level) <= tol


def test_moving_receivers_shift_the_image_as_physics_says():
    """A point imaged with the wrong stop-and-hop delay moves by about v R/c along-track, half of it for one way only."""
    tx = pysas.tracks.straight(120, 0.0125, start=(-0.75, 0.0, 0.0)).position
    velocity = np.tile([1.5, 0.0, 0.0], (120, 1))
    pulse = pysas.LFM(100e3, 30e3, 2e-3, "tukey", 0.1)
    raw = pysas.simulate([[0.0, 25.0, 0.0]], [1.0], pulse, tx=tx, rx=tx, velocity=velocity, fs=40e3, duration=0.04)
    echoes = pysas.compress(raw)
    grid = pysas.Grid.plane(np.arange(-50, 51) * 0.004, 25 + np.arange(-20, 21) * 0.005)
    true = pysas.metrics.peak_position(pysas.backproject(echoes, grid, 1e-4))
    wrong = pysas.metrics.peak_position(pysas.backproject(echoes.replace(velocity=None), grid, 1e-4))
    assert np.hypot(true[0], true[1] - 25) < 1e-4
    # the receiver has moved v (2R/c) = 50 mm at reception: the phase centre by half of that
    assert abs(abs(wrong[0]) - 1.5 * 25 / C) < 0.002


@pytest.mark.parametrize("scale", [1e-38, 1e-30, 1.0, 1e30])
def test_amplitude_does_not_matter(scale):
    echoes = straight(16)
    unit = pysas.backproject(echoes.replace(data=echoes.data.astype(np.complex64)), SMALL, 1e-3).data
    image = pysas.backproject(echoes.replace(data=(echoes.data * scale).astype(np.complex64)), SMALL, 1e-3).data
    # below 1e-37 the samples themselves are subnormal: they hold only 1e-38/1.4e-45 steps
    assert relative(image / np.float64(scale), unit) < (1e-6 if scale > 1e-37 else 2e-6)


def test_all_zero_data():
    with pytest.warns(UserWarning, match="every sample is 0"):
        image = pysas.backproject(straight(4).replace(data=np.zeros((4, 1, 900), np.complex64)), SMALL)
    assert not image.data.any()


def layouts(data):
    big = data.astype(data.dtype.newbyteorder(">"))
    wide = np.zeros((data.shape[0], data.shape[1] * 2, data.shape[2] * 3), data.dtype)
    wide[:, ::2, ::3] = data
    locked = data.copy()
    locked.flags.writeable = False
    return {"big-endian": big, "strided": wide[:, ::2, ::3], "read-only": locked, "Fortran": np.asfortranarray(data)}


@pytest.mark.parametrize("name", ["big-endian", "strided", "read-only", "Fortran"])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_any_layout_of_the_data(name, dtype):
    echoes = moving(5)
    data = echoes.data.astype(dtype)
    expected = pysas.backproject(echoes.replace(data=data), SMALL).data
    assert np.array_equal(pysas.backproject(echoes.replace(data=layouts(data)[name]), SMALL).data, expected)


def test_two_dimensional_data_is_one_channel():
    echoes = straight(8)
    flat = echoes.replace(data=echoes.data[:, 0], rx=echoes.rx[:, 0])
    assert np.array_equal(pysas.backproject(flat, SMALL).data, pysas.backproject(echoes, SMALL).data)


def test_start_times_per_ping():
    echoes = straight(8)
    shifts = np.arange(8) * 3
    data = np.stack([np.roll(trace, -s, axis=-1) for trace, s in zip(echoes.data, shifts, strict=True)])
    moved = echoes.replace(data=data, t0=echoes.t0 + shifts / echoes.fs)
    grid = pysas.Grid.plane(SMALL.axes["x"], [22.0, 22.5])  # far from the record's ends, where the roll wraps
    assert relative(pysas.backproject(moved, grid, 1e-5).data, pysas.backproject(echoes, grid, 1e-5).data) < 2e-5


def test_out_is_filled_in_place():
    echoes = straight(8)
    expected = pysas.backproject(echoes, SMALL).data
    for out in (np.full(SMALL.shape, 7j), np.full((SMALL.shape[0], 2 * SMALL.shape[1]), 7j)[:, ::2]):
        image = pysas.backproject(echoes, SMALL, out=out)
        assert image.data is out and np.array_equal(out, expected)
    for out, error in (
        (np.zeros(SMALL.shape, np.complex64), TypeError),
        (np.zeros((3, 3), complex), ValueError),
        ([0], TypeError),
    ):
        with pytest.raises(error, match="out"):
            pysas.backproject(echoes, SMALL, out=out)
    locked = np.zeros(SMALL.shape, complex)
    locked.flags.writeable = False
    with pytest.raises(ValueError, match="out"):
        pysas.backproject(echoes, SMALL, out=locked)


def test_progress_rises_to_one():
    shares = []
    pysas.backproject(straight(64), PLANE, threads=2, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and shares[0] >= 0


def test_non_finite_samples():
    echoes = moving(5)
    data = echoes.data.copy()
    data[3, 2, 5] = np.nan
    data[4, 1, 7] = np.inf
    bad = echoes.replace(data=data)
    with pytest.raises(ValueError, match="ping 3, channel 2"):
        pysas.backproject(bad, SMALL)
    image = pysas.backproject(bad, SMALL, nan="mask")
    weights = np.ones((5, 6))
    weights[3, 2] = weights[4, 1] = 0
    assert relative(image.data, pysas.backproject(echoes, SMALL, weights=weights).data) < 1e-6
    assert any("2 of 30 traces left out" in note for note in image.report.notes)


def test_a_grid_outside_the_record_warns_and_is_zero():
    grid = pysas.Grid.plane(SMALL.axes["x"], SMALL.axes["y"] + 500)
    with pytest.warns(UserWarning, match="outside the recorded window: image is zero"):
        image = pysas.backproject(straight(4), grid)
    assert not image.data.any() and image.report.share_left_out == 1
    assert any("outside the recorded window" in note for note in image.report.notes)


@pytest.mark.parametrize(
    ("change", "options", "error", "text"),
    [
        ({"compressed": False}, {}, ValueError, "compressed"),
        ({"bandwidth": 39e3}, {}, ValueError, "1.1 x"),
        ({}, {"tol": 0}, ValueError, "tol=0"),
        ({}, {"tol": np.nan}, ValueError, "tol=nan"),
        ({}, {"tol": "small"}, TypeError, "tol='small'"),
        ({}, {"tol": 0.5}, ValueError, "at most 0.1"),
        ({}, {"tol": 1e-12}, ValueError, "1e-10 at best"),
        ({}, {"threads": 0}, ValueError, "threads=0"),
        ({}, {"threads": 1.5}, TypeError, "threads=1.5"),
        ({}, {"backend": "fortran"}, ValueError, "backend='fortran'"),
        ({}, {"nan": "ignore"}, ValueError, "nan='ignore'"),
        ({}, {"weights": np.ones(3)}, ValueError, "weights: expected shape"),
        ({}, {"weights": [np.inf] + [1.0] * 7}, ValueError, "weights: non-finite at ping 0"),
        ({}, {"weights": ["a"] * 8}, TypeError, "weights"),
    ],
)
def test_errors_name_the_argument(change, options, error, text):
    with pytest.raises(error, match=text):
        pysas.backproject(straight(8).replace(**change), SMALL, **options)


def test_wrong_objects():
    with pytest.raises(TypeError, match="echoes"):
        pysas.backproject(np.zeros(3), SMALL)
    with pytest.raises(TypeError, match="grid"):
        pysas.backproject(straight(2), np.zeros(3))


def test_complex64_names_its_least_tol():
    echoes = straight(8)
    with pytest.raises(ValueError, match="1e-05 at best; complex128"):
        pysas.backproject(echoes.replace(data=echoes.data.astype(np.complex64)), SMALL, 1e-6)


def test_from_another_thread_and_two_at_once():
    echoes = moving()
    expected = pysas.backproject(echoes, PLANE).data
    found = [None, None]

    def work(i):
        found[i] = pysas.backproject(echoes, PLANE, threads=2).data

    threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(image, expected) for image in found)


def test_nothing_global_changes():
    import signal

    before = (
        np.geterr(),
        signal.getsignal(signal.SIGINT),
        warnings.filters[:],
        threading.active_count(),
        sys.getswitchinterval(),
    )
    pysas.backproject(moving(), SMALL, threads=2)
    after = np.geterr(), signal.getsignal(signal.SIGINT), warnings.filters[:], threading.active_count(), sys.getswitchinterval()
    assert before == after
    assert np.float32(1e-40) * np.float32(1.0) != 0  # subnormals still live: no flush-to-zero left behind
