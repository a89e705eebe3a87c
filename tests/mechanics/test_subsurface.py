import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import secondary_stress
from palpate.mechanics.half_space.subsurface import (
    boussinesq_stress,
    centreline_stress,
    cerruti_stress,
    greatest_shear,
    hertz_stress,
)

A, P0 = 2e-3, 0.1e6
NUS = (0.0, 0.3, 0.5)


@pytest.fixture
def points(rng):
    """Places at least 0.3 a deep, so that the superposed point forces are smooth there."""
    p = rng.uniform(-2, 2, (30, 3))
    p[:, 2] = np.abs(p[:, 2]) + 0.3
    return A * p


def superposed(points, nu, friction):
    """The contact as 60 x 120 point forces; exact for the square-root edge, as r = a sqrt(1 - v^2)."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    v, weights = (1 + nodes) / 2, weights / 2
    angles = np.arange(120) * 2 * np.pi / 120
    r = A * np.sqrt(1 - v**2)
    x, y = np.outer(r, np.cos(angles)).ravel(), np.outer(r, np.sin(angles)).ravel()
    forces = np.repeat(P0 * A**2 * v**2 * weights * 2 * np.pi / 120, 120)
    total = np.empty((len(points), 3, 3))
    for i, p in enumerate(points):
        s = boussinesq_stress(p[0] - x, p[1] - y, p[2], 1.0, nu)
        if friction:
            s = s + friction * cerruti_stress(p[0] - x, p[1] - y, p[2], 1.0, nu)
        total[i] = np.einsum("n,nij->ij", forces, s)
    return total


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_the_stress_is_that_of_superposed_point_forces(nu, friction, points):
    s = hertz_stress(*points.T, A, P0, nu, friction)
    # 60 nodes leave nothing of the quadrature's error at this depth
    np.testing.assert_allclose(s, superposed(points, nu, friction), atol=1e-12 * P0)


def test_in_an_incompressible_skin_it_is_the_fringes_field(points):
    s = hertz_stress(*points.T, A, P0, 0.5)
    difference, shear = secondary_stress(*points.T, A, P0)
    np.testing.assert_allclose(s[:, 0, 0] - s[:, 2, 2], difference, atol=1e-13 * P0)
    np.testing.assert_allclose(2 * s[:, 0, 2], shear, atol=1e-13 * P0)


@pytest.mark.parametrize("nu", NUS)
def test_on_the_axis_it_is_the_centreline_formula(nu):
    z = A * np.linspace(0, 5, 50)
    s = hertz_stress(0.0, 0.0, z, A, P0, nu)
    s_rr, s_zz = centreline_stress(z, A, P0, nu)
    # 1e-12 a stands for the surface
    np.testing.assert_allclose(s[:, 0, 0], s_rr, atol=1e-11 * P0)
    np.testing.assert_allclose(s[:, 1, 1], s_rr, atol=1e-11 * P0)
    np.testing.assert_allclose(s[:, 2, 2], s_zz, atol=1e-11 * P0)


@pytest.mark.parametrize(("nu", "shear", "depth"), [(0.3, 0.31002, 0.4808), (0.5, 0.26635, 0.5478)])
def test_the_greatest_shear_stands_where_johnson_has_it(nu, shear, depth):
    found, where = greatest_shear(nu)
    assert found == pytest.approx(shear, abs=5.1e-6)  # five digits are given
    assert where == pytest.approx(depth, abs=1.1e-4)
    grid = hertz_stress(
        *np.meshgrid(A * np.linspace(0, 1.2, 41), 0.0, A * np.linspace(0.1, 1, 91)), A, P0, nu
    )
    principal = np.linalg.eigvalsh(grid)
    # nowhere in the map is it larger: the grid's step costs 1e-4
    assert (principal[..., 2] - principal[..., 0]).max() / (2 * P0) == pytest.approx(shear, rel=1e-4)


@pytest.mark.parametrize("friction", [0.0, 1.2])
def test_on_the_surface_the_traction_is_the_load(friction):
    x = A * np.array([0.0, 0.3, 0.9, 0.999, 1.001, 1.5, 3.0])
    s = hertz_stress(x, 0.0, 0.0, A, P0, 0.3, friction)
    p = P0 * np.sqrt(np.maximum(1 - (x / A) ** 2, 0))
    np.testing.assert_allclose(s[:, 2, 2], -p, atol=1e-9 * P0)
    np.testing.assert_allclose(s[:, 0, 2], -friction * p, atol=1e-9 * P0)
    np.testing.assert_allclose(s[:, 1, 2], 0, atol=1e-9 * P0)


@pytest.mark.parametrize("nu", NUS)
def test_around_the_contact_the_surface_is_in_pure_shear(nu):
    # Johnson (3.43): s_r = -s_theta = (1 - 2 nu) p0 a^2 / (3 r^2)
    x = A * np.array([1.0001, 1.5, 4.0])
    s = hertz_stress(x, 0.0, 0.0, A, P0, nu)
    pull = (1 - 2 * nu) * P0 * A**2 / (3 * x**2)
    np.testing.assert_allclose(s[:, 0, 0], pull, atol=1e-8 * P0)
    np.testing.assert_allclose(s[:, 1, 1], -pull, atol=1e-8 * P0)


@pytest.mark.parametrize("bad", [0.0, math.nan])
def test_a_contact_without_a_size_or_a_load_is_refused(bad):
    with pytest.raises(RangeError, match="contact radius"):
        hertz_stress(0.0, 0.0, 1.0, bad, P0, 0.3)
    with pytest.raises(RangeError, match="peak pressure"):
        hertz_stress(0.0, 0.0, 1.0, A, bad, 0.3)
    with pytest.raises(RangeError, match="peak pressure"):
        centreline_stress(1.0, A, bad, 0.3)


def test_what_else_lies_outside_is_refused():
    with refused("above-surface", RangeError):
        hertz_stress(0.0, 0.0, -1e-3, A, P0, 0.3)
    with pytest.raises(RangeError, match="finite"):
        hertz_stress(math.nan, 0.0, 1e-3, A, P0, 0.3)
    with refused("above-surface", RangeError):
        centreline_stress(-1e-3, A, P0, 0.3)
    for nu in (-0.1, 0.6, math.nan):
        with refused("poisson-ratio", RangeError, match=r"0\.5"):
            hertz_stress(0.0, 0.0, 1e-3, A, P0, nu)
        with refused("poisson-ratio", RangeError, match=r"0\.5"):
            greatest_shear(nu)
    for friction in (3.0, math.nan):
        with refused("friction-range", RangeError, match="-2"):
            hertz_stress(0.0, 0.0, 1e-3, A, P0, 0.3, friction)
