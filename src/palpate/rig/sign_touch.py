"""A gentle touch before the first press of a run and after each change of tool: does the sensor feel it?

The probe goes down at the speed of the search for contact, until the force is a few times the threshold that
says contact, and back up. The force has to rise on the way down and to be gone afterwards, and to follow the
motion without a lag that its timestamps do not show (`force_lag`). What is felt on the way is the first that
the guard learns of the skin's stiffness, before any press goes deeper.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

from palpate.devices import ForceReached, Guard, Reason, Tripped
from palpate.rig.force_lag import LAGS_S, ForceLag, TouchRecord
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.rig import Rig

MM = 1e-3
TIMES = 3.0  # the contact threshold
LIMIT_SHARE = 0.5  # of the limit of force, at most
REST_S = 0.1  # in the air
PRESSED_S = 0.25  # at the deepest, so that a late force comes to rest as well
LAG_SLACK_S = 0.01  # in the time of a reported position
LAG_LOOKS_AS = (Reason.FORCE_DEAD, Reason.FORCE_IMPLAUSIBLE, Reason.FORCE_NOISE)
"""Reasons that a late force may have, since it does not fall at once on the way back."""
LEFT = 0.5  # of the touch's force that may be left in the air, by a skin that clings


@dataclass(frozen=True, slots=True)
class FeltTouch:
    """What a gentle touch felt.

    Attributes:
        force_n: at its deepest [N].
        left_n: back in the air [N].
        z_mm: of its deepest, below the expected surface [mm].
        lag_s, least_s, greatest_s: lag of the force behind the motion and its interval, see `ForceLag`; None
            where too little was measured [s].
    """

    force_n: float
    left_n: float
    z_mm: float
    lag_s: float | None = None
    least_s: float | None = None
    greatest_s: float | None = None


def touch_gently(rig: Rig, plan: RecordingPlan, guard: Guard) -> FeltTouch:
    """Touch the skin below the probe, which hangs in the air with its zero measured, and come back.

    Raises:
        Tripped: `FORCE_LAG`, the force follows the motion later than the rig states; the force does not rise
            on the way down, or does not fall on the way back; nothing was felt at all; or what any guarded
            motion raises.
    """
    record = TouchRecord(guard, rig.clock)
    with record.recorded():
        record.stand()
        try:
            felt = _down_and_back(rig, plan, guard, record)
        except Tripped as e:
            if e.reason in LAG_LOOKS_AS:
                record.stand()
                lag = record.lag()
                if lag is not None and lag.greatest_s < LAGS_S[-1]:  # and one that is held falls never
                    _check_lag(rig, lag)
            raise
    lag = record.lag()
    _check_lag(rig, lag)
    return felt if lag is None else replace(felt, **asdict(lag))


def _down_and_back(rig: Rig, plan: RecordingPlan, guard: Guard, record: TouchRecord) -> FeltTouch:
    wanted_n = min(TIMES * plan.threshold_N, LIMIT_SHARE * rig.limits.force_n)
    x, y, z = guard.position_m()
    if guard.force_n[2] > plan.threshold_N:
        raise Tripped(Reason.TOUCHED_EARLY, "the probe is in contact at the clearance already")
    lowest = (x, y, rig.origin_m[2] + plan.seek_mm * MM)
    speed = plan.seek_mm_s * MM
    reached = guard.towards(lowest, speed, ForceReached(wanted_n, any_way=True))
    record.stand()
    if reached and guard.force_n[2] <= plan.threshold_N:
        raise Tripped(
            Reason.FORCE_REVERSED,
            f"the touch was felt with {guard.force_n[2]:.2f} N along the press and "
            f"{math.hypot(*guard.force_n):.2f} N in all: the axes in the rig's file are wrong",
        )
    if not reached and guard.force_n[2] <= plan.threshold_N:  # a soft specimen may not carry more
        raise Tripped(
            Reason.NO_CONTACT,
            f"a touch of {plan.threshold_N:g} N was not felt down to {plan.seek_mm:g} mm below the expected "
            "surface; is the layer there, and does the force sensor feel anything?",
        )
    guard.learn_press()
    pressed_n, deepest = _mean_n(guard, PRESSED_S), guard.position_m()[2]
    record.stand()
    guard.away((x, y, z), speed)
    left_n = _mean_n(guard, REST_S)
    if abs(left_n) > max(LEFT * pressed_n, plan.threshold_N):
        raise Tripped(
            Reason.FORCE_DEAD,
            f"a touch of {pressed_n:.3f} N left {left_n:.3f} N in the air: the force did not fall when the "
            "probe was lifted; does the sensor follow what it touches?",
        )
    return FeltTouch(pressed_n, left_n, (deepest - rig.origin_m[2]) / MM)


def allowed_lag_s(rig: Rig) -> float:
    """Greatest lag of the force behind the motion that a rig's limits and stage explain [s]."""
    return rig.limits.force_latency_s + rig.stage.travel.latency_s + LAG_SLACK_S


def _check_lag(rig: Rig, lag: ForceLag | None) -> None:
    allowed_s = allowed_lag_s(rig)
    if lag is None or lag.least_s <= allowed_s:
        return
    raise Tripped(
        Reason.FORCE_LAG,
        f"the force follows the motion {lag.lag_s * 1e3:.0f} ms late ({lag.least_s * 1e3:.0f} to "
        f"{lag.greatest_s * 1e3:.0f} ms), although its timestamps are current; {allowed_s * 1e3:.0f} ms are "
        "allowed. Remove the filter or the queue between sensor and computer, or state the true "
        "force_latency_s in [limits]",
        {**asdict(lag), "allowed_s": allowed_s},
    )


def _mean_n(guard: Guard, seconds: float) -> float:
    """Mean normal force while the probe stands [N]."""
    samples = guard.wait(seconds)
    good = [guard.skin_n(one)[2] for one in samples if not one.fault]
    return sum(good) / len(good) if good else guard.force_n[2]
