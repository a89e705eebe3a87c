"""Guarded motion: nothing moves on an old force, and no motion continues past a limit.

A move towards the skin is divided into short ones, one in flight at a time. During motion the stage stops on
too much force, too fast a rise, an old or faulty sample, an operator command, any failure, or a force that no
motion explains (`force_trust`). Subscribers receive the samples, the position, and each look.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Generic, ParamSpec

from palpate.core import NS_PER_S, Clock, DeviceError, HardwareStopError, Position, Wrench
from palpate.devices.device_proxies import Actuator, ForceSource, PlainActuator, PlainForceSource
from palpate.devices.force_bias import Force, ForceBias
from palpate.devices.force_trust import Doubt, ForceMonitor, Phase, StiffnessRange, name_fault
from palpate.devices.motion_limits import ForceWatch, Limits, Reason, Tripped
from palpate.devices.operator_control import AT_ONCE, OperatorCommand, OperatorControl

POLL_S = 0.002  # between two looks at the force while something moves
WAIT_S = 0.02  # and while nothing does
LEVEL_M = 1e-6  # by which a move that leads aside may lead down
ARRIVED_M = 0.02e-3  # from the target, at most, after a move
LATE_S = 4.0  # beyond the time that a move should take: a stage's answer can be late by seconds
LATE_FACTOR = 2.0
LISTEN_S = 0.25  # at a stand, after a force that is not believed, to name what is wrong
FELT = (Reason.FORCE_LIMIT, Reason.TOUCHED_EARLY)  # names of a rise that is believed
FALLS = 0.25  # least share by which a force falls on the way back, of a linear fall
RISE_N = 1.0  # by which force may rise while the probe moves away: friction, noise, a sign that is wrong

LEAVING = (OperatorCommand.ESTOP,)
"""What may stop the probe on its way away from the skin."""


AIR_S = 0.3  # in the air, for the force sensor's zero
AIR_PERIODS = 25  # and at least, of a slow sensor
FEW = 3  # samples from which a rate can be told
LONGER_S = 1.0  # more, where nothing but one value was read

Until = Callable[[Force], bool]
Check = Callable[[Wrench], None]


@dataclass(frozen=True, slots=True)
class ForceReached:
    """Normal force at which a move ends: so much, or more [N]. Data, so that a supervisor can be told.

    Attributes:
        any_way: The force in any direction counts, and not along the normal alone.
    """

    normal_n: float
    any_way: bool = False

    def __call__(self, force: Force) -> bool:
        return (math.hypot(*force) if self.any_way else force[2]) >= self.normal_n


@dataclass(frozen=True, slots=True)
class Clearance:
    """Height at which the probe hangs free, along the stage's z, and how fast it is lifted there [m, m/s]."""

    z_m: float
    speed_m_s: float


def _never(force: Force) -> bool:
    return False


def _unchecked(sample: Wrench) -> None:
    pass


def _good(samples: Sequence[Wrench]) -> list[Wrench]:
    return [one for one in samples if not one.fault]


class _DoubtError(Exception):
    """Carries a doubt from a sample's check to the look that took the sample in."""

    def __init__(self, doubt: Doubt) -> None:
        super().__init__(doubt.text)
        self.doubt = doubt


