"""The driver on a fake of Marlin, over a real pseudo-terminal: where it goes, how it stops, what it bears."""

import math
import sys
import threading
from contextlib import ExitStack

import pytest
from hypothesis import given, strategies as st
from tests.fakes.marlin_firmware import MarlinFaults, MarlinFirmware, MarlinParameters
from tests.refusals import refused
from tests.rig.conftest import FastClock, GrblBench
from tests.rig.serial_terminal import FakeTerminal

from palpate.core import (
    DeviceError,
    InputError,
    ManualClock,
    MonotonicClock,
    PositionUnknownError,
    RangeError,
    Stage,
)
from palpate.devices.check import check_stage
from palpate.rig.real.marlin import MarlinSpec, MarlinStage
from palpate.rig.real.marlin.marlin_link import MarlinMachine, numbered, read_line
from palpate.rig.rig_file import RigFile

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")

START = (0.0, 0.0, 0.0)  # where it is said to stand; machine 0, 0, 0 after its port was opened
BOX = {"least_m": (-0.05, -0.05, -0.05), "greatest_m": (0.05, 0.05, 0.05)}
SPEED = 0.004  # its least jerk: it can stop dead
STEP_MM = 1 / 80  # of its coarsest axis
TICK_MM = 0.01  # a tick of the fake at that speed, and more


class MarlinBench(GrblBench):
    """The fake of Marlin, its terminal and the driver's spec."""

    def __init__(self, stack: ExitStack, model, faults, clock, **spec) -> None:
        self.clock, self._stack = clock, stack
        self.firmware = MarlinFirmware(model, faults, clock.now_ns() / 1e9)
        self.terminal = stack.enter_context(FakeTerminal(self.firmware, clock))
        self._spec = {"boot_s": 0.02, "reply_s": 5.0, "still_s": 1e3, "stop_s": 1e3, **BOX} | spec

    def open(self, *, known: bool = True) -> MarlinStage:
        stage = MarlinStage.open(MarlinSpec(self.terminal.path, **self._spec), self.clock)
        self._stack.callback(stage._link.close)
        if known:
            stage.reference(START)
        return stage

    @property
    def gone_mm(self):
        """The true place, from where it was switched on."""
        return tuple(
            at - start for at, start in zip(self.place_mm, self.firmware.model.start_mm, strict=True)
        )

    def move_to_speed(self, stage, target, speed=SPEED) -> None:
        super().move_to_speed(stage, target, speed)

    def fails(self, call) -> str:
        """What a call says when it comes to fail."""
        said: list[str] = []

        def failed() -> bool:
            try:
                call()
            except DeviceError as error:
                said.append(str(error))
            return bool(said)

        self.wait(failed)
        return said[0]


@pytest.fixture
def bench():
    pytest.importorskip("serial")
    with ExitStack() as stack:

        def make(model=None, faults=None, clock=None, **spec):
            return MarlinBench(
                stack, model or MarlinParameters(), faults or MarlinFaults(), clock or ManualClock(), **spec
            )

        yield make


@pytest.fixture
def opened(bench):
    def make(*args, known: bool = True, **spec):
        one = bench(*args, **spec)
        return one, one.open(known=known)

    return make


def mm(sensor_m):
    return sensor_m[0] * 1e3, -sensor_m[1] * 1e3, -sensor_m[2] * 1e3


def test_a_speed_factor_that_another_program_left_is_taken_back(bench) -> None:
    one = bench()
    with one.terminal.lock:
        one.firmware._modes.percent = 300.0
    stage = one.open()
    one.move_to_speed(stage, (5e-3, 0.0, 0.0))
    assert one.speed_mm_s <= SPEED * 1e3 * 1.001


def test_lines_carry_a_number_and_the_exclusive_or_of_their_bytes() -> None:
    assert numbered(1, "M115") == b"N1 M115*39\n"  # as hosts' logs show it
    with pytest.raises(ValueError, match="longer"):
        numbered(1, "M118 " + "x" * 90)


@given(st.binary(max_size=200))
def test_any_bytes_are_read_as_a_line_or_none(raw: bytes) -> None:
    read_line(raw)


