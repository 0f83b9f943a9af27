"""One-way migration along curved and circular paths, against the exact sum on the true path and against Hankel functions."""

import numpy as np
import pytest
from scipy.special import hankel1e

import pysas
from pysas.reference import exact, map_to_line, omega_k, one_way_polar
from pysas.reference.marching import EQUATIONS

C, FC, FS, BAND = 1500.0, 100e3, 20e3, 15e3
U = 0.01 * (np.arange(500) - 250)
POINTS = ((0.0, 8.0), (0.5, 9.0))


def survey(position, normal, points, near, samples, dtype=np.complex128):
    """Compressed echoes of a Gaussian pulse; a cos^2 beam about each ping's `normal` ends at a sine of 0.15."""
    t = 2 * near / C + np.arange(samples) / FS
    sigma = 6.8 / (np.pi * BAND)
    data = np.zeros((len(position), samples), dtype=np.complex128)
    for point in points:
        away = np.array(point) - position
        distance = np.hypot(*away.T)
        cosine = np.sum(away * normal, axis=1) / distance
        sine = np.where(cosine > 0, np.sqrt(np.clip(1 - cosine**2, 0, 1)), 1.0)
        beam = np.where(sine < 0.15, np.cos(np.pi / 2 * sine / 0.15) ** 2, 0.0)[:, None]
        late = t - 2 * distance[:, None] / C
        data += beam * np.exp(-(late**2) / (2 * sigma**2) - 4j * np.pi * FC / C * distance[:, None])
    tx = np.column_stack([position, np.zeros(len(position))])
    return pysas.Echoes(data.astype(dtype), fs=FS, fc=FC, tx=tx, rx=tx, c=C, t0=2 * near / C, bandwidth=BAND)


def curved(depth, u=U, side=1.0):
    return survey(np.stack([u, side * depth], axis=1), np.array([0.0, side]), [(x, side * z) for x, z in POINTS], 6.5, 130)


def error(image, echoes, grid, count=1500):
    """Relative error of `image` on `grid` against the exact sum of `echoes`, on random pixels."""
    pixels = np.random.default_rng(0).choice(grid.size, min(count, grid.size), replace=False)
    direct, level = exact(echoes, grid, pixels)
    return pysas.metrics.relative_error(image.ravel()[pixels], direct, level)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_curved_path_through_omega_k_is_back_projection_on_it(side):
    # 10 cm to either side: 84 rad of two-way phase
    echoes = curved(0.1 * np.sin(2 * np.pi * U / 6.0), side=side)
    if side < 0:
        echoes = echoes.replace(beam=pysas.Beam((0.0, -1.0, 0.0), 0.1, np.pi / 2))
        mapped = map_to_line(echoes, half_angle=0.15, threads=1).replace(beam=pysas.Beam((0.0, -1.0, 0.0), 0.1, 0.15))
    else:
        mapped = map_to_line(echoes, half_angle=0.15, threads=1)
    assert mapped.tx[:, 1] == pytest.approx(np.full(U.size, side * np.abs(echoes.tx[:, 1]).max()))
    image = omega_k(mapped, weight="backprojection", threads=1)
    rows, columns = np.abs(side * image.grid.axes["y"] - 8.5) < 1.0, np.abs(image.grid.axes["x"]) < 1.0
    grid = pysas.Grid.plane(image.grid.axes["x"][columns], image.grid.axes["y"][rows])
    assert error(image.data[np.ix_(rows, columns)], echoes.replace(beam=None), grid) < 0.012


def test_uncorrected_it_is_lost():
    echoes = curved(0.1 * np.sin(2 * np.pi * U / 6.0))
    straight = echoes.replace(tx=echoes.tx * [1, 0, 1], rx=echoes.tx * [1, 0, 1])
    grid = pysas.Grid.plane(U[150:350:2], 7.5 + 0.0125 * np.arange(160))
    assert error(pysas.backproject(straight, grid, tol=1e-4).data, echoes, grid) > 1


