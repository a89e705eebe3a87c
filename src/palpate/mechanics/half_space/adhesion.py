"""Adhesive contact of a rigid sphere and an elastic half-space: Johnson, Kendall, and Roberts (JKR).

With work of adhesion w and reduced modulus E*,

    F = 4 E* a^3 / (3 R) - sqrt(8 pi w E* a^3),    d = a^2 / R - sqrt(2 pi w a / E*),

and pull-off under a dead load at F = -(3/2) pi w R. Valid for Tabor's parameter (R w^2 / (E*^2 z0^3))^(1/3)
above 5 and a/R up to 0.5.

References: K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324 (1971)
301, doi:10.1098/rspa.1971.0141; K. L. Johnson, J. A. Greenwood, J. Colloid Interface Sci. 192 (1997) 326,
doi:10.1006/jcis.1997.4984.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import MAX_SLOPE, positive, reduced_modulus

JKR_ABOVE = 5.0  # minimum of Tabor's parameter


@dataclass(frozen=True, slots=True)
class AdhesiveSphere:
    """An adhesive sphere on a half-space.

    Attributes:
        work_of_adhesion_j_m2: w, 0 or more; about 0.05 for silicone rubber [J/m^2].
        radius_m: R [m].
        youngs_modulus_pa, poisson_ratio: Half-space [Pa], 0 to 0.5.

    Example:
        >>> round(AdhesiveSphere(0.05, 5e-3, 0.3e6, 0.49).pull_off_force_n * 1e3, 3)
        -1.178
    """

    work_of_adhesion_j_m2: float
    radius_m: float
    youngs_modulus_pa: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        w = self.work_of_adhesion_j_m2
        if not (w >= 0.0 and math.isfinite(w)):
            raise RangeError(
                f"work of adhesion {w} J/m^2 is not 0 or more; silicone rubber has about 0.05 J/m^2"
            )
        positive("the sphere's radius", self.radius_m, "m")
        reduced_modulus(self.youngs_modulus_pa, self.poisson_ratio)

    @property
    def pull_off_force_n(self) -> float:
        """Force -(3/2) pi w R at which contact is lost under a dead load [N]."""
        return -1.5 * math.pi * self.work_of_adhesion_j_m2 * self.radius_m

    @property
    def pull_off_depth_m(self) -> float:
        """Depth at which contact is lost on a stiff stage, negative [m]."""
        return self.depth_from_radius(self._least_radius)

    def force_from_radius(self, contact_radius_m: float) -> float:
        """Force on a contact of radius a, positive in compression [N]."""
        a, w, E = self._in_range(contact_radius_m), self.work_of_adhesion_j_m2, self._reduced_modulus
        return 4.0 * E * a**3 / (3.0 * self.radius_m) - math.sqrt(8.0 * math.pi * w * E * a**3)

    def depth_from_radius(self, contact_radius_m: float) -> float:
        """Depth of a contact of radius a [m]."""
        a, w, E = self._in_range(contact_radius_m), self.work_of_adhesion_j_m2, self._reduced_modulus
        return a**2 / self.radius_m - math.sqrt(2.0 * math.pi * w * a / E)

    def radius_from_force(self, force_n: float) -> float:
        """Stable contact radius under a force [m]: a^3 = 3 R / (4 E*) [F + 3 pi w R + sqrt(6 pi w R F + (3 pi
        w R)^2)].
        """
        w, R, E = self.work_of_adhesion_j_m2, self.radius_m, self._reduced_modulus
        least = self.pull_off_force_n
        if not (force_n >= least * (1 + 1e-12) and math.isfinite(force_n)):
            raise RangeError(
                f"force {force_n:g} N is below {least:g} N, where the sphere comes off; give a weaker pull"
            )
        n = 3.0 * math.pi * w * R
        cubed = 0.75 * R / E * (force_n + n + math.sqrt(max(n * (2.0 * force_n + n), 0.0)))
        return self._in_range(math.cbrt(max(cubed, 0.0)))

    def radius_from_depth(self, depth_m: float) -> float:
        """Stable contact radius at a fixed depth of an existing contact [m]."""
        a_least, a_greatest = self._least_radius, MAX_SLOPE * self.radius_m
        least, greatest = self.depth_from_radius(a_least), self.depth_from_radius(a_greatest)
        if not least - 1e-12 * abs(least) <= depth_m <= greatest * (1 + 1e-12):
            raise RangeError(
                f"depth {depth_m:g} m lies outside {least:g} m, where the sphere comes off, to {greatest:g} "
                f"m, where a/R is {MAX_SLOPE}"
            )
        if depth_m <= least:
            return a_least
        if depth_m >= greatest:
            return a_greatest
        return brentq(
            lambda a: self.depth_from_radius(a) - depth_m, a_least, a_greatest, xtol=1e-300, rtol=1e-14
        )

    def force_from_depth(self, depth_m: float) -> float:
        return self.force_from_radius(self.radius_from_depth(depth_m))

    def tabor_parameter(self, range_m: float) -> float:
        """Tabor's parameter for surface forces of range z0 [m]; JKR holds above 5 (``JKR_ABOVE``)."""
        positive("the range of the surface forces", range_m, "m")
        return math.cbrt(self.radius_m * (self.work_of_adhesion_j_m2 / self._reduced_modulus) ** 2) / range_m

    @property
    def _reduced_modulus(self) -> float:
        return reduced_modulus(self.youngs_modulus_pa, self.poisson_ratio)

    @property
    def _least_radius(self) -> float:
        """Contact radius at which d(a) is minimal: 2 a / R = sqrt(pi w / (2 E* a)) [m]."""
        w, R = self.work_of_adhesion_j_m2, self.radius_m
        return self._in_range(math.cbrt(math.pi * w * R**2 / (8.0 * self._reduced_modulus)))

    def _in_range(self, a: float) -> float:
        limit = MAX_SLOPE * self.radius_m
        if not 0.0 <= a <= limit * (1 + 1e-12):
            raise RangeError(
                f"contact radius {a:g} m lies outside 0 to {limit:g} m, where JKR's law holds "
                f"(a/R <= {MAX_SLOPE}); use a larger sphere or a smaller load",
                code="outside-law",
            )
        return a
