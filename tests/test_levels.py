"""The promise of tol beside bright samples that pixels do not read: echoes just outside the grid, blasts cut by records' ends.

Expected: `pysas.reference.exact`, the float64 oracle. An image keeps tol, or its report says how much more, and warns.
"""

import warnings
from unittest import mock

import answers
import numpy as np
import pytest
from scenes import noise, straight

import pysas
from pysas.engine import native, summation
from pysas.imaging import levels

BACKENDS = ["numba"] + ["cpp"] * (native.extension() is not None)
C, FS, FC, N = 1500.0, 40e3, 100e3, 700


def pulse(n, place, over):
    """Samples of a Gaussian pulse whose spectrum is below 1e-9 beyond the band of data sampled `over` x their bandwidth."""
    return np.exp(-(((n - place) / (1.5 * 2.0 * over / 1.33)) ** 2))


def scene(seed):
    """A dark image in a record that is bright where no pixel reads it: what it is called, echoes, grid."""
    rng = np.random.default_rng(seed)
    kind = ("before", "behind", "start", "end", "inside")[seed % 5]
    over, level = rng.choice([1.33, 1.33, 1.6, 2.5]), 10 ** (rng.uniform(0, 100) / 20)
    pings, first, count = 40, int(rng.integers(60, 450)), int(rng.integers(10, 60))
    tx = np.zeros((pings, 3))
    tx[:, 0] = (np.arange(pings) - pings / 2) * 0.02
    t0 = rng.choice([0.0, 0.02, 0.05])
    n = np.arange(N)
    data = noise(pings, 1, N, 1 / over, seed)[:, 0]
    if kind in ("before", "behind"):
        away = rng.uniform(1.5, 40)
        place = first - away if kind == "before" else first + count - 1 + away
        point = np.array([rng.uniform(-0.2, 0.2), (t0 + place / FS) * C / 2, 0.0])
        tau = 2 * np.linalg.norm(point - tx, axis=1)[:, None] / C
        data = data + level * pulse(n, (tau - t0) * FS, over) * np.exp(-2j * np.pi * FC * tau)
    else:  # what all pings have at one time: a transmit pulse, an interference
        place = {"start": rng.uniform(-3, 3), "end": N - 1 + rng.uniform(-3, 3), "inside": rng.uniform(8, first - 20)}[kind]
        data = data + level * pulse(n, place, over)
    if kind == "end":
        first = N - first - count
    y = (t0 + (first + np.arange(count)) / FS) * C / 2
    echoes = pysas.Echoes(data, fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=t0, bandwidth=FS / over)
    return f"{kind}, {20 * np.log10(level):.0f} dB", echoes, pysas.Grid.plane((np.arange(24) - 12) * 0.012, y)


def with_trees(echoes, grid, backend):
    """A plan of trees, however small the image is, that may be left."""
    with mock.patch("pysas.engine.cpp.TREES_MAY_GO", True):
        plan = pysas.plan(echoes, grid, 6e-3, "ffbp", backend=backend, fallback=False)
    assert plan.by.trees and plan.by.share == 1
    plan.by.fallback = True
    return plan


