"""Coulomb friction on a stack: a pressed indenter is shifted and rotated along the surface.

With the pressure p fixed, tractions q of the probe minimize 1/2 q.G q - q.s over |q| <= mu p, with the rigid
motion s = shift + turn (-y, x), made in one step. The normal displacement by q is neglected, as by Cattaneo
and Mindlin.

References: K. L. Johnson, Contact Mechanics (1985), sec. 7.2, doi:10.1017/CBO9781139171731; J.
L. Lubkin, J. Appl. Mech. 18, 183 (1951), for the rotation.

Displacement and stress inside a stack under a surface load, on planes at given depths.

The load is a sum of waves (`stack`). In-plane stresses follow from the stretch: with n = nu / (1 - nu), u_k =
i U along the wave and u_t = V across it,

    s_kk = -2 mu k U / (1 - nu) + n s_zz,     s_tt = -2 mu n k U + n s_zz,     s_kt = i mu k V.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core import Field, Float, InputError, Mask, RangeError, ndarray
from palpate.mechanics.layers.contact_solver import StackContact
from palpate.mechanics.layers.influence import (
    Cells,
    Wave,
    Waves,
    block_span,
    cells,
    spread,
    tangential_influence,
    tangential_preconditioner,
)
from palpate.mechanics.layers.stack import Level, Material, Slab, Stack, climb

TOLERANCE = 1e-4  # allowed slip of sticking cells over the maximum motion
FORCE_TOLERANCE = 1e-4  # relative tolerance of the load
AT_LIMIT = 1 - 1e-9  # fraction of the limit that counts as slip
STEPS = 1000
SHIFTS = 50
FIRST, CLOSER = 1e-2, 0.1  # tolerance of a load's first motion, and of the next ones over the residual
MIN_FIRM, MAX_FIRM = 1e-3, 1.2
"""Range of stiffness over that without slip in which a secant is accepted."""
MAX_STEP = 0.5  # maximum step over the motion
NEARLY = 0.9  # maximum friction fraction of the initial guess by Mindlin's law

Pair = Float[ndarray, "2"]
Motion = Float[ndarray, "3"]  # shift (x, y), and rotation times the contact radius [m]
Load = Float[ndarray, "3"]  # force (x, y), and moment over the contact radius [N]
Fields = Float[ndarray, "2 ny nx"]


@dataclass(frozen=True, slots=True)
class StackShear:
    """Tractions caused by a tangential motion of the indenter, on its contact's grid, SI.

    Attributes:
        shear_pa: Traction of the probe on the surface along x and y [Pa].
        sticking: Contact cells that stick; the others slip.
        moment_nm: Moment on the surface about z through the axis, from x towards y [N m].
        axis_m: Position of the axis [m].
    """

    contact: StackContact
    friction: float
    shear_pa: Fields
    sticking: Mask
    force_n: Pair
    shift_m: Pair
    moment_nm: float
    turn_rad: float
    axis_m: tuple[float, float]

    @property
    def displacement_m(self) -> Fields:
        """In-plane displacement of the surface [m]."""
        grid = cells(self.contact.x_m, self.contact.y_m)
        return tangential_influence(self.contact.stack, grid).apply_pair(self.shear_pa)


def shear_stack(
    contact: StackContact,
    friction: float,
    *,
    shift_m: tuple[float, float] | None = None,
    turn_rad: float | None = None,
    force_n: tuple[float, float] | None = None,
    moment_nm: float | None = None,
    axis_m: tuple[float, float] = (0.0, 0.0),
) -> StackShear:
    """Shift and rotate the indenter of a contact along the surface, by a motion or by a load.

    Args:
        contact: Contact with some force.
        friction: Coulomb coefficient.
        shift_m: Motion along x and y [m].
        turn_rad: Rotation about the axis, from x towards y [rad]. Or
        force_n: Force on the surface along x and y, below the friction limit [N].
        moment_nm: Moment about the axis [N m]; None for a probe that does not rotate.
        axis_m: Position of the axis [m].
    """
    if not contact.force_n > 0.0:
        raise RangeError(
            f"a contact of {contact.force_n} N carries no shear; press with more than 0 N",
            code="no-normal-force",
        )
    if not 0.0 < friction < math.inf:
        raise RangeError(
            f"the coefficient of friction is {friction}; give a positive number", code="not-positive"
        )
    by_motion = shift_m is not None or turn_rad is not None
    by_load = force_n is not None or moment_nm is not None
    if by_motion == by_load:
        raise InputError(
            "give exactly one of a motion and a load: shift_m and turn_rad, or force_n and moment_nm"
        )
    pair, about = (shift_m, turn_rad) if by_motion else (force_n, moment_nm)
    values = (*(pair or (0.0, 0.0)), about or 0.0)
    if not all(map(math.isfinite, (*values, *axis_m))):
        raise InputError(
            f"{values} about {axis_m} m; give finite numbers: two along x and y, one about z, a place in m"
        )
    problem = _Problem(contact, friction, axis_m)
    if by_motion:
        motion = np.array([*values[:2], values[2] * problem.radius])
        return problem.result(motion, problem.solve(motion, problem.none, problem.limit))
    load = np.array([*values[:2], values[2] / problem.radius])
    problem.check(load)
    return problem.result(*_motion_for(problem, load, turns=moment_nm is not None))


class _Problem:
    """One contact's influence and limits, on the part of the grid that touches."""

    def __init__(self, contact: StackContact, friction: float, axis_m: tuple[float, float]) -> None:
        self.contact, self.friction, self.axis_m = contact, friction, axis_m
        rows, columns = np.nonzero(contact.touching)
        shape = contact.touching.shape
        self.part = (block_span(rows, shape[0]), block_span(columns, shape[1]))
        y, x = contact.y_m[self.part[0]] - axis_m[1], contact.x_m[self.part[1]] - axis_m[0]
        self.grid = cells(x, y)
        self.touching = contact.touching[self.part]
        self.limit = friction * contact.pressure_pa[self.part]
        self.none = np.zeros((2, self.grid.ny, self.grid.nx))
        self.radius = math.sqrt(contact.area_m2 / math.pi)
        one, nothing = np.ones(self.limit.shape), np.zeros(self.limit.shape)
        rotation = np.stack([-y[:, None] * one, x * one]) / self.radius
        self.modes = np.stack([[one, nothing], [nothing, one], rotation]) * self.touching
        self._influence = tangential_influence(contact.stack, self.grid)
        self._preconditioner = tangential_preconditioner(contact.stack, self.grid)
        self.stiffest = float(self._preconditioner.spectra[0].max())

    def displacement(self, q: Fields) -> Fields:
        return self._influence.apply_pair(q)

    def precondition(self, u: Fields) -> Fields:
        return np.stack([self._preconditioner.apply(0, part) for part in u])

    def load(self, q: Fields) -> Load:
        """Load of the tractions [N]: their work in each motion of 1 m."""
        return np.tensordot(self.modes, q, axes=3) * self.grid.area_m2

    def check(self, load: Load) -> None:
        """Reject loads beyond friction."""
        force, moment = math.hypot(*load[:2]), abs(load[2]) * self.radius
        greatest = self.friction * self.contact.force_n
        if not force < greatest:
            raise RangeError(
                f"a force of {force:g} N makes the whole contact slip; give less than friction "
                f"times the normal force, {greatest:g} N",
                code="sliding",
            )
        around = float((self.limit * np.hypot(*self.modes[2])).sum()) * self.grid.area_m2 * self.radius
        if not moment < around:
            raise RangeError(
                f"a moment of {moment:g} N m makes the whole contact slip; give less than friction times "
                f"the pressure's distance from the axis, {around:g} N m",
                code="twisting-slip",
            )

    def solve(self, motion: Motion, q: Fields, limit: Field, tolerance: float = TOLERANCE) -> Fields:
        """Tractions [Pa] at a motion, by conjugate gradients from a guess."""
        target = np.tensordot(motion, self.modes, axes=1)
        allowed = tolerance * float(np.hypot(*target).max())
        q = _limited(q, limit)
        u = self.displacement(q)
        along, gradient, gain = self.none, self.none, np.inf
        for _ in range(STEPS):
            lag = np.where(self.touching, target - u, 0.0)
            limits = _limit_directions(lag, q, limit)
            before, gradient = gradient, _without(limits, lag)
            if np.abs(gradient).max() <= allowed:
                return q
            rising = (lag * limits).sum(axis=0)
            bend = np.divide(rising, limit, out=np.zeros_like(limit), where=rising > 0.0)
            firm = 1 / np.sqrt(1 + bend * self.stiffest)
            preconditioned = _without(limits, firm * self.precondition(firm * gradient) * self.touching)
            conjugate = max(0.0, float((preconditioned * (gradient - before)).sum())) / gain
            along = _without(limits, preconditioned + conjugate * along)
            gain = float((preconditioned * gradient).sum())
            curvature = self.displacement(along) + bend * along
            length = float((gradient * along).sum() / (curvature * along).sum())
            q = _limited(q + length * along, limit)
            u = self.displacement(q)
        raise RangeError(f"the shear did not settle in {STEPS} steps; give a finer grid or another motion")

    def result(self, motion: Motion, q: Fields) -> StackShear:
        shear = np.zeros((2, *self.contact.touching.shape))
        shear[(slice(None), *self.part)] = q
        sticking = np.zeros(self.contact.touching.shape, bool)
        sticking[self.part] = self.touching & (np.hypot(*q) < self.limit * AT_LIMIT)
        load = self.load(q)
        moment, turn = float(load[2]) * self.radius, float(motion[2]) / self.radius
        return StackShear(
            self.contact, self.friction, shear, sticking, load[:2], motion[:2], moment, turn, self.axis_m
        )


