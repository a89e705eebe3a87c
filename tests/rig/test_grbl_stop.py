"""Stop of a GRBL stage: from every state, on both firmwares, with its distance counted from the fake's place.

All of it is on a fake that was made from observed behaviour; no real firmware has run here.
"""

import math
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, strategies as st
from tests.fakes.grbl_controller import CANCEL, DOOR, HOLD, RESET
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.refusals import refused
from tests.slow_params import mostly_slow

from palpate.core.clock import NS_PER_S, MonotonicClock
from palpate.core.errors import DeviceError, RangeError
from palpate.rig.real.gcode_stage import PositionLostError
from palpate.rig.real.grbl.grbl_move import MoveSupervisor
from palpate.rig.real.grbl.grbl_supervisor import GrblMachine, GrblSpec

START = (-0.050, 0.050, 0.050)
AWAY = (-0.020, 0.050, 0.050)
LATENCY_S = 0.02  # of the fake, from a byte to its effect; the driver's spec in these tests states as much
TICK_MM_S = 0.002  # per mm/s: the fake takes up a byte at its next tick
ACCELERATION_MM_S2 = 50.0
FIRMWARES = {
    "Grbl 1.1h": GrblParameters(homed=True, latency_s=LATENCY_S),
    "grblHAL": GrblParameters(firmware="grblHAL", homed=True, latency_s=LATENCY_S),
}


@pytest.fixture(params=FIRMWARES.values(), ids=FIRMWARES)
def model(request):
    return request.param


def bound_mm(speed_mm_s: float, latency_s: float = LATENCY_S) -> float:
    """v^2 / 2a + v latency, and the fake's own coarseness."""
    return (
        speed_mm_s**2 / (2 * ACCELERATION_MM_S2) + speed_mm_s * (latency_s + TICK_MM_S) + 0.001  # of a report
    )


class TestDistance:
    """From where the first byte of a stop came to the stand."""

    @pytest.mark.parametrize("speed_mm_s", [1.0, 20.0])
    def test_a_jog_stops_within_its_bound_and_no_sooner_than_it_can(self, grbl_open, model, speed_mm_s):
        bench, stage = grbl_open(model)
        bench.move_to_speed(stage, AWAY, speed_mm_s / 1e3)
        stage.stop()
        went = math.dist(bench.stops(CANCEL)[0], bench.place_mm)
        slowing = speed_mm_s**2 / (2 * ACCELERATION_MM_S2)
        assert slowing - 1e-3 <= went <= bound_mm(speed_mm_s)
        assert went <= stage.travel.overshoot_m(speed_mm_s / 1e3) * 1e3 + speed_mm_s * TICK_MM_S + 0.001
        assert bench.firmware.state == "Idle"
        assert stage.position_m()[0] * 1e3 == pytest.approx(bench.place_mm[0], abs=1e-3)  # and is known

    def test_a_jog_that_still_speeds_up_stops_within_its_bound(self, grbl_open, model):
        bench, stage = grbl_open(model)
        stage.move_to(AWAY, 0.02)
        bench.wait(lambda: bench.speed_mm_s > 3.0, 0.005)
        stage.stop()
        # Meanwhile it speeds up, for the latency at most.
        most = bench.firmware._axes.acceleration_mm_s2 * (LATENCY_S + 0.01) + 5.0
        assert math.dist(bench.stops(CANCEL)[0], bench.place_mm) <= bound_mm(most)

    def test_a_programmed_move_of_somebody_else_is_held_within_its_bound(self, grbl_open, model):
        bench, stage = grbl_open(model)
        bench.say(b"G21G90G94G1X-20F600\n")
        bench.wait(lambda: bench.speed_mm_s >= 9.99, 0.01)
        with pytest.raises(DeviceError, match="now at"):  # it is where the driver did not send it
            stage.stop()
        assert math.dist(bench.stops(HOLD)[0], bench.place_mm) <= bound_mm(10.0)
        assert bench.firmware.state == "Idle"
        assert bench.speed_mm_s == 0.0

    def test_without_the_jog_cancel_grblhal_runs_on_to_its_end_and_the_stop_says_so(self, grbl_open):
        """The control: the hold that follows stops Grbl 1.1h, late, and does not stop grblHAL."""
        went = {}
        for name in ("Grbl 1.1h", "grblHAL"):
            bench, stage = grbl_open(FIRMWARES[name], GrblFaults(deaf_to_cancel=True), stop_s=30.0)
            target = (-0.038, 0.050, 0.050)
            bench.move_to_speed(stage, target, 0.010)
            if name == "grblHAL":
                with refused("stop-ignored", DeviceError):
                    stage.stop()
            else:
                stage.stop()
            went[name] = math.dist(bench.stops(CANCEL)[0], bench.place_mm)
            assert bench.speed_mm_s == 0.0
            assert stage.position_m()[0] * 1e3 == pytest.approx(bench.place_mm[0], abs=1e-3)
        assert went["grblHAL"] > 2 * bound_mm(10.0)
        assert went["Grbl 1.1h"] < went["grblHAL"] / 2

    def test_what_nothing_else_stops_is_reset_in_motion_and_its_place_given_up(self, grbl_open):
        bench, stage = grbl_open(FIRMWARES["grblHAL"], GrblFaults(deaf_to_cancel=True), stop_s=0.3)
        bench.move_to_speed(stage, (-0.001, 0.050, 0.050), 0.010)
        with refused("position-lost", DeviceError):
            stage.stop()
        assert bench.speed_mm_s == 0.0
        assert bench.place_mm[0] < -10.0  # long before its target


