"""Stop of a GRBL stage: from every state, on both firmwares, with its distance counted from the fake's place.

All of it is on a fake that was made from observed behaviour; no real firmware has run here.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
from tests.fakes.grbl_controller import CANCEL, DOOR, HOLD, RESET
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.refusals import refused

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError
from palpate.rig.real.gcode_stage import PositionLostError

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
    def test_a_stop_that_comes_as_it_arrives_is_no_fault(self, grbl_open, model):
        """Asked within the way that it needs to stop, it may well be at its target."""
        bench, stage = grbl_open(model)
        stage.move_to((-0.049, 0.050, 0.050), 0.010)
        bench.wait(lambda: bench.place_mm[0] > -49.05, 0.002)
        stage.stop()
        assert bench.speed_mm_s == 0.0
        assert not stage.moving()

    def test_a_stop_after_it_arrived_is_no_fault(self, grbl_open, model):
        bench, stage = grbl_open(model)
        stage.move_to((-0.0499, 0.050, 0.050), 0.010)
        bench.wait(lambda: bench.firmware.state == "Idle")
        bench.clock.sleep(1.0)
        stage.stop()
        assert stage.position_m()[0] == pytest.approx(-0.0499, abs=1e-6)

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
