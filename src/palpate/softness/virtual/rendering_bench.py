"""Virtual bench of a display on an arm under a finger, behind the protocols of both devices.

Each call advances the physics to the clock's time: accelerated with a `ManualClock`, in real time with a
`MonotonicClock`. Each device makes itself safe at the exact time at which its watchdog expires.

The virtual bench with a stiff flat probe and the display clamped in place of the arm.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palpate.core import (
    NS_PER_S,
    ArmRange,
    ArmSample,
    Clock,
    DeviceError,
    DisplayRange,
    DisplaySample,
    Float,
    ManualClock,
    Progress,
    RangeError,
    ndarray,
    silent,
)
from palpate.softness.control.servos import ChamberState, FlowServo, PressureServo, SpeedTracker
from palpate.softness.display_bench_test import (
    BenchTest,
    IndentationPlan,
    PressureResponse,
    measure_pressure_response,
    run_bench_test,
)
from palpate.softness.display_parts import (
    ANR_DENSITY_KG_M3,
    ATMOSPHERE_PA,
    GAS_J_KG_K,
    ROOM_K,
    ArmMechanics,
    Chamber,
    ConeDisplay,
    DisplaySensors,
    FingerMechanics,
    MeantMotion,
    ProportionalValve,
)
from palpate.softness.virtual import bench_kernel as k

STEP_S = 50e-6
TABLE = 2001  # points of area and volume over the tip's way
WATCHDOG_S = 4e-3
MAX_S = 5.0  # that the bench carries on at once; a program that slept longer finds it there


@dataclass(frozen=True, slots=True)
class BenchParts:
    """True parts of a bench; `plate` replaces the display, as in CM2."""

    shape: ConeDisplay = field(default_factory=ConeDisplay)
    valve: ProportionalValve = field(default_factory=ProportionalValve)
    chamber: Chamber = field(default_factory=Chamber)
    sensors: DisplaySensors = field(default_factory=DisplaySensors)
    arm: ArmMechanics = field(default_factory=ArmMechanics)
    finger: FingerMechanics = field(default_factory=FingerMechanics)
    greatest_pa: float = 100e3
    plate: bool = False


@dataclass(frozen=True, slots=True)
class BenchTruth:
    """True state of a bench, cumulative work, and greatest force so far."""

    time_s: float
    force_n: float
    pushed_m: float
    area_m2: float
    arm_m: float
    pressure_pa: float
    opening: float
    work_j: float
    largest_n: float

    @property
    def displacement_m(self) -> float:
        """Displacement of the finger's surface: the display's and the arm's [m]."""
        return self.pushed_m + self.arm_m