class TestShortOfTheTarget:
    def test_a_short_step_whose_ok_is_lost_is_no_stop_that_failed(self, grbl_open):
        """It arrives while its answer is waited for; nothing asked it to stop before."""
        bench, stage = grbl_open(FIRMWARES["grblHAL"], reply_s=1.0)
        bench.spoil(GrblFaults(lose_ok_of="$J"))

        def run_on():
            bench.wait(lambda: b"$J" in bench.received)
            end_ns = bench.clock.now_ns() + NS_PER_S
            bench.wait(lambda: bench.clock.now_ns() > end_ns)

        with ThreadPoolExecutor(1) as pool:
            runs = pool.submit(run_on)
            with refused("silence", DeviceError):
                stage.move_to((-0.0497, 0.050, 0.050), 0.002)
            runs.result()
        assert stage.position_m()[0] == pytest.approx(-0.0497, abs=1e-6)

    def test_a_jog_cancel_that_is_lost_once_is_sent_again(self, grbl_open, model):
        bench, stage = grbl_open(model, GrblFaults(deaf_to_cancel=True))
        bench.move_to_speed(stage, AWAY, 0.010)
        stage._link.halt()
        bench.spoil(GrblFaults())
        stage.stop()
        # Asked again after at most a tenth of a second.
        assert math.dist(bench.stops(CANCEL)[0], bench.place_mm) <= bound_mm(10.0, LATENCY_S + 0.15)

    @pytest.mark.parametrize("passes", [True, False], ids=["", "control: 0x19 is lost"])
    def test_a_cancel_that_meets_the_end_of_its_jog_on_grblhal_loses_no_place(self, grbl_open, passes):
        """It says Idle, reads no line, and a reset alone raises ALARM:3."""
        bench, stage = grbl_open(GrblParameters("grblHAL", homed=True))
        write = stage._link._write
        stage._link._write = lambda data: write(data) if passes or data != b"\x19" else None
        stage.move_to((-0.049, 0.050, 0.050), 0.010)
        bench.wait(lambda: bench.firmware.state == "Idle")
        with bench.terminal.lock:
            bench.firmware._take_up(CANCEL)  # it came in the jog, and is obeyed after its end
        if not passes:
            with pytest.raises(PositionLostError):
                stage.stop()
            return
        stage.stop()
        stage.move_to(START, 0.010)
        bench.arrive(stage)
        assert bench.place_mm[0] == pytest.approx(-50.0, abs=1e-4)

    def test_a_reset_is_answered_by_its_own_banner(self, grbl_open, model):
        """The banner of a reset in motion may come after its alarm is known."""
        bench, stage = grbl_open(model)
        link = stage._link
        link._take(b"ALARM:3")
        with ThreadPoolExecutor(1) as pool:
            before = bench.received.count(RESET)
            reset = pool.submit(link.reset)
            with pytest.raises(TimeoutError):
                reset.result(timeout=0.2)
            assert bench.received.count(RESET) == before
            link._take(b"Grbl 1.1h ['$' for help]")
            assert reset.result(timeout=10.0)
            assert bench.received.count(RESET) == before + 1

    def test_a_reset_whose_banner_is_lost_is_repeated_and_keeps_the_place(
        self, grbl_open, model, monkeypatch
    ):
        bench, stage = grbl_open(model, reply_s=0.5)
        before_m = stage.position_m()
        bench.say(b"!")
        greet, lost = bench.firmware._greet, []

        def lose_one(**words):
            if lost:
                greet(**words)
            lost.append(True)

        monkeypatch.setattr(bench.firmware, "_greet", lose_one)
        stage.stop()
        assert len(lost) == 2
        assert stage.position_m() == pytest.approx(before_m, abs=1e-6)


