import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from palpate.core import RangeError
from palpate.mechanics import viscoelastic
from palpate.mechanics.half_space import hertz
from palpate.mechanics.viscoelastic import Prony

R, NU, TOP = 5e-3, 0.49, 1e-3
SKIN = Prony(0.1e6, (0.15e6, 0.05e6), (0.5, 0.05))
K = 4 / 3 * math.sqrt(R) / (1 - NU**2)


def triangle(n=401):
    """In for a second, out for a second."""
    t = np.linspace(0, 2, n)
    return t, TOP * (1 - np.abs(1 - t))


def relaxation(t):
    return SKIN.equilibrium_pa + sum(
        E * math.exp(-t / tau) for E, tau in zip(SKIN.moduli_pa, SKIN.times_s, strict=True)
    )


def brute_force(t):
    """Ting's integrals for the triangle by adaptive quadrature: force and contact time."""
    if t <= 1:
        t1 = t
    else:
        back = quad(lambda s: relaxation(t - s), 1, t)[0]

        def balance(t1):
            return quad(lambda s: relaxation(t - s), t1, 1)[0] - back

        if balance(0.0) <= 0:
            return 0.0, 0.0
        t1 = brentq(balance, 0, 1, xtol=1e-12)
    force = quad(
        lambda s: relaxation(t - s) * 1.5 * math.sqrt(s), 0, t1, points=[max(t1 - 0.1, t1 / 2)], limit=200
    )[0]
    return K * TOP**1.5 * force, t1


def test_a_press_in_and_out_is_tings_integral():
    t, d = triangle()
    found = viscoelastic.ting(t, d, R, SKIN, NU)
    # the square root at first touch costs most: from a fifth of a second on it is below 1e-6
    for n in (40, 200, 250, 330):
        force, t1 = brute_force(t[n])
        assert found.force_n[n] == pytest.approx(force, rel=1e-6 if n <= 200 else 2e-6)
        if n > 200:
            assert found.radius_m[n] == pytest.approx(math.sqrt(R * TOP * t1), rel=1e-7)


HISTORIES = {
    "in and out": ([0, 1, 2], [0, TOP, 0]),
    "in, held and out": ([0, 1, 2, 3], [0, TOP, TOP, 0]),
    "fast in, held and fast out": ([0, 1e-3, 2, 2.002], [0, TOP, TOP, 0]),
    "from the air and back": ([0, 1, 2, 4], [-TOP, TOP, TOP, -5 * TOP]),
}


@pytest.mark.parametrize("law", [viscoelastic.ting, viscoelastic.press])
@pytest.mark.parametrize("name", HISTORIES)
@pytest.mark.cases(2)
def test_turning_points_alone_are_the_history_that_many_samples_are(law, name):
    t, d = (np.array(values, dtype=float) for values in HISTORIES[name])
    every = np.unique(np.concatenate([np.linspace(*ends, 1201) for ends in pairwise(t)]))
    fine = viscoelastic.ting(every, np.interp(every, t, d), R, SKIN, NU)
    found, here = law(t, d, R, SKIN, NU), np.searchsorted(every, t)
    np.testing.assert_allclose(found.force_n, fine.force_n[here], atol=1e-5 * fine.force_n.max())
    np.testing.assert_allclose(found.radius_m, fine.radius_m[here], atol=fine.radius_m.max() / 800)
    assert found.loss_j == pytest.approx(fine.loss_j, rel=1e-5)


@pytest.mark.parametrize(("scale", "modulus"), [(1e-5, SKIN.instantaneous_pa), (1e5, SKIN.equilibrium_pa)])
def test_a_very_fast_press_and_a_very_slow_one_are_elastic(scale, modulus):
    t, d = triangle()
    found = viscoelastic.ting(scale * t, d, R, SKIN, NU)
    wanted = [hertz.force_from_depth(v, R, modulus, NU) for v in d]
    # the slow way back lags by tau / scale, the fast one by its inverse
    np.testing.assert_allclose(found.force_n, wanted, atol=1e-3 * max(wanted))


