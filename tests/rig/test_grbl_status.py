"""Status of a GRBL stage on a period: what is lost, damaged or late on the wire costs no run and no place."""

import math
import time

import pytest
from hypothesis import given, strategies as st
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.slow_params import mostly_slow

from palpate.core.clock import MonotonicClock
from palpate.core.errors import DeviceError, RangeError
from palpate.rig.real.grbl.grbl_move import MoveSupervisor
from palpate.rig.real.grbl.grbl_supervisor import GrblMachine, GrblSpec

MODELS = {"Grbl 1.1h": GrblParameters(homed=True), "grblHAL": GrblParameters(firmware="grblHAL", homed=True)}
SPOILT = {
    "lost": GrblFaults(lose_every=5),
    "damaged": GrblFaults(garble_every=5),
    "lost and damaged": GrblFaults(lose_every=7, garble_every=5),
}


@pytest.fixture(params=MODELS.values(), ids=MODELS)
def model(request):
    return request.param


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
        MODELS["Grbl 1.1h"], clock=MonotonicClock(), silence_s=30.0, still_s=60.0, stop_s=30.0
    )
    bench.spoil(GrblFaults(late_every=25, late_s=1.2))
    for i in range(1, 4):
        stage.move_to((-0.050, 0.050, 0.050 + i * 0.2e-3), 0.005)
        bench.arrive(stage)
        assert stage.position_m()[2] == pytest.approx(0.050 + i * 0.2e-3, abs=1e-6)
    assert bench.firmware.wire.reports >= 25


def test_what_was_lost_and_damaged_is_counted_and_told(grbl_open):
    bench, stage = grbl_open(MODELS["Grbl 1.1h"])
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
    bench = grbl_bench(MODELS["Grbl 1.1h"], silence_s=30.0)
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
    bench, stage = grbl_open(MODELS["Grbl 1.1h"], clock=MonotonicClock(), silence_s=0.5, still_s=60.0)
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
    bench, stage = grbl_open(MODELS["Grbl 1.1h"], silence_s=0.4)
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
    bench, stage = grbl_open(MODELS["Grbl 1.1h"], clock=MonotonicClock(), silence_s=30.0, still_s=60.0)
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
