"""Each fault that a GRBL stage was seen to have, or can have: made to happen, over a real pseudo-terminal."""

from __future__ import annotations

import math
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
SOON_S = 1.0  # for an answer that must not come; each such test waits for it once or twice


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


class TestS1Banner:
    def test_one_that_comes_late_is_waited_for(self, grbl_bench):
        booting = GrblParameters(boot_s=0.3, homing_s=0.0)
        stage = grbl_bench(booting, clock=MonotonicClock(), boot_s=5.0, **REAL_TIME).open(known=False)
        stage.home()
        assert stage.position_m() == pytest.approx((-0.001, 0.001, 0.001))

    def test_none_at_all_is_no_fault_where_status_is_answered(self, grbl_open):
        bench, stage = grbl_open(faults=GrblFaults(no_banner=True))
        assert stage.firmware == ""
        assert stage.ask_firmware() == "version 1.1h.20190830"
        goes_and_comes_back(bench, stage)

    def test_a_device_that_says_nothing_is_refused(self, grbl_bench):
        bench = grbl_bench(faults=GrblFaults(mute=True), reply_s=0.1)
        with pytest.raises(DeviceError, match="nothing at"):
            bench.open()


def test_s2_a_dump_of_settings_before_the_banner_is_no_answer(grbl_open):
    booting = GrblParameters(boot_s=0.3, homing_s=0.0)
    dump = GrblFaults(boot_dump=True)
    bench, stage = grbl_open(booting, dump, clock=MonotonicClock(), boot_s=5.0, **REAL_TIME, known=False)
    stage.home()
    stage.move_to((-0.002, 0.001, 0.001), 0.01)
    bench.arrive(stage)


def test_s3_a_status_in_the_midst_of_a_reply_spoils_neither(grbl_bench):
    bench = grbl_bench(faults=GrblFaults(status_in_reply=True))
    goes_and_comes_back(bench, bench.open())


class TestS4Replies:
    def test_a_lost_ok_stops_the_move_and_is_said(self, grbl_open):
        bench, stage = grbl_open(HELD, reply_s=SOON_S)
        bench.spoil(GrblFaults(lose_ok_of="$J"))
        with refused("silence", DeviceError):
            stage.move_to(AWAY, 0.01)
        assert bench.speed_mm_s == 0.0
        assert stage.position_m() == pytest.approx(metres(bench.place_mm), abs=1e-6)
        bench.spoil(GrblFaults())
        goes_and_comes_back(bench, stage)

    def test_an_ok_that_comes_too_late_is_not_the_next_line_s(self, grbl_open):
        bench, stage = grbl_open(reply_s=SOON_S)
        bench.spoil(GrblFaults(lose_ok_of="$J"))
        with pytest.raises(DeviceError):
            stage.move_to(AWAY, 0.01)
        bench.spoil(GrblFaults())
        before = len(bench.received)
        with bench.terminal.lock:
            bench.firmware._reply("ok")
        goes_and_comes_back(bench, stage)
        # The next line went out only after a reset, whose banner divides old answers from new.
        assert bench.received[before:].index(b"\x18") < bench.received[before:].index(b"$J")

    def test_a_doubled_ok_is_not_the_answer_to_the_next_line(self, grbl_bench):
        bench = grbl_bench(faults=GrblFaults(double_ok=True))
        link = bench.open()._link
        link.command("G21")
        bench.wait(lambda: len(link._replies) == 1)
        with pytest.raises(RefusedError):
            link.command("$nonsense")

    def test_a_stale_ok_before_the_banner_is_forgotten(self, grbl_open):
        bench, stage = grbl_open(GrblParameters(homed=True, homing_s=0.0), reply_s=SOON_S)
        with pytest.raises(DeviceError):
            stage._link.command("G1X500F600", moves=True, timeout_s=0.2)  # a soft limit: never answered
        stage.unlock()  # resets, and the ok of that line comes just before the banner
        assert not stage._link.out_of_step
        with pytest.raises(RefusedError):
            stage._link.command("$nonsense")  # refused by its own answer, not granted by the stale one
        stage.home()
        assert stage.position_m() == pytest.approx((-0.001, 0.001, 0.001))


class TestS8SilenceAfterAnAlarm:
    @pytest.fixture
    def silent(self, grbl_open):
        bench, stage = grbl_open(GrblParameters(homed=True, homing_s=0.0), reply_s=SOON_S)
        bench.say(b"G1X500F600\n")
        bench.wait(lambda: stage._link.alarm is not None)
        return bench, stage

    def test_it_comes_back_by_unlock_and_home_alone(self, silent):
        bench, stage = silent
        with pytest.raises(DeviceError, match="ALARM:2"):
            stage.position_m()
        stage.unlock()
        is_lost(stage)
        stage.home()
        stage.move_to((-0.002, 0.001, 0.001), 0.01)
        bench.arrive(stage)

    def test_a_stop_still_ends_and_says_that_the_position_is_lost(self, silent):
        _, stage = silent
        stage._link.restless = True  # as if a move were under way
        with refused("position-lost", DeviceError):
            stage.stop()
        is_lost(stage)


