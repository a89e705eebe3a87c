"""Sphere or flat punch on an elastic layer over a rigid base: Hayes's exact law.

The layer's surface sinks by u(k) = 2/(E* k) M(kh) p(k) under a pressure p(k) of wavenumber k, where

    M = [(3-4nu) sinh 2s - 2s] / [(3-4nu) cosh 2s + 2s^2 + 5-12nu+8nu^2]     bonded to its base,
    M = (cosh 2s - 1) / (sinh 2s + 2s)                                       sliding without friction.

With p(k) = (E*/pi) int_0^a g(t) cos(kt) dt, inside the contact

    g(t) - (2/pi) int_0^a g(s) int_0^inf [1 - M(kh)] cos(ks) cos(kt) dk ds = d - { 0            flat punch
                                                                               { t atanh(t/R) sphere,

then F = 2 E* int_0^a g dt, and g(a) = 0 under a sphere.

Reference: W. C. Hayes et al., J. Biomech. 5 (1972) 541, doi:10.1016/0021-9290(72)90010-3.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive, reduced_modulus
from palpate.mechanics.half_space.sneddon import MAX_RADIUS

MAX_RATIO = 10.0  # maximum a/h
MAX_STRAIN = 0.2  # maximum d/h of small strain
NODES = 48  # nodes over the contact
LAST_WAVE = 25.0  # s beyond which 1 - M is below 1e-18

Base = Literal["bonded", "sliding"]
Function = Float[ndarray, " n"]


def layer_transfer(s: Function, poisson_ratio: float, base: Base = "bonded") -> Function:
    """Return M(s), a layer's displacement over a half-space's under a pressure of wavenumber s/h."""
    reduced_modulus(1.0, poisson_ratio)
    nu, fall = poisson_ratio, np.exp(-2 * s)  # all divided by e^2s / 2, so that nothing overflows
    if base == "bonded":
        k = 3 - 4 * nu
        below = k * (1 + fall**2) + 2 * (2 * s**2 + 5 - 12 * nu + 8 * nu**2) * fall
        return np.asarray((k * (1 - fall**2) - 4 * s * fall) / below)
    if base == "sliding":
        return np.asarray((1 - fall) ** 2 / np.maximum(1 - fall**2 + 4 * s * fall, 1e-300))
    raise InputError(f"base {base!r} is not known; the layer's base is 'bonded' or 'sliding'")


def punch_factor(ratio: float, poisson_ratio: float, base: Base = "bonded") -> float:
    """Return Hayes's kappa(a/h, nu): the force on a flat punch over that on a half-space.

    Example:
        >>> round(punch_factor(1e-9, 0.5), 6)
        1.0
    """
    _, weights, inverse = _system(_ratio(ratio), poisson_ratio, base)
    return float(weights @ inverse.sum(axis=1))


def sphere_from_radius(
    contact_radius_m: float,
    radius_m: float,
    thickness_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
    base: Base = "bonded",
) -> tuple[float, float]:
    """Return depth [m] and force [N] of a sphere whose contact on a layer has radius a."""
    positive("the sphere's radius", radius_m, "m")
    positive("the layer's thickness", thickness_m, "m")
    E, a, R = reduced_modulus(youngs_modulus_pa, poisson_ratio), contact_radius_m, radius_m
    if not 0.0 <= a <= MAX_RADIUS * R * (1 + 1e-12):
        raise RangeError(
            f"contact radius {a:g} m lies outside 0 to {MAX_RADIUS * R:g} m (a/R <= {MAX_RADIUS}); "
            "use a larger sphere"
        )
    if a == 0.0:
        return 0.0, 0.0
    t, weights, inverse = _system(_ratio(a / thickness_m), poisson_ratio, base)
    flat, curved = inverse.sum(axis=1), inverse @ (a * t * np.arctanh(a / R * t))
    depth = curved[-1] / flat[-1]
    return float(depth), float(2.0 * E * a * (weights @ (depth * flat - curved)))


def sphere_force(
    depth_m: float,
    radius_m: float,
    thickness_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
    base: Base = "bonded",
) -> float:
    """Return the force of a sphere pressed into a layer [N]."""
    positive("the sphere's radius", radius_m, "m")
    _strain(depth_m, thickness_m)
    rest = (radius_m, thickness_m, youngs_modulus_pa, poisson_ratio, base)
    widest = min(MAX_RADIUS * radius_m, MAX_RATIO * thickness_m)
    limit = sphere_from_radius(widest, *rest)[0]
    if depth_m > limit * (1 + 1e-12):
        raise RangeError(
            f"depth {depth_m:g} m lies outside 0 to {limit:g} m, where a/R <= {MAX_RADIUS} and "
            f"a/h <= {MAX_RATIO:g}; press less deeply or use a larger sphere",
            code="outside-law",
        )
    if depth_m == 0.0:
        return 0.0
    low = min(0.5 * math.sqrt(radius_m * depth_m), widest)  # a half-space has sqrt(R d), any layer more
    if depth_m >= limit:
        return sphere_from_radius(widest, *rest)[1]
    a = brentq(lambda a: sphere_from_radius(a, *rest)[0] - depth_m, low, widest, xtol=1e-300, rtol=1e-12)
    return sphere_from_radius(a, *rest)[1]


@lru_cache(maxsize=256)
def _system(ratio: float, nu: float, base: Base) -> tuple[Function, Function, Float[ndarray, "n n"]]:
    """Nodes and weights on 0 to 1, then t = 1 with weight 0, and the inverse of the equation (a = 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    t, weights = np.append((1 + nodes) / 2, 1.0), np.append(weights / 2, 0.0)
    s, ds = np.polynomial.legendre.leggauss(64 + int(16 * ratio))
    s, ds = LAST_WAVE / 2 * (1 + s), LAST_WAVE / 2 * ds
    waves = np.cos(ratio * np.outer(t, s))
    kernel = 2 / np.pi * ratio * (waves * (1 - layer_transfer(s, nu, base)) * ds) @ waves.T
    return t, weights, np.linalg.inv(np.eye(len(t)) - kernel * weights)


def _ratio(ratio: float) -> float:
    if not 0.0 < ratio <= MAX_RATIO * (1 + 1e-12):
        raise RangeError(
            f"contact radius over thickness, {ratio:g}, lies outside 0 to {MAX_RATIO:g}, where this was "
            "verified; a still thinner layer is no longer a contact problem",
            code="outside-law",
        )
    return ratio


def _strain(depth_m: float, thickness_m: float) -> None:
    positive("the layer's thickness", thickness_m, "m")
    limit = MAX_STRAIN * thickness_m
    if not 0.0 <= depth_m <= limit * (1 + 1e-12):
        raise RangeError(
            f"depth {depth_m:g} m lies outside 0 to {limit:g} m, a fifth of the layer's thickness of "
            f"{thickness_m:g} m, where small strain holds; press less deeply or use a finite-strain model",
            code="strain-limit",
        )
