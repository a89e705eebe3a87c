"""Servo of the arm: it carries the display to where force over displacement is the object's.

Of the tip's push s and the arm's displacement a, the object asks that beta(s + a) = alpha(A(s)). The
report's reference for the arm is a_ref = beta^-1(alpha(A)) - s, and it has the same zero. But a finger that
holds still turns every movement of the arm into one of the tip, s = y - a, so that for an object harder than
the display the arm runs after a reference that runs from it: the loop's gain comes to 1 where contact begins.
So what is driven to 0 here is the difference of the two forces, over both stiffnesses,

    e = (alpha(A(s)) - beta(s + a)) / (alpha' + beta' + k0),

whose slope over a lies between -1 and 0 whether the finger is stiff or soft. k0 makes the arm indifferent
where neither cue has force. In CM3 the whole displacement is to be 0: e = -(s + a). In CM2 a rigid plate is
in the display's place, and the arm gives beta(a) itself, with its own friction taken off.

    F = p A + k s - m (w^2 e + 2 z w e')

The first two terms carry the finger's force; m is the arm's mass, w its bandwidth. A bandwidth 1.5 times the
default's oscillates in CM3 on the virtual bench, whose loop is some 4 ms late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.softness.control.reference_table import Reference
from palpate.softness.rendering_law import Mode

CREEP_M_S = 0.01  # below which the direction of friction is not told from noise


@dataclass(frozen=True, slots=True)
class BenchState:
    """What the sensors of a bench say in one period.

    Attributes:
        force_n: of the display, from its measured pressure: p A and the sleeve's [N].
    """

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
    """Force of the arm in one period.

    Attributes:
        mass_kg: m, that the arm moves, as it is believed [kg].
        friction_n: Coulomb, of the arm, as it is believed [N].
    """

    mass_kg: float = 0.30
    bandwidth_hz: float = 20.0
    ratio: float = 1.6
    floor_n_m: float = 50.0
    friction_n: float = 0.08

    def force_n(self, mode: Mode, now: BenchState, wanted: Reference, *, touched: bool) -> float:
        """Force against the finger's press [N].

        Args:
            touched: whether a finger presses; where none does, the arm goes to 0.
        """
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
