import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import j0
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space import sneddon
from palpate.mechanics.layers import bonded_layer as layer

R, E = 5e-3, 0.3e6
BASES = ("bonded", "sliding")


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_a_thick_layer_is_a_half_space(nu, base):
    F = layer.sphere_force(1e-4, R, 100.0, E, nu, base)
    # what is left is of order sqrt(R d) / h = 7e-6
    assert pytest.approx(sneddon.sphere_force_from_depth(1e-4, R, E, nu), rel=1e-4) == F
    assert layer.punch_factor(1e-6, nu, base) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize(("ratio", "nu"), [(0.3, 0.3), (1.0, 0.5), (3.0, 0.45)])
def test_the_surface_under_the_sphere_has_its_shape(ratio, nu, base):
    """The solution put back into the layer's own equation, with Bessel's function instead of the cosine."""
    h = 1.0 / ratio  # a = 1, R = 2
    nodes, weights, inverse = layer._system(ratio, nu, base)
    flat, curved = inverse.sum(axis=1), inverse @ (nodes * np.arctanh(nodes / 2))
    d = curved[-1] / flat[-1]
    g = d * flat - curved

    def missing(k, r):
        """What the base takes away of the surface's sinking, at wavenumber k."""
        return (
            (weights * g)
            @ np.cos(k * nodes)
            * (1 - layer.layer_transfer(np.array([k * h]), nu, base)[0])
            * j0(k * r)
        )

    poly = np.polynomial.Chebyshev.fit(nodes, g, 24)
    for r in (0.2, 0.7, 0.95):
        half_space = quad(lambda angle, r=r: poly(r * math.sin(angle)), 0, math.pi / 2)[0]
        base_part = quad(missing, 0, 25 / h, args=(r,), limit=400)[0]
        u = 2 / math.pi * (half_space - base_part)
        # quadrature errs by 1e-8; the fit by less
        assert u == pytest.approx(d - (2 - math.sqrt(4 - r**2)), abs=1e-7)


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.45])
def test_a_thin_layer_is_a_mattress(nu, base):
    # under a wide punch each column stands alone: F = pi a^2 M d / h, M the modulus of the column
    factor = 1.0 if base == "sliding" else (1 - nu) ** 2 / (1 - 2 * nu)
    slope = (layer.punch_factor(10, nu, base) - layer.punch_factor(8, nu, base)) / 2
    # the rim's share is constant, and what is left falls with the thickness (slowest for nu near 1/2)
    assert slope == pytest.approx(math.pi / 2 * factor, rel=2e-3 if nu < 0.4 else 0.05)


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("a", [1e-4, 1e-3, 4e-3])
def test_force_and_depth_lead_back_to_each_other(a, base):
    d, F = layer.sphere_from_radius(a, R, 20e-3, E, 0.49, base)
    assert layer.sphere_force(d, R, 20e-3, E, 0.49, base) == pytest.approx(F, rel=1e-9)


@pytest.mark.parametrize(
    ("h", "forces"),
    [
        (10e-3, {1e-3: 5.08, 2e-3: 15.82, 3e-3: 30.85, 5e-3: 70.09}),
        (20e-3, {1e-3: 4.37, 2e-3: 12.76, 3e-3: 23.79, 5e-3: 51.30}),
    ],
)
def test_the_force_is_that_of_a_boundary_element_code(h, forces):
    # F/E in mm^2 of a true sphere of 5 mm, nu = 0.49; beyond a fifth of h only to compare the two codes
    for d, wanted in forces.items():
        a = brentq(lambda a, d=d: layer.sphere_from_radius(a, R, h, E, 0.49)[0] - d, 1e-4, 4.95e-3)
        found = layer.sphere_from_radius(a, R, h, E, 0.49)[1] / E * 1e6
        assert found == pytest.approx(wanted, rel=1.2e-3)  # three or four digits are given


@pytest.mark.parametrize("bad", [-1.0, math.nan])
def test_what_lies_outside_the_law_is_refused(bad):
    good = (1e-4, R, 1e-2, E, 0.49)
    for i in range(5):
        with pytest.raises(RangeError):
            layer.sphere_force(*good[:i], bad, *good[i + 1 :])


def test_every_range_has_its_name_in_the_refusal():
    with refused("strain-limit", RangeError):
        layer.sphere_force(1.1e-3, R, 5e-3, E, 0.49)
    with refused("outside-law", RangeError, match=r"0\.99"):
        layer.sphere_force(14e-3, R, 0.1, E, 0.49)
    with refused("outside-law", RangeError, match="10"):
        layer.punch_factor(11.0, 0.3)
    with pytest.raises((InputError, TypeError)):
        layer.punch_factor(1.0, 0.3, "floating")
