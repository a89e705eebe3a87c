"""Contact on a half-space: the closed laws against quadrature and superposed point forces."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from mpmath import mp
from numpy import ndarray
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipk

from oracles import Oracle, relative
from palpate.mechanics.half_space import hertz, sneddon
from palpate.mechanics.half_space.hertz import (
    centreline_stress,
    greatest_shear,
    line_integrated_stress,
    secondary_stress,
)

R, E, NU = 5e-3, 0.3e6, 0.49
BELOW = np.array([[0.0, 0.0, 0.5], [0.6, 0.3, 0.4], [1.0, 0.0, 0.5], [-1.4, 0.8, 0.9], [2.0, -1.0, 0.3]])
"""Places under a contact of radius 1, none nearer to its edge than 0.3."""


def hertz_force() -> float:
    """Force as the integral of the peak pressure's half ellipse, 30 digits."""
    errors = []
    for d in (0.1e-3, 0.5e-3, 1.25e-3):
        a, p0 = hertz.contact_radius(d, R), hertz.peak_pressure(d, R, E, NU)
        with mp.workdps(30):
            force = mp.quad(lambda r, a=a, p0=p0: 2 * mp.pi * r * p0 * mp.sqrt(1 - (r / a) ** 2), [0, a])
        errors.append(abs(float(force) / hertz.force_from_depth(d, R, E, NU) - 1))
    return max(errors)


def hertz_surface() -> float:
    """Sinking under Hertz's pressure by superposing Boussinesq's point forces, ring by ring."""
    d = 1e-3
    a, p0 = hertz.contact_radius(d, R), hertz.peak_pressure(d, R, E, NU)

    def ring(s: float, r: float) -> float:
        return p0 * math.sqrt(1 - (s / a) ** 2) * 4 * s / (r + s) * ellipk(4 * r * s / (r + s) ** 2)

    at = a * np.array([0.2, 0.5, 0.9, 1.3, 3.0])
    sunk = [quad(ring, 0, a, args=(r,), points=[r] if r < a else None, limit=200)[0] for r in at]
    return relative(hertz.surface_displacement(at, a, R), np.array(sunk) * (1 - NU**2) / (math.pi * E))


def sneddon_shapes() -> float:
    """Forces of an exact sphere, a cone and a flat punch from Sneddon's integral, done numerically."""
    slope = math.radians(70)
    shapes = [
        (lambda r: r / math.sqrt(R**2 - r**2), sneddon.sphere_force_from_depth, (R, E, NU)),
        (lambda r: 1 / math.tan(slope), sneddon.cone_force, (slope, E, NU)),
    ]
    errors = []
    for steepness, law, rest in shapes:
        for d in (0.3e-3, 1e-3, 2.5e-3):
            errors.append(abs(law(d, *rest) / _sneddon(d, steepness) - 1))
    punch = sneddon.punch_force(1e-3, 3e-3, E, NU) / (2 * 3e-3 * E / (1 - NU**2) * 1e-3)
    return max(*errors, abs(punch - 1))


def _sneddon(d: float, steepness: Callable[[float], float]) -> float:
    def g(t: float) -> float:
        return d - t * quad(lambda u: steepness(t * math.sin(u)), 0, math.pi / 2)[0]

    a = brentq(g, 1e-9, 0.95 * R, xtol=1e-15) if g(0.95 * R) < 0 else brentq(g, 1e-9, 5 * R, xtol=1e-15)
    return 2 * E / (1 - NU**2) * quad(g, 0, a, epsabs=0, epsrel=1e-12)[0]


def summed_below(places: ndarray, nu: float) -> ndarray:
    """Stress under Hertz's pressure with a = p0 = 1: Gauss points of the radius sin(t), even angles."""
    t, dt = np.polynomial.legendre.leggauss(80)
    t, dt = np.pi / 4 * (1 + t), np.pi / 4 * dt
    angle = 2 * np.pi * np.arange(160) / 160
    load = (np.cos(t) ** 2 * np.sin(t) * dt)[:, None] * np.full(160, 2 * np.pi / 160)
    sx, sy = np.sin(t)[:, None] * np.cos(angle), np.sin(t)[:, None] * np.sin(angle)
    return np.stack(
        [
            np.einsum("ij,ijkl->kl", load, _boussinesq(x - sx, y - sy, np.full(sx.shape, z), nu))
            for x, y, z in places
        ]
    )


