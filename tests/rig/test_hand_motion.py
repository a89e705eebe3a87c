"""Work by hand: no homing from within the skin, no zero in contact, no jog past a force or a ceiling."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any

import pytest

from palpate.core import NS_PER_S, DeviceError, ManualClock, Position, Wrench
from palpate.core.errors import InputError, RangeError
from palpate.devices import Mounting
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.commissioning.force_touch import G_M_S2, touch_twice, weigh
from palpate.rig.commissioning.hand_motion import await_push, home_clear, jog, lift_clear, touch_off, zero
from palpate.rig.rig import Rig
from palpate.rig.virtual import Fault, virtual_rig


def jogged(rig: Rig, **given: Any) -> float:
    jog(
        rig.stage,
        rig.force,
        rig.mounting,
        rig.limits,
        rig.clock,
        **{"axis": "z", "distance_m": 1e-3, "speed_m_s": 2e-3} | given,
    )
    return rig.stage.position_m()[2]


def devices(rig: Rig) -> tuple[Any, ...]:
    return rig.stage, rig.force, rig.mounting, rig.clock


class Turned:
    """The rig's force sensor, its axes permuted and turned round."""

    def __init__(self, rig: Rig, mounting: Mounting) -> None:
        self._sensor, self._mounting = rig.force, mounting
        self.rate_hz, self.range_n = rig.force.rate_hz, rig.force.range_n

    def latest(self) -> Wrench:
        one = self._sensor.latest()
        return replace(one, force_n=self._mounting.to_skin(one.force_n))

    def drain(self) -> list[Wrench]:
        return [replace(one, force_n=self._mounting.to_skin(one.force_n)) for one in self._sensor.drain()]

    def close(self) -> None:
        self._sensor.close()


class Switched:
    """A virtual stage with switches, as a controller has them; unknown until homed."""

    def __init__(self, rig: Rig, *, locked: bool = False, top_m: float = -1.0) -> None:
        self._stage, self.locked, self.top_m = rig.stage, locked, top_m
        self.homed_from_m: float | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def retreat(self, distance_m: float, speed_m_s: float) -> None:
        x, y, z = self._stage.position_m()
        if self.locked or z - distance_m < self.top_m:
            raise DeviceError("refused")
        self._stage.move_to((x, y, z - distance_m), speed_m_s)

    def approach(self, distance_m: float, speed_m_s: float) -> None:
        self.retreat(-distance_m, speed_m_s)

    def reference(self, position_m: Position) -> None:
        raise AssertionError("a position was stated that homing finds")

    def unlock(self) -> None:
        self.locked = False

    def home(self) -> None:
        self.homed_from_m = self._stage.position_m()[2]


class Referenced(Switched):
    """A stage whose position a touch-off states."""

    def reference(self, position_m: Position) -> None:
        self.stated_m = position_m


def in_contact(depth_m: float = 1.5e-3) -> Rig:
    """A rig whose probe stands in the skin."""
    rig = virtual_rig()
    rig.stage.move_to((0.0, 0.0, depth_m), 5e-3)
    while rig.stage.moving():
        rig.clock.sleep(0.01)
    return rig


def test_a_jog_goes_as_far_as_it_was_told_and_up_again() -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()[2]
    assert jogged(rig) == pytest.approx(start + 1e-3, abs=2e-5)
    assert jogged(rig, distance_m=-1e-3) == pytest.approx(start, abs=2e-5)


def test_a_jog_into_the_skin_ends_at_its_change_of_force() -> None:
    rig = virtual_rig()
    with pytest.raises(Tripped) as told:
        jogged(rig, distance_m=9e-3, stop_n=1.0)
    assert told.value.reason is Reason.FORCE_LIMIT
    assert 0 < rig.stage.position_m()[2] < 2e-3  # of 4 mm that it was sent into the skin


