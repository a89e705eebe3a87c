"""The palm's ball under a lateral load, to the full depth of its table."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import Pose, PressHistory, RangeError
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm
from palpate.sensors.palm.probe_stress import is_pulled_ball, laid_of

SPEC = palm.cropped(palm.debug(), 40, "small")
MM = 1e-3


def pressed(depth_mm, lateral_n, x_mm=0.0, y_mm=0.0, spec=SPEC):
    return palm.press(spec, Pose(x_mm * MM, y_mm * MM, depth_mm * MM), None, lateral_n)


def below(light, depth_m, spec=SPEC):
    """Rows in the membrane below the dimple."""
    z = spec.fringes.down_m
    return light[(z > depth_m) & (z < spec.thickness_m)]


def rms(difference):
    return float(np.sqrt(np.mean(difference**2)))


@pytest.mark.parametrize("depth_mm", [0.1, 6.0])
def test_a_lateral_load_is_allowed_to_the_tables_full_depth(depth_mm):
    still = pressed(depth_mm, (0.0, 0.0))
    asked = 0.25 * still.force_n * np.array([0.6, -0.8])
    pulled = pressed(depth_mm, tuple(asked))
    cell = (pulled.x_m[1] - pulled.x_m[0]) ** 2
    assert is_pulled_ball(pulled)
    assert not is_pulled_ball(still)
    assert pulled.force_n == still.force_n
    assert pulled.radius_m == still.radius_m
    np.testing.assert_allclose(pulled.lateral_n, asked)
    np.testing.assert_allclose(pulled.shear_pa.sum(axis=(1, 2)) * cell, asked, rtol=1e-6)


@pytest.mark.parametrize("depth_mm", [3.0])
def test_a_vanishing_pull_shows_the_balls_own_picture(depth_mm):
    """Stress laid out on planes against the march of rings: the same light, but for straight lines."""
    place = 4.0, -3.0
    own = palm.render_clean(pressed(depth_mm, (0.0, 0.0), *place), SPEC, exact=True)
    pulled = palm.render_clean(pressed(depth_mm, (1e-7, 0.0), *place), SPEC)
    assert rms(below(own[0] - pulled[0], depth_mm * MM)) < 2e-3
    assert rms(own[1] - pulled[1]) < 0.03


def test_a_pull_to_the_right_is_that_to_the_left_mirrored():
    left, right = (palm.render_clean(pressed(4.0, (force, 0.0)), SPEC)[0] for force in (-3.0, 3.0))
    assert rms(below(left - left[:, ::-1], 4e-3)) > 0.05, "and is not its own mirror"
    np.testing.assert_allclose(below(left, 4e-3), below(right, 4e-3)[:, ::-1], atol=2e-3)


def test_the_base_holds_the_pull_and_the_press():
    contact = pressed(4.0, (2.0, -1.0))
    near = laid_of(SPEC, contact).far.stress_pa[-1]
    cell = laid_of(SPEC, contact).far.cell_m[0] ** 2
    held = near[3].sum() * cell, near[4].sum() * cell
    # Some 5 % are carried next to the rim, where the stress is faded out.
    assert -1.0 < held[0] / 2.0 < -0.75
    assert 0.75 < held[1] / 1.0 < 1.0


def test_a_rim_that_is_applied_has_its_part_of_the_load():
    applied = replace(SPEC, rim="applied")
    still = pressed(4.0, (0.0, 0.0), 0.0, 20.0, applied)
    held = pressed(4.0, still.lateral_n, 0.0, 20.0, applied)
    more = pressed(4.0, (still.lateral_n[0] + 1.0, still.lateral_n[1]), 0.0, 20.0, applied)
    assert still.lateral_n[1] < -0.1
    assert held.force_n == more.force_n == still.force_n
    cell = (more.x_m[1] - more.x_m[0]) ** 2
    np.testing.assert_allclose(more.shear_pa.sum(axis=(1, 2)) * cell, [1.0, 0.0], atol=1e-6)
    assert more.lateral_n[1] == pytest.approx(still.lateral_n[1])
    far = laid_of(applied, more).far
    held_x, held_y = (float(far.stress_pa[-1, which].sum()) * far.cell_m[0] ** 2 for which in (3, 4))
    assert -1.0 < held_x < -0.75
    assert abs(held_y) < 0.05, "the rim's own load is none of the pull's"


@pytest.mark.parametrize("pull", [(-0.2, 0.1)])
def test_what_a_path_builds_up_comes_on_top_of_the_rims_load(pull):
    """As a virtual rig's force has both: a pull that vanishes leaves the press as it was."""
    sensor, pose = Palm(replace(SPEC, rim="applied")), Pose(18 * MM, -3 * MM, 3 * MM)
    ball = sensor.probe("sphere:10")
    still = sensor.press(ball, pose)
    assert still.lateral_n[0] < -0.05
    one = sensor.press(ball, pose, history=PressHistory(path_m=((1e-4, 0.0),), lateral_n=pull))
    np.testing.assert_allclose(one.lateral_n, np.add(still.lateral_n, pull), rtol=1e-9)
    assert one.history.lateral_n == pull
    cell = (one.x_m[1] - one.x_m[0]) ** 2
    np.testing.assert_allclose(one.shear_pa.sum(axis=(1, 2)) * cell, pull, atol=1e-9)
    barely = sensor.press(ball, pose, history=PressHistory(path_m=((1e-9, 0.0),)))
    np.testing.assert_allclose(barely.lateral_n, still.lateral_n, atol=1e-5)


def test_a_membrane_with_friction_or_without_a_table_keeps_to_linear_layers():
    for spec in (replace(SPEC, friction=0.5), replace(SPEC, thickness_m=8e-3)):
        assert not is_pulled_ball(pressed(1.0, (0.2, 0.0), spec=spec))
        with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
            pressed(1.6, (0.2, 0.0), spec=spec)
    with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
        palm.press(SPEC, Pose(0.0, 0.0, 2e-3), None, (0.2, 0.0), 1e-4)


def test_a_path_builds_up_the_tables_force():
    sensor = Palm(SPEC)
    ball, pose = sensor.probe("sphere:10"), Pose(0.0, 0.0, 5e-3)
    law = sensor.force_law(ball)
    stiff = float(np.interp(5e-3, law.depth_m, law.lateral_n_m))
    for shift in (1e-5, 5e-4):
        history = PressHistory(path_m=((0.0, 0.0), (0.6 * shift, 0.8 * shift)))
        x, y = sensor.press(ball, pose, history=history).lateral_n
        assert y / x == pytest.approx(0.8 / 0.6)
        assert 0.93 * stiff * shift < math.hypot(x, y) <= stiff * shift * (1 + 1e-6)
    assert sensor.known_depth_m(ball, lateral=True) == pytest.approx(6e-3)
    with refused("sliding", RangeError, match=r"2\.25 mm"):
        sensor.press(ball, pose, history=PressHistory(path_m=((3e-3, 0.0),)))
