"""The driver of an arm on a fake of ur_rtde: where it goes, how it stops, what it refuses."""

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation
from tests.fakes.ur_controller import (
    EMERGENCY,
    POWER_OFF,
    PROTECTIVE,
    ROBOT_EMERGENCY,
    SAFEGUARD,
    UrController,
    UrFaults,
    ur_modules,
)
from tests.refusals import refused

from palpate.core import (
    DeviceError,
    HardwareStopError,
    InputError,
    ManualClock,
    MissingExtraError,
    MonotonicClock,
    Stage,
    Wrench,
)
from palpate.devices import Limits, OperatorControl, Tripped
from palpate.devices.check import check_stage
from palpate.devices.force_bias import ForceBias
from palpate.devices.motion_guard import ForceReached, MotionGuard
from palpate.rig.real.ur_arm import ArmFrame, UrArmSpec, UrArmStage
from palpate.rig.rig_check import check_rig
from palpate.rig.virtual import virtual_rig

HOST = "127.{}.{}.1".format(*divmod(os.getpid() % 60_000, 250))  # an arm has one holder on a machine
DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
ZERO = (0.4, 0.1, 0.2)
TOOL = (math.pi, 0.0, 0.0)
FRAME = ArmFrame(DOWN, ZERO, TOOL)
BOX = {"least_m": (-0.05, -0.05, -0.05), "greatest_m": (0.05, 0.05, 0.01)}
POSE = (0.4, 0.1, 0.205, *TOOL)  # 5 mm above the rig's zero
SPEED = 0.004
STIFFNESS_N_M = 2000.0
LOW = (0.0, 0.0, 0.005)  # 5 mm into the skin


class ArmBench:
    """Arm behind the modules of the library."""

    def __init__(self, monkeypatch, faults=None, clock=None, pose=POSE, drift=0.0, **spec) -> None:
        self.clock = clock or ManualClock(123_000_000_000)
        self.arm = UrController(pose, self.clock, faults, drift=drift)
        for name, module in ur_modules(self.arm).items():
            monkeypatch.setitem(sys.modules, name, module)
        self.spec = UrArmSpec(HOST, **({"frame": FRAME} | BOX | spec))

    def open(self) -> UrArmStage:
        return UrArmStage.open(self.spec, self.clock)

    def arrive(self, stage: UrArmStage) -> None:
        end_ns = self.clock.now_ns() + 60_000_000_000
        while stage.moving():
            assert self.clock.now_ns() < end_ns
            self.clock.sleep(0.004)

    def to_speed(self, stage: UrArmStage, target, speed=SPEED) -> None:
        stage.move_to(target, speed)
        while self.arm.true_speed() < 0.999 * speed:
            self.clock.sleep(0.001)

    def fails(self, call: Callable[[], Any], kind: type[DeviceError] = DeviceError, within_s=5.0) -> str:
        """What a call says when it comes to fail."""
        end_ns = self.clock.now_ns() + round(within_s * 1e9)
        while self.clock.now_ns() < end_ns:
            try:
                call()
            except kind as error:
                return str(error)
            self.clock.sleep(0.004)
        pytest.fail(f"{call} did not fail in {within_s} s")


@pytest.fixture
def bench(monkeypatch):
    return lambda *args, **more: ArmBench(monkeypatch, *args, **more)


@pytest.fixture
def opened(bench):
    """An arm and its stage, closed at the end whatever became of it."""
    stages: list[UrArmStage] = []

    def make(*args, **more):
        rig = bench(*args, **more)
        stages.append(rig.open())
        return rig, stages[-1]

    yield make
    for stage in stages:
        try:
            stage.close()
        except DeviceError:
            assert stage._closed


def around(stage: UrArmStage, half_m: float = 2e-3):
    at = stage.position_m()
    return tuple(d - half_m for d in at), tuple(d + half_m for d in at)


@pytest.mark.parametrize("faults", [UrFaults(), UrFaults(noise_m=1.5e-6, noise_m_s=1e-4)])
@pytest.mark.parametrize("rate_hz", [125.0])
@pytest.mark.cases(1)
def test_the_driver_conforms(opened, faults, rate_hz) -> None:
    rig, stage = opened(faults, rate_hz=rate_hz)
    assert isinstance(stage, Stage)
    bad = [one for one in check_stage(stage, clock=rig.clock, region_m=around(stage)) if not one.ok]
    assert not bad, bad
    assert rig.arm.clashes == 0


