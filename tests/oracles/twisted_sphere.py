"""A pressed sphere twisted about its axis, which the friction solver is compared with; small strain.

By Lubkin: a disc of radius s that sticks to a half-space and turns by B carries 16/3 G s^3 B (Reissner and
Sagoci). Discs of all radii from c to a, turned on top of one another, leave a stick circle of radius c and
around it the traction mu p of Hertz's pressure. With D = K - E, the complete elliptic integrals of
m = 1 - s^2 / a^2,

    turn(c) = mu p0 / (2 G) D(c),      moment(c) = 8/3 mu p0 [c^3 D(c) + 3 int_c^a s^2 D(s) ds].

No turn makes all of it slip; the moment tends to 3 pi / 16 mu P a. What holds for any nu: twisting moves
nothing into the skin.

References: J. L. Lubkin, J. Appl. Mech. 18, 183 (1951); E. Reissner and H. F. Sagoci, J. Appl. Phys. 15, 652
(1944); K. L. Johnson, Contact Mechanics (1985), sec. 3.9 and 7.4, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math

from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipe, ellipkm1

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import positive, reduced_modulus

MIN_STICK = 1e-9  # over the contact's radius: below it the moment is that of slip to rounding


def twisting_stiffness(contact_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """dM/d(turn) = 16/3 G a^3 while all sticks [N m/rad]."""
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
