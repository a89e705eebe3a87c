"""Spec of a GRBL stage, and the settings that it has itself."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from palpate.core import DeviceError, InputError, RangeError
from palpate.rig.real.gcode_spec import MM_PER_M, S_PER_MIN, GcodeSpec, Millimetres, Mount
from palpate.rig.real.grbl.grbl_link import GrblLink, RefusedError
from palpate.rig.real.grbl.grbl_parser import GrblMessage, Setting

_REPORT_MACHINE, _REPORT_PINS = (
    1,
    16,
)  # bits of $10; the second is of grblHAL alone, Grbl 1.1 always reports inputs

_MOVES = re.compile(r"=.*?(?:[XYZABC]|G0*(?:[0-3]|28|30|38)(?!\d))")
AXIS_RATES = 512  # bit 9 of $22 (grblHAL): $190 to $192 hold a homing speed for each axis, and $25 is gone


@dataclass(frozen=True, slots=True)
class GrblSpec(GcodeSpec):
    """Specification of a GRBL stage.

    Attributes:
        status_s: period on which its status is asked for [s]. Near the predicted end of a move, and while a
            stop is awaited, it is asked for as soon as the last report has come.
        silence_s: for how long questions for the status may go unanswered before it counts as gone [s].
        require_homed: refuse to move unless homing is on and was not bypassed. Without it the place is on
            the word of who calls `reference`.
    """

    status_s: float = 0.1
    silence_s: float = 3.0
    require_homed: bool = True

    def __post_init__(self) -> None:
        GcodeSpec.__post_init__(self)
        if self.silence_s < 2 * self.status_s:
            raise RangeError(
                f"silence_s is {self.silence_s} s, with a question for the status every {self.status_s} s: a "
                f"lost answer would count as a stage that is gone; give {2 * self.status_s} s or more"
            )


@dataclass(frozen=True, slots=True)
class GrblMachine:
    """The settings that bear on motion.

    Attributes:
        steps_per_mm: $100 to $102.
        top_mm_min: $110 to $112.
        acceleration_mm_s2: $120 to $122.
        travel_mm: $130 to $132.
        homing: $22.
        reports: $10, what a status report shows.
        motors_hold: whether the motors keep their current at rest, $1=255.
        reversed_axes: $3, a bit for each axis that runs the other way.
        pull_off_mm: $27, the way back from the switches [mm].
        homing_mm_min: $25, the speed at which the switches are searched for [mm/min].
        homes_down: $23, a bit for each axis that homes towards smaller machine coordinates.
    """

    steps_per_mm: tuple[float, float, float]
    top_mm_min: tuple[float, float, float]
    acceleration_mm_s2: tuple[float, float, float]
    travel_mm: tuple[float, float, float]
    homing: bool
    reports: int = 511
    motors_hold: bool = False
    reversed_axes: int = 0
    homes_down: int = 0
    pull_off_mm: float = 1.0
    homing_mm_min: float = 500.0

    @classmethod
    def read(cls, settings: Mapping[int, str]) -> GrblMachine:
        """Read the settings from their numbers and texts."""
        if _number(settings, 13) != 0:
            raise DeviceError("the controller reports in inches ($13=1); set $13=0 on it")
        if settings.get(32, "0").split()[:1] == ["2"]:  # of grblHAL, where x may be a diameter
            raise DeviceError("the controller is in lathe mode ($32=2); set $32=0 on it", code="lathe-mode")
        return cls(
            steps_per_mm=_three(settings, 100),
            top_mm_min=_three(settings, 110),
            acceleration_mm_s2=_three(settings, 120),
            travel_mm=_three(settings, 130),
            homing=int(_number(settings, 22)) % 2 == 1,  # grblHAL keeps options in its higher bits
            reports=int(_number(settings, 10)),
            motors_hold=settings.get(1, "").split()[:1] == ["255"],
            reversed_axes=int(_number(settings, 3)),
            homes_down=int(_number(settings, 23)),
            pull_off_mm=_number(settings, 27),
            homing_mm_min=_homing_mm_min(settings),
        )

    def homes_into_skin(self, axes: tuple[str, str, str]) -> bool:
        """Whether homing drives the axis of the skin's z towards the skin, for the axes of a mount."""
        goes_down = bool(self.homes_down >> "XYZ".index(axes[2][-1]) & 1)
        return goes_down == axes[2].startswith("-")

    @property
    def least_mm(self) -> Millimetres:
        """Lower corner of its travel, whose upper one is 0 [mm]."""
        x, y, z = (-length for length in self.travel_mm)
        return x, y, z

    @property
    def tolerance_mm(self) -> float:
        """Tolerance of a place: two steps of the coarsest axis, 0.01 mm at least [mm]."""
        return max(2.0 / min(self.steps_per_mm), 0.01)

    @property
    def slowing_s(self) -> float:
        """Time that slowing down takes at worst [s]."""
        return max(self.top_mm_min) / S_PER_MIN / min(self.acceleration_mm_s2)