def kept(plan, data, exact, level, case):
    """Image; the promise of its plan's tol, or more where the report says so and a warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        image = plan(data)
    error, report = pysas.metrics.relative_error(image.data, exact, level), image.report
    case = (*case, plan.tol, error, report.predicted_error, report.notes)
    if report.predicted_error <= plan.tol * (1 + 1e-9):
        assert error <= plan.tol and not caught, case
    else:
        assert error <= report.predicted_error and len(caught) == 1, case
    return report


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", [*range(10), 1007, 1008, 1025])
def test_sums_beside_bright_samples_keep_tol_or_say_that_they_do_not(seed, backend):
    name, echoes, grid = scene(seed)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    exact, level = answers.exact(single, grid)
    for tol in 10.0 ** -np.random.default_rng(seed).uniform(1, 5, 3):
        kept(pysas.plan(single, grid, tol, "backprojection", backend=backend), single.data, exact, level, (name, backend))


@pytest.mark.parametrize("seed", [1003, 1006, 1007, 1011, 1012, 1022, 1027])
def test_trees_beside_bright_samples_keep_tol_or_are_left(seed):
    """Sub-images have nodes around the image, that hold bright echoes beside it, and none for frequencies beyond the band."""
    name, echoes, grid = scene(seed)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    exact, level = answers.exact(single, grid)
    used = 0
    for backend in BACKENDS:
        plan = with_trees(single, grid, backend)
        used += kept(plan, single.data, exact, level, (name, backend)).factorised_share > 0
        # left for these data only
        plain = noise(40, 1, N, single.bandwidth / FS, seed, np.complex64)[:, 0]
        report = plan(plain).report
        assert report.factorised_share == 1 and not report.choices["wide"]
    assert used in (0, len(BACKENDS))


def within_longer_records(echoes, seed=0):
    """The same echoes as what was recorded of longer ones, which begin at times of their own and hold NaN elsewhere."""
    pings, n = echoes.data.shape[0], echoes.n_sample
    first = np.random.default_rng(seed).integers(0, 300, pings)
    data = np.full((pings, n + 400), np.nan, dtype=echoes.dtype)
    for ping in range(pings):
        data[ping, first[ping] : first[ping] + n] = echoes.traces[ping, 0]
    valid = np.stack([first, first + n - 1], axis=1)
    return echoes.replace(data=data, t0=echoes.start_time - first / echoes.fs, valid=valid, rx=echoes.receivers[:, 0])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", [2, 3, 7, 8, 1007, 1008])
def test_ends_of_what_was_recorded_are_a_records_ends(seed, backend):
    """Blasts that these ends cut: as many sums and trees as of records that end there, and the same choices."""
    name, echoes, grid = scene(seed)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    both = (single, within_longer_records(single, seed))
    exact, level = answers.exact(single, grid)
    for tol in 10.0 ** -np.random.default_rng(seed).uniform(1, 5, 3):
        plans = [pysas.plan(e, grid, tol, "backprojection", backend=backend) for e in both]
        reports = [kept(plan, e.data, exact, level, (name, backend)) for plan, e in zip(plans, both, strict=True)]
        assert reports[0].choices["wide"] == reports[1].choices["wide"]
        assert reports[1].predicted_error <= max(tol, 1.5 * reports[0].predicted_error)
    trees = [with_trees(e, grid, backend) for e in both]
    shares = [kept(plan, e.data, exact, level, (name,)).factorised_share for plan, e in zip(trees, both, strict=True)]
    assert shares[0] == shares[1]


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_rings_of_what_was_recorded_is_part_of_the_image(backend):
    """As of a record's own bright start; samples that were not recorded are no numbers, and take no part."""
    echoes, grid = straight(32), pysas.Grid.plane(np.arange(-12, 12) * 0.02, 19.0 + np.arange(24) * 0.02)
    data = echoes.data.copy()
    data[..., :9] += 1e18
    cut = echoes.replace(data=data)
    longer = within_longer_records(cut)
    plan = pysas.plan(longer, grid, 1e-3, "backprojection", backend=backend)
    report = kept(plan, longer.data, *answers.exact(cut, grid), (backend,))
    assert report.predicted_error <= 1e-3


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_float64_cannot_tell_apart_in_what_was_recorded_is_said(backend):
    """As of whole records, in `test_what_float64_cannot_tell_apart_is_said`, beside samples that are no numbers."""
    echoes, grid = straight(32), pysas.Grid.plane(np.arange(-12, 12) * 0.02, 19.0 + np.arange(24) * 0.02)
    data = echoes.data + 1e18 * np.exp(-(((np.arange(echoes.n_sample) - 500) / 12) ** 2))
    with pytest.warns(UserWarning, match=r"tol=0.001 is not promised, error .* predicted"):
        pysas.backproject(within_longer_records(echoes.replace(data=data)), grid, 1e-3, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("tol", [1e-6, 1e-9])
@pytest.mark.parametrize("seed", [100, 101, 102, 104])
def test_double_precision_keeps_tol_beside_bright_samples(seed, tol, backend):
    name, echoes, grid = scene(seed)
    exact, level = answers.exact(echoes, grid)
    image = pysas.backproject(echoes, grid, tol, backend=backend)
    assert pysas.metrics.relative_error(image.data, exact, level) <= tol, name


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_float64_cannot_tell_apart_is_said(backend):
    """A transmit pulse 1e18 times as bright as the sea, of which float64 has 1e-16; it is smooth: nothing of it rings.

    The spectrum of exp(-(n/12)^2) is exp(-(12 pi f)^2), below 1e-120 where W falls.
    """
    echoes, grid = straight(32), pysas.Grid.plane(np.arange(-12, 12) * 0.02, 19.0 + np.arange(24) * 0.02)
    data = echoes.data + 1e18 * np.exp(-(((np.arange(echoes.n_sample) - 500) / 12) ** 2))
    with pytest.warns(UserWarning, match=r"tol=0.001 is not promised, error .* predicted"):
        image = pysas.backproject(echoes.replace(data=data), grid, 1e-3, backend=backend)
    assert image.report.predicted_error > 1e-3 and any("not promised" in note for note in image.report.notes)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_rings_of_bright_ends_is_part_of_the_image(backend):
    """A record that starts with 1e18 at full height: what W makes of that at the pixels is 1e9 times the sea, and exact."""
    echoes, grid = straight(32), pysas.Grid.plane(np.arange(-12, 12) * 0.02, 19.0 + np.arange(24) * 0.02)
    data = echoes.data.copy()
    data[..., :9] += 1e18
    plan = pysas.plan(echoes, grid, 1e-3, "backprojection", backend=backend)
    report = kept(plan, data, *answers.exact(echoes.replace(data=data), grid), (backend,))
    assert report.predicted_error <= 1e-3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("backend", BACKENDS)
def test_trees_over_low_passed_records_leave_out_what_is_not_finite(backend, bad):
    """Not even multiplied by a weight of 0, which would raise a RuntimeWarning."""
    n_ping, fs = 200, 30e3
    tx = np.zeros((n_ping, 3))
    tx[:, 0] = np.linspace(-2, 2, n_ping)
    data = noise(n_ping, 1, 700, 2 / 3, 0, np.complex64)[:, 0]
    echoes = pysas.Echoes(data, fs=fs, fc=FC, tx=tx, rx=tx, c=C, t0=2 * 7.6 / C, bandwidth=20e3)
    grid = pysas.Grid.plane((np.arange(160) - 80) * 0.02, 10 + np.arange(80) * 0.02)
    plan = pysas.plan(echoes, grid, 1e-3, "ffbp", backend=backend, nan="mask", fallback=False)
    assert plan.choices.n_fft
    data = data.copy()
    data[7] = 0
    expected = plan(data)
    data[7, 100:300] = bad
    found = plan(data)
    assert found.report.factorised_share > 0 and "1 of 200 traces left out" in found.report.notes[0]
    error = np.linalg.norm(found.data - expected.data)
    assert error <= 1e-5 * np.linalg.norm(expected.data)


def burst(ping, side, off, level):
    """A long dark swath, with a pulse in one ping's record `off` samples before or behind all that its pixels read."""
    pings, samples, fs = 150, 1500, 30e3
    tx = np.zeros((pings, 3))
    tx[:, 0] = np.linspace(-0.75, 0.75, pings)
    data = noise(pings, 1, samples, 2 / 3, 0, np.complex64)[:, 0]
    echoes = pysas.Echoes(data, fs=fs, fc=FC, tx=tx, rx=tx, c=C, t0=14 / C, bandwidth=20e3)
    grid = pysas.Grid.plane((np.arange(8) - 4) * 0.03, 10 + np.arange(700) * 0.03)
    read = (2 * np.linalg.norm(grid.coordinates() - tx[ping], axis=-1) / C - 14 / C) * fs
    place = read.max() + off if side == "behind" else read.min() - off
    data[ping] += (level * np.exp(-(((np.arange(samples) - place) / 4.2) ** 2))).astype(np.complex64)
    return echoes, grid


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("ping", "side", "off", "level"),
    [(3, "behind", 9, 1e5), (75, "behind", 13, 1e6), (40, "before", 11, 1e5), (110, "before", 13, 1e6)],
)
def test_a_burst_in_one_ping_just_outside_of_what_its_pixels_read(ping, side, off, level, backend):
    echoes, grid = burst(ping, side, off, level)
    plan = pysas.plan(echoes, grid, 1e-3, "backprojection", backend=backend)
    kept(plan, echoes.data, *answers.exact(echoes, grid), (ping, side, off, level, backend))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("off", [20, 45])
