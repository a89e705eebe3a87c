"""Contact of an indenter with the pad: pressure, then friction.

The layers are unbounded along x and y, so a contact is solved on a grid around the probe's axis. Cells are
refined by powers of two for narrow contacts.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, Float, InputError, Pose, PressHistory, Probe, RangeError, ndarray
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.stack import Stack
from palpate.mechanics.layers.stack_friction import shear_stack
from palpate.sensors.nusense.pad_indenters import gap_under, is_round, reaches, steepness

PATTERN_CELL_M = 0.4e-3
HALVINGS = 4  # maximum halvings of that cell
SIDE = 96  # grid side of a round contact, in cells
BLOCK = 32  # grid increment of a long contact, in cells
ROOM = 1.15  # grid size over the contact's reach
LIGHTEST = 1.2  # growth factor of a depth that the cells do not resolve
HELD = 0.98  # fraction of the friction limit beyond which a load slides
MODEL = "rigid indenter, bonded linear layers, small strain, Coulomb friction after the normal press"

Columns = Float[ndarray, " nx"]
Rows = Float[ndarray, " ny"]


class RelaxedPress(NamedTuple):
    """Press of the relaxed pad, and the load's scale where cells only resolve a deeper one."""

    solved: StackContact
    scale: float


@lru_cache(maxsize=64)
def grid_about(probe: Probe, depth_m: float) -> tuple[Columns, Rows]:
    """Return cells around a probe's axis that hold its contact [m]."""
    if is_round(probe):
        half = ROOM * max(reaches(probe, depth_m))
        cell = PATTERN_CELL_M / 2
        while cell > PATTERN_CELL_M / 2**HALVINGS and SIDE * cell / 4 >= half:
            cell /= 2
        counts = (SIDE, SIDE)
    else:
        cell = PATTERN_CELL_M / 2
        wide, high = (2 * (ROOM * reach / cell + 4) for reach in reaches(probe, depth_m))
        counts = (BLOCK * math.ceil(wide / BLOCK), BLOCK * math.ceil(high / BLOCK))
    x, y = ((np.arange(count) + 0.5 - count / 2) * cell for count in counts)
    return x, y


@lru_cache(maxsize=128)
def relaxed_press(stack: Stack, probe: Probe, depth_m: float) -> RelaxedPress:
    """Press the relaxed pad to a depth above 0 [m] (cached)."""
    try:
        return RelaxedPress(_pressed(stack, probe, depth_m), 1.0)
    except RangeError:
        deeper = _lightest_m(stack, probe, depth_m)
        return RelaxedPress(_pressed(stack, probe, deeper), (depth_m / deeper) ** steepness(probe))


def _pressed(stack: Stack, probe: Probe, depth_m: float) -> StackContact:
    x, y = grid_about(probe, depth_m)
    return press_stack(stack, gap_under(probe, x, y), x, y, depth_m=depth_m)


def _lightest_m(stack: Stack, probe: Probe, depth_m: float) -> float:
    """Smallest resolved depth from a depth on [m]."""
    whole = stack.thickness_m / 4
    trial, last = depth_m, RangeError("no depth")
    while trial < whole:
        trial *= LIGHTEST if trial > whole / 100 else 2 * LIGHTEST
        try:
            _pressed(stack, probe, trial)
            return trial
        except RangeError as error:
            last = error
    raise last


def pad_contact(stack: Stack, friction: float, probe: Probe, pose: Pose, history: PressHistory) -> Contact:
    """Return the contact of a probe at a pose.

    A viscoelastic pad multiplies the relaxed tractions by its stiffening. The probe is pressed, then shifted
    monotonically to the last point of the path or the lateral force; beyond friction it slides.
    """
    if not pose.depth_m > 0:
        return _nothing(probe, pose, history)
    relaxed = relaxed_press(stack, probe, pose.depth_m)
    solved, scale = relaxed.solved, relaxed.scale * history.stiffening
    shear, lateral, moment = _sheared(stack, friction, probe, pose.depth_m, relaxed, history)
    contact = solved.as_contact(probe, pose)
    return replace(
        contact,
        x_m=pose.x_m + solved.x_m,
        y_m=pose.y_m + solved.y_m,
        pressure_pa=solved.pressure_pa * scale,
        displacement_m=solved.displacement_m * relaxed.scale,
        force_n=solved.force_n * scale,
        radius_m=contact.radius_m * relaxed.scale ** (1 / 3),
        model=MODEL,
        shear_pa=shear,
        lateral_n=lateral,
        moment_nm=moment,
        history=history,
    )


