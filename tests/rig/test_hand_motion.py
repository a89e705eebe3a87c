"""Work by hand: no homing from within the skin, no zero in contact, no jog past a force or a ceiling."""

import math
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused
from tests.rig.guarded_presses import ChangedForce
from tests.rig.lab_files import lab_file

from palpate.core import NS_PER_S, DeviceError, Frame, InputError, ManualClock, PalpateError, Position, Wrench
from palpate.core.errors import RangeError
from palpate.devices import Mounting
from palpate.devices.device_proxies import driver_errors
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.commissioning.bench import Bench, frame_times
from palpate.rig.commissioning.first_touch import touch_twice
from palpate.rig.commissioning.hand_motion import jog, lift_clear, touch_off, zero
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.mean_force import Hand, await_push, discard
from palpate.rig.rig import Rig
from palpate.rig.rig_file import MarlinPart, open_rig
from palpate.rig.virtual import Fault, virtual_rig


def jogged(rig: Rig, **given: Any) -> float:
    jog(
        rig.stage, rig.force, rig.mounting, rig.limits, rig.clock,
        **{"axis": "z", "distance_m": 1e-3, "speed_m_s": 2e-3} | given,
    )  # fmt: skip
    return rig.stage.position_m()[2]


def devices(rig: Rig) -> tuple[Any, ...]:
    return rig.stage, rig.force, rig.mounting, rig.clock


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


def standing(z_m: float) -> Rig:
    """A rig whose probe stands at a height."""
    rig = virtual_rig()
    rig.stage.move_to((0.0, 0.0, z_m), 20e-3)
    while rig.stage.moving():
        rig.clock.sleep(0.01)
    return rig


def at_soft_limit(rig: Rig) -> Rig:
    """The same with its upper soft limit where the probe stands."""
    z = rig.stage.position_m()[2]
    return replace(rig, limits=replace(rig.limits, least_m=(*rig.limits.least_m[:2], z)))


@contextmanager
def tripped(*reasons: Reason) -> Iterator[None]:
    with pytest.raises(Tripped) as told:
        yield
    assert told.value.reason in reasons, told.value


def test_a_jog_goes_as_far_as_it_was_told_and_up_again_also_from_the_upper_soft_limit() -> None:
    rig = at_soft_limit(virtual_rig())
    start = rig.stage.position_m()[2]
    assert jogged(rig) == pytest.approx(start + 1e-3, abs=2e-5)
    assert jogged(rig, distance_m=-1e-3) == pytest.approx(start, abs=2e-5)


@pytest.mark.parametrize(("axis", "step_m"), [("z", 0.1e-3), ("x", 1e-3)])
def test_a_repeated_jog_in_the_skin_is_refused_and_lifts_the_probe(axis: str, step_m: float) -> None:
    rig = standing(0.3e-3)
    with tripped(Reason.TOUCHED_EARLY):
        jogged(rig, axis=axis, distance_m=step_m)
    assert rig.stage.position_m()[2] < 0


def test_repeated_small_jogs_go_no_deeper_than_one() -> None:
    rig, deepest_m = standing(-0.3e-3), -1e-3
    for _ in range(12):
        with suppress(Tripped):
            deepest_m = max(deepest_m, jogged(rig, distance_m=0.1e-3))
    assert 0 < deepest_m < 0.6e-3  # 1 N


def test_jogs_in_contact_at_the_upper_soft_limit_are_refused_and_press_no_harder_by_repetition() -> None:
    rig = at_soft_limit(standing(0.2e-3))
    for _ in range(4):
        with tripped(Reason.TOUCHED_EARLY):
            jogged(rig, distance_m=0.5e-3)
        assert rig.stage.position_m()[2] == pytest.approx(0.2e-3, abs=1e-5)
    with tripped(Reason.SOFT_LIMIT):
        touch_twice(rig.stage, rig.force, rig.limits, rig.clock, 2e-3)


