"""Guarded motion of any actuator, and its listeners: who hears what, in which order, and what fails."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from tests.refusals import refused
from tests.rig.rigs import rig

from palpate.core.clock import NS_PER_S, ManualClock
from palpate.core.device_protocols import ForceSensor, Position, Stage, Travel, Wrench
from palpate.core.errors import StorageError
from palpate.devices import ForceBias, Limits, MotionGuard, OperatorControl, Reason, Subscribers, Tripped
from palpate.recordings import Run
from palpate.rig import State, Status, record
from palpate.rig.plans import Listed, Ramp
from palpate.rig.rig import Rig


def guarded(small: Rig) -> MotionGuard:
    return MotionGuard(
        small.stage, small.force, small.limits, ForceBias(small.mounting), small.clock, OperatorControl()
    )


def test_two_subscribers_both_hear_each_sample_in_the_order_in_which_they_subscribed() -> None:
    small = rig()
    guard, first, second = guarded(small), list[Wrench](), list[Wrench]()
    order: list[str] = []

    def hear_first(samples: Sequence[Wrench]) -> None:
        first.extend(samples)
        order.append("first")

    def hear_second(samples: Sequence[Wrench]) -> None:
        second.extend(samples)
        order.append("second")

    guard.samples.subscribe(hear_first)
    guard.samples.subscribe(hear_second)
    returned = guard.wait(0.2)
    assert len(returned) > 20
    assert first == second == returned
    assert order == ["first", "second"] * (len(order) // 2)


def test_a_subscription_ends_with_its_block_and_leaves_the_others_as_they_were() -> None:
    guard, always, within = guarded(rig()), list[int](), list[int]()
    guard.samples.subscribe(lambda samples: always.append(len(samples)))
    with suppress(KeyError), guard.samples.subscribed(lambda samples: within.append(len(samples))):
        guard.wait(0.1)
        raise KeyError
    heard_within, heard_always = len(within), len(always)
    guard.wait(0.1)
    assert heard_within == heard_always > 0
    assert len(within) == heard_within
    assert len(always) > heard_always


def test_where_one_subscriber_raises_the_others_still_hear_and_no_exception_is_lost() -> None:
    events: Subscribers[[int]] = Subscribers()
    heard: list[int] = []

    def full(event: int) -> None:
        raise StorageError(f"no room for {event}")

    def broken(event: int) -> None:
        raise ValueError(f"cannot draw {event}")

    for callback in (full, broken, heard.append):
        events.subscribe(callback)
    with refused("storage", StorageError) as raised:
        events.publish(7)
    assert heard == [7]
    assert ["ValueError" in note for note in raised.value.__notes__] == [True]


def test_a_callback_that_has_not_subscribed_cannot_leave() -> None:
    events: Subscribers[[]] = Subscribers()
    with pytest.raises(ValueError, match="list"):
        events.unsubscribe(lambda: None)


def test_a_subscriber_that_raises_stops_the_motion_it_hears_of() -> None:
    small = rig()
    guard = guarded(small)
    x, y, z = small.stage.position_m()

    def hear(position_m: Position, time_ns: int) -> None:
        raise Tripped(Reason.CAMERA, "no frame came")

    guard.positions.subscribe(hear)
    with refused("camera", Tripped):
        guard.away((x + 2e-3, y, z), 5e-3)
    assert not small.stage.moving()
    assert small.stage.position_m()[0] < x + 1e-3


@pytest.mark.slow
def test_who_watches_hears_during_a_sweep_as_well_as_the_sweep_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("palpate.rig.engine.TOLD_EVERY_S", 0.0)
    depths: list[float] = []

    def watch(status: Status) -> None:
        if status.position_mm is not None and "sweep" in status.message:
            depths.append(status.position_mm[2])

    centre = Listed(kind="listed", at_mm=((0.0, 0.0),))
    slow = Ramp(name="s", kind="swept", places=centre, cycles=1, speed_mm_s=2.0, depth_mm=1.0, taps=0)
    outcome = record(rig(), slow, tmp_path / "run", watch=watch)
    assert outcome.state is State.DONE
    assert (Run.open(tmp_path / "run").labels["phase"] == "sweep").any()
    assert max(depths) > 0, "the probe was seen below the surface"


class Plunger:
    """An actuator along z that is no stage, since it cannot be closed; its spring begins at z = 0."""

    travel = Travel((-1e-3, -1e-3, -5e-3), (1e-3, 1e-3, 5e-3), 0.05, 1.0, 1e-3)

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self._begun_ns, self._start, self._target, self._speed = 0, -2e-3, -2e-3, 1.0

    def position_m(self) -> Position:
        gone = (self._clock.now_ns() - self._begun_ns) / NS_PER_S * self._speed
        way = self._target - self._start
        return 0.0, 0.0, self._start + min(1.0, gone / abs(way) if way else 1.0) * way

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        self._start, self._target = self.position_m()[2], position_m[2]
        self._begun_ns, self._speed = self._clock.now_ns(), speed_m_s

    def moving(self) -> bool:
        return self.position_m()[2] != self._target

    def stop(self) -> None:
        self._start = self._target = self.position_m()[2]


class Spring:
    """A force that is no sensor: it states no rate and no range."""

    def __init__(self, plunger: Plunger, clock: ManualClock) -> None:
        self._plunger, self._clock = plunger, clock

    def latest(self) -> Wrench:
        depth = max(0.0, self._plunger.position_m()[2])
        return Wrench(self._clock.now_ns(), (0.0, 0.0, 2e3 * depth))

    def drain(self) -> list[Wrench]:
        return [self.latest()]


def test_any_actuator_and_any_force_are_guarded_by_the_same_guard() -> None:
    clock = ManualClock()
    plunger = Plunger(clock)
    spring = Spring(plunger, clock)
    assert not isinstance(plunger, Stage)
    assert not isinstance(spring, ForceSensor)
    limits = Limits(plunger.travel.least_m, plunger.travel.greatest_m, force_n=1.0)
    guard = MotionGuard(plunger, spring, limits, ForceBias(), clock, OperatorControl())
    with refused("force-limit", Tripped) as tripped:
        guard.towards((0.0, 0.0, 2e-3), 5e-3)
    assert tripped.value.reason is Reason.FORCE_LIMIT
    assert not plunger.moving()
    # One newton is 0.5 mm; a poll at 5 mm/s is 0.01 mm, and the steps that lead there are whole.
    assert 0.5e-3 < plunger.position_m()[2] < 0.52e-3
    guard.away((0.0, 0.0, -2e-3), 5e-3)
    assert guard.force_n == (0.0, 0.0, 0.0)