@pytest.mark.parametrize("faults", [UrFaults(deaf=True), UrFaults(late_s=0.3), UrFaults(aside_m=0.5e-3)])
@pytest.mark.cases(1)
def test_an_arm_that_stops_late_or_leaves_its_way_does_not_conform(opened, faults) -> None:
    rig, stage = opened(faults)
    assert any(not one.ok for one in check_stage(stage, clock=rig.clock, region_m=around(stage)))


# Frame.

rotations = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
places = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


@given(rotations, places, places)
def test_a_frame_there_and_back_is_where_it_was(turn, zero, place) -> None:
    rows = tuple(tuple(row) for row in Rotation.from_rotvec(turn).as_matrix().tolist())
    frame = ArmFrame(rows, zero, turn)  # the tool's axes are the rig's
    assert np.allclose(frame.rig_m(frame.base_m(place)), place, atol=1e-12)
    assert frame.tilt_deg(turn) < 1e-5


def test_into_the_skin_is_down_and_y_leads_to_the_viewer_without_a_turn_of_the_tool(opened) -> None:
    rig, stage = opened(pose=(*POSE[:3], math.pi - math.radians(0.4), 0.0, 0.0))
    assert stage.position_m() == pytest.approx((0.0, 0.0, -0.005))
    stage.move_to((0.001, 0.002, 0.003), SPEED)
    rig.arrive(stage)
    assert rig.arm.true_pose()[:3] == pytest.approx([0.401, 0.098, 0.197], abs=2e-5)
    assert rig.arm.greatest_turn == 0.0
    assert stage.position_m() == pytest.approx((0.001, 0.002, 0.003), abs=2e-5)


@pytest.mark.parametrize(
    ("rows", "tool", "says"),
    [
        (((1, 0, 0), (0, -1, 0), (0, 0, -1.01)), TOOL, "not-orthonormal"),
        (((1, 0, 0), (0, 1, 0), (0, 0, -1)), TOOL, "mirrored"),
        (((1, 0, 0), (0, 1, 0), (0, 0, 1)), TOOL, "tool-direction"),  # z out of the skin
        (((math.nan, 0, 0), (0, -1, 0), (0, 0, -1)), TOOL, "not-finite"),
    ],
)
def test_a_wrong_rotation_is_refused(rows, tool, says) -> None:
    with refused(says, InputError):
        ArmFrame(rows, ZERO, tool)


def test_opening_moves_nothing_and_one_programme_at_a_time_has_an_arm(bench, monkeypatch) -> None:
    rig = bench()
    before = rig.arm.true_pose()
    with rig.open(), refused("device-held", DeviceError, match=str(HOST)):
        rig.open()
    assert not rig.arm.moves
    assert rig.arm.uploads == 1
    assert not rig.arm.programme  # the arm is given back
    assert np.array_equal(rig.arm.true_pose(), before)
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    with pytest.raises(MissingExtraError, match=r"palpate\[ur\]"):
        rig.open()


def test_another_orientation_is_refused_before_the_arm_is_taken(bench) -> None:
    rig = bench(pose=(*POSE[:3], math.pi - math.radians(0.6), 0.0, 0.0))
    with refused("tool-orientation", DeviceError, match=r"0\.60 degrees"):
        rig.open()
    assert not rig.arm.uploads
    bench(pose=(*POSE[:3], -math.pi, 0.0, 0.0)).open().close()  # another vector of the same orientation


@pytest.mark.parametrize(
    ("pose", "code"),
    [
        ((*POSE[:3], math.pi, 0.05, 0.0), "tool-orientation"),
        ((0.4, 0.16, 0.205, *TOOL), "outside-travel"),  # not sent back blindly
    ],
)
def test_an_arm_that_was_led_elsewhere_is_not_moved(opened, pose, code) -> None:
    rig, stage = opened()
    rig.arm.led_to(pose)
    rig.clock.sleep(0.01)
    with refused(code, DeviceError):
        stage.move_to(LOW, SPEED)
    assert not rig.arm.moves


