"""What was recorded of each trace: `valid` is a cropped trace, and `nan="mask"` finds it where a recorder padded with NaN.

Answers are those of `reference.exact`, which crops the traces itself, and of echoes that were cropped here.
"""

import answers
import numpy as np
import pytest
from scenes import PLANE, C, bright, moving, ring, straight, survey

import pysas
from pysas.engine import cpp
from pysas.inspection import inspect
from pysas.model.gaps import shortened, windows_of

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
FEW = pysas.Grid.plane(np.arange(-20, 21) * 0.05, 19.0 + np.arange(20) * 0.06)
CENTRE = pysas.Grid.plane(np.arange(-30, 31) * 0.02, np.arange(-30, 31) * 0.02)
BEAM = pysas.Beam([0, 1, -0.25], 0.05, 0.03, taper=0.5)


def windowed(echoes, seed=0, channels=True, fill=np.nan):
    """Random windows, one trace that holds nothing and one of a single sample among them; `fill` outside."""
    rng, n = np.random.default_rng(seed), echoes.n_sample
    shape = echoes.traces.shape[: 2 if channels and echoes.data.ndim == 3 else 1]
    valid = np.stack([rng.integers(0, n // 3, shape), rng.integers(n // 2, n, shape)], axis=-1)
    valid.reshape(-1, 2)[:3] = (5, 4), (n // 3, n // 3), (0, n - 1)
    return filled(echoes.replace(valid=valid), fill)


def filled(echoes, fill):
    """`fill` where nothing was recorded."""
    at, windows = np.arange(echoes.n_sample), echoes.windows
    data = echoes.data.copy()
    traces = data if data.ndim == 3 else data[:, None]
    traces[(at < windows[..., :1]) | (at > windows[..., 1:])] = fill
    return echoes.replace(data=data)


def error(image, echoes, grid, count=150):
    """Error on some pixels by the norm of tol's promise."""
    pixels = np.random.default_rng(1).choice(grid.size, min(count, grid.size), replace=False)
    return pysas.metrics.relative_error(image.data.ravel()[pixels], *answers.exact(echoes, grid, pixels))


SCENES = {
    "straight": (straight, PLANE),
    "six moving receivers in a beam": (lambda: moving(beam=BEAM), PLANE),
    "a window of a ping": (moving, FEW),
    "circular": (lambda: ring(40), CENTRE),
    "beside a bright point": (lambda: bright(32), pysas.Grid.plane(np.arange(-20, 21) * 0.04, 21.6 + np.arange(30) * 0.04)),
    "full band": (lambda: straight(32, bandwidth=40e3 / 1.1), PLANE),
    "points": (moving, pysas.Grid.points(FEW.coordinates())),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", SCENES)
def test_random_windows_keep_tol(name, engine):
    make, grid = SCENES[name]
    echoes = windowed(make(), channels=name != "a window of a ping")
    pixels = np.random.default_rng(1).choice(grid.size, 150, replace=False)
    exact, level = answers.exact(echoes, grid, pixels)
    for dtype, tolerances in ((np.complex64, (1e-1, 1e-3, 1e-5)), (np.complex128, (1e-4, 1e-7, 1e-10))):
        given = echoes.replace(data=echoes.data.astype(dtype))
        for tol in tolerances:
            image = pysas.backproject(given, grid, tol, backend=engine)
            assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= tol, (dtype, tol)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("tol", [1e-2, 1e-3])
def test_trees_keep_tol_beside_windows_ends(tol, engine, monkeypatch):
    monkeypatch.setattr(cpp, "TREES_MUST_PAY", False)
    echoes = straight(192, samples=1400)
    rng = np.random.default_rng(4)
    ends = np.stack([rng.integers(0, 60, 192), rng.integers(1000, 1400, 192)], axis=1)
    echoes = filled(echoes.replace(data=echoes.data.astype(np.complex64), valid=ends), np.nan)
    x = np.arange(160) * 0.02
    grid = pysas.Grid.plane(x - x.mean(), 24.0 + np.arange(400) * 0.05)  # the ends of many windows lie within
    image = pysas.ffbp(echoes, grid, tol, backend=engine)
    assert 0.02 < image.report.factorised_share < 0.98
    assert error(image, echoes, grid) <= tol


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("tol", [1e-3, 1e-5])
def test_a_bright_hard_end_rings_from_where_it_is(tol, engine):
    """A transmit pulse, 60 dB up, that windows cut in its middle: W rings over the pixels beside it."""
    echoes = straight(48)
    t, n = np.arange(900), 900
    data = echoes.data + 1e3 * np.exp(-(((t - 150) / 40) ** 2)) * np.exp(0.3j * t)
    cut = echoes.replace(data=data.astype(np.complex64), valid=np.tile([150, n - 1], (48, 1)))
    grid = pysas.Grid.plane(np.arange(-20, 21) * 0.04, 20.9 + np.arange(40) * 0.03)  # from sample 150 on
    image = pysas.backproject(cut, grid, tol, backend=engine)
    cropped = cut.replace(data=cut.data[..., 150:], t0=cut.t0 + 150 / cut.fs, valid=None)
    assert error(image, cut, grid) <= tol and error(image, cropped, grid) <= tol


@pytest.mark.parametrize("engine", ENGINES)
def test_a_window_is_the_cropped_trace(engine):
    """The same windows for all traces: echoes with fewer samples that begin later."""
    for tol in (1e-3, 1e-8):
        echoes = filled(moving().replace(valid=np.tile([120, 640], (16, 1))), np.inf)
        cropped = echoes.replace(data=echoes.data[..., 120:641], t0=echoes.t0 + 120 / echoes.fs, valid=None)
        images = [pysas.backproject(e, FEW, tol, backend=engine) for e in (echoes, cropped)]
        assert images[0].report.terms > 0
        assert np.linalg.norm(images[0].data - images[1].data) <= 2 * tol * np.linalg.norm(images[1].data)


def test_the_oracle_crops():
    echoes = windowed(moving(), fill=complex(np.nan, np.inf))
    total, power = np.zeros(FEW.shape, dtype=complex), np.zeros(FEW.shape)
    for ping, channel in np.ndindex(16, 6):
        first, last = echoes.valid[ping, channel]
        if first > last:
            continue
        one = pysas.Echoes(
            echoes.data[ping : ping + 1, channel, first : last + 1], fs=echoes.fs, fc=echoes.fc, tx=echoes.tx[ping : ping + 1],
            rx=echoes.rx[ping : ping + 1, channel], velocity=echoes.velocity[ping : ping + 1], c=C,
            t0=float(echoes.start_time[ping]) + first / echoes.fs, bandwidth=echoes.bandwidth,
        )  # fmt: skip
        image, level = answers.exact(one, FEW)
        total, power = total + image, power + level**2
    exact, level = answers.exact(echoes, FEW)
    assert np.linalg.norm(exact - total) < 1e-11 * np.linalg.norm(total)
    assert np.linalg.norm(level - np.sqrt(power)) < 1e-11 * np.linalg.norm(level)
    # samples no float64 squares hold, beside others that are no numbers
    with np.errstate(invalid="ignore"):
        data = echoes.data * 2.0**600
    large = answers.exact(echoes.replace(data=data), FEW)
    assert np.linalg.norm(large[0] * 2.0**-600 - exact) < 1e-13 * np.linalg.norm(exact)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_term_on_a_windows_edge_counts(engine):
    """Within 1e-4 samples beyond its first and its last sample, as at a record's ends."""
    sample = C / 2 / 40e3
    tx = np.zeros((1, 3))
    echoes = pysas.Echoes(np.ones((1, 200), np.complex128), fs=40e3, fc=1e5, tx=tx, rx=tx, t0=2 * 10.0 / C, bandwidth=30e3)
    echoes = echoes.replace(valid=np.array([[20, 150]]))
    place = np.array([20 - 1.5e-4, 20 - 0.5e-4, 20.0, 150.0, 150 + 0.5e-4, 150 + 1.5e-4])
    points = np.stack([10.0 + sample * place, 0 * place, 0 * place], axis=1)
    for method in (pysas.backproject, pysas.focus):
        image = method(echoes, pysas.Grid.points(points), 1e-8, backend=engine)
        assert image.report.terms == 4
        assert np.array_equal(image.data != 0, [False, True, True, True, True, False])
    assert np.array_equal(answers.exact(echoes, pysas.Grid.points(points))[1] != 0, image.data != 0)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("tol", [1e-3, 1e-9])
def test_lines_across_a_windows_edges_are_dark_beyond(tol, engine):
    """Lines half a sample from one to the next, along which delays change by 1.4 samples: some cross the edges."""
    tx = np.zeros((1, 3))
    echoes = pysas.Echoes(np.ones((1, 400), complex), fs=40e3, fc=1e5, tx=tx, rx=tx, t0=2 * 30.0 / C, bandwidth=30e3)
    echoes = echoes.replace(valid=np.array([[100, 300]]), data=echoes.data.astype(np.complex64 if tol == 1e-3 else complex))
    sample = C / 2 / 40e3
    for edge in (100, 300):
        grid = pysas.Grid.plane(np.arange(64) * 0.02, 30.0 + (edge - 10.03 + np.arange(40) * 0.5) * sample)
        image = pysas.backproject(echoes, grid, tol, backend=engine)
        lit = answers.exact(echoes, grid)[1] != 0
        assert np.array_equal(image.data != 0, lit) and 0.3 < np.mean(lit) < 0.7


@pytest.mark.parametrize("edge", [0, 1])
def test_bounds_near_a_windows_ends_are_those_of_all_frequencies(edge):
    """A low-passed trace holds all |f| < 1/2 near a hard end and not its band, 0.15, alone: as beside a record's own."""
    echoes = straight(8, bandwidth=12e3, samples=4000).replace(t0=2 * 10.0 / C)  # pixels read samples 500 to 560 or so
    valid = [470, 3999] if edge == 0 else [0, 600]
    plans = [pysas.plan(e, FEW, backend="numba") for e in (echoes.replace(valid=np.tile(valid, (8, 1))), echoes)]
    near, far = (plan.choices.errors["interpolation"] for plan in plans)
    assert near > 100 * far


@pytest.mark.parametrize("engine", ENGINES)
def test_nothing_recorded_is_said(engine):
    echoes = moving(4)
    empty = np.tile([0, -1], (4, 1))
    with pytest.warns(UserWarning, match="nothing was recorded: valid holds no sample of any trace: image is zero"):
        image = pysas.backproject(echoes.replace(valid=empty), FEW, backend=engine)
    assert image.report.terms == 0 and not image.data.any()
    with pytest.warns(UserWarning, match=r"outside the recorded window.* record 18\.75 to 18\.94 m"):
        pysas.backproject(echoes.replace(valid=np.tile([40, 50], (4, 1))), FEW, backend=engine)


@pytest.mark.parametrize("engine", ENGINES)
def test_samples_that_were_not_recorded_may_hold_anything(engine):
    """Images of the same bits whatever lies outside, on either side; a non-finite sample inside is an error that names it."""
    images = [
        pysas.backproject(windowed(moving(), fill=fill), FEW, tol, backend=engine).data
        for tol in (1e-3, 1e-8)
        for fill in (0, np.nan, np.inf, 1e30)
    ]
    assert all(np.array_equal(images[0], image) for image in images[1:4])
    assert all(np.array_equal(images[4], image) for image in images[5:])
    echoes = windowed(moving())
    data = echoes.data.copy()
    data[7, 3, 400] = np.nan  # within any window
    with pytest.raises(ValueError, match="data: non-finite sample at ping 7, channel 3"):
        pysas.backproject(echoes.replace(data=data), FEW, backend=engine)
    with pytest.raises(ValueError, match="ping 7, channel 3, sample 400"):
        answers.exact(echoes.replace(data=data), FEW)


def padded(seed=0):
    """Traces of unequal lengths padded with NaN, one with a hole, one of NaN alone; the same said by `valid` and weights."""
    echoes, rng = moving(), np.random.default_rng(seed)
    ends = np.stack([rng.integers(0, 300, (16, 6)), rng.integers(400, 900, (16, 6))], axis=-1)
    ends[2, 1] = 0, 899
    data = filled(echoes.replace(valid=ends), np.nan).data
    data[5, 2, 350], data[9, 0] = np.inf, np.nan
    weights = np.ones((16, 6))
    weights[5, 2] = weights[9, 0] = 0
    return echoes.replace(data=data), ends, weights


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", [pysas.backproject, pysas.ffbp, pysas.focus])
def test_mask_shortens_traces_and_leaves_out_those_with_holes(method, engine):
    raw, ends, weights = padded()
    made = method(raw, FEW, 1e-4, backend=engine, nan="mask")
    assert made.report.notes[0] == "93 of 96 traces shortened: non-finite samples at their ends"
    assert "2 of 96 traces left out: non-finite samples" in made.report.notes
    whole = raw.replace(data=np.nan_to_num(raw.data, nan=0.0, posinf=0.0, neginf=0.0), valid=ends)
    pixels = np.arange(0, FEW.size, 7)
    exact, level = answers.exact(whole, FEW, pixels, weights)
    assert pysas.metrics.relative_error(made.data.ravel()[pixels], exact, level) <= 1e-4
    with pytest.raises(ValueError, match="data: non-finite sample at ping 0, channel 0"):
        method(raw, FEW, backend=engine)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_plan_is_made_anew_for_data_whose_traces_end_earlier(engine):
    raw, _, weights = padded()
    plan = pysas.plan(
        raw.replace(data=np.zeros(raw.data.shape, complex)), FEW, 1e-4, backend=engine, nan="mask", weights=weights
    )
    made = plan(raw.data)
    right = pysas.focus(raw, FEW, 1e-4, backend=engine, nan="mask", weights=weights)
    assert np.array_equal(made.data, right.data) and made.report.notes == right.report.notes
    good = moving().data
    assert np.array_equal(plan(good).data, pysas.focus(moving(), FEW, 1e-4, backend=engine, weights=weights).data)


def test_windows_of_non_finite_ends():
    traces = np.ones((2, 3, 8), complex)
    windows = np.broadcast_to(np.array([0, 7]), (2, 3, 2))
    found, count = windows_of(traces, windows)
    assert count == 0 and found is windows
    traces[0, 0, :2] = traces[0, 0, 6:] = np.nan  # both ends
    traces[0, 1, 3] = np.inf  # a hole
    traces[0, 2, :3], traces[0, 2, 5] = np.nan, np.nan  # an end and a hole
    traces[1, 0] = np.nan  # all
    traces[1, 1, 7] = complex(0, np.nan)
    found, count = windows_of(traces, windows)
    assert count == 2
    assert found.tolist() == [[[2, 5], [0, 7], [0, 7]], [[0, 7], [0, 6], [0, 7]]]
    assert windows.tolist() == [[[0, 7]] * 3] * 2
    # what was not recorded is not looked at, and windows become no longer
    narrow = np.broadcast_to(np.array([3, 4]), (2, 3, 2))
    assert windows_of(traces[:1], narrow[:1])[0].tolist() == [[[3, 4], [4, 4], [3, 4]]]


def test_windows_of_two_dimensional_data_are_of_pings():
    echoes = survey(np.zeros((3, 3)), np.zeros((3, 1, 3)), 10.0, samples=20)
    data = echoes.data[:, 0].copy()
    data[1, :4] = np.nan
    flat = echoes.replace(data=data, rx=echoes.rx[:, 0])
    found, count = shortened(flat)
    assert count == 1 and found.valid.tolist() == [[0, 19], [4, 19], [0, 19]]


def test_compression_reads_what_was_recorded():
    """Samples outside count as zero; masked ends shorten `valid`, holes stay NaN."""
    pulse, rng = pysas.LFM(1e5, 2e4, 1e-3), np.random.default_rng(3)
    data = rng.standard_normal((3, 2, 200)) + 1j * rng.standard_normal((3, 2, 200))
    raw = pysas.Echoes(data, fs=4e4, fc=1e5, tx=np.zeros((3, 3)), rx=np.zeros((3, 2, 3)), pulse=pulse, compressed=False)
    valid = np.array([[0, 199], [30, 150], [60, 59]])
    for fill in (0, np.nan, np.inf):
        given = filled(raw.replace(valid=valid), fill)
        made = pysas.compress(given)
        assert np.array_equal(made.valid, valid)
        assert np.array_equal(made.data, pysas.compress(filled(raw.replace(valid=valid), 0).replace(valid=None)).data)
    holed = data.copy()
    holed[0, 1, 190:] = holed[1, 0, 100] = holed[1, 1, :40] = np.nan
    with pytest.raises(ValueError, match="ping 0, channel 1, sample 190"):
        pysas.compress(raw.replace(data=holed))
    made = pysas.compress(raw.replace(data=holed), nan="mask")
    assert made.valid.tolist() == [[[0, 199], [0, 189]], [[0, 199], [40, 199]], [[0, 199], [0, 199]]]
    inside = np.isfinite(made.data) | (np.arange(200) > made.valid[..., 1:]) | (np.arange(200) < made.valid[..., :1])
    assert np.argwhere(~inside).tolist() == [[1, 0, 100]]
    both = pysas.compress(raw.replace(data=holed, valid=valid), nan="mask")
    assert both.valid.tolist() == [[[0, 199], [0, 189]], [[30, 150], [40, 150]], [[60, 59], [60, 59]]]


def test_references_take_what_was_not_recorded_for_zeros():
    echoes = straight(32)
    given = windowed(echoes.replace(beam=None), channels=False)
    zeros = filled(given, 0).replace(valid=None)
    assert given.whole().valid is None and np.array_equal(given.whole().data, zeros.data) and echoes.whole() is echoes
    methods = [
        lambda e: pysas.reference.omega_k(e),
        lambda e: pysas.reference.range_doppler(e),
        lambda e: pysas.reference.fourier_image(e, pysas.Grid.plane([0.0, 0.05], [20.0, 20.05])),
    ]
    for method in methods:
        assert np.array_equal(method(given).data, method(zeros).data)
    kept = pysas.reference.motion_compensate(given, seabed=-5.0)
    assert kept.valid is None and np.array_equal(kept.data, pysas.reference.motion_compensate(zeros, seabed=-5.0).data)


def test_checks_and_explanations_are_of_what_was_recorded():
    echoes = windowed(straight(32), channels=False)
    states = {finding.name: finding.state for finding in inspect(echoes)}
    assert states["finite samples"] == "ok" and states["silent traces"] == "warn"  # one holds nothing
    share = np.mean(echoes.valid[:, 1] - echoes.valid[:, 0] + 1) / 900
    assert f"{100 * (1 - share):.3g} % of the samples: not recorded" in pysas.plan(echoes, FEW).explain()
    assert "not recorded" not in pysas.plan(straight(32), FEW).explain()


def test_the_plain_sum_of_circular_crops():
    """By sinc of the whole trace: with soft ends of windows it has nothing else to read than the oracle."""
    echoes = moving(4)
    rise = np.clip(np.minimum(np.arange(900) - 200, 700 - np.arange(900)) / 60, 0, 1)
    soft = echoes.replace(data=echoes.data * np.sin(np.pi / 2 * rise) ** 2, valid=np.tile([200, 700], (4, 1)))
    ones = np.ones((FEW.size, 4, 6))
    found = pysas.circular.weighted_sum(filled(soft, np.nan), FEW, ones)
    exact, level = answers.exact(soft, FEW)
    assert pysas.metrics.relative_error(found, exact, level) < 1e-5


BAD = {
    "dtype": (np.zeros((16, 2)), TypeError, "valid: expected whole numbers, found dtype float64"),
    "shape": (np.zeros((16, 5, 2), int), ValueError, r"valid: expected shape \(16, 2\) or \(16, 6, 2\), found \(16, 5, 2\)"),
    "before": (np.array([[0, 9]] * 15 + [[-1, 9]]), ValueError, "valid: samples -1 to 9 at ping 15: expected 0 <= first"),
    "behind": (np.array([[0, 9]] * 3 + [[0, 900]] * 13), ValueError, "samples 0 to 900 at ping 3: .* <= last <= 899"),
    "order": (np.array([[[0, 9]] * 5 + [[9, 7]]] * 16), ValueError, "samples 9 to 7 at ping 0, channel 5: .*last = first - 1"),
    "unsigned": (np.full((16, 2), 2**64 - 1, np.uint64), ValueError, "at ping 0: expected 0 <= first"),
    "masked": (np.ma.masked_equal(np.zeros((16, 2), int), 0), TypeError, "valid: masked entries"),
}


@pytest.mark.parametrize("name", BAD)
def test_windows_that_cannot_be(name):
    value, kind, message = BAD[name]
    with pytest.raises(kind, match=message):
        moving().replace(valid=value)


def test_echoes_keep_a_copy_of_their_windows_and_print_them():
    given = np.tile([0, 449], (16, 1)).astype(np.uint16)
    echoes = moving().replace(valid=given)
    given[:] = 0
    assert echoes.valid.dtype == np.int64 and not echoes.valid.flags.writeable and echoes.valid.max() == 449
    assert echoes.windows.shape == (16, 6, 2) and "valid      50 % of the samples were recorded" in repr(echoes)
    assert moving().valid is None and moving().windows.tolist() == [[[0, 899]] * 6] * 16


@pytest.mark.parametrize("engine", ENGINES)
def test_masked_pixels_within_a_window_are_no_terms(engine):
    """Kernels count whole lines, masked pixels among them; whoever asked hears that nothing he wanted was recorded."""
    echoes = straight(20, samples=700)
    middle = (echoes.start_time[0] + 200 / echoes.fs) * C / 2  # where windows end
    y = np.arange(middle - 2.0, middle + 2.0, 0.05)
    grid = pysas.Grid.points(
        np.stack([np.zeros((3, y.size)) + [[0.0], [0.05], [0.1]], np.tile(y, (3, 1)), np.zeros((3, y.size))], -1)
    )
    far = np.linalg.norm(grid.coordinates(), axis=1).reshape(grid.shape) > middle + 1.0
    grid = pysas.Grid.points(grid.coords, mask=far)
    short = echoes.replace(valid=np.tile([0, 200], (20, 1)))
    with pytest.warns(UserWarning, match="no pixel lies within the recorded window"):
        image = pysas.backproject(short, grid, 1e-3, backend=engine)
    assert not image.data.any() and image.report.terms == 0
