"""One straight move under watch: on its path, arrived, or stopped where it was not sent."""

from __future__ import annotations

import math

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError
from palpate.rig.real.grbl_lines import State, Status
from palpate.rig.real.grbl_machine import Machine
from palpate.rig.real.grbl_spec import S_PER_MIN

Millimetres = tuple[float, float, float]
_REPORTED_MM = 0.001  # resolution of a status report
_UNDER_WAY = {State.IDLE, State.RUN, State.JOG}


class Journey:
    """A move from `start_mm` to `target_mm` in machine coordinates.

    Arrived means: its line was answered, the controller is Idle, and the place is the target. Idle alone is
    not: it shows during a dwell and before a line was read.

    Args:
        start_mm, target_mm: [mm].
        feed_mm_min: its speed [mm/min].
        machine: for tolerance and steps.
        still_s: how long it may stay where it is, short of the target, before that is a fault [s].
        now_ns: when it began.
        beyond_mm: how far past the target it may slow down, where what ends it is not its target [mm].
    """

    def __init__(
        self,
        start_mm: Millimetres,
        target_mm: Millimetres,
        feed_mm_min: float,
        machine: Machine,
        still_s: float,
        now_ns: int,
        beyond_mm: float = 0.0,
    ) -> None:
        self.start_mm, self.target_mm, self.feed_mm_min = start_mm, target_mm, feed_mm_min
        self.tolerance_mm = machine.tolerance_mm
        grain_mm = max(_REPORTED_MM, 1.0 / min(machine.steps_per_mm))
        # A creeping axis shows no change from one grain to the next: five grains' time is not yet standing.
        self._patience_ns = max(still_s, 5.0 * grain_mm * S_PER_MIN / feed_mm_min) * NS_PER_S
        self._last_mm, self._last_ns = start_mm, now_ns
        length = math.dist(start_mm, target_mm)
        further = 1.0 + (beyond_mm / length if length > 0.0 else 0.0)
        x, y, z = (a + further * (b - a) for a, b in zip(start_mm, target_mm, strict=True))
        self._end_mm = (x, y, z)

    def stray(self, place_mm: Millimetres) -> str:
        """What is wrong with a place that is off the way by more than the tolerance; empty for one on it."""
        off = distance_to_segment(place_mm, self.start_mm, self._end_mm)
        if off <= self.tolerance_mm:
            return ""
        way = f"from {shown(self.start_mm)} to {shown(self.target_mm)}"
        return f"the stage reports {shown(place_mm)}, {off:.3f} mm off its way {way} (machine coordinates)"

    def arrived(self, status: Status, place_mm: Millimetres, now_ns: int) -> bool:
        """Whether it is at its end; for a place on the way.

        Raises:
            DeviceError: it is held, stands elsewhere, or says that it moves and does not.
        """
        if status.state is State.IDLE and math.dist(place_mm, self.target_mm) <= self.tolerance_mm:
            return True
        where = f"at {shown(place_mm)}, on its way to {shown(self.target_mm)} (machine coordinates)"
        if status.state not in _UNDER_WAY:
            raise DeviceError(f"the stage is in {status.state} {where}; stop() it, then see to the cause")
        if place_mm != self._last_mm:
            self._last_mm, self._last_ns = place_mm, now_ns
        elif now_ns - self._last_ns > self._patience_ns:
            kind = "has stopped" if status.state is State.IDLE else f"says {status.state} and does not move"
            raise DeviceError(f"the stage {kind} {where}; stop() it, then see what blocks it")
        return False


def distance_to_segment(place: Millimetres, start: Millimetres, end: Millimetres) -> float:
    """Distance of a point from a straight piece [as its arguments]."""
    length = math.dist(start, end)
    if length == 0.0:
        return math.dist(place, start)
    along = sum((p - s) * (e - s) for p, s, e in zip(place, start, end, strict=True)) / length
    part = min(max(along / length, 0.0), 1.0)
    nearest = [s + part * (e - s) for s, e in zip(start, end, strict=True)]
    return math.dist(place, nearest)


def shown(place_mm: Millimetres) -> str:
    """A place in words."""
    return "X{:.3f} Y{:.3f} Z{:.3f} mm".format(*place_mm)