class EndsMeasuring:
    """A force sensor that repeats its last sample, or falls silent, from a moment on."""

    def __init__(self, rig: Rig, after_s: float, *, silent: bool) -> None:
        self._sensor, self._silent, self._last = rig.force, silent, rig.force.latest()
        self._from_ns = rig.clock.now_ns() + after_s * NS_PER_S

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)

    def drain(self) -> list[Wrench]:
        samples = self._sensor.drain()
        good = [one for one in samples if one.time_ns < self._from_ns]
        self._last = good[-1] if good else self._last
        late = samples[len(good) :]
        return good + ([] if self._silent else [replace(self._last, time_ns=one.time_ns) for one in late])


@pytest.mark.parametrize("silent", [True, False])
def test_a_jog_away_ends_where_the_sensor_measures_no_more(silent: bool) -> None:
    """As z may be turned round."""
    rig = virtual_rig()
    z = rig.stage.position_m()[2]
    rig = replace(rig, force=EndsMeasuring(rig, 2.5, silent=silent))
    with tripped(Reason.FORCE_STALE if silent else Reason.FORCE_STUCK):
        jogged(rig, distance_m=-12e-3)
    assert rig.stage.position_m()[2] > z - 6e-3


def test_two_touches_that_begin_in_the_skin_find_its_surface() -> None:
    rig = standing(1.0e-3)
    found = touch_twice(rig.stage, rig.force, rig.limits, rig.clock, 2e-3)
    assert found.surface_m[2] == pytest.approx(0.0, abs=0.5e-3)
    with pytest.raises(RangeError):
        touch_twice(rig.stage, rig.force, rig.limits, rig.clock, 6e-3)


def test_a_jog_into_the_skin_ends_at_its_change_of_force() -> None:
    rig = virtual_rig()
    with tripped(Reason.FORCE_LIMIT):
        jogged(rig, distance_m=9e-3, stop_n=1.0)
    assert abs(rig.stage.position_m()[2]) < 0.2e-3  # back in the air, of 4 mm that it was sent into the skin


def test_a_jog_whose_sensor_is_at_the_end_of_its_range_ends_and_goes_back() -> None:
    rig = virtual_rig()
    whole, zero_n = rig.force.drain, rig.force.latest().force_n

    def railed() -> list[Wrench]:
        return [
            replace(
                one,
                force_n=tuple(
                    z + max(-0.5, min(f - z, 0.5)) for f, z in zip(one.force_n, zero_n, strict=True)
                ),
            )
            for one in whole()
        ]

    rig.force.drain = railed  # type: ignore[method-assign]
    with tripped(Reason.FORCE_DEAD):
        jogged(rig, distance_m=9e-3)
    assert rig.stage.position_m()[2] < 0.3e-3


@pytest.mark.parametrize("after_s", [0.4, 2.0])
def test_a_jog_ends_where_the_sensor_repeats_itself(after_s: float) -> None:
    rig = virtual_rig(faults=[Fault("force-stuck", after_s)])
    # While the lift proves the air, equal samples are no noise.
    with tripped(Reason.FORCE_STUCK, Reason.FORCE_DEAD, Reason.FORCE_NOISE):
        jogged(rig, distance_m=9e-3)
    assert rig.stage.position_m()[2] < 0.2e-3  # of 4 mm that it was sent into the skin


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"distance_m": 51e-3}, "jog-length"),
        ({"speed_m_s": 11e-3}, "jog-speed"),
        ({"stop_n": 36.0}, "force-limit"),
        ({"axis": "w"}, "axis-unknown"),
        ({"distance_m": float("nan")}, "jog-length"),
    ],
)
def test_a_jog_beyond_its_ceilings_is_refused_with_both_numbers(given: dict[str, Any], code: str) -> None:
    rig = virtual_rig()
    start = rig.stage.position_m()
    with refused(code):
        jogged(rig, **given)
    assert rig.stage.position_m() == start


