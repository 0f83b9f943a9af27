"""Pixels on the edges of what counts: a record's ends and a beam's half-angle, where rounding must not decide.

The rule is in `reference.exact`: edges lie EDGE samples and EDGE_ANGLE outside of where they are put. Places are made on the
edge by mathematics, at coordinates where float64 rounds them to either side, and beside it by less and more than the slack.
"""

import numpy as np
import pytest
from scenes import C, noise

import pysas
from pysas.engine import native
from pysas.model.beam import EDGE_ANGLE
from pysas.model.echoes import EDGE
from pysas.reference import direct

ENGINES = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
KINDS = ["monostatic", "bistatic", "moving"]
MAP = np.array([5e5, 5e6, 0.0])  # an UTM corner


def error(image, echoes, grid):
    """Relative to what `tol` is relative to."""
    exact, level = pysas.reference.exact(echoes, grid)
    return np.linalg.norm(image - exact) / max(np.linalg.norm(exact), np.linalg.norm(level), 1e-300)


def test_oracle_and_model_state_one_rule():
    assert (direct.EDGE, direct.EDGE_ANGLE) == (EDGE, EDGE_ANGLE) == (1e-4, 1e-7)


def record(kind, origin, fs, samples, start, seed):
    """One trace about `origin`, its sensors 3 m apart but for "monostatic"; heard from `start` on (s)."""
    rng = np.random.default_rng(seed)
    tx = origin + rng.uniform(-1, 1, (1, 3))
    rx = tx[:, None] + (0 if kind == "monostatic" else np.array([3.0, 0, 0]))
    data = noise(1, 1, samples, 0.6, seed).astype(np.complex64)
    more = {"velocity": np.array([[2.0, -1.0, 0.5]])} if kind == "moving" else {}
    return pysas.Echoes(data, fs=fs, fc=1e5, tx=tx, rx=rx, c=C, t0=start, bandwidth=0.6 * fs, **more)


def delayed(echoes, direction, tau):
    """The pixel in a direction from the transmitter whose travel time is `tau`, by bisection in long double."""
    tx, rx = (p.astype(np.longdouble) for p in (echoes.tx[0], echoes.receivers[0, 0]))
    v = np.zeros(3) if echoes.receiver_velocity is None else echoes.receiver_velocity[0, 0]
    tau, low, high = np.longdouble(tau), np.longdouble(0), C * np.longdouble(tau)
    for _ in range(80):
        middle = (low + high) / 2
        late = middle + np.linalg.norm(tx + middle * direction - rx - v * tau) > C * tau
        low, high = (low, middle) if late else (middle, high)
    return (tx + low * direction).astype(np.float64)


def assert_counted(echoes, grid, counts, backend):
    """Oracle and engine sum the terms of the pixels that count, and of no others."""
    exact, level = pysas.reference.exact(echoes, grid)
    np.testing.assert_array_equal(level > 0, counts)
    image = pysas.backproject(echoes, grid, 1e-3, backend=backend)
    np.testing.assert_array_equal(image.data != 0, counts)
    assert image.report.terms == sum(counts)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fs", [40e3, 1e6])
def test_places_on_a_records_ends_count(backend, kind, fs):
    """Exactly there, an ulp and half the slack beyond; twice the slack beyond does not. UTM coordinates included."""
    rng = np.random.default_rng(5)
    for seed in range(6):
        origin, samples = MAP * (seed % 2), int(rng.integers(20, 300))
        echoes = record(kind, origin, fs, samples, rng.uniform(0.005, 0.05), seed)
        points, counts = [], []
        for end, beyond in ((0, -1), (samples - 1, 1)):
            for off in (0.0, 0.5 * EDGE, -0.5 * EDGE, 2 * EDGE, -2 * EDGE):
                direction = rng.standard_normal(3)
                tau = echoes.start_time[0] + (end + beyond * off) / np.longdouble(fs)
                place = delayed(echoes, direction / np.linalg.norm(direction), tau)
                points += [place, np.nextafter(place, 1e9), np.nextafter(place, -1e9)]
                counts += [off < EDGE] * 3
        grid = pysas.Grid.points(points)
        assert_counted(echoes, grid, counts, backend)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("start, row", [(0.04, 30.0), (0.02, 15.0), (2 * 30 / C, 30.0)])
