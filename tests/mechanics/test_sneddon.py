import math

import numpy as np
import pytest
from scipy.integrate import quad
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space import hertz, sneddon

R, E, NU = 5e-3, 0.3e6, 0.49
ES = hertz.reduced_modulus(E, NU)


@pytest.mark.parametrize("slope", [1e-6, 0.0999, 0.1001, 0.99])
def test_the_spheres_force_is_the_stated_closed_form(slope):
    import mpmath

    with mpmath.workdps(60):
        a = mpmath.mpf(slope) * R
        log = mpmath.log((R + a) / (R - a))
        force = ES * ((a**2 + mpmath.mpf(R) ** 2) / 2 * log - a * R)
        depth = a / 2 * log
    assert sneddon.sphere_force_from_radius(float(a), R, E, NU) == pytest.approx(float(force), rel=1e-12)
    assert sneddon.sphere_depth_from_radius(float(a), R) == pytest.approx(float(depth), rel=1e-12)


def test_a_shallow_sphere_is_hertzs():
    d = 1e-6
    # the first correction is of order (a/R)^2 = d/R = 2e-4
    assert sneddon.sphere_force_from_depth(d, R, E, NU) == pytest.approx(
        hertz.force_from_depth(d, R, E, NU), rel=d / R
    )
    assert sneddon.sphere_radius_from_depth(d, R) == pytest.approx(hertz.contact_radius(d, R), rel=d / R)


@pytest.mark.parametrize("slope", [0.0, 1e-5, 0.8])
def test_radius_depth_and_force_lead_back_to_each_other(slope):
    a = slope * R
    d, F = sneddon.sphere_depth_from_radius(a, R), sneddon.sphere_force_from_radius(a, R, E, NU)
    assert sneddon.sphere_radius_from_depth(d, R) == pytest.approx(a, rel=1e-10)
    assert sneddon.sphere_radius_from_force(F, R, E, NU) == pytest.approx(a, rel=1e-10)
    assert sneddon.sphere_depth_from_force(F, R, E, NU) == pytest.approx(d, rel=1e-9)
    assert sneddon.sphere_force_from_depth(d, R, E, NU) == pytest.approx(F, rel=1e-9)


@pytest.mark.parametrize("slope", [0.6])
def test_the_force_is_the_derivative_of_the_work(slope):
    # dF = 2 a E* dd for every axisymmetric punch: the layer of contact added last is a flat punch
    a, h = slope * R, 1e-6 * R
    dF = sneddon.sphere_force_from_radius(a, R, E, NU) - sneddon.sphere_force_from_radius(a - h, R, E, NU)
    dd = sneddon.sphere_depth_from_radius(a, R) - sneddon.sphere_depth_from_radius(a - h, R)
    # one-sided difference: h/R over the distance to the equator
    assert dF / dd == pytest.approx(2 * a * ES, rel=1e-4)


@pytest.mark.parametrize("slope", [0.6])
def test_the_integral_of_the_spheres_pressure_is_the_force(slope):
    a = slope * R

    def ring(v):  # r = sqrt(a^2 - v^2) takes the root out of the end
        r = np.array(math.sqrt(a**2 - v**2))
        return 2 * math.pi * v * float(sneddon.sphere_pressure(r, a, R, E, NU))

    assert quad(ring, 0, a, epsabs=0, epsrel=1e-10)[0] == pytest.approx(
        sneddon.sphere_force_from_radius(a, R, E, NU), rel=1e-8
    )


def test_the_cones_force_depth_and_radius_are_the_stated_ones():
    alpha, d = math.radians(70), 1e-3
    F = sneddon.cone_force(d, alpha, E, NU)
    assert sneddon.cone_radius(d, alpha) == pytest.approx(2 / math.pi * d * math.tan(alpha), rel=1e-12)
    assert pytest.approx(2 * ES * d**2 * math.tan(alpha) / math.pi, rel=1e-12) == F
    assert sneddon.cone_depth(F, alpha, E, NU) == pytest.approx(d, rel=1e-12)


def test_a_flat_punch_has_the_stiffness_2_a_e_star():
    # ContactMechanics' own test of its flat punch: R = 20, E* = 3.56
    assert sneddon.punch_force(1.0, 20.0, 3.56, 0.0) / (2 * 20.0 * 3.56) == pytest.approx(1.0, rel=1e-12)
    assert sneddon.punch_depth(sneddon.punch_force(1e-4, R, E, NU), R, E, NU) == pytest.approx(1e-4)


@pytest.mark.parametrize(
    "ask",
    [
        lambda bad: sneddon.sphere_force_from_depth(bad, R, E, NU),
        lambda bad: sneddon.sphere_depth_from_force(bad, R, E, NU),
        lambda bad: sneddon.sphere_depth_from_radius(bad, R),
        lambda bad: sneddon.sphere_force_from_depth(1e-3, R, bad, NU),
        lambda bad: sneddon.sphere_force_from_depth(1e-3, R, E, bad),
        lambda bad: sneddon.sphere_radius_from_depth(1e-3, bad),
        lambda bad: sneddon.punch_force(bad, R, E, NU),
        lambda bad: sneddon.punch_depth(bad, R, E, NU),
        lambda bad: sneddon.punch_force(1e-3, bad, E, NU),
        lambda bad: sneddon.cone_force(bad, 1.0, E, NU),
        lambda bad: sneddon.cone_force(1e-3, bad, E, NU),
        lambda bad: sneddon.cone_depth(bad, 1.0, E, NU),
    ],
)
@pytest.mark.parametrize("bad", [-1.0, math.nan])
def test_what_lies_outside_the_law_is_refused(ask, bad):
    with pytest.raises(RangeError):
        ask(bad)


def test_a_depth_beyond_the_equator_names_the_limit_and_its_unit():
    with refused("outside-law", RangeError, match="20"):
        sneddon.sphere_force_from_depth(20.0, R, E, NU)
    with refused("outside-law", RangeError, match=r"0\.5"):
        sneddon.punch_force(0.6 * R, R, E, NU)
