"""One straight move of a GRBL stage: whether it keeps to its way, where on it it is, and when it arrives."""

from __future__ import annotations

import math

from palpate.core import NS_PER_S, DeviceError
from palpate.rig.real.gcode_spec import S_PER_MIN, Millimetres, distance_to_segment, shown
from palpate.rig.real.grbl.grbl_parser import GrblState, GrblStatus
from palpate.rig.real.grbl.grbl_supervisor import GrblMachine

_REPORTED_MM = 0.001  # resolution of a status report
_UNDER_WAY = {GrblState.IDLE, GrblState.RUN, GrblState.JOG}
_CLOCKS = 1.05  # ratio of the controller's clock and ours, at most
_SOONEST = 0.9  # of a move's time, speeding up and slowing down: an Idle before that is of another moment


class MoveSupervisor:
    """A move from `start_mm` to `target_mm` in machine coordinates, which speeds up and slows down evenly.

    Arrived means: its line was answered, the controller is Idle, and the place is the target. Idle alone is
    not: it shows during a dwell and before a line was read.

    Args:
        start_mm, target_mm: [mm].
        feed_mm_min: its speed [mm/min].
        machine: for tolerance, acceleration and steps.
        still_s: how long it may stay where it is, short of the target, before that is a fault [s].
        now_ns: when it began.

    Attributes:
        first: number of the first status report that counts, since those before it are of before the move.
        place_mm, at_ns: the last report that counted [mm], and when it came [ns]; the start before any.
    """

    def __init__(
        self,
        start_mm: Millimetres,
        target_mm: Millimetres,
        feed_mm_min: float,
        machine: GrblMachine,
        still_s: float,
        now_ns: int,
    ) -> None:
        self.start_mm, self.target_mm, self.feed_mm_min = start_mm, target_mm, feed_mm_min
        self.tolerance_mm = machine.tolerance_mm
        self.first = 0
        self.place_mm, self.at_ns = start_mm, now_ns
        self._began_ns = now_ns
        self._length_mm = math.dist(start_mm, target_mm)
        self._rate = min(machine.acceleration_mm_s2)
        self._top = min(feed_mm_min / S_PER_MIN, math.sqrt(self._rate * self._length_mm))
        grain_mm = max(_REPORTED_MM, 1.0 / min(machine.steps_per_mm))
        # A creeping axis shows no change from one grain to the next: five grains' time is not yet standing.
        self._patience_ns = max(still_s, 5.0 * grain_mm * S_PER_MIN / feed_mm_min) * NS_PER_S
        self._changed_ns = now_ns
        self._told_mm = 0.0  # how far along it was said to be

    def stray(self, place_mm: Millimetres) -> str:
        """Describe a place off the way by more than the tolerance; empty for one on it."""
        off = distance_to_segment(place_mm, self.start_mm, self.target_mm)
        if off <= self.tolerance_mm:
            return ""
        way = f"from {shown(self.start_mm)} to {shown(self.target_mm)}"
        return f"the stage reports {shown(place_mm)}, {off:.3f} mm off its way {way} (machine coordinates)"

    def plausible(self, place_mm: Millimetres, at_ns: int) -> bool:
        """Whether it can be there: on its way, not behind the last report, and not ahead of its speed."""
        least_mm = math.dist(self.start_mm, self.place_mm) - self.tolerance_mm
        since_s = _CLOCKS * (at_ns - self._began_ns) / NS_PER_S
        most_mm = since_s * self.feed_mm_min / S_PER_MIN + self.tolerance_mm
        return not self.stray(place_mm) and least_mm <= math.dist(self.start_mm, place_mm) <= most_mm

    def note(self, place_mm: Millimetres, at_ns: int) -> None:
        """Take in a report that counts."""
        if place_mm != self.place_mm:
            self._changed_ns = at_ns
        self.place_mm, self.at_ns = place_mm, at_ns

    def arrived(self, status: GrblStatus) -> bool:
        """Whether it is at its end, by the report that was noted last."""
        idle = status.state is GrblState.IDLE
        if idle and self.left_mm() <= self.tolerance_mm and self.at_ns - self._began_ns >= self._soonest_ns:
            return True
        where = f"at {shown(self.place_mm)}, on its way to {shown(self.target_mm)} (machine coordinates)"
        if status.state not in _UNDER_WAY:
            raise DeviceError(f"the stage is in {status.state} {where}; stop() it, then see to the cause")
        if self.at_ns - self._changed_ns > self._patience_ns:
            kind = "has stopped" if idle else f"says {status.state} and does not move"
            raise DeviceError(
                f"the stage {kind} {where}; stop() it, then see what blocks it, or who pressed its "
                "hold input",
                code="stage-stalled",
            )
        return False

    def left_mm(self) -> float:
        """Distance from the last report to the target [mm]."""
        return math.dist(self.place_mm, self.target_mm)

    def least_left_mm(self, now_ns: int) -> float:
        """Distance to the target that is left at least, at full speed since the last report [mm]."""
        since_s = max(now_ns - self.at_ns, 0) / NS_PER_S
        return self.left_mm() - since_s * self.feed_mm_min / S_PER_MIN

    def runs_on_mm(self, latency_s: float) -> float:
        """How far it goes on after it was asked to stop, v^2 / 2a + v latency [mm]."""
        speed = self.feed_mm_min / S_PER_MIN
        return speed**2 / (2 * self._rate) + speed * latency_s

    @property
    def began_ns(self) -> int:
        """When it began [ns]."""
        return self._began_ns

    @property
    def slowing_s(self) -> float:
        """Time that slowing down from its full speed takes [s]."""
        return self.feed_mm_min / S_PER_MIN / self._rate

    def near_end(self, now_ns: int, within_s: float) -> bool:
        """Whether its predicted end is no more than so long away, or was before now [s]."""
        return (now_ns - self._began_ns) / NS_PER_S >= self._lasts_s - within_s

    def place_at(self, now_ns: int) -> Millimetres:
        """Place now, by the last report and the even way that it goes on since; never back [mm].

        Between two reports it is known only by calculation. It is never said to be beyond its target, nor
        further than the speed that was asked for would have taken it.
        """
        if self._length_mm == 0:
            return self.place_mm
        reported = math.dist(self.start_mm, self.place_mm)
        moved = self.place_mm != self.start_mm
        since_s = max(now_ns - self.at_ns, 0) / NS_PER_S
        along = self._along_mm(self._time_s(reported) + since_s) if moved else 0.0
        self._told_mm = min(max(along, reported, self._told_mm), self._length_mm)
        part = self._told_mm / self._length_mm
        x, y, z = (a + part * (b - a) for a, b in zip(self.start_mm, self.target_mm, strict=True))
        return x, y, z

    @property
    def _soonest_ns(self) -> float:
        return _SOONEST * self._lasts_s * NS_PER_S

    @property
    def _lasts_s(self) -> float:
        return self._length_mm / self._top + self._top / self._rate if self._length_mm else 0.0

    def _along_mm(self, time_s: float) -> float:
        """How far along it is after a time: evenly faster, steady, evenly slower [mm]."""
        left_s = self._lasts_s - time_s
        ramp_s = self._top / self._rate
        if left_s <= 0:
            return self._length_mm
        if min(time_s, left_s) >= ramp_s:
            return self._top * (time_s - ramp_s / 2)
        if time_s <= left_s:
            return self._rate * time_s**2 / 2
        return self._length_mm - self._rate * left_s**2 / 2

    def _time_s(self, along_mm: float) -> float:
        """When it is so far along, which undoes `_along_mm` [s]."""
        ramp_mm = self._top**2 / (2 * self._rate)
        left_mm = max(self._length_mm - along_mm, 0.0)
        if min(along_mm, left_mm) >= ramp_mm:
            return along_mm / self._top + self._top / self._rate / 2
        if along_mm <= left_mm:
            return math.sqrt(2 * along_mm / self._rate)
        return self._lasts_s - math.sqrt(2 * left_mm / self._rate)
