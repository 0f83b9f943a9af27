"""Images of several Echoes are summed: each keeps tol, the sum keeps tol, and one report tells of all."""

import answers
import numpy as np
import pytest
from scenes import C, moving, ring, straight

import pysas

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
GRID = pysas.Grid.plane(np.arange(-20, 21) * 0.05, 19.0 + np.arange(20) * 0.06)
METHODS = (pysas.backproject, pysas.ffbp, pysas.focus)


def bands():
    """Two bands, two arrays, two tracks; one with a speed a ping, the other with windows a trace."""
    rng = np.random.default_rng(2)
    low = moving(seed=1).replace(c=C * (1 + 0.005 * rng.uniform(-1, 1, 16)))
    high = straight(40, fs=60e3, fc=180e3, bandwidth=50e3, samples=1200, seed=2)
    return [low, high.replace(valid=np.stack([rng.integers(0, 60, 40), rng.integers(400, 1200, 40)], axis=1))]


def exact(parts, weights=(None, None), grid=GRID):
    found = [answers.exact(part, grid, weights=one) for part, one in zip(parts, weights, strict=True)]
    return sum(image for image, _ in found), np.sqrt(sum(level**2 for _, level in found))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sum_keeps_tol(engine):
    parts = bands()
    right = exact(parts)
    for dtype, tolerances in ((np.complex64, (1e-2, 1e-5)), (np.complex128, (1e-3, 1e-8))):
        given = [part.replace(data=part.data.astype(dtype)) for part in parts]
        for tol in tolerances:
            image = pysas.backproject(given, GRID, tol, backend=engine)
            assert image.data.dtype == dtype and pysas.metrics.relative_error(image.data, *right) <= tol


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
def test_a_sum_is_the_sum_under_one_report(method, engine):
    parts, weights = bands(), [np.linspace(0.5, 1, 16), None]
    ones = [method(part, GRID, 1e-4, backend=engine, weights=w) for part, w in zip(parts, weights, strict=True)]
    shares: list[float] = []
    out = np.full(GRID.shape, 9.0 + 0j)
    image = method(parts, GRID, 1e-4, backend=engine, weights=weights, out=out, progress=shares.append)
    assert image.data is out and np.array_equal(out, ones[0].data + ones[1].data)
    assert pysas.metrics.relative_error(out, *exact(parts, weights)) <= 1e-4
    assert shares == sorted(shares) and 0 <= shares[0] and shares[-1] == 1 and any(0.4 < share <= 0.5 for share in shares)
    report, both = image.report, [one.report for one in ones]
    assert report.terms == both[0].terms + both[1].terms and report.tol == 1e-4 and report.backend == engine
    assert report.method == " + ".join(dict.fromkeys(one.method for one in both))
    assert report.predicted_error == max(one.predicted_error for one in both) <= 1e-4
    assert report.choices == {"echoes 0": both[0].choices, "echoes 1": both[1].choices}
    assert report.notes == tuple(f"echoes {k}: {note}" for k in (0, 1) for note in both[k].notes)
    left = (96 * both[0].share_left_out + 40 * both[1].share_left_out) / 136
    assert report.share_left_out == pytest.approx(left, abs=1e-12)
    assert image.fc == pytest.approx((96 * 100e3 + 40 * 180e3) / 136)
    assert image.c == pytest.approx((96 * np.mean(parts[0].c) + 40 * C) / 136)
    assert pysas.Report.from_dict(report.as_dict()) == report


@pytest.mark.parametrize("engine", ENGINES)
def test_two_halves_are_the_whole(engine):
    """What adds up in phase, a point's echoes, keeps tol of the sum's own norm."""
    whole = ring(60)
    t = whole.start_time[:, None] + np.arange(600) / whole.fs
    tau = 2 * np.linalg.norm(np.array([0.1, 0.2, 0.0]) - whole.tx, axis=1)[:, None] / C
    pulse = np.sinc(whole.bandwidth * (t - tau)) * np.exp(-2j * np.pi * whole.fc * tau)
    whole = whole.replace(data=pulse[:, None])
    parts = [whole.replace(data=whole.data[some], tx=whole.tx[some], rx=whole.rx[some]) for some in (slice(25), slice(25, 60))]
    grid = pysas.Grid.plane(np.arange(-15, 16) * 0.02, np.arange(-15, 16) * 0.02)
    right = answers.exact(whole, grid)
    assert np.linalg.norm(right[0]) > 1.5 * np.linalg.norm(right[1])
    for tol in (1e-3, 1e-6):
        for given in (parts, tuple(parts), [whole]):
            image = pysas.focus(given, grid, tol, backend=engine)
            assert pysas.metrics.relative_error(image.data, *right) <= tol
    assert np.array_equal(pysas.focus([whole], grid, backend=engine).data, pysas.focus(whole, grid, backend=engine).data)


