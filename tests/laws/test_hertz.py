import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.mechanics.half_space import hertz

R, E, NU = 5e-3, 0.3e6, 0.49
BALL = Probe("sphere", R)


def pressed(depth_m, **grid):
    return hertz.press(BALL, Pose(0.0, 0.0, depth_m), E, NU, **grid)


def test_the_closed_forms_give_the_golden_numbers():
    # eight digits are given
    assert hertz.force_from_depth(1e-3, R, E, NU) == pytest.approx(1.1770328, rel=5e-8)
    assert hertz.contact_radius(1e-3, R) == pytest.approx(2.2360680e-3, rel=5e-8)
    assert hertz.peak_pressure(1e-3, R, E, NU) == pytest.approx(0.11239835e6, rel=5e-8)


def test_the_golden_numbers_beyond_the_range_follow_by_scaling():
    # 2 mm of the 5 mm ball is refused; a ball four times as large doubles F and a, and halves p0
    d, larger = 2e-3, 4 * R
    assert hertz.force_from_depth(d, larger, E, NU) == pytest.approx(2 * 3.3291514, rel=5e-8)
    assert hertz.contact_radius(d, larger) == pytest.approx(2 * 3.1622777e-3, rel=5e-8)
    assert hertz.peak_pressure(d, larger, E, NU) == pytest.approx(0.15895527e6 / 2, rel=5e-8)


def test_the_numbers_agree_with_contact_mechanics_reference_values():
    # published by ContactMechanics' own tests for E* = 5, R = 4, F = 7
    d = hertz.depth_from_force(7.0, 4.0, 5.0, 0.0)
    assert d == pytest.approx(0.6507879989531481, rel=1e-12)
    assert hertz.contact_radius(d, 4.0) == pytest.approx(1.6134286460245437, rel=1e-12)
    assert hertz.peak_pressure(d, 4.0, 5.0, 0.0) == pytest.approx(1.2839257217043503, rel=1e-12)


def test_the_integral_of_pressure_is_the_force():
    contact = pressed(1e-3)
    p0 = hertz.peak_pressure(1e-3, R, E, NU)

    def ring(r):
        return 2 * math.pi * r * hertz.pressure(np.array(r), contact.radius_m, p0)

    # quad's own error on a square-root end is about 1e-9
    assert quad(ring, 0, contact.radius_m)[0] == pytest.approx(contact.force_n, rel=1e-7)


def test_the_pressure_on_the_grid_adds_up_to_the_force():
    contact = pressed(1e-3)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    # 18 cells a radius: the cut rim is worth 0.1 %
    assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=2e-3)


def test_the_work_done_is_the_integral_of_the_force():
    d = 1.2e-3
    work = quad(hertz.force_from_depth, 0, d, args=(R, E, NU))[0]
    closed = 8 / 15 * math.sqrt(R) * hertz.reduced_modulus(E, NU) * d**2.5
    assert work == pytest.approx(closed, rel=1e-7)


def test_inside_the_contact_the_skin_has_the_balls_shape():
    x = np.linspace(-2e-3, 2e-3, 41)
    contact = pressed(1e-3, x_m=x, y_m=np.zeros(1))
    np.testing.assert_allclose(contact.displacement_m[0], 1e-3 - x**2 / (2 * R), rtol=1e-12)


def test_the_surface_is_continuous_at_the_rim():
    a = hertz.contact_radius(1e-3, R)
    inside, outside = hertz.surface_displacement(np.array([a * (1 - 1e-9), a * (1 + 1e-9)]), a, R)
    assert inside == pytest.approx(outside, rel=1e-8)


