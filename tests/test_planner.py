"""The planner: its tables from mathematics, its bounds true, its explanations and estimates what happens."""

import re
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from scenes import PLANE, moving, straight
from scipy.special import jv
from test_factorised import BACKENDS, plane, single

import pysas
from pysas.engine import native
from pysas.imaging import planner
from pysas.planning import bounds
from pysas.planning.fallback import settings
from pysas.planning.scene import Scene


@pytest.mark.parametrize("degree", [3, 5, 7])
@pytest.mark.parametrize("i", [0, 4, 8, 14])
def test_theta_is_where_the_cut_series_reaches_its_error(degree, i):
    """exp(j theta x) = sum (2 - [k=0]) j^k J_k(theta) T_k(x) (Jacobi-Anger), cut after `degree`: 10^-(1 + i/2) at worst."""
    asked = 10 ** -(1 + i / 2)
    theta = settings.theta_limit(degree, asked)
    angle = np.linspace(0, np.pi, 999)
    k = np.arange(degree + 1)
    weight = (2.0 - (k == 0)) * 1j**k * jv(k, theta)
    error = np.abs(np.exp(1j * theta * np.cos(angle)) - weight @ np.cos(k[:, None] * angle)).max()
    assert 0.6 * asked <= error <= asked


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
    for degree in (3, 5, 7):
        for error in 10.0 ** -np.linspace(1, 2 + degree, 23):
            assert settings.interpolation_error(degree, settings.theta_limit(degree, error)) == pytest.approx(error, rel=1e-5)
        assert settings.interpolation_error(degree, 1e-9) < 1e-15


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


LARGE = plane(320, 256, 24.0)


@pytest.fixture(scope="module")
def long():
    """1024 pings, enough for a tree."""
    return single(straight(1024, 0.01, samples=1200))


@pytest.mark.parametrize("backend", BACKENDS)
def test_focus_takes_the_engine_of_least_predicted_time_and_keeps_tol(long, backend):
    plans = {m: pysas.plan(long, LARGE, 1e-3, m, 1, backend) for m in ("backprojection", "ffbp", "auto")}
    assert plans["ffbp"].predicted_seconds < plans["backprojection"].predicted_seconds
    assert plans["auto"].method == "ffbp" and plans["auto"].choices == plans["ffbp"].choices
    image = pysas.focus(long, LARGE, 1e-3, 1, backend)
    assert image.report.method == "ffbp" and image.report.factorised_share == 1
    pixels = np.random.default_rng(0).choice(LARGE.size, 100, replace=False)
    exact, level = pysas.reference.exact(long, LARGE, pixels)
    assert pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level) <= 1e-3
    if backend != "numba":  # two threads sum this in 30 ms: trees are worth planning even so
        assert pysas.plan(long, LARGE, 1e-3, "auto", 2, backend).method == "ffbp"
    # where no tree keeps tol, and below what planning one costs
    assert pysas.plan(long, LARGE, 1e-5, threads=1, backend=backend).method == "backprojection"
    small = plane(96, 20, 24.0)
    image = pysas.focus(long, small, 1e-3, 1, backend)
    assert image.report.method == "backprojection" and not image.report.notes
    assert np.array_equal(image.data, pysas.backproject(long, small, 1e-3, backend=backend).data)


def test_focus_passes_its_options_on():
    echoes = moving()
    out, seen = np.empty(PLANE.shape, complex), []
    weights = np.linspace(0, 1, 16)
    image = pysas.focus(echoes, PLANE, 1e-4, weights=weights, threads=1, out=out, progress=seen.append)
    assert image.data is out and seen[-1] == 1 and image.report.threads == 1
    assert np.array_equal(out, pysas.backproject(echoes, PLANE, 1e-4, weights=weights).data)
    even = pysas.focus(echoes, PLANE, 1e-3, weights="uniform-angle").data
    other = pysas.backproject(echoes, PLANE, 1e-3, weights="uniform-angle").data
    assert np.linalg.norm(even - other) <= 2e-3 * np.linalg.norm(other)
    with pytest.raises(ValueError, match="tol=1: expected at most 0.1"):
        pysas.focus(echoes, PLANE, 1.0)
    with pytest.raises(ValueError, match="out"):
        pysas.focus(echoes, PLANE, out=np.empty((2, 2), complex))


@pytest.mark.parametrize("backend", BACKENDS)
def test_explain_names_the_other_engine_and_its_time(long, backend, monkeypatch):
    monkeypatch.setenv("PYSAS_BACKEND", backend)
    direct, tree = (pysas.plan(long, LARGE, 1e-3, method) for method in ("backprojection", "ffbp"))

    def predicted(text, name):
        return float(re.search(rf"- {name}: ([\d.e-]+) s predicted", text)[1])

    assert predicted(tree.explain(), "backprojection") == pytest.approx(direct.predicted_seconds, rel=0.05)
    if backend == "numba":  # it has no costs to tell how long trees would take, but says what decides
        assert re.search(r"- ffbp: trees over \d+ groups of pings would serve 100 % of the terms", direct.explain())
        assert "rule           trees from" in str(pysas.plan(long, LARGE, 1e-3)) and "rule" not in str(direct)
    else:
        assert predicted(direct.explain(), "ffbp") == pytest.approx(tree.predicted_seconds, rel=0.2)
    for text in (direct.explain(), tree.explain()):
        assert re.search(r"predicted      error [\d.e-]+, time [\d.e-]+ s, memory \d+ MB beyond the input", text)
    assert "ffbp: tol below 3e-05" in pysas.plan(long, LARGE, 1e-5).explain()
    with pytest.warns(UserWarning, match="outside the recorded window"):
        text = pysas.plan(long, plane(320, 256, 2400.0)).explain()
    assert "ffbp: the grid lies outside the recorded window" in text


