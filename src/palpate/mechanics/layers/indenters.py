"""Indenters as height fields z(x, y) of the rigid surface over the flat membrane at first touch.

Heights are 0 at the lowest point and infinite where the indenter has no lower face.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Field, Float, InputError, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive

MAX_TILT = math.radians(30)  # limit of tilting a height field as a rigid rotation

Axis = Float[ndarray, " _"]
Place = tuple[float, float]
CENTRE: Place = (0.0, 0.0)


def sphere(x_m: Axis, y_m: Axis, radius_m: float, centre_m: Place = CENTRE) -> Field:
    """Return an exact sphere, z = R - sqrt(R^2 - r^2), with its lowest point at `centre_m` [m].

    Example:
        >>> z = sphere(np.array([0.0, 3e-3, 6e-3]), np.zeros(1), 5e-3)[0]
        >>> [round(float(height) * 1e3, 9) for height in z]
        [0.0, 1.0, inf]
    """
    positive("the sphere's radius", radius_m, "m")
    return _ball(_from_centre(x_m, y_m, centre_m), radius_m)


def paraboloid(x_m: Axis, y_m: Axis, radius_m: float, centre_m: Place = CENTRE) -> Field:
    """Return Hertz's z = r^2 / (2 R) [m]."""
    positive("the tip's radius", radius_m, "m")
    return _from_centre(x_m, y_m, centre_m) ** 2 / (2 * radius_m)


def cone(x_m: Axis, y_m: Axis, slope_rad: float, centre_m: Place = CENTRE) -> Field:
    """Return a cone, z = r tan(slope), with the slope of its side against the surface [m]."""
    return _from_centre(x_m, y_m, centre_m) * _slope(slope_rad)


def flat_punch(
    x_m: Axis, y_m: Axis, radius_m: float, edge_radius_m: float = 0.0, centre_m: Place = CENTRE
) -> Field:
    """Return an upright cylinder with a sharp edge, or one rounded by a quarter circle
    inside its radius [m].
    """
    positive("the punch's radius", radius_m, "m")
    if not 0.0 <= edge_radius_m <= radius_m:
        raise RangeError(
            f"the edge's radius {edge_radius_m} m lies outside 0 to the punch's {radius_m} m",
            code="edge-radius",
        )
    r = _from_centre(x_m, y_m, centre_m)
    past_flat = np.maximum(r - (radius_m - edge_radius_m), 0.0)
    rounded = _ball(past_flat, edge_radius_m) if edge_radius_m else np.zeros_like(r)
    return np.where(r <= radius_m, rounded, np.inf)


def wedge(
    x_m: Axis, y_m: Axis, slope_rad: float, length_m: float, turn_rad: float = 0.0, centre_m: Place = CENTRE
) -> Field:
    """Return a straight edge, z = (distance from its line) tan(slope), turned from x towards y and cut square
    at its ends [m].
    """
    along, across = _along_and_across(x_m, y_m, turn_rad, centre_m)
    return _cut(np.abs(across) * _slope(slope_rad), along, length_m)


def lying_cylinder(
    x_m: Axis, y_m: Axis, radius_m: float, length_m: float, turn_rad: float = 0.0, centre_m: Place = CENTRE
) -> Field:
    """Return a lying cylinder, turned from x towards y and cut square at its ends [m]."""
    positive("the cylinder's radius", radius_m, "m")
    along, across = _along_and_across(x_m, y_m, turn_rad, centre_m)
    return _cut(_ball(np.abs(across), radius_m), along, length_m)


def balls(x_m: Axis, y_m: Axis, radius_m: float, places_m: Sequence[tuple[float, float, float]]) -> Field:
    """Return equal spheres on one holder at (x, y, height of the lowest point), the lowest at 0 [m]."""
    heights = [up for _, _, up in places_m]
    if not heights:
        raise InputError("a holder without spheres; give one place (x, y, height) in m or more")
    if min(heights) != 0.0:
        raise RangeError(
            f"the spheres are {heights} m above the skin; the lowest is at 0 m, at first touch",
            code="spheres-above-surface",
        )
    return together(*(sphere(x_m, y_m, radius_m, (x, y)) + up for x, y, up in places_m))


def together(*gaps_m: Field) -> Field:
    """Combine several indenters on one holder."""
    return np.minimum.reduce(gaps_m)


def tilt(gap_m: Field, x_m: Axis, y_m: Axis, slope_x_rad: float = 0.0, slope_y_rad: float = 0.0) -> Field:
    """Tilt an indenter by slopes along x and y; its lowest grid point returns to height 0."""
    _check_tilt(slope_x_rad)
    _check_tilt(slope_y_rad)
    sloped = gap_m + math.tan(slope_x_rad) * x_m + math.tan(slope_y_rad) * y_m[:, None]
    return np.asarray(sloped - sloped.min())


def lean(gap_m: Field, x_m: Axis, y_m: Axis, tilt_rad: float, turn_rad: float = 0.0) -> Field:
    """Tilt an indenter by one angle; the side at ``turn_rad``, from x towards y, is lower."""
    _check_tilt(tilt_rad)
    slope = math.tan(tilt_rad)
    return tilt(
        gap_m, x_m, y_m, -math.atan(slope * math.cos(turn_rad)), -math.atan(slope * math.sin(turn_rad))
    )


def _check_tilt(tilt_rad: float) -> None:
    if not abs(tilt_rad) <= MAX_TILT:
        raise RangeError(
            f"a tilt of {tilt_rad} rad lies outside -{MAX_TILT:.4f} to {MAX_TILT:.4f} rad", code="tilt-range"
        )


def _ball(r: Field, R: float) -> Field:
    inside = np.minimum(r, R)
    return np.where(r <= R, inside**2 / (R + np.sqrt((R - inside) * (R + inside))), np.inf)


def _cut(z: Field, along: Field, length_m: float) -> Field:
    positive("the length", length_m, "m")
    return np.where(np.abs(along) <= length_m / 2, z, np.inf)


def _from_centre(x_m: Axis, y_m: Axis, centre_m: Place) -> Field:
    return np.hypot(x_m[None, :] - centre_m[0], y_m[:, None] - centre_m[1])


def _along_and_across(x_m: Axis, y_m: Axis, turn_rad: float, centre_m: Place) -> tuple[Field, Field]:
    x, y = x_m[None, :] - centre_m[0], y_m[:, None] - centre_m[1]
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return c * x + s * y, c * y - s * x


def _slope(slope_rad: float) -> float:
    if not 0.0 < slope_rad < math.pi / 2:
        raise RangeError(
            f"a side's slope of {slope_rad} rad against the skin lies outside 0 to 1.5708 rad",
            code="side-slope",
        )
    return math.tan(slope_rad)
