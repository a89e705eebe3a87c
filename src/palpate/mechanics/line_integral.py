"""Hertz's stress summed along a ray, in closed form.

Summed over y, the equations of a laterally infinite half-space become those of plane strain under the summed
load. So for any Poisson's ratio, int (s_xx, s_zz, s_xz) dy under a Hertz contact is the plane field of the
parabola  int p dy = P0 (1 - x^2/a^2),  P0 = (pi/2) p0 a.
With zeta = x + i z, Flamant's line loads under it add up to

    int (s_xx - s_zz) dy = -(2/pi) z Re K,     int 2 s_xz dy = (2/pi) z Im K,
    K = int (int p dy)(s) / (zeta - s)^2 ds = P0 [ -(2 zeta/a^2) ln((zeta - a)/(zeta + a)) - 4/a ].

Reference for Flamant's line load: K. L. Johnson, Contact Mechanics (1985), sec. 2.2,
doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.core.shapes import Complex, Float

FAR = (
    8.0  # contact radii beyond which the series is used: the closed form loses (r/a)^2 digits by cancellation
)
TERMS = 9  # of the series in (a/zeta)^2; the first left out is below 1e-17 of the sum at FAR

Points = Float[ndarray, "..."] | float
Summed = Float[ndarray, "..."]


def line_integrated_stress(
    x_m: Points, z_m: Points, contact_radius_m: float, peak_pressure_pa: float
) -> tuple[Summed, Summed]:
    """Stress summed along y under a Hertz contact at the origin; any Poisson's ratio.

    Args:
        x_m: where the ray passes [m].
        z_m: how far below the surface, not negative [m].
        contact_radius_m: a, positive [m].
        peak_pressure_pa: p0 [Pa].

    Returns:
        int (s_xx - s_zz) dy and int 2 s_xz dy [Pa m], positive in tension; both zero at z = 0.

    Raises:
        RangeError: a is not positive or some z is negative.
    """
    if not contact_radius_m > 0.0:
        raise RangeError(f"contact radius {contact_radius_m} m has no field; give a positive radius in m")
    if np.any(np.asarray(z_m) < 0):
        raise RangeError("the skin lies at z >= 0 m; a negative z is in the air above it")
    a = contact_radius_m
    zeta = np.asarray((x_m + 1j * np.asarray(z_m)) / a)
    P0 = np.pi / 2 * peak_pressure_pa * a
    K = P0 / a * np.where(abs(zeta) > FAR, _kernel_far(zeta), _kernel_near(zeta))
    return np.asarray(-2 / np.pi * z_m * K.real), np.asarray(2 / np.pi * z_m * K.imag)


def _kernel_near(zeta: Complex[ndarray, "*n"]) -> Complex[ndarray, "*n"]:
    on_edge = (zeta.imag == 0) & (abs(zeta.real) == 1)  # z K is zero there, K alone is not finite
    zeta = np.where(on_edge, 0.0, zeta)
    return np.asarray(-2 * zeta * np.log((zeta - 1) / (zeta + 1)) - 4)


def _kernel_far(zeta: Complex[ndarray, "*n"]) -> Complex[ndarray, "*n"]:
    u2 = 1 / np.where(abs(zeta) > FAR, zeta, FAR) ** 2
    coefficients = 4 / (2 * np.arange(TERMS + 1) + 1)
    coefficients[0] = 0.0
    return np.asarray(np.polynomial.polynomial.polyval(u2, coefficients))
