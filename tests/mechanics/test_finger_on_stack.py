"""An elastic ball on layers: Hertz's limits, one layer's known law, the grid's solution, mirrored pairs."""

import math

import numpy as np
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import Body
from palpate.mechanics.layers.bonded_layer import sphere_from_radius
from palpate.mechanics.layers.contact_solver import paraboloid, press_stack
from palpate.mechanics.layers.influence import press_course, press_to_radius
from palpate.mechanics.layers.stack import ElasticLayer, Stack

FINGER = Body(100e3 / 0.75, 15e-3)
RIGID = Body(math.inf, 15e-3)


def layers(*moduli_pa: float, thickness_m: float = 7e-3, nu: float = 0.49) -> Stack:
    return Stack(tuple(ElasticLayer(thickness_m, E, nu) for E in moduli_pa))


def test_on_a_half_space_it_is_the_pair_of_hertz_and_parts_go_as_compliances() -> None:
    flat = Stack((ElasticLayer(math.inf, 2e5, 0.49),), "half-space")
    pair = Body(flat.layers[0].reduced_modulus_pa, math.inf).against(FINGER)
    press = press_to_radius(flat, FINGER, 4e-3)
    assert_allclose(press.approach_m, 4e-3**2 / FINGER.radius_m)
    assert_allclose(press.force_n, pair.force_n(press.approach_m))
    assert_allclose(press.sunk_m / press.approach_m, pair.modulus_pa / flat.layers[0].reduced_modulus_pa)


def test_two_layers_of_one_material_are_one() -> None:
    one = press_to_radius(layers(2e5, thickness_m=14e-3), FINGER, 6e-3)
    assert_allclose(press_to_radius(layers(2e5, 2e5), FINGER, 6e-3), one, rtol=1e-9)


def test_a_rigid_ball_on_one_layer_is_the_exact_law_of_one_layer() -> None:
    ball = Body(math.inf, 0.5)  # so large that ball and paraboloid are one
    press = press_to_radius(layers(2e5), ball, 5e-3)
    depth, force = sphere_from_radius(5e-3, 0.5, 7e-3, 2e5, 0.49)
    assert_allclose([press.approach_m, press.force_n], [depth, force], rtol=1e-4)
    assert_allclose(press.sunk_m, press.approach_m)


def test_a_rigid_ball_on_two_layers_is_the_grids_solution() -> None:
    stack = layers(2e5, 6e4)
    press = press_to_radius(stack, RIGID, 4e-3)
    x = np.linspace(-6e-3, 6e-3, 121)
    grid = press_stack(stack, paraboloid(x, x, 15e-3), x, x, depth_m=press.approach_m)
    assert_allclose(grid.force_n, press.force_n, rtol=2e-3)
    assert_allclose(grid.area_m2, np.pi * press.radius_m**2, rtol=1e-2)


def test_at_one_contact_the_stiffness_is_a_flat_punchs_whatever_the_curvature() -> None:
    stack, a, step = layers(3e5, 6e4), 4e-3, 1e-5
    low, high = (press_to_radius(stack, FINGER, a + s * step) for s in (-1, 1))
    slope = (high.force_n - low.force_n) / (high.approach_m - low.approach_m)
    flat = press_to_radius(stack, Body(FINGER.modulus_pa, 30e-3), a)  # same layers, half the curvature
    curved = press_to_radius(stack, FINGER, a)
    assert_allclose(2 * flat.force_n, curved.force_n)
    assert_allclose(2 * flat.approach_m, curved.approach_m)
    ends = [press_to_radius(stack, Body(FINGER.modulus_pa, 30e-3), a + s * step) for s in (-1, 1)]
    assert_allclose((ends[1].force_n - ends[0].force_n) / (ends[1].approach_m - ends[0].approach_m), slope)


def test_a_course_begins_at_rest_rises_and_ends_where_it_is_told() -> None:
    course = press_course(layers(2e5, 1e5), FINGER, count=12, until_n=1.5)
    assert_allclose(course.force_n[[0, -1]], [0.0, 1.5], rtol=1e-9)
    for column in (course.radius_m, course.approach_m, course.force_n, course.sunk_m):
        assert len(column) == 13
        assert column[0] == 0.0
        assert (np.diff(column) > 0).all()


def test_small_strain_ends_at_half_the_ball_or_a_fifth_of_the_stack() -> None:
    whole = press_course(layers(2e6, 2e6), FINGER, count=2)
    assert_allclose(whole.radius_m[-1], FINGER.radius_m / 2)
    soft = press_course(layers(2e3, 2e3, thickness_m=3e-3), FINGER, count=2)
    assert_allclose(soft.sunk_m[-1], 0.2 * 6e-3)
    for force in (0.0, 1.01 * soft.force_n[-1], math.nan):
        with refused("outside-law", RangeError):
            press_course(layers(2e3, 2e3, thickness_m=3e-3), FINGER, until_n=force)
    with refused("outside-law", RangeError, match=r"7\.5"):
        press_to_radius(layers(2e5), FINGER, 8e-3)
