"""Specification of an arm: its address, frame, box, speeds and times."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.core import Position, RangeError
from palpate.rig.real.ur_arm.arm_frame import ArmFrame

MAX_SPEED_M_S = 0.25
"""Ceiling of an arm's speed: that at which people may be near one (ISO 10218-1, reduced speed) [m/s]."""
MIN_STOP_M_S2, MAX_STOP_M_S2 = 0.1, 10.0
MAX_TILT_DEG = 2.0
MIN_RATE_HZ, MAX_RATE_HZ = 50.0, 500.0


@dataclass(frozen=True, slots=True)
class UrArmSpec:
    """Specification of how an arm is reached, mounted and limited.

    Attributes:
        host: name or address of its controller.
        frame: the rig's frame in the arm's base, and the tool's orientation.
        least_m, greatest_m: where it may be sent, in the rig's frame [m].
        top_speed_m_s: fastest that is allowed; at most `MAX_SPEED_M_S` [m/s].
        acceleration_m_s2: at which a move begins and ends [m/s^2].
        stop_m_s2: at which a stop slows down, and which its distance is counted from [m/s^2].
        latency_s: from asking for a stop until it begins to slow down [s].
        tilt_deg: by which the tool may be found out of the stated orientation [degrees].
        rate_hz: of its status [Hz].
        stale_s: age of a status that is too old [s].
        stop_s: how long a stop may take before its program is ended [s].
        still_s: how long it may stand short of its target before that is a fault [s].

    Raises:
        RangeError: a number is out of its range, or the box is empty.
    """

    host: str
    frame: ArmFrame
    least_m: Position
    greatest_m: Position
    top_speed_m_s: float = 0.05
    acceleration_m_s2: float = 0.5
    stop_m_s2: float = 1.0
    latency_s: float = 0.05
    tilt_deg: float = 0.5
    rate_hz: float = 125.0
    stale_s: float = 0.1
    stop_s: float = 5.0
    still_s: float = 1.0

    def __post_init__(self) -> None:
        ranges = {
            "top_speed_m_s": (0.0, MAX_SPEED_M_S, "m/s"),
            "acceleration_m_s2": (0.0, MAX_STOP_M_S2, "m/s^2"),
            "stop_m_s2": (MIN_STOP_M_S2, MAX_STOP_M_S2, "m/s^2"),
            "latency_s": (0.0, 1.0, "s"),
            "tilt_deg": (0.0, MAX_TILT_DEG, "degrees"),
            "rate_hz": (MIN_RATE_HZ, MAX_RATE_HZ, "Hz"),
            "stale_s": (0.0, 0.5, "s"),
            "stop_s": (0.0, 30.0, "s"),
            "still_s": (0.0, 30.0, "s"),
        }
        for name, (least, most, unit) in ranges.items():
            value = getattr(self, name)
            if not (value > 0 and least <= value <= most):
                raise RangeError(
                    f"{name} is {value} {unit}; give more than 0, and {least:g} to {most:g} {unit}"
                )
        for axis, low, high in zip("xyz", self.least_m, self.greatest_m, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise RangeError(f"the arm's box along {axis} is {low} to {high} m; give a finite, wider one")
