"""A rigid sphere that sticks to an elastic half-space: Johnson, Kendall and Roberts (JKR); no friction.

With w the work of adhesion and E* the reduced modulus,

    F = 4 E* a^3 / (3 R) - sqrt(8 pi w E* a^3),    d = a^2 / R - sqrt(2 pi w a / E*),

and under a held load the sphere comes off at F = -(3/2) pi w R.

Valid for soft, large spheres: Tabor's parameter (R w^2 / (E*^2 z0^3))^(1/3), the stretch at pull-off over the
range z0 of the surface forces, above 5. Small strain, and a paraboloid for the sphere: a/R up to 0.5.
Every law here refuses, by a RangeError that names the range, what lies outside it.

Reference: K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324 (1971) 301,
doi:10.1098/rspa.1971.0141; on the range, K. L. Johnson, J. A. Greenwood, J. Colloid Interface Sci. 192 (1997)
326, doi:10.1006/jcis.1997.4984.
"""

from __future__ import annotations

import math

from scipy.optimize import brentq

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import MAX_SLOPE, positive, reduced_modulus

JKR_ABOVE = 5.0  # Tabor's parameter; below, surface forces act outside the contact too


def pull_off_force(work_of_adhesion_j_m2: float, radius_m: float) -> float:
    """The force -(3/2) pi w R [N] at which a sphere comes off under a held load; negative, for it is a pull.

    Example:
        >>> round(pull_off_force(0.05, 5e-3) * 1e3, 3)
        -1.178
    """
    return -1.5 * math.pi * _adhesion(work_of_adhesion_j_m2) * _radius(radius_m)


def force_from_radius(
    contact_radius_m: float,
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Force [N] on a contact of radius a, positive in compression."""
    a, R = _contact(contact_radius_m, radius_m), radius_m
    E, w = reduced_modulus(youngs_modulus_pa, poisson_ratio), _adhesion(work_of_adhesion_j_m2)
    return 4.0 * E * a**3 / (3.0 * R) - math.sqrt(8.0 * math.pi * w * E * a**3)


def depth_from_radius(
    contact_radius_m: float,
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Depth [m] of a contact of radius a; negative where the skin is drawn up."""
    a, R = _contact(contact_radius_m, radius_m), radius_m
    E, w = reduced_modulus(youngs_modulus_pa, poisson_ratio), _adhesion(work_of_adhesion_j_m2)
    return a**2 / R - math.sqrt(2.0 * math.pi * w * a / E)


def radius_from_force(
    force_n: float,
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Contact radius a [m] under a force, the stable branch.

    a^3 = 3 R / (4 E*) [F + 3 pi w R + sqrt(6 pi w R F + (3 pi w R)^2)]; w = 0 is Hertz's.
    """
    w, R = _adhesion(work_of_adhesion_j_m2), _radius(radius_m)
    E, least = reduced_modulus(youngs_modulus_pa, poisson_ratio), pull_off_force(w, R)
    if not (force_n >= least * (1 + 1e-12) and math.isfinite(force_n)):
        raise RangeError(
            f"force {force_n:g} N is below {least:g} N, where the sphere comes off; give a weaker pull"
        )
    n = 3.0 * math.pi * w * R
    cubed = 0.75 * R / E * (force_n + n + math.sqrt(max(n * (2.0 * force_n + n), 0.0)))
    return _contact(math.cbrt(max(cubed, 0.0)), R)


def radius_from_depth(
    depth_m: float,
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Contact radius a [m] at a held depth, on the branch that is stable then; the contact is already made.

    Raises:
        RangeError: the depth is below ``pull_off_depth`` or beyond a/R = 0.5, or an argument is out of range.
    """
    w, R = _adhesion(work_of_adhesion_j_m2), _radius(radius_m)
    material = (w, R, youngs_modulus_pa, poisson_ratio)
    a_least, a_greatest = _least_radius(*material), MAX_SLOPE * R
    least = depth_from_radius(a_least, *material)
    greatest = depth_from_radius(a_greatest, *material)
    if not least - 1e-12 * abs(least) <= depth_m <= greatest * (1 + 1e-12):
        raise RangeError(
            f"depth {depth_m:g} m lies outside {least:g} m, where the sphere comes off, to {greatest:g} m, "
            f"where a/R is {MAX_SLOPE}"
        )
    if depth_m <= least:
        return a_least
    if depth_m >= greatest:
        return a_greatest
    return brentq(
        lambda a: depth_from_radius(a, *material) - depth_m, a_least, a_greatest, xtol=1e-300, rtol=1e-14
    )


def force_from_depth(
    depth_m: float,
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> float:
    """Force [N] at a held depth, on the branch of ``radius_from_depth``.

    Raises:
        RangeError: the depth is below ``pull_off_depth`` or beyond a/R = 0.5, or an argument is out of range.
    """
    material = (work_of_adhesion_j_m2, radius_m, youngs_modulus_pa, poisson_ratio)
    return force_from_radius(radius_from_depth(depth_m, *material), *material)


def pull_off_depth(
    work_of_adhesion_j_m2: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Depth [m] at which a sphere held by a stiff stage comes off; negative, for the skin is drawn up."""
    material = (work_of_adhesion_j_m2, radius_m, youngs_modulus_pa, poisson_ratio)
    return depth_from_radius(_least_radius(*material), *material)


def tabor_parameter(
    work_of_adhesion_j_m2: float,
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
    range_m: float,
) -> float:
    """(R w^2 / (E*^2 z0^3))^(1/3); JKR's law holds above 5 (``JKR_ABOVE``).

    Args:
        work_of_adhesion_j_m2, radius_m, youngs_modulus_pa, poisson_ratio: w, R, E, nu.
        range_m: z0, over which the surface forces act, some tenths of a nanometre for molecular contact [m].
    """
    w, R = _adhesion(work_of_adhesion_j_m2), _radius(radius_m)
    positive("the range of the surface forces", range_m, "m")
    E = reduced_modulus(youngs_modulus_pa, poisson_ratio)
    return math.cbrt(R * (w / E) ** 2) / range_m


def _least_radius(w: float, R: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Contact radius [m] at which d(a) is least: 2 a / R = sqrt(pi w / (2 E* a))."""
    E = reduced_modulus(youngs_modulus_pa, poisson_ratio)
    return _contact(math.cbrt(math.pi * _adhesion(w) * _radius(R) ** 2 / (8.0 * E)), R)


def _adhesion(w: float) -> float:
    if not (w >= 0.0 and math.isfinite(w)):
        raise RangeError(f"work of adhesion {w} J/m^2 is not 0 or more; silicone rubber has about 0.05 J/m^2")
    return w


def _radius(radius_m: float) -> float:
    positive("the sphere's radius", radius_m, "m")
    return radius_m


def _contact(a: float, R: float) -> float:
    positive("the sphere's radius", R, "m")
    if not 0.0 <= a <= MAX_SLOPE * R * (1 + 1e-12):
        raise RangeError(
            f"contact radius {a:g} m lies outside 0 to {MAX_SLOPE * R:g} m, where JKR's law holds "
            f"(a/R <= {MAX_SLOPE}); use a larger sphere or a smaller load"
        )
    return a