def _boussinesq(x: ndarray, y: ndarray, z: ndarray, nu: float) -> ndarray:
    """Stress of a unit point force, Johnson (3.20), turned from cylinder to Cartesian axes."""
    r, rho = np.hypot(x, y), np.sqrt(x**2 + y**2 + z**2)
    m = (1 - 2 * nu) / (rho * (rho + z))
    rr, tt = m - 3 * z * r**2 / rho**5, (1 - 2 * nu) * z / rho**3 - m
    zz, rz = -3 * z**3 / rho**5, -3 * r * z**2 / rho**5
    c, s = x / r, y / r
    rows = [
        [rr * c**2 + tt * s**2, (rr - tt) * c * s, rz * c],
        [(rr - tt) * c * s, rr * s**2 + tt * c**2, rz * s],
        [rz * c, rz * s, zz],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1)) / (2 * np.pi)


def on_the_axis() -> float:
    """The stress on the axis, and the greatest shear, against Huber's centreline formulas in 30 digits."""
    errors, z = [], np.array([0.1, 0.4, 1.0, 3.0])
    for nu in (0.0, 0.3, 0.49):
        with mp.workdps(30):
            huber = [
                -(1 + mp.mpf(nu)) * (1 - v * mp.atan(1 / v)) + 1 / (2 * (1 + v**2)) for v in map(mp.mpf, z)
            ]
        along = centreline_stress(z, 1.0, 1.0, nu)
        errors += [
            relative(along[0], np.array([float(v) for v in huber])),
            relative(along[1], -1 / (1 + z**2)),
        ]
    digits = {0.3: (0.31002, 0.4808), 0.49: (0.26842, 0.5444), 0.5: (0.26635, 0.5478)}
    rounded = [abs(greatest_shear(nu)[0] - shear) > 5.1e-6 for nu, (shear, _) in digits.items()]
    return max(errors) + float(any(rounded))


def across_the_ray() -> float:
    """Stress across the ray at nu = 1/2: the Newtonian potential's form against superposed point forces."""
    tensor = summed_below(BELOW, 0.5)
    difference, shear = secondary_stress(*BELOW.T, 1.0, 1.0)
    return max(relative(difference, tensor[:, 0, 0] - tensor[:, 2, 2]), relative(shear, 2 * tensor[:, 0, 2]))


def _across(y: float, x: float, z: float, part: int) -> float:
    return float(secondary_stress(x, y, z, 1.0, 1.0)[part])


def line_integral() -> float:
    """The 3-D stress summed along the ray against the plane-strain form."""
    errors = []
    for x, z in ((0.0, 0.66), (0.7, 0.4), (2.0, 1.0)):
        parts = [quad(_across, -np.inf, np.inf, args=(x, z, part), limit=400)[0] for part in (0, 1)]
        errors.append(relative(np.array(parts), np.array(line_integrated_stress(x, z, 1.0, 1.0))))
    return max(errors)


ORACLES = (
    Oracle("Hertz: force", "the integral of its pressure, 30 digits (mpmath)", 1e-12, hertz_force),
    Oracle(
        "Hertz: displacement of the surface",
        "superposed point forces (elliptic integrals)",
        1e-8,
        hertz_surface,
    ),
    Oracle("Sphere, cone, punch: force", "Sneddon's integral by quadrature", 1e-8, sneddon_shapes),
    Oracle(
        "Stress on the axis, greatest shear",
        "Huber's centreline formulas, 30 digits (mpmath)",
        1e-10,
        on_the_axis,
    ),
    Oracle("Stress that a ray sees, nu = 1/2", "superposed Boussinesq forces", 1e-7, across_the_ray),
    Oracle("Stress summed along a ray", "quadrature of that stress", 1e-6, line_integral),
)
