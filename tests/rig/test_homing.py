"""Homing ends where the force changes, and never begins towards the skin."""

import itertools
import math
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.fakes.grbl_parameters import GrblParameters
from tests.refusals import refused

from palpate.core import DeviceError, HardwareStopError, MonotonicClock, Position, Wrench
from palpate.devices import Limits, Mounting, OperatorControl, Tripped
from palpate.devices.force_bias import ForceBias
from palpate.devices.motion_guard import MotionGuard
from palpate.rig.commissioning.bench import Bench, bench_status
from palpate.rig.commissioning.homing import home_watched
from palpate.rig.real.grbl.grbl_supervisor import GrblMachine


class Force:
    """A force sensor of 1 kHz whose force along z is that of a function of the seconds since it began."""

    rate_hz = 1000.0
    range_n = (10.0, 10.0, 10.0)

    def __init__(self, force_n: Callable[[float], float]) -> None:
        self._force_n, self._began_ns = force_n, time.monotonic_ns()
        self._last_ns = self._began_ns

    def drain(self) -> list[Wrench]:
        now_ns = time.monotonic_ns()
        times = range(self._last_ns + 1_000_000, now_ns, 1_000_000)
        self._last_ns = times[-1] if times else self._last_ns
        return [self._sample(ns) for ns in times]

    def latest(self) -> Wrench:
        return self._sample(time.monotonic_ns())

    def close(self) -> None: ...

    def _sample(self, ns: int) -> Wrench:
        noise = 1e-3 * (ns // 1_000_000 % 7 - 3)
        return Wrench(ns, (0.0, noise, self._force_n(1e-9 * (ns - self._began_ns))), (0.0, 0.0, 0.0))


class Stage:
    """A stage that homes for 0.8 s unless it is stopped."""

    def __init__(self) -> None:
        self.stopped = threading.Event()

    def home(self) -> None:
        if self.stopped.wait(0.8):
            raise DeviceError("homing was stopped")

    def stop(self) -> None:
        self.stopped.set()

    def unlock(self) -> None: ...
    def retreat(self, distance_m: float, speed_m_s: float) -> None: ...
    def approach(self, distance_m: float, speed_m_s: float) -> None: ...
    def reference(self, position_m: Position) -> None: ...


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_change_of_force_stops_homing(sign: float) -> None:
    stage = Stage()
    with refused("force-limit", Tripped):
        home_watched(stage, Force(lambda s: sign * 4.0 * max(s - 0.4, 0.0)), MonotonicClock())
    assert stage.stopped.is_set()


def test_a_sensor_that_falls_silent_stops_homing() -> None:
    stage, force = Stage(), Force(lambda s: 0.0)
    whole = force.drain
    force.drain = lambda: [one for one in whole() if one.time_ns - force._began_ns < 0.4e9]
    with refused("force-stale", Tripped):
        home_watched(stage, force, MonotonicClock())


def test_homing_in_the_air_goes_on() -> None:
    stage = Stage()
    home_watched(stage, Force(lambda s: 0.2), MonotonicClock())
    assert not stage.stopped.is_set()


@pytest.mark.parametrize(("setting", "code"), [({27: 20}, "homing-pull-off"), ({25: 1500}, "homing-speed")])
def test_homing_that_would_enter_the_skin_too_far_or_too_fast_is_refused(grbl_open, setting, code) -> None:
    bench, stage = grbl_open(GrblParameters(homed=True, settings=setting), known=False)
    with refused(code, DeviceError):
        stage.home()
    assert b"$H" not in bench.received


@pytest.mark.parametrize(
    ("block", "moves"),
    [("G91G0Z-40", True), ("G28", True), ("G20 G1 X1", True), ("G21 G90 G17 G54 M5 S100", False)],
)
def test_a_startup_block_that_moves_is_refused(grbl_bench, block: str, moves: bool) -> None:
    bench = grbl_bench(GrblParameters(homed=True, startup=("", block)))
    if moves:
        with refused("startup-motion", DeviceError):
            bench.open(known=False)
    else:
        bench.open(known=False)


@pytest.mark.parametrize(
    ("settings", "code"), [({32: 2}, "lathe-mode"), ({22: 513, 25: math.nan}, "homing-speed")]
)
def test_modes_of_grblhal_that_are_not_read_are_refused(grbl_bench, settings, code: str) -> None:
    bench = grbl_bench(GrblParameters(firmware="grblHAL", homed=True, settings=settings))
    with refused(code, DeviceError):
        bench.open(known=False)


@pytest.mark.parametrize(
    ("homes_down", "z_axis", "into"), [(0, "-Z", False), (4, "-Z", True), (0, "+Z", True), (4, "+Z", False)]
)
def test_the_direction_of_homing_is_that_of_the_setting(homes_down: int, z_axis: str, into: bool) -> None:
    three = (1.0, 1.0, 1.0)
    machine = GrblMachine(three, three, three, three, homing=True, homes_down=homes_down)
    assert machine.homes_into_skin(("+X", "-Y", z_axis)) is into


# The stage's own door and hold inputs: they stop it without the computer, which names them.

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
    with refused("hardware-stop", Tripped, match=INPUTS[which]):
        guard.towards((x + 0.03, y, z), 0.004)
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
