"""The first motion of a rig that is set up: home, lead the probe over the skin, touch twice, and lift again.

A gentle touch shows the force sensor's axis and sign, and a known weight its scale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core import Clock, ForceSensor, InputError, Position, RangeError, Stage
from palpate.devices import Limits, Mounting
from palpate.devices.force_bias import Force
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.commissioning.felt_way import feel_way
from palpate.rig.commissioning.hand_motion import (
    FLAT_M,
    JOG_N,
    MAX_JOG_M,
    MAX_JOG_M_S,
    SAME_M,
    guard_from_air,
    has_room_to_lift,
    lift_clear,
    move_watched,
)
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.commissioning.setup_answers import Answers, Three, three_of
from palpate.rig.mean_force import AXES, CHANGED_N, PUSH, Hand, await_push, mean_force
from palpate.rig.rig_file import RigFile, open_part

MM = 1e3
LIFT_M = 5e-3  # above the surface, where the check begins
STEP = re.compile(r"\s*([xyz])\s*([+-]?\d+(?:\.\d+)?)\s*")
WHERE = (
    "Place over the skin's centre, less than 10 mm above it, in the stage's frame as [x, y, z] in mm (z goes "
    'into the skin). A step first, as in "x 5" or "z -0.5" [mm], is asked again; Enter where it hangs right'
)

HOLD = (
    "The controller releases the motors at rest, and a stage that was pushed then loses its position. Set "
    "$1=255 on it, so that they keep their current and stay warm"
)

Say = Callable[[str], None]
STEP_M = 0.05e-3
SPEED_M_S = 1e-3
TOUCH_N = 0.3  # a change of force, along any axis, that is contact
MAX_TOUCH_N = 2.0  # and one at which the move under way is stopped
MAX_REACH_M = 5e-3
AGREE_M = 0.3e-3  # between two touches
AGREE_SHARE = 0.5  # of the touch's force that may be left, or lie across its axis
G_M_S2 = 9.80665  # standard acceleration of free fall (CGPM 1901)
BLOCKS = 10
BLOCK_S = 0.2
ALLOWED_SHARE = 0.02  # by which a scale may be off without a factor
LOCAL_G_SHARE = 0.003  # free fall from pole to equator is within this of the standard value
MIN_ALONG = 0.95  # of a weight's force that must lie along the press


def first_touch(file: RigFile, homing: bool, answers: Answers, say: Say, clock: Clock) -> dict[str, Any]:
    """Home, go above the skin, touch, and lift to where the check begins.

    Args:
        file: what was answered, with stage, force and limits.
        homing: whether the stage homes on switches.
        answers, say: of whoever is asked and told.
        clock: time.

    Returns:
        Fields of the file that the touch gave: ``axes`` of the force sensor, ``origin_mm``, and the stage's
        ``reference`` where it has no switches. Besides, ``motors_hold``.

    Raises:
        Tripped: a touch or a motion that was not as it has to be; the stage stands.
        DeviceError, RangeError: a device, or a place outside the limits.
    """
    assert file.stage is not None  # as whoever asked made sure of
    assert file.force is not None
    assert file.limits is not None
    limits = file.limits.limits()
    with ExitStack() as opened:
        force = open_part("force", file.force, clock)
        opened.callback(force.close)
        say(PUSH)
        pushed_n = await_push(force, clock)
        homes = homing and answers.confirm("home", "Home the stage now, the probe free", True)
        stage = open_part("stage", file.stage, clock, "nowhere" if homes else "reference")
        opened.callback(stage.close)
        if not getattr(stage, "motors_hold", True) and answers.confirm("hold_motors", HOLD, False):
            stage.hold_motors()
        if homes:
            say("homing, on your word that the probe hangs free")
            home_clear(stage, force, Mounting(), clock, lifted=True)
        _lead_above(Hand(stage, force, _mounting_of(pushed_n), clock), limits, answers)
        reach_mm = answers.number(
            "reach_mm", "How far down to feel for the skin [mm]", 0.1, MAX_REACH_M * MM, 5.0
        )
        say("touching twice, gently")
        touch = touch_twice(stage, force, limits, clock, reach_mm / MM)
        _check_same_axis(pushed_n, touch.axes[2])
        found: dict[str, Any] = {"axes": list(touch.axes), "origin_mm": _mm(touch.surface_m)}
        say(f"skin at {found['origin_mm']} mm; a press is {touch.axes[2]} of the sensor")
        x, y, z = touch.surface_m
        stage.move_to((x, y, max(z - LIFT_M, limits.least_m[2])), limits.fastest_m_s(stage.travel))
        while stage.moving():
            clock.sleep(0.01)
        found["motors_hold"] = getattr(stage, "motors_hold", True)
        return found if homing else found | {"reference": _mm(stage.position_m())}


def _mounting_of(pushed_n: Force) -> Mounting:
    """Mounting in which a push, as the skin gives it, is compression; x and y are not known yet."""
    i = max(range(3), key=lambda k: abs(pushed_n[k]))
    x, y = (AXES[k] for k in range(3) if k != i)
    return Mounting((x, y, f"{'-' if pushed_n[i] < 0 else ''}{AXES[i]}"))


def _lead_above(hand: Hand, limits: Limits, answers: Answers) -> None:
    """Go to the place that is answered; a person may also lead the probe there in steps."""
    stage = hand.stage

    def take() -> bool:
        at = stage.position_m()
        answer = answers.ask("above_mm", WHERE, _mm(at))
        step = STEP.fullmatch(answer) if isinstance(answer, str) else None
        try:
            if step is None:
                x, y, z = three_of("above_mm", WHERE, answer)
                _go_above(hand, limits, (x / MM, y / MM, z / MM))
                return True
            _go_above(hand, limits, _stepped(at, limits, step[1], float(step[2]) / MM))
        except Tripped as e:
            if not answers.again(f"{e}; the stage stands at {_mm(stage.position_m())} mm"):
                raise
            return False
        if not answers.again(f"the stage stands at {_mm(stage.position_m())} mm"):
            raise InputError("above_mm is a step, which is for a person; give three numbers, as [0, 0, -5]")
        return False

    while not answers.until_good(take):
        pass


def _stepped(at: Position, limits: Limits, axis: str, far_m: float) -> Position:
    if abs(far_m) > MAX_JOG_M:
        raise RangeError(f"a step of {far_m * MM:g} mm; {MAX_JOG_M * MM:g} mm are the most at once")
    x, y, z = (a + far_m * (axis == name) for name, a in zip("xyz", at, strict=True))
    limits.check_target((x, y, z))
    return x, y, z


def _go_above(hand: Hand, limits: Limits, above: Three) -> None:
    """Aside first and then down, stopped by a change of force of 1 N from that of the air."""
    at = hand.stage.position_m()
    guard = guard_from_air(hand, limits, JOG_N)
    speed = min(MAX_JOG_M_S, limits.fastest_m_s(hand.stage.travel))
    for target in ((above[0], above[1], min(at[2], above[2])), above):
        if math.dist(guard.position_m(), target) > SAME_M:
            feel_way(guard, target, speed, hand)


def _check_same_axis(pushed_n: Force, axis: str) -> None:
    """Refuse a touch that was felt along another axis than the push by hand, or with another sign."""
    pushed = _mounting_of(pushed_n).axes[2]
    if pushed != axis:
        raise Tripped(
            Reason.FORCE_REVERSED,
            f"the push by hand was felt along the sensor's {pushed}, and the touch along its {axis}: push "
            "the probe's tip towards the stage, and check how the sensor is mounted",
        )


def _mm(at: Position) -> list[float]:
    return [round(MM * d, 3) + 0.0 for d in at]  # + 0.0: no minus zero


@dataclass(frozen=True, slots=True)
class SkinTouch:
    """What a touch showed.

    Attributes:
        axes: for `Mounting`: the third is the axis that felt the press, with the sign that makes compression
            positive. The other two are in the sensor's own order and signs, and not measured.
        surface_m: place of the stage at the touch [m].
        force_n: change of force along the press [N].
    """

    axes: tuple[str, str, str]
    surface_m: Position
    force_n: float


def touch_twice(stage: Stage, force: ForceSensor, limits: Limits, clock: Clock, reach_m: float) -> SkinTouch:
    """Touch twice from where the probe hangs, in steps of 0.05 mm, and lift again.

    It is first lifted until the force no longer changes, since a touch that begins in the skin agrees with
    the next one that does.

    Raises:
        RangeError: more than `MAX_REACH_M`.
        Tripped: nothing was felt, no axis stands out, the touches differ, or the force does not return.
    """
    if not 0 < reach_m <= MAX_REACH_M:
        raise RangeError(f"a touch over {reach_m * 1e3:g} mm; {MAX_REACH_M * 1e3:g} mm are the most")
    if not has_room_to_lift(stage, limits):
        raise Tripped(
            Reason.SOFT_LIMIT,
            f"the upper soft limit leaves less than {FLAT_M * 1e3:g} mm above the probe, and a lift by that "
            "much proves that it hangs in the air: hang it lower, or raise the limit (least_mm, z)",
        )
    lift_clear(Hand(stage, force, Mounting(), clock), limits)
    reach_m += FLAT_M
    first, second = (_touch(stage, force, limits, clock, reach_m) for _ in range(2))
    apart_m = abs(first.surface_m[2] - second.surface_m[2])
    if first.axes != second.axes or apart_m > AGREE_M:
        raise Tripped(
            Reason.FORCE_NOISE,
            f"two touches differ: {first.axes[2]} and {second.axes[2]}, {apart_m * 1e3:.2f} mm apart "
            f"({AGREE_M * 1e3:g} mm are allowed); is the probe fixed, and the sensor quiet?",
        )
    return second


def _touch(stage: Stage, force: ForceSensor, limits: Limits, clock: Clock, reach_m: float) -> SkinTouch:
    start, air = stage.position_m(), mean_force(force, Mounting(), clock)
    limits.check_target((start[0], start[1], start[2] + reach_m))
    speed = min(SPEED_M_S, limits.fastest_m_s(stage.travel))
    pressed = air
    at = start
    try:
        while math.dist(pressed.force_n, air.force_n) < TOUCH_N:
            if at[2] - start[2] >= reach_m - 1e-9:
                raise Tripped(
                    Reason.NO_CONTACT,
                    f"nothing was felt within {reach_m * 1e3:g} mm: the probe hangs higher than that, or the "
                    "force sensor is dead",
                )
            goal = min(at[2] + STEP_M, start[2] + reach_m)
            move_watched(stage, force, clock, (at[0], at[1], goal), speed, air.force_n, MAX_TOUCH_N)
            at = stage.position_m()
            pressed = mean_force(force, Mounting(), clock)
    finally:
        stage.move_to(start, speed)
        while stage.moving():
            clock.sleep(0.01)
    left_n = math.dist(mean_force(force, Mounting(), clock).force_n, air.force_n)
    change = np.subtract(pressed.force_n, air.force_n)
    touched_n = float(np.abs(change).max())
    if left_n > max(CHANGED_N, AGREE_SHARE * touched_n):
        raise Tripped(
            Reason.FORCE_NOISE,
            f"{left_n:.2f} N of a touch of {touched_n:.2f} N were left after the probe was lifted: the "
            "sensor drifts, or something else pushes it",
        )
    return SkinTouch(_axes(change), at, touched_n)


def _axes(change_n: np.ndarray) -> tuple[str, str, str]:
    """The sensor's axes for the skin's; the one that changed most is the press."""
    order = np.argsort(-np.abs(change_n))
    most, next_ = (abs(float(change_n[i])) for i in order[:2])
    if next_ > AGREE_SHARE * most:
        raise Tripped(
            Reason.FORCE_NOISE,
            f"the touch changed the sensor's axes by {', '.join(f'{f:.2f}' for f in change_n)} N: none of "
            "them lies along the press; turn the sensor so that one does",
        )
    normal = int(order[0])
    x, y = (name for i, name in enumerate("xyz") if i != normal)
    return x, y, ("-" if change_n[normal] < 0 else "") + "xyz"[normal]


@dataclass(frozen=True, slots=True)
class WeighingResult:
    """What a known weight showed.

    Attributes:
        expected_n, read_n: force of the weight, and the change that the sensor read [N].
        factor: true over read.
        uncertainty: of the factor, for 95 %.
    """

    expected_n: float
    read_n: float
    factor: float
    uncertainty: float

    @property
    def agrees(self) -> bool:
        """Whether the sensor's scale is right within 2 %, or within the uncertainty where that is more."""
        return abs(self.factor - 1.0) <= max(ALLOWED_SHARE, self.uncertainty)