@pytest.mark.parametrize(
    "endstops",
    [
        ["echo:Soft endstops: On   Min: X0.00 Y0.00 Z0.00  Max: X200.00 Y210.00 Z180.00"],  # 1.1
        ["  M211 S1 ; ON", "  Min:  X0.00 Y0.00 Z0.00   Max:  X200.00 Y210.00 Z180.00"],  # 2.1
    ],
)
def test_settings_of_either_age_are_read(endstops) -> None:
    settings = [
        "echo:; Advanced: B<min_segment_time_us> S<min_feedrate>",
        "echo: M92 X80.00 Y80.00 Z400.00 E93.00",
        "echo:  M203 X500.00 Y500.00 Z10.00 E60.00",
        "echo:  M201 X500.00 Y500.00 Z100.00 E5000.00",
        "echo:  M204 P500.00 R1000.00 T300.00",
        "echo:  M205 B20000.00 S0.00 T0.00 X6.00 Y6.00 Z0.40 E10.00",
    ]
    machine = MarlinMachine.read(settings, endstops, ["Cap:EMERGENCY_PARSER:1"])
    assert machine.box_mm == ((0.0, 0.0, 0.0), (200.0, 210.0, 180.0))
    assert (machine.steps_per_mm, machine.jerk_mm_s) == ((80.0, 80.0, 400.0), (6.0, 6.0, 0.4))
    assert machine.acceleration_mm_s2 == (300.0, 300.0, 100.0)
    assert machine.emergency_parser
    assert not MarlinMachine.read(settings, endstops, ["Cap:EMERGENCY_PARSER:0"]).emergency_parser


def test_it_goes_where_it_is_sent(opened) -> None:
    one, stage = opened()
    assert isinstance(stage, Stage)
    assert stage.position_m() == pytest.approx(START)
    for target in ((0.002, -0.001, 0.0021), (-0.0012, 0.0013, -0.0006), START):
        stage.move_to(target, SPEED)
        assert stage.moving()
        one.arrive(stage)
        assert stage.position_m() == pytest.approx(target, abs=STEP_MM / 1e3)
        assert one.gone_mm == pytest.approx(mm(target), abs=STEP_MM)


@pytest.mark.parametrize("parser", [True, False])
def test_a_stop_ends_within_the_overshoot_bound_at_a_known_place(opened, parser) -> None:
    one, stage = opened(MarlinParameters(emergency_parser=parser))
    assert stage.emergency_parser is parser
    stage.stop()
    assert b"M410" not in bytes(one.firmware.received), "a stop at a stand sends nothing"
    one.move_to_speed(stage, (0.02, 0.0, 0.01))
    asked = one.gone_mm
    stage.stop()
    stopped = one.gone_mm
    assert math.dist(asked, stopped) <= TICK_MM  # dead at once, from its jerk
    assert math.dist(stopped, mm((0.02, 0.0, 0.01))) > 1.0
    assert not stage.moving()
    assert stage.position_m() == pytest.approx(
        [v / 1e3 for v in (stopped[0], -stopped[1], -stopped[2])], abs=2e-5
    )
    stage.move_to(START, SPEED)
    one.arrive(stage)
    assert one.gone_mm == pytest.approx((0, 0, 0), abs=2 * STEP_MM)


def test_no_speed_is_allowed_from_which_a_stop_would_lose_steps(bench) -> None:
    stage = bench().open()
    assert stage.travel.top_speed_m_s == pytest.approx(0.004)  # the least jerk, not M203's 5 mm/s
    with pytest.raises(RangeError, match="not moved"):
        stage.move_to((0.001, 0, 0), 0.0045)
    assert bench(sudden_m_s=0.002).open().travel.top_speed_m_s == pytest.approx(0.002)


def test_a_false_word_on_how_fast_it_may_stop_dead_loses_the_place_unseen(opened) -> None:
    """Negative control: the count cannot tell, so the word must be tried."""
    one, stage = opened(MarlinParameters(top_mm_s=(300.0, 300.0, 300.0)), sudden_m_s=0.02)
    one.move_to_speed(stage, (0.03, 0.0, 0.0), 0.02)
    stage.stop()
    assert abs(one.gone_mm[0] - stage.position_m()[0] * 1e3) > 1.0


