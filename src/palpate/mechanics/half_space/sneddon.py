"""Rigid sphere, flat punch, or cone on an elastic half-space: Sneddon's laws, without friction or adhesion.

With the punch's height f(r) over its tip, on 0 <= t <= a,

    g(t) = d - t int_0^t f'(r) / sqrt(t^2 - r^2) dr,      F = 2 E* int_0^a g dt,      g(a) = 0 without an
    edge: sphere  g = d - t atanh(t/R),     flat punch  g = d,     cone  g = d - (pi/2) t cot(alpha).

The sphere is exact, not a paraboloid; strain is small for slopes (a/R, cot(alpha)) below about 0.3.

Reference: I. N. Sneddon, Int. J. Eng. Sci. 3 (1965) 47, doi:10.1016/0020-7225(65)90019-4.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive, reduced_modulus

MAX_RADIUS = 0.99  # a/R of the sphere; at 1 the depth is infinite
MAX_PUNCH_DEPTH = 0.5  # d/a of the flat punch; its strain is of this order
SERIES_BELOW = 0.1  # a/R below which (1 + s^2) atanh(s) - s would lose digits
TERMS = np.arange(1, 9)  # of that series; the first left out is below 1e-16 of the sum
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)  # on -1 to 1
MODEL = "Sneddon: rigid {shape}, elastic half-space, small strain, no friction, no adhesion"

Points = Float[ndarray, "..."]


def sphere_depth_from_radius(contact_radius_m: float, radius_m: float) -> float:
    """Return the depth d = a atanh(a/R) [m]."""
    return contact_radius_m * math.atanh(_slope(contact_radius_m, radius_m))


def sphere_force_from_radius(
    contact_radius_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the force F = E* [(a^2 + R^2) atanh(a/R) - a R] [N]."""
    s = _slope(contact_radius_m, radius_m)
    if s < SERIES_BELOW:
        shape = float(np.sum(4 * TERMS / (4 * TERMS**2 - 1) * s ** (2 * TERMS + 1)))
    else:
        shape = (1 + s**2) * math.atanh(s) - s
    return reduced_modulus(youngs_modulus_pa, poisson_ratio) * radius_m**2 * shape


def sphere_radius_from_depth(depth_m: float, radius_m: float) -> float:
    """Return the contact radius a [m], from a atanh(a/R) = d.

    Example:
        >>> round(sphere_radius_from_depth(1e-3, 5e-3) * 1e3, 4)
        2.1613
    """
    positive("the sphere's radius", radius_m, "m")
    limit = sphere_depth_from_radius(MAX_RADIUS * radius_m, radius_m)
    _within("depth", depth_m, limit, "m", f"a/R <= {MAX_RADIUS}")
    return radius_m * _root(lambda s: s * math.atanh(s) - depth_m / radius_m, math.sqrt(depth_m / radius_m))


