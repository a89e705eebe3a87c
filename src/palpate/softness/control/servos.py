"""Pressure servos for a proportional valve: a PID, and a feed-forward of the mass flow.

`FlowServo` inverts the ISO 6358 valve for the flow that makes the gas follow the reference,

    q = V / (n R T) (p_ref' + k (p_ref - p)) - (p + p0) A s' / (R T).

Velocity estimate of a noisy sampled position by a second-order filter that follows ramps.

Servo of the arm: moves the display until force over displacement matches the object.

With tip push s and arm displacement a, the servo drives the force difference over both stiffnesses to 0,

    e = (alpha(A(s)) - beta(s + a)) / (alpha' + beta' + k0),    F = p A + k s - m (w^2 e + 2 z w e').

The slope of e over a stays between -1 and 0 for stiff and soft fingers, unlike that of the printed reference
beta^-1(alpha(A)) - s, which has the same zero. CM3 uses e = -(s + a); CM2 renders beta(a) directly.

References of both devices tabulated at equal steps, for lookup within a period of the loop.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import Float, ndarray
from palpate.softness.display_parts import (
    ANR_DENSITY_KG_M3,
    ATMOSPHERE_PA,
    GAS_J_KG_K,
    ROOM_K,
    Chamber,
    ConeDisplay,
    ProportionalValve,
)
from palpate.softness.rendering_law import Mode, RenderingLaw


@dataclass
class SpeedTracker:
    """An alpha-beta filter with its two poles together at a bandwidth.

    Predict x + v dt, then x += alpha r and v += beta r / dt with the residual r, where alpha = 1 - q^2,
    beta = (1 - q)^2 and q = exp(-2 pi f dt): a ramp is followed without error.

    Reference: P. R. Kalata, IEEE Trans. Aerosp. Electron. Syst. 20 (1984) 174, doi:10.1109/TAES.1984.310438.
    """

    bandwidth_hz: float = 200.0
    _place: float | None = field(default=None, init=False)
    _speed: float = field(default=0.0, init=False)

    def speed(self, place_m: float, dt_s: float) -> float:
        """Speed after one more sample, dt_s after the last one [m/s]."""
        if self._place is None:
            self._place = place_m
            return 0.0
        q = math.exp(-2 * math.pi * self.bandwidth_hz * dt_s)
        ahead = self._place + self._speed * dt_s
        residual = place_m - ahead
        self._place = ahead + (1 - q**2) * residual
        self._speed += (1 - q) ** 2 * residual / dt_s
        return self._speed

    @property
    def place_m(self) -> float:
        """Filtered place [m]; 0 before the first sample."""
        return 0.0 if self._place is None else self._place


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


POINTS = 4001
STEEP_N_M = 2000.0  # by which a force that an object has at no displacement begins

Table = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Piecewise linear values at equal steps from 0, held beyond both ends."""

    step: float
    values: Table

    def at(self, x: float) -> tuple[float, float]:
        """Value and slope."""
        place = x / self.step
        if place <= 0.0:
            return float(self.values[0]), float(self.values[1] - self.values[0]) / self.step
        i = min(int(place), len(self.values) - 2)
        low, high = float(self.values[i]), float(self.values[i + 1])
        return low + min(place - i, 1.0) * (high - low), (high - low) / self.step


@dataclass(frozen=True, slots=True)
class Reference:
    """References in one state: pressure and display force with slopes over push, object force over
    displacement.
    """

    pressure_pa: float
    pressure_slope: float
    force_n: float
    force_slope: float
    area_m2: float
    object_n: float
    object_slope: float

    def towards(self, other: Reference, share: float) -> Reference:
        """So far on the way to another: 0 is this one, 1 the other."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Reference(*(a + share * (b - a) for a, b in pairs))


class ReferenceTable:
    """Tabulated references of a rendering law."""

    def __init__(self, law: RenderingLaw) -> None:
        self.law, self.height_m = law, law.display.height_m
        step = self.height_m / (POINTS - 1)
        self._pressure, self._force, self._area = (Curve(step, one) for one in _of_push(law, step))
        whole = law.object.displacement
        d_step = float(whole.x[-1]) / (POINTS - 1)
        self._object = Curve(d_step, _from_first_touch(law, d_step * np.arange(POINTS)))

    def at(self, pushed_m: float, displacement_m: float) -> Reference:
        """References at a push of the tip and a whole displacement of the finger."""
        pushed = min(max(pushed_m, 0.0), self.height_m)
        return Reference(
            *self._pressure.at(pushed), *self._force.at(pushed), self._area.at(pushed)[0],
            *self._whole(displacement_m),
        )  # fmt: skip

    def _whole(self, displacement_m: float) -> tuple[float, float]:
        """Force of the object and its slope; a first force at no displacement is a steep rise to it."""
        force, slope = self._object.at(displacement_m)
        if displacement_m >= 0.0 or force == 0.0:
            return force, slope
        return max(force + max(slope, STEEP_N_M) * displacement_m, 0.0), max(slope, STEEP_N_M)


def _of_push(law: RenderingLaw, step: float) -> tuple[Table, Table, Table]:
    """Pressure, force and area at equal steps of the display's push."""
    if law.mode is Mode.KINESTHETIC:
        return np.zeros(POINTS), np.zeros(POINTS), np.zeros(POINTS)
    state = law.at(step * np.arange(POINTS))
    pressure = state.pressure_pa.copy()
    pressure[0] = pressure[1]  # at no area any pressure gives no force
    return pressure, state.force_n, state.area_m2


def _from_first_touch(law: RenderingLaw, displacement_m: Table) -> Table:
    """Force over displacement, from 0 where its table begins later."""
    curve = law.object.displacement
    return np.interp(displacement_m, curve.x, curve.force_n)


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