def _limit_directions(lag: Fields, q: Fields, limit: Field) -> Fields:
    """Unit vectors along tractions at their limit that would rise; zero elsewhere."""
    size = np.hypot(*q)
    outward = np.divide(q, size, out=np.zeros_like(q), where=size > 0.0)
    rising = (size >= limit * AT_LIMIT) & ((lag * outward).sum(axis=0) > 0.0)
    return np.where(rising, outward, 0.0)


def _without(limits: Fields, direction: Fields) -> Fields:
    return direction - (direction * limits).sum(axis=0) * limits


def _limited(q: Fields, limit: Field) -> Fields:
    size = np.hypot(*q)
    return q * np.divide(limit, size, out=np.ones_like(size), where=size > limit)


def _motion_for(problem: _Problem, load: Load, turns: bool) -> tuple[Motion, Fields]:
    """Motion of a load, by Broyden's method from the stiffness without slip."""
    free = slice(3 if turns else 2)
    scale = problem.contact.depth_m
    endless = np.where(problem.touching, np.inf, 0.0)
    unit_tractions = [problem.solve(scale * unit, problem.none, endless, FIRST) for unit in np.eye(3)[free]]
    compliance = scale * np.linalg.inv(np.stack([problem.load(q)[free] for q in unit_tractions], axis=1))
    stiffest, motion, target = np.linalg.inv(compliance), np.zeros(3), load[free]
    size, tolerance, q = float(np.linalg.norm(target)), FIRST, problem.none
    if size == 0.0:
        return motion, q
    part = min(size / (problem.friction * problem.contact.force_n), NEARLY)
    step, missing = compliance @ target * (1.5 * (1 - (1 - part) ** (2 / 3)) / part), target
    for _ in range(SHIFTS):
        motion = motion + np.append(step, np.zeros(3 - len(step)))
        try:
            q = problem.solve(motion, q, problem.limit, tolerance)
        except RangeError:  # unbounded motion, as in full slip
            break
        before, missing = missing, target - problem.load(q)[free]
        off = float(np.linalg.norm(missing)) / size
        if off <= FORCE_TOLERANCE and tolerance <= TOLERANCE:
            return motion, q
        gained, most = before - missing, float(step @ stiffest @ step)
        response = compliance @ gained
        if MIN_FIRM * most < step @ gained < MAX_FIRM * most and step @ response > 0.0:
            compliance = compliance + np.outer(step - response, step @ compliance) / (step @ response)
        step, tolerance = compliance @ missing, min(CLOSER * off, tolerance)
        longest, length = MAX_STEP * np.linalg.norm(motion), np.linalg.norm(step)
        step = step * float(longest / length) if length > longest else step
    raise RangeError(
        f"no shift and turn were found for a force of {math.hypot(*load[:2]):g} N and a moment of "
        f"{load[2] * problem.radius:g} N m, within {FORCE_TOLERANCE:g}; together they may make the whole "
        f"contact slip: give less of one, or of both, than what friction holds of each alone",
        code="combined-slip",
    )


