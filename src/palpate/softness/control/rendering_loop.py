"""Rendering loop: reads both devices once per period and commands both.

Every fault, operator command, or exception ends in one safe state: the chamber vents and the arm brakes.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError, DisplaySample, HapticArm, SafetyError, SoftnessDevice
from palpate.devices.motion_limits import Reason, Tripped
from palpate.devices.operator_control import OperatorCommand, OperatorControl, OperatorInterrupt
from palpate.softness.control.bench_watch import BenchLimits, BenchWatch
from palpate.softness.control.servos import ArmServo, BenchState, Reference, ReferenceTable, SpeedTracker
from palpate.softness.rendering_law import Mode

PERIOD_S = 1e-3
TOUCHED_M = 0.05e-3  # of push, from which a finger is there
CHANGE_S = 0.3  # in which one object turns into the next

T = TypeVar("T")

WISHED = {
    OperatorCommand.PAUSE: "the operator asked for a pause",
    OperatorCommand.STOP: "the operator ended it",
    OperatorCommand.ABORT: "the operator ended it",
    OperatorCommand.ESTOP: "the operator asked for an emergency stop",
}
STOPS = tuple(WISHED)


@dataclass(frozen=True, slots=True)
class LoopSample:
    """Measured and commanded values of one period."""

    time_s: float
    pushed_m: float
    arm_m: float
    pressure_pa: float
    told_pa: float
    force_n: float
    area_m2: float
    arm_force_n: float
    error_m: float
    touched: bool

    @property
    def displacement_m(self) -> float:
        """Displacement of the finger's surface [m]."""
        return self.pushed_m + self.arm_m


