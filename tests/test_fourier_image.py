"""Non-uniform FFT and images by Fourier samples of patches, against direct sums and the float64 oracle."""

import importlib.util
import re

import gridding_scenes
import numpy as np
import pytest

import pysas
from pysas.reference import exact, fourier_image, nufft
from pysas.reference.patches import Survey, patch, samples, sectors

pytestmark = pytest.mark.reference

C, FC, FS, BAND = 1500.0, 100e3, 40e3, 30e3
LIBRARIES = ["own", "finufft"] if importlib.util.find_spec("finufft") else ["own"]


def band_limited(pings, channels, n, seed=0):
    """Random traces in the band: the hardest case for any interpolation."""
    spectrum = gridding_scenes.noise((pings, channels, n), seed)
    # the ends of the record are smooth: they have no content outside of the band
    return np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(n)) < BAND / 2 / FS - 2 / n)) * np.hanning(n)


def scene(name, pings=60):
    """Echoes and a grid of 40 x 40 pixels."""
    side = np.arange(-20, 20)
    if name == "circular":
        track = pysas.tracks.circular(pings, 8.0, height=3.0)
        tx, centre, step = track.position, 0.0, 0.003
    else:
        sway = {"straight": 0.0, "perturbed": 0.2}[name]
        track = pysas.tracks.perturbed(pings, 0.05, 4.0, start=(-1.5, 0, 0), sway=sway, heave=sway, correlation=1.0, seed=3)
        tx, centre, step = track.position, 12.0, 0.015
    rx, velocity = tx[:, None], None
    if name == "perturbed":
        rx, velocity = pysas.tracks.array(track, 2, 0.04), np.tile([1.5, 0.2, 0.1], (pings, 1))
    data = band_limited(pings, rx.shape[1], 500)
    start = 2 * np.linalg.norm(tx - [0, centre, 0], axis=1) / C - 250 / FS
    echoes = pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=start, velocity=velocity, bandwidth=BAND)
    return echoes, pysas.Grid.plane(step * side, centre + step * side)


@pytest.fixture(scope="module", params=["straight", "perturbed", "circular"])
def oracle(request):
    echoes, grid = scene(request.param)
    return request.param, echoes, grid, *exact(echoes, grid)


# Non-uniform FFT


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("accuracy", [1e-2, 1e-6, 1e-11])
def test_nufft_is_the_direct_sum(library, accuracy):
    rng = np.random.default_rng(0)
    k, x = rng.uniform(-1, 1, (900, 2)) * [200, 30] + [10, 850], rng.uniform(-1, 1, (300, 2)) * [0.5, 0.3] + [3, 20]
    strengths = gridding_scenes.noise(900)
    expected = np.exp(1j * (x @ k.T)) @ strengths
    found = nufft(k, strengths, x, accuracy=accuracy, library=library)
    assert np.linalg.norm(found - expected) < accuracy * np.linalg.norm(expected)