MOVES = ("x", "y", "z")
STRESSES = ("xx", "yy", "zz", "yz", "xz", "xy")  # Voigt's order
MARGIN = 6.0  # default margin, in thicknesses
WIDTHS = 2.0  # maximum margin, in grid widths

SAME_PLANE = 1e-9  # relative distance at which a plane counts as an interface


@dataclass(frozen=True, slots=True)
class StackField:
    """Displacement and stress on planes inside a stack, SI.

    Attributes:
        displacement_m: In the order of ``MOVES`` [m].
        stress_pa: In the order of ``STRESSES`` [Pa]; at an interface xx, yy, xy are the upper layer's.
    """

    x_m: Float[ndarray, " nx"]
    y_m: Float[ndarray, " ny"]
    depths_m: Float[ndarray, " nz"]
    displacement_m: Float[ndarray, "nz 3 ny nx"]
    stress_pa: Float[ndarray, "nz 6 ny nx"]

    def stress(self, name: str) -> Float[ndarray, "nz ny nx"]:
        """One stress by its name in ``STRESSES`` [Pa]."""
        if name not in STRESSES:
            raise InputError(
                f"no stress is called {name!r}; there are {', '.join(STRESSES)}", code="unknown-name"
            )
        return self.stress_pa[:, STRESSES.index(name)]