def test_a_burst_in_one_ping_within_reach_of_trees(off, backend):
    echoes, grid = burst(75, "behind", off, 1e6)
    plan = with_trees(echoes, grid, backend)
    kept(plan, echoes.data, *answers.exact(echoes, grid), (off, backend))


@pytest.mark.parametrize("backend", BACKENDS)
def test_trees_are_not_left_without_leave(backend):
    _, echoes, grid = scene(1011)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    assert with_trees(single, grid, backend)(single.data).report.factorised_share == 0
    plan = pysas.plan(single, grid, 6e-3, "ffbp", backend=backend, fallback=False)
    out = np.full(grid.shape, 7, np.complex64)
    with pytest.raises(ValueError, match=r"fallback=False, tol=0.006: samples beside those that pixels read are too bright"):
        plan(single.data, out)
    assert np.all(out == 7)
    assert plan(noise(40, 1, N, single.bandwidth / FS, 0, np.complex64)[:, 0]).report.factorised_share == 1


@pytest.mark.parametrize("seed", [1003, 1006, 1007])
def test_other_choices_are_made_once(monkeypatch, seed):
    """By Numba's engine; that they are the same again by both."""
    calls = []
    for name in ("choose", "for_leaves"):
        whole = getattr(levels.planner, name)
        monkeypatch.setattr(levels.planner, name, lambda *a, whole=whole: (calls.append(0), whole(*a))[1])
    for backend in BACKENDS:
        _, echoes, grid = scene(seed)
        data = echoes.data.astype(np.complex64)
        plan = pysas.plan(echoes.replace(data=data), grid, 6e-3, backend=backend)
        first, made = plan(data), len(calls)
        again = plan(data)
        assert np.array_equal(again.data, first.data) and again.report.choices == first.report.choices
        assert len(calls) == made