# Speed and stops.


@pytest.mark.parametrize(("speed", "stop_m_s2"), [(0.02, 0.5), (0.25, 2.0)])
def test_a_stop_runs_on_by_v2_over_2a_and_the_latency(opened, speed, stop_m_s2) -> None:
    rig, stage = opened(top_speed_m_s=0.25, stop_m_s2=stop_m_s2, acceleration_m_s2=2.0)
    stage.move_to((-0.05, 0.0, -0.005), 0.05)
    rig.arrive(stage)
    rig.to_speed(stage, (0.05, 0.0, -0.005), speed)
    at = rig.arm.true_pose()
    stage.stop()
    went = float(np.linalg.norm(rig.arm.true_pose() - at))
    assert rig.arm.true_speed() == 0.0
    assert not stage.moving()
    assert speed**2 / (2 * stop_m_s2) < went <= stage.travel.overshoot_m(speed)
    stage.move_to((0.049, 0.0, -0.005), 0.05)  # it obeys afterwards
    rig.arrive(stage)


@pytest.mark.parametrize(
    ("faults", "code"),
    [({"weak": 0.3}, "stop-distance"), ({"late_s": 0.2}, "stop-distance"), ({"deaf": True}, "stop-failed")],
)
def test_a_stop_that_runs_on_too_far_or_does_not_come_is_told(opened, faults, code) -> None:
    rig, stage = opened(top_speed_m_s=0.25, acceleration_m_s2=2.0, stop_s=0.5)
    rig.to_speed(stage, (0.05, 0.0, -0.005), 0.01 if "deaf" in faults else 0.1)
    rig.arm.faults = UrFaults(**faults)
    with refused(code, DeviceError):
        stage.stop()


def test_a_motion_found_under_way_is_stopped(bench) -> None:
    rig = bench()
    rig.arm.go((0.45, 0.1, 0.205, *TOOL), 0.02, 0.5)
    rig.clock.sleep(0.2)
    with rig.open() as stage:
        assert rig.arm.true_speed() == 0.0
        assert rig.arm.true_pose()[0] < 0.41  # of 0.45
        assert not stage.moving()


# What its safety system, its mode and its connection say.

STOPS = {"emergency stop": ((ROBOT_EMERGENCY, EMERGENCY), POWER_OFF), "safeguard": ((SAFEGUARD,), 7)}


@pytest.mark.parametrize("name", STOPS)
def test_a_stop_of_its_own_is_named_in_motion_and_at_opening(bench, name) -> None:
    bits, mode = STOPS[name]
    rig = bench()
    stage = rig.open()
    rig.to_speed(stage, LOW)
    rig.arm.stop_for_safety(*bits, mode=mode)
    assert name in rig.fails(stage.moving, HardwareStopError, within_s=0.1)
    with refused("hardware-stop", HardwareStopError, match=str(name)):
        stage.stop()
    with pytest.raises(HardwareStopError, match=name):
        stage.move_to(LOW, SPEED)
    stage.position_m()  # it is where it is
    stage.close()
    sent = len(rig.arm.moves)
    with pytest.raises(HardwareStopError, match=name):
        rig.open()
    rig.arm.released()
    with rig.open() as again:
        again.move_to(LOW, SPEED)
        rig.arrive(again)
    assert len(rig.arm.moves) == sent + 1


def test_a_released_arm_whose_programme_ended_is_opened_anew(opened) -> None:
    rig, stage = opened()
    rig.arm.stop_for_safety(PROTECTIVE)
    rig.arm.released()
    rig.clock.sleep(0.01)
    with refused("program-ended", DeviceError):
        stage.move_to(LOW, SPEED)


@pytest.mark.parametrize(("mode", "name"), [(3, "power off"), (99, "mode 99")])
def test_a_mode_in_which_it_does_not_run_is_named(bench, mode, name) -> None:
    rig = bench()
    rig.arm.mode = mode
    with pytest.raises(DeviceError, match=name):
        rig.open()
    assert not rig.arm.uploads
    rig.arm.mode = 7
    rig.open().close()


