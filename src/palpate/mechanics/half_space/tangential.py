"""A pressed sphere pulled sideways or twisted: it sticks inside a circle and slips around it; small strain.

Pulled (Cattaneo and Mindlin), under a constant normal force P, Coulomb's friction and a tangential force Q
below mu P,

    c = a (1 - Q/(mu P))^(1/3),    q(r) = mu p0 [ sqrt(1 - r^2/a^2) - (c/a) sqrt(1 - r^2/c^2) ],
    delta = D [ 1 - (1 - Q/(mu P))^(2/3) ],    D = 3 mu P (2 - nu) / (16 a G),

for a rigid sphere on a half-space. The second root in q stands for 0 outside the stick circle r < c.

Valid for a Hertz contact (a/R up to 0.5). The stick circle moves as one, exactly. In the slip ring the
traction is taken along the pull, from which the slip turns a little where nu > 0; and for nu < 1/2 what the
traction does to the pressure is left out.

Twisted about its axis (Lubkin): a disc of radius s
that sticks to a half-space and turns by B carries 16/3 G s^3 B (Reissner and Sagoci).
Discs of all radii from c to a, turned on top of one another, leave a stick circle of radius c and around it
the traction mu p of Hertz's pressure. With D = K - E, the complete elliptic integrals of m = 1 - s^2 / a^2,

    turn(c) = mu p0 / (2 G) D(c),      moment(c) = 8/3 mu p0 [c^3 D(c) + 3 int_c^a s^2 D(s) ds].

No turn makes all of it slip; the moment tends to 3 pi / 16 mu P a. What holds for any nu: twisting moves
nothing into the skin.

Outside its range a law raises RangeError.

References: K. L. Johnson, Contact Mechanics (1985), sec. 3.9, 7.2 and 7.4, doi:10.1017/CBO9781139171731;
J. L. Lubkin, J. Appl. Mech. 18, 183 (1951); E. Reissner and H. F. Sagoci, J. Appl. Phys. 15, 652 (1944).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipe, ellipkm1

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

    Raises:
        RangeError: an argument is out of its range; at Q = mu P the whole contact slides.

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
    return _greatest(force_n, friction, k) * -math.expm1(2.0 / 3.0 * _log_rest(share))


def returning_displacement(
    pull_n: float,
    turned_at_n: float,
    force_n: float,
    friction: float,
    contact_radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Sideways displacement [m] on the way back from a pull Q* to -Q*: the first curve, doubled and turned.

    Args:
        pull_n: tangential force Q now, -Q* to Q* [N].
        turned_at_n: the pull Q* from which it returns, 0 to mu P [N].
        force_n, friction, contact_radius_m, youngs_modulus_pa, poisson_ratio: see `tangential_displacement`.
    """
    _share(turned_at_n, force_n, friction)
    if not -turned_at_n <= pull_n <= turned_at_n:
        raise RangeError(
            f"pull {pull_n:g} N lies outside {-turned_at_n:g} to {turned_at_n:g} N, between the turns"
        )
    rest = (contact_radius_m, youngs_modulus_pa, poisson_ratio)
    there = tangential_displacement(turned_at_n, force_n, friction, *rest)
    return there - 2.0 * tangential_displacement((turned_at_n - pull_n) / 2.0, force_n, friction, *rest)


