"""Stress to birefringence: Maxwell's stress-optic law in the plane across the ray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from palpate.core.errors import RangeError

Summed = Float[ndarray, "*n"]


@dataclass(frozen=True, slots=True)
class StressOpticLaw:
    """n1 - n2 = C (s1 - s2), with Cauchy's form for how C changes with wavelength.

    Attributes:
        coefficient_per_pa: C at the reference wavelength [1/Pa].
        dispersion_m2: D in C(l) = C (1 + D (1/l^2 - 1/l0^2)) [m^2]; 0 is no dispersion.
        reference_wavelength_m: l0 [m].
    """

    coefficient_per_pa: float
    dispersion_m2: float = 0.0
    reference_wavelength_m: float = 550e-9

    def __post_init__(self) -> None:
        if not self.coefficient_per_pa > 0.0:
            raise RangeError(
                f"stress-optic coefficient {self.coefficient_per_pa} 1/Pa; give a positive one (rubbers have "
                "1e-10 to 1e-8 1/Pa)"
            )

    def at(self, wavelength_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """C [1/Pa] at each wavelength [m]."""
        bend = 1 / wavelength_m**2 - 1 / self.reference_wavelength_m**2
        return self.coefficient_per_pa * (1 + self.dispersion_m2 * bend)


def fringe_order(
    difference: Summed, shear: Summed, coefficient_per_pa: float, wavelength_m: float
) -> Float[ndarray, "*n"]:
    """Fringe order N = C |int (s1 - s2) dy| / lambda of a ray along y whose stress axes do not turn.

    Args:
        difference: int (s_xx - s_zz) dy [Pa m].
        shear: int 2 s_xz dy [Pa m].
        coefficient_per_pa: C [1/Pa].
        wavelength_m: in vacuum [m].

    Returns:
        N, dimensionless and not negative; one order is one wavelength of retardance.
    """
    return np.asarray(coefficient_per_pa * np.hypot(difference, shear) / wavelength_m)


def stress_axis(difference: Summed, shear: Summed) -> Float[ndarray, "*n"]:
    """Angle of the larger principal stress from x towards z [rad], -pi/2 to pi/2."""
    return np.asarray(np.arctan2(shear, difference) / 2)
