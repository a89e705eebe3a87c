"""Laws of an edge's direction, an angle that repeats after half a turn."""

import math

import numpy as np
import pytest
from tests.refusals import refused

import palpate
from palpate.core import InputError, Pose
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import StrainMeter, axial_difference, edge_direction, on_plane

SENSOR = palpate.sensor("nusense")
SPEC = SENSOR.spec


def seen(contact, rng, sigma=0.05):
    truth = SENSOR.tile_corners(contact)
    places = truth.places_px + sigma * rng.normal(size=truth.places_px.shape)
    return on_plane(ControlPoints(truth.cells, places, np.full(len(places), sigma)), SPEC.lens, SPEC.camera_m)


def press(words, x=0.0, y=0.0, depth=0.0):
    return SENSOR.press(SENSOR.probe(words), Pose(x, y, depth))


def bands(angle, rng=None):
    """Marks pushed away from a line of 20 mm by hand."""
    column, row = np.meshgrid(np.arange(20), np.arange(15))
    cells = np.column_stack([column.ravel(), row.ravel()])
    at = 2.4e-3 * (cells - cells.mean(axis=0))
    along, across = (
        np.array([math.cos(angle), math.sin(angle)]),
        np.array([-math.sin(angle), math.cos(angle)]),
    )
    s, t = at @ along, at @ across
    push = 4e-4 * t / 2e-3 * np.exp(-((t / 3e-3) ** 2) - (s / 10e-3) ** 8)
    sigma = np.full(len(cells), 2e-6)
    noise = np.zeros_like(at) if rng is None else 2e-6 * rng.normal(size=at.shape)
    moved = ControlPoints(cells, at + push[:, None] * across + noise, sigma, "m")
    return StrainMeter(ControlPoints(cells, at, sigma, "m")).fields(moved)


@pytest.mark.parametrize("degrees", [0, 25, 133])
def test_marks_pushed_from_a_line_tell_it(degrees):
    found = edge_direction(bands(math.radians(degrees)))
    assert found is not None
    assert math.degrees(axial_difference(found.angle_rad, math.radians(degrees))) == pytest.approx(0, abs=3)
    assert 0 <= found.angle_rad < math.pi


def test_the_difference_of_directions_knows_no_front():
    a, b = math.radians(179.5), math.radians(0.5)
    assert axial_difference(a, b) == pytest.approx(-math.radians(1))
    assert axial_difference(a + math.pi, b) == pytest.approx(-math.radians(1))
    found = edge_direction(bands(math.radians(179.7)))
    assert found.contains(found.angle_rad + math.pi)
    assert found.contains(found.angle_rad - math.pi + 0.5 * found.half_rad)
    assert not found.contains(found.angle_rad + 2 * found.half_rad)


def test_what_is_round_or_does_not_touch_has_no_direction():
    rng = np.random.default_rng(0)
    meter = StrainMeter(seen(press("round"), rng))
    for x, y, depth in ((4e-3, -3e-3, 1.0e-3), (0, 0, 0)):
        assert edge_direction(meter.fields(seen(press("round", x, y, depth), rng))) is None
    with refused("ratio-range", InputError):
        edge_direction(bands(0.0), 0.9)


@pytest.mark.slow
def test_edges_at_8_newtons_are_told_to_a_degree_and_a_half():
    """Edges of 20 mm on the virtual pad at all angles, corners with noise of 0.05 px."""
    rng = np.random.default_rng(1)
    meter = StrainMeter(seen(press("round"), rng))
    off, held = [], []
    for degrees in np.arange(4.0, 180.0, 11.0):
        words = f"edge:20:{degrees:g}"
        x, y = rng.uniform(-8e-3, 8e-3), rng.uniform(-5e-3, 5e-3)
        found = edge_direction(meter.fields(seen(press(words, x, y, 0.72e-3), rng)))
        assert found is not None
        off.append(abs(math.degrees(axial_difference(found.angle_rad, math.radians(degrees)))))
        held.append(found.contains(math.radians(degrees)))
    assert np.quantile(off, 0.95) < 1.5
    assert np.mean(held) > 0.7
