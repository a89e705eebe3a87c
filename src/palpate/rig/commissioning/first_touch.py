"""The first motion of a rig that is set up: home, lead the probe over the skin, touch, and lift again."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from palpate.core import Clock, ForceSensor, InputError, Position, RangeError, Stage
from palpate.devices import Limits, Mounting
from palpate.devices.force_bias import Force
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.commissioning.force_touch import MAX_REACH_M, touch_twice
from palpate.rig.commissioning.hand_motion import (
    AXES,
    JOG_N,
    LIFT_SPEED_M_S,
    MAX_JOG_M,
    MAX_JOG_M_S,
    PUSH,
    await_push,
    guard_from_air,
    home_clear,
    hop_to,
)
from palpate.rig.commissioning.setup_answers import Answers, Three, confirm, number, three_of, until_good
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
        homes = homing and confirm(answers, "home", "Home the stage now, the probe free", True)
        stage = open_part("stage", file.stage, clock, "nowhere" if homes else "reference")
        opened.callback(stage.close)
        if not getattr(stage, "motors_hold", True) and confirm(answers, "hold_motors", HOLD, False):
            stage.hold_motors()
        if homes:
            say("homing, on your word that the probe hangs free")
            home_clear(stage, force, Mounting(), clock, lifted=True)
        _lead_above(stage, force, _mounting_of(pushed_n), limits, clock, answers)
        reach_mm = number(
            answers, "reach_mm", "How far down to feel for the skin [mm]", 0.1, MAX_REACH_M * MM, 5.0
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


def _lead_above(
    stage: Stage, force: ForceSensor, mounting: Mounting, limits: Limits, clock: Clock, answers: Answers
) -> None:
    """Go to the place that is answered; a person may also lead the probe there in steps."""

    def take() -> bool:
        at = stage.position_m()
        answer = answers.ask("above_mm", WHERE, _mm(at))
        step = STEP.fullmatch(answer) if isinstance(answer, str) else None
        try:
            if step is None:
                x, y, z = three_of("above_mm", WHERE, answer)
                _go_above(stage, force, mounting, limits, clock, (x / MM, y / MM, z / MM))
                return True
            target = _stepped(at, limits, step[1], float(step[2]) / MM)
            _go_above(stage, force, mounting, limits, clock, target)
        except Tripped as e:
            if not answers.again(f"{e}; the stage stands at {_mm(stage.position_m())} mm"):
                raise
            return False
        if not answers.again(f"the stage stands at {_mm(stage.position_m())} mm"):
            raise InputError("above_mm is a step, which is for a person; give three numbers, as [0, 0, -5]")
        return False

    while not until_good(answers, take):
        pass


def _stepped(at: Position, limits: Limits, axis: str, far_m: float) -> Position:
    if abs(far_m) > MAX_JOG_M:
        raise RangeError(f"a step of {far_m * MM:g} mm; {MAX_JOG_M * MM:g} mm are the most at once")
    x, y, z = (a + far_m * (axis == name) for name, a in zip("xyz", at, strict=True))
    limits.check_target((x, y, z))
    return x, y, z


def _go_above(
    stage: Stage, force: ForceSensor, mounting: Mounting, limits: Limits, clock: Clock, above: Three
) -> None:
    """Aside first and then down, stopped by a change of force of 1 N from that of the air."""
    at = stage.position_m()
    guard = guard_from_air(stage, force, mounting, limits, clock, JOG_N)
    speed = min(MAX_JOG_M_S, limits.fastest_m_s(stage.travel))
    try:
        for target in ((above[0], above[1], min(at[2], above[2])), above):
            if any(abs(a - b) > 1e-6 for a, b in zip(stage.position_m(), target, strict=True)):
                guard.towards(target, speed)
    except Tripped:  # perhaps in the skin
        x, y, z = stage.position_m()
        if z > at[2]:
            hop_to(stage, clock, (x, y, at[2]), LIFT_SPEED_M_S)
        raise


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
