"""Contact of a rigid indenter of any shape with a stack of layers, without friction or adhesion.

On a grid of cells with pressures p and rigid heights z, the contact at depth d minimises 1/2 p.Gp - p.(d - z)
over p >= 0: where the indenter presses, the skin takes its shape; elsewhere it lies below. Contacts that are
apart are solved together.

Constrained conjugate gradients: a step goes along the residual of the active cells (those that press, and
those the indenter is inside of), preconditioned by an approximate inverse of G and made conjugate to the step
before (Polak and Ribiere's factor, never negative, which restarts by itself where cells come and go); then
what became negative is cut off. Under a given load every direction has zero sum, and the depth is the mean
over what presses.

References: I. A. Polonsky and L. M. Keer, Wear 231, 206 (1999), doi:10.1016/S0043-1648(99)00113-1, for
gradients on changing cells; E. A. H. Vollebregt (2014) for the preconditioner by Fourier transform; for the
area within the rim's cells V. A. Yastrebov, G. Anciaux and J.-F. Molinari, Tribology International 114, 161
(2017), doi:10.1016/j.triboint.2017.02.023.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion

from palpate.core import Contact, Field, Float, InputError, Mask, Pose, Probe, RangeError, ndarray
from palpate.mechanics.layers.influence import normal_influence, normal_preconditioner
from palpate.mechanics.layers.stack import Stack
from palpate.mechanics.layers.surface_grid import Cells, cells

STEPS = 1000
REFRESHED = 10  # steps after which the displacement is summed anew, so that rounding does not gather in it
RESTING_SHARE = 0.1  # of the indenter, on which a load first rests

Linear = Callable[[Field], Field]


class SolvedPressure(NamedTuple):
    """Pressures [Pa], displacement [m], depth [m], steps taken, greatest misfit where it presses [m]."""

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
        compliance: displacement [m] under pressures [Pa]; linear, symmetric, positive definite.
        preconditioner: an approximate inverse of it; symmetric, positive definite.
        gap: heights [m]; infinite where nothing can touch.
        tolerance: misfit allowed, as a part of the greatest displacement.
        depth: of the indenter, above the least of the gap [m]; or
        load: the sum of the pressures, positive [Pa].
    """
    possible = np.isfinite(gap)
    heights = np.where(possible, gap, 0.0)
    p = _initial_pressure(compliance, gap, possible, depth, load)
    u = compliance(p)
    along, gradient, gain = np.zeros_like(p), np.zeros_like(p), np.inf
    for step in range(STEPS):
        pressing = p > 0.0
        d = float((u + heights)[pressing].mean()) if depth is None else depth
        room = u + heights - d  # between skin and indenter; below zero the indenter is inside the skin
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
    """A plain guess: pressures like the overlap, at the best scale; or the load on the lowest part."""
    if load is not None:
        resting = gap <= np.quantile(gap[possible], RESTING_SHARE)
        return np.where(resting, load / np.count_nonzero(resting), 0.0)
    overlap = np.maximum(depth - gap, 0.0)
    return overlap * float((overlap**2).sum() / (overlap * compliance(overlap)).sum())


MODEL = "rigid indenter, bonded linear elastic layers, small strain, no friction, no adhesion"
TOLERANCE = (
    1e-5  # of the greatest displacement asked for: how far the skin may be from the indenter it touches
)
MIN_INNER = 0.5  # part of the touching cells with four touching neighbours: four cells a radius
RIM = (math.pi - 1 + math.log(2)) / 24  # of a cell that each face of the rim counts too much (Yastrebov)


@dataclass(frozen=True, slots=True)
class StackContact:
    """The contact of an indenter with a stack, on the surface grid, SI.

    Attributes:
        x_m, y_m: grid columns and rows [m].
        pressure_pa: positive in compression ``[ny nx]`` [Pa].
        displacement_m: surface displacement along z ``[ny nx]`` [m].
        touching: the cells that press ``[ny nx]``.
        force_n: sum of pressure times cell [N].
        area_m2: of the contact [m^2]: the touching cells, less what the rim's cells have outside it.
        depth_m: approach past first touch [m].
        stack: what was touched.
        steps: iterations taken.
        misfit_m: greatest distance between skin and indenter where they touch [m].
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
        """The contact as core's Contact; its radius is that of the circle of equal area."""
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
        stack: the layers.
        gap_m: height of the indenter over the flat skin at first touch ``[ny nx]`` [m], as of
            ``palpate.mechanics.layers.indenters``; infinite where it has no lower face.
        x_m, y_m: columns and rows of a regular grid [m].
        depth_m: approach past first touch, 0 or more [m]; or
        force_n: normal force, 0 or more [N].
        tolerance: allowed misfit of skin and indenter, as a part of the greatest displacement.

    Returns:
        The contact. The force of a sphere is right to 1e-3, and its area to 1 %, from 10 cells a contact
        radius on; with 4, the coarsest allowed, to 1 % and 5 %.
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
    """Touching cells less RIM at each face to which the pressure falls; at a sharp edge it rises."""
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
