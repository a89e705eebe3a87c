"""A good haptic arm keeps every law, and one that breaks a law is named by it."""

import math
from dataclasses import dataclass, replace

import pytest
from tests.fakes.fake_force_dimension import FakeForceDimension

from palpate.check import check_arm
from palpate.core import ArmRange, ArmSample, DeviceError, ManualClock, RangeError
from palpate.softness.real.force_dimension_arm import ForceDimensionArm, ForceDimensionSpec

RANGE = ArmRange(least_m=-0.05, greatest_m=0.05, force_n=5.0, watchdog_s=0.02)
WAY_M = (-0.03, 0.03)
STEP_S = 1e-4
MASS_KG = 0.5
FREE_NS_M, BRAKE_NS_M = 0.5, 20.0
NS = 1e9


@dataclass
class Mass:
    """An arm that is a mass on a slide, with one flaw by name."""

    clock: ManualClock
    flaw: str = ""
    stated: ArmRange = RANGE
    place_m: float = 0.0
    speed_m_s: float = 0.0
    force_n: float = 0.0
    braked: bool = True
    dropped: bool = False
    closed: bool = False
    fed_s: float = 0.0
    braked_s: float = 0.0
    noise_m_s: float = 0.0
    time_s: float = 0.0

    @property
    def range(self) -> ArmRange:
        return self.stated

    def now(self) -> None:
        """Catch up with the clock."""
        self.time_s = self.time_s or self.clock.ns / NS
        lazy, dead = self.flaw == "lazy watchdog", self.flaw == "no watchdog"
        while self.time_s < self.clock.ns / NS - 1e-9:
            self.time_s += STEP_S
            if self.late and not (lazy or dead):
                self.dropped = True
            drag = BRAKE_NS_M if self.braked or self.dropped else FREE_NS_M
            drag = FREE_NS_M if self.flaw == "soft brake" else drag
            force_n = -self.force_n if not (self.braked or self.dropped) else 0.0
            lets_go = self.flaw == "lets go" and self.braked and self.time_s - self.braked_s > 0.05
            force_n += 0.4 if lets_go else 0.0
            drag = FREE_NS_M if lets_go else drag
            force_n += 0.5 if self.flaw == "sinks" and not self.braked else 0.0
            self.speed_m_s += STEP_S / MASS_KG * (force_n - drag * self.speed_m_s)
            self.place_m += STEP_S * self.speed_m_s
        self.dropped = self.dropped or (lazy and self.late)

    @property
    def late(self) -> bool:
        return self.time_s - self.fed_s > RANGE.watchdog_s

    def latest(self) -> ArmSample:
        self.check_open()
        self.now()
        if self.flaw == "look feeds":
            self.fed_s = self.time_s
        scale = {"millimetres": 1e3, "reversed": -1.0}.get(self.flaw, 1.0)
        speed = {"millimetres a second": 1e3, "velocity reversed": -1.0}.get(self.flaw, 1.0)
        place_m = math.nan if self.flaw == "no number" else scale * self.place_m
        time_ns = self.clock.ns
        if self.flaw == "old":
            time_ns -= 300_000_000
        elif self.flaw == "frozen stamps":
            time_ns -= time_ns % 50_000_000
        return ArmSample(
            time_ns,
            place_m + (0.06 if self.flaw == "out of reach" else 0.0),
            speed * scale * self.speed_m_s + self.noise_m_s * math.sin(self.clock.ns),
            "motor saturated" if self.flaw == "fault" else "",
        )

    def set_force(self, force_n: float) -> None:
        if not abs(force_n) <= RANGE.force_n:
            self.refuse(force_n)
            return
        if self.closed and self.flaw == "force once closed":
            return
        self.check_open()
        self.now()
        if self.braked and self.flaw != "takes force while braked":
            raise DeviceError("it brakes; release() it")
        self.force_n, self.fed_s = (0.0 if self.flaw == "weak" else force_n), self.time_s

    def refuse(self, force_n: float) -> None:
        self.now()
        if {"takes too much": not math.isnan(force_n), "takes nan": math.isnan(force_n)}.get(self.flaw):
            return
        if self.flaw == "kicks":
            self.speed_m_s = 0.12
        raise RangeError(f"{force_n} N; give up to {RANGE.force_n} N")

    def brake(self) -> None:
        self.check_open()
        self.now()
        if self.flaw == "brakes once" and self.braked:
            raise DeviceError("it brakes")
        self.braked, self.braked_s = True, self.time_s

    def release(self) -> None:
        self.check_open()
        self.now()
        if self.flaw == "released once" and self.dropped:
            raise DeviceError("its watchdog ran out")
        self.braked, self.dropped = False, False
        self.force_n, self.fed_s = 0.0, self.time_s

    def close(self) -> None:
        if self.closed and self.flaw == "closes once":
            raise DeviceError("closed")
        self.closed = True

    def check_open(self) -> None:
        if self.closed and self.flaw != "lives on":
            raise DeviceError("closed")


