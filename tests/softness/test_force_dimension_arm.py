"""The arm of Force Dimension, driven against a fake of its library: signs, limits, faults and brakes."""

import ast
import importlib.util
import inspect
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.fake_force_dimension import VELOCITY, ArmFaults, FakeForceDimension, _Dhd, _Expert
from tests.refusals import refused

from palpate.core import DeviceError, HapticArm, ManualClock, MissingExtraError, Position, RangeError
from palpate.softness.real.force_dimension_arm import (
    BY_ITSELF,
    FROZEN,
    SATURATED,
    ForceDimensionArm,
    ForceDimensionSpec,
)

ZERO_M = (0.01, -0.02, 0.03)
SPEC = ForceDimensionSpec(
    "z", -1, ZERO_M, least_m=-0.02, greatest_m=0.03, force_n=8.0, effector_kg=0.25, guide_n=6.0
)
PERIOD_S = 1e-3


def opened(
    spec: ForceDimensionSpec = SPEC, place_m: Position | None = None, **more: Any
) -> tuple[ForceDimensionArm, FakeForceDimension, ManualClock]:
    clock = ManualClock(10**12)
    fake = FakeForceDimension(clock, spec.zero_m if place_m is None else place_m, **more)
    return ForceDimensionArm(spec, clock, fake), fake, clock


def pressed(arm: ForceDimensionArm, clock: ManualClock, force_n: float, time_s: float) -> list[str]:
    """Push with a force at 1 kHz; the faults of each look."""
    faults = []
    for _ in range(round(time_s / PERIOD_S)):
        arm.set_force(force_n)
        clock.sleep(PERIOD_S)
        faults.append(arm.latest().fault)
    return faults


def holding(spec: ForceDimensionSpec = SPEC) -> Callable[[float, Position, Position], Position]:
    """A hand that holds the display where it is, by 2 N/mm."""

    def push(time_s: float, place_m: Position, velocity_m_s: Position) -> Position:
        x, y, z = (
            -2000 * (at - zero) - 40 * speed
            for at, zero, speed in zip(place_m, spec.zero_m, velocity_m_s, strict=True)
        )
        return x, y, z

    return push


# Opening and limits


def test_it_is_a_haptic_arm_and_opens_braking() -> None:
    arm, fake, _ = opened()
    assert isinstance(arm, HapticArm)
    assert fake.braked
    assert not fake.enabled
    with pytest.raises(DeviceError, match="release"):
        arm.set_force(0.0)


def test_every_limit_is_on_before_a_force_is_sent() -> None:
    _, fake, _ = opened()
    assert fake.max_force_n == pytest.approx(10.0)  # of press and guide, 8 and 6 N across each other
    assert fake.ticks == 160  # of 125 us, 20 ms
    assert fake.effector_kg == 0.25
    assert fake.gravity
    assert fake.threshold_m_s == 1.0
    assert "setForce" not in fake.counts
    assert not fake.expert_mode


@pytest.mark.parametrize(
    ("asked_s", "ticks"), [(0.02, 160), (0.0101, 80), (31.875e-3, 255), (0.01 + 124e-6, 80), (2e-3, 16)]
)
def test_the_watchdog_is_whole_ticks_and_never_longer_than_asked(asked_s: float, ticks: int) -> None:
    arm, fake, _ = opened(replace(SPEC, watchdog_s=asked_s))
    assert fake.ticks == ticks
    assert arm.range.watchdog_s == pytest.approx(ticks * 125e-6, rel=1e-12)
    assert arm.range.watchdog_s <= asked_s + 1e-12


@pytest.mark.parametrize(
    "wrong",
    [
        {"watchdog_s": 0.032},  # 256 ticks are 0 in a byte, which is off
        {"watchdog_s": 0.0},
        {"watchdog_s": math.nan},
        {"force_n": 20.1},
        {"force_n": math.nan},
        {"guide_n_m": -1.0},
        {"guide_ns_m": math.inf},
        {"least_m": 0.03},
        {"zero_m": (10.0, 0.0, 0.0)},
        {"zero_m": (math.nan, 0.0, 0.0)},
        {"press_axis": "w"},
        {"press_sign": 0},
        {"effector_kg": -0.1},
    ],
)
def test_a_number_that_no_arm_can_mean_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(RangeError):
        replace(SPEC, **wrong)