def test_homing_takes_as_long_as_it_says_that_it_is_busy(opened) -> None:
    _one, stage = opened(
        MarlinParameters(homing_s=30.0), clock=FastClock(20.0), least_m=None, greatest_m=None, known=False
    )
    with pytest.raises(DeviceError, match="not known"):
        stage.position_m()
    stage.home()
    assert stage.position_m() == pytest.approx(START)
    assert stage.travel.greatest_m == pytest.approx((0.2, 0.0, 0.0))  # -Y and -Z are the sensor's
    assert stage.travel.least_m == pytest.approx((0.0, -0.2, -0.2))


@pytest.mark.parametrize(
    ("model", "spec", "error", "said"),
    [
        ({"junction": True}, {}, InputError, "jerk-unknown"),
        ({"core_xy": True}, {}, DeviceError, "kinematics"),
        ({"level_mm": 0.3}, {}, DeviceError, "bed-leveling"),
        ({}, {"least_m": None, "greatest_m": None}, InputError, "travel-missing"),
    ],
)
def test_a_machine_that_cannot_be_driven_is_refused_by_name(bench, model, spec, error, said) -> None:
    with refused(said, error):
        bench(MarlinParameters(**model), **spec).open()


def test_a_machine_that_wants_homing_first_is_told(bench) -> None:
    stage = bench(MarlinParameters(needs_homing=True)).open()
    with refused("move-refused", DeviceError):
        stage.move_to((0.001, 0, 0), SPEED)


def test_a_build_that_tells_its_place_only_at_the_end_is_refused(opened) -> None:
    one, stage = opened(MarlinParameters(legacy_m114=True), clock=FastClock(5.0), reply_s=10.0)
    for target in (0.002, 0.0):
        stage.move_to((target, 0.0, 0.0), SPEED)
        one.arrive(stage)
    stage.move_to((0.002, 0.0, 0.0), SPEED)
    with pytest.raises(DeviceError, match="M114_LEGACY"):
        one.arrive(stage)


@pytest.mark.parametrize(
    "faults",
    [
        {"lose_every": 7},
        {"damage_every": 5},
        {"garble_every": 6},
        {"lose_ok_of": "G1"},
        {"lose_ok_of": "M114"},
        {"noise": b"\xff\x00\n"},
    ],
)
@pytest.mark.cases(2)
def test_lost_and_damaged_lines_cost_time_and_no_move_and_no_place(opened, faults) -> None:
    one, stage = opened(reply_s=0.15)
    one.spoil(MarlinFaults(**faults))
    for target in ((0.0005, 0.0, 0.0), (0.0005, 0.0002, 0.0), START):
        stage.move_to(target, SPEED)
        one.arrive(stage)
        assert one.gone_mm == pytest.approx(mm(target), abs=STEP_MM)
        assert stage.position_m() == pytest.approx(target, abs=STEP_MM / 1e3)


@pytest.mark.parametrize("quiet", [False, True])
def test_a_restart_in_motion_is_told_and_nothing_old_is_sent_again(opened, quiet) -> None:
    one, stage = opened(faults=MarlinFaults(restart_after_mm=1.0, quiet_start=quiet), reply_s=1.0)
    stage.move_to((0.01, 0.0, 0.0), SPEED)
    said = one.fails(stage.moving)
    assert "restarted" in said
    where = one.gone_mm
    assert where[0] < 2.0
    with pytest.raises(DeviceError, match="not known"):
        stage.position_m()
    one.clock.sleep(5.0)
    assert one.gone_mm == where  # no old move was done after it
    stage.reference(START)
    stage.move_to((0.001, 0.0, 0.0), SPEED)
    one.arrive(stage)
    assert one.gone_mm[0] - where[0] == pytest.approx(1.0, abs=2 * STEP_MM)


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ({"stuck_after_mm": 1.0}, "has stopped"),
        ({"jump_after_mm": 1.0, "jump_mm": (0.0, 0.5, 0.0)}, "off its"),
        (None, "may still"),  # its port goes
    ],
)
def test_a_stage_that_stands_short_jumps_or_is_gone_is_told(opened, faults, said: str) -> None:
    one, stage = opened(faults=MarlinFaults(**faults or {}), still_s=1.0)
    stage.move_to((0.005, 0.0, 0.0), SPEED)
    if faults is None:
        one.terminal.unplug()
    assert said in one.fails(stage.moving)
    if said == "off its":
        with refused("position-lost", DeviceError):
            stage.position_m()
    if said == "may still":
        one.clock.sleep(10.0)
        assert one.gone_mm[0] == pytest.approx(5.0, abs=STEP_MM)


