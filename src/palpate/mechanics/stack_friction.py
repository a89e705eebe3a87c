"""Coulomb friction on a stack: an indenter that presses already is shifted along the surface.

With the pressure p held, tractions q = (q_x, q_y) of the probe on the skin minimise 1/2 q.G q - q.s over |q|
<= mu p: where the skin sticks it moves by the shift s, elsewhere it lags behind and q has its limit. The
shift is made in one go from no shear. The sinking that q adds under the probe, nothing at nu = 1/2 on a
half-space, is left out, as Cattaneo and Mindlin leave it out.

Reference: K. L. Johnson, Contact Mechanics (1985), sec. 7.2, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from palpate.core.axes import Field, Mask
from palpate.core.errors import InputError, RangeError
from palpate.mechanics.stack_contact import StackContact
from palpate.mechanics.stack_influence import tangential_influence, tangential_resistance
from palpate.mechanics.surface_grid import cells

TOLERANCE = 1e-4  # of the shift: how far sticking skin may lag behind the probe
FORCE_TOLERANCE = 1e-4  # of the force asked for
AT_LIMIT = 1 - 1e-9  # of the limit: a traction that rounding alone keeps from it
STEPS = 1000
SHIFTS = 50

Pair = Float[ndarray, "2"]
Fields = Float[ndarray, "2 ny nx"]


@dataclass(frozen=True, slots=True)
class StackShear:
    """What a shift of the indenter does along the surface, on the grid of its contact, SI.

    Attributes:
        contact: the contact that was sheared.
        friction: coefficient of friction.
        shear_pa: traction of the probe on the skin along x and y ``[2 ny nx]`` [Pa].
        moved_m: displacement of the surface under it along x and y ``[2 ny nx]`` [m].
        sticking: the touching cells that go with the probe ``[ny nx]``; the others slip.
        force_n: of the probe on the skin along x and y [N].
        shift_m: of the probe along x and y [m].
    """

    contact: StackContact
    friction: float
    shear_pa: Fields
    moved_m: Fields
    sticking: Mask
    force_n: Pair
    shift_m: Pair


def shear_stack(
    contact: StackContact,
    friction: float,
    *,
    shift_m: tuple[float, float] | None = None,
    force_n: tuple[float, float] | None = None,
) -> StackShear:
    """Shift the indenter of a contact along the surface, by a distance or by a force.

    Args:
        contact: of the indenter, with some force.
        friction: Coulomb's coefficient, positive.
        shift_m: of the probe along x and y [m]; or
        force_n: of the probe on the skin along x and y, below friction times the normal force [N].

    Raises:
        InputError: not exactly one of shift and force, or one that is not finite.
        RangeError: a contact without force, a friction that is not positive, or a force at which all slips.
    """
    if not contact.force_n > 0.0:
        raise RangeError(f"a contact of {contact.force_n} N carries no shear; press with more than 0 N")
    if not 0.0 < friction < math.inf:
        raise RangeError(f"the coefficient of friction is {friction}; give a positive number")
    given = shift_m if force_n is None else force_n
    if (shift_m is None) == (force_n is None) or given is None or not all(map(math.isfinite, given)):
        raise InputError("give exactly one of shift_m and force_n, as two finite numbers along x and y")
    problem = _Problem(contact, friction)
    if force_n is None:
        shift = np.asarray(shift_m, float)
        return problem.result(shift, problem.solve(shift, problem.none, problem.limit))
    greatest = friction * contact.force_n
    if not math.hypot(*force_n) < greatest:
        raise RangeError(
            f"a force of {math.hypot(*force_n):g} N makes the whole contact slip; give less than friction "
            f"times the normal force, {greatest:g} N"
        )
    return problem.result(*_shift_for(problem, np.asarray(force_n, float)))


class _Problem:
    """One contact's influence and limits."""

    def __init__(self, contact: StackContact, friction: float) -> None:
        self.contact, self.friction = contact, friction
        self.grid = cells(contact.x_m, contact.y_m)
        self.limit = friction * contact.pressure_pa
        self.none = np.zeros((2, self.grid.ny, self.grid.nx))
        self._influence = tangential_influence(contact.stack, self.grid)
        self._resistance = tangential_resistance(contact.stack, self.grid)
        self.stiffest = float(self._resistance.spectra[0].max())

    def yielding(self, q: Fields) -> Fields:
        """Displacement of the surface [m] under tractions [Pa]."""
        return self._influence.apply_pair(q)

    def resisting(self, u: Fields) -> Fields:
        """About its inverse."""
        return np.stack([self._resistance.apply(0, part) for part in u])

    def force(self, q: Fields) -> Pair:
        """Sum of the tractions [N]."""
        return q.sum(axis=(1, 2)) * self.grid.area_m2

    def solve(self, shift: Pair, q: Fields, limit: Field) -> Fields:
        """Tractions [Pa] at a shift [m], from a guess: conjugate gradients on what may still change.

        A slipping traction turns on a circle. The smaller the circle, the more a turn costs: its bend stands
        beside the stiffness of the skin.
        """
        touching = self.contact.touching
        q = _limited(q, limit)
        u = self.yielding(q)
        along, gradient, gain = self.none, self.none, np.inf
        for _ in range(STEPS):
            lag = np.where(touching, shift[:, None, None] - u, 0.0)
            held = _held(lag, q, limit)
            before, gradient = gradient, _without(held, lag)
            if np.abs(gradient).max() <= TOLERANCE * math.hypot(*shift):
                return q
            rising = (lag * held).sum(axis=0)
            bend = np.divide(rising, limit, out=np.zeros_like(limit), where=rising > 0.0)
            firm = 1 / np.sqrt(1 + bend * self.stiffest)
            turned = _without(held, firm * self.resisting(firm * gradient) * touching)
            conjugate = max(0.0, float((turned * (gradient - before)).sum())) / gain
            along = _without(held, turned + conjugate * along)
            gain = float((turned * gradient).sum())
            curved = self.yielding(along) + bend * along
            length = float((gradient * along).sum() / (curved * along).sum())
            q = _limited(q + length * along, limit)
            u = self.yielding(q)
        raise RangeError(f"the shear did not settle in {STEPS} steps; give a finer grid or another shift")

    def result(self, shift: Pair, q: Fields) -> StackShear:
        """The tractions and what they do."""
        sticking = self.contact.touching & (np.hypot(*q) < self.limit * AT_LIMIT)
        return StackShear(self.contact, self.friction, q, self.yielding(q), sticking, self.force(q), shift)