@pytest.mark.parametrize("backend", BACKENDS)
def test_why_trees_are_not_used_is_said_once(backend):
    _, echoes, grid = scene(1007)
    single = echoes.replace(data=echoes.data.astype(np.complex64))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = pysas.ffbp(single, grid, 1e-5, backend=backend).report
    assert report.choices["wide"] and sum(note.startswith("summed directly") for note in report.notes) == 1


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", ["backprojection", "ffbp"])
def test_plain_data_are_imaged_as_planned(backend, method):
    """Noise, and a point 80 dB above it inside the image: pixels read what is bright, and nothing else is needed."""
    echoes, grid = straight(64), pysas.Grid.plane(np.arange(-40, 41) * 0.02, 19.0 + np.arange(60) * 0.02)
    point = np.array([0.1, 19.6, 0.0])
    tau = 2 * np.linalg.norm(point - echoes.tx, axis=1)[:, None] / C
    n = np.arange(echoes.n_sample)
    shape = pulse(n, (tau - echoes.start_time[:, None]) * echoes.fs, 1.33) * np.exp(-2j * np.pi * FC * tau)
    for data in (echoes.data, 1e-4 * echoes.data + shape[:, None]):
        for tol in (1e-2, 1e-3, 1e-4):
            plan = pysas.plan(echoes, grid, tol, method, backend=backend)
            report = plan(data).report
            assert not report.choices["wide"] and report.predicted_error == plan.choices.predicted_error
            assert report.choices == plan.choices.reported()


