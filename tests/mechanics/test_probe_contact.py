"""Probes without an axis from the lightest touch on: Hertz, linear layers, and how they join the tables."""

import math

import numpy as np
import pytest
from tests.mechanics.test_probe_table import TABLES, probe_of, rounded_gap
from tests.refusals import refused

from palpate.core import InputError, Pose, RangeError
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.light_touch import MAX_LIGHT, MIN_LIGHT, RoundedBody, light_law, light_touch
from palpate.mechanics.probe_contact import (
    LIGHT,
    is_tabled_probe,
    light_pressure,
    press_probe,
    probe_law,
    share_of_table,
)

H, E, NU = 10e-3, 0.32e6, 0.49
GRID = (np.arange(241) - 120) * 0.12e-3


def body_of(table):
    return RoundedBody(table.shape, table.radius, table.length, table.rounding)


def pressed(table, depth, turn=0.0, x_m=0.0, y_m=0.0):
    pose = Pose(x_m, y_m, depth * H)
    return press_probe(table, probe_of(table, turn), pose, E, H, 28.5e-3, GRID + x_m, GRID + y_m)


def patch(contact):
    return contact.touching.sum() * (contact.x_m[1] - contact.x_m[0]) ** 2


def test_two_balls_just_touching_are_two_of_hertz():
    """At 0.01 mm of 5 mm balls, by closed forms."""
    table, depth, reduced = TABLES["two-points:0.25:0.8"], 1e-3, 1.0 / (1.0 - NU**2)
    force = 2 * 4 / 3 * reduced * math.sqrt(table.radius) * depth**1.5
    area = 2 * math.pi * table.radius * depth
    peak = 2 * reduced / math.pi * math.sqrt(depth / table.radius)
    assert probe_law(table, np.array([depth]))[:, 0] == pytest.approx([force, area, peak], rel=0.025)
    contact = pressed(table, depth)
    assert contact.force_n == pytest.approx(force * E * H**2, rel=0.025)
    assert contact.pressure_pa.max() == pytest.approx(peak * E, rel=0.3)  # a contact 2.7 cells wide
    assert pressed(table, 5 * depth).pressure_pa.max() == pytest.approx(math.sqrt(5) * peak * E, rel=0.1)
    shape_of_the_first_depth = (
        pressed(table, LIGHT).pressure_pa.max() * force / probe_law(table, np.array([LIGHT]))[0, 0]
    )
    assert shape_of_the_first_depth / E < peak / 5, "kept, it would press a seventh as hard"


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.cases(1)
def test_a_light_touch_on_finer_cells_is_the_same(name):
    table = TABLES[name]
    touch = light_touch(body_of(table), NU, 5e-3)
    half = touch.x[-1], touch.y[-1]
    x, y = (np.linspace(-end, end, 2 * len(axis)) for end, axis in zip(half, (touch.x, touch.y), strict=True))
    finer = press_stack(Stack((ElasticLayer(1.0, 1.0, NU),)), rounded_gap(table, x, y), x, y, depth_m=5e-3)
    assert touch.force == pytest.approx(finer.force_n, rel=1e-3)
    assert touch.area == pytest.approx(finer.area_m2, rel=0.06)
    assert touch.pressure.max() == pytest.approx(finer.pressure_pa.max(), rel=0.02)
    law = light_law(body_of(table), NU)(np.array([5e-3]))[:, 0]
    assert law == pytest.approx([touch.force, touch.area, touch.pressure.max()], rel=0.03)
    assert law[0] == pytest.approx(touch.force, rel=1e-3)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.cases(1)
