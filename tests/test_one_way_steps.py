"""The steps of one-way migration: dispersion, damping and energy against their formulas, at every dz/dx."""

import numpy as np
import pytest

from pysas.reference import one_way_carrier as carrier
from pysas.reference.marching import EQUATIONS, March, Solver, one_way_wavenumber

pytestmark = pytest.mark.reference

RATIOS = (1e-3, 1.0, 1e3, 1e6)  # dz/dx


def cosine(columns, mode):
    """A mode of the second difference with Neumann ends; its eigenvalue is 4 sin^2(pi mode/(2 columns))."""
    return np.cos(np.pi * mode * (np.arange(columns) + 0.5) / columns)


# relative error of k_z/k at 5, 10, 15, 20, 30, 45, 60 degrees: the difference of two closed forms, as tabulated beforehand
DISPERSION = {
    15: (7e-6, 1.2e-4, 5.8e-4, 1.8e-3, 9e-3, 4.3e-2, 0.125),
    45: (1e-8, 9e-7, 1e-5, 5.7e-5, 6.4e-4, 7e-3, 3.9e-2),
    65: (1.6e-4, 6e-4, 1.2e-3, 1.8e-3, 2e-3, -1.7e-3, 2.5e-4),
}


@pytest.mark.parametrize("angle", DISPERSION)
def test_dispersion(angle):
    theta = np.radians([5, 10, 15, 20, 30, 45, 60])
    k = np.full(theta.size, 838.0)
    error = 1 + one_way_wavenumber(k, np.sin(theta) ** 2, EQUATIONS[angle]) / k - np.cos(theta)
    np.testing.assert_allclose(error, DISPERSION[angle], rtol=0.1, atol=5e-9)


@pytest.mark.parametrize("angle", EQUATIONS)
def test_a_step_turns_a_mode_by_the_equations_phase_and_keeps_its_size(angle):
    # fourth-order differences at k_x dx = pi/10, b = step's phase: Crank-Nicolson lacks b^3/12, differences (k_x dx)^4/240
    columns, spacing, length, frequency = 40, 0.002, 0.001, np.array([100e3, 110e3])
    march = March(frequency, spacing, EQUATIONS[angle], 1 / 12, 1)
    mode = cosine(columns, 4)
    w = np.stack([mode, mode], axis=1).astype(complex)
    solver = Solver(w)
    solver.prepare(march.factor(length, 1500.0, slice(0, 2)))
    for _ in range(10):
        solver.step(w)
    k = 4 * np.pi * frequency / 1500.0
    b = -one_way_wavenumber(k, (np.pi * 4 / (columns * spacing) / k) ** 2, EQUATIONS[angle]) * length
    ratio = w / mode[:, None]
    np.testing.assert_allclose(np.abs(ratio), 1, atol=1e-12)
    found = -np.angle(ratio[0])
    np.testing.assert_allclose(found, 10 * b, rtol=1e-4)
    np.testing.assert_allclose(found, 20 * np.arctan(b / 2), rtol=6e-5)


@pytest.mark.parametrize("ratio", RATIOS)
def test_base_band_keeps_energy(ratio):
    rng = np.random.default_rng(0)
    for terms in EQUATIONS.values():
        march = March(np.array([80e3, 100e3, 120e3]), 0.01, terms, 1 / 12, 1)
        w = rng.standard_normal((30, 3)) + 1j * rng.standard_normal((30, 3))
        start = np.sum(np.abs(w) ** 2, axis=0)
        solver = Solver(w)
        solver.prepare(march.factor(0.01 * ratio, 1500.0, slice(0, 3)))
        for _ in range(600):
            solver.step(w)
        np.testing.assert_allclose(np.sum(np.abs(w) ** 2, axis=0), start, rtol=1e-10)


def steady(columns, cells, mode, phase, scheme, count):
    """Amplitudes of one mode along range when the track records exp(-j phase n)."""

    def signal(first, last):
        n = np.arange(first, last)
        ramp = np.sin(np.pi / 2 * np.minimum(n / (count / 2), 1)) ** 2  # so that nothing but the steady wave is excited
        return (ramp * np.exp(-1j * phase * n))[:, None] * mode

    return carrier.march(signal, count, cells, columns, [scheme], 1)[0] / mode[0]


@pytest.mark.parametrize(("cells", "sine"), [(8, 0.3), (8, 0.1), (64, 0.3), (64, 0.1)])
def test_implicit_euler_damps_by_its_formula(cells, sine):
    # k = 251 rad/m: 39.8, 4.30, 5.0, 0.54 dB/m, found beforehand
    k = 251.0
    dz, k_x, columns = 2 * np.pi / k / cells, 251.0 * sine, 6
    dx = np.pi / (columns * k_x)  # mode 1 has this k_x
    phase, ratio = k * dz, dz / dx
    scheme = carrier.Scheme.of(0.5, ratio, columns, "euler", 0.0)
    u = steady(columns, 400, cosine(columns, 1), phase, scheme, 4000)
    a = 2 * ratio**2 * np.sin(k_x * dx / 2) ** 2
    formula = -10 * np.log10(1 + a + a**2 / (4 * np.sin(phase / 2) ** 2))
    found = 20 * np.log10(np.abs(u[220] / u[20])) / 200
    assert found == pytest.approx(formula, rel=0.01)
    # and roughly exp(-k_x^2 dz z/4)
    assert found == pytest.approx(-20 * np.log10(np.e) * k_x**2 * dz**2 / 4, rel=0.15)