STANDING = {
    "Idle": lambda bench: None,
    "Hold": lambda bench: bench.say(b"!"),
    "Check": lambda bench: bench.say(b"$C\n"),
    "Sleep": lambda bench: bench.say(b"$SLP\n"),
    "Alarm": lambda bench: bench.say(b"G1X500F600\n"),  # on grblHAL homed, as on 1.1h
    "Door": lambda bench: bench.say(bytes([DOOR])),
}


class TestStates:
    @pytest.mark.parametrize("state", STANDING)
    @pytest.mark.cases(10)
    def test_from_every_state_in_which_it_stands_a_stop_ends_idle_or_locked(self, grbl_open, model, state):
        if state == "Sleep" and model.firmware == "grblHAL":
            pytest.skip("a default build of grblHAL has no $SLP")
        bench, stage = grbl_open(model, silence_s=1.0, reply_s=1.0)
        STANDING[state](bench)
        bench.clock.sleep(0.1)
        bench.wait(lambda: bench.firmware.state.startswith(state))
        before = bench.place_mm
        lost = state in ("Sleep", "Alarm")
        if lost:
            with refused("position-lost", DeviceError) as caught:
                stage.stop()
            assert "power" not in str(caught.value)
            assert ("asleep" in str(caught.value)) == (state == "Sleep")
        else:
            stage.stop()
        assert bench.firmware.state == ("Alarm" if lost else "Idle")
        assert bench.place_mm == pytest.approx(before)
        if lost:
            stage.unlock()
            stage.reference()
            stage._session.unlocked = False  # as after homing, which takes long on this clock
        stage.move_to((-0.0495, 0.050, 0.050), 0.010)
        bench.arrive(stage)

    @pytest.mark.parametrize("state", ["Hold", "Check", "Sleep"])
    def test_no_move_begins_where_it_is_not_idle_until_a_reset_clears_it(self, grbl_open, model, state):
        if state == "Sleep" and model.firmware == "grblHAL":
            pytest.skip("a default build of grblHAL has no $SLP")
        bench, stage = grbl_open(model)
        STANDING[state](bench)
        bench.wait(lambda: bench.firmware.state.startswith(state))
        with pytest.raises(DeviceError, match=rf"in {state}.*stop\(\) it"):
            stage.move_to(AWAY, 0.01)
        assert b"$J" not in bench.received
        stage.unlock()
        assert bench.firmware.state == "Idle"

    def test_a_door_that_opens_in_a_jog_stops_it_and_is_named_until_it_is_closed(self, grbl_open, model):
        bench, stage = grbl_open(model)
        bench.move_to_speed(stage, AWAY, 0.010)
        with bench.terminal.lock:
            bench.firmware.open_door()
            opened = bench.firmware.place_mm
        with pytest.raises(DeviceError, match="door input"):
            bench.arrive(stage)
        assert math.dist(opened, bench.place_mm) <= bound_mm(10.0)
        with refused("hardware-stop", DeviceError):
            stage.stop()
        with bench.terminal.lock:
            bench.firmware.door_open = False
        stage.stop()
        assert bench.firmware.state == "Idle"
        assert stage.position_m()[0] * 1e3 == pytest.approx(bench.place_mm[0], abs=1e-3)

    @pytest.mark.parametrize("moving", ["jog", "programmed"])
    def test_opening_a_port_finds_a_motion_and_stops_it(self, grbl_bench, model, moving):
        bench = grbl_bench(model)
        bench.say({"jog": b"$J=G21G90G53X-10F600\n", "programmed": b"G21G90G94G1X-10F600\n"}[moving])
        bench.wait(lambda: bench.speed_mm_s >= 9.99, 0.01)
        stage = bench.open(known=False)
        assert bench.speed_mm_s == 0.0
        byte = {"jog": CANCEL, "programmed": HOLD}[moving]
        assert math.dist(bench.stops(byte)[0], bench.place_mm) <= bound_mm(10.0)
        assert not bench.stops(RESET) or bench.firmware.state == "Idle"
        stage.reference()

    def test_a_controller_that_reads_no_line_since_an_earlier_cancel_can_be_opened(self, grbl_bench, model):
        bench = grbl_bench(model)
        with bench.terminal.lock:
            bench.firmware._hung = True  # as after a jog cancel that met the end of its jog
        stage = bench.open(known=False)
        assert bench.firmware.state == "Idle"
        stage.reference()
        stage.move_to(AWAY, 0.01)
        bench.arrive(stage)

    def test_nothing_is_reset_while_it_moves_but_to_end_homing(self, grbl_open, model):
        bench, stage = grbl_open(model)
        for _ in range(3):
            before = len(bench.stops(RESET))
            bench.move_to_speed(stage, AWAY, 0.010)
            stage.stop()
            # On a busy machine a cancel sent again can meet the end of its jog, which a reset then clears.
            assert all(math.dist(at, bench.place_mm) == 0.0 for at in bench.stops(RESET)[before:])
            stage.move_to(START, 0.02)
            bench.arrive(stage)


