"""Partial slip of a pressed sphere under a tangential force, by Cattaneo and Mindlin.

Under constant normal force P, friction mu, and tangential force Q below mu P,

    c = a (1 - Q/(mu P))^(1/3),    q(r) = mu p0 [ sqrt(1 - r^2/a^2) - (c/a) sqrt(1 - r^2/c^2) ],
    delta = D [ 1 - (1 - Q/(mu P))^(2/3) ],    D = 3 mu P (2 - nu) / (16 a G),

where the second root is 0 outside the stick circle r < c. Valid for a/R up to 0.5. Traction in the slip ring
is along the pull; its effect on the pressure for nu < 1/2 is neglected.

Reference: K. L. Johnson, Contact
Mechanics (1985), sec. 7.2, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive, reduced_modulus

Points = Float[ndarray, "..."]


def stick_radius(pull_n: float, force_n: float, friction: float, contact_radius_m: float) -> float:
    """Return the radius c of the stick circle [m].

    Args:
        pull_n: Tangential force Q, 0 to mu P [N].
        force_n: Normal force P [N].
        friction: Coefficient mu.
        contact_radius_m: a [m].

    Example:
        >>> round(stick_radius(0.35, 1.0, 0.4, 2e-3) * 1e3, 9)
        1.0
    """
    positive("contact radius", contact_radius_m, "m")
    return contact_radius_m * math.cbrt(1.0 - _share(pull_n, force_n, friction))


def tangential_stiffness(contact_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return dQ/d(delta) = 8 a G / (2 - nu) without slip [N/m]."""
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
    """Return the displacement of the stick circle and the sphere under a monotonic pull [m]."""
    share = _share(pull_n, force_n, friction)
    k = tangential_stiffness(contact_radius_m, youngs_modulus_pa, poisson_ratio)
    log_rest = math.log1p(-share) if share < 1.0 else -math.inf
    return 1.5 * friction * force_n / k * -math.expm1(2.0 / 3.0 * log_rest)


def traction(r_m: Points, pull_n: float, force_n: float, friction: float, contact_radius_m: float) -> Points:
    """Return the tangential traction q along the pull at distance r [Pa]; zero outside the contact."""
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
