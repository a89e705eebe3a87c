"""A gentle touch before the first press of a run and after each change of tool: does the sensor feel it?

The probe goes down at the speed of the search for contact, until the force is a few times the threshold that
says contact, and back up. The force has to rise on the way down and to be gone afterwards. What is felt on
the way is the first that the guard learns of the skin's stiffness, before any press goes deeper.
"""

from __future__ import annotations

from dataclasses import dataclass

from palpate.devices import ForceReached, Guard, Reason, Tripped
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.rig import Rig

MM = 1e-3
TIMES = 3.0  # the contact threshold
LIMIT_SHARE = 0.5  # of the limit of force, at most
REST_S = 0.1
LEFT = 0.5  # of the touch's force that may be left in the air, by a skin that clings


@dataclass(frozen=True, slots=True)
class FeltTouch:
    """What a gentle touch felt.

    Attributes:
        force_n: at its deepest [N].
        left_n: back in the air [N].
        z_mm: of its deepest, below the expected surface [mm].
    """

    force_n: float
    left_n: float
    z_mm: float


def touch_gently(rig: Rig, plan: RecordingPlan, guard: Guard) -> FeltTouch:
    """Touch the skin below the probe, which hangs in the air with its zero measured, and come back.

    Raises:
        Tripped: the force does not rise on the way down, or does not fall on the way back; nothing was felt
        at
            all; or what any guarded motion raises.
    """
    wanted_n = min(TIMES * plan.threshold_N, LIMIT_SHARE * rig.limits.force_n)
    x, y, z = guard.position_m()
    if guard.force_n[2] > plan.threshold_N:
        raise Tripped(Reason.TOUCHED_EARLY, "the probe is in contact at the clearance already")
    lowest = (x, y, rig.origin_m[2] + plan.seek_mm * MM)
    speed = plan.seek_mm_s * MM
    reached = guard.towards(lowest, speed, ForceReached(wanted_n))
    if not reached and guard.force_n[2] <= plan.threshold_N:  # a soft specimen may not carry more
        raise Tripped(
            Reason.NO_CONTACT,
            f"a touch of {plan.threshold_N:g} N was not felt down to {plan.seek_mm:g} mm below the expected "
            f"surface; is "
            "the layer there, and does the force sensor feel anything?",
        )
    guard.learn_press()
    pressed_n, deepest = _mean_n(guard, REST_S), guard.position_m()[2]
    guard.away((x, y, z), speed)
    left_n = _mean_n(guard, REST_S)
    if abs(left_n) > max(LEFT * pressed_n, plan.threshold_N):
        raise Tripped(
            Reason.FORCE_DEAD,
            f"a touch of {pressed_n:.3f} N left {left_n:.3f} N in the air: the force did not fall when the "
            f"probe "
            "was lifted; does the sensor follow what it touches?",
        )
    return FeltTouch(pressed_n, left_n, (deepest - rig.origin_m[2]) / MM)


def _mean_n(guard: Guard, seconds: float) -> float:
    """Mean normal force while the probe stands [N]."""
    samples = guard.wait(seconds)
    good = [guard.skin_n(one)[2] for one in samples if not one.fault]
    return sum(good) / len(good) if good else guard.force_n[2]