@pytest.mark.parametrize("engine", ENGINES)
def test_masked_and_silent_parts_are_told_by_number(engine):
    parts = bands()
    data = parts[1].data.copy()
    data[4, 0, 300] = np.nan
    data[5, 0, :100] = np.nan
    parts[1] = parts[1].replace(data=data)
    image = pysas.backproject(parts, GRID, backend=engine, nan="mask")
    notes = [
        "echoes 1: 1 of 40 traces shortened: non-finite samples at their ends",
        "echoes 1: 1 of 40 traces left out: non-finite samples",
    ]
    assert all(note in image.report.notes for note in notes)
    with pytest.raises(ValueError, match="data: non-finite sample at ping 4, channel 0") as caught:
        pysas.backproject(parts, GRID, backend=engine)
    assert caught.value.__notes__ == ["echoes 1 of 2, counted from 0"]
    far = parts[0].replace(t0=1.0)
    with pytest.warns(UserWarning, match="outside the recorded window") as warned:
        image = pysas.focus([parts[0], far], GRID, backend=engine)
    assert [warning.filename for warning in warned] == [__file__]
    assert image.report.terms > 0 and any(note.startswith("echoes 1: the grid lies outside") for note in image.report.notes)
    assert np.array_equal(image.data, pysas.focus(parts[0], GRID, backend=engine).data)


BAD = {
    "none": (lambda a, b: {"echoes": []}, ValueError, "echoes: found none in the sequence: expected at least one"),
    "an array": (lambda a, b: {"echoes": [a, b.data]}, TypeError, r"echoes\[1\]=ndarray: expected pysas.Echoes"),
    "dtypes": (
        lambda a, b: {"echoes": [a, b.replace(data=b.data.astype("c8"))]}, TypeError,
        r"echoes\[1\]: complex64 after complex128: expected one dtype",
    ),
    "raw": (lambda a, b: {"echoes": [a, b.replace(compressed=False)]}, ValueError, r"raw \(compressed=False\)"),
    "weights for one": (
        lambda a, b: {"echoes": [a, b], "weights": np.ones(16)}, ValueError, "weights: found ndarray: expected None, or a list",
    ),
    "three weights": (
        lambda a, b: {"echoes": [a, b], "weights": [None] * 3}, ValueError, "weights: found 3: expected None, or a list of 2",
    ),
    "weights of the other": (
        lambda a, b: {"echoes": [a, b], "weights": [None, np.ones(16)]}, ValueError, r"weights: expected shape \(40,\)",
    ),
    "out": (lambda a, b: {"echoes": [a, b], "out": np.zeros(GRID.shape, "c8")}, TypeError, "out: expected .* complex128"),
    "a generator": (lambda a, b: {"echoes": iter([a, b])}, TypeError, "echoes=list_iterator: expected pysas.Echoes"),
}  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_summed(name, method):
    make, kind, message = BAD[name]
    with pytest.raises(kind, match=message):
        method(grid=GRID, backend="numba", **make(*bands()))


def test_out_may_not_share_memory_with_any_of_them():
    parts = bands()
    other = straight(41, samples=20)
    out = other.data.reshape(-1)[: GRID.size].reshape(GRID.shape)
    with pytest.raises(ValueError, match="out: shares memory with data"):
        pysas.backproject([parts[0], other], GRID, out=out)


def test_a_plan_is_of_one():
    with pytest.raises(TypeError, match="echoes=list: expected pysas.Echoes"):
        pysas.plan(bands(), GRID)
