"""Presses on viscous bodies: Ting's law, two bodies in series, and the limits of fast and slow."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from palpate.core import RangeError
from palpate.mechanics.axisymmetric.axisymmetric_fem import CreepingPress, Prony
from palpate.mechanics.half_space.hertz import Body

SKIN = Prony(0.1e6, (0.08e6, 0.05e6), (0.2, 2.0))
R, NU, MOST_N = 20e-3, 0.48, 50.0
PLANE = 1 - NU**2
STEP_S = 5e-3


def relaxation(time_s):
    """E(t) of the skin [Pa]."""
    terms = (E * np.exp(-time_s / tau) for E, tau in zip(SKIN.moduli_pa, SKIN.times_s, strict=True))
    return SKIN.equilibrium_pa + sum(terms)


def creep(time_s):
    """J(t) of the skin [1/Pa]."""
    weights, rates = SKIN.retardation()
    return 1 / SKIN.equilibrium_pa - np.exp(-np.asarray(time_s)[..., None] * rates) @ weights


def rigid_sphere(force_n: float, modulus_pa: float) -> float:
    return float(Body(modulus_pa / PLANE, R).approach_m(force_n))


def soft_tip(force_n: float, modulus_pa: float) -> float:
    tip = Body(0.06e6 / PLANE, R)
    return float(tip.against(Body(modulus_pa / PLANE, np.inf)).approach_m(force_n))


def creeping_press(approach_m, body, most_n, depth_m, step_s):
    press = CreepingPress(approach_m, body, most_n)
    return np.array([(press.to(float(d), step_s), press.modulus_pa) for d in depth_m]).T


def ramp_and_hold(rise_s: float, hold_s: float, depth_m: float = 3e-3) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, rise_s + hold_s, STEP_S)
    return time, depth_m * np.minimum(time / rise_s, 1.0)


def test_creep_undoes_relaxation() -> None:
    """The Laplace transforms of E and J multiply to 1/p^2: int E(t - s) J(s) ds = t."""
    for t in (0.005, 0.4, 6.0):
        ends = [t * 0.9, min(0.02, t / 2)]
        whole = quad(lambda s, t=t: relaxation(t - s) * float(creep(s)), 0, t, points=ends, limit=200)[0]
        assert_allclose(whole, t, rtol=1e-7)
    assert_allclose(creep(0.0), 1 / SKIN.instantaneous_pa)


@pytest.mark.parametrize(
    "bad",
    [(0.0, (), ()), (np.nan, (), ()), (1e5, (1e5,), ()), (1e5, (1e5,), (0.0,)), (1e5, (np.inf,), (1,))],
)
def test_a_series_that_is_no_skin_is_refused(bad) -> None:
    with pytest.raises(RangeError):
        Prony(*bad)


def test_a_rigid_sphere_obeys_tings_law() -> None:
    time, depth = ramp_and_hold(0.5, 0.5)
    force, _ = creeping_press(rigid_sphere, SKIN, MOST_N, depth, STEP_S)
    stiffness = 4 / 3 * np.sqrt(R) / PLANE
    rate = depth[-1] / 0.5

    def by_ting(t):
        """K int E(t - s) d(d^(3/2)) while the depth rises."""
        rising = min(t, 0.5)
        whole = quad(lambda s: relaxation(t - s) * 1.5 * rate * np.sqrt(rate * s), 0, rising, epsrel=1e-10)
        return stiffness * whole[0]

    assert_allclose(force[5:], [by_ting(t) for t in time[5:]], rtol=4e-3)
    naive = stiffness * relaxation(time) * depth**1.5
    assert np.abs(naive[5:] / force[5:] - 1).max() > 0.1  # E(t) at the time since touch is another law


def test_two_bodies_meet_the_integral_equation_of_both() -> None:
    """P/E1 + int J(t - s) dP(s) = 4/3 sqrt(R) d^(3/2), by a sum over the steps of force."""
    time, depth = ramp_and_hold(0.5, 0.5)
    force, _ = creeping_press(soft_tip, SKIN, MOST_N, depth, STEP_S)
    steps = np.diff(force)
    middle = (time[1:] + time[:-1]) / 2
    for n in (20, 99, len(time) - 1):
        past = middle[:n]
        both = PLANE * (force[n] / 0.06e6 + creep(time[n] - past) @ steps[:n])
        assert_allclose(both, 4 / 3 * np.sqrt(R) * depth[n] ** 1.5, rtol=1e-3)


@pytest.mark.parametrize(
    ("rise_s", "modulus_pa"), [(0.05, SKIN.instantaneous_pa), (400.0, SKIN.equilibrium_pa)]
)
def test_fast_and_slow_presses_are_of_elastic_bodies(rise_s, modulus_pa) -> None:
    step_s = rise_s / 100
    fast = Prony(SKIN.equilibrium_pa, SKIN.moduli_pa, tuple(40 * t for t in SKIN.times_s))
    body = fast if rise_s < 1 else SKIN
    depth = 3e-3 * np.arange(101) / 100
    force, in_effect = creeping_press(soft_tip, body, MOST_N, depth, step_s)
    assert_allclose(in_effect[-1], modulus_pa, rtol=0.02)
    assert_allclose(soft_tip(force[-1], modulus_pa), depth[-1], rtol=0.01)
    elastic_of_the_other = SKIN.equilibrium_pa if rise_s < 1 else SKIN.instantaneous_pa
    assert abs(soft_tip(force[-1], elastic_of_the_other) / depth[-1] - 1) > 0.1


def test_a_body_that_was_left_begins_anew() -> None:
    _, depth = ramp_and_hold(0.1, 0.1)
    once, _ = creeping_press(soft_tip, SKIN, MOST_N, depth, STEP_S)
    again, _ = creeping_press(soft_tip, SKIN, MOST_N, np.concatenate([depth, [-1e-3], depth]), STEP_S)
    assert_allclose(again[len(depth) + 1 :], once)
