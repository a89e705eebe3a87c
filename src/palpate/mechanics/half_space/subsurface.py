"""Stress below a Hertz contact, sliding or at rest, at points and integrated along rays; any Poisson's ratio.

Hertz pressure is a segment of point forces at complex depths z + i t with density c (a^2 - t^2), c = pi p0 /
(2 a). Where a point force has a derivative g of its potential, the contact has

    c int_{-a}^{a} (a^2 - t^2) g(z + i t) dt = 4 c Im W - 4 c a Re W_z,      W_zzz = g, at w = z + i a,

with antiderivatives elementary in q = w + S, S = sqrt(r^2 + w^2). Below, K1 to K4 are the first to fourth,
each the z-derivative of the next, and a prime is the derivative by r divided by r. Sliding is a traction q_x
= mu p over the contact (Hamilton's problem), whose effect on the pressure for nu < 1/2 is neglected.

Integrated over y the field is one of plane strain: with P0 = (pi/2) p0 a and zeta = x + i z,

    int (s_xx - s_zz) dy = -(2/pi) z Re K,     int 2 s_xz dy = (2/pi) z Im K,
    K = P0 [ -(2 zeta/a^2) ln((zeta - a)/(zeta + a)) - 4/a ].

References: K. L. Johnson, Contact Mechanics (1985), sec. 2.2 (Flamant), 3.2 and 3.4,
doi:10.1017/CBO9781139171731; G. M. Hamilton, Proc. IMechE 197C (1983) 53,
doi:10.1243/PIME_PROC_1983_197_076_02.

Point force on an elastic half-space: Boussinesq and Cerruti; small strain, any nu.

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
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from palpate.core import Complex, Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import SURFACE, in_skin, positive, reduced_modulus

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


def hertz_stress(
    x_m: Points,
    y_m: Points,
    z_m: Points,
    contact_radius_m: float,
    peak_pressure_pa: float,
    poisson_ratio: float,
    friction: float = 0.0,
) -> Tensors:
    """Return the stress below a Hertz contact at the origin, sliding along x or at rest [Pa].

    Args:
        x_m, y_m, z_m: Points, z >= 0 [m]; shapes broadcast.
        contact_radius_m: a [m].
        peak_pressure_pa: p0 [Pa].
        poisson_ratio: 0 to 0.5.
        friction: Traction along +x over pressure, -2 to 2.

    Returns:
        Tensor ``[... 3 3]``, positive in tension, with rounding about 1e-14 (rho/a)^2 at distance rho, and
        1e-6 at the edge.

    Example:
        >>> s = hertz_stress(0.0, 0.0, 0.48, 1.0, 1.0, 0.3)
        >>> round(float(s[0, 0] - s[2, 2]) / 2, 3)
        0.31
    """
    reduced_modulus(1.0, poisson_ratio)
    positive("contact radius", contact_radius_m, "m")
    positive("peak pressure", peak_pressure_pa, "Pa")
    if not -2.0 <= friction <= 2.0:
        raise RangeError(
            f"friction {friction} lies outside -2 to 2, where a coefficient of friction may lie",
            code="friction-range",
        )
    x, y, z = (np.asarray(v, dtype=float) / contact_radius_m for v in (x_m, y_m, z_m))
    if not (np.isfinite(x).all() and np.isfinite(y).all() and np.isfinite(z).all() and (z >= 0).all()):
        raise RangeError(
            "the skin lies at finite places with z >= 0 m; a negative z is in the air above it",
            code="above-surface",
        )
    z = np.maximum(z, SURFACE)
    K = hertz_potentials(np.hypot(x, y), z)
    s = stress_of_normal_load(K, x, y, z, poisson_ratio)
    if friction:
        s = s + friction * stress_of_load_along_x(K, x, y, z, poisson_ratio)
    return peak_pressure_pa * s


def hertz_potentials(r: Points, z: Points) -> Potentials:
    """Return derivatives of a Hertz contact's potentials with a = 1 and p0 = 1, at z > 0."""
    r2, w = np.square(r), z + 1j
    S = np.sqrt(r2 + w**2)
    q = w + S
    L = np.log(q)

    k0_a, k1_a = 1 / (S * q), -1 / q
    k2_a = -L / 2 + r2 / (4 * q**2)
    k3_a = -w * L / 2 + q / 4 + r2 / (8 * q) - r2**2 / (24 * q**3)
    k1_b, k2_b, k3_b = 1 / (S * q**2), -1 / (2 * q**2), 1 / (4 * q) + r2 / (12 * q**3)
    k4_b = L / 8 - r2 / (12 * q**2) - r2**2 / (96 * q**4)
    k2_c, k3_c, k4_c = 1 / (S * q**3), -1 / (3 * q**3), 1 / (12 * q**2) + r2 / (24 * q**4)
    return Potentials(
        v_z=_contact(w * L - S, L),
        v_zz=_contact(L, 1 / S),
        v_a=_contact(k2_a, k1_a),
        v_b=_contact(k2_b, k1_b),
        v_az=_contact(k1_a, k0_a),
        f_a=_contact(k3_a, k2_a),
        f_b=_contact(k3_b, k2_b),
        f_c=_contact(k3_c, k2_c),
        f1_b=_contact(k4_b, k3_b),
        f1_c=_contact(k4_c, k3_c),
    )


def centreline_stress(
    z_m: Points, contact_radius_m: float, peak_pressure_pa: float, poisson_ratio: float
) -> tuple[Points, Points]:
    """Return s_rr and s_zz on the axis of a Hertz contact [Pa]: Johnson (3.45)."""
    reduced_modulus(1.0, poisson_ratio)
    positive("contact radius", contact_radius_m, "m")
    positive("peak pressure", peak_pressure_pa, "Pa")
    in_skin(z_m)
    z = np.asarray(z_m) / contact_radius_m
    s_zz = -1 / (1 + z**2)
    s_rr = -(1 + poisson_ratio) * (1 - z * np.arctan2(1.0, z)) - s_zz / 2
    return peak_pressure_pa * s_rr, peak_pressure_pa * s_zz


def greatest_shear(poisson_ratio: float) -> tuple[float, float]:
    """Return the maximum shear stress under a Hertz contact over p0, and its depth over a.

    Example:
        >>> [round(v, 3) for v in greatest_shear(0.5)]
        [0.266, 0.548]
    """

    def shear(z: float) -> float:
        s_rr, s_zz = centreline_stress(z, 1.0, 1.0, poisson_ratio)
        return float(s_rr - s_zz) / 2

    best = minimize_scalar(lambda z: -shear(z), bounds=(0.3, 0.7), method="bounded", options={"xatol": 1e-9})
    return shear(best.x), float(best.x)


def _contact(W: Any, W_z: Any) -> Any:
    return 2 * np.pi * (W.imag - W_z.real)  # 4 c = 2 pi p0 / a


FAR = 8.0  # distance beyond which the series is used, in contact radii
TERMS = 9  # terms of the series in (a/zeta)^2, accurate to 1e-17 at FAR

Summed = Float[ndarray, "..."]


def line_integrated_stress(
    x_m: Points, z_m: Points, contact_radius_m: float, peak_pressure_pa: float
) -> tuple[Summed, Summed]:
    """Return int (s_xx - s_zz) dy and int 2 s_xz dy [Pa m] under a Hertz contact; any Poisson's ratio.

    Args:
        x_m, z_m: Position and depth of the ray [m].
        contact_radius_m: a [m].
        peak_pressure_pa: p0 [Pa].
    """
    positive("contact radius", contact_radius_m, "m")
    in_skin(z_m)
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
