"""Driver and fakes against both firmwares in real time; real ones where a simulator is at hand."""

import math
import random
import time
from contextlib import ExitStack

import pytest
from tests.refusals import refused
from tests.rig.grbl_talk import PATIENCE_S, Talk, fake, simulator

from palpate.core import DeviceError, MonotonicClock
from palpate.devices.check import check_stage
from palpate.rig.real.grbl.grbl_link import RefusedError
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

SETTINGS = ("$20=0", "$22=0", "$21=0", "$13=0", "$100=250", "$101=250", "$102=250")
REPORTS = {"1.1h": "$10=1", "grblHAL": "$10=511"}
MOTION = ("$120=50", "$121=50", "$122=50", "$110=1200", "$111=1200", "$112=1200", "$130=100", "$131=100")
WHERE = [
    pytest.param((kind, firmware), id=f"{kind} {firmware}", marks=[pytest.mark.slow] * (kind == "fake"))
    for kind in ("fake", "real")
    for firmware in ("1.1h", "grblHAL")
]
"""On the fakes, tests of the driver in its own time keep the same laws in every run."""
SHORT_JOGS = 100
LATENCY_S = 0.05
SPEED_M_S = 0.010
PATIENT = {"boot_s": 0.2, "reply_s": 20.0, "silence_s": 20.0, "still_s": 20.0, "stop_s": 20.0}


@pytest.fixture(params=WHERE)
def where(request, tmp_path):
    """The port of a controller with plain settings and no homing, and which firmware it is."""
    kind, firmware = request.param
    with ExitStack() as stack:
        path = stack.enter_context(fake(firmware) if kind == "fake" else simulator(tmp_path, firmware))
        with Talk(path) as talk:
            talk.wake()
            for line in (*SETTINGS, REPORTS[firmware], *MOTION, "$X"):
                assert talk.send(line)[-1] == "ok", line
        yield path, firmware


def spec(path: str, **changes) -> GrblSpec:
    words = {"least_m": (-0.05,) * 3, "greatest_m": (0.05,) * 3, "require_homed": False, **PATIENT}
    return GrblSpec(path, latency_s=LATENCY_S, **{**words, **changes})


@pytest.fixture
def stage(where):
    with GrblStage.open(spec(where[0])) as stage:
        stage.reference((0.0, 0.0, 0.0))
        yield stage


def arrive(stage) -> None:
    end = time.monotonic() + PATIENCE_S
    while stage.moving():
        assert time.monotonic() < end, "it never arrived"
        time.sleep(0.01)


def counted_mm(stage) -> tuple[float, ...]:
    """The controller's own count, asked for now [mm]."""
    return stage._link.report(PATIENCE_S).status.machine_mm


def run_up(stage, target, after_m: float = 0.003) -> None:
    stage.move_to(target, SPEED_M_S)
    while stage.position_m()[0] < after_m:
        assert stage.moving()


@pytest.mark.slow
def test_stops_of_short_jogs_at_random_lose_no_position(stage):
    rng = random.Random(41)
    for _ in range(SHORT_JOGS):
        x_m = stage.position_m()[0]
        length_m = math.copysign(rng.uniform(1e-4, 6e-4), -x_m)
        stage.move_to((x_m + length_m, 0.0, 0.0), SPEED_M_S)
        time.sleep(rng.uniform(0.0, 2.0 * math.sqrt(abs(length_m) / 0.05) + 0.03))
        stage.stop()  # a lost position is an error
        assert stage.position_m()[0] == pytest.approx(counted_mm(stage)[0] / 1e3, abs=1e-6)


def test_without_the_jog_cancel_only_1_1_stops_short(where):
    """The control: grblHAL ignores a hold in a jog, and the stop says that it went on."""
    path, firmware = where
    with GrblStage.open(spec(path)) as stage:
        stage.reference((0.0, 0.0, 0.0))
        write = stage._link._port.write
        stage._link._port = Deaf(stage._link._port, write)
        run_up(stage, (0.016, 0.0, 0.0))
        if firmware == "grblHAL":
            with refused("stop-ignored", DeviceError):
                stage.stop()
        else:
            stage.stop()
            assert stage.position_m()[0] < 0.0155


class Deaf:
    """A port that loses every jog cancel."""

    def __init__(self, port, write) -> None:
        self._port, self._write = port, write

    def __getattr__(self, name):
        return getattr(self._port, name)

    def write(self, data):
        return len(data) if data == b"\x85" else self._write(data)