def test_the_surface_around_the_contact_is_boussinesqs_superposed():
    contact = pressed(1e-3)
    a, p0 = contact.radius_m, hertz.peak_pressure(1e-3, R, E, NU)
    # midpoint rule in angle and in t = sqrt(1 - r^2/a^2), in which the pressure is smooth
    t = (np.arange(400) + 0.5) / 400
    angle = (np.arange(400) + 0.5) / 400 * 2 * np.pi
    r = a * np.sqrt(1 - t**2)[:, None]
    load = p0 * t[:, None] ** 2 * a**2 / 400 * 2 * np.pi / 400
    for at in (1.2 * a, 2 * a, 5 * a):
        distance = np.hypot(at - r * np.cos(angle), r * np.sin(angle))
        superposed = (load / distance).sum() / (math.pi * hertz.reduced_modulus(E, NU))
        assert hertz.surface_displacement(np.array([at]), a, R)[0] == pytest.approx(superposed, rel=1e-5)


def test_the_neglected_roundness_costs_less_than_three_percent_of_force_at_the_limit():
    # Sneddon's exact sphere at the same depth
    def depth(s):
        return s / 2 * math.log((1 + s) / (1 - s))

    s = brentq(lambda s: depth(s) - hertz.MAX_SLOPE**2, 0.1, 0.9)
    exact = (1 + s**2) / 2 * math.log((1 + s) / (1 - s)) - s
    hertzian = hertz.force_from_depth(hertz.MAX_SLOPE**2, 1.0, 1.0, 0.0)
    assert 0.02 < hertzian / exact - 1 < 0.03


def test_depth_force_and_radius_convert_back():
    for d in (1e-6, 3e-4, 1.25e-3):
        force = hertz.force_from_depth(d, R, E, NU)
        assert hertz.depth_from_force(force, R, E, NU) == pytest.approx(d, rel=1e-12)
        assert hertz.depth_from_radius(hertz.contact_radius(d, R), R) == pytest.approx(d, rel=1e-12)


def test_first_touch_does_nothing():
    contact = pressed(0.0)
    assert contact.force_n == contact.radius_m == 0.0
    assert not contact.pressure_pa.any()
    assert not contact.displacement_m.any()
    assert not contact.touching.any()


def test_the_contact_moves_with_the_pose():
    moved = hertz.press(BALL, Pose(2e-3, -1e-3, 1e-3), E, NU)
    row, column = np.unravel_index(moved.pressure_pa.argmax(), moved.pressure_pa.shape)
    assert moved.x_m[column] == pytest.approx(2e-3)
    assert moved.y_m[row] == pytest.approx(-1e-3)


@pytest.mark.parametrize("depth", [-1e-6, 1.26e-3, math.nan, math.inf])
def test_a_depth_outside_the_law_is_refused_with_the_limit(depth):
    with refused("outside-law", RangeError, match=r"0\.00125"):
        pressed(depth)


@pytest.mark.parametrize(
    ("young", "poisson", "code"),
    [
        (0.0, 0.5, "not-positive"),
        (-1.0, 0.5, "not-positive"),
        (math.nan, 0.5, "not-positive"),
        (E, 0.51, "poisson-ratio"),
        (E, -0.1, "poisson-ratio"),
    ],
)
def test_a_material_that_cannot_be_is_refused(young, poisson, code):
    with refused(code, RangeError):
        hertz.press(BALL, Pose(0.0, 0.0, 1e-3), young, poisson)


def test_what_is_not_a_sphere_at_a_place_is_refused():
    with pytest.raises(InputError, match="cylinder"):
        hertz.press(Probe("cylinder", R), Pose(0.0, 0.0, 1e-3), E, NU)
    with pytest.raises(InputError, match="finite"):
        hertz.press(BALL, Pose(math.nan, 0.0, 1e-3), E, NU)
    with pytest.raises(RangeError, match="radius"):
        hertz.press(Probe("sphere", 0.0), Pose(0.0, 0.0, 0.0), E, NU)
    with pytest.raises(RangeError, match="only pushes"):
        hertz.depth_from_force(-1.0, R, E, NU)
    with pytest.raises(RangeError, match="contact radius"):
        hertz.depth_from_radius(2.6e-3, R)
