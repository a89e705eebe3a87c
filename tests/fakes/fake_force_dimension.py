"""A fake of an arm of Force Dimension, as forcedimension-core shows it. It fails as it is told to.

Made from the library's public reference and its public source, version 1.0.0, and not from an arm: names,
arguments, the buffers that a call fills, codes, and the modes, watchdog, velocity threshold and brakes that
the reference tells of. Kinematics, joints, friction and the arm's own electronics are not simulated: a point
mass moves under the forces, and a viscosity where it brakes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, MutableSequence, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from types import SimpleNamespace

from palpate.core import NS_PER_S, Clock, Position

TICK_S = 125e-6  # of the watchdog
STEP_S = 1e-4  # of the motion
BRAKE_NS_M = 20.0  # viscosity of the motors in short circuit
FRICTION_NS_M = 0.5
VELOCITY_WINDOW_S = 0.02  # of the library's estimate
FASTEST_M_S = 1.0  # threshold of the velocity
MOTORS_N = 12.0  # that they reach
VELOCITY, WATCHDOG, SOFTWARE = 2, 3, 4

Force = Callable[[float, Position, Position], Position]
"""Force on the arm [N], from the time [s], its place [m] and its velocity [m/s]."""


class ErrorNum(IntEnum):
    """Numbers of errors, as far as they come here."""

    NO_ERROR = 0
    COM = 2
    NO_DEVICE_FOUND = 5
    TIMEOUT = 7
    EXPERT_MODE_DISABLED = 9


@dataclass
class ArmFaults:
    """Faults; none by default. They may be changed at any time.

    Attributes:
        fails: function's name to the number of its call that returns -1, counted from 1.
        stays: it fails from that call on, and not that one alone.
        absent: no device is found.
        uncalibrated: it is in its reset mode.
        disabled: it does not go into its force mode, as without its button.
        saturated: its motors do not reach what is asked.
        frozen: its place no longer changes.
        no_number: its place is not a number.
        deaf: a limit that is set is not taken, though the call succeeds.
    """

    fails: dict[str, int] = field(default_factory=dict)
    stays: bool = False
    absent: bool = False
    uncalibrated: bool = False
    disabled: bool = False
    saturated: bool = False
    frozen: bool = False
    no_number: bool = False
    deaf: bool = False


@dataclass
class DhdStatus:
    """Status, as far as it is used; `getStatus` fills it."""

    power: int = 0
    connected: int = 0
    started: int = 0
    reset: int = 0
    idle: int = 0
    force: int = 0
    brake: int = 0
    error: int = 0
    gravity: int = 0
    forceoffcause: int = 0


class FakeForceDimension:
    """Stands in for the module forcedimension_core, with one arm behind it.

    Args:
        clock: by which it moves; it catches up at every call.
        place_m: where it begins [m].
        mass_kg: that its motors move [kg].
        push: force on it from outside, such as a finger's; none where it is left out.

    Attributes:
        calls: name and arguments of every call, the arm's number left out.
        place_m, velocity_m_s: of the arm, truly [m, m/s].
        braked, enabled: which mode it is in; idle where it is in neither.
        hook: called with the name of a function before it does anything, for what another thread does then.
    """

    def __init__(
        self,
        clock: Clock,
        place_m: Position = (0.0, 0.0, 0.0),
        mass_kg: float = 0.3,
        push: Force | None = None,
        faults: ArmFaults | None = None,
    ) -> None:
        self.clock, self.mass_kg, self.push = clock, mass_kg, push
        self.faults = faults or ArmFaults()
        self.place_m, self.velocity_m_s = place_m, (0.0, 0.0, 0.0)
        self.calls: list[tuple[str, tuple[object, ...]]] = []
        self.counts: dict[str, int] = {}
        self.hook: Callable[[str], None] = lambda name: None
        self.opened, self.enabled, self.braked, self.cause = False, False, False, 0
        self.max_force_n, self.effector_kg, self.gravity = -1.0, 0.0, True
        self.ticks, self.expert_mode, self.threshold_m_s = 0, False, FASTEST_M_S
        self._force_n: Position = (0.0, 0.0, 0.0)
        self._forced_s = self._time_s = clock.now_ns() / NS_PER_S
        self._seen: deque[tuple[float, Position]] = deque()
        self._error = ErrorNum.NO_ERROR
        self.dhd = _Dhd(self)
        self.constants = SimpleNamespace(TIMEGUARD=1, MOTOR_SATURATED=2, ErrorNum=ErrorNum)
        self.containers = SimpleNamespace(Status=DhdStatus)

    @property
    def force_n(self) -> Position:
        """Force of its motors now, in the device's axes [N]."""
        return self._force_n if self.enabled else (0.0, 0.0, 0.0)

    def begins(self, name: str, *arguments: object) -> bool:
        """Note a call and catch up; False where the call fails."""
        self.hook(name)
        self.calls.append((name, arguments))
        self.counts[name] = count = self.counts.get(name, 0) + 1
        self.catch_up()
        self._error = ErrorNum.NO_ERROR
        at = self.faults.fails.get(name)
        if at is not None and (count == at or (self.faults.stays and count > at)):
            self._error = ErrorNum.COM
            return False
        if not self.opened and name not in ("open", "openSerial"):
            self._error = ErrorNum.NO_DEVICE_FOUND
            return False
        return True

    def catch_up(self) -> None:
        """Move the arm until now, in steps of 0.1 ms, and let its firmware look at each."""
        now_s = self.clock.now_ns() / NS_PER_S
        while self._time_s < now_s - 1e-9:
            step_s = min(STEP_S, now_s - self._time_s)
            self._watch()
            self._move(step_s)
            self._time_s += step_s

    def _watch(self) -> None:
        late = self.ticks and self._time_s - self._forced_s > self.ticks * TICK_S
        if self.enabled and late:
            self.turn_off(WATCHDOG)
        elif self.enabled and max(map(abs, self.velocity_m_s)) > self.threshold_m_s:
            self.turn_off(VELOCITY)

    def turn_off(self, cause: int) -> None:
        """Drop the force and brake."""
        self.enabled, self.braked, self.cause = False, True, cause

    def _move(self, step_s: float) -> None:
        drag = FRICTION_NS_M + (BRAKE_NS_M if self.braked else 0.0)
        pushed = (0.0, 0.0, 0.0)
        if self.push is not None:
            pushed = self.push(self._time_s, self.place_m, self.velocity_m_s)
        velocity = [
            (speed + step_s / self.mass_kg * (own + other)) / (1 + step_s / self.mass_kg * drag)
            for speed, own, other in zip(self.velocity_m_s, self.force_n, pushed, strict=True)
        ]
        place = [at + step_s * speed for at, speed in zip(self.place_m, velocity, strict=True)]
        self.velocity_m_s = (velocity[0], velocity[1], velocity[2])
        self.place_m = (place[0], place[1], place[2])

    def look(self) -> Position:
        """Place as it is reported, kept for the estimate of velocity [m]."""
        place_m = self.place_m
        if self.faults.no_number:
            place_m = (math.nan,) * 3
        elif self.faults.frozen and self._seen:
            place_m = self._seen[-1][1]
        now_s = self.clock.now_ns() / NS_PER_S
        self._seen.append((now_s, place_m))
        while self._seen[0][0] < now_s - VELOCITY_WINDOW_S:
            self._seen.popleft()
        return place_m

    def speed(self) -> Position | None:
        """Velocity over the window [m/s]; None where fewer than two places lie in it."""
        (first_s, first), (last_s, last) = (self._seen[0], self._seen[-1]) if self._seen else ((0, ()),) * 2
        if last_s <= first_s:
            return None
        speeds = [(b - a) / (last_s - first_s) for a, b in zip(first, last, strict=True)]
        return speeds[0], speeds[1], speeds[2]

    def take_force(self, force_n: Sequence[float]) -> int:
        """Take a force, and return the code of it."""
        length, share = math.hypot(*force_n), 1.0
        if 0 <= self.max_force_n < length:
            share = self.max_force_n / length
        code = 0
        if self.faults.saturated or share * length > MOTORS_N:
            code, share = self.constants.MOTOR_SATURATED, min(share, MOTORS_N / max(length, MOTORS_N))
        x, y, z = (share * one for one in force_n)
        self._force_n, self._forced_s = (x, y, z), self._time_s
        return code

    def fail(self, error: ErrorNum) -> int:
        """Code of a call that failed for a reason of its own."""
        self._error = error
        return -1

    @property
    def error(self) -> ErrorNum:
        """Error of the last call."""
        return self._error


