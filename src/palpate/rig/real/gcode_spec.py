"""What stages that read G-code share: how they are reached, mounted and limited, and how numbers are sent."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields

from palpate.core import InputError, Position, RangeError, Travel

Millimetres = tuple[float, float, float]
MM_PER_M = 1e3
S_PER_MIN = 60.0
MIN_FEED_MM_MIN = 1.0  # below it the planner runs at 1 mm/min whatever was asked (its stock build)
_ROUNDING_M = 1e-9  # of a limit that was calculated; a thousandth of what the stage resolves
_AXIS = re.compile(r"([+-])([XYZ])")
_DECIMALS = 4  # of a target [mm]; a tenth of what the controller reports


@dataclass(frozen=True, slots=True)
class GcodeSpec:
    """Specification of how a stage is reached, mounted and limited.

    Attributes:
        port: a path such as /dev/ttyACM0, or the USB serial number of its adapter.
        baud: of the port; 115200 and 250000 are usual.
        axes: which machine axis, and which way, is x, y and z of the sensor's frame (x right, y towards the
            viewer, z into the skin). The default fits a machine whose Z points up and Y away from the viewer.
        least_m, greatest_m: where it may be sent, in the sensor's frame [m]. Left out, it is all of the
            machine's own travel, which holds once it is homed.
        top_speed_m_s: fastest that is allowed; left out, the slowest axis' own limit [m/s].
        latency_s: from asking for a stop until it acts: port, USB and firmware [s].
        boot_s: how long to listen for its first line after opening the port [s].
        reply_s: how long it may take to answer a line [s].
        stop_s: how long a stop may take beyond the slowing down, before the controller is reset (GRBL) or
            made to give up (Marlin) [s].
        home_s: how long homing may take (GRBL), or go on without a sign of life (Marlin) [s].
        still_s: how long it may stand away from its target, or not come on, before that is a fault [s].
        poll_s: between two looks while it waits for the stage, and for how long a look while it moves waits
            for a report [s].
        dtr: raise the port's DTR line, which resets many boards. Some boards with USB of their own talk only
            with it on.
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
    stop_s: float = 1.0
    home_s: float = 120.0
    still_s: float = 1.0
    poll_s: float = 0.02
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
        for low, high in zip(self.least_m or (), self.greatest_m or (), strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise RangeError(f"limits {low} to {high} m: both must be finite, the first the lower")
        numbers = {one.name: getattr(self, one.name) for one in fields(self)}
        for name, value in numbers.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                good = value > 0 or (name == "boot_s" and value == 0)
                if not (good and math.isfinite(value)):
                    raise RangeError(f"{name} is {value}; it must be positive and finite")


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

    def box_m(self, low_mm: Millimetres, high_mm: Millimetres = (0.0,) * 3) -> tuple[Position, Position]:
        """The machine's own travel in the sensor's frame [m]."""
        corners = self.sensor_m(low_mm), self.sensor_m(high_mm)
        x, y, z = (sorted(pair) for pair in zip(*corners, strict=True))
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