def test_nufft_extremes():
    k, x = np.array([[3.0, 4.0]]), np.array([[5.0, 6.0], [-2.0, 1.0]])
    np.testing.assert_allclose(nufft(k, [2.0], x, library="own", accuracy=1e-10), 2 * np.exp(1j * (x @ k[0])), rtol=1e-9)
    line = np.stack([np.linspace(-40, 40, 50), np.zeros(50)], axis=1)  # no extent along the second axis
    values = gridding_scenes.noise(50)
    for targets in (np.array([[0.1, 7.0]]), np.stack([np.linspace(0, 1, 9), np.linspace(-3, 3, 9)], axis=1)):
        expected = np.exp(1j * (targets @ line.T)) @ values
        np.testing.assert_allclose(nufft(line, values, targets, library="own", accuracy=1e-9), expected, rtol=0, atol=1e-7)
    for bad, message in (
        ({"accuracy": 0.5}, "accuracy=0.5"),
        ({"library": "fftw"}, "library='fftw'"),
        ({"targets": np.zeros((0, 2))}, "expected at least one"),
        ({"strengths": [[1.0]]}, "strengths: expected shape (1,)"),
        ({"wavenumbers": [[np.inf, 0.0]]}, "wavenumbers: inf at sample 0"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            nufft(**({"wavenumbers": k, "strengths": [1.0], "targets": x} | bad))


def test_libraries_agree_on_an_image():
    echoes, grid = scene("straight")
    some = pysas.Grid.plane(grid.axes["x"][:3], grid.axes["y"][:3])
    wanted, level = exact(echoes, some)
    images = [fourier_image(echoes, some, error=1e-6, library=name, threads=1).data for name in LIBRARIES]
    for image in images:
        assert pysas.metrics.relative_error(image, wanted, level) < 2e-6
        assert pysas.metrics.relative_error(image, images[0]) < 1e-6


# Patches


def test_delays_solve_their_equation():
    echoes, grid = scene("perturbed", 7)
    survey, points = Survey.of(echoes), grid.coordinates()[::97]
    tau = survey.delays(points)
    back = points - survey.rx[:, None] - survey.velocity[:, None] * tau[..., None]
    path = np.linalg.norm(points - survey.tx[:, None], axis=-1) + np.linalg.norm(back, axis=-1)
    np.testing.assert_allclose(C * tau, path, rtol=1e-14)
    still = Survey.of(echoes.replace(velocity=None))
    np.testing.assert_allclose(
        C * still.delays(points),
        np.linalg.norm(points - still.tx[:, None], axis=-1) + np.linalg.norm(points - still.rx[:, None], axis=-1),
        rtol=1e-14,
    )


def test_one_pixel_is_a_patch_without_error(oracle):
    name, echoes, grid, _, _ = oracle
    one = pysas.Grid.plane(grid.axes["x"][13:14], grid.axes["y"][30:31])
    found = fourier_image(echoes, one, error=1e-6, library="own", threads=1)
    # a fifth of `error` is the samples' own
    assert found.report.predicted_error == pytest.approx(2e-7, abs=1e-8)
    assert pysas.metrics.relative_error(found.data, *exact(echoes, one)) < 1e-6


def test_the_error_against_the_size_of_a_patch(oracle):
    name, echoes, grid, image, level = oracle
    x, y = grid.axes["x"], grid.axes["y"]
    survey, centre = Survey.of(echoes), np.array([x.mean(), y.mean(), 0.0])
    predicted = {True: [], False: []}
    for correct in (True, False):
        surveys = sectors(survey, centre) if correct else [survey]
        for half in (5, 10, 20):
            part = slice(20 - half, 20 + half)
            one = patch(surveys, x, y, 0.0, part, part, correct)
            found = 0
            for expansion in one.parts:
                k, values = samples(expansion, one.offsets, 1e-6)
                found = found + nufft(k, values, expansion.targets(one.offsets), accuracy=1e-6, library="own")
            wanted = image[part, part], level[part, part]
            measured = pysas.metrics.relative_error(found.reshape(2 * half, -1), *wanted)
            predicted[correct].append(one.error)
            assert measured < one.error
            if one.error < 0.5:
                assert measured > one.error / 8
    # range curvature is of second order in the size; without what all traces of 45 degrees share, far less is left
    ratios = np.diff(np.log2(predicted[False]))
    np.testing.assert_allclose(ratios, np.log2([19 / 9, 39 / 19]) * 2, rtol=0.03)
    assert np.all(np.array(predicted[True]) < np.array(predicted[False]) / 8)


@pytest.mark.parametrize("error", [1e-1, 1e-2, 1e-3])
def test_tiling_keeps_the_stated_error(oracle, error):
    name, echoes, grid, image, level = oracle
    found = fourier_image(echoes, grid, error=error, library="own" if error > 1e-3 else "auto", threads=1)
    assert found.report.predicted_error <= error
    assert pysas.metrics.relative_error(found.data, image, level) < error
    assert found.report.choices["sectors"] == (8 if name == "circular" else 1)


@pytest.mark.parametrize("name", ["straight", "circular"])
def test_a_bright_point_at_the_worst_place_of_a_patch(name):
    echoes, grid = scene(name)
    place = np.array([grid.axes["x"][0], grid.axes["y"][-1], 0.0])
    tau = 2 * np.linalg.norm(echoes.tx - place, axis=1) / C
    t = echoes.start_time[:, None] + np.arange(500) / FS - tau[:, None]
    point = echoes.replace(data=(np.sinc(t * BAND) * np.exp(-2j * np.pi * FC * tau[:, None]))[:, None])
    wanted, level = exact(point, grid)
    left = fourier_image(point, grid, error=1.0, threads=1).report.predicted_error - 0.2
    error = left / 0.8 * (1 + 1e-9)
    found = fourier_image(point, grid, error=error, tiled=False, library="own", threads=1)
    assert pysas.metrics.relative_error(found.data, wanted, level) < error


def test_silent_pings_have_no_say():
    echoes, grid = scene("straight")
    alive = np.arange(60) >= 54
    dim = echoes.replace(data=echoes.data * alive[:, None, None])
    wanted, level = exact(dim, grid)
    for error in (1e-1, 1e-2):
        found = fourier_image(dim, grid, error=error, threads=1)
        assert pysas.metrics.relative_error(found.data, wanted, level) < error
    place = grid.axes["x"], grid.axes["y"], 0.0, slice(0, 40), slice(0, 40), False
    whole = Survey.of(echoes)
    some = patch([whole.of_traces(np.flatnonzero(alive))], *place).error
    assert patch([Survey.of(dim)], *place).error == pytest.approx(some, rel=1e-12)
    assert abs(patch([whole], *place).error / some - 1) > 1e-3


def test_uncorrected_curvature_is_what_geometry_says():
    echoes, _ = scene("straight")
    survey = Survey.of(echoes)
    # d across the look of a short aperture: 2 k (sqrt(R^2 + d^2) - R) = k d^2/R of two-way phase
    few = survey.of_traces(np.arange(29, 31))
    one = patch([few], np.array([-0.2, 0.2]), np.array([12.0]), 0.0, slice(0, 1), slice(0, 2), False)
    assert one.error == pytest.approx(2 * np.pi * survey.frequency / C * 0.2**2 / np.hypot(12, 4), rel=0.01)


def test_beyond_the_limit_a_single_patch_raises():
    echoes, grid = scene("straight")
    assert fourier_image(echoes, grid, error=0.3, tiled=False, threads=1).report.choices["patches"] == 1
    with pytest.raises(ValueError, match=r"leaves 0\.\d+ rad of plane waves.*0\.8 error=0.001, patches of about 0\.\d+ m"):
        fourier_image(echoes, grid, error=1e-3, tiled=False, threads=1)
    assert fourier_image(echoes, grid, error=0.1, correct=False, threads=1).report.choices["patches"] > 4


def test_threads_masks_and_records_that_end():
    echoes, grid = scene("perturbed")
    image = fourier_image(echoes, grid, error=1e-2, threads=1)
    np.testing.assert_array_equal(fourier_image(echoes, grid, error=1e-2, threads=3).data, image.data)
    mask = np.zeros(grid.shape, dtype=bool)
    mask[3:9, 5:30] = True
    masked = pysas.Grid.plane(grid.axes["x"], grid.axes["y"], mask=mask)
    np.testing.assert_array_equal(fourier_image(echoes, masked, error=1e-2, threads=1).data, np.where(mask, image.data, 0))
    assert not image.report.notes
    # a record that ends within the grid: as exact where every delay is well inside
    short = echoes.replace(data=echoes.data[..., :262])
    found, (wanted, level) = fourier_image(short, grid, error=1e-2, threads=1), exact(short, grid)
    assert re.fullmatch(r"\d+ of 120 traces end within the grid: .*", found.report.notes[0])
    survey = Survey.of(short)
    late = np.max(survey.delays(grid.coordinates()) - survey.start[:, None], axis=0).reshape(grid.shape)
    inside = late * FS < 247
    assert 100 < np.count_nonzero(inside) < inside.size
    assert pysas.metrics.relative_error(found.data[inside], wanted[inside], level[inside]) < 1.5e-2
    assert not fourier_image(short, pysas.Grid.plane([0.0, 0.1], [90.0])).data.any()
    assert not fourier_image(short, pysas.Grid.plane([0.0, 0.1], [90.0]), "frame").data.any()


# Inversions


@pytest.fixture(scope="module")
def three_points():
    track = pysas.tracks.perturbed(60, 0.05, 4.0, start=(-1.5, 0, 0), sway=0.1, correlation=1.0, seed=3)
    points, amplitudes = np.array([[0.0, 12.0, 0.0], [0.12, 12.05, 0.0], [-0.1, 11.9, 0.0]]), np.array([1.0, 0.7, 0.5])
    raw = pysas.simulate(
        points, amplitudes, pysas.LFM(FC, 20e3, 2e-3, "tukey", 0.5), tx=track.position, rx=track.position, fs=FS,
        duration=5e-3, t0=2 * 11.5 / C, dtype=np.complex128, threads=1,
    )  # fmt: skip
    echoes = pysas.compress(raw, threads=1)
    grid = pysas.Grid.plane(np.linspace(-0.2, 0.2, 41), 12 + np.linspace(-0.2, 0.2, 41))
    return echoes, grid, points, *exact(echoes, grid)


@pytest.mark.parametrize("method", ["gridding", "frame", "ftcg"])
def test_inversions_find_the_points(three_points, method):
    echoes, grid, points, image, _ = three_points
    found = fourier_image(echoes, grid, method, error=0.1, threads=1)
    assert found.report.choices["patches"] == 1 and np.isfinite(found.data).all()
    for point in points:
        place = pysas.metrics.peak_position(found, point[:2], 0.03)
        assert place == pytest.approx(tuple(point[:2]), abs=3e-3)
        i, j = np.argmin(np.abs(grid.axes["y"] - point[1])), np.argmin(np.abs(grid.axes["x"] - point[0]))
        # amplitudes of back-projection, and its phases
        assert abs(found.data[i, j] / image[i, j] - 1) < 0.15
    for cut in ((slice(20, 21), slice(None)), (slice(None), slice(20, 21))):
        widths = [pysas.metrics.irw(data[cut].ravel(), 0.01) for data in (found.data, image)]
        assert widths[0] < 1.1 * widths[1]


def test_inversions_of_a_circular_track():
    track, place = pysas.tracks.circular(90, 4.0), np.array([0.002, -0.003, 0.0])
    tau = 2 * np.linalg.norm(track.position - place, axis=1) / C
    fs, band = 80e3, 60e3
    start = 2 * 4.0 / C - 60 / fs
    t = start + np.arange(120) / fs - tau[:, None]
    data = np.sinc(t * band) * np.exp(-2j * np.pi * FC * tau[:, None])
    echoes = pysas.Echoes(data, fs=fs, fc=FC, tx=track.position, rx=track.position, c=C, t0=start, bandwidth=band)
    grid = pysas.Grid.plane(0.001 * np.arange(-8, 9), 0.001 * np.arange(-8, 9))
    # an inversion weighs areas of the ring of wavenumbers, the sum its frequencies: their ratio is 1 + f/fc. Pipe and Menon's
    # weights are larger at the ring's edges; frames leave over what their modes lack; a band is coarser still
    ramp = 1 + np.fft.fftfreq(120, 1 / fs) / FC
    image, _ = exact(echoes.replace(data=np.fft.ifft(np.fft.fft(data) * ramp)), grid)
    for method, limit in (("gridding", 0.15), ("frame", 0.15), ("ftcg", 0.25)):
        found = fourier_image(echoes, grid, method, error=0.3, threads=1)
        assert found.report.choices["patches"] == 1
        i, j = np.unravel_index(np.argmax(np.abs(found.data)), grid.shape)
        assert (grid.axes["x"][j], grid.axes["y"][i]) == pytest.approx(place[:2])
        assert pysas.metrics.relative_error(gridding_scenes.fitted(image, found.data), image) < limit


BAD = {
    "grid: expected a plane": {"grid": pysas.Grid.points(np.zeros((2, 3)))},
    "method='fft'": {"method": "fft"},
    "error=1e-09": {"error": 1e-9},
    "r=-1": {"r": -1},
    "rcond=2": {"rcond": 2},
    "library='x'": {"library": "x"},
    "expected beam=None": {"beam": pysas.Beam((0, 1, 0), 0.1, 0.2)},
    "expected range-compressed echoes": {"compressed": False},
    "data: (nan+0j) at ping 3, channel 0, sample 7": {"bad": (3, 0, 7)},
}


@pytest.mark.parametrize("message", BAD)
def test_one_clear_error(message):
    options = dict(BAD[message])
    echoes, grid = scene("straight", 5)
    if "bad" in options:
        data = echoes.data.copy()
        data[options.pop("bad")] = np.nan
        echoes = echoes.replace(data=data)
    echoes = echoes.replace(**{name: options.pop(name) for name in ("beam", "compressed") if name in options})
    with pytest.raises(ValueError, match=re.escape(message)):
        fourier_image(echoes, options.pop("grid", grid), **options)
    with pytest.raises(TypeError, match="echoes=int"):
        fourier_image(1, grid)
    with pytest.raises(TypeError, match="grid=int"):
        fourier_image(echoes, 1)
