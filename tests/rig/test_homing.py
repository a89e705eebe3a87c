"""Homing ends where the force changes, and never begins towards the skin."""

import threading
import time
from collections.abc import Callable

import pytest
from tests.fakes.grbl_parameters import GrblParameters
from tests.refusals import refused

from palpate.core import DeviceError, MonotonicClock, Position, Wrench
from palpate.devices import Reason, Tripped
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
    with pytest.raises(Tripped) as caught:
        home_watched(stage, Force(lambda s: sign * 4.0 * max(s - 0.4, 0.0)), MonotonicClock())
    assert caught.value.code == Reason.FORCE_LIMIT
    assert stage.stopped.is_set()


def test_a_sensor_that_falls_silent_stops_homing() -> None:
    stage, force = Stage(), Force(lambda s: 0.0)
    whole = force.drain
    force.drain = lambda: [one for one in whole() if one.time_ns - force._began_ns < 0.4e9]
    with pytest.raises(Tripped) as caught:
        home_watched(stage, force, MonotonicClock())
    assert caught.value.code == Reason.FORCE_STALE


def test_homing_in_the_air_goes_on() -> None:
    stage = Stage()
    home_watched(stage, Force(lambda s: 0.2), MonotonicClock())
    assert not stage.stopped.is_set()


def test_a_pull_off_beyond_the_lift_before_homing_is_refused(grbl_open) -> None:
    bench, stage = grbl_open(GrblParameters(homed=True, settings={27: 20}), known=False)
    with refused("homing-pull-off", DeviceError):
        stage.home()
    assert b"$H" not in bench.received


@pytest.mark.parametrize(
    ("homes_down", "z_axis", "into"), [(0, "-Z", False), (4, "-Z", True), (0, "+Z", True), (4, "+Z", False)]
)
def test_the_direction_of_homing_is_that_of_the_setting(homes_down: int, z_axis: str, into: bool) -> None:
    three = (1.0, 1.0, 1.0)
    machine = GrblMachine(three, three, three, three, homing=True, homes_down=homes_down)
    assert machine.homes_into_skin(("+X", "-Y", z_axis)) is into