class RenderingBench:
    """A virtual bench with its `display` and `arm`."""

    def __init__(
        self, clock: Clock, presses: MeantMotion, parts: BenchParts | None = None,
        servo: PressureServo | None = None, seed: int = 0, watchdog_s: float = WATCHDOG_S,
    ) -> None:  # fmt: skip
        self.parts = parts or BenchParts()
        self.presses, self.clock = presses, clock
        self._figures = _figures(self.parts)
        shape, self._way = self.parts.shape, np.linspace(0.0, self.parts.shape.height_m, TABLE)
        self._areas, self._volumes = shape.area_m2(self._way), shape.volume_m3(self._way)
        self._state = np.zeros(k.STATES)
        self._state[k.PRESSURE] = ATMOSPHERE_PA
        self._state[k.FINGER] = -presses.gap_m
        self._steps, self._began_ns = 0, clock.now_ns()
        self._work = self._largest = 0.0
        self.opening, self.force_n = -1.0, 0.0
        self.turn = threading.RLock()
        self.noise = np.random.default_rng(seed)
        self.display = VirtualDisplay(self, servo or FlowServo(self.parts.shape), watchdog_s)
        self.arm = VirtualArm(self, watchdog_s)

    @property
    def display_if_any(self) -> VirtualDisplay | None:
        """The display; None where a plate is in its place."""
        return None if self.parts.plate else self.display

    def follow(self) -> None:
        """Carry the physics on to now, through the instants at which a watchdog acts."""
        with self.turn:
            now = int((self.clock.now_ns() - self._began_ns) / NS_PER_S / STEP_S + 1e-6)
            now = min(now, self._steps + int(MAX_S / STEP_S))
            while self._steps < now:
                ends = [
                    now,
                    *(one.due_step for one in (self.display, self.arm) if one.due_step > self._steps),
                ]
                self._carry_on(min(ends))
                for one in (self.display, self.arm):
                    if one.due_step <= self._steps:
                        one.watchdog_acts()

    def truth(self) -> BenchTruth:
        """The state now."""
        with self.turn:
            self.follow()
            s = self._state
            area = float(np.interp(s[k.PUSH], self._way, self._areas))
            return BenchTruth(
                self._steps * STEP_S, float(k.pulp_force(s, self._figures)), float(s[k.PUSH]), area,
                float(s[k.ARM]), float(s[k.PRESSURE]) - ATMOSPHERE_PA, float(s[k.SPOOL]),
                self._work, self._largest,
            )  # fmt: skip

    def switch_safety(self, *, off: bool) -> None:
        """Take the safety valve's current away, or give it back."""
        self._figures = self._figures._replace(safe=float(off))

    def brake(self, *, on: bool) -> None:
        """Let the arm brake, or run free."""
        arm = self.parts.arm
        self._figures = self._figures._replace(arm_damping=arm.brake_n_s_m if on else arm.damping_n_s_m)

    def step_in(self, seconds: float) -> int:
        """Number of the step that lies so far ahead."""
        return self._steps + max(1, round(seconds / STEP_S))

    def _carry_on(self, until: int) -> None:
        times = STEP_S * np.arange(self._steps, until)
        meant, speed = self.presses.meant(times, self.parts.finger)
        work, largest = k.advance(
            self._state, self._figures, self._areas, self._volumes, meant, speed,
            self.opening, self.force_n, STEP_S,
        )  # fmt: skip
        self._steps, self._work, self._largest = until, self._work + work, max(self._largest, largest)

    @property
    def state(self) -> Float[ndarray, " n"]:
        """The state itself, for faults that are put in by tests."""
        return self._state


NEVER = 2**62
VELOCITY_HZ = 30.0  # of the arm's own velocity, which a step of its encoder must not shake


