"""A linear rig that a small motor drives under proportional and derivative control: its real approach.

    m v' = u - b v - f(v) - F(z - s)      support of place z and speed v, tip's force F below the surface s
    u = clip(Kp (c - e) + Kd (e' - e), F_max)      at every tick of the control, held until the next
    e = q round(z / q)                             encoder; e' at the tick before; c the place asked for

All is told at the support: u is what the motor would push while it stands, its back-EMF is a part of b, its
rotor a part of m. Without an integral term the support stays behind: by (b v + f + F) / Kp along a ramp under
a load, and the derivative's share, see `LinearRig.lag_m`. Friction f is Coulomb's, and greater at rest
(Stribeck), so that slow moves stick and slip.

Steps are semi-implicit: damping and the load's slope at the new speed, and friction as the impulse that
opposes it, no greater than what brings it to rest (Moreau's time stepping). So neither load nor friction can
make energy, and a stuck support stands still. First order in the step.

The preset is the rig of the TacTip's compliance report, source "R" of `sensors.tactip.tactip_spec`. "Q" is
public firmware of boards like its own, in which the encoder's 12 bits are written as 16, the effort is a duty
cycle in per cent, and the derivative is of the measured place, from tick to tick.

A straight move with finite acceleration: where it is at any time, and how it ends when it is told to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, no_type_check

import numba
import numpy as np

from palpate.core import Float, InputError, Position, ndarray

Series = Float[ndarray, " n"]
Knots = Float[ndarray, " k"]
TICKS = 65536  # of the board's angle in a revolution (Q)


@dataclass(frozen=True, slots=True)
class LinearRig:
    """Numbers of a support on cogwheels, its motor, encoder, control and load cell.

    Attributes:
        name: of the preset.
        gear: revolutions of the motor in one of the pinion. R: 35, a Maxon DCX8 with a GPX8.
        efficiency: of the gears, as a factor of the torque. Assumed.
        stall_n_m, no_load_rad_s: of the motor at a duty cycle of 100 % of R's 12 V [N m, rad/s]. Assumed: of
            the size of an 8 mm motor of half a watt.
        rotor_kg_m2: inertia of the rotor [kg m^2]. Assumed.
        lead_m: way of the support in one revolution of pinion and encoder [m]. Assumed: a pinion of 8 mm.
        encoder_bits: of a revolution; None for an encoder without steps. R: 12, an AS5045.
        gain_p: duty cycle over error [% a tick of 1/65536 revolution]. R: 0.04; its unit by Q, assumed.
        gain_d: duty cycle over the place's change since the tick before [the same]. R: 0.002; likewise.
        control_hz: ticks of the control a second. R: 1000.
        moving_kg: mass of support and tip [kg]. Assumed; its weight is left out, as it is constant.
        viscous_n_s_m: friction of the guides in proportion to speed [N s/m]. Assumed.
        coulomb_n, breakaway_n: friction while it moves fast, and from rest [N]. Assumed.
        creep_m_s: Stribeck's speed, over which friction falls from one to the other [m/s]. Assumed.
        steps: of the integration in a tick of the control.
        cell_n: range of the load cell along and across the tip's axis [N]. Assumed: that of the Mini45 whose
            step is R's 1/16 N. Noise and step are the sensor's own, see `ForceSensorSpec`.
    """

    name: str = "linear"
    gear: float = 35.0
    efficiency: float = 0.7
    stall_n_m: float = 1.3e-3
    no_load_rad_s: float = 1300.0
    rotor_kg_m2: float = 3e-9
    lead_m: float = 2 * math.pi * 4e-3
    encoder_bits: int | None = 12
    gain_p: float = 0.04
    gain_d: float = 0.002
    control_hz: float = 1000.0
    moving_kg: float = 0.25
    viscous_n_s_m: float = 10.0
    coulomb_n: float = 0.4
    breakaway_n: float = 0.5
    creep_m_s: float = 1e-3
    steps: int = 20
    cell_n: tuple[float, float] = (290.0, 145.0)

    def __post_init__(self) -> None:
        positive = (
            self.gear, self.efficiency, self.stall_n_m, self.no_load_rad_s, self.lead_m,
            self.gain_p, self.control_hz, self.moving_kg, self.creep_m_s, self.steps, *self.cell_n,
        )  # fmt: skip
        others = (self.rotor_kg_m2, self.gain_d, self.viscous_n_s_m, self.coulomb_n)
        sound = all(one > 0 for one in positive) and all(one >= 0 for one in others)
        if not (sound and self.breakaway_n >= self.coulomb_n):
            raise InputError(
                f"rig {self.name!r}: sizes, gains and rates are above 0, inertia, damping and friction 0 or "
                f"more, and friction from rest ({self.breakaway_n:g} N) no less than in motion "
                f"({self.coulomb_n:g} N)"
            )

    @property
    def radius_m(self) -> float:
        """Radius of the pinion [m]."""
        return self.lead_m / (2 * math.pi)

    @property
    def quantum_m(self) -> float:
        """Way in a step of the encoder, 0 without steps [m]."""
        return 0.0 if self.encoder_bits is None else self.lead_m / 2**self.encoder_bits

    @property
    def greatest_n(self) -> float:
        """Push of the standing motor at a duty cycle of 100 % [N]."""
        return self.efficiency * self.stall_n_m * self.gear / self.radius_m

    @property
    def stiffness_n_m(self) -> float:
        """The proportional gain at the support, Kp [N/m]."""
        return self._at_support(self.gain_p)

    @property
    def derivative_n_m(self) -> float:
        """The derivative gain at the support, Kd, of the change in a tick of the control [N/m]."""
        return self._at_support(self.gain_d)

    @property
    def damping_n_s_m(self) -> float:
        """Damping b of guides and back-EMF [N s/m]."""
        return self.viscous_n_s_m + self.greatest_n * self.gear / (self.no_load_rad_s * self.radius_m)

    @property
    def mass_kg(self) -> float:
        """Mass m of what moves, with the rotor's inertia through the gears [kg]."""
        return self.moving_kg + self.rotor_kg_m2 * (self.gear / self.radius_m) ** 2

    def droop_m(self, force_n: float) -> float:
        """How far the support stands behind under a load, without friction, F / Kp [m]."""
        return force_n / self.stiffness_n_m

    def lag_m(self, speed_m_s: float, force_n: float = 0.0) -> float:
        """How far it moves behind along a ramp under a load [m].

        The derivative is of the measured place, and so drags as damping does: Kd over a tick of the control.
        """
        drag = self.damping_n_s_m + self.derivative_n_m / self.control_hz
        friction = self.coulomb_n * math.copysign(1.0, speed_m_s) if speed_m_s else 0.0
        return self.droop_m(drag * speed_m_s + friction + force_n)

    def read_m(self, place_m: Series) -> Series:
        """Places as the encoder has them [m]."""
        q = self.quantum_m
        return q * np.rint(place_m / q) if q > 0 else np.array(place_m)

    def ticks_in(self, rate_hz: float) -> int:
        """Ticks of the control between two samples of a rate."""
        ticks = round(self.control_hz / rate_hz)
        if ticks < 1 or not math.isclose(ticks * rate_hz, self.control_hz):
            raise InputError(
                f"samples at {rate_hz:g} Hz beside a control at {self.control_hz:g} Hz; a whole number of "
                "its ticks lies between two samples, as at 200 Hz"
            )
        return ticks

    def _at_support(self, gain: float) -> float:
        return gain / 100 * self.greatest_n * TICKS / self.lead_m


