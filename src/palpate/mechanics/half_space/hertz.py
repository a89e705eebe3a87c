"""Hertz contact of a rigid sphere on an elastic half-space, and the stress below it for nu = 1/2.

Small strain, no friction, no adhesion, a/R up to 0.5, where the paraboloid's force is 2.5 % above the
sphere's. For nu = 1/2 the stress that birefringence measures follows from one Newtonian potential V (Johnson
3.11),

    s_xx - s_zz = -(z / 2 pi) (V_xx - V_zz),      2 s_xz = -(z / pi) V_xz,
    V = c  int_{-a}^{a} (a^2 - t^2) / sqrt(r^2 + (z + i t)^2) dt,      c = pi p0 / (2 a),

with elementary derivatives in w = z + i a, S = sqrt(r^2 + w^2), q = w + S. Integrated over y, at any nu, the
field is one of plane strain: with P0 = (pi/2) p0 a and zeta = x + i z,

    int (s_xx - s_zz) dy = -(2/pi) z Re K,     int 2 s_xz dy = (2/pi) z Im K,
    K = P0 [ -(2 zeta/a^2) ln((zeta - a)/(zeta + a)) - 4/a ].

Reference: K. L. Johnson, Contact Mechanics (1985), ch. 3 and 4, doi:10.1017/CBO9781139171731.

Hertz contact of two elastic spheres, and pairs of objects that one cue cannot distinguish.

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
from scipy.optimize import minimize_scalar

from palpate.core import Complex, Contact, Float, InputError, Pose, Probe, RangeError, ndarray

MAX_SLOPE = 0.5  # maximum a/R of the paraboloid
GRID_POINTS = 81
MODEL = "Hertz: rigid sphere, elastic half-space, small strain, no friction, no adhesion, a/R <= 0.5"

Points = Float[ndarray, "..."]


def reduced_modulus(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return E* = E / (1 - nu^2) [Pa]."""
    positive("Young's modulus", youngs_modulus_pa, "Pa")
    if not 0.0 <= poisson_ratio <= 0.5:
        raise RangeError(
            f"Poisson's ratio {poisson_ratio} lies outside 0 to 0.5; an elastomer has 0.45 to 0.5",
            code="poisson-ratio",
        )
    return youngs_modulus_pa / (1.0 - poisson_ratio**2)


def greatest_depth(radius_m: float) -> float:
    """Return the depth at which a/R = 0.5 [m].

    Example:
        >>> greatest_depth(5e-3)
        0.00125
    """
    positive("the sphere's radius", radius_m, "m")
    return MAX_SLOPE**2 * radius_m


def contact_radius(depth_m: float, radius_m: float) -> float:
    """Return the contact radius a = sqrt(R d) at a depth of 0 to R/4 [m].

    Example:
        >>> round(contact_radius(1e-3, 5e-3) * 1e3, 7)
        2.236068
    """
    limit = greatest_depth(radius_m)
    if not 0.0 <= depth_m <= limit * (1 + 1e-12):  # rounding above the limit is accepted
        raise RangeError(
            f"depth {depth_m:g} m of a sphere of radius {radius_m:g} m lies outside 0 to {limit:g} m, where "
            f"Hertz's law holds (a/R <= {MAX_SLOPE}); press less deeply or use a larger sphere",
            code="outside-law",
        )
    return math.sqrt(radius_m * depth_m)