@pytest.mark.parametrize("method", planner.METHODS)
def test_a_plan_before_compression_is_that_of_compressed_echoes(method):
    """Only where it is said that they are not yet: raw echoes are no echoes to image."""
    raw = straight().replace(compressed=False, pulse=pysas.LFM(100e3, 30e3, 1e-3))
    echoes = pysas.compress(raw)
    before = planner.plan_ahead(raw, PLANE, 1e-3, method)
    assert str(before) == str(pysas.plan(echoes, PLANE, 1e-3, method))
    assert np.array_equal(before(echoes.data).data, pysas.plan(echoes, PLANE, 1e-3, method)(echoes.data).data)
    with pytest.raises(ValueError, match=r"raw \(compressed=False\): expected range-compressed echoes"):
        pysas.plan(raw, PLANE, 1e-3, method)


def test_a_warning_of_a_plan_names_the_line_that_asked_for_it():
    echoes, far = straight(8), pysas.Grid.plane([0.0], [900.0])
    for ask in (lambda: pysas.plan(echoes, far), lambda: planner.plan_ahead(echoes, far)):
        with pytest.warns(UserWarning, match="outside the recorded window") as caught:
            ask()
        assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize("off", [0.0, 0.009, 0.011])
def test_fourier_algorithms_are_alternatives_where_they_take_the_track(off):
    """One ping `off` wavelengths beside an even line: a hundredth is what the Fourier algorithms allow."""
    echoes = straight(32)
    tx = echoes.tx.copy()
    tx[7, 1] += off * echoes.c / echoes.fc * 32 / 31  # the line moves by 1/32 of it
    echoes = echoes.replace(tx=tx, rx=tx[:, None])
    text = pysas.plan(echoes, PLANE).explain()
    if off <= 0.01:
        pysas.reference.omega_k(echoes, threads=1)
        assert "omega-k, range-Doppler, chirp scaling (pysas.reference): the track is straight and even" in text
    else:
        with pytest.raises(ValueError, match="tx at ping 7"):
            pysas.reference.omega_k(echoes, threads=1)
        assert "omega-k" not in text


def test_arrays_come_to_fourier_algorithms_by_their_phase_centres():
    echoes = straight(32)
    pair = echoes.replace(data=np.repeat(echoes.data, 2, axis=1), rx=np.stack([echoes.tx, echoes.tx + [0.03, 0, 0]], axis=1))
    assert "(pysas.reference, of reference.phase_centres)" in pysas.plan(pair, PLANE).explain()
    assert "omega-k" not in pysas.plan(moving(), PLANE).explain()
    assert "omega-k" not in pysas.plan(straight(1), PLANE).explain()


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


@pytest.mark.parametrize(
    "beam",
    [
        pysas.Beam((0.0, 1.0, 0.0), 0.04, 0.03),
        pysas.Beam((0.0, 1.0, 0.0), 0.04, 0.06, taper=0.7, axis=(1.0, 0.05, 0.05)),
        pysas.Beam((0.0, 1.0, 0.0), 0.04, 0.3, "cone"),
    ],
)
def test_share_of_pairs_within_record_and_beam_is_guessed(beam):
    """Against the terms that the engine counts; 400 pixels and 32 traces of them are looked at."""
    echoes = moving(64).replace(beam=beam)
    image = pysas.backproject(echoes, PLANE, 1e-3)
    scene = Scene(echoes, PLANE, None)
    assert 0.1 < scene.lit < 0.9
    assert scene.lit == pytest.approx(1 - image.report.share_left_out, abs=0.03)


@pytest.mark.cpp
def test_wide_pixels_get_long_polynomials_instead_of_gathers():
    """Intervals that a vector of pixels of 10 cm spans at a high rate do not lie in registers."""
    if native.isa_name() == "baseline":
        return  # it gathers anyway
    echoes = straight(64, samples=3600)  # beside a record's end every rate is at least 2
    narrow, wide = (
        pysas.plan(echoes, plane(64, 256, 24.0, step), 1e-3, "backprojection", backend="cpp").choices for step in (0.005, 0.1)
    )
    assert wide.oversampling < narrow.oversampling and wide.degree > narrow.degree


@pytest.mark.parametrize("shape", ["fan", "cone"])
@pytest.mark.parametrize("method", ["backprojection", "ffbp"])
def test_a_beam_that_reaches_every_pixel_is_left_out(long, method, shape):
    """A corner seen from the farthest ping bounds the angle; a beam a hundredth narrower cuts terms."""
    corners = np.array([[x, y, 0.0] for x in LARGE.axes["x"][[0, -1]] for y in LARGE.axes["y"][[0, -1]]])
    away = corners - long.tx[:, None]
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    widest = float(np.arccos(away[..., 1].min()) if shape == "cone" else np.arcsin(np.abs(away[..., 0]).max()))
    wide, narrow = (long.replace(beam=pysas.Beam((0.0, 1.0, 0.0), 0.04, widest * f, shape)) for f in (1.01, 0.99))
    plain, whole, cut = (pysas.plan(echoes, LARGE, 1e-3, method) for echoes in (long, wide, narrow))
    assert "beam: it reaches every pixel" in whole.explain() and "beam:" not in cut.explain()
    assert np.array_equal(whole(long.data).data, plain(long.data).data)
    assert cut(long.data).report.terms < plain(long.data).report.terms
