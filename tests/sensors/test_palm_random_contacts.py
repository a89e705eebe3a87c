import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.mechanics.probe_contact import is_tabled_probe, resultant_of
from palpate.sensors import palm
from palpate.sensors.palm import random_presses
from palpate.sensors.palm.palm_press import FRICTION, greatest_aside, press_layers

SPEC = palm.cropped(palm.palm(), 16, "tiny")


def drawn(kind, count=1, seed=3):
    return random_presses.draw_loads(SPEC, kind, count, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def every():
    return {kind: drawn(kind) for kind in random_presses.NAMES}


def column(found, name):
    return found.values[:, found.names.index(name)]


@pytest.mark.parametrize("kind", random_presses.NAMES)
def test_each_picture_has_its_untouched_one_and_its_values(every, kind):
    found = every[kind]
    assert found.images.shape == found.hanging.shape == (1, 16, 32, 3)
    assert found.values.shape == (1, len(found.names))
    assert len(set(found.names)) == len(found.names)
    assert (np.abs(found.images.astype(int) - found.hanging).mean(axis=(1, 2, 3)) > 1).all()
    assert (column(found, "force_N") > 0).all()


@pytest.mark.parametrize("kind", random_presses.NAMES)
def test_all_is_inside_the_rim(every, kind):
    found, R = every[kind], SPEC.radius_m * 1e3
    for x in [name for name in found.names if name.startswith("x")]:
        away = np.hypot(column(found, x), column(found, "y" + x[1:]))
        assert (np.isnan(away) | (away < R - 2.5)).all()


def test_no_lateral_load_is_more_than_friction_holds(every):
    found = every["lateral"]
    aside = np.hypot(column(found, "force_x_N"), column(found, "force_y_N"))
    assert (aside < random_presses.HELD * FRICTION * column(found, "force_N")).all()
    assert (aside > 0).all()
    assert (column(found, "moment_z_Nmm") != 0).all()


def test_the_forces_of_balls_add_up(every):
    for kind, count in (("two-contacts", 2), ("grasp", 4)):
        found = every[kind]
        each = np.stack([column(found, f"force{i + 1}_N") for i in range(count)])
        assert (np.isnan(each) | (each > 0)).all()
        np.testing.assert_allclose(np.nansum(each, axis=0), column(found, "force_N"), rtol=1e-5)


def test_balls_stand_apart_and_are_numbered_from_the_left(every):
    found = every["two-contacts"]
    x = [column(found, f"x{i}_mm") for i in (1, 2)]
    y = [column(found, f"y{i}_mm") for i in (1, 2)]
    assert (np.hypot(x[1] - x[0], y[1] - y[0]) > 11.9).all()
    assert (x[1] > x[0]).all()
    for i in (1, 2):
        assert ((column(found, f"depth{i}_mm") > 0.39) & (column(found, f"depth{i}_mm") < 1.51)).all()


def test_a_moment_is_kept_with_the_shear_that_adds_up_to_it():
    pose, ball = Pose(4e-3, -2e-3, 1e-3), Probe("sphere", SPEC.indenter_radius_m)
    force, moment = greatest_aside(press_layers(SPEC, pose, ball))
    contact = palm.press(SPEC, pose, ball, (0.3 * force, 0.0), 0.4 * moment)
    wrench = resultant_of(contact, (pose.x_m, pose.y_m))
    assert contact.moment_nm == pytest.approx(0.4 * moment)
    # the solver is asked for 1e-4 of force and moment taken together
    assert wrench.moment_z_nm == pytest.approx(contact.moment_nm, rel=5e-4)
    assert wrench.force_x_n == pytest.approx(0.3 * force, rel=5e-4)
    assert moment == pytest.approx(3 * math.pi / 16 * force * contact.radius_m, rel=0.02), "about Hertz's"


def test_a_moment_that_cannot_be_is_refused():
    ball = Probe("sphere", SPEC.indenter_radius_m)
    with refused("not-finite", InputError):
        palm.press(SPEC, Pose(0.0, 0.0, 1e-3), ball, (0.0, 0.0), math.nan)
    with refused("twisting-slip", RangeError):
        palm.press(SPEC, Pose(0.0, 0.0, 1e-3), ball, (0.0, 0.0), 1.0)
    with refused("no-normal-force", RangeError):
        palm.press(SPEC, Pose(0.0, 0.0, 0.0), ball, (0.0, 0.0), 1e-4)


def test_what_cannot_be_drawn_is_refused():
    with refused("unknown-name", InputError):
        drawn("banana")
    with refused("press-count", InputError):
        drawn("lateral", 0)


def test_a_shape_that_has_a_table_is_pressed_by_it_and_all_others_by_linear_layers():
    """Also of one seed with a membrane that has none, so that no other draw has moved."""
    even, other = SPEC, replace(SPEC, friction=1e-3)
    tabled = set()
    for seed in (4, 9, *range(11, 17)):
        contact, values = random_presses.shapes(even, np.random.default_rng(seed))
        if is_tabled_probe(contact):
            tabled.add((contact.probe.shape, contact.probe.length_m))
        layered, before = random_presses.shapes(other, np.random.default_rng(seed))
        assert (contact.pose, contact.probe, values[:-1]) == (layered.pose, layered.probe, before[:-1])
        linear = press_layers(even, contact.pose, contact.probe).contact.force_n
        assert before[-1] == linear
        assert (values[-1] == linear) != is_tabled_probe(contact)
        by_itself = palm.press(even, contact.pose, contact.probe).force_n
        assert values[-1] == (by_itself if is_tabled_probe(contact) else linear)
    assert tabled == {("edge", 12e-3), ("cylinder", 12e-3)}