def _held(lag: Fields, q: Fields, limit: Field) -> Fields:
    """Unit vectors along the tractions that are at their limit and would rise; zero elsewhere."""
    size = np.hypot(*q)
    outward = np.divide(q, size, out=np.zeros_like(q), where=size > 0.0)
    rising = (size >= limit * AT_LIMIT) & ((lag * outward).sum(axis=0) > 0.0)
    return np.where(rising, outward, 0.0)


def _without(held: Fields, direction: Fields) -> Fields:
    return direction - (direction * held).sum(axis=0) * held


def _limited(q: Fields, limit: Field) -> Fields:
    size = np.hypot(*q)
    return q * np.divide(limit, size, out=np.ones_like(size), where=size > limit)


def _shift_for(problem: _Problem, force: Pair) -> tuple[Pair, Fields]:
    """The shift of a force, by Broyden's secants from the stiffness without slip."""
    scale = problem.contact.depth_m
    endless = np.where(problem.contact.touching, np.inf, 0.0)
    stuck = [problem.solve(scale * unit, problem.none, endless) for unit in np.eye(2)]
    yielding = scale * np.linalg.inv(np.stack([problem.force(q) for q in stuck], axis=1))
    shift = yielding @ force
    q = problem.solve(shift, problem.none, problem.limit)
    missing = force - problem.force(q)
    for _ in range(SHIFTS):
        if math.hypot(*missing) <= FORCE_TOLERANCE * math.hypot(*force):
            return shift, q
        step = yielding @ missing
        shift = shift + step
        q = problem.solve(shift, q, problem.limit)
        before, missing = missing, force - problem.force(q)
        turned = yielding @ (before - missing)
        yielding = yielding + np.outer(step - turned, step @ yielding) / (step @ turned)
    raise RangeError(
        f"no shift was found for a force of {math.hypot(*force):g} N, within {FORCE_TOLERANCE:g}; give one "
        f"further from the limit of {problem.friction * problem.contact.force_n:g} N"
    )
