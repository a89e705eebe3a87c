"""Frictionless contact of a rigid indenter of any shape with a stack of layers.

On cells with pressures p and rigid heights z, the contact at depth d minimizes 1/2 p.Gp - p.(d - z) over p >=
0 by constrained, preconditioned conjugate gradients (Polak-Ribiere) on the active cells. Under a given load
directions have zero sum and the depth is the mean over the contact.

References: I. A. Polonsky and L. M.
Keer, Wear 231, 206 (1999), doi:10.1016/S0043-1648(99)00113-1; E. A. H. Vollebregt (2014) for the
preconditioner; V. A. Yastrebov, G. Anciaux and J.-F. Molinari, Tribology International 114, 161 (2017),
doi:10.1016/j.triboint.2017.02.023, for the contact area.

Indenters as height fields z(x, y) of the rigid surface over the flat membrane at first touch.

Heights are 0 at the lowest point and infinite where the indenter has no lower face.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion

from palpate.core import Contact, Field, Float, InputError, Mask, Pose, Probe, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive
from palpate.mechanics.layers.influence import Cells, cells, normal_influence, normal_preconditioner
from palpate.mechanics.layers.stack import Stack

STEPS = 1000
REFRESHED = 10  # steps between recomputations of the displacement, against rounding
RESTING_SHARE = 0.1  # fraction of the indenter in the initial guess of a load

Linear = Callable[[Field], Field]


class SolvedPressure(NamedTuple):
    """Pressures [Pa], displacement [m], depth [m], steps, and maximum misfit in contact [m]."""

    pressure: Field
    displacement: Field
    depth: float
    steps: int
    misfit: float


def solve_pressure(
    compliance: Linear,
    preconditioner: Linear,
    gap: Field,
    tolerance: float,
    *,
    depth: float | None = None,
    load: float | None = None,
) -> SolvedPressure:
    """Find p >= 0 with compliance(p) = depth - gap where p > 0, and no less elsewhere.

    Args:
        compliance: Displacement [m] under pressures [Pa]; linear, symmetric, positive definite.
        preconditioner: Approximate inverse of it; symmetric, positive definite.
        gap: Heights [m]; infinite where nothing can touch.
        tolerance: Allowed misfit over the maximum displacement.
        depth: Depth of the indenter [m]; or
        load: Sum of the pressures [Pa].
    """
    possible = np.isfinite(gap)
    heights = np.where(possible, gap, 0.0)
    p = _initial_pressure(compliance, gap, possible, depth, load)
    u = compliance(p)
    along, gradient, gain = np.zeros_like(p), np.zeros_like(p), np.inf
    for step in range(STEPS):
        pressing = p > 0.0
        d = float((u + heights)[pressing].mean()) if depth is None else depth
        room = u + heights - d  # negative where the indenter penetrates
        allowed = tolerance * float(np.max(d - heights, where=possible, initial=0.0))
        misfit = float(np.abs(room[pressing]).max(initial=0.0))
        if misfit <= allowed and not np.any(possible & ~pressing & (room < -allowed)):
            return SolvedPressure(p, u, d, step, misfit)
        active = pressing | (possible & (room < 0.0))
        fixed_sum = depth is None
        before, gradient = gradient, _within(room, active, fixed_sum)
        preconditioned = _within(preconditioner(gradient), active, fixed_sum)
        conjugate = max(0.0, float((preconditioned * (gradient - before)).sum())) / gain
        along = np.where(active, preconditioned + conjugate * along, 0.0)
        gain = float((preconditioned * gradient).sum())
        response = compliance(along)
        length = float((gradient * along).sum() / (response * along).sum())
        trial = p - length * along
        p = np.maximum(trial, 0.0)
        refresh = np.any(trial < 0.0) or step % REFRESHED == 0
        u = compliance(p) if refresh else u - length * response
        if load is not None:
            u, p = u * (load / p.sum()), p * (load / p.sum())
    raise RangeError(
        f"the contact did not settle to {tolerance:g} of its displacement in {STEPS} steps; allow a larger "
        "tolerance, or give a grid that resolves the indenter"
    )


def _within(values: Field, active: Mask, fixed_sum: bool) -> Field:
    mean = values[active].mean() if fixed_sum else 0.0
    return np.where(active, values - mean, 0.0)


def _initial_pressure(
    compliance: Linear, gap: Field, possible: Mask, depth: float | None, load: float | None
) -> Field:
    """Pressures proportional to the overlap, or the load on the lowest part."""
    if load is not None:
        resting = gap <= np.quantile(gap[possible], RESTING_SHARE)
        return np.where(resting, load / np.count_nonzero(resting), 0.0)
    overlap = np.maximum(depth - gap, 0.0)
    return overlap * float((overlap**2).sum() / (overlap * compliance(overlap)).sum())


MODEL = "rigid indenter, bonded linear elastic layers, small strain, no friction, no adhesion"
TOLERANCE = 1e-5  # allowed misfit over the maximum displacement
MIN_INNER = 0.5  # minimum fraction of contact cells with four touching neighbours: four cells per radius
RIM = (math.pi - 1 + math.log(2)) / 24  # area correction per rim face, in cells (Yastrebov)


@dataclass(frozen=True, slots=True)
class StackContact:
    """Contact of an indenter with a stack on the surface grid, SI.

    Attributes:
        area_m2: Contact area, corrected for the rim's cells [m^2].
        depth_m: Approach past first touch [m].
        steps: Iterations.
        misfit_m: Maximum distance between surface and indenter in contact [m].
    """

    x_m: Float[ndarray, " nx"]
    y_m: Float[ndarray, " ny"]
    pressure_pa: Field
    displacement_m: Field
    touching: Mask
    force_n: float
    area_m2: float
    depth_m: float
    stack: Stack
    steps: int
    misfit_m: float

    def as_contact(self, probe: Probe, pose: Pose) -> Contact:
        """Convert to a `Contact` with the radius of the circle of equal area."""
        radius_m, surface = math.sqrt(self.area_m2 / math.pi), (self.pressure_pa, self.displacement_m)
        return Contact(
            self.x_m, self.y_m, *surface, self.touching, self.force_n, radius_m, probe, pose, MODEL
        )


def press_stack(
    stack: Stack,
    gap_m: Field,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
    *,
    depth_m: float | None = None,
    force_n: float | None = None,
    tolerance: float = TOLERANCE,
) -> StackContact:
    """Press a rigid height field into a stack to a depth, or by a force.

    Args:
        stack: Layers.
        gap_m: Height of the indenter over the flat surface at first touch, infinite where it has no lower
            face [m].
        x_m, y_m: Columns and rows of a regular grid [m].
        depth_m: Approach past first touch [m]; or
        force_n: Normal force [N].
        tolerance: Allowed misfit over the maximum displacement.

    Returns:
        Contact. For a sphere the force is accurate to 1e-3 and the area to 1 % with 10 cells per contact
        radius; with 4, the minimum, to 1 % and 5 %.
    """
    grid = cells(x_m, y_m)
    _check_gap(gap_m, grid)
    if (depth_m is None) == (force_n is None):
        raise InputError("give exactly one of depth_m and force_n")
    for name, value, unit in (("depth_m", depth_m, "m"), ("force_n", force_n, "N")):
        if value is not None and not 0.0 <= value < math.inf:
            raise RangeError(
                f"{name} is {value} {unit}; give a number of {unit} from 0 up", code="not-positive"
            )
    if not (depth_m or force_n):
        return _untouched(stack, x_m, y_m)
    _check_depth(depth_m, stack, gap_m)
    solution = solve_pressure(
        partial(normal_influence(stack, grid).apply, 0),
        partial(normal_preconditioner(stack, grid).apply, 0),
        gap_m,
        tolerance,
        depth=depth_m,
        load=None if force_n is None else force_n / grid.area_m2,
    )
    _check_depth(solution.depth, stack, gap_m)
    touching = solution.pressure > 0.0
    _check_touching(touching, x_m, y_m)
    force, area = float(solution.pressure.sum()) * grid.area_m2, _area(solution.pressure, grid)
    fields = (x_m, y_m, solution.pressure, solution.displacement, touching)
    return StackContact(*fields, force, area, solution.depth, stack, solution.steps, solution.misfit)


def _area(p: Field, grid: Cells) -> float:
    """Contact area: cells less RIM at each face to which the pressure falls."""
    faces = 0
    for side in (1, -1):
        for axis in (0, 1):
            outer, inner = np.roll(p, -side, axis), np.roll(p, side, axis)
            faces += int(np.count_nonzero((p > 0.0) & (outer == 0.0) & (inner >= p)))
    return (np.count_nonzero(p) - RIM * faces) * grid.area_m2


def _untouched(stack: Stack, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]) -> StackContact:
    nothing = np.zeros((len(y_m), len(x_m)))
    return StackContact(x_m, y_m, nothing, nothing, nothing > 0.0, 0.0, 0.0, 0.0, stack, 0, 0.0)


def _check_gap(gap_m: Field, grid: Cells) -> None:
    if gap_m.shape != (grid.ny, grid.nx):
        raise InputError(f"the gap has {gap_m.shape} points, the grid {(grid.ny, grid.nx)} (rows, columns)")
    if not (np.all(gap_m >= 0.0) and np.any(gap_m < math.inf)):
        raise InputError(
            "a gap is a height in m from 0 up, with infinity where nothing can touch; this one has "
            f"{np.count_nonzero(np.isnan(gap_m))} NaN, {np.count_nonzero(gap_m < 0.0)} negative and "
            f"{np.count_nonzero(np.isfinite(gap_m))} finite heights"
        )


def _check_depth(depth_m: float | None, stack: Stack, gap_m: Field) -> None:
    if depth_m is not None and not depth_m < stack.thickness_m:
        raise RangeError(
            f"a depth of {depth_m:g} m is not within the stack's thickness, "
            f"0 to {stack.thickness_m:g} m; press less"
        )
    if depth_m is not None and not depth_m > gap_m.min():
        raise RangeError(
            f"at a depth of {depth_m:g} m no point of the grid is under the indenter, whose lowest one lies "
            f"at {gap_m.min():g} m; give a finer grid, or one with a point at the tip",
            code="depth-below-grid",
        )


def _check_touching(touching: Mask, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]) -> None:
    if np.any(touching[[0, -1]]) or np.any(touching[:, [0, -1]]):
        raise RangeError(
            f"the contact reaches the border of the grid, {x_m[0]:g} to {x_m[-1]:g} m along x and "
            f"{y_m[0]:g} to {y_m[-1]:g} m along y; give a larger grid, a smaller indenter, or press less",
            code="contact-reaches-border",
        )
    inner = binary_erosion(touching)  # cells with four touching neighbours
    if np.count_nonzero(inner) < MIN_INNER * np.count_nonzero(touching):
        raise RangeError(
            f"the contact covers {np.count_nonzero(touching)} cells, of which {np.count_nonzero(inner)} are "
            f"not at its rim; {MIN_INNER:.0%} at least must be, so give a finer grid"
        )


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