# Status of a GRBL stage on a period: what is lost, damaged or late on the wire costs no run and no place.

SPOILT = {
    "lost": GrblFaults(lose_every=5),
    "damaged": GrblFaults(garble_every=5),
    "lost and damaged": GrblFaults(lose_every=7, garble_every=5),
}


@pytest.mark.parametrize("spoilt", mostly_slow(list(SPOILT.values()), lambda i: i == 2), ids=SPOILT)
@pytest.mark.cases(1)
def test_a_descent_in_steps_arrives_whatever_is_lost_on_the_wire(grbl_open, model, spoilt):
    bench, stage = grbl_open(model, spoilt)
    for i in range(1, 6):
        stage.move_to((-0.050, 0.050, 0.050 + i * 0.2e-3), 0.005)
        bench.arrive(stage)
        assert stage.position_m()[2] == pytest.approx(0.050 + i * 0.2e-3, abs=1e-6)
    bench.move_to_speed(stage, (-0.030, 0.050, 0.051), 0.010)
    stage.stop()
    assert bench.speed_mm_s == 0.0
    assert stage.position_m()[0] * 1e3 == pytest.approx(bench.place_mm[0], abs=1e-3)


def test_reports_that_are_late_by_seconds_end_no_descent(grbl_open):
    bench, stage = grbl_open(
        FIRMWARES["Grbl 1.1h"], clock=MonotonicClock(), silence_s=30.0, still_s=60.0, stop_s=30.0
    )
    bench.spoil(GrblFaults(late_every=25, late_s=1.2))
    for i in range(1, 4):
        stage.move_to((-0.050, 0.050, 0.050 + i * 0.2e-3), 0.005)
        bench.arrive(stage)
        assert stage.position_m()[2] == pytest.approx(0.050 + i * 0.2e-3, abs=1e-6)
    assert bench.firmware.wire.reports >= 25


def test_what_was_lost_and_damaged_is_counted_and_told(grbl_open):
    bench, stage = grbl_open(FIRMWARES["Grbl 1.1h"])
    assert stage.health == ""
    bench.spoil(GrblFaults(lose_every=3, garble_every=4))
    for _ in range(12):
        stage.position_m()
    damaged, lost = (int(part.split()[0]) for part in stage.health.split(", "))
    assert damaged >= 1
    assert lost >= 1
    assert damaged <= bench.firmware.wire.reports // 4
    # A damaged report is no answer either, and the last question may still be under way.
    assert lost <= bench.firmware.wire.lost + damaged + 1


def test_a_lost_question_delays_an_answer_by_a_period_and_no_more(grbl_bench):
    bench = grbl_bench(FIRMWARES["Grbl 1.1h"], silence_s=30.0)
    link = bench.open()._link
    least = math.inf
    for _ in range(5):  # the least of some: a loaded machine may add anything
        bench.spoil(GrblFaults(silent=True))
        asked, began = link.asked, time.monotonic()
        while link.asked == asked:
            time.sleep(0.001)
        bench.spoil(GrblFaults())
        assert link.report(30.0)
        least = min(least, time.monotonic() - began)
    assert least < 4 * 0.1


