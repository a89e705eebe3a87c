import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.layers import contact_solver

X = np.linspace(-6e-3, 6e-3, 61)
Y = np.linspace(-5e-3, 5e-3, 51)
R = 4e-3


def test_every_point_of_the_sphere_is_one_radius_from_its_centre():
    z = contact_solver.sphere(X, Y, R, (1e-3, -5e-4))
    r2 = (X - 1e-3) ** 2 + (Y[:, None] + 5e-4) ** 2
    below = np.isfinite(z)
    np.testing.assert_allclose((r2 + (R - z) ** 2)[below], R**2, rtol=1e-12)
    assert below.sum() == np.count_nonzero(r2 <= R**2)


def test_cone_and_wedge_rise_at_their_slope():
    slope = math.radians(20)
    cone = contact_solver.cone(X, Y, slope)
    assert cone[25, -1] == pytest.approx(6e-3 * math.tan(slope))
    wedge = contact_solver.wedge(X, Y, slope, 4e-3)
    np.testing.assert_allclose(wedge[:, 30], np.abs(Y) * math.tan(slope), atol=1e-18)
    assert np.isinf(wedge[25, [0, -1]]).all()


def test_a_punch_is_flat_to_its_edge_and_round_at_it():
    sharp, rounded = contact_solver.flat_punch(X, Y, 3e-3), contact_solver.flat_punch(X, Y, 3e-3, 1e-3)
    r = np.hypot(X, Y[:, None])
    assert set(np.unique(sharp)) == {0.0, np.inf}
    np.testing.assert_array_equal(np.isfinite(sharp), r <= 3e-3)
    np.testing.assert_array_equal(rounded[r <= 2e-3], 0.0)
    at_edge = np.isfinite(rounded) & (r > 2e-3)
    np.testing.assert_allclose((r - 2e-3)[at_edge] ** 2 + (1e-3 - rounded[at_edge]) ** 2, 1e-6, rtol=1e-9)


@pytest.mark.parametrize("turn_deg", [-40])
@pytest.mark.parametrize("place", [(1e-3, -5e-4)])
def test_a_long_indenter_turns_from_x_towards_y(turn_deg, place):
    """At an odd angle, where the senses differ: its edge runs along (cos, sin) and rises to both sides."""
    turn, slope = math.radians(turn_deg), math.radians(20)
    along, across = (math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))

    def height(shape, u, v):
        at = [np.array([place[k] + u * along[k] + v * across[k]]) for k in (0, 1)]
        return float(shape(*at)[0, 0])

    def wedge(x, y):
        return contact_solver.wedge(x, y, slope, 4e-3, turn, place)

    def cylinder(x, y):
        return contact_solver.lying_cylinder(x, y, R, 4e-3, turn, place)

    for end in (-1, 1):
        for shape in (wedge, cylinder):
            assert height(shape, end * 1.9e-3, 0.0) == pytest.approx(0.0, abs=1e-15)
            assert height(shape, end * 2.1e-3, 0.0) == math.inf
        for u in (0.0, 1.5e-3, -1.5e-3):
            assert height(wedge, u, end * 3e-3) == pytest.approx(3e-3 * math.tan(slope), rel=1e-12)
            expected = R - math.sqrt(R**2 - 3e-3**2)
            assert height(cylinder, u, end * 3e-3) == pytest.approx(expected, rel=1e-12)


def test_balls_on_a_holder_are_spheres_lifted():
    z = contact_solver.balls(X, Y, 1e-3, [(-2e-3, 0.0, 0.0), (2e-3, 1e-3, 2e-4)])
    assert z[25, 20] == 0.0
    assert z[30, 40] == pytest.approx(2e-4)
    assert np.isinf(z[25, 30])
    one, other = (
        contact_solver.sphere(X, Y, 1e-3, (-2e-3, 0.0)),
        contact_solver.sphere(X, Y, 1e-3, (2e-3, 1e-3)),
    )
    np.testing.assert_array_equal(z, contact_solver.together(one, other + 2e-4))
    with refused("spheres-above-surface", RangeError):
        contact_solver.balls(X, Y, 1e-3, [(0.0, 0.0, 1e-4)])
    with pytest.raises(InputError, match="without spheres"):
        contact_solver.balls(X, Y, 1e-3, [])


@pytest.mark.parametrize("turn_deg", [0, 90, 200])
def test_the_side_that_an_indenter_leans_to_is_the_lower_one(turn_deg):
    turn = math.radians(turn_deg)
    z = contact_solver.lean(contact_solver.flat_punch(X, Y, 3e-3), X, Y, math.radians(5), turn)
    lowest = np.unravel_index(z.argmin(), z.shape)
    x, y = X[lowest[1]], Y[lowest[0]]
    # the lowest point of the grid lies at the rim, within a cell of 0.2 mm of that direction
    assert (x * math.cos(turn) + y * math.sin(turn)) == pytest.approx(3e-3, abs=2e-4)
    assert np.ptp(z[np.isfinite(z)]) == pytest.approx(6e-3 * math.tan(math.radians(5)), rel=0.05)
    with pytest.raises(RangeError, match="tilt"):
        contact_solver.lean(z, X, Y, math.nan)


@pytest.mark.parametrize(
    ("shape", "code"),
    [
        (lambda: contact_solver.sphere(X, Y, 0.0), "not-positive"),
        (lambda: contact_solver.sphere(X, Y, math.nan), "not-positive"),
        (lambda: contact_solver.paraboloid(X, Y, -1e-3), "not-positive"),
        (lambda: contact_solver.cone(X, Y, 0.0), "side-slope"),
        (lambda: contact_solver.cone(X, Y, math.pi / 2), "side-slope"),
        (lambda: contact_solver.flat_punch(X, Y, 1e-3, 2e-3), "edge-radius"),
        (lambda: contact_solver.wedge(X, Y, 0.1, 0.0), "not-positive"),
        (lambda: contact_solver.lying_cylinder(X, Y, -R, 1e-3), "not-positive"),
        (lambda: contact_solver.tilt(contact_solver.sphere(X, Y, R), X, Y, 0.6), "tilt-range"),
    ],
)
def test_a_shape_that_cannot_be_is_refused(shape, code):
    with refused(code, RangeError):
        shape()
