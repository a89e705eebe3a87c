"""The driver on a fake of Grbl 1.1h and grblHAL, over a real pseudo-terminal: when all goes well."""

import math
import re
import sys
import threading
from types import SimpleNamespace

import pytest
from hypothesis import given, strategies as st
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.refusals import refused

from palpate.core.errors import DeviceError, InputError, MissingExtraError, PositionUnknownError, RangeError
from palpate.rig.real import gcode_stage, serial_port
from palpate.rig.real.gcode_spec import Mount, fixed
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

# The default mount: x = X, y = -Y, z = -Z; the fake starts at machine -50, -50, -50 mm.
START = (-0.050, 0.050, 0.050)
STEP_MM = 0.02  # two clock ticks of the fake at 10 mm/s: it takes up a hold no finer than that
MODELS = {
    "Grbl": GrblParameters(homed=True, offset_mm=(3.0, -4.0, 5.0)),
    "grblHAL": GrblParameters(firmware="grblHAL", homed=True),
    "slow to obey, jogs held": GrblParameters(homed=True, latency_s=0.02, hold_cancels_jog=False),
}


@pytest.fixture(params=MODELS.values(), ids=MODELS)
def model(request):
    return request.param


def metres(machine_mm):
    return machine_mm[0] / 1e3, -machine_mm[1] / 1e3, -machine_mm[2] / 1e3


@pytest.mark.parametrize(
    ("firmware", "reports", "remedy"),
    [*(("1.1h", 2, 1), ("grblHAL", 1, 511), ("grblHAL", 510, 511), ("grblHAL", 17, None))],
)
def test_reports_without_coordinates_or_inputs_are_refused_with_the_remedy(
    grbl_bench, firmware, reports, remedy
):
    bench = grbl_bench(GrblParameters(firmware, homed=True, settings={10: reports}))
    if remedy is None:
        assert bench.open().position_m()
        return
    with pytest.raises(DeviceError, match=rf"\$10={remedy} "):
        bench.open()


def test_one_wrong_digit_counts_only_when_a_second_report_confirms_it(grbl_open, model):
    bench, stage = grbl_open(model, GrblFaults(wrong_digit_every=11))
    for target in ((-0.048, 0.050, 0.0521), START):
        stage.move_to(target, 0.01)
        bench.arrive(stage)
        assert stage.position_m() == pytest.approx(target, abs=1e-6)
    assert bench.firmware.wire.reports > 22


def test_it_goes_where_it_is_sent(grbl_open, model):
    bench, stage = grbl_open(model)
    assert stage.position_m() == pytest.approx(START)
    for target in ((-0.048, 0.050, 0.0521), (-0.0512, 0.0487, 0.0506), START):
        stage.move_to(target, 0.01)
        assert stage.moving()
        bench.arrive(stage)
        assert stage.position_m() == pytest.approx(target, abs=1e-6)  # what a report resolves
        assert metres(bench.place_mm) == pytest.approx(target, abs=1e-7)  # what a line resolves


def test_a_stop_ends_within_the_overshoot_bound_at_a_known_place(grbl_open, model):
    bench, stage = grbl_open(model)
    bench.move_to_speed(stage, (-0.030, 0.050, 0.060), 0.010)
    asked = bench.place_mm
    stage.stop()
    stopped = bench.place_mm
    # v^2 / 2a = 1 mm and v latency = 0.2 mm; the clock stood still between the question and the hold.
    assert math.dist(asked, stopped) <= stage.travel.overshoot_m(0.010) * 1e3 + STEP_MM
    assert math.dist(asked, stopped) >= 1.0 - STEP_MM  # it slowed down, and did not lose steps
    assert bench.speed_mm_s == 0.0
    assert not stage.moving()
    assert stage.position_m() == pytest.approx(metres(stopped), abs=1e-6)
    stage.move_to(START, 0.01)
    bench.arrive(stage)
    assert metres(bench.place_mm) == pytest.approx(START, abs=1e-7)