def test_a_controller_that_says_nothing_is_told(opened) -> None:
    one, stage = opened(reply_s=0.1)
    one.spoil(MarlinFaults(mute=True))
    with refused("silence", DeviceError):
        stage.position_m()


def test_a_stop_that_is_not_heeded_is_no_stop(opened) -> None:
    one, stage = opened(faults=MarlinFaults(ignores_stop=True), stop_s=1.0)
    one.move_to_speed(stage, (0.04, 0.0, 0.0))
    done: list[BaseException] = []

    def stop() -> None:
        try:
            stage.stop()
        except DeviceError as error:
            done.append(error)

    stopper = threading.Thread(target=stop)
    stopper.start()
    one.wait(lambda: not stopper.is_alive())
    assert "stop when" in str(done[0])
    one.wait(lambda: one.firmware.killed)
    assert one.gone_mm[0] < 39.0


def test_what_is_no_marlin_is_refused(bench) -> None:
    with refused("not-marlin", DeviceError):
        bench(faults=MarlinFaults(mute=True), reply_s=0.05).open()


@pytest.mark.slow
@pytest.mark.parametrize(("parser", "speed_m_s"), [(True, 3.5e-3), (False, 1.5e-3)])
def test_the_marlin_driver_keeps_every_law_of_a_stage(opened, parser, speed_m_s) -> None:
    one, stage = opened(
        MarlinParameters(emergency_parser=parser), clock=MonotonicClock(), still_s=5.0, stop_s=5.0
    )
    half = 5e-3
    box = ((-half, -half, -half), (half, half, half))
    found = check_stage(stage, clock=one.clock, region_m=box, speed_m_s=speed_m_s)
    assert [one for one in found if not one.ok] == []


def test_a_rig_s_file_opens_it_at_its_reference_only_on_confirmation(bench) -> None:
    one = bench(clock=MonotonicClock())
    fields = {"kind": "marlin", "port": one.terminal.path, "reference": [1.0, 2.0, -3.0]}
    limits = {"least_mm": [-5, -5, -5], "greatest_mm": [5, 5, 5], "sudden_mm_s": 2.5}
    limits |= {"steps_per_mm": [80, 80, 400], "boot_s": 0.02}
    part = RigFile.model_validate({"name": "bench", "stage": fields | limits}).stage
    with part.open(one.clock) as stage, pytest.raises(PositionUnknownError):
        stage.position_m()
    with part.open(one.clock, position="reference") as stage:
        assert stage.position_m() == pytest.approx((0.001, 0.002, -0.003))
        assert stage.travel.top_speed_m_s == pytest.approx(0.0025)
        assert stage.travel.greatest_m == pytest.approx((0.005, 0.005, 0.005))
    unstated = RigFile.model_validate({"name": "bench", "stage": fields | limits | {"steps_per_mm": None}})
    with refused("scale-not-stated", InputError):
        unstated.stage.open(one.clock, position="reference")
    with pytest.raises(ValueError, match="reference"):
        RigFile.model_validate({"name": "bench", "stage": fields | limits | {"home": True}})


def test_a_stage_that_knows_no_place_still_lifts_away_from_the_skin(opened) -> None:
    one, stage = opened(known=False)
    stage.retreat(2e-3, SPEED)
    one.arrive(stage)
    assert one.gone_mm == pytest.approx((0.0, 0.0, 2.0), abs=STEP_MM)  # its -Z leads into the skin
    with pytest.raises(DeviceError, match="not known"):
        stage.position_m()


def test_a_stage_that_runs_to_its_target_after_the_stop_is_no_stop(bench) -> None:
    one = bench(faults=MarlinFaults(ignores_stop=True), clock=FastClock(5.0), stop_s=100.0)
    stage = one.open()
    one.move_to_speed(stage, (0.01, 0.0, 0.0))
    with pytest.raises(DeviceError, match="ran on"):
        stage.stop()


def test_without_an_emergency_parser_the_stated_latency_is_longer(bench) -> None:
    quick, slow = (bench(MarlinParameters(emergency_parser=p)).open().travel for p in (True, False))
    assert quick.latency_s == pytest.approx(0.05)
    assert slow.latency_s == pytest.approx(0.55)
    assert slow.overshoot_m(1e-3) > 5 * quick.overshoot_m(1e-3)