def test_crank_nicolson_in_time_does_not_damp_and_is_right_at_the_centre():
    k, dz, columns = 251.0, 2 * np.pi / 251.0 / 8, 6
    phase, dx = k * dz, np.pi / (6 * 75.0)
    fixed = np.tan(phase / 2) / (phase / 2)
    scheme = carrier.Scheme.of(0.5 * fixed, dz / dx, columns, "cn", 1 / 12)
    u = steady(columns, 150, cosine(columns, 1), phase, scheme, 1200)
    turn = np.angle(u[110] / u[10])
    assert np.abs(u[110] / u[10]) == pytest.approx(1, abs=0.01)
    # k_z dz per cell of the 15-degree equation; k_x dx = 30 degrees leaves (k_x dx)^4/240 of the deviation
    expected = 100 * dz * (k - 75.0**2 / (2 * k))
    assert np.angle(np.exp(1j * (turn - expected))) == pytest.approx(0, abs=0.03)


def second_difference(u):
    low, high = np.vstack([u[:1], u[:-1]]), np.vstack([u[1:], u[-1:]])
    return 2 * u - low - high


def energy(part, field, other):
    """(field, P field)/(coefficient (dz/dx)^2), and with `other` the whole energy's part of u."""
    weighted = field - part.gamma * second_difference(field)
    return float(np.real(np.vdot(field, weighted))) / other


ALGORITHMS = {
    "I": ((0.5,), "cn"), "II, 45": ((0.5, 0.25), "cn"), "II, 65": ((0.478242, 0.376370), "cn"),
    "I, Euler": ((0.5,), "euler"), "II, 45, Euler": ((0.5, 0.25), "euler"),
}  # fmt: skip


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", ALGORITHMS)
def test_energy_never_grows_beyond_what_enters(name, ratio):
    # |u_x|^2 + |F|^2/alpha + |q|^2/beta of the paper, in the discrete norm that Crank-Nicolson keeps, over 600 random steps
    terms, kind = ALGORITHMS[name]
    columns, cells = 12, 10
    parts = [carrier.Scheme.of(v, ratio, columns, kind, 1 / 12 if kind == "cn" else 0.0) for v in terms]
    state = carrier._State(columns, cells, np.dtype(complex), len(parts))
    rng = np.random.default_rng(3)
    data = rng.standard_normal((600, columns)) + 0j
    last, before, largest = np.zeros(columns), 0.0, 0.0
    for sample in data:
        difference = sample - last
        entering = difference - (state.q[:, 0] if len(parts) == 2 else 0)
        state.advance(difference[None], parts, True)
        last = sample
        u, f = state.u, state.w[state.done % 2][:, 1:]
        now = float(np.real(np.vdot(u, second_difference(u)))) + energy(parts[0], f, terms[0] * ratio**2)
        if len(parts) == 2:
            now += energy(parts[1], state.q, terms[1] * ratio**2)
        added = energy(parts[0], entering[:, None], terms[0] * ratio**2)
        assert now <= (before + added) * (1 + 1e-9)
        before, largest = now, max(largest, float(np.abs(u).max()))
    assert largest < 8  # of data with deviation 1; 3.7 was found for longer records


def test_algorithm_two_with_beta_zero_is_algorithm_one():
    rng = np.random.default_rng(0)
    data = rng.standard_normal((150, 9)) + 1j * rng.standard_normal((150, 9))
    for kind, gamma in (("cn", 1 / 12), ("euler", 0.0)):
        one, zero = (carrier.Scheme.of(v, 0.7, 9, kind, gamma) for v in (0.5, 0.0))
        found = [carrier.march(lambda i, j: data[i:j], 150, 100, 9, parts, 1) for parts in ([one], [one, zero])]
        np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-13)


def test_tiles_threads_and_a_plain_loop_are_one():
    # the same algorithm, cell by cell with dense matrices (K. Ito et al., Algorithm II with alpha and beta in their places)
    rng = np.random.default_rng(1)
    columns, cells, count, ratio = 7, 70, 100, 0.8
    data = rng.standard_normal((count, columns)) + 1j * rng.standard_normal((count, columns))
    h = second_difference(np.eye(columns))
    alpha, beta = 0.5, 0.25
    u, f, q = (np.zeros((columns, cells), complex) for _ in range(3))
    for n in range(count):
        f[:, 1:] = f[:, :-1].copy()
        f[:, 0] = data[n] - (data[n - 1] if n else 0) - q[:, 0]
        middle = np.linalg.solve(np.eye(columns) + alpha * ratio**2 * h, u + f)
        f = middle - u
        u = np.linalg.solve(np.eye(columns) + beta * ratio**2 * h, middle + q)
        q = u - middle
    parts = [carrier.Scheme.of(v, ratio, columns, "euler", 0.0) for v in (alpha, beta)]
    found = [carrier.march(lambda i, j: data[i:j], count, cells, columns, parts, threads) for threads in (1, 2)]
    np.testing.assert_allclose(found[0], u, atol=1e-12)
    np.testing.assert_array_equal(found[0], found[1])