def read_machine(link: GrblLink) -> GrblMachine:
    """Ask for the settings."""
    for _ in range(3):  # an answer to somebody else's line can come before the list
        settings = {line.number: line.text for line in link.command("$$") if isinstance(line, Setting)}
        if settings:
            return GrblMachine.read(settings)
    raise DeviceError("the stage's controller does not list its settings on $$")


def check_startup(link: GrblLink) -> None:
    """Refuse startup blocks that move: the firmware runs them after each reset and after homing.

    Raises:
        DeviceError: `$N0` or `$N1` moves an axis (`startup-motion`).
    """
    with suppress(RefusedError):  # a build without startup blocks
        for said in link.command("$N"):
            if isinstance(said, GrblMessage) and said.tag == "startup" and _MOVES.search(said.text.upper()):
                name = said.text.partition("=")[0]
                raise DeviceError(
                    f"the startup block {said.text} on the stage's controller moves it after each reset and "
                    f"after homing; clear it with {name}=",
                    code="startup-motion",
                )


def check_reports(machine: GrblMachine, *, hal: bool) -> None:
    """Refuse status reports without machine coordinates, or without inputs, which grblHAL can leave out.

    Raises:
        DeviceError: $10 hides one of them.
    """
    needed, remedy = (_REPORT_MACHINE | _REPORT_PINS, 511) if hal else (_REPORT_MACHINE, 1)
    if machine.reports & needed != needed:
        hidden = "its coordinates or its hold, door and limit inputs" if hal else "its machine coordinates"
        raise DeviceError(
            f"$10={machine.reports} on the stage's controller hides {hidden}; set $10={remedy} on it"
        )


def check_limits(spec: GrblSpec, machine: GrblMachine) -> None:
    """Refuse limits that the machine cannot have.

    Raises:
        InputError: there are none, and homing is off: the counts begin anywhere, and so would -$130 to 0.
        RangeError: they span more than the machine does, or are faster.
    """
    fastest = min(machine.top_mm_min) / S_PER_MIN
    if spec.top_speed_m_s is not None and spec.top_speed_m_s * MM_PER_M > fastest * (1 + 1e-9):
        raise RangeError(
            f"a top speed of {spec.top_speed_m_s * MM_PER_M:g} mm/s is stated, and the machine's slowest "
            f"axis does {fastest:g} mm/s ($110 to $112); state that or less"
        )
    if spec.least_m is None or spec.greatest_m is None:
        if not machine.homing:
            raise InputError("homing is off on the stage ($22=0), so give least_m and greatest_m [m]")
        return
    if not machine.homing:
        return
    low, high = Mount(spec.axes).box_m(machine.least_mm)
    for name, least, greatest, a, b in zip("xyz", spec.least_m, spec.greatest_m, low, high, strict=True):
        if greatest - least > (b - a) * (1 + 1e-9):  # a rounding above the travel is the travel
            raise RangeError(
                f"limits {least} to {greatest} m of {name} span more than the machine's {b - a:g} m "
                "($130 to $132); narrow them"
            )


def _homing_mm_min(settings: Mapping[int, str]) -> float:
    if 25 not in settings and int(_number(settings, 22)) & AXIS_RATES:
        raise DeviceError(
            f"$22={settings[22]} gives each axis a homing speed of its own, which is not read: subtract "
            f"{AXIS_RATES} from $22, and set $25 to 500",
            code="homing-speed",
        )
    return _number(settings, 25)


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
