"""Specification of a Marlin stage: its port, mounting, limits and times."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.core import Position, RangeError
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec


@dataclass(frozen=True, slots=True)
class MarlinSpec:
    """Specification of how a stage is reached, mounted and limited.

    Attributes:
        port: a path such as /dev/ttyUSB0, or the USB serial number of its adapter.
        baud: of the port; 115200 and 250000 are usual.
        axes: which machine axis, and which way, is x, y and z of the sensor's frame (x right, y towards the
            viewer, z into the skin).
        least_m, greatest_m: where it may be sent, in the sensor's frame [m]. Left out, it is the machine's
            own box (M211), which holds only once it is homed.
        sudden_m_s: fastest speed from which it can be stopped dead without losing steps; left out, the
            controller's jerk (M205). Try it, with the load that it carries [m/s].
        top_speed_m_s: fastest that is allowed; at most `sudden_m_s` and the slowest axis' own limit [m/s].
        latency_s: from asking for a stop until the motors stand, with an emergency parser [s].
        queued_s: more of it without one, since M410 then waits for its turn [s].
        boot_s: how long to listen for its `start` after opening the port [s].
        reply_s: how long it may take to answer a line [s].
        stop_s: how long a stop may take before the controller is made to give up (M112) [s].
        home_s: how long homing may go on without a sign of life [s].
        still_s: how long it may stand short of its target before that is a fault [s].
        poll_s: between questions while it waits for the stage [s].
        dtr: raise the port's DTR line, which resets many boards; boards with USB of their own may need it.
        frame: As in `GrblSpec`.
    """

    port: str
    baud: int = 115200
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    least_m: Position | None = None
    greatest_m: Position | None = None
    sudden_m_s: float | None = None
    top_speed_m_s: float | None = None
    latency_s: float = 0.05
    queued_s: float = 0.5
    boot_s: float = 5.0
    reply_s: float = 2.0
    stop_s: float = 5.0
    home_s: float = 60.0
    still_s: float = 1.0
    poll_s: float = 0.02
    dtr: bool = False
    frame: str = ""

    def __post_init__(self) -> None:
        GrblSpec(self.port, axes=self.axes, least_m=self.least_m, greatest_m=self.greatest_m)  # their checks
        times = ("latency_s", "queued_s", "reply_s", "stop_s", "home_s", "still_s", "poll_s")
        for name in ("baud", "sudden_m_s", "top_speed_m_s", *times):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise RangeError(f"{name} is {value}; it must be positive and finite")
        if not (self.boot_s >= 0 and math.isfinite(self.boot_s)):
            raise RangeError(f"boot_s is {self.boot_s} s; it must be 0 s or more")