LINEAR_RIG = LinearRig()
"""The report's."""

NO_DEPTH, NO_LOAD = np.array([0.0, 1.0]), np.zeros(2)


class LinearDrive:
    """Motion of a rig's support.

    Args:
        rig: its numbers.
        place_m: where it begins [m].
        speed_m_s: with which it begins; it stands where left out [m/s].
    """

    def __init__(self, rig: LinearRig, place_m: float, speed_m_s: float = 0.0) -> None:
        self.rig = rig
        before = place_m - speed_m_s / rig.control_hz
        self._state = np.array([place_m, speed_m_s, float(rig.read_m(np.array([before]))[0])])

    @property
    def place_m(self) -> float:
        """Where the support is [m]."""
        return float(self._state[0])

    @property
    def speed_m_s(self) -> float:
        """Its speed [m/s]."""
        return float(self._state[1])

    def follow(
        self, asked_m: Series, depth_m: Knots = NO_DEPTH, force_n: Knots = NO_LOAD, surface_m: float = 0.0
    ) -> Series:
        """Let the control go on, and tell where the support is after each of its ticks.

        Args:
            asked_m: place asked for at every tick [m].
            depth_m, force_n: knots of the load's law, the depth rising from 0, where there is no force;
                beyond the last it goes on along a straight line; without them there is no load [m, N].
            surface_m: place of first touch [m].

        Returns:
            The support's places [m].
        """
        rig, asked = self.rig, np.ascontiguousarray(asked_m, dtype=np.float64)
        sizes = (rig.stiffness_n_m, rig.derivative_n_m, rig.greatest_n, rig.quantum_m)
        body = (rig.mass_kg, rig.damping_n_s_m, rig.coulomb_n, rig.breakaway_n, rig.creep_m_s)
        step_s = 1 / (rig.control_hz * rig.steps)
        return advanced(
            self._state, asked, sizes, body, rig.steps, step_s, depth_m, force_n, float(surface_m)
        )


