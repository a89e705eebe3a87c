"""Tables of probes without an axis: balance, work, linear layers under a light touch, and two balls apart."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.core import Probe, RangeError
from palpate.mechanics.axisymmetric.shape_table import SphereTable
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.probe_table import probe_table_for, probe_tables

TABLES = {f"{t.shape}:{t.radius:g}:{t.length:g}": t for t in probe_tables()}
LAYER = Stack((ElasticLayer(1.0, 1.0, 0.49),))
STUDY = Path(__file__).resolve().parents[2] / "tools" / "probe_study.json"
H, E = 10e-3, 0.32e6


def depths_of(table, *shares):
    return [share * table.greatest_depth for share in shares]


def probe_of(table, turn=0.0):
    return Probe(table.shape, table.radius * H, table.length * H, turn)


def summed(values, along, across):
    """Over the whole square, of a quarter's values."""
    return 4.0 * np.trapezoid(np.trapezoid(values, along, axis=-1), across)


def rounded_gap(table, x, y):
    """Height of the table's probe, with its rounded edges, over the flat skin."""
    along, across, e = np.abs(x[None, :]), np.abs(y[:, None]), table.rounding
    if table.shape == "two-points":
        r2 = (along - table.length / 2) ** 2 + across**2
        inside = np.sqrt(np.maximum(table.radius**2 - r2, 0.0))
        return np.where(r2 < table.radius**2, table.radius - inside, np.inf)
    past = np.maximum(along - (table.length / 2 - e), 0.0)
    left = np.sqrt(np.maximum(e**2 - past**2, 0.0))  # of the rounding's radius, so far along
    if table.shape == "cylinder":
        r = table.radius - e + left
        height = table.radius - np.sqrt(np.maximum(r**2 - across**2, 0.0))
        return np.where((past <= e) & (across <= r), height, np.inf)
    slope = math.radians(30)
    tip = across < left * math.sin(slope)
    on_tip = e - np.sqrt(np.maximum(left**2 - across**2, 0.0))
    on_side = e - left / math.cos(slope) + across * math.tan(slope)
    return np.where(past <= e, np.where(tip, on_tip, on_side), np.inf)


def linear_force(table, depth):
    cell = 0.005 if table.shape == "edge" else 0.01
    nx, ny = (2 * round((half + 0.3) / cell) for half in (table.radius + table.length / 2, 0.4))
    x, y = ((np.arange(n) + 0.5 - n / 2) * cell for n in (nx, ny))
    return press_stack(LAYER, rounded_gap(table, x, y), x, y, depth_m=depth).force_n


@pytest.mark.parametrize("name", TABLES)
def test_pressure_and_the_load_on_the_base_sum_to_the_force(name):
    table = TABLES[name]
    for depth in (0.05, *depths_of(table, 1.0)):
        at = table.at(depth)
        assert summed(at.pressure, at.x, at.y) == pytest.approx(at.force, rel=2e-3)
        assert summed(-at.stress[2, -1], at.x, at.y) == pytest.approx(at.force, rel=0.02)


@pytest.mark.parametrize("name", TABLES)
def test_what_pulls_the_layer_beside_the_probe_is_held_by_its_base(name):
    """Balance along x of what lies beyond a plane; with the shear's sign turned it fails."""
    table = TABLES[name]
    for depth in depths_of(table, 0.3, 1.0):
        at = table.at(depth)
        i = int(np.searchsorted(at.x, table.length / 2 + table.radius + 0.15))
        down = at.surface[:, i] + at.zeta[:, None] * (1.0 - at.surface[:, i])
        pull = np.trapezoid(np.trapezoid(at.stress[0, :, :, i], down, axis=0), at.y)
        held = np.trapezoid(np.trapezoid(at.stress[4, -1, :, i:], at.x[i:], axis=1), at.y)
        assert pull == pytest.approx(held, abs=0.06 * abs(held))
        assert pull != pytest.approx(-held, abs=0.06 * abs(held))


