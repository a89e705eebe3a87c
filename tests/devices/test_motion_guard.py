"""Guarded motion without an engine: a stage that moves as time passes, a spring from z = 0 on."""

import math
import threading
from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ManualClock
from palpate.core.device_protocols import Position, Travel, Wrench
from palpate.devices import (
    ForceBias,
    Limits,
    MotionGuard,
    OperatorCommand,
    OperatorControl,
    OperatorInterrupt,
    Reason,
    Tripped,
)
from palpate.devices.motion_guard import ARRIVED_M, RISE_N

TRAVEL = Travel((-20e-3,) * 3, (20e-3,) * 3, 10e-3, 0.5, 0.002)
LIMITS = Limits((-15e-3,) * 3, (15e-3,) * 3, force_n=5.0, force_rate_n_s=100.0, step_m=0.5e-3)
SPEED = 2e-3
STIFFNESS = 1e3  # N/m, from z = 0 on


class Stage:
    """Runs in a straight line at its speed, `slower` times as slow."""

    travel = TRAVEL

    def __init__(self, clock: ManualClock, slower: float = 1.0) -> None:
        self.clock, self.slower = clock, slower
        self.start = self.target = (0.0, 0.0, -1e-3)
        self.begun_ns = self.speed = 1
        self.sent: list[Position] = []
        self.stops = 0

    def _share(self) -> float:
        length = math.dist(self.start, self.target)
        gone = (self.clock.now_ns() - self.begun_ns) / 1e9 * self.speed / self.slower
        return 1.0 if length == 0 else min(gone / length, 1.0)

    def position_m(self) -> Position:
        x, y, z = (a + (b - a) * self._share() for a, b in zip(self.start, self.target, strict=True))
        return x, y, z

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        self.start, self.target = self.position_m(), position_m
        self.begun_ns, self.speed = self.clock.now_ns(), speed_m_s
        self.sent.append(position_m)

    def moving(self) -> bool:
        return self._share() < 1.0

    def stop(self) -> None:
        self.start = self.target = self.position_m()
        self.stops += 1

    def close(self) -> None: ...


class Sensor:
    """A sample at each look, of the force that the place gives."""

    rate_hz, range_n = 500.0, (100.0, 100.0, 100.0)

    def __init__(self, clock: ManualClock, force_n: Callable[[], float]) -> None:
        self.clock, self.force_n = clock, force_n
        self.fault, self.age_s = "", 0.0

    def latest(self) -> Wrench:
        time_ns = self.clock.now_ns() - round(self.age_s * 1e9)
        return Wrench(time_ns, (0.0, 0.0, float(self.force_n())), fault=self.fault)

    def drain(self) -> list[Wrench]:
        return [self.latest()]

    def close(self) -> None: ...


class Bench:
    """A guard over such a stage and sensor."""

    def __init__(
        self, slower: float = 1.0, stiffness_n_m: float = STIFFNESS, limits: Limits = LIMITS
    ) -> None:
        self.clock = ManualClock(10**9)
        self.stage = Stage(self.clock, slower)
        self.sensor = Sensor(self.clock, lambda: max(self.stage.position_m()[2], 0.0) * stiffness_n_m)
        self.control = OperatorControl()
        self.guard = MotionGuard(self.stage, self.sensor, limits, ForceBias(), self.clock, self.control)


def test_a_guarded_motion_ends_at_its_target_by_even_steps_no_longer_than_allowed() -> None:
    bench = Bench()
    target = (1e-3, -2e-3, -0.2e-3)
    begun = bench.stage.position_m()
    assert not bench.guard.towards(target, SPEED)
    assert bench.stage.position_m() == pytest.approx(target, abs=1e-12)
    steps = np.diff([begun, *bench.stage.sent], axis=0)
    np.testing.assert_allclose(steps, np.tile(steps[0], (len(steps), 1)), atol=1e-12)
    length = np.linalg.norm(np.subtract(target, begun))
    assert len(steps) == math.ceil(length / LIMITS.step_m)


