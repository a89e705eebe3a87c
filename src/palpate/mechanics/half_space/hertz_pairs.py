"""Hertz contact of two elastic spheres, and pairs of objects that one cue cannot distinguish.

With 1/E = 1/E1 + 1/E2, 1/R = 1/R1 + 1/R2, and E_i = Young's modulus over 1 - nu_i^2,

    P = 4/3 E sqrt(R) d^(3/2)      force and displacement determine E sqrt(R)
    A = pi (3 R P / 4 E)^(2/3)     force and contact area determine E / R

Equations (1) and (2) of the softness display's report print the right-hand sides exchanged.

References: K. L. Johnson, Contact Mechanics (1985), ch. 4, doi:10.1017/CBO9781139171731; E. P. Scilingo,
M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010) 109,
doi:10.1109/TOH.2010.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, RangeError, ndarray

Values = float | Float[ndarray, "*n"]


@dataclass(frozen=True)
class Body:
    """A sphere, or the equivalent of a pair: Young's modulus over 1 - nu^2 [Pa], and radius, infinite for a
    flat [m].
    """

    modulus_pa: float
    radius_m: float

    def __post_init__(self) -> None:
        if not (self.modulus_pa > 0 and self.radius_m > 0):
            raise RangeError(
                f"a sphere of {self.modulus_pa:g} Pa and {self.radius_m:g} m; both above 0, a flat's infinite"
            )

    def against(self, other: Body) -> Body:
        """The pair in contact, as one body on a rigid flat."""
        return Body(
            1 / (1 / self.modulus_pa + 1 / other.modulus_pa), 1 / (1 / self.radius_m + 1 / other.radius_m)
        )

    def force_n(self, approach_m: Values) -> Values:
        """P = 4/3 E sqrt(R) d^(3/2) [N]."""
        return 4 / 3 * self.modulus_pa * math.sqrt(self.radius_m) * np.asarray(approach_m) ** 1.5

    def approach_m(self, force_n: Values) -> Values:
        """Approach at a force [m]."""
        return (3 * np.asarray(force_n) / (4 * self.modulus_pa * math.sqrt(self.radius_m))) ** (2 / 3)

    def area_m2(self, force_n: Values) -> Values:
        """A = pi (3 R P / 4 E)^(2/3) [m^2]."""
        return math.pi * (3 * self.radius_m * np.asarray(force_n) / (4 * self.modulus_pa)) ** (2 / 3)


def alike_to_the_arm(one: Body, finger: Body, modulus_pa: float) -> Body:
    """Return the object of another modulus with equal force over displacement under this finger."""
    E1, E2 = one.against(finger).modulus_pa, Body(modulus_pa, 1.0).against(finger).modulus_pa
    return _partner(modulus_pa, (E1 / E2) ** 2 * one.against(finger).radius_m, finger)


def alike_to_the_skin(one: Body, finger: Body, modulus_pa: float) -> Body:
    """Return the object of another modulus with equal contact area over force under this finger."""
    E1, E2 = one.against(finger).modulus_pa, Body(modulus_pa, 1.0).against(finger).modulus_pa
    return _partner(modulus_pa, E2 / E1 * one.against(finger).radius_m, finger)


def _partner(modulus_pa: float, together_m: float, finger: Body) -> Body:
    """Object that has this radius together with the finger."""
    curvature = 1 / together_m - 1 / finger.radius_m
    if not curvature > 0:
        raise RangeError(
            f"no ball of {modulus_pa:g} Pa feels alike: it would have to be hollow, since a flat one makes "
            f"{1e3 * finger.radius_m:.3g} mm with the finger, and {1e3 * together_m:.3g} mm are needed"
        )
    return Body(modulus_pa, 1 / curvature)
