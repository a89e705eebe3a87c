"""What a GRBL controller's firmware is set to, of its `$$` list."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from palpate.core.errors import DeviceError, InputError, RangeError
from palpate.rig.real.grbl_lines import Setting
from palpate.rig.real.grbl_link import GrblLink
from palpate.rig.real.grbl_spec import S_PER_MIN, GrblSpec, Mount


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
