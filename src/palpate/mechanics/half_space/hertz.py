"""Hertz's contact of a rigid sphere on an elastic half-space, and at nu = 1/2 the stress below it.

Small strain, no friction, no adhesion; valid to a/R = 0.5, which every conversion enforces by a RangeError.
The sphere is taken as a paraboloid: at the limit the exact sphere's force at the same depth is 2.5 % lower.

At nu = 1/2 the stress that birefringence sees is z times the Hessian of one Newtonian potential V, that of a
disc whose surface density is the pressure (Johnson 3.11 with 1 - 2 nu = 0):

    s_xx - s_zz = -(z / 2 pi) (V_xx - V_zz),      2 s_xz = -(z / pi) V_xz.

For Hertz's pressure V is a segment of point charges at complex depths z + i t with a parabolic density,

    V = c  int_{-a}^{a} (a^2 - t^2) / sqrt(r^2 + (z + i t)^2) dt,      c = pi p0 / (2 a),

whose derivatives are elementary in w = z + i a, S = sqrt(r^2 + w^2), q = w + S.

Reference: K. L. Johnson, Contact Mechanics (1985), ch. 3 and 4, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math

import numpy as np

from palpate.core import Contact, Float, InputError, Pose, Probe, RangeError, ndarray

MAX_SLOPE = 0.5  # a/R; beyond it the paraboloid is no longer the sphere
GRID_POINTS = 81
MODEL = "Hertz: rigid sphere, elastic half-space, small strain, no friction, no adhesion, a/R <= 0.5"

Points = Float[ndarray, "..."]


def reduced_modulus(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """E* = E / (1 - nu^2) of a half-space under a rigid body [Pa]."""
    positive("Young's modulus", youngs_modulus_pa, "Pa")
    if not 0.0 <= poisson_ratio <= 0.5:
        raise RangeError(
            f"Poisson's ratio {poisson_ratio} lies outside 0 to 0.5; an elastomer has 0.45 to 0.5",
            code="poisson-ratio",
        )
    return youngs_modulus_pa / (1.0 - poisson_ratio**2)


def greatest_depth(radius_m: float) -> float:
    """Depth [m] at which the contact radius reaches half the sphere's radius.

    Example:
        >>> greatest_depth(5e-3)
        0.00125
    """
    positive("the sphere's radius", radius_m, "m")
    return MAX_SLOPE**2 * radius_m


def contact_radius(depth_m: float, radius_m: float) -> float:
    """Contact radius a = sqrt(R d) [m].

    Args:
        depth_m: approach past first touch, 0 to R/4 [m].
        radius_m: radius of the sphere [m].

    Example:
        >>> round(contact_radius(1e-3, 5e-3) * 1e3, 7)
        2.236068
    """
    limit = greatest_depth(radius_m)
    if not 0.0 <= depth_m <= limit * (1 + 1e-12):  # a rounding above the limit is the limit
        raise RangeError(
            f"depth {depth_m:g} m of a sphere of radius {radius_m:g} m lies outside 0 to {limit:g} m, where "
            f"Hertz's law holds (a/R <= {MAX_SLOPE}); press less deeply or use a larger sphere",
            code="outside-law",
        )
    return math.sqrt(radius_m * depth_m)


def force_from_depth(
    depth_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Normal force F = 4/3 E* sqrt(R) d^(3/2) [N], positive in compression.

    Example:
        >>> round(force_from_depth(1e-3, 5e-3, 0.3e6, 0.49), 7)
        1.1770328
    """
    a = contact_radius(depth_m, radius_m)
    return 4.0 / 3.0 * reduced_modulus(youngs_modulus_pa, poisson_ratio) * a * depth_m


