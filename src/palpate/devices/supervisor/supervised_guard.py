"""Guard of a motion that a supervisor carries out: what `MotionGuard` is in one process, over a link."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from palpate.core import ForceSensor, Position, Wrench
from palpate.devices.force_bias import Force, ForceBias
from palpate.devices.force_trust import StiffnessRange
from palpate.devices.motion_guard import Clearance, ForceReached, Subscribers
from palpate.devices.motion_limits import Reason, Tripped
from palpate.devices.operator_control import AT_ONCE, OperatorCommand, OperatorControl
from palpate.devices.supervisor.guard_messages import sample_of, three
from palpate.devices.supervisor.process_link import ANSWER_S, Message, ProcessGoneError
from palpate.devices.supervisor.supervisor_link import SupervisorLink


class SupervisedGuard:
    """Orders guarded motion of a supervisor, and publishes what it tells. See `MotionGuard`.

    Args:
        link: to the supervisor.
        sensor: the supervisor's force sensor, or a proxy of it.
        bias: follows the supervisor's zero.
        control: its commands are passed on at once, in the thread that asks.

    Attributes:
        samples, positions, looks: as of a `MotionGuard`. What subscribes must keep up: a look that lies
            unanswered for a second stops the motion.

    An exception of a subscriber stops the motion.
    """

    def __init__(
        self, link: SupervisorLink, sensor: ForceSensor, bias: ForceBias, control: OperatorControl
    ) -> None:
        self._link, self._sensor, self._bias, self._control = link, sensor, bias, control
        self._clearance: Clearance | None = None
        self.samples: Subscribers[[Sequence[Wrench]]] = Subscribers()
        self.positions: Subscribers[[Position, int]] = Subscribers()
        self.looks: Subscribers[[]] = Subscribers()
        self._ask("begin")
        link.force.guarded = True
        control.listen(lambda command: link.tell("command", command=command))

    @property
    def clearance(self) -> Clearance | None:
        """Where `lift` goes, and where the supervisor lifts to by itself; None until it is stated."""
        return self._clearance

    @clearance.setter
    def clearance(self, clearance: Clearance) -> None:
        self._clearance = clearance
        self._ask("clearance", z_m=clearance.z_m, speed_m_s=clearance.speed_m_s)

    @property
    def force_n(self) -> Force:
        """The newest force, in the skin's axes [N]."""
        with _as_tripped():
            return self._bias.force(self._sensor.latest())

    def skin_n(self, sample: Wrench) -> Force:
        """Force of a sample, in the skin's axes, without the bias [N]."""
        return self._bias.force(sample)

    def position_m(self) -> Position:
        return three(self._ask("position"))

    def tare(self, stated_hz: float) -> list[Wrench]:
        """Take the sensor's zero and learn its noise, standing in the air; the samples from which it was."""
        zero = self._order("tare", stated_hz=stated_hz)
        bias = self._bias
        bias.force_n, bias.torque_nm = three(zero["force_n"]), three(zero["torque_nm"])
        bias.noise_n = float(zero["noise_n"])
        return [sample_of(row) for row in zero["samples"]]

    def new_tool(self, stated: StiffnessRange | None = None) -> None:
        """Forget the stiffness that was learnt: another tool or skin follows; its range may be stated."""
        self._order("new_tool", stated=None if stated is None else asdict(stated))

    def learn_press(self) -> None:
        """Learn the skin's stiffness from the way down that went well just now."""
        self._order("learn_press")

    def lift(self) -> None:
        """Lift straight up to the clearance, if the probe is below it."""
        self._order("lift")

    def wait(self, seconds: float, *, judged: bool = True) -> list[Wrench]:
        """Let time pass while watching, and return what the sensor measured in it."""
        return [sample_of(row) for row in self._order("wait", seconds, seconds=seconds, judged=judged)]

    def look(self, asks: tuple[OperatorCommand, ...] = AT_ONCE, *, judged: bool = True) -> list[Wrench]:
        """Take in and publish what the sensor measured since, and raise on what must stop a motion."""
        return [sample_of(row) for row in self._order("look", asks=list(asks), judged=judged)]

    def towards(
        self,
        target: Position,
        speed_m_s: float,
        until: ForceReached | None = None,
        step_m: float | None = None,
    ) -> bool:
        """Move in short guarded steps; True as soon as the normal force is reached, stopped there."""
        until_n, any_way = (None, False) if until is None else (until.normal_n, until.any_way)
        reached = self._order(
            "towards",
            target=target,
            speed_m_s=speed_m_s,
            until_N=until_n,
            until_any=any_way,
            step_m=step_m,
        )
        return bool(reached)

    def away(self, target: Position, speed_m_s: float) -> None:
        """Move away from the skin, or beside it, in one go."""
        self._order("away", target=target, speed_m_s=speed_m_s)

    def halt(self) -> None:
        """Bring the stage to a stand."""
        self._ask("stop")

    def close(self) -> None:
        """The run is over: from now on the sensor is asked, and commands are nobody's."""
        self._control.listen(None)
        self._link.force.guarded = False
        if not self._link.gone:
            self._ask("end")

    def _ask(self, do: str, **fields: Any) -> Any:
        with _as_tripped():
            return self._link.ask(do, **fields)

    def _order(self, do: str, lasts_s: float = 0.0, **fields: Any) -> Any:
        """Order something, publish what is told on the way, and return what comes of it."""
        failed: BaseException | None = None
        with _as_tripped():
            number = self._link.order(do, **fields)
            while (event := self._link.next_event(ANSWER_S + lasts_s)).get("id") != number:
                if "look" in event:
                    failed = self._publish(event, failed)
        try:
            self._pass_on(event)
        except BaseException as e:
            failed = failed or e
        if failed is not None:
            raise failed
        return self._link.result_of(event)

    def _publish(self, event: Message, failed: BaseException | None) -> BaseException | None:
        """Publish a look, and say that it was dealt with."""
        try:
            self._pass_on(event)
            self.looks.publish()
        except BaseException as e:
            if failed is None:
                self._link.tell("halt")
            failed = failed or e
        finally:
            self._link.tell("heard", look=event["look"])
        return failed

    def _pass_on(self, message: Message) -> None:
        self._link.force.tell([sample_of(row) for row in message["samples"]])
        try:
            self.samples.publish(self._sensor.drain())
        finally:
            for *at, time_ns in message["positions"]:
                self.positions.publish(three(at), int(time_ns))


@contextmanager
def _as_tripped() -> Iterator[None]:
    """Raise a supervisor that is gone as what ends a motion, by its name."""
    try:
        yield
    except ProcessGoneError as e:
        raise Tripped(Reason.SUPERVISOR, str(e)) from e
