"""Jog through the air that ends at contact: it goes back as soon as the force says so.

A sensor at the end of its range, or with an overload stop beside it, reads a constant force while the probe
goes on. So the force must also rise while the depth doubles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from palpate.core import Position, Wrench
from palpate.devices import Reason, Tripped
from palpate.devices.motion_guard import MotionGuard
from palpate.rig.mean_force import AirForce, Hand, contact_n

ONSET_N, ONSET_SIGMAS = 0.1, 20.0  # change of force that is contact for certain
AIR_SHARE = 0.25  # of that change, below which the probe was still in the air
GROWTH = 1.25  # least factor by which the force rises while the depth doubles
LEAST_M = 50e-6  # over which no growth is asked for
PERIODS = 3.0  # of the sensor, over which none is asked for either
CLEAR_M = 0.1e-3  # of air left between the probe and the contact that ended a way
FREE_STEP_M = 0.2e-3  # by which it goes on back, where backlash left it in contact
MAX_BACKLASH_M = 3e-3
LEVEL_M = 1e-6
_CONTACT = (Reason.FORCE_LIMIT, Reason.FORCE_DEAD, Reason.TOUCHED_EARLY)
_STANDS = (Reason.STAGE, Reason.STAGE_LATE, Reason.HARDWARE_STOP)  # where nothing more is to be moved


class FeltWay:
    """Change of the force along a way that began in the air.

    Attributes:
        began_m: way at which the force was last that of the air [m].

    Example:
        >>> way = FeltWay(noise_n=0.002)
        >>> for i in range(5):
        ...     way.take(0.1e-3 * i, 0.2 * i)  # 2 N/mm
        >>> way.began_m
        0.0
        >>> way.take(0.9e-3, 0.8)
        Traceback (most recent call last):
            ...
        palpate.devices.motion_limits.Tripped: the force stayed at 0.80 N ...
    """

    def __init__(self, noise_n: float, least_m: float = LEAST_M) -> None:
        self._least_m = max(LEAST_M, least_m)
        self._onset_n = max(ONSET_N, ONSET_SIGMAS * noise_n)
        self.began_m = self._level_m = 0.0
        self._level_n = 0.0

    def take(self, way_m: float, force_n: float) -> None:
        """Take the greatest force since the last call, at a way.

        Raises:
            Tripped: The force stays while the depth doubled (`FORCE_DEAD`).
        """
        if force_n < AIR_SHARE * self._onset_n:
            self.began_m, self._level_n = way_m, 0.0
        elif force_n >= max(self._onset_n, GROWTH * self._level_n):
            self._level_m, self._level_n = way_m, force_n
        more_m = way_m - self._level_m
        if self._level_n and more_m > max(self._least_m, self._level_m - self.began_m):
            raise Tripped(
                Reason.FORCE_DEAD,
                f"the force stayed at {force_n:.2f} N over {more_m * 1e3:.2f} mm in contact: the sensor is "
                "at the end of its range, or something beside it takes the load",
            )


def feel_way(guard: MotionGuard, target: Position, speed_m_s: float, hand: Hand) -> None:
    """Move from the air to a target; where contact ends that, go back into the air.

    Args:
        guard: Zeroed in the air.
        hand: What the guard moves and measures with.

    Raises:
        Tripped: A limit, or contact; the probe is back in the air unless the message says otherwise.
    """
    start, air = guard.position_m(), hand.felt_through(guard)
    way = FeltWay(air.noise_n, PERIODS * speed_m_s / hand.force.rate_hz)
    peak_n = felt_at_m = 0.0

    def feel(samples: Sequence[Wrench]) -> None:
        nonlocal peak_n
        good = [math.hypot(*guard.skin_n(one)) for one in samples if not one.fault]
        peak_n = max(good, default=peak_n)

    def look(at: Position, time_ns: int) -> None:
        nonlocal felt_at_m
        way.take(felt_at_m, peak_n)  # the force came before this position was asked for
        felt_at_m = math.dist(start, at)

    with guard.samples.subscribed(feel), guard.positions.subscribed(look):
        try:
            guard.towards(target, speed_m_s)
            return
        except Tripped as e:
            stopped = e
    far_m = math.dist(start, guard.position_m())
    if _stays(stopped) or (stopped.reason not in _CONTACT and way.began_m >= far_m):
        raise stopped
    share = max(min(way.began_m, far_m) - CLEAR_M, 0.0) / math.dist(start, target)
    x, y, z = (a + share * (b - a) for a, b in zip(start, target, strict=True))
    ended = guard.position_m()
    try:
        guard.away((x, y, z), speed_m_s, judged=False)
        _leave_contact(guard, start, speed_m_s, hand, air)
    except Tripped as e:
        hand.distrust_position()
        told = f"{stopped}; the probe did not go back into the air: {e}"
    except BaseException:  # as Ctrl-C: it stands in contact
        hand.distrust_position()
        raise
    else:
        back_m = math.dist(ended, guard.position_m())
        told = f"{stopped}; the probe went back by {back_m * 1e3:.2f} mm"
    raise Tripped(stopped.reason, told, stopped.numbers) from stopped


def _stays(stopped: Tripped) -> bool:
    """Whether nothing more is to be moved: a stage that stopped late, and knows where, may go back."""
    return stopped.reason in _STANDS and getattr(stopped.__cause__, "code", "") != "stop-ignored"


def _leave_contact(guard: MotionGuard, start: Position, speed_m_s: float, hand: Hand, air: AirForce) -> None:
    """Go on back in steps until the force is that of the air again, as far as the start.

    Where z has backlash, the stage moves before the probe does: from above, it goes up beyond the start.
    """
    now = hand.felt_through(guard)
    left_n = math.dist(now.force_n, air.force_n)
    goes_up = math.dist(start[:2], guard.position_m()[:2]) < LEVEL_M
    for _ in range(round(MAX_BACKLASH_M / FREE_STEP_M)):
        if left_n <= contact_n(now, air):
            return
        at = guard.position_m()
        share = min(FREE_STEP_M / max(math.dist(at, start), LEVEL_M), 1.0)
        x, y, z = (a + share * (b - a) for a, b in zip(at, start, strict=True))
        z = at[2] - FREE_STEP_M if goes_up else z
        if math.dist(at, (x, y, z)) < LEVEL_M:
            break
        guard.away((x, y, z), speed_m_s, judged=False)
        before_n, now = left_n, hand.felt_through(guard)
        left_n = math.dist(now.force_n, air.force_n)
        if left_n > before_n + contact_n(now, air):
            break
    if left_n > contact_n(now, air):
        raise Tripped(
            Reason.FORCE_NOISE,
            f"the force is still {left_n:.2f} N from that of the air: the stage does not move the probe, or "
            "the force sensor has changed; look at the rig before anything else moves",
        )
