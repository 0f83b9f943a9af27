"""What single traces contribute to rows of points, held against the oracle's sum of those traces alone.

The oracle knows no rows: it images each row's points from a copy of the echoes in which all other traces are gone.
"""

import answers
import numpy as np
import pytest
from scenes import moving, ring, straight

import pysas
from pysas.imaging.contributions import along_lines, contributions

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
BEAM = pysas.Beam([0, 1, -0.25], 0.05, 0.03, taper=0.5)
SCENES = {
    "straight": lambda: straight(9),
    "six moving receivers": lambda: moving(6),
    "in a beam": lambda: moving(6, beam=BEAM),
    "six of them, some recorded less": lambda: windowed(moving(6)),
    "circular": lambda: ring(9),
}


def windowed(echoes):
    last = echoes.n_sample - 1 - 40 * np.arange(echoes.n_ping)
    return echoes.replace(valid=np.stack([np.full_like(last, 30), last], axis=1))


def rows_of(echoes, seed=0, count=30):
    """Rows away from each ping's middle, and which traces they hear: one, a ping's, some across two pings; not in order."""
    rng = np.random.default_rng(seed)
    channels, traces = echoes.n_channel, echoes.n_ping * echoes.n_channel
    ping = rng.permutation(np.repeat(np.arange(echoes.n_ping), 2))
    first = ping * channels + rng.integers(0, channels, ping.size)
    last = np.minimum(first + rng.integers(0, channels + 2, ping.size), traces - 1)
    start = echoes.tx[ping] * [1, 0, 0] + np.stack(
        [rng.uniform(-0.3, 0.3, ping.size), rng.uniform(17, 22, ping.size), 0 * ping], 1
    )
    step = rng.uniform(-0.03, 0.03, (ping.size, 3)) + [0, 0.01, 0]
    return start, step, count, np.stack([first, last], axis=1)


def expected(echoes, points, traces):
    """(row, n) and its level, by the oracle, and the terms' level in all."""
    out, level = [], []
    for place, (first, last) in zip(points, traces, strict=True):
        heard = np.zeros(echoes.traces.shape[:2])
        heard.reshape(-1)[first : last + 1] = 1
        some = echoes.replace(data=(echoes.traces * heard[..., None]).reshape(echoes.data.shape))
        found, own = answers.exact(some, pysas.Grid.points(place))
        out.append(found)
        level.append(own)
    return np.array(out), np.array(level)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", SCENES)
def test_rows_keep_tol(name, engine):
    echoes = SCENES[name]()
    first, step, count, traces = rows_of(echoes)
    points = first[:, None] + np.arange(count)[:, None] * step[:, None]
    exact, level = expected(echoes, points, traces)
    norm = np.linalg.norm(level)
    assert norm > 0
    for dtype, tolerances in ((np.complex64, (1e-1, 1e-3, 1e-5)), (np.complex128, (1e-4, 1e-8))):
        given = echoes.replace(data=echoes.data.astype(dtype))
        for tol in tolerances:
            for found in (
                contributions(given, points, traces, tol=tol, backend=engine),
                along_lines(given, first, step, count, traces, tol=tol, backend=engine),
            ):
                assert found.dtype == dtype and found.shape == exact.shape
                assert np.linalg.norm(found - exact) <= tol * max(norm, np.linalg.norm(exact)), (dtype, tol)


@pytest.mark.parametrize("engine", ENGINES)
def test_pings_sum_to_the_image(engine):
    """What each ping contributes to a patch, summed, is the patch: linearity."""
    echoes = moving(12, beam=BEAM)
    grid = pysas.Grid.plane(np.arange(20) * 0.02 - 0.2, 19 + np.arange(7) * 0.03)
    lines = grid.coordinates().reshape(7, 20, 3)
    first, step = np.tile(lines[:, 0], (12, 1)), np.tile(lines[:, 1] - lines[:, 0], (12, 1))
    channels = echoes.n_channel
    traces = np.repeat(np.arange(12)[:, None] * channels + [0, channels - 1], 7, axis=0)
    parts = along_lines(echoes, first, step, 20, traces, tol=1e-4, backend=engine).reshape(12, 7, 20)
    image = pysas.backproject(echoes, grid, 1e-4, backend=engine)
    _, level = answers.exact(echoes, grid)
    assert pysas.metrics.relative_error(parts.sum(axis=0), image, level) <= 2e-4
    assert np.count_nonzero(np.abs(parts).sum(axis=(1, 2))) > 1


@pytest.mark.parametrize("engine", ENGINES)
def test_threads_change_no_bit(engine):
    echoes = moving(7)
    first, step, count, traces = rows_of(echoes, 3)
    one, two, three = (along_lines(echoes, first, step, count, traces, threads=n, backend=engine) for n in (1, 2, 3))
    assert np.array_equal(one, two) and np.array_equal(one, three)


@pytest.mark.parametrize("engine", ENGINES)
def test_traces_that_no_row_hears_count_for_nothing(engine):
    """However bright: the rest is the same to the last digit of its type's rounding."""
    echoes = moving(6)
    first, step, count, _ = rows_of(echoes)
    traces = np.full((len(first), 2), 5)
    found = along_lines(echoes, first, step, count, traces, backend=engine)
    loud = echoes.traces.copy()
    loud.reshape(-1, echoes.n_sample)[[0, 4, 6, 20]] *= 1e6
    louder = along_lines(echoes.replace(data=loud.reshape(echoes.data.shape)), first, step, count, traces, backend=engine)
    assert np.array_equal(found, louder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"traces": np.zeros((3, 2))}, r"traces: expected whole numbers \(4, 2\), found float64 \(3, 2\)"),
        ({"traces": np.array([[0, 1], [0, 36], [0, 1], [0, 1]])}, r"traces: \[0, 36\] of row 1: expected first <= last of 36"),
        ({"traces": np.array([[0, 1], [3, 2], [0, 1], [0, 1]])}, r"traces: \[3, 2\] of row 1"),
        ({"points": np.zeros((4, 3))}, r"points: expected shape \(row, n, 3\), found \(4, 3\)"),
        ({"points": np.full((4, 2, 3), np.nan)}, "points: nan"),
        ({"tol": 0.5}, "tol=0.5: expected at most 0.1"),
    ],
)
def test_what_does_not_go_together_is_named(change, message):
    arguments = {"points": np.ones((4, 2, 3)), "traces": np.zeros((4, 2), dtype=int), "tol": 1e-3} | change
    with pytest.raises(ValueError, match=message):
        contributions(moving(6), **arguments)


def test_lines_are_checked():
    echoes = moving(6)
    with pytest.raises(ValueError, match="first, step"):
        along_lines(echoes, np.zeros((2, 3)), np.zeros((1, 3)), 3, np.zeros((2, 2), dtype=int))
    with pytest.raises(ValueError, match="count"):
        along_lines(echoes, np.zeros((2, 3)), np.zeros((2, 3)), 0, np.zeros((2, 2), dtype=int))
    with pytest.raises(ValueError, match="data: non-finite sample at ping 0"):
        bad = echoes.data.copy()
        bad[0] = np.nan
        along_lines(echoes.replace(data=bad), np.zeros((2, 3)) + 20, np.ones((2, 3)), 3, np.zeros((2, 2), dtype=int))
