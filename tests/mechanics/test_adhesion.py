import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space import hertz
from palpate.mechanics.half_space.adhesion import JKR_ABOVE, AdhesiveSphere

W, R, E, NU = 0.05, 5e-3, 0.3e6, 0.49
SPHERE = AdhesiveSphere(W, R, E, NU)
ES = hertz.reduced_modulus(E, NU)


def test_without_adhesion_the_law_is_hertzs():
    d = 0.5e-3
    F = hertz.force_from_depth(d, R, E, NU)
    assert AdhesiveSphere(0.0, R, E, NU).force_from_depth(d) == pytest.approx(F, rel=1e-12)
    assert AdhesiveSphere(0.0, R, E, NU).radius_from_force(F) == pytest.approx(math.sqrt(R * d), rel=1e-12)


@pytest.mark.parametrize("force_n", [-1.1e-3, 0.0, 0.1])
def test_radius_and_force_lead_back_to_each_other(force_n):
    a = SPHERE.radius_from_force(force_n)
    assert SPHERE.force_from_radius(a) == pytest.approx(force_n, rel=1e-9, abs=1e-15)
    d = SPHERE.depth_from_radius(a)
    assert SPHERE.force_from_depth(d) == pytest.approx(force_n, rel=1e-8, abs=1e-14)


def test_the_work_of_the_force_is_elastic_energy_less_adhesion():
    # Griffith's balance along the branch: F dd = dU_elastic - w dA, with U of a punch and a paraboloid
    def energy(a):
        hertzian = 4 * ES * a**3 / (3 * R)
        short = hertzian - SPHERE.force_from_radius(a)  # a flat punch's pull
        return hertzian**2 * 3 / (10 * ES * a) + short**2 / (4 * a * ES) - short * 2 * a**2 / (3 * R)

    a = np.linspace(2e-3, 2.2e-3, 2001)
    forces = np.array([SPHERE.force_from_radius(v) for v in a])
    depths = np.array([SPHERE.depth_from_radius(v) for v in a])
    work = np.trapezoid(forces, depths)
    gained = energy(a[-1]) - energy(a[0]) - W * math.pi * (a[-1] ** 2 - a[0] ** 2)
    assert work == pytest.approx(gained, rel=1e-6)


def test_at_the_pull_off_depth_the_branch_turns():
    d = SPHERE.pull_off_depth_m
    a = np.linspace(1e-6, R / 4, 100_001)
    assert d == pytest.approx((a**2 / R - np.sqrt(2 * math.pi * W * a / ES)).min(), rel=1e-6)
    assert d < 0
    # held by its depth, the sphere comes off at 5/9 of the greatest pull
    assert SPHERE.force_from_depth(d) == pytest.approx(5 / 9 * SPHERE.pull_off_force_n, rel=1e-6)


def test_tabors_parameter_says_that_jkr_holds_for_soft_skin_and_not_for_hard_dust():
    assert SPHERE.tabor_parameter(0.3e-9) > 1e3 * JKR_ABOVE
    assert AdhesiveSphere(W, 1e-8, 70e9, 0.2).tabor_parameter(0.3e-9) < 0.1
    by_hand = (R * W**2 / (ES**2 * 0.3e-9**3)) ** (1 / 3)
    assert SPHERE.tabor_parameter(0.3e-9) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize(
    "ask",
    [
        lambda bad: AdhesiveSphere(bad, R, E, NU),
        lambda bad: AdhesiveSphere(W, bad, E, NU),
        lambda bad: SPHERE.radius_from_force(bad),
        lambda bad: SPHERE.force_from_depth(bad),
        lambda bad: SPHERE.force_from_radius(bad),
        lambda bad: SPHERE.depth_from_radius(bad),
        lambda bad: AdhesiveSphere(W, R, bad, NU),
        lambda bad: AdhesiveSphere(W, R, E, bad),
        lambda bad: SPHERE.tabor_parameter(bad),
    ],
)
@pytest.mark.parametrize("bad", [-1.0, math.nan])
def test_what_lies_outside_the_law_is_refused(ask, bad):
    with pytest.raises(RangeError):
        ask(bad)


def test_a_contact_beyond_half_the_radius_is_refused():
    with refused("outside-law", RangeError, match=r"0\.5"):
        SPHERE.radius_from_force(10.0)
    with pytest.raises(RangeError, match="comes off"):
        SPHERE.radius_from_force(-2e-3)