def weigh(
    force: ForceSensor,
    axis: str,
    clock: Clock,
    mass_g: float,
    mass_tolerance_g: float,
    lay: Callable[[], None],
) -> WeighingResult:
    """Compare a known weight with the change of force that it makes.

    Args:
        axis: of the sensor, along which the weight acts; the last letter counts.
        mass_g, mass_tolerance_g: of the weight, and its half-width [g].
        lay: returns once the weight lies on the sensor, or hangs from it.

    Raises:
        InputError: its force was not felt along the press.
        RangeError: it is heavier than the sensor's range.
    """
    expected_n = mass_g * 1e-3 * G_M_S2
    normal = "xyz".index(axis[-1])
    if expected_n > force.range_n[normal]:
        raise RangeError(
            f"{mass_g:g} g weigh {expected_n:.2f} N, and the sensor measures to {force.range_n[normal]:g} N; "
            "take a lighter weight"
        )
    before, before_u = _blocks(force, clock)
    lay()
    after, after_u = _blocks(force, clock)
    change = np.subtract(after, before)
    read_n = float(abs(change[normal]))
    if read_n < MIN_ALONG * float(np.linalg.norm(change)) or read_n < 0.05 * expected_n:
        raise InputError(
            f"the weight of {expected_n:.3f} N changed the force by {', '.join(f'{c:.3f}' for c in change)} "
            "N; it has to act along the press, upright: lay it on or hang it so, and begin anew"
        )
    factor = expected_n / read_n
    half = 2.0 * math.hypot(before_u[normal], after_u[normal]) / read_n
    share = math.sqrt(half**2 + (mass_tolerance_g / mass_g) ** 2 + LOCAL_G_SHARE**2)
    return WeighingResult(expected_n, read_n, factor, factor * share)


def _blocks(force: ForceSensor, clock: Clock) -> tuple[Force, Force]:
    """Mean of some blocks of samples and its standard error, along each axis [N]."""
    means = []
    for _ in range(BLOCKS):
        means.append(mean_force(force, Mounting(), clock).force_n)
        clock.sleep(BLOCK_S - 0.1)
    x, y, z = np.mean(means, axis=0).tolist()
    ux, uy, uz = (np.std(means, axis=0, ddof=1) / math.sqrt(BLOCKS)).tolist()
    return (x, y, z), (ux, uy, uz)
