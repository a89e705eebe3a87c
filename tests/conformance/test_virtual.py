"""The public checks pass what keeps the protocols, and tell each fault by the law that it breaks."""

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import DeviceError, ManualClock, Position, RangeError, Travel, Wrench
from palpate.core.frame import Frame
from palpate.devices.check.camera_check import check_camera
from palpate.devices.check.force_check import check_force_sensor
from palpate.devices.check.interface_check import CheckResult
from palpate.devices.check.stage_check import check_stage
from palpate.devices.check.stage_motion import Box
from palpate.rig.rig import Rig
from palpate.rig.rig_check import check_rig
from palpate.rig.virtual import Fault, virtual_rig
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm

SPEC = palm.cropped(palm.palm(), 16, "tiny")
BOX: Box = ((-2e-3, -2e-3, -7e-3), (2e-3, 2e-3, -3e-3))
SPEED_M_S = 10e-3
SURFACE_M = 0.0  # of the virtual palm's layer


def rig(*faults: Fault) -> Rig:
    return virtual_rig(Palm(SPEC), clock=ManualClock(10**11), faults=faults)


def failed(findings: list[CheckResult]) -> set[str]:
    assert all(one.ok or one.message for one in findings), "what is wrong is told"
    return {one.code for one in findings if not one.ok}


# The stage


class Stage:
    """As plain as a stage can be: at speed at once, braked as it says. Remembers where it was."""

    travel = Travel((-40e-3,) * 3, (40e-3, 40e-3, 12e-3), 50e-3, 0.5, 0.004)

    def __init__(self, clock: ManualClock) -> None:
        self.clock, self.closed = clock, False
        self.from_m = self.to_m = np.array([0.0, 0.0, -5e-3])
        self.begun_s, self.speed_m_s = 0.0, 1.0
        self.deepest_m = -math.inf
        self.sent: list[Position] = []

    @property
    def now_s(self) -> float:
        if self.closed:
            raise DeviceError("closed")
        return self.clock.ns / 1e9

    def gone(self) -> float:
        length = float(np.linalg.norm(self.to_m - self.from_m))
        return min((self.now_s - self.begun_s) * self.speed_m_s / length, 1.0) if length else 1.0

    def position_m(self) -> Position:
        x, y, z = (self.from_m + self.gone() * (self.to_m - self.from_m)).tolist()
        self.deepest_m = max(self.deepest_m, z)
        return x, y, z

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        travel = self.travel
        if not all(
            a <= p <= b for a, p, b in zip(travel.least_m, position_m, travel.greatest_m, strict=True)
        ):
            raise RangeError("outside")
        if not 0 < speed_m_s <= travel.top_speed_m_s:
            raise RangeError("no such speed")
        if self.gone() < 1.0:
            raise DeviceError("it moves already")
        self.sent.append(position_m)
        self.from_m, self.to_m = np.array(self.position_m()), np.array(position_m)
        self.begun_s, self.speed_m_s = self.now_s, speed_m_s

    def moving(self) -> bool:
        return self.gone() < 1.0

    def stop(self) -> None:
        if self.gone() < 1.0:
            self.clock.sleep(self.travel.latency_s)
            rest = self.speed_m_s**2 / 2 / self.travel.acceleration_m_s2
            way = self.to_m - self.from_m
            share = min(self.gone() + rest / float(np.linalg.norm(way)), 1.0)
            self.clock.sleep(self.speed_m_s / self.travel.acceleration_m_s2)
            self.from_m = self.to_m = self.from_m + share * way

    def close(self) -> None:
        self.closed = True


class Around(Stage):
    """A stage that is like another one; where it was and was sent is remembered."""

    def __init__(self, stage: Any, clock: ManualClock) -> None:
        super().__init__(clock)
        self.stage = stage

    def position_m(self) -> Position:
        place = self.stage.position_m()
        self.deepest_m = max(self.deepest_m, place[2])
        return place

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        self.sent.append(position_m)
        self.stage.move_to(position_m, speed_m_s)

    def moving(self) -> bool:
        return self.stage.moving()

    def stop(self) -> None:
        self.stage.stop()

    def close(self) -> None:
        self.stage.close()


def changed(kind: type, **changes: Any) -> type:
    """The kind with other members."""
    return type("Changed", (kind,), changes)


