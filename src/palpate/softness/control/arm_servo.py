"""Servo of the arm: moves the display until force over displacement matches the object.

With tip push s and arm displacement a, the servo drives the force difference over both stiffnesses to 0,

    e = (alpha(A(s)) - beta(s + a)) / (alpha' + beta' + k0),    F = p A + k s - m (w^2 e + 2 z w e').

The slope of e over a stays between -1 and 0 for stiff and soft fingers, unlike that of the printed reference
beta^-1(alpha(A)) - s, which has the same zero. CM3 uses e = -(s + a); CM2 renders beta(a) directly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.softness.control.reference_table import Reference
from palpate.softness.rendering_law import Mode

CREEP_M_S = 0.01  # below which the direction of friction is not told from noise


@dataclass(frozen=True, slots=True)
class BenchState:
    """Sensor state of a bench in one period; `force_n` is the display's, p A and sleeve."""

    pushed_m: float
    push_speed_m_s: float
    arm_m: float
    arm_speed_m_s: float
    force_n: float

    @property
    def displacement_m(self) -> float:
        """Displacement of the finger's surface [m]."""
        return self.pushed_m + self.arm_m

    @property
    def speed_m_s(self) -> float:
        """Speed of the finger's surface [m/s]."""
        return self.push_speed_m_s + self.arm_speed_m_s


@dataclass(frozen=True, slots=True)
class ArmServo:
    """Force of the arm, with m `mass_kg`, w / 2 pi `bandwidth_hz`, z `ratio`, and k0 `floor_n_m`."""

    mass_kg: float = 0.30
    bandwidth_hz: float = 20.0
    ratio: float = 1.6
    floor_n_m: float = 50.0
    friction_n: float = 0.08

    def force_n(self, mode: Mode, now: BenchState, wanted: Reference, *, touched: bool) -> float:
        """Return the force against the press [N]; without touch the arm returns to 0."""
        w = 2 * math.pi * self.bandwidth_hz
        if mode is Mode.KINESTHETIC:
            back = min(now.arm_m, 0.0)  # it stands at 0 where nobody presses
            still = self.mass_kg * w * (w * back + (2 * now.arm_speed_m_s if back else 0.0))
            return wanted.object_n + still - self.friction_n * math.tanh(now.arm_speed_m_s / CREEP_M_S)
        error, slope = self.error(mode, now, wanted, touched=touched)
        return now.force_n - self.mass_kg * w * (w * error + 2 * self.ratio * slope)

    def error(self, mode: Mode, now: BenchState, wanted: Reference, *, touched: bool) -> tuple[float, float]:
        """By which the arm has to move on, and its slope over time [m], [m/s]."""
        if mode is Mode.KINESTHETIC:
            return 0.0, 0.0
        if not touched:
            return -now.arm_m, -now.arm_speed_m_s
        if mode is Mode.CUTANEOUS:
            return -now.displacement_m, -now.speed_m_s
        both = wanted.force_slope + wanted.object_slope + self.floor_n_m
        above = min(now.displacement_m, 0.0)  # the arm stands where no press was
        error = (wanted.force_n - wanted.object_n - self.floor_n_m * above) / both
        slope = (wanted.force_slope * now.push_speed_m_s - wanted.object_slope * now.speed_m_s) / both
        return error, slope