def test_a_zero_in_the_air_is_the_sensors_own_and_one_in_contact_is_refused() -> None:
    air = zero(Hand(*devices(virtual_rig())))
    assert air.lifted_mm == pytest.approx(0.6)
    touching = standing(1.5e-3)
    with pytest.raises(Tripped, match="in contact"):
        zero(Hand(*devices(touching)))
    again = zero(Hand(*devices(touching)))  # the refusal left it in the air
    assert again.force_n == pytest.approx(air.force_n, abs=0.05)


@pytest.mark.parametrize("locked", [False, True])
def test_homing_from_within_the_skin_first_lifts_into_the_air(locked: bool) -> None:
    rig = standing(1.5e-3)
    stage = Switched(rig, locked=locked)
    home_clear(stage, rig.force, rig.mounting, rig.clock)
    assert stage.homed_from_m is not None
    assert stage.homed_from_m < 0.0


def test_a_stage_that_cannot_be_lifted_is_not_homed_but_on_ones_word() -> None:
    rig = standing(1.5e-3)
    stage = Switched(rig, top_m=1.4e-3)
    for force in (rig.force, None):
        with pytest.raises(DeviceError, match="--lifted"):
            home_clear(stage, force, rig.mounting, rig.clock)
    assert stage.homed_from_m is None
    home_clear(stage, None, rig.mounting, rig.clock, lifted=True)
    assert stage.homed_from_m is not None


def added(one: Wrench, x_n: float, y_n: float, z_n: float) -> Wrench:
    x, y, z = one.force_n
    return replace(one, force_n=(x + x_n, y + y_n, z + z_n))


def numb(rig: Rig) -> ChangedForce:
    """Gives its noise alone, whatever it touches."""
    draw = random.Random(3).gauss

    def noise(one: Wrench) -> Wrench:
        fx, fy, fz, tx, ty, tz = (draw(0, 0.005) for _ in range(6))
        return replace(one, force_n=(fx, fy, fz), torque_nm=(tx, ty, tz), fault="")

    return ChangedForce(rig.force, noise)


def test_homing_with_a_numb_sensor_still_starts_above_the_skin() -> None:
    rig = standing(3e-3)
    stage = Switched(rig)
    found = home_clear(stage, numb(rig), rig.mounting, rig.clock)
    assert found is not None
    assert found.lifted_mm == pytest.approx(8.0)
    assert stage.homed_from_m == pytest.approx(3e-3 - 8e-3, abs=0.1e-3)


def touched_off(rig: Rig, stage: Any, force: Any, **given: Any) -> None:
    touch_off(Hand(stage, force, rig.mounting, rig.clock), (0.0, 0.0, 0.0), **given)


def test_a_touch_off_with_a_numb_sensor_does_not_leave_the_probe_in_the_skin() -> None:
    rig = standing(-1e-3)
    with tripped(Reason.NO_CONTACT):
        touched_off(rig, Switched(rig), numb(rig), pushed=False)
    assert rig.stage.position_m()[2] < -1e-3


def pushed(rig: Rig, push_n: float, begin_s: float, end_s: float) -> ChangedForce:
    """A hand pushes it for a while, along its z."""
    begin_ns, end_ns = (rig.clock.now_ns() + round(s * NS_PER_S) for s in (begin_s, end_s))
    return ChangedForce(
        rig.force, lambda one: added(one, 0.0, 0.0, push_n if begin_ns <= one.time_ns < end_ns else 0.0)
    )


@pytest.mark.parametrize(("push_n", "end_s"), [(0.7, 4.0), (-5.0, 2.5), (20.0, 50.0)])
@pytest.mark.cases(1)
def test_a_push_by_hand_shows_that_the_sensor_responds_once_it_is_over(push_n: float, end_s: float) -> None:
    rig = virtual_rig()
    start_ns = rig.clock.now_ns()
    found = await_push(pushed(rig, push_n, 2.0, end_s), rig.clock, 2)
    assert found[2] == pytest.approx(push_n, abs=0.05)
    assert end_s - 0.2 < (rig.clock.now_ns() - start_ns) / NS_PER_S < end_s + 2.0