def failed(arm: object, clock: ManualClock, force_n: float = 1.0) -> set[str]:
    found = check_arm(arm, clock=clock, way_m=WAY_M, force_n=force_n)
    return {one.code for one in found if not one.ok}


def test_a_good_arm_keeps_every_law_and_is_left_braked_and_closed() -> None:
    arm = Mass(clock := ManualClock(10**9))
    found = check_arm(arm, clock=clock, way_m=WAY_M)
    assert [one for one in found if not one.ok] == []
    assert len(found) >= 25
    assert arm.braked
    assert arm.closed


def test_a_velocity_with_noise_breaks_no_law() -> None:
    arm = Mass(clock := ManualClock(10**9), noise_m_s=0.01)
    assert failed(arm, clock) == set()


@pytest.mark.parametrize("press_sign", [1, -1])
def test_the_driver_of_force_dimension_keeps_every_law(press_sign: int) -> None:
    clock = ManualClock(10**9)
    spec = ForceDimensionSpec("z", press_sign, (0.0, 0.0, 0.0), -0.05, 0.05, force_n=5.0, effector_kg=0.2)
    arm = ForceDimensionArm(spec, clock, FakeForceDimension(clock))
    assert failed(arm, clock) == set()


FLAWS = {
    "old": "latest-age",
    "frozen stamps": "time-order",
    "fault": "no-fault",
    "out of reach": "position-in-range",
    "no number": "position-in-range",
    "takes force while braked": "refuses-when-braked",
    "sinks": "still-at-no-force",
    "takes too much": "refuses-force-range",
    "takes nan": "refuses-nan",
    "kicks": "refusal-without-effect",
    "reversed": "force-sign-against",
    "weak": "force-sign-with",
    "velocity reversed": "velocity-against",
    "millimetres a second": "velocity-with",
    "millimetres": "stays-on-path",
    "soft brake": "brake-time",
    "lets go": "stays-braked",
    "brakes once": "brake-any-time",
    "look feeds": "watchdog",
    "lazy watchdog": "watchdog-alone",
    "released once": "unexpected-error-watchdog",
    "closes once": "close-twice",
    "lives on": "refuses-when-closed",
    "force once closed": "refuses-force-when-closed",
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_an_arm_that_breaks_a_law_is_named_by_it(flaw: str) -> None:
    arm = Mass(clock := ManualClock(10**9), flaw)
    assert FLAWS[flaw] in failed(arm, clock)
    assert arm.braked


@pytest.mark.parametrize("flaw", ["takes nan", "closes once", "look feeds", "lazy watchdog"])
def test_a_single_flaw_breaks_its_own_law_alone(flaw: str) -> None:
    arm = Mass(clock := ManualClock(10**9), flaw)
    assert failed(arm, clock, force_n=0.3) == {FLAWS[flaw]}


def test_an_arm_without_a_watchdog_is_found_out_and_braked() -> None:
    arm = Mass(clock := ManualClock(10**9), "no watchdog")
    assert failed(arm, clock) & {"watchdog", "stays-on-path"}
    assert arm.braked


def test_an_arm_that_stands_outside_its_way_is_never_released() -> None:
    arm = Mass(clock := ManualClock(10**9), place_m=0.04)
    assert failed(arm, clock) == {"stays-on-path"}
    assert arm.force_n == 0.0
    assert arm.place_m == pytest.approx(0.04)


@pytest.mark.parametrize(
    "stated",
    [
        replace(RANGE, greatest_m=50.0),  # mm
        replace(RANGE, greatest_m=-0.06),
        replace(RANGE, force_n=math.nan),
        replace(RANGE, watchdog_s=20.0),  # ms
        replace(RANGE, watchdog_s=0.0),
    ],
)
def test_a_range_that_is_not_sane_is_named_and_nothing_is_pushed(stated: ArmRange) -> None:
    arm = Mass(clock := ManualClock(10**9), stated=stated)
    assert failed(arm, clock) in ({"range-plausible"}, {"range-order"})
    assert arm.braked


def test_what_is_no_arm_is_named_by_what_it_lacks() -> None:
    (finding,) = check_arm(object(), clock=ManualClock(), way_m=WAY_M)
    assert "set_force" in finding.message


def test_a_way_and_a_force_that_cannot_be_are_refused() -> None:
    arm, clock = Mass(ManualClock(10**9)), ManualClock(10**9)
    for way_m in ((-0.06, 0.0), (0.0, 0.06), (0.0, 3e-3), (0.01, -0.01), (math.nan, 0.02)):
        with pytest.raises(RangeError, match="way"):
            check_arm(arm, clock=clock, way_m=way_m)
    for force_n in (0.0, 5.1, math.nan):
        with pytest.raises(RangeError, match="N"):
            check_arm(arm, clock=clock, way_m=WAY_M, force_n=force_n)
    with pytest.raises(RangeError, match="brake_s"):
        check_arm(arm, clock=clock, way_m=WAY_M, brake_s=math.inf)