def test_it_stops_at_the_first_force_that_is_enough() -> None:
    bench = Bench()
    assert bench.guard.towards((0.0, 0.0, 4e-3), SPEED, until=lambda force: force[2] >= 1.5)
    # One look every 2 ms at 2 mm/s is 4 micrometres, 0.004 N.
    assert bench.sensor.force_n() == pytest.approx(1.5, abs=0.01)
    assert bench.stage.stops == 1


def test_it_stops_on_more_force_than_is_allowed() -> None:
    bench = Bench()
    with refused("force-limit", Tripped) as caught:
        bench.guard.towards((0.0, 0.0, 10e-3), SPEED)
    assert caught.value.reason is Reason.FORCE_LIMIT
    assert bench.sensor.force_n() == pytest.approx(5.0, abs=0.01)
    assert not bench.stage.moving()


def test_a_busy_computer_sends_no_further_step_on_a_force_that_it_has_not_looked_at() -> None:
    limits = Limits(LIMITS.least_m, LIMITS.greatest_m, 5.0, 1e6, step_m=0.5e-3)
    bench = Bench(stiffness_n_m=12e3, limits=limits)
    bench.stage.start = bench.stage.target = (0.0, 0.0, 0.0)
    send = bench.stage.move_to

    def move_to(position_m: Position, speed_m_s: float) -> None:
        send(position_m, speed_m_s)
        bench.clock.sleep(1.0)

    bench.stage.move_to = move_to  # type: ignore[method-assign]
    with refused("force-limit", Tripped):
        bench.guard.towards((0.0, 0.0, 4e-3), SPEED)
    assert bench.stage.sent == [(0.0, 0.0, 0.5e-3)]


@pytest.mark.parametrize(("stiffness", "trips"), [(40e3, False), (60e3, True)])
def test_it_stops_on_a_force_that_rises_too_fast(stiffness: float, trips: bool) -> None:
    bench = Bench(stiffness_n_m=stiffness, limits=Limits(LIMITS.least_m, LIMITS.greatest_m, 1e3, 100.0))
    if not trips:
        bench.guard.towards((0.0, 0.0, 0.3e-3), SPEED)
        return
    with refused("force-rate", Tripped) as caught:
        bench.guard.towards((0.0, 0.0, 0.3e-3), SPEED)
    assert caught.value.reason is Reason.FORCE_RATE


def test_nothing_moves_on_an_old_or_faulty_force() -> None:
    for change, reason in (({"age_s": 0.11}, Reason.FORCE_STALE), ({"fault": "wet"}, Reason.FORCE_FAULT)):
        bench = Bench()
        vars(bench.sensor).update(change)
        with pytest.raises(Tripped) as caught:
            bench.guard.towards((0.0, 0.0, 1e-3), SPEED)
        assert caught.value.reason is reason
        assert not bench.stage.sent


@pytest.mark.parametrize(("slower", "late"), [(1.0, False), (1.9, False), (40.0, True)])
def test_a_stage_that_takes_much_longer_than_it_should_is_stopped(slower: float, late: bool) -> None:
    bench = Bench(slower)
    begun = bench.clock.now_ns()
    if not late:
        bench.guard.towards((0.0, 0.0, -0.5e-3), SPEED)
        return
    with pytest.raises(Tripped, match="still moves") as caught:
        bench.guard.towards((0.0, 0.0, -0.5e-3), SPEED)
    assert caught.value.reason is Reason.STAGE_LATE
    waited = (bench.clock.now_ns() - begun) / 1e9
    slowing = SPEED / TRAVEL.acceleration_m_s2
    assert waited == pytest.approx(4.0 + 2.0 * (0.25 + slowing), abs=0.005)
    assert not bench.stage.moving()


def test_moving_away_is_allowed_under_any_force_that_does_not_rise() -> None:
    bench = Bench()
    bench.stage.start = bench.stage.target = (0.0, 0.0, 8e-3)  # 8 N, where 5 are allowed
    bench.guard.away((0.0, 0.0, -1e-3), SPEED)
    assert bench.stage.position_m()[2] == pytest.approx(-1e-3)


