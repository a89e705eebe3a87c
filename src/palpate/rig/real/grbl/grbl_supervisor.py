"""Spec of a GRBL stage, its mounting in the sensor's frame, and the settings that it has itself."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from palpate.core import DeviceError, InputError, Position, RangeError, Travel
from palpate.rig.real.grbl.grbl_link import GrblLink
from palpate.rig.real.grbl.grbl_parser import Setting

MM_PER_M = 1e3
S_PER_MIN = 60.0
MIN_FEED_MM_MIN = 1.0  # below it the planner runs at 1 mm/min whatever was asked (its stock build)
_ROUNDING_M = 1e-9  # of a limit that was calculated; a thousandth of what the stage resolves
_AXIS = re.compile(r"([+-])([XYZ])")
_REPORT_MACHINE, _REPORT_PINS = (
    1,
    16,
)  # bits of $10; the second is of grblHAL alone, Grbl 1.1 always reports inputs
_DECIMALS = 4  # of a target [mm]; a tenth of what the controller reports


@dataclass(frozen=True, slots=True)
class GrblSpec:
    """Specification of how a stage is reached, mounted and limited.

    Attributes:
        port: a path such as /dev/ttyACM0, or the USB serial number of its adapter.
        baud: of the port.
        axes: which machine axis, and which way, is x, y and z of the sensor's frame (x right, y towards the
            viewer, z into the skin). The default fits a machine whose Z points up and Y away from the viewer.
        least_m, greatest_m: where it may be sent, in the sensor's frame [m]. Left out, it is all of the
            machine's own travel, which spans -$130 to 0 and so on in machine coordinates once homed.
        top_speed_m_s: fastest that is allowed; left out, the slowest axis' own limit, $110 to $112.
        latency_s: from asking for a stop to the start of slowing down: port, USB and firmware [s].
        boot_s: how long to listen for its banner after opening the port [s].
        reply_s: how long it may take to answer a line [s].
        status_s: period on which its status is asked for [s]. Near the predicted end of a move, and while a
            stop is awaited, it is asked for as soon as the last report has come.
        silence_s: for how long questions for the status may go unanswered before it counts as gone [s].
        stop_s: how long a stop may take beyond the slowing down itself [s]; then it is reset in motion.
        home_s: how long homing may take [s].
        still_s: how long it may stand away from its target, or not come on, before that is a fault [s].
        poll_s: between two looks while it waits for the stage, and for how long a look while it moves waits
            for a report [s].
        require_homed: refuse to move unless homing is on and was not bypassed. Without it the place is on
            the word of who calls `reference`.
        dtr: raise the port's DTR line. Off, an AVR board is kept from being reset where the system allows it;
            some boards with USB of their own talk only with it on.
        frame: What defines the sensor's frame; a position that was stored with another one is not accepted.
    """

    port: str
    baud: int = 115200
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    least_m: Position | None = None
    greatest_m: Position | None = None
    top_speed_m_s: float | None = None
    latency_s: float = 0.05
    boot_s: float = 2.5
    reply_s: float = 2.0
    status_s: float = 0.1
    silence_s: float = 3.0
    stop_s: float = 1.0
    home_s: float = 120.0
    still_s: float = 1.0
    poll_s: float = 0.02
    require_homed: bool = True
    dtr: bool = False
    frame: str = ""

    def __post_init__(self) -> None:
        letters = [axis[1:] for axis in self.axes if _AXIS.fullmatch(axis)]
        if sorted(letters) != ["X", "Y", "Z"]:
            raise InputError(
                f"axes {self.axes} must name X, Y and Z once each with a sign, as ('+X', '-Y', '-Z')"
            )
        if (self.least_m is None) != (self.greatest_m is None):
            raise InputError("give both least_m and greatest_m [m], or neither")
        if self.least_m is not None and self.greatest_m is not None:
            for low, high in zip(self.least_m, self.greatest_m, strict=True):
                if not (math.isfinite(low) and math.isfinite(high) and low < high):
                    raise RangeError(f"limits {low} to {high} m: both must be finite, the first the lower")
        times = ("latency_s", "reply_s", "status_s", "silence_s", "stop_s", "home_s", "still_s", "poll_s")
        if self.silence_s < 2 * self.status_s:
            raise RangeError(
                f"silence_s is {self.silence_s} s, with a question for the status every {self.status_s} s: a "
                f"lost answer would count as a stage that is gone; give {2 * self.status_s} s or more"
            )
        for name in ("baud", "top_speed_m_s", *times):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise RangeError(f"{name} is {value}; it must be positive and finite")
        if not (self.boot_s >= 0 and math.isfinite(self.boot_s)):
            raise RangeError(f"boot_s is {self.boot_s} s; it must be 0 s or more")


@dataclass(frozen=True, slots=True)
class Mount:
    """Sensor frame to machine coordinates and back: sensor = sign (machine - origin), axis by axis.

    Attributes:
        axes: as in the spec.
        origin_mm: machine coordinates of the sensor frame's zero [mm].
    """

    axes: tuple[str, str, str]
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def sensor_m(self, machine_mm: tuple[float, ...]) -> Position:
        """Place in the sensor's frame [m]."""
        from_origin = [there - zero for there, zero in zip(machine_mm, self.origin_mm, strict=False)]
        x, y, z = (_sign(axis) * from_origin[_index(axis)] / MM_PER_M for axis in self.axes)
        return x, y, z

    def machine_mm(self, sensor_m: Position) -> tuple[float, float, float]:
        """Place in machine coordinates, rounded to what is sent [mm]."""
        machine = list(self.origin_mm)
        for axis, value in zip(self.axes, sensor_m, strict=True):
            machine[_index(axis)] += _sign(axis) * value * MM_PER_M
        x, y, z = (round(value, _DECIMALS) for value in machine)
        return x, y, z

    def at_origin(self) -> Mount:
        """The mount whose zero is the machine's."""
        return Mount(self.axes)

    def placed(self, machine_mm: tuple[float, ...], sensor_m: Position) -> Mount:
        """The mount for which the machine, standing there, is at `sensor_m`."""
        at_zero = Mount(self.axes).machine_mm(sensor_m)
        x, y, z = (machine_mm[i] - at_zero[i] for i in range(3))
        return Mount(self.axes, (x, y, z))

    def box_m(self, travel_mm: tuple[float, float, float]) -> tuple[Position, Position]:
        """The machine's own travel, -travel to 0, in the sensor's frame [m]."""
        low = self.sensor_m(tuple(-length for length in travel_mm))
        high = self.sensor_m((0.0, 0.0, 0.0))
        x, y, z = (sorted(pair) for pair in zip(low, high, strict=True))
        return (x[0], y[0], z[0]), (x[1], y[1], z[1])