class RenderingLoop:
    """Renders an object on a display (None in CM2) and an arm.

    Attributes:
        safe: reason why the devices were made safe; empty while rendering.
    """

    def __init__(
        self, display: SoftnessDevice | None, arm: HapticArm, table: ReferenceTable, clock: Clock,
        limits: BenchLimits | None = None, servo: ArmServo | None = None,
        control: OperatorControl | None = None, damping_n_s_m: float = 0.25,
    ) -> None:  # fmt: skip
        self._display, self._arm, self._clock = display, arm, clock
        self._limits, self._servo = limits or BenchLimits(), servo or ArmServo()
        self.control, self._damping = control or OperatorControl(), damping_n_s_m
        self._table, self._changed_ns = table, 0
        self._next: ReferenceTable | None = None
        self._turn = threading.Lock()
        self._check_stated()
        self._watch = BenchWatch(self._limits, None if display is None else display.range, arm.range)
        self._push, self._arm_speed = SpeedTracker(), SpeedTracker()
        self._began_ns = clock.now_ns()
        self._before_ns: int | None = None
        self._told_pa, self._told_n = 0.0, 0.0
        self.safe = ""
        self.last: LoopSample | None = None

    def show(self, table: ReferenceTable) -> None:
        """Turn into another object, over `CHANGE_S`; from any thread."""
        now, then = self._table.law, table.law
        if (then.mode, then.display, then.bounds) != (now.mode, now.display, now.bounds):
            raise SafetyError(
                f"an object in {table.law.mode.value} cannot follow one in {self._table.law.mode.value} "
                "while a finger may be there, nor one of another display or bounds; end this rendering first"
            )
        with self._turn:
            if self._next is not None:
                self._table = self._next
            self._next, self._changed_ns = table, self._clock.now_ns()

    def tick(self) -> LoopSample:
        """One period."""
        if self.safe:
            raise SafetyError(f"this rendering has ended: {self.safe}; begin another")
        try:
            self.last = self._period()
        except OperatorInterrupt as e:
            self.make_safe(WISHED[e.command])
            raise
        except Tripped as e:
            self.make_safe(str(e))
            raise
        except BaseException as e:
            self.make_safe(f"{type(e).__name__}: {e}")
            raise
        return self.last

    def make_safe(self, why: str) -> None:
        """Vent and brake, independently; failures are appended to `safe` and left to the watchdogs."""
        self.safe = self.safe or why  # the first reason is the one to be told
        ways = [("arm did not brake", self._arm.brake)]
        if (display := self._display) is not None:
            ways.insert(0, ("display did not vent", display.vent))
        for name, told in ways:
            for _ in range(2):  # a lost message is sent again
                try:
                    told()
                    break
                except Exception as e:  # the other device has to be told all the same
                    failed = f"; the {name}: {e}"
            else:
                self.safe += failed

    def _period(self) -> LoopSample:
        """One period; an emergency stop in its midst is the reason, not the device that then refuses."""
        self.control.check(STOPS)
        try:
            return self._tick()
        except Tripped:
            self.control.check(STOPS)
            raise

    def _tick(self) -> LoopSample:
        now_ns = self._clock.now_ns()
        self._watch.period(self._before_ns, now_ns)
        dt = PERIOD_S if self._before_ns is None else max((now_ns - self._before_ns) / NS_PER_S, 1e-6)
        self._before_ns = now_ns
        seen, state, wanted = self._read(dt)
        touched = (state.arm_m if self._display is None else state.pushed_m) > TOUCHED_M
        told_pa, rate = self._pressure(state, wanted)
        mode = self._table.law.mode
        asked = self._servo.force_n(mode, state, wanted, touched=touched)
        self._watch.command(wanted.pressure_pa, asked, self._law_pa)
        error, _ = self._servo.error(mode, state, wanted, touched=touched)
        measured_pa = 0.0 if seen is None else seen.pressure_pa
        self._watch.pressure(measured_pa, self._told_pa, now_ns)
        self._watch.touch(state.force_n, state.speed_m_s, dt, now_ns, touched=touched)
        self._watch.arm_error(error, now_ns)
        most, step = min(self._arm.range.force_n, 2 * self._limits.force.force_n), self._limits.step_n
        force = min(max(asked, self._told_n - step, -most), self._told_n + step, most)
        if (display := self._display) is not None:
            _telling(Reason.DISPLAY, lambda: display.set_pressure(told_pa, rate))
        _telling(Reason.ARM, lambda: self._arm.set_force(force))
        self._told_pa, self._told_n = told_pa, force
        return LoopSample(
            (now_ns - self._began_ns) / NS_PER_S, state.pushed_m, state.arm_m, measured_pa, told_pa,
            state.force_n, wanted.area_m2, force, error, touched,
        )  # fmt: skip

    def _read(self, dt: float) -> tuple[DisplaySample | None, BenchState, Reference]:
        seen = None if self._display is None else _telling(Reason.DISPLAY, self._display.latest)
        arm = _telling(Reason.ARM, self._arm.latest)
        self._watch.samples(seen, arm, self._clock.now_ns())
        arm_speed = self._arm_speed.speed(arm.displacement_m, dt)
        if seen is None:
            wanted = self._reference(0.0, arm.displacement_m)
            return None, BenchState(0.0, 0.0, arm.displacement_m, arm_speed, self._told_n), wanted
        wanted = self._reference(seen.pushed_m, seen.pushed_m + arm.displacement_m)
        force = seen.pressure_pa * wanted.area_m2 + self._table.law.display.sleeve_n_m * max(seen.pushed_m, 0)
        push_speed = self._push.speed(seen.pushed_m, dt)
        return seen, BenchState(seen.pushed_m, push_speed, arm.displacement_m, arm_speed, force), wanted

    def _pressure(self, state: BenchState, wanted: Reference) -> tuple[float, float]:
        """Pressure and its rate, with the tip's damping taken off."""
        drag = self._damping * state.push_speed_m_s / max(wanted.area_m2, MIN_M2)
        told = wanted.pressure_pa - drag
        if not math.isfinite(told):
            return told, 0.0
        return min(max(told, 0.0), self._greatest_pa), wanted.pressure_slope * state.push_speed_m_s

    def _reference(self, pushed_m: float, displacement_m: float) -> Reference:
        with self._turn:
            now = self._table.at(pushed_m, displacement_m)
            if self._next is None:
                return now
            share = (self._clock.now_ns() - self._changed_ns) / (CHANGE_S * NS_PER_S)
            then = self._next.at(pushed_m, displacement_m)
            if share >= 1.0:
                self._table, self._next = self._next, None
                return then
            return now.towards(then, share)

    def _check_stated(self) -> None:
        """Refuse what the devices do not have, and watchdogs that would act in every period."""
        law, shown = self._table.law, None if self._display is None else self._display.range
        if (shown is None) != (law.mode is Mode.KINESTHETIC):
            raise SafetyError("CM1 and CM3 need a display, and in CM2 a rigid plate is in its place")
        watchdogs = [("arm", self._arm.range.watchdog_s)]
        self._greatest_pa = 0.0
        self._law_pa = law.bounds.pressure_pa
        if shown is not None:
            self._greatest_pa = min(shown.greatest_pa, law.bounds.pressure_pa)
            watchdogs.append(("display", shown.watchdog_s))
            sizes = [(one.height_m, one.radius_m) for one in (shown, law.display)]
            if not np.allclose(sizes[0], sizes[1], rtol=0.0, atol=SAME_M):
                mm = [f"{1e3 * height:g} mm high, {1e3 * radius:g} mm in radius" for height, radius in sizes]
                raise SafetyError(
                    f"the display is {mm[0]}, and the references are of one {mm[1]}",
                    code="references-of-another",
                )
        for name, watchdog_s in watchdogs:
            if not watchdog_s > self._limits.late_s:
                raise SafetyError(
                    f"the {name}'s watchdog acts after {watchdog_s * 1e3:g} ms, and a period may take "
                    f"{self._limits.late_s * 1e3:g} ms; give it more"
                )


SAME_M = 1e-6
MIN_M2 = 4e-6  # area below which the tip's damping is taken off as there: pressure there means little


def _telling(reason: Reason, call: Callable[[], T]) -> T:
    """Call a device; what it refuses is a reason to stop."""
    try:
        return call()
    except DeviceError as e:
        raise Tripped(reason, str(e)) from e
