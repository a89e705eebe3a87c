import numpy as np
import pytest
from scipy.integrate import quad
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics import line_integrated_stress, secondary_stress

POINTS = [(0.0, 0.3), (0.5, 0.2), (-0.9, 0.1), (1.3, 0.7), (3.0, 2.0), (-6.0, 5.9)]


def flamant(x, z):
    """s_xx - s_zz and 2 s_xz of a unit line load."""
    r4 = (x**2 + z**2) ** 2
    return -2 * z * (x**2 - z**2) / (np.pi * r4), -4 * x * z**2 / (np.pi * r4)


def boussinesq(x, y, z, nu):
    """s_xx - s_zz and 2 s_xz of a unit point load (Johnson 3.19)."""
    r2, rho = x**2 + y**2, np.sqrt(x**2 + y**2 + z**2)
    flat = (1 - z / rho) * (x**2 - y**2) / r2 + z * y**2 / rho**3
    sxx = ((1 - 2 * nu) / r2 * flat - 3 * z * x**2 / rho**5) / (2 * np.pi)
    szz = -3 * z**3 / (2 * np.pi * rho**5)
    return sxx - szz, -3 * x * z**2 / (np.pi * rho**5)


@pytest.mark.parametrize(("x", "z"), POINTS)
def test_the_closed_form_is_flamants_line_load_superposed(x, z):
    def under_parabola(part):
        return quad(lambda s: np.pi / 2 * (1 - s**2) * flamant(x - s, z)[part], -1, 1, epsabs=1e-11)[0]

    closed = line_integrated_stress(np.array(x), np.array(z), 1.0, 1.0)
    assert closed == pytest.approx((under_parabola(0), under_parabola(1)), abs=1e-9)


@pytest.mark.parametrize(("x", "z"), POINTS)
def test_the_closed_form_is_the_stress_below_the_contact_summed_along_the_ray(x, z):
    def summed(part):
        return 2 * quad(lambda y: secondary_stress(x, y, z, 1.0, 1.0)[part], 0, np.inf, epsabs=1e-10)[0]

    closed = line_integrated_stress(np.array(x), np.array(z), 1.0, 1.0)
    assert closed == pytest.approx((summed(0), summed(1)), abs=1e-7)  # quad reaches 1e-8 beside the rim


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_a_point_load_summed_along_the_ray_is_a_line_load_for_any_poissons_ratio(nu):
    x, z = 0.7, 0.4

    def summed(part):
        return 2 * quad(lambda y: boussinesq(x, y, z, nu)[part], 0, np.inf, epsabs=1e-11)[0]

    assert (summed(0), summed(1)) == pytest.approx(flamant(x, z), abs=1e-8)


def test_the_stress_below_the_contact_is_boussinesqs_superposed():
    # midpoint rule in angle and in t = sqrt(1 - r^2), in which Hertz's pressure is smooth
    n = 1000
    t, angle = ((np.arange(n) + 0.5) / n)[:, None], (np.arange(n) + 0.5) / n * 2 * np.pi
    r, load = np.sqrt(1 - t**2), t**2 / n * 2 * np.pi / n
    for x, y, z in [(0.3, 0.2, 0.4), (1.0, 0.0, 0.5), (-0.8, 1.5, 0.3), (2.0, -1.0, 3.0)]:
        parts = boussinesq(x - r * np.cos(angle), y - r * np.sin(angle), z, 0.5)
        superposed = [(load * part).sum() for part in parts]
        assert secondary_stress(x, y, z, 1.0, 1.0) == pytest.approx(superposed, abs=1e-5)


def test_below_the_centre_the_greatest_shear_is_hubers():
    z = np.linspace(0.5, 0.6, 10_001)
    shear = secondary_stress(0.0, 0.0, z, 1.0, 1.0)[0] / 2
    assert shear.max() == pytest.approx(0.26635, abs=5e-6)  # five digits are given
    assert z[shear.argmax()] == pytest.approx(0.5478, abs=1e-4)
    huber = (-1.5 * (1 - z * np.arctan(1 / z)) + 1.5 / (1 + z**2)) / 2
    np.testing.assert_allclose(shear, huber, rtol=1e-10)


def test_far_away_the_fringe_order_is_that_of_a_point_load():
    # N = 2 C F cos(phi) / (pi lambda r); the next term of the series is (3/5)(a/r)^2
    a, p0, r = 2e-3, 1e5, 2.0
    force = 2 / 3 * np.pi * p0 * a**2
    for phi in (0.0, 0.4, 1.2):
        parts = line_integrated_stress(np.array(r * np.sin(phi)), np.array(r * np.cos(phi)), a, p0)
        assert np.hypot(*parts) == pytest.approx(2 * force * np.cos(phi) / (np.pi * r), rel=2 * (a / r) ** 2)


def test_the_greatest_fringe_order_is_0439_of_cf_over_a_lambda():
    z = np.linspace(0.5, 0.8, 3001)
    difference, _ = line_integrated_stress(np.zeros_like(z), z, 1.0, 1.0)
    force = 2 * np.pi / 3
    assert difference.max() / force == pytest.approx(0.439, abs=5e-4)
    assert z[difference.argmax()] == pytest.approx(0.66, abs=5e-3)


def test_series_and_closed_form_meet():
    for x, z in [(0.0, 8.0), (5.0, 6.3), (-7.9, 1.5)]:
        near = line_integrated_stress(np.array(x * 0.999), np.array(z * 0.999), 1.0, 1.0)
        far = line_integrated_stress(np.array(x * 1.01), np.array(z * 1.01), 1.0, 1.0)
        # between the two the field falls as 1/r, and a little faster
        assert np.array(far) * 1.01 / 0.999 == pytest.approx(np.array(near), rel=1e-3, abs=1e-6)


def test_the_surface_itself_is_free_of_retardance():
    x = np.array([-2.0, -1.0, -0.5, 0.0, 1.0, 9.0])
    for part in line_integrated_stress(x, np.zeros_like(x), 1.0, 1.0):
        np.testing.assert_array_equal(part, 0.0)
    for part in secondary_stress(x, 0.0, 0.0, 1.0, 1.0):
        np.testing.assert_allclose(
            part, 0.0, atol=1e-5
        )  # the floor of z on the edge circle leaves sqrt(1e-12)


def test_mirroring_the_ray_mirrors_the_shear_alone():
    x, z = np.array([0.3, 1.0, 12.0]), np.array([0.2, 0.5, 3.0])
    right, left = line_integrated_stress(x, z, 1.0, 1.0), line_integrated_stress(-x, z, 1.0, 1.0)
    np.testing.assert_allclose(left[0], right[0], rtol=1e-12)
    np.testing.assert_allclose(left[1], -right[1], rtol=1e-12)


@pytest.mark.parametrize(
    "law",
    [lambda a, z: line_integrated_stress(0.0, z, a, 1.0), lambda a, z: secondary_stress(0.0, 0.0, z, a, 1.0)],
)
def test_no_contact_and_the_air_have_no_field(law):
    with pytest.raises(RangeError, match="contact radius"):
        law(0.0, np.array(1.0))
    with refused("above-surface", RangeError):
        law(1.0, np.array(-0.1))
