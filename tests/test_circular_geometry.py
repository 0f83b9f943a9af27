"""View angles on a circular track: the printed formulas, their inverse, and the extremes the printed forms cannot take."""

import numpy as np
import pytest
from scipy.special import jv

from pysas import circular

pytestmark = pytest.mark.reference

OFFSETS = (0.0, 0.2, 0.5, 0.9, 0.999999)
ANGLES = np.linspace(-np.pi, np.pi, 2001)


@pytest.mark.parametrize("a", (0.2, 0.5, 0.9))
def test_the_printed_equations_hold(a):
    theta = np.linspace(-3.1, 3.1, 500)
    # Pailhas et al., Eqs 2 and 3 as printed
    h = np.sign(theta) * np.arccos((np.cos(theta) - a) / np.sqrt(1 + a**2 - 2 * a * np.cos(theta)))
    np.testing.assert_allclose(circular.view_angle(theta, a), h, atol=1e-12)
    printed = a * np.sin(theta) ** 2 + np.cos(theta) * np.sqrt(1 - a**2 * np.sin(theta) ** 2)
    np.testing.assert_allclose(circular.track_angle(theta, a), np.sign(theta) * np.arccos(printed), atol=1e-12)


@pytest.mark.parametrize("a", OFFSETS)
def test_the_view_is_that_of_the_sonar_about_the_point(a):
    view = circular.view_angle(ANGLES, a)
    sonar = np.exp(1j * ANGLES)
    np.testing.assert_allclose(np.abs(sonar - a) * np.exp(1j * view), sonar - a, atol=1e-15)


@pytest.mark.parametrize("a", OFFSETS)
def test_the_inverse_undoes_it(a):
    # near the sonar a view angle turns 1/(1 - a) times as fast as the track: so do its rounding errors on the way back
    np.testing.assert_allclose(circular.track_angle(circular.view_angle(ANGLES, a), a), ANGLES, rtol=0, atol=1e-13)
    back = circular.view_angle(circular.track_angle(ANGLES, a), a)
    np.testing.assert_allclose(back, ANGLES, rtol=0, atol=1e-13 if a < 0.99 else 1e-9)


# a, angle, and there view angle, track angle, rate and density: atan2, angle - asin(a sin), and the quotients of Eqs 2 and 3's
# derivatives, evaluated by mpmath with 60 digits
EXACT = [
    (0.2, 1e-9, 1.25e-9, 8e-10, 1.25, 0.8),
    (0.2, 0.001, 0.0012499999218750185, 0.0008000000319999989, 1.2499997656250927, 0.8000000959999949),
    (0.2, 1.0, 1.1864909267459907, 0.8309010727165542, 1.082609770073946, 0.8903759504391527),
    (0.9, 1e-14, 1.0000000000000003e-13, 9.999999999999997e-16, 10.000000000000002, 0.09999999999999998),
    (0.9, 0.001, 0.009999715015403261, 0.00010000002850000894, 9.999145077014315, 0.1000000855000448),
    (0.9, 1.0, 1.9747512888223278, 0.14079461617627353, 0.613438815985137, 0.2553710641013663),
    (0.9, 3.0, 3.0670639838995273, 2.8726480282779185, 0.5264477609149809, 1.8982676956320563),
    (0.9, 3.141592652589793, 3.1415926530634772, 3.141592651689793, 0.5263157894736842, 1.9),
    (1 - 1e-12, 1e-14, 0.00999988788663978, 9.999778782798786e-27, 999922125572.7994, 9.999778782798785e-13),
    (1 - 1e-12, 1e-9, 1.5697963497499272, 9.999778782798786e-22, 999977.3783477419, 9.999778782798785e-13),
    (1 - 1e-12, 0.001, 1.5712963257949188, 9.999782116059714e-16, 0.5000009999779617, 9.999788782584235e-13),
    (1 - 1e-12, 1.0, 2.0707963267939813, 1.5573732721152136e-12, 0.5000000000010877, 3.4254430424336724e-12),
    (1 - 1e-12, 3.0, 3.070796326794861, 2.8584073464103494, 0.5000000000002512, 1.9999999999989797),
    (1 - 1e-12, 3.141592652589793, 3.141592653089793, 3.141592651589793, 0.50000000000025, 1.999999999999),
]


@pytest.mark.parametrize(("a", "angle", "view", "track", "rate", "density"), EXACT)
def test_no_digits_are_lost(a, angle, view, track, rate, density):
    found = [f(angle, a) for f in (circular.view_angle, circular.track_angle, circular.view_rate, circular.view_density)]
    np.testing.assert_allclose(found, [view, track, rate, density], rtol=1e-14)