def field_below(
    stack: Stack,
    pressure_pa: Field,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
    depths_m: Sequence[float] | Float[ndarray, " nz"],
    *,
    shear_x_pa: Field | None = None,
    shear_y_pa: Field | None = None,
    margin_m: float | None = None,
) -> StackField:
    """Return displacement and stress on planes under a surface load.

    Args:
        stack: Layers.
        pressure_pa: Pressure [Pa].
        x_m, y_m: Columns and rows of a regular grid [m].
        depths_m: Planes, 0 to the stack's thickness [m].
        shear_x_pa, shear_y_pa: Traction of the probe on the surface [Pa].
        margin_m: Unloaded strip to the grid's periodic image [m]; by default six thicknesses, at most twice
            the width.

    Returns:
        Field. With the load in the middle third of the grid, images cause errors of at most 3e-4 of the
        maximum pressure, and 0.5 % of the maximum displacement at the border.
    """
    grid = cells(x_m, y_m)
    nothing = np.zeros((grid.ny, grid.nx))
    loads = [nothing if q is None else q for q in (shear_x_pa, shear_y_pa)] + [pressure_pa]
    depths = np.asarray(depths_m, float)
    _check_loads(loads, nothing.shape)
    _check_depths(depths, stack)
    waves = spread(grid, _margin(stack, grid, margin_m))
    spectra = [waves.forward(load) for load in loads]
    slabs, levels = _cut_at(stack, depths)
    in_plane, across = climb(slabs, stack.below, waves.k)
    moves = np.empty((len(depths), len(MOVES), grid.ny, grid.nx))
    stresses = np.empty((len(depths), len(STRESSES), grid.ny, grid.nx))
    for i, level in enumerate(levels):
        material = slabs[level - 1].material if level else stack.layers[0].material
        moves_there, stresses_there = _on_plane(material, in_plane[level], across[level], waves, spectra)
        moves[i] = [waves.back(wave) for wave in moves_there]
        stresses[i] = [waves.back(wave) for wave in stresses_there]
    return StackField(x_m, y_m, depths, moves, stresses)


def _check_loads(loads: Sequence[Field], shape: tuple[int, ...]) -> None:
    for load in loads:
        if load.shape != shape or not np.all(np.isfinite(load)):
            raise InputError(
                f"a load is finite and has the grid's shape {shape}; this one has the shape "
                f"{load.shape} and {np.count_nonzero(~np.isfinite(load))} values that are not finite"
            )


def _check_depths(depths: ndarray, stack: Stack) -> None:
    inside = (depths >= 0.0) & (depths <= stack.thickness_m) & (depths < math.inf)
    if depths.ndim != 1 or not len(depths) or not inside.all():
        raise RangeError(
            f"depths {np.ravel(depths)[~np.ravel(inside)]} m lie outside the stack; give a list of "
            f"depths from 0 to {stack.thickness_m:g} m",
            code="outside-stack",
        )