def test_a_grid_that_begins_and_ends_with_the_record(backend, start, row):
    """Pixels abeam of a ping lie on its first sample, those of the last row on its last."""
    samples, fs = 400, 40e3
    tx = np.stack([(np.arange(24) - 12) * 0.02, np.zeros(24), np.zeros(24)], axis=1)
    data = noise(24, 1, samples, 0.75).astype(np.complex64)
    echoes = pysas.Echoes(data, fs=fs, fc=1e5, tx=tx, rx=tx[:, None], c=C, t0=start, bandwidth=30e3)
    last = row + C * (samples - 1) / fs / 2
    grid = pysas.Grid.plane(np.arange(-24, 24) * 0.01, np.linspace(row, last, 12))
    image = pysas.backproject(echoes, grid, 1e-3, backend=backend)
    assert error(image.data, echoes, grid) < 1e-3


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("half", [np.pi / 2, np.pi / 4, 2.0, np.pi - 1e-8, np.pi, 1e-3, 1e-5, 1e-7, 1e-9])
def test_places_on_a_cones_edge_count(backend, half):
    rng = np.random.default_rng(6)
    for seed in range(6):
        origin = MAP * (seed % 2)
        echoes = record("monostatic", origin, 40e3, 400, 0.0, seed)
        bore = rng.standard_normal(3)
        bore /= np.linalg.norm(bore)
        echoes = echoes.replace(beam=pysas.Beam(bore * rng.uniform(0.1, 10), 0.1, half, "cone"))
        points, counts = [], []
        for off in OFF:
            aside = np.cross(bore, rng.standard_normal(3))
            aside /= np.linalg.norm(aside)
            angle, distance = max(half + off, 0.0), rng.uniform(2.0, 5.0)
            points.append(echoes.tx[0] + distance * (np.cos(angle) * bore + np.sin(angle) * aside))
            counts.append(off < EDGE_ANGLE or half + EDGE_ANGLE >= np.pi)
        grid = pysas.Grid.points(points)
        assert_counted(echoes, grid, counts, backend)


