"""Contact of an indenter with the pad: pressure, then friction.

The layers are unbounded along x and y, so a contact is solved on a grid around the probe's axis. Cells are
refined by powers of two for narrow contacts.

Indenters of NUSense: parsing, and gap to the pad.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, Field, Float, InputError, Pose, PressHistory, Probe, RangeError, ndarray
from palpate.mechanics.layers import contact_solver
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.stack import Stack
from palpate.mechanics.layers.stack_friction import shear_stack

EDGE_RADIUS_M = 2e-3  # edge radius of the long tip (assumed)
ROUNDED = 0.1  # rim radius of a flat tip over its radius (assumed)

WORDS = {
    "sphere": "sphere:DIAMETER_MM",
    "punch": "punch:DIAMETER_MM",
    "edge": "edge:LENGTH_MM[:TURN_DEG]",
    "two-points": "two-points:DIAMETER_MM:APART_MM[:TURN_DEG]",
}
COUNTS = {"sphere": (1, 1), "punch": (1, 1), "edge": (1, 2), "two-points": (2, 3)}
NAMES = {"round": "sphere:10", "flat": "punch:10"}
MAX_MM = 60.0

Axis = Float[ndarray, " _"]


def parse_indenter(words: str) -> Probe:
    """Parse an indenter: ``round`` and ``flat`` (tips of 5 mm radius), ``edge:30:60``, ``two-points:4:12``.

    Example:
        >>> parse_indenter("round").radius_m
        0.005
    """
    shape, *sizes = NAMES.get(words, words).split(":")
    low, high = COUNTS.get(shape, (1, 0))
    try:
        numbers = [float(size) for size in sizes]
    except ValueError:
        numbers = []
    turns = len(numbers) == high and high > low
    lengths = numbers[:-1] if turns else numbers
    if not (low <= len(numbers) <= high and all(0 < n <= MAX_MM for n in lengths)) or not all(
        math.isfinite(n) for n in numbers
    ):
        raise InputError(
            f"indenter {words!r}; NUSense knows {', '.join([*NAMES, *WORDS.values()])}, sizes above 0 to "
            f"{MAX_MM:g} mm",
            code="unknown-name",
        )
    turn = math.radians(numbers[-1]) if turns else 0.0
    if shape == "edge":
        return Probe("cylinder", EDGE_RADIUS_M, 1e-3 * numbers[0], turn)
    return Probe(shape, 0.5e-3 * numbers[0], 1e-3 * lengths[1] if len(lengths) > 1 else 0.0, turn)


def gap_under(probe: Probe, x_m: Axis, y_m: Axis) -> Field:
    """Return the height of a probe over the flat pad at first touch, with its axis at 0 [m]."""
    if probe.tilt_rad:
        raise InputError(
            "an indenter that leans on NUSense is not modelled; hold it upright", code="inclined-indenter"
        )
    R = probe.radius_m
    if probe.shape == "sphere":
        return contact_solver.sphere(x_m, y_m, R)
    if probe.shape == "punch":
        return contact_solver.flat_punch(x_m, y_m, R, ROUNDED * R)
    if probe.shape == "cylinder":
        return contact_solver.lying_cylinder(x_m, y_m, R, probe.length_m, probe.turn_rad)
    if probe.shape == "two-points":
        dx, dy = (probe.length_m / 2 * f(probe.turn_rad) for f in (math.cos, math.sin))
        return contact_solver.balls(x_m, y_m, R, [(-dx, -dy, 0.0), (dx, dy, 0.0)])
    raise InputError(
        f"NUSense does not know a probe of the shape {probe.shape!r}; {', '.join(WORDS)} it does"
    )


def reaches(probe: Probe, depth_m: float) -> tuple[float, float]:
    """Return half the sides of a box around any contact at a depth [m]."""
    if probe.shape == "punch":
        return probe.radius_m, probe.radius_m
    wide = math.sqrt(2 * probe.radius_m * min(depth_m, probe.radius_m))
    x, y = (abs(probe.length_m / 2 * f(probe.turn_rad)) for f in (math.cos, math.sin))
    return wide + x, wide + y


def steepness(probe: Probe) -> float:
    """Return the exponent of force over depth in the lightest touch."""
    return {"punch": 1.0, "cylinder": 1.1}.get(probe.shape, 1.5)


def is_round(probe: Probe) -> bool:
    """Return whether a probe is rotationally symmetric."""
    return bool(np.isclose(probe.length_m, 0.0))


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
