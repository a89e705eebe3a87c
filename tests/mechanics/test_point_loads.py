import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space import subsurface as loads

LAWS = {"boussinesq": (loads.boussinesq_stress, 2), "cerruti": (loads.cerruti_stress, 0)}
both = pytest.mark.parametrize("name", LAWS)
ratios = pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])


@pytest.fixture
def points(rng):
    """Points at least 0.3 from the force."""
    p = rng.uniform(-1, 1, (200, 3)) * [1, 1, 0.5] + [0, 0, 0.55]
    return p[np.linalg.norm(p, axis=1) > 0.3]


def stress(name, nu, p):
    return LAWS[name][0](*p.T, 1.0, nu)


@ratios
@both
def test_the_stress_is_in_equilibrium(name, nu, points):
    h = 1e-3

    def along(e):
        near, far = (stress(name, nu, points + k * e) - stress(name, nu, points - k * e) for k in (1, 2))
        return (8 * near - far) / (12 * h)

    slopes = np.stack([along(h * e) for e in np.eye(3)], -1)
    divergence = np.trace(slopes, axis1=-2, axis2=-1)
    # the error of the fourth-order differences is h^4 / r^4 of the slope
    assert np.abs(divergence).max() < 1e-7 * np.abs(slopes).max()


@ratios
@both
def test_the_surface_is_free_of_traction(name, nu, points):
    assert np.abs(stress(name, nu, points * [1, 1, 0])[:, :, 2]).max() < 1e-14


@ratios
@both
def test_a_plane_below_the_force_carries_all_of_it(name, nu):
    nodes, weights = np.polynomial.legendre.leggauss(200)
    r, angles = np.tan(np.pi / 4 * (1 + nodes)), np.arange(8) * np.pi / 4
    ring = r * weights * np.pi / 4 * (1 + r**2) * 2 * np.pi / len(angles)
    x, y = np.outer(r, np.cos(angles)), np.outer(r, np.sin(angles))
    p = np.stack([x, y, np.full((200, 8), 0.7)], -1).reshape(-1, 3)
    carried = np.einsum("n,ni->i", np.repeat(ring, 8), stress(name, nu, p)[:, :, 2])
    # the shear's tail falls as 1/r^3 or faster
    np.testing.assert_allclose(carried, -np.eye(3)[LAWS[name][1]], atol=1e-6)


def test_boussinesqs_stress_is_radial_in_an_incompressible_half_space(points):
    s = loads.boussinesq_stress(*points.T, 2.0, 0.5)
    radial = -3 * 2.0 * points[:, 2] / (2 * np.pi * np.linalg.norm(points, axis=1) ** 5)
    np.testing.assert_allclose(s, radial[:, None, None] * points[:, :, None] * points[:, None, :], atol=1e-14)


@pytest.mark.parametrize(
    ("point", "force", "nu", "code"),
    [
        ((1.0, 0.0, 1.0), 1.0, -0.1, "poisson-ratio"),
        ((1.0, 0.0, 1.0), 1.0, 0.51, "poisson-ratio"),
        ((1.0, 0.0, 1.0), 1.0, math.nan, "poisson-ratio"),
        ((0.0, 0.0, -1.0), 1.0, 0.3, "above-surface"),
        ((math.nan, 0.0, 1.0), 1.0, 0.3, "above-surface"),
        ((0.0, 0.0, 0.0), 1.0, 0.3, "singular-point"),
    ],
)
@both
def test_points_and_materials_without_a_field_are_refused(name, point, force, nu, code):
    with refused(code, RangeError):
        LAWS[name][0](*point, force, nu)
    with pytest.raises(RangeError, match="finite"):
        LAWS[name][0](1.0, 0.0, 1.0, math.inf, 0.3)
