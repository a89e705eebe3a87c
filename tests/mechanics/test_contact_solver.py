import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space import hertz
from palpate.mechanics.layers import contact_solver
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack

R, E, NU, DEPTH = 5e-3, 0.3e6, 0.49, 1e-3
HALF_SPACE = Stack((ElasticLayer(math.inf, E, NU),), "half-space")
E_STAR = HALF_SPACE.layers[0].reduced_modulus_pa


def square(half_width_m, points):
    return np.linspace(-half_width_m, half_width_m, points)


def ball(stack, depth, half_width_m=4e-3, points=96, **pressing):
    x = square(half_width_m, points)
    pressing = pressing or {"depth_m": depth}
    return press_stack(stack, contact_solver.sphere(x, x, R), x, x, **pressing)


@pytest.fixture(scope="module")
def hertzian():
    x = square(3e-3, 128)
    return press_stack(HALF_SPACE, contact_solver.paraboloid(x, x, R), x, x, depth_m=DEPTH)


def test_a_paraboloid_on_a_half_space_is_hertzs_contact(hertzian):
    a = hertz.contact_radius(DEPTH, R)
    assert hertzian.force_n == pytest.approx(hertz.force_from_depth(DEPTH, R, E, NU), rel=1e-3)
    assert hertzian.area_m2 == pytest.approx(math.pi * a**2, rel=1e-2)
    p0 = hertz.peak_pressure(DEPTH, R, E, NU)
    assert hertzian.pressure_pa.max() == pytest.approx(p0, rel=1e-2)
    r = np.hypot(hertzian.x_m, hertzian.y_m[:, None])
    away = np.abs(r - a) > 0.1 * a  # on the rim a square root meets a cell
    np.testing.assert_allclose(hertzian.pressure_pa[away], hertz.pressure(r, a, p0)[away], atol=1e-2 * p0)
    np.testing.assert_allclose(
        hertzian.displacement_m, hertz.surface_displacement(r, a, R), atol=2e-3 * DEPTH
    )


def test_the_skin_has_the_indenters_shape_where_it_touches_and_lies_below_elsewhere(hertzian):
    room = hertzian.displacement_m - (DEPTH - contact_solver.paraboloid(hertzian.x_m, hertzian.y_m, R))
    assert np.abs(room[hertzian.touching]).max() == pytest.approx(hertzian.misfit_m, rel=1e-6)
    assert hertzian.misfit_m <= 1e-5 * DEPTH
    assert room.min() >= -1e-5 * DEPTH


def test_the_depth_of_a_force_gives_the_force_back():
    for stack in (HALF_SPACE, Stack((ElasticLayer(1e-3, 10 * E, NU), ElasticLayer(9e-3, E, NU)))):
        by_depth = ball(stack, 0.6e-3, 3e-3, 64)
        by_force = ball(stack, None, 3e-3, 64, force_n=by_depth.force_n)
        assert by_force.force_n == pytest.approx(by_depth.force_n, rel=1e-9)
        assert by_force.depth_m == pytest.approx(0.6e-3, rel=1e-4)


def test_a_flat_punch_is_as_stiff_as_its_diameter():
    # the counted disc is a rough circle: its radius is right to half a cell
    a, depth = 2e-3, 1e-4
    x = square(2.5e-3, 201)
    found = press_stack(HALF_SPACE, contact_solver.flat_punch(x, x, a), x, x, depth_m=depth)
    assert found.force_n / (2 * a * E_STAR * depth) == pytest.approx(1.0, abs=0.01)
    assert found.area_m2 == pytest.approx(math.pi * a**2, rel=0.01)


# Force over modulus [mm^2] of a sphere of 5 mm at a depth [mm] on a bonded layer [mm], nu = 0.49, by an
# axisymmetric boundary element solution of the same linear problem, given to 0.01.
AXISYMMETRIC = {
    10: {1: 5.08, 2: 15.82, 3: 30.85, 5: 70.09},
}


@pytest.mark.parametrize("thickness_mm", [10])
def test_a_sphere_on_a_bonded_layer_agrees_with_an_axisymmetric_solution(thickness_mm):
    layer = Stack((ElasticLayer(thickness_mm * 1e-3, E, NU),))
    for depth_mm, over_modulus_mm2 in AXISYMMETRIC[thickness_mm].items():
        found = ball(layer, depth_mm * 1e-3, 6e-3)
        assert found.force_n / E * 1e6 == pytest.approx(
            over_modulus_mm2, rel=0.002 + 0.005 / over_modulus_mm2
        )


def test_far_contacts_on_a_bonded_layer_do_not_feel_each_other():
    layer = Stack((ElasticLayer(1e-3, E, NU),))
    x, y = square(8e-3, 192), square(2.5e-3, 60)
    alone = press_stack(layer, contact_solver.sphere(x, y, 3e-3, (-5.2e-3, 0.0)), x, y, depth_m=3e-4)
    pair = contact_solver.balls(x, y, 3e-3, [(-5.2e-3, 0.0, 0.0), (5.2e-3, 0.0, 0.0)])
    both = press_stack(layer, pair, x, y, depth_m=3e-4)
    # ten thicknesses apart the motion of one has faded below 1e-3 under the other
    assert both.force_n == pytest.approx(2 * alone.force_n, rel=2e-3)
    np.testing.assert_allclose(
        both.pressure_pa[:, :96], alone.pressure_pa[:, :96], atol=5e-3 * alone.pressure_pa.max()
    )


def test_what_the_grid_does_not_hold_is_refused():
    with refused("contact-reaches-border", RangeError):
        ball(HALF_SPACE, DEPTH, 2e-3)
    with pytest.raises(RangeError, match="finer grid"):
        ball(HALF_SPACE, 1e-5, 4e-3, 97)
    with refused("depth-below-grid", RangeError):
        ball(HALF_SPACE, 1e-8, 4e-3, 96)
    with refused("grid-too-coarse", RangeError):
        ball(Stack((ElasticLayer(1e-5, E, NU), ElasticLayer(5e-3, E, NU))), DEPTH)


@pytest.mark.parametrize("asked", [{"depth_m": -1e-4}, {"depth_m": math.nan}, {"force_n": -1.0}])
def test_a_depth_or_force_that_cannot_be_is_refused(asked):
    with refused("not-positive", RangeError):
        ball(HALF_SPACE, None, **asked)


def test_a_depth_beyond_the_stack_is_refused():
    for asked in ({"depth_m": 2e-3}, {"force_n": 1e4}):
        with pytest.raises(RangeError, match=r"thickness|border"):
            ball(Stack((ElasticLayer(2e-3, E, NU),)), None, **asked)


def test_input_that_is_no_height_field_on_a_grid_is_refused():
    x = square(4e-3, 40)
    z = contact_solver.sphere(x, x, R)
    with pytest.raises(InputError, match="exactly one"):
        press_stack(HALF_SPACE, z, x, x)
    with pytest.raises(InputError, match="exactly one"):
        press_stack(HALF_SPACE, z, x, x, depth_m=DEPTH, force_n=1.0)
    with pytest.raises(InputError, match="regular grid"):
        press_stack(HALF_SPACE, z, x**3, x, depth_m=DEPTH)
    with pytest.raises(InputError, match="NaN"):
        press_stack(HALF_SPACE, np.where(z > 1e-3, np.nan, z), x, x, depth_m=DEPTH)
    with pytest.raises(InputError, match="negative"):
        press_stack(HALF_SPACE, z - 1e-4, x, x, depth_m=DEPTH)