class MotionGuard:
    """Moves an actuator within limits, and watches a force all the while.

    Args:
        stage: what moves.
        sensor: what feels the contact.
        limits: of position, speed and force.
        bias: from a sample to the force in the skin's axes.
        clock: that samples are stamped on.
        control: through which the operator interrupts.

    Attributes:
        clearance: where `lift` goes; None until it is stated.
        monitor: doubts the force, once it was taught in the air.
        samples: hear each batch of force samples, raw and oldest first, before it is checked.
        positions: hear where the stage is [m], and when that was asked [ns], at each look while it moves and
            once it stands.
        looks: hear of each look at the force, after its samples and position.

    An exception of a subscriber stops the motion as that of a device does.
    """

    def __init__(
        self,
        stage: Actuator,
        sensor: ForceSource,
        limits: Limits,
        bias: ForceBias,
        clock: Clock,
        control: OperatorControl,
    ) -> None:
        limits.check_within(stage.travel)
        self._stage = PlainActuator(stage)
        self._sensor = PlainForceSource(sensor)
        self._limits = limits
        self._bias = bias
        self._clock = clock
        self._control = control
        self.clearance: Clearance | None = None
        self.monitor = ForceMonitor(bias, limits, stage.travel)
        self._disbelieved = False
        self.samples: Subscribers[[Sequence[Wrench]]] = Subscribers()
        self.positions: Subscribers[[Position, int]] = Subscribers()
        self.looks: Subscribers[[]] = Subscribers()
        self._watch = ForceWatch(limits)
        self._phase = Phase.STAND
        self._turn = threading.RLock()
        self._stoppable: tuple[OperatorCommand, ...] = ()  # what may stop the move that is under way
        self._age_s = 0.0  # of the sample that `fresh` handed out last
        self._left: Position | None = None  # where it stood after the last move that arrived
        self._risen_from: Force | None = None  # force at the start of the last motion away, where it rose [N]
        self._lift_from: Force | None = None  # force at the start of a lift that a rise has stopped [N]

    @property
    def force_n(self) -> Force:
        """The newest force, in the skin's axes [N]."""
        return self._bias.force(self.fresh())

    def skin_n(self, sample: Wrench) -> Force:
        """Force of a sample, in the skin's axes, without the bias [N]."""
        return self._bias.force(sample)

    def position_m(self) -> Position:
        try:
            return self._stage.position_m()
        except DeviceError as e:
            raise Tripped(Reason.STAGE, f"the stage does not say where it is: {e}") from e

    def close(self) -> None:
        """Nothing: the stage stands, and whoever opened the devices closes them."""

    def tare(self, stated_hz: float) -> list[Wrench]:
        """Take the sensor's zero and learn its noise, standing in the air; the samples from which it was.

        Args:
            stated_hz: samples a second that the sensor states [Hz].
        """
        samples = self.wait(max(AIR_S, AIR_PERIODS / stated_hz), judged=False)
        if len({(one.force_n, one.torque_nm) for one in _good(samples)}) == 1:
            samples += self.wait(LONGER_S, judged=False)
        if len(_good(samples)) >= FEW:
            if self._disbelieved:
                self.monitor.forget_press()
            self.monitor.learn_air(_good(samples), stated_hz)
        self._bias.measure(samples)
        self._disbelieved = False  # it measures in the air as it has to
        return samples

    def new_tool(self, stated: StiffnessRange | None = None) -> None:
        """Forget the stiffness that was learnt: another tool or skin follows; its range may be stated."""
        self.monitor.new_tool(stated)

    def learn_press(self) -> None:
        """Learn the skin's stiffness from the way down that went well just now."""
        self.monitor.learn_press()

    def lift(self) -> None:
        """Lift straight up to the clearance, if the probe is below it."""
        if self.clearance is None:
            raise Tripped(Reason.PLAN, "a lift before anybody stated the clearance")
        x, y, z = self.position_m()
        if z > self.clearance.z_m:
            self.away((x, y, self.clearance.z_m), self.clearance.speed_m_s, judged=False)

    def wait(self, seconds: float, *, judged: bool = True) -> list[Wrench]:
        """Let time pass while watching, and return what the sensor measured in it.

        Args:
            seconds: how long.
            judged: raise on what must stop a motion; off where no force means anything yet, in the air.
        """
        end_ns = self._clock.now_ns() + round(seconds * NS_PER_S)
        samples: list[Wrench] = []
        while (left_s := (end_ns - self._clock.now_ns()) / NS_PER_S) > 0:
            self._clock.sleep(min(WAIT_S, left_s))
            samples += self.look(judged=judged)
            self.looks.publish()
        return samples

    def towards(
        self, target: Position, speed_m_s: float, until: Until | None = None, step_m: float | None = None
    ) -> bool:
        """Move in short guarded steps; True as soon as `until` says so of a force, stopped there.

        Args:
            target: where to [m].
            speed_m_s: how fast.
            until: of the force in the skin's axes; asked before each step and of every sample on the way.
            step_m: longest step; the limits' own where left out.
        """
        until = until or _never
        self._limits.check_sensor(self._sensor)
        self._limits.check_target(target)
        self._limits.check_speed(speed_m_s, self._stage.travel)
        start = self.position_m()
        self._check_left(start)
        self._phase = Phase.DOWN if target[2] > start[2] + LEVEL_M else Phase.ASIDE
        pieces = max(1, math.ceil(math.dist(start, target) / (step_m or self._limits.step_m) - 1e-9))
        for i in range(1, pieces + 1):
            if until(self._bias.force(self._moved_on())):
                return True
            x, y, z = (start[k] + (target[k] - start[k]) * i / pieces for k in range(3))
            if self._run((x, y, z), speed_m_s, until, self._within, AT_ONCE):
                return True
        return until(self._bias.force(self._moved_on()))

    def away(self, target: Position, speed_m_s: float, *, judged: bool = True) -> None:
        """Move away from the skin, or beside it, in one go; allowed under a force above the limit.

        Where judged, and at a speed at which it may also move towards the skin, it stops on a force that is
        not believed. Faster, or after that, it goes on to its target whatever the sensor reads: away is where
        nothing is pressed. Where the force rises, since z may be reversed, it goes back to where it began.
        """
        self._limits.check_target(target)
        began, travel = self.position_m(), self._stage.travel
        up = target[2] < began[2] - LEVEL_M
        speed = min(speed_m_s, travel.top_speed_m_s)
        slow = judged and self._limits.runs_on_m(speed, travel) <= self._limits.overshoot_m
        self._phase, self._risen_from = Phase.UP if slow else Phase.LIFT, None
        try:
            self._run(target, speed, _never, self._rise_check(self._lift_start(up), up, slow), LEAVING)
        except Tripped as e:
            if self._risen_from is None or self._disbelieved:
                raise
            raise self._back_out(e, began, self._risen_from, speed) from e
        self._lift_from = None

    def _rise_check(self, start: Force | None, up: bool, slow: bool) -> Check:
        """Check of a motion away: it ends where the force rises from that of its start."""
        old_ns = self._clock.now_ns() + round(self._limits.force_latency_s * NS_PER_S)

        def check(sample: Wrench) -> None:
            nonlocal start
            force = self._bias.force(sample)
            if sample.fault or self._disbelieved:
                return
            if start is not None and sample.time_ns <= old_ns:  # of what was before this motion
                start = max(start, force, key=self._rising_part)
            if slow and math.hypot(*force) <= self._limits.force_n:
                self._believe(sample)
            if start is not None and self._rises(start, force):
                self._lift_from, self._risen_from = start if up else self._lift_from, start
                raise _DoubtError(self.monitor.rise(start, force, up))

        return check

    def _lift_start(self, up: bool) -> Force | None:
        """Force at the start of a motion away; after a lift that a rise has stopped, the lower of both."""
        start = self._last_force()
        before = self._lift_from if up and not self._disbelieved else None
        if start is None or before is None:
            return start
        if self._rises(before, start):
            raise self._named(self.monitor.rise(before, start, up))
        return min(start, before, key=self._rising_part)

    def _back_out(self, stopped: Tripped, began: Position, start: Force, speed_m_s: float) -> Tripped:
        """Go back to where a motion away began, as its repetition would press harder; the error to raise."""
        now, ended = self._last_force(), self.position_m()
        rose_n = 0.0 if now is None else self._rising_part(now) - self._rising_part(start)
        if now is None or rose_n < RISE_N / 2:
            return stopped  # what pressed is gone
        far_m = max(math.dist(began, ended), LEVEL_M)

        def stays(sample: Wrench) -> None:  # a sensor that has changed: the probe is safer where it is
            back = math.dist(self._stage.position_m(), ended) / far_m
            force = self._bias.force(sample)
            most_n = self._rising_part(now) - FALLS * rose_n * min(back, 1.0) + RISE_N / 2
            if not sample.fault and self._rising_part(force) > most_n:
                raise _DoubtError(self.monitor.rise(now, force, False))

        slow_m_s = min(speed_m_s, self._limits.fastest_m_s(self._stage.travel))
        try:
            self._run(began, slow_m_s, _never, stays, LEAVING)
            told = "the probe went back to where that motion began"
        except Tripped as e:
            told = f"the probe did not go back: {e}"
        return Tripped(stopped.reason, f"{stopped}; {told}", stopped.numbers)

    def look(self, asks: tuple[OperatorCommand, ...] = AT_ONCE, *, judged: bool = True) -> list[Wrench]:
        """Take in and publish what the sensor measured since, and raise on what must stop a motion."""
        samples = self._look(self._within if judged else _unchecked, asks)
        if not judged:
            self.monitor.restart()
        return samples

    def _look(self, check: Check, asks: tuple[OperatorCommand, ...]) -> list[Wrench]:
        """On the way away from the skin a sensor that is gone stops nothing: there it is safer to move on."""
        self._control.check(asks)
        try:
            samples = self._sensor.drain()
        except DeviceError as e:
            if asks == LEAVING:
                return []
            raise Tripped(Reason.FORCE_SENSOR, f"the force sensor failed: {e}") from e
        self.samples.publish(samples)
        for i, one in enumerate(samples):
            try:
                check(one)
            except _DoubtError as e:
                raise self._named(e.doubt, samples[i:]) from None
        return samples

    def interrupt(self, command: OperatorCommand) -> None:
        """Stop a move at once that this command stops at the guard's next look; from another thread."""
        with self._turn:  # so that no lift begins meanwhile, which it would stop short
            if command in self._stoppable:
                self._stage.stop()

    def halt(self) -> None:
        """Bring the stage to a stand.

        Raises:
            Tripped: it could not be.
        """
        try:
            self._stage.stop()
        except HardwareStopError as e:
            raise Tripped(Reason.HARDWARE_STOP, str(e)) from e
        except DeviceError as e:
            raise Tripped(Reason.STAGE, f"the stage did not stop when told to: {e}") from e

    def _run(
        self,
        target: Position,
        speed_m_s: float,
        until: Until,
        check: Check,
        asks: tuple[OperatorCommand, ...],
    ) -> bool:
        """One move, watched; the stage stands when this returns or raises."""
        with self._turn:
            self._stoppable = asks
        try:
            return self._watched(target, speed_m_s, until, check, asks)
        finally:
            with self._turn:
                self._stoppable = ()

    def _watched(
        self,
        target: Position,
        speed_m_s: float,
        until: Until,
        check: Check,
        asks: tuple[OperatorCommand, ...],
    ) -> bool:
        try:
            start = self.position_m()
            reached = self._follow(target, speed_m_s, until, check, asks)
            if reached:
                self.halt()
            self.monitor.end(self._clock.now_ns())
            if reached:
                self.monitor.stood(math.dist(start, self.position_m()))
                return True
        except HardwareStopError as e:
            self._end()
            raise Tripped(Reason.HARDWARE_STOP, str(e)) from e
        except DeviceError as e:
            self._end()
            raise Tripped(Reason.STAGE, f"the stage failed on its way: {e}") from e
        except BaseException:
            self._end()
            raise
        self._control.check(asks)  # a stop from outside leaves it short of its target
        self._check_arrived(target)
        self.monitor.stood(math.dist(start, target))
        if not self._disbelieved and (doubt := self.monitor.arrived()) is not None:
            raise self._named(doubt)
        return False

    def _end(self) -> None:
        """Bring the stage to a stand, and have the force held against a stand from then on."""
        self.halt()
        self.monitor.end(self._clock.now_ns())

    def _follow(
        self,
        target: Position,
        speed_m_s: float,
        until: Until,
        check: Check,
        asks: tuple[OperatorCommand, ...],
    ) -> bool:
        slowing_s = speed_m_s / self._stage.travel.acceleration_m_s2
        due_s = LATE_S + LATE_FACTOR * (math.dist(self.position_m(), target) / speed_m_s + slowing_s)
        start, asked_ns = self.position_m(), self._clock.now_ns()
        self._left = None
        end_ns = asked_ns + round(due_s * NS_PER_S)
        self._stage.move_to(target, speed_m_s)
        self.monitor.begin(self._phase, speed_m_s, math.dist(start, target), asked_ns, self._clock.now_ns())
        while self._stage.moving():
            self._clock.sleep(POLL_S)
            if any(until(self._bias.force(one)) for one in self._look(check, asks)):
                return True
            if check == self._within or target[2] > start[2] + LEVEL_M:
                self._moved_on()
            elif self._phase is Phase.UP:
                self._check_gap()
            now_ns, at = self._clock.now_ns(), self._stage.position_m()
            self.monitor.reported(math.dist(start, at))
            self.positions.publish(at, now_ns)
            self.looks.publish()
            if now_ns > end_ns:
                raise Tripped(Reason.STAGE_LATE, f"the stage still moves {due_s:.1f} s after it was sent")
        # What came since the last look belongs to this move: all of it where the computer was busy.
        return any(until(self._bias.force(one)) for one in self._look(check, asks))

    def _check_arrived(self, target: Position) -> None:
        at = self.position_m()
        self.positions.publish(at, self._clock.now_ns())
        if (miss_m := math.dist(at, target)) > ARRIVED_M:
            raise Tripped(
                Reason.STAGE,
                f"the stage stands {miss_m * 1e3:.3f} mm from where it was sent; {ARRIVED_M * 1e3:g} mm are "
                "allowed: were steps lost?",
            )
        self._left = at

    def _check_left(self, at: Position) -> None:
        """Refuse to go on into the skin from elsewhere than where the last move left the stage."""
        if self._left is not None and (off_m := math.dist(at, self._left)) > ARRIVED_M:
            raise Tripped(
                Reason.STAGE,
                f"the stage stands {off_m * 1e3:.3f} mm from where it was left; {ARRIVED_M * 1e3:g} mm are "
                "allowed: was it pushed, or is its count wrong?",
            )

    def _believe(self, sample: Wrench) -> None:
        """Raise `_DoubtError` on a good sample that the monitor does not believe."""
        if (doubt := self.monitor.take(sample)) is not None:
            raise _DoubtError(doubt)

    def _named(self, doubt: Doubt, after: Sequence[Wrench] = ()) -> Tripped:
        """Stop, listen for a moment to what follows, and name it; from now on the force is not believed."""
        self.halt()
        begun_ns, heard, listened_s = self._clock.now_ns(), list(after), 0.0
        while listened_s < LISTEN_S:
            self._clock.sleep(WAIT_S)
            heard += self._look(_unchecked, LEAVING)
            listened_s = (self._clock.now_ns() - begun_ns) / NS_PER_S
        named = Tripped(*name_fault(doubt, heard, self.monitor.air, self._bias, listened_s), doubt.numbers)
        self._disbelieved = named.reason not in FELT
        return named

    def _check_gap(self) -> None:
        """Doubt a sensor that is silent on the way back; one that does not answer stops nothing there."""
        asked_ns = self._clock.now_ns()
        with suppress(DeviceError):
            age_s = (asked_ns - self._sensor.latest().time_ns) / NS_PER_S
            learnt = self.monitor.air is not None
            if learnt and not self._disbelieved and age_s > self.monitor.oldest_s:
                raise self._named(self.monitor.gap(age_s))

    def fresh(self) -> Wrench:
        """The newest sample."""
        asked_ns = self._clock.now_ns()  # before the call: a busy computer makes no sample old
        try:
            newest = self._sensor.latest()
        except DeviceError as e:
            raise Tripped(Reason.FORCE_SENSOR, f"the force sensor failed: {e}") from e
        self._age_s = (asked_ns - newest.time_ns) / NS_PER_S
        self._watch.check_age(self._age_s)
        if newest.fault:
            raise Tripped(Reason.FORCE_FAULT, f"the force sensor says: {newest.fault}")
        return newest

    def _moved_on(self) -> Wrench:
        """The newest sample, on which a motion goes on; one that is older than it should be is doubted."""
        newest = self.fresh()
        if self._age_s > self.monitor.oldest_s:
            raise self._named(self.monitor.gap(self._age_s))
        return newest

    def _within(self, sample: Wrench) -> None:
        if sample.fault:
            raise Tripped(Reason.FORCE_FAULT, f"the force sensor says: {sample.fault}")
        force = self._bias.force(sample)
        self._watch.check_size(math.hypot(*force))
        self._believe(sample)
        self._watch.check_rate(sample.time_ns, force[2])

    def _last_force(self) -> Force | None:
        """Newest force, however old [N]; None where the sensor does not say."""
        try:
            newest = self._sensor.latest()
        except DeviceError:
            return None
        return None if newest.fault else self._bias.force(newest)

    def _rising_part(self, force: Force) -> float:
        """What of a force rises where the probe is pressed [N].

        Before a zero was measured, a tool's weight may lie in any direction, and hide in the magnitude what
        is pressed.
        """
        return force[2] if self.monitor.air is None else math.hypot(*force)

    def _rises(self, start: Force, force: Force) -> bool:
        """Whether a force rose by more than a motion away explains."""
        return self._rising_part(force) > self._rising_part(start) + RISE_N