def _sheared(
    stack: Stack, friction: float, probe: Probe, depth_m: float, relaxed: RelaxedPress, history: PressHistory
) -> tuple[Float[ndarray, "2 ny nx"] | None, tuple[float, float], float]:
    """Shear [Pa], force [N], and moment [N m] of the probe on the pad."""
    scale = relaxed.scale * history.stiffening
    if history.lateral_n is not None:
        load = (history.lateral_n[0] / scale, history.lateral_n[1] / scale)
        if not all(map(math.isfinite, load)):
            raise InputError(f"the lateral load {history.lateral_n} N is not finite")
        if load == (0.0, 0.0):
            return None, (0.0, 0.0), 0.0
        if math.hypot(*load) >= HELD * friction * relaxed.solved.force_n:
            return _sliding(friction, relaxed.solved, load, scale)
        q, force, moment = _stuck(stack, friction, probe, depth_m, load, None)
    elif history.path_m and history.path_m[-1] != (0.0, 0.0):
        if not all(map(math.isfinite, history.path_m[-1])):
            raise InputError(f"the path's last place {history.path_m[-1]} m is not finite")
        q, force, moment = _stuck(stack, friction, probe, depth_m, None, history.path_m[-1])
    else:
        return None, (0.0, 0.0), 0.0
    return q * scale, (force[0] * scale, force[1] * scale), moment * scale


@lru_cache(maxsize=64)
def _stuck(
    stack: Stack,
    friction: float,
    probe: Probe,
    depth_m: float,
    load_n: tuple[float, float] | None,
    shift_m: tuple[float, float] | None,
) -> tuple[Float[ndarray, "2 ny nx"], tuple[float, float], float]:
    solved = relaxed_press(stack, probe, depth_m).solved
    sheared = (
        shear_stack(solved, friction, force_n=load_n)
        if load_n is not None
        else shear_stack(solved, friction, shift_m=shift_m)
    )
    return sheared.shear_pa, (float(sheared.force_n[0]), float(sheared.force_n[1])), sheared.moment_nm


def _sliding(
    friction: float, solved: StackContact, load: tuple[float, float], scale: float
) -> tuple[Float[ndarray, "2 ny nx"], tuple[float, float], float]:
    size = math.hypot(*load)
    along = np.array(load) / size
    q = friction * solved.pressure_pa * scale
    force = friction * solved.force_n * scale * along
    return along[:, None, None] * q, (float(force[0]), float(force[1])), 0.0


def _nothing(probe: Probe, pose: Pose, history: PressHistory) -> Contact:
    x, y = ((np.arange(SIDE) + 0.5 - SIDE / 2) * PATTERN_CELL_M / 2 for _ in range(2))
    zero = np.zeros((SIDE, SIDE))
    return Contact(
        pose.x_m + x, pose.y_m + y, zero, zero, zero > 0, 0.0, 0.0, probe, pose, MODEL, history=history
    )


def greatest_depth_m(stack: Stack, probe: Probe, max_depth_m: float, max_force_n: float) -> float:
    """Return the maximum depth within a depth and a force limit [m]."""
    if relaxed_press(stack, probe, max_depth_m).solved.force_n <= max_force_n:
        return max_depth_m
    low, high = 0.0, max_depth_m
    for _ in range(12):
        middle = (low + high) / 2
        press = relaxed_press(stack, probe, middle)
        if press.solved.force_n * press.scale <= max_force_n:
            low = middle
        else:
            high = middle
    return low
