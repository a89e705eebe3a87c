"""Checks of a contact-area display against `core.SoftnessDevice`, with no finger on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError, DisplaySample, RangeError, SoftnessDevice
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    at_most,
    call_elsewhere,
    check_closing,
    describe,
    display_interface,
    gather,
    judge,
    on_clock,
    refusal,
    seconds,
    verdict,
)

SHARE = 0.25  # of the greatest pressure, that is held where nothing else is asked for
NEAR = 0.05  # of the held pressure: so near is the same, and near to 0
WAY = 0.05  # of its height, by which a tip may read beyond its way
LOOKS = 20
POLL_S = 5e-3
AGE_S = 0.1  # of the newest sample
FEEDS = 5.0  # new pressures within a watchdog's time
QUIET = 0.5  # of the watchdog's time, for which it must hold by itself
BEYOND = 1.01  # times the greatest pressure


@dataclass(frozen=True, slots=True)
class DisplayTrial:
    """Display under check, and what it is asked for.

    Attributes:
        display: of the driver.
        clock: that it stamps on.
        pressure_pa: that is held [Pa].
        settle_s, vent_s: time to reach it, and to fall near 0 [s].
    """

    display: SoftnessDevice
    clock: Clock
    pressure_pa: float
    settle_s: float
    vent_s: float

    @property
    def near_pa(self) -> float:
        """Pressure that is as good as none [Pa]."""
        return NEAR * self.pressure_pa

    def pressure_now_pa(self) -> float:
        """Gauge pressure that it measures now, not a number where the sample is faulty [Pa]."""
        sample = self.display.latest()
        return math.nan if sample.fault else sample.pressure_pa

    def hold(self, time_s: float) -> float:
        """Set the pressure over and over for a time; its error at the end [Pa]."""
        end_s = seconds(self.clock) + time_s
        while seconds(self.clock) < end_s:
            self.display.set_pressure(self.pressure_pa)
            self.clock.sleep(min(POLL_S, self.display.range.watchdog_s / FEEDS))
        return abs(self.pressure_now_pa() - self.pressure_pa)

    def fall_s(self, patience_s: float) -> float:
        """Time until the pressure is near 0, looking all the time [s]; infinite where it is not in time."""
        start_s = seconds(self.clock)
        while not self.pressure_now_pa() <= self.near_pa:
            if seconds(self.clock) - start_s > patience_s:
                return math.inf
            self.clock.sleep(POLL_S)
        return seconds(self.clock) - start_s

    def highest_pa(self, time_s: float) -> float:
        """Greatest pressure of all good samples over a time; not a number where none is good [Pa]."""
        seen, end_s = [self.pressure_now_pa()], seconds(self.clock) + time_s
        while seconds(self.clock) < end_s:
            self.clock.sleep(POLL_S)
            seen.append(self.pressure_now_pa())
        return max((one for one in seen if not math.isnan(one)), default=math.nan)


def check_display(
    display: object,
    *,
    clock: Clock,
    pressure_pa: float | None = None,
    settle_s: float = 1.0,
    vent_s: float = 0.5,
    close: bool = True,
) -> list[CheckResult]:
    """Check a driver of a contact-area display that no finger touches.

    It is put under pressure and vented some times, and vented at the end whatever happens. Pressures that it
    has to refuse are asked for too; one that it takes is vented at once. It takes a few times the watchdog's
    time.

    Args:
        display: the driver's, a `core.SoftnessDevice`.
        clock: that it stamps on: `MonotonicClock` for a real one.
        pressure_pa: that is held, above 0 [Pa]; a quarter of its greatest where left out.
        settle_s: time in which it reaches that to 5 % [s].
        vent_s: time in which a vent brings it down to 5 % of that [s].
        close: close it at the end, and check that.

    Raises:
        RangeError: no such pressure or time; nothing was set.
    """
    for name, value in (("settle_s", settle_s), ("vent_s", vent_s)):
        if not 0 < value < math.inf:
            raise RangeError(f"{name} is {value} s; give a number above 0 s")
    findings = [*gather("protocol", display_interface(display))]
    if not (isinstance(display, SoftnessDevice) and all(one.ok for one in findings)):
        return findings
    greatest_pa = display.range.greatest_pa
    held_pa = SHARE * greatest_pa if pressure_pa is None else pressure_pa
    if not 0 < held_pa <= greatest_pa:
        raise RangeError(f"a pressure of {held_pa} Pa to hold; give above 0 and up to {greatest_pa:g} Pa")
    findings += _all_parts(DisplayTrial(display, clock, held_pa, settle_s, vent_s))
    if close:
        uses = (display.latest, lambda: display.set_pressure(0.0))
        findings += gather("close", check_closing(display, uses[0], "latest()"))
        findings += gather("close", _refuses_pressure("refuses-pressure-when-closed", uses[1]))
    return findings


def _all_parts(trial: DisplayTrial) -> Iterator[CheckResult]:
    """All parts, each ended by a vent; one that is not taken ends the check."""
    parts: tuple[tuple[str, Callable[[DisplayTrial], Part]], ...] = (
        ("looking", _looking), ("holding", _holding), ("refusing", _refusing), ("venting", _venting),
        ("venting-from-thread", _venting_elsewhere), ("watchdog", _watchdog),
        ("watchdog-alone", _watchdog_alone),
    )  # fmt: skip
    for what, part in parts:
        try:
            yield from gather(what, part(trial))
        finally:
            error = refusal(trial.display.vent)
        if error is not None:
            yield verdict("vent-any-time", False, f"vent() {describe(error)}; shut the air off")
            return


def _looking(trial: DisplayTrial) -> Part:
    display, clock = trial.display, trial.clock
    display.vent()
    clock.sleep(trial.vent_s)
    stated, looks = display.range, []
    for _ in range(LOOKS):
        looks.append((display.latest(), clock.now_ns()))
        clock.sleep(POLL_S)
    samples = [sample for sample, _ in looks]
    shaped = all(isinstance(one, DisplaySample) for one in samples)
    yield verdict("sample-type", shaped, f"latest() gave {samples[0]!r}; give a palpate.core.DisplaySample")
    if not shaped:
        return
    yield on_clock(display.latest().time_ns, clock)
    age_s = max((now_ns - one.time_ns) / NS_PER_S for one, now_ns in looks)
    yield at_most("latest-age", age_s, AGE_S, "s", "no pressure is controlled by a sample that is older")
    stands = int(np.count_nonzero(np.diff([one.time_ns for one in samples]) <= 0))
    yield at_most("time-order", stands, 0, "", f"{stands} of {LOOKS} looks were no newer than the one before")
    faults = sorted({one.fault for one in samples if one.fault})
    yield verdict("no-fault", not faults, f"{faults}; see to the device")
    slack_m, slack_pa = WAY * stated.height_m, NEAR * stated.greatest_pa
    pushed, pressure = [one.pushed_m for one in samples], [one.pressure_pa for one in samples]
    yield verdict(
        "position-in-range",
        all(-slack_m <= one <= stated.height_m + slack_m for one in pushed),
        f"pushed_m from {min(pushed)} to {max(pushed)} m, of {stated.height_m} m; is it in m, 0 when free?",
    )
    yield verdict(
        "pressure-in-range",
        all(-slack_pa <= one <= stated.greatest_pa + slack_pa for one in pressure),
        f"{min(pressure)} to {max(pressure)} Pa, of {stated.greatest_pa} Pa; is it gauge pressure, in Pa?",
    )
    yield at_most(
        "no-pressure-when-vented", float(np.abs(pressure).max()), trial.near_pa, "Pa",
        "vented it reads this; is it gauge pressure, and its zero taken off?",
    )  # fmt: skip


def _holding(trial: DisplayTrial) -> Part:
    trial.display.release()
    yield at_most(
        "no-pressure-after-release",
        trial.highest_pa(QUIET * trial.vent_s), trial.near_pa, "Pa", "release() must begin with 0 Pa",
    )  # fmt: skip
    yield at_most(
        "pressure-reached", trial.hold(trial.settle_s), trial.near_pa, "Pa",
        f"{trial.settle_s:g} s after {trial.pressure_pa:g} Pa were set it is off by this; is the supply on?",
    )  # fmt: skip
    trial.display.set_pressure(trial.pressure_pa)
    trial.clock.sleep(QUIET * trial.display.range.watchdog_s)
    yield at_most(
        "holds-within-watchdog", abs(trial.pressure_now_pa() - trial.pressure_pa),
        trial.near_pa, "Pa", "it let go before its stated watchdog ran out; state a shorter watchdog_s",
    )  # fmt: skip


def _refusing(trial: DisplayTrial) -> Part:
    """Pressures that are not allowed; whatever is taken is vented at once."""
    greatest_pa = trial.display.range.greatest_pa
    asked = {
        "refuses-pressure-range": (-trial.near_pa, BEYOND * greatest_pa, math.inf, -math.inf),
        "refuses-nan": (math.nan,),
    }
    moved_pa = [0.0]
    for code, pressures in asked.items():
        for pressure_pa in pressures:
            trial.display.release()
            trial.hold(trial.settle_s)
            error = refusal(lambda pressure_pa=pressure_pa: trial.display.set_pressure(pressure_pa))  # type: ignore[misc]
            refused = isinstance(error, RangeError)
            if refused:
                trial.clock.sleep(QUIET * trial.display.range.watchdog_s)
                moved_pa.append(abs(trial.pressure_now_pa() - trial.pressure_pa))
            trial.display.vent()
            if not refused:
                break
        yield verdict(
            code,
            refused,
            f"set_pressure({pressure_pa}) {describe(error)}; raise RangeError and change nothing",
        )
    yield at_most(
        "refusal-without-effect", float(np.max(moved_pa)), trial.near_pa, "Pa",
        "the pressure moved although what was asked for was refused",
    )  # fmt: skip


def _venting(trial: DisplayTrial) -> Part:
    trial.display.release()
    trial.hold(trial.settle_s)
    trial.display.vent()
    start_s = seconds(trial.clock)
    yield _begun(trial, "vent-begins")
    trial_s = trial.fall_s(trial.vent_s)
    fell_s = seconds(trial.clock) - start_s if trial_s < math.inf else math.inf
    yield at_most(
        "vent-time", fell_s, trial.vent_s, "s",
        f"it is not below {trial.near_pa:g} Pa by then; does the valve open, is the hose narrow?",
    )  # fmt: skip
    yield from _refuses_pressure("refuses-when-vented", lambda: trial.display.set_pressure(trial.pressure_pa))
    yield at_most(
        "stays-vented", trial.highest_pa(trial.settle_s), trial.near_pa, "Pa",
        "pressure came back although it was not released",
    )  # fmt: skip
    trial.display.release()
    yield at_most(
        "pressure-after-release", trial.hold(trial.settle_s), trial.near_pa, "Pa",
        "after vent and release the pressure that was set is not reached",
    )  # fmt: skip


def _venting_elsewhere(trial: DisplayTrial) -> Part:
    trial.display.release()
    trial.hold(trial.settle_s)
    returned, error = call_elsewhere(trial.display.vent, trial.display.latest)
    yield _begun(trial, "vent-begins-from-thread")
    fell_s = trial.fall_s(trial.vent_s) if returned else math.inf
    yield judge(
        "vent-from-thread", error is None and fell_s <= trial.vent_s, fell_s, trial.vent_s, "s",
        f"vent() in another thread {describe(error)}; it must be safe while others ask for samples",
    )  # fmt: skip


def _begun(trial: DisplayTrial, code: str) -> CheckResult:
    """Whether the pressure falls soon after a vent, since later the watchdog vents in any case."""
    trial.clock.sleep(QUIET * trial.display.range.watchdog_s)
    left_pa = trial.pressure_now_pa()
    return at_most(
        code, left_pa, trial.pressure_pa - trial.near_pa, "Pa",
        "after half of the watchdog's time the pressure has not begun to fall; does vent() reach the device?",
    )  # fmt: skip


def _watchdog(trial: DisplayTrial) -> Part:
    yield at_most(
        "watchdog", _after_silence(trial, looked_at=True),
        trial.near_pa, "Pa",
        "the pressure stayed; does latest() feed the watchdog? Only a new pressure may",
    )  # fmt: skip
    yield at_most(
        "pressure-after-watchdog",
        trial.hold(trial.settle_s), trial.near_pa, "Pa",
        "release() must bring it back after its own vent as after another",
    )  # fmt: skip


def _watchdog_alone(trial: DisplayTrial) -> Part:
    """The same with no call at all, so that a watchdog in the driver's own calls is found out."""
    yield at_most(
        "watchdog-alone", _after_silence(trial, looked_at=False), trial.near_pa, "Pa",
        "it vents only once it is called; the watchdog must lie in the device, for a program that is gone",
    )  # fmt: skip


def _after_silence(trial: DisplayTrial, *, looked_at: bool) -> float:
    """Pressure that is left after a time without a new one [Pa]."""
    trial.display.release()
    trial.hold(trial.settle_s)
    trial.display.set_pressure(trial.pressure_pa)
    end_s = seconds(trial.clock) + trial.display.range.watchdog_s + trial.vent_s
    while looked_at and seconds(trial.clock) < end_s:
        trial.display.latest()
        trial.clock.sleep(POLL_S)
    trial.clock.sleep(max(0.0, end_s - seconds(trial.clock)))
    trial.display.release()
    return trial.pressure_now_pa()


def _refuses_pressure(code: str, call: Callable[[], None]) -> Part:
    error = refusal(call)
    yield verdict(code, isinstance(error, DeviceError), f"set_pressure {describe(error)}; raise DeviceError")