def frames(rng):
    """Boresight and axis of a fan, the latter in a random direction, and two unit vectors across it."""
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    across = np.cross(axis, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    turn = rng.uniform(-1, 1)
    return np.cos(turn) * across + np.sin(turn) * axis, axis, across, np.cross(axis, across)


OFF = (0.0, 0.5 * EDGE_ANGLE, -0.5 * EDGE_ANGLE, 2 * EDGE_ANGLE, -2 * EDGE_ANGLE)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("half", [np.pi / 2, np.pi / 2 - 1e-8, np.pi / 4, 1.5, 1e-3, 1e-5, 1e-7, 1e-9])
def test_places_on_a_fans_edge_count(backend, half):
    """On both sides of its middle, at any depression, with an axis at any angle to boresight; and on the end of its side."""
    rng = np.random.default_rng(8)
    for seed in range(6):
        origin = MAP * (seed % 2)
        echoes = record("monostatic", origin, 40e3, 400, 0.0, seed)
        bore, axis, across, up = frames(rng)
        beam = pysas.Beam(bore * rng.uniform(0.1, 10), 0.1, half, axis=axis * rng.uniform(0.1, 10))
        echoes = echoes.replace(beam=beam)
        directions, counts = [], []
        for off in OFF:
            # over the edge: an axis askew leaves more of one side than of the other
            for side, turn in ((1, rng.uniform(-1, 1)), (-1, rng.uniform(-1, 1))):
                angle = min(max(half + off, 0.0), np.pi / 2)
                middle = np.cos(turn) * across + np.sin(turn) * up
                direction = np.cos(angle) * middle + side * np.sin(angle) * axis
                if abs(direction @ bore) > 1e-6:
                    directions.append(direction)
                    counts.append(direction @ bore > 0 and (off < EDGE_ANGLE or half + off >= np.pi / 2))
            # at the end of the side, `off` beyond the plane across boresight, where that lies within the half-angle
            level = np.cross(bore, axis)
            along = np.cross(level, bore)
            level, along = (v / np.linalg.norm(v) for v in (level, along))
            for tilt in (0.3 * half, -0.5 * half):
                edge = np.cos(tilt) * level + np.sin(tilt) * along
                direction = np.cos(off) * edge - np.sin(off) * bore
                alpha = np.arcsin(min(1.0, abs(direction @ axis)))
                if abs(alpha - half) > 1e-6:
                    directions.append(direction)
                    counts.append(off < EDGE_ANGLE and alpha < half)
        grid = pysas.Grid.points(echoes.tx[0] + rng.uniform(2.0, 5.0) * np.array(directions))
        assert_counted(echoes, grid, counts, backend)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("shape", ["fan", "cone"])
@pytest.mark.parametrize("half, taper", [(0.7, 0.5), (1.2, 1.0), (1e-3, 0.3), (1e-4, 0.1), (1e-5, 1.0), (1.5, 1e-5)])
def test_weights_across_a_taper(backend, shape, half, taper):
    """A pixel's value by its value without a beam is the beam's weight, from 1e-5 rad of taper on; UTM coordinates included.

    Coordinates of 5e6 m are rounded to 1e-9 m, at 2 m to 5e-10 rad; the weight changes by at most pi/2 of that over the ramp.
    """
    rng = np.random.default_rng(9)
    ramp = np.array([-0.5, -1e-3, 0.0, 1e-3, 0.25, 0.5, 0.75, 0.999, 1.001, 1.5])
    angle = np.clip(half * (1 - taper) + ramp * taper * half, 0, np.pi / 2)
    for seed in range(4):
        origin = MAP * (seed % 2)
        echoes = record("monostatic", origin, 40e3, 400, 0.0, seed).replace(data=np.ones((1, 1, 400), complex))
        bore, axis, across, up = frames(rng)
        if shape == "cone":
            beam = pysas.Beam(bore, 0.1, half, "cone", taper)
            side = np.cross(bore, rng.standard_normal((angle.size, 3)))
            middle, side = bore, side / np.linalg.norm(side, axis=1, keepdims=True)
        else:
            beam = pysas.Beam(bore, 0.1, half, taper=taper, axis=axis)
            turn = rng.uniform(-0.3, 0.3, (angle.size, 1))
            middle, side = np.cos(turn) * across + np.sin(turn) * up, axis * np.sign(bore @ axis)
        points = echoes.tx[0] + rng.uniform(2, 5) * (np.cos(angle)[:, None] * middle + np.sin(angle)[:, None] * side)
        grid = pysas.Grid.points(points)
        plain = pysas.backproject(echoes, grid, 1e-9, backend=backend).data
        image = pysas.backproject(echoes.replace(beam=beam), grid, 1e-9, backend=backend)
        x = np.clip((angle - half * (1 - taper)) / (taper * half), 0, 1)
        error = 1e-8 + 2e-9 * (seed % 2) / (taper * half)
        np.testing.assert_allclose(image.data / plain, np.cos(np.pi / 2 * x) ** 2, rtol=0, atol=error)
        assert image.report.terms == np.count_nonzero(angle <= half)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("origin", [np.zeros(3), MAP])
@pytest.mark.parametrize("shape", ["fan", "cone"])
@pytest.mark.parametrize("half", [np.pi / 2, np.pi / 4])
def test_rows_of_pixels_on_a_beams_edge(backend, origin, half, shape):
    """A grid that begins on the track, abeam of which a beam of a right angle ends, and one along a beam's edge."""
    tx = origin + np.stack([np.arange(8) * 0.05, np.zeros(8), np.zeros(8)], axis=1)
    data = noise(8, 1, 400, 0.6).astype(np.complex64)
    bore = [0, 1.0, 0] if half > 1 else [1.0, 0, 0]
    beam = pysas.Beam(bore, 0.1, half, shape)
    echoes = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=tx[:, None], c=C, t0=0.0, bandwidth=24e3, beam=beam)
    across = np.arange(1, 6, 0.05)
    grid = pysas.Grid.plane(origin[0] + across, origin[1] + (np.arange(0, 0.5, 0.05) if half > 1 else across))
    image = pysas.backproject(echoes, grid, 1e-3, backend=backend)
    assert error(image.data, echoes, grid) < 1e-3


@pytest.mark.cpp
@pytest.mark.parametrize("isa", native.core().levels() if native.extension() else ["not built"])
def test_instruction_sets_count_alike(isa, monkeypatch):
    monkeypatch.setenv("PYSAS_ISA", isa)
    test_places_on_a_records_ends_count("cpp", "moving", 1e6)
    test_places_on_a_cones_edge_count("cpp", 1e-7)
    test_places_on_a_fans_edge_count("cpp", 1e-7)
    test_weights_across_a_taper("cpp", "fan", 1e-4, 0.1)