class Peak:
    """Greatest force that a bench's sensor gave."""

    def __init__(self, bench: Bench, force_n: Callable[[], float]) -> None:
        self._force_n, self.n = force_n, 0.0
        bench.sensor.force_n = self.taken

    def taken(self) -> float:
        force_n = self._force_n()
        self.n = max(self.n, force_n)
        return force_n


def test_moving_away_into_more_force_is_stopped_and_undone() -> None:
    bench = Bench()
    begun = bench.stage.position_m()
    peak = Peak(bench, lambda: max(-bench.stage.position_m()[2] - 1e-3, 0.0) * STIFFNESS)
    with pytest.raises(Tripped, match="turned round") as caught:
        bench.guard.away((0.0, 0.0, -9e-3), SPEED)
    assert caught.value.reason is Reason.FORCE_LIMIT
    felt_late_n = STIFFNESS * SPEED * LIMITS.force_latency_s  # what comes at first may be of before
    assert RISE_N - 0.01 <= peak.n <= RISE_N + felt_late_n + 0.01
    assert bench.stage.position_m() == begun


def test_a_rise_that_is_gone_when_the_motion_away_stands_is_not_answered_by_going_back() -> None:
    bench = Bench()
    left = iter([0.0] * 100 + [2.0] * 2)
    bench.sensor.force_n = lambda: next(left, 0.0)
    with pytest.raises(Tripped):
        bench.guard.away((0.0, 0.0, -9e-3), SPEED)
    assert next(left, None) is None
    assert bench.stage.position_m()[2] < -1.1e-3


def test_a_force_on_the_way_down_to_the_clearance_is_a_touch_that_came_early() -> None:
    bench = Bench()
    begun = bench.stage.position_m()
    peak = Peak(bench, bench.sensor.force_n)
    with pytest.raises(Tripped, match="touch something") as caught:
        bench.guard.away((0.0, 0.0, 8e-3), SPEED)
    assert caught.value.reason is Reason.TOUCHED_EARLY
    assert peak.n == pytest.approx(RISE_N, abs=0.01)
    assert bench.stage.position_m() == begun


@pytest.mark.parametrize(("target_m", "stops"), [((0.0, 0.0, -0.1e-3), True), ((0.0, 0.0, -5e-3), False)])
def test_only_what_leads_down_through_the_air_needs_a_force_that_is_new(
    target_m: Position, stops: bool
) -> None:
    bench = Bench()
    bench.sensor.age_s = 1.01 * LIMITS.age_s
    if stops:
        with pytest.raises(Tripped) as caught:
            bench.guard.away(target_m, SPEED)
        assert caught.value.reason is Reason.FORCE_STALE
        assert bench.stage.position_m()[2] < -0.99e-3, "at the first look"
    else:
        bench.guard.away(target_m, SPEED)
        assert bench.stage.position_m() == pytest.approx(target_m)


@pytest.mark.parametrize(("pushed_m", "moved"), [(0.9 * ARRIVED_M, False), (1.1 * ARRIVED_M, True)])
def test_a_stage_that_stands_elsewhere_than_it_was_left_does_not_go_on_into_the_skin(
    pushed_m: float, moved: bool
) -> None:
    bench = Bench()
    bench.guard.towards((0.0, 0.0, -0.5e-3), SPEED)
    x, y, z = bench.stage.position_m()
    bench.stage.start = bench.stage.target = (x + pushed_m, y, z)
    if moved:
        sent = len(bench.stage.sent)
        with refused("stage", Tripped) as caught:
            bench.guard.towards((0.0, 0.0, 0.5e-3), SPEED)
        assert caught.value.reason is Reason.STAGE
        assert len(bench.stage.sent) == sent
        bench.guard.away((0.0, 0.0, -1e-3), SPEED)  # away it goes from anywhere
    bench.guard.towards((0.0, 0.0, -0.2e-3), SPEED)


@pytest.mark.parametrize("seconds", [0.01, 0.5, 2.5])
def test_waiting_takes_as_long_as_it_is_told_and_looks_all_the_while(seconds: float) -> None:
    bench = Bench()
    begun = bench.clock.now_ns()
    samples = bench.guard.wait(seconds)
    assert (bench.clock.now_ns() - begun) / 1e9 == pytest.approx(seconds)
    assert len(samples) == math.ceil(seconds / 0.02 - 1e-9)