def force_from_depth(
    depth_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the normal force F = 4/3 E* sqrt(R) d^(3/2) [N].

    Example:
        >>> round(force_from_depth(1e-3, 5e-3, 0.3e6, 0.49), 7)
        1.1770328
    """
    a = contact_radius(depth_m, radius_m)
    return 4.0 / 3.0 * reduced_modulus(youngs_modulus_pa, poisson_ratio) * a * depth_m


def depth_from_force(
    force_n: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float
) -> float:
    """Return the depth d = (3F / (4 E* sqrt(R)))^(2/3) [m]."""
    if not (force_n >= 0.0 and math.isfinite(force_n)):
        raise RangeError(f"force {force_n} N is not 0 or more; Hertz's contact only pushes")
    positive("the sphere's radius", radius_m, "m")
    E = reduced_modulus(youngs_modulus_pa, poisson_ratio)
    depth_m = math.pow(3.0 * force_n / (4.0 * E * math.sqrt(radius_m)), 2.0 / 3.0)
    contact_radius(depth_m, radius_m)  # checks the range
    return depth_m


def depth_from_radius(contact_radius_m: float, radius_m: float) -> float:
    """Return the depth d = a^2 / R [m]."""
    positive("the sphere's radius", radius_m, "m")
    if not 0.0 <= contact_radius_m <= MAX_SLOPE * radius_m * (1 + 1e-12):
        raise RangeError(
            f"contact radius {contact_radius_m:g} m is outside 0 to {MAX_SLOPE * radius_m:g} m, where "
            f"Hertz's law holds (a/R <= {MAX_SLOPE}); use a larger sphere"
        )
    return contact_radius_m**2 / radius_m


def peak_pressure(depth_m: float, radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return the pressure at the centre p0 = (2 E* / pi) sqrt(d / R) [Pa]."""
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
        probe: Sphere.
        pose: Position and depth.
        youngs_modulus_pa, poisson_ratio: Half-space [Pa], 0 to 0.5.
        x_m, y_m: Columns and rows of the grid [m]; by default 81 points over one radius to each side.

    Returns:
        Contact with exact pressure and surface displacement.
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
    """Return columns, rows, and distances from the pose [m], by default around the pose."""
    if not (math.isfinite(pose.x_m) and math.isfinite(pose.y_m)):
        raise InputError(
            f"the pose ({pose.x_m}, {pose.y_m}) m is not a finite position; give numbers in metres"
        )
    x = pose.x_m + around_m if x_m is None else x_m
    y = pose.y_m + around_m if y_m is None else y_m
    return x, y, np.hypot(x[None, :] - pose.x_m, y[:, None] - pose.y_m)


def pressure(r: Points, a: float, p0: float) -> Points:
    """Return the pressure p0 sqrt(1 - r^2/a^2) at distance r [Pa]; zero outside."""
    if a == 0.0:
        return np.zeros_like(r)
    return np.asarray(p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0)))


def surface_displacement(r: Points, a: float, radius_m: float) -> Points:
    """Return the surface displacement at distance r [m]: Johnson (3.42)."""
    if a == 0.0:
        return np.zeros_like(r)
    outside = np.maximum(r, a)
    around = (2 * a**2 - r**2) * np.arcsin(a / outside) + a * np.sqrt((outside - a) * (outside + a))
    inside = np.pi / 2 * (2 * a**2 - r**2)
    return np.where(r < a, inside, around) / (np.pi * radius_m)


def positive(name: str, value: float, unit: str) -> None:
    """Reject values that are not positive and finite."""
    if not (value > 0.0 and math.isfinite(value)):
        raise RangeError(f"{name} is {value} {unit}; give a positive number of {unit}", code="not-positive")


def in_skin(*places_m: RayPoints) -> None:
    """Reject points that are not finite or, by the last coordinate, above the surface."""
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
    """Return s_xx - s_zz and 2 s_xz [Pa] on a ray along y below a Hertz contact at the origin, for nu = 1/2.

    Args:
        x_m, y_m, z_m: Points across the ray, along it, and into the half-space [m]; shapes broadcast.
        contact_radius_m: a [m].
        peak_pressure_pa: p0 [Pa].

    Returns:
        Stresses, positive in tension, with relative rounding about 1e-16 (rho/a)^2 at distance rho.
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


def centreline_stress(
    z_m: RayPoints, contact_radius_m: float, peak_pressure_pa: float, poisson_ratio: float
) -> tuple[RayPoints, RayPoints]:
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


FAR = 8.0  # distance beyond which the series is used, in contact radii
TERMS = 9  # terms of the series in (a/zeta)^2, accurate to 1e-17 at FAR


def line_integrated_stress(
    x_m: RayPoints, z_m: RayPoints, contact_radius_m: float, peak_pressure_pa: float
) -> tuple[Points, Points]:
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


def tangential_stiffness(contact_radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return dQ/d(delta) = 8 a G / (2 - nu) without slip [N/m]."""
    positive("contact radius", contact_radius_m, "m")
    G = reduced_modulus(youngs_modulus_pa, poisson_ratio) * (1.0 - poisson_ratio) / 2.0
    return 8.0 * contact_radius_m * G / (2.0 - poisson_ratio)