def test_stops_from_many_threads_are_one_stop(grbl_open):
    bench, stage = grbl_open(GrblParameters(homed=True, hold_cancels_jog=False))
    bench.move_to_speed(stage, (-0.030, 0.050, 0.050), 0.010)
    threads = [threading.Thread(target=stage.stop) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert stage.position_m() == pytest.approx(metres(bench.place_mm), abs=1e-6)


def test_a_move_recalled_before_it_was_sent_is_not_sent(grbl_open, monkeypatch):
    bench, stage = grbl_open()
    before = bench.received
    with stage._lock:  # another thread asks for a move and has to wait, and is stopped meanwhile
        halts = stage._link.halts
        failures = []

        def move():
            try:
                stage.move_to((-0.040, 0.050, 0.050), 0.010)
            except DeviceError as error:
                failures.append(error)

        entered = threading.Event()
        monkeypatch.setattr(gcode_stage, "check_range", lambda *asked: entered.set())
        mover = threading.Thread(target=move)
        mover.start()
        entered.wait()
        assert stage._link.halts == halts
        stage.stop()
    mover.join()
    assert len(failures) == 1
    assert b"$J" not in bench.received[len(before) :]
    stage.move_to((-0.0495, 0.050, 0.050), 0.010)  # and the next is
    bench.arrive(stage)


def test_one_move_at_a_time(grbl_open):
    bench, stage = grbl_open()
    stage.move_to((-0.045, 0.050, 0.050), 0.010)
    with pytest.raises(DeviceError, match="moving already"):
        stage.move_to((-0.045, 0.050, 0.050), 0.010)
    assert bench.received.count(b"$J") == 1


@pytest.mark.parametrize(("axis", "bad"), [(0, math.nan), (1, -math.inf), (2, 1.0), (2, -1.0)])
def test_a_target_outside_the_travel_is_refused_before_anything_is_sent(grbl_open, axis, bad):
    bench, stage = grbl_open()
    before = bench.received
    target = list(START)
    target[axis] = bad
    with pytest.raises(RangeError, match="travel"):
        stage.move_to(tuple(target), 0.01)
    assert bench.received == before


@pytest.mark.parametrize("speed", [math.nan, 0.0, 1e-6, 0.021])
def test_a_speed_that_it_cannot_run_at_is_refused_before_anything_is_sent(grbl_open, speed):
    bench, stage = grbl_open()
    before = bench.received
    with pytest.raises(RangeError, match="speed"):
        stage.move_to(START, speed)
    assert bench.received == before


def test_what_the_controller_refuses_it_says_and_does_not_do(grbl_open):
    bench, stage = grbl_open(least_m=(0.0, 0.0, 0.0), greatest_m=(0.1, 0.1, 0.1))
    stage.reference((0.0, 0.05, 0.05))  # which puts half the limits' range beyond the machine's own
    with pytest.raises(DeviceError, match="error:15"):
        stage.move_to((0.08, 0.05, 0.05), 0.01)
    assert not stage.moving()
    assert stage.position_m() == pytest.approx((0.0, 0.05, 0.05))
    stage.move_to((0.01, 0.05, 0.05), 0.01)
    bench.arrive(stage)
    assert bench.place_mm == pytest.approx((-40.0, -50.0, -50.0))


def test_limits_wider_than_the_machine_are_refused(grbl_bench):
    bench = grbl_bench(least_m=(-0.06, 0.0, 0.0), greatest_m=(-0.04, 0.06, 0.2))
    with pytest.raises(RangeError, match=r"\$130"):
        bench.open()


def test_the_travel_is_the_firmware_s(grbl_bench):
    settings = {110: 600.0, 112: 300.0, 121: 20.0, 131: 40.0}
    travel = grbl_bench(GrblParameters(homed=True, settings=settings)).open().travel
    assert travel.least_m == pytest.approx((-0.1, 0.0, 0.0))
    assert travel.greatest_m == pytest.approx((0.0, 0.04, 0.1))
    assert travel.top_speed_m_s == pytest.approx(0.005)
    assert travel.acceleration_m_s2 == pytest.approx(0.02)


def test_every_move_states_its_modes_in_fixed_point(grbl_open):
    bench, stage = grbl_open()
    for target in ((-0.0500001, 0.05, 0.05), (-1e-9, 0.05, 0.05), (-0.0123456, 1e-7, 0.05)):
        stage.move_to(target, 0.02)
        bench.arrive(stage)
    lines = [line for line in bench.received.decode().replace("?", "").splitlines() if "$J" in line]
    word = r"-?\d+\.\d{4}"
    assert len(lines) == 3
    for line in lines:
        assert re.fullmatch(rf"\$J=G21G90G53X{word}Y{word}Z{word}F\d+\.\d{{3}}", line)


@given(st.floats(-9e5, 9e5))
def test_a_number_is_sent_in_fixed_point_and_rounded_by_no_more_than_half_its_last_place(value):
    text = fixed(value)
    assert re.fullmatch(r"-?\d{1,6}\.\d{4}", text)
    assert abs(float(text) - value) <= 0.5e-4 * (1 + 1e-6) + abs(value) * 1e-15
    assert text != "-0.0000"


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e6])
def test_what_is_no_length_is_never_sent(value):
    with pytest.raises(RangeError):
        fixed(value)