def energy_lost_per_cycle(
    turned_at_n: float,
    force_n: float,
    friction: float,
    contact_radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Work lost to friction while the pull goes from Q* to -Q* and back [J]."""
    s = _share(turned_at_n, force_n, friction)
    k = tangential_stiffness(contact_radius_m, youngs_modulus_pa, poisson_ratio)
    if s < 0.01:  # the closed form cancels to s^3; the first term left out is 3e-9 of the sum
        shape = 5 / 162 * s**3 * (1 + 2 / 3 * s + 7 / 15 * s**2 + 28 / 81 * s**3)
    else:
        shape = 1.0 - (1.0 - s) ** (5 / 3) - 5.0 / 6.0 * s * (1.0 + (1.0 - s) ** (2 / 3))
    return 4.8 * _greatest(force_n, friction, k) * friction * force_n * shape


def traction(r_m: Points, pull_n: float, force_n: float, friction: float, contact_radius_m: float) -> Points:
    """Tangential traction q [Pa] on the skin along the pull, at distance r [m]; zero outside the contact."""
    a, c = contact_radius_m, stick_radius(pull_n, force_n, friction, contact_radius_m)
    p0 = 1.5 * force_n / (math.pi * a**2)
    stick = np.sqrt(np.maximum(c**2 - np.square(r_m), 0.0)) / a  # (c/a) sqrt(1 - r^2/c^2)
    return np.asarray(friction * p0 * (np.sqrt(np.maximum(1.0 - np.square(r_m / a), 0.0)) - stick))


def _greatest(force_n: float, friction: float, stiffness: float) -> float:
    """D, the displacement at which all slides [m]."""
    return 1.5 * friction * force_n / stiffness


def _log_rest(share: float) -> float:
    return math.log1p(-share) if share < 1.0 else -math.inf


def _share(pull_n: float, force_n: float, friction: float) -> float:
    """Q / (mu P)."""
    positive("normal force", force_n, "N")
    positive("the coefficient of friction", friction, "(a ratio)")
    limit = friction * force_n
    if not 0.0 <= pull_n <= limit * (1 + 1e-12):
        raise RangeError(
            f"pull {pull_n:g} N lies outside 0 to {limit:g} N, the friction that holds it; beyond it the "
            "whole contact slides"
        )
    return min(pull_n / limit, 1.0)


MIN_STICK = 1e-9  # over the contact's radius: below it the moment is that of slip to rounding


def twisting_stiffness(contact_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """dM/d(turn) = 16/3 G a^3 while all sticks [N m/rad].

    Example:
        >>> round(twisting_stiffness(3e-3, 0.3e6, 0.5), 9)
        0.0144
    """
    positive("contact radius", contact_radius_m, "m")
    return 16 / 3 * _shear_modulus(youngs_modulus_pa, poisson_ratio) * contact_radius_m**3


def greatest_moment(force_n: float, friction: float, contact_radius_m: float) -> float:
    """Moment at which all of Hertz's contact slips, 3 pi / 16 mu P a [N m]."""
    positive("normal force", force_n, "N")
    positive("the coefficient of friction", friction, "(a ratio)")
    positive("contact radius", contact_radius_m, "m")
    return 3 * math.pi / 16 * friction * force_n * contact_radius_m


def twisting_moment(
    turn_rad: float,
    force_n: float,
    friction: float,
    contact_radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> tuple[float, float]:
    """Moment [N m] and radius of the stick circle [m] at a turn that only grew.

    Args:
        turn_rad: of the sphere, 0 or more [rad].
        force_n: normal force P, positive [N].
        friction: coefficient mu, positive.
        contact_radius_m: a, positive [m].
        youngs_modulus_pa, poisson_ratio: of the half-space [Pa].
    """
    greatest = greatest_moment(force_n, friction, contact_radius_m)
    if not 0.0 <= turn_rad < math.inf:
        raise RangeError(f"a turn of {turn_rad} rad; give a number of rad from 0 up")
    peak = 1.5 * friction * force_n / (math.pi * contact_radius_m**2)  # mu p0
    level = 2 * _shear_modulus(youngs_modulus_pa, poisson_ratio) * turn_rad / peak
    if level >= _difference(MIN_STICK):
        return greatest, 0.0
    stick = float(brentq(lambda c: _difference(c) - level, MIN_STICK, 1.0, xtol=1e-15))
    ring = quad(lambda s: s**2 * _difference(s), stick, 1.0, epsabs=1e-14, epsrel=1e-12)[0]
    moment = 8 / 3 * peak * contact_radius_m**3 * (stick**3 * _difference(stick) + 3 * ring)
    return float(moment), stick * contact_radius_m


def _difference(share: float) -> float:
    """K - E of the radius over the contact's."""
    return float(ellipkm1(share**2) - ellipe(1 - share**2))


def _shear_modulus(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    return reduced_modulus(youngs_modulus_pa, poisson_ratio) * (1.0 - poisson_ratio) / 2.0