def test_a_wish_stops_a_motion_and_only_an_emergency_stops_one_away() -> None:
    for wish in (OperatorCommand.PAUSE, OperatorCommand.ABORT, OperatorCommand.ESTOP):
        bench = Bench()
        bench.control.ask(wish)
        with pytest.raises(OperatorInterrupt):
            bench.guard.towards((0.0, 0.0, 1e-3), SPEED)
        if wish is not OperatorCommand.ESTOP:
            bench.guard.away((0.0, 0.0, -2e-3), SPEED)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_no_number_stops_by_its_name_and_holds_up_no_way_out(bad: float) -> None:
    bench = Bench()
    bench.sensor.force_n = lambda: bad if bench.stage.position_m()[2] > 0 else 0.0
    heard: list[Wrench] = []
    bench.guard.samples.subscribe(heard.extend)
    with refused("force-fault", Tripped) as caught:
        bench.guard.towards((0.0, 0.0, 1e-3), SPEED)
    assert caught.value.reason is Reason.FORCE_FAULT
    assert bench.stage.position_m()[2] < 0.05e-3  # a few looks of 4 micrometres
    assert all(one.fault for one in heard if not math.isfinite(one.force_n[2]))
    bench.guard.away((0.0, 0.0, -1e-3), SPEED)
    assert bench.stage.position_m()[2] == pytest.approx(-1e-3)


@pytest.mark.parametrize("error", [ValueError("odd"), ZeroDivisionError(), KeyError("x"), SystemExit(3)])
@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (("stage", "moving"), Reason.STAGE),
        (("stage", "move_to"), Reason.STAGE),
        (("sensor", "drain"), Reason.FORCE_SENSOR),
        (("sensor", "latest"), Reason.FORCE_SENSOR),
    ],
)
def test_a_driver_s_own_exception_stops_by_the_name_of_its_device(
    broken: tuple[str, str], reason: Reason, error: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench()

    def fails(*_: object) -> None:
        raise error

    bench.guard.towards((0.0, 0.0, -0.5e-3), SPEED)
    monkeypatch.setattr(getattr(bench, broken[0]), broken[1], fails)
    with pytest.raises(Tripped, match=type(error).__name__) as caught:
        bench.guard.towards((0.0, 0.0, -0.2e-3), SPEED)
    assert caught.value.reason is reason
    if broken[0] == "sensor":  # and on the way out it stops nothing
        bench.guard.away((0.0, 0.0, -2e-3), SPEED)
        assert bench.stage.position_m()[2] == pytest.approx(-2e-3)


@pytest.mark.parametrize(
    ("down", "command", "stops"),
    [
        (True, OperatorCommand.PAUSE, True),
        (True, OperatorCommand.ABORT, True),
        (True, OperatorCommand.STOP, False),  # ends after the press
        (False, OperatorCommand.ABORT, False),  # nothing but an emergency stop holds up a lift
        (False, OperatorCommand.ESTOP, True),
    ],
)
def test_another_thread_stops_a_move_at_once_by_what_the_next_look_would_stop(
    down: bool, command: OperatorCommand, stops: bool
) -> None:
    bench, stopped = Bench(), []

    def ask() -> None:
        if not stopped:
            bench.control.ask(command)
            other = threading.Thread(target=bench.guard.interrupt, args=(command,))
            other.start()
            other.join(10.0)
            stopped.append(bench.stage.stops)

    bench.guard.looks.subscribe(ask)
    move = bench.guard.towards if down else bench.guard.away
    ends = pytest.raises(OperatorInterrupt, match=command.value) if stops else nullcontext()
    with ends:
        move((0.0, 0.0, 1e-3 if down else -9e-3), SPEED)
    assert stopped == [1 if stops else 0], "before the look had returned"
    bench.guard.interrupt(command)
    assert bench.stage.stops <= 2, "nothing is stopped that does not move"