@pytest.mark.parametrize("after_s", [0.4, 1.0, 2.0])
def test_a_jog_ends_where_the_sensor_repeats_itself(after_s: float) -> None:
    rig = virtual_rig(faults=[Fault("force-stuck", after_s)])
    with pytest.raises(Tripped) as told:
        jogged(rig, distance_m=9e-3)
    assert told.value.reason in (Reason.FORCE_STUCK, Reason.FORCE_DEAD)
    assert rig.stage.position_m()[2] < 0.2e-3  # of 4 mm that it was sent into the skin


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"distance_m": 51e-3}, "51.*50"),
        ({"speed_m_s": 11e-3}, "11.*10"),
        ({"stop_n": 36.0}, "36.*35"),
        ({"axis": "w"}, "x, y or z"),
        ({"distance_m": float("nan")}, "nan"),
    ],
)
def test_a_jog_beyond_its_ceilings_is_refused_with_both_numbers(given: dict[str, Any], said: str) -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()
    with pytest.raises((RangeError, InputError), match=said):
        jogged(rig, **given)
    assert rig.stage.position_m() == start


def test_a_zero_in_the_air_is_the_sensors_own_and_one_in_contact_is_refused() -> None:
    air = zero(*devices(virtual_rig()))
    assert air.lifted_mm == pytest.approx(0.6)
    touching = in_contact()
    with pytest.raises(Tripped, match="in contact"):
        zero(*devices(touching))
    again = zero(*devices(touching))  # the refusal left it in the air
    assert again.force_n == pytest.approx(air.force_n, abs=0.05)


@pytest.mark.parametrize("locked", [False, True])
def test_homing_from_within_the_skin_first_lifts_into_the_air(locked: bool) -> None:
    rig = in_contact()
    stage = Switched(rig, locked=locked)
    home_clear(stage, rig.force, rig.mounting, rig.clock)
    assert stage.homed_from_m is not None
    assert stage.homed_from_m < 0.0


def test_a_stage_that_cannot_be_lifted_is_not_homed_but_on_ones_word() -> None:
    rig = in_contact()
    stage = Switched(rig, top_m=1.4e-3)
    with pytest.raises(DeviceError, match="--lifted"):
        home_clear(stage, rig.force, rig.mounting, rig.clock)
    with pytest.raises(DeviceError, match="--lifted"):
        home_clear(stage, None, rig.mounting, rig.clock)
    assert stage.homed_from_m is None
    home_clear(stage, None, rig.mounting, rig.clock, lifted=True)
    assert stage.homed_from_m is not None


class Numb:
    """A force sensor that gives its noise alone, whatever it touches."""

    def __init__(self, rig: Rig) -> None:
        self._sensor, self._noise = rig.force, random.Random(3)
        self.rate_hz, self.range_n = rig.force.rate_hz, rig.force.range_n

    def latest(self) -> Wrench:
        return self.drain()[-1]

    def close(self) -> None:
        self._sensor.close()

    def drain(self) -> list[Wrench]:
        def noise() -> tuple[float, float, float]:
            return self._noise.gauss(0, 0.005), self._noise.gauss(0, 0.005), self._noise.gauss(0, 0.005)

        samples = self._sensor.drain()
        return [replace(one, force_n=noise(), torque_nm=noise(), fault="") for one in samples]


def test_homing_with_a_numb_sensor_still_starts_above_the_skin() -> None:
    rig = in_contact(3e-3)
    stage = Switched(rig)
    found = home_clear(stage, Numb(rig), rig.mounting, rig.clock)
    assert found is not None
    assert found.lifted_mm == pytest.approx(8.0)
    assert stage.homed_from_m == pytest.approx(3e-3 - 8e-3, abs=0.1e-3)


def test_a_touch_off_with_a_numb_sensor_does_not_leave_the_probe_in_the_skin() -> None:
    rig = virtual_rig()
    rig.stage.move_to((0.0, 0.0, -1e-3), 5e-3)
    while rig.stage.moving():
        rig.clock.sleep(0.01)
    with pytest.raises(Tripped, match="lifted again") as refusal:
        touch_off(Switched(rig), Numb(rig), rig.mounting, rig.clock, (0.0, 0.0, 0.0), pushed=False)
    assert refusal.value.reason is Reason.NO_CONTACT
    assert rig.stage.position_m()[2] < -1e-3