class VirtualDisplay:
    """Implements `core.SoftnessDevice` on a bench."""

    def __init__(self, bench: RenderingBench, servo: PressureServo, watchdog_s: float) -> None:
        self._bench, self._servo, self._watchdog_s = bench, servo, watchdog_s
        self._tracker = SpeedTracker()
        self._last_ns: int | None = None
        self._closed = self._vented = False
        self._why = ""
        self.due_step = NEVER

    @property
    def range(self) -> DisplayRange:
        """Shape, greatest pressure and watchdog."""
        shape = self._bench.parts.shape
        return DisplayRange(shape.height_m, shape.radius_m, self._bench.parts.greatest_pa, self._watchdog_s)

    def latest(self) -> DisplaySample:
        """Its state, as the sensors see it."""
        with self._bench.turn:
            self._check_open()
            truth, sensors = self._bench.truth(), self._bench.parts.sensors
            hall, pressure = (
                float(self._bench.noise.normal(0.0, sd))
                for sd in (sensors.hall_noise_m, sensors.pressure_noise_pa)
            )
            return DisplaySample(
                self._bench.clock.now_ns(), truth.pushed_m + hall, truth.pressure_pa + pressure
            )

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        """Hold a pressure, by one period of its servo."""
        greatest = self._bench.parts.greatest_pa
        if not (0.0 <= pressure_pa <= greatest and math.isfinite(rate_pa_s)):
            raise RangeError(
                f"a pressure of {pressure_pa / 1e3:g} kPa, changing by {rate_pa_s / 1e3:g} kPa/s; 0 to "
                f"{greatest / 1e3:g} kPa are allowed"
            )
        with self._bench.turn:
            self._check_open()
            sample = self.latest()
            if self._vented:
                raise DeviceError(
                    f"the display is vented{self._why}; release it before it is to hold pressure",
                    code="display-vented",
                )
            dt = 1e-3 if self._last_ns is None else (sample.time_ns - self._last_ns) / NS_PER_S
            if dt > 0:
                speed = self._tracker.speed(sample.pushed_m, dt)
                now = ChamberState(sample.pressure_pa, sample.pushed_m, speed)
                self._bench.opening = self._servo.opening(pressure_pa, rate_pa_s, now, dt)
            self._last_ns = sample.time_ns
            self.due_step = self._bench.step_in(self._watchdog_s)

    def vent(self) -> None:
        """Open the exhaust, and keep it open."""
        with self._bench.turn:
            self._check_open()
            self._bench.follow()
            self._exhaust()

    def release(self) -> None:
        """Take pressures again."""
        with self._bench.turn:
            self._check_open()
            self._bench.follow()
            self._vented, self._why = False, ""
            self._bench.switch_safety(off=False)

    def close(self) -> None:
        """Vent and let go."""
        with self._bench.turn:
            if not self._closed:
                self.vent()
                self._closed = True

    def watchdog_acts(self) -> None:
        """Vent, since nobody set a pressure for its time."""
        self._why = f" (nobody set a pressure for {self._watchdog_s * 1e3:g} ms; its watchdog vented it)"
        self._exhaust()

    def _exhaust(self) -> None:
        self._bench.opening, self._vented, self.due_step, self._last_ns = -1.0, True, NEVER, None
        self._servo.reset()
        self._bench.switch_safety(off=True)

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError("the display is closed")


class VirtualArm:
    """Implements `core.HapticArm` on a bench."""

    def __init__(self, bench: RenderingBench, watchdog_s: float) -> None:
        self._bench, self._watchdog_s = bench, watchdog_s
        self._tracker = SpeedTracker(VELOCITY_HZ)
        self._last_ns: int | None = None
        self._speed = 0.0
        self._closed = self._braked = False
        self._why = ""
        self.due_step = NEVER

    @property
    def range(self) -> ArmRange:
        """Reach, greatest force and watchdog."""
        arm = self._bench.parts.arm
        return ArmRange(-arm.reach_m, arm.reach_m, arm.force_n, self._watchdog_s)

    def latest(self) -> ArmSample:
        """Its state, as its encoders see it."""
        with self._bench.turn:
            self._check_open()
            place, grid = self._bench.truth().arm_m, self._bench.parts.arm.resolution_m
            seen = round(place / grid) * grid if grid else place
            now = self._bench.clock.now_ns()
            if self._last_ns is None or now > self._last_ns:
                dt = 1e-3 if self._last_ns is None else (now - self._last_ns) / NS_PER_S
                self._speed, self._last_ns = self._tracker.speed(seen, dt), now
            return ArmSample(now, seen, self._speed)

    def set_force(self, force_n: float) -> None:
        """Push with a force."""
        greatest = self._bench.parts.arm.force_n
        if not abs(force_n) <= greatest:
            raise RangeError(f"a force of {force_n:g} N; {greatest:g} N to either side are allowed")
        with self._bench.turn:
            self._check_open()
            self._bench.follow()
            if self._braked:
                raise DeviceError(f"the arm brakes{self._why}; release it before it is to push")
            self._bench.force_n = force_n
            self.due_step = self._bench.step_in(self._watchdog_s)

    def brake(self) -> None:
        """Drop the force."""
        with self._bench.turn:
            self._check_open()
            self._bench.follow()
            self._drop()

    def release(self) -> None:
        """Take forces again."""
        with self._bench.turn:
            self._check_open()
            self._bench.follow()
            self._braked, self._why = False, ""
            self._bench.brake(on=False)

    def close(self) -> None:
        """Brake and let go."""
        with self._bench.turn:
            if not self._closed:
                self.brake()
                self._closed = True

    def watchdog_acts(self) -> None:
        """Drop the force, since nobody set one for its time."""
        self._why = f" (nobody set a force for {self._watchdog_s * 1e3:g} ms; its watchdog dropped it)"
        self._drop()

    def _drop(self) -> None:
        self._bench.force_n, self._braked, self.due_step = 0.0, True, NEVER
        self._bench.brake(on=True)

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError("the arm is closed")


