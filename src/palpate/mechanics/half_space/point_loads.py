"""A point force on or in an elastic half-space: Boussinesq, Cerruti and Mindlin; small strain, any nu.

Forces on the surface. A harmonic F with F_z = V, where V is the potential of the surface load, gives the
field of a normal load, and with F1_z = F that of a load along x:

    2 pi s_xx = 2 nu V_z - (1 - 2 nu) F_xx - z V_xx                           (normal; Johnson 3.2)
    2 pi s_xx = 2 (1 + nu) F_xz + 2 nu F1_xxx - z F_xxx                      (along x)

and so on below. A point force has F = P ln(rho + z); a Hertz contact has its integral (``subsurface``).

Force at depth c (Mindlin). With k = 1/R1 from the force, b = 1/R2 and L = ln(R2 + z + c) from its image at
-c, and beta = 3 - 4 nu, 16 pi G (1 - nu) u_i / P is

    along z:  beta k d_i3 - (z-c)(k_i + beta b_i) + 2 c z b_i3 - m L_i + d_i3 (beta^2 b - 2 beta c b_3)
    along x:  d_i1 (beta k + b) - x (k_i + beta b_i) - 2 c z b_i1 + 2 beta c d_i3 b_1 + m (2 d_i3 L_1 - M_1i)

with m = 4 (1-nu)(1-2nu) and M_z = L. 2 (1-2nu) divides its divergence, so the stress is finite at nu = 1/2.

Stress is positive in tension, force and displacement along the sensor's axes (z into the skin). A point on
the force or above the skin, or a material out of range, raises RangeError.

References: K. L. Johnson, Contact Mechanics (1985), sec. 3.2 and 3.6, doi:10.1017/CBO9781139171731;
R. D. Mindlin, Physics 7 (1936) 195, doi:10.1063/1.1745385.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.mechanics.half_space.hertz import in_skin, reduced_modulus

Points = Float[ndarray, "..."] | float
Vectors = Float[ndarray, "... 3"]
Tensors = Float[ndarray, "... 3 3"]
Along = Literal["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class Potentials:
    """Derivatives of the axisymmetric F, V = F_z and F1 (F1_z = F), from which every component follows.

    With ' the derivative by r divided by r, ``a`` is K', ``b`` is K'' and ``c`` is K''': K_x = x a,
    K_xx = a + x^2 b, K_xy = x y b, K_xxx = 3 x b + x^3 c.

    Attributes:
        v_z, v_zz, v_a, v_b, v_az: of V; ``v_az`` is (V_z)'.
        f_a, f_b, f_c: of F.
        f1_b, f1_c: of F1.
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
    """Derivatives of F = ln(rho + z), V = 1/rho and F1 = z ln(rho + z) - rho."""
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
    """K_xxx, K_xyy and K_xxy from ``b`` and ``c``."""
    return 3 * x * b + x**3 * c, x * b + x * y**2 * c, y * b + x**2 * y * c


def stress_of_normal_load(K: Potentials, x: Points, y: Points, z: Points, nu: float) -> Tensors:
    """Stress under a normal surface load with these potentials [Pa]."""
    m = 1 - 2 * nu
    xx = 2 * nu * K.v_z - m * (K.f_a + x**2 * K.f_b) - z * (K.v_a + x**2 * K.v_b)
    yy = 2 * nu * K.v_z - m * (K.f_a + y**2 * K.f_b) - z * (K.v_a + y**2 * K.v_b)
    xy = -m * x * y * K.f_b - z * x * y * K.v_b
    zz = K.v_z - z * K.v_zz
    return _symmetric(xx, yy, zz, xy, -z * y * K.v_az, -z * x * K.v_az) / (2 * np.pi)


def stress_of_load_along_x(K: Potentials, x: Points, y: Points, z: Points, nu: float) -> Tensors:
    """Stress under a tangential surface load along x with these potentials [Pa]."""
    f_xxx, f_xyy, f_xxy = _third_derivatives(K.f_b, K.f_c, x, y)
    f1_xxx, f1_xyy, f1_xxy = _third_derivatives(K.f1_b, K.f1_c, x, y)
    xx = 2 * (1 + nu) * x * K.v_a + 2 * nu * f1_xxx - z * f_xxx
    yy = 2 * nu * x * K.v_a + 2 * nu * f1_xyy - z * f_xyy
    xy = y * K.v_a + 2 * nu * f1_xxy - z * f_xxy
    xz = K.v_z - z * (K.v_a + x**2 * K.v_b)
    return _symmetric(xx, yy, -z * x * K.v_az, xy, -z * x * y * K.v_b, xz) / (2 * np.pi)


def boussinesq_stress(x_m: Points, y_m: Points, z_m: Points, force_n: float, poisson_ratio: float) -> Tensors:
    """Stress under a force along z on the surface at the origin [Pa].

    Args:
        x_m, y_m: in the sensor's frame [m].
        z_m: into the skin, not negative [m]; the three shapes broadcast.
        force_n: into the skin [N]; a pull is negative.
        poisson_ratio: 0 to 0.5.

    Returns:
        The symmetric tensor ``[... 3 3]``, positive in tension.
    """
    reduced_modulus(1.0, poisson_ratio)
    _below(x_m, y_m, z_m, 0.0)
    K = point_potentials(x_m, y_m, z_m)
    return _finite(force_n) * stress_of_normal_load(K, x_m, y_m, z_m, poisson_ratio)


def cerruti_stress(x_m: Points, y_m: Points, z_m: Points, force_n: float, poisson_ratio: float) -> Tensors:
    """Stress under a force along x on the surface at the origin [Pa]; see ``boussinesq_stress``."""
    reduced_modulus(1.0, poisson_ratio)
    _below(x_m, y_m, z_m, 0.0)
    K = point_potentials(x_m, y_m, z_m)
    return _finite(force_n) * stress_of_load_along_x(K, x_m, y_m, z_m, poisson_ratio)


def mindlin_displacement(
    x_m: Points,
    y_m: Points,
    z_m: Points,
    depth_m: float,
    force_n: float,
    along: Along,
    youngs_modulus_pa: float,
    poisson_ratio: float,
) -> Vectors:
    """Displacement by a force inside the half-space, below the origin, or on it at depth 0 [m].

    On the surface Boussinesq's force, along z, makes u_z = (1 - nu^2) F / (pi E r).

    Args:
        x_m, y_m: in the sensor's frame [m].
        z_m: into the skin, not negative [m]; the three shapes broadcast.
        depth_m: of the force, 0 or more [m].
        force_n: along the named axis [N].
        along: ``"x"``, ``"y"`` or ``"z"``.
        youngs_modulus_pa, poisson_ratio: of the skin [Pa], 0 to 0.5.
    """
    G = reduced_modulus(youngs_modulus_pa, poisson_ratio) * (1 - poisson_ratio) / 2
    u, _, _ = _mindlin(x_m, y_m, z_m, depth_m, along, poisson_ratio)
    return _finite(force_n) * u / (16 * np.pi * G * (1 - poisson_ratio))


def mindlin_stress(
    x_m: Points, y_m: Points, z_m: Points, depth_m: float, force_n: float, along: Along, poisson_ratio: float
) -> Tensors:
    """Stress by a force inside the half-space, below the origin [Pa]; see ``mindlin_displacement``."""
    reduced_modulus(1.0, poisson_ratio)
    _, gradient, volume = _mindlin(x_m, y_m, z_m, depth_m, along, poisson_ratio)
    twice_strain = gradient + np.swapaxes(gradient, -1, -2)
    s = twice_strain + 4 * poisson_ratio * np.asarray(volume)[..., None, None] * np.eye(3)
    return _finite(force_n) * s / (16 * np.pi * (1 - poisson_ratio))


def _mindlin(
    x: Points, y: Points, z: Points, c: float, along: str, nu: float
) -> tuple[Vectors, Tensors, Points]:
    """16 pi G (1 - nu) times u, its gradient u_i,j, and its divergence over 2 (1 - 2 nu); of a unit force."""
    if along not in ("x", "y", "z"):
        raise InputError(f"a force along {along!r} is not known; use 'x', 'y' or 'z'")
    if not (c >= 0.0 and np.isfinite(c)):
        raise RangeError(f"depth {c} m of the force is not 0 or more; the skin lies at z >= 0 m")
    _below(x, y, z, c)
    if along == "y":  # turn the picture: x' = y, y' = x is a reflection, which the half-space does not see
        u, grad, div = _mindlin(y, x, z, c, "x", nu)
        swap = [1, 0, 2]
        return u[..., swap], grad[..., swap, :][..., swap], div
    x, y, z = np.broadcast_arrays(*(np.asarray(v, float) for v in (x, y, z)))
    beta, m = 3 - 4 * nu, 4 * (1 - nu) * (1 - 2 * nu)
    k, k1, k2, _ = _inverse_distance(np.stack([x, y, z - c], -1))
    b, b1, b2, b3 = _inverse_distance(np.stack([x, y, z + c], -1))
    K = point_potentials(x, y, z + c)
    z_, zc, cz = z[..., None, None], (z - c)[..., None, None], 2 * c * z
    L1 = np.stack([x * K.f_a, y * K.f_a, b], -1)
    L2 = _symmetric(
        K.f_a + x**2 * K.f_b, K.f_a + y**2 * K.f_b, b1[..., 2], x * y * K.f_b, b1[..., 1], b1[..., 0]
    )
    sum1 = k1 + beta * b1
    if along == "z":
        u = -zc[..., 0] * sum1 + cz[..., None] * b2[..., 2] - m * L1
        u[..., 2] += beta * k + beta**2 * b - 2 * beta * c * b1[..., 2]
        grad = -zc * (k2 + beta * b2) + 2 * c * z_ * b3[..., 2, :, :] - m * L2
        grad[..., :, 2] += -sum1 + 2 * c * b2[..., 2]
        grad[..., 2, :] += beta * k1 + beta**2 * b1 - 2 * beta * c * b2[..., 2, :]
        return u, grad, k1[..., 2] + beta * b1[..., 2] - 2 * c * b2[..., 2, 2]
    M_xx, M_xy = -1 / (b**-1 + z + c) + x**2 * K.f1_b, x * y * K.f1_b
    M1 = np.stack([M_xx, M_xy, L1[..., 0]], -1)
    M_xxx, M_xyy, M_xxy = _third_derivatives(K.f1_b, K.f1_c, x, y)
    M2 = _symmetric(M_xxx, M_xyy, L2[..., 0, 2], M_xxy, L2[..., 0, 1], L2[..., 0, 0])
    u = -x[..., None] * sum1 - cz[..., None] * b2[..., 0] - m * M1
    u[..., 0] += beta * k + b
    u[..., 2] += 2 * beta * c * b1[..., 0] + 2 * m * L1[..., 0]
    grad = -x[..., None, None] * (k2 + beta * b2) - 2 * c * z_ * b3[..., 0, :, :] - m * M2
    grad[..., :, 0] -= sum1
    grad[..., :, 2] -= 2 * c * b2[..., 0]
    grad[..., 0, :] += beta * k1 + b1
    grad[..., 2, :] += 2 * beta * c * b2[..., 0, :] + 2 * m * L2[..., 0, :]
    return u, grad, k1[..., 0] + beta * b1[..., 0] + 2 * c * b2[..., 0, 2]


def _inverse_distance(
    p: Vectors,
) -> tuple[Float[ndarray, ...], Vectors, Tensors, Float[ndarray, "... 3 3 3"]]:
    """1/R and its first three gradients."""
    R = np.asarray(np.linalg.norm(p, axis=-1))
    e, n = np.eye(3), p / R[..., None]
    nn = n[..., :, None] * n[..., None, :]
    mixed = (
        n[..., :, None, None] * e
        + n[..., None, :, None] * e[:, None, :]
        + n[..., None, None, :] * e[:, :, None]
    )
    return (
        np.asarray(1 / R),
        -n / (R**2)[..., None],
        (3 * nn - e) / (R**3)[..., None, None],
        (3 * mixed - 15 * nn[..., None] * n[..., None, None, :]) / (R**4)[..., None, None, None],
    )


def _symmetric(xx: Points, yy: Points, zz: Points, xy: Points, yz: Points, xz: Points) -> Tensors:
    xx, yy, zz, xy, yz, xz = np.broadcast_arrays(xx, yy, zz, xy, yz, xz)
    return np.stack([np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)


def _below(x: Points, y: Points, z: Points, c: float) -> None:
    in_skin(x, y, z)
    if np.any((np.asarray(x) == 0) & (np.asarray(y) == 0) & (np.asarray(z) == c)):
        raise RangeError(
            f"a point lies on the force, at depth {c} m, where the field is infinite; move it away",
            code="singular-point",
        )


def _finite(force_n: float) -> float:
    if not np.isfinite(force_n):
        raise RangeError(f"force {force_n} N is not a finite number of newtons")
    return force_n