def test_a_stage_that_is_gone_is_told_within_its_time_while_a_look_waits_for_nothing(grbl_open):
    bench, stage = grbl_open(FIRMWARES["Grbl 1.1h"], clock=MonotonicClock(), silence_s=0.5, still_s=60.0)
    stage.move_to((-0.001, 0.050, 0.050), 0.001)
    bench.wait(lambda: stage.position_m()[0] > -0.0499)
    bench.spoil(GrblFaults(silent=True))
    began, looks = time.monotonic(), 0
    said = ""
    while not said:  # each look waits for 20 ms at most, so that a force is watched all the while
        assert time.monotonic() - began < 60.0
        try:
            assert stage.moving()
            looks += 1
        except DeviceError as error:
            said = str(error)
    assert "0.5 s" in said
    assert time.monotonic() - began >= 0.4
    assert looks >= 5


def test_a_silent_stage_that_takes_a_reset_keeps_its_place_and_can_be_lifted(grbl_open):
    bench, stage = grbl_open(FIRMWARES["Grbl 1.1h"], silence_s=0.4)
    bench.move_to_speed(stage, (-0.030, 0.050, 0.050), 0.010)
    bench.spoil(GrblFaults(silent=True))
    stage._link.halt()
    bench.wait(lambda: bench.speed_mm_s == 0.0)
    with bench.terminal.lock:
        soft_reset = bench.firmware._soft_reset

        def reset_and_speak():
            bench.firmware.faults = GrblFaults()
            soft_reset()

        bench.firmware._soft_reset = reset_and_speak
    stage.stop()
    stage.move_to((-0.050, 0.050, 0.049), 0.010)
    bench.arrive(stage)
    assert bench.place_mm == pytest.approx((-50.0, -50.0, -49.0), abs=1e-4)


def test_reports_that_come_in_a_burst_are_not_taken_for_now(grbl_open):
    bench, stage = grbl_open(FIRMWARES["Grbl 1.1h"], clock=MonotonicClock(), silence_s=30.0, still_s=60.0)
    link = stage._link
    with bench.terminal.lock:
        bench.firmware.wire._held_until_s = bench.terminal.now_s() + 0.6
    asked = link.asked
    while link.asked < asked + 3:
        time.sleep(0.01)
    with bench.terminal.lock:  # so some answers are on their way, of a place that it leaves now
        bench.firmware._axes.shift((0.5, 0.0, 0.0))
    assert link.report(30.0).status.machine_mm[0] == pytest.approx(-49.5)


@pytest.mark.parametrize("words", [{"silence_s": 0.1}, {"status_s": 2.0}, {"status_s": 0.0}])
def test_times_at_which_one_lost_answer_is_a_lost_stage_are_refused(words):
    with pytest.raises(RangeError):
        GrblSpec("/dev/ttyACM0", **words)


MACHINE = GrblMachine((250.0,) * 3, (1200.0,) * 3, (50.0,) * 3, (100.0,) * 3, True)


@given(
    st.floats(0.01, 40.0),
    st.floats(0.2, 20.0),
    st.lists(st.floats(0.0, 0.3), min_size=1, max_size=8),
    st.floats(0.0, 1.0),
)
def test_between_reports_it_is_where_an_even_motion_has_it_never_back_and_never_beyond(
    length_mm, speed_mm_s, waits_s, first
):
    target = (length_mm, 0.0, 0.0)
    move = MoveSupervisor((0.0, 0.0, 0.0), target, speed_mm_s * 60, MACHINE, 1.0, 0)
    time_s, told = round(first * 0.5, 3), 0.0
    for wait_s in (round(one, 3) for one in waits_s):
        here = _along(length_mm, speed_mm_s, time_s)
        move.note((here, 0.0, 0.0), round(time_s * 1e9))
        time_s += wait_s
        at = move.place_at(round(time_s * 1e9))[0]
        assert told - 1e-9 <= at <= length_mm + 1e-9
        if here > 0:
            # The integration's own steps are a millisecond of the speed.
            assert at == pytest.approx(_along(length_mm, speed_mm_s, time_s), abs=2e-3 * (1 + speed_mm_s))
        told = at


def _along(length_mm: float, speed_mm_s: float, until_s: float, rate: float = 50.0) -> float:
    step_s, along, speed, steps = 1e-3, 0.0, 0.0, round(until_s / 1e-3)
    top = min(speed_mm_s, math.sqrt(rate * length_mm))
    for _ in range(steps):
        left = length_mm - along
        slow = math.sqrt(max(2 * rate * left, 0.0))
        new = min(speed + rate * step_s, top, max(slow, 0.0))
        along, speed = min(along + (speed + new) / 2 * step_s, length_mm), new
    return along