def test_where_there_is_no_arm_it_says_what_to_check() -> None:
    with refused("arm-not-found", DeviceError):
        opened(faults=ArmFaults(absent=True))
    with refused("arm-not-found", DeviceError, match="41"):
        opened(replace(SPEC, serial=41), faults=ArmFaults(absent=True))


def test_an_arm_whose_places_mean_nothing_is_refused_and_let_go() -> None:
    faults = ArmFaults(uncalibrated=True)
    fake = FakeForceDimension(clock := ManualClock(), faults=faults)
    with pytest.raises(DeviceError, match="not calibrated"):
        ForceDimensionArm(SPEC, clock, fake)
    assert fake.braked
    assert not fake.opened


def test_a_limit_that_is_not_taken_is_found_by_reading_it_back() -> None:
    with refused("arm-fault", DeviceError, match="-1"):
        opened(faults=ArmFaults(deaf=True))


def test_without_the_library_it_says_which_extra_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "forcedimension_core", None)
    with pytest.raises(MissingExtraError, match=r"palpate\[haptic-arm\]"):
        ForceDimensionArm(SPEC)


# Axis, sign and zero


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_positive_force_pushes_against_the_press(axis: Any, sign: Any) -> None:
    spec = replace(SPEC, press_axis=axis, press_sign=sign)
    arm, fake, _ = opened(spec)
    arm.release()
    arm.set_force(3.0)
    expected = [0.0, 0.0, 0.0]
    expected["xyz".index(axis)] = -3.0 * sign
    assert fake.force_n == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("sign", [1, -1])
def test_displacement_counts_from_first_touch_the_way_the_finger_presses(axis: Any, sign: Any) -> None:
    spec = replace(SPEC, press_axis=axis, press_sign=sign)
    place = list(ZERO_M)
    place["xyz".index(axis)] += sign * 4e-3
    arm, fake, clock = opened(spec, (place[0], place[1], place[2]))
    assert arm.latest().displacement_m == pytest.approx(4e-3, abs=1e-9)
    push = [0.0, 0.0, 0.0]
    push["xyz".index(axis)] = sign * 1.0
    fake.push = lambda time_s, place_m, velocity_m_s: (push[0], push[1], push[2])
    for _ in range(40):
        clock.sleep(PERIOD_S)
        sample = arm.latest()
    speed = fake.velocity_m_s["xyz".index(axis)] * sign
    assert speed > 0.03
    assert sample.velocity_m_s == pytest.approx(speed, rel=0.15)  # over the last 20 ms
    assert sample.displacement_m > 4e-3
    assert sample.time_ns == clock.ns


# Forces


@pytest.mark.parametrize("force_n", [math.nan, math.inf, -math.inf, 8.001, -8.001])
def test_a_force_that_may_not_be_is_refused_before_anything_is_sent(force_n: float) -> None:
    arm, fake, _ = opened()
    arm.release()
    before = len(fake.calls)
    with refused("force", RangeError, match="8 N"):
        arm.set_force(force_n)
    assert len(fake.calls) == before
    assert fake.enabled


def test_the_guide_pulls_back_with_its_spring_and_damper() -> None:
    spec = replace(SPEC, guide_n_m=500.0, guide_ns_m=8.0, guide_n=100.0 / 10)
    assert spec.guide_force_n((2e-3, 0.0), (0.0, 0.0)) == pytest.approx((-1.0, 0.0))
    assert spec.guide_force_n((0.0, 0.0), (0.0, 0.05)) == pytest.approx((0.0, -0.4))
    x, y = spec.guide_force_n((30e-3, -40e-3), (0.0, 0.0))
    assert math.hypot(x, y) == pytest.approx(10.0)
    assert (x, y) == pytest.approx((-6.0, 8.0))


@pytest.mark.parametrize("mass_kg", [0.1, 0.3, 1.0])
def test_the_guide_brings_the_display_to_its_axis_and_holds_it_still(mass_kg: float) -> None:
    x, y, z = ZERO_M
    arm, fake, clock = opened(place_m=(x + 3e-3, y - 2e-3, z), mass_kg=mass_kg)
    arm.release()
    pressed(arm, clock, 0.0, 1.0)
    aside_m = math.hypot(fake.place_m[0] - x, fake.place_m[1] - y)
    assert aside_m < 0.05e-3
    assert math.hypot(*fake.velocity_m_s[:2]) < 1e-3
    assert fake.place_m[2] == pytest.approx(z, abs=1e-9)