def elsewhere(away: Callable[[Stage], float]) -> type[Stage]:
    """A stage that says that it is so far along x from where it is."""

    def position_m(self: Stage) -> Position:
        x, y, z = Stage.position_m(self)
        return x + away(self), y, z

    return changed(Stage, position_m=position_m)


def tells_the_target(self: Stage) -> Position:
    return self.sent[-1] if self.sent and self.moving() else Stage.position_m(self)


def takes_any_speed(self: Stage, position_m: Position, speed_m_s: float) -> None:
    Stage.move_to(self, position_m, min(abs(speed_m_s), 0.05) if speed_m_s else 1e-3)


class Blocks(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        super().move_to(position_m, speed_m_s)
        while self.moving():
            self.clock.sleep(0.01)


class FallsShort(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        at = self.position_m()
        x, y, z = (p + 0.98 * (q - p) if math.isfinite(q) else q for p, q in zip(at, position_m, strict=True))
        super().move_to((x, y, z), speed_m_s)


class WavesOnItsWay(Stage):
    def position_m(self) -> Position:
        x, y, z = super().position_m()
        wave = 0.1e-3 * math.sin(400 * self.clock.ns / 1e9) if self.moving() else 0.0
        return x + wave, y + wave, z + wave


class NeverSaysThatItStands(Stage):
    sent_off = False

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        super().move_to(position_m, speed_m_s)
        self.sent_off = True

    def moving(self) -> bool:
        return self.sent_off

    def stop(self) -> None:
        super().stop()
        self.sent_off = False


class StopsSlowly(Stage):
    """The stage stands soon; stop() returns late."""

    def stop(self) -> None:
        super().stop()
        self.clock.sleep(1.5)


class RacesAlong(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        super().move_to(position_m, min(3 * speed_m_s, 50e-3) if 0 < speed_m_s <= 50e-3 else speed_m_s)


class TakesAnyPlace(Stage):
    """Clips what lies outside, as controllers do, rather than refuse it."""

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        travel = self.travel
        x, y, z = np.clip(position_m, travel.least_m, travel.greatest_m).tolist()
        super().move_to((x, y, z), speed_m_s)


class TakesNoNumber(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        x, y, z = np.nan_to_num(position_m, nan=-5e-3, posinf=-5e-3, neginf=-5e-3).tolist()
        super().move_to((x, y, z), speed_m_s)


class RefusesWithAnotherError(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        try:
            super().move_to(position_m, speed_m_s)
        except RangeError as e:
            raise ValueError(str(e)) from e


class TakesASecondMove(Stage):
    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        self.stop()
        super().move_to(position_m, speed_m_s)


class RunsOn(Stage):
    """Its true latency is a fifth of a second, and it states 4 ms."""

    def stop(self) -> None:
        if self.moving():
            self.clock.sleep(0.2)
        super().stop()


class ReturnsBeforeItStands(Stage):
    """The controller stops it a quarter of a second after stop() has returned."""

    due_ns = math.inf

    def stop(self) -> None:
        if self.moving():
            self.due_ns = self.clock.ns + 250_000_000

    def position_m(self) -> Position:
        self._stop_if_due()
        return super().position_m()

    def moving(self) -> bool:
        self._stop_if_due()
        return super().moving()

    def _stop_if_due(self) -> None:
        if self.clock.ns >= self.due_ns:
            self.due_ns = math.inf
            super().stop()


class GoesOnToTheTarget(Stage):
    """stop() waits until the move is over."""

    def stop(self) -> None:
        while self.moving():
            self.clock.sleep(0.01)


class StopsInItsOwnThreadOnly(Stage):
    def __init__(self, clock: ManualClock) -> None:
        super().__init__(clock)
        self.own = threading.get_ident()

    def stop(self) -> None:
        if threading.get_ident() != self.own:
            raise DeviceError("stop me from my own thread")
        super().stop()


class FailsWhenStoppedAtAStand(Stage):
    def stop(self) -> None:
        if not self.moving() and self.sent:
            raise DeviceError("nothing to stop")
        super().stop()


class ClosesOnce(Stage):
    def close(self) -> None:
        if self.closed:
            raise DeviceError("closed already")
        self.closed = True


class TurnedRound(Stage):
    """Its z is the other way round, as when the sign of the mounting is wrong."""

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        x, y, z = position_m
        super().move_to((x, y, -10e-3 - z) if math.isfinite(z) else position_m, speed_m_s)


def stage_checked(kind: type[Stage], box: Box = BOX, **options: Any) -> tuple[set[str], Stage]:
    stage = kind(clock := ManualClock(10**11))
    options = {"speed_m_s": SPEED_M_S} | options
    return failed(check_stage(stage, clock=clock, region_m=box, **options)), stage


def test_the_virtual_stage_keeps_every_law() -> None:
    found = check_stage((made := rig()).stage, clock=made.clock, region_m=BOX, speed_m_s=SPEED_M_S)
    assert failed(found) == set()
    assert len({one.code for one in found}) == len(found), "a law is told once"


@pytest.mark.parametrize(
    ("kind", "laws"),
    [
        (Blocks, {"move-returns", "moving-reported"}),
        (FallsShort, {"target-reached"}),
        (changed(Stage, position_m=tells_the_target), {"position-on-path"}),
        (WavesOnItsWay, {"no-reversal"}),
        (elsewhere(lambda self: 1e-4 * math.sin(math.pi * self.gone())), {"straight-path"}),
        (elsewhere(lambda self: 1e-3 * (self.now_s - 100)), {"holds-position"}),
        (NeverSaysThatItStands, {"end-reported"}),
        (StopsSlowly, {"stop-time-z"}),
        (RacesAlong, {"speed-limit", "overshoot-z"}),
        (changed(Stage, moving=lambda self: False), {"moving-reported"}),
        (TakesAnyPlace, {"refuses-outside-travel"}),
        (TakesNoNumber, {"refuses-nan"}),
        (changed(Stage, move_to=takes_any_speed), {"refuses-speed"}),
        (RefusesWithAnotherError, {"refuses-outside-travel"}),
        (TakesASecondMove, {"second-move-refused", "first-move-continues"}),
        (RunsOn, {"overshoot-x"}),
        (ReturnsBeforeItStands, {"stands-after-stop-x"}),
        (GoesOnToTheTarget, {"stops-short-y"}),
        (StopsInItsOwnThreadOnly, {"stop-from-thread"}),
        (FailsWhenStoppedAtAStand, {"stays-safe"}),
        (ClosesOnce, {"close-twice"}),
        (changed(Stage, close=lambda self: None), {"refuses-when-closed"}),
        (changed(Stage, travel=replace(Stage.travel, greatest_m=(40.0, 40.0, 12.0))), {"travel-plausible"}),
        (changed(Stage, travel=replace(Stage.travel, acceleration_m_s2=0.0)), {"travel-plausible"}),
    ],
)
def test_a_broken_stage_is_told_by_the_laws_that_it_breaks(kind: type[Stage], laws: set[str]) -> None:
    assert laws <= stage_checked(kind)[0]


class SlowedHost:
    """A clock by which a simulated stage, on a clock of its own, runs so many times as slow."""

    def __init__(self, stage: ManualClock, times: float) -> None:
        self.stage, self.times = stage, times

    def now_ns(self) -> int:
        return round(self.stage.ns * self.times)

    def sleep(self, seconds: float) -> None:
        self.stage.sleep(seconds / self.times)


def slowed(kind: type[Stage], times: float, time_scale: float) -> set[str]:
    stage = kind(clock := ManualClock(10**11))
    host = SlowedHost(clock, times)
    options = {"region_m": BOX, "speed_m_s": SPEED_M_S, "time_scale": time_scale}
    return failed(check_stage(stage, clock=host, **options))  # type: ignore[arg-type]


@pytest.mark.parametrize("times", [2.0, 8.0])
def test_a_stage_that_is_simulated_slowly_is_judged_for_what_it_does(times: float) -> None:
    assert slowed(Stage, times, times) == set()


def test_without_the_scale_a_slow_simulation_fails_for_its_speed() -> None:
    assert "end-reported" in slowed(Stage, 8.0, 1.0)


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        (NeverSaysThatItStands, "end-reported"),
        (StopsSlowly, "stop-time-z"),
        (RacesAlong, "speed-limit"),
        (RunsOn, "overshoot-x"),
        (GoesOnToTheTarget, "stops-short-y"),
        (FallsShort, "target-reached"),
    ],
)
def test_a_scale_hides_no_law_that_is_broken(kind: type[Stage], law: str) -> None:
    assert law in slowed(kind, 8.0, 8.0)


@pytest.mark.parametrize("time_scale", [0.0, -1.0, math.nan, math.inf])
def test_a_time_scale_that_is_none_is_refused(time_scale: float) -> None:
    with pytest.raises(RangeError, match="time scale"):
        stage_checked(Stage, time_scale=time_scale)


@pytest.mark.parametrize(
    ("kind", "law"),
    [("stage-stuck", "stays-safe"), ("stage-deaf", "stays-safe"), ("stage-gone", "stays-safe")],
)
def test_a_stage_that_fails_is_told_and_not_moved_on(kind: Any, law: str) -> None:
    made = rig(Fault(kind, 1.0))
    found = check_stage(made.stage, clock=made.clock, region_m=BOX, speed_m_s=SPEED_M_S)
    assert law in failed(found)
    assert [one.code for one in found if not one.ok][-1] in (
        law,
        "refuses-when-closed",
        "unexpected-error-close",
    )


def test_a_stage_that_loses_steps_stands_elsewhere() -> None:
    made = rig(Fault("stage-slips"))
    assert "target-reached" in failed(
        check_stage(made.stage, clock=made.clock, region_m=BOX, speed_m_s=SPEED_M_S)
    )


def test_what_is_no_stage_is_told_before_anything_is_called() -> None:
    found = check_stage(object(), clock=ManualClock(), region_m=BOX)
    assert [(one.code, one.ok) for one in found] == [("protocol-members", False)]


@pytest.mark.parametrize("kind", [Stage, Blocks, RunsOn, RacesAlong, TakesASecondMove, TakesNoNumber])
def test_the_stage_never_leaves_its_box_but_for_what_it_runs_on(kind: type[Stage]) -> None:
    _, stage = stage_checked(kind)
    # The slowest of these runs on for 0.2 s, or goes at three times the speed that was asked for.
    assert stage.deepest_m < BOX[1][2] + 0.2 * SPEED_M_S


def test_a_stage_outside_its_box_is_not_moved() -> None:
    found, stage = stage_checked(Stage, box=((-2e-3, -2e-3, -20e-3), (2e-3, 2e-3, -10e-3)), close=False)
    assert found == {"starts-in-box", "stays-safe"}
    assert stage.sent == []


def test_a_stage_whose_axis_is_turned_round_is_stopped_when_it_leaves_the_box() -> None:
    box: Box = ((-2e-3, -2e-3, -6e-3), (2e-3, 2e-3, -2e-3))
    found, stage = stage_checked(TurnedRound, box)
    assert "stays-safe" in found
    assert stage.deepest_m < box[1][2] + 0.1e-3  # a look every 5 ms, and what it runs on


def test_the_check_ends_when_the_watch_raises_and_the_stage_stands() -> None:
    looks = iter(range(100))

    def watch() -> None:
        if next(looks) == 60:
            raise RuntimeError("it touches something")

    stage = Stage(clock := ManualClock(10**11))
    found = check_stage(stage, clock=clock, region_m=BOX, watch=watch, close=False)
    assert failed(found) == {"stays-safe"}
    assert not stage.moving()


@pytest.mark.parametrize(
    ("box", "options", "words"),
    [
        (((-2e-3, -2e-3, -7e-3), (2e-3, 2e-3, 1.0)), {}, "box-outside-travel"),
        (((-2e-3, -2e-3, -7e-3), (2e-3, 2e-3, math.nan)), {}, "box-outside-travel"),
        (((-2e-3, -2e-3, -5.01e-3), (2e-3, 2e-3, -5e-3)), {}, "box-too-short"),
        (BOX, {"speed_m_s": math.nan}, "speed-range"),
        (BOX, {"speed_m_s": 1.0}, "speed-range"),
        (BOX, {"within_m": 0.0}, "not-positive"),
    ],
)
def test_a_box_or_speed_that_does_not_do_is_refused_before_anything_moves(
    box: Box, options: dict[str, float], words: str
) -> None:
    stage = Stage(clock := ManualClock(10**11))
    with refused(words, RangeError):
        check_stage(stage, clock=clock, region_m=box, **options)
    assert stage.sent == []


# The force sensor


class Force:
    """A force sensor that is like another one, but for what a test changes."""

    def __init__(self, device: Any, clock: ManualClock) -> None:
        self.device, self.clock = device, clock

    @property
    def rate_hz(self) -> float:
        return self.device.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        return self.device.range_n

    def latest(self) -> Wrench:
        return self.device.latest()

    def drain(self) -> list[Wrench]:
        return self.device.drain()

    def close(self) -> None:
        self.device.close()


def drained(change: Callable[[Force, list[Wrench]], list[Wrench]]) -> type[Force]:
    return changed(Force, drain=lambda self: change(self, self.device.drain()))


def restamped(time_ns: Callable[[int], int]) -> type[Force]:
    return drained(lambda _, samples: [replace(one, time_ns=time_ns(one.time_ns)) for one in samples])


def never_forgets(sensor: Any, samples: list[Wrench]) -> list[Wrench]:
    sensor.kept = [*getattr(sensor, "kept", ()), *samples][-5:]
    return list(sensor.kept)


class ShowsTheFirst(Force):
    first: Wrench | None = None

    def latest(self) -> Wrench:
        self.first = self.first or self.device.latest()
        return self.first


class LatestTakesAway(Force):
    taken: Wrench | None = None

    def latest(self) -> Wrench:
        self.taken = self.device.latest()
        return self.taken

    def drain(self) -> list[Wrench]:
        return [one for one in self.device.drain() if one != self.taken]


FORCE_FAULTS: tuple[tuple[str, type[Force]], ...] = (
    ("sample-rate", changed(Force, rate_hz=property(lambda self: 2 * self.device.rate_hz))),
    ("sample-rate", drained(lambda _, samples: [one for one in samples if one.time_ns // 5_000_000 % 3])),
    ("sample-gap", drained(lambda _, all_: [one for one in all_ if one.time_ns % 500_000_000 > 140_000_000])),
    ("drain-once", drained(never_forgets)),
    ("drain-order", drained(lambda _, samples: samples[::-1])),
    ("host-clock", restamped(lambda time_ns: time_ns + 1_700_000_000_000_000_000)),  # by the calendar
    ("host-clock", restamped(lambda time_ns: time_ns // 1000)),  # in microseconds
    ("time-order", restamped(lambda time_ns: time_ns - time_ns // 5_000_000 % 2 * 20_000_000)),
    ("latest-newest", ShowsTheFirst),
    ("latest-age", ShowsTheFirst),
    ("drain-complete", LatestTakesAway),
    ("call-time", changed(Force, latest=lambda self: (self.clock.sleep(0.03), self.device.latest())[1])),
    ("not-frozen", drained(lambda _, all_: [replace(one, force_n=(0.1, 0.2, 0.3)) for one in all_])),
    ("range-stated", changed(Force, range_n=(0.0, 10.0, 10.0))),
    ("force-in-range", changed(Force, range_n=(1.0, 1.0, 1.0))),
    ("refuses-when-closed", changed(Force, close=lambda self: None)),
)


def test_the_virtual_force_sensor_keeps_every_law() -> None:
    made = rig()
    found = check_force_sensor(made.force, clock=made.clock, noise_n=0.01)
    assert failed(found) == set()
    assert len({one.code for one in found}) == len(found)


def test_the_noise_that_is_told_is_the_sensors() -> None:
    made = rig()
    found = {one.code: one for one in check_force_sensor(made.force, clock=made.clock, seconds=10.0)}
    # 5 mN and a step of 3.1 mN, over 2000 samples: good to 1.6 %; drift adds a little.
    told = [found[f"noise-{axis}"].measured for axis in "xyz"]
    assert told == pytest.approx([math.hypot(0.005, 1 / 320 / math.sqrt(12))] * 3, rel=0.1)


@pytest.mark.parametrize(("law", "kind"), FORCE_FAULTS)
def test_a_broken_force_sensor_is_told_by_the_law_that_it_breaks(law: str, kind: type[Force]) -> None:
    made = rig()
    sensor = kind(made.force, made.clock)  # type: ignore[arg-type]
    assert law in failed(check_force_sensor(sensor, clock=made.clock))


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        ("force-stalls", "samples-continuous"),
        ("force-saturates", "no-fault"),
        ("force-gone", "unexpected-error-listening"),
        ("force-noisy", "noise-z"),
        ("force-spike", "force-in-range"),
    ],
)
def test_a_force_sensor_that_fails_is_told(kind: Any, law: str) -> None:
    made = rig(Fault(kind, 0.1))
    assert law in failed(check_force_sensor(made.force, clock=made.clock, noise_n=0.01))


def test_a_force_sensor_that_stops_in_between_leaves_a_gap_or_grows_old() -> None:
    made = rig(Fault("force-stalls", 1.0))
    assert "latest-age" in failed(check_force_sensor(made.force, clock=made.clock))


def test_listening_too_short_to_say_anything_is_refused() -> None:
    made = rig()
    with pytest.raises(RangeError, match="above 0"):
        check_force_sensor(made.force, clock=made.clock, seconds=0.0)
    with pytest.raises(RangeError, match="above 0"):
        check_force_sensor(made.force, clock=made.clock, noise_n=math.nan)


# The camera


class PlainCamera:
    """Noise at a rate, exposed and carried over, on a clock that is advanced by hand."""

    rate_hz, size_px, exposure_s, carried_s = 30.0, (24, 16), 0.01, 0.004
    true_rate_hz = 30.0
    jitter_s = 0.0

    def __init__(self, clock: ManualClock) -> None:
        self.clock, self.rng, self.closed = clock, np.random.default_rng(0), False

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        if self.closed:
            raise DeviceError("closed")
        asked_s = self.clock.ns / 1e9
        ends_s = math.ceil((asked_s + self.exposure_s) * self.true_rate_hz + 1e-9) / self.true_rate_hz
        if ends_s + self.carried_s - asked_s > timeout_s:
            self.clock.sleep(timeout_s)
            raise DeviceError("no frame came in time")
        self.clock.sleep(ends_s + self.carried_s - asked_s)
        stamped_s = ends_s - self.jitter_s * self.rng.uniform(0, 1)
        return round(stamped_s * 1e9), self.frame(stamped_s)

    def frame(self, time_s: float) -> Frame:
        return Frame(self.picture(), time_s, self.exposure_s)

    def picture(self) -> np.ndarray:
        return self.rng.integers(0, 255, (16, 24), dtype=np.uint8)

    def close(self) -> None:
        self.closed = True


def grabbed(change: Callable[[PlainCamera, int], int]) -> type[PlainCamera]:
    def grab(self: PlainCamera, timeout_s: float = 1.0) -> tuple[int, Frame]:
        time_ns, frame = PlainCamera.grab(self, timeout_s)
        return change(self, time_ns), frame

    return changed(PlainCamera, grab=grab)


CAMERA_FAULTS: tuple[tuple[str, type[PlainCamera]], ...] = (
    *(("frame-rate", changed(PlainCamera, true_rate_hz=rate_hz)) for rate_hz in (15.0, 25.0, 60.0)),
    ("frame-interval", changed(PlainCamera, jitter_s=0.02)),
    ("not-frozen", changed(PlainCamera, picture=lambda self: np.full((16, 24), 7, np.uint8))),
    ("frame-size", changed(
        PlainCamera, picture=lambda self: PlainCamera.picture(self)[: self.rng.integers(14, 17)])),
    ("frame-size", changed(PlainCamera, size_px=(16, 24))),
    # From a queue of one frame.
    ("exposed-after-call", grabbed(lambda self, time_ns: time_ns - round(1e9 / self.rate_hz))),
    ("time-order", grabbed(lambda self, time_ns: 0)),
    ("host-clock", grabbed(lambda self, time_ns: time_ns + 1_700_000_000_000_000_000)),
    ("exposure-stated", changed(
        PlainCamera, frame=lambda self, time_s: Frame(self.picture(), time_s))),
    ("exposure-length", changed(  # in milliseconds
        PlainCamera, frame=lambda self, time_s: Frame(self.picture(), time_s, 10.0))),
    ("frame-timeout", changed(
        PlainCamera, grab=lambda self, timeout_s=1.0: PlainCamera.grab(self, 1.0))),
    ("rate-stated", changed(PlainCamera, rate_hz=0.0)),
    ("refuses-when-closed", changed(PlainCamera, close=lambda self: None)),
)  # fmt: skip


def test_the_virtual_camera_keeps_every_law() -> None:
    made = rig()
    found = check_camera(made.camera, clock=made.clock)
    assert failed(found) == set()
    assert len({one.code for one in found}) == len(found)


@pytest.mark.parametrize("rate_hz", [5.0, 30.0, 29.97, 200.0])
@pytest.mark.parametrize("carried_s", [0.0, 0.05])
def test_the_rate_is_found_whatever_frames_are_missed_between_grabs(rate_hz: float, carried_s: float) -> None:
    camera = PlainCamera(clock := ManualClock(10**11))
    camera.rate_hz = camera.true_rate_hz = rate_hz
    camera.exposure_s, camera.carried_s = 0.3 / rate_hz, carried_s
    found = {one.code: one for one in check_camera(camera, clock=clock)}
    assert failed(list(found.values())) == set()
    # The frames span over 80 periods, and a peak is sampled ten times.
    assert found["frame-rate"].measured == pytest.approx(rate_hz, rel=2e-3)


@pytest.mark.parametrize(("law", "kind"), CAMERA_FAULTS)
def test_a_broken_camera_is_told_by_the_law_that_it_breaks(law: str, kind: type[PlainCamera]) -> None:
    camera = kind(clock := ManualClock(10**11))
    assert law in failed(check_camera(camera, clock=clock))


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        ("camera-gone", "unexpected-error-grabbing"),
        ("camera-frozen", "not-frozen"),
        ("camera-resized", "frame-size"),
        ("camera-drops", "frame-rate"),
    ],
)
def test_a_camera_that_fails_is_told(kind: Any, law: str) -> None:
    made = rig(Fault(kind))
    assert law in failed(check_camera(made.camera, clock=made.clock))


def test_too_few_frames_to_tell_a_rate_are_refused() -> None:
    made = rig()
    with refused("too-few-frames", RangeError, match="20"):
        check_camera(made.camera, clock=made.clock, frames=10)


# The whole rig


def test_the_virtual_rig_keeps_every_law_and_touches_nothing() -> None:
    made = rig()
    stage = Around(made.stage, made.clock)  # type: ignore[arg-type]
    found = check_rig(replace(made, stage=stage))
    assert failed(found) == set()
    assert len({one.code for one in found}) == len(found)
    assert stage.deepest_m <= SURFACE_M - 2e-3


def test_a_probe_near_the_skin_is_not_moved() -> None:
    made = rig()
    made.stage.move_to((0.0, 0.0, -1e-3), 5e-3)
    made.clock.sleep(2.0)
    stage = Around(made.stage, made.clock)  # type: ignore[arg-type]
    assert "stage.clear-of-skin" in failed(check_rig(replace(made, stage=stage), close=False))
    assert stage.sent == []


@pytest.mark.parametrize("kind", ["force-stalls", "force-saturates", "force-gone", "force-noisy"])
def test_nothing_moves_on_a_force_sensor_that_fails(kind: Any) -> None:
    made = rig(Fault(kind, 0.2))
    stage = Around(made.stage, made.clock)  # type: ignore[arg-type]
    assert "stage.was-moved" in failed(check_rig(replace(made, stage=stage), close=False))
    assert stage.sent == []


@pytest.mark.parametrize("kind", ["force-stalls", "force-saturates", "force-gone", "force-spike"])
@pytest.mark.cases(1)
def test_motion_ends_when_the_force_sensor_fails_on_the_way(kind: Any) -> None:
    # Force and camera take 2 s and more; by then the stage moves.
    made = rig(Fault(kind, 10.0))
    stage = Around(made.stage, made.clock)  # type: ignore[arg-type]
    assert "stage.stays-safe" in failed(check_rig(replace(made, stage=stage), close=False))
    assert not made.stage.moving()


def test_the_oldest_force_that_the_check_bears_is_the_rigs_own_limit() -> None:
    made = rig()
    found = check_rig(replace(made, limits=replace(made.limits, age_s=0.07)))
    assert [one.allowed for one in found if one.code == "force.latest-age"] == [0.07]


def test_a_rig_whose_limits_leave_the_travel_is_told() -> None:
    made = rig(Fault("force-gone", 0.2))
    wide = replace(made.limits, greatest_m=(1.0, 1.0, 1.0))
    assert "rig.limits-in-travel" in failed(check_rig(replace(made, limits=wide)))
