"""Point force on an elastic half-space: Boussinesq and Cerruti; small strain, any nu.

A harmonic F with F_z = V, the potential of the load, gives the field of a normal load, and F1 with F1_z = F
that of a load along x, e.g.

    2 pi s_xx = 2 nu V_z - (1 - 2 nu) F_xx - z V_xx                           (normal; Johnson 3.2)
    2 pi s_xx = 2 (1 + nu) F_xz + 2 nu F1_xxx - z F_xxx                      (along x)

A point force has F = P ln(rho + z); a Hertz contact its integral (``subsurface``). Stress is positive in
tension; z points into the half-space.

Reference: K. L. Johnson, Contact Mechanics (1985), sec. 3.2 and 3.6, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import in_skin, reduced_modulus

Points = Float[ndarray, "..."] | float
Tensors = Float[ndarray, "... 3 3"]


@dataclass(frozen=True, slots=True)
class Potentials:
    """Derivatives of the axisymmetric F, V = F_z, and F1 (F1_z = F).

    With ' the derivative by r divided by r, ``a`` is K', ``b`` is K'', and ``c`` is K''': K_x = x a,
    K_xx = a + x^2 b, K_xy = x y b, K_xxx = 3 x b + x^3 c; ``v_az`` is (V_z)'.
    """

    v_z: Points
    v_zz: Points
    v_a: Points
    v_b: Points
    v_az: Points
    f_a: Points
    f_b: Points
    f_c: Points
    f1_b: Points
    f1_c: Points


def point_potentials(x: Points, y: Points, z: Points) -> Potentials:
    """Return derivatives of F = ln(rho + z), V = 1/rho, and F1 = z ln(rho + z) - rho."""
    rho = np.sqrt(np.square(x) + np.square(y) + np.square(z))
    q = rho + z
    return Potentials(
        v_z=-z / rho**3,
        v_zz=(3 * np.square(z) / rho**2 - 1) / rho**3,
        v_a=-1 / rho**3,
        v_b=3 / rho**5,
        v_az=3 * z / rho**5,
        f_a=1 / (rho * q),
        f_b=-(2 * rho + z) / (rho**3 * q**2),
        f_c=(8 * rho**2 + 9 * rho * z + 3 * np.square(z)) / (rho**5 * q**3),
        f1_b=1 / (rho * q**2),
        f1_c=-(3 * rho + z) / (rho**3 * q**3),
    )


def _third_derivatives(b: Points, c: Points, x: Points, y: Points) -> tuple[Points, Points, Points]:
    """K_xxx, K_xyy, and K_xxy from ``b`` and ``c``."""
    return 3 * x * b + x**3 * c, x * b + x * y**2 * c, y * b + x**2 * y * c


def stress_of_normal_load(K: Potentials, x: Points, y: Points, z: Points, nu: float) -> Tensors:
    """Return the stress under a normal surface load with these potentials [Pa]."""
    m = 1 - 2 * nu
    xx = 2 * nu * K.v_z - m * (K.f_a + x**2 * K.f_b) - z * (K.v_a + x**2 * K.v_b)
    yy = 2 * nu * K.v_z - m * (K.f_a + y**2 * K.f_b) - z * (K.v_a + y**2 * K.v_b)
    xy = -m * x * y * K.f_b - z * x * y * K.v_b
    zz = K.v_z - z * K.v_zz
    return _symmetric(xx, yy, zz, xy, -z * y * K.v_az, -z * x * K.v_az) / (2 * np.pi)


def stress_of_load_along_x(K: Potentials, x: Points, y: Points, z: Points, nu: float) -> Tensors:
    """Return the stress under a tangential surface load along x with these potentials [Pa]."""
    f_xxx, f_xyy, f_xxy = _third_derivatives(K.f_b, K.f_c, x, y)
    f1_xxx, f1_xyy, f1_xxy = _third_derivatives(K.f1_b, K.f1_c, x, y)
    xx = 2 * (1 + nu) * x * K.v_a + 2 * nu * f1_xxx - z * f_xxx
    yy = 2 * nu * x * K.v_a + 2 * nu * f1_xyy - z * f_xyy
    xy = y * K.v_a + 2 * nu * f1_xxy - z * f_xxy
    xz = K.v_z - z * (K.v_a + x**2 * K.v_b)
    return _symmetric(xx, yy, -z * x * K.v_az, xy, -z * x * y * K.v_b, xz) / (2 * np.pi)


def boussinesq_stress(x_m: Points, y_m: Points, z_m: Points, force_n: float, poisson_ratio: float) -> Tensors:
    """Return the stress under a force along z on the surface at the origin [Pa].

    Args:
        x_m, y_m, z_m: Points, z >= 0 [m]; shapes broadcast.
        force_n: Force into the half-space [N].
        poisson_ratio: 0 to 0.5.

    Returns:
        Symmetric tensor ``[... 3 3]``, positive in tension.
    """
    reduced_modulus(1.0, poisson_ratio)
    _below(x_m, y_m, z_m)
    K = point_potentials(x_m, y_m, z_m)
    return _finite(force_n) * stress_of_normal_load(K, x_m, y_m, z_m, poisson_ratio)


def cerruti_stress(x_m: Points, y_m: Points, z_m: Points, force_n: float, poisson_ratio: float) -> Tensors:
    """Return the stress under a force along x on the surface at the origin [Pa]; see
    ``boussinesq_stress``.
    """
    reduced_modulus(1.0, poisson_ratio)
    _below(x_m, y_m, z_m)
    K = point_potentials(x_m, y_m, z_m)
    return _finite(force_n) * stress_of_load_along_x(K, x_m, y_m, z_m, poisson_ratio)


def _symmetric(xx: Points, yy: Points, zz: Points, xy: Points, yz: Points, xz: Points) -> Tensors:
    xx, yy, zz, xy, yz, xz = np.broadcast_arrays(xx, yy, zz, xy, yz, xz)
    return np.stack([np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)


def _below(x: Points, y: Points, z: Points) -> None:
    in_skin(x, y, z)
    if np.any((np.asarray(x) == 0) & (np.asarray(y) == 0) & (np.asarray(z) == 0)):
        raise RangeError(
            "a point lies on the force, where the field is infinite; move it away", code="singular-point"
        )


def _finite(force_n: float) -> float:
    if not np.isfinite(force_n):
        raise RangeError(f"force {force_n} N is not a finite number of newtons")
    return force_n