def test_a_display_far_off_its_guide_is_a_fault() -> None:
    x, y, z = ZERO_M
    arm, _, _ = opened(place_m=(x + 3e-3, y - 4.1e-3, z))
    assert "5.1 mm" in arm.latest().fault
    assert opened(place_m=(x + 3e-3, y - 3.9e-3, z))[0].latest().fault == ""


# What the device says is wrong


def test_motors_that_do_not_reach_the_force_are_a_fault_once_it_lasts() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    fake.faults.saturated = True
    assert set(pressed(arm, clock, 2.0, 0.1)) == {""}
    assert pressed(arm, clock, 2.0, 0.005)[-1] == SATURATED
    fake.faults.saturated = False
    assert set(pressed(arm, clock, 2.0, 0.2)) == {""}
    fake.faults.saturated = True
    assert set(pressed(arm, clock, 2.0, 0.1)) == {""}


def test_an_arm_that_brakes_for_its_speed_says_so_and_takes_no_force_until_released() -> None:
    arm, fake, clock = opened()
    arm.release()
    with refused("arm-braked", DeviceError):
        pressed(arm, clock, 8.0, 0.2)  # 8 N on 0.3 kg are 1 m/s within 38 ms
    assert fake.cause in (VELOCITY, 4)
    assert "velocity" in arm.latest().fault
    with refused("arm-braked", DeviceError):
        arm.set_force(0.0)
    clock.sleep(1.0)
    arm.release()
    assert arm.latest().fault == ""
    assert fake.enabled


def test_the_watchdog_drops_the_force_where_none_comes() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    arm.set_force(2.0)
    clock.sleep(0.0195)
    fake.catch_up()
    assert fake.force_n[2] == 2.0
    clock.sleep(0.001)
    fake.catch_up()
    assert fake.force_n == (0.0, 0.0, 0.0)
    assert "watchdog" in arm.latest().fault
    with refused("arm-braked", DeviceError):
        arm.set_force(2.0)
    arm.release()
    assert fake.force_n == pytest.approx((0.0, 0.0, 0.0), abs=0.05)  # the last force does not come back


def test_a_force_sent_into_the_brake_is_refused_though_the_library_takes_it() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    clock.sleep(0.03)
    with refused("arm-braked", DeviceError, match="watchdog"):
        arm.set_force(1.0)
    assert not fake.enabled


def test_an_arm_that_does_not_go_into_its_force_mode_is_not_released() -> None:
    arm, fake, _ = opened()
    fake.faults.disabled = True
    with pytest.raises(DeviceError, match=BY_ITSELF):
        arm.release()
    assert fake.braked


def test_a_place_that_no_longer_changes_under_a_force_is_a_fault() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    fake.faults.frozen = True
    assert set(pressed(arm, clock, 2.0, 1.99)) == {""}
    assert pressed(arm, clock, 2.0, 0.05)[-1] == FROZEN


def test_an_arm_at_rest_that_pushes_with_little_is_not_frozen() -> None:
    arm, fake, clock = opened(replace(SPEC, frozen_s=0.1))
    arm.release()
    fake.faults.frozen = True
    assert set(pressed(arm, clock, 0.5, 0.3)) == {""}


def test_a_place_that_is_no_number_brakes_and_raises() -> None:
    arm, fake, _ = opened()
    arm.release()
    fake.faults.no_number = True
    with refused("arm-fault", DeviceError):
        arm.latest()
    assert fake.braked
    with pytest.raises(DeviceError, match="release"):
        arm.set_force(0.0)


# Every code


def session(fake: FakeForceDimension, clock: ManualClock) -> None:
    """All that a session does; the arm is let go of at its end whatever happens."""
    with ForceDimensionArm(SPEC, clock, fake) as arm:
        arm.release()
        pressed(arm, clock, 1.0, 0.02)
        arm.brake()
        arm.release()
        pressed(arm, clock, 1.0, 0.02)


def counted() -> dict[str, int]:
    """How often a good session calls each function."""
    fake = FakeForceDimension(clock := ManualClock(), ZERO_M, push=holding())
    session(fake, clock)
    return fake.counts


COUNTED = counted()


