"""An upright punch on the palm: by its finite-strain table, and by linear layers where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import Pose, RangeError
from palpate.mechanics.axisymmetric.shape_table import PunchTable, is_punched
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.sensors import palm
from palpate.sensors.palm.palm_press import (
    LINEAR_DEPTH_M,
    has_table,
    stack_of,
    table_of,
)
from palpate.sensors.palm.palm_sensor import Palm
from palpate.sensors.palm.probe_shapes import gap_of

SPEC = palm.preset("debug")
PUNCHES = ("punch:6", "punch:8", "punch:10")
DEEPEST = PunchTable.load("punch-h25-mu0").greatest_depth * 4e-3


def pressed(words, depth_m, x_m=0.0, y_m=0.0, spec=SPEC, lateral_n=(0.0, 0.0)):
    return palm.press(spec, Pose(x_m, y_m, depth_m), palm.parse_probe(words), lateral_n)


def linear_force(words, depth_m):
    """Of linear layers, also beyond the depth to which the palm allows them."""
    x = (np.arange(160) + 0.5) * 0.09e-3 - 7.2e-3
    gap = gap_of(palm.parse_probe(words), x, x, (0.0, 0.0))
    return press_stack(stack_of(SPEC), gap, x, x, depth_m=depth_m).force_n


@pytest.mark.parametrize("words", PUNCHES)
def test_a_punch_is_pressed_by_its_table_by_itself_to_the_tables_depth(words):
    probe = palm.parse_probe(words)
    table = table_of(SPEC, probe)
    for share in (0.1, 0.5, 1.0):
        contact = pressed(words, share * table.greatest_depth * probe.radius_m)
        assert is_punched(contact)
        unit = SPEC.youngs_modulus_pa * probe.radius_m**2
        assert contact.force_n == pytest.approx(table.at(share * table.greatest_depth).force * unit, rel=1e-9)
    most = table.greatest_depth * probe.radius_m
    assert most > LINEAR_DEPTH_M
    with refused("outside-table", RangeError, match=f"{most * 1e3:g} mm"):
        pressed(words, most + 0.01e-3)


@pytest.mark.parametrize("words", PUNCHES)
def test_a_light_press_is_that_of_linear_layers_and_a_deep_one_is_not(words):
    excess = {d: linear_force(words, d) / pressed(words, d).force_n - 1 for d in (0.05e-3, 0.4e-3, 1.5e-3)}
    assert abs(excess[0.05e-3]) < 0.012
    assert abs(excess[0.05e-3]) < excess[0.4e-3] < excess[1.5e-3]


@pytest.mark.parametrize("words", ["punch:7", "punch:8@5:0"])
def test_without_a_table_linear_layers_press_and_hold_to_their_depth(words):
    assert not has_table(SPEC, palm.parse_probe(words))
    contact = pressed(words, 1.2e-3)
    assert not is_punched(contact)
    with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
        pressed(words, 1.6e-3)


@pytest.mark.parametrize("depth", [1.5e-3])
def test_a_lateral_load_leaves_a_punchs_press_as_it_is_and_its_shear_is_odd_in_it(depth):
    alone = pressed("punch:8", depth)
    pull = 0.4 * alone.force_n
    there, back = (pressed("punch:8", depth, lateral_n=(sign * pull, 0.0)) for sign in (1, -1))
    for contact in (there, back):
        assert is_punched(contact)
        assert (contact.force_n, contact.radius_m) == (alone.force_n, alone.radius_m)
        np.testing.assert_array_equal(contact.pressure_pa, alone.pressure_pa)
    np.testing.assert_allclose(there.shear_pa, -back.shear_pa, atol=1e-6 * np.abs(there.shear_pa).max())
    cell = (alone.x_m[1] - alone.x_m[0]) ** 2
    assert there.shear_pa[0].sum() * cell == pytest.approx(pull, rel=2e-3)


def test_other_membranes_leave_a_punch_to_linear_layers_and_so_does_a_deep_pull():
    with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
        pressed("punch:8", 2e-3, lateral_n=(0.5, 0.0))
    for other in (
        replace(SPEC, thickness_m=9.5e-3),
        replace(SPEC, friction=0.5),
        replace(SPEC, poisson_ratio=0.48),
        replace(SPEC, diameter_m=50e-3),
    ):
        assert not has_table(other, palm.parse_probe("punch:8"))


def test_a_rigs_law_of_a_punch_is_the_tables_and_reaches_as_deep():
    sensor, probe = Palm(SPEC), palm.parse_probe("punch:8")
    law = sensor.force_law(probe)
    assert law.greatest_m == pytest.approx(DEEPEST)
    for depth in (0.4e-3, 1.5e-3, 3e-3):
        alone = sensor.press(probe, Pose(0.0, 0.0, depth))
        assert np.interp(depth, law.depth_m, law.force_n) == pytest.approx(alone.force_n, rel=1e-4)
        assert np.interp(depth, law.depth_m, law.radius_m) == pytest.approx(alone.radius_m, rel=0.01)
    assert sensor.known_depth_m(probe) == pytest.approx(DEEPEST)
    assert sensor.known_depth_m(probe, lateral=True) == LINEAR_DEPTH_M
