"""The solver of probes without an axis: its shapes, its elimination, and a ball beside the ball's table."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from palpate.mechanics.axisymmetric.shape_table import SphereTable

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
probe_press = importlib.import_module("probe_press")
shapes = importlib.import_module("finite_strain.rigid_probes")
tables = importlib.import_module("probe_tables")
sys.path.pop(0)

BODIES = {
    "two balls": shapes.Balls(0.25, 0.8),
    "cylinder": shapes.RoundedPrism(1.2, 0.05, 0.3),
    "edge": shapes.RoundedPrism(1.2, 0.05),
}


def coarse(probe, cell=0.15, end=2.85):
    across, down = probe_press.graded([(0.45, cell)], end, 1.6), probe_press.graded([(0.15, cell)], 1.0, 1.6)
    return probe_press.ProbePress(probe_press.quarter(across, across, down), probe=probe)


@pytest.mark.parametrize("name", BODIES)
def test_a_probes_normal_and_its_turning_are_the_slopes_of_its_distance(name):
    places = np.random.default_rng(0).uniform([0, 0, -0.1], [0.75, 0.35, 0.1], (4000, 3))
    distance, normal, turning = BODIES[name].distance(places)
    step = 1e-6
    beside = [[BODIES[name].distance(places + way * step * axis) for way in (1, -1)] for axis in np.eye(3)]
    slope = np.stack([(after[0] - before[0]) / (2 * step) for after, before in beside], axis=-1)
    turned = np.stack([(after[1] - before[1]) / (2 * step) for after, before in beside], axis=-1)
    near = distance > -0.04
    assert np.quantile(np.abs(slope - normal)[near], 0.999) < 1e-8
    assert np.quantile(np.abs(turned - turning)[near], 0.99) < 1e-6
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_a_probe_first_touches_at_its_lowest_places_and_nowhere_else(name):
    x = np.linspace(0.0, 0.55, 56)
    flat = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)
    distance = BODIES[name].distance(flat)[0]
    assert distance.min() == pytest.approx(0.0, abs=1e-12)
    lowest = x[distance < 1e-9]
    assert lowest == pytest.approx([0.4]) if name == "two balls" else lowest[-1] == pytest.approx(0.55)


def test_what_was_eliminated_layer_by_layer_solves_the_whole():
    press = coarse(BODIES["cylinder"], 0.3)
    load, K = press._assemble(np.zeros(press.disc.unknowns), 0.02, stress=0.0)
    found = press._solved(K, load)
    dofs, n = press.disc.dofs.reshape(len(K), 81), len(load)
    at = np.where(dofs < 0, n, dofs)
    whole = np.zeros((n + 1, n + 1))
    for unknowns, brick in zip(at, K, strict=True):
        whole[np.ix_(unknowns, unknowns)] += brick
    np.testing.assert_allclose(found, np.linalg.solve(whole[:n, :n], load), atol=2e-4 * np.abs(found).max())


def test_a_balls_force_and_the_floors_are_those_of_the_balls_table():
    """On bricks of 0.3 radii; on those of 0.2 radii 0.5 % at 0.1 R and 0.07 to 0.3 % from 0.2 to 1.2 R."""
    table, press, radius = SphereTable.load("sphere-h2-mu0"), coarse(shapes.Balls(0.5, 0.0)), 0.5
    for depth, u in press.through([0.1]):
        asked = float(table.force_at(np.array([depth / radius]))[0]) * radius**2
        assert press.force(u, depth) == pytest.approx(asked, rel=0.015)
        assert -press.reaction(u) == pytest.approx(press.force(u, depth), rel=1e-4)


def test_a_solved_layers_odd_stresses_vanish_on_its_planes_of_symmetry():
    press = coarse(BODIES["edge"], 0.3)
    (depth, u), *_ = press.through([0.03])
    nodal = tables.Solved(press, depth, u).stress.values
    for plane, odd, even in ((nodal[0], [4, 5], [0, 1, 2, 3]), (nodal[:, 0], [3, 5], [0, 1, 2, 4])):
        assert np.abs(plane[..., odd]).max() == 0.0
        assert np.all(np.abs(plane[..., even]).max(axis=(0, 1)) > 1e-3)