def test_a_touch_off_after_a_push_states_the_position_of_the_skin() -> None:
    rig = standing(-1e-3)
    stage = Referenced(rig)
    touched_off(rig, stage, pushed(rig, 1.0, 1.0, 2.0))
    assert stage.stated_m == pytest.approx((0.0, 0.0, -2e-3))
    assert rig.stage.position_m()[2] == pytest.approx(-2e-3, abs=0.2e-3)


def sideways(one: Wrench, since_s: float) -> Wrench:
    return added(one, 2.0 * (0 < since_s < 1), 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda one, since_s: added(one, 0.0, 0.0, 0.6 * (since_s > 0)), Reason.FORCE_NOISE),
        (lambda one, since_s: added(one, 0.0, 0.0, 0.04 * since_s), Reason.FORCE_DEAD),
        (sideways, Reason.FORCE_DEAD),
        (lambda one, since_s: added(one, 0.0, 0.0, math.nan if since_s > 0 else 0.0), Reason.FORCE_FAULT),
    ],
    ids=["jump", "drift", "sideways", "nan"],
)
def test_a_change_of_force_that_is_no_push_along_the_press_moves_nothing(change, reason: Reason) -> None:
    rig = virtual_rig()
    start, begin_ns = rig.stage.position_m(), rig.clock.now_ns() + 2 * NS_PER_S
    disturbed = ChangedForce(rig.force, lambda one: change(one, max(one.time_ns - begin_ns, 0) / NS_PER_S))
    with tripped(reason):
        touched_off(rig, Switched(rig), disturbed)
    assert rig.stage.position_m() == start


def soft(rig: Rig, n_m: float, more_n: Callable[[float], float] = lambda z_m: 0.0) -> ChangedForce:
    """A linear skin of so many N/m below z = 0, with the sensor's noise."""
    draw = random.Random(5).gauss

    def felt(one: Wrench) -> Wrench:
        z_m = rig.stage.position_m()[2]
        x, y, z = (draw(0, 0.003) for _ in "xyz")
        return replace(one, force_n=(x, y, z + n_m * max(z_m, 0.0) + more_n(z_m)), fault="")

    return ChangedForce(rig.force, felt)


class TurnedStage(Switched):
    """A stage whose z runs the other way: what it is told to lift goes into the skin."""

    def retreat(self, distance_m: float, speed_m_s: float) -> None:
        x, y, z = self._stage.position_m()
        self._stage.move_to((x, y, z + distance_m), speed_m_s)


@pytest.mark.parametrize(("n_m", "most_mm"), [(500.0, 2.5), (4000.0, 0.6), (-1000.0, 10.5), (-4000.0, 3.0)])
def test_a_lift_that_leads_into_a_soft_skin_is_stopped_by_the_whole_change(
    n_m: float, most_mm: float
) -> None:
    rig = standing(-0.2e-3)
    with tripped(Reason.FORCE_LIMIT):
        lift_clear(Hand(TurnedStage(rig), soft(rig, n_m), rig.mounting, rig.clock))
    assert rig.stage.position_m()[2] * 1e3 < most_mm


def test_a_knock_in_a_search_gives_no_position() -> None:
    rig, begun_ns = standing(-3e-3), list[int]()

    def knock_n(z_m: float) -> float:
        now_ns = rig.clock.now_ns()
        if not begun_ns and z_m > -2.9e-3:
            begun_ns.append(now_ns)
        return 0.6 if begun_ns and now_ns - begun_ns[0] < 0.4 * NS_PER_S else 0.0

    with tripped(Reason.FORCE_NOISE, Reason.NO_CONTACT):
        touched_off(rig, Referenced(rig), soft(rig, 4000.0, knock_n), pushed=False)
    assert rig.stage.position_m()[2] < -1e-3, "lifted again"


# Commissioning verbs: what ends them, what they refuse, and what a camera's rate is.


BOX = {"least_mm": [-1, -1, -1], "greatest_mm": [1, 1, 1]}


