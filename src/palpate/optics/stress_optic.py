"""Stress-optic law: from stress to birefringence in the plane across the ray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, RangeError, ndarray

ASSUMED_DISPERSION_M2 = 1e-14  # C is 3 % larger at 400 nm than at 550 nm (assumed)

Summed = Float[ndarray, "*n"]


@dataclass(frozen=True, slots=True)
class StressOpticLaw:
    """n1 - n2 = C (s1 - s2), with Cauchy dispersion.

    Attributes:
        coefficient_per_pa: C at the reference wavelength [1/Pa].
        dispersion_m2: D in C(l) = C (1 + D (1/l^2 - 1/l0^2)) [m^2]; unpublished for silicones, see
            `ASSUMED_DISPERSION_M2`.
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
        if not (np.isfinite(self.coefficient_per_pa) and np.isfinite(self.dispersion_m2)):
            raise RangeError("coefficient [1/Pa] and dispersion [m^2] must be finite numbers")
        if not self.reference_wavelength_m > 0.0:
            raise RangeError(f"reference wavelength {self.reference_wavelength_m} m must be positive")

    def at(self, wavelength_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """C at each wavelength [1/Pa]."""
        bend = 1 / wavelength_m**2 - 1 / self.reference_wavelength_m**2
        return self.coefficient_per_pa * (1 + self.dispersion_m2 * bend)

    def half_phase(self, wavelength_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Half the phase per Pa m at each wavelength: pi C / lambda [1/(Pa m)]."""
        if not np.all(wavelength_m > 0):
            raise RangeError("every wavelength must be positive; give metres, such as 550e-9")
        coefficient = self.at(wavelength_m)
        if not np.all(coefficient > 0):
            raise RangeError(
                f"dispersion {self.dispersion_m2} m^2 leaves no positive coefficient at some wavelength; "
                "plastics have about 1e-14 m^2"
            )
        return np.asarray(np.pi * coefficient / wavelength_m)


def fringe_order(
    difference: Summed, shear: Summed, coefficient_per_pa: float, wavelength_m: float
) -> Float[ndarray, "*n"]:
    """Return the fringe order N = C |int (s1 - s2) dy| / lambda of a ray whose stress axes do not rotate.

    Args:
        difference: int (s_xx - s_zz) dy [Pa m].
        shear: int 2 s_xz dy [Pa m].
        coefficient_per_pa: C [1/Pa].
        wavelength_m: Vacuum wavelength [m].
    """
    return np.asarray(coefficient_per_pa * np.hypot(difference, shear) / wavelength_m)


def stress_axis(difference: Summed, shear: Summed) -> Float[ndarray, "*n"]:
    """Return the angle of the larger principal stress from x towards z, -pi/2 to pi/2 [rad]."""
    return np.asarray(np.arctan2(shear, difference) / 2)


def frozen_stress(birefringence: float, axis_rad: float, law: StressOpticLaw) -> tuple[float, float]:
    """Return s_xx - s_zz and 2 s_xz [Pa] equivalent to a uniform residual birefringence.

    Args:
        birefringence: n1 - n2 at the reference wavelength, dispersing like C.
        axis_rad: Axis of the larger index from x towards z [rad].
        law: Stress-optic law.
    """
    if not (np.isfinite(birefringence) and np.isfinite(axis_rad)):
        raise RangeError(f"birefringence {birefringence} and axis {axis_rad} rad must be finite numbers")
    stress = birefringence / law.coefficient_per_pa
    return float(stress * np.cos(2 * axis_rad)), float(stress * np.sin(2 * axis_rad))