def sphere_radius_from_force(
    force_n: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the contact radius of a sphere under a force [m]."""
    positive("the sphere's radius", radius_m, "m")
    E = reduced_modulus(youngs_modulus_pa, poisson_ratio)
    limit = sphere_force_from_radius(MAX_RADIUS * radius_m, radius_m, youngs_modulus_pa, poisson_ratio)
    _within("force", force_n, limit, "N", f"a/R <= {MAX_RADIUS}")

    def excess(s: float) -> float:
        force = sphere_force_from_radius(s * radius_m, radius_m, youngs_modulus_pa, poisson_ratio)
        return (force - force_n) / (E * radius_m**2)

    return radius_m * _root(excess, math.cbrt(0.75 * force_n / (E * radius_m**2)))


def sphere_force_from_depth(
    depth_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the force of a sphere at a depth [N].

    Example:
        >>> round(sphere_force_from_depth(1e-3, 5e-3, 0.3e6, 0.49), 4)
        1.1534
    """
    a = sphere_radius_from_depth(depth_m, radius_m)
    return sphere_force_from_radius(a, radius_m, youngs_modulus_pa, poisson_ratio)


def sphere_depth_from_force(
    force_n: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the depth of a sphere under a force [m]."""
    a = sphere_radius_from_force(force_n, radius_m, youngs_modulus_pa, poisson_ratio)
    return sphere_depth_from_radius(a, radius_m)


def sphere_pressure(
    r_m: Points, contact_radius_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> Points:
    """Return the pressure p = -(E*/pi) int_r^a g'(t) / sqrt(t^2 - r^2) dt at distance r
    [Pa]; zero outside.
    """
    E, R = reduced_modulus(youngs_modulus_pa, poisson_ratio), radius_m
    if _slope(contact_radius_m, R) == 0.0:
        return np.zeros_like(r_m)
    r2 = np.minimum(r_m, contact_radius_m) ** 2
    v = np.sqrt(contact_radius_m**2 - r2)  # of t; with v = sqrt(t^2 - r^2), dt / v is dv / t
    rest = np.sqrt(R**2 - r2)
    edge = R / rest * np.arctanh(v / rest)
    rise = np.zeros_like(r2)
    for node, weight in zip((1 + NODES) / 2, WEIGHTS / 2, strict=True):
        t = np.sqrt(r2 + (node * v) ** 2)
        rise += weight * v * np.arctanh(t / R) / t
    return np.asarray(E / np.pi * (edge + rise))


def punch_force(
    depth_m: float, punch_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the force F = 2 a E* d [N] of a flat-ended cylinder at a depth of at most a/2.

    Example:
        >>> round(punch_force(1e-3, 3e-3, 0.3e6, 0.49), 4)
        2.3687
    """
    positive("the punch's radius", punch_radius_m, "m")
    _within("depth", depth_m, MAX_PUNCH_DEPTH * punch_radius_m, "m", "a flat punch d/a <= 0.5")
    return 2.0 * punch_radius_m * reduced_modulus(youngs_modulus_pa, poisson_ratio) * depth_m


def punch_depth(
    force_n: float, punch_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the depth d = F / (2 a E*) of a flat-ended cylinder [m]."""
    positive("the punch's radius", punch_radius_m, "m")
    stiffness = 2.0 * punch_radius_m * reduced_modulus(youngs_modulus_pa, poisson_ratio)
    limit = stiffness * MAX_PUNCH_DEPTH * punch_radius_m
    _within("force", force_n, limit, "N", "a flat punch d/a <= 0.5")
    return force_n / stiffness


def cone_radius(depth_m: float, half_angle_rad: float) -> float:
    """Return the contact radius a = (2/pi) d tan(alpha) [m], alpha from the cone's axis to its side."""
    _within("depth", depth_m, math.inf, "m", "a contact")
    return 2.0 / math.pi * depth_m * _tangent(half_angle_rad)


def cone_force(
    depth_m: float, half_angle_rad: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the force F = (2/pi) E* d^2 tan(alpha) [N]."""
    a = cone_radius(depth_m, half_angle_rad)
    return reduced_modulus(youngs_modulus_pa, poisson_ratio) * a * depth_m


def cone_depth(
    force_n: float, half_angle_rad: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the depth of a cone under a force [m]."""
    _within("force", force_n, math.inf, "N", "a contact without adhesion")
    stiffness = 2 / math.pi * reduced_modulus(youngs_modulus_pa, poisson_ratio) * _tangent(half_angle_rad)
    return math.sqrt(force_n / stiffness)


def _slope(contact_radius_m: float, radius_m: float) -> float:
    positive("the sphere's radius", radius_m, "m")
    _within("contact radius", contact_radius_m, MAX_RADIUS * radius_m, "m", f"a/R <= {MAX_RADIUS}")
    return contact_radius_m / radius_m


def _tangent(half_angle_rad: float) -> float:
    if not 0.0 < half_angle_rad < math.pi / 2:
        raise RangeError(
            f"half-angle {half_angle_rad} rad lies outside 0 to pi/2 rad; measure it from the cone's axis"
        )
    return math.tan(half_angle_rad)


def _within(name: str, value: float, limit: float, unit: str, law: str) -> None:
    if not (0.0 <= value <= limit * (1 + 1e-12) and math.isfinite(value)):
        raise RangeError(
            f"{name} {value:g} {unit} lies outside 0 to {limit:g} {unit}, where {law} holds",
            code="outside-law",
        )


def _root(excess: Callable[[float], float], upper: float) -> float:
    """Slope a/R of zero excess, bracketed by the paraboloid's."""
    if upper == 0.0:
        return 0.0
    top = min(upper * (1 + 1e-9), MAX_RADIUS * (1 + 1e-12))
    return brentq(excess, 0.0, top, xtol=1e-300, rtol=1e-15) if excess(top) > 0 else top
