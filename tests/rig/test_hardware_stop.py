"""The stage's own door and hold inputs: they stop it without the computer, which names them."""

import itertools
from typing import Any

import pytest
from tests.fakes.grbl_parameters import GrblParameters
from tests.refusals import refused

from palpate.core import DeviceError, HardwareStopError, Wrench
from palpate.devices import Limits, Mounting, OperatorControl
from palpate.devices.force_bias import ForceBias
from palpate.devices.motion_guard import MotionGuard
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.commissioning.bench import Bench, bench_status

FIRMWARES = ["1.1h", "grblHAL"]
INPUTS = {"door": "its door input", "hold": "its hold input"}


class Quiet:
    """A force sensor in the air."""

    rate_hz, range_n = 1000.0, (50.0, 50.0, 50.0)

    def __init__(self, clock: Any) -> None:
        self.clock, self.n = clock, itertools.count()

    def latest(self) -> Wrench:
        return Wrench(self.clock.now_ns(), (1e-3 * (next(self.n) % 7), 0.0, 0.0))

    def drain(self) -> list[Wrench]:
        return [self.latest()]

    def close(self) -> None:
        pass


def press(bench: Any, which: str) -> None:
    with bench.terminal.lock:
        bench.terminal.catch_up()
        bench.firmware.open_door() if which == "door" else bench.firmware.press_hold()


def free(bench: Any) -> None:
    with bench.terminal.lock:
        bench.firmware.door_open = bench.firmware.hold_pressed = False


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("which", INPUTS)
def test_an_input_of_the_stages_own_ends_a_guarded_motion_by_its_own_name(grbl_open, firmware, which):
    bench, stage = grbl_open(GrblParameters(homed=True, firmware=firmware))
    x, y, z = stage.position_m()
    limits = Limits((x - 0.04, y - 0.04, z - 0.04), (x + 0.04, y + 0.04, z + 0.04), overshoot_m=1e-3)
    guard = MotionGuard(
        stage, Quiet(bench.clock), limits, ForceBias(Mounting()), bench.clock, OperatorControl()
    )
    looks = itertools.count()

    def look() -> None:
        if next(looks) == 40:
            press(bench, which)

    guard.looks.subscribe(look)
    with pytest.raises(Tripped, match=INPUTS[which]) as told:
        guard.towards((x + 0.03, y, z), 0.004)
    assert told.value.reason is Reason.HARDWARE_STOP
    assert bench.speed_mm_s == 0.0
    assert bench.place_mm[0] - 1e3 * x < 10.0  # of the 30 mm that it was sent
    found = bench_status(Bench("b", bench.clock, Mounting(), limits, (0.0, 0.0, 0.0), stage))
    assert f"Pn:{which[0].upper()}" in found["stage_says"]
    with pytest.raises(HardwareStopError, match=INPUTS[which]):
        stage.move_to((x, y, z), 0.004)  # nothing moves before it is freed
    free(bench)
    stage.stop()
    bench.wait(lambda: bench.firmware.state == "Idle")
    stage.move_to((x, y, z), 0.004)
    bench.arrive(stage)
    assert stage.position_m() == pytest.approx((x, y, z), abs=1e-5)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_stage_whose_door_is_open_is_not_opened_and_says_why(grbl_bench: Any, firmware: str) -> None:
    bench = grbl_bench(GrblParameters(homed=True, firmware=firmware))
    press(bench, "door")
    with refused("hardware-stop", HardwareStopError):
        bench.open()
    free(bench)
    assert bench.open().position_m()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_the_control_a_stop_that_the_computer_asked_for_is_no_hardware_stop(grbl_open, firmware):
    bench, stage = grbl_open(GrblParameters(homed=True, firmware=firmware))
    x, y, z = stage.position_m()
    for _ in range(5):
        bench.move_to_speed(stage, (x + 0.02, y, z), 0.01)
        stage._link.halt()  # as an operator's stop in another thread begins
        try:
            bench.wait(lambda: not stage.moving() or bench.speed_mm_s == 0.0)
        except HardwareStopError:
            pytest.fail("an operator's stop was taken for the machine's own")
        except DeviceError:
            pass
        stage.stop()
        stage.move_to((x, y, z), 0.02)
        bench.arrive(stage)