class _Dhd:
    """The module dhd: calls return 0 on success and -1 otherwise, unless they say."""

    def __init__(self, arm: FakeForceDimension) -> None:
        self._arm = arm
        self.expert = _Expert(arm)

    def open(self) -> int:
        return self._found(self._arm.begins("open"))

    def openSerial(self, serial: int) -> int:
        return self._found(self._arm.begins("openSerial", serial))

    def _found(self, ok: bool) -> int:
        if not ok or self._arm.faults.absent:
            return self._arm.fail(ErrorNum.NO_DEVICE_FOUND)
        self._arm.opened = True
        return 0

    def close(self, ID: int = -1) -> int:
        if not self._arm.begins("close"):
            return -1
        self._arm.opened = False
        return 0

    def stop(self, ID: int = -1) -> int:
        if not self._arm.begins("stop"):
            return -1
        self._arm.turn_off(SOFTWARE)
        return 0

    def enableForce(self, enable: bool, ID: int = -1) -> int:
        if not self._arm.begins("enableForce", enable):
            return -1
        if not enable:
            self._arm.turn_off(SOFTWARE)
        elif not self._arm.faults.disabled:
            self._arm.enabled, self._arm.braked, self._arm.cause = True, False, 0
            self._arm._forced_s = self._arm._time_s
        return 0

    def getStatus(self, out: DhdStatus, ID: int = -1) -> int:
        arm = self._arm
        if not arm.begins("getStatus"):
            return -1
        out.power = out.connected = out.started = 1
        out.reset = int(arm.faults.uncalibrated)
        out.force, out.brake, out.idle = (
            int(arm.enabled),
            int(arm.braked),
            int(not (arm.enabled or arm.braked)),
        )
        out.gravity, out.forceoffcause = int(arm.gravity), arm.cause
        return 0

    def setMaxForce(self, limit: float, ID: int = -1) -> int:
        if not self._arm.begins("setMaxForce", limit):
            return -1
        if not self._arm.faults.deaf:
            self._arm.max_force_n = limit
        return 0

    def getMaxForce(self, ID: int = -1) -> float:
        """Limit [N], -1 where there is none."""
        return self._arm.max_force_n if self._arm.begins("getMaxForce") else -1.0

    def setEffectorMass(self, mass: float, ID: int = -1) -> int:
        if not self._arm.begins("setEffectorMass", mass):
            return -1
        self._arm.effector_kg = mass
        return 0

    def getEffectorMass(self, ID: int = -1) -> float:
        """Mass [kg], -1 where it fails."""
        return self._arm.effector_kg if self._arm.begins("getEffectorMass") else -1.0

    def setGravityCompensation(self, enable: bool, ID: int = -1) -> int:
        if not self._arm.begins("setGravityCompensation", enable):
            return -1
        self._arm.gravity = enable
        return 0

    def getPosition(self, out: MutableSequence[float], ID: int = -1) -> int:
        """Fill `out` with x, y, z [m]; 1 where the place is one that was read just before."""
        if not self._arm.begins("getPosition"):
            return -1
        out[0], out[1], out[2] = self._arm.look()
        return 0

    def getLinearVelocity(self, out: MutableSequence[float], ID: int = -1) -> int:
        """Fill `out` with x, y, z [m/s]; fails where places are too few."""
        if not self._arm.begins("getLinearVelocity"):
            return -1
        speed = self._arm.speed()
        if speed is None:
            return self._arm.fail(ErrorNum.TIMEOUT)
        out[0], out[1], out[2] = speed
        return 0

    def setForce(self, f: Sequence[float], ID: int = -1) -> int:
        """Take x, y, z [N]; 2 where the motors do not reach it."""
        if not self._arm.begins("setForce", tuple(f)):
            return -1
        return self._arm.take_force(f)

    def errorGetLast(self) -> ErrorNum:
        return self._arm.error

    def errorGetLastStr(self) -> str:
        return self._arm.error.name.lower().replace("_", " ")


class _Expert:
    """The module dhd.expert; its calls fail until its mode is on."""

    def __init__(self, arm: FakeForceDimension) -> None:
        self._arm = arm

    def enableExpertMode(self) -> int:
        return self._switch("enableExpertMode", True)

    def disableExpertMode(self) -> int:
        return self._switch("disableExpertMode", False)

    def _switch(self, name: str, on: bool) -> int:
        if not self._arm.begins(name):
            return -1
        self._arm.expert_mode = on
        return 0

    def setWatchdog(self, duration: int, ID: int = -1) -> int:
        """Take multiples of 125 us; 0 is off. The library hands over a byte, in which 256 is 0."""
        if not self._arm.begins("setWatchdog", duration):
            return -1
        if not self._arm.expert_mode:
            return self._arm.fail(ErrorNum.EXPERT_MODE_DISABLED)
        self._arm.ticks = duration & 0xFF
        return 0

    def getWatchdog(self, ID: int = -1) -> int:
        """Multiples of 125 us, -1 where it fails."""
        return self._arm.ticks if self._arm.begins("getWatchdog") else -1