def fixed(value: float, decimals: int = _DECIMALS) -> str:
    """A number as GRBL reads it: fixed point, no exponent, no minus before zero.

    Raises:
        RangeError: it is not finite, or too large to be a length in mm or a speed in mm/min.

    Example:
        >>> fixed(-0.00001), fixed(1e-2)
        ('0.0000', '0.0100')
    """
    if not (math.isfinite(value) and abs(value) < 1e6):
        raise RangeError(f"{value} cannot be sent to the stage: it must be finite and below 1e6 mm or mm/min")
    text = f"{value:.{decimals}f}"
    return text[1:] if float(text) == 0.0 and text.startswith("-") else text


def feed_mm_min(speed_m_s: float) -> float:
    """A speed in the controller's unit [mm/min]."""
    return speed_m_s * MM_PER_M * S_PER_MIN


def check_range(travel: Travel, position_m: Position, speed_m_s: float) -> None:
    """Refuse what a stage cannot do."""
    for name, value, low, high in zip("xyz", position_m, travel.least_m, travel.greatest_m, strict=True):
        if not low - _ROUNDING_M <= value <= high + _ROUNDING_M:
            raise RangeError(
                f"{name} = {value} m lies outside the stage's travel, {low:g} to {high:g} m; not moved",
                code="outside-travel",
            )
    least, greatest = MIN_FEED_MM_MIN / MM_PER_M / S_PER_MIN, travel.top_speed_m_s
    if not least <= speed_m_s <= greatest * (1 + 1e-9):  # a rounding above the limit is the limit
        raise RangeError(f"speed {speed_m_s} m/s lies outside {least:.3g} to {greatest:g} m/s; not moved")


def _index(axis: str) -> int:
    return "XYZ".index(axis[1])


def _sign(axis: str) -> int:
    return -1 if axis[0] == "-" else 1


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

    @classmethod
    def read(cls, settings: Mapping[int, str]) -> GrblMachine:
        """Read the settings from their numbers and texts."""
        if _number(settings, 13) != 0:
            raise DeviceError("the controller reports in inches ($13=1); set $13=0 on it")
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
        )

    def homes_into_skin(self, axes: tuple[str, str, str]) -> bool:
        """Whether homing drives the axis of the skin's z towards the skin, for the axes of a mount."""
        goes_down = bool(self.homes_down >> _index(axes[2]) & 1)
        return goes_down == (_sign(axes[2]) < 0)

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
            "axis "
            f"does {fastest:g} mm/s ($110 to $112); state that or less"
        )
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