@pytest.mark.parametrize("lock", [1, 0])
def test_s9_a_restart_by_itself_loses_the_position_until_it_is_found(grbl_open, lock):
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


def test_s9_a_stop_that_finds_a_restart_says_so(grbl_open):
    bench, stage = grbl_open()
    bench.spoil(GrblFaults(restart_after_mm=3.0))
    stage.move_to(AWAY, 0.01)
    bench.wait(lambda: bench.firmware.state == "Alarm")
    with refused("position-lost", DeviceError):
        stage.stop()
    is_lost(stage)


class TestS10Modes:
    def test_modes_left_by_others_change_no_move(self, grbl_open):
        bench, stage = grbl_open()
        bench.say(b"G20G91\n")
        goes_and_comes_back(bench, stage)

    def test_a_reset_changes_no_move(self, grbl_open):
        bench, stage = grbl_open(HELD)
        bench.say(b"G20G91\n")
        bench.move_to_speed(stage, AWAY, 0.01)
        bench.say(b"!")  # on this one it holds the jog, which a reset then ends
        stage.stop()
        assert b"\x18" in bench.received
        goes_and_comes_back(bench, stage)


class TestS11LostLink:
    def test_a_lost_link_is_an_error_and_never_a_place(self, grbl_open):
        bench, stage = grbl_open()
        bench.move_to_speed(stage, AWAY, 0.01)
        bench.terminal.unplug()
        with pytest.raises(DeviceError, match="port"):
            bench.wait(lambda: stage.moving() and False)
        with pytest.raises(DeviceError):
            stage.position_m()
        with pytest.raises(DeviceError):
            stage.stop()
        with refused("port-gone", DeviceError):
            stage.close()
        stage.close()
        assert bench.speed_mm_s > 0.0  # no programme stops a stage without its link: that takes a switch

    def test_opened_anew_it_is_stopped_and_its_position_not_trusted(self, grbl_open):
        bench, stage = grbl_open(HELD)
        bench.move_to_speed(stage, AWAY, 0.01)
        bench.terminal.unplug()
        stage._link.close()
        bench.terminal.plug()
        assert bench.speed_mm_s > 0.0
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
def test_s12_a_write_that_fails_or_falls_short_ends_the_link(wire):
    link = GrblLink(wire, reply_s=10.0, status_s=0.1, clock=MonotonicClock())
    try:
        for attempt in (lambda: link.command("$$"), lambda: link.report(1.0), lambda: link.slow_down(b"!")):
            with pytest.raises(DeviceError) as caught:
                attempt()
            assert caught.value.code in ("port-failed", "port-gone")
    finally:
        link.close()


class TestS13Noise:
    NOISE = (b"\xff\xfe\x80", b"x" * 5000 + b"\r\n", b"<Idle|MPos:9.000,9.0\r\n")

    @pytest.mark.parametrize("noise", NOISE, ids=["8-bit", "overlong", "cut"])
    def test_noise_between_lines_costs_at_most_an_answer(self, grbl_open, noise):
        bench, stage = grbl_open(reply_s=SOON_S)
        bench.spoil(GrblFaults(noise=noise))
        try:
            stage.move_to((-0.0495, 0.050, 0.050), 0.01)
        except DeviceError:  # the answer was spoilt: then it must be standing
            assert bench.speed_mm_s == 0.0
        bench.spoil(GrblFaults())
        bench.arrive(stage)
        goes_and_comes_back(bench, stage)

    def test_a_flood_of_noise_takes_no_memory(self, grbl_open):
        bench, stage = grbl_open()
        with bench.terminal.lock:
            bench.firmware.wire.put((b"[MSG:flood]\r\n" + b"\xff" * 90 + b"\r\n") * 3_000)
        bench.wait(lambda: stage._link.garbage >= 3_000)
        assert len(stage._link._pushed) <= 512
        goes_and_comes_back(bench, stage)


class TestS14Unhomed:
    def test_an_unhomed_grblhal_is_not_moved(self, grbl_open):
        bench, stage = grbl_open(GrblParameters(firmware="grblHAL", homed=True))
        with bench.terminal.lock:
            bench.firmware.homed = False
        with pytest.raises(DeviceError, match=r"home\(\)"):
            stage.move_to((-0.049, 0.050, 0.050), 0.01)
        assert b"$J" not in bench.received