def test_a_lost_connection_is_told_and_a_stop_says_what_to_do(opened) -> None:
    rig, stage = opened()
    rig.arm.cut = True
    stage.close()  # it went nowhere
    rig, stage = opened()
    rig.to_speed(stage, LOW)
    rig.arm.cut = True
    for call in (stage.position_m, stage.moving):
        with refused("connection-lost", DeviceError):
            call()
    with refused("stop-not-confirmed", DeviceError):
        stage.stop()
    with pytest.raises(DeviceError, match="nothing shows"):  # closing an arm that may move says so
        stage.close()


def test_a_status_that_stands_still_is_refused_once_it_is_too_old(opened) -> None:
    rig, stage = opened(stale_s=0.05)
    rig.to_speed(stage, LOW)
    stage.position_m()
    rig.arm.faults = UrFaults(silent=True)
    began_s = rig.clock.now_ns() / 1e9
    assert "s old" in rig.fails(stage.position_m)
    took_s = rig.clock.now_ns() / 1e9 - began_s
    assert 0.05 - 1 / 125 - 0.005 <= took_s <= 0.05 + 1 / 125 + 0.005


def test_a_connection_that_fell_silent_in_a_long_pause_is_not_believed(opened) -> None:
    rig, stage = opened()
    stage.position_m()
    rig.arm.faults = UrFaults(silent=True)
    rig.clock.sleep(36e3)
    with refused("status-stale", DeviceError):
        stage.position_m()


def test_clocks_that_drift_apart_make_no_status_old(opened) -> None:
    rig, stage = opened(drift=-8e-5)
    ages = []
    for pause_s in (0.01, 1.0, 9.0, 60.0, 36e3):
        for _ in range(50):
            rig.clock.sleep(pause_s)
            ages.append(stage.status.age_s)
    assert min(ages) >= 0.0
    assert max(ages) < 0.01


def test_a_controller_that_restarted_is_told(opened) -> None:
    rig, stage = opened()
    rig.arm.restart()
    rig.clock.sleep(0.02)
    with pytest.raises(DeviceError, match="restarted"):
        stage.position_m()


# Return codes, exceptions, threads.


@pytest.mark.parametrize(
    ("faults", "code"),
    [
        ({"refuse": True}, "move-refused"),
        ({"refuse_late": True}, "move-refused"),  # and begins all the same
        ({"raises": True}, "stop-unexpected"),
    ],
)
def test_a_move_that_the_library_refuses_ends_at_a_stand(opened, faults, code) -> None:
    rig, stage = opened()
    rig.arm.faults = UrFaults(**faults)
    with refused(code, DeviceError):
        stage.move_to(LOW, SPEED)
    rig.clock.sleep(1.0)
    assert rig.arm.true_speed() == 0.0
    assert rig.arm.true_pose()[2] > 0.2  # short of it


def test_an_arm_that_stands_short_or_strays_is_told(opened) -> None:
    rig, stage = opened(still_s=0.2)
    began_s = rig.clock.now_ns() / 1e9
    stage.move_to((0.0, 0.0, -0.0049), 5e-5)  # a slow move is neither over too soon nor taken for stuck
    rig.arrive(stage)
    assert rig.clock.now_ns() / 1e9 - began_s >= 2.0
    rig.arm.faults = UrFaults(stuck_m=3e-3)
    stage.move_to(LOW, SPEED)
    assert "6.90 mm" in rig.fails(stage.moving, within_s=2.0)
    stage.stop()
    rig.arm.faults = UrFaults(aside_m=4e-3)
    stage.move_to(LOW, SPEED)
    assert "straight way" in rig.fails(stage.moving, within_s=4.0)
    stage.stop()


def test_a_move_that_was_stopped_before_it_began_never_does(opened, monkeypatch) -> None:
    rig, stage = opened()
    look = stage._watch.look

    def stopped_meanwhile():
        status = look()
        monkeypatch.setattr(stage._watch, "look", look)
        stage.stop()
        return status

    monkeypatch.setattr(stage._watch, "look", stopped_meanwhile)
    with refused("move-canceled", DeviceError):
        stage.move_to(LOW, SPEED)
    assert not rig.arm.moves