@pytest.mark.parametrize("which", ["first", "middle", "last"])
@pytest.mark.parametrize("name", sorted(COUNTED))
def test_no_call_of_any_function_may_fail_unseen(name: str, which: str) -> None:
    k = {"first": 1, "middle": (COUNTED[name] + 1) // 2, "last": COUNTED[name]}[which]
    faults = ArmFaults(fails={name: k}, stays=True)
    fake = FakeForceDimension(clock := ManualClock(), ZERO_M, push=holding(), faults=faults)
    if name == "stop":
        # Turning forces off brakes as well, so that one of the two may fail.
        faults.fails["enableForce"] = 1
    with pytest.raises(DeviceError):
        session(fake, clock)
    clock.sleep(0.05)
    fake.catch_up()
    assert not fake.enabled  # braked, or its watchdog ran out


def test_a_brake_that_is_not_taken_raises_and_leaves_the_rest_to_the_watchdog() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    arm.set_force(2.0)
    fake.faults.fails = {"stop": 1, "enableForce": 1}
    fake.faults.stays = True
    with refused("brake-refused", DeviceError, match="20 ms"):
        arm.brake()
    with pytest.raises(DeviceError):
        arm.set_force(2.0)
    clock.sleep(0.021)
    fake.catch_up()
    assert fake.force_n == (0.0, 0.0, 0.0)


# Brakes, from any thread


@pytest.mark.parametrize("name", ["getPosition", "getLinearVelocity", "setForce", "getStatus"])
def test_a_brake_of_another_thread_wins_over_a_force_on_its_way(name: str) -> None:
    arm, fake, _ = opened(push=holding())
    arm.release()

    def once(called: str) -> None:
        if called == name:
            fake.hook = lambda name: None
            arm.brake()

    fake.hook = once
    with refused("arm-braked", DeviceError):
        arm.set_force(2.0)
    assert fake.braked
    assert arm.latest().fault == ""  # nothing is wrong with it


@pytest.mark.parametrize("name", ["setForce", "enableForce"])
def test_a_brake_of_another_thread_wins_over_a_release_on_its_way(name: str) -> None:
    arm, fake, _ = opened()

    def once(called: str) -> None:
        if called == name:
            fake.hook = lambda name: None
            arm.brake()

    fake.hook = once
    with refused("braked-in-release", DeviceError):
        arm.release()
    assert fake.braked
    assert not fake.enabled


def test_a_brake_drops_the_force_until_release() -> None:
    arm, fake, clock = opened(push=holding())
    arm.release()
    arm.set_force(2.0)
    arm.brake()
    assert fake.braked
    assert fake.force_n == (0.0, 0.0, 0.0)
    with pytest.raises(DeviceError, match="release"):
        arm.set_force(1.0)
    arm.release()
    pressed(arm, clock, 1.0, 0.01)
    assert fake.force_n[2] == pytest.approx(1.0)


def test_closing_brakes_lets_go_and_does_nothing_again() -> None:
    arm, fake, _ = opened()
    arm.release()
    arm.close()
    assert fake.braked
    assert not fake.opened
    before = len(fake.calls)
    arm.close()
    assert len(fake.calls) == before
    for use in (arm.latest, arm.brake, arm.release, lambda: arm.set_force(0.0)):
        with pytest.raises(DeviceError, match="closed"):
            use()


# The true library


def defined(path: Path) -> dict[str, list[str]]:
    """Functions of a module's source and their arguments."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {
        node.name: [one.arg for one in node.args.args]
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }


def test_every_call_of_the_fake_is_one_of_the_true_library() -> None:
    spec = importlib.util.find_spec("forcedimension_core")  # not imported: that needs the maker's SDK
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("forcedimension-core is not installed; pip install 'palpate[haptic-arm]'")
    root = Path(spec.submodule_search_locations[0])
    for kind, module in ((_Dhd, "dhd/__init__.py"), (_Expert, "dhd/expert/__init__.py")):
        true, fake = defined(root / module), vars(kind)
        for name in (name for name in fake if not name.startswith("_")):
            assert list(inspect.signature(fake[name]).parameters)[1:] == true[name], name
    constants: dict[str, Any] = {}
    exec((root / "constants.py").read_text(encoding="utf-8"), constants)
    assert (constants["TIMEGUARD"], constants["MOTOR_SATURATED"]) == (1, 2)
    causes = constants["ForceOffCause"]
    assert (causes.BUTTON, causes.VELOCITY, causes.WATCHDOG, causes.USBDISCN, causes.DEADMAN) == (
        1,
        2,
        3,
        5,
        6,
    )
    assert constants["ErrorNum"].TIMEOUT == 7
    fields = (root / "containers/__init__.py").read_text(encoding="utf-8")
    for name in ("power", "connected", "started", "reset", "error", "force", "brake", "forceoffcause"):
        assert f"('{name}', c_int)" in fields
