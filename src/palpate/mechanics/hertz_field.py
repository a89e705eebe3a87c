"""Stress below a Hertz contact on an incompressible half-space, in closed form.

At nu = 1/2 the stress that birefringence sees is z times the Hessian of one Newtonian potential V, that of a
disc whose surface density is the pressure (Johnson 3.11 with 1 - 2 nu = 0):

    s_xx - s_zz = -(z / 2 pi) (V_xx - V_zz),      2 s_xz = -(z / pi) V_xz.

For Hertz's pressure V is a segment of point charges at complex depths z + i t with a parabolic density,

    V = c  int_{-a}^{a} (a^2 - t^2) / sqrt(r^2 + (z + i t)^2) dt,      c = pi p0 / (2 a),

whose derivatives are elementary in w = z + i a, S = sqrt(r^2 + w^2), q = w + S.

Reference: K. L. Johnson, Contact Mechanics (1985), sec. 3.2, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.core.shapes import Float

SURFACE = (
    1e-12  # depth in contact radii that stands for z -> 0, where the edge circle's 1/S would be infinite
)

Points = Float[ndarray, "..."] | float
Stress = Float[ndarray, "..."]


def secondary_stress(
    x_m: Points, y_m: Points, z_m: Points, contact_radius_m: float, peak_pressure_pa: float
) -> tuple[Stress, Stress]:
    """The two stresses that a ray along y sees, below a Hertz contact at the origin; nu = 1/2.

    Args:
        x_m: across the ray [m].
        y_m: along the ray [m].
        z_m: into the skin, not negative [m]; the three shapes broadcast.
        contact_radius_m: a, positive [m].
        peak_pressure_pa: p0 [Pa].

    Returns:
        s_xx - s_zz and 2 s_xz [Pa], positive in tension. The relative rounding error is about 1e-16 (rho/a)^2
        at a distance rho from the contact.

    Raises:
        RangeError: a is not positive or some z is negative.
    """
    if not contact_radius_m > 0.0:
        raise RangeError(f"contact radius {contact_radius_m} m has no field; give a positive radius in m")
    if np.any(np.asarray(z_m) < 0):
        raise RangeError("the skin lies at z >= 0 m; a negative z is in the air above it")
    a = contact_radius_m
    z = np.maximum(z_m, SURFACE * a)
    w = z + 1j * a
    S = np.sqrt(x_m**2 + y_m**2 + w**2)
    q = w + S
    L = np.log(q)
    c = np.pi * peak_pressure_pa / (2 * a)
    V_zz = 4 * c * (L.imag - a * (1 / S).real)
    V_r_over_r = -2 * c * (L + np.conj(w) / q).imag
    x2_part = -2 * c * ((S + 2j * a) / (S * q**2)).imag
    V_xx = V_r_over_r + x_m**2 * x2_part
    V_xz = -4 * c * x_m * ((S + 1j * a) / (S * q)).imag
    return np.asarray(-z / (2 * np.pi) * (V_xx - V_zz)), np.asarray(-z / np.pi * V_xz)
