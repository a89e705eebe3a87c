"""Pressure servos for a proportional valve: a PID, and a feed-forward of the mass flow.

`FlowServo` inverts the ISO 6358 valve for the flow that makes the gas follow the reference,

    q = V / (n R T) (p_ref' + k (p_ref - p)) - (p + p0) A s' / (R T).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from palpate.softness.cone_display import ConeDisplay
from palpate.softness.control.speed_tracker import SpeedTracker
from palpate.softness.display_parts import (
    ANR_DENSITY_KG_M3,
    ATMOSPHERE_PA,
    GAS_J_KG_K,
    ROOM_K,
    Chamber,
    ProportionalValve,
)


@dataclass(frozen=True, slots=True)
class ChamberState:
    """What a servo knows in one period."""

    pressure_pa: float
    pushed_m: float
    speed_m_s: float


@runtime_checkable
class PressureServo(Protocol):
    """Gives a valve's opening."""

    def opening(self, pressure_pa: float, rate_pa_s: float, now: ChamberState, dt_s: float) -> float:
        """Opening for a reference and its rate, -1 to 1."""

    def reset(self) -> None:
        """Forget what came before, after a vent."""


@dataclass
class PidServo:
    """PID of the pressure error."""

    gain_per_pa: float = 1.6e-5
    integral_s: float = 0.01
    derivative_s: float = 2e-3
    _sum: float = field(default=0.0, init=False)
    _before: float | None = field(default=None, init=False)

    def opening(self, pressure_pa: float, rate_pa_s: float, now: ChamberState, dt_s: float) -> float:
        """Opening for an error; its integral stands still while the valve is fully open."""
        error = pressure_pa - now.pressure_pa
        slope = 0.0 if self._before is None else (error - self._before) / dt_s
        self._before = error
        grown = self._sum + error * dt_s / self.integral_s
        asked = self.gain_per_pa * (error + grown + self.derivative_s * slope)
        if abs(asked) < 1.0:
            self._sum = grown
        return min(max(asked, -1.0), 1.0)

    def reset(self) -> None:
        """Forget integral and slope."""
        self._sum, self._before = 0.0, None


@dataclass
class FlowServo:
    """Feed-forward of the mass flow with modeled valve and chamber, plus proportional feedback.

    Attributes:
        lead_s: delay of spool, tube, and one period that is predicted [s].
        foresight_hz: bandwidth of the derivative used for that [Hz].
    """

    shape: ConeDisplay = field(default_factory=ConeDisplay)
    valve: ProportionalValve = field(default_factory=ProportionalValve)
    chamber: Chamber = field(default_factory=Chamber)
    gain_per_s: float = 100.0
    lead_s: float = 3.5e-3
    foresight_hz: float = 80.0
    _slope: SpeedTracker = field(init=False)

    def __post_init__(self) -> None:
        self.reset()

    def opening(self, pressure_pa: float, rate_pa_s: float, now: ChamberState, dt_s: float) -> float:
        """Opening that lets the flow through which the gas needs."""
        pushed = min(max(now.pushed_m, 0.0), self.shape.height_m)
        absolute = now.pressure_pa + ATMOSPHERE_PA
        volume = self.chamber.dead_m3 + float(self.shape.volume_m3(pushed))
        stored = volume / (self.chamber.polytropic * GAS_J_KG_K * ROOM_K)  # mass for each pascal
        swept = absolute * float(self.shape.area_m2(pushed)) * now.speed_m_s / (GAS_J_KG_K * ROOM_K)
        needed = stored * rate_pa_s - swept
        foreseen = needed + self.lead_s * self._slope.speed(needed, dt_s)
        left = stored * self.gain_per_s * (pressure_pa - now.pressure_pa)
        return self.opening_for(foreseen + left, absolute)

    def opening_for(self, flow_kg_s: float, absolute_pa: float) -> float:
        """Opening through which a mass flows into the chamber at its absolute pressure."""
        if flow_kg_s == 0.0:
            return 0.0
        inlet = self.valve.supply_pa + ATMOSPHERE_PA
        up, down = (inlet, absolute_pa) if flow_kg_s > 0 else (absolute_pa, ATMOSPHERE_PA)
        full = self.valve.conductance * ANR_DENSITY_KG_M3 * up * self._fall(down / up)
        share = min(abs(flow_kg_s) / max(full, 1e-12), 1.0)
        wide = self.valve.overlap + (1.0 - self.valve.overlap) * share
        return math.copysign(wide, flow_kg_s)

    def _fall(self, ratio: float) -> float:
        b = self.valve.critical_ratio
        if ratio <= b:
            return 1.0
        return math.sqrt(max(1.0 - ((ratio - b) / (1.0 - b)) ** 2, 0.0))

    def reset(self) -> None:
        """Forget how the flow changed."""
        self._slope = SpeedTracker(self.foresight_hz)
