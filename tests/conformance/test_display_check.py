"""A good contact-area display keeps every law, and one that breaks a law is named by it."""

import math
from dataclasses import dataclass, replace

import pytest

from palpate.check import check_display
from palpate.core import DeviceError, DisplayRange, DisplaySample, ManualClock, RangeError

RANGE = DisplayRange(height_m=0.01, radius_m=0.0065, greatest_pa=1e5, watchdog_s=0.1)
STEP_S = 1e-3
TAU_S = 0.02  # of its chamber
NS = 1e9


@dataclass
class Chamber:
    """A display whose pressure follows what it is set to, with one flaw by name."""

    clock: ManualClock
    flaw: str = ""
    stated: DisplayRange = RANGE
    pressure_pa: float = 0.0
    target_pa: float = 0.0
    vented: bool = True
    closed: bool = False
    fed_s: float = 0.0
    tells: bool = False
    time_s: float = 0.0

    @property
    def range(self) -> DisplayRange:
        return self.stated

    def now(self, called: bool = True) -> None:
        """Catch up with the clock."""
        self.time_s = self.time_s or self.clock.ns / NS
        lazy = self.flaw == "watchdog in its own calls"
        dead = self.flaw == "no watchdog"
        limit_s = (0.3 if self.flaw == "early watchdog" else 1.0) * RANGE.watchdog_s
        while self.time_s < self.clock.ns / NS - 1e-9:
            self.time_s += STEP_S
            if self.time_s - self.fed_s > limit_s and not (lazy or dead):
                self.target_pa = 0.0
            slow = 50 if self.flaw == "slow vent" and self.target_pa == 0 else 1
            self.pressure_pa += (self.target_pa - self.pressure_pa) * STEP_S / (slow * TAU_S)
        if lazy and self.time_s - self.fed_s > limit_s:
            self.target_pa = 0.0

    def latest(self) -> DisplaySample:
        self.check_open()
        self.now()
        if self.flaw == "look feeds":
            self.fed_s = self.time_s
        time_ns = self.clock.ns
        pushed_m = 0.0
        if self.flaw == "old":
            time_ns -= 300_000_000
        elif self.flaw == "frozen stamps":
            time_ns -= time_ns % 50_000_000
        elif self.flaw == "other clock":
            time_ns = 5
        elif self.flaw == "millimetres":
            pushed_m = 3.0
        elif self.flaw == "no number":
            pushed_m = math.nan
        kilo = 1e-3 if self.flaw == "kilopascal" else 1.0
        absolute = {"absolute pressure": 1.01e5, "signed": -2e4}.get(self.flaw, 0.0)
        fault = "supply pressure low" if self.flaw == "fault" else ""
        if self.tells and not self.vented and self.time_s - self.fed_s > RANGE.watchdog_s:
            fault = "watchdog"
        return DisplaySample(time_ns, pushed_m, kilo * self.pressure_pa + absolute, fault)

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        if not (0 <= pressure_pa <= RANGE.greatest_pa):
            self.refuse(pressure_pa)
            return
        if self.closed and self.flaw == "pressure once closed":
            return
        self.check_open()
        self.now()
        if self.vented and self.flaw != "takes pressure while vented":
            raise DeviceError("vented; release() it")
        self.target_pa, self.fed_s = pressure_pa, self.time_s

    def refuse(self, pressure_pa: float) -> None:
        self.now()
        taken = {"takes too much": pressure_pa > 0, "takes nan": math.isnan(pressure_pa)}
        if taken.get(self.flaw):
            return
        if self.flaw == "zeroing":
            self.target_pa = 0.0
        if self.flaw == "raises another error":
            raise ValueError(pressure_pa)
        raise RangeError(f"{pressure_pa} Pa; give 0 to {RANGE.greatest_pa} Pa")

    def vent(self) -> None:
        self.check_open()
        self.now()
        if self.flaw == "vents once" and self.vented:
            raise DeviceError("it is vented")
        self.vented = True
        if self.flaw != "no vent":
            self.target_pa = 0.0

    def release(self) -> None:
        self.check_open()
        self.now()
        if self.flaw != "never released":
            self.vented = False
        self.fed_s = self.time_s if self.tells else self.fed_s
        if self.flaw == "release restores":
            self.target_pa, self.fed_s = 2e4, self.time_s

    def close(self) -> None:
        if self.closed and self.flaw == "closes once":
            raise DeviceError("closed")
        self.closed = True

    def check_open(self, flaw: str = "lives on") -> None:
        if self.closed and self.flaw != flaw:
            raise DeviceError("closed")