@given(
    st.permutations("XYZ"),
    st.tuples(*[st.sampled_from("+-")] * 3),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.tuples(*[st.floats(-500, 500)] * 3),
)
def test_the_mount_and_back_is_the_same_place(letters, signs, place_m, machine_mm):
    axes = tuple(sign + letter for sign, letter in zip(signs, letters, strict=True))
    mount = Mount(axes).placed(machine_mm, place_m)
    # Rounded twice to 0.1 micrometre.
    assert mount.sensor_m(machine_mm) == pytest.approx(place_m, abs=1.1e-7)
    assert mount.sensor_m(mount.machine_mm(place_m)) == pytest.approx(place_m, abs=1.1e-7)


class TestHoming:
    def test_the_position_is_unknown_until_it_is_found(self, grbl_open):
        bench, stage = grbl_open(GrblParameters(homing_s=0.0), known=False)
        with pytest.raises(PositionUnknownError):
            stage.position_m()
        with pytest.raises(PositionUnknownError):
            stage.move_to(START, 0.01)
        stage.home()
        assert stage.position_m() == pytest.approx((-0.001, 0.001, 0.001))
        stage.move_to((-0.002, 0.001, 0.001), 0.01)
        bench.arrive(stage)

    def test_nothing_homes_or_unlocks_by_itself(self, grbl_bench):
        bench = grbl_bench(GrblParameters())
        with bench.open(known=False) as stage:
            for attempt in (
                stage.position_m,
                stage.moving,
                lambda: stage.move_to(START, 0.01),
                stage.reference,
            ):
                with pytest.raises(DeviceError):
                    attempt()
        assert b"$H" not in bench.received
        assert b"$X" not in bench.received

    def test_without_switches_it_fails_by_name(self, grbl_open, fast_clock):
        _bench, stage = grbl_open(
            GrblParameters(switches=False), clock=fast_clock(100), still_s=1e3, stop_s=1e3, known=False
        )
        with pytest.raises(DeviceError, match="ALARM:9"):
            stage.home()
        with pytest.raises(DeviceError, match="ALARM:9"):
            stage.position_m()

    def test_homing_that_is_stopped_leaves_the_position_unknown(self, grbl_open):
        bench, stage = grbl_open(GrblParameters(homing_s=1e6), known=False)
        failures = []

        def home():
            try:
                stage.home()
            except DeviceError as error:
                failures.append(str(error))

        homing = threading.Thread(target=home)
        homing.start()
        bench.wait(lambda: bench.firmware.state == "Home")
        with refused("position-lost", DeviceError):
            stage.stop()
        homing.join()
        assert failures
        assert bench.firmware.state == "Alarm"

    def test_homing_switched_off_is_said_so(self, grbl_bench):
        off = GrblParameters(settings={22: 0, 20: 0})
        with pytest.raises(InputError, match="least_m"):
            grbl_bench(off).open(known=False)
        stage = grbl_bench(off, least_m=(-0.01,) * 3, greatest_m=(0.01,) * 3).open(known=False)
        with pytest.raises(DeviceError, match=r"\$22=1"):
            stage.home()
        stage.reference((0.0, 0.0, 0.0))
        with pytest.raises(DeviceError, match=r"\$22=0"):
            stage.move_to((0.001, 0.0, 0.0), 0.01)

    def test_unlocked_is_not_homed(self, grbl_open):
        _bench, stage = grbl_open(GrblParameters(), known=False)
        stage.unlock()
        with pytest.raises(DeviceError, match="unlocked"):
            stage.position_m()
        stage.reference()
        with pytest.raises(DeviceError, match=r"home\(\)"):
            stage.move_to((-0.001, 0.001, 0.001), 0.01)


