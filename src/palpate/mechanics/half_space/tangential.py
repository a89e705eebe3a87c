"""A pressed sphere pulled sideways: it sticks inside a circle and slips around it; small strain.

By Cattaneo and Mindlin, under a constant normal force P, Coulomb's friction and a tangential force Q
below mu P,

    c = a (1 - Q/(mu P))^(1/3),    q(r) = mu p0 [ sqrt(1 - r^2/a^2) - (c/a) sqrt(1 - r^2/c^2) ],
    delta = D [ 1 - (1 - Q/(mu P))^(2/3) ],    D = 3 mu P (2 - nu) / (16 a G),

for a rigid sphere on a half-space. The second root in q stands for 0 outside the stick circle r < c.

Valid for a Hertz contact (a/R up to 0.5). The stick circle moves as one, exactly. In the slip ring the
traction is taken along the pull, from which the slip turns a little where nu > 0; and for nu < 1/2 what the
traction does to the pressure is left out.

Outside its range a law raises RangeError.

Reference: K. L. Johnson, Contact Mechanics (1985), sec. 7.2, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive, reduced_modulus

Points = Float[ndarray, "..."]


def stick_radius(pull_n: float, force_n: float, friction: float, contact_radius_m: float) -> float:
    """Radius c of the circle that sticks [m].

    Args:
        pull_n: tangential force Q, 0 to mu P [N].
        force_n: normal force P, positive [N].
        friction: coefficient mu, positive.
        contact_radius_m: a, positive [m].

    Example:
        >>> round(stick_radius(0.35, 1.0, 0.4, 2e-3) * 1e3, 9)
        1.0
    """
    positive("contact radius", contact_radius_m, "m")
    return contact_radius_m * math.cbrt(1.0 - _share(pull_n, force_n, friction))


def tangential_stiffness(contact_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """dQ/d(delta) = 8 a G / (2 - nu) at the first pull, while all sticks [N/m]."""
    positive("contact radius", contact_radius_m, "m")
    G = reduced_modulus(youngs_modulus_pa, poisson_ratio) * (1.0 - poisson_ratio) / 2.0
    return 8.0 * contact_radius_m * G / (2.0 - poisson_ratio)


def tangential_displacement(
    pull_n: float,
    force_n: float,
    friction: float,
    contact_radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Displacement of the stick circle, and of the sphere with it, along a pull that only grew [m]."""
    share = _share(pull_n, force_n, friction)
    k = tangential_stiffness(contact_radius_m, youngs_modulus_pa, poisson_ratio)
    log_rest = math.log1p(-share) if share < 1.0 else -math.inf
    return 1.5 * friction * force_n / k * -math.expm1(2.0 / 3.0 * log_rest)


def traction(r_m: Points, pull_n: float, force_n: float, friction: float, contact_radius_m: float) -> Points:
    """Tangential traction q [Pa] on the skin along the pull, at distance r [m]; zero outside the contact."""
    a, c = contact_radius_m, stick_radius(pull_n, force_n, friction, contact_radius_m)
    p0 = 1.5 * force_n / (math.pi * a**2)
    stick = np.sqrt(np.maximum(c**2 - np.square(r_m), 0.0)) / a  # (c/a) sqrt(1 - r^2/c^2)
    return np.asarray(friction * p0 * (np.sqrt(np.maximum(1.0 - np.square(r_m / a), 0.0)) - stick))


def _share(pull_n: float, force_n: float, friction: float) -> float:
    """Q / (mu P)."""
    positive("normal force", force_n, "N")
    positive("the coefficient of friction", friction, "(a ratio)")
    limit = friction * force_n
    if not 0.0 <= pull_n <= limit * (1 + 1e-12):
        raise RangeError(
            f"pull {pull_n:g} N lies outside 0 to {limit:g} N, the friction that holds it; beyond it the "
            "whole contact slides",
            code="sliding",
        )
    return min(pull_n / limit, 1.0)