class Pushed:
    """A force sensor that a hand pushes for a while, along its x."""

    def __init__(self, rig: Rig, push_n: float, begin_s: float, end_s: float) -> None:
        self._sensor, self._push_n = rig.force, push_n
        start_ns = rig.clock.now_ns()
        self._begin_ns, self._end_ns = (start_ns + round(s * NS_PER_S) for s in (begin_s, end_s))
        self.rate_hz, self.range_n = rig.force.rate_hz, rig.force.range_n

    def drain(self) -> list[Wrench]:
        return [self._felt(one) for one in self._sensor.drain()]

    def latest(self) -> Wrench:
        return self._felt(self._sensor.latest())

    def close(self) -> None:
        self._sensor.close()

    def _felt(self, one: Wrench) -> Wrench:
        x, y, z = one.force_n
        push_n = self._push_n if self._begin_ns <= one.time_ns < self._end_ns else 0.0
        return replace(one, force_n=(x + push_n, y, z))


@pytest.mark.parametrize(("push_n", "end_s"), [(0.7, 4.0), (-5.0, 2.5), (20.0, 50.0)])
def test_a_push_by_hand_shows_that_the_sensor_responds_once_it_is_over(push_n: float, end_s: float) -> None:
    rig = virtual_rig()
    start_ns = rig.clock.now_ns()
    await_push(Pushed(rig, push_n, 2.0, end_s), rig.clock)  # type: ignore[arg-type]
    assert 2.0 < (rig.clock.now_ns() - start_ns) / NS_PER_S < end_s + 2.0
    stage = Referenced(rig)
    touch_off(stage, Pushed(rig, push_n, 2.0, end_s), *devices(rig)[2:], (0.0, 0.0, 0.0))  # type: ignore[arg-type]
    assert stage.stated_m == pytest.approx((0.0, 0.0, -2e-3))
    assert rig.stage.position_m()[2] == pytest.approx(-2e-3, abs=0.2e-3)


@pytest.mark.parametrize("push_n", [0.0, 0.3])
def test_nothing_moves_before_the_force_sensor_has_responded_to_a_push(push_n: float) -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()
    sensor = Numb(rig) if push_n == 0 else Pushed(rig, push_n, 2.0, 50.0)
    with pytest.raises(Tripped) as refusal:
        touch_off(Switched(rig), sensor, rig.mounting, rig.clock, (0.0, 0.0, 0.0))  # type: ignore[arg-type]
    assert refusal.value.reason is Reason.FORCE_DEAD
    assert rig.stage.position_m() == start


def test_nothing_moves_while_a_hand_still_pushes() -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()

    class Wavering(Pushed):
        def _felt(self, one: Wrench) -> Wrench:
            self._push_n = 1.0 + 0.5 * math.sin(one.time_ns / NS_PER_S * 5.0)
            return super()._felt(one)

    with pytest.raises(Tripped) as refusal:
        touch_off(Switched(rig), Wavering(rig, 1.0, 2.0, 1e4), rig.mounting, rig.clock, (0.0, 0.0, 0.0))  # type: ignore[arg-type]
    assert refusal.value.reason is Reason.FORCE_NOISE
    assert rig.stage.position_m() == start


@pytest.mark.parametrize("guarded", [False, True])
def test_motion_that_no_force_bounds_is_sent_in_short_hops(guarded: bool) -> None:
    rig = virtual_rig()
    start, hops = rig.stage.position_m(), []
    move_to = rig.stage.move_to

    def noted(target: Any, speed_m_s: float) -> None:
        hops.append(abs(target[2] - rig.stage.position_m()[2]))
        move_to(target, speed_m_s)

    rig.stage.move_to = noted  # type: ignore[method-assign]
    jog(
        rig.stage, rig.force if guarded else None, rig.mounting, rig.limits, rig.clock,
        axis="z", distance_m=-3e-3, speed_m_s=2e-3,
    )  # fmt: skip
    assert rig.stage.position_m()[2] == pytest.approx(start[2] - 3e-3, abs=2e-5)
    assert max(hops) < 0.51e-3