@pytest.mark.parametrize("name", TABLES)
def test_the_forces_work_is_the_energy_of_the_layer(name):
    table = TABLES[name]
    rows = [r for r in json.loads(STUDY.read_text())["meshes"] if r["mesh"] == "table" and _is_of(r, table)]
    depth = np.array([r["depth"] for r in rows])
    assert table.depth == pytest.approx(depth)
    assert table.force == pytest.approx([r["force"] for r in rows], abs=1e-6)
    fine = np.linspace(depth[0], depth[-1], 2001)
    work = np.concatenate(
        [[0.0], np.cumsum(np.diff(fine) * (table.force_at(fine)[1:] + table.force_at(fine)[:-1]) / 2)]
    )
    gained = np.array([r["energy"] for r in rows]) - rows[0]["energy"]
    assert np.interp(depth, fine, work)[1:] == pytest.approx(gained[1:], rel=7e-3)
    assert [r["floor"] for r in rows] == pytest.approx([r["force"] for r in rows], rel=1e-3)


def _is_of(row, table):
    return table.shape in row["probe"]


@pytest.mark.parametrize("name", TABLES)
def test_another_mesh_gives_the_same_force(name):
    table = TABLES[name]
    rows = [r for r in json.loads(STUDY.read_text())["meshes"] if r["mesh"] != "table" and _is_of(r, table)]
    for row in rows:
        force = float(table.force_at(np.array([row["depth"]]))[0])
        assert row["force"] == pytest.approx(force, rel=0.016 if row["depth"] >= 0.03 else 0.04)


@pytest.mark.parametrize("name", TABLES)
def test_a_light_press_is_that_of_linear_layers_and_a_deep_one_is_not(name):
    table = TABLES[name]
    for depth in (0.01, 0.03):
        assert linear_force(table, depth) == pytest.approx(
            float(table.force_at(np.array([depth]))[0]), rel=0.03
        )
    deep = min(table.greatest_depth, 0.3)
    assert linear_force(table, deep) > 1.03 * float(table.force_at(np.array([deep]))[0])


# One ball by the three-dimensional solver in the middle of the same square, over the ball's table, whose disc
# ends at half the distance; on a square of that disc's area it is within 0.6 % of the table.
WIDER = {0.04: 1.0086, 0.1: 1.0113, 0.2: 1.0146}


@pytest.mark.parametrize("depth", WIDER)
def test_two_balls_three_radii_apart_press_as_two_alone_in_a_layer_as_wide(depth):
    table = TABLES["two-points:0.25:0.8"]
    ball = SphereTable.load("sphere-h4-mu0")  # of the same radius in a layer as thick
    alone = float(ball.force_at(np.array([depth / table.radius]))[0]) * table.radius**2
    pair = float(table.force_at(np.array([depth]))[0])
    assert pair == pytest.approx(2 * WIDER[depth] * alone, rel=0.02)
    assert pair != pytest.approx(2 * alone, rel=0.01) or depth < 0.1, "in the table's disc the rim would tell"


def test_only_exact_proportions_have_a_table():
    table = next(iter(TABLES.values()))
    probe, membrane = probe_of(table), (H, 28.5e-3, 0.0, 0.49)
    for same in (probe, replace(probe, turn_rad=1.0)):
        found = probe_table_for(same, *membrane)
        assert found is not None
        assert (found.shape, found.radius, found.length) == (table.shape, table.radius, table.length)
    for other in (
        replace(probe, length_m=1.01 * probe.length_m),
        replace(probe, tilt_rad=0.01),
        replace(probe, shape="punch"),
    ):
        assert probe_table_for(other, *membrane) is None
    for other in (
        (0.99 * H, 28.5e-3, 0.0, 0.49),
        (H, 20e-3, 0.0, 0.49),
        (H, 28.5e-3, 0.5, 0.49),
        (H, 28.5e-3, 0.0, 0.48),
    ):
        assert probe_table_for(probe, *other) is None


def test_a_table_ends_where_it_was_solved():
    for table in TABLES.values():
        for depth in (0.0, 0.999 * table.depth[0], 1.001 * table.greatest_depth, math.nan):
            with pytest.raises(RangeError, match="was solved"):
                table.at(depth)
