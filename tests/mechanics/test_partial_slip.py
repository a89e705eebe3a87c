import math

import numpy as np
import pytest
from scipy.integrate import quad
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space import hertz as slip

A, P, MU, E = 2e-3, 1.0, 0.8, 0.3e6
P0 = 1.5 * P / (math.pi * A**2)


def q(r, pull):
    return float(slip.traction(np.array(r), pull, P, MU, A))


@pytest.mark.parametrize("pull", [0.0, 0.5, 0.8])
def test_the_integral_of_traction_is_the_pull(pull):
    c = slip.stick_radius(pull, P, MU, A)
    total = quad(lambda r: 2 * math.pi * r * q(r, pull), 0, A, points=[c], epsabs=1e-10)[0]
    assert total == pytest.approx(pull, abs=1e-8)


@pytest.mark.parametrize("pull", [0.5])
def test_outside_the_stick_circle_the_traction_is_mu_times_the_pressure(pull):
    c = slip.stick_radius(pull, P, MU, A)
    r = np.linspace(0, A, 50)
    pressure = P0 * np.sqrt(1 - (r / A) ** 2)
    traction = slip.traction(r, pull, P, MU, A)
    np.testing.assert_allclose(traction[r >= c], MU * pressure[r >= c], rtol=1e-12)
    assert (traction[r < c] < MU * pressure[r < c]).all()


def displacement(x0, pull, nu):
    """Cerruti's surface displacement along the pull at (x0, 0), superposed in polar coordinates about it."""
    G = E / (2 * (1 + nu))
    c = slip.stick_radius(pull, P, MU, A)
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def ray(angle):
        # where the ray leaves the stick circle, and the contact
        ends = [-x0 * math.cos(angle) + math.sqrt(R**2 - (x0 * math.sin(angle)) ** 2) for R in (c, A)]
        total = 0.0
        for low, high in ((0.0, ends[0]), (ends[0], ends[1])):
            t = (1 + nodes) / 2
            s = low + (high - low) * t * (2 - t)  # takes the root at the far end out
            r = np.hypot(x0 + s * math.cos(angle), s * math.sin(angle))
            total += np.sum(weights / 2 * (high - low) * 2 * (1 - t) * slip.traction(r, pull, P, MU, A))
        return (1 - nu + nu * math.cos(angle) ** 2) * total

    return 2 * quad(ray, 0, math.pi, epsrel=1e-10)[0] / (2 * math.pi * G)


@pytest.mark.parametrize(("nu", "x0"), [(0.0, 0.5), (0.5, 0.0)])
def test_the_stick_circle_moves_as_one_by_the_stated_displacement(nu, x0):
    pull = 0.5
    c = slip.stick_radius(pull, P, MU, A)
    stated = slip.tangential_displacement(pull, P, MU, A, E, nu)
    # the quadrature's own error, from the root at the near edge
    assert displacement(x0 * c, pull, nu) == pytest.approx(stated, rel=1e-5)


def test_the_first_pull_meets_the_stiffness_of_a_stuck_contact():
    k = slip.tangential_stiffness(A, E, 0.49)
    G = E / (2 * 1.49)
    assert k == pytest.approx(8 * A * G / (2 - 0.49), rel=1e-12)
    tiny = 1e-7
    # the next order is Q / (6 mu P)
    assert slip.tangential_displacement(tiny, P, MU, A, E, 0.49) == pytest.approx(tiny / k, rel=1e-7)


@pytest.mark.parametrize("pull", [-0.1, 0.81, math.nan])
def test_a_pull_that_friction_does_not_hold_is_refused(pull):
    for ask in (
        lambda: slip.stick_radius(pull, P, MU, A),
        lambda: slip.traction(np.zeros(1), pull, P, MU, A),
        lambda: slip.tangential_displacement(pull, P, MU, A, E, 0.3),
    ):
        with refused("sliding", RangeError, match=r"0\.8"):
            ask()


@pytest.mark.parametrize("bad", [0.0, math.nan])
def test_what_else_lies_outside_is_refused(bad):
    for ask in (
        lambda: slip.stick_radius(0.1, bad, MU, A),
        lambda: slip.stick_radius(0.1, P, bad, A),
        lambda: slip.stick_radius(0.1, P, MU, bad),
        lambda: slip.tangential_stiffness(A, bad, 0.3),
        lambda: slip.tangential_stiffness(bad, E, 0.3),
    ):
        with pytest.raises(RangeError):
            ask()
    with pytest.raises(RangeError):
        slip.tangential_stiffness(A, E, 0.6)