def failed(display: object, clock: ManualClock) -> set[str]:
    return {one.code for one in check_display(display, clock=clock) if not one.ok}


def test_a_good_display_keeps_every_law_and_is_left_vented_and_closed() -> None:
    display = Chamber(clock := ManualClock(10**9))
    found = check_display(display, clock=clock)
    assert [one for one in found if not one.ok] == []
    assert len(found) >= 25
    assert display.vented
    assert display.closed


def test_a_display_that_tells_of_its_watchdog_by_a_fault_keeps_every_law() -> None:
    display = Chamber(clock := ManualClock(10**9), tells=True)
    assert failed(display, clock) == set()


def test_a_display_that_is_not_to_be_closed_is_left_vented_and_open() -> None:
    display = Chamber(clock := ManualClock(10**9))
    check_display(display, clock=clock, close=False)
    assert display.vented
    assert not display.closed


FLAWS = {
    "old": "latest-age",
    "frozen stamps": "time-order",
    "other clock": "latest-age",
    "fault": "no-fault",
    "millimetres": "position-in-range",
    "no number": "position-in-range",
    "absolute pressure": "no-pressure-when-vented",
    "signed": "pressure-in-range",
    "kilopascal": "pressure-reached",
    "never released": "unexpected-error-holding",
    "release restores": "no-pressure-after-release",
    "early watchdog": "holds-within-watchdog",
    "takes too much": "refuses-pressure-range",
    "raises another error": "refuses-pressure-range",
    "takes nan": "refuses-nan",
    "zeroing": "refusal-without-effect",
    "slow vent": "vent-time",
    "takes pressure while vented": "refuses-when-vented",
    "vents once": "vent-any-time",
    "look feeds": "watchdog",
    "no watchdog": "watchdog",
    "watchdog in its own calls": "watchdog-alone",
    "closes once": "close-twice",
    "lives on": "refuses-when-closed",
    "pressure once closed": "refuses-pressure-when-closed",
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_display_that_breaks_a_law_is_named_by_it(flaw: str) -> None:
    display = Chamber(clock := ManualClock(10**9), flaw)
    assert FLAWS[flaw] in failed(display, clock)


@pytest.mark.parametrize("flaw", ["takes nan", "closes once", "zeroing", "look feeds"])
def test_a_single_flaw_breaks_its_own_law_alone(flaw: str) -> None:
    display = Chamber(clock := ManualClock(10**9), flaw)
    assert failed(display, clock) == {FLAWS[flaw]}


def test_a_vent_that_does_nothing_is_seen_although_the_watchdog_vents() -> None:
    display = Chamber(clock := ManualClock(10**9), "no vent")
    assert failed(display, clock) == {"vent-begins", "vent-begins-from-thread"}


@pytest.mark.parametrize(
    "stated",
    [
        replace(RANGE, height_m=10.0),  # mm
        replace(RANGE, radius_m=math.nan),
        replace(RANGE, greatest_pa=100.0),  # kPa
        replace(RANGE, watchdog_s=100.0),  # ms
        replace(RANGE, watchdog_s=0.0),
    ],
)
def test_a_range_in_another_unit_is_not_sane_and_nothing_is_set(stated: DisplayRange) -> None:
    display = Chamber(clock := ManualClock(10**9), stated=stated)
    assert failed(display, clock) == {"range-plausible"}
    assert display.vented
    assert not display.closed


def test_what_is_no_display_is_named_by_what_it_lacks() -> None:
    (finding,) = check_display(object(), clock=ManualClock())
    assert "set_pressure" in finding.message


def test_a_pressure_to_hold_that_it_cannot_is_refused() -> None:
    for pressure_pa in (0.0, 1.1e5, math.nan):
        with pytest.raises(RangeError, match="Pa"):
            check_display(Chamber(clock := ManualClock(10**9)), clock=clock, pressure_pa=pressure_pa)
    with pytest.raises(RangeError, match="vent_s"):
        check_display(Chamber(clock), clock=clock, vent_s=0.0)
