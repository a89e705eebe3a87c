import math

import numpy as np
import pytest
from scipy.integrate import quad
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import centreline_stress, greatest_shear, secondary_stress

A, P0 = 2e-3, 0.1e6


def below(x, z):
    """s_xx - s_zz under Hertz's pressure at nu = 1/2, by superposing point forces, which are radial there."""

    def ring(r):
        angle = np.arange(128) * 2 * np.pi / 128
        dx, dy = x - r * np.cos(angle), -r * np.sin(angle)
        part = 3 * z * (z**2 - dx**2) / (2 * np.pi * (dx**2 + dy**2 + z**2) ** 2.5)
        return P0 * math.sqrt(1 - (r / A) ** 2) * r * part.mean() * 2 * np.pi

    return quad(ring, 0, A, epsrel=1e-10)[0]


@pytest.mark.parametrize(("x", "z"), [(0.0, 0.5), (0.6, 0.4), (-1.4, 0.9), (2.0, 0.7)])
def test_the_fringes_field_is_that_of_superposed_point_forces(x, z):
    difference, _ = secondary_stress(x * A, 0.0, z * A, A, P0)
    assert float(difference) == pytest.approx(below(x * A, z * A), abs=1e-7 * P0)


def test_on_the_axis_the_fringes_field_is_the_centreline_formula():
    z = A * np.linspace(0, 5, 50)
    difference, shear = secondary_stress(0.0, 0.0, z, A, P0)
    s_rr, s_zz = centreline_stress(z, A, P0, 0.5)
    np.testing.assert_allclose(difference, s_rr - s_zz, atol=1e-11 * P0)
    np.testing.assert_allclose(shear, 0.0, atol=1e-11 * P0)


@pytest.mark.parametrize(("nu", "shear", "depth"), [(0.3, 0.31002, 0.4808), (0.5, 0.26635, 0.5478)])
def test_the_greatest_shear_stands_where_johnson_has_it(nu, shear, depth):
    found, where = greatest_shear(nu)
    assert found == pytest.approx(shear, abs=5.1e-6)  # five digits are given
    assert where == pytest.approx(depth, abs=1.1e-4)


def test_what_lies_outside_is_refused():
    with pytest.raises(RangeError, match="peak pressure"):
        centreline_stress(1.0, A, math.nan, 0.3)
    with refused("above-surface", RangeError):
        centreline_stress(-1e-3, A, P0, 0.3)
    for nu in (-0.1, 0.6, math.nan):
        with refused("poisson-ratio", RangeError):
            greatest_shear(nu)