@pytest.mark.parametrize("homes", [False, True])
def test_a_marlin_stage_homes_only_where_its_file_says_that_it_may(homes: bool) -> None:
    fields = {"kind": "marlin", "port": "p", "home": homes} | BOX
    part = MarlinPart.model_validate(fields if homes else fields | {"reference": [0, 0, 0]})
    bench = Bench("printer", ManualClock(), Mounting(), None, (0.0, 0.0, 0.0), stage_part=part)
    if homes:
        bench.check_may_home()
    else:
        with pytest.raises(InputError, match="nothing moved"):
            bench.check_may_home()


class ClockedCamera:
    """A camera whose frames end at whole periods; `grab` waits for a whole exposure, as all do."""

    size_px = (4, 4)

    def __init__(self, clock: ManualClock, rate_hz: float, stated_hz: float) -> None:
        self._clock, self._period_ns, self.rate_hz = clock, round(NS_PER_S / rate_hz), stated_hz
        self._given = 0

    def _frame(self, index: int) -> tuple[int, Frame]:
        self._given = index
        return index * self._period_ns, Frame(np.zeros((4, 4), np.uint8))

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        index = self._clock.now_ns() // self._period_ns + 2
        self._clock.sleep((index * self._period_ns - self._clock.now_ns()) / NS_PER_S)
        return self._frame(index)

    def drain(self) -> list[tuple[int, Frame]]:
        newest = self._clock.now_ns() // self._period_ns
        return [self._frame(index) for index in range(self._given + 1, newest + 1)]

    def close(self) -> None: ...


@pytest.mark.parametrize("rate_hz", [12.0, 20.0, 30.0, 100.0])
def test_the_rate_of_a_camera_is_that_of_all_its_frames(rate_hz: float) -> None:
    clock = ManualClock(NS_PER_S)
    times = frame_times(ClockedCamera(clock, rate_hz, 30.0), clock, 1.0)
    assert (len(times) - 1) * NS_PER_S / (times[-1] - times[0]) == pytest.approx(rate_hz, rel=1e-6)


class ForeignExit(BaseException):
    """What no `except Exception` catches, as a cancelled task or a panic of another language."""


def test_whatever_a_driver_raises_is_an_error_of_the_device() -> None:
    with pytest.raises(PalpateError, match="ForeignExit"), driver_errors("the driver failed"):
        raise ForeignExit
    with pytest.raises(KeyboardInterrupt), driver_errors("the driver failed"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"greatest_mm": [-10, 90, 900]}, "travel"),
        ({"least_mm": [-90, 10, 36]}, "must be"),
        ({"force_N": 50.0}, "force_N"),
    ],
)
def test_a_file_that_homes_is_judged_before_it_does(tmp_path, limits: dict[str, Any], said: str) -> None:
    with lab_file(tmp_path) as lab:
        page = {"stage": {"home": True, "reference": None}, "limits": limits}
        lab.fields["stage"].pop("reference")
        page["stage"].pop("reference")
        if "force_N" in limits:
            page["force"] = {"axes": ["z", "y", "-x"]}  # along which it measures 30 N at most
        with pytest.raises(PalpateError, match=said):
            open_rig(lab.write(**page), supervised=False)
        assert not lab.jogged


class Overflowing:
    """A force sensor whose samples nobody fetched for long; it says so once, as drivers do."""

    rate_hz, range_n = 100.0, (10.0, 10.0, 10.0)

    def __init__(self, times: int) -> None:
        self._left = times

    def drain(self) -> list[Any]:
        if self._left:
            self._left -= 1
            raise DeviceError("12078 samples were overwritten")
        return []

    def latest(self) -> Wrench:
        return Wrench(0, (0.0, 0.0, 0.0))

    def close(self) -> None: ...


def test_what_came_while_a_person_read_is_dropped_and_a_failed_sensor_is_told() -> None:
    discard(Overflowing(1))
    with pytest.raises(DeviceError):
        discard(Overflowing(2))
