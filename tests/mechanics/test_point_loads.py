import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space import point_loads as loads

E, C = 2.0, 0.6  # modulus and depth of the buried force
NUS = (0.0, 0.3, 0.5)


def fields(nu):
    """Every stress here, as a function of points ``[n 3]``, with the force's axis and depth."""
    return {
        "boussinesq": (lambda p: loads.boussinesq_stress(*p.T, 1.0, nu), 2, 0.0),
        "cerruti": (lambda p: loads.cerruti_stress(*p.T, 1.0, nu), 0, 0.0),
        "mindlin x": (lambda p: loads.mindlin_stress(*p.T, C, 1.0, "x", nu), 0, C),
        "mindlin y": (lambda p: loads.mindlin_stress(*p.T, C, 1.0, "y", nu), 1, C),
        "mindlin z": (lambda p: loads.mindlin_stress(*p.T, C, 1.0, "z", nu), 2, C),
    }


NAMES = list(fields(0.0))


@pytest.fixture
def points(rng):
    """Places in the skin at least 0.3 from either force."""
    p = rng.uniform(-1, 1, (200, 3)) * [1, 1, 0.5] + [0, 0, 0.55]
    return p[(np.linalg.norm(p - [0, 0, C], axis=1) > 0.3) & (np.linalg.norm(p, axis=1) > 0.3)]


def gradient(field, p, h=1e-3):
    """Fourth-order central differences, the new axis last."""

    def along(e):
        return (8 * (field(p + e) - field(p - e)) - (field(p + 2 * e) - field(p - 2 * e))) / (12 * h)

    return np.stack([along(h * e) for e in np.eye(3)], -1)


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("name", NAMES)
def test_the_stress_is_in_equilibrium(name, nu, points):
    stress, _, _ = fields(nu)[name]
    slopes = gradient(stress, points)
    divergence = np.trace(slopes, axis1=-2, axis2=-1)
    # the differences' own error is h^4 / r^4 of the slope
    assert np.abs(divergence).max() < 1e-7 * np.abs(slopes).max()


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("name", NAMES)
def test_the_surface_is_free_of_traction(name, nu, points):
    stress, _, _ = fields(nu)[name]
    on_surface = stress(points * [1, 1, 0])
    assert np.abs(on_surface[:, :, 2]).max() < 1e-14  # over a force of 1 at places about 1 away


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("name", NAMES)
def test_a_plane_below_the_force_carries_all_of_it(name, nu):
    stress, axis, _ = fields(nu)[name]
    nodes, weights = np.polynomial.legendre.leggauss(200)
    r, angles = np.tan(np.pi / 4 * (1 + nodes)), np.arange(8) * np.pi / 4
    ring = r * weights * np.pi / 4 * (1 + r**2) * 2 * np.pi / len(angles)
    p = np.stack(
        [np.outer(r, np.cos(angles)), np.outer(r, np.sin(angles)), np.full((200, 8), C + 0.7)], -1
    ).reshape(-1, 3)
    carried = np.einsum("n,ni->i", np.repeat(ring, 8), stress(p)[:, :, 2])
    wanted = np.zeros(3)
    wanted[axis] = -1.0  # a force along +z on the plane from below is compression
    # the quadrature's own error: the shear's tail falls as 1/r^3 or faster
    np.testing.assert_allclose(carried, wanted, atol=1e-6)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_stress_and_displacement_obey_hookes_law(axis, nu, points):
    slopes = gradient(lambda p: loads.mindlin_displacement(*p.T, C, 1.0, axis, E, nu), points)
    strain = (slopes + slopes.swapaxes(1, 2)) / 2
    volume = np.trace(strain, axis1=1, axis2=2)[:, None, None]
    hooke = E / (1 + nu) * (strain + nu / (1 - 2 * nu) * volume * np.eye(3))
    stress = loads.mindlin_stress(*points.T, C, 1.0, axis, nu)
    # differences err by 1e-8 or so; at nu = 0.49 the volume's error counts 25 times
    np.testing.assert_allclose(hooke, stress, atol=3e-6 * np.abs(stress).max())


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_at_nu_one_half_volume_is_kept(axis, points):
    slopes = gradient(lambda p: loads.mindlin_displacement(*p.T, C, 1.0, axis, E, 0.5), points)
    assert np.abs(np.trace(slopes, axis1=1, axis2=2)).max() < 1e-7 * np.abs(slopes).max()