class TestS16Jumps:
    @pytest.mark.parametrize("jump", [(0.0, 0.5, 0.0), (30.0, 0.0, 0.0)])
    def test_a_jump_off_the_way_loses_the_position(self, grbl_open, jump):
        bench, stage = grbl_open()
        bench.spoil(GrblFaults(jump_after_mm=2.0, jump_mm=jump))
        stage.move_to(AWAY, 0.01)
        with refused("off-path", DeviceError):
            bench.arrive(stage)
        is_lost(stage)
        stage.stop()
        assert bench.speed_mm_s == 0.0

    def test_a_jump_while_it_stands_loses_the_position(self, grbl_open):
        bench, stage = grbl_open()
        with bench.terminal.lock:
            bench.firmware._axes.shift((0.0, 0.0, -0.1))
        with pytest.raises(DeviceError, match="stood at"):
            stage.position_m()
        is_lost(stage)


class TestS17Stuck:
    def test_one_that_says_it_runs_and_does_not_is_found_out(self, grbl_open):
        bench, stage = grbl_open()
        bench.spoil(GrblFaults(stuck_after_mm=2.0))
        stage.move_to(AWAY, 0.01)
        with refused("stage-stalled", DeviceError):
            bench.arrive(stage)

    def test_a_stop_of_one_that_never_stands_ends_all_the_same(self, grbl_open):
        bench, stage = grbl_open()
        bench.spoil(GrblFaults(stuck_after_mm=2.0))
        stage.move_to(AWAY, 0.01)
        bench.wait(lambda: bench.firmware._axes.stuck)
        with refused("position-lost", DeviceError):
            stage.stop()
        is_lost(stage)

    def test_a_creeping_move_is_not_taken_for_a_stuck_one(self, grbl_open):
        bench, stage = grbl_open(still_s=0.03)
        stage.move_to((-0.050, 0.050, 0.05004), 1.7e-5)
        bench.arrive(stage)
        assert metres(bench.place_mm)[2] == pytest.approx(0.05004, abs=1e-7)


def test_s18_no_number_goes_out_that_the_firmware_misreads(grbl_open):
    bench, stage = grbl_open()
    before = bench.received
    for bad in (math.nan, math.inf, -math.inf, 1e300):
        with pytest.raises(ValueError, match="travel"):
            stage.move_to((bad, 0.050, 0.050), 0.01)
        with pytest.raises(ValueError, match="speed"):
            stage.move_to(START, bad)
    assert bench.received == before
    stage.move_to((-1e-12, 0.050, 0.050), 0.02)  # which in plain notation would carry an exponent
    bench.arrive(stage)
    assert stage.position_m()[0] == 0.0


class TestS19Idle:
    def test_idle_before_the_end_is_not_the_end(self, grbl_open):
        bench, stage = grbl_open(faults=GrblFaults(idle_s=0.6))
        stage.move_to((-0.040, 0.050, 0.050), 0.01)
        assert stage.moving()
        bench.arrive(stage)
        assert metres(bench.place_mm) == pytest.approx((-0.040, 0.050, 0.050), abs=1e-7)

    def test_idle_for_good_short_of_the_end_is_a_fault(self, grbl_open):
        bench, stage = grbl_open()
        bench.move_to_speed(stage, AWAY, 0.01)
        bench.say(b"\x85")  # somebody else cancels the jog
        with pytest.raises(DeviceError, match="has stopped"):
            bench.arrive(stage)
        stage.stop()
        assert stage.position_m() == pytest.approx(metres(bench.place_mm), abs=1e-6)


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


class TestS20TheEndOfTheProgramme:
    @pytest.mark.parametrize("state", STATES)
    def test_ctrl_c_in_every_state_stops_it(self, grbl_open, state):
        bench, stage = grbl_open(HELD)

        def programme():
            with stage:
                STATES[state](bench, stage)
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            programme()
        assert bench.speed_mm_s == 0.0
        assert bench.firmware.state == "Idle"  # no alarm: the position was kept

    @pytest.mark.parametrize("awaited", ["newest", "command"])
    def test_ctrl_c_while_it_waits_for_an_answer_stops_it(self, grbl_open, monkeypatch, awaited):
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

    @pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals as on POSIX")
    def test_a_programme_that_ctrl_c_ends_stops_its_stage(self, grbl_bench):
        bench = grbl_bench(HELD, clock=MonotonicClock(), **REAL_TIME)
        code = (
            "import signal, sys, time\n"
            # A shell starts what runs in the background deaf to Ctrl-C; a person's terminal does not.
            "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "from palpate.rig.real.grbl.grbl_stage import GrblStage\n"
            "from palpate.rig.real.grbl.grbl_supervisor import GrblSpec\n"
            "spec = GrblSpec(sys.argv[1], boot_s=0.02, reply_s=30.0, still_s=60.0, stop_s=60.0)\n"
            "with GrblStage.open(spec) as stage:\n"
            "    stage.reference()\n"
            "    stage.move_to((-0.001, 0.050, 0.050), 0.0005)\n"  # which takes 98 s
            "    print('moving', flush=True)\n"
            "    time.sleep(600)\n"
        )
        with subprocess.Popen(
            [sys.executable, "-c", code, bench.terminal.path],
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