def test_the_contact_is_never_in_tension_and_is_lost_before_the_depth_is():
    t, d = triangle()
    found = viscoelastic.ting(t, d, R, SKIN, NU)
    lost = found.radius_m[1:] == 0
    assert (found.force_n >= 0).all()
    assert found.force_n[1:][lost].max() == 0
    assert d[1:][lost].max() > 0.05 * TOP
    # the loading law, carried on, is in tension there: why Ting's is needed
    loading = K * SKIN.stress(t, d**1.5)
    assert loading.min() < -0.05 * loading.max()


def test_while_held_the_force_relaxes_with_the_modulus():
    t = np.concatenate([[0.0], 1e-6 + np.linspace(0, 3, 301)])
    d = np.concatenate([[0.0], np.full(301, TOP)])
    found = viscoelastic.ting(t, d, R, SKIN, NU)
    held = K * TOP**1.5 * SKIN.relaxation(t[1:])
    # the press took a microsecond
    np.testing.assert_allclose(found.force_n[1:], held, rtol=1e-4)
    np.testing.assert_allclose(found.radius_m[1:], hertz.contact_radius(TOP, R), rtol=1e-12)


@pytest.mark.parametrize("hold", [0.0, 0.7])
def test_element_by_element_one_press_is_tings_law(hold):
    t = np.linspace(0, 2 + hold, 301)
    d = np.interp(
        t, [0, 1, 1 + hold, 2 + hold] if hold else [0, 1, 2], [0, TOP, TOP, 0] if hold else [0, TOP, 0]
    )
    one, other = (law(t, d, R, SKIN, NU) for law in (viscoelastic.ting, viscoelastic.press))
    # 400 elements: (1/400)^2 in force, half an element in radius
    np.testing.assert_allclose(other.force_n, one.force_n, atol=1e-5 * one.force_n.max())
    np.testing.assert_allclose(other.radius_m, one.radius_m, atol=1.5e-3 * one.radius_m.max())


def test_held_on_the_way_back_the_skin_returns_to_equilibrium():
    t = np.linspace(0, 12, 601)
    d = np.interp(t, [0, 1, 1.5, 12], [0, TOP, TOP / 2, TOP / 2])
    with pytest.raises(RangeError, match="use press"):
        viscoelastic.ting(t, d, R, SKIN, NU)
    found = viscoelastic.press(t, d, R, SKIN, NU)
    after = found.radius_m[75:]
    assert (np.diff(after) >= 0).all()
    # ten seconds are twenty of the slowest times
    assert found.force_n[-1] == pytest.approx(
        hertz.force_from_depth(TOP / 2, R, SKIN.equilibrium_pa, NU), rel=1e-4
    )
    assert after[-1] == pytest.approx(hertz.contact_radius(TOP / 2, R), rel=3e-3)


LAWS = [viscoelastic.ting, viscoelastic.press]


@pytest.mark.parametrize("law", LAWS)
def test_what_is_no_history_is_refused(law):
    t, d = triangle(11)
    spoilt = d.copy()
    spoilt[3] = math.nan
    for times, depths, says in (
        (t, spoilt, "not finite"),
        (t[::-1].copy(), d, "does not increase"),
        (np.zeros(11), d, "does not increase"),
        (t, d + 1e-4, "first depth"),
        (t, 2 * d, "a/R"),
        (t[:1], d[:1], "no history"),
    ):
        with pytest.raises(RangeError, match=says):
            law(times, depths, R, SKIN, NU)
    for radius, nu in ((-R, NU), (math.nan, NU), (R, 0.6), (R, -0.1), (R, math.nan)):
        with pytest.raises(RangeError):
            law(t, d, radius, SKIN, nu)


def test_ting_refuses_a_second_press():
    t = np.linspace(0, 4, 41)
    with pytest.raises(RangeError, match="rise once"):
        viscoelastic.ting(t, TOP * np.interp(t, [0, 1, 2, 3, 4], [0, 1, 0, 1, 0]), R, SKIN, NU)
