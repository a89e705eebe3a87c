"""Checks of a haptic arm against `core.HapticArm`, by small pushes in free air."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from palpate.core import NS_PER_S, ArmSample, Clock, DeviceError, HapticArm, RangeError
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    arm_interface,
    at_most,
    call_elsewhere,
    check_closing,
    describe,
    gather,
    judge,
    on_clock,
    refusal,
    seconds,
    verdict,
)

PUSHED_M = 1e-3  # by which a push moves it before it ends
PUSH_S = 0.3  # that a push lasts at most
MARGIN_M = 1e-3  # by which it may read beyond its stated reach
STAND_M_S = 5e-3  # that is as good as a stand
FASTER = 1.5  # times the speed of a watchdog that was seen to work
LATE_S = 0.05  # after which a velocity tells what the force is, by an estimate over 20 ms
COAST_S = 0.1  # in which a force that still acts is seen to speed it up
DRIFT_M = 1e-3  # of an arm that is let go and not pushed
SAME_RATE = 0.5  # by which the integral of velocity may miss the way
LOOKS = 20
POLL_S = 2e-3
AGE_S = 0.1  # of the newest sample
FEEDS = 5.0  # new forces within a watchdog's time
QUIET = 0.5  # of the watchdog's time, in which no force need come
BEYOND = 1.01  # times the greatest force


class _OutsideError(Exception):
    """The arm has left the way that it was given, or may do so."""


@dataclass(slots=True)
class ArmTrial:
    """Arm under check, and where it may move.

    Attributes:
        arm: of the driver.
        clock: that it stamps on.
        way_m: least and greatest displacement of it [m].
        force_n: of a push [N].
        brake_s: time in which it comes to a stand [s].
        samples: of the last push.
    """

    arm: HapticArm
    clock: Clock
    way_m: tuple[float, float]
    force_n: float
    brake_s: float
    samples: list[ArmSample] = field(default_factory=list)

    def look(self) -> ArmSample:
        """A sample; the arm is braked and the check ended where that lies outside the way."""
        sample = self.arm.latest()
        if not self.way_m[0] <= sample.displacement_m <= self.way_m[1]:
            self.arm.brake()
            raise _OutsideError(f"it is at {sample.displacement_m} m, outside {self.way_m} m")
        return sample

    def inwards_n(self) -> float:
        """Force of a push towards the middle of its way [N]."""
        above = self.look().displacement_m > sum(self.way_m) / 2
        return self.force_n if above else -self.force_n

    def push(self, force_n: float) -> float:
        """Push until it has moved, or for some time; the way that it moved [m]."""
        start = self.look()
        self.samples, end_s = [start], seconds(self.clock) + PUSH_S
        while abs(self.moved_m) < PUSHED_M and seconds(self.clock) < end_s:
            self.arm.set_force(force_n)
            self.clock.sleep(self.period_s)
            self.samples.append(self.look())
        return self.moved_m

    def watch(self, time_s: float) -> list[ArmSample]:
        """Look for a time, without a force."""
        seen, end_s = [self.look()], seconds(self.clock) + time_s
        while seconds(self.clock) < end_s:
            self.clock.sleep(POLL_S)
            seen.append(self.look())
        return seen

    def stand(self) -> float:
        """Brake; the time until it stands, infinite where it does not in time [s]."""
        self.arm.brake()
        return self.standing_s()

    def standing_s(self) -> float:
        """Time until it stands [s]; infinite where it does not in time."""
        start_s = seconds(self.clock)
        while abs(self.look().velocity_m_s) > STAND_M_S:
            if seconds(self.clock) - start_s > self.brake_s:
                return math.inf
            self.clock.sleep(POLL_S)
        return seconds(self.clock) - start_s

    @property
    def moved_m(self) -> float:
        """Way of the last push [m]."""
        return self.samples[-1].displacement_m - self.samples[0].displacement_m

    @property
    def period_s(self) -> float:
        """Time between two forces [s]."""
        return min(POLL_S, self.arm.range.watchdog_s / FEEDS)


def check_arm(
    arm: object,
    *,
    clock: Clock,
    way_m: tuple[float, float],
    force_n: float = 1.0,
    brake_s: float = 0.5,
    close: bool = True,
) -> list[CheckResult]:
    """Check a driver of a haptic arm, by pushing it a little along its axis.

    The arm stands in the middle of the way, with nobody's hand on it. Each push ends after 1 mm, or 0.3 s. It
    is braked, and nothing is pushed any more, as soon as it is seen outside the way. A driver whose watchdog
    does not work goes on for that watchdog's time and 0.15 s more, unseen: choose the force so small, and the
    way with so much air beside it, that this does no harm. Forces that it has to refuse are asked for too; an
    arm that takes one is braked at once.

    Args:
        arm: the driver's, a `core.HapticArm`.
        clock: that it stamps on: `MonotonicClock` for a real one.
        way_m: least and greatest displacement, inside its reach [m]. All of it is free air.
        force_n: of the pushes, more than its friction [N].
        brake_s: time in which its brake brings it to less than 5 mm/s [s].
        close: close it at the end, and check that.

    Raises:
        RangeError: no such way, force or time; nothing was pushed.
    """
    if not 0 < brake_s < math.inf:
        raise RangeError(f"brake_s is {brake_s} s; give a number above 0 s")
    findings = [*gather("protocol", arm_interface(arm))]
    if not (isinstance(arm, HapticArm) and all(one.ok for one in findings)):
        return findings
    stated = arm.range
    if not stated.least_m <= way_m[0] < way_m[1] - 4 * PUSHED_M <= stated.greatest_m - 4 * PUSHED_M:
        raise RangeError(
            f"a way from {way_m[0]} to {way_m[1]} m; give {4e3 * PUSHED_M:g} mm and more, inside "
            f"{stated.least_m} to {stated.greatest_m} m"
        )
    if not 0 < force_n <= stated.force_n:
        raise RangeError(f"pushes of {force_n} N; give above 0 and up to {stated.force_n:g} N")
    findings += _all_parts(ArmTrial(arm, clock, way_m, force_n, brake_s))
    if close:
        findings += gather("close", check_closing(arm, arm.latest, "latest()"))
        findings += gather("close", _refuses_force("refuses-force-when-closed", arm, 0.0))
    return findings


def _all_parts(trial: ArmTrial) -> Iterator[CheckResult]:
    """All parts, each ended by the brake; one that leaves the arm where it must not be ends the check."""
    parts: tuple[tuple[str, Callable[[ArmTrial], Part]], ...] = (
        ("looking", _looking), ("releasing", _releasing), ("refusing", _refusing), ("pushing", _pushing),
        ("braking", _braking), ("braking-from-thread", _braking_elsewhere), ("watchdog", _watchdog),
    )  # fmt: skip
    for what, part in parts:
        outside: list[_OutsideError] = []
        try:
            yield from gather(what, _inside(part(trial), outside))
        finally:
            error = refusal(trial.arm.brake)
        if error is not None:
            yield verdict("brake-any-time", False, f"brake() {describe(error)}; switch it off")
            return
        if outside:
            yield verdict("stays-on-path", False, f"{outside[0]}; nothing was pushed after that")
            return


def _inside(part: Part, outside: list[_OutsideError]) -> Part:
    try:
        yield from part
    except _OutsideError as e:
        outside.append(e)


def _looking(trial: ArmTrial) -> Part:
    arm, clock = trial.arm, trial.clock
    arm.brake()
    stated, looks = arm.range, []
    for _ in range(LOOKS):
        looks.append((arm.latest(), clock.now_ns()))
        clock.sleep(POLL_S)
    samples = [sample for sample, _ in looks]
    shaped = all(isinstance(one, ArmSample) for one in samples)
    yield verdict("sample-type", shaped, f"latest() gave {samples[0]!r}; give a palpate.core.ArmSample")
    if not shaped:
        raise _OutsideError("where it is is not known")
    yield on_clock(arm.latest().time_ns, clock)
    age_s = max((now_ns - one.time_ns) / NS_PER_S for one, now_ns in looks)
    yield at_most("latest-age", age_s, AGE_S, "s", "no force is controlled by a sample that is older")
    stands = int(np.count_nonzero(np.diff([one.time_ns for one in samples]) <= 0))
    yield at_most("time-order", stands, 0, "", f"{stands} of {LOOKS} looks were no newer than the one before")
    faults = sorted({one.fault for one in samples if one.fault})
    yield verdict("no-fault", not faults, f"{faults}; see to the device")
    places = [one.displacement_m for one in samples]
    yield verdict(
        "position-in-range",
        all(stated.least_m - MARGIN_M <= one <= stated.greatest_m + MARGIN_M for one in places),
        f"{min(places)} to {max(places)} m, of {stated.least_m} to {stated.greatest_m} m; is it in m?",
    )
    yield at_most(
        "still-when-braked", _wandered_m(samples), DRIFT_M, "m", "let it come to rest before the check"
    )
    trial.look()


def _wandered_m(samples: list[ArmSample]) -> float:
    """Way between the outermost places, which the noise of a velocity does not touch [m]."""
    return float(np.ptp([one.displacement_m for one in samples]))


def _releasing(trial: ArmTrial) -> Part:
    yield from _refuses_force("refuses-when-braked", trial.arm, 0.0)
    trial.arm.release()
    before = trial.look()
    end_s = seconds(trial.clock) + COAST_S
    while seconds(trial.clock) < end_s:
        trial.arm.set_force(0.0)
        trial.clock.sleep(trial.period_s)
        after = trial.look()
    yield at_most(
        "still-at-no-force",
        abs(after.displacement_m - before.displacement_m), DRIFT_M, "m",
        "it moves by itself: is its own weight, with what it carries, made up for?",
    )  # fmt: skip


def _refusing(trial: ArmTrial) -> Part:
    """Forces that are not allowed; an arm that takes one is braked at once."""
    most_n = BEYOND * trial.arm.range.force_n
    asked = {
        "refuses-force-range": (most_n, -most_n, math.inf, -math.inf),
        "refuses-nan": (math.nan,),
    }
    moved_m = [0.0]
    for code, forces in asked.items():
        for force_n in forces:
            trial.arm.release()
            trial.arm.set_force(0.0)
            before = trial.look()
            error = refusal(lambda force_n=force_n: trial.arm.set_force(force_n))  # type: ignore[misc]
            refused = isinstance(error, RangeError)
            if refused:
                trial.clock.sleep(QUIET * trial.arm.range.watchdog_s)
                moved_m.append(abs(trial.look().displacement_m - before.displacement_m))
            trial.stand()
            if not refused:
                break
        yield verdict(
            code, refused, f"set_force({force_n}) {describe(error)}; raise RangeError and change nothing"
        )
    yield at_most(
        "refusal-without-effect", float(np.max(moved_m)), DRIFT_M, "m",
        "it moved although the force that was asked for was refused",
    )  # fmt: skip


def _pushing(trial: ArmTrial) -> Part:
    """Push both ways, towards the middle first."""
    first_n = trial.inwards_n()
    for force_n in (first_n, -first_n):
        trial.arm.release()
        moved_m = trial.push(force_n)
        seen = [*trial.samples, *_while_braking(trial)]
        way = "against" if force_n > 0 else "with"
        yield judge(
            f"force-sign-{way}", moved_m * force_n < 0, moved_m, 0.0, "m",
            f"{force_n:g} N moved it by {moved_m:g} m; a positive force pushes the finger back, so that the "
            "displacement falls: is a sign wrong, or the force less than the friction?",
        )  # fmt: skip
        times = np.array([one.time_ns for one in seen]) / NS_PER_S
        speeds = np.array([one.velocity_m_s for one in seen])
        by_speed_m = float(np.trapezoid(speeds, times))
        way_m = seen[-1].displacement_m - seen[0].displacement_m
        yield at_most(
            f"velocity-{way}",
            abs(by_speed_m - way_m) / max(abs(way_m), 1e-9), SAME_RATE, "",
            f"it moved by {way_m:g} m and its velocity tells {by_speed_m:g} m; is it in m/s, with this sign?",
        )  # fmt: skip


def _while_braking(trial: ArmTrial) -> list[ArmSample]:
    trial.arm.brake()
    return trial.watch(COAST_S)


def _braking(trial: ArmTrial) -> Part:
    trial.arm.release()
    trial.push(trial.inwards_n())
    yield at_most(
        "brake-time", trial.stand(), trial.brake_s, "s",
        f"it is not slower than {1e3 * STAND_M_S:g} mm/s by then; did the force drop?",
    )  # fmt: skip
    yield from _refuses_force("refuses-after-brake", trial.arm, trial.force_n)
    seen = trial.watch(COAST_S)
    yield at_most(
        "stays-braked", _wandered_m(seen), DRIFT_M, "m",
        "it moves again although it was not released",
    )  # fmt: skip
    trial.arm.release()
    moved_m = trial.push(trial.inwards_n())
    yield judge(
        "moves-after-release", abs(moved_m) >= PUSHED_M / 2, abs(moved_m), PUSHED_M / 2, "m",
        "after brake and release a force does not move it",
    )  # fmt: skip


def _braking_elsewhere(trial: ArmTrial) -> Part:
    trial.stand()
    trial.arm.release()
    trial.push(trial.inwards_n())
    returned, error = call_elsewhere(trial.arm.brake, trial.arm.latest)
    stood_s = trial.standing_s() if returned else math.inf
    refused = refusal(lambda: trial.arm.set_force(0.0))
    yield judge(
        "brake-from-thread",
        error is None and isinstance(refused, DeviceError) and stood_s <= trial.brake_s,
        stood_s, trial.brake_s, "s",
        f"brake() in another thread {describe(error)}; it must be safe while others ask for samples",
    )  # fmt: skip


def _watchdog(trial: ArmTrial) -> Part:
    """Let no force come, first looking on and then with no call at all."""
    watchdog_s = trial.arm.range.watchdog_s
    trial.stand()
    trial.arm.release()
    trial.arm.set_force(trial.inwards_n())
    before = trial.watch(watchdog_s + LATE_S)
    after = trial.watch(COAST_S)
    reached = max(abs(one.velocity_m_s) for one in before)
    went_on = max(abs(one.velocity_m_s) for one in after)
    yield at_most(
        "watchdog", went_on, reached + STAND_M_S, "m/s",
        "it went on being pushed; does latest() feed the watchdog? Only a new force may",
    )  # fmt: skip
    trial.stand()
    trial.arm.release()
    trial.arm.set_force(trial.inwards_n())
    trial.clock.sleep(watchdog_s + LATE_S + COAST_S)
    alone = abs(trial.look().velocity_m_s)
    yield at_most(
        "watchdog-alone", alone, FASTER * reached + STAND_M_S, "m/s",
        "it drops it only once it is called; the watchdog must lie in the device, for a program that is gone",
    )  # fmt: skip
    trial.stand()
    trial.arm.release()
    moved_m = trial.push(trial.inwards_n())
    yield judge(
        "moves-after-watchdog", abs(moved_m) >= PUSHED_M / 2, abs(moved_m),
        PUSHED_M / 2, "m", "release() must bring it back after its own braking as after another",
    )  # fmt: skip


def _refuses_force(code: str, arm: HapticArm, force_n: float) -> Part:
    error = refusal(lambda: arm.set_force(force_n))
    yield verdict(code, isinstance(error, DeviceError), f"set_force {describe(error)}; raise DeviceError")