@pytest.mark.parametrize("a", (0.0, 0.2, 0.5, 0.9))
def test_jacobian(a):
    theta, step = np.linspace(-3, 3, 301), 1e-5
    slope = (circular.view_angle(theta + step, a) - circular.view_angle(theta - step, a)) / (2 * step)
    rate = circular.view_rate(theta, a)
    np.testing.assert_allclose(slope, rate, rtol=1e-7)
    np.testing.assert_allclose(rate * circular.view_density(circular.view_angle(theta, a), a), 1, rtol=1e-14)
    circle = -np.pi + np.arange(4096) * (2 * np.pi / 4096)
    assert np.mean(circular.view_rate(circle, a)) == pytest.approx(1, abs=1e-12)
    assert circular.view_density(0.0, a) == pytest.approx(1 - a, rel=1e-15)
    assert circular.view_density(np.pi, a) == pytest.approx(1 + a, rel=1e-15)
    opposite = circular.view_density(theta, a) + circular.view_density(theta + np.pi, a)
    np.testing.assert_allclose(opposite, 2, rtol=1e-14)


def test_full_view_radius():
    assert circular.full_view_radius(40.0, np.pi / 3) == pytest.approx(20.0, rel=1e-15)
    assert circular.full_view_radius(40.0, np.pi) == pytest.approx(40.0, rel=1e-15)


def test_virtual_sampling_of_the_papers_target():
    # circle of 40 sqrt(2) m, target at (20, 20) m, 15 mm: a virtual circle of 20 sqrt(2) m (printed: 20 m), half as many views
    assert circular.virtual_angles(40 * np.sqrt(2), 0.015, 0.0).size == 47391
    view = circular.virtual_angles(40 * np.sqrt(2), 0.015, 0.5)
    assert view.size == 23696
    assert np.diff(view).max() * 20 * np.sqrt(2) <= 0.0075
    np.testing.assert_allclose(np.diff(view, append=view[0] + 2 * np.pi), 2 * np.pi / view.size, rtol=1e-9)


@pytest.mark.parametrize("waves", (0.1, 1.0, 100.0, 1e4))
def test_a_patch_needs_no_more_views_than_its_bessel_functions_reach(waves):
    n = circular.angles_for_patch(waves, 1.0)
    z = 8 * np.pi * waves
    assert np.abs(jv(n, z)) < 1e-7
    # and not many less: at n = z the aliased term is within a factor of a few of J0's own envelope
    assert np.abs(jv(int(z), z)) > 0.1 * z ** (-1 / 3)


def test_few_views_alias_as_predicted():
    r, angle, n = 0.5, 0.3, 12
    view = np.arange(n) * 2 * np.pi / n
    total = np.mean(np.exp(2j * 2 * np.pi * r * np.cos(view - angle)))
    z = 4 * np.pi * r
    series = jv(0, z) + sum(2 * 1j ** (m * n) * jv(m * n, z) * np.cos(m * n * angle) for m in (1, 2, 3))
    assert total == pytest.approx(series, abs=1e-14)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: circular.view_angle(0.1, 1.0), ValueError, r"offset=1.0: expected a number in \[0, 1\)"),
        (lambda: circular.view_angle(0.1, -0.1), ValueError, "offset=-0.1"),
        (lambda: circular.view_angle(0.1, np.nan), ValueError, "offset=nan"),
        (lambda: circular.view_angle([0.1, np.inf], 0.5), ValueError, "track_angle: inf at index"),
        (lambda: circular.track_angle("x", 0.5), TypeError, "view_angle: expected real numbers"),
        (lambda: circular.view_density([1j], 0.5), TypeError, "view_angle: expected real numbers"),
        (lambda: circular.view_rate(None, 0.5), TypeError, "track_angle"),
        (lambda: circular.full_view_radius(-1.0, 1.0), ValueError, "radius=-1.0"),
        (lambda: circular.full_view_radius(1.0, 4.0), ValueError, "beamwidth=4.0"),
        (lambda: circular.virtual_angles(10.0, 0.0, 0.5), ValueError, "wavelength=0.0"),
        (lambda: circular.angles_for_patch(np.inf, 0.015), ValueError, "patch_radius=inf"),
    ],
)
def test_what_cannot_be_is_named(call, error, text):
    with pytest.raises(error, match=text):
        call()