@pytest.mark.parametrize(("line", "state"), [("$SLP", "Sleep"), ("$C", "Check")])
def test_sleep_and_check_are_cleared_by_a_stop(where, stage, line, state):
    if line == "$SLP" and where[1] == "grblHAL":
        with pytest.raises(RefusedError) as caught:
            stage._link.command(line)
        assert caught.value.code == "grbl-error-3"
        return
    stage._link.command(line)
    while stage._link.report(PATIENCE_S).status.state != state:
        time.sleep(0.05)
    with pytest.raises(DeviceError, match=rf"in {state}.*stop\(\) it"):
        stage.move_to((0.001, 0.0, 0.0), SPEED_M_S)
    if state == "Sleep":  # with its motors off, the place is lost
        with refused("position-lost", DeviceError) as caught:
            stage.stop()
        assert "power" not in str(caught.value)
        stage.unlock()
        stage.reference((0.0, 0.0, 0.0))
    else:
        stage.stop()
    stage.move_to((0.001, 0.0, 0.0), SPEED_M_S)
    arrive(stage)


def test_a_reset_in_motion_is_an_alarm_and_loses_the_place(stage):
    run_up(stage, (0.045, 0.0, 0.0))
    stage._link._write(b"\x18")
    with pytest.raises(DeviceError, match=r"ALARM:3|restarted"):
        arrive(stage)
    with pytest.raises(DeviceError):
        stage.position_m()
    stage.unlock()
    stage.reference((0.0, 0.0, 0.0))
    stage.move_to((0.001, 0.0, 0.0), SPEED_M_S)
    arrive(stage)


def test_a_port_that_is_opened_anew_in_motion_is_stopped_and_its_place_unknown(where):
    path, _ = where
    stage = GrblStage.open(spec(path))
    stage.reference((0.0, 0.0, 0.0))
    run_up(stage, (0.049, 0.0, 0.0))
    stage._link.close()  # as a programme that dies: nothing is stopped
    with GrblStage.open(spec(path)) as again:
        first = counted_mm(again)
        time.sleep(0.3)
        assert counted_mm(again) == first
        with pytest.raises(DeviceError, match="just opened"):
            again.position_m()
        again.reference((0.0, 0.0, 0.0))
        again.move_to((0.001, 0.0, 0.0), SPEED_M_S)
        arrive(again)


@pytest.mark.slow
def test_the_driver_keeps_every_law_of_a_stage_on_firmware_however_slow(stage):
    box = ((-0.005,) * 3, (0.005,) * 3)
    began = time.monotonic()
    stage._link.command("G4P2", timeout_s=PATIENCE_S)  # a dwell of two of its own seconds
    pace = max(1.0, (time.monotonic() - began) / 2.0)
    found = check_stage(
        stage, clock=MonotonicClock(), region_m=box, speed_m_s=4e-3, time_scale=pace, close=False
    )
    assert [one for one in found if not one.ok and one.code != "move-returns"] == []


# What firmware was seen to do: asked of the fake always, of real firmware where a simulator is at hand.

UNHOMED = ("$20=0", "$22=0", "$21=0", "$13=0", "$10=1")  # nothing to home against
OBSERVED_MOTION = ("$120=50", "$121=50", "$122=50", "$110=1200", "$111=1200", "$112=1200")


@pytest.fixture(params=["fake", "simulator"])
def path(request, tmp_path):
    with ExitStack() as stack:
        path = stack.enter_context(fake() if request.param == "fake" else simulator(tmp_path))
        with Talk(path) as talk:
            talk.wake()
            for line in (*UNHOMED, *OBSERVED_MOTION, "$X"):
                assert talk.send(line)[-1] == "ok", line
        yield path


@pytest.fixture
def talk(path):
    with Talk(path) as talk:
        yield talk


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("G21G91G94G1X0.01", "error:22"), ("G1X1F-1", "error:4"), ("G1XnanF100", "error:2"),
        ("G1XinfF100", "error:2"), ("G1X1e3F100", "error:20"), ("G1X" + "0" * 97 + "1F100", "error:11"),
        ("$20=1", "error:10"), ("G20", "ok"), ("", "ok"),
    ],
)  # fmt: skip
def test_a_line_has_the_one_answer_that_was_seen(talk, line, answer):
    assert talk.send(line)[-1] == answer


def test_ok_is_not_done(talk):
    assert talk.send("G21G91G94G1X2F300")[-1] == "ok"
    assert talk.status().startswith("<Run")
    talk.until("Idle")
    assert talk.x_mm() == pytest.approx(2.0, abs=0.01)


def test_a_hold_then_a_reset_keeps_the_place_and_the_lock_off(talk):
    talk.send("G21G91G94G1X30F600")
    time.sleep(0.5)
    talk.port.write(b"!")
    talk.until("Hold:0")
    x_mm = talk.x_mm()
    heard = talk.reset()
    assert not [line for line in heard if line.startswith("ALARM")]
    assert talk.status().startswith("<Idle")
    assert talk.x_mm() == pytest.approx(x_mm, abs=0.01)


def test_a_reset_in_motion_is_alarm_3(talk):
    talk.send("G21G91G94G1X30F600")
    time.sleep(0.5)
    assert "ALARM:3" in talk.reset()
    assert talk.status().startswith("<Alarm")
    assert talk.send("G1X1F60")[-1] == "error:9"
