"""A sound speed a ping: engines against the oracle, that against single pings, the simulator against both, and who says no.

A ping's echoes know its own c alone, so that the sum over pings of images of one ping each, of one speed, is the answer.
"""

import dataclasses
import re

import answers
import numpy as np
import pytest
from scenes import PLANE, C, far, moving, ring, straight

import pysas
from pysas.planning import framing

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
FEW = pysas.Grid.plane(np.arange(-20, 21) * 0.05, 19.0 + np.arange(20) * 0.06)
X, Y = PLANE.axes["x"], PLANE.axes["y"]
BEAM = pysas.Beam([0, 1, -0.25], 0.05, 0.03, taper=0.5)


def varied(echoes, spread, seed=0):
    """Speeds within `spread` (a share) of C."""
    return echoes.replace(c=C * (1 + spread * np.random.default_rng(seed).uniform(-1, 1, echoes.n_ping)))


SCENES = {
    "straight": (straight, PLANE),
    "six moving receivers": (moving, PLANE),
    "six moving receivers in a beam": (lambda: moving(beam=BEAM), PLANE),
    "circular": (lambda: ring(40), pysas.Grid.plane(np.arange(-30, 31) * 0.02, np.arange(-30, 31) * 0.02)),
    "surface": (moving, pysas.Grid.surface(X, Y, 0.3 * np.sin(X / 0.4) * np.cos(Y[:, None] / 0.5))),
    "record's edges": (lambda: straight(32), pysas.Grid.plane(X[::8], 17.0 + np.arange(90) * 0.2)),
    "points": (lambda: moving(8), pysas.Grid.points(FEW.coordinates())),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("spread", [0.005, 0.03])
@pytest.mark.parametrize("name", SCENES)
def test_speeds_of_pings_keep_tol(name, spread, engine):
    make, grid = SCENES[name]
    echoes = varied(make(), spread)
    few = echoes[:4] if engine == "numba" else echoes  # its tables for 1e-10 take 30 ms a trace
    pixels = np.random.default_rng(1).choice(grid.size, 120, replace=False)
    for dtype, tolerances, some in (
        (np.complex64, (1e-1, 1e-3, 1e-5), echoes),
        (np.complex128, (1e-4, 1e-7), echoes),
        (np.complex128, (1e-10,), few),
    ):
        exact, level = answers.exact(some, grid, pixels)
        given = some.replace(data=some.data.astype(dtype))
        for tol in tolerances:
            image = pysas.backproject(given, grid, tol, backend=engine)
            assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= tol, (dtype, tol)
            assert image.c == np.mean(some.c)


@pytest.mark.parametrize("engine", ENGINES)
def test_far_ranges_keep_tol(engine):
    """1 km, where 1 % is 10 m of a record of 17 m: some of the pings hear a pixel."""
    echoes = varied(far(16), 0.01)
    grid = pysas.Grid.plane(np.arange(-10, 11) * 0.02, 993.0 + np.arange(30) * 0.02)
    exact, level = pysas.reference.exact(echoes, grid)
    for tol in (1e-3, 1e-5):
        image = pysas.backproject(echoes, grid, tol, backend=engine)
        assert 0 < image.report.terms < 16 * grid.size
        assert pysas.metrics.relative_error(image.data, exact, level) <= tol


@pytest.mark.parametrize("engine", ENGINES)
def test_ffbp_and_focus_keep_tol(engine):
    """Trees of the Numba engine want one speed: all is summed directly there, and said."""
    echoes = varied(straight(192, samples=1400), 0.005)
    echoes = echoes.replace(data=echoes.data.astype(np.complex64))
    grid = pysas.Grid.plane(np.arange(-60, 61) * 0.02, 24.0 + np.arange(120) * 0.02)
    pixels = np.random.default_rng(1).choice(grid.size, 150, replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    for method in (pysas.ffbp, pysas.focus):
        image = method(echoes, grid, 1e-3, backend=engine)
        assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= 1e-3
    if engine == "numba":
        image = pysas.ffbp(echoes, grid, 1e-3, backend=engine)
        assert image.report.factorised_share == 0
        assert "summed directly: pings of different sound speeds" in image.report.notes
        with pytest.raises(
            ValueError, match="expected all terms to go through the tree, found: pings of different sound speeds"
        ):
            pysas.ffbp(echoes, grid, 1e-3, False, backend=engine)


def test_the_oracle_knows_each_pings_speed():
    echoes = varied(moving(6), 0.03)
    total, power = np.zeros(FEW.shape, dtype=complex), np.zeros(FEW.shape)
    for ping, c in enumerate(echoes.c):
        only = slice(ping, ping + 1)
        one = moving(6).replace(
            data=echoes.data[only], tx=echoes.tx[only], rx=echoes.rx[only], velocity=echoes.velocity[only], c=float(c)
        )
        image, level = pysas.reference.exact(one, FEW)
        total, power = total + image, power + level**2
    exact, level = pysas.reference.exact(echoes, FEW)
    assert np.linalg.norm(exact - total) < 1e-14 * np.linalg.norm(exact)
    assert np.linalg.norm(level - np.sqrt(power)) < 1e-14 * np.linalg.norm(level)


def test_plans_take_the_least_speed_for_wave_numbers():
    """Which bounds those of all pings from above; traces have their own."""
    echoes = varied(moving(), 0.03)
    scene = pysas.plan(echoes, FEW, backend="numba").scene
    assert scene.c == np.min(echoes.c) and scene.mean_speed == np.mean(echoes.c) and not scene.one_speed
    assert np.array_equal(scene.trace["c"], np.repeat(echoes.c, 6))


@pytest.mark.parametrize("engine", ENGINES)
def test_equal_speeds_are_one_speed(engine):
    echoes = moving()
    for tol in (1e-3, 1e-8):
        images = [pysas.focus(e, FEW, tol, backend=engine).data for e in (echoes, echoes.replace(c=np.full(16, C)))]
        assert np.array_equal(*images)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_simulated_point_has_its_peak_and_its_phase(engine):
    """c tau = |x - tx| + |x - rx - v tau| of each ping, simulated and imaged; by the mean speed it is lost."""
    pings, point = 24, np.array([0.1, 20.0, 0.0])
    track = pysas.tracks.straight(pings, 0.05, height=5.0, start=(-0.6, 0.0, 0.0)).position
    c = C + 15 * np.random.default_rng(7).uniform(-1, 1, pings)
    raw = pysas.simulate(
        [point], [1.0], pysas.LFM(100e3, 10e3, 4e-3, "tukey", 0.5), tx=track, rx=track[:, None] + [0.1, 0.0, 0.0], fs=40e3,
        duration=0.01, c=c, t0=0.024, velocity=np.tile([2.0, 0.1, 0.0], (pings, 1)), dtype=np.complex128,
    )  # fmt: skip
    assert np.array_equal(raw.c, c)
    echoes = pysas.compress(raw)
    assert np.array_equal(echoes.c, c)
    spot = pysas.Grid.points([point])
    peak = pysas.backproject(echoes, spot, 1e-6, backend=engine).data[0]
    assert abs(peak - pings) < 0.02 * pings  # a rect-spectrum pulse's peak lies between samples
    lost = pysas.backproject(echoes.replace(c=C), spot, 1e-6, backend=engine).data[0]
    assert abs(lost) < 0.5 * pings
    matched = pysas.reference.correlation(raw.replace(velocity=None), spot)
    assert matched.c == np.mean(c) and abs(matched.data[0]) > 0.8 * pings  # stop-and-hop: a drift of 2 v tau f/c


def test_the_plain_sum_of_circular_knows_each_pings_speed():
    echoes = varied(moving(4), 0.02)
    ends = np.clip(np.minimum(np.arange(900), np.arange(900)[::-1]) / 60, 0, 1)
    soft = echoes.replace(data=echoes.data * np.sin(np.pi / 2 * ends) ** 2)
    found = pysas.circular.weighted_sum(soft, FEW, np.ones((FEW.size, 4, 6)))
    assert pysas.metrics.relative_error(found, *pysas.reference.exact(soft, FEW)) < 1e-5


ONE_SPEED = {
    "omega_k": lambda e: pysas.reference.omega_k(e),
    "range_doppler": lambda e: pysas.reference.range_doppler(e),
    "chirp_scaling": lambda e: pysas.reference.chirp_scaling(e.replace(compressed=False, pulse=pysas.LFM(100e3, 3e4, 2e-3))),
    "one_way": lambda e: pysas.reference.one_way(e),
    "fourier_image": lambda e: pysas.reference.fourier_image(e, FEW),
    "motion_compensate": lambda e: pysas.reference.motion_compensate(e, seabed=-5.0),
    "phase_centres": lambda e: pysas.reference.phase_centres(e),
}


@pytest.mark.parametrize("name", ONE_SPEED)
def test_algorithms_of_one_speed_say_so(name):
    echoes = straight(16)
    echoes = echoes.replace(c=np.where(np.arange(16) < 5, 1500.0, 1501.0))
    message = (
        "c=1501 m/s at ping 5, 1500 m/s at ping 0: expected one speed of all pings: pysas.backproject, ffbp and focus take"
    )
    with pytest.raises(ValueError, match=re.escape(message)):
        ONE_SPEED[name](echoes)


def test_equal_speeds_suit_algorithms_of_one_speed():
    echoes = straight(32)
    images = [pysas.reference.omega_k(e).data for e in (echoes, echoes.replace(c=np.full(32, C)))]
    assert np.array_equal(*images)


def test_what_echoes_say_of_their_speeds():
    echoes = straight(4).replace(c=[1450.0, 1500.0, 1550.0, 1500.0])
    assert isinstance(straight(4).c, float) and straight(4).speed == straight(4).mean_speed == C
    assert echoes.speeds.tolist() == [1450.0, 1500.0, 1550.0, 1500.0] and echoes.mean_speed == 1500.0
    assert not echoes.c.flags.writeable and "c 1450 to 1550 m/s" in repr(echoes)
    start, last = float(echoes.t0), float(echoes.t0) + 899 / 40e3
    assert echoes.swath == (1450 / 2 * start, 1550 / 2 * last)
    assert echoes.range_resolution == straight(4).range_resolution
    assert framing.default_grid(echoes, 0.0)[0].shape == framing.default_grid(straight(4), 0.0)[0].shape
    assert "omega-k" not in pysas.plan(echoes, FEW).explain() and "omega-k" in pysas.plan(straight(4), FEW).explain()


BAD = {
    "shape": (np.full(15, C), ValueError, r"c: expected shape \(16,\), found \(15,\)"),
    "not finite": (np.r_[np.full(3, C), np.nan, np.full(12, C)], ValueError, "c: nan at ping 3: expected finite values"),
    "zero": (np.r_[np.full(9, C), 0.0, np.full(6, C)], ValueError, "c: 0 at ping 9: expected numbers > 0"),
    "number": (-1.0, ValueError, "c=-1.0: expected a finite number > 0"),
    "complex": (np.full(16, C + 0j), TypeError, "c: expected real numbers, found dtype complex128"),
    "slow": (np.r_[np.full(15, C), 30.0], ValueError, "velocity: .* m/s: expected below a tenth of the sound speed, 3 m/s"),
}


@pytest.mark.parametrize("name", BAD)
def test_speeds_that_cannot_be(name):
    value, kind, message = BAD[name]
    fast = dataclasses.replace(moving(), velocity=np.tile([5.0, 0.0, 0.0], (16, 1)))
    with pytest.raises(kind, match=message):
        fast.replace(c=value)
    if name not in ("number", "slow"):
        with pytest.raises(kind, match=message):
            tx = np.zeros((16, 3))
            pysas.simulate([[0, 9, 0]], [1], pysas.LFM(1e5, 2e4, 1e-3), tx=tx, rx=tx, fs=4e4, duration=0.02, c=value)
