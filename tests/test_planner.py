"""The planner: its tables from mathematics, its bounds true, its explanations and estimates what happens."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from scenes import PLANE, moving, straight
from scipy.special import jv

import pysas
from pysas import bounds


@pytest.mark.parametrize("degree", [1, 3, 5, 7])
@pytest.mark.parametrize("i", [0, 4, 8, 14, 22])
def test_theta_is_where_the_cut_series_reaches_its_error(degree, i):
    """exp(j theta x) = sum (2 - [k=0]) j^k J_k(theta) T_k(x) (Jacobi-Anger), cut after `degree`; 10^-(1 + i/2) at worst."""
    theta, asked = bounds.THETA[degree][i], 10 ** -(1 + i / 2)
    angle = np.linspace(0, np.pi, 999)
    k = np.arange(degree + 1)
    weight = (2.0 - (k == 0)) * 1j**k * jv(k, theta)
    error = np.abs(np.exp(1j * theta * np.cos(angle)) - weight @ np.cos(k[:, None] * angle)).max()
    # theta is tabulated to 1e-7: at 1e-12 float64's own rounding and that of theta show
    assert error == pytest.approx(asked, rel=0.06 if asked < 1e-10 else 2e-3, abs=3e-15)


@pytest.mark.parametrize("i", [0, 6, 12, 18])
def test_guard_is_where_the_low_pass_tail_falls_below_its_error(i):
    """Tail of W's kernel from W itself: an inverse transform of 2^20 samples of W, read half way between samples."""
    n = 1 << 20
    f = np.fft.fftfreq(n)
    edge = np.clip((np.abs(f) - 1 / 2.2) / (0.5 - 1 / 2.2), 0, 1)
    kernel = np.abs(np.fft.ifft(np.cos(np.pi / 2 * edge) ** 2 * np.exp(-1j * np.pi * f)))[1 : n // 2]
    tail = np.sqrt(np.cumsum(kernel[::-1] ** 2)[::-1])
    asked, count = 10 ** -(1 + i / 2), bounds.GUARD[i]
    assert tail[count - 1] < asked * 1.01 and tail[count - 2] > asked * 0.99


def test_limits_are_each_other_s_inverse():
    for degree in bounds.THETA:
        for error in 10.0 ** -np.linspace(1, 12, 23):
            assert bounds.interpolation_error(degree, bounds.theta_limit(degree, error)) == pytest.approx(error, rel=1e-6)
        assert bounds.interpolation_error(degree, 1e-9) < 1e-15


@pytest.mark.parametrize("terms", range(3, 10))
def test_sine_and_cosine_are_as_good_as_stated(terms):
    (sine, cosine), stated = bounds.trigonometry(terms)
    t = np.linspace(-0.5, 0.5, 3001)
    wrong = np.abs(t * np.polynomial.polynomial.polyval(t**2, sine) - np.sin(2 * np.pi * t)).max()
    wrong = max(wrong, np.abs(np.polynomial.polynomial.polyval(t**2, cosine) - np.cos(2 * np.pi * t)).max())
    assert 0.8 * wrong <= stated <= 1.3 * wrong and len(sine) == terms and len(cosine) == terms + 1


def test_a_plan_images_other_data_of_its_geometry():
    echoes, other = moving(), moving(seed=9)
    plan = pysas.plan(echoes, PLANE, 1e-4)
    assert np.array_equal(plan(other.data).data, pysas.backproject(other, PLANE, 1e-4).data)
    with pytest.raises(ValueError, match="data: expected the planned shape"):
        plan(other.data[:3])
    with pytest.raises(TypeError, match="data: expected complex128"):
        plan(other.data.astype(np.complex64))


def test_print_and_explain_say_what_was_chosen_and_left_out():
    still, turning = pysas.plan(straight(), PLANE, 1e-3), pysas.plan(moving(), PLANE, 1e-8)
    for text in ("tol 0.001", "float32", "degree", "monostatic", "polynomials", "predicted"):
        assert text in str(still)
    assert "float64" in str(turning) and "moving receivers" in str(turning)
    assert "exact per pixel" in str(pysas.plan(moving(), PLANE, 1e-8, backend="numba"))
    assert "second square root" in still.explain() and "of each record" in still.explain()
    assert "second square root" not in turning.explain() and "float64 in the inner loop" not in turning.explain()
    mask = np.zeros(PLANE.shape, bool)
    mask[:20] = True
    half = pysas.Grid.plane(PLANE.axes["x"], PLANE.axes["y"], mask=mask)
    assert "67 % of the pixels" in pysas.plan(straight(), half).explain()


def test_errors_add_up_to_less_than_tol():
    for tol in 10.0 ** -np.linspace(1, 5, 9):
        choices = pysas.plan(straight(), PLANE, tol).choices
        assert 0.1 * tol < choices.predicted_error <= tol or choices.oversampling == 1.0


@pytest.mark.parametrize("step", [0.005, 0.02, 0.16, 1.0])
@pytest.mark.parametrize("tol", [1.33e-5, 1e-5, 3e-5, 1e-4])
def test_coarse_pixels_do_not_round_tol_away(step, tol):
    """A block's offset in float32 grows with the pixel: where it would cost more than tol, delays are exact instead."""
    grid = pysas.Grid.plane(np.arange(-9, 10) * step, 20.0 + np.arange(20) * step)
    echoes = straight()
    image = pysas.backproject(echoes.replace(data=echoes.data.astype(np.complex64)), grid, tol)
    assert image.report.predicted_error <= tol
    exact, level = pysas.reference.exact(echoes, grid)
    assert pysas.metrics.relative_error(image.data, exact, level) <= tol


def test_a_record_the_grid_does_not_need_is_not_transformed():
    echoes = straight(samples=8000)
    choices = pysas.plan(echoes, PLANE, 1e-3).choices
    assert choices.length < 500
    exact, level = pysas.reference.exact(echoes, PLANE, np.arange(0, PLANE.size, 17))
    image = pysas.backproject(echoes, PLANE, 1e-3)
    assert pysas.metrics.relative_error(image.data.ravel()[::17], exact, level) <= 1e-3


@pytest.mark.parametrize("dtype", ["complex64", "complex128"])
def test_memory_stays_within_the_estimate_and_the_promise(dtype):
    """Peak resident memory of a process beyond what it had before: image + 25 % + 64 MB, and the plan's own estimate."""
    code = f"""
        import resource, numpy as np, pysas
        rng = np.random.default_rng(0)
        tx = np.zeros((400, 3)); tx[:, 0] = np.arange(400) * 0.02
        data = rng.standard_normal((400, 2, 4096, 2)).view(complex)[..., 0].astype({dtype!r})
        rx = np.stack([tx, tx + [0.1, 0.0, 0.0]], axis=1)
        echoes = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=rx, t0=0.02, bandwidth=30e3)
        tol = 1e-3
        small = pysas.Grid.plane(np.arange(70) * 0.02, 30 + np.arange(40) * 0.02)
        pysas.backproject(echoes, small, tol, threads=2)  # compiles; its own memory is small
        grid = pysas.Grid.plane(np.arange(1500) * 0.02, 20 + np.arange(900) * 0.02)
        plan = pysas.plan(echoes, grid, tol, threads=2)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        image = plan(data)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
        print(grown, plan.predicted_memory, data.nbytes, image.data.nbytes)
    """
    run = [sys.executable, "-c", textwrap.dedent(code)]
    result = subprocess.run(run, capture_output=True, text=True, timeout=200, check=True)
    grown, predicted, data, image = (int(v) for v in result.stdout.split())
    assert grown <= image + 0.25 * (data + image) + 64 * 2**20
    assert grown <= 1.5 * predicted + 16 * 2**20