def _figures(parts: BenchParts) -> Any:
    shape, valve, chamber, arm, finger = parts.shape, parts.valve, parts.chamber, parts.arm, parts.finger
    return k.BenchFigures(
        shape.height_m, chamber.dead_m3, chamber.polytropic, GAS_J_KG_K * ROOM_K, ANR_DENSITY_KG_M3,
        ATMOSPHERE_PA, valve.supply_pa, valve.conductance, valve.critical_ratio, valve.overlap,
        2 * math.pi * valve.bandwidth_hz, chamber.tube_lag_s, chamber.leak,
        chamber.safety, chamber.safety_s, chamber.sleeve_n_m,
        chamber.friction_n, chamber.damping_n_s_m, chamber.tip_kg, arm.mass_kg, arm.friction_n,
        arm.damping_n_s_m, arm.lag_s, arm.reach_m, finger.mass_kg, finger.stiffness_n_m,
        finger.damping_n_s_m, finger.pulp_n, finger.pulp_per_m, finger.pulp_damping_n_s_m,
        float(parts.plate), 0.0, k.creep(chamber.friction_n, chamber.tip_kg, STEP_S),
        k.creep(arm.friction_n, arm.mass_kg, STEP_S),
    )  # fmt: skip


Times = Float[ndarray, " n"]

CLAMPED = ArmMechanics(mass_kg=1e12)  # in a minute, 5 N move it by less than a nanometre
PROBE = FingerMechanics(0.05, 1e5, 60.0, 100.0, 1500.0, 10.0, 0.0)  # stiff: some micrometres under 5 N


class HeldProbe:
    """A probe that is where it was told to be."""

    gap_m = 0.0

    def __init__(self) -> None:
        self.way_m = 0.0

    def move(self, way_m: float) -> None:
        """Be at a way of the tip from now on [m]."""
        self.way_m = way_m

    def meant(self, time_s: Times, finger: FingerMechanics) -> tuple[Times, Times]:
        """Places where it is told to be, and no speed [m], [m/s]."""
        return np.full(len(time_s), self.way_m), np.zeros(len(time_s))


def virtual_bench_test(
    plan: IndentationPlan | None = None, parts: BenchParts | None = None, *,
    stated: ConeDisplay | None = None, seed: int = 0, progress: Progress = silent,
) -> BenchTest:  # fmt: skip
    """Run a plan on the virtual bench in accelerated time; `stated` is the assumed display."""
    parts = parts or BenchParts()
    probe, clock = HeldProbe(), ManualClock()
    bench = RenderingBench(clock, probe, replace(parts, arm=CLAMPED, finger=PROBE, plate=False), seed=seed)
    shape = stated or replace(parts.shape, sleeve_n_m=parts.chamber.sleeve_n_m)
    return run_bench_test(
        plan or IndentationPlan(), bench.display, probe.move, lambda: bench.truth().force_n, clock, shape,
        progress,
    )  # fmt: skip


def virtual_pressure_response(
    servo: PressureServo, amplitude_pa: float, parts: BenchParts | None = None, *, seed: int = 0
) -> PressureResponse:
    """Measure a servo's pressure response on the virtual bench, with the tip held halfway."""
    parts = parts or BenchParts()
    probe, clock = HeldProbe(), ManualClock()
    probe.move(parts.shape.height_m / 2)
    clamped = replace(parts, arm=CLAMPED, finger=PROBE, plate=False)
    bench = RenderingBench(clock, probe, clamped, servo, seed=seed)
    return measure_pressure_response(bench.display, amplitude_pa, clock)