@pytest.mark.cpp
def test_trees_over_whole_records_of_plain_data_stay(monkeypatch):
    """Record ends ring in every image that reaches them; only ends brighter than the image are a reason to leave trees."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    echoes = straight(128, bandwidth=30e3)
    step = C / echoes.fs / 2
    grid = pysas.Grid.plane((np.arange(64) - 32) * 0.02, 19.0 + np.arange(820) * step)
    for tol in (1e-3, 1e-4):
        plan = pysas.plan(echoes, grid, tol, "ffbp", backend="cpp")
        assert plan.by.trees
        assert plan(echoes.data).report.factorised_share == plan.by.share > 0.5


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("over", [1.33, 5.5, 20])
def test_hard_ends_of_oversampled_records(backend, over):
    """A low-passed record's end holds all frequencies up to fs/2, however narrow the band of its data is."""
    bandwidth, samples = 30e3, 200
    tx = np.zeros((16, 3))
    tx[:, 0] = (np.arange(16) - 8) * 0.02
    data = noise(16, 1, samples, 1 / over, 0)[:, 0]
    echoes = pysas.Echoes(data, fs=over * bandwidth, fc=FC, tx=tx, rx=tx, c=C, t0=0.04, bandwidth=bandwidth)
    far = C / 2 * (0.04 + samples / echoes.fs)
    grid = pysas.Grid.plane(np.arange(-16, 16) * 0.01, np.linspace(30, far, 40) + 3.3e-4)
    exact, level = answers.exact(echoes, grid)
    for tol in (1e-2, 1e-3, 1e-4, 1e-6, 1e-9):
        image = pysas.backproject(echoes, grid, tol, backend=backend)
        assert pysas.metrics.relative_error(image.data, exact, level) <= tol, tol


@pytest.mark.cpp
@pytest.mark.parametrize("seed", range(6))
def test_a_filter_keeps_its_error_at_every_frequency_of_its_band(seed):
    """Tones on a fine raster of frequencies, the band's edges among them, and places: `error` is the worst there is."""
    rng = np.random.default_rng(seed)
    over = 1.1 + 18.9 * rng.random() ** 2
    band, error = 0.5 / over, 10.0 ** -rng.uniform(1, 5)
    degree, (phases, step) = int(rng.choice([2, 3, 5])), ((3, 1), (7, 2), (4, 1), (5, 1), (6, 1))[rng.integers(5)]
    filter = native.core().design(band, degree, phases, step, error, 8, 400)
    f = np.linspace(-band, band, 1201)
    t = np.linspace(-0.5, 0.5, 41)
    worst = 0.0
    for phase in range(phases):
        tap = filter.first[phase] + np.arange(filter.taps)
        response = np.exp(2j * np.pi * f[:, None] * tap) @ filter.weight[phase]
        place = ((phase + 0.5) + t) * step / phases
        read = response @ np.vander(t, degree + 1, increasing=True).T
        worst = max(worst, float(np.max(np.abs(read - np.exp(2j * np.pi * f[:, None] * place)))))
    assert worst <= 1.02 * filter.error


@pytest.mark.parametrize("kind", ["<c8", ">c8", "<c16", ">c16"])
@pytest.mark.parametrize("part", [np.s_[:], np.s_[::2], np.s_[:, :, ::-3]])
def test_levels_are_measured_as_plain_numpy_does(kind, part):
    """Peaks to the bit and mean squares to rounding, of samples that are finite and that are not."""
    data = noise(12, 3, 300, 0.9, 5).astype(kind)
    for ping, channel, value in ((2, 1, np.nan), (4, 0, np.inf), (7, 2, complex(1, -np.inf))):
        data[ping, channel, 20 + 30 * ping] = value
    data = data[part]
    rng, traces, n = np.random.default_rng(1), data.shape[0] * 3, data.shape[2]
    begin, end = rng.integers(0, n // 3, traces), rng.integers(n // 2, n, traces)
    trace, place = np.sort(rng.integers(0, traces, 500)), rng.integers(-3, n + 3, 500)
    flat = data.reshape(traces, n).astype("c16")
    largest = np.array([np.abs(s[a:b].view(float)).max() for s, a, b in zip(flat, begin, end, strict=True)])
    low, high = rng.integers(0, n // 3, traces), rng.integers(n // 2, n, traces)  # recorded: others count for nothing
    valid = np.stack([low, high], axis=1)
    outside = (np.arange(n) < low[:, None]) | (np.arange(n) > high[:, None])
    largest[~(np.isfinite(flat) | outside).all(axis=1)] = np.inf
    near = [np.where(outside, 0, flat)[t, max(p - 6, 0) : p + 7] for t, p in zip(trace, place, strict=True)]
    with np.errstate(invalid="ignore"):
        squares = np.array([np.sum(np.abs(s / 2.0) ** 2) / 13 for s in near])
    assert np.array_equal(np.ravel(summation.peaks(data, valid, begin, end, 2)), largest)
    np.testing.assert_allclose(summation.mean_squares(data, valid, trace, place, 6, 2.0, 2), squares, rtol=1e-12)
