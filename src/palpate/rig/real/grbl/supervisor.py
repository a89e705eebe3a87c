"""The machine's own settings, and one straight move under watch: on its path, arrived, or stopped short."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError, InputError, RangeError
from palpate.rig.real.grbl.link import GrblLink
from palpate.rig.real.grbl.parser import GrblState, GrblStatus, Setting
from palpate.rig.real.grbl.spec import S_PER_MIN, GrblSpec, Mount


@dataclass(frozen=True, slots=True)
class Machine:
    """The settings that bear on motion.

    Attributes:
        steps_per_mm: $100 to $102.
        top_mm_min: $110 to $112.
        acceleration_mm_s2: $120 to $122.
        travel_mm: $130 to $132.
        homing: $22.
    """

    steps_per_mm: tuple[float, float, float]
    top_mm_min: tuple[float, float, float]
    acceleration_mm_s2: tuple[float, float, float]
    travel_mm: tuple[float, float, float]
    homing: bool

    @classmethod
    def read(cls, settings: Mapping[int, str]) -> Machine:
        """From setting numbers and texts.

        Raises:
            DeviceError: one is missing, not a positive number, or it reports in inches.
        """
        if _number(settings, 13) != 0:
            raise DeviceError("the controller reports in inches ($13=1); set $13=0 on it")
        return cls(
            steps_per_mm=_three(settings, 100),
            top_mm_min=_three(settings, 110),
            acceleration_mm_s2=_three(settings, 120),
            travel_mm=_three(settings, 130),
            homing=int(_number(settings, 22)) % 2 == 1,  # grblHAL keeps options in its higher bits
        )

    @property
    def tolerance_mm(self) -> float:
        """How near counts as there: two steps of the coarsest axis, 0.01 mm at least [mm]."""
        return max(2.0 / min(self.steps_per_mm), 0.01)

    @property
    def slowing_s(self) -> float:
        """How long slowing down takes at worst [s]."""
        return max(self.top_mm_min) / S_PER_MIN / min(self.acceleration_mm_s2)


def read_machine(link: GrblLink) -> Machine:
    """Ask for the settings.

    Raises:
        DeviceError: they do not come, or one that is needed cannot be read.
    """
    for _ in range(3):  # an answer to somebody else's line can come before the list
        settings = {line.number: line.text for line in link.command("$$") if isinstance(line, Setting)}
        if settings:
            return Machine.read(settings)
    raise DeviceError("the stage's controller does not list its settings on $$")


def check_limits(spec: GrblSpec, machine: Machine) -> None:
    """Refuse limits that the machine cannot have.

    Raises:
        InputError: there are none, and homing is off: the counts begin anywhere, and so would -$130 to 0.
        RangeError: they span more than the machine does.
    """
    if spec.least_m is None or spec.greatest_m is None:
        if not machine.homing:
            raise InputError("homing is off on the stage ($22=0), so give least_m and greatest_m [m]")
        return
    if not machine.homing:
        return
    low, high = Mount(spec.axes).box_m(machine.travel_mm)
    for name, least, greatest, a, b in zip("xyz", spec.least_m, spec.greatest_m, low, high, strict=True):
        if greatest - least > (b - a) * (1 + 1e-9):  # a rounding above the travel is the travel
            raise RangeError(
                f"limits {least} to {greatest} m of {name} span more than the machine's {b - a:g} m "
                "($130 to $132); narrow them"
            )


def _number(settings: Mapping[int, str], number: int) -> float:
    try:
        return float(settings[number].split()[0])
    except (KeyError, ValueError, IndexError) as error:
        raise DeviceError(f"the controller's list of settings has no readable ${number}") from error


def _three(settings: Mapping[int, str], first: int) -> tuple[float, float, float]:
    x, y, z = (_number(settings, first + i) for i in range(3))
    if not all(math.isfinite(value) and value > 0 for value in (x, y, z)):
        raise DeviceError(
            f"the controller's settings ${first} to ${first + 2} must be above 0; set them on it"
        )
    return x, y, z


Millimetres = tuple[float, float, float]
_REPORTED_MM = 0.001  # resolution of a status report
_UNDER_WAY = {GrblState.IDLE, GrblState.RUN, GrblState.JOG}


class MoveSupervisor:
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

    def arrived(self, status: GrblStatus, place_mm: Millimetres, now_ns: int) -> bool:
        """Whether it is at its end; for a place on the way.

        Raises:
            DeviceError: it is held, stands elsewhere, or says that it moves and does not.
        """
        if status.state is GrblState.IDLE and math.dist(place_mm, self.target_mm) <= self.tolerance_mm:
            return True
        where = f"at {shown(place_mm)}, on its way to {shown(self.target_mm)} (machine coordinates)"
        if status.state not in _UNDER_WAY:
            raise DeviceError(f"the stage is in {status.state} {where}; stop() it, then see to the cause")
        if place_mm != self._last_mm:
            self._last_mm, self._last_ns = place_mm, now_ns
        elif now_ns - self._last_ns > self._patience_ns:
            kind = (
                "has stopped" if status.state is GrblState.IDLE else f"says {status.state} and does not move"
            )
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