P = ParamSpec("P")


class Subscribers(Generic[P]):
    """Callbacks for one kind of event, called in the order in which they subscribed.

    Example:
        >>> force: Subscribers[[float]] = Subscribers()
        >>> force.subscribe(lambda newtons: print("recorded", newtons))
        >>> with force.subscribed(lambda newtons: print("plotted", newtons)):
        ...     force.publish(1.5)
        recorded 1.5
        plotted 1.5
        >>> force.publish(2.0)
        recorded 2.0
    """

    def __init__(self) -> None:
        self._callbacks: list[Callable[P, None]] = []

    def subscribe(self, callback: Callable[P, None]) -> None:
        """Call it at each event from now on, after those that subscribed before."""
        self._callbacks.append(callback)

    def unsubscribe(self, callback: Callable[P, None]) -> None:
        """Call it no more."""
        self._callbacks.remove(callback)

    @contextmanager
    def subscribed(self, callback: Callable[P, None]) -> Iterator[None]:
        """Call it at each event within a ``with`` block, and then no more, however the block ends."""
        self.subscribe(callback)
        try:
            yield
        finally:
            self.unsubscribe(callback)

    def publish(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Call all of them, also where one raises."""
        errors: list[Exception] = []
        for callback in tuple(self._callbacks):
            try:
                callback(*args, **kwargs)
            except Exception as e:
                errors.append(e)
        if errors:
            for other in errors[1:]:
                errors[0].add_note(f"another subscriber raised {type(other).__name__}: {other}")
            raise errors[0]