def test_a_lift_that_leads_into_the_skin_is_stopped() -> None:
    rig = in_contact(0.5e-3)

    class Down(Switched):
        def retreat(self, distance_m: float, speed_m_s: float) -> None:
            super().retreat(-distance_m, speed_m_s)

    with pytest.raises(Tripped, match=r"turned round|still changes"):
        lift_clear(Down(rig), rig.force, rig.mounting, rig.clock)
    assert rig.stage.position_m()[2] < 3e-3


@pytest.mark.parametrize(
    "axes",
    [
        pytest.param(("x", "y", "z"), marks=pytest.mark.slow),
        pytest.param(("x", "y", "-z"), marks=pytest.mark.slow),
        ("-y", "z", "x"),
        ("z", "x", "-y"),
    ],
)
@pytest.mark.cases(1)
def test_a_touch_finds_the_axis_and_sign_of_any_mounting(axes: tuple[str, str, str]) -> None:
    rig = virtual_rig()
    turned = Turned(rig, Mounting(axes))
    touch = touch_twice(rig.stage, turned, rig.limits, rig.clock, 8e-3)  # type: ignore[arg-type]
    pressed = Mounting(touch.axes).to_skin(Mounting(axes).to_skin((0.0, 0.0, 1.0)))
    assert pressed[2] == 1.0
    assert -0.2e-3 < touch.surface_m[2] < 1.0e-3


def test_a_touch_that_finds_no_skin_or_reaches_too_far_is_refused() -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()
    with pytest.raises(Tripped, match="dead"):
        touch_twice(rig.stage, rig.force, rig.limits, rig.clock, 2e-3)
    assert rig.stage.position_m() == pytest.approx(start, abs=1e-5)
    with pytest.raises(RangeError, match=r"11 mm.*10 mm"):
        touch_twice(rig.stage, rig.force, rig.limits, rig.clock, 11e-3)


class Scale:
    """A sensor of quiet counts that reads `scale` of what lies on it, on a clock in the test's hand."""

    rate_hz, range_n = 500.0, (30.0, 30.0, 30.0)

    def __init__(self, scale: float) -> None:
        self.scale, self.load_n, self.clock, self._n = scale, (0.0, 0.0, 0.0), ManualClock(NS_PER_S), 0
        self._due_ns = self.clock.now_ns()

    def latest(self) -> Wrench:
        self._n += 1
        x, y, z = (
            self.scale * f + 1e-3 * (self._n * k % 7 - 3) for f, k in zip(self.load_n, (1, 2, 3), strict=True)
        )
        return Wrench(self._due_ns, (x, y, z + 5.0))

    def drain(self) -> list[Wrench]:
        taken = []
        while self._due_ns <= self.clock.now_ns():
            taken.append(self.latest())
            self._due_ns += 2_000_000
        return taken

    def close(self) -> None:
        pass


@pytest.mark.parametrize("scale", [1.0, 0.1, 1.3])
def test_a_known_weight_tells_the_scale_within_its_uncertainty(scale: float) -> None:
    sensor = Scale(scale)

    def lay() -> None:
        sensor.load_n = (0.0, 0.0, -0.2 * G_M_S2)

    found = weigh(sensor, ("x", "y", "-z"), sensor.clock, 200.0, 0.2, lay)
    assert found.factor == pytest.approx(1 / scale, abs=found.uncertainty)
    assert found.uncertainty < 0.02 / scale
    assert found.agrees == (scale == 1.0)


@pytest.mark.parametrize("load_n", [(0.0, 0.0, 0.0), (1.4, 0.0, -1.4)])
def test_a_weight_that_is_not_there_or_askew_gives_no_factor(
    load_n: tuple[float, float, float],
) -> None:
    sensor = Scale(1.0)

    def lay() -> None:
        sensor.load_n = load_n

    with pytest.raises(InputError, match="along the press"):
        weigh(sensor, ("x", "y", "z"), sensor.clock, 200.0, 0.2, lay)
    with pytest.raises(RangeError, match="lighter"):
        weigh(sensor, ("x", "y", "z"), sensor.clock, 4000.0, 1.0, lay)