def test_steeper_than_the_beam_is_refused():
    depth = np.where(U < 1.0, 0.0, 0.2 * (U - 1.0))  # 11.3 degrees
    with pytest.raises(ValueError, match=r"path: 11\.3 degrees steep after the ping at x=.* half-angle, 8\.59 degrees"):
        map_to_line(curved(depth), half_angle=0.15)


def test_what_else_map_to_line_refuses():
    depth = 0.05 * np.sin(U)
    echoes = curved(depth)
    with pytest.raises(ValueError, match=r"line=0.0: ping .* lies beyond it"):
        map_to_line(echoes, line=0.0)
    heave = echoes.tx + np.array([0.0, 0.0, 0.01]) * np.sin(U)[:, None]
    with pytest.raises(ValueError, match="path: ping .* m above or below the others"):
        map_to_line(echoes, heave)
    with pytest.raises(ValueError, match=r"path: expected shape \(500, 3\)"):
        map_to_line(echoes, heave[:3])
    with pytest.raises(ValueError, match="even straight line along x"):
        map_to_line(echoes, echoes.tx * [1.0, 1.0, 1.0] + np.outer(U > 0, [0.001, 0, 0]))
    with pytest.raises(TypeError, match="echoes=int"):
        map_to_line(3)


def test_a_straight_path_is_left_as_it_is():
    # raw or compressed: all of the occupied band comes back
    echoes = curved(np.zeros(U.size))
    mapped = map_to_line(echoes, threads=1)
    assert pysas.metrics.relative_error(mapped.data, echoes.data) < 1e-8
    assert mapped.t0 == echoes.t0 and np.array_equal(mapped.tx, mapped.rx)


@pytest.mark.parametrize("backwards", [False, True])
def test_a_line_farther_out_and_tracks_run_backwards(backwards):
    echoes = curved(0.05 * np.sin(2 * np.pi * U / 5.0))
    if backwards:
        echoes = echoes.replace(data=echoes.data[::-1], tx=echoes.tx[::-1], rx=echoes.rx[::-1])
    mapped = map_to_line(echoes, line=0.3, half_angle=0.15, threads=1)
    np.testing.assert_allclose(mapped.tx[:, 0], echoes.tx[:, 0], atol=1e-9)
    grid = pysas.Grid.plane(U[200:300:3], 8.5 + 0.0125 * np.arange(80))
    image = pysas.backproject(mapped, grid, tol=1e-5, threads=1)
    # nearer by 0.3 m: pings see 0.3/9 less of the track, and the sum is less by sqrt(8.7/9)
    ratio = np.sqrt(9.0 / 8.7)
    assert error(image.data * ratio, echoes, grid) < 0.02


# Circles


def ring(mode, radius, depth, k):
    """A full circle that records cos(mode phi) times a pulse of 200 Hz."""
    n = int(np.ceil(2 * np.pi * radius / 0.01))
    phi = 2 * np.pi * np.arange(n) / n
    tx = np.stack([radius * np.cos(phi), radius * np.sin(phi), 0 * phi], axis=1)
    fc, fs = k * C / (4 * np.pi), 1000.0
    t = np.arange(40) / fs - 0.02 + 2 * depth / C
    pulse = np.exp(-((t - 2 * depth / C) ** 2) / (2 * 0.003**2)) * np.exp(-4j * np.pi * fc * depth / C)
    data = np.cos(mode * phi)[:, None] * pulse
    return pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=tx, c=C, t0=float(t[0]), bandwidth=600.0), t, pulse, phi