@numba.njit(cache=True)
@no_type_check
def advanced(state, asked, sizes, body, steps, dt, depths, forces, surface):
    """Places after each tick of the control; `state` (place, speed, reading) goes along."""
    Kp, Kd, most, q = sizes
    m, b, moving, resting, creep = body
    z, v, before = state[0], state[1], state[2]
    places = np.empty(len(asked))
    for i in range(len(asked)):
        e = q * np.rint(z / q) if q > 0 else z
        u = min(max(Kp * (asked[i] - e) + Kd * (before - e), -most), most)
        before = e
        for _ in range(steps):
            F, slope = load(z - surface, depths, forces)
            p = m * v / dt + u - F
            f = moving + (resting - moving) * math.exp(-((v / creep) ** 2))
            v = 0.0 if abs(p) <= f else (p - math.copysign(f, p)) / (m / dt + b + slope * dt)
            z += dt * v
        places[i] = z
    state[0], state[1], state[2] = z, v, before
    return places


@numba.njit(cache=True)
@no_type_check
def load(depth, depths, forces):
    """Force [N] and its slope [N/m] at a depth."""
    if depth <= depths[0]:
        return 0.0, 0.0
    i = min(np.searchsorted(depths, depth), len(depths) - 1)
    slope = (forces[i] - forces[i - 1]) / (depths[i] - depths[i - 1])
    return forces[i - 1] + slope * (depth - depths[i - 1]), slope


RIGS: dict[str, LinearRig | None] = {"ideal": None, "linear": LINEAR_RIG}
"""Rigs of virtual presses by name; an ideal one is wherever it is asked to be."""


def rig_named(name: str) -> LinearRig | None:
    """A rig of `RIGS`; None for the ideal one.

    Raises:
        InputError: there is none of this name.
    """
    if name not in RIGS:
        raise InputError(f"there is no virtual rig {name!r}; there are {', '.join(RIGS)}")
    return RIGS[name]


def rig_record(rig: LinearRig | None) -> dict[str, Any]:
    """A rig in plain numbers, with what follows from them."""
    if rig is None:
        return {"name": "ideal"}
    names = ("quantum_m", "greatest_n", "stiffness_n_m", "derivative_n_m", "damping_n_s_m", "mass_kg")
    fields = {name: getattr(rig, name) for name in rig.__dataclass_fields__}
    return fields | {name: getattr(rig, name) for name in names}


Times = Float[ndarray, " n"]
Places = Float[ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion up to speed, along, and down again; a stand where start and target are one.

    Attributes:
        start_m, target_m: from and to [m].
        speed_m_s, acceleration_m_s2: at most.
        begun_s: when [s].
        stopped_s: when it began to slow down on request; never, as a rule.
    """

    start_m: Position
    target_m: Position
    speed_m_s: float
    acceleration_m_s2: float
    begun_s: float
    stopped_s: float = math.inf

    @property
    def length_m(self) -> float:
        """Length from start to target [m]."""
        return math.dist(self.start_m, self.target_m)

    @property
    def top_m_s(self) -> float:
        """The speed it reaches."""
        return min(self.speed_m_s, math.sqrt(self.length_m * self.acceleration_m_s2))

    @property
    def ends_s(self) -> float:
        """Time when it stands [s]."""
        if self.length_m == 0:
            return self.begun_s
        v, a = self.top_m_s, self.acceleration_m_s2
        ends = self.begun_s + self.length_m / v + v / a
        if self.stopped_s >= ends:
            return ends
        return self.stopped_s + self._speed(self.stopped_s) / a

    def at(self, time_s: Times) -> Places:
        """Places at times [m]."""
        return np.array([self.place_m(one) for one in time_s.tolist()]).reshape(-1, 3)

    def place_m(self, time_s: float) -> Position:
        """Place at a time [m]: in plain numbers, since a stage is asked for it at every look of its guard."""
        if self.length_m == 0:
            return self.start_m
        share = self._gone(time_s) / self.length_m
        x, y, z = (a + share * (b - a) for a, b in zip(self.start_m, self.target_m, strict=True))
        return x, y, z

    def _gone(self, time_s: float) -> float:
        gone = self._unstopped(min(time_s, self.stopped_s))
        if time_s <= self.stopped_s:
            return gone
        v, a = self._speed(self.stopped_s), self.acceleration_m_s2
        braked = min(time_s - self.stopped_s, v / a)
        return min(gone + v * braked - a * braked**2 / 2, self.length_m)

    def _unstopped(self, time_s: float) -> float:
        v, a = self.top_m_s, self.acceleration_m_s2
        whole = self.length_m / v + v / a
        t = min(max(time_s - self.begun_s, 0.0), whole)
        up, down = min(t, v / a), max(t - (whole - v / a), 0.0)
        steady = min(max(t - v / a, 0.0), whole - 2 * v / a)
        return a * up**2 / 2 + v * steady + v * down - a * down**2 / 2

    def _speed(self, time_s: float) -> float:
        v, a = self.top_m_s, self.acceleration_m_s2
        whole = self.length_m / v + v / a
        t = min(max(time_s - self.begun_s, 0.0), whole)
        return min(a * t, v, a * (whole - t))


def standing(at_m: Position, time_s: float) -> Motion:
    """No move at all."""
    return Motion(at_m, at_m, 1.0, 1.0, time_s)