@pytest.mark.parametrize("nu", NUS)
def test_at_depth_0_mindlin_is_boussinesq_and_cerruti(nu, points):
    x, y, z = points.T
    for axis, law in (("z", loads.boussinesq_stress), ("x", loads.cerruti_stress)):
        np.testing.assert_allclose(
            loads.mindlin_stress(x, y, z, 0.0, 1.0, axis, nu), law(x, y, z, 1.0, nu), atol=1e-14
        )


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("axis", [0, 2])
def test_far_below_the_surface_mindlin_is_kelvin(axis, nu, points):
    c = 1e5
    p = points - [0, 0, C]
    u = loads.mindlin_displacement(*(p + np.array([0, 0, c])).T, c, 1.0, "xyz"[axis], E, nu)
    R = np.linalg.norm(p, axis=1)[:, None]
    G = E / (2 * (1 + nu))
    kelvin = ((3 - 4 * nu) * np.eye(3)[axis] / R + p[:, [axis]] * p / R**3) / (16 * math.pi * G * (1 - nu))
    # the image is 2e5 away, so its part is of order R/c
    np.testing.assert_allclose(u, kelvin, atol=2e-5 * np.abs(kelvin).max())


@pytest.mark.parametrize("nu", NUS)
def test_the_surface_sinks_as_johnson_gives_it(nu):
    r, F, G = 0.7, 3.0, E / (2 * (1 + nu))
    u = loads.mindlin_displacement(r, 0.0, 0.0, 0.0, F, "z", E, nu)
    assert u[2] == pytest.approx((1 - nu**2) * F / (math.pi * E * r), rel=1e-12)
    assert u[0] == pytest.approx(-(1 - 2 * nu) * F / (4 * math.pi * G * r), rel=1e-12, abs=1e-16)
    x, y = 0.3, 0.5
    r = math.hypot(x, y)
    u = loads.mindlin_displacement(x, y, 0.0, 0.0, F, "x", E, nu)
    along = F / (2 * math.pi * G) * ((1 - nu) / r + nu * x**2 / r**3)
    assert u[0] == pytest.approx(along, rel=1e-12)
    assert u[1] == pytest.approx(F / (2 * math.pi * G) * nu * x * y / r**3, rel=1e-12, abs=1e-16)


def test_in_an_incompressible_skin_boussinesqs_stress_is_radial(points):
    s = loads.boussinesq_stress(*points.T, 2.0, 0.5)
    rho = np.linalg.norm(points, axis=1)
    radial = -3 * 2.0 * points[:, 2] / (2 * np.pi * rho**5)
    np.testing.assert_allclose(s, radial[:, None, None] * points[:, :, None] * points[:, None, :], atol=1e-14)


def test_displacements_of_two_forces_are_reciprocal(rng):
    a, b = rng.uniform(0.1, 1, (2, 3))
    for i, along in enumerate("xyz"):
        for j, back in enumerate("xyz"):
            there = loads.mindlin_displacement(b[0] - a[0], b[1] - a[1], b[2], a[2], 1.0, along, E, 0.3)
            here = loads.mindlin_displacement(a[0] - b[0], a[1] - b[1], a[2], b[2], 1.0, back, E, 0.3)
            assert there[j] == pytest.approx(here[i], rel=1e-12)


@pytest.mark.parametrize("bad", [-0.1, 0.51, math.nan])
def test_a_poissons_ratio_out_of_range_is_refused(bad):
    for ask in (
        lambda: loads.boussinesq_stress(1.0, 0.0, 1.0, 1.0, bad),
        lambda: loads.cerruti_stress(1.0, 0.0, 1.0, 1.0, bad),
        lambda: loads.mindlin_stress(1.0, 0.0, 1.0, 1.0, 1.0, "x", bad),
        lambda: loads.mindlin_displacement(1.0, 0.0, 1.0, 1.0, 1.0, "x", E, bad),
    ):
        with refused("poisson-ratio", RangeError, match=r"0\.5"):
            ask()


def test_places_and_forces_without_a_field_are_refused():
    with refused("above-surface", RangeError):
        loads.boussinesq_stress(0.0, 0.0, -1.0, 1.0, 0.3)
    with refused("singular-point", RangeError):
        loads.cerruti_stress(np.zeros(2), np.zeros(2), np.arange(2.0), 1.0, 0.3)
    with refused("singular-point", RangeError):
        loads.mindlin_stress(0.0, 0.0, C, C, 1.0, "z", 0.3)
    with pytest.raises(RangeError, match="finite"):
        loads.boussinesq_stress(0.0, 0.0, 1.0, math.inf, 0.3)
    with pytest.raises(RangeError, match="depth -1"):
        loads.mindlin_stress(0.0, 0.0, 1.0, -1.0, 1.0, "z", 0.3)
    with pytest.raises(RangeError, match="finite places"):
        loads.boussinesq_stress(math.nan, 0.0, 1.0, 1.0, 0.3)
    with pytest.raises((InputError, TypeError)):
        loads.mindlin_stress(1.0, 0.0, 1.0, 1.0, 1.0, "w", 0.3)
