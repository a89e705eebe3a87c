"""Each fault that a GRBL stage was seen to have, or can have: made to happen, over a real pseudo-terminal."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.refusals import refused

from palpate.core.clock import MonotonicClock
from palpate.core.errors import DeviceError
from palpate.rig.real.grbl.grbl_link import GrblLink, RefusedError

START = (-0.050, 0.050, 0.050)
AWAY = (-0.030, 0.050, 0.050)
HELD = GrblParameters(homed=True, hold_cancels_jog=False)
REAL_TIME = {"still_s": 30.0, "stop_s": 30.0}  # patience on a loaded machine
SOON_S = 0.5  # for an answer that must not come; each such test waits for it once or twice


def metres(machine_mm):
    return machine_mm[0] / 1e3, -machine_mm[1] / 1e3, -machine_mm[2] / 1e3


def goes_and_comes_back(bench, stage):
    """The stage works as it should."""
    for target in ((-0.0495, 0.050, 0.0505), START):
        stage.move_to(target, 0.01)
        bench.arrive(stage)
        assert metres(bench.place_mm) == pytest.approx(target, abs=1e-7)


def is_lost(stage):
    """It neither says where it is nor moves, until it is found again."""
    with pytest.raises(DeviceError):
        stage.position_m()
    with pytest.raises(DeviceError):
        stage.move_to(START, 0.01)


# Banner, settings and replies


@pytest.mark.parametrize("dump", [False, True])
def test_a_banner_that_comes_late_or_after_a_dump_of_settings_is_waited_for(grbl_open, dump):
    booting = GrblParameters(boot_s=0.3, homing_s=0.0)
    bench, stage = grbl_open(
        booting, GrblFaults(boot_dump=dump), clock=MonotonicClock(), boot_s=5.0, known=False, **REAL_TIME
    )
    assert stage.firmware == "Grbl 1.1h"
    stage.home()
    stage.move_to((-0.002, 0.001, 0.001), 0.02)
    bench.arrive(stage)


@pytest.mark.parametrize("fault", ["no_banner", "status_in_reply", "double_ok"])
def test_what_spoils_no_answer_costs_nothing(grbl_open, fault):
    bench, stage = grbl_open(faults=GrblFaults(**{fault: True}))
    if fault == "no_banner":
        assert stage.firmware == ""
        assert stage.ask_firmware() == "version 1.1h.20190830"
    goes_and_comes_back(bench, stage)
    if fault == "double_ok":
        link = stage._link
        link.command("G21")
        bench.wait(lambda: len(link._replies) == 1)
        with pytest.raises(RefusedError):
            link.command("$nonsense")  # it has an answer of its own


def test_a_device_that_says_nothing_is_refused(grbl_bench):
    with pytest.raises(DeviceError, match="nothing at"):
        grbl_bench(faults=GrblFaults(mute=True), reply_s=0.1).open()


@pytest.mark.parametrize("late", [False, True])
def test_a_lost_ok_stops_the_move_and_a_late_one_is_not_the_next_line_s(grbl_open, late):
    bench, stage = grbl_open(HELD, reply_s=SOON_S)
    bench.spoil(GrblFaults(lose_ok_of="$J"))
    with refused("silence", DeviceError):
        stage.move_to(AWAY, 0.01)
    assert bench.speed_mm_s == 0.0
    assert stage.position_m() == pytest.approx(metres(bench.place_mm), abs=1e-6)
    bench.spoil(GrblFaults())
    before = len(bench.received)
    if late:
        with bench.terminal.lock:
            bench.firmware._reply("ok")
    goes_and_comes_back(bench, stage)
    # The next line went out only after a reset, whose banner divides old answers from new.
    assert bench.received[before:].index(b"\x18") < bench.received[before:].index(b"$J")


def test_a_stale_ok_before_the_banner_is_forgotten(grbl_open):
    _, stage = grbl_open(GrblParameters(homed=True, homing_s=0.0), reply_s=SOON_S)
    with pytest.raises(DeviceError):
        stage._link.command("G1X500F600", moves=True, timeout_s=0.2)  # a soft limit: never answered
    stage.unlock()  # resets, and the ok of that line comes just before the banner
    assert not stage._link.out_of_step
    with pytest.raises(RefusedError):
        stage._link.command("$nonsense")  # refused by its own answer, not granted by the stale one
    stage.home()
    assert stage.position_m() == pytest.approx((-0.001, 0.001, 0.001))


@pytest.mark.parametrize("moves", [False, True])
def test_after_an_alarm_its_name_is_told_and_it_comes_back_by_unlock_and_home_alone(grbl_open, moves):
    bench, stage = grbl_open(GrblParameters(homed=True, homing_s=0.0), reply_s=SOON_S)
    bench.say(b"G1X500F600\n")
    bench.wait(lambda: stage._link.alarm is not None)
    if moves:
        stage._link.restless = True  # as if a move were under way
        with refused("position-lost", DeviceError):
            stage.stop()
        is_lost(stage)
        return
    with pytest.raises(DeviceError, match="ALARM:2"):
        stage.position_m()
    stage.unlock()
    is_lost(stage)
    stage.home()
    stage.move_to((-0.002, 0.001, 0.001), 0.01)
    bench.arrive(stage)


# Restarts, modes, links


@pytest.mark.parametrize("lock", [1, 0])
def test_a_restart_by_itself_loses_the_position_until_it_is_found(grbl_open, lock):
    limits = (
        {} if lock else {"least_m": (-0.1, 0.0, 0.0), "greatest_m": (0.0, 0.1, 0.1), "require_homed": False}
    )
    bench, stage = grbl_open(GrblParameters(homed=True, settings={22: lock, 20: lock}), **limits)
    bench.spoil(GrblFaults(restart_after_mm=3.0))
    stage.move_to(AWAY, 0.01)
    with refused("controller-restarted", DeviceError):
        bench.arrive(stage)
    is_lost(stage)
    stage.stop()
    is_lost(stage)
    assert bench.speed_mm_s == 0.0
    if lock:
        with pytest.raises(DeviceError):
            stage.reference()
        with bench.terminal.lock:
            bench.firmware.model = GrblParameters(homing_s=0.0)
        stage.home()
        assert stage.position_m() == pytest.approx((-0.001, 0.001, 0.001))
    else:
        stage.reference(metres(bench.place_mm))
        goes_and_comes_back(bench, stage)


def test_modes_left_by_others_change_no_move(grbl_open):
    bench, stage = grbl_open()
    bench.say(b"G20G91\n")
    goes_and_comes_back(bench, stage)


def test_a_lost_link_is_an_error_and_never_a_place_and_opened_anew_it_is_stopped(grbl_open):
    bench, stage = grbl_open(HELD)
    bench.move_to_speed(stage, AWAY, 0.01)
    bench.terminal.unplug()
    with pytest.raises(DeviceError, match="port"):
        bench.wait(lambda: stage.moving() and False)
    for call in (stage.position_m, stage.stop):
        with pytest.raises(DeviceError):
            call()
    with refused("port-gone", DeviceError):
        stage.close()
    stage.close()
    assert bench.speed_mm_s > 0.0  # no programme stops a stage without its link: that takes a switch
    bench.terminal.plug()
    again = bench.open(known=False)
    assert bench.speed_mm_s == 0.0
    assert bench.place_mm[0] < -31.0  # not at the end of the move
    is_lost(again)
    again.reference()
    goes_and_comes_back(bench, again)


class Wire:
    """A serial port that fails as a real one does."""

    in_waiting = 0

    def __init__(self, failure=None, short: int = 0) -> None:
        self.failure, self.short, self.closed = failure, short, threading.Event()

    def read(self, size=1):
        self.closed.wait(0.01)
        return b""

    def write(self, data):
        if self.failure:
            raise self.failure
        return len(data) - self.short

    def close(self):
        self.closed.set()


@pytest.mark.parametrize("wire", [Wire(OSError(5, "Input/output error")), Wire(short=1)])
def test_a_write_that_fails_or_falls_short_ends_the_link(wire):
    link = GrblLink(wire, reply_s=10.0, status_s=0.1, clock=MonotonicClock())
    try:
        for attempt in (lambda: link.command("$$"), lambda: link.report(1.0), lambda: link.slow_down(b"!")):
            with pytest.raises(DeviceError) as caught:
                attempt()
            assert caught.value.code in ("port-failed", "port-gone")
    finally:
        link.close()


NOISE = (b"\xff\xfe\x80", b"x" * 5000 + b"\r\n", b"<Idle|MPos:9.000,9.0\r\n")


@pytest.mark.parametrize("noise", NOISE, ids=["8-bit", "overlong", "cut"])
def test_noise_between_lines_costs_at_most_an_answer(grbl_open, noise):
    bench, stage = grbl_open(reply_s=SOON_S)
    bench.spoil(GrblFaults(noise=noise))
    try:
        stage.move_to((-0.0495, 0.050, 0.050), 0.01)
    except DeviceError:  # the answer was spoilt: then it must be standing
        assert bench.speed_mm_s == 0.0
    bench.spoil(GrblFaults())
    bench.arrive(stage)
    goes_and_comes_back(bench, stage)


def test_a_flood_of_noise_takes_no_memory(grbl_open):
    bench, stage = grbl_open()
    with bench.terminal.lock:
        bench.firmware.wire.put((b"[MSG:flood]\r\n" + b"\xff" * 90 + b"\r\n") * 3_000)
    bench.wait(lambda: stage._link.garbage >= 3_000)
    assert len(stage._link._pushed) <= 512


def test_an_unhomed_grblhal_is_not_moved(grbl_open):
    bench, stage = grbl_open(GrblParameters(firmware="grblHAL", homed=True))
    with bench.terminal.lock:
        bench.firmware.homed = False
    with pytest.raises(DeviceError, match=r"home\(\)"):
        stage.move_to((-0.049, 0.050, 0.050), 0.01)
    assert b"$J" not in bench.received


# What its reports say of a motion


@pytest.mark.parametrize(
    ("faults", "code"),
    [
        ({"jump_after_mm": 2.0, "jump_mm": (0.0, 0.5, 0.0)}, "off-path"),
        ({"jump_after_mm": 2.0, "jump_mm": (30.0, 0.0, 0.0)}, "off-path"),
        ({"stuck_after_mm": 2.0}, "stage-stalled"),  # it says that it runs
    ],
)
def test_a_jump_off_the_way_or_a_stand_short_of_the_end_ends_the_move(grbl_open, faults, code):
    bench, stage = grbl_open()
    bench.spoil(GrblFaults(**faults))
    stage.move_to(AWAY, 0.01)
    with refused(code, DeviceError):
        bench.arrive(stage)
    if code == "off-path":
        is_lost(stage)
        stage.stop()
        assert bench.speed_mm_s == 0.0


@pytest.mark.parametrize("faults", [{"stuck_after_mm": 2.0}, {"restart_after_mm": 3.0}])
def test_a_stop_of_one_that_never_stands_or_restarted_says_so(grbl_open, faults):
    bench, stage = grbl_open()
    bench.spoil(GrblFaults(**faults))
    stage.move_to(AWAY, 0.01)
    bench.wait(lambda: bench.firmware._axes.stuck or bench.firmware.state == "Alarm")
    with refused("position-lost", DeviceError):
        stage.stop()
    is_lost(stage)


def test_a_jump_while_it_stands_loses_the_position(grbl_open):
    bench, stage = grbl_open()
    with bench.terminal.lock:
        bench.firmware._axes.shift((0.0, 0.0, -0.1))
    with pytest.raises(DeviceError, match="stood at"):
        stage.position_m()
    is_lost(stage)


@pytest.mark.parametrize(
    ("faults", "spec", "target", "speed"),
    [
        ({"idle_s": 0.6}, {}, (-0.040, 0.050, 0.050), 0.01),  # idle before its end
        ({}, {"still_s": 0.03}, (-0.050, 0.050, 0.05004), 1.7e-5),  # creeping
    ],
)
def test_idle_before_the_end_is_not_the_end_and_a_creeping_move_not_stuck(
    grbl_open, faults, spec, target, speed
):
    bench, stage = grbl_open(faults=GrblFaults(**faults), **spec)
    stage.move_to(target, speed)
    assert stage.moving()
    bench.arrive(stage)
    assert metres(bench.place_mm) == pytest.approx(target, abs=1e-7)


def test_idle_for_good_short_of_the_end_is_a_fault(grbl_open):
    bench, stage = grbl_open()
    bench.move_to_speed(stage, AWAY, 0.01)
    bench.say(b"\x85")  # somebody else cancels the jog
    with pytest.raises(DeviceError, match="has stopped"):
        bench.arrive(stage)
    stage.stop()
    assert stage.position_m() == pytest.approx(metres(bench.place_mm), abs=1e-6)


# The end of the programme


STATES = {
    "standing": lambda bench, stage: None,
    "speeding up": lambda bench, stage: (stage.move_to(AWAY, 0.02), bench.wait(lambda: bench.speed_mm_s > 5)),
    "cruising": lambda bench, stage: bench.move_to_speed(stage, AWAY, 0.01),
    "slowing down": lambda bench, stage: (
        bench.move_to_speed(stage, AWAY, 0.02),
        bench.wait(lambda: bench.speed_mm_s < 10, 0.01),
    ),
    "arrived and not asked": lambda bench, stage: (
        stage.move_to((-0.0499, 0.05, 0.05), 0.02),
        bench.wait(lambda: bench.firmware.state == "Idle"),
    ),
}


@pytest.mark.parametrize("state", STATES)
def test_ctrl_c_in_every_state_stops_it(grbl_open, state):
    bench, stage = grbl_open(HELD)
    with pytest.raises(KeyboardInterrupt), stage:  # noqa: PT012 - it closes as the interrupt passes
        STATES[state](bench, stage)
        raise KeyboardInterrupt
    assert bench.speed_mm_s == 0.0
    assert bench.firmware.state == "Idle"  # no alarm: the position was kept


@pytest.mark.parametrize("awaited", ["newest", "command"])
def test_ctrl_c_while_it_waits_for_an_answer_stops_it(grbl_open, monkeypatch, awaited):
    bench, stage = grbl_open()
    calls = getattr(stage._link, awaited)

    def interrupted(*args, **how):
        calls(*args, **how)
        monkeypatch.setattr(stage._link, awaited, calls)
        raise KeyboardInterrupt

    def programme():
        with stage:
            if awaited == "newest":
                bench.move_to_speed(stage, AWAY, 0.01)
            monkeypatch.setattr(stage._link, awaited, interrupted)
            stage.moving() if awaited == "newest" else stage.move_to(AWAY, 0.01)

    with pytest.raises(KeyboardInterrupt):
        programme()
    assert bench.speed_mm_s == 0.0
    assert bench.firmware.state == "Idle"


PROGRAMME = """
import signal, sys, time
# A shell starts what runs in the background deaf to Ctrl-C; a person's terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec
spec = GrblSpec(sys.argv[1], boot_s=0.02, reply_s=30.0, still_s=60.0, stop_s=60.0)
with GrblStage.open(spec) as stage:
    stage.reference()
    stage.move_to((-0.001, 0.050, 0.050), 0.0005)  # which takes 98 s
    print("moving", flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals as on POSIX")
def test_a_programme_that_ctrl_c_ends_stops_its_stage(grbl_bench):
    bench = grbl_bench(HELD, clock=MonotonicClock(), **REAL_TIME)
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAMME, bench.terminal.path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as programme:
        assert programme.stdout is not None
        assert programme.stdout.readline() == "moving\n"
        bench.wait(lambda: bench.speed_mm_s > 0)
        time.sleep(0.05)  # no condition: let it be anywhere in its sleep
        programme.send_signal(signal.SIGINT)
        try:
            _, said = programme.communicate(timeout=60)
        finally:
            programme.kill()  # else a programme that does not end is waited for without end
    # Python ends by the signal itself after an unhandled KeyboardInterrupt.
    assert programme.returncode == -signal.SIGINT, said
    assert bench.speed_mm_s == 0.0
    assert bench.firmware.state == "Idle"
    sent = bench.received
    assert b"\x85" in sent
    assert b"\x18" not in sent  # it was never reset in motion
    assert bench.place_mm[0] < -2.0