class TestPorts:
    def test_a_port_that_is_not_there_is_refused_with_those_that_are(self, monkeypatch):
        there = [SimpleNamespace(device="/dev/ttyACM7", serial_number="5583", hwid="USB")]
        monkeypatch.setattr(serial_port, "_ports", lambda: there)
        for name in ("/dev/ttyNOWHERE", "9999"):
            with refused("port-not-found", DeviceError, match="5583"):
                GrblStage.open(GrblSpec(name))

    def test_a_serial_number_names_a_port(self, grbl_bench, monkeypatch):
        bench = grbl_bench()
        there = [SimpleNamespace(device=bench.terminal.path, serial_number="5583")]
        monkeypatch.setattr(serial_port, "_ports", lambda: there)
        assert serial_port.find_port("5583") == bench.terminal.path
        monkeypatch.setattr(serial_port, "_ports", lambda: there * 2)
        with refused("port-ambiguous", DeviceError):
            serial_port.find_port("5583")

    def test_without_pyserial_the_extra_is_named(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "serial", None)
        with pytest.raises(MissingExtraError, match=r"palpate\[rig\]"):
            GrblStage.open(GrblSpec("/dev/null"))


@pytest.mark.parametrize(
    "words",
    [
        {"axes": ("+X", "+X", "-Z")}, {"least_m": (0.0, 0.0, 0.0)},
        {"least_m": (0.0, 0.0, 0.0), "greatest_m": (1.0, 1.0, 0.0)}, {"latency_s": -1.0},
        {"boot_s": math.nan}, {"top_speed_m_s": 0.0},
    ],
)  # fmt: skip
def test_a_spec_that_makes_no_sense_is_refused(words):
    with pytest.raises(InputError):
        GrblSpec("/dev/ttyACM0", **words)


def test_a_retreat_leads_away_from_the_skin_before_its_place_is_known_and_teaches_none(grbl_open, fast_clock):
    bench, stage = grbl_open(clock=fast_clock(), known=False)
    start = bench.place_mm
    stage.retreat(0.5e-3, 5e-3)
    bench.arrive(stage)
    assert bench.place_mm == pytest.approx((start[0], start[1], start[2] + 0.5), abs=0.005)  # z is -Z
    with pytest.raises(DeviceError, match="not known"):
        stage.position_m()
    with pytest.raises(DeviceError, match="not known"):
        stage.move_to((-50e-3, 50e-3, 50e-3), 5e-3)
    for distance_m in (0.0, -1e-3, math.nan):
        with pytest.raises(RangeError, match="above 0"):
            stage.retreat(distance_m, 5e-3)


def test_a_wrong_digit_in_every_report_is_a_lost_position(grbl_open):
    bench, stage = grbl_open()
    for faults in (GrblFaults(wrong_digit_every=1), GrblFaults()):
        bench.spoil(faults)
        with pytest.raises(DeviceError):
            stage.position_m()


def test_a_hold_that_meets_a_stage_just_reset_is_cleared_too(grbl_open, monkeypatch):
    bench, stage = grbl_open(GrblParameters(homed=True, hold_cancels_jog=False))
    bench.move_to_speed(stage, (-0.030, 0.050, 0.050), 0.010)
    bench.say(b"!")
    reset, held = stage._session.reset, []

    def reset_and_hold(**words):  # as another thread's stop can
        reset(**words)
        if len(held) < 2:
            held.append(True)
            stage._link.slow_down(b"!")

    monkeypatch.setattr(stage._session, "reset", reset_and_hold)
    stage.stop()
    assert len(held) == 2
    assert not stage.moving()