def depth_from_force(
    force_n: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Depth d = (3F / (4 E* sqrt(R)))^(2/3) [m]."""
    if not (force_n >= 0.0 and math.isfinite(force_n)):
        raise RangeError(f"force {force_n} N is not 0 or more; Hertz's contact only pushes")
    positive("the sphere's radius", radius_m, "m")
    E = reduced_modulus(youngs_modulus_pa, poisson_ratio)
    depth_m = math.pow(3.0 * force_n / (4.0 * E * math.sqrt(radius_m)), 2.0 / 3.0)
    contact_radius(depth_m, radius_m)  # refuses what lies beyond the law
    return depth_m


def depth_from_radius(contact_radius_m: float, radius_m: float) -> float:
    """Depth d = a^2 / R [m] of a contact of radius a."""
    positive("the sphere's radius", radius_m, "m")
    if not 0.0 <= contact_radius_m <= MAX_SLOPE * radius_m * (1 + 1e-12):
        raise RangeError(
            f"contact radius {contact_radius_m:g} m is outside 0 to {MAX_SLOPE * radius_m:g} m, where "
            f"Hertz's law holds (a/R <= {MAX_SLOPE}); use a larger sphere"
        )
    return contact_radius_m**2 / radius_m


def peak_pressure(depth_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Pressure at the centre p0 = (2 E* / pi) sqrt(d / R) [Pa]."""
    a = contact_radius(depth_m, radius_m)
    return 2.0 * reduced_modulus(youngs_modulus_pa, poisson_ratio) / math.pi * a / radius_m


def press(
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    poisson_ratio: float,
    x_m: Float[ndarray, " nx"] | None = None,
    y_m: Float[ndarray, " ny"] | None = None,
) -> Contact:
    """Press a rigid sphere into a half-space.

    Args:
        probe: a sphere and its radius [m].
        pose: where, and how deep; depth 0 is first touch and gives no contact.
        youngs_modulus_pa, poisson_ratio: of the skin [Pa], 0 to 0.5.
        x_m, y_m: columns and rows of the surface grid in the sensor's frame [m]; by default 81 points each,
            over one sphere's radius to each side of the pose.

    Returns:
        The contact: exact pressure and surface displacement, inside the contact and around it.
    """
    if probe.shape != "sphere":
        raise InputError(f"Hertz's law is for a sphere, got probe shape {probe.shape!r}; use shape 'sphere'")
    R, d = probe.radius_m, pose.depth_m
    a = contact_radius(d, R)
    p0 = peak_pressure(d, R, youngs_modulus_pa, poisson_ratio)
    x, y, r = grid_around(pose, np.linspace(-R, R, GRID_POINTS), x_m, y_m)
    force = force_from_depth(d, R, youngs_modulus_pa, poisson_ratio)
    p, u = pressure(r, a, p0), surface_displacement(r, a, R)
    return Contact(x, y, p, u, r < a, force, a, probe, pose, MODEL)


def grid_around(
    pose: Pose,
    around_m: Float[ndarray, " n"],
    x_m: Float[ndarray, " nx"] | None,
    y_m: Float[ndarray, " ny"] | None,
) -> tuple[Float[ndarray, " nx"], Float[ndarray, " ny"], Float[ndarray, "ny nx"]]:
    """Columns, rows and distances from the pose [m]; around the pose where no columns or rows are given."""
    if not (math.isfinite(pose.x_m) and math.isfinite(pose.y_m)):
        raise InputError(
            f"the pose ({pose.x_m}, {pose.y_m}) m is not a finite position; give numbers in metres"
        )
    x = pose.x_m + around_m if x_m is None else x_m
    y = pose.y_m + around_m if y_m is None else y_m
    return x, y, np.hypot(x[None, :] - pose.x_m, y[:, None] - pose.y_m)


def pressure(r: Points, a: float, p0: float) -> Points:
    """Pressure p0 sqrt(1 - r^2/a^2) [Pa] at distance r [m] from the centre; zero outside and when a is 0."""
    if a == 0.0:
        return np.zeros_like(r)
    return np.asarray(p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0)))


def surface_displacement(r: Points, a: float, radius_m: float) -> Points:
    """Surface displacement into the skin [m] at distance r [m]: Johnson (3.42) inside, its sequel outside."""
    if a == 0.0:
        return np.zeros_like(r)
    outside = np.maximum(r, a)
    around = (2 * a**2 - r**2) * np.arcsin(a / outside) + a * np.sqrt((outside - a) * (outside + a))
    inside = np.pi / 2 * (2 * a**2 - r**2)
    return np.where(r < a, inside, around) / (np.pi * radius_m)


def positive(name: str, value: float, unit: str) -> None:
    """Refuse what is not a positive, finite number."""
    if not (value > 0.0 and math.isfinite(value)):
        raise RangeError(f"{name} is {value} {unit}; give a positive number of {unit}", code="not-positive")


def in_skin(*places_m: RayPoints) -> None:
    """Refuse places that are not finite, and a depth, the last of them, above the surface."""
    if not (all(np.isfinite(place).all() for place in places_m) and np.all(np.asarray(places_m[-1]) >= 0)):
        raise RangeError(
            "the skin lies at finite places with z >= 0 m; a negative z is in the air above it",
            code="above-surface",
        )


SURFACE = 1e-12  # contact radii that stand for z -> 0, where the edge circle's 1/S would be infinite

RayPoints = Float[ndarray, "..."] | float


def secondary_stress(
    x_m: RayPoints, y_m: RayPoints, z_m: RayPoints, contact_radius_m: float, peak_pressure_pa: float
) -> tuple[Points, Points]:
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
    """
    positive("contact radius", contact_radius_m, "m")
    in_skin(z_m)
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
