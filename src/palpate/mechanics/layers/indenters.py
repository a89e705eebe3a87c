"""Indenters as height fields z(x, y): how far the rigid surface lies above the flat skin at first touch.

Heights are 0 at the lowest point and grow away from it; where the indenter has no lower face (beyond a
sphere's equator, beyond the rim of a punch) they are infinite. Pressed in by the depth d, the indenter asks
for the displacement d - z where it touches. Combine shapes with ``together``, lean them with ``tilt``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Field, Float, InputError, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive

MAX_TILT = math.radians(30)  # beyond it a leaning height field is no longer a rigid turn, to 15 %

Axis = Float[ndarray, " _"]
Place = tuple[float, float]
CENTRE: Place = (0.0, 0.0)


def sphere(x_m: Axis, y_m: Axis, radius_m: float, centre_m: Place = CENTRE) -> Field:
    """Exact sphere, z = R - sqrt(R^2 - r^2) [m].

    Args:
        x_m, y_m: columns and rows of the grid [m].
        radius_m: R, positive [m].
        centre_m: the lowest point (x, y) [m].

    Example:
        >>> z = sphere(np.array([0.0, 3e-3, 6e-3]), np.zeros(1), 5e-3)[0]
        >>> [round(float(height) * 1e3, 9) for height in z]
        [0.0, 1.0, inf]
    """
    positive("the sphere's radius", radius_m, "m")
    return _ball(_from_centre(x_m, y_m, centre_m), radius_m)


def paraboloid(x_m: Axis, y_m: Axis, radius_m: float, centre_m: Place = CENTRE) -> Field:
    """Hertz's z = r^2 / (2 R) [m], R the radius of curvature at the tip [m]."""
    positive("the tip's radius", radius_m, "m")
    return _from_centre(x_m, y_m, centre_m) ** 2 / (2 * radius_m)


def cone(x_m: Axis, y_m: Axis, slope_rad: float, centre_m: Place = CENTRE) -> Field:
    """Cone, z = r tan(slope) [m]; the slope is that of its side against the skin, 0 to 90 degrees [rad]."""
    return _from_centre(x_m, y_m, centre_m) * _slope(slope_rad)


def flat_punch(
    x_m: Axis, y_m: Axis, radius_m: float, edge_radius_m: float = 0.0, centre_m: Place = CENTRE
) -> Field:
    """Upright cylinder of radius a; its edge is sharp, or rounded by a quarter circle inside a [m]."""
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
    """Straight edge, z = (distance from its line) tan(slope) [m], cut off square at its ends.

    Args:
        x_m, y_m: columns and rows of the grid [m].
        slope_rad: of both sides against the skin, 0 to 90 degrees [rad].
        length_m: of the edge [m].
        turn_rad: of the edge from x towards y [rad].
        centre_m: the middle of the edge (x, y) [m].
    """
    along, across = _along_and_across(x_m, y_m, turn_rad, centre_m)
    return _cut(np.abs(across) * _slope(slope_rad), along, length_m)


def lying_cylinder(
    x_m: Axis, y_m: Axis, radius_m: float, length_m: float, turn_rad: float = 0.0, centre_m: Place = CENTRE
) -> Field:
    """Cylinder of radius R on its side, its axis turned from x towards y, cut off square at its ends [m]."""
    positive("the cylinder's radius", radius_m, "m")
    along, across = _along_and_across(x_m, y_m, turn_rad, centre_m)
    return _cut(_ball(np.abs(across), radius_m), along, length_m)


def balls(x_m: Axis, y_m: Axis, radius_m: float, places_m: Sequence[tuple[float, float, float]]) -> Field:
    """Equal spheres on one holder, each with its lowest point at (x, y) and so far above the skin [m]."""
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
    """Several indenters on one holder: the lowest of their heights."""
    return np.minimum.reduce(gaps_m)


def tilt(gap_m: Field, x_m: Axis, y_m: Axis, slope_x_rad: float = 0.0, slope_y_rad: float = 0.0) -> Field:
    """Lean an indenter by an angle along x and along y; its lowest grid point is at height 0 again."""
    _check_tilt(slope_x_rad)
    _check_tilt(slope_y_rad)
    sloped = gap_m + math.tan(slope_x_rad) * x_m + math.tan(slope_y_rad) * y_m[:, None]
    return np.asarray(sloped - sloped.min())


def lean(gap_m: Field, x_m: Axis, y_m: Axis, tilt_rad: float, turn_rad: float = 0.0) -> Field:
    """Lean an indenter by one angle; the side that ``turn_rad``, from x towards y, points to is lower."""
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