@pytest.mark.parametrize(("radius", "r", "sine"), [(3.0, 6.0, 0.2), (4.5, 3.0, 0.2)])
def test_polar_against_hankel_functions(radius, r, sine):
    # waves exp(j m phi) sqrt(k r) H_m(k r), alpha and beta of the equation give the phase error of its 15 and 45 degrees
    k, depth = 200.0, abs(r - radius)
    mode = round(k * radius * sine)
    echoes, t, pulse, phi = ring(mode, radius, depth, k)
    f = np.arange(-300.0, 301.0, 10.0)
    spectrum = np.exp(-2j * np.pi * np.outer(f, t)) @ pulse
    wave = 4 * np.pi * (echoes.fc + f) / C
    place = np.linspace(radius, r, 3001)
    turn = np.unwrap(np.angle(hankel1e(mode, wave[:, None] * place)), axis=1)
    advance = np.sign(r - radius) * (turn[:, -1] - turn[:, 0]) + wave * depth
    expected = 10.0 * np.sum(spectrum * np.exp(1j * advance)) / echoes.fs * np.sqrt(radius / r)
    for angle, terms in list(EQUATIONS.items())[:2]:
        # far from the seam of the circle, where the record goes on as it is but differences end
        grid = pysas.Grid.polar([r], phi[phi.size // 2 : phi.size // 2 + 1])
        found = one_way_polar(echoes, grid, angle=angle, half_angle=0.21, step=0.0075, threads=1).data.item()
        found /= np.cos(mode * phi[phi.size // 2])
        sine2 = (mode**2 - 0.25) / (k * place) ** 2
        approximate = terms[0] * sine2 / (1 - terms[1] * sine2)
        error = np.trapezoid(k * (1 - approximate - np.sqrt(1 - sine2)), np.abs(place - radius))
        assert abs(found) == pytest.approx(abs(expected), rel=0.02)
        assert np.angle(found / expected) == pytest.approx(error, abs=0.005)


def arc(side=1.0, target=5.0, backwards=False):
    """Pings every 1 cm on 2 m of a circle of 4 m, looking out or in."""
    phi = 0.0025 * (np.arange(200) - 100)[:: -1 if backwards else 1]
    unit = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    return survey(4.0 * unit, side * unit, [(target, 0.0)], abs(target - 4.0) - 0.5, 30), phi


@pytest.mark.parametrize(("side", "target"), [(1.0, 5.0), (-1.0, 3.2)])
def test_polar_is_back_projection(side, target):
    echoes, phi = arc(side, target)
    r = target + 0.03 * np.arange(-6, 7)
    grid = pysas.Grid.polar(r, phi[80:121])
    image = one_way_polar(echoes, grid, half_angle=0.15, threads=1)
    # stationary phase of the sum over pings: sqrt(2 pi |r - R|/k) exp(j pi/4)/spacing for waves along the radius at fc; as
    # 1/sqrt(k) the ends of the band differ by 4 %, as cos^(-3/2) the edge of the beam by 2 %
    weight = np.sqrt(2 * np.pi * np.abs(r - 4.0) * C / (4 * np.pi * FC)) * np.exp(0.25j * np.pi) / 0.01
    assert error(image.data * weight, echoes, grid) < 0.03
    back, _ = arc(side, target, backwards=True)
    again = one_way_polar(back, grid, half_angle=0.15, threads=2)
    np.testing.assert_allclose(again.data, image.data, rtol=0, atol=1e-9 * np.abs(image.data).max())


def test_what_one_way_polar_refuses():
    echoes, phi = arc()
    grid = pysas.Grid.polar([4.9, 5.0], phi[:3])
    for bad, message in (
        (pysas.Grid.polar([3.9, 5.0], phi[:3]), "all on one side of the circle"),
        (pysas.Grid.polar([0.5], phi[:3]), r"at r=0\.5 m the half-angle of 8\.59 degrees .* expected r >= 0\.690[0-9]* m"),
        (pysas.Grid.polar([5.0], phi[:1] + 0.001), "angle=-0.249 rad at column 0: expected the angle of a ping"),
        (pysas.Grid.polar([5.0], phi[:1], (0.1, 0.0, 0.0)), "tx at ping .* from a monostatic circle"),
    ):
        with pytest.raises(ValueError, match=message):
            one_way_polar(echoes, bad, half_angle=0.15)
    with pytest.raises(ValueError, match="non-finite sample at ping 7"):
        data = echoes.data.copy()
        data[7, 3] = np.nan
        one_way_polar(echoes.replace(data=data), grid)
    with pytest.raises(ValueError, match="rx at ping 0"):
        one_way_polar(echoes.replace(rx=echoes.rx + 0.1), grid)
    with pytest.raises(TypeError, match="expected a pysas.Grid.polar"):
        one_way_polar(echoes, pysas.Grid.plane([0.0], [1.0]))