def test_linear_layers_and_the_table_join_without_a_step(name):
    table, eps = TABLES[name], 1e-6
    for depth in (MIN_LIGHT, LIGHT, MAX_LIGHT):
        below, above = pressed(table, depth * (1 - eps)), pressed(table, depth * (1 + eps))
        for part in ("force_n", "radius_m"):
            assert getattr(below, part) == pytest.approx(getattr(above, part), rel=1e-4)
        for part in ("pressure_pa", "displacement_m"):
            most = getattr(above, part).max()
            np.testing.assert_allclose(getattr(below, part), getattr(above, part), atol=1e-3 * most)
        assert patch(below) == pytest.approx(patch(above), rel=0.01)
    alone = table.at(LIGHT)
    assert probe_law(table, np.array([LIGHT]))[2, 0] > 1.05 * alone.peak_pressure or "two" in name


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.cases(1)
def test_a_light_touch_sinks_the_skin_as_deep_as_the_probe_where_cells_are_wider_than_contact(name):
    """Linear layers under the pressure of the grid's cells alone sink 0.6 to 0.85 of 0.01 mm."""
    for depth in (1e-3, LIGHT):
        sunk = pressed(TABLES[name], depth).displacement_m.max()
        assert sunk == pytest.approx(depth * H, rel=0.05)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.cases(1)
def test_in_between_pressure_and_surface_are_the_sum_of_their_shares(name):
    table, depth = TABLES[name], 0.018
    share = float(share_of_table(depth))
    assert 0.2 < share < 0.5
    assert (share_of_table(LIGHT), share_of_table(MAX_LIGHT)) == (0.0, 1.0)
    contact, pose = pressed(table, depth, 0.3), Pose(0.0, 0.0, depth * H)
    cell = (GRID[1] - GRID[0]) ** 2
    assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=0.01)
    light = light_pressure(table, probe_of(table, 0.3), pose, H, GRID, GRID)
    assert light.sum() * cell / H**2 == pytest.approx(
        float(light_law(body_of(table), NU)(np.array([depth]))[0, 0]), rel=1e-9
    )
    rest = contact.pressure_pa / E - (1 - share) * light
    assert rest.min() > -1e-9
    assert rest.sum() * cell / H**2 == pytest.approx(share * table.at(depth).force, rel=0.015)
    assert contact.displacement_m.max() == pytest.approx(depth * H, rel=0.04)


@pytest.mark.parametrize("depth", [0.006, 0.1])
def test_a_turned_probes_contact_is_turned_and_moved_with_it(depth):
    table = next(iter(TABLES.values()))
    along, across = pressed(table, depth), pressed(table, depth, math.pi / 2, 4e-3, -3e-3)
    assert is_tabled_probe(along)
    np.testing.assert_allclose(across.pressure_pa, along.pressure_pa.T, atol=1e-6 * along.pressure_pa.max())
    np.testing.assert_allclose(across.displacement_m, along.displacement_m.T, atol=1e-9)
    assert np.abs(across.pressure_pa - along.pressure_pa).max() > 0.1 * along.pressure_pa.max()


def test_a_press_holds_to_the_tables_depth_and_to_the_rim():
    table = next(iter(TABLES.values()))
    for depth in (-1e-2, 1.001 * table.greatest_depth, math.nan):
        with refused("outside-table", RangeError):
            pressed(table, depth)
    for depth in (1e-3, 0.1):
        with refused("contact-over-rim", RangeError):
            pressed(table, depth, x_m=25e-3)


@pytest.mark.parametrize("turn", [0.0, math.pi / 2])
def test_a_grid_that_does_not_hold_a_light_contact_is_refused(turn):
    table, pose = TABLES["cylinder:0.3:1.2"], Pose(0.0, 0.0, 1e-4)
    short = GRID[np.abs(GRID) < 5e-3]
    across = (short, GRID) if turn == 0.0 else (GRID, short)
    with pytest.raises(InputError, match="along x" if turn == 0.0 else "along y"):
        press_probe(table, probe_of(table, turn), pose, E, H, 28.5e-3, *across)
    press_probe(table, probe_of(table, turn), pose, E, H, 28.5e-3, *across[::-1])