def _margin(stack: Stack, grid: Cells, margin_m: float | None) -> float:
    if margin_m is not None and not 0.0 <= margin_m < math.inf:
        raise RangeError(f"the margin is {margin_m} m; give a number of m from 0 up")
    if margin_m is not None:
        return margin_m
    return min(MARGIN * stack.thickness_m, WIDTHS * max(grid.nx * grid.dx, grid.ny * grid.dy))


def _cut_at(stack: Stack, depths: Float[ndarray, " nz"]) -> tuple[list[Slab], list[int]]:
    """Slabs between interfaces and planes, and each plane's index."""
    faces = np.concatenate([[0.0], np.cumsum([slab.thickness_m for slab in stack.slabs])])
    nearest = faces[np.abs(depths[:, None] - faces).argmin(axis=1)]
    planes = np.where(np.abs(depths - nearest) <= SAME_PLANE * faces[-1], nearest, depths)
    cuts = np.unique(np.concatenate([faces, planes]))
    middles = (cuts[:-1] + cuts[1:]) / 2
    owners = np.searchsorted(faces, middles) - 1
    slabs = [
        Slab(stack.layers[owner].material, float(thickness))
        for owner, thickness in zip(owners, np.diff(cuts), strict=True)
    ]
    return slabs, [int(level) for level in np.searchsorted(cuts, planes)]


def _on_plane(
    material: Material, in_plane: Level, across: Level, waves: Waves, spectra: list[Wave]
) -> tuple[list[Wave], list[Wave]]:
    """Waves of displacement x, y, z and of the six stresses on a plane."""
    mu, nu = material
    n = nu / (1 - nu)
    R, CR = in_plane.transmission, in_plane.compliance @ in_plane.transmission
    r, cr = across.transmission[:, 0, 0], (across.compliance @ across.transmission)[:, 0, 0]
    on = waves.gather
    c, s, k = waves.cos, waves.sin, on(waves.k)
    q_x, q_y, p = spectra
    q_k, q_t = c * q_x + s * q_y, c * q_y - s * q_x
    kU = on(CR[:, 0, 0]) * (-1j * q_k) + on(CR[:, 0, 1]) * p
    kW = on(CR[:, 1, 0]) * (-1j * q_k) + on(CR[:, 1, 1]) * p
    kV = on(cr) * q_t
    s_zz = on(R[:, 1, 0]) * (1j * q_k) - on(R[:, 1, 1]) * p
    s_kz = -on(R[:, 0, 0]) * q_k - on(R[:, 0, 1]) * (1j * p)
    s_tz = -on(r) * q_t
    s_kk, s_tt = n * s_zz - 2 * mu / (1 - nu) * kU, n * s_zz - 2 * mu * n * kU
    s_kt = 1j * mu * kV
    u_x, u_y = (1j * c * kU - s * kV) / k, (1j * s * kU + c * kV) / k
    s_xx = c * c * s_kk + s * s * s_tt - 2 * c * s * s_kt
    s_yy = s * s * s_kk + c * c * s_tt + 2 * c * s * s_kt
    s_xy = c * s * (s_kk - s_tt) + (c * c - s * s) * s_kt
    s_xz, s_yz = c * s_kz - s * s_tz, s * s_kz + c * s_tz
    u_z = kW / k
    # The mean wave is averaged over directions, which removes odd parts.
    trace = -2 * n * R[:, 1, 1] - 2 * mu * (1 / (1 - nu) + n) * CR[:, 0, 1]
    s_xx[0, 0] = s_yy[0, 0] = waves.mean_wave(trace / 2) * p[0, 0]
    s_zz[0, 0] = waves.mean_wave(-R[:, 1, 1]) * p[0, 0]
    u_z[0, 0] = waves.mean_wave(CR[:, 1, 1] / waves.k) * p[0, 0]
    for u, s_z, q in ((u_x, s_xz, q_x), (u_y, s_yz, q_y)):
        u[0, 0] = waves.mean_wave((CR[:, 0, 0] + cr) / (2 * waves.k)) * q[0, 0]
        s_z[0, 0] = waves.mean_wave(-(R[:, 0, 0] + r) / 2) * q[0, 0]
    return [u_x, u_y, u_z], [s_xx, s_yy, s_zz, s_yz, s_xz, s_xy]