def test_a_stop_waits_until_a_move_is_handed_over_and_then_stops_it(opened) -> None:
    rig, stage = opened(UrFaults(taken_s=0.3), clock=MonotonicClock())
    moving = threading.Thread(target=stage.move_to, args=((0.0, 0.0, 0.009), 0.005))
    moving.start()
    while not rig.arm.busy:
        time.sleep(0.001)
    stage.stop()
    moving.join(timeout=60.0)
    assert rig.arm.moves
    assert rig.arm.true_speed() == 0.0
    assert rig.arm.true_pose()[2] > 0.195  # of 0.191, from 0.205
    assert rig.arm.clashes == 0


# In a rig.


class ArmSpring:
    """Force sensor under a skin at the rig's zero, on the bench's clock."""

    rate_hz, range_n = 250.0, (50.0, 50.0, 50.0)

    def __init__(self, rig: ArmBench) -> None:
        self._rig, self._draw = rig, np.random.default_rng(1)
        self._told = self._newest

    def drain(self) -> list[Wrench]:
        first, self._told = self._told, self._newest
        return [self._sample(k / self.rate_hz) for k in range(first + 1, self._told + 1)]

    def latest(self) -> Wrench:
        return self._sample(self._newest / self.rate_hz)

    def close(self) -> None:
        pass

    @property
    def _newest(self) -> int:
        return int(self._rig.arm.now_s * self.rate_hz)

    def _sample(self, time_s: float) -> Wrench:
        depth_m = max(ZERO[2] - self._rig.arm.true_pose(time_s)[2], 0.0)
        noise = (0.002 * self._draw.standard_normal(6)).tolist()
        force = (noise[0], noise[1], float(STIFFNESS_N_M * depth_m) + noise[2])
        return Wrench(round(time_s * 1e9), force, (0.0, *noise[4:]))


@pytest.fixture
def guarded(opened, coarse_looks):
    """An arm over the skin, and a guard that knows its zero."""
    rig, stage = opened(latency_s=0.02)
    limits = Limits((-0.04, -0.04, -0.04), (0.04, 0.04, 0.009), force_n=15.0)
    guard = MotionGuard(stage, ArmSpring(rig), limits, ForceBias(), rig.clock, OperatorControl())
    guard.tare(250.0)
    return rig, stage, guard


def test_a_guarded_press_of_an_arm_ends_at_its_force(guarded) -> None:
    rig, stage, guard = guarded
    stop_n = 1.0
    guard.towards((0.0, 0.0, -0.0005), 3e-3)
    assert guard.towards((0.0, 0.0, 0.006), 1e-3, ForceReached(stop_n))
    depth_m = stage.position_m()[2]
    reached_m = stop_n / STIFFNESS_N_M
    assert reached_m - 1e-5 <= depth_m <= reached_m + stage.travel.overshoot_m(1e-3, 0.01) + 2e-5
    guard.away((0.0, 0.0, -0.004), 5e-3)
    assert rig.arm.true_pose()[2] == pytest.approx(0.204, abs=2e-5)
    assert rig.arm.clashes == 0


def test_a_protective_stop_in_a_guarded_press_is_named(guarded) -> None:
    rig, _, guard = guarded

    def pressed(force) -> bool:
        if force[2] > 1.0 and not rig.arm.safety >> PROTECTIVE & 1:
            rig.arm.stop_for_safety(PROTECTIVE)
        return False

    with refused("hardware-stop", Tripped, match="protective stop"):
        guard.towards((0.0, 0.0, 0.003), 2e-3, pressed)


@pytest.mark.slow
def test_the_check_of_a_rig_with_an_arm_passes(opened) -> None:
    whole = virtual_rig(clock=ManualClock(5_000_000_000))
    rig, stage = opened(clock=whole.clock, pose=(0.4, 0.1, 0.206, *TOOL))
    limits = replace(whole.limits, least_m=(-0.02,) * 3, greatest_m=(0.02, 0.02, 0.009))
    found = check_rig(replace(whole, stage=stage, limits=limits))
    assert not [one for one in found if not one.ok]
    assert len(rig.arm.moves) > 20
